//! The Python package: what it reads and computes is what the program does, and TorchScript too.
//!
//! Python with `NumPy` is needed, and what is needed and not there is said; with `REQUIRE_NUMPY` its absence is a failure.
#![expect(clippy::unwrap_used, reason = "a failing test may panic")]
#![expect(clippy::print_stderr, reason = "a test that is skipped says so, and distances are told")]

#[path = "support/program.rs"]
mod program;

use std::collections::HashMap;
use std::fs;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::Command;

use dropj::dream::{DreamEpisode, Rows};
use dropj::query::{DreamId, Justification, Justifications, Preference, Response, SegmentRef, Weights};
use dropj::reward::{
    Learned, RewardConfig, RewardEnsemble, RewardInputs, RewardModel as _, RewardNetworks, SegmentPair,
    SparseConfig, SparseReward, Trainer, scaled_actions_tensor, segment_rows, sparse,
};
use dropj::session::arrays::dream_from_bytes;
use dropj::tensor::{Parameters, bytes_of_frames, from_slice, normal, to_frames, uniform};
use dropj::world_model::{Memory, Next, Noise, State, Vae, WorldModel, actions_tensor, fast_kind};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use serde_json::json;
use tch::{CModule, Device, Kind, Tensor, nn};

use program::{dropj, shipped};

const WORLD: &str = "assets/world-car-racing.safetensors";
const DREAM: &str = "sessions/example/dreams/0000.safetensors";
const REWARD: &str = "sessions/example/reward/0000.safetensors";

fn rng() -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(0)
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn parameters(path: &Path) -> Parameters {
    Parameters::from_bytes(fs::read(path).unwrap()).unwrap()
}

fn model(path: &Path) -> WorldModel {
    WorldModel::load(parameters(path)).unwrap()
}

/// Python with the package and what the tests need, if it can import that.
fn python(import: &str) -> Option<Command> {
    let before = std::env::var_os("PYTHONPATH").unwrap_or_default();
    // What .ci/setup-python has fetched.
    let fetched = fs::read_dir(shipped(".tools")).into_iter().flatten().filter_map(|entry| {
        let path = entry.ok()?.path();
        path.join("numpy").is_dir().then_some(path)
    });
    let paths = [shipped("assets/python"), shipped("tests/python")].into_iter();
    let paths = std::env::join_paths(paths.chain(std::env::split_paths(&before)).chain(fetched)).unwrap();
    let here = || {
        let mut python = Command::new("python3");
        python.env("PYTHONPATH", &paths).env("PYTHONDONTWRITEBYTECODE", "1").env("OMP_NUM_THREADS", "1");
        python.current_dir(shipped(""));
        python
    };
    if here().args(["-c", import]).output().is_ok_and(|tried| tried.status.success()) {
        return Some(here());
    }
    assert!(std::env::var_os("REQUIRE_NUMPY").is_none(), "python3 cannot `{import}`");
    eprintln!("skipped: python3 cannot `{import}` here; .ci/setup-python fetches what is needed");
    None
}

/// Runs it, and tells what it said.
#[track_caller]
fn run(mut python: Command) {
    let done = python.output().unwrap();
    let [out, err] = [done.stdout, done.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    assert!(done.status.success(), "{out}\n{err}");
    eprint!("{out}{err}");
}

#[test]
fn the_packages_own_tests_pass() {
    let Some(mut python) = python("import numpy") else { return };
    python.args(["-m", "unittest", "discover", "tests/python"]);
    run(python);
}

#[test]
fn the_program_writes_the_whole_package() {
    let dir = tempfile::tempdir().unwrap();
    dropj(dir.path(), ["world", "adapter", "--out", "python"]).succeeded();
    for folder in ["", "dropj"] {
        let names = |root: PathBuf| {
            let files = fs::read_dir(root.join(folder)).unwrap().map(|entry| entry.unwrap().path());
            let files = files.filter(|path| path.is_file());
            let mut names: Vec<_> = files.map(|path| path.file_name().unwrap().to_owned()).collect();
            names.sort();
            names
        };
        assert_eq!(names(dir.path().join("python")), names(shipped("assets/python")));
    }
}

/// The features of a state, by a name.
fn named(state: &State, name: &str) -> (String, Tensor) {
    (name.to_owned(), state.features())
}

/// What a world model makes of frames and of states, by name.
fn world(model: &WorldModel) -> Vec<(String, Tensor)> {
    let (b, config) = (5, &model.config().mdn_rnn);
    let rng = &mut rng();
    let start = State::from(&model.starts()[3]).repeated(b);
    let z = start.z + normal(rng, &[b, config.latent]) * 0.3;
    let actions = uniform(rng, &[b, 3], 1.0) * Tensor::from_slice(&[1.0f32, 0.5, 0.5])
        + Tensor::from_slice(&[0.0f32, 0.5, 0.5]);
    let state = State { z, memory: start.memory };
    let noise = Noise::draw(b, config.latent, rng);
    let painted = model.decode(&state.z);
    // Frames that no decoder has smoothed.
    let frames = to_frames(
        &(bytes_of_frames(&painted).to_kind(Kind::Float) / 255.0 + normal(rng, &[b, 84, 84, 3]) * 0.1),
    );
    let after = model.remember(&state, &actions);

    let store = nn::VarStore::new(Device::Cpu);
    let vae = Vae::new(&store.root(), model.config().vae.clone(), Kind::Float, rng);
    model.parameters().fill("vae", &model.config().vae.slots(), 2, &store).unwrap();
    let in_f32 = tch::no_grad(|| to_frames(&vae.decode(&state.z)));

    let mut all = vec![
        ("frames".to_owned(), bytes_of_frames(&frames)),
        ("observed".to_owned(), model.observe(&frames)),
        ("painted".to_owned(), bytes_of_frames(&painted)),
        ("painted in f32".to_owned(), bytes_of_frames(&in_f32)),
        ("remembered".to_owned(), Tensor::cat(&[&after.c, &after.h], 1)),
        ("uniform".to_owned(), noise.uniform.shallow_clone()),
        ("normal".to_owned(), noise.normal.shallow_clone()),
    ];
    for temperature in [0.1, 1.0] {
        let mean = model.imagine(&state, &actions, Next::Mean { temperature });
        all.push(named(&mean, &format!("mean {temperature:?}")));
    }
    for temperature in [1.0, 0.5] {
        let drawn = model.imagine(&state, &actions, Next::Sample { temperature, noise: &noise });
        all.push(named(&drawn, &format!("sample {temperature:?}")));
    }
    let Memory { c, h } = state.memory;
    all.extend(
        [("z", state.z), ("c", c), ("h", h), ("actions", actions)].map(|(name, t)| (name.to_owned(), t)),
    );
    all
}

/// What the shipped reward says of the shipped dream, and rewards of verdicts in `folder`, by name.
fn rewards(model: &WorldModel, folder: &Path) -> Vec<(String, Tensor)> {
    let episode = dream_from_bytes(&fs::read(shipped(DREAM)).unwrap()).unwrap();
    let kept = episode.features(model);
    let features = from_slice(&kept.values, &[episode.len() as i64, kept.width as i64]);
    let (driven, scaled) =
        (actions_tensor(&episode.actions), scaled_actions_tensor(&episode.actions, model.ranges()));
    let reward = RewardEnsemble::load(&parameters(&shipped(REWARD))).unwrap().in_kind(Kind::Float);
    let row = |values: &[f32]| from_slice(values, &[values.len() as i64]);
    let mut all = vec![
        ("reward".to_owned(), reward.rewards(&features, &scaled)),
        ("members".to_owned(), reward.member_rewards(&features, &scaled)),
        ("dream start.z".to_owned(), row(&episode.start.z)),
        ("dream start.c".to_owned(), row(&episode.start.c)),
        ("dream start.h".to_owned(), row(&episode.start.h)),
        ("dream zs".to_owned(), from_slice(&episode.zs.values, &[episode.len() as i64, -1])),
    ];
    for (name, rules) in [("joint", sparse::Rules::Joint), ("apart", sparse::Rules::Apart)] {
        let config = SparseConfig { rules, ..SparseConfig::tiny() };
        let reward = SparseReward::new(RewardInputs::of(model), config, &mut rng());
        fs::write(folder.join(format!("{name}.safetensors")), reward.parameters().bytes()).unwrap();
        let chances = tch::no_grad(|| reward.chances(&features, &driven));
        all.push((name.to_owned(), reward.rewards(&features, &scaled)));
        all.push((format!("{name} chances"), chances));
    }
    let reward = naming_grass(model, &episode, &kept);
    fs::write(folder.join("hazards.safetensors"), reward.parameters().bytes()).unwrap();
    all.push(("hazards".to_owned(), reward.rewards(&features, &scaled)));
    let shown = reward.hazards().unwrap().probabilities(&Tensor::cat(&[&features, &scaled], 1));
    all.push(("hazards shown".to_owned(), shown));
    all.extend([
        ("dream features".to_owned(), features),
        ("dream actions".to_owned(), driven),
        ("scaled".to_owned(), scaled),
    ]);
    all
}

/// A reward that was learned from six answers about this dream, of which two name grass and two water.
fn naming_grass(model: &WorldModel, episode: &DreamEpisode, features: &Rows) -> RewardEnsemble {
    let mut weights = Weights::paper();
    weights.justifications =
        Justifications::new([("grass", 0.9), ("water", 0.9), ("default", 0.75)]).unwrap();
    let naming = RewardConfig { learned: Learned::Hazards, ..RewardConfig::tiny() };
    let ensemble = RewardEnsemble::new(RewardInputs::of(model), naming, &mut rng());
    let mut trainer = Trainer::new(ensemble.in_kind(Kind::Float));
    for (i, place) in [0, 1, 2, 0, 1, 2].into_iter().enumerate() {
        let rows = |start| {
            let segment = SegmentRef { dream: DreamId(0), start };
            segment_rows(features, &episode.actions, model.ranges(), segment)
        };
        let response = Response::Justified(Justification(place).into(), Preference::Left);
        let label = weights.label(&response).unwrap();
        trainer.add(&SegmentPair { left: rows(30 * i), right: rows(200 + 30 * i), label });
    }
    let _ = trainer.fit(&mut rng(), |_| ControlFlow::Continue(())).unwrap();
    let reward = RewardEnsemble::load(&trainer.ensemble().parameters()).unwrap().in_kind(Kind::Float);
    let costs = reward.hazards().unwrap().weights();
    assert!(costs.max().double_value(&[]) > 0.0, "something is taken off: {costs:?}");
    reward
}

/// What networks of the first layout make of a little, by name.
fn of_layout_1() -> Vec<(String, Tensor)> {
    let rng = &mut rng();
    let model = model(&shipped("tests/cases/earlier/world-1.safetensors"));
    let (z, side) = (normal(rng, &[3, model.config().mdn_rnn.latent]), model.config().vae.height);
    let actions = uniform(rng, &[3, 3], 1.0).abs();
    let frames = to_frames(&uniform(rng, &[3, side, side, 3], 1.0).abs());
    let state = State { z, memory: model.no_memory(3) };
    let imagined = model.imagine(&state, &actions, Next::Mean { temperature: 0.1 });
    let mut all = vec![
        ("old observed".to_owned(), model.observe(&frames)),
        ("old frames".to_owned(), bytes_of_frames(&frames)),
        ("old painted".to_owned(), bytes_of_frames(&model.decode(&state.z))),
        named(&imagined, "old imagined"),
        ("old actions".to_owned(), actions.shallow_clone()),
        ("old z".to_owned(), state.z),
    ];
    let features = normal(rng, &[3, model.config().n_features()]);
    let scaled = &actions * Tensor::from_slice(&[1.0f32, 2.0, 2.0]) - Tensor::from_slice(&[0.0f32, 1.0, 1.0]);
    for (name, file) in [("old sparse", "sparse-reward-1"), ("old reward", "reward-1")] {
        let parameters = parameters(&shipped(&format!("tests/cases/earlier/{file}.safetensors")));
        let said = match RewardNetworks::load(&parameters).unwrap() {
            RewardNetworks::Preferences(reward) => reward.in_kind(Kind::Float).rewards(&features, &scaled),
            RewardNetworks::Verdicts(reward) => reward.rewards(&features, &scaled),
        };
        all.push((name.to_owned(), said));
    }
    all.push(("few features".to_owned(), features));
    all.push(("few actions".to_owned(), actions));
    all
}

/// A session of what the page on formats shows, a line of each kind of event.
fn session_of_the_page(folder: &Path) -> PathBuf {
    let page = fs::read_to_string(shipped("assets/format-sessions.md")).unwrap();
    let header = page.split("```json\n").nth(1).unwrap().split("```").next().unwrap();
    let dir = folder.join("page");
    fs::create_dir(&dir).unwrap();
    fs::write(dir.join("session.json"), header.replace("\"drop\"", "\"dropj\"")).unwrap();
    let events: Vec<_> = page.lines().filter(|line| line.starts_with("{\"event\"")).collect();
    fs::write(dir.join("events.jsonl"), events.join("\n") + "\n").unwrap();
    dir
}

#[test]
fn python_computes_what_the_program_does() {
    let Some(mut python) = python("import numpy") else { return };
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path();
    let model = model(&shipped(WORLD));
    let mut all = world(&model);
    all.extend(rewards(&model, folder));
    all.extend(of_layout_1());
    let frames =
        all.iter().find(|(name, _)| name == "frames").map(|(_, frames)| frames.shallow_clone()).unwrap();
    let frames = to_frames(&(frames.to_kind(Kind::Float) / 255.0));
    for dtype in ["f16", "bf16"] {
        let narrow = folder.join(format!("world-{dtype}.safetensors"));
        dropj(folder, ["convert", "--dtype", dtype, "--out", text(&narrow), text(&shipped(WORLD))])
            .succeeded();
        all.push((format!("observed {dtype}"), self::model(&narrow).observe(&frames)));
    }
    let tensors = all.into_iter().map(|(name, tensor)| (name, tensor.to_kind(Kind::Float).contiguous()));
    let kind = format!("{:?}", fast_kind());
    let rust = Parameters::from_tensors(
        tensors,
        &[("kind", if kind == "Float" { kind } else { "BFloat16".to_owned() })],
    );
    fs::write(folder.join("rust.safetensors"), rust.bytes()).unwrap();

    let example = shipped("sessions/example");
    for (form, file) in [(None, "reward.csv"), (Some("--json"), "reward.json")] {
        let mut args = vec!["reward", "--on", "0", "--out", file, "--session", text(&example)];
        args.extend(form);
        dropj(folder, args).succeeded();
    }
    let (obstacles, page) = (shipped("sessions/example-obstacles"), session_of_the_page(folder));
    let mut labels = Vec::new();
    for (i, (session, options, weights)) in [
        (&example, "", json!({})),
        (
            &example,
            "--safety 0.9 --default 0.6 --weights grass=0.95,default=0.85",
            json!({
                "safety": 0.9, "default": 0.6, "justifications": {"grass": 0.95, "default": 0.85}
            }),
        ),
        (&obstacles, "", json!({})),
        (
            &obstacles,
            "--weights grass=1,chuckhole=0.7,default=0.95",
            json!({
                "justifications": {"grass": 1.0, "chuckhole": 0.7, "default": 0.95}
            }),
        ),
        (&page, "", json!({})),
        (&page, "--default 0.99 --safety 0.51", json!({"safety": 0.51, "default": 0.99})),
    ]
    .into_iter()
    .enumerate()
    {
        let name = format!("labels-{i}.jsonl");
        let args = ["labels", "--jsonl", "--out", &name].into_iter().chain(options.split_whitespace());
        dropj(folder, args.chain([text(session)])).succeeded();
        labels.push(json!([name, session, weights]));
    }
    let earlier = |name: &str| shipped(&format!("tests/cases/earlier/{name}.safetensors"));
    let given = json!({
        "world": shipped(WORLD),
        "reward": shipped(REWARD),
        "joint": folder.join("joint.safetensors"),
        "apart": folder.join("apart.safetensors"),
        "hazards": folder.join("hazards.safetensors"),
        "old world": earlier("world-1"),
        "old reward": earlier("reward-1"),
        "old sparse": earlier("sparse-reward-1"),
        "labels": labels,
    });
    fs::write(folder.join("given.json"), given.to_string()).unwrap();
    python.args(["tests/python/compare.py".as_ref(), folder]);
    run(python);
}

/// How far two tensors are apart.
fn apart(found: &Tensor, wanted: &Tensor) -> f64 {
    assert_eq!(found.size(), wanted.size(), "as many numbers");
    (found.to_kind(Kind::Float) - wanted.to_kind(Kind::Float)).abs().max().double_value(&[])
}

#[test]
fn torchscript_computes_what_the_program_does() {
    let dir = tempfile::tempdir().unwrap();
    let model = model(&shipped(WORLD));
    let all: HashMap<_, _> = world(&model).into_iter().chain(rewards(&model, dir.path())).collect();
    let export = |what: &str, path: &Path, out: &str| {
        let args = ["export", "--torchscript", "--out", out, what, text(path)];
        dropj(dir.path(), args).succeeded().to_owned()
    };
    export("--world", &shipped(WORLD), "w.pt");
    export("--reward", &shipped(REWARD), "w.pt");
    let load = |name: &str| CModule::load(dir.path().join(name)).unwrap();
    let given = |names: &[&str]| names.iter().map(|name| all[*name].shallow_clone()).collect::<Vec<_>>();
    let state = Tensor::cat(&given(&["z", "c", "h"]), 1);
    let step = |temperature: f32| {
        vec![state.shallow_clone(), all["actions"].shallow_clone(), Tensor::from(temperature)]
    };
    let noisy_step: Vec<_> = step(0.5).into_iter().chain(given(&["uniform", "normal"])).collect();

    let mut found = vec![
        ("observe", load("w-observe.pt").forward_ts(&given(&["frames"])).unwrap(), "observed", 5e-5),
        ("decode", load("w-decode.pt").forward_ts(&given(&["z"])).unwrap(), "painted in f32", 1.0),
        ("imagine", load("w-imagine.pt").forward_ts(&step(0.1)).unwrap(), "mean 0.1", 5e-5),
        ("imagine", load("w-imagine.pt").forward_ts(&step(1.0)).unwrap(), "mean 1.0", 5e-5),
        ("sample", load("w-sample.pt").forward_ts(&noisy_step).unwrap(), "sample 0.5", 5e-5),
    ];
    let rows = given(&["dream features", "dream actions"]);
    found.push(("reward", load("w-reward.pt").forward_ts(&rows).unwrap(), "reward", 5e-5));
    for name in ["joint", "apart", "hazards"] {
        export("--reward", &dir.path().join(format!("{name}.safetensors")), &format!("{name}.pt"));
        let said = load(&format!("{name}-reward.pt")).forward_ts(&rows).unwrap();
        found.push(("reward", said, name, 5e-5));
    }
    for (name, found, wanted, most) in found {
        let distance = apart(&found, &all[wanted]);
        eprintln!("TorchScript: {name} ({wanted}): {distance:.3e} apart, at most {most:e}");
        assert!(distance <= most, "{name} ({wanted}) is {distance} apart");
    }
    let reward = shipped(REWARD);
    dropj(dir.path(), ["export", "--torchscript", "--out", "w.pt", "--reward", text(&reward)]).refused();
}
