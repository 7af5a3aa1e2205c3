//! What the agent believes about the world: a simulation learned from recordings (Step 1 of the method).
//!
//! Knows no window, clock or file, and is the only place that knows the order `[z | c | h]` of a state's features.

mod config;
pub mod fit;
mod fused_rollout;
mod identity;
mod layers;
pub mod mdn_rnn;
mod networks;
mod shapes;
mod starts;
pub mod vae;

use std::sync::Arc;

use rand::{Rng, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use tch::{Device, Kind, Tensor, nn};

use crate::tensor::limits::{MAX_EPISODE, OutOfRange};
use crate::tensor::{
    Backend, DescriptionError, NotFinite, Parameters, ParametersError, Slot, described, from_frames_on,
    from_slice, is_finite, to_frames, to_vec,
};
use crate::world::{Action, ActionRanges, Frame, WorldSpec};

pub use crate::tensor::fast_kind;
pub use config::WorldModelConfig;
use fused_rollout::FusedRollout;
pub use identity::ModelIdentity;
pub use layers::Layer;
pub use mdn_rnn::{MdnRnn, MdnRnnConfig, Memory, Mixture, Noise};
use networks::{Kept, Networks};
pub use vae::{Decoder, Encoder, Vae, VaeConfig};

/// A batch of states: latents, and the memory *before* taking in these latents and the action to come.
#[derive(Debug)]
pub struct State {
    /// `[B, Z]`.
    pub z: Tensor,
    /// `[B, M]` twice.
    pub memory: Memory,
}

impl Clone for State {
    fn clone(&self) -> Self {
        Self { z: self.z.shallow_clone(), memory: self.memory.clone() }
    }
}

impl State {
    /// What the reward reads: `[z | c | h]`, the only concatenation.
    ///
    /// # Shapes
    /// - returns `[B, Z + 2 M]`
    pub fn features(&self) -> Tensor {
        // DIFFERENCE: the paper writes [h, z]. The authors' code, which made the numbers, has this order (method §14.6).
        let Memory { c, h } = &self.memory;
        Tensor::cat(&[&self.z.to_device(c.device()), c, h], 1)
    }

    /// The same states on a device.
    #[must_use]
    pub fn on(&self, device: Device) -> Self {
        Self { z: self.z.to_device(device), memory: self.memory.on(device) }
    }

    /// Fails where one of the states is not made of numbers. `what` says which they are.
    pub fn require_finite(&self, what: &str) -> Result<(), NotFinite> {
        let part = |name: &str, part: &Tensor| {
            let met = || NotFinite(format!("what the world model makes of {what} ({name})"));
            is_finite(part).then_some(()).ok_or_else(met)
        };
        part("latents", &self.z)?;
        part("memory", &self.memory.c)?;
        part("memory", &self.memory.h)
    }

    /// States one beside the other.
    ///
    /// # Panics
    /// Where there is none, or where they are not of one model.
    pub fn side_by_side(states: &[&LatentState]) -> Self {
        let all = |part: fn(&LatentState) -> &[f32]| {
            let values: Vec<f32> = states.iter().flat_map(|state| part(state)).copied().collect();
            from_slice(&values, &[states.len() as i64, part(states[0]).len() as i64])
        };
        let memory = Memory { c: all(|state| &state.c), h: all(|state| &state.h) };
        Self { z: all(|state| &state.z), memory }
    }

    /// This state `b` times over. It must be a batch of one.
    pub fn repeated(&self, b: i64) -> Self {
        let repeat = |tensor: &Tensor| tensor.expand([b, -1], false);
        let memory = Memory { c: repeat(&self.memory.c), h: repeat(&self.memory.h) };
        Self { z: repeat(&self.z), memory }
    }
}

/// One state as plain data, for channels and files.
#[derive(Clone, Debug, PartialEq)]
pub struct LatentState {
    /// Z latents.
    pub z: Vec<f32>,
    /// M cells.
    pub c: Vec<f32>,
    /// M outputs.
    pub h: Vec<f32>,
}

impl From<&LatentState> for State {
    fn from(state: &LatentState) -> Self {
        let row = |values: &[f32]| from_slice(values, &[1, values.len() as i64]);
        Self { z: row(&state.z), memory: Memory { c: row(&state.c), h: row(&state.h) } }
    }
}

impl From<&State> for LatentState {
    fn from(state: &State) -> Self {
        Self { z: to_vec(&state.z), c: to_vec(&state.memory.c), h: to_vec(&state.memory.h) }
    }
}

/// How the next latents follow from their mixture (method §4.5).
#[derive(Clone, Copy, Debug)]
pub enum Next<'a> {
    /// Drawn: in dreams, at temperature 1.
    Sample {
        /// τ.
        temperature: f64,
        /// The caller's randomness.
        noise: &'a Noise,
    },
    /// The mean: in planning, at temperature 0.1.
    Mean {
        /// τ.
        temperature: f64,
    },
}

/// The parameters of a world model, and what shall compute with them: the processor, where nothing else is said.
#[derive(Clone, Debug)]
pub struct Placed {
    /// The networks.
    pub parameters: Parameters,
    /// What computes.
    pub backend: Backend,
}

impl From<Parameters> for Placed {
    fn from(parameters: Parameters) -> Self {
        Self { parameters, backend: Backend::cpu() }
    }
}

/// Vision and memory together, for use. Their training is in `fit`.
///
/// Where it is on an accelerator, so is what it makes; what it is given may be anywhere.
#[derive(Debug)]
pub struct WorldModel {
    backend: Backend,
    config: WorldModelConfig,
    spec: Arc<WorldSpec>,
    ranges: ActionRanges,
    parameters: Parameters,
    networks: Networks,
    _kept: Kept,
    starts: Vec<LatentState>,
    held_out: Option<Vec<usize>>,
    identity: ModelIdentity,
}

/// Why a world model cannot be loaded.
#[derive(Debug, thiserror::Error)]
pub enum WorldModelError {
    /// The parameters are wrong.
    #[error("cannot load the world model: {0}")]
    Parameters(ParametersError),
    /// The header does not describe networks.
    #[error("cannot load the world model: its header does not describe one ({0})")]
    Header(DescriptionError),
    /// The header describes networks that cannot be.
    #[error("cannot load the world model: {0}")]
    Config(OutOfRange),
    /// What lies beside the networks does not fit them.
    #[error("cannot load the world model: {what}")]
    Beside {
        /// What is wrong.
        what: String,
    },
}

impl From<ParametersError> for WorldModelError {
    fn from(met: ParametersError) -> Self {
        Self::Parameters(met)
    }
}

impl WorldModel {
    /// The model whose networks `parameters` hold. Their header says which they are.
    pub fn load(placed: impl Into<Placed>) -> Result<Self, WorldModelError> {
        let Placed { parameters, backend } = placed.into();
        let Backend { device, kind } = backend;
        let identity = ModelIdentity::of(&parameters)?;
        let (layout, config) = (identity.layout(), identity.config().clone());
        let (of_vae, of_mdn_rnn) = (config.vae.slots(), config.mdn_rnn.slots());
        // Before anything is made: what a header promises, the file must hold.
        parameters.require("vae", &of_vae, layout)?;
        parameters.require("mdn_rnn", &of_mdn_rnn, layout)?;
        let starts = starts::unpack(&parameters, &config.mdn_rnn)?;
        let held_out = held_out(&parameters)?;
        let make = || {
            // The draw is overwritten at once.
            let rng = &mut ChaCha8Rng::seed_from_u64(0);
            let (mut vision, mut memory) = (nn::VarStore::new(Device::Cpu), nn::VarStore::new(Device::Cpu));
            let vae = Vae::new(&vision.root(), config.vae.clone(), Kind::Float, rng);
            let mdn_rnn = MdnRnn::new(&memory.root(), config.mdn_rnn.clone(), rng);
            parameters.fill("vae", &of_vae, layout, &vision)?;
            parameters.fill("mdn_rnn", &of_mdn_rnn, layout, &memory)?;
            memory.freeze();
            if !backend.is_cpu() {
                vision.set_device(device);
                memory.set_device(device);
            }
            Ok::<_, WorldModelError>(Networks {
                encoder: vae.encoder.for_inference(Kind::Float),
                decoder: vae.decoder.for_inference(kind),
                fused_rollout: FusedRollout::of(&mdn_rnn),
                mdn_rnn,
            })
        };
        let (networks, kept) = Networks::of(&parameters.hash(), backend, make)?;
        let spec = config.spec();
        let ranges = ActionRanges::of(&spec.axes);
        Ok(Self {
            backend,
            config,
            spec,
            ranges,
            parameters,
            networks,
            _kept: kept,
            starts,
            held_out,
            identity,
        })
    }

    /// What computes.
    pub fn backend(&self) -> Backend {
        self.backend
    }

    /// The same model, computed by `backend`.
    pub fn on(self, backend: Backend) -> Result<Self, WorldModelError> {
        if self.backend == backend {
            return Ok(self);
        }
        Self::load(Placed { parameters: self.parameters, backend })
    }

    /// A tensor where the networks are.
    fn here(&self, tensor: &Tensor) -> Tensor {
        tensor.to_device(self.backend.device)
    }

    /// The state, a batch of one, whose features `[z | c | h]` are these.
    pub fn state_of(&self, features: &[f32]) -> State {
        let (z, memory) = features.split_at(self.config.mdn_rnn.latent as usize);
        let (c, h) = memory.split_at(self.config.mdn_rnn.memory as usize);
        State::from(&LatentState { z: z.to_vec(), c: c.to_vec(), h: h.to_vec() })
    }

    /// Both networks as they are trained: what [`Self::load`] takes.
    pub fn parameters_of(
        config: &WorldModelConfig,
        vision: &nn::VarStore,
        memory: &nn::VarStore,
    ) -> Parameters {
        let (of_vae, of_mdn_rnn) = (config.vae.slots(), config.mdn_rnn.slots());
        let stores: [(&str, &nn::VarStore, &[Slot]); 2] =
            [("vae", vision, &of_vae), ("mdn_rnn", memory, &of_mdn_rnn)];
        Parameters::stored(&stores, &[("config", described(config))])
    }

    /// This model's parameters with `starts` beside them, and the numbers of the episodes that were held out.
    pub fn parameters_with_starts(&self, starts: &[LatentState], held_out: &[usize]) -> Parameters {
        let held_out: Vec<f32> = held_out.iter().map(|&episode| episode as f32).collect();
        let held_out = ("held_out".to_owned(), Tensor::from_slice(&held_out));
        self.parameters.with(starts::pack(starts).into_iter().chain([held_out]))
    }

    /// The recorded episodes that this model was never trained on, where its file says so.
    pub fn held_out(&self) -> Option<Vec<usize>> {
        self.held_out.clone()
    }

    /// Where dreams may start: moments of held-out real episodes, their memory warm.
    pub fn starts(&self) -> &[LatentState] {
        &self.starts
    }

    /// The shapes of the networks.
    pub fn config(&self) -> &WorldModelConfig {
        &self.config
    }

    /// The world whose recordings it learned from, in pictures of the size that it sees.
    pub fn spec(&self) -> &Arc<WorldSpec> {
        &self.spec
    }

    /// The ranges of that world's actions.
    pub fn ranges(&self) -> &ActionRanges {
        &self.ranges
    }

    /// What identifies this model: everything dreamed with it names it.
    ///
    /// One that was stored in another layout since then is called otherwise: whether it is meant, [`Self::is`] says.
    pub fn hash(&self) -> String {
        self.parameters.hash()
    }

    /// The parameters this was loaded from.
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// The latents of frames: the encoder's means.
    ///
    /// # Shapes
    /// - returns `[B, Z]`
    pub fn observe(&self, frames: &[Frame]) -> Tensor {
        tch::no_grad(|| self.networks.encoder.encode(&from_frames_on(self.backend.device, frames)).0)
    }

    /// An empty memory for a batch of `b`.
    pub fn no_memory(&self, b: i64) -> Memory {
        Memory::zeros(b, &self.config.mdn_rnn).on(self.backend.device)
    }

    /// The memory after taking in a state and an action. It depends on nothing else.
    ///
    /// # Shapes
    /// - `actions`: `[B, A]`, as driven
    pub fn remember(&self, state: &State, actions: &Tensor) -> Memory {
        let State { z, memory } = state.on(self.backend.device);
        tch::no_grad(|| self.networks.mdn_rnn.remember(&z, &self.here(actions), &memory))
    }

    /// The state that follows `state` under `actions`.
    ///
    /// # Shapes
    /// - `actions`: `[B, A]`, as driven
    pub fn imagine(&self, state: &State, actions: &Tensor, next: Next<'_>) -> State {
        let Networks { mdn_rnn, fused_rollout, .. } = &self.networks;
        let (State { z, memory }, actions) = (state.on(self.backend.device), self.here(actions));
        tch::no_grad(|| {
            let (z, memory) = match next {
                Next::Sample { temperature, noise } => {
                    let memory = mdn_rnn.remember(&z, &actions, &memory);
                    let noise = noise.on(self.backend.device);
                    (mdn_rnn.mixture(&memory.h).sample(temperature, &noise), memory)
                }
                Next::Mean { temperature } => fused_rollout.imagine(&z, &actions, &memory, temperature),
            };
            State { z, memory }
        })
    }

    /// The state that follows `state` under `actions` in the mean, through which gradients pass.
    ///
    /// # Shapes
    /// - `actions`: `[B, A]`, as driven
    pub fn imagine_for_gradients(&self, state: &State, actions: &Tensor, temperature: f64) -> State {
        let (State { z, memory }, actions) = (state.on(self.backend.device), self.here(actions));
        let memory = self.networks.mdn_rnn.remember(&z, &actions, &memory);
        State { z: self.networks.mdn_rnn.mixture(&memory.h).mean(temperature), memory }
    }

    /// What the model expects after `memory`, for measuring surprise and uncertainty.
    pub fn expect(&self, memory: &Memory) -> Mixture {
        tch::no_grad(|| self.networks.mdn_rnn.mixture(&self.here(&memory.h)))
    }

    /// The latents in what the reward reads.
    ///
    /// # Shapes
    /// - `features`: `[…, Z + 2 M]`
    /// - returns `[…, Z]`
    pub fn latents_of(&self, features: &Tensor) -> Tensor {
        features.narrow(-1, 0, self.config().mdn_rnn.latent)
    }

    /// The pictures of latents.
    ///
    /// # Shapes
    /// - `z`: `[B, Z]`
    pub fn decode(&self, z: &Tensor) -> Vec<Frame> {
        let draw = |z: &Tensor| tch::no_grad(|| to_frames(&self.networks.decoder.decode(&self.here(z))));
        if self.backend().device != Device::Cpu {
            return draw(z);
        }
        // What a processor computes on the way stays in its caches, and small: 40 pictures of 128 pixels took 280 MB.
        z.split(DRAWN, 0).iter().flat_map(draw).collect()
    }
}

/// Pictures that the processor draws together.
const DRAWN: i64 = 5;

/// The numbers of the episodes that were held out, where `parameters` tell them.
fn held_out(parameters: &Parameters) -> Result<Option<Vec<usize>>, WorldModelError> {
    let Some(held_out) = parameters.finite("held_out")? else { return Ok(None) };
    let wrong = |what| WorldModelError::Beside { what };
    if held_out.dim() != 1 {
        return Err(wrong(format!(
            "its \"held_out\" has the shape {:?}, and must have one axis",
            held_out.size()
        )));
    }
    let number = |episode: f32| {
        let is_one = (0.0..=MAX_EPISODE).contains(&episode) && episode.fract() == 0.0;
        is_one.then_some(episode as usize).ok_or_else(|| {
            wrong(format!("its \"held_out\" names the episode {episode:?}, which is no number of one"))
        })
    };
    to_vec(&held_out).into_iter().map(number).collect::<Result<_, _>>().map(Some)
}

/// A tensor of actions of one world as driven.
///
/// # Shapes
/// - returns `[B, A]`; of no actions `[0, 0]`
///
/// # Panics
/// Where they have not all as many numbers.
pub fn actions_tensor(actions: &[Action]) -> Tensor {
    let n_axes = actions.first().map_or(0, |action| action.len());
    let values: Vec<f32> = actions.iter().flat_map(|action| action.iter().copied()).collect();
    from_slice(&values, &[actions.len() as i64, n_axes as i64])
}

/// A world model that has learned nothing, for tests and for measuring speed.
pub fn untrained(config: &WorldModelConfig, rng: &mut impl Rng) -> WorldModel {
    let (vision, memory) = (nn::VarStore::new(Device::Cpu), nn::VarStore::new(Device::Cpu));
    Vae::new(&vision.root(), config.vae.clone(), Kind::Float, rng);
    MdnRnn::new(&memory.root(), config.mdn_rnn.clone(), rng);
    let parameters = WorldModel::parameters_of(config, &vision, &memory);
    WorldModel::load(parameters).unwrap_or_else(|e| unreachable!("just made: {e}"))
}
