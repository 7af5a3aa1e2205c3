//! Acting in the real world, to have something that a world model can learn from.

mod episodes;
mod rollout_comparison;

use eframe::egui::{Ui, vec2};

use crate::app::{Command, Field, RecordCommand, WindowCommand};
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::dream::{banner, hand_over_button};
use crate::ui::record::rollout_comparison::{dream_beside_ui, drift_ui};
use crate::ui::settings::keymap::KeyAction;
use crate::ui::tokens::{self, GAP, Tokens};
use crate::ui::widgets::clip::{Rim, clip_button_ui, picture_ui};
use crate::ui::widgets::field::{field_ui, path_ui};
use crate::ui::widgets::gauge::{action_ui, figure_ui, row_color_ui, status_ui};
use crate::ui::widgets::keycap::{KeyButton, Tone};
use crate::ui::widgets::layout::{beside_picture, dream_shape, heading, scene_shape, titled_card, with_side};

/// What is said where nothing can be acted in.
pub(in crate::ui) const RECORDED_ONLY: &str = "This world is known from recordings alone: there is nothing here that could be acted in. All else works.";
/// Room for what stands under the picture.
const BELOW: f32 = 50.0;

pub(in crate::ui) fn record_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let about = "Act in the real world and keep what you did, to fit a world model of your own.";
    heading(ui, "Record", about);
    let main = |ui: &mut Ui, commands: &mut Commands| stage_ui(ui, state, commands);
    let aside = |ui: &mut Ui, commands: &mut Commands| aside_ui(ui, state, commands);
    let shape = shapes(state).iter().sum::<f32>();
    let side = beside_picture(ui, shape, BELOW);
    with_side(ui, side, commands, main, aside);
}

/// Width by height of the scene, and of the dream beside it where there is one.
fn shapes(state: &View<'_>) -> [f32; 2] {
    let record = &state.record;
    let picture = record.picture.as_ref().filter(|_| record.is_on && record.live.is_some());
    [scene_shape(state, picture), if record.rollout.asked.is_some() { dream_shape(state) } else { 0.0 }]
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
    let [scene, beside] = shapes(state);
    let gap = if is_beside { GAP } else { 0.0 };
    let height = ((room.x - gap) / (scene + beside)).min(room.y - BELOW).max(120.0);
    let label =
        live.map_or("The real world".to_owned(), |live| format!("The real world at step {}", live.step));
    let empty = if state.is_recorded_only() {
        RECORDED_ONLY
    } else if record.is_on {
        "Starting the world…"
    } else {
        "Press Record, then act with keys or a gamepad."
    };
    let rim = if is_paused { Rim::Accent } else { Rim::Plain };
    let to_come = state.scene(Field::RecordSeed).filter(|_| !record.is_on);
    let picture = record.picture.as_ref().filter(|_| live.is_some()).or(to_come);
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = gap;
        let response = picture_ui(ui, picture, vec2(height * scene, height), &label, empty, rim);
        if is_paused {
            banner(ui, response.rect, record.why_paused.unwrap_or("Paused"));
        } else if live.is_some_and(|live| live.is_planned) {
            banner(ui, response.rect, "The planner acts");
        } else if to_come.is_some() {
            banner(ui, response.rect, empty);
        }
        if is_beside {
            dream_beside_ui(ui, state, height);
        }
    });
    ui.add_space(6.0);
    // What the world moves by a key is not a command as long as somebody acts in it.
    let key = |key_action| state.settings.keys.free(key_action);
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().item_spacing.x = 8.0;
        if !record.is_on {
            let begin = state.settings.keys.of(KeyAction::Begin);
            let button = KeyButton::new("Record").key(begin).tone(Tone::Primary).width(150.0);
            if button.enabled(!state.is_recorded_only()).is_pressed(ui) {
                commands.push(Command::Record(RecordCommand::Start));
            }
            if state.has_clip() {
                clip_button_ui(ui, state, commands);
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

/// The present step, and how well the clock keeps.
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
            figure_ui(ui, step, &format!("step of {}", state.spec.longest_episode));
            figure_ui(ui, rate, &format!("steps a second of {}", state.spec.rate));
        });
        ui.add_space(6.0);
        let planned = live.filter(|live| live.is_planned || live.is_paused).map(|live| live.action);
        action_ui(ui, &state.spec.axes, planned.unwrap_or(state.dream.action));
        let n_late = live.map_or(0, |live| live.n_late);
        row_color_ui(
            ui,
            "Late steps",
            n_late.to_string(),
            if n_late > 0 { tokens.warn } else { tokens.text },
        );
        status_ui(ui, live.and_then(|live| live.status.as_ref()));
    });
}

/// The folder, and the seed of the next episode.
fn where_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    titled_card(ui, "Where", |ui| {
        path_ui(ui, state, Field::Dataset, "Folder of recordings", commands);
        field_ui(ui, state, Field::RecordSeed, "Seed of the episode", commands);
        ui.label(tokens::small(ui, "LeRobot v3: other programs can open it"));
    });
}
