//! Training both networks: vision on shuffled frames, memory on windows of encoded episodes (method §§3.4, 4.4).
//!
//! Each stage keeps its best parameters by what it scores on held-out episodes, lowers its learning rate where that
//! no longer improves, and checkpoints after every epoch, so that a stopped fit resumes.
//!
//! Where a world is not built in, pixels count more the rarer their color is in its recordings, and so do those around
//! them, so that vision does not overlook what is small: with a strength s
//!
//! ```text
//! w = 1 + s (mean over 5 × 5 of clip(√(p_median / p(color)), 1, 16) − 1)
//! ```

mod data;
mod rarity;
mod speed;
#[cfg(test)]
mod tests;
mod train_loop;

use std::fmt::{self, Write as _};
use std::ops::ControlFlow;

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use tch::{Kind, Tensor, nn};

use crate::dataset::{Dataset, DatasetError, Episode};
use crate::run::{Run, RunError};
use crate::tensor::limits::{MAX_COUNT, OutOfRange, within};
use crate::tensor::{Backend, NotFinite, Parameters, ParametersError, from_frames_on, normal};
use crate::world::{EventKind, EventSpec, Size, WorldSpec};
use crate::world_model::{LatentState, MdnRnn, Vae, WorldModel, WorldModelConfig};

use data::{DeviceSequences, Pictures, Source, at_once, encode, held_out_frames, means, windows};
pub use data::{ReadEpisodes, Split, Take, read_one_by_one};
use rarity::Rarity;
pub use speed::{Speed, speed};
use train_loop::TrainLoop;

/// How one network is trained.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Schedule {
    /// Frames, or windows of episodes, in an update.
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
    /// Fails where nothing can be trained so; `what` is trained.
    fn check(&self, what: &str) -> Result<(), OutOfRange> {
        within(&format!("the batch of {what}"), self.batch, 1..=MAX_COUNT)?;
        within(
            &format!("the number of updates in an epoch of {what}"),
            self.updates_per_epoch,
            1..=MAX_COUNT,
        )?;
        within(&format!("the number of epochs of {what}"), self.max_epochs, 1..=MAX_COUNT)?;
        within(&format!("the learning rate of {what}"), self.learning_rate, 0.0..=1e3)?;
        within(&format!("the smallest learning rate of {what}"), self.min_learning_rate, 0.0..=1e3)
    }

    /// How far `epoch` is along all of them, in twentieths.
    fn twentieths(&self, epoch: usize) -> usize {
        epoch * 20 / self.max_epochs.max(1)
    }

    /// The most that the learning rate may be in `epoch`: with the end in sight it falls to a third, then to a tenth.
    fn ceiling(&self, epoch: usize) -> f64 {
        match self.twentieths(epoch) {
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
    /// Steps in a window of an episode for the memory.
    pub window: usize,
    /// For vision.
    pub vae: Schedule,
    /// For memory.
    pub mdn_rnn: Schedule,
}

impl FitConfig {
    /// The whole of it, as for the models that are shipped: see the cards beside them.
    pub fn full() -> Self {
        // DIFFERENCE: the paper's rates are 1e-4 to 1e-5 for vision, over 100 passes. Ours start higher and pass fewer times.
        let vae = Schedule {
            batch: 32,
            updates_per_epoch: 1000,
            max_epochs: 60,
            learning_rate: 1e-3,
            min_learning_rate: 2e-5,
            patience: 3,
        };
        // DIFFERENCE: windows from anywhere in an episode rather than whole ones, so that an empty memory in the middle
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

    /// The same for the recordings of `spec`: five seconds at once, and what its file says otherwise.
    ///
    /// These are 250 steps at the 50 Hz of the built-in worlds. Where they would be fewer than 50 steps, or more than 500,
    /// or more than an episode has, it is as many.
    pub fn for_world(spec: &WorldSpec) -> Self {
        let told = &spec.fitting;
        let full = Self::full();
        let steps = (full.window as f64 * spec.rate / 50.0).round() as usize;
        let window = steps.clamp(50, 500).min(spec.longest_episode).max(2);
        let schedule = |usual: &Schedule, max_epochs: Option<usize>| Schedule {
            batch: told.batch.unwrap_or(usual.batch),
            max_epochs: max_epochs.unwrap_or(usual.max_epochs),
            ..usual.clone()
        };
        Self {
            held_out: told.held_out.unwrap_or(full.held_out),
            window: told.window.unwrap_or(window),
            vae: schedule(&full.vae, told.vae_epochs),
            mdn_rnn: schedule(&full.mdn_rnn, told.mdn_rnn_epochs),
            ..full
        }
    }

    /// Fails where no world model can be trained so.
    pub fn check(&self) -> Result<(), OutOfRange> {
        within("the share of episodes that is held out", self.held_out, 0.0..=0.9)?;
        within("the number of steps in a stretch", self.window, 2..=MAX_COUNT)?;
        self.vae.check("vision")?;
        self.mdn_rnn.check("memory")
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
    Parameters(ParametersError),
    /// No networks can be of the shapes that are wanted.
    #[error("cannot train such networks: {0}")]
    Config(OutOfRange),
    /// A number was none, and nothing more can come of the fit.
    #[error("{0}: the fit ends here; nothing of this epoch is kept, and the checkpoint before it is whole")]
    NotFinite(NotFinite),
    /// What was begun with other recordings would be trained on what was held out.
    #[error(
        "this fit began with {began}, and now it would be {now}: go on with the same, or begin anew without `--resume`"
    )]
    Others {
        /// At its beginning.
        began: Box<Terms>,
        /// At present.
        now: Box<Terms>,
    },
    /// The recordings are not of the world that the networks are for.
    #[error(
        "the recordings have {found}, and the world {world:?} has {wanted}: give recordings of that world, or their own"
    )]
    Unfit {
        /// The world's name.
        world: String,
        /// What the recordings have.
        found: String,
        /// What the world has.
        wanted: String,
    },
    /// Too few recordings.
    #[error("a world model needs at least two recorded episodes, one of them held out; there are {0}")]
    TooFew(usize),
    /// The caller asked.
    #[error("stopped; `--resume` goes on from the last checkpoint")]
    Stopped,
}

impl From<ParametersError> for FitError {
    fn from(met: ParametersError) -> Self {
        Self::Parameters(met)
    }
}

/// What a resumed fit must share with the one that it goes on from: what decides which episodes are held out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Terms {
    /// The environment.
    pub env: String,
    /// Recorded episodes.
    pub n_episodes: usize,
    /// Share of them that is held out.
    pub held_out: f64,
    /// Of the draw.
    pub seed: u64,
    /// Which episodes, and in which order. Fits that were begun before this was noted say nothing.
    #[serde(default)]
    pub recordings: String,
}

impl Terms {
    /// Whether what was begun on these terms can go on under `now`.
    fn permit(&self, now: &Self) -> bool {
        let recordings = if self.recordings.is_empty() { &now.recordings } else { &self.recordings };
        Self { recordings: recordings.clone(), ..self.clone() } == *now
    }
}

impl fmt::Display for Terms {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { env, n_episodes, held_out, seed, recordings } = self;
        write!(f, "{n_episodes} episodes of {env} ({:.0} % held out, seed {seed}", 100.0 * held_out)?;
        // A few digits tell them apart.
        match recordings.get(..8) {
            Some(which) => write!(f, ", recordings {which})"),
            None => f.write_str(")"),
        }
    }
}

/// Whoever listens to a fit. `Break` stops it.
pub type Report<'a> = dyn FnMut(&Progress) -> ControlFlow<()> + 'a;

/// Whether a world model can be trained on `dataset` at all: what takes no time to find out, before anything is touched.
pub fn check(dataset: &Dataset) -> Result<(), FitError> {
    let n = dataset.n_episodes();
    if n < 2 {
        return Err(FitError::TooFew(n));
    }
    dataset.episode(0)?;
    Ok(())
}

/// Whether `dataset` can be recordings of the world that `config` is for: by the size of the pictures, the axes and the
/// rate.
pub fn check_world(dataset: &Dataset, config: &WorldModelConfig) -> Result<(), FitError> {
    let (Some(size), Some(layout)) = (dataset.size(), dataset.layout()) else { return Ok(()) };
    let spec = config.spec();
    let names: Vec<_> = spec.axes.iter().map(|axis| axis.name.clone()).collect();
    let is_rate = (layout.rate / spec.rate - 1.0).abs() < 1e-6;
    if is_rate && (size, &layout.axes) == (config.vae.size(), &names) {
        return Ok(());
    }
    let said = |Size { height, width }: Size, axes: &[String], rate: f64| {
        let axes = crate::text::shown(&axes.join(", "));
        format!("pictures of {height} x {width} pixels, the axes {axes} and {rate} steps a second")
    };
    Err(FitError::Unfit {
        world: crate::text::shown(&config.env),
        found: said(size, &layout.axes, layout.rate),
        wanted: said(config.vae.size(), &names, spec.rate),
    })
}

/// With what a world model is trained.
#[derive(Clone, Copy)]
pub struct Means<'a> {
    /// On what.
    pub backend: Backend,
    /// How recordings are read.
    pub read: &'a ReadEpisodes,
}

impl Default for Means<'_> {
    /// The processor, and one episode after the other.
    fn default() -> Self {
        Self { backend: Backend::cpu(), read: &read_one_by_one }
    }
}

impl fmt::Debug for Means<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Means on {}", self.backend)
    }
}

/// How a world model was fitted, as its file tells it: what it takes to fit it again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FitRecord {
    /// The settings. The networks' shapes stand in the file's `config`.
    pub settings: FitConfig,
    /// How many episodes there were, those that were held out among them.
    pub n_episodes: usize,
    /// What the recordings are known by.
    pub recordings: String,
    /// The version of the program.
    pub app: String,
}

impl FitRecord {
    /// Where it stands in the header of a world model's file.
    const KEY: &str = "fit";

    /// That of the world model in `parameters`, where its file has one.
    pub fn of(parameters: &Parameters) -> Option<Self> {
        serde_json::from_str(&parameters.metadata(Self::KEY)?).ok()
    }

    fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_else(|e| unreachable!("plain data: {e}"))
    }
}

/// Trains a world model on `dataset`, keeping all it needs to resume in `run`.
pub fn fit_world(
    dataset: &Dataset,
    config: &WorldModelConfig,
    fit: &FitConfig,
    run: &Run,
    report: &mut Report<'_>,
) -> Result<Parameters, FitError> {
    fit_world_with(Means::default(), dataset, config, fit, run, report)
}

/// The same with `means`.
pub fn fit_world_with(
    means: Means<'_>,
    dataset: &Dataset,
    config: &WorldModelConfig,
    fit: &FitConfig,
    run: &Run,
    report: &mut Report<'_>,
) -> Result<Parameters, FitError> {
    let split = Split::new(dataset.n_episodes(), fit.held_out, fit.seed);
    fit_world_on(means, dataset, &split, config, fit, run, report)
}

/// The same on those episodes of `dataset` alone that `split` names: the share that `fit` would hold out is not asked for.
///
/// A folder `run` is for one split, and gone on with under no other.
pub fn fit_world_on(
    means: Means<'_>,
    dataset: &Dataset,
    split: &Split,
    config: &WorldModelConfig,
    fit: &FitConfig,
    run: &Run,
    report: &mut Report<'_>,
) -> Result<Parameters, FitError> {
    let Means { backend, read } = means;
    let source = Source { dataset, read };
    check(dataset)?;
    config.check().map_err(FitError::Config)?;
    check_world(dataset, config)?;
    let n = split.train.len() + split.held_out.len();
    let (env, recordings) = (config.env.clone(), dataset.fingerprint());
    let record = FitRecord {
        settings: fit.clone(),
        n_episodes: n,
        recordings: recordings.clone(),
        app: env!("CARGO_PKG_VERSION").to_owned(),
    };
    let now = Terms { env, n_episodes: n, held_out: fit.held_out, seed: fit.seed, recordings };
    match run.recall::<Terms>("terms")? {
        Some(began) if !began.permit(&now) => {
            return Err(FitError::Others { began: Box::new(began), now: Box::new(now) });
        }
        Some(_) => {}
        None => run.note("terms", &now)?,
    }
    let vision = fit_vae(source, split, config, fit, backend, run, report)?;
    let seen = Parameters::of(&[("net", &vision)], &[]);
    encode(source, split, config, (backend, &seen), run, report)?;
    let memory = fit_mdn_rnn(split, config, fit, backend, seen.hash(), run, report)?;
    let parameters = WorldModel::parameters_of(config, &vision, &memory);
    let parameters = parameters.with_metadata(FitRecord::KEY, record.to_json());
    with_starts(source, split, &parameters, |model, i, episode, at| {
        if backend.is_cpu() {
            return Ok(model.states_of(&episode.frames, &episode.actions, at));
        }
        Ok(model.states_of_latents(&means_of(run, i, config)?, &episode.actions, at))
    })
}

/// The least losses on held-out episodes of the fit in `run`, of vision and of memory; nothing where it has no epoch of each.
///
/// # Errors
/// Where a checkpoint cannot be read.
pub fn best_losses(run: &Run) -> Result<Option<[f64; 2]>, FitError> {
    let (vision, memory) = (train_loop::best(run, Stage::Vae)?, train_loop::best(run, Stage::MdnRnn)?);
    Ok(vision.zip(memory).map(<[f64; 2]>::from))
}

/// The latents of an episode's steps, as they were encoded.
fn means_of(run: &Run, episode: usize, config: &WorldModelConfig) -> Result<Tensor, FitError> {
    means(run, episode, &config.mdn_rnn)
}

/// The parameters with a moment of each of up to thirty held-out episodes beside them, where dreams may start.
///
/// It is a moment at which nothing bad goes on nor just went on, as far as that was recorded, so that whoever dreams is not
/// lost at once; and after the first second of the episode, in which the camera is still on its way down where there is
/// one.
///
/// `states` are those of an episode before some steps.
fn with_starts(
    source: Source<'_>,
    split: &Split,
    parameters: &Parameters,
    states: impl Fn(&WorldModel, usize, &Episode, &[usize]) -> Result<Vec<LatentState>, FitError>,
) -> Result<Parameters, FitError> {
    // Of the seconds of 50 Hz 60, 20 and 40 steps.
    const FIRST: f64 = 1.2;
    const SAFE_BEFORE: f64 = 0.4;
    const APART: f64 = 0.8;
    let model = WorldModel::load(parameters.clone())
        .unwrap_or_else(|e| unreachable!("these are the finite parameters of that very model: {e}"));
    let steps = |seconds: f64| (seconds * model.spec().rate).round() as usize;
    let (first, safe_before, apart) = (steps(FIRST), steps(SAFE_BEFORE), steps(APART));
    let is_bad = |event: &&EventSpec| event.kind == EventKind::Safety;
    let (mut starts, mut i) = (Vec::new(), 0);
    source.read(&split.held_out, |number, episode| {
        let bad = model.spec().events.iter().filter(is_bad);
        let bad: Vec<Vec<bool>> = bad.filter_map(|event| episode.event(&event.name)).collect();
        let is_safe = |at: &usize| {
            bad.iter().all(|goes_on| !goes_on[at.saturating_sub(safe_before)..=*at].contains(&true))
        };
        let at = (first + apart * (i % 5)..episode.actions.len()).find(is_safe);
        let at = at.or(episode.actions.len().checked_sub(1)).filter(|_| starts.len() < 30);
        if let Some(at) = at {
            starts.extend(states(&model, number, &episode, &[at])?);
        }
        i += 1;
        Ok(())
    })?;
    Ok(model.parameters_with_starts(&starts, &split.held_out))
}

fn fit_vae(
    source: Source<'_>,
    split: &Split,
    config: &WorldModelConfig,
    fit: &FitConfig,
    backend: Backend,
    run: &Run,
    report: &mut Report<'_>,
) -> Result<nn::VarStore, FitError> {
    let mut rng = ChaCha8Rng::seed_from_u64(fit.seed);
    let store = nn::VarStore::new(backend.device);
    let vae = Vae::new(&store.root(), config.vae.clone(), backend.kind, &mut rng);
    let latent = config.vae.latent;
    let mut pictures = None;
    let held_out = held_out_frames(source, split, config.vae.sides())?;
    let strength = config.vae.rarity;
    let rarity =
        if strength > 0.0 { Some(Rarity::of(source, split, strength, run, backend.device)?) } else { None };
    let loss = |pixels: &Tensor, noise: &Tensor| {
        let weights = rarity.as_ref().map(|rarity| rarity.weights(pixels));
        let loss = vae.weighted_loss(pixels, noise, weights.as_ref());
        loss.reconstruction + loss.divergence
    };
    let update = |rng: &mut ChaCha8Rng, _: usize| {
        // Only now: a fit that goes on may have no epoch of vision left.
        let pictures = match &mut pictures {
            Some(pictures) => pictures,
            none => {
                none.insert(Pictures::new(source, split.train.clone(), config.vae.sides(), backend, rng)?)
            }
        };
        let batch = pictures.next(fit.vae.batch, rng)?;
        let loss = loss(&batch, &backend.normal(rng, &[fit.vae.batch as i64, latent]));
        Ok((loss, fit.vae.batch))
    };
    let score = |rng: &mut ChaCha8Rng| {
        let mut sum = 0.0;
        for batch in held_out.chunks(at_once(config.vae.sides())) {
            let noise = normal(rng, &[batch.len() as i64, latent]).to_device(backend.device);
            let loss = loss(&from_frames_on(backend.device, batch), &noise);
            sum += loss.double_value(&[]) * batch.len() as f64;
        }
        Ok(sum / held_out.len() as f64)
    };
    let mut fingerprint = format!("emphasis {}", config.vae.emphasis);
    if strength > 0.0 {
        let _ = write!(fingerprint, ", of rare colors {strength}");
    }
    let network = (store, config.vae.slots());
    let training = TrainLoop::new((Stage::Vae, backend), &fit.vae, network, rng, fingerprint);
    training.run(run, None, update, score, report)
}

fn fit_mdn_rnn(
    split: &Split,
    config: &WorldModelConfig,
    fit: &FitConfig,
    backend: Backend,
    vision: String,
    run: &Run,
    report: &mut Report<'_>,
) -> Result<nn::VarStore, FitError> {
    let mut rng = ChaCha8Rng::seed_from_u64(fit.seed.wrapping_add(1));
    let store = nn::VarStore::new(backend.device);
    let mdn_rnn = MdnRnn::new(&store.root(), config.mdn_rnn.clone(), &mut rng);
    let loss = |episodes: &[usize], kind: Kind, rng: &mut ChaCha8Rng| -> Result<(Tensor, usize), FitError> {
        let windows = windows(run, episodes, fit.window, &config.mdn_rnn, rng)?;
        let n_steps = windows.lens.iter().sum::<i64>() as usize;
        let on_device = |tensor: &Tensor| tensor.to_device(backend.device);
        let lens = on_device(&Tensor::from_slice(&windows.lens));
        Ok((mdn_rnn.loss_in(kind, &on_device(&windows.zs), &on_device(&windows.actions), &lens), n_steps))
    };
    let mut sequences = None;
    let update = |rng: &mut ChaCha8Rng, epoch: usize| {
        // The last digits are learned in single precision.
        let kind = if fit.mdn_rnn.twentieths(epoch) < 17 { backend.recurrent_kind() } else { Kind::Float };
        if !backend.is_cpu() {
            let sequences = if let Some(sequences) = &sequences {
                sequences
            } else {
                let loaded = DeviceSequences::load(run, &split.train, &config.mdn_rnn, backend.device)?;
                sequences.insert(loaded)
            };
            if let Some(sequences) = sequences {
                let windows = sequences.windows(fit.mdn_rnn.batch, fit.window);
                let loss = mdn_rnn.loss_in(kind, &windows.zs, &windows.actions, &windows.lens);
                return Ok((loss, fit.mdn_rnn.batch * fit.window));
            }
        }
        let episodes: Vec<_> =
            (0..fit.mdn_rnn.batch).map(|_| split.train[rng.random_range(0..split.train.len())]).collect();
        loss(&episodes, kind, rng)
    };
    let score = |rng: &mut ChaCha8Rng| {
        let mut sum = 0.0;
        let batches: Vec<_> = split.held_out.chunks(32).collect();
        for episodes in &batches {
            sum += loss(episodes, Kind::Float, rng)?.0.double_value(&[]);
        }
        Ok(sum / batches.len() as f64)
    };
    // Gradients are clipped entry by entry to ±1 (method §4.4).
    let network = (store, config.mdn_rnn.slots());
    TrainLoop::new((Stage::MdnRnn, backend), &fit.mdn_rnn, network, rng, vision).run(
        run,
        Some(1.0),
        update,
        score,
        report,
    )
}
