//! Who answered about these dreams, and how far they agree.

use eframe::egui::{RichText, Ui};

use crate::app::{Command, SessionCommand};
use crate::session::AnnotatorReport;
use crate::text::{shown, shown_within};
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::tokens::{self, Tokens};
use crate::ui::widgets::keycap::{KeyButton, Tone};
use crate::ui::widgets::layout::titled_card;

pub(in crate::ui) fn card_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    titled_card(ui, "Annotators", |ui| {
        let Some(found) = &state.label.annotators else {
            ui.label(tokens::small(ui, "All who answered about these dreams, in this session or another"));
            if KeyButton::new("Compare").tone(Tone::Quiet).small().is_pressed(ui) {
                commands.push(Command::Session(SessionCommand::CompareAnnotators));
            }
            return several_ui(ui, commands);
        };
        let color = Tokens::of(ui).text;
        for one in &found.each {
            ui.label(RichText::new(shown(&one.name)).size(13.5).color(color));
            ui.label(tokens::small(ui, in_words(one)));
        }
        for ([one, other], agreement) in &found.pairs {
            ui.label(RichText::new(format!("{} and {}", shown(one), shown(other))).size(13.5).color(color));
            let kappa = agreement.kappa.map_or_else(String::new, |kappa| format!(", κ {kappa:.2}"));
            let said = format!(
                "{} of {} alike{kappa}, {} differ about safety",
                agreement.n_same, agreement.n, agreement.n_critical
            );
            ui.label(tokens::small(ui, said))
                .on_hover_text("Cohen's κ: 1 is agreeing always, 0 is what chance would do");
        }
        for note in &found.notes {
            ui.label(tokens::small(ui, shown_within(note, 200)));
        }
        if found.pairs.is_empty() {
            ui.label(tokens::small(ui, "No two of them answered the same query"));
        }
        if KeyButton::new("Compare anew").tone(Tone::Quiet).small().is_pressed(ui) {
            commands.push(Command::Session(SessionCommand::CompareAnnotators));
        }
        several_ui(ui, commands);
    });
}

/// The way to sessions of several.
fn several_ui(ui: &mut Ui, commands: &mut Commands) {
    let button = KeyButton::new("Merge or hand on…").tone(Tone::Quiet).small().show(ui);
    let about = "Put sessions of several annotators together, or have somebody else answer the same queries";
    if button.on_hover_text(about).clicked() {
        commands.push(Command::Session(SessionCommand::ToggleMerge));
    }
}

fn in_words(one: &AnnotatorReport) -> String {
    let median = one.median_secs.map_or_else(String::new, |secs| format!(", {secs:.1} s each"));
    let rate = one.labels_per_hour().map_or_else(String::new, |rate| format!(", {rate:.0} an hour"));
    let again = one
        .consistency
        .map_or_else(String::new, |again| format!(", {} of {} as before", again.n_same, again.n));
    format!("{} answers{median}{rate}{again}", one.n_answered)
}
