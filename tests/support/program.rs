//! The program as a user starts it, and what it said.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// What one run of the program came to.
#[derive(Debug)]
pub(crate) struct Ran {
    /// The exit code; none where a signal ended it.
    pub(crate) code: Option<i32>,
    /// Standard output.
    pub(crate) out: String,
    /// Standard error.
    pub(crate) err: String,
}

impl Ran {
    /// Asserts that the program refused with one clear error: exit code 1, or 2 for the command line itself, and a line that begins with its name, no
    /// panic, no stack of a foreign library, and nothing said twice.
    #[track_caller]
    pub(crate) fn refused(&self) -> &str {
        assert!(matches!(self.code, Some(1 | 2)), "it refuses: {self:?}");
        assert!(!self.err.contains("panicked"), "without a panic: {self:?}");
        assert!(!self.err.contains("libtorch") && !self.err.contains(".cpp"), "in its own words: {self:?}");
        let line = self.err.lines().find(|line| line.starts_with("dropj: "));
        let line = line.unwrap_or_else(|| panic!("it says who refuses: {self:?}"));
        let causes: Vec<_> = line.split(": ").collect();
        for (i, cause) in causes.iter().enumerate() {
            assert!(!causes[..i].contains(cause), "{cause:?} is said twice: {line}");
        }
        line
    }

    /// Asserts that the program did what it was asked.
    #[track_caller]
    pub(crate) fn succeeded(&self) -> &str {
        assert_eq!(self.code, Some(0), "it does what it is asked: {self:?}");
        &self.out
    }
}

/// Runs the program in `dir` with these arguments.
pub(crate) fn dropj<S: AsRef<OsStr>>(dir: &Path, args: impl IntoIterator<Item = S>) -> Ran {
    let output = Command::new(env!("CARGO_BIN_EXE_dropj")).current_dir(dir).args(args).output();
    let Output { status, stdout, stderr } = output.expect("it ends and is read");
    let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
    Ran { code: status.code(), out: text(stdout), err: text(stderr) }
}

/// A file or folder that is shipped with the sources.
pub(crate) fn shipped(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}
