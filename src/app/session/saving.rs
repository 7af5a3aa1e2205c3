//! What is not on disk: it is said at once, kept in memory, and saved again or elsewhere when somebody says so.

use std::path::{Path, PathBuf};

use crate::app::session::open::OpenSession;
use crate::app::{App, Command, Effect, Field, Panel, RecordCommand, SessionCommand, counted};
use crate::query::Response;
use crate::session::{DreamSource, Event, Session, SessionError};
use crate::worker::{FolderCheck, RecorderCommand, SessionWriterCommand, WorkerCommand};

/// What is saved elsewhere than it was to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SaveAs {
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
    pub asked: Option<SaveAs>,
    /// The same, until a place is proposed.
    proposing: Option<SaveAs>,
    /// Whether whoever closes the window has been told that something is not on disk.
    is_warned: bool,
}

impl App {
    /// Says that something is not on disk, and what can be done.
    pub(in crate::app) fn not_saved(&mut self, what: &str, why: &str) {
        self.state.saving.trouble = Some(why.to_owned());
        self.fail_with(format!("{what}: {why}"), saving_ways(SaveAs::Session));
    }

    /// Says that there is no place where a session could be kept.
    pub(super) fn no_place(&mut self, why: &str) {
        self.state.saving.trouble = Some(why.to_owned());
        let ways = [
            ("Choose another folder…", SessionCommand::ChoosePlace(Some(SaveAs::Sessions))),
            ("Other sessions…", SessionCommand::ToggleList),
        ];
        let text = format!("there is no place to keep what is done and answered: {why}");
        let way = |(name, command): (&str, SessionCommand)| (name.to_owned(), Command::Session(command));
        self.fail_with(text, ways.map(way).into());
    }

    /// The session is no longer under its name, or is again: nobody is told that something was saved where it is not.
    pub(super) fn session_checked(&mut self, result: Result<(), SessionError>) {
        let is_told = self.state.saving.trouble.is_some();
        match result {
            Err(error) if !is_told => {
                self.not_saved("this session is no longer saved under its name", &error.to_string());
            }
            Ok(()) if !self.is_unsaved() => self.state.saving.trouble = None,
            Ok(()) if !is_told => {
                let why = "some of this session could not be written down yet";
                self.state.saving.trouble = Some(why.to_owned());
            }
            Err(_) | Ok(()) => {}
        }
    }

    /// Whether something of the session is in memory alone, and would be lost with the window.
    pub(in crate::app) fn is_unsaved(&self) -> bool {
        self.state.open.as_ref().is_some_and(|open| open.n_unsaved > 0)
            || !self.state.dream.unsaved.is_empty()
            || self.state.reward.unsaved.is_some()
    }

    /// Says that nothing else can be opened before this is saved, or let go.
    pub(super) fn save_first(&mut self) {
        self.state.list.is_open = false;
        let mut ways = saving_ways(SaveAs::Session);
        ways.push(("Let it go".to_owned(), Command::Session(SessionCommand::ForgetUnsaved)));
        self.fail_with("some of this session is not on disk yet: save that first".to_owned(), ways);
    }

    /// Keeps the window open once where something would be lost with it.
    pub(in crate::app) fn hold_open(&mut self) {
        let is_held = self.state.record.is_held;
        if !self.is_unsaved() && !is_held || self.state.saving.is_warned {
            return;
        }
        self.state.saving.is_warned = true;
        self.effects.push(Effect::KeepOpen);
        let asked = if is_held { SaveAs::Recording } else { SaveAs::Session };
        let text = "not everything is on disk yet: close the window once more to leave without it";
        self.fail_with(text.to_owned(), saving_ways(asked));
    }

    /// Lets go of what was said last, if it did not get to disk; whether it did not.
    pub(in crate::app) fn forget_last_unsaved(&mut self) -> bool {
        let is_unsaved = self.state.open.as_ref().is_some_and(|open| open.n_unsaved > 0);
        if is_unsaved {
            self.write(SessionWriterCommand::ForgetLastUnsaved);
        }
        is_unsaved
    }

    /// Asks where, with a place that would do.
    pub(super) fn choose_place(&mut self, what: SaveAs) {
        let (folder, name) = match what {
            SaveAs::Sessions => (self.sessions.clone(), None),
            SaveAs::Recording => {
                let dataset = PathBuf::from(self.state.field(Field::Dataset));
                let above = dataset.parent().unwrap_or(Path::new("")).to_owned();
                (above, Some(format!("{}-saved", name(&dataset))))
            }
            SaveAs::Session => {
                let open = self.state.open.as_ref();
                (self.sessions.clone(), open.map(|open| format!("{}-saved", name(&open.dir))))
            }
        };
        self.state.saving.proposing = Some(what);
        self.write(SessionWriterCommand::ProposePlace { folder, name });
    }

    pub(super) fn place_proposed(&mut self, path: &Path) {
        if let Some(what) = self.state.saving.proposing.take() {
            self.state.fields.insert(Field::SaveAs, path.display().to_string());
            self.state.saving.asked = Some(what);
        }
    }

    pub(super) fn save_in(&mut self, path: PathBuf) {
        match self.state.saving.asked {
            Some(SaveAs::Session) => {
                let (dreams, reward) =
                    (self.state.review.episodes.clone(), self.state.reward.parameters.clone());
                self.write(SessionWriterCommand::SaveAs { path, dreams, reward });
            }
            Some(SaveAs::Sessions) => {
                let (sessions, purpose) = (path, FolderCheck::Chosen);
                self.write(SessionWriterCommand::CheckFolder { sessions, purpose });
            }
            Some(SaveAs::Recording) => {
                self.state.saving.asked = None;
                self.send(WorkerCommand::Recorder(RecorderCommand::SaveIn(path)));
            }
            None => {}
        }
    }

    /// All of the session was written to another folder, and goes on there.
    pub(super) fn saved_as(&mut self, open: OpenSession, events: &[Event], left_out: &[String]) {
        let dir = open.dir.display().to_string();
        (self.state.open, self.state.saving) = (Some(open), Saving::default());
        self.forget_troubles();
        self.follow(events);
        self.done(format!("all of the session is in {dir} from here on"));
        if !left_out.is_empty() {
            let files = counted(left_out.len(), "file");
            self.warn(format!(
                "{files} of it were gone before and could not be saved: {}",
                left_out.join(", ")
            ));
        }
        self.save_rest();
    }

    /// It is known whether sessions can be kept in a folder.
    pub(super) fn folder_checked(
        &mut self,
        sessions: PathBuf,
        purpose: FolderCheck,
        result: Result<(), SessionError>,
    ) {
        match (purpose, result) {
            (FolderCheck::AtStart, Ok(())) => {}
            (FolderCheck::AtStart | FolderCheck::Again, Err(error)) => self.no_place(&error.to_string()),
            (FolderCheck::Again, Ok(())) => self.state.saving.trouble = None,
            (FolderCheck::Chosen, Err(error)) => self.fail(error.to_string()),
            (FolderCheck::Chosen, Ok(())) => {
                self.state.fields.insert(Field::Session, sessions.display().to_string());
                self.sessions = sessions;
                self.state.saving = Saving::default();
                self.forget_troubles();
                self.done(format!("sessions are kept in {} from here on", self.sessions.display()));
            }
        }
    }

    /// Writes down what could not be, where it was to be.
    pub(super) fn try_again(&mut self) {
        if self.state.record.is_held {
            self.state.record.is_held = false;
            self.send(WorkerCommand::Recorder(RecorderCommand::Pause(false)));
        }
        if self.state.open.is_some() {
            self.write(SessionWriterCommand::TryAgain);
        } else {
            self.check_folder(FolderCheck::Again);
        }
    }

    /// What could not be written down before is on disk now.
    pub(super) fn rest_written(&mut self, events: &[Event], session: Session) {
        if let Some(open) = &mut self.state.open {
            (open.session, open.n_unsaved) = (session, 0);
        }
        self.state.saving.trouble = None;
        self.forget_troubles();
        self.follow(events);
        if !self.save_rest() {
            self.done("everything is on disk".to_owned());
        }
    }

    /// Saves dreams and a reward that could not be saved before, and gives the dream that is being driven a journal;
    /// whether there were any.
    fn save_rest(&mut self) -> bool {
        let (dreams, reward) =
            (std::mem::take(&mut self.state.dream.unsaved), self.state.reward.unsaved.take());
        let is_more = !dreams.is_empty() || reward.is_some();
        for (episode, journal) in dreams {
            self.save_dream(episode, DreamSource::User, None, journal);
        }
        if let Some((parameters, fit)) = reward {
            self.save_reward(parameters, fit);
        }
        if let Some(episode) = self.state.dream.begun.clone().filter(|_| self.state.dream.is_on) {
            self.write(SessionWriterCommand::OpenJournal { episode, is_new: false });
        }
        is_more
    }

    /// Lets go of all that could not be saved.
    pub(super) fn forget_unsaved(&mut self) {
        self.write(SessionWriterCommand::ForgetUnsaved);
        if let Some(open) = &mut self.state.open {
            open.n_unsaved = 0;
        }
        self.state.dream.unsaved.clear();
        self.state.reward.unsaved = None;
    }

    /// Goes on where what was said could not be written down then, and is now.
    fn follow(&mut self, events: &[Event]) {
        for event in events {
            match event {
                Event::Answered(answer) => {
                    self.tell_trainer(answer.query);
                    if matches!(answer.response, Response::Skipped(Some(_))) {
                        self.learn_doubt();
                    }
                }
                Event::Retracted { query } | Event::Restored { query } => self.tell_trainer(*query),
                Event::SkipExplained { .. } => self.learn_doubt(),
                Event::WeightsChanged { .. } => self.weights_changed(),
                Event::Asked { .. }
                | Event::AskedTransition { .. }
                | Event::Flagged { .. }
                | Event::Unflagged { .. }
                | Event::ProtocolChanged { .. }
                | Event::ScreenChanged { .. }
                | Event::DreamKept(_)
                | Event::DreamDropped { .. }
                | Event::DreamRestored { .. }
                | Event::Fitted { .. } => {}
            }
        }
        if !events.is_empty() && self.state.panel == Panel::Label {
            self.next_query(None);
        }
    }

    /// Takes away what was said of something that is saved by now.
    pub(super) fn forget_troubles(&mut self) {
        let is_of_saving = |(_, command): &(String, Command)| {
            matches!(
                command,
                Command::Session(
                    SessionCommand::ChoosePlace(_) | SessionCommand::TryAgain | SessionCommand::ForgetUnsaved
                )
            )
        };
        self.state.messages.retain(|message| !message.ways.iter().any(is_of_saving));
    }

    /// Says that the recording stands.
    pub(in crate::app) fn recording_held(&mut self, why: &str) {
        (self.state.record.is_ending, self.state.record.is_held) = (false, true);
        let text = format!("the recording stands, and nothing of it is lost, but it is not on disk: {why}");
        self.fail_with(text, saving_ways(SaveAs::Recording));
    }

    /// Goes on recording into another folder.
    pub(in crate::app) fn recording_moved(&mut self, dataset: &Path) {
        self.state.record.is_held = false;
        self.state.fields.insert(Field::Dataset, dataset.display().to_string());
        self.forget_troubles();
        self.list_recordings();
        let text =
            format!("the recording is in {} from here on, and goes on when you like", dataset.display());
        self.offer(text, vec![("Go on".to_owned(), Command::Record(RecordCommand::Pause))]);
    }
}

/// What can be done where something is not saved.
fn saving_ways(asked: SaveAs) -> Vec<(String, Command)> {
    let ways = [
        ("Save elsewhere…", SessionCommand::ChoosePlace(Some(asked))),
        ("Try again", SessionCommand::TryAgain),
    ];
    ways.map(|(name, command)| (name.to_owned(), Command::Session(command))).into()
}

fn name(dir: &Path) -> String {
    dir.file_name().map_or_else(|| "session".to_owned(), |name| name.to_string_lossy().into_owned())
}
