//! The networks in training, and an update of them.

use rand::Rng;
use tch::{Kind, Reduction, Tensor, nn};

use super::agent::{DrqAgent, Nature};
use super::networks::{Actor, Critic, Encoder};
use super::noise::perturbed;
use super::replay::Batch;
use crate::tensor::adam::Adam;
use crate::tensor::limits::OutOfRange;
use crate::tensor::{Backend, NotFinite, Parameters, ParametersError, normal, require_finite};
use crate::world::WorldSpec;

/// The networks and their optimizers.
#[derive(Debug)]
pub struct Learner {
    nature: Nature,
    backend: Backend,
    /// Encoder and critic, which learn together.
    valuing: nn::VarStore,
    acting: nn::VarStore,
    target_store: nn::VarStore,
    encoder: Encoder,
    critic: Critic,
    target: Critic,
    actor: Actor,
    /// Of encoder and critic: two optimizers of one rate are one.
    adam_valuing: Adam,
    adam_acting: Adam,
}

/// What an update was about, on the device: reading them is waiting.
#[derive(Debug)]
pub struct Losses {
    /// Of the critic, `[]`.
    pub critic: Tensor,
    /// The mean of what the critics were to learn, `[]`.
    pub target: Tensor,
}

/// What critics that say `values` are off by, where they should have said `target`.
///
/// `mean (Q₁ − y)² + mean (Q₂ − y)²`
///
/// # Shapes
/// - `values`: twice `[B, 1]`, `target`: `[B, 1]`
/// - returns `[]`
pub fn critic_loss(values: &[Tensor; 2], target: &Tensor) -> Tensor {
    let [one, other] = values.each_ref().map(|value| value.mse_loss(target, Reduction::Mean));
    one + other
}

impl Learner {
    /// Networks that have learned nothing, for a world, drawn by `rng`.
    ///
    /// # Errors
    /// Where the world's pictures are too small or too large.
    pub fn new(
        spec: &WorldSpec,
        config: &super::DrqConfig,
        backend: Backend,
        rng: &mut impl Rng,
    ) -> Result<Self, OutOfRange> {
        let nature = Nature::of(spec, config);
        let widths = nature.widths()?;
        let store = || nn::VarStore::new(backend.device);
        let (valuing, acting, mut target_store) = (store(), store(), store());
        let encoder = Encoder::new(&(valuing.root() / "encoder"), config, rng);
        let actor = Actor::new(&(acting.root() / "actor"), config, widths, rng);
        let critic = Critic::new(&(valuing.root() / "critic"), config, widths, rng);
        let target = Critic::new(&(target_store.root() / "critic"), config, widths, rng);
        let (adam_valuing, adam_acting) = (Adam::new(&valuing), Adam::new(&acting));
        target_store.freeze();
        let mut learner = Self {
            nature,
            backend,
            valuing,
            acting,
            target_store,
            encoder,
            critic,
            target,
            actor,
            adam_valuing,
            adam_acting,
        };
        // The target begins as the critic.
        learner.follow(1.0);
        Ok(learner)
    }

    /// What acts as these networks do now, and as they will.
    pub fn agent(&self) -> DrqAgent {
        DrqAgent {
            nature: self.nature.clone(),
            encoder: self.encoder.detached(),
            actor: self.actor.detached(),
            backend: self.backend,
        }
    }

    /// The agent's parameters, to be stored.
    pub fn agent_parameters(&self) -> Parameters {
        DrqAgent::parameters(&self.nature, &[("", &self.valuing), ("", &self.acting)])
    }

    /// Learns from `batch`, where noise has the standard deviation `std`.
    ///
    /// `// DIFFERENCE:` convolutions are computed in the backend's arithmetic, half precision where that is quicker; published
    /// is single precision throughout. Parameters and all else are.
    pub fn update(&mut self, batch: &Batch, std: f64, rng: &mut impl Rng) -> Losses {
        let config = &self.nature.config;
        let (rate, clip, target_rate) = (config.learning_rate, config.noise_clip, config.target_rate);
        let device = self.backend.device;
        let mut noise = || (normal(rng, &batch.actions.size()) * std).clamp(-clip, clip).to_device(device);
        let h = self.encoder.forward(&batch.pixels, self.backend.kind);
        let target = tch::no_grad(|| {
            let next = self.encoder.forward(&batch.next_pixels, self.backend.kind);
            self.target_of(&next, batch, &noise())
        });
        let loss = critic_loss(&self.critic.forward(&h, &batch.actions), &target);
        self.adam_valuing.step(&loss, rate, None);

        // By what was seen before the encoder moved, as published, and by the critic as it is now.
        let h = h.detach();
        let actions = perturbed(&self.actor.forward(&h), &noise());
        let [one, other] = self.critic.detached().forward(&h, &actions);
        let value = one.minimum(&other).mean(Kind::Float);
        self.adam_acting.step(&-value, rate, None);

        self.follow(target_rate);
        Losses { critic: loss.detach(), target: target.mean(Kind::Float) }
    }

    /// What the critic is to say of a batch: `y = r + γ^n min(Q̄₁, Q̄₂)(h', clip(μ(h') + ε))`.
    ///
    /// # Shapes
    /// - `next`: `[B, R]`, what the encoder sees n actions later; `noise`: `[B, A]`
    /// - returns `[B, 1]`
    fn target_of(&self, next: &Tensor, batch: &Batch, noise: &Tensor) -> Tensor {
        let actions = perturbed(&self.actor.forward(next), noise);
        let [one, other] = self.target.forward(next, &actions);
        &batch.rewards + &batch.discounts * one.minimum(&other)
    }

    /// Moves the target network towards the critic by this share of the way.
    fn follow(&mut self, rate: f64) {
        let critic = self.valuing.variables();
        tch::no_grad(|| {
            for (name, mut target) in self.target_store.variables() {
                let Some(variable) = critic.get(&name) else { unreachable!("{name} is the critic's, too") };
                if rate == 1.0 {
                    target.copy_(variable);
                } else {
                    let _ = target.lerp_(variable, rate);
                }
            }
        });
    }

    /// The target network's and the critic's value of what a batch sees and does, and the batch's target without noise: for
    /// tests.
    #[cfg(test)]
    pub(super) fn told(&self, batch: &Batch) -> ([Tensor; 2], Tensor) {
        tch::no_grad(|| {
            let h = self.encoder.forward(&batch.pixels, self.backend.kind);
            let next = self.encoder.forward(&batch.next_pixels, self.backend.kind);
            let target = self.target_of(&next, batch, &batch.actions.zeros_like());
            (self.critic.forward(&h, &batch.actions), target)
        })
    }

    /// All that goes on changing, by name, for a checkpoint with `state` in its header.
    pub fn checkpoint(&self, state: &[(&str, String)]) -> Parameters {
        let stores = [("net", &self.valuing), ("net", &self.acting), ("target", &self.target_store)];
        let networks = stores.into_iter().flat_map(|(prefix, store)| {
            store.variables().into_iter().map(move |(name, tensor)| (format!("{prefix}.{name}"), tensor))
        });
        let moments = |prefix: &'static str, adam: &Adam| {
            adam.state().into_iter().map(move |(name, tensor)| (format!("{prefix}.{name}"), tensor))
        };
        let valuing = moments("adam.valuing", &self.adam_valuing);
        Parameters::from_tensors(
            networks.chain(valuing).chain(moments("adam.acting", &self.adam_acting)),
            state,
        )
    }

    /// Goes on from what [`Self::checkpoint`] kept.
    ///
    /// # Errors
    /// Where something is missing or damaged.
    pub fn restore(&mut self, kept: &Parameters) -> Result<(), ParametersError> {
        kept.load("net", &self.valuing)?;
        kept.load("net", &self.acting)?;
        kept.load("target", &self.target_store)?;
        for (prefix, adam) in
            [("adam.valuing", &mut self.adam_valuing), ("adam.acting", &mut self.adam_acting)]
        {
            let restored = adam.restore(|name| kept.finite(&format!("{prefix}.{name}")).ok()?);
            restored.ok_or_else(|| ParametersError::Missing(prefix.to_owned()))?;
        }
        Ok(())
    }

    /// Fails where a number of a network is none.
    ///
    /// # Errors
    /// With its name.
    pub fn require_finite(&self) -> Result<(), NotFinite> {
        require_finite(&self.valuing, "the encoder and critic of DrQ-v2")?;
        require_finite(&self.acting, "the actor of DrQ-v2")
    }
}
