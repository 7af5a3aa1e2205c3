//! Small pictures of queries in the list of answers.

use crate::app::label::pair::Pair;
use crate::app::{App, Picture};
use crate::query::{Query, QueryId};
use crate::worker::clipper::MIDDLE;
use crate::worker::{ClipperCommand, WorkerCommand};
use crate::world::Frame;

/// So many are kept at the most; those that are seen then are decoded again.
const MOST: usize = 400;

impl App {
    /// Keeps a picture of clips that are decoded.
    pub(super) fn keep_thumbnail(&mut self, query: QueryId, pair: &Pair) {
        if let (Some(left), Some(right)) = (pair.left.get(MIDDLE), pair.right.get(MIDDLE)) {
            self.make_room();
            self.state.label.thumbnails.insert(query, [left.clone(), right.clone()]);
        }
    }

    pub(super) fn thumbnails_decoded(&mut self, query: Query, frames: &[Frame; 2]) {
        let is_known = self.state.session().and_then(|session| session.query(query.id));
        if is_known.is_some_and(|asked| asked.query == query) {
            self.make_room();
            let pictures = frames.each_ref().map(Picture::from);
            self.state.label.thumbnails.insert(query.id, pictures);
        }
    }

    /// Has those of `queries` decoded that have not been.
    pub(super) fn load_thumbnails(&mut self, queries: &[QueryId]) {
        for &id in queries {
            let Some(query) = self.state.session().and_then(|session| session.query(id)) else { continue };
            let query = query.query;
            let label = &mut self.state.label;
            let is_readable =
                ![query.left.dream, query.right.dream].iter().any(|dream| label.unreadable.contains(dream));
            if is_readable && label.thumbnails_asked.insert(id) {
                self.send(WorkerCommand::Clipper(ClipperCommand::DecodeThumbnails(query)));
            }
        }
    }

    fn make_room(&mut self) {
        let label = &mut self.state.label;
        if label.thumbnails.len() >= MOST {
            label.thumbnails.clear();
            label.thumbnails_asked.clear();
        }
    }
}
