//! What both environments have in common: a track with cars on it, and the book kept of tiles.
//!
//! Rules and constants are those of the authors' changed copy of gym 0.20's `car_racing.py` (gym's MIT notice is in
//! `assets/licenses/gym.txt`).

use std::f64::consts::PI;

use super::car::Car;
use super::draw::{Camera, CarView, Indicators, Pose, Scene};
use super::physics::{Body, Polygon, Shape, Touch, Vec2, World};
use super::random::UniformStream;
use super::track::{NODE_STEP, PLAYFIELD, Track};
use super::trig::{self, Trig};
use super::{CarAction, End, Events, MAX_STEPS, Obstacle, Outcome, Seed, Truth};

/// Seconds a step.
const DT: f64 = 1.0 / 50.0;
/// Radius of a chuckhole in units.
const CHUCKHOLE_RADIUS: f32 = 1.2;
/// An obstacle is told of from so many units ahead until it is so many behind.
const SIGHT: f32 = 100.0;
const BESIDE: f32 = 4.0;
/// The rewards of a new tile and of the grass.
const NEW_TILE_REWARD: f32 = 10.0;
const GRASS_REWARD: f32 = -1.0;
/// What every action takes off the score that is shown, and what all tiles together add.
const SCORE_PER_ACTION: f64 = 0.1;
const SCORE_OF_ALL_TILES: f64 = 1000.0;

/// What the agent's car measures: its speed in units a second, the angle of its front wheels in radians and its yaw rate
/// in radians a second (both positive to the left), and how fast each wheel turns in radians a second.
pub(super) const SENSORS: [&str; 7] = [
    "speed",
    "steering_angle",
    "yaw_rate",
    "wheel_speed.front_left",
    "wheel_speed.front_right",
    "wheel_speed.rear_left",
    "wheel_speed.rear_right",
];

/// What a fixture belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Part {
    Tile(usize),
    Chuckhole(usize),
    Hull { car: usize },
    Wheel { car: usize, wheel: usize },
}

/// A beginning or ending touch that is not about tiles.
#[derive(Clone, Copy, Debug)]
pub(super) struct Meeting {
    pub(super) begins: bool,
    pub(super) one: Part,
    pub(super) other: Part,
}

/// A track, the cars on it, and what the agent's car (the first) has visited.
#[derive(Clone, Debug)]
pub(super) struct Lap {
    pub(super) track: Track,
    pub(super) world: World,
    pub(super) cars: Vec<Car>,
    /// Centers of the chuckholes in units.
    pub(super) chuckholes: Vec<[f64; 2]>,
    /// What each fixture belongs to.
    parts: Vec<Part>,
    /// Tiles drawn as touched.
    touched: Vec<bool>,
    visited: Vec<bool>,
    n_visited: usize,
    n_visited_before: usize,
    /// Set when a wheel leaves its last tile, cleared when any wheel enters a tile.
    off_road: bool,
    /// Whether tiles notice hulls, too.
    hulls_touch: bool,
    score: f64,
    time: f64,
    n_actions: usize,
    touches: Vec<Touch>,
    pub(super) meetings: Vec<Meeting>,
}

impl Lap {
    /// The track of `seed`, without a car.
    pub(super) fn new(seed: Seed, trig: Trig, hulls_touch: bool) -> Self {
        let track = Track::generate(&mut UniformStream::track(seed));
        let n = track.nodes.len();
        let mut world = World::new(trig);
        let mut parts = Vec::with_capacity(n);
        for i in 0..n {
            world.add_sensor(Shape::Polygon(Polygon::hull(&track.tile(i))));
            parts.push(Part::Tile(i));
        }
        Self {
            track,
            world,
            cars: Vec::new(),
            chuckholes: Vec::new(),
            parts,
            touched: vec![false; n],
            visited: vec![false; n],
            n_visited: 0,
            n_visited_before: 0,
            off_road: false,
            hulls_touch,
            score: 0.0,
            time: 0.0,
            n_actions: 0,
            touches: Vec::new(),
            meetings: Vec::new(),
        }
    }

    /// Puts a chuckhole at `center`. All of them come before the cars.
    pub(super) fn add_chuckhole(&mut self, center: [f64; 2]) {
        self.world.add_sensor(Shape::Circle { center: Vec2::from_f64(center), radius: CHUCKHOLE_RADIUS });
        self.parts.push(Part::Chuckhole(self.chuckholes.len()));
        self.chuckholes.push(center);
    }

    /// Puts a car at a node of the track.
    pub(super) fn add_car(&mut self, node: usize) {
        let node = &self.track.nodes[node];
        let (at, beta) = ([node.x, node.y], node.beta);
        let car = self.cars.len();
        self.cars.push(Car::new(&mut self.world, at, beta));
        self.parts.extend((0..Car::N_FIXTURES - 4).map(|_| Part::Hull { car }));
        self.parts.extend((0..4).map(|wheel| Part::Wheel { car, wheel }));
    }

    /// The agent's car.
    pub(super) fn agent(&mut self) -> &mut Car {
        &mut self.cars[0]
    }

    /// The hull of a car.
    pub(super) fn hull(&self, car: usize) -> &Body {
        self.world.body(self.cars[car].hull())
    }

    /// Lets one car's engine and tires act.
    pub(super) fn step_car(&mut self, car: usize) {
        self.cars[car].step(&mut self.world);
    }

    /// Moves the world on, and keeps the book of tiles. What else met is in `meetings`.
    pub(super) fn step_world(&mut self) {
        let mut touches = std::mem::take(&mut self.touches);
        touches.clear();
        touches.extend_from_slice(self.world.step());
        self.meetings.clear();
        for &Touch { begins, a, b } in &touches {
            let (one, other) = (self.parts[a], self.parts[b]);
            if let Part::Tile(tile) = one {
                self.touch_tile(tile, other, begins);
            } else {
                self.meetings.push(Meeting { begins, one, other });
            }
        }
        self.touches = touches;
        self.time += DT;
    }

    /// A tile and a part of a car began or ceased to touch.
    fn touch_tile(&mut self, tile: usize, part: Part, begins: bool) {
        match part {
            Part::Wheel { car: 0, wheel } => {
                self.touched[tile] = true;
                let wheel = self.cars[0].wheel_mut(wheel);
                if begins {
                    self.off_road = false;
                    wheel.enter(tile);
                    if !self.visited[tile] {
                        self.visited[tile] = true;
                        self.n_visited += 1;
                        self.score += SCORE_OF_ALL_TILES / self.track.nodes.len() as f64;
                    }
                } else if wheel.leave(tile) {
                    // A latch of the last event, not a state: it defines the paper's rate of grass.
                    self.off_road = true;
                }
            }
            Part::Hull { .. } if self.hulls_touch => self.touched[tile] = true,
            // Other cars' wheels never learn that they are on the road: they have the grip of grass.
            _ => {}
        }
    }

    /// Closes the hidden step of a reset, whose tiles are never rewarded.
    pub(super) fn settle(&mut self) {
        self.n_visited_before = self.n_visited;
    }

    /// Closes a step that an action was given for: reward, grass, new tile, end.
    pub(super) fn outcome(&mut self) -> Outcome {
        self.score -= SCORE_PER_ACTION;
        self.n_actions += 1;
        let p = self.hull(0).position();
        let out = f64::from(p.x).abs() > PLAYFIELD || f64::from(p.y).abs() > PLAYFIELD;
        let grass = out || self.off_road;
        let new_tile = !grass && self.n_visited > self.n_visited_before;
        self.n_visited_before = self.n_visited;
        // DIFFERENCE: a finished lap ends gym's episode. The authors overwrite that flag, and so do we.
        let end = if out {
            Some(End::Terminated)
        } else if self.n_actions >= MAX_STEPS {
            Some(End::Truncated)
        } else {
            None
        };
        let reward = if grass {
            GRASS_REWARD
        } else if new_tile {
            NEW_TILE_REWARD
        } else {
            0.0
        };
        Outcome { reward, events: Events { new_tile, grass, ..Events::default() }, end }
    }

    /// The score that the picture shows, which is not the return.
    pub(super) fn score(&self) -> f64 {
        self.score
    }

    /// How many tiles were visited.
    pub(super) fn n_visited(&self) -> usize {
        self.n_visited
    }

    /// x, y, angle, vx, vy and turn rate of every hull.
    pub(super) fn car_states(&self) -> Vec<[f32; 6]> {
        let state = |car| {
            let hull = self.hull(car);
            let (p, v) = (hull.position(), hull.velocity());
            [p.x, p.y, hull.angle(), v.x, v.y, hull.turn_rate()]
        };
        (0..self.cars.len()).map(state).collect()
    }

    /// What [`SENSORS`] of the agent's car measure: nothing that is known of the road.
    pub(super) fn state(&self) -> [f32; SENSORS.len()] {
        let (hull, wheels) = (self.hull(0), self.cars[0].wheels());
        let [front_left, front_right, rear_left, rear_right] =
            wheels.each_ref().map(|wheel| wheel.omega() as f32);
        let steering_angle = self.world.joint_angle(wheels[0].joint());
        [speed(hull) as f32, steering_angle, hull.turn_rate(), front_left, front_right, rear_left, rear_right]
    }

    /// What there is to draw.
    pub(super) fn scene(&self, indicators: bool) -> Scene<'_> {
        let pose = |body: &Body| {
            let p = body.position();
            Pose { x: p.x, y: p.y, angle: body.angle() }
        };
        let view = |(i, car): (usize, &Car)| CarView {
            hull: pose(self.world.body(car.hull())),
            wheels: car.wheels().each_ref().map(|wheel| (pose(self.world.body(wheel.body())), wheel.phase())),
            is_agent: i == 0,
        };
        let hull = self.hull(0);
        let (p, v) = (hull.position(), hull.velocity());
        let velocity = [f64::from(v.x), f64::from(v.y)];
        let wheels = self.cars[0].wheels();
        let gauges = || Indicators {
            score: self.score,
            speed: speed(hull),
            omegas: wheels.each_ref().map(super::car::Wheel::omega),
            joint_angle: f64::from(self.world.joint_angle(wheels[0].joint())),
            angular_velocity: f64::from(hull.turn_rate()),
        };
        Scene {
            track: &self.track,
            touched: &self.touched,
            chuckholes: &self.chuckholes,
            cars: self.cars.iter().enumerate().map(view).collect(),
            time: self.time,
            camera: Camera { x: f64::from(p.x), y: f64::from(p.y), angle: f64::from(hull.angle()), velocity },
            indicators: indicators.then(gauges),
        }
    }

    /// The node nearest to a car's hull; of equals the first.
    pub(super) fn nearest_node(&self, car: usize) -> usize {
        let p = self.hull(car).position();
        self.nearest_node_to([f64::from(p.x), f64::from(p.y)])
    }

    fn nearest_node_to(&self, [x, y]: [f64; 2]) -> usize {
        let (mut nearest, mut least) = (0, f64::MAX);
        for (i, node) in self.track.nodes.iter().enumerate() {
            let (dx, dy) = (node.x - x, node.y - y);
            let distance = dx * dx + dy * dy;
            if distance < least {
                (nearest, least) = (i, distance);
            }
        }
        nearest
    }

    /// Where a place is on the road: its nearest node, and how far it is in units beyond and right of that node.
    fn on_road(&self, at: [f64; 2]) -> (usize, [f64; 2]) {
        let q = self.nearest_node_to(at);
        let node = &self.track.nodes[q];
        let (s, c) = (trig::sin(node.beta), trig::cos(node.beta));
        let (x, y) = (at[0] - node.x, at[1] - node.y);
        (q, [c * y - s * x, c * x + s * y])
    }

    /// The next of `all` obstacles (number, center, units a second) ahead of the agent's car or beside it.
    pub(super) fn next_obstacle(
        &self,
        all: impl Iterator<Item = (usize, [f64; 2], f64)>,
    ) -> Option<Obstacle> {
        let (n, p) = (self.track.nodes.len() as i64, self.hull(0).position());
        let (here, [beyond, _]) = self.on_road([f64::from(p.x), f64::from(p.y)]);
        let see = |(id, at, speed): (usize, [f64; 2], f64)| {
            let (node, [further, lateral]) = self.on_road(at);
            let n_nodes = (node as i64 - here as i64 + n / 2).rem_euclid(n) - n / 2;
            let ahead = (n_nodes as f64 * NODE_STEP + further - beyond) as f32;
            Obstacle { id, ahead, lateral: lateral as f32, speed: speed as f32 }
        };
        let ahead = all.map(see).filter(|obstacle| (-BESIDE..SIGHT).contains(&obstacle.ahead));
        ahead.min_by(|a, b| a.ahead.total_cmp(&b.ahead))
    }

    /// What the simulator knows of the agent's car.
    pub(super) fn truth(&self) -> Truth {
        let hull = self.hull(0);
        let (p, v) = (hull.position(), hull.velocity());
        let q = self.nearest_node(0);
        let nodes = &self.track.nodes;
        let node = &nodes[q];
        let (s, c) = (trig::sin(node.beta), trig::cos(node.beta));
        // The road leads along (−s, c), and (c, s) points to its right.
        let along = |x: f64, y: f64| c * y - s * x;
        let across = |x: f64, y: f64| c * x + s * y;
        let (vx, vy) = (f64::from(v.x), f64::from(v.y));
        let bend = |ahead: usize| {
            let turn = |i: usize| {
                let (here, next) = (&nodes[(q + i) % nodes.len()], &nodes[(q + i + 1) % nodes.len()]);
                wrap(next.beta - here.beta)
            };
            (0..ahead).map(turn).sum::<f64>() as f32
        };
        Truth {
            position: [p.x, p.y],
            angle: hull.angle(),
            speed: speed(hull) as f32,
            road_velocity: [along(vx, vy) as f32, across(vx, vy) as f32],
            lateral: across(f64::from(p.x) - node.x, f64::from(p.y) - node.y) as f32,
            heading_error: wrap(f64::from(hull.angle()) - node.beta) as f32,
            bends: [5, 10, 20].map(bend),
            node: q,
            n_nodes: nodes.len(),
            n_visited: self.n_visited,
            wheels_off: self.cars[0].wheels().iter().filter(|wheel| !wheel.on_road()).count() as u8,
            ..Truth::default()
        }
    }
}

/// How fast a body moves, units a second.
pub(super) fn speed(body: &Body) -> f64 {
    let v = body.velocity();
    let (x, y) = (f64::from(v.x), f64::from(v.y));
    (x * x + y * y).sqrt()
}

/// An angle moved by full turns to `[-π, π)`.
pub(super) fn wrap(angle: f64) -> f64 {
    (angle + PI).rem_euclid(2.0 * PI) - PI
}

/// An action in double precision: steer, gas and brake.
pub(super) fn controls(action: CarAction) -> [f64; 3] {
    action.to_array().map(f64::from)
}
