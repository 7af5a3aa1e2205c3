//! What is drawn: functions of the state that push commands.

use eframe::egui::{CentralPanel, Frame, Margin, Panel as Side, Ui};

use crate::app::{Command, Panel, WindowCommand};
use crate::ui::command::Commands;
use crate::ui::settings::help;
use crate::ui::tokens::{PAD, Tokens};
use crate::ui::{
    View, deploy, dream, evaluate, guide, input, label, rail, record, reward, session, status, world_model,
};

/// The whole window.
pub(super) fn window_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let tokens = Tokens::of(ui);
    let frame = |fill, margin| Frame::new().fill(fill).inner_margin(margin);
    Side::bottom("status")
        .exact_size(30.0)
        .resizable(false)
        .show_separator_line(false)
        .frame(frame(tokens.rail, Margin::symmetric(16, 0)))
        .show(ui, |ui| status::status_ui(ui, state, commands));
    if let Some(hint) = state.hint() {
        Side::bottom("hint")
            .exact_size(guide::HINT)
            .resizable(false)
            .show_separator_line(false)
            .frame(frame(tokens.surface, Margin::symmetric(16, 4)))
            .show(ui, |ui| guide::hint_ui(ui, state, hint, commands));
    }
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
            _ if state.guide.is_offering => guide::welcome_ui(ui, state, commands),
            Panel::Record => record::record_ui(ui, state, commands),
            Panel::World => world_model::world_ui(ui, state, commands),
            Panel::Dream => dream::dream_ui(ui, state, commands),
            Panel::Label => label::label_ui(ui, state, commands),
            Panel::Reward => reward::reward_ui(ui, state, commands),
            Panel::Deploy => deploy::deploy_ui(ui, state, commands),
            Panel::Evaluate => evaluate::evaluate_ui(ui, state, commands),
        },
    );
    status::messages_ui(ui, state, commands);
    if state.list.is_open {
        session::sessions_ui(ui, state, commands);
    }
    if state.merge.is_open {
        session::merge::merge_sessions_ui(ui, state, commands);
    }
    if state.saving.asked.is_some() {
        session::saving::saving_ui(ui, state, commands);
    }
    if state.help_open {
        help::help_ui(ui, state, commands);
    } else if input::asks_for_help(ui) {
        commands.push(Command::Window(WindowCommand::ToggleHelp));
    }
}
