//! A reward that nobody had to teach: what a probe sees in imagined pictures. For scale, as no method has it.

use tch::{Kind, Tensor};

use super::perception::Eyes;
use super::probe::Probe;
use crate::reward::RewardModel;
use crate::tensor::{dims, from_slice};
use crate::world::WorldSpec;
use crate::world_model::WorldModel;

/// Of so many imagined steps one is looked at: decoding is slow, and what happens lasts longer.
const EVERY: i64 = 2;

/// Judges imagined states by their decoded pictures, as somebody would who sees everything at once and never errs: what a
/// planner makes of it is the most that any reward learned from these pictures could bring.
///
/// A step is worth its progress, or where a safety event goes on or what a justification is about, minus one unit of progress.
#[derive(Debug)]
pub struct SeenReward<'a> {
    model: &'a WorldModel,
    eyes: Eyes<'a>,
}

impl<'a> SeenReward<'a> {
    /// What `probe` sees in the pictures of `model`, of what can happen in the world `spec`.
    pub fn new(model: &'a WorldModel, probe: &'a Probe, spec: &WorldSpec) -> Self {
        Self { model, eyes: Eyes::new(probe, spec) }
    }
}

impl RewardModel for SeenReward<'_> {
    /// # Shapes
    /// - `features`: `[H, S, F]`, as a planner asks
    fn rewards(&self, features: &Tensor, _: &Tensor) -> Tensor {
        let [horizon, n, _] = dims(features);
        let zs = self.model.latents_of(features); // [H, S, Z]
        let seen = zs.slice(0, 0, horizon, EVERY);
        let courses = (0..n).map(|s| {
            let clip = self.model.decode(&seen.select(1, s));
            let rewards = self.eyes.watch_every(&clip, EVERY as usize).rewards();
            from_slice(&rewards, &[rewards.len() as i64, 1])
        });
        let all = Tensor::cat(&courses.collect::<Vec<_>>(), 1); // [H / 2, S]
        all.repeat_interleave_self_int(EVERY, 0, None).narrow(0, 0, horizon).to_kind(Kind::Float)
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;
    use tch::{Device, nn};

    use super::*;
    use crate::simulate::probe::{Net, ProbeConfig};
    use crate::tensor::normal;
    use crate::world_model::{WorldModelConfig, untrained};

    #[test]
    fn every_imagined_step_is_judged_by_its_picture() {
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let model = untrained(&WorldModelConfig::tiny(), rng);
        let (store, config) = (nn::VarStore::new(Device::Cpu), ProbeConfig::tiny());
        Net::new(&store.root(), config.clone(), rng);
        let probe = Probe::load(&Probe::parameters_of(&config, &store, None, String::new())).unwrap();
        let features = normal(rng, &[7, 3, model.config().n_features()]);
        let rewards = SeenReward::new(&model, &probe, model.spec())
            .rewards(&features, &Tensor::zeros([7, 3, 3], tch::kind::FLOAT_CPU));
        assert_eq!(rewards.size(), [7, 3]);
        assert_eq!(rewards.get(0), rewards.get(1), "one of two is looked at");
        let other = SeenReward::new(&model, &probe, model.spec()).rewards(&features.flip([1]), &rewards);
        assert_eq!(other.flip([1]), rewards, "each course by itself");
    }
}
