//! What the networks are trained on: frames of several episodes mixed, and windows of encoded ones.
//!
//! On an accelerator all of it lies there from the start, as far as its memory goes, and batches are drawn there.

use rand::seq::SliceRandom as _;
use rand::{Rng, RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use tch::{Device, Kind, Tensor, nn};

use crate::dataset::{Dataset, Episode};
use crate::run::Run;
use crate::tensor::{
    Backend, Parameters, ParametersError, bytes_of_frames, from_frames_on, intensities, normal,
};
use crate::world::Frame;
use crate::world_model::fit::{FitError, Progress, Report, Stage};
use crate::world_model::{MdnRnnConfig, Vae, WorldModelConfig, actions_tensor};

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
        let n_held_out = ((n as f64 * held_out).round() as usize).max(1).min(n.saturating_sub(1));
        let train = all.split_off(n_held_out);
        Self { train, held_out: all }
    }
}

/// Whoever takes episodes as they are read, each with its index. An error ends the reading.
pub type Take<'a> = dyn FnMut(usize, Episode) -> Result<(), FitError> + 'a;

/// Reads the episodes of some indices, and hands them over in that order.
pub type ReadEpisodes = dyn Fn(&Dataset, &[usize], &mut Take<'_>) -> Result<(), FitError>;

/// The plainest [`ReadEpisodes`].
pub fn read_one_by_one(dataset: &Dataset, episodes: &[usize], take: &mut Take<'_>) -> Result<(), FitError> {
    episodes.iter().try_for_each(|&i| take(i, dataset.episode(i)?))
}

/// Recordings, and how they are read.
#[derive(Clone, Copy)]
pub(super) struct Source<'a> {
    pub(super) dataset: &'a Dataset,
    pub(super) read: &'a ReadEpisodes,
}

impl Source<'_> {
    /// Reads the episodes of these indices.
    pub(super) fn read(
        self,
        episodes: &[usize],
        mut take: impl FnMut(usize, Episode) -> Result<(), FitError>,
    ) -> Result<(), FitError> {
        (self.read)(self.dataset, episodes, &mut take)
    }
}

/// Bytes of a picture of these sides.
fn bytes_of([height, width]: [i64; 2]) -> usize {
    (3 * height * width) as usize
}

/// Pictures that are computed with at once where nothing is learned: a hundred, or fewer of more than 128 x 128 pixels.
pub(super) fn at_once(sides: [i64; 2]) -> usize {
    (100 * bytes_of([128; 2]) / bytes_of(sides)).clamp(1, 100)
}

/// Two thousand frames of held-out episodes, evenly spread: enough to tell epochs apart. Fewer where they would take more
/// than half a gigabyte.
pub(super) fn held_out_frames(
    source: Source<'_>,
    split: &Split,
    sides: [i64; 2],
) -> Result<Vec<Frame>, FitError> {
    const MOST_BYTES: usize = 1 << 29;
    let mut kept = Vec::new();
    let per_episode = 2000.min(MOST_BYTES / bytes_of(sides)).div_ceil(split.held_out.len());
    source.read(&split.held_out, |_, Episode { frames, .. }| {
        let every = frames.len().div_ceil(per_episode).max(1);
        kept.extend(frames.into_iter().step_by(every));
        Ok(())
    })?;
    Ok(kept)
}

/// The pictures that vision is trained on.
pub(super) enum Pictures<'a> {
    /// Those of a few episodes at a time, in memory.
    Mixed(ShuffledFrames<'a>, Device),
    /// Those of as many episodes as the device holds, on the device.
    OnDevice(DeviceFrames<'a>),
}

impl<'a> Pictures<'a> {
    pub(super) fn new(
        source: Source<'a>,
        train: Vec<usize>,
        sides: [i64; 2],
        backend: Backend,
        rng: &mut impl Rng,
    ) -> Result<Self, FitError> {
        if !backend.is_cpu()
            && let Some(frames) = DeviceFrames::new(source, &train, sides, backend.device, rng)?
        {
            return Ok(Self::OnDevice(frames));
        }
        Ok(Self::Mixed(ShuffledFrames::new(source, train, sides), backend.device))
    }

    /// The next `n`, as intensities.
    ///
    /// # Shapes
    /// - returns `[n, H, W, 3]`
    pub(super) fn next(&mut self, n: usize, rng: &mut impl Rng) -> Result<Tensor, FitError> {
        match self {
            Self::Mixed(frames, device) => Ok(from_frames_on(*device, &frames.next(n, rng)?)),
            Self::OnDevice(frames) => frames.next(n, rng),
        }
    }
}

/// Frames on a device in an order that mixes all episodes which are there. If not all have room they come by turns.
pub(super) struct DeviceFrames<'a> {
    source: Source<'a>,
    train: Vec<usize>,
    /// Episodes still to come in this pass. Empty where all are there.
    queue: Vec<usize>,
    /// `[N, H, W, 3]` bytes.
    pixels: Tensor,
    /// How many of them are filled.
    n: i64,
    /// The order of this pass over the filled ones, and how far it has come.
    order: Tensor,
    at: i64,
}

impl<'a> DeviceFrames<'a> {
    /// Bytes that are left for all else.
    const ROOM: i64 = 6 << 30;

    /// Nothing where the device has no room for a few episodes.
    pub(super) fn new(
        source: Source<'a>,
        train: &[usize],
        [height, width]: [i64; 2],
        device: Device,
        rng: &mut impl Rng,
    ) -> Result<Option<Self>, FitError> {
        let n_frames = |i: &usize| source.dataset.len(*i) as i64 + 1;
        let longest = train.iter().map(n_frames).max().unwrap_or_default();
        let mut capacity: i64 = train.iter().map(n_frames).sum();
        // There is no asking how much memory is left, but trying.
        let pixels = loop {
            let room =
                Tensor::f_empty([Self::ROOM.min(capacity * 3 * height * width)], (Kind::Uint8, device));
            let pixels = Tensor::f_empty([capacity, height, width, 3], (Kind::Uint8, device));
            match (room, pixels) {
                (Ok(_), Ok(pixels)) => break pixels,
                _ if capacity / 2 < 4 * longest => return Ok(None),
                _ => capacity /= 2,
            }
        };
        let order = Tensor::empty([0], (Kind::Int64, device));
        let (train, queue) = (train.to_vec(), Vec::new());
        let mut frames = Self { source, train, queue, pixels, n: 0, order, at: 0 };
        frames.fill(rng)?;
        Ok(Some(frames))
    }

    /// Fills the pixels with the next episodes.
    fn fill(&mut self, rng: &mut impl Rng) -> Result<(), FitError> {
        if self.queue.is_empty() {
            self.queue.clone_from(&self.train);
            self.queue.shuffle(rng);
        }
        let capacity = self.pixels.size()[0];
        let (mut chosen, mut n) = (Vec::new(), 0);
        while let Some(&i) = self.queue.last() {
            n += self.source.dataset.len(i) as i64 + 1;
            if n > capacity {
                break;
            }
            chosen.extend(self.queue.pop());
        }
        self.n = 0;
        self.source.read(&chosen, |_, Episode { frames, .. }| {
            let n = (frames.len() as i64).min(capacity - self.n);
            let bytes = bytes_of_frames(&frames).narrow(0, 0, n);
            self.pixels.narrow(0, self.n, n).copy_(&bytes);
            self.n += n;
            Ok(())
        })
    }

    /// The next `n` frames, as intensities.
    pub(super) fn next(&mut self, n: usize, rng: &mut impl Rng) -> Result<Tensor, FitError> {
        let (n, options) = (n as i64, (Kind::Int64, self.pixels.device()));
        if self.at + n > self.order.size()[0] {
            if !self.queue.is_empty() && self.order.size()[0] > 0 {
                self.fill(rng)?;
            }
            // Where there are fewer than a batch, some are in it twice.
            let passes: Vec<_> = (0..=n / self.n).map(|_| Tensor::randperm(self.n, options)).collect();
            self.order = if n > self.n { Tensor::cat(&passes, 0) } else { Tensor::randperm(self.n, options) };
            self.at = 0;
        }
        let batch = self.order.narrow(0, self.at, n);
        self.at += n;
        Ok(intensities(&self.pixels.index_select(0, &batch)))
    }
}

/// Frames in an order that mixes several episodes, of which only those are in memory.
pub(super) struct ShuffledFrames<'a> {
    source: Source<'a>,
    train: Vec<usize>,
    n_mixed: usize,
    /// Episodes still to come in this pass.
    queue: Vec<usize>,
    pool: Vec<Frame>,
}

impl<'a> ShuffledFrames<'a> {
    /// How many episodes are mixed. Of Car Racing some 20 MB each.
    const N_MIXED: usize = 16;
    /// What they take at the most, of those that are as long as the longest.
    const MOST_BYTES: usize = 1 << 30;

    fn new(source: Source<'a>, train: Vec<usize>, sides: [i64; 2]) -> Self {
        let longest = train.iter().map(|&i| source.dataset.len(i) + 1).max().unwrap_or(1);
        let room = Self::MOST_BYTES / (longest * bytes_of(sides)).max(1);
        let n_mixed = Self::N_MIXED.min(train.len()).min(room.max(1));
        Self { source, train, n_mixed, queue: Vec::new(), pool: Vec::new() }
    }

    /// The next `n` frames.
    fn next(&mut self, n: usize, rng: &mut impl Rng) -> Result<Vec<Frame>, FitError> {
        let mut batch = Vec::with_capacity(n);
        while batch.len() < n {
            if self.pool.is_empty() {
                let mut chosen = Vec::new();
                for _ in 0..self.n_mixed {
                    if self.queue.is_empty() {
                        self.queue.clone_from(&self.train);
                        self.queue.shuffle(rng);
                    }
                    chosen.extend(self.queue.pop());
                }
                let pool = &mut self.pool;
                self.source.read(&chosen, |_, Episode { frames, .. }| {
                    pool.extend(frames);
                    Ok(())
                })?;
                self.pool.shuffle(rng);
            }
            let rest = self.pool.len().saturating_sub(n - batch.len());
            batch.extend(self.pool.drain(rest..));
        }
        Ok(batch)
    }
}

/// Keeps the latents of every episode of the split in `run`, so that the memory's training holds only its batch. Those of
/// another vision are made anew.
pub(super) fn encode(
    source: Source<'_>,
    split: &Split,
    config: &WorldModelConfig,
    (backend, vision): (Backend, &Parameters),
    run: &Run,
    report: &mut Report<'_>,
) -> Result<(), FitError> {
    let store = nn::VarStore::new(backend.device);
    let vae = Vae::new(&store.root(), config.vae.clone(), Kind::Float, &mut ChaCha8Rng::seed_from_u64(0));
    vision.load("net", &store)?;
    let of = vision.hash();
    // Noise is added to these anyway. The quick arithmetic is exact enough, and there are a great many.
    let encoder = vae.encoder.for_inference(if backend.is_cpu() { backend.kind } else { Kind::Float });
    let mut episodes = [&split.train[..], &split.held_out].concat();
    episodes.sort_unstable();
    let mut done = 0;
    let mut encoded = || {
        done += 1;
        let progress = Progress {
            stage: Stage::Encode,
            epoch: 0,
            max_epochs: 1,
            done,
            n: episodes.len(),
            items: 1000,
            loss: 0.0,
            held_out: None,
            learning_rate: 0.0,
            is_best: false,
        };
        if report(&progress).is_break() { Err(FitError::Stopped) } else { Ok(()) }
    };
    let mut missing = Vec::new();
    for &i in &episodes {
        let there = run.load(&latents_name(i))?.and_then(|latents| latents.metadata("vision"));
        if there.as_ref() == Some(&of) {
            encoded()?;
        } else {
            missing.push(i);
        }
    }
    source.read(&missing, |i, episode| {
        let encode = |chunk: &[Frame]| encoder.encode(&from_frames_on(backend.device, chunk));
        let parts: Vec<_> =
            tch::no_grad(|| episode.frames.chunks(at_once(config.vae.sides())).map(encode).collect());
        let (means, log_vars): (Vec<_>, Vec<_>) = parts.into_iter().unzip();
        // Actions and latents of the same steps: a closing frame without an action is left out.
        let t = episode.actions.len() as i64;
        let latents = [
            ("mean".to_owned(), Tensor::cat(&means, 0).narrow(0, 0, t)),
            ("log_var".to_owned(), Tensor::cat(&log_vars, 0).narrow(0, 0, t)),
            ("actions".to_owned(), actions_tensor(&episode.actions).view([t, config.mdn_rnn.actions])),
        ];
        run.save(&latents_name(i), &Parameters::from_tensors(latents, &[("vision", of.clone())]))?;
        encoded()
    })
}

/// The latents of an episode's steps: the encoder's means.
pub(super) fn means(run: &Run, episode: usize, memory: &MdnRnnConfig) -> Result<Tensor, FitError> {
    Ok(encoded(run, episode, memory)?.mean)
}

/// Encoded episodes on a device, one after the other.
pub(super) struct DeviceSequences {
    /// `[N, Z]`.
    mean: Tensor,
    log_var: Tensor,
    /// `[N, A]`.
    actions: Tensor,
    /// Where each begins, `[E]`.
    first: Tensor,
    /// How many steps each has, `[E]`.
    len: Tensor,
}

impl DeviceSequences {
    /// The latents of `episodes`, or nothing where the device has no room for them.
    pub(super) fn load(
        run: &Run,
        episodes: &[usize],
        memory: &MdnRnnConfig,
        device: Device,
    ) -> Result<Option<Self>, FitError> {
        let all = episodes.iter().map(|&i| encoded(run, i, memory)).collect::<Result<Vec<_>, _>>()?;
        let lens: Vec<i64> = all.iter().map(|one| one.mean.size()[0]).collect();
        let together = |part: fn(&Encoded) -> &Tensor| {
            let parts: Vec<_> = all.iter().map(part).collect();
            Tensor::cat(&parts, 0).f_to_device(device)
        };
        let parts = (together(|one| &one.mean), together(|one| &one.log_var), together(|one| &one.actions));
        let (Ok(mean), Ok(log_var), Ok(actions)) = parts else { return Ok(None) };
        Ok(Some(Self::of(mean, log_var, actions, &lens)))
    }

    /// Episodes of `lens` steps.
    pub(super) fn of(mean: Tensor, log_var: Tensor, actions: Tensor, lens: &[i64]) -> Self {
        let starts = lens.iter().scan(0, |start, len| Some(std::mem::replace(start, *start + len)));
        let on_device = |values: &[i64]| Tensor::from_slice(values).to_device(mean.device());
        let (first, len) = (on_device(&starts.collect::<Vec<_>>()), on_device(lens));
        Self { mean, log_var, actions, first, len }
    }

    /// One window of at most `window` steps from each of `n` episodes, drawn on the device as [`windows`] draws it.
    ///
    /// What is behind the end of an episode repeats its last step.
    pub(super) fn windows(&self, n: usize, window: usize) -> Windows<Tensor> {
        let (n, window, device) = (n as i64, window as i64, self.mean.device());
        let episodes = Tensor::randint(self.first.size()[0], [n], (Kind::Int64, device));
        let (first, len) = (self.first.index_select(0, &episodes), self.len.index_select(0, &episodes));
        let lens = len.clamp_max(window);
        let last = &len - &lens;
        let start = Tensor::rand([n], (Kind::Float, device)) * (&last + 1).to_kind(Kind::Float);
        let start = start.to_kind(Kind::Int64).minimum(&last) + first;
        let step =
            Tensor::arange(window, (Kind::Int64, device)).unsqueeze(0).minimum(&(&lens - 1).unsqueeze(1));
        let at = (start.unsqueeze(1) + step).view(-1);
        let rows = |all: &Tensor| all.index_select(0, &at).view([n, window, -1]);
        let (mean, log_var) = (rows(&self.mean), rows(&self.log_var));
        let zs = &mean + (log_var * 0.5).exp() * mean.randn_like();
        Windows { zs, actions: rows(&self.actions), lens }
    }
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

fn encoded(run: &Run, episode: usize, memory: &MdnRnnConfig) -> Result<Encoded, FitError> {
    let name = latents_name(episode);
    let missing = |what: &str| ParametersError::Missing(format!("{what} of {name}"));
    let saved = run.load(&name)?.ok_or_else(|| missing("all"))?;
    let part = |what: &str| saved.finite(what)?.ok_or_else(|| missing(what));
    let encoded = Encoded { mean: part("mean")?, log_var: part("log_var")?, actions: part("actions")? };
    let Encoded { mean, log_var, actions } = &encoded;
    let [t, z] = mean.size()[..] else { return Err(missing("latents").into()) };
    for (name, part, wanted) in [
        ("log_var", log_var, [t, z]),
        ("actions", actions, [t, memory.actions]),
        ("mean", mean, [t, memory.latent]),
    ] {
        if part.size() != wanted {
            let (name, found) = (format!("{name} of {}", latents_name(episode)), part.size());
            return Err(ParametersError::Shape { name, found, wanted: wanted.to_vec() }.into());
        }
    }
    Ok(encoded)
}

/// Windows of episodes, padded to the same length.
pub(super) struct Windows<L = Vec<i64>> {
    /// Drawn latents, `[B, T, Z]`: the same draw is target at t and input at t + 1.
    pub zs: Tensor,
    /// `[B, T, A]`.
    pub actions: Tensor,
    /// Steps of each that are not padding.
    pub lens: L,
}

/// One window of at most `window` steps from each of `episodes`, its start uniform, padded with zeros.
pub(super) fn windows(
    run: &Run,
    episodes: &[usize],
    window: usize,
    memory: &MdnRnnConfig,
    rng: &mut ChaCha8Rng,
) -> Result<Windows, FitError> {
    let (mut zs, mut actions, mut lens) = (Vec::new(), Vec::new(), Vec::new());
    for &episode in episodes {
        let Encoded { mean, log_var, actions: all } = encoded(run, episode, memory)?;
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
    Ok(Windows { zs: Tensor::stack(&zs, 0), actions: Tensor::stack(&actions, 0), lens })
}
