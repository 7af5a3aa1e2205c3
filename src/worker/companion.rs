//! Who rides with a person in the real car: a dream of the same drive, and a planner that can take the wheel.

use crate::dream::TEMPERATURE;
use crate::env::{Action, Frame};
use crate::planner::{Agent, PlannerConfig};
use crate::reward::LearnedReward;
use crate::tensor::{NotFinite, Parameters};
use crate::worker::{Beside, BesideView};
use crate::world_model::{Next, State, WorldModel, actions_tensor};

/// What rides along, as far as it was asked for.
pub(super) struct Companion {
    planner: PlannerConfig,
    model: Option<WorldModel>,
    reward: Option<LearnedReward>,
    agent: Option<Agent>,
    beside: Option<Beside>,
    dream: Option<Shadow>,
}

/// A dream that is given the real car's actions.
struct Shadow {
    state: State,
    /// Steps since it saw the real world.
    since: usize,
}

impl Companion {
    pub(super) fn new(planner: PlannerConfig) -> Self {
        Self { planner, model: None, reward: None, agent: None, beside: None, dream: None }
    }

    /// Dreams and plans with this model from now on; `env` and `side` say what it has to see.
    pub(super) fn see_with(&mut self, model: Parameters, env: &str, side: u32) -> Result<(), String> {
        if self.model.as_ref().is_some_and(|known| known.hash() == model.hash()) {
            return Ok(());
        }
        (self.model, self.reward, self.agent, self.dream) = (None, None, None, None);
        let model = WorldModel::load(model).map_err(|e| e.to_string())?;
        let config = model.config();
        if config.env != env || config.vae.side as u32 != side {
            return Err(format!(
                "this world model sees {} at {} pixels a side, but this is {env} at {side}: load another one",
                config.env, config.vae.side
            ));
        }
        self.model = Some(model);
        Ok(())
    }

    /// Plans by this reward from the next plan on; by none where it cannot be used, rather than by one that is not meant.
    pub(super) fn like(&mut self, reward: &Parameters) -> Result<(), String> {
        let Some(model) = &self.model else { return Ok(()) };
        match LearnedReward::load(reward, model.identity()) {
            Ok(reward) => self.reward = Some(reward),
            Err(e) => {
                (self.reward, self.agent) = (None, None);
                return Err(format!("the planner cannot drive by this reward: {e}"));
            }
        }
        if let (Some(config), Some(agent)) = (self.plans(), &mut self.agent) {
            agent.plan_by(config);
        }
        Ok(())
    }

    /// How the planner looks ahead by the reward that there is.
    fn plans(&self) -> Option<PlannerConfig> {
        let is_sparse = self.reward.as_ref()?.is_sparse();
        let config = self.planner.clone();
        Some(if is_sparse { config.for_transitions() } else { config })
    }

    /// Gives the wheel to the planner, where there is one, or takes it away.
    pub(super) fn hand_over(&mut self, is_over: bool, seed: u64) {
        let config = self.plans().filter(|_| is_over && self.model.is_some());
        self.agent = config.map(|config| Agent::new(config, seed));
    }

    /// Whether the planner drives.
    pub(super) fn is_driving(&self) -> bool {
        self.agent.is_some()
    }

    /// Dreams along, or no longer.
    pub(super) fn ride_beside(&mut self, beside: Option<Beside>) {
        (self.beside, self.dream) = (beside, None);
    }

    /// A new episode: nobody has seen anything of it.
    pub(super) fn begin(&mut self) {
        (self.agent, self.dream) = (None, None);
    }

    /// What the planner does where it drives; whoever takes hold of the wheel has it instead.
    ///
    /// Where it meets what is no number, it gives the wheel back.
    pub(super) fn act(&mut self, hands: Action, frame: &Frame) -> Result<Option<Action>, NotFinite> {
        if hands != Action::default() {
            self.agent = None;
        }
        let (Some(agent), Some(model), Some(reward)) = (&mut self.agent, &self.model, &self.reward) else {
            return Ok(None);
        };
        let driven = agent.act(model, reward, frame).map(|(action, _)| Some(action));
        driven.inspect_err(|_| self.agent = None)
    }

    /// Takes in what was done where `frame` was seen.
    ///
    /// Where that leads the dream beside to what is no number, it ends.
    pub(super) fn acted(&mut self, frame: &Frame, action: Action) -> Result<(), NotFinite> {
        if let Some(agent) = &mut self.agent {
            agent.acted(action);
        }
        let (Some(beside), Some(model)) = (self.beside, &self.model) else { return Ok(()) };
        let is_old = |dream: &Shadow| beside.reset.is_some_and(|every| dream.since >= every);
        let dream = self.dream.take().filter(|dream| !is_old(dream)).unwrap_or_else(|| {
            let z = model.observe(std::slice::from_ref(frame));
            Shadow { state: State { z, memory: model.no_memory(1) }, since: 0 }
        });
        // The mean and not a draw: what differs is what the model does not know, and not chance.
        let next = Next::Mean { temperature: TEMPERATURE };
        let state = model.imagine(&dream.state, &actions_tensor(&[action]), next);
        let since = dream.since + 1;
        state
            .require_finite(&format!("step {since} of the dream beside"))
            .inspect_err(|_| self.beside = None)?;
        self.dream = Some(Shadow { state, since });
        Ok(())
    }

    /// What the dream shows where the real world shows `frame`.
    pub(super) fn view(&self, step: usize, frame: &Frame) -> Option<BesideView> {
        let (Some(dream), Some(model)) = (&self.dream, &self.model) else { return None };
        let dreamt = model.decode(&dream.state.z).pop()?;
        let drift = rmse(&dreamt, frame);
        Some(BesideView { frame: dreamt, step, since: dream.since, drift })
    }

    /// Whether anything is to be seen of it.
    pub(super) fn is_beside(&self) -> bool {
        self.dream.is_some()
    }
}

/// The root of the mean squared difference of two pictures, in `[0, 1]`.
fn rmse(a: &Frame, b: &Frame) -> f32 {
    let squares = a.rgb().iter().zip(b.rgb()).map(|(a, b)| f32::from(a.abs_diff(*b)).powi(2));
    (squares.sum::<f32>() / a.rgb().len().max(1) as f32).sqrt() / 255.0
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::reward::{RewardConfig, RewardEnsemble, SparseConfig, SparseReward};
    use crate::worker::toy;

    fn gray(shade: u8) -> Frame {
        let side = toy::model().config().vae.side as u32;
        Frame::new(side, vec![shade; (3 * side * side) as usize])
    }

    fn companion() -> Companion {
        let mut companion = Companion::new(PlannerConfig::car_racing());
        let model = toy::model();
        let side = model.config().vae.side as u32;
        companion.see_with(model.parameters().clone(), "dummy-road", side).unwrap();
        companion
    }

    #[test]
    fn drift_is_how_far_pictures_are_apart() {
        assert_eq!(rmse(&gray(7), &gray(7)), 0.0);
        assert!((rmse(&gray(0), &gray(51)) - 0.2).abs() < 1e-6, "51 of 255");
    }

    #[test]
    fn the_dream_beside_begins_with_what_is_seen_and_then_sees_no_more() {
        let mut companion = companion();
        companion.ride_beside(Some(Beside { reset: Some(3) }));
        let mut views = Vec::new();
        for t in 0..5 {
            companion.acted(&gray(10 * t), Action::new(0.0, 1.0, 0.0)).unwrap();
            views.push(companion.view(usize::from(t), &gray(10)).unwrap());
        }
        assert_eq!(views.iter().map(|view| view.since).collect::<Vec<_>>(), [1, 2, 3, 1, 2]);

        let model = toy::model();
        let z = model.observe(&[gray(0)]);
        let mut state = State { z, memory: model.no_memory(1) };
        for _ in 0..3 {
            let next = Next::Mean { temperature: TEMPERATURE };
            state = model.imagine(&state, &actions_tensor(&[Action::new(0.0, 1.0, 0.0)]), next);
        }
        let by_hand = model.decode(&state.z).pop().unwrap();
        assert_eq!(views[2].frame, by_hand, "three steps after the only look");
        assert_eq!(views[2].drift, rmse(&by_hand, &gray(10)));
    }

    #[test]
    fn a_planner_drives_until_a_hand_is_on_the_wheel() {
        let mut companion = companion();
        companion.hand_over(true, 0);
        assert!(!companion.is_driving(), "without a reward it cannot");
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let reward = RewardEnsemble::new(36, &toy::model().hash(), RewardConfig::tiny(), rng);
        companion.like(&reward.parameters()).unwrap();
        companion.hand_over(true, 0);
        let action = companion.act(Action::default(), &gray(3)).unwrap();
        assert!(action.is_some_and(|action| action.gas > 0.0), "{action:?}");
        assert_eq!(companion.act(Action::new(0.5, 0.0, 0.0), &gray(3)), Ok(None));
        assert_eq!(companion.act(Action::default(), &gray(3)), Ok(None), "until it is handed over again");
    }

    #[test]
    fn a_reward_of_verdicts_drives_the_real_car_too_and_one_of_another_world_does_not() {
        let mut companion = companion();
        let verdicts = |world: &str| {
            let rng = &mut ChaCha8Rng::seed_from_u64(0);
            SparseReward::new(36, world, SparseConfig::tiny(), rng)
        };
        let reward = verdicts(&toy::model().hash());
        companion.like(&reward.parameters()).unwrap();
        companion.hand_over(true, 3);
        let config = PlannerConfig::car_racing().for_transitions();
        let by_hand = Agent::new(config, 3).act(&toy::model(), &reward.for_inference(), &gray(3)).unwrap().0;
        assert_eq!(companion.act(Action::default(), &gray(3)), Ok(Some(by_hand)));
        let refused = companion.like(&verdicts("sha256:0").parameters()).unwrap_err();
        assert!(refused.contains("the planner cannot drive by this reward"), "{refused}");
        assert!(!companion.is_driving(), "nor does it drive by the one before");
    }

    #[test]
    fn a_model_of_another_world_is_refused() {
        let refused = Companion::new(PlannerConfig::car_racing())
            .see_with(toy::model().parameters().clone(), "car-racing", 84)
            .unwrap_err();
        assert!(refused.contains("sees dummy-road") && refused.contains("car-racing at 84"), "{refused}");
    }
}
