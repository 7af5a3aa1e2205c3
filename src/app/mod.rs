//! The application without a window: [`Command`]s and [`Report`]s go in, [`Effect`]s come out, [`State`] is what is shown.
//!
//! Window, headless scripts and tests drive it the same way:
//!
//! ```text
//! person ── Command ──▶ App ── Effect ──▶ workers, dialogs
//!             tick ──▶  │ ▲                    │
//!                       ▼ └────── Report ──────┘
//!                     State ──▶ window
//! ```
//!
//! Nothing here draws, touches a file, starts a thread or reads a clock: time and seeds are arguments, and what happens
//! to a session has happened once the session writer reports that it is on disk. A room is called here as in the
//! window and in [`worker`](crate::worker).

#![warn(clippy::wildcard_enum_match_arm)] // a new command or report that nobody handles does not pass

mod clips;
mod command;
mod effect;
mod failure;
mod guide;
mod message;
mod panel;
mod picture;
mod playhead;
mod scene;
mod state;

pub mod deploy;
pub mod dream;
pub mod evaluate;
pub mod label;
pub mod record;
pub mod reward;
pub mod session;
pub mod world_model;

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::query::QueryId;
use crate::session::{LoadedSession, SessionStore};
use crate::worker::{FolderCheck, JobCommand, LoadedWorld, Report, SessionWriterCommand, WorkerCommand};
use crate::world::WorldSpec;

pub use command::{Command, PlaybackCommand, WindowCommand};
pub use deploy::DeployCommand;
pub use dream::DreamCommand;
pub use effect::Effect;
pub use evaluate::EvaluateCommand;
pub use guide::{GuideCommand, Hint};
pub use label::{Budget, LabelCommand, Moment, QuerySelection};
pub use message::{Message, MessageKind};
pub use panel::{Field, Panel, Purpose};
pub use picture::Picture;
pub use playhead::Playhead;
pub use record::RecordCommand;
pub use reward::RewardCommand;
pub use session::{OpenSession, SaveAs, SessionCommand};
pub use state::State;
pub use world_model::WorldModelCommand;

/// The world model that the application begins with.
#[derive(Debug)]
pub enum FirstWorld {
    /// It is here, or it is known why there is none.
    Here(Result<Box<LoadedWorld>, String>),
    /// It is in this file, which is to be read.
    In(PathBuf),
}

/// What the application begins with.
#[derive(Debug)]
pub struct Startup {
    /// The world that it is about.
    pub spec: Arc<WorldSpec>,
    /// Its file, where it has one of its own: sessions remember it.
    pub spec_file: Option<PathBuf>,
    /// The folder of sessions.
    pub sessions: PathBuf,
    /// The folder of recordings.
    pub dataset: PathBuf,
    /// The world model.
    pub world: FirstWorld,
    /// The session to go on with; without one, a new one begins with the first dream.
    pub session: Option<SessionStore>,
    /// Of all seeds that are drawn: of sessions, dreams and fits.
    pub seed: u64,
}

/// What passes while nobody does anything.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tick {
    /// The picture of the window that is laid out now, and its time.
    pub moment: Moment,
    /// Seconds since the one before.
    pub dt: f64,
    /// Milliseconds since 1970: what is written down is dated by it.
    pub date: u64,
    /// Whether somebody is before the window.
    pub has_focus: bool,
    /// Whether somebody has touched anything since the last time.
    pub is_touched: bool,
}

/// The application.
#[derive(Debug)]
pub struct App {
    state: State,
    effects: Vec<Effect>,
    seeds: ChaCha8Rng,
    /// Milliseconds since 1970.
    date: u64,
    /// The folder of sessions.
    sessions: PathBuf,
    /// Which of all sessions so far each change is of that is on its way to disk; the writer reports in this order.
    writing: VecDeque<u64>,
    /// Which of all sessions so far is open.
    generation: u64,
    /// What was asked meanwhile and must see the session as it is then.
    waiting: VecDeque<(Command, Moment)>,
    /// The session to go on with once nothing of the present one is on its way, and where to.
    next_session: Option<(Box<LoadedSession>, Option<Panel>)>,
    /// The session to go on with once its world model is there, and where to.
    after_world: Option<(Box<LoadedSession>, Option<Panel>)>,
    next_message: u64,
}

impl App {
    /// The application as it begins; its first effects are waiting.
    pub fn new(startup: Startup) -> Self {
        let Startup { spec, spec_file, sessions, dataset, world, session, seed } = startup;
        let mut app = Self {
            state: State { spec, spec_file, ..State::default() },
            effects: Vec::new(),
            seeds: ChaCha8Rng::seed_from_u64(seed),
            date: 0,
            sessions,
            writing: VecDeque::new(),
            generation: 0,
            waiting: VecDeque::new(),
            next_session: None,
            after_world: None,
            next_message: 0,
        };
        let out = dataset.with_added_extension("safetensors");
        let fields = &mut app.state.fields;
        fields.insert(Field::Dataset, dataset.display().to_string());
        fields.insert(Field::ModelOut, out.display().to_string());
        fields.insert(Field::RecordSeed, "1".to_owned());
        fields.insert(Field::DeploySeed, "1".to_owned());
        fields.insert(Field::FiguresOut, "figures".to_owned());
        fields.insert(Field::Session, app.sessions.display().to_string());
        match session {
            Some(store) => app.read_session(Box::new(store)),
            None => app.check_folder(FolderCheck::AtStart),
        }
        match world {
            FirstWorld::In(path) => app.load_world_model(path),
            FirstWorld::Here(Ok(world)) => {
                app.send(WorkerCommand::UseWorldModel(world.parameters.clone()));
                app.use_world_model(*world);
                app.seek_latest_session();
            }
            FirstWorld::Here(Err(sentence)) => {
                app.state.panel = Panel::World;
                app.fail(sentence);
            }
        }
        app
    }

    /// What is shown.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// The session that is open, as far as it is on disk.
    pub fn open(&self) -> Option<&OpenSession> {
        self.state.open.as_ref()
    }

    /// What is to be done outside since the last time.
    pub fn take_effects(&mut self) -> Vec<Effect> {
        std::mem::take(&mut self.effects)
    }

    /// Whether everything that was said is written down, as far as it can be.
    pub fn is_settled(&self) -> bool {
        self.writing.is_empty() && self.waiting.is_empty() && self.effects.is_empty()
    }

    /// Carries out what somebody asks who saw the picture `seen` when asking.
    pub fn command(&mut self, command: Command, seen: Moment) {
        if !self.writing.is_empty() && needs_session(&command) {
            return self.waiting.push_back((command, seen));
        }
        self.state.seen = seen;
        match command {
            Command::Window(command) => self.window_command(command),
            Command::Record(command) => self.record_command(command),
            Command::WorldModel(command) => self.world_model_command(command),
            Command::Dream(command) => self.dream_command(command),
            Command::Playback(command) => self.playback_command(&command),
            Command::Label(command) => self.label_command(command),
            Command::Reward(command) => self.reward_command(command),
            Command::Deploy(command) => self.deploy_command(command),
            Command::Evaluate(command) => self.evaluate_command(command),
            Command::Session(command) => self.session_command(command),
            Command::Guide(command) => self.guide_command(command),
        }
    }

    /// Takes in what a worker reports.
    pub fn report(&mut self, report: Report) {
        match report {
            Report::Record(report) => self.record_report(report),
            Report::WorldModel(report) => self.world_model_report(report),
            Report::Dream(report) => self.dream_report(report),
            Report::Label(report) => self.label_report(report),
            Report::Reward(report) => self.reward_report(report),
            Report::Deploy(report) => self.deploy_report(report),
            Report::Evaluate(report) => self.evaluate_report(report),
            Report::Session(report) => self.session_report(report),
            Report::Scene(report) => self.scene_seen(&report),
            Report::Job(report) => self.job_report(report),
            Report::Failed(failure) => self.worker_failed(failure),
        }
        self.settle();
    }

    /// Takes note that time has passed, before anything else that comes with `tick`.
    pub fn tick(&mut self, tick: Tick) {
        (self.state.now, self.date) = (tick.moment.at, tick.date);
        (self.state.moment, self.state.seen) = (tick.moment, tick.moment);
        if tick.is_touched {
            self.state.label.clock.touch(tick.moment.at);
        }
    }

    /// Moves what plays, asks what is to be asked next, and has prepared what will be shown: after all else of `tick`.
    pub fn advance(&mut self, tick: Tick) {
        self.advance_merge();
        self.advance_clips(tick);
        self.advance_review(tick.dt);
        self.advance_episode(tick.dt);
        self.advance_scene();
        self.advance_guide();
        self.advance_replay(tick.dt);
        let now = self.state.now;
        self.state.messages.retain(|message| message.until.is_none_or(|until| until > now));
    }

    /// Goes on where something waited for the session to be on disk.
    fn settle(&mut self) {
        if !self.writing.is_empty() {
            return;
        }
        if let Some((loaded, goes_to)) = self.next_session.take() {
            self.go_on_with(loaded, goes_to);
        }
        while let Some((command, seen)) = self.waiting.pop_front() {
            self.command(command, seen);
            if !self.writing.is_empty() {
                return;
            }
        }
    }

    fn window_command(&mut self, command: WindowCommand) {
        match command {
            WindowCommand::Show(panel) => self.show(panel),
            WindowCommand::Edit(field, text) => drop(self.state.fields.insert(field, text)),
            WindowCommand::Browse(field) => {
                let at = self.state.field(field).to_owned();
                self.effects.push(Effect::OpenDialog(Purpose::Field(field), at));
            }
            WindowCommand::Import(purpose) => {
                self.effects.push(Effect::OpenDialog(purpose, String::new()));
            }
            WindowCommand::Chosen(Purpose::Clip, chosen) => self.clip_place_chosen(chosen),
            WindowCommand::Chosen(purpose, Ok(paths)) => {
                for path in paths {
                    self.take_chosen(purpose, path);
                }
            }
            WindowCommand::Chosen(_, Err(sentence)) | WindowCommand::Fail(sentence) => self.fail(sentence),
            WindowCommand::Drop(path) => self.job(JobCommand::Identify(path)),
            WindowCommand::ToggleHelp => self.state.help_open = !self.state.help_open,
            WindowCommand::Dismiss(id) => self.state.messages.retain(|message| message.id != id),
            WindowCommand::Note(text) => self.note(text),
            WindowCommand::Warn(text) => self.warn(text),
            WindowCommand::SaveClip => self.save_clip(),
            WindowCommand::Restart => self.restart(),
            WindowCommand::HandOver => self.hand_over(),
            WindowCommand::PauseDriving(why) => self.pause_driving(Some(why)),
            WindowCommand::Close => self.hold_open(),
        }
    }

    fn take_chosen(&mut self, purpose: Purpose, path: PathBuf) {
        match purpose {
            Purpose::Field(field) => drop(self.state.fields.insert(field, path.display().to_string())),
            Purpose::World => self.load_world_model(path),
            // As if it had been dropped on the window: it is read first.
            Purpose::Env => self.job(JobCommand::Identify(path)),
            Purpose::Recordings => self.use_dataset(path),
            Purpose::Merge => self.session_command(SessionCommand::AddToMerge(path)),
            // Its place was asked for, and is taken in as such.
            Purpose::Clip => {}
            Purpose::Results | Purpose::ResultsFile => {
                self.evaluate_command(EvaluateCommand::Open(path));
            }
            Purpose::Save(part) => self.save_results(part, path),
        }
    }

    fn show(&mut self, panel: Panel) {
        self.state.guide.is_offering = false;
        if panel == self.state.panel {
            return;
        }
        // Nobody drives what nobody sees.
        self.pause_driving(None);
        self.effects.push(Effect::ReleaseControls);
        self.state.panel = panel;
        if panel == Panel::Record {
            self.show_record();
        }
    }

    /// Tells a worker.
    fn send(&mut self, command: WorkerCommand) {
        self.effects.push(Effect::Worker(command));
    }

    /// Has a piece of work done on files.
    fn job(&mut self, command: JobCommand) {
        self.send(WorkerCommand::Jobs(command));
    }

    /// Has the session writer change the session that is open; one report tells what came of it.
    fn change(&mut self, command: SessionWriterCommand) {
        self.writing.push_back(self.generation);
        self.write(command);
    }

    /// Has the session writer do something.
    fn write(&mut self, command: SessionWriterCommand) {
        self.send(WorkerCommand::SessionWriter(command));
    }

    /// A seed that was not there before; it is written down with what it made, as a number that JSON can hold.
    fn fresh_seed(&mut self) -> u64 {
        self.seeds.random::<u64>() >> 11
    }

    /// The query whose clips are on the screen: for tests and benches.
    pub fn shown(&self) -> Option<QueryId> {
        self.state.label.shown.map(|shown| shown.query)
    }

    /// Whether they were there for long enough that an answer is taken: for tests and benches.
    pub fn is_answerable(&self) -> bool {
        let State { moment, label, .. } = &self.state;
        let next = Moment { nr: moment.nr + 1, at: moment.at };
        label.shown.is_some_and(|shown| shown.is_seen(next))
    }

    /// How many of the queries that come next are ready to be shown, one after the other: for tests and benches.
    pub fn n_ready(&self) -> usize {
        let pairs = &self.state.label.pairs;
        self.state.upcoming().iter().take_while(|query| pairs.contains_key(&query.id)).count()
    }
}

/// Whether `command` must see the session as it is once all that was said before is on disk.
fn needs_session(command: &Command) -> bool {
    match command {
        Command::Label(_) | Command::Reward(_) | Command::Session(_) => true,
        Command::Dream(command) => {
            matches!(command, DreamCommand::Start | DreamCommand::Delete(_) | DreamCommand::Restore(_))
        }
        Command::Window(command) => matches!(command, WindowCommand::Restart),
        Command::Guide(command) => matches!(command, GuideCommand::Dream | GuideCommand::Practice),
        Command::Record(_)
        | Command::WorldModel(_)
        | Command::Playback(_)
        | Command::Deploy(_)
        | Command::Evaluate(_) => false,
    }
}

/// `1 dream`, `2 dreams`.
pub(crate) fn counted(n: usize, noun: &str) -> String {
    let s = if n == 1 { "" } else { "s" };
    format!("{n} {noun}{s}")
}
