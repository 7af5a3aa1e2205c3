//! Makes trajectories that are worth asking about, while others are being answered: ReQueST (method §10).

use std::ops::ControlFlow;
use std::sync::mpsc::{Receiver, TryRecvError};
use std::time::{Duration, Instant};

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use crate::dream::Rows;
use crate::planner::synthesis::{Acquisition, SynthesisConfig, synthesize};
use crate::reward::{RewardInputs, RewardKind, SparseConfig, SparseReward};
use crate::tensor::{Parameters, from_slice};
use crate::worker::error::TaskError;
use crate::worker::{LabelReport, Reports, SynthesizerCommand, Worker, WorkerError, WorkerName, one_thread};
use crate::world_model::{LatentState, Placed, WorldModel};

const NAME: WorkerName = WorkerName::Synthesizer;
/// How far it is is reported no more often than this: where a window is painted in software, showing it costs time too.
const REPORT_EVERY: Duration = Duration::from_secs(1);

/// Starts a thread that makes trajectories of `model`.
pub fn spawn(
    model: impl Into<Placed>,
    config: SynthesisConfig,
    reports: &Reports,
) -> Worker<SynthesizerCommand> {
    let model = model.into();
    Worker::spawn(NAME, reports, move |commands, reports| make(&commands, &reports, model, &config))
}

/// The body of the thread.
pub fn make(
    commands: &Receiver<SynthesizerCommand>,
    reports: &Reports,
    model: impl Into<Placed>,
    config: &SynthesisConfig,
) -> Result<(), WorkerError> {
    one_thread();
    let model = WorldModel::load(model)?;
    let mut next = None;
    while let Some(command) = next.take().or_else(|| commands.recv().ok()) {
        let SynthesizerCommand::Make { start, acquisition, reward, seen, seed } = command else { continue };
        let wanted = Wanted { start, acquisition, reward, seen, seed };
        // Whatever comes meanwhile ends this one: it is no longer wanted, or another is, or nobody is there.
        let is_wanted = || match commands.try_recv() {
            Err(TryRecvError::Empty) => ControlFlow::Continue(()),
            Err(TryRecvError::Disconnected) => ControlFlow::Break(()),
            Ok(command) => {
                next = Some(command);
                ControlFlow::Break(())
            }
        };
        match wanted.make(&model, config, reports, is_wanted) {
            Ok(Some(report)) => reports.send(report),
            Ok(None) => {}
            Err(e) => reports.fail(NAME, e.gave_up()),
        }
    }
    Ok(())
}

/// A trajectory that is wanted.
struct Wanted {
    start: LatentState,
    acquisition: Acquisition,
    reward: Option<Parameters>,
    seen: Rows,
    seed: u64,
}

impl Wanted {
    /// Makes it, unless it is no longer wanted.
    fn make(
        &self,
        model: &WorldModel,
        config: &SynthesisConfig,
        reports: &Reports,
        mut is_wanted: impl FnMut() -> ControlFlow<()>,
    ) -> Result<Option<LabelReport>, WorkerError> {
        let &Self { acquisition, seed, ref seen, .. } = self;
        let rng = &mut ChaCha8Rng::seed_from_u64(seed);
        let reward = self.classifier(model, rng)?;
        let seen = (!seen.is_empty()).then(|| from_slice(&seen.values, &[-1, seen.width as i64]));
        let n = config.iterations;
        let mut reported = None::<Instant>;
        let on_iteration = &mut |done| {
            if reported.is_none_or(|reported| reported.elapsed() >= REPORT_EVERY) {
                reported = Some(Instant::now());
                reports.send(LabelReport::Synthesizing { seed, done, n });
            }
            is_wanted()
        };
        let wanted = [(&self.start, acquisition)];
        let made = synthesize(model, &reward, &wanted, seen.as_ref(), config, rng, on_iteration)?;
        Ok(made.and_then(|mut made| made.pop()).map(|mut episode| {
            episode.seed = seed;
            LabelReport::Synthesized { episode, acquisition }
        }))
    }

    /// What it is scored by: the classifier that was learned, or a fresh one where none was.
    fn classifier(&self, model: &WorldModel, rng: &mut ChaCha8Rng) -> Result<SparseReward, WorkerError> {
        let learned = self
            .reward
            .as_ref()
            .filter(|parameters| RewardKind::of(parameters) == Some(RewardKind::Verdicts));
        let Some(learned) = learned else {
            let fresh = SparseReward::new(RewardInputs::of(model), SparseConfig::request(), rng);
            return Ok(fresh.on(model.backend()));
        };
        let reward = SparseReward::load(learned)?;
        reward.require(model.identity()).map_err(TaskError::OtherClassifier)?;
        Ok(reward.on(model.backend()))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;
    use crate::query::TRAJECTORY_LEN;
    use crate::worker::{Report, fixtures};

    fn wish(seed: u64, reward: Option<Parameters>) -> SynthesizerCommand {
        let (start, acquisition) = (fixtures::start(), Acquisition::Novelty);
        let seen = Rows { width: 4, values: vec![0.1; 8] };
        SynthesizerCommand::Make { start, acquisition, reward, seen, seed }
    }

    fn few(iterations: usize) -> SynthesisConfig {
        SynthesisConfig { iterations, ..SynthesisConfig::paper() }
    }

    /// What comes of `commands`, which are all there before the first is received.
    fn reports_of(commands: impl IntoIterator<Item = SynthesizerCommand>) -> Vec<Report> {
        let (sender, received) = channel();
        commands.into_iter().for_each(|command| sender.send(command).unwrap());
        let (reports, inbox) = Reports::new(|| ());
        let worker = std::thread::Builder::new().spawn(move || {
            let model = fixtures::model().parameters().clone();
            make(&received, &reports, model, &few(2)).unwrap();
        });
        let made = |report: &Report| {
            matches!(report, Report::Label(LabelReport::Synthesized { .. }) | Report::Failed(_))
        };
        let mut all = Vec::new();
        for report in inbox.iter() {
            let is_last = made(&report);
            all.push(report);
            if is_last {
                break;
            }
        }
        drop(sender);
        worker.unwrap().join().unwrap();
        all.extend(inbox.iter());
        all
    }

    #[test]
    fn a_trajectory_is_made_from_its_start_and_the_same_for_the_same_seed() {
        let made = |seed| {
            let reports = reports_of([wish(seed, None)]);
            assert!(
                matches!(reports[0], Report::Label(LabelReport::Synthesizing { done: 1, n: 2, .. })),
                "{reports:?}"
            );
            match reports.into_iter().last() {
                Some(Report::Label(LabelReport::Synthesized {
                    episode,
                    acquisition: Acquisition::Novelty,
                })) => episode,
                other => panic!("{other:?}"),
            }
        };
        let episode = made(7);
        assert_eq!((episode.len(), episode.seed, &episode.start), (TRAJECTORY_LEN, 7, &fixtures::start()));
        assert_eq!(episode.zs.row(0), fixtures::start().z);
        assert_eq!(episode, made(7));
    }

    #[test]
    fn who_is_told_to_stop_or_to_make_another_makes_no_more_of_the_first() {
        let seeds = |commands: Vec<SynthesizerCommand>| -> Vec<u64> {
            let made = |report| match report {
                Report::Label(LabelReport::Synthesized { episode, .. }) => Some(episode.seed),
                _ => None,
            };
            reports_of(commands).into_iter().filter_map(made).collect()
        };
        assert_eq!(seeds(vec![wish(1, None), SynthesizerCommand::Stop, wish(2, None)]), [2]);
        assert_eq!(seeds(vec![wish(1, None), wish(2, None)]), [2]);
    }

    #[test]
    fn who_is_dismissed_ends_in_the_midst_of_it() {
        let (reports, inbox) = Reports::new(|| ());
        // It would take days.
        let worker = spawn(fixtures::model().parameters().clone(), few(10_000_000), &reports);
        worker.send(wish(1, None));
        let report = inbox.recv().unwrap();
        assert!(matches!(report, Report::Label(LabelReport::Synthesizing { seed: 1, .. })), "{report:?}");
        drop(worker.dismiss());
    }

    #[test]
    fn a_classifier_of_another_world_is_refused() {
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let other = SparseReward::new((36, "sha256:other"), SparseConfig::tiny(), rng).parameters();
        let reports = reports_of([wish(1, Some(other))]);
        let [Report::Failed(failure)] = &reports[..] else { panic!("{reports:?}") };
        let message = failure.error.to_string();
        assert!(message.contains("another world model"), "{message}");
    }
}
