//! How the answering goes: only what was measured.

use crate::query::Response;
use crate::session::Session;

/// Seconds of one answer beyond which the annotator is taken to have been elsewhere.
pub const IDLE_SECS: f32 = 60.0;

/// Counts of a session, over the answers that count. What was asked again is counted apart.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Statistics {
    /// Queries asked, repetitions left out.
    pub n_asked: usize,
    /// Of these, answered with more than a skip.
    pub n_answered: usize,
    /// Of these, skipped.
    pub n_skipped: usize,
    /// Of these, marked for a second look.
    pub n_flagged: usize,
    /// Of those answered or skipped, those that took time: stand-ins take none, and tell nothing of anybody's pace.
    pub n_timed: usize,
    /// Of these, answered with more than a skip.
    pub n_timed_answered: usize,
    /// Repetitions that were answered or skipped.
    pub n_again: usize,
    /// Seconds spent with queries, repetitions and retracted answers included, at most [`IDLE_SECS`] each.
    pub active_secs: f32,
}

impl Statistics {
    pub(super) fn of(session: &Session) -> Self {
        let active_secs = session.spent.iter().map(|spent| spent.secs.min(IDLE_SECS)).sum();
        let mut statistics = Self { active_secs, ..Self::default() };
        for asked in &session.queries {
            let response = asked.answer().map(|given| given.answer.response);
            if asked.repeats().is_some() {
                statistics.n_again += usize::from(response.is_some());
                continue;
            }
            statistics.n_asked += 1;
            statistics.n_flagged += usize::from(asked.is_flagged);
            match response {
                None => {}
                Some(Response::Skipped(_)) => statistics.n_skipped += 1,
                Some(_) => statistics.n_answered += 1,
            }
            if asked.answer().is_some_and(|given| given.answer.secs > 0.0) {
                statistics.n_timed += 1;
                let is_skip = matches!(response, Some(Response::Skipped(_)));
                statistics.n_timed_answered += usize::from(!is_skip);
            }
        }
        statistics
    }

    /// Queries without an answer that counts.
    pub fn n_pending(&self) -> usize {
        self.n_asked - self.n_answered - self.n_skipped
    }

    /// Usable labels an hour of those whose time was taken, once some was spent.
    pub fn labels_per_hour(&self) -> Option<f32> {
        let rate = 3600.0 * self.n_timed_answered as f32 / self.active_secs;
        rate.is_finite().then_some(rate)
    }
}
