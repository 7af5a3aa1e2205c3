//! What can go wrong with a session: each says what was tried, what was met, and where.

use std::io;
use std::path::{Path, PathBuf};

use crate::dream::OtherStates;
use crate::query::{DreamId, Protocol, QueryId, SegmentRef, Transition};
use crate::reward::RewardError;
use crate::run::place::Told;
use crate::run::{AppendError, RunError};
use crate::session::event::LineError;
use crate::tensor::container::{ContainerError, Dtype};
use crate::tensor::limits::OutOfRange;
use crate::tensor::{NotFinite, ParametersError};
use crate::world_model::WorldModelError;

/// Why an event cannot have happened in a session.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Impossible {
    /// A dream has not the number that is next.
    #[error("dream {} was kept where dream {next} is next", .found.0)]
    DreamNumber {
        /// Its number.
        found: DreamId,
        /// The next.
        next: usize,
    },
    /// A mark lies behind the end of its dream.
    #[error("step {mark} is marked in a dream of {len} steps")]
    Mark {
        /// The step.
        mark: usize,
        /// How many there are.
        len: usize,
    },
    /// A dream was dropped, so nothing can be said about it.
    #[error("dream {} was deleted; bring it back first", .0.0 + 1)]
    Dropped(DreamId),
    /// A dream was not dropped, so it cannot be brought back.
    #[error("dream {} was not deleted", .0.0 + 1)]
    NotDropped(DreamId),
    /// Answers rest on a dream.
    #[error(
        "dream {} cannot be deleted, for {n} answers rest on it: take those back first, or skip these queries",
        .dream.0 + 1
    )]
    Rests {
        /// The dream.
        dream: DreamId,
        /// How many answers that count.
        n: usize,
    },
    /// A query has not the number that is next.
    #[error("query {} was asked where query {next} is next", .found.0)]
    QueryNumber {
        /// Its number.
        found: QueryId,
        /// The next.
        next: usize,
    },
    /// A segment does not lie in a dream of the session.
    #[error("the segment from step {} of dream {} lies outside it", .0.start, .0.dream.0)]
    Segment(SegmentRef),
    /// A transition does not lie in a trajectory of a dream of the session.
    #[error("the transition from step {} of dream {} lies outside its trajectory", .0.step, .0.dream.0)]
    Transition(Transition),
    /// A query is said to repeat one that shows something else.
    #[error("query {} repeats query {}, which shows other segments", .query.0, .of.0)]
    OtherSegments {
        /// The repetition.
        query: QueryId,
        /// What it repeats.
        of: QueryId,
    },
    /// A query was never asked.
    #[error("query {} was never asked", .0.0)]
    NeverAsked(QueryId),
    /// The protocol does not ask for such a response.
    #[error("{} does not ask for the response to query {}", .protocol.name(), .query.0)]
    Response {
        /// The query.
        query: QueryId,
        /// The one in force.
        protocol: Protocol,
    },
    /// A reason is given for a skip that was none.
    #[error("query {} was not skipped, so there is no reason for that", .0.0)]
    NotSkipped(QueryId),
    /// The justification is not in the session's list.
    #[error("query {} was answered with a justification that the session does not have", .0.0)]
    Justification(QueryId),
    /// A step is named that the segment does not have.
    #[error("query {} was answered with step {step}, which its segments do not have", .query.0)]
    Step {
        /// The query.
        query: QueryId,
        /// The step.
        step: usize,
    },
    /// There is no answer to take back.
    #[error("query {} has no answer to take back", .0.0)]
    NotAnswered(QueryId),
    /// No answer was taken back.
    #[error("no answer to query {} was taken back", .0.0)]
    NotRetracted(QueryId),
    /// A weight is out of range.
    #[error("the weight {name:?} must be above 0.5 and at most 1, but is {weight}")]
    Weight {
        /// Which one.
        name: &'static str,
        /// Its value.
        weight: f32,
    },
    /// The justifications changed, so that old answers would mean something else.
    #[error("the justifications must stay as they are: only their weights can change")]
    Justifications,
    /// More is held back than there is.
    #[error("{0} of a hundred pairs cannot be held back")]
    Share(u8),
    /// A number is infinite or none, or negative where it cannot be.
    #[error("{0} must be a number, and cannot be negative")]
    Number(&'static str),
    /// A reward was learned from lines that were not yet written.
    #[error("a reward was learned after {after} lines where there were {n_lines}")]
    Future {
        /// After how many lines.
        after: u64,
        /// How many there were.
        n_lines: u64,
    },
    /// A file lies outside the session's folder.
    #[error("the file {0:?} lies outside the session")]
    Outside(String),
}

/// Why bytes are no header of a session.
#[derive(Debug, thiserror::Error)]
pub enum HeaderError {
    /// There are none.
    #[error("it is empty")]
    Empty,
    /// A crash of the machine left the file so.
    #[error("there is nothing but zeros in it")]
    Zeros,
    /// They are text in another encoding.
    #[error("it is stored as UTF-16, and the header is UTF-8")]
    Utf16,
    /// They are not JSON, or tell something else.
    #[error(transparent)]
    Json(serde_json::Error),
    /// What looked like a header is not JSON.
    #[error("it is not JSON ({0})")]
    NotJson(serde_json::Error),
    /// No header begins in them.
    #[error("there is no header in it")]
    None,
    /// There never was such a format.
    #[error("it is of format 0, and the first one is 1")]
    FormatZero,
    /// The format is not named.
    #[error("it has no number \"format\"")]
    NoFormat,
    /// It is of a later format.
    #[error("it is of format {found}, and this program knows formats up to {known}")]
    Later {
        /// Its format.
        found: u64,
        /// Ours.
        known: u32,
    },
    /// A number is negative, broken or too large.
    #[error("its {0:?} is not a whole number from 0 to {max}", max = u64::MAX)]
    NotWhole(&'static str),
    /// A text is missing.
    #[error("it does not say {0:?}")]
    Missing(&'static str),
    /// A weight cannot be.
    #[error(transparent)]
    Weights(Impossible),
}

/// Why bytes, or the arrays in them, are no dream.
#[derive(Debug, thiserror::Error)]
pub enum DreamError {
    /// They are no safetensors file.
    #[error(transparent)]
    Container(ContainerError),
    /// The seed is missing.
    #[error("it has no seed")]
    NoSeed,
    /// An array is missing.
    #[error("it has no {0:?}")]
    Missing(&'static str),
    /// An array has more or fewer axes.
    #[error("its {name:?} have {found} axes in place of {wanted}")]
    Axes {
        /// Which one.
        name: &'static str,
        /// How many it has.
        found: usize,
        /// How many it should have.
        wanted: usize,
    },
    /// An array does not hold floating numbers.
    #[error("its {name:?} are of type {dtype}")]
    Kind {
        /// Which one.
        name: &'static str,
        /// What it holds.
        dtype: Dtype,
    },
    /// An array does not hold steps.
    #[error("its {name:?} are {dtype} of shape {shape:?}")]
    NoSteps {
        /// Which one.
        name: &'static str,
        /// What it holds.
        dtype: Dtype,
        /// Its shape.
        shape: Vec<usize>,
    },
    /// Latents and actions are not of the same steps.
    #[error("its arrays do not fit: zs {zs:?}, actions {actions:?}")]
    Unfit {
        /// The shape of the latents.
        zs: Vec<usize>,
        /// The shape of the actions.
        actions: Vec<usize>,
    },
    /// An action is infinite or none.
    #[error("the action of its step {0} is not a number")]
    Action(usize),
    /// It is wider than can be.
    #[error(transparent)]
    OutOfRange(OutOfRange),
    /// The start has not one output for each memory cell.
    #[error("its start has {cells} memory cells and {outputs} outputs of them")]
    Start {
        /// How many memory cells it has.
        cells: usize,
        /// How many outputs.
        outputs: usize,
    },
    /// There are more or fewer latents than actions.
    #[error("it has latents of {latents} steps and actions of {actions}")]
    Steps {
        /// Of how many steps there are latents.
        latents: usize,
        /// Of how many there are actions.
        actions: usize,
    },
    /// A number of the start is infinite or none.
    #[error("its start is not made of numbers")]
    StartNotFinite,
    /// A latent is infinite or none.
    #[error("the latents of its step {0} are not numbers")]
    Latents(usize),
    /// A step is marked that it does not have.
    #[error("its step {mark} is marked as unsafe, and it has {n_steps} steps")]
    Mark {
        /// The step.
        mark: usize,
        /// How many it has.
        n_steps: usize,
    },
    /// The planner drove steps that it does not have, or out of order.
    #[error(
        "the planner is said to have driven its steps from {from} to {to}, which are none of its {n_steps}, or are not \
         behind those named before"
    )]
    Planned {
        /// The first of these steps.
        from: usize,
        /// The one behind the last.
        to: usize,
        /// How many it has.
        n_steps: usize,
    },
    /// It was dreamed by other networks.
    #[error(transparent)]
    OtherStates(OtherStates),
    /// It is longer or shorter than the log tells.
    #[error("it has {found} steps where the log says {told}")]
    Length {
        /// How many steps it has.
        found: usize,
        /// How many the log tells of.
        told: usize,
    },
}

impl From<OtherStates> for DreamError {
    fn from(met: OtherStates) -> Self {
        Self::OtherStates(met)
    }
}

/// Why bytes do not tell what clips look like.
#[derive(Debug, thiserror::Error)]
pub enum ClipHashError {
    /// They are not JSON, or hold something else.
    #[error(transparent)]
    Json(serde_json::Error),
    /// A clip is called otherwise.
    #[error("a clip is named by its dream and its first step, as in 3/120")]
    Name,
}

/// Why a session cannot be made, opened, written or read.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// Something is to be kept while no session is open.
    #[error("there is no session to keep it in")]
    NotOpen,
    /// It is being made, or was when the program was killed.
    #[error("this session was never finished: run the command that made it again, or wait for it: {path:?}")]
    Unfinished {
        /// The folder.
        path: PathBuf,
    },
    /// The disk refused: full, read-only, forbidden, absent.
    #[error("cannot {tried}: {}: {path:?}", Told(.met))]
    Disk {
        /// What was tried.
        tried: &'static str,
        /// What was met.
        met: io::Error,
        /// Where.
        path: PathBuf,
    },
    /// Nothing can be written there.
    #[error(transparent)]
    Run(#[from] RunError),
    /// What is written would not be found under the session's name.
    #[error(
        "the log was replaced, moved or changed by another program while it was open, and nothing more is written \
         there; save the session elsewhere, or put the log back: {path:?}"
    )]
    Replaced {
        /// The log, or the journal, by its name.
        path: PathBuf,
    },
    /// A file that the session had is no longer there.
    #[error(
        "a file of this session is gone from its place; save the session elsewhere, or put it back: {path:?}"
    )]
    Gone {
        /// Which.
        path: PathBuf,
    },
    /// A new session would lie over something else.
    #[error("cannot make a session where there is something already: {path:?}")]
    Exists {
        /// Where.
        path: PathBuf,
    },
    /// No session was given.
    #[error("there are no sessions to put together")]
    NothingToMerge,
    /// Two sessions are about different things.
    #[error("cannot put together sessions of different {what}s: the first has another than {path:?}")]
    Unlike {
        /// What is not the same.
        what: &'static str,
        /// The session that differs.
        path: PathBuf,
    },
    /// A session in which somebody else answers.
    #[error("in this session {found:?} answers, and not {annotator:?}: {path:?}")]
    OtherAnnotator {
        /// Who answers in it.
        found: String,
        /// Who was to.
        annotator: String,
        /// Its folder.
        path: PathBuf,
    },
    /// Another program has the session open.
    #[error("cannot write this session: another program has it open: {path:?}")]
    InUse {
        /// Its log.
        path: PathBuf,
    },
    /// There is no session in a folder, not even a damaged one.
    #[error("there is neither a session.json nor an events.jsonl here, so this is no session: {path:?}")]
    NoSession {
        /// The folder.
        path: PathBuf,
    },
    /// The header is lost, and nothing is known to make it anew of.
    #[error(
        "the session's header is lost: {met}; give the world model it was dreamed with by --world: {path:?}"
    )]
    LostHeader {
        /// What was met.
        met: HeaderError,
        /// Its path.
        path: PathBuf,
    },
    /// The header cannot be understood.
    #[error("cannot read the session's header: {met}; `dropj repair` keeps what can be read: {path:?}")]
    Header {
        /// What was met.
        met: HeaderError,
        /// Its path.
        path: PathBuf,
    },
    /// The session was written in another format.
    #[error("this is a session of format {found}, and this program reads formats up to {known}: {path:?}")]
    Format {
        /// Its format.
        found: u64,
        /// Ours.
        known: u32,
        /// Its header.
        path: PathBuf,
    },
    /// The session belongs to another world model.
    #[error("this session was made with the world model {session}, not with {model}: {path:?}")]
    OtherWorldModel {
        /// The hash in the session.
        session: String,
        /// The hash of the model at hand.
        model: String,
        /// The session.
        path: PathBuf,
    },
    /// The session's world model is nowhere to be found.
    #[error(
        "cannot find the world model {hash} of this session, neither in its folder nor beside it nor among those that are \
         shipped; put it there as world_model.safetensors, or give it with --world: {path:?}"
    )]
    NoWorldModel {
        /// The hash in the session.
        hash: String,
        /// The session.
        path: PathBuf,
    },
    /// A line of the log is not an event.
    #[error(
        "line {line} of the session log is not an event: {met}; `dropj repair` keeps what can be read: {path:?}"
    )]
    Line {
        /// Which line, the first being 1.
        line: usize,
        /// What was met.
        met: LineError,
        /// The log.
        path: PathBuf,
    },
    /// A line of the log tells what cannot have happened.
    #[error(
        "line {line} of the session log cannot be: {why}: `dropj repair` keeps what can be read: {path:?}"
    )]
    ImpossibleLine {
        /// Which line, the first being 1.
        line: usize,
        /// Why.
        why: Impossible,
        /// The log.
        path: PathBuf,
    },
    /// An event cannot be recorded.
    #[error("cannot record this: {0}")]
    Impossible(Impossible),
    /// There is no such dream.
    #[error("the session has no dream {}", .0.0)]
    NoDream(DreamId),
    /// A file is not what it was when the log named it.
    #[error("this file has changed since the session saved it: {path:?}")]
    Changed {
        /// Which one.
        path: PathBuf,
    },
    /// A file does not hold a dream.
    #[error("cannot read the dream: {met}: {path:?}")]
    Dream {
        /// What was met.
        met: DreamError,
        /// Its path.
        path: PathBuf,
    },
    /// A file does not tell what clips look like.
    #[error("cannot read what the clips look like: {met}; `dropj replay --record` writes it anew: {path:?}")]
    ClipHashes {
        /// What was met.
        met: ClipHashError,
        /// Its path.
        path: PathBuf,
    },
    /// A file does not hold parameters.
    #[error("cannot read the parameters: {met}: {path:?}")]
    Parameters {
        /// What was met.
        met: ParametersError,
        /// Their path.
        path: PathBuf,
    },
    /// A file does not hold a reward.
    #[error("{met}: {path:?}")]
    Reward {
        /// What was met.
        met: RewardError,
        /// Its path.
        path: PathBuf,
    },
    /// A reward cannot be fitted again.
    #[error("cannot fit the reward: {0}")]
    NotFinite(NotFinite),
    /// The world model cannot be built.
    #[error("{met}: {path:?}")]
    WorldModel {
        /// What was met.
        met: WorldModelError,
        /// Its path.
        path: PathBuf,
    },
}

impl From<Impossible> for SessionError {
    /// Said whole by the error itself, so that it is no cause besides.
    fn from(why: Impossible) -> Self {
        Self::Impossible(why)
    }
}

impl From<NotFinite> for SessionError {
    fn from(met: NotFinite) -> Self {
        Self::NotFinite(met)
    }
}

impl SessionError {
    /// What to make of it that nothing could be appended to the file at `path`.
    pub(crate) fn append(tried: &'static str, path: &Path) -> impl FnOnce(AppendError) -> Self {
        move |met| match met {
            AppendError::Replaced => Self::Replaced { path: path.to_owned() },
            AppendError::Disk(met) => Self::Disk { tried, met, path: path.to_owned() },
        }
    }

    /// What to make of an [`io::Error`] met while trying something at `path`.
    pub(crate) fn disk(tried: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |met| Self::Disk { tried, met, path: path.to_owned() }
    }
}
