//! What commands do. `App::record` is the only place where the session changes by a single event.

use std::path::Path;
use std::time::SystemTime;

use eframe::egui::Context;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use crate::dream::DreamEpisode;
use crate::query::{
    Preference, Protocol, QueryId, Response, SEGMENT_LEN, SafetyAnswer, SkipReason, sample_queries,
};
use crate::session::{Answer, Choice, DreamSource, Event, Header, Session, SessionStore, recent};
use crate::ui::App;
use crate::ui::command::{Command, Field, Panel};
use crate::ui::crew::Order;
use crate::ui::dialog::Dialog;
use crate::ui::state::{FitState, Labeling, RecentSession, Rewarding, Toast, ToastKind, World};
use crate::worker::{
    ClipperCommand, DreamerCommand, DriverCommand, ModelerCommand, RecorderCommand, TrainerCommand,
};
use crate::world_model::WorldModelConfig;

/// Queries that are drawn before they are needed.
const N_AHEAD: usize = 5;
/// The slowest and the fastest clips, in frames a second.
const SPEEDS: [f64; 7] = [5.0, 10.0, 15.0, 25.0, 35.0, 50.0, 100.0];

impl App {
    pub(super) fn act(&mut self, ctx: &Context, command: Command) {
        match command {
            Command::Show(panel) => self.show(panel),
            Command::Edit(field, text) => drop(self.state.fields.insert(field, text)),
            Command::Browse(field) => self.dialog = Some(Dialog::open(ctx, field, self.state.field(field))),
            Command::Theme(theme) => {
                self.state.theme = Some(theme);
                ctx.set_theme(theme);
            }
            Command::ToggleHelp => self.state.help_open = !self.state.help_open,
            Command::ToggleSessions => self.toggle_sessions(),
            Command::Dismiss(id) => self.state.toasts.retain(|toast| toast.id != id),
            Command::Restart => self.restart(),
            Command::NewSession(protocol) => self.new_session(protocol),
            Command::OpenSession(dir) => self.open_session(&dir),
            Command::RecoverDreams => self.recover(),
            Command::DiscardUnfinished => self.discard_unfinished(),
            Command::FitWorld { .. } | Command::StopFit | Command::LoadWorld(_) => {
                self.act_on_world(ctx, command);
            }
            Command::StartRecording
            | Command::PauseRecording
            | Command::KeepRecording
            | Command::RedoRecording
            | Command::LeaveRecording => self.act_on_recording(&command),
            Command::ChooseStart(_)
            | Command::StartDream
            | Command::PauseDream
            | Command::StepDream
            | Command::MarkUnsafe
            | Command::KeepDream
            | Command::RedoDream
            | Command::LeaveDream => self.act_on_dream(&command),
            Command::FitReward => {
                self.state.reward.is_fitting = true;
                self.crew.send(Order::Trainer(TrainerCommand::Fit { seed: fresh_seed() }));
            }
            Command::Drive | Command::PauseDrive | Command::StopDrive => self.act_on_drive(&command),
            _ => self.act_on_label(command),
        }
    }

    fn show(&mut self, panel: Panel) {
        if panel == self.state.panel {
            return;
        }
        // Nobody drives what nobody sees.
        if self.state.dream.is_on && !self.state.dream.live.as_ref().is_some_and(|live| live.is_paused) {
            self.crew.send(Order::Dreamer(DreamerCommand::Pause(true)));
        }
        if self.state.record.is_on && !self.state.record.live.as_ref().is_some_and(|live| live.is_paused) {
            self.crew.send(Order::Recorder(RecorderCommand::Pause(true)));
        }
        self.hands.release();
        self.state.panel = panel;
    }

    /// Writes `event` down; the session changes here and, where files belong to an event, in the store's `save_…`.
    fn record(&mut self, event: Event) -> bool {
        let Some(store) = &mut self.state.store else { return false };
        match store.record(event) {
            Ok(()) => true,
            Err(e) => {
                let ways = vec![("Other sessions…".to_owned(), Command::ToggleSessions)];
                self.fail_with(format!("nothing is lost, but this was not saved: {e}"), ways);
                false
            }
        }
    }

    fn act_on_world(&mut self, ctx: &Context, command: Command) {
        match command {
            Command::FitWorld { resume } => {
                let (dataset, out) =
                    (self.state.field(Field::Dataset).into(), self.state.field(Field::ModelOut).into());
                self.state.world.fit = Some(FitState::default());
                self.crew.send(Order::Modeler(ModelerCommand::Fit { dataset, out, resume }));
            }
            Command::StopFit => self.crew.send(Order::Modeler(ModelerCommand::Stop)),
            Command::LoadWorld(path) => match (self.load)(&path) {
                Ok(world) => {
                    self.end_dream();
                    let fit = self.state.world.fit.take();
                    self.crew.change_world(&world.parameters);
                    let name = world.name.clone();
                    self.state.world = World { fit, ..World::of(ctx, world, &mut self.state.dream) };
                    (self.state.label, self.state.reward) = (Labeling::default(), Rewarding::default());
                    self.state.unfinished.clear();
                    // A session belongs to the model that it was dreamed with.
                    if self.state.store.take().is_some() {
                        self.note(
                            "a session belongs to its world model: the next dream begins a new one"
                                .to_owned(),
                        );
                    }
                    self.done(format!("{name} is loaded"));
                }
                Err(sentence) => self.fail(sentence),
            },
            _ => {}
        }
    }

    fn act_on_recording(&mut self, command: &Command) {
        let is_paused = self.state.record.live.as_ref().is_some_and(|live| live.is_paused);
        match command {
            Command::StartRecording => self.start_recording(),
            Command::PauseRecording => self.crew.send(Order::Recorder(RecorderCommand::Pause(!is_paused))),
            // Nothing was driven, so there is nothing to keep.
            Command::KeepRecording if self.state.record.live.as_ref().is_none_or(|live| live.step == 0) => {
                self.act_on_recording(&Command::LeaveRecording);
            }
            Command::KeepRecording => self.crew.send(Order::Recorder(RecorderCommand::Keep)),
            Command::RedoRecording => {
                self.crew.send(Order::Recorder(RecorderCommand::Discard));
                self.start_recording();
            }
            _ => {
                self.crew.send(Order::Recorder(RecorderCommand::Discard));
                self.state.record.is_on = false;
            }
        }
    }

    fn start_recording(&mut self) {
        let Ok(seed) = self.state.field(Field::RecordSeed).trim().parse() else {
            self.fail("the seed of a track is a whole number, such as 7".to_owned());
            return;
        };
        let dataset = self.state.field(Field::Dataset).into();
        self.hands.release();
        self.state.record.is_on = true;
        self.state.record.live = None;
        self.crew.send(Order::Recorder(RecorderCommand::Start { dataset, seed }));
    }

    fn act_on_dream(&mut self, command: &Command) {
        let is_paused = self.state.dream.live.as_ref().is_some_and(|live| live.is_paused);
        match *command {
            Command::ChooseStart(idx) => {
                self.state.dream.start_idx = idx;
                self.state.dream.picture = None;
            }
            Command::StartDream => self.start_dream(fresh_seed()),
            Command::PauseDream => self.crew.send(Order::Dreamer(DreamerCommand::Pause(!is_paused))),
            Command::StepDream if is_paused => self.crew.send(Order::Dreamer(DreamerCommand::Step)),
            Command::MarkUnsafe => self.crew.send(Order::Dreamer(DreamerCommand::MarkUnsafe)),
            Command::KeepDream if !self.state.dream.is_ending => {
                self.state.dream.is_ending = true;
                self.crew.send(Order::Dreamer(DreamerCommand::Finish));
            }
            Command::RedoDream => {
                self.crew.send(Order::Dreamer(DreamerCommand::Discard));
                self.start_dream(fresh_seed());
            }
            Command::LeaveDream => self.end_dream(),
            _ => {}
        }
    }

    fn start_dream(&mut self, seed: u64) {
        if self.state.store.is_none() {
            self.new_session(Protocol::Dropj);
        }
        let idx = self.state.dream.start_idx;
        let start = self.state.world.loaded.as_ref().and_then(|world| world.starts.get(idx));
        let Some(start) = start.map(|start| start.state.clone()) else { return };
        let journal = self
            .state
            .store
            .as_ref()
            .map(|store| store.journal(&DreamEpisode::new(start.clone(), seed), DreamSource::User));
        let journal = match journal.transpose() {
            Ok(journal) => journal,
            Err(e) => {
                self.fail(format!("this dream would be lost if the program were killed: {e}"));
                None
            }
        };
        self.hands.release();
        let dream = &mut self.state.dream;
        (dream.is_on, dream.is_ending, dream.live, dream.seed) = (true, false, None, seed);
        self.crew.send(Order::Dreamer(DreamerCommand::Start { start, seed, journal }));
    }

    fn end_dream(&mut self) {
        if self.state.dream.is_on {
            self.crew.send(Order::Dreamer(DreamerCommand::Discard));
            self.state.dream.is_on = false;
        }
    }

    fn act_on_drive(&mut self, command: &Command) {
        match command {
            Command::Drive => {
                let Ok(seed) = self.state.field(Field::DeploySeed).trim().parse() else {
                    self.fail("the seed of a track is a whole number, such as 7".to_owned());
                    return;
                };
                let deploy = &mut self.state.deploy;
                (deploy.is_on, deploy.is_paused, deploy.seed) = (true, false, seed);
                self.crew.send(Order::Driver(DriverCommand::Drive { seed }));
            }
            Command::PauseDrive => {
                let is_paused = !self.state.deploy.is_paused;
                self.state.deploy.is_paused = is_paused;
                self.crew.send(Order::Driver(DriverCommand::Pause(is_paused)));
            }
            _ => {
                self.state.deploy.is_on = false;
                self.crew.send(Order::Driver(DriverCommand::Stop));
            }
        }
    }

    fn act_on_label(&mut self, command: Command) {
        let label = &mut self.state.label;
        match command {
            Command::Answer(response) => self.answer(response),
            Command::GuidedSafe(is_safe) => self.answer_guided(is_safe),
            Command::Guide(is_guided) => (label.is_guided, label.guided) = (is_guided, Vec::new()),
            Command::ToggleAnswers => label.is_list_open = !label.is_list_open,
            Command::Justify(justification) => label.justification = Some(justification),
            Command::GiveReason(reason) => self.give_reason(reason),
            Command::Undo => self.undo(),
            Command::Redo => self.redo(),
            Command::Flag => self.flag(),
            Command::Revisit(id) => {
                (label.revisited, label.said, label.skipped) = (Some(id), None, None);
                label.guided.clear();
            }
            Command::RestartClips => (label.playhead, label.is_standing) = (0.0, false),
            Command::PauseClips => label.is_standing = !label.is_standing,
            Command::StepClips(n) => {
                label.is_standing = true;
                let frame = (label.playhead as i32).min(SEGMENT_LEN as i32 - 1) + n;
                label.playhead = f64::from(frame.rem_euclid(SEGMENT_LEN as i32)) + 0.5;
            }
            Command::Faster(is_faster) => {
                let slower = SPEEDS.iter().rev().find(|speed| **speed < label.speed);
                let faster = SPEEDS.iter().find(|speed| **speed > label.speed);
                label.speed = *(if is_faster { faster } else { slower }).unwrap_or(&label.speed);
            }
            _ => {}
        }
    }

    fn answer(&mut self, response: Response) {
        // An answer counts only for clips that were seen.
        let Some((query, since)) = self.state.label.shown else { return };
        if !self.state.protocol().permits(&response)
            || self.state.current().is_none_or(|next| next.id != query)
        {
            return;
        }
        let secs = (self.state.now - since).max(0.0) as f32;
        let annotator = self.annotator();
        let answer =
            Answer { loops: self.state.label.loops, ..Answer::new(query, response, secs, &annotator) };
        if !self.record(Event::Answered(answer)) {
            return;
        }
        let said = self.state.weights().say(&response);
        let label = &mut self.state.label;
        label.said = Some(said);
        label.skipped = matches!(response, Response::Skipped(None)).then_some(query);
        self.next_query(None);
        self.teach(query);
    }

    fn annotator(&self) -> String {
        let typed = self.state.field(Field::Annotator).trim();
        let given = self.state.header().map_or("anonymous", |header| header.config.annotator.as_str());
        if typed.is_empty() { given.to_owned() } else { typed.to_owned() }
    }

    /// Goes to the next query, or to `revisited` if that is given, as if nothing had been said about it yet.
    fn next_query(&mut self, revisited: Option<QueryId>) {
        let label = &mut self.state.label;
        label.revisited = revisited;
        label.justification = None;
        label.guided.clear();
        label.shown = None;
        self.ask();
        // The next pair is on the graphics card already: it is in the very next picture of the window.
        let current = self.state.current().map(|query| query.id);
        let label = &mut self.state.label;
        label.shown = current.filter(|id| label.pairs.contains_key(id)).map(|id| (id, self.state.now));
        (label.playhead, label.loops, label.is_standing) = (0.0, 0, false);
    }

    fn answer_guided(&mut self, is_safe: bool) {
        let guided = &mut self.state.label.guided;
        guided.push(is_safe);
        let answer = match guided[..] {
            [true, false] => SafetyAnswer::OnlyLeft,
            [false, true] => SafetyAnswer::OnlyRight,
            [false, false] => SafetyAnswer::Neither,
            _ => return,
        };
        self.answer(Response::Safety(answer));
    }

    fn give_reason(&mut self, reason: SkipReason) {
        let Some(query) = self.state.label.skipped else { return };
        let given = self.state.session().and_then(|session| session.query(query)?.answer().cloned());
        let Some(given) = given else { return };
        // Taken back first, so that one undo undoes the skip and not only its reason.
        if self.record(Event::Retracted { query }) {
            let response = Response::Skipped(Some(reason));
            self.record(Event::Answered(Answer { response, ..given.answer }));
        }
        let why = match reason {
            SkipReason::Hallucinated => "the dream does not look like the world",
            SkipReason::Ambiguous => "the clips cannot be told apart",
            SkipReason::Other => "another reason",
        };
        let label = &mut self.state.label;
        (label.skipped, label.said) = (None, Some(format!("skipped: {why}")));
    }

    fn undo(&mut self) {
        if self.state.label.guided.pop().is_some() {
            return;
        }
        let Some(query) = self.state.session().and_then(Session::undoable) else { return };
        if !self.record(Event::Retracted { query }) {
            return;
        }
        (self.state.label.said, self.state.label.skipped) = (None, None);
        self.teach(query);
        self.next_query(Some(query));
    }

    fn redo(&mut self) {
        let Some(query) = self.state.session().and_then(Session::redoable) else { return };
        if self.record(Event::Restored { query }) {
            self.teach(query);
            self.next_query(None);
        }
    }

    fn flag(&mut self) {
        let Some(query) = self.state.current().map(|query| query.id) else { return };
        let is_flagged =
            self.state.session().and_then(|s| s.query(query)).is_some_and(|asked| asked.is_flagged);
        self.record(if is_flagged { Event::Unflagged { query } } else { Event::Flagged { query } });
    }

    /// Tells the trainer what counts for a query now.
    fn teach(&mut self, query: QueryId) {
        let Some(session) = self.state.session() else { return };
        let Some(asked) = session.query(query) else { return };
        let label = asked.answer().and_then(|given| session.weights().label(&given.answer.response));
        let command = match label {
            Some(label) => TrainerCommand::Learn(asked.query, label),
            None => TrainerCommand::Forget(query),
        };
        self.crew.send(Order::Trainer(command));
    }

    /// Draws queries and has their clips drawn before they are needed.
    pub(super) fn ask(&mut self) {
        let Some(store) = &self.state.store else { return };
        let session = store.session();
        let missing = N_AHEAD.saturating_sub(session.pending().count());
        if missing > 0 && self.state.now >= self.state.label.ask_again_at {
            let first = session.next_query_id();
            let mut rng = ChaCha8Rng::seed_from_u64(store.header().seed);
            rng.set_stream(u64::from(first.0));
            for query in sample_queries(&session.dream_lens(), missing, first, &mut rng) {
                let (left, right) = (query.left, query.right);
                let is_written =
                    self.record(Event::Asked { query: query.id, left, right, choice: Choice::Uniform });
                if !is_written {
                    // A full disk is not asked sixty times a second whether it is still full.
                    self.state.label.ask_again_at = self.state.now + 5.0;
                    break;
                }
            }
        }
        for query in self.state.upcoming().into_iter().take(N_AHEAD) {
            let label = &mut self.state.label;
            if !label.pairs.contains_key(&query.id) && !label.asked.contains(&query.id) {
                label.asked.push(query.id);
                self.crew.send(Order::Clipper(ClipperCommand::Decode(query)));
            }
        }
    }

    fn toggle_sessions(&mut self) {
        self.state.sessions_open = !self.state.sessions_open;
        if !self.state.sessions_open {
            return;
        }
        match recent(&self.sessions) {
            Ok(found) => {
                self.state.recent = found.into_iter().take(30).map(|recent| self.describe(recent)).collect();
            }
            Err(e) => self.fail(e.to_string()),
        }
    }

    fn describe(&self, recent: crate::session::Recent) -> RecentSession {
        let name =
            recent.dir.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        let about = match &recent.session {
            Ok((header, _))
                if !self.state.world.hash.is_empty() && header.world_model != self.state.world.hash =>
            {
                Err("dreamed with another world model: load that one first".to_owned())
            }
            Ok((header, session)) => {
                let (n_dreams, n_answers) = (session.dreams().len(), session.statistics().n_answered);
                let protocol = header.protocol.name();
                Ok(format!("{protocol} · {} · {}", counted(n_dreams, "dream"), counted(n_answers, "answer")))
            }
            Err(e) => Err(e.to_string()),
        };
        RecentSession { dir: recent.dir, name, about }
    }

    fn new_session(&mut self, protocol: Protocol) {
        let Some(world) = &self.state.world.loaded else {
            self.fail("a session needs a world model: load one first".to_owned());
            return;
        };
        let path =
            world.path.as_ref().filter(|path| path.is_absolute()).map(|path| path.display().to_string());
        let header =
            Header::new(&self.state.env, protocol, fresh_seed() >> 11, &self.state.world.hash, millis());
        let header = Header { world_model_path: path, ..header };
        match SessionStore::create_in(&self.sessions, header) {
            Ok(store) => {
                self.state.sessions_open = false;
                self.adopt(store);
            }
            Err(e) => {
                let ways = vec![("Other sessions…".to_owned(), Command::ToggleSessions)];
                self.fail_with(e.to_string(), ways);
            }
        }
    }

    fn open_session(&mut self, dir: &Path) {
        if self.state.store.as_ref().is_some_and(|store| store.dir() == dir) {
            self.state.sessions_open = false;
            return;
        }
        let hash = Some(self.state.world.hash.as_str()).filter(|hash| !hash.is_empty());
        match SessionStore::open(dir, hash) {
            Ok(store) => {
                self.state.sessions_open = false;
                self.adopt(store);
                self.state.panel = Panel::Label;
            }
            Err(e) => self.fail(e.to_string()),
        }
    }

    fn restart(&mut self) {
        if let Some(world) = &self.state.world.loaded {
            self.crew.change_world(&world.parameters);
        }
        if let Some(store) = self.state.store.take() {
            self.adopt(store);
        }
    }

    /// Goes on with the session in `store`, telling the workers all that is in it.
    pub(super) fn adopt(&mut self, store: SessionStore) {
        self.end_dream();
        self.crew.forget();
        let (is_guided, speed) = (self.state.label.is_guided, self.state.label.speed);
        self.state.label = Labeling { speed, is_guided, ..Labeling::default() };
        self.state.reward = Rewarding::default();
        if let Some(torn) = store.torn() {
            self.warn(format!(
                "the last line of this session was cut short when the program ended: {torn:?}"
            ));
        }
        for (id, _) in store.session().dream_lens() {
            match store.dream(id) {
                Ok(episode) => self.teach_dream(id, episode),
                Err(e) => self.fail(e.to_string()),
            }
        }
        for labeled in store.session().labeled() {
            self.crew.send(Order::Trainer(TrainerCommand::Learn(labeled.query, labeled.label)));
        }
        match store.reward() {
            Ok(Some(parameters)) => {
                self.state.reward.n_learned =
                    store.session().fits().last().map_or(0, |fitted| fitted.fit.n_labels);
                self.state.reward.parameters = Some(parameters.clone());
                self.crew.send(Order::Driver(DriverCommand::Reward(parameters)));
            }
            Ok(None) => {}
            Err(e) => self.fail(e.to_string()),
        }
        self.state.store = Some(store);
        self.look_for_unfinished();
    }

    fn look_for_unfinished(&mut self) {
        let found = self.state.store.as_ref().map_or_else(|| Ok(Vec::new()), SessionStore::unfinished_dreams);
        match found {
            Ok(found) => self.state.unfinished = found,
            Err(e) => self.fail(e.to_string()),
        }
        let n = self.state.unfinished.len();
        if n > 0 {
            let text = format!("{} survived a program that was ended while driving", counted(n, "dream"));
            let ways = [("Keep", Command::RecoverDreams), ("Throw away", Command::DiscardUnfinished)];
            self.offer(text, ways.map(|(name, command)| (name.to_owned(), command)).into());
        }
    }

    fn recover(&mut self) {
        if self.state.unfinished.is_empty() {
            let Some(store) = &self.state.store else { return };
            self.state.unfinished = store.unfinished_dreams().unwrap_or_default();
        }
        for left in std::mem::take(&mut self.state.unfinished) {
            let Some(store) = &mut self.state.store else { return };
            let episode = left.episode.clone();
            match store.recover(left) {
                Ok(id) => {
                    self.teach_dream(id, episode);
                    self.done(format!("dream {} is kept", id.0 + 1));
                }
                Err(e) => self.fail(e.to_string()),
            }
        }
    }

    fn discard_unfinished(&mut self) {
        for left in std::mem::take(&mut self.state.unfinished) {
            if let Err(e) = left.discard() {
                self.fail(e.to_string());
            }
        }
    }

    /// Lets go of everything before the window closes; what is being driven stays in its journal.
    pub(super) fn leave(&mut self) {
        self.hands.release();
    }

    /// Says something that passes.
    pub(super) fn note(&mut self, text: String) {
        self.toast(ToastKind::Note, text, Vec::new(), Some(6.0));
    }

    /// Says that something was done.
    pub(super) fn done(&mut self, text: String) {
        self.toast(ToastKind::Done, text, Vec::new(), Some(4.0));
    }

    /// Says something that should be read.
    pub(super) fn warn(&mut self, text: String) {
        self.toast(ToastKind::Note, text, Vec::new(), Some(12.0));
    }

    /// Says something, with what can be done about it.
    pub(super) fn offer(&mut self, text: String, ways: Vec<(String, Command)>) {
        self.toast(ToastKind::Note, text, ways, None);
    }

    /// Says what went wrong.
    pub(super) fn fail(&mut self, text: String) {
        self.fail_with(text, Vec::new());
    }

    /// Says what went wrong, with a way out.
    pub(super) fn fail_with(&mut self, text: String, ways: Vec<(String, Command)>) {
        log::error!("{text}");
        self.toast(ToastKind::Error, text, ways, None);
    }

    fn toast(&mut self, kind: ToastKind, text: String, ways: Vec<(String, Command)>, secs: Option<f64>) {
        let text = sentence_case(&text);
        self.state.toasts.retain(|toast| toast.text != text);
        let until = secs.map(|secs| self.state.now + secs);
        self.state.toasts.push(Toast { id: self.next_toast, kind, text, ways, until });
        self.next_toast += 1;
        if self.state.toasts.len() > 4 {
            self.state.toasts.remove(0);
        }
    }
}

fn sentence_case(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// `1 dream`, `2 dreams`.
pub(super) fn counted(n: usize, noun: &str) -> String {
    let s = if n == 1 { "" } else { "s" };
    format!("{n} {noun}{s}")
}

fn millis() -> u64 {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).map_or(0, |since| since.as_millis() as u64)
}

/// A seed that was not there before; it is written down with what it made.
fn fresh_seed() -> u64 {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64)
}

/// The preference that an arrow means.
pub(super) const PREFERENCES: [Preference; 3] = [Preference::Left, Preference::Equal, Preference::Right];
