//! Acting in the real world, to have something that a world model can be fitted to.

mod episodes;
mod rollout_comparison;

use std::path::PathBuf;
use std::sync::Arc;

pub(crate) use episodes::Episodes;
pub(crate) use rollout_comparison::Rollout;

use crate::app::{App, Command, Effect, Field, Picture, counted};
use crate::worker::{DreamerCommand, JobCommand, LiveView, RecordReport, RecorderCommand, WorkerCommand};

/// On recording, and on recorded episodes.
#[derive(Clone, Debug, PartialEq)]
pub enum RecordCommand {
    /// Begins to record an episode.
    Start,
    /// Stops the clock of the recording, or lets it go on.
    Pause,
    /// Ends the recording and keeps it.
    Keep,
    /// Throws the recording away and begins another of the same seed.
    Redo,
    /// Throws the recording away.
    Leave,
    /// Keeps the recordings that a killed program left behind.
    Recover,
    /// Throws them away.
    DiscardUnfinished,
    /// Takes the recordings in a folder for those of this window.
    UseDataset(PathBuf),
    /// Dreams beside the real world, or no longer.
    ToggleRollout,
    /// Lets that dream look at the real world after so many steps, or never.
    ResetRollout(Option<usize>),
    /// Looks at the episode that was recorded as this, or at none any longer.
    Watch(Option<String>),
    /// Asks whether it is really to be deleted, or no longer.
    AskToDelete(bool),
    /// Deletes it from the folder.
    DeleteEpisode,
    /// Brings back the episode that was deleted last.
    RestoreEpisode {
        /// Of this folder.
        dataset: PathBuf,
        /// This one, as long as it is the one that was deleted last.
        recording: String,
    },
}

/// Acting in the real world.
#[expect(clippy::struct_excessive_bools, reason = "each is true or not whatever the others are")]
#[derive(Debug, Default)]
pub(crate) struct Recording {
    pub is_on: bool,
    /// Whether the recording has been asked to end and is being sealed.
    pub is_ending: bool,
    /// Whether it stands because it cannot be written.
    pub is_held: bool,
    /// Whether the planner was given the controls since it began.
    pub is_shared: bool,
    pub live: Option<LiveView>,
    pub picture: Option<Picture>,
    /// Why it was paused, where nobody asked for that.
    pub why_paused: Option<&'static str>,
    /// How many episodes were kept since the window opened.
    pub n_kept: usize,
    /// The dream beside.
    pub rollout: Rollout,
}

impl App {
    pub(super) fn record_command(&mut self, command: RecordCommand) {
        let is_paused = self.state.record.live.as_ref().is_some_and(|live| live.is_paused);
        let dataset: PathBuf = self.state.field(Field::Dataset).into();
        match command {
            RecordCommand::Recover | RecordCommand::DiscardUnfinished if self.state.record.is_on => {
                self.note("end this recording first, then come here again".to_owned());
            }
            RecordCommand::Recover => self.send_recorder(RecorderCommand::Recover(dataset)),
            RecordCommand::DiscardUnfinished => self.send_recorder(RecorderCommand::Forget(dataset)),
            RecordCommand::Start => self.start_recording(),
            RecordCommand::Pause => {
                self.state.record.why_paused = None;
                self.send_recorder(RecorderCommand::Pause(!is_paused));
            }
            // It is being sealed: what is pressed meanwhile must not throw it away.
            RecordCommand::Keep | RecordCommand::Redo | RecordCommand::Leave
                if self.state.record.is_ending => {}
            RecordCommand::Keep => {
                // Nothing was driven, so there is nothing to keep.
                if self.state.record.live.as_ref().is_none_or(|live| live.step == 0) {
                    return self.leave_recording();
                }
                self.state.record.is_ending = true;
                self.send_recorder(RecorderCommand::Keep);
            }
            RecordCommand::Redo => {
                self.send_recorder(RecorderCommand::Discard);
                self.state.record.is_held = false;
                self.start_recording();
            }
            RecordCommand::Leave => self.leave_recording(),
            RecordCommand::UseDataset(dir) => self.use_dataset(dir),
            RecordCommand::ToggleRollout => self.toggle_rollout(),
            RecordCommand::ResetRollout(reset) => self.reset_rollout(reset),
            RecordCommand::Watch(None) => self.close_episode(),
            RecordCommand::Watch(Some(recording)) => self.watch(recording),
            RecordCommand::AskToDelete(is_asked) => self.state.episodes.is_asked = is_asked,
            RecordCommand::DeleteEpisode => self.delete_episode(),
            RecordCommand::RestoreEpisode { dataset, recording } => self.restore_episode(dataset, recording),
        }
    }

    pub(super) fn record_report(&mut self, report: RecordReport) {
        match report {
            RecordReport::View(view) => self.recording_seen(view),
            RecordReport::Rollout(view) => self.rollout_seen(view),
            RecordReport::Recorded { episode, n_steps } => {
                (self.state.record.is_on, self.state.record.is_ending) = (false, false);
                self.state.record.is_held = false;
                self.state.record.n_kept += 1;
                self.next_seed(Field::RecordSeed);
                self.list_recordings();
                self.done(format!("episode {episode} is on disk: {n_steps} steps"));
            }
            RecordReport::Held(why) => self.recording_held(&why),
            RecordReport::Moved(dataset) => self.recording_moved(&dataset),
            RecordReport::Unfinished(n) => self.offer_recordings(n),
            RecordReport::LeftOut(why) => self.warn(why),
            RecordReport::Episodes(list) => self.listed(list),
            RecordReport::Opened(episode) => self.episode_opened(episode),
            RecordReport::EpisodeView(view) => self.episode_seen(&view),
            RecordReport::EpisodeRewards { recording, rewards } => {
                self.episode_evaluated(&recording, rewards);
            }
        }
    }

    fn send_recorder(&mut self, command: RecorderCommand) {
        self.send(WorkerCommand::Recorder(command));
    }

    /// The panel is shown: what its folder holds may be something else than before.
    pub(super) fn show_record(&mut self) {
        if !self.state.episodes.is_changing() {
            self.list_recordings();
            let dataset = self.state.field(Field::Dataset).into();
            self.send_recorder(RecorderCommand::FindUnfinished(dataset));
        }
    }

    /// Pauses a dream or a recording that is being driven; `why` is said where nobody asked for it.
    pub(super) fn pause_driving(&mut self, why: Option<&'static str>) {
        let (dream, record) = (&mut self.state.dream, &mut self.state.record);
        let is_dreaming = dream.is_on && !dream.live.as_ref().is_some_and(|live| live.is_paused);
        let is_recording = record.is_on && !record.live.as_ref().is_some_and(|live| live.is_paused);
        if is_dreaming {
            dream.why_paused = why;
            self.send(WorkerCommand::Dreamer(DreamerCommand::Pause(true)));
        }
        if is_recording {
            self.state.record.why_paused = why;
            self.send_recorder(RecorderCommand::Pause(true));
        }
    }

    fn start_recording(&mut self) {
        let Some(seed) = self.episode_seed(Field::RecordSeed) else { return };
        if self.state.episodes.is_changing() {
            return self.warn("one moment: the recordings are being put in order".to_owned());
        }
        self.close_episode();
        let dataset = self.state.field(Field::Dataset).into();
        self.effects.push(Effect::ReleaseControls);
        let record = &mut self.state.record;
        (record.is_on, record.is_ending, record.is_shared) = (true, false, false);
        (record.live, record.why_paused) = (None, None);
        self.send_recorder(RecorderCommand::Start { dataset, seed });
    }

    fn leave_recording(&mut self) {
        self.send_recorder(RecorderCommand::Discard);
        (self.state.record.is_on, self.state.record.is_held) = (false, false);
    }

    fn recording_seen(&mut self, view: LiveView) {
        let record = &mut self.state.record;
        if record.is_on {
            let scene = view.picture.as_ref().map(Picture::from);
            record.picture = Some(scene.unwrap_or_else(|| Picture::from(&view.frame)));
            record.live = Some(view);
        }
    }

    fn offer_recordings(&mut self, n: usize) {
        let text = format!("{} not ended the last time can still be kept", counted(n, "recording"));
        let ways = [("Keep", RecordCommand::Recover), ("Throw away", RecordCommand::DiscardUnfinished)];
        self.offer(text, ways.map(|(name, command)| (name.to_owned(), Command::Record(command))).into());
    }

    /// The recorder met an error: nothing is being driven any more.
    pub(super) fn recorder_failed(&mut self) {
        (self.state.record.is_on, self.state.record.is_ending) = (false, false);
        self.state.record.is_held = false;
    }

    /// Records into another folder from here on, and fits from it, once it was looked at.
    pub(super) fn use_dataset(&mut self, dir: PathBuf) {
        if self.state.record.is_on {
            return self.warn("end the recording first: keep it, or leave it".to_owned());
        }
        let spec = Arc::clone(&self.state.spec);
        self.begin_job("looking at the recordings", JobCommand::OpenRecordings { dir, spec });
    }
}
