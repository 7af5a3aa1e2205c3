//! A reward laid out for inference: a planner asks for it four hundred times an episode.

use tch::{Kind, Tensor};

use crate::reward::{Hazards, RewardEnsemble, RewardModel};

/// A [`RewardEnsemble`] with its weights cast and laid out once, for speed.
///
/// Hidden layers are computed in the ensemble's arithmetic, outputs in full precision.
/// Since every member reads the same rows, their first layers are one product.
#[derive(Debug)]
pub struct InferenceReward {
    kind: Kind,
    n_members: i64,
    /// `[F + A, E · hidden]` and `[E · hidden]`.
    first: [Tensor; 2],
    /// `[E, in, out]` and `[E, 1, out]`.
    rest: Vec<[Tensor; 2]>,
    hazards: Option<Hazards>,
}

impl RewardEnsemble {
    /// The ensemble as it stands, which learns no more.
    pub fn for_inference(&self) -> InferenceReward {
        let n_hidden = self.layers.len() - 1;
        let kind = |i| if i == n_hidden { Kind::Float } else { self.kind };
        tch::no_grad(|| {
            let side_by_side = |members: &Tensor| members.transpose(0, 1).flatten(1, 2).to_kind(self.kind);
            let (first, rest) = (&self.layers[0], self.layers.iter().enumerate().skip(1));
            InferenceReward {
                kind: self.kind,
                n_members: self.config.members,
                first: [side_by_side(&first.weight), side_by_side(&first.bias)],
                rest: rest
                    .map(|(i, layer)| [&layer.weight, &layer.bias].map(|t| t.to_kind(kind(i)).copy()))
                    .collect(),
                hazards: self.hazards.as_ref().map(|hazards| hazards.for_inference(self.kind)),
            }
        })
    }
}

impl RewardModel for InferenceReward {
    fn rewards(&self, features: &Tensor, scaled_actions: &Tensor) -> Tensor {
        let mut shape = features.size();
        shape.pop();
        tch::no_grad(|| {
            let [weight, bias] = &self.first;
            let [features, scaled_actions] = [features, scaled_actions].map(|t| t.to_device(weight.device()));
            let rows = Tensor::cat(&[features, scaled_actions], -1).flatten(0, -2).to_kind(self.kind); // [N, F + A]
            let joint = bias.addmm(&rows, weight).leaky_relu(); // [N, E · hidden]
            let mut x = joint.view([joint.size()[0], self.n_members, -1]).transpose(0, 1); // [E, N, hidden]
            for (i, [weight, bias]) in self.rest.iter().enumerate() {
                x = bias.baddbmm(&x.to_kind(weight.kind()), weight, 1, 1);
                x = if i + 1 == self.rest.len() { x.tanh() } else { x.leaky_relu() };
            }
            let rewards = x.mean_dim(0, false, Kind::Float).view([-1]);
            let costs = self.hazards.as_ref().map(|hazards| hazards.costs(&rows));
            costs.map_or(rewards.shallow_clone(), |costs| rewards - costs).view(shape.as_slice())
        })
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::reward::RewardConfig;
    use crate::tensor::normal;

    #[test]
    fn a_frozen_reward_judges_like_its_ensemble() {
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let (features, actions) = (normal(rng, &[5, 7, 36]), normal(rng, &[5, 7, 3]));
        let ensemble = RewardEnsemble::new((36, "sha256:0"), RewardConfig::tiny(), rng).in_kind(Kind::Float);
        let apart =
            ensemble.for_inference().rewards(&features, &actions) - ensemble.rewards(&features, &actions);
        assert!(apart.abs().max().double_value(&[]) < 1e-6);
        let quick = ensemble.in_kind(Kind::BFloat16);
        let apart = quick.for_inference().rewards(&features, &actions) - quick.rewards(&features, &actions);
        assert!(apart.abs().max().double_value(&[]) < 2e-2, "rounded to eight bits, but not otherwise");
    }
}
