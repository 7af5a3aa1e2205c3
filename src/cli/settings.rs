//! The file in which the window's settings are kept, looked after before the window reads it.
//!
//! `eframe` writes it in place, and takes one that it cannot read for none: it would be overwritten half a minute later.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use dropj::run::replace_file;
use dropj::ui::SettingsFile;

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
    let instead = match SettingsFile::of(&bytes) {
        SettingsFile::Good => {
            keep_copy(&last, &bytes);
            return None;
        }
        SettingsFile::Mended(mended) => {
            Some((mended, "the size of the window or of what is in it made no sense, and is as at first"))
        }
        SettingsFile::Damaged => {
            let good = fs::read(&last).ok().filter(|bytes| SettingsFile::of(bytes) == SettingsFile::Good);
            good.map(|good| (good, "the settings could not be read, and those of the last start are used"))
        }
    };
    let aside = free_name(path);
    if let Err(e) = fs::rename(path, &aside) {
        return Some(format!(
            "the settings are damaged and could not be moved aside, so they will be overwritten: {e}: {path:?}"
        ));
    }
    let is_done = instead.as_ref().is_some_and(|(bytes, _)| replace_file(path, bytes).is_ok());
    let said = instead.map(|(_, said)| said).filter(|_| is_done);
    let said = said.unwrap_or("the settings could not be read, and all are as at first");
    Some(format!("{said}; the old file is kept: {aside:?}"))
}

/// Keeps the settings, which are good, for the next start.
fn keep_copy(last: &Path, bytes: &[u8]) {
    let is_there = fs::read(last).is_ok_and(|kept| kept == bytes);
    if !is_there && let Err(e) = replace_file(last, bytes) {
        log::warn!("the settings could not be copied: {e}: {last:?}");
    }
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
    fn what_would_end_every_window_is_taken_out() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("app.ron");
        let absurd = b"{\"preferences\":\"(theme:Dark)\",\"egui\":\"(options:(zoom_factor:NaN))\"}";
        fs::write(&path, absurd).unwrap();
        let said = look_after(&path).unwrap();
        assert!(said.contains("made no sense") && said.contains("app.ron.damaged"), "{said}");
        let mended = String::from_utf8(fs::read(&path).unwrap()).unwrap();
        assert!(mended.contains("theme:Dark") && !mended.contains("NaN"), "{mended}");
        assert_eq!(fs::read(dir.path().join("app.ron.damaged")).unwrap(), absurd);
        assert_eq!(look_after(&path), None, "it is said once");
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
