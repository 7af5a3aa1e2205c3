//! What is done with kept dreams: looking at them again, deleting them, and weighing answers differently.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::Arc;

use eframe::egui::{Context, TextureHandle};

use crate::dream::DreamEpisode;
use crate::query::{DreamId, Weights};
use crate::session::{Event, Session};
use crate::ui::App;
use crate::ui::act::counted;
use crate::ui::choosing::Weighing;
use crate::ui::command::{Command, Panel};
use crate::ui::crew::Order;
use crate::ui::foretelling::Foretelling;
use crate::ui::playhead::Playhead;
use crate::ui::state::{Rewarding, State, World};
use crate::ui::widgets::clip;
use crate::worker::trainer::MIN_LABELS;
use crate::worker::{Job, Judgement, Report, ReviewView, ReviewerCommand, TrainerCommand};

/// A kept dream on the screen.
#[derive(Default)]
pub(crate) struct Reviewing {
    /// Which one.
    pub dream: Option<DreamId>,
    /// Where in it.
    pub head: Playhead,
    /// What was seen and thought there.
    pub view: Option<ReviewView>,
    pub picture: Option<TextureHandle>,
    /// What the reward says of the whole dream.
    pub judgement: Option<Judgement>,
    /// All dreams that could be read.
    pub episodes: BTreeMap<DreamId, Arc<DreamEpisode>>,
    /// Those that the reviewer knows.
    known: BTreeSet<DreamId>,
    /// What was asked for last.
    asked: Option<(DreamId, usize)>,
}

impl Reviewing {
    /// The dream that is looked at.
    pub(crate) fn episode(&self) -> Option<&DreamEpisode> {
        self.episodes.get(&self.dream?).map(Arc::as_ref)
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
            Panel::Dream => !self.dream.is_on && self.review.dream.is_some(),
            _ => false,
        }
    }
}

impl App {
    pub(super) fn act_on_review(&mut self, command: &Command) {
        match command {
            Command::Review(dream) => self.review(*dream),
            Command::ReviewNext(_) | Command::Scrub(_) | Command::PlayReview
                if self.state.panel == Panel::Record =>
            {
                self.move_in_episode(command);
            }
            Command::ReviewNext(by) => {
                let all = self.state.reviewable();
                let here = all.iter().position(|id| Some(*id) == self.state.review.dream);
                let next = here.map_or(all.len() as i32 - 1, |here| here as i32 + by);
                if let Some(id) = usize::try_from(next).ok().and_then(|next| all.get(next)) {
                    self.review(Some(*id));
                }
            }
            Command::Scrub(step) => self.state.review.head.stand_at(*step),
            Command::PlayReview => {
                let len = self.state.review.episode().map_or(0, DreamEpisode::len);
                self.state.review.head.toggle(len);
            }
            Command::DeleteDream(dream) => self.delete_dream(*dream),
            Command::BringBack(dream) => self.bring_back(*dream),
            Command::TryWeights(weights) => self.state.reward.tried = Some(weights.clone()),
            Command::Weigh(weights) => self.weigh(weights.clone()),
            _ => {}
        }
    }

    fn review(&mut self, dream: Option<DreamId>) {
        let review = &mut self.state.review;
        (review.dream, review.head) = (dream, Playhead::default());
        (review.view, review.judgement, review.asked, review.picture) = (None, None, None, None);
    }

    fn delete_dream(&mut self, dream: DreamId) {
        let Some(store) = &mut self.state.store else { return };
        match store.record(Event::DreamDropped { dream }) {
            Ok(()) => {
                if self.state.review.dream == Some(dream) {
                    self.review(None);
                }
                // Pairs that were about to be asked may show it.
                self.state.label.weighing = Weighing::default();
                self.next_query(None);
                let text = format!("dream {} is deleted, and nothing is asked about it", dream.0 + 1);
                self.offer(text, vec![("Bring it back".to_owned(), Command::BringBack(dream))]);
            }
            Err(e) => self.warn(e.to_string()),
        }
    }

    fn bring_back(&mut self, dream: DreamId) {
        if self.record(Event::DreamRestored { dream }) {
            self.done(format!("dream {} is back", dream.0 + 1));
        }
    }

    /// Lets answers weigh differently: their labels change, and the reward is learned anew.
    fn weigh(&mut self, weights: Weights) {
        self.state.reward.tried = None;
        if weights == self.state.weights() {
            return;
        }
        if !self.state.review.known.is_empty() {
            self.crew.send(Order::Reviewer(ReviewerCommand::Compare));
        }
        if !self.record(Event::WeightsChanged { weights }) {
            return;
        }
        let labeled = self.state.session().map(Session::labeled).unwrap_or_default();
        for labeled in &labeled {
            self.crew.send(Order::Trainer(TrainerCommand::Learn(labeled.query, labeled.label)));
        }
        self.crew.send(Order::Trainer(TrainerCommand::Relearn));
        self.state.reward.is_relearning = labeled.len() >= MIN_LABELS;
    }

    /// Has the step on the screen drawn, and moves on while a dream plays.
    pub(super) fn show_review(&mut self, ctx: &Context) {
        if !self.state.is_reviewing() {
            self.state.review.head.is_playing = false;
            return;
        }
        if self.state.review.dream.is_none() {
            let last = self.state.reviewable().pop();
            self.state.review.dream = last;
        }
        let review = &mut self.state.review;
        let Some((id, episode)) = review.dream.and_then(|id| Some((id, review.episodes.get(&id)?.clone())))
        else {
            return;
        };
        review.head.pass(f64::from(ctx.input(|input| input.stable_dt)).min(0.25), episode.len());
        let wanted = Some((id, review.step()));
        if review.asked == wanted {
            return;
        }
        review.asked = wanted;
        self.show_to_reviewer(id);
        let step = self.state.review.step();
        self.crew.send(Order::Reviewer(ReviewerCommand::Look { dream: id, step }));
    }

    /// Makes the reviewer know a dream, and the reward.
    pub(super) fn show_to_reviewer(&mut self, dream: DreamId) {
        if self.state.review.known.is_empty()
            && let Some(parameters) = self.state.reward.parameters.clone()
        {
            self.crew.send(Order::Reviewer(ReviewerCommand::Reward(parameters)));
        }
        if let Some(episode) = self.state.review.episodes.get(&dream).cloned()
            && self.state.review.known.insert(dream)
        {
            self.crew.send(Order::Reviewer(ReviewerCommand::AddDream(dream, episode)));
        }
    }

    /// Takes in what the reviewer has drawn.
    pub(super) fn hear_review(&mut self, ctx: &Context) {
        let review = &mut self.state.review;
        if let Some(view) = self.slots.review.take().filter(|view| Some(view.dream) == review.dream) {
            clip::put(ctx, &mut review.picture, &view.frame);
            review.view = Some(view);
        }
    }

    /// Tells the reviewer of a new reward, if there is one.
    pub(super) fn teach_reviewer(&mut self) {
        self.state.shelf.forget_reward();
        self.state.label.foretelling = Foretelling::default();
        if let Some(parameters) = self.state.reward.parameters.clone()
            && !self.state.review.known.is_empty()
        {
            self.crew.send(Order::Reviewer(ReviewerCommand::Reward(parameters)));
        }
    }

    /// Ends all work on the session at hand, and does not listen to what comes of it any more.
    pub(super) fn forget_workers(&mut self) {
        self.crew.forget();
        let is_of_the_session = |report: &Report| match report {
            Report::Clips { .. }
            | Report::Judged(_)
            | Report::JudgedEpisode { .. }
            | Report::Foretold { .. }
            | Report::Learning(_)
            | Report::Learned { .. }
            | Report::Drove { .. } => true,
            Report::Failed { worker, .. } => {
                ["clipper", "trainer", "driver", "reviewer", "screener", "synthesizer"].contains(worker)
            }
            _ => false,
        };
        let others = self.inbox.try_iter().filter(|report| !is_of_the_session(report));
        self.unheard.extend(others);
        self.slots.review.take();
        self.slots.drive.take();
        self.state.review = Reviewing::default();
        self.state.shelf.forget_reward();
    }

    /// Begins to read a world model; the window goes on meanwhile.
    pub(super) fn load_world(&mut self, ctx: &Context, path: PathBuf) {
        if self.state.dream.is_on {
            return self.warn("end the dream first: keep it, or leave it".to_owned());
        }
        self.state.world.loading = Some(path.clone());
        let (load, ctx) = (Arc::clone(&self.load), ctx.clone());
        let work = move || {
            let loaded = load(&path);
            // Slow for a large file, and kept.
            if let Ok(loaded) = &loaded {
                loaded.parameters.hash();
            }
            loaded
        };
        self.loading = Some(Job::begin("loader", move || ctx.request_repaint(), work));
    }

    pub(super) fn hear_loader(&mut self, ctx: &Context) {
        let Some(job) = &mut self.loading else { return };
        let is_over = job.is_over();
        let loaded = match job.poll() {
            Some(loaded) => loaded,
            None if is_over => Err("reading the world model failed: this is a bug of ours".to_owned()),
            None => return,
        };
        self.loading = None;
        self.state.world.loading = None;
        let is_first = self.state.world.loaded.is_none();
        let world = match loaded {
            Ok(world) => world,
            Err(sentence) => {
                if let Some((opened, goes_to)) = self.waiting.take() {
                    self.go_on_with(opened, goes_to);
                }
                if is_first {
                    self.state.panel = Panel::World;
                }
                return self.fail(sentence);
            }
        };
        let fit = self.state.world.fit.take();
        self.end_dream();
        self.forget_workers();
        self.crew.change_world(&world.parameters);
        let name = world.name.clone();
        self.state.world = World { fit, ..World::of(ctx, world, &mut self.state.dream) };
        (self.state.label, self.state.reward) = (self.state.label.anew(), Rewarding::default());
        self.state.unfinished.clear();
        // A session belongs to the model that it was dreamed with.
        let had_session = self.state.store.take().is_some();
        if let Some((opened, goes_to)) = self.waiting.take() {
            return self.go_on_with(opened, goes_to);
        }
        if had_session {
            self.note("a session belongs to its world model: the next dream begins a new one".to_owned());
        }
        if !is_first {
            self.done(format!("{name} is loaded"));
        }
    }
}

/// The weights with that of one justification moved, and of the others what must move with it.
pub(crate) fn with_justification(weights: &Weights, idx: usize, weight: f32) -> Weights {
    let mut named: Vec<(String, f32)> = weights.justifications.clone().into();
    let default = named.len() - 1;
    named[idx].1 = weight;
    if idx < default {
        named[..idx].iter_mut().for_each(|(_, above)| *above = above.max(weight));
        named[idx + 1..default].iter_mut().for_each(|(_, below)| *below = below.min(weight));
    }
    let justifications = crate::query::Justifications::new(named).unwrap_or(weights.justifications.clone());
    Weights { justifications, ..weights.clone() }
}

/// How many answers rest on a dream, in words; nothing where it can be deleted.
pub(crate) fn resting(state: &State, dream: DreamId) -> Option<String> {
    match state.session()?.n_resting_on(dream) {
        0 => None,
        n => Some(format!("{} rest on this dream: take them back first", counted(n, "answer"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::query::Justifications;

    #[test]
    fn moving_a_weight_keeps_the_order_of_severity() {
        let all = [("grass", 1.0), ("chuckhole", 0.9), ("car", 0.8), ("default", 0.75)];
        let weights = Weights { justifications: Justifications::new(all).unwrap(), ..Weights::car_racing() };
        let moved = |idx, weight| -> Vec<f32> {
            let moved = with_justification(&weights, idx, weight);
            moved.justifications.iter().map(|(.., weight)| weight).collect()
        };
        assert_eq!(moved(1, 0.6), [1.0, 0.6, 0.6, 0.75]);
        assert_eq!(moved(2, 1.0), [1.0, 1.0, 1.0, 0.75]);
        assert_eq!(moved(3, 1.0), [1.0, 0.9, 0.8, 1.0], "the default is no degree of severity");
    }
}
