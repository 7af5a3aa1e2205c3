//! Every key of every panel, which can be changed here, and who draws the window.

use eframe::egui::{
    Align, Event, Grid, Id, Key, Layout, Modal, PointerButton, RichText, ScrollArea, Slider, Ui,
};

use crate::app::{Command, GuideCommand, LabelCommand, WindowCommand};
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::settings::SettingsCommand;
use crate::ui::settings::gamepad_ui::{pad_ui, told};
use crate::ui::settings::keymap::{KeyAction, Rebinding, Slot, Taken, known_key};
use crate::ui::tokens::{self, GAP, Tokens};
use crate::ui::widgets::gauge::capitalized;
use crate::ui::widgets::keycap::{KeyButton, Tone, key_name, keycap_button};
use crate::ui::widgets::layout::dialog_frame;
use crate::world::Axis;
use crate::world::controls::{AxisControls, key_share};

type Rows = &'static [(&'static [KeyAction], &'static str)];

const DRIVING: Rows = &[
    (&[KeyAction::Begin], "begin"),
    (&[KeyAction::Keep], "end and keep"),
    (&[KeyAction::Redo], "throw away and redo"),
    (&[KeyAction::Pause], "pause"),
    (&[KeyAction::Step], "one step, paused"),
    (&[KeyAction::Unsafe], "unsafe now"),
    (&[KeyAction::HandOver], "planner or hand in control"),
    (&[KeyAction::Beside], "dream beside the real world"),
    (&[KeyAction::Leave], "leave"),
];

const LABELING: Rows = &[
    (&[KeyAction::OnlyLeft], "only left is safe"),
    (&[KeyAction::OnlyRight], "only right is safe"),
    (&[KeyAction::Neither], "neither is safe"),
    (
        &[KeyAction::PreferLeft, KeyAction::Equal, KeyAction::PreferRight],
        "left, equal, right; unsafe, neither, good",
    ),
    (&[KeyAction::Guide], "one question at a time"),
    (&[KeyAction::Yes, KeyAction::No], "it stays safe, or not"),
    (&[KeyAction::Skip], "skip, then 1 2 3 for why"),
    (&[KeyAction::Undo], "undo, without limit"),
    (&[KeyAction::Restore], "redo what was undone"),
    (&[KeyAction::Flag], "flag"),
    (&[KeyAction::Answers], "list of answers"),
    (&[KeyAction::Restart], "clips from the start"),
    (&[KeyAction::PauseClips], "pause the clips"),
    (&[KeyAction::Back, KeyAction::Forward], "frame by frame"),
    (&[KeyAction::Slower, KeyAction::Faster], "slower, faster"),
];

/// What is not a matter of keys.
const ON_SEEING: &str = "A pair can be answered once it has been on the screen for a tenth of a second and two pictures of \
    the window: a key that comes before is not taken. A dream or a recording pauses when the window loses the focus, and \
    goes on when you say so; a plan that is carried out does not pause.";

pub(in crate::ui) fn help_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let modal = Modal::new(Id::unique("help")).frame(dialog_frame(ui)).show(ui.ctx(), |ui| {
        ui.set_width(620.0);
        ui.horizontal(|ui| {
            ui.label(tokens::title("Keys and help"));
            ui.add_space(GAP);
            for (name, is_pad) in [("Keys", false), ("Gamepad", true)] {
                let tone = if state.settings.is_gamepad_shown == is_pad { Tone::Chosen } else { Tone::Quiet };
                if KeyButton::new(name).tone(tone).small().show(ui).clicked() {
                    commands.push(SettingsCommand::ShowGamepad(is_pad));
                }
            }
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| motion_ui(ui, state, commands));
        });
        if state.settings.is_gamepad_shown {
            ui.label(tokens::muted(ui, told(state)));
        } else {
            told_ui(ui, state, commands);
        }
        ui.add_space(GAP);
        let room = (ui.ctx().content_rect().height() - 210.0).max(150.0);
        ScrollArea::vertical().max_height(room).min_scrolled_height(room).show(ui, |ui| {
            if state.settings.is_gamepad_shown {
                return pad_ui(ui, state, commands);
            }
            ui.columns(2, |columns| {
                moves_ui(&mut columns[0], state, commands);
                columns[0].add_space(GAP);
                keys_ui(&mut columns[0], state, "In a dream or the real world", DRIVING, commands);
                columns[0].add_space(GAP);
                controls_ui(&mut columns[0], state, commands);
                keys_ui(&mut columns[1], state, "Labeling", LABELING, commands);
            });
            ui.add_space(GAP);
            ui.label(tokens::small(ui, "Ctrl and 1 to 7 go to a panel; Ctrl+Z undoes an answer, Ctrl+Shift+Z or Ctrl+Y gives it back. Looking at a kept dream or a driven episode: Page Up and Page Down for others; Delete deletes a dream."));
            ui.label(tokens::small(ui, ON_SEEING));
            ui.label(tokens::small(ui, "Ctrl and + or − make everything larger or smaller, Ctrl+0 as it was. Tab goes from one control to the next, Space or Enter presses it."));
            ui.add_space(GAP);
            ui.label(tokens::small(ui, format!("dropj {} · drawn by {}", env!("CARGO_PKG_VERSION"), state.settings.adapter)));
        });
        ui.add_space(GAP);
        ui.horizontal(|ui| {
            if KeyButton::new("Close").key(Key::Escape).tone(Tone::Quiet).show(ui).clicked() {
                commands.push(Command::Window(WindowCommand::ToggleHelp));
            }
            if KeyButton::new("How to begin").tone(Tone::Quiet).show(ui).clicked() {
                commands.push(Command::Guide(GuideCommand::Offer(true)));
            }
            if KeyButton::new("Show hints again").tone(Tone::Quiet).show(ui).clicked() {
                commands.push(Command::Guide(GuideCommand::TeachAgain));
            }
            if KeyButton::new("Back to the first keys").tone(Tone::Quiet).show(ui).clicked() {
                commands.push(SettingsCommand::Reset);
            }
        });
    });
    let caught = ui.input(|input| input.events.iter().find_map(key_down));
    match (state.settings.rebinding, caught) {
        (Some(_), Some(Key::Escape)) => commands.push(SettingsCommand::Rebind(None)),
        (Some(_), Some(key)) => commands.push(SettingsCommand::Bind(key)),
        (None, _)
            if modal.should_close() && !commands.contains(&Command::Window(WindowCommand::ToggleHelp)) =>
        {
            commands.push(Command::Window(WindowCommand::ToggleHelp));
        }
        _ => {}
    }
}

/// Whether anything moves that does not have to.
fn motion_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let mut is_reduced = state.label.is_motion_reduced;
    let about = "Clips show a few still pictures one after the other, and nothing in the window slides";
    if ui.checkbox(&mut is_reduced, "Less motion").on_hover_text(about).changed() {
        commands.push(Command::Label(LabelCommand::ReduceMotion(is_reduced)));
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
fn told_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    ui.horizontal(|ui| {
        ui.set_min_height(28.0);
        let Some(Rebinding { slot, wanted }) = state.settings.rebinding else {
            ui.label(tokens::muted(ui, "Click a key to change it."));
            return;
        };
        let keys = &state.settings.keys;
        let name = keys.name_of(slot);
        let Some((key, taken)) = wanted else {
            ui.label(tokens::muted(ui, format!("Press the new key of “{name}”, or Esc to leave it.")));
            return;
        };
        let (whose, can_swap) = match taken {
            Taken::By(other) => (keys.name_of(other), true),
            Taken::Fixed(what) => (what.to_owned(), false),
        };
        let text = format!("{} is the key of “{whose}”. Press another", key_name(key));
        let text = text + if can_swap { ", or" } else { "." };
        ui.label(RichText::new(text).color(Tokens::of(ui).warn));
        if can_swap && KeyButton::new("Swap them").small().show(ui).clicked() {
            commands.push(SettingsCommand::SwapKeys);
        }
    });
}

/// Keys of an axis that stand beside each other.
const KEYS_A_ROW: usize = 4;

/// The keys that move the world's axes: for each axis a row, or more where it has many.
fn moves_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    ui.label(RichText::new(&state.spec.title).strong().color(Tokens::of(ui).text));
    let has_keys = |axis: &&Axis| !axis.keys.is_empty();
    if !state.spec.axes.iter().any(|axis| has_keys(&axis)) {
        ui.label(tokens::small(ui, "Its file names no keys: a gamepad or the planner moves it"));
    }
    Grid::new("moves").num_columns(2).spacing([16.0, 8.0]).min_row_height(20.0).show(ui, |ui| {
        ui.spacing_mut().interact_size.y = 20.0;
        for axis in state.spec.axes.iter().filter(has_keys) {
            let keys: Vec<_> = axis.keys.iter().filter_map(|input| known_key(&input.key)).collect();
            for (idx, row) in keys.chunks(KEYS_A_ROW).enumerate() {
                ui.horizontal(|ui| {
                    ui.spacing_mut().item_spacing.x = 4.0;
                    for name in row {
                        cap_ui(ui, state, Slot::Move(name), state.settings.keys.of_move(name), commands);
                    }
                });
                ui.label(tokens::muted(ui, if idx == 0 { &axis.name } else { "" }));
                ui.end_row();
            }
        }
    });
}

fn keys_ui(ui: &mut Ui, state: &View<'_>, heading: &str, rows: Rows, commands: &mut Commands) {
    let tokens = Tokens::of(ui);
    ui.label(RichText::new(heading).strong().color(tokens.text));
    Grid::new(heading).num_columns(2).spacing([16.0, 8.0]).min_row_height(20.0).show(ui, |ui| {
        ui.spacing_mut().interact_size.y = 20.0;
        for (key_actions, what) in rows {
            ui.horizontal(|ui| {
                ui.spacing_mut().item_spacing.x = 4.0;
                for &key_action in *key_actions {
                    for (idx, &key) in state.settings.keys.all(key_action).iter().enumerate() {
                        cap_ui(ui, state, Slot::Of(key_action, idx), key, commands);
                    }
                }
            });
            ui.label(tokens::muted(
                ui,
                lost(state, key_actions)
                    .map_or_else(|| (*what).to_owned(), |moves| format!("{what} (not while {moves})")),
            ));
            ui.end_row();
        }
    });
}

/// What this world moves by the key of one of these, if it does: then that key does not do this while the world is acted in.
fn lost(state: &View<'_>, key_actions: &[KeyAction]) -> Option<String> {
    let keys = &state.settings.keys;
    let is_driving = |key_action: &&KeyAction| **key_action < KeyAction::OnlyLeft;
    let moved = key_actions
        .iter()
        .filter(is_driving)
        .find_map(|it| Some((keys.of(*it), keys.driving(keys.of(*it))?)));
    moved.map(|(key, name)| format!("{} moves {}", key_name(key), keys.name_of(Slot::Move(name))))
}

fn cap_ui(ui: &mut Ui, state: &View<'_>, slot: Slot, key: Key, commands: &mut Commands) {
    let waiting = state.settings.rebinding.map(|rebinding| rebinding.slot);
    let name = state.settings.keys.name_of(slot);
    let response = keycap_button(ui, key, &name, waiting == Some(slot));
    // While a key is awaited, Space and Enter are keys like others.
    let is_hit =
        if waiting.is_none() { response.clicked() } else { response.clicked_by(PointerButton::Primary) };
    if is_hit {
        commands.push(SettingsCommand::Rebind(Some(slot)));
    }
}

/// How far held keys move each axis.
fn controls_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    ui.label(RichText::new("How far keys move it").strong().color(Tokens::of(ui).text));
    let mut controls = state.settings.controls.clone();
    for axis in state.spec.axes.iter().filter(|axis| !axis.keys.is_empty()) {
        let (wanted, first) = (controls.of(&axis.name), key_share(axis));
        let mut share = wanted.keys.unwrap_or(first);
        let slider = Slider::new(&mut share, 0.0..=1.0).fixed_decimals(2).text(capitalized(&axis.name));
        if ui.add(slider).on_hover_text("A share of the way from its neutral value to its end").changed() {
            let keys = Some(share).filter(|share| *share != first);
            controls.set(&axis.name, AxisControls { keys, ..wanted });
        }
    }
    ui.label(tokens::small(ui, "With Shift, keys give half of that."));
    if controls != state.settings.controls {
        commands.push(SettingsCommand::Controls(controls));
    }
}
