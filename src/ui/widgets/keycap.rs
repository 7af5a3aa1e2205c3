//! Buttons that show the key that presses them.

use eframe::egui::{
    Align2, Color32, CornerRadius, FontId, Key, Painter, Pos2, Rect, Response, Role, Sense, Shape, Stroke,
    StrokeKind, Ui, Vec2, WidgetInfo, pos2, vec2,
};

use crate::ui::input;
use crate::ui::tokens::{CONTROL, SMALL_CORNER, Tokens};

/// How much a button wants to be pressed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Tone {
    /// The one thing to do next.
    Primary,
    /// One of several.
    #[default]
    Plain,
    /// Hardly.
    Quiet,
    /// Chosen from several.
    Chosen,
}

/// A button with its key.
#[derive(Clone, Copy, Debug)]
pub(crate) struct KeyButton<'a> {
    label: &'a str,
    key: Option<Key>,
    tone: Tone,
    is_enabled: bool,
    is_small: bool,
    size: Vec2,
}

impl<'a> KeyButton<'a> {
    pub(crate) fn new(label: &'a str) -> Self {
        Self {
            label,
            key: None,
            tone: Tone::Plain,
            is_enabled: true,
            is_small: false,
            size: vec2(0.0, CONTROL),
        }
    }

    /// The key that presses it, if one does.
    pub(crate) fn key(mut self, key: impl Into<Option<Key>>) -> Self {
        self.key = key.into();
        self
    }

    pub(crate) fn tone(mut self, tone: Tone) -> Self {
        self.tone = tone;
        self
    }

    pub(crate) fn enabled(mut self, is_enabled: bool) -> Self {
        self.is_enabled = is_enabled;
        self
    }

    /// Small, for what is used now and then.
    pub(crate) fn small(mut self) -> Self {
        (self.is_small, self.size.y) = (true, 26.0);
        self
    }

    /// At least so large.
    pub(crate) fn size(mut self, size: Vec2) -> Self {
        self.size = size;
        self
    }

    /// At least so wide.
    pub(crate) fn width(mut self, width: f32) -> Self {
        self.size.x = width;
        self
    }

    /// As wide as there is room.
    pub(crate) fn wide(mut self, ui: &Ui) -> Self {
        self.size.x = ui.available_width();
        self
    }

    /// Draws it and says whether it was clicked or its key pressed.
    pub(crate) fn is_pressed(self, ui: &mut Ui) -> bool {
        let is_hit =
            self.is_enabled && ui.is_enabled() && self.key.is_some_and(|key| input::pressed(ui, key));
        self.show(ui).clicked() || is_hit
    }

    /// Draws it.
    pub(crate) fn show(self, ui: &mut Ui) -> Response {
        let tokens = Tokens::of(ui);
        let font = FontId::proportional(if self.is_small { 13.0 } else { 14.5 });
        let color = match (self.is_enabled, self.tone) {
            (false, _) => tokens.faint,
            (true, Tone::Primary) => tokens.on_accent,
            (true, Tone::Quiet) => tokens.muted,
            (true, Tone::Plain | Tone::Chosen) => tokens.text,
        };
        let galley = ui.painter().layout_no_wrap(self.label.to_owned(), font, color);
        let (gap, padding) = if self.is_small { (6.0, 7.0) } else { (12.0, 13.0) };
        let cap_width = self.key.map_or(0.0, |key| cap_size(ui.painter(), key).x + gap);
        let wanted = vec2(galley.size().x + cap_width + 2.0 * padding, 0.0).max(self.size);
        let sense = if self.is_enabled { Sense::click() } else { Sense::hover() };
        let (rect, response) = ui.allocate_exact_size(wanted, sense);
        let is_enabled = self.is_enabled && ui.is_enabled();
        response.widget_info(|| WidgetInfo::labeled(Role::Button, is_enabled, self.label));
        if !ui.is_rect_visible(rect) {
            return response;
        }
        let is_hot = self.is_enabled && (response.hovered() || response.has_focus());
        let (fill, border) = match (self.tone, is_hot) {
            (Tone::Primary, _) if !self.is_enabled => (tokens.raised, tokens.border),
            (Tone::Primary, false) => (tokens.accent, tokens.accent),
            (Tone::Primary, true) => (tokens.accent.gamma_multiply(0.88), tokens.accent),
            (Tone::Plain, false) => (tokens.raised, tokens.border),
            (Tone::Plain, true) => (tokens.hovered, tokens.faint),
            (Tone::Quiet, false) => (Color32::TRANSPARENT, Color32::TRANSPARENT),
            (Tone::Quiet, true) => (tokens.hovered, tokens.border),
            (Tone::Chosen, _) => (tokens.accent.gamma_multiply(0.18), tokens.accent),
        };
        let pushed = if response.is_pointer_button_down_on() { vec2(0.0, 1.0) } else { Vec2::ZERO };
        let rect = rect.translate(pushed);
        ui.painter().rect(rect, SMALL_CORNER, fill, Stroke::new(1.0, border), StrokeKind::Inside);
        if response.has_focus() {
            let around = rect.expand(2.0);
            ui.painter().rect_stroke(
                around,
                CornerRadius::same(8),
                Stroke::new(1.5, tokens.accent),
                StrokeKind::Inside,
            );
        }
        let left = rect.center().x - f32::midpoint(galley.size().x, cap_width);
        let text_at = pos2(left, rect.center().y - galley.size().y / 2.0);
        let after = left + galley.size().x + gap;
        ui.painter().galley(text_at, galley, color);
        if let Some(key) = self.key {
            let size = cap_size(ui.painter(), key);
            let cap = Rect::from_min_size(pos2(after, rect.center().y - size.y / 2.0), size);
            paint_cap(ui.painter(), cap, key, color);
        }
        response
    }
}

/// A key by itself, as in the list of keys.
pub(crate) fn keycap(ui: &mut Ui, key: Key) -> Response {
    let size = cap_size(ui.painter(), key);
    let (rect, response) = ui.allocate_exact_size(size, Sense::hover());
    response.widget_info(|| WidgetInfo::labeled(Role::Label, true, key_name(key)));
    paint_cap(ui.painter(), rect, key, Tokens::of(ui).muted);
    response
}

/// A key that can be changed, called `name`; while `is_waiting` for another one it stands out.
pub(crate) fn keycap_button(ui: &mut Ui, key: Key, name: &str, is_waiting: bool) -> Response {
    let tokens = Tokens::of(ui);
    let (rect, response) = ui.allocate_exact_size(cap_size(ui.painter(), key), Sense::click());
    response.widget_info(|| WidgetInfo::labeled(Role::Button, true, format!("{name}: {}", key_name(key))));
    let is_hot = response.hovered() || response.has_focus();
    if is_waiting {
        ui.painter().rect_filled(rect, CornerRadius::same(4), tokens.accent);
    }
    let color = if is_waiting { tokens.on_accent } else { tokens.muted };
    paint_cap(ui.painter(), rect, key, if is_hot && !is_waiting { tokens.accent } else { color });
    response
}

/// What stands on a key.
pub(crate) fn key_name(key: Key) -> &'static str {
    match key {
        Key::Escape => "Esc",
        Key::Space => "Space",
        Key::Backspace => "Back",
        Key::Delete => "Del",
        Key::Enter => "Enter",
        Key::Period => ".",
        Key::Comma => ",",
        Key::OpenBracket => "[",
        Key::CloseBracket => "]",
        Key::Questionmark => "?",
        _ => key.name(),
    }
}

fn is_arrow(key: Key) -> bool {
    matches!(key, Key::ArrowLeft | Key::ArrowRight | Key::ArrowUp | Key::ArrowDown)
}

fn cap_size(painter: &Painter, key: Key) -> Vec2 {
    if is_arrow(key) {
        return vec2(22.0, 20.0);
    }
    let text = painter.layout_no_wrap(key_name(key).to_owned(), FontId::proportional(12.0), Color32::WHITE);
    vec2((text.size().x + 11.0).max(22.0), 20.0)
}

fn paint_cap(painter: &Painter, rect: Rect, key: Key, color: Color32) {
    let stroke = Stroke::new(1.0, color.gamma_multiply(0.5));
    painter.rect(rect, CornerRadius::same(4), color.gamma_multiply(0.08), stroke, StrokeKind::Inside);
    if !is_arrow(key) {
        painter.text(rect.center(), Align2::CENTER_CENTER, key_name(key), FontId::proportional(12.0), color);
        return;
    }
    let along = match key {
        Key::ArrowLeft => vec2(-1.0, 0.0),
        Key::ArrowRight => vec2(1.0, 0.0),
        Key::ArrowUp => vec2(0.0, -1.0),
        _ => vec2(0.0, 1.0),
    };
    paint_arrow(painter, rect.center(), along, 5.5, color);
}

/// An arrow with its middle at `center`, pointing `along`.
pub(crate) fn paint_arrow(painter: &Painter, center: Pos2, along: Vec2, reach: f32, color: Color32) {
    let tip = center + along * reach;
    let across = along.rot90() * reach * 0.62;
    painter.line_segment([center - along * reach, tip - along], Stroke::new(1.4, color));
    let back = tip - along * reach * 0.85;
    painter.add(Shape::convex_polygon(vec![tip, back + across, back - across], color, Stroke::NONE));
}
