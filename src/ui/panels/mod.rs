//! What is drawn: functions of the state that push commands.

mod annotators;
mod answers;
mod asking;
mod beside;
mod deploy;
mod dream;
mod elsewhere;
mod foretold;
mod help;
mod label;
mod progress;
mod pad;
mod rail;
mod record;
mod review;
mod reward;
mod sessions;
mod several;
mod shelf;
mod status;
mod trajectories;
mod weights;
mod world;

use eframe::egui::{CentralPanel, Frame, Key, Margin, Panel as Side, Ui};

use crate::ui::command::{Command, Panel};
use crate::ui::input;
use crate::ui::state::State;
use crate::ui::tokens::{PAD, Tokens};

/// The whole window.
pub(super) fn window_ui(ui: &mut Ui, state: &State, commands: &mut Vec<Command>) {
    let tokens = Tokens::of(ui);
    let frame = |fill, margin| Frame::new().fill(fill).inner_margin(margin);
    Side::bottom("status")
        .exact_size(30.0)
        .resizable(false)
        .show_separator_line(false)
        .frame(frame(tokens.rail, Margin::symmetric(16, 0)))
        .show(ui, |ui| status::status_ui(ui, state, commands));
    Side::left("rail")
        .exact_size(208.0)
        .resizable(false)
        .show_separator_line(false)
        .frame(frame(tokens.rail, Margin::symmetric(12, 16)))
        .show(ui, |ui| rail::rail_ui(ui, state, commands));
    // Where clips are judged, room for them counts more than air.
    let air = if state.panel == Panel::Label { PAD as i8 / 2 } else { PAD as i8 };
    CentralPanel::default().frame(frame(tokens.background, Margin::symmetric(PAD as i8, air))).show(
        ui,
        |ui| match state.panel {
            Panel::Record => record::record_ui(ui, state, commands),
            Panel::World => world::world_ui(ui, state, commands),
            Panel::Dream => dream::dream_ui(ui, state, commands),
            Panel::Label => label::label_ui(ui, state, commands),
            Panel::Reward => reward::reward_ui(ui, state, commands),
            Panel::Deploy => deploy::deploy_ui(ui, state, commands),
        },
    );
    status::toasts_ui(ui, state, commands);
    if state.sessions_open {
        sessions::sessions_ui(ui, state, commands);
    }
    if state.several.is_open {
        several::several_ui(ui, state, commands);
    }
    if state.saving.asked.is_some() {
        elsewhere::elsewhere_ui(ui, state, commands);
    }
    if state.help_open {
        help::help_ui(ui, state, commands);
    } else if [Key::Questionmark, Key::Slash, Key::F1].into_iter().any(|key| input::pressed(ui, key)) {
        commands.push(Command::ToggleHelp);
    }
}
