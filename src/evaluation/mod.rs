//! Driving real episodes and saying how well they went (Step 4 of the method, §12).
//!
//! Takes a policy and returns numbers. Every method drives the same tracks.

pub mod agreement;
pub mod fidelity;
pub mod metrics;
pub mod ranking;
pub mod results;
pub mod significance;
pub mod table;

use std::ops::ControlFlow;
use std::time::Instant;

use crate::env::{Action, Env, Frame, Outcome, Seed};
use crate::planner::{Agent, Plan};
use crate::reward::RewardModel;
use crate::tensor::NotFinite;
use crate::world_model::WorldModel;

pub use agreement::{Agreement, kappa};
pub use metrics::{EpisodeMetrics, MeanSd, Summary, Tally};
pub use ranking::auc;
pub use results::Results;
pub use significance::{Dunn, KruskalWallis, Untested, dunn, kruskal_wallis, untested};
pub use table::{aligned, table};

/// Which track each episode has: that of the seed plus its number, whatever the method.
///
/// ```
/// use dropj::env::Seed;
/// use dropj::evaluation::TracksAlike;
///
/// assert_eq!(TracksAlike { seed: 100 }.track(3), Seed::Native(103));
/// ```
///
/// `// DIFFERENCE:` the authors never seed the environment, so that no two methods drove the same tracks (method §12).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TracksAlike {
    /// The first episode's.
    pub seed: u64,
}

impl TracksAlike {
    /// The track of an episode, which are numbered from 0.
    pub fn track(self, episode: u64) -> Seed {
        Seed::Native(self.seed.wrapping_add(episode))
    }
}

/// Whoever drives.
pub trait Policy {
    /// The action for what is seen, unless what it is chosen by is no number.
    fn act(&mut self, frame: &Frame) -> Result<Action, NotFinite>;

    /// Is told which action the world was given, which an aid may have changed.
    fn acted(&mut self, executed: Action);

    /// The plan that the last action came from, if it was made for that action. Only such steps are timed.
    fn planned(&self) -> Option<&Plan> {
        None
    }
}

/// What happened in a step, for whoever watches.
#[derive(Debug)]
pub struct Step<'a> {
    /// Its number, from 0.
    pub t: usize,
    /// What was seen.
    pub frame: &'a Frame,
    /// What was done, which an aid may have changed.
    pub executed: Action,
    /// What came of it.
    pub outcome: Outcome,
    /// The plan, where one was made.
    pub plan: Option<&'a Plan>,
}

/// Lets `policy` drive an episode of `env` from `seed` to its end, or until `on_step` breaks.
///
/// After a break the metrics are those of the steps so far. Where the policy meets what is no number, the episode ends.
pub fn evaluate_episode(
    env: &mut dyn Env,
    seed: Seed,
    policy: &mut dyn Policy,
    mut on_step: impl FnMut(&dyn Env, &Step<'_>) -> ControlFlow<()>,
) -> Result<EpisodeMetrics, NotFinite> {
    let mut tally = Tally::default();
    env.reset(seed);
    for t in 0.. {
        let frame = env.frame();
        let asked = Instant::now();
        let action =
            policy.act(&frame).map_err(|NotFinite(what)| NotFinite(format!("{what} at step {t}")))?;
        let secs = asked.elapsed().as_secs_f64();
        let outcome = env.advance(action);
        let executed = env.executed().unwrap_or(action);
        policy.acted(executed);
        let plan = policy.planned();
        tally.add(&outcome, plan.map(|_| secs));
        let watched = on_step(env, &Step { t, frame: &frame, executed, outcome, plan });
        if outcome.end.is_some() || watched.is_break() {
            break;
        }
    }
    Ok(tally.metrics())
}

/// The method's driver: an [`Agent`] with the models that it asks.
#[derive(Debug)]
pub struct PlanningPolicy<'a, R> {
    model: &'a WorldModel,
    reward: &'a R,
    agent: Agent,
    is_fresh: bool,
}

impl<'a, R: RewardModel> PlanningPolicy<'a, R> {
    /// `agent` with `model` and `reward`, for one episode.
    pub fn new(model: &'a WorldModel, reward: &'a R, agent: Agent) -> Self {
        Self { model, reward, agent, is_fresh: false }
    }
}

impl<R: RewardModel> Policy for PlanningPolicy<'_, R> {
    fn act(&mut self, frame: &Frame) -> Result<Action, NotFinite> {
        let (action, plan) = self.agent.act(self.model, self.reward, frame)?;
        self.is_fresh = plan.is_some();
        Ok(action)
    }

    fn acted(&mut self, executed: Action) {
        self.agent.acted(executed);
    }

    fn planned(&self) -> Option<&Plan> {
        self.agent.plan().filter(|_| self.is_fresh)
    }
}

/// Drives ahead gently and looks at nothing: what a method must beat.
#[derive(Clone, Copy, Debug, Default)]
pub struct StraightOn;

impl Policy for StraightOn {
    fn act(&mut self, _: &Frame) -> Result<Action, NotFinite> {
        Ok(Action::new(0.0, 0.1, 0.0))
    }

    fn acted(&mut self, _: Action) {}
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::env::{Aids, End, Events, ObstacleCarRacing, Obstacles, Truth};
    use crate::planner::PlannerConfig;
    use crate::reward::{RewardConfig, RewardEnsemble};
    use crate::world_model::{WorldModelConfig, untrained};

    /// Ten steps: a tile at every even one, grass at every fifth.
    struct TenSteps(usize);

    impl Env for TenSteps {
        fn reset(&mut self, _: Seed) {
            self.0 = 0;
        }

        fn advance(&mut self, _: Action) -> Outcome {
            let t = self.0;
            self.0 += 1;
            let events =
                Events { new_tile: t.is_multiple_of(2), grass: t.is_multiple_of(5), ..Events::default() };
            let reward = if events.grass { -1.0 } else { 10.0 * f32::from(events.new_tile) };
            Outcome { reward, events, end: (self.0 == 10).then_some(End::TimeLimit) }
        }

        fn frame(&self) -> Frame {
            Frame::new(20, vec![80u8; 3 * 20 * 20])
        }

        fn truth(&self) -> Truth {
            Truth::default()
        }

        fn picture(&self, _: u32, _: u32) -> Vec<u8> {
            Vec::new()
        }
    }

    #[test]
    fn an_episode_is_driven_to_its_end() {
        let mut seen = Vec::new();
        let metrics = evaluate_episode(&mut TenSteps(5), Seed::Native(0), &mut StraightOn, |_, step| {
            seen.push(step.t);
            ControlFlow::Continue(())
        })
        .unwrap();
        assert_eq!(seen, (0..10).collect::<Vec<_>>());
        assert_eq!(
            (metrics.n_steps, metrics.ret, metrics.new_tile_rate, metrics.grass_rate),
            (10, 38.0, 0.5, 0.2)
        );
        assert_eq!((metrics.chuckhole_rate, metrics.plan_ms_mean), (None, None));
    }

    #[test]
    fn whoever_watches_can_stop_it() {
        let stop_at_three = |_: &dyn Env, step: &Step<'_>| {
            if step.t == 3 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        let metrics =
            evaluate_episode(&mut TenSteps(0), Seed::Native(0), &mut StraightOn, stop_at_three).unwrap();
        assert_eq!((metrics.n_steps, metrics.finished), (4, false));
    }

    #[test]
    fn with_aids_what_is_executed_is_not_what_was_chosen() {
        let executed = |aids| {
            let seed = Seed::Native(0);
            let mut env = ObstacleCarRacing::new(seed, Obstacles::Chuckholes, aids);
            let mut executed = Action::default();
            let metrics = evaluate_episode(&mut env, seed, &mut StraightOn, |_, step| {
                executed = step.executed;
                ControlFlow::Break(())
            })
            .unwrap();
            assert_eq!((metrics.n_steps, metrics.car_rate), (1, None), "no cars, no rate of them");
            executed
        };
        assert_eq!(executed(Aids::ALL), Action::new(0.0, 0.3, 0.0));
        assert_ne!(executed(Aids::NONE), executed(Aids::ALL));
    }

    #[test]
    fn a_planning_policy_shows_its_plan_every_four_steps() {
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let model = untrained(&WorldModelConfig::tiny(), rng);
        let n_features = model.config().n_features();
        let reward = RewardEnsemble::new(n_features, "sha256:0", RewardConfig::tiny(), rng);
        let mut policy = PlanningPolicy::new(&model, &reward, Agent::new(PlannerConfig::car_racing(), 0));
        let mut planned = Vec::new();
        let metrics = evaluate_episode(&mut TenSteps(0), Seed::Native(0), &mut policy, |_, step| {
            planned.extend(step.plan.map(|_| step.t));
            ControlFlow::Continue(())
        })
        .unwrap();
        assert_eq!(planned, [0, 4, 8]);
        assert!(metrics.plan_ms_mean.is_some_and(|ms| ms > 0.0), "plans take time");
    }
}
