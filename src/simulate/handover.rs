//! Who drives in a dream, the player or the planner: as in the window, the wheel is handed over and taken back.

use rand::{Rng as _, RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::planner::{CoDriver, PlannerConfig};
use crate::reward::InferenceReward;
use crate::tensor::NotFinite;
use crate::world::Action;
use crate::world_model::{State, WorldModel};

/// Share of the turns that are the planner's.
const PLANNED: f64 = 0.8;
/// How many steps a turn lasts, at the least and at the most.
const STEPS: std::ops::Range<u32> = 40..160;
/// The stream of whose turn it is. The player has that before.
const STREAM: u64 = 2;

/// The reward learned so far, and how the planner looks ahead with it.
#[derive(Debug)]
pub struct Learned {
    /// The reward learned from the answers so far.
    pub reward: InferenceReward,
    /// How the planner looks ahead.
    pub planner: PlannerConfig,
}

/// Hands the wheel of one dream to the planner and back.
#[derive(Debug)]
pub(super) struct Handover<'a> {
    learned: &'a Learned,
    rng: ChaCha8Rng,
    /// The planner, while it drives.
    co_driver: Option<CoDriver>,
    steps_left: u32,
}

impl<'a> Handover<'a> {
    /// A planner that follows what was `learned` takes turns. `seed` decides when, and draws its candidates.
    pub(super) fn new(learned: &'a Learned, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(STREAM);
        Self { learned, rng, co_driver: None, steps_left: 0 }
    }

    /// The planner's action in `state`. None where it is the player's turn.
    ///
    /// # Shapes
    /// - `state`: a batch of one
    pub(super) fn act(&mut self, model: &WorldModel, state: &State) -> Result<Option<Action>, NotFinite> {
        if self.steps_left == 0 {
            self.steps_left = self.rng.random_range(STEPS);
            let is_planned = self.rng.random_bool(PLANNED);
            let seed = self.rng.next_u64();
            self.co_driver = is_planned.then(|| CoDriver::new(self.learned.planner.clone(), seed));
        }
        self.steps_left -= 1;
        let reward = &self.learned.reward;
        self.co_driver.as_mut().map(|driver| driver.act(model, reward, state)).transpose()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reward::{RewardConfig, RewardEnsemble};
    use crate::world_model::{LatentState, WorldModelConfig, untrained};

    #[test]
    fn the_planner_drives_for_most_of_the_time_in_turns() {
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let model = untrained(&WorldModelConfig::tiny(), rng);
        let reward = RewardEnsemble::new((36, "sha256:0"), RewardConfig::tiny(), rng).for_inference();
        let planner = PlannerConfig { horizon: 2, ..PlannerConfig::car_racing() };
        let learned = Learned { reward, planner };
        let state = State::from(&LatentState { z: vec![0.3; 4], c: vec![0.1; 16], h: vec![0.2; 16] });

        let drive = |seed| {
            let mut handover = Handover::new(&learned, seed);
            (0..3000).map(|_| handover.act(&model, &state).unwrap()).collect::<Vec<_>>()
        };
        let driven = drive(5);

        let is_planned: Vec<_> = driven.iter().map(Option::is_some).collect();
        let n_planned = is_planned.iter().filter(|is| **is).count();
        assert!((1800..2990).contains(&n_planned), "{n_planned} of 3000 steps");
        let shortest = is_planned.chunk_by(|a, b| a == b).rev().skip(1).map(<[bool]>::len).min();
        assert!(shortest.is_some_and(|n| n >= 40), "a turn lasts {shortest:?} steps");
        assert_eq!(driven, drive(5));
        assert_ne!(driven, drive(6), "another seed, other turns");
    }
}
