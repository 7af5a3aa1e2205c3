//! Rigid bodies and the fixtures on them.

use super::math::{Rot, Transform, Vec2};
use super::shape::{Aabb, Polygon, Shape};
use crate::world::cars::trig::Trig;

/// The number of a body in its world.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BodyId(pub(super) usize);

/// A rigid body.
#[derive(Clone, Debug)]
pub struct Body {
    pub(super) xf: Transform,
    /// Center of mass in the body's frame.
    pub(super) local_center: Vec2,
    /// Center of mass in the world, now and before the last step.
    pub(super) center: Vec2,
    pub(super) center_before: Vec2,
    /// Angle in radians, now and before the last step.
    pub(super) angle: f32,
    pub(super) angle_before: f32,
    pub(super) v: Vec2,
    pub(super) w: f32,
    pub(super) force: Vec2,
    pub(super) inv_mass: f32,
    pub(super) inv_inertia: f32,
    pub(super) dynamic: bool,
    pub(super) awake: bool,
    pub(super) sleep_secs: f32,
    /// In an island of the present step, and its place there.
    pub(super) in_island: bool,
    pub(super) island_idx: usize,
    /// Its fixtures: a range of fixture numbers.
    pub(super) fixtures: std::ops::Range<usize>,
}

impl Body {
    /// The immovable ground at the origin, which carries all sensors.
    pub(super) fn ground() -> Self {
        Self::at(Transform::IDENTITY, 0.0, false)
    }

    pub(super) fn dynamic(position: Vec2, angle: f32, trig: Trig) -> Self {
        Self::at(Transform { p: position, q: Rot::new(angle, trig) }, angle, true)
    }

    fn at(xf: Transform, angle: f32, dynamic: bool) -> Self {
        Self {
            xf,
            local_center: Vec2::default(),
            center: xf.p,
            center_before: xf.p,
            angle,
            angle_before: angle,
            v: Vec2::default(),
            w: 0.0,
            force: Vec2::default(),
            inv_mass: 0.0,
            inv_inertia: 0.0,
            dynamic,
            awake: dynamic,
            sleep_secs: 0.0,
            in_island: false,
            island_idx: 0,
            fixtures: 0..0,
        }
    }

    /// Sums up the mass of `polygons`, which are in order of creation. The last is counted first.
    pub(super) fn set_mass(&mut self, polygons: &[Polygon], density: f32) {
        let (mut mass, mut center, mut inertia) = (0.0_f32, Vec2::default(), 0.0_f32);
        for polygon in polygons.iter().rev() {
            let part = polygon.mass(density);
            mass += part.mass;
            center += part.mass * part.center;
            inertia += part.inertia;
        }
        self.inv_mass = 1.0 / mass;
        self.local_center = self.inv_mass * center;
        inertia -= mass * self.local_center.dot(self.local_center);
        self.inv_inertia = 1.0 / inertia;
        self.center = self.xf.apply(self.local_center);
        self.center_before = self.center;
    }

    /// Position of the origin in units.
    pub fn position(&self) -> Vec2 {
        self.xf.p
    }

    /// Angle in radians, counter-clockwise, not wrapped.
    pub fn angle(&self) -> f32 {
        self.angle
    }

    /// Velocity of the center of mass in units a second.
    pub fn velocity(&self) -> Vec2 {
        self.v
    }

    /// Turn rate in radians a second.
    pub fn turn_rate(&self) -> f32 {
        self.w
    }

    /// The rotation from the body to the world.
    pub fn rotation(&self) -> Rot {
        self.xf.q
    }

    /// Wakes the body. One that is awake does not notice.
    pub(super) fn wake(&mut self) {
        if !self.awake && self.dynamic {
            self.awake = true;
            self.sleep_secs = 0.0;
        }
    }

    pub(super) fn sleep(&mut self) {
        self.awake = false;
        self.sleep_secs = 0.0;
        self.v = Vec2::default();
        self.w = 0.0;
        self.force = Vec2::default();
    }
}

/// Which other fixtures a fixture collides with: both must accept the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Filter {
    /// What the fixture is.
    pub category: u16,
    /// Which categories it meets.
    pub mask: u16,
}

impl Filter {
    /// Box2D's default: category 1, meets everything.
    pub const DEFAULT: Self = Self { category: 0x0001, mask: 0xFFFF };

    pub(super) fn meets(self, other: Self) -> bool {
        self.mask & other.category != 0 && self.category & other.mask != 0
    }
}

/// A shape on a body.
#[derive(Clone, Debug)]
pub(super) struct Fixture {
    pub(super) body: usize,
    pub(super) shape: Shape,
    pub(super) sensor: bool,
    pub(super) filter: Filter,
}

impl Fixture {
    /// The polygon of a fixture of a dynamic body, which has no other shapes.
    pub(super) fn polygon(&self) -> &Polygon {
        match &self.shape {
            Shape::Polygon(polygon) => polygon,
            Shape::Circle { .. } => unreachable!("only sensors are circles"),
        }
    }
}

/// A box that may be larger than its fixture, so that it need not follow each small motion.
pub(super) fn fatten(bounds: Aabb) -> Aabb {
    bounds.grown(0.1)
}
