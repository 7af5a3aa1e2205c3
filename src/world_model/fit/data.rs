//! What the networks are trained on: frames of several episodes mixed, and windows of encoded ones.

use rand::seq::SliceRandom as _;
use rand::{Rng, RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use tch::{Device, Kind, Tensor, nn};

use crate::dataset::Dataset;
use crate::env::{Action, Frame};
use crate::run::Run;
use crate::tensor::{Parameters, ParametersError, from_frames, normal};
use crate::world_model::fit::{FitError, Progress, Report, Stage};
use crate::world_model::{Vae, WorldModelConfig, actions_tensor, fast_kind};

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

/// Two thousand frames of held-out episodes, evenly spread: enough to tell epochs apart.
pub(super) fn held_out_frames(dataset: &Dataset, split: &Split) -> Result<Vec<Frame>, FitError> {
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
pub(super) struct ShuffledFrames<'a> {
    dataset: &'a Dataset,
    train: Vec<usize>,
    /// Episodes still to come in this pass.
    queue: Vec<usize>,
    pool: Vec<Frame>,
}

impl<'a> ShuffledFrames<'a> {
    /// How many episodes are mixed. Some 20 MB each.
    const N_MIXED: usize = 16;

    pub(super) fn new(dataset: &'a Dataset, train: Vec<usize>) -> Self {
        Self { dataset, train, queue: Vec::new(), pool: Vec::new() }
    }

    /// The next `n` frames.
    pub(super) fn next(&mut self, n: usize, rng: &mut impl Rng) -> Result<Vec<Frame>, FitError> {
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

/// Keeps the latents of every episode in `run`, so that the memory's training holds only its batch. Those of another
/// vision are made anew.
pub(super) fn encode(
    dataset: &Dataset,
    config: &WorldModelConfig,
    vision: &Parameters,
    run: &Run,
    report: &mut Report<'_>,
) -> Result<(), FitError> {
    let store = nn::VarStore::new(Device::Cpu);
    let vae = Vae::new(&store.root(), config.vae.clone(), Kind::Float, &mut ChaCha8Rng::seed_from_u64(0));
    vision.load("net", &store)?;
    let of = vision.hash();
    // Noise is added to these anyway. The quick arithmetic is exact enough, and there are a great many.
    let vae = vae.for_inference(fast_kind());
    let n = dataset.n_episodes();
    for i in 0..n {
        let there = run.load(&latents_name(i))?.and_then(|latents| latents.metadata("vision"));
        if there.as_ref() != Some(&of) {
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
            run.save(&latents_name(i), &Parameters::from_tensors(encoded, &[("vision", of.clone())]))?;
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

fn encoded(run: &Run, episode: usize, latent: i64) -> Result<Encoded, FitError> {
    let name = latents_name(episode);
    let missing = |what: &str| ParametersError::Missing(format!("{what} of {name}"));
    let saved = run.load(&name)?.ok_or_else(|| missing("all"))?;
    let part = |what: &str| saved.finite(what)?.ok_or_else(|| missing(what));
    let encoded = Encoded { mean: part("mean")?, log_var: part("log_var")?, actions: part("actions")? };
    let Encoded { mean, log_var, actions } = &encoded;
    let [t, z] = mean.size()[..] else { return Err(missing("latents").into()) };
    for (name, part, wanted) in [
        ("log_var", log_var, [t, z]),
        ("actions", actions, [t, Action::LEN as i64]),
        ("mean", mean, [t, latent]),
    ] {
        if part.size() != wanted {
            let (name, found) = (format!("{name} of {}", latents_name(episode)), part.size());
            return Err(ParametersError::Shape { name, found, wanted: wanted.to_vec() }.into());
        }
    }
    Ok(encoded)
}

/// Windows of episodes, padded with zeros to the same length.
pub(super) struct Windows {
    /// Drawn latents, `[B, T, Z]`: the same draw is target at t and input at t + 1.
    pub zs: Tensor,
    /// `[B, T, A]`.
    pub actions: Tensor,
    /// Steps of each that are not padding.
    pub lens: Vec<i64>,
}

/// One window of at most `window` steps from each of `episodes`, its start uniform.
pub(super) fn windows(
    run: &Run,
    episodes: &[usize],
    window: usize,
    latent: i64,
    rng: &mut ChaCha8Rng,
) -> Result<Windows, FitError> {
    let (mut zs, mut actions, mut lens) = (Vec::new(), Vec::new(), Vec::new());
    for &episode in episodes {
        let Encoded { mean, log_var, actions: all } = encoded(run, episode, latent)?;
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
