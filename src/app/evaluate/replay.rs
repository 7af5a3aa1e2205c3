//! Episodes that the planner drove in this window, looked at again.
//!
//! Nothing but the seed and the actions is kept of them: a built-in world is driven again by these, and comes out the same.
//! A world in a process is not, for it may be a machine, which would move.

use std::ops::Range;
use std::sync::Arc;

use crate::app::{App, Panel, Picture, PlaybackCommand, Playhead, State};
use crate::evaluation::EpisodeMetrics;
use crate::worker::{EvaluateReport, ReplayView, ReplayerCommand, WorkerCommand};
use crate::world::{Action, SourceKind};

/// An episode that the planner drove in this window.
#[derive(Clone, Debug)]
pub(crate) struct DrivenHere {
    /// Of the track.
    pub seed: u64,
    pub metrics: EpisodeMetrics,
    /// What the planner asked for at each step.
    pub actions: Arc<[Action]>,
    /// How many answers the reward knew.
    pub n_answers: usize,
    /// The results that it is among.
    pub results: u64,
}

/// An episode that is looked at again.
#[derive(Debug)]
pub(crate) struct Replay {
    /// Its number among those of this window.
    pub driven: usize,
    /// What it is called by the replayer.
    id: u64,
    pub head: Playhead,
    pub picture: Option<Picture>,
    /// How many steps are driven so far.
    pub done: usize,
    /// Once all are: the steps in which something went on that must not happen, and whether it came out the same.
    pub over: Option<(Vec<Range<usize>>, bool)>,
    /// The step that was asked for last.
    asked: Option<usize>,
}

impl State {
    /// The episode that is looked at again, and what was kept of it.
    pub(crate) fn replayed(&self) -> Option<(&Replay, &DrivenHere)> {
        let replay = self.evaluate.replay.as_ref()?;
        Some((replay, self.evaluate.driven.get(replay.driven)?))
    }

    /// The step of it that is looked at.
    pub(crate) fn replay_step(&self) -> usize {
        self.replayed().map_or(0, |(replay, driven)| replay.head.step(driven.actions.len()))
    }

    /// Whether it is shown, and plays.
    pub(crate) fn is_replaying(&self) -> bool {
        self.panel == Panel::Evaluate && self.evaluate.replay.as_ref().is_some_and(|it| it.head.is_playing)
    }

    /// Whether the episode that is looked at came out as it was measured, once it is driven again: for tests.
    pub fn came_out_the_same(&self) -> Option<bool> {
        self.evaluate.replay.as_ref()?.over.as_ref().map(|(_, is_same)| *is_same)
    }

    /// Whether what was driven here can be driven again.
    pub(crate) fn can_replay(&self) -> bool {
        self.spec.source.kind == SourceKind::BuiltIn
    }
}

impl App {
    pub(super) fn watch_driven(&mut self, which: Option<usize>) {
        if self.state.evaluate.replay.take().is_some() {
            self.send(WorkerCommand::Replayer(ReplayerCommand::Close));
        }
        let Some(driven) = which.and_then(|i| self.state.evaluate.driven.get(i)).cloned() else { return };
        if !self.state.can_replay() {
            return self
                .warn("only a built-in world is driven again: another might move something".to_owned());
        }
        let evaluate = &mut self.state.evaluate;
        let id = evaluate.next;
        evaluate.next += 1;
        evaluate.replay = Some(Replay {
            driven: which.unwrap_or_default(),
            id,
            head: Playhead::default(),
            picture: None,
            done: 0,
            over: None,
            asked: Some(0),
        });
        let DrivenHere { seed, actions, .. } = driven;
        self.send(WorkerCommand::Replayer(ReplayerCommand::Drive { replay: id, seed, actions }));
    }

    /// Stands at a step, plays, or goes to another episode.
    pub(in crate::app) fn play_replay(&mut self, command: &PlaybackCommand) {
        let evaluate = &mut self.state.evaluate;
        let Some(replay) = &mut evaluate.replay else { return };
        let len = evaluate.driven.get(replay.driven).map_or(0, |driven| driven.actions.len());
        match command {
            PlaybackCommand::Scrub(step) => replay.head.stand_at(*step),
            PlaybackCommand::Play => replay.head.toggle(len),
            PlaybackCommand::Next(by) => {
                let next = replay.driven.checked_add_signed(*by as isize);
                if let Some(next) = next.filter(|next| *next < evaluate.driven.len()) {
                    self.watch_driven(Some(next));
                }
            }
        }
    }

    pub(in crate::app) fn evaluate_report(&mut self, report: EvaluateReport) {
        let evaluate = &mut self.state.evaluate;
        let Some(replay) = &mut evaluate.replay else { return };
        match report {
            EvaluateReport::Replaying { replay: id, done } if id == replay.id => replay.done = done,
            EvaluateReport::Replayed { replay: id, metrics, unsafe_steps } if id == replay.id => {
                replay.done = metrics.n_steps;
                let measured = evaluate.driven.get(replay.driven).map(|driven| &driven.metrics);
                let is_same = measured.is_some_and(|it| EvaluateReport::is_same(&metrics, it));
                replay.over = Some((unsafe_steps, is_same));
            }
            EvaluateReport::View(ReplayView { replay: id, frame, .. }) if id == replay.id => {
                replay.picture = Some(Picture::from(&frame));
            }
            // Of one that is not looked at any more.
            EvaluateReport::Replaying { .. } | EvaluateReport::Replayed { .. } | EvaluateReport::View(_) => {}
        }
    }

    /// The replayer met an error: nothing is looked at any more.
    pub(in crate::app) fn replayer_failed(&mut self) {
        self.state.evaluate.replay = None;
    }

    /// Has the step on the screen shown, and moves on while an episode plays.
    pub(in crate::app) fn advance_replay(&mut self, dt: f64) {
        let is_shown = self.state.panel == Panel::Evaluate;
        let rate = self.state.spec.rate;
        let evaluate = &mut self.state.evaluate;
        let Some(replay) = &mut evaluate.replay else { return };
        if !is_shown {
            replay.head.is_playing = false;
            return;
        }
        let len = evaluate.driven.get(replay.driven).map_or(0, |driven| driven.actions.len());
        replay.head.pass(dt.min(0.25), rate, len);
        let step = replay.head.step(len);
        if replay.asked.replace(step) != Some(step) {
            self.send(WorkerCommand::Replayer(ReplayerCommand::Show(step)));
        }
    }
}
