//! The real car under the planner, and what it thought of.

use eframe::egui::{
    Align, Align2, Color32, CornerRadius, FontId, Grid, Layout, Rect, Role, ScrollArea, Sense, Ui, UiBuilder,
    WidgetInfo, pos2, vec2,
};

use crate::app::{Command, DeployCommand, Field, Panel, WindowCommand};
use crate::evaluation::EpisodeMetrics;
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::dream::banner;
use crate::ui::settings::keymap::KeyAction;
use crate::ui::tokens::{self, GAP};
use crate::ui::widgets::clip::{Rim, paint_picture, picture_ui};
use crate::ui::widgets::field::inline_field_ui;
use crate::ui::widgets::gauge::{row_ui, wheels_ui};
use crate::ui::widgets::keycap::{KeyButton, Tone};
use crate::ui::widgets::layout::{heading, titled_card};

/// Width by height of the scene.
const SHAPE: f32 = 600.0 / 480.0;
/// Candidates in a row, as in the paper's Fig. 13.
const N_COLUMNS: usize = 5;
/// Rows of them.
const N_ROWS: usize = 3;

pub(super) fn deploy_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    heading(
        ui,
        "Deploy",
        "The planner drives the real car: it dreams fifteen futures ahead and takes the one the reward likes best.",
    );
    if state.reward.parameters.is_none() {
        ui.label("The planner needs a reward: answer some queries first.");
        ui.add_space(GAP);
        if KeyButton::new("Go and label").tone(Tone::Primary).is_pressed(ui) {
            commands.push(Command::Window(WindowCommand::Show(Panel::Label)));
        }
        return;
    }
    let all = ui.available_rect_before_wrap();
    let left = all.width() * 0.47;
    let columns = [
        Rect::from_min_size(all.min, vec2(left, all.height())),
        Rect::from_min_max(pos2(all.left() + left + 2.0 * GAP, all.top()), all.max),
    ];
    let column = |rect| UiBuilder::new().max_rect(rect).layout(Layout::top_down(Align::Min));
    ui.scope_builder(column(columns[0]), |ui| car_ui(ui, state, commands));
    ui.scope_builder(column(columns[1]), |ui| thoughts_ui(ui, state));
}

/// The real car and how it fares.
fn car_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let deploy = &state.deploy;
    let width = ui.available_width().min((ui.available_height() - 240.0) * SHAPE).max(150.0);
    let label = deploy
        .view
        .as_ref()
        .map_or("The track".to_owned(), |view| format!("The track at step {}", view.step));
    let empty = "Press Drive to let the planner take the wheel.";
    let response =
        picture_ui(ui, deploy.picture.as_ref(), vec2(width, width / SHAPE), &label, empty, Rim::Plain);
    if deploy.is_on && deploy.is_paused {
        banner(ui, response.rect, "Paused");
    }
    ui.add_space(4.0);
    controls_ui(ui, state, commands);
    ui.add_space(8.0);
    titled_card(ui, "This episode", |ui| match &deploy.view {
        Some(view) => {
            for (name, value) in figures(&view.metrics) {
                row_ui(ui, name, value);
            }
            row_ui(ui, "Latest plan", format!("{:.0} ms", view.plan_ms));
            wheels_ui(ui, view.wheels_off);
        }
        None => drop(ui.label(tokens::muted(ui, "Not begun."))),
    });
}

/// What the planner imagined, and the episodes so far.
fn thoughts_ui(ui: &mut Ui, state: &View<'_>) {
    let gap = 8.0;
    let strip = 18.0;
    let room = ui.available_size();
    let cell = ((room.x - gap * (N_COLUMNS as f32 - 1.0)) / N_COLUMNS as f32)
        .min((room.y - 180.0) / N_ROWS as f32 - strip - gap)
        .max(40.0);
    candidates_ui(ui, state, cell, strip, gap);
    ui.label(tokens::small(ui, "Where each of fifteen plans would lead, and what the reward promises of it"));
    ui.add_space(8.0);
    titled_card(ui, "Episodes", |ui| episodes_ui(ui, state));
}

fn controls_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let deploy = &state.deploy;
    let key = |key_action| state.settings.keys.of(key_action);
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 8.0;
        if !deploy.is_on {
            let drive = KeyButton::new("Drive").key(key(KeyAction::Begin)).tone(Tone::Primary).width(150.0);
            if drive.is_pressed(ui) {
                commands.push(Command::Deploy(DeployCommand::Start));
            }
            ui.add_space(8.0);
            inline_field_ui(ui, state, Field::DeploySeed, "Seed of the track", commands);
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

fn candidates_ui(ui: &mut Ui, state: &View<'_>, cell: f32, strip: f32, gap: f32) {
    let tokens = tokens::Tokens::of(ui);
    let deploy = &state.deploy;
    let chosen = deploy.view.as_ref().map(|view| view.chosen);
    for row in 0..N_ROWS {
        ui.horizontal(|ui| {
            ui.spacing_mut().item_spacing.x = gap;
            for column in 0..N_COLUMNS {
                let i = row * N_COLUMNS + column;
                let (rect, response) = ui.allocate_exact_size(vec2(cell, cell + strip), Sense::hover());
                let candidate = deploy.view.as_ref().and_then(|view| view.candidates.get(i));
                let is_chosen = chosen == Some(i) && candidate.is_some();
                let promised = candidate
                    .map_or("–".to_owned(), |candidate| format!("{:.2}", candidate.predicted_return));
                let name = format!("Plan {}{}: {promised}", i + 1, if is_chosen { ", chosen" } else { "" });
                response.widget_info(|| WidgetInfo::labeled(Role::Image, true, &name));
                let picture = Rect::from_min_size(rect.min, vec2(cell, cell)).shrink(2.0);
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
        Grid::new("episodes").num_columns(5).striped(false).spacing([18.0, 6.0]).show(ui, |ui| {
            for name in ["Track", "Return", "New tiles", "Grass", "Steps"] {
                ui.label(tokens::small(ui, name));
            }
            ui.end_row();
            for (seed, metrics) in episodes.iter().rev() {
                ui.label(seed.to_string());
                for (_, value) in figures(metrics).into_iter().take(4) {
                    ui.label(value);
                }
                ui.end_row();
            }
        });
    });
}

/// The figures of an episode, with their names.
fn figures(metrics: &EpisodeMetrics) -> Vec<(&'static str, String)> {
    let share = |share: f32| format!("{:.0} %", 100.0 * share);
    let mut figures = vec![
        ("Return", format!("{:.0}", metrics.ret)),
        ("New tiles", format!("{} of steps", share(metrics.new_tile_rate))),
        ("On the grass", format!("{} of steps", share(metrics.grass_rate))),
        ("Steps", metrics.n_steps.to_string()),
    ];
    figures.extend(metrics.chuckhole_rate.map(|rate| ("Chuckholes hit", share(rate))));
    figures.extend(metrics.car_rate.map(|rate| ("Cars hit", share(rate))));
    figures
}
