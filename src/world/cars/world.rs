//! The built-in worlds as any other world is: described by a file, driven by an action of some numbers.

use std::sync::Arc;

use rand_chacha::ChaCha8Rng;

use super::pilot::ScriptedPilot;
use super::{Aids, CarAction, CarRacing, Env, Events, ObstacleCarRacing, Obstacles, Outcome, Seed, Truth};
use crate::world::{
    Action, Frame, Happened, ImageSpec, OwnPolicy, Status, Step, World, WorldError, WorldSpec,
};

/// A simulated car in its world.
pub struct CarWorld {
    spec: Arc<WorldSpec>,
    env: Box<dyn Env>,
    /// Its own way to drive, once it was begun.
    pilot: Option<ScriptedPilot>,
    /// Whether an episode goes on.
    goes_on: bool,
}

impl CarWorld {
    /// The built-in world of this name; where there are obstacles, `aids` may help the driver.
    pub fn open(name: &str, aids: Aids) -> Option<Self> {
        let spec = WorldSpec::built_in(name)?;
        let seed = Seed::Native(0);
        let env: Box<dyn Env> = match name {
            "obstacle-car-racing" => {
                Box::new(ObstacleCarRacing::new(seed, Obstacles::ChuckholesAndCars, aids))
            }
            "obstacle-car-racing-chuckholes" => {
                Box::new(ObstacleCarRacing::new(seed, Obstacles::Chuckholes, aids))
            }
            _ => Box::new(CarRacing::new(seed)),
        };
        Some(Self { spec: Arc::new(spec), env, pilot: None, goes_on: false })
    }

    /// Any simulation of a car, called `name`, in which what happens and what can be done is as in Car Racing.
    pub fn of(name: &str, env: impl Env + 'static) -> Self {
        let like = WorldSpec::built_in("car-racing").unwrap_or_else(|| unreachable!("it is built in"));
        let frame = env.frame();
        let image = ImageSpec { height: frame.height(), width: frame.width(), ..like.image };
        let spec = WorldSpec { name: name.to_owned(), title: name.to_owned(), image, ..like };
        Self { spec: Arc::new(spec), env: Box::new(env), pilot: None, goes_on: false }
    }

    /// The same world as another file describes it.
    #[must_use]
    pub fn described(self, spec: Arc<WorldSpec>) -> Self {
        Self { spec, ..self }
    }

    /// The simulation itself.
    pub fn simulation(&mut self) -> &mut dyn Env {
        &mut *self.env
    }

    /// What the simulator knows of the agent's car.
    pub fn truth(&self) -> Truth {
        self.env.truth()
    }

    /// What happened, in the order of the world's file.
    fn happened(&self, events: Events) -> Vec<Happened> {
        let touched = self.env.truth().contacts.unwrap_or_default();
        let of = |name: &str| {
            let (happened, goes_on, passed) = match name {
                "grass" => (events.grass, events.grass, false),
                "new tile" => (events.new_tile, events.new_tile, false),
                "chuckhole" => (events.chuckhole, touched.chuckhole, events.chuckhole_passed),
                "car" => (events.car, touched.car, events.car_passed),
                _ => (false, false, false),
            };
            Happened { happened, goes_on, passed }
        };
        self.spec.events.iter().map(|event| of(&event.name)).collect()
    }
}

impl World for CarWorld {
    fn spec(&self) -> &Arc<WorldSpec> {
        &self.spec
    }

    fn reset(&mut self, seed: u64) -> Result<Frame, WorldError> {
        self.env.reset(Seed::Native(seed));
        self.goes_on = true;
        Ok(self.env.frame())
    }

    fn step(&mut self, action: &[f32]) -> Result<Step, WorldError> {
        let action = self.spec.checked(action)?;
        if !self.goes_on {
            return Err(WorldError::NoEpisode);
        }
        let Outcome { reward, events, end } = self.env.advance(CarAction::from(&*action));
        self.goes_on = end.is_none();
        Ok(Step {
            frame: self.env.frame(),
            reward: Some(reward),
            events: self.happened(events),
            executed: self.env.executed().map(Action::from),
            end,
        })
    }

    fn sensors(&self) -> Vec<String> {
        self.env.sensors().iter().map(|name| (*name).to_owned()).collect()
    }

    fn state(&self) -> Vec<f32> {
        self.env.state()
    }

    fn picture(&self, width: u32, height: u32) -> Option<Frame> {
        let picture = self.env.picture(width, height);
        // A toy may have nothing to show.
        (!picture.is_empty()).then(|| Frame::new(height, width, picture))
    }

    fn known(&self) -> Vec<(&'static str, f32)> {
        let Truth { speed, lateral, heading_error, wheels_off, .. } = self.env.truth();
        vec![
            ("speed", speed),
            ("lateral", lateral),
            ("heading_error", heading_error),
            ("wheels_off", f32::from(wheels_off)),
        ]
    }

    fn status(&self) -> Option<Status> {
        let off = self.env.truth().wheels_off;
        Some(match off {
            0 => Status { text: "all wheels on the road".to_owned(), is_fine: true },
            4 => Status { text: "off the road".to_owned(), is_fine: false },
            n => Status { text: format!("{n} of 4 wheels off the road"), is_fine: false },
        })
    }

    fn copied(&self) -> Option<Box<dyn World>> {
        let env = self.env.copied()?;
        Some(Box::new(Self { spec: Arc::clone(&self.spec), env, pilot: None, goes_on: self.goes_on }))
    }

    fn policy(&mut self) -> Option<&mut dyn OwnPolicy> {
        Some(self)
    }
}

impl OwnPolicy for CarWorld {
    fn begin(&mut self, rng: &mut ChaCha8Rng) {
        self.pilot = Some(ScriptedPilot::drawn(rng));
    }

    fn act(&mut self, rng: &mut ChaCha8Rng) -> Result<Action, WorldError> {
        let truth = self.env.truth();
        Ok(self.pilot.get_or_insert_with(|| ScriptedPilot::drawn(rng)).act(&truth, rng).into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::BuiltIn;

    #[test]
    fn every_built_in_world_opens_and_steps_as_its_simulation_does() {
        for built_in in BuiltIn::all() {
            let mut world = CarWorld::open(built_in.name(), Aids::NONE).unwrap();
            assert!(matches!(world.step(&[0.0; 3]), Err(WorldError::NoEpisode)));
            let first = world.reset(3).unwrap();
            let mut env = CarRacing::new(Seed::Native(3));
            if built_in.name() == "car-racing" {
                assert_eq!(first, env.frame());
                for _ in 0..60 {
                    let outcome = env.advance(CarAction::new(0.3, 0.5, 0.0));
                    let step = world.step(&[0.3, 0.5, 0.0]).unwrap();
                    assert_eq!((step.reward, step.end), (Some(outcome.reward), outcome.end));
                    assert_eq!(step.events[0].happened, outcome.events.grass);
                    assert_eq!(step.frame, env.frame());
                }
            }
            assert!(matches!(world.step(&[0.0; 2]), Err(WorldError::ActionLength { found: 2, wanted: 3 })));
            assert!(matches!(world.step(&[0.0, f32::NAN, 0.0]), Err(WorldError::ActionValue { .. })));
        }
        assert!(CarWorld::open("elsewhere", Aids::NONE).is_none());
    }
}
