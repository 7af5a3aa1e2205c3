//! From what a driver wants of the car to an action: by keys, by a stick, or from the planner's menu.

use rand::{Rng, RngExt as _};

use crate::world::cars::CarAction;

/// The most that the front wheels turn, in radians. Steering beyond it does nothing more.
pub(super) const LOCK: f32 = 0.4;
/// The brake of the authors' menu (method §11): harder than our planner's, so that dreams know both.
const MENU_BRAKE: f32 = 0.2;
/// The longest that an action of the menu is held, in steps: the authors' horizon.
const MENU_HOLD: u32 = 15;

/// What the driver wants of the car.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Setpoint {
    /// Angle of the front wheels in radians, in `[-LOCK, LOCK]`. Positive is right.
    pub(super) wheels: f32,
    /// Gas where positive, brake where negative, in `[-1, 1]`.
    pub(super) throttle: f32,
}

/// What the controls are worked with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum InputKind {
    /// All or nothing, held longer for a stronger setpoint.
    Keys,
    /// As much as the setpoint says.
    Stick,
    /// The actions that the planner chooses from, each held for a while.
    Menu,
}

/// Turns setpoints into actions, step by step.
#[derive(Clone, Debug)]
pub(super) struct Actuator {
    input: InputKind,
    steering: Tap,
    pedals: Tap,
    /// The action being held, and for how many more steps.
    held: (CarAction, u32),
    /// How far a stick is pushed beyond what turns the wheels, at least 1.
    stick_gain: f32,
    /// The probability that an action of the menu is a random one, in `[0, 1]`.
    random_share: f64,
}

impl Actuator {
    /// An actuator with this input, whose habits differ a little each time.
    pub(super) fn new(input: InputKind, rng: &mut impl Rng) -> Self {
        Self {
            input,
            steering: Tap::new(rng.random_range(3..=9)),
            pedals: Tap::new(rng.random_range(4..=12)),
            held: (CarAction::default(), 0),
            stick_gain: rng.random_range(1.0..2.5),
            random_share: rng.random_range(0.0..0.1),
        }
    }

    /// The action of this step.
    pub(super) fn act(&mut self, setpoint: Setpoint, rng: &mut impl Rng) -> CarAction {
        match self.input {
            InputKind::Keys => self.keys(setpoint),
            InputKind::Stick => self.hold(|actuator, rng| actuator.stick(setpoint, rng), rng),
            InputKind::Menu => self.hold(|actuator, rng| actuator.menu(setpoint, rng), rng),
        }
    }

    /// Keys are tapped: the stronger the setpoint, the longer.
    fn keys(&mut self, setpoint: Setpoint) -> CarAction {
        let steer = self.steering.press(setpoint.wheels / LOCK);
        let pedal = self.pedals.press(setpoint.throttle);
        CarAction::new(steer, pedal.max(0.0), 0.8 * (-pedal).max(0.0))
    }

    /// The action being held, or a new one where that has been held for its time.
    fn hold<R: Rng>(&mut self, choose: impl Fn(&Self, &mut R) -> (CarAction, u32), rng: &mut R) -> CarAction {
        if self.held.1 == 0 {
            self.held = choose(self, rng);
        }
        self.held.1 -= 1;
        self.held.0
    }

    /// A stick follows the setpoint, with a tremor, and rests between its moves.
    fn stick(&self, setpoint: Setpoint, rng: &mut impl Rng) -> (CarAction, u32) {
        let tremor = rng.random_range(-0.05..0.05);
        let action = CarAction::new(
            setpoint.wheels * self.stick_gain + tremor,
            setpoint.throttle.max(0.0),
            (-setpoint.throttle).max(0.0),
        );
        (action, rng.random_range(1..=4))
    }

    /// The action of the menu that comes nearest, now and then another.
    fn menu(&self, setpoint: Setpoint, rng: &mut impl Rng) -> (CarAction, u32) {
        if rng.random_bool(self.random_share) {
            let steer = [-1.0, 0.0, 1.0][rng.random_range(0..3)];
            let gas = [0.1, 0.2][rng.random_range(0..2)];
            let brake = if rng.random_bool(0.2) { rng.random_range(0.0..=MENU_BRAKE) } else { 0.0 };
            return (CarAction::new(steer, gas, brake), rng.random_range(1..=MENU_HOLD));
        }
        let steer = if setpoint.wheels.abs() < 0.3 * LOCK { 0.0 } else { setpoint.wheels.signum() };
        let gas = if setpoint.throttle > 0.1 { 0.2 } else { 0.1 };
        let brake = if setpoint.throttle < 0.0 { rng.random_range(0.05..=MENU_BRAKE) } else { 0.0 };
        // A full turn of the wheels is held for a moment only, a longer one for a stronger setpoint.
        let longest = if steer == 0.0 { 4 } else { 1 + (4.0 * setpoint.wheels.abs() / LOCK) as u32 };
        (CarAction::new(steer, gas, brake), rng.random_range(1..=longest))
    }
}

/// A pair of opposite keys that is tapped once a period.
#[derive(Clone, Debug)]
struct Tap {
    /// Steps from tap to tap.
    period: u32,
    step: u32,
    /// Which key is tapped, and for how many steps of the period.
    side: f32,
    length: u32,
}

impl Tap {
    fn new(period: u32) -> Self {
        Self { period, step: 0, side: 0.0, length: 0 }
    }

    /// Which key is down in this step: −1, 0 or 1. `strength` is in `[-1, 1]`.
    fn press(&mut self, strength: f32) -> f32 {
        if self.step == 0 {
            self.side = strength.signum();
            self.length = (strength.abs().min(1.0) * self.period as f32).round() as u32;
        }
        let is_down = self.step < self.length;
        self.step = (self.step + 1) % self.period;
        if is_down { self.side } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn actions(input: InputKind, setpoint: Setpoint) -> Vec<CarAction> {
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let mut actuator = Actuator::new(input, rng);
        (0..300).map(|_| actuator.act(setpoint, rng)).collect()
    }

    #[test]
    fn keys_are_down_or_up_and_down_longer_for_a_stronger_setpoint() {
        let steered = |wheels| {
            let actions = actions(InputKind::Keys, Setpoint { wheels, throttle: 0.5 });
            assert!(actions.iter().all(|a| [0.0, 1.0].contains(&a.steer) && [0.0, 1.0].contains(&a.gas)));
            actions.iter().filter(|a| a.steer == 1.0).count()
        };

        assert!(steered(0.3) > steered(0.1), "a stronger setpoint");
        assert_eq!(steered(0.0), 0, "no setpoint");
    }

    #[test]
    fn the_menu_has_the_actions_of_the_planner_only() {
        for action in actions(InputKind::Menu, Setpoint { wheels: -0.3, throttle: -0.5 }) {
            assert!([-1.0, 0.0, 1.0].contains(&action.steer), "{action:?}");
            assert!([0.1, 0.2].contains(&action.gas), "{action:?}");
            assert!((0.0..=MENU_BRAKE).contains(&action.brake), "{action:?}");
        }
    }

    #[test]
    fn a_stick_takes_values_in_between() {
        let actions = actions(InputKind::Stick, Setpoint { wheels: 0.1, throttle: -0.25 });

        assert!(actions.iter().all(|a| a.steer > 0.0 && a.steer < 0.5 && a.gas == 0.0 && a.brake == 0.25));
    }
}
