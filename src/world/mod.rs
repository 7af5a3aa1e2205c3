//! What a world is: its file, what it shows and brings, and a world in a process of its own.
//!
//! Knows no tensor and no session. Outside the files of the built-in worlds nothing here knows a car: names, numbers and
//! ranges come from a [`WorldSpec`].
//!
//! No thread is started either. A process is waited for with `poll`, whose time-out is the caller's, so that whoever
//! calls decides in which thread that is.

use std::sync::Arc;

use rand_chacha::ChaCha8Rng;

mod action;
mod builtin;
pub mod cars;
pub mod controls;
mod error;
mod events;
mod explorer;
mod frame;
pub mod image;
mod process;
mod protocol;
mod spec;
mod tail;
#[cfg(test)]
mod tests;
mod write;

pub use action::{Action, ActionRanges, MAX_AXES, RangesError};
pub use builtin::{BuiltIn, NAMES, authors_brake, example_of};
pub use error::{SpecError, SpecFault};
pub use events::{EventReader, Happened, event_slug, field_value};
pub use explorer::Explorer;
pub use frame::Frame;
pub use process::{Launch, Phase, Process, ProcessError, ProcessFault, ProcessWorld, Warning};
pub use protocol::{Fields, Hello, HelloAxis, HelloEvent, HelloImage, Reply, VERSION};
pub use spec::{
    Axis, CandidateSource, Candidates, Count, EventKind, EventSpec, FORMAT, FittingOverrides, ImageSpec,
    JustificationSpec, KEYS, KeyInput, LabelWeights, MAX_HORIZON, MAX_SIDE, Margins, NetworkOverrides,
    PadAxis, PadInput, Part, PlannerSpec, Release, Size, Source, SourceKind, Stage, TimeOuts, When,
    WorldSpec,
};

/// A world that can be acted in.
///
/// ```text
/// reset(seed) → frame; then, until terminated or truncated: step(action) → frame, reward, events
/// ```
///
/// The first three are its duties. What comes after them it may offer.
pub trait World: Send {
    /// What it is.
    fn spec(&self) -> &Arc<WorldSpec>;

    /// Starts an episode and shows its first moment, as networks see it: see [`ImageSpec::trained`].
    ///
    /// # Errors
    /// Where the world fails. It may then be of no more use: see [`WorldError`].
    fn reset(&mut self, seed: u64) -> Result<Frame, WorldError>;

    /// Moves the world on by one step of `1 / rate` seconds. Values out of an axis's range are moved into it.
    ///
    /// # Errors
    /// Where the action has not a finite number for each axis, where no episode goes on, and where the world fails.
    fn step(&mut self, action: &[f32]) -> Result<Step, WorldError>;

    /// The names of what is measured beside the picture, as by a robot of itself. None where nothing is.
    fn sensors(&self) -> Vec<String> {
        Vec::new()
    }

    /// What [`sensors`](Self::sensors) measure at the present moment, in their order.
    fn state(&self) -> Vec<f32> {
        Vec::new()
    }

    /// The present moment as a person sees it, where that is not what networks see: of this size, if it can be drawn at
    /// any, or else of its own.
    fn picture(&self, width: u32, height: u32) -> Option<Frame> {
        let _ = (width, height);
        None
    }

    /// What a simulation knows of the present moment beside what is measured: for tables, and never for the method.
    fn known(&self) -> Vec<(&'static str, f32)> {
        Vec::new()
    }

    /// What of the present moment is worth a few words, where there is something.
    fn status(&self) -> Option<Status> {
        None
    }

    /// The same world at the present moment, to go on by itself: to look ahead in it, as no real world allows, for scale.
    /// Only a simulation can be copied.
    fn copied(&self) -> Option<Box<dyn World>> {
        None
    }

    /// Its own way to act, where it has one: for recordings without a person.
    fn policy(&mut self) -> Option<&mut dyn OwnPolicy> {
        None
    }
}

/// How a world acts where nobody else does: it explores, unsafely too.
pub trait OwnPolicy {
    /// Begins an episode with the moods that `rng` draws. The world was reset.
    fn begin(&mut self, rng: &mut ChaCha8Rng);

    /// What to do now. The world is not moved.
    ///
    /// # Errors
    /// Where the world fails.
    fn act(&mut self, rng: &mut ChaCha8Rng) -> Result<Action, WorldError>;
}

/// What of a moment is worth a few words.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Status {
    /// The words: `2 of 4 wheels off the road`.
    pub text: String,
    /// Whether all is well.
    pub is_fine: bool,
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
    /// What was carried out, where that is not what was asked: a filter, an aid, a hand at the robot.
    pub executed: Option<Action>,
    /// Why it was the last of its episode, if it was.
    pub end: Option<End>,
}

/// Why an episode ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// By what happened in it.
    Terminated,
    /// From outside, as by its longest time.
    Truncated,
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
