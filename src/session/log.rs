//! The log of a session on disk: one event a line, appended and never edited.

use std::fs::{File, TryLockError};
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::Path;

use crate::run::Appender;
use crate::session::error::SessionError;
use crate::session::event::{Entry, Event, LineError, has_event};
use crate::text::{is_utf16, shown, trimmed};

/// As many bytes of a log are read at first to find its last line.
const TAIL: u64 = 1 << 12;

/// What a log holds.
#[derive(Debug, Default, PartialEq)]
pub struct Contents {
    /// Its lines.
    pub entries: Vec<Entry>,
    /// Which line of the file each of them is, the first being 1: blank ones count.
    pub lines: Vec<usize>,
    /// What stands behind the last line without being one: a write that was cut short, never acknowledged.
    pub torn: Option<String>,
    /// How many bytes the lines have.
    len: u64,
    /// Whether the end of the last line is missing.
    unended: bool,
}

/// Reads the log at `path` and changes nothing.
pub fn read(path: &Path) -> Result<Contents, SessionError> {
    let bytes = std::fs::read(path).map_err(SessionError::disk("read the session log", path))?;
    parse(&bytes, path)
}

/// When the last line of the log at `path` was written, in milliseconds since 1970, reading no more than its end.
///
/// None where no line can be read.
pub fn last_at(path: &Path) -> Option<u64> {
    let mut file = File::open(path).ok()?;
    let len = file.metadata().ok()?.len();
    let mut start = len.saturating_sub(TAIL);
    loop {
        let mut bytes = Vec::new();
        file.seek(SeekFrom::Start(start)).ok()?;
        file.read_to_end(&mut bytes).ok()?;
        // What is read first is the rest of a line, unless it is the first one.
        let n_cut =
            if start == 0 { 0 } else { bytes.iter().position(|&byte| byte == b'\n').unwrap_or(bytes.len()) };
        let mut lines = bytes[n_cut..].rsplit(|&byte| byte == b'\n');
        let at = lines.find_map(|line| Entry::from_line(trimmed(line)).ok()).map(|entry| entry.at);
        if at.is_some() || start == 0 {
            return at;
        }
        start = len.saturating_sub(16 * (len - start));
    }
}

/// What the bytes of a log hold, wherever it lies: a pure function, which takes whatever bytes there are.
///
/// A mark of the encoding, blank lines and carriage returns mean nothing and are passed over.
pub fn parse(bytes: &[u8], path: &Path) -> Result<Contents, SessionError> {
    if is_utf16(bytes) {
        return Err(SessionError::Line { line: 1, met: LineError::Utf16, path: path.to_owned() });
    }
    let mut contents = Contents::default();
    for (i, line) in bytes.split_inclusive(|&byte| byte == b'\n').enumerate() {
        let wrong = |met| SessionError::Line { line: i + 1, met, path: path.to_owned() };
        let is_last = contents.len as usize + line.len() == bytes.len();
        let said = trimmed(line);
        if !said.is_empty() {
            let entry = match Entry::from_line(said) {
                Ok(entry) => entry,
                // Where a whole event is in it, more than half a line would be lost.
                Err(LineError::Torn(_)) if is_last && !has_event(said) => {
                    contents.torn = Some(String::from_utf8_lossy(line).into_owned());
                    break;
                }
                Err(e) => return Err(wrong(e)),
            };
            let next = contents.entries.len();
            if entry.seq != next as u64 {
                return Err(wrong(LineError::Number { found: entry.seq, next }));
            }
            contents.entries.push(entry);
            contents.lines.push(i + 1);
        }
        contents.len += line.len() as u64;
        contents.unended = !line.ends_with(b"\n");
    }
    Ok(contents)
}

/// A log that is open for writing, by nobody else.
#[derive(Debug)]
pub struct Log {
    file: Appender,
    /// How many lines are safely on disk.
    n_lines: u64,
}

impl Log {
    /// A new log at `path`, where there must be none.
    pub fn create(path: &Path) -> Result<Self, SessionError> {
        let file = Appender::create(path).map_err(SessionError::disk("make the session log", path))?;
        lock(&file)?;
        Ok(Self { file, n_lines: 0 })
    }

    /// The log at `path` and what it holds. A torn end is cut off.
    pub fn open(path: &Path) -> Result<(Self, Contents), SessionError> {
        let mut file = Appender::open(path).map_err(SessionError::disk("open the session log", path))?;
        lock(&file)?;
        let bytes = file.read().map_err(SessionError::disk("read the session log", path))?;
        let contents = parse(&bytes, path)?;
        file.cut(contents.len).map_err(SessionError::disk("cut a torn line off the session log", path))?;
        let mut log = Self { file, n_lines: contents.entries.len() as u64 };
        if let Some(torn) = &contents.torn {
            log::warn!("the last line was cut short and is dropped: {}: {}", shown(torn), path.display());
        }
        if contents.unended {
            log.write(b"\n", true, "end the last line of the session log")?;
        }
        Ok((log, contents))
    }

    /// Appends `event`; when this returns it is on disk under the log's name, or the log is as it was.
    ///
    /// What was merely asked is on disk only with the next line that is not: by itself it is no loss, and waiting for
    /// the disk twice an answer would be felt.
    pub fn append(&mut self, event: Event, at: u64) -> Result<Entry, SessionError> {
        let entry = Entry { event, seq: self.n_lines, at };
        let line = entry.to_line() + "\n";
        let can_wait = matches!(entry.event, Event::Asked { .. } | Event::AskedTransition { .. });
        self.write(line.as_bytes(), !can_wait, "write to the session log")?;
        self.n_lines += 1;
        Ok(entry)
    }

    /// Appends all of `entries`, which have the numbers that are next, in one go.
    pub(super) fn append_all(&mut self, entries: &[Entry]) -> Result<(), SessionError> {
        let lines: String = entries.iter().map(|entry| entry.to_line() + "\n").collect();
        self.write(lines.as_bytes(), true, "write to the session log")?;
        self.n_lines += entries.len() as u64;
        Ok(())
    }

    fn write(&mut self, bytes: &[u8], is_synced: bool, tried: &'static str) -> Result<(), SessionError> {
        let appended = self.file.append(bytes, is_synced);
        appended.map_err(|met| SessionError::append(tried, self.file.path())(met))
    }

    /// Whether the log still is what its name says.
    pub fn check(&self) -> Result<(), SessionError> {
        self.file.check().map_err(SessionError::append("look at the session log", self.file.path()))
    }

    /// Forces all lines to disk, those that could wait among them.
    pub(super) fn sync(&self) -> Result<(), SessionError> {
        self.file.sync().map_err(SessionError::disk("write to the session log", self.file.path()))
    }

    /// How many lines it has.
    pub fn n_lines(&self) -> u64 {
        self.n_lines
    }
}

/// The log at `path`, which nobody else writes as long as this is held.
pub(super) fn hold(path: &Path) -> Result<Appender, SessionError> {
    let file = Appender::open(path).map_err(SessionError::disk("open the session log", path))?;
    lock(&file)?;
    Ok(file)
}

/// Keeps other programs from writing. The system lifts this when the program ends, however it ends.
fn lock(file: &Appender) -> Result<(), SessionError> {
    match file.lock() {
        Ok(()) => Ok(()),
        Err(TryLockError::WouldBlock) => Err(SessionError::InUse { path: file.path().to_owned() }),
        Err(TryLockError::Error(e)) => {
            log::warn!("cannot keep other programs from writing a session: {e}: {}", file.path().display());
            Ok(())
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::query::{DreamId, Preference, QueryId, Response, SafetyAnswer, SegmentRef, SkipReason};
    use crate::session::event::{Answer, Choice, Fit};

    fn any_event() -> impl Strategy<Value = Event> {
        let query = || any::<u32>().prop_map(QueryId);
        let segment = || {
            (any::<u32>(), 0usize..1 << 40)
                .prop_map(|(dream, start)| SegmentRef { dream: DreamId(dream), start })
        };
        let response = prop_oneof![
            Just(Response::Skipped(None)),
            Just(Response::Skipped(Some(SkipReason::Ambiguous))),
            Just(Response::Preferred(Preference::Left)),
            Just(Response::Safety(SafetyAnswer::Neither)),
            Just(Response::Safety(SafetyAnswer::Both(Preference::Equal))),
        ];
        let answer = (query(), response, 0.0f32..1e6, any::<String>(), proptest::option::of(0usize..20));
        let fit = (any::<u64>(), any::<u64>(), prop::collection::vec(0.0f32..1e9, 0..4));
        prop_oneof![
            (query(), segment(), segment()).prop_map(|(query, left, right)| {
                Event::Asked { query, left, right, choice: Choice::Repeat(query) }
            }),
            answer.prop_map(|(query, response, secs, annotator, left_unsafe_from)| {
                Event::Answered(Answer { left_unsafe_from, ..Answer::new(query, response, secs, &annotator) })
            }),
            query().prop_map(|query| Event::Retracted { query }),
            fit.prop_map(|(after, seed, losses)| Event::Fitted {
                fit: Fit { after, n_labels: 1, seed, epochs: 2, losses, held_out: Some(0.1) },
                file: "reward/0000.safetensors".to_owned(),
                sha256: String::new(),
            }),
        ]
    }

    proptest! {
        #[test]
        fn any_bytes_are_a_log_or_an_error(bytes in any::<Vec<u8>>()) {
            drop(parse(&bytes, Path::new("log")));
        }

        #[test]
        fn what_is_appended_is_what_is_read(events in prop::collection::vec((any_event(), any::<u64>()), 0..12)) {
            let mut bytes = Vec::new();
            let mut entries = Vec::new();
            for (i, (event, at)) in events.into_iter().enumerate() {
                let entry = Entry { event, seq: i as u64, at };
                bytes.extend_from_slice((entry.to_line() + "\n").as_bytes());
                entries.push(entry);
            }
            prop_assert_eq!(parse(&bytes, Path::new("log")).unwrap().entries, entries);
        }
    }

    fn flagged(n: u32) -> Event {
        Event::Flagged { query: QueryId(n) }
    }

    #[test]
    fn cutting_the_last_line_anywhere_loses_at_most_that_line() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("events.jsonl");
        let mut log = Log::create(&path).unwrap();
        let first = log.append(flagged(0), 1).unwrap();
        let kept = log.file.len() as usize;
        log.append(flagged(1), 2).unwrap();
        drop(log);
        let whole = std::fs::read(&path).unwrap();
        for len in kept..=whole.len() {
            std::fs::write(&path, &whole[..len]).unwrap();
            let (mut log, contents) = Log::open(&path).unwrap();
            assert_eq!(contents.entries[0], first);
            let n = contents.entries.len();
            // Without its end the line is whole.
            assert_eq!(n, if len + 1 >= whole.len() { 2 } else { 1 }, "cut at {len}");
            log.append(flagged(7), 3).unwrap();
            drop(log);
            let after = read(&path).unwrap();
            assert_eq!((after.entries.len(), after.torn), (n + 1, None), "cut at {len}");
        }
    }

    #[test]
    fn when_something_last_happened_is_read_off_the_end() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("events.jsonl");
        assert_eq!(last_at(&path), None, "there is no log");
        let mut log = Log::create(&path).unwrap();
        assert_eq!(last_at(&path), None, "nothing has happened");
        log.append(flagged(0), 3).unwrap();
        assert_eq!(last_at(&path), Some(3), "the first line is the last");
        for at in 4..300 {
            log.append(flagged(1), at).unwrap();
        }
        assert!(log.file.len() > TAIL);
        assert_eq!(last_at(&path), Some(299));
        let fit = Fit { after: 0, n_labels: 1, seed: 0, epochs: 2, losses: vec![0.3; 5000], held_out: None };
        log.append(Event::Fitted { fit, file: String::new(), sha256: String::new() }, 400).unwrap();
        assert_eq!(last_at(&path), Some(400), "a line longer than what is read at first");
        log.write(b"{\"event\":\"fla", true, "tear a line").unwrap();
        assert_eq!(last_at(&path), Some(400), "a torn line has not happened");
    }

    #[test]
    fn a_bad_line_in_the_middle_is_named() {
        let good = |seq| Entry { event: flagged(0), seq, at: 0 }.to_line();
        let text = format!("{}\n{{\"event\":\"fla\n{}\n", good(0), good(2));
        let refused = parse(text.as_bytes(), Path::new("log")).unwrap_err().to_string();
        assert!(
            refused.starts_with("line 2 of the session log is not an event: it is not JSON"),
            "{refused}"
        );
        let refused = parse(format!("{}\n{}\n", good(0), good(2)).as_bytes(), Path::new("log")).unwrap_err();
        assert!(refused.to_string().contains("it has the number 2 where 1 is next"), "{refused}");
    }

    #[test]
    fn what_means_nothing_between_lines_is_passed_over() {
        let good = |seq| Entry { event: flagged(0), seq, at: 0 }.to_line();
        let text = format!("\u{feff}{}\r\n\r\n  \n\u{feff}{}\n\n\n", good(0), good(1));
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("events.jsonl");
        std::fs::write(&path, &text).unwrap();
        let (mut log, contents) = Log::open(&path).unwrap();
        assert_eq!((contents.entries.len(), &contents.lines[..], contents.torn), (2, &[1, 4][..], None));
        log.append(flagged(2), 3).unwrap();
        drop(log);
        let after = std::fs::read_to_string(&path).unwrap();
        assert!(after.starts_with(&text), "nothing that was there is changed: {after:?}");
        assert_eq!(read(&path).unwrap().entries.len(), 3);
        assert_eq!(last_at(&path), Some(3));
    }

    #[test]
    fn a_log_in_another_encoding_is_refused_and_not_cut() {
        let text: Vec<u8> = "\u{feff}{}\n".encode_utf16().flat_map(u16::to_le_bytes).collect();
        let refused = parse(&text, Path::new("log")).unwrap_err().to_string();
        assert!(refused.contains("UTF-16"), "{refused}");
    }

    #[test]
    fn a_last_line_of_a_later_program_is_an_error_and_not_cut() {
        let line = "{\"event\":\"sung\",\"seq\":0,\"at\":0}\n";
        let refused = parse(line.as_bytes(), Path::new("log")).unwrap_err().to_string();
        assert!(refused.contains("unknown variant `sung`"), "{refused}");
    }

    #[test]
    fn two_writers_are_one_too_many() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("events.jsonl");
        let first = Log::create(&path).unwrap();
        assert!(matches!(Log::open(&path), Err(SessionError::InUse { .. })));
        drop(first);
        assert!(Log::open(&path).is_ok());
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_is_one_clear_error_and_no_line() {
        let full = Path::new("/dev/full");
        let mut log = Log { file: Appender::open(full).unwrap(), n_lines: 3 };
        let refused = log.append(flagged(0), 0).unwrap_err().to_string();
        assert_eq!(
            refused,
            "cannot write to the session log: No space left on device (os error 28); free some space on this disk, or \
             choose another place: \"/dev/full\""
        );
        assert_eq!(log.n_lines(), 3);
    }
}
