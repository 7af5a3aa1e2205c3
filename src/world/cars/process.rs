//! What the models see of a Car Racing picture: cropped, squeezed, black turned to white.
//!
//! By hand on purpose: resizers of the registry do not promise Pillow's fixed-point rounding, bit for bit.

use std::f64::consts::PI;
use std::ops::Range;
use std::sync::LazyLock;

use super::raster::{Color, paint};
use super::{Frame, trig};

/// Pixels a side of the picture that comes in.
const RAW: usize = 96;
/// Pixels a side of the frame that goes out.
const SIDE: usize = 84;
/// Input columns that one output column takes. The weights of those it does not need are 0.
const N_TAPS: usize = 8;
/// Bits behind the point of a weight.
const PRECISION: u32 = 22;

/// The recipe of every picture.
static RECIPE: LazyLock<Recipe> = LazyLock::new(Recipe::new);

/// The frame of a 96 × 96 state image (method §2.1).
///
/// ```text
/// keep rows 0..83 → squeeze 96 columns to 84 by Lanczos-3, as Pillow does, bit for bit → black becomes white
/// ```
///
/// # Panics
/// Where `raw96` is not `96 · 96 · 3` bytes.
pub fn process(raw96: &[u8]) -> Frame {
    assert_eq!(raw96.len(), 3 * RAW * RAW, "a state image of Car Racing is 96 × 96");
    let mut rgb = vec![0; 3 * SIDE * SIDE];
    let (recipe, rows) = (&*RECIPE, raw96.as_chunks::<3>().0.chunks_exact(RAW));
    for (row, processed) in rows.zip(rgb.as_chunks_mut::<3>().0.chunks_exact_mut(SIDE)) {
        recipe.squeeze(row, processed);
    }
    Frame::square(SIDE as u32, rgb)
}

fn without_black(pixel: Color) -> Color {
    if pixel == [0; 3] { [255; 3] } else { pixel }
}

/// How input columns make output columns.
struct Recipe {
    /// Of every output column.
    taps: Vec<Taps>,
    /// The first output column whose window begins at an input column or after it.
    from: [usize; RAW + 1],
    /// The first output column whose window does not end before an input column.
    until: [usize; RAW + 1],
}

impl Recipe {
    fn new() -> Self {
        let taps: Vec<_> = (0..SIDE).map(Taps::of_column).collect();
        let from = std::array::from_fn(|x| taps.partition_point(|taps| taps.first < x));
        let until = std::array::from_fn(|x| taps.partition_point(|taps| taps.first + N_TAPS <= x));
        Self { taps, from, until }
    }

    /// A row of the input as one of the output, run of equal pixels by run: where the window of an output column is of one color, as
    /// most are, it keeps that color, for the weights sum to 1.
    fn squeeze(&self, row: &[Color], processed: &mut [Color]) {
        let run_ends = run_ends(row);
        let (mut column, mut at) = (0, 0);
        while at < RAW {
            let end = run_ends[at];
            let (from, until) = (self.from[at], self.until[end]);
            if from < until {
                self.mix(row, &run_ends, column..from, processed);
                paint(&mut processed[from..until], without_black(row[at]));
                column = until;
            }
            at = end;
        }
        self.mix(row, &run_ends, column..SIDE, processed);
    }

    /// Output columns whose windows have several colors.
    fn mix(&self, row: &[Color], run_ends: &[usize; RAW], columns: Range<usize>, processed: &mut [Color]) {
        for (taps, to) in self.taps[columns.clone()].iter().zip(&mut processed[columns]) {
            *to = without_black(taps.apply(row, run_ends));
        }
    }
}

/// For each column the end of the run of equal pixels that it is in.
fn run_ends(row: &[Color]) -> [usize; RAW] {
    let mut ends = [RAW; RAW];
    for column in (0..RAW - 1).rev() {
        ends[column] = if row[column] == row[column + 1] { ends[column + 1] } else { column + 1 };
    }
    ends
}

/// The input columns that make one output column.
struct Taps {
    first: usize,
    /// The sum of the weights of the first so many of them, in fixed point.
    up_to: [i32; N_TAPS + 1],
}

impl Taps {
    fn of_column(column: usize) -> Self {
        let scale = RAW as f64 / SIDE as f64;
        let support = 3.0 * scale;
        let center = (column as f64 + 0.5) * scale;
        let start = (center - support + 0.5).max(0.0) as usize;
        let end = RAW.min((center + support + 0.5) as usize);
        let weight = |x: usize| lanczos((x as f64 - center + 0.5) / scale);
        let sum: f64 = (start..end).map(weight).sum();
        let first = start.min(RAW - N_TAPS);
        let mut up_to = [0; N_TAPS + 1];
        for i in 0..N_TAPS {
            let weight = if (start..end).contains(&(first + i)) { weight(first + i) / sum } else { 0.0 };
            up_to[i + 1] = up_to[i] + (weight * f64::from(1 << PRECISION)).round() as i32;
        }
        Self { first, up_to }
    }

    /// Run by run of equal pixels, which are few: whole numbers add up to the same in any order.
    fn apply(&self, row: &[Color], run_ends: &[usize; RAW]) -> Color {
        let mut sums = [1 << (PRECISION - 1); 3];
        let (mut at, last) = (self.first, self.first + N_TAPS);
        while at < last {
            let end = run_ends[at].min(last);
            let weight = self.up_to[end - self.first] - self.up_to[at - self.first];
            for (sum, &byte) in sums.iter_mut().zip(&row[at]) {
                *sum += weight * i32::from(byte);
            }
            at = end;
        }
        sums.map(|sum: i32| (sum >> PRECISION).clamp(0, 255) as u8)
    }
}

/// The windowed sinc of three lobes.
fn lanczos(x: f64) -> f64 {
    if (-3.0..3.0).contains(&x) { sinc(x) * sinc(x / 3.0) } else { 0.0 }
}

fn sinc(x: f64) -> f64 {
    if x == 0.0 { 1.0 } else { trig::sin(x * PI) / (x * PI) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plain_picture_stays_plain_and_black_turns_white() {
        assert_eq!(process(&vec![102; 3 * RAW * RAW]).rgb(), vec![102; 3 * SIDE * SIDE]);
        assert_eq!(process(&vec![0; 3 * RAW * RAW]).rgb(), vec![255; 3 * SIDE * SIDE]);
    }
}
