//! Recorded episodes: listing them, looking at them again, deleting them.

use std::path::PathBuf;

use crate::app::{App, Command, Field, Panel, Picture, PlaybackCommand, Playhead, RecordCommand, State};
use crate::dataset::Summary;
use crate::worker::{EpisodeBrowserCommand, EpisodeList, EpisodeView, OpenEpisode, WorkerCommand};

/// Recorded episodes, and the one on the screen.
#[derive(Debug, Default)]
pub(crate) struct Episodes {
    /// What the folder of recordings holds, once that is known.
    pub list: Option<EpisodeList>,
    /// The episode that is looked at, by what it was recorded as.
    pub open: Option<String>,
    pub head: Playhead,
    /// What was done in it, once it is read.
    pub episode: Option<OpenEpisode>,
    pub picture: Option<Picture>,
    /// What the reward says of it: the mean of the members, the lowest and the highest.
    pub rewards: Option<[Vec<f32>; 3]>,
    /// Whether it is asked if the open one is really to be deleted.
    pub is_asked: bool,
    /// What is being changed in the folder.
    changing: Option<Change>,
    /// The folder that was listed last.
    listed: Option<PathBuf>,
    /// The step that was asked for last.
    asked: Option<usize>,
    /// Whether the episode browser knows the present reward.
    is_told: bool,
}

/// A change of the folder of recordings.
#[derive(Debug)]
enum Change {
    /// The episode recorded as this, which has this number, goes.
    Delete(String, usize),
    Restore,
}

impl Episodes {
    /// What is known of the episode that is looked at.
    pub(crate) fn summary(&self) -> Option<&Summary> {
        self.list.as_ref()?.episodes.iter().find(|it| Some(&it.recording) == self.open.as_ref())
    }

    /// How many steps it has.
    pub(crate) fn len(&self) -> usize {
        self.episode.as_ref().map_or(0, |episode| episode.actions.len())
    }

    /// The step that is looked at.
    pub(crate) fn step(&self) -> usize {
        self.head.step(self.len())
    }

    /// The place in the list of the episode that is looked at, and how long the list is.
    pub(crate) fn place(&self) -> Option<(usize, usize)> {
        let all = &self.list.as_ref()?.episodes;
        Some((all.iter().position(|it| Some(&it.recording) == self.open.as_ref())?, all.len()))
    }

    /// Whether an episode is being deleted or brought back.
    pub(crate) fn is_changing(&self) -> bool {
        self.changing.is_some()
    }

    /// Another reward, or none: what was said by the one before does not count any more.
    pub(crate) fn forget_reward(&mut self) {
        (self.rewards, self.is_told) = (None, false);
    }

    fn is_open(&self, recording: &str) -> bool {
        self.open.as_deref() == Some(recording)
    }

    fn close(&mut self) {
        let Self { list, changing, listed, is_told, .. } = std::mem::take(self);
        *self = Self { list, changing, listed, is_told, ..Self::default() };
    }
}

impl State {
    /// How many recorded episodes are known of.
    pub(crate) fn n_recorded(&self) -> usize {
        self.episodes.list.as_ref().map_or(self.record.n_kept, |list| list.episodes.len())
    }

    /// Whether a recorded episode is on the screen.
    pub(crate) fn is_watching(&self) -> bool {
        self.panel == Panel::Record && !self.record.is_on && self.episodes.open.is_some()
    }
}

impl App {
    /// Stands at a step, plays, or goes to another episode.
    pub(in crate::app) fn play_episode(&mut self, command: &PlaybackCommand) {
        let episodes = &mut self.state.episodes;
        let len = episodes.len();
        match command {
            PlaybackCommand::Scrub(step) => episodes.head.stand_at(*step),
            PlaybackCommand::Play => episodes.head.toggle(len),
            PlaybackCommand::Next(by) => {
                let (Some((here, _)), Some(list)) = (episodes.place(), &episodes.list) else { return };
                let next = here.checked_add_signed(*by as isize).and_then(|next| list.episodes.get(next));
                if let Some(recording) = next.map(|next| next.recording.clone()) {
                    self.watch(recording);
                }
            }
        }
    }

    pub(super) fn watch(&mut self, recording: String) {
        let Some(list) = &self.state.episodes.list else { return };
        let dataset = list.dataset.clone();
        self.state.episodes.close();
        self.state.episodes.open = Some(recording.clone());
        self.send(WorkerCommand::EpisodeBrowser(EpisodeBrowserCommand::Open { dataset, recording }));
    }

    /// Looks at no episode any more, and lets go of its frames.
    pub(in crate::app) fn close_episode(&mut self) {
        if self.state.episodes.open.is_some() {
            self.state.episodes.close();
            self.send(WorkerCommand::EpisodeBrowser(EpisodeBrowserCommand::Close));
        }
    }

    /// Whether recordings can be changed now; says why where they cannot.
    fn can_change_recordings(&mut self) -> bool {
        let why = if self.state.record.is_on {
            "end this recording first, then come here again"
        } else if self.state.world.fit.is_some() {
            "a world model is being fitted to these recordings: wait for it, or stop it first"
        } else if self.state.episodes.is_changing() {
            "one moment: the recordings are being put in order"
        } else {
            return true;
        };
        self.warn(why.to_owned());
        false
    }

    pub(super) fn delete_episode(&mut self) {
        self.state.episodes.is_asked = false;
        let Some(Summary { recording, number, .. }) = self.state.episodes.summary().cloned() else { return };
        let Some(dataset) = self.state.episodes.list.as_ref().map(|list| list.dataset.clone()) else {
            return;
        };
        if self.can_change_recordings() {
            self.state.episodes.close();
            self.state.episodes.changing = Some(Change::Delete(recording.clone(), number));
            self.send(WorkerCommand::EpisodeBrowser(EpisodeBrowserCommand::Delete { dataset, recording }));
        }
    }

    pub(super) fn restore_episode(&mut self, dataset: PathBuf, recording: String) {
        if self.can_change_recordings() {
            self.state.episodes.changing = Some(Change::Restore);
            self.send(WorkerCommand::EpisodeBrowser(EpisodeBrowserCommand::BringBack { dataset, recording }));
        }
    }

    /// Lists the folder where it may hold something else than before.
    pub(in crate::app) fn list_recordings(&mut self) {
        self.state.episodes.listed = None;
    }

    /// An episode has been read.
    pub(super) fn episode_opened(&mut self, episode: OpenEpisode) {
        if self.state.episodes.is_open(&episode.recording) {
            self.state.episodes.episode = Some(episode);
        }
    }

    /// The reward has evaluated an episode.
    pub(super) fn episode_evaluated(&mut self, recording: &str, rewards: [Vec<f32>; 3]) {
        let episodes = &mut self.state.episodes;
        // By this reward, and not by that of a session before.
        if episodes.is_open(recording) && episodes.is_told && self.state.reward.parameters.is_some() {
            episodes.rewards = Some(rewards);
        }
    }

    /// A step of an episode is decoded.
    pub(super) fn episode_seen(&mut self, view: &EpisodeView) {
        if self.state.episodes.is_open(&view.recording) {
            self.state.episodes.picture = Some(Picture::from(&view.frame));
        }
    }

    pub(super) fn listed(&mut self, list: EpisodeList) {
        let episodes = &mut self.state.episodes;
        // Of a folder that was named before this one, nothing is shown.
        let is_wanted = episodes.listed.as_ref().is_none_or(|listed| *listed == list.dataset);
        let changed = if list.is_changed { episodes.changing.take() } else { None };
        let dataset = list.dataset.clone();
        let last = list.episodes.last().map(|last| last.number);
        let deleted = list.deleted.as_ref().map(|deleted| deleted.recording.clone());
        if is_wanted {
            episodes.list = Some(list);
            if episodes.summary().is_none() {
                self.close_episode();
            }
        }
        match (changed, deleted, last) {
            (Some(Change::Delete(recording, number)), Some(deleted), _) if recording == deleted => {
                let back = Command::Record(RecordCommand::RestoreEpisode { dataset, recording });
                self.offer(format!("episode {number} is deleted"), vec![("Bring it back".to_owned(), back)]);
            }
            (Some(Change::Restore), None, Some(last)) => {
                self.done(format!("the episode is back, as number {last}"));
            }
            // It did not work, and the episode browser says why.
            _ => {}
        }
    }

    /// The episode browser met an error: nothing is being changed any more.
    pub(in crate::app) fn episode_browser_failed(&mut self) {
        self.state.episodes.changing = None;
        if self.state.episodes.episode.is_none() {
            self.close_episode();
        }
    }

    /// Has the folder listed and the step on the screen drawn, and moves on while an episode plays.
    pub(in crate::app) fn advance_episode(&mut self, dt: f64) {
        if self.state.panel != Panel::Record || self.state.record.is_on {
            self.state.episodes.head.is_playing = false;
            return;
        }
        let dataset = PathBuf::from(self.state.field(Field::Dataset));
        let episodes = &mut self.state.episodes;
        if episodes.listed.as_ref() != Some(&dataset) && !episodes.is_changing() {
            if episodes.list.as_ref().is_some_and(|list| list.dataset != dataset) {
                episodes.list = None;
                episodes.close();
            }
            episodes.listed = Some(dataset.clone());
            self.send(WorkerCommand::EpisodeBrowser(EpisodeBrowserCommand::List(dataset)));
        }
        let episodes = &mut self.state.episodes;
        if episodes.open.is_none() {
            return;
        }
        if !episodes.is_told {
            episodes.is_told = true;
            let reward = self.state.reward.parameters.clone();
            let evaluator =
                self.state.world.loaded.as_ref().map(|world| world.parameters.clone()).zip(reward);
            self.send(WorkerCommand::EpisodeBrowser(EpisodeBrowserCommand::Evaluate(evaluator)));
        }
        let rate = self.state.spec.rate;
        let episodes = &mut self.state.episodes;
        let len = episodes.len();
        episodes.head.pass(dt.min(0.25), rate, len);
        let step = episodes.step();
        // Its first step is drawn when it is opened.
        if episodes.episode.is_some() && episodes.asked.replace(step).unwrap_or(0) != step {
            self.send(WorkerCommand::EpisodeBrowser(EpisodeBrowserCommand::Show(step)));
        }
    }
}
