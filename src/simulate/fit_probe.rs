//! Fitting the probe: pictures from fresh simulation, what they show from the simulator itself.
//!
//! Where a world model is given the probe learns from its paintings of the same moments, too, painted from *drawn*
//! latents, because those are what dreams show.

use std::ops::ControlFlow;

use rand::seq::SliceRandom as _;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use tch::{Device, Kind, Reduction, Tensor, nn};

use super::pilot::ScriptedPilot;
use super::player::explorer;
use super::probe::{CONTACTS, GAP, N_MEASURED, Net, Probe, ProbeConfig, Sight};
use crate::env::{Env, Frame, Seed};
use crate::tensor::adam::Adam;
use crate::tensor::limits::{MAX_COUNT, OutOfRange, within};
use crate::tensor::{NotFinite, Parameters, from_frames, from_slice, normal, require_finite};
use crate::world_model::{Vae, WorldModel, fast_kind};

/// The first worlds that the probe is fitted on. Evaluations and recordings use smaller seeds.
const FIRST_WORLD: u64 = 7_000_000;
/// The steps in which the camera still zooms in, which dreams never show.
const ZOOM_STEPS: usize = 55;
/// Share of pictures that are shown without the one before.
const STILL: f64 = 0.15;
/// Pictures that are painted together.
const PAINTED: usize = 64;

/// How a probe is fitted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FitProbeConfig {
    /// The network.
    pub probe: ProbeConfig,
    /// Of everything drawn.
    pub seed: u64,
    /// Episodes that are driven to fit on.
    pub n_episodes: usize,
    /// Further episodes that the errors are measured on.
    pub n_held_out: usize,
    /// Steps from one example to the next, on average. At least 6.
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
    /// What made the probe that is shipped: some minutes on one core.
    pub fn car_racing() -> Self {
        Self {
            probe: ProbeConfig::car_racing(),
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

    /// The same for the world with obstacles.
    pub fn obstacle_car_racing() -> Self {
        Self { probe: ProbeConfig::obstacle_car_racing(), ..Self::car_racing() }
    }

    /// Fails where no probe can be fitted so.
    pub fn check(&self) -> Result<(), OutOfRange> {
        self.probe.check()?;
        within("the number of episodes that are driven", self.n_episodes, 2..=100_000)?;
        within("the number of episodes that are held out", self.n_held_out, 1..=100_000)?;
        within("the number of steps between examples", self.stride, 6..=1000)?;
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

/// How wrong a probe is on moments that it was not fitted on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ProbeErrors {
    /// Moments.
    pub n: usize,
    /// Share of them with a wheel off the road.
    pub off_road_share: f64,
    /// Share told rightly: whether a wheel is off the road.
    pub off_road_accuracy: f64,
    /// Probability that a moment off the road looks more so than one on it.
    pub off_road_auc: f64,
    /// Share told rightly: whether all wheels are.
    pub all_off_accuracy: f64,
    /// Mean absolute error of the lateral offset in units.
    pub lateral: f64,
    /// Of the heading in radians.
    pub heading: f64,
    /// Of the velocity along the road in units a second.
    pub along: f64,
    /// Of the velocity across the road in units a second.
    pub across: f64,
    /// Of the three bends ahead in radians.
    pub bends: [f64; 3],
    /// Share of them with a wheel in a chuckhole, and probability that such a moment looks more so than another.
    pub chuckhole: [f64; 2],
    /// The same for touching another car.
    pub car: [f64; 2],
}

/// A fitted probe and how good it is.
#[derive(Clone, Debug)]
pub struct ProbeFit {
    /// What [`Probe::load`] takes. The header tells the errors.
    pub parameters: Parameters,
    /// On real pictures.
    pub real: ProbeErrors,
    /// On the world model's paintings.
    pub painted: Option<ProbeErrors>,
}

/// A moment: the picture of [`GAP`] steps before, the present one, and what they show.
#[derive(Clone, Debug)]
struct Example {
    earlier: Frame,
    now: Frame,
    shown: Sight,
}

impl Example {
    /// Whether the picture tells where the road leads: against its direction, nothing does.
    fn tells_direction(&self) -> bool {
        self.shown.heading_error.cos() > -0.2
    }
}

/// Fits a probe on episodes of `env`. Where `report` breaks off, on what has been seen until then.
///
/// It ends at the first loss that is no number.
pub fn fit_probe(
    config: &FitProbeConfig,
    env: &mut dyn Env,
    model: Option<&WorldModel>,
    report: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
) -> Result<ProbeFit, NotFinite> {
    let mut tell = |phase, done, n, loss| report(&Progress { phase, done, n, loss });
    let n = config.n_episodes + config.n_held_out;
    let (mut seen, mut held_out) = (Vec::new(), Vec::new());
    for i in 0..n {
        // The held-out episodes come first, so that they are there when the fit is broken off.
        let into = if i < config.n_held_out { &mut held_out } else { &mut seen };
        into.extend(drive(env, i as u64, config));
        if tell(Phase::Drive, i + 1, n, 0.0).is_break() {
            break;
        }
    }
    let mut painted = Vec::new();
    if let Some(model) = model {
        let painter = Painter::new(model);
        let rng = &mut ChaCha8Rng::seed_from_u64(config.seed);
        seen.shuffle(rng);
        let n = (config.painted * seen.len() as f64) as usize;
        painted = painter.paint(&held_out, rng);
        let mut all = Vec::new();
        for some in seen[..n].chunks(PAINTED) {
            all.extend(painter.paint(some, rng));
            if tell(Phase::Paint, all.len(), n, 0.0).is_break() {
                break;
            }
        }
        seen.extend(all);
    }
    let store = learn(config, &seen, &mut |done, loss| tell(Phase::Learn, done, config.n_updates, loss))?;
    let unmeasured = Probe::parameters_of(&config.probe, &store, String::new());
    let probe = Probe::load(&unmeasured).unwrap_or_else(|e| unreachable!("just made: {e}"));
    let real = errors(&probe, &held_out);
    let painted = (!painted.is_empty()).then(|| errors(&probe, &painted));
    let told = serde_json::json!({ "real": real, "painted": painted, "fit": config }).to_string();
    Ok(ProbeFit { parameters: Probe::parameters_of(&config.probe, &store, told), real, painted })
}

/// Moments of an episode that a pilot drives, the even ones carefully, the odd ones as dreams are driven.
fn drive(env: &mut dyn Env, episode: u64, config: &FitProbeConfig) -> Vec<Example> {
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    rng.set_stream(1 + episode);
    let mut pilot =
        if episode.is_multiple_of(2) { ScriptedPilot::drawn(&mut rng) } else { explorer(&mut rng) };
    env.reset(Seed::Native(FIRST_WORLD + episode));
    let mut examples = Vec::new();
    let stride = config.stride.max(GAP + 2);
    let mut at = ZOOM_STEPS + rng.random_range(0..stride);
    let mut earlier = None;
    for step in 1.. {
        let action = pilot.act(&env.truth(), &mut rng);
        let outcome = env.advance(action);
        if step + GAP == at {
            earlier = Some(env.frame());
        } else if step == at {
            let shown = Sight::of(&env.truth());
            examples.extend(earlier.take().map(|earlier| Example { earlier, now: env.frame(), shown }));
            at += rng.random_range(GAP + 1..=2 * stride - GAP - 1);
        }
        if outcome.end.is_some() {
            break;
        }
    }
    examples
}

/// A world model that paints what it sees as a dream would show it.
struct Painter<'a> {
    model: &'a WorldModel,
    encoder: Vae,
}

impl<'a> Painter<'a> {
    fn new(model: &'a WorldModel) -> Self {
        let store = nn::VarStore::new(Device::Cpu);
        let config = model.config().vae.clone();
        let vae = Vae::new(&store.root(), config.clone(), Kind::Float, &mut ChaCha8Rng::seed_from_u64(0));
        let layout = model.identity().layout();
        let loaded = model.parameters().fill("vae", &config.slots(), layout, &store);
        loaded.unwrap_or_else(|e| unreachable!("the model was loaded from them: {e}"));
        Self { model, encoder: vae.for_inference(fast_kind()) }
    }

    /// The same moments in paint.
    fn paint(&self, examples: &[Example], rng: &mut ChaCha8Rng) -> Vec<Example> {
        let mut painted = Vec::with_capacity(examples.len());
        for some in examples.chunks(PAINTED) {
            let mut repaint = |frames: Vec<Frame>| {
                let (mean, log_var) = tch::no_grad(|| self.encoder.encode(&from_frames(&frames)));
                let z = &mean + (log_var * 0.5).exp() * normal(rng, &mean.size());
                self.model.decode(&z)
            };
            let earlier = repaint(some.iter().map(|example| example.earlier.clone()).collect());
            let now = repaint(some.iter().map(|example| example.now.clone()).collect());
            let pairs = earlier.into_iter().zip(now).zip(some);
            painted.extend(pairs.map(|((earlier, now), e)| Example { earlier, now, shown: e.shown }));
        }
        painted
    }
}

/// Trains a fresh network on `examples`.
fn learn(
    config: &FitProbeConfig,
    examples: &[Example],
    report: &mut dyn FnMut(usize, f64) -> ControlFlow<()>,
) -> Result<nn::VarStore, NotFinite> {
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    let store = nn::VarStore::new(Device::Cpu);
    let net = Net::new(&store.root(), config.probe.clone(), &mut rng);
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
        let loss = loss(&net, &batch, &mut rng);
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
/// One half of the pictures is mirrored, and all are a little brighter or darker than they were.
fn loss(net: &Net, batch: &[&Example], rng: &mut ChaCha8Rng) -> Tensor {
    let b = batch.len();
    let (mut earlier, mut now, mut measured, mut counts) = (vec![], vec![], vec![], vec![]);
    let (mut is_off, mut touches) = (vec![], vec![]);
    for (i, example) in batch.iter().enumerate() {
        let is_still = rng.random_bool(STILL);
        earlier.push(if is_still { example.now.clone() } else { example.earlier.clone() });
        now.push(example.now.clone());
        is_off.extend([example.shown.off_road, example.shown.all_off]);
        touches.extend([example.shown.chuckhole, example.shown.car]);
        let shown = example.shown;
        let shown = if i < b / 2 { mirrored(shown) } else { shown };
        measured.extend(shown.targets());
        let [place, motion] = [example.tells_direction(), example.tells_direction() && !is_still]
            .map(|counts| if counts { 1.0f32 } else { 0.0 });
        counts.extend([place, place, place, motion, motion, place, place, place]);
    }
    let light = 1.0 + 0.04 * normal(rng, &[b as i64, 1, 1, 1]);
    let shade = 0.02 * normal(rng, &[b as i64, 1, 1, 1]);
    let [earlier, now] = [earlier, now].map(|frames| {
        let pixels = from_frames(&frames) * &light + &shade;
        let [half, rest] =
            [pixels.narrow(0, 0, b as i64 / 2), pixels.narrow(0, b as i64 / 2, (b - b / 2) as i64)];
        Tensor::cat(&[half.flip([2]), rest], 0)
    });
    let b = b as i64;
    let outputs = net.forward(&earlier, &now);
    let told = |from: usize, truths: &[f32]| {
        let logits = outputs.narrow(1, from as i64, 2);
        let truths = from_slice(truths, &[b, 2]);
        logits.binary_cross_entropy_with_logits(&truths, None::<Tensor>, None::<Tensor>, Reduction::Mean)
    };
    let shape = [b, N_MEASURED as i64];
    let measures = outputs.narrow(1, 2, shape[1]);
    let wrong = measures.smooth_l1_loss(&from_slice(&measured, &shape), Reduction::None, 0.1);
    let loss = told(0, &is_off) + (wrong * from_slice(&counts, &shape)).mean(Kind::Float) * 4.0;
    // A touch is rare and short, and what an annotator is asked about.
    if outputs.size()[1] > CONTACTS as i64 { loss + told(CONTACTS, &touches) * 4.0 } else { loss }
}

/// What the mirrored picture shows.
fn mirrored(sight: Sight) -> Sight {
    let [along, across] = sight.road_velocity;
    Sight {
        lateral: -sight.lateral,
        heading_error: -sight.heading_error,
        road_velocity: [along, -across],
        bends: sight.bends.map(|bend| -bend),
        ..sight
    }
}

/// How wrong `probe` is on `examples`.
fn errors(probe: &Probe, examples: &[Example]) -> ProbeErrors {
    let (earlier, now): (Vec<_>, Vec<_>) =
        examples.iter().map(|example| (example.earlier.clone(), example.now.clone())).unzip();
    let seen = probe.read(&earlier, &now);
    let pairs: Vec<_> = examples.iter().zip(&seen).collect();
    let share = |is: &dyn Fn(&Sight, &Sight) -> bool| {
        pairs.iter().filter(|(example, seen)| is(&example.shown, seen)).count() as f64
            / pairs.len().max(1) as f64
    };
    let directed: Vec<_> = pairs.iter().filter(|(example, _)| example.tells_direction()).collect();
    let mean = |error: &dyn Fn(&Sight, &Sight) -> f32| {
        let sum: f64 =
            directed.iter().map(|(example, seen)| f64::from(error(&example.shown, seen).abs())).sum();
        sum / directed.len().max(1) as f64
    };
    let told_apart = |chance: &dyn Fn(&Sight) -> f32| {
        auc(&pairs.iter().map(|(e, seen)| (chance(&e.shown) > 0.5, chance(seen))).collect::<Vec<_>>())
    };
    let turn = |a: f32, b: f32| (a - b).sin().atan2((a - b).cos());
    ProbeErrors {
        n: pairs.len(),
        off_road_share: share(&|shown, _| shown.off_road > 0.5),
        off_road_accuracy: share(&|shown, seen| (shown.off_road > 0.5) == (seen.off_road > 0.5)),
        off_road_auc: told_apart(&|sight| sight.off_road),
        all_off_accuracy: share(&|shown, seen| (shown.all_off > 0.5) == (seen.all_off > 0.5)),
        lateral: mean(&|shown, seen| shown.lateral - seen.lateral),
        heading: mean(&|shown, seen| turn(shown.heading_error, seen.heading_error)),
        along: mean(&|shown, seen| shown.road_velocity[0] - seen.road_velocity[0]),
        across: mean(&|shown, seen| shown.road_velocity[1] - seen.road_velocity[1]),
        bends: [0, 1, 2].map(|i| mean(&|shown, seen| shown.bends[i] - seen.bends[i])),
        chuckhole: [share(&|shown, _| shown.chuckhole > 0.5), told_apart(&|sight| sight.chuckhole)],
        car: [share(&|shown, _| shown.car > 0.5), told_apart(&|sight| sight.car)],
    }
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
    use crate::env::CarRacing;
    use crate::simulate::player::{DreamPlayer, Manner};

    #[test]
    fn the_area_is_one_where_all_positives_stand_above() {
        assert_eq!(auc(&[(true, 0.9), (false, 0.1), (true, 0.8), (false, 0.2)]), 1.0);
        assert_eq!(auc(&[(true, 0.1), (false, 0.9)]), 0.0);
        assert_eq!(auc(&[]), 0.5);
    }

    /// A grey road 8 pixels wide on green. The lateral offset is that of its middle from the picture's.
    fn toy(shift: i32) -> Example {
        let mut rgb = Vec::new();
        for _ in 0..20 {
            for x in 0..20 {
                let is_road = (x - 10 + shift).abs() < 4;
                rgb.extend(if is_road { [100, 100, 100] } else { [100, 200, 100] });
            }
        }
        let frame = Frame::new(20, rgb);
        let off_road = if shift.abs() > 3 { 1.0 } else { 0.0 };
        let shown = Sight { off_road, lateral: shift as f32, ..Sight::default() };
        Example { earlier: frame.clone(), now: frame, shown }
    }

    #[test]
    fn a_probe_learns_where_a_toy_road_is() {
        let examples: Vec<_> = (-7..=7).map(toy).collect();
        let config = FitProbeConfig {
            probe: ProbeConfig::tiny(),
            n_updates: 400,
            batch: 15,
            learning_rate: 5e-3,
            ..FitProbeConfig::car_racing()
        };

        let store = learn(&config, &examples, &mut |_, _| ControlFlow::Continue(())).unwrap();

        let probe = Probe::load(&Probe::parameters_of(&config.probe, &store, String::new())).unwrap();
        let errors = errors(&probe, &examples);
        assert!(errors.off_road_accuracy > 0.9 && errors.lateral < 0.8, "{errors:?}");
    }

    /// Half an hour of one core: `cargo test --lib -- --ignored --nocapture a_probe_sees_well_enough_to_drive`.
    /// `FIT_PROBE` may hold another configuration as JSON.
    #[test]
    #[ignore = "fits a whole probe, which takes half an hour: for whoever changes the probe or its pilot"]
    #[expect(clippy::print_stderr, reason = "its figures are of interest")]
    fn a_probe_sees_well_enough_to_drive() {
        let config = std::env::var("FIT_PROBE")
            .map_or_else(|_| FitProbeConfig::car_racing(), |text| serde_json::from_str(&text).unwrap());
        let begun = std::time::Instant::now();
        let fit = fit_probe(&config, &mut CarRacing::new(Seed::Native(0)), None, &mut |progress| {
            if progress.done % 500 == 0 {
                eprintln!("{:.0} s {progress:?}", begun.elapsed().as_secs_f64());
            }
            ControlFlow::Continue(())
        });
        let fit = fit.unwrap();
        eprintln!("{:#?}", fit.real);
        let probe = Probe::load(&fit.parameters).unwrap();
        let (mut n_off, mut n_clips, mut n_unsafe, mut n_steps, mut n_tiles) = (0, 0, 0, 0, 0);
        for seed in 0..8 {
            let mut env = CarRacing::new(Seed::Native(seed));
            let mut player = DreamPlayer::new(Manner::Exploring, seed);
            let mut frames = vec![env.frame()];
            let mut offs = Vec::new();
            loop {
                if frames.len() % 2 == 1 {
                    let now = frames.len() - 1;
                    player.see(probe.read(&frames[now.saturating_sub(GAP)..][..1], &frames[now..])[0]);
                }
                let outcome = env.advance(player.act());
                frames.push(env.frame());
                offs.push(env.truth().wheels_off > 0);
                if outcome.end.is_some() {
                    break;
                }
            }
            n_tiles += env.n_visited();
            n_steps += offs.len();
            n_off += offs.iter().filter(|off| **off).count();
            n_clips += offs.chunks_exact(20).count();
            n_unsafe +=
                offs.chunks_exact(20).filter(|clip| clip.iter().filter(|off| **off).count() > 1).count();
        }
        let off_road = f64::from(n_off as u32) / n_steps as f64;
        eprintln!(
            "off the road {off_road:.3}, unsafe clips {:.3}, {} tiles",
            n_unsafe as f64 / n_clips as f64,
            n_tiles / 8
        );
        assert!(fit.real.off_road_accuracy > 0.97 && fit.real.lateral < 0.6 && fit.real.along < 3.0);
        assert!((0.2..0.5).contains(&off_road), "{off_road} of the time off the road");
    }
}
