//! Where the networks lie that sessions were made with: the one place that looks for them.
//!
//! A session names its world model by hash, and where it was only as a hint: folders are moved and handed on.

use std::collections::{BTreeSet, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::SystemTime;

use crate::session::header::Header;
use crate::tensor::{Parameters, sha256};
use crate::world_model::ModelIdentity;

/// The copy of a world model in a session's folder.
pub(super) const WORLD_MODEL_FILE: &str = "world_model.safetensors";
/// What the files of networks end in.
const EXTENSION: &str = "safetensors";
/// No world model is larger than so many bytes. Such a file is not read to see whether it is one.
const MOST: u64 = 1 << 30;
/// In a folder with more files than this none is looked at that is not named.
const MANY: usize = 200;

/// A file that is shipped with the program: in `assets` here, beside the program, or where it was built.
///
/// Where there is none, the path at which it should be.
pub fn asset(name: &str) -> PathBuf {
    let paths = shipped_folders().into_iter().map(|folder| folder.join(name));
    let mut paths: Vec<_> = paths.collect();
    let found = paths.iter().position(|path| path.is_file());
    paths.swap_remove(found.unwrap_or(paths.len() - 1))
}

/// A folder that is shipped beside `assets`, or where it should be.
pub(super) fn shipped_beside(name: &Path) -> PathBuf {
    let beside = |assets: PathBuf| assets.parent().map_or_else(PathBuf::new, Path::to_owned).join(name);
    let mut paths: Vec<_> = shipped_folders().into_iter().map(beside).collect();
    let found = paths.iter().position(|path| path.is_dir());
    paths.swap_remove(found.unwrap_or(paths.len() - 1))
}

/// The folders in which networks are shipped, the likeliest first.
fn shipped_folders() -> Vec<PathBuf> {
    let beside = std::env::current_exe().ok().and_then(|program| Some(program.parent()?.join("assets")));
    let built = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets");
    [Some(PathBuf::from("assets")), beside, Some(built)].into_iter().flatten().collect()
}

/// The file with the world model of the session in `dir`, whose head this is.
///
/// Looked for by its hash in the session's folder, where the head says that it was, beside it, among its neighbors and
/// among those that are shipped. Files are read for that, once each: not for a thread that draws.
pub fn find(dir: &Path, header: &Header) -> Option<PathBuf> {
    let mut met = BTreeSet::new();
    let is_new = |path: &PathBuf| path.is_file() && met.insert(path.canonicalize().unwrap_or(path.clone()));
    candidates(dir, header).filter(is_new).find(|path| is_of(path, &header.world_model))
}

/// The files that may hold it, the likeliest first. Each folder is listed only when it is reached.
fn candidates<'a>(dir: &'a Path, header: &'a Header) -> impl Iterator<Item = PathBuf> + use<'a> {
    let hint = header.world_model_path.as_deref().map(Path::new);
    let hinted = hint.map(|hint| dir.join(hint));
    // A hint from another machine: its last name may be known here.
    let named = hint.and_then(Path::file_name).map(PathBuf::from);
    let shipped_by_name = named
        .clone()
        .into_iter()
        .flat_map(|name| shipped_folders().into_iter().map(move |folder| folder.join(&name)));
    let absolute = std::path::absolute(dir).unwrap_or_else(|_| dir.to_owned());
    let parent = absolute.parent().map(Path::to_owned);
    let beside = named.zip(parent.clone()).map(|(name, parent)| parent.join(name));
    let shipped = std::iter::once_with(|| {
        shipped_folders().into_iter().flat_map(|folder| networks(&folder, "world")).collect::<Vec<_>>()
    });
    let own = std::iter::once_with(move || networks(dir, ""));
    let neighbors = std::iter::once_with(move || {
        let Some(parent) = parent else { return Vec::new() };
        let folders = listed(&parent).into_iter().map(|folder| folder.join(WORLD_MODEL_FILE));
        networks(&parent, "").into_iter().chain(folders).collect()
    });
    [Some(dir.join(WORLD_MODEL_FILE)), hinted, beside]
        .into_iter()
        .flatten()
        .chain(shipped_by_name)
        .chain(shipped.flatten())
        .chain(own.flatten())
        .chain(neighbors.flatten())
}

/// The files in `folder` that may hold networks and whose names begin so.
fn networks(folder: &Path, beginning: &str) -> Vec<PathBuf> {
    let is_one = |path: &PathBuf| {
        let name = path.file_name().and_then(|name| name.to_str());
        path.extension().is_some_and(|extension| extension == EXTENSION)
            && name.is_some_and(|name| name.starts_with(beginning))
    };
    listed(folder).into_iter().filter(is_one).collect()
}

/// What lies in `folder`, in the order of names. Nothing where it cannot be listed or is a heap.
fn listed(folder: &Path) -> Vec<PathBuf> {
    let Ok(listing) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut paths: Vec<_> = listing.take(MANY + 1).filter_map(|item| Some(item.ok()?.path())).collect();
    if paths.len() > MANY {
        return Vec::new();
    }
    paths.sort();
    paths
}

/// A file as it was when it was read: its path, its length, and when it was written.
type Version = (PathBuf, u64, Option<SystemTime>);

/// By which hashes a file is known.
#[derive(Clone)]
struct Names {
    /// That of its bytes.
    own: String,
    /// That of the same parameters in the other layout, where it was asked for and the file is a world model.
    other: Option<Option<String>>,
}

/// Whether the file at `path` holds the world model with this hash, in whichever layout.
pub(super) fn is_of(path: &Path, hash: &str) -> bool {
    static KNOWN: Mutex<Option<HashMap<Version, Names>>> = Mutex::new(None);

    let Ok(about) = std::fs::metadata(path) else { return false };
    if !about.is_file() || about.len() > MOST {
        return false;
    }
    let version = (path.canonicalize().unwrap_or(path.to_owned()), about.len(), about.modified().ok());
    let known = || KNOWN.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    let before = known().get_or_insert_default().get(&version).cloned();
    if let Some(Names { own, other }) = &before
        && (own == hash || other.is_some())
    {
        return own == hash || *other == Some(Some(hash.to_owned()));
    }
    let Ok(bytes) = std::fs::read(path) else { return false };
    let own = before.map_or_else(|| sha256(&bytes), |names| names.own);
    // Laying tensors out anew takes longer than hashing, and most files are found by their own name.
    let other = (own != hash).then(|| other_hash(bytes));
    let is_of = own == hash || other == Some(Some(hash.to_owned()));
    known().get_or_insert_default().insert(version, Names { own, other });
    is_of
}

/// The hash of the world model in `bytes` in the other layout, if there is one in them.
fn other_hash(bytes: Vec<u8>) -> Option<String> {
    let identity = ModelIdentity::of(&Parameters::from_bytes(bytes).ok()?).ok()?;
    Some(identity.relaid()?.hash())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::query::Protocol;

    #[test]
    fn a_world_model_is_found_by_what_it_is_wherever_it_lies() {
        let place = tempfile::tempdir().unwrap();
        let session = place.path().join("sessions/s");
        std::fs::create_dir_all(session.join("dreams")).unwrap();
        std::fs::create_dir_all(place.path().join("sessions/other")).unwrap();
        let header = Header::new("car-racing", Protocol::Dropj, 0, &sha256(b"the world"), 0);
        let find = |hint: Option<&str>| {
            find(&session, &Header { world_model_path: hint.map(str::to_owned), ..header.clone() })
        };
        assert_eq!(find(None), None);
        assert_eq!(find(Some("dreams")), None, "a folder is no file");
        for beside in [
            "s/world_model.safetensors",
            "s/mine.safetensors",
            "w.safetensors",
            "other/world_model.safetensors",
        ] {
            let path = place.path().join("sessions").join(beside);
            std::fs::write(&path, "another").unwrap();
            assert_eq!(find(Some("../w.safetensors")), None, "{beside} holds another one");
            std::fs::write(&path, "the world").unwrap();
            assert_eq!(find(None).unwrap().canonicalize().unwrap(), path.canonicalize().unwrap());
            std::fs::remove_file(&path).unwrap();
        }
        std::fs::write(place.path().join("elsewhere"), "the world").unwrap();
        assert!(find(Some("../../elsewhere")).is_some(), "where it is said to be");
        assert!(find(Some("/of/another/machine")).is_none());
    }

    #[test]
    fn a_file_that_was_replaced_is_read_again() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("w");
        std::fs::write(&path, "one").unwrap();
        assert!(is_of(&path, &sha256(b"one")), "it is");
        std::fs::write(&path, "another").unwrap();
        assert!(!is_of(&path, &sha256(b"one")) && is_of(&path, &sha256(b"another")), "it is another");
    }
}
