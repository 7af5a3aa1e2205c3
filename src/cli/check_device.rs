//! `dropj check-device`.

use std::fmt::Write as _;
use std::time::Duration;

use dropj::planner::{PlannerConfig, plan};
use dropj::reward::{RewardConfig, RewardEnsemble, RewardInputs, RewardModel as _};
use dropj::tensor::adam::Adam;
use dropj::tensor::{Backend, DeviceChoice, bytes_of_frames, normal};
use dropj::world::{Action, Frame};
use dropj::world_model::fit::{FitConfig, Speed, speed};
use dropj::world_model::{
    LatentState, MdnRnn, Memory, Mixture, Next, Noise, State, Vae, WorldModelConfig, actions_tensor,
    untrained,
};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use serde_json::json;
use tch::{Device, Kind, Tensor, nn};

use super::choices::backend;
use super::fit_world::Preset;
use super::numbers::number;
use super::told::Form;

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// What to compare with the processor: auto (an accelerator, if there is one), cpu, cuda, cuda:N or mps
    #[arg(long, default_value = "auto")]
    device: DeviceChoice,
    /// The networks' sizes
    #[arg(long, value_enum, default_value = "obstacle-car-racing")]
    preset: Preset,
    /// How long to train each network for its speed; with 0 nothing is trained
    #[arg(long, value_parser = number(0.0..=3600.0), default_value = "10")]
    seconds: f64,
    /// Pictures, or stretches, in an update
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=4096), default_value = "128")]
    batch: u16,
    #[command(flatten)]
    form: Form,
}

/// Pictures, or stretches, that are compared.
const BATCH: i64 = 4;
/// Dreamed steps.
const STEPS: i64 = 50;
/// Updates of a fit that is compared.
const UPDATES: usize = 8;

/// What one device makes of the problem: names and tensors.
type Made = Vec<(&'static str, Tensor)>;

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    let backend = backend(options.device)?;
    if options.device == DeviceChoice::Auto && backend.is_cpu() {
        return options.form.tell(&json!({"device": null}), || {
            "there is no accelerator that this program can compute on, and so nothing to compare".to_owned()
        });
    }
    let config = options.preset.config();
    let mut words =
        format!("{:<52} {:>10} {:>10}\n", format!("{backend} beside the processor"), "apart", "allowed");
    let mut compared = Vec::new();
    let exact = Backend { kind: Kind::Float, ..backend };
    let processor = made(Backend { device: Device::Cpu, kind: Kind::Float }, &config);
    let mut worst = Vec::new();
    // Accelerators round the factors of products to ten bits (TF32), and in training to seven (bfloat16).
    for (how, backend, tolerances) in
        [("single precision", exact, [5e-3, 3e-2, 5e-3]), ("as trained", backend, [5e-2, 5e-2, 2e-2])]
    {
        for ((what, found), (_, wanted)) in made(backend, &config).iter().zip(&processor) {
            let allowed = match *what {
                what if what.contains("gradient") => tolerances[1],
                what if what.contains("loss") => tolerances[2],
                _ => tolerances[0],
            };
            let apart = apart(found, wanted);
            writeln!(words, "{:<52} {apart:>10.2e} {allowed:>10.0e}", format!("{what}, {how}"))?;
            compared.push(json!({"what": what, "how": how, "apart": apart, "allowed": allowed}));
            if apart.is_nan() || apart > allowed {
                worst.push(format!("{what}, {how}"));
            }
        }
    }
    if !worst.is_empty() {
        options.form.tell(&json!({"device": backend.to_string(), "compared": compared}), || words)?;
        anyhow::bail!("{backend} computes something else than the processor: {}", worst.join("; "));
    }
    let mut trained = serde_json::Value::Null;
    if options.seconds > 0.0 {
        let mut fit = FitConfig::full();
        (fit.vae.batch, fit.mdn_rnn.batch) = (usize::from(options.batch), usize::from(options.batch));
        let Speed { pictures, steps, steps_in_full } =
            speed(&config, &fit, backend, Duration::from_secs_f64(options.seconds));
        trained = json!({"pictures_per_second": pictures, "steps_per_second": steps, "steps_in_full": steps_in_full});
        writeln!(words, "vision: {pictures:.0} pictures a second, {} in an update", options.batch)?;
        writeln!(
            words,
            "memory: {steps:.0} steps a second, {steps_in_full:.0} in single precision, {} stretches of {} in an update",
            options.batch, fit.window
        )?;
    }
    options
        .form
        .tell(&json!({"device": backend.to_string(), "compared": compared, "training": trained}), || words)
}

/// The largest difference, in parts of the largest of the wanted numbers.
fn apart(found: &Tensor, wanted: &Tensor) -> f64 {
    let found = found.to_device(Device::Cpu).to_kind(Kind::Double);
    let wanted = wanted.to_device(Device::Cpu).to_kind(Kind::Double);
    let largest = |tensor: &Tensor| tensor.abs().max().double_value(&[]);
    largest(&(found - &wanted)) / largest(&wanted).max(1e-12)
}

/// The gradient of `loss` by all variables of `store`, in the order of their names.
fn gradient(loss: &Tensor, store: &nn::VarStore) -> Tensor {
    let mut variables: Vec<_> = store.variables().into_iter().collect();
    variables.sort_by(|(one, _), (other, _)| one.cmp(other));
    let variables: Vec<_> = variables.into_iter().map(|(_, variable)| variable).collect();
    let gradients = Tensor::run_backward(&[loss], &variables, true, false);
    Tensor::cat(&gradients.iter().map(|gradient| gradient.reshape([-1])).collect::<Vec<_>>(), 0)
}

/// What `backend` makes of the same parameters and inputs.
fn made(backend: Backend, config: &WorldModelConfig) -> Made {
    let rng = &mut ChaCha8Rng::seed_from_u64(0);
    let there = |tensor: Tensor| tensor.to_device(backend.device);
    let (latent, height, width) = (config.vae.latent, config.vae.height, config.vae.width);
    let mut made = Made::new();

    let store = nn::VarStore::new(backend.device);
    let vae = Vae::new(&store.root(), config.vae.clone(), backend.kind, rng);
    let pixels = there((normal(rng, &[BATCH, height, width, 3]) * 0.2 + 0.5).clamp(0.0, 1.0));
    let mut noise = || there(normal(rng, &[BATCH, latent]));
    let (mean, log_var) = tch::no_grad(|| vae.encode(&pixels));
    made.push(("vision, latents", Tensor::cat(&[mean, log_var], 1)));
    let first = noise();
    made.push(("vision, pictures", tch::no_grad(|| vae.decode(&first))));
    let loss = vae.loss(&pixels, &first);
    let loss = loss.reconstruction + loss.divergence;
    made.push(("vision, gradient", gradient(&loss, &store)));
    made.push(("vision, loss", loss.detach()));
    // Not a rate at which what is rounded otherwise would be taken elsewhere.
    let mut adam = Adam::new(&store);
    for _ in 0..UPDATES {
        let loss = vae.loss(&pixels, &noise());
        adam.step(&(loss.reconstruction + loss.divergence), 1e-4, None);
    }
    let loss = tch::no_grad(|| vae.loss(&pixels, &first));
    made.push(("vision, loss after a few updates", loss.reconstruction + loss.divergence));
    drop((vae, store));

    let rng = &mut ChaCha8Rng::seed_from_u64(1);
    let store = nn::VarStore::new(backend.device);
    let mdn_rnn = MdnRnn::new(&store.root(), config.mdn_rnn.clone(), rng);
    let zs = there(normal(rng, &[BATCH, STEPS, latent]));
    let actions = there(normal(rng, &[BATCH, STEPS, config.mdn_rnn.actions]));
    let lens = there(Tensor::from_slice(&[STEPS, STEPS, STEPS, STEPS / 2]));
    // The recurrent arithmetic of training goes with that of vision.
    let kind = if backend.kind == Kind::Float { Kind::Float } else { backend.recurrent_kind() };
    let loss = mdn_rnn.loss_in(kind, &zs, &actions, &lens);
    made.push(("memory, gradient", gradient(&loss, &store)));
    made.push(("memory, loss", loss.detach()));
    let dreamed = |next: &dyn Fn(&Mixture, i64) -> Tensor| {
        let nothing = || Tensor::zeros([BATCH, config.mdn_rnn.memory], (Kind::Float, backend.device));
        let (mut z, mut memory) = (zs.select(1, 0), Memory { c: nothing(), h: nothing() });
        for t in 0..STEPS {
            memory = mdn_rnn.remember(&z, &actions.select(1, t), &memory);
            z = next(&mdn_rnn.mixture(&memory.h), t);
        }
        Tensor::cat(&[&z, &memory.c, &memory.h], 1)
    };
    let features = tch::no_grad(|| dreamed(&|mixture, _| mixture.mean(0.1)));
    // Always from the first component, for a rounding could choose another.
    let first = || there(Tensor::zeros([BATCH, latent], (Kind::Float, Device::Cpu)));
    let noises: Vec<_> = (0..STEPS)
        .map(|_| Noise { uniform: first(), normal: there(normal(rng, &[BATCH, latent])) })
        .collect();
    let drawn = tch::no_grad(|| dreamed(&|mixture, t| mixture.sample(1.0, &noises[t as usize])));
    let reward = RewardEnsemble::new((config.n_features(), "none"), RewardConfig::car_racing(), rng);
    let reward = reward.in_kind(backend.kind).on(backend);
    let scores = reward.rewards(&features, &actions.select(1, 0));
    made.push(("imagination, after 50 steps", features));
    made.push(("imagination, after 50 drawn steps", drawn));
    made.push(("reward", scores));
    let mut adam = Adam::new(&store);
    for _ in 0..UPDATES {
        adam.step(&mdn_rnn.loss_in(kind, &zs, &actions, &lens), 1e-4, Some(1.0));
    }
    let loss = tch::no_grad(|| mdn_rnn.loss_in(kind, &zs, &actions, &lens));
    made.push(("memory, loss after a few updates", loss));
    made.extend(used(backend, config));
    made
}

/// The same of a world model and a reward as the commands use them: what is given lies with the processor.
fn used(backend: Backend, config: &WorldModelConfig) -> Made {
    let rng = &mut ChaCha8Rng::seed_from_u64(2);
    let model = untrained(config, rng).on(backend).unwrap_or_else(|e| unreachable!("just made: {e}"));
    let frames = vec![Frame::new(
        config.vae.height as u32,
        config.vae.width as u32,
        (0..3 * config.vae.height * config.vae.width).map(|i| (i % 251) as u8).collect::<Vec<_>>(),
    )];
    let state = State { z: model.observe(&frames), memory: model.no_memory(1) };
    let neutral = Action::new(model.spec().neutral());
    // As plain data, which comes from the processor. No draw, for a rounding could choose another component.
    let state = State::from(&LatentState::from(&state));
    let next = model.imagine(&state, &actions_tensor(&[neutral]), Next::Mean { temperature: 0.1 });
    let painted = bytes_of_frames(&model.decode(&next.z)).to_kind(Kind::Float);
    let reward = RewardEnsemble::new(RewardInputs::of(&model), RewardConfig::car_racing(), rng).on(backend);
    let planner = PlannerConfig::of_model(&model);
    let plan = plan(&model, &reward.for_inference(), &next, &planner, None, rng);
    let plan = plan.unwrap_or_else(|e| unreachable!("networks as drawn make numbers: {e}"));
    let returns: Vec<f32> = plan.candidates.iter().map(|candidate| candidate.predicted_return).collect();
    vec![
        ("a dreamed state", next.features()),
        ("a dreamed picture", painted),
        ("the returns of a plan", Tensor::from_slice(&returns)),
    ]
}
