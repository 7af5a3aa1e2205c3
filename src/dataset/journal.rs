//! The journal of an episode that is being driven: what a killed program leaves behind.
//!
//! ```text
//! journal/00001767225600123456789.journal
//!   "dropj journal 3\n", then records: length u32, the first 8 bytes of the SHA-256, payload
//!   payload: 'I' info as JSON
//!            · 'S' wall clock i64, action f32 each, reward f32, flags u8, events u8 each, state f32 each, PNG
//!            · 'E' end u8, PNG
//! ```
//!
//! The info names what the action, the events and the state hold. The lowest bit of the flags is whether the planner drove.
//! An event is 1 where it goes on, and 0 elsewhere. The end is 0 where the driver ended it, 1 where the world did by what
//! happened in it, 2 where that was from outside. Numbers are little-endian. A torn last record is dropped, with a warning.
//!
//! Journals of older versions are read as well.

use std::fs::{self, File};
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::damage::Unfit;
use super::disk::JOURNAL_EXTENSION;
use super::{DatasetError, EpisodeInfo, Layout, StepRecord, disk, legacy, limits, png};
use crate::run::{Appender, log_saved};
use crate::world::{Action, End, Frame, Size};

/// What a journal begins with.
const MAGIC: &[u8; 16] = b"dropj journal 3\n";
/// What the journals begin with that can be read.
const MAGICS: [&[u8; 16]; 3] = [legacy::FIRST_MAGIC, legacy::SECOND_MAGIC, MAGIC];
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
    size: Option<Size>,
    pub(super) take: Take,
}

/// What is known of an episode before it is sealed.
#[derive(Debug, PartialEq)]
pub(super) struct Take {
    /// The journal's name, which is kept in the sealed file so that nothing is sealed twice.
    pub(super) id: String,
    /// Who drove where.
    pub(super) info: EpisodeInfo,
    /// What its steps have.
    pub(super) layout: Layout,
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
    /// Which events go on after it.
    pub(super) events: Vec<bool>,
    pub(super) wall_time_ns: i64,
    /// Whether the planner drove, and not whoever is named as the pilot.
    pub(super) planned: bool,
    /// What was measured before the action.
    pub(super) state: Vec<f32>,
}

/// The frame after the last action, and whether the world ended the episode.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct TakeEnd {
    pub(super) png: Vec<u8>,
    pub(super) done: bool,
    /// Whether it did so from outside.
    pub(super) truncated: bool,
}

/// The first record of a journal.
#[derive(Serialize, Deserialize)]
struct Head {
    app: String,
    #[serde(flatten)]
    info: EpisodeInfo,
    /// Only older versions left it out, for which the names of what was measured were enough.
    layout: Option<Layout>,
    #[serde(default, skip_serializing)]
    state: Vec<String>,
}

impl Recording {
    /// Begins a journal in the dataset at `dir`, whose frames have this size where that is known.
    pub(super) fn begin(
        dir: &Path,
        info: EpisodeInfo,
        layout: Layout,
        size: Option<Size>,
    ) -> Result<Self, DatasetError> {
        let odd = limits::check_info(&info).and(limits::check_layout(&layout));
        odd.map_err(|met| DatasetError::Unfit { reason: Unfit::Limits(met), path: dir.to_path_buf() })?;
        let (id, path) = new_journal(&dir.join("journal"));
        let head = Head {
            app: env!("CARGO_PKG_VERSION").into(),
            info: info.clone(),
            layout: Some(layout.clone()),
            state: Vec::new(),
        };
        let payload = [b"I".as_slice(), &serde_json::to_vec(&head).expect("text and numbers")].concat();
        let begun = [MAGIC.as_slice(), &record(&payload)].concat();
        disk::replace(&path, &begun)?;
        Ok(Self {
            file: Appender::open(&path).map_err(DatasetError::disk("begin the journal", &path))?,
            synced: Instant::now(),
            size,
            take: Take { id, info, layout, rows: Vec::new(), end: None },
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
        let layout = &self.take.layout;
        let unfit = |reason| DatasetError::Unfit { reason, path: self.path().to_owned() };
        let (found, wanted) = (step.action.len(), layout.axes.len());
        if found != wanted {
            return Err(unfit(Unfit::Action { found, wanted }));
        }
        let (found, wanted) = (step.events.len(), layout.events.len());
        if found != wanted {
            return Err(unfit(Unfit::Events { found, wanted }));
        }
        let (found, wanted) = (step.state.len(), layout.sensors.len());
        if found != wanted {
            return Err(unfit(Unfit::Measurements { found, wanted }));
        }
        if ![step.action.as_ref(), &[step.reward], &step.state].concat().iter().all(|it| it.is_finite()) {
            let numbers = [step.action.as_ref(), &[step.reward]].concat();
            return Err(unfit(Unfit::NotFinite { numbers, state: step.state.clone() }));
        }
        if self.n_steps() >= limits::STEPS {
            return Err(unfit(Unfit::Steps(limits::STEPS)));
        }
        self.check_size(&step.frame)?;
        let row = Row {
            png: png::encode(&step.frame),
            action: step.action,
            reward: step.reward,
            events: step.events.clone(),
            wall_time_ns: step.wall_time_ns,
            planned,
            state: step.state.clone(),
        };
        self.append(&record(&row.to_payload()))?;
        self.size = Some(step.frame.size());
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
        if let (Some(tried), Some(met)) = (other.size, self.size)
            && tried != met
        {
            return Err(DatasetError::OtherSize { tried, met, path: self.path().to_owned() });
        }
        let records = other.take.rows.iter().flat_map(|row| record(&row.to_payload())).collect::<Vec<u8>>();
        self.append(&records)?;
        self.file.sync().map_err(DatasetError::disk("sync the journal", self.path()))?;
        self.size = other.size;
        self.take.rows.clone_from(&other.take.rows);
        Ok(())
    }

    /// Appends the end, which the world gave the episode, or its driver.
    pub(super) fn finish(&mut self, last_frame: &Frame, end: Option<End>) -> Result<(), DatasetError> {
        self.check_size(last_frame)?;
        let code = match end {
            None => 0,
            Some(End::Terminated) => 1,
            Some(End::Truncated) => 2,
        };
        let end = TakeEnd::of(code, png::encode(last_frame));
        self.append(&record(&[b"E".as_slice(), &[code], &end.png].concat()))?;
        self.take.end = Some(end);
        Ok(())
    }

    fn check_size(&self, frame: &Frame) -> Result<(), DatasetError> {
        match self.size {
            None if !limits::is_sane(frame.size()) => {
                let reason = Unfit::Size(frame.size());
                Err(DatasetError::Unfit { reason, path: self.path().to_owned() })
            }
            Some(met) if met != frame.size() => {
                Err(DatasetError::OtherSize { tried: frame.size(), met, path: self.path().to_owned() })
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
    fn to_payload(&self) -> Vec<u8> {
        let numbers = |numbers: &[f32]| numbers.iter().flat_map(|it| it.to_le_bytes()).collect::<Vec<u8>>();
        let events = self.events.iter().map(|&goes_on| u8::from(goes_on)).collect::<Vec<u8>>();
        [
            b"S".as_slice(),
            &self.wall_time_ns.to_le_bytes(),
            &numbers(&self.action),
            &self.reward.to_le_bytes(),
            &[u8::from(self.planned)],
            &events,
            &numbers(&self.state),
            &self.png,
        ]
        .concat()
    }

    fn from_payload(payload: &[u8], layout: &Layout) -> Option<Self> {
        let rest = payload.strip_prefix(b"S")?;
        let (wall_time_ns, rest) = rest.split_first_chunk()?;
        let (action, rest) = rest.split_at_checked(4 * layout.axes.len())?;
        let (reward, rest) = rest.split_first_chunk()?;
        let (&flags, rest) = rest.split_first()?;
        let (events, rest) = rest.split_at_checked(layout.events.len())?;
        let (state, png) = rest.split_at_checked(4 * layout.sensors.len())?;
        let row = Self {
            png: png.to_vec(),
            action: Action::new(floats(action)),
            reward: f32::from_le_bytes(*reward),
            events: events.iter().map(|&event| event == 1).collect(),
            wall_time_ns: i64::from_le_bytes(*wall_time_ns),
            planned: flags & 1 == 1,
            state: floats(state),
        };
        let is_sane = flags <= 1 && events.iter().all(|&event| event <= 1);
        (is_sane && row.is_finite()).then_some(row)
    }

    /// Whether all of its numbers are some.
    pub(super) fn is_finite(&self) -> bool {
        self.action.is_finite() && self.reward.is_finite() && self.state.iter().all(|it| it.is_finite())
    }
}

/// The numbers that some bytes stand for.
pub(super) fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.as_chunks().0.iter().map(|&number| f32::from_le_bytes(number)).collect()
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
    is_read && MAGICS.contains(&&begun)
}

/// What the bytes of the journal `id` hold, and how many are torn at their end. Nothing where the beginning is.
pub(super) fn parse(bytes: &[u8], id: String) -> Option<(Take, usize)> {
    let (magic, rest) = bytes.split_first_chunk()?;
    let (is_first, is_old) = (magic == legacy::FIRST_MAGIC, magic != MAGIC);
    if !MAGICS.contains(&magic) {
        return None;
    }
    let (payload, mut rest) = split_record(rest)?;
    let Head { info, layout, state, .. } = serde_json::from_slice(payload.strip_prefix(b"I")?).ok()?;
    let layout = if is_old { Layout { sensors: state, ..Layout::default() } } else { layout? };
    limits::check_info(&info).and(limits::check_layout(&layout)).ok()?;
    let mut take = Take { id, info, layout, rows: Vec::new(), end: None };
    while let Some((payload, after)) = split_record(rest) {
        match payload {
            [b'E', code @ 0..=2, png @ ..] => {
                let mut end = TakeEnd::of(*code, png.to_vec());
                end.truncated |= is_first && legacy::is_out_of_time(end.done, take.rows.len());
                take.end = Some(end);
            }
            // Nothing comes after the end.
            _ if take.end.is_some() || take.rows.len() >= limits::STEPS => break,
            payload => {
                let row = if is_old {
                    legacy::row(payload, &mut take)
                } else {
                    Row::from_payload(payload, &take.layout)
                };
                let Some(row) = row else { break };
                take.rows.push(row);
            }
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
            frame: Frame::square(4, vec![level; 48]),
            action: Action::new([0.25, f32::from(level) / 255.0, 0.5]),
            reward: -1.0,
            events: vec![level % 2 == 1, level == 2],
            wall_time_ns: 1_767_225_600_000_000_000 + i64::from(level),
            state: vec![f32::from(level), -0.5],
        }
    }

    fn layout() -> Layout {
        let names = |names: [&str; 2]| names.map(str::to_owned).to_vec();
        Layout { events: names(["bump", "tile"]), sensors: names(["speed", "yaw_rate"]), ..Layout::default() }
    }

    fn info() -> EpisodeInfo {
        EpisodeInfo { env: "dummy".into(), pilot: "nobody".into(), seed: u64::MAX }
    }

    #[test]
    fn a_journal_cut_at_any_byte_of_its_last_record_keeps_all_records_before() {
        let dir = tempfile::tempdir().unwrap();
        let mut recording = Recording::begin(dir.path(), info(), layout(), None).unwrap();
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
        let mut recording = Recording::begin(dir.path(), info(), layout(), None).unwrap();
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
        let mut recording = Recording::begin(dir.path(), info(), layout(), None).unwrap();
        recording.push(&step(1)).unwrap();
        recording.finish(&step(9).frame, Some(End::Truncated)).unwrap();
        let take = read(recording.path()).unwrap();
        assert_eq!(take, recording.take);
        assert!(take.end.is_some_and(|end| end.done && end.truncated), "its time was up");
    }

    #[test]
    fn a_journal_of_the_first_version_is_read() {
        let info = serde_json::json!({"app": "0.1.0", "env": "dummy", "pilot": "nobody", "seed": 7});
        let row = Row {
            png: png::encode(&step(1).frame),
            action: Action::new([0.25, 0.5, 0.0]),
            reward: 10.0,
            events: vec![true],
            wall_time_ns: 12,
            planned: true,
            state: Vec::new(),
        };
        // On the grass, by the planner.
        let payloads = [
            [b"I".as_slice(), info.to_string().as_bytes()].concat(),
            old_payload(&row, 0b1_0001),
            b"E\x01png".to_vec(),
        ];
        let (take, n_torn) = parse(&journal(legacy::FIRST_MAGIC, &payloads), "old".to_owned()).unwrap();
        assert_eq!((take.rows, n_torn, take.info.seed), (vec![row], 0, 7));
        assert_eq!(take.layout, Layout::default());
        assert_eq!(take.end, Some(TakeEnd { png: b"png".to_vec(), done: true, truncated: false }));
    }

    #[test]
    fn a_journal_of_the_second_version_says_itself_whether_there_are_obstacles() {
        let info = serde_json::json!({
            "app": "0.1.0", "env": "dummy", "pilot": "nobody", "seed": 7, "state": ["speed"],
        });
        let row = Row {
            png: png::encode(&step(1).frame),
            action: Action::new([0.25, 0.5, 0.0]),
            reward: 10.0,
            events: vec![false, true, false],
            wall_time_ns: 12,
            planned: false,
            state: vec![3.0],
        };
        let info = [b"I".as_slice(), info.to_string().as_bytes()].concat();
        let payloads = [info, old_payload(&row, 0b1010), old_payload(&row, 0), b"E\x02png".to_vec()];
        let (take, n_torn) = parse(&journal(legacy::SECOND_MAGIC, &payloads), "old".to_owned()).unwrap();
        assert_eq!(take.layout.events, ["grass", "chuckhole", "car"]);
        assert_eq!(take.layout.sensors, ["speed"]);
        assert_eq!((take.rows, take.end), (vec![row], None), "from a step of another world on it is torn");
        assert!(n_torn > 0, "and that is told");
    }

    /// A step as versions of before wrote it.
    fn old_payload(row: &Row, touched: u8) -> Vec<u8> {
        let mut payload = row.to_payload();
        // The flags and the events.
        payload.splice(25..=25 + row.events.len(), [touched]);
        payload
    }

    fn journal(magic: &[u8; 16], payloads: &[Vec<u8>]) -> Vec<u8> {
        [magic.to_vec(), payloads.iter().flat_map(|payload| record(payload)).collect()].concat()
    }

    #[test]
    fn a_journal_of_any_world_is_read() {
        let dir = tempfile::tempdir().unwrap();
        for (n_axes, n_events, n_sensors) in [(1, 0, 0), (14, 3, 42), (48, 64, 64)] {
            let names = |n: usize| (0..n).map(|i| format!("number {i}")).collect::<Vec<_>>();
            let layout = Layout {
                axes: names(n_axes),
                events: names(n_events),
                sensors: names(n_sensors),
                rate: 12.5,
            };
            let mut recording = Recording::begin(dir.path(), info(), layout, None).unwrap();
            for t in 0..3 {
                let step = StepRecord {
                    frame: Frame::new(2, 5, vec![t as u8; 30]),
                    action: Action::new(vec![0.5 * t as f32; n_axes]),
                    events: (0..n_events).map(|event| event % 3 == t).collect(),
                    state: vec![-1.5 * t as f32; n_sensors],
                    ..step(1)
                };
                recording.push_by(&step, t == 1).unwrap();
            }
            assert_eq!(read(recording.path()).unwrap(), recording.take);
        }
    }

    #[test]
    fn a_layout_that_cannot_be_is_refused_before_anything_is_driven() {
        let dir = tempfile::tempdir().unwrap();
        let names = |names: &[&str]| names.iter().map(|&name| name.to_owned()).collect::<Vec<_>>();
        let odd = [
            (Layout { axes: names(&[]), ..layout() }, "it names 0 axes, and must name 1 to 48"),
            (Layout { axes: vec!["a".to_owned(); 49], ..layout() }, "it names 49 axes"),
            (Layout { events: vec!["a".to_owned(); 65], ..layout() }, "it names 65 events"),
            (Layout { axes: names(&[""]), ..layout() }, "one of its axes is called \"\", which is no name"),
            (Layout { sensors: names(&["a\nb"]), ..layout() }, "which is no name"),
            (Layout { rate: f64::NAN, ..layout() }, "NaN steps a second"),
            (Layout { rate: 0.0, ..layout() }, "0 steps a second"),
            (
                Layout { events: names(&["new tile", "New-tile"]), ..layout() },
                r#"its events "new tile" and "New-tile" would both be the column next.new_tile"#,
            ),
            (
                Layout { events: names(&["done"]), ..layout() },
                r#"its event "done" would be the column next.done, which tells something else"#,
            ),
        ];
        for (layout, wanted) in odd {
            let refused = Recording::begin(dir.path(), info(), layout, None).err().unwrap().to_string();
            assert!(refused.starts_with("this cannot be recorded") && refused.contains(wanted), "{refused}");
        }
        assert!(!dir.path().join("journal").exists(), "nothing is begun");
    }

    #[test]
    fn numbers_that_are_not_finite_are_refused_and_so_is_what_has_too_few_of_them() {
        let dir = tempfile::tempdir().unwrap();
        let mut recording = Recording::begin(dir.path(), info(), layout(), None).unwrap();
        let odd = [
            StepRecord { reward: f32::NAN, ..step(1) },
            StepRecord { state: vec![f32::INFINITY, 0.0], ..step(1) },
            StepRecord { action: Action::new([0.0, f32::NAN, 0.0]), ..step(1) },
            StepRecord { action: Action::new([0.0; 2]), ..step(1) },
            StepRecord { events: vec![true], ..step(1) },
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
        let mut recording = Recording::begin(dir.path(), info(), layout(), None).unwrap();
        recording.push(&step(1)).unwrap();
        let other = StepRecord { frame: Frame::square(2, vec![0; 12]), ..step(2) };
        let message = recording.push(&other).unwrap_err().to_string();
        assert!(message.starts_with("a frame of 2 x 2 pixels cannot join frames of 4 x 4"), "{message}");
        recording.push(&step(3)).unwrap();
        assert_eq!(recording.n_steps(), 2);
    }
}
