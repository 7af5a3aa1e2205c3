//! Files that only grow, and that must stay what their name says while they are open.
//!
//! A program that holds a file open does not notice when another puts a new one in its place, or moves its folder: what
//! it writes goes to a file that nobody will find. So the name is looked at again with everything that is written.
//!
//! Locks belong to files and not to names. Whoever opens a name after something else was put there locks *that*. The
//! program that had the old file finds at its next write that it no longer has the name, and writes no more. A folder
//! that was moved takes its files and their locks with it: under its new name it cannot be opened for writing as long
//! as the first program lives, which itself refuses to write, for its name is gone. So no name ever has two writers.

use std::fs::{self, File, TryLockError};
use std::io::{self, Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};

use super::place::is_named;

/// Why nothing was appended.
#[derive(Debug, thiserror::Error)]
pub enum AppendError {
    /// The name is another file's by now, or nobody's, or somebody else has written into it.
    #[error("it was replaced, moved or changed by another program while it was open")]
    Replaced,
    /// The disk refused.
    #[error(transparent)]
    Disk(#[from] io::Error),
}

/// A file that is appended to: each time whole, or as if nothing had been tried.
#[derive(Debug)]
pub struct Appender {
    file: File,
    path: PathBuf,
    /// How many bytes are known to be whole.
    len: u64,
    /// Whether something may stand behind them that must go before the next is written.
    is_dirty: bool,
    /// Whether the system can tell that a name is this file's. Some network disks cannot.
    has_identity: bool,
}

impl Appender {
    /// A new file at `path`, where there must be none.
    pub fn create(path: &Path) -> io::Result<Self> {
        let file = File::options().read(true).write(true).create_new(true).open(path)?;
        Ok(Self::new(file, path, 0))
    }

    /// The file at `path`, to go on after whatever it holds.
    pub fn open(path: &Path) -> io::Result<Self> {
        // Not opened in append mode: on Windows such a file cannot be cut.
        let file = File::options().read(true).write(true).open(path)?;
        let len = file.metadata()?.len();
        Ok(Self::new(file, path, len))
    }

    fn new(file: File, path: &Path, len: u64) -> Self {
        let has_identity = is_named(&file, path).unwrap_or(false);
        Self { file, path: path.to_owned(), len, is_dirty: false, has_identity }
    }

    /// Keeps other programs from doing the same, where the system can. The lock ends with the program, however it ends.
    ///
    /// Whether the name still is this file's is looked at after that, so that nobody locks what was just replaced.
    pub fn lock(&self) -> Result<(), TryLockError> {
        self.file.try_lock()?;
        if self.has_identity && !is_named(&self.file, &self.path).map_err(TryLockError::Error)? {
            return Err(TryLockError::WouldBlock);
        }
        Ok(())
    }

    /// All that it holds.
    pub fn read(&mut self) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        self.file.seek(SeekFrom::Start(0))?;
        self.file.read_to_end(&mut bytes)?;
        Ok(bytes)
    }

    /// Cuts off what stands behind the first `len` bytes.
    pub fn cut(&mut self, len: u64) -> io::Result<()> {
        self.is_dirty |= self.len != len;
        self.len = len;
        self.clean()
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How many bytes it has.
    pub fn len(&self) -> u64 {
        self.len
    }

    /// Whether it has none.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Whether its name still is its own, and nobody else has written into it.
    pub fn check(&self) -> Result<(), AppendError> {
        if self.has_identity && !is_named(&self.file, &self.path)? {
            return Err(AppendError::Replaced);
        }
        // Where the system cannot tell files apart, the one of this name has at least to be as long.
        let there = fs::metadata(&self.path).map_err(|met| match met.kind() {
            io::ErrorKind::NotFound => AppendError::Replaced,
            _ => met.into(),
        })?;
        let is_as_left = if self.is_dirty { there.len() >= self.len } else { there.len() == self.len };
        if there.is_file() && !is_as_left { Err(AppendError::Replaced) } else { Ok(()) }
    }

    /// Appends `bytes`: when this returns they are with the system under this name, and on the disk itself where
    /// `is_synced`; after an error the file is as it was.
    pub fn append(&mut self, bytes: &[u8], is_synced: bool) -> Result<(), AppendError> {
        self.check()?;
        self.clean()?;
        let len = self.len;
        let written = self.file.seek(SeekFrom::Start(len)).and_then(|_| self.file.write_all(bytes));
        let written = written.and_then(|()| if is_synced { self.file.sync_data() } else { Ok(()) });
        self.len += bytes.len() as u64;
        // What was replaced meanwhile was written to for nothing. It need not wait for the next time to be said.
        let written = written.map_err(AppendError::from).and_then(|()| self.check());
        written.inspect_err(|_| {
            // Where this fails too, it is tried again before the next time.
            self.is_dirty = true;
            self.len = len;
            self.clean().ok();
        })
    }

    /// Forces all of it to the disk itself.
    pub fn sync(&self) -> io::Result<()> {
        self.file.sync_data()
    }

    fn clean(&mut self) -> io::Result<()> {
        if self.is_dirty {
            self.file.set_len(self.len)?;
            self.file.sync_data()?;
            self.is_dirty = false;
        }
        Ok(())
    }

    /// Removes the file. What has its name by now stays.
    pub fn remove(self) -> io::Result<()> {
        let is_there = !self.has_identity || is_named(&self.file, &self.path)?;
        drop(self.file);
        if is_there { fs::remove_file(&self.path) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn appender(dir: &Path) -> Appender {
        let mut appender = Appender::create(&dir.join("log")).unwrap();
        appender.append(b"one\n", true).unwrap();
        appender
    }

    /// Every way in which a name can stop being the file's.
    #[cfg(unix)]
    #[test]
    fn nothing_is_appended_under_a_name_that_is_gone() {
        type Mishap = fn(&Path);
        let mishaps: [Mishap; 6] = [
            |dir| fs::remove_file(dir.join("log")).unwrap(),
            |dir| fs::rename(dir.join("log"), dir.join("other")).unwrap(),
            |dir| fs::rename(dir, dir.with_extension("moved")).unwrap(),
            |dir| fs::remove_dir_all(dir).unwrap(),
            |dir| {
                fs::write(dir.join("new"), "one\n").unwrap();
                fs::rename(dir.join("new"), dir.join("log")).unwrap();
            },
            |dir| fs::write(dir.join("log"), "one\ntwo\n").unwrap(),
        ];
        for (i, mishap) in mishaps.into_iter().enumerate() {
            let dir = tempfile::tempdir().unwrap();
            let dir = dir.path().join("s");
            fs::create_dir(&dir).unwrap();
            let mut log = appender(&dir);
            mishap(&dir);
            let there = fs::read(dir.join("log")).ok();
            assert!(matches!(log.append(b"two\n", true), Err(AppendError::Replaced)), "mishap {i}");
            assert_eq!(fs::read(dir.join("log")).ok(), there, "mishap {i}: what is there now stays as it is");
        }
    }

    #[test]
    fn what_is_put_back_is_written_on() {
        let dir = tempfile::tempdir().unwrap();
        let mut log = appender(dir.path());
        fs::rename(dir.path().join("log"), dir.path().join("other")).unwrap();
        log.append(b"two\n", true).unwrap_err();
        fs::rename(dir.path().join("other"), dir.path().join("log")).unwrap();
        log.append(b"three\n", true).unwrap();
        assert_eq!(fs::read(dir.path().join("log")).unwrap(), b"one\nthree\n");
    }

    #[cfg(unix)]
    #[test]
    fn a_moved_file_takes_its_lock_with_it_and_a_new_one_has_its_own() {
        let dir = tempfile::tempdir().unwrap();
        let log = appender(dir.path());
        log.lock().unwrap();
        let (path, other) = (dir.path().join("log"), dir.path().join("other"));
        fs::rename(&path, &other).unwrap();
        let second = Appender::open(&other).unwrap();
        assert!(
            matches!(second.lock(), Err(TryLockError::WouldBlock)),
            "under its new name it is still held"
        );
        let mut new = Appender::create(&path).unwrap();
        new.lock().unwrap();
        new.append(b"anew\n", true).unwrap();
        assert!(log.check().is_err(), "and the first writes no more");
    }

    #[cfg(unix)]
    #[test]
    fn removing_leaves_what_has_the_name_by_now() {
        let dir = tempfile::tempdir().unwrap();
        let log = appender(dir.path());
        fs::remove_file(dir.path().join("log")).unwrap();
        fs::write(dir.path().join("log"), "theirs").unwrap();
        log.remove().unwrap();
        assert_eq!(fs::read(dir.path().join("log")).unwrap(), b"theirs");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_is_an_error_and_nothing_is_appended() {
        let mut log = Appender::open(Path::new("/dev/full")).unwrap();
        let refused = log.append(b"one\n", true).unwrap_err();
        assert!(matches!(refused, AppendError::Disk(met) if met.kind() == io::ErrorKind::StorageFull));
        assert_eq!(log.len(), 0);
    }
}
