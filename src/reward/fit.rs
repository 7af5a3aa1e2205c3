//! Fitting the ensemble to answers: Bradley–Terry cross-entropy with soft labels (method §8), and where they name justifications,
//! what each segment shows.

mod gradients;

use std::ops::ControlFlow;

use rand::Rng;
use rand::seq::SliceRandom as _;
use serde::{Deserialize, Serialize};
use tch::{Kind, Tensor, nn};

use crate::dream::Rows;
use crate::query::{Justification, Label, SEGMENT_LEN, SegmentRef, Shown};
use crate::reward::hazards::HazardFit;
use crate::reward::metrics::{Prediction, PredictionMetrics};
use crate::reward::{Learned, RewardConfig, RewardEnsemble, Schedule};
use crate::tensor::adam::pytorch_adam;
use crate::tensor::{NotFinite, dims, from_slice, require_finite, to_vec};
use crate::world::{Action, ActionRanges};

pub use gradients::GradientNorm;

/// How many answers the recent metrics look back on.
pub const RECENT: usize = 50;
/// Steps in which hazards are learned, for each in which labels are.
const HAZARD_UPDATES: usize = 2;
/// After so many of them a fit tells how far it is.
const ROUND: usize = 10;
/// Two segments as the ensemble reads them, and which is better: the triple (σ⁰, σ¹, μ) of the paper.
#[derive(Clone, Debug, PartialEq)]
pub struct SegmentPair {
    /// σ⁰: [`SEGMENT_LEN`] rows `[x | ã]`, one after the other.
    pub left: Vec<f32>,
    /// σ¹, likewise.
    pub right: Vec<f32>,
    /// What was answered.
    pub label: Label,
}

/// The rows `[x | ã]` of a segment of a dream.
///
/// # Panics
/// Where the segment reaches beyond the dream.
///
/// # Shapes
/// - `features`: `[T, F]`, `actions`: T of them, both of the segment's dream
/// - returns `[k, F + A]`
pub fn segment_rows(
    features: &Rows,
    actions: &[Action],
    ranges: &ActionRanges,
    segment: SegmentRef,
) -> Vec<f32> {
    let mut rows = Vec::with_capacity(SEGMENT_LEN * (features.width + ranges.n_axes()));
    let steps = segment.start..segment.start + SEGMENT_LEN;
    for (t, action) in steps.clone().zip(&actions[steps]) {
        rows.extend_from_slice(features.row(t));
        rows.extend_from_slice(&ranges.scaled(action));
    }
    rows
}

/// What an epoch brought.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EpochReport {
    /// Its number in the fit, from 1.
    pub epoch: usize,
    /// Of how many.
    pub n_epochs: usize,
    /// The mean loss of each member before its steps, in nats a label.
    pub losses: Vec<f64>,
}

/// An ensemble that learns, with the answers it learns from.
#[derive(Debug)]
pub struct Trainer {
    ensemble: RewardEnsemble,
    adam: nn::Optimizer,
    pairs: Vec<Pair>,
    /// The prediction of each answer, where one was made.
    predictions: Vec<Option<Prediction>>,
}

/// A [`SegmentPair`] in the ensemble's arithmetic.
#[derive(Debug)]
struct Pair {
    /// `[2, k, F + A]`.
    rows: Tensor,
    label: Label,
}

impl Pair {
    /// As many hazards as its answer knows anything of.
    fn n_hazards(&self) -> i64 {
        self.label.shown().map(Shown::n_places).into_iter().max().unwrap_or(0) as i64
    }
}

impl Clone for Pair {
    fn clone(&self) -> Self {
        Self { rows: self.rows.shallow_clone(), label: self.label }
    }
}

impl Trainer {
    /// A trainer that goes on with `ensemble` and knows no answers yet.
    pub fn new(ensemble: RewardEnsemble) -> Self {
        Self { adam: ensemble.adam(), ensemble, pairs: Vec::new(), predictions: Vec::new() }
    }

    /// The ensemble as it stands.
    pub fn ensemble(&self) -> &RewardEnsemble {
        &self.ensemble
    }

    /// How many answers there are to learn from.
    pub fn n_labels(&self) -> usize {
        self.pairs.len()
    }

    /// Predicts an answer, then adds it. It is learned from only in the steps to come.
    ///
    /// # Panics
    /// Where the segments are not [`SEGMENT_LEN`] rows of the ensemble's width.
    pub fn predict_and_add(&mut self, pair: &SegmentPair) -> Prediction {
        self.add(pair);
        let idx = self.pairs.len() - 1;
        let prediction = self.predict(&self.pairs[idx]);
        self.predictions[idx] = Some(prediction);
        prediction
    }

    /// Adds an answer without a prediction, as where the ensemble has learned too little for one.
    ///
    /// # Panics
    /// Where the segments are not [`SEGMENT_LEN`] rows of the ensemble's width.
    pub fn add(&mut self, pair: &SegmentPair) {
        let shape = [SEGMENT_LEN as i64, self.ensemble.row_len()];
        let rows = Tensor::stack(&[from_slice(&pair.left, &shape), from_slice(&pair.right, &shape)], 0);
        let rows = self.ensemble.here(&rows).to_kind(self.ensemble.kind);
        self.pairs.push(Pair { rows, label: pair.label });
        self.predictions.push(None);
    }

    /// Changes what was answered at `idx`. Its prediction stays, for now it is no longer new.
    ///
    /// # Panics
    /// Where there is no answer.
    pub fn relabel(&mut self, idx: usize, label: Label) {
        self.pairs[idx].label = label;
        if let Some(prediction) = &mut self.predictions[idx] {
            prediction.label = label;
        }
    }

    /// Goes on with the ensemble of `fitted`. Answers and their predictions stay.
    pub fn adopt(&mut self, fitted: Self) {
        (self.ensemble, self.adam) = (fitted.ensemble, fitted.adam);
    }

    /// Removes the answer at `idx`, in the order of adding. What was learned from it stays until the next fit.
    ///
    /// # Panics
    /// Where there is none.
    pub fn remove(&mut self, idx: usize) {
        self.pairs.remove(idx);
        self.predictions.remove(idx);
    }

    /// How well the last [`RECENT`] answers were predicted before they were learned.
    pub fn recent(&self) -> Option<PredictionMetrics> {
        let predictions: Vec<_> = self.predictions.iter().flatten().copied().collect();
        PredictionMetrics::of(&predictions[predictions.len().saturating_sub(RECENT)..])
    }

    /// How well all answers were predicted before they were learned.
    pub fn overall(&self) -> Option<PredictionMetrics> {
        PredictionMetrics::of(&self.predictions.iter().flatten().copied().collect::<Vec<_>>())
    }

    /// Fits a fresh ensemble to all answers, as the authors do: no validation split, a fixed number of steps.
    ///
    /// Stops early, keeping what it has, where `on_epoch` breaks. Fails at the first loss that is no number: after that
    /// nothing it has is worth keeping.
    pub fn fit(
        &mut self,
        rng: &mut impl Rng,
        mut on_epoch: impl FnMut(&EpochReport) -> ControlFlow<()>,
    ) -> Result<ControlFlow<()>, NotFinite> {
        self.fit_watched(
            rng,
            |_, report| if report.epoch == 0 { ControlFlow::Continue(()) } else { on_epoch(report) },
        )
    }

    /// The same, where `on_epoch` may look at what is learning: after each epoch, and before the first, which it is told as
    /// the epoch 0 without losses.
    pub fn fit_watched(
        &mut self,
        rng: &mut impl Rng,
        mut on_epoch: impl FnMut(&Self, &EpochReport) -> ControlFlow<()>,
    ) -> Result<ControlFlow<()>, NotFinite> {
        self.begin_anew(rng);
        let n_passes = self.ensemble.config.epochs(self.pairs.len());
        let n_hazards = self.n_hazards();
        let n_rounds =
            if n_hazards > 0 { (HAZARD_UPDATES * self.ensemble.config.updates).div_ceil(ROUND) } else { 0 };
        let n_epochs = n_passes + n_rounds;
        if on_epoch(self, &EpochReport { epoch: 0, n_epochs, losses: Vec::new() }).is_break() {
            return Ok(ControlFlow::Break(()));
        }
        let mut last = Vec::new();
        for epoch in 1..=n_passes {
            let left = match self.ensemble.config.schedule {
                Schedule::Falling => 1.0 - (epoch - 1) as f64 / n_passes as f64,
                Schedule::Authors { .. } => 1.0,
            };
            self.adam.set_lr(self.ensemble.config.learning_rate * left);
            let losses = self.epoch(rng);
            require_losses(&losses, epoch, "the reward")?;
            last.clone_from(&losses);
            if on_epoch(self, &EpochReport { epoch, n_epochs, losses }).is_break() {
                return Ok(ControlFlow::Break(()));
            }
        }
        require_finite(&self.ensemble.store, "the reward")?;
        self.fit_hazards(n_hazards, n_rounds, rng, |trainer, round| {
            let report = EpochReport { epoch: n_passes + round, n_epochs, losses: last.clone() };
            on_epoch(trainer, &report)
        })
    }

    /// As many hazards as answers name, where more than labels is learned, and of at least two it is known what shows it and
    /// what does not.
    fn n_hazards(&self) -> i64 {
        let n = self.pairs.iter().map(Pair::n_hazards).max().unwrap_or(0);
        let told = |hazard: i64, wanted| {
            let mut sides = self.pairs.iter().flat_map(|pair| pair.label.shown());
            sides.any(|shown| shown.shows(Justification(hazard as u8)) == Some(wanted))
        };
        let are_several = || (0..n).filter(|hazard| told(*hazard, true) && told(*hazard, false)).count() > 1;
        if self.ensemble.config.learned == Learned::Hazards && are_several() { n } else { 0 }
    }

    /// Learns beside the reward what hazards look like: so many, in rounds of [`ROUND`] steps.
    fn fit_hazards(
        &mut self,
        n_hazards: i64,
        n_rounds: usize,
        rng: &mut impl Rng,
        mut on_round: impl FnMut(&Self, usize) -> ControlFlow<()>,
    ) -> Result<ControlFlow<()>, NotFinite> {
        let RewardEnsemble { config, kind, .. } = &self.ensemble;
        let config = RewardConfig { hazards: n_hazards, ..config.clone() };
        let sides = self.pairs.iter().map(|pair| ([0, 1].map(|side| pair.rows.select(0, side)), pair.label));
        let sides: Vec<_> = sides.collect();
        let answers: Vec<_> = sides.iter().map(|([left, right], label)| (left, right, *label)).collect();
        let (device, row_len) = (self.ensemble.store.device(), self.ensemble.row_len());
        let Some(mut fit) = HazardFit::new(&config, *kind, device, &answers, row_len, rng) else {
            return Ok(ControlFlow::Continue(()));
        };
        let n_updates = n_rounds * ROUND;
        for round in 0..n_rounds {
            for i in round * ROUND..(round + 1) * ROUND {
                let loss = fit.step(1.0 - i as f64 / n_updates as f64, rng);
                require_losses(&[loss], round + 1, "what tells hazards")?;
            }
            if on_round(self, round + 1).is_break() {
                return Ok(ControlFlow::Break(()));
            }
        }
        let members = self.ensemble.config.members;
        let worth = |rows: &Tensor| {
            let rows = rows.expand([members, -1, -1], false);
            tch::no_grad(|| self.ensemble.forward(&rows)).mean_dim(0, false, Kind::Float)
        };
        let hazards = fit.into_hazards(worth);
        require_finite(hazards.store(), "what tells hazards")?;
        self.ensemble.config.hazards = n_hazards;
        self.ensemble.hazards = Some(hazards);
        Ok(ControlFlow::Continue(()))
    }

    /// Goes through all answers once, each member in an order of its own, and returns the losses before the steps.
    fn epoch(&mut self, rng: &mut impl Rng) -> Vec<f64> {
        let (n, batch) = (self.pairs.len(), self.ensemble.config.batch);
        let orders = self.orders(rng);
        let mut losses = vec![0.0; orders.len()];
        for start in (0..n).step_by(batch) {
            let end = (start + batch).min(n);
            let picks: Vec<_> = orders.iter().map(|order| &order[start..end]).collect();
            for (mean, loss) in losses.iter_mut().zip(self.step(&picks)) {
                *mean += f64::from(loss) * (end - start) as f64 / n as f64;
            }
        }
        losses
    }

    /// Fits a fresh ensemble to all but `fraction` of the answers and says how well it predicts those.
    ///
    /// Nothing where `on_epoch` breaks, or where there are too few answers to split.
    pub fn held_out(
        &self,
        fraction: f64,
        rng: &mut impl Rng,
        on_epoch: impl FnMut(&EpochReport) -> ControlFlow<()>,
    ) -> Result<Option<PredictionMetrics>, NotFinite> {
        let mut pairs = self.pairs.clone();
        pairs.shuffle(rng);
        let held_out = pairs.split_off(pairs.len() - (fraction * pairs.len() as f64).round() as usize);
        if pairs.is_empty() || held_out.is_empty() {
            return Ok(None);
        }
        let mut ensemble = self.ensemble.fresh(rng);
        // Answers are predicted by what labels taught.
        ensemble.config.learned = Learned::Label;
        let mut rest = Self { pairs, ..Self::new(ensemble) };
        if rest.fit(rng, on_epoch)?.is_break() {
            return Ok(None);
        }
        Ok(PredictionMetrics::of(&held_out.iter().map(|pair| rest.predict(pair)).collect::<Vec<_>>()))
    }

    /// A fresh ensemble; ours has the reward 0 everywhere.
    fn begin_anew(&mut self, rng: &mut impl Rng) {
        self.ensemble = self.ensemble.fresh(rng);
        // DIFFERENCE: the authors begin with outputs as drawn: likes and dislikes by chance, which a short fit keeps.
        if self.ensemble.config.schedule == Schedule::Falling {
            self.ensemble.zero_output();
        }
        self.adam = self.ensemble.adam();
    }

    /// For each member a permutation of the answers.
    fn orders(&self, rng: &mut impl Rng) -> Vec<Vec<usize>> {
        let mut order = || {
            let mut order: Vec<_> = (0..self.pairs.len()).collect();
            order.shuffle(rng);
            order
        };
        (0..self.ensemble.config.members).map(|_| order()).collect()
    }

    /// Moves every member by one step on the pairs picked for it, and returns its loss before.
    fn step(&mut self, picks: &[&[usize]]) -> Vec<f32> {
        let picked = || picks.iter().copied().flatten().map(|&i| &self.pairs[i]);
        let rows = Tensor::stack(&picked().map(|pair| &pair.rows).collect::<Vec<_>>(), 0);
        let mus: Vec<f32> = picked().map(|pair| pair.label.mu()).collect();
        let (e, k) = (picks.len() as i64, SEGMENT_LEN as i64);
        let rows = rows.view([e, -1, 2, k, self.ensemble.row_len()]); // [E, B, 2, k, F + A]
        let mus = self.ensemble.here(&Tensor::from_slice(&mus)).view([e, -1]);
        let losses = loss(&self.ensemble.segment_returns(&rows), &mus);
        self.adam.backward_step(&losses.sum(Kind::Float));
        to_vec(&losses.detach())
    }

    /// What the mean of the members expects of `pair`, without what hazards cost.
    fn predict(&self, pair: &Pair) -> Prediction {
        let e = self.ensemble.config.members;
        let returns = tch::no_grad(|| {
            let rows = pair.rows.unsqueeze(0).unsqueeze(0); // [1, 1, 2, k, F + A]
            self.ensemble.segment_returns(&rows.expand([e, -1, -1, -1, -1], false))
        });
        let returns = returns.mean_dim(0, false, Kind::Float); // [1, 2]
        let gap = returns.double_value(&[0, 0]) - returns.double_value(&[0, 1]);
        Prediction { p: 1.0 / (1.0 + (-gap).exp()), label: pair.label }
    }
}

/// Fails where a loss is not a number: an ensemble's of each network, or of all together.
pub(super) fn require_losses(losses: &[f64], epoch: usize, whose: &str) -> Result<(), NotFinite> {
    match losses.iter().position(|loss| !loss.is_finite()) {
        Some(i) => {
            Err(NotFinite(format!("the loss of {whose} (network {}) in epoch {epoch} of the fit", i + 1)))
        }
        None => Ok(()),
    }
}

impl RewardEnsemble {
    /// The return of every segment for every member: R̂(σ) = Σ over its rows of r̂.
    ///
    /// # Shapes
    /// - `rows`: `[E, B, 2, k, F + A]`
    /// - returns `[E, B, 2]`
    pub(super) fn segment_returns(&self, rows: &Tensor) -> Tensor {
        let [e, b, sides, k, width] = dims(rows);
        let rewards = self.forward(&rows.reshape([e, -1, width])); // [E, B · 2 · k]
        rewards.view([e, b, sides, k]).sum_dim_intlist(-1, false, Kind::Float)
    }

    /// An optimizer for all members: it is one for each, because their parameters are apart.
    fn adam(&self) -> nn::Optimizer {
        pytorch_adam(&self.store, self.config.learning_rate)
    }

    /// Another ensemble of the same shape that has learned nothing.
    fn fresh(&self, rng: &mut impl Rng) -> Self {
        let config: RewardConfig = self.config.clone();
        Self::new(self.inputs.clone(), config, rng).in_kind(self.kind).on(self.backend())
    }
}

/// The cross-entropy of soft labels under the Bradley–Terry model, for each member: [DROPJ](crate#references), Eq. 1.
///
/// ```text
/// p = exp R̂⁰ / (exp R̂⁰ + exp R̂¹)
/// ℓ = mean of −[μ ln p + (1 − μ) ln(1 − p)]
/// ```
///
/// # Shapes
/// - `returns`: `[E, B, 2]`, left and right; `mus`: `[E, B]`
/// - returns nats, `[E]`
fn loss(returns: &Tensor, mus: &Tensor) -> Tensor {
    let gap = returns.select(2, 0) - returns.select(2, 1); // [E, B]
    // −ln σ(g) = softplus(g) − g and −ln(1 − σ(g)) = softplus(g).
    (gap.softplus() - mus * gap).mean_dim(1, false, Kind::Float)
}

#[cfg(test)]
pub(super) mod tests {
    use proptest::prelude::*;
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::query::{DreamId, Justifications, Preference, Response, SafetyAnswer, Weights};
    use crate::reward::RewardModel as _;
    use crate::tensor::normal;

    pub(super) const F: i64 = 6;

    pub(super) fn rng(seed: u64) -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(seed)
    }

    fn label(answer: SafetyAnswer) -> Label {
        Weights::paper().label(&Response::Safety(answer)).unwrap()
    }

    pub(super) fn pair(answer: SafetyAnswer, seed: u64) -> SegmentPair {
        let segment = |seed| to_vec(&normal(&mut rng(seed), &[SEGMENT_LEN as i64, F + 3]));
        SegmentPair { left: segment(2 * seed), right: segment(2 * seed + 1), label: label(answer) }
    }

    /// Eight pairs, each labeled by nothing but chance: they can only be learned by heart.
    pub(super) fn trainer(config: RewardConfig) -> Trainer {
        let mut trainer = Trainer::new(RewardEnsemble::new((F, "sha256:0"), config, &mut rng(0)));
        for i in 0..8 {
            let answer = if i % 3 == 0 { SafetyAnswer::OnlyLeft } else { SafetyAnswer::OnlyRight };
            trainer.predict_and_add(&pair(answer, i));
        }
        trainer
    }

    fn loss_of(gap: f32, mu: f32) -> f32 {
        to_vec(&loss(&from_slice(&[gap, 0.0], &[1, 1, 2]), &from_slice(&[mu], &[1, 1])))[0]
    }

    #[test]
    fn equal_returns_cost_the_logarithm_of_two() {
        assert!((loss_of(0.0, 1.0) - 2.0f32.ln()).abs() < 1e-6);
        assert!((loss_of(0.0, 0.75) - 2.0f32.ln()).abs() < 1e-6);
    }

    #[test]
    fn a_label_of_three_quarters_is_met_by_a_gap_of_its_logit() {
        let gap = Tensor::from(1.0986f32);
        assert!((gap.sigmoid().double_value(&[]) - 0.75).abs() < 1e-5);
        let least = loss_of(1.0986, 0.75);
        assert!(least < loss_of(1.05, 0.75) && least < loss_of(1.15, 0.75), "the loss is least at the logit");
    }

    #[test]
    fn a_small_ensemble_learns_eight_answers_by_heart() {
        let mut trainer = trainer(RewardConfig { updates: 120, ..RewardConfig::tiny() });
        let mut last = Vec::new();
        let done = trainer.fit(&mut rng(1), |report| {
            last.clone_from(&report.losses);
            ControlFlow::Continue(())
        });
        assert!(done.unwrap().is_continue() && last.iter().all(|loss| *loss < 0.1), "{last:?}");
        let all: Vec<_> = trainer.pairs.iter().map(|pair| trainer.predict(pair)).collect();
        assert_eq!(PredictionMetrics::of(&all).unwrap().agreement, Some(1.0));
    }

    /// Twelve answers about segments of which the worse shows, in five steps, a spill (its first feature is 1) or a crash
    /// (its second is). Each third names neither.
    fn naming(config: RewardConfig, weight: f32) -> Trainer {
        let named = [("spill", 1.0), ("crash", weight), ("default", 0.75)];
        let weights = Weights { justifications: Justifications::new(named).unwrap(), ..Weights::paper() };
        let mut trainer =
            Trainer::new(RewardEnsemble::new((F, "sha256:0"), config, &mut rng(0)).in_kind(Kind::Float));
        for i in 0..12 {
            let place = [0, 1, 2][i % 3];
            let segment = |seed, shows: bool| {
                let mut rows = to_vec(&normal(&mut rng(seed), &[SEGMENT_LEN as i64, F + 3]));
                for (t, row) in rows.chunks_mut(F as usize + 3).enumerate() {
                    (row[0], row[1]) = (0.0, 0.0);
                    if shows && place < 2 && (5..10).contains(&t) {
                        row[place] = 1.0;
                    }
                }
                rows
            };
            let response = Response::Justified(Justification(place as u8).into(), Preference::Right);
            let label = weights.label(&response).unwrap();
            let (left, right) = (segment(2 * i as u64, true), segment(2 * i as u64 + 1, false));
            trainer.add(&SegmentPair { left, right, label });
        }
        trainer
    }

    /// How likely steps that show a spill, a crash and nothing do so.
    fn told(trainer: &Trainer) -> Option<Vec<f32>> {
        let rows = [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]].map(|first| [first.as_slice(), &[0.0; 7]].concat());
        Some(to_vec(&trainer.ensemble().hazards()?.probabilities(&from_slice(&rows.concat(), &[3, F + 3]))))
    }

    #[test]
    fn what_answers_name_is_found_in_the_steps_that_show_it() {
        let config = RewardConfig { updates: 100, learned: Learned::Hazards, ..RewardConfig::tiny() };
        let mut trainer = naming(config.clone(), 1.0);
        let mut last = None;
        let done = trainer.fit(&mut rng(1), |report| {
            last = Some((report.epoch, report.n_epochs));
            ControlFlow::Continue(())
        });
        assert!(done.unwrap().is_continue() && last.is_some_and(|(epoch, n)| epoch == n), "{last:?}");
        let found = told(&trainer).unwrap();
        assert!(found[0] > 0.3 && found[3] > 0.3 && found[4] < 0.1 && found[5] < 0.1, "{found:?}");

        // One of them is left to labels, and those are learned as they are alone.
        let costs = to_vec(trainer.ensemble().hazards().unwrap().weights());
        assert!(costs.contains(&0.0) && costs.iter().all(|cost| (0.0..1.0).contains(cost)), "{costs:?}");
        let mut alone = naming(RewardConfig { learned: Learned::Label, ..config }, 1.0);
        let _ = alone.fit(&mut rng(1), |_| ControlFlow::Continue(())).unwrap();
        assert_eq!(told(&alone), None);
        for (one, other) in alone.ensemble.layers.iter().zip(&trainer.ensemble.layers) {
            assert_eq!(to_vec(&one.weight), to_vec(&other.weight));
        }
    }

    #[test]
    fn hazards_travel_with_the_reward_and_cost_alike_everywhere() {
        let mut trainer = naming(RewardConfig { learned: Learned::Hazards, ..RewardConfig::tiny() }, 0.9);
        let _ = trainer.fit(&mut rng(1), |_| ControlFlow::Continue(())).unwrap();
        let ensemble = trainer.ensemble();
        assert_eq!(ensemble.config().hazards, 2);
        let (features, actions) = (normal(&mut rng(5), &[4, 3, F]), normal(&mut rng(6), &[4, 3, 3]));
        let rewards = to_vec(&ensemble.rewards(&features, &actions));
        let parameters = ensemble.parameters();
        let loaded = RewardEnsemble::load(&parameters).unwrap().in_kind(Kind::Float);
        assert_eq!(to_vec(&loaded.rewards(&features, &actions)), rewards);
        assert_eq!(RewardEnsemble::relaid(&parameters).unwrap().bytes(), parameters.bytes());
        let frozen = to_vec(&loaded.for_inference().rewards(&features, &actions));
        assert!(frozen.iter().zip(&rewards).all(|(one, other)| (one - other).abs() < 1e-5));
        let rows = Tensor::cat(&[&features, &actions], -1).flatten(0, 1);
        let plain = ensemble.forward(&rows.expand([2, -1, -1], false)).mean_dim(0, false, Kind::Float);
        let costs = ensemble.hazards().unwrap().costs(&rows);
        let apart = from_slice(&rewards, &[12]) - (plain - &costs);
        assert!(apart.abs().max().double_value(&[]) < 1e-5, "what hazards cost is taken off");
        assert!(costs.max().double_value(&[]) > 0.0, "and it is something");
    }

    #[test]
    fn with_no_learning_rate_nothing_moves() {
        let mut trainer = trainer(RewardConfig { learning_rate: 0.0, ..RewardConfig::tiny() });
        let before = trainer.ensemble().parameters();
        trainer.epoch(&mut rng(2));
        assert_eq!(trainer.ensemble().parameters().bytes(), before.bytes());
    }

    #[test]
    fn the_same_seed_fits_the_same_ensemble() {
        let fit = |seed| {
            let mut trainer = trainer(RewardConfig::tiny());
            assert!(
                trainer.fit(&mut rng(seed), |_| ControlFlow::Continue(())).unwrap().is_continue(),
                "nobody stops it"
            );
            trainer.ensemble().parameters().hash()
        };
        assert_eq!(fit(1), fit(1));
        assert_ne!(fit(1), fit(2));
    }

    #[test]
    fn a_fit_stops_when_it_is_told_to() {
        let mut n_epochs = 0;
        let stopped = trainer(RewardConfig::tiny()).fit(&mut rng(0), |_| {
            n_epochs += 1;
            if n_epochs == 3 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        assert_eq!((stopped, n_epochs), (Ok(ControlFlow::Break(())), 3));
    }

    #[test]
    fn a_fit_ends_at_the_first_loss_that_is_no_number() {
        let mut trainer = trainer(RewardConfig::tiny());
        let odd =
            SegmentPair { left: vec![f32::NAN; 20 * (F as usize + 3)], ..pair(SafetyAnswer::OnlyLeft, 9) };
        trainer.add(&odd);
        let mut n_epochs = 0;
        let met = trainer.fit(&mut rng(0), |_| {
            n_epochs += 1;
            ControlFlow::Continue(())
        });
        let met = met.unwrap_err().to_string();
        assert!(n_epochs == 0 && met.contains("epoch 1") && met.contains("network 1"), "{met}");
        assert!(trainer.held_out(0.1, &mut rng(0), |_| ControlFlow::Continue(())).is_err());
    }

    #[test]
    fn an_answer_is_predicted_before_it_is_learned() {
        let mut trainer = trainer(RewardConfig::tiny());
        let surprising = pair(SafetyAnswer::OnlyLeft, 99);
        let p = trainer.predict(&Pair {
            rows: from_slice(&[surprising.left.clone(), surprising.right.clone()].concat(), &[2, 20, F + 3]),
            label: surprising.label,
        });
        trainer.predict_and_add(&surprising);
        (0..50).for_each(|_| drop(trainer.epoch(&mut rng(0))));
        let before = trainer.predictions[8].unwrap();
        assert!((before.p - p.p).abs() < 1e-2, "later steps do not change a prediction");
        assert_eq!(trainer.overall().map(|metrics| metrics.n), Some(9));
    }

    #[test]
    fn a_forgotten_answer_counts_no_more() {
        let mut trainer = trainer(RewardConfig::tiny());
        trainer.remove(0);
        assert_eq!((trainer.n_labels(), trainer.overall().map(|metrics| metrics.n)), (7, Some(7)));
    }

    #[test]
    fn a_changed_answer_was_predicted_when_it_was_new() {
        let mut trainer = trainer(RewardConfig::tiny());
        let before = trainer.predictions[3].unwrap();
        trainer.relabel(3, Label::EQUAL);
        assert_eq!(trainer.predictions[3], Some(Prediction { label: Label::EQUAL, ..before }));
        trainer.add(&pair(SafetyAnswer::OnlyLeft, 9));
        trainer.adopt(Trainer::new(RewardEnsemble::new((F, "sha256:0"), RewardConfig::tiny(), &mut rng(1))));
        assert_eq!((trainer.n_labels(), trainer.overall().map(|metrics| metrics.n)), (9, Some(8)));
    }

    #[test]
    fn answers_can_be_held_out() {
        let trainer = trainer(RewardConfig::tiny());
        let metrics = trainer.held_out(0.25, &mut rng(0), |_| ControlFlow::Continue(()));
        assert_eq!(metrics.unwrap().map(|metrics| metrics.n), Some(2));
        assert_eq!(trainer.held_out(0.0, &mut rng(0), |_| ControlFlow::Continue(())), Ok(None));
    }

    #[test]
    fn a_segment_is_twenty_rows_of_features_and_scaled_actions() {
        let mut features = Rows { width: 2, values: Vec::new() };
        (0..30).for_each(|t| features.push(&[t as f32, -(t as f32)]));
        let actions = vec![Action::new([0.5, 0.0, 1.0]); 30];
        let rows = segment_rows(
            &features,
            &actions,
            &ActionRanges::default(),
            SegmentRef { dream: DreamId(0), start: 10 },
        );
        assert_eq!(rows.len(), 20 * 5);
        assert_eq!(rows[5..10], [11.0, -11.0, 0.5, -1.0, 1.0]);
    }

    proptest! {
        #[test]
        fn changing_the_sides_over_leaves_the_loss(gap in -20f32..20.0, mu in 0f32..=1.0) {
            let (one, other) = (loss_of(gap, mu), loss_of(-gap, 1.0 - mu));
            prop_assert!((one - other).abs() < 1e-4, "{one} and {other}");
        }
    }

    #[test]
    fn members_do_not_disturb_each_other() {
        // One member alone and the same member beside another take the same steps: the loss is a sum.
        let mut trainer = trainer(RewardConfig { learning_rate: 1e-3, ..RewardConfig::tiny() });
        let before = to_vec(&trainer.ensemble.layers[0].weight.select(0, 1));
        let rows = Tensor::stack(&[&trainer.pairs[0].rows, &trainer.pairs[1].rows], 0).unsqueeze(1);
        let returns = trainer.ensemble.segment_returns(&rows);
        let losses = loss(&returns, &from_slice(&[1.0, 0.0], &[2, 1]));
        trainer.adam.backward_step(&losses.select(0, 0));
        assert_eq!(to_vec(&trainer.ensemble.layers[0].weight.select(0, 1)), before);
    }

    #[test]
    fn an_equal_answer_pulls_returns_together() {
        let mut trainer =
            Trainer::new(RewardEnsemble::new((F, "sha256:0"), RewardConfig::tiny(), &mut rng(0)));
        trainer.predict_and_add(&pair(SafetyAnswer::Both(Preference::Equal), 4));
        let apart = |trainer: &Trainer| (trainer.predict(&trainer.pairs[0]).p - 0.5).abs();
        let before = apart(&trainer);
        (0..20).for_each(|_| drop(trainer.epoch(&mut rng(0))));
        assert!(apart(&trainer) < before, "{} and {before}", apart(&trainer));
    }
}
