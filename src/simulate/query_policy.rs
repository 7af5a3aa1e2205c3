//! Which queries a simulation asks: what the window does for a person, without a clock.

use std::ops::ControlFlow;

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use crate::dream::{DreamEpisode, Rows};
use crate::query::strategy::N_CANDIDATES;
use crate::query::{
    DreamId, Justifications, KnownClips, Label, Pool, Query, Response, SegmentRef, Strategy, most_disagreed,
};
use crate::reward::{RewardConfig, RewardEnsemble, RewardInputs, SegmentPair, Trainer, segment_rows};
use crate::tensor::NotFinite;
use crate::world::{Action, ActionRanges};
use crate::world_model::WorldModel;

/// From so many labels on a reward is learned, and again whenever a tenth of them is new.
const MIN_LABELS: usize = 10;
const NEW_SHARE: usize = 10;
/// The stream of what is chosen. Answers have those from 1 on.
const STREAM: u64 = u64::MAX;

/// Chooses pairs, learning a reward along where that is what chooses.
pub(super) struct QueryPolicy {
    strategy: Strategy,
    /// How many dreams it was given.
    n_dreams: usize,
    lens: Vec<(DreamId, usize)>,
    marks: Vec<(DreamId, usize)>,
    known: KnownClips,
    rng: ChaCha8Rng,
    learner: Option<Learner>,
}

/// A reward that learns while answers come in.
struct Learner {
    trainer: Trainer,
    ranges: ActionRanges,
    /// The actions and features of every dream.
    dreams: Vec<(Vec<Action>, Rows)>,
    rng: ChaCha8Rng,
    /// Labels since the last fit, and whether there was one.
    n_new: usize,
    has_learned: bool,
}

impl QueryPolicy {
    /// Asks by `strategy`, for which a reward of the shape `reward` is learned if it needs one.
    pub(super) fn new(
        model: &WorldModel,
        strategy: Strategy,
        justifications: &Justifications,
        reward: &RewardConfig,
        seed: u64,
    ) -> Self {
        let known = KnownClips::new(justifications);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(STREAM);
        let learner = (strategy == Strategy::Disagreement).then(|| Learner::new(model, reward, seed));
        Self { strategy, n_dreams: 0, lens: Vec::new(), marks: Vec::new(), known, rng, learner }
    }

    /// Asks from now on about `dreams`, whose ids follow those of the ones that it was given before.
    pub(super) fn add_dreams(&mut self, model: &WorldModel, dreams: &[DreamEpisode]) {
        let numbered = || (self.n_dreams as u32..).map(DreamId).zip(dreams);
        let marks = numbered().flat_map(|(id, dream)| dream.unsafe_marks.iter().map(move |mark| (id, *mark)));
        let (lens, marks) = (numbered().map(|(id, dream)| (id, dream.len())).collect(), marks.collect());
        (self.lens, self.marks) = (lens, marks);
        self.n_dreams += dreams.len();
        if let Some(learner) = &mut self.learner {
            let read = dreams.iter().map(|dream| (dream.actions.clone(), dream.features(model)));
            learner.dreams.extend(read);
        }
    }

    /// The dreams that are asked about and their lengths.
    pub(super) fn lens(&self) -> &[(DreamId, usize)] {
        &self.lens
    }

    /// What is asked instead of `query`, which was drawn by chance, and how it was chosen.
    pub(super) fn choose(&mut self, query: Query) -> (Query, Strategy) {
        let Self { strategy, lens, marks, known, rng, learner, .. } = self;
        let pool = Pool { dreams: lens, known, marks };
        let pair = match (*strategy, learner) {
            (Strategy::Balanced | Strategy::LeastAnswered | Strategy::SafetyBoundary, _) => {
                pool.draw(*strategy, rng)
            }
            (Strategy::Disagreement, Some(learner)) if learner.has_learned => {
                let pairs = (0..N_CANDIDATES).filter_map(|_| pool.draw(*strategy, rng)).collect::<Vec<_>>();
                learner.most_disagreed(&pairs)
            }
            (Strategy::Disagreement | Strategy::Uniform, _) => None,
        };
        pair.map_or((query, Strategy::Uniform), |[left, right]| (Query { left, right, ..query }, *strategy))
    }

    /// Observes an answer, and learns from it where a reward chooses.
    pub(super) fn observe(
        &mut self,
        query: Query,
        response: Response,
        label: Option<Label>,
    ) -> Result<(), NotFinite> {
        self.known.record([query.left, query.right], response);
        if let (Some(learner), Some(label)) = (&mut self.learner, label) {
            learner.observe(query, label)?;
        }
        Ok(())
    }
}

impl Learner {
    fn new(model: &WorldModel, reward: &RewardConfig, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let ensemble =
            RewardEnsemble::new(RewardInputs::of(model), reward.clone(), &mut rng).on(model.backend());
        let ranges = model.ranges().clone();
        Self {
            trainer: Trainer::new(ensemble),
            ranges,
            dreams: Vec::new(),
            rng,
            n_new: 0,
            has_learned: false,
        }
    }

    fn rows(&self, segment: SegmentRef) -> Vec<f32> {
        let (actions, features) = &self.dreams[segment.dream.0 as usize];
        segment_rows(features, actions, &self.ranges, segment)
    }

    fn most_disagreed(&self, pairs: &[[SegmentRef; 2]]) -> Option<[SegmentRef; 2]> {
        let rows: Vec<_> = pairs.iter().map(|pair| pair.map(|segment| self.rows(segment))).collect();
        let found = self.trainer.ensemble().disagreements(&rows);
        most_disagreed(pairs, &found)
    }

    fn observe(&mut self, query: Query, label: Label) -> Result<(), NotFinite> {
        let pair = SegmentPair { left: self.rows(query.left), right: self.rows(query.right), label };
        self.trainer.add(&pair);
        self.n_new += 1;
        let n = self.trainer.n_labels();
        if n >= MIN_LABELS && self.n_new * NEW_SHARE >= n {
            let _ = self.trainer.fit(&mut self.rng, |_| ControlFlow::Continue(()))?;
            (self.n_new, self.has_learned) = (0, true);
        }
        Ok(())
    }
}
