//! Solid contacts: cars that hit cars.

use super::manifold::{Manifold, TOTAL_RADIUS};
use super::math::{Rot, Transform, Vec2, clamp};
use super::motion::{Position, Velocity};
use super::shape::SKIN;
use crate::world::cars::trig::Trig;

/// Friction of every car fixture. Two of them mix to the root of their product.
const FRICTION: f32 = 0.2;
const LINEAR_SLOP: f32 = 0.005;
const BAUMGARTE: f32 = 0.2;
const MAX_LINEAR_CORRECTION: f32 = 0.2;
const MAX_CONDITION_NUMBER: f32 = 1000.0;

/// A pair of fixtures whose fat boxes overlap.
#[derive(Clone, Debug)]
pub(super) struct Contact {
    /// Fixture numbers, the lower first.
    pub(super) a: usize,
    pub(super) b: usize,
    pub(super) sensor: bool,
    pub(super) touching: bool,
    pub(super) in_island: bool,
    pub(super) manifold: Manifold,
}

#[derive(Clone, Copy, Debug, Default)]
struct RowPoint {
    ra: Vec2,
    rb: Vec2,
    normal_mass: f32,
    tangent_mass: f32,
    velocity_bias: f32,
    normal_impulse: f32,
    tangent_impulse: f32,
}

/// A symmetric 2 × 2 matrix.
#[derive(Clone, Copy, Debug, Default)]
struct Sym2 {
    xx: f32,
    xy: f32,
    yy: f32,
}

impl Sym2 {
    fn inverse(self) -> Self {
        let mut det = self.xx * self.yy - self.xy * self.xy;
        if det != 0.0 {
            det = 1.0 / det;
        }
        Self { xx: det * self.yy, xy: -det * self.xy, yy: det * self.xx }
    }

    fn apply(self, v: Vec2) -> Vec2 {
        Vec2::new(self.xx * v.x + self.xy * v.y, self.xy * v.x + self.yy * v.y)
    }
}

/// One body as a contact sees it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Side {
    pub(super) idx: usize,
    pub(super) inv_mass: f32,
    pub(super) inv_inertia: f32,
    pub(super) local_center: Vec2,
}

/// A contact prepared for the iterations of a step.
#[derive(Clone, Debug)]
pub(super) struct ContactRow {
    contact: usize,
    a: Side,
    b: Side,
    manifold: Manifold,
    normal: Vec2,
    friction: f32,
    points: [RowPoint; 2],
    /// How many points the velocity solver uses. The position solver uses all of the manifold.
    count: usize,
    k: Sym2,
    k_inverse: Sym2,
}

impl ContactRow {
    pub(super) fn new(
        contact_idx: usize,
        manifold: &Manifold,
        [a, b]: [Side; 2],
        positions: &[Position],
        velocities: &[Velocity],
        (dt_ratio, trig): (f32, Trig),
    ) -> Self {
        let (pos_a, pos_b) = (positions[a.idx], positions[b.idx]);
        let (vel_a, vel_b) = (velocities[a.idx], velocities[b.idx]);
        let xf_a = Transform::around(pos_a.c, Rot::new(pos_a.a, trig), a.local_center);
        let xf_b = Transform::around(pos_b.c, Rot::new(pos_b.a, trig), b.local_center);
        let mut row = Self {
            contact: contact_idx,
            a,
            b,
            manifold: *manifold,
            normal: Vec2::default(),
            friction: (FRICTION * FRICTION).sqrt(),
            points: [RowPoint::default(); 2],
            count: manifold.count,
            k: Sym2::default(),
            k_inverse: Sym2::default(),
        };
        for i in 0..manifold.count {
            let (face, clip, gap) = manifold.seen(xf_a, xf_b, i);
            let on_reference = clip + (SKIN - gap) * face;
            let on_incident = clip - SKIN * face;
            let world = if manifold.reference_is_b {
                0.5 * (on_incident + on_reference)
            } else {
                0.5 * (on_reference + on_incident)
            };
            let normal = if manifold.reference_is_b { -face } else { face };
            row.normal = normal;
            let (ra, rb) = (world - pos_a.c, world - pos_b.c);
            let tangent = normal.right();
            let approach = normal.dot(vel_b.v + rb.spun(vel_b.w) - vel_a.v - ra.spun(vel_a.w));
            row.points[i] = RowPoint {
                ra,
                rb,
                normal_mass: 1.0 / row.effective(ra.cross(normal), rb.cross(normal)),
                tangent_mass: 1.0 / row.effective(ra.cross(tangent), rb.cross(tangent)),
                // No restitution: the bias is a zero, whose sign follows Box2D.
                velocity_bias: if approach < -1.0 { -0.0 * approach } else { 0.0 },
                normal_impulse: dt_ratio * manifold.points[i].normal_impulse,
                tangent_impulse: dt_ratio * manifold.points[i].tangent_impulse,
            };
        }
        if row.count == 2 {
            let [p, q] = row.points;
            let (n1a, n1b) = (p.ra.cross(row.normal), p.rb.cross(row.normal));
            let (n2a, n2b) = (q.ra.cross(row.normal), q.rb.cross(row.normal));
            let k11 = row.effective(n1a, n1b);
            let k22 = row.effective(n2a, n2b);
            let k12 = a.inv_mass + b.inv_mass + a.inv_inertia * n1a * n2a + b.inv_inertia * n1b * n2b;
            if k11 * k11 < MAX_CONDITION_NUMBER * (k11 * k22 - k12 * k12) {
                row.k = Sym2 { xx: k11, xy: k12, yy: k22 };
                row.k_inverse = row.k.inverse();
            } else {
                row.count = 1;
            }
        }
        row
    }

    fn effective(&self, arm_a: f32, arm_b: f32) -> f32 {
        let (a, b) = (self.a, self.b);
        a.inv_mass + b.inv_mass + a.inv_inertia * arm_a * arm_a + b.inv_inertia * arm_b * arm_b
    }

    /// Applies last step's impulses.
    pub(super) fn warm_start(&self, velocities: &mut [Velocity]) {
        let (mut a, mut b) = (velocities[self.a.idx], velocities[self.b.idx]);
        let tangent = self.normal.right();
        for point in &self.points[..self.count] {
            let p = point.normal_impulse * self.normal + point.tangent_impulse * tangent;
            self.push(&mut a, &mut b, point, p);
        }
        velocities[self.a.idx] = a;
        velocities[self.b.idx] = b;
    }

    #[inline]
    fn push(&self, a: &mut Velocity, b: &mut Velocity, point: &RowPoint, p: Vec2) {
        a.v -= self.a.inv_mass * p;
        a.w -= self.a.inv_inertia * point.ra.cross(p);
        b.v += self.b.inv_mass * p;
        b.w += self.b.inv_inertia * point.rb.cross(p);
    }

    /// One velocity iteration: friction, then normals.
    pub(super) fn solve_velocity(&mut self, velocities: &mut [Velocity]) {
        let (mut a, mut b) = (velocities[self.a.idx], velocities[self.b.idx]);
        let tangent = self.normal.right();
        for i in 0..self.count {
            let point = self.points[i];
            let push = point.tangent_mass * (-slip(a, b, &point).dot(tangent));
            let most = self.friction * point.normal_impulse;
            let total = clamp(point.tangent_impulse + push, -most, most);
            self.points[i].tangent_impulse = total;
            self.push(&mut a, &mut b, &point, (total - point.tangent_impulse) * tangent);
        }
        if self.count == 1 {
            let point = self.points[0];
            let push = -point.normal_mass * (slip(a, b, &point).dot(self.normal) - point.velocity_bias);
            let total = (point.normal_impulse + push).max(0.0);
            self.points[0].normal_impulse = total;
            self.push(&mut a, &mut b, &point, (total - point.normal_impulse) * self.normal);
        } else {
            self.solve_both_normals(&mut a, &mut b);
        }
        velocities[self.a.idx] = a;
        velocities[self.b.idx] = b;
    }

    /// Two normals at once: a 2 × 2 linear complementarity problem, solved by trying its four cases.
    fn solve_both_normals(&mut self, a: &mut Velocity, b: &mut Velocity) {
        let [p, q] = self.points;
        let before = Vec2::new(p.normal_impulse, q.normal_impulse);
        let mut rhs = Vec2::new(
            slip(*a, *b, &p).dot(self.normal) - p.velocity_bias,
            slip(*a, *b, &q).dot(self.normal) - q.velocity_bias,
        );
        rhs -= self.k.apply(before);
        let both = -self.k_inverse.apply(rhs);
        let first = -p.normal_mass * rhs.x;
        let second = -q.normal_mass * rhs.y;
        let x = if both.x >= 0.0 && both.y >= 0.0 {
            both
        } else if first >= 0.0 && self.k.xy * first + rhs.y >= 0.0 {
            Vec2::new(first, 0.0)
        } else if second >= 0.0 && self.k.xy * second + rhs.x >= 0.0 {
            Vec2::new(0.0, second)
        } else if rhs.x >= 0.0 && rhs.y >= 0.0 {
            Vec2::default()
        } else {
            return;
        };
        let d = x - before;
        let (p1, p2) = (d.x * self.normal, d.y * self.normal);
        a.v -= self.a.inv_mass * (p1 + p2);
        a.w -= self.a.inv_inertia * (p.ra.cross(p1) + q.ra.cross(p2));
        b.v += self.b.inv_mass * (p1 + p2);
        b.w += self.b.inv_inertia * (p.rb.cross(p1) + q.rb.cross(p2));
        self.points[0].normal_impulse = x.x;
        self.points[1].normal_impulse = x.y;
    }

    /// Hands the impulses back, for the next step to start from.
    pub(super) fn store(&self, contacts: &mut [Contact]) {
        let manifold = &mut contacts[self.contact].manifold;
        for (stored, point) in manifold.points.iter_mut().zip(&self.points[..self.count]) {
            stored.normal_impulse = point.normal_impulse;
            stored.tangent_impulse = point.tangent_impulse;
        }
    }

    /// One position iteration. Returns the deepest separation.
    pub(super) fn solve_position(&self, positions: &mut [Position], trig: Trig) -> f32 {
        let (mut a, mut b) = (positions[self.a.idx], positions[self.b.idx]);
        let mut deepest = 0.0_f32;
        for i in 0..self.manifold.count {
            let xf_a = Transform::around(a.c, Rot::new(a.a, trig), self.a.local_center);
            let xf_b = Transform::around(b.c, Rot::new(b.a, trig), self.b.local_center);
            let (face, point, gap) = self.manifold.seen(xf_a, xf_b, i);
            let normal = if self.manifold.reference_is_b { -face } else { face };
            let separation = gap - SKIN - SKIN;
            let (ra, rb) = (point - a.c, point - b.c);
            deepest = deepest.min(separation);
            let c = clamp(BAUMGARTE * (separation + LINEAR_SLOP), -MAX_LINEAR_CORRECTION, 0.0);
            let p = (-c / self.effective(ra.cross(normal), rb.cross(normal))) * normal;
            a.c -= self.a.inv_mass * p;
            a.a -= self.a.inv_inertia * ra.cross(p);
            b.c += self.b.inv_mass * p;
            b.a += self.b.inv_inertia * rb.cross(p);
        }
        positions[self.a.idx] = a;
        positions[self.b.idx] = b;
        deepest
    }

    /// Whether positions are good enough.
    pub(super) fn is_shallow(deepest: f32) -> bool {
        deepest >= -3.0 * LINEAR_SLOP
    }

    /// Whether the impulses are equal to the last bit.
    pub(super) fn same_impulses(&self, other: &Self) -> bool {
        self.points.iter().zip(&other.points).all(|(p, q)| {
            p.normal_impulse.to_bits() == q.normal_impulse.to_bits()
                && p.tangent_impulse.to_bits() == q.tangent_impulse.to_bits()
        })
    }
}

/// The velocity of the second body against the first at a point.
#[inline]
fn slip(a: Velocity, b: Velocity, point: &RowPoint) -> Vec2 {
    b.v + point.rb.spun(b.w) - a.v - point.ra.spun(a.w)
}

const _: () = assert!(TOTAL_RADIUS == SKIN + SKIN, "the manifold and the solver agree on the skins");
