//! A reward of either kind, as it is kept in a session: learned from preferences, or from verdicts.

use tch::Tensor;

use crate::reward::{InferenceReward, RewardEnsemble, RewardError, RewardModel, SparseReward};
use crate::tensor::Parameters;
use crate::world_model::ModelIdentity;

/// What a planner is given.
#[derive(Debug)]
pub enum LearnedReward {
    /// Learned from pairs of clips.
    Preferences(InferenceReward),
    /// Learned from single transitions.
    Verdicts(SparseReward),
}

impl LearnedReward {
    /// The reward in `parameters`, which must have been learned with the world model that is `wanted`.
    pub fn load(parameters: &Parameters, wanted: &ModelIdentity) -> Result<Self, RewardError> {
        if SparseReward::is_in(parameters) {
            let reward = SparseReward::load(parameters)?;
            reward.require(wanted)?;
            return Ok(Self::Verdicts(reward.for_inference()));
        }
        let reward = RewardEnsemble::load(parameters)?;
        reward.require(wanted)?;
        Ok(Self::Preferences(reward.for_inference()))
    }

    /// Whether it was learned from single transitions, for which a planner looks further ahead (method §11).
    pub fn is_sparse(&self) -> bool {
        matches!(self, Self::Verdicts(_))
    }
}

impl RewardModel for LearnedReward {
    fn rewards(&self, features: &Tensor, scaled_actions: &Tensor) -> Tensor {
        match self {
            Self::Preferences(reward) => reward.rewards(features, scaled_actions),
            Self::Verdicts(reward) => reward.rewards(features, scaled_actions),
        }
    }
}
