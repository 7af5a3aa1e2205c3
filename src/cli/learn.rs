//! Learning what a session's answers say: what `refit` and `simulate` share.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::ops::ControlFlow;

use anyhow::Context as _;
use dropj::dream::DreamEpisode;
use dropj::query::{DreamId, Protocol, SegmentRef, Transition};
use dropj::reward::{
    EpochReport, Fitted, HeldOut, PredictionMetrics, RewardConfig, SparseConfig, SparseFit, fit_anew,
    fit_sparse_anew, predict_held_out, segment_rows, transition_row,
};
use dropj::session::{Fit, Session, SessionError, SessionStore};
use dropj::tensor::{NotFinite, Parameters};
use dropj::world_model::WorldModel;
use serde::Serialize;

use super::curves::Curves;
use super::meter::Meter;

/// Said where a session has no verdicts.
pub(crate) const NO_VERDICTS: &str = "there are no verdicts to learn from";
/// Said where a session has no answers.
pub(crate) const NO_ANSWERS: &str = "there are no answers to learn from";

/// What a fit of a reward counts.
const EPOCHS: &str = "learning, epochs";

/// The loss that a fit tells, the mean over the networks.
fn loss(report: &EpochReport) -> String {
    format!("loss {:.4}", report.losses.iter().sum::<f64>() / report.losses.len().max(1) as f64)
}

/// What was learned, and how.
#[derive(Debug)]
pub(crate) struct Learned {
    pub(crate) parameters: Parameters,
    pub(crate) fit: Fit,
    pub(crate) curves: Curves,
    /// How well answers were predicted that were held out, where some were.
    pub(crate) held_out: Option<HeldOutTold>,
}

impl Learned {
    /// Keeps it in the session, with its curves.
    fn keep(self, store: &mut SessionStore) -> anyhow::Result<(Fit, Option<HeldOutTold>)> {
        let Self { parameters, fit, curves, held_out } = self;
        store.save_reward(&parameters, fit.clone())?;
        curves.write(store.dir(), store.session())?;
        Ok((fit, held_out))
    }
}

/// How well answers were predicted that nothing was learned from.
#[derive(Clone, Copy, Debug, Serialize)]
#[serde(untagged)]
pub(crate) enum HeldOutTold {
    /// Pairs of clips.
    Answers(PredictionMetrics),
    /// Single transitions.
    Verdicts { n: usize, loss: f32, predicted: f32 },
}

impl fmt::Display for HeldOutTold {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Answers(PredictionMetrics { n, log_loss, floor, n_strict, agreement }) => writeln!(
                f,
                "of {n} answers held out: log-loss {log_loss:.3} nats (at least {floor:.3}), \
                 {:.0} % of {n_strict} strict ones predicted",
                100.0 * agreement.unwrap_or(0.0)
            ),
            Self::Verdicts { n, loss, predicted } => {
                writeln!(
                    f,
                    "of {n} verdicts held out: log-loss {loss:.3} nats, {:.0} % predicted",
                    100.0 * predicted
                )
            }
        }
    }
}

/// How verdicts given under `protocol` are learned.
pub(crate) fn sparse_config(protocol: Protocol) -> SparseConfig {
    if protocol == Protocol::Request { SparseConfig::request() } else { SparseConfig::dros() }
}

/// Fits a fresh classifier to every verdict of the session and keeps it there.
pub(crate) fn fit_sparse(
    store: &mut SessionStore,
    model: &WorldModel,
    config: SparseConfig,
    seed: u64,
) -> anyhow::Result<(Fit, Option<HeldOutTold>)> {
    let judged: BTreeSet<_> = store.session().judged().iter().map(|judged| judged.transition.dream).collect();
    let dreams = judged.into_iter().map(|id| Ok((id, store.dream(id)?)));
    let dreams = dreams.collect::<Result<_, SessionError>>()?;
    learn_sparse(store.session(), &dreams, model, config, seed)?.keep(store)
}

/// Fits a fresh classifier to every verdict of a session with these dreams, and says how.
pub(crate) fn learn_sparse(
    session: &Session,
    dreams: &BTreeMap<DreamId, DreamEpisode>,
    model: &WorldModel,
    config: SparseConfig,
    seed: u64,
) -> anyhow::Result<Learned> {
    // Batches are small: a second thread would mostly be waited for.
    tch::set_num_threads(1);
    let judged = session.judged();
    anyhow::ensure!(!judged.is_empty(), NO_VERDICTS);
    let features: BTreeMap<_, _> = dreams.iter().map(|(id, dream)| (*id, dream.features(model))).collect();
    let row = |transition: Transition| {
        let (dream, features) = (&dreams[&transition.dream], &features[&transition.dream]);
        Ok::<_, NotFinite>(transition_row(features, &dream.actions, transition.step))
    };
    let mut epochs = 0;
    let (mut meter, mut curves) = (Meter::new(), Curves::default());
    let fitted = fit_sparse_anew(model, config, seed, &judged, row, |report| {
        epochs = report.epoch as u32;
        meter.at(EPOCHS, report.epoch, report.n_epochs, || loss(report));
        curves.epoch(report);
        ControlFlow::Continue(())
    })?;
    drop(meter);
    let mut told = None;
    let SparseFit { reward, losses, held_out } = fitted.context("the fit was broken off")?;
    if let Some(HeldOut { n, loss, accuracy }) = held_out {
        curves.held_out(f64::from(loss), Some(f64::from(accuracy)));
        told = Some(HeldOutTold::Verdicts { n, loss, predicted: accuracy });
    }
    let (after, n_labels) = (session.n_entries(), judged.len());
    let fit = Fit { after, n_labels, seed, epochs, losses, held_out: held_out.map(|held_out| held_out.loss) };
    Ok(Learned { parameters: reward.parameters(), fit, curves, held_out: told })
}

/// Fits a fresh reward to every answer of the session, or to the `first` so many, and keeps it there.
pub(crate) fn fit_reward(
    store: &mut SessionStore,
    model: &WorldModel,
    config: RewardConfig,
    seed: u64,
    held_out: Option<f64>,
    first: Option<usize>,
) -> anyhow::Result<(Fit, Option<HeldOutTold>)> {
    let dreams = store.session().dream_lens().into_iter();
    let dreams = dreams.map(|(id, _)| Ok((id, store.dream(id)?))).collect::<Result<_, SessionError>>()?;
    learn_reward(store.session(), &dreams, model, config, seed, held_out, first)?.keep(store)
}

/// Fits a fresh reward to every answer of a session with these dreams, or to the `first` so many, and says how.
pub(crate) fn learn_reward(
    session: &Session,
    dreams: &BTreeMap<DreamId, DreamEpisode>,
    model: &WorldModel,
    config: RewardConfig,
    seed: u64,
    held_out: Option<f64>,
    first: Option<usize>,
) -> anyhow::Result<Learned> {
    let features: BTreeMap<_, _> = dreams.iter().map(|(id, dream)| (*id, dream.features(model))).collect();
    let rows = |segment: SegmentRef| {
        let (dream, features) = (&dreams[&segment.dream], &features[&segment.dream]);
        Ok::<_, NotFinite>(segment_rows(features, &dream.actions, model.ranges(), segment))
    };
    let mut labels = session.labeled();
    // Queries are numbered as they are asked; those that were skipped count.
    labels.retain(|labeled| first.is_none_or(|first| (labeled.query.id.0 as usize) < first));
    anyhow::ensure!(!labels.is_empty(), NO_ANSWERS);
    let epochs = config.epochs(labels.len()) as u32;
    let figures = held_out.map(|share| predict_held_out(model, config.clone(), seed, &labels, rows, share));
    let figures = figures.transpose()?;
    let figures = figures.map(|figures| figures.context("there are too few answers to hold some out"));
    let figures = figures.transpose()?;
    let told = figures.map(HeldOutTold::Answers);
    let (mut meter, mut curves) = (Meter::new(), Curves::default());
    let fitted = fit_anew(model, config, seed, &labels, rows, |report| {
        meter.at(EPOCHS, report.epoch, report.n_epochs, || loss(report));
        curves.epoch(report);
        ControlFlow::Continue(())
    })?;
    drop(meter);
    let Fitted { trainer, losses } = fitted.context("the fit was broken off")?;
    if let Some(figures) = figures {
        curves.held_out(figures.log_loss, figures.agreement);
    }
    let fit = Fit {
        after: session.n_entries(),
        n_labels: labels.len(),
        seed,
        epochs,
        losses,
        held_out: figures.map(|figures| figures.log_loss as f32),
    };
    Ok(Learned { parameters: trainer.ensemble().parameters(), fit, curves, held_out: told })
}
