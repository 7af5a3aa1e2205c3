//! What `LeRobot` wants to know of each column: least, greatest, mean, spread, quantiles.

use serde::{Deserialize, Serialize};

/// The quantiles that `LeRobot` keeps, by its names for them: since 0.4.0 policies can scale by these.
pub(super) const QUANTILES: [(&str, f64); 5] =
    [("q01", 0.01), ("q10", 0.1), ("q50", 0.5), ("q90", 0.9), ("q99", 0.99)];

/// Least, greatest, mean, standard deviation and quantiles of a column, per component.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Stats {
    /// The least value of each component.
    pub(super) min: Vec<f64>,
    /// The greatest value of each component.
    pub(super) max: Vec<f64>,
    /// The mean of each component.
    pub(super) mean: Vec<f64>,
    /// The standard deviation of each component, of the population.
    pub(super) std: Vec<f64>,
    /// How many rows were looked at.
    pub(super) count: u64,
    /// For each of the [`QUANTILES`] that of each component; none where an older version wrote the episode.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) quantiles: Vec<Vec<f64>>,
}

impl Stats {
    /// The statistics of `values`, which has rows of `width` components; of `n_rows` rows as `LeRobot` counts them.
    pub(super) fn of(width: usize, values: &[f64], n_rows: usize) -> Self {
        let n = (values.len() / width) as f64;
        let mut stats = Self {
            min: vec![f64::INFINITY; width],
            max: vec![f64::NEG_INFINITY; width],
            mean: vec![0.0; width],
            std: vec![0.0; width],
            count: n_rows as u64,
            quantiles: quantiles(width, values),
        };
        for row in values.chunks_exact(width) {
            for (component, &value) in row.iter().enumerate() {
                stats.min[component] = stats.min[component].min(value);
                stats.max[component] = stats.max[component].max(value);
                stats.mean[component] += value;
            }
        }
        for mean in &mut stats.mean {
            *mean /= n;
        }
        for row in values.chunks_exact(width) {
            for (component, &value) in row.iter().enumerate() {
                stats.std[component] += (value - stats.mean[component]).powi(2) / n;
            }
        }
        for variance in &mut stats.std {
            *variance = variance.sqrt();
        }
        stats
    }

    /// Whether they can be those of a column of `width` components in an episode of `n_rows` rows.
    pub(super) fn is_sane(&self, width: usize, n_rows: usize) -> bool {
        let Self { min, max, mean, std, count, quantiles } = self;
        let is_whole =
            |values: &Vec<f64>| values.len() == width && values.iter().all(|value| value.is_finite());
        let is_told = quantiles.is_empty() || quantiles.len() == QUANTILES.len();
        [min, max, mean, std].into_iter().chain(quantiles).all(is_whole)
            && is_told
            && quantiles.is_sorted_by(|low, high| low.iter().zip(high).all(|(low, high)| low <= high))
            && (1..=n_rows as u64).contains(count)
            && min.iter().zip(max).all(|(min, max)| min <= max)
            && std.iter().all(|&std| std >= 0.0)
    }

    /// The statistics of both together. Quantiles are the means of both, by their rows, as `LeRobot` puts those of episodes
    /// together: near to those of all rows, and not the same.
    pub(super) fn merged(&self, other: &Self) -> Self {
        let count = self.count + other.count;
        let weight = other.count as f64 / count as f64;
        let mean = |(one, other): (&f64, &f64)| one + weight * (other - one);
        let means = |(one, other): (&Vec<f64>, &Vec<f64>)| one.iter().zip(other).map(mean).collect();
        let quantiles = if self.quantiles.len() == other.quantiles.len() {
            self.quantiles.iter().zip(&other.quantiles).map(means).collect()
        } else {
            Vec::new()
        };
        let mut merged = Self { count, quantiles, ..self.clone() };
        for component in 0..self.mean.len() {
            let gap = other.mean[component] - self.mean[component];
            let variance = (1.0 - weight) * self.std[component].powi(2)
                + weight * other.std[component].powi(2)
                + weight * (1.0 - weight) * gap.powi(2);
            merged.min[component] = self.min[component].min(other.min[component]);
            merged.max[component] = self.max[component].max(other.max[component]);
            merged.mean[component] += weight * gap;
            merged.std[component] = variance.sqrt();
        }
        merged
    }
}

/// The [`QUANTILES`] of each component, between the two nearest values where they lie between, as `NumPy` has them.
fn quantiles(width: usize, values: &[f64]) -> Vec<Vec<f64>> {
    let mut quantiles = vec![Vec::with_capacity(width); QUANTILES.len()];
    for component in 0..width {
        let mut column: Vec<f64> = values.iter().skip(component).step_by(width).copied().collect();
        column.sort_unstable_by(f64::total_cmp);
        let Some(last) = column.len().checked_sub(1) else { return Vec::new() };
        for ((_, share), of_each) in QUANTILES.iter().zip(&mut quantiles) {
            let at = share * last as f64;
            let (low, high) = (column[at as usize], column[(at as usize + 1).min(last)]);
            of_each.push(low + at.fract() * (high - low));
        }
    }
    quantiles
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_numpy() {
        let values: Vec<f64> = [5.0, 1.0, 9.0, 2.0, 4.0].iter().flat_map(|&value| [value, -value]).collect();
        // numpy.quantile([5, 1, 9, 2, 4], [0.01, 0.1, 0.5, 0.9, 0.99])
        let numpys = [1.04, 1.4, 4.0, 7.4, 8.84];
        let stats = Stats::of(2, &values, 5);
        for ((found, numpys), turned) in stats.quantiles.iter().zip(numpys).zip(numpys.iter().rev()) {
            assert!((found[0] - numpys).abs() < 1e-12 && (found[1] + turned).abs() < 1e-12, "{found:?}");
        }
        assert!(stats.is_sane(2, 5));
        let merged = stats.merged(&stats);
        assert_eq!(merged.quantiles, stats.quantiles);
        let older = Stats { quantiles: Vec::new(), ..stats.clone() };
        assert!(older.is_sane(2, 5) && stats.merged(&older).quantiles.is_empty());
        let odd = Stats { quantiles: stats.quantiles.iter().rev().cloned().collect(), ..stats };
        assert!(!odd.is_sane(2, 5));
    }

    #[test]
    fn halves_merge_to_the_statistics_of_the_whole() {
        let values = [1.0, 10.0, 2.0, 20.0, 4.0, 40.0, 9.0, 90.0];
        let whole = Stats::of(2, &values, 4);
        let merged = Stats::of(2, &values[..2], 1).merged(&Stats::of(2, &values[2..], 3));
        // numpy.mean and numpy.std of [1, 2, 4, 9], and ten times as much.
        let numpys = [4.0, 40.0, 3.082_207_001_484, 30.822_070_014_845];
        for stats in [&whole, &merged] {
            assert_eq!((&stats.min, &stats.max, stats.count), (&vec![1.0, 10.0], &vec![9.0, 90.0], 4));
            for (found, numpys) in stats.mean.iter().chain(&stats.std).zip(numpys) {
                assert!((found - numpys).abs() < 1e-9, "{found} is not {numpys}");
            }
        }
    }
}
