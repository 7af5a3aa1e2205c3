//! Files that are either whole or absent, and where they lie in a dataset.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::DatasetError;
use crate::run::{PARTIAL, replace_file};

/// Files in a chunk folder, as `LeRobot` has it.
pub(super) const FILES_PER_CHUNK: usize = 1000;

/// Where episode `number` is sealed.
pub(super) fn episode_path(dir: &Path, number: usize) -> PathBuf {
    dir.join(format!(
        "data/chunk-{:03}/file-{:03}.parquet",
        number / FILES_PER_CHUNK,
        number % FILES_PER_CHUNK
    ))
}

/// The numbers of the episodes that have a file, in order, and the file of each.
pub(super) fn episode_files(dir: &Path) -> Result<Vec<(usize, PathBuf)>, DatasetError> {
    let mut files = Vec::new();
    for chunk in list(&dir.join("data"))? {
        let Some(chunk_idx) = number_in(&chunk, "chunk-", "") else { continue };
        for file in list(&chunk)? {
            if let Some(file_idx) = number_in(&file, "file-", ".parquet") {
                files.push((chunk_idx * FILES_PER_CHUNK + file_idx, file));
            }
        }
    }
    files.sort();
    Ok(files)
}

/// The number in a name such as `chunk-007`.
fn number_in(path: &Path, before: &str, after: &str) -> Option<usize> {
    path.file_name()?.to_str()?.strip_prefix(before)?.strip_suffix(after)?.parse().ok()
}

/// What a folder holds; nothing where there is no folder.
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

/// Removes what a killed program left half written in `dir` and the folders below it.
pub(super) fn remove_partials(dir: &Path) -> Result<(), DatasetError> {
    for path in list(dir)? {
        if path.is_dir() {
            remove_partials(&path)?;
        } else if path.extension().is_some_and(|extension| extension == PARTIAL) {
            log::warn!("removing a half-written file: {}", path.display());
            fs::remove_file(&path).map_err(DatasetError::disk("remove the file", &path))?;
        }
    }
    Ok(())
}
