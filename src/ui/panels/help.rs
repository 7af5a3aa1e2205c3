//! Every key of every panel, and who draws the window.

use eframe::egui::{Grid, Id, Key, Modal, RichText, Ui};

use crate::ui::command::Command;
use crate::ui::state::State;
use crate::ui::tokens::{self, GAP, Tokens};
use crate::ui::widgets::keycap::{KeyButton, Tone, keycap};
use crate::ui::widgets::layout::dialog_frame;

type Keys = &'static [(&'static [Key], &'static str)];

const DRIVING: Keys = &[
    (&[Key::ArrowLeft, Key::ArrowRight, Key::A, Key::D], "steer"),
    (&[Key::ArrowUp, Key::W], "gas"),
    (&[Key::ArrowDown, Key::S], "brake"),
    (&[Key::N], "end and keep"),
    (&[Key::R], "throw away and redo"),
    (&[Key::P], "pause"),
    (&[Key::Period], "one step, paused"),
    (&[Key::U], "unsafe now"),
    (&[Key::Escape], "leave"),
];

const LABELING: Keys = &[
    (&[Key::A], "only left is safe"),
    (&[Key::D], "only right is safe"),
    (&[Key::S], "neither is safe"),
    (&[Key::ArrowLeft, Key::ArrowUp, Key::ArrowRight], "left, equal, right"),
    (&[Key::Space], "skip, then 1 2 3 for why"),
    (&[Key::Backspace], "undo, without limit"),
    (&[Key::F], "flag"),
    (&[Key::L], "list of answers"),
    (&[Key::G], "one question at a time"),
    (&[Key::Num0], "clips from the start"),
    (&[Key::Comma, Key::Period], "frame by frame"),
    (&[Key::OpenBracket, Key::CloseBracket], "slower, faster"),
];

pub(super) fn help_ui(ui: &mut Ui, state: &State, commands: &mut Vec<Command>) {
    let modal = Modal::new(Id::unique("help")).frame(dialog_frame(ui)).show(ui.ctx(), |ui| {
        ui.set_width(620.0);
        ui.label(tokens::title("Keys"));
        ui.add_space(GAP);
        ui.columns(2, |columns| {
            keys_ui(&mut columns[0], "Driving", DRIVING);
            keys_ui(&mut columns[1], "Labeling", LABELING);
        });
        ui.add_space(GAP);
        ui.label(tokens::small(ui, "Ctrl and 1 to 6 go to a panel. A gamepad drives with its left stick and triggers: Y keeps, X redoes, A marks, Start pauses, B leaves. Labeling: shoulders and cross, B skips, Back undoes."));
        ui.add_space(GAP);
        ui.label(tokens::small(ui, format!("dropj {} · drawn by {}", env!("CARGO_PKG_VERSION"), state.adapter)));
        ui.add_space(GAP);
        if KeyButton::new("Close").key(Key::Escape).tone(Tone::Quiet).show(ui).clicked() {
            commands.push(Command::ToggleHelp);
        }
    });
    if modal.should_close() && !commands.contains(&Command::ToggleHelp) {
        commands.push(Command::ToggleHelp);
    }
}

fn keys_ui(ui: &mut Ui, heading: &str, keys: Keys) {
    let tokens = Tokens::of(ui);
    ui.label(RichText::new(heading).strong().color(tokens.text));
    Grid::new(heading).num_columns(2).spacing([16.0, 8.0]).show(ui, |ui| {
        for (caps, what) in keys {
            ui.horizontal(|ui| {
                ui.spacing_mut().item_spacing.x = 4.0;
                for key in *caps {
                    keycap(ui, *key);
                }
            });
            ui.label(tokens::muted(ui, *what));
            ui.end_row();
        }
    });
}
