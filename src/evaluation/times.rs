//! How long answers take, by what is asked: the paper's Table 2.

use serde::Serialize;

use super::MeanSd;

/// An answer by the time it took.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedAnswer {
    /// Seconds from the query to the answer.
    pub secs: f64,
    /// Whether it was skipped.
    pub is_skipped: bool,
}

/// The times of many answers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AnswerTimes {
    /// Seconds an answer, skipped ones too; the standard deviation is that of the population, as the paper prints it.
    pub secs: MeanSd,
    /// Half of them took no longer.
    pub median_secs: f64,
    /// The share that was skipped, in `[0, 1]`.
    pub skipped: f64,
    /// Answers that were not, an hour.
    pub labels_per_hour: f64,
}

impl AnswerTimes {
    /// Those of `answers`. Nothing where there is none, or none of a finite time.
    pub fn of(answers: &[TimedAnswer]) -> Option<Self> {
        let timed: Vec<_> = answers.iter().filter(|it| it.secs.is_finite() && it.secs >= 0.0).collect();
        let n = timed.len();
        if n == 0 {
            return None;
        }
        let mut secs: Vec<f64> = timed.iter().map(|it| it.secs).collect();
        secs.sort_by(f64::total_cmp);
        let total: f64 = secs.iter().sum();
        let mean = total / n as f64;
        let variance = secs.iter().map(|secs| (secs - mean).powi(2)).sum::<f64>() / n as f64;
        let n_skipped = timed.iter().filter(|it| it.is_skipped).count();
        let median = f64::midpoint(secs[(n - 1) / 2], secs[n / 2]);
        Some(Self {
            secs: MeanSd { mean, sd: variance.sqrt(), n },
            median_secs: median,
            skipped: n_skipped as f64 / n as f64,
            labels_per_hour: if total > 0.0 { 3600.0 * (n - n_skipped) as f64 / total } else { 0.0 },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn skipped_answers_take_time_and_bring_no_label() {
        let of = |secs, is_skipped| TimedAnswer { secs, is_skipped };
        let found =
            AnswerTimes::of(&[of(2.0, false), of(4.0, true), of(6.0, false), of(f64::NAN, false)]).unwrap();
        assert_eq!((found.secs.n, found.secs.mean, found.median_secs), (3, 4.0, 4.0));
        assert!((found.secs.sd - (8f64 / 3.0).sqrt()).abs() < 1e-6);
        assert!((found.labels_per_hour - 600.0).abs() < 1e-9 && (found.skipped - 1.0 / 3.0).abs() < 1e-9);
        assert_eq!(AnswerTimes::of(&[]), None);
    }
}
