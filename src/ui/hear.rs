//! What comes in between two pictures of the window: hands, reports, live pictures, and the clock of the clips.

use std::time::{Duration, Instant};

use eframe::egui::{Context, TextureHandle};

use crate::dream::DreamEpisode;
use crate::query::{QueryId, SEGMENT_LEN};
use crate::session::{DreamJournal, DreamSource, Fit};
use crate::tensor::Parameters;
use crate::ui::App;
use crate::ui::command::{Command, Field, Panel};
use crate::ui::crew::Order;
use crate::ui::input::PadEvent;
use crate::ui::labeling::Pair;
use crate::ui::pressing::pad_command;
use crate::ui::state::{Dreaming, LoadedWorld, World};
use crate::ui::widgets::clip;
use crate::worker::driver::GAVE_UP;
use crate::worker::{ClipperCommand, DriverCommand, Report, ScreenerCommand, TrainerCommand};
use crate::world_model::ModelIdentity;

/// How the report of a worker that has died begins.
const PANICKED: &str = "this is a bug of ours";
/// Frames for which a clip stands at its end before it begins again.
const REST: f64 = 5.0;
/// Pairs of clips that stay on the graphics card, so that undoing shows them at once.
const N_PAIRS: usize = 40;

impl World {
    /// The state for a world model that has just been loaded.
    pub(super) fn of(ctx: &Context, loaded: LoadedWorld, dream: &mut Dreaming) -> Self {
        let picture = |start: &crate::ui::DreamStart| -> Option<TextureHandle> {
            start.picture.as_ref().map(|frame| clip::texture(ctx, &start.name, frame))
        };
        dream.thumbnails = loaded.starts.iter().map(picture).collect();
        (dream.start_idx, dream.live, dream.picture) = (0, None, None);
        let hash = loaded.parameters.hash();
        let identity = ModelIdentity::of(&loaded.parameters).ok();
        Self { loaded: Some(loaded), hash, identity, ..Self::default() }
    }
}

impl App {
    pub(super) fn hear_hands(&mut self, ctx: &Context) {
        let mut commands = Vec::new();
        let is_covered = self.state.is_covered() || ctx.text_edit_focused();
        for event in self.input.poll() {
            match event {
                PadEvent::Connected(name) => {
                    self.note(format!("{name} is plugged in"));
                    if !self.state.pads.contains(&name) {
                        self.state.pads.push(name);
                    }
                }
                PadEvent::Disconnected(name) => {
                    self.hands.release();
                    self.state.pads.retain(|pad| *pad != name);
                    let text =
                        format!("{name} was unplugged: everything on it is let go, and the keys still drive");
                    self.warn(text);
                }
                PadEvent::Moved(pad) => self.hands.hold(pad),
                PadEvent::Pressed(button) => match self.state.rebinding_pad {
                    Some(deed) => commands.push(Command::BindPad(deed, button)),
                    None if is_covered => {}
                    None => commands.extend(pad_command(&self.state, button)),
                },
            }
        }
        let is_driving = self.state.is_driving() && !is_covered;
        if !commands.is_empty() || ctx.input(|input| !input.events.is_empty()) {
            self.state.label.pace.touch(self.state.now);
        }
        let keys = &self.state.keys;
        ctx.input(|input| {
            self.hands.hear(&input.events, keys, input.focused, is_driving);
            self.hands.be_careful(input.modifiers.shift);
        });
        self.state.pad_held = self.hands.pad();
        if self.state.is_driving() {
            let held = self.hands.action(&self.state.controls);
            let action = if is_driving { held } else { crate::env::Action::default() };
            self.state.dream.action = action;
            self.slots.action.put((action, Instant::now()));
        }
        for command in commands {
            self.act(ctx, command);
        }
    }

    pub(super) fn hear_reports(&mut self, ctx: &Context) {
        for report in std::mem::take(&mut self.unheard) {
            self.hear(ctx, report);
        }
        while let Ok(report) = self.inbox.try_recv() {
            self.hear(ctx, report);
        }
    }

    fn hear(&mut self, ctx: &Context, report: Report) {
        match report {
            Report::Dreamt { episode, journal } => self.dreamt(episode, journal),
            // Drawn for the session before this one: nobody asks for them any more.
            Report::Clips { query, .. }
                if self.state.session().and_then(|s| s.query(query.id)).is_none_or(|a| a.query != query) => {}
            Report::Clips { query, left, right } => {
                let put = |frames: &[crate::env::Frame]| {
                    frames.iter().map(|frame| clip::texture(ctx, "clip", frame)).collect()
                };
                let (left, right) = (put(&left), put(&right));
                self.state.label.asked.retain(|asked| *asked != query.id);
                self.keep_thumbnail(query.id, &left, &right);
                self.state.label.pairs.insert(query.id, Pair { left, right });
                self.forget_far_pairs();
            }
            Report::Glance { query, frames } => self.glanced(ctx, query, &frames),
            Report::Foretold { query, clips } => self.foretold(query, clips),
            Report::Signs { dream, seed, signs } => self.signs_found(dream, seed, &signs),
            Report::Synthesizing { seed, done, n } => self.synthesizing(seed, done, n),
            Report::Synthesized { episode, acquisition } => self.synthesized(episode, acquisition),
            Report::Weighed { pairs, disagreements } => self.weighed(pairs, disagreements.as_deref()),
            Report::Judged(judgement) => self.state.review.judgement = Some(judgement),
            Report::Learning(learning) => self.state.reward.hear(learning),
            Report::Learned { parameters, n_labels, fit } => self.learned(parameters, n_labels, fit),
            Report::Drove { seed, metrics } => {
                self.state.deploy.is_on = false;
                self.state.deploy.episodes.push((seed, metrics));
                self.next_track(Field::DeploySeed);
            }
            Report::Recorded { episode, n_steps } => {
                (self.state.record.is_on, self.state.record.is_ending) = (false, false);
                self.state.record.n_kept += 1;
                self.next_track(Field::RecordSeed);
                self.list_recordings();
                self.done(format!("episode {episode} is on disk: {n_steps} steps"));
            }
            Report::Unfinished(n) => self.offer_recordings(n),
            Report::Modeling(progress) => {
                let now = self.state.now;
                self.state.world.fit.get_or_insert_default().hear(progress, now);
            }
            Report::Modeled(path) => {
                self.state.world.fit = None;
                self.state.world.fitted = Some(path.clone());
                let text = "the new world model is on disk".to_owned();
                self.offer(text, vec![("Use it".to_owned(), Command::LoadWorld(path))]);
            }
            Report::Shelf(_) | Report::Opened(_) | Report::JudgedEpisode { .. } => {
                self.hear_librarian(report);
            }
            Report::LeftOut(why) => self.warn(why),
            Report::Failed { worker, message } => self.worker_failed(worker, &message),
        }
    }

    /// Another track each time, unless somebody writes which.
    fn next_track(&mut self, field: Field) {
        if let Ok(seed) = self.state.field(field).trim().parse::<u64>() {
            self.state.fields.insert(field, seed.wrapping_add(1).to_string());
        }
    }

    fn dreamt(&mut self, episode: DreamEpisode, journal: Option<DreamJournal>) {
        // One that was kept and followed by another at once arrives after that has begun.
        if episode.seed == self.state.dream.seed {
            (self.state.dream.is_on, self.state.dream.is_ending) = (false, false);
        }
        if !episode.is_usable() {
            let n = episode.len();
            self.warn(format!("the dream had {n} steps and was not kept: a segment needs {SEGMENT_LEN}"));
            journal.map(DreamJournal::discard);
            return;
        }
        self.keep_dream(episode, journal);
    }

    pub(super) fn keep_dream(&mut self, episode: DreamEpisode, journal: Option<DreamJournal>) {
        let Some(store) = &mut self.state.store else {
            self.fail("the dream could not be kept, for there is no session to keep it in".to_owned());
            return;
        };
        match store.save_dream(&episode, DreamSource::User) {
            Ok(id) => {
                let n = episode.len();
                self.teach_dream(id, episode);
                self.done(format!("dream {} is kept: {n} steps", id.0 + 1));
                if let Some(Err(e)) = journal.map(DreamJournal::discard) {
                    log::warn!("{e}");
                }
            }
            Err(e) => {
                self.state.dream.unsaved = Some((episode, journal));
                let text = format!("the dream is not lost but could not be kept yet: {e}");
                self.fail_with(text, vec![("Try again".to_owned(), Command::RecoverDreams)]);
            }
        }
    }

    fn learned(&mut self, parameters: Parameters, n_labels: usize, fit: Option<(u64, Vec<f32>)>) {
        self.crew.send(Order::Driver(DriverCommand::Reward(parameters.clone())));
        let reward = &mut self.state.reward;
        reward.n_learned = n_labels;
        reward.parameters = Some(parameters.clone());
        reward.is_relearning = false;
        self.teach_reviewer();
        let reward = &mut self.state.reward;
        let Some((seed, losses)) = fit else { return };
        reward.is_fitting = false;
        let latest = reward.latest.as_ref();
        let (epochs, held_out) = latest.map_or((0, None), |latest| (latest.epoch, latest.held_out_loss));
        let asked = reward.asked.iter().position(|(asked, _)| *asked == seed);
        let (Some(asked), Some(store)) = (asked, &mut self.state.store) else { return };
        // Those asked for before were overtaken by this one.
        let after = reward.asked.drain(..=asked).next_back().map_or(0, |(_, after)| after);
        let fit = Fit { after, n_labels, seed, epochs: epochs as u32, losses, held_out };
        match store.save_reward(&parameters, fit) {
            Ok(()) => self.done(format!("the reward is fitted to {n_labels} answers and saved")),
            Err(e) => self.fail(e.to_string()),
        }
    }

    fn worker_failed(&mut self, worker: &'static str, message: &str) {
        let has_died = message.starts_with(PANICKED);
        match worker {
            "dreamer" if has_died => (self.state.dream.is_on, self.state.dream.is_ending) = (false, false),
            "driver" if has_died || message.starts_with(GAVE_UP) => self.state.deploy.is_on = false,
            "trainer" => (self.state.reward.is_fitting, self.state.reward.is_relearning) = (false, false),
            "synthesizer" if !has_died => return self.not_made(message.to_owned()),
            "synthesizer" => self.make_trajectories(false),
            "librarian" => self.librarian_failed(),
            "recorder" => (self.state.record.is_on, self.state.record.is_ending) = (false, false),
            "modeler" => {
                self.state.world.fit = None;
                let way = vec![("Go on".to_owned(), Command::FitWorld { resume: true })];
                if message.starts_with("stopped") {
                    self.offer(
                        "the fit is stopped and goes on from its last checkpoint when you like".to_owned(),
                        way,
                    );
                } else {
                    self.fail_with(message.to_owned(), way);
                }
                return;
            }
            _ => {}
        }
        let way = vec![("Restart".to_owned(), Command::Restart)];
        self.fail_with(message.to_owned(), if has_died { way } else { Vec::new() });
    }

    pub(super) fn hear_slots(&mut self, ctx: &Context) {
        if let Some(view) = self.slots.dream.take().filter(|_| self.state.dream.is_on) {
            clip::put(ctx, &mut self.state.dream.picture, &view.frame);
            self.state.dream.live = Some(view);
        }
        if let Some(view) = self.slots.record.take().filter(|_| self.state.record.is_on) {
            match &view.picture {
                Some((width, height, rgb)) => {
                    clip::put_picture(ctx, &mut self.state.record.picture, (*width, *height, rgb));
                }
                None => clip::put(ctx, &mut self.state.record.picture, &view.frame),
            }
            self.state.record.live = Some(view);
        }
        self.hear_review(ctx);
        self.hear_shelf(ctx);
        self.hear_beside(ctx);
        if let Some(view) = self.slots.drive.take() {
            let deploy = &mut self.state.deploy;
            let (width, height, rgb) = &view.picture;
            clip::put_picture(ctx, &mut deploy.picture, (*width, *height, rgb));
            let is_new = deploy
                .view
                .as_ref()
                .is_none_or(|old| !std::sync::Arc::ptr_eq(&old.candidates, &view.candidates));
            if is_new {
                let last = |candidate: &crate::worker::CandidateView| {
                    candidate.frames.last().map(|frame| clip::texture(ctx, "candidate", frame))
                };
                deploy.candidates = view.candidates.iter().map(last).collect();
            }
            deploy.view = Some(view);
        }
    }

    /// Keeps the next clips ready, and moves those on the screen.
    pub(super) fn show_clips(&mut self, ctx: &Context) {
        if self.state.panel != Panel::Label {
            self.state.label.shown = None;
            return;
        }
        self.ask();
        let current = self.state.current().map(|query| query.id);
        let now = self.state.now;
        let label = &mut self.state.label;
        let ready = current.filter(|id| label.pairs.contains_key(id));
        if label.shown.map(|(id, _)| id) != ready {
            label.shown = ready.map(|id| (id, now));
            (label.loops, label.is_standing) = (0, false);
            label.pace.begin(now);
            self.state.label.playhead = self.state.span().start;
        }
        if let Some(query) = self.state.reconsidered() {
            self.foretell(query);
        }
        let span = self.state.span();
        let label = &mut self.state.label;
        if ready.is_some() {
            label.pace.pass(now, ctx.input(|input| input.focused));
        }
        if ready.is_some() && !label.is_standing && !label.pace.is_away(now) {
            let dt = f64::from(ctx.input(|input| input.stable_dt)).min(0.25);
            label.playhead += dt * label.speed;
            let end = span.end + REST;
            if label.playhead >= end {
                label.playhead = span.start + (label.playhead - end) % (end - span.start);
                label.loops += 1;
            }
        }
    }

    fn forget_far_pairs(&mut self) {
        let wanted: Vec<QueryId> = self.state.upcoming().iter().take(8).map(|query| query.id).collect();
        let pairs = &mut self.state.label.pairs;
        while pairs.len() > N_PAIRS {
            let Some(far) = pairs.keys().find(|id| !wanted.contains(id)).copied() else { break };
            pairs.remove(&far);
        }
    }

    pub(super) fn schedule(&self, ctx: &Context) {
        let state = &self.state;
        if state.is_driving() {
            ctx.request_repaint_after(self.pace.max(Duration::from_millis(16)));
        }
        let is_away = state.label.pace.is_away(state.now);
        if state.panel == Panel::Label && state.label.shown.is_some() && !state.label.is_standing && !is_away
        {
            ctx.request_repaint_after(self.pace.max(Duration::from_secs_f64(0.5 / state.label.speed)));
        }
        if state.review.head.is_playing || state.shelf.head.is_playing {
            ctx.request_repaint_after(self.pace.max(Duration::from_millis(20)));
        }
        // Pads are read between two pictures, so there must be some; in software a picture costs too much for many.
        if !state.pads.is_empty() {
            ctx.request_repaint_after(6 * self.pace);
        }
        if state.is_opening() {
            ctx.request_repaint_after(self.pace.max(Duration::from_millis(100)));
        }
        let until = state.toasts.iter().filter_map(|toast| toast.until).reduce(f64::min);
        if let Some(until) = until {
            ctx.request_repaint_after(Duration::from_secs_f64((until - state.now).max(0.05)));
        }
    }

    /// Tells the workers of a dream.
    pub(super) fn teach_dream(&mut self, id: crate::query::DreamId, episode: DreamEpisode) {
        let episode = std::sync::Arc::new(episode);
        self.state.review.episodes.insert(id, episode.clone());
        self.crew.send(Order::Clipper(ClipperCommand::AddDream(id, episode.clone())));
        self.crew.send(Order::Screener(ScreenerCommand::AddDream(id, episode.clone())));
        self.crew.send(Order::Trainer(TrainerCommand::AddDream(id, episode)));
    }
}
