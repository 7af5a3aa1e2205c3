//! What is said to whoever sits before the window.

use crate::ui::App;
use crate::ui::command::Command;
use crate::ui::state::{Toast, ToastKind};

impl App {
    /// Says something that passes.
    pub(super) fn note(&mut self, text: String) {
        self.toast(ToastKind::Note, text, Vec::new(), Some(6.0));
    }

    /// Says that something was done.
    pub(super) fn done(&mut self, text: String) {
        self.toast(ToastKind::Done, text, Vec::new(), Some(4.0));
    }

    /// Says something that should be read.
    pub(super) fn warn(&mut self, text: String) {
        self.toast(ToastKind::Note, text, Vec::new(), Some(12.0));
    }

    /// Says something, with what can be done about it.
    pub(super) fn offer(&mut self, text: String, ways: Vec<(String, Command)>) {
        self.toast(ToastKind::Note, text, ways, None);
    }

    /// Says what went wrong.
    pub(super) fn fail(&mut self, text: String) {
        self.fail_with(text, Vec::new());
    }

    /// Says what went wrong, with a way out.
    pub(super) fn fail_with(&mut self, text: String, ways: Vec<(String, Command)>) {
        log::error!("{text}");
        self.toast(ToastKind::Error, text, ways, None);
    }

    fn toast(&mut self, kind: ToastKind, text: String, ways: Vec<(String, Command)>, secs: Option<f64>) {
        let text = sentence_case(&text);
        self.state.toasts.retain(|toast| toast.text != text);
        let until = secs.map(|secs| self.state.now + secs);
        self.state.toasts.push(Toast { id: self.next_toast, kind, text, ways, until });
        self.next_toast += 1;
        if self.state.toasts.len() > 4 {
            self.state.toasts.remove(0);
        }
    }
}

fn sentence_case(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}
