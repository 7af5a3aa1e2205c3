//! What can go wrong with episodes on disk.

use std::io;
use std::path::{Path, PathBuf};

use super::damage::{Damage, Stranger, Unfit, Useless, shown};
use super::lerobot::LeRobotFault;
use crate::run::AppendError;
use crate::run::place::Told;
use crate::world::Size;

/// Why a dataset could not be read or written.
///
/// Every message is whole: what was tried, what was met, and where.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// The disk is full, the folder may not be written, a file vanished.
    #[error("could not {tried}: {}, at {path:?}", Told(.met))]
    Disk {
        /// What was tried, as an infinitive.
        tried: &'static str,
        /// What the system said.
        met: io::Error,
        /// The file or folder.
        path: PathBuf,
    },
    /// What is written would not be found under the journal's name.
    #[error(
        "the journal was replaced, moved or changed by another program while it was open, and nothing more is written \
         there; save the recording elsewhere, or put the journal back, at {path:?}"
    )]
    Replaced {
        /// The journal, by its name.
        path: PathBuf,
    },
    /// The folder holds no dataset.
    #[error("no recorded episodes at {path:?}")]
    Missing {
        /// The folder that was to be opened.
        path: PathBuf,
    },
    /// The folder is somebody else's.
    #[error(
        "this folder holds no recordings of dropj's, and nothing is written to it ({reason}); choose another folder, or a \
         new one to record into; to learn from what others recorded, name its world, whose file `dropj world new --data` \
         writes: {path:?}"
    )]
    Foreign {
        /// Whose it is, or what it holds.
        reason: String,
        /// The folder.
        path: PathBuf,
    },
    /// Recordings of others are not of the world that they were taken for.
    #[error(
        "an action of these recordings has {found}, and the world {world:?} has {wanted} axes: name the world that was \
         recorded, or write its file with `dropj world new --data`: {path:?}"
    )]
    OtherWorld {
        /// How many numbers an action has.
        found: String,
        /// How many axes there are.
        wanted: String,
        /// The world's name.
        world: String,
        /// The folder.
        path: PathBuf,
    },
    /// An episode file is whole, and not as we would have written it.
    #[error("this file cannot be among the episodes: it is {reason}; move it out of the dataset: {path:?}")]
    NotOurs {
        /// What it is instead.
        reason: Stranger,
        /// The file.
        path: PathBuf,
    },
    /// Two episodes cannot be in one dataset.
    #[error(
        "two episodes do not belong into one dataset: one {one}, the other {other}; \
         move one of the files out: {path:?} and {other_path:?}"
    )]
    Mixed {
        /// What the one is.
        one: String,
        /// What the other is.
        other: String,
        /// The file of the one.
        path: PathBuf,
        /// The file of the other.
        other_path: PathBuf,
    },
    /// An episode file is torn or altered.
    #[error(
        "this episode file is damaged ({reason}); move it out of the dataset to go on without it: {path:?}"
    )]
    Damaged {
        /// What is wrong with it.
        reason: Damage,
        /// The file.
        path: PathBuf,
    },
    /// A file was damaged, and lies elsewhere now.
    #[error("a file of the dataset is of no use ({reason}) and was moved aside, to {to:?}: {path:?}")]
    SetAside {
        /// What is wrong with it.
        reason: Useless,
        /// Where it was.
        path: PathBuf,
        /// Where it is.
        to: PathBuf,
    },
    /// A journal does not begin as a journal does.
    #[error("this journal of an unfinished episode cannot be read, its beginning is damaged: {path:?}")]
    DamagedJournal {
        /// The file.
        path: PathBuf,
    },
    /// The dataset belongs to another world.
    #[error("episodes of {tried:?} cannot join a dataset of {met:?}, at {path:?}")]
    OtherEnv {
        /// The world asked for.
        tried: String,
        /// The dataset's own.
        met: String,
        /// The dataset.
        path: PathBuf,
    },
    /// A frame is of another size than the frames before it.
    #[error("a frame of {} pixels cannot join frames of {}, at {path:?}", shown(*.tried), shown(*.met))]
    OtherSize {
        /// That of the new frame.
        tried: Size,
        /// That of those before it.
        met: Size,
        /// The dataset or journal.
        path: PathBuf,
    },
    /// An episode lacks columns that those before it have, or has others.
    #[error("an episode with the columns {tried} cannot join episodes with the columns {met}, at {path:?}")]
    OtherColumns {
        /// Its columns.
        tried: String,
        /// Those of the episodes before it.
        met: String,
        /// The dataset.
        path: PathBuf,
    },
    /// An episode is acted in otherwise than those before it.
    #[error("an episode {tried} cannot join episodes {met}, at {path:?}")]
    OtherLayout {
        /// Its axes or its rate.
        tried: String,
        /// Those of the episodes before it.
        met: String,
        /// The dataset.
        path: PathBuf,
    },
    /// What is to be recorded is no step of an episode.
    #[error("this cannot be recorded: {reason}, at {path:?}")]
    Unfit {
        /// Why.
        reason: Unfit,
        /// The dataset or journal.
        path: PathBuf,
    },
    /// Somebody else has the dataset open for recording.
    #[error("another program is recording into the dataset at {path:?}")]
    Busy {
        /// The dataset.
        path: PathBuf,
    },
    /// The dataset was opened for reading only.
    #[error("the dataset was opened for reading, not for recording, at {path:?}")]
    ReadOnly {
        /// The dataset.
        path: PathBuf,
    },
    /// An episode without a step is none.
    #[error("an episode without a step cannot be sealed, at {path:?}")]
    Empty {
        /// Its journal.
        path: PathBuf,
    },
    /// Another program deleted episodes while this one read them.
    #[error("episodes were deleted while these were being read: begin again, with the dataset at {path:?}")]
    Moved {
        /// The dataset.
        path: PathBuf,
    },
    /// The deleted episode cannot be brought back.
    #[error("this episode cannot be brought back: only the one that was deleted last can, at {path:?}")]
    NothingDeleted {
        /// The dataset.
        path: PathBuf,
    },
    /// A dataset that others made cannot be read.
    #[error("{fault}: {path:?}")]
    LeRobot {
        /// Why.
        fault: Box<LeRobotFault>,
        /// The file or folder.
        path: PathBuf,
    },
    /// Sealing failed. Nothing is lost.
    #[error("could not seal the episode, which stays in its journal {path:?}: {met}")]
    NotSealed {
        /// What was met.
        met: Box<Self>,
        /// The journal.
        path: PathBuf,
    },
}

impl DatasetError {
    /// Turns what the system said into an error: `.map_err(DatasetError::disk("write the file", path))`.
    pub(super) fn disk(tried: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |met| Self::Disk { tried, met, path: path.to_path_buf() }
    }

    /// What to make of it that nothing could be appended to the file at `path`.
    pub(super) fn append(tried: &'static str, path: &Path) -> impl FnOnce(AppendError) -> Self {
        move |met| match met {
            AppendError::Replaced => Self::Replaced { path: path.to_path_buf() },
            AppendError::Disk(met) => Self::Disk { tried, met, path: path.to_path_buf() },
        }
    }

    /// An error about a damaged episode file.
    pub(super) fn damaged(reason: impl Into<Damage>, path: &Path) -> Self {
        Self::Damaged { reason: reason.into(), path: path.to_path_buf() }
    }
}
