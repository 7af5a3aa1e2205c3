//! Opening a session, which reads many files: in a thread of its own, while the window goes on.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::session::{LoadedSession, SessionStore};
use crate::text::shown;
use crate::ui::App;
use crate::ui::command::Panel;
use crate::ui::errands::is_same;
use crate::ui::state::State;
use crate::worker::{Job, Latest};

/// The reading of a session; nothing comes of one that another has overtaken.
pub(super) type Reading = Job<Result<Option<LoadedSession>, String>>;

/// A session that is being opened.
pub(super) struct Opening {
    reading: Reading,
    is_wanted: Arc<AtomicBool>,
    goes_to: Option<Panel>,
}

/// What is told of it.
#[derive(Debug)]
pub(crate) struct BeingOpened {
    dir: PathBuf,
    /// How many of its dreams are read, and how many it has.
    progress: Latest<(usize, usize)>,
}

impl BeingOpened {
    /// The name of its folder.
    pub(crate) fn name(&self) -> String {
        self.dir.file_name().map_or_else(String::new, |name| shown(&name.to_string_lossy()))
    }

    /// How far it is, in words.
    pub(crate) fn progress(&self) -> String {
        match self.progress.peek() {
            Some((n_read, n)) if n > 0 => format!("{n_read} of {n} dreams read"),
            _ => "being opened".to_owned(),
        }
    }
}

impl State {
    /// Whether a session is on its way in, so that nothing is to be begun in the one before.
    pub(crate) fn is_opening(&self) -> bool {
        self.opening.is_some()
    }
}

impl App {
    pub(super) fn open_session(&mut self, dir: &Path) {
        if self.state.dream.is_on {
            return self.warn("end the dream first: keep it, or leave it".to_owned());
        }
        if self.is_unsaved() {
            return self.save_first();
        }
        self.state.sessions_open = false;
        if self.state.opening.as_ref().is_some_and(|opening| opening.dir == dir) {
            return;
        }
        if self.state.store.as_ref().is_some_and(|store| is_same(store.dir(), dir)) {
            return self.give_up_opening();
        }
        // Another world model may be on its way in: then it is that one that the session must be of.
        let is_settled = self.loading.is_none() && !self.state.world.hash.is_empty();
        let identity = self.state.world.identity.clone().filter(|_| is_settled);
        let path = dir.to_owned();
        let open = move || SessionStore::open(&path, identity.as_ref()).map_err(|e| e.to_string());
        self.open(dir.to_owned(), Some(Panel::Label), open);
    }

    /// Reads what a session holds that is open already.
    pub(super) fn read_session(&mut self, store: SessionStore) {
        self.open(store.dir().to_owned(), None, move || Ok(store));
    }

    fn open(
        &mut self,
        dir: PathBuf,
        goes_to: Option<Panel>,
        open: impl FnOnce() -> Result<SessionStore, String> + Send + 'static,
    ) {
        self.give_up_opening();
        let (progress, is_wanted) = (Latest::default(), Arc::new(AtomicBool::new(true)));
        let previous = self.abandoned.take();
        let (told, wanted) = (progress.clone(), Arc::clone(&is_wanted));
        let work = move || {
            // It may hold the very session that is wanted now.
            if let Some(previous) = previous {
                previous.wait();
            }
            let mut report = |n_read, n| {
                told.put((n_read, n));
                if wanted.load(Ordering::Relaxed) {
                    ControlFlow::Continue(())
                } else {
                    ControlFlow::Break(())
                }
            };
            if report(0, 0).is_break() {
                return Ok(None);
            }
            Ok(LoadedSession::read(open()?, &mut report))
        };
        let waker = self.waker.clone();
        let reading = Job::begin("opener", move || waker.request_repaint(), work);
        self.state.opening = Some(BeingOpened { dir, progress });
        self.opening = Some(Opening { reading, is_wanted, goes_to });
    }

    /// Another session is wanted now.
    pub(super) fn give_up_opening(&mut self) {
        self.state.opening = None;
        if let Some(opening) = self.opening.take() {
            opening.is_wanted.store(false, Ordering::Relaxed);
            self.abandoned = Some(opening.reading);
        }
    }

    /// Goes on with the session that was being opened, once it is read.
    pub(super) fn hear_opener(&mut self) {
        let Some(opening) = &mut self.opening else { return };
        let is_over = opening.reading.is_over();
        let opened = match opening.reading.poll() {
            Some(opened) => opened,
            None if is_over => Err("opening the session failed: this is a bug of ours".to_owned()),
            None => return,
        };
        let goes_to = opening.goes_to;
        (self.opening, self.state.opening) = (None, None);
        match opened {
            // It waits for the world model that it was dreamed with.
            Ok(Some(opened)) if self.loading.is_some() => self.waiting = Some((opened, goes_to)),
            Ok(Some(opened)) => self.go_on_with(opened, goes_to),
            Ok(None) => {}
            Err(e) => self.fail(e),
        }
    }

    /// Goes on with a session, if it is one of this world model.
    pub(super) fn go_on_with(&mut self, mut opened: LoadedSession, goes_to: Option<Panel>) {
        if !self.state.world.is_of(opened.store.header()) {
            return self
                .fail("this session was dreamed with another world model: load that one first".to_owned());
        }
        if let Some(identity) = &self.state.world.identity
            && let Err(e) = opened.bind_model(identity)
        {
            return self.fail(e.to_string());
        }
        self.adopt(opened);
        if let Some(panel) = goes_to {
            self.show(panel);
        }
    }
}
