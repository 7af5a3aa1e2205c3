//! Whether methods differ by more than chance: Kruskal–Wallis, and Dunn's test of each pair (method §12).
//!
//! By hand on purpose: `statrs` has the distributions but neither of the tests; all is checked against `SciPy` below.

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};

/// Whether several groups of values come from one distribution.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct KruskalWallis {
    /// `H`, corrected for ties.
    pub h: f64,
    /// The degrees of freedom: groups less one.
    pub df: usize,
    /// The probability of such an `H`, or a greater one, where there is no difference: that of χ² with `df`.
    pub p: f64,
}

/// How two of the groups differ.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dunn {
    /// The numbers of both groups.
    pub pair: (usize, usize),
    /// The difference of their mean ranks in standard errors. Positive where the first has the greater values.
    pub z: f64,
    /// The two-sided normal probability of such a difference, where there is none; not adjusted, as the paper's.
    pub p: f64,
}

/// Why groups cannot be compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Untested {
    /// There is nothing to compare with.
    FewerThanTwo,
    /// The group of this number has no value.
    Empty(usize),
    /// Each has a single value: no rank can tell a difference from chance.
    OneEach,
    /// All values are one.
    AllEqual,
}

/// Why [`kruskal_wallis`] and [`dunn`] say nothing of such groups, or nothing that means anything.
///
/// ```
/// use dropj::evaluation::{Untested, untested};
///
/// assert_eq!(untested(&[&[1.0, 1.0], &[1.0]]), Some(Untested::AllEqual));
/// assert_eq!(untested(&[&[1.0, 2.0], &[1.0]]), None);
/// ```
pub fn untested(groups: &[&[f64]]) -> Option<Untested> {
    if groups.len() < 2 {
        return Some(Untested::FewerThanTwo);
    }
    if let Some(empty) = groups.iter().position(|group| group.is_empty()) {
        return Some(Untested::Empty(empty));
    }
    let mut values = groups.iter().copied().flatten();
    let first = values.next();
    if values.all(|value| Some(value) == first) {
        return Some(Untested::AllEqual);
    }
    groups.iter().all(|group| group.len() == 1).then_some(Untested::OneEach)
}

/// The ranks of all groups together.
struct Ranks {
    /// The mean rank of each group, and how many values it has.
    groups: Vec<(f64, f64)>,
    /// N: how many values there are.
    n: f64,
    /// Σ (τ³ − τ) over ties of τ values.
    ties: f64,
}

/// The test of Kruskal and Wallis. Nothing where there are fewer than two groups, one is empty, or all values are one.
///
/// ```text
/// H = [12 / (N (N + 1)) Σ R_i² / n_i − 3 (N + 1)] / [1 − Σ (τ³ − τ) / (N³ − N)]
/// ```
pub fn kruskal_wallis(groups: &[&[f64]]) -> Option<KruskalWallis> {
    let Ranks { groups, n, ties } = ranks(groups)?;
    let squares: f64 = groups.iter().map(|(mean, n_i)| mean.powi(2) * n_i).sum();
    let h = (12.0 / (n * (n + 1.0)) * squares - 3.0 * (n + 1.0)) / (1.0 - ties / (n.powi(3) - n));
    let (h, df) = (h.max(0.0), groups.len() - 1);
    Some(KruskalWallis { h, df, p: chi_square_tail(h, df) })
}

/// Dunn's test of every pair, after [`kruskal_wallis`]. Empty where that is nothing.
///
/// ```text
/// z = (R̄_i − R̄_j) / √([N (N + 1) / 12 − Σ (τ³ − τ) / (12 (N − 1))] (1 / n_i + 1 / n_j))
/// ```
pub fn dunn(groups: &[&[f64]]) -> Vec<Dunn> {
    let Some(Ranks { groups, n, ties }) = ranks(groups) else { return Vec::new() };
    let variance = n * (n + 1.0) / 12.0 - ties / (12.0 * (n - 1.0));
    let test = |i: usize, j: usize| {
        let ((mean_i, n_i), (mean_j, n_j)) = (groups[i], groups[j]);
        let z = (mean_i - mean_j) / (variance * (1.0 / n_i + 1.0 / n_j)).sqrt();
        Dunn { pair: (i, j), z, p: libm::erfc(z.abs() / 2f64.sqrt()) }
    };
    (0..groups.len())
        .flat_map(|i| (i + 1..groups.len()).map(move |j| (i, j)))
        .map(|(i, j)| test(i, j))
        .collect()
}

/// The ranks of all groups together, where they can differ.
fn ranks(groups: &[&[f64]]) -> Option<Ranks> {
    let (ranks, ties) = ranked(&groups.concat());
    let n = ranks.len() as f64;
    let can_differ = groups.len() > 1 && groups.iter().all(|group| !group.is_empty()) && ties < n.powi(3) - n;
    let mut rest = &ranks[..];
    let means = groups.iter().map(|group| {
        let (of_group, others) = rest.split_at(group.len());
        rest = others;
        (of_group.iter().sum::<f64>() / group.len() as f64, group.len() as f64)
    });
    let groups = means.collect();
    can_differ.then_some(Ranks { groups, n, ties })
}

/// The ranks of values, equal ones sharing the mean of theirs, and Σ (τ³ − τ) over ties of τ values.
pub(super) fn ranked(values: &[f64]) -> (Vec<f64>, f64) {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
    let (mut ranks, mut ties, mut before) = (vec![0.0; values.len()], 0.0, 0);
    for tied in order.chunk_by(|a, b| values[*a] == values[*b]) {
        let tau = tied.len() as f64;
        for i in tied {
            ranks[*i] = before as f64 + f64::midpoint(tau, 1.0);
        }
        ties += tau.powi(3) - tau;
        before += tied.len();
    }
    (ranks, ties)
}

/// The probability that χ² with `df` degrees of freedom is at least `x`: a finite sum, for `df` is whole.
pub(super) fn chi_square_tail(x: f64, df: usize) -> f64 {
    let half = x / 2.0;
    let (mut tail, mut term, mut below) = if df.is_multiple_of(2) {
        (0.0, (-half).exp(), 0.0)
    } else {
        (libm::erfc(half.sqrt()), (-half).exp() * 2.0 * (half / PI).sqrt(), 0.5)
    };
    for _ in 0..df / 2 {
        tail += term;
        below += 1.0;
        term *= half / below;
    }
    tail
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn assert_close(found: f64, expected: f64) {
        assert!((found - expected).abs() <= 1e-9 * expected.abs().max(1e-6), "{found} and {expected}");
    }

    // >>> stats.chi2.sf(5, [1, 2, 3, 5, 9])                                          # SciPy 1.17
    #[test]
    fn tails_of_chi_square_are_scipys() {
        for (df, p) in [
            (1, 0.025_347_318_677),
            (2, 0.082_084_998_623),
            (3, 0.171_797_144_296),
            (5, 0.415_880_186_995),
            (9, 0.834_308_260_193),
        ] {
            assert_close(chi_square_tail(5.0, df), p);
        }
        assert_close(chi_square_tail(80.0, 3), 3.069_277_486_172e-17);
        assert_close(chi_square_tail(0.0, 4), 1.0);
    }

    // >>> stats.kruskal(*groups)
    #[test]
    fn groups_without_ties_are_compared_as_scipy_does() {
        let groups: [&[f64]; 3] =
            [&[2.9, 3.0, 2.5, 2.6, 3.2], &[3.8, 2.7, 4.0, 2.4], &[2.8, 3.4, 3.7, 2.2, 2.0]];
        let KruskalWallis { h, df, p } = kruskal_wallis(&groups).unwrap();
        assert_eq!(df, 2);
        assert_close(h, 0.771_428_571_428);
        assert_close(p, 0.679_964_773_578);
    }

    // >>> stats.kruskal(*groups), and Dunn's z by the formula above with stats.rankdata and stats.norm.sf
    #[test]
    fn ties_are_corrected_for() {
        let groups: [&[f64]; 3] = [&[0.0, 0.0, 0.0, 1.0], &[0.0, 1.0, 2.0, 2.0], &[3.0, 2.0, 3.0, 4.0, 5.0]];
        let KruskalWallis { h, p, .. } = kruskal_wallis(&groups).unwrap();
        assert_close(h, 9.134_482_758_620);
        assert_close(p, 0.010_386_572_847);
        let expected = [
            ((0, 1), -1.021_324_359_973, 0.307_100_788_837),
            ((0, 2), -2.955_675_104_890, 0.003_119_855_438),
            ((1, 2), -1.879_104_702_447, 0.060_230_198_187),
        ];
        for (test, (pair, z, p)) in dunn(&groups).into_iter().zip(expected) {
            assert_eq!(test.pair, pair);
            assert_close(test.z, z);
            assert_close(test.p, p);
        }
    }

    #[test]
    fn two_groups_give_both_tests_one_probability() {
        let groups: [&[f64]; 2] = [&[1.0, 2.0, 3.0, 4.0, 5.0], &[6.0, 7.0, 8.0, 9.0, 10.0]];
        // By hand: rank sums 15 and 40, so H = 12/110 · (45 + 320) − 33.
        assert_close(kruskal_wallis(&groups).unwrap().h, 12.0 / 110.0 * 365.0 - 33.0);
        assert_close(dunn(&groups)[0].p, kruskal_wallis(&groups).unwrap().p);
    }

    #[test]
    fn where_nothing_can_differ_nothing_is_said() {
        for groups in [&[&[1.0, 2.0][..]][..], &[&[1.0], &[]], &[&[3.0, 3.0], &[3.0]]] {
            assert_eq!((kruskal_wallis(groups), dunn(groups)), (None, vec![]));
            assert!(untested(groups).is_some(), "and why: {groups:?}");
        }
    }
}
