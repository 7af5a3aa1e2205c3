//! Small pictures of queries in the list of answers.

use eframe::egui::Context;

use crate::env::Frame;
use crate::query::{Query, QueryId};
use crate::ui::App;
use crate::ui::crew::Order;
use crate::ui::widgets::clip::{self, Clip};
use crate::worker::ClipperCommand;
use crate::worker::clipper::MIDDLE;

/// So many are on the graphics card at the most; those that are seen then are drawn again.
const MOST: usize = 400;

impl App {
    /// Keeps a picture of clips that are on the graphics card.
    pub(super) fn keep_thumbnail(&mut self, query: QueryId, left: &Clip, right: &Clip) {
        if let (Some(left), Some(right)) = (left.get(MIDDLE), right.get(MIDDLE)) {
            self.make_room();
            self.state.label.thumbnails.insert(query, [left.clone(), right.clone()]);
        }
    }

    pub(super) fn glanced(&mut self, ctx: &Context, query: Query, frames: &[Frame; 2]) {
        let is_known = self.state.session().and_then(|session| session.query(query.id));
        if is_known.is_some_and(|asked| asked.query == query) {
            self.make_room();
            let textures = frames.each_ref().map(|frame| clip::texture(ctx, "thumbnail", frame));
            self.state.label.thumbnails.insert(query.id, textures);
        }
    }

    /// Has those of `queries` drawn that have not been.
    pub(super) fn glance(&mut self, queries: &[QueryId]) {
        for &id in queries {
            let Some(query) = self.state.session().and_then(|session| session.query(id)) else { continue };
            let query = query.query;
            let label = &mut self.state.label;
            let is_readable =
                ![query.left.dream, query.right.dream].iter().any(|dream| label.unreadable.contains(dream));
            if is_readable && label.glanced.insert(id) {
                self.crew.send(Order::Clipper(ClipperCommand::Glance(query)));
            }
        }
    }

    fn make_room(&mut self) {
        let label = &mut self.state.label;
        if label.thumbnails.len() >= MOST {
            label.thumbnails.clear();
            label.glanced.clear();
        }
    }
}
