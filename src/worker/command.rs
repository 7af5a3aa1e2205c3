//! What workers are told to do.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use crate::dream::{DreamEpisode, Rows};
use crate::evaluation::EpisodeMetrics;
use crate::experiment::side_by_side::{Part, SideBySide};
use crate::planner::synthesis::Acquisition;
use crate::query::{DreamId, JudgedTransition, Label, Query, QueryId, Response, SegmentRef};
use crate::session::{DreamJournal, DreamSource, Event, Fit, Header, Session, SessionStore, UnfinishedDream};
use crate::tensor::Parameters;
use crate::worker::RolloutComparison;
use crate::world::{Action, Frame, WorldSpec};
use crate::world_model::{LatentState, ModelIdentity};

/// A command, and the worker that it is for.
#[derive(Debug)]
pub enum WorkerCommand {
    /// Plays dreams.
    Dreamer(DreamerCommand),
    /// Decodes clips.
    Clipper(ClipperCommand),
    /// Looks for dreams that have left the world.
    Screener(ScreenerCommand),
    /// Synthesizes trajectories.
    Synthesizer(SynthesizerCommand),
    /// Learns the reward.
    Trainer(TrainerCommand),
    /// Acts in the real world by plan.
    Driver(DriverCommand),
    /// Shows kept dreams, and what the reward says of them.
    DreamInspector(DreamInspectorCommand),
    /// Records.
    Recorder(RecorderCommand),
    /// Lists and shows recorded episodes.
    EpisodeBrowser(EpisodeBrowserCommand),
    /// Drives episodes of the planner again.
    Replayer(ReplayerCommand),
    /// Fits world models.
    Modeler(ModelerCommand),
    /// Shows what episodes begin with.
    Previewer(PreviewerCommand),
    /// Keeps the session on disk.
    SessionWriter(SessionWriterCommand),
    /// Does single pieces of work on files.
    Jobs(JobCommand),
    /// All workers of the present session end, and what they were about to report is dropped.
    EndSession,
    /// The same, and those that need a world model begin anew with this one.
    UseWorldModel(Parameters),
}

/// Plays dreams at the world's rate, each for as long as the world's longest episode at the most.
#[derive(Debug)]
pub enum DreamerCommand {
    /// Starts a dream, journalled in `journal` where that is given.
    Start {
        /// Where it begins.
        start: LatentState,
        /// Of its noise.
        seed: u64,
        /// What holds it until it is kept; without a session there is none.
        journal: Option<DreamJournal>,
    },
    /// Stops the clock, or lets it go on.
    Pause(bool),
    /// One step while the clock stands.
    Step,
    /// Marks the present step as unsafe.
    MarkUnsafe,
    /// Plans with this reward from now on.
    Reward(Parameters),
    /// Gives the wheel to the planner, or back.
    HandOver(bool),
    /// Ends the dream and reports it.
    Finish,
    /// Ends the dream and forgets it, journal and all.
    Discard,
    /// Writes the dream into this journal from now on, and what was driven so far.
    Journal(DreamJournal),
}

/// Draws clips before they are needed.
#[derive(Debug)]
pub enum ClipperCommand {
    /// Knows a dream from now on.
    AddDream(DreamId, Arc<DreamEpisode>),
    /// Decodes both segments of a query.
    Decode(Query),
    /// Decodes one picture of either segment, for a list.
    DecodeThumbnails(Query),
}

/// Looks for signs that dreams have left the world behind.
#[derive(Debug)]
pub enum ScreenerCommand {
    /// Looks at a dream.
    AddDream(DreamId, Arc<DreamEpisode>),
}

/// Makes trajectories that are worth asking about.
#[derive(Debug)]
pub enum SynthesizerCommand {
    /// Makes one, and no longer the one before.
    Make {
        /// Where it begins.
        start: LatentState,
        /// What it is to be.
        acquisition: Acquisition,
        /// The classifier that says so; without one, or where these are a reward of another kind, a fresh one.
        reward: Option<Parameters>,
        /// The latents that transitions led to which were judged, `[N, Z]`.
        seen: Rows,
        /// Of all that is drawn.
        seed: u64,
    },
    /// Makes it no longer.
    Stop,
}

/// Learns a reward while answers come in: from preferences or from verdicts, whichever came last.
#[derive(Debug)]
pub enum TrainerCommand {
    /// Knows a dream from now on.
    AddDream(DreamId, Arc<DreamEpisode>),
    /// Learns from an answer, or from another answer to the same query.
    Learn(Query, Label),
    /// Learns from a verdict on a transition, or from another verdict on the same.
    LearnVerdict(JudgedTransition),
    /// Forgets the answer to a query.
    Forget(QueryId),
    /// Measures how much the members of the ensemble disagree about each of these pairs.
    MeasureDisagreement(Vec<[SegmentRef; 2]>),
    /// Learns all answers anew, for they weigh differently.
    Relearn,
    /// Starts afresh and fits all answers to the end.
    Fit {
        /// Of initialization and order.
        seed: u64,
    },
}

/// Acts in the real world by plan.
#[derive(Debug)]
pub enum DriverCommand {
    /// Plans with these rewards from now on.
    Reward(Parameters),
    /// Drives an episode on the track of `seed`, once there is a reward.
    Drive {
        /// Of the track and of the planner's draws.
        seed: u64,
    },
    /// Stops the clock, or lets it go on.
    Pause(bool),
    /// Ends the episode; its figures are not reported, for they are not those of a whole one.
    Stop,
}

/// Looks at kept dreams again.
#[derive(Debug)]
pub enum DreamInspectorCommand {
    /// Knows a dream from now on.
    AddDream(DreamId, Arc<DreamEpisode>),
    /// Evaluates by this reward from now on.
    Reward(Parameters),
    /// Compares what the rewards to come predict with what the present one predicts.
    Compare,
    /// Shows this step, and evaluates the dream where that has not been done by the present reward.
    Show {
        /// Of which dream.
        dream: DreamId,
        /// Which step.
        step: usize,
    },
    /// Predicts by the present reward which clip of a query is better.
    Predict(Query),
}

/// Lets a person act in the real world and records it; an episode that the environment ends is kept.
#[derive(Debug)]
pub enum RecorderCommand {
    /// Starts an episode on the track of `seed`, kept in the dataset at `dataset`.
    Start {
        /// The `LeRobot` folder.
        dataset: PathBuf,
        /// Of the track.
        seed: u64,
    },
    /// Dreams and plans with this world model from now on.
    Model(Parameters),
    /// Plans with this reward from now on.
    Reward(Parameters),
    /// Gives the wheel to the planner, or back.
    HandOver(bool),
    /// Dreams beside the real world, or no longer.
    CompareRollout(Option<RolloutComparison>),
    /// Stops the clock, or lets it go on.
    Pause(bool),
    /// Ends the episode and seals it.
    Keep,
    /// Ends the episode and forgets it.
    Discard,
    /// Goes on with the episode in this dataset, with all that was driven so far.
    SaveIn(PathBuf),
    /// Finds the episodes in this dataset that a killed program left behind, unless one is being driven.
    FindUnfinished(PathBuf),
    /// Seals those, as far as they go.
    Recover(PathBuf),
    /// Throws them away.
    Forget(PathBuf),
}

/// Lists, opens and deletes recorded episodes, which are named by what they were recorded as.
#[derive(Debug)]
pub enum EpisodeBrowserCommand {
    /// Lists the episodes of a `LeRobot` folder.
    List(PathBuf),
    /// Opens one of them, and draws its first step.
    Open {
        /// The `LeRobot` folder.
        dataset: PathBuf,
        /// Which.
        recording: String,
    },
    /// Shows this step of it.
    Show(usize),
    /// Evaluates by this world model and reward from now on, or no longer.
    Evaluate(Option<(Parameters, Parameters)>),
    /// Forgets the one that is open.
    Close,
    /// Deletes one, and lists the others.
    Delete {
        /// The `LeRobot` folder.
        dataset: PathBuf,
        /// Which.
        recording: String,
    },
    /// Brings back one if it is the one that was deleted last, and lists all.
    BringBack {
        /// The `LeRobot` folder.
        dataset: PathBuf,
        /// Which.
        recording: String,
    },
}

/// Drives an episode again that the planner drove.
#[derive(Debug)]
pub enum ReplayerCommand {
    /// Drives it, and no longer the one before.
    Drive {
        /// What it is called in reports.
        replay: u64,
        /// Of the track.
        seed: u64,
        /// What the planner asked for at each step.
        actions: Arc<[Action]>,
    },
    /// Shows this step of it, once it is driven.
    Show(usize),
    /// Forgets it.
    Close,
}

/// Trains a world model.
#[derive(Debug)]
pub enum ModelerCommand {
    /// Fits one to the recordings at `dataset` and writes it to `out`.
    Fit {
        /// The `LeRobot` folder.
        dataset: PathBuf,
        /// The file to write.
        out: PathBuf,
        /// Whether to go on from a checkpoint.
        resume: bool,
    },
    /// Stops at the next update, which is reported as [`Report::Failed`](crate::worker::Report::Failed); it can be resumed.
    Stop,
}

/// Shows what episodes of the real world begin with, before anybody acts in them.
#[derive(Debug)]
pub enum PreviewerCommand {
    /// Shows the first picture of the episode of this seed.
    Show(u64),
}

/// Keeps the session that is open on disk, in the order of these commands.
///
/// Each event is forced to disk before it is reported as recorded: what is not reported has not happened.
#[derive(Debug)]
pub enum SessionWriterCommand {
    /// Makes a session in a folder of its own below `sessions`.
    Create {
        /// The folder of sessions.
        sessions: PathBuf,
        /// Its head.
        header: Header,
    },
    /// Writes into this session from now on.
    Use(Box<SessionStore>),
    /// Closes the session that is open.
    Close,
    /// Hands out the session that is open, so that it can be read anew.
    Release,
    /// Appends an event to the log.
    Record {
        /// What happened.
        event: Event,
        /// When, in milliseconds since 1970.
        at: u64,
    },
    /// Keeps a dream: its file, then its event; its journal is removed after that.
    SaveDream {
        /// As it was driven or synthesized.
        episode: DreamEpisode,
        /// Who drove.
        source: DreamSource,
        /// What a synthesized trajectory was to be.
        acquisition: Option<Acquisition>,
        /// What held it until now.
        journal: Option<DreamJournal>,
    },
    /// Keeps a reward and how it was learned.
    SaveReward {
        /// Its parameters.
        parameters: Parameters,
        /// How they were fitted.
        fit: Fit,
    },
    /// Keeps what the reward drove.
    KeepDriven {
        /// The seed of the episode.
        seed: u64,
        /// What came of it.
        metrics: EpisodeMetrics,
    },
    /// Opens a journal for a dream that begins, or that goes on without one.
    OpenJournal {
        /// As far as it was driven.
        episode: DreamEpisode,
        /// Whether it is about to begin.
        is_new: bool,
    },
    /// Removes the journal of a dream that is not kept.
    DiscardJournal(DreamJournal),
    /// Keeps the dreams that a killed program left behind: these, or those that are found where there are none.
    Recover(Vec<UnfinishedDream>),
    /// Throws them away.
    DiscardUnfinished(Vec<UnfinishedDream>),
    /// Writes down what could not be before, in its order.
    TryAgain,
    /// Takes back what happened last of what could not be written down.
    ForgetLastUnsaved,
    /// Lets go of all that could not be written down.
    ForgetUnsaved,
    /// Writes all of the session to `path`, in a folder of its own where there is something already, and goes on there.
    SaveAs {
        /// Where.
        path: PathBuf,
        /// The dreams that are in memory.
        dreams: BTreeMap<DreamId, Arc<DreamEpisode>>,
        /// The latest reward.
        reward: Option<Parameters>,
    },
    /// Finds out whether sessions can be kept in this folder.
    CheckFolder {
        /// The folder of sessions.
        sessions: PathBuf,
        /// Why that is asked.
        purpose: FolderCheck,
    },
    /// Proposes where what cannot be saved in its place could be: below this folder if it can be written, else at home.
    ProposePlace {
        /// The folder that would do best.
        folder: PathBuf,
        /// What a new folder in it is to be called; nothing where the folder itself is meant.
        name: Option<String>,
    },
}

/// Why it is asked whether sessions can be kept in a folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FolderCheck {
    /// The window has opened.
    AtStart,
    /// Somebody has chosen it for all sessions from here on.
    Chosen,
    /// It could not be written, and may be by now.
    Again,
}

/// A single piece of work on files, done in a thread of its own.
#[derive(Debug)]
pub enum JobCommand {
    /// Reads a world model.
    LoadWorldModel(PathBuf),
    /// Opens the session in a folder and reads what it holds; the one that was being opened before is given up.
    OpenSession {
        /// Its folder.
        dir: PathBuf,
        /// The world model that it must be of, if that is known.
        model: Option<ModelIdentity>,
    },
    /// Reads what a session holds that is open already.
    ReadSession(Box<SessionStore>),
    /// Gives up the session that is being opened.
    GiveUpOpening,
    /// Lists the latest sessions in a folder, one after the other.
    ListSessions {
        /// The folder of sessions.
        sessions: PathBuf,
        /// The world model that is loaded, if one is.
        model: Option<ModelIdentity>,
    },
    /// Lists them no longer.
    StopListing,
    /// Finds the latest of them that can be gone on with.
    FindLatestSession {
        /// The folder of sessions.
        sessions: PathBuf,
        /// The world model that is loaded, if one is.
        model: Option<ModelIdentity>,
        /// The name of a folder that is none of somebody's own: the example that is shipped.
        except: Option<&'static str>,
    },
    /// Lists sessions that could be merged.
    ListMergeable {
        /// The folder of sessions.
        sessions: PathBuf,
        /// Folders that were named beside those.
        added: Vec<PathBuf>,
        /// The hash of the world model that they must be of, or nothing.
        hash: String,
        /// The world model that is loaded, if one is.
        model: Option<ModelIdentity>,
    },
    /// Merges sessions into a new one below `sessions`.
    Merge {
        /// Their folders; weights are those of the first.
        dirs: Vec<PathBuf>,
        /// The folder of sessions.
        sessions: PathBuf,
    },
    /// Makes a session of the same queries for another annotator.
    HandOver {
        /// The session's folder.
        dir: PathBuf,
        /// The folder of sessions.
        sessions: PathBuf,
        /// Who is to answer.
        annotator: String,
    },
    /// Compares all who answered about the dreams of a session.
    CompareAnnotators {
        /// The session's folder.
        dir: PathBuf,
        /// Its state.
        session: Box<Session>,
        /// The folder of sessions.
        sessions: PathBuf,
    },
    /// Looks at the recordings in a folder.
    OpenRecordings {
        /// The `LeRobot` folder.
        dir: PathBuf,
        /// The world that they must be of.
        spec: Arc<WorldSpec>,
    },
    /// Finds out what was dropped on the window.
    Identify(PathBuf),
    /// Makes a session of a few queries of the example that is shipped for a world.
    Practice {
        /// The world's name.
        world: String,
        /// The folder of sessions.
        sessions: PathBuf,
        /// Who is to answer.
        annotator: String,
    },
    /// Writes what was seen as a GIF.
    WriteClip {
        /// The file.
        path: PathBuf,
        /// What was seen.
        source: ClipSource,
    },
    /// Reads results, to set them beside others.
    OpenResults(PathBuf),
    /// Writes what is shown of runs side by side.
    SaveResults {
        /// What of it.
        part: Part,
        /// The file, or the folder of all.
        path: PathBuf,
        /// What is shown.
        shown: Box<SideBySide>,
    },
}

/// What was seen, and is to be shown to others.
#[derive(Clone, Debug)]
pub enum ClipSource {
    /// Both clips of a query, and what was said of them.
    Query {
        /// Pictures of the left one.
        left: Vec<Frame>,
        /// Pictures of the right one.
        right: Vec<Frame>,
        /// What was said, if anything.
        response: Option<Response>,
        /// Steps a second of the world.
        rate: f64,
    },
    /// A kept dream.
    Dream {
        /// It.
        episode: Arc<DreamEpisode>,
        /// The model that it was dreamed in.
        model: Parameters,
    },
    /// An episode that the planner acted in, beside the futures that it chose from.
    Deployed {
        /// What was seen, one after the other.
        seen: Vec<DeployedMoment>,
        /// Pictures a second.
        rate: f64,
    },
    /// The real world, and what was dreamt beside it, one after the other.
    Beside {
        /// Pairs of the real world and the dream.
        seen: Vec<[Frame; 2]>,
        /// Pictures a second.
        rate: f64,
    },
}

/// A moment of an episode that the planner acted in.
#[derive(Clone, Debug)]
pub struct DeployedMoment {
    /// What was seen.
    pub frame: Frame,
    /// The last picture of each plan.
    pub lead_to: Arc<[Frame]>,
    /// The plan that was chosen.
    pub chosen: usize,
}
