//! The replay buffer: whole episodes, each picture once, and samples that are shifted by chance.
//!
//! An episode comes into it when it is over, as published. A stack never reaches before its episode's first picture, which
//! stands in for those before it, and a sum of rewards never beyond its last action. Where the buffer is full, the oldest
//! episodes go.

use std::collections::VecDeque;

use rand::{Rng, RngExt as _};
use tch::{Device, Tensor};

use super::DrqConfig;
use crate::tensor::from_slice;
use crate::world::{Frame, Size};

/// What a file of an episode begins with.
const MAGIC: &[u8; 8] = b"drqv2ep1";
/// Bytes of what comes after it: height, width, A, number of actions, and whether it was terminated.
const HEAD: usize = 5 * 4;

/// Why a file is no episode.
#[derive(Debug, thiserror::Error)]
#[error("this is no whole episode of the replay buffer ({0}); begin the job anew, without `--resume`")]
pub struct ReplayError(&'static str);

/// What was seen, done and rewarded from a reset on.
#[derive(Clone, Debug, PartialEq)]
pub struct Episode {
    size: Size,
    n_axes: usize,
    /// One picture more than actions, `[n + 1, H, W, 3]`.
    pixels: Vec<u8>,
    /// In `[-1, 1]`, `[n, A]`.
    actions: Vec<f32>,
    /// Of each action, summed over the steps for which it was held.
    rewards: Vec<f32>,
    /// Whether what happened ended it, so that nothing more was to be had.
    is_terminated: bool,
}

impl Episode {
    /// One that begins with this picture.
    pub fn begin(first: &Frame, n_axes: usize) -> Self {
        Self {
            size: first.size(),
            n_axes,
            pixels: first.rgb().to_vec(),
            actions: Vec::new(),
            rewards: Vec::new(),
            is_terminated: false,
        }
    }

    /// Adds an action in `[-1, 1]`, what it brought, and what is seen after it.
    ///
    /// # Panics
    /// Where the action or the picture is of another size.
    pub fn push(&mut self, action: &[f32], reward: f32, seen: &Frame, is_terminated: bool) {
        assert_eq!((action.len(), seen.size()), (self.n_axes, self.size), "one world throughout");
        self.actions.extend(action);
        self.rewards.push(reward);
        self.pixels.extend(seen.rgb());
        self.is_terminated = is_terminated;
    }

    /// How many actions it has.
    pub fn len(&self) -> usize {
        self.rewards.len()
    }

    /// Whether it has none.
    pub fn is_empty(&self) -> bool {
        self.rewards.is_empty()
    }

    fn n_bytes(&self) -> usize {
        3 * self.size.height as usize * self.size.width as usize
    }

    /// The picture before the action of this number, or after the last.
    fn picture(&self, t: usize) -> &[u8] {
        let n = self.n_bytes();
        &self.pixels[t * n..(t + 1) * n]
    }

    /// The numbers of the `k` pictures that are seen at `t`, the oldest first.
    ///
    /// ```
    /// use dropj::drqv2::Episode;
    ///
    /// assert_eq!(Episode::stack(5, 3).collect::<Vec<_>>(), [3, 4, 5]);
    /// assert_eq!(Episode::stack(1, 3).collect::<Vec<_>>(), [0, 0, 1]);
    /// ```
    pub fn stack(t: usize, k: usize) -> impl Iterator<Item = usize> {
        (0..k).map(move |i| (t + 1 + i).saturating_sub(k))
    }

    /// As it lies in a file: numbers little-endian, pictures in an LZ4 block with its size before it.
    ///
    /// ```text
    /// "drqv2ep1" · height, width, A, n, terminated: u32 · actions: f32 [n, A] · rewards: f32 [n] · pictures
    /// ```
    pub fn to_bytes(&self) -> Vec<u8> {
        let numbers = [
            self.size.height,
            self.size.width,
            self.n_axes as u32,
            self.len() as u32,
            u32::from(self.is_terminated),
        ];
        let mut bytes = MAGIC.to_vec();
        bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
        bytes.extend(self.actions.iter().chain(&self.rewards).flat_map(|number| number.to_le_bytes()));
        bytes.extend(lz4_flex::compress_prepend_size(&self.pixels));
        bytes
    }

    /// The way back of [`Self::to_bytes`].
    ///
    /// # Errors
    /// Where the bytes are not those of an episode.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, ReplayError> {
        let rest = bytes.strip_prefix(MAGIC).ok_or(ReplayError("it begins otherwise"))?;
        let (head, rest) = rest.split_at_checked(HEAD).ok_or(ReplayError("it is cut short"))?;
        let numbers: Vec<u32> = head.as_chunks().0.iter().map(|bytes| u32::from_le_bytes(*bytes)).collect();
        let [height, width, n_axes, n, is_terminated] = numbers[..] else {
            return Err(ReplayError("it is cut short"));
        };
        let [n_rows, n_columns, n_axes, n] = [height, width, n_axes, n].map(|number| number as usize);
        let count = |a: usize, b: usize| a.checked_mul(b).ok_or(ReplayError("it is too large"));
        let n_floats = count(count(n, n_axes + 1)?, 4)?;
        let (floats, rest) = rest.split_at_checked(n_floats).ok_or(ReplayError("it is cut short"))?;
        let mut actions: Vec<f32> =
            floats.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
        let rewards = actions.split_off(n * n_axes);
        let n_bytes = count(count(n_rows, n_columns)?, 3 * (n + 1))?;
        // Before anything is allocated.
        if rest.first_chunk().is_none_or(|told| u32::from_le_bytes(*told) as usize != n_bytes) {
            return Err(ReplayError("its pictures are of another size"));
        }
        let pixels = lz4_flex::decompress_size_prepended(rest).ok().filter(|pixels| pixels.len() == n_bytes);
        let pixels = pixels.ok_or(ReplayError("its pictures are damaged"))?;
        let size = Size { height, width };
        Ok(Self { size, n_axes, pixels, actions, rewards, is_terminated: is_terminated != 0 })
    }
}

/// The discounted sum of `rewards`, and what the value after them is multiplied by: nothing where the episode was
/// terminated with them.
///
/// ```text
/// Σ_{i<n} γ^i r_i   and   γ^n
/// ```
///
/// ```
/// use dropj::drqv2::n_step_return;
///
/// assert_eq!(n_step_return(&[1.0, 2.0, 4.0], 0.5, false), [3.0, 0.125]);
/// assert_eq!(n_step_return(&[1.0, 2.0, 4.0], 0.5, true), [3.0, 0.0]);
/// ```
pub fn n_step_return(rewards: &[f32], discount: f64, is_terminated: bool) -> [f32; 2] {
    let (sum, factor) = rewards
        .iter()
        .fold((0.0, 1.0), |(sum, factor), reward| (sum + factor * f64::from(*reward), factor * discount));
    [sum as f32, if is_terminated { 0.0 } else { factor as f32 }]
}

/// Samples for an update.
#[derive(Debug)]
pub struct Batch {
    /// What is seen, `[B, 3 k, H, W]`, bytes, shifted.
    pub pixels: Tensor,
    /// What is done, `[B, A]`, in `[-1, 1]`.
    pub actions: Tensor,
    /// The discounted sum of n rewards, `[B, 1]`.
    pub rewards: Tensor,
    /// What the value of what is seen then is multiplied by, `[B, 1]`.
    pub discounts: Tensor,
    /// What is seen n actions later, shifted otherwise.
    pub next_pixels: Tensor,
}

/// Episodes to learn from.
#[derive(Debug, Default)]
pub struct Replay {
    /// With their numbers, the oldest first.
    episodes: VecDeque<(u64, Episode)>,
    n_actions: usize,
}

impl Replay {
    /// Adds the episode of this number, if it is long enough to be sampled, and lets go of the oldest ones for which there
    /// is no more room. Their numbers.
    pub fn push(&mut self, number: u64, episode: Episode, config: &DrqConfig) -> Vec<u64> {
        let mut gone = Vec::new();
        if !Self::takes(&episode, config) {
            return gone;
        }
        while self.n_actions + episode.len() > config.capacity
            && let Some((number, oldest)) = self.episodes.pop_front()
        {
            self.n_actions -= oldest.len();
            gone.push(number);
        }
        self.n_actions += episode.len();
        self.episodes.push_back((number, episode));
        gone
    }

    /// Whether an episode is long enough to be sampled.
    pub fn takes(episode: &Episode, config: &DrqConfig) -> bool {
        episode.len() >= config.n_step
    }

    /// How many actions it holds.
    pub fn len(&self) -> usize {
        self.n_actions
    }

    /// Whether there is nothing to sample.
    pub fn is_empty(&self) -> bool {
        self.episodes.is_empty()
    }

    /// The numbers of the episodes that it holds.
    pub fn numbers(&self) -> impl Iterator<Item = u64> {
        self.episodes.iter().map(|(number, _)| *number)
    }

    /// Samples: an episode by chance, a time in it by chance, and a shift of what is seen then and n actions later.
    ///
    /// `// DIFFERENCE:` the published program samples in four processes, each of which has a quarter of the episodes and looks
    /// for new ones once in a while. Here an episode can be sampled as soon as it is over.
    ///
    /// # Panics
    /// Where there is nothing.
    pub fn sample(&self, config: &DrqConfig, device: Device, rng: &mut impl Rng) -> Batch {
        assert!(!self.is_empty(), "there is something to sample");
        let (size, n_axes) = (self.episodes[0].1.size, self.episodes[0].1.n_axes);
        let (b, k) = (config.batch, config.stack);
        let n_bytes = b * k * self.episodes[0].1.n_bytes();
        let (mut now, mut next) = (Vec::with_capacity(n_bytes), Vec::with_capacity(n_bytes));
        let (mut actions, mut rewards, mut discounts) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..b {
            let (_, episode) = &self.episodes[rng.random_range(0..self.episodes.len())];
            let t = rng.random_range(0..=episode.len() - config.n_step);
            let end = t + config.n_step;
            for (at, pixels) in [(t, &mut now), (end, &mut next)] {
                let mut shift = || rng.random_range(0..=2 * config.shift) as i64 - config.shift as i64;
                let shift = [shift(), shift()];
                for i in Episode::stack(at, k) {
                    shifted(episode.picture(i), size, shift, pixels);
                }
            }
            actions.extend(&episode.actions[t * n_axes..(t + 1) * n_axes]);
            let is_terminated = episode.is_terminated && end == episode.len();
            let [sum, factor] = n_step_return(&episode.rewards[t..end], config.discount, is_terminated);
            rewards.push(sum);
            discounts.push(factor);
        }
        let numbers =
            |values: &[f32], width: usize| from_slice(values, &[b as i64, width as i64]).to_device(device);
        Batch {
            pixels: stacked(&now, [b, k], size, device),
            actions: numbers(&actions, n_axes),
            rewards: numbers(&rewards, 1),
            discounts: numbers(&discounts, 1),
            next_pixels: stacked(&next, [b, k], size, device),
        }
    }
}

/// Pictures as the encoder takes them.
///
/// # Shapes
/// - `pixels`: `[B, k, H, W, 3]`
/// - returns `[B, 3 k, H, W]`, bytes
pub(super) fn stacked(pixels: &[u8], [b, k]: [usize; 2], size: Size, device: Device) -> Tensor {
    let [b, k, height, width] = [b as i64, k as i64, i64::from(size.height), i64::from(size.width)];
    let pixels = Tensor::from_slice(pixels).view([b, k, height, width, 3]).to_device(device);
    pixels.permute([0, 1, 4, 2, 3]).reshape([b, 3 * k, height, width])
}

/// Appends a picture as it is seen so many rows and columns further down and to the right; beyond its edges they go on.
///
/// This is the published augmentation: pictures are padded by what is at their edges, and sampled with bilinear
/// interpolation at whole pixels, so that what is sampled are the pixels themselves.
pub(super) fn shifted(picture: &[u8], size: Size, [down, right]: [i64; 2], to: &mut Vec<u8>) {
    let (height, width) = (i64::from(size.height), i64::from(size.width));
    let (before, after) = ((-right).clamp(0, width), right.clamp(0, width));
    for y in 0..height {
        let start = 3 * width * (y + down).clamp(0, height - 1);
        let row = &picture[start as usize..(start + 3 * width) as usize];
        let (first, last) = (&row[..3], &row[row.len() - 3..]);
        (0..before).for_each(|_| to.extend_from_slice(first));
        to.extend_from_slice(&row[3 * after as usize..3 * (width - before) as usize]);
        (0..after).for_each(|_| to.extend_from_slice(last));
    }
}
