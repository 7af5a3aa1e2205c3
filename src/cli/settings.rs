//! The file in which the window's settings are kept, looked after before the window reads it.
//!
//! `eframe` writes it in place, and takes one that it cannot read for none: it would be overwritten half a minute later.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use dropj::run::replace_file;
use dropj::ui::is_settings_file;

/// What the name of the copy ends in that was good at the last start.
const LAST: &str = "last";
/// What the name of one that cannot be read ends in.
const DAMAGED: &str = "damaged";

/// Moves aside a file of settings that cannot be read, brings back those of the last start, and says so.
pub(crate) fn look_after(path: &Path) -> Option<String> {
    let last = path.with_added_extension(LAST);
    let bytes = match fs::read(path) {
        Ok(bytes) => bytes,
        Err(e) if e.kind() == ErrorKind::NotFound => return None,
        Err(e) => {
            return Some(format!(
                "the settings cannot be read, so they are as at first and will not be kept: {e}: {path:?}"
            ));
        }
    };
    if is_settings_file(&bytes) {
        if fs::read(&last).ok().as_ref() != Some(&bytes)
            && let Err(e) = replace_file(&last, &bytes)
        {
            log::warn!("the settings could not be copied: {e}: {last:?}");
        }
        return None;
    }
    let aside = free_name(path);
    if let Err(e) = fs::rename(path, &aside) {
        return Some(format!(
            "the settings are damaged and could not be moved aside, so they will be overwritten: {e}: {path:?}"
        ));
    }
    let good = fs::read(&last).ok().filter(|bytes| is_settings_file(bytes));
    let are = match good.map(|bytes| replace_file(path, &bytes)) {
        Some(Ok(())) => "those of the last start are used",
        _ => "all are as at first",
    };
    Some(format!("the settings could not be read, and {are}; the damaged file is kept: {aside:?}"))
}

/// A name beside `path` that nobody has.
fn free_name(path: &Path) -> PathBuf {
    let first = path.with_added_extension(DAMAGED);
    let numbered = (2..1000).map(|n| path.with_added_extension(format!("{DAMAGED}-{n}")));
    let mut names = std::iter::once(first.clone()).chain(numbered);
    names.find(|name| !name.exists()).unwrap_or(first)
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &[u8] = b"{\n    \"preferences\": \"(theme:Dark)\",\n}";

    #[test]
    fn good_settings_are_copied_and_where_there_are_none_nothing_is_made() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("app.ron");
        assert_eq!(look_after(&path), None);
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
        fs::write(&path, GOOD).unwrap();
        assert_eq!(look_after(&path), None);
        assert_eq!(fs::read(dir.path().join("app.ron.last")).unwrap(), GOOD);
        assert_eq!(fs::read(&path).unwrap(), GOOD);
    }

    #[test]
    fn damaged_settings_are_kept_and_those_of_the_last_start_are_used() {
        for damaged in [&b""[..], &GOOD[..20], b"\xff\xfe\0\0", b"{{{", b"[]"] {
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("app.ron");
            fs::write(&path, damaged).unwrap();
            let said = look_after(&path).unwrap();
            assert!(said.contains("all are as at first") && said.contains("app.ron.damaged"), "{said}");
            assert!(!path.exists(), "the window begins anew");
            assert_eq!(fs::read(dir.path().join("app.ron.damaged")).unwrap(), damaged);

            fs::write(dir.path().join("app.ron.last"), GOOD).unwrap();
            fs::write(&path, damaged).unwrap();
            let said = look_after(&path).unwrap();
            assert!(said.contains("those of the last start are used"), "{said}");
            assert_eq!(fs::read(&path).unwrap(), GOOD);
            assert_eq!(fs::read(dir.path().join("app.ron.damaged-2")).unwrap(), damaged, "both are kept");
            assert_eq!(look_after(&path), None, "it is said once");
        }
    }

    #[test]
    fn what_cannot_be_read_at_all_is_said() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("app.ron");
        fs::create_dir(&path).unwrap();
        let said = look_after(&path).unwrap();
        assert!(said.contains("cannot be read") && path.is_dir(), "{said}");
    }
}
