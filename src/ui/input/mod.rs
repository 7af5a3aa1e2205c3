//! Keys and pads as the window receives them.
//!
//! Decides nothing about what is done: what is held becomes an action in [`world::controls`](crate::world::controls).

mod pad_commands;
mod pad_router;
mod typing;

use std::fmt;

use eframe::egui::{Context, Event, Id, Key, Ui};
use serde::{Deserialize, Serialize};

use crate::app::Moment;
use crate::ui::settings::keymap::Keys;
use crate::world::controls::{ControlConfig, Controls, Pad};
use crate::world::{Action, WorldSpec};

pub(crate) use pad_commands::pad_command;

use pad_router::{PadAxis, PadRouter, PadSignal, Side};
use typing::Typing;

/// A button of a pad, by what it is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum PadButton {
    /// The lower of the four: A.
    South,
    /// The right one: B.
    East,
    /// The left one: X.
    West,
    /// The upper one: Y.
    North,
    /// The left shoulder.
    LeftShoulder,
    /// The right shoulder.
    RightShoulder,
    /// To the left on the cross.
    Left,
    /// To the right on the cross.
    Right,
    /// Up on the cross.
    Up,
    /// Down on the cross.
    Down,
    /// The right one in the middle.
    Start,
    /// The left one in the middle.
    Back,
}

/// What a pad did; no two that are plugged in have the same name.
#[derive(Clone, Debug, PartialEq)]
pub enum PadEvent {
    /// It was plugged in.
    Connected(String),
    /// It was unplugged, or its battery died.
    Disconnected(String),
    /// This one drives from here on: it was pressed or moved, and no other has the wheel any more.
    Took(String),
    /// A button went down.
    Pressed(PadButton),
    /// The sticks and both triggers of the one that drives are here now.
    Moved(Pad),
}

/// Where pad events come from: a device, nothing, or a script.
pub trait InputSource {
    /// What happened since the last time.
    fn poll(&mut self) -> Vec<PadEvent>;
}

/// No pads at all.
#[derive(Debug)]
pub struct NoPads;

impl InputSource for NoPads {
    fn poll(&mut self) -> Vec<PadEvent> {
        Vec::new()
    }
}

/// The pads of this machine.
pub struct Gilrs {
    gilrs: gilrs::Gilrs,
    router: PadRouter,
    /// What was there from the beginning and was not told of.
    untold: Vec<PadEvent>,
}

impl fmt::Debug for Gilrs {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Gilrs")
    }
}

/// The pads of this machine, or none where they cannot be asked for.
pub fn system_pads() -> Box<dyn InputSource> {
    match gilrs::Gilrs::new() {
        Ok(gilrs) => {
            let (mut router, mut untold) = (PadRouter::default(), Vec::new());
            for (id, pad) in gilrs.gamepads() {
                router.receive(id.into(), connected(&pad), &mut untold);
            }
            Box::new(Gilrs { gilrs, router, untold })
        }
        Err(e) => {
            log::info!("no gamepads: {e}");
            Box::new(NoPads)
        }
    }
}

fn connected(pad: &gilrs::Gamepad<'_>) -> PadSignal {
    let has_right_stick = pad.axis_code(gilrs::Axis::RightStickX).is_some();
    PadSignal::Connected { name: pad.name().to_owned(), has_right_stick }
}

impl InputSource for Gilrs {
    fn poll(&mut self) -> Vec<PadEvent> {
        let mut events = std::mem::take(&mut self.untold);
        while let Some(gilrs::Event { id, event, .. }) = self.gilrs.next_event() {
            let signal = match event {
                gilrs::EventType::Connected => Some(connected(&self.gilrs.gamepad(id))),
                gilrs::EventType::Disconnected => Some(PadSignal::Disconnected),
                gilrs::EventType::ButtonPressed(button, _) => pad_button(button).map(PadSignal::Down),
                gilrs::EventType::AxisChanged(axis, value, _) => {
                    pad_axis(axis).map(|axis| PadSignal::Axis(axis, value))
                }
                gilrs::EventType::ButtonChanged(gilrs::Button::LeftTrigger2, value, _) => {
                    Some(PadSignal::Trigger(Side::Left, value))
                }
                gilrs::EventType::ButtonChanged(gilrs::Button::RightTrigger2, value, _) => {
                    Some(PadSignal::Trigger(Side::Right, value))
                }
                _ => None,
            };
            if let Some(signal) = signal {
                self.router.receive(id.into(), signal, &mut events);
            }
        }
        self.router.tell(&mut events);
        events
    }
}

fn pad_axis(axis: gilrs::Axis) -> Option<PadAxis> {
    Some(match axis {
        gilrs::Axis::LeftStickX => PadAxis::LeftX,
        gilrs::Axis::LeftStickY => PadAxis::LeftY,
        gilrs::Axis::RightStickX => PadAxis::RightX,
        gilrs::Axis::RightStickY => PadAxis::RightY,
        gilrs::Axis::LeftZ => PadAxis::LeftZ,
        gilrs::Axis::RightZ => PadAxis::RightZ,
        _ => return None,
    })
}

fn pad_button(button: gilrs::Button) -> Option<PadButton> {
    Some(match button {
        gilrs::Button::South => PadButton::South,
        gilrs::Button::East => PadButton::East,
        gilrs::Button::West => PadButton::West,
        gilrs::Button::North => PadButton::North,
        gilrs::Button::LeftTrigger => PadButton::LeftShoulder,
        gilrs::Button::RightTrigger => PadButton::RightShoulder,
        gilrs::Button::DPadLeft => PadButton::Left,
        gilrs::Button::DPadRight => PadButton::Right,
        gilrs::Button::DPadUp => PadButton::Up,
        gilrs::Button::DPadDown => PadButton::Down,
        gilrs::Button::Start => PadButton::Start,
        gilrs::Button::Select => PadButton::Back,
        _ => return None,
    })
}

/// Whether the window has the focus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Focus {
    /// It never had: it has just opened, or nothing gives a focus here, as without a window manager.
    #[default]
    Unknown,
    /// It has.
    Here,
    /// It had.
    Left,
}

/// Keys and pads, from one picture of the window to the next.
pub(crate) struct Input {
    source: Box<dyn InputSource>,
    /// What is held.
    pub held: HeldControls,
    /// Keys that were struck faster than the window draws.
    typing: Typing,
    focus: Focus,
    /// The picture that was begun last.
    last: Moment,
}

impl Input {
    /// Nothing is held yet, for the axes of this world; pads are read from `source`.
    pub(crate) fn new(spec: &WorldSpec, source: Box<dyn InputSource>) -> Self {
        let (held, typing) = (HeldControls::new(spec), Typing::default());
        Self { source, held, typing, focus: Focus::default(), last: Moment::default() }
    }

    /// The picture that is laid out now, and whether there is one.
    pub(crate) fn begin_picture(&mut self, ctx: &Context) -> (Moment, bool) {
        let picture = Moment { nr: ctx.cumulative_frame_nr(), at: ctx.input(|input| input.time) };
        let is_new = picture.at > self.last.at;
        self.last = picture;
        (picture, is_new)
    }

    /// Whether the window loses the focus now, or is no longer to be seen.
    pub(crate) fn follow_focus(&mut self, ctx: &Context, is_new: bool) -> bool {
        let (has_focus, had_lost) = ctx.input(|input| {
            let is_seen = input.viewport().visible() != Some(false);
            let lost = input.events.iter().any(|event| matches!(event, Event::WindowFocused(false)));
            (input.raw.focused && is_seen, lost && is_new)
        });
        let is_leaving = had_lost || self.focus == Focus::Here && !has_focus;
        match (has_focus, is_leaving) {
            (true, _) => self.focus = Focus::Here,
            (false, true) => self.focus = Focus::Left,
            (false, false) => {}
        }
        is_leaving
    }

    /// Whether it had the focus and has not any more.
    pub(crate) fn has_left(&self) -> bool {
        self.focus == Focus::Left
    }

    /// What pads did since the last time.
    pub(crate) fn poll(&mut self) -> Vec<PadEvent> {
        self.source.poll()
    }

    /// Takes in the keys of a picture, leaves the one that is to be carried out now, and returns the picture that was
    /// seen by whoever struck it.
    pub(crate) fn receive_keys(
        &mut self,
        ctx: &Context,
        keys: &Keys,
        now: Moment,
        is_driving: bool,
    ) -> Moment {
        let is_writing = ctx.text_edit_focused();
        let seen = ctx.input_mut(|input| {
            self.held.receive(&input.events, keys, input.focused, is_driving);
            self.held.be_careful(input.modifiers.shift);
            self.typing.one_by_one(&mut input.events, now, is_writing)
        });
        if self.typing.is_waiting() {
            ctx.request_repaint();
        }
        seen
    }
}

/// What is held on keys and pad.
#[derive(Clone, Debug)]
pub(crate) struct HeldControls {
    controls: Controls,
    /// Keys that went down and up within one frame: they count until the next.
    tapped: Vec<&'static str>,
    /// Whether keys give half: Shift is held.
    is_careful: bool,
}

impl HeldControls {
    /// Nothing is held yet.
    pub(crate) fn new(spec: &WorldSpec) -> Self {
        Self { controls: Controls::new(spec), tapped: Vec::new(), is_careful: false }
    }

    /// Takes in the key events of a frame; `is_driving` says whether keys drive now.
    pub(crate) fn receive(&mut self, events: &[Event], keys: &Keys, has_focus: bool, is_driving: bool) {
        for key in std::mem::take(&mut self.tapped) {
            self.controls.set(key, false);
        }
        let mut went_down = Vec::new();
        for event in events {
            match *event {
                Event::Key { key, pressed: true, modifiers, .. } if is_driving && !modifiers.command => {
                    if let Some(key) = keys.driving(key) {
                        self.controls.set(key, true);
                        went_down.push(key);
                    }
                }
                Event::Key { key, pressed: false, .. } => {
                    let Some(key) = keys.driving(key) else { continue };
                    if went_down.contains(&key) {
                        self.tapped.push(key);
                    } else {
                        self.controls.set(key, false);
                    }
                }
                Event::WindowFocused(false) => self.controls.release_keys(),
                _ => {}
            }
        }
        if !has_focus || !is_driving {
            self.controls.release_keys();
            self.tapped.clear();
        }
    }

    /// Takes in whether keys give half.
    pub(crate) fn be_careful(&mut self, is_careful: bool) {
        self.is_careful = is_careful;
    }

    /// Where the pad's sticks and triggers are.
    pub(crate) fn pad(&self) -> Pad {
        self.controls.pad()
    }

    /// Takes in where a pad's sticks and triggers are.
    pub(crate) fn hold(&mut self, pad: Pad) {
        self.controls.hold(pad);
    }

    /// Lets go of everything: every axis is neutral again.
    pub(crate) fn release(&mut self) {
        self.controls.reset();
        self.tapped.clear();
        self.is_careful = false;
    }

    /// The action that they give after `dt` more seconds.
    pub(crate) fn step(&mut self, dt: f32, config: &ControlConfig) -> Action {
        self.controls.step(dt, self.is_careful, config)
    }

    /// The action while nobody's hands are here.
    pub(crate) fn idle(&self) -> Action {
        self.controls.idle()
    }
}

/// Whether keys press buttons now: not while somebody types or a dialog is open.
pub(crate) fn set_live(ctx: &Context, is_live: bool) {
    ctx.data_mut(|data| data.insert_temp(Id::unique("keys are live"), is_live));
}

/// Whether `key` went down in this frame, and nobody else wants it.
pub(crate) fn pressed(ui: &Ui, key: Key) -> bool {
    let ctx = ui.ctx();
    let is_live = ctx.data(|data| data.get_temp(Id::unique("keys are live")).unwrap_or(true));
    if !is_live || ctx.text_edit_focused() {
        return false;
    }
    // A control that was reached with Tab keeps the keys that press and leave it.
    let is_for_controls = matches!(
        key,
        Key::Space
            | Key::Enter
            | Key::Escape
            | Key::ArrowLeft
            | Key::ArrowRight
            | Key::ArrowUp
            | Key::ArrowDown
    );
    if is_for_controls && ctx.memory(|memory| memory.focused().is_some()) {
        return false;
    }
    ctx.input(|input| input.events.iter().any(|event| is_press(event, key)))
}

/// Whether Ctrl (on a Mac the command key) and `key` went down in this frame, with the shift key or without.
pub(crate) fn chord(ui: &Ui, key: Key, shift: bool) -> bool {
    let ctx = ui.ctx();
    let is_live = ctx.data(|data| data.get_temp(Id::unique("keys are live")).unwrap_or(true));
    let is_wanted = |event: &Event| match event {
        Event::Key { key: found, pressed: true, repeat: false, modifiers, .. } => {
            *found == key && modifiers.command && !modifiers.alt && modifiers.shift == shift
        }
        _ => false,
    };
    is_live && !ctx.text_edit_focused() && ctx.input(|input| input.events.iter().any(is_wanted))
}

/// Whether somebody asks for the list of keys, by `?`, `/` or F1.
///
/// Whoever lets go of Shift first has released `/` and not `?`, which counts as held from then on: that it is pressed
/// again looks like a repetition.
pub(crate) fn asks_for_help(ui: &Ui) -> bool {
    let ctx = ui.ctx();
    let is_live = ctx.data(|data| data.get_temp(Id::unique("keys are live")).unwrap_or(true));
    let is_wanted = |event: &Event| match event {
        Event::Key { key, pressed: true, modifiers, .. } => {
            matches!(key, Key::Questionmark | Key::Slash | Key::F1) && !modifiers.command && !modifiers.alt
        }
        _ => false,
    };
    is_live && !ctx.text_edit_focused() && ctx.input(|input| input.events.iter().any(is_wanted))
}

fn is_press(event: &Event, wanted: Key) -> bool {
    match event {
        Event::Key { key, pressed: true, repeat: false, modifiers, .. } => {
            *key == wanted && !modifiers.command && !modifiers.ctrl && !modifiers.alt
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use eframe::egui::Modifiers;

    use super::*;

    /// What is held after a frame with these key events.
    fn after(held: &mut HeldControls, keys: &[(Key, bool)]) -> Action {
        let event = |&(key, pressed): &(Key, bool)| Event::Key {
            key,
            physical_key: None,
            pressed,
            repeat: false,
            modifiers: Modifiers::NONE,
        };
        let events: Vec<_> = keys.iter().map(event).collect();
        held.receive(&events, &Keys::default(), true, true);
        held.step(0.02, &ControlConfig::default())
    }

    fn nothing_held() -> HeldControls {
        HeldControls::new(&WorldSpec::default())
    }

    #[test]
    fn a_tap_within_one_frame_counts_until_the_next() {
        let mut held = nothing_held();
        assert_eq!(after(&mut held, &[(Key::D, true), (Key::D, false)])[0], 1.0);
        assert_eq!(after(&mut held, &[])[0], 0.0);
    }

    #[test]
    fn shift_halves_what_keys_give() {
        let mut held = nothing_held();
        after(&mut held, &[(Key::ArrowUp, true), (Key::ArrowLeft, true)]);
        held.be_careful(true);
        assert_eq!(held.step(0.02, &ControlConfig::default()), [-0.5, 0.5, 0.0]);
        held.be_careful(false);
        assert_eq!(held.step(0.02, &ControlConfig::default()), [-1.0, 1.0, 0.0]);
    }

    #[test]
    fn a_key_that_moves_nothing_moves_nothing() {
        assert_eq!(after(&mut nothing_held(), &[(Key::N, true)]), [0.0; 3]);
    }
}
