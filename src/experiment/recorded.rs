//! World models learned from few and from many recorded episodes (the paper's Figures 14 and 15).
//!
//! ```text
//! worlds/recordings/              what is recorded, once for all: held-out episodes first
//! worlds/0025-1.safetensors       learned from 25 of them by the seed 1; what it takes to go on is in 0025-1.safetensors.fit/
//! worlds/0025-1.probe.safetensors what the stand-in for a person sees its pictures with
//! worlds/0025-1.json              what it can; written last
//! ```
//!
//! All methods of a number of episodes and a seed share a model: the first trial that wants it learns it, others wait.
//! Which episodes are learned from is drawn by the seed, and fewer are always among more; the held-out ones are the same for all.
//!
//! `// DIFFERENCE:` the stand-in's eyes are fitted anew for each model, on what the simulator or the recordings tell of its
//! pictures. A person brings theirs along, but knows what a road looks like even where it is painted badly; a probe that was
//! fitted on the pictures of one model knows it of no other.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rand::SeedableRng as _;
use rand::seq::SliceRandom as _;
use rand_chacha::ChaCha8Rng;

use super::description::Description;
use super::options::WorldModels;
use super::trial::Stage;
use crate::dataset::{Dataset, DatasetError};
use crate::evaluation::fidelity::{Fidelity, FidelityError, fidelity};
use crate::planner::with_snippets_of;
use crate::run::{Run, RunError, hold, read_at_most, read_parameters, write_whole};
use crate::simulate::probe::{ProbeError, Reads};
use crate::simulate::record::{RecordError, record};
use crate::simulate::{FitProbeConfig, FitProbeError, Probe, fit_car_probe, fit_event_probe};
use crate::tensor::{NotFinite, Parameters};
use crate::world::cars::{Aids, CarWorld};
use crate::world::{End, Frame, OwnPolicy, Step, World, WorldError, WorldSpec};
use crate::world_model::fit::{self, FitConfig, FitError, Means, Progress, Split, best_losses, fit_world_on};
use crate::world_model::{WorldModel, WorldModelConfig, WorldModelError};

/// The seed of recordings.
const RECORDED: u64 = 0;
/// Stretches of held-out episodes that are dreamed again.
const STRETCHES: usize = 40;
/// Bytes of a note.
const MOST: u64 = 1 << 16;

/// A world model that was learned for an experiment.
#[derive(Debug)]
pub struct LearnedWorld {
    /// The model.
    pub model: WorldModel,
    /// Through which people are stood in for in its dreams.
    pub probe: Probe,
    /// What it can, by the keys of [`WORLD_MODEL`](super::table::WORLD_MODEL).
    pub figures: BTreeMap<String, f64>,
}

/// Why there is no such world model.
#[derive(Debug, thiserror::Error)]
pub enum RecordedError {
    /// The world cannot be opened.
    #[error("{0}")]
    World(String),
    /// Nothing can be recorded.
    #[error(transparent)]
    Record(Box<RecordError>),
    /// Recordings cannot be read.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// It cannot be learned.
    #[error(transparent)]
    Fit(Box<FitError>),
    /// What was learned cannot be used.
    #[error(transparent)]
    Model(#[from] WorldModelError),
    /// Its fidelity cannot be told.
    #[error(transparent)]
    Fidelity(Box<FidelityError>),
    /// What the stand-in sees with cannot be fitted.
    #[error("what the stand-in sees with cannot be fitted: {0}")]
    FitProbe(Box<FitProbeError>),
    /// What the stand-in sees with is not finite.
    #[error("what the stand-in sees with cannot be fitted: {0}")]
    NotFinite(#[from] NotFinite),
    /// What the stand-in sees with cannot be used.
    #[error(transparent)]
    Probe(#[from] ProbeError),
    /// A file cannot be used.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A note cannot be read.
    #[error("cannot read {path:?} ({met}): remove it, and the world model is learned again")]
    Note {
        /// Where.
        path: PathBuf,
        /// What was met.
        met: String,
    },
    /// It was told to end.
    #[error("the trial was broken off")]
    Stopped,
}

impl From<RecordError> for RecordedError {
    fn from(met: RecordError) -> Self {
        Self::Record(Box::new(met))
    }
}

impl From<FitError> for RecordedError {
    fn from(met: FitError) -> Self {
        Self::Fit(Box::new(met))
    }
}

impl From<FidelityError> for RecordedError {
    fn from(met: FidelityError) -> Self {
        Self::Fidelity(Box::new(met))
    }
}

impl From<FitProbeError> for RecordedError {
    fn from(met: FitProbeError) -> Self {
        Self::FitProbe(Box::new(met))
    }
}

/// Opens the world without aids, to record in it.
pub type Open<'a> = dyn Fn(bool) -> Result<Box<dyn World>, String> + 'a;
type OnStage<'a> = dyn FnMut(Stage) -> ControlFlow<()> + 'a;

/// The world model of `recorded` episodes for the trials of `seed` in the experiment's folder `dir`: read, or learned if nobody
/// did that yet. What was begun and killed is gone on with.
///
/// # Errors
/// Where it cannot be learned or read, or `on_stage` breaks off.
///
/// # Panics
/// Where the description does not ask for it.
pub fn learned_world(
    dir: &Path,
    description: &Description,
    spec: &Arc<WorldSpec>,
    open: &Open<'_>,
    (recorded, seed): (usize, u64),
    on_stage: &mut OnStage<'_>,
) -> Result<LearnedWorld, RecordedError> {
    let Some(how) = &description.world_models else { panic!("nobody asked for a world model") };
    let dir = dir.join("worlds");
    let file = |end: &str| dir.join(format!("{recorded:04}-{seed}.{end}"));
    // Others that want the same wait here until it is whole.
    let _held = hold(&file("lock"))?;
    let note = file("json");
    if !note.exists() {
        let most = description.recorded.iter().copied().max().unwrap_or(recorded);
        let dataset = recordings(&dir, how, spec, open, most, on_stage)?;
        let made = Making { how, spec, dataset: &dataset, split: split(how, most, recorded, seed), seed };
        let parameters = made.model(&file("safetensors"), on_stage)?;
        let model = WorldModel::load(parameters.clone())?;
        let (probe, accuracy) = made.probe(&model, on_stage)?;
        let figures = made.figures(&file("safetensors"), &model, accuracy)?;
        write_whole(&file("safetensors"), parameters.bytes())?;
        write_whole(&file("probe.safetensors"), probe.bytes())?;
        let told = serde_json::to_vec_pretty(&figures).unwrap_or_else(|met| unreachable!("numbers: {met}"));
        write_whole(&note, &told)?;
    }
    let unreadable = |met: String| RecordedError::Note { path: note.clone(), met };
    let told = read_at_most(&note, MOST).map_err(|met| unreadable(met.to_string()))?.unwrap_or_default();
    Ok(LearnedWorld {
        model: WorldModel::load(read_parameters(&file("safetensors"))?)?,
        probe: Probe::load(&read_parameters(&file("probe.safetensors"))?)?,
        figures: serde_json::from_slice(&told).map_err(|met| unreadable(met.to_string()))?,
    })
}

/// Records what is missing: held-out episodes and those that are learned from, `most` of them.
fn recordings(
    dir: &Path,
    how: &WorldModels,
    spec: &Arc<WorldSpec>,
    open: &Open<'_>,
    most: usize,
    on_stage: &mut OnStage<'_>,
) -> Result<Dataset, RecordedError> {
    let into = dir.join("recordings");
    let _held = hold(&dir.join("recordings.lock"))?;
    let n = how.held_out + most;
    let mut dataset = Dataset::create_or_open(&into, &spec.name)?;
    if dataset.n_episodes() < n {
        let left = how.episode_steps.unwrap_or(usize::MAX);
        let mut world = Short { world: open(false).map_err(RecordedError::World)?, longest: left, left };
        let (mut done, mut is_stopped) = (dataset.n_episodes(), false);
        record(&mut world, &mut dataset, 0..n as u64, RECORDED, |_| {
            done += 1;
            let go_on = on_stage(("recording episodes", done, n));
            is_stopped |= go_on.is_break();
            go_on
        })?;
        if is_stopped {
            return Err(RecordedError::Stopped);
        }
    }
    drop(dataset);
    Ok(Dataset::open_as(&into, spec)?)
}

/// The first episodes are held out, and of the others as many are learned from as are wanted: the first of an order that the
/// seed draws, so that fewer are among more.
fn split(how: &WorldModels, most: usize, recorded: usize, seed: u64) -> Split {
    let mut pool: Vec<usize> = (how.held_out..how.held_out + most).collect();
    pool.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));
    pool.truncate(recorded);
    Split { train: pool, held_out: (0..how.held_out).collect() }
}

/// A model that is learned.
struct Making<'a> {
    how: &'a WorldModels,
    spec: &'a Arc<WorldSpec>,
    dataset: &'a Dataset,
    split: Split,
    seed: u64,
}

impl Making<'_> {
    fn model(&self, out: &Path, on_stage: &mut OnStage<'_>) -> Result<Parameters, RecordedError> {
        let usual = FitConfig::for_world(self.spec);
        let schedule = |usual: fit::Schedule, epochs, updates| fit::Schedule {
            max_epochs: epochs,
            updates_per_epoch: updates,
            ..usual
        };
        let how = self.how;
        let settings = FitConfig {
            seed: self.seed,
            vae: schedule(usual.vae, how.vae_epochs, how.vae_updates),
            mdn_rnn: schedule(usual.mdn_rnn, how.mdn_rnn_epochs, how.mdn_rnn_updates),
            ..usual
        };
        let config = WorldModelConfig::for_world(self.spec);
        let run = Run::beside(out, true)?;
        let mut report = |progress: &Progress| {
            let what = match progress.stage {
                fit::Stage::Vae => "learning to see, updates",
                fit::Stage::Encode => "encoding episodes",
                fit::Stage::MdnRnn => "learning to remember, updates",
            };
            let before = progress.epoch.saturating_sub(usize::from(progress.held_out.is_some()));
            on_stage((what, before * progress.n + progress.done, progress.max_epochs * progress.n))
        };
        let means = Means::default();
        let fitted = fit_world_on(means, self.dataset, &self.split, &config, &settings, &run, &mut report);
        let parameters = fitted.map_err(|met| match met {
            FitError::Stopped => RecordedError::Stopped,
            met => met.into(),
        })?;
        let go_on = &mut |_, _| ControlFlow::Continue(());
        let with = with_snippets_of(parameters, self.dataset, &self.split.train, go_on)?;
        with.ok_or(RecordedError::Stopped)
    }

    /// A probe, and how often it is right in pictures that the model paints of held-out moments.
    fn probe(
        &self,
        model: &WorldModel,
        on_stage: &mut OnStage<'_>,
    ) -> Result<(Parameters, Option<f64>), RecordedError> {
        let usual = FitProbeConfig::for_world(self.spec);
        let config = FitProbeConfig {
            n_updates: self.how.probe_updates,
            seed: self.seed,
            n_episodes: self.how.probe_episodes,
            n_held_out: (self.how.probe_episodes / 10).max(1),
            ..usual
        };
        let mut is_stopped = false;
        let mut report = |progress: &crate::simulate::fit_probe::Progress| {
            let go_on = on_stage(("fitting what the stand-in sees with", progress.done, progress.n));
            is_stopped |= go_on.is_break();
            go_on
        };
        let (parameters, accuracy) = if let Reads::Car { .. } = config.probe.reads {
            let name = self.spec.source.world.as_deref().unwrap_or(&self.spec.name);
            let none = || RecordedError::World(format!("there is no built-in world {name:?}"));
            let mut world = CarWorld::open(name, Aids::NONE).ok_or_else(none)?;
            let fitted = fit_car_probe(&config, world.simulation(), Some(model), &mut report)?;
            (fitted.parameters, fitted.painted.map(|painted| painted.off_road_accuracy))
        } else {
            let config = FitProbeConfig { n_episodes: usual.n_episodes, ..config };
            let fitted = fit_event_probe(&config, self.dataset, self.spec, Some(model), &mut report)?;
            let accuracy = fitted.painted.and_then(|painted| {
                let all = painted.events.iter().map(|event| event.accuracy);
                let n = painted.events.len();
                (n > 0).then(|| all.sum::<f64>() / n as f64)
            });
            (fitted.parameters, accuracy)
        };
        if is_stopped {
            return Err(RecordedError::Stopped);
        }
        Ok((parameters, accuracy))
    }

    fn figures(
        &self,
        out: &Path,
        model: &WorldModel,
        accuracy: Option<f64>,
    ) -> Result<BTreeMap<String, f64>, RecordedError> {
        let mut figures = BTreeMap::new();
        let mut tell = |key: &str, value: f64| {
            if value.is_finite() {
                figures.insert(key.to_owned(), value);
            }
        };
        if let Some([vision, memory]) = best_losses(&Run::beside(out, true)?)? {
            tell("vision_loss", vision);
            tell("memory_loss", memory);
        }
        let held_out = &self.split.held_out;
        // Two of an episode at the most: they overlap where there are few.
        let (found, _) = fidelity(model, self.dataset, held_out, STRETCHES.min(2 * held_out.len()), 0)?;
        if found.n_stretches > 0 {
            tell("seen_error", f64::from(found.reconstruction));
            let ahead = Fidelity::STEPS.iter().position(|steps| *steps == 25);
            if let Some(i) = ahead {
                tell("dreamed_error", f64::from(found.dreamed[i]));
            }
        }
        if let Some(accuracy) = accuracy {
            tell("probe_accuracy", accuracy);
        }
        Ok(figures)
    }
}

/// A world whose episodes are over after so many steps.
struct Short {
    world: Box<dyn World>,
    longest: usize,
    left: usize,
}

impl World for Short {
    fn spec(&self) -> &Arc<WorldSpec> {
        self.world.spec()
    }

    fn reset(&mut self, seed: u64) -> Result<Frame, WorldError> {
        self.left = self.longest;
        self.world.reset(seed)
    }

    fn step(&mut self, action: &[f32]) -> Result<Step, WorldError> {
        let step = self.world.step(action)?;
        self.left = self.left.saturating_sub(1);
        let end = step.end.or((self.left == 0).then_some(End::Truncated));
        Ok(Step { end, ..step })
    }

    fn sensors(&self) -> Vec<String> {
        self.world.sensors()
    }

    fn state(&self) -> Vec<f32> {
        self.world.state()
    }

    fn policy(&mut self) -> Option<&mut dyn OwnPolicy> {
        self.world.policy()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::{Scale, named};

    fn open(_: bool) -> Result<Box<dyn World>, String> {
        let world = CarWorld::open("car-racing", Aids::NONE).ok_or("it is built in")?;
        Ok(Box::new(world))
    }

    #[test]
    fn fewer_episodes_are_among_more_and_all_hold_out_the_same() {
        let how = named("world-size").unwrap().world_models.unwrap();
        let (few, many) = (split(&how, 100, 10, 3), split(&how, 100, 50, 3));
        assert_eq!(few.held_out, many.held_out);
        assert_eq!(few.train, many.train[..10]);
        assert!(many.train.iter().all(|episode| !many.held_out.contains(episode)));
        assert_ne!(split(&how, 100, 10, 4).train, few.train, "another seed learns from others");
    }

    #[test]
    fn a_world_model_is_learned_once_and_gone_on_with_where_it_was_left() {
        tch::set_num_threads(1);
        let dir = tempfile::tempdir().unwrap();
        let description = named("world-size").unwrap().at(Scale::Toy);
        let spec = Arc::new(WorldSpec::built_in("car-racing").unwrap());
        // The first is broken off while it learns to remember.
        let stop = &mut |(what, ..): Stage| {
            if what.contains("remember") { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        let met = learned_world(dir.path(), &description, &spec, &open, (2, 0), stop).unwrap_err();
        assert!(matches!(met, RecordedError::Stopped), "{met}");
        let mut stages: Vec<&'static str> = Vec::new();
        let mut note = |(what, ..): Stage| {
            stages.push(what);
            ControlFlow::Continue(())
        };
        let learned = learned_world(dir.path(), &description, &spec, &open, (2, 0), &mut note).unwrap();
        assert!(
            !stages.iter().any(|what| what.contains("to see") || what.contains("recording")),
            "{stages:?}"
        );
        assert_eq!(learned.model.held_out(), Some(vec![0]));
        assert!(learned.figures["vision_loss"] > 0.0 && learned.figures.contains_key("memory_loss"));
        assert!(learned.figures["seen_error"] > 0.0 && learned.figures["dreamed_error"] > 0.0);
        learned.probe.require(&learned.model).unwrap();
        // It is there now, and is read.
        let never = &mut |_| panic!("nothing is to be done");
        let again = learned_world(dir.path(), &description, &spec, &open, (2, 0), never).unwrap();
        assert_eq!((again.model.hash(), again.figures), (learned.model.hash(), learned.figures));
        let other =
            learned_world(dir.path(), &description, &spec, &open, (3, 0), &mut |_| ControlFlow::Continue(()));
        assert_ne!(other.unwrap().model.hash(), again.model.hash());
    }
}
