//! Fitting the probe: pictures of the real world, and what they show from whoever knows.
//!
//! Of the built-in cars that is their simulator, which is driven for it; of any other world its recordings.
//! Where a world model is given the probe learns from its paintings of the same moments, too, painted from *drawn*
//! latents, because those are what dreams show.

mod car;
mod events;

use std::ops::ControlFlow;

use rand::seq::SliceRandom as _;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use tch::{Device, Kind, Reduction, Tensor, nn};

use super::probe::{Net, ProbeConfig, Reads};
use crate::tensor::adam::Adam;
use crate::tensor::limits::{MAX_COUNT, OutOfRange, within};
use crate::tensor::{Backend, NotFinite, Parameters, from_frames_on, from_slice, normal, require_finite};
use crate::world::{Frame, WorldSpec};
use crate::world_model::{Encoder, Vae, WorldModel};

pub use car::fit_car_probe;
pub use events::{EventError, EventErrors, FitProbeError, fit_event_probe};

/// Share of pictures that are shown without the one before.
const STILL: f64 = 0.15;
/// Pictures that are painted together.
const PAINTED: usize = 64;
/// Seconds from one example of a recording to the next, on average.
const STRIDE_SECS: f64 = 0.16;

/// How a probe is fitted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FitProbeConfig {
    /// The network.
    pub probe: ProbeConfig,
    /// Of everything drawn.
    pub seed: u64,
    /// Episodes to fit on: those of a car are driven, those of recordings are as many as there are, up to this.
    pub n_episodes: usize,
    /// Further episodes that the errors are measured on.
    pub n_held_out: usize,
    /// Steps from one example to the next, on average. Of a car at least 6.
    pub stride: usize,
    /// Share of the examples that are also painted by the world model, in `[0, 1]`.
    pub painted: f64,
    /// Updates.
    pub n_updates: usize,
    /// Examples in an update.
    pub batch: usize,
    /// Learning rate at the start. It falls to zero along a cosine.
    pub learning_rate: f64,
}

impl FitProbeConfig {
    /// What suits a world: for a built-in car what made the probes that are shipped, in some minutes on one core; else what
    /// suits [recordings](Self::for_recordings).
    pub fn for_world(spec: &WorldSpec) -> Self {
        let probe = ProbeConfig::for_world(spec);
        if matches!(probe.reads, Reads::Events(_)) {
            return Self::for_recordings(spec);
        }
        Self {
            probe,
            seed: 0,
            n_episodes: 160,
            n_held_out: 12,
            stride: 8,
            painted: 0.7,
            n_updates: 6000,
            batch: 64,
            learning_rate: 2e-3,
        }
    }

    /// What suits recordings of a world: its events are read, and examples are about 0.16 s apart.
    pub fn for_recordings(spec: &WorldSpec) -> Self {
        Self {
            probe: ProbeConfig::of_size(spec.image.trained(), ProbeConfig::events_of(spec)),
            seed: 0,
            n_episodes: 100_000,
            n_held_out: 40,
            stride: ((STRIDE_SECS * spec.rate).round() as usize).clamp(1, 1000),
            painted: 0.7,
            n_updates: 4000,
            batch: 64,
            learning_rate: 2e-3,
        }
    }

    /// Fails where no probe can be fitted so.
    pub fn check(&self) -> Result<(), OutOfRange> {
        self.probe.check()?;
        let is_car = matches!(self.probe.reads, Reads::Car { .. });
        let episodes = if is_car { "driven" } else { "read" };
        within(&format!("the number of episodes that are {episodes}"), self.n_episodes, 2..=100_000)?;
        within("the number of episodes that are held out", self.n_held_out, 1..=100_000)?;
        within("the number of steps between examples", self.stride, if is_car { 6 } else { 1 }..=1000)?;
        within("the share of examples that is painted", self.painted, 0.0..=1.0)?;
        within("the number of the probe's updates", self.n_updates, 1..=MAX_COUNT)?;
        within("the number of examples in an update", self.batch, 1..=MAX_COUNT)?;
        within("the probe's learning rate", self.learning_rate, 0.0..=1e3)
    }
}

/// What a fit is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// Episodes are driven.
    Drive,
    /// Recorded episodes are read.
    Read,
    /// The world model paints.
    Paint,
    /// The network learns.
    Learn,
}

/// Where a fit stands.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Progress {
    /// What it does.
    pub phase: Phase,
    /// Episodes, pictures or updates done.
    pub done: usize,
    /// How many there are.
    pub n: usize,
    /// Running mean of the loss. 0 before the network learns.
    pub loss: f64,
}

/// Whoever is told where a fit stands, and may break it off.
type Report<'a> = dyn FnMut(Phase, usize, usize, f64) -> ControlFlow<()> + 'a;

/// A fitted probe and how good it is.
#[derive(Clone, Debug)]
pub struct ProbeFit<E> {
    /// What [`Probe::load`](super::Probe::load) takes. The header tells the errors.
    pub parameters: Parameters,
    /// On real pictures.
    pub real: E,
    /// On the world model's paintings.
    pub painted: Option<E>,
}

/// A moment: the picture of some steps before, the present one, and what they show.
#[derive(Clone, Debug)]
struct Example<S> {
    earlier: Frame,
    now: Frame,
    shown: S,
}

/// Some of the numbers that come out, one beside the other, and how they are learned.
#[derive(Clone, Debug)]
struct Group {
    from: usize,
    n: usize,
    kind: GroupKind,
    /// What its part of the loss counts.
    weight: f64,
}

/// How numbers are learned.
#[derive(Clone, Debug)]
enum GroupKind {
    /// As logits, by cross-entropy; what is, counts as many times as these say, if they do.
    Chances(Option<Vec<f32>>),
    /// As values, by absolute errors that are smoothed below this, where they count.
    Values(f64),
}

/// What the numbers of a picture should be.
#[derive(Clone, Debug, Default)]
struct Targets {
    values: Vec<f32>,
    /// 1 where a value counts, else 0. Chances always count.
    counts: Vec<f32>,
}

/// What is learned.
trait Lesson<S> {
    /// The numbers that come out.
    fn groups(&self) -> Vec<Group>;

    /// What they should be where this is shown, of all groups together.
    fn targets(&self, shown: &S, is_mirrored: bool, is_still: bool) -> Targets;

    /// Whether the mirror image of a picture shows something of the kind, too.
    fn has_mirror_images(&self) -> bool;
}

/// A world model that paints what it sees as a dream would show it.
struct Painter<'a> {
    model: &'a WorldModel,
    encoder: Encoder,
}

impl<'a> Painter<'a> {
    fn new(model: &'a WorldModel) -> Self {
        let mut store = nn::VarStore::new(Device::Cpu);
        let config = model.config().vae.clone();
        let vae = Vae::new(&store.root(), config.clone(), Kind::Float, &mut ChaCha8Rng::seed_from_u64(0));
        let layout = model.identity().layout();
        let loaded = model.parameters().fill("vae", &config.slots(), layout, &store);
        loaded.unwrap_or_else(|e| unreachable!("the model was loaded from them: {e}"));
        let Backend { device, kind } = model.backend();
        if device != Device::Cpu {
            store.set_device(device);
        }
        Self { model, encoder: vae.encoder.for_inference(kind) }
    }

    /// The same moments in paint.
    fn paint<S: Clone>(&self, examples: &[Example<S>], rng: &mut ChaCha8Rng) -> Vec<Example<S>> {
        let mut painted = Vec::with_capacity(examples.len());
        for some in examples.chunks(PAINTED) {
            let earlier: Vec<_> = some.iter().map(|example| example.earlier.clone()).collect();
            let now: Vec<_> = some.iter().map(|example| example.now.clone()).collect();
            let (earlier, now) = (self.repaint(&earlier, rng), self.repaint(&now, rng));
            let pairs = earlier.into_iter().zip(now).zip(some);
            painted.extend(pairs.map(|((earlier, now), e)| Example { earlier, now, shown: e.shown.clone() }));
        }
        painted
    }

    /// The pictures as they are painted from latents that are drawn.
    fn repaint(&self, frames: &[Frame], rng: &mut ChaCha8Rng) -> Vec<Frame> {
        let (mean, log_var) =
            tch::no_grad(|| self.encoder.encode(&from_frames_on(self.model.backend().device, frames)));
        let z = &mean + (log_var * 0.5).exp() * normal(rng, &mean.size()).to_device(mean.device());
        self.model.decode(&z)
    }
}

/// Trains a fresh network on `examples`.
fn learn<S>(
    config: &FitProbeConfig,
    lesson: &dyn Lesson<S>,
    examples: &[Example<S>],
    device: Device,
    report: &mut dyn FnMut(usize, f64) -> ControlFlow<()>,
) -> Result<nn::VarStore, NotFinite> {
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    let mut store = nn::VarStore::new(Device::Cpu);
    // Drawn by the seed alone, wherever it is trained.
    let net = Net::new(&store.root(), config.probe.clone(), &mut rng);
    if device != Device::Cpu {
        store.set_device(device);
    }
    let mut adam = Adam::new(&store);
    let mut order: Vec<usize> = Vec::new();
    let mut mean_loss = 0.0;
    for update in 0..config.n_updates {
        if order.len() < config.batch {
            order = (0..examples.len()).collect();
            order.shuffle(&mut rng);
        }
        let chosen = order.split_off(order.len().saturating_sub(config.batch));
        let batch: Vec<_> = chosen.into_iter().map(|i| &examples[i]).collect();
        if batch.is_empty() {
            break;
        }
        let done = update as f64 / config.n_updates as f64;
        // A short climb at the start, then down along a cosine.
        let climb = ((update + 1) as f64 / 100.0).min(1.0);
        let rate = config.learning_rate * climb * 0.5 * (1.0 + (std::f64::consts::PI * done).cos());
        let loss = loss(&net, lesson, &batch, &mut rng);
        let value = loss.double_value(&[]);
        if !value.is_finite() {
            return Err(NotFinite(format!("the loss of the probe at update {}", update + 1)));
        }
        adam.step(&loss, rate, Some(0.1));
        let share = 1.0 / (update + 1).min(200) as f64;
        mean_loss += share * (value - mean_loss);
        if report(update + 1, mean_loss).is_break() {
            break;
        }
    }
    require_finite(&store, "the probe")?;
    Ok(store)
}

/// The loss on a batch: cross-entropy for what is or is not, absolute errors (smoothed) for what is measured.
///
/// One half of the pictures is mirrored, where that makes sense, and all are a little brighter or darker than they were.
fn loss<S>(net: &Net, lesson: &dyn Lesson<S>, batch: &[&Example<S>], rng: &mut ChaCha8Rng) -> Tensor {
    let b = batch.len();
    let n_mirrored = if lesson.has_mirror_images() { b / 2 } else { 0 };
    let (mut earlier, mut now, mut targets) = (vec![], vec![], vec![]);
    for (i, example) in batch.iter().enumerate() {
        let is_still = rng.random_bool(STILL);
        earlier.push(if is_still { example.now.clone() } else { example.earlier.clone() });
        now.push(example.now.clone());
        targets.push(lesson.targets(&example.shown, i < n_mirrored, is_still));
    }
    let device = net.device();
    let light: Tensor = 1.0 + 0.04 * normal(rng, &[b as i64, 1, 1, 1]);
    let shade: Tensor = 0.02 * normal(rng, &[b as i64, 1, 1, 1]);
    let [earlier, now] = [earlier, now].map(|frames| {
        let pixels = from_frames_on(device, &frames) * light.to_device(device) + shade.to_device(device);
        if n_mirrored == 0 {
            return pixels;
        }
        let (half, rest) = (n_mirrored as i64, (b - n_mirrored) as i64);
        Tensor::cat(&[pixels.narrow(0, 0, half).flip([2]), pixels.narrow(0, half, rest)], 0)
    });
    let outputs = net.forward(&earlier, &now);
    let of = |group: &Group, part: fn(&Targets) -> &Vec<f32>| {
        let all = targets.iter().flat_map(|targets| &part(targets)[group.from..group.from + group.n]);
        from_slice(&all.copied().collect::<Vec<_>>(), &[b as i64, group.n as i64]).to_device(device)
    };
    let losses = lesson.groups().into_iter().filter(|group| group.n > 0).map(|group| {
        let found = outputs.narrow(1, group.from as i64, group.n as i64);
        let wanted = of(&group, |targets| &targets.values);
        let loss = match &group.kind {
            GroupKind::Chances(counts) => {
                let counts =
                    counts.as_ref().map(|counts| from_slice(counts, &[group.n as i64]).to_device(device));
                found.binary_cross_entropy_with_logits(&wanted, None::<Tensor>, counts, Reduction::Mean)
            }
            GroupKind::Values(smooth) => {
                let wrong = found.smooth_l1_loss(&wanted, Reduction::None, *smooth);
                (wrong * of(&group, |targets| &targets.counts)).mean(Kind::Float)
            }
        };
        loss * group.weight
    });
    losses.reduce(|sum, loss| sum + loss).unwrap_or_else(|| outputs.sum(Kind::Float) * 0.0)
}

/// The area under the curve of true against false alarms: the rank sum of the positives. ½ where one side is empty.
fn auc(scored: &[(bool, f32)]) -> f64 {
    let mut sorted = scored.to_vec();
    sorted.sort_by(|a, b| a.1.total_cmp(&b.1));
    let n_positive = sorted.iter().filter(|(is, _)| *is).count();
    let n_negative = sorted.len() - n_positive;
    if n_positive == 0 || n_negative == 0 {
        return 0.5;
    }
    let ranks: usize = sorted.iter().enumerate().filter(|(_, (is, _))| *is).map(|(rank, _)| rank + 1).sum();
    (ranks - n_positive * (n_positive + 1) / 2) as f64 / (n_positive * n_negative) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_area_is_one_where_all_positives_stand_above() {
        assert_eq!(auc(&[(true, 0.9), (false, 0.1), (true, 0.8), (false, 0.2)]), 1.0);
        assert_eq!(auc(&[(true, 0.1), (false, 0.9)]), 0.0);
        assert_eq!(auc(&[]), 0.5);
    }
}
