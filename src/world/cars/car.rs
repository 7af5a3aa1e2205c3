//! A car: a hull, four wheels, an engine that drives the rear ones and brakes on all.
//!
//! Constants and rules are those of gym's `car_dynamics.py` (MIT notice in `assets/licenses/gym.txt`). Lengths in
//! world units, angles in radians counter-clockwise, a car at angle 0 points along +y.

use super::physics::{BodyId, Filter, JointDef, JointId, MAX_VERTICES, Polygon, Vec2, World};

/// World units a car unit.
pub const SIZE: f64 = 0.02;
/// Seconds a step.
const DT: f64 = 1.0 / 50.0;
const ENGINE_POWER: f64 = 100_000_000.0 * SIZE * SIZE;
/// The inertia of a wheel's spin: bookkeeping beside the physics.
const SPIN_INERTIA: f64 = 4000.0 * SIZE * SIZE;
/// The most force that a wheel on the road gives.
const FRICTION_LIMIT: f64 = 1_000_000.0 * SIZE * SIZE;
const GRASS_FRICTION_LIMIT: f64 = FRICTION_LIMIT * 0.6;
const STIFFNESS: f64 = 205_000.0;
const WHEEL_RADIUS: f64 = 27.0 * SIZE;
const MAX_MOTOR_TORQUE: f64 = 180.0 * 900.0 * SIZE * SIZE;
/// At this brake and above the wheels lock.
const LOCKING_BRAKE: f64 = 0.9;
/// What a full brake takes off a wheel's spin in a step, radians a second.
const BRAKE_FORCE: f64 = 15.0;
/// The most that gas rises by in a call.
const GAS_RAMP: f64 = 0.1;

/// The four convex parts of a hull, in car units.
pub const HULL: [&[[f64; 2]]; 4] = [
    &[[-60.0, 130.0], [60.0, 130.0], [60.0, 110.0], [-60.0, 110.0]],
    &[[-15.0, 120.0], [15.0, 120.0], [20.0, 20.0], [-20.0, 20.0]],
    &[
        [25.0, 20.0],
        [50.0, -10.0],
        [50.0, -40.0],
        [20.0, -90.0],
        [-20.0, -90.0],
        [-50.0, -40.0],
        [-50.0, -10.0],
        [-25.0, 20.0],
    ],
    &[[-50.0, -120.0], [50.0, -120.0], [50.0, -90.0], [-50.0, -90.0]],
];
/// A wheel, in car units.
pub const WHEEL: [[f64; 2]; 4] = [[-14.0, 27.0], [14.0, 27.0], [14.0, -27.0], [-14.0, -27.0]];
/// Where the wheels sit: front left, front right, rear left, rear right, in car units.
pub const WHEEL_SEATS: [[f64; 2]; 4] = [[-55.0, 80.0], [55.0, 80.0], [-55.0, -82.0], [55.0, -82.0]];

const HULL_DENSITY: f32 = 1.0;
const WHEEL_DENSITY: f32 = 0.1;
/// Wheels meet hulls, tiles and chuckholes, but not wheels.
const WHEEL_FILTER: Filter = Filter { category: 0x0020, mask: 0x0001 };

/// A wheel.
#[derive(Clone, Debug)]
pub struct Wheel {
    body: BodyId,
    joint: JointId,
    gas: f64,
    brake: f64,
    /// The steering angle that is aimed at, in radians.
    steer: f64,
    phase: f64,
    omega: f64,
    /// The tiles that it touches.
    tiles: Vec<usize>,
}

impl Wheel {
    /// Its body.
    pub fn body(&self) -> BodyId {
        self.body
    }

    /// The joint that it hangs on.
    pub fn joint(&self) -> JointId {
        self.joint
    }

    /// How far it has rolled, in radians.
    pub fn phase(&self) -> f64 {
        self.phase
    }

    /// How fast it rolls, in radians a second.
    pub fn omega(&self) -> f64 {
        self.omega
    }

    /// Whether it touches a tile.
    pub fn on_road(&self) -> bool {
        !self.tiles.is_empty()
    }

    /// Notes that the wheel touches a tile.
    pub fn enter(&mut self, tile: usize) {
        if !self.tiles.contains(&tile) {
            self.tiles.push(tile);
        }
    }

    /// Notes that the wheel touches a tile no more. Says whether it was the last.
    pub fn leave(&mut self, tile: usize) -> bool {
        self.tiles.retain(|&other| other != tile);
        self.tiles.is_empty()
    }

    /// Rolls and pushes for one step.
    fn step(&mut self, world: &mut World) {
        let error = self.steer - f64::from(world.joint_angle(self.joint));
        world.set_motor_speed(self.joint, (sign(error) * (50.0 * error.abs()).min(3.0)) as f32);

        let limit = if self.on_road() { FRICTION_LIMIT } else { GRASS_FRICTION_LIMIT };
        let body = world.body(self.body);
        let (q, v) = (body.rotation(), body.velocity());
        let forward = [-f64::from(q.s), f64::from(q.c)];
        let side = [f64::from(q.c), f64::from(q.s)];
        let v = [f64::from(v.x), f64::from(v.y)];
        let v_forward = forward[0] * v[0] + forward[1] * v[1];
        let v_side = side[0] * v[0] + side[1] * v[1];

        // The 5 keeps a standing wheel from a division by zero.
        self.omega += DT * ENGINE_POWER * self.gas / SPIN_INERTIA / (self.omega.abs() + 5.0);
        if self.brake >= LOCKING_BRAKE {
            self.omega = 0.0;
        } else if self.brake > 0.0 {
            self.omega += -sign(self.omega) * (BRAKE_FORCE * self.brake).min(self.omega.abs());
        }
        self.phase += self.omega * DT;

        let mut along = (self.omega * WHEEL_RADIUS - v_forward) * (STIFFNESS * SIZE * SIZE);
        let mut across = -v_side * (STIFFNESS * SIZE * SIZE);
        let force = (along * along + across * across).sqrt();
        if force > limit {
            along = along / force * limit;
            across = across / force * limit;
        }
        self.omega -= DT * along * WHEEL_RADIUS / SPIN_INERTIA;
        let push = [across * side[0] + along * forward[0], across * side[1] + along * forward[1]];
        world.apply_force(self.body, Vec2::from_f64(push));
    }
}

/// A car in a world.
#[derive(Clone, Debug)]
pub struct Car {
    hull: BodyId,
    wheels: [Wheel; 4],
}

impl Car {
    /// How many fixtures a car has: the hull's parts, then the wheels.
    pub const N_FIXTURES: usize = HULL.len() + 4;

    /// Puts a car into the world at `[x, y]`, turned by `angle`.
    pub fn new(world: &mut World, [x, y]: [f64; 2], angle: f64) -> Self {
        let at = Vec2::from_f64([x, y]);
        let (hull, _) = world.add_body(at, angle as f32, &HULL.map(polygon), HULL_DENSITY, Filter::DEFAULT);
        let wheels = WHEEL_SEATS.map(|[seat_x, seat_y]| {
            let seat = [seat_x * SIZE, seat_y * SIZE];
            // The seat is not turned with the car, as in gym: the joints pull the wheels into place, with a small kick.
            let at = Vec2::from_f64([x + seat[0], y + seat[1]]);
            let (body, _) = world.add_body(at, angle as f32, &[polygon(&WHEEL)], WHEEL_DENSITY, WHEEL_FILTER);
            let anchor = Vec2::from_f64(seat);
            let def = JointDef { anchor, limit: 0.4, max_torque: MAX_MOTOR_TORQUE as f32 };
            let joint = world.add_joint(hull, body, def);
            Wheel { body, joint, gas: 0.0, brake: 0.0, steer: 0.0, phase: 0.0, omega: 0.0, tiles: Vec::new() }
        });
        Self { hull, wheels }
    }

    /// The body of the hull.
    pub fn hull(&self) -> BodyId {
        self.hull
    }

    /// Front left, front right, rear left, rear right.
    pub fn wheels(&self) -> &[Wheel; 4] {
        &self.wheels
    }

    /// One of the wheels, to note what it touches.
    pub fn wheel_mut(&mut self, i: usize) -> &mut Wheel {
        &mut self.wheels[i]
    }

    /// Throttle in `[0, 1]`: rises by at most 0.1 a call, drops at once.
    pub fn gas(&mut self, gas: f64) {
        let gas = gas.clamp(0.0, 1.0);
        for wheel in &mut self.wheels[2..] {
            wheel.gas += (gas - wheel.gas).min(GAS_RAMP);
        }
    }

    /// Brake in `[0, 1]`. At 0.9 and above the wheels lock.
    pub fn brake(&mut self, brake: f64) {
        for wheel in &mut self.wheels {
            wheel.brake = brake;
        }
    }

    /// Aims the front wheels, in radians. Positive is left, and the joints stop at 0.4.
    pub fn steer(&mut self, angle: f64) {
        for wheel in &mut self.wheels[..2] {
            wheel.steer = angle;
        }
    }

    /// Lets engine, brakes and tires act for one step.
    pub fn step(&mut self, world: &mut World) {
        for wheel in &mut self.wheels {
            wheel.step(world);
        }
    }
}

/// The sign of `x`, 0 for 0.
fn sign(x: f64) -> f64 {
    if x == 0.0 { 0.0 } else { x.signum() }
}

/// A polygon given in car units.
fn polygon(points: &[[f64; 2]]) -> Polygon {
    let mut scaled = [[0.0; 2]; MAX_VERTICES];
    for (to, from) in scaled.iter_mut().zip(points) {
        *to = from.map(|x| x * SIZE);
    }
    Polygon::hull(&scaled[..points.len()])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::cars::trig::Trig;

    /// Steer (right), gas and brake of the recorded lone car, by step.
    fn recorded_controls(step: usize) -> [f64; 3] {
        match step {
            0..60 => [0.0, 0.6, 0.0],
            60..120 => [0.4, 0.2, 0.0],
            120..170 => [-0.7, 0.3, 0.0],
            170..200 => [0.0, 0.0, 0.5],
            200..240 => [-0.2, 1.0, 0.0],
            240..270 => [0.9, 0.0, 0.0],
            _ => [0.3, 0.0, 1.0],
        }
    }

    /// The largest difference from a car recorded in gymnasium 1.4.0 with Box2D 2.3.10.
    ///
    /// Columns: step, hull x, y, angle, vx, vy, w, then for each wheel x, y, angle, joint angle, omega, vx, vy, w.
    fn difference_from(golden: &str, on_road: bool, trig: Trig) -> f64 {
        let mut world = World::new(trig);
        let mut car = Car::new(&mut world, [10.0, -5.0], 0.3);
        if on_road {
            car.wheels.iter_mut().for_each(|wheel| wheel.enter(0));
        }
        let mut worst = 0.0_f64;
        for (step, line) in golden.lines().enumerate() {
            let [steer, gas, brake] = recorded_controls(step);
            car.steer(-steer);
            car.gas(gas);
            car.brake(brake);
            car.step(&mut world);
            world.step();
            let hull = world.body(car.hull);
            let (p, v) = (hull.position(), hull.velocity());
            let mut row = vec![step as f64];
            row.extend([p.x, p.y, hull.angle(), v.x, v.y, hull.turn_rate()].map(f64::from));
            for wheel in &car.wheels {
                let body = world.body(wheel.body);
                let (p, v) = (body.position(), body.velocity());
                row.extend([p.x, p.y, body.angle(), world.joint_angle(wheel.joint)].map(f64::from));
                row.push(wheel.omega);
                row.extend([v.x, v.y, body.turn_rate()].map(f64::from));
            }
            let recorded: Vec<f64> = line.split(',').map(|field| field.parse().unwrap()).collect();
            assert_eq!(row.len(), recorded.len(), "step {step} has all columns");
            worst = row.iter().zip(&recorded).fold(worst, |worst, (a, b)| worst.max((a - b).abs()));
        }
        worst
    }

    const ROAD: &str = include_str!("../../../tests/golden/car_road.csv");
    const GRASS: &str = include_str!("../../../tests/golden/car_grass.csv");

    #[test]
    #[cfg(all(target_os = "linux", target_env = "gnu", target_arch = "x86_64"))]
    fn a_lone_car_drives_as_in_box2d_to_the_last_bit() {
        assert_eq!(difference_from(ROAD, true, Trig::System), 0.0, "on the road");
        assert_eq!(difference_from(GRASS, false, Trig::System), 0.0, "on grass");
    }

    #[test]
    fn a_lone_car_drives_nearly_as_in_box2d_on_every_platform() {
        // The last bit of a sine grows to about 1e-4 units in 300 steps.
        assert!(difference_from(ROAD, true, Trig::Portable) < 1e-3, "on the road");
        assert!(difference_from(GRASS, false, Trig::Portable) < 1e-3, "on grass");
    }
}
