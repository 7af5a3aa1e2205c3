//! What is seen while a trajectory is being made and there is nothing to answer yet.

use eframe::egui::Ui;

use crate::app::{Command, LabelCommand, Panel, WindowCommand};
use crate::planner::synthesis::Acquisition;
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::label::protocol::protocol_ui;
use crate::ui::tokens::{self, GAP};
use crate::ui::widgets::gauge::progress_ui;
use crate::ui::widgets::keycap::{KeyButton, Tone};
use crate::ui::widgets::layout::{heading, titled_card};

/// How wide the text is.
const WIDTH: f32 = 560.0;

pub(in crate::ui) fn waiting_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    heading(
        ui,
        "Label",
        "Here you will judge single steps of short trajectories that are made to be worth asking about.",
    );
    ui.set_max_width(WIDTH);
    ui.horizontal(|ui| {
        ui.label(tokens::muted(ui, "The questions are those of"));
        protocol_ui(ui, state, commands);
    });
    ui.add_space(GAP);
    let making = &state.label.synthesis;
    if let Some(ordered) = &making.ordered {
        titled_card(ui, "The next trajectory is being made", |ui| {
            ui.label(format!(
                "Fifty steps {}, found by following the gradient of that.",
                about(ordered.acquisition)
            ));
            ui.label(tokens::small(
                ui,
                "It is asked about as soon as it is there, and the next one is made while you answer.",
            ));
            ui.add_space(4.0);
            let share = format!("{:.0} %", 100.0 * ordered.share);
            progress_ui(ui, &format!("Making a trajectory, {share}"), ordered.share);
            ui.label(tokens::small(ui, share));
            if KeyButton::new("Stop").is_pressed(ui) {
                commands.push(Command::Label(LabelCommand::Synthesize(false)));
            }
        });
    } else if making.is_stopped {
        ui.label("No trajectory is being made.");
        ui.add_space(GAP);
        if KeyButton::new("Make the next one").tone(Tone::Primary).is_pressed(ui) {
            commands.push(Command::Label(LabelCommand::Synthesize(true)));
        }
    } else if state.world.loaded.is_none() {
        ui.label("Trajectories are made in a world model: load one first.");
        ui.add_space(GAP);
        if KeyButton::new("Go to world models").tone(Tone::Primary).is_pressed(ui) {
            commands.push(Command::Window(WindowCommand::Show(Panel::World)));
        }
    } else if state.world.loaded.as_ref().is_some_and(|world| world.starts.is_empty()) {
        ui.label(
            "A trajectory needs a place to begin: this world model has none, so dream first, and keep it.",
        );
        ui.add_space(GAP);
        if KeyButton::new("Go and dream").tone(Tone::Primary).is_pressed(ui) {
            commands.push(Command::Window(WindowCommand::Show(Panel::Dream)));
        }
    } else {
        ui.label("A trajectory is about to be made.");
    }
}

/// What a trajectory is made to be.
fn about(acquisition: Acquisition) -> &'static str {
    match acquisition {
        Acquisition::Uncertainty => "about which the networks of the reward disagree most",
        Acquisition::MaxReward => "that the reward finds best",
        Acquisition::MinReward => "that the reward finds worst",
        Acquisition::Novelty => "as unlike what was judged before as can be",
    }
}

/// How far the next one is, in a few words, while another is answered.
pub(super) fn in_short(state: &View<'_>) -> Option<String> {
    let ordered = state.label.synthesis.ordered.as_ref()?;
    Some(format!("next one: {:.0} % made", 100.0 * ordered.share))
}
