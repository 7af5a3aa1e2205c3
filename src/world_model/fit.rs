//! Training both networks: vision on shuffled frames, memory on stretches of encoded episodes (method §§3.4, 4.4).
//!
//! Each stage keeps its best parameters by what it scores on held-out episodes, lowers its learning rate where that
//! no longer improves, and checkpoints after every epoch, so that a stopped fit resumes.

use std::ops::ControlFlow;

use rand::seq::SliceRandom as _;
use rand::{Rng, RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use tch::{Device, Kind, Tensor, nn};

use crate::dataset::{Dataset, DatasetError};
use crate::env::Frame;
use crate::run::{Run, RunError};
use crate::tensor::adam::Adam;
use crate::tensor::{Parameters, ParametersError, from_frames, normal};
use crate::world_model::{MdnRnn, Vae, WorldModel, WorldModelConfig, actions_tensor, fast_kind};

/// How one network is trained.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Schedule {
    /// Frames, or stretches of episodes, in an update.
    pub batch: usize,
    /// Updates from one look at the held-out episodes to the next.
    pub updates_per_epoch: usize,
    /// Epochs at the most.
    pub max_epochs: usize,
    /// Learning rate at the start.
    pub learning_rate: f64,
    /// Below this the fit ends.
    pub min_learning_rate: f64,
    /// Epochs without improvement after which the learning rate falls to a third.
    pub patience: usize,
}

impl Schedule {
    /// The most that the learning rate may be in `epoch`: with the end in sight it falls to a third, then to a tenth.
    fn ceiling(&self, epoch: usize) -> f64 {
        match epoch * 20 / self.max_epochs.max(1) {
            0..12 => self.learning_rate,
            12..17 => self.learning_rate / 3.0,
            _ => self.learning_rate / 10.0,
        }
    }
}

/// How a world model is trained.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FitConfig {
    /// Of everything drawn.
    pub seed: u64,
    /// Share of the episodes that is never trained on.
    pub held_out: f64,
    /// Steps in a stretch of an episode for the memory.
    pub window: usize,
    /// For vision.
    pub vae: Schedule,
    /// For memory.
    pub mdn_rnn: Schedule,
}

impl FitConfig {
    /// What made the model that is shipped: see the card beside it.
    pub fn car_racing() -> Self {
        // DIFFERENCE: the paper's rates are 1e-4 to 1e-5 for vision, over 100 passes; ours start higher and pass fewer times.
        let vae = Schedule {
            batch: 32,
            updates_per_epoch: 1000,
            max_epochs: 60,
            learning_rate: 1e-3,
            min_learning_rate: 2e-5,
            patience: 3,
        };
        // DIFFERENCE: stretches from anywhere in an episode rather than whole ones, so that an empty memory in the middle
        // of a drive, which deployment meets at every reset, is something the memory has been trained on (method §4.6).
        let mdn_rnn = Schedule {
            batch: 32,
            updates_per_epoch: 100,
            max_epochs: 60,
            learning_rate: 1e-3,
            min_learning_rate: 2e-5,
            patience: 4,
        };
        Self { seed: 0, held_out: 0.1, window: 250, vae, mdn_rnn }
    }

    /// A few seconds on toys.
    pub fn tiny() -> Self {
        let schedule = |updates| Schedule {
            batch: 16,
            updates_per_epoch: updates,
            max_epochs: 4,
            learning_rate: 3e-3,
            min_learning_rate: 1e-4,
            patience: 2,
        };
        Self { seed: 0, held_out: 0.2, window: 30, vae: schedule(60), mdn_rnn: schedule(30) }
    }
}

/// Which network is being trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// Vision.
    Vae,
    /// Turning every episode into latents.
    Encode,
    /// Memory.
    MdnRnn,
}

/// Where a fit stands.
#[derive(Clone, Debug, Serialize)]
pub struct Progress {
    /// The network.
    pub stage: Stage,
    /// Epochs done.
    pub epoch: usize,
    /// Epochs at the most.
    pub max_epochs: usize,
    /// Updates, or episodes, done in this epoch.
    pub done: usize,
    /// Updates, or episodes, in an epoch.
    pub n: usize,
    /// Frames, or steps, in an update.
    pub items: usize,
    /// Loss on what is trained on, since the epoch began.
    pub loss: f64,
    /// Loss on the held-out episodes, at the end of an epoch.
    pub held_out: Option<f64>,
    /// The present learning rate.
    pub learning_rate: f64,
    /// Whether this epoch is the best yet.
    pub is_best: bool,
}

/// Why a fit ended early.
#[derive(Debug, thiserror::Error)]
pub enum FitError {
    /// The recordings cannot be read.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// The folder of the job cannot be used.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A checkpoint belongs to other networks.
    #[error("cannot resume: {0}")]
    Parameters(#[from] ParametersError),
    /// Too few recordings.
    #[error("a world model needs at least two recorded episodes, one of them held out; there are {0}")]
    TooFew(usize),
    /// The caller asked.
    #[error("stopped; `--resume` goes on from the last checkpoint")]
    Stopped,
}

/// Which episodes are trained on, and which only looked at.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Split {
    /// Trained on.
    pub train: Vec<usize>,
    /// Held out.
    pub held_out: Vec<usize>,
}

impl Split {
    /// A split of `n` episodes, both for vision and for memory.
    pub fn new(n: usize, held_out: f64, seed: u64) -> Self {
        // DIFFERENCE: the authors split frames for vision, so that neighbors of held-out frames are trained on.
        let mut all: Vec<_> = (0..n).collect();
        all.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));
        let n_held_out = ((n as f64 * held_out).round() as usize).clamp(1.min(n), n.saturating_sub(1));
        let train = all.split_off(n_held_out);
        Self { train, held_out: all }
    }
}

/// Whoever listens to a fit; `Break` stops it.
pub type Report<'a> = dyn FnMut(&Progress) -> ControlFlow<()> + 'a;

/// Trains a world model on `dataset`, keeping all it needs to resume in `run`.
pub fn fit_world(
    dataset: &Dataset,
    config: &WorldModelConfig,
    fit: &FitConfig,
    run: &Run,
    report: &mut Report<'_>,
) -> Result<Parameters, FitError> {
    let n = dataset.n_episodes();
    if n < 2 {
        return Err(FitError::TooFew(n));
    }
    let split = Split::new(n, fit.held_out, fit.seed);
    let vision = fit_vae(dataset, &split, config, fit, run, report)?;
    encode(dataset, config, &vision, run, report)?;
    let memory = fit_mdn_rnn(dataset, &split, config, fit, run, report)?;
    let parameters = WorldModel::parameters_of(config, &vision, &memory);
    with_starts(dataset, &split, &parameters)
}

/// The parameters with a moment of each of up to thirty held-out episodes beside them, where dreams may start.
///
/// It is a moment on the road, so that whoever dreams is not lost at once, and after the first second of the episode,
/// in which the camera is still on its way down.
fn with_starts(dataset: &Dataset, split: &Split, parameters: &Parameters) -> Result<Parameters, FitError> {
    const FIRST: usize = 60;
    const SAFE_BEFORE: usize = 20;
    let model = WorldModel::load(parameters.clone())
        .unwrap_or_else(|e| unreachable!("these are the parameters of that very model: {e}"));
    let mut starts = Vec::new();
    for (i, &episode) in split.held_out.iter().enumerate() {
        let episode = dataset.episode(episode)?;
        let is_on_road = |at: &usize| !episode.grass[at.saturating_sub(SAFE_BEFORE)..=*at].contains(&true);
        let at = (FIRST + 40 * (i % 5)..episode.actions.len()).find(is_on_road);
        let at = at.or(episode.actions.len().checked_sub(1)).filter(|_| starts.len() < 30);
        starts
            .extend(at.into_iter().flat_map(|at| model.states_of(&episode.frames, &episode.actions, &[at])));
    }
    Ok(model.parameters_with_starts(&starts))
}

/// A fit in progress: what a checkpoint holds.
struct Course<'a> {
    stage: Stage,
    name: &'static str,
    schedule: &'a Schedule,
    store: nn::VarStore,
    adam: Adam,
    rng: ChaCha8Rng,
    standing: Standing,
}

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Standing {
    epoch: usize,
    learning_rate: f64,
    best: f64,
    n_stale: usize,
    /// [`VaeConfig::emphasis`](crate::world_model::VaeConfig::emphasis): scores under another do not compare.
    #[serde(default)]
    emphasis: f64,
}

impl Course<'_> {
    /// Goes on from the last checkpoint, if there is one.
    fn resume(&mut self, run: &Run) -> Result<(), FitError> {
        let Some(saved) = run.load(&format!("{}-last", self.name))? else { return Ok(()) };
        saved.load("net", &self.store)?;
        let restored = self.adam.restore(|name| saved.tensor(&format!("adam.{name}")));
        let standing: Option<Standing> =
            saved.metadata("standing").and_then(|text| serde_json::from_str(&text).ok());
        let (Some(()), Some(standing)) = (restored, standing) else {
            return Err(ParametersError::Missing("adam".to_owned()).into());
        };
        self.standing = if standing.emphasis == self.standing.emphasis {
            standing
        } else {
            Standing { epoch: standing.epoch, ..self.standing }
        };
        Ok(())
    }

    fn checkpoint(&self, run: &Run) -> Result<(), FitError> {
        let standing =
            serde_json::to_string(&self.standing).unwrap_or_else(|e| unreachable!("plain data: {e}"));
        let net = self.store.variables().into_iter().map(|(name, tensor)| (format!("net.{name}"), tensor));
        let adam = self.adam.state().into_iter().map(|(name, tensor)| (format!("adam.{name}"), tensor));
        let all = Parameters::from_tensors(net.chain(adam), &[("standing", standing)]);
        run.save(&format!("{}-last", self.name), &all)?;
        Ok(())
    }

    /// Runs all epochs that are left, then takes the best parameters back.
    fn run(
        mut self,
        run: &Run,
        clip: Option<f64>,
        mut update: impl FnMut(&mut ChaCha8Rng) -> Result<(Tensor, usize), FitError>,
        mut score: impl FnMut(&mut ChaCha8Rng) -> Result<f64, FitError>,
        report: &mut Report<'_>,
    ) -> Result<nn::VarStore, FitError> {
        self.resume(run)?;
        let Schedule { updates_per_epoch, max_epochs, min_learning_rate, patience, .. } = *self.schedule;
        while self.standing.epoch < max_epochs && self.standing.learning_rate >= min_learning_rate {
            // Each epoch has a stream of its own, so that a resumed fit goes on as it would have.
            let learning_rate = self.standing.learning_rate.min(self.schedule.ceiling(self.standing.epoch));
            self.rng.set_stream(self.standing.epoch as u64 + 1);
            self.rng.set_word_pos(0);
            let mut progress = Progress {
                stage: self.stage,
                epoch: self.standing.epoch,
                max_epochs,
                done: 0,
                n: updates_per_epoch,
                items: 0,
                loss: 0.0,
                held_out: None,
                learning_rate,
                is_best: false,
            };
            let mut sum = 0.0;
            for done in 1..=updates_per_epoch {
                let (loss, items) = update(&mut self.rng)?;
                self.adam.step(&loss, learning_rate, clip);
                sum += loss.double_value(&[]);
                progress = Progress { done, items, loss: sum / done as f64, ..progress };
                if done < updates_per_epoch && report(&progress).is_break() {
                    return Err(FitError::Stopped);
                }
            }
            let held_out = tch::no_grad(|| score(&mut ChaCha8Rng::seed_from_u64(0)))?;
            let is_best = held_out < self.standing.best;
            self.standing.epoch += 1;
            if is_best {
                self.standing.best = held_out;
                self.standing.n_stale = 0;
                run.save(&format!("{}-best", self.name), &Parameters::of(&[("net", &self.store)], &[]))?;
            } else {
                self.standing.n_stale += 1;
                if self.standing.n_stale >= patience {
                    self.standing.learning_rate /= 3.0;
                    self.standing.n_stale = 0;
                }
            }
            self.checkpoint(run)?;
            progress = Progress { epoch: self.standing.epoch, held_out: Some(held_out), is_best, ..progress };
            run.log(&progress)?;
            if report(&progress).is_break() {
                return Err(FitError::Stopped);
            }
        }
        if let Some(best) = run.load(&format!("{}-best", self.name))? {
            best.load("net", &self.store)?;
        }
        Ok(self.store)
    }
}

fn course<'a>(
    stage: Stage,
    name: &'static str,
    schedule: &'a Schedule,
    store: nn::VarStore,
    rng: ChaCha8Rng,
    emphasis: f64,
) -> Course<'a> {
    let adam = Adam::new(&store);
    let learning_rate = schedule.learning_rate;
    let standing = Standing { epoch: 0, learning_rate, best: f64::INFINITY, n_stale: 0, emphasis };
    Course { stage, name, schedule, store, adam, rng, standing }
}

fn fit_vae(
    dataset: &Dataset,
    split: &Split,
    config: &WorldModelConfig,
    fit: &FitConfig,
    run: &Run,
    report: &mut Report<'_>,
) -> Result<nn::VarStore, FitError> {
    let mut rng = ChaCha8Rng::seed_from_u64(fit.seed);
    let store = nn::VarStore::new(Device::Cpu);
    let vae = Vae::new(&store.root(), config.vae.clone(), fast_kind(), &mut rng);
    let latent = config.vae.latent;
    let mut frames = ShuffledFrames::new(dataset, split.train.clone());
    let held_out = held_out_frames(dataset, split)?;
    let update = |rng: &mut ChaCha8Rng| {
        let batch = frames.next(fit.vae.batch, rng)?;
        let loss = vae.loss(&from_frames(&batch), &normal(rng, &[batch.len() as i64, latent]));
        Ok((loss.reconstruction + loss.divergence, batch.len()))
    };
    let score = |rng: &mut ChaCha8Rng| {
        let mut sum = 0.0;
        for batch in held_out.chunks(100) {
            let loss = vae.loss(&from_frames(batch), &normal(rng, &[batch.len() as i64, latent]));
            sum += (loss.reconstruction + loss.divergence).double_value(&[]) * batch.len() as f64;
        }
        Ok(sum / held_out.len() as f64)
    };
    let emphasis = config.vae.emphasis;
    course(Stage::Vae, "vae", &fit.vae, store, rng, emphasis).run(run, None, update, score, report)
}

/// Two thousand frames of held-out episodes, evenly spread: enough to tell epochs apart.
fn held_out_frames(dataset: &Dataset, split: &Split) -> Result<Vec<Frame>, FitError> {
    let mut kept = Vec::new();
    let per_episode = 2000_usize.div_ceil(split.held_out.len());
    for &i in &split.held_out {
        let frames = dataset.episode(i)?.frames;
        let every = frames.len().div_ceil(per_episode).max(1);
        kept.extend(frames.into_iter().step_by(every));
    }
    Ok(kept)
}

/// Frames in an order that mixes several episodes, of which only those are in memory.
struct ShuffledFrames<'a> {
    dataset: &'a Dataset,
    train: Vec<usize>,
    /// Episodes still to come in this pass.
    queue: Vec<usize>,
    pool: Vec<Frame>,
}

impl<'a> ShuffledFrames<'a> {
    /// How many episodes are mixed; some 20 MB each.
    const N_MIXED: usize = 16;

    fn new(dataset: &'a Dataset, train: Vec<usize>) -> Self {
        Self { dataset, train, queue: Vec::new(), pool: Vec::new() }
    }

    /// The next `n` frames.
    fn next(&mut self, n: usize, rng: &mut impl Rng) -> Result<Vec<Frame>, FitError> {
        let mut batch = Vec::with_capacity(n);
        while batch.len() < n {
            if self.pool.is_empty() {
                for _ in 0..Self::N_MIXED.min(self.train.len()) {
                    if self.queue.is_empty() {
                        self.queue.clone_from(&self.train);
                        self.queue.shuffle(rng);
                    }
                    let Some(i) = self.queue.pop() else { break };
                    self.pool.extend(self.dataset.episode(i)?.frames);
                }
                self.pool.shuffle(rng);
            }
            let rest = self.pool.len().saturating_sub(n - batch.len());
            batch.extend(self.pool.drain(rest..));
        }
        Ok(batch)
    }
}

/// Keeps the latents of every episode in `run`, so that the memory's training holds only its batch.
fn encode(
    dataset: &Dataset,
    config: &WorldModelConfig,
    vision: &nn::VarStore,
    run: &Run,
    report: &mut Report<'_>,
) -> Result<(), FitError> {
    let store = nn::VarStore::new(Device::Cpu);
    let vae = Vae::new(&store.root(), config.vae.clone(), Kind::Float, &mut ChaCha8Rng::seed_from_u64(0));
    Parameters::of(&[("net", vision)], &[]).load("net", &store)?;
    // Noise is added to these anyway; the quick arithmetic is exact enough, and there are a great many.
    let vae = vae.frozen(fast_kind());
    let n = dataset.n_episodes();
    for i in 0..n {
        if run.load(&latents_name(i))?.is_none() {
            let episode = dataset.episode(i)?;
            let parts: Vec<_> = tch::no_grad(|| {
                episode.frames.chunks(100).map(|chunk| vae.encode(&from_frames(chunk))).collect()
            });
            let (means, log_vars): (Vec<_>, Vec<_>) = parts.into_iter().unzip();
            // Actions and latents of the same steps: a closing frame without an action is left out.
            let t = episode.actions.len() as i64;
            let encoded = [
                ("mean".to_owned(), Tensor::cat(&means, 0).narrow(0, 0, t)),
                ("log_var".to_owned(), Tensor::cat(&log_vars, 0).narrow(0, 0, t)),
                ("actions".to_owned(), actions_tensor(&episode.actions)),
            ];
            run.save(&latents_name(i), &Parameters::from_tensors(encoded, &[]))?;
        }
        let progress = Progress {
            stage: Stage::Encode,
            epoch: 0,
            max_epochs: 1,
            done: i + 1,
            n,
            items: 1000,
            loss: 0.0,
            held_out: None,
            learning_rate: 0.0,
            is_best: false,
        };
        if report(&progress).is_break() {
            return Err(FitError::Stopped);
        }
    }
    Ok(())
}

fn latents_name(episode: usize) -> String {
    format!("latents-{episode:06}")
}

/// An episode as vision sees it.
struct Encoded {
    mean: Tensor,
    log_var: Tensor,
    actions: Tensor,
}

fn encoded(run: &Run, episode: usize) -> Result<Encoded, FitError> {
    let name = latents_name(episode);
    let missing = |what: &str| ParametersError::Missing(format!("{what} of {name}"));
    let saved = run.load(&name)?.ok_or_else(|| missing("all"))?;
    let part = |what: &str| saved.tensor(what).ok_or_else(|| missing(what));
    Ok(Encoded { mean: part("mean")?, log_var: part("log_var")?, actions: part("actions")? })
}

fn fit_mdn_rnn(
    dataset: &Dataset,
    split: &Split,
    config: &WorldModelConfig,
    fit: &FitConfig,
    run: &Run,
    report: &mut Report<'_>,
) -> Result<nn::VarStore, FitError> {
    let mut rng = ChaCha8Rng::seed_from_u64(fit.seed.wrapping_add(1));
    let store = nn::VarStore::new(Device::Cpu);
    let mdn_rnn = MdnRnn::new(&store.root(), config.mdn_rnn.clone(), &mut rng);
    assert_eq!(
        dataset.n_episodes(),
        split.train.len() + split.held_out.len(),
        "the split is of this dataset"
    );
    let loss = |episodes: &[usize], rng: &mut ChaCha8Rng| -> Result<(Tensor, usize), FitError> {
        let stretches = stretches(run, episodes, fit.window, rng)?;
        let n_steps = stretches.lens.iter().sum::<i64>() as usize;
        Ok((mdn_rnn.loss(&stretches.zs, &stretches.actions, &stretches.lens), n_steps))
    };
    let update = |rng: &mut ChaCha8Rng| {
        let episodes: Vec<_> =
            (0..fit.mdn_rnn.batch).map(|_| split.train[rng.random_range(0..split.train.len())]).collect();
        loss(&episodes, rng)
    };
    let score = |rng: &mut ChaCha8Rng| {
        let mut sum = 0.0;
        let batches: Vec<_> = split.held_out.chunks(32).collect();
        for episodes in &batches {
            sum += loss(episodes, rng)?.0.double_value(&[]);
        }
        Ok(sum / batches.len() as f64)
    };
    // Gradients are clipped entry by entry to ±1 (method §4.4).
    course(Stage::MdnRnn, "mdn_rnn", &fit.mdn_rnn, store, rng, 0.0).run(run, Some(1.0), update, score, report)
}

/// Stretches of episodes, padded with zeros to the same length.
struct Stretches {
    /// Drawn latents, `[B, T, Z]`: the same draw is target at t and input at t + 1.
    zs: Tensor,
    /// `[B, T, A]`.
    actions: Tensor,
    lens: Vec<i64>,
}

/// One stretch of at most `window` steps from each of `episodes`, its start uniform.
fn stretches(
    run: &Run,
    episodes: &[usize],
    window: usize,
    rng: &mut ChaCha8Rng,
) -> Result<Stretches, FitError> {
    let (mut zs, mut actions, mut lens) = (Vec::new(), Vec::new(), Vec::new());
    for &episode in episodes {
        let Encoded { mean, log_var, actions: all } = encoded(run, episode)?;
        let n = all.size()[0];
        let len = n.min(window as i64);
        let start = rng.random_range(0..=n - len);
        let (mean, log_var) = (mean.narrow(0, start, len), log_var.narrow(0, start, len));
        let noise = normal(rng, &mean.size());
        let pad = |tensor: Tensor| tensor.constant_pad_nd([0, 0, 0, window as i64 - len]);
        zs.push(pad(mean + (log_var * 0.5).exp() * noise));
        actions.push(pad(all.narrow(0, start, len)));
        lens.push(len);
    }
    Ok(Stretches { zs: Tensor::stack(&zs, 0), actions: Tensor::stack(&actions, 0), lens })
}
