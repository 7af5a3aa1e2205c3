//! Driving real episodes and saying how well they went (Step 4 of the method, §12).
//!
//! Takes a policy and returns numbers. Every method drives the same tracks.

pub mod agreement;
pub mod diversity;
pub mod fidelity;
pub mod hazards;
pub mod metrics;
pub mod oracle;
pub mod paired;
pub mod ranking;
pub mod results;
pub mod significance;
pub mod table;
pub mod times;

use std::ops::ControlFlow;
use std::time::Instant;

use crate::planner::{Agent, Plan};
use crate::reward::RewardModel;
use crate::tensor::NotFinite;
use crate::world::{Action, Frame, World, WorldError};
use crate::world_model::WorldModel;

pub use agreement::{Agreement, kappa};
pub use diversity::diversity;
pub use hazards::{HazardRanking, HazardTally};
pub use metrics::{EpisodeMetrics, EventFigure, MeanSd, Summary, Tally};
pub use oracle::Oracle;
pub use paired::{Friedman, bootstrap, cliffs_delta, friedman, holm, wilcoxon};
pub use ranking::auc;
pub use results::Results;
pub use significance::{Dunn, KruskalWallis, Untested, dunn, kruskal_wallis, untested};
pub use table::{aligned, table};
pub use times::{AnswerTimes, TimedAnswer};

/// Which seed each episode has: the first plus its number, whatever the method.
///
/// ```
/// use dropj::evaluation::TracksAlike;
///
/// assert_eq!(TracksAlike { seed: 100 }.track(3), 103);
/// ```
///
/// `// DIFFERENCE:` the authors never seed the environment, so that no two methods drove the same tracks (method §12).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TracksAlike {
    /// The first episode's.
    pub seed: u64,
}

impl TracksAlike {
    /// The seed of an episode, which are numbered from 0.
    pub fn track(self, episode: u64) -> u64 {
        self.seed.wrapping_add(episode)
    }
}

/// Whoever drives.
pub trait Policy {
    /// The action for what is seen, unless what it is chosen by is no number.
    fn act(&mut self, frame: &Frame) -> Result<Action, NotFinite>;

    /// The same where a policy may look into the world itself. Only an [`Oracle`] does.
    fn act_in(&mut self, world: &dyn World, frame: &Frame) -> Result<Action, NotFinite> {
        let _ = world;
        self.act(frame)
    }

    /// Is told which action the world was given, which an aid may have changed.
    fn acted(&mut self, executed: Action);

    /// The plan that the last action came from, if it was made for that action. Only such steps are timed.
    fn planned(&self) -> Option<&Plan> {
        None
    }
}

/// What happened in a step, for whoever watches.
#[derive(Debug)]
pub struct Watched<'a> {
    /// Its number, from 0.
    pub t: usize,
    /// What was seen.
    pub frame: &'a Frame,
    /// What was done, which an aid may have changed.
    pub executed: Action,
    /// What came of it.
    pub step: &'a crate::world::Step,
    /// The plan, where one was made.
    pub plan: Option<&'a Plan>,
}

/// Why an episode broke off.
#[derive(Debug, thiserror::Error)]
pub enum EpisodeError {
    /// What the policy goes by is no number.
    #[error(transparent)]
    NotFinite(#[from] NotFinite),
    /// The world failed.
    #[error("the world failed at step {step}: {met}")]
    World {
        /// How many steps there were.
        step: usize,
        /// What it met.
        met: WorldError,
    },
}

/// Lets `policy` drive an episode of `world` from `seed` to its end, or until `on_step` breaks.
///
/// After a break the metrics are those of the steps so far. Where the policy meets what is no number, or the world fails,
/// the episode breaks off.
pub fn evaluate_episode(
    world: &mut dyn World,
    seed: u64,
    policy: &mut dyn Policy,
    mut on_step: impl FnMut(&dyn World, &Watched<'_>) -> ControlFlow<()>,
) -> Result<EpisodeMetrics, EpisodeError> {
    let mut tally = Tally::of(&world.spec().events);
    let failed = |step, met| EpisodeError::World { step, met };
    let mut frame = world.reset(seed).map_err(|met| failed(0, met))?;
    for t in 0.. {
        let asked = Instant::now();
        let action = policy
            .act_in(world, &frame)
            .map_err(|NotFinite(what)| NotFinite(format!("{what} at step {t}")))?;
        let secs = asked.elapsed().as_secs_f64();
        let step = world.step(&action).map_err(|met| failed(t, met))?;
        let executed = step.executed.unwrap_or(action);
        policy.acted(executed);
        let plan = policy.planned();
        tally.add(&step, plan.map(|_| secs));
        let watched = on_step(world, &Watched { t, frame: &frame, executed, step: &step, plan });
        if step.end.is_some() || watched.is_break() {
            break;
        }
        frame = step.frame;
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

/// Does the same throughout and looks at nothing: what a method must beat.
#[derive(Clone, Copy, Debug)]
pub struct Constant(pub Action);

impl Policy for Constant {
    fn act(&mut self, _: &Frame) -> Result<Action, NotFinite> {
        Ok(self.0)
    }

    fn acted(&mut self, _: Action) {}
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::planner::PlannerConfig;
    use crate::reward::{RewardConfig, RewardEnsemble, RewardInputs};
    use crate::world::End;
    use crate::world::cars::{Aids, CarAction, CarWorld, Env, Events, Outcome, Seed, Truth};
    use crate::world_model::{WorldModelConfig, untrained};

    /// Ten steps: a tile at every even one, grass at every fifth.
    struct TenSteps(usize);

    impl Env for TenSteps {
        fn reset(&mut self, _: Seed) {
            self.0 = 0;
        }

        fn advance(&mut self, _: CarAction) -> Outcome {
            let t = self.0;
            self.0 += 1;
            let events =
                Events { new_tile: t.is_multiple_of(2), grass: t.is_multiple_of(5), ..Events::default() };
            let reward = if events.grass { -1.0 } else { 10.0 * f32::from(events.new_tile) };
            Outcome { reward, events, end: (self.0 == 10).then_some(End::Truncated) }
        }

        fn frame(&self) -> Frame {
            Frame::square(20, vec![80u8; 3 * 20 * 20])
        }

        fn truth(&self) -> Truth {
            Truth::default()
        }

        fn picture(&self, _: u32, _: u32) -> Vec<u8> {
            Vec::new()
        }
    }

    fn ten_steps(t: usize) -> CarWorld {
        CarWorld::of("ten-steps", TenSteps(t))
    }

    fn straight_on() -> Constant {
        Constant(Action::new([0.0, 0.1, 0.0]))
    }

    #[test]
    fn an_episode_is_driven_to_its_end() {
        let mut seen = Vec::new();
        let metrics = evaluate_episode(&mut ten_steps(5), 0, &mut straight_on(), |_, step| {
            seen.push(step.t);
            ControlFlow::Continue(())
        })
        .unwrap();
        assert_eq!(seen, (0..10).collect::<Vec<_>>());
        assert_eq!((metrics.n_steps, metrics.ret), (10, 38.0));
        assert_eq!((metrics.event("new tile"), metrics.event("grass")), (Some(0.5), Some(0.2)));
        assert_eq!((metrics.event("chuckhole"), metrics.plan_ms_mean), (None, None));
    }

    #[test]
    fn whoever_watches_can_stop_it() {
        let stop_at_three = |_: &dyn World, step: &Watched<'_>| {
            if step.t == 3 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        let metrics = evaluate_episode(&mut ten_steps(0), 0, &mut straight_on(), stop_at_three).unwrap();
        assert_eq!((metrics.n_steps, metrics.finished), (4, false));
    }

    #[test]
    fn with_aids_what_is_executed_is_not_what_was_chosen() {
        let executed = |aids| {
            let mut world = CarWorld::open("obstacle-car-racing-chuckholes", aids).unwrap();
            let mut executed = Action::default();
            let metrics = evaluate_episode(&mut world, 0, &mut straight_on(), |_, step| {
                executed = step.executed;
                ControlFlow::Break(())
            })
            .unwrap();
            assert_eq!((metrics.n_steps, metrics.event("car")), (1, None), "no cars, no rate of them");
            executed
        };
        assert_eq!(executed(Aids::ALL), [0.0, 0.3, 0.0]);
        assert_ne!(executed(Aids::NONE), executed(Aids::ALL));
    }

    #[test]
    fn a_planning_policy_shows_its_plan_every_four_steps() {
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let model = untrained(&WorldModelConfig::tiny(), rng);
        let reward = RewardEnsemble::new(RewardInputs::of(&model), RewardConfig::tiny(), rng);
        let mut policy = PlanningPolicy::new(&model, &reward, Agent::new(PlannerConfig::car_racing(), 0));
        let mut planned = Vec::new();
        let metrics = evaluate_episode(&mut ten_steps(0), 0, &mut policy, |_, step| {
            planned.extend(step.plan.map(|_| step.t));
            ControlFlow::Continue(())
        })
        .unwrap();
        assert_eq!(planned, [0, 4, 8]);
        assert!(metrics.plan_ms_mean.is_some_and(|ms| ms > 0.0), "plans take time");
    }

    #[test]
    fn a_world_that_fails_ends_the_episode_with_its_step() {
        /// Fails in its third step.
        struct Failing(CarWorld, usize);

        impl World for Failing {
            fn spec(&self) -> &std::sync::Arc<crate::world::WorldSpec> {
                self.0.spec()
            }

            fn reset(&mut self, seed: u64) -> Result<Frame, WorldError> {
                self.0.reset(seed)
            }

            fn step(&mut self, action: &[f32]) -> Result<crate::world::Step, WorldError> {
                self.1 += 1;
                if self.1 == 3 { Err(WorldError::NoEpisode) } else { self.0.step(action) }
            }
        }

        let go_on = |_: &dyn World, _: &Watched<'_>| ControlFlow::Continue(());
        let met = evaluate_episode(&mut Failing(ten_steps(0), 0), 0, &mut straight_on(), go_on).unwrap_err();
        assert!(met.to_string().starts_with("the world failed at step 2: "), "{met}");
    }
}
