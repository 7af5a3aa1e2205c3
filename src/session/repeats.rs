//! Queries that are asked a second time, with their sides changed over: does the annotator say the same?
//!
//! The second answer says how consistent the annotator is, and nothing else. It is no label, for the same pair would
//! only count twice. It counts neither as answered nor as skipped, so that no budget moves.

use crate::evaluation::Agreement;
use crate::query::{QueryId, Response};
use crate::session::event::Choice;
use crate::session::{AskedQuery, Session};

/// So many other answers come before a query is asked again, that nobody remembers what they said.
pub const REPEAT_AFTER: usize = 10;

impl AskedQuery {
    /// The query that this one repeats.
    pub fn repeats(&self) -> Option<QueryId> {
        if let Choice::Repeat(of) = self.choice { Some(of) } else { None }
    }
}

impl Session {
    /// The queries that `annotator` could be asked again: answered by them under the present protocol, with more than a
    /// skip, and at least [`REPEAT_AFTER`] answers ago. None of them twice.
    pub fn repeatable(&self, annotator: &str) -> Vec<QueryId> {
        let answers = self.answers();
        let Some(n_long_ago) = answers.len().checked_sub(REPEAT_AFTER) else { return Vec::new() };
        let is_repeated = |id| self.queries().iter().any(|asked| asked.repeats() == Some(id));
        let could_be = |id: &QueryId| {
            // A single step has no sides to change over.
            let is_pair = |asked: &AskedQuery| asked.transition.is_none() && asked.repeats().is_none();
            self.query(*id).is_some_and(is_pair) && !is_repeated(*id)
        };
        let long_ago = answers[..n_long_ago].iter().filter(|given| {
            let is_skip = matches!(given.answer.response, Response::Skipped(_));
            !is_skip && given.protocol == self.protocol() && given.answer.annotator == annotator
        });
        long_ago.map(|given| given.answer.query).filter(could_be).collect()
    }

    /// How far annotators said the same when they were asked again: all of them, or the one of this name.
    pub fn consistency(&self, annotator: Option<&str>) -> Option<Agreement> {
        let pairs: Vec<_> = self.repeated(annotator).collect();
        Agreement::of(&pairs, self.weights().justifications.default())
    }

    /// What was said first and what was said again by the same annotator, both as of the first query's sides.
    pub fn repeated(&self, annotator: Option<&str>) -> impl Iterator<Item = (Response, Response)> {
        let is_meant = move |again: &&AskedQuery| {
            let who = again.answer().map(|given| given.answer.annotator.as_str());
            annotator.is_none() || who == annotator
        };
        self.queries().iter().filter(is_meant).filter_map(|again| self.repeated_by(again))
    }

    /// The same of one query that repeats another.
    pub(super) fn repeated_by(&self, again: &AskedQuery) -> Option<(Response, Response)> {
        let first = self.query(again.repeats()?)?;
        let (one, other) = (&first.answer()?.answer, &again.answer()?.answer);
        let is_swapped = first.query.left != again.query.left;
        let response = if is_swapped { other.response.mirrored() } else { other.response };
        (one.annotator == other.annotator).then_some((one.response, response))
    }
}
