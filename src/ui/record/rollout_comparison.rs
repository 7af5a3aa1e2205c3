//! The real car and the dream of the same drive, side by side, with how far they are apart.

use eframe::egui::{Ui, vec2};
use egui_plot::Corner;

use crate::app::{Command, RecordCommand};
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::settings::keymap::KeyAction;
use crate::ui::tokens::{self, Tokens};
use crate::ui::widgets::clip::{Rim, picture_ui};
use crate::ui::widgets::curve::{Curve, curves_ui};
use crate::ui::widgets::gauge::row_ui;
use crate::ui::widgets::keycap::{KeyButton, Tone};

/// The dream's picture, `side` points wide.
pub(in crate::ui) fn dream_beside_ui(ui: &mut Ui, state: &View<'_>, side: f32) {
    let besides = &state.record.rollout;
    let label = besides.view.as_ref().map_or_else(
        || "The dream beside".to_owned(),
        |view| format!("The dream beside, {} steps after it last saw the track", view.since),
    );
    let empty = "The dream of the same drive: it sees the track once and then only what you do.";
    let picture = besides.picture.as_ref().filter(|_| state.record.is_on);
    picture_ui(ui, picture, vec2(side, side), &label, empty, Rim::Plain);
}

/// Whether and how a dream rides beside, and how far it has drifted.
pub(in crate::ui) fn drift_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let besides = &state.record.rollout;
    let is_on = besides.asked.is_some();
    let tone = if is_on { Tone::Chosen } else { Tone::Plain };
    let button = KeyButton::new("Dream beside").key(state.settings.keys.of(KeyAction::Beside)).tone(tone);
    if button.enabled(state.world.loaded.is_some()).is_pressed(ui) {
        commands.push(Command::Record(RecordCommand::ToggleRollout));
    }
    let Some(asked) = besides.asked else {
        ui.label(tokens::small(ui, "The world model dreams the same drive: see where it goes wrong"));
        return;
    };
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 4.0;
        ui.label(tokens::small(ui, "Looks again"));
        for (name, reset) in [("never", None), ("25", Some(25)), ("50", Some(50)), ("100", Some(100))] {
            let tone = if asked.reset == reset { Tone::Chosen } else { Tone::Quiet };
            let response = KeyButton::new(name).tone(tone).small().show(ui);
            let about = "After how many steps the dream sees the track again and begins anew; the planner \
                         forgets everything after 50";
            if response.on_hover_text(about).clicked() {
                commands.push(Command::Record(RecordCommand::ResetRollout(reset)));
            }
        }
    });
    let drift = besides.view.as_ref().map_or("–".to_owned(), |view| format!("{:.1} %", 100.0 * view.drift));
    row_ui(ui, "Drift", drift);
    let about = "How far the dreamt picture is from the real one: the root of the mean squared difference of \
                 their pixels, as a share of the whole range";
    let color = Tokens::of(ui).lines[0];
    let curve = Curve { name: "drift", points: &besides.drift, color };
    curves_ui(ui, ("Drift by step", about), &[curve], None, Corner::LeftTop, 90.0);
}
