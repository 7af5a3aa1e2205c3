//! Sessions of several people: made apart from the same dreams and queries, and put together again.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use crate::query::{DreamId, QueryId, SegmentRef, Transition, Weights};
use crate::run::sync_folder;
use crate::session::error::SessionError;
use crate::session::event::{Choice, Event, KeptDream};
use crate::session::header::{Header, timed_name};
use crate::session::store::{self, Reading, SessionStore};

/// A session in `out` with all that was said in the sessions in `dirs`, one after the other.
///
/// Dreams of the same content become one dream. Every query stays a query of its own with the answers that it was given,
/// so where two people answered the same one, both are learned from: where they disagree, the reward is pulled both ways.
/// What answers weigh is as in the first session now; rewards are left out, for each was learned from a part.
pub fn merge(dirs: &[PathBuf], out: &Path) -> Result<SessionStore, SessionError> {
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
    whole(out, header, |merged| {
        for (reading, dir) in readings.iter().zip(dirs) {
            append(merged, reading, dir)?;
        }
        drop_dreams(merged, |hash| dropped.contains(hash) && !in_use.contains(hash))
    })
}

/// A session in `out` that is there once it is `filled`, and not before: nobody takes half of one for the whole.
fn whole(
    out: &Path,
    header: Header,
    fill: impl FnOnce(&mut SessionStore) -> Result<(), SessionError>,
) -> Result<SessionStore, SessionError> {
    if out.exists() {
        return Err(SessionError::Exists { path: out.to_owned() });
    }
    let name = out.file_name().unwrap_or_default().to_string_lossy();
    // Beside it, so that files beside both are found from either; a name with a dot is passed over.
    let partial = out.with_file_name(format!(".{name}.{}.partial", std::process::id()));
    let made = SessionStore::create(&partial, header).and_then(|mut store| fill(&mut store));
    let made = made.and_then(|()| {
        std::fs::rename(&partial, out).map_err(SessionError::disk("put the session in its place", out))?;
        sync_folder(out).map_err(SessionError::disk("put the session in its place", out))
    });
    made.inspect_err(|_| drop(std::fs::remove_dir_all(&partial)))?;
    SessionStore::open(out, None)
}

/// The same in a folder of its own below `sessions`.
pub fn merge_in(dirs: &[PathBuf], sessions: &Path) -> Result<SessionStore, SessionError> {
    let out = store::free_folder(sessions, &timed_name(store::now(), "merged"));
    merge(dirs, &out)
}

/// The hashes of the dreams that were deleted from a session, or that were not.
fn hashes(reading: &Reading, dropped: bool) -> impl Iterator<Item = &str> {
    let dreams = reading.session.dreams().iter();
    let wanted = dreams.filter(move |kept| reading.session.is_dropped(kept.dream) == dropped);
    wanted.map(|kept| kept.sha256.as_str())
}

/// Deletes the dreams whose hashes are `unwanted`.
fn drop_dreams(store: &mut SessionStore, unwanted: impl Fn(&str) -> bool) -> Result<(), SessionError> {
    let dreams = store.session().dreams().iter().filter(|kept| unwanted(&kept.sha256));
    let dreams: Vec<_> = dreams.map(|kept| kept.dream).collect();
    dreams.into_iter().try_for_each(|dream| store.record(Event::DreamDropped { dream }))
}

/// A session in `out` with the dreams of the one in `dir` and all queries that were answered there, but no answer: for
/// `annotator`, who is to answer the same.
pub fn hand_on(dir: &Path, out: &Path, annotator: &str) -> Result<SessionStore, SessionError> {
    let reading = store::read(dir, None)?;
    let mut header = heir(&reading.header, dir, out);
    header.protocol = reading.session.protocol();
    header.config.weights = reading.session.weights().clone();
    annotator.clone_into(&mut header.config.annotator);
    whole(out, header, |handed| {
        for kept in reading.session.dreams() {
            let bytes = store::read_hashed(&dir.join(&kept.file), &kept.sha256)?;
            handed.copy_dream(kept, &bytes, store::now())?;
        }
        let asked = reading.session.queries().iter().filter(|asked| reading.session.is_in_use(asked));
        for asked in asked.filter(|asked| asked.repeats().is_none() && asked.answer().is_some()) {
            let query = handed.session().next_query_id();
            let (left, right, choice) = (asked.query.left, asked.query.right, asked.choice);
            handed.record(match asked.transition {
                None => Event::Asked { query, left, right, choice },
                Some(transition) => Event::AskedTransition { query, transition, choice },
            })?;
        }
        let dropped: BTreeSet<&str> = hashes(&reading, true).collect();
        drop_dreams(handed, |hash| dropped.contains(hash))
    })
}

/// The same in a folder of its own below `sessions`.
pub fn hand_on_in(dir: &Path, sessions: &Path, annotator: &str) -> Result<SessionStore, SessionError> {
    let plain: String = annotator.chars().map(|c| if c.is_alphanumeric() { c } else { '-' }).collect();
    let out = store::free_folder(sessions, &timed_name(store::now(), &format!("for-{plain}")));
    hand_on(dir, &out, annotator)
}

/// The head of a session in `out` that goes on with what the one in `dir` was about.
fn heir(header: &Header, dir: &Path, out: &Path) -> Header {
    let found = store::world_model_path(dir, header);
    let world_model_path = found.and_then(|file| relative(out, &file)).or(header.world_model_path.clone());
    let fresh = Header::new(&header.env, header.protocol, header.seed, &header.world_model, store::now());
    Header { world_model_path, config: header.config.clone(), ..fresh }
}

/// Whether what was said in both sessions is about the same world, or what is not the same.
fn alike(
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

/// Everything that happened in `reading`, numbered on from what is there.
fn append(merged: &mut SessionStore, reading: &Reading, dir: &Path) -> Result<(), SessionError> {
    let first = merged.session().next_query_id().0;
    let mut dreams: BTreeMap<DreamId, DreamId> = BTreeMap::new();
    let began = reading.header.created_at;
    if merged.session().protocol() != reading.header.protocol {
        merged.record_at(Event::ProtocolChanged { protocol: reading.header.protocol }, began)?;
    }
    if merged.session().held_back() != 0 {
        merged.record_at(Event::ScreenChanged { held_back: 0 }, began)?;
    }
    let on = |query: QueryId| QueryId(first + query.0);
    for entry in &reading.contents.entries {
        let at = |segment: SegmentRef| SegmentRef { dream: dreams[&segment.dream], ..segment };
        let event = match entry.event.clone() {
            Event::DreamKept(kept) => {
                let known = merged.session().dreams().iter().find(|known| known.sha256 == kept.sha256);
                let number = if let Some(known) = known {
                    known.dream
                } else {
                    let bytes = store::read_hashed(&dir.join(&kept.file), &kept.sha256)?;
                    merged.copy_dream(&kept, &bytes, entry.at)?
                };
                dreams.insert(kept.dream, number);
                continue;
            }
            Event::Asked { query, left, right, choice } => {
                let choice = if let Choice::Again(of) = choice { Choice::Again(on(of)) } else { choice };
                Event::Asked { query: on(query), left: at(left), right: at(right), choice }
            }
            Event::AskedTransition { query, transition, choice } => {
                let choice = if let Choice::Again(of) = choice { Choice::Again(on(of)) } else { choice };
                let transition = Transition { dream: dreams[&transition.dream], ..transition };
                Event::AskedTransition { query: on(query), transition, choice }
            }
            Event::Answered(answer) => {
                let query = on(answer.query);
                Event::Answered(crate::session::Answer { query, ..answer })
            }
            Event::SkipExplained { query, reason } => Event::SkipExplained { query: on(query), reason },
            Event::Retracted { query } => Event::Retracted { query: on(query) },
            Event::Restored { query } => Event::Restored { query: on(query) },
            Event::Flagged { query } => Event::Flagged { query: on(query) },
            Event::Unflagged { query } => Event::Unflagged { query: on(query) },
            event @ (Event::ProtocolChanged { .. } | Event::ScreenChanged { .. }) => event,
            // Which dreams are in use is known once all sessions are together.
            Event::DreamDropped { .. }
            | Event::DreamRestored { .. }
            | Event::WeightsChanged { .. }
            | Event::Fitted { .. } => continue,
        };
        merged.record_at(event, entry.at)?;
    }
    Ok(())
}

impl SessionStore {
    /// Keeps a dream of another session as it stands in its file there.
    fn copy_dream(&mut self, kept: &KeptDream, bytes: &[u8], at: u64) -> Result<DreamId, SessionError> {
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
