//! The same queries for several people at once: each has a session of their own, which is brought up to date with the
//! first whenever it is handed out again.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use crate::query::{DreamId, SegmentRef, Transition};
use crate::session::AskedQuery;
use crate::session::error::SessionError;
use crate::session::event::Event;
use crate::session::merge::{drop_dreams, hashes, heir, whole};
use crate::session::store::{self, Reading, SessionStore};

/// A name can be longer than that of a folder.
const LONGEST: usize = 40;

/// The session in which `annotator` answers the queries of the one in `dir`: in a folder beside it, or in `folder`, called
/// after both.
///
/// ```
/// use std::path::Path;
///
/// use dropj::session::annotator_folder;
///
/// let own = annotator_folder(Path::new("sessions/s"), None, "Ann-Sofie B.");
/// assert_eq!(own, Path::new("sessions/s-Ann-Sofie-B-"));
/// ```
pub fn annotator_folder(dir: &Path, folder: Option<&Path>, annotator: &str) -> PathBuf {
    let absolute = std::path::absolute(dir).ok();
    let named = dir.file_name().or_else(|| absolute.as_deref().and_then(Path::file_name));
    let name = named.map_or_else(|| "session".into(), |name| name.to_string_lossy());
    let name = format!("{name}-{}", in_a_folder(annotator));
    folder.map_or_else(|| dir.with_file_name(&name), |folder| folder.join(&name))
}

/// A name as a part of that of a folder.
pub(super) fn in_a_folder(name: &str) -> String {
    name.chars().map(|c| if c.is_alphanumeric() { c } else { '-' }).take(LONGEST).collect()
}

/// The session in `out` in which `annotator` answers the queries of the one in `dir`, answered there or not: made, or
/// opened and brought up to date. What was said in it stays, and so does the one in `dir`.
pub fn hand_out(dir: &Path, out: &Path, annotator: &str) -> Result<SessionStore, SessionError> {
    let reading = store::read(dir, None)?;
    let is_wanted = |asked: &AskedQuery| asked.repeats().is_none();
    if !out.join(store::LOG_FILE).exists() {
        let mut header = heir(&reading.header, dir, out);
        header.protocol = reading.session.protocol();
        header.config.weights = reading.session.weights().clone();
        annotator.clone_into(&mut header.config.annotator);
        return whole(out, header, |handed| pass_on(handed, &reading, dir, is_wanted).map(drop));
    }
    let mut handed = SessionStore::open(out, None)?;
    let (found, path) = (handed.header(), out.to_owned());
    if found.world_model != reading.header.world_model {
        let (session, model) = (found.world_model.clone(), reading.header.world_model);
        return Err(SessionError::OtherWorldModel { session, model, path });
    }
    if found.config.annotator != annotator {
        let (found, annotator) = (found.config.annotator.clone(), annotator.to_owned());
        return Err(SessionError::OtherAnnotator { found, annotator, path });
    }
    let weights = reading.session.weights();
    if handed.session().weights() != weights {
        handed.record(Event::WeightsChanged { weights: weights.clone() })?;
    }
    pass_on(&mut handed, &reading, dir, is_wanted)?;
    let protocol = reading.session.protocol();
    if handed.session().protocol() != protocol {
        handed.record(Event::ProtocolChanged { protocol })?;
    }
    handed.sync()?;
    Ok(handed)
}

/// Copies what `handed` has not got of the session in `dir`, which was read before: its dreams, and of the queries about
/// dreams in use those that are wanted, without an answer. How many queries that were.
pub(super) fn pass_on(
    handed: &mut SessionStore,
    reading: &Reading,
    dir: &Path,
    is_wanted: impl Fn(&AskedQuery) -> bool,
) -> Result<usize, SessionError> {
    let mut dreams: BTreeMap<DreamId, DreamId> = BTreeMap::new();
    for kept in reading.session.dreams() {
        let there = handed.session().dreams().iter().find(|there| there.sha256 == kept.sha256);
        if let Some(there) = there {
            dreams.insert(kept.dream, there.dream);
            continue;
        }
        let bytes = match store::read_hashed(&dir.join(&kept.file), &kept.sha256) {
            Ok(bytes) => bytes,
            // It was deleted, and nothing is asked about it.
            Err(_) if reading.session.is_dropped(kept.dream) => continue,
            Err(e) => return Err(e),
        };
        dreams.insert(kept.dream, handed.copy_dream(kept, &bytes, store::now())?);
    }
    let asked = reading.session.queries().iter().filter(|asked| reading.session.is_in_use(asked));
    // What several have answered, in a session that was put together, is asked once.
    let mut shown: BTreeSet<_> = handed.session().queries().iter().map(shown_by).collect();
    let n_before = handed.session().queries().len();
    for asked in asked.filter(|asked| is_wanted(asked)) {
        let at = |segment: SegmentRef| SegmentRef { dream: dreams[&segment.dream], ..segment };
        let mut here = asked.clone();
        (here.query.left, here.query.right) = (at(asked.query.left), at(asked.query.right));
        here.transition = asked.transition.map(|it| Transition { dream: dreams[&it.dream], ..it });
        let is_dropped =
            [here.query.left, here.query.right].iter().any(|it| handed.session().is_dropped(it.dream));
        if is_dropped || !shown.insert(shown_by(&here)) {
            continue;
        }
        let (query, choice) = (handed.session().next_query_id(), asked.choice);
        handed.record(match here.transition {
            None => Event::Asked { query, left: here.query.left, right: here.query.right, choice },
            Some(transition) => Event::AskedTransition { query, transition, choice },
        })?;
    }
    let (dropped, in_use): (BTreeSet<&str>, BTreeSet<&str>) =
        (hashes(reading, true).collect(), hashes(reading, false).collect());
    // What somebody has answered about meanwhile stays.
    let session = handed.session();
    let free = session
        .dreams()
        .iter()
        .filter(|kept| session.check(&Event::DreamDropped { dream: kept.dream }).is_ok());
    let free: BTreeSet<String> = free.map(|kept| kept.sha256.clone()).collect();
    drop_dreams(handed, |hash| dropped.contains(hash) && !in_use.contains(hash) && free.contains(hash))?;
    Ok(handed.session().queries().len() - n_before)
}

/// A place in a dream: which, and the step.
type Place = (DreamId, usize);

/// What a query shows, whichever side is where.
fn shown_by(asked: &AskedQuery) -> (Place, Place, Option<usize>) {
    let [a, b] = [asked.query.left, asked.query.right].map(|segment| (segment.dream, segment.start));
    (a.min(b), a.max(b), asked.transition.map(|transition| transition.step))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::query::{Protocol, QueryId, Response, SafetyAnswer};
    use crate::session::arrays::formula_dream;
    use crate::session::{Answer, Choice, DreamSource, Header};

    fn asked(query: u32, left: usize, right: usize) -> Event {
        let at = |start| SegmentRef { dream: DreamId(0), start };
        Event::Asked { query: QueryId(query), left: at(left), right: at(right), choice: Choice::Uniform }
    }

    #[test]
    fn what_is_handed_out_again_gains_what_is_new_and_keeps_what_was_said() {
        let folder = tempfile::tempdir().unwrap();
        let (dir, out) = (folder.path().join("s"), folder.path().join("s-anna"));
        let header = Header::new("dummy-road", Protocol::Dropj, 1, "sha256:00", 0);
        let mut store = SessionStore::create(&dir, header).unwrap();
        store.save_dream(&formula_dream(60, 4), DreamSource::User).unwrap();
        store.record(asked(0, 0, 20)).unwrap();
        store.record(asked(1, 30, 7)).unwrap();
        let said = Response::Safety(SafetyAnswer::OnlyLeft);
        store.record(Event::Answered(Answer::new(QueryId(0), said, 1.0, "host"))).unwrap();

        let mut anna = hand_out(&dir, &out, "anna").unwrap();
        assert_eq!((anna.session().pending().count(), anna.session().answers().len()), (2, 0));
        assert_eq!(anna.header().config.annotator, "anna");
        let answer = Event::Answered(Answer::new(QueryId(1), said, 2.0, "anna"));
        anna.record(answer).unwrap();
        assert!(matches!(hand_out(&dir, &out, "anna"), Err(SessionError::InUse { .. })), "she has it open");
        drop(anna);

        store.record(asked(2, 7, 30)).unwrap();
        store.record(asked(3, 1, 2)).unwrap();
        store.record(Event::ProtocolChanged { protocol: Protocol::Drop }).unwrap();
        drop(store);
        let anna = hand_out(&dir, &out, "anna").unwrap();
        let (session, n) = (anna.session(), anna.entries().len());
        assert_eq!((session.queries().len(), session.answers().len()), (3, 1), "one was only turned round");
        assert_eq!(session.protocol(), Protocol::Drop);
        drop(anna);
        assert_eq!(hand_out(&dir, &out, "anna").unwrap().entries().len(), n, "nothing is new");
        let refused = hand_out(&dir, &out, "ben").unwrap_err().to_string();
        assert!(refused.contains("\"anna\" answers"), "{refused}");
    }
}
