//! Runs side by side: their figures, what differs by the tests, and driven episodes looked at again.

mod differences;
mod plots;
mod replay;
mod runs;

use std::path::PathBuf;

use eframe::egui::{Align, Layout, RichText, ScrollArea, Ui};

use crate::app::{Command, EvaluateCommand, Field, Panel, Purpose, WindowCommand};
use crate::experiment::side_by_side::Part;
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::settings::keymap::KeyAction;
use crate::ui::tokens::{self, GAP, Tokens};
use crate::ui::widgets::field::path_ui;
use crate::ui::widgets::keycap::{KeyButton, Tone};
use crate::ui::widgets::layout::{card, heading, titled_card};

pub(super) fn evaluate_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let about = "Runs side by side: how their episodes went, and which runs the tests tell apart.";
    heading(ui, "Evaluate", about);
    if state.replayed().is_some() {
        return replay::replay_ui(ui, state, commands);
    }
    ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        ui.spacing_mut().item_spacing.y = GAP;
        if state.evaluate.results.is_empty() {
            return empty_ui(ui, state, commands);
        }
        card(ui, |ui| runs::runs_ui(ui, state, commands));
        let shown = &state.evaluate.shown;
        if !shown.groups.is_empty() {
            plots::plots_ui(ui, state, commands);
            titled_card(ui, "What differs, by the tests", |ui| differences::differences_ui(ui, state));
        }
        if !shown.losses.is_empty() {
            card(ui, |ui| plots::losses_ui(ui, state, commands));
        }
        titled_card(ui, "Episodes driven in this window", |ui| replay::driven_ui(ui, state, commands));
        card(ui, |ui| paths_ui(ui, state, commands));
    });
}

/// What will be here, and how it comes here.
fn empty_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    titled_card(ui, "Nothing to compare yet", |ui| {
        ui.label(
            "Here runs stand beside each other, with their distributions, curves and tests. They come from:",
        );
        for (what, how) in [
            ("Deploy", "every episode that the planner drives in this window, by itself"),
            ("dropj experiment", "the folder it writes: all methods and seeds of an experiment"),
            ("dropj deploy --json > a.json", "a file for each run, or a folder of such files"),
            ("dropj fit-world", "the folder of a fit, for its curves"),
        ] {
            ui.horizontal_wrapped(|ui| {
                ui.label(RichText::new(what).monospace().color(Tokens::of(ui).text));
                ui.label(tokens::muted(ui, how));
            });
        }
        ui.label(tokens::muted(ui, "A folder or file that is dropped on this window opens here, too."));
        ui.add_space(4.0);
        ui.horizontal(|ui| {
            open_ui(ui, state, Tone::Primary, commands);
            if KeyButton::new("Go to Deploy").tone(Tone::Quiet).is_pressed(ui) {
                commands.push(Command::Window(WindowCommand::Show(Panel::Deploy)));
            }
        });
    });
    card(ui, |ui| path_to_open_ui(ui, state, commands));
}

/// Buttons that ask for results.
fn open_ui(ui: &mut Ui, state: &View<'_>, tone: Tone, commands: &mut Commands) {
    let key = state.settings.keys.of(KeyAction::Begin);
    if KeyButton::new("Open a folder…").key(key).tone(tone).is_pressed(ui) {
        commands.push(Command::Window(WindowCommand::Import(Purpose::Results)));
    }
    if KeyButton::new("Open files…").is_pressed(ui) {
        commands.push(Command::Window(WindowCommand::Import(Purpose::ResultsFile)));
    }
    if state.evaluate.n_reading > 0 {
        ui.label(tokens::small(ui, "Reading results…"));
    }
}

fn path_to_open_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    path_ui(ui, state, Field::ResultsIn, "The folder or file of results", commands);
    let path = state.field(Field::ResultsIn).trim();
    if KeyButton::new("Open").enabled(!path.is_empty()).is_pressed(ui) {
        commands.push(Command::Evaluate(EvaluateCommand::Open(PathBuf::from(path))));
    }
}

/// The same by paths, where there are no dialogs; and everything saved at once.
fn paths_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    path_to_open_ui(ui, state, commands);
    ui.add_space(4.0);
    path_ui(
        ui,
        state,
        Field::FiguresOut,
        "A folder for all tables (CSV) and figures (SVG and PNG)",
        commands,
    );
    let path = state.field(Field::FiguresOut).trim();
    if KeyButton::new("Save everything").enabled(!path.is_empty()).is_pressed(ui) {
        commands.push(Command::Evaluate(EvaluateCommand::SaveAll));
    }
}

/// A heading, and at its right a button that saves what is under it.
fn saved_heading_ui(ui: &mut Ui, text: &str, (button, part): (&str, Part), commands: &mut Commands) {
    ui.horizontal(|ui| {
        ui.label(RichText::new(text).strong().color(Tokens::of(ui).text));
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            if KeyButton::new(button).tone(Tone::Quiet).small().is_pressed(ui) {
                commands.push(Command::Evaluate(EvaluateCommand::Save(part)));
            }
        });
    });
}
