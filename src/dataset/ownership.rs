//! Whose folder it is: nothing is written to, moved or removed in one that is not ours.

use std::fs;
use std::path::Path;

use serde_json::Value;

use super::damage::Unfit;
use super::found::Found;
use super::{DatasetError, disk, index, journal, sealed};

/// What we make in a dataset's folder.
const OURS: [&str; 5] = ["data", "meta", "journal", index::DELETED, disk::DAMAGED];
/// What file managers and file systems leave in folders that are empty to a person.
const DROPPINGS: [&str; 7] =
    [".DS_Store", ".directory", ".gitkeep", ".localized", "Thumbs.db", "desktop.ini", "lost+found"];
/// How deep it is looked for files.
const DEPTH: usize = 8;

/// What `meta/info.json` says.
enum Info {
    /// There is none, or it cannot be read.
    Nothing,
    /// We wrote it.
    Ours,
    /// Another program wrote it, about this.
    Other(String),
}

/// Refuses a folder that is neither ours nor empty, where `found` is what lies among its episodes.
pub(super) fn require(dir: &Path, found: &mut Found) -> Result<(), DatasetError> {
    if dir.as_os_str().is_empty() {
        return Err(DatasetError::Unfit { reason: Unfit::NoFolder, path: dir.to_path_buf() });
    }
    let entries = entries(dir)?;
    if entries.is_empty() {
        return Ok(());
    }
    let foreign = |reason| Err(DatasetError::Foreign { reason, path: dir.to_path_buf() });
    let info = info(dir);
    if let Info::Other(about) = info {
        return foreign(match found.others.first() {
            None if !found.episodes.is_empty() => {
                format!(
                    "{about}, although the episodes are; move its folder `meta` away to have that made anew"
                )
            }
            other => and_why(dir, about, other),
        });
    }
    let is_ours = !found.episodes.is_empty() || matches!(info, Info::Ours) || has_traces(dir, &entries);
    match found.others.first() {
        Some(DatasetError::NotOurs { reason, path }) if !is_ours => {
            foreign(format!("{} is {reason}", relative(dir, path)))
        }
        Some(_) => Err(found.others.swap_remove(0)),
        None if is_ours => Ok(()),
        None => foreign(format!("it holds {} and no recording", named(&entries))),
    }
}

/// Says whose the recordings in a folder are in which none of ours was found.
pub(super) fn describe(dir: &Path, found: &Found) -> Option<String> {
    match (info(dir), found.others.first()) {
        (Info::Other(about), other) => Some(and_why(dir, about, other)),
        (_, Some(DatasetError::NotOurs { reason, path })) => {
            Some(format!("{} is {reason}", relative(dir, path)))
        }
        _ => None,
    }
}

/// What an index says of its dataset, and what a file says of itself.
fn and_why(dir: &Path, about: String, other: Option<&DatasetError>) -> String {
    match other {
        Some(DatasetError::NotOurs { reason, path }) => {
            format!("{about}, and {} is {reason}", relative(dir, path))
        }
        _ => about,
    }
}

/// The names in the folder, without what nobody put there: folders that hold no file, and droppings.
fn entries(dir: &Path) -> Result<Vec<String>, DatasetError> {
    let mut names: Vec<String> = disk::list(dir)?
        .iter()
        .filter(|path| !is_bare(path, DEPTH))
        .filter_map(|path| Some(path.file_name()?.to_string_lossy().into_owned()))
        .filter(|name| !DROPPINGS.contains(&name.as_str()))
        .collect();
    names.sort();
    Ok(names)
}

/// Whether it is a folder without a file in it, however deep.
fn is_bare(path: &Path, depth: usize) -> bool {
    let is_folder = fs::symlink_metadata(path).is_ok_and(|met| met.is_dir());
    let within = || disk::list(path).is_ok_and(|paths| paths.iter().all(|path| is_bare(path, depth - 1)));
    is_folder && depth > 0 && within()
}

/// Whether we have recorded here, though no episode is left of it.
fn has_traces(dir: &Path, entries: &[String]) -> bool {
    let within = |folder: &str| disk::list(&dir.join(folder)).unwrap_or_default();
    if within(index::DELETED).iter().any(|path| sealed::open(path).is_ok()) {
        return true;
    }
    if within("journal").iter().any(|path| journal::is_one(path)) {
        return true;
    }
    // A lock is a weak sign: versions of before put one into any folder that they were told.
    let is_known = |name: &String| OURS.contains(&name.as_str());
    dir.join("journal").join(disk::LOCK).is_file() && entries.iter().all(is_known)
}

fn info(dir: &Path) -> Info {
    const BYTES: u64 = 64 << 20;
    let path = dir.join("meta").join("info.json");
    let text = match fs::metadata(&path) {
        Ok(met) if met.len() <= BYTES => fs::read(&path).unwrap_or_default(),
        _ => return Info::Nothing,
    };
    let Ok(Value::Object(info)) = serde_json::from_slice(&text) else { return Info::Nothing };
    if info.get("dropj").is_some_and(Value::is_object) {
        return Info::Ours;
    }
    let said = |key: &str| {
        info.get(key).and_then(Value::as_str).map(|value| value.chars().take(60).collect::<String>())
    };
    let robot = said("robot_type").map_or_else(String::new, |robot| format!(" of {robot:?}"));
    let version = said("codebase_version").map_or_else(String::new, |version| format!(" {version}"));
    Info::Other(format!("its meta/info.json is not dropj's, but that of a LeRobot dataset{version}{robot}"))
}

/// A path within the folder, as it is told.
fn relative(dir: &Path, path: &Path) -> String {
    path.strip_prefix(dir).unwrap_or(path).display().to_string()
}

/// The first few names of many.
fn named(names: &[String]) -> String {
    const N: usize = 3;
    let first: Vec<String> = names.iter().take(N).map(|name| format!("{name:?}")).collect();
    let more = if names.len() > N { format!(" and {} more", names.len() - N) } else { String::new() };
    first.join(", ") + &more
}
