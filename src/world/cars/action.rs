//! What the driver of a car does.

use super::super::Action;

/// The lowest and the highest value of steer, gas and brake.
pub const RANGES: [[f32; 2]; 3] = [[-1.0, 1.0], [0.0, 1.0], [0.0, 1.0]];

/// The controls of one step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CarAction {
    /// Steering in `[-1, 1]`. Positive is right.
    pub steer: f32,
    /// Throttle in `[0, 1]`.
    pub gas: f32,
    /// Brake in `[0, 1]`. At 0.9 and above the wheels lock.
    pub brake: f32,
}

impl CarAction {
    /// How many numbers it has.
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

impl From<[f32; 3]> for CarAction {
    fn from([steer, gas, brake]: [f32; 3]) -> Self {
        Self::new(steer, gas, brake)
    }
}

impl From<CarAction> for Action {
    fn from(action: CarAction) -> Self {
        Self::new(action.to_array())
    }
}

impl From<&[f32]> for CarAction {
    /// Numbers that are missing are 0.
    fn from(values: &[f32]) -> Self {
        let value = |i: usize| values.get(i).copied().unwrap_or_default();
        Self::new(value(0), value(1), value(2))
    }
}
