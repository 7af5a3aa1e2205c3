//! Car Racing: an empty road through the grass, as the authors changed it from gym 0.20.
//!
//! A step gives +10 where a new tile was entered, −1 off the road, else 0. Only leaving the field and the time limit
//! end an episode. A [`CarRacing`] driven by recorded actions equals the Python environment step by step.

use super::course::{Course, controls};
use super::draw::{picture, state_image};
use super::process::process;
use super::trace::Traced;
use super::trig::Trig;
use super::{Action, Env, Frame, Outcome, Seed, Truth};

/// Pixels a side of the picture before processing.
const RAW_SIDE: u32 = 96;

/// Car Racing (CR).
#[derive(Clone, Debug)]
pub struct CarRacing {
    trig: Trig,
    course: Course,
}

impl CarRacing {
    /// The world of `seed`, ready for its first action.
    pub fn new(seed: Seed) -> Self {
        Self::with_trig(seed, Trig::Portable)
    }

    /// Like [`CarRacing::new`] with a choice of maths library, to compare with recorded episodes.
    pub fn with_trig(seed: Seed, trig: Trig) -> Self {
        Self { trig, course: start(seed, trig) }
    }

    /// How many tiles were visited.
    pub fn n_visited(&self) -> usize {
        self.course.n_visited()
    }
}

/// A fresh course after the hidden step of a reset.
fn start(seed: Seed, trig: Trig) -> Course {
    let mut course = Course::new(seed, trig, true);
    course.add_car(0);
    course.step_car(0);
    course.step_world();
    course.settle();
    course
}

impl Env for CarRacing {
    fn reset(&mut self, seed: Seed) {
        self.course = start(seed, self.trig);
    }

    fn advance(&mut self, action: Action) -> Outcome {
        self.advance_by(controls(action))
    }

    fn frame(&self) -> Frame {
        process(&self.raw_image())
    }

    fn truth(&self) -> Truth {
        self.course.truth()
    }

    fn picture(&self, width: u32, height: u32) -> Vec<u8> {
        picture(&self.course.scene(true), width, height)
    }
}

impl Traced for CarRacing {
    fn advance_by(&mut self, [steer, gas, brake]: [f64; 3]) -> Outcome {
        let agent = self.course.agent();
        agent.steer(-steer);
        agent.gas(gas);
        agent.brake(brake);
        self.course.step_car(0);
        self.course.step_world();
        self.course.judge()
    }

    fn score(&self) -> f64 {
        self.course.score()
    }

    fn car_states(&self) -> Vec<[f32; 6]> {
        self.course.car_states()
    }

    fn raw_image(&self) -> Vec<u8> {
        state_image(&self.course.scene(true), RAW_SIDE)
    }
}
