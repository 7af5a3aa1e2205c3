//! Why a world's file cannot be used.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use crate::text::shown;

/// Why a world's file cannot be used: one sentence with the key, what is wrong, what would be right, and the file.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{fault}: {path:?}")]
pub struct SpecError {
    /// What is wrong.
    pub fault: SpecFault,
    /// The file.
    pub path: PathBuf,
}

/// What is wrong with a world's file.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SpecFault {
    /// It is no TOML, has a key that nobody knows, lacks one, or has a value of another type.
    #[error("line {line} of this world cannot be understood: {what}")]
    Syntax {
        /// Counted from 1.
        line: usize,
        /// What the parser says.
        what: String,
    },
    /// A value that cannot be.
    #[error("{key} is {found}, and must be {wanted}")]
    Value {
        /// The key, with those of the tables that it is in.
        key: String,
        /// Its value.
        found: String,
        /// What it may be.
        wanted: String,
    },
    /// A key is missing that is needed because of another.
    #[error("{key} is missing: {wanted}")]
    Missing {
        /// The key.
        key: String,
        /// Why it is needed.
        wanted: String,
    },
    /// A key is given that another rules out.
    #[error("{key} cannot be given here: {why}")]
    Misplaced {
        /// The key.
        key: String,
        /// What rules it out.
        why: String,
    },
    /// A name is given twice.
    #[error("{key} has {name:?} twice, and each must be given once")]
    Twice {
        /// The list.
        key: String,
        /// The name.
        name: String,
    },
    /// A justification names an event that there is not.
    #[error("{key} names the event {name:?}, which this world does not have; {known}")]
    UnknownEvent {
        /// The key.
        key: String,
        /// The event that is named.
        name: String,
        /// Those that there are, in words.
        known: String,
    },
    /// The probabilities of stages do not make a whole.
    #[error("planner.candidates.stages: the values of `follows` sum to {found}, and must sum to 1")]
    Follows {
        /// Their sum.
        found: f64,
    },
}

impl SpecFault {
    /// That `key` is `found`, in place of something `wanted`.
    pub(super) fn value(key: impl Into<String>, found: impl Display, wanted: impl Into<String>) -> Self {
        Self::Value { key: key.into(), found: found.to_string(), wanted: wanted.into() }
    }

    /// The same of a text, which is shown so that nothing in it is taken for ours.
    pub(super) fn text(key: impl Into<String>, found: &str, wanted: impl Into<String>) -> Self {
        let found = shown(found);
        Self::value(key, if found.starts_with('"') { found } else { format!("\"{found}\"") }, wanted)
    }

    /// That `key` is missing.
    pub(super) fn missing(key: impl Into<String>, wanted: impl Into<String>) -> Self {
        Self::Missing { key: key.into(), wanted: wanted.into() }
    }

    /// That `key` cannot be given.
    pub(super) fn misplaced(key: impl Into<String>, why: impl Into<String>) -> Self {
        Self::Misplaced { key: key.into(), why: why.into() }
    }

    /// What the parser says of `text`.
    pub(super) fn syntax(met: &toml::de::Error, text: &str) -> Self {
        let before = met.span().and_then(|span| text.get(..span.start)).unwrap_or_default();
        let what = met.message().lines().map(str::trim).collect::<Vec<_>>().join(" ").replace('`', "\"");
        Self::Syntax { line: before.matches('\n').count() + 1, what }
    }

    /// The same, met in the file at `path`.
    pub(super) fn at(self, path: &Path) -> SpecError {
        SpecError { fault: self, path: path.to_owned() }
    }
}
