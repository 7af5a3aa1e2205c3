//! Which dreams are asked about: those that were driven, or trajectories that were made to be asked about.

use crate::query::{DreamId, Protocol};
use crate::session::event::{Choice, DreamSource, KeptDream};
use crate::session::{AskedQuery, Session};

impl Session {
    /// The dreams in use that `protocol` asks about, with their lengths: ReQueST's were made, all others were driven.
    pub fn dreams_for(&self, protocol: Protocol) -> Vec<(DreamId, usize)> {
        let asked_about = self.dreams().iter().filter(|kept| {
            !self.is_dropped(kept.dream) && is_synthesized(kept) == (protocol == Protocol::Request)
        });
        asked_about.map(|kept| (kept.dream, kept.len)).collect()
    }

    /// Whether `protocol` asks what was asked: about a pair, a transition that was driven, or one that was made.
    pub fn is_of(&self, asked: &AskedQuery, protocol: Protocol) -> bool {
        match asked.transition {
            None => !protocol.is_sparse(),
            Some(transition) => {
                let kept = &self.dreams()[transition.dream.0 as usize];
                protocol.is_sparse() && is_synthesized(kept) == (protocol == Protocol::Request)
            }
        }
    }

    /// How many trajectories were made so far.
    pub fn n_synthesized(&self) -> usize {
        self.dreams().iter().filter(|kept| is_synthesized(kept)).count()
    }

    /// The trajectories in use about which nothing was asked yet, in the order of making.
    pub fn fresh_trajectories(&self) -> Vec<&KeptDream> {
        let mut fresh: Vec<_> = self.dreams().iter().filter(|kept| is_synthesized(kept)).collect();
        let is_begun = |dream| self.queries().iter().any(|asked| asked.query.left.dream == dream);
        fresh.retain(|kept| !self.is_dropped(kept.dream) && !is_begun(kept.dream));
        fresh
    }

    /// Why transitions of `dream` are asked about.
    pub fn choice_of(&self, dream: DreamId) -> Choice {
        let acquisition = self.dreams().get(dream.0 as usize).and_then(|kept| kept.acquisition);
        acquisition.map_or(Choice::Uniform, Choice::Synthesized)
    }
}

fn is_synthesized(kept: &KeptDream) -> bool {
    kept.source == DreamSource::Synthesized
}
