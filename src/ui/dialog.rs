//! The system's dialogs, which may take as long as a person wants while the window goes on.

#[cfg(target_os = "linux")]
use std::ffi::OsString;
use std::future::Future;
use std::path::PathBuf;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context as TaskContext, Poll, Wake, Waker};
use std::time::{Duration, Instant};

use eframe::egui::Context;
use rfd::{AsyncFileDialog, FileHandle};

use crate::app::{Field, Purpose};
use crate::experiment::side_by_side::Part;

/// A dialog that is open.
pub(super) struct Dialog {
    /// What its answer is for.
    pub purpose: Purpose,
    answer: Pin<Box<dyn Future<Output = Vec<FileHandle>>>>,
    waker: Waker,
    since: Instant,
}

/// Nobody closes a dialog in less, for it is hardly on the screen by then.
const QUICKEST: Duration = Duration::from_millis(300);

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
        let dialog = match purpose {
            Purpose::Save(part) if part != Part::All => dialog.set_file_name(at),
            _ if at.is_empty() => dialog,
            _ => dialog.set_directory(at),
        };
        let weights = |dialog: AsyncFileDialog| dialog.add_filter("Network parameters", &["safetensors"]);
        let answer: Pin<Box<dyn Future<Output = Vec<FileHandle>>>> = match purpose {
            Purpose::Field(Field::ModelIn) | Purpose::World => one(weights(dialog).pick_file()),
            Purpose::Field(Field::ModelOut) => {
                one(weights(dialog).set_file_name("world_model.safetensors").save_file())
            }
            // What it begins at is a name here: it is a new file.
            Purpose::Clip => {
                one(AsyncFileDialog::new().add_filter("GIF", &["gif"]).set_file_name(at).save_file())
            }
            Purpose::Env => one(dialog.add_filter("Worlds", &["toml"]).pick_file()),
            Purpose::Merge => {
                let picked = dialog.set_title("Folders of sessions").pick_folders();
                Box::pin(async { picked.await.unwrap_or_default() })
            }
            Purpose::ResultsFile => {
                let dialog = dialog.set_title("Files of results");
                let picked = dialog.add_filter("Results", &["json", "jsonl", "ndjson"]).pick_files();
                Box::pin(async { picked.await.unwrap_or_default() })
            }
            Purpose::Save(Part::Table) => one(dialog.add_filter("Table", &["csv"]).save_file()),
            Purpose::Save(Part::Distribution | Part::Curves | Part::Losses) => {
                let dialog = dialog.add_filter("Vectors", &["svg"]).add_filter("Pixels", &["png"]);
                one(dialog.save_file())
            }
            _ => one(dialog.pick_folder()),
        };
        Self { purpose, answer, waker: Arc::new(Repaint(ctx.clone())).into(), since: Instant::now() }
    }

    /// What was chosen, once something was; nothing inside where it was closed, and a sentence where there was none.
    pub(super) fn poll(&mut self) -> Option<Result<Vec<PathBuf>, String>> {
        let Poll::Ready(chosen) = self.answer.as_mut().poll(&mut TaskContext::from_waker(&self.waker)) else {
            return None;
        };
        let chosen: Vec<_> = chosen.iter().map(|file| file.path().to_owned()).collect();
        if chosen.is_empty() && !was_shown(self.since.elapsed(), can_show()) {
            return Some(Err(no_dialog(self.purpose)));
        }
        Some(Ok(chosen))
    }
}

/// Whether a dialog that gave nothing was there at all, which the system does not say: one that nobody `can_show` was
/// not, nor one that was gone at once.
fn was_shown(elapsed: Duration, can_show: bool) -> bool {
    can_show && elapsed >= QUICKEST
}

/// Whether something is installed that shows dialogs.
#[cfg(target_os = "linux")]
fn can_show() -> bool {
    let named = |name| std::env::var_os(name).filter(|value| !value.is_empty());
    let paths = |list: Option<OsString>, otherwise: &str| -> Vec<PathBuf> {
        std::env::split_paths(&list.unwrap_or_else(|| otherwise.into())).collect()
    };
    let runtime_dir = named("XDG_RUNTIME_DIR").map(PathBuf::from);
    let has_bus = named("DBUS_SESSION_BUS_ADDRESS").is_some()
        || runtime_dir.is_some_and(|dir| dir.join("bus").exists());
    let services = paths(named("XDG_DATA_DIRS"), "/usr/local/share:/usr/share");
    let home = named("HOME").map(|home| PathBuf::from(home).join(".local/share"));
    let has_portal =
        services.into_iter().chain(home).any(|dir| dir.join("dbus-1/services").join(PORTAL).exists());
    let has_zenity = paths(named("PATH"), "/usr/bin").into_iter().any(|dir| dir.join("zenity").exists());
    has_bus && has_portal || has_zenity
}

/// The file by which the portal is started.
#[cfg(target_os = "linux")]
const PORTAL: &str = "org.freedesktop.portal.Desktop.service";

/// Elsewhere the system shows them itself.
#[cfg(not(target_os = "linux"))]
fn can_show() -> bool {
    true
}

/// What to do where no dialog can be shown.
fn no_dialog(purpose: Purpose) -> String {
    let instead = match purpose {
        Purpose::Field(_) => "or type the path into the field",
        Purpose::World => "or type the path of the file under World model",
        Purpose::Recordings | Purpose::Merge => "or drop the folder on this window",
        Purpose::Clip => "and it is put beside the sessions",
        Purpose::Results | Purpose::ResultsFile => "or drop it on this window, or type its path below",
        Purpose::Save(_) => "or name a folder below and save everything there",
        Purpose::Env => "or drop the file on this window, or name it by --env",
    };
    format!(
        "no dialog for files could be shown here: install xdg-desktop-portal with a backend (such as \
         xdg-desktop-portal-gtk) or zenity, {instead}"
    )
}

fn one(
    picked: impl Future<Output = Option<FileHandle>> + 'static,
) -> Pin<Box<dyn Future<Output = Vec<FileHandle>>>> {
    Box::pin(async { picked.await.into_iter().collect() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dialog_that_is_gone_at_once_or_that_nobody_can_show_was_none() {
        let (at_once, later) = (Duration::from_millis(20), Duration::from_secs(3));
        assert!(was_shown(later, true), "somebody has closed it");
        assert!(!was_shown(at_once, true) && !was_shown(at_once, false));
        assert!(!was_shown(later, false), "a system that waits for a service that never comes");
    }

    #[test]
    fn whoever_has_no_dialogs_is_told_what_to_install_and_what_to_do_without() {
        for (purpose, instead) in [
            (Purpose::Field(Field::Dataset), "type the path into the field"),
            (Purpose::World, "type the path of the file"),
            (Purpose::Merge, "drop the folder"),
        ] {
            let said = no_dialog(purpose);
            assert!(said.contains("xdg-desktop-portal") && said.contains("zenity"), "{said}");
            assert!(said.contains(instead), "{said}");
        }
    }

    #[test]
    fn a_dialog_that_gives_nothing_at_once_says_that_there_is_none() {
        let mut dialog = Dialog {
            purpose: Purpose::World,
            answer: Box::pin(std::future::ready(Vec::new())),
            waker: Waker::noop().clone(),
            since: Instant::now(),
        };
        assert!(dialog.poll().is_some_and(|answer| answer.is_err()));
    }
}
