//! Signs that a dream has left the world behind: what can be measured without asking anybody, step by step.

use tch::{Kind, Tensor};

use crate::dream::{DreamEpisode, Rows};
use crate::tensor::{dims, from_slice, to_vec};
use crate::world::Frame;
use crate::world_model::{Memory, WorldModel};

/// How many signs there are.
pub const N_SIGNS: usize = 7;

/// What each of them is called, in their order.
///
/// | sign | of a step |
/// |---|---|
/// | reencoding | how far its latents move when they are decoded and encoded again, ‖enc(dec(z)) − z‖ / √Z |
/// | entropy | how undecided the memory was about it: the mean over coordinates of Σ π (log σ − log π) |
/// | surprise | how unlikely its latents were, in nats a coordinate |
/// | norm | how far its latents lie from the middle of all that was ever encoded, ‖z‖ / √Z |
/// | stir | how far its picture differs from the one before, in `[0, 1]` |
/// | flicker | how far its picture differs from the mean of its neighbors, in `[0, 1]` |
/// | startle | how far its picture differs from that of what the memory expected, in `[0, 1]` |
pub const SIGNS: [&str; N_SIGNS] =
    ["reencoding", "entropy", "surprise", "norm", "stir", "flicker", "startle"];

/// Steps that are looked at together.
const BATCH: usize = 50;

impl DreamEpisode {
    /// The signs of every step, `[T, 7]`, as [`SIGNS`] names them.
    ///
    /// Nothing comes where `go_on` says no, which is asked before every fifty steps.
    pub fn signs(&self, model: &WorldModel, mut go_on: impl FnMut() -> bool) -> Option<Rows> {
        let features = self.features(model);
        let mut signs = Rows { width: N_SIGNS, values: Vec::new() };
        for begin in (0..self.len()).step_by(BATCH) {
            if !go_on() {
                return None;
            }
            let end = (begin + BATCH).min(self.len());
            let rows = &features.values[begin * features.width..end * features.width];
            let rows = from_slice(rows, &[(end - begin) as i64, features.width as i64]);
            // With a neighbor on either side. The ends of the dream are their own.
            let last = self.len() - 1;
            let (first, after) = (begin.saturating_sub(1), end.min(last) + 1);
            let mut frames = self.frames(model, first..after);
            if begin == 0 {
                frames.insert(0, frames[0].clone());
            }
            if end > last {
                frames.push(frames[frames.len() - 1].clone());
            }
            signs.values.extend(to_vec(&tch::no_grad(|| batch(model, &rows, &frames))));
        }
        Some(signs)
    }
}

/// # Shapes
/// - `features`: `[B, F]`; `frames`: those of the same steps and of one on either side
/// - returns `[B, 7]`
fn batch(model: &WorldModel, features: &Tensor, frames: &[Frame]) -> Tensor {
    let (latent, m) = (model.config().mdn_rnn.latent, model.config().mdn_rnn.memory);
    let [b, _] = dims(features);
    let features = &features.to_device(model.backend().device);
    let z = features.narrow(1, 0, latent);
    // The memory before a step is what its latents were drawn from.
    let memory = Memory { c: features.narrow(1, latent, m), h: features.narrow(1, latent + m, m) };
    let expected = model.expect(&memory);
    let mean = |x: &Tensor| x.mean_dim(1, false, Kind::Float);
    let entropy = (expected.log_pi.exp() * (&expected.log_std - &expected.log_pi)).sum_dim_intlist(
        -1,
        false,
        Kind::Float,
    );
    let shown = &frames[1..=b as usize];
    let again = model.observe(shown);
    let expected_frames = model.decode(&expected.mean(1.0));
    let triples = frames.windows(3);
    let pixels = [
        triples.clone().map(|at| apart(&at[1], &at[0], &at[0])).collect::<Vec<_>>(),
        triples.map(|at| apart(&at[1], &at[0], &at[2])).collect(),
        shown.iter().zip(&expected_frames).map(|(one, other)| apart(one, other, other)).collect(),
    ];
    let [stir, flicker, startle] = pixels.map(|values| from_slice(&values, &[b]).to_device(z.device()));
    let reencoding = mean(&(again - &z).square()).sqrt();
    let surprise = mean(&expected.nll(&z));
    let norm = mean(&z.square()).sqrt();
    Tensor::stack(&[reencoding, mean(&entropy), surprise, norm, stir, flicker, startle], 1)
}

/// How far a picture differs from the mean of two others, in `[0, 1]`.
fn apart(one: &Frame, other: &Frame, third: &Frame) -> f32 {
    let bytes = one.rgb().iter().zip(other.rgb()).zip(third.rgb());
    let twice = |a: &u8| 2 * u32::from(*a);
    let sum: u32 = bytes.map(|((a, b), c)| twice(a).abs_diff(u32::from(*b) + u32::from(*c))).sum();
    sum as f32 / (2.0 * 255.0 * one.rgb().len() as f32)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::dream::Dream;
    use crate::world::Action;
    use crate::world_model::{LatentState, WorldModelConfig, untrained};

    #[test]
    fn signs_are_measured_step_by_step_over_the_borders_of_batches() {
        let rng = &mut ChaCha8Rng::seed_from_u64(3);
        let model = untrained(&WorldModelConfig::tiny(), rng);
        let start = LatentState { z: vec![0.1; 4], c: vec![0.2; 16], h: vec![0.3; 16] };
        let mut dream = Dream::new(&start, 3);
        (0..120).for_each(|t| dream.step(&model, Action::new([(t as f32).sin(), 0.5, 0.0]), rng).unwrap());
        let dream = dream.finish();
        let signs = dream.signs(&model, || true).unwrap();
        assert_eq!((signs.len(), signs.width), (120, N_SIGNS));
        assert!(signs.values.iter().all(|value| value.is_finite()), "all are numbers");
        let sign = |name, t: usize| signs.row(t)[SIGNS.iter().position(|sign| *sign == name).unwrap()];

        for t in [0_usize, 1, 49, 50, 51, 118, 119] {
            let frames = dream.frames(&model, t.saturating_sub(1)..(t + 2).min(120));
            let here = usize::from(t > 0);
            let (before, after) = (&frames[0], &frames[frames.len() - 1]);
            // A batch rounds pictures differently, but little.
            assert!((sign("stir", t) - apart(&frames[here], before, before)).abs() < 2e-3, "step {t}");
            assert!((sign("flicker", t) - apart(&frames[here], before, after)).abs() < 2e-3, "step {t}");
        }
        let mut n = 0;
        let stopped = dream.signs(&model, || {
            n += 1;
            n < 2
        });
        assert!(stopped.is_none() && n == 2, "it stops when it is told to");
    }

    #[test]
    fn the_norm_is_the_root_of_the_mean_square_of_the_latents() {
        let model = untrained(&WorldModelConfig::tiny(), &mut ChaCha8Rng::seed_from_u64(3));
        let start = LatentState { z: vec![3.0, 4.0, 0.0, 0.0], c: vec![0.0; 16], h: vec![0.0; 16] };
        let mut dream = DreamEpisode::new(start, 3);
        for z in [[3.0, 4.0, 0.0, 0.0], [1.0, -1.0, 1.0, 1.0]] {
            dream.zs.push(&z);
            dream.actions.push(Action::new([0.0; 3]));
        }
        let signs = dream.signs(&model, || true).unwrap();
        let norm = |t: usize| signs.row(t)[SIGNS.iter().position(|sign| *sign == "norm").unwrap()];
        assert!((norm(0) - 2.5).abs() < 1e-6 && (norm(1) - 1.0).abs() < 1e-6, "√(25 / 4) and 1");
    }

    #[test]
    fn pictures_differ_by_their_mean_distance() {
        let frame = |value: u8| Frame::square(2, vec![value; 12]);
        assert!((apart(&frame(100), &frame(49), &frame(49)) - 0.2).abs() < 1e-6, "51 of 255");
        assert_eq!(apart(&frame(100), &frame(50), &frame(150)), 0.0, "half-way between its neighbors");
    }
}
