//! The quiet line at the foot of the window, and the messages above it.

use eframe::egui::{
    Align, Align2, Area, Frame, Id, Key, Layout, Margin, Order, RichText, Sense, Stroke, ThemePreference, Ui,
    vec2,
};

use crate::app::SaveAs;
use crate::app::counted;
use crate::app::{Command, Field, MessageKind, Panel, SessionCommand, WindowCommand};
use crate::text::shown;
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::guide::HINT;
use crate::ui::label::progress;
use crate::ui::settings::SettingsCommand;
use crate::ui::tokens::{self, CORNER, Tokens};
use crate::ui::widgets::keycap::{KeyButton, Tone, keycap};

pub(super) fn status_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let tokens = Tokens::of(ui);
    ui.horizontal_centered(|ui| {
        ui.spacing_mut().item_spacing.x = 14.0;
        ui.label(tokens::small(ui, state.spec.title.as_str()))
            .on_hover_text("The world that all of this is about");
        let annotator = annotator(state);
        let about = "Who answers, kept with every answer; the list of answers has a field for the name";
        ui.label(tokens::small(ui, annotator)).on_hover_text(about);
        match &state.open {
            _ if state.saving.trouble.is_some() => unsaved_ui(ui, state, commands),
            Some(open) => {
                let n = open.session.n_entries();
                let text = tokens::small(ui, format!("saved · {}", counted(n as usize, "event")));
                ui.label(text).on_hover_text(open.dir.display().to_string());
            }
            None => drop(ui.label(tokens::small(ui, "nothing to save yet"))),
        }
        for job in jobs(state) {
            let (rect, _) = ui.allocate_exact_size(vec2(7.0, 7.0), Sense::hover());
            ui.painter().circle_filled(rect.center(), 3.5, tokens.accent);
            ui.add_space(-8.0);
            ui.label(tokens::small(ui, job));
        }
        for pad in &state.settings.pads {
            ui.label(tokens::small(ui, pad.as_str()));
        }
        progress::break_ui(ui, state, commands);
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            ui.spacing_mut().item_spacing.x = 6.0;
            if quiet_ui(ui, "Keys and help").on_hover_text("Every key of every panel").clicked() {
                commands.push(Command::Window(WindowCommand::ToggleHelp));
            }
            keycap(ui, Key::Questionmark);
            ui.add_space(12.0);
            let (name, next) = match state.settings.theme {
                ThemePreference::System => ("As the system", ThemePreference::Light),
                ThemePreference::Light => ("Light", ThemePreference::Dark),
                ThemePreference::Dark => ("Dark", ThemePreference::System),
            };
            if quiet_ui(ui, name).on_hover_text("Light, dark, or as the system says").clicked() {
                commands.push(SettingsCommand::Theme(next));
            }
        });
    });
}

/// Whose answers these are.
fn annotator(state: &View<'_>) -> String {
    let typed = state.field(Field::Annotator).trim();
    let of_the_session = state.header().map_or("anonymous", |header| header.config.annotator.as_str());
    shown(if typed.is_empty() { of_the_session } else { typed })
}

/// What is not on disk, and a way to put it there.
fn unsaved_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let bad = Tokens::of(ui).bad;
    let (text, asked) = match &state.open {
        None => ("no place to save".to_owned(), SaveAs::Sessions),
        Some(open) if open.n_unsaved == 0 => ("not saved".to_owned(), SaveAs::Session),
        Some(open) => (format!("not saved: {}", counted(open.n_unsaved, "event")), SaveAs::Session),
    };
    let text = tokens::small(ui, text).color(bad);
    let button = ui.add(eframe::egui::Button::new(text).frame(false));
    let why = state.saving.trouble.as_deref().unwrap_or_default();
    if button.on_hover_text(why).clicked() {
        commands.push(Command::Session(SessionCommand::ChoosePlace(Some(asked))));
    }
}

/// A word that can be clicked.
fn quiet_ui(ui: &mut Ui, text: &str) -> eframe::egui::Response {
    let text = tokens::small(ui, text);
    ui.add(eframe::egui::Button::new(text).frame(false))
}

/// What is being done now.
fn jobs(state: &View<'_>) -> Vec<String> {
    let mut jobs = Vec::new();
    if state.world.loading.is_some() {
        jobs.push("reading the world model".to_owned());
    }
    if let Some(opening) = &state.opening {
        jobs.push(format!("session: {}", opening.progress()));
    }
    if let Some(progress) = state.world.fit.as_ref().and_then(|fit| fit.progress.as_ref()) {
        jobs.push(format!("world model: epoch {} of {}", progress.epoch + 1, progress.max_epochs));
    } else if state.world.fit.is_some() {
        jobs.push("world model: beginning".to_owned());
    }
    if let Some(learning) = state.reward.latest.as_ref().filter(|_| state.reward.is_fitting) {
        let epochs = learning.fit_epochs.map_or_else(String::new, |n| format!(" of {n}"));
        jobs.push(format!("reward: epoch {}{epochs}", learning.epoch));
    }
    if state.reward.is_relearning {
        jobs.push("reward: learning by other weights".to_owned());
    }
    jobs.extend(state.job.map(str::to_owned));
    if state.guide.is_preparing {
        jobs.push("preparing twenty questions".to_owned());
    }
    if state.clips.n_writing > 0 {
        jobs.push("writing a clip".to_owned());
    }
    if let Some(ordered) = &state.label.synthesis.ordered {
        jobs.push(format!("trajectory: {:.0} %", 100.0 * ordered.share));
    }
    if state.record.is_ending {
        jobs.push("recording: being sealed".to_owned());
    }
    if state.deploy.is_on {
        jobs.push(format!("episode of seed {}", state.deploy.seed));
    }
    jobs
}

/// Messages, the newest lowest.
pub(super) fn messages_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    if state.messages.is_empty() {
        return;
    }
    let tokens = Tokens::of(ui);
    // What can be done about a hint stays in reach, and so do the answers, which are at the foot of their panel.
    let hint = if state.hint().is_some() { HINT } else { 0.0 };
    let (corner, offset) = match state.panel {
        Panel::Label => (Align2::RIGHT_TOP, vec2(-20.0, 8.0)),
        _ => (Align2::RIGHT_BOTTOM, vec2(-20.0, -46.0 - hint)),
    };
    Area::new(Id::unique("toasts")).order(Order::Foreground).anchor(corner, offset).interactable(true).show(
        ui.ctx(),
        |ui| {
            for toast in &state.messages {
                let color = match toast.kind {
                    MessageKind::Note => tokens.accent,
                    MessageKind::Done => tokens.good,
                    MessageKind::Error => tokens.bad,
                };
                let frame = Frame::new()
                    .fill(tokens.raised)
                    .stroke(Stroke::new(1.0, color))
                    .corner_radius(CORNER)
                    .inner_margin(Margin::symmetric(14, 10));
                frame.show(ui, |ui| {
                    ui.set_width(380.0);
                    ui.horizontal_top(|ui| {
                        let room = ui.available_width() - 60.0;
                        ui.vertical(|ui| {
                            ui.set_width(room);
                            // In the middle of the button beside it, as long as it is one line.
                            ui.add_space(7.0);
                            ui.label(RichText::new(&toast.text).color(tokens.text));
                            if !toast.ways.is_empty() {
                                ui.horizontal(|ui| {
                                    for (name, command) in &toast.ways {
                                        if KeyButton::new(name).is_pressed(ui) {
                                            commands.push(command.clone());
                                            commands.push(Command::Window(WindowCommand::Dismiss(toast.id)));
                                        }
                                    }
                                });
                            }
                        });
                        if KeyButton::new("Close").tone(Tone::Quiet).show(ui).clicked() {
                            commands.push(Command::Window(WindowCommand::Dismiss(toast.id)));
                        }
                    });
                });
            }
        },
    );
}
