//! What the trainer knows of verdicts on transitions, and how it learns from them.

use std::collections::BTreeMap;
use std::ops::ControlFlow;

use crate::query::{JudgedTransition, QueryId, Transition};
use crate::reward::{EpochReport, FittedVerdicts, SparseConfig, fit_verdicts};
use crate::tensor::Parameters;
use crate::world_model::WorldModel;

/// From so many verdicts on, something can be learned from them: those of a trajectory.
const MIN_VERDICTS: usize = 49;
/// Once one in so many verdicts is new, all are learned anew.
const NEW_SHARE: usize = 10;
/// Steps of Adam while verdicts come in: enough to see where it goes.
const QUICK_UPDATES: usize = 300;

/// All verdicts that count.
#[derive(Debug, Default)]
pub(super) struct Judge {
    judged: BTreeMap<QueryId, JudgedTransition>,
    /// Given, changed or taken back since the last fit.
    n_new: usize,
    /// Whether the last answer that was heard of is a verdict.
    pub(super) is_last: bool,
    /// What was learned last.
    pub(super) parameters: Option<Parameters>,
}

impl Judge {
    pub(super) fn len(&self) -> usize {
        self.judged.len()
    }

    pub(super) fn hear(&mut self, judged: JudgedTransition) {
        self.is_last = true;
        if self.judged.insert(judged.query, judged) != Some(judged) {
            self.n_new += 1;
        }
    }

    pub(super) fn forget(&mut self, query: QueryId) {
        if self.judged.remove(&query).is_some() {
            self.n_new += 1;
        }
    }

    pub(super) fn is_behind(&self) -> bool {
        let n = self.judged.len();
        self.is_last && n >= MIN_VERDICTS && self.n_new > 0 && self.n_new * NEW_SHARE >= n
    }

    /// How everything is learned anew, to the end or for a first impression.
    pub(super) fn config(is_whole: bool) -> SparseConfig {
        let whole = SparseConfig::dros();
        if is_whole { whole } else { SparseConfig { updates: QUICK_UPDATES, ..whole } }
    }

    /// Learns all verdicts anew; nothing comes where `on_epoch` breaks.
    pub(super) fn fit(
        &mut self,
        model: &WorldModel,
        config: SparseConfig,
        seed: u64,
        row: impl FnMut(Transition) -> Result<Vec<f32>, String>,
        on_epoch: impl FnMut(&EpochReport) -> ControlFlow<()>,
    ) -> Result<Option<FittedVerdicts>, String> {
        let judged: Vec<_> = self.judged.values().copied().collect();
        // Where it fails it is not tried again before something changes.
        self.n_new = 0;
        let fitted = fit_verdicts(model, config, seed, &judged, row, on_epoch)?;
        if let Some(fitted) = &fitted {
            self.parameters = Some(fitted.reward.parameters());
        }
        Ok(fitted)
    }
}
