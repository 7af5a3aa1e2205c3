//! Keys and pads: what a person holds becomes an [`Action`] of any world's axes.
//!
//! Pure: no device is read here. `ui` says what is held, and asks for the action of each step.
//!
//! - A held key moves its axis to its value, at once or with the axis's `key_speed`. Of several keys of an axis the one
//!   pressed last counts, and letting it go gives back the one before it. Let go, an axis springs back to its neutral
//!   value at once, or stays where it is.
//! - A stick or trigger moves its axis from the neutral value at rest to its value at the far end.
//! - Of keys and pad the one that moves the axis further counts, and the keys where both move it as far.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::{Action, Axis, KEYS, PadAxis, Release, WorldSpec};

/// What of a gamepad can move an axis: a whole stick to both its ends, both triggers, or one direction alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[expect(missing_docs, reason = "each is called as its name says")]
pub enum Lever {
    LeftStickSideways,
    LeftStickUpright,
    RightStickSideways,
    RightStickUpright,
    Triggers,
    LeftTrigger,
    RightTrigger,
    LeftStickLeft,
    LeftStickRight,
    LeftStickUp,
    LeftStickDown,
    RightStickLeft,
    RightStickRight,
    RightStickUp,
    RightStickDown,
}

impl Lever {
    /// Those that move an axis to both its ends.
    pub const WHOLE: [Self; 5] = [
        Self::LeftStickSideways,
        Self::LeftStickUpright,
        Self::RightStickSideways,
        Self::RightStickUpright,
        Self::Triggers,
    ];

    /// Those that move an axis to one end.
    pub const HALF: [Self; 10] = [
        Self::RightTrigger,
        Self::LeftTrigger,
        Self::RightStickUp,
        Self::RightStickDown,
        Self::RightStickLeft,
        Self::RightStickRight,
        Self::LeftStickUp,
        Self::LeftStickDown,
        Self::LeftStickLeft,
        Self::LeftStickRight,
    ];

    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Self::LeftStickSideways => "left stick",
            Self::LeftStickUpright => "left stick, up and down",
            Self::RightStickSideways => "right stick",
            Self::RightStickUpright => "right stick, up and down",
            Self::Triggers => "both triggers",
            Self::LeftTrigger => "left trigger",
            Self::RightTrigger => "right trigger",
            Self::LeftStickLeft => "left stick to the left",
            Self::LeftStickRight => "left stick to the right",
            Self::LeftStickUp => "left stick up",
            Self::LeftStickDown => "left stick down",
            Self::RightStickLeft => "right stick to the left",
            Self::RightStickRight => "right stick to the right",
            Self::RightStickUp => "right stick up",
            Self::RightStickDown => "right stick down",
        }
    }

    /// Its directions: the one towards the lower end of an axis and the one towards the upper end; or the only one.
    fn directions(self) -> (Option<PadAxis>, PadAxis) {
        match self {
            Self::LeftStickSideways => (Some(PadAxis::LeftStickLeft), PadAxis::LeftStickRight),
            Self::LeftStickUpright => (Some(PadAxis::LeftStickDown), PadAxis::LeftStickUp),
            Self::RightStickSideways => (Some(PadAxis::RightStickLeft), PadAxis::RightStickRight),
            Self::RightStickUpright => (Some(PadAxis::RightStickDown), PadAxis::RightStickUp),
            Self::Triggers => (Some(PadAxis::LeftTrigger), PadAxis::RightTrigger),
            Self::LeftTrigger => (None, PadAxis::LeftTrigger),
            Self::RightTrigger => (None, PadAxis::RightTrigger),
            Self::LeftStickLeft => (None, PadAxis::LeftStickLeft),
            Self::LeftStickRight => (None, PadAxis::LeftStickRight),
            Self::LeftStickUp => (None, PadAxis::LeftStickUp),
            Self::LeftStickDown => (None, PadAxis::LeftStickDown),
            Self::RightStickLeft => (None, PadAxis::RightStickLeft),
            Self::RightStickRight => (None, PadAxis::RightStickRight),
            Self::RightStickUp => (None, PadAxis::RightStickUp),
            Self::RightStickDown => (None, PadAxis::RightStickDown),
        }
    }
}

/// What a person wants of an axis, where that is not as its world's file says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct AxisControls {
    /// How far its keys move it, as a share of the way from its neutral value to its end, in `[0, 1]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub keys: Option<f32>,
    /// What of a pad moves it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pad: Option<Lever>,
}

/// How far held keys move each axis, and how a pad answers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ControlConfig {
    /// How far a stick or trigger moves before it counts, in `[0, 0.9]`. Beyond it the range begins again at 0.
    pub dead_zone: f32,
    /// The exponent of a stick or trigger beyond its dead zone, in `[1, 3]`. 1 is straight.
    pub curve: f32,
    /// What is wanted of axes, by their names; of all others their worlds' files say it.
    pub axes: BTreeMap<String, AxisControls>,
}

impl Default for ControlConfig {
    /// All as the worlds' files say, and a dead zone for worn sticks.
    fn default() -> Self {
        Self { dead_zone: 0.1, curve: 1.0, axes: BTreeMap::new() }
    }
}

impl ControlConfig {
    /// The same with every value moved into its range, and values that are no number as at first.
    #[must_use]
    pub fn clamped(mut self) -> Self {
        let first = Self::default();
        self.dead_zone = within(self.dead_zone, 0.9, first.dead_zone);
        self.curve = within(self.curve, 3.0, first.curve).max(1.0);
        for axis in self.axes.values_mut() {
            axis.keys = axis.keys.filter(|share| !share.is_nan()).map(|share| share.clamp(0.0, 1.0));
        }
        self.axes.retain(|_, axis| *axis != AxisControls::default());
        self
    }

    /// What is wanted of the axis of this name.
    pub fn of(&self, axis: &str) -> AxisControls {
        self.axes.get(axis).copied().unwrap_or_default()
    }

    /// Wants that of the axis of this name.
    pub fn set(&mut self, axis: &str, wanted: AxisControls) {
        if wanted == AxisControls::default() {
            self.axes.remove(axis);
        } else {
            self.axes.insert(axis.to_owned(), wanted);
        }
    }

    /// What a stick or trigger gives that is so far moved.
    pub fn beyond(&self, value: f32) -> f32 {
        if value.is_nan() {
            return 0.0;
        }
        let distance =
            ((value.abs().min(1.0) - self.dead_zone) / (1.0 - self.dead_zone)).max(0.0).powf(self.curve);
        if value < 0.0 { -distance } else { distance }
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
    /// How far it is moved in a direction, in `[0, 1]`.
    pub fn along(&self, direction: PadAxis) -> f32 {
        let value = match direction {
            PadAxis::LeftStickLeft => -self.stick,
            PadAxis::LeftStickRight => self.stick,
            PadAxis::LeftStickUp => self.left_y,
            PadAxis::LeftStickDown => -self.left_y,
            PadAxis::RightStickLeft => -self.right_x,
            PadAxis::RightStickRight => self.right_x,
            PadAxis::RightStickUp => self.right_y,
            PadAxis::RightStickDown => -self.right_y,
            PadAxis::LeftTrigger => self.left_trigger,
            PadAxis::RightTrigger => self.right_trigger,
        };
        value.max(0.0)
    }
}

/// How an axis is moved.
#[derive(Clone, Debug)]
struct Moved {
    axis: Axis,
    /// Where its keys have moved it.
    value: f32,
}

/// What is held on keys and pad, for the axes of one world.
#[derive(Clone, Debug)]
pub struct Controls {
    axes: Vec<Moved>,
    /// The keys that are down, in the order of pressing.
    held: Vec<&'static str>,
    pad: Pad,
}

impl Controls {
    /// Nothing is held, and every axis is neutral.
    pub fn new(spec: &WorldSpec) -> Self {
        let moved = |axis: &Axis| Moved { axis: axis.clone(), value: axis.neutral };
        Self { axes: spec.axes.iter().map(moved).collect(), held: Vec::new(), pad: Pad::default() }
    }

    /// Notes that a key, one of [`KEYS`], is down or up. Saying so again, as repeating keys do, changes nothing.
    pub fn set(&mut self, key: &str, is_down: bool) {
        let Some(key) = KEYS.into_iter().find(|known| *known == key) else { return };
        if !is_down {
            self.held.retain(|held| *held != key);
        } else if !self.held.contains(&key) {
            self.held.push(key);
        }
    }

    /// Lets go of every key, as when the window loses its focus: what stays stays where it is.
    pub fn release_keys(&mut self) {
        self.held.clear();
    }

    /// Lets go of everything, and moves every axis back to its neutral value: another episode begins.
    pub fn reset(&mut self) {
        self.held.clear();
        self.pad = Pad::default();
        self.axes.iter_mut().for_each(|moved| moved.value = moved.axis.neutral);
    }

    /// Whether any key is down.
    pub fn any(&self) -> bool {
        !self.held.is_empty()
    }

    /// Where the pad's sticks and triggers are.
    pub fn pad(&self) -> Pad {
        self.pad
    }

    /// Takes in where a pad's sticks and triggers are.
    pub fn hold(&mut self, pad: Pad) {
        self.pad = pad;
    }

    /// The action after `dt` more seconds; keys move half as far where `is_careful`, or half as fast where what they move
    /// stays.
    pub fn step(&mut self, dt: f32, is_careful: bool, config: &ControlConfig) -> Action {
        let config = config.clone().clamped();
        let mut action = Action::new(vec![0.0; self.axes.len()]);
        for (moved, value) in self.axes.iter_mut().zip(action.iter_mut()) {
            let wanted = config.of(&moved.axis.name);
            moved.step(dt, &self.held, is_careful, wanted.keys);
            let (keys, pad) = (moved.value, by_pad(&moved.axis, &self.pad, wanted.pad, &config));
            let neutral = moved.axis.neutral;
            *value = if (pad - neutral).abs() > (keys - neutral).abs() { pad } else { keys };
        }
        action
    }

    /// What happens where nobody holds anything: what stays stays, and all else is neutral.
    pub fn idle(&self) -> Action {
        let mut action = Action::new(vec![0.0; self.axes.len()]);
        for (moved, value) in self.axes.iter().zip(action.iter_mut()) {
            let stays = moved.axis.release == Release::Stay;
            *value = if stays { moved.value } else { moved.axis.neutral };
        }
        action
    }
}

impl Moved {
    fn step(&mut self, dt: f32, held: &[&str], is_careful: bool, strength: Option<f32>) {
        let axis = &self.axis;
        let input = held.iter().rev().find_map(|key| axis.keys.iter().find(|input| input.key == *key));
        let Some(input) = input else {
            if axis.release == Release::Spring {
                self.value = axis.neutral;
            }
            return;
        };
        let full = strength.map_or(input.to, |share| strengthened(axis, input.to, share));
        let is_slow = is_careful && axis.release == Release::Stay && axis.key_speed.is_some();
        let to = if is_careful && !is_slow { axis.neutral + (full - axis.neutral) / 2.0 } else { full };
        self.value = match axis.key_speed {
            None => to,
            Some(speed) => {
                let reach = speed * dt.max(0.0) * if is_slow { 0.5 } else { 1.0 };
                // Written so that it lands on `to` and nowhere beside it.
                if (to - self.value).abs() <= reach {
                    to
                } else {
                    self.value + reach.copysign(to - self.value)
                }
            }
        };
    }
}

/// How far the keys of an axis move it as its world's file says, as a share of the way from neutral to an end.
///
/// Of several that share is the largest one. 1 where no key moves it.
pub fn key_share(axis: &Axis) -> f32 {
    let shares = axis.keys.iter().filter_map(|input| share_of(axis, input.to));
    shares.reduce(f32::max).filter(|share| *share > 0.0).unwrap_or(1.0)
}

/// The way from neutral to `to`, as a share of that to the end.
fn share_of(axis: &Axis, to: f32) -> Option<f32> {
    let end = if to < axis.neutral { axis.low } else { axis.high };
    let whole = end - axis.neutral;
    (whole != 0.0).then(|| (to - axis.neutral) / whole)
}

/// Where a key moves an axis whose keys move it by `share` of the way at the most.
fn strengthened(axis: &Axis, to: f32, share: f32) -> f32 {
    let Some(own) = share_of(axis, to) else { return to };
    let end = if to < axis.neutral { axis.low } else { axis.high };
    // Exactly 1 where all keys of an axis move it as far.
    let part = own / key_share(axis);
    axis.neutral + (end - axis.neutral) * (share * part)
}

/// What of a pad moves an axis as its world's file says, if that has a name.
pub fn lever_of(axis: &Axis) -> Option<Lever> {
    let to = |direction: PadAxis| axis.pad.iter().find(|input| input.axis == direction).map(|it| it.to);
    let is_of = |lever: &Lever| match lever.directions() {
        (Some(down), up) => axis.pad.len() == 2 && to(down) == Some(axis.low) && to(up) == Some(axis.high),
        (None, only) => axis.pad.len() == 1 && to(only) == Some(far_end(axis)),
    };
    Lever::WHOLE.into_iter().chain(Lever::HALF).find(is_of)
}

/// The levers that a person can choose from for an axis.
pub fn levers_for(axis: &Axis) -> &'static [Lever] {
    if is_two_sided(axis) { &Lever::WHOLE } else { &Lever::HALF }
}

/// Whether an axis can be moved to either side of its neutral value.
pub fn is_two_sided(axis: &Axis) -> bool {
    axis.low < axis.neutral && axis.neutral < axis.high
}

/// The end of an axis that is farther from its neutral value.
fn far_end(axis: &Axis) -> f32 {
    if axis.high - axis.neutral >= axis.neutral - axis.low { axis.high } else { axis.low }
}

/// Where a pad moves an axis.
fn by_pad(axis: &Axis, pad: &Pad, chosen: Option<Lever>, config: &ControlConfig) -> f32 {
    let at = |direction: PadAxis, to: f32| {
        axis.neutral + config.beyond(pad.along(direction)) * (to - axis.neutral)
    };
    let further = |one: f32, other: f32| {
        if (other - axis.neutral).abs() > (one - axis.neutral).abs() { other } else { one }
    };
    match chosen.map(Lever::directions) {
        None => axis.pad.iter().map(|input| at(input.axis, input.to)).fold(axis.neutral, further),
        Some((Some(down), up)) => further(at(down, axis.low), at(up, axis.high)),
        Some((None, only)) => at(only, far_end(axis)),
    }
}

/// `value` in `[0, high]`, or `otherwise` where it is no number.
fn within(value: f32, high: f32, otherwise: f32) -> f32 {
    if value.is_nan() { otherwise } else { value.clamp(0.0, high) }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::world::cars::controls as old;

    fn cars() -> WorldSpec {
        WorldSpec::default()
    }

    /// A world with the axes of `text`, in TOML.
    fn world(text: &str) -> WorldSpec {
        let head = "format = 1\nname = \"arm\"\ntitle = \"An arm\"\nrate = 20\nlongest_episode = 400\n\
            source = { kind = \"recordings\" }\nimage = { height = 60, width = 80 }\n";
        WorldSpec::from_toml(&format!("{head}{text}"), std::path::Path::new("arm.toml")).unwrap()
    }

    fn stepped(controls: &mut Controls, dt: f32) -> Vec<f32> {
        controls.step(dt, false, &ControlConfig::default()).to_vec()
    }

    #[test]
    fn keys_give_what_the_recorder_of_the_paper_gave() {
        let mut controls = Controls::new(&cars());
        for key in ["Left", "W", "Down"] {
            controls.set(key, true);
        }
        assert_eq!(stepped(&mut controls, 0.02), [-1.0, 1.0, 0.8]);
        controls.release_keys();
        assert!(!controls.any());
        assert_eq!(stepped(&mut controls, 0.02), [0.0; 3]);
    }

    #[test]
    fn of_opposite_keys_the_last_wins_and_its_release_gives_back_the_other() {
        let mut controls = Controls::new(&cars());
        let mut steer = |key: &str, is_down: bool| {
            controls.set(key, is_down);
            stepped(&mut controls, 0.02)[0]
        };
        assert_eq!((steer("A", true), steer("Right", true)), (-1.0, 1.0));
        assert_eq!(steer("A", true), 1.0, "a repeating key is not a newer one");
        assert_eq!((steer("Right", false), steer("A", false)), (-1.0, 0.0));
        assert_eq!((steer("A", true), steer("Left", true), steer("A", false)), (-1.0, -1.0, -1.0));
    }

    #[test]
    fn keys_with_a_speed_move_by_and_by_and_stay_or_spring_back() {
        let spec = world(
            "[[axes]]\nname = \"reach\"\nlow = 0.0\nhigh = 512.0\nneutral = 256.0\nkey_speed = 100.0\nrelease = \"stay\"\n\
             keys = [{ key = \"Left\", to = 0.0 }, { key = \"Right\", to = 512.0 }]\n\
             [[axes]]\nname = \"grip\"\nlow = 0.0\nhigh = 1.0\nneutral = 0.0\nkey_speed = 2.0\n\
             keys = [{ key = \"Space\", to = 1.0 }]\n",
        );
        let mut controls = Controls::new(&spec);
        for key in ["Right", "Space"] {
            controls.set(key, true);
        }
        assert_eq!(stepped(&mut controls, 0.1), [266.0, 0.2]);
        assert_eq!(
            controls.step(0.1, true, &ControlConfig::default()).to_vec(),
            [271.0, 0.4],
            "half as fast"
        );
        assert_eq!(stepped(&mut controls, 10.0), [512.0, 1.0], "and no further than it goes");
        controls.release_keys();
        assert_eq!(*controls.idle(), [512.0, 0.0]);
        assert_eq!(stepped(&mut controls, 0.1), [512.0, 0.0]);
        controls.reset();
        assert_eq!(stepped(&mut controls, 0.1), [256.0, 0.0]);
    }

    #[test]
    fn an_axis_that_rests_at_an_end_is_moved_from_there() {
        let spec = world(
            "[[axes]]\nname = \"lift\"\nlow = -2.0\nhigh = 3.0\nneutral = 3.0\nkeys = [{ key = \"Q\", to = 1.0 }]\n\
             pad = [{ axis = \"right-stick-down\", to = -2.0 }]\n",
        );
        let mut controls = Controls::new(&spec);
        assert_eq!(lever_of(&spec.axes[0]), Some(Lever::RightStickDown));
        controls.hold(Pad { right_y: -1.0, ..Pad::default() });
        assert_eq!(stepped(&mut controls, 0.1), [-2.0]);
        controls.set("Q", true);
        controls.hold(Pad::default());
        assert_eq!(stepped(&mut controls, 0.1), [1.0]);
        let mut config = ControlConfig::default();
        config.set("lift", AxisControls { keys: Some(1.0), pad: Some(Lever::LeftTrigger) });
        assert_eq!(controls.step(0.1, false, &config).to_vec(), [-2.0]);
    }

    #[test]
    fn what_cannot_be_set_is_moved_into_its_range() {
        let mut config = ControlConfig { dead_zone: f32::NAN, curve: 9.0, ..ControlConfig::default() };
        config.axes.insert("gas".to_owned(), AxisControls { keys: Some(f32::NAN), pad: None });
        config.axes.insert("brake".to_owned(), AxisControls { keys: Some(7.0), pad: None });
        let config = config.clamped();
        assert_eq!((config.dead_zone, config.curve), (0.1, 3.0));
        assert_eq!((config.of("gas").keys, config.of("brake").keys), (None, Some(1.0)));
    }

    #[test]
    fn levers_of_the_cars_have_names() {
        let levers: Vec<_> = cars().axes.iter().map(lever_of).collect();
        let named = [Lever::LeftStickSideways, Lever::RightTrigger, Lever::LeftTrigger].map(Some);
        assert_eq!(levers, named);
        let shares: Vec<_> = cars().axes.iter().map(key_share).collect();
        assert_eq!(shares, [1.0, 1.0, 0.8]);
    }

    fn values() -> impl Strategy<Value = f32> {
        prop_oneof![
            8 => -1.2f32..1.2,
            1 => Just(f32::NAN),
            1 => prop::sample::select(vec![0.0, 1.0, -1.0, 0.1, -0.1])
        ]
    }

    fn settings() -> impl Strategy<Value = old::ControlConfig> {
        let pedal = || prop::sample::select(old::PedalAxis::ALL.to_vec());
        let steer = prop::sample::select(old::SteerAxis::ALL.to_vec());
        let strength = || prop_oneof![0f32..=1.0, Just(1.0), Just(0.8)];
        let numbers = (strength(), strength(), strength(), 0f32..=0.9, 1f32..=3.0);
        (numbers, steer, pedal(), pedal()).prop_map(|(numbers, steer_by, gas_by, brake_by)| {
            let (key_steer, key_gas, key_brake, dead_zone, curve) = numbers;
            old::ControlConfig { key_steer, key_gas, key_brake, dead_zone, curve, steer_by, gas_by, brake_by }
        })
    }

    /// The same wishes as the old settings said them.
    fn wished(config: &old::ControlConfig) -> ControlConfig {
        let mut all =
            ControlConfig { dead_zone: config.dead_zone, curve: config.curve, ..ControlConfig::default() };
        let steer = match config.steer_by {
            old::SteerAxis::LeftStick => Lever::LeftStickSideways,
            old::SteerAxis::RightStick => Lever::RightStickSideways,
        };
        let pedal = |axis| match axis {
            old::PedalAxis::LeftTrigger => Lever::LeftTrigger,
            old::PedalAxis::RightTrigger => Lever::RightTrigger,
            old::PedalAxis::LeftUp => Lever::LeftStickUp,
            old::PedalAxis::LeftDown => Lever::LeftStickDown,
            old::PedalAxis::RightUp => Lever::RightStickUp,
            old::PedalAxis::RightDown => Lever::RightStickDown,
        };
        for (name, keys, pad) in [
            ("steer", config.key_steer, steer),
            ("gas", config.key_gas, pedal(config.gas_by)),
            ("brake", config.key_brake, pedal(config.brake_by)),
        ] {
            all.set(name, AxisControls { keys: Some(keys), pad: Some(pad) });
        }
        all
    }

    proptest! {
        #[test]
        fn the_cars_are_driven_as_they_were(
            pressed in prop::collection::vec((0usize..4, any::<bool>()), 0..12),
            pad in prop::array::uniform6(values()),
            config in prop::option::of(settings()),
            is_careful: bool,
        ) {
            let [stick, right_trigger, left_trigger, left_y, right_x, right_y] = pad;
            let (mut now, mut before) = (Controls::new(&cars()), old::HeldKeys::default());
            let keys = [
                ("A", old::DrivingKey::Left),
                ("D", old::DrivingKey::Right),
                ("W", old::DrivingKey::Up),
                ("S", old::DrivingKey::Down),
            ];
            for (key, is_down) in pressed {
                now.set(keys[key].0, is_down);
                before.set(keys[key].1, is_down);
            }
            now.hold(Pad { stick, right_trigger, left_trigger, left_y, right_x, right_y });
            let pad = old::Pad { stick, right_trigger, left_trigger, left_y, right_x, right_y };
            let wished = config.as_ref().map_or_else(ControlConfig::default, wished);
            let config = config.unwrap_or_default();
            let config = if is_careful { config.halved() } else { config };
            let expected = old::combined(&before, &pad, &config);
            let found = now.step(0.02, is_careful, &wished);
            prop_assert_eq!(found.to_vec(), expected.to_array().to_vec());
        }
    }
}
