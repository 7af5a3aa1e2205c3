//! The planner with the simulator's own dynamics and reward: what its candidates could do if nothing had to be learned.

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use super::Policy;
use crate::planner::{PlannerConfig, candidates};
use crate::tensor::NotFinite;
use crate::world::{Action, EventKind, Frame, World};

/// What a step costs in which a safety event goes on: in the built-in worlds as much as a tile brings.
const COST: f32 = 10.0;

/// Tries every candidate of the planner in a copy of the world, and does what brought most.
///
/// ```text
/// return = Σ_{t=0}^{H−1} (the world's reward at t, less 10 where something unsafe goes on)
/// ```
#[derive(Debug)]
pub struct Oracle {
    config: PlannerConfig,
    rng: ChaCha8Rng,
    t: usize,
    course: Vec<Action>,
}

impl Oracle {
    /// One for an episode. `seed` decides its candidates, which are those of an agent with this seed.
    pub fn new(config: PlannerConfig, seed: u64) -> Self {
        Self { config, rng: ChaCha8Rng::seed_from_u64(seed), t: 0, course: Vec::new() }
    }

    /// What comes of a course of action. Nothing where the world cannot be copied.
    fn tried(world: &dyn World, course: &[Action]) -> Option<f32> {
        let mut copy = world.copied()?;
        let events = &world.spec().events;
        let mut sum = 0.0;
        for action in course {
            let Ok(step) = copy.step(action) else { break };
            let is_unsafe = step.events.iter().zip(events);
            let is_unsafe = is_unsafe
                .filter(|(_, event)| event.kind == EventKind::Safety)
                .any(|(met, _)| met.happened || met.goes_on);
            sum += step.reward.unwrap_or_default() - if is_unsafe { COST } else { 0.0 };
            if step.end.is_some() {
                break;
            }
        }
        Some(sum)
    }
}

impl Policy for Oracle {
    fn act(&mut self, _: &Frame) -> Result<Action, NotFinite> {
        Err(NotFinite("what an oracle knows of a world that it cannot look into".to_owned()))
    }

    fn act_in(&mut self, world: &dyn World, frame: &Frame) -> Result<Action, NotFinite> {
        let step = self.t % self.config.replan.clamp(1, self.config.horizon);
        if step == 0 {
            let mut best: Option<(f32, Vec<Action>)> = None;
            for course in candidates(&self.config, &mut self.rng) {
                let Some(sum) = Self::tried(world, &course) else { return self.act(frame) };
                if best.as_ref().is_none_or(|(most, _)| sum > *most) {
                    best = Some((sum, course));
                }
            }
            self.course = best.map(|(_, course)| course).unwrap_or_default();
        }
        self.t += 1;
        let none = || NotFinite("the number of the planner's candidates".to_owned());
        self.course.get(step).copied().ok_or_else(none)
    }

    fn acted(&mut self, _: Action) {}
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::*;
    use crate::evaluation::{Constant, evaluate_episode};
    use crate::world::cars::{Aids, CarWorld};

    #[test]
    fn who_knows_the_world_drives_better_and_leaves_it_as_it_was() {
        let drive = |policy: &mut dyn Policy| {
            let mut world = CarWorld::open("obstacle-car-racing-chuckholes", Aids::ALL).unwrap();
            evaluate_episode(&mut world, 5, policy, |_, step| {
                if step.t == 150 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            })
            .unwrap()
        };
        let config = PlannerConfig { horizon: 12, ..PlannerConfig::obstacle_car_racing_chuckholes() };
        let (knowing, blind) =
            (drive(&mut Oracle::new(config, 0)), drive(&mut Constant(Action::new([0.0, 0.5, 0.0]))));
        assert_eq!(knowing.n_steps, blind.n_steps);
        assert!(knowing.ret > blind.ret, "{} and {}", knowing.ret, blind.ret);
        assert!(knowing.event("grass") < blind.event("grass"));
    }
}
