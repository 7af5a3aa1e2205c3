//! Where something can be written, and what to do where it cannot.

use std::fs::{self, File, Metadata};
use std::io::{self, ErrorKind, Write as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use super::{PARTIAL, RunError};

/// What the names of files begin with that are not whole yet.
const PREFIX: &str = ".dropj-";
/// So much is written to see whether a disk is full.
const SAMPLE: [u8; 4096] = [0; 4096];

/// What to do about an error of the system, where there is something to do.
pub fn advice(met: &io::Error) -> Option<&'static str> {
    match met.kind() {
        ErrorKind::StorageFull => Some("free some space on this disk, or choose another place"),
        ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge => {
            Some("your share of this disk is used up: free some of it, or choose another place")
        }
        ErrorKind::ReadOnlyFilesystem => Some("this disk can only be read: choose another place"),
        ErrorKind::PermissionDenied => Some("you may not write here: choose another place"),
        ErrorKind::NotADirectory => Some("there is a file in the place of a folder: choose another place"),
        _ => None,
    }
}

/// An error of the system, with what to do about it.
pub struct Told<'a>(pub &'a io::Error);

impl std::fmt::Display for Told<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match advice(self.0) {
            Some(advice) => write!(f, "{}; {advice}", self.0),
            None => self.0.fmt(f),
        }
    }
}

/// Whether files can be written into the folder `dir`, or into the nearest one above it where it is still to be made.
///
/// A small file is written to find out, and removed again: permissions alone do not tell of a full disk.
pub fn check_folder(dir: &Path) -> Result<(), RunError> {
    let mut there = dir;
    loop {
        let here = if there == Path::new("") { Path::new(".") } else { there };
        match fs::metadata(here) {
            Ok(found) if found.is_dir() => return probe(here),
            Ok(_) => {
                let why = "there is a file in the place of a folder; choose another place";
                return Err(RunError::Place { why, path: here.to_owned() });
            }
            Err(met) if matches!(met.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {
                there = there.parent().unwrap_or(Path::new(""));
            }
            Err(met) => {
                return Err(RunError::Disk { doing: "look at the folder", met, path: here.to_owned() });
            }
        }
    }
}

/// Whether files can be written into the folder `dir`.
fn probe(dir: &Path) -> Result<(), RunError> {
    let (mut file, path) = new_partial(dir).map_err(RunError::disk("write into this folder", dir))?;
    let written = file.write_all(&SAMPLE).and_then(|()| file.sync_data());
    drop(file);
    fs::remove_file(&path).ok();
    written.map_err(RunError::disk("write into this folder", dir))
}

/// A new file in `dir` that nobody else has, under a name that says whose it is.
pub(super) fn new_partial(dir: &Path) -> io::Result<(File, PathBuf)> {
    static NUMBER: AtomicU64 = AtomicU64::new(0);
    loop {
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let path = dir.join(format!("{PREFIX}{}-{number}.{PARTIAL}", std::process::id()));
        match File::options().write(true).create_new(true).open(&path) {
            // Left behind by an earlier program whose number this one has.
            Err(met) if met.kind() == ErrorKind::AlreadyExists => {}
            opened => return opened.map(|file| (file, path)),
        }
    }
}

/// Whether a file of this name is one that a killed program left half written.
pub fn is_partial(name: &str) -> bool {
    let middle = name.strip_prefix(PREFIX).and_then(|rest| rest.strip_suffix(PARTIAL)?.strip_suffix('.'));
    let is_number = |part: &str| !part.is_empty() && part.bytes().all(|byte| byte.is_ascii_digit());
    middle.and_then(|it| it.split_once('-')).is_some_and(|(one, other)| is_number(one) && is_number(other))
}

/// Removes what killed programs left half written in `dir`, which nobody else may be writing into.
pub fn remove_partials(dir: &Path) {
    for entry in fs::read_dir(dir).into_iter().flatten().flatten() {
        if entry.file_name().to_str().is_some_and(is_partial) {
            log::warn!("removing a half-written file: {}", entry.path().display());
            fs::remove_file(entry.path()).ok();
        }
    }
}

/// What tells a file from any other on this machine. The same for all where the system does not say.
#[cfg(unix)]
fn identity(of: &Metadata) -> (u64, u64) {
    use std::os::unix::fs::MetadataExt as _;
    (of.dev(), of.ino())
}

#[cfg(not(unix))]
fn identity(_: &Metadata) -> (u64, u64) {
    (0, 0)
}

/// Whether a file has a name at all. It has none once it is deleted or something is put in its place.
#[cfg(unix)]
fn has_name(of: &Metadata) -> bool {
    use std::os::unix::fs::MetadataExt as _;
    of.nlink() > 0
}

#[cfg(not(unix))]
fn has_name(_: &Metadata) -> bool {
    true
}

/// A file by its name, as it was when it was looked at.
#[derive(Clone, Debug)]
pub struct Named {
    path: PathBuf,
    identity: Option<(u64, u64)>,
}

impl Named {
    /// What is at `path` now.
    pub fn of(path: &Path) -> Self {
        Self { path: path.to_owned(), identity: fs::metadata(path).ok().as_ref().map(identity) }
    }

    /// Whether the same is there still.
    pub fn is_there(&self) -> bool {
        Self::of(&self.path).identity == self.identity
    }
}

/// Whether `path` still is the name of `file`. Where the system cannot tell files apart, whether there is one.
pub fn is_named(file: &File, path: &Path) -> io::Result<bool> {
    let there = match fs::metadata(path) {
        Err(met) if matches!(met.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => return Ok(false),
        there => there?,
    };
    let own = file.metadata()?;
    Ok(has_name(&own) && identity(&own) == identity(&there))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_is_still_to_be_made_is_looked_for_above() {
        let dir = tempfile::tempdir().unwrap();
        check_folder(&dir.path().join("a/b/c")).unwrap();
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0, "nothing is left of the looking");
        let file = dir.path().join("file");
        fs::write(&file, "mine").unwrap();
        let refused = check_folder(&file.join("a/b")).unwrap_err().to_string();
        assert!(refused.contains("a file in the place of a folder"), "{refused}");
        assert_eq!(fs::read(&file).unwrap(), b"mine");
    }

    #[test]
    fn half_written_files_of_others_are_not_ours() {
        let dir = tempfile::tempdir().unwrap();
        let (_, own) = new_partial(dir.path()).unwrap();
        assert!(is_partial(own.file_name().unwrap().to_str().unwrap()));
        for other in
            ["download.partial", ".dropj-a-1.partial", ".dropj-1.partial", ".dropj-1-1", ".dropj--.partial"]
        {
            assert!(!is_partial(other), "{other}");
            fs::write(dir.path().join(other), "mine").unwrap();
        }
        remove_partials(dir.path());
        assert!(!own.exists());
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 5, "those of others stay");
    }
}
