//! What workers meet, with the cause of each as a type of its own.

use std::path::PathBuf;
use std::sync::Arc;

use crate::clip::ClipError;
use crate::dataset::DatasetError;
use crate::experiment::ResultsError;
use crate::query::{DreamId, QueryId};
use crate::reward::RewardError;
use crate::run::RunError;
use crate::session::SessionError;
use crate::tensor::NotFinite;
use crate::worker::jobs::SaveError;
use crate::worker::{OpenError, WorkerError};
use crate::world::SpecError;
use crate::world_model::WorldModelError;
use crate::world_model::fit::FitError;

/// Why a worker cannot do what it was told to.
#[derive(Debug, thiserror::Error)]
pub(super) enum TaskError {
    /// A clip lies in no dream that is known.
    #[error("cannot draw a clip from step {start} of dream {}: it is not known here", .dream.0)]
    Clip { dream: DreamId, start: usize },
    /// What an answer is about lies in no dream that is known.
    #[error("cannot learn from step {step} of dream {}: it is not known here", .dream.0)]
    Learn { dream: DreamId, step: usize },
    #[error("there are no answers to learn from yet")]
    NoAnswers,
    #[error("dream {} is not known here: its file could not be read", .0.0 + 1)]
    UnknownDream(DreamId),
    #[error("the dream has no steps")]
    EmptyDream,
    #[error("a clip of query {} is of a dream that is not known here", .0.0 + 1)]
    UnknownClip(QueryId),
    #[error("this classifier was learned in another world model ({0}): fit the reward anew")]
    OtherClassifier(RewardError),
    /// A reward cannot be used for planning.
    #[error("the planner cannot drive by this reward: {0}")]
    NoPlanning(RewardError),
    /// The planner no longer drives.
    #[error("the planner gives control back: {0}")]
    PlannerEnded(NotFinite),
    #[error("the dream ends here, and what was dreamed is kept: {0}")]
    DreamEnded(NotFinite),
    #[error("the dream beside ends: {0}")]
    RolloutEnded(NotFinite),
    #[error("the drive ended at step {step}: {met}")]
    DriveEnded { step: usize, met: NotFinite },
    /// A world model sees something else than is driven.
    #[error("this world model sees {sees}, but this is {env}: load another one")]
    OtherEnv { sees: String, env: String },
    /// A world model of something else was to be fitted to recordings.
    #[error("these recordings are of {found:?}, but the model is to be one of {wanted:?}")]
    OtherRecordings { found: String, wanted: String },
    #[error("a world model is being trained already; stop that first")]
    IsFitting,
    /// A world's file cannot be read.
    #[error("cannot read the world: {path:?}: {cause}")]
    WorldUnread { path: PathBuf, cause: std::io::Error },
    #[error("this is longer than any world's file: {0:?}")]
    WorldTooLong(PathBuf),
    /// A file describes no world.
    #[error("{0}")]
    World(SpecError),
    #[error("there is no example of the world {0:?}: begin with a dream")]
    NoExample(String),
    /// Recordings of something else were chosen.
    #[error(
        "these recordings are of {found} and this window is about {env}: start `dropj --env {found}` for them"
    )]
    OtherWindow { found: String, env: String },
}

/// What is met by a worker that lives on: its kind tells nobody more.
macro_rules! met {
    ($($error:ty),*) => {
        $(impl From<$error> for WorkerError {
            fn from(error: $error) -> Self {
                Self::Met(Arc::new(error))
            }
        })*
    };
}

met!(
    TaskError,
    ClipError,
    OpenError,
    WorldModelError,
    RewardError,
    DatasetError,
    SessionError,
    RunError,
    NotFinite,
    ResultsError,
    SaveError
);

impl WorkerError {
    /// That it ended what it was doing, where nothing more is known of it.
    pub(super) fn gave_up(self) -> Self {
        match self {
            Self::Met(cause) => Self::GaveUp(cause),
            other => other,
        }
    }
}

impl From<FitError> for WorkerError {
    fn from(error: FitError) -> Self {
        match error {
            FitError::Stopped => Self::Stopped,
            error => Self::Met(Arc::new(error)),
        }
    }
}
