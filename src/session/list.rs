//! The sessions in a folder, for somebody who wants to go on with one.

use std::cmp::Reverse;
use std::path::{Path, PathBuf};

use crate::run::is_being_built;
use crate::session::error::SessionError;
use crate::session::header::{self, Header};
use crate::session::{Session, log, store};

/// A session that can be opened, or why it cannot.
#[derive(Debug)]
pub struct ListedSession {
    /// Its folder.
    pub dir: PathBuf,
    /// What it is and how far it got.
    pub session: Result<(Header, Session), SessionError>,
}

impl ListedSession {
    /// The session in `dir`, which is left as it is.
    pub fn read(dir: &Path) -> Self {
        let session = store::read(dir, None).map(|reading| (reading.header, reading.session));
        Self { dir: dir.to_owned(), session }
    }

    /// When something last happened in it, in milliseconds since 1970. 0 where that cannot be read.
    pub fn last_at(&self) -> u64 {
        self.session.as_ref().map_or(0, |(header, session)| session.last_at().unwrap_or(header.created_at))
    }
}

/// The sessions in `sessions`, the latest first. None where there is no such folder.
pub fn list_sessions(sessions: &Path) -> Result<Vec<ListedSession>, SessionError> {
    let mut listed: Vec<_> = folders(sessions)?.iter().map(|dir| ListedSession::read(dir)).collect();
    listed.sort_by_key(|session| Reverse(session.last_at()));
    Ok(listed)
}

/// The same one by one, each read when it is asked for, so that who wants only the latest need not read them all.
///
/// Which are the latest is read off the ends of their logs: one that turns out to be unreadable comes in its turn.
pub fn latest(sessions: &Path) -> Result<impl Iterator<Item = ListedSession> + use<>, SessionError> {
    let mut dirs = folders(sessions)?;
    dirs.sort_by_cached_key(|dir| {
        let created_at = || Header::read(dir).ok().map(|header| header.created_at);
        Reverse(log::last_at(&dir.join(store::LOG_FILE)).or_else(created_at))
    });
    Ok(dirs.into_iter().map(|dir| ListedSession::read(&dir)))
}

/// The folders of the sessions in `sessions`, in the order of their names.
fn folders(sessions: &Path) -> Result<Vec<PathBuf>, SessionError> {
    let listing = match std::fs::read_dir(sessions) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        listing => listing.map_err(SessionError::disk("list the sessions", sessions))?,
    };
    let mut dirs: Vec<PathBuf> = listing.filter_map(|item| Some(item.ok()?.path())).collect();
    // One that begins with a dot was still being made by an earlier version.
    let is_hidden =
        |dir: &PathBuf| dir.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."));
    dirs.retain(|dir| dir.join(header::FILE).exists() && !is_hidden(dir) && !is_being_built(dir));
    dirs.sort();
    Ok(dirs)
}
