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
