//! The list of sessions to go on with.

use crate::app::App;
use crate::worker::{JobCommand, SessionItem};

/// The list, as it is shown.
#[derive(Clone, Debug, Default)]
pub(crate) struct SessionList {
    pub is_open: bool,
    /// Those that were found so far.
    pub found: Vec<SessionItem>,
    /// Whether there may be more.
    pub is_listing: bool,
}

impl App {
    pub(super) fn toggle_list(&mut self) {
        let list = &mut self.state.list;
        list.is_open = !list.is_open;
        if list.is_open {
            *list = SessionList { is_open: true, found: Vec::new(), is_listing: true };
            let (sessions, model) = (self.sessions.clone(), self.state.world.identity.clone());
            self.job(JobCommand::ListSessions { sessions, model });
        } else {
            self.stop_listing();
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
