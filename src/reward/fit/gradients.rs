//! How strongly each answer moves what learns from it: what the paper's Theorem 1 is about (method §8, §14.36).

use tch::{Kind, Tensor};

use super::{Pair, Trainer, loss};
use crate::tensor::to_vec;

/// How large the gradient of one answer's loss is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GradientNorm {
    /// By the gap of the two returns: |p − μ|, in `[0, 1]`.
    pub logit: f64,
    /// By all parameters of a member: its Euclidean norm.
    pub parameters: f64,
}

impl Trainer {
    /// How strongly each answer, by itself, moves what it is learned by: in the order of adding, the mean over members.
    ///
    /// ```text
    /// ∂ℓ/∂g = p − μ with g = R̂⁰ − R̂¹, and ∂ℓ/∂θ = (p − μ) ∂g/∂θ
    /// ```
    pub fn gradients(&self) -> Vec<GradientNorm> {
        let parameters: Vec<&Tensor> =
            self.ensemble.layers.iter().flat_map(|layer| [&layer.weight, &layer.bias]).collect();
        self.pairs.iter().map(|pair| self.gradient(pair, &parameters)).collect()
    }

    fn gradient(&self, pair: &Pair, parameters: &[&Tensor]) -> GradientNorm {
        let e = self.ensemble.config.members;
        let rows = pair.rows.unsqueeze(0).unsqueeze(0).expand([e, -1, -1, -1, -1], false);
        let returns = self.ensemble.segment_returns(&rows); // [E, 1, 2]
        let mu = pair.label.mu();
        let mus = Tensor::full([e, 1], f64::from(mu), (Kind::Float, returns.device()));
        // Members have no parameter in common, so that the gradient of the sum is that of each.
        let sum = loss(&returns, &mus).sum(Kind::Float);
        let gradients = Tensor::run_backward(&[sum], parameters, false, false);
        let squares = gradients.iter().map(|gradient| {
            gradient.to_kind(Kind::Float).square().sum_dim_intlist([1i64, 2].as_slice(), false, Kind::Float)
        });
        let squares = squares.reduce(|all, square| all + square);
        let norms = squares.map_or_else(Vec::new, |squares| to_vec(&squares.sqrt()));
        let gap = (returns.select(2, 0) - returns.select(2, 1)).detach();
        let logit = (gap.sigmoid() - f64::from(mu)).abs().mean(Kind::Float).double_value(&[]);
        let parameters = norms.iter().map(|norm| f64::from(*norm)).sum::<f64>() / norms.len().max(1) as f64;
        GradientNorm { logit, parameters }
    }
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::super::tests::{F, pair, rng, trainer};
    use super::*;
    use crate::query::{Label, SafetyAnswer};
    use crate::reward::{RewardConfig, RewardEnsemble};
    use crate::tensor::from_slice;

    #[test]
    fn the_gradient_of_an_answer_is_that_of_finite_differences() {
        // In full precision, or small differences drown.
        let config = RewardConfig { members: 1, ..RewardConfig::tiny() };
        let ensemble = RewardEnsemble::new((F, "sha256:0"), config, &mut rng(0)).in_kind(Kind::Float);
        let mut trainer = Trainer::new(ensemble);
        trainer.add(&pair(SafetyAnswer::OnlyLeft, 1));
        let (found, label) = (trainer.gradients()[0], trainer.pairs[0].label);
        let p = trainer.predict(&trainer.pairs[0]).p;
        assert!((found.logit - (p - f64::from(label.mu())).abs()).abs() < 0.02, "{found:?} and {p}");
        // Along its own direction a small step changes the loss by its norm.
        let loss_now = |trainer: &Trainer| {
            let rows = trainer.pairs[0].rows.unsqueeze(0).unsqueeze(0);
            loss(&trainer.ensemble.segment_returns(&rows), &from_slice(&[label.mu()], &[1, 1]))
        };
        let parameters: Vec<Tensor> = trainer.ensemble.store.trainable_variables();
        let gradients = Tensor::run_backward(&[loss_now(&trainer)], &parameters, false, false);
        let before = loss_now(&trainer).double_value(&[]);
        let step = 1e-2 / found.parameters;
        tch::no_grad(|| {
            for (parameter, gradient) in parameters.iter().zip(&gradients) {
                parameter.shallow_clone().copy_(&(parameter - gradient * step));
            }
        });
        let fallen = before - loss_now(&trainer).double_value(&[]);
        let wanted = 1e-2 * found.parameters;
        assert!((fallen / wanted - 1.0).abs() < 0.2, "{fallen} and {wanted}");
        // One that is met moves nothing.
        trainer.relabel(0, Label::EQUAL);
        trainer.begin_anew(&mut rng(3));
        assert_eq!(trainer.gradients()[0], GradientNorm { logit: 0.0, parameters: 0.0 });
    }

    #[test]
    fn who_watches_a_fit_sees_it_before_its_first_step_and_changes_nothing() {
        let mut seen = Vec::new();
        let (mut one, mut other) = (trainer(RewardConfig::tiny()), trainer(RewardConfig::tiny()));
        assert!(one.fit(&mut rng(1), |_| ControlFlow::Continue(())).unwrap().is_continue());
        let watched = other.fit_watched(&mut rng(1), |trainer, report| {
            let gradients = trainer.gradients();
            seen.push((
                report.epoch,
                gradients.iter().map(|it| it.logit).sum::<f64>() / gradients.len() as f64,
            ));
            ControlFlow::Continue(())
        });
        assert!(watched.unwrap().is_continue());
        assert_eq!(seen.iter().map(|(epoch, _)| *epoch).collect::<Vec<_>>(), (0..=20).collect::<Vec<_>>());
        assert!((seen[0].1 - 0.5).abs() < 1e-6 && seen[20].1 < 0.3, "{seen:?}");
        let weights = |trainer: &Trainer| to_vec(&trainer.ensemble.layers[0].weight);
        assert_eq!(weights(&one), weights(&other));
    }
}
