//! Somebody who plays in dreams: a car by what the pictures show, anything else by what was done in recordings.
//!
//! Unsafe things must happen there, too: that is what dreams are for. So now and then something is tried, whatever comes of it.

use std::ops::ControlFlow;
use std::sync::Arc;

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use tch::Tensor;

use super::handover::{Handover, Learned};
use super::probe::{Probe, Reads};
use crate::dream::{DreamEpisode, TEMPERATURE};
use crate::planner::Snippets;
use crate::tensor::{NotFinite, to_vec};
use crate::world::cars::{CarPlayer, Sight};
use crate::world::{Action, Explorer, Frame, OwnPolicy as _, WorldSpec};
use crate::world_model::{LatentState, Memory, Next, Noise, State, WorldModel, actions_tensor};

/// Of so many recorded moments that look most like the present one is drawn, what was done in it is done again.
const N_NEAREST: usize = 16;
/// How long something is tried, in seconds.
const TRY_SECS: [f64; 2] = [0.3, 1.5];

/// What somebody who plays in a dream is after.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Manner {
    /// To see everything, for a good part what is unsafe: a car is off the road nearly half of the time, at any speed.
    #[default]
    Exploring,
    /// To get on, and unsafe things now and then: a car is fast along the road, and slow on trips onto the grass.
    Touring,
}

impl Manner {
    /// How often a player without a car tries something, in the time in which it does not already: once in so many seconds.
    fn secs_between_tries(self) -> f64 {
        match self {
            Self::Exploring => 1.0,
            Self::Touring => 3.0,
        }
    }
}

/// What players know of a world before they play.
#[derive(Clone, Debug)]
pub enum Knowledge {
    /// How to drive a car.
    Car,
    /// What was done in recordings, if that is known, and what can be done at all.
    World {
        /// Its axes and rate.
        spec: Arc<WorldSpec>,
        /// What was done.
        snippets: Option<Arc<Snippets>>,
    },
}

impl Knowledge {
    /// That of the world of this model, which is seen through this probe.
    pub fn of(model: &WorldModel, probe: &Probe) -> Self {
        if matches!(probe.reads(), Reads::Car { .. }) {
            return Self::Car;
        }
        let spec = model.spec();
        let read = Snippets::read(model.parameters(), spec.axes.len(), model.config().mdn_rnn.latent);
        let snippets = read.unwrap_or_else(|met| {
            log::warn!("the recorded actions in the world model cannot be used: {met}");
            None
        });
        Self::World { spec: Arc::clone(spec), snippets: snippets.map(Arc::new) }
    }
}

/// A stand-in for a person who plays in a dream.
#[derive(Clone, Debug)]
pub struct DreamPlayer(Who);

#[derive(Clone, Debug)]
enum Who {
    Driver(Box<CarPlayer>),
    Imitator(Box<Imitator>),
}

impl DreamPlayer {
    /// A player whose moods follow from `seed`.
    pub fn new(knowledge: &Knowledge, manner: Manner, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(1);
        Self(match (knowledge, manner) {
            (Knowledge::Car, Manner::Exploring) => Who::Driver(Box::new(CarPlayer::exploring(rng))),
            (Knowledge::Car, Manner::Touring) => Who::Driver(Box::new(CarPlayer::touring(rng))),
            (Knowledge::World { spec, snippets }, manner) => {
                Who::Imitator(Box::new(Imitator::new(spec, snippets.clone(), manner, rng)))
            }
        })
    }

    /// Takes in what a new picture shows of a car. Others do not look.
    pub fn see(&mut self, sight: Sight) {
        if let Who::Driver(driver) = &mut self.0 {
            driver.see(sight);
        }
    }

    /// The action of this step, in which the latents are `z`.
    ///
    /// Whoever drives a car goes by what was seen, and does nothing before that.
    pub fn act(&mut self, z: &[f32]) -> Action {
        match &mut self.0 {
            Who::Driver(driver) => driver.act(),
            Who::Imitator(imitator) => imitator.act(z),
        }
    }
}

/// Does what was done in recordings where it looked like the present moment, a few steps at a time, and now and then
/// something by chance. Where nothing was recorded all is by chance.
#[derive(Clone, Debug)]
struct Imitator {
    spec: Arc<WorldSpec>,
    snippets: Option<Arc<Snippets>>,
    explorer: Explorer,
    /// The probability that a try begins in a step, where none goes on.
    tries: f64,
    /// The steps of a try that are left.
    n_tried: u32,
    /// What is left of a snippet, the next action last.
    left: Vec<Action>,
    rng: ChaCha8Rng,
}

impl Imitator {
    fn new(spec: &Arc<WorldSpec>, snippets: Option<Arc<Snippets>>, manner: Manner, rng: ChaCha8Rng) -> Self {
        Self {
            spec: Arc::clone(spec),
            snippets,
            explorer: Explorer::new(Arc::clone(spec)),
            tries: (1.0 / (manner.secs_between_tries() * spec.rate)).clamp(0.0, 1.0),
            n_tried: 0,
            left: Vec::new(),
            rng,
        }
    }

    fn act(&mut self, z: &[f32]) -> Action {
        let Some(snippets) = self.snippets.clone() else { return self.explore() };
        if self.n_tried == 0 && self.rng.random_bool(self.tries) {
            let secs = self.rng.random_range(TRY_SECS[0]..TRY_SECS[1]);
            self.n_tried = (secs * self.spec.rate).ceil() as u32;
            self.left.clear();
        }
        if self.n_tried > 0 {
            self.n_tried -= 1;
            return self.explore();
        }
        if self.left.is_empty()
            && let Some(snippet) = snippets.near(z, N_NEAREST, &mut self.rng)
        {
            // All of it, or at least half: so that it is not always the same moments in which the next one begins.
            let n = self.rng.random_range(snippet.len().div_ceil(2)..=snippet.len());
            self.left = snippet[..n].iter().rev().copied().collect();
        }
        let Some(action) = self.left.pop() else { return self.explore() };
        self.spec.checked(&action).unwrap_or_else(|_| self.neutral())
    }

    fn explore(&mut self) -> Action {
        self.explorer.act(&mut self.rng).unwrap_or_else(|_| self.neutral())
    }

    fn neutral(&self) -> Action {
        Action::new(self.spec.neutral())
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
    let go_on = &mut |_, _: Option<&[Frame]>| ControlFlow::Continue(());
    let playing = Playing { n_steps, manner: Manner::Exploring, learned: None };
    let played = play_all(model, probe, &[(start, seed)], &playing, go_on);
    Ok(played?.into_iter().flatten().next().unwrap_or_else(|| unreachable!("nobody broke off")))
}

/// How dreams are played.
#[derive(Debug)]
pub struct Playing<'a> {
    /// How long each is.
    pub n_steps: usize,
    /// What the player is after.
    pub manner: Manner,
    /// What a planner follows that drives in turns with the player, where something was learned.
    pub learned: Option<&'a Learned>,
}

/// Is told the count of steps, and what was looked at in the last.
pub type OnStep<'a> = dyn FnMut(usize, Option<&[Frame]>) -> ControlFlow<()> + 'a;

/// Dreams side by side, each from its start and with its own seed.
///
/// `on_step` is told the count of steps, and the pictures in which the last one began, one of each dream, where somebody looked
/// at them. Nothing comes where `on_step` breaks off. Where what is dreamed or planned is no number, that is the error.
pub fn play_all(
    model: &WorldModel,
    probe: &Probe,
    starts: &[(&LatentState, u64)],
    &Playing { n_steps, manner, learned }: &Playing<'_>,
    on_step: &mut OnStep<'_>,
) -> Result<Option<Vec<DreamEpisode>>, NotFinite> {
    if starts.is_empty() {
        return Ok(Some(Vec::new()));
    }
    let mut dreams: Vec<_> =
        starts.iter().map(|(start, seed)| DreamEpisode::new((*start).clone(), *seed)).collect();
    let knowledge = Knowledge::of(model, probe);
    let mut players: Vec<_> =
        starts.iter().map(|(_, seed)| DreamPlayer::new(&knowledge, manner, *seed)).collect();
    let mut handovers: Vec<_> =
        starts.iter().map(|(_, seed)| learned.map(|learned| Handover::new(learned, *seed))).collect();
    let mut noises: Vec<_> = starts.iter().map(|(_, seed)| ChaCha8Rng::seed_from_u64(*seed)).collect();
    let mut state = State::side_by_side(&starts.iter().map(|(start, _)| *start).collect::<Vec<_>>());
    let latent = model.config().mdn_rnn.latent;
    let mut views = matches!(knowledge, Knowledge::Car).then(|| Views::new(probe));
    for step in 0..n_steps {
        if let Some(sights) = views.as_mut().and_then(|views| views.look(step, model, &state)) {
            players.iter_mut().zip(sights).for_each(|(player, sight)| player.see(sight));
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
                let action = planned.unwrap_or_else(|| player.act(z));
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
        let view = views.as_ref().and_then(|views| views.of(step));
        if on_step(step + 1, view).is_break() {
            return Ok(None);
        }
    }
    Ok(Some(dreams))
}

/// What those who drive cars have seen in the last steps.
struct Views<'a> {
    probe: &'a Probe,
    /// The pictures of the last steps in which somebody looked, the oldest first.
    last: Vec<Vec<Frame>>,
}

impl<'a> Views<'a> {
    fn new(probe: &'a Probe) -> Self {
        Self { probe, last: Vec::new() }
    }

    /// The pictures of this step, where it was one in which they looked.
    fn of(&self, step: usize) -> Option<&[Frame]> {
        self.last.last().filter(|_| step.is_multiple_of(CarPlayer::VIEW_STEPS)).map(Vec::as_slice)
    }

    /// What each sees in this step, where it is one in which they look.
    fn look(&mut self, step: usize, model: &WorldModel, state: &State) -> Option<Vec<Sight>> {
        if !step.is_multiple_of(CarPlayer::VIEW_STEPS) {
            return None;
        }
        let n_between = self.probe.gap() / CarPlayer::VIEW_STEPS;
        self.last.push(model.decode(&state.z));
        if self.last.len() > n_between + 1 {
            self.last.remove(0);
        }
        // Before there is a view of that long ago, the present one stands in for it: nothing moves.
        let now = self.last.last()?;
        let earlier = if self.last.len() > n_between { &self.last[0] } else { now };
        Some(self.probe.sights(earlier, now))
    }
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
    use crate::dream::Rows;
    use crate::simulate::perception::made_up::arm;

    /// Of a moment at 0 and one at 1, in each of which the arm was held.
    fn knowledge() -> Knowledge {
        let latents = Rows { width: 1, values: (0..40).map(|i| (i % 2) as f32).collect() };
        let held = |reach: f32| vec![Action::new([reach]); 10];
        let snippets =
            Snippets::new(latents, (0..40).map(|i| held(100.0 + 100.0 * (i % 2) as f32)).collect());
        Knowledge::World { spec: Arc::new(arm()), snippets: Some(Arc::new(snippets)) }
    }

    fn played(knowledge: &Knowledge, manner: Manner, seed: u64) -> Vec<f32> {
        let mut player = DreamPlayer::new(knowledge, manner, seed);
        (0..4000).map(|t| player.act(&[if t < 2000 { 0.1 } else { 0.9 }])[0]).collect()
    }

    #[test]
    fn what_was_done_where_it_looked_alike_is_done_and_now_and_then_something_else() {
        let all = played(&knowledge(), Manner::Exploring, 3);
        let share = |reach: f32, all: &[f32]| {
            all.iter().filter(|done| **done == reach).count() as f64 / all.len() as f64
        };
        assert!((0.35..0.75).contains(&share(100.0, &all[..2000])), "{}", share(100.0, &all[..2000]));
        assert!((0.35..0.75).contains(&share(200.0, &all[2020..])), "{}", share(200.0, &all[2020..]));
        assert_eq!(share(200.0, &all[..2000]), 0.0);
        assert!(
            all.iter().any(|done| *done < 50.0) && all.iter().any(|done| *done > 450.0),
            "of all that can be done"
        );
        let calm = played(&knowledge(), Manner::Touring, 3);
        assert!(share(100.0, &calm[..2000]) > share(100.0, &all[..2000]) + 0.1);
        assert_eq!(all, played(&knowledge(), Manner::Exploring, 3));
        assert_ne!(all, played(&knowledge(), Manner::Exploring, 4));
    }

    #[test]
    fn without_recordings_all_is_tried() {
        let knowledge = Knowledge::World { spec: Arc::new(arm()), snippets: None };
        let all = played(&knowledge, Manner::Touring, 3);
        let spread = |from: f32, to: f32| all.iter().filter(|done| (from..=to).contains(*done)).count();
        assert!(
            [0.0, 128.0, 256.0, 384.0].iter().all(|from| spread(*from, from + 128.0) > 150),
            "everywhere"
        );
    }
}
