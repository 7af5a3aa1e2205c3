//! What the driver does, in the two ranges that the method uses.

use serde::{Deserialize, Serialize};

/// The controls of one step, as the environment and the dynamics take them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Action {
    /// Steering in `[-1, 1]`. Positive is right.
    pub steer: f32,
    /// Throttle in `[0, 1]`.
    pub gas: f32,
    /// Brake in `[0, 1]`. At 0.9 and above the wheels lock.
    pub brake: f32,
}

impl Action {
    /// How many numbers an action has: the axis `A`.
    pub const LEN: usize = 3;

    /// An action, each component clipped into its range.
    pub fn new(steer: f32, gas: f32, brake: f32) -> Self {
        Self { steer: steer.clamp(-1.0, 1.0), gas: gas.clamp(0.0, 1.0), brake: brake.clamp(0.0, 1.0) }
    }

    /// Steer, gas and brake in this order.
    pub fn to_array(self) -> [f32; 3] {
        [self.steer, self.gas, self.brake]
    }
}

impl From<[f32; 3]> for Action {
    fn from([steer, gas, brake]: [f32; 3]) -> Self {
        Self::new(steer, gas, brake)
    }
}

/// An [`Action`] with every component moved to `[-1, 1]`, as only the preference reward takes it.
///
/// `ã = clip(2 (a − low) / (high − low) − 1, −1, 1)` with `low = [−1, 0, 0]`, `high = [1, 1, 1]` (method §5).
///
/// ```
/// use dropj::env::{Action, ScaledAction};
///
/// assert_eq!(ScaledAction::from(Action::new(0.0, 0.0, 0.0)).to_array(), [0.0, -1.0, -1.0]);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScaledAction([f32; 3]);

impl ScaledAction {
    /// Steer, gas and brake in this order, each in `[-1, 1]`.
    pub fn to_array(self) -> [f32; 3] {
        self.0
    }
}

impl From<Action> for ScaledAction {
    fn from(action: Action) -> Self {
        Self([action.steer, 2.0 * action.gas - 1.0, 2.0 * action.brake - 1.0])
    }
}
