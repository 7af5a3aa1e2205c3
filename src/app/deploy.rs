//! The planner acts in the real world.

use crate::app::clips::Replay;
use crate::app::{App, Field, Picture};
use crate::evaluation::EpisodeMetrics;
use crate::worker::{DeployReport, DriveView, DriverCommand, SessionWriterCommand, WorkerCommand};

/// On the world that the planner acts in.
#[derive(Clone, Debug, PartialEq)]
pub enum DeployCommand {
    /// Lets the planner act for an episode.
    Start,
    /// Stops its clock, or lets it go on.
    Pause,
    /// Ends the episode.
    Stop,
}

/// The planner acts.
#[derive(Debug, Default)]
pub(crate) struct Deploying {
    pub is_on: bool,
    pub is_paused: bool,
    pub seed: u64,
    pub view: Option<DriveView>,
    pub picture: Option<Picture>,
    /// Last pictures of the candidates.
    pub candidates: Vec<Option<Picture>>,
    /// Episodes that ended: the seed and the figures.
    pub episodes: Vec<(u64, EpisodeMetrics)>,
}

impl App {
    pub(super) fn deploy_command(&mut self, command: DeployCommand) {
        match command {
            DeployCommand::Start => {
                let Some(seed) = self.episode_seed(Field::DeploySeed) else { return };
                let deploy = &mut self.state.deploy;
                (deploy.is_on, deploy.is_paused, deploy.seed) = (true, false, seed);
                // A world in a process takes its time until the first of them.
                (deploy.view, deploy.picture) = (None, None);
                deploy.candidates.clear();
                self.state.clips.deployed = Replay::default();
                self.send(WorkerCommand::Driver(DriverCommand::Drive { seed }));
            }
            DeployCommand::Pause => {
                let is_paused = !self.state.deploy.is_paused;
                self.state.deploy.is_paused = is_paused;
                self.send(WorkerCommand::Driver(DriverCommand::Pause(is_paused)));
            }
            DeployCommand::Stop => {
                self.state.deploy.is_on = false;
                self.send(WorkerCommand::Driver(DriverCommand::Stop));
            }
        }
    }

    pub(super) fn deploy_report(&mut self, report: DeployReport) {
        match report {
            DeployReport::View(view) => {
                self.remember_deployed(&view);
                let deploy = &mut self.state.deploy;
                deploy.picture = Some(Picture::from(&view.picture));
                let last =
                    |candidate: &crate::worker::CandidateView| candidate.frames.last().map(Picture::from);
                deploy.candidates = view.candidates.iter().map(last).collect();
                deploy.view = Some(view);
            }
            DeployReport::Ended { seed, metrics, actions } => {
                self.episode_driven(seed, &metrics, actions);
                self.write(SessionWriterCommand::KeepDriven { seed, metrics: metrics.clone() });
                let deploy = &mut self.state.deploy;
                deploy.is_on = false;
                deploy.episodes.push((seed, metrics));
                self.next_seed(Field::DeploySeed);
            }
        }
    }

    /// The seed that somebody has typed; says so where it is none, or where there is no episode to begin.
    pub(super) fn episode_seed(&mut self, field: Field) -> Option<u64> {
        if self.state.is_recorded_only() {
            let title = &self.state.spec.title;
            self.warn(format!("{title} is known from recordings alone: it cannot be acted in"));
            return None;
        }
        let seed = self.state.field(field).trim().parse().ok();
        if seed.is_none() {
            self.fail("the seed of an episode is a whole number, such as 7".to_owned());
        }
        seed
    }

    /// Another seed each time, unless somebody writes which.
    pub(super) fn next_seed(&mut self, field: Field) {
        if let Ok(seed) = self.state.field(field).trim().parse::<u64>() {
            self.state.fields.insert(field, seed.wrapping_add(1).to_string());
        }
    }
}
