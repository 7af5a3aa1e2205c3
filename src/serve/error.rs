//! Why a session cannot be offered.

use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;

use crate::query::Protocol;
use crate::run::RunError;
use crate::session::SessionError;
use crate::text::shown;

/// Why a session cannot be offered.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// A session cannot be read or made.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// A file cannot be written.
    #[error(transparent)]
    Run(#[from] RunError),
    /// There is nobody to offer it to.
    #[error("nobody is named who is to answer: --annotators anna,ben")]
    Nobody,
    /// Two annotators would write into the same session.
    #[error("{} and {} would answer in the same folder: call one otherwise", shown(one), shown(other))]
    SameFolder {
        /// One.
        one: String,
        /// The other.
        other: String,
    },
    /// There is nothing to ask.
    #[error("there is no query of {} to answer in {path:?}: --queries 100 draws some from its dreams", protocol.name())]
    NoQueries {
        /// What is asked now.
        protocol: Protocol,
        /// The session.
        path: PathBuf,
    },
    /// Nothing can be drawn.
    #[error("no query of {} can be drawn in {path:?}: it has no dream that this asks about", protocol.name())]
    NothingToDraw {
        /// What is asked now.
        protocol: Protocol,
        /// The session.
        path: PathBuf,
    },
    /// The file of tokens cannot be used.
    #[error("cannot use the tokens, for {why}: {path:?}")]
    Tokens {
        /// What is wrong.
        why: String,
        /// The file.
        path: PathBuf,
    },
    /// Nobody can listen there.
    #[error("cannot listen at {at}: {met}{}", advice(met))]
    Listen {
        /// Where.
        at: SocketAddr,
        /// What was met.
        met: io::Error,
    },
    /// The system gives no threads, or no chance.
    #[error("cannot begin to serve: {0}")]
    Begin(io::Error),
    /// Waiting for connections failed.
    #[error("cannot wait for connections: {0}")]
    Wait(io::Error),
    /// A clip cannot be drawn.
    #[error("a clip cannot be drawn: {0}")]
    Clip(String),
}

/// What somebody can do about it.
fn advice(met: &io::Error) -> &'static str {
    match met.kind() {
        io::ErrorKind::AddrInUse => "; --port names another, and 0 any that is free: links name it, too",
        io::ErrorKind::AddrNotAvailable => "; --address names one of this machine, or 0.0.0.0 for all",
        _ => "",
    }
}
