//! Where a body is and how it moves while an island is solved.

use super::math::Vec2;

/// Center of mass and angle while an island is solved.
#[derive(Clone, Copy, Debug)]
pub(super) struct Position {
    pub(super) c: Vec2,
    pub(super) a: f32,
}

/// Linear and angular velocity while an island is solved.
#[derive(Clone, Copy, Debug)]
pub(super) struct Velocity {
    pub(super) v: Vec2,
    pub(super) w: f32,
}

impl Velocity {
    /// Equality to the last bit.
    #[inline]
    pub(super) fn same(self, other: Self) -> bool {
        self.v.x.to_bits() == other.v.x.to_bits()
            && self.v.y.to_bits() == other.v.y.to_bits()
            && self.w.to_bits() == other.w.to_bits()
    }
}
