//! Driving where nothing real can break.

pub(super) mod review;

use eframe::egui::{Rect, Role, ScrollArea, Sense, Stroke, StrokeKind, Ui, WidgetInfo, vec2};

use crate::app::counted;
use crate::app::{Command, DreamCommand, Panel, WindowCommand};
use crate::env::{MAX_STEPS, STEPS_PER_SEC};
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::settings::keymap::KeyAction;
use crate::ui::tokens::{self, GAP, Tokens};
use crate::ui::widgets::clip::{Rim, paint_picture, picture_ui};
use crate::ui::widgets::gauge::{action_ui, figure_ui, row_button, row_color_ui, row_ui};
use crate::ui::widgets::keycap::{KeyButton, Tone, key_name};
use crate::ui::widgets::layout::{beside_picture, heading, titled_card, with_side};
use crate::worker::LiveView;
use review::review_ui;

/// Width by height of a dream.
const SHAPE: f32 = 1.0;
/// Room for what stands under the picture.
const BELOW: f32 = 110.0;

pub(in crate::ui) fn dream_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    heading(
        ui,
        "Dream",
        "Drive inside the world model. Drive well, and drive badly too: both are worth asking about.",
    );
    if state.world.loading.is_some() {
        ui.label(tokens::muted(ui, "Reading the world model…"));
        return;
    }
    if state.world.loaded.as_ref().is_none_or(|world| world.starts.is_empty()) {
        let why = match &state.world.loaded {
            None => "A dream needs a world model.",
            Some(_) => "This world model came without states to begin from.",
        };
        ui.label(why);
        ui.add_space(GAP);
        if KeyButton::new("Choose a world model").tone(Tone::Primary).is_pressed(ui) {
            commands.push(Command::Window(WindowCommand::Show(Panel::World)));
        }
        return;
    }
    let main = |ui: &mut Ui, commands: &mut Commands| stage_ui(ui, state, commands);
    let aside = |ui: &mut Ui, commands: &mut Commands| aside_ui(ui, state, commands);
    let side = beside_picture(ui, SHAPE, BELOW);
    with_side(ui, side, commands, main, aside);
}

fn stage_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let dream = &state.dream;
    if state.is_reviewing() {
        return review_ui(ui, state, commands);
    }
    let room = ui.available_size();
    let side = (room.y - BELOW).min(room.x).max(120.0);
    let live = dream.live.as_ref().filter(|_| dream.is_on);
    let thumbnail = dream.thumbnails.get(dream.start_idx).and_then(Option::as_ref);
    let picture = if dream.is_on { dream.picture.as_ref() } else { thumbnail.or(dream.picture.as_ref()) };
    let label =
        live.map_or("The start of the dream".to_owned(), |live| format!("The dream at step {}", live.step));
    let empty = if dream.is_on { "Falling asleep…" } else { "" };
    let is_paused = live.is_some_and(|live| live.is_paused);
    let rim = if is_paused { Rim::Accent } else { Rim::Plain };
    let response = picture_ui(ui, picture, vec2(side, side), &label, empty, rim);
    if is_paused {
        banner(ui, response.rect, dream.why_paused.unwrap_or("Paused"));
    } else if live.is_some_and(|live| live.is_planned) {
        banner(ui, response.rect, "The planner drives");
    }
    ui.add_space(6.0);
    if dream.is_on {
        driving_ui(ui, state, is_paused, commands);
    } else {
        starts_ui(ui, state, commands);
    }
}

/// A word over a picture.
pub(super) fn banner(ui: &Ui, over: Rect, text: &str) {
    use eframe::egui::{Align2, Color32, CornerRadius, FontId};
    let font = FontId::proportional(15.0);
    let galley = ui.painter().layout_no_wrap(text.to_owned(), font, Color32::WHITE);
    let at = Align2::CENTER_TOP.anchor_size(over.center_top() + vec2(0.0, 20.0), galley.size());
    ui.painter().rect_filled(
        at.expand2(vec2(14.0, 7.0)),
        CornerRadius::same(14),
        Color32::from_black_alpha(190),
    );
    ui.painter().galley(at.min, galley, Color32::WHITE);
}

fn driving_ui(ui: &mut Ui, state: &View<'_>, is_paused: bool, commands: &mut Commands) {
    let is_ending = state.dream.is_ending;
    let key = |key_action| state.settings.keys.of(key_action);
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().item_spacing.x = 8.0;
        for (button, command) in [
            (
                KeyButton::new("Keep").key(key(KeyAction::Keep)).tone(Tone::Primary).enabled(!is_ending),
                Command::Dream(DreamCommand::Keep),
            ),
            (
                KeyButton::new("Unsafe now").key(key(KeyAction::Unsafe)),
                Command::Dream(DreamCommand::MarkUnsafe),
            ),
            (
                KeyButton::new(if is_paused { "Go on" } else { "Pause" }).key(key(KeyAction::Pause)),
                Command::Dream(DreamCommand::Pause),
            ),
            (hand_over_button(state, state.dream.live.as_ref()), Command::Window(WindowCommand::HandOver)),
            (KeyButton::new("Redo").key(key(KeyAction::Redo)), Command::Dream(DreamCommand::Redo)),
            (
                KeyButton::new("Leave").key(key(KeyAction::Leave)).tone(Tone::Quiet),
                Command::Dream(DreamCommand::Leave),
            ),
        ] {
            if button.is_pressed(ui) {
                commands.push(command);
            }
        }
        if is_paused && KeyButton::new("Step").key(key(KeyAction::Step)).is_pressed(ui) {
            commands.push(Command::Dream(DreamCommand::Step));
        }
    });
}

/// Who has the wheel gives it to the other.
pub(super) fn hand_over_button<'a>(state: &View<'_>, live: Option<&LiveView>) -> KeyButton<'a> {
    let is_planned = live.is_some_and(|live| live.is_planned);
    let name = if is_planned { "Take over" } else { "Hand over" };
    KeyButton::new(name).key(state.settings.keys.of(KeyAction::HandOver))
}

fn starts_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let Some(world) = &state.world.loaded else { return };
    ui.horizontal(|ui| {
        let drive = KeyButton::new("Drive").key(state.settings.keys.of(KeyAction::Begin)).tone(Tone::Primary);
        if drive.size(vec2(150.0, 64.0)).is_pressed(ui) {
            commands.push(Command::Dream(DreamCommand::Start));
        }
        ui.add_space(8.0);
        ui.vertical(|ui| {
            ui.label(tokens::small(ui, "Begin here"));
            ScrollArea::horizontal().id_salt("starts").show(ui, |ui| {
                ui.horizontal(|ui| {
                    for (idx, start) in world.starts.iter().enumerate() {
                        if start_ui(ui, state, idx, &start.name) {
                            commands.push(Command::Dream(DreamCommand::ChooseStart(idx)));
                        }
                    }
                });
            });
        });
    });
}

fn start_ui(ui: &mut Ui, state: &View<'_>, idx: usize, name: &str) -> bool {
    let tokens = Tokens::of(ui);
    let is_chosen = state.dream.start_idx == idx;
    let (rect, response) = ui.allocate_exact_size(vec2(66.0, 66.0), Sense::click());
    response.widget_info(|| WidgetInfo::selected(Role::RadioButton, true, is_chosen, name));
    let inner = rect.shrink(3.0);
    let thumbnail = state.dream.thumbnails.get(idx).and_then(Option::as_ref);
    paint_picture(ui, thumbnail, inner, name, Rim::Plain);
    if is_chosen || response.hovered() || response.has_focus() {
        let color = if is_chosen { tokens.accent } else { tokens.faint };
        ui.painter().rect_stroke(inner, 6.0, Stroke::new(2.0, color), StrokeKind::Outside);
    }
    response.on_hover_text(name).clicked()
}

fn aside_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let tokens = Tokens::of(ui);
    let live = state.dream.live.as_ref();
    if state.is_reviewing() {
        then_ui(ui, state);
        kept_ui(ui, state, commands);
        return;
    }
    titled_card(ui, "Now", |ui| {
        let is_on = state.dream.is_on;
        let (rate, step) = match live.filter(|_| is_on) {
            Some(live) => (format!("{:.0}", live.steps_per_sec), live.step.to_string()),
            None => ("–".to_owned(), "–".to_owned()),
        };
        ui.horizontal(|ui| {
            ui.spacing_mut().item_spacing.x = 28.0;
            figure_ui(ui, step, &format!("step of {MAX_STEPS}"));
            figure_ui(ui, rate, &format!("steps a second of {STEPS_PER_SEC}"));
        });
        ui.add_space(6.0);
        let action = live
            .filter(|live| is_on && (live.is_paused || live.is_planned))
            .map_or(state.dream.action, |live| live.action);
        action_ui(ui, if is_on { action } else { crate::env::Action::default() });
        ui.add_space(2.0);
        let n_late = live.map_or(0, |live| live.n_late);
        let color = if n_late > 0 { tokens.warn } else { tokens.text };
        row_color_ui(ui, "Late steps", n_late.to_string(), color);
        let pictures =
            live.filter(|_| is_on).map_or("–".to_owned(), |live| format!("{:.0}", live.pictures_per_sec));
        row_ui(ui, "Pictures a second", pictures);
        row_ui(ui, "Unsafe marks", live.map_or(0, |live| live.n_unsafe_marks).to_string());
    });
    kept_ui(ui, state, commands);
    titled_card(ui, "At the wheel", |ui| {
        for (name, key_actions) in [
            ("Steer", &[KeyAction::SteerLeft, KeyAction::SteerRight][..]),
            ("Gas", &[KeyAction::Gas]),
            ("Brake", &[KeyAction::Brake]),
        ] {
            let nth = |idx: usize| {
                let keys =
                    key_actions.iter().filter_map(|key_action| state.settings.keys.all(*key_action).get(idx));
                keys.map(|key| key_name(*key)).collect::<Vec<_>>().join(", ")
            };
            row_ui(ui, name, format!("{} · {}", nth(0), nth(1)));
        }
        row_ui(ui, "Gamepad", "left stick and triggers");
    });
}

/// What was done at the step of a kept dream that is looked at.
fn then_ui(ui: &mut Ui, state: &View<'_>) {
    titled_card(ui, "Then", |ui| {
        let Some(episode) = state.review.episode() else { return };
        let step = state.review.step();
        figure_ui(ui, step.to_string(), &format!("step of {}", episode.len()));
        ui.add_space(6.0);
        action_ui(ui, episode.actions.get(step).copied().unwrap_or_default());
        row_ui(ui, "At the wheel", if episode.is_planned(step) { "the planner" } else { "by hand" });
        row_ui(ui, "By the planner", counted(episode.n_planned(), "step"));
        row_ui(ui, "Unsafe marks", episode.unsafe_marks.len().to_string());
    });
}

fn kept_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    titled_card(ui, "Kept dreams", |ui| {
        let Some(session) = state.session() else {
            ui.label(tokens::muted(ui, "None yet. Drive, and keep what you have driven."));
            return;
        };
        let dreams: Vec<_> = session.dreams().iter().filter(|kept| !session.is_dropped(kept.dream)).collect();
        if dreams.is_empty() {
            ui.label(tokens::muted(ui, "None yet. Drive, and keep what you have driven."));
            return;
        }
        for kept in dreams.iter().rev().take(12) {
            let marks = match kept.marks.len() {
                0 => String::new(),
                n => format!(" · {}", counted(n, "mark")),
            };
            let by_planner = if kept.planned > 0 { " · shared" } else { "" };
            let about = format!("{} steps{marks}{by_planner}", kept.len);
            let is_chosen = state.review.dream == Some(kept.dream) && state.is_reviewing();
            let response = row_button(ui, &format!("Dream {}", kept.dream.0 + 1), &about, is_chosen);
            if response.on_hover_text("Look at it again, or delete it").clicked() && !state.dream.is_on {
                commands.push(Command::Dream(DreamCommand::Review(Some(kept.dream))));
            }
        }
        if dreams.len() > 12 {
            ui.label(tokens::small(ui, format!("and {} before", dreams.len() - 12)));
        }
    });
}
