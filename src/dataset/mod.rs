//! Recorded episodes on disk: journaled while they are driven, sealed when they end, read one at a time.
//!
//! The folder is a `LeRobotDataset` v3.0, which `LeRobot` and Rerun open:
//!
//! ```text
//! data/chunk-000/file-000.parquet   one sealed file per episode: chunk = number / 1000, file = number % 1000
//! README.md                         a card for the Hugging Face Hub, until somebody changes it
//! .gitignore                        the folders below, which no upload takes along
//! meta/                             info.json, stats.json, tasks.parquet, episodes/chunk-000/file-000.parquet
//! journal/                          episodes that are being driven, or were when the program was killed
//! deleted/                          the episode that was deleted last, which can be brought back
//! damaged/                          files that turned out to be damaged, out of everybody's way
//! ```
//!
//! A row of `data` is a step: `observation.image` (a PNG, the frame *before* the action), `observation.state` (what was
//! measured then), `action` (a number for each axis, as the world took them), `next.reward`, `next.done` (the world ended
//! the episode), `next.terminated` and `next.truncated` (by what happened in it, or from outside), for each event a column
//! such as `next.new_tile` (whether it goes on), `timestamp` (seconds, the step's index over the rate), `wall_time_ns`
//! (nanoseconds since 1970 when the action was taken) and `LeRobot`'s indices.
//! An episode of n steps has n + 1 frames, each stored once: the frame after the last action is no step and gets no
//! row. It stands in the footer of the file, under the key `dropj.last_frame`, as a PNG in hexadecimal.
//! `assets/format-datasets.md` tells all of it.
//!
//! The files of `data` say all there is to say. `meta` is derived from them and made to agree whenever the dataset is opened
//! for recording. A folder that is neither ours nor empty is not written to.

mod card;
mod damage;
mod disk;
mod error;
mod folder;
mod foreign;
mod found;
mod hex;
mod index;
mod journal;
mod layout;
mod legacy;
pub mod lerobot;
mod limits;
mod meta;
mod notes;
mod ownership;
mod parquet_check;
mod png;
mod sealed;
mod stats;
mod table;
#[cfg(test)]
mod tests;

use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

pub use damage::{Damage, FrameError, OutOfLimits, Stranger, TableError, Unfit, Useless};
pub use error::DatasetError;
pub use folder::Dataset;
pub use index::Summary;
pub use journal::Recording;
pub use layout::Layout;
pub use png::encode as png_bytes;
pub use table::{TableColumn, order_as_types_do, table_bytes};

use crate::world::{Action, Frame};

/// Who drove where.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct EpisodeInfo {
    /// The world's name.
    pub env: String,
    /// The driver's name: a person's or a scripted pilot's.
    pub pilot: String,
    /// What the world was reset with.
    pub seed: u64,
}

/// A step as it is recorded.
#[derive(Clone, Debug, PartialEq)]
pub struct StepRecord {
    /// What was seen before the action.
    pub frame: Frame,
    /// What was done.
    pub action: Action,
    /// The world's own reward for it, which the method never sees.
    pub reward: f32,
    /// Which events go on after it, in the order of [`Layout::events`].
    pub events: Vec<bool>,
    /// When the action was taken, in nanoseconds since 1970.
    pub wall_time_ns: i64,
    /// What was measured before the action, in the order of [`Layout::sensors`].
    pub state: Vec<f32>,
}

/// An episode as it was recorded: n steps.
#[derive(Clone, Debug, PartialEq)]
pub struct Episode {
    /// Its number in the dataset.
    pub number: usize,
    /// Who drove where.
    pub info: EpisodeInfo,
    /// The frame before each action and the one after the last: n + 1.
    ///
    /// The one after the last is missing (n frames) where the program was killed before it was recorded.
    pub frames: Vec<Frame>,
    /// The action of each step: n.
    pub actions: Vec<Action>,
    /// The world's own reward for each: n.
    pub rewards: Vec<f32>,
    /// What its steps have.
    pub layout: Layout,
    /// Which events go on after each, in the order of [`Layout::events`]: n.
    pub events: Vec<Vec<bool>>,
    /// When each action was taken, in nanoseconds since 1970: n.
    pub wall_times_ns: Vec<i64>,
    /// What was measured before each action, in the order of [`Layout::sensors`]: n.
    pub states: Vec<Vec<f32>>,
    /// Whether the world ended it, and not the driver or a crash of the program.
    pub done: bool,
    /// Whether the world ended it from outside, as by its longest time, and for nothing that happened.
    pub truncated: bool,
    /// The steps that the planner drove, and not whoever is named as the pilot.
    pub planned: Vec<Range<usize>>,
}

impl Episode {
    /// After which steps the event of this name goes on, where there is such an event.
    pub fn event(&self, name: &str) -> Option<Vec<bool>> {
        let event = self.layout.event(name)?;
        Some(self.events.iter().map(|events| events[event]).collect())
    }
}

/// An episode that was being driven when the program stopped.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unfinished {
    /// Its journal.
    pub path: PathBuf,
    /// Who drove where.
    pub info: EpisodeInfo,
    /// How many whole steps the journal holds.
    pub n_steps: usize,
}

/// Reads an episode from the bytes of its file, which may be anything.
pub fn read_episode(bytes: Vec<u8>) -> Result<Episode, DatasetError> {
    sealed::parse(bytes, Path::new("")).and_then(sealed::episode)
}

/// Who drove where, and how many whole steps there are, in the bytes of a journal, which may be anything.
pub fn read_journal(bytes: &[u8]) -> Option<(EpisodeInfo, usize)> {
    journal::parse(bytes, String::new()).map(|(take, _)| (take.info, take.rows.len()))
}
