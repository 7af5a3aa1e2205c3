//! Acting where nothing real can break.

pub(super) mod review;

use eframe::egui::{Rect, Role, ScrollArea, Sense, Stroke, StrokeKind, Ui, WidgetInfo, vec2};

use crate::app::counted;
use crate::app::{Command, DreamCommand, Panel, WindowCommand};
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::guide;
use crate::ui::settings::keymap::{KeyAction, known_key};
use crate::ui::tokens::{self, GAP, Tokens};
use crate::ui::widgets::clip::{Rim, paint_picture, picture_ui};
use crate::ui::widgets::gauge::{action_ui, capitalized, figure_ui, row_button, row_color_ui, row_ui};
use crate::ui::widgets::keycap::{KeyButton, Tone, key_name};
use crate::ui::widgets::layout::{
    beside_picture, dream_shape, fitting, heading, thumbnail_size, titled_card, with_side,
};
use crate::worker::LiveView;
use crate::world::Action;
use crate::world::controls::{Lever, lever_of};
use review::review_ui;

/// Room for what stands under the picture.
const BELOW: f32 = 110.0;

pub(in crate::ui) fn dream_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    heading(
        ui,
        "Dream",
        "Act inside the world model. Do it well, and badly too: both are worth asking about.",
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
    let side = beside_picture(ui, dream_shape(state), BELOW);
    with_side(ui, side, commands, main, aside);
}

fn stage_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let dream = &state.dream;
    if state.is_reviewing() {
        return review_ui(ui, state, commands);
    }
    let size = fitting(ui, dream_shape(state), BELOW);
    let live = dream.live.as_ref().filter(|_| dream.is_on);
    let thumbnail = dream.thumbnails.get(dream.start_idx).and_then(Option::as_ref);
    let picture = if dream.is_on { dream.picture.as_ref() } else { thumbnail.or(dream.picture.as_ref()) };
    let label =
        live.map_or("The start of the dream".to_owned(), |live| format!("The dream at step {}", live.step));
    let empty = if dream.is_on { "Falling asleep…" } else { "" };
    let is_paused = live.is_some_and(|live| live.is_paused);
    let rim = if is_paused { Rim::Accent } else { Rim::Plain };
    let response = picture_ui(ui, picture, size, &label, empty, rim);
    if is_paused {
        banner(ui, response.rect, dream.why_paused.unwrap_or("Paused"));
    } else if live.is_some_and(|live| live.is_planned) {
        banner(ui, response.rect, "The planner acts");
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
    // What the world moves by a key is not a command as long as somebody acts in it.
    let key = |key_action| state.settings.keys.free(key_action);
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

/// Who has the controls gives them to the other.
pub(super) fn hand_over_button<'a>(state: &View<'_>, live: Option<&LiveView>) -> KeyButton<'a> {
    let is_planned = live.is_some_and(|live| live.is_planned);
    let name = if is_planned { "Take over" } else { "Hand over" };
    KeyButton::new(name).key(state.settings.keys.free(KeyAction::HandOver))
}

fn starts_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let Some(world) = &state.world.loaded else { return };
    ui.horizontal(|ui| {
        let drive = KeyButton::new("Begin").key(state.settings.keys.of(KeyAction::Begin)).tone(Tone::Primary);
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
    let (rect, response) =
        ui.allocate_exact_size(thumbnail_size(state, 60.0) + vec2(6.0, 6.0), Sense::click());
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
            figure_ui(ui, step, &format!("step of {}", state.spec.longest_episode));
            figure_ui(ui, rate, &format!("steps a second of {}", state.spec.rate));
        });
        ui.add_space(6.0);
        let action = live
            .filter(|live| is_on && (live.is_paused || live.is_planned))
            .map_or(state.dream.action, |live| live.action);
        action_ui(ui, &state.spec.axes, if is_on { action } else { Action::default() });
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
    controls_ui(ui, state);
}

/// Axes beyond so many are left out: their keys are in the list of keys.
const MOST_AXES: usize = 8;

/// What moves each axis.
fn controls_ui(ui: &mut Ui, state: &View<'_>) {
    titled_card(ui, "Controls", |ui| {
        let keys = &state.settings.keys;
        for axis in state.spec.axes.iter().take(MOST_AXES) {
            let mut sides: Vec<(f32, Vec<&str>)> = Vec::new();
            for input in &axis.keys {
                let Some(name) = known_key(&input.key) else { continue };
                let name = key_name(keys.of_move(name));
                match sides.iter_mut().find(|(to, _)| *to == input.to) {
                    Some((_, names)) => names.push(name),
                    None => sides.push((input.to, vec![name])),
                }
            }
            let most = sides.iter().map(|(_, names)| names.len()).max().unwrap_or(0);
            let nth = |idx: usize| {
                sides.iter().filter_map(|(_, names)| names.get(idx).copied()).collect::<Vec<_>>().join(", ")
            };
            let mut by: Vec<String> = (0..most).map(nth).collect();
            if by.is_empty() {
                let wanted = state.settings.controls.of(&axis.name).pad.or(lever_of(axis));
                by.push(wanted.map_or("–", Lever::name).to_owned());
            }
            row_ui(ui, &capitalized(&axis.name), by.join(" · "));
        }
        if state.spec.axes.len() > MOST_AXES {
            ui.label(tokens::small(ui, format!("and {} more", state.spec.axes.len() - MOST_AXES)));
        }
        row_ui(ui, "Gamepad", pad_parts(state));
    });
}

/// What of a gamepad is used.
fn pad_parts(state: &View<'_>) -> &'static str {
    let levers = state.spec.axes.iter().map(|axis| {
        let chosen = state.settings.controls.of(&axis.name).pad.or(lever_of(axis));
        chosen.map_or_else(|| axis.pad.first().map(|input| input.axis.name()), |lever| Some(lever.name()))
    });
    let named: Vec<&str> = levers.flatten().collect();
    let has = |part: &str| named.iter().any(|name| name.contains(part));
    match (has("stick"), has("trigger")) {
        (true, true) => "sticks and triggers",
        (true, false) => "sticks",
        (false, true) => "triggers",
        (false, false) => "not used",
    }
}

/// What was done at the step of a kept dream that is looked at.
fn then_ui(ui: &mut Ui, state: &View<'_>) {
    titled_card(ui, "Then", |ui| {
        let Some(episode) = state.review.episode() else { return };
        let step = state.review.step();
        figure_ui(ui, step.to_string(), &format!("step of {}", episode.len()));
        ui.add_space(6.0);
        action_ui(ui, &state.spec.axes, episode.actions.get(step).copied().unwrap_or_default());
        row_ui(ui, "In control", if episode.is_planned(step) { "the planner" } else { "by hand" });
        row_ui(ui, "By the planner", counted(episode.n_planned(), "step"));
        row_ui(ui, "Unsafe marks", episode.unsafe_marks.len().to_string());
    });
}

fn kept_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    titled_card(ui, "Kept dreams", |ui| {
        let Some(session) = state.session() else {
            ui.label(tokens::muted(ui, "None yet. Begin one, and keep it."));
            guide::go_on_ui(ui, state, None, commands);
            return;
        };
        let dreams: Vec<_> = session.dreams().iter().filter(|kept| !session.is_dropped(kept.dream)).collect();
        if dreams.is_empty() {
            ui.label(tokens::muted(ui, "None yet. Begin one, and keep it."));
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
