//! Which queries come next: by chance, by disagreement, near marks, or one that was answered before.
//!
//! Disagreement is measured by the trainer; until it reports, what is ready is shown, and by chance if need be.

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::app::{App, State};
use crate::dream::Rows;
use crate::query::strategy::N_CANDIDATES;
use crate::query::{DreamId, Mix, Pool, Query, SegmentRef, Strategy, most_disagreed};
use crate::session::{Choice, Event, Session};
use crate::worker::{TrainerCommand, WorkerCommand};

/// While so many pairs wait to be shown, there is time to measure others.
const N_PATIENT: usize = 2;
/// At most so many queries of a hundred are asked again.
pub(crate) const MOST_REPEATS: u8 = 30;

/// At most so many pairs of a hundred are held back.
pub(crate) const MOST_HELD_BACK: u8 = 60;
/// So often another pair is drawn where one is held back; the least doubtful of them is asked.
const N_TRIES: usize = 20;

/// How queries are selected.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct QuerySelection {
    /// How pairs are chosen.
    pub mix: Mix,
    /// How many queries of a hundred are ones that were answered before.
    #[serde(rename = "again")]
    pub repeats: u8,
    /// How many pairs of a hundred are held back for being the most doubtful.
    pub held_back: u8,
}

impl Default for QuerySelection {
    fn default() -> Self {
        Self { mix: Mix::default(), repeats: 5, held_back: 0 }
    }
}

impl QuerySelection {
    /// The same, with nothing out of range.
    #[must_use]
    pub(super) fn clamped(self) -> Self {
        let (repeats, held_back) = (self.repeats.min(MOST_REPEATS), self.held_back.min(MOST_HELD_BACK));
        Self { mix: self.mix.clamped(), repeats, held_back }
    }

    /// The share of pairs that is held back, in `[0, 1]`.
    pub(crate) fn share_held_back(self) -> f32 {
        f32::from(self.held_back) / 100.0
    }
}

/// Two segments, and why they are asked about.
type Chosen = ([SegmentRef; 2], Choice);

/// Pairs whose disagreement the trainer measures.
#[derive(Debug, Default)]
pub(crate) struct Disagreements {
    /// Those that it was sent.
    sent: Option<Vec<[SegmentRef; 2]>>,
    /// The one that came of it.
    chosen: Option<Chosen>,
}

impl App {
    /// The pair of the next query, where `n_waiting` others are yet to be shown.
    ///
    /// Nothing comes where nothing can be shown, or where a better pair is worth waiting for.
    pub(super) fn select_query(&mut self, n_waiting: usize) -> Option<Chosen> {
        let open = self.state.open.as_ref()?;
        let session = &open.session;
        let is_readable = |dream: DreamId| !self.state.label.unreadable.contains(&dream);
        let mut dreams = session.dreams_for(session.protocol());
        dreams.retain(|(dream, _)| is_readable(*dream));
        // A stream of its own: what is asked does not hang on when it was drawn.
        let mut rng = ChaCha8Rng::seed_from_u64(open.header.seed);
        rng.set_stream(u64::from(session.next_query_id().0));
        let selection = self.state.label.selection;
        let (is_repeat, strategy) =
            (rng.random_range(0..100) < selection.repeats, selection.mix.draw(&mut rng));
        if is_repeat {
            let mut known = session.repeatable(&self.annotator());
            known.retain(|id| {
                session.query(*id).is_some_and(|asked| {
                    is_readable(asked.query.left.dream) && is_readable(asked.query.right.dream)
                })
            });
            if !known.is_empty() {
                let id = known[rng.random_range(0..known.len())];
                let query = session.query(id)?.query;
                return Some(([query.right, query.left], Choice::Repeat(id)));
            }
        }
        let screened = |rng: &mut ChaCha8Rng, draw: &Draw<'_>| screened(&self.state, rng, draw);
        let (known, marks) = (session.known_clips(), session.marks());
        let pool = Pool { dreams: &dreams, known: &known, marks: &marks };
        let any: &Draw<'_> = &|rng| pool.draw(Strategy::Uniform, rng);
        let by_chance = (screened(&mut rng, any)?, Choice::Uniform);
        match strategy {
            Strategy::Uniform => Some(by_chance),
            Strategy::Balanced | Strategy::LeastAnswered | Strategy::SafetyBoundary => {
                let drawn = screened(&mut rng, &|rng| pool.draw(strategy, rng));
                Some(drawn.map_or(by_chance, |pair| (pair, strategy.into())))
            }
            Strategy::Disagreement if self.state.reward.parameters.is_none() => Some(by_chance),
            Strategy::Disagreement => {
                let pairs: Vec<_> = (0..N_CANDIDATES).filter_map(|_| screened(&mut rng, any)).collect();
                let disagreements = &mut self.state.label.disagreements;
                if let Some(chosen) = disagreements.chosen.take() {
                    return Some(chosen);
                }
                if disagreements.sent.is_none() {
                    disagreements.sent = Some(pairs.clone());
                    self.send(WorkerCommand::Trainer(TrainerCommand::MeasureDisagreement(pairs)));
                }
                (n_waiting < N_PATIENT).then_some(by_chance)
            }
        }
    }

    /// Writes down what is held back from here on, before anything is asked so.
    pub(super) fn note_screen(&mut self) -> bool {
        let held_back = self.state.label.selection.held_back;
        let is_noted = self.state.session().is_none_or(|session| session.held_back() == held_back);
        if !is_noted {
            self.record(Event::ScreenChanged { held_back });
        }
        is_noted
    }

    /// Takes in the signs of a dream.
    pub(super) fn dream_screened(&mut self, dream: DreamId, seed: u64, signs: &Rows) {
        let Some(session) = self.state.session() else { return };
        // That of a session before this one has another seed.
        let kept = session.dreams().get(dream.0 as usize);
        if kept.is_some_and(|kept| kept.seed == seed && kept.len == signs.len()) {
            self.state.label.screen.add_dream(dream, signs);
            self.learn_doubt();
        }
    }

    /// Learns what is doubtful from what was skipped so far.
    pub(in crate::app) fn learn_doubt(&mut self) {
        let Some(judged) = self.state.session().map(Session::looked_at) else { return };
        self.state.label.screen.learn(&judged);
    }

    /// Lets go of the pairs whose disagreement is measured: one may show a dream that is deleted.
    pub(in crate::app) fn forget_disagreements(&mut self) {
        self.state.label.disagreements = Disagreements::default();
    }

    /// Takes in what the trainer says of `pairs`: the one that is disagreed about most, or any where nothing is known.
    pub(super) fn disagreements_measured(&mut self, pairs: &[[SegmentRef; 2]], measured: Option<&[f32]>) {
        let disagreements = &mut self.state.label.disagreements;
        // Those of another session are of no use here.
        if disagreements.sent.as_deref() != Some(pairs) {
            return;
        }
        disagreements.sent = None;
        let most = measured.and_then(|measured| most_disagreed(pairs, measured));
        disagreements.chosen = match most {
            Some(pair) => Some((pair, Choice::Disagreement)),
            None => pairs.first().map(|pair| (*pair, Choice::Uniform)),
        };
    }
}

/// Draws a pair, if there is one.
type Draw<'a> = dyn Fn(&mut ChaCha8Rng) -> Option<[SegmentRef; 2]> + 'a;

/// A pair that is not held back; where all are, the least doubtful of twenty.
fn screened(state: &State, rng: &mut ChaCha8Rng, draw: &Draw<'_>) -> Option<[SegmentRef; 2]> {
    let (screen, share) = (&state.label.screen, state.label.selection.share_held_back());
    let mut best = draw(rng)?;
    for _ in 1..N_TRIES {
        if !screen.holds_back(best, share) {
            break;
        }
        let other = draw(rng)?;
        if screen.anomaly(other) < screen.anomaly(best) {
            best = other;
        }
    }
    Some(best)
}

/// Whether a query that was drawn already is to be asked last.
pub(super) fn is_held_back(state: &State, query: &Query) -> bool {
    let label = &state.label;
    label.screen.holds_back([query.left, query.right], label.selection.share_held_back())
}

/// What stands in the way of asking as was chosen, in sentences.
pub(crate) fn obstacles(state: &State) -> Vec<&'static str> {
    let mix = state.label.selection.mix;
    let has_marks = state.session().is_some_and(|session| !session.marks().is_empty());
    let mut all = Vec::new();
    if mix.disagreement > 0 && state.reward.parameters.is_none() {
        all.push("Nothing is learned yet that could be unsure: these are drawn by chance for now");
    }
    if mix.boundary > 0 && !has_marks {
        all.push("No dream has an unsafe mark yet: these are drawn by chance for now");
    }
    all
}
