//! What follows where a worker met an error, or has died.

use crate::app::{App, Command, WindowCommand, WorldModelCommand};
use crate::worker::{WorkerError, WorkerFailure, WorkerName};

impl App {
    pub(super) fn worker_failed(&mut self, failure: WorkerFailure) {
        let WorkerFailure { worker, error } = failure;
        let has_died = matches!(error, WorkerError::Panicked(_));
        let has_ended = has_died || matches!(error, WorkerError::GaveUp(_) | WorkerError::Stopped);
        match worker {
            WorkerName::Dreamer if has_died => {
                (self.state.dream.is_on, self.state.dream.is_ending) = (false, false);
            }
            WorkerName::Driver if has_ended => self.state.deploy.is_on = false,
            WorkerName::Trainer => {
                (self.state.reward.is_fitting, self.state.reward.is_relearning) = (false, false);
            }
            WorkerName::Synthesizer if has_died => self.synthesize(false),
            WorkerName::Synthesizer => return self.not_synthesized(error.to_string()),
            WorkerName::Replayer => self.replayer_failed(),
            WorkerName::EpisodeBrowser => self.episode_browser_failed(),
            WorkerName::Recorder if has_ended => self.recorder_failed(),
            WorkerName::Modeler if has_ended => return self.fit_ended(&error),
            WorkerName::SessionWriter if has_died => return self.reopen(&error),
            WorkerName::SessionWriter
            | WorkerName::Dreamer
            | WorkerName::Driver
            | WorkerName::Recorder
            | WorkerName::Modeler
            | WorkerName::Clipper
            | WorkerName::Screener
            | WorkerName::Previewer
            | WorkerName::DreamInspector
            | WorkerName::Jobs => {}
        }
        let restart = vec![("Restart".to_owned(), Command::Window(WindowCommand::Restart))];
        self.fail_with(error.to_string(), if has_died { restart } else { Vec::new() });
    }

    /// A fit of a world model has ended without one.
    fn fit_ended(&mut self, error: &WorkerError) {
        self.state.world.fit = None;
        let fit = WorldModelCommand::Fit { resume: true };
        let ways = vec![("Go on".to_owned(), Command::WorldModel(fit))];
        match error {
            WorkerError::Stopped => {
                let text = "the fit is stopped and goes on from its last checkpoint when you like";
                self.offer(text.to_owned(), ways);
            }
            WorkerError::Panicked(_) | WorkerError::GaveUp(_) | WorkerError::Met(_) => {
                self.fail_with(error.to_string(), ways);
            }
        }
    }
}
