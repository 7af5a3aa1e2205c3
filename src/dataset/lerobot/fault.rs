//! What can be wrong with a dataset that others made.

use std::io;
use std::path::Path;

use super::super::DatasetError;

/// Why a dataset that others made cannot be read. Each says what is wrong and, where somebody can do something, what.
#[derive(Debug, thiserror::Error)]
pub enum LeRobotFault {
    /// The folder has no `meta/info.json`.
    #[error(
        "this folder holds no LeRobotDataset, for it has no meta/info.json; give the folder that has meta and data in it"
    )]
    NoDataset,
    /// It is of a codebase before 3.0.
    #[error(
        "this dataset is a LeRobotDataset {version}, and those of v3.0 are read. lerobot 0.4 or later converts it, after a \
         copy: {command}"
    )]
    Old {
        /// Its version.
        version: String,
        /// What converts it.
        command: String,
    },
    /// It is of a codebase that is not known yet.
    #[error(
        "this dataset says that its codebase_version is {0}, and those of v3.0 are read; have lerobot write it as v3.0"
    )]
    Version(String),
    /// A recording was not finalized, or no episode was ever saved.
    #[error(
        "this dataset was never finalized: {told}, and there is no list of episodes in meta/episodes. Where the program \
         that recorded it still runs, have it call finalize(); otherwise record again"
    )]
    NotFinalized {
        /// What `info.json` says there is.
        told: String,
    },
    /// A table ends without a footer.
    #[error(
        "this file ends without a footer: the program that recorded it was killed before it called finalize(), or the copy \
         is cut. What it holds cannot be read; copy the dataset again, or record again"
    )]
    Killed,
    /// A file that the dataset needs is not there.
    #[error(
        "this file is missing, and the dataset needs it ({why}); copy the dataset again, with all its files"
    )]
    Missing {
        /// What for.
        why: String,
    },
    /// It has no episode.
    #[error("this dataset has no episode")]
    Empty,
    /// `info.json`, or another file of JSON, cannot be understood.
    #[error("this file cannot be understood: {0}")]
    Json(serde_json::Error),
    /// A file is larger than one of its kind is.
    #[error("this file has {found} bytes, and one of its kind has {most} at the most")]
    TooLarge {
        /// Its bytes.
        found: u64,
        /// The most there can be.
        most: u64,
    },
    /// A key says what cannot be.
    #[error("{key} is {found}, and must be {wanted}")]
    Key {
        /// Which key.
        key: String,
        /// What it says.
        found: String,
        /// What it can say.
        wanted: String,
    },
    /// A path leads out of the dataset.
    #[error("{key} leads to {found:?}, which is not a path within the dataset")]
    Escape {
        /// Which key says so.
        key: String,
        /// Where it leads.
        found: String,
    },
    /// A file is no Parquet file, or its footer is damaged.
    #[error("this file cannot be read as Parquet: {0}; copy it again")]
    Table(String),
    /// A column cannot be read.
    #[error("the column {column:?} cannot be read: {why}")]
    Column {
        /// Which one.
        column: String,
        /// Why.
        why: String,
    },
    /// A table lacks a column.
    #[error("there is no column {column:?} that holds {wanted}")]
    NoColumn {
        /// Which one.
        column: String,
        /// What it is to hold.
        wanted: &'static str,
    },
    /// The list of episodes contradicts itself or the files.
    #[error("the list of episodes cannot be right: {0}")]
    Episodes(String),
    /// An episode's rows cannot be.
    #[error("episode {episode}: {why}")]
    Episode {
        /// Which one.
        episode: i64,
        /// What is wrong with it.
        why: String,
    },
    /// A number of an action is none.
    #[error(
        "episode {episode}, row {row}: {axis:?} of the action is {found}, and must be a number; mend the dataset, or leave \
         the episode out"
    )]
    NotFinite {
        /// Which episode.
        episode: i64,
        /// Which of its rows, from 0.
        row: usize,
        /// Which axis.
        axis: String,
        /// What it is.
        found: f32,
    },
    /// A picture cannot be read.
    #[error("episode {episode}, row {row}: the picture of {camera:?} cannot be read: {why}")]
    Picture {
        /// Which episode.
        episode: i64,
        /// Which of its rows, from 0.
        row: usize,
        /// Whose picture.
        camera: String,
        /// Why.
        why: String,
    },
    /// A video cannot be read.
    #[error("this video cannot be read: {0}")]
    Video(String),
    /// A video needs a program that is not there.
    #[error(
        "this video is {codec}, which the program ffmpeg reads, and it is not installed: install it (apt install ffmpeg, or \
         brew install ffmpeg), or have lerobot encode the videos as AV1"
    )]
    NoFfmpeg {
        /// What it is encoded as.
        codec: String,
    },
    /// There is no such camera, or none at all.
    #[error("{0}")]
    Choice(String),
}

impl LeRobotFault {
    /// The error about the file at `path`.
    pub(super) fn at(self, path: &Path) -> DatasetError {
        DatasetError::LeRobot { fault: Box::new(self), path: path.to_path_buf() }
    }

    /// A key that says what cannot be.
    pub(super) fn key(key: impl Into<String>, found: impl ToString, wanted: impl Into<String>) -> Self {
        let found = crate::text::shown_within(&found.to_string(), 120);
        Self::Key { key: key.into(), found, wanted: wanted.into() }
    }
}

/// What to make of it that the system would not open or read a file that is needed for `why`.
pub(super) fn met(met: io::Error, path: &Path, why: &str) -> DatasetError {
    match met.kind() {
        io::ErrorKind::NotFound => LeRobotFault::Missing { why: why.to_owned() }.at(path),
        _ => DatasetError::disk("read the dataset", path)(met),
    }
}
