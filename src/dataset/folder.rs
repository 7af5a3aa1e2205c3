//! A dataset's folder: opening, sealing, recovering, reading.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use sha2::{Digest as _, Sha256};

use super::journal::{self, Recording, Take};
use super::sealed::{self, Notes, Sealed, to_hex};
use super::{DatasetError, Episode, EpisodeInfo, Unfinished, disk, meta};
use crate::env::Frame;

/// A folder of episodes in one environment.
pub struct Dataset {
    pub(super) dir: PathBuf,
    pub(super) episodes: Vec<Notes>,
    damaged: Vec<DatasetError>,
    /// The places of damaged episode files, in order.
    pub(super) damaged_numbers: Vec<usize>,
    unfinished: Vec<Unfinished>,
    pub(super) next_number: usize,
    env: Option<String>,
    /// Held, and locked, while the dataset is open for recording.
    pub(super) lock: Option<File>,
}

impl Dataset {
    /// Opens a dataset for recording in the environment `env`; makes it where there is none.
    ///
    /// This is also the moment of repair: half-written files go, a deletion that was begun is finished, and `meta` is made
    /// to agree with the episodes.
    /// Journals left by a killed program are listed in [`unfinished`](Self::unfinished).
    pub fn create_or_open(dir: &Path, env: &str) -> Result<Self, DatasetError> {
        let journals = dir.join("journal");
        disk::make_folder(&journals)?;
        let lock_path = journals.join(".lock");
        let lock = File::create(&lock_path).map_err(DatasetError::disk("lock the dataset", &lock_path))?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(fs::TryLockError::WouldBlock) => return Err(DatasetError::Busy { path: dir.to_path_buf() }),
            // Some network disks know no locks; recording there is at the user's own risk.
            Err(fs::TryLockError::Error(error)) => {
                log::warn!("could not lock {}: {error}", lock_path.display());
            }
        }
        let mut dataset = Self::scan(dir)?;
        dataset.check_env(env)?;
        dataset.env = Some(env.into());
        dataset.lock = Some(lock);
        for folder in ["data", "meta", "journal"] {
            disk::remove_partials(&dir.join(folder))?;
        }
        dataset.forget_twins()?;
        // Where an episode cannot be moved, those there are can still be read and added to.
        if let Err(error) = dataset.repair() {
            log::warn!("{error}");
            dataset.damaged.push(error);
        }
        meta::write(dir, &dataset.episodes)?;
        dataset.find_unfinished(&journals)?;
        Ok(dataset)
    }

    /// Opens a dataset for reading, even where there is nothing; changes nothing on disk.
    pub fn look(dir: &Path) -> Result<Self, DatasetError> {
        let mut dataset = Self::scan(dir)?;
        dataset.forget_twins()?;
        Ok(dataset)
    }

    /// Opens a dataset for reading; changes nothing on disk.
    pub fn open(dir: &Path) -> Result<Self, DatasetError> {
        let dataset = Self::look(dir)?;
        if dataset.episodes.is_empty() && dataset.damaged.is_empty() {
            return Err(DatasetError::Missing { path: dir.to_path_buf() });
        }
        Ok(dataset)
    }

    /// Reads the footers of all episodes.
    fn scan(dir: &Path) -> Result<Self, DatasetError> {
        let (mut episodes, mut damaged, mut next_number) = (Vec::<Notes>::new(), Vec::new(), 0);
        let mut damaged_numbers = Vec::new();
        for (number, path) in disk::episode_files(dir)? {
            next_number = number + 1;
            match Sealed::open(path, number) {
                Ok(sealed) => episodes.push(sealed.notes),
                Err(error) => {
                    log::warn!("{error}");
                    damaged.push(error);
                    damaged_numbers.push(number);
                }
            }
        }
        let env = episodes.first().map(|first| first.info.env.clone());
        let dir = dir.to_path_buf();
        let unfinished = Vec::new();
        Ok(Self { dir, episodes, damaged, damaged_numbers, unfinished, next_number, env, lock: None })
    }

    /// Where it is.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// The name of the environment that it was recorded in.
    pub fn env(&self) -> Option<&str> {
        self.env.as_deref()
    }

    /// How many sealed episodes can be read.
    pub fn n_episodes(&self) -> usize {
        self.episodes.len()
    }

    /// How many steps they have together.
    pub fn n_steps(&self) -> usize {
        self.episodes.iter().map(|notes| notes.n_steps).sum()
    }

    /// How many steps the episode at `idx` has.
    pub fn len(&self, idx: usize) -> usize {
        self.episodes[idx].n_steps
    }

    /// Whether it has no episode.
    pub fn is_empty(&self) -> bool {
        self.episodes.is_empty()
    }

    /// Who drove where in the episode at `idx`.
    pub fn info(&self, idx: usize) -> &EpisodeInfo {
        &self.episodes[idx].info
    }

    /// The number that the next sealed episode gets.
    pub fn next_number(&self) -> usize {
        self.next_number
    }

    /// What tells these episodes, in this order, from any others.
    pub fn fingerprint(&self) -> String {
        let mut hasher = Sha256::new();
        self.episodes.iter().for_each(|notes| hasher.update(format!("{}\n", notes.recording)));
        to_hex(&hasher.finalize())
    }

    /// Pixels a side of all frames, once there are any.
    pub fn side(&self) -> Option<u32> {
        self.episodes.first().map(|first| first.side)
    }

    /// Why some files in the folder are not among the episodes.
    pub fn damaged(&self) -> &[DatasetError] {
        &self.damaged
    }

    /// Reads the episode at `idx`, in the order of their numbers.
    pub fn episode(&self, idx: usize) -> Result<Episode, DatasetError> {
        let Notes { number, recording, .. } = &self.episodes[idx];
        let sealed = Sealed::open(disk::episode_path(&self.dir, *number), *number)?;
        if sealed.notes.recording != *recording {
            return Err(DatasetError::Moved { path: self.dir.clone() });
        }
        sealed.read()
    }

    /// Reads the episodes one after the other; only one at a time is in memory.
    ///
    /// A damaged one is an error that the caller may report and pass over.
    pub fn episodes(&self) -> impl Iterator<Item = Result<Episode, DatasetError>> + '_ {
        (0..self.n_episodes()).map(|idx| self.episode(idx))
    }

    /// Begins to record an episode.
    pub fn begin(&self, info: EpisodeInfo) -> Result<Recording, DatasetError> {
        if self.lock.is_none() {
            return Err(DatasetError::ReadOnly { path: self.dir.clone() });
        }
        self.check_env(&info.env)?;
        Recording::begin(&self.dir, info, self.side())
    }

    /// Goes on here with a recording of another dataset, whose place is gone or full: all of its steps are written anew.
    ///
    /// The other journal stays as it is.
    pub fn take_over(&self, other: &Recording) -> Result<Recording, DatasetError> {
        let mut recording = self.begin(other.take.info.clone())?;
        match recording.take_over(other) {
            Ok(()) => Ok(recording),
            Err(e) => {
                recording.discard().ok();
                Err(e)
            }
        }
    }

    /// Seals a recording and returns its number in the dataset.
    ///
    /// `last_frame` is what was seen after the last action; `done` says whether the environment ended the episode.
    /// Where the disk does not allow it, the episode stays in its journal, among the [`unfinished`](Self::unfinished).
    pub fn seal(
        &mut self,
        mut recording: Recording,
        last_frame: &Frame,
        done: bool,
    ) -> Result<usize, DatasetError> {
        let finished = recording.finish(last_frame, done);
        let path = recording.path().to_path_buf();
        let take = &recording.take;
        finished.and_then(|()| self.seal_take(take, &path)).map_err(|met| {
            let unfinished =
                Unfinished { path: path.clone(), info: take.info.clone(), n_steps: take.rows.len() };
            self.unfinished.push(unfinished);
            DatasetError::NotSealed { met: Box::new(met), path }
        })
    }

    /// What a killed program left: each can be sealed with [`recover`](Self::recover) or dropped.
    pub fn unfinished(&self) -> &[Unfinished] {
        &self.unfinished
    }

    /// Seals an unfinished episode as far as its journal goes and returns its number in the dataset.
    pub fn recover(&mut self, idx: usize) -> Result<usize, DatasetError> {
        let path = self.unfinished[idx].path.clone();
        let number = self.seal_take(&journal::read(&path)?, &path)?;
        self.unfinished.remove(idx);
        Ok(number)
    }

    /// Drops an unfinished episode for good.
    pub fn discard(&mut self, idx: usize) -> Result<(), DatasetError> {
        let path = &self.unfinished[idx].path;
        fs::remove_file(path).map_err(DatasetError::disk("remove the journal", path))?;
        self.unfinished.remove(idx);
        Ok(())
    }

    /// Seals, then brings `meta` up to date, then removes the journal: in this order nothing can be lost.
    fn seal_take(&mut self, take: &Take, journal: &Path) -> Result<usize, DatasetError> {
        if take.rows.is_empty() {
            return Err(DatasetError::Empty { path: journal.to_path_buf() });
        }
        self.check_env(&take.info.env)?;
        let number = self.next_number;
        let first_index = self.episodes.last().map_or(0, |last| last.first_index + last.n_steps);
        self.episodes.push(sealed::write(&self.dir, take, number, first_index)?);
        self.next_number += 1;
        if let Err(error) = meta::write(&self.dir, &self.episodes) {
            log::warn!(
                "episode {number} is safe, but meta lags behind until the dataset is opened again: {error}"
            );
        }
        // Left behind it would be recognized and removed on opening.
        fs::remove_file(journal).ok();
        Ok(number)
    }

    /// Lists the journals that hold something, and removes those that hold nothing or are sealed already.
    fn find_unfinished(&mut self, journals: &Path) -> Result<(), DatasetError> {
        let mut paths = disk::list(journals)?;
        paths.retain(|path| path.extension().is_some_and(|extension| extension == journal::EXTENSION));
        paths.sort();
        for path in paths {
            let take = match journal::read(&path) {
                Ok(take) => take,
                Err(error) => {
                    log::warn!("{error}");
                    self.damaged.push(error);
                    continue;
                }
            };
            let is_sealed = self.episodes.iter().any(|notes| notes.recording == take.id);
            if take.rows.is_empty() || is_sealed {
                fs::remove_file(&path).map_err(DatasetError::disk("remove the journal", &path))?;
            } else {
                self.unfinished.push(Unfinished { path, info: take.info, n_steps: take.rows.len() });
            }
        }
        Ok(())
    }

    fn check_env(&self, env: &str) -> Result<(), DatasetError> {
        match &self.env {
            Some(met) if met != env => {
                Err(DatasetError::OtherEnv { tried: env.into(), met: met.clone(), path: self.dir.clone() })
            }
            _ => Ok(()),
        }
    }
}
