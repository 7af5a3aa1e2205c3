//! How well the reward is learned, as far as it was measured.

mod weights;

use eframe::egui::{
    Align, Align2, Color32, CornerRadius, FontId, Layout, Rect, Role, ScrollArea, Sense, Ui, WidgetInfo, vec2,
};
use egui_plot::Corner;

use crate::app::counted;
use crate::app::{Command, Panel, RewardCommand, WindowCommand};
use crate::session::Session;
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::dream::review::judged_ui;
use crate::ui::guide;
use crate::ui::settings::keymap::KeyAction;
use crate::ui::tokens::{self, GAP, Tokens};
use crate::ui::widgets::curve::{Curve, curves_ui};
use crate::ui::widgets::gauge::{figure_ui, progress_ui, row_ui};
use crate::ui::widgets::keycap::{KeyButton, Tone};
use crate::ui::widgets::layout::{card, heading, titled_card, with_side};
use weights::weights_ui;

pub(in crate::ui) fn reward_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    heading(ui, "Reward", "Three networks learn from your answers while you give them.");
    let n_answered = state.session().map_or(0, |session| session.statistics().n_answered);
    if n_answered == 0 {
        ui.label("There is nothing to learn from yet: answer some queries.");
        ui.add_space(GAP);
        if KeyButton::new("Go and label").tone(Tone::Primary).is_pressed(ui) {
            commands.push(Command::Window(WindowCommand::Show(Panel::Label)));
        }
        ui.add_space(GAP);
        guide::curves_to_come_ui(ui);
        return;
    }
    let main = |ui: &mut Ui, commands: &mut Commands| learned_ui(ui, state, commands);
    let aside = |ui: &mut Ui, commands: &mut Commands| {
        fit_ui(ui, state, commands);
        titled_card(ui, "How much answers weigh", |ui| weights_ui(ui, state, commands));
        titled_card(ui, "Answers by label", |ui| distribution_ui(ui, state));
    };
    if ui.available_width() >= WIDE {
        return with_side(ui, 300.0, commands, main, aside);
    }
    // In a narrow window one stands below the other.
    let height = ui.available_height();
    ScrollArea::vertical().id_salt("reward").auto_shrink(false).show(ui, |ui| {
        let room = vec2(ui.available_width() - GAP, height.max(LOWEST));
        ui.allocate_ui_with_layout(room, Layout::top_down(Align::Min), |ui| {
            ui.set_max_size(room);
            main(ui, commands);
        });
        ui.spacing_mut().item_spacing.y = GAP;
        aside(ui, commands);
    });
}

/// What a dream and the curves want beside the rest.
const WIDE: f32 = 880.0;
/// And in height, where all scrolls.
const LOWEST: f32 = 440.0;

/// A dream as the reward sees it, and how the reward came to see it so.
fn learned_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    ui.spacing_mut().item_spacing.y = GAP;
    let plot = ((ui.available_height() - 150.0) * 0.32).clamp(80.0, 240.0);
    let review = (ui.available_height() - plot - 135.0).clamp(170.0, 520.0);
    titled_card(ui, "What it says of a dream", |ui| judged_ui(ui, state, review - 40.0, commands));
    curves(ui, state, plot);
}

fn curves(ui: &mut Ui, state: &View<'_>, height: f32) {
    let tokens = Tokens::of(ui);
    let reward = &state.reward;
    ui.columns(3, |columns| {
        card(&mut columns[0], |ui| {
            let names = ["1", "2", "3"];
            let curves = names.iter().zip(&reward.losses).zip(tokens.lines);
            let curves: Vec<_> =
                curves.map(|((name, points), color)| Curve { name, points, color }).collect();
            let about = "Cross-entropy of each network with the labels that it learns from, report by report";
            curves_ui(ui, ("Loss of each network", about), &curves, None, Corner::RightTop, height);
        });
        card(&mut columns[1], |ui| {
            let curve = Curve { name: "reward", points: &reward.held_out, color: tokens.lines[0] };
            let level = Some(("knowing nothing", std::f64::consts::LN_2));
            let about = "Cross-entropy with answers that were predicted before they were learned: below the \
                         line it knows more than nothing";
            curves_ui(ui, ("Held-out loss", about), &[curve], level, Corner::LeftBottom, height);
        });
        card(&mut columns[2], |ui| {
            let curve = Curve { name: "reward", points: &reward.agreement, color: tokens.lines[1] };
            let about = "Share of the latest answers with a winner whose winner was predicted";
            let level = Some(("chance", 0.5));
            curves_ui(ui, ("Answers predicted", about), &[curve], level, Corner::RightBottom, height);
        });
    });
}

fn fit_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let reward = &state.reward;
    titled_card(ui, "Learned", |ui| {
        let latest = reward.latest.as_ref();
        ui.horizontal(|ui| {
            ui.spacing_mut().item_spacing.x = 28.0;
            figure_ui(ui, reward.n_learned.to_string(), "answers");
            let agreement = latest.and_then(|latest| latest.agreement);
            figure_ui(
                ui,
                agreement.map_or("–".to_owned(), |share| format!("{:.0} %", 100.0 * share)),
                "predicted",
            );
        });
        if let Some(loss) = latest.and_then(|latest| latest.held_out_loss) {
            row_ui(ui, "Held-out log-loss", format!("{loss:.3}"));
        }
        if let Some(fit) = state.session().and_then(|session| session.fits().last()) {
            row_ui(ui, "Last full fit", counted(fit.fit.n_labels, "answer"));
        }
        ui.add_space(4.0);
        if reward.is_fitting {
            let (done, all) = latest.map_or((0, None), |latest| (latest.epoch, latest.fit_epochs));
            ui.label(tokens::small(ui, format!("epoch {done}")));
            progress_ui(ui, "Full fit", done as f32 / all.unwrap_or(1).max(1) as f32);
        }
        let fit = KeyButton::new("Fit fully")
            .key(state.settings.keys.of(KeyAction::Begin))
            .tone(Tone::Primary)
            .enabled(!reward.is_fitting)
            .wide(ui);
        if fit.is_pressed(ui) {
            commands.push(Command::Reward(RewardCommand::Fit { seed: None }));
        }
        ui.label(tokens::small(ui, "Begins afresh and saves the result in the session"));
    });
}

/// How many answers there are of each label.
fn distribution_ui(ui: &mut Ui, state: &View<'_>) {
    let tokens = Tokens::of(ui);
    let labels = state.session().map(Session::labeled).unwrap_or_default();
    let mut counts: std::collections::BTreeMap<i32, usize> = std::collections::BTreeMap::new();
    for labeled in &labels {
        *counts.entry((labeled.label.mu() * 1000.0).round() as i32).or_default() += 1;
    }
    let most = counts.values().copied().max().unwrap_or(1).max(1);
    for (mu, n) in counts.iter().rev() {
        let mu = f64::from(*mu) / 1000.0;
        let (side, color) = match mu.total_cmp(&0.5) {
            std::cmp::Ordering::Greater => ("left", tokens.lines[0]),
            std::cmp::Ordering::Equal => ("neither", tokens.faint),
            std::cmp::Ordering::Less => ("right", tokens.lines[2]),
        };
        bar_ui(ui, &format!("μ = {mu}"), side, *n, *n as f32 / most as f32, color);
    }
    row_ui(ui, "Skipped", state.session().map_or(0, |session| session.statistics().n_skipped).to_string());
}

fn bar_ui(ui: &mut Ui, name: &str, side: &str, n: usize, share: f32, color: Color32) {
    let tokens = Tokens::of(ui);
    let (rect, response) = ui.allocate_exact_size(vec2(ui.available_width(), 34.0), Sense::hover());
    response.widget_info(|| WidgetInfo::labeled(Role::Label, true, format!("{name}, {side}: {n}")));
    let font = || FontId::proportional(13.5);
    ui.painter().text(rect.left_top(), Align2::LEFT_TOP, format!("{name}  {side}"), font(), tokens.muted);
    ui.painter().text(rect.right_top(), Align2::RIGHT_TOP, n, font(), tokens.text);
    let track =
        Rect::from_min_max(rect.left_bottom() - vec2(0.0, 12.0), rect.right_bottom() - vec2(0.0, 6.0));
    ui.painter().rect_filled(track, CornerRadius::same(3), tokens.border);
    let mut filled = track;
    filled.set_width(track.width() * share);
    ui.painter().rect_filled(filled, CornerRadius::same(3), color);
}
