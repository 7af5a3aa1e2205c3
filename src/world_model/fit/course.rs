//! One network on its way: epochs, the best parameters, checkpoints.

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use tch::{Tensor, nn};

use crate::run::Run;
use crate::tensor::adam::Adam;
use crate::tensor::{Parameters, ParametersError};
use crate::world_model::fit::{FitError, Progress, Report, Schedule, Stage};

/// A network on its way.
pub(super) struct Course<'a> {
    stage: Stage,
    schedule: &'a Schedule,
    store: nn::VarStore,
    adam: Adam,
    rng: ChaCha8Rng,
    standing: Standing,
}

/// How far it is; with the network and the optimizer this is a checkpoint.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Standing {
    epoch: usize,
    learning_rate: f64,
    best: f64,
    n_stale: usize,
    /// What scores rest on: those that rest on something else do not compare.
    #[serde(default)]
    basis: String,
}

impl<'a> Course<'a> {
    /// The network in `store` at its start; `basis` says what its scores rest on.
    pub(super) fn new(
        stage: Stage,
        schedule: &'a Schedule,
        store: nn::VarStore,
        rng: ChaCha8Rng,
        basis: String,
    ) -> Self {
        let adam = Adam::new(&store);
        let learning_rate = schedule.learning_rate;
        let standing = Standing { epoch: 0, learning_rate, best: f64::INFINITY, n_stale: 0, basis };
        Self { stage, schedule, store, adam, rng, standing }
    }

    /// The name of a checkpoint.
    fn file(&self, which: &str) -> String {
        let network = if self.stage == Stage::Vae { "vae" } else { "mdn_rnn" };
        format!("{network}-{which}")
    }

    /// Goes on from the last checkpoint, if there is one; where scores rest on something else by now, all epochs are
    /// still to come, and the network begins them as it is.
    fn resume(&mut self, run: &Run) -> Result<(), FitError> {
        let Some(saved) = run.load(&self.file("last"))? else { return Ok(()) };
        saved.load("net", &self.store)?;
        let restored = self.adam.restore(|name| saved.tensor(&format!("adam.{name}")));
        let standing: Option<Standing> =
            saved.metadata("standing").and_then(|text| serde_json::from_str(&text).ok());
        let (Some(()), Some(standing)) = (restored, standing) else {
            return Err(ParametersError::Missing("adam".to_owned()).into());
        };
        if standing.basis == self.standing.basis {
            self.standing = standing;
        }
        Ok(())
    }

    fn checkpoint(&self, run: &Run) -> Result<(), FitError> {
        let standing =
            serde_json::to_string(&self.standing).unwrap_or_else(|e| unreachable!("plain data: {e}"));
        let net = self.store.variables().into_iter().map(|(name, tensor)| (format!("net.{name}"), tensor));
        let adam = self.adam.state().into_iter().map(|(name, tensor)| (format!("adam.{name}"), tensor));
        let all = Parameters::from_tensors(net.chain(adam), &[("standing", standing)]);
        run.save(&self.file("last"), &all)?;
        Ok(())
    }

    /// Runs all epochs that are left, then takes the best parameters back.
    pub(super) fn run(
        mut self,
        run: &Run,
        clip: Option<f64>,
        mut update: impl FnMut(&mut ChaCha8Rng) -> Result<(Tensor, usize), FitError>,
        mut score: impl FnMut(&mut ChaCha8Rng) -> Result<f64, FitError>,
        report: &mut Report<'_>,
    ) -> Result<nn::VarStore, FitError> {
        self.resume(run)?;
        let Schedule { updates_per_epoch, max_epochs, min_learning_rate, patience, .. } = *self.schedule;
        while self.standing.epoch < max_epochs && self.standing.learning_rate >= min_learning_rate {
            // Each epoch has a stream of its own, so that a resumed fit goes on as it would have.
            let learning_rate = self.standing.learning_rate.min(self.schedule.ceiling(self.standing.epoch));
            self.rng.set_stream(self.standing.epoch as u64 + 1);
            self.rng.set_word_pos(0);
            let mut progress = Progress {
                stage: self.stage,
                epoch: self.standing.epoch,
                max_epochs,
                done: 0,
                n: updates_per_epoch,
                items: 0,
                loss: 0.0,
                held_out: None,
                learning_rate,
                is_best: false,
            };
            let mut sum = 0.0;
            for done in 1..=updates_per_epoch {
                let (loss, items) = update(&mut self.rng)?;
                self.adam.step(&loss, learning_rate, clip);
                sum += loss.double_value(&[]);
                progress = Progress { done, items, loss: sum / done as f64, ..progress };
                if done < updates_per_epoch && report(&progress).is_break() {
                    return Err(FitError::Stopped);
                }
            }
            let held_out = tch::no_grad(|| score(&mut ChaCha8Rng::seed_from_u64(0)))?;
            let is_best = held_out < self.standing.best;
            self.standing.epoch += 1;
            if is_best {
                self.standing.best = held_out;
                self.standing.n_stale = 0;
                run.save(&self.file("best"), &Parameters::of(&[("net", &self.store)], &[]))?;
            } else {
                self.standing.n_stale += 1;
                if self.standing.n_stale >= patience {
                    self.standing.learning_rate /= 3.0;
                    self.standing.n_stale = 0;
                }
            }
            self.checkpoint(run)?;
            progress = Progress { epoch: self.standing.epoch, held_out: Some(held_out), is_best, ..progress };
            run.log(&progress)?;
            if report(&progress).is_break() {
                return Err(FitError::Stopped);
            }
        }
        if let Some(best) = run.load(&self.file("best"))? {
            best.load("net", &self.store)?;
        }
        Ok(self.store)
    }
}
