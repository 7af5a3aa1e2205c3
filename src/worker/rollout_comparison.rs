//! What runs beside a person in the real world: a rollout of the world model to compare with, and a planner that can drive.

use std::sync::Arc;

use crate::dream::TEMPERATURE;
use crate::planner::{Agent, PlannerConfig};
use crate::reward::LearnedReward;
use crate::tensor::{NotFinite, Parameters};
use crate::worker::error::TaskError;
use crate::worker::{RolloutComparison, RolloutView, WorkerError};
use crate::world::{Action, Frame, WorldSpec};
use crate::world_model::{Next, State, WorldModel, actions_tensor};

/// What runs beside the drive, as far as it was asked for.
pub(super) struct Assistant {
    spec: Arc<WorldSpec>,
    planner: PlannerConfig,
    model: Option<WorldModel>,
    reward: Option<LearnedReward>,
    agent: Option<Agent>,
    comparison: Option<RolloutComparison>,
    rollout: Option<Rollout>,
}

/// What the world model predicts under the real world's actions.
struct Rollout {
    state: State,
    /// Steps since it saw the real world.
    since: usize,
}

impl Assistant {
    pub(super) fn new(spec: Arc<WorldSpec>, planner: PlannerConfig) -> Self {
        Self { spec, planner, model: None, reward: None, agent: None, comparison: None, rollout: None }
    }

    /// Predicts and plans with this model from now on, which must be of the world that is driven in.
    pub(super) fn use_model(&mut self, model: Parameters) -> Result<(), WorkerError> {
        if self.model.as_ref().is_some_and(|known| known.hash() == model.hash()) {
            return Ok(());
        }
        (self.model, self.reward, self.agent, self.rollout) = (None, None, None, None);
        let model = WorldModel::load(model)?;
        let (of, here) = (model.spec(), &self.spec);
        let told = |spec: &WorldSpec| (spec.name.clone(), spec.image.trained(), spec.axes.len());
        if told(of) != told(here) {
            let in_words = |spec: &WorldSpec| format!("{:?} ({})", spec.name, spec.image.trained());
            return Err(TaskError::OtherEnv { sees: in_words(of), env: in_words(here) }.into());
        }
        self.planner = self.planner.clone().for_model(&model);
        self.model = Some(model);
        Ok(())
    }

    /// Plans by this reward from the next plan on; by none where it cannot be used, rather than by one that is not meant.
    pub(super) fn use_reward(&mut self, reward: &Parameters) -> Result<(), WorkerError> {
        let Some(model) = &self.model else { return Ok(()) };
        match LearnedReward::load(reward, model) {
            Ok(reward) => self.reward = Some(reward),
            Err(e) => {
                (self.reward, self.agent) = (None, None);
                return Err(TaskError::NoPlanning(e).into());
            }
        }
        if let (Some(config), Some(agent)) = (self.planner_config(), &mut self.agent) {
            agent.plan_by(config);
        }
        Ok(())
    }

    /// How the planner looks ahead by the reward that there is.
    fn planner_config(&self) -> Option<PlannerConfig> {
        let is_sparse = self.reward.as_ref()?.is_sparse();
        let config = self.planner.clone();
        Some(if is_sparse { config.for_transitions() } else { config })
    }

    /// Gives the wheel to the planner, where there is one, or takes it away.
    pub(super) fn hand_over(&mut self, is_over: bool, seed: u64) {
        let config = self.planner_config().filter(|_| is_over && self.model.is_some());
        self.agent = config.map(|config| Agent::new(config, seed));
    }

    /// Whether the planner drives.
    pub(super) fn is_driving(&self) -> bool {
        self.agent.is_some()
    }

    /// Compares with a rollout, or no longer.
    pub(super) fn compare(&mut self, comparison: Option<RolloutComparison>) {
        (self.comparison, self.rollout) = (comparison, None);
    }

    /// A new episode: nobody has seen anything of it.
    pub(super) fn begin(&mut self) {
        (self.agent, self.rollout) = (None, None);
    }

    /// What the planner does where it drives; whoever takes hold of the wheel has it instead.
    ///
    /// Where it meets what is no number, it gives the wheel back.
    pub(super) fn act(&mut self, hands: Action, frame: &Frame) -> Result<Option<Action>, NotFinite> {
        if *hands != self.spec.neutral()[..] {
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
    /// Where that leads the rollout to what is no number, it ends.
    pub(super) fn acted(&mut self, frame: &Frame, action: Action) -> Result<(), NotFinite> {
        if let Some(agent) = &mut self.agent {
            agent.acted(action);
        }
        let (Some(comparison), Some(model)) = (self.comparison, &self.model) else { return Ok(()) };
        let is_old = |rollout: &Rollout| comparison.reset.is_some_and(|every| rollout.since >= every);
        let rollout = self.rollout.take().filter(|rollout| !is_old(rollout)).unwrap_or_else(|| {
            let z = model.observe(std::slice::from_ref(frame));
            Rollout { state: State { z, memory: model.no_memory(1) }, since: 0 }
        });
        // The mean and not a draw: what differs is what the model does not know, and not chance.
        let next = Next::Mean { temperature: TEMPERATURE };
        let state = model.imagine(&rollout.state, &actions_tensor(&[action]), next);
        let since = rollout.since + 1;
        state
            .require_finite(&format!("step {since} of the dream beside"))
            .inspect_err(|_| self.comparison = None)?;
        self.rollout = Some(Rollout { state, since });
        Ok(())
    }

    /// What the rollout shows where the real world shows `frame`.
    pub(super) fn view(&self, step: usize, frame: &Frame) -> Option<RolloutView> {
        let (Some(rollout), Some(model)) = (&self.rollout, &self.model) else { return None };
        let predicted = model.decode(&rollout.state.z).pop()?;
        let drift = rmse(&predicted, frame);
        Some(RolloutView { frame: predicted, step, since: rollout.since, drift })
    }

    /// Whether anything is to be seen of it.
    pub(super) fn has_rollout(&self) -> bool {
        self.rollout.is_some()
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
    use crate::worker::fixtures;

    fn gray(shade: u8) -> Frame {
        let side = fixtures::model().config().vae.height as u32;
        Frame::square(side, vec![shade; (3 * side * side) as usize])
    }

    fn assistant() -> Assistant {
        let mut assistant = Assistant::new(Arc::clone(fixtures::model().spec()), PlannerConfig::car_racing());
        let model = fixtures::model();
        assistant.use_model(model.parameters().clone()).unwrap();
        assistant
    }

    #[test]
    fn drift_is_how_far_pictures_are_apart() {
        assert_eq!(rmse(&gray(7), &gray(7)), 0.0);
        assert!((rmse(&gray(0), &gray(51)) - 0.2).abs() < 1e-6, "51 of 255");
    }

    #[test]
    fn a_rollout_begins_with_what_is_seen_and_then_sees_no_more() {
        let mut assistant = assistant();
        assistant.compare(Some(RolloutComparison { reset: Some(3) }));
        let mut views = Vec::new();
        for t in 0..5 {
            assistant.acted(&gray(10 * t), Action::new([0.0, 1.0, 0.0])).unwrap();
            views.push(assistant.view(usize::from(t), &gray(10)).unwrap());
        }
        assert_eq!(views.iter().map(|view| view.since).collect::<Vec<_>>(), [1, 2, 3, 1, 2]);

        let model = fixtures::model();
        let z = model.observe(&[gray(0)]);
        let mut state = State { z, memory: model.no_memory(1) };
        for _ in 0..3 {
            let next = Next::Mean { temperature: TEMPERATURE };
            state = model.imagine(&state, &actions_tensor(&[Action::new([0.0, 1.0, 0.0])]), next);
        }
        let by_hand = model.decode(&state.z).pop().unwrap();
        assert_eq!(views[2].frame, by_hand, "three steps after the only look");
        assert_eq!(views[2].drift, rmse(&by_hand, &gray(10)));
    }

    #[test]
    fn a_planner_drives_until_a_hand_is_on_the_wheel() {
        let mut assistant = assistant();
        assistant.hand_over(true, 0);
        assert!(!assistant.is_driving(), "without a reward it cannot");
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let reward = RewardEnsemble::new((36, fixtures::model().hash().as_str()), RewardConfig::tiny(), rng);
        assistant.use_reward(&reward.parameters()).unwrap();
        assistant.hand_over(true, 0);
        let action = assistant.act(Action::new([0.0; 3]), &gray(3)).unwrap();
        assert!(action.is_some_and(|action| action[1] > 0.0), "{action:?}");
        assert_eq!(assistant.act(Action::new([0.5, 0.0, 0.0]), &gray(3)), Ok(None));
        assert_eq!(assistant.act(Action::new([0.0; 3]), &gray(3)), Ok(None), "until it is handed over again");
    }

    #[test]
    fn a_reward_of_verdicts_drives_the_real_car_too_and_one_of_another_world_does_not() {
        let mut assistant = assistant();
        let verdicts = |world: &str| {
            let rng = &mut ChaCha8Rng::seed_from_u64(0);
            SparseReward::new((36, world), SparseConfig::tiny(), rng)
        };
        let reward = verdicts(&fixtures::model().hash());
        assistant.use_reward(&reward.parameters()).unwrap();
        assistant.hand_over(true, 3);
        let config = PlannerConfig::car_racing().for_transitions();
        let by_hand =
            Agent::new(config, 3).act(&fixtures::model(), &reward.for_inference(), &gray(3)).unwrap().0;
        assert_eq!(assistant.act(Action::new([0.0; 3]), &gray(3)), Ok(Some(by_hand)));
        let refused = assistant.use_reward(&verdicts("sha256:0").parameters()).unwrap_err().to_string();
        assert!(refused.contains("the planner cannot drive by this reward"), "{refused}");
        assert!(!assistant.is_driving(), "nor does it drive by the one before");
    }

    #[test]
    fn a_model_of_another_world_is_refused() {
        let refused = Assistant::new(Arc::new(WorldSpec::default()), PlannerConfig::car_racing())
            .use_model(fixtures::model().parameters().clone())
            .unwrap_err()
            .to_string();
        assert!(
            refused.contains("sees \"dummy-road\" (20 x 20)") && refused.contains("car-racing\" (84 x 84)"),
            "{refused}"
        );
    }
}
