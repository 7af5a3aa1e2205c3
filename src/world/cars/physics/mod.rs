//! A small rigid-body world after Box2D 2.3: cars of polygons on revolute joints, and sensors that notice them.
//!
//! It follows Box2D's numerical scheme operation by operation, in single precision, so that an episode equals one of
//! the Python environment to the last bit. `tests/golden_env.rs` compares them. What the environments do not use is
//! left out: gravity, damping, restitution, other joints, continuous collision.
//! By hand on purpose: engines of the registry, such as `rapier2d`, solve in other ways and come to other numbers.
//!
//! This is an altered version of Box2D, rewritten in Rust. Box2D's notice is in `assets/licenses/Box2D.txt`.

mod body;
mod contact;
mod island;
mod joint;
mod manifold;
mod math;
mod motion;
mod shape;

pub use body::{Body, BodyId, Filter};
pub use joint::{JointDef, JointId};
pub use math::{Rot, Transform, Vec2};
pub use shape::{MAX_VERTICES, MassData, Polygon, SKIN, Shape};

use std::ops::Range;

use self::body::{Fixture, fatten};
use self::contact::Contact;
use self::island::Island;
use self::joint::Joint;
use self::manifold::Manifold;
use self::shape::Aabb;
use crate::world::cars::trig::Trig;

/// Seconds a step.
const DT: f32 = 0.02;
/// How far a box reaches ahead: so many displacements.
const AHEAD: f32 = 2.0;

/// Two fixtures began or ceased to touch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Touch {
    /// Whether they began to touch.
    pub begins: bool,
    /// Number of the one created first.
    pub a: usize,
    /// Number of the other.
    pub b: usize,
}

/// Bodies, joints and contacts. Fixtures are numbered in order of creation.
#[derive(Clone, Debug)]
pub struct World {
    trig: Trig,
    /// The first is the ground.
    bodies: Vec<Body>,
    fixtures: Vec<Fixture>,
    fat: Vec<Aabb>,
    joints: Vec<Joint>,
    /// The newest is last.
    contacts: Vec<Contact>,
    /// Bit `a · fixtures + b`: whether there is a contact of fixtures a and b.
    paired: Vec<u64>,
    /// Fixtures whose boxes changed since pairs were last looked for.
    moved: Vec<usize>,
    inv_dt_before: f32,
    touches: Vec<Touch>,
    // Memory that steps share.
    pairs: Vec<(usize, usize)>,
    seen: Vec<Polygon>,
    solid: Vec<usize>,
    stack: Vec<usize>,
    island: Island,
}

impl World {
    /// A world with nothing but the ground.
    pub fn new(trig: Trig) -> Self {
        Self {
            trig,
            bodies: vec![Body::ground()],
            fixtures: Vec::new(),
            fat: Vec::new(),
            joints: Vec::new(),
            contacts: Vec::new(),
            paired: Vec::new(),
            moved: Vec::new(),
            inv_dt_before: 0.0,
            touches: Vec::new(),
            pairs: Vec::new(),
            seen: Vec::new(),
            solid: Vec::new(),
            stack: Vec::new(),
            island: Island::default(),
        }
    }

    /// Adds a sensor to the ground and returns its fixture number.
    pub fn add_sensor(&mut self, shape: Shape) -> usize {
        self.add_fixture(Fixture { body: 0, shape, sensor: true, filter: Filter::DEFAULT })
    }

    /// Adds a body made of `polygons` of one density, each a fixture. Returns it with its fixture numbers.
    pub fn add_body(
        &mut self,
        position: Vec2,
        angle: f32,
        polygons: &[Polygon],
        density: f32,
        filter: Filter,
    ) -> (BodyId, Range<usize>) {
        let id = self.bodies.len();
        let mut body = Body::dynamic(position, angle, self.trig);
        body.set_mass(polygons, density);
        body.fixtures = self.fixtures.len()..self.fixtures.len() + polygons.len();
        let fixtures = body.fixtures.clone();
        self.bodies.push(body);
        for &polygon in polygons {
            self.add_fixture(Fixture { body: id, shape: Shape::Polygon(polygon), sensor: false, filter });
        }
        (BodyId(id), fixtures)
    }

    fn add_fixture(&mut self, fixture: Fixture) -> usize {
        let idx = self.fixtures.len();
        self.fat.push(fatten(fixture.shape.bounds(self.bodies[fixture.body].xf)));
        self.fixtures.push(fixture);
        self.moved.push(idx);
        idx
    }

    /// Ties body `b` at its origin to body `a`.
    pub fn add_joint(&mut self, a: BodyId, b: BodyId, def: JointDef) -> JointId {
        self.joints.push(Joint::new(a.0, b.0, def));
        JointId(self.joints.len() - 1)
    }

    /// A body.
    pub fn body(&self, id: BodyId) -> &Body {
        &self.bodies[id.0]
    }

    /// How far the second body of a joint is turned against the first, in radians.
    pub fn joint_angle(&self, id: JointId) -> f32 {
        let joint = &self.joints[id.0];
        self.bodies[joint.b].angle - self.bodies[joint.a].angle
    }

    /// Sets the speed that a joint's motor aims at, in radians a second, and wakes both bodies.
    pub fn set_motor_speed(&mut self, id: JointId, speed: f32) {
        let joint = &mut self.joints[id.0];
        joint.speed = speed;
        self.bodies[joint.a].wake();
        self.bodies[joint.b].wake();
    }

    /// Pushes a body at its center of mass until the end of the step, and wakes it.
    pub fn apply_force(&mut self, id: BodyId, force: Vec2) {
        let body = &mut self.bodies[id.0];
        body.wake();
        body.force += force;
    }

    /// Gives a body another velocity, and wakes it unless that is zero.
    pub fn set_velocity(&mut self, id: BodyId, v: Vec2) {
        let body = &mut self.bodies[id.0];
        if v.dot(v) > 0.0 {
            body.wake();
        }
        body.v = v;
    }

    /// Moves everything on by 0.02 s. Returns what began or ceased to touch, judged by the poses before the step.
    pub fn step(&mut self) -> &[Touch] {
        let side = self.fixtures.len();
        if self.paired.len() * 64 < side * side {
            self.grow_pairs();
        }
        // Sensors are created before the first step. Afterwards, only step itself moves boxes.
        self.find_pairs();
        self.touches.clear();
        self.update_contacts();
        self.solve();
        self.refresh_boxes();
        self.find_pairs();
        self.inv_dt_before = 1.0 / DT;
        for body in &mut self.bodies {
            body.force = Vec2::default();
        }
        &self.touches
    }

    fn grow_pairs(&mut self) {
        let side = self.fixtures.len();
        self.paired = vec![0; (side * side).div_ceil(64)];
        for i in 0..self.contacts.len() {
            let (a, b) = (self.contacts[i].a, self.contacts[i].b);
            self.set_paired(a, b, true);
        }
    }

    fn is_paired(&self, a: usize, b: usize) -> bool {
        let bit = a * self.fixtures.len() + b;
        self.paired[bit / 64] >> (bit % 64) & 1 == 1
    }

    fn set_paired(&mut self, a: usize, b: usize, paired: bool) {
        let bit = a * self.fixtures.len() + b;
        let mask = 1 << (bit % 64);
        if paired {
            self.paired[bit / 64] |= mask;
        } else {
            self.paired[bit / 64] &= !mask;
        }
    }

    /// Makes contacts of the moved fixtures with all whose boxes they overlap, in order of fixture numbers.
    fn find_pairs(&mut self) {
        self.pairs.clear();
        for &one in &self.moved {
            if !self.bodies[self.fixtures[one].body].dynamic {
                continue; // whatever dynamic overlaps a new sensor is new as well
            }
            let fat = self.fat[one];
            for (two, other) in self.fat.iter().enumerate() {
                if fat.overlaps(*other) && two != one {
                    self.pairs.push((one.min(two), one.max(two)));
                }
            }
        }
        self.moved.clear();
        self.pairs.sort_unstable();
        self.pairs.dedup();
        for i in 0..self.pairs.len() {
            let (a, b) = self.pairs[i];
            if self.is_paired(a, b) || !self.may_touch(a, b) {
                continue;
            }
            self.set_paired(a, b, true);
            let sensor = self.fixtures[a].sensor || self.fixtures[b].sensor;
            let manifold = Manifold::default();
            self.contacts.push(Contact { a, b, sensor, touching: false, in_island: false, manifold });
            if !sensor {
                self.wake_both(a, b);
            }
        }
    }

    fn may_touch(&self, a: usize, b: usize) -> bool {
        let (a, b) = (&self.fixtures[a], &self.fixtures[b]);
        let tied = |one, two| self.joints.iter().any(|joint| joint.a == one && joint.b == two);
        a.body != b.body && a.filter.meets(b.filter) && !tied(a.body, b.body) && !tied(b.body, a.body)
    }

    fn wake_both(&mut self, a: usize, b: usize) {
        self.bodies[self.fixtures[a].body].wake();
        self.bodies[self.fixtures[b].body].wake();
    }

    /// Looks at every contact, newest first: drops it, or notes whether its shapes touch now.
    fn update_contacts(&mut self) {
        self.see_polygons();
        for i in (0..self.contacts.len()).rev() {
            let Contact { a, b, sensor, touching: before, .. } = self.contacts[i];
            let active = |fixture: usize| {
                let body = &self.bodies[self.fixtures[fixture].body];
                body.awake && body.dynamic
            };
            if !active(a) && !active(b) {
                continue;
            }
            if !self.fat[a].overlaps(self.fat[b]) {
                if before {
                    self.touches.push(Touch { begins: false, a, b });
                    if !sensor {
                        self.wake_both(a, b);
                    }
                }
                self.set_paired(a, b, false);
                self.contacts.remove(i);
                continue;
            }
            let touching = if sensor {
                self.fixtures[a].shape.touches(&self.seen[b])
            } else {
                let seen = |fixture: usize| {
                    let fixture = &self.fixtures[fixture];
                    (fixture.polygon(), self.bodies[fixture.body].xf)
                };
                let manifold = Manifold::between(seen(a), seen(b), &self.contacts[i].manifold);
                let touching = manifold.count > 0;
                self.contacts[i].manifold = manifold;
                if touching != before {
                    self.wake_both(a, b);
                }
                touching
            };
            self.contacts[i].touching = touching;
            if touching != before {
                self.touches.push(Touch { begins: touching, a, b });
            }
        }
    }

    /// Puts the polygons of dynamic bodies where the world sees them.
    fn see_polygons(&mut self) {
        if self.seen.len() != self.fixtures.len() {
            // Sensors are always the first of a contact: their places are never looked at.
            let nowhere = Polygon::hull(&[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]);
            self.seen = vec![nowhere; self.fixtures.len()];
        }
        for body in self.bodies.iter().filter(|body| body.dynamic) {
            for i in body.fixtures.clone() {
                self.seen[i] = self.fixtures[i].polygon().transformed(body.xf);
            }
        }
    }

    /// Gathers what is tied together, newest body first, and solves each such island.
    fn solve(&mut self) {
        for body in &mut self.bodies {
            body.in_island = false;
        }
        for joint in &mut self.joints {
            joint.in_island = false;
        }
        self.solid.clear();
        for i in (0..self.contacts.len()).rev() {
            let contact = &mut self.contacts[i];
            contact.in_island = false;
            if contact.touching && !contact.sensor {
                self.solid.push(i);
            }
        }
        for seed in (0..self.bodies.len()).rev() {
            let body = &mut self.bodies[seed];
            if body.in_island || !body.awake || !body.dynamic {
                continue;
            }
            body.in_island = true;
            self.stack.push(seed);
            self.gather();
            let fixtures = &self.fixtures;
            let given = (DT, self.inv_dt_before * DT, self.trig);
            let body_of = |fixture: usize| fixtures[fixture].body;
            self.island.solve(&mut self.bodies, &mut self.joints, &mut self.contacts, body_of, given);
        }
    }

    /// Fills the island from the stack.
    fn gather(&mut self) {
        let Self { island, stack, bodies, joints, contacts, fixtures, solid, .. } = self;
        island.clear();
        while let Some(b) = stack.pop() {
            island.bodies.push(b);
            bodies[b].wake();
            let mut reach = |other: usize, bodies: &mut [Body]| {
                if !bodies[other].in_island {
                    bodies[other].in_island = true;
                    stack.push(other);
                }
            };
            for &i in &*solid {
                let contact = &mut contacts[i];
                let (one, two) = (fixtures[contact.a].body, fixtures[contact.b].body);
                if !contact.in_island && (one == b || two == b) {
                    contact.in_island = true;
                    island.contacts.push(i);
                    reach(if one == b { two } else { one }, bodies);
                }
            }
            for (i, joint) in joints.iter_mut().enumerate().rev() {
                if !joint.in_island && (joint.a == b || joint.b == b) {
                    joint.in_island = true;
                    island.joints.push(i);
                    reach(if joint.a == b { joint.b } else { joint.a }, bodies);
                }
            }
        }
    }

    /// Lets the fat boxes follow the bodies that moved out of them.
    fn refresh_boxes(&mut self) {
        for body in self.bodies.iter().rev().filter(|body| body.in_island) {
            let before = Transform::around(
                body.center_before,
                Rot::new(body.angle_before, self.trig),
                body.local_center,
            );
            let shift = body.xf.p - before.p;
            for i in body.fixtures.clone() {
                let shape = &self.fixtures[i].shape;
                let swept = shape.bounds(before).union(shape.bounds(body.xf));
                if !self.fat[i].contains(swept) {
                    self.fat[i] = fatten(swept).stretched(AHEAD * shift);
                    self.moved.push(i);
                }
            }
        }
    }
}
