//! Files that commands write: their place is looked at before the work, and they are put there whole after it.

use std::fs::{self, File};
use std::io::{self, Read as _, Write as _};
use std::path::{Path, PathBuf};

use super::RunError;
use super::place::{check_folder, new_partial};

/// What a file is to hold, so that nothing of another kind is written over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Parameters of networks, as safetensors.
    Network,
    /// A table, with a line of names.
    Table,
    /// A picture, as PNG.
    Picture,
    /// Something drawn, as SVG.
    Drawing,
    /// Pictures one after the other, as GIF.
    Clip,
    /// What is noted for other programs, as JSON.
    Notes,
}

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Self::Network => "a file of network parameters",
            Self::Table => "a table",
            Self::Picture => "a PNG picture",
            Self::Drawing => "an SVG drawing",
            Self::Clip => "a GIF",
            Self::Notes => "a file of JSON",
        }
    }

    /// Whether a file of `len` bytes that begins with `head` can be of this kind. One that is empty can.
    fn admits(self, head: &[u8], len: u64) -> bool {
        let first = head.iter().find(|byte| !byte.is_ascii_whitespace());
        match self {
            _ if len == 0 => true,
            Self::Network => {
                let n_header = head.first_chunk().map(|n| u64::from_le_bytes(*n));
                n_header.is_some_and(|n| n <= len - 8) && head.get(8) == Some(&b'{')
            }
            Self::Picture => head.starts_with(b"\x89PNG"),
            Self::Drawing => head.starts_with(b"<svg") || head.starts_with(b"<?xml"),
            Self::Clip => head.starts_with(b"GIF8"),
            Self::Notes => first == Some(&b'{'),
            Self::Table => {
                let line = head.split(|&byte| byte == b'\n').next().unwrap_or(head);
                let is_text = match str::from_utf8(head) {
                    Ok(_) => true,
                    // Cut in the middle of a letter.
                    Err(met) => met.error_len().is_none(),
                };
                is_text
                    && !head.contains(&0)
                    && !matches!(first, Some(b'{' | b'['))
                    && line.iter().any(|byte| b",;\t".contains(byte))
            }
        }
    }
}

/// A file that will be written: whoever has one has looked at its place.
#[derive(Debug)]
#[must_use]
pub struct OutputFile {
    path: PathBuf,
}

impl OutputFile {
    /// The files `names` to be in the folder `dir`, under the same conditions.
    pub fn all_in(
        dir: &Path,
        names: impl IntoIterator<Item = String>,
        kind: Kind,
    ) -> Result<Vec<Self>, RunError> {
        check_folder(dir)?;
        names.into_iter().map(|name| Self::over(&dir.join(name), kind)).collect()
    }

    /// The file to be at `path`, if it can be written there and nothing of another kind is. Nothing is touched.
    ///
    /// Folders above it that are missing are made when it is written. What is no file but can be written, such as
    /// `/dev/stdout`, is written into.
    pub fn at(path: &Path, kind: Kind) -> Result<Self, RunError> {
        let output = Self::over(path, kind)?;
        let path = target(path);
        if !fs::metadata(&path).is_ok_and(|found| !found.is_file()) {
            check_folder(path.parent().unwrap_or(Path::new("")))?;
        }
        Ok(output)
    }

    /// The same, as far as it depends on what is at `path` already.
    fn over(path: &Path, kind: Kind) -> Result<Self, RunError> {
        let given = path;
        let refused = |why| Err(RunError::Place { why, path: given.to_owned() });
        let ends_in_separator = path
            .as_os_str()
            .as_encoded_bytes()
            .last()
            .is_some_and(|byte| std::path::is_separator((*byte).into()));
        if path.file_name().is_none() || ends_in_separator {
            return refused("a file has to be named, and this names a folder");
        }
        if kind == Kind::Picture && !path.extension().is_some_and(|end| end.eq_ignore_ascii_case("png")) {
            return refused("pictures are written as PNG: choose a name that ends in .png");
        }
        let output = Self { path: path.to_owned() };
        let path = &target(path);
        match fs::metadata(path) {
            Ok(found) if found.is_dir() => return refused("there is a folder of that name; choose another"),
            Ok(found) if !found.is_file() => {}
            Ok(found) if found.permissions().readonly() => {
                return refused("this file is write-protected; choose another name");
            }
            Ok(found) => {
                let head = head(path).map_err(RunError::disk("look at what would be written over", path))?;
                if !kind.admits(&head, found.len()) {
                    return Err(RunError::OtherKind { wanted: kind.name(), path: path.to_owned() });
                }
            }
            // What is wrong above it is said by looking at the folder.
            Err(_) => {}
        }
        Ok(output)
    }

    /// Where it will be.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Puts the file in its place, whole or not at all.
    ///
    /// Where that fails after all, what took long to make is put among the temporary files, and the error says where.
    pub fn write(self, bytes: &[u8]) -> Result<(), RunError> {
        let Err(met) = write_whole(&self.path, bytes) else { return Ok(()) };
        let is_device = fs::metadata(&self.path).is_ok_and(|found| !found.is_file());
        let rescued = self.path.file_name().filter(|_| !is_device).and_then(|name| {
            let name = format!("dropj-{}-{}", std::process::id(), name.to_string_lossy());
            let path = std::env::temp_dir().join(name);
            replace_file(&path, bytes).ok().map(|()| path)
        });
        match rescued {
            Some(path) => Err(RunError::Rescued { met: Box::new(met), path }),
            None => Err(met),
        }
    }
}

/// Writes a file whole, as [`replace_file`] does, with an error that says what and where. Folders above it are made.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), RunError> {
    let write = || {
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder)?;
        }
        if fs::metadata(path).is_ok_and(|found| !found.is_file() && !found.is_dir()) {
            // Renaming would put a file in the place of a device.
            return File::options().write(true).open(path)?.write_all(bytes);
        }
        replace_file(path, bytes)
    };
    write().map_err(RunError::disk("write the file", path))
}

/// Writes `bytes` so that after a crash the file is as before or as wanted: first beside it, forced to disk, then renamed.
///
/// Where `path` is a link, what it leads to is written. What lies beside it for that moment has a name of its own.
pub fn replace_file(path: &Path, bytes: &[u8]) -> io::Result<()> {
    replace(path, bytes, false)
}

/// Writes a file whole that nobody else on this machine is to read, with an error that says what and where.
pub fn write_private(path: &Path, bytes: &[u8]) -> Result<(), RunError> {
    replace(path, bytes, true).map_err(RunError::disk("write the file", path))
}

fn replace(path: &Path, bytes: &[u8], is_private: bool) -> io::Result<()> {
    let path = &target(path);
    let folder = path.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."));
    let (mut file, partial) = new_partial(folder)?;
    let write = || {
        if is_private {
            // Before there is anything in it.
            make_private(&file)?;
        } else if let Ok(before) = fs::metadata(path) {
            file.set_permissions(before.permissions()).ok();
        }
        file.write_all(bytes)?;
        file.sync_all()?;
        drop(file);
        fs::rename(&partial, path)
    };
    write().inspect_err(|_| drop(fs::remove_file(&partial)))?;
    sync_folder(path)
}

#[cfg(unix)]
fn make_private(file: &File) -> io::Result<()> {
    use std::os::unix::fs::PermissionsExt as _;
    file.set_permissions(fs::Permissions::from_mode(0o600))
}

#[cfg(not(unix))]
fn make_private(_: &File) -> io::Result<()> {
    Ok(())
}

/// Forces the name of `path`, rather than its content, to disk.
pub fn sync_folder(path: &Path) -> io::Result<()> {
    // Elsewhere folders cannot be opened, and need not be.
    match path.parent() {
        Some(folder) if cfg!(unix) && folder != Path::new("") => File::open(folder)?.sync_all(),
        Some(_) if cfg!(unix) => File::open(".")?.sync_all(),
        _ => Ok(()),
    }
}

/// What `path` leads to, where it is a link. There need be nothing.
fn target(path: &Path) -> PathBuf {
    /// So many links are followed. More are a circle.
    const MOST: usize = 40;
    let mut path = path.to_owned();
    for _ in 0..MOST {
        let Ok(next) = fs::read_link(&path) else { break };
        path = path.parent().unwrap_or(Path::new("")).join(next);
    }
    path
}

/// The beginning of a file.
fn head(path: &Path) -> io::Result<Vec<u8>> {
    let mut head = Vec::new();
    File::open(path)?.take(4096).read_to_end(&mut head)?;
    Ok(head)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_of_another_kind_is_not_written_over() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("it.png");
        let network = [8_u64.to_le_bytes().as_slice(), b"{}      "].concat();
        let contents: [(&[u8], &[Kind]); 8] = [
            (b"", &[Kind::Network, Kind::Table, Kind::Picture, Kind::Notes]),
            (&network, &[Kind::Network]),
            (b"a,b\n1,2\n", &[Kind::Table]),
            (b"\x89PNG\r\n\x1a\n", &[Kind::Picture]),
            (b" {\"a\": 1, \"b\": 2}", &[Kind::Notes]),
            (b"# My notes\n\nare dear to me, all of them", &[]),
            (b"PAR1,\0\0", &[]),
            (&[255; 9], &[]),
        ];
        for (content, kinds) in contents {
            fs::write(&path, content).unwrap();
            for kind in [Kind::Network, Kind::Table, Kind::Picture, Kind::Notes] {
                let output = OutputFile::at(&path, kind);
                assert_eq!(output.is_ok(), kinds.contains(&kind), "{kind:?} over {content:?}: {output:?}");
                assert_eq!(fs::read(&path).unwrap(), content, "looking changes nothing");
            }
        }
    }

    #[test]
    fn a_place_that_cannot_be_written_is_refused_before_anything_is_made() {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("file"), "mine, all").unwrap();
        fs::create_dir(dir.path().join("folder")).unwrap();
        for (path, why) in [
            ("folder", "there is a folder of that name"),
            ("folder/", "this names a folder"),
            ("..", "this names a folder"),
            ("", "this names a folder"),
            ("file/a/b.csv", "a file in the place of a folder"),
        ] {
            let path = if path.is_empty() { PathBuf::new() } else { dir.path().join(path) };
            let refused = OutputFile::at(&path, Kind::Table).unwrap_err().to_string();
            assert!(refused.contains(why), "{refused}");
        }
        let refused = OutputFile::at(&dir.path().join("it.jpg"), Kind::Picture).unwrap_err().to_string();
        assert!(refused.contains(".png"), "{refused}");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 2);
    }

    #[test]
    fn folders_are_made_when_the_file_is_written_and_not_before() {
        let dir = tempfile::tempdir().unwrap();
        let output = OutputFile::at(&dir.path().join("a/b/c.csv"), Kind::Table).unwrap();
        assert!(!dir.path().join("a").exists());
        output.write(b"a,b\n").unwrap();
        assert_eq!(fs::read(dir.path().join("a/b/c.csv")).unwrap(), b"a,b\n");
        assert_eq!(fs::read_dir(dir.path().join("a/b")).unwrap().count(), 1, "nothing is left beside it");
    }

    #[test]
    fn what_others_call_partial_stays() {
        let dir = tempfile::tempdir().unwrap();
        let (path, theirs) = (dir.path().join("t.csv"), dir.path().join("t.csv.partial"));
        fs::write(&theirs, "mine").unwrap();
        replace_file(&path, b"a,b\n").unwrap();
        assert_eq!(fs::read(&theirs).unwrap(), b"mine");
    }

    #[test]
    fn what_took_long_to_make_is_put_elsewhere_where_its_place_is_gone() {
        let dir = tempfile::tempdir().unwrap();
        let output = OutputFile::at(&dir.path().join("a/t.csv"), Kind::Table).unwrap();
        fs::write(dir.path().join("a"), "in the way").unwrap();
        let refused = output.write(b"a,b\n").unwrap_err();
        let RunError::Rescued { ref path, .. } = refused else { panic!("{refused}") };
        assert_eq!(fs::read(path).unwrap(), b"a,b\n");
        assert!(refused.to_string().contains("a/t.csv"), "{refused}");
        fs::remove_file(path).unwrap();
    }

    #[cfg(unix)]
    #[test]
    fn what_is_private_is_read_by_nobody_else() {
        use std::os::unix::fs::PermissionsExt as _;

        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("keys.toml");
        fs::write(&path, "old").unwrap();
        write_private(&path, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
    }

    #[cfg(unix)]
    #[test]
    fn a_link_stays_a_link_and_a_device_a_device() {
        let dir = tempfile::tempdir().unwrap();
        let (link, file) = (dir.path().join("link.csv"), dir.path().join("file.csv"));
        std::os::unix::fs::symlink("file.csv", &link).unwrap();
        OutputFile::at(&link, Kind::Table).unwrap().write(b"a,b\n").unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read(&file).unwrap(), b"a,b\n");
        OutputFile::at(Path::new("/dev/null"), Kind::Network).unwrap().write(b"nothing").unwrap();
        assert!(!fs::metadata("/dev/null").unwrap().is_file());
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_says_what_to_do() {
        let refused = OutputFile::at(Path::new("/dev/full"), Kind::Table).unwrap().write(b"a,b\n");
        assert_eq!(
            refused.unwrap_err().to_string(),
            "cannot write the file: No space left on device (os error 28); free some space on this disk, or choose \
             another place: \"/dev/full\""
        );
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_read_only_disk_says_what_to_do() {
        // The system's own files are on one, whoever asks.
        let Err(refused) = OutputFile::at(Path::new("/proc/nothing.csv"), Kind::Table) else {
            panic!("/proc takes files");
        };
        assert!(refused.to_string().starts_with("cannot write into this folder: "), "{refused}");
        let read_only = io::Error::from(io::ErrorKind::ReadOnlyFilesystem);
        let told = RunError::disk("write the file", Path::new("t.csv"))(read_only).to_string();
        assert!(told.contains("this disk can only be read: choose another place"), "{told}");
    }
}
