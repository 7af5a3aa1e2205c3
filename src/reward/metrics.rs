//! How well a reward predicts answers that it has not learned from.

use serde::{Deserialize, Serialize};

use crate::query::Label;

/// A prediction made before the answer was learned, and the answer's label.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prediction {
    /// The probability p that the left segment is better, as the ensemble saw it.
    pub p: f64,
    /// What was answered.
    pub label: Label,
}

/// How well answers were predicted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PredictionMetrics {
    /// How many answers there were.
    pub n: usize,
    /// The mean of −[μ ln p + (1 − μ) ln(1 − p)], in nats. It is ln 2 where nothing is known.
    pub log_loss: f64,
    /// The least that `log_loss` could be: the entropy of soft labels.
    pub floor: f64,
    /// How many answers named a better side: μ is not ½.
    pub n_strict: usize,
    /// The share of those whose side was predicted: p and μ on the same side of ½.
    ///
    /// Answers that named no side do not count, and predicting neither (p = ½) is wrong.
    pub agreement: Option<f64>,
}

impl PredictionMetrics {
    /// The metrics of `predictions`, or nothing where there is none.
    pub fn of(predictions: &[Prediction]) -> Option<Self> {
        let n = predictions.len();
        if n == 0 {
            return None;
        }
        let mean = |loss: fn(&Prediction) -> f64| predictions.iter().map(loss).sum::<f64>() / n as f64;
        let strict: Vec<_> = predictions.iter().filter(|f| f.label.mu() != Label::EQUAL.mu()).collect();
        let n_agreed = strict.iter().filter(|f| (f.p - 0.5) * (f64::from(f.label.mu()) - 0.5) > 0.0).count();
        Some(Self {
            n,
            log_loss: mean(|f| cross_entropy(f.label.mu().into(), f.p)),
            floor: mean(|f| cross_entropy(f.label.mu().into(), f.label.mu().into())),
            n_strict: strict.len(),
            agreement: (!strict.is_empty()).then(|| n_agreed as f64 / strict.len() as f64),
        })
    }
}

/// −[μ ln p + (1 − μ) ln(1 − p)], in nats, where 0 ln 0 is 0.
fn cross_entropy(mu: f64, p: f64) -> f64 {
    let term = |weight: f64, p: f64| if weight == 0.0 { 0.0 } else { -weight * p.ln() };
    term(mu, p) + term(1.0 - mu, 1.0 - p)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::query::{Preference, Response, SafetyAnswer, Weights};

    fn label(answer: SafetyAnswer) -> Label {
        Weights::paper().label(&Response::Safety(answer)).unwrap()
    }

    #[test]
    fn knowing_nothing_costs_the_logarithm_of_two() {
        let prediction = Prediction { p: 0.5, label: label(SafetyAnswer::OnlyLeft) };
        let metrics = PredictionMetrics::of(&[prediction]).unwrap();
        assert!((metrics.log_loss - std::f64::consts::LN_2).abs() < 1e-12);
        assert_eq!((metrics.floor, metrics.agreement), (0.0, Some(0.0)));
        assert_eq!(PredictionMetrics::of(&[]), None);
    }

    #[test]
    fn only_answers_that_name_a_side_can_agree() {
        let right = Prediction { p: 0.4, label: label(SafetyAnswer::Both(Preference::Right)) };
        let wrong = Prediction { p: 0.4, label: label(SafetyAnswer::OnlyLeft) };
        let neither = Prediction { p: 0.4, label: label(SafetyAnswer::Neither) };
        let metrics = PredictionMetrics::of(&[right, wrong, neither]).unwrap();
        assert_eq!((metrics.n, metrics.n_strict, metrics.agreement), (3, 2, Some(0.5)));
    }
}
