//! Pictures with hard pixels, on the graphics card, and clips of them.

use std::cmp::Ordering;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use eframe::egui::{
    Align2, Color32, ColorImage, Context, CornerRadius, CursorIcon, FontId, Id, Rect, Response, Role, Sense,
    Stroke, StrokeKind, TextureHandle, TextureId, TextureOptions, Ui, Vec2, WidgetInfo, epaint::RectShape,
    pos2, vec2,
};

use crate::app::{Command, Picture, WindowCommand};
use crate::ui::View;
use crate::ui::command::Commands;
use crate::ui::tokens::Tokens;
use crate::ui::widgets::keycap::{KeyButton, Tone};

/// The pictures that are on the graphics card: those of the last frames, and places for others of their shapes.
#[derive(Default)]
struct Textures {
    /// By the address of their bytes.
    shown: HashMap<usize, Texture>,
    free: HashMap<Shape, Vec<TextureHandle>>,
}

/// Pixels from side to side and from top to bottom, and whether they are to be seen.
type Shape = (u32, u32, bool);

struct Texture {
    /// What it shows, kept so that nothing else comes to lie at its address.
    picture: Picture,
    handle: TextureHandle,
    /// The frame of the window that showed it last.
    used: u64,
}

/// Frames for which a picture stays on the graphics card that is not shown.
const STAYS: u64 = 2;
/// Places of one shape that are kept for others.
const MOST_FREE: usize = 64;

impl Textures {
    fn of(&mut self, ctx: &Context, picture: &Picture) -> TextureId {
        let now = ctx.cumulative_frame_nr();
        let shape = (picture.width, picture.height, picture.is_hard);
        let found = self.shown.entry(picture.rgb.as_ptr().addr());
        let texture = found.or_insert_with(|| {
            let size = [picture.width as usize, picture.height as usize];
            let image = ColorImage::from_rgb(size, &picture.rgb);
            let options = if picture.is_hard { TextureOptions::NEAREST } else { TextureOptions::LINEAR };
            let handle = match self.free.get_mut(&shape).and_then(Vec::pop) {
                Some(mut handle) => {
                    handle.set(image, options);
                    handle
                }
                None => ctx.load_texture("picture", image, options),
            };
            Texture { picture: picture.clone(), handle, used: now }
        });
        texture.used = now;
        texture.handle.id()
    }

    /// Frees the places of pictures that are no longer shown.
    fn tidy(&mut self, now: u64) {
        for (_, texture) in self.shown.extract_if(|_, texture| texture.used + STAYS < now) {
            let Picture { width, height, is_hard, .. } = texture.picture;
            let free = self.free.entry((width, height, is_hard)).or_default();
            if free.len() < MOST_FREE {
                free.push(texture.handle);
            }
        }
    }
}

/// The pictures of this window.
fn textures(ctx: &Context) -> Arc<Mutex<Textures>> {
    ctx.data_mut(|data| Arc::clone(data.get_temp_mut_or_default(Id::unique("textures"))))
}

/// Frees the places of pictures that are no longer shown; to be called once a frame.
pub(crate) fn tidy_textures(ctx: &Context) {
    let now = ctx.cumulative_frame_nr();
    textures(ctx).lock().unwrap_or_else(PoisonError::into_inner).tidy(now);
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

/// A button that saves what is seen on the panel as a GIF.
pub(crate) fn clip_button_ui(ui: &mut Ui, state: &View<'_>, commands: &mut Commands) {
    let button = KeyButton::new("GIF…").tone(Tone::Quiet).small().enabled(state.has_clip());
    let response = button.show(ui).on_hover_text("Save what is seen here as a GIF");
    if response.clicked() {
        commands.push(Command::Window(WindowCommand::SaveClip));
    }
}

/// Draws a picture, as large as `size` allows, or an empty stage that says why it is empty.
pub(crate) fn picture_ui(
    ui: &mut Ui,
    picture: Option<&Picture>,
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
pub(crate) fn paint_picture(ui: &Ui, picture: Option<&Picture>, rect: Rect, empty: &str, rim: Rim) {
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
        let all = textures(ui.ctx());
        let texture = all.lock().unwrap_or_else(PoisonError::into_inner).of(ui.ctx(), picture);
        painter.rect_filled(rect, corner, tokens.stage);
        let shape = vec2(picture.width as f32, picture.height as f32);
        let scale = (rect.width() / shape.x).min(rect.height() / shape.y);
        let inner = Rect::from_center_size(rect.center(), shape * scale);
        let uv = Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0));
        let is_whole = (inner.size() - rect.size()).abs().max_elem() < 1.0;
        let corner = if is_whole { corner } else { CornerRadius::ZERO };
        painter.add(RectShape::filled(inner, corner, Color32::WHITE).with_texture(texture, uv));
    } else {
        painter.rect_filled(rect, corner, tokens.stage);
        let font = FontId::proportional(14.5);
        let galley = painter.layout(empty.to_owned(), font, tokens.muted, rect.width() - 32.0);
        let at = Align2::CENTER_CENTER.anchor_size(rect.center(), galley.size());
        painter.galley(at.min, galley, tokens.muted);
    }
    painter.rect_stroke(rect, corner, Stroke::new(width, color), StrokeKind::Outside);
    badge(ui, rect, rim);
}

/// What the color of a rim says, as a shape in its corner: a check mark, or a cross.
fn badge(ui: &Ui, rect: Rect, rim: Rim) {
    let tokens = Tokens::of(ui);
    let color = match rim {
        Rim::Good => tokens.good,
        Rim::Bad => tokens.bad,
        Rim::Plain | Rim::Accent => return,
    };
    // On a small picture the mark is small, too.
    let unit = (rect.height() / 60.0).clamp(0.6, 2.0);
    let center = rect.right_top() + vec2(-9.0, 9.0) * unit;
    let at = |x: f32, y: f32| center + vec2(x, y) * unit;
    ui.painter().circle_filled(center, 7.0 * unit, color);
    let ink = Stroke::new(1.6 * unit, tokens.background);
    let lines = if rim == Rim::Good {
        [[at(-3.2, 0.2), at(-0.9, 2.6)], [at(-0.9, 2.6), at(3.4, -2.6)]]
    } else {
        [[at(-2.6, -2.6), at(2.6, 2.6)], [at(-2.6, 2.6), at(2.6, -2.6)]]
    };
    for line in lines {
        ui.painter().line_segment(line, ink);
    }
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
