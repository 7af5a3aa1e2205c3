//! The list of sessions to go on with, for which many files are read: in a thread of its own, while the window goes on.

use std::path::Path;
use std::sync::mpsc::{Receiver, channel};

use crate::session::{ListedSession, latest};
use crate::text::shown;
use crate::ui::App;
use crate::ui::act::counted;
use crate::ui::state::{RecentSession, is_called};
use crate::worker::Job;

/// So many are listed at the most.
const MOST: usize = 30;

/// The list, as it is shown.
#[derive(Default)]
pub(crate) struct RecentSessions {
    /// Those that were looked at so far.
    pub found: Vec<RecentSession>,
    /// Whether there may be more.
    pub is_looking: bool,
}

/// A list that is being read; whoever reads it stops when this is dropped.
pub(super) struct Looking {
    job: Job<Result<(), String>>,
    /// The list so far, after every session.
    found: Receiver<Vec<RecentSession>>,
}

impl App {
    pub(super) fn toggle_sessions(&mut self) {
        self.state.sessions_open = !self.state.sessions_open;
        if self.state.sessions_open {
            self.look_for_recent();
        }
    }

    fn look_for_recent(&mut self) {
        let (tell, found) = channel();
        let (sessions, hash) = (self.sessions.clone(), self.state.world.hash.clone());
        let identity = self.state.world.identity.clone();
        let (waker, pace) = (self.waker.clone(), self.pace);
        let work = move || {
            look(&sessions, &|named| hash.is_empty() || is_called(identity.as_ref(), &hash, named), |found| {
                let is_wanted = tell.send(found).is_ok();
                waker.request_repaint_after(pace);
                is_wanted
            })
        };
        let waker = self.waker.clone();
        let job = Job::begin("looker", move || waker.request_repaint(), work);
        self.looking = Some(Looking { job, found });
        self.state.recent = RecentSessions { found: Vec::new(), is_looking: true };
    }

    /// Shows what was found of the list so far.
    pub(super) fn hear_looking(&mut self) {
        if !self.state.sessions_open {
            (self.looking, self.state.recent.is_looking) = (None, false);
        }
        let Some(looking) = &mut self.looking else { return };
        let is_over = looking.job.is_over();
        let outcome = looking.job.poll();
        // Asked for last, so that nothing comes after it once the job is over.
        if let Some(found) = looking.found.try_iter().last() {
            self.state.recent.found = found;
        }
        let outcome = match outcome {
            Some(outcome) => outcome,
            None if is_over => Err("looking at the sessions failed: this is a bug of ours".to_owned()),
            None => return,
        };
        (self.looking, self.state.recent.is_looking) = (None, false);
        if let Err(e) = outcome {
            self.fail(e);
        }
    }
}

/// Reads the latest of `sessions` and tells the list after each of them, as long as it is wanted.
///
/// Those that cannot be read are its end: nobody can go on with them.
fn look(
    sessions: &Path,
    is_ours: &dyn Fn(&str) -> bool,
    mut tell: impl FnMut(Vec<RecentSession>) -> bool,
) -> Result<(), String> {
    let mut found: Vec<RecentSession> = Vec::new();
    let mut n_readable = 0;
    for recent in latest(sessions).map_err(|e| e.to_string())? {
        if recent.session.is_ok() {
            found.insert(n_readable, described(recent, is_ours));
            n_readable += 1;
        } else {
            found.push(described(recent, is_ours));
        }
        found.truncate(MOST);
        if !tell(found.clone()) || n_readable == MOST {
            break;
        }
    }
    Ok(())
}

/// A session in the window of the world model that is called what `is_ours` says.
fn described(recent: ListedSession, is_ours: &dyn Fn(&str) -> bool) -> RecentSession {
    let name = recent.dir.file_name().map_or_else(String::new, |name| shown(&name.to_string_lossy()));
    let about = match &recent.session {
        Ok((header, _)) if !is_ours(&header.world_model) => {
            Err("dreamed with another world model: load that one first".to_owned())
        }
        Ok((_, session)) => {
            let (n_dreams, n_answers) = (session.dreams().len(), session.statistics().n_answered);
            let protocol = session.protocol().name();
            Ok(format!("{protocol} · {} · {}", counted(n_dreams, "dream"), counted(n_answers, "answer")))
        }
        Err(e) => Err(e.to_string()),
    };
    RecentSession { dir: recent.dir, name, about }
}
