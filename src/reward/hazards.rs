//! What a step shows of the things that must not happen, learned from answers that name them.
//!
//! An answer says which of two clips shows what must not happen, though not when. That is learned as from bags of instances
//! ([multiple-instance learning](crate#references) with a noisy OR), by a network beside those that learn from labels.

use rand::{Rng, RngExt as _};
use tch::{Device, Kind, Tensor, nn};

use super::{Layer, RewardConfig, RewardError, stacked_slots};
use crate::query::{Justification, Label, Shown};
use crate::tensor::adam::pytorch_adam;
use crate::tensor::{Parameters, Slot, uniform};

/// What is taken from an output before it is a rate: that of a network that has learned nothing is 0.018 a step.
const PRIOR: f64 = 4.0;
/// What a probability is raised by before its logarithm is taken.
const LEAST_PROBABILITY: f64 = 1e-6;
/// Segments in a batch: as many that show a hazard as do not, of each hazard alike.
const BATCH: usize = 256;
/// What a hazard costs whose answers are sure, where labels know another better.
const COST: f64 = 0.3;
/// The weight of an answer above which a hazard costs no more.
const SURE: f32 = 0.99;

/// A network that tells how likely a step shows each of J hazards, and what each costs.
///
/// ```text
/// λ_j = softplus(h_j(x, ã) − 4)    how often a step shows the hazard j
/// p_j = 1 − exp(−λ_j)              how likely it does: σ(h_j − 4)
/// r̂ = 1/E Σ_e tanh(member_e) − Σ_j κ_j p_j
///
/// s_j = min(logit w_j / logit 0.99, 1)       what j costs in that of an answer that is sure
/// δ_j = mean r of steps of segments without any hazard − mean r of steps of those with j, weighted by p_j
/// κ_j = 0 where δ_j / s_j is largest, else 0.3 s_j
/// ```
///
/// `w_j` is the weight of answers that name j, and r what labels alone made of a step: δ is what they let a hazard cost. The
/// hazard that they know best is left to them: whatever is taken off for it, too, is all that drives (assets/results).
/// Layers are those of a member of the [ensemble](super::RewardEnsemble).
///
/// `// DIFFERENCE:` the paper learns from labels alone: that one segment of twenty steps is better than another. From answers
/// about what is small and seldom seen, such a reward learns what is around it rather than the thing.
#[derive(Debug)]
pub struct Hazards {
    kind: Kind,
    store: nn::VarStore,
    layers: Vec<Layer>,
    /// κ: `[J]`, at least 0.
    costs: Tensor,
}

/// A segment, and one thing that is known of it.
#[derive(Clone, Copy, Debug)]
struct Bag<'a> {
    /// `[k, F + A]`.
    rows: &'a Tensor,
    hazard: i64,
    shows: bool,
}

impl Hazards {
    /// What the names of its parameters begin with.
    pub const KEY: &str = "hazards";

    /// One for J = `config.hazards` that has learned nothing: each hazard is expected in 0.018 of all steps, and costs nothing.
    fn new(config: &RewardConfig, row_len: i64, rng: &mut impl Rng) -> Self {
        let store = nn::VarStore::new(Device::Cpu);
        let (mut inputs, mut layers) = (row_len, Vec::new());
        for i in 0..=config.layers {
            let is_last = i == config.layers;
            let outputs = if is_last { config.hazards } else { config.hidden };
            let (path, bound) = (store.root() / i, if is_last { 0.0 } else { 1.0 / (inputs as f64).sqrt() });
            let weight = path.var_copy("weight", &uniform(rng, &[1, inputs, outputs], bound));
            let bias = path.var_copy("bias", &uniform(rng, &[1, 1, outputs], bound));
            layers.push(Layer { weight, bias });
            inputs = outputs;
        }
        let costs = store.root().zeros_no_train("cost", &[config.hazards]);
        Self { kind: Kind::Float, store, layers, costs }
    }

    /// How it is stored.
    pub(super) fn slots(config: &RewardConfig, row_len: i64) -> Vec<Slot> {
        let &RewardConfig { hidden, layers, hazards, .. } = config;
        let mut slots = stacked_slots(1, row_len, hidden, layers, hazards);
        slots.push(Slot::plain("cost", &[hazards]));
        slots
    }

    /// That in `parameters`, if `config` says that there is one.
    pub(super) fn load(
        parameters: &Parameters,
        layout: u32,
        config: &RewardConfig,
        row_len: i64,
    ) -> Result<Option<Self>, RewardError> {
        if config.hazards == 0 {
            return Ok(None);
        }
        let slots = Self::slots(config, row_len);
        parameters.require(Self::KEY, &slots, layout)?;
        // The draw is overwritten at once.
        let loaded =
            Self::new(config, row_len, &mut <rand_chacha::ChaCha8Rng as rand::SeedableRng>::seed_from_u64(0));
        parameters.fill(Self::KEY, &slots, layout, &loaded.store)?;
        Ok(Some(loaded))
    }

    pub(super) fn store(&self) -> &nn::VarStore {
        &self.store
    }

    pub(super) fn set_device(&mut self, device: Device) {
        self.store.set_device(device);
    }

    /// The same, which learns no more, with its products computed in `kind`.
    pub fn for_inference(&self, kind: Kind) -> Self {
        let copy = |tensor: &Tensor| tensor.detach().to_kind(kind);
        let layers = self.layers.iter();
        let layers = layers.map(|layer| Layer { weight: copy(&layer.weight), bias: copy(&layer.bias) });
        let (store, costs) = (nn::VarStore::new(self.store.device()), self.costs.detach().copy());
        Self { kind, store, layers: layers.collect(), costs }
    }

    /// How often each step shows each hazard: λ.
    ///
    /// # Shapes
    /// - `rows`: `[N, F + A]`
    /// - returns `[N, J]`, at least 0
    fn rates(&self, rows: &Tensor) -> Tensor {
        let mut x = rows.to_kind(self.kind);
        for (i, Layer { weight, bias }) in self.layers.iter().enumerate() {
            let [weight, bias] = [weight.select(0, 0), bias.select(0, 0)].map(|t| t.to_kind(self.kind));
            x = x.matmul(&weight) + bias;
            x = if i + 1 == self.layers.len() { x } else { x.leaky_relu() };
        }
        (x.to_kind(Kind::Float) - PRIOR).softplus()
    }

    /// How likely a step shows each hazard.
    ///
    /// # Shapes
    /// - `rows`: features and scaled actions, `[N, F + A]`
    /// - returns `[N, J]`, in `[0, 1)`
    pub fn probabilities(&self, rows: &Tensor) -> Tensor {
        tch::no_grad(|| probability(&self.rates(&rows.to_device(self.store.device()))))
    }

    /// What each hazard costs where it is certain, beside what labels let it cost: κ, J of them in `[0, 0.3]`.
    pub fn weights(&self) -> &Tensor {
        &self.costs
    }

    /// What hazards cost in each step: `Σ_j κ_j p_j`.
    ///
    /// # Shapes
    /// - `rows`: `[N, F + A]`
    /// - returns `[N]`
    pub fn costs(&self, rows: &Tensor) -> Tensor {
        probability(&self.rates(rows)).matmul(&self.costs)
    }
}

/// How likely something happens at all that happens at these rates: `1 − exp(−λ)`.
fn probability(rates: &Tensor) -> Tensor {
    -rates.neg().expm1()
}

/// What a hazard costs that answers of weight `weight` name, in `[0, 1]`: the logit of it, in that of an answer that is sure.
fn share(weight: f32) -> f32 {
    let logit = |p: f32| (p / (1.0 - p)).ln();
    logit(weight.min(SURE)) / logit(SURE)
}

/// Learns what hazards look like, from segments and what answers said of them.
#[derive(Debug)]
pub(super) struct HazardFit<'a> {
    hazards: Hazards,
    adam: nn::Optimizer,
    learning_rate: f64,
    /// For each hazard the segments that show it, and those that do not. Hazards that lack either are not learned.
    bags: Vec<[Vec<Bag<'a>>; 2]>,
    /// Segments that show no hazard at all.
    clean: Vec<&'a Tensor>,
    /// s: for each hazard what it costs in that of an answer that is sure; 0 where it is not learned.
    shares: Vec<f64>,
}

impl<'a> HazardFit<'a> {
    /// Begins anew with these segments, left and right of each answer. Nothing comes where there is nothing to learn.
    pub(super) fn new(
        config: &RewardConfig,
        kind: Kind,
        device: Device,
        answers: &[(&'a Tensor, &'a Tensor, Label)],
        row_len: i64,
        rng: &mut impl Rng,
    ) -> Option<Self> {
        let mut bags = Vec::new();
        let mut shares = vec![0.0; config.hazards as usize];
        for hazard in 0..config.hazards {
            let of = |wanted| {
                let sides = answers
                    .iter()
                    .flat_map(|(left, right, label)| [*left, *right].into_iter().zip(label.shown()));
                let place = Justification(hazard as u8);
                let these = sides.filter(move |(_, shown)| shown.shows(place) == Some(wanted));
                these.map(move |(rows, _)| Bag { rows, hazard, shows: wanted }).collect::<Vec<_>>()
            };
            let both = [of(true), of(false)];
            if both.iter().all(|bags| !bags.is_empty()) {
                bags.push(both);
                shares[hazard as usize] = f64::from(share(weight_of(hazard as usize, answers)));
            }
        }
        // One alone would be left to labels.
        if bags.len() < 2 {
            return None;
        }
        let sides =
            answers.iter().flat_map(|(left, right, label)| [*left, *right].into_iter().zip(label.shown()));
        let all = || (0..config.hazards).map(|hazard| Justification(hazard as u8));
        let is_clean = |shown: &Shown| all().all(|place| shown.shows(place) == Some(false));
        let clean = sides.filter(|(_, shown)| is_clean(shown)).map(|(rows, _)| rows).collect();
        let mut hazards = Hazards::new(config, row_len, rng);
        hazards.set_device(device);
        hazards.kind = kind;
        let adam = pytorch_adam(&hazards.store, config.learning_rate);
        Some(Self { hazards, adam, learning_rate: config.learning_rate, bags, clean, shares })
    }

    /// Moves by one step, where this share of all is `left`, and returns the loss before, in nats a segment:
    ///
    /// ```text
    /// P = 1 − exp(−Σ_t λ_t)    that a segment shows a hazard at some step
    /// ℓ = mean of −ln P where it was said to, and of −ln(1 − P) = Σ_t λ_t where it was said not to
    /// ```
    pub(super) fn step(&mut self, left: f64, rng: &mut impl Rng) -> f64 {
        self.adam.set_lr(self.learning_rate * left);
        let n = (BATCH / (2 * self.bags.len())).max(1);
        let mut drawn =
            |bags: &Vec<Bag<'a>>| (0..n).map(|_| bags[rng.random_range(0..bags.len())]).collect::<Vec<_>>();
        let picks: Vec<Bag<'a>> = self.bags.iter().flatten().flat_map(&mut drawn).collect();
        let rows = Tensor::stack(&picks.iter().map(|bag| bag.rows).collect::<Vec<_>>(), 0); // [B, k, F + A]
        let (b, k) = (picks.len() as i64, rows.size()[1]);
        let rates = self.hazards.rates(&rows.flatten(0, 1)).view([b, k, -1]);
        let rates = rates.sum_dim_intlist(1, false, Kind::Float); // [B, J]
        let which: Vec<i64> = picks.iter().map(|bag| bag.hazard).collect();
        let which = Tensor::from_slice(&which).to_device(rates.device()).unsqueeze(1);
        let shows: Vec<f32> = picks.iter().map(|bag| f32::from(u8::from(bag.shows))).collect();
        let shows = Tensor::from_slice(&shows).to_device(rates.device());
        let loss = loss(&rates.gather(1, &which, false).squeeze_dim(1), &shows);
        self.adam.backward_step(&loss);
        loss.double_value(&[])
    }

    /// What was learned, where steps are worth `rewards` by labels alone: `[N, F + A]` in, `[N]` out.
    pub(super) fn into_hazards(self, rewards: impl Fn(&Tensor) -> Tensor) -> Hazards {
        let worth = |rows: &Tensor| rewards(rows).to_kind(Kind::Double);
        let means: Vec<f64> =
            self.clean.iter().map(|rows| worth(rows).mean(None::<Kind>).double_value(&[])).collect();
        let usual = mean(&means);
        let mut known = vec![0.0; self.shares.len()];
        for [shown, _] in &self.bags {
            let Some(hazard) = shown.first().map(|bag| bag.hazard) else { continue };
            let (mut sum, mut weight) = (0.0, 0.0);
            for bag in shown {
                let p = self.hazards.probabilities(bag.rows).select(1, hazard).to_kind(Kind::Double);
                sum += (&p * worth(bag.rows)).sum(Kind::Double).double_value(&[]);
                weight += p.sum(Kind::Double).double_value(&[]);
            }
            known[hazard as usize] = usual - sum / weight.max(f64::MIN_POSITIVE);
        }
        let costs = beside(&self.shares, &known);
        let mut hazards = self.hazards;
        tch::no_grad(|| hazards.costs.copy_(&Tensor::from_slice(&costs)));
        hazards
    }
}

/// The mean, 0 of none.
fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// κ: what each hazard costs whose `shares` are above 0, where labels let it cost `known` already.
fn beside(shares: &[f64], known: &[f64]) -> Vec<f32> {
    let each = || shares.iter().zip(known).map(|(share, known)| known / share).enumerate();
    let learned = each().filter(|(i, _)| shares[*i] > 0.0);
    let best_known = learned.max_by(|(_, one), (_, other)| one.total_cmp(other)).map(|(i, _)| i);
    let cost = |(i, share): (usize, &f64)| if Some(i) == best_known { 0.0 } else { (COST * share) as f32 };
    shares.iter().enumerate().map(cost).collect()
}

/// The weight of answers that name this hazard as the most severe: that of the last, or ½ where there are none.
fn weight_of(hazard: usize, answers: &[(&Tensor, &Tensor, Label)]) -> f32 {
    let names = |label: &Label| {
        let shown = label.shown();
        let first =
            |side: usize| (0..64).find(|place| shown[side].shows(Justification(*place)) == Some(true));
        [0, 1].into_iter().filter_map(first).min() == Some(hazard as u8)
    };
    let strict =
        answers.iter().rev().map(|(.., label)| label).filter(|label| label.mu() != Label::EQUAL.mu());
    strict.filter(|label| names(label)).map(|label| label.mu().max(1.0 - label.mu())).next().unwrap_or(0.5)
}

/// The mean cross-entropy of segments in which something is expected so often, `Σ_t λ_t`, and which show it (1) or do not (0).
fn loss(rates: &Tensor, shows: &Tensor) -> Tensor {
    let happens = -(probability(rates) + LEAST_PROBABILITY).log();
    let losses: Tensor = shows * happens + (1.0 - shows) * rates;
    losses.mean(Kind::Float)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tensor::{from_slice, to_vec};

    #[test]
    fn a_segment_shows_what_happens_at_any_step() {
        // −ln(1 − e⁻²) and 0.5, of a segment that shows something and one that does not.
        let of =
            |rates: [f32; 2]| to_vec(&loss(&from_slice(&rates, &[2]), &from_slice(&[1.0, 0.0], &[2])))[0];
        assert!((of([2.0, 0.5]) - 0.322_706_73).abs() < 1e-5);
        assert!(of([0.0, 0.0]).is_finite(), "even what is thought impossible");
    }

    // ln 19 / ln 99, ln 3 / ln 99 and ln 1.5 / ln 99.
    #[test]
    fn a_hazard_costs_the_more_the_more_answers_weigh() {
        for (weight, wanted) in
            [(1.0, 1.0), (0.99, 1.0), (0.95, 0.640_774), (0.75, 0.239_08), (0.6, 0.088_238), (0.5, 0.0)]
        {
            assert!((share(weight) - wanted).abs() < 1e-4, "{weight}: {}", share(weight));
        }
    }

    #[test]
    fn what_labels_know_best_is_left_to_them() {
        assert_eq!(beside(&[1.0, 1.0], &[0.5, 0.125]), [0.0, 0.3]);
        assert_eq!(
            beside(&[0.5, 1.0, 0.5], &[0.125, 0.5, 0.0]),
            [0.15, 0.0, 0.15],
            "the less it weighs, the less"
        );
        assert_eq!(
            beside(&[0.5, 1.0], &[0.25, 0.25]),
            [0.0, 0.3],
            "as much of what weighs less is known better"
        );
        assert_eq!(
            beside(&[0.0, 1.0, 1.0], &[0.0, -0.25, -0.5]),
            [0.0, 0.0, 0.3],
            "the first was not learned"
        );
        assert_eq!(beside(&[1.0], &[0.25]), [0.0]);
    }
}
