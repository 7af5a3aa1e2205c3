//! What `assets/FORMAT.md` says of the shipped files, computed from them by plain loops.

use dropj::reward::{RewardEnsemble, RewardModel as _, scaled_actions_tensor};
use dropj::session::arrays::dream_from_bytes;
use dropj::tensor::container::Container;
use dropj::tensor::{Parameters, from_slice, to_vec};
use dropj::world::{ActionRanges, Frame};
use dropj::world_model::{LatentState, Next, State, WorldModel, actions_tensor};

use crate::program::shipped;

const WORLD: &str = "assets/world-car-racing.safetensors";
const DREAM: &str = "sessions/example/dreams/0000.safetensors";
const REWARD: &str = "sessions/example/reward/0000.safetensors";

/// The numbers that the page tells.
const REWARDS: [f32; 3] = [-0.059_80, -0.061_63, -0.036_92];
const MEAN_REWARD: f32 = 0.051_90;
const COLORS: [f32; 3] = [0.405_60, 0.712_66, 0.400_46];
const LATENTS_OF_BLACK: [f32; 4] = [0.190_11, -0.220_53, -1.188_55, -1.159_65];
const IMAGINED: [f32; 4] = [0.191_16, -0.085_38, -1.430_19, 0.208_42];

fn read(path: &str) -> Vec<u8> {
    std::fs::read(shipped(path)).unwrap()
}

/// A tensor as numbers and sizes.
fn tensor(file: &Container<'_>, name: &str) -> (Vec<f32>, Vec<usize>) {
    let entry = file.entry(name).unwrap();
    (file.floats(entry).unwrap(), entry.shape.clone())
}

/// `W x + b` of a layer that lies as `[out, in]`.
fn linear(weight: &[f32], bias: &[f32], x: &[f32]) -> Vec<f32> {
    let rows = weight.chunks_exact(x.len()).zip(bias);
    rows.map(|(row, b)| row.iter().zip(x).map(|(w, x)| w * x).sum::<f32>() + b).collect()
}

fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// The features `[z | c | h]` of the first `n` steps of the dream.
fn features(world: &Container<'_>, dream: &Container<'_>, n: usize) -> Vec<Vec<f32>> {
    let lstm = |name: &str| tensor(world, &format!("mdn_rnn.lstm.{name}")).0;
    let [w_ih, w_hh, b_ih, b_hh] = ["weight_ih", "weight_hh", "bias_ih", "bias_hh"].map(lstm);
    let (zs, shape) = tensor(dream, "zs");
    let (actions, _) = tensor(dream, "actions");
    let (mut c, mut h) = (tensor(dream, "start.c").0, tensor(dream, "start.h").0);
    let mut rows = Vec::new();
    for (z, a) in zs.chunks_exact(shape[1]).zip(actions.chunks_exact(3)).take(n) {
        rows.push([z, &c, &h].concat());
        let (of_input, of_output) = (linear(&w_ih, &b_ih, &[z, a].concat()), linear(&w_hh, &b_hh, &h));
        let gates: Vec<f32> = of_input.iter().zip(&of_output).map(|(a, b)| a + b).collect();
        let m = c.len();
        for j in 0..m {
            let [i, f, g, o] = [0, 1, 2, 3].map(|gate| gates[gate * m + j]);
            c[j] = sigmoid(f) * c[j] + sigmoid(i) * g.tanh();
            h[j] = sigmoid(o) * c[j].tanh();
        }
    }
    rows
}

/// The reward of one action in a state with these features.
fn reward(file: &Container<'_>, features: &[f32], action: &[f32]) -> f32 {
    let scaled = [action[0], 2.0 * action[1] - 1.0, 2.0 * action[2] - 1.0];
    let n_layers = file.entries.len() / 2;
    let (_, shape) = tensor(file, "reward.0.weight");
    let members = shape[0];
    let mut sum = 0.0;
    for e in 0..members {
        let mut x = [features, &scaled].concat();
        for i in 0..n_layers {
            let of_member = |part: &str| {
                let (values, shape) = tensor(file, &format!("reward.{i}.{part}"));
                let n: usize = shape[1..].iter().product();
                values[e * n..(e + 1) * n].to_vec()
            };
            x = linear(&of_member("weight"), &of_member("bias"), &x);
            let is_last = i + 1 == n_layers;
            for x in &mut x {
                *x = if is_last { x.tanh() } else { x.max(0.01 * *x) };
            }
        }
        sum += x[0];
    }
    sum / members as f32
}

fn assert_close(found: &[f32], wanted: &[f32], within: f32) {
    let apart = found.iter().zip(wanted).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(found.len() == wanted.len() && apart <= within, "{found:?} is not {wanted:?}");
}

#[test]
fn a_reward_is_what_the_page_on_formats_says() {
    let [world, dream, learned] = [WORLD, DREAM, REWARD].map(read);
    let [world_file, dream_file, reward_file] =
        [&world, &dream, &learned].map(|b| Container::read(b).unwrap());
    let n = 12;
    let (actions, _) = tensor(&dream_file, "actions");
    let rows = features(&world_file, &dream_file, n);
    let by_hand: Vec<f32> = rows
        .iter()
        .zip(actions.chunks_exact(3))
        .map(|(features, action)| reward(&reward_file, features, action))
        .collect();

    let model = WorldModel::load(Parameters::from_bytes(world.clone()).unwrap()).unwrap();
    let episode = dream_from_bytes(&dream).unwrap();
    let kept = episode.features(&model);
    assert_close(&kept.values[..n * kept.width], &rows.concat(), 1e-4);
    let ensemble = RewardEnsemble::load(&Parameters::from_bytes(learned.clone()).unwrap()).unwrap();
    let all = from_slice(&kept.values, &[400, -1]);
    let scaled = scaled_actions_tensor(&episode.actions, &ActionRanges::default());
    let rewards = to_vec(&ensemble.in_kind(tch::Kind::Float).rewards(&all, &scaled));
    assert_close(&rewards[..n], &by_hand, 1e-5);
    assert_close(&rewards[..3], &REWARDS, 1e-5);
    assert_close(&[rewards.iter().sum::<f32>() / 400.0], &[MEAN_REWARD], 1e-5);
}

#[test]
fn a_world_model_is_what_the_page_on_formats_says() {
    let model = WorldModel::load(Parameters::from_bytes(read(WORLD)).unwrap()).unwrap();
    let episode = dream_from_bytes(&read(DREAM)).unwrap();
    let picture = episode.frames(&model, 0..1).remove(0);
    let color = |i: usize| {
        let values = picture.rgb().iter().skip(i).step_by(3);
        values.map(|v| f32::from(*v) / 255.0).sum::<f32>() / (84.0 * 84.0)
    };
    // Pictures may be drawn in bf16, and are of whole bytes.
    assert_close(&[color(0), color(1), color(2)], &COLORS, 4e-3);
    let black = to_vec(&model.observe(&[Frame::square(84, vec![0; 3 * 84 * 84])]));
    assert_close(&black[..4], &LATENTS_OF_BLACK, 1e-4);
    let state = State::from(&episode.start);
    let next = Next::Mean { temperature: 0.1 };
    let next = model.imagine(&state, &actions_tensor(&episode.actions[..1]), next);
    assert_close(&LatentState::from(&next).z[..4], &IMAGINED, 1e-4);
}

#[test]
fn the_page_on_formats_tells_the_numbers_that_are_tested() {
    let page = std::fs::read_to_string(shipped("assets/FORMAT.md")).unwrap();
    let numbers =
        REWARDS.iter().chain([&MEAN_REWARD]).chain(&COLORS).chain(&LATENTS_OF_BLACK).chain(&IMAGINED);
    for number in numbers {
        let text = format!("{number:.5}").replace('-', "−");
        assert!(page.contains(&text), "{text} is on it");
    }
}
