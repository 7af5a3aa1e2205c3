//! The system's dialogs, which may take as long as a person wants while the window goes on.

use std::future::Future;
use std::path::PathBuf;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context as TaskContext, Poll, Wake, Waker};

use eframe::egui::Context;

use crate::ui::command::Field;

/// A dialog that is open.
pub(super) struct Dialog {
    /// What its answer is for.
    pub field: Field,
    answer: Pin<Box<dyn Future<Output = Option<rfd::FileHandle>>>>,
    waker: Waker,
}

struct Repaint(Context);

impl Wake for Repaint {
    fn wake(self: Arc<Self>) {
        self.0.request_repaint();
    }
}

impl Dialog {
    /// Asks for what `field` needs, beginning where it points now.
    pub(super) fn open(ctx: &Context, field: Field, at: &str) -> Self {
        let dialog = rfd::AsyncFileDialog::new();
        let dialog = if at.is_empty() { dialog } else { dialog.set_directory(at) };
        let weights =
            |dialog: rfd::AsyncFileDialog| dialog.add_filter("Network parameters", &["safetensors"]);
        let answer: Pin<Box<dyn Future<Output = _>>> = match field {
            Field::ModelIn => Box::pin(weights(dialog).pick_file()),
            Field::ModelOut => Box::pin(weights(dialog).set_file_name("world_model.safetensors").save_file()),
            _ => Box::pin(dialog.pick_folder()),
        };
        Self { field, answer, waker: Arc::new(Repaint(ctx.clone())).into() }
    }

    /// What was chosen, once something was; nothing inside where it was closed.
    pub(super) fn poll(&mut self) -> Option<Option<PathBuf>> {
        match self.answer.as_mut().poll(&mut TaskContext::from_waker(&self.waker)) {
            Poll::Ready(chosen) => Some(chosen.map(|file| file.path().to_owned())),
            Poll::Pending => None,
        }
    }
}
