//! Recorded episodes: which there are, and one of them looked at again.

use eframe::egui::{Key, ScrollArea, Ui, vec2};

use crate::app::counted;
use crate::app::{Command, PlaybackCommand, RecordCommand};
use crate::dataset::Summary;
use crate::session::date;
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::dream::review::{neighbors_ui, playing_ui};
use crate::ui::input;
use crate::ui::settings::keymap::KeyAction;
use crate::ui::tokens::{self, Tokens};
use crate::ui::widgets::clip::{Rim, picture_ui};
use crate::ui::widgets::gauge::{action_ui, capitalized, figure_ui, row_button, row_color_ui, row_ui};
use crate::ui::widgets::keycap::{KeyButton, Tone};
use crate::ui::widgets::layout::{dream_shape, fitting, titled_card};
use crate::ui::widgets::strip::{Strip, strip_ui};
use crate::world::EventKind;

/// The height of a row of the list.
const ROW: f32 = 24.0;
/// The height of the strip under the picture.
const STRIP: f32 = 62.0;
/// Rows that are seen at a time.
const N_ROWS: usize = 12;

/// An episode in the place of the world that is acted in: a large picture over its strip.
pub(in crate::ui) fn watch_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let episodes = &state.episodes;
    let size = fitting(ui, dream_shape(state), 148.0);
    let step = episodes.step();
    let number = episodes.summary().map_or(0, |summary| summary.number);
    let is_off =
        episodes.episode.as_ref().is_some_and(|it| it.unsafe_steps.iter().any(|range| range.contains(&step)));
    let rim = if is_off { Rim::Bad } else { Rim::Plain };
    let label = format!("Episode {number} at step {step}");
    picture_ui(ui, episodes.picture.as_ref(), size, &label, "Reading the episode…", rim);
    ui.add_space(2.0);
    if let Some(episode) = &episodes.episode {
        let strip = Strip {
            len: episodes.len(),
            step,
            rewards: episodes.rewards.as_ref().map(|[mean, low, high]| [&mean[..], low, high]),
            marks: &[],
            planned: &episode.planned,
            asked: &[],
            off: &episode.unsafe_steps,
        };
        if let Some(step) = strip_ui(ui, strip, STRIP) {
            commands.push(Command::Playback(PlaybackCommand::Scrub(step)));
        }
    } else {
        ui.allocate_space(vec2(1.0, STRIP));
    }
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 6.0;
        if episodes.is_asked {
            really_ui(ui, number, commands);
            return;
        }
        playing_ui(ui, state, episodes.head, step, commands);
        if let Some((here, n)) = episodes.place() {
            neighbors_ui(ui, "Episode", here > 0, here + 1 < n, commands);
        }
        let delete = KeyButton::new("Delete…").key(Key::Delete).tone(Tone::Quiet).small();
        if delete.is_pressed(ui) {
            commands.push(Command::Record(RecordCommand::AskToDelete(true)));
        }
        let close =
            KeyButton::new("Close").key(state.settings.keys.of(KeyAction::Leave)).tone(Tone::Quiet).small();
        if close.is_pressed(ui) {
            commands.push(Command::Record(RecordCommand::Watch(None)));
        }
    });
}

/// Asks once more.
fn really_ui(ui: &mut Ui, number: usize, commands: &mut Commands) {
    ui.label(tokens::muted(ui, format!("Delete episode {number} from the folder?")));
    let yes = KeyButton::new("Yes, delete it").key(Key::Enter).small().show(ui).on_hover_text(
        "The episodes after it move up. It can be brought back, as the last one, until another is deleted. \
         World models that were fitted before name the episodes they never saw by their numbers.",
    );
    if yes.clicked() || input::pressed(ui, Key::Enter) {
        commands.push(Command::Record(RecordCommand::DeleteEpisode));
    }
    if KeyButton::new("No, keep it").key(Key::Escape).tone(Tone::Quiet).small().is_pressed(ui) {
        commands.push(Command::Record(RecordCommand::AskToDelete(false)));
    }
}

/// What was done at the step that is looked at.
pub(in crate::ui) fn then_ui(ui: &mut Ui, state: &View<'_>) {
    let episodes = &state.episodes;
    titled_card(ui, "Then", |ui| {
        let Some((episode, summary)) = episodes.episode.as_ref().zip(episodes.summary()) else {
            ui.label(tokens::muted(ui, "Reading the episode…"));
            return;
        };
        let step = episodes.step();
        figure_ui(ui, step.to_string(), &format!("step of {}", episodes.len()));
        ui.add_space(6.0);
        action_ui(ui, &state.spec.axes, episode.actions.get(step).copied().unwrap_or_default());
        let is = |ranges: &[std::ops::Range<usize>]| ranges.iter().any(|range| range.contains(&step));
        let driver = if is(&episode.planned) { "the planner" } else { &summary.info.pilot };
        row_ui(ui, "In control", driver);
        row_ui(ui, "By the planner", counted(summary.n_planned, "step"));
        let (off, color) = if is(&episode.unsafe_steps) {
            ("yes", Tokens::of(ui).warn)
        } else {
            ("no", Tokens::of(ui).text)
        };
        row_color_ui(ui, "Unsafe", off, color);
        for (name, share) in &summary.events {
            row_ui(ui, &capitalized(name), format!("{:.0} % of the steps", 100.0 * share));
        }
        row_ui(ui, "Recorded", date(summary.began_secs.max(0) as u64) + " UTC");
        row_ui(ui, "Seed", summary.info.seed.to_string());
        let end = if summary.done { "by the world" } else { "by hand" };
        row_ui(ui, "Ended", end);
    });
}

/// The episodes of the folder, the latest first; only those that are seen cost anything.
pub(in crate::ui) fn list_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let episodes = &state.episodes;
    titled_card(ui, "Episodes", |ui| {
        if episodes.is_changing() {
            ui.label(tokens::small(ui, "Putting the folder in order…"));
        }
        let Some(list) = &episodes.list else {
            ui.label(tokens::muted(ui, "Looking…"));
            return;
        };
        let n = list.episodes.len();
        if n == 0 {
            ui.label(tokens::muted(ui, "None in this folder yet. Record one, and keep it."));
        }
        ui.spacing_mut().item_spacing.y = 2.0;
        let height = (ROW + 2.0) * n.min(N_ROWS) as f32;
        let rows = ScrollArea::vertical().id_salt("episodes").max_height(height);
        rows.show_rows(ui, ROW, n, |ui, rows| {
            for summary in rows.map(|row| &list.episodes[n - 1 - row]) {
                row(ui, state, summary, commands);
            }
        });
        if !list.damaged.is_empty() {
            let text = format!("{} cannot be read", counted(list.damaged.len(), "file"));
            let label = ui.label(tokens::small(ui, text).color(Tokens::of(ui).warn));
            label.on_hover_text(list.damaged.join("\n"));
        }
        if let Some(deleted) = list.deleted.as_ref().filter(|_| !episodes.is_changing()) {
            let button = KeyButton::new("Bring back the deleted one").tone(Tone::Quiet).small().show(ui);
            let about =
                format!("{} steps, recorded {} UTC", deleted.n_steps, date(deleted.began_secs.max(0) as u64));
            if button.on_hover_text(about).clicked() {
                let (dataset, recording) = (list.dataset.clone(), deleted.recording.clone());
                commands.push(Command::Record(RecordCommand::RestoreEpisode { dataset, recording }));
            }
        }
    });
}

/// The share of steps in which what must not happen most goes on.
fn unsafe_share(state: &View<'_>, summary: &Summary) -> f64 {
    let is_unsafe = |name: &str| state.spec.events_of(EventKind::Safety).any(|event| event.name == name);
    let shares = summary.events.iter().filter(|(name, _)| is_unsafe(name)).map(|(_, share)| *share);
    shares.fold(0.0, f64::max)
}

fn row(ui: &mut Ui, state: &View<'_>, summary: &Summary, commands: &mut Commands) {
    let unsafe_share = unsafe_share(state, summary);
    let off = match unsafe_share {
        0.0 => String::new(),
        share => format!(" · {:.0} % unsafe", (100.0 * share).max(1.0)),
    };
    let shared = if summary.n_planned > 0 { " · shared" } else { "" };
    let about = format!("{} steps{off}{shared}", summary.n_steps);
    let is_chosen = state.is_watching() && state.episodes.open.as_ref() == Some(&summary.recording);
    let response = row_button(ui, &format!("Episode {}", summary.number), &about, is_chosen);
    let hover = format!(
        "By {} on {} UTC, {:.1} % of the steps unsafe\nLook at it again, or delete it",
        summary.info.pilot,
        date(summary.began_secs.max(0) as u64),
        100.0 * unsafe_share
    );
    if response.on_hover_text(hover).clicked() && !state.episodes.is_changing() {
        commands.push(Command::Record(RecordCommand::Watch(Some(summary.recording.clone()))));
    }
}
