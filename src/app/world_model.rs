//! The world model: loading one, and fitting another.

use std::path::PathBuf;

use crate::app::{App, Command, Field, Panel, Picture};
use crate::session::Header;
use crate::worker::{JobCommand, LoadedWorld, ModelerCommand, WorkerCommand, WorkerError, WorldModelReport};
use crate::world_model::ModelIdentity;
use crate::world_model::fit::{Progress, Stage};

/// On the world model.
#[derive(Clone, Debug, PartialEq)]
pub enum WorldModelCommand {
    /// Fits one to the recordings.
    Fit {
        /// Whether from the last checkpoint.
        resume: bool,
    },
    /// Stops that; it can be resumed.
    StopFit,
    /// Loads the one in a file.
    Load(PathBuf),
}

/// The world model, and the fit of another.
#[derive(Debug, Default)]
pub(crate) struct World {
    pub loaded: Option<LoadedWorld>,
    pub hash: String,
    /// What it is called, also where it was stored in another way.
    pub identity: Option<ModelIdentity>,
    /// The file that is being read.
    pub loading: Option<PathBuf>,
    pub fit: Option<FitState>,
    /// The file of the last fit.
    pub fitted: Option<PathBuf>,
}

impl World {
    fn of(loaded: LoadedWorld) -> Self {
        let hash = loaded.parameters.hash();
        let identity = ModelIdentity::of(&loaded.parameters).ok();
        Self { loaded: Some(loaded), hash, identity, ..Self::default() }
    }

    /// Whether the session with this head was dreamed with it; of none, nothing is known.
    pub(crate) fn is_of(&self, header: &Header) -> bool {
        let named = &header.world_model;
        let is_stored_otherwise =
            || self.identity.as_ref().is_some_and(|identity| identity.is(&self.hash) && identity.is(named));
        self.loaded.is_none() || self.hash == *named || is_stored_otherwise()
    }
}

/// A fit that is under way.
#[derive(Clone, Debug, Default)]
pub(crate) struct FitState {
    pub progress: Option<Progress>,
    /// The stage, when it was first reported, and how many updates it had then.
    pub began: Option<(Stage, f64, usize)>,
    pub loss: Vec<[f64; 2]>,
    pub held_out: Vec<[f64; 2]>,
}

impl FitState {
    /// Updates that `progress` has behind it in its stage.
    fn updates(progress: &Progress) -> usize {
        progress.epoch * progress.n + progress.done
    }

    fn receive(&mut self, progress: Progress, now: f64) {
        let updates = Self::updates(&progress);
        if self.began.is_none_or(|(stage, ..)| stage != progress.stage) {
            self.began = Some((progress.stage, now, updates));
            self.loss.clear();
            self.held_out.clear();
        }
        let x = updates as f64 / progress.n.max(1) as f64;
        if progress.loss.is_finite() {
            self.loss.push([x, progress.loss]);
        }
        if let Some(held_out) = progress.held_out.filter(|loss| loss.is_finite()) {
            self.held_out.push([x, held_out]);
        }
        self.progress = Some(progress);
    }

    /// Frames or steps a second, and seconds to the end of the stage at the most.
    pub(crate) fn rate(&self, now: f64) -> Option<(f64, f64)> {
        let ((_, since, first), progress) = (self.began?, self.progress.as_ref()?);
        let (secs, done) = (now - since, Self::updates(progress).saturating_sub(first) as f64);
        if secs < 1.0 || done < 1.0 {
            return None;
        }
        let left = (progress.max_epochs * progress.n).saturating_sub(Self::updates(progress)) as f64;
        Some((done * progress.items as f64 / secs, left * secs / done))
    }
}

impl App {
    pub(super) fn world_model_command(&mut self, command: WorldModelCommand) {
        match command {
            WorldModelCommand::Fit { .. } if self.state.episodes.is_changing() => {
                self.note("one moment: the recordings are being put in order".to_owned());
            }
            WorldModelCommand::Fit { resume } => {
                let (dataset, out) =
                    (self.state.field(Field::Dataset).into(), self.state.field(Field::ModelOut).into());
                self.state.world.fit = Some(FitState::default());
                self.send(WorkerCommand::Modeler(ModelerCommand::Fit { dataset, out, resume }));
            }
            WorldModelCommand::StopFit => self.send(WorkerCommand::Modeler(ModelerCommand::Stop)),
            WorldModelCommand::Load(path) => self.load_world_model(path),
        }
    }

    pub(super) fn world_model_report(&mut self, report: WorldModelReport) {
        match report {
            WorldModelReport::Fitting(progress) => {
                let now = self.state.now;
                self.state.world.fit.get_or_insert_default().receive(progress, now);
            }
            WorldModelReport::Fitted(path) => {
                self.state.world.fit = None;
                self.state.world.fitted = Some(path.clone());
                let load = Command::WorldModel(WorldModelCommand::Load(path));
                let text = "the new world model is on disk".to_owned();
                self.offer(text, vec![("Use it".to_owned(), load)]);
            }
        }
    }

    /// Begins to read a world model; all else goes on meanwhile.
    pub(super) fn load_world_model(&mut self, path: PathBuf) {
        if self.state.dream.is_on {
            return self.warn("end the dream first: keep it, or leave it".to_owned());
        }
        self.state.world.loading = Some(path.clone());
        self.job(JobCommand::LoadWorldModel(path));
    }

    /// Goes on with the world model that was read, or without.
    pub(super) fn world_model_loaded(&mut self, loaded: Result<Box<LoadedWorld>, WorkerError>) {
        self.state.world.loading = None;
        let is_first = self.state.world.loaded.is_none();
        let world = match loaded {
            Ok(world) => *world,
            Err(error) => {
                if let Some((loaded, goes_to)) = self.after_world.take() {
                    self.go_on_with(loaded, goes_to);
                }
                if is_first {
                    (self.state.panel, self.state.guide.is_offering) = (Panel::World, false);
                }
                return self.fail(error.to_string());
            }
        };
        let name = world.name.clone();
        self.end_dream();
        self.send(WorkerCommand::UseWorldModel(world.parameters.clone()));
        self.use_world_model(world);
        self.forget_reports();
        (self.state.label, self.state.reward) =
            (self.state.label.anew(), super::reward::Rewarding::default());
        self.state.unfinished.clear();
        // A session belongs to the model that it was dreamed with.
        let had_session = self.close_session();
        if let Some((loaded, goes_to)) = self.after_world.take() {
            return self.go_on_with(loaded, goes_to);
        }
        if had_session {
            self.note("a session belongs to its world model: the next dream begins a new one".to_owned());
        }
        if !is_first {
            self.done(format!("{name} is loaded"));
        }
        self.seek_latest_session();
    }

    /// Dreams with this world model from now on.
    pub(super) fn use_world_model(&mut self, world: LoadedWorld) {
        let dream = &mut self.state.dream;
        let starts = world.starts.iter();
        dream.thumbnails = starts.map(|start| start.picture.as_ref().map(Picture::from)).collect();
        (dream.start_idx, dream.live, dream.picture) = (0, None, None);
        let fit = self.state.world.fit.take();
        self.state.world = World { fit, ..World::of(world) };
    }
}
