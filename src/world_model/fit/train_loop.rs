//! The training loop of one network: epochs, the best parameters, checkpoints.

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use tch::{Tensor, nn};

use crate::run::Run;
use crate::tensor::adam::Adam;
use crate::tensor::{
    Backend, NotFinite, Parameters, ParametersError, Slot, described, describes, layout_of, require_finite,
};
use crate::world_model::fit::{FitError, Progress, Report, Schedule, Stage};

/// The key of the training state in the metadata of a checkpoint.
const STATE: &str = "standing";

/// On an accelerator the loss is read once in so many updates: to read it is to wait.
const READ_EVERY: usize = 32;

/// A network in training.
pub(super) struct TrainLoop<'a> {
    stage: Stage,
    backend: Backend,
    schedule: &'a Schedule,
    store: nn::VarStore,
    /// How the network is stored.
    slots: Vec<Slot>,
    adam: Adam,
    rng: ChaCha8Rng,
    state: TrainState,
}

/// How far training is. With the network and the optimizer this makes a checkpoint.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct TrainState {
    epoch: usize,
    learning_rate: f64,
    best: f64,
    n_stale: usize,
    /// What the scores depend on: only scores of the same fingerprint compare.
    #[serde(default, rename = "basis")]
    fingerprint: String,
}

/// The name of a checkpoint of the network that `stage` trains.
fn checkpoint(stage: Stage, which: &str) -> String {
    let network = if stage == Stage::Vae { "vae" } else { "mdn_rnn" };
    format!("{network}-{which}")
}

/// The least loss on held-out episodes of the network that `stage` trains, as far as it was trained in `run`.
pub(super) fn best(run: &Run, stage: Stage) -> Result<Option<f64>, FitError> {
    let Some(saved) = run.load(&checkpoint(stage, "best"))? else { return Ok(None) };
    let none = |_| ParametersError::Missing(STATE.to_owned());
    let (_, state): (u32, TrainState) = describes(saved.metadata(STATE).as_deref()).map_err(none)?;
    Ok(Some(state.best))
}

impl<'a> TrainLoop<'a> {
    /// The network in `store` before its first epoch. `fingerprint` says what its scores depend on.
    pub(super) fn new(
        (stage, backend): (Stage, Backend),
        schedule: &'a Schedule,
        (store, slots): (nn::VarStore, Vec<Slot>),
        rng: ChaCha8Rng,
        fingerprint: String,
    ) -> Self {
        let adam = Adam::new(&store);
        let learning_rate = schedule.learning_rate;
        let state = TrainState { epoch: 0, learning_rate, best: f64::INFINITY, n_stale: 0, fingerprint };
        Self { stage, backend, schedule, store, slots, adam, rng, state }
    }

    /// The name of a checkpoint.
    fn file(&self, which: &str) -> String {
        checkpoint(self.stage, which)
    }

    /// Goes on from the last checkpoint, if there is one.
    ///
    /// Where the fingerprint differs, the network is kept, but all epochs are still to come.
    fn resume(&mut self, run: &Run) -> Result<(), FitError> {
        let Some(saved) = run.load(&self.file("last"))? else { return Ok(()) };
        let none = |_| ParametersError::Missing(STATE.to_owned());
        let (layout, state): (u32, TrainState) = describes(saved.metadata(STATE).as_deref()).map_err(none)?;
        saved.fill("net", &self.slots, layout, &self.store)?;
        let slots = &self.slots;
        let restored = self.adam.restore(|name| {
            let tensor = saved.finite(&format!("adam.{name}")).ok()??;
            let of = name.rsplit_once('.').and_then(|(of, _)| slots.iter().find(|slot| slot.name == of));
            of.map_or(Some(tensor.shallow_clone()), |slot| slot.read(&tensor, layout))
        });
        restored.ok_or_else(|| ParametersError::Missing("adam".to_owned()))?;
        if state.fingerprint == self.state.fingerprint {
            self.state = state;
        }
        Ok(())
    }

    fn checkpoint(&self, run: &Run) -> Result<(), FitError> {
        let slot = |name: &str| self.slots.iter().find(|slot| slot.name == name);
        let stored =
            |of: &str, tensor: Tensor| slot(of).map_or(tensor.shallow_clone(), |s| s.from_memory(&tensor));
        let net = self.store.variables().into_iter();
        let net = net.map(|(name, tensor)| (format!("net.{name}"), stored(&name, tensor)));
        let adam = self.adam.state().into_iter().map(|(name, tensor)| {
            let of = name.rsplit_once('.').map_or("", |(of, _)| of);
            (format!("adam.{name}"), stored(of, tensor))
        });
        let all = Parameters::from_tensors(net.chain(adam), &[(STATE, described(&self.state))]);
        run.save(&self.file("last"), &all)?;
        Ok(())
    }

    /// Where a number is not one, in words.
    fn at(&self, what: &str, update: usize) -> NotFinite {
        let network = if self.stage == Stage::Vae { "vision" } else { "memory" };
        NotFinite(format!("{what} of {network} at update {update} of epoch {}", self.state.epoch + 1))
    }

    /// Runs all epochs that are left, then takes the best parameters back.
    ///
    /// `update` is told the epoch.
    pub(super) fn run(
        mut self,
        run: &Run,
        clip: Option<f64>,
        mut update: impl FnMut(&mut ChaCha8Rng, usize) -> Result<(Tensor, usize), FitError>,
        mut score: impl FnMut(&mut ChaCha8Rng) -> Result<f64, FitError>,
        report: &mut Report<'_>,
    ) -> Result<nn::VarStore, FitError> {
        self.resume(run)?;
        let Schedule { updates_per_epoch, max_epochs, min_learning_rate, patience, .. } = *self.schedule;
        while self.state.epoch < max_epochs && self.state.learning_rate >= min_learning_rate {
            // Each epoch has a stream of its own, so that a resumed fit goes on as it would have.
            let learning_rate = self.state.learning_rate.min(self.schedule.ceiling(self.state.epoch));
            self.rng.set_stream(self.state.epoch as u64 + 1);
            self.rng.set_word_pos(0);
            self.backend.begin(&mut self.rng);
            let mut progress = Progress {
                stage: self.stage,
                epoch: self.state.epoch,
                max_epochs,
                done: 0,
                n: updates_per_epoch,
                items: 0,
                loss: 0.0,
                held_out: None,
                learning_rate,
                is_best: false,
            };
            let read_every = if self.backend.is_cpu() { 1 } else { READ_EVERY };
            let (mut sum, mut unread) = (0.0, None::<Tensor>);
            for done in 1..=updates_per_epoch {
                let (loss, items) = update(&mut self.rng, self.state.epoch)?;
                let fresh = loss.detach();
                let fresh = unread.take().map_or_else(|| fresh.shallow_clone(), |unread| unread + &fresh);
                if done % read_every == 0 || done == updates_per_epoch {
                    let value = fresh.double_value(&[]);
                    if !value.is_finite() {
                        return Err(FitError::NotFinite(self.at("the loss", done)));
                    }
                    sum += value;
                    progress.loss = sum / done as f64;
                } else {
                    unread = Some(fresh);
                }
                self.adam.step(&loss, learning_rate, clip);
                progress = Progress { done, items, ..progress };
                if done < updates_per_epoch && report(&progress).is_break() {
                    return Err(FitError::Stopped);
                }
            }
            require_finite(&self.store, "the network")
                .map_err(|NotFinite(which)| FitError::NotFinite(self.at(&which, updates_per_epoch)))?;
            let held_out = tch::no_grad(|| score(&mut ChaCha8Rng::seed_from_u64(0)))?;
            if !held_out.is_finite() {
                return Err(FitError::NotFinite(self.at("the loss on held-out episodes", updates_per_epoch)));
            }
            let is_best = held_out < self.state.best;
            self.state.epoch += 1;
            if is_best {
                self.state.best = held_out;
                self.state.n_stale = 0;
                let stores: [(&str, &nn::VarStore, &[Slot]); 1] = [("net", &self.store, &self.slots)];
                let best = Parameters::stored(&stores, &[(STATE, described(&self.state))]);
                run.save(&self.file("best"), &best)?;
            } else {
                self.state.n_stale += 1;
                if self.state.n_stale >= patience {
                    self.state.learning_rate /= 3.0;
                    self.state.n_stale = 0;
                }
            }
            self.checkpoint(run)?;
            progress = Progress { epoch: self.state.epoch, held_out: Some(held_out), is_best, ..progress };
            run.log(&progress)?;
            let network = if self.stage == Stage::Vae { "vision" } else { "memory" };
            let curve = |name: &str| format!("{network}/{name}");
            let points = [
                (&*curve("loss"), progress.loss as f32),
                (&*curve("held out"), held_out as f32),
                (&*curve("learning rate"), progress.learning_rate as f32),
            ];
            run.plot(progress.epoch as u64, &points)?;
            if report(&progress).is_break() {
                return Err(FitError::Stopped);
            }
        }
        if let Some(best) = run.load(&self.file("best"))? {
            let layout = layout_of(best.metadata(STATE).as_deref()).map_err(ParametersError::Description)?;
            best.fill("net", &self.slots, layout, &self.store)?;
        }
        Ok(self.store)
    }
}
