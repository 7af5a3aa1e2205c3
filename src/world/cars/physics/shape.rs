//! Convex polygons, circles and boxes.

use super::math::{Transform, Vec2};

/// The most corners that a polygon has.
pub const MAX_VERTICES: usize = 8;
/// Thickness of the skin around a polygon in units: two polygons touch when closer than twice this.
pub const SKIN: f32 = 0.01;
/// How much wider than a sensor's skins a gap may be and still count as touching: ten machine epsilons.
const TOUCH_TOLERANCE: f32 = 10.0 * f32::EPSILON;

/// A convex polygon, counter-clockwise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Polygon {
    vertices: [Vec2; MAX_VERTICES],
    normals: [Vec2; MAX_VERTICES],
    count: usize,
    centroid: Vec2,
}

/// Mass, center of mass and inertia about the body's origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MassData {
    /// Mass.
    pub mass: f32,
    /// Center of mass in the body's frame.
    pub center: Vec2,
    /// Rotational inertia about the body's origin.
    pub inertia: f32,
}

impl Polygon {
    /// The convex hull of `points`.
    ///
    /// # Panics
    /// With fewer than 3 or more than [`MAX_VERTICES`] points, or where all lie on a line.
    pub fn hull(points: &[[f64; 2]]) -> Self {
        assert!((3..=MAX_VERTICES).contains(&points.len()), "a polygon has 3 to {MAX_VERTICES} corners");
        let mut given = [Vec2::default(); MAX_VERTICES];
        for (vertex, &point) in given.iter_mut().zip(points) {
            *vertex = Vec2::from_f64(point);
        }
        let given = &given[..points.len()];
        let (vertices, count) = gift_wrap(given);
        assert!(count >= 3, "the corners of a polygon do not lie on a line");
        let mut normals = [Vec2::default(); MAX_VERTICES];
        for i in 0..count {
            normals[i] = (vertices[(i + 1) % count] - vertices[i]).right().normalized();
        }
        let centroid = centroid(&vertices[..count]);
        Self { vertices, normals, count, centroid }
    }

    /// The corners.
    #[inline]
    pub fn vertices(&self) -> &[Vec2] {
        &self.vertices[..self.count]
    }

    /// The outward normal of each edge. Edge `i` leads from corner `i` to the next.
    #[inline]
    pub fn normals(&self) -> &[Vec2] {
        &self.normals[..self.count]
    }

    /// Center of the area.
    pub(super) fn centroid(&self) -> Vec2 {
        self.centroid
    }

    /// The polygon seen from the world.
    pub(super) fn transformed(&self, xf: Transform) -> Self {
        let mut seen = *self;
        for i in 0..self.count {
            seen.vertices[i] = xf.apply(self.vertices[i]);
            seen.normals[i] = xf.q.apply(self.normals[i]);
        }
        seen
    }

    /// The smallest box around the polygon and its skin.
    pub(super) fn bounds(&self, xf: Transform) -> Aabb {
        let first = xf.apply(self.vertices[0]);
        let mut bounds = Aabb { lo: first, hi: first };
        for &vertex in &self.vertices()[1..] {
            let v = xf.apply(vertex);
            bounds = bounds.union(Aabb { lo: v, hi: v });
        }
        bounds.grown(SKIN)
    }

    /// Mass properties at a density in mass per square unit.
    pub(super) fn mass(&self, density: f32) -> MassData {
        let third = 1.0_f32 / 3.0;
        let mut s = Vec2::default();
        for &v in self.vertices() {
            s += v;
        }
        s = (1.0 / self.count as f32) * s;
        let (mut area, mut center, mut inertia) = (0.0_f32, Vec2::default(), 0.0_f32);
        for i in 0..self.count {
            let e1 = self.vertices[i] - s;
            let e2 = self.vertices[(i + 1) % self.count] - s;
            let d = e1.cross(e2);
            let triangle = 0.5 * d;
            area += triangle;
            center += (triangle * third) * (e1 + e2);
            let xx = e1.x * e1.x + e2.x * e1.x + e2.x * e2.x;
            let yy = e1.y * e1.y + e2.y * e1.y + e2.y * e2.y;
            inertia += (0.25 * third * d) * (xx + yy);
        }
        let mass = density * area;
        center = (1.0 / area) * center;
        let shifted = center + s;
        let inertia = density * inertia + mass * (shifted.dot(shifted) - center.dot(center));
        MassData { mass, center: shifted, inertia }
    }
}

/// The hull of `given`, counter-clockwise from its right-most, then lowest point.
fn gift_wrap(given: &[Vec2]) -> ([Vec2; MAX_VERTICES], usize) {
    let mut start = 0;
    for (i, p) in given.iter().enumerate() {
        let best = given[start];
        if p.x > best.x || (p.x == best.x && p.y < best.y) {
            start = i;
        }
    }
    let mut hull = [Vec2::default(); MAX_VERTICES];
    let (mut count, mut here) = (0, start);
    loop {
        hull[count] = given[here];
        count += 1;
        let mut next = 0;
        for j in 1..given.len() {
            if next == here {
                next = j;
                continue;
            }
            let (r, v) = (given[next] - given[here], given[j] - given[here]);
            let turn = r.cross(v);
            if turn < 0.0 || (turn == 0.0 && v.dot(v) > r.dot(r)) {
                next = j;
            }
        }
        here = next;
        if here == start || count == given.len() {
            return (hull, count);
        }
    }
}

fn centroid(vertices: &[Vec2]) -> Vec2 {
    let third = 1.0_f32 / 3.0;
    let (mut area, mut center) = (0.0_f32, Vec2::default());
    for (i, &v) in vertices.iter().enumerate() {
        let next = vertices[(i + 1) % vertices.len()];
        let triangle = 0.5 * v.cross(next);
        area += triangle;
        center += (triangle * third) * (v + next);
    }
    (1.0 / area) * center
}

/// What a fixture covers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// A convex polygon with a skin of [`SKIN`].
    Polygon(Polygon),
    /// A disc without a skin.
    Circle {
        /// Center in the body's frame.
        center: Vec2,
        /// Radius in units.
        radius: f32,
    },
}

impl Shape {
    pub(super) fn bounds(&self, xf: Transform) -> Aabb {
        match self {
            Self::Polygon(polygon) => polygon.bounds(xf),
            Self::Circle { center, radius } => {
                let c = xf.apply(*center);
                Aabb { lo: c, hi: c }.grown(*radius)
            }
        }
    }

    /// Whether this shape, given in the world's frame, overlaps `other`, skins included.
    pub(super) fn touches(&self, other: &Polygon) -> bool {
        match self {
            Self::Polygon(polygon) => closer_than(polygon, other, 2.0 * SKIN + TOUCH_TOLERANCE),
            Self::Circle { center, radius } => {
                let reach = SKIN + radius + TOUCH_TOLERANCE;
                let inside =
                    other.normals().iter().zip(other.vertices()).all(|(n, &v)| n.dot(*center - v) <= 0.0);
                inside
                    || edges(other).any(|(a, b)| squared_distance(*center, a, b) < f64::from(reach).powi(2))
            }
        }
    }
}

/// Whether the gap between two polygons is below `reach`. Both in the world's frame.
///
/// DIFFERENCE: Box2D runs GJK. Separating axes and, in the rare corner case, the exact distance say the same.
fn closer_than(a: &Polygon, b: &Polygon, reach: f32) -> bool {
    let widest = separation(a, b, reach).max(separation(b, a, reach));
    if widest >= reach {
        return false;
    }
    if widest <= 0.0 {
        return true;
    }
    let reach = f64::from(reach).powi(2);
    let near = |corners: &Polygon, sides: &Polygon| {
        corners.vertices().iter().any(|&v| edges(sides).any(|(p, q)| squared_distance(v, p, q) < reach))
    };
    near(a, b) || near(b, a)
}

/// The largest gap along the edge normals of `a`. May stop early with a value of at least `enough`.
#[inline]
fn separation(a: &Polygon, b: &Polygon, enough: f32) -> f32 {
    let mut widest = f32::MIN;
    for (n, &v) in a.normals().iter().zip(a.vertices()) {
        let nearest = b.vertices().iter().fold(f32::MAX, |least, &w| least.min(n.dot(w - v)));
        widest = widest.max(nearest);
        if widest >= enough {
            break;
        }
    }
    widest
}

fn edges(polygon: &Polygon) -> impl Iterator<Item = (Vec2, Vec2)> + '_ {
    let vertices = polygon.vertices();
    vertices.iter().enumerate().map(move |(i, &v)| (v, vertices[(i + 1) % vertices.len()]))
}

/// The squared distance of `p` from the segment `a b`.
fn squared_distance(p: Vec2, a: Vec2, b: Vec2) -> f64 {
    let [px, py, ax, ay, bx, by] = [p.x, p.y, a.x, a.y, b.x, b.y].map(f64::from);
    let (ex, ey) = (bx - ax, by - ay);
    let along = (((px - ax) * ex + (py - ay) * ey) / (ex * ex + ey * ey)).clamp(0.0, 1.0);
    (px - ax - along * ex).powi(2) + (py - ay - along * ey).powi(2)
}

/// An axis-aligned box.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Aabb {
    pub(super) lo: Vec2,
    pub(super) hi: Vec2,
}

impl Aabb {
    #[inline]
    pub(super) fn union(self, other: Self) -> Self {
        Self {
            lo: Vec2::new(self.lo.x.min(other.lo.x), self.lo.y.min(other.lo.y)),
            hi: Vec2::new(self.hi.x.max(other.hi.x), self.hi.y.max(other.hi.y)),
        }
    }

    #[inline]
    pub(super) fn grown(self, by: f32) -> Self {
        let r = Vec2::new(by, by);
        Self { lo: self.lo - r, hi: self.hi + r }
    }

    /// The box stretched by `d` on the side that `d` points to.
    #[inline]
    pub(super) fn stretched(mut self, d: Vec2) -> Self {
        if d.x < 0.0 {
            self.lo.x += d.x;
        } else {
            self.hi.x += d.x;
        }
        if d.y < 0.0 {
            self.lo.y += d.y;
        } else {
            self.hi.y += d.y;
        }
        self
    }

    #[inline]
    pub(super) fn contains(self, other: Self) -> bool {
        self.lo.x <= other.lo.x
            && self.lo.y <= other.lo.y
            && other.hi.x <= self.hi.x
            && other.hi.y <= self.hi.y
    }

    #[inline]
    #[expect(clippy::needless_bitwise_bool, reason = "the scan over all tiles stays free of branches")]
    pub(super) fn overlaps(self, other: Self) -> bool {
        (self.lo.x <= other.hi.x)
            & (self.lo.y <= other.hi.y)
            & (other.lo.x <= self.hi.x)
            & (other.lo.y <= self.hi.y)
    }
}
