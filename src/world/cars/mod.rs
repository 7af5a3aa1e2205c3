//! The real world: simulated racing that a seed and the actions decide completely (Step 0 of the method).
//!
//! Nothing here knows a tensor: frames are `u8`, actions `f32`.

pub mod action;
pub mod car;
pub mod car_racing;
pub mod controls;
pub mod draw;

mod lap;
pub mod mersenne;
pub mod obstacles;
pub mod physics;
pub mod pilot;
pub mod player;
pub mod process;
pub mod random;
mod raster;
pub mod sight;
pub mod trace;
pub mod track;
pub mod trig;
mod world;

pub use super::{End, Frame};
pub use action::{CarAction, RANGES};
pub use car_racing::CarRacing;
pub use obstacles::{Aids, ObstacleCarRacing, Obstacles};
pub use player::CarPlayer;
pub use sight::Sight;
pub use world::CarWorld;

/// Environment steps a second of simulated time.
pub const STEPS_PER_SEC: u32 = 50;
/// The most steps an episode has.
pub const MAX_STEPS: usize = 1000;

/// What decides a world: one number for a stream of our own, or those of a Python run to compare with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Seed {
    /// Our own: two derived `ChaCha8` streams, one for the track and one for the obstacles.
    Native(u64),
    /// `env.seed(env)` of gym 0.20 and `random.seed(python)` of Python.
    Gym {
        /// The environment's seed: the track.
        env: u64,
        /// Python's global seed: the chuckholes.
        python: u64,
    },
    /// `reset(seed=n)` of gymnasium.
    Gymnasium(u64),
}

/// The world that the agent must drive in, at 50 steps a second.
///
/// ```text
/// reset(seed) → frame; then, until outcome.end: advance(action) → outcome, frame()
/// ```
pub trait Env: Send {
    /// Starts an episode.
    fn reset(&mut self, seed: Seed);

    /// Moves the world on by one step without drawing it.
    fn advance(&mut self, action: CarAction) -> Outcome;

    /// What the car carried out in the last step, where an aid may have changed what it was told.
    fn executed(&self) -> Option<CarAction> {
        None
    }

    /// What the models see of the present moment, processed (method §2.1).
    fn frame(&self) -> Frame;

    /// The names of what the agent's car measures of itself, as a real one would. None where it measures nothing.
    fn sensors(&self) -> &'static [&'static str] {
        &[]
    }

    /// What [`sensors`](Self::sensors) measure at the present moment, in their order.
    fn state(&self) -> Vec<f32> {
        Vec::new()
    }

    /// What the simulator knows of the agent's car: for scripted pilots and probes, never for the method.
    fn truth(&self) -> Truth;

    /// The scene as a person sees it, at any size: `width · height · 3` bytes, anti-aliased.
    fn picture(&self, width: u32, height: u32) -> Vec<u8>;

    /// The same simulation as it stands, to go on by itself; where it can be had.
    fn copied(&self) -> Option<Box<dyn Env>> {
        None
    }
}

/// What a step brought.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outcome {
    /// +10 for a new tile, −1 off the road, else 0.
    pub reward: f32,
    /// What happened.
    pub events: Events,
    /// Set on the last step of an episode.
    pub end: Option<End>,
}

/// What happened to the agent's car in a step. The authors' info flags.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[expect(clippy::struct_excessive_bools, reason = "six independent flags of the reference environment")]
pub struct Events {
    /// A tile was entered for the first time (`succ`).
    pub new_tile: bool,
    /// The off-road latch is set, or the car has left the field (`crash`).
    pub grass: bool,
    /// A chuckhole was touched for the first time (`chuck`).
    pub chuckhole: bool,
    /// A chuckhole came within 20 units for the first time (`chuck_passed`).
    pub chuckhole_passed: bool,
    /// A car was hit for the first time (`car`).
    pub car: bool,
    /// A car came within 20 units for the first time (`car_passed`).
    pub car_passed: bool,
}

/// What the simulator knows of the agent's car.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Truth {
    /// Hull position in world units.
    pub position: [f32; 2],
    /// Hull angle in radians, counter-clockwise, 0 is +y.
    pub angle: f32,
    /// Hull speed in units a second.
    pub speed: f32,
    /// Hull velocity along and to the right of the road's direction at the nearest node, units a second.
    pub road_velocity: [f32; 2],
    /// Signed distance of the hull from the center line in units. Positive is right of it. Half the road is 6.67.
    pub lateral: f32,
    /// Hull heading minus road heading in `[-π, π)`. Positive points left of the road.
    pub heading_error: f32,
    /// The road's change of direction over the next 5, 10 and 20 nodes (3.5 units each), radians. Positive is left.
    pub bends: [f32; 3],
    /// Index of the nearest track node.
    pub node: usize,
    /// How many nodes the track has.
    pub n_nodes: usize,
    /// Tiles visited so far.
    pub n_visited: usize,
    /// How many of the four wheels touch no tile.
    pub wheels_off: u8,
    /// What the car touches at this moment. Nothing in a world without obstacles.
    pub contacts: Option<Contacts>,
    /// The next chuckhole, if there is one ahead or beside.
    pub chuckhole: Option<Obstacle>,
    /// The next other car, if there is one ahead or beside.
    pub car: Option<Obstacle>,
}

/// Which obstacles the agent's car touches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Contacts {
    /// A wheel is in a chuckhole.
    pub chuckhole: bool,
    /// The hull touches that of another car.
    pub car: bool,
}

/// An obstacle as whoever drives the agent's car would say where it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Obstacle {
    /// Which of its kind.
    pub id: usize,
    /// How far ahead of the hull its center is in units along the road. Negative is behind.
    pub ahead: f32,
    /// How far right of the center line its center is in units.
    pub lateral: f32,
    /// Its speed in units a second.
    pub speed: f32,
}
