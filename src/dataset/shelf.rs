//! What is known of a dataset's episodes without reading them, and taking episodes out of it.
//!
//! `LeRobot` finds an episode by its place, so that numbers and steps have to count on without a gap. Deleting therefore
//! moves the file away in one step, and then every later episode one place down, one file at a time:
//!
//! ```text
//! journal/renumbering            there as long as this lasts
//! deleted/<recording>.parquet    the episode that was deleted last, as it was
//! ```
//!
//! Whenever the program is killed, opening the dataset for recording finishes what was begun. An episode that is brought
//! back comes after all others.

use std::fs;
use std::path::{Path, PathBuf};

use super::sealed::{self, Notes, Sealed};
use super::{Dataset, DatasetError, EpisodeInfo, disk, meta};
use crate::run::sync_folder;

/// Where the episode that was deleted last stays.
const DELETED: &str = "deleted";
/// What lies in `journal` while episodes change their places.
const RENUMBERING: &str = "renumbering";

/// What is known of a sealed episode without reading it.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// What it was recorded as: unlike its number this never changes.
    pub recording: String,
    /// Its number in the dataset.
    pub number: usize,
    /// Who drove where.
    pub info: EpisodeInfo,
    /// How many steps it has.
    pub n_steps: usize,
    /// How many of them the planner drove.
    pub n_planned: usize,
    /// The share of its steps on the grass, in `[0, 1]`.
    pub grass: f64,
    /// Whether the environment ended it.
    pub done: bool,
    /// When its first action was taken, in seconds since 1970.
    pub began_secs: i64,
}

impl Summary {
    fn of(notes: &Notes) -> Self {
        let stats = |column: &str| notes.stats.get(column);
        let began_ns = stats("wall_time_ns").map_or(0.0, |stats| stats.min[0]);
        Self {
            recording: notes.recording.clone(),
            number: notes.number,
            info: notes.info.clone(),
            n_steps: notes.n_steps,
            n_planned: notes.planned.iter().map(|[from, to]| to - from).sum(),
            grass: stats("next.grass").map_or(0.0, |stats| stats.mean[0]),
            done: notes.done,
            began_secs: (began_ns / 1e9) as i64,
        }
    }
}

impl Dataset {
    /// What is known of the episodes, in the order of their numbers.
    pub fn summaries(&self) -> impl Iterator<Item = Summary> + '_ {
        self.episodes.iter().map(Summary::of)
    }

    /// The place of an episode by what it was recorded as.
    pub fn find(&self, recording: &str) -> Option<usize> {
        self.episodes.iter().position(|notes| notes.recording == recording)
    }

    /// The episode that was deleted last, if it can be brought back.
    pub fn deleted(&self) -> Option<Summary> {
        deleted(&self.dir)
            .map(|(_, notes)| Summary::of(&notes))
            .filter(|it| self.find(&it.recording).is_none())
    }

    /// Whether a program was killed while it deleted something here; opening it for recording repairs that.
    pub fn is_torn(dir: &Path) -> bool {
        renumbering(dir).exists()
    }

    /// Takes the episode at `idx` out of the dataset. It can be [brought back](Self::bring_back) until another is deleted.
    ///
    /// After an error opening the dataset anew shows whether it is still there, and finishes what was begun.
    pub fn delete(&mut self, idx: usize) -> Result<(), DatasetError> {
        self.require_lock()?;
        let (number, recording) = (self.episodes[idx].number, self.episodes[idx].recording.clone());
        let from = disk::episode_path(&self.dir, number);
        let to = self.dir.join(DELETED).join(format!("{recording}.parquet"));
        disk::make_folder(&self.dir.join(DELETED))?;
        for old in disk::list(&self.dir.join(DELETED))? {
            remove(&old)?;
        }
        disk::replace(&renumbering(&self.dir), b"")?;
        // From here on it is deleted.
        fs::rename(&from, &to).map_err(DatasetError::disk("move the episode away", &from))?;
        for path in [&from, &to] {
            sync_folder(path).map_err(DatasetError::disk("move the episode away", path))?;
        }
        self.episodes.remove(idx);
        self.close_gaps()
    }

    /// Puts the episode `recording` after all others, if it is the one that was deleted last, and returns its number there.
    pub fn bring_back(&mut self, recording: &str) -> Result<usize, DatasetError> {
        self.require_lock()?;
        let is_wanted = |it: &Notes| it.recording == recording && self.find(recording).is_none();
        let Some((path, notes)) = deleted(&self.dir).filter(|(_, it)| is_wanted(it)) else {
            return Err(DatasetError::NothingDeleted { path: self.dir.clone() });
        };
        let number = self.next_number;
        let first_index = self.episodes.last().map_or(0, |last| last.first_index + last.n_steps);
        self.episodes.push(sealed::move_to(&self.dir, path.clone(), notes.number, number, first_index)?);
        self.next_number += 1;
        meta::write(&self.dir, &self.episodes)?;
        // Left behind it is known for what it is: an episode that is in the dataset.
        remove(&path)?;
        Ok(number)
    }

    /// Finishes what a killed program began, where it was deleting.
    pub(super) fn repair(&mut self) -> Result<(), DatasetError> {
        if Self::is_torn(&self.dir) { self.close_gaps() } else { Ok(()) }
    }

    /// Lets the numbers and steps of the episodes count on without a gap, and `meta` say so.
    ///
    /// Damaged files keep their places, for nobody knows what is in them.
    fn close_gaps(&mut self) -> Result<(), DatasetError> {
        let (mut number, mut first_index) = (0, 0);
        for idx in 0..self.episodes.len() {
            while self.damaged_numbers.contains(&number) {
                number += 1;
            }
            let notes = &self.episodes[idx];
            if (notes.number, notes.first_index) != (number, first_index) {
                let (old, path) = (notes.number, disk::episode_path(&self.dir, notes.number));
                self.episodes[idx] = sealed::move_to(&self.dir, path.clone(), old, number, first_index)?;
                if old != number {
                    remove(&path)?;
                }
            }
            number += 1;
            first_index += self.episodes[idx].n_steps;
        }
        self.next_number = self.damaged_numbers.last().map_or(number, |last| number.max(last + 1));
        if self.episodes.is_empty() {
            // It would tell of episodes that are gone.
            let meta = self.dir.join("meta");
            if meta.exists() {
                fs::remove_dir_all(&meta).map_err(DatasetError::disk("remove the folder", &meta))?;
            }
        }
        meta::write(&self.dir, &self.episodes)?;
        remove(&renumbering(&self.dir))
    }

    /// Of an episode that was caught between two places, the file at its old place goes.
    pub(super) fn forget_twins(&mut self) -> Result<(), DatasetError> {
        let mut twins = self.episodes.extract_if(.., {
            let mut before = None;
            move |notes| before.replace(notes.recording.clone()).as_ref() == Some(&notes.recording)
        });
        twins.try_for_each(|twin| match &self.lock {
            Some(_) => remove(&disk::episode_path(&self.dir, twin.number)),
            None => Ok(()),
        })
    }

    fn require_lock(&self) -> Result<(), DatasetError> {
        match self.lock {
            Some(_) => Ok(()),
            None => Err(DatasetError::ReadOnly { path: self.dir.clone() }),
        }
    }
}

/// The episode that was deleted last, and its file.
fn deleted(dir: &Path) -> Option<(PathBuf, Notes)> {
    let files = disk::list(&dir.join(DELETED)).ok()?;
    files.into_iter().find_map(|path| Some((path.clone(), Sealed::open_anywhere(path).ok()?.notes)))
}

fn renumbering(dir: &Path) -> PathBuf {
    dir.join("journal").join(RENUMBERING)
}

fn remove(path: &Path) -> Result<(), DatasetError> {
    fs::remove_file(path).map_err(DatasetError::disk("remove the file", path))?;
    sync_folder(path).map_err(DatasetError::disk("remove the file", path))
}
