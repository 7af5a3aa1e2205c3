//! Differences between methods that drove the same tracks from the same seeds: Friedman's test, Holm's correction, Cliff's δ
//! and bootstrap intervals.
//!
//! Kruskal–Wallis and Dunn, which the paper uses, take episodes for independent. Here all methods drive the same tracks.

use rand::{Rng, RngExt as _};
use serde::Serialize;

use super::significance::{chi_square_tail, ranked};

/// Whether several treatments of the same blocks differ.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Friedman {
    /// `χ²_F`, corrected for ties.
    pub chi2: f64,
    /// The degrees of freedom: treatments less one.
    pub df: usize,
    /// The probability of such a value, or a greater one, where there is no difference.
    pub p: f64,
}

/// Friedman's test of `blocks`, each with a value for every treatment. Nothing where there are fewer than two blocks or
/// treatments, or where all values of every block are one.
///
/// ```text
/// χ² = [12 Σ R_j² / (n k (k + 1)) − 3 n (k + 1)] / [1 − Σ (τ³ − τ) / (n k (k² − 1))]
/// ```
///
/// With two treatments it is the sign test's approximation.
pub fn friedman(blocks: &[Vec<f64>]) -> Option<Friedman> {
    let (n, k) = (blocks.len(), blocks.first().map_or(0, Vec::len));
    if n < 2 || k < 2 || blocks.iter().any(|block| block.len() != k) {
        return None;
    }
    let (mut sums, mut ties) = (vec![0.0; k], 0.0);
    for block in blocks {
        let (ranks, tied) = ranked(block);
        sums.iter_mut().zip(ranks).for_each(|(sum, rank)| *sum += rank);
        ties += tied;
    }
    let (n, k) = (n as f64, k as f64);
    let corrected = 1.0 - ties / (n * k * (k * k - 1.0));
    if corrected <= 0.0 {
        return None;
    }
    let squares: f64 = sums.iter().map(|sum| sum * sum).sum();
    let chi2 = ((12.0 * squares / (n * k * (k + 1.0)) - 3.0 * n * (k + 1.0)) / corrected).max(0.0);
    let df = sums.len() - 1;
    Some(Friedman { chi2, df, p: chi_square_tail(chi2, df) })
}

/// The probability of pairs as they are, or further apart, where neither is greater: Wilcoxon's signed ranks, exact up to 20
/// pairs that differ, and beyond by the normal distribution. Pairs that do not differ are left out.
pub fn wilcoxon(pairs: &[(f64, f64)]) -> Option<f64> {
    let differences: Vec<f64> =
        pairs.iter().map(|(a, b)| a - b).filter(|difference| *difference != 0.0).collect();
    let n = differences.len();
    if n == 0 {
        return None;
    }
    let (ranks, ties) = ranked(&differences.iter().map(|difference| difference.abs()).collect::<Vec<_>>());
    let positive: f64 = ranks.iter().zip(&differences).filter(|(_, d)| **d > 0.0).map(|(rank, _)| rank).sum();
    let total: f64 = ranks.iter().sum();
    let least = positive.min(total - positive);
    if n <= 20 {
        // Of all 2ⁿ ways to give signs, those whose sum is as small, in halves of ranks so that sums are whole.
        let halves: Vec<usize> = ranks.iter().map(|rank| (2.0 * rank).round() as usize).collect();
        let mut ways = vec![0.0f64; halves.iter().sum::<usize>() + 1];
        ways[0] = 1.0;
        for half in halves {
            for sum in (half..ways.len()).rev() {
                ways[sum] += ways[sum - half];
            }
        }
        let as_small: f64 = ways[..=(2.0 * least).round() as usize].iter().sum();
        return Some((2.0 * as_small / 2f64.powi(n as i32)).min(1.0));
    }
    let n = n as f64;
    let variance = n * (n + 1.0) * (2.0 * n + 1.0) / 24.0 - ties / 48.0;
    let z = (least - total / 2.0) / variance.sqrt();
    Some(libm::erfc(z.abs() / 2f64.sqrt()).min(1.0))
}

/// Probabilities corrected for their number by Holm's method, in the order in which they came.
///
/// ```
/// use dropj::evaluation::holm;
///
/// let corrected = holm(&[0.01, 0.04, 0.03]);
/// assert!(corrected.iter().zip([0.03, 0.06, 0.06]).all(|(p, wanted)| (p - wanted).abs() < 1e-12));
/// ```
pub fn holm(ps: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..ps.len()).collect();
    order.sort_by(|a, b| ps[*a].total_cmp(&ps[*b]));
    let (mut corrected, mut most) = (vec![0.0; ps.len()], 0.0f64);
    for (i, &at) in order.iter().enumerate() {
        most = most.max(ps[at] * (ps.len() - i) as f64).min(1.0);
        corrected[at] = most;
    }
    corrected
}

/// Cliff's δ: how much more often a value of the first is the greater of two than one of the second, in `[−1, 1]`.
///
/// ```
/// use dropj::evaluation::cliffs_delta;
///
/// assert_eq!(cliffs_delta(&[3.0, 4.0], &[1.0, 3.0]), Some(0.75));
/// ```
pub fn cliffs_delta(one: &[f64], other: &[f64]) -> Option<f64> {
    let n = one.len() * other.len();
    let sum: f64 = one
        .iter()
        .flat_map(|a| {
            other.iter().map(move |b| {
                if a > b {
                    1.0
                } else if a < b {
                    -1.0
                } else {
                    0.0
                }
            })
        })
        .sum();
    (n > 0).then(|| sum / n as f64)
}

/// The mean of `values` and the bounds between which 95 of 100 means of as many values drawn from them lie (the percentile
/// bootstrap). Of a single value nothing is known but itself.
pub fn bootstrap(values: &[f64], rng: &mut impl Rng) -> Option<[f64; 3]> {
    const N: usize = 2000;
    let mean = |values: &mut dyn Iterator<Item = f64>, n: usize| values.sum::<f64>() / n as f64;
    let n = values.len();
    if n == 0 {
        return None;
    }
    let center = mean(&mut values.iter().copied(), n);
    let mut means: Vec<f64> =
        (0..N).map(|_| mean(&mut (0..n).map(|_| values[rng.random_range(0..n)]), n)).collect();
    means.sort_by(f64::total_cmp);
    Some([center, means[N / 40], means[N - 1 - N / 40]])
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[track_caller]
    fn assert_close(found: f64, expected: f64) {
        assert!((found - expected).abs() <= 1e-9 * expected.abs().max(1e-6), "{found} and {expected}");
    }

    // >>> stats.friedmanchisquare(*zip(*blocks))                                     # SciPy 1.17
    #[test]
    fn treatments_are_compared_as_scipy_does() {
        let blocks: Vec<Vec<f64>> = [
            [72.0, 120.0, 76.0],
            [96.0, 120.0, 95.0],
            [88.0, 132.0, 104.0],
            [92.0, 120.0, 96.0],
            [74.0, 101.0, 84.0],
            [76.0, 96.0, 72.0],
            [82.0, 112.0, 76.0],
        ]
        .map(Vec::from)
        .into();
        let Friedman { chi2, df, p } = friedman(&blocks).unwrap();
        assert_eq!(df, 2);
        assert_close(chi2, 10.571_428_571_428_57);
        assert_close(p, 0.005_063_414_171_757);
        let tied: Vec<Vec<f64>> =
            [[1.0, 1.0, 2.0, 3.0], [2.0, 1.0, 2.0, 2.0], [0.0, 4.0, 4.0, 5.0], [1.0, 2.0, 3.0, 3.0]]
                .map(Vec::from)
                .into();
        let Friedman { chi2, p, .. } = friedman(&tied).unwrap();
        assert_close(chi2, 8.272_727_272_727_27);
        assert_close(p, 0.040_699_027_028);
        assert_eq!(friedman(&[vec![1.0, 1.0], vec![2.0, 2.0]]), None, "nothing differs");
        assert_eq!(friedman(&blocks[..1]), None);
    }

    // >>> stats.wilcoxon(a, b, method="exact" or "approx", correction=False)
    #[test]
    fn pairs_are_compared_as_scipy_does() {
        let a = [125.0, 115.0, 130.0, 140.0, 140.5, 115.5, 140.8, 125.2, 140.1, 135.0];
        let b = [110.0, 122.0, 125.0, 120.0, 140.0, 124.0, 123.0, 137.0, 135.0, 145.3];
        let pairs: Vec<_> = a.into_iter().zip(b).collect();
        assert_close(wilcoxon(&pairs).unwrap(), 0.625);
        let many: Vec<_> = (0..30).map(|i| (f64::from(i * 7 % 30), f64::from(i * 11 % 29) - 1.5)).collect();
        assert_close(wilcoxon(&many).unwrap(), 0.308_474_101_285);
        assert_eq!(wilcoxon(&[(1.0, 1.0)]), None);
    }

    #[test]
    fn a_bootstrap_holds_its_mean_and_narrows_with_more_values() {
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let few: Vec<f64> = (0..5).map(f64::from).collect();
        let many: Vec<f64> = (0..500).map(|i| f64::from(i % 5)).collect();
        let [mean, low, high] = bootstrap(&few, rng).unwrap();
        assert!(mean == 2.0 && low < 1.3 && high > 2.7, "{low} to {high}");
        let [_, low_of_many, high_of_many] = bootstrap(&many, rng).unwrap();
        assert!(high_of_many - low_of_many < 0.3 * (high - low));
        assert_eq!(bootstrap(&[3.0], rng), Some([3.0; 3]));
        assert_eq!(bootstrap(&[], rng), None);
    }
}
