//! How rare the colors of recordings are, so that vision does not overlook what is small.

use tch::{Device, Kind, Tensor};

use super::FitError;
use super::data::{Source, Split};
use crate::run::Run;
use crate::tensor::{Parameters, ParametersError, from_slice};
use crate::world::Frame;

/// Shades of each color that are told apart, as a power of two.
const BITS: i64 = 4;
/// All of them: 16 of red, of green and of blue.
const N_COLORS: usize = 1 << (3 * BITS);
/// The most that a pixel counts.
const MOST: f64 = 16.0;
/// Episodes that are looked at, and pictures of each: enough to tell rare from common.
const EPISODES: usize = 40;
const PER_EPISODE: usize = 50;
/// Where a fit keeps it.
const FILE: &str = "rarity";

/// How much more a pixel of each color counts than one of those that make up half of all.
///
/// ```text
/// r(color) = clip(√(p_median / p(color)), 1, 16) − 1
/// ```
///
/// `p` is the share of the pixels that have the color, of which each channel has 16 shades, and `p_median` that of the
/// color in whose place half of all pixels have rarer ones.
#[derive(Debug)]
pub(super) struct Rarity {
    /// `[4096]`: red first, then green, then blue.
    beyond: Tensor,
    strength: f64,
}

impl Rarity {
    /// That of the episodes which are trained on, with `strength`; what a fit found out before is not found out again.
    pub(super) fn of(
        source: Source<'_>,
        split: &Split,
        strength: f64,
        run: &Run,
        device: Device,
    ) -> Result<Self, FitError> {
        if let Some(found) = run.load(FILE)? {
            let beyond = found.finite("beyond")?.filter(|beyond| beyond.size() == [N_COLORS as i64]);
            let beyond = beyond.ok_or_else(|| ParametersError::Missing("beyond".to_owned()))?;
            return Ok(Self { beyond: beyond.to_device(device), strength });
        }
        let every = split.train.len().div_ceil(EPISODES).max(1);
        let looked_at: Vec<usize> = split.train.iter().copied().step_by(every).collect();
        let mut counts = vec![0_u64; N_COLORS];
        source.read(&looked_at, |_, episode| {
            let every = episode.frames.len().div_ceil(PER_EPISODE).max(1);
            episode.frames.iter().step_by(every).for_each(|frame| count(frame, &mut counts));
            Ok(())
        })?;
        let beyond = from_slice(&beyond(&counts), &[N_COLORS as i64]);
        run.save(FILE, &Parameters::from_tensors([("beyond".to_owned(), beyond.shallow_clone())], &[]))?;
        Ok(Self { beyond: beyond.to_device(device), strength })
    }

    /// How much each pixel counts, averaged over the five by five around it.
    ///
    /// # Shapes
    /// - `pixels`: `[B, H, W, 3]` in `[0, 1]`
    /// - returns `[B, H, W, 1]`
    pub(super) fn weights(&self, pixels: &Tensor) -> Tensor {
        let shade = (pixels * 255.0).round().to_kind(Kind::Int64).bitwise_right_shift_tensor_scalar(8 - BITS);
        let color = |i| shade.select(3, i);
        let index = (color(0) * (1 << (2 * BITS))) + (color(1) * (1 << BITS)) + color(2); // [B, H, W]
        around(&self.beyond.take(&index)) * self.strength + 1.0
    }
}

/// Counts the colors of a picture.
fn count(frame: &Frame, counts: &mut [u64]) {
    for rgb in frame.rgb().as_chunks::<3>().0 {
        let index = rgb.iter().fold(0, |index, shade| (index << BITS) | usize::from(shade >> (8 - BITS)));
        counts[index] += 1;
    }
}

/// How much more a pixel of each color counts.
fn beyond(counts: &[u64]) -> Vec<f32> {
    let mut sorted = counts.to_vec();
    sorted.sort_unstable();
    let (half, mut sum) = (counts.iter().sum::<u64>().div_ceil(2), 0);
    let median = sorted.into_iter().find(|count| {
        sum += count;
        sum >= half
    });
    let median = median.unwrap_or_default() as f64;
    let of = |count: &u64| (median / (*count).max(1) as f64).sqrt().clamp(1.0, MOST) - 1.0;
    counts.iter().map(|count| of(count) as f32).collect()
}

/// The mean over what lies around each pixel, within the picture.
///
/// # Shapes
/// - `x`: `[B, H, W]`
/// - returns `[B, H, W, 1]`
fn around(x: &Tensor) -> Tensor {
    const AROUND: i64 = 2;
    let kernel = [2 * AROUND + 1; 2];
    x.unsqueeze(1)
        .avg_pool2d(kernel, [1; 2], [AROUND; 2], false, false, None::<i64>)
        .squeeze_dim(1)
        .unsqueeze(3)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tensor::from_frames;

    /// A white picture with a red pixel at (2, 3) and eight gray ones in the last row.
    fn picture() -> Frame {
        let (height, width) = (8, 10);
        let mut rgb = vec![255; 3 * height * width];
        rgb[3 * (2 * width + 3)..][..3].copy_from_slice(&[200, 10, 10]);
        rgb[3 * 7 * width..][..3 * 8].fill(100);
        Frame::new(height as u32, width as u32, rgb)
    }

    // Of 80 pixels 71 are white, and 1 and 8 are otherwise: √71 − 1 = 7.426 and √(71 / 8) − 1 = 1.979.
    #[test]
    fn a_color_counts_more_the_rarer_it_is_and_so_does_what_is_around_it() {
        let mut counts = vec![0; N_COLORS];
        count(&picture(), &mut counts);
        assert_eq!((counts[0xc00], counts[0x666], counts[0xfff]), (1, 8, 71));
        let beyond = beyond(&counts);
        let near =
            |found: f32, wanted: f32| assert!((found - wanted).abs() < 1e-3, "{found} and not {wanted}");
        near(beyond[0xfff], 0.0);
        near(beyond[0xc00], 7.426);
        near(beyond[0x666], 1.979);
        near(beyond[0], 7.426);
        let rarity = Rarity { beyond: from_slice(&beyond, &[N_COLORS as i64]), strength: 2.0 };
        let weights = rarity.weights(&from_frames(&[picture()]));
        assert_eq!(weights.size(), [1, 8, 10, 1]);
        let at = |row, column| weights.double_value(&[0, row, column, 0]) as f32;
        near(at(4, 5), 1.0 + 2.0 * 7.426 / 25.0);
        near(at(2, 8), 1.0);
        // At the corner nine pixels lie around, three of them gray; those beyond the picture do not count.
        near(at(7, 0), 1.0 + 2.0 * 3.0 * 1.979 / 9.0);
    }

    #[test]
    fn pictures_of_one_color_count_throughout() {
        let mut counts = vec![0; N_COLORS];
        count(&Frame::square(4, vec![7; 48]), &mut counts);
        assert_eq!(beyond(&counts)[0], 0.0);
        assert!(beyond(&vec![0; N_COLORS]).iter().all(|beyond| *beyond == 0.0));
    }
}
