//! What the reward predicts of clips that were answered already.
//!
//! Of a query that is still to be answered nothing is said, for it would lead whoever answers.

use std::collections::{BTreeMap, BTreeSet};

use crate::app::{App, State};
use crate::query::{Query, QueryId};
use crate::worker::{ClipRewards, DreamInspectorCommand, WorkerCommand};

/// What the present reward predicts, as far as it was asked.
#[derive(Debug, Default)]
pub(crate) struct Predictions {
    predicted: BTreeMap<QueryId, [ClipRewards; 2]>,
    asked: BTreeSet<QueryId>,
}

impl State {
    /// What the reward predicts of the clips of an answered query, once it is known.
    pub(crate) fn prediction(&self, query: QueryId) -> Option<&[ClipRewards; 2]> {
        self.label.predictions.predicted.get(&query).filter(|_| self.is_answered(query))
    }

    /// Whether it is worth asking for that.
    pub(crate) fn is_to_be_predicted(&self, query: QueryId) -> bool {
        self.reward.parameters.is_some()
            && self.is_answered(query)
            && !self.label.predictions.asked.contains(&query)
    }

    /// The query on the screen, if it is there to be answered anew.
    pub(crate) fn reconsidered(&self) -> Option<QueryId> {
        let shown = self.label.shown.map(|shown| shown.query)?;
        (self.label.revisited == Some(shown) && self.is_answered(shown)).then_some(shown)
    }

    fn is_answered(&self, query: QueryId) -> bool {
        self.session().and_then(|session| session.query(query)).is_some_and(|asked| asked.answer().is_some())
    }
}

impl App {
    /// Has the reward predict which clip of an answered query is better.
    pub(super) fn predict(&mut self, id: QueryId) {
        if !self.state.is_to_be_predicted(id) {
            return;
        }
        let Some(query) = self.state.session().and_then(|session| session.query(id)) else { return };
        let query = query.query;
        let dreams = [query.left.dream, query.right.dream];
        if dreams.iter().any(|dream| !self.state.review.episodes.contains_key(dream)) {
            return;
        }
        self.state.label.predictions.asked.insert(id);
        for dream in dreams {
            self.show_to_inspector(dream);
        }
        self.send(WorkerCommand::DreamInspector(DreamInspectorCommand::Predict(query)));
    }

    pub(super) fn predicted(&mut self, query: Query, clips: [ClipRewards; 2]) {
        let is_known = self.state.session().and_then(|session| session.query(query.id));
        if is_known.is_some_and(|asked| asked.query == query) {
            self.state.label.predictions.predicted.insert(query.id, clips);
        }
    }
}
