//! What the user wants, learned from their answers: an ensemble of small networks (Step 3 of the method).
//!
//! Never sees a frame: it reads a state's features and the scaled action, and nothing else.

mod config;
mod disagreement;
pub mod fit;
mod hazards;
pub mod inference;
pub mod learned;
pub mod metrics;
pub mod preference_fit;
pub mod sparse;
pub mod sparse_fit;

use rand::{Rng, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use tch::{Device, Kind, Tensor, nn};

use crate::tensor::limits::{MAX_LATENTS, MAX_MEMORY, OutOfRange, named, within};
use crate::tensor::{
    Backend, DescriptionError, LAYOUT, Parameters, ParametersError, Slot, described, describes, dims,
    from_slice, uniform,
};
use crate::world::{Action, ActionRanges};
use crate::world_model::{ModelIdentity, WorldModel, fast_kind};

pub use config::{Learned, RewardConfig, Schedule};
pub use fit::{EpochReport, GradientNorm, SegmentPair, Trainer, segment_rows};
pub use hazards::Hazards;
pub use inference::InferenceReward;
pub use learned::{LearnedReward, RewardKind, RewardNetworks};
pub use metrics::PredictionMetrics;
pub use preference_fit::{Fitted, fit_anew, fit_anew_watched, predict_held_out};
pub use sparse::{SparseConfig, SparseReward, transition_row};
pub use sparse_fit::{HeldOut, SparseFit, fit_sparse_anew};

/// Whatever says how good it is to do something somewhere.
pub trait RewardModel {
    /// The reward r̂ of every state and action.
    ///
    /// # Shapes
    /// - `features`: `[…, F]`, `scaled_actions`: `[…, A]`; of a planner `[H, S, F]` and `[H, S, A]`
    /// - returns `[…]`
    fn rewards(&self, features: &Tensor, scaled_actions: &Tensor) -> Tensor;
}

impl<R: RewardModel + ?Sized> RewardModel for Box<R> {
    fn rewards(&self, features: &Tensor, scaled_actions: &Tensor) -> Tensor {
        (**self).rewards(features, scaled_actions)
    }
}

/// Networks that were begun differently and trained on the same. The reward is their mean.
///
/// ```text
/// r̂ = 1/E Σ_e tanh(member_e([x | ã]))
/// ```
///
/// A member is `layers` times (linear, leaky ReLU of slope 0.01) and one linear output.
/// Where answers named hazards, what they cost is taken off: see [`Hazards`].
/// All members lie stacked, so that each layer of the whole ensemble is one batched product.
#[derive(Debug)]
pub struct RewardEnsemble {
    config: RewardConfig,
    inputs: RewardInputs,
    /// The arithmetic of the products. Parameters, their gradients and the returns are in full precision always.
    kind: Kind,
    store: nn::VarStore,
    layers: Vec<Layer>,
    /// What is learned beside labels.
    hazards: Option<Hazards>,
}

/// One linear layer of every member.
#[derive(Debug)]
struct Layer {
    /// `[E, in, out]`.
    weight: Tensor,
    /// `[E, 1, out]`.
    bias: Tensor,
}

/// Why a reward cannot be loaded.
#[derive(Debug, thiserror::Error)]
pub enum RewardError {
    /// The parameters are wrong.
    #[error("cannot load the reward: {0}")]
    Parameters(ParametersError),
    /// The header does not describe an ensemble.
    #[error("cannot load the reward: its header does not describe one ({0})")]
    Header(DescriptionError),
    /// The header describes an ensemble that cannot be.
    #[error("cannot load the reward: {0}")]
    Config(OutOfRange),
    /// It reads states of another width.
    #[error("the reward reads {found} features of a state, where the world model's states have {wanted}")]
    Features {
        /// How many it reads.
        found: i64,
        /// How many there are.
        wanted: i64,
    },
    /// It scales other actions.
    #[error(
        "the reward reads actions in the ranges {found}, where those of the world model's world are {wanted}"
    )]
    Ranges {
        /// Those that it reads.
        found: String,
        /// Those that there are.
        wanted: String,
    },
    /// It reads the features of another world model.
    #[error("the reward was learned in the dreams of the world model {found}, but this one is {wanted}")]
    OtherWorldModel {
        /// The hash of the model it was learned with.
        found: String,
        /// The hash of the model at hand.
        wanted: String,
    },
}

impl From<ParametersError> for RewardError {
    fn from(met: ParametersError) -> Self {
        Self::Parameters(met)
    }
}

/// What a reward reads: the states of one world model, and its world's actions.
#[derive(Clone, Debug, PartialEq)]
pub struct RewardInputs {
    /// F: how many features a state has.
    pub n_features: i64,
    /// The hash of the world model.
    pub world_model: String,
    /// The ranges of an action's A numbers.
    pub ranges: ActionRanges,
}

impl RewardInputs {
    /// The states of this model and the actions of its world.
    pub fn of(model: &WorldModel) -> Self {
        let (n_features, world_model) = (model.config().n_features(), model.hash());
        Self { n_features, world_model, ranges: model.ranges().clone() }
    }

    /// How long the rows are that the networks read: F + A.
    fn row_len(&self) -> i64 {
        self.n_features + self.ranges.n_axes() as i64
    }
}

impl From<(i64, &str)> for RewardInputs {
    /// So many features of the world model with this hash, where a car drives.
    fn from((n_features, world_model): (i64, &str)) -> Self {
        Self { n_features, world_model: world_model.to_owned(), ranges: ActionRanges::default() }
    }
}

/// What the header of the parameters holds beside the names and shapes.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header<C> {
    config: C,
    n_features: i64,
    world_model: String,
    /// Of an action's numbers.
    #[serde(default, skip_serializing_if = "ActionRanges::is_default")]
    ranges: ActionRanges,
}

impl<C: Serialize + for<'de> Deserialize<'de>> Header<C> {
    /// The layout and the header of `parameters`, under `key`. `check` says whether its configuration can be.
    fn of(
        parameters: &Parameters,
        key: &str,
        check: impl FnOnce(&C) -> Result<(), OutOfRange>,
    ) -> Result<(u32, Self), RewardError> {
        let told = describes::<Self>(parameters.metadata(key).as_deref());
        let (layout, header) = told.map_err(RewardError::Header)?;
        let Self { config, n_features, world_model, .. } = &header;
        let most = MAX_LATENTS + 2 * MAX_MEMORY;
        check(config)
            .and_then(|()| within("the number of features that the reward reads", *n_features, 1..=most))
            .and_then(|()| named("the hash of the reward's world model", world_model))
            .map_err(RewardError::Config)?;
        Ok((layout, header))
    }

    fn new(config: C, RewardInputs { n_features, world_model, ranges }: RewardInputs) -> Self {
        Self { config, n_features, world_model, ranges }
    }

    /// What the reward reads, and its configuration.
    fn into_parts(self) -> (RewardInputs, C) {
        let Self { config, n_features, world_model, ranges } = self;
        (RewardInputs { n_features, world_model, ranges }, config)
    }
}

/// How the layers of an ensemble are stored: `layers` hidden ones of `hidden` units, and one of `outputs`.
fn stacked_slots(members: i64, inputs: i64, hidden: i64, layers: usize, outputs: i64) -> Vec<Slot> {
    let mut slots = Vec::new();
    let mut inputs = inputs;
    for i in 0..=layers {
        let outputs = if i == layers { outputs } else { hidden };
        let weight = Slot::plain(format!("{i}.weight"), &[members, outputs, inputs]);
        let bias = Slot::plain(format!("{i}.bias"), &[members, outputs]);
        slots.push(weight.rearranged(&[0, 2, 1], &[members, inputs, outputs]));
        slots.push(bias.rearranged(&[0, 1], &[members, 1, outputs]));
        inputs = outputs;
    }
    slots
}

/// Fails where a reward that reads `inputs` does not read the states of the world model that is `wanted`.
fn require_model(inputs: &RewardInputs, wanted: &ModelIdentity) -> Result<(), RewardError> {
    if !wanted.is(&inputs.world_model) {
        return Err(RewardError::OtherWorldModel {
            found: inputs.world_model.clone(),
            wanted: wanted.hash(),
        });
    }
    let config = wanted.config();
    if config.n_features() != inputs.n_features {
        return Err(RewardError::Features { found: inputs.n_features, wanted: config.n_features() });
    }
    let (found, wanted) = (&inputs.ranges, ActionRanges::of(&config.spec().axes));
    if *found == wanted {
        return Ok(());
    }
    let told = |ranges: &ActionRanges| format!("{:?}", ranges.iter().collect::<Vec<_>>());
    Err(RewardError::Ranges { found: told(found), wanted: told(&wanted) })
}

impl RewardEnsemble {
    /// The key of its header, and what the names of its parameters begin with.
    pub const KEY: &str = "reward";

    /// A fresh ensemble that reads `inputs` and knows of no hazards, however many `config` says.
    ///
    /// Weights and biases are uniform in ±1/√inputs, as PyTorch draws them.
    pub fn new(inputs: impl Into<RewardInputs>, config: RewardConfig, rng: &mut impl Rng) -> Self {
        let store = nn::VarStore::new(Device::Cpu);
        let read = inputs.into();
        let mut inputs = read.row_len();
        let mut layers = Vec::new();
        for i in 0..=config.layers {
            let outputs = if i == config.layers { 1 } else { config.hidden };
            let (path, bound) = (store.root() / i, 1.0 / (inputs as f64).sqrt());
            let weight = path.var_copy("weight", &uniform(rng, &[config.members, inputs, outputs], bound));
            let bias = path.var_copy("bias", &uniform(rng, &[config.members, 1, outputs], bound));
            layers.push(Layer { weight, bias });
            inputs = outputs;
        }
        let config = RewardConfig { hazards: 0, ..config };
        Self { config, inputs: read, kind: fast_kind(), store, layers, hazards: None }
    }

    /// Makes the reward of everything 0, without touching what lies before the outputs.
    fn zero_output(&mut self) {
        let Some(Layer { weight, bias }) = self.layers.last_mut() else { return };
        tch::no_grad(|| drop([weight.zero_(), bias.zero_()]));
    }

    /// The ensemble whose networks `parameters` hold. Their header says which they are.
    pub fn load(parameters: &Parameters) -> Result<Self, RewardError> {
        let (layout, header) = Header::of(parameters, Self::KEY, RewardConfig::check)?;
        let (inputs, config) = header.into_parts();
        let slots = Self::slots(&config, inputs.row_len());
        // Before anything is made: what a header promises, the file must hold.
        parameters.require(Self::KEY, &slots, layout)?;
        let hazards = Hazards::load(parameters, layout, &config, inputs.row_len())?;
        // The draw is overwritten at once.
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let ensemble = Self::new(inputs, config.clone(), rng);
        parameters.fill(Self::KEY, &slots, layout, &ensemble.store)?;
        Ok(Self { config, hazards, ..ensemble })
    }

    /// `parameters`, which must be those of an ensemble, in this program's layout.
    pub fn relaid(parameters: &Parameters) -> Result<Parameters, RewardError> {
        Self::load(parameters)?;
        let (layout, header) = Header::of(parameters, Self::KEY, RewardConfig::check)?;
        let (inputs, config) = header.into_parts();
        let slots = Self::slots(&config, inputs.row_len());
        let of_hazards = Hazards::slots(&config, inputs.row_len());
        let all: [(&str, &[Slot]); 2] = [(Self::KEY, &slots), (Hazards::KEY, &of_hazards)];
        let n = if config.hazards > 0 { 2 } else { 1 };
        let relaid = parameters.relaid(Self::KEY, &all[..n], layout, LAYOUT);
        Ok(relaid.unwrap_or_else(|| parameters.clone()))
    }

    /// How an ensemble over rows of so many numbers is stored.
    fn slots(config: &RewardConfig, row_len: i64) -> Vec<Slot> {
        let &RewardConfig { members, hidden, layers, .. } = config;
        stacked_slots(members, row_len, hidden, layers, 1)
    }

    /// What [`Self::load`] takes.
    pub fn parameters(&self) -> Parameters {
        let header = Header::new(self.config.clone(), self.inputs.clone());
        let slots = Self::slots(&self.config, self.row_len());
        let of_hazards = Hazards::slots(&self.config, self.row_len());
        let mut stored = vec![(Self::KEY, &self.store, slots.as_slice())];
        stored.extend(
            self.hazards.as_ref().map(|hazards| (Hazards::KEY, hazards.store(), of_hazards.as_slice())),
        );
        Parameters::stored(&stored, &[(Self::KEY, described(&header))])
    }

    /// The same ensemble with its products computed in `kind`. Where nothing is said it is [`fast_kind`].
    #[must_use]
    pub fn in_kind(self, kind: Kind) -> Self {
        Self { kind, ..self }
    }

    /// The same ensemble, computed by `backend`.
    #[must_use]
    pub fn on(mut self, Backend { device, kind }: Backend) -> Self {
        if device != self.store.device() {
            self.store.set_device(device);
            self.kind = kind;
            if let Some(hazards) = &mut self.hazards {
                hazards.set_device(device);
            }
        }
        self
    }

    /// What computes.
    fn backend(&self) -> Backend {
        Backend { device: self.store.device(), kind: self.kind }
    }

    /// A tensor where the networks are.
    fn here(&self, tensor: &Tensor) -> Tensor {
        tensor.to_device(self.store.device())
    }

    /// The shape of the ensemble, and how it is fitted.
    pub fn config(&self) -> &RewardConfig {
        &self.config
    }

    /// F: how many features it reads.
    pub fn n_features(&self) -> i64 {
        self.inputs.n_features
    }

    /// What it reads.
    pub fn inputs(&self) -> &RewardInputs {
        &self.inputs
    }

    /// The hash of the world model whose features it reads.
    pub fn world_model(&self) -> &str {
        &self.inputs.world_model
    }

    /// Fails where this was learned with another world model than the one that is `wanted`.
    pub fn require(&self, wanted: &ModelIdentity) -> Result<(), RewardError> {
        require_model(&self.inputs, wanted)
    }

    /// What each member says, less what hazards cost.
    ///
    /// # Shapes
    /// - `features`: `[…, F]`, `scaled_actions`: `[…, A]`
    /// - returns `[E, …]`, in `(-1, 1)`; with J hazards in `(-1 - 0.3 J, 1)`
    pub fn member_rewards(&self, features: &Tensor, scaled_actions: &Tensor) -> Tensor {
        let mut shape = features.size();
        shape.pop();
        shape.insert(0, self.config.members);
        let rows = Tensor::cat(&[self.here(features), self.here(scaled_actions)], -1); // […, F + A]
        let rows = rows.view([-1, self.row_len()]); // [N, F + A]
        tch::no_grad(|| {
            let rewards = self.forward(&rows.expand([self.config.members, -1, -1], false)); // [E, N]
            let costs = self.hazards.as_ref().map(|hazards| hazards.costs(&rows));
            costs.map_or(rewards.shallow_clone(), |costs| rewards - costs)
        })
        .view(shape.as_slice())
    }

    /// How long the rows are that the networks read: F + A.
    fn row_len(&self) -> i64 {
        self.inputs.row_len()
    }

    /// What every member says about its own rows.
    ///
    /// # Shapes
    /// - `rows`: `[E, N, F + A]`
    /// - returns `[E, N]`
    fn forward(&self, rows: &Tensor) -> Tensor {
        let [e, n, _] = dims(rows);
        let mut x = rows.to_kind(self.kind);
        for (i, layer) in self.layers.iter().enumerate() {
            // In place: what costs here is fresh memory.
            x = x.bmm(&layer.weight.to_kind(self.kind)).g_add_(&layer.bias.to_kind(self.kind));
            x = if i == self.config.layers { x.to_kind(Kind::Float).tanh() } else { x.leaky_relu_() };
        }
        x.view([e, n])
    }

    /// What tells hazards, where answers named any.
    pub fn hazards(&self) -> Option<&Hazards> {
        self.hazards.as_ref()
    }
}

impl RewardModel for RewardEnsemble {
    fn rewards(&self, features: &Tensor, scaled_actions: &Tensor) -> Tensor {
        self.member_rewards(features, scaled_actions).mean_dim(0, false, Kind::Float)
    }
}

/// A tensor of actions scaled to `[-1, 1]`.
///
/// # Shapes
/// - returns `[N, A]`
pub fn scaled_actions_tensor(actions: &[Action], ranges: &ActionRanges) -> Tensor {
    let values: Vec<f32> = actions.iter().flat_map(|action| ranges.scaled(action).to_vec()).collect();
    from_slice(&values, &[actions.len() as i64, ranges.n_axes() as i64])
}

/// Two members over two features, two hidden layers of three units, whose parameters are cosines: `NumPy` makes the same.
#[cfg(test)]
fn of_cosines() -> RewardEnsemble {
    let config = RewardConfig { members: 2, hidden: 3, layers: 2, ..RewardConfig::tiny() };
    let slots = RewardEnsemble::slots(&config, 5);
    let tensors = slots.iter().map(|slot| {
        let shape = slot.shape_in(LAYOUT);
        let factor = if slot.name.ends_with("bias") { 0.1 } else { 1.0 };
        let values: Vec<_> = (0..shape.iter().product()).map(|i: i64| factor * (i as f32).cos()).collect();
        (format!("reward.{}", slot.name), from_slice(&values, shape))
    });
    let header = Header::new(config, (2, "sha256:0").into());
    let parameters = Parameters::from_tensors(tensors, &[("reward", described(&header))]);
    let loaded = RewardEnsemble::load(&parameters).unwrap_or_else(|e| panic!("they are of that shape: {e}"));
    loaded.in_kind(Kind::Float)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tensor::{normal, to_vec};
    use crate::world_model::{WorldModelConfig, untrained};

    fn rng() -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(0)
    }

    fn tiny() -> RewardEnsemble {
        RewardEnsemble::new((36, "sha256:0"), RewardConfig::tiny(), &mut rng())
    }

    #[test]
    fn a_member_for_car_racing_has_the_papers_size() {
        let config = RewardConfig::car_racing();
        let ensemble = RewardEnsemble::new((544, "sha256:0"), config.clone(), &mut rng());
        let n_parameters: usize = ensemble.store.variables().values().map(Tensor::numel).sum();
        assert_eq!(n_parameters, 272_129 * config.members as usize);
    }

    #[test]
    fn a_reward_is_the_mean_of_networks_that_differ() {
        let (features, actions) = (normal(&mut rng(), &[5, 7, 36]), normal(&mut rng(), &[5, 7, 3]));
        let members = tiny().member_rewards(&features, &actions);
        let rewards = tiny().rewards(&features, &actions);
        assert_eq!((members.size(), rewards.size()), (vec![2, 5, 7], vec![5, 7]));
        assert_ne!(to_vec(&members.select(0, 0)), to_vec(&members.select(0, 1)));
        let apart = (rewards - (members.select(0, 0) + members.select(0, 1)) / 2.0).abs().max();
        assert!(apart.double_value(&[]) < 1e-6, "the mean of two is half their sum");
    }

    // The numbers are NumPy's:
    //
    //   from numpy import *
    //   def layer(inputs, outputs):
    //       w = cos(arange(2 * outputs * inputs)).reshape(2, outputs, inputs)
    //       return w, 0.1 * cos(arange(2 * outputs)).reshape(2, outputs)
    //   layers = [layer(5, 3), layer(3, 3), layer(3, 1)]
    //   def rewards(x):
    //       out = []
    //       for e in range(2):
    //           y = x
    //           for i, (w, b) in enumerate(layers):
    //               y = y @ w[e].T + b[e]
    //               if i < 2: y = where(y > 0, y, 0.01 * y)
    //           out.append(tanh(y[..., 0]))
    //       return stack(out)
    //   rewards(sin(arange(20.)).reshape(4, 5)), rewards(sin(arange(20.)).reshape(4, 5)).mean(0)
    #[test]
    fn members_and_their_mean_are_those_of_the_formula() {
        let ensemble = of_cosines();
        let rows: Vec<_> = (0..20u8).map(|i| f32::from(i).sin()).collect();
        let rows = from_slice(&rows, &[4, 5]);
        let (features, actions) = (rows.narrow(1, 0, 2), rows.narrow(1, 2, 3));
        let members = to_vec(&ensemble.member_rewards(&features, &actions));
        let mean = to_vec(&ensemble.rewards(&features, &actions));
        let first = [0.641_740_55, 0.450_581_2, 0.216_093_97, 0.833_430_33];
        let second = [0.051_878_85, -0.696_333_04, -0.959_670_2, -0.790_145_1];
        let together = [0.346_809_7, -0.122_875_92, -0.371_788_1, 0.021_642_61];
        for (found, wanted) in members.iter().chain(&mean).zip([first, second, together].concat()) {
            assert!((found - wanted).abs() < 1e-5, "{found} instead of {wanted}");
        }
    }

    #[test]
    fn an_ensemble_survives_the_way_to_bytes_and_back() {
        let (features, actions) = (normal(&mut rng(), &[5, 36]), normal(&mut rng(), &[5, 3]));
        let loaded = RewardEnsemble::load(&tiny().parameters()).unwrap();
        assert_eq!(
            to_vec(&loaded.rewards(&features, &actions)),
            to_vec(&tiny().rewards(&features, &actions))
        );
    }

    #[test]
    fn a_reward_knows_its_world_model_and_how_wide_its_states_are() {
        let model = untrained(&WorldModelConfig::tiny(), &mut rng());
        let reward = |n, of: &str| RewardEnsemble::new((n, of), RewardConfig::tiny(), &mut rng());
        let earlier = model.identity().relaid().unwrap().hash();
        for hash in [&model.hash(), &earlier] {
            assert!(reward(36, hash).require(model.identity()).is_ok(), "it knows its world model");
        }
        let refused = |reward: RewardEnsemble| reward.require(model.identity()).unwrap_err().to_string();
        let error = refused(reward(36, "sha256:0"));
        assert!(error.contains("sha256:0") && error.contains(&model.hash()), "{error}");
        let error = refused(reward(35, &model.hash()));
        assert!(error.contains("35") && error.contains("36"), "{error}");
    }

    #[test]
    fn an_ensemble_is_stored_as_pytorch_has_linear_layers() {
        let parameters = tiny().parameters();
        let stored = |name| parameters.tensor(name).unwrap();
        assert_eq!(stored("reward.0.weight").size(), [2, 16, 39]);
        assert_eq!(stored("reward.0.bias").size(), [2, 16]);
        let row = normal(&mut rng(), &[39]);
        let by_hand = row.linear(&stored("reward.0.weight").get(1), Some(stored("reward.0.bias").get(1)));
        let layer = &tiny().layers[0];
        let here = row.unsqueeze(0).matmul(&layer.weight.get(1)) + layer.bias.get(1);
        assert!((here - by_hand).abs().max().double_value(&[]) < 1e-6);
    }

    #[test]
    fn hazards_are_what_a_fit_found_and_not_what_a_configuration_says() {
        let config = RewardConfig { hazards: 3, ..RewardConfig::tiny() };
        let ensemble = RewardEnsemble::new((36, "sha256:0"), config.clone(), &mut rng());
        let loaded = RewardEnsemble::load(&ensemble.parameters()).unwrap();
        assert!(loaded.hazards().is_none() && loaded.config().hazards == 0);
        // A file that promises some must hold them.
        let header = Header::new(config, (36, "sha256:0").into());
        let slots = RewardEnsemble::slots(&RewardConfig::tiny(), 39);
        let promising = [(RewardEnsemble::KEY, described(&header))];
        let parameters = Parameters::stored(&[(RewardEnsemble::KEY, &ensemble.store, &slots)], &promising);
        let met = RewardEnsemble::load(&parameters).unwrap_err().to_string();
        assert!(met.contains("hazards.0.weight"), "{met}");
    }

    #[test]
    fn shapes_that_cannot_be_are_refused_before_anything_is_made() {
        let header = |change: &dyn Fn(&mut RewardConfig)| {
            let mut config = RewardConfig::tiny();
            change(&mut config);
            let header = Header::new(config, (36, "sha256:0").into());
            let parameters = Parameters::from_tensors([], &[("reward", described(&header))]);
            RewardEnsemble::load(&parameters).unwrap_err().to_string()
        };
        assert!(header(&|c| c.members = i64::MAX).contains("networks"));
        assert!(header(&|c| c.hidden = -1).contains("width"));
        assert!(header(&|c| c.layers = 1 << 40).contains("hidden layers"));
        assert!(header(&|c| c.batch = 0).contains("batch"));
        assert!(header(&|c| c.hidden = 10_000).contains("reward.0.weight"), "the file does not hold them");
    }

    #[test]
    fn parameters_of_something_else_are_no_reward() {
        let store = nn::VarStore::new(Device::Cpu);
        let error = RewardEnsemble::load(&Parameters::of(&[("vae", &store)], &[])).unwrap_err().to_string();
        assert!(error.contains("header"), "{error}");
    }
}
