//! Driving inside the world model, where nothing real can break (Step 2 of the method).
//!
//! A dream holds no randomness of its own: its noise comes from the generator that its caller gives it.

pub mod screen;
pub mod signs;

use std::ops::Range;

use rand::Rng;

use crate::query::SEGMENT_LEN;
use crate::tensor::{NotFinite, from_slice, to_vec};
use crate::world::{Action, Frame};
use crate::world_model::{LatentState, ModelIdentity, Next, Noise, State, WorldModel, actions_tensor};

pub use screen::Screen;

/// τ in dreams: the mixture as it is (paper, Table 4).
pub const TEMPERATURE: f64 = 1.0;

/// Rows of equal width.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rows {
    /// How many numbers a row has.
    pub width: usize,
    /// Row after row.
    pub values: Vec<f32>,
}

impl Rows {
    /// How many rows there are.
    pub fn len(&self) -> usize {
        self.values.len().checked_div(self.width).unwrap_or(0)
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The row at `i`.
    pub fn row(&self, i: usize) -> &[f32] {
        &self.values[i * self.width..(i + 1) * self.width]
    }

    /// Appends a row.
    ///
    /// # Panics
    /// Where it is of another width.
    pub fn push(&mut self, row: &[f32]) {
        assert_eq!(row.len(), self.width, "a row has the width of the others");
        self.values.extend_from_slice(row);
    }
}

/// That the states of a dream are not as wide as those of a world model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "its states have {} latents and {} memory cells, and those of the world model {} and {}",
    .found[0], .found[1], .wanted[0], .wanted[1]
)]
pub struct OtherStates {
    /// The latents and memory cells of the dream's states.
    pub found: [usize; 2],
    /// Those of the world model's.
    pub wanted: [usize; 2],
}

/// A dream as it was driven, from which everything else follows.
///
/// Step t is in state (zₜ, memoryₜ) and takes action t. The memory is a function of the start, the latents and the
/// actions, so it is not kept but remembered anew by [`DreamEpisode::features`].
#[derive(Clone, Debug, PartialEq)]
pub struct DreamEpisode {
    /// The first state.
    pub start: LatentState,
    /// The latents of every step, `[T, Z]`. The first row is the start's.
    pub zs: Rows,
    /// The action of every step, as driven.
    pub actions: Vec<Action>,
    /// Steps that the driver marked as unsafe.
    pub unsafe_marks: Vec<usize>,
    /// The seed of its noise.
    pub seed: u64,
    /// The steps that the planner drove, in order and apart. The others were driven by hand.
    pub planned: Vec<Range<usize>>,
}

impl DreamEpisode {
    /// An episode of no steps yet.
    pub fn new(start: LatentState, seed: u64) -> Self {
        let zs = Rows { width: start.z.len(), values: Vec::new() };
        Self { start, zs, actions: Vec::new(), unsafe_marks: Vec::new(), seed, planned: Vec::new() }
    }

    /// How many steps it has.
    pub fn len(&self) -> usize {
        self.actions.len()
    }

    /// Whether it has none.
    pub fn is_empty(&self) -> bool {
        self.actions.is_empty()
    }

    /// Whether it is long enough to show a segment of.
    pub fn is_usable(&self) -> bool {
        self.len() >= SEGMENT_LEN
    }

    /// Whether the planner drove step `t`.
    pub fn is_planned(&self, t: usize) -> bool {
        self.planned.iter().any(|range| range.contains(&t))
    }

    /// How many steps the planner drove.
    pub fn n_planned(&self) -> usize {
        self.planned.iter().map(Range::len).sum()
    }

    /// Notes that the planner drove the last step.
    pub fn note_planned(&mut self) {
        let n = self.len();
        match self.planned.last_mut() {
            Some(last) if last.end + 1 == n => last.end = n,
            _ if n > 0 => self.planned.push(n - 1..n),
            _ => {}
        }
    }

    /// Fails where this was dreamed by networks of other shapes than those of `model`.
    pub fn require(&self, model: &ModelIdentity) -> Result<(), OtherStates> {
        let found = [self.start.z.len(), self.zs.width, self.start.c.len(), self.start.h.len()];
        let (z, m) = (model.config().mdn_rnn.latent as usize, model.config().mdn_rnn.memory as usize);
        if found == [z, z, m, m] {
            return Ok(());
        }
        let [n_latents, _, n_memory, _] = found;
        Err(OtherStates { found: [n_latents, n_memory], wanted: [z, m] })
    }

    /// The features `[z | c | h]` of every step, remembered anew.
    pub fn features(&self, model: &WorldModel) -> Rows {
        let mut state = State::from(&self.start);
        let mut rows = Rows { width: model.config().n_features() as usize, values: Vec::new() };
        for (t, action) in self.actions.iter().enumerate() {
            let z = self.zs.row(t);
            state.z = from_slice(z, &[1, z.len() as i64]);
            rows.push(&to_vec(&state.features()));
            state.memory = model.remember(&state, &actions_tensor(&[*action]));
        }
        rows
    }

    /// The pictures of the steps in `range`.
    ///
    /// # Panics
    /// Where the range reaches beyond the episode.
    pub fn frames(&self, model: &WorldModel, range: Range<usize>) -> Vec<Frame> {
        let width = self.zs.width;
        let zs = &self.zs.values[range.start * width..range.end * width];
        model.decode(&from_slice(zs, &[range.len() as i64, width as i64]))
    }
}

/// A dream that is being driven.
#[derive(Debug)]
pub struct Dream {
    state: State,
    episode: DreamEpisode,
}

impl Dream {
    /// A dream from `start`. `seed` is kept in the episode as the name of the caller's generator.
    pub fn new(start: &LatentState, seed: u64) -> Self {
        Self { state: start.into(), episode: DreamEpisode::new(start.clone(), seed) }
    }

    /// Takes `action` and moves on by one step, with noise from `rng`.
    ///
    /// Where that leads to what is no number the dream stays where it is, with all that was dreamed before.
    pub fn step(&mut self, model: &WorldModel, action: Action, rng: &mut impl Rng) -> Result<(), NotFinite> {
        let noise = Noise::draw(1, model.config().mdn_rnn.latent, rng);
        let next = Next::Sample { temperature: TEMPERATURE, noise: &noise };
        let next = model.imagine(&self.state, &actions_tensor(&[action]), next);
        next.require_finite(&format!("step {} of the dream", self.episode.len() + 1))?;
        self.episode.zs.push(&to_vec(&self.state.z));
        self.episode.actions.push(action);
        self.state = next;
        Ok(())
    }

    /// The same, with an action that the planner chose.
    pub fn step_planned(
        &mut self,
        model: &WorldModel,
        action: Action,
        rng: &mut impl Rng,
    ) -> Result<(), NotFinite> {
        self.step(model, action, rng)?;
        self.episode.note_planned();
        Ok(())
    }

    /// Marks the present step as unsafe.
    pub fn mark_unsafe(&mut self) {
        self.episode.unsafe_marks.push(self.episode.len());
    }

    /// The present state.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// What is seen now.
    pub fn frame(&self, model: &WorldModel) -> Option<Frame> {
        model.decode(&self.state.z).pop()
    }

    /// What was driven so far.
    pub fn episode(&self) -> &DreamEpisode {
        &self.episode
    }

    /// Ends the dream.
    pub fn finish(self) -> DreamEpisode {
        self.episode
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::world_model::{WorldModelConfig, untrained};

    #[test]
    fn remembering_a_dream_gives_the_states_it_was_driven_in() {
        let rng = &mut ChaCha8Rng::seed_from_u64(3);
        let model = untrained(&WorldModelConfig::tiny(), rng);
        let start = LatentState { z: vec![0.1; 4], c: vec![0.2; 16], h: vec![0.3; 16] };
        let mut dream = Dream::new(&start, 3);
        let mut live = Vec::new();
        for t in 0..30 {
            live.extend(to_vec(&dream.state().features()));
            dream.step(&model, Action::new([(t as f32).sin(), 0.5, 0.0]), rng).unwrap();
        }
        let anew = dream.finish().features(&model);
        let apart = live.iter().zip(&anew.values).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert_eq!(anew.len(), 30);
        assert!(apart < 1e-5, "{apart}");
    }

    /// A model whose memory explodes: finite parameters, and a state that is not after a few steps.
    fn exploding() -> WorldModel {
        let model = untrained(&WorldModelConfig::tiny(), &mut ChaCha8Rng::seed_from_u64(1));
        // Means that are 1e30 of the outputs each, with which the next step's gates are all or nothing.
        let head = model.parameters().tensor("mdn_rnn.head.weight").unwrap() * 1e38;
        let parameters = model.parameters().with([("mdn_rnn.head.weight".to_owned(), head)]);
        WorldModel::load(parameters).unwrap()
    }

    #[test]
    fn a_dream_ends_where_numbers_end_and_keeps_what_was_before() {
        let (model, rng) = (exploding(), &mut ChaCha8Rng::seed_from_u64(0));
        let start = LatentState { z: vec![0.1; 4], c: vec![0.2; 16], h: vec![0.3; 16] };
        let mut dream = Dream::new(&start, 0);
        let met = (0..50).find_map(|_| dream.step(&model, Action::new([0.3, 1.0, 0.0]), rng).err()).unwrap();
        let n = dream.episode().len();
        assert!(met.to_string().contains(&format!("step {} of the dream", n + 1)), "{met} after {n} steps");
        assert!(dream.finish().zs.values.iter().all(|z| z.is_finite()), "what is kept is whole");
    }

    #[test]
    fn a_dream_of_other_networks_is_named() {
        let model = untrained(&WorldModelConfig::tiny(), &mut ChaCha8Rng::seed_from_u64(1));
        let dream =
            |z, m| DreamEpisode::new(LatentState { z: vec![0.0; z], c: vec![0.0; m], h: vec![0.0; m] }, 0);
        assert_eq!(dream(4, 16).require(model.identity()), Ok(()));
        let refused = dream(2, 16).require(model.identity()).unwrap_err().to_string();
        assert!(refused.contains("2 latents and 16 memory cells"), "{refused}");
        assert!(dream(4, 10).require(model.identity()).is_err());
    }

    #[test]
    fn who_drove_each_step_is_kept() {
        let model = untrained(&WorldModelConfig::tiny(), &mut ChaCha8Rng::seed_from_u64(1));
        let start = LatentState { z: vec![0.0; 4], c: vec![0.0; 16], h: vec![0.0; 16] };
        let (mut dream, rng) = (Dream::new(&start, 0), &mut ChaCha8Rng::seed_from_u64(0));
        for t in 0..9 {
            if [2, 3, 4, 8].contains(&t) {
                dream.step_planned(&model, Action::new([0.0; 3]), rng).unwrap();
            } else {
                dream.step(&model, Action::new([0.0; 3]), rng).unwrap();
            }
        }
        let episode = dream.finish();
        assert_eq!((&episode.planned[..], episode.n_planned()), (&[2..5, 8..9][..], 4));
        assert!(episode.is_planned(4) && !episode.is_planned(5), "ranges end before their end");
    }

    #[test]
    fn the_same_noise_dreams_the_same_dream() {
        let model = untrained(&WorldModelConfig::tiny(), &mut ChaCha8Rng::seed_from_u64(1));
        let start = LatentState { z: vec![0.0; 4], c: vec![0.0; 16], h: vec![0.0; 16] };
        let drive = |seed| {
            let rng = &mut ChaCha8Rng::seed_from_u64(seed);
            let mut dream = Dream::new(&start, 0);
            (0..10).for_each(|_| dream.step(&model, Action::new([0.0; 3]), rng).unwrap());
            dream.finish().zs
        };
        assert_eq!(drive(5), drive(5));
        assert_ne!(drive(5), drive(6));
    }
}
