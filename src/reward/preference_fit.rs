//! From answers to a reward: the one way that the window, a replay and a simulation go.

use std::ops::ControlFlow;

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use crate::query::{LabeledQuery, SegmentRef};
use crate::reward::{
    EpochReport, PredictionMetrics, RewardConfig, RewardEnsemble, RewardInputs, SegmentPair, Trainer,
};
use crate::tensor::NotFinite;
use crate::world_model::WorldModel;

/// A reward that was learned to the end.
#[derive(Debug)]
pub struct Fitted {
    /// The ensemble, with the answers that it learned from.
    pub trainer: Trainer,
    /// The last loss of each member, in nats a label.
    pub losses: Vec<f32>,
}

/// Fits a fresh ensemble over the features of `model` to all `labels`, in the order of asking.
///
/// The same labels and `seed` give the same reward, in whatever order the labels stand here.
/// Nothing comes where `on_epoch` breaks. Where a segment has no rows, or a loss is no number, that is the error.
///
/// # Shapes
/// - `rows`: those of a segment, `[k, F + A]`, as [`segment_rows`](crate::reward::segment_rows) makes them
pub fn fit_anew<E: From<NotFinite>>(
    model: &WorldModel,
    config: RewardConfig,
    seed: u64,
    labels: &[LabeledQuery],
    mut rows: impl FnMut(SegmentRef) -> Result<Vec<f32>, E>,
    mut on_epoch: impl FnMut(&EpochReport) -> ControlFlow<()>,
) -> Result<Option<Fitted>, E> {
    fit_anew_watched(model, config, seed, labels, &mut rows, |_, report| {
        if report.epoch == 0 { ControlFlow::Continue(()) } else { on_epoch(report) }
    })
}

/// The same, where `on_epoch` may look at what is learning: see [`Trainer::fit_watched`].
pub fn fit_anew_watched<E: From<NotFinite>>(
    model: &WorldModel,
    config: RewardConfig,
    seed: u64,
    labels: &[LabeledQuery],
    mut rows: impl FnMut(SegmentRef) -> Result<Vec<f32>, E>,
    mut on_epoch: impl FnMut(&Trainer, &EpochReport) -> ControlFlow<()>,
) -> Result<Option<Fitted>, E> {
    let rng = &mut ChaCha8Rng::seed_from_u64(seed);
    let mut trainer = trainer_over(model, config, labels, &mut rows, rng)?;
    let mut losses = Vec::new();
    let done = trainer.fit_watched(rng, |trainer, report| {
        losses = report.losses.iter().map(|loss| *loss as f32).collect();
        on_epoch(trainer, report)
    })?;
    Ok(done.is_continue().then_some(Fitted { trainer, losses }))
}

/// How well an ensemble that [`fit_anew`] would fit to all but `fraction` of `labels` predicts those.
///
/// Nothing where there are too few answers to hold any out.
pub fn predict_held_out<E: From<NotFinite>>(
    model: &WorldModel,
    config: RewardConfig,
    seed: u64,
    labels: &[LabeledQuery],
    mut rows: impl FnMut(SegmentRef) -> Result<Vec<f32>, E>,
    fraction: f64,
) -> Result<Option<PredictionMetrics>, E> {
    let rng = &mut ChaCha8Rng::seed_from_u64(seed);
    let trainer = trainer_over(model, config, labels, &mut rows, rng)?;
    Ok(trainer.held_out(fraction, rng, |_| ControlFlow::Continue(()))?)
}

/// A trainer over `labels`, in the order of asking.
fn trainer_over<E>(
    model: &WorldModel,
    config: RewardConfig,
    labels: &[LabeledQuery],
    rows: &mut impl FnMut(SegmentRef) -> Result<Vec<f32>, E>,
    rng: &mut ChaCha8Rng,
) -> Result<Trainer, E> {
    let ensemble = RewardEnsemble::new(RewardInputs::of(model), config, rng).on(model.backend());
    let mut trainer = Trainer::new(ensemble);
    let mut labels = labels.to_vec();
    labels.sort_by_key(|labeled| labeled.query.id);
    for LabeledQuery { query, label } in labels {
        trainer.add(&SegmentPair { left: rows(query.left)?, right: rows(query.right)?, label });
    }
    Ok(trainer)
}
