//! What a labeler and a researcher feel of the world model: a dream step with its picture, and a training update.
//!
//! One thread, unless the name says another number; compare figures of one run only.

use divan::Bencher;
use dropj::dream::Dream;
use dropj::planner::{PlannerConfig, plan};
use dropj::reward::{RewardConfig, RewardEnsemble};
use dropj::tensor::adam::Adam;
use dropj::tensor::normal;
use dropj::world::{Action, Frame};
use dropj::world_model::{
    LatentState, MdnRnn, MdnRnnConfig, Next, Noise, State, Vae, VaeConfig, WorldModel, WorldModelConfig,
    actions_tensor, fast_kind, untrained,
};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use tch::nn::OptimizerConfig as _;
use tch::{Device, Kind, Tensor, nn};

fn main() {
    tch::set_num_threads(1);
    divan::main();
}

fn rng() -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(0)
}

/// One training update of 32 frames as it is usually written: channels first, single precision, torch's own Adam.
#[divan::bench(sample_count = 20)]
fn vae_update_plain(bencher: Bencher<'_, '_>) {
    let store = nn::VarStore::new(Device::Cpu);
    let (root, config) = (store.root(), VaeConfig::car_racing());
    let mut inputs = 3;
    let mut convolutions = Vec::new();
    for (i, layer) in config.encoder.iter().enumerate() {
        let shape = nn::ConvConfig { stride: layer.stride, ..nn::ConvConfig::default() };
        convolutions.push(nn::conv2d(&root / format!("in{i}"), inputs, layer.channels, layer.kernel, shape));
        inputs = layer.channels;
    }
    let n_features = inputs * 4;
    let linear =
        |name, inputs, outputs| nn::linear(&root / name, inputs, outputs, nn::LinearConfig::default());
    let heads = [linear("mean", n_features, 32), linear("log_var", n_features, 32)];
    let outwards = linear("out", 32, n_features);
    let mut deconvolutions = Vec::new();
    for (i, layer) in config.decoder.iter().enumerate() {
        let shape = nn::ConvTransposeConfig { stride: layer.stride, ..nn::ConvTransposeConfig::default() };
        let path = &root / format!("out{i}");
        deconvolutions.push(nn::conv_transpose2d(path, inputs, layer.channels, layer.kernel, shape));
        inputs = layer.channels;
    }
    let adam = nn::Adam::default().build(&store, 1e-4);
    let mut adam = adam.unwrap_or_else(|e| unreachable!("plain numbers make an optimizer: {e}"));
    let pixels = Tensor::rand([32, 3, 84, 84], (Kind::Float, Device::Cpu));
    bencher.counter(divan::counter::ItemsCount::new(32_usize)).bench_local(|| {
        let mut x = pixels.shallow_clone();
        for layer in &convolutions {
            x = x.apply(layer).relu();
        }
        let [mean, log_var] = heads.each_ref().map(|head| x.flatten(1, -1).apply(head));
        let z = &mean + (&log_var * 0.5).exp() * normal(&mut rng(), &[32, 32]);
        let mut y = z.apply(&outwards).view([32, -1, 2, 2]);
        for (i, layer) in deconvolutions.iter().enumerate() {
            y = if i == 0 { y } else { y.relu() }.apply(layer);
        }
        let reconstruction = (y.sigmoid() - &pixels).square().sum(Kind::Float) / 32.0;
        let terms: Tensor = 1.0 + &log_var - mean.square() - log_var.exp();
        let divergence = terms.sum_dim_intlist(1, false, Kind::Float) * -0.5;
        adam.backward_step(&(reconstruction + divergence.clamp_min(16.0).mean(Kind::Float)));
    });
}

/// One training update of 32 frames; items are frames.
#[divan::bench(args = ["f32", "fast"], sample_count = 20)]
fn vae_update(bencher: Bencher<'_, '_>, arithmetic: &str) {
    let kind = if arithmetic == "f32" { Kind::Float } else { fast_kind() };
    let store = nn::VarStore::new(Device::Cpu);
    let vae = Vae::new(&store.root(), VaeConfig::car_racing(), kind, &mut rng());
    let mut adam = Adam::new(&store);
    let pixels = Tensor::rand([32, 84, 84, 3], (Kind::Float, Device::Cpu));
    bencher.counter(divan::counter::ItemsCount::new(32_usize)).bench_local(|| {
        let loss = vae.loss(&pixels, &normal(&mut rng(), &[32, 32]));
        adam.step(&(loss.reconstruction + loss.divergence), 1e-4, None);
    });
}

/// One training update of 32 stretches of 250 steps; items are steps.
#[divan::bench(sample_count = 5)]
fn mdn_rnn_update(bencher: Bencher<'_, '_>) {
    let store = nn::VarStore::new(Device::Cpu);
    let mdn_rnn = MdnRnn::new(&store.root(), MdnRnnConfig::car_racing(), &mut rng());
    let mut adam = Adam::new(&store);
    let (zs, actions) = (normal(&mut rng(), &[32, 250, 32]), normal(&mut rng(), &[32, 250, 3]));
    bencher.counter(divan::counter::ItemsCount::new(32 * 250_usize)).bench_local(|| {
        adam.step(&mdn_rnn.loss(&zs, &actions, &[250; 32]), 1e-4, Some(1.0));
    });
}

/// What a dream does fifty times a second.
#[divan::bench]
fn dream_step_and_picture(bencher: Bencher<'_, '_>) {
    let model = untrained(&WorldModelConfig::car_racing(), &mut rng());
    let start = LatentState { z: vec![0.1; 32], c: vec![0.1; 256], h: vec![0.1; 256] };
    let (mut dream, mut rng) = (Dream::new(&start, 0), rng());
    bencher.bench_local(|| {
        dream.step(&model, Action::new([0.0; 3]), &mut rng).expect("numbers stay numbers");
        dream.frame(&model)
    });
}

/// Networks for obstacles, and on how many threads they run.
const OBSTACLES: [(&str, i32); 4] = [("compact", 1), ("compact", 2), ("paper", 1), ("paper", 2)];

/// A model of that size and one of its states.
fn obstacles((size, threads): (&str, i32)) -> (WorldModel, State) {
    tch::set_num_threads(threads);
    let compact = WorldModelConfig::obstacle_compact();
    let config = if size == "compact" { compact } else { WorldModelConfig::obstacle_car_racing() };
    let model = untrained(&config, &mut rng());
    let frame = Frame::square(128, vec![100u8; 3 * 128 * 128]);
    let state = State { z: model.observe(&[frame]), memory: model.no_memory(1) };
    (model, state)
}

#[divan::bench(args = OBSTACLES, sample_count = 100, sample_size = 1)]
fn obstacle_step(bencher: Bencher<'_, '_>, on: (&str, i32)) {
    let ((model, state), mut rng) = (obstacles(on), rng());
    let actions = actions_tensor(&[Action::new([0.0; 3])]);
    bencher.bench_local(|| {
        let noise = Noise::draw(1, 64, &mut rng);
        model.imagine(&state, &actions, Next::Sample { temperature: 1.0, noise: &noise })
    });
}

#[divan::bench(args = OBSTACLES, sample_count = 50, sample_size = 1)]
fn obstacle_decode(bencher: Bencher<'_, '_>, on: (&str, i32)) {
    let (model, state) = obstacles(on);
    bencher.bench_local(|| model.decode(&state.z));
}

#[divan::bench(args = OBSTACLES, sample_count = 50, sample_size = 1)]
fn obstacle_plan_15_times_15(bencher: Bencher<'_, '_>, on: (&str, i32)) {
    let ((model, state), mut rng) = (obstacles(on), rng());
    let n_features = model.config().n_features();
    let reward = RewardEnsemble::new((n_features, "sha256:0"), RewardConfig::car_racing(), &mut rng);
    let (reward, config) =
        (reward.for_inference(), PlannerConfig { horizon: 15, ..PlannerConfig::obstacle_car_racing() });
    bencher.bench_local(|| {
        plan(&model, &reward, &state, &config, None, &mut rng).expect("numbers stay numbers").chosen
    });
}
