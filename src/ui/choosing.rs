//! Which queries come next: by chance, by disagreement, near marks, or one that was answered before.
//!
//! What takes a model is weighed by the trainer; until it answers, what is ready is shown, and by chance if need be.

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::query::strategy::{N_CANDIDATES, sample_near_mark, sample_pair};
use crate::query::{DreamId, Mix, SegmentRef, Strategy};
use crate::session::Choice;
use crate::ui::App;
use crate::ui::crew::Order;
use crate::ui::state::State;
use crate::worker::TrainerCommand;

/// While so many pairs wait to be shown, there is time to weigh others.
const N_PATIENT: usize = 2;
/// At most so many queries of a hundred are asked again.
pub(super) const MOST_AGAIN: u8 = 30;

/// What is asked about.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Asking {
    /// How pairs are chosen.
    pub mix: Mix,
    /// How many queries of a hundred are ones that were answered before.
    pub again: u8,
}

impl Default for Asking {
    fn default() -> Self {
        Self { mix: Mix::default(), again: 5 }
    }
}

impl Asking {
    /// The same, with nothing out of range.
    #[must_use]
    pub(super) fn clamped(self) -> Self {
        Self { mix: self.mix.clamped(), again: self.again.min(MOST_AGAIN) }
    }
}

/// Two segments, and why they are asked about.
type Chosen = ([SegmentRef; 2], Choice);

/// Pairs that the trainer weighs.
#[derive(Debug, Default)]
pub(crate) struct Weighing {
    /// Those that it was sent.
    sent: Option<Vec<[SegmentRef; 2]>>,
    /// The one that came of it.
    chosen: Option<Chosen>,
}

impl App {
    /// The pair of the next query, where `n_waiting` others are yet to be shown.
    ///
    /// Nothing comes where nothing can be shown, or where a better pair is worth waiting for.
    pub(super) fn choose(&mut self, n_waiting: usize) -> Option<Chosen> {
        let store = self.state.store.as_ref()?;
        let session = store.session();
        let is_readable = |dream: DreamId| !self.state.label.unreadable.contains(&dream);
        let mut dreams = session.dream_lens();
        dreams.retain(|(dream, _)| is_readable(*dream));
        // A stream of its own: what is asked does not hang on when it was drawn.
        let mut rng = ChaCha8Rng::seed_from_u64(store.header().seed);
        rng.set_stream(u64::from(session.next_query_id().0));
        let asking = self.state.label.asking;
        let by_chance = sample_pair(&dreams, &mut rng)?;
        let (is_again, strategy) = (rng.random_range(0..100) < asking.again, asking.mix.draw(&mut rng));
        if is_again {
            let mut known = session.repeatable(&self.annotator());
            known.retain(|id| {
                session.query(*id).is_some_and(|asked| {
                    is_readable(asked.query.left.dream) && is_readable(asked.query.right.dream)
                })
            });
            if !known.is_empty() {
                let id = known[rng.random_range(0..known.len())];
                let query = session.query(id)?.query;
                return Some(([query.right, query.left], Choice::Again(id)));
            }
        }
        let by_chance = (by_chance, Choice::Uniform);
        match strategy {
            Strategy::Uniform => Some(by_chance),
            Strategy::SafetyBoundary => {
                let near = sample_near_mark(&dreams, &session.marks(), &mut rng);
                Some(near.map_or(by_chance, |pair| (pair, Choice::SafetyBoundary)))
            }
            Strategy::Disagreement if self.state.reward.parameters.is_none() => Some(by_chance),
            Strategy::Disagreement => {
                let weighing = &mut self.state.label.weighing;
                if let Some(chosen) = weighing.chosen.take() {
                    return Some(chosen);
                }
                if weighing.sent.is_none() {
                    let pairs: Vec<_> =
                        (0..N_CANDIDATES).filter_map(|_| sample_pair(&dreams, &mut rng)).collect();
                    weighing.sent = Some(pairs.clone());
                    self.crew.send(Order::Trainer(TrainerCommand::Weigh(pairs)));
                }
                (n_waiting < N_PATIENT).then_some(by_chance)
            }
        }
    }

    /// Takes in what the trainer says of `pairs`: the one that is disagreed about most, or any where nothing is known.
    pub(super) fn weighed(&mut self, pairs: Vec<[SegmentRef; 2]>, disagreements: Option<&[f32]>) {
        let weighing = &mut self.state.label.weighing;
        // Those of another session are of no use here.
        if weighing.sent.as_ref() != Some(&pairs) {
            return;
        }
        weighing.sent = None;
        let most = disagreements.and_then(|all| (0..all.len()).max_by(|a, b| all[*a].total_cmp(&all[*b])));
        let choice = if most.is_some() { Choice::Disagreement } else { Choice::Uniform };
        weighing.chosen = pairs.get(most.unwrap_or(0)).map(|pair| (*pair, choice));
    }
}

/// What stands in the way of asking as was chosen, in sentences.
pub(super) fn obstacles(state: &State) -> Vec<&'static str> {
    let mix = state.label.asking.mix;
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
