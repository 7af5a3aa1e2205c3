//! Trains a world model while the window stays alive.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::mpsc::{Receiver, TryRecvError};
use std::time::{Duration, Instant};

use crate::dataset::Dataset;
use crate::planner::with_snippets;
use crate::run::{Kind, OutputFile, Run};
use crate::tensor::Backend;
use crate::worker::error::TaskError;
use crate::worker::{
    ModelerCommand, RecordReport, Reports, Worker, WorkerError, WorkerName, WorldModelReport, one_thread,
    read_ahead,
};
use crate::world_model::WorldModelConfig;
use crate::world_model::fit::{self, FitConfig, Means, Progress, fit_world_with};

const NAME: WorkerName = WorkerName::Modeler;
/// The window need not know of every update.
const REPORT_EVERY: Duration = Duration::from_millis(100);

/// Starts a thread that trains world models of the given shape.
pub fn spawn(
    config: WorldModelConfig,
    fit: FitConfig,
    backend: Backend,
    reports: &Reports,
) -> Worker<ModelerCommand> {
    Worker::spawn(NAME, reports, move |commands, reports| {
        model(&commands, &reports, &config, &fit, backend);
        Ok(())
    })
}

/// The body of the thread.
pub fn model(
    commands: &Receiver<ModelerCommand>,
    reports: &Reports,
    config: &WorldModelConfig,
    fit: &FitConfig,
    backend: Backend,
) {
    while let Ok(command) = commands.recv() {
        let ModelerCommand::Fit { dataset, out, resume } = command else { continue };
        // One is left for the window; only here, for the other threads compute in steps too short to share.
        let n_threads = std::thread::available_parallelism().map_or(1, |n| n.get().saturating_sub(1).max(1));
        tch::set_num_threads(n_threads as i32);
        let fitted = fit_one(commands, reports, (config, fit, backend), &dataset, &out, resume);
        one_thread();
        match fitted {
            Ok(()) => reports.send(WorldModelReport::Fitted(out)),
            Err(error) => reports.fail(NAME, error.gave_up()),
        }
    }
}

/// One fit, which keeps what it needs to be resumed in a folder beside `out`.
fn fit_one(
    commands: &Receiver<ModelerCommand>,
    reports: &Reports,
    (config, fit, backend): (&WorldModelConfig, &FitConfig, Backend),
    dataset: &Path,
    out: &Path,
    resume: bool,
) -> Result<(), WorkerError> {
    let dataset = Dataset::open_as(dataset, &config.spec())?;
    if let Some(env) = dataset.env().filter(|env| *env != config.env) {
        let (found, wanted) = (env.to_owned(), config.env.clone());
        return Err(TaskError::OtherRecordings { found, wanted }.into());
    }
    for damaged in dataset.damaged() {
        reports.send(RecordReport::LeftOut(format!("left out of the fit: {damaged}")));
    }
    fit::check(&dataset)?;
    let output = OutputFile::at(out, Kind::Network)?;
    let run = Run::beside(out, resume)?;
    let mut last = None;
    let mut listen = |progress: &Progress| loop {
        match commands.try_recv() {
            Ok(ModelerCommand::Stop) | Err(TryRecvError::Disconnected) => return ControlFlow::Break(()),
            Ok(ModelerCommand::Fit { .. }) => {
                reports.fail(NAME, TaskError::IsFitting);
            }
            Err(TryRecvError::Empty) => {
                let is_news = last.is_none_or(|last: Instant| last.elapsed() >= REPORT_EVERY);
                if is_news || progress.done == progress.n {
                    last = Some(Instant::now());
                    reports.send(WorldModelReport::Fitting(progress.clone()));
                }
                return ControlFlow::Continue(());
            }
        }
    };
    let means = Means { backend, read: &read_ahead };
    let parameters = fit_world_with(means, &dataset, config, fit, &run, &mut listen)?;
    let go_on = &mut |_, _| match commands.try_recv() {
        Ok(ModelerCommand::Stop) | Err(TryRecvError::Disconnected) => ControlFlow::Break(()),
        Ok(ModelerCommand::Fit { .. }) | Err(TryRecvError::Empty) => ControlFlow::Continue(()),
    };
    match with_snippets(parameters, &dataset, go_on)? {
        Some(parameters) => Ok(output.write(parameters.bytes())?),
        None => Err(WorkerError::Stopped),
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;
    use crate::dataset::{EpisodeInfo, StepRecord};
    use crate::run::read_parameters;
    use crate::worker::fixtures::Wall;
    use crate::worker::{Report, WorkerFailure};
    use crate::world::Action;
    use crate::world::End;
    use crate::world::cars::Env as _;
    use crate::world_model::WorldModel;

    /// Three episodes of a wall, in the name of the tiny model's environment.
    fn record(dir: &Path) {
        let env = WorldModelConfig::tiny().env;
        let mut dataset = Dataset::create_or_open(dir, &env).unwrap();
        for seed in 0..3 {
            let info = EpisodeInfo { env: env.clone(), pilot: "nobody".to_owned(), seed };
            let (mut recording, mut wall) = (dataset.begin(info).unwrap(), Wall::new(40));
            for t in 0..40 {
                let (frame, action) = (wall.frame(), Action::new([(t as f32).sin(), 0.0, 0.0]));
                wall.advance((&*action).into());
                let step = StepRecord {
                    frame,
                    action,
                    reward: 0.0,
                    events: vec![false],
                    wall_time_ns: 0,
                    state: Vec::new(),
                };
                recording.push(&step).unwrap();
            }
            dataset.seal(recording, &wall.frame(), Some(End::Truncated)).unwrap();
        }
    }

    /// Two short epochs of each network.
    fn brief() -> FitConfig {
        let mut fit = FitConfig::tiny();
        for schedule in [&mut fit.vae, &mut fit.mdn_rnn] {
            (schedule.max_epochs, schedule.updates_per_epoch) = (2, 3);
        }
        fit
    }

    #[test]
    fn a_fitted_model_is_on_disk_and_can_be_dreamed_in() {
        let dir = tempfile::tempdir().unwrap();
        let (dataset, out) = (dir.path().join("real"), dir.path().join("model.safetensors"));
        record(&dataset);
        let (reports, inbox) = Reports::new(|| ());
        let modeler = spawn(WorldModelConfig::tiny(), brief(), Backend::cpu(), &reports);
        modeler.send(ModelerCommand::Fit { dataset, out: out.clone(), resume: false });
        let is_fitting = |report: &Report| matches!(report, Report::WorldModel(WorldModelReport::Fitting(_)));
        let n_reports = inbox.iter().take_while(is_fitting).count();
        drop(modeler);
        // How many come in between is a matter of time; the ends of epochs always do.
        assert!(n_reports >= 4, "two epochs of each network make {n_reports} reports");
        assert!(WorldModel::load(read_parameters(&out).unwrap()).is_ok(), "it is whole");
    }

    #[test]
    fn a_stopped_fit_says_so() {
        let dir = tempfile::tempdir().unwrap();
        let (dataset, out) = (dir.path().join("real"), dir.path().join("model.safetensors"));
        record(&dataset);
        let (commands, received) = channel();
        commands.send(ModelerCommand::Fit { dataset, out: out.clone(), resume: false }).unwrap();
        commands.send(ModelerCommand::Stop).unwrap();
        drop(commands);
        let (reports, inbox) = Reports::new(|| ());
        model(&received, &reports, &WorldModelConfig::tiny(), &brief(), Backend::cpu());
        let Report::Failed(failure) = inbox.recv().unwrap() else { panic!("another report") };
        assert!(matches!(failure.error, WorkerError::Stopped), "{failure:?}");
        assert!(!out.exists(), "half a model is none");
    }

    #[test]
    fn recordings_of_another_world_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        record(dir.path());
        let (commands, received) = channel();
        let fit = ModelerCommand::Fit {
            dataset: dir.path().to_owned(),
            out: dir.path().join("out"),
            resume: false,
        };
        commands.send(fit).unwrap();
        drop(commands);
        let (reports, inbox) = Reports::new(|| ());
        model(&received, &reports, &WorldModelConfig::car_racing(), &brief(), Backend::cpu());
        let Report::Failed(WorkerFailure { error: WorkerError::GaveUp(error), .. }) = inbox.recv().unwrap()
        else {
            panic!("another report")
        };
        let message = error.to_string();
        assert!(message.contains("dummy-road") && message.contains("car-racing"), "{message}");
    }
}
