//! What a fit on the processor makes of the same recordings, and what is drawn for one on a device.

use std::collections::BTreeSet;
use std::ops::ControlFlow;
use std::path::Path;

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use tch::{Device, Kind, Tensor};

use super::data::{DeviceFrames, DeviceSequences, Source, read_one_by_one};
use crate::dataset::{Dataset, EpisodeInfo, StepRecord};
use crate::env::{Action, End, Frame};
use crate::run::Run;
use crate::tensor::{to_frames, to_vec};
use crate::world_model::WorldModelConfig;
use crate::world_model::fit::{FitConfig, Progress, fit_world};

/// Of each epoch, those of vision first.
const LOSSES: [[f64; 2]; 4] =
    [[92.72897, 101.436], [91.58750, 102.969], [1.21116, 1.12891], [1.18187, 1.07495]];

/// Four episodes of a gray that comes and goes.
fn recordings(dir: &Path) -> Dataset {
    let env = WorldModelConfig::tiny().env;
    let mut dataset = Dataset::create_or_open(dir, &env).unwrap();
    for seed in 0..4_u64 {
        let frame = |t: u64| Frame::new(20, (0..1200).map(|i| (i * seed + 5 * t) as u8).collect::<Vec<_>>());
        let info = EpisodeInfo { env: env.clone(), pilot: "nobody".to_owned(), seed };
        let mut recording = dataset.begin(info).unwrap();
        let n = 35 + seed;
        for t in 0..n {
            let action = Action::new((t as f32).sin(), 0.0, 0.0);
            let (grass, contacts, state) = (false, None, Vec::new());
            let step =
                StepRecord { frame: frame(t), action, reward: 0.0, grass, contacts, wall_time_ns: 0, state };
            recording.push(&step).unwrap();
        }
        dataset.seal(recording, &frame(n), Some(End::TimeLimit)).unwrap();
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
    for (found, wanted) in losses.iter().flatten().zip(LOSSES.iter().flatten()) {
        assert!((found / wanted - 1.0).abs() < 2e-3, "{losses:?} instead of {LOSSES:?}");
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
    let mut pictures = DeviceFrames::new(source, &train, Device::Cpu, rng).unwrap().expect("there is room");
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
