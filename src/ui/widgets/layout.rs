//! Cards, columns and headings: the same room everywhere.

use eframe::egui::{Align, Frame, Layout, Margin, Rect, RichText, ScrollArea, Stroke, Ui, UiBuilder, pos2};

use crate::ui::tokens::{self, CORNER, GAP, Tokens};

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
