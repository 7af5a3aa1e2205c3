//! What the application wants done outside itself.

use std::path::PathBuf;

use crate::app::panel::Purpose;
use crate::worker::WorkerCommand;

/// Something that whoever runs the application carries out: the window, or a script without one.
#[derive(Debug)]
#[expect(clippy::large_enum_variant, reason = "nearly all of them are for workers")]
pub enum Effect {
    /// A worker is told something.
    Worker(WorkerCommand),
    /// The system's dialog opens, at this path if that is given; a
    /// [`WindowCommand::Chosen`](crate::app::WindowCommand::Chosen) answers it.
    OpenDialog(Purpose, String),
    /// All that is held on keys and pads is let go: another thing is driven now.
    ReleaseControls,
    /// The program ends, and begins anew with the world in this file.
    OpenWorld(PathBuf),
    /// The window stays open, for something would be lost with it.
    KeepOpen,
}
