//! The system's dialogs, which may take as long as a person wants while the window goes on.

use std::future::Future;
use std::path::PathBuf;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context as TaskContext, Poll, Wake, Waker};

use eframe::egui::Context;
use rfd::{AsyncFileDialog, FileHandle};

use crate::ui::command::Field;

/// What a file or folder is chosen for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// To stand in a field.
    Field(Field),
    /// A world model to load.
    World,
    /// A folder of recordings to use.
    Recordings,
    /// Sessions to put together with others.
    Several,
}

/// A dialog that is open.
pub(super) struct Dialog {
    /// What its answer is for.
    pub purpose: Purpose,
    answer: Pin<Box<dyn Future<Output = Vec<FileHandle>>>>,
    waker: Waker,
}

struct Repaint(Context);

impl Wake for Repaint {
    fn wake(self: Arc<Self>) {
        self.0.request_repaint();
    }
}

impl Dialog {
    /// Asks for what `purpose` needs, beginning at the path `at`, if there is one.
    pub(super) fn open(ctx: &Context, purpose: Purpose, at: &str) -> Self {
        let dialog = AsyncFileDialog::new();
        let dialog = if at.is_empty() { dialog } else { dialog.set_directory(at) };
        let weights = |dialog: AsyncFileDialog| dialog.add_filter("Network parameters", &["safetensors"]);
        let answer: Pin<Box<dyn Future<Output = Vec<FileHandle>>>> = match purpose {
            Purpose::Field(Field::ModelIn) | Purpose::World => one(weights(dialog).pick_file()),
            Purpose::Field(Field::ModelOut) => {
                one(weights(dialog).set_file_name("world_model.safetensors").save_file())
            }
            Purpose::Several => {
                let picked = dialog.set_title("Folders of sessions").pick_folders();
                Box::pin(async { picked.await.unwrap_or_default() })
            }
            _ => one(dialog.pick_folder()),
        };
        Self { purpose, answer, waker: Arc::new(Repaint(ctx.clone())).into() }
    }

    /// What was chosen, once something was; nothing inside where it was closed.
    pub(super) fn poll(&mut self) -> Option<Vec<PathBuf>> {
        match self.answer.as_mut().poll(&mut TaskContext::from_waker(&self.waker)) {
            Poll::Ready(chosen) => Some(chosen.iter().map(|file| file.path().to_owned()).collect()),
            Poll::Pending => None,
        }
    }
}

fn one(
    picked: impl Future<Output = Option<FileHandle>> + 'static,
) -> Pin<Box<dyn Future<Output = Vec<FileHandle>>>> {
    Box::pin(async { picked.await.into_iter().collect() })
}
