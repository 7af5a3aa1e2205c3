//! A damaged session made readable again: what can be read is kept, and what was left out is said line by line.
//!
//! Nothing is destroyed: what stood there is kept beside it. What a line lost can make later ones impossible, or
//! mean another query than they say; so queries and dreams are numbered anew, and what is about one that is lost goes
//! with it. The two halves without files, [`mend_header`] and [`mend_log`], take whatever bytes there are.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

use crate::query::{DreamId, Preference, Protocol, QueryId, Response, SegmentRef, Transition, Weights};
use crate::session::error::{HeaderError, Impossible, SessionError};
use crate::session::event::{Choice, DreamSource, Entry, Event, KeptDream, LineError, objects_in};
use crate::session::header::{self, FORMAT, Header};
use crate::session::{Answer, Session, arrays, check, log, store};
use crate::tensor::sha256;
use crate::text::{decoded, is_utf16, shown, trimmed};
use crate::world::WorldSpec;

/// What the name of a file that was repaired ends in.
const BEFORE: &str = "before-repair";
/// So many dreams in a row are looked for in their files where the log lost them.
const MOST_DREAMS: u32 = 10_000;

/// What a repair came to.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Repair {
    /// What was left out, or put in, and why; of the header first, then line by line.
    pub notes: Vec<Note>,
    /// How many events are kept.
    pub n_kept: usize,
    /// Where the damaged files are kept. None where nothing was to be repaired.
    pub kept_beside: Vec<PathBuf>,
}

/// A line that is not kept as it stood, or something that had to be put in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Note {
    /// The line of the log, the first being 1. Nothing where it is about the header.
    pub line: Option<usize>,
    /// What is done about it, and why.
    pub what: String,
}

/// What a header is made anew of, where it cannot be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Origin {
    /// The hash of the world model that the dreams were dreamed with.
    pub world_model: String,
    /// The environment that it was trained on.
    pub env: String,
}

/// Repairs the session in `dir`, or only says what would be done where it `is_trial`.
///
/// `origin` helps where the header is lost. Without it that is an error.
pub fn repair(dir: &Path, origin: Option<&Origin>, is_trial: bool) -> Result<Repair, SessionError> {
    let (header_path, log_path) = (dir.join(header::FILE), dir.join(store::LOG_FILE));
    let header_bytes = read_if_there(&header_path, "read the session's header")?;
    let log_bytes = read_if_there(&log_path, "read the session log")?;
    if header_bytes.is_none() && log_bytes.is_none() {
        return Err(SessionError::NoSession { path: dir.to_owned() });
    }
    // Nobody is to write while it is repaired.
    let _lock = log_bytes.as_ref().map(|_| log::hold(&log_path)).transpose()?;
    let mut repair = Repair::default();

    let found = header_bytes.as_deref().unwrap_or_default();
    let whole = Header::parse(found, &header_path);
    let is_header_whole = whole.is_ok();
    let header = match whole {
        Ok(header) => header,
        Err(e @ SessionError::Format { .. }) => return Err(e),
        Err(_) => {
            let mended = mend_header(found).or_else(|why| {
                let origin =
                    origin.ok_or_else(|| SessionError::LostHeader { met: why, path: header_path.clone() })?;
                Ok::<_, SessionError>(header_anew(origin, log_bytes.as_deref().unwrap_or_default()))
            })?;
            repair.notes.extend(mended.1.into_iter().map(|what| Note { line: None, what }));
            mended.0
        }
    };

    let found = log_bytes.as_deref().unwrap_or_default();
    // Of a log that was emptied the dreams are left, if there were any.
    let is_emptied = trimmed(found).is_empty() && recovered(dir, 0).is_some();
    let is_log_whole = log_bytes.is_some()
        && !is_emptied
        && log::parse(found, &log_path).is_ok_and(|contents| {
            contents.torn.is_none() && header.session().folded(&contents.entries).is_ok()
        });
    let mut recover = |dream: u32| recovered(dir, dream);
    let mended = if is_log_whole { None } else { Some(mend_log(found, &header, &mut recover)) };
    repair.n_kept = match &mended {
        Some(mended) => mended.entries.len(),
        None => log::parse(found, &log_path)?.entries.len(),
    };
    repair.notes.extend(mended.iter().flat_map(|mended| mended.notes.clone()));
    if is_trial {
        return Ok(repair);
    }
    if !is_header_whole {
        repair.kept_beside.extend(keep_beside(&header_path, header_bytes.as_deref())?);
        header.write(dir)?;
    }
    if let Some(mended) = mended {
        repair.kept_beside.extend(keep_beside(&log_path, log_bytes.as_deref())?);
        arrays::write_whole(&log_path, &mended.to_bytes(), "write the repaired session log")?;
    }
    Ok(repair)
}

fn read_if_there(path: &Path, tried: &'static str) -> Result<Option<Vec<u8>>, SessionError> {
    match std::fs::read(path) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(None),
        read => read.map(Some).map_err(SessionError::disk(tried, path)),
    }
}

/// Puts the damaged `bytes` of the file at `path` beside it, under a name that is free.
fn keep_beside(path: &Path, bytes: Option<&[u8]>) -> Result<Option<PathBuf>, SessionError> {
    let Some(bytes) = bytes else { return Ok(None) };
    let numbered = (2..).map(|n| path.with_added_extension(format!("{BEFORE}-{n}")));
    let mut names = std::iter::once(path.with_added_extension(BEFORE)).chain(numbered);
    let beside = names.find(|path| !path.exists()).unwrap_or_else(|| unreachable!("there are names enough"));
    arrays::write_whole(&beside, bytes, "keep the damaged file beside the repaired one")?;
    Ok(Some(beside))
}

/// The dream of this number as its file tells of it, where the log lost the line.
fn recovered(dir: &Path, dream: u32) -> Option<KeptDream> {
    let file = store::dream_file(DreamId(dream));
    let bytes = std::fs::read(dir.join(&file)).ok()?;
    let episode = arrays::dream_from_bytes(&bytes).ok()?;
    let len = episode.len();
    let mut marks: Vec<_> = episode.unsafe_marks.iter().copied().filter(|mark| *mark < len).collect();
    marks.sort_unstable();
    marks.dedup();
    Some(KeptDream {
        dream: DreamId(dream),
        len,
        seed: episode.seed,
        marks,
        source: DreamSource::User,
        acquisition: None,
        planned: episode.n_planned(),
        file,
        sha256: sha256(&bytes),
    })
}

/// The head in damaged bytes, and what had to be changed; or why there is none.
pub fn mend_header(bytes: &[u8]) -> Result<(Header, Vec<String>), HeaderError> {
    let text = decoded(bytes);
    let start = text.find('{').ok_or(HeaderError::None)?;
    let mut fields = match serde_json::Deserializer::from_str(&text[start..]).into_iter().next() {
        Some(Ok(Value::Object(fields))) => fields,
        Some(Err(e)) => return Err(HeaderError::NotJson(e)),
        _ => return Err(HeaderError::None),
    };
    let mut notes = Vec::new();
    match fields.get("format").and_then(Value::as_u64) {
        Some(found) if found > u64::from(FORMAT) => {
            return Err(HeaderError::Later { found, known: FORMAT });
        }
        Some(1..) => {}
        _ => put(&mut fields, "format", FORMAT.into(), &mut notes),
    }
    let text = |fields: &Map<String, Value>, name: &'static str| {
        let text = fields.get(name).and_then(Value::as_str).map(str::to_owned);
        text.ok_or(HeaderError::Missing(name))
    };
    let env = text(&fields, "env")?;
    text(&fields, "world_model")?;
    if text(&fields, "app").is_err() {
        put(&mut fields, "app", "unknown".into(), &mut notes);
    }
    for name in ["seed", "created_at"] {
        if fields.get(name).and_then(Value::as_u64).is_none() {
            put(&mut fields, name, 0.into(), &mut notes);
        }
    }
    let protocol = fields.get("protocol").cloned().unwrap_or_default();
    if serde_json::from_value::<Protocol>(protocol).is_err() {
        let usual = serde_json::to_value(Protocol::of(&WorldSpec::of_name(&env))).unwrap_or_default();
        put(&mut fields, "protocol", usual, &mut notes);
    }
    if fields.get("world_model_path").is_some_and(|path| !path.is_string() && !path.is_null()) {
        fields.remove("world_model_path");
        notes.push("its \"world_model_path\" is left out, for it is no path".to_owned());
    }
    let mut config = match fields.remove("config") {
        Some(Value::Object(config)) => config,
        _ => Map::new(),
    };
    let weights = config.get("weights").cloned().unwrap_or_default();
    let weights = serde_json::from_value::<Weights>(weights).ok();
    if weights.is_none_or(|weights| check::check_weights(&weights).is_err()) {
        let usual = serde_json::to_value(Weights::of(&WorldSpec::of_name(&env))).unwrap_or_default();
        put(&mut config, "weights", usual, &mut notes);
    }
    if config.get("annotator").is_some_and(|annotator| !annotator.is_string()) {
        config.remove("annotator");
        notes.push("its \"annotator\" is left out, for it is no name".to_owned());
    }
    leave_out_others(&mut config, &["weights", "annotator"], &mut notes);
    fields.insert("config".to_owned(), Value::Object(config));
    let known = [
        "format",
        "app",
        "env",
        "protocol",
        "seed",
        "world_model",
        "world_model_path",
        "created_at",
        "config",
    ];
    leave_out_others(&mut fields, &known, &mut notes);
    if notes.is_empty() {
        notes.push("what stood around the header is left out".to_owned());
    }
    let header = serde_json::from_value(Value::Object(fields)).map_err(HeaderError::Json)?;
    Ok((header, notes))
}

/// Puts a value in place of one that is missing or cannot be.
fn put(fields: &mut Map<String, Value>, name: &str, value: Value, notes: &mut Vec<String>) {
    notes.push(match fields.get(name) {
        Some(met) => {
            format!("its {name:?} is {value} from here on, for {} cannot be", shown(&met.to_string()))
        }
        None => format!("its {name:?} is missing, and {value} from here on"),
    });
    fields.insert(name.to_owned(), value);
}

fn leave_out_others(fields: &mut Map<String, Value>, known: &[&str], notes: &mut Vec<String>) {
    let others: Vec<_> = fields.keys().filter(|name| !known.contains(&name.as_str())).cloned().collect();
    for name in others {
        fields.remove(&name);
        notes.push(format!("{} is left out, for this program does not know it", shown(&format!("{name:?}"))));
    }
}

/// A head for a log that has none, and what is to be known of it.
fn header_anew(origin: &Origin, log: &[u8]) -> (Header, Vec<String>) {
    let entries: Vec<_> = lines(log).flat_map(|(_, line)| events_in(&line).0).collect();
    let at = entries.iter().map(|entry| entry.at).min().unwrap_or_default();
    let mut answers = entries.iter().filter_map(|entry| match &entry.event {
        Event::Answered(answer) => Some(answer),
        _ => None,
    });
    let first = answers.clone().find_map(|answer| asked_under(answer.response));
    let protocol = first.unwrap_or(Protocol::of(&WorldSpec::of_name(&origin.env)));
    let mut header = Header::new(&origin.env, protocol, 0, &origin.world_model, at);
    if let Some(answer) = answers.next_back() {
        header.config.annotator.clone_from(&answer.annotator);
    }
    let protocol = protocol.name();
    let what = format!(
        "it is made anew: {protocol} in {:?}, with the world model that is given and the usual weights",
        origin.env
    );
    (header, vec![what])
}

/// A protocol that asks for such a response. Nothing where all do.
fn asked_under(response: Response) -> Option<Protocol> {
    match response {
        Response::Skipped(_) => None,
        Response::Preferred(Preference::Equal) => Some(Protocol::Drope),
        Response::Preferred(_) => Some(Protocol::Drop),
        Response::Safety(_) => Some(Protocol::Dropj),
        Response::Justified(..) => Some(Protocol::DropjMulti),
        Response::Judged(_) => Some(Protocol::Dros),
    }
}

/// What could be kept of a log.
#[derive(Clone, Debug, PartialEq)]
pub struct MendedLog {
    /// The events, numbered anew.
    pub entries: Vec<Entry>,
    /// What was left out or put in.
    pub notes: Vec<Note>,
    /// Where each of them was, by the number that it had.
    old: Vec<u64>,
}

impl MendedLog {
    /// The log of them.
    pub fn to_bytes(&self) -> Vec<u8> {
        self.entries.iter().flat_map(|entry| (entry.to_line() + "\n").into_bytes()).collect()
    }
}

/// What can be kept of the log in `bytes`, of the session with this head.
///
/// `recover` tells of a dream whose line is lost, if its file is there.
pub fn mend_log(
    bytes: &[u8],
    header: &Header,
    recover: &mut dyn FnMut(u32) -> Option<KeptDream>,
) -> MendedLog {
    let log = MendedLog { entries: Vec::new(), notes: Vec::new(), old: Vec::new() };
    let mut mending = Mending {
        session: header.session(),
        log,
        met: BTreeSet::new(),
        dreams: BTreeMap::new(),
        queries: BTreeMap::new(),
        line: 0,
        at: header.created_at,
        recover,
    };
    for (line, text) in lines(bytes) {
        mending.line = line;
        let (entries, rest) = events_in(&text);
        if entries.len() > 1 {
            mending.note(format!("{} events stand in it, and each gets a line of its own", entries.len()));
        }
        for entry in entries {
            mending.take(entry);
        }
        if let Some(rest) = rest {
            mending.note(format!("left out: {rest}"));
        }
    }
    // Where nothing at all is left, the dreams are.
    if mending.log.entries.is_empty() {
        mending.line = 0;
        let _: Option<u32> = (0..MOST_DREAMS).find(|dream| mending.recover(*dream).is_none());
    }
    let mut log = mending.log;
    let is_as_before = log.old.iter().copied().eq(0..log.entries.len() as u64);
    if log.notes.is_empty() && !is_as_before {
        log.notes.push(Note { line: None, what: "the lines are numbered anew".to_owned() });
    }
    log
}

/// The lines of a log with their numbers, without what means nothing.
fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, Vec<u8>)> {
    let bytes = if is_utf16(bytes) { decoded(bytes).into_owned().into_bytes() } else { bytes.to_owned() };
    let lines: Vec<_> = bytes.split(|&byte| byte == b'\n').map(<[u8]>::to_vec).collect();
    lines
        .into_iter()
        .enumerate()
        .map(|(i, line)| (i + 1, trimmed(&line).to_vec()))
        .filter(|(_, line)| !line.is_empty())
}

/// The events in a line, and what else is in it.
fn events_in(line: &[u8]) -> (Vec<Entry>, Option<String>) {
    match Entry::from_line(line) {
        Ok(entry) => return (vec![entry], None),
        Err(LineError::Torn(_)) => {}
        Err(met) => {
            return (Vec::new(), Some(format!("it is not an event ({})", shown(&met.to_string()))));
        }
    }
    let (mut entries, mut rest) = (Vec::new(), Vec::new());
    let mut from = 0;
    for (range, value) in objects_in(line) {
        rest.extend_from_slice(&line[from..range.start]);
        from = range.end;
        match Entry::from_value(value) {
            Ok(entry) => entries.push(entry),
            Err(_) => rest.extend_from_slice(&line[range]),
        }
    }
    rest.extend_from_slice(&line[from..]);
    let n_bytes = rest.len();
    rest.retain(|&byte| byte != 0);
    let n_zeros = n_bytes - rest.len();
    let rest = trimmed(&rest);
    let rest = String::from_utf8_lossy(rest);
    let is_mark = ["<<<<<<<", "=======", ">>>>>>>", "|||||||"].iter().any(|mark| rest.starts_with(mark));
    let what = if is_mark {
        Some("a mark of a merge that was not finished".to_owned())
    } else if !rest.is_empty() {
        let zeros = if n_zeros == 0 { String::new() } else { format!(", and {n_zeros} zeros") };
        Some(format!("{} bytes that are no event: {}{zeros}", rest.len(), shown(&rest)))
    } else if n_zeros > 0 {
        Some(format!("{n_zeros} zeros, as a crash of the machine leaves them"))
    } else {
        None
    };
    (entries, what)
}

/// Why an event is not kept.
#[derive(Debug, thiserror::Error)]
enum NotKept {
    /// It cannot have happened.
    #[error(transparent)]
    Impossible(Impossible),
    /// Neither the log nor a file tells of its dream.
    #[error("it is about dream {}, of which the line and the file are lost", u64::from(.0.0) + 1)]
    LostDream(DreamId),
    /// The log does not tell of its query.
    #[error("it is about query {}, and the line that asked it is lost", .0.0)]
    LostQuery(QueryId),
    /// The same dream was kept before.
    #[error("this dream is there already")]
    Twice,
}

impl From<Impossible> for NotKept {
    fn from(why: Impossible) -> Self {
        Self::Impossible(why)
    }
}

/// A log that is being mended.
struct Mending<'a> {
    session: Session,
    log: MendedLog,
    /// The lines that were met, to know what stands there twice.
    met: BTreeSet<String>,
    /// The new numbers of dreams and queries by those that they had.
    dreams: BTreeMap<DreamId, DreamId>,
    queries: BTreeMap<QueryId, QueryId>,
    line: usize,
    at: u64,
    recover: &'a mut dyn FnMut(u32) -> Option<KeptDream>,
}

impl Mending<'_> {
    fn note(&mut self, what: String) {
        let line = (self.line > 0).then_some(self.line);
        self.log.notes.push(Note { line, what });
    }

    /// Keeps an event as far as it can have happened.
    fn take(&mut self, entry: Entry) {
        self.at = entry.at;
        if !self.met.insert(entry.to_line()) {
            return self.note("left out: this very event stands there already".to_owned());
        }
        let asked = match &entry.event {
            Event::Asked { query, .. } | Event::AskedTransition { query, .. } => Some(*query),
            _ => None,
        };
        let old = entry.seq;
        match self.renumbered(entry.event).and_then(|event| Ok(self.happens(event, old)?)) {
            Ok(()) => {
                if let Some(query) = asked {
                    self.queries.insert(query, QueryId(self.session.next_query_id().0 - 1));
                }
            }
            Err(why) => {
                // What is said of it from here on is not about the one of this number that was asked before.
                asked.map(|query| self.queries.remove(&query));
                self.note(format!("left out: {why}"));
            }
        }
    }

    fn happens(&mut self, event: Event, old: u64) -> Result<(), Impossible> {
        if let Event::Answered(Answer { response, .. }) = &event
            && matches!(self.session.check(&event), Err(Impossible::Response { .. }))
            && let Some(protocol) = asked_under(*response)
            && protocol.is_sparse() == self.session.protocol().is_sparse()
        {
            let changed = Event::ProtocolChanged { protocol };
            self.push(changed, old)?;
            self.note(format!("from here on {} is asked: the line that said so is lost", protocol.name()));
        }
        self.push(event, old)
    }

    fn push(&mut self, event: Event, old: u64) -> Result<(), Impossible> {
        let entry = Entry { event, seq: self.session.n_entries(), at: self.at };
        self.session.apply(&entry)?;
        self.log.entries.push(entry);
        self.log.old.push(old);
        Ok(())
    }

    /// Puts in a dream whose line is lost and whose file is there.
    fn recover(&mut self, dream: u32) -> Option<DreamId> {
        let kept = (self.recover)(dream)?;
        let known = self.session.dreams().iter().find(|known| known.sha256 == kept.sha256);
        if let Some(known) = known.map(|known| known.dream) {
            self.dreams.insert(DreamId(dream), known);
            return Some(known);
        }
        let number = DreamId(self.session.dreams().len() as u32);
        let file = kept.file.clone();
        self.push(Event::DreamKept(KeptDream { dream: number, ..kept }), 0).ok()?;
        self.dreams.insert(DreamId(dream), number);
        self.note(format!(
            "dream {} is put in from its file {file}: the line that kept it is lost",
            dream + 1
        ));
        Some(number)
    }

    /// The new number of a dream.
    fn dream(&mut self, dream: DreamId) -> Result<DreamId, NotKept> {
        let known = self.dreams.get(&dream).copied();
        let known = known.or_else(|| self.recover(dream.0));
        known.ok_or(NotKept::LostDream(dream))
    }

    fn query(&self, query: QueryId) -> Result<QueryId, NotKept> {
        let known = self.queries.get(&query).copied();
        known.ok_or(NotKept::LostQuery(query))
    }

    fn choice(&self, choice: Choice) -> Result<Choice, NotKept> {
        if let Choice::Repeat(of) = choice { self.query(of).map(Choice::Repeat) } else { Ok(choice) }
    }

    fn segment(&mut self, segment: SegmentRef) -> Result<SegmentRef, NotKept> {
        Ok(SegmentRef { dream: self.dream(segment.dream)?, ..segment })
    }

    /// The event about dreams and queries as they are numbered now.
    fn renumbered(&mut self, event: Event) -> Result<Event, NotKept> {
        Ok(match event {
            Event::DreamKept(kept) => {
                let next = self.dreams.keys().next_back().map_or(0, |last| last.0.saturating_add(1));
                for lost in next..kept.dream.0.min(next.saturating_add(MOST_DREAMS)) {
                    if self.recover(lost).is_none() {
                        break;
                    }
                }
                let known = self.session.dreams().iter().find(|known| known.sha256 == kept.sha256);
                if let Some(known) = known.map(|known| known.dream) {
                    self.dreams.insert(kept.dream, known);
                    return Err(NotKept::Twice);
                }
                let number = DreamId(self.session.dreams().len() as u32);
                self.dreams.insert(kept.dream, number);
                Event::DreamKept(KeptDream { dream: number, ..kept })
            }
            Event::DreamDropped { dream } => Event::DreamDropped { dream: self.dream(dream)? },
            Event::DreamRestored { dream } => Event::DreamRestored { dream: self.dream(dream)? },
            Event::Asked { left, right, choice, .. } => {
                let (left, right, choice) = (self.segment(left)?, self.segment(right)?, self.choice(choice)?);
                Event::Asked { query: self.session.next_query_id(), left, right, choice }
            }
            Event::AskedTransition { transition, choice, .. } => {
                let dream = self.dream(transition.dream)?;
                let (transition, choice) = (Transition { dream, ..transition }, self.choice(choice)?);
                Event::AskedTransition { query: self.session.next_query_id(), transition, choice }
            }
            Event::Answered(answer) => Event::Answered(Answer { query: self.query(answer.query)?, ..answer }),
            Event::SkipExplained { query, reason } => {
                Event::SkipExplained { query: self.query(query)?, reason }
            }
            Event::Retracted { query } => Event::Retracted { query: self.query(query)? },
            Event::Restored { query } => Event::Restored { query: self.query(query)? },
            Event::Flagged { query } => Event::Flagged { query: self.query(query)? },
            Event::Unflagged { query } => Event::Unflagged { query: self.query(query)? },
            Event::Fitted { mut fit, file, sha256 } => {
                let before = self.log.old.iter().filter(|old| **old < fit.after).count();
                fit.after = before as u64;
                Event::Fitted { fit, file, sha256 }
            }
            event @ (Event::ProtocolChanged { .. }
            | Event::ScreenChanged { .. }
            | Event::WeightsChanged { .. }) => event,
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::query::{SafetyAnswer, SkipReason};

    fn header() -> Header {
        Header::new("car-racing", Protocol::Dropj, 7, "sha256:00", 5)
    }

    fn kept(dream: u32) -> KeptDream {
        KeptDream {
            dream: DreamId(dream),
            len: 60,
            seed: 0,
            marks: vec![],
            source: DreamSource::User,
            acquisition: None,
            planned: 0,
            file: format!("dreams/{dream:04}.safetensors"),
            sha256: format!("sha256:{dream}"),
        }
    }

    fn asked(query: u32, dream: u32) -> Event {
        let at = |start| SegmentRef { dream: DreamId(dream), start };
        Event::Asked {
            query: QueryId(query),
            left: at(query as usize),
            right: at(30),
            choice: Choice::Uniform,
        }
    }

    fn answered(query: u32, response: Response) -> Event {
        Event::Answered(Answer::new(QueryId(query), response, 1.0, "anna"))
    }

    const LEFT: Response = Response::Safety(SafetyAnswer::OnlyLeft);
    const RIGHT: Response = Response::Safety(SafetyAnswer::OnlyRight);

    /// Two dreams, and three queries with their answers: nine lines.
    fn whole() -> Vec<String> {
        let mut events = vec![Event::DreamKept(kept(0)), Event::DreamKept(kept(1))];
        for (query, response) in [(0, LEFT), (1, RIGHT), (2, Response::Skipped(Some(SkipReason::Other)))] {
            events.extend([asked(query, query % 2), answered(query, response)]);
        }
        events.push(Event::Flagged { query: QueryId(2) });
        let line = |(seq, event)| Entry { event, seq: seq as u64, at: 10 + seq as u64 }.to_line();
        events.into_iter().enumerate().map(line).collect()
    }

    fn mended(lines: &[String]) -> (MendedLog, Session) {
        let log = mend_log(lines.join("\n").as_bytes(), &header(), &mut |_| None);
        let contents = log::parse(&log.to_bytes(), Path::new("log")).unwrap();
        assert_eq!(contents.entries, log.entries);
        let session = header().session().folded(&contents.entries).unwrap();
        (log, session)
    }

    fn notes(log: &MendedLog) -> Vec<(usize, &str)> {
        log.notes.iter().map(|note| (note.line.unwrap_or(0), note.what.as_str())).collect()
    }

    #[test]
    fn what_is_whole_stays_as_it_is() {
        let (log, _) = mended(&whole());
        assert_eq!(notes(&log), []);
        assert_eq!(log.to_bytes(), (whole().join("\n") + "\n").into_bytes());
        for line in whole() {
            assert_eq!(events_in(line.as_bytes()).1, None, "{line}");
        }
    }

    #[test]
    fn an_event_within_a_broken_line_is_kept() {
        let mut lines = whole();
        lines[3] = format!("{}{}", &lines[3][..40], lines[3]);
        lines[5] = format!("{}{}", "\0".repeat(200), lines[5]);
        lines[7] = format!("{}{}", lines[7], lines[8]);
        lines[8] = "\0".repeat(50);
        let (log, session) = mended(&lines);
        assert_eq!(session.answers().len(), 3);
        assert!(session.queries()[2].is_flagged, "the glued line");
        let notes = notes(&log);
        assert!(notes[0].0 == 4 && notes[0].1.contains("40 bytes that are no event"), "{notes:?}");
        assert!(notes[1] == (6, "left out: 200 zeros, as a crash of the machine leaves them"), "{notes:?}");
        assert_eq!(notes[2], (8, "2 events stand in it, and each gets a line of its own"));
        assert_eq!(notes.len(), 4);
    }

    #[test]
    fn what_is_about_a_lost_query_goes_with_it_and_the_others_keep_theirs() {
        let mut lines = whole();
        lines[4] = r#"{"event":"ask"#.to_owned();
        let (log, session) = mended(&lines);
        let responses: Vec<_> = session.answers().iter().map(|given| given.answer.response).collect();
        assert_eq!(responses, [LEFT, Response::Skipped(Some(SkipReason::Other))]);
        assert_eq!(session.queries()[1].query.left.start, 2, "the third query, under the second number");
        assert!(session.queries()[1].is_flagged, "and its mark");
        assert_eq!(notes(&log)[1], (6, "left out: it is about query 1, and the line that asked it is lost"));
    }

    #[test]
    fn both_sides_of_an_unfinished_merge_are_kept_without_mixing() {
        let whole = whole();
        let mut lines = whole.clone();
        let entry = |event, seq, at| Entry { event, seq, at }.to_line();
        // Theirs: another second query, with another answer. Ours is lines 5 to 9.
        lines.insert(4, "<<<<<<< HEAD".to_owned());
        lines.push("=======".to_owned());
        lines.push(entry(asked(1, 0), 4, 50));
        lines.push(entry(answered(1, LEFT), 5, 51));
        lines.push(">>>>>>> theirs".to_owned());
        lines.push(whole[3].clone());
        let (log, session) = mended(&lines);
        assert_eq!(session.queries().len(), 4);
        assert_eq!(session.queries()[1].answer().unwrap().answer.response, RIGHT, "ours as it was");
        assert_eq!(session.queries()[3].answer().unwrap().answer.response, LEFT);
        let n_marks =
            notes(&log).iter().filter(|(_, what)| what.contains("merge that was not finished")).count();
        assert_eq!((n_marks, log.notes.len()), (3, 4));
    }

    #[test]
    fn a_dream_whose_line_is_lost_is_put_in_from_its_file() {
        let mut lines = whole();
        lines[1] = "{".to_owned();
        let log =
            mend_log(lines.join("\n").as_bytes(), &header(), &mut |dream| (dream == 1).then(|| kept(1)));
        assert_eq!(log.entries.iter().filter(|entry| matches!(entry.event, Event::DreamKept(_))).count(), 2);
        assert_eq!(log.entries.len(), 9);
        let (log, session) = mended(&lines);
        assert_eq!(session.dreams().len(), 1);
        assert_eq!(
            session.answers().len(),
            2,
            "without its file what was said of it is lost: {:?}",
            log.notes
        );
    }

    #[test]
    fn answers_after_a_lost_change_of_protocol_are_kept() {
        let mut lines = whole();
        let preferred = answered(1, Response::Preferred(Preference::Left));
        lines[5] = Entry { event: preferred, seq: 5, at: 15 }.to_line();
        let (log, session) = mended(&lines);
        assert_eq!(session.answers().len(), 3);
        assert_eq!(notes(&log), [(6, "from here on DROP is asked: the line that said so is lost")]);
    }

    #[test]
    fn a_line_that_was_taken_out_is_missed() {
        let mut lines = whole();
        lines.remove(7);
        let (log, session) = mended(&lines);
        assert_eq!((session.answers().len(), notes(&log)), (2, vec![(0, "the lines are numbered anew")]));
    }

    #[test]
    fn what_a_later_program_wrote_is_left_out() {
        let mut lines = whole();
        lines.insert(2, r#"{"event":"sung","seq":2,"at":0}"#.to_owned());
        let (log, session) = mended(&lines);
        assert_eq!(session.answers().len(), 3);
        assert!(log.notes[0].what.contains("unknown variant `sung`"), "{log:?}");
    }

    #[test]
    fn a_log_in_another_encoding_is_read() {
        let text = whole().join("\r\n");
        let bytes: Vec<u8> =
            [0xfeff].into_iter().chain(text.encode_utf16()).flat_map(u16::to_le_bytes).collect();
        let log = mend_log(&bytes, &header(), &mut |_| None);
        assert_eq!((log.entries.len(), log.notes.len()), (9, 0));
    }

    #[test]
    fn a_damaged_header_keeps_what_can_be_read() {
        let text = serde_json::to_string_pretty(&header()).unwrap();
        let (mended, _) = mend_header(format!("\0\0\u{feff}{text}\0\0").as_bytes()).unwrap();
        assert_eq!(mended, header());
        let odd = text
            .replace("\"seed\": 7", "\"seed\": 1e30, \"mood\": 1")
            .replace("\"format\": 3", "\"format\": 0");
        let (mended, notes) = mend_header(odd.as_bytes()).unwrap();
        assert_eq!(mended, Header { seed: 0, ..header() });
        assert_eq!(notes.len(), 3, "{notes:?}");
        for lost in ["", "\0\0\0", "{", "[]", r#"{"format": 9}"#, "{}"] {
            assert!(mend_header(lost.as_bytes()).is_err(), "{lost:?}");
        }
    }

    proptest! {
        #[test]
        fn any_damage_leaves_a_log_that_can_be_read(
            cuts in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0usize..40), 1..6),
        ) {
            let mut bytes = whole().join("\n").into_bytes();
            for (at, byte, n) in cuts {
                let at = at.index(bytes.len());
                match byte % 3 {
                    0 => bytes[at] = byte,
                    1 => drop(bytes.drain(at..(at + n).min(bytes.len() - 1))),
                    _ => { bytes.splice(at..at, vec![byte; n]); }
                }
            }
            let log = mend_log(&bytes, &header(), &mut |_| None);
            let contents = log::parse(&log.to_bytes(), Path::new("log")).unwrap();
            prop_assert!(header().session().folded(&contents.entries).is_ok());
            drop(mend_header(&bytes));
        }

        #[test]
        fn any_bytes_can_be_mended(bytes in any::<Vec<u8>>()) {
            prop_assert_eq!(mend_log(&bytes, &header(), &mut |_| None).entries.len(), 0);
            drop(mend_header(&bytes));
        }
    }
}
