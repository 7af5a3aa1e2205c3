//! What is not on disk: it is said at once, kept in memory, and saved again or elsewhere when somebody says so.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::time::Duration;

use eframe::egui::{Context, ViewportCommand};

use crate::query::Response;
use crate::session::{DreamSource, Event, SavedAs as Copied, SessionStore};
use crate::ui::App;
use crate::ui::act::counted;
use crate::ui::command::{Command, Field, Panel};
use crate::ui::crew::Order;
use crate::ui::errands::is_same;
use crate::worker::{DreamerCommand, Job, RecorderCommand};

/// Seconds between two looks at whether the session still is where its name says.
const LOOK_EVERY: f64 = 1.0;

/// What is saved elsewhere than it was to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Elsewhere {
    /// The session that is open.
    Session,
    /// All sessions from here on.
    Sessions,
    /// The recording that is being driven.
    Recording,
}

/// How the saving goes.
#[derive(Debug, Default)]
pub(crate) struct Saving {
    /// Why something is not on disk under its name, if anything is.
    pub trouble: Option<String>,
    /// What is to be saved elsewhere, while somebody is asked where.
    pub asked: Option<Elsewhere>,
    /// When the session's names are looked at again, in seconds since the window opened.
    look_at: f64,
    /// Whether whoever closes the window has been told that something is not on disk.
    is_warned: bool,
}

/// A thread that draws the window again where the session's log is no longer under its name.
pub(super) struct Watching {
    dir: PathBuf,
    job: Job<()>,
    /// Dropped, it ends the thread.
    _wanted: Sender<()>,
}

impl Watching {
    fn begin(ctx: &Context, store: &SessionStore) -> Self {
        let (waker, watch) = (ctx.clone(), store.watch());
        let (wanted, end) = channel::<()>();
        let work = move || {
            let every = Duration::from_secs_f64(LOOK_EVERY);
            while watch.is_there() && end.recv_timeout(every) == Err(RecvTimeoutError::Timeout) {}
        };
        let job = Job::begin("watcher", move || waker.request_repaint(), work);
        Self { dir: store.dir().to_owned(), job, _wanted: wanted }
    }
}

impl App {
    /// Says that something is not on disk, and what can be done.
    pub(super) fn not_saved(&mut self, what: &str, why: &str) {
        self.state.saving.trouble = Some(why.to_owned());
        self.fail_with(format!("{what}: {why}"), saving_ways(Elsewhere::Session));
    }

    /// Says that there is no place where a session could be kept.
    pub(super) fn no_place(&mut self, why: &str) {
        self.state.saving.trouble = Some(why.to_owned());
        let ways = [
            ("Choose another folder…", Command::SaveElsewhere(Some(Elsewhere::Sessions))),
            ("Other sessions…", Command::ToggleSessions),
        ];
        let text = format!("there is no place to keep what is driven and answered: {why}");
        self.fail_with(text, ways.map(|(name, command)| (name.to_owned(), command)).into());
    }

    /// Says at once where sessions cannot be kept, before anybody drives.
    pub(super) fn look_for_place(&mut self) {
        if let Err(e) = SessionStore::check_folder(&self.sessions) {
            self.no_place(&e.to_string());
        }
    }

    /// Looks from time to time whether the session still is where its name says, so that nobody is told it was saved
    /// where it is not.
    pub(super) fn look_at_session(&mut self, ctx: &Context) {
        let Some(store) = &self.state.store else {
            self.watching = None;
            return;
        };
        let saving = &mut self.state.saving;
        let watched = self.watching.as_mut().filter(|watching| watching.dir == store.dir());
        let is_gone = if let Some(watching) = watched {
            watching.job.poll().is_some()
        } else {
            self.watching = Some(Watching::begin(ctx, store));
            false
        };
        let now = self.state.now;
        if is_gone || now >= saving.look_at {
            saving.look_at = now + LOOK_EVERY;
            let (checked, is_told) = (store.check(), saving.trouble.is_some());
            match checked {
                Err(e) if !is_told => {
                    self.not_saved("this session is no longer saved under its name", &e.to_string());
                }
                Ok(()) if !self.is_unsaved() => self.state.saving.trouble = None,
                Ok(()) if !is_told => {
                    let why = "some of this session could not be written down yet";
                    self.state.saving.trouble = Some(why.to_owned());
                }
                _ => {}
            }
        }
        // What was put back is watched again.
        if self.state.saving.trouble.is_none() && self.watching.as_ref().is_some_and(|it| it.job.is_over()) {
            self.watching = None;
        }
    }

    /// Whether something of the session is in memory alone, and would be lost with the window.
    pub(super) fn is_unsaved(&self) -> bool {
        let store = self.state.store.as_ref();
        store.is_some_and(|store| store.n_unsaved() > 0)
            || !self.state.dream.unsaved.is_empty()
            || self.state.reward.unsaved.is_some()
    }

    /// Says that nothing else can be opened before this is saved, or let go.
    pub(super) fn save_first(&mut self) {
        self.state.sessions_open = false;
        let mut ways = saving_ways(Elsewhere::Session);
        ways.push(("Let it go".to_owned(), Command::ForgetUnsaved));
        self.fail_with("some of this session is not on disk yet: save that first".to_owned(), ways);
    }

    /// Keeps the window open once where something would be lost with it.
    pub(super) fn hear_closing(&mut self, ctx: &Context) {
        let is_held = self.is_unsaved() || self.state.record.is_held;
        if !is_held || self.state.saving.is_warned || !ctx.input(|input| input.viewport().close_requested()) {
            return;
        }
        self.state.saving.is_warned = true;
        ctx.send_viewport_cmd(ViewportCommand::CancelClose);
        let asked = if self.state.record.is_held { Elsewhere::Recording } else { Elsewhere::Session };
        let text = "not everything is on disk yet: close the window once more to leave without it";
        self.fail_with(text.to_owned(), saving_ways(asked));
    }

    /// Lets go of what was said last, if it did not get to disk; whether it did not.
    pub(super) fn forget_unsaved_event(&mut self) -> bool {
        let forgotten = self.state.store.as_mut().and_then(SessionStore::forget_unsaved).is_some();
        if forgotten {
            self.note("what was not saved is taken back".to_owned());
        }
        forgotten
    }

    pub(super) fn act_on_saving(&mut self, command: Command) {
        match command {
            Command::SaveElsewhere(Some(asked)) => self.ask_where(asked),
            Command::SaveElsewhere(None) => self.state.saving.asked = None,
            Command::SaveIn(path) => match self.state.saving.asked {
                Some(Elsewhere::Session) => self.save_session_in(&path),
                Some(Elsewhere::Sessions) => self.keep_sessions_in(path),
                Some(Elsewhere::Recording) => {
                    self.state.saving.asked = None;
                    self.crew.send(Order::Recorder(RecorderCommand::SaveIn(path)));
                }
                None => {}
            },
            Command::SaveAgain => self.save_again(),
            _ => self.let_go(),
        }
    }

    /// Asks where, with a place that would do.
    fn ask_where(&mut self, asked: Elsewhere) {
        let folder = free_place(&self.sessions);
        let path = match asked {
            Elsewhere::Sessions => folder,
            Elsewhere::Recording => {
                let dataset = PathBuf::from(self.state.field(Field::Dataset));
                let beside = free_place(dataset.parent().unwrap_or(Path::new("")));
                SessionStore::free_folder(&beside, &format!("{}-saved", name(&dataset)))
            }
            Elsewhere::Session => match &self.state.store {
                Some(store) => SessionStore::free_folder(&folder, &format!("{}-saved", name(store.dir()))),
                None => folder,
            },
        };
        self.state.fields.insert(Field::Elsewhere, path.display().to_string());
        self.state.saving.asked = Some(asked);
    }

    /// Writes all of the session to `path` and goes on there; in `path` where that is a folder with something in it.
    fn save_session_in(&mut self, path: &Path) {
        let Some(store) = &self.state.store else { return };
        let out = match path.parent() {
            _ if !is_there(path) => path.to_owned(),
            Some(above) if is_same(path, store.dir()) => SessionStore::free_folder(above, &name(path)),
            _ => SessionStore::free_folder(path, &name(store.dir())),
        };
        let episodes = &self.state.review.episodes;
        let held = |id| episodes.get(&id).map(|episode| episode.as_ref().clone());
        match store.save_as(&out, held, self.state.reward.parameters.as_ref()) {
            Ok(Copied { store, written, left_out }) => {
                (self.state.store, self.state.saving) = (Some(store), Saving::default());
                self.forget_troubles();
                self.written(&written);
                self.done(format!("all of the session is in {} from here on", out.display()));
                if !left_out.is_empty() {
                    let files = counted(left_out.len(), "file");
                    self.warn(format!(
                        "{files} of it were gone before and could not be saved: {}",
                        left_out.join(", ")
                    ));
                }
                self.save_rest();
            }
            Err(e) => self.fail(format!("it could not be saved there: {e}")),
        }
    }

    /// Keeps sessions in another folder from here on.
    fn keep_sessions_in(&mut self, folder: PathBuf) {
        if let Err(e) = SessionStore::check_folder(&folder) {
            return self.fail(e.to_string());
        }
        self.state.fields.insert(Field::Session, folder.display().to_string());
        self.sessions = folder;
        self.state.saving = Saving::default();
        self.forget_troubles();
        self.done(format!("sessions are kept in {} from here on", self.sessions.display()));
    }

    /// Writes down what could not be, where it was to be.
    fn save_again(&mut self) {
        if self.state.record.is_held {
            self.state.record.is_held = false;
            self.crew.send(Order::Recorder(RecorderCommand::Pause(false)));
        }
        let Some(store) = &mut self.state.store else {
            return match SessionStore::check_folder(&self.sessions) {
                Ok(()) => self.state.saving.trouble = None,
                Err(e) => self.no_place(&e.to_string()),
            };
        };
        match store.try_again() {
            Ok(written) => {
                self.state.saving.trouble = None;
                self.forget_troubles();
                self.written(&written);
                self.save_rest();
                if self.state.saving.trouble.is_none() {
                    self.done("everything is on disk".to_owned());
                }
            }
            Err(e) => self.not_saved("this is still not saved", &e.to_string()),
        }
    }

    /// Saves dreams and a reward that could not be saved before, and gives the dream that is being driven a journal.
    fn save_rest(&mut self) {
        for (episode, journal) in std::mem::take(&mut self.state.dream.unsaved) {
            self.keep_dream(episode, journal);
        }
        if let (Some((parameters, fit)), Some(store)) =
            (self.state.reward.unsaved.take(), &mut self.state.store)
        {
            match store.save_reward(&parameters, fit.clone()) {
                Ok(()) => self.done("the reward is saved".to_owned()),
                Err(e) => {
                    self.state.reward.unsaved = Some((parameters, fit));
                    self.not_saved("the reward is not lost but is not saved yet", &e.to_string());
                }
            }
        }
        let dream = &self.state.dream;
        if let (true, Some(begun), Some(store)) = (dream.is_on, &dream.begun, &self.state.store) {
            match store.journal(begun, DreamSource::User) {
                Ok(journal) => self.crew.send(Order::Dreamer(DreamerCommand::Journal(journal))),
                Err(e) => {
                    let text = "the dream goes on, but is lost if the program ends before it is kept";
                    self.not_saved(text, &e.to_string());
                }
            }
        }
    }

    /// Lets go of all that could not be saved.
    fn let_go(&mut self) {
        while self.state.store.as_mut().and_then(SessionStore::forget_unsaved).is_some() {}
        self.state.dream.unsaved.clear();
        self.state.reward.unsaved = None;
    }

    /// Goes on where what was said could not be written down then, and is now.
    fn written(&mut self, events: &[Event]) {
        for event in events {
            match event {
                Event::Answered(answer) => {
                    self.teach(answer.query);
                    if matches!(answer.response, Response::Skipped(Some(_))) {
                        self.learn_doubt();
                    }
                }
                Event::Retracted { query } | Event::Restored { query } => self.teach(*query),
                Event::SkipExplained { .. } => self.learn_doubt(),
                _ => {}
            }
        }
        if !events.is_empty() && self.state.panel == Panel::Label {
            self.next_query(None);
        }
    }

    /// Takes away what was said of something that is saved by now.
    pub(super) fn forget_troubles(&mut self) {
        let is_of_saving = |(_, command): &(String, Command)| {
            matches!(command, Command::SaveElsewhere(_) | Command::SaveAgain | Command::ForgetUnsaved)
        };
        self.state.toasts.retain(|toast| !toast.ways.iter().any(is_of_saving));
    }

    /// Says that the recording stands.
    pub(super) fn recording_held(&mut self, why: &str) {
        (self.state.record.is_ending, self.state.record.is_held) = (false, true);
        let text = format!("the recording stands, and nothing of it is lost, but it is not on disk: {why}");
        self.fail_with(text, saving_ways(Elsewhere::Recording));
    }

    /// Goes on recording into another folder.
    pub(super) fn recording_moved(&mut self, dataset: &Path) {
        self.state.record.is_held = false;
        self.state.fields.insert(Field::Dataset, dataset.display().to_string());
        self.forget_troubles();
        self.list_recordings();
        let text =
            format!("the recording is in {} from here on, and goes on when you like", dataset.display());
        self.offer(text, vec![("Go on".to_owned(), Command::PauseRecording)]);
    }
}

/// What can be done where something is not saved.
fn saving_ways(asked: Elsewhere) -> Vec<(String, Command)> {
    let ways = [("Save elsewhere…", Command::SaveElsewhere(Some(asked))), ("Try again", Command::SaveAgain)];
    ways.map(|(name, command)| (name.to_owned(), command)).into()
}

/// A folder that can be written into: this one, one at home, or a temporary one.
fn free_place(folder: &Path) -> PathBuf {
    let home = std::env::home_dir().map(|home| home.join("dropj-sessions"));
    let places = [Some(folder.to_owned()), home, Some(std::env::temp_dir().join("dropj-sessions"))];
    let mut places = places.into_iter().flatten();
    places.find(|place| SessionStore::check_folder(place).is_ok()).unwrap_or_else(|| folder.to_owned())
}

/// Whether there is something at `path` that is no empty folder.
fn is_there(path: &Path) -> bool {
    path.is_dir() && path.read_dir().is_ok_and(|mut inside| inside.next().is_some())
}

fn name(dir: &Path) -> String {
    dir.file_name().map_or_else(|| "session".to_owned(), |name| name.to_string_lossy().into_owned())
}
