//! Writing all of an open session to another place, where its own is gone, full or read-only.

use std::path::{Component, Path, PathBuf};

use crate::dream::DreamEpisode;
use crate::query::DreamId;
use crate::session::arrays::{dream_to_bytes, write_whole};
use crate::session::clip_hash;
use crate::session::error::SessionError;
use crate::session::event::Event;
use crate::session::header::Header;
use crate::session::merge::relative;
use crate::session::new::NewSession;
use crate::session::store::{DRIVEN_FILE, SessionStore, read_hashed, tidied};
use crate::session::worlds::{self, WORLD_MODEL_FILE};
use crate::tensor::{Parameters, sha256};

/// A session that was written to another place.
#[derive(Debug)]
pub struct SavedAs {
    /// It, open for writing. What could not be written before is in it.
    pub store: SessionStore,
    /// What that was.
    pub written: Vec<Event>,
    /// Files that the log tells of and that were neither in memory nor anywhere on disk.
    pub left_out: Vec<String>,
}

impl SessionStore {
    /// Writes all of the session to `out`, where there must be nothing yet, and what could not be written before.
    ///
    /// Dreams and the latest reward come from memory, where `held` has them; else from the session's folder, under its
    /// name or, as far as the system can follow it, under the one that it was moved to. This session stays as it is.
    pub fn save_as(
        &self,
        out: &Path,
        held: impl Fn(DreamId) -> Option<DreamEpisode>,
        reward: Option<&Parameters>,
    ) -> Result<SavedAs, SessionError> {
        let new = NewSession::at(out)?;
        let header = Header { world_model_path: self.hint_from(out), ..self.header().clone() };
        let mut copy = new.create(header)?;
        let (mut entries, mut left_out) = (Vec::with_capacity(self.entries.len()), Vec::new());
        for entry in &self.entries {
            let mut entry = entry.clone();
            match &mut entry.event {
                Event::DreamKept(kept) => {
                    let in_memory = held(kept.dream).map(|episode| dream_to_bytes(&tidied(&episode)));
                    let is_same = in_memory.as_ref().is_some_and(|bytes| sha256(bytes) == kept.sha256);
                    let on_disk = if is_same { None } else { self.find(&kept.file, &kept.sha256) };
                    match on_disk.or(in_memory) {
                        Some(bytes) => {
                            copy.write(&kept.file, &bytes, "save a dream")?;
                            kept.sha256 = sha256(&bytes);
                        }
                        None => left_out.push(kept.file.clone()),
                    }
                }
                Event::Fitted { file, sha256, .. } => {
                    let in_memory = reward.filter(|reward| reward.hash() == *sha256);
                    let in_memory = in_memory.map(|reward| reward.bytes().to_vec());
                    match in_memory.or_else(|| self.find(file, sha256)) {
                        Some(bytes) => copy.write(file, &bytes, "save a reward")?,
                        None => left_out.push(file.clone()),
                    }
                }
                _ => {}
            }
            entries.push(entry);
        }
        copy.take_over(entries, &left_out)?;
        copy.unsaved.clone_from(&self.unsaved);
        let written = copy.try_again()?;
        for file in [WORLD_MODEL_FILE, clip_hash::FILE, DRIVEN_FILE] {
            if let Some(bytes) = self.places().find_map(|dir| std::fs::read(dir.join(file)).ok()) {
                write_whole(&copy.dir().join(file), &bytes, "copy a file of the session")?;
            }
        }
        Ok(SavedAs { store: new.finish(copy)?, written, left_out })
    }

    /// Where its files may be.
    fn places(&self) -> impl Iterator<Item = PathBuf> {
        [Some(self.dir().to_owned()), self.moved_to()].into_iter().flatten()
    }

    /// The folder itself, whatever it is called by now.
    #[cfg(target_os = "linux")]
    fn moved_to(&self) -> Option<PathBuf> {
        use std::os::fd::AsRawFd as _;
        let folder = self.folder.as_ref()?;
        Some(PathBuf::from(format!("/proc/self/fd/{}", folder.as_raw_fd())))
    }

    #[cfg(not(target_os = "linux"))]
    fn moved_to(&self) -> Option<PathBuf> {
        None
    }

    /// What a file of the session held when it was saved, if it still is anywhere.
    fn find(&self, file: &str, hash: &str) -> Option<Vec<u8>> {
        self.places().find_map(|dir| read_hashed(&dir.join(file), hash).ok())
    }

    /// Where the world model is, from the folder `out`.
    fn hint_from(&self, out: &Path) -> Option<String> {
        let hint = self.header().world_model_path.as_ref()?;
        let named = worlds::find(self.dir(), self.header()).filter(|path| path.starts_with(self.dir()));
        let is_own = named.is_some_and(|path| path.ends_with(WORLD_MODEL_FILE));
        // The folder may be gone, so the way from it is followed by name.
        let path = by_name(&std::path::absolute(self.dir()).ok()?.join(hint));
        if is_own || Path::new(hint).is_absolute() || !path.exists() {
            return Some(hint.clone());
        }
        relative(out, &path).or_else(|| path.to_str().map(str::to_owned))
    }
}

/// `path` without the `..` in it.
fn by_name(path: &Path) -> PathBuf {
    let mut plain = PathBuf::new();
    for component in path.components() {
        if component == Component::ParentDir {
            plain.pop();
        } else {
            plain.push(component);
        }
    }
    plain
}
