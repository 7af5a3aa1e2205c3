//! What the tests of all workers share: a tiny model, dreams of it, and a world that is a gray wall.

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use crate::dream::{Dream, DreamEpisode};
use crate::env::{Action, End, Env, Events, Frame, Outcome, Seed, Truth};
use crate::query::{DreamId, Query, QueryId, SegmentRef};
use crate::world_model::{LatentState, WorldModel, WorldModelConfig, untrained};

/// The same untrained model always.
pub(super) fn model() -> WorldModel {
    untrained(&WorldModelConfig::tiny(), &mut ChaCha8Rng::seed_from_u64(0))
}

/// One whose parameters are finite, and whose imagination is not for long.
pub(super) fn exploding() -> WorldModel {
    let head = model().parameters().tensor("mdn_rnn.head.weight").unwrap() * 1e38;
    let parameters = model().parameters().with([("mdn_rnn.head.weight".to_owned(), head)]);
    WorldModel::load(parameters).unwrap()
}

/// Where its dreams begin.
pub(super) fn start() -> LatentState {
    LatentState { z: vec![0.1; 4], c: vec![0.0; 16], h: vec![0.0; 16] }
}

/// A dream of `n` steps.
pub(super) fn dream(seed: u64, n: usize) -> DreamEpisode {
    let (model, rng) = (model(), &mut ChaCha8Rng::seed_from_u64(seed));
    let mut dream = Dream::new(&start(), seed);
    (0..n).for_each(|t| dream.step(&model, Action::new((t as f32).sin(), 0.5, 0.0), rng).unwrap());
    dream.finish()
}

/// A query about the segments that start at (dream, step).
pub(super) fn query(id: u32, left: (u32, usize), right: (u32, usize)) -> Query {
    let segment = |(dream, start)| SegmentRef { dream: DreamId(dream), start };
    Query { id: QueryId(id), left: segment(left), right: segment(right) }
}

/// A wall that grows brighter step by step, for `len` steps.
#[derive(Debug)]
pub(super) struct Wall {
    pub(super) len: usize,
    pub(super) t: usize,
}

impl Wall {
    /// Ready for its first action.
    pub(super) fn new(len: usize) -> Self {
        Self { len, t: 0 }
    }
}

impl Env for Wall {
    fn reset(&mut self, _: Seed) {
        self.t = 0;
    }

    fn advance(&mut self, _: Action) -> Outcome {
        self.t += 1;
        let events = Events { new_tile: true, ..Events::default() };
        Outcome { reward: 10.0, events, end: (self.t >= self.len).then_some(End::TimeLimit) }
    }

    fn frame(&self) -> Frame {
        Frame::new(20, vec![self.t.min(255) as u8; 3 * 20 * 20])
    }

    fn truth(&self) -> Truth {
        Truth::default()
    }

    fn picture(&self, width: u32, height: u32) -> Vec<u8> {
        vec![0; (width * height * 3) as usize]
    }
}
