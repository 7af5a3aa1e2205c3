//! The planner at the wheel of a dream, where the state is known and need not be observed.

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use crate::planner::{Plan, PlannerConfig, plan};
use crate::reward::RewardModel;
use crate::tensor::NotFinite;
use crate::world::Action;
use crate::world_model::{State, WorldModel};

/// Drives for as long as nobody else does.
#[derive(Debug)]
pub struct CoDriver {
    config: PlannerConfig,
    rng: ChaCha8Rng,
    plan: Option<Plan>,
    /// How many actions of the plan were given.
    step: usize,
}

impl CoDriver {
    /// A driver that has no plan yet. `seed` decides its candidates.
    pub fn new(config: PlannerConfig, seed: u64) -> Self {
        Self { config, rng: ChaCha8Rng::seed_from_u64(seed), plan: None, step: 0 }
    }

    /// Looks ahead as `config` says from the next plan on. That begins at once where it differs.
    pub fn plan_by(&mut self, config: PlannerConfig) {
        if self.config != config {
            (self.config, self.plan) = (config, None);
        }
    }

    /// The action in `state`, by a new plan where the last one is used up.
    ///
    /// Where what it promises itself is no number, it does not drive.
    pub fn act(
        &mut self,
        model: &WorldModel,
        reward: &impl RewardModel,
        state: &State,
    ) -> Result<Action, NotFinite> {
        let is_driven = self.step >= self.config.replan.clamp(1, self.config.horizon);
        let current = match self.plan.take() {
            Some(current) if !is_driven => current,
            last => {
                self.step = 0;
                plan(model, reward, state, &self.config, last.as_ref(), &mut self.rng)?
            }
        };
        let action = current.best().actions[self.step];
        self.step += 1;
        self.plan = Some(current);
        Ok(action)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reward::{RewardConfig, RewardEnsemble};
    use crate::world_model::{LatentState, WorldModelConfig, untrained};

    #[test]
    fn it_drives_the_best_plan_and_makes_a_new_one_after_four_steps() {
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let model = untrained(&WorldModelConfig::tiny(), rng);
        let reward = RewardEnsemble::new((36, "sha256:0"), RewardConfig::tiny(), rng);
        let state = LatentState { z: vec![0.3; 4], c: vec![0.1; 16], h: vec![0.2; 16] };
        let (state, config) = (State::from(&state), PlannerConfig::car_racing());
        let mut driver = CoDriver::new(config.clone(), 9);
        let driven: Vec<Action> = (0..6).map(|_| driver.act(&model, &reward, &state).unwrap()).collect();
        let rng = &mut ChaCha8Rng::seed_from_u64(9);
        let [first, second] = [(); 2]
            .map(|()| plan(&model, &reward, &state, &config, None, rng).unwrap().best().actions.clone());
        assert_eq!(driven, [&first[..4], &second[..2]].concat());
    }

    #[test]
    fn a_longer_look_begins_with_another_plan() {
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let model = untrained(&WorldModelConfig::tiny(), rng);
        let reward = RewardEnsemble::new((36, "sha256:0"), RewardConfig::tiny(), rng);
        let state = State::from(&LatentState { z: vec![0.3; 4], c: vec![0.1; 16], h: vec![0.2; 16] });
        let near = PlannerConfig { horizon: 2, ..PlannerConfig::paper() };
        let mut driver = CoDriver::new(near.clone(), 9);
        driver.act(&model, &reward, &state).unwrap();
        driver.plan_by(near.clone());
        assert!(driver.plan.is_some(), "the same config changes nothing");
        driver.plan_by(near.for_transitions());
        let rest: Vec<Action> = (0..4).map(|_| driver.act(&model, &reward, &state).unwrap()).collect();
        let plan = driver.plan.as_ref().map(|plan| plan.best().actions.clone()).unwrap_or_default();
        assert_eq!((plan.len(), &rest[..]), (25, &plan[..4]));
    }
}
