//! Learning by driving: episodes with noise, updates on the way, evaluations without noise, and a checkpoint with every
//! episode.
//!
//! An episode is the unit of all that is kept, for no world can be put back into the middle of one. Killed, the job goes on
//! with the episode that it was in; on the processor it then does what it would have done.
//!
//! `// DIFFERENCE:` the published program does not keep its replay buffer with a checkpoint, and ends in the middle of an episode.

use std::collections::BTreeMap;

use rand::{Rng as _, RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::agent::{DrqAgent, DrqPolicy, Nature, Sight};
use super::learner::{Learner, Losses};
use super::noise::perturbed;
use super::record::{Evaluated, Finished, Progress, Record, Report};
use super::replay::{Episode, Replay, ReplayError};
use super::{Beside, DrqConfig, curve};
use crate::evaluation::{EpisodeError, EpisodeMetrics, Summary, TracksAlike, evaluate_episode};
use crate::run::{Run, RunError};
use crate::tensor::limits::OutOfRange;
use crate::tensor::{
    Backend, NotFinite, Parameters, ParametersError, described, describes, from_slice, normal, to_vec,
};
use crate::world::{End, EventKind, Step, World, WorldError, event_slug};

/// The name of the checkpoint, and the key of the state in its metadata.
const LAST: &str = "last";
const STATE: &str = "state";
/// The name of the note of what was begun.
const TERMS: &str = "terms";
/// Losses are read once in so many updates: to read them is to wait.
const READ_EVERY: u64 = 16;

/// Why learning broke off.
#[derive(Debug, thiserror::Error)]
pub enum DrqError {
    /// A number cannot be.
    #[error(transparent)]
    OutOfRange(#[from] OutOfRange),
    /// The folder of the job cannot be read or written.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A checkpoint cannot be gone on with.
    #[error("the checkpoint cannot be gone on with: {0}")]
    Checkpoint(#[from] ParametersError),
    /// A file of the replay buffer is damaged.
    #[error("episode {episode}: {met}")]
    Replay {
        /// Its number.
        episode: u64,
        /// What is wrong with it.
        met: ReplayError,
    },
    /// Another job was begun in this folder.
    #[error(
        "the job in this folder was begun with other settings or in another world; begin anew, without `--resume`"
    )]
    Others,
    /// The world has no reward.
    #[error("the world {0:?} tells no reward, and DrQ-v2 learns by nothing else")]
    NoReward(String),
    /// A number that was computed is none.
    #[error(transparent)]
    NotFinite(#[from] NotFinite),
    /// The world failed.
    #[error("the world failed in episode {episode}: {met}")]
    World {
        /// Its number.
        episode: u64,
        /// What it met.
        met: WorldError,
    },
    /// An evaluation broke off.
    #[error("an evaluation broke off: {0}")]
    Evaluation(#[from] EpisodeError),
    /// Whoever listens stopped it.
    #[error("stopped; with `--resume` it goes on from the last whole episode")]
    Stopped,
}

/// How far it is, in whole episodes. With networks, optimizers and the replay buffer this makes a checkpoint.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct TrainState {
    /// Steps of the world.
    steps: u64,
    actions: u64,
    episodes: u64,
    updates: u64,
    /// Steps in which something went on that must not happen.
    unsafe_steps: u64,
    /// How often each event of the world was counted, by its name in results.
    events: BTreeMap<String, u64>,
    /// Lines of the metrics.
    records: usize,
    /// The numbers of the episodes in the replay buffer.
    replay: Vec<u64>,
}

/// Where and by what a job is done.
#[derive(Clone, Copy, Debug)]
pub struct Job<'a> {
    /// What computes.
    pub backend: Backend,
    /// The folder.
    pub run: &'a Run,
    /// What is drawn beside the curve.
    pub beside: &'a [Beside],
}

/// A job on its way.
struct Training<'a> {
    world: &'a mut dyn World,
    config: &'a DrqConfig,
    backend: Backend,
    run: &'a Run,
    beside: &'a [Beside],
    learner: Learner,
    replay: Replay,
    state: TrainState,
    records: Vec<Record>,
}

/// Learns in `world` until [`DrqConfig::steps`] are driven, from the last checkpoint in the job's folder if there is one; the
/// agent's parameters.
///
/// Beside checkpoints, the replay buffer and the metrics, the folder has the curve, as tables and as a figure.
///
/// # Errors
/// Where the world or the disk fails, where a number is none, and where `report` breaks.
pub fn train(
    world: &mut dyn World,
    config: &DrqConfig,
    Job { backend, run, beside }: Job<'_>,
    report: &mut Report<'_>,
) -> Result<Parameters, DrqError> {
    let spec = std::sync::Arc::clone(world.spec());
    config.check_for(spec.image.trained())?;
    let now = Nature::of(&spec, &config.lasting());
    match run.recall::<Nature>(TERMS)? {
        Some(began) if began != now => return Err(DrqError::Others),
        Some(_) => {}
        None => run.note(TERMS, &now)?,
    }
    let rng = &mut ChaCha8Rng::seed_from_u64(config.seed);
    backend.begin(&mut rng.clone());
    let learner = Learner::new(&spec, config, backend, rng)?;
    let (replay, state, records) = Default::default();
    let mut training = Training { world, config, backend, run, beside, learner, replay, state, records };
    training.resume()?;
    while training.state.steps < config.steps {
        training.evaluate_if_due(report)?;
        training.episode(report)?;
    }
    if training.evaluated_at() != Some(training.state.steps) {
        training.evaluate(report)?;
    }
    training.show()?;
    Ok(training.learner.agent_parameters())
}

/// The file of an episode in the replay buffer.
fn file_of(episode: u64) -> String {
    format!("episode-{episode:06}.replay")
}

/// What the steps of an episode brought.
#[derive(Default)]
struct Brought {
    ret: f32,
    n_steps: u64,
    unsafe_steps: u64,
    events: Vec<u64>,
}

impl Brought {
    fn add(&mut self, step: &Step, spec: &crate::world::WorldSpec) {
        self.ret += step.reward.unwrap_or_default();
        self.n_steps += 1;
        self.events.resize(spec.events.len(), 0);
        let mut is_unsafe = false;
        for ((event, now), count) in spec.events.iter().zip(&step.events).zip(&mut self.events) {
            *count += u64::from(now.happened);
            is_unsafe |= event.kind == EventKind::Safety && (now.goes_on || now.happened);
        }
        self.unsafe_steps += u64::from(is_unsafe);
    }
}

/// The means of what updates were about, read now and then.
#[derive(Default)]
struct Means {
    unread: Vec<Losses>,
    sums: [f64; 2],
    n: u64,
}

impl Means {
    fn add(&mut self, losses: Losses, updates: u64) -> Result<(), NotFinite> {
        self.unread.push(losses);
        if updates.is_multiple_of(READ_EVERY) { self.read(updates) } else { Ok(()) }
    }

    fn read(&mut self, updates: u64) -> Result<(), NotFinite> {
        for Losses { critic, target } in self.unread.drain(..) {
            let values = [critic.double_value(&[]), target.double_value(&[])];
            if !values.iter().all(|value| value.is_finite()) {
                return Err(NotFinite(format!("the loss of the critic at update {updates}")));
            }
            self.n += 1;
            (0..2).for_each(|i| self.sums[i] += values[i]);
        }
        Ok(())
    }

    fn of(&self, i: usize) -> Option<f32> {
        (self.n > 0).then(|| (self.sums[i] / self.n as f64) as f32)
    }
}

impl Training<'_> {
    /// Goes on from the last checkpoint, if there is one.
    fn resume(&mut self) -> Result<(), DrqError> {
        let Some(kept) = self.run.load(LAST)? else { return Ok(()) };
        let none = |_| ParametersError::Missing(STATE.to_owned());
        let (_, state): (u32, TrainState) = describes(kept.metadata(STATE).as_deref()).map_err(none)?;
        self.learner.restore(&kept)?;
        for &episode in &state.replay {
            let bytes = self.run.read(&file_of(episode))?;
            let read = Episode::from_bytes(&bytes.unwrap_or_default());
            let read = read.map_err(|met| DrqError::Replay { episode, met })?;
            self.replay.push(episode, read, self.config);
        }
        // What was told after the checkpoint is told again.
        self.run.keep_logged(state.records)?;
        self.records = self.run.logged()?;
        self.state = state;
        Ok(())
    }

    fn checkpoint(&self) -> Result<(), DrqError> {
        self.run.save(LAST, &self.learner.checkpoint(&[(STATE, described(&self.state))]))?;
        Ok(())
    }

    fn progress(&self, brought: &Brought) -> Progress {
        let ret = self.records.iter().rev().find_map(|record| match record {
            Record::Episode(finished) => Some(finished.ret),
            Record::Evaluation(_) => None,
        });
        Progress {
            steps: self.state.steps + brought.n_steps,
            n_steps: self.config.steps,
            updates: self.state.updates,
            unsafe_steps: self.state.unsafe_steps + brought.unsafe_steps,
            ret,
            evaluating: None,
            record: None,
        }
    }

    /// Drives an episode with noise, learns meanwhile, and keeps it.
    fn episode(&mut self, report: &mut Report<'_>) -> Result<(), DrqError> {
        let config = self.config;
        let number = self.state.episodes;
        let spec = std::sync::Arc::clone(self.world.spec());
        // Each episode has a stream of its own, so that a resumed job goes on as it would have.
        let rng = &mut ChaCha8Rng::seed_from_u64(config.seed);
        rng.set_stream(number + 1);
        let failed = |met| DrqError::World { episode: number, met };
        let frame = self.world.reset(u64::from(rng.next_u32())).map_err(failed)?;
        let mut episode = Episode::begin(&frame, spec.axes.len());
        let (mut sight, agent) = (Sight::of(config.stack), self.learner.agent());
        sight.see(&frame);
        let (mut brought, mut means) = (Brought::default(), Means::default());
        let mut end = None;
        while end.is_none() {
            let action = self.explore(&agent, &sight, rng)?;
            let may_learn = self.state.actions >= config.exploration_actions && !self.replay.is_empty();
            if may_learn && self.state.actions.is_multiple_of(config.update_every) {
                let batch = self.replay.sample(config, self.backend.device, rng);
                let losses = self.learner.update(&batch, config.noise_at(self.state.actions), rng);
                self.state.updates += 1;
                means.add(losses, self.state.updates)?;
            }
            let (mut reward, mut seen) = (0.0, None);
            for _ in 0..config.action_repeat {
                let step = self.world.step(&agent.unscaled(&action)).map_err(failed)?;
                reward += step.reward.ok_or_else(|| DrqError::NoReward(spec.name.clone()))?;
                brought.add(&step, &spec);
                end = step.end;
                seen = Some(step.frame);
                if end.is_some() {
                    break;
                }
            }
            self.state.actions += 1;
            if let Some(seen) = &seen {
                episode.push(&action, reward, seen, end == Some(End::Terminated));
                sight.see(seen);
            }
            if report(&self.progress(&brought)).is_break() {
                return Err(DrqError::Stopped);
            }
        }
        means.read(self.state.updates)?;
        self.learner.require_finite()?;
        self.finish(episode, &brought, &means, report)
    }

    /// The next action in `[-1, 1]`, with noise; by chance alone as long as it explores.
    fn explore(&self, agent: &DrqAgent, sight: &Sight, rng: &mut ChaCha8Rng) -> Result<Vec<f32>, NotFinite> {
        let n_axes = agent.nature.ranges.n_axes();
        let action = if self.state.actions < self.config.exploration_actions {
            (0..n_axes).map(|_| rng.random_range(-1.0..1.0)).collect()
        } else {
            let noise = normal(rng, &[1, n_axes as i64]) * self.config.noise_at(self.state.actions);
            // No more than the noise of an action goes to the device and back.
            let mean = from_slice(&to_vec(&agent.mean(sight.pictures())), &[1, n_axes as i64]);
            to_vec(&perturbed(&mean, &noise))
        };
        if action.iter().all(|value: &f32| value.is_finite()) {
            return Ok(action);
        }
        Err(NotFinite(format!("the action at update {}", self.state.updates)))
    }

    /// Counts and keeps an episode.
    fn finish(
        &mut self,
        episode: Episode,
        brought: &Brought,
        means: &Means,
        report: &mut Report<'_>,
    ) -> Result<(), DrqError> {
        let number = self.state.episodes;
        let state = &mut self.state;
        state.episodes += 1;
        state.steps += brought.n_steps;
        state.unsafe_steps += brought.unsafe_steps;
        for (event, n) in self.world.spec().events.iter().zip(&brought.events) {
            *state.events.entry(event_slug(&event.name)).or_default() += n;
        }
        let finished = Finished {
            episode: state.episodes,
            steps: state.steps,
            updates: state.updates,
            ret: brought.ret,
            n_steps: brought.n_steps,
            unsafe_steps: state.unsafe_steps,
            events: state.events.clone(),
            noise: self.config.noise_at(state.actions.saturating_sub(1)) as f32,
            critic_loss: means.of(0),
            value: means.of(1),
        };
        if Replay::takes(&episode, self.config) {
            self.run.write(&file_of(number), &episode.to_bytes())?;
        }
        let gone = self.replay.push(number, episode, self.config);
        self.state.replay = self.replay.numbers().collect();
        let mut points = vec![
            ("training/return", finished.ret),
            ("training/unsafe steps", finished.unsafe_steps as f32),
            ("training/noise", finished.noise),
        ];
        points.extend(finished.critic_loss.map(|loss| ("training/critic loss", loss)));
        points.extend(finished.value.map(|value| ("training/value", value)));
        self.run.plot(finished.steps, &points)?;
        self.record(Record::Episode(finished), report)?;
        self.checkpoint()?;
        // Only now does nobody need them.
        gone.into_iter().try_for_each(|episode| self.run.remove(&file_of(episode)))?;
        Ok(())
    }

    fn record(&mut self, record: Record, report: &mut Report<'_>) -> Result<(), DrqError> {
        self.run.log(&record)?;
        self.records.push(record.clone());
        self.state.records = self.records.len();
        let progress = Progress { record: Some(record), ..self.progress(&Brought::default()) };
        if report(&progress).is_break() { Err(DrqError::Stopped) } else { Ok(()) }
    }

    /// After how many steps it was last evaluated.
    fn evaluated_at(&self) -> Option<u64> {
        self.records.iter().rev().find_map(|record| match record {
            Record::Evaluation(evaluated) => Some(evaluated.steps),
            Record::Episode(_) => None,
        })
    }

    /// Evaluates before anything is learned, and in the first pause after every so many steps.
    ///
    /// `// DIFFERENCE:` the published program breaks off at the very step; one world can be in one episode alone.
    fn evaluate_if_due(&mut self, report: &mut Report<'_>) -> Result<(), DrqError> {
        let due = self
            .evaluated_at()
            .map_or(0, |steps| (steps / self.config.evaluate_every + 1) * self.config.evaluate_every);
        if self.state.steps >= due { self.evaluate(report) } else { Ok(()) }
    }

    fn evaluate(&mut self, report: &mut Report<'_>) -> Result<(), DrqError> {
        let n = self.config.evaluation_episodes;
        if n == 0 {
            return Ok(());
        }
        let agent = self.learner.agent();
        let (tracks, longest) = (TracksAlike { seed: 0 }, self.world.spec().longest_episode);
        let progress = self.progress(&Brought::default());
        let mut episodes: Vec<EpisodeMetrics> = Vec::new();
        for i in 0..n {
            let mut is_stopped = false;
            let mut policy = DrqPolicy::new(&agent);
            let met = evaluate_episode(self.world, tracks.track(i), &mut policy, |_, step| {
                let done = i as usize * longest + step.t + 1;
                let evaluating = Some([done, n as usize * longest]);
                let told = report(&Progress { evaluating, ..progress.clone() });
                is_stopped = told.is_break();
                told
            })?;
            if is_stopped {
                return Err(DrqError::Stopped);
            }
            episodes.push(met);
        }
        let summary = Summary::of(&episodes);
        let mean =
            |figure: Option<crate::evaluation::MeanSd>| figure.map_or(f32::NAN, |figure| figure.mean as f32);
        let events = summary.events.iter();
        let evaluated = Evaluated {
            steps: self.state.steps,
            updates: self.state.updates,
            returns: episodes.iter().map(|episode| episode.ret).collect(),
            ret: mean(summary.ret),
            unsafe_rate: mean(summary.unsafe_rate),
            events: events.filter_map(|(event, it)| Some((event.key(), it.as_ref()?.mean as f32))).collect(),
        };
        let points =
            [("evaluation/return", evaluated.ret), ("evaluation/unsafe rate", evaluated.unsafe_rate)];
        self.run.plot(evaluated.steps, &points)?;
        self.record(Record::Evaluation(evaluated), report)?;
        self.checkpoint()?;
        self.show()
    }

    /// Puts the curve and the agent as they are now into the folder, for people to look at meanwhile.
    fn show(&self) -> Result<(), DrqError> {
        curve::write(self.run, &self.world.spec().title, &self.records, self.beside)?;
        Ok(self.run.save("agent", &self.learner.agent_parameters())?)
    }
}
