//! The session that is open.

use std::path::{Path, PathBuf};

use crate::session::{Header, Session};

/// A session that is open: what its log says, as far as that is on disk.
#[derive(Clone, Debug)]
pub struct OpenSession {
    /// Its folder.
    pub(crate) dir: PathBuf,
    /// Its head.
    pub(crate) header: Header,
    /// What its log says.
    pub(crate) session: Session,
    /// How many events could not be written down and wait.
    pub(crate) n_unsaved: usize,
}

impl OpenSession {
    /// Its folder.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// Its head.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// What its log says, as far as that is on disk.
    pub fn session(&self) -> &Session {
        &self.session
    }

    /// How many events could not be written down, and do not count yet.
    pub fn n_unsaved(&self) -> usize {
        self.n_unsaved
    }
}
