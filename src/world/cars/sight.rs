//! What a picture shows of a car on its road, as the numbers of a network that looks at it, and what that is worth.
//!
//! No network is known here: numbers come in, and numbers go out.

use serde::{Deserialize, Serialize};

use super::{STEPS_PER_SEC, Truth};
use crate::world::{NAMES, SourceKind, WorldSpec};

/// Numbers that are measured.
pub const N_MEASURED: usize = 8;
/// Where the logits of contacts begin, if there are obstacles: behind two logits and what is measured.
pub const CONTACTS: usize = 2 + N_MEASURED;
/// What the measured numbers are divided by: units, 1, 1, units a second twice, radians three times.
pub const SCALES: [f32; N_MEASURED] = [5.0, 1.0, 1.0, 15.0, 15.0, 0.5, 0.5, 1.0];
/// Beyond this many units from the center line the road is out of sight.
pub const FARTHEST: f32 = 25.0;
/// Steps from the picture of a moment before to the present one.
pub const GAP: usize = 4;

/// What can be seen to happen, as the world's file calls it.
pub const EVENTS: [&str; 3] = ["grass", "chuckhole", "car"];
/// The one of these that makes a clip unsafe, and a step of it worth nothing.
pub const UNSAFE: &str = EVENTS[0];
/// In so many pictures something must be seen. In one alone it may be a flaw of the picture.
pub const N_SEEN: usize = 2;
/// A step off the road costs this part of what a new tile pays: −1 against +10 (method §12).
pub const UNSAFE_COST: f32 = 0.1;
/// Who makes so much way along the road in a step is seen to come onto a new piece of it, in tiles.
///
/// `// DIFFERENCE:` a new tile cannot be seen in a dream of 84 pixels: whoever gets on along the road gets new ones.
pub const ONWARD: f32 = 0.1;
/// Length of a tile in units.
const TILE: f32 = 3.5;
/// Where the car, keeping its middle to the middle of the road, has a wheel at the edge, in units.
const EDGE: f32 = 6.0;

/// What a picture shows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sight {
    /// Probability that at least one wheel is off the road, in `[0, 1]`.
    pub off_road: f32,
    /// Probability that all four are, in `[0, 1]`.
    pub all_off: f32,
    /// Signed distance from the center line in units. Positive is right of it.
    pub lateral: f32,
    /// Heading of the car against that of the road in radians. Positive points left of it.
    pub heading_error: f32,
    /// Velocity along and to the right of the road, units a second.
    pub road_velocity: [f32; 2],
    /// The road's change of direction over the next 5, 10 and 20 nodes, radians. Positive is left.
    pub bends: [f32; 3],
    /// Probability that a wheel is in a chuckhole, in `[0, 1]`. 0 where there are none.
    pub chuckhole: f32,
    /// Probability that the hull touches another car, in `[0, 1]`. 0 where there are none.
    pub car: f32,
}

impl Sight {
    /// Whether there are obstacles to touch in a world; none where it is not one of the built-in cars.
    pub fn has_contacts(spec: &WorldSpec) -> Option<bool> {
        let name = spec.source.world.as_deref().unwrap_or(&spec.name);
        let is_one = spec.source.kind == SourceKind::BuiltIn && NAMES.contains(&name);
        is_one.then(|| name != NAMES[0])
    }

    /// What a perfect probe sees.
    pub fn of(truth: &Truth) -> Self {
        let share = |is: bool| if is { 1.0 } else { 0.0 };
        let contacts = truth.contacts.unwrap_or_default();
        Self {
            off_road: share(truth.wheels_off > 0),
            all_off: share(truth.wheels_off == 4),
            lateral: truth.lateral.clamp(-FARTHEST, FARTHEST),
            heading_error: truth.heading_error,
            road_velocity: truth.road_velocity,
            bends: truth.bends,
            chuckhole: share(contacts.chuckhole),
            car: share(contacts.car),
        }
    }

    /// Something a pilot can drive by. What no picture shows, such as the place on the map, is left at zero.
    pub fn as_truth(&self) -> Truth {
        let [along, across] = self.road_velocity;
        Truth {
            speed: along.hypot(across),
            road_velocity: self.road_velocity,
            lateral: self.lateral,
            heading_error: self.heading_error,
            bends: self.bends,
            wheels_off: if self.all_off > 0.5 { 4 } else { u8::from(self.off_road > 0.5) },
            ..Truth::default()
        }
    }

    /// This sight moved towards a `later` one by a `share` in `[0, 1]`.
    #[must_use]
    pub fn blended(&self, later: &Self, share: f32) -> Self {
        let mix = |a: f32, b: f32| a + share * (b - a);
        Self {
            off_road: mix(self.off_road, later.off_road),
            all_off: mix(self.all_off, later.all_off),
            lateral: mix(self.lateral, later.lateral),
            heading_error: mix(self.heading_error, later.heading_error),
            road_velocity: [0, 1].map(|i| mix(self.road_velocity[i], later.road_velocity[i])),
            bends: [0, 1, 2].map(|i| mix(self.bends[i], later.bends[i])),
            chuckhole: mix(self.chuckhole, later.chuckhole),
            car: mix(self.car, later.car),
        }
    }

    /// The same with the motion of another.
    #[must_use]
    pub fn moving_as(self, other: &Self) -> Self {
        Self { road_velocity: other.road_velocity, ..self }
    }

    /// What the mirrored picture shows.
    #[must_use]
    pub fn mirrored(self) -> Self {
        let [along, across] = self.road_velocity;
        Self {
            lateral: -self.lateral,
            heading_error: -self.heading_error,
            road_velocity: [along, -across],
            bends: self.bends.map(|bend| -bend),
            ..self
        }
    }

    /// The sight that a network's numbers mean: 10, or 12 where it looks for obstacles.
    ///
    /// # Panics
    /// Where there are fewer than 10.
    pub fn from_outputs(outputs: &[f32]) -> Self {
        let chance = |logit: f32| 1.0 / (1.0 + (-logit).exp());
        let measured = |i: usize| outputs[2 + i] * SCALES[i];
        Self {
            off_road: chance(outputs[0]),
            all_off: chance(outputs[1]),
            lateral: measured(0),
            heading_error: measured(1).atan2(measured(2)),
            road_velocity: [measured(3), measured(4)],
            bends: [measured(5), measured(6), measured(7)],
            chuckhole: outputs.get(CONTACTS).map_or(0.0, |logit| chance(*logit)),
            car: outputs.get(CONTACTS + 1).map_or(0.0, |logit| chance(*logit)),
        }
    }

    /// What the network's measuring numbers should be.
    pub fn targets(&self) -> [f32; N_MEASURED] {
        let (sin, cos) = self.heading_error.sin_cos();
        let [along, across] = self.road_velocity;
        let [near, middle, far] = self.bends;
        let values = [self.lateral, sin, cos, along, across, near, middle, far];
        std::array::from_fn(|i| values[i] / SCALES[i])
    }

    /// Whether the picture tells where the road leads: against its direction, nothing does.
    pub fn tells_direction(&self) -> bool {
        self.heading_error.cos() > -0.2
    }

    /// Which of the measuring numbers a picture tells; one that stands still tells no motion.
    pub fn told(&self, is_still: bool) -> [bool; N_MEASURED] {
        let place = self.tells_direction();
        let motion = place && !is_still;
        [place, place, place, motion, motion, place, place, place]
    }

    /// The probabilities of [`EVENTS`], in their order.
    pub fn chances(&self) -> [f32; EVENTS.len()] {
        [self.off_road, self.chuckhole, self.car]
    }

    /// Tiles passed in a step: velocity along the road, backwards counting nothing.
    pub fn tiles(&self) -> f32 {
        let secs = 1.0 / STEPS_PER_SEC as f32;
        self.road_velocity[0].max(0.0) * secs / TILE
    }

    /// How near the edge of the road the car is: the square of its way from the middle, where 1 is the edge.
    pub fn nearness(&self) -> f32 {
        (self.lateral / EDGE).powi(2)
    }

    /// The move across the road since the picture `before`, a step ago, that the car's motion does not explain, in units.
    ///
    /// Far out on the grass there is little to measure a move by, and its meaning is clear: there none is found.
    pub fn jump(&self, before: &Self) -> f32 {
        if self.off_road >= 0.5 || before.off_road >= 0.5 {
            return 0.0;
        }
        let secs = 1.0 / STEPS_PER_SEC as f32;
        let across = 0.5 * (before.road_velocity[1] + self.road_velocity[1]);
        self.lateral - before.lateral - across * secs
    }
}

/// How wrong a probe is on moments that it was not fitted on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ProbeErrors {
    /// Moments.
    pub n: usize,
    /// Share of them with a wheel off the road.
    pub off_road_share: f64,
    /// Share told rightly: whether a wheel is off the road.
    pub off_road_accuracy: f64,
    /// Probability that a moment off the road looks more so than one on it.
    pub off_road_auc: f64,
    /// Share told rightly: whether all wheels are.
    pub all_off_accuracy: f64,
    /// Mean absolute error of the lateral offset in units.
    pub lateral: f64,
    /// Of the heading in radians.
    pub heading: f64,
    /// Of the velocity along the road in units a second.
    pub along: f64,
    /// Of the velocity across the road in units a second.
    pub across: f64,
    /// Of the three bends ahead in radians.
    pub bends: [f64; 3],
    /// Share of them with a wheel in a chuckhole, and probability that such a moment looks more so than another.
    pub chuckhole: [f64; 2],
    /// The same for touching another car.
    pub car: [f64; 2],
}

impl ProbeErrors {
    /// Of what was seen, where something was shown: pairs of both. `auc` tells how well scores tell what is from what is not.
    pub fn of(pairs: &[(Sight, Sight)], auc: impl Fn(&[(bool, f32)]) -> f64) -> Self {
        let share = |is: &dyn Fn(&Sight, &Sight) -> bool| {
            pairs.iter().filter(|(shown, seen)| is(shown, seen)).count() as f64 / pairs.len().max(1) as f64
        };
        let directed: Vec<_> = pairs.iter().filter(|(shown, _)| shown.tells_direction()).collect();
        let mean = |error: &dyn Fn(&Sight, &Sight) -> f32| {
            let sum: f64 = directed.iter().map(|(shown, seen)| f64::from(error(shown, seen).abs())).sum();
            sum / directed.len().max(1) as f64
        };
        let told_apart = |chance: &dyn Fn(&Sight) -> f32| {
            auc(&pairs.iter().map(|(shown, seen)| (chance(shown) > 0.5, chance(seen))).collect::<Vec<_>>())
        };
        let turn = |a: f32, b: f32| (a - b).sin().atan2((a - b).cos());
        Self {
            n: pairs.len(),
            off_road_share: share(&|shown, _| shown.off_road > 0.5),
            off_road_accuracy: share(&|shown, seen| (shown.off_road > 0.5) == (seen.off_road > 0.5)),
            off_road_auc: told_apart(&|sight| sight.off_road),
            all_off_accuracy: share(&|shown, seen| (shown.all_off > 0.5) == (seen.all_off > 0.5)),
            lateral: mean(&|shown, seen| shown.lateral - seen.lateral),
            heading: mean(&|shown, seen| turn(shown.heading_error, seen.heading_error)),
            along: mean(&|shown, seen| shown.road_velocity[0] - seen.road_velocity[0]),
            across: mean(&|shown, seen| shown.road_velocity[1] - seen.road_velocity[1]),
            bends: [0, 1, 2].map(|i| mean(&|shown, seen| shown.bends[i] - seen.bends[i])),
            chuckhole: [share(&|shown, _| shown.chuckhole > 0.5), told_apart(&|sight| sight.chuckhole)],
            car: [share(&|shown, _| shown.car > 0.5), told_apart(&|sight| sight.car)],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // By hand, with the scales of assets/FORMAT.md: −3 / 5, sin 0.4, cos 0.4, 30 / 15, −2 / 15, 0.1 / 0.5, −0.2 / 0.5, 0.6.
    #[test]
    fn the_outputs_of_a_sight_mean_that_sight() {
        let sight = Sight {
            lateral: -3.0,
            heading_error: 0.4,
            road_velocity: [30.0, -2.0],
            bends: [0.1, -0.2, 0.6],
            ..Sight::default()
        };
        let outputs = [-0.6, 0.389_418, 0.921_061, 2.0, -0.133_333, 0.2, -0.4, 0.6];
        for (found, wanted) in sight.targets().into_iter().zip(outputs) {
            assert!((found - wanted).abs() < 1e-5, "{found} instead of {wanted}");
        }

        // A logit of ln 3 is a chance of three quarters.
        let read = Sight::from_outputs(&[[1.098_612, -1.098_612].as_slice(), &outputs].concat());
        assert!((read.off_road - 0.75).abs() < 1e-5 && (read.all_off - 0.25).abs() < 1e-5, "{read:?}");
        assert!((read.heading_error - 0.4).abs() < 1e-5 && (read.lateral + 3.0).abs() < 1e-5, "{read:?}");
        assert!((read.road_velocity[0] - 30.0).abs() < 1e-4, "{read:?}");
        assert!((read.road_velocity[1] + 2.0).abs() < 1e-4, "{read:?}");
        assert!((read.bends[1] + 0.2).abs() < 1e-5 && (read.bends[2] - 0.6).abs() < 1e-5, "{read:?}");
    }

    #[test]
    fn driving_is_worth_the_way_in_tiles() {
        let sight = Sight { road_velocity: [35.0, 0.0], lateral: 3.0, ..Sight::default() };
        assert!((sight.tiles() - 0.2).abs() < 1e-6, "35 units a second for a fiftieth of one");
        assert!((sight.nearness() - 0.25).abs() < 1e-6, "halfway to the edge");
        let back = Sight { road_velocity: [-35.0, 0.0], ..sight };
        assert_eq!(back.tiles(), 0.0);
    }

    #[test]
    fn a_move_that_the_motion_explains_is_no_jump() {
        let sight = |lateral, across| Sight { lateral, road_velocity: [20.0, across], ..Sight::default() };
        assert!(sight(0.2, 10.0).jump(&sight(0.0, 10.0)).abs() < 1e-6);
        assert!((sight(2.0, 0.0).jump(&sight(0.0, 0.0)) - 2.0).abs() < 1e-6);
        let off = Sight { off_road: 0.9, ..sight(2.0, 0.0) };
        assert_eq!(off.jump(&sight(0.0, 0.0)), 0.0);
    }

    #[test]
    fn the_built_in_worlds_are_those_with_a_road() {
        let of = |name: &str| Sight::has_contacts(&WorldSpec::built_in(name).unwrap());
        assert_eq!(NAMES.map(of), [Some(false), Some(true), Some(true)]);
        let mine = WorldSpec { name: "mine".to_owned(), ..WorldSpec::built_in(NAMES[0]).unwrap() };
        assert_eq!(Sight::has_contacts(&mine), Some(false), "under another name");
        let recorded = WorldSpec { source: crate::world::Source::default(), ..mine };
        assert_eq!(Sight::has_contacts(&recorded), None);
    }
}
