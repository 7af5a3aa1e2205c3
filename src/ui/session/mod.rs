//! Beginning a session, and going on with another.

pub(super) mod merge;
pub(super) mod saving;

use std::path::PathBuf;

use eframe::egui::{Align, Id, Key, Layout, Modal, RichText, ScrollArea, Ui, UiBuilder};

use crate::app::session::is_same;
use crate::app::{Command, Field, Purpose, SessionCommand, WindowCommand};
use crate::query::Protocol;
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::tokens::{self, GAP, Tokens};
use crate::ui::widgets::field::path_ui;
use crate::ui::widgets::keycap::{KeyButton, Tone};
use crate::ui::widgets::layout::dialog_frame;
use crate::worker::SessionItem;

/// The height of all but the list of sessions.
const AROUND: f32 = 580.0;

pub(in crate::ui) fn sessions_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let modal = Modal::new(Id::unique("sessions")).frame(dialog_frame(ui)).show(ui.ctx(), |ui| {
        ui.set_width(600.0);
        ui.label(tokens::title("Sessions"));
        ui.label(tokens::muted(ui, "A session holds dreams, answers and rewards. It saves itself."));
        ui.add_space(GAP);
        new_ui(ui, state, commands);
        ui.add_space(GAP);
        recent_ui(ui, state, commands);
        ui.add_space(GAP);
        path_ui(ui, state, Field::Session, "Or the folder of a session", commands);
        ui.add_space(4.0);
        ui.horizontal(|ui| {
            let path = state.field(Field::Session).trim();
            if KeyButton::new("Open").enabled(!path.is_empty()).is_pressed(ui) {
                commands.push(Command::Session(SessionCommand::Open(PathBuf::from(path))));
            }
            if KeyButton::new("Close").key(Key::Escape).tone(Tone::Quiet).show(ui).clicked() {
                commands.push(Command::Session(SessionCommand::ToggleList));
            }
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| import_ui(ui, state, commands));
        });
    });
    if modal.should_close() && !commands.contains(&Command::Session(SessionCommand::ToggleList)) {
        commands.push(Command::Session(SessionCommand::ToggleList));
    }
}

fn new_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let tokens = Tokens::of(ui);
    ui.label(RichText::new("Begin a new one").strong().color(tokens.text));
    let has_world = state.world.loaded.is_some();
    for (protocol, about) in [
        (Protocol::Dropj, "Which clips stay safe; where both do, which is better"),
        (Protocol::Drope, "Left, equal or right"),
        (Protocol::Drop, "Left or right"),
        (Protocol::DropjMulti, "What matters most, and left, equal or right"),
        (Protocol::Dros, "Whether each single step is unsafe, good or neither"),
        (Protocol::Request, "The same of trajectories made to be worth asking about"),
    ] {
        ui.horizontal(|ui| {
            let tone = if protocol == Protocol::of(&state.spec) { Tone::Primary } else { Tone::Plain };
            let button = KeyButton::new(protocol.name()).tone(tone).enabled(has_world);
            if button.width(160.0).is_pressed(ui) {
                commands.push(Command::Session(SessionCommand::New(protocol)));
            }
            ui.label(tokens::muted(ui, about));
        });
    }
}

/// What else can be taken in from elsewhere, from the right to the left.
fn import_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let recordings = "A folder of recorded episodes: world models are fitted to them, and new ones are added";
    let world = "A file of network parameters; its dreams are another session's";
    let other = "The world.toml of another world: the program begins anew with it, and this session is kept";
    for (name, purpose, about) in [
        ("Recordings…", Purpose::Recordings, recordings),
        ("World model…", Purpose::World, world),
        ("World…", Purpose::Env, other),
    ] {
        let button = KeyButton::new(name).enabled(state.job.is_none()).show(ui);
        if button.on_hover_text(about).clicked() {
            commands.push(Command::Window(WindowCommand::Import(purpose)));
        }
    }
    ui.label(tokens::small(ui, "Take in"));
}

fn recent_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let tokens = Tokens::of(ui);
    ui.scope(|ui| {
        // As high as its words, where other rows are as high as buttons.
        ui.spacing_mut().interact_size.y = 0.0;
        ui.horizontal(|ui| {
            ui.label(RichText::new("Go on with").strong().color(tokens.text));
            if state.list.is_listing {
                ui.label(tokens::small(ui, "Looking at the sessions…"));
            }
        });
    });
    // In a low window the rest must stay in reach.
    let room = (ui.ctx().content_rect().height() - AROUND).clamp(60.0, 190.0);
    // It takes all its room at once: nothing moves away from under a hand while it fills.
    let list = ScrollArea::vertical()
        .id_salt("recent")
        .max_height(room)
        .min_scrolled_height(room)
        .auto_shrink(false);
    list.show(ui, |ui| {
        if state.list.found.is_empty() && !state.list.is_listing {
            ui.label(tokens::muted(ui, "None yet."));
        }
        for recent in &state.list.found {
            // Named by its folder, so that it keeps the focus where another comes above it.
            let row = UiBuilder::new().scope_id(Id::unique("recent").with(&recent.dir));
            ui.scope_builder(row, |ui| session_ui(ui, state, recent, commands));
        }
    });
}

fn session_ui(ui: &mut Ui, state: &View<'_>, listed: &SessionItem, commands: &mut Commands) {
    let warn = Tokens::of(ui).warn;
    ui.horizontal(|ui| {
        let is_open = state.open.as_ref().is_some_and(|open| is_same(&open.dir, &listed.dir));
        let button = KeyButton::new(&listed.name).tone(if is_open { Tone::Chosen } else { Tone::Plain });
        if button.enabled(listed.about.is_ok()).is_pressed(ui) {
            commands.push(Command::Session(SessionCommand::Open(listed.dir.clone())));
        }
        match &listed.about {
            Ok(about) => ui.label(tokens::small(ui, about.as_str())),
            Err(why) => ui.label(tokens::small(ui, why.as_str()).color(warn)),
        };
    });
}
