//! Clips of the real world, as the program writes them.

use crate::program::{dropj, shipped};

#[test]
fn an_episode_and_a_dream_beside_it_are_gifs() {
    let dir = tempfile::tempdir().unwrap();
    let example = shipped("sessions/example").display().to_string();
    for (what, name) in [("--deploy", "futures.gif"), ("--beside", "beside.gif")] {
        let line = ["clip", "--session", &example, what, "1", "--steps", "6", "--out", name];
        let ran = dropj(dir.path(), line);
        assert!(ran.succeeded().contains("6 steps"), "it says what it shows: {ran:?}");
        assert!(std::fs::read(dir.path().join(name)).unwrap().starts_with(b"GIF89a"));
    }
    let both = ["clip", "--session", &example, "--deploy", "1", "--query", "1", "--out", "both.gif"];
    dropj(dir.path(), both).refused();
    let nothing = ["clip", "--session", &example, "--out", "nothing.gif"];
    dropj(dir.path(), nothing).refused();
}
