//! Datasets of others, seen as recordings of a world: its file says which camera, which action and what is an event.

use std::path::Path;
use std::sync::Arc;

use sha2::{Digest as _, Sha256};

use super::found::Found;
use super::hex::to_hex;
use super::index::Summary;
use super::lerobot::{LeRobotDataset, View};
use super::{Dataset, DatasetError, Episode, EpisodeInfo, Layout};
use crate::world::{Action, WorldSpec};

/// The name of whoever recorded it.
const PILOT: &str = "recorded";
/// The column of the world's own reward.
const REWARD: &str = "next.reward";

/// A dataset of others, as recordings of a world.
#[derive(Debug)]
pub(super) struct Foreign {
    dataset: LeRobotDataset,
    view: View,
    spec: Arc<WorldSpec>,
    info: EpisodeInfo,
}

impl Foreign {
    fn open(dir: &Path, spec: &Arc<WorldSpec>) -> Result<Self, DatasetError> {
        let dataset = LeRobotDataset::open(dir)?;
        let source = &spec.source;
        let view = View { cameras: source.cameras.clone(), action: source.action.clone() };
        // What cannot be found is said before anything is read.
        dataset.frame_size(&view)?;
        let n = dataset.action(view.action.as_deref())?.components.len();
        if n != spec.axes.len() {
            let (found, wanted) = (format!("{n} numbers"), format!("{}", spec.axes.len()));
            return Err(DatasetError::OtherWorld {
                found,
                wanted,
                world: spec.name.clone(),
                path: dir.to_owned(),
            });
        }
        let info = EpisodeInfo { env: spec.name.clone(), pilot: PILOT.to_owned(), seed: 0 };
        Ok(Self { dataset, view, spec: Arc::clone(spec), info })
    }

    pub(super) fn n_episodes(&self) -> usize {
        self.dataset.n_episodes()
    }

    pub(super) fn len(&self, idx: usize) -> usize {
        self.dataset.len(idx)
    }

    pub(super) fn info(&self) -> &EpisodeInfo {
        &self.info
    }

    pub(super) fn spec(&self) -> &WorldSpec {
        &self.spec
    }

    /// Its rate, and names as the world's file has them.
    pub(super) fn layout(&self) -> Layout {
        Layout { rate: self.dataset.fps(), ..Layout::of(&self.spec, &[]) }
    }

    /// What tells these episodes from any others.
    pub(super) fn fingerprint(&self) -> String {
        let mut hasher = Sha256::new();
        for idx in 0..self.n_episodes() {
            hasher.update(format!("{} {}\n", self.dataset.number(idx), self.len(idx)));
        }
        to_hex(&hasher.finalize())
    }

    fn recording(&self, idx: usize) -> String {
        format!("episode-{}", self.dataset.number(idx))
    }

    pub(super) fn find(&self, recording: &str) -> Option<usize> {
        (0..self.n_episodes()).find(|idx| self.recording(*idx) == recording)
    }

    /// What is known of an episode. Shares of events would have to be read, and are not told.
    pub(super) fn summary(&self, idx: usize) -> Summary {
        Summary {
            recording: self.recording(idx),
            number: idx,
            info: self.info.clone(),
            n_steps: self.len(idx),
            n_planned: 0,
            events: Vec::new(),
            done: true,
            began_secs: 0,
        }
    }

    /// An episode, its actions moved into the ranges of the world's axes.
    pub(super) fn episode(&self, idx: usize) -> Result<Episode, DatasetError> {
        let raw = self.dataset.framed_episode(idx, &self.view, &self.spec.image)?;
        let n = raw.actions.len();
        let happened = raw.happened(&self.spec.events);
        let clamped =
            |action: &Vec<f32>| Action::new(action).map(|i, value| self.spec.axes[i].clamped(value));
        let rewards = raw.scalars.get(REWARD).cloned().unwrap_or_else(|| vec![0.0; n]);
        Ok(Episode {
            number: idx,
            info: self.info.clone(),
            actions: raw.actions.iter().map(clamped).collect(),
            rewards: rewards
                .into_iter()
                .map(|reward| if reward.is_finite() { reward } else { 0.0 })
                .collect(),
            layout: self.layout(),
            events: happened.iter().map(|row| row.iter().map(|event| event.goes_on).collect()).collect(),
            frames: raw.frames,
            wall_times_ns: vec![0; n],
            states: vec![Vec::new(); n],
            done: true,
            truncated: false,
            planned: Vec::new(),
        })
    }
}

impl Dataset {
    /// Opens recordings of the world `spec` for reading: ours, or a `LeRobotDataset` of others. Changes nothing on disk.
    ///
    /// # Errors
    /// Where there is neither, and where they do not fit the world.
    pub fn open_as(dir: &Path, spec: &Arc<WorldSpec>) -> Result<Self, DatasetError> {
        // Where nothing of ours is there, or it was edited by the tools of others, which leave our notes out.
        if !LeRobotDataset::is_at(dir) || !Found::read(dir)?.episodes.is_empty() {
            return Self::open(dir);
        }
        let foreign = Foreign::open(dir, spec)?;
        let mut dataset = Self::of(dir, Vec::new());
        dataset.env = Some(spec.name.clone());
        dataset.foreign = Some(foreign);
        Ok(dataset)
    }
}
