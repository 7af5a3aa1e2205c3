//! What the user wants, learned from verdicts on single transitions: the classifier of ReQueST and DROS (method §9).

use rand::{Rng, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use tch::{Device, Kind, Tensor, nn};

use crate::dream::Rows;
use crate::query::Verdict;
use crate::reward::{Header, RewardError, RewardInputs, RewardModel, require_model, stacked_slots};
use crate::tensor::limits::{MAX_COUNT, MAX_LAYERS, MAX_MEMBERS, MAX_WIDTH, OutOfRange, within};
use crate::tensor::{Backend, LAYOUT, Parameters, Slot, described, dims, from_slice, uniform};
use crate::world::{Action, ActionRanges};
use crate::world_model::ModelIdentity;

/// How many classes there are.
const N_CLASSES: i64 = Verdict::ALL.len() as i64;

/// Whose rules the ensemble follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rules {
    /// Those of DROPJ's authors: one loss for the average of all members, and a reward that is one of −1, 0 and +10.
    Joint,
    /// Those of [ReQueST](crate#references): each member learns by itself, classes count alike, and the reward is what
    /// the members expect on average.
    Apart,
}

/// The shape of a [`SparseReward`], and how it is fitted (method §9).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SparseConfig {
    /// E: how many networks there are. Paper: 4.
    pub members: i64,
    /// How wide the hidden layers are. Paper: 256.
    pub hidden: i64,
    /// How many hidden layers there are. Authors' code: 5.
    pub layers: usize,
    /// Verdicts in a batch. Paper: 32.
    pub batch: usize,
    /// Adam's step. Paper: 1e-3.
    pub learning_rate: f64,
    /// How often a fit goes through all verdicts at the most. Paper: 200.
    pub epochs: usize,
    /// Steps of Adam in a fit at the most.
    pub updates: usize,
    /// The share of verdicts that is held out: 0.2 for DROS, 0.01 for ReQueST.
    pub held_out: f64,
    /// Whether the networks of the epoch that predicted the held out ones best are kept, or else the last ones.
    pub keeps_best: bool,
    /// Whose rules are followed.
    pub rules: Rules,
}

impl SparseConfig {
    /// The authors' classifier for DROS: 404 227 parameters a member.
    pub fn dros() -> Self {
        Self {
            members: 4,
            hidden: 256,
            layers: 5,
            batch: 32,
            learning_rate: 1e-3,
            epochs: 200,
            // DIFFERENCE: the authors take 200 passes, 11 000 steps for their 2205 labels. Somebody waits here, and the
            // state that predicts best what is held out is kept anyway.
            updates: 2000,
            held_out: 0.2,
            keeps_best: true,
            rules: Rules::Joint,
        }
    }

    /// The same for ReQueST, which keeps the last networks.
    pub fn request() -> Self {
        Self { held_out: 0.01, keeps_best: false, ..Self::dros() }
    }

    /// A toy for tests.
    pub fn tiny() -> Self {
        Self {
            members: 2,
            hidden: 16,
            layers: 1,
            updates: 120,
            batch: 8,
            learning_rate: 1e-2,
            ..Self::dros()
        }
    }

    /// Fails where no classifier can be of this shape, or be fitted so.
    pub fn check(&self) -> Result<(), OutOfRange> {
        within("the number of the classifier's networks", self.members, 1..=MAX_MEMBERS)?;
        within("the width of the classifier's layers", self.hidden, 1..=MAX_WIDTH)?;
        within("the number of the classifier's hidden layers", self.layers, 0..=MAX_LAYERS)?;
        within("the number of verdicts in a batch of the classifier", self.batch, 1..=MAX_COUNT)?;
        within("the classifier's learning rate", self.learning_rate, 0.0..=1e3)?;
        within("how often the classifier goes through all verdicts", self.epochs, 1..=MAX_COUNT)?;
        within("the number of the classifier's updates", self.updates, 0..=MAX_COUNT)?;
        within("the share of verdicts that is held out", self.held_out, 0.0..=1.0)
    }

    /// How often a fit goes through `n` verdicts.
    pub fn epochs(&self, n: usize) -> usize {
        let steps = n.div_ceil(self.batch).max(1);
        self.updates.div_ceil(steps).clamp(1, self.epochs)
    }
}

/// Networks that say of a state and an action what a person would: unsafe, neutral or good.
///
/// A member is `layers` times (linear, ReLU) and three linear outputs over `[x | a]`, the action as driven.
#[derive(Debug)]
pub struct SparseReward {
    pub(super) config: SparseConfig,
    inputs: RewardInputs,
    /// The arithmetic of the products.
    kind: Kind,
    pub(super) store: nn::VarStore,
    /// `[E, in, out]` and `[E, 1, out]` of each layer.
    layers: Vec<[Tensor; 2]>,
}

impl SparseReward {
    /// The key of its header, and what the names of its parameters begin with.
    pub const KEY: &str = "sparse_reward";

    /// A fresh ensemble that reads `inputs`.
    pub fn new(inputs: impl Into<RewardInputs>, config: SparseConfig, rng: &mut impl Rng) -> Self {
        let store = nn::VarStore::new(Device::Cpu);
        let read = inputs.into();
        let mut inputs = read.row_len();
        let mut layers = Vec::new();
        for i in 0..=config.layers {
            let outputs = if i == config.layers { N_CLASSES } else { config.hidden };
            let (path, bound) = (store.root() / i, 1.0 / (inputs as f64).sqrt());
            let weight = path.var_copy("weight", &uniform(rng, &[config.members, inputs, outputs], bound));
            let bias = path.var_copy("bias", &uniform(rng, &[config.members, 1, outputs], bound));
            layers.push([weight, bias]);
            inputs = outputs;
        }
        Self { config, inputs: read, kind: Kind::Float, store, layers }
    }

    /// The ensemble whose networks `parameters` hold. Their header says which they are.
    pub fn load(parameters: &Parameters) -> Result<Self, RewardError> {
        let (layout, header) = Header::of(parameters, Self::KEY, SparseConfig::check)?;
        let (inputs, config) = header.into_parts();
        let slots = Self::slots(&config, inputs.row_len());
        parameters.require(Self::KEY, &slots, layout)?;
        // The draw is overwritten at once.
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let ensemble = Self::new(inputs, config, rng);
        parameters.fill(Self::KEY, &slots, layout, &ensemble.store)?;
        Ok(ensemble)
    }

    /// `parameters`, which must be those of such an ensemble, in this program's layout.
    pub fn relaid(parameters: &Parameters) -> Result<Parameters, RewardError> {
        Self::load(parameters)?;
        let (layout, header) = Header::of(parameters, Self::KEY, SparseConfig::check)?;
        let (inputs, config) = header.into_parts();
        let slots = Self::slots(&config, inputs.row_len());
        let relaid = parameters.relaid(Self::KEY, &[(Self::KEY, &slots)], layout, LAYOUT);
        Ok(relaid.unwrap_or_else(|| parameters.clone()))
    }

    /// How an ensemble over rows of so many numbers is stored.
    fn slots(config: &SparseConfig, row_len: i64) -> Vec<Slot> {
        let &SparseConfig { members, hidden, layers, .. } = config;
        stacked_slots(members, row_len, hidden, layers, N_CLASSES)
    }

    /// Fails where this was learned with another world model than the one that is `wanted`.
    pub fn require(&self, wanted: &ModelIdentity) -> Result<(), RewardError> {
        require_model(&self.inputs, wanted)
    }

    /// What [`Self::load`] takes.
    pub fn parameters(&self) -> Parameters {
        let header = Header::new(self.config.clone(), self.inputs.clone());
        let slots = Self::slots(&self.config, self.inputs.row_len());
        Parameters::stored(&[(Self::KEY, &self.store, &slots)], &[(Self::KEY, described(&header))])
    }

    /// The shape of the ensemble, and how it is fitted.
    pub fn config(&self) -> &SparseConfig {
        &self.config
    }

    /// What it reads.
    pub fn inputs(&self) -> &RewardInputs {
        &self.inputs
    }

    /// The hash of the world model whose features it reads.
    pub fn world_model(&self) -> &str {
        &self.inputs.world_model
    }

    /// The same networks, which learn no more and compute in whatever is quickest here.
    pub fn for_inference(&self) -> Self {
        let mut frozen = self.reloaded(&self.parameters());
        frozen.store.freeze();
        Self { kind: Backend::on(self.store.device()).kind, ..frozen }
    }

    /// The same networks, computed by `backend`; they learn in full precision everywhere.
    #[must_use]
    pub fn on(mut self, backend: Backend) -> Self {
        if backend.device != self.store.device() {
            self.store.set_device(backend.device);
        }
        self
    }

    /// The networks in `parameters`, which were just written, where these are.
    pub(super) fn reloaded(&self, parameters: &Parameters) -> Self {
        let loaded = Self::load(parameters).unwrap_or_else(|e| unreachable!("just written: {e}"));
        loaded.on(Backend::on(self.store.device()))
    }

    /// A tensor where the networks are.
    pub(super) fn here(&self, tensor: &Tensor) -> Tensor {
        tensor.to_device(self.store.device())
    }

    /// The logits of every member about its own rows.
    ///
    /// # Shapes
    /// - `rows`: `[E, N, F + A]`
    /// - returns `[E, N, 3]`
    pub(super) fn forward(&self, rows: &Tensor) -> Tensor {
        let mut x = rows.to_kind(self.kind);
        for (i, [weight, bias]) in self.layers.iter().enumerate() {
            x = bias.to_kind(self.kind).baddbmm(&x, &weight.to_kind(self.kind), 1, 1);
            x = if i + 1 == self.layers.len() { x } else { x.relu() };
        }
        x.to_kind(Kind::Float)
    }

    /// The logits of every member about the same rows.
    ///
    /// # Shapes
    /// - `rows`: `[N, F + A]`
    /// - returns `[E, N, 3]`
    pub(super) fn logits(&self, rows: &Tensor) -> Tensor {
        self.forward(&self.here(rows).unsqueeze(0).expand([self.config.members, -1, -1], false))
    }

    /// What every member thinks of each class, through which gradients pass.
    ///
    /// # Shapes
    /// - `features`: `[N, F]`, `actions`: `[N, A]`, as driven
    /// - returns `[E, N, 3]`
    pub fn chances(&self, features: &Tensor, actions: &Tensor) -> Tensor {
        self.logits(&Tensor::cat(&[self.here(features), self.here(actions)], -1)).softmax(-1, Kind::Float)
    }

    /// What is expected of each class on average: `1/E Σ_e Σ_c p_c R_c`.
    ///
    /// # Shapes
    /// - `chances`: `[E, N, 3]`
    /// - returns `[N]`
    pub fn expected(chances: &Tensor) -> Tensor {
        (chances * worths().to_device(chances.device())).sum_dim_intlist(-1, false, Kind::Float).mean_dim(
            0,
            false,
            Kind::Float,
        )
    }
}

impl RewardModel for SparseReward {
    fn rewards(&self, features: &Tensor, scaled_actions: &Tensor) -> Tensor {
        let mut shape = features.size();
        shape.pop();
        tch::no_grad(|| {
            let actions = as_driven(&scaled_actions.to_device(Device::Cpu), &self.inputs.ranges);
            let rows = Tensor::cat(&[self.here(features), self.here(&actions)], -1).flatten(0, -2);
            let logits = self.logits(&rows); // [E, N, 3]
            let rewards = match self.config.rules {
                Rules::Joint => {
                    let class = logits.mean_dim(0, false, Kind::Float).argmax(-1, false);
                    self.here(&worths()).index_select(0, &class)
                }
                Rules::Apart => Self::expected(&logits.softmax(-1, Kind::Float)),
            };
            rewards.view(shape.as_slice())
        })
    }
}

/// What each class is worth, `[3]`.
fn worths() -> Tensor {
    Tensor::from_slice(&Verdict::ALL.map(Verdict::worth))
}

/// Actions as driven of scaled ones: from −1 to 1 in each axis.
///
/// # Shapes
/// - `[…, A]`
fn as_driven(scaled: &Tensor, ranges: &ActionRanges) -> Tensor {
    let scales: Vec<_> = ranges.iter().map(|[low, high]| (high - low) / 2.0).collect();
    let middles: Vec<_> = ranges.iter().map(|[low, high]| f32::midpoint(low, high)).collect();
    scaled * Tensor::from_slice(&scales) + Tensor::from_slice(&middles)
}

/// The row `[x | a]` of a step of a dream, the action as driven.
///
/// # Panics
/// Where the dream has no such step.
pub fn transition_row(features: &Rows, actions: &[Action], step: usize) -> Vec<f32> {
    let mut row = features.row(step).to_vec();
    row.extend_from_slice(&actions[step]);
    row
}

/// The cross-entropy of the average of all members' logits: DROPJ's authors (method §9).
///
/// ```text
/// ℓ = mean of −ln softmax(1/E Σ_e logits_e)_class
/// ```
///
/// # Shapes
/// - `logits`: `[E, N, 3]`, `classes`: `[N]`
/// - returns nats, `[1]`
pub(super) fn joint_loss(logits: &Tensor, classes: &Tensor) -> Tensor {
    let mean = logits.mean_dim(0, false, Kind::Float).log_softmax(-1, Kind::Float);
    -mean.gather(-1, &classes.unsqueeze(-1), false).mean_dim(&[0i64, 1][..], false, Kind::Float).view([1])
}

/// The cross-entropy of every member by itself, in which classes count alike: [ReQueST](crate#references).
///
/// ```text
/// ℓ_e = Σ w ℓ / Σ w,  w = n / (n_classes · how many are of the class)
/// ```
///
/// # Shapes
/// - `logits`: `[E, N, 3]`, `classes`: `[E, N]`, `weights`: `[3]`
/// - returns nats, `[E]`
pub(super) fn balanced_losses(logits: &Tensor, classes: &Tensor, weights: &Tensor) -> Tensor {
    let [e, n, _] = dims(logits);
    let log_p = logits.log_softmax(-1, Kind::Float).gather(-1, &classes.unsqueeze(-1), false).view([e, n]);
    let weights = weights.index_select(0, &classes.reshape([-1])).view([e, n]);
    -(log_p * &weights).sum_dim_intlist(-1, false, Kind::Float)
        / weights.sum_dim_intlist(-1, false, Kind::Float)
}

/// Rows and classes to learn from.
#[derive(Debug)]
pub(super) struct Examples {
    /// `[N, F + A]`.
    pub(super) rows: Tensor,
    /// `[N]`.
    pub(super) classes: Tensor,
    pub(super) n: usize,
}

impl Examples {
    pub(super) fn of(rows: &[Vec<f32>], verdicts: &[Verdict]) -> Self {
        let (n, width) = (rows.len(), rows.first().map_or(0, Vec::len));
        let classes: Vec<i64> = verdicts.iter().map(|verdict| verdict.class() as i64).collect();
        let rows = from_slice(&rows.concat(), &[n as i64, width as i64]);
        Self { rows, classes: Tensor::from_slice(&classes), n }
    }

    /// The same on a device.
    pub(super) fn on(self, device: Device) -> Self {
        Self { rows: self.rows.to_device(device), classes: self.classes.to_device(device), n: self.n }
    }

    /// `n / (n_classes · how many are of the class)`, and 0 for a class that is not there.
    pub(super) fn weights(&self) -> Tensor {
        let counts = self.classes.bincount::<Tensor>(None, N_CLASSES).to_kind(Kind::Float);
        let weights = self.n as f64 / (N_CLASSES as f64 * counts.clamp_min(1.0));
        weights * counts.gt(0.0).to_kind(Kind::Float)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reward::{RewardKind, scaled_actions_tensor};
    use crate::tensor::{normal, to_vec};

    fn rng() -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(0)
    }

    fn close(found: &[f32], wanted: &[f32]) {
        let apart = found.iter().zip(wanted).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(found.len() == wanted.len() && apart < 1e-5, "{found:?} is not {wanted:?}");
    }

    #[test]
    fn a_member_for_car_racing_has_the_papers_size() {
        let ensemble = SparseReward::new((544, "sha256:0"), SparseConfig::dros(), &mut rng());
        let n_parameters: usize = ensemble.store.variables().values().map(Tensor::numel).sum();
        assert_eq!(n_parameters, 404_227 * 4);
    }

    #[test]
    fn the_joint_loss_and_its_gradient_are_those_by_hand() {
        // Two members whose logits average to (1, 0, 0). The class is the first.
        let logits =
            Tensor::from_slice(&[2.0f32, 0.0, 0.0, 0.0, 0.0, 0.0]).view([2, 1, 3]).set_requires_grad(true);
        let loss = joint_loss(&logits, &Tensor::from_slice(&[0i64]));
        let e = std::f32::consts::E;
        let p = [e / (e + 2.0), 1.0 / (e + 2.0)];
        close(&to_vec(&loss), &[-p[0].ln()]);
        loss.backward();
        // (p − y) / E for either member.
        let gradient = [(p[0] - 1.0) / 2.0, p[1] / 2.0, p[1] / 2.0];
        close(&to_vec(&logits.grad()), &[gradient, gradient].concat());
    }

    #[test]
    fn apart_each_member_has_its_own_loss_in_which_classes_count_alike() {
        // Three of the second class and one of the third: weights 4/9 and 4/3.
        let examples = Examples::of(
            &vec![vec![0.0]; 4],
            &[Verdict::Neutral, Verdict::Neutral, Verdict::Good, Verdict::Neutral],
        );
        close(&to_vec(&examples.weights()), &[0.0, 4.0 / 9.0, 4.0 / 3.0]);
        // The first member knows nothing. The second gives the second class twice the odds of each other.
        let knows = [0.0, 2.0f32.ln(), 0.0].repeat(4);
        let logits = from_slice(&[vec![0.0; 12], knows].concat(), &[2, 4, 3]);
        let classes = examples.classes.unsqueeze(0).expand([2, -1], false);
        let losses = balanced_losses(&logits, &classes, &examples.weights());
        // Both classes weigh one half: ln 3; and ½ ln 2 + ½ ln 4.
        close(&to_vec(&losses), &[3.0f32.ln(), 1.5 * 2.0f32.ln()]);
    }

    #[test]
    fn the_reward_is_the_worth_of_the_likeliest_class_or_what_is_expected() {
        let chances = from_slice(&[0.5, 0.0, 0.5, 0.0, 1.0, 0.0], &[2, 1, 3]);
        close(&to_vec(&SparseReward::expected(&chances)), &[2.25]);
        let (features, actions) = (normal(&mut rng(), &[5, 7, 36]), normal(&mut rng(), &[5, 7, 3]));
        let ensemble = SparseReward::new((36, "sha256:0"), SparseConfig::tiny(), &mut rng());
        let rewards = ensemble.rewards(&features, &actions);
        assert_eq!(rewards.size(), [5, 7]);
        assert!(to_vec(&rewards).iter().all(|r| [-1.0, 0.0, 10.0].contains(r)), "nothing between");
    }

    #[test]
    fn networks_read_actions_as_driven() {
        let actions = [Action::new([-1.0, 0.2, 0.8]), Action::new([0.5, 1.0, 0.0])];
        let scaled = scaled_actions_tensor(&actions, &ActionRanges::default());
        close(
            &to_vec(&as_driven(&scaled, &ActionRanges::default())),
            &actions.map(|action| action.to_vec()).concat(),
        );
        assert_ne!(ActionRanges::default().scaled(&actions[0]), actions[0]);
    }

    #[test]
    fn an_ensemble_survives_the_way_to_bytes_and_back() {
        let ensemble = SparseReward::new((36, "sha256:0"), SparseConfig::tiny(), &mut rng());
        let rows = normal(&mut rng(), &[6, 39]);
        let parameters = ensemble.parameters();
        let loaded = SparseReward::load(&parameters).unwrap();
        let kind = RewardKind::of(&parameters);
        assert_eq!(kind, Some(RewardKind::Verdicts), "its header tells it from other rewards");
        assert_eq!(to_vec(&loaded.logits(&rows)), to_vec(&ensemble.logits(&rows)));
        assert_eq!((loaded.config(), loaded.world_model()), (ensemble.config(), "sha256:0"));
    }
}
