//! Trains a world model while the window stays alive.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::mpsc::{Receiver, TryRecvError};
use std::time::{Duration, Instant};

use crate::dataset::Dataset;
use crate::run::{Kind, OutputFile, Run};
use crate::worker::{ModelerCommand, Report, Reports, Worker, one_thread};
use crate::world_model::WorldModelConfig;
use crate::world_model::fit::{self, FitConfig, FitError, Progress, fit_world};

const NAME: &str = "modeler";
/// The window need not know of every update.
const REPORT_EVERY: Duration = Duration::from_millis(100);

/// Starts a thread that trains world models of the given shape.
pub fn spawn(config: WorldModelConfig, fit: FitConfig, reports: &Reports) -> Worker<ModelerCommand> {
    Worker::spawn(NAME, reports, move |commands, reports| {
        model(&commands, &reports, &config, &fit);
        Ok(())
    })
}

/// The body of the thread.
pub fn model(
    commands: &Receiver<ModelerCommand>,
    reports: &Reports,
    config: &WorldModelConfig,
    fit: &FitConfig,
) {
    while let Ok(command) = commands.recv() {
        let ModelerCommand::Fit { dataset, out, resume } = command else { continue };
        // One is left for the window; only here, for the other threads compute in steps too short to share.
        let n_threads = std::thread::available_parallelism().map_or(1, |n| n.get().saturating_sub(1).max(1));
        tch::set_num_threads(n_threads as i32);
        let fitted = fit_one(commands, reports, config, fit, &dataset, &out, resume);
        one_thread();
        match fitted {
            Ok(()) => reports.send(Report::Modeled(out)),
            Err(message) => reports.fail(NAME, message),
        }
    }
}

/// One fit, which keeps what it needs to be resumed in a folder beside `out`.
fn fit_one(
    commands: &Receiver<ModelerCommand>,
    reports: &Reports,
    config: &WorldModelConfig,
    fit: &FitConfig,
    dataset: &Path,
    out: &Path,
    resume: bool,
) -> Result<(), String> {
    let dataset = Dataset::open(dataset).map_err(|e| e.to_string())?;
    if let Some(env) = dataset.env().filter(|env| *env != config.env) {
        return Err(format!(
            "these recordings are of {env:?}, but the model is to be one of {:?}",
            config.env
        ));
    }
    for damaged in dataset.damaged() {
        reports.send(Report::LeftOut(format!("left out of the fit: {damaged}")));
    }
    fit::check(&dataset).map_err(|e| e.to_string())?;
    let output = OutputFile::at(out, Kind::Network).map_err(|e| e.to_string())?;
    let run = Run::beside(out, resume).map_err(|e| e.to_string())?;
    let mut last = None;
    let mut listen = |progress: &Progress| loop {
        match commands.try_recv() {
            Ok(ModelerCommand::Stop) | Err(TryRecvError::Disconnected) => return ControlFlow::Break(()),
            Ok(ModelerCommand::Fit { .. }) => {
                reports.fail(NAME, "a world model is being trained already; stop that first");
            }
            Err(TryRecvError::Empty) => {
                let is_news = last.is_none_or(|last: Instant| last.elapsed() >= REPORT_EVERY);
                if is_news || progress.done == progress.n {
                    last = Some(Instant::now());
                    reports.send(Report::Modeling(progress.clone()));
                }
                return ControlFlow::Continue(());
            }
        }
    };
    let parameters = match fit_world(&dataset, config, fit, &run, &mut listen) {
        Err(FitError::Stopped) => return Err("stopped; resuming goes on from the last checkpoint".to_owned()),
        fitted => fitted.map_err(|e| e.to_string())?,
    };
    output.write(parameters.bytes()).map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;
    use crate::dataset::{EpisodeInfo, StepRecord};
    use crate::env::{Action, End, Env as _};
    use crate::run::read_parameters;
    use crate::worker::toy::Wall;
    use crate::world_model::WorldModel;

    /// Three episodes of a wall, in the name of the toy's environment.
    fn record(dir: &Path) {
        let env = WorldModelConfig::tiny().env;
        let mut dataset = Dataset::create_or_open(dir, &env).unwrap();
        for seed in 0..3 {
            let info = EpisodeInfo { env: env.clone(), pilot: "nobody".to_owned(), seed };
            let (mut recording, mut wall) = (dataset.begin(info).unwrap(), Wall::new(40));
            for t in 0..40 {
                let (frame, action) = (wall.frame(), Action::new((t as f32).sin(), 0.0, 0.0));
                wall.advance(action);
                let step = StepRecord {
                    frame,
                    action,
                    reward: 0.0,
                    grass: false,
                    contacts: None,
                    wall_time_ns: 0,
                    state: Vec::new(),
                };
                recording.push(&step).unwrap();
            }
            dataset.seal(recording, &wall.frame(), Some(End::TimeLimit)).unwrap();
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
        let modeler = spawn(WorldModelConfig::tiny(), brief(), &reports);
        modeler.send(ModelerCommand::Fit { dataset, out: out.clone(), resume: false });
        let listening = inbox.iter().take_while(|report| matches!(report, Report::Modeling(_))).count();
        drop(modeler);
        // How many come in between is a matter of time; the ends of epochs always do.
        assert!(listening >= 4, "two epochs of each network make {listening} reports");
        assert!(WorldModel::load(read_parameters(&out).unwrap()).is_ok(), "it is whole");
    }

    #[test]
    fn a_stopped_fit_says_that_it_can_be_resumed() {
        let dir = tempfile::tempdir().unwrap();
        let (dataset, out) = (dir.path().join("real"), dir.path().join("model.safetensors"));
        record(&dataset);
        let (commands, heard) = channel();
        commands.send(ModelerCommand::Fit { dataset, out: out.clone(), resume: false }).unwrap();
        commands.send(ModelerCommand::Stop).unwrap();
        drop(commands);
        let (reports, inbox) = Reports::new(|| ());
        model(&heard, &reports, &WorldModelConfig::tiny(), &brief());
        let Report::Failed { message, .. } = inbox.recv().unwrap() else { panic!("another report") };
        assert!(message.contains("resuming"), "{message}");
        assert!(!out.exists(), "half a model is none");
    }

    #[test]
    fn recordings_of_another_world_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        record(dir.path());
        let (commands, heard) = channel();
        let fit = ModelerCommand::Fit {
            dataset: dir.path().to_owned(),
            out: dir.path().join("out"),
            resume: false,
        };
        commands.send(fit).unwrap();
        drop(commands);
        let (reports, inbox) = Reports::new(|| ());
        model(&heard, &reports, &WorldModelConfig::car_racing(), &brief());
        let Report::Failed { message, .. } = inbox.recv().unwrap() else { panic!("another report") };
        assert!(message.contains("dummy-road") && message.contains("car-racing"), "{message}");
    }
}
