//! What is said to whoever sits before the window, with what can be done about it.

use crate::app::{App, Command};

/// A message, with a way out of what it tells.
#[derive(Clone, Debug)]
pub struct Message {
    /// By which it is taken away.
    pub id: u64,
    /// How it is shown.
    pub kind: MessageKind,
    /// A sentence.
    pub text: String,
    /// What can be done, and what it is called.
    pub ways: Vec<(String, Command)>,
    /// When it goes by itself, in seconds since the window opened.
    pub until: Option<f64>,
}

/// How a message is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MessageKind {
    /// Something to know.
    Note,
    /// Something was done.
    Done,
    /// Something went wrong.
    Error,
}

/// So many are shown at the most; the oldest goes.
const MOST: usize = 4;

impl App {
    /// Says something that passes.
    pub(super) fn note(&mut self, text: String) {
        self.say(MessageKind::Note, &text, Vec::new(), Some(6.0));
    }

    /// Says that something was done.
    pub(super) fn done(&mut self, text: String) {
        self.say(MessageKind::Done, &text, Vec::new(), Some(4.0));
    }

    /// Says something that should be read.
    pub(super) fn warn(&mut self, text: String) {
        self.say(MessageKind::Note, &text, Vec::new(), Some(12.0));
    }

    /// Says something, with what can be done about it.
    pub(super) fn offer(&mut self, text: String, ways: Vec<(String, Command)>) {
        self.say(MessageKind::Note, &text, ways, None);
    }

    /// Says what went wrong.
    pub(super) fn fail(&mut self, text: String) {
        self.fail_with(text, Vec::new());
    }

    /// Says what went wrong, with a way out.
    pub(super) fn fail_with(&mut self, text: String, ways: Vec<(String, Command)>) {
        log::error!("{text}");
        self.say(MessageKind::Error, &text, ways, None);
    }

    fn say(&mut self, kind: MessageKind, text: &str, ways: Vec<(String, Command)>, secs: Option<f64>) {
        let text = sentence_case(text);
        let messages = &mut self.state.messages;
        messages.retain(|message| message.text != text);
        let until = secs.map(|secs| self.state.now + secs);
        messages.push(Message { id: self.next_message, kind, text, ways, until });
        self.next_message += 1;
        if messages.len() > MOST {
            messages.remove(0);
        }
    }
}

fn sentence_case(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}
