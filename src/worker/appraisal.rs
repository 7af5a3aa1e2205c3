//! What the members of a reward say of steps that were driven: of dreams, of clips and of real episodes alike.

use tch::{Kind, Tensor};

use crate::dream::Rows;
use crate::env::Action;
use crate::reward::{RewardEnsemble, scaled_actions_tensor};
use crate::tensor::{from_slice, to_vec};

/// The reward of each step: the mean of the members, the lowest of them, and the highest.
pub(super) fn appraise(ensemble: &RewardEnsemble, features: &Rows, actions: &[Action]) -> [Vec<f32>; 3] {
    let members = member_rewards(ensemble, &features.values, actions);
    let mean = members.mean_dim(0, false, Kind::Float);
    [mean, members.amin(0, false), members.amax(0, false)].map(|row| to_vec(&row))
}

/// What each member says of each step; `features` has a row for each of `actions`.
///
/// # Shapes
/// - returns `[E, T]`
pub(super) fn member_rewards(ensemble: &RewardEnsemble, features: &[f32], actions: &[Action]) -> Tensor {
    let rows = from_slice(features, &[actions.len() as i64, -1]);
    ensemble.member_rewards(&rows, &scaled_actions_tensor(actions))
}
