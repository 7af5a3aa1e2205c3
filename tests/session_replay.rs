//! The sessions that are shipped as examples replay to the state they were recorded in: their clips look as they did, and
//! their rewards can be learned again.

use std::path::Path;

use dropj::query::{Protocol, Response};
use dropj::session::{Replay, SessionStore, replay};

/// Goes through the example called `name` again and compares all that was recorded of it.
fn checked(name: &str) -> Replay {
    tch::set_num_threads(1);
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("sessions").join(name);
    let model = SessionStore::read_world_model(&dir).expect("its world model is shipped");
    let replayed = replay(&dir, &model).expect("it is whole");
    let statistics = replayed.session.statistics();
    assert!(
        statistics.n_answered > 0 && statistics.n_skipped > 0,
        "answers and a skip are in it: {statistics:?}"
    );
    let then =
        replayed.recorded_clips().expect("it can be read").expect("what its clips look like is recorded");
    let changed = replayed.changed_clips(&then);
    assert!(
        then.len() >= 50 && changed.is_empty(),
        "of {} clips these look otherwise: {changed:?}",
        then.len()
    );
    assert!(!replayed.fits.is_empty(), "a fit is in it");
    for fit in &replayed.fits {
        let losses = replayed.refit(&model, fit).expect("what it rests on is there");
        assert!(fit.agrees(&losses), "{:?} when recorded, {losses:?} now", fit.fitted.fit.losses);
    }
    replayed
}

#[test]
fn the_example_replays_and_its_rewards_are_learned_again() {
    let replayed = checked("example");
    let protocols = [Protocol::Drop, Protocol::Drope, Protocol::Dropj];
    assert_eq!(replayed.session.protocols(), protocols, "all that can be simulated are answered in it");
    let log = std::fs::read_to_string(replayed.dir.join("events.jsonl")).unwrap();
    assert!(log.contains(r#"{"event":"retracted""#), "an undo is in it");
}

#[test]
fn the_example_with_obstacles_replays_and_its_rewards_are_learned_again() {
    let replayed = checked("example-obstacles");
    assert_eq!(replayed.session.protocols(), [Protocol::DropjMulti]);
    let asked = replayed.session.queries().iter();
    let mut named: Vec<_> = asked
        .filter_map(|asked| match asked.answer()?.answer.response {
            Response::Justified(active, _) => Some(active.most_severe()),
            _ => None,
        })
        .collect();
    named.sort();
    named.dedup();
    assert!(named.len() >= 2, "more than one justification is named in it: {named:?}");
}
