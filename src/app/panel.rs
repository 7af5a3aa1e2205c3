//! Places in the window, and the fields that are typed into there.

use crate::experiment::side_by_side::Part;

/// A place in the window, in the order of the work.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Panel {
    /// Acting in the real world to record it.
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
    /// Watching the planner act.
    Deploy,
    /// Setting runs side by side.
    Evaluate,
}

impl Panel {
    /// All of them, in the order of the work.
    pub const ALL: [Self; 7] =
        [Self::Record, Self::World, Self::Dream, Self::Label, Self::Reward, Self::Deploy, Self::Evaluate];

    /// What it is called.
    pub fn name(self) -> &'static str {
        match self {
            Self::Record => "Record",
            Self::World => "World model",
            Self::Dream => "Dream",
            Self::Label => "Label",
            Self::Reward => "Reward",
            Self::Deploy => "Deploy",
            Self::Evaluate => "Evaluate",
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
    /// The seed of the episode to record.
    RecordSeed,
    /// The seed of the episode to deploy in.
    DeploySeed,
    /// The folder of a session to open.
    Session,
    /// Who answers.
    Annotator,
    /// Where to save what cannot be saved in its place.
    SaveAs,
    /// Who is to answer the queries that are handed on.
    HandOnTo,
    /// The folder or file of results to set beside others.
    ResultsIn,
    /// The folder of tables and figures.
    FiguresOut,
}

/// What a file or folder is chosen for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// To stand in a field.
    Field(Field),
    /// A world model to load.
    World,
    /// The file of a world to open.
    Env,
    /// A folder of recordings to use.
    Recordings,
    /// Sessions to merge with others.
    Merge,
    /// A GIF to write.
    Clip,
    /// A folder of results to set beside others.
    Results,
    /// A file of results.
    ResultsFile,
    /// Where to save what is shown of runs side by side.
    Save(Part),
}
