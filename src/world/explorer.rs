//! Somebody who tries everything, for worlds that have no way to act of their own.

use std::sync::Arc;

use rand::{Rng as _, RngExt as _};
use rand_chacha::ChaCha8Rng;

use super::{Action, OwnPolicy, WorldError, WorldSpec};

/// A stretch lasts so long, in seconds.
const STRETCH_SECS: [f64; 2] = [0.2, 1.5];
/// How near to what it wants an action comes in a step, on average over the seconds of a hand's move.
const HAND_SECS: f64 = 0.12;
/// How often an axis is left neutral, and how often it is moved to one of its ends; else it is moved anywhere.
const NEUTRAL: f64 = 0.35;
const END: f64 = 0.25;

/// Holds actions drawn by chance, each for a while, as a hand would: no step jumps from end to end.
#[derive(Clone, Debug)]
pub struct Explorer {
    spec: Arc<WorldSpec>,
    action: Action,
    wanted: Action,
    steps_left: u32,
}

impl Explorer {
    /// For the axes of this world.
    pub fn new(spec: Arc<WorldSpec>) -> Self {
        let neutral = Action::new(spec.neutral());
        Self { spec, action: neutral, wanted: neutral, steps_left: 0 }
    }
}

impl OwnPolicy for Explorer {
    fn begin(&mut self, _: &mut ChaCha8Rng) {
        *self = Self::new(Arc::clone(&self.spec));
    }

    fn act(&mut self, rng: &mut ChaCha8Rng) -> Result<Action, WorldError> {
        if self.steps_left == 0 {
            let secs = rng.random_range(STRETCH_SECS[0]..STRETCH_SECS[1]);
            self.steps_left = (secs * self.spec.rate).ceil() as u32;
            let axes = &self.spec.axes;
            self.wanted = self.wanted.map(|i, _| {
                let axis = &axes[i];
                match rng.random::<f64>() {
                    kind if kind < NEUTRAL => axis.neutral,
                    kind if kind < NEUTRAL + END => [axis.low, axis.high][(rng.next_u32() % 2) as usize],
                    _ => rng.random_range(axis.low..=axis.high),
                }
            });
        }
        self.steps_left -= 1;
        let share = (1.0 / (HAND_SECS * self.spec.rate)).min(1.0) as f32;
        let (action, wanted) = (self.action, self.wanted);
        self.action = action.map(|i, value| value + share * (wanted[i] - value));
        Ok(self.spec.checked(&self.action).unwrap_or(self.wanted))
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;

    use super::*;

    #[test]
    fn it_reaches_every_part_of_every_axis_and_repeats_with_its_seed() {
        let spec = Arc::new(WorldSpec::built_in("car-racing").unwrap());
        let act = |seed| {
            let (mut explorer, rng) =
                (Explorer::new(Arc::clone(&spec)), &mut ChaCha8Rng::seed_from_u64(seed));
            explorer.begin(rng);
            (0..4000).map(|_| explorer.act(rng).unwrap()).collect::<Vec<_>>()
        };
        let all = act(1);
        assert_eq!(all, act(1));
        for (i, axis) in spec.axes.iter().enumerate() {
            let share = |from: f32, to: f32| {
                let within = all.iter().filter(|action| {
                    let at = (action[i] - axis.low) / (axis.high - axis.low);
                    (from..=to).contains(&at)
                });
                within.count()
            };
            assert!(
                (0..4).all(|part| share(0.25 * part as f32, 0.25 * (part + 1) as f32) > 150),
                "{}",
                axis.name
            );
        }
    }
}
