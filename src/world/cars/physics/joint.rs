//! Revolute joints with a motor and limits: how wheels hang on a hull.

use super::math::{Rot, Vec2, clamp, solve_symmetric};
use super::motion::{Position, Velocity};
use crate::world::cars::trig::Trig;

/// The number of a joint in its world.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct JointId(pub(super) usize);

const PI: f32 = std::f32::consts::PI;
const LINEAR_SLOP: f32 = 0.005;
const ANGULAR_SLOP: f32 = 2.0 / 180.0 * PI;
const MAX_ANGULAR_CORRECTION: f32 = 8.0 / 180.0 * PI;

/// What a joint is made from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointDef {
    /// Where it sits on the first body, in that body's frame. It sits on the second body's origin.
    pub anchor: Vec2,
    /// It turns in `[-limit, limit]` radians.
    pub limit: f32,
    /// The most torque that its motor gives.
    pub max_torque: f32,
}

/// Where the joint stands within its limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Limit {
    Free,
    Lower,
    Upper,
}

/// What a joint has pushed with in a step, kept to start the next one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct JointImpulse {
    xy: Vec2,
    z: f32,
    motor: f32,
}

impl JointImpulse {
    /// Equality to the last bit.
    #[inline]
    pub(super) fn same(self, other: Self) -> bool {
        self.xy.x.to_bits() == other.xy.x.to_bits()
            && self.xy.y.to_bits() == other.xy.y.to_bits()
            && self.z.to_bits() == other.z.to_bits()
            && self.motor.to_bits() == other.motor.to_bits()
    }
}

/// A joint between two bodies.
#[derive(Clone, Debug)]
pub(super) struct Joint {
    pub(super) a: usize,
    pub(super) b: usize,
    pub(super) def: JointDef,
    /// The motor's target in radians a second.
    pub(super) speed: f32,
    pub(super) impulse: JointImpulse,
    state: Limit,
    pub(super) in_island: bool,
}

impl Joint {
    pub(super) fn new(a: usize, b: usize, def: JointDef) -> Self {
        let impulse = JointImpulse::default();
        Self { a, b, def, speed: 0.0, impulse, state: Limit::Free, in_island: false }
    }
}

/// What stays the same in a joint over the iterations of a step.
#[derive(Clone, Debug)]
pub(super) struct JointRow {
    joint: usize,
    ia: usize,
    ib: usize,
    ra: Vec2,
    rb: Vec2,
    m_a: f32,
    m_b: f32,
    i_a: f32,
    i_b: f32,
    k11: f32,
    k12: f32,
    k13: f32,
    k22: f32,
    k23: f32,
    k33: f32,
    det2: f32,
    motor_mass: f32,
    speed: f32,
    max_motor: f32,
    state: Limit,
    anchor: Vec2,
    anchor_b: Vec2,
    limit: f32,
}

impl JointRow {
    /// Prepares a step and applies last step's impulses.
    pub(super) fn new(
        joint_idx: usize,
        joint: &mut Joint,
        [(ia, a), (ib, b)]: [(usize, &super::Body); 2],
        positions: &[Position],
        velocities: &mut [Velocity],
        (dt, dt_ratio, trig): (f32, f32, Trig),
    ) -> Self {
        let (m_a, m_b, i_a, i_b) = (a.inv_mass, b.inv_mass, a.inv_inertia, b.inv_inertia);
        let (angle_a, angle_b) = (positions[ia].a, positions[ib].a);
        let (anchor, anchor_b) = (joint.def.anchor - a.local_center, Vec2::default() - b.local_center);
        let ra = Rot::new(angle_a, trig).apply(anchor);
        let rb = Rot::new(angle_b, trig).apply(anchor_b);
        let k11 = m_a + m_b + ra.y * ra.y * i_a + rb.y * rb.y * i_b;
        let k12 = -ra.y * ra.x * i_a - rb.y * rb.x * i_b;
        let k13 = -ra.y * i_a - rb.y * i_b;
        let k22 = m_a + m_b + ra.x * ra.x * i_a + rb.x * rb.x * i_b;
        let k23 = ra.x * i_a + rb.x * i_b;
        let k33 = i_a + i_b;
        let limit = joint.def.limit;
        let angle = angle_b - angle_a;
        let state = if angle <= -limit {
            Limit::Lower
        } else if angle >= limit {
            Limit::Upper
        } else {
            Limit::Free
        };
        if state != joint.state || state == Limit::Free {
            joint.impulse.z = 0.0;
        }
        joint.state = state;

        let impulse = &mut joint.impulse;
        impulse.xy = dt_ratio * impulse.xy;
        impulse.z *= dt_ratio;
        impulse.motor *= dt_ratio;
        let p = impulse.xy;
        velocities[ia].v -= m_a * p;
        velocities[ia].w -= i_a * (ra.cross(p) + impulse.motor + impulse.z);
        velocities[ib].v += m_b * p;
        velocities[ib].w += i_b * (rb.cross(p) + impulse.motor + impulse.z);
        Self {
            joint: joint_idx,
            ia,
            ib,
            ra,
            rb,
            m_a,
            m_b,
            i_a,
            i_b,
            k11,
            k12,
            k13,
            k22,
            k23,
            k33,
            det2: 1.0 / (k11 * k22 - k12 * k12),
            motor_mass: 1.0 / k33,
            speed: joint.speed,
            max_motor: dt * joint.def.max_torque,
            state,
            anchor,
            anchor_b,
            limit,
        }
    }

    /// Which joint this is.
    pub(super) fn joint(&self) -> usize {
        self.joint
    }

    /// One velocity iteration.
    #[inline]
    pub(super) fn solve_velocity(&self, velocities: &mut [Velocity], total: &mut JointImpulse) {
        let (mut a, mut b) = (velocities[self.ia], velocities[self.ib]);
        let before = total.motor;
        let push = -self.motor_mass * (b.w - a.w - self.speed);
        total.motor = clamp(before + push, -self.max_motor, self.max_motor);
        let push = total.motor - before;
        a.w -= self.i_a * push;
        b.w += self.i_b * push;

        let slip = b.v + self.rb.spun(b.w) - a.v - self.ra.spun(a.w);
        if self.state == Limit::Free {
            let p = self.solve2(-slip);
            total.xy += p;
            a.v -= self.m_a * p;
            a.w -= self.i_a * self.ra.cross(p);
            b.v += self.m_b * p;
            b.w += self.i_b * self.rb.cross(p);
        } else {
            let (p, z) = self.solve_at_limit(slip, b.w - a.w, total);
            a.v -= self.m_a * p;
            a.w -= self.i_a * (self.ra.cross(p) + z);
            b.v += self.m_b * p;
            b.w += self.i_b * (self.rb.cross(p) + z);
        }
        velocities[self.ia] = a;
        velocities[self.ib] = b;
    }

    fn solve_at_limit(&self, slip: Vec2, turn: f32, total: &mut JointImpulse) -> (Vec2, f32) {
        let [x, y, z] = self.solve3(slip, turn).map(|component| -component);
        let after = total.z + z;
        let leaves = if self.state == Limit::Lower { after < 0.0 } else { after > 0.0 };
        if leaves {
            let p = self.solve2(-slip + total.z * Vec2::new(self.k13, self.k23));
            let z = -total.z;
            total.xy += p;
            total.z = 0.0;
            (p, z)
        } else {
            total.xy += Vec2::new(x, y);
            total.z = after;
            (Vec2::new(x, y), z)
        }
    }

    #[inline]
    fn solve2(&self, b: Vec2) -> Vec2 {
        solve_symmetric(self.det2, self.k11, self.k12, self.k22, b)
    }

    /// Solves the whole 3 × 3 system by Cramer's rule.
    fn solve3(&self, b: Vec2, b_z: f32) -> [f32; 3] {
        let (ex, ey, ez) =
            ([self.k11, self.k12, self.k13], [self.k12, self.k22, self.k23], [self.k13, self.k23, self.k33]);
        let b = [b.x, b.y, b_z];
        let ey_ez = cross3(ey, ez);
        let det = 1.0 / dot3(ex, ey_ez);
        [det * dot3(b, ey_ez), det * dot3(ex, cross3(b, ez)), det * dot3(ex, cross3(ey, b))]
    }

    /// One position iteration. Says whether the joint is in place.
    pub(super) fn solve_position(&self, positions: &mut [Position], trig: Trig) -> bool {
        let (mut a, mut b) = (positions[self.ia], positions[self.ib]);
        let mut angular_error = 0.0;
        if self.state != Limit::Free {
            let angle = b.a - a.a;
            let correction = if self.state == Limit::Lower {
                let c = angle + self.limit;
                angular_error = -c;
                clamp(c + ANGULAR_SLOP, -MAX_ANGULAR_CORRECTION, 0.0)
            } else {
                let c = angle - self.limit;
                angular_error = c;
                clamp(c - ANGULAR_SLOP, 0.0, MAX_ANGULAR_CORRECTION)
            };
            let push = -self.motor_mass * correction;
            a.a -= self.i_a * push;
            b.a += self.i_b * push;
        }
        let ra = Rot::new(a.a, trig).apply(self.anchor);
        let rb = Rot::new(b.a, trig).apply(self.anchor_b);
        let gap = b.c + rb - a.c - ra;
        let (m_a, m_b, i_a, i_b) = (self.m_a, self.m_b, self.i_a, self.i_b);
        let k11 = m_a + m_b + i_a * ra.y * ra.y + i_b * rb.y * rb.y;
        let k12 = -i_a * ra.x * ra.y - i_b * rb.x * rb.y;
        let k22 = m_a + m_b + i_a * ra.x * ra.x + i_b * rb.x * rb.x;
        let p = -solve_symmetric(1.0 / (k11 * k22 - k12 * k12), k11, k12, k22, gap);
        a.c -= m_a * p;
        a.a -= i_a * ra.cross(p);
        b.c += m_b * p;
        b.a += i_b * rb.cross(p);
        positions[self.ia] = a;
        positions[self.ib] = b;
        gap.length() <= LINEAR_SLOP && angular_error <= ANGULAR_SLOP
    }
}

#[inline]
fn dot3(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline]
fn cross3(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
