//! Files that are either whole or absent, and where they lie in a dataset.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::DatasetError;
use crate::run::{PARTIAL, replace_file, sync_folder};

/// Files in a chunk folder, as `LeRobot` has it.
pub(super) const FILES_PER_CHUNK: usize = 1000;

/// Where what is damaged is moved, out of the sight of programs that read all Parquet files of a dataset.
pub(super) const DAMAGED: &str = "damaged";
/// What the name of a damaged file ends in, there.
const DAMAGED_EXTENSION: &str = "damaged";
/// What the name of a journal ends in.
pub(super) const JOURNAL_EXTENSION: &str = "journal";
/// Who holds this file locked is recording. It lies in `journal`.
pub(super) const LOCK: &str = ".lock";

/// Where episode `number` is sealed.
pub(super) fn episode_path(dir: &Path, number: usize) -> PathBuf {
    dir.join(format!(
        "data/chunk-{:03}/file-{:03}.parquet",
        number / FILES_PER_CHUNK,
        number % FILES_PER_CHUNK
    ))
}

/// All Parquet files that others would take for parts of the dataset: first those in their places, in their order.
pub(super) fn data_files(dir: &Path) -> Result<Vec<PathBuf>, DatasetError> {
    let mut files = Vec::new();
    for chunk in list(&dir.join("data"))?.into_iter().filter(|path| path.is_dir()) {
        for file in list(&chunk)? {
            if file.extension().is_some_and(|extension| extension == "parquet") {
                files.push((place(dir, &file).unwrap_or(usize::MAX), file));
            }
        }
    }
    files.sort();
    Ok(files.into_iter().map(|(_, file)| file).collect())
}

/// The number of the episode whose place a path is.
fn place(dir: &Path, path: &Path) -> Option<usize> {
    let chunk = number_in(path.parent()?, "chunk-", "")?;
    let number = chunk.checked_mul(FILES_PER_CHUNK)?.checked_add(number_in(path, "file-", ".parquet")?)?;
    (episode_path(dir, number) == path).then_some(number)
}

/// The number in a name such as `chunk-007`.
fn number_in(path: &Path, before: &str, after: &str) -> Option<usize> {
    path.file_name()?.to_str()?.strip_prefix(before)?.strip_suffix(after)?.parse().ok()
}

/// Moves a file of the dataset aside, and says where it is now. Nothing that is there is overwritten.
pub(super) fn set_aside(dir: &Path, path: &Path) -> Result<PathBuf, DatasetError> {
    let folder = dir.join(DAMAGED);
    make_folder(&folder)?;
    let within = path.strip_prefix(dir).unwrap_or(path);
    let names: Vec<_> = within.iter().map(|name| name.to_string_lossy()).collect();
    let name = names.join("-");
    let (mut free, mut n) = (folder.join(format!("{name}.{DAMAGED_EXTENSION}")), 0);
    while fs::symlink_metadata(&free).is_ok() {
        n += 1;
        free = folder.join(format!("{name}.{n}.{DAMAGED_EXTENSION}"));
    }
    fs::rename(path, &free).map_err(DatasetError::disk("move the damaged file aside", path))?;
    for moved in [path, &free] {
        sync_folder(moved).map_err(DatasetError::disk("move the damaged file aside", moved))?;
    }
    Ok(free)
}

/// What a folder holds. Nothing where there is no folder.
pub(super) fn list(dir: &Path) -> Result<Vec<PathBuf>, DatasetError> {
    let entries = match fs::read_dir(dir) {
        Ok(entries) => entries,
        Err(met) if met.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(met) => return Err(DatasetError::disk("list the folder", dir)(met)),
    };
    entries
        .map(|entry| Ok(entry?.path()))
        .collect::<io::Result<_>>()
        .map_err(DatasetError::disk("list the folder", dir))
}

/// Makes a folder and those above it.
pub(super) fn make_folder(dir: &Path) -> Result<(), DatasetError> {
    fs::create_dir_all(dir).map_err(DatasetError::disk("make the folder", dir))
}

/// Writes a file so that after a crash it is as before or as wanted, and never in between.
pub(super) fn replace(path: &Path, bytes: &[u8]) -> Result<(), DatasetError> {
    if let Some(dir) = path.parent() {
        make_folder(dir)?;
    }
    replace_file(path, bytes).map_err(DatasetError::disk("write the file", path))
}

/// Writes a file only where it says something else already.
pub(super) fn replace_if_other(path: &Path, bytes: &[u8]) -> Result<(), DatasetError> {
    if fs::read(path).is_ok_and(|old| old == bytes) {
        return Ok(());
    }
    replace(path, bytes)
}

/// Removes what a killed program of ours left half written in `dir` and the folders below it.
pub(super) fn remove_partials(dir: &Path) -> Result<(), DatasetError> {
    for path in list(dir)? {
        if path.is_dir() {
            remove_partials(&path)?;
        } else if path.extension().is_some_and(|extension| extension == PARTIAL) && is_written_here(&path) {
            log::warn!("removing a half-written file: {}", path.display());
            fs::remove_file(&path).map_err(DatasetError::disk("remove the file", &path))?;
        }
    }
    Ok(())
}

/// Whether a half-written file, without that ending, is named as one that we write.
fn is_written_here(partial: &Path) -> bool {
    let whole = partial.with_extension("");
    let is_named = |names: &[&str]| names.iter().any(|name| whole.ends_with(name));
    number_in(&whole, "file-", ".parquet").is_some()
        || is_named(&["info.json", "stats.json", "tasks.parquet", "renumbering"])
        || whole.extension().is_some_and(|extension| extension == JOURNAL_EXTENSION)
}
