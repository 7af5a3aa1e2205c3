//! Where to save what cannot be saved where it was to be.

use std::path::PathBuf;

use eframe::egui::{Id, Key, Modal, Ui};

use crate::app::SaveAs;
use crate::app::{Command, Field, SessionCommand};
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::tokens::{self, GAP};
use crate::ui::widgets::field::path_ui;
use crate::ui::widgets::keycap::{KeyButton, Tone};
use crate::ui::widgets::layout::dialog_frame;

pub(in crate::ui) fn saving_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let Some(asked) = state.saving.asked else { return };
    let (title, about, name, key_action) = match asked {
        SaveAs::Session => (
            "Save elsewhere",
            "All of the session is written to another folder and goes on there: what was said, dreams and rewards, and what could not be saved.",
            "The folder to make",
            "Save there",
        ),
        SaveAs::Sessions => (
            "Where sessions are kept",
            "Every session is a folder in this one.",
            "The folder of sessions",
            "Keep them there",
        ),
        SaveAs::Recording => (
            "Save elsewhere",
            "All that was done is written to another folder of recordings and goes on there.",
            "The folder of recordings",
            "Save there",
        ),
    };
    let close = Command::Session(SessionCommand::ChoosePlace(None));
    let modal = Modal::new(Id::unique("elsewhere")).frame(dialog_frame(ui)).show(ui.ctx(), |ui| {
        ui.set_width(520.0);
        ui.label(tokens::title(title));
        ui.label(tokens::muted(ui, about));
        ui.add_space(GAP);
        path_ui(ui, state, Field::SaveAs, name, commands);
        ui.add_space(GAP);
        ui.horizontal(|ui| {
            let path = state.field(Field::SaveAs).trim();
            let button = KeyButton::new(key_action).tone(Tone::Primary).enabled(!path.is_empty());
            if button.is_pressed(ui) {
                commands.push(Command::Session(SessionCommand::SaveIn(PathBuf::from(path))));
            }
            if KeyButton::new("Cancel").key(Key::Escape).tone(Tone::Quiet).show(ui).clicked() {
                commands.push(close.clone());
            }
        });
    });
    if modal.should_close() && !commands.contains(&close) {
        commands.push(close);
    }
}
