//! What a world is: its file, what it shows and brings, and a world in a process of its own.
//!
//! Knows no tensor and no session. Outside the files of the built-in worlds nothing here knows a car: names, numbers and
//! ranges come from a [`WorldSpec`].
//!
//! No thread is started either. A process is waited for with `poll`, whose time-out is the caller's, so that whoever
//! calls decides in which thread that is.

mod builtin;
mod error;
mod events;
mod frame;
mod process;
mod protocol;
mod spec;
mod tail;
#[cfg(test)]
mod tests;
mod write;

pub use builtin::{BuiltIn, NAMES};
pub use error::{SpecError, SpecFault};
pub use events::{EventReader, Happened, field_value};
pub use frame::Frame;
pub use process::{Launch, Phase, Process, ProcessError, ProcessFault, ProcessWorld, Warning};
pub use protocol::{Fields, Hello, HelloAxis, HelloEvent, HelloImage, Reply, VERSION};
pub use spec::{
    Axis, CandidateSource, Candidates, Count, EventKind, EventSpec, FORMAT, FittingOverrides, ImageSpec,
    JustificationSpec, KEYS, KeyInput, LabelWeights, MAX_SIDE, Margins, NetworkOverrides, PadAxis, PadInput,
    PlannerSpec, Release, Size, Source, SourceKind, Stage, TimeOuts, When, WorldSpec,
};

/// A world that can be acted in.
///
/// ```text
/// reset(seed) → frame; then, until terminated or truncated: step(action) → frame, reward, events
/// ```
pub trait World: Send {
    /// What it is.
    fn spec(&self) -> &WorldSpec;

    /// Starts an episode and shows its first moment.
    ///
    /// # Errors
    /// Where the world fails. It may then be of no more use: see [`WorldError`].
    fn reset(&mut self, seed: u64) -> Result<Frame, WorldError>;

    /// Moves the world on by one step of `1 / rate` seconds. Values out of an axis's range are moved into it.
    ///
    /// # Errors
    /// Where the action has not a finite number for each axis, where no episode goes on, and where the world fails.
    fn step(&mut self, action: &[f32]) -> Result<Step, WorldError>;
}

/// What a step brought.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// What is seen after it.
    pub frame: Frame,
    /// The world's own reward, where it has one. Finite.
    pub reward: Option<f32>,
    /// What happened, in the order of the events of the [`WorldSpec`].
    pub events: Vec<Happened>,
    /// Whether the episode ended by what happened in it.
    pub terminated: bool,
    /// Whether it was ended from outside, as by its longest time.
    pub truncated: bool,
}

impl Step {
    /// Whether it was the last of its episode.
    pub fn is_last(&self) -> bool {
        self.terminated || self.truncated
    }
}

/// Why a world did not do what it was asked.
#[derive(Debug, thiserror::Error)]
pub enum WorldError {
    /// An action has too many or too few numbers.
    #[error("an action of this world has {wanted} numbers, one for each axis, and this one has {found}")]
    ActionLength {
        /// How many it has.
        found: usize,
        /// How many axes there are.
        wanted: usize,
    },
    /// An action has what is no number.
    #[error("the action's value for {axis:?} is {found}, and must be a number")]
    ActionValue {
        /// Which axis.
        axis: String,
        /// Its value.
        found: f32,
    },
    /// No episode goes on: none was begun, or the last one is over.
    #[error("no episode of this world goes on: reset it first")]
    NoEpisode,
    /// Its process failed, and is gone.
    #[error(transparent)]
    Process(#[from] ProcessError),
}
