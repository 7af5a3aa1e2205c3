//! What the reward says under clips that are looked at again.

use eframe::egui::{Align, Layout, Ui, Vec2, vec2};

use crate::query::QueryId;
use crate::ui::View;
use crate::ui::tokens::GAP;
use crate::ui::widgets::predictions::{WORDS, most, prediction_ui};

/// The height of what the reward says of a clip.
const HEIGHT: f32 = 40.0 + WORDS;
/// Its size in the list of answers.
const SMALL: Vec2 = vec2(210.0, 48.0 + WORDS);

/// The height that it takes under the clips, if it has a place there: only where an answer is looked at again.
pub(in crate::ui) fn height(state: &View<'_>) -> Option<f32> {
    (state.reconsidered().is_some() && state.reward.parameters.is_some()).then_some(HEIGHT)
}

/// What the reward says of the clips of an answered query, each in `width` points.
pub(in crate::ui) fn under_clips_ui(ui: &mut Ui, state: &View<'_>, width: f32) {
    let Some(height) = height(state) else { return };
    let size = vec2(ui.available_width(), height);
    ui.allocate_ui_with_layout(size, Layout::left_to_right(Align::Min), |ui| {
        ui.spacing_mut().item_spacing.x = GAP;
        ui.set_min_height(height);
        if let Some(query) = state.reconsidered() {
            clips_ui(ui, state, query, Some(state.frame()), vec2(width, height));
        }
    });
}

/// What was said, and what the reward says of it.
pub(in crate::ui) fn hover_ui(ui: &mut Ui, state: &View<'_>, query: QueryId, said: &str) {
    ui.label(format!("{said}\nClick to answer it again"));
    ui.horizontal(|ui| clips_ui(ui, state, query, None, SMALL));
}

fn clips_ui(ui: &mut Ui, state: &View<'_>, query: QueryId, frame: Option<usize>, size: Vec2) {
    let Some(clips) = state.prediction(query) else { return };
    let most = most(clips);
    // A transition has one clip.
    let n = if state.protocol().is_sparse() { 1 } else { 2 };
    for (clip, name) in clips.iter().zip(["Left clip", "Right clip"]).take(n) {
        prediction_ui(ui, name, clip, most, frame, size);
    }
}
