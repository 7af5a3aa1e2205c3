//! The first hour: three ways to begin, hints where they are needed, scenes before anybody presses, and clips to show.

use std::collections::BTreeMap;

use dropj::session::N_PRACTICED;
use dropj::worker::{JobCommand, JobReport};
use eframe::egui::Modifiers;
use eframe::egui::accesskit::{Action, Role};

use super::keys::Memory;
use super::*;

/// A window of somebody who has never used one.
fn first_window(dir: &Path, size: Vec2, picture: bool, scale: f32) -> (Harness<'static, Window>, Backstage) {
    let nothing: &'static Memory = Box::leak(Box::default());
    window_at(dir, None, size, picture, Some(nothing), scale)
}

fn remembered(harness: &mut Harness<'_, Window>) -> Memory {
    let mut memory = Memory::default();
    eframe::App::save(harness.state_mut(), &mut memory);
    memory
}

fn has(harness: &Harness<'_, Window>, text: &str) -> bool {
    harness.query_by_label_contains(text).is_some()
}

/// A reward that is learned from `n_labels` answers; with a seed, by a full fit.
fn learned(n_labels: usize, seed: Option<u64>) -> Report {
    let fit = seed.map(|seed| (seed, vec![0.5, 0.25, 0.3]));
    Report::Reward(RewardReport::Learned { parameters: world().parameters, n_labels, fit })
}

#[test]
fn a_first_start_offers_three_ways_and_the_first_begins_a_dream() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = first_window(dir.path(), vec2(1280.0, 800.0), false, 1.0);
    for title in ["Drive in a dream now", "Answer twenty questions", "Open a world of my own"] {
        harness.get_by_label(title);
    }
    backstage.orders();
    press(&mut harness, Key::Num1);
    let is_start =
        |order: &WorkerCommand| matches!(order, WorkerCommand::Dreamer(DreamerCommand::Start { .. }));
    assert!(backstage.orders().iter().any(is_start), "it has begun");
    harness.run_steps(2);
    assert!(!has(&harness, "Drive in a dream now"), "the cards are gone");
    harness.get_by_label_contains("Drive well for a while, then badly");
}

#[test]
fn whoever_has_been_here_or_goes_on_with_a_session_is_offered_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = first_window(dir.path(), vec2(1280.0, 800.0), false, 1.0);
    press(&mut harness, Key::Escape);
    harness.get_by_label_contains("Act inside the world model");
    let memory: &'static Memory = Box::leak(Box::new(remembered(&mut harness)));
    drop(harness);
    let (harness, _) = window_with(dir.path(), None, vec2(1280.0, 800.0), false, Some(memory));
    assert!(!has(&harness, "Drive in a dream now"));
    drop(harness);

    let nothing: &'static Memory = Box::leak(Box::default());
    let store = session(dir.path(), Protocol::Dropj);
    let (mut harness, _) = window_with(dir.path(), Some(store), vec2(1280.0, 800.0), false, Some(nothing));
    assert!(!has(&harness, "Drive in a dream now"), "there is a session");
    harness.get_by_label("Keys and help").click();
    harness.run_steps(10);
    harness.get_by_label("How to begin").click();
    harness.run_steps(2);
    harness.get_by_label("Drive in a dream now");
    go(&mut harness, Panel::Reward);
    assert!(!has(&harness, "Drive in a dream now"), "a panel was wanted");
}

#[test]
fn a_new_start_offers_to_go_on_with_the_latest_session() {
    let dir = tempfile::tempdir().unwrap();
    drop(session(dir.path(), Protocol::Dropj));
    let (mut harness, _) = window(dir.path(), None, vec2(1280.0, 800.0), false);
    wait_for(&mut harness, |harness| has(harness, "Go on with 2026-11-22 10:15"));
    assert!(has(&harness, "DROPJ · 2 dreams · 0 answers"));
    harness.get_by_label("Go on with 2026-11-22 10:15").click();
    wait_for(&mut harness, |harness| harness.state().app().open().is_some());
    harness.run_steps(2);
    assert!(!has(&harness, "Go on with"), "it is open");
    drop(harness);

    // A first start has it beside the three cards.
    let (mut harness, _) = first_window(dir.path(), vec2(1280.0, 800.0), false, 1.0);
    wait_for(&mut harness, |harness| has(harness, "Go on with 2026-11-22 10:15"));
    press(&mut harness, Key::Num4);
    wait_for(&mut harness, |harness| harness.state().app().open().is_some());
    harness.run_steps(2);
    assert!(!has(&harness, "Drive in a dream now"), "the cards are gone");
}

#[test]
fn a_look_at_reward_leaves_the_next_dream_to_begin() {
    let dir = tempfile::tempdir().unwrap();
    let store = session(dir.path(), Protocol::Dropj);
    let (mut harness, backstage) = window(dir.path(), Some(store), vec2(1280.0, 800.0), false);
    go(&mut harness, Panel::Reward);
    go(&mut harness, Panel::Dream);
    harness.get_by_label("Begin here");
    // A dream that is looked at gives way to the next one by the same key.
    harness.get_by_label("Dream 2: 90 steps").click();
    harness.run_steps(2);
    harness.get_by_label("Drive");
    backstage.orders();
    press(&mut harness, Key::Enter);
    let is_start =
        |order: &WorkerCommand| matches!(order, WorkerCommand::Dreamer(DreamerCommand::Start { .. }));
    assert!(backstage.orders().iter().any(is_start), "it has begun");
}

#[test]
fn the_second_way_opens_twenty_queries_of_the_example() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = first_window(dir.path(), vec2(1280.0, 800.0), false, 1.0);
    press(&mut harness, Key::Num2);
    // What is made is of the shipped world model, and this window has a toy: it says so, and stays as it was.
    wait_for(&mut harness, |harness| !harness.state().app().state().messages().is_empty());
    let made: Vec<_> = std::fs::read_dir(dir.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
    let made = made.iter().find(|path| path.join("session.json").exists()).unwrap();
    let (header, practice) = SessionStore::read(made).unwrap();
    assert_eq!((header.env.as_str(), practice.pending().count()), ("car-racing", N_PRACTICED));
    assert_eq!(practice.protocol(), Protocol::Dropj, "each has one key");
}

#[test]
fn hints_come_one_at_a_time_are_remembered_and_can_be_called_back() {
    let dir = tempfile::tempdir().unwrap();
    let nothing: &'static Memory = Box::leak(Box::default());
    let store = session(dir.path(), Protocol::Dropj);
    let (mut harness, backstage) =
        window_with(dir.path(), Some(store), vec2(1280.0, 800.0), false, Some(nothing));
    harness.get_by_label_contains("2 dreams are kept. Now compare clips of them");
    harness.get_by_label("Go and label").click();
    harness.run_steps(3);
    harness.get_by_label_contains("Watch both clips, then press one key");
    for _ in 0..3 {
        press(&mut harness, Key::A);
    }
    harness.get_by_label_contains("After 20 answers there is something to see");
    harness.get_by_label("Got it").click();
    harness.run_steps(2);
    assert!(!has(&harness, "there is something to see"));
    for i in 3..N_PRACTICED {
        press(&mut harness, if i % 2 == 0 { Key::S } else { Key::ArrowLeft });
    }
    harness.get_by_label_contains("20 answers: enough to see");
    harness.get_by_label("Look at Reward").click();
    backstage.report(learned(20, None));
    harness.run_steps(3);
    harness.get_by_label_contains("fits it to all answers from the beginning");
    backstage.orders();
    press(&mut harness, Key::Enter);
    let seed = backstage.orders().into_iter().find_map(|order| match order {
        WorkerCommand::Trainer(TrainerCommand::Fit { seed }) => Some(seed),
        _ => None,
    });
    assert!(!has(&harness, "fits it to all answers"), "it is being done");
    backstage.report(learned(20, seed));
    harness.run_steps(3);
    harness.get_by_label("Go and deploy").click();
    harness.run_steps(3);
    harness.get_by_label_contains("It is not a dream any more");

    let memory: &'static Memory = Box::leak(Box::new(remembered(&mut harness)));
    drop((harness, backstage));
    let folder = std::fs::read_dir(dir.path()).unwrap().map(|entry| entry.unwrap().path());
    let folder = folder.into_iter().find(|path| path.join("session.json").exists()).unwrap();
    let store = SessionStore::open(&folder, None).unwrap();
    let (mut harness, _) = window_with(dir.path(), Some(store), vec2(1280.0, 800.0), false, Some(memory));
    go(&mut harness, Panel::Label);
    assert!(harness.query_by_label("Got it").is_none(), "each is shown once");
    harness.get_by_label("Keys and help").click();
    harness.run_steps(10);
    harness.get_by_label("Show hints again").click();
    harness.run_steps(4);
    go(&mut harness, Panel::Deploy);
    harness.get_by_label("Got it");
}

#[test]
fn where_nothing_can_be_remembered_nobody_is_taught_each_time() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = window(dir.path(), None, vec2(1280.0, 800.0), false);
    assert!(!has(&harness, "Drive in a dream now"));
    press(&mut harness, Key::Enter);
    assert!(harness.query_by_label("Got it").is_none());
}

#[test]
fn a_query_is_written_as_a_gif_and_where_it_is_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = labeling(dir.path(), Protocol::Dropj);
    see(&mut harness);
    harness.get_by_label("GIF…");
    // Whether there is a dialog depends on the machine: what comes after it is done here.
    let path = dir.path().join("mine");
    let source = dropj::worker::ClipSource::Query {
        left: vec![frame(40); 20],
        right: vec![frame(90); 20],
        response: None,
        rate: 50.0,
    };
    let mut jobs = backstage.jobs.lock().unwrap();
    jobs.as_mut().unwrap().send(WorkerCommand::Jobs(JobCommand::WriteClip { path: path.clone(), source }));
    drop(jobs);
    wait_for(&mut harness, |harness| has(harness, "The clip is in"));
    assert!(std::fs::read(path.with_extension("gif")).unwrap().starts_with(b"GIF89a"));
    backstage.report(Report::Job(JobReport::ClipWritten(Err(WorkerError::Stopped))));
    harness.run_steps(2);
    assert!(has(&harness, "Stopped"), "what went wrong is said");
}

#[test]
fn with_less_motion_a_clip_is_a_few_pictures_one_after_the_other() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    harness.get_by_label("Keys and help").click();
    harness.run_steps(10);
    harness.get_by_label("Less motion").click();
    harness.run_steps(2);
    press(&mut harness, Key::Escape);
    let mut frames = BTreeMap::new();
    for _ in 0..400 {
        harness.step();
        for i in 1..=SEGMENT_LEN {
            if harness.query_by_label(&format!("Frame {i} of {SEGMENT_LEN}")).is_some() {
                *frames.entry(i).or_insert(0) += 1;
            }
        }
    }
    assert_eq!(frames.keys().copied().collect::<Vec<_>>(), [1, 6, 11, 16, 20], "{frames:?}");
    assert!(frames.values().all(|n| *n >= 5), "each stands for a while: {frames:?}");
    let text = remembered(&mut harness).0;
    assert!(text.values().any(|text| text.contains("is_motion_reduced:true")), "{text:?}");
}

#[test]
fn the_question_mark_opens_the_help_again_and_again_whichever_key_is_let_go_first() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = window(dir.path(), None, vec2(1280.0, 800.0), false);
    for _ in 0..2 {
        // Shift is let go first, so that what is released is another key.
        harness.key_down_modifiers(Modifiers::SHIFT, Key::Questionmark);
        harness.run_steps(2);
        harness.key_up(Key::Slash);
        harness.run_steps(8);
        harness.get_by_label("Back to the first keys");
        press(&mut harness, Key::Escape);
        assert!(!has(&harness, "Back to the first keys"));
    }
}

/// Every control of the window has a name and a role, which is all that a screen reader knows of it.
fn assert_accessible(harness: &Harness<'_, Window>, place: &str) {
    let mut n = 0;
    for node in harness.root().children_recursive() {
        let node = node.accesskit_node();
        // A text that can be marked is no control, and a scroll bar is known by its role.
        let has_no_name = matches!(node.role(), Role::Label | Role::ScrollBar);
        let is_control = node.data().supports_action(Action::Click) && !has_no_name;
        if node.is_hidden() || !is_control {
            continue;
        }
        n += 1;
        let role = node.role();
        let name = node.label().or_else(|| node.value()).unwrap_or_default();
        assert!(!matches!(role, Role::Unknown | Role::GenericContainer), "{place}: {name:?} has no role");
        assert!(!name.trim().is_empty(), "{place}: a {role:?} at {:?} has no name", node.bounding_box());
    }
    assert!(n >= 8, "{place}: {n} controls are few");
}

#[test]
fn the_whole_loop_goes_by_keys_alone_and_everything_has_a_name() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = first_window(dir.path(), vec2(1280.0, 800.0), false, 1.0);
    assert_accessible(&harness, "how to begin");
    let go_by_key = |harness: &mut Harness<'_, Window>, key: Key| {
        harness.key_press_modifiers(Modifiers::COMMAND, key);
        harness.run_steps(3);
    };
    press(&mut harness, Key::Num1);
    for n_kept in 1..=2 {
        backstage.slots.dream.put(view(40));
        harness.run_steps(2);
        assert_accessible(&harness, "a dream");
        press(&mut harness, Key::N);
        backstage.report(Report::Dream(DreamReport::Ended { episode: dream(60), journal: None }));
        harness.run_steps(3);
        let session = harness.state().app().open().unwrap().session();
        assert_eq!(session.dreams().len(), n_kept);
        if n_kept == 1 {
            press(&mut harness, Key::Enter);
        }
    }
    go_by_key(&mut harness, Key::Num4);
    assert_accessible(&harness, "label");
    let keys = [Key::A, Key::D, Key::S, Key::ArrowLeft, Key::ArrowUp, Key::ArrowRight];
    for i in 0..N_PRACTICED {
        press(&mut harness, keys[i % keys.len()]);
    }
    assert_eq!(answers(&harness).len(), N_PRACTICED);
    press(&mut harness, Key::L);
    assert_accessible(&harness, "answers");
    backstage.report(learned(N_PRACTICED, None));
    go_by_key(&mut harness, Key::Num5);
    assert_accessible(&harness, "reward");
    backstage.orders();
    press(&mut harness, Key::Enter);
    let seed = backstage.orders().into_iter().find_map(|order| match order {
        WorkerCommand::Trainer(TrainerCommand::Fit { seed }) => Some(seed),
        _ => None,
    });
    backstage.report(learned(N_PRACTICED, Some(seed.unwrap())));
    harness.run_steps(3);
    assert_eq!(harness.state().app().open().unwrap().session().fits().len(), 1, "it is kept");
    go_by_key(&mut harness, Key::Num6);
    assert_accessible(&harness, "deploy");
    press(&mut harness, Key::Enter);
    let is_drive = |order: &WorkerCommand| {
        matches!(order, WorkerCommand::Driver(dropj::worker::DriverCommand::Drive { .. }))
    };
    assert!(backstage.orders().iter().any(is_drive), "the planner acts");
    for (key, place) in [(Key::Num1, "record"), (Key::Num2, "world model")] {
        go_by_key(&mut harness, key);
        assert_accessible(&harness, place);
    }
    press(&mut harness, Key::Questionmark);
    harness.run_steps(10);
    assert_accessible(&harness, "help");
    press(&mut harness, Key::Escape);
    harness.get_by_label("Sessions…").click();
    harness.run_steps(10);
    assert_accessible(&harness, "sessions");
}

#[test]
fn how_to_begin_looks_as_it_did_at_every_scale() {
    if !looks::has_adapter() {
        return;
    }
    let mut results = egui_kittest::SnapshotResults::new();
    for (size, scale, name) in [
        (vec2(1280.0, 720.0), 1.0, "begin-100"),
        (vec2(960.0, 600.0), 1.5, "begin-150"),
        (vec2(880.0, 600.0), 2.0, "begin-200"),
    ] {
        let dir = tempfile::tempdir().unwrap();
        let (mut harness, _) = first_window(dir.path(), size, true, scale);
        harness.run_steps(4);
        results.add(harness.try_snapshot(name));
    }
    let dir = tempfile::tempdir().unwrap();
    let nothing: &'static Memory = Box::leak(Box::default());
    let store = session(dir.path(), Protocol::Dropj);
    let size = vec2(880.0, 600.0);
    let (mut harness, backstage) = window_at(dir.path(), Some(store), size, true, Some(nothing), 2.0);
    for (panel, name) in [
        (Panel::Label, "label-small-200"),
        (Panel::Deploy, "deploy-small-200"),
        (Panel::Record, "record-small-200"),
    ] {
        go(&mut harness, panel);
        backstage.report(learned(3, None));
        harness.run_steps(8);
        results.add(harness.try_snapshot(name));
    }
}
