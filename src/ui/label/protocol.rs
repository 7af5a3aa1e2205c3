//! Which questions are asked.

use eframe::egui::Ui;

use crate::app::{Command, LabelCommand};
use crate::query::Protocol;
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::tokens;

/// Which questions are asked, and which else could be.
pub(super) fn protocol_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let present = state.protocol();
    let menu = ui.menu_button(tokens::small(ui, present.name()), |ui| {
        for protocol in Protocol::ALL {
            if ui.selectable_label(protocol == present, protocol.name()).clicked() {
                commands.push(Command::Label(LabelCommand::ChangeProtocol(protocol)));
                ui.close();
            }
        }
    });
    menu.response.on_hover_text("Ask other questions from here on");
}
