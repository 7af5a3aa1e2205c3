//! From verdicts to a reward: the one way that the window, a replay and a simulation go.

use std::ops::ControlFlow;

use rand::SeedableRng as _;
use rand::seq::SliceRandom as _;
use rand_chacha::ChaCha8Rng;
use tch::{Kind, Tensor};

use crate::query::{JudgedTransition, Transition};
use crate::reward::EpochReport;
use crate::reward::RewardInputs;
use crate::reward::fit::require_losses;
use crate::reward::sparse::{Examples, Rules, SparseConfig, SparseReward, balanced_losses, joint_loss};
use crate::tensor::adam::pytorch_adam;
use crate::tensor::{NotFinite, require_finite, to_vec};
use crate::world_model::WorldModel;

/// Held out verdicts are predicted once in so many epochs (method §9).
const EVALUATE_EVERY: usize = 5;

/// A classifier that was fitted to the end.
#[derive(Debug)]
pub struct SparseFit {
    /// The networks that were kept.
    pub reward: SparseReward,
    /// The last loss: one of all members together, or one of each.
    pub losses: Vec<f32>,
    /// How well those networks predict held out verdicts, where some were held out.
    pub held_out: Option<HeldOut>,
}

/// How well verdicts were predicted that were not learned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldOut {
    /// How many there were.
    pub n: usize,
    /// Their cross-entropy under the average of all members, in nats.
    pub loss: f32,
    /// The share whose class was the likeliest.
    pub accuracy: f32,
}

/// Fits a fresh classifier over the features of `model` to all verdicts but those held out, in the order of asking.
///
/// The same verdicts and `seed` give the same networks, in whatever order they stand here.
/// Nothing comes where `on_epoch` breaks. Where a transition has no row, or a loss is no number, that is the error.
///
/// # Shapes
/// - `row`: that of a transition, `[F + A]`, as [`transition_row`](crate::reward::transition_row) makes it
pub fn fit_sparse_anew<E: From<NotFinite>>(
    model: &WorldModel,
    config: SparseConfig,
    seed: u64,
    judged: &[JudgedTransition],
    mut row: impl FnMut(Transition) -> Result<Vec<f32>, E>,
    on_epoch: impl FnMut(&EpochReport) -> ControlFlow<()>,
) -> Result<Option<SparseFit>, E> {
    let rng = &mut ChaCha8Rng::seed_from_u64(seed);
    let mut judged = judged.to_vec();
    judged.sort_by_key(|judged| judged.query);
    let mut examples = Vec::new();
    for JudgedTransition { transition, verdict, .. } in judged {
        examples.push((row(transition)?, verdict));
    }
    let reward = SparseReward::new(RewardInputs::of(model), config, rng).on(model.backend());
    Ok(fit(reward, examples, rng, on_epoch)?)
}

fn fit(
    mut reward: SparseReward,
    mut examples: Vec<(Vec<f32>, crate::query::Verdict)>,
    rng: &mut ChaCha8Rng,
    mut on_epoch: impl FnMut(&EpochReport) -> ControlFlow<()>,
) -> Result<Option<SparseFit>, NotFinite> {
    let config = reward.config.clone();
    examples.shuffle(rng);
    let n_held_out = (config.held_out * examples.len() as f64).round() as usize;
    let held_out =
        examples_of(examples.split_off(examples.len() - n_held_out.min(examples.len().saturating_sub(1))));
    let device = reward.store.device();
    let (held_out, training) = (held_out.on(device), examples_of(examples).on(device));
    let (weights, mut adam) =
        (training.weights().to_device(device), pytorch_adam(&reward.store, config.learning_rate));
    let n_epochs = config.epochs(training.n);
    let (mut best, mut losses) = (None::<(HeldOut, crate::tensor::Parameters)>, Vec::new());
    for epoch in 1..=n_epochs {
        let n_losses = if config.rules == Rules::Joint { 1 } else { config.members as usize };
        let mut means = vec![0.0; n_losses];
        let orders: Vec<Tensor> = (0..n_losses).map(|_| order(training.n, rng).to_device(device)).collect();
        for start in (0..training.n).step_by(config.batch) {
            let len = config.batch.min(training.n - start) as i64;
            let picks: Vec<_> = orders.iter().map(|order| order.narrow(0, start as i64, len)).collect();
            let of_step = step(&reward, &training, &weights, &picks);
            adam.backward_step(&of_step.sum(Kind::Float));
            for (mean, loss) in means.iter_mut().zip(to_vec(&of_step.detach())) {
                *mean += f64::from(loss) * len as f64 / training.n as f64;
            }
        }
        require_losses(&means, epoch, "the classifier")?;
        losses = means.iter().map(|loss| *loss as f32).collect();
        let is_time = epoch % EVALUATE_EVERY == 0 || epoch == n_epochs;
        if is_time && held_out.n > 0 {
            let found = evaluate(&reward, &held_out);
            if best.as_ref().is_none_or(|(best, _)| found.loss < best.loss || !config.keeps_best) {
                best = Some((found, reward.parameters()));
            }
        }
        if on_epoch(&EpochReport { epoch, n_epochs, losses: means }).is_break() {
            return Ok(None);
        }
    }
    require_finite(&reward.store, "the classifier")?;
    let held_out = best.as_ref().map(|(found, _)| *found);
    if let Some((_, parameters)) = best.filter(|_| config.keeps_best) {
        reward = reward.reloaded(&parameters);
    }
    Ok(Some(SparseFit { reward, losses, held_out }))
}

fn examples_of(examples: Vec<(Vec<f32>, crate::query::Verdict)>) -> Examples {
    let (rows, verdicts): (Vec<_>, Vec<_>) = examples.into_iter().unzip();
    Examples::of(&rows, &verdicts)
}

fn order(n: usize, rng: &mut ChaCha8Rng) -> Tensor {
    let mut order: Vec<i64> = (0..n as i64).collect();
    order.shuffle(rng);
    Tensor::from_slice(&order)
}

/// The losses of the rows picked: by one order for all members, or by one for each.
fn step(reward: &SparseReward, training: &Examples, weights: &Tensor, picks: &[Tensor]) -> Tensor {
    match reward.config.rules {
        Rules::Joint => {
            let rows = training.rows.index_select(0, &picks[0]);
            joint_loss(&reward.logits(&rows), &training.classes.index_select(0, &picks[0]))
        }
        Rules::Apart => {
            let picked = |of: &Tensor| {
                Tensor::stack(&picks.iter().map(|pick| of.index_select(0, pick)).collect::<Vec<_>>(), 0)
            };
            balanced_losses(&reward.forward(&picked(&training.rows)), &picked(&training.classes), weights)
        }
    }
}

fn evaluate(reward: &SparseReward, held_out: &Examples) -> HeldOut {
    tch::no_grad(|| {
        let logits = reward.logits(&held_out.rows);
        let loss = joint_loss(&logits, &held_out.classes).double_value(&[0]) as f32;
        let likeliest = logits.mean_dim(0, false, Kind::Float).argmax(-1, false);
        let hits = likeliest.eq_tensor(&held_out.classes).to_kind(Kind::Float);
        HeldOut { n: held_out.n, loss, accuracy: hits.mean(Kind::Float).double_value(&[]) as f32 }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::query::{DreamId, QueryId, Verdict};
    use crate::tensor::normal;
    use crate::world_model::{WorldModelConfig, untrained};

    /// Transitions of noise, whose first feature decides the verdict.
    fn toy(n: usize) -> (WorldModel, Vec<JudgedTransition>, Vec<Vec<f32>>) {
        let model = untrained(&WorldModelConfig::tiny(), &mut ChaCha8Rng::seed_from_u64(0));
        let row = |i: usize| to_vec(&normal(&mut ChaCha8Rng::seed_from_u64(i as u64), &[39]));
        let rows: Vec<_> = (0..n).map(row).collect();
        let judged = rows.iter().enumerate().map(|(i, row)| JudgedTransition {
            query: QueryId(i as u32),
            transition: Transition { dream: DreamId(0), first: 0, step: i },
            verdict: match row[0] {
                x if x < -0.4 => Verdict::Unsafe,
                x if x < 0.4 => Verdict::Neutral,
                _ => Verdict::Good,
            },
        });
        let judged = judged.collect();
        (model, judged, rows)
    }

    fn fit_toy(config: SparseConfig, n: usize, is_reversed: bool) -> SparseFit {
        let (model, mut judged, rows) = toy(n);
        if is_reversed {
            judged.reverse();
        }
        let row = |transition: Transition| Ok::<_, NotFinite>(rows[transition.step].clone());
        let fitted = fit_sparse_anew(&model, config, 3, &judged, row, |_| ControlFlow::Continue(()));
        fitted.unwrap().unwrap()
    }

    #[test]
    fn both_rules_learn_what_decides_the_verdicts() {
        tch::set_num_threads(1);
        for rules in [Rules::Joint, Rules::Apart] {
            let config = SparseConfig { updates: 600, rules, ..SparseConfig::tiny() };
            let held_out = fit_toy(config, 400, false).held_out.unwrap();
            assert_eq!(held_out.n, 80, "a fifth");
            assert!(held_out.accuracy > 0.7, "{rules:?}: {held_out:?} where a third is chance");
        }
    }

    #[test]
    fn a_fit_ends_at_the_first_loss_that_is_no_number() {
        let (model, judged, mut rows) = toy(60);
        rows[3][0] = f32::INFINITY;
        let row = |transition: Transition| Ok::<_, NotFinite>(rows[transition.step].clone());
        let go_on = |_: &EpochReport| ControlFlow::Continue(());
        let config = SparseConfig { held_out: 0.0, ..SparseConfig::tiny() };
        let met = fit_sparse_anew(&model, config, 3, &judged, row, go_on).unwrap_err();
        assert!(met.to_string().contains("epoch 1"), "{met}");
    }

    #[test]
    fn the_order_in_which_verdicts_stand_does_not_matter() {
        let [there, back] = [false, true].map(|is_reversed| fit_toy(SparseConfig::tiny(), 60, is_reversed));
        assert_eq!(there.reward.parameters().hash(), back.reward.parameters().hash());
        assert_eq!(there.losses, back.losses);
    }

    #[test]
    fn the_best_networks_are_kept_where_that_is_asked_for() {
        // So few verdicts are overfitted soon, and what is held out suffers.
        let config = SparseConfig { updates: 400, ..SparseConfig::tiny() };
        let best = fit_toy(config.clone(), 40, false).held_out.unwrap();
        let last = fit_toy(SparseConfig { keeps_best: false, ..config }, 40, false).held_out.unwrap();
        assert!(best.loss < last.loss, "{best:?} and {last:?}");
    }
}
