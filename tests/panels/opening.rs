//! Opening sessions of many dreams while the window goes on.

use super::*;

/// A session of the questions of `protocol` with so many dreams, in a folder of this name.
fn dreamed(dir: &Path, name: &str, protocol: Protocol, n_dreams: usize) {
    let header = Header::new("dummy-road", protocol, 5, &world().parameters.hash(), 1_795_342_500_000);
    let mut store = SessionStore::create(&dir.join(name), header).unwrap();
    for _ in 0..n_dreams {
        store.save_dream(&dream(30), DreamSource::User).unwrap();
    }
}

fn open(harness: &mut Harness<'_, Window>, name: &str) {
    harness.get_by_label("Sessions…").click();
    harness.run_steps(10);
    choose(harness, name);
    harness.run_steps(2);
}

/// Clicks on a session in the list, once it is there; the window has not heard of it yet.
pub(super) fn choose(harness: &mut Harness<'_, Window>, name: &str) {
    wait_for(harness, |harness| harness.query_by_label(name).is_some());
    harness.run_steps(2);
    harness.get_by_label(name).click();
}

/// Puts a pipe here, in the place of a file if there is one.
#[cfg(unix)]
fn pipe(path: &Path) {
    std::fs::remove_file(path).ok();
    let made = std::process::Command::new("mkfifo").arg(path).status().unwrap();
    assert!(made.success(), "no pipe could be made");
}

fn name(harness: &Harness<'_, Window>) -> Option<String> {
    let store = harness.state().app().open()?;
    Some(store.dir().file_name()?.to_string_lossy().into_owned())
}

#[test]
#[cfg(unix)]
fn the_window_goes_on_while_a_session_is_opened_and_another_overtakes_it() {
    let dir = tempfile::tempdir().unwrap();
    dreamed(dir.path(), "long", Protocol::Drope, 5);
    dreamed(dir.path(), "short", Protocol::Drop, 1);
    // A pipe is as slow as a disk can be: nothing comes of it until somebody writes.
    let slow = dir.path().join("long/dreams/0002.safetensors");
    let bytes = std::fs::read(&slow).unwrap();
    pipe(&slow);

    let (mut harness, backstage) = window(dir.path(), None, vec2(1280.0, 800.0), false);
    open(&mut harness, "long");
    wait_for(&mut harness, |harness| {
        harness.query_by_label_contains("session: 2 of 5 dreams read").is_some()
    });
    assert_eq!(name(&harness), None, "it is being read");
    harness.run_steps(3);
    press(&mut harness, Key::Enter);
    harness.get_by_label("One moment: the session is being opened");
    assert!(!backstage.orders().iter().any(|order| matches!(order, WorkerCommand::Dreamer(_))));

    open(&mut harness, "short");
    std::fs::write(&slow, &bytes).unwrap();
    wait_for(&mut harness, |harness| name(harness).is_some());
    assert_eq!(name(&harness).as_deref(), Some("short"), "the last one counts");
    assert_eq!(harness.state().app().state().panel(), Panel::Label);
    harness.run_steps(2);
    assert!(harness.query_by_label_contains("session: ").is_none(), "nothing is being opened any more");

    // What was given up does not stand in the way of itself.
    std::fs::remove_file(&slow).unwrap();
    std::fs::write(&slow, &bytes).unwrap();
    backstage.orders();
    open(&mut harness, "long");
    open(&mut harness, "short");
    open(&mut harness, "long");
    wait_for(&mut harness, |harness| name(harness).as_deref() == Some("long"));
    harness.run_steps(2);
    let is_dream =
        |order: &WorkerCommand| matches!(order, WorkerCommand::Trainer(TrainerCommand::AddDream(..)));
    assert!(backstage.orders().iter().filter(|order| is_dream(order)).count() >= 5, "all are handed on");
}

#[test]
#[cfg(unix)]
fn no_session_stays_open_under_a_world_model_that_it_is_not_of() {
    let dir = tempfile::tempdir().unwrap();
    dreamed(dir.path(), "other", Protocol::Drop, 1);
    let store = session(dir.path(), Protocol::Dropj);
    let (mut harness, _) = window(dir.path(), Some(store), vec2(1280.0, 800.0), false);
    // Nothing comes of a pipe until somebody writes.
    let slow = dir.path().join("slow.safetensors");
    pipe(&slow);
    merge::drop_on(&mut harness, &slow);
    open(&mut harness, "other");
    wait_for(&mut harness, |harness| harness.query_by_label_contains("session: ").is_none());
    assert!(name(&harness).is_some_and(|name| name != "other"), "it waits for the world model");
    std::fs::write(&slow, "another").unwrap();
    wait_for(&mut harness, |harness| {
        harness.query_by_label_contains("dreamed with another world model").is_some()
    });
    assert_eq!(name(&harness), None, "nothing is dreamed into either of them");
}

#[test]
#[cfg(unix)]
fn the_list_of_sessions_fills_in_while_the_window_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    for (secs, name) in ["early", "middle", "late", "broken"].into_iter().enumerate() {
        let at = 1_795_342_500_000 + 1000 * secs as u64;
        let header = Header::new("dummy-road", Protocol::Drope, 5, &world().parameters.hash(), at);
        let mut store = SessionStore::create(&dir.path().join(name), header).unwrap();
        let weights = dropj::query::Weights::paper();
        store.record_at(dropj::session::Event::WeightsChanged { weights }, at).unwrap();
    }
    std::fs::write(dir.path().join("broken/session.json"), "{").unwrap();
    let slow = dir.path().join("middle/session.json");
    let bytes = std::fs::read(&slow).unwrap();
    pipe(&slow);

    let (mut harness, _) = window(dir.path(), None, vec2(1280.0, 800.0), false);
    harness.get_by_label("Sessions…").click();
    wait_for(&mut harness, |harness| harness.query_by_label("late").is_some());
    harness.run_steps(10);
    harness.get_by_label("Looking at the sessions…");
    assert!(harness.query_by_label("early").is_none(), "the latest come first");
    let close = harness.get_by_label("Close").rect();
    harness.get_by_label("late").focus();
    harness.run_steps(2);

    std::fs::write(&slow, &bytes).unwrap();
    wait_for(&mut harness, |harness| harness.query_by_label("Looking at the sessions…").is_none());
    harness.run_steps(10);
    let tops = ["late", "middle", "early", "broken"].map(|name| harness.get_by_label(name).rect().top());
    assert!(tops.is_sorted(), "{tops:?}");
    assert_eq!(harness.get_by_label("Close").rect(), close, "nothing moved away");
    press(&mut harness, Key::Enter);
    wait_for(&mut harness, |harness| name(harness).as_deref() == Some("late"));
}

#[test]
fn a_folder_that_holds_no_session_is_said_to_be_none_and_the_present_one_stays() {
    let dir = tempfile::tempdir().unwrap();
    let store = session(dir.path(), Protocol::Dropj);
    let (mut harness, _) = window(dir.path(), Some(store), vec2(1280.0, 800.0), false);
    let before = name(&harness);
    harness.get_by_label("Sessions…").click();
    harness.run_steps(10);
    // The field names the folder of all sessions.
    harness.get_by_label("Open").click();
    harness.run_steps(2);
    wait_for(&mut harness, |harness| harness.query_by_label_contains("session's header").is_some());
    assert_eq!(name(&harness), before);
    assert!(before.is_some());
}
