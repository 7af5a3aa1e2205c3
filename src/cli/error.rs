//! What the command line refuses by itself, before anything is begun.

use std::io;
use std::path::PathBuf;

/// Why a value, a line or a file of settings is not taken.
#[derive(Debug, thiserror::Error)]
pub(crate) enum CliError {
    /// No whole number, or one out of range.
    #[error("it must be a whole number from {least} to {most}")]
    Count {
        /// The smallest that is taken.
        least: usize,
        /// The largest.
        most: usize,
    },
    /// No number, or one out of range.
    #[error("it must be a number from {least} to {most}")]
    Number {
        /// The smallest that is taken.
        least: f64,
        /// The largest.
        most: f64,
    },
    /// The same in less precision.
    #[error("it must be a number from {least} to {most}")]
    Number32 {
        /// The smallest that is taken.
        least: f32,
        /// The largest.
        most: f32,
    },
    /// No number, or one out of a range whose lower end is not in it.
    #[error("it must be a number above {least} and up to {most}")]
    Above {
        /// What it must be above.
        least: f64,
        /// The largest that is taken.
        most: f64,
    },
    /// No weight.
    #[error("a weight must be above 0.5 and at most 1, and {0:?} is not")]
    Weight(String),
    /// No weight with a name.
    #[error("a weight is written name=number")]
    UnnamedWeight,
    /// A weight with an empty name.
    #[error("a weight is written name=number, and the name is missing")]
    EmptyName,
    /// Nobody's name.
    #[error("a name is needed")]
    Name,
    /// The line is not one of this program's; help that was asked for is one of these, too.
    #[error(transparent)]
    Line(#[from] clap::Error),
    /// A file of settings cannot be read.
    #[error("cannot read the settings: {cause}: {path:?}")]
    RunFile {
        /// What was met.
        cause: io::Error,
        /// Where.
        path: PathBuf,
    },
    /// A file of settings is no TOML, or no table of tables.
    #[error("these settings cannot be understood, for {cause}: {path:?}")]
    NoToml {
        /// What was met.
        cause: String,
        /// Where.
        path: PathBuf,
    },
    /// A file of settings has what nobody knows.
    #[error("there is no {what} {key}; there are {known}: {path:?}")]
    Unknown {
        /// A table or a setting.
        what: &'static str,
        /// Its name.
        key: String,
        /// Those that there are.
        known: String,
        /// The file.
        path: PathBuf,
    },
    /// A file of settings has values that cannot be.
    #[error("in the table {table}: {why}: {path:?}")]
    Settings {
        /// The table.
        table: String,
        /// What is wrong.
        why: String,
        /// The file.
        path: PathBuf,
    },
}
