//! Which world model is in use, and how to come by another.

use std::path::PathBuf;

use eframe::egui::{RichText, ScrollArea, Ui};
use egui_plot::Corner;

use crate::app::{Command, Field, WorldModelCommand};
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::tokens::{self, GAP, Tokens};
use crate::ui::widgets::curve::{Curve, curves_ui};
use crate::ui::widgets::field::path_ui;
use crate::ui::widgets::gauge::{progress_ui, row_ui};
use crate::ui::widgets::keycap::{KeyButton, Tone};
use crate::ui::widgets::layout::{heading, titled_card, with_side};
use crate::world_model::fit::Stage;

pub(super) fn world_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    heading(
        ui,
        "World model",
        "What dreams are made of: it has learned to see, to remember and to predict from recordings.",
    );
    let main = |ui: &mut Ui, commands: &mut Commands| {
        ScrollArea::vertical().auto_shrink([false, false]).show(ui, |ui| {
            ui.spacing_mut().item_spacing.y = GAP;
            fit_ui(ui, state, commands);
        });
    };
    let aside = |ui: &mut Ui, commands: &mut Commands| {
        loaded_ui(ui, state);
        load_ui(ui, state, commands);
    };
    with_side(ui, 380.0, commands, main, aside);
}

fn loaded_ui(ui: &mut Ui, state: &View<'_>) {
    titled_card(ui, "In use", |ui| {
        let Some(world) = &state.world.loaded else {
            ui.label(tokens::muted(ui, "None. Load one below, or fit one to recordings."));
            return;
        };
        row_ui(ui, "Name", world.name.as_str());
        let hash = state.world.hash.strip_prefix("sha256:").unwrap_or(&state.world.hash);
        row_ui(ui, "SHA-256", format!("{}…", &hash[..hash.len().min(16)]));
        for (name, value) in &world.card {
            row_ui(ui, name, value.as_str());
        }
        row_ui(ui, "Starts", world.starts.len().to_string());
        if let Some(path) = &world.path {
            ui.label(tokens::small(ui, path.display().to_string()));
        }
    });
}

fn load_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    titled_card(ui, "Load another", |ui| {
        path_ui(ui, state, Field::ModelIn, "File of network parameters (safetensors)", commands);
        let path = state.field(Field::ModelIn).trim();
        if KeyButton::new("Load").enabled(!path.is_empty()).is_pressed(ui) {
            commands.push(Command::WorldModel(WorldModelCommand::Load(PathBuf::from(path))));
        }
        ui.label(tokens::small(
            ui,
            "A session belongs to its world model, so another model begins another session",
        ));
    });
}

fn fit_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    titled_card(ui, "Fit one to recordings", |ui| {
        ui.label(tokens::muted(
            ui,
            "Vision first, then memory. It takes hours, goes on in the background and can be resumed.",
        ));
        ui.add_space(4.0);
        let is_fitting = state.world.fit.is_some();
        ui.add_enabled_ui(!is_fitting, |ui| {
            path_ui(ui, state, Field::Dataset, "Folder of recordings", commands);
            path_ui(ui, state, Field::ModelOut, "File to write", commands);
        });
        ui.add_space(4.0);
        ui.horizontal(|ui| {
            if is_fitting {
                if KeyButton::new("Stop").is_pressed(ui) {
                    commands.push(Command::WorldModel(WorldModelCommand::StopFit));
                }
                return;
            }
            if KeyButton::new("Fit").tone(Tone::Primary).is_pressed(ui) {
                commands.push(Command::WorldModel(WorldModelCommand::Fit { resume: false }));
            }
            if KeyButton::new("Resume").is_pressed(ui) {
                commands.push(Command::WorldModel(WorldModelCommand::Fit { resume: true }));
            }
        });
    });
    if let Some(fit) = &state.world.fit {
        titled_card(ui, "Fitting", |ui| fitting_ui(ui, fit, state.now));
    } else if let Some(path) = &state.world.fitted {
        titled_card(ui, "Fitted", |ui| {
            ui.label(path.display().to_string());
            if KeyButton::new("Use it").tone(Tone::Primary).is_pressed(ui) {
                commands.push(Command::WorldModel(WorldModelCommand::Load(path.clone())));
            }
        });
    }
}

fn fitting_ui(ui: &mut Ui, fit: &crate::app::world_model::FitState, now: f64) {
    let tokens = Tokens::of(ui);
    let Some(progress) = &fit.progress else {
        ui.label(tokens::muted(ui, "Reading the recordings…"));
        return;
    };
    let (stage, what) = match progress.stage {
        Stage::Vae => ("Vision", "frames"),
        Stage::Encode => ("Turning episodes into latents", "steps"),
        Stage::MdnRnn => ("Memory", "steps"),
    };
    let epoch = (progress.epoch + 1).min(progress.max_epochs.max(1));
    ui.label(
        RichText::new(format!("{stage}, epoch {epoch} of at most {}", progress.max_epochs.max(1)))
            .color(tokens.text),
    );
    let done = (progress.epoch * progress.n + progress.done) as f32;
    progress_ui(ui, stage, done / (progress.max_epochs.max(1) * progress.n.max(1)) as f32);
    ui.add_space(4.0);
    if progress.loss.is_finite() {
        row_ui(ui, "Loss", format!("{:.4}", progress.loss));
    }
    if let Some(held_out) = progress.held_out {
        let best = if progress.is_best { ", the best yet" } else { "" };
        row_ui(ui, "Loss on held-out episodes", format!("{held_out:.4}{best}"));
    }
    row_ui(ui, "Learning rate", format!("{:.1e}", progress.learning_rate));
    if let Some((rate, left)) = fit.rate(now) {
        row_ui(ui, "Rate", format!("{rate:.0} {what} a second"));
        row_ui(ui, "This stage ends", format!("in at most {}", duration(left)));
    }
    let curves = [
        Curve { name: "training", points: &fit.loss, color: tokens.lines[0] },
        Curve { name: "held out", points: &fit.held_out, color: tokens.lines[1] },
    ];
    let about = "What training makes small, and the same on episodes that it does not learn from";
    curves_ui(ui, ("Loss by epoch", about), &curves, None, Corner::RightTop, 180.0);
}

/// `2 h 5 min`.
fn duration(secs: f64) -> String {
    let minutes = (secs / 60.0).ceil() as u64;
    if minutes < 60 { format!("{minutes} min") } else { format!("{} h {} min", minutes / 60, minutes % 60) }
}
