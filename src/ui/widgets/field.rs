//! Fields to type into.

use eframe::egui::{TextEdit, Ui};

use crate::app::{Command, Field, WindowCommand};
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::tokens;
use crate::ui::widgets::keycap::KeyButton;

/// A field under its name.
pub(crate) fn field_ui(ui: &mut Ui, state: &View<'_>, field: Field, name: &str, commands: &mut Commands) {
    let label = ui.label(tokens::small(ui, name));
    let width = ui.available_width();
    edit_ui(ui, state, field, width, label.id, commands);
}

/// A short field after its name.
pub(crate) fn inline_field_ui(
    ui: &mut Ui,
    state: &View<'_>,
    field: Field,
    name: &str,
    commands: &mut Commands,
) {
    let label = ui.label(tokens::small(ui, name));
    edit_ui(ui, state, field, 64.0, label.id, commands);
}

/// A path under its name, with a dialog to choose it in.
pub(crate) fn path_ui(ui: &mut Ui, state: &View<'_>, field: Field, name: &str, commands: &mut Commands) {
    let label = ui.label(tokens::small(ui, name));
    ui.horizontal(|ui| {
        let width = (ui.available_width() - 104.0).max(80.0);
        edit_ui(ui, state, field, width, label.id, commands);
        if KeyButton::new("Browse…").is_pressed(ui) {
            commands.push(Command::Window(WindowCommand::Browse(field)));
        }
    });
}

fn edit_ui(
    ui: &mut Ui,
    state: &View<'_>,
    field: Field,
    width: f32,
    label: eframe::egui::Id,
    commands: &mut Commands,
) {
    let mut text = state.field(field).to_owned();
    let edit =
        TextEdit::singleline(&mut text).desired_width(width).margin(eframe::egui::Margin::symmetric(8, 8));
    if ui.add(edit).labelled_by(label).changed() {
        commands.push(Command::Window(WindowCommand::Edit(field, text)));
    }
}
