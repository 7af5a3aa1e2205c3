//! Files written whole, files that only grow, folders built beside their place, and the folder of a long job.
//!
//! What is not ours is never written over and never removed: whose a file or folder is, and whether it can be written at
//! all, is looked at before the work begins.

mod appender;
mod building;
pub mod curves;
mod output;
pub mod place;

use std::collections::BTreeSet;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::tensor::{Parameters, ParametersError};

pub use appender::{AppendError, Appender};
pub use building::{Building, IsOurs, is_being_built};
pub use output::{Kind, OutputFile, replace_file, sync_folder, write_private, write_whole};
use place::Told;
pub use place::{check_folder, remove_partials};

/// The bytes of a file, or nothing where it has more than `most`: no more than these are read.
pub fn read_at_most(path: &Path, most: u64) -> io::Result<Option<Vec<u8>>> {
    let mut bytes = Vec::new();
    File::open(path)?.take(most.saturating_add(1)).read_to_end(&mut bytes)?;
    Ok((bytes.len() as u64 <= most).then_some(bytes))
}

/// What the name of a file or folder ends in until it is whole.
pub const PARTIAL: &str = "partial";

/// Why a file or folder cannot be written, or a job's folder not be used.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The disk refused.
    #[error("cannot {doing}: {}: {path:?}", Told(.met))]
    Disk {
        /// What was tried.
        doing: &'static str,
        /// What was met.
        met: io::Error,
        /// Where.
        path: PathBuf,
    },
    /// Nothing can be written under this name.
    #[error("cannot write here: {why}: {path:?}")]
    Place {
        /// Why, and what to do.
        why: &'static str,
        /// Where.
        path: PathBuf,
    },
    /// Something of another kind would be written over.
    #[error(
        "this is not {wanted} and would be written over; choose another name, or move it away first: {path:?}"
    )]
    OtherKind {
        /// What was to be written.
        wanted: &'static str,
        /// What is there.
        path: PathBuf,
    },
    /// A new folder would lie over something else.
    #[error("there is something already; choose another name: {path:?}")]
    Exists {
        /// Where.
        path: PathBuf,
    },
    /// A folder that is to be used holds what we did not write.
    #[error(
        "there is something that this program did not write ({found:?}); it is left alone: choose another name, or move it away first: {path:?}"
    )]
    Foreign {
        /// What was found.
        found: PathBuf,
        /// The folder.
        path: PathBuf,
    },
    /// Another program of ours is at work there.
    #[error("another program is at work in this folder; wait for it, or choose another name: {path:?}")]
    Busy {
        /// The folder.
        path: PathBuf,
    },
    /// A folder was built but could not be put in its place.
    #[error("what was made is whole, but could not be put in its place ({met}): rename it by hand: {path:?}")]
    NotInPlace {
        /// What was met.
        met: Box<Self>,
        /// Where it is.
        path: PathBuf,
    },
    /// A file could not be put in its place, and is elsewhere.
    #[error("{met}; what was to be written is in {path:?}")]
    Rescued {
        /// What was met.
        met: Box<Self>,
        /// Where it is.
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

/// Tells the log that `what` of this number is in the file at `path`, whatever happens to the program from now on.
///
/// `RUST_LOG=dropj::saved=debug` shows it. `.ci/kill-test` holds the program to it.
pub fn log_saved(what: &str, number: u64, path: &Path) {
    log::debug!(target: "dropj::saved", "saved: {what} {number}: {path:?}");
}

impl RunError {
    /// What to make of an [`io::Error`] met while doing something at `path`.
    fn disk(doing: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |met| Self::Disk { doing, met, path: path.to_owned() }
    }
}

/// Makes the folder `dir`, and those above it, where there is none.
pub fn make_folder(dir: &Path) -> Result<(), RunError> {
    fs::create_dir_all(dir).map_err(RunError::disk("make the folder", dir))
}

/// Waits until no other program of ours holds the file at `path`, which is made where there is none. It is held until what
/// comes is dropped.
///
/// Some network disks know no locks: there two programs may do the same work, each to its end.
pub fn hold(path: &Path) -> Result<File, RunError> {
    if let Some(folder) = path.parent() {
        make_folder(folder)?;
    }
    let file = OpenOptions::new().write(true).create(true).truncate(false).open(path);
    let file = file.map_err(RunError::disk("make the file", path))?;
    if let Err(met) = file.lock() {
        log::warn!("could not lock {}: {met}", path.display());
    }
    Ok(file)
}

/// Removes the file at `path`, which is ours, if it is there.
pub fn remove_file(path: &Path) -> Result<(), RunError> {
    match fs::remove_file(path) {
        Err(met) if met.kind() != ErrorKind::NotFound => {
            Err(RunError::Disk { doing: "remove", met, path: path.to_owned() })
        }
        _ => Ok(()),
    }
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

/// The file in a job's folder that lists what the job wrote, a name a line. Whoever works there holds its lock.
const LIST: &str = ".dropj-job";
/// The file in it that grows by a line of numbers now and then.
const METRICS: &str = "metrics.jsonl";

/// The folder of one job, in which it alone is at work.
///
/// It lists what it writes, so that whoever begins anew removes that and nothing else: a file that somebody else put
/// there stays. A folder that holds something but no list is not ours, and is refused.
#[derive(Debug)]
pub struct Run {
    dir: PathBuf,
    /// What this job and those before it wrote here.
    files: Mutex<BTreeSet<String>>,
    list: Mutex<File>,
}

impl Run {
    /// The folder at `dir`, made if need be. Without `resume` what an earlier job left in it is removed.
    pub fn open(dir: &Path, resume: bool) -> Result<Self, RunError> {
        let foreign = |found: PathBuf| RunError::Foreign { found, path: dir.to_owned() };
        let list_path = dir.join(LIST);
        let mut adopted = BTreeSet::new();
        if !list_path.exists() {
            if fs::symlink_metadata(dir).is_ok_and(|_| !dir.is_dir()) {
                let why = "the job needs a folder of that name; choose another name";
                return Err(RunError::Place { why, path: dir.to_owned() });
            }
            let names = names_in(dir)?;
            if let Some(found) = names.first() {
                // Folders of earlier versions have no list, and can only be gone on with.
                let is_ours = names.iter().any(|name| name == "terms.json");
                if !(resume && is_ours) {
                    return Err(foreign(dir.join(found)));
                }
                adopted.extend(names.into_iter().filter(|name| is_of_earlier(name)));
            }
            check_folder(dir)?;
            fs::create_dir_all(dir).map_err(RunError::disk("make the folder of the job", dir))?;
        }
        let list = OpenOptions::new().read(true).append(true).create(true).open(&list_path);
        let list = list.map_err(RunError::disk("open the list of the job's files", &list_path))?;
        if matches!(list.try_lock(), Err(TryLockError::WouldBlock)) {
            return Err(RunError::Busy { path: dir.to_owned() });
        }
        remove_partials(dir);
        let run = Self { dir: dir.to_owned(), files: Mutex::default(), list: Mutex::new(list) };
        adopted.iter().try_for_each(|name| run.enlist(name))?;
        let listed = fs::read_to_string(&list_path);
        let listed = listed.map_err(RunError::disk("read the list of the job's files", &list_path))?;
        // A name is one of a file in this folder, whatever somebody wrote into the list.
        let is_plain =
            |name: &&str| !name.is_empty() && *name != ".." && !name.contains(std::path::is_separator);
        let mut files: BTreeSet<String> = listed.lines().filter(is_plain).map(str::to_owned).collect();
        if !resume {
            for name in std::mem::take(&mut files) {
                let path = dir.join(&name);
                match fs::remove_file(&path) {
                    Err(met) if met.kind() != ErrorKind::NotFound => {
                        return Err(RunError::disk("clear the folder of the job", &path)(met));
                    }
                    _ => {}
                }
            }
            let list = run.list.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            list.set_len(0).map_err(RunError::disk("clear the list of the job's files", &list_path))?;
        }
        Ok(Self { files: Mutex::new(files), ..run })
    }

    /// The folder of the job that makes the file `out`: beside it, called as the file with `.fit` behind, so that every
    /// file has its own.
    ///
    /// Earlier versions put `.fit` in the place of the ending. A job that they began is gone on with where it is.
    pub fn beside(out: &Path, resume: bool) -> Result<Self, RunError> {
        let (dir, earlier) = (out.with_added_extension("fit"), out.with_extension("fit"));
        let is_of_earlier = resume && !dir.exists() && earlier.join("terms.json").exists();
        Self::open(if is_of_earlier { &earlier } else { &dir }, resume)
    }

    /// Notes that the file `name` is ours, before it is there.
    fn enlist(&self, name: &str) -> Result<(), RunError> {
        let mut files = self.files.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if files.insert(name.to_owned()) {
            let mut list = self.list.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            let path = self.dir.join(LIST);
            list.write_all(format!("{name}\n").as_bytes())
                .map_err(RunError::disk("list the job's files", &path))?;
        }
        Ok(())
    }

    /// Where `name` is, which is ours from now on.
    fn file(&self, name: &str) -> Result<PathBuf, RunError> {
        self.enlist(name)?;
        Ok(self.dir.join(name))
    }

    /// Writes `what` down under `name`, for people to read too.
    pub fn note(&self, name: &str, what: &impl Serialize) -> Result<(), RunError> {
        let text = serde_json::to_vec_pretty(what).unwrap_or_else(|e| unreachable!("plain data: {e}"));
        write_whole(&self.file(&format!("{name}.json"))?, &text)
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
        write_whole(&self.file(&format!("{name}.safetensors"))?, parameters.bytes())
    }

    /// What was kept under `name`, if anything.
    pub fn load(&self, name: &str) -> Result<Option<Parameters>, RunError> {
        let path = self.dir.join(format!("{name}.safetensors"));
        if path.exists() { read_parameters(&path).map(Some) } else { Ok(None) }
    }

    /// Writes the file `name` of the job, which is of its own kind, whole.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<(), RunError> {
        write_whole(&self.file(name)?, bytes)
    }

    /// What the file `name` of the job holds, if there is one.
    pub fn read(&self, name: &str) -> Result<Option<Vec<u8>>, RunError> {
        let path = self.dir.join(name);
        match fs::read(&path) {
            Err(e) if e.kind() == ErrorKind::NotFound => Ok(None),
            read => read.map(Some).map_err(RunError::disk("read the job's file", &path)),
        }
    }

    /// Removes the file `name` of the job, if there is one.
    pub fn remove(&self, name: &str) -> Result<(), RunError> {
        remove_file(&self.dir.join(name))
    }

    /// All lines of `metrics.jsonl` up to the first that cannot be read.
    pub fn logged<T: DeserializeOwned>(&self) -> Result<Vec<T>, RunError> {
        let bytes = self.read(METRICS)?.unwrap_or_default();
        let lines = bytes.split(|byte| *byte == b'\n');
        Ok(lines.map_while(|line| serde_json::from_slice(line).ok()).collect())
    }

    /// Keeps the first `n` lines of `metrics.jsonl` as they are, for a job that goes on from where they were written.
    pub fn keep_logged(&self, n: usize) -> Result<(), RunError> {
        let bytes = self.read(METRICS)?.unwrap_or_default();
        let ends = bytes.iter().enumerate().filter(|(_, byte)| **byte == b'\n').map(|(at, _)| at + 1);
        let len = ends.take(n).last().unwrap_or_default();
        if len < bytes.len() { self.write(METRICS, &bytes[..len]) } else { Ok(()) }
    }

    /// Appends a line to `metrics.jsonl`.
    pub fn log(&self, metrics: &impl Serialize) -> Result<(), RunError> {
        let path = self.file(METRICS)?;
        let mut line = serde_json::to_string(metrics).unwrap_or_else(|e| unreachable!("plain numbers: {e}"));
        line.push('\n');
        let append = || OpenOptions::new().append(true).create(true).open(&path)?.write_all(line.as_bytes());
        append().map_err(|met| RunError::Disk { doing: "log metrics", met, path: path.clone() })
    }

    /// Adds a point to each of the named curves, in an event file of `TensorBoard`.
    pub fn plot(&self, step: u64, points: &[(&str, f32)]) -> Result<(), RunError> {
        let path = self.file(curves::NAME)?;
        curves::append(&path, step, points).map_err(RunError::disk("add to the curves", &path))
    }
}

/// The names of what lies in `dir`, in order. None where there is no such folder.
pub fn names_in(dir: &Path) -> Result<Vec<String>, RunError> {
    let listing = match fs::read_dir(dir) {
        Err(met) if met.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        listing => listing.map_err(RunError::disk("look into the folder of the job", dir))?,
    };
    let mut names: Vec<_> =
        listing.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    Ok(names)
}

/// Whether jobs of earlier versions, which listed nothing, wrote files of this name.
fn is_of_earlier(name: &str) -> bool {
    let is_network = name.strip_suffix(".safetensors").is_some_and(|stem| {
        let is_number = |part: &str| !part.is_empty() && part.bytes().all(|byte| byte.is_ascii_digit());
        matches!(stem, "vae-last" | "vae-best" | "mdn_rnn-last" | "mdn_rnn-best")
            || stem.strip_prefix("latents-").is_some_and(is_number)
    });
    is_network || matches!(name, "terms.json" | "metrics.jsonl")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(dir: &Path) -> Vec<String> {
        names_in(dir).unwrap().into_iter().filter(|name| name != LIST).collect()
    }

    #[test]
    fn whoever_begins_anew_removes_what_jobs_wrote_and_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        let dir = dir.path().join("w.safetensors.fit");
        let run = Run::open(&dir, false).unwrap();
        run.note("terms", &1).unwrap();
        run.log(&2).unwrap();
        drop(run);
        fs::write(dir.join("thesis.txt"), "mine").unwrap();
        fs::create_dir(dir.join("plots")).unwrap();

        let run = Run::open(&dir, true).unwrap();
        assert_eq!(run.recall::<i32>("terms").unwrap(), Some(1));
        run.note("later", &3).unwrap();
        drop(run);
        assert_eq!(names(&dir), ["later.json", "metrics.jsonl", "plots", "terms.json", "thesis.txt"]);

        drop(Run::open(&dir, false).unwrap());
        assert_eq!(names(&dir), ["plots", "thesis.txt"]);
    }

    #[test]
    fn a_folder_of_somebody_else_is_refused_and_left_alone() {
        let dir = tempfile::tempdir().unwrap();
        for name in ["thesis.txt", "terms.json"] {
            let dir = dir.path().join(name);
            fs::create_dir(&dir).unwrap();
            fs::write(dir.join(name), "mine").unwrap();
            assert!(matches!(Run::open(&dir, false), Err(RunError::Foreign { .. })));
            assert_eq!(names_in(&dir).unwrap(), [name], "nothing is added either");
        }
        assert!(matches!(Run::open(&dir.path().join("thesis.txt"), true), Err(RunError::Foreign { .. })));
        fs::write(dir.path().join("file"), "mine").unwrap();
        assert!(matches!(Run::open(&dir.path().join("file"), true), Err(RunError::Place { .. })));
    }

    #[test]
    fn every_file_has_a_folder_of_its_own_and_a_job_of_an_earlier_version_is_gone_on_with() {
        let dir = tempfile::tempdir().unwrap();
        let (one, other) = (dir.path().join("v1.2.safetensors"), dir.path().join("v1.2"));
        let (one, other) = (Run::beside(&one, false).unwrap(), Run::beside(&other, false).unwrap());
        assert_ne!(one.dir, other.dir);

        let earlier = dir.path().join("old.fit");
        fs::create_dir(&earlier).unwrap();
        fs::write(earlier.join("terms.json"), "7").unwrap();
        fs::write(earlier.join("thesis.txt"), "mine").unwrap();
        let out = dir.path().join("old.safetensors");
        let run = Run::beside(&out, true).unwrap();
        assert_eq!(run.recall::<i32>("terms").unwrap(), Some(7));
        drop(run);
        // Begun anew it is in a folder of its own; and where the earlier is begun anew, what is not ours stays.
        assert_eq!(Run::beside(&out, false).unwrap().recall::<i32>("terms").unwrap(), None);
        drop(Run::open(&earlier, false).unwrap());
        assert_eq!(names(&earlier), ["thesis.txt"]);
    }

    #[test]
    fn two_jobs_in_one_folder_are_one_too_many() {
        let dir = tempfile::tempdir().unwrap();
        let run = Run::open(dir.path(), false).unwrap();
        run.note("terms", &1).unwrap();
        assert!(matches!(Run::open(dir.path(), false), Err(RunError::Busy { .. })));
        assert_eq!(run.recall::<i32>("terms").unwrap(), Some(1));
        drop(run);
        Run::open(dir.path(), true).unwrap();
    }

    #[test]
    fn a_list_that_names_files_elsewhere_removes_none_of_them() {
        let dir = tempfile::tempdir().unwrap();
        let (job, theirs) = (dir.path().join("job"), dir.path().join("theirs"));
        fs::write(&theirs, "mine").unwrap();
        drop(Run::open(&job, false).unwrap());
        fs::write(job.join(LIST), format!("../theirs\n..\n{}\n", theirs.display())).unwrap();
        drop(Run::open(&job, false).unwrap());
        assert_eq!(fs::read(&theirs).unwrap(), b"mine");
    }
}
