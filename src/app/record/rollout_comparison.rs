//! A dream beside the real world, and who has the controls.

use crate::app::{App, Panel, Picture, State};
use crate::worker::{DreamerCommand, RecorderCommand, RolloutComparison, RolloutView, WorkerCommand};

/// Points of the drift curve that are kept: a whole episode and more.
const MOST: usize = 2000;

/// What is shown beside the real world.
#[derive(Debug, Default)]
pub(crate) struct Rollout {
    /// How it was asked for, if it was.
    pub asked: Option<RolloutComparison>,
    pub view: Option<RolloutView>,
    pub picture: Option<Picture>,
    /// Drift by step.
    pub drift: Vec<[f64; 2]>,
}

impl Rollout {
    /// Takes in what is dreamt now; another episode begins another curve.
    fn receive(&mut self, view: RolloutView) {
        let x = view.step as f64;
        if self.drift.last().is_some_and(|last| last[0] >= x) || self.drift.len() >= MOST {
            self.drift.clear();
        }
        self.drift.push([x, f64::from(view.drift)]);
        self.view = Some(view);
    }
}

impl App {
    pub(super) fn toggle_rollout(&mut self) {
        let rollout = &mut self.state.record.rollout;
        rollout.asked = if rollout.asked.is_some() { None } else { Some(RolloutComparison::default()) };
        self.send_rollout();
    }

    pub(super) fn reset_rollout(&mut self, reset: Option<usize>) {
        self.state.record.rollout.asked = Some(RolloutComparison { reset });
        self.send_rollout();
    }

    /// Tells the recorder what is to be dreamt beside the real world.
    fn send_rollout(&mut self) {
        let asked = self.state.record.rollout.asked;
        (self.state.record.rollout.view, self.state.record.rollout.picture) = (None, None);
        self.state.record.rollout.drift.clear();
        if asked.is_some() {
            let Some(world) = &self.state.world.loaded else {
                self.state.record.rollout.asked = None;
                return self.warn("a dream beside the real world needs a world model".to_owned());
            };
            self.send(WorkerCommand::Recorder(RecorderCommand::Model(world.parameters.clone())));
        }
        self.send(WorkerCommand::Recorder(RecorderCommand::CompareRollout(asked)));
    }

    /// Gives the controls to the planner or takes it back, wherever somebody drives.
    pub(in crate::app) fn hand_over(&mut self) {
        if !self.state.is_driving() {
            return;
        }
        let is_dream = self.state.panel == Panel::Dream;
        let live = if is_dream { &self.state.dream.live } else { &self.state.record.live };
        if live.as_ref().is_some_and(|live| live.is_planned) {
            return self.send(if is_dream {
                WorkerCommand::Dreamer(DreamerCommand::HandOver(false))
            } else {
                WorkerCommand::Recorder(RecorderCommand::HandOver(false))
            });
        }
        let Some(reward) = self.state.reward.parameters.clone() else {
            return self
                .warn(format!("the planner needs a reward before it can act: {}", way_to_one(&self.state)));
        };
        if is_dream {
            self.state.dream.is_shared = true;
            self.send(WorkerCommand::Dreamer(DreamerCommand::Reward(reward)));
            return self.send(WorkerCommand::Dreamer(DreamerCommand::HandOver(true)));
        }
        let Some(world) = &self.state.world.loaded else {
            return self.warn("the planner needs a world model before it can act: load one".to_owned());
        };
        self.state.record.is_shared = true;
        self.send(WorkerCommand::Recorder(RecorderCommand::Model(world.parameters.clone())));
        self.send(WorkerCommand::Recorder(RecorderCommand::Reward(reward)));
        self.send(WorkerCommand::Recorder(RecorderCommand::HandOver(true)));
    }

    /// Lets a planner that has the controls know the reward that was learned meanwhile.
    pub(in crate::app) fn tell_planner(&mut self) {
        let Some(reward) = self.state.reward.parameters.clone() else { return };
        if self.state.dream.is_on && self.state.dream.is_shared {
            self.send(WorkerCommand::Dreamer(DreamerCommand::Reward(reward.clone())));
        }
        if self.state.record.is_on && self.state.record.is_shared {
            self.send(WorkerCommand::Recorder(RecorderCommand::Reward(reward.clone())));
        }
    }

    pub(super) fn rollout_seen(&mut self, view: RolloutView) {
        if self.state.record.is_on && self.state.record.rollout.asked.is_some() {
            self.remember_beside(&view);
            let record = &mut self.state.record;
            record.rollout.picture = Some(Picture::from(&view.frame));
            record.rollout.receive(view);
        }
    }
}

/// What brings a reward, where there is none yet.
fn way_to_one(state: &State) -> &'static str {
    if state.protocol().is_sparse() {
        "judge some transitions, then fit it in Reward"
    } else {
        "answer some queries"
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::Frame;

    #[test]
    fn another_episode_begins_another_curve() {
        let mut rollout = Rollout::default();
        for step in [1, 2, 5, 1, 2] {
            let frame = Frame::square(1, vec![0; 3]);
            rollout.receive(RolloutView { frame, step, since: step, drift: 0.5 });
        }
        assert_eq!(rollout.drift, [[1.0, 0.5], [2.0, 0.5]]);
    }
}
