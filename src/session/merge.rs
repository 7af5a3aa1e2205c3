//! Sessions of several people: made apart from the same dreams and queries, and put together again.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::{Path, PathBuf};

use crate::query::{DreamId, QueryId, SegmentRef, Transition, Weights};
use crate::session::AskedQuery;
use crate::session::error::SessionError;
use crate::session::event::{Choice, Event, KeptDream};
use crate::session::hand_out::{in_a_folder, pass_on};
use crate::session::header::{Header, timed_name};
use crate::session::new::NewSession;
use crate::session::store::{self, Reading, SessionStore};
use crate::session::worlds;

/// A session in `out` with all that was said in the sessions in `dirs`, one after the other.
///
/// Dreams of the same content become one dream. Every query stays a query of its own with the answers that it was given,
/// so where two people answered the same one, both are learned from: where they disagree, the reward is pulled both ways.
/// What stands in several of the sessions, because one is a copy of another or was put together from it, counts once: an
/// answer is the same where the same was said of the same clips at the same moment, wherever it was copied to.
/// The weights of answers are those of the first session now. Rewards are left out, for each was learned from a part.
pub fn merge(dirs: &[PathBuf], out: &Path) -> Result<SessionStore, SessionError> {
    merge_counted(dirs, out).map(|(merged, _)| merged)
}

/// The same, and how many queries stood in several of the sessions.
pub fn merge_counted(dirs: &[PathBuf], out: &Path) -> Result<(SessionStore, usize), SessionError> {
    let readings: Vec<_> = dirs.iter().map(|dir| store::read(dir, None)).collect::<Result<_, _>>()?;
    let (Some(first), Some(dir)) = (readings.first(), dirs.first()) else {
        return Err(SessionError::NothingToMerge);
    };
    for (reading, path) in readings.iter().zip(dirs) {
        alike((first, dir), (reading, path))
            .map_err(|what| SessionError::Unlike { what, path: path.clone() })?;
    }
    let mut header = heir(&first.header, dir, out);
    header.config.weights = first.session.weights().clone();
    let in_use: BTreeSet<&str> = readings.iter().flat_map(|reading| hashes(reading, false)).collect();
    let dropped: BTreeSet<&str> = readings.iter().flat_map(|reading| hashes(reading, true)).collect();
    let mut known = Known::default();
    let merged = whole(out, header, |merged| {
        for (reading, dir) in readings.iter().zip(dirs) {
            append(merged, reading, dir, &mut known)?;
        }
        drop_dreams(merged, |hash| dropped.contains(hash) && !in_use.contains(hash))
    })?;
    Ok((merged, known.n_same))
}

/// A session in `out` that is there once it is `filled`, and not before: nobody takes half of one for the whole.
pub(super) fn whole(
    out: &Path,
    header: Header,
    fill: impl FnOnce(&mut SessionStore) -> Result<(), SessionError>,
) -> Result<SessionStore, SessionError> {
    let new = NewSession::at(out)?;
    let mut store = new.create(header)?;
    fill(&mut store)?;
    new.finish(store)
}

/// The same in a folder of its own below `sessions`.
pub fn merge_in(dirs: &[PathBuf], sessions: &Path) -> Result<SessionStore, SessionError> {
    let out = store::free_folder(sessions, &timed_name(store::now(), "merged"));
    merge(dirs, &out)
}

/// The hashes of the dreams that were deleted from a session, or that were not.
pub(super) fn hashes(reading: &Reading, dropped: bool) -> impl Iterator<Item = &str> {
    let dreams = reading.session.dreams().iter();
    let wanted = dreams.filter(move |kept| reading.session.is_dropped(kept.dream) == dropped);
    wanted.map(|kept| kept.sha256.as_str())
}

/// Deletes the dreams whose hashes are `unwanted`.
pub(super) fn drop_dreams(
    store: &mut SessionStore,
    unwanted: impl Fn(&str) -> bool,
) -> Result<(), SessionError> {
    let dreams = store.session().dreams().iter().filter(|kept| unwanted(&kept.sha256));
    let dreams: Vec<_> = dreams.map(|kept| kept.dream).collect();
    dreams.into_iter().try_for_each(|dream| store.record(Event::DreamDropped { dream }))
}

/// A session in `out` with the dreams of the one in `dir` and all queries that were answered there, but no answer: for
/// `annotator`, who is to answer the same.
pub fn hand_on(dir: &Path, out: &Path, annotator: &str) -> Result<SessionStore, SessionError> {
    hand_on_some(dir, out, annotator, usize::MAX)
}

/// The same with `most` of the queries at the most, from the whole of the session.
pub(super) fn hand_on_some(
    dir: &Path,
    out: &Path,
    annotator: &str,
    most: usize,
) -> Result<SessionStore, SessionError> {
    let reading = store::read(dir, None)?;
    let mut header = heir(&reading.header, dir, out);
    header.protocol = reading.session.protocol();
    header.config.weights = reading.session.weights().clone();
    annotator.clone_into(&mut header.config.annotator);
    whole(out, header, |handed| {
        let is_wanted = |asked: &AskedQuery| asked.repeats().is_none() && asked.answer().is_some();
        let all = reading.session.queries().iter().filter(|asked| reading.session.is_in_use(asked));
        let all: Vec<QueryId> = all.filter(|asked| is_wanted(asked)).map(|asked| asked.query.id).collect();
        let every = all.len().div_ceil(most.max(1)).max(1);
        let chosen: BTreeSet<QueryId> = all.into_iter().step_by(every).collect();
        pass_on(handed, &reading, dir, |asked| chosen.contains(&asked.query.id)).map(drop)
    })
}

/// The same in a folder of its own below `sessions`.
pub fn hand_on_in(dir: &Path, sessions: &Path, annotator: &str) -> Result<SessionStore, SessionError> {
    let name = format!("for-{}", in_a_folder(annotator));
    let out = store::free_folder(sessions, &timed_name(store::now(), &name));
    hand_on(dir, &out, annotator)
}

/// The head of a session in `out` that goes on with what the one in `dir` was about.
pub(super) fn heir(header: &Header, dir: &Path, out: &Path) -> Header {
    let found = worlds::find(dir, header);
    let world_model_path = found.and_then(|file| relative(out, &file)).or(header.world_model_path.clone());
    let fresh = Header::new(&header.env, header.protocol, header.seed, &header.world_model, store::now());
    let world_file = header.world_file.clone();
    Header { world_model_path, world_file, config: header.config.clone(), ..fresh }
}

/// Whether what was said in both sessions is about the same world, or what is not the same.
pub(super) fn alike(
    (one, one_dir): (&Reading, &Path),
    (other, other_dir): (&Reading, &Path),
) -> Result<(), &'static str> {
    let names = |weights: &Weights| -> Vec<String> {
        weights.justifications.iter().map(|(_, name, _)| name.to_owned()).collect()
    };
    // One may name the world model by the hash that it has since it was stored in another way.
    let is_model = |dir: &Path, header: &Header, named: &str| {
        store::world_model(dir, header).is_ok_and(|model| model.is(named))
    };
    let [ours, theirs] = [&one.header.world_model, &other.header.world_model];
    if ours != theirs && !is_model(one_dir, &one.header, theirs) && !is_model(other_dir, &other.header, ours)
    {
        return Err("world model");
    }
    if one.header.env != other.header.env {
        return Err("environment");
    }
    if names(one.session.weights()) != names(other.session.weights()) {
        return Err("list of justification");
    }
    Ok(())
}

/// What happened to a query after it was asked, and when. Which query it is, is left out.
type History = Vec<(u64, Event)>;

/// What tells a query from every other, wherever it was copied: when it was asked, and what it shows.
#[derive(Clone, PartialEq, Eq, Hash)]
struct Mark {
    asked_at: u64,
    shown: [(String, usize); 2],
    transition: Option<[usize; 2]>,
}

/// The queries that are together so far.
#[derive(Default)]
struct Known {
    places: HashMap<Mark, Vec<QueryId>>,
    /// By number.
    histories: Vec<History>,
    /// How many were there already when they came.
    n_same: usize,
}

/// What becomes of a query that comes.
enum Fate {
    /// It is another one than all that are there.
    New,
    /// It is this one, of whose history so many events are there, or need not be.
    Is(QueryId, usize),
}

impl Known {
    /// What becomes of the queries with these marks and histories, which come together.
    fn fates(&self, coming: &[(Mark, History)]) -> Vec<Fate> {
        let mut taken = BTreeSet::new();
        let mut fates: Vec<Option<Fate>> = coming.iter().map(|_| None).collect();
        // Those that are wholly the same find each other first.
        for is_whole in [true, false] {
            for ((mark, history), fate) in coming.iter().zip(&mut fates).filter(|(_, fate)| fate.is_none()) {
                let places = self.places.get(mark).into_iter().flatten().filter(|id| !taken.contains(*id));
                let fitting = places.filter_map(|id| {
                    let known = &self.histories[id.0 as usize];
                    let n_there = if is_whole {
                        (known == history).then_some(known.len())
                    } else {
                        n_there(known, history)
                    };
                    Some((shared(known, history), *id, n_there?))
                });
                if let Some((_, id, n_there)) = fitting.max_by_key(|(shared, ..)| *shared) {
                    taken.insert(id);
                    *fate = Some(Fate::Is(id, n_there));
                }
            }
        }
        fates.into_iter().map(|fate| fate.unwrap_or(Fate::New)).collect()
    }
}

/// How many events two histories begin with alike.
fn shared(one: &History, other: &History) -> usize {
    one.iter().zip(other).take_while(|(a, b)| a == b).count()
}

/// How many events of `coming` need not be added to `known`, where both are of one query. Nothing where they are not.
///
/// Where one person went on in two copies, what was said last counts. Where two did, each has said it of a query of
/// their own.
fn n_there(known: &History, coming: &History) -> Option<usize> {
    let shared = shared(known, coming);
    if shared == known.len() || shared == coming.len() {
        return Some(shared);
    }
    let who = |history: &History| -> BTreeSet<String> {
        let answers = history.iter().filter_map(|(_, event)| match event {
            Event::Answered(answer) => Some(answer.annotator.clone()),
            _ => None,
        });
        answers.collect()
    };
    let last = |history: &History| history.last().map(|(at, _)| *at);
    (who(known) == who(coming)).then_some(if last(coming) > last(known) { shared } else { coming.len() })
}

/// The query that an event is about, where it is one that was asked before.
fn about(event: &mut Event) -> Option<&mut QueryId> {
    match event {
        Event::Answered(answer) => Some(&mut answer.query),
        Event::SkipExplained { query, .. }
        | Event::Retracted { query }
        | Event::Restored { query }
        | Event::Flagged { query }
        | Event::Unflagged { query } => Some(query),
        _ => None,
    }
}

/// The queries of `reading` in the order of asking, as they can be found again.
fn queries(reading: &Reading) -> Vec<(Mark, History)> {
    let session = &reading.session;
    let hash = |dream: DreamId| session.dreams()[dream.0 as usize].sha256.clone();
    let marked = |asked: &AskedQuery| Mark {
        asked_at: 0,
        shown: [asked.query.left, asked.query.right].map(|at| (hash(at.dream), at.start)),
        transition: asked.transition.map(|transition| [transition.first, transition.step]),
    };
    let mut queries: Vec<_> = session.queries().iter().map(|asked| (marked(asked), History::new())).collect();
    for entry in &reading.contents.entries {
        if let Event::Asked { query, .. } | Event::AskedTransition { query, .. } = &entry.event {
            queries[query.0 as usize].0.asked_at = entry.at;
        }
        let mut event = entry.event.clone();
        if let Some(query) = about(&mut event) {
            let query = std::mem::replace(query, QueryId(0));
            queries[query.0 as usize].1.push((entry.at, event));
        }
    }
    queries
}

/// Everything that happened in `reading` and is not there yet, numbered on from what is there.
fn append(
    merged: &mut SessionStore,
    reading: &Reading,
    dir: &Path,
    known: &mut Known,
) -> Result<(), SessionError> {
    let coming = queries(reading);
    let fates = known.fates(&coming);
    let mut dreams: BTreeMap<DreamId, DreamId> = BTreeMap::new();
    let mut numbers: BTreeMap<QueryId, QueryId> = BTreeMap::new();
    // Of the history of each query, how many events were met so far.
    let mut n_met = vec![0; coming.len()];
    let mut protocol = reading.header.protocol;
    for entry in &reading.contents.entries {
        let at = |segment: SegmentRef| Some(SegmentRef { dream: *dreams.get(&segment.dream)?, ..segment });
        let again = |choice: Choice, numbers: &BTreeMap<QueryId, QueryId>| match choice {
            Choice::Repeat(of) => numbers.get(&of).copied().map(Choice::Repeat),
            choice => Some(choice),
        };
        match &entry.event {
            Event::DreamKept(kept) => {
                let there = merged.session().dreams().iter().find(|there| there.sha256 == kept.sha256);
                let number = match there.map(|there| there.dream) {
                    Some(there) => there,
                    None => match store::read_hashed(&dir.join(&kept.file), &kept.sha256) {
                        Ok(bytes) => merged.copy_dream(kept, &bytes, entry.at)?,
                        // It was deleted, so no answer rests on it: what was asked about it is left out.
                        Err(_) if reading.session.is_dropped(kept.dream) => continue,
                        Err(e) => return Err(e),
                    },
                };
                dreams.insert(kept.dream, number);
            }
            &(Event::Asked { query, choice, .. } | Event::AskedTransition { query, choice, .. }) => {
                let (mark, history) = &coming[query.0 as usize];
                if let Fate::Is(there, n_there) = fates[query.0 as usize] {
                    numbers.insert(query, there);
                    known.histories[there.0 as usize].extend_from_slice(&history[n_there..]);
                    known.n_same += 1;
                    continue;
                }
                let number = merged.session().next_query_id();
                let event = match entry.event {
                    Event::AskedTransition { transition, .. } => {
                        dreams.get(&transition.dream).zip(again(choice, &numbers)).map(|(dream, choice)| {
                            let transition = Transition { dream: *dream, ..transition };
                            Event::AskedTransition { query: number, transition, choice }
                        })
                    }
                    Event::Asked { left, right, .. } => at(left)
                        .zip(at(right))
                        .zip(again(choice, &numbers))
                        .map(|((left, right), choice)| Event::Asked { query: number, left, right, choice }),
                    _ => None,
                };
                if let Some(event) = event {
                    merged.record_at(event, entry.at)?;
                    numbers.insert(query, number);
                    known.places.entry(mark.clone()).or_default().push(number);
                    known.histories.push(history.clone());
                }
            }
            Event::ProtocolChanged { protocol: next } => protocol = *next,
            // Which dreams are in use and how many pairs are held back is known once all sessions are together.
            Event::DreamDropped { .. }
            | Event::DreamRestored { .. }
            | Event::ScreenChanged { .. }
            | Event::WeightsChanged { .. }
            | Event::Fitted { .. } => {}
            Event::Answered(_)
            | Event::SkipExplained { .. }
            | Event::Retracted { .. }
            | Event::Restored { .. }
            | Event::Flagged { .. }
            | Event::Unflagged { .. } => {
                let mut event = entry.event.clone();
                let Some(query) = about(&mut event) else { continue };
                let idx = query.0 as usize;
                let Some(number) = numbers.get(query) else { continue };
                *query = *number;
                let n_there = if let Fate::Is(_, n_there) = fates[idx] { n_there } else { 0 };
                n_met[idx] += 1;
                if n_met[idx] <= n_there {
                    continue;
                }
                if matches!(event, Event::Answered(_)) && merged.session().protocol() != protocol {
                    merged.record_at(Event::ProtocolChanged { protocol }, entry.at)?;
                }
                // Where one person went on in two copies, what was taken back in one may not be there to take back.
                if n_there == 0 || merged.session().check(&event).is_ok() {
                    merged.record_at(event, entry.at)?;
                }
            }
        }
    }
    let ended = reading.session.last_at().unwrap_or(reading.header.created_at);
    let (protocol, held_back) = (reading.session.protocol(), reading.session.held_back());
    if merged.session().protocol() != protocol {
        merged.record_at(Event::ProtocolChanged { protocol }, ended)?;
    }
    if merged.session().held_back() != held_back {
        merged.record_at(Event::ScreenChanged { held_back }, ended)?;
    }
    Ok(())
}

impl SessionStore {
    /// Keeps a dream of another session as it stands in its file there.
    pub(super) fn copy_dream(
        &mut self,
        kept: &KeptDream,
        bytes: &[u8],
        at: u64,
    ) -> Result<DreamId, SessionError> {
        let dream = DreamId(self.session().dreams().len() as u32);
        let file = store::dream_file(dream);
        self.write(&file, bytes, "copy a dream")?;
        self.record_at(Event::DreamKept(KeptDream { dream, file, ..kept.clone() }), at)?;
        Ok(dream)
    }
}

/// The way from the folder `from` to the file `to`, where both lie below the same folder.
pub fn relative(from: &Path, to: &Path) -> Option<String> {
    let (from, to) = (std::path::absolute(from).ok()?, std::path::absolute(to).ok()?);
    let n_shared = from.components().zip(to.components()).take_while(|(a, b)| a == b).count();
    let up = from.components().skip(n_shared).map(|_| std::path::Component::ParentDir);
    let way: PathBuf = up.chain(to.components().skip(n_shared)).collect();
    way.to_str().map(str::to_owned)
}
