//! The window where nothing can show it.

use std::os::unix::net::UnixListener;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

/// What the program says that is to open its window on this Wayland display, and on no other.
fn opened_on(display: &str, dir: &Path) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_dropj"))
        .current_dir(dir)
        .env_remove("DISPLAY")
        .env_remove("WAYLAND_SOCKET")
        .env("WAYLAND_DISPLAY", display)
        .env("XDG_RUNTIME_DIR", dir)
        .env("XDG_DATA_HOME", dir)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn a_display_that_nobody_answers_is_said_at_once_where_there_is_no_other() {
    let dir = tempfile::tempdir().unwrap();
    let said = opened_on("wayland-nobody", dir.path());
    assert!(said.contains("WAYLAND_DISPLAY names a display that does not answer"), "{said}");
    // One that takes connections and never says a word would be waited for for ever.
    let _hung = UnixListener::bind(dir.path().join("wayland-hung")).unwrap();
    let since = Instant::now();
    let said = opened_on("wayland-hung", dir.path());
    assert!(said.contains("does not answer") && since.elapsed() < Duration::from_secs(20), "{said}");
}
