//! Sessions: beginning one, opening one, and what is in their files.

mod list;
mod merge;
mod open;
mod saving;

use std::path::{Path, PathBuf};

pub use open::OpenSession;
pub use saving::SaveAs;

pub(crate) use list::SessionList;
pub(crate) use merge::Merging;
pub(crate) use saving::Saving;

use crate::app::reward::Rewarding;
use crate::app::{App, Command, LabelCommand, Panel};
use crate::query::Protocol;
use crate::session::{Entry, Event, Header, LoadedSession, Session, SessionError, SessionStore};
use crate::text::shown;
use crate::worker::{
    DriverCommand, FolderCheck, JobCommand, JobReport, SessionReport, SessionWriterCommand, TrainerCommand,
    WorkerCommand, WorkerError,
};

/// On sessions and their files.
#[derive(Clone, Debug, PartialEq)]
pub enum SessionCommand {
    /// Opens or closes the list of sessions.
    ToggleList,
    /// Begins a new session with these questions.
    New(Protocol),
    /// Opens the session in a folder.
    Open(PathBuf),
    /// Keeps the dreams that a killed program left behind.
    RecoverDreams,
    /// Throws them away.
    DiscardDreams,
    /// Asks where to save what cannot be saved in its place, or no longer.
    ChoosePlace(Option<SaveAs>),
    /// Saves it there.
    SaveIn(PathBuf),
    /// Saves it where it was to be, after all.
    TryAgain,
    /// Lets go of what could not be saved.
    ForgetUnsaved,
    /// Opens or closes what is done with sessions of several annotators.
    ToggleMerge,
    /// Offers this session, too, for merging.
    AddToMerge(PathBuf),
    /// Merges this session with others, or not.
    ChooseForMerge(PathBuf, bool),
    /// Merges the chosen sessions into a new one.
    Merge,
    /// Makes a session of the same queries for whoever is named.
    HandOn,
    /// Compares all who answered about the dreams of this session.
    CompareAnnotators,
}

/// The session that is being opened.
#[derive(Clone, Debug)]
pub(crate) struct OpenedFolder {
    dir: PathBuf,
    /// How many of its dreams are read, and how many it has.
    progress: (usize, usize),
    goes_to: Option<Panel>,
}

impl OpenedFolder {
    /// The name of its folder.
    pub(crate) fn name(&self) -> String {
        self.dir.file_name().map_or_else(String::new, |name| shown(&name.to_string_lossy()))
    }

    /// How far it is, in words.
    pub(crate) fn progress(&self) -> String {
        match self.progress {
            (n_read, n) if n > 0 => format!("{n_read} of {n} dreams read"),
            _ => "being opened".to_owned(),
        }
    }
}

impl App {
    pub(super) fn session_command(&mut self, command: SessionCommand) {
        match command {
            SessionCommand::ToggleList => self.toggle_list(),
            SessionCommand::New(protocol) => drop(self.new_session(protocol)),
            SessionCommand::Open(dir) => self.open_session(dir),
            SessionCommand::RecoverDreams => self.recover_dreams(),
            SessionCommand::DiscardDreams => {
                let unfinished = std::mem::take(&mut self.state.unfinished);
                self.write(SessionWriterCommand::DiscardUnfinished(unfinished));
            }
            SessionCommand::ChoosePlace(Some(what)) => self.choose_place(what),
            SessionCommand::ChoosePlace(None) => self.state.saving.asked = None,
            SessionCommand::SaveIn(path) => self.save_in(path),
            SessionCommand::TryAgain => self.try_again(),
            SessionCommand::ForgetUnsaved => self.forget_unsaved(),
            SessionCommand::ToggleMerge => self.toggle_merge(),
            SessionCommand::AddToMerge(dir) => self.add_to_merge(dir),
            SessionCommand::ChooseForMerge(dir, is_chosen) => self.choose_for_merge(dir, is_chosen),
            SessionCommand::Merge => self.merge_sessions(),
            SessionCommand::HandOn => self.hand_on(),
            SessionCommand::CompareAnnotators => self.compare_annotators(),
        }
    }

    pub(super) fn session_report(&mut self, report: SessionReport) {
        match report {
            SessionReport::Created(made) => {
                self.was_changed();
                self.session_created(made);
            }
            SessionReport::Released(store) => self.read_session(store),
            SessionReport::Recorded(entry) => {
                if self.was_changed() {
                    self.apply(&entry);
                    self.recorded(&entry.event);
                    self.ask();
                }
            }
            SessionReport::NotRecorded { event, error, n_unsaved } => {
                self.was_changed();
                self.not_recorded(&event, &error, n_unsaved);
            }
            SessionReport::DreamSaved { entry, id, episode } => {
                if self.was_changed() {
                    self.apply(&entry);
                    self.dream_saved(&entry, id, episode);
                }
            }
            SessionReport::DreamNotSaved { acquisition: Some(_), error, .. } => {
                self.was_changed();
                self.not_synthesized(format!("a trajectory was made and could not be kept: {error}"));
            }
            SessionReport::DreamNotSaved { episode, acquisition: None, journal, error } => {
                self.was_changed();
                self.dream_not_saved(episode, journal, &error);
            }
            SessionReport::RewardSaved(entry) => {
                if self.was_changed() {
                    self.apply(&entry);
                    self.reward_saved(&entry);
                }
            }
            SessionReport::RewardNotSaved { parameters, fit, error } => {
                self.was_changed();
                self.state.reward.unsaved = Some((parameters, fit));
                self.not_saved("the reward is not lost but is not saved yet", &error.to_string());
            }
            SessionReport::Journal { episode, journal, is_new } => {
                self.journal_opened(episode, journal, is_new);
            }
            SessionReport::DrivenNotKept(error) => {
                self.warn(format!("the episode stays here until the window is closed: {error}"));
            }
            SessionReport::NotRecovered(error) => {
                self.was_changed();
                self.fail(error.to_string());
            }
            SessionReport::Written { events, session } => self.rest_written(&events, *session),
            SessionReport::NotWritten { error, n_unsaved } => {
                self.set_unsaved(n_unsaved);
                self.not_saved("this is still not saved", &error.to_string());
            }
            SessionReport::Forgotten { n_unsaved } => {
                self.set_unsaved(n_unsaved);
                self.note("what was not saved is taken back".to_owned());
            }
            SessionReport::SavedAs { dir, header, session, events, left_out } => {
                self.saved_as(
                    OpenSession { dir, header, session: *session, n_unsaved: 0 },
                    &events,
                    &left_out,
                );
            }
            SessionReport::NotSavedAs(error) => self.fail(format!("it could not be saved there: {error}")),
            SessionReport::Folder { sessions, purpose, result } => {
                self.folder_checked(sessions, purpose, result);
            }
            SessionReport::Place(path) => self.place_proposed(&path),
            SessionReport::Checked(result) => self.session_checked(result),
        }
    }

    pub(super) fn job_report(&mut self, report: JobReport) {
        match report {
            JobReport::WorldModel(loaded) => self.world_model_loaded(loaded),
            JobReport::Opening(n_read, n) => {
                if let Some(opening) = &mut self.state.opening {
                    opening.progress = (n_read, n);
                }
            }
            JobReport::Session(loaded) => self.session_loaded(loaded),
            JobReport::Sessions { found, is_listing } => self.listed_sessions(found, is_listing),
            JobReport::NotListed(error) => {
                self.state.list.is_listing = false;
                self.fail(error.to_string());
            }
            JobReport::LatestSession(latest) => self.state.list.latest = latest,
            JobReport::Identified(path, dropped) => self.dropped(path, dropped),
            JobReport::Mergeable(found, n_added) => self.mergeable(found, n_added),
            JobReport::Compared(dir, annotators) => self.annotators_compared(&dir, annotators),
            JobReport::Made(dir, said) => self.session_made(dir, said),
            JobReport::Recordings(dir, said) => self.recordings_found(&dir, said),
            JobReport::Practice(made) => self.practice_made(made),
            JobReport::ClipWritten(written) => self.clip_written(written),
            JobReport::Results(read) => self.results_read(read),
            JobReport::Saved(saved) => self.results_saved(saved),
            JobReport::Failed(error) => self.job_failed(&error),
        }
    }

    /// Has `event` written down; what follows from it follows once it is.
    pub(super) fn record(&mut self, event: Event) {
        let Some(open) = &self.state.open else { return };
        if let Err(impossible) = open.session.check(&event) {
            return self.not_recorded(&event, &SessionError::from(impossible), open.n_unsaved);
        }
        let at = self.date;
        self.change(SessionWriterCommand::Record { event, at });
    }

    /// The writer has told what came of a change; whether it is one of the session that is open now.
    fn was_changed(&mut self) -> bool {
        self.writing.pop_front().is_none_or(|generation| generation == self.generation)
    }

    /// Brings into memory what is on disk.
    fn apply(&mut self, entry: &Entry) {
        let Some(open) = &mut self.state.open else { return };
        if let Err(impossible) = open.session.apply(entry) {
            // The writer has applied it to the same session.
            log::error!("what is on disk is not what is shown: {impossible}");
            self.restart();
        }
    }

    fn not_recorded(&mut self, event: &Event, error: &SessionError, n_unsaved: usize) {
        self.set_unsaved(n_unsaved);
        if matches!(event, Event::Asked { .. } | Event::AskedTransition { .. }) {
            self.not_asked();
        }
        match (event, error) {
            (Event::DreamDropped { .. }, SessionError::Impossible(_)) => self.warn(error.to_string()),
            (_, SessionError::Impossible(_)) => {
                let list = Command::Session(SessionCommand::ToggleList);
                let ways = vec![("Other sessions…".to_owned(), list)];
                self.fail_with(format!("nothing is lost, but this was not saved: {error}"), ways);
            }
            _ => self.not_saved("nothing is lost, but this is not saved", &error.to_string()),
        }
    }

    fn dream_saved(&mut self, entry: &Entry, id: crate::query::DreamId, episode: crate::dream::DreamEpisode) {
        let n = episode.len();
        let is_synthesized = matches!(&entry.event, Event::DreamKept(kept) if kept.acquisition.is_some());
        self.add_dream(id, episode);
        if !is_synthesized {
            self.done(format!("dream {} is kept: {n} steps", id.0 + 1));
        }
    }

    fn reward_saved(&mut self, entry: &Entry) {
        if let Event::Fitted { fit, .. } = &entry.event {
            let n = fit.n_labels;
            self.done(format!("the reward is fitted to {n} answers and saved"));
        }
    }

    fn set_unsaved(&mut self, n_unsaved: usize) {
        if let Some(open) = &mut self.state.open {
            open.n_unsaved = n_unsaved;
        }
    }

    /// Begins a new session; whether one is being made now.
    pub(super) fn new_session(&mut self, protocol: Protocol) -> bool {
        if self.state.dream.is_on {
            self.warn("end the dream first: keep it, or leave it".to_owned());
            return false;
        }
        if self.is_unsaved() {
            self.save_first();
            return false;
        }
        let Some(world) = &self.state.world.loaded else {
            self.fail("a session needs a world model: load one first".to_owned());
            return false;
        };
        let path = world.path.as_ref().and_then(|path| std::path::absolute(path).ok());
        let path = path.map(|path| path.display().to_string());
        let (seed, hash) = (self.fresh_seed(), self.state.world.hash.clone());
        let header = Header::of(&self.state.spec, protocol, seed, &hash, self.date);
        let file = self.state.spec_file.as_ref().map(|file| file.display().to_string());
        let header = Header { world_model_path: path, world_file: file, ..header };
        let sessions = self.sessions.clone();
        self.change(SessionWriterCommand::Create { sessions, header });
        true
    }

    fn session_created(&mut self, made: Result<Box<LoadedSession>, SessionError>) {
        match made {
            Ok(loaded) => {
                let protocol = loaded.store.session().protocol();
                let is_starting = self.state.dream.is_starting;
                self.state.list.is_open = false;
                self.give_up_opening();
                self.adopt(*loaded);
                if is_starting {
                    self.open_journal();
                }
                // Nothing is to be driven: what is asked about is synthesized there.
                if protocol == Protocol::Request {
                    self.label_command(LabelCommand::Synthesize(true));
                    self.show(Panel::Label);
                }
            }
            Err(error) => {
                self.state.dream.is_starting = false;
                self.no_place(&error.to_string());
            }
        }
    }

    /// Starts all workers anew, and reads the session anew.
    pub(super) fn restart(&mut self) {
        if let Some(world) = &self.state.world.loaded {
            let parameters = world.parameters.clone();
            self.send(WorkerCommand::UseWorldModel(parameters));
            self.forget_reports();
        }
        if self.state.open.take().is_some() {
            self.generation += 1;
            self.write(SessionWriterCommand::Release);
        }
    }

    /// The session writer has died: what it had not written is told of, and the session is read anew.
    pub(super) fn reopen(&mut self, error: &WorkerError) {
        self.writing.clear();
        self.generation += 1;
        self.fail(error.to_string());
        if let Some(open) = self.state.open.take() {
            let (dir, model) = (open.dir, self.state.world.identity.clone());
            self.state.opening = Some(OpenedFolder { dir: dir.clone(), progress: (0, 0), goes_to: None });
            self.job(JobCommand::OpenSession { dir, model });
        }
    }

    fn open_session(&mut self, dir: PathBuf) {
        if self.state.dream.is_on {
            return self.warn("end the dream first: keep it, or leave it".to_owned());
        }
        if self.is_unsaved() {
            return self.save_first();
        }
        self.state.list.is_open = false;
        if self.state.opening.as_ref().is_some_and(|opening| opening.dir == dir) {
            return;
        }
        if self.state.open.as_ref().is_some_and(|open| is_same(&open.dir, &dir)) {
            return self.give_up_opening();
        }
        // Another world model may be on its way in: then it is that one that the session must be of.
        let is_settled = self.state.world.loading.is_none() && !self.state.world.hash.is_empty();
        let model = self.state.world.identity.clone().filter(|_| is_settled);
        self.state.opening =
            Some(OpenedFolder { dir: dir.clone(), progress: (0, 0), goes_to: Some(Panel::Label) });
        self.job(JobCommand::OpenSession { dir, model });
    }

    /// Reads what a session holds that is open already.
    pub(super) fn read_session(&mut self, store: Box<SessionStore>) {
        let dir = store.dir().to_owned();
        self.state.opening = Some(OpenedFolder { dir, progress: (0, 0), goes_to: None });
        self.job(JobCommand::ReadSession(store));
    }

    /// Another session is wanted now.
    fn give_up_opening(&mut self) {
        if self.state.opening.take().is_some() {
            self.job(JobCommand::GiveUpOpening);
        }
    }

    /// Goes on with the session that was being opened, now that it is read.
    fn session_loaded(&mut self, loaded: Result<Box<LoadedSession>, WorkerError>) {
        let Some(OpenedFolder { goes_to, .. }) = self.state.opening.take() else { return };
        match loaded {
            // It waits for the world model that it was dreamed with.
            Ok(loaded) if self.state.world.loading.is_some() => self.after_world = Some((loaded, goes_to)),
            Ok(loaded) if !self.writing.is_empty() => self.next_session = Some((loaded, goes_to)),
            Ok(loaded) => self.go_on_with(loaded, goes_to),
            Err(error) => self.fail(error.to_string()),
        }
    }

    /// Goes on with a session, if it is one of this world model.
    pub(super) fn go_on_with(&mut self, mut loaded: Box<LoadedSession>, goes_to: Option<Panel>) {
        if !self.state.world.is_of(loaded.store.header()) {
            return self
                .fail("this session was dreamed with another world model: load that one first".to_owned());
        }
        if let Some(identity) = &self.state.world.identity
            && let Err(error) = loaded.bind_model(identity)
        {
            return self.fail(error.to_string());
        }
        self.adopt(*loaded);
        if let Some(panel) = goes_to {
            self.show(panel);
        }
    }

    /// Goes on with a session, telling the workers all that is in it.
    fn adopt(&mut self, loaded: LoadedSession) {
        self.generation += 1;
        let LoadedSession { store, dreams, reward, unfinished, driven } = loaded;
        self.end_dream();
        self.send(WorkerCommand::EndSession);
        self.forget_reports();
        self.state.deploy.is_on = false;
        self.state.saving = Saving::default();
        self.forget_troubles();
        (self.state.label, self.state.reward) = (self.state.label.anew(), Rewarding::default());
        if let Some(torn) = store.torn() {
            self.warn(format!(
                "the last line of this session was cut short when the program ended: {}",
                shown(torn)
            ));
        }
        for (id, dream) in dreams {
            match dream {
                Ok(episode) => self.add_dream(id, episode),
                Err(e) => {
                    self.state.label.unreadable.push(id);
                    self.fail(e.to_string());
                }
            }
        }
        self.tell_trainer_all(store.session());
        match reward {
            Ok(Some(parameters)) => {
                self.state.reward.n_learned =
                    store.session().fits().last().map_or(0, |fitted| fitted.fit.n_labels);
                self.state.reward.parameters = Some(parameters.clone());
                self.send(WorkerCommand::Driver(DriverCommand::Reward(parameters)));
            }
            Ok(None) => {}
            Err(e) => self.fail(e.to_string()),
        }
        self.state.open = Some(OpenSession {
            dir: store.dir().to_owned(),
            header: store.header().clone(),
            session: store.session().clone(),
            n_unsaved: store.n_unsaved(),
        });
        match driven {
            Ok(lines) => self.recall_driven(store.dir(), &lines),
            Err(e) => self.fail(e.to_string()),
        }
        self.write(SessionWriterCommand::Use(Box::new(store)));
        match unfinished {
            Ok(found) => self.state.unfinished = found,
            Err(e) => self.fail(e.to_string()),
        }
        self.offer_dreams();
    }

    /// Tells the trainer all labels and verdicts of a session.
    fn tell_trainer_all(&mut self, session: &Session) {
        let verdicts = session.judged().into_iter().map(TrainerCommand::LearnVerdict);
        let labels = session.labeled().into_iter();
        let labels = labels.map(|labeled| TrainerCommand::Learn(labeled.query, labeled.label));
        // What was said last is what the next reward is learned from.
        let commands: Vec<_> = if session.ends_with_verdicts() {
            labels.chain(verdicts).collect()
        } else {
            verdicts.chain(labels).collect()
        };
        for command in commands {
            self.send(WorkerCommand::Trainer(command));
        }
    }

    /// Closes the session that is open, if one is; whether one was.
    pub(super) fn close_session(&mut self) -> bool {
        let was_open = self.state.open.take().is_some();
        if was_open {
            self.generation += 1;
            self.write(SessionWriterCommand::Close);
        }
        was_open
    }

    /// What the workers of the session before this one have shown is of no use here.
    pub(super) fn forget_reports(&mut self) {
        self.state.review = crate::app::dream::Reviewing::default();
        self.state.episodes.forget_reward();
    }

    fn recover_dreams(&mut self) {
        let unfinished = std::mem::take(&mut self.state.unfinished);
        self.writing.extend(unfinished.iter().map(|_| self.generation));
        self.write(SessionWriterCommand::Recover(unfinished));
    }

    /// Who answers.
    pub(super) fn annotator(&self) -> String {
        let typed = self.state.field(crate::app::Field::Annotator).trim();
        let given = self.state.header().map_or("anonymous", |header| header.config.annotator.as_str());
        if typed.is_empty() { given.to_owned() } else { typed.to_owned() }
    }

    /// Finds out whether sessions can be kept where they are to be.
    pub(super) fn check_folder(&mut self, purpose: FolderCheck) {
        let sessions = self.sessions.clone();
        self.write(SessionWriterCommand::CheckFolder { sessions, purpose });
    }
}

/// Whether both name the same folder.
pub(crate) fn is_same(one: &Path, other: &Path) -> bool {
    std::path::absolute(one).ok() == std::path::absolute(other).ok()
}
