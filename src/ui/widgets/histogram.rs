//! How numbers are distributed, with a line that can be moved.

use eframe::egui::{Rect, Role, Sense, Ui, WidgetInfo, pos2, remap_clamp, vec2};

use crate::ui::tokens::{SMALL_CORNER, Tokens};

/// How many bars there are.
const N_BARS: usize = 32;
/// The height of the highest.
const HEIGHT: f32 = 64.0;

/// The distribution of `sorted` numbers, the least first; those above `limit` are held back.
///
/// Returns where the line was moved to, if it was.
pub(crate) fn histogram_ui(ui: &mut Ui, sorted: &[f32], limit: Option<f32>, name: &str) -> Option<f32> {
    let tokens = Tokens::of(ui);
    let size = vec2(ui.available_width(), HEIGHT);
    let (rect, response) = ui.allocate_exact_size(size, Sense::click_and_drag());
    response.widget_info(|| WidgetInfo::labeled(Role::Image, true, name));
    ui.painter().rect_filled(rect, SMALL_CORNER, tokens.raised);
    // A few odd ones at the ends would leave no room for the others.
    let at = |share: f32| sorted.get((share * (sorted.len().saturating_sub(1)) as f32) as usize).copied();
    let (least, most) = (at(0.005)?, at(0.995)?);
    if most <= least {
        return None;
    }
    let inner = rect.shrink(4.0);
    let mut counts = [0usize; N_BARS];
    for value in sorted {
        let bar = (value - least) / (most - least) * N_BARS as f32;
        counts[(bar.max(0.0) as usize).min(N_BARS - 1)] += 1;
    }
    let highest = counts.iter().copied().max().unwrap_or(1).max(1) as f32;
    let width = inner.width() / N_BARS as f32;
    for (i, count) in counts.into_iter().enumerate() {
        let left = inner.left() + i as f32 * width;
        let top = inner.bottom() - inner.height() * count as f32 / highest;
        let middle = least + (i as f32 + 0.5) / N_BARS as f32 * (most - least);
        let color = if limit.is_some_and(|limit| middle > limit) { tokens.warn } else { tokens.faint };
        let bar = Rect::from_min_max(pos2(left, top), pos2(left + width - 1.0, inner.bottom()));
        ui.painter().rect_filled(bar, 0.0, color);
    }
    let x = remap_clamp(limit.unwrap_or(most), least..=most, inner.left()..=inner.right());
    let is_held = response.hovered() || response.dragged();
    let line = if is_held { tokens.accent } else { tokens.text };
    ui.painter().vline(x, rect.y_range(), (2.0, line));
    let moved = response.interact_pointer_pos().filter(|_| response.dragged() || response.clicked());
    moved.map(|at| remap_clamp(at.x, inner.left()..=inner.right(), least..=most))
}
