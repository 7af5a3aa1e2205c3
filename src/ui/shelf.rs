//! What is done with recorded episodes: listing them, looking at them again, deleting them.

use std::path::PathBuf;

use eframe::egui::{Context, TextureHandle};

use crate::dataset::Summary;
use crate::ui::App;
use crate::ui::command::{Command, Field, Panel};
use crate::ui::crew::Order;
use crate::ui::playhead::Playhead;
use crate::ui::state::State;
use crate::ui::widgets::clip;
use crate::worker::{LibrarianCommand, OpenEpisode, Report, Shelf};

/// Recorded episodes, and the one on the screen.
#[derive(Default)]
pub(crate) struct Shelving {
    /// What the folder of recordings holds, once that is known.
    pub list: Option<Shelf>,
    /// The episode that is looked at, by what it was recorded as.
    pub open: Option<String>,
    pub head: Playhead,
    /// What was done in it, once it is read.
    pub episode: Option<OpenEpisode>,
    pub picture: Option<TextureHandle>,
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
    /// Whether the librarian knows the present reward.
    is_taught: bool,
}

/// A change of the folder of recordings.
enum Change {
    /// The episode recorded as this, which has this number, goes.
    Delete(String, usize),
    BringBack,
}

impl Shelving {
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
        (self.rewards, self.is_taught) = (None, false);
    }

    fn close(&mut self) {
        let Self { list, changing, listed, is_taught, .. } = std::mem::take(self);
        *self = Self { list, changing, listed, is_taught, ..Self::default() };
    }
}

impl State {
    /// How many recorded episodes are known of.
    pub(crate) fn n_recorded(&self) -> usize {
        self.shelf.list.as_ref().map_or(self.record.n_kept, |list| list.episodes.len())
    }

    /// Whether a recorded episode is on the screen.
    pub(crate) fn is_watching(&self) -> bool {
        self.panel == Panel::Record && !self.record.is_on && self.shelf.open.is_some()
    }
}

impl App {
    pub(super) fn act_on_shelf(&mut self, command: &Command) {
        match command {
            Command::Watch(None) => self.close_shelf(),
            Command::Watch(Some(recording)) => self.watch(recording.clone()),
            Command::AskToDelete(is_asked) => self.state.shelf.is_asked = *is_asked,
            Command::DeleteEpisode => self.delete_episode(),
            Command::BringEpisodeBack { dataset, recording } => {
                self.bring_episode_back(dataset.clone(), recording.clone());
            }
            _ => {}
        }
    }

    /// Stands at a step, plays, or goes to another episode.
    pub(super) fn move_in_episode(&mut self, command: &Command) {
        let shelf = &mut self.state.shelf;
        let len = shelf.len();
        match command {
            Command::Scrub(step) => shelf.head.stand_at(*step),
            Command::PlayReview => shelf.head.toggle(len),
            Command::ReviewNext(by) => {
                let (Some((here, _)), Some(list)) = (shelf.place(), &shelf.list) else { return };
                let next = here.checked_add_signed(*by as isize).and_then(|next| list.episodes.get(next));
                if let Some(recording) = next.map(|next| next.recording.clone()) {
                    self.watch(recording);
                }
            }
            _ => {}
        }
    }

    fn watch(&mut self, recording: String) {
        let Some(list) = &self.state.shelf.list else { return };
        let dataset = list.dataset.clone();
        self.state.shelf.close();
        self.state.shelf.open = Some(recording.clone());
        self.crew.send(Order::Librarian(LibrarianCommand::Open { dataset, recording }));
    }

    /// Looks at no episode any more, and lets go of its frames.
    pub(super) fn close_shelf(&mut self) {
        if self.state.shelf.open.is_some() {
            self.state.shelf.close();
            self.crew.send(Order::Librarian(LibrarianCommand::Close));
        }
    }

    /// Whether recordings can be changed now; says why where they cannot.
    fn can_change_recordings(&mut self) -> bool {
        let why = if self.state.record.is_on {
            "end this recording first, then come here again"
        } else if self.state.world.fit.is_some() {
            "a world model is being fitted to these recordings: wait for it, or stop it first"
        } else if self.state.shelf.is_changing() {
            "one moment: the recordings are being put in order"
        } else {
            return true;
        };
        self.warn(why.to_owned());
        false
    }

    fn delete_episode(&mut self) {
        self.state.shelf.is_asked = false;
        let Some(Summary { recording, number, .. }) = self.state.shelf.summary().cloned() else { return };
        let Some(dataset) = self.state.shelf.list.as_ref().map(|list| list.dataset.clone()) else { return };
        if self.can_change_recordings() {
            self.state.shelf.close();
            self.state.shelf.changing = Some(Change::Delete(recording.clone(), number));
            self.crew.send(Order::Librarian(LibrarianCommand::Delete { dataset, recording }));
        }
    }

    fn bring_episode_back(&mut self, dataset: PathBuf, recording: String) {
        if self.can_change_recordings() {
            self.state.shelf.changing = Some(Change::BringBack);
            self.crew.send(Order::Librarian(LibrarianCommand::BringBack { dataset, recording }));
        }
    }

    /// Lists the folder where it may hold something else than before.
    pub(super) fn list_recordings(&mut self) {
        self.state.shelf.listed = None;
    }

    pub(super) fn hear_librarian(&mut self, report: Report) {
        let shelf = &mut self.state.shelf;
        let is_open = |recording: &String| shelf.open.as_ref() == Some(recording);
        match report {
            Report::Shelf(list) => self.listed(list),
            Report::Opened(episode) if is_open(&episode.recording) => shelf.episode = Some(episode),
            // By this reward, and not by that of a session before.
            Report::JudgedEpisode { recording, rewards }
                if is_open(&recording) && shelf.is_taught && self.state.reward.parameters.is_some() =>
            {
                shelf.rewards = Some(rewards);
            }
            _ => {}
        }
    }

    fn listed(&mut self, list: Shelf) {
        let shelf = &mut self.state.shelf;
        // Of a folder that was named before this one, nothing is shown.
        let is_wanted = shelf.listed.as_ref().is_none_or(|listed| *listed == list.dataset);
        let changed = if list.is_changed { shelf.changing.take() } else { None };
        let dataset = list.dataset.clone();
        let last = list.episodes.last().map(|last| last.number);
        let deleted = list.deleted.as_ref().map(|deleted| deleted.recording.clone());
        if is_wanted {
            shelf.list = Some(list);
            if shelf.summary().is_none() {
                self.close_shelf();
            }
        }
        match (changed, deleted, last) {
            (Some(Change::Delete(recording, number)), Some(deleted), _) if recording == deleted => {
                let back = Command::BringEpisodeBack { dataset, recording };
                self.offer(format!("episode {number} is deleted"), vec![("Bring it back".to_owned(), back)]);
            }
            (Some(Change::BringBack), None, Some(last)) => {
                self.done(format!("the episode is back, as number {last}"));
            }
            // It did not work, and the librarian says why.
            _ => {}
        }
    }

    /// The librarian met an error: nothing is being changed any more.
    pub(super) fn librarian_failed(&mut self) {
        self.state.shelf.changing = None;
        if self.state.shelf.episode.is_none() {
            self.close_shelf();
        }
    }

    /// Has the folder listed and the step on the screen drawn, and moves on while an episode plays.
    pub(super) fn show_shelf(&mut self, ctx: &Context) {
        if self.state.panel != Panel::Record || self.state.record.is_on {
            self.state.shelf.head.is_playing = false;
            return;
        }
        let dataset = PathBuf::from(self.state.field(Field::Dataset));
        let shelf = &mut self.state.shelf;
        if shelf.listed.as_ref() != Some(&dataset) && !shelf.is_changing() {
            if shelf.list.as_ref().is_some_and(|list| list.dataset != dataset) {
                shelf.list = None;
                shelf.close();
            }
            shelf.listed = Some(dataset.clone());
            self.crew.send(Order::Librarian(LibrarianCommand::List(dataset)));
        }
        let shelf = &mut self.state.shelf;
        if shelf.open.is_none() {
            return;
        }
        if !shelf.is_taught {
            shelf.is_taught = true;
            let reward = self.state.reward.parameters.clone();
            let judge = self.state.world.loaded.as_ref().map(|world| world.parameters.clone()).zip(reward);
            self.crew.send(Order::Librarian(LibrarianCommand::Judge(judge)));
        }
        let shelf = &mut self.state.shelf;
        let len = shelf.len();
        shelf.head.pass(f64::from(ctx.input(|input| input.stable_dt)).min(0.25), len);
        let step = shelf.step();
        // Its first step is drawn when it is opened.
        if shelf.episode.is_some() && shelf.asked.replace(step).unwrap_or(0) != step {
            self.crew.send(Order::Librarian(LibrarianCommand::Look(step)));
        }
    }

    /// Takes in what the librarian has drawn.
    pub(super) fn hear_shelf(&mut self, ctx: &Context) {
        let shelf = &mut self.state.shelf;
        if let Some(view) =
            self.slots.episode.take().filter(|view| Some(&view.recording) == shelf.open.as_ref())
        {
            clip::put(ctx, &mut shelf.picture, &view.frame);
        }
    }
}
