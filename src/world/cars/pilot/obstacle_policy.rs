//! What the scripted pilot makes of an obstacle: mostly a way around it, now and then none.

use rand::{Rng, RngExt as _};

use crate::world::cars::{Obstacle, Truth};

/// Half the road in units.
pub(super) const HALF_ROAD: f32 = 6.67;
/// An obstacle is noticed so many seconds before it is reached, at no less than so many units a second.
const NOTICED_SECS: f32 = 2.0;
const NOTICED_SPEED: f32 = 12.0;
/// Nobody drives around what lies further than this from the center line, in units.
const OUT_OF_THE_WAY: f32 = 9.0;
/// How far from the center line a way around may lead, in units.
const WIDEST_LINE: f32 = 6.5;

/// How an obstacle is met.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Manner {
    /// As if it were not there.
    Ignore,
    /// `offset` units right of its center.
    Pass { offset: f32 },
    /// At its own speed, `gap` units behind it.
    Tail { gap: f32 },
}

/// What a pilot makes of the obstacle that it has noticed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ObstaclePolicy {
    obstacle: Obstacle,
    manner: Manner,
    /// Steps until the pilot thinks again.
    steps_left: u32,
}

impl ObstaclePolicy {
    /// What becomes of `before` with what is next now, if that is near enough to be noticed.
    pub(super) fn with(
        obstacle: Obstacle,
        before: Option<Self>,
        truth: &Truth,
        rng: &mut impl Rng,
    ) -> Option<Self> {
        let sight = NOTICED_SECS * truth.speed.max(NOTICED_SPEED);
        if obstacle.ahead > sight || obstacle.lateral.abs() > OUT_OF_THE_WAY {
            return None;
        }
        if let Some(met) = before
            && met.obstacle.id == obstacle.id
            && met.steps_left > 0
        {
            return Some(Self { obstacle, steps_left: met.steps_left - 1, ..met });
        }
        let is_car = Some(obstacle) == truth.car;
        let manner = if is_car { car(obstacle, truth, rng) } else { chuckhole(truth, rng) };
        Some(Self { obstacle, manner, steps_left: rng.random_range(100..400) })
    }

    /// The speed and the line, in units a second and units right of the center, that `aim` becomes.
    pub(super) fn bend(&self, (speed, line): (f32, f32), truth: &Truth) -> (f32, f32) {
        // Whoever drives in the grass on purpose has nothing to drive around.
        if line.abs() > HALF_ROAD + 0.5 || truth.lateral.abs() > 2.0 * HALF_ROAD {
            return (speed, line);
        }
        match self.manner {
            Manner::Ignore => (speed, line),
            Manner::Pass { offset } => {
                (speed, (self.obstacle.lateral + offset).clamp(-WIDEST_LINE, WIDEST_LINE))
            }
            Manner::Tail { gap } => {
                let Obstacle { ahead, lateral, speed: its, .. } = self.obstacle;
                (speed.min((its + ahead - gap).max(0.0)), lateral)
            }
        }
    }
}

/// Around a chuckhole on the side where the car is, seldom on the other; or a wheel grazes it, or it is hit.
fn chuckhole(truth: &Truth, rng: &mut impl Rng) -> Manner {
    let side = side(truth.lateral, 0.7, rng);
    match rng.random_range(0..20) {
        0..12 => Manner::Pass { offset: side * rng.random_range(3.2..5.0) },
        12..15 => Manner::Pass { offset: side * rng.random_range(1.4..2.8) },
        15..17 => Manner::Pass { offset: rng.random_range(-1.0..1.0) },
        _ => Manner::Ignore,
    }
}

/// Past a car where there is more room, or after it; or it is scraped or rammed.
fn car(obstacle: Obstacle, truth: &Truth, rng: &mut impl Rng) -> Manner {
    let side = side(truth.lateral * 0.3 - obstacle.lateral, 0.85, rng);
    match rng.random_range(0..20) {
        0..11 => Manner::Pass { offset: side * rng.random_range(3.6..5.5) },
        11..15 => Manner::Tail { gap: rng.random_range(7.0..18.0) },
        15..17 => Manner::Pass { offset: side * rng.random_range(1.5..3.0) },
        17..19 => Manner::Pass { offset: rng.random_range(-1.0..1.0) },
        _ => Manner::Ignore,
    }
}

/// The side that `lean` leans to with probability `p`: +1 is right.
fn side(lean: f32, p: f64, rng: &mut impl Rng) -> f32 {
    let toward = if lean < 0.0 { -1.0 } else { 1.0 };
    if rng.random_bool(p) { toward } else { -toward }
}
