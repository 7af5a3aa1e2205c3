//! What a person or a script can ask of the application: one enum a room, and all of them in one.

use std::path::PathBuf;

use crate::app::deploy::DeployCommand;
use crate::app::dream::DreamCommand;
use crate::app::evaluate::EvaluateCommand;
use crate::app::guide::GuideCommand;
use crate::app::label::LabelCommand;
use crate::app::panel::{Field, Panel, Purpose};
use crate::app::record::RecordCommand;
use crate::app::reward::RewardCommand;
use crate::app::session::SessionCommand;
use crate::app::world_model::WorldModelCommand;

/// One thing to do.
#[derive(Clone, Debug, PartialEq)]
pub enum Command {
    /// On what is shown at all.
    Window(WindowCommand),
    /// On recording, and on recorded episodes.
    Record(RecordCommand),
    /// On the world model.
    WorldModel(WorldModelCommand),
    /// On dreams.
    Dream(DreamCommand),
    /// On the kept dream, the recorded episode or the driven one that is looked at.
    Playback(PlaybackCommand),
    /// On queries and their answers.
    Label(LabelCommand),
    /// On the reward.
    Reward(RewardCommand),
    /// On the world that the planner acts in.
    Deploy(DeployCommand),
    /// On runs that are set side by side.
    Evaluate(EvaluateCommand),
    /// On sessions and their files.
    Session(SessionCommand),
    /// On the first hour.
    Guide(GuideCommand),
}

/// On what is shown at all.
#[derive(Clone, Debug, PartialEq)]
pub enum WindowCommand {
    /// Goes to a panel.
    Show(Panel),
    /// Puts text into a field.
    Edit(Field, String),
    /// Asks the system's dialog for a field.
    Browse(Field),
    /// Asks the system's dialog for something to take in at once.
    Import(Purpose),
    /// The system's dialog has given these paths, or says in a sentence why there was none.
    Chosen(Purpose, Result<Vec<PathBuf>, String>),
    /// Something was dropped on the window.
    Drop(PathBuf),
    /// Opens or closes the list of keys.
    ToggleHelp,
    /// Takes a message away.
    Dismiss(u64),
    /// Says something that passes.
    Note(String),
    /// Says something that should be read.
    Warn(String),
    /// Says what went wrong.
    Fail(String),
    /// Saves what is seen on the panel as a GIF.
    SaveClip,
    /// Starts all workers anew and tells them all that is in the session.
    Restart,
    /// Gives the controls to the planner, or takes them back: in a dream, or in the real world.
    HandOver,
    /// Pauses what a person drives, and says why.
    PauseDriving(&'static str),
    /// Somebody wants to close the window.
    Close,
}

/// On the kept dream, the recorded episode or the driven one that is looked at.
#[derive(Clone, Debug, PartialEq)]
pub enum PlaybackCommand {
    /// Looks at the one after this, or so many before.
    Next(i32),
    /// Goes to a step of it.
    Scrub(usize),
    /// Plays it, or stops.
    Play,
}
