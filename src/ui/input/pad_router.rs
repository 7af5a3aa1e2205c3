//! Which of several pads drives, and what its levers mean: what the system says of pads becomes [`PadEvent`]s.
//!
//! Pure: no device is read here, so that streams of signals that pads have sent can be played to it.

use crate::ui::input::{PadButton, PadEvent};
use crate::world::controls::Pad;

/// An axis, as drivers report it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PadAxis {
    /// Left stick, sideways.
    LeftX,
    /// Left stick, positive away from the hand.
    LeftY,
    /// Right stick, sideways.
    RightX,
    /// Right stick, positive away from the hand.
    RightY,
    /// Z: the left trigger of most pads, and the right stick, sideways, of others.
    LeftZ,
    /// RZ: the right trigger of most pads, and the right stick, positive near the hand, of others.
    RightZ,
}

/// One of two triggers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Side {
    Left,
    Right,
}

/// What the system says of one pad.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum PadSignal {
    /// It is plugged in.
    Connected {
        /// What it calls itself.
        name: String,
        /// Whether its right stick has axes of its own, so that Z and RZ are something else.
        has_right_stick: bool,
    },
    /// It is gone.
    Disconnected,
    /// A button went down.
    Down(PadButton),
    /// An axis is here, in `[-1, 1]`.
    Axis(PadAxis, f32),
    /// A trigger that reports as a button is so far down, in `[0, 1]`.
    Trigger(Side, f32),
}

/// How far a control is moved, and how far it has to have come, before its pad takes the wheel: far beyond any dead zone,
/// and further where another pad has it.
const TAKES: Reach = Reach { moved: 0.25, traveled: 0.15 };
const TAKES_OVER: Reach = Reach { moved: 0.5, traveled: 0.3 };
/// What a lever is first seen at, or below, that rests at −1; sticks are not flicked that far between two reports.
const RESTS_LOW: f32 = -0.75;
/// What is first seen at this, or beyond, is a switch that was pressed, and not a lever that lies so.
const IS_SWITCH: f32 = 0.95;
/// Letters of a pad's name that are shown.
const NAME_LEN: usize = 48;

/// How far something has to be moved.
#[derive(Clone, Copy, Debug)]
struct Reach {
    moved: f32,
    traveled: f32,
}

/// The pads that are plugged in, and the one that drives.
///
/// The first that is pressed or moved has the wheel, until another one is pressed or moved far. That one brings what is
/// held on it, and nothing that is held on the former counts any more.
#[derive(Debug, Default)]
pub(crate) struct PadRouter {
    pads: Vec<Known>,
    /// The id of the one that drives.
    active: Option<usize>,
    /// Whether something of it has moved that was not told yet.
    has_moved: bool,
}

/// A pad that is plugged in.
#[derive(Debug)]
struct Known {
    id: usize,
    /// What it is called here: no two are called the same.
    name: String,
    has_right_stick: bool,
    /// In the order of [`PadAxis`].
    axes: [Option<f32>; 6],
    /// What either lever was first seen at.
    first: [Option<f32>; 2],
    /// Triggers that report as buttons.
    triggers: [f32; 2],
    /// Where each control was nearest to its rest since the pad lost the wheel.
    rest: [Option<f32>; 6],
}

impl Known {
    fn new(id: usize, name: String, has_right_stick: bool) -> Self {
        Self {
            id,
            name,
            has_right_stick,
            axes: [None; 6],
            first: [None; 2],
            triggers: [0.0; 2],
            rest: [None; 6],
        }
    }

    /// What a lever gives as a trigger, in `[0, 1]`, and whether that is sure; nothing where it is a stick, or unknown.
    fn lever(&self, side: Side) -> Option<(f32, bool)> {
        let first = self.first[side as usize]?;
        let value = self.axes[PadAxis::LeftZ as usize + side as usize]?;
        if first <= RESTS_LOW {
            return Some((f32::midpoint(value, 1.0), true));
        }
        // One that rests at 0. A stick that is taken for it gives nothing while it rests.
        self.has_right_stick.then_some((value.max(0.0), false))
    }

    fn trigger(&self, side: Side) -> f32 {
        let button = self.triggers[side as usize];
        match self.lever(side) {
            // Pads that have both say by the button only that it is touched.
            Some((lever, true)) => lever,
            Some((lever, false)) => lever.max(button),
            None => button,
        }
    }

    /// Where everything is.
    fn pad(&self) -> Pad {
        let axis = |axis: PadAxis| self.axes[axis as usize].unwrap_or(0.0);
        let stick = |side: Side| self.lever(side).is_none() && !self.has_right_stick;
        let right_x = if stick(Side::Left) { axis(PadAxis::LeftZ) } else { axis(PadAxis::RightX) };
        let right_y = if stick(Side::Right) { -axis(PadAxis::RightZ) } else { axis(PadAxis::RightY) };
        Pad {
            stick: axis(PadAxis::LeftX),
            left_y: axis(PadAxis::LeftY),
            right_x,
            right_y,
            left_trigger: self.trigger(Side::Left),
            right_trigger: self.trigger(Side::Right),
        }
    }

    /// The same, one after the other.
    fn controls(&self) -> [f32; 6] {
        let Pad { stick, left_y, right_x, right_y, left_trigger, right_trigger } = self.pad();
        [stick, left_y, right_x, right_y, left_trigger, right_trigger]
    }

    /// Takes in a signal, and says whether that changes where something is.
    fn take(&mut self, signal: &PadSignal) -> bool {
        match *signal {
            // Not-a-number is no place.
            PadSignal::Axis(_, value) | PadSignal::Trigger(_, value) if !value.is_finite() => return false,
            PadSignal::Axis(axis, value) => {
                let value = value.clamp(-1.0, 1.0);
                if let Some(lever) = (axis as usize).checked_sub(PadAxis::LeftZ as usize) {
                    self.first[lever].get_or_insert(value);
                }
                self.axes[axis as usize] = Some(value);
            }
            PadSignal::Trigger(side, value) => self.triggers[side as usize] = value.clamp(0.0, 1.0),
            _ => return false,
        }
        true
    }

    /// Whether something was moved far from where it rested.
    fn reaches(&mut self, reach: Reach) -> bool {
        let mut is_far = false;
        for (value, rest) in self.controls().into_iter().zip(&mut self.rest) {
            if value == 0.0 && rest.is_none() {
                continue;
            }
            let at_first = if value.abs() >= IS_SWITCH { 0.0 } else { value };
            let rest = rest.get_or_insert(at_first);
            if value.abs() < rest.abs() {
                *rest = value;
            }
            is_far |= value.abs() >= reach.moved && (value - *rest).abs() >= reach.traveled;
        }
        is_far
    }

    /// Somebody else has the wheel: what is held here now is where it rests.
    fn lose(&mut self) {
        self.rest = self.controls().map(Some);
    }
}

impl PadRouter {
    /// Takes in what the system says of the pad `id`, and adds to `events` what that means.
    pub(crate) fn receive(&mut self, id: usize, signal: PadSignal, events: &mut Vec<PadEvent>) {
        match signal {
            PadSignal::Connected { name, has_right_stick } => {
                self.connect(id, &name, has_right_stick, events);
            }
            PadSignal::Disconnected => self.disconnect(id, events),
            PadSignal::Down(button) => {
                self.know(id, events);
                self.take_wheel(id, events);
                events.push(PadEvent::Pressed(button));
            }
            signal => {
                let has_others = self.active.is_some_and(|active| active != id);
                let reach = if has_others { TAKES_OVER } else { TAKES };
                let is_active = self.active == Some(id);
                let pad = self.know(id, events);
                if !pad.take(&signal) {
                    return;
                }
                if is_active {
                    self.has_moved = true;
                } else if pad.reaches(reach) {
                    self.take_wheel(id, events);
                }
            }
        }
    }

    /// Adds to `events` where the pad that drives is now, if it has moved since the last time.
    pub(crate) fn tell(&mut self, events: &mut Vec<PadEvent>) {
        let pad = self.pads.iter().find(|pad| Some(pad.id) == self.active);
        if std::mem::take(&mut self.has_moved)
            && let Some(pad) = pad
        {
            events.push(PadEvent::Moved(pad.pad()));
        }
    }

    fn connect(&mut self, id: usize, name: &str, has_right_stick: bool, events: &mut Vec<PadEvent>) {
        if self.pads.iter().any(|pad| pad.id == id) {
            return;
        }
        let name: String = name.chars().filter(|letter| !letter.is_control()).take(NAME_LEN).collect();
        let name = if name.trim().is_empty() { "Gamepad" } else { name.trim() };
        let (mut unlike, mut n) = (name.to_owned(), 1);
        while self.pads.iter().any(|pad| pad.name == unlike) {
            n += 1;
            unlike = format!("{name} ({n})");
        }
        let name = unlike;
        events.push(PadEvent::Connected(name.clone()));
        self.pads.push(Known::new(id, name, has_right_stick));
    }

    fn disconnect(&mut self, id: usize, events: &mut Vec<PadEvent>) {
        let Some(idx) = self.pads.iter().position(|pad| pad.id == id) else { return };
        if self.active == Some(id) {
            (self.active, self.has_moved) = (None, false);
            events.push(PadEvent::Moved(Pad::default()));
        }
        events.push(PadEvent::Disconnected(self.pads.remove(idx).name));
    }

    /// The pad `id`, which may never have said that it is there.
    fn know(&mut self, id: usize, events: &mut Vec<PadEvent>) -> &mut Known {
        self.connect(id, "", false, events);
        let idx = self.pads.iter().position(|pad| pad.id == id).unwrap_or_default();
        &mut self.pads[idx]
    }

    fn take_wheel(&mut self, id: usize, events: &mut Vec<PadEvent>) {
        if self.active == Some(id) {
            return;
        }
        if let Some(former) = self.pads.iter_mut().find(|pad| Some(pad.id) == self.active) {
            former.lose();
        }
        (self.active, self.has_moved) = (Some(id), true);
        let name = self.pads.iter().find(|pad| pad.id == id).map(|pad| pad.name.clone());
        events.extend(name.map(PadEvent::Took));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Plays a recording: a line for each report of a pad, with its id first and then its signals.
    fn play(router: &mut PadRouter, recording: &str) -> Vec<PadEvent> {
        let mut events = Vec::new();
        for line in recording.lines().map(str::trim).filter(|line| !line.is_empty()) {
            let (id, signals) = line.split_once(' ').unwrap();
            for signal in signals.split(", ") {
                router.receive(id.parse().unwrap(), signal_of(signal), &mut events);
            }
            router.tell(&mut events);
        }
        events
    }

    fn signal_of(text: &str) -> PadSignal {
        let (what, rest) = text.split_once(' ').unwrap_or((text, ""));
        let value = || rest.parse().unwrap();
        match what {
            "plug" => PadSignal::Connected { name: rest.to_owned(), has_right_stick: true },
            "plug-zrz" => PadSignal::Connected { name: rest.to_owned(), has_right_stick: false },
            "unplug" => PadSignal::Disconnected,
            "south" => PadSignal::Down(PadButton::South),
            "x" => PadSignal::Axis(PadAxis::LeftX, value()),
            "rx" => PadSignal::Axis(PadAxis::RightX, value()),
            "z" => PadSignal::Axis(PadAxis::LeftZ, value()),
            "rz" => PadSignal::Axis(PadAxis::RightZ, value()),
            "lt2" => PadSignal::Trigger(Side::Left, value()),
            "rt2" => PadSignal::Trigger(Side::Right, value()),
            _ => panic!("no signal is called {what}"),
        }
    }

    /// Where the pad that drives was said to be last.
    fn held(events: &[PadEvent]) -> Pad {
        let moved = events.iter().rev().find_map(|event| match event {
            PadEvent::Moved(pad) => Some(*pad),
            _ => None,
        });
        moved.unwrap_or_default()
    }

    fn took(events: &[PadEvent]) -> Vec<String> {
        let took = |event: &PadEvent| match event {
            PadEvent::Took(name) => Some(name.clone()),
            _ => None,
        };
        events.iter().filter_map(took).collect()
    }

    /// An Xbox pad without a mapping: triggers are Z and RZ and rest at −1.
    const XBOX: &str = "0 plug Xbox pad
        0 rz -0.97
        0 rz -0.8
        0 rz -0.2
        0 rz 0.6
        0 rz 1";

    #[test]
    fn triggers_that_report_as_axes_give_gas_and_brake() {
        let mut router = PadRouter::default();
        let events = play(&mut router, XBOX);
        assert_eq!((held(&events).right_trigger, held(&events).left_trigger), (1.0, 0.0));
        let half = play(&mut router, "0 rz 0, z -0.95");
        assert!((held(&half).right_trigger - 0.5).abs() < 1e-6 && held(&half).left_trigger < 0.05);
        let let_go = play(&mut router, "0 rz -1, z 1");
        assert_eq!((held(&let_go).right_trigger, held(&let_go).left_trigger), (0.0, 1.0));
    }

    #[test]
    fn a_trigger_that_rests_at_zero_gives_as_much_as_it_is_pressed() {
        let mut router = PadRouter::default();
        let events = play(&mut router, "3 plug Pedals\n3 rz 0.1\n3 rz 0.3\n3 rz 0.75");
        assert_eq!(held(&events).right_trigger, 0.75);
        assert_eq!(held(&play(&mut router, "3 rz 0")).right_trigger, 0.0);
    }

    #[test]
    fn triggers_that_report_as_buttons_still_drive() {
        let mut router = PadRouter::default();
        let events = play(&mut router, "0 plug Pad\n0 rt2 0.5\n0 rt2 1, lt2 0.25\n0 rt2 0.9");
        assert_eq!((held(&events).right_trigger, held(&events).left_trigger), (0.9, 0.25));
        // One that says both: by the button it says only that it is touched.
        let mut router = PadRouter::default();
        let events = play(&mut router, "0 plug Pad\n0 rt2 1, rz -0.9\n0 rz -0.5");
        assert_eq!(held(&events).right_trigger, 0.25);
    }

    #[test]
    fn z_and_rz_are_the_right_stick_where_there_is_no_other() {
        let mut router = PadRouter::default();
        let events = play(&mut router, "0 plug-zrz Old pad\n0 z -0.1\n0 z -0.6, rz 0.2\n0 z -1, rz 1");
        let pad = held(&events);
        assert_eq!((pad.right_x, pad.right_y, pad.left_trigger, pad.right_trigger), (-1.0, -1.0, 0.0, 0.0));
        let rests = held(&play(&mut router, "0 z 0, rz 0"));
        assert_eq!(rests, Pad::default(), "a stick in the middle is no half gas");
        // But those of a pad that has no right stick at all are triggers.
        let mut router = PadRouter::default();
        let events = play(&mut router, "0 plug-zrz Wheel\n0 rz -0.98\n0 rz 0.5");
        assert_eq!(held(&events).right_trigger, 0.75);
    }

    #[test]
    fn a_stick_that_is_taken_for_a_trigger_gives_nothing_while_it_rests() {
        let mut router = PadRouter::default();
        play(&mut router, "0 plug Pad\n0 z -0.2\n0 z -0.7\n0 z -1\n0 z -0.3\n0 z 0\n0 south");
        assert_eq!(held(&play(&mut router, "0 z 0.01, z 0")), Pad::default());
    }

    #[test]
    fn two_pads_of_one_name_are_two_pads() {
        let mut router = PadRouter::default();
        let connected = |name: &str| PadEvent::Connected(name.to_owned());
        let events = play(&mut router, "0 plug Pad\n1 plug Pad\n2 plug Pad (2)\n1 plug Pad");
        assert_eq!(events, [connected("Pad"), connected("Pad (2)"), connected("Pad (2) (2)")]);
        let events = play(&mut router, "0 unplug\n4 plug Pad\n0 unplug");
        assert_eq!(events, [PadEvent::Disconnected("Pad".to_owned()), connected("Pad")]);
    }

    #[test]
    fn a_pad_without_a_name_has_one_here() {
        let mut router = PadRouter::default();
        let events = play(&mut router, "0 plug \n1 plug \u{7}\u{7} \n2 south");
        let names =
            ["Gamepad", "Gamepad (2)", "Gamepad (3)"].map(|name| PadEvent::Connected(name.to_owned()));
        assert_eq!(events[..3], names, "one that never said that it is there has one too");
        let long = PadSignal::Connected { name: "x".repeat(1000), has_right_stick: false };
        let mut events = Vec::new();
        router.receive(7, long, &mut events);
        assert_eq!(events, [PadEvent::Connected("x".repeat(NAME_LEN))]);
    }

    #[test]
    fn drift_of_an_untouched_pad_does_not_take_the_wheel() {
        let mut router = PadRouter::default();
        play(&mut router, "0 plug Pad\n1 plug Worn\n0 x 0.2\n0 x 0.6\n0 rt2 1");
        // A worn stick, and a pad that lies on its trigger.
        let noise =
            |i| format!("1 x {}, rt2 {}", 0.3 + 0.1 * f64::from(i % 3), 0.6 + 0.02 * f64::from(i % 5));
        let noise: Vec<_> = (0..200).map(noise).collect();
        assert_eq!(play(&mut router, &noise.join("\n")), [], "not a word of it");
        let events = play(&mut router, "0 x 0.7");
        assert_eq!((held(&events).stick, held(&events).right_trigger), (0.7, 1.0));
    }

    #[test]
    fn drift_alone_drives_nothing_either() {
        let mut router = PadRouter::default();
        assert_eq!(play(&mut router, "0 plug Worn\n0 x 0.04\n0 x 0.12\n0 x -0.1\n0 x 0.15").len(), 1);
        let events = play(&mut router, "0 x 0.3\n0 x 0.1");
        assert_eq!(took(&events), ["Worn"], "a gentle move does");
        assert_eq!(held(&events).stick, 0.1);
    }

    #[test]
    fn who_takes_over_brings_what_is_held_there_and_nothing_of_the_former() {
        let mut router = PadRouter::default();
        play(&mut router, "0 plug Pad\n1 plug Pad\n0 x 0.1\n0 x 1\n0 rt2 1");
        let events = play(&mut router, "1 x -0.2\n1 x -0.6");
        assert_eq!(took(&events), ["Pad (2)"]);
        assert_eq!(held(&events), Pad { stick: -0.6, ..Pad::default() }, "the other's gas is let go");
        // What is still held on the former trembles, and does not take it back.
        assert_eq!(play(&mut router, "0 x 0.97\n0 x 1\n0 rt2 0.98\n0 rt2 1"), []);
        assert_eq!(
            took(&play(&mut router, "0 rt2 0.4\n0 rt2 0\n0 rt2 0.8")),
            ["Pad"],
            "pressed anew it does"
        );
        let events = play(&mut router, "1 south");
        assert_eq!(took(&events), ["Pad (2)"], "and so does a button");
    }

    #[test]
    fn a_switch_for_a_stick_drives_from_its_first_press() {
        let mut router = PadRouter::default();
        let events = play(&mut router, "0 plug Old pad\n0 x -1");
        assert_eq!(held(&events).stick, -1.0);
    }

    #[test]
    fn unplugging_one_of_two_leaves_the_other() {
        let mut router = PadRouter::default();
        play(&mut router, "0 plug Pad\n1 plug Pad\n0 x 0.1\n0 x 1");
        let events = play(&mut router, "1 unplug");
        assert_eq!(events, [PadEvent::Disconnected("Pad (2)".to_owned())], "nothing is let go");
        assert_eq!(held(&play(&mut router, "0 x 0.9")).stick, 0.9);
        let events = play(&mut router, "0 unplug");
        let gone = PadEvent::Disconnected("Pad".to_owned());
        assert_eq!(events, [PadEvent::Moved(Pad::default()), gone], "what was held is let go first");
        let events = play(&mut router, "0 plug Pad\n0 x 0.05\n0 x 0.4");
        assert_eq!(held(&events).stick, 0.4, "plugged in again it begins anew");
    }

    #[test]
    fn what_is_no_number_is_no_place() {
        let mut router = PadRouter::default();
        play(&mut router, "0 plug Pad\n0 x 0.1\n0 x 0.5");
        let events = play(&mut router, "0 x NaN\n0 x inf\n0 rt2 NaN\n0 rz -inf");
        assert_eq!(events, []);
        let events = play(&mut router, "0 x 7, rt2 5");
        assert_eq!((held(&events).stick, held(&events).right_trigger), (1.0, 1.0));
        // Nor does it take the wheel.
        assert_eq!(took(&play(&mut router, "1 plug Broken\n1 x NaN\n1 rz NaN")), [""; 0]);
    }
}
