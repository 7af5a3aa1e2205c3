//! What workers report, by the room that receives it.

use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use crate::dream::{DreamEpisode, Rows};
use crate::evaluation::EpisodeMetrics;
use crate::experiment::Opened;
use crate::planner::synthesis::Acquisition;
use crate::query::{DreamId, Query, SegmentRef};
use crate::session::{
    Annotators, DreamJournal, Entry, Event, Fit, Header, LoadedSession, Session, SessionError, SessionStore,
};
use crate::tensor::Parameters;
use crate::worker::{
    ClipRewards, DreamRewards, DriveView, EpisodeList, EpisodeView, FolderCheck, LiveView, OpenEpisode,
    ReplayView, ReviewView, RolloutView,
};
use crate::world::{Action, Frame};
use crate::world_model::LatentState;
use crate::world_model::fit::Progress;

/// What a worker reports: one closed list, one inbox.
#[derive(Debug)]
pub enum Report {
    /// On recording and on recorded episodes.
    Record(RecordReport),
    /// On the fitting of world models.
    WorldModel(WorldModelReport),
    /// On dreams.
    Dream(DreamReport),
    /// On queries.
    Label(LabelReport),
    /// On the reward.
    Reward(RewardReport),
    /// On the car that the planner drives.
    Deploy(DeployReport),
    /// On runs that are set side by side.
    Evaluate(EvaluateReport),
    /// On the session on disk.
    Session(SessionReport),
    /// On what episodes begin with.
    Scene(SceneReport),
    /// On a piece of work on files.
    Job(JobReport),
    /// A worker met an error.
    Failed(WorkerFailure),
}

/// On recording and on recorded episodes.
#[derive(Debug)]
pub enum RecordReport {
    /// What is seen now.
    View(LiveView),
    /// What is dreamt beside it.
    Rollout(RolloutView),
    /// An episode is on disk.
    Recorded {
        /// Its number in the dataset.
        episode: usize,
        /// Steps.
        n_steps: usize,
    },
    /// A recording stands, for it cannot be written; what was driven is kept. The sentence says why.
    Held(String),
    /// A recording goes on in this dataset.
    Moved(PathBuf),
    /// So many recordings were left behind by a killed program.
    Unfinished(usize),
    /// A recorded episode is left out of a fit, or out of the dataset from here on; the sentence says why.
    LeftOut(String),
    /// What a folder of recordings holds.
    Episodes(EpisodeList),
    /// A recorded episode has been read.
    Opened(OpenEpisode),
    /// A step of it.
    EpisodeView(EpisodeView),
    /// What the reward says of the recorded episode that is open.
    EpisodeRewards {
        /// Which.
        recording: String,
        /// The mean of the members, the lowest and the highest, step by step.
        rewards: [Vec<f32>; 3],
    },
}

/// On the fitting of world models.
#[derive(Debug)]
pub enum WorldModelReport {
    /// One is being fitted.
    Fitting(Progress),
    /// One is on disk.
    Fitted(PathBuf),
}

/// On dreams.
#[derive(Debug)]
pub enum DreamReport {
    /// What is seen in the dream that is driven.
    View(LiveView),
    /// A dream ended and is offered for keeping.
    Ended {
        /// As it was driven.
        episode: DreamEpisode,
        /// What to discard once it is kept or thrown away.
        journal: Option<DreamJournal>,
    },
    /// A dream is driven and cannot be written down; the sentence says why.
    Unjournaled(String),
    /// A step of a kept dream.
    Review(ReviewView),
    /// What the reward says of a kept dream.
    Rewards(DreamRewards),
}

/// On queries.
#[derive(Debug)]
pub enum LabelReport {
    /// A query's clips are decoded.
    Clips {
        /// Which.
        query: Query,
        /// Twenty pictures.
        left: Vec<Frame>,
        /// Twenty pictures.
        right: Vec<Frame>,
    },
    /// A query's thumbnails are decoded.
    Thumbnails {
        /// Which.
        query: Query,
        /// From the middle of the left clip, and of the right one.
        frames: [Frame; 2],
    },
    /// A dream has been screened.
    Signs {
        /// Which.
        dream: DreamId,
        /// Of its noise: another session has a dream of this number, too.
        seed: u64,
        /// The signs of its steps.
        signs: Rows,
    },
    /// The disagreement about pairs has been measured.
    Disagreements {
        /// Which.
        pairs: Vec<[SegmentRef; 2]>,
        /// How much the members disagree about each; nothing where nothing was learned yet.
        disagreements: Option<Vec<f32>>,
    },
    /// What the reward predicts of the clips of a query.
    Predicted {
        /// Which.
        query: Query,
        /// Of the left one, and of the right one.
        clips: [ClipRewards; 2],
    },
    /// A trajectory is being synthesized.
    Synthesizing {
        /// Of which search.
        seed: u64,
        /// Steps of the gradient so far.
        done: usize,
        /// How many there will be.
        n: usize,
    },
    /// A trajectory is synthesized.
    Synthesized {
        /// It, with the seed of its search.
        episode: DreamEpisode,
        /// What it was to be.
        acquisition: Acquisition,
    },
}

/// On the reward.
#[derive(Debug)]
pub enum RewardReport {
    /// It has learned a little.
    Learning(Learning),
    /// It has parameters worth planning with.
    Learned {
        /// They.
        parameters: Parameters,
        /// How many answers they rest on.
        n_labels: usize,
        /// Where a full fit has ended: its seed, and each member's loss in its last epoch.
        fit: Option<(u64, Vec<f32>)>,
    },
}

/// On the car that the planner drives.
#[derive(Debug)]
pub enum DeployReport {
    /// What is seen now, and what the planner considers.
    View(DriveView),
    /// An episode ended.
    Ended {
        /// Of the track.
        seed: u64,
        /// Its figures.
        metrics: EpisodeMetrics,
        /// What the planner asked for at each step.
        actions: Arc<[Action]>,
    },
}

/// What the episode of a seed begins with.
#[derive(Debug)]
pub struct SceneReport {
    /// The seed.
    pub seed: u64,
    /// As a person sees it: width, height, RGB bytes.
    pub picture: (u32, u32, Arc<[u8]>),
}

/// On an episode of the planner that is driven again.
#[derive(Debug)]
pub enum EvaluateReport {
    /// So many steps of it are driven.
    Replaying {
        /// Which.
        replay: u64,
        /// How many.
        done: usize,
    },
    /// All of it is driven.
    Replayed {
        /// Which.
        replay: u64,
        /// Its figures.
        metrics: EpisodeMetrics,
        /// The steps in which something went on that must not happen.
        unsafe_steps: Vec<Range<usize>>,
    },
    /// A step of it.
    View(ReplayView),
}

/// On the session on disk.
#[derive(Debug)]
pub enum SessionReport {
    /// A session was made, or why it could not be.
    Created(Result<Box<LoadedSession>, SessionError>),
    /// The session that was open, which is no longer written into.
    Released(Box<SessionStore>),
    /// An event is on disk, and counts.
    Recorded(Entry),
    /// An event is not on disk, and does not count.
    NotRecorded {
        /// Which.
        event: Event,
        /// Why.
        error: SessionError,
        /// How many events wait to be written down.
        n_unsaved: usize,
    },
    /// A dream is kept.
    DreamSaved {
        /// Its line in the log.
        entry: Entry,
        /// Which.
        id: DreamId,
        /// It.
        episode: DreamEpisode,
    },
    /// A dream could not be kept, and is not lost.
    DreamNotSaved {
        /// It.
        episode: DreamEpisode,
        /// What it was to be, where it was synthesized.
        acquisition: Option<Acquisition>,
        /// What holds it.
        journal: Option<DreamJournal>,
        /// Why.
        error: SessionError,
    },
    /// A reward is saved.
    RewardSaved(Entry),
    /// A reward could not be saved, and is not lost.
    RewardNotSaved {
        /// It.
        parameters: Parameters,
        /// How it was fitted.
        fit: Fit,
        /// Why.
        error: SessionError,
    },
    /// A journal for a dream that is about to begin, or why there is none; and that dream.
    Journal {
        /// As it begins.
        episode: DreamEpisode,
        /// What holds it from now on.
        journal: Result<DreamJournal, SessionError>,
        /// Whether the dream is about to begin, and does not go on.
        is_new: bool,
    },
    /// A dream that a killed program left behind could not be kept or thrown away.
    NotRecovered(SessionError),
    /// What the reward drove could not be kept.
    DrivenNotKept(SessionError),
    /// What could not be written down before is on disk now, and the session as it is with that.
    Written {
        /// What was written.
        events: Vec<Event>,
        /// All of it.
        session: Box<Session>,
    },
    /// It still cannot be written down.
    NotWritten {
        /// Why.
        error: SessionError,
        /// How many events wait to be written down.
        n_unsaved: usize,
    },
    /// The event that happened last of those that could not be written down was taken back.
    Forgotten {
        /// How many events wait to be written down.
        n_unsaved: usize,
    },
    /// All of the session is in another folder, and goes on there.
    SavedAs {
        /// The folder.
        dir: PathBuf,
        /// Its head.
        header: Header,
        /// The session as it is there.
        session: Box<Session>,
        /// What had not been written down before.
        events: Vec<Event>,
        /// Files that were neither in memory nor anywhere on disk.
        left_out: Vec<String>,
    },
    /// It could not be saved there.
    NotSavedAs(SessionError),
    /// Whether sessions can be kept in a folder.
    Folder {
        /// The folder.
        sessions: PathBuf,
        /// Why that was asked.
        purpose: FolderCheck,
        /// Whether they can.
        result: Result<(), SessionError>,
    },
    /// Where something could be saved.
    Place(PathBuf),
    /// The session that is open is under its name, or no longer: reported whenever that changes.
    Checked(Result<(), SessionError>),
}

/// On a piece of work on files.
#[derive(Debug)]
pub enum JobReport {
    /// A world model was read, or why it could not be.
    WorldModel(Result<Box<LoadedWorld>, WorkerError>),
    /// So many of so many dreams of the session that is being opened are read.
    Opening(usize, usize),
    /// It is read, or why it cannot be.
    Session(Result<Box<LoadedSession>, WorkerError>),
    /// The sessions that were found so far.
    Sessions {
        /// The latest first.
        found: Vec<SessionItem>,
        /// Whether there may be more.
        is_listing: bool,
    },
    /// They could not be listed.
    NotListed(WorkerError),
    /// The latest one that can be gone on with, where there is one.
    LatestSession(Option<SessionItem>),
    /// The sessions that could be merged, where so many folders had been named beside those that are found.
    Mergeable(Vec<SessionItem>, usize),
    /// Those were compared who answered about the dreams of the session in this folder.
    Compared(PathBuf, Annotators),
    /// A session was made; the sentence says what it holds.
    Made(PathBuf, String),
    /// Recordings can be used; the sentence says what they are.
    Recordings(PathBuf, String),
    /// What was dropped on the window.
    Identified(PathBuf, Dropped),
    /// A session of a few queries to begin with was made, or why it could not be.
    Practice(Result<PathBuf, WorkerError>),
    /// A clip is on disk, or why it is not.
    ClipWritten(Result<PathBuf, WorkerError>),
    /// Results were read, or why they could not be.
    Results(Result<Box<Opened>, WorkerError>),
    /// What is shown of them was saved; the sentence says where. Or why it could not be.
    Saved(Result<String, WorkerError>),
    /// Something could not be done.
    Failed(WorkerError),
}

/// Where a dream can begin.
#[derive(Clone, Debug)]
pub struct DreamStart {
    /// What a person would call it.
    pub name: String,
    /// The state.
    pub state: LatentState,
    /// What it looks like.
    pub picture: Option<Frame>,
}

/// A world model that is ready for use.
#[derive(Clone, Debug)]
pub struct LoadedWorld {
    /// A name for people: that it is shipped, or its file's.
    pub name: String,
    /// The file it came from, if it came from one.
    pub path: Option<PathBuf>,
    /// The networks.
    pub parameters: Parameters,
    /// What is known about it: what it was fitted to, how well it predicts.
    pub card: Vec<(String, String)>,
    /// Where its dreams can begin.
    pub starts: Vec<DreamStart>,
    /// A smaller one of the same world, for machines that do not keep this one's pace.
    pub compact: Option<PathBuf>,
}

/// A session in a list.
#[derive(Clone, Debug)]
pub struct SessionItem {
    /// Its folder.
    pub dir: PathBuf,
    /// A name for people.
    pub name: String,
    /// What it holds, or why it cannot be opened.
    pub about: Result<String, String>,
}

/// What was dropped on the window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dropped {
    /// A file of parameters.
    WorldModel,
    /// The file of a world, which can be opened.
    World,
    /// The folder of a session.
    Session,
    /// Results, to be set beside others.
    Results,
    /// Another folder: recordings, perhaps.
    Recordings,
}

/// A report of a room is a report.
macro_rules! rooms {
    ($($room:ident($report:ty)),*) => {
        $(impl From<$report> for Report {
            fn from(report: $report) -> Self {
                Self::$room(report)
            }
        })*
    };
}

rooms!(
    Record(RecordReport),
    WorldModel(WorldModelReport),
    Dream(DreamReport),
    Label(LabelReport),
    Reward(RewardReport),
    Deploy(DeployReport),
    Evaluate(EvaluateReport),
    Session(SessionReport),
    Scene(SceneReport),
    Job(JobReport)
);

/// How well the reward fits.
#[derive(Clone, Debug, PartialEq)]
pub struct Learning {
    /// Epochs of a full fit that are done, or the fits so far while answers come in.
    pub epoch: usize,
    /// Cross-entropy of each member.
    pub losses: Vec<f32>,
    /// Cross-entropy of answers predicted before they were learned, where there are enough.
    pub held_out_loss: Option<f32>,
    /// Share of strict answers that were predicted right before they were learned.
    pub agreement: Option<f32>,
    /// Answers learned from.
    pub n_labels: usize,
    /// Whether a full fit is under way, and how many epochs it will have.
    pub fit_epochs: Option<usize>,
}

/// A worker.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[expect(missing_docs, reason = "each is called as its module")]
pub enum WorkerName {
    Dreamer,
    Clipper,
    Screener,
    Synthesizer,
    Trainer,
    Driver,
    DreamInspector,
    Recorder,
    EpisodeBrowser,
    Replayer,
    Modeler,
    Previewer,
    SessionWriter,
    Jobs,
}

impl WorkerName {
    /// All of them.
    pub const ALL: [Self; 14] = [
        Self::Dreamer,
        Self::Clipper,
        Self::Screener,
        Self::Synthesizer,
        Self::Trainer,
        Self::Driver,
        Self::DreamInspector,
        Self::Recorder,
        Self::EpisodeBrowser,
        Self::Replayer,
        Self::Modeler,
        Self::Previewer,
        Self::SessionWriter,
        Self::Jobs,
    ];

    /// What its thread is called; Linux shows no more than 15 letters.
    pub fn name(self) -> &'static str {
        match self {
            Self::Dreamer => "dreamer",
            Self::Clipper => "clipper",
            Self::Screener => "screener",
            Self::Synthesizer => "synthesizer",
            Self::Trainer => "trainer",
            Self::Driver => "driver",
            Self::DreamInspector => "dream inspector",
            Self::Recorder => "recorder",
            Self::EpisodeBrowser => "episode browser",
            Self::Replayer => "replayer",
            Self::Modeler => "modeler",
            Self::Previewer => "previewer",
            Self::SessionWriter => "session writer",
            Self::Jobs => "jobs",
        }
    }
}

/// A worker met an error, or has died of a bug.
#[derive(Debug)]
pub struct WorkerFailure {
    /// Which worker.
    pub worker: WorkerName,
    /// What it met.
    pub error: WorkerError,
}

/// What a worker meets.
#[derive(Debug, thiserror::Error)]
pub enum WorkerError {
    /// It has died of a bug; the text is that of the panic.
    #[error("this is a bug of ours: {0}")]
    Panicked(String),
    /// It was told to stop.
    #[error("stopped")]
    Stopped,
    /// It gave up what it was doing, and can be asked to do it again.
    #[error("{0}")]
    GaveUp(Cause),
    /// It lives on.
    #[error("{0}")]
    Met(Cause),
}

/// The cause of an error, as it is said.
pub type Cause = Arc<dyn std::error::Error + Send + Sync>;
