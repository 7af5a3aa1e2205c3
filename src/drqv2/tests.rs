use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::Path;

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use tch::{Device, Kind, Tensor};

use super::agent::Nature;
use super::replay::shifted;
use super::*;
use crate::evaluation::Policy as _;
use crate::run::Run;
use crate::tensor::{Backend, Parameters, from_slice, normal, to_vec};
use crate::world::cars::{CarAction, CarWorld, Env, Events, Outcome, Seed, Truth};
use crate::world::{End, Frame, Size, World as _, WorldSpec};

/// A lane of 18 pixels a side: whoever steers leaves its middle, and beyond 1 is grass. Terminated at 2, over after 11 steps.
struct Lane {
    t: usize,
    at: f32,
}

impl Env for Lane {
    fn reset(&mut self, seed: Seed) {
        let Seed::Native(seed) = seed else { return };
        *self = Self { t: 0, at: (seed % 7) as f32 / 10.0 - 0.3 };
    }

    fn advance(&mut self, action: CarAction) -> Outcome {
        self.t += 1;
        self.at += 0.5 * action.to_array()[0];
        let events = Events { grass: self.at.abs() > 1.0, ..Events::default() };
        let end = if self.at.abs() > 2.0 {
            Some(End::Terminated)
        } else {
            (self.t == 11).then_some(End::Truncated)
        };
        Outcome { reward: 1.0 - self.at.abs(), events, end }
    }

    fn frame(&self) -> Frame {
        let middle = 9.0 + 3.0 * self.at;
        let bytes = (0..18 * 18).flat_map(|i| {
            let near = (i % 18) as f32 - middle;
            [(200.0 * (-near * near / 4.0).exp()) as u8, self.t as u8, 30]
        });
        Frame::square(18, bytes.collect::<Vec<_>>())
    }

    fn truth(&self) -> Truth {
        Truth::default()
    }

    fn picture(&self, _: u32, _: u32) -> Vec<u8> {
        Vec::new()
    }
}

fn lane() -> CarWorld {
    CarWorld::of("lane", Lane { t: 0, at: 0.0 })
}

fn backend() -> Backend {
    tch::set_num_threads(1);
    Backend { device: Device::Cpu, kind: Kind::Float }
}

fn rng() -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(0)
}

/// An episode of `n` actions in which the picture before action t is all `10 t`, and the rewards are 1, 2, 3, …
fn counted(n: u8, is_terminated: bool) -> Episode {
    let picture = |t: u8| Frame::square(18, vec![10 * t; 3 * 18 * 18]);
    let mut episode = Episode::begin(&picture(0), 3);
    for t in 0..n {
        let share = f32::from(t) / 10.0;
        episode.push(&[share, -share, 0.5], f32::from(t + 1), &picture(t + 1), is_terminated && t + 1 == n);
    }
    episode
}

/// What each of the pictures in the stacks of a batch shows at its first pixel, `[B, k]`.
fn shown(pixels: &Tensor, k: usize) -> Vec<Vec<u8>> {
    let first = to_vec(&pixels.slice(1, 0, 3 * k as i64, 3).select(2, 0).select(2, 0).contiguous());
    first.chunks(k).map(|stack| stack.iter().map(|value| *value as u8).collect()).collect()
}

// By hand, with γ = 0.9: 1 + 0.9 · 2 + 0.81 · 3 = 5.23, and so on; 0.9³ = 0.729.
#[test]
fn samples_are_n_step_returns_and_stay_within_their_episode() {
    let config = DrqConfig { stack: 3, n_step: 3, discount: 0.9, batch: 200, ..DrqConfig::tiny() };
    let mut replay = Replay::default();
    replay.push(0, counted(5, true), &config);
    replay.push(1, counted(2, true), &config);
    assert_eq!(replay.numbers().collect::<Vec<_>>(), [0], "two actions have no three rewards");
    let batch = replay.sample(&config, Device::Cpu, &mut rng());
    assert_eq!(batch.pixels.size(), [200, 9, 18, 18]);
    let wanted = BTreeMap::from([
        (0u8, ([0u8, 0, 0], [10u8, 20, 30], 0.0f32, 5.23f32, 0.729f32)),
        (10, ([0, 0, 10], [20, 30, 40], 0.1, 7.94, 0.729)),
        (20, ([0, 10, 20], [30, 40, 50], 0.2, 10.65, 0.0f32)),
    ]);
    let (now, next) = (shown(&batch.pixels, 3), shown(&batch.next_pixels, 3));
    let [rewards, discounts] = [&batch.rewards, &batch.discounts].map(to_vec);
    let mut met = BTreeMap::new();
    for i in 0..200 {
        *met.entry(now[i][2]).or_insert(0) += 1;
        let (stack, then, action, reward, discount) = wanted[&now[i][2]];
        assert_eq!((&now[i][..], &next[i][..]), (&stack[..], &then[..]));
        assert_eq!(batch.actions.double_value(&[i as i64, 0]) as f32, action);
        assert!((rewards[i] - reward).abs() < 1e-5 && (discounts[i] - discount).abs() < 1e-6, "{reward}");
    }
    assert!(met.values().all(|n| *n > 40) && met.len() == 3, "each time as often as any other: {met:?}");
}

#[test]
fn an_episode_that_only_ran_out_of_time_is_worth_something_beyond_its_end() {
    let config = DrqConfig { n_step: 3, batch: 20, discount: 0.9, ..DrqConfig::tiny() };
    let mut replay = Replay::default();
    replay.push(0, counted(3, false), &config);
    let batch = replay.sample(&config, Device::Cpu, &mut rng());
    assert!(to_vec(&batch.discounts).iter().all(|discount| (discount - 0.729).abs() < 1e-6));
}

#[test]
fn a_full_buffer_lets_go_of_whole_episodes_the_oldest_first() {
    let config = DrqConfig { capacity: 11, ..DrqConfig::tiny() };
    let mut replay = Replay::default();
    assert!(replay.push(0, counted(5, false), &config).is_empty());
    assert!(replay.push(1, counted(4, false), &config).is_empty());
    assert_eq!(replay.push(2, counted(7, false), &config), [0]);
    assert_eq!((replay.len(), replay.numbers().collect::<Vec<_>>()), (11, vec![1, 2]));
    assert_eq!(
        replay.push(3, counted(12, false), &config),
        [1, 2],
        "one that is too large is held all the same"
    );
    assert_eq!(replay.len(), 12);
}

#[test]
fn an_episode_comes_back_from_its_bytes_and_damage_is_told() {
    let episode = counted(5, true);
    let bytes = episode.to_bytes();
    assert_eq!(Episode::from_bytes(&bytes).unwrap(), episode);
    assert!(bytes.len() < 6 * 3 * 18 * 18 / 4, "{} bytes: plain pictures are compressed", bytes.len());
    for cut in [0, 7, 20, 60, bytes.len() - 1] {
        assert!(Episode::from_bytes(&bytes[..cut]).is_err(), "cut at {cut}");
    }
    for at in 8..28 {
        let mut damaged = bytes.clone();
        damaged[at] ^= 0x81;
        if let Ok(read) = Episode::from_bytes(&damaged) {
            assert_eq!(read.len(), episode.len(), "only whether it was terminated can change: byte {at}");
        }
    }
}

/// The published augmentation as it is published: pictures padded by their edges, sampled at shifted points.
#[test]
fn a_shift_is_padding_and_bilinear_sampling() {
    let (size, pad) = (Size { height: 6, width: 6 }, 2i64);
    let picture: Vec<u8> = (0..3 * 36).map(|i| (i * 37 % 251) as u8).collect();
    let pixels = Tensor::from_slice(&picture).view([1, 6, 6, 3]).permute([0, 3, 1, 2]).to_kind(Kind::Float);
    let padded = pixels.replication_pad2d([pad; 4]);
    // Points in [-1, 1], where a pixel is 2 / 10 wide.
    let along = |shift: i64| {
        let points = (0..6).map(|i| -1.0 + 0.1 + 0.2 * (i + shift) as f32);
        points.collect::<Vec<_>>()
    };
    for [down, right] in [[0, 0], [-2, 2], [1, -1], [2, 0], [-1, -2]] {
        let (ys, xs) = (along(down + pad), along(right + pad));
        let points: Vec<f32> = ys.iter().flat_map(|y| xs.iter().flat_map(move |x| [*x, *y])).collect();
        let sampled = padded.grid_sampler(&from_slice(&points, &[1, 6, 6, 2]), 0, 0, false);
        let mut found = Vec::new();
        shifted(&picture, size, [down, right], &mut found);
        let wanted = to_vec(&sampled.permute([0, 2, 3, 1]).contiguous());
        for (found, wanted) in found.iter().zip(wanted) {
            assert!((f32::from(*found) - wanted).abs() < 1e-2, "shift {down}, {right}");
        }
    }
}

#[test]
fn a_shift_far_beyond_the_picture_shows_its_edge() {
    let picture: Vec<u8> = (0..3 * 4).collect();
    let mut found = Vec::new();
    shifted(&picture, Size { height: 1, width: 4 }, [9, 9], &mut found);
    assert_eq!(found, [9, 10, 11].repeat(4));
}

#[test]
fn what_is_cut_off_an_action_has_no_part_in_its_gradient() {
    let mean = from_slice(&[0.5, 0.9, -0.9], &[1, 3]).set_requires_grad(true);
    let action = perturbed(&mean, &from_slice(&[0.25, 0.3, -0.3], &[1, 3]));
    let found = to_vec(&action);
    assert!(
        found.iter().zip([0.75, 1.0 - 1e-6, 1e-6 - 1.0]).all(|(a, b)| (a - b as f32).abs() < 1e-6),
        "{found:?}"
    );
    (action * from_slice(&[1.0, 2.0, 3.0], &[1, 3])).sum(Kind::Float).backward();
    assert_eq!(to_vec(&mean.grad()), [1.0, 2.0, 3.0]);
}

// numpy: mean([0, 1]) + mean([1, 9]) = 5.5
#[test]
fn the_loss_is_of_both_critics() {
    let column = |values: &[f32]| from_slice(values, &[2, 1]);
    let loss = critic_loss(&[column(&[1.0, 2.0]), column(&[0.0, 4.0])], &column(&[1.0, 1.0]));
    assert_eq!(loss.double_value(&[]), 5.5);
}

fn learner(config: &DrqConfig) -> Learner {
    Learner::new(lane().spec(), config, backend(), &mut rng()).unwrap()
}

/// A batch of noise.
fn noise(config: &DrqConfig, discount: f32) -> Batch {
    let (rng, b) = (&mut rng(), config.batch as i64);
    let mut pixels = || (normal(rng, &[b, 3 * config.stack as i64, 18, 18]) * 60.0 + 128.0).clamp(0.0, 255.0);
    let (pixels, next_pixels) = (pixels().to_kind(Kind::Uint8), pixels().to_kind(Kind::Uint8));
    let actions = normal(rng, &[b, 3]).clamp(-1.0, 1.0);
    let discounts = Tensor::full([b, 1], f64::from(discount), (Kind::Float, Device::Cpu));
    Batch { pixels, rewards: normal(rng, &[b, 1]), actions, discounts, next_pixels }
}

#[test]
fn a_target_is_the_reward_and_the_smaller_of_what_both_target_critics_say_of_the_actors_action() {
    let config = DrqConfig::tiny();
    let learner = learner(&config);
    let batch = noise(&config, 0.5);
    let (_, target) = learner.told(&batch);
    // The target network begins as the critic, so the critic asked of the same picture and action says the same.
    let agent = learner.agent();
    let actions = agent.actor.forward(&agent.encoder.forward(&batch.next_pixels, Kind::Float));
    let (values, _) = learner.told(&Batch {
        pixels: batch.next_pixels.shallow_clone(),
        actions,
        rewards: batch.rewards.shallow_clone(),
        discounts: batch.discounts.shallow_clone(),
        next_pixels: batch.next_pixels.shallow_clone(),
    });
    let [one, other] = values.each_ref().map(to_vec);
    assert_ne!(one, other, "the two are not one");
    let rewards = to_vec(&batch.rewards);
    for (i, found) in to_vec(&target).into_iter().enumerate() {
        let wanted = rewards[i] + 0.5 * one[i].min(other[i]);
        assert!((found - wanted).abs() < 1e-5, "{found} is not {wanted}");
    }
}

#[test]
fn critics_learn_a_batch_by_heart() {
    let config = DrqConfig { learning_rate: 3e-3, ..DrqConfig::tiny() };
    let (mut learner, rng) = (learner(&config), &mut rng());
    let batch = noise(&config, 0.0);
    let losses: Vec<f64> =
        (0..250).map(|_| learner.update(&batch, 0.1, rng).critic.double_value(&[])).collect();
    assert!(losses[0] > 0.5 && losses[249] < 0.05 * losses[0], "{} became {}", losses[0], losses[249]);
}

#[test]
fn the_actor_comes_to_do_what_is_rewarded() {
    let config = DrqConfig { batch: 64, learning_rate: 3e-3, ..DrqConfig::tiny() };
    let batch = noise(&config, 0.0);
    let batch = Batch { rewards: batch.actions.narrow(1, 0, 1) - batch.actions.narrow(1, 2, 1), ..batch };
    let done = |learner: &Learner| {
        let agent = learner.agent();
        let actions = agent.actor.forward(&agent.encoder.forward(&batch.pixels, Kind::Float));
        to_vec(&actions.mean_dim([0i64].as_slice(), false, Kind::Float))
    };
    let mut trained = learner(&config);
    let rng = &mut rng();
    (0..300).for_each(|_| drop(trained.update(&batch, 0.2, rng)));
    let found = done(&trained);
    assert!(found[0] > 0.8 && found[2] < -0.8, "{found:?}");
}

fn run(dir: &Path, resume: bool) -> Run {
    Run::open(dir, resume).unwrap()
}

/// Learns in the lane, to the end or until so many reports.
fn learn(dir: &Path, config: &DrqConfig, resume: bool, most: usize) -> Result<Parameters, DrqError> {
    let mut n = 0;
    let job = Job { backend: backend(), run: &run(dir, resume), beside: &[] };
    train(&mut lane(), config, job, &mut |_| {
        n += 1;
        if n > most { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })
}

#[test]
fn a_job_that_was_stopped_anywhere_goes_on_as_if_it_had_not_been() {
    let dir = tempfile::tempdir().unwrap();
    let config = DrqConfig { capacity: 40, steps: 150, ..DrqConfig::tiny() };
    let (whole, halting) = (dir.path().join("whole"), dir.path().join("halting"));
    let wanted = learn(&whole, &config, false, usize::MAX).unwrap();
    let mut resume = false;
    let found = loop {
        match learn(&halting, &config, resume, 67) {
            Ok(found) => break found,
            Err(DrqError::Stopped) => resume = true,
            Err(met) => panic!("{met}"),
        }
    };
    assert!(resume, "it was stopped");
    assert_eq!(found.bytes(), wanted.bytes(), "bit for bit");
    for name in ["metrics.jsonl", "training.csv", "evaluations.csv", "curve.svg", "last.safetensors"] {
        let read = |dir: &Path| run(dir, true).read(name).unwrap().unwrap();
        assert!(read(&halting) == read(&whole), "{name}");
    }
    let kept = |dir: &Path| {
        let numbers =
            (0..60).filter(|n| run(dir, true).read(&format!("episode-{n:06}.replay")).unwrap().is_some());
        numbers.collect::<Vec<_>>()
    };
    assert_eq!(kept(&halting), kept(&whole));
    assert!(!kept(&whole).contains(&0), "what the buffer let go of has no file any more");
    let records: Vec<Record> = run(&whole, true).logged().unwrap();
    let (mut unsafe_steps, mut steps, mut evaluations) = (0, 0, Vec::new());
    for record in &records {
        match record {
            Record::Episode(one) => {
                assert!(one.steps == steps + one.n_steps && one.unsafe_steps >= unsafe_steps, "{one:?}");
                assert_eq!(one.events["grass"], one.unsafe_steps);
                (steps, unsafe_steps) = (one.steps, one.unsafe_steps);
            }
            Record::Evaluation(one) => evaluations.push((one.steps / 60, one.returns.len())),
        }
    }
    assert!(steps >= 150 && unsafe_steps > 0, "noise leaves the lane: {unsafe_steps} of {steps}");
    assert_eq!(evaluations, [(0, 2), (1, 2), (2, 2), (2, 2)], "at first, when it is due, and in the end");
}

#[test]
fn a_job_goes_on_for_longer_but_not_with_other_numbers() {
    let dir = tempfile::tempdir().unwrap();
    let config = DrqConfig { steps: 40, ..DrqConfig::tiny() };
    learn(dir.path(), &config, false, usize::MAX).unwrap();
    let other = DrqConfig { batch: 4, ..config.clone() };
    assert!(matches!(learn(dir.path(), &other, true, usize::MAX), Err(DrqError::Others)));
    let longer = DrqConfig { steps: 80, ..config };
    let agent = learn(dir.path(), &longer, true, usize::MAX).unwrap();
    let again = learn(dir.path(), &longer, true, 0).unwrap();
    assert_eq!(agent.bytes(), again.bytes(), "what is done is not done again");
}

#[test]
fn an_agent_from_its_file_acts_as_it_was_trained_and_holds_each_action() {
    let config = DrqConfig::tiny();
    let learner = learner(&config);
    let parameters = learner.agent_parameters();
    let agent = DrqAgent::load(&Parameters::from_bytes(parameters.bytes()).unwrap()).unwrap();
    assert_eq!((agent.world(), agent.config()), ("lane", &config));
    let act = |agent: &DrqAgent| {
        let (mut world, mut policy) = (lane(), DrqPolicy::new(agent));
        let mut frame = world.reset(3).unwrap();
        let mut actions = Vec::new();
        for _ in 0..6 {
            let action = policy.act(&frame).unwrap();
            actions.push(action.to_vec());
            frame = world.step(&action).unwrap().frame;
        }
        actions
    };
    let actions = act(&agent);
    // Where the processor has it, files are acted by in less precision than tests train in.
    for (found, wanted) in actions.iter().flatten().zip(act(&learner.agent()).iter().flatten()) {
        assert!((found - wanted).abs() < 0.05, "{found} is not {wanted}");
    }
    assert!(actions[0] == actions[1] && actions[2] == actions[3] && actions[0] != actions[2], "{actions:?}");

    agent.require(lane().spec()).unwrap();
    let refused = agent.require(&WorldSpec::built_in("car-racing").unwrap()).unwrap_err().to_string();
    assert!(refused.contains("\"lane\" (18 x 18)") && refused.contains("84 x 84"), "{refused}");
    assert!(DrqAgent::load(&Parameters::from_tensors([], &[])).is_err(), "no agent at all");
}

#[test]
fn actions_reach_both_ends_of_every_axis() {
    let spec = WorldSpec::built_in("car-racing").unwrap();
    let config = DrqConfig { channels: 1, features: 2, hidden: 2, ..DrqConfig::published() };
    let agent = Learner::new(&spec, &config, backend(), &mut rng()).unwrap().agent();
    assert_eq!(agent.unscaled(&[-1.0, -1.0, 0.0]), [-1.0, 0.0, 0.5]);
    assert_eq!(agent.unscaled(&[1.0, 1.0, -0.5]), [1.0, 1.0, 0.25]);
    assert_eq!(Nature::of(&spec, &config).widths().unwrap(), [35 * 35, 3]);
}

#[test]
fn a_curve_has_a_line_an_episode_and_shows_what_was_unsafe() {
    let episode = |episode: u64| {
        Record::Episode(Finished {
            episode,
            steps: 1000 * episode,
            updates: 10,
            ret: 100.0,
            n_steps: 1000,
            unsafe_steps: 300 * episode,
            events: [("grass".to_owned(), 300 * episode)].into(),
            noise: 0.5,
            critic_loss: (episode > 1).then_some(2.5),
            value: None,
        })
    };
    let evaluation = Record::Evaluation(Evaluated {
        steps: 2000,
        updates: 20,
        returns: vec![10.0, 30.0],
        ret: 20.0,
        unsafe_rate: 0.25,
        events: [("grass_rate".to_owned(), 0.25)].into(),
    });
    let records = [episode(1), episode(2), evaluation];
    let [training, evaluations] = tables(&records);
    assert_eq!(
        training.lines().collect::<Vec<_>>(),
        [
            "episode,steps,updates,return,episode_steps,noise,critic_loss,value,unsafe_steps,grass",
            "1,1000,10,100,1000,0.5,,,300,300",
            "2,2000,10,100,1000,0.5,2.5,,600,600",
        ]
    );
    assert_eq!(evaluations.lines().nth(1), Some("2000,20,2,20,10,30,0.25,0.25"));
    let beside = Beside { name: "another method".to_owned(), ret: 2749.0 };
    let svg = curve("a lane", &records, &[beside]).unwrap();
    for shown in ["<svg", "a lane", "unsafe steps so far", "another method", "2500"] {
        assert!(svg.contains(shown), "{shown}");
    }
    curve("nothing yet", &[], &[]).unwrap();
}
