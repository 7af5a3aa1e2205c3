//! A screen for bad dreams: which segments somebody would skip because they do not look like the world.
//!
//! A segment's anomaly score is a weighted sum of its [`SIGNS`], each measured against all segments that are known. The
//! score of a pair is the sum of both. A share of all pairs is held back, so that it means the same in every world.

use std::collections::BTreeMap;

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use crate::dream::Rows;
use crate::dream::signs::{N_SIGNS, SIGNS};
use crate::query::strategy::sample_pair;
use crate::query::{DreamId, SEGMENT_LEN, SegmentRef};

/// What each sign counts before anybody has skipped anything, in the order of [`SIGNS`].
///
/// A logistic regression on what was skipped by `simulate --queries 300 --dreams 6 --seed 0 --eps-skip 0.35` for Car Racing,
/// rounded. The first three told too little there to count.
const DEFAULT_WEIGHTS: [f64; N_SIGNS] = [0.0, 0.0, 0.0, 0.2, 0.1, 0.15, 0.15];
/// The precision of the Gaussian prior around those weights, for signs whose deviation is one.
const PRIOR_PRECISION: f64 = 30.0;
/// So many skips must there be before anything is learned from them.
const MIN_SKIPS: usize = 3;
/// Pairs whose anomaly scores make up the distribution.
const N_PAIRS: usize = 1000;

/// Two segments.
pub type Pair = [SegmentRef; 2];

/// What is known of the segments of a session.
#[derive(Clone, Debug, PartialEq)]
pub struct Screen {
    /// The signs of each segment of a dream, by its first step: the means over its steps.
    segments: BTreeMap<DreamId, Vec<[f64; N_SIGNS]>>,
    /// The mean and the deviation of each sign over all segments.
    standard: [(f64, f64); N_SIGNS],
    weights: [f64; N_SIGNS],
    /// The anomaly scores of pairs by chance, the least first.
    distribution: Vec<f32>,
}

/// What a screen would have done to pairs that were seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Spared {
    /// How many were skipped because they did not look like the world.
    pub n_bad: usize,
    /// How many of these it would have held back.
    pub n_spared: usize,
    /// How many were not.
    pub n_good: usize,
    /// How many of these it would have held back.
    pub n_lost: usize,
}

impl Default for Screen {
    fn default() -> Self {
        let (segments, distribution) = (BTreeMap::new(), Vec::new());
        Self { segments, standard: [(0.0, 1.0); N_SIGNS], weights: DEFAULT_WEIGHTS, distribution }
    }
}

impl Screen {
    /// Adds a dream by the signs of its steps, `[T, 7]`.
    pub fn add_dream(&mut self, dream: DreamId, signs: &Rows) {
        let mut sum = [0.0; N_SIGNS];
        let mut segments = Vec::new();
        for t in 0..signs.len() {
            for (i, sum) in sum.iter_mut().enumerate() {
                *sum += f64::from(signs.row(t)[i]);
                *sum -= t.checked_sub(SEGMENT_LEN).map_or(0.0, |gone| f64::from(signs.row(gone)[i]));
            }
            if t + 1 >= SEGMENT_LEN {
                segments.push(sum.map(|sum| sum / SEGMENT_LEN as f64));
            }
        }
        self.segments.insert(dream, segments);
        let all = || self.segments.values().flatten();
        let n = all().count().max(1) as f64;
        self.standard = std::array::from_fn(|i| {
            let mean = all().map(|signs| signs[i]).sum::<f64>() / n;
            let variance = all().map(|signs| (signs[i] - mean).powi(2)).sum::<f64>() / n;
            (mean, variance.sqrt().max(1e-9))
        });
        self.distribute();
    }

    /// The signs of a pair, each the sum of both segments' distances from the mean in deviations.
    ///
    /// Nothing comes where a dream is not known.
    pub fn signs(&self, pair: Pair) -> Option<[f64; N_SIGNS]> {
        let of = |segment: SegmentRef| self.segments.get(&segment.dream)?.get(segment.start);
        let (left, right) = (of(pair[0])?, of(pair[1])?);
        Some(std::array::from_fn(|i| {
            let (mean, deviation) = self.standard[i];
            (left[i] + right[i] - 2.0 * mean) / deviation
        }))
    }

    /// The anomaly score of a pair: how little it looks like the world, against others. Nothing where a dream is not known.
    pub fn anomaly(&self, pair: Pair) -> Option<f32> {
        let signs = self.signs(pair)?;
        Some(signs.iter().zip(self.weights).map(|(sign, weight)| sign * weight).sum::<f64>() as f32)
    }

    /// The anomaly scores of a thousand pairs by chance, the least first.
    pub fn distribution(&self) -> &[f32] {
        &self.distribution
    }

    /// The anomaly score above which the worst `share` of all pairs lies. Nothing where nothing is held back or known.
    pub fn limit(&self, share: f32) -> Option<f32> {
        let n = self.distribution.len();
        let n_held = (share.clamp(0.0, 1.0) * n as f32).round() as usize;
        (n_held > 0).then(|| self.distribution.get((n - n_held).saturating_sub(1)).copied()).flatten()
    }

    /// Whether a pair is among the worst `share` of all.
    pub fn holds_back(&self, pair: Pair, share: f32) -> bool {
        let most = self.limit(share);
        most.is_some_and(|most| self.anomaly(pair).is_some_and(|anomaly| anomaly > most))
    }

    /// What each sign counts.
    pub fn weights(&self) -> impl Iterator<Item = (&'static str, f64)> {
        SIGNS.into_iter().zip(self.weights)
    }

    /// Learns from pairs that were seen, and whether they did not look like the world: a logistic regression from the
    /// weights at first, which it leaves the further the more was skipped.
    pub fn learn(&mut self, seen: &[(Pair, bool)]) {
        self.weights = DEFAULT_WEIGHTS;
        let rows: Vec<_> = seen.iter().filter_map(|(pair, bad)| Some((self.signs(*pair)?, *bad))).collect();
        let n_bad = rows.iter().filter(|(_, bad)| *bad).count();
        if n_bad >= MIN_SKIPS && n_bad < rows.len() {
            self.weights = logistic(&rows, DEFAULT_WEIGHTS);
        }
        self.distribute();
    }

    /// What holding back the worst `share` would have done to pairs that were seen.
    pub fn spared(&self, seen: &[(Pair, bool)], share: f32) -> Spared {
        let mut spared = Spared::default();
        for &(pair, is_bad) in seen.iter().filter(|(pair, _)| self.signs(*pair).is_some()) {
            let is_held = usize::from(self.holds_back(pair, share));
            if is_bad {
                (spared.n_bad, spared.n_spared) = (spared.n_bad + 1, spared.n_spared + is_held);
            } else {
                (spared.n_good, spared.n_lost) = (spared.n_good + 1, spared.n_lost + is_held);
            }
        }
        spared
    }

    fn distribute(&mut self) {
        let lens: Vec<_> =
            self.segments.iter().map(|(id, segments)| (*id, segments.len() + SEGMENT_LEN - 1)).collect();
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let pairs = (0..N_PAIRS).filter_map(|_| sample_pair(&lens, rng));
        self.distribution = pairs.filter_map(|pair| self.anomaly(pair)).collect();
        self.distribution.sort_by(f32::total_cmp);
    }
}

/// The weights, but for the constant, that make what was seen most likely, pulled towards `prior`: Newton's method.
fn logistic(rows: &[([f64; N_SIGNS], bool)], prior: [f64; N_SIGNS]) -> [f64; N_SIGNS] {
    const N: usize = N_SIGNS + 1;
    let with_one = |signs: &[f64; N_SIGNS]| -> [f64; N] {
        std::array::from_fn(|i| signs.get(i).copied().unwrap_or(1.0))
    };
    let mut weights = with_one(&prior);
    let n_bad = rows.iter().filter(|(_, is_bad)| *is_bad).count() as f64;
    weights[N_SIGNS] = (n_bad / (rows.len() as f64 - n_bad)).ln();
    for _ in 0..20 {
        // The last column of the matrix is the gradient.
        let mut system = [[0.0; N + 1]; N];
        for (i, (row, prior)) in system.iter_mut().zip(prior).enumerate() {
            row[i] = PRIOR_PRECISION;
            row[N] = PRIOR_PRECISION * (prior - weights[i]);
        }
        for (signs, is_bad) in rows {
            let x = with_one(signs);
            let sum: f64 = x.iter().zip(&weights).map(|(x, weight)| x * weight).sum();
            let p = 1.0 / (1.0 + (-sum).exp());
            for (row, x_i) in system.iter_mut().zip(x) {
                row.iter_mut().zip(x).for_each(|(cell, x_j)| *cell += p * (1.0 - p) * x_i * x_j);
                row[N] += (f64::from(u8::from(*is_bad)) - p) * x_i;
            }
        }
        let step = solved(system);
        weights.iter_mut().zip(step).for_each(|(weight, step)| *weight += step);
        if step.iter().all(|step| step.abs() < 1e-9) {
            break;
        }
    }
    std::array::from_fn(|i| weights[i])
}

/// The solution of linear equations whose matrix is positive definite. The last column is the right side.
fn solved<const N: usize, const M: usize>(mut system: [[f64; M]; N]) -> [f64; N] {
    for i in 0..N {
        let pivot = system[i];
        for row in &mut system[i + 1..] {
            let factor = row[i] / pivot[i];
            row.iter_mut().zip(pivot).for_each(|(x, above)| *x -= factor * above);
        }
    }
    let mut solution = [0.0; N];
    for i in (0..N).rev() {
        let known: f64 = (i + 1..N).map(|j| system[i][j] * solution[j]).sum();
        solution[i] = (system[i][M - 1] - known) / system[i][i];
    }
    solution
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A dream of 120 steps whose second half is ever more restless in the last sign.
    fn screen() -> Screen {
        let mut signs = Rows { width: N_SIGNS, values: Vec::new() };
        for t in 0..120 {
            let mut row = [0.5; N_SIGNS];
            row[0] = (t % 7) as f32;
            row[N_SIGNS - 1] = (t as f32 - 60.0).max(0.0);
            signs.push(&row);
        }
        let mut screen = Screen::default();
        screen.add_dream(DreamId(2), &signs);
        screen
    }

    fn pair(left: usize, right: usize) -> Pair {
        [left, right].map(|start| SegmentRef { dream: DreamId(2), start })
    }

    /// Pairs of which those were skipped that show a late moment.
    fn seen() -> Vec<(Pair, bool)> {
        (0..100).map(|i| (pair(i, (i * 37) % 100), i.max((i * 37) % 100) > 80)).collect()
    }

    #[test]
    fn a_segment_has_the_mean_signs_of_its_steps() {
        let screen = screen();
        let segments = &screen.segments[&DreamId(2)];
        assert_eq!(segments.len(), 101, "the last segment counts");
        // Steps 85 to 104, of which the remainders by 7 are 1 to 6, then 0 to 6 twice: 63 / 20.
        assert!((segments[85][0] - 3.15).abs() < 1e-9, "{}", segments[85][0]);
        assert_eq!(screen.anomaly([SegmentRef { dream: DreamId(0), start: 0 }; 2]), None, "it is not known");
    }

    #[test]
    fn what_to_hold_back_is_learned_from_skips() {
        let mut screen = screen();
        screen.learn(&seen());
        assert!(screen.anomaly(pair(90, 95)) > screen.anomaly(pair(10, 20)), "late moments score higher");
        let spared = screen.spared(&seen(), 0.4);
        assert!(spared.n_spared as f64 > 0.8 * spared.n_bad as f64, "{spared:?}");
        assert!((spared.n_lost as f64) < 0.2 * spared.n_good as f64, "{spared:?}");
        let held = (0..100).filter(|i| screen.holds_back(pair(*i, (i * 53) % 100), 0.4)).count();
        assert!((30..=50).contains(&held), "{held} of a hundred are held back where forty should be");
    }

    #[test]
    fn nothing_is_learned_from_too_few_skips_and_no_share_holds_nothing_back() {
        let mut screen = screen();
        let before = screen.clone();
        screen.learn(&[(pair(90, 91), true), (pair(80, 81), true), (pair(0, 1), false)]);
        assert_eq!(screen, before);
        assert!(!screen.holds_back(pair(100, 100), 0.0), "nothing is held back");
        assert!(!Screen::default().holds_back(pair(0, 0), 1.0), "nothing is known");
    }

    #[test]
    fn a_logistic_regression_finds_the_odds() {
        // One sign of ±1, with a third of those above and two thirds of those below skipped: ±ln 2, without a prior.
        let row = |x: f64, is_bad| ([x, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], is_bad);
        let mut rows = vec![row(1.0, true); 2000];
        rows.extend([row(1.0, false)].repeat(1000));
        rows.extend([row(-1.0, true)].repeat(1000));
        rows.extend([row(-1.0, false)].repeat(2000));
        let weights = logistic(&rows, [0.0; N_SIGNS]);
        assert!((weights[0] - 2f64.ln()).abs() < 0.03, "{weights:?}");
        assert_eq!(weights[1], 0.0);
    }
}
