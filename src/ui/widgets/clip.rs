//! Pictures with hard pixels, on the graphics card, and clips of them.

use std::cmp::Ordering;

use eframe::egui::{
    Align2, Color32, ColorImage, Context, CornerRadius, CursorIcon, FontId, Rect, Response, Role, Sense,
    Stroke, StrokeKind, TextureHandle, TextureOptions, Ui, Vec2, WidgetInfo, epaint::RectShape, pos2, vec2,
};

use crate::env::Frame;
use crate::ui::tokens::Tokens;

/// Twenty pictures, ready to be shown.
pub(crate) type Clip = Vec<TextureHandle>;

/// The picture of a frame as a new texture.
pub(crate) fn texture(ctx: &Context, name: &str, frame: &Frame) -> TextureHandle {
    ctx.load_texture(name, image(frame), TextureOptions::NEAREST)
}

/// Puts a frame into `slot`, making the texture where there is none.
pub(crate) fn put(ctx: &Context, slot: &mut Option<TextureHandle>, frame: &Frame) {
    match slot {
        Some(slot) => slot.set(image(frame), TextureOptions::NEAREST),
        None => *slot = Some(texture(ctx, "live", frame)),
    }
}

/// Puts a picture of any size into `slot`.
pub(crate) fn put_picture(
    ctx: &Context,
    slot: &mut Option<TextureHandle>,
    (width, height, rgb): (u32, u32, &[u8]),
) {
    let image = ColorImage::from_rgb([width as usize, height as usize], rgb);
    match slot {
        Some(slot) => slot.set(image, TextureOptions::LINEAR),
        None => *slot = Some(ctx.load_texture("scene", image, TextureOptions::LINEAR)),
    }
}

fn image(frame: &Frame) -> ColorImage {
    let side = frame.side() as usize;
    ColorImage::from_rgb([side, side], frame.rgb())
}

/// How a picture is framed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Rim {
    /// Quietly.
    #[default]
    Plain,
    /// As safe, chosen or good.
    Good,
    /// As unsafe.
    Bad,
    /// As the one that counts.
    Accent,
}

/// Draws a picture, as large as `size` allows, or an empty stage that says why it is empty.
pub(crate) fn picture_ui(
    ui: &mut Ui,
    picture: Option<&TextureHandle>,
    size: Vec2,
    label: &str,
    empty: &str,
    rim: Rim,
) -> Response {
    let (rect, response) = ui.allocate_exact_size(size, Sense::click());
    response.widget_info(|| WidgetInfo::labeled(Role::Image, true, label));
    paint_picture(ui, picture, rect, empty, rim);
    response
}

/// Paints a picture into `rect`, keeping its shape.
pub(crate) fn paint_picture(ui: &Ui, picture: Option<&TextureHandle>, rect: Rect, empty: &str, rim: Rim) {
    let tokens = Tokens::of(ui);
    let painter = ui.painter();
    let corner = CornerRadius::same(6);
    let (color, width) = match rim {
        Rim::Plain => (tokens.border, 1.0),
        Rim::Good => (tokens.good, 3.0),
        Rim::Bad => (tokens.bad, 3.0),
        Rim::Accent => (tokens.accent, 3.0),
    };
    if let Some(picture) = picture {
        painter.rect_filled(rect, corner, tokens.stage);
        let shape = picture.size_vec2();
        let scale = (rect.width() / shape.x).min(rect.height() / shape.y);
        let inner = Rect::from_center_size(rect.center(), shape * scale);
        let uv = Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0));
        let is_whole = (inner.size() - rect.size()).abs().max_elem() < 1.0;
        let corner = if is_whole { corner } else { CornerRadius::ZERO };
        painter.add(RectShape::filled(inner, corner, Color32::WHITE).with_texture(picture.id(), uv));
    } else {
        painter.rect_filled(rect, corner, tokens.stage);
        let font = FontId::proportional(14.5);
        let galley = painter.layout(empty.to_owned(), font, tokens.muted, rect.width() - 32.0);
        let at = Align2::CENTER_CENTER.anchor_size(rect.center(), galley.size());
        painter.galley(at.min, galley, tokens.muted);
    }
    painter.rect_stroke(rect, corner, Stroke::new(width, color), StrokeKind::Outside);
}

/// A line under clips: one tick a frame, those played brighter, a `marked` one brightest; where it is dragged or clicked, the frame that is
/// pointed at.
pub(crate) fn timeline_ui(
    ui: &mut Ui,
    frame: usize,
    n: usize,
    width: f32,
    marked: Option<usize>,
) -> Option<f64> {
    let tokens = Tokens::of(ui);
    // Not to be reached with Tab: there are keys for a frame back and on, and the focus would take the arrows.
    let (rect, response) = ui.allocate_exact_size(vec2(width, 16.0), Sense::CLICK | Sense::DRAG);
    response.widget_info(|| WidgetInfo::labeled(Role::Slider, true, format!("Frame {} of {n}", frame + 1)));
    let is_hot = response.hovered() || response.dragged();
    let half = if is_hot { 4.0 } else { 2.0 };
    let step = rect.width() / n.max(1) as f32;
    for i in 0..n {
        let tick = Rect::from_min_size(
            pos2(rect.left() + i as f32 * step + 1.0, rect.center().y - half),
            vec2((step - 2.0).max(1.0), 2.0 * half),
        );
        let color = match i.cmp(&frame) {
            Ordering::Equal => tokens.accent,
            _ if marked == Some(i) => tokens.text,
            Ordering::Less => tokens.faint,
            Ordering::Greater => tokens.border,
        };
        ui.painter().rect_filled(tick, CornerRadius::same(2), color);
    }
    let response = response.on_hover_cursor(CursorIcon::ResizeHorizontal);
    let at = response.interact_pointer_pos().filter(|_| response.dragged() || response.clicked())?;
    Some(f64::from((at.x - rect.left()) / step).clamp(0.0, n as f64 - 0.01))
}
