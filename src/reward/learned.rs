//! A reward of either kind, as it is kept in a session: learned from preferences, or from verdicts.

use tch::Tensor;

use crate::reward::{InferenceReward, RewardEnsemble, RewardError, RewardModel, SparseReward};
use crate::tensor::{Backend, Parameters};
use crate::world_model::{ModelIdentity, WorldModel};

/// What a reward was learned from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RewardKind {
    /// Pairs of clips.
    Preferences,
    /// Single transitions.
    Verdicts,
}

impl RewardKind {
    /// The kind of the reward in `parameters`, by their header. Nothing where they hold no reward.
    pub fn of(parameters: &Parameters) -> Option<Self> {
        if parameters.metadata(SparseReward::KEY).is_some() {
            Some(Self::Verdicts)
        } else {
            parameters.metadata(RewardEnsemble::KEY).map(|_| Self::Preferences)
        }
    }
}

/// The networks of a reward of either kind, whose members can be asked one by one.
#[derive(Debug)]
pub enum RewardNetworks {
    /// Learned from pairs of clips.
    Preferences(RewardEnsemble),
    /// Learned from single transitions.
    Verdicts(SparseReward),
}

impl RewardNetworks {
    /// The networks in `parameters`.
    pub fn load(parameters: &Parameters) -> Result<Self, RewardError> {
        match RewardKind::of(parameters) {
            Some(RewardKind::Verdicts) => SparseReward::load(parameters).map(Self::Verdicts),
            // What holds no reward at all is refused for its header.
            Some(RewardKind::Preferences) | None => RewardEnsemble::load(parameters).map(Self::Preferences),
        }
    }

    /// Fails where these were learned with another world model than the one that is `wanted`.
    pub fn require(&self, wanted: &ModelIdentity) -> Result<(), RewardError> {
        match self {
            Self::Preferences(reward) => reward.require(wanted),
            Self::Verdicts(reward) => reward.require(wanted),
        }
    }

    /// Those in `parameters`, which must have been learned with this model, where that is computed.
    pub fn over(parameters: &Parameters, model: &WorldModel) -> Result<Self, RewardError> {
        let networks = Self::load(parameters)?;
        networks.require(model.identity())?;
        Ok(networks.on(model.backend()))
    }

    /// The same networks, computed by `backend`.
    #[must_use]
    fn on(self, backend: Backend) -> Self {
        match self {
            Self::Preferences(reward) => Self::Preferences(reward.on(backend)),
            Self::Verdicts(reward) => Self::Verdicts(reward.on(backend)),
        }
    }

    /// The same reward as a planner is given it.
    pub fn for_inference(&self) -> LearnedReward {
        match self {
            Self::Preferences(reward) => LearnedReward::Preferences(reward.for_inference()),
            Self::Verdicts(reward) => LearnedReward::Verdicts(reward.for_inference()),
        }
    }
}

/// What a planner is given.
#[derive(Debug)]
pub enum LearnedReward {
    /// Learned from pairs of clips.
    Preferences(InferenceReward),
    /// Learned from single transitions.
    Verdicts(SparseReward),
}

impl LearnedReward {
    /// The reward in `parameters`, which must have been learned with this model, where that is computed.
    pub fn load(parameters: &Parameters, model: &WorldModel) -> Result<Self, RewardError> {
        Ok(RewardNetworks::over(parameters, model)?.for_inference())
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
