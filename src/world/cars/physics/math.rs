//! Vectors, rotations and rigid transforms in single precision, in Box2D's order of operations.

use std::ops::{Add, AddAssign, Mul, Neg, Sub, SubAssign};

use crate::world::cars::trig::Trig;

/// A vector or point of the plane in world units.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Vec2 {
    /// Right.
    pub x: f32,
    /// Up.
    pub y: f32,
}

impl Vec2 {
    /// The vector `(x, y)`.
    #[inline]
    pub const fn new(x: f32, y: f32) -> Self {
        Self { x, y }
    }

    /// The vector nearest to `(x, y)`.
    #[inline]
    pub const fn from_f64([x, y]: [f64; 2]) -> Self {
        Self { x: x as f32, y: y as f32 }
    }

    /// Scalar product.
    #[inline]
    pub fn dot(self, other: Self) -> f32 {
        self.x * other.x + self.y * other.y
    }

    /// The third component of the vector product.
    #[inline]
    pub fn cross(self, other: Self) -> f32 {
        self.x * other.y - self.y * other.x
    }

    /// The vector turned by a right angle clockwise: `self × 1`.
    #[inline]
    #[must_use]
    pub fn right(self) -> Self {
        Self::new(self.y, -self.x)
    }

    /// The velocity that a turn rate `w` gives to the arm `self`: `w × self`.
    #[inline]
    #[must_use]
    pub fn spun(self, w: f32) -> Self {
        Self::new(-w * self.y, w * self.x)
    }

    /// Euclidean length.
    #[inline]
    pub fn length(self) -> f32 {
        self.dot(self).sqrt()
    }

    /// The vector multiplied by one over its length.
    #[inline]
    #[must_use]
    pub fn normalized(self) -> Self {
        (1.0 / self.length()) * self
    }
}

impl Add for Vec2 {
    type Output = Self;
    #[inline]
    fn add(self, other: Self) -> Self {
        Self::new(self.x + other.x, self.y + other.y)
    }
}

impl Sub for Vec2 {
    type Output = Self;
    #[inline]
    fn sub(self, other: Self) -> Self {
        Self::new(self.x - other.x, self.y - other.y)
    }
}

impl Neg for Vec2 {
    type Output = Self;
    #[inline]
    fn neg(self) -> Self {
        Self::new(-self.x, -self.y)
    }
}

impl Mul<Vec2> for f32 {
    type Output = Vec2;
    #[inline]
    fn mul(self, v: Vec2) -> Vec2 {
        Vec2::new(self * v.x, self * v.y)
    }
}

impl AddAssign for Vec2 {
    #[inline]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl SubAssign for Vec2 {
    #[inline]
    fn sub_assign(&mut self, other: Self) {
        *self = *self - other;
    }
}

/// A rotation as sine and cosine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rot {
    /// Sine of the angle.
    pub s: f32,
    /// Cosine of the angle.
    pub c: f32,
}

impl Rot {
    /// The rotation by `angle` radians.
    #[inline]
    pub fn new(angle: f32, trig: Trig) -> Self {
        let (s, c) = trig.sin_cos(angle);
        Self { s, c }
    }

    /// Turns `v`.
    #[inline]
    pub fn apply(self, v: Vec2) -> Vec2 {
        Vec2::new(self.c * v.x - self.s * v.y, self.s * v.x + self.c * v.y)
    }

    /// Turns `v` back.
    #[inline]
    pub fn undo(self, v: Vec2) -> Vec2 {
        Vec2::new(self.c * v.x + self.s * v.y, -self.s * v.x + self.c * v.y)
    }
}

/// A rotation followed by a shift.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transform {
    /// Shift.
    pub p: Vec2,
    /// Rotation.
    pub q: Rot,
}

impl Transform {
    /// The transform that leaves everything where it is.
    pub const IDENTITY: Self = Self { p: Vec2::new(0.0, 0.0), q: Rot { s: 0.0, c: 1.0 } };

    /// The transform of a body whose center of mass, `local_center` in its own frame, is at `center`.
    #[inline]
    pub fn around(center: Vec2, q: Rot, local_center: Vec2) -> Self {
        Self { p: center - q.apply(local_center), q }
    }

    /// From body to world.
    #[inline]
    pub fn apply(self, v: Vec2) -> Vec2 {
        Vec2::new((self.q.c * v.x - self.q.s * v.y) + self.p.x, (self.q.s * v.x + self.q.c * v.y) + self.p.y)
    }

    /// From world to body.
    #[inline]
    pub fn undo(self, v: Vec2) -> Vec2 {
        self.q.undo(v - self.p)
    }
}

/// Solves `[a11 a12; a12 a22] x = b`, given the reciprocal determinant.
#[inline]
pub(super) fn solve_symmetric(det: f32, a11: f32, a12: f32, a22: f32, b: Vec2) -> Vec2 {
    Vec2::new(det * (a22 * b.x - a12 * b.y), det * (a11 * b.y - a12 * b.x))
}

/// `x` cut to `[lo, hi]` as Box2D does it.
#[inline]
pub(super) fn clamp(x: f32, lo: f32, hi: f32) -> f32 {
    x.min(hi).max(lo)
}
