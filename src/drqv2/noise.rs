//! Exploration noise: how large it is over time, and actions that it moves.

use serde::{Deserialize, Serialize};
use tch::Tensor;

/// An action comes no nearer to its ends than this, as published.
const MARGIN: f64 = 1e-6;

/// The standard deviation of exploration noise, which changes in a straight line and then stays.
///
/// ```
/// use dropj::drqv2::NoiseSchedule;
///
/// let noise = NoiseSchedule { from: 1.0, to: 0.1, actions: 500_000 };
/// assert_eq!([0, 250_000, 500_000, 900_000].map(|action| noise.at(action)), [1.0, 0.55, 0.1, 0.1]);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NoiseSchedule {
    /// At first, in units of actions in `[-1, 1]`.
    pub from: f64,
    /// In the end.
    pub to: f64,
    /// The number of the action from which on it stays.
    pub actions: u64,
}

impl NoiseSchedule {
    /// That at an action, numbered from 0: `(1 − m) from + m to` with `m = min(action / actions, 1)`.
    pub fn at(&self, action: u64) -> f64 {
        let share = if self.actions == 0 { 1.0 } else { (action as f64 / self.actions as f64).min(1.0) };
        (1.0 - share) * self.from + share * self.to
    }
}

/// `mean` moved by `noise` and kept within `[-1, 1]`: the truncated normal of DrQ-v2.
///
/// What is cut off has no part in the gradient: it is that of `mean`, as if nothing had been.
///
/// # Shapes
/// - `mean`, `noise`: `[B, A]`
/// - returns `[B, A]`
pub fn perturbed(mean: &Tensor, noise: &Tensor) -> Tensor {
    let free = mean + noise;
    let cut = free.detach().clamp(MARGIN - 1.0, 1.0 - MARGIN) - free.detach();
    free + cut
}
