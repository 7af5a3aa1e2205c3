//! What commands do. `App::record` is the only place where the session changes by a single event.

use std::path::PathBuf;
use std::time::SystemTime;

use eframe::egui::Context;

use crate::dream::DreamEpisode;
use crate::query::Protocol;
use crate::session::{DreamSource, Event, Session, SessionError};
use crate::ui::App;
use crate::ui::command::{Command, Field, Panel};
use crate::ui::crew::Order;
use crate::ui::dialog::{Dialog, Purpose};
use crate::ui::state::FitState;
use crate::worker::{DreamerCommand, DriverCommand, ModelerCommand, RecorderCommand, TrainerCommand};

impl App {
    pub(super) fn act(&mut self, ctx: &Context, command: Command) {
        match command {
            Command::Show(panel) => self.show(panel),
            Command::Edit(field, text) => drop(self.state.fields.insert(field, text)),
            Command::Browse(field) => {
                self.dialog = Some(Dialog::open(ctx, Purpose::Field(field), self.state.field(field)));
            }
            Command::Import(_)
            | Command::UseRecordings(_)
            | Command::CompareAnnotators
            | Command::ToggleSeveral
            | Command::AddToSeveral(_)
            | Command::ChooseForSeveral(..)
            | Command::Merge
            | Command::HandOn => self.act_on_errands(ctx, &command),
            Command::Theme(theme) => {
                self.state.theme = theme;
                ctx.set_theme(theme);
            }
            Command::ToggleHelp => {
                (self.state.help_open, self.state.rebinding) = (!self.state.help_open, None);
                self.state.rebinding_pad = None;
            }
            Command::Rebind(_)
            | Command::Bind(_)
            | Command::SwapKeys
            | Command::ResetKeys
            | Command::ShowPad(_)
            | Command::RebindPad(_)
            | Command::BindPad(..)
            | Command::Control(_) => self.act_on_keys(command),
            Command::SaveElsewhere(_) | Command::SaveIn(_) | Command::SaveAgain | Command::ForgetUnsaved => {
                self.act_on_saving(command);
            }
            Command::ToggleSessions => self.toggle_sessions(),
            Command::Dismiss(id) => self.state.toasts.retain(|toast| toast.id != id),
            Command::Restart => self.restart(),
            Command::NewSession(protocol) => self.new_session(protocol),
            Command::ChangeProtocol(protocol) => self.change_protocol(protocol),
            Command::OpenSession(dir) => self.open_session(&dir),
            Command::RecoverDreams => self.recover(),
            Command::DiscardUnfinished => self.discard_unfinished(),
            Command::FitWorld { .. } | Command::StopFit => self.act_on_world(&command),
            Command::LoadWorld(path) => self.load_world(ctx, path),
            Command::HandOver => self.hand_over(),
            Command::ToggleBeside | Command::ResetBeside(_) => self.act_on_beside(&command),
            Command::Review(_)
            | Command::ReviewNext(_)
            | Command::Scrub(_)
            | Command::PlayReview
            | Command::DeleteDream(_)
            | Command::BringBack(_)
            | Command::TryWeights(_)
            | Command::Weigh(_) => self.act_on_review(&command),
            Command::Foretell(query) => self.foretell(query),
            Command::Watch(_)
            | Command::AskToDelete(_)
            | Command::DeleteEpisode
            | Command::BringEpisodeBack { .. } => self.act_on_shelf(&command),
            Command::StartRecording
            | Command::PauseRecording
            | Command::KeepRecording
            | Command::RedoRecording
            | Command::LeaveRecording
            | Command::RecoverRecordings
            | Command::ForgetRecordings => self.act_on_recording(&command),
            Command::ChooseStart(_)
            | Command::StartDream
            | Command::PauseDream
            | Command::StepDream
            | Command::MarkUnsafe
            | Command::KeepDream
            | Command::RedoDream
            | Command::LeaveDream => self.act_on_dream(&command),
            Command::FitReward => self.fit_reward(),
            Command::Drive | Command::PauseDrive | Command::StopDrive => self.act_on_drive(&command),
            _ => self.act_on_label(command),
        }
    }

    pub(super) fn show(&mut self, panel: Panel) {
        if panel == self.state.panel {
            return;
        }
        // Nobody drives what nobody sees.
        self.pause_driving(None);
        self.hands.release();
        self.state.panel = panel;
        if panel == Panel::Record && !self.state.shelf.is_changing() {
            self.list_recordings();
            let dataset = self.state.field(Field::Dataset).into();
            self.crew.send(Order::Recorder(RecorderCommand::Look(dataset)));
        }
    }

    /// Pauses a dream or a recording that is being driven; `why` is said where nobody asked for it.
    pub(super) fn pause_driving(&mut self, why: Option<&'static str>) {
        let (dream, record) = (&mut self.state.dream, &mut self.state.record);
        if dream.is_on && !dream.live.as_ref().is_some_and(|live| live.is_paused) {
            dream.why_paused = why;
            self.crew.send(Order::Dreamer(DreamerCommand::Pause(true)));
        }
        if record.is_on && !record.live.as_ref().is_some_and(|live| live.is_paused) {
            record.why_paused = why;
            self.crew.send(Order::Recorder(RecorderCommand::Pause(true)));
        }
    }

    /// Writes `event` down; the session changes here and, where files belong to an event, in the store's `save_…`.
    pub(super) fn record(&mut self, event: Event) -> bool {
        let Some(store) = &mut self.state.store else { return false };
        match store.record(event) {
            Ok(()) => true,
            Err(e @ SessionError::Impossible(_)) => {
                let ways = vec![("Other sessions…".to_owned(), Command::ToggleSessions)];
                self.fail_with(format!("nothing is lost, but this was not saved: {e}"), ways);
                false
            }
            Err(e) => {
                self.not_saved("nothing is lost, but this is not saved", &e.to_string());
                false
            }
        }
    }

    fn act_on_world(&mut self, command: &Command) {
        match *command {
            Command::FitWorld { .. } if self.state.shelf.is_changing() => {
                self.note("one moment: the recordings are being put in order".to_owned());
            }
            Command::FitWorld { resume } => {
                let (dataset, out) =
                    (self.state.field(Field::Dataset).into(), self.state.field(Field::ModelOut).into());
                self.state.world.fit = Some(FitState::default());
                self.crew.send(Order::Modeler(ModelerCommand::Fit { dataset, out, resume }));
            }
            Command::StopFit => self.crew.send(Order::Modeler(ModelerCommand::Stop)),
            _ => {}
        }
    }

    fn act_on_recording(&mut self, command: &Command) {
        let is_paused = self.state.record.live.as_ref().is_some_and(|live| live.is_paused);
        let dataset: PathBuf = self.state.field(Field::Dataset).into();
        match command {
            Command::RecoverRecordings | Command::ForgetRecordings if self.state.record.is_on => {
                self.note("end this recording first, then come here again".to_owned());
            }
            Command::RecoverRecordings => {
                self.crew.send(Order::Recorder(RecorderCommand::Recover(dataset)));
            }
            Command::ForgetRecordings => {
                self.crew.send(Order::Recorder(RecorderCommand::Forget(dataset)));
            }
            Command::StartRecording => self.start_recording(),
            Command::PauseRecording => {
                self.state.record.why_paused = None;
                self.crew.send(Order::Recorder(RecorderCommand::Pause(!is_paused)));
            }
            // Nothing was driven, so there is nothing to keep.
            Command::KeepRecording if self.state.record.live.as_ref().is_none_or(|live| live.step == 0) => {
                self.act_on_recording(&Command::LeaveRecording);
            }
            // It is being sealed: what is pressed meanwhile must not throw it away.
            _ if self.state.record.is_ending => {}
            Command::KeepRecording => {
                self.state.record.is_ending = true;
                self.crew.send(Order::Recorder(RecorderCommand::Keep));
            }
            Command::RedoRecording => {
                self.crew.send(Order::Recorder(RecorderCommand::Discard));
                self.state.record.is_held = false;
                self.start_recording();
            }
            _ => {
                self.crew.send(Order::Recorder(RecorderCommand::Discard));
                (self.state.record.is_on, self.state.record.is_held) = (false, false);
            }
        }
    }

    pub(super) fn offer_recordings(&mut self, n: usize) {
        let text = format!("{} survived a program that was ended while driving", counted(n, "recording"));
        let ways = [("Keep", Command::RecoverRecordings), ("Throw away", Command::ForgetRecordings)];
        self.offer(text, ways.map(|(name, command)| (name.to_owned(), command)).into());
    }

    fn start_recording(&mut self) {
        let Ok(seed) = self.state.field(Field::RecordSeed).trim().parse() else {
            self.fail("the seed of a track is a whole number, such as 7".to_owned());
            return;
        };
        if self.state.shelf.is_changing() {
            return self.warn("one moment: the recordings are being put in order".to_owned());
        }
        self.close_shelf();
        let dataset = self.state.field(Field::Dataset).into();
        self.hands.release();
        (self.state.record.is_on, self.state.record.is_ending) = (true, false);
        (self.state.record.live, self.state.record.why_paused) = (None, None);
        self.state.record.is_shared = false;
        self.crew.send(Order::Recorder(RecorderCommand::Start { dataset, seed }));
    }

    fn act_on_dream(&mut self, command: &Command) {
        let is_paused = self.state.dream.live.as_ref().is_some_and(|live| live.is_paused);
        match *command {
            Command::ChooseStart(idx) => {
                self.state.dream.start_idx = idx;
                self.state.dream.picture = None;
            }
            Command::StartDream => {
                self.state.review.dream = None;
                self.start_dream(fresh_seed());
            }
            Command::PauseDream => {
                self.state.dream.why_paused = None;
                self.crew.send(Order::Dreamer(DreamerCommand::Pause(!is_paused)));
            }
            Command::StepDream if is_paused => self.crew.send(Order::Dreamer(DreamerCommand::Step)),
            Command::MarkUnsafe => self.crew.send(Order::Dreamer(DreamerCommand::MarkUnsafe)),
            Command::KeepDream if !self.state.dream.is_ending => {
                self.state.dream.is_ending = true;
                self.crew.send(Order::Dreamer(DreamerCommand::Finish));
            }
            Command::RedoDream => {
                self.end_dream();
                self.start_dream(fresh_seed());
            }
            Command::LeaveDream => self.end_dream(),
            _ => {}
        }
    }

    fn start_dream(&mut self, seed: u64) {
        if self.state.is_opening() {
            return self.warn("one moment: the session is being opened".to_owned());
        }
        if self.state.store.is_none() {
            self.new_session(Protocol::of_env(&self.state.env));
        }
        let idx = self.state.dream.start_idx;
        let start = self.state.world.loaded.as_ref().and_then(|world| world.starts.get(idx));
        let Some(start) = start.map(|start| start.state.clone()) else { return };
        // Nobody drives what could not be kept; why there is no session has been said.
        let Some(store) = &self.state.store else { return };
        let begun = DreamEpisode::new(start.clone(), seed);
        let journal = match store.journal(&begun, DreamSource::User) {
            Ok(journal) => Some(journal),
            Err(e) => {
                let text = "no dream begins, for it would be lost if the program were killed";
                return self.not_saved(text, &e.to_string());
            }
        };
        self.hands.release();
        let dream = &mut self.state.dream;
        dream.begun = Some(begun);
        (dream.is_on, dream.is_ending, dream.live, dream.seed) = (true, false, None, seed);
        (dream.is_shared, dream.why_paused) = (false, None);
        self.crew.send(Order::Dreamer(DreamerCommand::Start { start, seed, journal }));
    }

    pub(super) fn end_dream(&mut self) {
        if self.state.dream.is_on {
            self.crew.send(Order::Dreamer(DreamerCommand::Discard));
            self.state.dream.is_on = false;
        }
    }

    fn fit_reward(&mut self) {
        let Some(after) = self.state.session().map(Session::n_entries) else { return };
        let seed = fresh_seed();
        let reward = &mut self.state.reward;
        reward.is_fitting = true;
        // What is answered while it fits is not in it.
        reward.asked.push((seed, after));
        self.crew.send(Order::Trainer(TrainerCommand::Fit { seed }));
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

    /// Lets go of everything before the window closes; what is being driven stays in its journal.
    pub(super) fn leave(&mut self) {
        self.hands.release();
    }
}

/// `1 dream`, `2 dreams`.
pub(super) fn counted(n: usize, noun: &str) -> String {
    let s = if n == 1 { "" } else { "s" };
    format!("{n} {noun}{s}")
}

/// A seed that was not there before; it is written down with what it made.
pub(super) fn fresh_seed() -> u64 {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64)
}
