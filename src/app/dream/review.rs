//! Kept dreams: looking at them again, deleting them and bringing them back.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use crate::app::{App, Command, DreamCommand, Panel, Picture, PlaybackCommand, Playhead, State, counted};
use crate::dream::DreamEpisode;
use crate::query::DreamId;
use crate::session::Event;
use crate::worker::{DreamInspectorCommand, DreamRewards, ReviewView, WorkerCommand};

/// A kept dream on the screen.
#[derive(Debug, Default)]
pub(crate) struct Reviewing {
    /// Which one.
    pub dream: Option<DreamId>,
    /// Whether somebody asked for it in the panel of dreams, where it stands in the place of the next one.
    pub is_opened: bool,
    /// Where in it.
    pub head: Playhead,
    /// What was seen and thought there.
    pub view: Option<ReviewView>,
    pub picture: Option<Picture>,
    /// What the reward says of the whole dream.
    pub rewards: Option<DreamRewards>,
    /// All dreams that could be read.
    pub episodes: BTreeMap<DreamId, Arc<DreamEpisode>>,
    /// Those that the dream inspector knows.
    known: BTreeSet<DreamId>,
    /// What was asked for last.
    asked: Option<(DreamId, usize)>,
}

impl Reviewing {
    /// The dream that is looked at.
    pub(crate) fn episode(&self) -> Option<&DreamEpisode> {
        self.episodes.get(&self.dream?).map(Arc::as_ref)
    }

    /// Whether the dream inspector knows any.
    pub(crate) fn is_known(&self) -> bool {
        !self.known.is_empty()
    }

    /// The step that is looked at.
    pub(crate) fn step(&self) -> usize {
        self.head.step(self.episode().map_or(0, DreamEpisode::len))
    }
}

impl State {
    /// The dreams that can be looked at, in the order of keeping.
    pub(crate) fn reviewable(&self) -> Vec<DreamId> {
        let Some(session) = self.session() else { return Vec::new() };
        let lens = session.dream_lens();
        lens.into_iter().map(|(id, _)| id).filter(|id| self.review.episodes.contains_key(id)).collect()
    }

    /// Whether a kept dream is on the screen.
    pub(crate) fn is_reviewing(&self) -> bool {
        match self.panel {
            Panel::Reward => true,
            Panel::Dream => !self.dream.is_on && self.review.is_opened && self.review.dream.is_some(),
            Panel::Record | Panel::World | Panel::Label | Panel::Deploy | Panel::Evaluate => false,
        }
    }
}

impl App {
    pub(in crate::app) fn playback_command(&mut self, command: &PlaybackCommand) {
        if self.state.panel == Panel::Record {
            return self.play_episode(command);
        }
        if self.state.panel == Panel::Evaluate {
            return self.play_replay(command);
        }
        match command {
            PlaybackCommand::Next(by) => {
                let all = self.state.reviewable();
                let here = all.iter().position(|id| Some(*id) == self.state.review.dream);
                let next = here.map_or(all.len() as i32 - 1, |here| here as i32 + by);
                if let Some(id) = usize::try_from(next).ok().and_then(|next| all.get(next)) {
                    self.review(Some(*id));
                }
            }
            PlaybackCommand::Scrub(step) => self.state.review.head.stand_at(*step),
            PlaybackCommand::Play => {
                let len = self.state.review.episode().map_or(0, DreamEpisode::len);
                self.state.review.head.toggle(len);
            }
        }
    }

    pub(super) fn review(&mut self, dream: Option<DreamId>) {
        let is_opened = dream.is_some() && (self.state.review.is_opened || self.state.panel == Panel::Dream);
        let review = &mut self.state.review;
        review.is_opened = is_opened;
        (review.dream, review.head) = (dream, Playhead::default());
        (review.view, review.rewards, review.asked, review.picture) = (None, None, None, None);
    }

    pub(super) fn delete_dream(&mut self, dream: DreamId) {
        self.record(Event::DreamDropped { dream });
    }

    /// A dream is deleted: nothing is asked about it any more.
    pub(in crate::app) fn dream_deleted(&mut self, dream: DreamId) {
        if self.state.review.dream == Some(dream) {
            self.review(None);
        }
        // Pairs that were about to be asked may show it.
        self.forget_disagreements();
        self.next_query(None);
        let text = format!("dream {} is deleted, and nothing is asked about it", dream.0 + 1);
        let restore = Command::Dream(DreamCommand::Restore(dream));
        self.offer(text, vec![("Bring it back".to_owned(), restore)]);
    }

    pub(super) fn restore_dream(&mut self, dream: DreamId) {
        self.record(Event::DreamRestored { dream });
    }

    /// Has the step on the screen drawn, and moves on while a dream plays.
    pub(in crate::app) fn advance_review(&mut self, dt: f64) {
        if !self.state.is_reviewing() {
            self.state.review.head.is_playing = false;
            return;
        }
        if self.state.review.dream.is_none() {
            let last = self.state.reviewable().pop();
            self.state.review.dream = last;
        }
        let rate = self.state.spec.rate;
        let review = &mut self.state.review;
        let Some((id, episode)) = review.dream.and_then(|id| Some((id, review.episodes.get(&id)?.clone())))
        else {
            return;
        };
        review.head.pass(dt.min(0.25), rate, episode.len());
        let wanted = Some((id, review.step()));
        if review.asked == wanted {
            return;
        }
        review.asked = wanted;
        self.show_to_inspector(id);
        let step = self.state.review.step();
        self.send(WorkerCommand::DreamInspector(DreamInspectorCommand::Show { dream: id, step }));
    }

    /// Makes the dream inspector know a dream, and the reward.
    pub(in crate::app) fn show_to_inspector(&mut self, dream: DreamId) {
        if self.state.review.known.is_empty()
            && let Some(parameters) = self.state.reward.parameters.clone()
        {
            self.send(WorkerCommand::DreamInspector(DreamInspectorCommand::Reward(parameters)));
        }
        if let Some(episode) = self.state.review.episodes.get(&dream).cloned()
            && self.state.review.known.insert(dream)
        {
            self.send(WorkerCommand::DreamInspector(DreamInspectorCommand::AddDream(dream, episode)));
        }
    }

    /// The dream inspector has shown a step.
    pub(super) fn review_seen(&mut self, view: ReviewView) {
        let review = &mut self.state.review;
        if Some(view.dream) == review.dream {
            review.picture = Some(Picture::from(&view.frame));
            review.view = Some(view);
        }
    }

    /// Knows a dream that was kept, and tells the workers.
    pub(in crate::app) fn add_dream(&mut self, id: DreamId, episode: DreamEpisode) {
        use crate::worker::{ClipperCommand, ScreenerCommand, TrainerCommand};

        let episode = Arc::new(episode);
        self.state.review.episodes.insert(id, Arc::clone(&episode));
        self.send(WorkerCommand::Clipper(ClipperCommand::AddDream(id, Arc::clone(&episode))));
        self.send(WorkerCommand::Screener(ScreenerCommand::AddDream(id, Arc::clone(&episode))));
        self.send(WorkerCommand::Trainer(TrainerCommand::AddDream(id, episode)));
    }
}

/// How many answers rest on a dream, in words; nothing where it can be deleted.
pub(crate) fn resting(state: &State, dream: DreamId) -> Option<String> {
    match state.session()?.n_resting_on(dream) {
        0 => None,
        n => Some(format!("{} rest on this dream: take them back first", counted(n, "answer"))),
    }
}
