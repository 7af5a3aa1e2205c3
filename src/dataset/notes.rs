//! What the footer of an episode file says of the episode, and which columns the file has.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::stats::Stats;
use super::{EpisodeInfo, disk};

/// The format of the notes. Those of 1 knew neither the car's state nor why an episode ended.
pub(super) const FORMAT: u32 = 2;
/// The column of actions.
pub(super) const ACTION: &str = "action";
/// The columns that only worlds with obstacles have.
pub(super) const CHUCKHOLE: &str = "next.chuckhole";
pub(super) const CAR: &str = "next.car";
/// The column of frames.
pub(super) const IMAGE: &str = "observation.image";
/// The column of what the car measured, in worlds where it measures something.
pub(super) const STATE: &str = "observation.state";
/// The columns that tell the two ends apart that an environment gives an episode.
pub(super) const TERMINATED: &str = "next.terminated";
pub(super) const TRUNCATED: &str = "next.truncated";

/// What the footer of an episode file says.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Notes {
    pub(super) format: u32,
    /// The version that recorded it.
    pub(super) app: String,
    /// Who drove where.
    #[serde(flatten)]
    pub(super) info: EpisodeInfo,
    /// The journal that it was sealed from.
    pub(super) recording: String,
    /// Its number in the dataset.
    pub(super) number: usize,
    /// How many steps the episodes before it have.
    pub(super) first_index: usize,
    /// How many steps it has.
    pub(super) n_steps: usize,
    /// Pixels a side.
    pub(super) side: u32,
    /// Whether the environment ended it.
    pub(super) done: bool,
    /// Whether it did so because the time was up.
    #[serde(default)]
    pub(super) truncated: bool,
    /// The names of what the car measured.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) state: Vec<String>,
    /// The steps that the planner drove, from the first to before the last of each stretch.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) planned: Vec<[usize; 2]>,
    /// The statistics of each column.
    pub(super) stats: BTreeMap<String, Stats>,
    /// The file that says so.
    #[serde(skip)]
    pub(super) path: PathBuf,
}

impl Notes {
    /// Which columns it has.
    pub(super) fn columns(&self) -> Columns {
        Columns {
            state: self.state.clone(),
            ends: self.stats.contains_key(TRUNCATED),
            obstacles: self.stats.contains_key(CHUCKHOLE) || self.stats.contains_key(CAR),
        }
    }

    /// Whether it has this place in the dataset, in its name and in its columns.
    pub(super) fn is_at(&self, dir: &Path, number: usize, first_index: usize) -> bool {
        (self.number, self.first_index) == (number, first_index)
            && self.path == disk::episode_path(dir, number)
    }
}

/// The columns that not every dataset has. All episodes of one have the same.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Columns {
    /// The names of what the car measured; none, no column.
    pub(super) state: Vec<String>,
    /// Whether it is told why episodes ended. Before format 2 it was not.
    pub(super) ends: bool,
    /// Whether contacts with obstacles were recorded.
    pub(super) obstacles: bool,
}

impl Columns {
    /// The names of all columns.
    pub(super) fn names(&self) -> Vec<&'static str> {
        let mut names = vec![
            IMAGE,
            ACTION,
            "next.reward",
            "next.done",
            "next.grass",
            "wall_time_ns",
            "timestamp",
            "frame_index",
            "episode_index",
            "index",
            "task_index",
        ];
        let optional = [
            (!self.state.is_empty(), [STATE].as_slice()),
            (self.ends, &[TERMINATED, TRUNCATED]),
            (self.obstacles, &[CHUCKHOLE, CAR]),
        ];
        names.extend(optional.into_iter().filter(|(is_there, _)| *is_there).flat_map(|(_, names)| names));
        names
    }
}
