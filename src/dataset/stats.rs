//! What `LeRobot` wants to know of each column: least, greatest, mean, spread.

use serde::{Deserialize, Serialize};

/// Least, greatest, mean and standard deviation of a column, per component.
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
        let Self { min, max, mean, std, count } = self;
        let is_whole =
            |values: &Vec<f64>| values.len() == width && values.iter().all(|value| value.is_finite());
        [min, max, mean, std].into_iter().all(is_whole)
            && (1..=n_rows as u64).contains(count)
            && min.iter().zip(max).all(|(min, max)| min <= max)
            && std.iter().all(|&std| std >= 0.0)
    }

    /// The statistics of both together.
    pub(super) fn merged(&self, other: &Self) -> Self {
        let count = self.count + other.count;
        let weight = other.count as f64 / count as f64;
        let mut merged = Self { count, ..self.clone() };
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

#[cfg(test)]
mod tests {
    use super::*;

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
