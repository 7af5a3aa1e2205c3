//! Cards, columns and headings: the same room everywhere.

use eframe::egui::{
    Align, Frame, Layout, Margin, Rect, RichText, ScrollArea, Stroke, Ui, UiBuilder, Vec2, pos2, vec2,
};

use crate::app::{Picture, State};

use crate::ui::tokens::{self, CORNER, GAP, Tokens};
use crate::world::{Size, SourceKind};

/// A group of things that belong together.
pub(crate) fn card<R>(ui: &mut Ui, contents: impl FnOnce(&mut Ui) -> R) -> R {
    let tokens = Tokens::of(ui);
    let frame = Frame::new()
        .fill(tokens.surface)
        .stroke(Stroke::new(1.0, tokens.border))
        .corner_radius(CORNER)
        .inner_margin(Margin::same(16));
    let shown = frame.show(ui, |ui| {
        ui.set_width(ui.available_width());
        ui.spacing_mut().item_spacing.y = 6.0;
        contents(ui)
    });
    shown.inner
}

/// The frame of a dialog.
pub(crate) fn dialog_frame(ui: &Ui) -> Frame {
    Frame::window(ui.style()).inner_margin(Margin::same(24))
}

/// A card with a heading.
pub(crate) fn titled_card<R>(ui: &mut Ui, heading: &str, contents: impl FnOnce(&mut Ui) -> R) -> R {
    card(ui, |ui| {
        ui.label(RichText::new(heading).strong().color(Tokens::of(ui).text));
        ui.add_space(2.0);
        contents(ui)
    })
}

/// What a panel is about, and one sentence of what to do in it.
pub(crate) fn heading(ui: &mut Ui, title: &str, sentence: &str) {
    ui.label(tokens::title(title));
    ui.add_space(-2.0);
    ui.label(tokens::muted(ui, sentence));
    ui.add_space(GAP);
}

/// How wide the column beside a picture may be, whose width by height is `shape`, with `below` points under it.
pub(crate) fn beside_picture(ui: &Ui, shape: f32, below: f32) -> f32 {
    let room = ui.available_size();
    (room.x - (room.y - below) * shape - 2.0 * GAP).clamp(268.0, 460.0)
}

/// Width by height of what networks see: of dreams, clips and recordings.
pub(crate) fn dream_shape(state: &State) -> f32 {
    shape_of(state.spec().image.trained())
}

/// Width by height of the real scene: of `picture`, or as it is to be expected.
pub(crate) fn scene_shape(state: &State, picture: Option<&Picture>) -> f32 {
    let spec = state.spec();
    match picture {
        Some(picture) => picture.width as f32 / picture.height.max(1) as f32,
        None if spec.source.kind == SourceKind::BuiltIn => 600.0 / 480.0,
        None => shape_of(spec.image.framed()),
    }
}

fn shape_of(size: Size) -> f32 {
    size.width as f32 / size.height.max(1) as f32
}

/// The largest size within `room` whose width by height is `shape`.
pub(crate) fn within(room: Vec2, shape: f32) -> Vec2 {
    let width = room.x.min(room.y * shape);
    vec2(width, width / shape)
}

/// The size of a picture of this shape that leaves `below` points under it.
pub(crate) fn fitting(ui: &Ui, shape: f32, below: f32) -> Vec2 {
    let room = ui.available_size();
    within(vec2(room.x.max(120.0), (room.y - below).max(120.0)), shape)
}

/// The size of a small picture of what networks see, of `high` points; not much wider than high.
pub(crate) fn thumbnail_size(state: &State, high: f32) -> Vec2 {
    within(vec2(high * 1.8, high), dream_shape(state))
}

/// A wide column, and a column of `side` points at its right, each as high as there is room.
pub(crate) fn with_side<S>(
    ui: &mut Ui,
    side: f32,
    state: &mut S,
    main: impl FnOnce(&mut Ui, &mut S),
    aside: impl FnOnce(&mut Ui, &mut S),
) {
    let all = ui.available_rect_before_wrap();
    let middle = (all.right() - side).max(all.left() + 200.0);
    let left = Rect::from_min_max(all.min, pos2(middle - 2.0 * GAP, all.bottom()));
    let right = Rect::from_min_max(pos2(middle, all.top()), all.max);
    ui.scope_builder(UiBuilder::new().max_rect(left).layout(Layout::top_down(Align::Min)), |ui| {
        main(ui, state);
    });
    ui.scope_builder(UiBuilder::new().max_rect(right).layout(Layout::top_down(Align::Min)), |ui| {
        ScrollArea::vertical().id_salt("aside").auto_shrink([false, false]).show(ui, |ui| {
            ui.spacing_mut().item_spacing.y = GAP;
            aside(ui, state);
        });
    });
    ui.advance_cursor_after_rect(all);
}
