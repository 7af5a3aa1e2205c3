//! What the footer of an episode file says of the episode, and which columns the file has.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::layout::column;
use super::stats::Stats;
use super::{EpisodeInfo, Layout, disk};
use crate::world::Size;

/// The format of the notes. Those of 1 knew neither a state nor why an episode ended, those of 2 no world but the built-in ones.
pub(super) const FORMAT: u32 = 3;
/// The column of actions.
pub(super) const ACTION: &str = "action";
/// The column of the world's own rewards.
pub(super) const REWARD: &str = "next.reward";
/// The column that tells whether the world ended the episode.
pub(super) const DONE: &str = "next.done";
/// The column of frames.
pub(super) const IMAGE: &str = "observation.image";
/// The column of what was measured, in worlds where something is.
pub(super) const STATE: &str = "observation.state";
/// The columns that tell the two ends apart that a world gives an episode.
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
    /// Rows of its pictures.
    #[serde(default)]
    pub(super) height: u32,
    /// Pixels of a row.
    #[serde(default)]
    pub(super) width: u32,
    /// Pixels a side, where an older version wrote it. Not to be asked: it is in the other two.
    #[serde(default, skip_serializing)]
    pub(super) side: u32,
    /// Whether the world ended it.
    pub(super) done: bool,
    /// Whether it did so from outside.
    #[serde(default)]
    pub(super) truncated: bool,
    /// What the numbers of an action are called.
    #[serde(default)]
    pub(super) axes: Vec<String>,
    /// What can go on after a step.
    #[serde(default)]
    pub(super) events: Vec<String>,
    /// Steps a second.
    #[serde(default)]
    pub(super) rate: f64,
    /// The names of what was measured.
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
        Columns { layout: self.layout(), ends: self.stats.contains_key(TRUNCATED) }
    }

    /// What its steps have.
    pub(super) fn layout(&self) -> Layout {
        Layout {
            axes: self.axes.clone(),
            events: self.events.clone(),
            sensors: self.state.clone(),
            rate: self.rate,
        }
    }

    /// The size of its pictures.
    pub(super) fn size(&self) -> Size {
        Size { height: self.height, width: self.width }
    }

    /// Whether it has this place in the dataset, in its name and in its columns.
    pub(super) fn is_at(&self, dir: &Path, number: usize, first_index: usize) -> bool {
        (self.number, self.first_index) == (number, first_index)
            && self.path == disk::episode_path(dir, number)
    }
}

/// Which columns a dataset has. All episodes of one have the same.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Columns {
    /// What the steps have.
    pub(super) layout: Layout,
    /// Whether it is told why episodes ended. Before format 2 it was not.
    pub(super) ends: bool,
}

impl Columns {
    /// The names of those that every dataset has.
    const ALWAYS: [&str; 10] = [
        IMAGE,
        ACTION,
        REWARD,
        DONE,
        "wall_time_ns",
        "timestamp",
        "frame_index",
        "episode_index",
        "index",
        "task_index",
    ];

    /// The names of all columns.
    pub(super) fn names(&self) -> Vec<String> {
        let mut names = Self::ALWAYS.map(str::to_owned).to_vec();
        if !self.layout.sensors.is_empty() {
            names.push(STATE.to_owned());
        }
        if self.ends {
            names.extend([TERMINATED, TRUNCATED].map(str::to_owned));
        }
        names.extend(self.layout.events.iter().map(|event| column(event)));
        names
    }
}
