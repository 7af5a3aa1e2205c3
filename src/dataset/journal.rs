//! The journal of an episode that is being driven: what a killed program leaves behind.
//!
//! ```text
//! journal/00001767225600123456789.journal
//!   "dropj journal 2\n", then records: length u32, the first 8 bytes of the SHA-256, payload
//!   payload: 'I' info as JSON · 'S' wall clock i64, action 3 f32, reward f32, touched u8, state f32 each, PNG
//!            · 'E' end u8, PNG
//! ```
//!
//! The info names what the state holds. The end is 0 where the driver ended it, 1 where the environment did because
//! the car had left the field, 2 where its time was up. Journals that begin with "dropj journal 1\n" are read as well:
//! they have no state, and 1 for either end.
//!
//! The bits of what was touched, from the lowest: grass, chuckhole, car, whether the world has the latter two; then
//! whether the planner drove.
//! Numbers are little-endian. A torn last record is dropped, with a warning.

use std::fs::{self, File};
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::damage::Unfit;
use super::disk::JOURNAL_EXTENSION;
use super::{DatasetError, EpisodeInfo, StepRecord, disk, limits, png};
use crate::env::{Action, Contacts, End, Frame, MAX_STEPS};
use crate::run::{Appender, log_saved};

/// What a journal begins with.
const MAGIC: &[u8] = b"dropj journal 2\n";
/// What it began with before it knew the car's state and why an episode ended.
const OLD_MAGIC: &[u8] = b"dropj journal 1\n";
/// Length and checksum before each payload.
const RECORD_HEAD: usize = 12;
/// A power cut costs at most this much; a killed program nothing.
const SYNC_EVERY: Duration = Duration::from_secs(1);

/// An episode that is being driven, every step of it on disk as soon as [`push`](Self::push) returns.
///
/// Dropped, it stays in its journal and is offered as unfinished when the dataset is opened again.
pub struct Recording {
    file: Appender,
    synced: Instant,
    side: Option<u32>,
    pub(super) take: Take,
}

/// What is known of an episode before it is sealed.
#[derive(Debug, PartialEq)]
pub(super) struct Take {
    /// The journal's name, which is kept in the sealed file so that nothing is sealed twice.
    pub(super) id: String,
    /// Who drove where.
    pub(super) info: EpisodeInfo,
    /// The names of what the car measured.
    pub(super) state: Vec<String>,
    /// The steps, in order.
    pub(super) rows: Vec<Row>,
    /// How it ended, where it did.
    pub(super) end: Option<TakeEnd>,
}

/// A step, its frame as PNG.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Row {
    pub(super) png: Vec<u8>,
    pub(super) action: Action,
    pub(super) reward: f32,
    pub(super) grass: bool,
    pub(super) contacts: Option<Contacts>,
    pub(super) wall_time_ns: i64,
    /// Whether the planner drove, and not whoever is named as the pilot.
    pub(super) planned: bool,
    /// What the car measured before the action.
    pub(super) state: Vec<f32>,
}

/// The frame after the last action, and whether the environment ended the episode.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct TakeEnd {
    pub(super) png: Vec<u8>,
    pub(super) done: bool,
    /// Whether it did so because the time was up.
    pub(super) truncated: bool,
}

/// The first record of a journal.
#[derive(Serialize, Deserialize)]
struct Head {
    app: String,
    #[serde(flatten)]
    info: EpisodeInfo,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    state: Vec<String>,
}

impl Recording {
    /// Begins a journal in the dataset at `dir`, whose frames have `side` pixels a side where that is known.
    pub(super) fn begin(
        dir: &Path,
        info: EpisodeInfo,
        state: Vec<String>,
        side: Option<u32>,
    ) -> Result<Self, DatasetError> {
        let odd = limits::check_info(&info).and(limits::check_sensors(&state));
        odd.map_err(|met| DatasetError::Unfit { reason: Unfit::Limits(met), path: dir.to_path_buf() })?;
        let (id, path) = new_journal(&dir.join("journal"));
        let head = Head { app: env!("CARGO_PKG_VERSION").into(), info: info.clone(), state: state.clone() };
        let payload = [b"I".as_slice(), &serde_json::to_vec(&head).expect("text and numbers")].concat();
        let begun = [MAGIC, &record(&payload)].concat();
        disk::replace(&path, &begun)?;
        Ok(Self {
            file: Appender::open(&path).map_err(DatasetError::disk("begin the journal", &path))?,
            synced: Instant::now(),
            side,
            take: Take { id, info, state, rows: Vec::new(), end: None },
        })
    }

    /// Appends a step. Once this returns, a killed program does not lose it.
    ///
    /// After an error the step is not part of the recording, which may go on.
    pub fn push(&mut self, step: &StepRecord) -> Result<(), DatasetError> {
        self.push_by(step, false)
    }

    /// The same, where `planned` says whether the planner drove.
    pub fn push_by(&mut self, step: &StepRecord, planned: bool) -> Result<(), DatasetError> {
        let numbers = [step.action.steer, step.action.gas, step.action.brake, step.reward];
        let unfit = |reason| DatasetError::Unfit { reason, path: self.path().to_owned() };
        if !numbers.iter().chain(&step.state).all(|number| number.is_finite()) {
            return Err(unfit(Unfit::NotFinite { numbers, state: step.state.clone() }));
        }
        if step.state.len() != self.take.state.len() {
            let (found, wanted) = (step.state.len(), self.take.state.len());
            return Err(unfit(Unfit::Measurements { found, wanted }));
        }
        if self.n_steps() >= limits::STEPS {
            return Err(unfit(Unfit::Steps(limits::STEPS)));
        }
        self.check_side(&step.frame)?;
        let row = Row {
            png: png::encode(&step.frame),
            action: step.action,
            reward: step.reward,
            grass: step.grass,
            contacts: step.contacts,
            wall_time_ns: step.wall_time_ns,
            planned,
            state: step.state.clone(),
        };
        self.append(&record(&row.to_payload()))?;
        self.side = Some(step.frame.side());
        self.take.rows.push(row);
        log_saved("step", self.take.rows.len() as u64, self.path());
        Ok(())
    }

    /// How many steps it has so far.
    pub fn n_steps(&self) -> usize {
        self.take.rows.len()
    }

    /// The journal.
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// Whether the journal still is what its name says.
    pub fn check(&self) -> Result<(), DatasetError> {
        self.file.check().map_err(DatasetError::append("look at the journal", self.path()))
    }

    /// Forgets the episode, journal and all.
    pub fn discard(self) -> Result<(), DatasetError> {
        let path = self.path().to_owned();
        self.file.remove().map_err(DatasetError::disk("remove the journal", &path))
    }

    /// Writes all steps of `other` down here, where nothing was driven yet.
    pub(super) fn take_over(&mut self, other: &Self) -> Result<(), DatasetError> {
        if let (Some(tried), Some(met)) = (other.side, self.side)
            && tried != met
        {
            return Err(DatasetError::OtherSide { tried, met, path: self.path().to_owned() });
        }
        let records = other.take.rows.iter().flat_map(|row| record(&row.to_payload())).collect::<Vec<u8>>();
        self.append(&records)?;
        self.file.sync().map_err(DatasetError::disk("sync the journal", self.path()))?;
        self.side = other.side;
        self.take.rows.clone_from(&other.take.rows);
        Ok(())
    }

    /// Appends the end, which the environment gave the episode, or its driver.
    pub(super) fn finish(&mut self, last_frame: &Frame, end: Option<End>) -> Result<(), DatasetError> {
        self.check_side(last_frame)?;
        let code = match end {
            None => 0,
            Some(End::OutOfBounds) => 1,
            Some(End::TimeLimit) => 2,
        };
        let end = TakeEnd::of(code, png::encode(last_frame));
        self.append(&record(&[b"E".as_slice(), &[code], &end.png].concat()))?;
        self.take.end = Some(end);
        Ok(())
    }

    fn check_side(&self, frame: &Frame) -> Result<(), DatasetError> {
        match self.side {
            None if !(1..=limits::SIDE).contains(&frame.side()) => {
                let reason = Unfit::Side(frame.side());
                Err(DatasetError::Unfit { reason, path: self.path().to_owned() })
            }
            Some(met) if met != frame.side() => {
                Err(DatasetError::OtherSide { tried: frame.side(), met, path: self.path().to_owned() })
            }
            _ => Ok(()),
        }
    }

    /// Writes whole records, or leaves the journal as it was.
    fn append(&mut self, records: &[u8]) -> Result<(), DatasetError> {
        let is_synced = self.synced.elapsed() >= SYNC_EVERY;
        let appended = self.file.append(records, is_synced);
        appended.map_err(DatasetError::append("write the journal", self.file.path()))?;
        if is_synced {
            self.synced = Instant::now();
        }
        Ok(())
    }
}

impl TakeEnd {
    fn of(code: u8, png: Vec<u8>) -> Self {
        Self { png, done: code != 0, truncated: code == 2 }
    }
}

impl Row {
    /// Bytes of a payload before the state.
    const HEAD: usize = 1 + 8 + 4 * Action::LEN + 4 + 1;

    fn to_payload(&self) -> Vec<u8> {
        let mut payload = Vec::with_capacity(Self::HEAD + 4 * self.state.len() + self.png.len());
        payload.push(b'S');
        payload.extend(self.scalars());
        payload.extend(self.state.iter().flat_map(|number| number.to_le_bytes()));
        payload.extend(&self.png);
        payload
    }

    /// What every world has but the frame, as bytes.
    fn scalars(&self) -> Vec<u8> {
        let mut bytes = self.wall_time_ns.to_le_bytes().to_vec();
        for number in self.action.to_array().into_iter().chain([self.reward]) {
            bytes.extend(number.to_le_bytes());
        }
        let Contacts { chuckhole, car } = self.contacts.unwrap_or_default();
        let touched = [self.grass, chuckhole, car, self.contacts.is_some(), self.planned];
        bytes.push((0..).zip(touched).map(|(bit, is)| u8::from(is) << bit).sum());
        bytes
    }

    fn from_payload(payload: &[u8], n_sensors: usize) -> Option<Self> {
        let (head, rest) = payload.split_at_checked(Self::HEAD)?;
        let (state, png) = rest.split_at_checked(4 * n_sensors)?;
        let (state, _) = state.as_chunks();
        let number = |at: usize| Some(f32::from_le_bytes(*head.get(at..)?.first_chunk()?));
        let touched = *head.last()?;
        let is = |bit: u8| touched >> bit & 1 != 0;
        let row = Self {
            png: png.to_vec(),
            action: Action { steer: number(9)?, gas: number(13)?, brake: number(17)? },
            reward: number(21)?,
            grass: is(0),
            contacts: is(3).then(|| Contacts { chuckhole: is(1), car: is(2) }),
            wall_time_ns: i64::from_le_bytes(*head.get(1..)?.first_chunk()?),
            planned: is(4),
            state: state.iter().map(|&number| f32::from_le_bytes(number)).collect(),
        };
        let Action { steer, gas, brake } = row.action;
        let mut numbers = [steer, gas, brake, row.reward].into_iter().chain(row.state.iter().copied());
        (head[0] == b'S' && numbers.all(f32::is_finite)).then_some(row)
    }
}

/// A record with its length and checksum before it.
fn record(payload: &[u8]) -> Vec<u8> {
    let mut record = Vec::with_capacity(RECORD_HEAD + payload.len());
    record.extend((payload.len() as u32).to_le_bytes());
    record.extend(checksum(payload));
    record.extend(payload);
    record
}

fn checksum(payload: &[u8]) -> [u8; 8] {
    let mut checksum = [0; 8];
    checksum.copy_from_slice(&Sha256::digest(payload)[..8]);
    checksum
}

/// A name that no other journal has: the nanoseconds of the wall clock.
fn new_journal(folder: &Path) -> (String, PathBuf) {
    let since_epoch = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let mut nanos = since_epoch.as_nanos();
    loop {
        let id = format!("{nanos:023}");
        let path = folder.join(format!("{id}.{JOURNAL_EXTENSION}"));
        if !path.exists() {
            return (id, path);
        }
        nanos += 1;
    }
}

/// Reads what a journal holds, up to its first torn record.
pub(super) fn read(path: &Path) -> Result<Take, DatasetError> {
    let n_bytes = fs::metadata(path).map_err(DatasetError::disk("read the journal", path))?.len();
    if n_bytes > limits::FILE_BYTES {
        return Err(DatasetError::DamagedJournal { path: path.to_path_buf() });
    }
    let bytes = fs::read(path).map_err(DatasetError::disk("read the journal", path))?;
    let id = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let (take, n_torn) =
        parse(&bytes, id).ok_or_else(|| DatasetError::DamagedJournal { path: path.to_path_buf() })?;
    if n_torn > 0 {
        log::warn!("dropping a torn record, the last {n_torn} bytes of the journal {}", path.display());
    }
    Ok(take)
}

/// Whether a file begins as a journal does.
pub(super) fn is_one(path: &Path) -> bool {
    let mut begun = [0; MAGIC.len()];
    let is_read = File::open(path).and_then(|mut file| file.read_exact(&mut begun)).is_ok();
    is_read && [MAGIC, OLD_MAGIC].contains(&begun.as_slice())
}

/// What the bytes of the journal `id` hold, and how many are torn at their end. Nothing where the beginning is.
pub(super) fn parse(bytes: &[u8], id: String) -> Option<(Take, usize)> {
    let is_old = bytes.starts_with(OLD_MAGIC);
    let rest = bytes.strip_prefix(if is_old { OLD_MAGIC } else { MAGIC })?;
    let (payload, mut rest) = split_record(rest)?;
    let head: Head = serde_json::from_slice(payload.strip_prefix(b"I")?).ok()?;
    limits::check_info(&head.info).and(limits::check_sensors(&head.state)).ok()?;
    let mut take = Take { id, info: head.info, state: head.state, rows: Vec::new(), end: None };
    while let Some((payload, after)) = split_record(rest) {
        match payload {
            [b'E', code @ 0..=2, png @ ..] => {
                let mut end = TakeEnd::of(*code, png.to_vec());
                end.truncated |= is_old && end.done && take.rows.len() >= MAX_STEPS;
                take.end = Some(end);
            }
            payload => match Row::from_payload(payload, take.state.len()) {
                // Nothing comes after the end.
                Some(row) if take.end.is_none() && take.rows.len() < limits::STEPS => take.rows.push(row),
                _ => break,
            },
        }
        rest = after;
    }
    Some((take, rest.len()))
}

/// The payload of the first record, and what comes after it. Nothing where the record is torn.
fn split_record(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (head, rest) = bytes.split_at_checked(RECORD_HEAD)?;
    let len = u32::from_le_bytes(*head.first_chunk()?) as usize;
    let (payload, after) = rest.split_at_checked(len)?;
    (checksum(payload) == head[4..]).then_some((payload, after))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(level: u8) -> StepRecord {
        StepRecord {
            frame: Frame::new(4, vec![level; 48]),
            action: Action::new(0.25, f32::from(level) / 255.0, 0.5),
            reward: -1.0,
            grass: level % 2 == 1,
            contacts: (level > 1).then_some(Contacts { chuckhole: level == 2, car: level == 3 }),
            wall_time_ns: 1_767_225_600_000_000_000 + i64::from(level),
            state: vec![f32::from(level), -0.5],
        }
    }

    fn sensors() -> Vec<String> {
        vec!["speed".to_owned(), "yaw_rate".to_owned()]
    }

    fn info() -> EpisodeInfo {
        EpisodeInfo { env: "dummy".into(), pilot: "nobody".into(), seed: u64::MAX }
    }

    #[test]
    fn a_journal_cut_at_any_byte_of_its_last_record_keeps_all_records_before() {
        let dir = tempfile::tempdir().unwrap();
        let mut recording = Recording::begin(dir.path(), info(), sensors(), None).unwrap();
        recording.push(&step(1)).unwrap();
        recording.push(&step(2)).unwrap();
        let n_before = recording.file.len() as usize;
        recording.push(&step(3)).unwrap();
        let whole = fs::read(recording.path()).unwrap();
        for n_left in n_before..whole.len() {
            fs::write(recording.path(), &whole[..n_left]).unwrap();
            let take = read(recording.path()).unwrap();
            assert_eq!(take.rows, recording.take.rows[..2], "cut to {n_left} bytes");
        }
        fs::write(recording.path(), &whole).unwrap();
        assert_eq!(read(recording.path()).unwrap(), recording.take);
    }

    #[test]
    fn a_flipped_bit_ends_a_journal_there() {
        let dir = tempfile::tempdir().unwrap();
        let mut recording = Recording::begin(dir.path(), info(), sensors(), None).unwrap();
        recording.push(&step(1)).unwrap();
        let n_before = recording.file.len() as usize;
        recording.push(&step(2)).unwrap();
        let mut bytes = fs::read(recording.path()).unwrap();
        bytes[n_before + 30] ^= 4;
        fs::write(recording.path(), bytes).unwrap();
        assert_eq!(read(recording.path()).unwrap().rows, recording.take.rows[..1]);
    }

    #[test]
    fn an_end_is_read_back() {
        let dir = tempfile::tempdir().unwrap();
        let mut recording = Recording::begin(dir.path(), info(), sensors(), None).unwrap();
        recording.push(&step(1)).unwrap();
        recording.finish(&step(9).frame, Some(End::TimeLimit)).unwrap();
        let take = read(recording.path()).unwrap();
        assert_eq!(take, recording.take);
        assert!(take.end.is_some_and(|end| end.done && end.truncated), "its time was up");
    }

    #[test]
    fn a_journal_of_the_first_version_is_read() {
        let info = serde_json::json!({"app": "0.1.0", "env": "dummy", "pilot": "nobody", "seed": 7});
        let row = Row {
            png: png::encode(&step(1).frame),
            action: Action::new(0.25, 0.5, 0.0),
            reward: 10.0,
            grass: true,
            contacts: None,
            wall_time_ns: 12,
            planned: true,
            state: Vec::new(),
        };
        let payloads =
            [[b"I".as_slice(), info.to_string().as_bytes()].concat(), row.to_payload(), b"E\x01png".to_vec()];
        let bytes =
            [OLD_MAGIC.to_vec(), payloads.iter().flat_map(|payload| record(payload)).collect()].concat();
        let (take, n_torn) = parse(&bytes, "old".to_owned()).unwrap();
        assert_eq!((take.rows, n_torn, take.info.seed), (vec![row], 0, 7));
        assert_eq!(take.end, Some(TakeEnd { png: b"png".to_vec(), done: true, truncated: false }));
    }

    #[test]
    fn numbers_that_are_not_finite_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let mut recording = Recording::begin(dir.path(), info(), sensors(), None).unwrap();
        let odd = [
            StepRecord { reward: f32::NAN, ..step(1) },
            StepRecord { state: vec![f32::INFINITY, 0.0], ..step(1) },
            StepRecord { action: Action { gas: f32::NAN, ..Action::default() }, ..step(1) },
            StepRecord { state: vec![1.0], ..step(1) },
        ];
        for step in odd {
            assert!(matches!(recording.push(&step), Err(DatasetError::Unfit { .. })), "{step:?}");
        }
        recording.push(&step(1)).unwrap();
        assert_eq!(read(recording.path()).unwrap().rows.len(), 1, "the recording goes on");
    }

    #[test]
    fn a_frame_of_another_size_is_refused_and_the_recording_goes_on() {
        let dir = tempfile::tempdir().unwrap();
        let mut recording = Recording::begin(dir.path(), info(), sensors(), None).unwrap();
        recording.push(&step(1)).unwrap();
        let other = StepRecord { frame: Frame::new(2, vec![0; 12]), ..step(2) };
        let message = recording.push(&other).unwrap_err().to_string();
        assert!(message.starts_with("a frame of 2 pixels a side cannot join frames of 4"), "{message}");
        recording.push(&step(3)).unwrap();
        assert_eq!(recording.n_steps(), 2);
    }
}
