//! A dream beside the real car, and who has the wheel.

use eframe::egui::{Context, TextureHandle};

use crate::ui::App;
use crate::ui::command::{Command, Panel};
use crate::ui::crew::Order;
use crate::ui::state::State;
use crate::ui::widgets::clip;
use crate::worker::{Beside, BesideView, DreamerCommand, RecorderCommand};

/// Points of the drift curve that are kept: a whole episode and more.
const MOST: usize = 2000;

/// What is shown beside the real car.
#[derive(Default)]
pub(crate) struct Besides {
    /// How it was asked for, if it was.
    pub asked: Option<Beside>,
    pub view: Option<BesideView>,
    pub picture: Option<TextureHandle>,
    /// Drift by step.
    pub drift: Vec<[f64; 2]>,
}

impl Besides {
    /// Takes in what is dreamt now; another episode begins another curve.
    fn hear(&mut self, view: BesideView) {
        let x = view.step as f64;
        if self.drift.last().is_some_and(|last| last[0] >= x) || self.drift.len() >= MOST {
            self.drift.clear();
        }
        self.drift.push([x, f64::from(view.drift)]);
        self.view = Some(view);
    }
}

impl App {
    pub(super) fn act_on_beside(&mut self, command: &Command) {
        let besides = &mut self.state.record.besides;
        match command {
            Command::ToggleBeside => {
                besides.asked = if besides.asked.is_some() { None } else { Some(Beside::default()) };
            }
            Command::ResetBeside(reset) => besides.asked = Some(Beside { reset: *reset }),
            _ => {}
        }
        self.send_beside();
    }

    /// Tells the recorder what is to be dreamt beside the real car.
    fn send_beside(&mut self) {
        let asked = self.state.record.besides.asked;
        (self.state.record.besides.view, self.state.record.besides.picture) = (None, None);
        self.state.record.besides.drift.clear();
        if asked.is_some() {
            let Some(world) = &self.state.world.loaded else {
                self.state.record.besides.asked = None;
                return self.warn("a dream beside the real car needs a world model".to_owned());
            };
            self.crew.send(Order::Recorder(RecorderCommand::Model(world.parameters.clone())));
        }
        self.crew.send(Order::Recorder(RecorderCommand::Beside(asked)));
    }

    /// Gives the wheel to the planner or takes it back, wherever somebody drives.
    pub(super) fn hand_over(&mut self) {
        if !self.state.is_driving() {
            return;
        }
        let is_dream = self.state.panel == Panel::Dream;
        let live = if is_dream { &self.state.dream.live } else { &self.state.record.live };
        if live.as_ref().is_some_and(|live| live.is_planned) {
            return self.crew.send(if is_dream {
                Order::Dreamer(DreamerCommand::HandOver(false))
            } else {
                Order::Recorder(RecorderCommand::HandOver(false))
            });
        }
        let Some(reward) = self.state.reward.parameters.clone() else {
            return self.warn(format!(
                "the planner needs a reward before it can drive: {}",
                way_to_one(&self.state)
            ));
        };
        if is_dream {
            self.state.dream.is_shared = true;
            self.crew.send(Order::Dreamer(DreamerCommand::Reward(reward)));
            return self.crew.send(Order::Dreamer(DreamerCommand::HandOver(true)));
        }
        let Some(world) = &self.state.world.loaded else {
            return self.warn("the planner needs a world model before it can drive: load one".to_owned());
        };
        self.state.record.is_shared = true;
        self.crew.send(Order::Recorder(RecorderCommand::Model(world.parameters.clone())));
        self.crew.send(Order::Recorder(RecorderCommand::Reward(reward)));
        self.crew.send(Order::Recorder(RecorderCommand::HandOver(true)));
    }

    /// Lets a planner that has the wheel know the reward that was learned meanwhile.
    pub(super) fn teach_planner(&mut self) {
        let Some(reward) = &self.state.reward.parameters else { return };
        if self.state.dream.is_on && self.state.dream.is_shared {
            self.crew.send(Order::Dreamer(DreamerCommand::Reward(reward.clone())));
        }
        if self.state.record.is_on && self.state.record.is_shared {
            self.crew.send(Order::Recorder(RecorderCommand::Reward(reward.clone())));
        }
    }

    pub(super) fn hear_beside(&mut self, ctx: &Context) {
        let record = &mut self.state.record;
        if let Some(view) =
            self.slots.beside.take().filter(|_| record.is_on && record.besides.asked.is_some())
        {
            clip::put(ctx, &mut record.besides.picture, &view.frame);
            record.besides.hear(view);
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
    use crate::env::Frame;

    #[test]
    fn another_episode_begins_another_curve() {
        let mut besides = Besides::default();
        for step in [1, 2, 5, 1, 2] {
            let frame = Frame::new(1, vec![0; 3]);
            besides.hear(BesideView { frame, step, since: step, drift: 0.5 });
        }
        assert_eq!(besides.drift, [[1.0, 0.5], [2.0, 0.5]]);
    }
}
