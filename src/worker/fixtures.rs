//! What the tests of all workers share: a tiny model, dreams of it, and a world that is a gray wall.

use std::io::Write as _;
use std::path::Path;
use std::sync::Arc;

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use tempfile::TempPath;

use crate::dream::{Dream, DreamEpisode};
use crate::planner::PlannerConfig;
use crate::planner::synthesis::SynthesisConfig;
use crate::query::{DreamId, Query, QueryId, SegmentRef};
use crate::reward::RewardConfig;
use crate::tensor::Backend;
use crate::worker::{LoadWorldModel, LoadedWorld, OpenWorld, WorkerConfig};
use crate::world::End;
use crate::world::cars::{CarAction, CarWorld, Env, Events, Outcome, Seed, Truth};
use crate::world::{Action, Frame, World as _};
use crate::world_model::fit::FitConfig;
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
    (0..n).for_each(|t| dream.step(&model, Action::new([(t as f32).sin(), 0.5, 0.0]), rng).unwrap());
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

    fn advance(&mut self, _: CarAction) -> Outcome {
        self.t += 1;
        let events = Events { new_tile: true, ..Events::default() };
        Outcome { reward: 10.0, events, end: (self.t >= self.len).then_some(End::Truncated) }
    }

    fn frame(&self) -> Frame {
        Frame::square(20, vec![self.t.min(255) as u8; 3 * 20 * 20])
    }

    fn truth(&self) -> Truth {
        Truth::default()
    }

    fn picture(&self, width: u32, height: u32) -> Vec<u8> {
        vec![0; (width * height * 3) as usize]
    }
}

/// Opens a wall of so many steps.
pub(super) fn wall(len: usize) -> OpenWorld {
    Arc::new(move |_| Ok(Box::new(CarWorld::of("wall", Wall::new(len)))))
}

/// Puts a file at `path`, in the place of another if there is one.
pub(super) fn put(path: &Path, text: &str) {
    let mut file = tempfile::NamedTempFile::new_in(path.parent().unwrap()).unwrap();
    file.write_all(text.as_bytes()).unwrap();
    file.persist(path).unwrap();
}

/// Removes a file.
pub(super) fn remove(path: &Path) {
    TempPath::try_from_path(path).unwrap().close().unwrap();
}

/// Gives a file another name.
pub(super) fn rename(path: &Path, name: &Path) {
    TempPath::try_from_path(path).unwrap().persist(name).unwrap();
}

/// Makes a folder called `name` in `dir`.
pub(super) fn make_folder(dir: &Path, name: &str) {
    drop(tempfile::Builder::new().prefix(name).rand_bytes(0).tempdir_in(dir).unwrap().keep());
}

/// Reads the world model `good`, and no other.
pub(super) fn load() -> LoadWorldModel {
    Arc::new(|path: &Path| {
        if path != Path::new("good") {
            return Err(Arc::new(std::io::Error::other("a bad file")));
        }
        Ok(LoadedWorld {
            name: "good".to_owned(),
            path: Some(path.to_owned()),
            parameters: model().parameters().clone(),
            card: Vec::new(),
            starts: Vec::new(),
            compact: None,
        })
    })
}

/// Workers for a wall of so many steps.
pub(super) fn config(len: usize) -> WorkerConfig {
    WorkerConfig {
        open: wall(len),
        spec: Arc::clone(CarWorld::of("wall", Wall::new(1)).spec()),
        world: WorldModelConfig::tiny(),
        fit: FitConfig::tiny(),
        reward: RewardConfig::tiny(),
        planner: PlannerConfig::car_racing(),
        synthesis: SynthesisConfig::paper(),
        load: load(),
        backend: Backend::cpu(),
    }
}
