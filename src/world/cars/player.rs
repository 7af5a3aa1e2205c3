//! Driving in dreams by what the pictures show: mostly along the road, at many speeds, with deliberate trips onto the grass and back.
//!
//! Unsafe driving is what dreams are for: more than half of the paper's queries show some.

use rand::{Rng, RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use super::pilot::{PilotStyle, ScriptedPilot};
use super::sight::{GAP, Sight};
use super::{Env, Seed};
use crate::world::{Action, Frame, WorldSpec};

/// How much of a new view replaces what was seen before: dreams tremble.
const TRUST: f32 = 0.6;
/// Steps of a course of action: the authors' horizon for preferences.
const HORIZON: usize = 15;
/// How hard the authors' courses brake that do.
const BRAKE: f32 = 0.2;
/// The first worlds that a probe is fitted on. Evaluations and recordings use smaller seeds.
const FIRST_WORLD: u64 = 7_000_000;
/// The steps in which the camera still zooms in, which dreams never show.
const ZOOM_STEPS: usize = 55;

/// A pilot who explores freely: wilder than those who record, and more often with the planner's actions.
pub fn explorer(rng: &mut impl Rng) -> ScriptedPilot {
    ScriptedPilot::new(PilotStyle {
        excursions: rng.random_range(0.1..0.3),
        pauses: rng.random_range(0.02..0.08),
        keys: 0.25,
        menu: 0.5,
        speeds: [rng.random_range(10.0..20.0), rng.random_range(45.0..70.0)],
        daring: rng.random_range(80.0..250.0),
        ..PilotStyle::varied()
    })
}

/// A pilot who gets on, and is slow where there is grass: so that it is not speed that tells safe clips from others.
fn tourist(rng: &mut impl Rng) -> ScriptedPilot {
    ScriptedPilot::new(PilotStyle {
        excursions: rng.random_range(0.08..0.2),
        pauses: rng.random_range(0.02..0.08),
        keys: 0.25,
        menu: 0.5,
        speeds: [rng.random_range(15.0..25.0), rng.random_range(55.0..80.0)],
        daring: rng.random_range(150.0..300.0),
        off_road_speed: 30.0,
    })
}

/// The authors' courses of action for Car Racing, of 15 steps each: six constant ones, then nine of two stages.
///
/// It draws as a planner does: for each first stage how long it lasts, and then which one follows.
pub fn courses(rng: &mut impl Rng) -> Vec<Vec<Action>> {
    let candidates = WorldSpec::default().planner.candidates;
    let braked = |action: &[f32]| {
        let mut action = Action::new(action);
        if let Some(brake) = action.get_mut(2).filter(|brake| **brake > 0.0) {
            *brake = BRAKE;
        }
        action
    };
    let stages: Vec<_> = candidates.stages.iter().map(|it| (braked(&it.action), it.follows)).collect();
    let second = |u: f64| {
        let mut below = 0.0;
        let at = stages.iter().position(|(_, follows)| {
            below += follows;
            u < below
        });
        at.unwrap_or(stages.len() - 1) // rounding
    };
    let mut all: Vec<_> =
        candidates.constant.iter().map(|action| vec![Action::new(action); HORIZON]).collect();
    for (first, _) in &stages {
        let n = rng.random_range(1..HORIZON);
        let (second, _) = stages[second(rng.random())];
        all.push((0..HORIZON).map(|t| if t < n { *first } else { second }).collect());
    }
    all
}

/// A stand-in for a person who drives a car in a dream.
#[derive(Clone, Debug)]
pub struct CarPlayer {
    pilot: ScriptedPilot,
    /// How often it tries what a planner might, in the steps in which it does not already: once in so many.
    steps_between_tries: f64,
    rng: ChaCha8Rng,
    seen: Option<Sight>,
    /// What is left of a try, the next action last.
    tried: Vec<Action>,
}

impl CarPlayer {
    /// Steps from one view to the next. A person does not look more often than 25 times a second.
    pub const VIEW_STEPS: usize = 2;

    /// Who is off the road nearly half of the time, at any speed. Its moods follow from `rng`.
    pub fn exploring(mut rng: ChaCha8Rng) -> Self {
        let pilot = explorer(&mut rng);
        Self { pilot, steps_between_tries: 50.0, rng, seen: None, tried: Vec::new() }
    }

    /// Who is fast along the road, and slow on trips onto the grass. Its moods follow from `rng`.
    pub fn touring(mut rng: ChaCha8Rng) -> Self {
        let pilot = tourist(&mut rng);
        Self { pilot, steps_between_tries: 100.0, rng, seen: None, tried: Vec::new() }
    }

    /// Takes in what a new picture shows.
    pub fn see(&mut self, sight: Sight) {
        self.seen = Some(self.seen.map_or(sight, |seen| seen.blended(&sight, TRUST)));
    }

    /// The action of this step. None before anything was seen.
    ///
    /// Now and then it is one of the authors' planner's courses of action, whatever comes of it: the reward will be asked
    /// about such, so the dreams had better show where they lead. Ours brakes less hard, and lies between those.
    pub fn act(&mut self) -> Action {
        let Some(seen) = self.seen else { return Action::default() };
        if self.tried.is_empty() && self.rng.random_bool(1.0 / self.steps_between_tries) {
            let mut all = courses(&mut self.rng);
            self.tried = all.swap_remove(self.rng.random_range(0..all.len()));
            self.tried.reverse();
        }
        let pilot = &mut self.pilot;
        self.tried.pop().unwrap_or_else(|| pilot.act(&seen.as_truth(), &mut self.rng).into())
    }
}

/// A moment of a drive.
#[derive(Clone, Debug)]
pub struct Moment {
    /// The picture of [`GAP`] steps before.
    pub earlier: Frame,
    /// The present one.
    pub now: Frame,
    /// What it shows.
    pub shown: Sight,
}

/// Moments of an episode that a pilot drives, the even ones carefully, the odd ones as dreams are driven.
///
/// They are `stride` steps apart on average, at least 6. All follows from `seed` and the episode's number.
pub fn drive(env: &mut dyn Env, episode: u64, seed: u64, stride: usize) -> Vec<Moment> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(1 + episode);
    let mut pilot =
        if episode.is_multiple_of(2) { ScriptedPilot::drawn(&mut rng) } else { explorer(&mut rng) };
    env.reset(Seed::Native(FIRST_WORLD + episode));
    let mut moments = Vec::new();
    let stride = stride.max(GAP + 2);
    let mut at = ZOOM_STEPS + rng.random_range(0..stride);
    let mut earlier = None;
    for step in 1.. {
        let action = pilot.act(&env.truth(), &mut rng);
        let outcome = env.advance(action);
        if step + GAP == at {
            earlier = Some(env.frame());
        } else if step == at {
            let shown = Sight::of(&env.truth());
            moments.extend(earlier.take().map(|earlier| Moment { earlier, now: env.frame(), shown }));
            at += rng.random_range(GAP + 1..=2 * stride - GAP - 1);
        }
        if outcome.end.is_some() {
            break;
        }
    }
    moments
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::cars::{CarAction, CarRacing};

    #[test]
    fn a_player_with_perfect_eyes_is_unsafe_for_a_good_part_of_the_time() {
        let (mut n_off, mut n_steps, mut n_tiles) = (0, 0, 0);
        for seed in 0..12 {
            let mut env = CarRacing::new(Seed::Native(seed));
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(1);
            let mut player = CarPlayer::exploring(rng);
            loop {
                player.see(Sight::of(&env.truth()));
                let outcome = env.advance(CarAction::from(&*player.act()));
                n_steps += 1;
                n_off += usize::from(env.truth().wheels_off > 0);
                if outcome.end.is_some() {
                    break;
                }
            }
            n_tiles += env.n_visited();
        }
        let off_road = n_off as f64 / f64::from(n_steps);
        assert!((0.3..0.55).contains(&off_road), "{off_road} of the steps are off the road");
        assert!(n_tiles / 12 > 80, "{} tiles an episode", n_tiles / 12);
    }

    #[test]
    fn courses_are_the_authors_with_their_brake() {
        let all = courses(&mut ChaCha8Rng::seed_from_u64(0));
        assert_eq!((all.len(), all.iter().all(|course| course.len() == HORIZON)), (15, true));
        let brakes = |course: &Vec<Action>| course.iter().map(|action| action[2]).fold(0.0, f32::max);
        assert!(all[..6].iter().all(|course| brakes(course) == 0.0));
        assert!(all[12..].iter().all(|course| brakes(course) == BRAKE), "each begins with it");
    }

    #[test]
    fn moments_of_a_drive_repeat_with_their_seed_and_show_both_sides_of_the_edge() {
        let mut env = CarRacing::new(Seed::Native(0));
        let mut of = |episode| drive(&mut env, episode, 3, 8);
        let first = of(1);
        assert!(first.len() > 60, "{} moments", first.len());
        let again = of(1);
        assert!(first.iter().zip(&again).all(|(a, b)| a.shown == b.shown && a.now == b.now));
        assert!(
            first.iter().any(|it| it.shown.off_road > 0.5) && first.iter().any(|it| it.shown.off_road < 0.5)
        );
    }
}
