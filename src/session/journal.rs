//! A dream on its way to disk while it is driven, so that a killed program loses nothing.

use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};

use crate::dream::DreamEpisode;
use crate::run::{Appender, log_saved};
use crate::session::error::SessionError;
use crate::session::event::DreamSource;
use crate::world::{Action, ActionRanges, MAX_AXES};
use crate::world_model::LatentState;

/// What every journal begins with.
const MAGIC: &[u8; 16] = b"dropj dream 1\n\0\0";
/// What a step begins with; never 0, which is what a crash of the whole machine can leave.
const STEP: u8 = 1;
/// What a mark begins with.
const MARK: u8 = 2;
/// What a step that the planner drove begins with. A program that does not know it stops reading there.
const PLANNED_STEP: u8 = 3;
/// What a step with another number of actions than a car has begins with; whether it was planned and how many numbers its
/// action has come next, a byte each.
const STEP_OF: u8 = 4;

/// The journal of a dream that is being driven: a few kilobytes a second.
///
/// Each step is with the system once [`Self::follow`] returns, so it outlives the program. It is forced to the disk
/// itself only when the dream is kept, since a step that waited for the disk would be late.
/// Where a step cannot be written, the journal is as it was, and the next time catches up.
#[derive(Debug)]
pub struct DreamJournal {
    file: Appender,
    n_steps: usize,
    n_marks: usize,
}

impl DreamJournal {
    /// A journal in `folder` under the first free name, for a dream that has not begun.
    pub(super) fn create(
        folder: &Path,
        episode: &DreamEpisode,
        source: DreamSource,
    ) -> Result<Self, SessionError> {
        let tried = "make the journal of a dream";
        std::fs::create_dir_all(folder).map_err(SessionError::disk(tried, folder))?;
        let mut number = 0;
        let file = loop {
            let path = folder.join(format!("journal-{number:04}.partial"));
            match Appender::create(&path) {
                Ok(file) => break file,
                Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => number += 1,
                Err(e) => return Err(SessionError::disk(tried, &path)(e)),
            }
        };
        // Tells a journal that is being written from one that was left behind.
        file.lock().ok();
        let mut journal = Self { file, n_steps: 0, n_marks: 0 };
        let LatentState { z, c, h } = &episode.start;
        let mut bytes = MAGIC.to_vec();
        bytes.extend_from_slice(&(z.len() as u32).to_le_bytes());
        bytes.extend_from_slice(&(c.len() as u32).to_le_bytes());
        bytes.extend_from_slice(&episode.seed.to_le_bytes());
        bytes.push(u8::from(source == DreamSource::Simulated));
        bytes.extend([z, c, h].into_iter().flatten().flat_map(|v| v.to_le_bytes()));
        let begun = journal.append(&bytes, tried).and_then(|()| journal.follow(episode));
        // One without a beginning is of no use.
        if let Err(e) = begun {
            journal.discard().ok();
            return Err(e);
        }
        Ok(journal)
    }

    /// Writes down what `episode` has gained since the last time.
    pub fn follow(&mut self, episode: &DreamEpisode) -> Result<(), SessionError> {
        let mut bytes = Vec::new();
        for t in self.n_steps..episode.len() {
            let (action, is_planned) = (&episode.actions[t], episode.is_planned(t));
            if action.len() == ActionRanges::default().n_axes() {
                bytes.push(if is_planned { PLANNED_STEP } else { STEP });
            } else {
                bytes.extend([STEP_OF, u8::from(is_planned), action.len() as u8]);
            }
            let numbers = episode.zs.row(t).iter().copied().chain(action.iter().copied());
            bytes.extend(numbers.flat_map(f32::to_le_bytes));
        }
        for &mark in &episode.unsafe_marks[self.n_marks.min(episode.unsafe_marks.len())..] {
            bytes.push(MARK);
            bytes.extend_from_slice(&(mark as u32).to_le_bytes());
        }
        self.append(&bytes, "write to the journal of a dream")?;
        (self.n_steps, self.n_marks) = (episode.len(), episode.unsafe_marks.len());
        log_saved("dream step", self.n_steps as u64, self.path());
        Ok(())
    }

    fn append(&mut self, bytes: &[u8], tried: &'static str) -> Result<(), SessionError> {
        let appended = self.file.append(bytes, false);
        appended.map_err(|met| SessionError::append(tried, self.file.path())(met))
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// Removes the journal, once its dream is kept or thrown away.
    pub fn discard(self) -> Result<(), SessionError> {
        let path = self.file.path().to_owned();
        self.file.remove().map_err(SessionError::disk("remove the journal of a dream", &path))
    }
}

/// A dream whose program ended before it did.
#[derive(Clone, Debug, PartialEq)]
pub struct UnfinishedDream {
    /// As far as it was driven.
    pub episode: DreamEpisode,
    /// Who drove.
    pub source: DreamSource,
    /// Its journal.
    pub(super) path: PathBuf,
}

impl UnfinishedDream {
    /// Removes its journal.
    pub fn discard(self) -> Result<(), SessionError> {
        std::fs::remove_file(&self.path)
            .map_err(SessionError::disk("remove the journal of a dream", &self.path))
    }
}

/// The journals that were left in `folder`, in the order of their names.
///
/// Those that nobody can continue, because not a single step was written, are removed.
pub(super) fn unfinished(folder: &Path) -> Result<Vec<UnfinishedDream>, SessionError> {
    let tried = "look for unfinished dreams";
    let listing = match std::fs::read_dir(folder) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        listing => listing.map_err(SessionError::disk(tried, folder))?,
    };
    let is_journal = |path: &PathBuf| {
        let name = path.file_name().and_then(|name| name.to_str());
        name.is_some_and(|name| name.starts_with("journal-") && name.ends_with(".partial"))
    };
    let mut paths: Vec<_> = listing.filter_map(|item| Some(item.ok()?.path())).filter(is_journal).collect();
    paths.sort();
    let mut found = Vec::new();
    for path in paths {
        let file = File::open(&path).map_err(SessionError::disk(tried, &path))?;
        if matches!(file.try_lock(), Err(TryLockError::WouldBlock)) {
            continue;
        }
        drop(file);
        let bytes = std::fs::read(&path).map_err(SessionError::disk(tried, &path))?;
        match parse(&bytes) {
            Some((episode, source)) if !episode.is_empty() => {
                found.push(UnfinishedDream { episode, source, path });
            }
            _ if bytes.starts_with(MAGIC) || bytes.len() < MAGIC.len() => {
                std::fs::remove_file(&path).map_err(SessionError::disk("remove an empty journal", &path))?;
            }
            _ => ::log::warn!("this is not the journal of a dream: {}", path.display()),
        }
    }
    Ok(found)
}

/// The dream in a journal up to the last whole step, unless its beginning is missing.
fn parse(bytes: &[u8]) -> Option<(DreamEpisode, DreamSource)> {
    let rest = &mut bytes.strip_prefix(MAGIC)?;
    let n_z = u32::from_le_bytes(take(rest)?) as usize;
    let n_memory = u32::from_le_bytes(take(rest)?) as usize;
    let seed = u64::from_le_bytes(take(rest)?);
    let [source] = take(rest)?;
    let source = if source == 0 { DreamSource::User } else { DreamSource::Simulated };
    let (z, c, h) = (take_floats(rest, n_z)?, take_floats(rest, n_memory)?, take_floats(rest, n_memory)?);
    if z.is_empty() || c.is_empty() || ![&z, &c, &h].into_iter().flatten().all(|v| v.is_finite()) {
        return None;
    }
    let mut episode = DreamEpisode::new(LatentState { z, c, h }, seed);
    while let Some([kind]) = take(rest) {
        match kind {
            STEP | PLANNED_STEP | STEP_OF => {
                let told = if kind == STEP_OF { take(rest) } else { None };
                let [is_planned, n_axes] =
                    told.unwrap_or([u8::from(kind == PLANNED_STEP), ActionRanges::default().n_axes() as u8]);
                if !(1..=MAX_AXES).contains(&usize::from(n_axes)) || (kind == STEP_OF && told.is_none()) {
                    break;
                }
                let Some(numbers) = take_floats(rest, n_z + usize::from(n_axes)) else { break };
                if !numbers.iter().all(|number| number.is_finite()) {
                    break;
                }
                let (z, action) = numbers.split_at(n_z);
                episode.zs.push(z);
                episode.actions.push(Action::new(action));
                if is_planned == 1 {
                    episode.note_planned();
                }
            }
            MARK => {
                let Some(mark) = take(rest) else { break };
                episode.unsafe_marks.push(u32::from_le_bytes(mark) as usize);
            }
            _ => break,
        }
    }
    Some((episode, source))
}

fn take<const N: usize>(rest: &mut &[u8]) -> Option<[u8; N]> {
    let (taken, left) = rest.split_first_chunk::<N>()?;
    *rest = left;
    Some(*taken)
}

fn take_floats(rest: &mut &[u8], n: usize) -> Option<Vec<f32>> {
    let (taken, left) = rest.split_at_checked(n.checked_mul(4)?)?;
    *rest = left;
    Some(taken.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::arrays::formula_dream;

    fn first_steps(whole: &DreamEpisode, n: usize) -> DreamEpisode {
        let mut part = DreamEpisode::new(whole.start.clone(), whole.seed);
        (0..n).for_each(|t| part.zs.push(whole.zs.row(t)));
        part.actions = whole.actions[..n].to_vec();
        part.unsafe_marks = whole.unsafe_marks.iter().copied().filter(|mark| *mark < n).collect();
        let planned = whole.planned.iter().map(|range| range.start..range.end.min(n));
        part.planned = planned.filter(|range| !range.is_empty()).collect();
        part
    }

    #[test]
    fn a_journal_that_is_cut_anywhere_holds_every_whole_step_before_the_cut() {
        let dir = tempfile::tempdir().unwrap();
        let dream = DreamEpisode { planned: vec![1..3, 8..9], ..formula_dream(9, 4) };
        let mut journal =
            DreamJournal::create(dir.path(), &first_steps(&dream, 0), DreamSource::Simulated).unwrap();
        for n in 1..=9 {
            journal.follow(&first_steps(&dream, n)).unwrap();
        }
        let bytes = std::fs::read(journal.path()).unwrap();
        assert_eq!(parse(&bytes), Some((dream.clone(), DreamSource::Simulated)));
        let head = MAGIC.len() + 17 + 4 * (4 + 16 + 16);
        for len in 0..bytes.len() {
            let Some((part, _)) = parse(&bytes[..len]) else {
                assert!(len < head, "the beginning is there at {len}");
                continue;
            };
            let n = part.len();
            assert_eq!(part.zs, first_steps(&dream, n).zs);
            // Two marks of five bytes, at steps 0 and 7.
            assert!(n >= (len - head).saturating_sub(10) / 29, "{n} steps of {len} bytes");
        }
    }

    #[test]
    fn only_journals_that_nobody_writes_are_unfinished() {
        let dir = tempfile::tempdir().unwrap();
        let dream = formula_dream(30, 2);
        let journal = DreamJournal::create(dir.path(), &dream, DreamSource::User).unwrap();
        DreamJournal::create(dir.path(), &first_steps(&dream, 0), DreamSource::User).unwrap();
        assert_eq!(unfinished(dir.path()).unwrap(), []);
        let path = journal.path().to_owned();
        assert!(!dir.path().join("journal-0001.partial").exists(), "no step was lost with it");
        drop(journal);
        assert_eq!(
            unfinished(dir.path()).unwrap(),
            [UnfinishedDream { episode: dream, source: DreamSource::User, path: path.clone() }]
        );
        unfinished(dir.path()).unwrap().remove(0).discard().unwrap();
        assert!(!path.exists(), "discarding removes the journal");
    }
}
