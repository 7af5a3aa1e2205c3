//! Bars and figures that are read at a glance.

use eframe::egui::{
    Align2, Color32, CornerRadius, FontId, Rect, Response, Role, Sense, Ui, WidgetInfo, lerp, pos2, vec2,
};

use crate::ui::tokens::{self, Tokens};
use crate::world::{Action, Axis, Status};

/// Bars beyond so many are left out: a whole robot does not fit.
const MOST_BARS: usize = 12;
/// Points that a name has at least, left of its bar.
const LEAST_NAME: f32 = 56.0;

/// What is done as bars, one for each axis, the first ones where there are many. Without a number nothing is done.
pub(crate) fn action_ui(ui: &mut Ui, axes: &[Axis], action: Action) {
    let tokens = Tokens::of(ui);
    let colors = [tokens.accent, tokens.good, tokens.warn];
    let shown = || axes.iter().take(MOST_BARS);
    // All bars begin at one place, right of the longest name.
    let width_of = |axis: &Axis| {
        let text = capitalized(&axis.name);
        ui.painter().layout_no_wrap(text, FontId::proportional(13.0), tokens.muted).size().x + 10.0
    };
    let most = (ui.available_width() * 0.5).max(LEAST_NAME);
    let room = shown().map(width_of).fold(LEAST_NAME, f32::max).min(most);
    for (i, axis) in shown().enumerate() {
        let value = action.get(i).copied().unwrap_or(axis.neutral);
        bar_ui(ui, axis, value, room, colors[i % colors.len()]);
    }
    if axes.len() > MOST_BARS {
        ui.label(tokens::small(ui, format!("and {} more", axes.len() - MOST_BARS)));
    }
}

/// A bar for `value` from where the axis is neutral, with `room` points for its name.
fn bar_ui(ui: &mut Ui, axis: &Axis, value: f32, room: f32, color: Color32) {
    let label = &capitalized(&axis.name);
    let share_of = |value: f32| (value - axis.low) / (axis.high - axis.low);
    let is_signed = axis.neutral > axis.low && axis.neutral < axis.high;
    let tokens = Tokens::of(ui);
    let (rect, response) = ui.allocate_exact_size(vec2(ui.available_width(), 18.0), Sense::hover());
    response.widget_info(|| WidgetInfo::labeled(Role::Meter, true, format!("{label} {value:.1}")));
    let painter = ui.painter();
    let named = painter.with_clip_rect(rect.with_max_x(rect.left() + room - 4.0));
    named.text(rect.left_center(), Align2::LEFT_CENTER, label, FontId::proportional(13.0), tokens.muted);
    let track = Rect::from_min_max(
        pos2(rect.left() + room, rect.center().y - 3.0),
        rect.right_center() + vec2(0.0, 3.0),
    );
    painter.rect_filled(track, CornerRadius::same(3), tokens.border);
    let at = |value: f32| lerp(track.x_range(), share_of(value).clamp(0.0, 1.0));
    let (zero, tip) = (at(axis.neutral), at(value));
    let filled = Rect::from_x_y_ranges(zero.min(tip)..=zero.max(tip), track.y_range());
    painter.rect_filled(filled, CornerRadius::same(3), color);
    if is_signed {
        painter.vline(zero, (track.top() - 3.0)..=(track.bottom() + 3.0), (1.0, tokens.faint));
    }
}

/// A share of something that is being done, in `[0, 1]`.
pub(crate) fn progress_ui(ui: &mut Ui, label: &str, share: f32) {
    let tokens = Tokens::of(ui);
    let (rect, response) = ui.allocate_exact_size(vec2(ui.available_width(), 8.0), Sense::hover());
    response.widget_info(|| WidgetInfo::labeled(Role::ProgressIndicator, true, label));
    ui.painter().rect_filled(rect, CornerRadius::same(4), tokens.border);
    let mut filled = rect;
    filled.set_width(rect.width() * share.clamp(0.0, 1.0));
    ui.painter().rect_filled(filled, CornerRadius::same(4), tokens.accent);
}

/// A figure with what it counts under it.
pub(crate) fn figure_ui(ui: &mut Ui, value: impl Into<String>, caption: &str) {
    ui.vertical(|ui| {
        ui.spacing_mut().item_spacing.y = 0.0;
        ui.label(tokens::figure(value));
        ui.label(tokens::small(ui, caption));
    });
}

/// A name and its value on one line.
pub(crate) fn row_ui(ui: &mut Ui, name: &str, value: impl Into<String>) {
    row_color_ui(ui, name, value, Tokens::of(ui).text);
}

/// The same in a color of its own.
pub(crate) fn row_color_ui(ui: &mut Ui, name: &str, value: impl Into<String>, color: Color32) -> Response {
    let tokens = Tokens::of(ui);
    let value = value.into();
    let (rect, response) = ui.allocate_exact_size(vec2(ui.available_width(), 21.0), Sense::hover());
    response.widget_info(|| WidgetInfo::labeled(Role::Label, true, format!("{name} {value}")));
    let font = || FontId::proportional(13.5);
    let named = ui.painter().text(rect.left_center(), Align2::LEFT_CENTER, name, font(), tokens.muted);
    // What is too long for the row is cut at its left, where it is least missed.
    let painter = ui.painter().with_clip_rect(rect.with_min_x(named.right() + 10.0));
    painter.text(rect.right_center(), Align2::RIGHT_CENTER, value, font(), color);
    response
}

/// What of this moment is worth a few words, where something is.
pub(crate) fn status_ui(ui: &mut Ui, status: Option<&Status>) {
    let Some(Status { text, is_fine }) = status else { return };
    let tokens = Tokens::of(ui);
    let color = if *is_fine { tokens.text } else { tokens.warn };
    row_color_ui(ui, "Now", text, color)
        .on_hover_text("As the world says it of this moment. Rates count by the events of its file.");
}

/// A name as a label begins.
pub(crate) fn capitalized(name: &str) -> String {
    let mut letters = name.chars();
    letters.next().map(|first| first.to_uppercase().chain(letters).collect()).unwrap_or_default()
}

/// A row that can be chosen.
pub(crate) fn row_button(ui: &mut Ui, name: &str, value: &str, is_chosen: bool) -> Response {
    let tokens = Tokens::of(ui);
    let (rect, response) = ui.allocate_exact_size(vec2(ui.available_width(), 24.0), Sense::click());
    response.widget_info(|| WidgetInfo::selected(Role::Button, true, is_chosen, format!("{name}: {value}")));
    if is_chosen || response.hovered() || response.has_focus() {
        let fill = if is_chosen { tokens.here } else { tokens.hovered };
        ui.painter().rect_filled(rect.expand2(vec2(6.0, 0.0)), CornerRadius::same(4), fill);
    }
    let font = || FontId::proportional(13.5);
    ui.painter().text(rect.left_center(), Align2::LEFT_CENTER, name, font(), tokens.muted);
    ui.painter().text(rect.right_center(), Align2::RIGHT_CENTER, value, font(), tokens.text);
    response
}
