//! Keys and pads: what a person holds becomes an [`CarAction`].
//!
//! Pure: no device is read here. `ui` says what is held, and asks for the action of each step.

use serde::{Deserialize, Serialize};

use super::CarAction;

/// The four driving keys, whatever they are bound to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum DrivingKey {
    /// Steer left.
    Left,
    /// Steer right.
    Right,
    /// Gas.
    Up,
    /// Brake.
    Down,
}

/// The stick that steers, sideways.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum SteerAxis {
    /// The left one.
    #[default]
    LeftStick,
    /// The right one.
    RightStick,
}

impl SteerAxis {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::LeftStick, Self::RightStick];

    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Self::LeftStick => "left stick",
            Self::RightStick => "right stick",
        }
    }
}

/// What gives gas or brakes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum PedalAxis {
    /// The left trigger.
    LeftTrigger,
    /// The right trigger.
    RightTrigger,
    /// The left stick, pushed away.
    LeftUp,
    /// The left stick, pulled near.
    LeftDown,
    /// The right stick, pushed away.
    RightUp,
    /// The right stick, pulled near.
    RightDown,
}

impl PedalAxis {
    /// All of them.
    pub const ALL: [Self; 6] =
        [Self::RightTrigger, Self::LeftTrigger, Self::RightUp, Self::RightDown, Self::LeftUp, Self::LeftDown];

    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Self::LeftTrigger => "left trigger",
            Self::RightTrigger => "right trigger",
            Self::LeftUp => "left stick up",
            Self::LeftDown => "left stick down",
            Self::RightUp => "right stick up",
            Self::RightDown => "right stick down",
        }
    }
}

/// How much a held key gives, and how a pad answers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ControlConfig {
    /// Steering of ← and →, in `[0, 1]`. The authors' recorder: 1.
    pub key_steer: f32,
    /// Throttle of ↑, in `[0, 1]`. The authors' recorder: 1.
    pub key_gas: f32,
    /// Brake of ↓, in `[0, 1]`. The authors' recorder: 0.8, just less than what locks the wheels.
    pub key_brake: f32,
    /// How far a stick or trigger moves before it counts, in `[0, 0.9]`. Beyond it the range begins again at 0.
    pub dead_zone: f32,
    /// The exponent of a stick or trigger beyond its dead zone, in `[1, 3]`. 1 is straight.
    pub curve: f32,
    /// What steers.
    pub steer_by: SteerAxis,
    /// What gives gas.
    pub gas_by: PedalAxis,
    /// What brakes.
    pub brake_by: PedalAxis,
}

impl ControlConfig {
    /// The keys of the authors' recorder (method §5), and a dead zone for worn sticks.
    pub fn paper() -> Self {
        Self {
            key_steer: 1.0,
            key_gas: 1.0,
            key_brake: 0.8,
            dead_zone: 0.1,
            curve: 1.0,
            steer_by: SteerAxis::LeftStick,
            gas_by: PedalAxis::RightTrigger,
            brake_by: PedalAxis::LeftTrigger,
        }
    }

    /// The same with every value moved into its range, and values that are no number into the paper's.
    #[must_use]
    pub fn clamped(self) -> Self {
        let paper = Self::paper();
        Self {
            key_steer: within(self.key_steer, 1.0, paper.key_steer),
            key_gas: within(self.key_gas, 1.0, paper.key_gas),
            key_brake: within(self.key_brake, 1.0, paper.key_brake),
            dead_zone: within(self.dead_zone, 0.9, paper.dead_zone),
            curve: within(self.curve, 3.0, paper.curve).max(1.0),
            ..self
        }
    }

    /// The same with every key giving half: for slow and careful driving.
    #[must_use]
    pub fn halved(self) -> Self {
        Self {
            key_steer: self.key_steer / 2.0,
            key_gas: self.key_gas / 2.0,
            key_brake: self.key_brake / 2.0,
            ..self
        }
    }
}

impl Default for ControlConfig {
    fn default() -> Self {
        Self::paper()
    }
}

/// Which driving keys are down.
///
/// Of ← and → the one pressed last wins. Releasing it gives back the other if that is still held.
// DIFFERENCE: in the released recorder, releasing the winner straightens the wheels although the other is still
// held (method §5). A key that is held should count, so here it does again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[expect(clippy::struct_excessive_bools, reason = "four keys, each up or down")]
pub struct HeldKeys {
    left: bool,
    right: bool,
    up: bool,
    down: bool,
    /// Whether → was pressed after ←.
    right_is_newer: bool,
}

impl HeldKeys {
    /// Notes that a key is down or up. Saying so again, as repeating keys do, changes nothing.
    pub fn set(&mut self, key: DrivingKey, is_down: bool) {
        match key {
            DrivingKey::Left => {
                if is_down && !self.left {
                    self.right_is_newer = false;
                }
                self.left = is_down;
            }
            DrivingKey::Right => {
                if is_down && !self.right {
                    self.right_is_newer = true;
                }
                self.right = is_down;
            }
            DrivingKey::Up => self.up = is_down,
            DrivingKey::Down => self.down = is_down,
        }
    }

    /// Lets go of every key, as when the window loses its focus.
    pub fn release_all(&mut self) {
        *self = Self::default();
    }

    /// Whether any key is down.
    pub fn any(&self) -> bool {
        self.left || self.right || self.up || self.down
    }

    /// What the keys say.
    pub fn action(&self, config: &ControlConfig) -> CarAction {
        let config = config.clamped();
        let side = match (self.left, self.right) {
            (true, true) if self.right_is_newer => 1.0,
            (true, _) => -1.0,
            (false, true) => 1.0,
            (false, false) => 0.0,
        };
        let held = |key: bool, value: f32| if key { value } else { 0.0 };
        CarAction::new(
            side * config.key_steer,
            held(self.up, config.key_gas),
            held(self.down, config.key_brake),
        )
    }
}

/// A gamepad as it is read, before the dead zone.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pad {
    /// Left stick, sideways, in `[-1, 1]`. Positive is right.
    pub stick: f32,
    /// Right trigger, in `[0, 1]`.
    pub right_trigger: f32,
    /// Left trigger, in `[0, 1]`.
    pub left_trigger: f32,
    /// Left stick, away from the hand, in `[-1, 1]`.
    pub left_y: f32,
    /// Right stick, sideways, in `[-1, 1]`. Positive is right.
    pub right_x: f32,
    /// Right stick, away from the hand, in `[-1, 1]`.
    pub right_y: f32,
}

impl Pad {
    /// What the pad says, by the axes that `config` names.
    pub fn action(&self, config: &ControlConfig) -> CarAction {
        let ControlConfig { dead_zone, curve, .. } = config.clamped();
        let beyond = |value: f32| {
            if value.is_nan() {
                return 0.0;
            }
            let distance = ((value.abs().min(1.0) - dead_zone) / (1.0 - dead_zone)).max(0.0).powf(curve);
            if value < 0.0 { -distance } else { distance }
        };
        let steer = match config.steer_by {
            SteerAxis::LeftStick => self.stick,
            SteerAxis::RightStick => self.right_x,
        };
        let pedal = |axis| match axis {
            PedalAxis::LeftTrigger => self.left_trigger,
            PedalAxis::RightTrigger => self.right_trigger,
            PedalAxis::LeftUp => self.left_y.max(0.0),
            PedalAxis::LeftDown => (-self.left_y).max(0.0),
            PedalAxis::RightUp => self.right_y.max(0.0),
            PedalAxis::RightDown => (-self.right_y).max(0.0),
        };
        CarAction::new(beyond(steer), beyond(pedal(config.gas_by)), beyond(pedal(config.brake_by)))
    }
}

/// What a person at keys and pad at once says: each control from where it is moved most, the keys on a tie.
pub fn combined(keys: &HeldKeys, pad: &Pad, config: &ControlConfig) -> CarAction {
    let (keys, pad) = (keys.action(config), pad.action(config));
    let stronger = |key: f32, pad: f32| if pad.abs() > key.abs() { pad } else { key };
    CarAction::new(
        stronger(keys.steer, pad.steer),
        stronger(keys.gas, pad.gas),
        stronger(keys.brake, pad.brake),
    )
}

/// `value` in `[0, high]`, or `otherwise` where it is no number.
fn within(value: f32, high: f32, otherwise: f32) -> f32 {
    if value.is_nan() { otherwise } else { value.clamp(0.0, high) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn holding(keys: &[DrivingKey]) -> HeldKeys {
        let mut held = HeldKeys::default();
        for &key in keys {
            held.set(key, true);
        }
        held
    }

    #[test]
    fn keys_give_what_the_recorder_of_the_paper_gave() {
        let held = holding(&[DrivingKey::Left, DrivingKey::Up, DrivingKey::Down]);

        assert_eq!(held.action(&ControlConfig::paper()), CarAction::new(-1.0, 1.0, 0.8));
    }

    #[test]
    fn nothing_held_is_no_action() {
        let config = ControlConfig::paper();

        assert_eq!(combined(&HeldKeys::default(), &Pad::default(), &config), CarAction::default());
    }

    #[test]
    fn of_opposite_keys_the_last_wins_and_its_release_gives_back_the_other() {
        let config = ControlConfig::paper();
        let mut held = holding(&[DrivingKey::Left, DrivingKey::Right]);
        assert_eq!(held.action(&config).steer, 1.0);

        held.set(DrivingKey::Right, false);
        assert_eq!(held.action(&config).steer, -1.0);

        held.set(DrivingKey::Left, false);
        assert_eq!(held.action(&config).steer, 0.0);
    }

    #[test]
    fn a_repeating_key_is_not_a_newer_one() {
        let mut held = holding(&[DrivingKey::Left, DrivingKey::Right]);

        held.set(DrivingKey::Left, true);

        assert_eq!(held.action(&ControlConfig::paper()).steer, 1.0);
    }

    #[test]
    fn letting_go_of_everything_stops_everything() {
        let mut held = holding(&[DrivingKey::Right, DrivingKey::Up]);

        held.release_all();

        assert!(!held.any());
        assert_eq!(held.action(&ControlConfig::paper()), CarAction::default());
    }

    #[test]
    fn the_strength_of_keys_can_be_set_within_its_range() {
        let config = ControlConfig { key_gas: 0.25, key_brake: 7.0, ..ControlConfig::paper() };
        let held = holding(&[DrivingKey::Up, DrivingKey::Down]);

        assert_eq!(held.action(&config), CarAction::new(0.0, 0.25, 1.0));
    }

    #[test]
    fn a_stick_is_dead_in_the_middle_and_whole_at_the_end() {
        let config = ControlConfig { dead_zone: 0.2, ..ControlConfig::paper() };
        let steer = |stick| Pad { stick, ..Pad::default() }.action(&config).steer;

        assert_eq!([steer(0.2), steer(-0.1), steer(1.0), steer(-1.0)], [0.0, 0.0, 1.0, -1.0]);
        assert!((steer(-0.6) + 0.5).abs() < 1e-6, "half way beyond the dead zone is half");
    }

    #[test]
    fn triggers_give_gas_and_brake_and_never_less_than_none() {
        let pad = Pad { stick: f32::NAN, right_trigger: 1.0, left_trigger: -1.0, ..Pad::default() };

        assert_eq!(pad.action(&ControlConfig::paper()), CarAction::new(0.0, 1.0, 0.0));
    }

    #[test]
    fn a_curve_is_gentle_in_the_middle_and_whole_at_the_end() {
        let config = ControlConfig { dead_zone: 0.0, curve: 2.0, ..ControlConfig::paper() };
        let steer = |stick| Pad { stick, ..Pad::default() }.action(&config).steer;

        assert_eq!([steer(0.5), steer(-0.5), steer(1.0)], [0.25, -0.25, 1.0]);
    }

    #[test]
    fn other_axes_can_steer_and_give_gas() {
        let config = ControlConfig {
            dead_zone: 0.0,
            steer_by: SteerAxis::RightStick,
            gas_by: PedalAxis::LeftUp,
            brake_by: PedalAxis::LeftDown,
            ..ControlConfig::paper()
        };
        let pad = Pad { stick: 1.0, right_trigger: 1.0, left_y: -0.5, right_x: -0.25, ..Pad::default() };

        assert_eq!(pad.action(&config), CarAction::new(-0.25, 0.0, 0.5));
    }

    #[test]
    fn keys_and_pad_combine_control_by_control() {
        let pad = Pad { stick: 0.55, right_trigger: 0.55, ..Pad::default() };

        let action = combined(&holding(&[DrivingKey::Left]), &pad, &ControlConfig::paper());

        assert_eq!(action.steer, -1.0);
        assert!((action.gas - 0.5).abs() < 1e-6, "gas comes from the pad");
    }

    #[test]
    fn a_setting_that_is_no_number_falls_back_to_the_paper() {
        let config = ControlConfig {
            key_gas: f32::NAN,
            dead_zone: f32::NAN,
            curve: f32::NAN,
            ..ControlConfig::paper()
        };

        assert_eq!(config.clamped(), ControlConfig::paper());
    }
}
