//! Episodes that the planner drove in this window: which there are, and one of them looked at again.

use eframe::egui::{ScrollArea, Ui, vec2};

use crate::app::evaluate::{DrivenHere, Replay};
use crate::app::{Command, EvaluateCommand, PlaybackCommand, counted};
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::dream::review::{neighbors_ui, playing_ui};
use crate::ui::settings::keymap::KeyAction;
use crate::ui::tokens::{self, Tokens};
use crate::ui::widgets::clip::{Rim, picture_ui};
use crate::ui::widgets::gauge::{
    action_ui, capitalized, figure_ui, progress_ui, row_button, row_color_ui, row_ui,
};
use crate::ui::widgets::keycap::{KeyButton, Tone};
use crate::ui::widgets::layout::{beside_picture, dream_shape, fitting, titled_card, with_side};
use crate::ui::widgets::strip::{Strip, strip_ui};

/// The height of the strip under the picture.
const STRIP: f32 = 44.0;
/// The height of all that stands under the picture.
const BELOW: f32 = 130.0;
/// Episodes that are seen at a time.
const N_ROWS: usize = 8;
/// The height of a row.
const ROW: f32 = 24.0;

/// The episodes, the latest first; only those that are seen cost anything.
pub(super) fn driven_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let driven = &state.evaluate.driven;
    let n = driven.len();
    if n == 0 {
        let text = "None yet. What the planner drives to its end in Deploy stands here, and can be looked at again. Of \
                    episodes in files only the figures are known.";
        ui.label(tokens::muted(ui, text));
        return;
    }
    let about = if state.can_replay() {
        "Choose one to look at it: it is driven again by its seed and actions, and comes out the same. Of episodes in files only \
         the figures are known."
    } else {
        "These cannot be looked at again: only what a built-in world does can be done over, another might be a machine."
    };
    ui.label(tokens::small(ui, about));
    ui.spacing_mut().item_spacing.y = 2.0;
    let rows = ScrollArea::vertical().id_salt("driven").max_height((ROW + 2.0) * n.min(N_ROWS) as f32);
    rows.show_rows(ui, ROW, n, |ui, rows| {
        for i in rows.map(|row| n - 1 - row) {
            let it = &driven[i];
            let name = format!("Episode {} on seed {}", i + 1, it.seed);
            if row_button(ui, &name, &told(state, it), false).clicked() {
                commands.push(Command::Evaluate(EvaluateCommand::Watch(Some(i))));
            }
        }
    });
}

/// How an episode went, in a line.
fn told(state: &View<'_>, it: &DrivenHere) -> String {
    let results = state.evaluate.results.iter().find(|results| results.id == it.results);
    let of = results.map_or_else(String::new, |results| format!(" · {}", results.name));
    format!(
        "return {:.0} · {:.1} % unsafe · {} · knew {}{of}",
        it.metrics.ret,
        100.0 * it.metrics.unsafe_rate,
        counted(it.metrics.n_steps, "step"),
        counted(it.n_answers, "answer"),
    )
}

/// An episode in the place of all else: a large picture over its strip.
pub(super) fn replay_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let Some((replay, driven)) = state.replayed() else { return };
    let main = |ui: &mut Ui, commands: &mut Commands| watch_ui(ui, state, (replay, driven), commands);
    let aside = |ui: &mut Ui, _: &mut Commands| then_ui(ui, state, (replay, driven));
    let side = beside_picture(ui, dream_shape(state), BELOW);
    with_side(ui, side, commands, main, aside);
}

fn watch_ui(
    ui: &mut Ui,
    state: &View<'_>,
    (replay, driven): (&Replay, &DrivenHere),
    commands: &mut Commands,
) {
    let (step, len) = (state.replay_step(), driven.actions.len());
    let off = replay.over.as_ref().map_or(&[][..], |(off, _)| off);
    let rim = if off.iter().any(|range| range.contains(&step)) { Rim::Bad } else { Rim::Plain };
    let label = format!("Episode {} at step {step}", replay.driven + 1);
    let size = fitting(ui, dream_shape(state), BELOW);
    picture_ui(ui, replay.picture.as_ref(), size, &label, "Driving it again…", rim);
    ui.add_space(2.0);
    let strip = Strip { len, step, rewards: None, marks: &[], planned: &[], asked: &[], off };
    if let Some(step) = strip_ui(ui, strip, STRIP) {
        commands.push(Command::Playback(PlaybackCommand::Scrub(step)));
    }
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 6.0;
        playing_ui(ui, state, replay.head, step, commands);
        let n = state.evaluate.driven.len();
        neighbors_ui(ui, "Episode", replay.driven > 0, replay.driven + 1 < n, commands);
        let close =
            KeyButton::new("Close").key(state.settings.keys.of(KeyAction::Leave)).tone(Tone::Quiet).small();
        if close.is_pressed(ui) {
            commands.push(Command::Evaluate(EvaluateCommand::Watch(None)));
        }
    });
    if replay.over.is_none() {
        ui.add_space(2.0);
        ui.allocate_ui(vec2(size.x, 20.0), |ui| {
            progress_ui(ui, "Driving it again", replay.done as f32 / len.max(1) as f32);
        });
    }
}

/// What was done at the step that is looked at, and how the episode went.
fn then_ui(ui: &mut Ui, state: &View<'_>, (replay, driven): (&Replay, &DrivenHere)) {
    let step = state.replay_step();
    titled_card(ui, "Then", |ui| {
        figure_ui(ui, step.to_string(), &format!("step of {}", driven.actions.len()));
        ui.add_space(6.0);
        action_ui(ui, &state.spec.axes, driven.actions.get(step).copied().unwrap_or_default());
        ui.label(tokens::small(ui, "As the planner asked"));
    });
    titled_card(ui, &format!("Episode {}", replay.driven + 1), |ui| {
        let metrics = &driven.metrics;
        row_ui(ui, "Seed", driven.seed.to_string());
        row_ui(ui, "Return", format!("{:.0}", metrics.ret));
        row_ui(ui, "Unsafe", format!("{:.1} % of steps", 100.0 * metrics.unsafe_rate));
        for figure in &metrics.events {
            row_ui(ui, &capitalized(&figure.name), figure.shown());
        }
        row_ui(ui, "The reward knew", counted(driven.n_answers, "answer"));
        let tokens = Tokens::of(ui);
        let (text, color) = match &replay.over {
            None => ("under way", tokens.muted),
            Some((_, true)) => ("the same figures", tokens.good),
            Some((_, false)) => ("other figures", tokens.bad),
        };
        row_color_ui(ui, "Driven again", text, color);
    });
}
