//! Car Racing: an empty road through the grass, as the authors changed it from gym 0.20.
//!
//! A step gives +10 where a new tile was entered, −1 off the road, else 0. Only leaving the field and the time limit
//! end an episode. A [`CarRacing`] driven by recorded actions equals the Python environment step by step.

use super::draw::{picture, state_image};
use super::lap::{Lap, SENSORS, controls};
use super::process::process;
use super::trace::Traced;
use super::trig::Trig;
use super::{CarAction, Env, Frame, Outcome, Seed, Truth};

/// Pixels a side of the picture before processing.
const RAW_SIDE: u32 = 96;

/// Car Racing (CR).
#[derive(Clone, Debug)]
pub struct CarRacing {
    trig: Trig,
    lap: Lap,
}

impl CarRacing {
    /// The world of `seed`, ready for its first action.
    pub fn new(seed: Seed) -> Self {
        Self::with_trig(seed, Trig::Portable)
    }

    /// Like [`CarRacing::new`] with a choice of maths library, to compare with recorded episodes.
    pub fn with_trig(seed: Seed, trig: Trig) -> Self {
        Self { trig, lap: start(seed, trig) }
    }

    /// How many tiles were visited.
    pub fn n_visited(&self) -> usize {
        self.lap.n_visited()
    }
}

/// A fresh lap after the hidden step of a reset.
fn start(seed: Seed, trig: Trig) -> Lap {
    let mut lap = Lap::new(seed, trig, true);
    lap.add_car(0);
    lap.step_car(0);
    lap.step_world();
    lap.settle();
    lap
}

impl Env for CarRacing {
    fn copied(&self) -> Option<Box<dyn Env>> {
        Some(Box::new(self.clone()))
    }

    fn reset(&mut self, seed: Seed) {
        self.lap = start(seed, self.trig);
    }

    fn advance(&mut self, action: CarAction) -> Outcome {
        self.advance_by(controls(action))
    }

    fn frame(&self) -> Frame {
        process(&self.raw_image())
    }

    fn sensors(&self) -> &'static [&'static str] {
        &SENSORS
    }

    fn state(&self) -> Vec<f32> {
        self.lap.state().to_vec()
    }

    fn truth(&self) -> Truth {
        self.lap.truth()
    }

    fn picture(&self, width: u32, height: u32) -> Vec<u8> {
        picture(&self.lap.scene(true), width, height)
    }
}

impl Traced for CarRacing {
    fn advance_by(&mut self, [steer, gas, brake]: [f64; 3]) -> Outcome {
        let agent = self.lap.agent();
        agent.steer(-steer);
        agent.gas(gas);
        agent.brake(brake);
        self.lap.step_car(0);
        self.lap.step_world();
        self.lap.outcome()
    }

    fn score(&self) -> f64 {
        self.lap.score()
    }

    fn car_states(&self) -> Vec<[f32; 6]> {
        self.lap.car_states()
    }

    fn raw_image(&self) -> Vec<u8> {
        state_image(&self.lap.scene(true), RAW_SIDE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_car_measures_what_it_does() {
        let mut env = CarRacing::new(Seed::Native(0));
        let resting = env.state();
        assert_eq!((resting.len(), env.sensors().len()), (7, 7));
        for t in 0..50 {
            env.advance(if t < 40 { CarAction::new(0.0, 0.5, 0.0) } else { CarAction::new(-0.5, 0.1, 0.0) });
        }
        let state = env.state();
        let &[speed, steering, yaw, ref wheels @ ..] = state.as_slice() else { panic!("seven numbers") };
        assert_eq!(speed, env.truth().speed);
        assert!(speed > resting[0] + 5.0, "it drives: {speed}");
        assert!(steering > 0.2 && yaw > 0.1, "to the left: {steering}, {yaw}");
        assert!(wheels.iter().all(|&speed| speed > 5.0), "on turning wheels: {wheels:?}");
    }
}
