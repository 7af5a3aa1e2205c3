//! Files as the program writes them.

use std::path::Path;

use dropj::dataset::{Dataset, EpisodeInfo, Layout, StepRecord};
use dropj::dream::{Dream, DreamEpisode};
use dropj::evaluation::{EpisodeMetrics, EventFigure};
use dropj::query::{Preference, Protocol, Response, SafetyAnswer, SkipReason, sample_queries};
use dropj::reward::{RewardConfig, RewardEnsemble, SparseConfig, SparseReward};
use dropj::session::{Answer, Choice, DreamSource, Event, Fit, Header, SessionStore};
use dropj::world::{Action, Count, End, World as _};
use dropj::world_model::{LatentState, WorldModel, WorldModelConfig, untrained};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use crate::support::DummyRoad;

fn rng() -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(1)
}

pub(crate) fn start() -> LatentState {
    LatentState { z: vec![0.1; 4], c: vec![0.0; 16], h: vec![0.0; 16] }
}

pub(crate) fn model() -> WorldModel {
    untrained(&WorldModelConfig::tiny(), &mut rng())
}

/// A world model with starts, and one without.
pub(crate) fn worlds() -> Vec<Vec<u8>> {
    let model = model();
    let with_starts = model.parameters_with_starts(&[start(), start()], &[3, 9]);
    vec![with_starts.bytes().to_vec(), model.parameters().bytes().to_vec()]
}

/// A reward of preferences and one of verdicts.
pub(crate) fn rewards() -> Vec<Vec<u8>> {
    let hash = model().hash();
    let of_pairs = RewardEnsemble::new((36, hash.as_str()), RewardConfig::tiny(), &mut rng()).parameters();
    let of_verdicts = SparseReward::new((36, hash.as_str()), SparseConfig::tiny(), &mut rng()).parameters();
    vec![of_pairs.bytes().to_vec(), of_verdicts.bytes().to_vec()]
}

/// The shipped one: it is small.
pub(crate) fn probes() -> Vec<Vec<u8>> {
    let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets");
    vec![std::fs::read(assets.join("probe-obstacle-car-racing.safetensors")).unwrap()]
}

fn dream(len: usize, seed: u64) -> DreamEpisode {
    let mut dream = Dream::new(&start(), seed);
    let (model, rng) = (model(), &mut rng());
    for t in 0..len {
        dream.step(&model, Action::new([(t as f32).sin(), 0.5, 0.0]), rng).unwrap();
    }
    let mut episode = dream.finish();
    (episode.unsafe_marks, episode.planned) = (vec![2, 9], vec![3..7, 12..15]);
    episode
}

pub(crate) fn dreams() -> Vec<Vec<u8>> {
    [20, 33].map(|len| dropj::session::arrays::dream_to_bytes(&dream(len, 7))).into()
}

/// The files of a session in which everything happened that can.
pub(crate) fn session(dir: &Path) {
    let model = model();
    let header = Header::new("dummy-road", Protocol::Dropj, 7, &model.hash(), 1_795_342_500_000);
    let mut store = SessionStore::create(dir, header).unwrap();
    store.save_dream(&dream(40, 1), DreamSource::User).unwrap();
    store.save_dream(&dream(25, 2), DreamSource::Simulated).unwrap();
    let session = store.session();
    let queries = sample_queries(&session.dream_lens(), 6, session.next_query_id(), &mut rng());
    let responses = [
        Response::Safety(SafetyAnswer::OnlyLeft),
        Response::Safety(SafetyAnswer::Both(Preference::Right)),
        Response::Skipped(None),
        Response::Safety(SafetyAnswer::Neither),
        Response::Skipped(Some(SkipReason::Hallucinated)),
    ];
    for (query, response) in queries.iter().zip(responses) {
        let (id, left, right) = (query.id, query.left, query.right);
        store.record(Event::Asked { query: id, left, right, choice: Choice::Uniform }).unwrap();
        store.record(Event::Answered(Answer::new(id, response, 4.5, "anna, the \"first\""))).unwrap();
    }
    let (first, skipped) = (queries[0].id, queries[2].id);
    store.record(Event::SkipExplained { query: skipped, reason: SkipReason::Ambiguous }).unwrap();
    for event in [
        Event::Retracted { query: first },
        Event::Restored { query: first },
        Event::Flagged { query: first },
        Event::Unflagged { query: first },
        Event::ScreenChanged { held_back: 10 },
        Event::ProtocolChanged { protocol: Protocol::Drope },
    ] {
        store.record(event).unwrap();
    }
    let fit = Fit { after: 9, n_labels: 2, seed: 5, epochs: 3, losses: vec![0.1, 0.2], held_out: Some(0.5) };
    let reward =
        RewardEnsemble::new((36, model.hash().as_str()), RewardConfig::tiny(), &mut rng()).parameters();
    store.save_reward(&reward, fit).unwrap();
}

/// A dataset of a sealed episode, and one that is left in its journal: their files.
pub(crate) fn episodes(dir: &Path) -> [Vec<u8>; 2] {
    let mut dataset = Dataset::create_or_open(dir, "dummy-road").unwrap();
    let mut journal = Vec::new();
    for is_sealed in [true, false] {
        let info = EpisodeInfo { env: "dummy-road".to_owned(), pilot: "anna".to_owned(), seed: 3 };
        let mut road = DummyRoad::world();
        let mut frame = road.reset(3).unwrap();
        let layout = Layout::of(road.spec(), &road.sensors());
        let mut recording = dataset.begin_with(info, &layout).unwrap();
        for t in 0..24 {
            let state = road.state();
            let action = Action::new([(t as f32 * 0.3).sin(), 0.2, 0.0]);
            let step = road.step(&action).unwrap();
            let (reward, wall_time_ns) = (step.reward.unwrap_or_default(), 1_795_342_500 + t);
            let events = step.events.iter().map(|event| event.goes_on).collect();
            let frame = std::mem::replace(&mut frame, step.frame);
            recording
                .push_by(&StepRecord { frame, action, reward, events, wall_time_ns, state }, t > 15)
                .unwrap();
        }
        if is_sealed {
            dataset.seal(recording, &frame, Some(End::Truncated)).unwrap();
        } else {
            journal = std::fs::read(recording.path()).unwrap();
        }
    }
    let sealed = std::fs::read(dir.join("data/chunk-000/file-000.parquet")).unwrap();
    [sealed, journal]
}

/// What `deploy --json` prints.
pub(crate) fn comparisons() -> Vec<Vec<u8>> {
    let line = |track: u64| {
        let metrics = EpisodeMetrics {
            ret: 900.5 + track as f32,
            unsafe_rate: 0.02,
            events: [
                ("new tile", Some(0.15)),
                ("grass", Some(0.02)),
                ("chuckhole", Some(0.5)),
                ("car", None),
            ]
            .map(|(name, value)| EventFigure { name: name.to_owned(), count: Count::PerStep, value })
            .into(),
            n_steps: 1000,
            finished: true,
            plan_ms_mean: Some(5.5),
            plan_ms_max: Some(9.0),
        };
        format!("{}\n", serde_json::json!({"track": track, "metrics": metrics}))
    };
    vec![(0..4).map(line).collect::<String>().into_bytes()]
}
