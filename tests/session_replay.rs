//! The session that is shipped as an example replays to the state it was recorded in, and its rewards can be learned again.

use std::path::Path;

use dropj::query::Protocol;
use dropj::session::{SessionStore, replay};

#[test]
fn the_example_replays_and_its_rewards_are_learned_again() {
    tch::set_num_threads(1);
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("sessions/example");
    let model = SessionStore::read_world_model(&dir).unwrap();
    let replayed = replay(&dir, &model).unwrap();
    let statistics = replayed.session.statistics();
    assert!(
        statistics.n_answered > 0 && statistics.n_skipped > 0,
        "answers and a skip are in it: {statistics:?}"
    );
    let protocols = [Protocol::Drop, Protocol::Drope, Protocol::Dropj];
    assert_eq!(replayed.session.protocols(), protocols, "all that can be simulated are answered in it");
    let log = std::fs::read_to_string(dir.join("events.jsonl")).unwrap();
    assert!(log.contains(r#"{"event":"retracted""#), "an undo is in it");
    let then = replayed.recorded_clips().unwrap().expect("what its clips look like is recorded");
    let changed = replayed.changed_clips(&then);
    assert!(
        then.len() >= 100 && changed.is_empty(),
        "of {} clips these look otherwise: {changed:?}",
        then.len()
    );
    assert!(!replayed.fits.is_empty(), "a fit is in it");
    for fit in &replayed.fits {
        let losses = replayed.refit(&model, fit).unwrap();
        assert!(fit.agrees(&losses), "{:?} when recorded, {losses:?} now", fit.fitted.fit.losses);
    }
}
