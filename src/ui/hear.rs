//! What comes in between two pictures of the window: hands, reports, live pictures, and the clock of the clips.

use std::time::{Duration, Instant};

use eframe::egui::{Context, Event, TextureHandle};

use crate::dream::DreamEpisode;
use crate::env::controls::Pad;
use crate::query::{QueryId, SEGMENT_LEN};
use crate::session::{DreamJournal, DreamSource, Fit};
use crate::tensor::Parameters;
use crate::ui::App;
use crate::ui::command::{Command, Field, Panel};
use crate::ui::crew::Order;
use crate::ui::input::PadEvent;
use crate::ui::labeling::Pair;
use crate::ui::pressing::pad_command;
use crate::ui::seen::{Picture, Shown};
use crate::ui::state::{Dreaming, LoadedWorld, World};
use crate::ui::widgets::clip;
use crate::worker::driver::GAVE_UP;
use crate::worker::{ClipperCommand, DriverCommand, Report, ScreenerCommand, TrainerCommand};
use crate::world_model::ModelIdentity;

/// Whether the window has the focus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Focus {
    /// It never had: it has just opened, or nothing gives a focus here, as without a window manager.
    #[default]
    Unknown,
    /// It has.
    Here,
    /// It had.
    Left,
}

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
    /// Takes in what keys and pads did since the last picture.
    ///
    /// Without the focus nothing is heard but what is plugged in and out: hands are elsewhere.
    pub(super) fn hear_hands(&mut self, ctx: &Context) {
        let is_new = self.hear_picture(ctx);
        self.hear_focus(ctx, is_new);
        let is_writing = ctx.text_edit_focused();
        let mut is_touched = ctx.input(|input| !input.events.is_empty());
        for event in self.input.poll() {
            is_touched |= self.hear_pad(ctx, event, is_writing);
        }
        let is_left = self.focus == Focus::Left;
        if is_touched && !is_left {
            self.state.label.pace.touch(self.state.now);
        }
        let is_driving = self.state.is_driving() && !self.state.is_covered() && !is_writing && !is_left;
        let (keys, picture) = (&self.state.keys, self.state.picture);
        ctx.input_mut(|input| {
            // Where nothing is drawn, the events are those of the last picture still.
            if is_new {
                self.hands.hear(&input.events, keys, input.focused, is_driving);
                self.hands.be_careful(input.modifiers.shift);
                self.state.heard = self.typing.one_by_one(&mut input.events, picture, is_writing);
            }
        });
        if self.typing.is_waiting() {
            ctx.request_repaint();
        }
        self.state.pad_held = self.hands.pad();
        if self.state.is_driving() {
            let held = self.hands.action(&self.state.controls);
            let action = if is_driving { held } else { crate::env::Action::default() };
            self.state.dream.action = action;
            self.slots.action.put((action, Instant::now()));
        }
    }

    /// Takes note of the picture that is laid out now, and says whether there is one.
    fn hear_picture(&mut self, ctx: &Context) -> bool {
        let picture = Picture { nr: ctx.cumulative_frame_nr(), at: ctx.input(|input| input.time) };
        let is_new = picture.at > self.state.picture.at;
        self.state.now = picture.at;
        (self.state.picture, self.state.heard) = (picture, picture);
        is_new
    }

    /// Pauses what a hand drives where the window loses the focus, or is no longer to be seen.
    ///
    /// A drive by plan goes on: nobody's hands are needed there.
    fn hear_focus(&mut self, ctx: &Context, is_new: bool) {
        let (has_focus, had_lost) = ctx.input(|input| {
            let is_seen = input.viewport().visible() != Some(false);
            let lost = input.events.iter().any(|event| matches!(event, Event::WindowFocused(false)));
            (input.raw.focused && is_seen, lost && is_new)
        });
        let is_leaving = had_lost || self.focus == Focus::Here && !has_focus;
        match (has_focus, is_leaving) {
            (true, _) => self.focus = Focus::Here,
            (false, true) => self.focus = Focus::Left,
            (false, false) => {}
        }
        if is_leaving {
            self.pause_driving(Some("Paused, for the window lost the focus"));
        }
    }

    /// Takes in what a pad did, and says whether somebody did it.
    fn hear_pad(&mut self, ctx: &Context, event: PadEvent, is_writing: bool) -> bool {
        match event {
            PadEvent::Connected(name) => {
                self.note(format!("{name} is plugged in"));
                if !self.state.pads.contains(&name) {
                    self.state.pads.push(name);
                }
                false
            }
            PadEvent::Took(name) => {
                if self.state.pad_in_use.replace(name.clone()).is_some_and(|former| former != name) {
                    self.note(format!("{name} has the wheel now"));
                }
                true
            }
            PadEvent::Disconnected(name) => {
                self.unplugged(&name);
                false
            }
            PadEvent::Moved(pad) => {
                self.hands.hold(pad);
                false
            }
            PadEvent::Pressed(_) if self.focus == Focus::Left => false,
            PadEvent::Pressed(button) => {
                let command = match self.state.rebinding_pad {
                    Some(deed) => Some(Command::BindPad(deed, button)),
                    None if self.state.is_covered() || is_writing => None,
                    None => pad_command(&self.state, button),
                };
                if let Some(command) = command {
                    self.act(ctx, command);
                }
                true
            }
        }
    }

    fn unplugged(&mut self, name: &str) {
        self.state.pads.retain(|pad| pad != name);
        let other = self.state.pad_in_use.take_if(|in_use| in_use != name);
        if let Some(other) = other {
            self.note(format!("{name} was unplugged, and {other} has the wheel still"));
            self.state.pad_in_use = Some(other);
            return;
        }
        self.state.pad_in_use = None;
        self.hands.hold(Pad::default());
        self.warn(format!("{name} was unplugged: everything on it is let go, and the keys still drive"));
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
                self.state.record.is_held = false;
                self.state.record.n_kept += 1;
                self.next_track(Field::RecordSeed);
                self.list_recordings();
                self.done(format!("episode {episode} is on disk: {n_steps} steps"));
            }
            Report::Held(why) => self.recording_held(&why),
            Report::Moved(dataset) => self.recording_moved(&dataset),
            Report::Unjournaled(why) => {
                let text = "the dream goes on, but is lost if the program ends before it is kept";
                self.not_saved(text, &why);
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
            self.state.dream.unsaved.push((episode, journal));
            let why = "there is no session to keep it in";
            return self.not_saved("the dream is not lost but could not be kept yet", why);
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
                self.state.dream.unsaved.push((episode, journal));
                self.not_saved("the dream is not lost but could not be kept yet", &e.to_string());
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
        self.teach_planner();
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
        match store.save_reward(&parameters, fit.clone()) {
            Ok(()) => self.done(format!("the reward is fitted to {n_labels} answers and saved")),
            Err(e) => {
                self.state.reward.unsaved = Some((parameters, fit));
                self.not_saved("the reward is not lost but is not saved yet", &e.to_string());
            }
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
            "recorder" => {
                (self.state.record.is_on, self.state.record.is_ending) = (false, false);
                self.state.record.is_held = false;
            }
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
        if label.shown.map(|shown| shown.query) != ready {
            label.shown = ready.map(Shown::new);
            (label.loops, label.is_standing) = (0, false);
            label.pace.begin(now);
            self.state.label.playhead = self.state.span().start;
        }
        if let Some(query) = self.state.reconsidered() {
            self.foretell(query);
        }
        let has_focus = ctx.input(|input| input.focused) && !self.state.is_covered();
        let span = self.state.span();
        let label = &mut self.state.label;
        if ready.is_some() {
            label.pace.pass(now, has_focus);
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
        let shown = state.label.shown.filter(|_| state.panel == Panel::Label);
        if shown.is_some_and(|shown| shown.is_becoming_seen(state.picture)) {
            ctx.request_repaint_after(self.pace);
        }
        if shown.is_some() && !state.label.is_standing && !is_away {
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
