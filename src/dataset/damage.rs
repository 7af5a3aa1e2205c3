//! What can be wrong with the files of a dataset, and with what is to be written into them.

use std::io;
use std::path::PathBuf;

use image::{ColorType, ImageError};
use parquet::errors::ParquetError;

use crate::world::Size;

/// Why an episode file is damaged.
#[derive(Debug, thiserror::Error)]
pub enum Damage {
    /// It is too large to be one.
    #[error("it has {0} bytes")]
    Bytes(u64),
    /// It is no table, or not the one that was written.
    #[error(transparent)]
    Table(TableError),
    /// A column cannot be read or written.
    #[error(transparent)]
    Column(ParquetError),
    /// Its notes tell of an episode that cannot be.
    #[error(transparent)]
    Limits(OutOfLimits),
    /// The note that tells its checksum is gone.
    #[error("its footer has lost its checksum")]
    Unsigned,
    /// It is an episode without a step.
    #[error("it has no step")]
    NoStep,
    /// A frame cannot be read.
    #[error(transparent)]
    Frame(FrameError),
    /// One frame is larger than another.
    #[error("its frames are of different sizes")]
    Sizes,
    /// The frame after the last action cannot be read.
    #[error("its last frame is not hexadecimal")]
    LastFrame,
    /// Columns are longer or shorter than the episode.
    #[error("{n_steps} steps have columns of {lens:?}")]
    Lengths {
        /// How many steps it has.
        n_steps: usize,
        /// How long the columns are.
        lens: Vec<usize>,
    },
    /// A number is infinite or none.
    #[error("a number in it is not finite")]
    NotFinite,
}

impl From<OutOfLimits> for Damage {
    fn from(met: OutOfLimits) -> Self {
        Self::Limits(met)
    }
}

impl From<FrameError> for Damage {
    fn from(met: FrameError) -> Self {
        Self::Frame(met)
    }
}

impl From<ParquetError> for Damage {
    fn from(met: ParquetError) -> Self {
        Self::Column(met)
    }
}

/// Why a file cannot be read as a table.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// The system refused.
    #[error(transparent)]
    Disk(io::Error),
    /// It ends before a footer can.
    #[error("it is too short")]
    Short,
    /// Its last bytes are no Parquet file's.
    #[error("it does not end as a Parquet file does")]
    Tail,
    /// Its footer is said to be longer than all of it.
    #[error("its footer is longer than the file")]
    Cut,
    /// Its footer is larger than any of ours.
    #[error("its footer has {0} bytes")]
    FooterBytes(usize),
    /// Its footer was changed.
    #[error("its footer does not match its checksum")]
    FooterChecksum,
    /// Its footer is not built as footers are.
    #[error("its footer is no footer")]
    NoFooter,
    /// Its footer or its columns cannot be understood.
    #[error(transparent)]
    Parquet(ParquetError),
    /// What stands before the footer was changed.
    #[error("its content does not match its checksum")]
    Checksum,
    /// Its rows are in several groups, or in none.
    #[error("it has not one group of rows")]
    RowGroups,
    /// It has more rows than an episode can, or another number than its footer says.
    #[error("it says it has {0} rows")]
    Rows(i64),
}

/// Why bytes do not show a frame.
#[derive(Debug, thiserror::Error)]
pub enum FrameError {
    /// They do not begin as a PNG file does.
    #[error("a frame is no PNG")]
    NotPng,
    /// Its height or width is beyond all limits.
    #[error("a frame of {} pixels is empty or too large", shown(*.0))]
    Limits(Size),
    /// It is of another size.
    #[error("a frame has {} pixels, not {}", shown(*.found), shown(*.wanted))]
    Size {
        /// Its size.
        found: Size,
        /// That of the episode.
        wanted: Size,
    },
    /// It has other colors.
    #[error("a frame of {0:?} is not RGB")]
    NotRgb(ColorType),
    /// It cannot be decoded.
    #[error(transparent)]
    Image(ImageError),
}

/// Why an episode that a file tells of cannot be.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum OutOfLimits {
    /// A name is too long, or holds signs that no name has.
    #[error("the name of its {what} has {n_bytes} bytes or odd signs")]
    Name {
        /// Whose name it is.
        what: &'static str,
        /// How long it is.
        n_bytes: usize,
    },
    /// It has too many of something, or too few.
    #[error("it names {found} {what}, and must name {least} to {most}")]
    Listed {
        /// Of what: axes, events or sensors.
        what: &'static str,
        /// How many it has.
        found: usize,
        /// How many it has at least.
        least: usize,
        /// How many at most.
        most: usize,
    },
    /// A name is empty, too long, or holds signs that no name has.
    #[error("one of its {what} is called {name}, which is no name")]
    Called {
        /// Of what: axes, events or sensors.
        what: &'static str,
        /// The name, as it is shown.
        name: String,
    },
    /// Two events would be one column.
    #[error("its events {one:?} and {other:?} would both be the column {column}")]
    SameColumn {
        /// The one.
        one: String,
        /// The other.
        other: String,
        /// The column.
        column: String,
    },
    /// An event would be a column that is there for something else.
    #[error("its event {event:?} would be the column {column}, which tells something else")]
    Taken {
        /// The event.
        event: String,
        /// The column.
        column: String,
    },
    /// Its steps follow each other too fast, or never.
    #[error("it says it has {0} steps a second")]
    Rate(String),
    /// It has too many steps, none, or not as many as rows.
    #[error("it says it has {n_steps} steps, and has {n_rows} rows")]
    Steps {
        /// How many steps it says it has.
        n_steps: usize,
        /// How many rows there are.
        n_rows: i64,
    },
    /// Its frames are too large, or empty.
    #[error("it says its frames have {} pixels", shown(*.0))]
    Size(Size),
    /// All of its frames together are too large.
    #[error("{n_steps} frames of {} pixels are too much for an episode", shown(*.size))]
    Frames {
        /// How many steps it has.
        n_steps: usize,
        /// The size of its frames.
        size: Size,
    },
    /// Its recording has no name that a file can have.
    #[error("it says it was recorded as {0:?}")]
    Recording(String),
    /// The planner drove steps that it does not have, or out of order.
    #[error("it says the planner drove the steps {from} to {to} of {n_steps}")]
    Planned {
        /// The first of these steps.
        from: usize,
        /// The one behind the last.
        to: usize,
        /// How many it has.
        n_steps: usize,
    },
    /// It ended, and did not.
    #[error("it says it was ended from outside, and that it did not end")]
    End,
    /// The statistics of a column are missing.
    #[error("its footer lacks the statistics of {0:?}")]
    NoStatistics(String),
    /// There are statistics of something else.
    #[error("its footer has statistics of {0:?}, which is no column")]
    OtherStatistics(String),
    /// The statistics of a column cannot be.
    #[error("its footer has no sane statistics of {0:?}")]
    OddStatistics(String),
}

/// What a whole file is instead of an episode of ours.
#[derive(Debug, thiserror::Error)]
pub enum Stranger {
    /// Another program wrote it.
    #[error("not recorded by dropj, but written by {0}")]
    Foreign(String),
    /// Another program wrote the columns of an episode of ours anew, without the notes.
    #[error(
        "recorded by dropj, but rewritten by {0}, which left out who drove, how it ended and the last frame"
    )]
    WithoutNotes(String),
    /// Another program wrote an episode of ours anew, with the notes.
    #[error("recorded by dropj, but rewritten by {0}")]
    Rewritten(String),
    /// Its notes are not JSON, or tell something else.
    #[error("one that cannot be understood: {0}")]
    Json(serde_json::Error),
    /// Its notes tell of an episode that cannot be.
    #[error("one that cannot be understood: {0}")]
    Limits(OutOfLimits),
    /// It is of another format.
    #[error("of format {found}, and this version knows those up to {known}")]
    Format {
        /// Its format.
        found: u32,
        /// Ours.
        known: u32,
    },
    /// It lies in two files.
    #[error("the same episode as {0:?}")]
    Twin(PathBuf),
}

/// Why a file was moved aside.
#[derive(Debug, thiserror::Error)]
pub enum Useless {
    /// It is a damaged episode.
    #[error(transparent)]
    Damage(Damage),
    /// It is the same episode as another file.
    #[error("the same episode as {0:?}")]
    Twin(PathBuf),
    /// It lies where the index does, and is not ours.
    #[error("it says what other programs would take for an index")]
    Index,
    /// It is a journal that cannot be read.
    #[error("a journal of an unfinished episode whose beginning is damaged")]
    Journal,
}

/// Why something cannot be recorded.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Unfit {
    /// No folder was given.
    #[error("no folder is named")]
    NoFolder,
    /// It would be an episode that cannot be.
    #[error(transparent)]
    Limits(OutOfLimits),
    /// A number is infinite or none.
    #[error("action and reward {numbers:?} or state {state:?} are not finite")]
    NotFinite {
        /// Those of the action, and the reward.
        numbers: Vec<f32>,
        /// What was measured.
        state: Vec<f32>,
    },
    /// The action has not a number for each axis.
    #[error("an action of {found} numbers for {wanted} axes")]
    Action {
        /// How many numbers it has.
        found: usize,
        /// How many axes there are.
        wanted: usize,
    },
    /// It is not told of each event whether it goes on.
    #[error("{found} of {wanted} events are told")]
    Events {
        /// Of how many it is told.
        found: usize,
        /// How many there are.
        wanted: usize,
    },
    /// There are more or fewer measurements than sensors.
    #[error("{found} measurements of {wanted} sensors")]
    Measurements {
        /// How many measurements there are.
        found: usize,
        /// How many sensors.
        wanted: usize,
    },
    /// The episode is as long as one can be.
    #[error("an episode has at most {0} steps")]
    Steps(usize),
    /// A frame is larger than can be, or empty.
    #[error("a frame of {} pixels is empty or too large", shown(*.0))]
    Size(Size),
}

/// A size as messages tell it.
pub(super) fn shown(size: Size) -> String {
    format!("{} x {}", size.height, size.width)
}
