//! Driving in dreams by what the pictures show: mostly along the road, at many speeds, with deliberate trips onto the grass and back.
//!
//! Unsafe driving is what dreams are for: more than half of the paper's queries show some.

use std::ops::ControlFlow;

use rand::{Rng, RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use tch::Tensor;

use super::handover::{Handover, Learned};
use super::pilot::{PilotStyle, ScriptedPilot};
use super::probe::{GAP, Probe, Sight};
use crate::dream::{DreamEpisode, TEMPERATURE};
use crate::env::{Action, Frame};
use crate::planner::{PlannerConfig, candidates};
use crate::tensor::{NotFinite, dims, to_vec};
use crate::world_model::{LatentState, Memory, Next, Noise, State, WorldModel, actions_tensor};

/// Steps from one view to the next. A person does not look more often than 25 times a second.
const VIEW_STEPS: usize = 2;
/// How much of a new view replaces what was seen before: dreams tremble.
const TRUST: f32 = 0.6;

/// A pilot who explores freely: wilder than those who record, and more often with the planner's actions.
pub fn explorer(rng: &mut impl Rng) -> ScriptedPilot {
    ScriptedPilot::new(PilotStyle {
        excursions: rng.random_range(0.1..0.3),
        pauses: rng.random_range(0.02..0.08),
        keys: 0.25,
        menu: 0.5,
        speeds: [rng.random_range(10.0..20.0), rng.random_range(45.0..70.0)],
        daring: rng.random_range(80.0..250.0),
        ..PilotStyle::varied()
    })
}

/// A pilot who gets on, and is slow where there is grass: so that it is not speed that tells safe clips from others.
fn tourist(rng: &mut impl Rng) -> ScriptedPilot {
    ScriptedPilot::new(PilotStyle {
        excursions: rng.random_range(0.08..0.2),
        pauses: rng.random_range(0.02..0.08),
        keys: 0.25,
        menu: 0.5,
        speeds: [rng.random_range(15.0..25.0), rng.random_range(55.0..80.0)],
        daring: rng.random_range(150.0..300.0),
        off_road_speed: 30.0,
    })
}

/// What somebody who drives in a dream is after.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Manner {
    /// Off the road nearly half of the time, at any speed.
    #[default]
    Exploring,
    /// Fast along the road. Slow trips onto the grass.
    Touring,
}

impl Manner {
    /// How often a player tries what the planner might, in the steps in which it does not already: once in so many.
    fn steps_between_tries(self) -> f64 {
        match self {
            Self::Exploring => 50.0,
            Self::Touring => 100.0,
        }
    }
}

/// A stand-in for a person who drives in a dream.
#[derive(Clone, Debug)]
pub struct DreamPlayer {
    manner: Manner,
    pilot: ScriptedPilot,
    rng: ChaCha8Rng,
    seen: Option<Sight>,
    /// What is left of a try, the next action last.
    tried: Vec<Action>,
}

impl DreamPlayer {
    /// A player whose moods follow from `seed`.
    pub fn new(manner: Manner, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(1);
        let pilot = match manner {
            Manner::Exploring => explorer(&mut rng),
            Manner::Touring => tourist(&mut rng),
        };
        Self { manner, pilot, rng, seen: None, tried: Vec::new() }
    }

    /// Takes in what a new picture shows.
    pub fn see(&mut self, sight: Sight) {
        self.seen = Some(self.seen.map_or(sight, |seen| seen.blended(&sight, TRUST)));
    }

    /// The action of this step. None before anything was seen.
    ///
    /// Now and then it is one of the authors' planner's courses of action, whatever comes of it: the reward will be asked
    /// about such, so the dreams had better show where they lead. Ours brakes less hard, and lies between those.
    pub fn act(&mut self) -> Action {
        let Some(seen) = self.seen else { return Action::default() };
        if self.tried.is_empty() && self.rng.random_bool(1.0 / self.manner.steps_between_tries()) {
            let mut all = candidates(&PlannerConfig::paper(), &mut self.rng);
            self.tried = all.swap_remove(self.rng.random_range(0..all.len()));
            self.tried.reverse();
        }
        let pilot = &mut self.pilot;
        self.tried.pop().unwrap_or_else(|| pilot.act(&seen.as_truth(), &mut self.rng))
    }
}

/// A dream of `n_steps` from `start`, in which both the noise and the player follow from `seed`.
pub fn play(
    model: &WorldModel,
    probe: &Probe,
    start: &LatentState,
    n_steps: usize,
    seed: u64,
) -> Result<DreamEpisode, NotFinite> {
    let go_on = &mut |_| ControlFlow::Continue(());
    let played = play_all(model, probe, &[(start, seed)], n_steps, Manner::Exploring, None, go_on);
    Ok(played?.into_iter().flatten().next().unwrap_or_else(|| unreachable!("nobody broke off")))
}

/// Dreams side by side, each from its start and with its own seed. `on_step` is told the count of steps.
///
/// Where something was `learned`, the player and a planner that follows it drive in turns.
/// Nothing comes where `on_step` breaks off. Where what is dreamed or planned is no number, that is the error.
pub fn play_all(
    model: &WorldModel,
    probe: &Probe,
    starts: &[(&LatentState, u64)],
    n_steps: usize,
    manner: Manner,
    learned: Option<&Learned>,
    on_step: &mut dyn FnMut(usize) -> ControlFlow<()>,
) -> Result<Option<Vec<DreamEpisode>>, NotFinite> {
    if starts.is_empty() {
        return Ok(Some(Vec::new()));
    }
    let mut dreams: Vec<_> =
        starts.iter().map(|(start, seed)| DreamEpisode::new((*start).clone(), *seed)).collect();
    let mut players: Vec<_> = starts.iter().map(|(_, seed)| DreamPlayer::new(manner, *seed)).collect();
    let mut handovers: Vec<_> =
        starts.iter().map(|(_, seed)| learned.map(|learned| Handover::new(learned, *seed))).collect();
    let mut noises: Vec<_> = starts.iter().map(|(_, seed)| ChaCha8Rng::seed_from_u64(*seed)).collect();
    let mut state = side_by_side(starts);
    let latent = model.config().mdn_rnn.latent;
    // The views of the last GAP steps, the oldest first.
    let mut views: Vec<Vec<Frame>> = Vec::new();
    for step in 0..n_steps {
        if step % VIEW_STEPS == 0 {
            views.push(model.decode(&state.z));
            if views.len() > GAP / VIEW_STEPS + 1 {
                views.remove(0);
            }
            // Before there is a view of GAP steps ago, the present one stands in for it: nothing moves.
            let now = &views[views.len() - 1];
            let earlier = if views.len() > GAP / VIEW_STEPS { &views[0] } else { now };
            for (player, sight) in players.iter_mut().zip(probe.read(earlier, now)) {
                player.see(sight);
            }
        }
        let zs = to_vec(&state.z);
        let drivers = players.iter_mut().zip(&mut handovers).enumerate();
        let actions: Vec<_> = drivers
            .zip(dreams.iter_mut().zip(zs.chunks_exact(latent as usize)))
            .map(|((i, (player, handover)), (dream, z))| {
                let planned = match handover {
                    Some(handover) => handover.act(model, &only(&state, i))?,
                    None => None,
                };
                let action = planned.unwrap_or_else(|| player.act());
                dream.zs.push(z);
                dream.actions.push(action);
                if planned.is_some() {
                    dream.note_planned();
                }
                Ok(action)
            })
            .collect::<Result<_, NotFinite>>()?;
        let noise = draw(&mut noises, latent);
        let next = Next::Sample { temperature: TEMPERATURE, noise: &noise };
        state = model.imagine(&state, &actions_tensor(&actions), next);
        state.require_finite(&format!("step {} of the dreams", step + 1))?;
        if on_step(step + 1).is_break() {
            return Ok(None);
        }
    }
    Ok(Some(dreams))
}

/// The starts as one batch.
fn side_by_side(starts: &[(&LatentState, u64)]) -> State {
    let states: Vec<State> = starts.iter().map(|(start, _)| State::from(*start)).collect();
    let all = |part: &dyn Fn(&State) -> Tensor| Tensor::cat(&states.iter().map(part).collect::<Vec<_>>(), 0);
    let z = all(&|state| state.z.shallow_clone());
    let [b, _] = dims(&z);
    assert_eq!(b as usize, starts.len(), "one row a start");
    let memory = Memory {
        c: all(&|state| state.memory.c.shallow_clone()),
        h: all(&|state| state.memory.h.shallow_clone()),
    };
    State { z, memory }
}

/// The state of the dream at `i` as a batch of one.
fn only(state: &State, i: usize) -> State {
    let row = |part: &Tensor| part.narrow(0, i as i64, 1);
    State { z: row(&state.z), memory: Memory { c: row(&state.memory.c), h: row(&state.memory.h) } }
}

/// Each dream's noise from its own generator, so that it does not matter which dreams are beside it.
fn draw(rngs: &mut [ChaCha8Rng], latent: i64) -> Noise {
    let noises: Vec<_> = rngs.iter_mut().map(|rng| Noise::draw(1, latent, rng)).collect();
    let all = |part: &dyn Fn(&Noise) -> Tensor| Tensor::cat(&noises.iter().map(part).collect::<Vec<_>>(), 0);
    Noise {
        uniform: all(&|noise| noise.uniform.shallow_clone()),
        normal: all(&|noise| noise.normal.shallow_clone()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::{CarRacing, Env as _, Seed};

    #[test]
    fn a_player_with_perfect_eyes_is_unsafe_for_a_good_part_of_the_time() {
        let (mut n_off, mut n_steps, mut n_tiles) = (0, 0, 0);
        for seed in 0..12 {
            let mut env = CarRacing::new(Seed::Native(seed));
            let mut player = DreamPlayer::new(Manner::Exploring, seed);
            loop {
                player.see(Sight::of(&env.truth()));
                let outcome = env.advance(player.act());
                n_steps += 1;
                n_off += usize::from(env.truth().wheels_off > 0);
                if outcome.end.is_some() {
                    break;
                }
            }
            n_tiles += env.n_visited();
        }
        let off_road = n_off as f64 / f64::from(n_steps);
        assert!((0.3..0.55).contains(&off_road), "{off_road} of the steps are off the road");
        assert!(n_tiles / 12 > 80, "{} tiles an episode", n_tiles / 12);
    }
}
