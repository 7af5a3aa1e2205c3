//! What is asked about, and how often again.

use eframe::egui::containers::menu::{MenuButton, MenuConfig};
use eframe::egui::{PopupCloseBehavior, Slider, Ui};

use crate::app::QuerySelection;
use crate::app::label::{MOST_HELD_BACK, MOST_REPEATS, obstacles};
use crate::app::{Command, LabelCommand};
use crate::query::Mix;
use crate::session::Session;
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::tokens::{self, GAP, Tokens};
use crate::ui::widgets::gauge::row_ui;
use crate::ui::widgets::histogram::histogram_ui;
use crate::ui::widgets::layout::titled_card;

/// The width of the menu.
const WIDTH: f32 = 320.0;

/// What is asked about, in a few lines, and a button to change it.
pub(in crate::ui) fn card_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let selection = state.label.selection;
    titled_card(ui, "What is asked", |ui| {
        row_ui(ui, "Pairs", in_short(selection.mix));
        row_ui(ui, "Asked a second time", format!("{} %", selection.repeats));
        if let Some(found) = state.session().and_then(|session| session.consistency(None)) {
            row_ui(ui, "Answered as before", format!("{} of {}", found.n_same, found.n));
        }
        if selection.held_back > 0 {
            row_ui(ui, "Held back as doubtful", format!("{} %", selection.held_back));
        }
        let config = MenuConfig::new().close_behavior(PopupCloseBehavior::CloseOnClickOutside);
        MenuButton::new("Change what is asked").config(config).ui(ui, |ui| {
            ui.set_width(WIDTH);
            let mut changed = selection;
            mix_ui(ui, state, &mut changed);
            ui.add_space(GAP);
            again_ui(ui, state, &mut changed);
            ui.add_space(GAP);
            screen_ui(ui, state, &mut changed);
            if changed != selection {
                commands.push(Command::Label(LabelCommand::SelectQueries(changed)));
            }
        });
    });
}

/// How pairs are chosen, in two words.
fn in_short(mix: Mix) -> &'static str {
    match (mix.disagreement, mix.boundary, mix.uniform()) {
        (0, 0, _) if mix.is_balanced => "balanced",
        (0, 0, _) => "by chance",
        (100, ..) => "most unsure",
        (_, 100, _) => "near marks",
        _ if mix.least_answered == 100 => "answered least",
        _ => "mixed",
    }
}

fn mix_ui(ui: &mut Ui, state: &View<'_>, selection: &mut QuerySelection) {
    ui.label("What is asked about");
    let mix = &mut selection.mix;
    share_ui(ui, &mut mix.disagreement, 100, "where the reward is unsure")
        .on_hover_text("Of ten pairs the one that the networks of the reward disagree about most");
    let most = 100 - mix.disagreement.min(100);
    share_ui(ui, &mut mix.least_answered, 100, "about what was answered least").on_hover_text(
        "One clip is from around one that was said to show it: so that all that is unsafe is told, not only what is frequent",
    );
    mix.least_answered = mix.least_answered.min(most);
    let most = most - mix.least_answered;
    share_ui(ui, &mut mix.boundary, 100, "near what was marked as unsafe")
        .on_hover_text("One clip is from around a step that was marked in a dream, the other by chance");
    mix.boundary = mix.boundary.min(most);
    ui.checkbox(&mut mix.is_balanced, "seldom two that are likely unsafe").on_hover_text(
        "Goes by what was answered about moments nearby; leaves more queries for what you prefer",
    );
    let how = if mix.is_balanced { "balanced" } else { "as in the paper" };
    ui.label(tokens::muted(ui, format!("{} % by chance, {how}", mix.uniform())));
    for sentence in obstacles(state) {
        let warn = Tokens::of(ui).warn;
        ui.label(tokens::small(ui, sentence).color(warn));
    }
}

fn again_ui(ui: &mut Ui, state: &View<'_>, selection: &mut QuerySelection) {
    ui.label("Asked a second time");
    share_ui(ui, &mut selection.repeats, MOST_REPEATS, "with the sides changed over")
        .on_hover_text("To see how steady the answers are; they are not learned from, and no count moves");
    let consistency = state.session().and_then(|session| session.consistency(None));
    let said = consistency.map_or_else(
        || "Nothing was answered a second time yet".to_owned(),
        |found| {
            let critical = match found.n_critical {
                0 => String::new(),
                n => format!(", {n} differed about safety"),
            };
            format!("{} of {} were answered as before{critical}", found.n_same, found.n)
        },
    );
    ui.label(tokens::muted(ui, said));
}

/// What is held back because it hardly looks like the world.
fn screen_ui(ui: &mut Ui, state: &View<'_>, selection: &mut QuerySelection) {
    ui.label("Held back until last");
    let screen = &state.label.screen;
    let sorted = screen.distribution();
    share_ui(ui, &mut selection.held_back, MOST_HELD_BACK, "that look least like the world").on_hover_text(
        "Measured from how restless the pictures are and how far the dream has strayed; skipping as hallucinated teaches it",
    );
    if sorted.is_empty() {
        ui.label(tokens::muted(ui, "The dreams are yet to be looked at"));
        return;
    }
    let limit = screen.limit(selection.share_held_back());
    if let Some(most) = histogram_ui(ui, sorted, limit, "How doubtful pairs are") {
        let n_above = sorted.len() - sorted.partition_point(|doubt| *doubt <= most);
        let percent = (100.0 * n_above as f32 / sorted.len() as f32).round() as u8;
        selection.held_back = percent.min(MOST_HELD_BACK);
    }
    let judged = state.session().map(Session::looked_at).unwrap_or_default();
    let spared = screen.spared(&judged, selection.share_held_back());
    let said = match spared.n_bad {
        0 => "Nothing was skipped as hallucinated yet".to_owned(),
        n => format!(
            "Of what was answered so far it would have held back {} of {n} skipped as hallucinated and {} of {} others",
            spared.n_spared, spared.n_lost, spared.n_good
        ),
    };
    ui.label(tokens::muted(ui, said));
}

/// A share in percent.
fn share_ui(ui: &mut Ui, percent: &mut u8, most: u8, name: &str) -> eframe::egui::Response {
    ui.add(Slider::new(percent, 0..=most).suffix(" %").text(name))
}
