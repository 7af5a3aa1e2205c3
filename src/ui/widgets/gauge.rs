//! Bars and figures that are read at a glance.

use eframe::egui::{
    Align2, Color32, CornerRadius, FontId, Rect, Response, Role, Sense, Ui, WidgetInfo, lerp, pos2, vec2,
};

use crate::env::Action;
use crate::ui::tokens::{self, Tokens};

/// Steer, gas and brake as bars.
pub(crate) fn action_ui(ui: &mut Ui, action: Action) {
    let tokens = Tokens::of(ui);
    bar_ui(ui, "Steer", action.steer, true, tokens.accent);
    bar_ui(ui, "Gas", action.gas, false, tokens.good);
    bar_ui(ui, "Brake", action.brake, false, tokens.warn);
}

/// A bar for `value`, in `[-1, 1]` from the middle or in `[0, 1]` from the left.
fn bar_ui(ui: &mut Ui, label: &str, value: f32, is_signed: bool, color: Color32) {
    let tokens = Tokens::of(ui);
    let (rect, response) = ui.allocate_exact_size(vec2(ui.available_width(), 18.0), Sense::hover());
    response.widget_info(|| WidgetInfo::labeled(Role::Meter, true, format!("{label} {value:.1}")));
    let painter = ui.painter();
    painter.text(rect.left_center(), Align2::LEFT_CENTER, label, FontId::proportional(13.0), tokens.muted);
    let track = Rect::from_min_max(
        pos2(rect.left() + 56.0, rect.center().y - 3.0),
        rect.right_center() + vec2(0.0, 3.0),
    );
    painter.rect_filled(track, CornerRadius::same(3), tokens.border);
    let zero = if is_signed { track.center().x } else { track.left() };
    let share = if is_signed { value.mul_add(0.5, 0.5) } else { value };
    let tip = lerp(track.x_range(), share.clamp(0.0, 1.0));
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

/// How many wheels are off the road at this moment, beside the environment's own flag.
pub(crate) fn wheels_ui(ui: &mut Ui, n: u8) {
    let tokens = Tokens::of(ui);
    let color = if n > 0 { tokens.warn } else { tokens.text };
    row_color_ui(ui, "Wheels off the road", format!("{n} of 4"), color).on_hover_text(
        "As the wheels touch it now. The rate of grass counts by the environment's own flag, as the paper does, \
         which the last wheel to come upon a tile or to leave one sets.",
    );
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
