//! A whole episode as a strip: what the reward says of each step, what was marked, who drove, and where one is.

use std::ops::Range;

use eframe::egui::{
    Align2, Color32, CornerRadius, FontId, Key, Pos2, Rect, Role, Sense, Shape, Stroke, Ui, Vec2, WidgetInfo,
    lerp, pos2, remap, vec2,
};

use crate::ui::tokens::{SMALL_CORNER, Tokens};

/// What is drawn of an episode of `len` steps.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Strip<'a> {
    pub len: usize,
    /// The step that is looked at.
    pub step: usize,
    /// The reward of each step with the lowest and highest member, once it is known.
    pub rewards: Option<[&'a [f32]; 3]>,
    /// Steps that were marked as unsafe.
    pub marks: &'a [usize],
    /// Steps that the planner drove.
    pub planned: &'a [Range<usize>],
    /// Clips that were asked about.
    pub asked: &'a [Range<usize>],
    /// Steps in which something went on that must not happen, where that is known.
    pub off: &'a [Range<usize>],
}

/// Draws it and says to which step a hand has moved.
pub(crate) fn strip_ui(ui: &mut Ui, strip: Strip<'_>, height: f32) -> Option<usize> {
    let tokens = Tokens::of(ui);
    let size = vec2(ui.available_width(), height);
    let (rect, response) = ui.allocate_exact_size(size, Sense::click_and_drag());
    let last = strip.len.saturating_sub(1);
    let said = strip.rewards.and_then(|[rewards, ..]| rewards.get(strip.step));
    let name = match said {
        Some(reward) => format!("Step {} of {}: reward {reward:.2}", strip.step, strip.len),
        None => format!("Step {} of {}", strip.step, strip.len),
    };
    response.widget_info(|| WidgetInfo::slider(true, strip.step as f64, &name));
    ui.painter().rect(
        rect,
        SMALL_CORNER,
        tokens.stage,
        Stroke::new(1.0, if response.has_focus() { tokens.accent } else { tokens.border }),
        eframe::egui::StrokeKind::Inside,
    );
    let inner = rect.shrink2(vec2(8.0, 8.0));
    let x = |t: f32| lerp(inner.x_range(), t / last.max(1) as f32);
    lanes(ui, inner, strip, &x);
    let plot = Rect::from_min_max(inner.min + vec2(0.0, 7.0), inner.max - vec2(0.0, 9.0));
    if let Some(rewards) = strip.rewards {
        curve(ui, plot, rewards, &x);
    }
    let at = x(strip.step as f32);
    ui.painter().vline(at, rect.y_range().shrink(2.0), Stroke::new(1.5, tokens.text));
    if let Some(reward) = said {
        let anchor = if at > rect.center().x { Align2::RIGHT_TOP } else { Align2::LEFT_TOP };
        let beside = pos2(at + if at > rect.center().x { -6.0 } else { 6.0 }, plot.top() - 2.0);
        ui.painter().text(beside, anchor, format!("{reward:+.2}"), FontId::proportional(12.5), tokens.text);
    }
    let by_key = response.has_focus().then(|| {
        let pressed = |key| ui.input(|input| input.key_pressed(key));
        let by = i32::from(pressed(Key::ArrowRight)) - i32::from(pressed(Key::ArrowLeft));
        (by != 0).then(|| strip.step.saturating_add_signed(by as isize).min(last))
    });
    if response.has_focus() {
        let keep = eframe::egui::EventFilter { horizontal_arrows: true, ..Default::default() };
        ui.memory_mut(|memory| memory.set_focus_lock_filter(response.id, keep));
    }
    let hand = response.interact_pointer_pos().map(|hand: Pos2| {
        let share = remap(hand.x, inner.x_range(), 0.0..=last as f32);
        share.round().clamp(0.0, last as f32) as usize
    });
    hand.or(by_key.flatten()).filter(|step| *step != strip.step)
}

/// Who drove at the foot, marks at the head, and the clips that were asked about between them.
fn lanes(ui: &Ui, inner: Rect, strip: Strip<'_>, x: &dyn Fn(f32) -> f32) {
    let tokens = Tokens::of(ui);
    let lane = |range: &Range<usize>, y: f32, height: f32, color: Color32| {
        let span = Rect::from_min_max(
            pos2(x(range.start as f32), y),
            pos2(x(range.end as f32).min(inner.right()), y + height),
        );
        ui.painter().rect_filled(span, CornerRadius::same(1), color);
    };
    for range in united(strip.asked) {
        lane(&range, inner.top() + 7.0, inner.height() - 16.0, tokens.accent.gamma_multiply(0.14));
    }
    lane(&(0..strip.len), inner.bottom() - 4.0, 4.0, tokens.border);
    for range in strip.planned {
        lane(range, inner.bottom() - 4.0, 4.0, tokens.accent);
    }
    for range in strip.off {
        lane(range, inner.top(), 4.0, tokens.bad);
    }
    for mark in strip.marks {
        let tip = pos2(x(*mark as f32), inner.top() + 5.0);
        let triangle = vec![tip, tip + vec2(-4.0, -6.0), tip + vec2(4.0, -6.0)];
        ui.painter().add(Shape::convex_polygon(triangle, tokens.warn, Stroke::NONE));
    }
}

/// The same steps as ranges that do not overlap.
fn united(ranges: &[Range<usize>]) -> Vec<Range<usize>> {
    let mut sorted = ranges.to_vec();
    sorted.sort_by_key(|range| range.start);
    let mut united: Vec<Range<usize>> = Vec::new();
    for range in sorted {
        match united.last_mut() {
            Some(last) if range.start <= last.end => last.end = last.end.max(range.end),
            _ => united.push(range),
        }
    }
    united
}

/// The mean of the members as a line, and where they lie as a band.
fn curve(ui: &Ui, plot: Rect, [mean, low, high]: [&[f32]; 3], x: &dyn Fn(f32) -> f32) {
    let tokens = Tokens::of(ui);
    let most = low.iter().chain(high).fold(0.1_f32, |most, value| most.max(value.abs()));
    let y = |value: f32| remap(value, -most..=most, plot.bottom()..=plot.top());
    ui.painter().hline(plot.x_range(), y(0.0), Stroke::new(1.0, tokens.border));
    // A picture has fewer columns than a long episode steps.
    let every = (mean.len() / (plot.width() as usize).max(1)).max(1);
    let shown = || (0..mean.len()).step_by(every);
    let band = tokens.lines[0].gamma_multiply(0.25);
    let thickness = (plot.width() / (mean.len() as f32 / every as f32)).max(1.0);
    for t in shown() {
        let span = y(high[t])..=y(low[t]);
        ui.painter().vline(x(t as f32), span, Stroke::new(thickness, band));
    }
    let line: Vec<Pos2> = shown().map(|t| pos2(x(t as f32), y(mean[t]))).collect();
    ui.painter().add(Shape::line(line, Stroke::new(1.6, tokens.lines[0])));
}

/// What the planner is promised, plan by plan: one bar each, and a line where it was before.
pub(crate) fn promises_ui(
    ui: &mut Ui,
    promises: &[crate::worker::Promise],
    chosen: usize,
    chosen_before: Option<usize>,
    height: f32,
) {
    let tokens = Tokens::of(ui);
    let values = promises.iter().flat_map(|promise| [Some(promise.now), promise.before]).flatten();
    let (least, most) =
        values.fold((0.0_f32, 0.1_f32), |(least, most), value| (least.min(value), most.max(value)));
    let gap = 4.0;
    let width = ((ui.available_width() + gap) / promises.len().max(1) as f32 - gap).max(4.0);
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = gap;
        for (i, promise) in promises.iter().enumerate() {
            let (rect, response) = ui.allocate_exact_size(vec2(width, height), Sense::hover());
            let is_chosen = i == chosen;
            let before = promise.before.map_or_else(String::new, |before| format!(", before {before:.2}"));
            let name = format!(
                "Plan {}{}: {:.2}{before}",
                i + 1,
                if is_chosen { ", chosen" } else { "" },
                promise.now
            );
            response.widget_info(|| WidgetInfo::labeled(Role::Image, true, &name));
            let y = |value: f32| remap(value, least..=most, rect.bottom() - 6.0..=rect.top());
            let bar = Rect::from_x_y_ranges(
                rect.x_range(),
                y(promise.now.max(0.0))..=y(promise.now.min(0.0)).max(y(promise.now.max(0.0)) + 1.0),
            );
            let color = if is_chosen { tokens.good } else { tokens.faint.gamma_multiply(0.6) };
            ui.painter().rect_filled(bar, CornerRadius::same(2), color);
            ui.painter().hline(rect.x_range(), y(0.0), Stroke::new(1.0, tokens.border));
            if let Some(before) = promise.before {
                let is_same = chosen_before == Some(i);
                let color = if is_same { tokens.warn } else { tokens.text };
                ui.painter().hline(rect.x_range(), y(before), Stroke::new(2.0, color));
            }
            // By shape and not by color alone: a wedge points at the chosen one, a dot is below the one before.
            let foot = pos2(rect.center().x, rect.bottom() - 2.0);
            let aside = if is_chosen && chosen_before == Some(i) { vec2(4.0, 0.0) } else { Vec2::ZERO };
            if is_chosen {
                let at = foot - aside;
                let corners = vec![at + vec2(-4.0, 2.0), at + vec2(4.0, 2.0), at - vec2(0.0, 3.5)];
                ui.painter().add(Shape::convex_polygon(corners, tokens.good, Stroke::NONE));
            }
            if chosen_before == Some(i) {
                ui.painter().circle_filled(foot + aside, 2.0, tokens.warn);
            }
            response.on_hover_text(format!("{name}\n{}", promise.actions));
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clips_that_overlap_are_drawn_once() {
        assert_eq!(united(&[40..60, 0..20, 10..30, 60..80]), [0..30, 40..80]);
    }
}
