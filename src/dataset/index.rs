//! What is known of a dataset's episodes without reading them, and taking episodes out of it.
//!
//! `LeRobot` finds an episode by its place, so that numbers and steps have to count on without a gap. Wherever they do not,
//! for an episode was deleted, or files were moved out of the folder, renamed or put into it, every later episode is
//! written at its place anew, one file at a time:
//!
//! ```text
//! journal/renumbering            there as long as this lasts
//! deleted/<recording>.parquet    the episode that was deleted last, as it was
//! ```
//!
//! Whenever the program is killed, opening the dataset for recording finishes what was begun. An episode that is brought
//! back comes after all others.

use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

use super::damage::{Stranger, Useless};
use super::layout::column;
use super::notes::Notes;
use super::sealed::{self, Place};
use super::{Dataset, DatasetError, EpisodeInfo, disk, meta};
use crate::run::sync_folder;

/// Where the episode that was deleted last stays.
pub(super) const DELETED: &str = "deleted";
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
    /// Each event, and the share of its steps after which that goes on, in `[0, 1]`.
    pub events: Vec<(String, f64)>,
    /// Whether the world ended it.
    pub done: bool,
    /// When its first action was taken, in seconds since 1970.
    pub began_secs: i64,
}

impl Summary {
    fn of(notes: &Notes) -> Self {
        let stats = |column: &str| notes.stats.get(column);
        let share = |event: &String| stats(&column(event)).map_or(0.0, |stats| stats.mean[0]);
        let began_ns = stats("wall_time_ns").map_or(0.0, |stats| stats.min[0]);
        Self {
            recording: notes.recording.clone(),
            number: notes.number,
            info: notes.info.clone(),
            n_steps: notes.n_steps,
            n_planned: notes.planned.iter().map(|[from, to]| to - from).sum(),
            events: notes.events.iter().map(|event| (event.clone(), share(event))).collect(),
            done: notes.done,
            began_secs: (began_ns / 1e9) as i64,
        }
    }
}

impl Dataset {
    /// What is known of the episodes, in the order of their numbers.
    pub fn summaries(&self) -> impl Iterator<Item = Summary> + '_ {
        let foreign =
            self.foreign.iter().flat_map(|foreign| (0..foreign.n_episodes()).map(|idx| foreign.summary(idx)));
        self.episodes.iter().map(Summary::of).chain(foreign)
    }

    /// The place of an episode by what it was recorded as.
    pub fn find(&self, recording: &str) -> Option<usize> {
        match &self.foreign {
            Some(foreign) => foreign.find(recording),
            None => self.episodes.iter().position(|notes| notes.recording == recording),
        }
    }

    /// The episode that was deleted last, if it can be brought back.
    pub fn deleted(&self) -> Option<Summary> {
        deleted(&self.dir).map(|notes| Summary::of(&notes)).filter(|it| self.find(&it.recording).is_none())
    }

    /// Whether a program was killed while it deleted something here. Opening it for recording repairs that.
    pub fn is_torn(dir: &Path) -> bool {
        renumbering(dir).exists()
    }

    /// Takes the episode at `idx` out of the dataset. It can be [brought back](Self::bring_back) until another is deleted.
    ///
    /// After an error opening the dataset anew shows whether it is still there, and finishes what was begun.
    pub fn delete(&mut self, idx: usize) -> Result<(), DatasetError> {
        self.require_lock()?;
        let Notes { recording, path: from, .. } = &self.episodes[idx];
        let to = self.dir.join(DELETED).join(format!("{recording}.parquet"));
        disk::make_folder(&self.dir.join(DELETED))?;
        while let Some(old) = deleted(&self.dir) {
            remove(&old.path)?;
        }
        disk::replace(&renumbering(&self.dir), b"")?;
        // From here on it is deleted.
        fs::rename(from, &to).map_err(DatasetError::disk("move the episode away", from))?;
        for path in [from, &to] {
            sync_folder(path).map_err(DatasetError::disk("move the episode away", path))?;
        }
        self.episodes.remove(idx);
        self.put_in_order()
    }

    /// Puts the episode `recording` after all others, if it is the one that was deleted last, and returns its number there.
    pub fn bring_back(&mut self, recording: &str) -> Result<usize, DatasetError> {
        self.require_lock()?;
        let is_wanted = |it: &Notes| it.recording == recording && self.find(recording).is_none();
        let Some(notes) = deleted(&self.dir).filter(is_wanted) else {
            return Err(DatasetError::NothingDeleted { path: self.dir.clone() });
        };
        if let Some(first) = self.episodes.first() {
            sealed::require_alike(first, &notes)?;
        }
        let place = self.next_place();
        self.episodes.push(sealed::move_to(&self.dir, &notes, place)?);
        meta::write(&self.dir, &self.episodes)?;
        // Left behind it is known for what it is: an episode that is in the dataset.
        remove(&notes.path)?;
        Ok(place.number)
    }

    /// Lets the numbers and steps of the episodes count on without a gap, and `meta` say so.
    ///
    /// A place is free when an episode comes to it: those before it have moved already, those after it are further up.
    /// An episode that turns out to be damaged is moved aside.
    pub(super) fn put_in_order(&mut self) -> Result<(), DatasetError> {
        let mut place = Place { number: 0, first_index: 0 };
        let mut is_begun = Self::is_torn(&self.dir);
        while let Some(notes) = self.episodes.get(place.number) {
            if !notes.is_at(&self.dir, place.number, place.first_index) {
                if !is_begun {
                    disk::replace(&renumbering(&self.dir), b"")?;
                    is_begun = true;
                }
                let old = notes.path.clone();
                match sealed::move_to(&self.dir, notes, place) {
                    Ok(moved) if moved.path == old => self.episodes[place.number] = moved,
                    Ok(moved) => {
                        self.episodes[place.number] = moved;
                        remove(&old)?;
                    }
                    Err(DatasetError::Damaged { reason, path }) if path == old => {
                        self.episodes.remove(place.number);
                        self.set_aside(Useless::Damage(reason), &path)?;
                        continue;
                    }
                    Err(error) => return Err(error),
                }
            }
            place.first_index += self.episodes[place.number].n_steps;
            place.number += 1;
        }
        if self.episodes.is_empty() {
            // It would tell of episodes that are gone.
            meta::remove(&self.dir)?;
        }
        if is_begun {
            meta::write(&self.dir, &self.episodes)?;
            remove(&renumbering(&self.dir))?;
        }
        Ok(())
    }

    /// Of an episode that lies in two files, the first one counts.
    ///
    /// Where it was caught between two places, the file at its old place goes. Other copies are moved aside.
    pub(super) fn forget_twins(&mut self) -> Result<(), DatasetError> {
        let mut first_of = HashMap::<String, PathBuf>::new();
        let is_twin = |notes: &mut Notes| {
            let is_known = first_of.contains_key(&notes.recording);
            first_of.entry(notes.recording.clone()).or_insert_with(|| notes.path.clone());
            is_known
        };
        let twins: Vec<Notes> = self.episodes.extract_if(.., is_twin).collect();
        for twin in twins {
            let first = &first_of[&twin.recording];
            let first = first.strip_prefix(&self.dir).unwrap_or(first).to_owned();
            match (&self.lock, Self::is_torn(&self.dir)) {
                (Some(_), true) => remove(&twin.path)?,
                (Some(_), false) => self.set_aside(Useless::Twin(first), &twin.path)?,
                (None, true) => {}
                (None, false) => {
                    let reason = Stranger::Twin(first);
                    self.damaged.push(DatasetError::NotOurs { reason, path: twin.path });
                }
            }
        }
        Ok(())
    }

    fn require_lock(&self) -> Result<(), DatasetError> {
        match self.lock {
            Some(_) => Ok(()),
            None => Err(DatasetError::ReadOnly { path: self.dir.clone() }),
        }
    }
}

/// The episode that was deleted last.
fn deleted(dir: &Path) -> Option<Notes> {
    let files = disk::list(&dir.join(DELETED)).ok()?;
    files.iter().find_map(|path| sealed::open(path).ok())
}

fn renumbering(dir: &Path) -> PathBuf {
    dir.join("journal").join(RENUMBERING)
}

fn remove(path: &Path) -> Result<(), DatasetError> {
    fs::remove_file(path).map_err(DatasetError::disk("remove the file", path))?;
    sync_folder(path).map_err(DatasetError::disk("remove the file", path))
}
