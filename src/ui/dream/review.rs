//! A kept dream, looked at again: its pictures, who acted, and what the reward says of it.

use eframe::egui::{Key, Rect, Ui, UiBuilder, Vec2, pos2, vec2};

use crate::app::Playhead;
use crate::app::counted;
use crate::app::dream::resting;
use crate::app::{Command, DreamCommand, PlaybackCommand};
use crate::dream::DreamEpisode;
use crate::query::{DreamId, SEGMENT_LEN};
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::input;
use crate::ui::settings::keymap::KeyAction;
use crate::ui::tokens::{self, GAP, Tokens};
use crate::ui::widgets::clip::{Rim, clip_button_ui, picture_ui};
use crate::ui::widgets::keycap::{KeyButton, Tone};
use crate::ui::widgets::layout::{dream_shape, fitting, within};
use crate::ui::widgets::strip::{Strip, promises_ui, strip_ui};

/// The dream in the place of the one that is driven: a large picture over its strip.
pub(in crate::ui) fn review_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let Some(id) = state.review.dream else { return };
    let size = fitting(ui, dream_shape(state), 148.0);
    picture(ui, state, id, size);
    ui.add_space(2.0);
    strip(ui, state, id, 62.0, commands);
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().item_spacing = vec2(4.0, 2.0);
        moving_ui(ui, state, commands);
        let button = KeyButton::new("Delete").tone(Tone::Quiet).small();
        let response = button.show(ui).on_hover_text(resting(state, id).unwrap_or_else(|| {
            "Delete: nothing is asked about it any more; its file stays, so that it can be brought back"
                .to_owned()
        }));
        if response.clicked() || input::pressed(ui, Key::Delete) {
            commands.push(Command::Dream(DreamCommand::Delete(id)));
        }
        clip_button_ui(ui, state, commands);
        let begin = KeyButton::new("Drive").key(state.settings.keys.of(KeyAction::Begin)).small();
        if begin.is_pressed(ui) {
            commands.push(Command::Dream(DreamCommand::Start));
        }
        let close =
            KeyButton::new("Close").key(state.settings.keys.of(KeyAction::Leave)).tone(Tone::Quiet).small();
        if close.is_pressed(ui) {
            commands.push(Command::Dream(DreamCommand::Review(None)));
        }
    });
}

/// The dream beside what the reward says of it, in a card of `height` points.
pub(in crate::ui) fn judged_ui(ui: &mut Ui, state: &View<'_>, height: f32, commands: &mut Commands) {
    let Some(id) = state.review.dream else {
        ui.label(tokens::muted(ui, "No dream can be looked at: keep one first."));
        return;
    };
    let all = ui.available_rect_before_wrap();
    let all = Rect::from_min_size(all.min, vec2(all.width(), height));
    let size = within(vec2(all.width() * 0.42, height), dream_shape(state));
    let left = Rect::from_min_size(all.min, vec2(size.x, all.height()));
    let right = Rect::from_min_max(pos2(left.right() + GAP, all.top()), all.max);
    ui.scope_builder(UiBuilder::new().max_rect(left), |ui| picture(ui, state, id, size));
    ui.scope_builder(UiBuilder::new().max_rect(right), |ui| {
        ui.spacing_mut().item_spacing.y = 4.0;
        ui.horizontal(|ui| {
            ui.spacing_mut().item_spacing.x = 2.0;
            moving_ui(ui, state, commands);
            name_ui(ui, state);
        });
        let rest = right.bottom() - ui.cursor().top() - 4.0;
        strip(ui, state, id, (rest * 0.42).max(50.0), commands);
        promised(ui, state, rest * 0.58 - 30.0);
    });
    ui.advance_cursor_after_rect(all);
}

fn picture(ui: &mut Ui, state: &View<'_>, id: DreamId, size: Vec2) {
    let review = &state.review;
    let step = review.step();
    let label = format!("Dream {} at step {step}", id.0 + 1);
    let is_marked = review.episode().is_some_and(|episode| episode.unsafe_marks.contains(&step));
    let rim = if is_marked { Rim::Bad } else { Rim::Plain };
    picture_ui(ui, review.picture.as_ref(), size, &label, "Remembering…", rim);
}

fn strip(ui: &mut Ui, state: &View<'_>, id: DreamId, height: f32, commands: &mut Commands) {
    let review = &state.review;
    let Some(episode) = review.episode() else { return };
    let judgement = review.rewards.as_ref().filter(|judgement| judgement.dream == id);
    let queries = state.session().map_or(&[][..], |session| session.queries());
    let segments = queries.iter().flat_map(|asked| [asked.query.left, asked.query.right]);
    let asked: Vec<_> = segments
        .filter(|segment| segment.dream == id)
        .map(|segment| segment.start..segment.start + SEGMENT_LEN)
        .collect();
    let strip = Strip {
        len: episode.len(),
        step: review.step(),
        rewards: judgement.map(|all| [&all.rewards[..], &all.low, &all.high]),
        marks: &episode.unsafe_marks,
        planned: &episode.planned,
        asked: &asked,
        off: &[],
    };
    if let Some(step) = strip_ui(ui, strip, height) {
        commands.push(Command::Playback(PlaybackCommand::Scrub(step)));
    }
}

/// Going through what is looked at.
pub(in crate::ui) fn playing_ui(
    ui: &mut Ui,
    state: &View<'_>,
    head: Playhead,
    step: usize,
    commands: &mut Commands,
) {
    let name = if head.is_playing { "Stop" } else { "Play" };
    if KeyButton::new(name).key(state.settings.keys.of(KeyAction::Pause)).small().is_pressed(ui) {
        commands.push(Command::Playback(PlaybackCommand::Play));
    }
    for (name, key_action, to) in [
        ("Back", KeyAction::Back, step.saturating_sub(1)),
        ("On", KeyAction::Forward, step.saturating_add(1)),
    ] {
        let button = KeyButton::new(name).key(state.settings.keys.of(key_action)).tone(Tone::Quiet).small();
        if button.is_pressed(ui) {
            commands.push(Command::Playback(PlaybackCommand::Scrub(to)));
        }
    }
}

/// Going to the one before and the one after, where there is one.
pub(in crate::ui) fn neighbors_ui(
    ui: &mut Ui,
    noun: &str,
    has_before: bool,
    has_after: bool,
    commands: &mut Commands,
) {
    for (name, key, by, is_there) in
        [("before", Key::PageUp, -1, has_before), ("after", Key::PageDown, 1, has_after)]
    {
        let button = KeyButton::new(if by < 0 { "‹" } else { "›" }).tone(Tone::Quiet).small();
        let response = button.enabled(is_there).show(ui).on_hover_text(format!("{noun} {name}"));
        if is_there && (response.clicked() || input::pressed(ui, key)) {
            commands.push(Command::Playback(PlaybackCommand::Next(by)));
        }
    }
}

/// Going through the dream, and to others.
fn moving_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    playing_ui(ui, state, state.review.head, state.review.step(), commands);
    let all = state.reviewable();
    let here = all.iter().position(|id| Some(*id) == state.review.dream);
    let has_after = here.is_some_and(|here| here + 1 < all.len());
    neighbors_ui(ui, "Dream", here.is_some_and(|here| here > 0), has_after, commands);
}

/// Which dream it is, and who drove it.
fn name_ui(ui: &mut Ui, state: &View<'_>) {
    let review = &state.review;
    let planned = review.episode().map_or(0, DreamEpisode::n_planned);
    let who = if planned > 0 { format!(", {planned} by the planner") } else { String::new() };
    let of = review.episode().map_or_else(String::new, |episode| counted(episode.len(), "step") + &who);
    if let Some(id) = review.dream {
        ui.label(tokens::small(ui, format!("Dream {} · {of}", id.0 + 1)));
    }
}

/// What the planner would do from here, now and by the weights before.
fn promised(ui: &mut Ui, state: &View<'_>, height: f32) {
    let Some(view) = state.review.view.as_ref().filter(|view| !view.promises.is_empty()) else {
        ui.label(tokens::small(ui, "What the planner would do from here is shown once a reward is learned."));
        return;
    };
    let best = &view.promises[view.chosen];
    let text = match view.chosen_before {
        None => format!("From here the planner would do {}: {:.2}", best.actions, best.now),
        Some(before) if before == view.chosen => format!(
            "The planner would still do {}: {:.2}, before {:.2}",
            best.actions,
            best.now,
            best.before.unwrap_or(best.now)
        ),
        Some(before) => format!(
            "The planner would now do {} ({:.2}), before {}",
            best.actions, best.now, view.promises[before].actions
        ),
    };
    let color = if view.chosen_before.is_some_and(|before| before != view.chosen) {
        Tokens::of(ui).warn
    } else {
        Tokens::of(ui).muted
    };
    let label = eframe::egui::Label::new(tokens::small(ui, text.as_str()).color(color)).truncate();
    ui.add(label).on_hover_text(text);
    promises_ui(ui, &view.promises, view.chosen, view.chosen_before, height.max(30.0));
}
