//! The loop that drives: observe, plan now and then, remember what was done (method §4.6 and §11).

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use crate::planner::{Plan, PlannerConfig, plan};
use crate::reward::RewardModel;
use crate::tensor::NotFinite;
use crate::world::{Action, Frame};
use crate::world_model::{Memory, State, WorldModel, actions_tensor};

/// A driver for one episode.
///
/// ```text
/// until the end: action = act(frame); the world moves; acted(what the world was given)
/// ```
#[derive(Debug)]
pub struct Agent {
    config: PlannerConfig,
    rng: ChaCha8Rng,
    /// How many actions it was asked for.
    t: usize,
    plan: Option<Plan>,
    /// The last state, and the action that was executed in it.
    last: Option<(State, Action)>,
}

impl Agent {
    /// An agent at the start of an episode. `seed` decides its candidates.
    pub fn new(config: PlannerConfig, seed: u64) -> Self {
        Self { config, rng: ChaCha8Rng::seed_from_u64(seed), t: 0, plan: None, last: None }
    }

    /// Looks ahead as `config` says from the next plan on. How often a plan is made stays as it was.
    pub fn plan_by(&mut self, config: PlannerConfig) {
        self.config = PlannerConfig { replan: self.config.replan.min(self.config.horizon), ..config };
    }

    /// The action for what is seen now, and the plan if one was made for it.
    ///
    /// Where what is seen or planned is no number, nothing is driven.
    /// Between plans the last one is driven blindly, though memory takes in what is seen.
    pub fn act(
        &mut self,
        model: &WorldModel,
        reward: &impl RewardModel,
        frame: &Frame,
    ) -> Result<(Action, Option<&Plan>), NotFinite> {
        let z = model.observe(std::slice::from_ref(frame));
        let state = State { z, memory: self.memory(model) };
        // A reset in the middle of a plan does not end it (method §4.6).
        let step = self.t % self.config.replan.clamp(1, self.config.horizon);
        if step == 0 || self.plan.is_none() {
            let last = self.plan.take();
            state.require_finite("what is seen now")?;
            self.plan = Some(plan(model, reward, &state, &self.config, last.as_ref(), &mut self.rng)?);
        }
        let Some(plan) = &self.plan else { unreachable!("one was just made where there was none") };
        let action = plan.best().actions[step];
        self.last = Some((state, action));
        self.t += 1;
        Ok((action, (step == 0).then_some(plan)))
    }

    /// Says what was executed, where that is not what [`Self::act`] returned.
    ///
    /// `// DIFFERENCE:` the authors remember the planned action even where the environment overrode it (method §14.20).
    pub fn acted(&mut self, executed: Action) {
        if let Some((_, action)) = &mut self.last {
            *action = executed;
        }
    }

    /// The plan that is being driven.
    pub fn plan(&self) -> Option<&Plan> {
        self.plan.as_ref()
    }

    /// What is remembered before taking in the present.
    fn memory(&self, model: &WorldModel) -> Memory {
        let forgets = self.config.memory_reset.is_some_and(|every| self.t.is_multiple_of(every));
        match &self.last {
            Some((state, action)) if !forgets => model.remember(state, &actions_tensor(&[*action])),
            _ => model.no_memory(1),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reward::{RewardConfig, RewardEnsemble};
    use crate::tensor::to_vec;
    use crate::world_model::{WorldModelConfig, untrained};

    fn rng() -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(0)
    }

    /// A model, a reward over it, and something to see.
    fn world() -> (WorldModel, RewardEnsemble, Frame) {
        let config = WorldModelConfig::tiny();
        let reward = RewardEnsemble::new((config.n_features(), "sha256:0"), RewardConfig::tiny(), &mut rng());
        let side = config.vae.height as u32;
        let gray = vec![90u8; (3 * side * side) as usize];
        (untrained(&config, &mut rng()), reward, Frame::square(side, gray))
    }

    #[test]
    fn a_plan_is_driven_for_four_steps() {
        let (model, reward, frame) = world();
        let mut agent = Agent::new(PlannerConfig::car_racing(), 0);
        for t in 0..12 {
            let (action, plan) = agent.act(&model, &reward, &frame).unwrap();
            assert_eq!(plan.is_some(), t % 4 == 0);
            assert_eq!(agent.plan().map(|plan| plan.best().actions[t % 4]), Some(action));
        }
    }

    #[test]
    fn memory_holds_what_was_executed() {
        let (model, reward, frame) = world();
        let remembered = |executed: Option<Action>| {
            let mut agent = Agent::new(PlannerConfig::car_racing(), 0);
            let (planned, _) = agent.act(&model, &reward, &frame).unwrap();
            agent.acted(executed.unwrap_or(planned));
            to_vec(&agent.memory(&model).c)
        };
        assert_ne!(remembered(None), remembered(Some(Action::new([0.3, 1.0, 0.7]))));
    }

    #[test]
    fn memory_is_empty_at_the_start_and_after_every_fifty_steps() {
        let (model, reward, frame) = world();
        let mut agent = Agent::new(PlannerConfig::car_racing(), 0);
        for t in 0..101 {
            let is_empty = to_vec(&agent.memory(&model).c).iter().all(|c| *c == 0.0);
            assert_eq!(is_empty, t % 50 == 0, "at step {t}");
            agent.act(&model, &reward, &frame).unwrap();
        }
        let config = PlannerConfig { memory_reset: None, ..PlannerConfig::car_racing() };
        let mut agent = Agent::new(config, 0);
        for _ in 0..50 {
            agent.act(&model, &reward, &frame).unwrap();
        }
        assert!(to_vec(&agent.memory(&model).c).iter().any(|c| *c != 0.0), "it need not forget");
    }
}
