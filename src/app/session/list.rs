//! The list of sessions to go on with, and the latest of them, which a new start offers.

use crate::app::App;
use crate::worker::{JobCommand, SessionItem};
use crate::world::example_of;

/// The list, as it is shown.
#[derive(Clone, Debug, Default)]
pub(crate) struct SessionList {
    pub is_open: bool,
    /// Those that were found so far.
    pub found: Vec<SessionItem>,
    /// Whether there may be more.
    pub is_listing: bool,
    /// The latest one of this world model, where it was looked for.
    pub latest: Option<SessionItem>,
}

impl App {
    pub(super) fn toggle_list(&mut self) {
        let list = &mut self.state.list;
        list.is_open = !list.is_open;
        if list.is_open {
            (list.found, list.is_listing) = (Vec::new(), true);
            let (sessions, model) = (self.sessions.clone(), self.state.world.identity.clone());
            self.job(JobCommand::ListSessions { sessions, model });
        } else {
            self.stop_listing();
        }
    }

    /// Looks for the latest session of this world model, as long as none is open: it can be gone on with.
    pub(in crate::app) fn seek_latest_session(&mut self) {
        self.state.list.latest = None;
        if self.state.open.is_none() && self.state.opening.is_none() {
            let (sessions, model) = (self.sessions.clone(), self.state.world.identity.clone());
            let except = example_of(&self.state.spec.name);
            self.job(JobCommand::FindLatestSession { sessions, model, except });
        }
    }

    fn stop_listing(&mut self) {
        if std::mem::take(&mut self.state.list.is_listing) {
            self.job(JobCommand::StopListing);
        }
    }

    /// Shows what was found of the list so far, as long as anybody looks.
    pub(super) fn listed_sessions(&mut self, found: Vec<SessionItem>, is_listing: bool) {
        if !self.state.list.is_open {
            return self.stop_listing();
        }
        (self.state.list.found, self.state.list.is_listing) = (found, is_listing);
    }
}
