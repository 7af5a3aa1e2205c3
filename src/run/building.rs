//! Folders that are built beside their place and put there whole.

use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};

use super::place::{check_folder, is_partial};
use super::{PARTIAL, RunError, sync_folder};

/// The file that says that a folder is being built by us. Whoever builds it holds its lock.
const MARK: &str = ".dropj-building";

/// Which files a folder can hold while it is being built, by their way from it.
pub type IsOurs = fn(&Path) -> bool;

/// A folder that is being built as `NAME.partial` and put in its place when it is whole.
///
/// Dropped, it is removed. What a killed program left of one is removed by the next that builds the same, if nobody is
/// building it and nothing else lies in it. What is not ours in that place is left alone, and refused.
#[derive(Debug)]
#[must_use]
pub struct Building {
    out: PathBuf,
    partial: PathBuf,
    /// The folders that were made for it, the uppermost last.
    made: Vec<PathBuf>,
    /// Held as long as this lives.
    mark: Option<File>,
}

impl Building {
    /// Begins to build the folder `out`, where there must be nothing yet, or an empty folder.
    ///
    /// `is_ours` says which files can be found in what a killed program left.
    pub fn begin(out: &Path, is_ours: IsOurs) -> Result<Self, RunError> {
        let taken = || RunError::Exists { path: out.to_owned() };
        let Some(name) = out.file_name() else { return Err(taken()) };
        if !is_free(out) {
            return Err(taken());
        }
        let folder = out.parent().unwrap_or(Path::new(""));
        check_folder(folder)?;
        let mut partial = name.to_owned();
        partial.push(format!(".{PARTIAL}"));
        let partial = out.with_file_name(partial);
        if !is_free(&partial) {
            remove_left(&partial, is_ours)?;
        }
        let above = out.ancestors().skip(1).take_while(|it| *it != Path::new("") && !it.exists());
        let made = above.map(Path::to_owned).collect();
        fs::create_dir_all(&partial).map_err(RunError::disk("make the folder", &partial))?;
        let mark_path = partial.join(MARK);
        let mark = File::create_new(&mark_path).map_err(|met| match met.kind() {
            // Somebody else was quicker.
            std::io::ErrorKind::AlreadyExists => RunError::Busy { path: partial.clone() },
            _ => RunError::disk("mark the folder as ours", &mark_path)(met),
        })?;
        mark.try_lock().ok();
        Ok(Self { out: out.to_owned(), partial, made, mark: Some(mark) })
    }

    /// Where it is being built.
    pub fn dir(&self) -> &Path {
        &self.partial
    }

    /// Where it will be.
    pub fn out(&self) -> &Path {
        &self.out
    }

    /// Puts it in its place. Where that fails, it stays where it was built.
    pub fn finish(mut self) -> Result<(), RunError> {
        let put = || {
            // The lock ends with this, and not before the folder is where nobody takes it for one that was left.
            match fs::rename(&self.partial, &self.out) {
                // An empty folder is no obstacle. Some systems want it out of the way.
                Err(_) if is_free(&self.out) => {
                    fs::remove_dir(&self.out).ok();
                    fs::rename(&self.partial, &self.out)?;
                }
                renamed => renamed?,
            }
            sync_folder(&self.out)
        };
        let placed = if is_free(&self.out) {
            put().map_err(RunError::disk("put the folder in its place", &self.out))
        } else {
            Err(RunError::Exists { path: self.out.clone() })
        };
        self.mark = None;
        if let Err(met) = placed {
            return Err(RunError::NotInPlace { met: Box::new(met), path: self.partial.clone() });
        }
        fs::remove_file(self.out.join(MARK)).ok();
        Ok(())
    }
}

impl Drop for Building {
    fn drop(&mut self) {
        if self.mark.take().is_some() {
            fs::remove_dir_all(&self.partial).ok();
            // Those in which there is something by now stay.
            self.made.iter().for_each(|folder| drop(fs::remove_dir(folder)));
        }
    }
}

/// Whether there is nothing at `dir`, or an empty folder.
fn is_free(dir: &Path) -> bool {
    fs::read_dir(dir)
        .map_or_else(|_| fs::symlink_metadata(dir).is_err(), |mut inside| inside.next().is_none())
}

/// Whether `dir` is a folder that is being built, or was when the program was killed.
pub fn is_being_built(dir: &Path) -> bool {
    dir.extension().is_some_and(|end| end == PARTIAL) && dir.join(MARK).exists()
}

/// Removes what a killed program left of a folder that it was building.
fn remove_left(partial: &Path, is_ours: IsOurs) -> Result<(), RunError> {
    let foreign = |path: &Path| RunError::Foreign { found: path.to_owned(), path: partial.to_owned() };
    let mark = File::open(partial.join(MARK)).map_err(|_| foreign(partial))?;
    if matches!(mark.try_lock(), Err(TryLockError::WouldBlock)) {
        return Err(RunError::Busy { path: partial.to_owned() });
    }
    if let Some(found) = first_foreign(partial, partial, is_ours) {
        return Err(foreign(&found));
    }
    log::warn!("removing what a killed program left: {}", partial.display());
    fs::remove_dir_all(partial).map_err(RunError::disk("remove what a killed program left", partial))
}

/// The first file in `dir` or below that is not ours.
fn first_foreign(root: &Path, dir: &Path, is_ours: IsOurs) -> Option<PathBuf> {
    let Ok(inside) = fs::read_dir(dir) else { return Some(dir.to_owned()) };
    inside.flatten().map(|entry| entry.path()).find_map(|path| {
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        let way = path.strip_prefix(root).unwrap_or(&path);
        if fs::symlink_metadata(&path).is_ok_and(|found| found.is_dir()) {
            first_foreign(root, &path, is_ours)
        } else if name == MARK || is_partial(name) || is_ours(way) {
            None
        } else {
            Some(path)
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is_ours(way: &Path) -> bool {
        way == Path::new("inside/it")
    }

    fn begin(dir: &Path) -> Result<Building, RunError> {
        Building::begin(&dir.join("out"), is_ours)
    }

    fn names(dir: &Path) -> Vec<String> {
        let mut names: Vec<_> =
            fs::read_dir(dir).unwrap().map(|it| it.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    fn fill(building: &Building) {
        fs::create_dir(building.dir().join("inside")).unwrap();
        fs::write(building.dir().join("inside/it"), "whole").unwrap();
    }

    #[test]
    fn a_folder_is_there_when_it_is_whole_and_not_before() {
        let dir = tempfile::tempdir().unwrap();
        let building = begin(dir.path()).unwrap();
        fill(&building);
        assert_eq!(names(dir.path()), ["out.partial"]);
        building.finish().unwrap();
        assert_eq!(names(dir.path()), ["out"]);
        assert_eq!(names(&dir.path().join("out")), ["inside"]);
    }

    #[test]
    fn what_is_given_up_leaves_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let building = begin(dir.path()).unwrap();
        fill(&building);
        drop(building);
        drop(begin(&dir.path().join("a/b")).unwrap());
        assert_eq!(names(dir.path()), [""; 0], "the folders above it go as well");
    }

    #[test]
    fn what_a_killed_program_left_is_built_anew() {
        let dir = tempfile::tempdir().unwrap();
        let mut building = begin(dir.path()).unwrap();
        fill(&building);
        // A killed program drops nothing, but its lock ends.
        building.mark = None;
        drop(building);
        assert_eq!(names(dir.path()), ["out.partial"]);
        let building = begin(dir.path()).unwrap();
        assert_eq!(names(building.dir()), [MARK]);
    }

    #[test]
    fn what_another_is_building_and_what_is_not_ours_is_left_alone() {
        let dir = tempfile::tempdir().unwrap();
        let building = begin(dir.path()).unwrap();
        fill(&building);
        assert!(matches!(begin(dir.path()), Err(RunError::Busy { .. })));
        assert!(building.dir().join("inside/it").exists());
        drop(building);

        let partial = dir.path().join("out.partial");
        fs::create_dir(&partial).unwrap();
        fs::write(partial.join("thesis.txt"), "mine").unwrap();
        assert!(matches!(begin(dir.path()), Err(RunError::Foreign { .. })), "it bears no mark");
        fs::write(partial.join(MARK), "").unwrap();
        let refused = begin(dir.path()).unwrap_err().to_string();
        assert!(refused.contains("thesis.txt"), "{refused}");
        assert_eq!(fs::read(partial.join("thesis.txt")).unwrap(), b"mine");
    }

    #[test]
    fn a_place_that_is_taken_is_refused_and_an_empty_folder_is_not() {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir(dir.path().join("out")).unwrap();
        begin(dir.path()).unwrap().finish().unwrap();
        fs::write(dir.path().join("out/mine"), "mine").unwrap();
        assert!(matches!(begin(dir.path()), Err(RunError::Exists { .. })));
        fs::write(dir.path().join("file"), "mine").unwrap();
        assert!(Building::begin(&dir.path().join("file"), is_ours).is_err());
        assert!(Building::begin(&dir.path().join("file/out"), is_ours).is_err());
        assert_eq!(names(dir.path()), ["file", "out"]);
    }
}
