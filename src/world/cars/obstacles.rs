//! Obstacle Car Racing: Car Racing with chuckholes in the road and, if wanted, scripted cars on it.
//!
//! Chuckholes slow the car down, cars are solid. Neither gives a reward nor ends an episode. In evaluation three
//! [`Aids`] help the agent, as in the authors' experiments.

use std::collections::HashSet;

use super::draw::{picture, state_image};
use super::lap::{Lap, Meeting, Part, SENSORS, controls, speed, wrap};
use super::random::ChoiceStream;
use super::trace::Traced;
use super::track::NODE_STEP;
use super::trig::{self, Trig};
use super::{CarAction, Contacts, Env, Frame, Outcome, Seed, Truth};

/// Pixels a side of a frame.
const SIDE: u32 = 128;
const N_CHUCKHOLES: usize = 20;
/// How many cars there are in all where there are scripted ones.
const N_CARS: usize = 12;
/// The first tiles, and the last two, have no chuckholes.
const FREE_START: usize = 20;
const FREE_END: usize = 2;
/// Chuckholes keep so many tiles apart, and the search for a place gives up after so many draws.
const CHUCKHOLE_GAP: usize = 7;
const MAX_DRAWS: usize = 100;
/// An obstacle counts as passed once it came nearer than this, in units.
const NEAR: f64 = 20.0;
/// What is left of a hull's velocity in a step with a wheel in a chuckhole.
const SLOWED: f64 = 0.6;

/// Which obstacles there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Obstacles {
    /// 20 chuckholes ("chuckc").
    Chuckholes,
    /// 20 chuckholes and 11 scripted cars ("chuckccar").
    ChuckholesAndCars,
}

/// Help for the agent's car. While a person drives there is none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Aids {
    /// The first 49 actions are replaced by a gentle start (`INITIAL_ACC`).
    pub initial_acceleration: bool,
    /// A car far in the grass is steered back (`RECOVER`).
    pub recover: bool,
    /// Above 40 units a second the gas is cut (`CONTROL_SPEED`).
    pub control_speed: bool,
}

impl Aids {
    /// Nothing helps: for recording people.
    pub const NONE: Self = Self { initial_acceleration: false, recover: false, control_speed: false };
    /// Everything helps: for evaluation.
    pub const ALL: Self = Self { initial_acceleration: true, recover: true, control_speed: true };
}

/// Obstacle Car Racing (OCR).
#[derive(Clone, Debug)]
pub struct ObstacleCarRacing {
    obstacles: Obstacles,
    aids: Aids,
    trig: Trig,
    lap: Lap,
    /// Steps taken, the hidden one of the reset included.
    n_steps: usize,
    /// How many wheel contacts with chuckholes each car has.
    wheels_in: Vec<usize>,
    /// How many contacts the agent's hull has with other hulls.
    hulls_on: usize,
    touched: HashSet<usize>,
    hit: HashSet<usize>,
    passed_chuckholes: HashSet<usize>,
    passed_cars: HashSet<usize>,
    recovery: Recovery,
    executed: CarAction,
}

/// How far the return from the grass has come.
#[derive(Clone, Debug)]
enum Recovery {
    /// Turning parallel to the road: how many more times to the left than to the right.
    Turning { balance: i32 },
    /// Drifting back to the road, always to one side: +1 is left.
    Drifting { side: f64 },
}

impl ObstacleCarRacing {
    /// The world of `seed`, ready for its first action.
    pub fn new(seed: Seed, obstacles: Obstacles, aids: Aids) -> Self {
        Self::with_trig(seed, obstacles, aids, Trig::Portable)
    }

    /// Like [`ObstacleCarRacing::new`] with a choice of maths library, to compare with recorded episodes.
    pub fn with_trig(seed: Seed, obstacles: Obstacles, aids: Aids, trig: Trig) -> Self {
        let lap = place(seed, obstacles, trig);
        let mut env = Self {
            obstacles,
            aids,
            trig,
            wheels_in: vec![0; lap.cars.len()],
            hulls_on: 0,
            lap,
            n_steps: 0,
            touched: HashSet::new(),
            hit: HashSet::new(),
            passed_chuckholes: HashSet::new(),
            passed_cars: HashSet::new(),
            recovery: Recovery::Turning { balance: 0 },
            executed: CarAction::default(),
        };
        env.step(None);
        env
    }

    /// Changes which aids help from the next step on.
    pub fn set_aids(&mut self, aids: Aids) {
        self.aids = aids;
    }

    /// One step. Without an action it is the hidden one of a reset.
    fn step(&mut self, action: Option<[f64; 3]>) -> Outcome {
        self.n_steps += 1;
        let n_cars = self.lap.cars.len();
        let nearest: Vec<usize> = (0..n_cars).map(|car| self.lap.nearest_node(car)).collect();
        for car in 0..n_cars {
            if car > 0 {
                self.drive_scripted(car, &nearest);
            } else if let Some(action) = action {
                self.drive_agent(action, nearest[0]);
            }
            self.lap.step_car(car);
            if self.wheels_in[car] > 0 {
                self.slow_down(car);
            }
        }
        self.lap.step_world();
        let (chuckhole, hit) = self.meet();

        let mut outcome = if action.is_some() {
            self.lap.outcome()
        } else {
            self.lap.settle();
            Outcome::default()
        };
        let events = &mut outcome.events;
        events.chuckhole = chuckhole;
        events.car = hit;
        let here = self.position(0);
        for (i, &hole) in self.lap.chuckholes.iter().enumerate() {
            events.chuckhole_passed |= distance(here, hole) < NEAR && self.passed_chuckholes.insert(i);
        }
        for car in 1..n_cars {
            events.car_passed |= distance(here, self.position(car)) < NEAR && self.passed_cars.insert(car);
        }
        outcome
    }

    fn position(&self, car: usize) -> [f64; 2] {
        let p = self.lap.hull(car).position();
        [f64::from(p.x), f64::from(p.y)]
    }

    /// Works through what met in the last world step: whether there was a new chuckhole, and a new car.
    fn meet(&mut self) -> (bool, bool) {
        let (mut new_chuckhole, mut new_car) = (false, false);
        for &Meeting { begins, one, other } in &self.lap.meetings {
            match (one, other) {
                (Part::Hull { car: 0 }, Part::Hull { car }) | (Part::Hull { car }, Part::Hull { car: 0 }) => {
                    self.hulls_on = if begins { self.hulls_on + 1 } else { self.hulls_on.saturating_sub(1) };
                    new_car |= self.hit.insert(car);
                }
                (Part::Chuckhole(hole), Part::Wheel { car, .. }) => {
                    let wheels = &mut self.wheels_in[car];
                    *wheels = if begins { *wheels + 1 } else { wheels.saturating_sub(1) };
                    new_chuckhole |= car == 0 && self.touched.insert(hole);
                }
                _ => {}
            }
        }
        (new_chuckhole, new_car)
    }

    fn slow_down(&mut self, car: usize) {
        let mut v = self.lap.hull(car).velocity();
        v.x = (f64::from(v.x) * SLOWED) as f32;
        v.y = (f64::from(v.y) * SLOWED) as f32;
        self.lap.world.set_velocity(self.lap.cars[car].hull(), v);
    }

    /// Gives the agent's action to its car, or what the aids make of it.
    fn drive_agent(&mut self, [steer, gas, brake]: [f64; 3], node: usize) {
        if self.aids.initial_acceleration && self.n_steps <= 50 {
            return self.execute([0.0, 0.3, 0.0]);
        }
        if self.aids.recover
            && let Some([angle, gas, brake]) = self.recover(node)
        {
            return self.execute([-angle, gas, brake]);
        }
        if !self.aids.control_speed {
            return self.execute([steer, gas, brake]);
        }
        if self.aids.recover {
            // As in the reference code: two calls a step, hence a ramp twice as steep.
            self.lap.agent().gas(gas);
        }
        let v = speed(self.lap.hull(0));
        let gas = if v > 40.0 { (0.05 * (40.0 - v)).clamp(0.0, 0.1) } else { gas };
        self.execute([steer, gas, brake]);
    }

    fn execute(&mut self, [steer, gas, brake]: [f64; 3]) {
        let agent = self.lap.agent();
        agent.steer(-steer);
        agent.gas(gas);
        agent.brake(brake);
        self.executed = CarAction::new(steer as f32, gas as f32, brake as f32);
    }

    /// Where the car is far from the road: the angle to steer by, gas and brake that lead back.
    fn recover(&mut self, node: usize) -> Option<[f64; 3]> {
        let (x, y, beta) = {
            let node = &self.lap.track.nodes[node];
            (node.x, node.y, node.beta)
        };
        if distance(self.position(0), [x, y]) < 8.0 {
            self.recovery = Recovery::Turning { balance: 0 };
            return None;
        }
        if let Recovery::Turning { balance } = self.recovery {
            let hull = self.lap.hull(0);
            let brake = if speed(hull) > 30.0 { 1.0 } else { 0.0 };
            let error = wrap(beta - f64::from(hull.angle()));
            let [angle, gas] = self.follow(0, node, 50.0);
            let balance = balance + i32::from(angle > 0.0) - i32::from(angle < 0.0);
            self.recovery = if error.abs() < 0.05 {
                Recovery::Drifting { side: if balance > 0 { 1.0 } else { -1.0 } }
            } else {
                Recovery::Turning { balance }
            };
            return Some([angle, gas, brake]);
        }
        let Recovery::Drifting { side } = self.recovery else { return None };
        Some([0.05 * side, 0.2, 0.0])
    }

    /// The angle to steer by and the gas with which a car keeps the road's direction, aiming at a speed.
    fn follow(&self, car: usize, node: usize, target: f64) -> [f64; 2] {
        let nodes = &self.lap.track.nodes;
        let hull = self.lap.hull(car);
        let error = wrap(nodes[node].beta - f64::from(hull.angle()));
        let v = speed(hull);
        let angle = if target == 15.0 { 4.0 * error } else { error * (4.0 / (1.0 + 0.05 * v)) };
        let mut gas = (0.05 * (target - v)).clamp(0.0, 0.1);
        if let Some(next) = nodes.get(node + 1) {
            let turn = wrap(next.beta - nodes[node].beta).abs();
            gas *= (1.0 - turn).clamp(0.4, 1.0);
        }
        [angle.clamp(-1.0, 1.0), gas]
    }

    /// A scripted car goes while the agent is around or another presses from behind, unless one is right ahead.
    fn drive_scripted(&mut self, car: usize, nearest: &[usize]) {
        let n = self.lap.track.nodes.len();
        let spacing = n / nearest.len();
        let ahead = |from: usize, to: usize| (nearest[to] + n - nearest[from]) % n;
        let mut others = (1..nearest.len()).filter(|&other| other != car);
        let lead = ahead(0, car);
        let agent_is_near = lead < 13 || lead > n - 13;
        let pressed = others.clone().any(|other| (1..spacing).contains(&ahead(other, car)));
        let blocked = others.any(|other| (1..5).contains(&ahead(car, other)));
        let [angle, gas, brake] = if (agent_is_near || pressed) && !blocked {
            let [angle, gas] = self.follow(car, nearest[car], 15.0);
            [angle, gas, 0.0]
        } else {
            [0.0, 0.0, 1.0]
        };
        let car = &mut self.lap.cars[car];
        car.steer(angle);
        car.gas(gas);
        car.brake(brake);
    }
}

/// A fresh lap with its chuckholes and cars.
fn place(seed: Seed, obstacles: Obstacles, trig: Trig) -> Lap {
    let mut lap = Lap::new(seed, trig, false);
    let mut stream = ChoiceStream::obstacles(seed);
    let n = lap.track.nodes.len();
    for tile in chuckhole_tiles(n, &mut stream) {
        let node = &lap.track.nodes[tile];
        let ahead = NODE_STEP / 2.0;
        let at = [node.x - ahead * trig::sin(node.beta), node.y + ahead * trig::cos(node.beta)];
        lap.add_chuckhole(at);
    }
    let n_cars = match obstacles {
        Obstacles::Chuckholes => 1,
        Obstacles::ChuckholesAndCars => N_CARS,
    };
    for car in 0..n_cars {
        lap.add_car(car * (n / n_cars));
    }
    lap
}

/// Draws the tiles that get a chuckhole on a track of `n`.
fn chuckhole_tiles(n: usize, stream: &mut ChoiceStream) -> [usize; N_CHUCKHOLES] {
    let mut free: Vec<bool> = (0..n).map(|i| (FREE_START..n - FREE_END).contains(&i)).collect();
    [(); N_CHUCKHOLES].map(|()| {
        let mut tile = 0;
        for _ in 0..MAX_DRAWS {
            tile = stream.below(n as u32) as usize;
            if free[tile] {
                let around = tile.saturating_sub(CHUCKHOLE_GAP)..(tile + CHUCKHOLE_GAP + 1).min(n);
                free[around].fill(false);
                break;
            }
        }
        tile
    })
}

fn distance([ax, ay]: [f64; 2], [bx, by]: [f64; 2]) -> f64 {
    let (dx, dy) = (ax - bx, ay - by);
    (dx * dx + dy * dy).sqrt()
}

impl Env for ObstacleCarRacing {
    fn copied(&self) -> Option<Box<dyn Env>> {
        Some(Box::new(self.clone()))
    }

    fn reset(&mut self, seed: Seed) {
        *self = Self::with_trig(seed, self.obstacles, self.aids, self.trig);
    }

    fn advance(&mut self, action: CarAction) -> Outcome {
        self.advance_by(controls(action))
    }

    fn executed(&self) -> Option<CarAction> {
        Some(self.executed)
    }

    fn frame(&self) -> Frame {
        Frame::square(SIDE, self.raw_image())
    }

    fn sensors(&self) -> &'static [&'static str] {
        &SENSORS
    }

    fn state(&self) -> Vec<f32> {
        self.lap.state().to_vec()
    }

    fn truth(&self) -> Truth {
        let lap = &self.lap;
        let holes = lap.chuckholes.iter().enumerate().map(|(i, &at)| (i, at, 0.0));
        let cars = (1..lap.cars.len()).map(|car| (car, self.position(car), speed(lap.hull(car))));
        Truth {
            contacts: Some(Contacts { chuckhole: self.wheels_in[0] > 0, car: self.hulls_on > 0 }),
            chuckhole: lap.next_obstacle(holes),
            car: lap.next_obstacle(cars),
            ..lap.truth()
        }
    }

    fn picture(&self, width: u32, height: u32) -> Vec<u8> {
        picture(&self.lap.scene(true), width, height)
    }
}

impl Traced for ObstacleCarRacing {
    fn advance_by(&mut self, action: [f64; 3]) -> Outcome {
        self.step(Some(action))
    }

    fn score(&self) -> f64 {
        self.lap.score()
    }

    fn car_states(&self) -> Vec<[f32; 6]> {
        self.lap.car_states()
    }

    fn raw_image(&self) -> Vec<u8> {
        state_image(&self.lap.scene(false), SIDE)
    }
}
