//! A session with all that its files hold: the slow part of opening one.

use std::ops::ControlFlow;

use crate::dream::DreamEpisode;
use crate::query::DreamId;
use crate::session::{SessionError, SessionStore, UnfinishedDream};
use crate::tensor::Parameters;
use crate::world_model::ModelIdentity;

/// A session, and what is in its files.
#[derive(Debug)]
pub struct LoadedSession {
    /// The session.
    pub store: SessionStore,
    /// Its dreams, or why they cannot be read. Deleted ones are left out.
    pub dreams: Vec<(DreamId, Result<DreamEpisode, SessionError>)>,
    /// The reward that was learned last.
    pub reward: Result<Option<Parameters>, SessionError>,
    /// Dreams whose program ended before they did.
    pub unfinished: Result<Vec<UnfinishedDream>, SessionError>,
    /// Lines on the episodes that its reward drove, as `dropj deploy --json` prints them.
    pub driven: Result<Vec<u8>, SessionError>,
}

impl LoadedSession {
    /// A session that has just been made: there is nothing to read yet.
    pub fn new(store: SessionStore) -> Self {
        Self {
            store,
            dreams: Vec::new(),
            reward: Ok(None),
            unfinished: Ok(Vec::new()),
            driven: Ok(Vec::new()),
        }
    }

    /// Holds the session and its dreams against the world model that it is to go on with.
    pub fn bind_model(&mut self, model: &ModelIdentity) -> Result<(), SessionError> {
        self.store.bind_model(model)?;
        for (id, dream) in &mut self.dreams {
            if let Ok(episode) = dream
                && let Err(met) = episode.require(model)
            {
                *dream = Err(SessionError::Dream { met: met.into(), path: self.store.dream_path(*id) });
            }
        }
        Ok(())
    }

    /// Reads all that the session in `store` holds.
    ///
    /// `report` is told how many dreams of how many are read, and may end it; then there is nothing.
    pub fn read(
        store: SessionStore,
        report: &mut dyn FnMut(usize, usize) -> ControlFlow<()>,
    ) -> Option<Self> {
        let lens = store.session().dream_lens();
        let mut dreams = Vec::with_capacity(lens.len());
        for (n_read, (id, _)) in lens.iter().enumerate() {
            if report(n_read, lens.len()).is_break() {
                return None;
            }
            dreams.push((*id, store.dream(*id)));
        }
        let (reward, unfinished, driven) = (store.reward(), store.unfinished_dreams(), store.driven());
        Some(Self { store, dreams, reward, unfinished, driven })
    }
}
