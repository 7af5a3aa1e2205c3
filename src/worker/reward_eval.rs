//! Evaluates a reward and its members on steps that were driven: those of dreams, of clips and of real episodes alike.

use tch::Kind;

use crate::reward::{
    LearnedReward, RewardEnsemble, RewardError, RewardModel as _, RewardNetworks, SparseReward,
    scaled_actions_tensor,
};
use crate::tensor::{Parameters, from_slice, to_vec};
use crate::world::{Action, ActionRanges};
use crate::world_model::{WorldModel, actions_tensor};

/// A reward of either kind, evaluated as a whole and member by member.
pub(super) enum RewardEvaluator {
    /// Learned from pairs of clips.
    Preferences(RewardEnsemble),
    /// Learned from single transitions.
    Verdicts(SparseReward),
}

impl RewardEvaluator {
    /// The reward in `parameters`, which must have been learned with this model.
    pub(super) fn load(parameters: &Parameters, model: &WorldModel) -> Result<Self, RewardError> {
        Ok(match RewardNetworks::over(parameters, model)? {
            RewardNetworks::Preferences(reward) => Self::Preferences(reward),
            RewardNetworks::Verdicts(reward) => Self::Verdicts(reward),
        })
    }

    /// The same reward as a planner is given it.
    pub(super) fn frozen(&self) -> LearnedReward {
        match self {
            Self::Preferences(reward) => LearnedReward::Preferences(reward.for_inference()),
            Self::Verdicts(reward) => LearnedReward::Verdicts(reward.for_inference()),
        }
    }

    /// What the reward is of each step, whose `features` are one row each, and what it is by each member alone.
    pub(super) fn evaluate_members(
        &self,
        features: &[f32],
        actions: &[Action],
        ranges: &ActionRanges,
    ) -> (Vec<f32>, Vec<Vec<f32>>) {
        let rows = from_slice(features, &[actions.len() as i64, -1]);
        let scaled = scaled_actions_tensor(actions, ranges);
        let (rewards, members) = match self {
            Self::Preferences(reward) => {
                let members = reward.member_rewards(&rows, &scaled); // [E, T]
                (members.mean_dim(0, false, Kind::Float), members.unbind(0))
            }
            Self::Verdicts(reward) => tch::no_grad(|| {
                let chances = reward.chances(&rows, &actions_tensor(actions)); // [E, T, 3]
                let members =
                    (0..chances.size()[0]).map(|e| SparseReward::expected(&chances.narrow(0, e, 1)));
                (reward.rewards(&rows, &scaled), members.collect())
            }),
        };
        (to_vec(&rewards), members.iter().map(to_vec).collect())
    }

    /// The reward of each step, the lowest by any member, and the highest.
    pub(super) fn evaluate(
        &self,
        features: &[f32],
        actions: &[Action],
        ranges: &ActionRanges,
    ) -> [Vec<f32>; 3] {
        let (rewards, members) = self.evaluate_members(features, actions, ranges);
        let all = |pick: fn(f32, f32) -> f32| -> Vec<f32> {
            let at = |t: usize| members.iter().map(|member| member[t]).reduce(pick).unwrap_or_default();
            (0..rewards.len()).map(at).collect()
        };
        let (low, high) = (all(f32::min), all(f32::max));
        [rewards, low, high]
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::reward::{RewardConfig, SparseConfig};
    use crate::worker::fixtures;

    #[test]
    fn rewards_of_either_kind_are_evaluated_member_by_member() {
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let model = fixtures::model();
        let preferences =
            RewardEnsemble::new((36, model.hash().as_str()), RewardConfig::tiny(), rng).parameters();
        let verdicts = SparseReward::new((36, model.hash().as_str()), SparseConfig::tiny(), rng).parameters();
        let others = [
            RewardEnsemble::new((36, "another"), RewardConfig::tiny(), rng).parameters(),
            SparseReward::new((36, "another"), SparseConfig::tiny(), rng).parameters(),
        ];
        let features: Vec<f32> = (0..180).map(|i| (i as f32).sin()).collect();
        let actions: Vec<Action> = (0..5).map(|t| Action::new([0.2 * t as f32, 0.5, 0.0])).collect();
        for (parameters, other) in [preferences, verdicts].into_iter().zip(others) {
            assert!(RewardEvaluator::load(&other, &model).is_err());
            let evaluator = RewardEvaluator::load(&parameters, &model).unwrap();
            let (rewards, members) =
                evaluator.evaluate_members(&features, &actions, &ActionRanges::default());
            let scaled = scaled_actions_tensor(&actions, &ActionRanges::default());
            let by_hand = to_vec(&evaluator.frozen().rewards(&from_slice(&features, &[5, 36]), &scaled));
            let gap = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            // Frozen ones compute in whatever is quickest.
            assert!(gap(&rewards, &by_hand) < 0.02, "{rewards:?} and {by_hand:?}");
            assert!(members.len() > 1 && members.iter().all(|member| member.len() == 5), "{members:?}");
            let [_, low, high] = evaluator.evaluate(&features, &actions, &ActionRanges::default());
            let lowest = members.iter().map(|member| member[2]).fold(f32::INFINITY, f32::min);
            assert!(low[2] == lowest && low.iter().zip(&high).all(|(low, high)| low < high));
        }
    }
}
