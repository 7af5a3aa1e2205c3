//! The real world and the dream of the same actions, side by side, with how far they are apart.

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
use crate::ui::widgets::layout::dream_shape;

/// The dream's picture, `height` points high.
pub(in crate::ui) fn dream_beside_ui(ui: &mut Ui, state: &View<'_>, height: f32) {
    let besides = &state.record.rollout;
    let label = besides.view.as_ref().map_or_else(
        || "The dream beside".to_owned(),
        |view| format!("The dream beside, {} steps after it last saw the world", view.since),
    );
    let empty = "The dream of the same actions: it sees the world once and then only what you do.";
    let picture = besides.picture.as_ref().filter(|_| state.record.is_on);
    picture_ui(ui, picture, vec2(height * dream_shape(state), height), &label, empty, Rim::Plain);
}

/// Whether and how a dream rides beside, and how far it has drifted.
pub(in crate::ui) fn drift_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let besides = &state.record.rollout;
    let is_on = besides.asked.is_some();
    let tone = if is_on { Tone::Chosen } else { Tone::Plain };
    let keys = &state.settings.keys;
    let key =
        if state.record.is_on { keys.free(KeyAction::Beside) } else { Some(keys.of(KeyAction::Beside)) };
    let button = KeyButton::new("Dream beside").key(key).tone(tone);
    if button.enabled(state.world.loaded.is_some()).is_pressed(ui) {
        commands.push(Command::Record(RecordCommand::ToggleRollout));
    }
    let Some(asked) = besides.asked else {
        ui.label(tokens::small(ui, "The world model dreams the same actions: see where it goes wrong"));
        return;
    };
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 4.0;
        ui.label(tokens::small(ui, "Looks again"));
        for (name, reset) in [("never", None), ("25", Some(25)), ("50", Some(50)), ("100", Some(100))] {
            let tone = if asked.reset == reset { Tone::Chosen } else { Tone::Quiet };
            let response = KeyButton::new(name).tone(tone).small().show(ui);
            let about = "After how many steps the dream sees the world again and begins anew";
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
