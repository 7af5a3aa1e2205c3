//! Every key of every panel, which can be changed here, and who draws the window.

use eframe::egui::{Event, Grid, Id, Key, Modal, PointerButton, RichText, ScrollArea, Slider, Ui};

use crate::env::controls::ControlConfig;
use crate::ui::command::Command;
use crate::ui::keys::{Deed, Rebinding, Taken};
use crate::ui::panels::pad::{pad_ui, told};
use crate::ui::state::State;
use crate::ui::tokens::{self, GAP, Tokens};
use crate::ui::widgets::keycap::{KeyButton, Tone, key_name, keycap_button};
use crate::ui::widgets::layout::dialog_frame;

type Rows = &'static [(&'static [Deed], &'static str)];

const DRIVING: Rows = &[
    (&[Deed::SteerLeft, Deed::SteerRight], "steer"),
    (&[Deed::Gas], "gas"),
    (&[Deed::Brake], "brake"),
    (&[Deed::Begin], "begin"),
    (&[Deed::Keep], "end and keep"),
    (&[Deed::Redo], "throw away and redo"),
    (&[Deed::Pause], "pause"),
    (&[Deed::Step], "one step, paused"),
    (&[Deed::Unsafe], "unsafe now"),
    (&[Deed::HandOver], "planner or hand at the wheel"),
    (&[Deed::Beside], "dream beside the real car"),
    (&[Deed::Leave], "leave"),
];

const LABELING: Rows = &[
    (&[Deed::OnlyLeft], "only left is safe"),
    (&[Deed::OnlyRight], "only right is safe"),
    (&[Deed::Neither], "neither is safe"),
    (&[Deed::PreferLeft, Deed::Equal, Deed::PreferRight], "left, equal, right; unsafe, neither, good"),
    (&[Deed::Guide], "one question at a time"),
    (&[Deed::Yes, Deed::No], "it stays safe, or not"),
    (&[Deed::Skip], "skip, then 1 2 3 for why"),
    (&[Deed::Undo], "undo, without limit"),
    (&[Deed::Restore], "redo what was undone"),
    (&[Deed::Flag], "flag"),
    (&[Deed::Answers], "list of answers"),
    (&[Deed::Restart], "clips from the start"),
    (&[Deed::PauseClips], "pause the clips"),
    (&[Deed::Back, Deed::Forward], "frame by frame"),
    (&[Deed::Slower, Deed::Faster], "slower, faster"),
];

/// What is not a matter of keys.
const ON_SEEING: &str = "A pair can be answered once it has been on the screen for a tenth of a second and two pictures of \
    the window: a key that comes before is not taken. A dream or a recording pauses when the window loses the focus, and \
    goes on when you say so; a drive by plan does not pause.";

pub(super) fn help_ui(ui: &mut Ui, state: &State, commands: &mut Vec<Command>) {
    let modal = Modal::new(Id::unique("help")).frame(dialog_frame(ui)).show(ui.ctx(), |ui| {
        ui.set_width(620.0);
        ui.horizontal(|ui| {
            ui.label(tokens::title("Keys and help"));
            ui.add_space(GAP);
            for (name, is_pad) in [("Keys", false), ("Gamepad", true)] {
                let tone = if state.is_pad_shown == is_pad { Tone::Chosen } else { Tone::Quiet };
                if KeyButton::new(name).tone(tone).small().show(ui).clicked() {
                    commands.push(Command::ShowPad(is_pad));
                }
            }
        });
        if state.is_pad_shown {
            ui.label(tokens::muted(ui, told(state)));
        } else {
            told_ui(ui, state, commands);
        }
        ui.add_space(GAP);
        let room = (ui.ctx().content_rect().height() - 210.0).max(150.0);
        ScrollArea::vertical().max_height(room).show(ui, |ui| {
            if state.is_pad_shown {
                return pad_ui(ui, state, commands);
            }
            ui.columns(2, |columns| {
                keys_ui(&mut columns[0], state, "Driving", DRIVING, commands);
                columns[0].add_space(GAP);
                controls_ui(&mut columns[0], state, commands);
                keys_ui(&mut columns[1], state, "Labeling", LABELING, commands);
            });
            ui.add_space(GAP);
            ui.label(tokens::small(ui, "Ctrl and 1 to 6 go to a panel; Ctrl+Z undoes an answer, Ctrl+Shift+Z or Ctrl+Y gives it back. Looking at a kept dream: Page Up and Page Down for others, Delete deletes it."));
            ui.label(tokens::small(ui, ON_SEEING));
            ui.add_space(GAP);
            ui.label(tokens::small(ui, format!("dropj {} · drawn by {}", env!("CARGO_PKG_VERSION"), state.adapter)));
        });
        ui.add_space(GAP);
        ui.horizontal(|ui| {
            if KeyButton::new("Close").key(Key::Escape).tone(Tone::Quiet).show(ui).clicked() {
                commands.push(Command::ToggleHelp);
            }
            if KeyButton::new("Back to the first keys").tone(Tone::Quiet).show(ui).clicked() {
                commands.push(Command::ResetKeys);
            }
        });
    });
    let caught = ui.input(|input| input.events.iter().find_map(key_down));
    match (state.rebinding, caught) {
        (Some(_), Some(Key::Escape)) => commands.push(Command::Rebind(None)),
        (Some(_), Some(key)) => commands.push(Command::Bind(key)),
        (None, _) if modal.should_close() && !commands.contains(&Command::ToggleHelp) => {
            commands.push(Command::ToggleHelp);
        }
        _ => {}
    }
}

fn key_down(event: &Event) -> Option<Key> {
    match event {
        Event::Key { key, pressed: true, repeat: false, modifiers, .. }
            if !modifiers.command && !modifiers.ctrl && !modifiers.alt =>
        {
            Some(*key)
        }
        _ => None,
    }
}

/// What can be done here, or what prevents it.
fn told_ui(ui: &mut Ui, state: &State, commands: &mut Vec<Command>) {
    ui.horizontal(|ui| {
        ui.set_min_height(28.0);
        let Some(Rebinding { slot: (deed, _), wanted }) = state.rebinding else {
            ui.label(tokens::muted(ui, "Click a key to change it."));
            return;
        };
        let name = deed.name();
        let Some((key, taken)) = wanted else {
            ui.label(tokens::muted(ui, format!("Press the new key of “{name}”, or Esc to leave it.")));
            return;
        };
        let (whose, can_swap) = match taken {
            Taken::By((other, _)) => (other.name(), true),
            Taken::Fixed(what) => (what, false),
        };
        let text = format!("{} is the key of “{whose}”. Press another", key_name(key));
        let text = text + if can_swap { ", or" } else { "." };
        ui.label(RichText::new(text).color(Tokens::of(ui).warn));
        if can_swap && KeyButton::new("Swap them").small().show(ui).clicked() {
            commands.push(Command::SwapKeys);
        }
    });
}

fn keys_ui(ui: &mut Ui, state: &State, heading: &str, rows: Rows, commands: &mut Vec<Command>) {
    let tokens = Tokens::of(ui);
    ui.label(RichText::new(heading).strong().color(tokens.text));
    Grid::new(heading).num_columns(2).spacing([16.0, 8.0]).min_row_height(20.0).show(ui, |ui| {
        ui.spacing_mut().interact_size.y = 20.0;
        for (deeds, what) in rows {
            ui.horizontal(|ui| {
                ui.spacing_mut().item_spacing.x = 4.0;
                for &deed in *deeds {
                    for (idx, &key) in state.keys.all(deed).iter().enumerate() {
                        cap_ui(ui, state, (deed, idx), key, commands);
                    }
                }
            });
            ui.label(tokens::muted(ui, *what));
            ui.end_row();
        }
    });
}

fn cap_ui(ui: &mut Ui, state: &State, slot: (Deed, usize), key: Key, commands: &mut Vec<Command>) {
    let waiting = state.rebinding.map(|rebinding| rebinding.slot);
    let response = keycap_button(ui, key, slot.0.name(), waiting == Some(slot));
    // While a key is awaited, Space and Enter are keys like others.
    let is_hit =
        if waiting.is_none() { response.clicked() } else { response.clicked_by(PointerButton::Primary) };
    if is_hit {
        commands.push(Command::Rebind(Some(slot)));
    }
}

/// How much a held key gives, and where a pad begins to give something.
fn controls_ui(ui: &mut Ui, state: &State, commands: &mut Vec<Command>) {
    ui.label(RichText::new("At the wheel").strong().color(Tokens::of(ui).text));
    let mut controls = state.controls;
    let ControlConfig { key_steer, key_gas, key_brake, .. } = &mut controls;
    for (value, name) in
        [(key_steer, "steering of a key"), (key_gas, "gas of a key"), (key_brake, "brake of a key")]
    {
        ui.add(Slider::new(value, 0.0..=1.0).fixed_decimals(2).text(name));
    }
    ui.label(tokens::small(ui, "With Shift, keys give half of that."));
    if controls != state.controls {
        commands.push(Command::Control(controls));
    }
}
