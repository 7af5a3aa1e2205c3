//! Where two polygons touch.

use super::math::{Transform, Vec2};
use super::shape::{Polygon, SKIN};

/// The two skins between two polygons.
pub(super) const TOTAL_RADIUS: f32 = SKIN + SKIN;

/// Which features of the two polygons made a point: it is the same point while these stay.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Feature {
    idx: [u8; 2],
    is_face: [bool; 2],
}

impl Feature {
    fn swapped(self) -> Self {
        Self { idx: [self.idx[1], self.idx[0]], is_face: [self.is_face[1], self.is_face[0]] }
    }
}

/// One point of contact.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Point {
    /// In the frame of the incident body.
    pub(super) local: Vec2,
    feature: Feature,
    pub(super) normal_impulse: f32,
    pub(super) tangent_impulse: f32,
}

/// Up to two points of contact against a reference face.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Manifold {
    pub(super) points: [Point; 2],
    pub(super) count: usize,
    /// Normal and mid-point of the reference face, in the frame of the reference body.
    pub(super) local_normal: Vec2,
    pub(super) local_point: Vec2,
    /// Whether the second body has the reference face.
    pub(super) reference_is_b: bool,
}

impl Manifold {
    /// Where `a` and `b` touch. Points that were there `before` keep their impulses.
    pub(super) fn between(a: (&Polygon, Transform), b: (&Polygon, Transform), before: &Self) -> Self {
        let mut manifold = collide(a, b);
        for point in &mut manifold.points[..manifold.count] {
            if let Some(old) = before.points[..before.count].iter().find(|old| old.feature == point.feature) {
                point.normal_impulse = old.normal_impulse;
                point.tangent_impulse = old.tangent_impulse;
            }
        }
        manifold
    }

    /// Normal from the first to the second body, and for each point clip point and separation without skins.
    pub(super) fn seen(&self, xf_a: Transform, xf_b: Transform, i: usize) -> (Vec2, Vec2, f32) {
        let (reference, incident) = if self.reference_is_b { (xf_b, xf_a) } else { (xf_a, xf_b) };
        let normal = reference.q.apply(self.local_normal);
        let plane = reference.apply(self.local_point);
        let clip = incident.apply(self.points[i].local);
        (normal, clip, (clip - plane).dot(normal))
    }
}

#[derive(Clone, Copy, Default)]
struct Clip {
    v: Vec2,
    feature: Feature,
}

fn collide(a: (&Polygon, Transform), b: (&Polygon, Transform)) -> Manifold {
    let mut manifold = Manifold::default();
    let (edge_a, gap_a) = max_separation(a, b);
    if gap_a > TOTAL_RADIUS {
        return manifold;
    }
    let (edge_b, gap_b) = max_separation(b, a);
    if gap_b > TOTAL_RADIUS {
        return manifold;
    }
    let reference_is_b = gap_b > 0.98 * gap_a + 0.001;
    let (one, two, edge) = if reference_is_b { (b, a, edge_b) } else { (a, b, edge_a) };

    let (polygon, xf) = one;
    let n = polygon.vertices().len();
    let next = (edge + 1) % n;
    let (v1, v2) = (polygon.vertices()[edge], polygon.vertices()[next]);
    let local_tangent = (v2 - v1).normalized();
    let tangent = xf.q.apply(local_tangent);
    let normal = tangent.right();
    let (w1, w2) = (xf.apply(v1), xf.apply(v2));
    let front = normal.dot(w1);
    let Some(clips) = clip(incident_edge(one, edge, two), -tangent, -tangent.dot(w1) + TOTAL_RADIUS, edge)
    else {
        return manifold;
    };
    let Some(clips) = clip(clips, tangent, tangent.dot(w2) + TOTAL_RADIUS, next) else {
        return manifold;
    };
    manifold.local_normal = local_tangent.right();
    manifold.local_point = 0.5 * (v1 + v2);
    manifold.reference_is_b = reference_is_b;
    for clip in clips {
        if normal.dot(clip.v) - front <= TOTAL_RADIUS {
            let feature = if reference_is_b { clip.feature.swapped() } else { clip.feature };
            let local = two.1.undo(clip.v);
            manifold.points[manifold.count] = Point { local, feature, ..Point::default() };
            manifold.count += 1;
        }
    }
    manifold
}

/// How far `two` lies outside the edge of `one`.
fn edge_separation(one: (&Polygon, Transform), edge: usize, two: (&Polygon, Transform)) -> f32 {
    let normal = one.1.q.apply(one.0.normals()[edge]);
    let local = two.1.q.undo(normal);
    let (mut nearest, mut least) = (0, f32::MAX);
    for (i, v) in two.0.vertices().iter().enumerate() {
        let dot = v.dot(local);
        if dot < least {
            (nearest, least) = (i, dot);
        }
    }
    let v1 = one.1.apply(one.0.vertices()[edge]);
    let v2 = two.1.apply(two.0.vertices()[nearest]);
    (v2 - v1).dot(normal)
}

/// The edge of `one` that `two` is farthest outside of, found by hill climbing, and how far.
fn max_separation(one: (&Polygon, Transform), two: (&Polygon, Transform)) -> (usize, f32) {
    let n = one.0.vertices().len();
    let toward = one.1.q.undo(two.1.apply(two.0.centroid()) - one.1.apply(one.0.centroid()));
    let (mut edge, mut most) = (0, -f32::MAX);
    for (i, normal) in one.0.normals().iter().enumerate() {
        let dot = normal.dot(toward);
        if dot > most {
            (edge, most) = (i, dot);
        }
    }
    let (previous, next) = ((edge + n - 1) % n, (edge + 1) % n);
    let here = edge_separation(one, edge, two);
    let gap_previous = edge_separation(one, previous, two);
    let gap_next = edge_separation(one, next, two);
    let (step, mut best) = if gap_previous > here && gap_previous > gap_next {
        (n - 1, (previous, gap_previous))
    } else if gap_next > here {
        (1, (next, gap_next))
    } else {
        return (edge, here);
    };
    loop {
        let edge = (best.0 + step) % n;
        let gap = edge_separation(one, edge, two);
        if gap <= best.1 {
            return best;
        }
        best = (edge, gap);
    }
}

/// The edge of `two` that faces the edge of `one` most.
fn incident_edge(one: (&Polygon, Transform), edge: usize, two: (&Polygon, Transform)) -> [Clip; 2] {
    let normal = two.1.q.undo(one.1.q.apply(one.0.normals()[edge]));
    let (mut facing, mut least) = (0, f32::MAX);
    for (i, n) in two.0.normals().iter().enumerate() {
        let dot = normal.dot(*n);
        if dot < least {
            (facing, least) = (i, dot);
        }
    }
    [facing, (facing + 1) % two.0.vertices().len()].map(|i| Clip {
        v: two.1.apply(two.0.vertices()[i]),
        feature: Feature { idx: [edge as u8, i as u8], is_face: [true, false] },
    })
}

/// Cuts a segment at a line. `None` where less than a segment is left.
fn clip([p, q]: [Clip; 2], normal: Vec2, offset: f32, vertex: usize) -> Option<[Clip; 2]> {
    let (d0, d1) = (normal.dot(p.v) - offset, normal.dot(q.v) - offset);
    let cut = || Clip {
        v: p.v + (d0 / (d0 - d1)) * (q.v - p.v),
        feature: Feature { idx: [vertex as u8, p.feature.idx[1]], is_face: [false, true] },
    };
    match (d0 <= 0.0, d1 <= 0.0) {
        (true, true) => Some([p, q]),
        (true, false) if d0 * d1 < 0.0 => Some([p, cut()]),
        (false, true) if d0 * d1 < 0.0 => Some([q, cut()]),
        _ => None,
    }
}
