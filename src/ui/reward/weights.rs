//! How much answers weigh: sliders that teach the reward anew when they are let go.

use eframe::egui::{Slider, Ui};

use crate::app::reward::with_justification;
use crate::app::{Command, RewardCommand};
use crate::query::{Protocol, Weights};
use crate::session::Session;
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::tokens;
use crate::ui::widgets::keycap::{KeyButton, Tone};

/// The least that a weight can be: at one half an answer would say nothing.
const LEAST: f32 = 0.51;

pub(in crate::ui) fn weights_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let weights = state.reward.tried.clone().unwrap_or_else(|| state.weights());
    let protocols = state.session().map_or_else(|| vec![state.protocol()], Session::protocols);
    let has = |protocol| protocols.contains(&protocol) || state.protocol() == protocol;
    let (has_safety, has_reasons) = (has(Protocol::Dropj), has(Protocol::DropjMulti));
    if !has_safety && !has_reasons {
        ui.label(tokens::muted(ui, "Plain preferences all weigh the same."));
        return;
    }
    if has_safety {
        let about = "How sure it is that the clip that stays safe is better than one that does not \
                     (w_s; the paper has 1)";
        slider_ui(ui, "one is unsafe", weights.safety, about, commands, |safety| Weights {
            safety,
            ..weights.clone()
        });
        let about = "How sure it is that the preferred clip is better where both stay safe (w_def; the \
                     paper has 0.75)";
        slider_ui(ui, "both are safe", weights.default, about, commands, |default| Weights {
            default,
            ..weights.clone()
        });
    }
    if has_reasons {
        for (idx, (_, name, weight)) in weights.justifications.iter().enumerate() {
            let about = format!(
                "How sure it is that the preferred clip is better where {name} was the reason (w_{}); a \
                 less severe reason never weighs more",
                idx + 1
            );
            slider_ui(ui, name, weight, &about, commands, |weight| with_justification(&weights, idx, weight));
        }
    }
    let first = state.header().map(|header| header.config.weights.clone());
    ui.horizontal(|ui| {
        if let Some(first) = first.filter(|first| *first != weights) {
            let button = KeyButton::new("As at first").tone(Tone::Quiet).small();
            if button.show(ui).on_hover_text("The weights that the session began with").clicked() {
                commands.push(Command::Reward(RewardCommand::ChangeWeights(first)));
            }
        }
        if state.reward.is_relearning {
            ui.label(tokens::small(ui, "learning anew…"));
        }
    });
}

/// One weight; while it is dragged it is only shown, and counts when it is let go.
fn slider_ui(
    ui: &mut Ui,
    name: &str,
    weight: f32,
    about: &str,
    commands: &mut Commands,
    with: impl Fn(f32) -> Weights,
) {
    let mut moved = weight;
    ui.spacing_mut().slider_width = (ui.available_width() - 170.0).max(70.0);
    let slider = Slider::new(&mut moved, LEAST..=1.0).step_by(0.01).fixed_decimals(2).text(name);
    let response = ui.add(slider).on_hover_text(about);
    if response.dragged() && moved != weight {
        commands.push(Command::Reward(RewardCommand::TryWeights(with(moved))));
    } else if response.drag_stopped() || response.changed() {
        commands.push(Command::Reward(RewardCommand::ChangeWeights(with(moved))));
    }
}
