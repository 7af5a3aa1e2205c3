//! Files of networks and arrays: crafted, damaged, of another width, not of numbers, or of an earlier layout.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use dropj::dataset::{Dataset, EpisodeInfo, StepRecord};
use dropj::dream::{Dream, DreamEpisode};
use dropj::query::{Protocol, QueryId, Response, SafetyAnswer, SegmentRef};
use dropj::reward::{
    LearnedReward, RewardConfig, RewardEnsemble, RewardModel as _, SparseConfig, SparseReward,
};
use dropj::run::Run;
use dropj::session::arrays::{dream_from_bytes, dream_to_bytes};
use dropj::session::{Answer, Choice, DreamSource, Event, Fit, Header, LoadedSession, SessionStore, replay};
use dropj::simulate::probe::Probe;
use dropj::tensor::container::{self, Container, Part};
use dropj::tensor::{Dtype, Parameters, from_slice, sha256, to_vec};
use dropj::world::{Action, Frame};
use dropj::world_model::fit::{FitConfig, FitError, fit_world};
use dropj::world_model::{
    LatentState, Layer, MdnRnnConfig, VaeConfig, WorldModel, WorldModelConfig, untrained,
};
use proptest::prelude::*;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use tch::Tensor;

use crate::program::{Ran, dropj, shipped};

fn rng() -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(0)
}

/// Networks that see what Car Racing shows, and are as small as can be.
fn small() -> WorldModelConfig {
    let layer = |channels, kernel| Layer { channels, kernel, stride: 4, padding: 0 };
    let vae = VaeConfig {
        height: 84,
        width: 84,
        rarity: 0.0,
        latent: 4,
        encoder: vec![layer(4, 4), layer(4, 5)],
        decoder: vec![layer(4, 5), layer(3, 4)],
        free_bits: 0.1,
        emphasis: 0.0,
    };
    let mdn_rnn = MdnRnnConfig { latent: 4, memory: 8, components: 2, actions: 3 };
    WorldModelConfig { env: "car-racing".to_owned(), vae, mdn_rnn, world: None }
}

fn start() -> LatentState {
    LatentState { z: vec![0.1; 4], c: vec![0.2; 8], h: vec![0.3; 8] }
}

/// The parameters of a small world model with a start, and what is said of what was held out.
fn world() -> Parameters {
    untrained(&small(), &mut rng()).parameters_with_starts(&[start(), start()], &[1, 4])
}

/// The same with one tensor replaced.
fn with(parameters: &Parameters, name: &str, values: &[f32], shape: &[i64]) -> Parameters {
    parameters.with([(name.to_owned(), from_slice(values, shape))])
}

/// The same whose tensor `name` is `NaN` throughout.
fn not_numbers(parameters: &Parameters, name: &str) -> Parameters {
    let nan = parameters.tensor(name).unwrap() * f64::NAN;
    parameters.with([(name.to_owned(), nan)])
}

/// The same without some tensors.
fn without(parameters: &Parameters, is_left_out: impl Fn(&str) -> bool) -> Vec<u8> {
    rewritten(parameters, |part| (!is_left_out(&part.name)).then_some(part))
}

/// The file of `parameters` with each tensor changed.
fn rewritten(parameters: &Parameters, change: impl Fn(Part) -> Option<Part>) -> Vec<u8> {
    let file = Container::read(parameters.bytes()).unwrap();
    let part = |entry: &container::Entry| Part {
        name: entry.name.clone(),
        dtype: entry.dtype,
        shape: entry.shape.clone(),
        bytes: file.bytes(entry).to_vec(),
    };
    let parts: Vec<_> = file.entries.iter().map(part).filter_map(change).collect();
    container::write(file.metadata.as_deref(), &parts)
}

fn write(dir: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = dir.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

/// A try to drive no episode with this world model: it is loaded, and that is all.
fn load(dir: &Path, world: &Path) -> Ran {
    let world = world.to_str().unwrap();
    dropj(dir, ["deploy", "--random-reward", "0", "--world", world, "--episodes", "0"])
}

/// Why these bytes are no world model.
fn refusal(bytes: &[u8]) -> String {
    match Parameters::from_bytes(bytes).map(WorldModel::load) {
        Err(e) => e.to_string(),
        Ok(loaded) => loaded.unwrap_err().to_string(),
    }
}

#[test]
fn sizes_that_cannot_be_are_refused_before_anything_is_made() {
    let dir = tempfile::tempdir().unwrap();
    let cases: &[(&str, &[&str], Value)] = &[
        ("cells", &["mdn_rnn", "memory"], json!(-1)),
        ("cells", &["mdn_rnn", "memory"], json!(0)),
        ("cells", &["mdn_rnn", "memory"], json!(10_000_000)),
        ("cells", &["mdn_rnn", "memory"], json!(i64::MAX)),
        ("describe", &["mdn_rnn", "memory"], json!(1e30)),
        ("Gaussians", &["mdn_rnn", "components"], json!(-2)),
        ("latents", &["vae", "latent"], json!(-4)),
        ("latents", &["mdn_rnn", "latent"], json!(16)),
        ("kernel", &["vae", "side"], json!(1)),
        ("side", &["vae", "side"], json!(-84)),
        ("side", &["vae", "side"], json!(1_u64 << 40)),
        ("side", &["vae", "side"], json!(85)),
        ("stride", &["vae", "encoder", "0", "stride"], json!(0)),
        ("stride", &["vae", "decoder", "1", "stride"], json!(-3)),
        ("kernel", &["vae", "encoder", "1", "kernel"], json!(1_u64 << 50)),
        ("padding", &["vae", "encoder", "1", "padding"], json!(i64::MAX)),
        ("channels", &["vae", "encoder", "0", "channels"], json!(0)),
        ("channels", &["vae", "encoder", "0", "channels"], json!(i64::MAX)),
        ("colors", &["vae", "decoder", "1", "channels"], json!(4)),
        ("layers", &["vae", "encoder"], json!([])),
        (
            "layers",
            &["vae", "decoder"],
            json!(vec![json!({"channels": 3, "kernel": 1, "stride": 1, "padding": 0}); 900]),
        ),
        ("free bits", &["vae", "free_bits"], json!(-1.0)),
        ("emphasis", &["vae", "emphasis"], json!(1e300)),
        ("rare colors", &["vae", "rarity"], json!(-1.0)),
        ("height", &["vae", "height"], json!(84)),
        ("axes", &["mdn_rnn", "actions"], json!(1_000_000)),
        ("axes", &["mdn_rnn", "actions"], json!(4)),
        ("world's file", &["world"], json!("name = 3")),
        ("world's file", &["world"], json!("#".repeat(1 << 19))),
        ("environment", &["env"], json!("")),
        ("environment", &["env"], json!("x".repeat(5000))),
        ("new", &["vae", "new"], json!(1)),
        ("layout", &["layout"], json!(9)),
    ];
    for (i, (named, place, value)) in cases.iter().enumerate() {
        let mut config = serde_json::to_value(small()).unwrap();
        let (last, above) = place.split_last().unwrap();
        let mut at = &mut config;
        for key in above {
            at = match key.parse::<usize>() {
                Ok(i) => &mut at[i],
                Err(_) => &mut at[*key],
            };
        }
        at[*last] = value.clone();
        let one = [("x".to_owned(), Tensor::zeros([1], tch::kind::FLOAT_CPU))];
        let crafted = Parameters::from_tensors(one, &[("config", config.to_string())]);
        let said = refusal(crafted.bytes());
        assert!(said.contains(named), "{place:?} = {value}: {said}");
        // Each start of the program takes its time: every fifth goes that way too.
        if i % 5 == 0 {
            let ran = load(dir.path(), &write(dir.path(), "world.safetensors", crafted.bytes()));
            assert!(ran.refused().contains(&said), "{}", ran.err);
        }
    }
}

#[test]
fn what_a_header_promises_the_file_must_hold() {
    let dir = tempfile::tempdir().unwrap();
    let config = WorldModelConfig { mdn_rnn: MdnRnnConfig { memory: 16_000, ..small().mdn_rnn }, ..small() };
    let config = serde_json::to_string(&config).unwrap();
    let large = Parameters::from_tensors([], &[("config", config)]);
    let refused = load(dir.path(), &write(dir.path(), "a.safetensors", large.bytes()));
    assert!(refused.refused().contains("vae.conv1.weight"), "{refused:?}");
    let refused = load(
        dir.path(),
        &write(dir.path(), "b.safetensors", &without(&world(), |name| name == "mdn_rnn.head.bias")),
    );
    assert!(refused.refused().contains("mdn_rnn.head.bias"), "{refused:?}");
    let reshaped = with(&world(), "vae.fc_mu.weight", &[0.0; 400], &[100, 4]);
    let refused = load(dir.path(), &write(dir.path(), "c.safetensors", reshaped.bytes()));
    assert!(refused.refused().contains("vae.fc_mu.weight"), "{refused:?}");
}

#[test]
fn starts_and_held_out_episodes_must_fit_the_networks() {
    let dir = tempfile::tempdir().unwrap();
    let world = world();
    let cases = [
        ("starts.z", with(&world, "starts.z", &[0.1; 8], &[8])),
        ("starts.c", with(&world, "starts.c", &[0.1; 8], &[1, 8])),
        ("starts.z", with(&world, "starts.z", &[0.1; 4], &[2, 2])),
        ("starts.h", with(&world, "starts.h", &[0.1; 14], &[2, 7])),
        ("starts.z", not_numbers(&world, "starts.z")),
        ("starts.h", not_numbers(&world, "starts.h")),
        ("held_out", with(&world, "held_out", &[-1.0, 3.0], &[2])),
        ("held_out", with(&world, "held_out", &[1e30], &[1])),
        ("held_out", with(&world, "held_out", &[0.5], &[1])),
        ("held_out", with(&world, "held_out", &[f32::NAN], &[1])),
        ("held_out", with(&world, "held_out", &[1.0], &[1, 1])),
    ];
    for (i, (named, changed)) in cases.iter().enumerate() {
        let said = refusal(changed.bytes());
        assert!(said.contains(named), "{i}: {said}");
        if i % 4 == 0 {
            let path = write(dir.path(), &format!("{i}.safetensors"), changed.bytes());
            assert!(load(dir.path(), &path).refused().contains(&said), "{i}");
        }
    }
    let path = write(dir.path(), "part.safetensors", &without(&world, |name| name == "starts.c"));
    assert!(load(dir.path(), &path).refused().contains("starts.c"));
    let path = write(dir.path(), "none.safetensors", &without(&world, |name| name.starts_with("starts.")));
    load(dir.path(), &path).succeeded();
}

#[test]
fn networks_that_are_not_made_of_numbers_are_refused_by_whoever_reads_them() {
    let dir = tempfile::tempdir().unwrap();
    for name in ["mdn_rnn.lstm.weight_hh", "vae.conv1.weight", "vae.deconv2.bias"] {
        let path = write(dir.path(), "world.safetensors", not_numbers(&world(), name).bytes());
        assert!(load(dir.path(), &path).refused().contains(name));
        let args = ["simulate", "--world", path.to_str().unwrap(), "--out", "simulated"];
        assert!(dropj(dir.path(), args).refused().contains(name));
    }
}

#[test]
fn numbers_of_any_width_are_read() {
    let dir = tempfile::tempdir().unwrap();
    let world = world();
    let is_network = |name: &str| name.starts_with("vae.") || name.starts_with("mdn_rnn.");
    for dtype in [Dtype::F16, Dtype::BF16, Dtype::F64] {
        let narrow = world.narrowed(dtype, is_network).unwrap();
        load(dir.path(), &write(dir.path(), "narrow.safetensors", narrow.bytes())).succeeded();
        let model = WorldModel::load(narrow).unwrap();
        assert_eq!((model.starts().len(), model.held_out()), (2, Some(vec![1, 4])), "those stay as they are");
    }
    let whole = rewritten(&world, |part| {
        let bytes = if part.name == "vae.fc_mu.bias" { vec![0; 16] } else { return Some(part) };
        Some(Part { dtype: Dtype::I32, bytes, ..part })
    });
    let refused = load(dir.path(), &write(dir.path(), "whole.safetensors", &whole));
    assert!(refused.refused().contains("I32"), "{refused:?}");
}

#[test]
fn what_is_no_file_of_networks_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let whole = world();
    let twice = br#"{"a":{"dtype":"F32","shape":[0],"data_offsets":[0,0]},"a":{"dtype":"F32","shape":[0],"data_offsets":[0,0]}}"#;
    let cases: [(&str, Vec<u8>); 6] = [
        ("empty", vec![]),
        ("git lfs pull", b"version https://git-lfs.github.com/spec/v1\noid sha256:00\n".to_vec()),
        ("zip", [b"PK\x03\x04".to_vec(), vec![0; 200]].concat()),
        ("are there", whole.bytes()[..whole.bytes().len() / 2].to_vec()),
        ("at most", [u64::MAX.to_le_bytes().to_vec(), vec![b' '; 100]].concat()),
        ("twice", [(twice.len() as u64).to_le_bytes().to_vec(), twice.to_vec()].concat()),
    ];
    for (named, bytes) in cases {
        let ran = load(dir.path(), &write(dir.path(), "world.safetensors", &bytes));
        assert!(ran.refused().contains(named), "{}", ran.err);
    }
    // A converter has dropped the description.
    let bare = container::write(None, &[]);
    assert!(load(dir.path(), &write(dir.path(), "world.safetensors", &bare)).refused().contains("describe"));
}

/// A session of the small world with two dreams and three answers, and a copy of its world model.
fn session(dir: &Path) -> (WorldModel, SessionStore) {
    let model = WorldModel::load(world()).unwrap();
    let header = Header::new("car-racing", Protocol::Dropj, 7, &model.hash(), 0);
    let mut store = SessionStore::create(dir, header).unwrap();
    store.save_world_model(&model).unwrap();
    for seed in 0..2 {
        let (mut dream, rng) = (Dream::new(&start(), seed), &mut ChaCha8Rng::seed_from_u64(seed));
        for t in 0..40 {
            dream.step(&model, Action::new([(t as f32).sin(), 0.5, 0.0]), rng).unwrap();
        }
        store.save_dream(&dream.finish(), DreamSource::User).unwrap();
    }
    for i in 0..3 {
        let [left, right] = [0, 1].map(|d| SegmentRef { dream: dropj::query::DreamId(d), start: i as usize });
        store.record(Event::Asked { query: QueryId(i), left, right, choice: Choice::Uniform }).unwrap();
        let response = Response::Safety(SafetyAnswer::OnlyLeft);
        store.record(Event::Answered(Answer::new(QueryId(i), response, 1.0, "anna"))).unwrap();
    }
    (model, store)
}

/// Puts `bytes` in the place of the first dream, and lets the log say so.
fn replace_dream(dir: &Path, bytes: &[u8]) {
    let path = dir.join("dreams/0000.safetensors");
    let before = sha256(&std::fs::read(&path).unwrap());
    std::fs::write(&path, bytes).unwrap();
    let log = std::fs::read_to_string(dir.join("events.jsonl")).unwrap();
    std::fs::write(dir.join("events.jsonl"), log.replace(&before, &sha256(bytes))).unwrap();
}

#[test]
fn a_dream_that_does_not_fit_is_refused_by_whoever_reads_it() {
    let root = tempfile::tempdir().unwrap();
    let dir = root.path().join("session");
    let (model, store) = session(&dir);
    let whole = store.dream(dropj::query::DreamId(0)).unwrap();
    drop(store);
    let narrow = DreamEpisode {
        start: LatentState { z: vec![0.1; 2], ..start() },
        zs: dropj::dream::Rows { width: 2, values: whole.zs.values[..80].to_vec() },
        ..whole.clone()
    };
    let thin =
        DreamEpisode { start: LatentState { c: vec![0.2; 5], h: vec![0.3; 5], ..start() }, ..whole.clone() };
    let mut nan = whole.clone();
    nan.zs.values.fill(f32::NAN);
    let marked = DreamEpisode { unsafe_marks: vec![5, 1_000_000], ..whole.clone() };
    let (from, to) = (30, 3);
    let inverted = DreamEpisode { planned: vec![from..to, to..from], ..whole.clone() };
    let beyond = DreamEpisode { planned: vec![3..9, 1_000_000..10_000_000], ..whole.clone() };
    let cases = [
        ("2 latents", &narrow),
        ("5 memory cells", &thin),
        ("step 0 are not numbers", &nan),
        ("step 1000000", &marked),
        ("from 30 to 3", &inverted),
        ("from 1000000 to 10000000", &beyond),
    ];
    let name = dir.to_str().unwrap();
    for (said, dream) in cases {
        replace_dream(&dir, &dream_to_bytes(dream));
        assert!(replay(&dir, &model).unwrap_err().to_string().contains(said));
        let ran = dropj(root.path(), ["refit", "--session", name]);
        assert!(ran.refused().contains(said), "{}", ran.err);
        // The window reads what it can, and says what it cannot.
        let store = SessionStore::open(&dir, Some(model.identity())).unwrap();
        let opened = LoadedSession::read(store, &mut |_, _| ControlFlow::Continue(())).unwrap();
        let [first, second] = [0, 1].map(|i| opened.dreams[i].1.as_ref().map_err(ToString::to_string));
        assert!(second.is_ok() && first.unwrap_err().contains(said));
        // So it does where the world model is known only later.
        let store = SessionStore::open(&dir, None);
        drop(opened);
        let store = store.or_else(|_| SessionStore::open(&dir, None)).unwrap();
        let opened = LoadedSession::read(store, &mut |_, _| ControlFlow::Continue(()));
        let mut opened = opened.unwrap();
        opened.bind_model(model.identity()).unwrap();
        assert!(opened.dreams[0].1.as_ref().unwrap_err().to_string().contains(said));
    }
    replace_dream(&dir, &dream_to_bytes(&whole));
    dropj(root.path(), ["refit", "--session", name]).succeeded();
}

#[test]
fn rewards_must_be_of_numbers_and_fit_the_world_model() {
    let root = tempfile::tempdir().unwrap();
    let dir = root.path().join("session");
    let (model, mut store) = session(&dir);
    let hash = model.hash();
    let ensemble = |n, of: &str| RewardEnsemble::new((n, of), RewardConfig::tiny(), &mut rng()).parameters();
    let sparse = |n, of: &str| SparseReward::new((n, of), SparseConfig::tiny(), &mut rng()).parameters();
    let crafted = |key: &str, parameters: &Parameters, from: &str, to: &str| {
        let described = parameters.metadata(key).unwrap().replace(from, to);
        Parameters::from_tensors([], &[(key, described)])
    };
    let (good, good_sparse) = (ensemble(20, &hash), sparse(20, &hash));
    let cases = [
        ("sha256:00", ensemble(20, "sha256:00")),
        ("sha256:00", sparse(20, "sha256:00")),
        ("21 features", ensemble(21, &hash)),
        ("21 features", sparse(21, &hash)),
        ("reward.1.weight", not_numbers(&good, "reward.1.weight")),
        ("sparse_reward.0.bias", not_numbers(&good_sparse, "sparse_reward.0.bias")),
        ("networks", crafted("reward", &good, "\"members\":2", "\"members\":-2")),
        ("hidden layers", crafted("reward", &good, "\"layers\":2", "\"layers\":999999999")),
        ("reward.0.weight", crafted("reward", &good, "\"hidden\":16", "\"hidden\":16000")),
        ("features", crafted("reward", &good, "\"n_features\":20", "\"n_features\":-20")),
        ("width", crafted("sparse_reward", &good_sparse, "\"hidden\":16", "\"hidden\":0")),
        ("batch", crafted("sparse_reward", &good_sparse, "\"batch\":8", "\"batch\":0")),
    ];
    let name = dir.to_str().unwrap();
    for (i, (said, reward)) in cases.into_iter().enumerate() {
        let met = LearnedReward::load(&reward, &model).unwrap_err().to_string();
        assert!(met.contains(said), "{said}: {met}");
        if i % 3 > 0 {
            continue;
        }
        let fit = Fit { after: 0, n_labels: 1, seed: 0, epochs: 1, losses: vec![0.5; 2], held_out: None };
        store.save_reward(&reward, fit).unwrap();
        let ran = dropj(root.path(), ["deploy", "--session", name, "--episodes", "0"]);
        assert!(ran.refused().contains(said), "{said}: {}", ran.err);
    }
}

#[test]
fn a_probe_must_see_what_is_shown() {
    let dir = tempfile::tempdir().unwrap();
    let world = write(dir.path(), "world.safetensors", world().bytes());
    let own = Parameters::from_bytes(std::fs::read(shipped("assets/probe-car-racing.safetensors")).unwrap());
    let own = own.unwrap();
    let config = own.metadata("config").unwrap();
    let crafted = |from: &str, to: &str| {
        let changed = config.replacen(from, to, 1);
        assert_ne!(changed, config, "{from} is there");
        own.with([]).metadata("errors").unwrap();
        Parameters::from_tensors([], &[("config", changed)]).bytes().to_vec()
    };
    let other = std::fs::read(shipped("assets/probe-obstacle-car-racing.safetensors")).unwrap();
    let cases = [
        ("128 pixels", other),
        ("probe.out.bias", not_numbers(&own, "probe.out.bias").bytes().to_vec()),
        ("hidden units", crafted("\"hidden\":128", "\"hidden\":-1")),
        ("stride", crafted("\"stride\":2", "\"stride\":0")),
        ("side", crafted("\"side\":84", "\"side\":840000000")),
        ("probe.conv1.weight", crafted("\"hidden\":128", "\"hidden\":129")),
    ];
    for (said, probe) in cases {
        let probe = write(dir.path(), "probe.safetensors", &probe);
        let [world, probe] = [&world, &probe].map(|path| path.to_str().unwrap());
        let ran = dropj(dir.path(), ["simulate", "--world", world, "--probe", probe, "--out", "simulated"]);
        assert!(ran.refused().contains(said), "{said}: {}", ran.err);
    }
}

/// A world model whose parameters are finite, and whose imagination is not for long.
fn exploding() -> Parameters {
    let head = world().tensor("mdn_rnn.head.weight").unwrap() * 1e38;
    world().with([("mdn_rnn.head.weight".to_owned(), head)])
}

#[test]
fn nobody_drives_or_dreams_on_by_what_is_no_number() {
    let dir = tempfile::tempdir().unwrap();
    let path = write(dir.path(), "world.safetensors", exploding().bytes());
    let world = path.to_str().unwrap();
    let ran = dropj(dir.path(), ["deploy", "--random-reward", "0", "--world", world, "--episodes", "1"]);
    assert!(ran.refused().contains("NaN") && ran.err.contains("track 0"), "{ran:?}");
    let args =
        ["simulate", "--world", world, "--queries", "5", "--dreams", "2", "--steps", "60", "--out", "s"];
    let ran = dropj(dir.path(), args);
    assert!(ran.refused().contains("NaN") && ran.err.contains("step"), "{ran:?}");
}

/// A file that was made by the program before networks were stored as PyTorch has them.
fn earlier(name: &str) -> Parameters {
    let path = shipped("tests/cases/earlier").join(name);
    Parameters::from_bytes(std::fs::read(path).unwrap()).unwrap()
}

/// What the program that made those files printed for the two states and actions below.
const REWARDS_THEN: [f32; 2] = [0.054_014_55, 0.090_254_284];
const CHANCES_THEN: [f32; 12] = [
    0.440_502_9,
    0.232_267_44,
    0.327_229_62,
    0.411_933_1,
    0.254_472_82,
    0.333_594_1,
    0.352_780_73,
    0.346_004_96,
    0.301_214_28,
    0.368_778_68,
    0.333_832_26,
    0.297_389,
];

fn states_and_actions() -> (Tensor, Tensor) {
    let features: Vec<f32> = (0..16).map(|i| (i as f32).sin()).collect();
    (from_slice(&features, &[2, 8]), from_slice(&[0.5, -0.2, 0.1, -1.0, 0.3, 1.0], &[2, 3]))
}

fn assert_close(found: &[f32], wanted: &[f32], within: f32) {
    let apart = found.iter().zip(wanted).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(found.len() == wanted.len() && apart <= within, "{found:?} is not {wanted:?}");
}

#[test]
fn files_of_the_earlier_layout_are_read_and_mean_the_same() {
    let model = WorldModel::load(earlier("world-1.safetensors")).unwrap();
    assert_eq!((model.starts().len(), model.held_out()), (1, Some(vec![1, 4])));
    let (features, actions) = states_and_actions();
    let reward = earlier("reward-1.safetensors");
    let ensemble = RewardEnsemble::load(&reward).unwrap().in_kind(tch::Kind::Float);
    assert_close(&to_vec(&ensemble.rewards(&features, &actions)), &REWARDS_THEN, 1e-6);
    assert!(LearnedReward::load(&reward, &model).is_ok());
    let sparse = SparseReward::load(&earlier("sparse-reward-1.safetensors")).unwrap();
    assert_close(&to_vec(&sparse.chances(&features, &actions)), &CHANCES_THEN, 1e-6);
}

#[test]
fn what_is_converted_is_the_same_model_in_the_layout_of_pytorch() {
    let dir = tempfile::tempdir().unwrap();
    let convert = |name: &str| {
        let file = shipped("tests/cases/earlier").join(format!("{name}-1.safetensors"));
        let out = dir.path().join(format!("{name}.safetensors"));
        let args = [file.to_str().unwrap(), "--out", out.to_str().unwrap()];
        dropj(dir.path(), ["convert"].into_iter().chain(args)).succeeded();
        let refused = dropj(dir.path(), ["convert"].into_iter().chain(args));
        assert!(refused.refused().contains("already"), "nothing is written over: {refused:?}");
        Parameters::from_bytes(std::fs::read(&out).unwrap()).unwrap()
    };
    let (before, after) = (earlier("world-1.safetensors"), convert("world"));
    let model = WorldModel::load(after.clone()).unwrap();
    assert!(before.hash() != after.hash() && model.is(&before.hash()) && model.is(&after.hash()));
    assert_eq!(model.identity().relaid().unwrap().bytes(), before.bytes(), "byte by byte");

    let (features, actions) = states_and_actions();
    let reward = convert("reward");
    let shapes = ["reward.0.weight", "reward.0.bias", "reward.2.weight"]
        .map(|name| reward.tensor(name).unwrap().size());
    assert_eq!(shapes, [vec![2, 5, 11], vec![2, 5], vec![2, 1, 5]]);
    let ensemble = RewardEnsemble::load(&reward).unwrap().in_kind(tch::Kind::Float);
    assert_close(&to_vec(&ensemble.rewards(&features, &actions)), &REWARDS_THEN, 1e-6);
    assert!(LearnedReward::load(&reward, &model).is_ok(), "it names the model by its hash of then");
    let sparse = SparseReward::load(&convert("sparse-reward")).unwrap();
    assert_close(&to_vec(&sparse.chances(&features, &actions)), &CHANCES_THEN, 1e-6);
}

#[test]
fn the_shipped_models_are_those_that_earlier_sessions_name() {
    let earlier = [
        ("world-car-racing", "sha256:af5106263db29415d31108d59b96f1d4c61f3bcc64afd7aed1fc810c57c16ec7"),
        (
            "world-obstacle-car-racing-compact",
            "sha256:06aeb82791c9a99f0c5c135d40beed24ae60935b34bbd0fbdd43180cfdfbcec7",
        ),
    ];
    for (name, hash) in earlier {
        let bytes = std::fs::read(shipped(&format!("assets/{name}.safetensors"))).unwrap();
        let model = WorldModel::load(Parameters::from_bytes(bytes).unwrap()).unwrap();
        assert_eq!(model.identity().layout(), dropj::tensor::LAYOUT, "{name}");
        assert_ne!(model.hash(), hash);
        assert!(model.is(hash), "{name}");
        let then = model.identity().relaid().unwrap();
        assert_eq!(sha256(then.bytes()), hash, "these are the bytes of then");
        let z = from_slice(&model.starts()[0].z, &[1, -1]);
        assert_eq!(WorldModel::load(then).unwrap().decode(&z), model.decode(&z));
    }
}

#[test]
fn a_session_of_a_model_that_was_stored_anew_goes_on() {
    let root = tempfile::tempdir().unwrap();
    let dir = root.path().join("session");
    let model = WorldModel::load(earlier("world-1.safetensors")).unwrap();
    let header = Header::new("car-racing", Protocol::Dropj, 7, &model.hash(), 0);
    drop(SessionStore::create(&dir, header).unwrap());
    let anew = model.identity().relaid().unwrap();
    std::fs::write(dir.join("world_model.safetensors"), anew.bytes()).unwrap();
    let found = SessionStore::read_world_model(&dir).unwrap();
    assert_eq!(found.hash(), anew.hash());
    assert!(SessionStore::open(&dir, Some(found.identity())).is_ok());
    let other = WorldModel::load(world()).unwrap();
    assert!(SessionStore::open(&dir, Some(other.identity())).is_err(), "another is another");
}

#[test]
fn networks_are_stored_in_two_bytes_where_that_is_asked() {
    let dir = tempfile::tempdir().unwrap();
    let path = write(dir.path(), "world.safetensors", world().bytes());
    for (asked, dtype) in [("f16", Dtype::F16), ("bf16", Dtype::BF16)] {
        let out = dir.path().join(format!("{asked}.safetensors"));
        let [file, to] = [&path, &out].map(|path| path.to_str().unwrap());
        dropj(dir.path(), ["convert", file, "--out", to, "--dtype", asked]).succeeded();
        let bytes = std::fs::read(&out).unwrap();
        let stored = Container::read(&bytes).unwrap();
        let of = |name: &str| stored.entry(name).unwrap().dtype;
        assert_eq!([of("vae.conv1.weight"), of("mdn_rnn.head.bias")], [dtype; 2]);
        assert_eq!([of("starts.z"), of("held_out")], [Dtype::F32; 2]);
        load(dir.path(), &out).succeeded();
    }
    let head = world().tensor("mdn_rnn.head.weight").unwrap() * 1e9;
    let large = world().with([("mdn_rnn.head.weight".to_owned(), head)]);
    let large = write(dir.path(), "large.safetensors", large.bytes());
    let args = ["convert", large.to_str().unwrap(), "--out", "half.safetensors", "--dtype", "f16"];
    let refused = dropj(dir.path(), args);
    assert!(refused.refused().contains("mdn_rnn.head.weight"), "{refused:?}");
    assert!(!dir.path().join("half.safetensors").exists(), "nothing is left");
}

/// Three episodes of gray pictures.
fn recordings(dir: &Path) -> Dataset {
    let env = WorldModelConfig::tiny().env;
    let mut dataset = Dataset::create_or_open(dir, &env).unwrap();
    for seed in 0..3_u64 {
        let frame = |t: usize| Frame::square(20, vec![(5 * t) as u8; 1200]);
        let info = EpisodeInfo { env: env.clone(), pilot: "nobody".to_owned(), seed };
        let mut recording = dataset.begin(info).unwrap();
        for t in 0..40 {
            let action = Action::new([(t as f32).sin(), 0.0, 0.0]);
            let step = StepRecord {
                frame: frame(t),
                action,
                reward: 0.0,
                events: vec![false],
                wall_time_ns: 0,
                state: Vec::new(),
            };
            recording.push(&step).unwrap();
        }
        dataset.seal(recording, &frame(40), Some(dropj::world::End::Truncated)).unwrap();
    }
    drop(dataset);
    Dataset::open(dir).unwrap()
}

/// A fit of so many short epochs of each network in the folder `run`.
fn fit(
    dataset: &Dataset,
    run: &Path,
    resume: bool,
    n_epochs: usize,
    rate: f64,
) -> Result<Parameters, FitError> {
    tch::set_num_threads(1);
    let mut fit = FitConfig::tiny();
    for schedule in [&mut fit.vae, &mut fit.mdn_rnn] {
        (schedule.max_epochs, schedule.updates_per_epoch) = (n_epochs, 3);
    }
    fit.vae.learning_rate = rate;
    let run = Run::open(run, resume).unwrap();
    fit_world(dataset, &WorldModelConfig::tiny(), &fit, &run, &mut |_| ControlFlow::Continue(()))
}

#[test]
fn a_fit_ends_at_the_first_number_that_is_none() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = recordings(&dir.path().join("data"));
    let run = dir.path().join("run");
    let met = fit(&dataset, &run, false, 2, 1e30).unwrap_err().to_string();
    assert!(met.contains("vision at update 2 of epoch 1") && met.contains("NaN"), "{met}");
    let kept = std::fs::read_dir(&run).unwrap().filter_map(Result::ok).map(|item| item.file_name());
    assert!(
        kept.into_iter().all(|name| !name.to_string_lossy().ends_with("safetensors")),
        "nothing of it is kept"
    );
}

#[test]
fn checkpoints_of_the_earlier_layout_are_gone_on_from() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = recordings(&dir.path().join("data"));
    let run = dir.path().join("run");
    fit(&dataset, &run, false, 1, 1e-3).unwrap();
    let (whole, copy) = (fit(&dataset, &run, true, 1, 1e-3).unwrap(), dir.path().join("copy"));
    std::fs::rename(&run, &copy).unwrap();
    let mut n_marks = 0;
    for item in std::fs::read_dir(&copy).unwrap() {
        let path = item.unwrap().path();
        // As they were written before there was a mark; of the toy's networks nothing else was otherwise.
        let mark = br#"{\"layout\":2,"#;
        let none = format!("{{{}", " ".repeat(mark.len() - 1));
        let mut bytes = std::fs::read(&path).unwrap();
        while let Some(at) = bytes.windows(mark.len()).position(|bytes| bytes == mark) {
            bytes[at..at + mark.len()].copy_from_slice(none.as_bytes());
            n_marks += 1;
        }
        std::fs::write(&path, bytes).unwrap();
    }
    assert_eq!(n_marks, 4, "the last and the best of each network");
    assert_eq!(fit(&dataset, &copy, true, 1, 1e-3).unwrap().bytes(), whole.bytes());
    assert!(fit(&dataset, &copy, true, 2, 1e-3).is_ok(), "and trained on");
}

/// Bytes with some of them changed, most often in the header, where the sense is.
fn damaged() -> impl Strategy<Value = (Vec<(prop::sample::Index, u8, bool)>, Option<prop::sample::Index>)> {
    let change = (any::<prop::sample::Index>(), any::<u8>(), prop::bool::weighted(0.8));
    (prop::collection::vec(change, 1..6), prop::option::weighted(0.2, any::<prop::sample::Index>()))
}

type Damage = (Vec<(prop::sample::Index, u8, bool)>, Option<prop::sample::Index>);

fn damage(bytes: &[u8], (changes, cut): &Damage) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    let header = bytes.len().min(8 + u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize);
    for (at, byte, is_header) in changes {
        let n = if *is_header { header } else { bytes.len() };
        // A digit is worth more than any byte: it keeps the header readable.
        let at = at.index(n);
        bytes[at] = if bytes[at].is_ascii_digit() { b'0' + byte % 10 } else { *byte };
    }
    if let Some(cut) = cut {
        bytes.truncate(cut.index(bytes.len()));
    }
    bytes
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

    #[test]
    fn damaged_networks_are_loaded_or_refused(damaged in damaged()) {
        tch::set_num_threads(1);
        let model = WorldModel::load(earlier("world-1.safetensors")).unwrap();
        let read = |bytes: &[u8]| Parameters::from_bytes(damage(bytes, &damaged));
        if let Ok(model) = read(earlier("world-1.safetensors").bytes()).map(WorldModel::load)
            && let Ok(model) = model
        {
            prop_assert!(model.starts().iter().all(|start| model.decode(&from_slice(&start.z, &[1, -1])).len() == 1));
        }
        for name in ["reward-1.safetensors", "sparse-reward-1.safetensors"] {
            if let Ok(reward) = read(earlier(name).bytes()) {
                drop(LearnedReward::load(&reward, &model));
            }
        }
        if let Ok(probe) = read(probe()) {
            drop(Probe::load(&probe));
        }
    }
}

/// The file of the shipped probe.
fn probe() -> &'static [u8] {
    static BYTES: std::sync::OnceLock<Vec<u8>> = std::sync::OnceLock::new();
    BYTES.get_or_init(|| std::fs::read(shipped("assets/probe-car-racing.safetensors")).unwrap())
}

#[test]
fn a_damaged_dream_of_a_session_is_a_dream_or_refused() {
    let dir = tempfile::tempdir().unwrap();
    let (_, store) = session(&dir.path().join("session"));
    let dream = store.dream(dropj::query::DreamId(0)).unwrap();
    let bytes = dream_to_bytes(&dream);
    for at in 0..bytes.len().min(900) {
        for byte in [b'0', b'9', b'{', 0xff] {
            let mut damaged = bytes.clone();
            damaged[at] = byte;
            drop(dream_from_bytes(&damaged));
        }
    }
}
