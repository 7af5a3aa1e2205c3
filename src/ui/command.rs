//! What a person can ask of the window: panels push these while drawing, the app carries them out afterwards.

use std::path::PathBuf;

use eframe::egui::{Key, ThemePreference};

use crate::env::controls::ControlConfig;
use crate::query::{DreamId, Justification, Protocol, QueryId, Response, SkipReason, Weights};
use crate::ui::choosing::Asking;
use crate::ui::dialog::Purpose;
use crate::ui::elsewhere::Elsewhere;
use crate::ui::input::PadButton;
use crate::ui::keys::Deed;
use crate::ui::pace::Budget;

/// A place in the window, in the order of the work.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Panel {
    /// Driving the real car to record it.
    Record,
    /// Fitting and choosing a world model.
    World,
    /// Driving in a dream.
    #[default]
    Dream,
    /// Answering queries.
    Label,
    /// Watching the reward learn.
    Reward,
    /// Watching the planner drive.
    Deploy,
}

impl Panel {
    /// All of them, in the order of the work.
    pub const ALL: [Self; 6] =
        [Self::Record, Self::World, Self::Dream, Self::Label, Self::Reward, Self::Deploy];

    /// What it is called.
    pub fn name(self) -> &'static str {
        match self {
            Self::Record => "Record",
            Self::World => "World model",
            Self::Dream => "Dream",
            Self::Label => "Label",
            Self::Reward => "Reward",
            Self::Deploy => "Deploy",
        }
    }
}

/// A field that can be typed into.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Field {
    /// The folder of recordings, to record into and to fit from.
    Dataset,
    /// The file of the world model that is fitted.
    ModelOut,
    /// The file of a world model to load.
    ModelIn,
    /// The seed of the track to record on.
    RecordSeed,
    /// The seed of the track to deploy on.
    DeploySeed,
    /// The folder of a session to open.
    Session,
    /// Who answers.
    Annotator,
    /// Where to save what cannot be saved where it was to be.
    Elsewhere,
    /// Who is to answer the queries that are handed on.
    HandOnTo,
}

/// One thing to do, once the frame is drawn.
#[derive(Clone, Debug, PartialEq)]
pub enum Command {
    /// Goes to a panel.
    Show(Panel),
    /// Puts text into a field.
    Edit(Field, String),
    /// Asks the system's dialog for a field.
    Browse(Field),
    /// Asks the system's dialog for something to take in at once.
    Import(Purpose),
    /// Takes the recordings in a folder for those of this window.
    UseRecordings(PathBuf),
    /// Chooses light, dark or what the system says.
    Theme(ThemePreference),
    /// Opens or closes the list of keys.
    ToggleHelp,
    /// Waits for the key that one of the keys of a deed becomes, or no longer.
    Rebind(Option<(Deed, usize)>),
    /// Makes it this key, if nobody else has it.
    Bind(Key),
    /// Makes it the key that somebody else has, who gets this one's.
    SwapKeys,
    /// Shows the gamepad in the list of keys, or the keys again.
    ShowPad(bool),
    /// Waits for the button of a pad that does this, or no longer.
    RebindPad(Option<Deed>),
    /// Makes it this button; whoever had it gets the one before.
    BindPad(Deed, PadButton),
    /// Gives all keys back what they did at first, and the controls what they gave.
    ResetKeys,
    /// Changes how much keys give, and where a pad begins to.
    Control(ControlConfig),
    /// Asks where to save what cannot be saved where it was to be, or no longer.
    SaveElsewhere(Option<Elsewhere>),
    /// Saves it there.
    SaveIn(PathBuf),
    /// Saves it where it was to be, after all.
    SaveAgain,
    /// Lets go of what could not be saved.
    ForgetUnsaved,
    /// Opens or closes the list of sessions.
    ToggleSessions,
    /// Takes a message away.
    Dismiss(u64),

    /// Starts all workers anew and tells them all that is in the session.
    Restart,
    /// Begins a new session with these questions.
    NewSession(Protocol),
    /// Asks other questions from here on.
    ChangeProtocol(Protocol),
    /// Opens the session in a folder.
    OpenSession(PathBuf),
    /// Keeps the dreams that a killed program left behind.
    RecoverDreams,
    /// Throws them away.
    DiscardUnfinished,

    /// Begins to record an episode.
    StartRecording,
    /// Stops the clock of the recording, or lets it go on.
    PauseRecording,
    /// Ends the recording and keeps it.
    KeepRecording,
    /// Throws the recording away and begins another on the same track.
    RedoRecording,
    /// Throws the recording away.
    LeaveRecording,
    /// Keeps the recordings that a killed program left behind.
    RecoverRecordings,
    /// Throws them away.
    ForgetRecordings,

    /// Fits a world model to the recordings.
    FitWorld {
        /// Whether from the last checkpoint.
        resume: bool,
    },
    /// Stops that; it can be resumed.
    StopFit,
    /// Loads the world model in a file.
    LoadWorld(PathBuf),

    /// Chooses where dreams begin.
    ChooseStart(usize),
    /// Begins a dream.
    StartDream,
    /// Stops the clock of the dream, or lets it go on.
    PauseDream,
    /// One step of a dream that stands.
    StepDream,
    /// Marks the present step as unsafe.
    MarkUnsafe,
    /// Ends the dream and keeps it.
    KeepDream,
    /// Throws the dream away and begins another from the same state.
    RedoDream,
    /// Throws the dream away.
    LeaveDream,
    /// Gives the wheel to the planner, or takes it back: in a dream, or in the real world.
    HandOver,
    /// Dreams beside the real car, or no longer.
    ToggleBeside,
    /// Lets that dream look at the real world after so many steps, or never.
    ResetBeside(Option<usize>),

    /// Looks at the episode that was recorded as this, or at none any longer.
    Watch(Option<String>),
    /// Asks whether it is really to be deleted, or no longer.
    AskToDelete(bool),
    /// Deletes it from the folder.
    DeleteEpisode,
    /// Brings back the episode that was deleted last.
    BringEpisodeBack {
        /// Of this folder.
        dataset: PathBuf,
        /// This one, as long as it is the one that was deleted last.
        recording: String,
    },

    /// Looks at a kept dream again, or no longer.
    Review(Option<DreamId>),
    /// Looks at the dream or episode after this one, or before.
    ReviewNext(i32),
    /// Goes to a step of it.
    Scrub(usize),
    /// Plays it, or stops.
    PlayReview,
    /// Deletes a kept dream; its file stays.
    DeleteDream(DreamId),
    /// Uses it again.
    BringBack(DreamId),

    /// Answers the query that is shown.
    Answer(Response),
    /// Says whether a clip stays safe, in the guided questions.
    GuidedSafe(bool),
    /// Asks one question at a time, or all at once.
    Guide(bool),
    /// Opens or closes the list of answers.
    ToggleAnswers,
    /// Opens or closes what is done with sessions of several annotators.
    ToggleSeveral,
    /// Offers this session, too, for putting together.
    AddToSeveral(PathBuf),
    /// Puts this session together with others, or not.
    ChooseForSeveral(PathBuf, bool),
    /// Puts the chosen sessions together in a new one.
    Merge,
    /// Makes a session of the same queries for whoever is named.
    HandOn,
    /// Compares all who answered about the dreams of this session.
    CompareAnnotators,
    /// Makes trajectories where they are needed, or none and not the one that is being made.
    MakeTrajectories(bool),
    /// Chooses what is asked about.
    Ask(Asking),
    /// Names the justification that the next preference rests on.
    Justify(Justification),
    /// Says why the last query was skipped.
    GiveReason(SkipReason),
    /// Takes back the last answer.
    Undo,
    /// Gives back what was taken back last.
    Redo,
    /// Marks the query that is shown for a second look, or removes the mark.
    Flag,
    /// Answers this query again.
    Revisit(QueryId),
    /// Sets how much is to be labeled.
    Budget(Budget),
    /// Suggests a pause after so many minutes of labeling; 0 is never.
    BreakAfter(u32),
    /// Says nothing of pauses for a while.
    PutOffBreak,
    /// Has thumbnails drawn of these queries.
    Glance(Vec<QueryId>),
    /// Has the reward say what it thinks of the clips of an answered query.
    Foretell(QueryId),
    /// Begins the clips anew.
    RestartClips,
    /// Stops the clips, or lets them go on.
    PauseClips,
    /// Moves the standing clips by so many frames.
    StepClips(i32),
    /// Stops the clips here, in frames.
    ScrubClips(f64),
    /// Makes the clips faster, or slower.
    Faster(bool),

    /// Fits the reward to all answers, to the end.
    FitReward,
    /// Shows other weights while a slider is being moved.
    TryWeights(Weights),
    /// Lets answers weigh so from here on, and learns the reward anew.
    Weigh(Weights),

    /// Lets the planner drive an episode.
    Drive,
    /// Stops its clock, or lets it go on.
    PauseDrive,
    /// Ends the episode.
    StopDrive,
}
