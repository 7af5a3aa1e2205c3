//! Starting the program.

use crate::program::{dropj, shipped};

#[test]
fn a_session_that_is_not_there_is_refused_in_one_sentence() {
    let dir = tempfile::tempdir().unwrap();
    let ran = dropj(dir.path(), ["replay", "nowhere"]);
    assert!(ran.refused().contains("nowhere"), "{ran:?}");
}

#[test]
fn what_is_shipped_is_found() {
    assert!(shipped("sessions/example/session.json").exists(), "the example lies beside the sources");
}

#[test]
fn progress_is_plain_lines_where_nobody_watches() {
    let dir = tempfile::tempdir().unwrap();
    let ran = dropj(dir.path(), ["record", "--episodes", "2", "--out", "r"]);
    assert_eq!(ran.succeeded().lines().count(), 1, "{ran:?}");
    assert_eq!(ran.err.lines().filter(|line| line.starts_with("episode ")).count(), 2, "{ran:?}");
    assert!(!ran.err.contains(['\r', '\u{1b}']), "{ran:?}");
}
