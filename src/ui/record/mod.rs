//! Driving the real car, to have something that a world model can learn from.

mod episodes;
mod rollout_comparison;

use eframe::egui::{Ui, vec2};

use crate::app::{Command, Field, RecordCommand, WindowCommand};
use crate::env::{MAX_STEPS, STEPS_PER_SEC};
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::dream::{banner, hand_over_button};
use crate::ui::record::rollout_comparison::{dream_beside_ui, drift_ui};
use crate::ui::settings::keymap::KeyAction;
use crate::ui::tokens::{self, GAP, Tokens};
use crate::ui::widgets::clip::{Rim, picture_ui};
use crate::ui::widgets::field::{field_ui, path_ui};
use crate::ui::widgets::gauge::{action_ui, figure_ui, row_color_ui, wheels_ui};
use crate::ui::widgets::keycap::{KeyButton, Tone};
use crate::ui::widgets::layout::{beside_picture, heading, titled_card, with_side};

/// Width by height of the scene.
const SHAPE: f32 = 600.0 / 480.0;
/// Room for what stands under the picture.
const BELOW: f32 = 50.0;

pub(in crate::ui) fn record_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let about = "Drive the real car and keep what you drove, to fit a world model of your own.";
    heading(ui, "Record", about);
    let main = |ui: &mut Ui, commands: &mut Commands| stage_ui(ui, state, commands);
    let aside = |ui: &mut Ui, commands: &mut Commands| aside_ui(ui, state, commands);
    let shape = if state.record.rollout.asked.is_some() { SHAPE + 1.0 } else { SHAPE };
    let side = beside_picture(ui, shape, BELOW);
    with_side(ui, side, commands, main, aside);
}

fn stage_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    if state.is_watching() {
        return episodes::watch_ui(ui, state, commands);
    }
    let record = &state.record;
    let live = record.live.as_ref().filter(|_| record.is_on);
    let is_paused = live.is_some_and(|live| live.is_paused);
    let room = ui.available_size();
    let is_beside = record.rollout.asked.is_some();
    // Both are equally high.
    let shape = if is_beside { SHAPE + 1.0 } else { SHAPE };
    let gap = if is_beside { GAP } else { 0.0 };
    let height = ((room.x - gap) / shape).min(room.y - BELOW).max(120.0);
    let label = live.map_or("The track".to_owned(), |live| format!("The track at step {}", live.step));
    let empty = if record.is_on {
        "Drawing the track…"
    } else {
        "Press Record, then drive with keys or a gamepad."
    };
    let rim = if is_paused { Rim::Accent } else { Rim::Plain };
    let picture = record.picture.as_ref().filter(|_| live.is_some());
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = gap;
        let response = picture_ui(ui, picture, vec2(height * SHAPE, height), &label, empty, rim);
        if is_paused {
            banner(ui, response.rect, record.why_paused.unwrap_or("Paused"));
        } else if live.is_some_and(|live| live.is_planned) {
            banner(ui, response.rect, "The planner drives");
        }
        if is_beside {
            dream_beside_ui(ui, state, height);
        }
    });
    ui.add_space(6.0);
    let key = |key_action| state.settings.keys.of(key_action);
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().item_spacing.x = 8.0;
        if !record.is_on {
            let button = KeyButton::new("Record").key(key(KeyAction::Begin)).tone(Tone::Primary).width(150.0);
            if button.is_pressed(ui) {
                commands.push(Command::Record(RecordCommand::Start));
            }
            return;
        }
        for (button, command) in [
            (
                KeyButton::new("Keep")
                    .key(key(KeyAction::Keep))
                    .tone(Tone::Primary)
                    .enabled(!record.is_ending),
                Command::Record(RecordCommand::Keep),
            ),
            (
                KeyButton::new(if is_paused { "Go on" } else { "Pause" }).key(key(KeyAction::Pause)),
                Command::Record(RecordCommand::Pause),
            ),
            (hand_over_button(state, record.live.as_ref()), Command::Window(WindowCommand::HandOver)),
            (
                KeyButton::new("Redo").key(key(KeyAction::Redo)).enabled(!record.is_ending),
                Command::Record(RecordCommand::Redo),
            ),
            (
                KeyButton::new("Leave").key(key(KeyAction::Leave)).tone(Tone::Quiet),
                Command::Record(RecordCommand::Leave),
            ),
        ] {
            if button.is_pressed(ui) {
                commands.push(command);
            }
        }
    });
}

fn aside_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    if state.is_watching() {
        episodes::then_ui(ui, state);
        episodes::list_ui(ui, state, commands);
        return;
    }
    if state.record.is_on {
        now_ui(ui, state);
    } else {
        where_ui(ui, state, commands);
        episodes::list_ui(ui, state, commands);
    }
    titled_card(ui, "Dream and real", |ui| drift_ui(ui, state, commands));
}

/// The step that is driven, and how well the clock keeps.
fn now_ui(ui: &mut Ui, state: &View<'_>) {
    let tokens = Tokens::of(ui);
    let live = state.record.live.as_ref();
    titled_card(ui, "Now", |ui| {
        let (rate, step) = match live {
            Some(live) => (format!("{:.0}", live.steps_per_sec), live.step.to_string()),
            None => ("–".to_owned(), "–".to_owned()),
        };
        ui.horizontal(|ui| {
            ui.spacing_mut().item_spacing.x = 28.0;
            figure_ui(ui, step, &format!("step of {MAX_STEPS}"));
            figure_ui(ui, rate, &format!("steps a second of {STEPS_PER_SEC}"));
        });
        ui.add_space(6.0);
        let planned = live.filter(|live| live.is_planned || live.is_paused).map(|live| live.action);
        action_ui(ui, planned.unwrap_or(state.dream.action));
        let n_late = live.map_or(0, |live| live.n_late);
        row_color_ui(
            ui,
            "Late steps",
            n_late.to_string(),
            if n_late > 0 { tokens.warn } else { tokens.text },
        );
        if let Some(n) = live.and_then(|live| live.wheels_off) {
            wheels_ui(ui, n);
        }
    });
}

/// The folder, and the track that is driven next.
fn where_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    titled_card(ui, "Where", |ui| {
        path_ui(ui, state, Field::Dataset, "Folder of recordings", commands);
        field_ui(ui, state, Field::RecordSeed, "Seed of the track", commands);
        ui.label(tokens::small(ui, "LeRobot v3: other programs can open it"));
    });
}
