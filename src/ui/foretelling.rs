//! What the reward says of clips that were answered already.
//!
//! Of a query that is still to be answered nothing is said, for it would lead whoever answers.

use std::collections::{BTreeMap, BTreeSet};

use crate::query::{Query, QueryId};
use crate::ui::App;
use crate::ui::crew::Order;
use crate::ui::state::State;
use crate::worker::{ClipRewards, ReviewerCommand};

/// What the present reward says, as far as it was asked.
#[derive(Default)]
pub(crate) struct Foretelling {
    said: BTreeMap<QueryId, [ClipRewards; 2]>,
    asked: BTreeSet<QueryId>,
}

impl State {
    /// What the reward says of the clips of an answered query, once it is known.
    pub(crate) fn foretold(&self, query: QueryId) -> Option<&[ClipRewards; 2]> {
        self.label.foretelling.said.get(&query).filter(|_| self.is_answered(query))
    }

    /// Whether it is worth asking for that.
    pub(crate) fn is_to_be_foretold(&self, query: QueryId) -> bool {
        self.reward.parameters.is_some()
            && self.is_answered(query)
            && !self.label.foretelling.asked.contains(&query)
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
    /// Has the reward say what it thinks of a query that was answered.
    pub(super) fn foretell(&mut self, id: QueryId) {
        if !self.state.is_to_be_foretold(id) {
            return;
        }
        let Some(query) = self.state.session().and_then(|session| session.query(id)) else { return };
        let query = query.query;
        let dreams = [query.left.dream, query.right.dream];
        if dreams.iter().any(|dream| !self.state.review.episodes.contains_key(dream)) {
            return;
        }
        self.state.label.foretelling.asked.insert(id);
        for dream in dreams {
            self.show_to_reviewer(dream);
        }
        self.crew.send(Order::Reviewer(ReviewerCommand::Foretell(query)));
    }

    pub(super) fn foretold(&mut self, query: Query, clips: [ClipRewards; 2]) {
        let is_known = self.state.session().and_then(|session| session.query(query.id));
        if is_known.is_some_and(|asked| asked.query == query) {
            self.state.label.foretelling.said.insert(query.id, clips);
        }
    }
}
