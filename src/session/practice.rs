//! A few queries of a session that somebody else has answered, to be answered anew: how it goes is learned by doing it.

use std::path::{Path, PathBuf};

use crate::session::SessionError;
use crate::session::header::timed_name;
use crate::session::merge::hand_on_some;
use crate::session::store::{self, SessionStore};
use crate::session::worlds::shipped_beside;
use crate::world::example_of;

/// How many queries are asked.
pub const N_PRACTICED: usize = 20;

/// The folder of the example session that is shipped for the world of this name; where it should be, if it is not there.
pub fn example(world: &str) -> Option<PathBuf> {
    example_of(world).map(|name| shipped_beside(&Path::new("sessions").join(name)))
}

/// A session below `sessions` with the dreams of the one in `dir` and [`N_PRACTICED`] of its queries, unanswered, for `annotator`.
pub fn practice_in(dir: &Path, sessions: &Path, annotator: &str) -> Result<SessionStore, SessionError> {
    let out = store::free_folder(sessions, &timed_name(store::now(), "practice"));
    hand_on_some(dir, &out, annotator, N_PRACTICED)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::SessionStore;

    #[test]
    fn twenty_queries_of_the_example_wait_for_whoever_begins() {
        let dir = tempfile::tempdir().unwrap();
        let example = example("car-racing").unwrap();
        let practice = practice_in(&example, dir.path(), "anna").unwrap();
        let session = practice.session();
        assert_eq!((session.queries().len(), session.pending().count()), (N_PRACTICED, N_PRACTICED));
        assert_eq!(session.statistics().n_answered, 0);
        let (_, original) = SessionStore::read(&example).unwrap();
        assert_eq!(session.dreams().len(), original.dreams().len(), "all its dreams are there");
        let dreams: std::collections::BTreeSet<_> =
            session.queries().iter().map(|asked| asked.query.left.dream).collect();
        assert!(dreams.len() > 2, "they are of several dreams: {dreams:?}");
        assert!(super::example("elsewhere").is_none());
    }
}
