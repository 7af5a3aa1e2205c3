//! The fifteen courses of action that the planner chooses among (method §11).

use rand::{Rng, RngExt as _};

use crate::env::Action;
use crate::planner::PlannerConfig;

/// Steer and gas of the candidates that keep to one action.
const CONSTANT: [[f32; 2]; 6] = [[0.0, 0.2], [-1.0, 0.1], [1.0, 0.1], [0.0, 0.1], [-1.0, 0.2], [1.0, 0.2]];

/// What the stages of the others are made of: steer, gas, whether they brake, and the probability to come second.
///
/// A left turn follows more often than a right one, as in the authors' code.
const STAGES: [(f32, f32, bool, f64); 9] = [
    (0.0, 0.1, false, 0.13),
    (0.0, 0.2, false, 0.32),
    (-1.0, 0.1, false, 0.30),
    (1.0, 0.1, false, 0.20),
    (1.0, 0.2, false, 0.01),
    (-1.0, 0.2, false, 0.01),
    (-1.0, 0.1, true, 0.01),
    (1.0, 0.1, true, 0.01),
    (0.0, 0.1, true, 0.01),
];

/// How many candidates there are: S.
pub const N_CANDIDATES: usize = CONSTANT.len() + STAGES.len();

/// The candidates in the authors' order: six constant ones, then one for each first stage.
///
/// A first stage lasts n ~ U{1 … H − 1} steps. The second is drawn from the same list for the rest.
/// The generator gives n and then the second stage, candidate by candidate.
/// `// DIFFERENCE:` the paper counts braking among the predefined sequences. In the authors' code nobody brakes throughout
/// (method §14.10), and we follow the code.
pub fn candidates(config: &PlannerConfig, rng: &mut impl Rng) -> Vec<Vec<Action>> {
    let horizon = config.horizon;
    let constant = CONSTANT.map(|[steer, gas]| vec![Action::new(steer, gas, 0.0); horizon]);
    let stages = STAGES
        .map(|(steer, gas, brakes, _)| Action::new(steer, gas, if brakes { config.brake } else { 0.0 }));
    let two_stage = stages.map(|first| {
        let n = rng.random_range(1..horizon.max(2));
        let second = stages[second_stage(rng.random())];
        (0..horizon).map(|t| if t < n { first } else { second }).collect()
    });
    constant.into_iter().chain(two_stage).collect()
}

/// The stage in whose share of `[0, 1)` `u` lies.
fn second_stage(u: f64) -> usize {
    let mut below = 0.0;
    let at = STAGES.iter().position(|(.., p)| {
        below += p;
        u < below
    });
    at.unwrap_or(STAGES.len() - 1) // rounding
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn six_candidates_keep_to_one_action_and_nine_change_it_once() {
        let all = candidates(&PlannerConfig::paper(), &mut ChaCha8Rng::seed_from_u64(0));
        assert_eq!(all.len(), N_CANDIDATES);
        let firsts: Vec<_> = all.iter().map(|actions| actions[0].to_array()).collect();
        assert_eq!(firsts[..2], [[0.0, 0.2, 0.0], [-1.0, 0.1, 0.0]]);
        assert_eq!(firsts[6..8], [[0.0, 0.1, 0.0], [0.0, 0.2, 0.0]]);
        assert_eq!(firsts[14], [0.0, 0.1, 0.2]);
        for (i, actions) in all.iter().enumerate() {
            let n_changes = actions.windows(2).filter(|pair| pair[0] != pair[1]).count();
            assert!(n_changes <= usize::from(i >= 6), "candidate {i} changes {n_changes} times");
        }
    }

    #[test]
    fn the_shares_of_the_second_stages_are_the_papers() {
        assert!((STAGES.iter().map(|(.., p)| p).sum::<f64>() - 1.0).abs() < 1e-12);
        assert_eq!([0.0, 0.12, 0.14, 0.5, 0.8, 0.9999].map(second_stage), [0, 0, 1, 2, 3, 8]);
    }

    #[test]
    fn the_last_step_is_always_of_the_second_stage() {
        let config = PlannerConfig { horizon: 2, ..PlannerConfig::car_racing() };
        let all = candidates(&config, &mut ChaCha8Rng::seed_from_u64(0));
        // Seven draws of nine differ from their first stage here; with n = H none would.
        assert!(all[6..].iter().any(|actions| actions[0] != actions[1]));
    }

    proptest! {
        #[test]
        fn candidates_are_as_long_as_the_horizon(horizon in 1usize..40, seed: u64) {
            let config = PlannerConfig { horizon, ..PlannerConfig::car_racing() };
            for actions in candidates(&config, &mut ChaCha8Rng::seed_from_u64(seed)) {
                prop_assert_eq!(actions.len(), horizon);
            }
        }
    }
}
