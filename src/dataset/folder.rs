//! A dataset's folder: opening, sealing, recovering, reading.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use sha2::{Digest as _, Sha256};

use super::damage::Useless;
use super::foreign::Foreign;
use super::found::Found;
use super::hex::to_hex;
use super::journal::{self, Recording, Take};
use super::notes::Notes;
use super::sealed::{self, Place};
use super::{DatasetError, Episode, EpisodeInfo, Layout, Unfinished, card, disk, meta, ownership};
use crate::world::{End, Frame, Size};

/// A folder of episodes in one world.
pub struct Dataset {
    pub(super) dir: PathBuf,
    /// In their order, which their files' names decide.
    pub(super) episodes: Vec<Notes>,
    pub(super) damaged: Vec<DatasetError>,
    unfinished: Vec<Unfinished>,
    pub(super) env: Option<String>,
    /// What others recorded, in place of episodes of ours.
    pub(super) foreign: Option<Foreign>,
    /// Held, and locked, while the dataset is open for recording.
    pub(super) lock: Option<File>,
}

impl Dataset {
    /// Opens a dataset for recording in the world `env`. Makes it where there is none.
    ///
    /// A folder that is neither ours nor empty is refused before anything in it is touched.
    ///
    /// This is also the moment of repair: half-written files go, damaged ones are moved aside, and episodes and `meta` are
    /// made to agree: their numbers and steps count on without a gap, in the order of their files.
    /// Journals left by a killed program are listed in [`unfinished`](Self::unfinished).
    pub fn create_or_open(dir: &Path, env: &str) -> Result<Self, DatasetError> {
        let journals = dir.join("journal");
        let lock_path = journals.join(disk::LOCK);
        if !lock_path.exists() {
            found_to_go_on_with(dir, env)?;
            disk::make_folder(&journals)?;
        }
        let lock = File::options().write(true).create(true).truncate(false).open(&lock_path);
        let lock = lock.map_err(DatasetError::disk("lock the dataset", &lock_path))?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(fs::TryLockError::WouldBlock) => return Err(DatasetError::Busy { path: dir.to_path_buf() }),
            // Some network disks know no locks. Recording there is at the user's own risk.
            Err(fs::TryLockError::Error(error)) => {
                log::warn!("could not lock {}: {error}", lock_path.display());
            }
        }
        // From here on nobody else changes it.
        let found = found_to_go_on_with(dir, env)?;
        let mut dataset = Self::of(dir, found.episodes);
        dataset.env = Some(env.into());
        if dataset.episodes.first().is_some_and(|first| !first.columns().ends) {
            log::warn!(
                "an older version began these recordings: new ones do without the columns that they lack, at {}",
                dir.display()
            );
        }
        dataset.lock = Some(lock);
        for (reason, path) in found.torn {
            dataset.set_aside(Useless::Damage(reason), &path)?;
        }
        for folder in ["data", "meta", "journal"] {
            disk::remove_partials(&dir.join(folder))?;
        }
        crate::run::remove_partials(dir);
        dataset.forget_twins()?;
        dataset.put_in_order()?;
        for path in meta::strays(dir)? {
            dataset.set_aside(Useless::Index, &path)?;
        }
        meta::write(dir, &dataset.episodes)?;
        dataset.find_unfinished(&journals)?;
        Ok(dataset)
    }

    /// Opens a dataset for reading, even where there is nothing. Changes nothing on disk.
    pub fn inspect(dir: &Path) -> Result<Self, DatasetError> {
        Self::read(dir, Found::read(dir)?)
    }

    /// Opens a dataset for reading. Changes nothing on disk.
    pub fn open(dir: &Path) -> Result<Self, DatasetError> {
        let found = Found::read(dir)?;
        let foreign = ownership::describe(dir, &found);
        let mut dataset = Self::read(dir, found)?;
        if !dataset.episodes.is_empty() {
            return Ok(dataset);
        }
        let path = dir.to_path_buf();
        Err(match (foreign, dataset.damaged.pop()) {
            (Some(reason), _) => DatasetError::Foreign { reason, path },
            (None, Some(damaged)) => damaged,
            (None, None) => DatasetError::Missing { path },
        })
    }

    /// What was found, to be read only.
    fn read(dir: &Path, found: Found) -> Result<Self, DatasetError> {
        found.require_alike()?;
        let mut dataset = Self::of(dir, found.episodes);
        let torn = found.torn.into_iter().map(|(reason, path)| DatasetError::Damaged { reason, path });
        dataset.damaged.extend(torn.chain(found.others).inspect(|error| log::warn!("{error}")));
        dataset.forget_twins()?;
        // Wherever the files lie, their order is what counts.
        let mut first_index = 0;
        for (number, notes) in dataset.episodes.iter_mut().enumerate() {
            (notes.number, notes.first_index) = (number, first_index);
            first_index += notes.n_steps;
        }
        Ok(dataset)
    }

    pub(super) fn of(dir: &Path, episodes: Vec<Notes>) -> Self {
        let env = episodes.first().map(|first| first.info.env.clone());
        let (dir, damaged, unfinished) = (dir.to_path_buf(), Vec::new(), Vec::new());
        Self { dir, episodes, damaged, unfinished, env, foreign: None, lock: None }
    }

    /// Moves a file out of the dataset, to where it is in nobody's way, and remembers to tell of it.
    pub(super) fn set_aside(&mut self, reason: Useless, path: &Path) -> Result<(), DatasetError> {
        let to = disk::set_aside(&self.dir, path)?;
        let error = DatasetError::SetAside { reason, path: path.to_path_buf(), to };
        log::warn!("{error}");
        self.damaged.push(error);
        Ok(())
    }

    /// Where it is.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// The name of the world that it was recorded in.
    pub fn env(&self) -> Option<&str> {
        self.env.as_deref()
    }

    /// How many sealed episodes can be read.
    pub fn n_episodes(&self) -> usize {
        self.foreign.as_ref().map_or(self.episodes.len(), Foreign::n_episodes)
    }

    /// How many steps they have together.
    pub fn n_steps(&self) -> usize {
        (0..self.n_episodes()).map(|idx| self.len(idx)).sum()
    }

    /// How many steps the episode at `idx` has.
    pub fn len(&self, idx: usize) -> usize {
        self.foreign.as_ref().map_or_else(|| self.episodes[idx].n_steps, |foreign| foreign.len(idx))
    }

    /// Whether it has no episode.
    pub fn is_empty(&self) -> bool {
        self.n_episodes() == 0
    }

    /// Who drove where in the episode at `idx`.
    pub fn info(&self, idx: usize) -> &EpisodeInfo {
        self.foreign.as_ref().map_or_else(|| &self.episodes[idx].info, Foreign::info)
    }

    /// The number that the next sealed episode gets.
    pub fn next_number(&self) -> usize {
        self.episodes.len()
    }

    /// What tells these episodes, in this order, from any others.
    pub fn fingerprint(&self) -> String {
        if let Some(foreign) = &self.foreign {
            return foreign.fingerprint();
        }
        let mut hasher = Sha256::new();
        self.episodes.iter().for_each(|notes| hasher.update(format!("{}\n", notes.recording)));
        to_hex(&hasher.finalize())
    }

    /// The size of all frames, once there are any.
    pub fn size(&self) -> Option<Size> {
        let foreign = self.foreign.as_ref().map(|foreign| foreign.spec().image.trained());
        foreign.or_else(|| self.episodes.first().map(Notes::size))
    }

    /// What the steps of all episodes have, once there are any.
    pub fn layout(&self) -> Option<Layout> {
        let foreign = self.foreign.as_ref().map(Foreign::layout);
        foreign.or_else(|| self.episodes.first().map(Notes::layout))
    }

    /// Why some files in the folder are not among the episodes, or not any more.
    pub fn damaged(&self) -> &[DatasetError] {
        &self.damaged
    }

    /// Reads the episode at `idx`, in the order of their numbers.
    pub fn episode(&self, idx: usize) -> Result<Episode, DatasetError> {
        if let Some(foreign) = &self.foreign {
            return foreign.episode(idx);
        }
        let Notes { number, recording, path, .. } = &self.episodes[idx];
        let moved = || DatasetError::Moved { path: self.dir.clone() };
        let (mut notes, take) = sealed::read(path).map_err(|error| match error {
            DatasetError::Disk { met, .. } if met.kind() == io::ErrorKind::NotFound => moved(),
            error => error,
        })?;
        if notes.recording != *recording {
            return Err(moved());
        }
        notes.number = *number;
        sealed::episode((notes, take))
    }

    /// Reads the episodes one after the other. Only one at a time is in memory.
    ///
    /// A damaged one is an error that the caller may report and pass over.
    pub fn episodes(&self) -> impl Iterator<Item = Result<Episode, DatasetError>> + '_ {
        (0..self.n_episodes()).map(|idx| self.episode(idx))
    }

    /// Writes the episodes anew below `dir`, with all that the Hugging Face Hub and `LeRobot` look for, whatever version
    /// recorded them, and with nothing else: no journal, and nothing that was deleted or is damaged.
    ///
    /// A card that somebody changed goes along as it is. `told` hears how many are done, of how many.
    ///
    /// # Errors
    /// Where others recorded it, an episode cannot be read, or nothing can be written there.
    pub fn write_for_hub(&self, dir: &Path, mut told: impl FnMut(usize, usize)) -> Result<(), DatasetError> {
        if self.foreign.is_some() {
            let reason = "it was recorded by others, and can go to the Hub as it is".to_owned();
            return Err(DatasetError::Foreign { reason, path: self.dir.clone() });
        }
        let mut written = Vec::new();
        for (number, notes) in self.episodes.iter().enumerate() {
            told(number, self.episodes.len());
            let place = Place { number, first_index: notes.first_index };
            written.push(sealed::move_to(dir, notes, place)?);
        }
        card::take_along(&self.dir, dir)?;
        meta::write(dir, &written)
    }

    /// Begins to record an episode whose steps have the default layout.
    pub fn begin(&self, info: EpisodeInfo) -> Result<Recording, DatasetError> {
        self.begin_with(info, &Layout::default())
    }

    /// Begins to record an episode whose steps have this layout.
    ///
    /// Events and sensors that the dataset does not have are left out once it is sealed.
    ///
    /// # Errors
    /// Where it could not be sealed here: the dataset has other axes, another rate, other sensors, or an event that is
    /// not among these.
    pub fn begin_with(&self, info: EpisodeInfo, layout: &Layout) -> Result<Recording, DatasetError> {
        if self.lock.is_none() {
            return Err(DatasetError::ReadOnly { path: self.dir.clone() });
        }
        self.check_env(&info.env)?;
        if let Some(first) = self.episodes.first() {
            sealed::require_fit(layout, first, &self.dir)?;
        }
        Recording::begin(&self.dir, info, layout.clone(), self.size())
    }

    /// Goes on here with a recording of another dataset, whose place is gone or full: all of its steps are written anew.
    ///
    /// The other journal stays as it is.
    pub fn take_over(&self, other: &Recording) -> Result<Recording, DatasetError> {
        let mut recording = self.begin_with(other.take.info.clone(), &other.take.layout)?;
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
    /// `last_frame` is what was seen after the last action. `end` is why the world ended the episode, if it did.
    /// Where the episodes before it lack columns that it would have, as those of older versions do, it does without.
    /// Where the disk does not allow it, the episode stays in its journal, among the [`unfinished`](Self::unfinished).
    pub fn seal(
        &mut self,
        mut recording: Recording,
        last_frame: &Frame,
        end: Option<End>,
    ) -> Result<usize, DatasetError> {
        let finished = recording.finish(last_frame, end);
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
        let place = self.next_place();
        let number = place.number;
        self.episodes.push(sealed::write(&self.dir, take, place, self.episodes.first())?);
        if let Err(error) = meta::write(&self.dir, &self.episodes) {
            log::warn!(
                "episode {number} is safe, but meta lags behind until the dataset is opened again: {error}"
            );
        }
        // Left behind it would be recognized and removed on opening.
        fs::remove_file(journal).ok();
        Ok(number)
    }

    /// Where the next episode goes.
    pub(super) fn next_place(&self) -> Place {
        let first_index = self.episodes.last().map_or(0, |last| last.first_index + last.n_steps);
        Place { number: self.episodes.len(), first_index }
    }

    /// Lists the journals that hold something, and removes those that hold nothing or are sealed already.
    fn find_unfinished(&mut self, journals: &Path) -> Result<(), DatasetError> {
        let mut paths = disk::list(journals)?;
        paths.retain(|path| path.extension().is_some_and(|extension| extension == disk::JOURNAL_EXTENSION));
        paths.sort();
        for path in paths {
            let take = match journal::read(&path) {
                Ok(take) => take,
                Err(DatasetError::DamagedJournal { path }) => {
                    self.set_aside(Useless::Journal, &path)?;
                    continue;
                }
                Err(error) => return Err(error),
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

/// What episodes of `env` can join, in a folder of ours or an empty one.
fn found_to_go_on_with(dir: &Path, env: &str) -> Result<Found, DatasetError> {
    let mut found = Found::read(dir)?;
    ownership::require(dir, &mut found)?;
    found.require_alike()?;
    match found.episodes.first() {
        Some(first) if first.info.env != env => {
            let met = first.info.env.clone();
            Err(DatasetError::OtherEnv { tried: env.into(), met, path: dir.to_path_buf() })
        }
        _ => Ok(found),
    }
}
