//! The folder of a long job: checkpoints that are whole or absent, numbers kept out of memory, and a log of metrics.

use std::fs::{self, File, OpenOptions};
use std::io::{self, ErrorKind, Write as _};
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::tensor::{Parameters, ParametersError};

/// What the name of a file ends in until it is whole.
pub const PARTIAL: &str = "partial";

/// Why a job's folder cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The disk refused.
    #[error("cannot {doing}: {met}: {path:?}")]
    Disk {
        /// What was tried.
        doing: &'static str,
        /// What was met.
        met: io::Error,
        /// Where.
        path: PathBuf,
    },
    /// A note cannot be read.
    #[error("cannot read the job's note: {met}; begin the job anew, without `--resume`: {path:?}")]
    Note {
        /// Why.
        met: serde_json::Error,
        /// Where.
        path: PathBuf,
    },
    /// A checkpoint cannot be read.
    #[error("{met}: {path:?}")]
    Checkpoint {
        /// Why.
        met: ParametersError,
        /// Where.
        path: PathBuf,
    },
}

/// Writes `bytes` so that after a crash the file is as before or as wanted: first beside it, forced to disk, then renamed.
pub fn replace_file(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let partial = path.with_added_extension(PARTIAL);
    let write = || {
        let mut file = File::create(&partial)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        fs::rename(&partial, path)
    };
    write().inspect_err(|_| drop(fs::remove_file(&partial)))?;
    sync_folder(path)
}

/// Tells the log that `what` of this number is in the file at `path`, whatever happens to the program from now on.
///
/// `RUST_LOG=dropj::saved=debug` shows it; `.ci/kill-test` holds the program to it.
pub fn log_saved(what: &str, number: u64, path: &Path) {
    log::debug!(target: "dropj::saved", "saved: {what} {number}: {path:?}");
}

/// Forces the name of `path`, rather than its content, to disk.
pub fn sync_folder(path: &Path) -> io::Result<()> {
    // Elsewhere folders cannot be opened, and need not be.
    match path.parent() {
        Some(folder) if cfg!(unix) && folder != Path::new("") => File::open(folder)?.sync_all(),
        _ => Ok(()),
    }
}

/// Writes a file whole, as [`replace_file`] does, with an error that says what and where.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), RunError> {
    replace_file(path, bytes).map_err(|met| RunError::Disk {
        doing: "write the file",
        met,
        path: path.to_owned(),
    })
}

/// Reads safetensors.
pub fn read_parameters(path: &Path) -> Result<Parameters, RunError> {
    let bytes = fs::read(path).map_err(|met| RunError::Disk {
        doing: "read the parameters",
        met,
        path: path.to_owned(),
    })?;
    Parameters::from_bytes(bytes).map_err(|met| RunError::Checkpoint { met, path: path.to_owned() })
}

/// The folder of one job.
#[derive(Debug)]
pub struct Run {
    dir: PathBuf,
}

impl Run {
    /// The folder at `dir`, made if need be; without `resume` what an earlier job left in it is removed.
    pub fn open(dir: &Path, resume: bool) -> Result<Self, RunError> {
        let failed = |doing| move |met| RunError::Disk { doing, met, path: dir.to_owned() };
        if !resume && dir.exists() {
            fs::remove_dir_all(dir).map_err(failed("clear the folder of the job"))?;
        }
        fs::create_dir_all(dir).map_err(failed("make the folder of the job"))?;
        Ok(Self { dir: dir.to_owned() })
    }

    /// The folder of the job that makes the file `out`: beside it.
    pub fn beside(out: &Path, resume: bool) -> Result<Self, RunError> {
        Self::open(&out.with_extension("fit"), resume)
    }

    /// Writes `what` down under `name`, for people to read too.
    pub fn note(&self, name: &str, what: &impl Serialize) -> Result<(), RunError> {
        let text = serde_json::to_vec_pretty(what).unwrap_or_else(|e| unreachable!("plain data: {e}"));
        write_whole(&self.dir.join(format!("{name}.json")), &text)
    }

    /// What was written down under `name`, if anything.
    pub fn recall<T: DeserializeOwned>(&self, name: &str) -> Result<Option<T>, RunError> {
        let path = self.dir.join(format!("{name}.json"));
        match fs::read(&path) {
            Err(e) if e.kind() == ErrorKind::NotFound => Ok(None),
            Err(met) => Err(RunError::Disk { doing: "read the job's note", met, path }),
            Ok(text) => serde_json::from_slice(&text).map(Some).map_err(|met| RunError::Note { met, path }),
        }
    }

    /// Keeps `parameters` under `name`.
    pub fn save(&self, name: &str, parameters: &Parameters) -> Result<(), RunError> {
        write_whole(&self.dir.join(format!("{name}.safetensors")), parameters.bytes())
    }

    /// What was kept under `name`, if anything.
    pub fn load(&self, name: &str) -> Result<Option<Parameters>, RunError> {
        let path = self.dir.join(format!("{name}.safetensors"));
        if path.exists() { read_parameters(&path).map(Some) } else { Ok(None) }
    }

    /// Appends a line to `metrics.jsonl`.
    pub fn log(&self, metrics: &impl Serialize) -> Result<(), RunError> {
        let path = self.dir.join("metrics.jsonl");
        let mut line = serde_json::to_string(metrics).unwrap_or_else(|e| unreachable!("plain numbers: {e}"));
        line.push('\n');
        let append = || OpenOptions::new().append(true).create(true).open(&path)?.write_all(line.as_bytes());
        append().map_err(|met| RunError::Disk { doing: "log metrics", met, path: path.clone() })
    }
}
