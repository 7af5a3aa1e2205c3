//! Episodes in the real world as pictures: beside the futures that the planner chose from, or beside a dream.

use std::ops::{ControlFlow, Range};
use std::path::Path;

use anyhow::Context as _;
use dropj::clip::{beside, futures};
use dropj::dream::TEMPERATURE;
use dropj::evaluation::{PlanningPolicy, evaluate_episode};
use dropj::planner::{Agent, Plan, PlannerConfig};
use dropj::reward::LearnedReward;
use dropj::session::{Header, SessionStore};
use dropj::tensor::from_slice;
use dropj::world::{Action, Frame};
use dropj::world_model::{Next, State, WorldModel, actions_tensor};

use super::chosen_world::ChosenWorld;
use super::meter::Meter;
use super::models;

/// A dream beside the real world.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Compared {
    /// After how many steps it looks at the real world and begins anew, if ever.
    pub(crate) reset: Option<usize>,
}

/// What was driven for a clip.
#[derive(Debug)]
pub(crate) struct Driven {
    /// What is shown of it.
    pub(crate) frames: Vec<Frame>,
    /// How many steps were driven.
    pub(crate) n_steps: usize,
    /// The true return of those, which the agent did not see.
    pub(crate) ret: f32,
}

/// Lets the planner act by the reward of the session in `dir`, and shows `every` so many of these `steps`: beside its futures, or
/// beside a dream where that is asked for. The seed decides the episode; whether the world may help is said with it.
pub(crate) fn drive(
    dir: &Path,
    model: &WorldModel,
    (seed, aids): (u64, bool),
    compared: Option<Compared>,
    steps: Range<usize>,
    every: usize,
) -> anyhow::Result<Driven> {
    let env = ChosenWorld::of_session(&Header::read(dir)?, Some(model))?;
    models::require(model, &env)?;
    let (_, kept) = SessionStore::read_reward(dir)?;
    let none = || format!("the session {dir:?} has no reward yet: fit one in the window");
    let reward = LearnedReward::load(kept.as_ref().with_context(none)?, model)?;
    let config = PlannerConfig::of_world(&env.spec, model);
    let config = if reward.is_sparse() { config.for_transitions() } else { config };
    let mut policy = PlanningPolicy::new(model, &reward, Agent::new(config, seed));
    let mut world = env.open(aids)?;
    let mut dream = compared.map(|compared| Dreamt { compared, model, last: None });
    let (mut considered, mut frames) = (Considered::default(), Vec::new());
    let (mut met, mut meter) = (None, Meter::new());
    let metrics = evaluate_episode(&mut *world, seed, &mut policy, |_, watched| {
        meter.at("steps", watched.t, steps.end, String::new);
        let is_shown = steps.contains(&watched.t) && (watched.t - steps.start).is_multiple_of(every);
        if let Some(plan) = watched.plan.filter(|_| dream.is_none()) {
            considered = Considered::of(plan, model);
        }
        let dreamt = match dream.as_mut().map(|dream| dream.acted(watched.frame, watched.executed)) {
            None => None,
            Some(Ok(dreamt)) => Some(dreamt),
            Some(Err(not_finite)) => {
                met = Some(not_finite);
                return ControlFlow::Break(());
            }
        };
        if is_shown {
            frames.push(match dreamt {
                Some(dreamt) => beside(watched.frame, &dreamt),
                None => futures(watched.frame, &considered.lead_to, considered.chosen),
            });
        }
        if watched.t + 1 < steps.end { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    })?;
    if let Some(met) = met {
        return Err(met.into());
    }
    anyhow::ensure!(!frames.is_empty(), "that episode has {} steps", metrics.n_steps);
    Ok(Driven { frames, n_steps: metrics.n_steps, ret: metrics.ret })
}

/// What the planner chose from.
#[derive(Default)]
struct Considered {
    /// The last picture of each plan.
    lead_to: Vec<Frame>,
    chosen: usize,
}

impl Considered {
    fn of(plan: &Plan, model: &WorldModel) -> Self {
        let lasts = plan.candidates.iter().filter(|candidate| !candidate.zs.is_empty());
        let lasts: Vec<f32> = lasts.flat_map(|it| it.zs.row(it.zs.len() - 1)).copied().collect();
        let width = plan.candidates.first().map_or(1, |candidate| candidate.zs.width);
        let lead_to = model.decode(&from_slice(&lasts, &[(lasts.len() / width) as i64, width as i64]));
        Self { lead_to, chosen: plan.chosen }
    }
}

/// What the world model dreams under the actions of the real world.
struct Dreamt<'a> {
    compared: Compared,
    model: &'a WorldModel,
    last: Option<(State, usize)>,
}

impl Dreamt<'_> {
    /// What it shows where the real world shows `frame`, before it moves on with `action`.
    fn acted(&mut self, frame: &Frame, action: Action) -> Result<Frame, dropj::tensor::NotFinite> {
        let is_young = |since: &usize| self.compared.reset.is_none_or(|every| *since < every);
        let (state, since) = self.last.take().filter(|(_, since)| is_young(since)).unwrap_or_else(|| {
            let z = self.model.observe(std::slice::from_ref(frame));
            (State { z, memory: self.model.no_memory(1) }, 0)
        });
        let shown = self.model.decode(&state.z).pop().unwrap_or_else(|| frame.clone());
        // The mean and not a draw, as in the window: what differs is what the model does not know, and not chance.
        let next = Next::Mean { temperature: TEMPERATURE };
        let state = self.model.imagine(&state, &actions_tensor(&[action]), next);
        state.require_finite(&format!("step {} of the dream beside", since + 1))?;
        self.last = Some((state, since + 1));
        Ok(shown)
    }
}
