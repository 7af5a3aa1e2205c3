//! What a fit on the processor makes of the same recordings, and what is drawn for one on a device.

use std::collections::BTreeSet;
use std::ops::ControlFlow;
use std::path::Path;

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use tch::{Device, Kind, Tensor};

use super::data::{DeviceFrames, DeviceSequences, Source, read_one_by_one};
use crate::dataset::{Dataset, EpisodeInfo, Layout, StepRecord};
use crate::run::Run;
use crate::tensor::{to_frames, to_vec};
use crate::world::{Action, End, Frame, WorldSpec};
use crate::world_model::fit::{FitConfig, Progress, check_world, fit_world};
use crate::world_model::{WorldModel, WorldModelConfig};

/// Of each epoch, those of vision first, where vision is trained in bf16.
const LOSSES: [[f64; 2]; 4] =
    [[92.72897, 101.436], [91.58750, 102.969], [1.21116, 1.12891], [1.18187, 1.07495]];
/// The same in single precision.
const LOSSES_IN_F32: [[f64; 2]; 4] =
    [[92.72836, 101.4333], [91.59819, 102.9396], [1.21672, 1.13386], [1.18882, 1.08235]];

/// Four episodes of a gray that comes and goes.
fn recordings(dir: &Path) -> Dataset {
    let env = WorldModelConfig::tiny().env;
    let mut dataset = Dataset::create_or_open(dir, &env).unwrap();
    for seed in 0..4_u64 {
        let frame =
            |t: u64| Frame::square(20, (0..1200).map(|i| (i * seed + 5 * t) as u8).collect::<Vec<_>>());
        let info = EpisodeInfo { env: env.clone(), pilot: "nobody".to_owned(), seed };
        let mut recording = dataset.begin(info).unwrap();
        let n = 35 + seed;
        for t in 0..n {
            let action = Action::new([(t as f32).sin(), 0.0, 0.0]);
            let events = vec![false; dataset.layout().unwrap_or_default().events.len()];
            let (frame, state) = (frame(t), Vec::new());
            let step = StepRecord { frame, action, reward: 0.0, events, wall_time_ns: 0, state };
            recording.push(&step).unwrap();
        }
        dataset.seal(recording, &frame(n), Some(End::Truncated)).unwrap();
    }
    drop(dataset);
    Dataset::open(dir).unwrap()
}

/// A brief fit in a folder of its own, and what it told of each epoch: the losses on what is trained on and held out.
fn brief(dir: &Path, dataset: &Dataset) -> Vec<[f64; 2]> {
    tch::set_num_threads(1);
    let mut fit = FitConfig::tiny();
    for schedule in [&mut fit.vae, &mut fit.mdn_rnn] {
        (schedule.max_epochs, schedule.updates_per_epoch) = (2, 9);
    }
    let run = Run::open(&dir.join("run"), false).unwrap();
    let mut losses = Vec::new();
    let report = &mut |progress: &Progress| {
        losses.extend(progress.held_out.map(|held_out| [progress.loss, held_out]));
        ControlFlow::Continue(())
    };
    fit_world(dataset, &WorldModelConfig::tiny(), &fit, &run, report).unwrap();
    losses
}

/// The numbers are those of before there were devices. How products are rounded depends on the processor, what is drawn does
/// not: another order of draws makes other numbers by far more than is allowed here.
#[test]
fn a_fit_on_the_processor_learns_what_it_always_learned() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = recordings(&dir.path().join("data"));
    let losses = brief(dir.path(), &dataset);
    let wanted = if crate::tensor::fast_kind() == Kind::Float { LOSSES_IN_F32 } else { LOSSES };
    for (found, one) in losses.iter().flatten().zip(wanted.iter().flatten()) {
        assert!((found / one - 1.0).abs() < 2e-3, "{losses:?} instead of {wanted:?}");
    }
}

#[test]
fn pictures_on_a_device_come_once_in_a_pass() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = recordings(&dir.path().join("data"));
    let source = Source { dataset: &dataset, read: &read_one_by_one };
    let rng = &mut ChaCha8Rng::seed_from_u64(0);
    let train = [0, 2, 3];
    let mut wanted: Vec<Vec<u8>> = Vec::new();
    for i in train {
        wanted.extend(dataset.episode(i).unwrap().frames.iter().map(|frame| frame.rgb().to_vec()));
    }
    let mut pictures =
        DeviceFrames::new(source, &train, [20; 2], Device::Cpu, rng).unwrap().expect("there is room");
    for pass in 0..2 {
        let batches = [40, wanted.len() - 40].map(|n| to_frames(&pictures.next(n, rng).unwrap()));
        let mut found: Vec<_> = batches.iter().flatten().map(|frame| frame.rgb().to_vec()).collect();
        assert_ne!(found, wanted, "in another order");
        found.sort();
        wanted.sort();
        assert!(found == wanted, "pass {pass}");
    }
    let many = pictures.next(3 * wanted.len(), rng).unwrap();
    assert_eq!(many.size(), [3 * wanted.len() as i64, 20, 20, 3]);
}

#[test]
fn windows_on_a_device_are_stretches_of_one_episode() {
    let lens = [30, 7, 50];
    let n = lens.iter().sum::<i64>();
    // Each step says which it is; noise is too small to matter.
    let steps = Tensor::arange(n, (Kind::Float, Device::Cpu)).unsqueeze(1);
    let log_var = Tensor::full([n, 2], -60.0, (Kind::Float, Device::Cpu));
    let sequences =
        DeviceSequences::of(steps.expand([n, 2], false), log_var, steps.expand([n, 3], false), &lens);
    let windows = sequences.windows(200, 10);
    assert_eq!((windows.zs.size(), windows.actions.size()), (vec![200, 10, 2], vec![200, 10, 3]));
    let mut begins = BTreeSet::new();
    for b in 0..200 {
        let zs = to_vec(&windows.zs.get(b).select(1, 0).round());
        assert_eq!(zs, to_vec(&windows.actions.get(b).select(1, 2)));
        let len = windows.lens.int64_value(&[b]);
        let episode = if zs[0] < 30.0 {
            0..30
        } else if zs[0] < 37.0 {
            30..37
        } else {
            37..87
        };
        assert_eq!(len, 10.min(i64::from(episode.end - episode.start)));
        for (t, z) in zs.iter().take(len as usize).enumerate() {
            assert_eq!(*z, zs[0] + t as f32, "one step after the other");
        }
        assert!(zs.iter().all(|z| episode.contains(&(*z as i32))), "of one episode: {zs:?}");
        begins.insert(zs[0] as i32);
    }
    assert!(begins.contains(&30) && begins.len() > 30, "from anywhere: {begins:?}");
}

/// An arm that sees 21 x 33 pixels ten times a second, and bumps into things.
fn arm() -> WorldSpec {
    let file = r#"
        format = 1
        name = "arm"
        title = "An arm"
        rate = 10
        longest_episode = 400
        source = { kind = "recordings" }
        image = { height = 21, width = 33 }
        axes = [
            { name = "reach", low = 0.0, high = 512.0, neutral = 256.0 },
            { name = "grip", low = -1.0, high = 1.0, neutral = 0.0 },
        ]
        events = [{ name = "lifts", kind = "progress", field = "lifts" }, { name = "bump", kind = "safety", field = "bump" }]
        networks = { latent = 3, memory = 8, components = 2, channels = 4 }
        fitting = { batch = 8, held_out = 0.5, mdn_rnn_epochs = 2 }
    "#;
    file.parse().unwrap()
}

/// Four episodes of the arm: it lifts throughout, and bumps up to step 20. Its frames say which step it is.
fn recordings_of_arm(dir: &Path) -> Dataset {
    let mut dataset = Dataset::create_or_open(dir, "arm").unwrap();
    for seed in 0..4_u64 {
        let frame = |t: usize| Frame::new(21, 33, vec![(4 * t) as u8; 3 * 21 * 33]);
        let info = EpisodeInfo { env: "arm".to_owned(), pilot: "nobody".to_owned(), seed };
        let mut recording = dataset.begin_with(info, &Layout::of(&arm(), &[])).unwrap();
        for t in 0..45 {
            let action = Action::new([t as f32, 0.5]);
            let (frame, events, state) = (frame(t), vec![true, t <= 20], Vec::new());
            let step = StepRecord { frame, action, reward: 0.0, events, wall_time_ns: 0, state };
            recording.push(&step).unwrap();
        }
        dataset.seal(recording, &frame(45), Some(End::Truncated)).unwrap();
    }
    drop(dataset);
    Dataset::open(dir).unwrap()
}

#[test]
fn any_world_is_learned_and_dreams_of_it_start_where_nothing_bad_goes_on() {
    tch::set_num_threads(1);
    let dir = tempfile::tempdir().unwrap();
    let dataset = recordings_of_arm(&dir.path().join("data"));
    let (config, mut fit) = (WorldModelConfig::for_world(&arm()), FitConfig::for_world(&arm()));
    assert_eq!((fit.window, fit.vae.batch, fit.mdn_rnn.max_epochs), (50, 8, 2));
    (fit.vae.max_epochs, fit.vae.updates_per_epoch, fit.mdn_rnn.updates_per_epoch) = (1, 4, 3);
    let run = Run::open(&dir.path().join("run"), false).unwrap();
    let go_on = &mut |_: &Progress| ControlFlow::Continue(());
    let parameters = fit_world(&dataset, &config, &fit, &run, go_on).unwrap();
    assert!(run.load("rarity").unwrap().is_some(), "rare colors were looked for");
    let model = WorldModel::load(parameters.clone()).unwrap();
    assert_eq!((model.spec().name.as_str(), model.config()), ("arm", &config));
    let held_out = model.held_out().unwrap();
    assert_eq!((held_out.len(), model.starts().len()), (2, 2));
    for (i, (start, episode)) in model.starts().iter().zip(held_out).enumerate() {
        // Nothing bad for 0.4 s: four steps.
        let at = 25.max(12 + 8 * i);
        let episode = dataset.episode(episode).unwrap();
        assert_eq!(model.states_of(&episode.frames, &episode.actions, &[at]), std::slice::from_ref(start));
    }
    drop(run);
    let run = Run::open(&dir.path().join("run"), true).unwrap();
    assert_eq!(fit_world(&dataset, &config, &fit, &run, go_on).unwrap().bytes(), parameters.bytes());
}

#[test]
fn recordings_of_another_world_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = recordings_of_arm(dir.path());
    let of = |change: &dyn Fn(&mut WorldSpec)| {
        let mut spec = arm();
        change(&mut spec);
        check_world(&dataset, &WorldModelConfig::for_world(&spec)).map_err(|met| met.to_string())
    };
    assert_eq!(of(&|_| ()), Ok(()));
    let has = "the recordings have pictures of 21 x 33 pixels, the axes reach, grip and 10 steps a second, and the world \
               \"arm\" has";
    for (change, wanted) in [
        (
            &(|spec: &mut WorldSpec| spec.image.width = 32) as &dyn Fn(&mut WorldSpec),
            "pictures of 21 x 32 pixels, the axes reach, grip and 10 steps",
        ),
        (&|spec| spec.rate = 50.0, "pictures of 21 x 33 pixels, the axes reach, grip and 50 steps"),
        (&|spec| spec.axes.truncate(1), "pictures of 21 x 33 pixels, the axes reach and 10 steps"),
        (
            &|spec| spec.axes[1].name = "twist".to_owned(),
            "pictures of 21 x 33 pixels, the axes reach, twist and 10 steps",
        ),
    ] {
        let said = of(change).unwrap_err();
        assert!(said.starts_with(&format!("{has} {wanted} a second")), "{said}");
    }
}

#[test]
fn built_in_worlds_are_fitted_as_they_always_were() {
    for name in crate::world::NAMES {
        assert_eq!(FitConfig::for_world(&WorldSpec::built_in(name).unwrap()), FitConfig::full());
    }
    let window = |rate: f64, longest_episode: usize| {
        FitConfig::for_world(&WorldSpec { rate, longest_episode, ..arm() }).window
    };
    assert_eq!(
        [window(30.0, 400), window(5.0, 400), window(1000.0, 9000), window(50.0, 80)],
        [150, 50, 500, 80]
    );
}
