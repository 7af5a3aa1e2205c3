//! The real world under the planner, and what it thought of.

use eframe::egui::{
    Align, Align2, Color32, CornerRadius, FontId, Grid, Layout, Rect, Role, ScrollArea, Sense, Ui, UiBuilder,
    Vec2, WidgetInfo, pos2, vec2,
};

use crate::app::{Command, DeployCommand, Field, Panel, WindowCommand};
use crate::evaluation::EpisodeMetrics;
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::dream::banner;
use crate::ui::record::RECORDED_ONLY;
use crate::ui::settings::keymap::KeyAction;
use crate::ui::tokens::{self, GAP};
use crate::ui::widgets::clip::{Rim, clip_button_ui, paint_picture, picture_ui};
use crate::ui::widgets::field::inline_field_ui;
use crate::ui::widgets::gauge::{capitalized, row_ui, status_ui};
use crate::ui::widgets::keycap::{KeyButton, Tone, key_name};
use crate::ui::widgets::layout::{dream_shape, fitting, heading, scene_shape, titled_card};

/// The height of what is promised, under a picture.
const STRIP: f32 = 18.0;
/// Between two pictures.
const SPACE: f32 = 8.0;
/// The least width of a picture that can still be told from others.
const LEAST: f32 = 44.0;

pub(super) fn deploy_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    heading(
        ui,
        "Deploy",
        "The planner acts in the real world: it dreams many futures ahead and takes the one the reward likes best.",
    );
    if state.is_recorded_only() && state.reward.parameters.is_some() {
        ui.label(RECORDED_ONLY);
        return;
    }
    let all = ui.available_rect_before_wrap();
    let left = all.width() * 0.47;
    let columns = [
        Rect::from_min_size(all.min, vec2(left, all.height())),
        Rect::from_min_max(pos2(all.left() + left + 2.0 * GAP, all.top()), all.max),
    ];
    let column = |rect| UiBuilder::new().max_rect(rect).layout(Layout::top_down(Align::Min));
    ui.scope_builder(column(columns[0]), |ui| scene_ui(ui, state, commands));
    ui.scope_builder(column(columns[1]), |ui| thoughts_ui(ui, state, commands));
}

/// The real world and how it goes.
fn scene_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let deploy = &state.deploy;
    let to_come = || state.scene(Field::DeploySeed).filter(|_| !deploy.is_on);
    let picture = deploy.picture.as_ref().or_else(to_come);
    let size = fitting(ui, scene_shape(state, picture), 240.0);
    let label = deploy
        .view
        .as_ref()
        .map_or("The real world".to_owned(), |view| format!("The real world at step {}", view.step));
    let has_reward = state.reward.parameters.is_some();
    let empty = match (deploy.is_on, has_reward) {
        (true, _) => "Starting the world…",
        (false, true) => "Press Begin to let the planner act.",
        (false, false) => "Here the planner will act by the reward that you teach it.",
    };
    let response = picture_ui(ui, picture, size, &label, empty, Rim::Plain);
    if !deploy.is_on && deploy.view.is_none() && picture.is_some() {
        banner(ui, response.rect, empty);
    }
    if deploy.is_on && deploy.is_paused {
        banner(ui, response.rect, "Paused");
    }
    ui.add_space(4.0);
    controls_ui(ui, state, commands);
    ui.add_space(8.0);
    // What was seen last is some steps before the end.
    let ended = deploy.episodes.last().filter(|_| !deploy.is_on);
    let title =
        ended.map_or("This episode".to_owned(), |(seed, _)| format!("Ended: the episode of seed {seed}"));
    titled_card(ui, &title, |ui| match (ended, &deploy.view) {
        (Some((_, metrics)), _) => {
            for (name, value) in figures(metrics) {
                row_ui(ui, &name, value);
            }
            let next = format!(
                "{} drives the next one. Evaluate (Ctrl+7) compares them.",
                key_name(state.settings.keys.of(KeyAction::Begin))
            );
            ui.label(tokens::small(ui, next));
        }
        (None, Some(view)) => {
            for (name, value) in figures(&view.metrics) {
                row_ui(ui, &name, value);
            }
            row_ui(ui, "Latest plan", format!("{:.0} ms", view.plan_ms));
            status_ui(ui, view.status.as_ref());
        }
        (None, None) => drop(ui.label(tokens::muted(ui, "Not begun."))),
    });
}

/// What the planner imagined, and the episodes so far.
fn thoughts_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let room = ui.available_size() - vec2(0.0, 180.0);
    let n = match &state.deploy.view {
        Some(view) => view.candidates.len(),
        None => state.spec.planner.candidates.n_given(),
    };
    let grid = Cells::of(n.max(1), room, dream_shape(state));
    let (chosen, promised) = match &state.deploy.view {
        Some(view) => {
            let returns: Vec<_> = view.candidates.iter().map(|it| it.predicted_return).collect();
            (Some(view.chosen), returns)
        }
        None => (None, vec![0.0; n]),
    };
    candidates_ui(ui, state, &grid, &grid.shown(&promised, chosen));
    let about = match (n, grid.n_cells()) {
        (0, _) => "Where each plan would lead, and what the reward promises of it".to_owned(),
        (n, cells) if cells < n => {
            format!("Where the best {cells} of {n} plans would lead, and what the reward promises of each")
        }
        (n, _) => format!("Where each of {n} plans would lead, and what the reward promises of it"),
    };
    ui.label(tokens::small(ui, about));
    if state.has_clip() {
        clip_button_ui(ui, state, commands);
    }
    ui.add_space(8.0);
    titled_card(ui, "Episodes", |ui| episodes_ui(ui, state));
}

/// Where pictures of candidates are: as large as they can be if all are to be seen, or else as many as there is room for.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Cells {
    columns: usize,
    rows: usize,
    /// The size of a picture.
    picture: Vec2,
}

impl Cells {
    /// For `n` pictures whose width by height is `shape`.
    fn of(n: usize, room: Vec2, shape: f32) -> Self {
        let rows_of = |columns: usize| n.div_ceil(columns);
        let width = |columns: usize| {
            let wide = (room.x - SPACE * (columns - 1) as f32) / columns as f32;
            let high = room.y / rows_of(columns) as f32 - STRIP - SPACE;
            wide.min(high * shape)
        };
        // Rows that are not full waste room, and look like it.
        let worth = |columns: usize| width(columns) * n as f32 / (columns * rows_of(columns)) as f32;
        let best = (1..=n).max_by(|one, other| worth(*one).total_cmp(&worth(*other))).unwrap_or(1);
        if width(best) >= LEAST {
            let picture = vec2(width(best), width(best) / shape);
            return Self { columns: best, rows: rows_of(best), picture };
        }
        let fit = |room: f32, each: f32| (((room + SPACE) / (each + SPACE)) as usize).max(1);
        let least = vec2(LEAST, LEAST / shape);
        let (columns, rows) = (fit(room.x, least.x), fit(room.y, least.y + STRIP));
        Self { columns: columns.min(n), rows: rows.min(n.div_ceil(columns)), picture: least }
    }

    fn n_cells(&self) -> usize {
        self.columns * self.rows
    }

    /// Which candidates are shown, in their order: the chosen one and the best where there is no room for all.
    fn shown(&self, promised: &[f32], chosen: Option<usize>) -> Vec<usize> {
        let mut order: Vec<usize> = (0..promised.len()).collect();
        order.sort_by(|one, other| {
            let is_chosen = |i: usize| Some(i) == chosen;
            let by_choice = is_chosen(*other).cmp(&is_chosen(*one));
            by_choice.then(promised[*other].total_cmp(&promised[*one]))
        });
        order.truncate(self.n_cells());
        order.sort_unstable();
        order
    }
}

fn controls_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let deploy = &state.deploy;
    let key = |key_action| state.settings.keys.of(key_action);
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 8.0;
        if state.reward.parameters.is_none() {
            if KeyButton::new("Go and label").tone(Tone::Primary).is_pressed(ui) {
                commands.push(Command::Window(WindowCommand::Show(Panel::Label)));
            }
            ui.label(tokens::small(ui, "The planner needs a reward: answer some queries first."));
            return;
        }
        if !deploy.is_on {
            let drive = KeyButton::new("Begin").key(key(KeyAction::Begin)).tone(Tone::Primary).width(150.0);
            if drive.is_pressed(ui) {
                commands.push(Command::Deploy(DeployCommand::Start));
            }
            ui.add_space(8.0);
            inline_field_ui(ui, state, Field::DeploySeed, "Seed of the episode", commands);
            return;
        }
        let name = if deploy.is_paused { "Go on" } else { "Pause" };
        if KeyButton::new(name).key(key(KeyAction::Pause)).is_pressed(ui) {
            commands.push(Command::Deploy(DeployCommand::Pause));
        }
        if KeyButton::new("Stop").key(key(KeyAction::Leave)).is_pressed(ui) {
            commands.push(Command::Deploy(DeployCommand::Stop));
        }
    });
}

fn candidates_ui(ui: &mut Ui, state: &View<'_>, cells: &Cells, shown: &[usize]) {
    let tokens = tokens::Tokens::of(ui);
    let deploy = &state.deploy;
    let chosen = deploy.view.as_ref().map(|view| view.chosen);
    for row in shown.chunks(cells.columns) {
        ui.horizontal(|ui| {
            ui.spacing_mut().item_spacing.x = SPACE;
            for &i in row {
                let (rect, response) =
                    ui.allocate_exact_size(cells.picture + vec2(0.0, STRIP), Sense::hover());
                let candidate = deploy.view.as_ref().and_then(|view| view.candidates.get(i));
                let is_chosen = chosen == Some(i) && candidate.is_some();
                let promised = candidate
                    .map_or("–".to_owned(), |candidate| format!("{:.2}", candidate.predicted_return));
                let name = format!("Plan {}{}: {promised}", i + 1, if is_chosen { ", chosen" } else { "" });
                response.widget_info(|| WidgetInfo::labeled(Role::Image, true, &name));
                let picture = Rect::from_min_size(rect.min, cells.picture).shrink(2.0);
                let rim = if is_chosen { Rim::Good } else { Rim::Plain };
                paint_picture(ui, deploy.candidates.get(i).and_then(Option::as_ref), picture, "", rim);
                let ink = if is_chosen { tokens.good } else { tokens.muted };
                let at = rect.center_bottom() - vec2(0.0, 1.0);
                ui.painter().text(at, Align2::CENTER_BOTTOM, &promised, FontId::proportional(12.5), ink);
                if is_chosen {
                    mark(ui, picture, tokens.good, tokens.background);
                }
                if let Some(candidate) = candidate {
                    response.on_hover_text(&candidate.actions);
                }
            }
        });
    }
}

/// A word on the chosen candidate.
fn mark(ui: &Ui, over: Rect, fill: Color32, ink: Color32) {
    let galley = ui.painter().layout_no_wrap("chosen".to_owned(), FontId::proportional(11.5), ink);
    let rect = Rect::from_min_size(over.min, galley.size() + vec2(10.0, 4.0));
    ui.painter().rect_filled(rect, CornerRadius { nw: 4, ne: 0, sw: 0, se: 6 }, fill);
    ui.painter().galley(rect.min + vec2(5.0, 2.0), galley, ink);
}

fn episodes_ui(ui: &mut Ui, state: &View<'_>) {
    let episodes = &state.deploy.episodes;
    if episodes.is_empty() {
        ui.label(tokens::muted(ui, "None has ended yet."));
        return;
    }
    ScrollArea::vertical().id_salt("episodes").show(ui, |ui| {
        Grid::new("episodes").num_columns(4).striped(false).spacing([18.0, 6.0]).show(ui, |ui| {
            for name in ["Seed", "Return", "Unsafe", "Steps"] {
                ui.label(tokens::small(ui, name));
            }
            ui.end_row();
            for (seed, metrics) in episodes.iter().rev() {
                ui.label(seed.to_string());
                for (_, value) in figures(metrics).into_iter().take(3) {
                    ui.label(value);
                }
                ui.end_row();
            }
        });
    });
}

/// The figures of an episode, with their names.
fn figures(metrics: &EpisodeMetrics) -> Vec<(String, String)> {
    let mut figures = vec![
        ("Return".to_owned(), format!("{:.0}", metrics.ret)),
        ("Unsafe".to_owned(), format!("{:.0} % of steps", 100.0 * metrics.unsafe_rate)),
        ("Steps".to_owned(), metrics.n_steps.to_string()),
    ];
    figures.extend(metrics.events.iter().map(|figure| (capitalized(&figure.name), figure.shown())));
    figures
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fifteen_squares_are_five_by_three_and_other_shapes_and_numbers_fit_too() {
        let room = vec2(520.0, 500.0);
        let cells = Cells::of(15, room, 1.0);
        assert_eq!((cells.columns, cells.rows), (5, 3));
        for (n, shape) in [(1, 1.0), (30, 1.0), (30, 80.0 / 60.0), (7, 0.5), (200, 1.0), (4096, 4.0)] {
            let cells = Cells::of(n, room, shape);
            let (columns, rows) = (cells.columns as f32, cells.rows as f32);
            assert!(columns * (cells.picture.x + SPACE) - SPACE <= room.x + 0.1, "{n} {shape}: {cells:?}");
            assert!(
                rows * (cells.picture.y + STRIP + SPACE) <= room.y + SPACE + 0.1,
                "{n} {shape}: {cells:?}"
            );
            assert!(cells.picture.x >= LEAST && (cells.picture.x / cells.picture.y - shape).abs() < 1e-3);
        }
    }

    #[test]
    fn where_not_all_fit_the_chosen_and_the_best_are_seen_in_their_order() {
        let cells = Cells { columns: 2, rows: 2, picture: vec2(50.0, 50.0) };
        assert_eq!(cells.shown(&[1.0, 9.0, 2.0, 8.0, 0.0, 7.0], Some(4)), [1, 3, 4, 5]);
        assert_eq!(cells.shown(&[1.0, f32::NAN, 2.0], None), [0, 1, 2]);
    }
}
