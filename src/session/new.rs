//! A session that is made in one go: as `NAME.partial`, and under its name once it is whole.

use std::path::Path;

use crate::run::{Building, RunError};
use crate::session::clip_hash;
use crate::session::error::SessionError;
use crate::session::header::{self, Header};
use crate::session::store::{DREAMS, DRIVEN_FILE, LOG_FILE, REWARDS, SessionStore};
use crate::session::worlds::WORLD_MODEL_FILE;

/// The place of a session that is being made, where nobody finds half of it under its name.
///
/// Dropped without [`Self::finish`], it leaves nothing. A program that is killed leaves a folder that the next one
/// recognizes and replaces.
#[derive(Debug)]
pub struct NewSession {
    building: Building,
}

impl NewSession {
    /// A session to be at `out`, where there must be nothing yet, or an empty folder.
    pub fn at(out: &Path) -> Result<Self, SessionError> {
        let building = Building::begin(out, is_of_a_session).map_err(|met| match met {
            RunError::Exists { path } => SessionError::Exists { path },
            met => met.into(),
        });
        Ok(Self { building: building? })
    }

    /// The session, still empty and not yet in its place.
    pub fn create(&self, header: Header) -> Result<SessionStore, SessionError> {
        SessionStore::create_here(self.building.dir(), header)
    }

    /// Puts the session in its place and opens it there.
    pub fn finish(self, store: SessionStore) -> Result<SessionStore, SessionError> {
        store.sync()?;
        drop(store);
        let out = self.building.out().to_owned();
        self.building.finish()?;
        SessionStore::open(&out, None)
    }
}

/// Whether a session has a file of this name.
fn is_of_a_session(way: &Path) -> bool {
    let Some(name) = way.file_name().and_then(|name| name.to_str()) else { return false };
    match way.parent().and_then(Path::to_str) {
        Some("") => [LOG_FILE, WORLD_MODEL_FILE, header::FILE, clip_hash::FILE, DRIVEN_FILE].contains(&name),
        Some(DREAMS | REWARDS) => name.ends_with(".safetensors") || name.starts_with("journal-"),
        _ => false,
    }
}
