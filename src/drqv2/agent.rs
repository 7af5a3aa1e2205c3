//! A trained agent: what it sees by, what it does, and its file.

use std::collections::VecDeque;

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use tch::{Device, Tensor, nn};

use super::DrqConfig;
use super::networks::{Actor, Encoder, representation};
use super::replay::stacked;
use crate::evaluation::Policy;
use crate::tensor::limits::OutOfRange;
use crate::tensor::{
    Backend, DescriptionError, NotFinite, Parameters, ParametersError, described, describes, to_vec,
};
use crate::world::{Action, ActionRanges, Frame, Size, WorldSpec};

/// The key of an agent's description in the metadata of its file.
const KEY: &str = "drqv2";

/// Of which world an agent is, and by what numbers it was made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Nature {
    pub(super) world: String,
    pub(super) height: u32,
    pub(super) width: u32,
    pub(super) ranges: ActionRanges,
    pub(super) config: DrqConfig,
}

impl Nature {
    pub(super) fn of(spec: &WorldSpec, config: &DrqConfig) -> Self {
        let Size { height, width } = spec.image.trained();
        let ranges = ActionRanges::of(&spec.axes);
        Self { world: spec.name.clone(), height, width, ranges, config: config.clone() }
    }

    pub(super) fn size(&self) -> Size {
        Size { height: self.height, width: self.width }
    }

    /// R and A: the numbers that the encoder makes, and those of an action.
    pub(super) fn widths(&self) -> Result<[i64; 2], OutOfRange> {
        Ok([representation(&self.config, self.size())?, self.ranges.n_axes() as i64])
    }
}

/// Why a file holds no agent for a world.
#[derive(Debug, thiserror::Error)]
pub enum AgentError {
    /// It holds none.
    #[error(transparent)]
    Parameters(#[from] ParametersError),
    /// It holds one that cannot be.
    #[error("this agent of DrQ-v2 cannot be: {0}")]
    OutOfRange(#[from] OutOfRange),
    /// It acts in another world.
    #[error("this agent was trained in {trained:?} ({seen}), and the world here is {world:?} ({shown})")]
    World {
        /// In which it was trained.
        trained: String,
        /// What it saw there.
        seen: Size,
        /// In which it would act.
        world: String,
        /// What is shown there.
        shown: Size,
    },
}

/// What acts: an encoder and an actor, with no noise.
#[derive(Debug)]
pub struct DrqAgent {
    pub(super) nature: Nature,
    pub(super) encoder: Encoder,
    pub(super) actor: Actor,
    pub(super) backend: Backend,
}

impl DrqAgent {
    /// Its parameters, to be stored.
    pub(super) fn parameters(nature: &Nature, stores: &[(&str, &nn::VarStore)]) -> Parameters {
        let variables = stores.iter().flat_map(|(prefix, store)| {
            store.variables().into_iter().map(move |(name, tensor)| (format!("{prefix}{name}"), tensor))
        });
        let is_acting = |name: &str| name.starts_with("encoder.") || name.starts_with("actor.");
        let acting = variables.filter(|(name, _)| is_acting(name));
        let acting = acting.map(|(name, tensor)| (format!("drqv2.{name}"), tensor));
        Parameters::from_tensors(acting, &[(KEY, described(nature))])
    }

    /// The one that is stored in these parameters, to act on the processor.
    ///
    /// # Errors
    /// Where there is none.
    pub fn load(parameters: &Parameters) -> Result<Self, AgentError> {
        let (_, nature): (u32, Nature) =
            describes(parameters.metadata(KEY).as_deref()).map_err(|met| match met {
                DescriptionError::Missing => ParametersError::Missing("drqv2".to_owned()),
                met => ParametersError::Description(met),
            })?;
        nature.config.check_for(nature.size())?;
        let widths = nature.widths()?;
        let store = nn::VarStore::new(Device::Cpu);
        // What is drawn is written over.
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let encoder = Encoder::new(&(store.root() / "encoder"), &nature.config, rng);
        let actor = Actor::new(&(store.root() / "actor"), &nature.config, widths, rng);
        parameters.load("drqv2", &store)?;
        let (encoder, actor) = (encoder.detached(), actor.detached());
        Ok(Self { nature, encoder, actor, backend: Backend::cpu() })
    }

    /// In which world it was trained.
    pub fn world(&self) -> &str {
        &self.nature.world
    }

    /// The numbers by which it was trained.
    pub fn config(&self) -> &DrqConfig {
        &self.nature.config
    }

    /// Fails where it cannot act in this world.
    ///
    /// # Errors
    /// Where that shows pictures of another size, or takes other actions.
    pub fn require(&self, spec: &WorldSpec) -> Result<(), AgentError> {
        let Nature { world, ranges, .. } = &self.nature;
        if self.nature.size() == spec.image.trained() && *ranges == ActionRanges::of(&spec.axes) {
            return Ok(());
        }
        Err(AgentError::World {
            trained: world.clone(),
            seen: self.nature.size(),
            world: spec.name.clone(),
            shown: spec.image.trained(),
        })
    }

    /// What it does where it sees these pictures, in `[-1, 1]`.
    pub(super) fn mean(&self, pictures: &VecDeque<Frame>) -> Tensor {
        let pixels: Vec<u8> = pictures.iter().flat_map(Frame::rgb).copied().collect();
        let pixels = stacked(&pixels, [1, pictures.len()], self.nature.size(), self.backend.device);
        tch::no_grad(|| self.actor.forward(&self.encoder.forward(&pixels, self.backend.kind)))
    }

    /// An action in `[-1, 1]` as the world takes it.
    ///
    /// `a = low + (ã + 1) (high − low) / 2`
    pub(super) fn unscaled(&self, action: &[f32]) -> Action {
        let mut unscaled = Action::new(action);
        for (value, [low, high]) in unscaled.iter_mut().zip(self.nature.ranges.iter()) {
            *value = (low + 0.5 * (*value + 1.0) * (high - low)).clamp(low, high);
        }
        unscaled
    }
}

/// The pictures that are seen at once.
#[derive(Clone, Debug)]
pub(super) struct Sight {
    pictures: VecDeque<Frame>,
    k: usize,
}

impl Sight {
    pub(super) fn of(k: usize) -> Self {
        Self { pictures: VecDeque::new(), k }
    }

    /// The last ones, the oldest first.
    pub(super) fn pictures(&self) -> &VecDeque<Frame> {
        &self.pictures
    }

    /// Sees one more; the first stands for those before it.
    pub(super) fn see(&mut self, frame: &Frame) -> &VecDeque<Frame> {
        while self.pictures.len() < self.k {
            self.pictures.push_back(frame.clone());
        }
        self.pictures.pop_front();
        self.pictures.push_back(frame.clone());
        &self.pictures
    }
}

/// A [`DrqAgent`] in an episode, without noise.
#[derive(Debug)]
pub struct DrqPolicy<'a> {
    agent: &'a DrqAgent,
    sight: Sight,
    /// What it does, and for how many steps more.
    held: (Action, usize),
}

impl<'a> DrqPolicy<'a> {
    /// For one episode.
    pub fn new(agent: &'a DrqAgent) -> Self {
        let sight = Sight::of(agent.nature.config.stack);
        Self { agent, sight, held: (Action::default(), 0) }
    }
}

impl Policy for DrqPolicy<'_> {
    fn act(&mut self, frame: &Frame) -> Result<Action, NotFinite> {
        if self.held.1 == 0 {
            let action = self.agent.unscaled(&to_vec(&self.agent.mean(self.sight.see(frame))));
            if !action.is_finite() {
                return Err(NotFinite("the action of the agent".to_owned()));
            }
            self.held = (action, self.agent.nature.config.action_repeat);
        }
        self.held.1 -= 1;
        Ok(self.held.0)
    }

    fn acted(&mut self, _: Action) {}
}
