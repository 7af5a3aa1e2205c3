//! Sessions of several annotators: put together, or handed on to somebody else.

use eframe::egui::{Id, Key, Modal, RichText, ScrollArea, Ui};

use crate::app::{Command, Field, Purpose, SessionCommand, WindowCommand};
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::tokens::{self, GAP, Tokens};
use crate::ui::widgets::field::field_ui;
use crate::ui::widgets::keycap::{KeyButton, Tone};
use crate::ui::widgets::layout::dialog_frame;

pub(in crate::ui) fn merge_sessions_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let modal = Modal::new(Id::unique("several")).frame(dialog_frame(ui)).show(ui.ctx(), |ui| {
        ui.set_width(560.0);
        ui.label(tokens::title("Several annotators"));
        ui.add_space(GAP);
        merge_ui(ui, state, commands);
        ui.add_space(GAP);
        hand_on_ui(ui, state, commands);
        ui.add_space(GAP);
        ui.horizontal(|ui| {
            if KeyButton::new("Close").key(Key::Escape).tone(Tone::Quiet).show(ui).clicked() {
                commands.push(Command::Session(SessionCommand::ToggleMerge));
            }
            if let Some(doing) = state.job {
                ui.label(tokens::muted(ui, format!("{doing}…")));
            }
        });
    });
    if modal.should_close() && !commands.contains(&Command::Session(SessionCommand::ToggleMerge)) {
        commands.push(Command::Session(SessionCommand::ToggleMerge));
    }
}

fn merge_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let tokens = Tokens::of(ui);
    ui.label(RichText::new("Put sessions together").strong().color(tokens.text));
    ui.label(tokens::muted(
        ui,
        "A new session with all that was said in these, which stay as they are. The reward is to be learned anew there.",
    ));
    let several = &state.merge;
    let list = ScrollArea::vertical().id_salt("several").max_height(220.0);
    list.show(ui, |ui| {
        let Some(found) = &several.found else {
            return drop(ui.label(tokens::muted(ui, "Looking at the sessions…")));
        };
        for session in found {
            ui.horizontal(|ui| {
                let mut is_chosen = several.chosen.contains(&session.dir) && session.about.is_ok();
                ui.add_enabled_ui(session.about.is_ok(), |ui| {
                    if ui.checkbox(&mut is_chosen, &session.name).changed() {
                        commands.push(Command::Session(SessionCommand::ChooseForMerge(
                            session.dir.clone(),
                            is_chosen,
                        )));
                    }
                });
                match &session.about {
                    Ok(about) => ui.label(tokens::small(ui, about.as_str())),
                    Err(why) => ui.label(tokens::small(ui, why.as_str()).color(tokens.warn)),
                };
            });
        }
    });
    let is_idle = state.job.is_none();
    let n_chosen = several
        .found
        .iter()
        .flatten()
        .filter(|session| session.about.is_ok() && several.chosen.contains(&session.dir));
    let n_chosen = n_chosen.count();
    ui.horizontal(|ui| {
        let merge = KeyButton::new("Put together").tone(Tone::Primary);
        if merge.enabled(is_idle && n_chosen >= 2).is_pressed(ui) {
            commands.push(Command::Session(SessionCommand::Merge));
        }
        if KeyButton::new("Add folders…").enabled(is_idle).is_pressed(ui) {
            commands.push(Command::Window(WindowCommand::Import(Purpose::Merge)));
        }
        if n_chosen < 2 {
            ui.label(tokens::small(ui, "Choose at least two"));
        }
    });
}

fn hand_on_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let tokens = Tokens::of(ui);
    ui.label(RichText::new("Hand this session on").strong().color(tokens.text));
    ui.label(tokens::muted(
        ui,
        "A new session with the same dreams and queries and without the answers, so that somebody else answers the same.",
    ));
    field_ui(ui, state, Field::HandOnTo, "Who is to answer", commands);
    let is_ready = state.job.is_none() && state.open.is_some();
    let is_named = !state.field(Field::HandOnTo).trim().is_empty();
    if KeyButton::new("Hand on").enabled(is_ready && is_named).is_pressed(ui) {
        commands.push(Command::Session(SessionCommand::HandOn));
    }
}
