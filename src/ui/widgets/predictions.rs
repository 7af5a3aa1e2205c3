//! What the reward says of a clip: a light line for each member, their mean, and the whole in words.

use eframe::egui::{
    Pos2, Rect, Role, Sense, Shape, Stroke, StrokeKind, Ui, Vec2, WidgetInfo, lerp, pos2, remap, vec2,
};

use crate::ui::tokens::{self, SMALL_CORNER, Tokens};
use crate::worker::ClipRewards;

/// The height of the words under the lines.
pub(crate) const WORDS: f32 = 18.0;

/// Draws what the reward says of `clip`, called `name`, up to `most` above and below zero; `frame` is what is seen now.
pub(crate) fn prediction_ui(
    ui: &mut Ui,
    name: &str,
    clip: &ClipRewards,
    most: f32,
    frame: Option<usize>,
    size: Vec2,
) {
    let tokens = Tokens::of(ui);
    ui.allocate_ui(size, |ui| {
        ui.spacing_mut().item_spacing.y = 0.0;
        ui.vertical(|ui| {
            let (rect, response) = ui.allocate_exact_size(vec2(size.x, size.y - WORDS), Sense::hover());
            let words = in_words(clip);
            response.widget_info(|| WidgetInfo::labeled(Role::Image, true, format!("{name}: the {words}")));
            let stroke = Stroke::new(1.0, tokens.border);
            ui.painter().rect(rect, SMALL_CORNER, tokens.stage, stroke, StrokeKind::Inside);
            let inner = rect.shrink(4.0);
            let n = clip.rewards.len();
            let line = |values: &[f32]| -> Vec<Pos2> {
                let at = |(t, value): (usize, &f32)| pos2(x(inner, t, n), y(inner, *value, most));
                values.iter().enumerate().map(at).collect()
            };
            ui.painter().hline(inner.x_range(), y(inner, 0.0, most), stroke);
            for member in &clip.members {
                let light = Stroke::new(1.0, tokens.lines[0].gamma_multiply(0.4));
                ui.painter().add(Shape::line(line(member), light));
            }
            ui.painter().add(Shape::line(line(&clip.rewards), Stroke::new(1.8, tokens.lines[0])));
            if let Some(frame) = frame {
                let at = x(inner, frame, n);
                ui.painter().vline(at, rect.y_range().shrink(2.0), Stroke::new(1.5, tokens.text));
            }
            response.on_hover_text(
                "What the reward says now of every step: a light line for each member of the ensemble, and their \
                 mean. Shown only where the query is answered already.",
            );
            ui.label(tokens::small(ui, format!("The {words}")));
        });
    });
}

/// The greatest reward of either clip, above or below zero, so that both are drawn alike.
pub(crate) fn most(clips: &[ClipRewards; 2]) -> f32 {
    let members = clips.iter().flat_map(|clip| clip.members.iter().chain([&clip.rewards]));
    members.flatten().fold(0.1, |most: f32, value| most.max(value.abs()))
}

/// What the clip is worth as a whole.
pub(crate) fn in_words(clip: &ClipRewards) -> String {
    format!("reward gives it {:+.1} over {} steps", clip.sum(), clip.rewards.len())
}

fn x(inner: Rect, t: usize, n: usize) -> f32 {
    lerp(inner.x_range(), t as f32 / n.saturating_sub(1).max(1) as f32)
}

fn y(inner: Rect, value: f32, most: f32) -> f32 {
    remap(value, -most..=most, inner.bottom()..=inner.top())
}
