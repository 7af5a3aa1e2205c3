//! Recorded episodes on disk: journaled while they are driven, sealed when they end, read one at a time.
//!
//! The folder is a `LeRobotDataset` v3.0, which `LeRobot` and Rerun open:
//!
//! ```text
//! data/chunk-000/file-000.parquet   one sealed file per episode: chunk = number / 1000, file = number % 1000
//! meta/                             info.json, stats.json, tasks.parquet, episodes/chunk-000/file-000.parquet
//! journal/                          episodes that are being driven, or were when the program was killed
//! deleted/                          the episode that was deleted last, which can be brought back
//! damaged/                          files that turned out to be damaged, out of everybody's way
//! ```
//!
//! A row of `data` is a step: `observation.image` (a PNG, the frame *before* the action), `observation.state` (what the
//! car measured then), `action` (steer, gas and brake as the environment took them), `next.reward`, `next.done` (the
//! environment ended the episode), `next.terminated` and `next.truncated` (because the car had left the field, or because
//! the time was up), `next.grass`, `timestamp` (seconds, the step's index over 50), `wall_time_ns` (nanoseconds since 1970
//! when the action was taken) and `LeRobot`'s indices.
//! Worlds with obstacles add `next.chuckhole` (a wheel is in one) and `next.car` (the hull touches another's).
//! An episode of n steps has n + 1 frames, each stored once: the frame after the last action is no step and gets no
//! row. It stands in the footer of the file, under the key `dropj.last_frame`, as a PNG in hexadecimal.
//! `assets/format-datasets.md` tells all of it.
//!
//! The files of `data` say all there is to say. `meta` is derived from them and made to agree whenever the dataset is opened
//! for recording. A folder that is neither ours nor empty is not written to.

mod damage;
mod disk;
mod error;
mod folder;
mod found;
mod hex;
mod index;
mod journal;
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

use crate::env::{Action, Contacts, Frame};

/// Who drove where.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct EpisodeInfo {
    /// The environment's name.
    pub env: String,
    /// The driver's name: a person's or a scripted pilot's.
    pub pilot: String,
    /// What the environment was reset with.
    pub seed: u64,
}

/// A step as it is recorded.
#[derive(Clone, Debug, PartialEq)]
pub struct StepRecord {
    /// What was seen before the action.
    pub frame: Frame,
    /// What was done.
    pub action: Action,
    /// The environment's reward for it, which the method never sees.
    pub reward: f32,
    /// Whether the car was on the grass after it.
    pub grass: bool,
    /// What the car touched after it, in a world with obstacles.
    pub contacts: Option<Contacts>,
    /// When the action was taken, in nanoseconds since 1970.
    pub wall_time_ns: i64,
    /// What the car measured before the action, as many numbers as [`Dataset::begin_with`] was given names.
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
    /// The environment's reward for each: n.
    pub rewards: Vec<f32>,
    /// Whether the car was on the grass after each: n.
    pub grass: Vec<bool>,
    /// What the car touched after each: n, or none in a world without obstacles.
    pub contacts: Vec<Contacts>,
    /// When each action was taken, in nanoseconds since 1970: n.
    pub wall_times_ns: Vec<i64>,
    /// The names of what the car measured. None in a world where it measures nothing, and before that was recorded.
    pub state_names: Vec<String>,
    /// What the car measured before each action: n, each as long as its names.
    pub states: Vec<Vec<f32>>,
    /// Whether the environment ended it, and not the driver or a crash of the program.
    pub done: bool,
    /// Whether the environment ended it because the time was up, and for nothing that happened.
    pub truncated: bool,
    /// The steps that the planner drove, and not whoever is named as the pilot.
    pub planned: Vec<Range<usize>>,
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
