//! What the window says and keeps where nothing can be saved.

use std::fs;

use dropj::query::DreamId;

use dropj::world_model::ModelIdentity;

use super::*;

/// Puts a copy of the log in its place, as a tool that brings files up to date does.
fn replace_log(harness: &Harness<'_, Window>) {
    let log = harness.state().app().open().unwrap().dir().join("events.jsonl");
    let copy = log.with_extension("copy");
    fs::copy(&log, &copy).unwrap();
    fs::rename(&copy, &log).unwrap();
}

pub(crate) fn says(harness: &Harness<'_, Window>, text: &str) -> bool {
    harness.query_all_by_label_contains(text).next().is_some()
}

/// Saves the session elsewhere, where the window suggests.
fn save_elsewhere(harness: &mut Harness<'_, Window>) {
    harness.get_all_by_label("Save elsewhere…").next().unwrap().click();
    harness.run_steps(3);
    harness.get_by_label("Save there").click();
    harness.run_steps(3);
}

#[test]
fn a_log_that_was_replaced_is_told_of_at_once_and_nothing_said_is_lost() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = labeling(dir.path(), Protocol::Dropj);
    press(&mut harness, Key::A);
    let first = harness.state().app().open().unwrap().dir().to_owned();
    assert!(says(&harness, "saved · "));
    replace_log(&harness);
    let replaced = fs::read(first.join("events.jsonl")).unwrap();

    press(&mut harness, Key::D);
    assert!(says(&harness, "was replaced, moved or changed by another program"));
    assert!(!says(&harness, "saved · ") && says(&harness, "not saved: 1 event"));
    assert_eq!(responses(&harness).len(), 1, "what is not on disk does not count");
    assert_eq!(fs::read(first.join("events.jsonl")).unwrap(), replaced, "and nothing more goes there");

    backstage.orders();
    save_elsewhere(&mut harness);
    let both = [SafetyAnswer::OnlyLeft, SafetyAnswer::OnlyRight].map(Response::Safety);
    assert_eq!(responses(&harness), both, "both were given, and are there");
    assert!(says(&harness, "saved · ") && !says(&harness, "not saved"));
    let taught = backstage.orders().into_iter().any(
        |order| matches!(order, WorkerCommand::Trainer(TrainerCommand::Learn(query, _)) if query.id == QueryId(1)),
    );
    assert!(taught, "the trainer hears of it as well");
    press(&mut harness, Key::S);
    let second = harness.state().app().open().unwrap().dir().to_owned();
    assert_ne!(first, second);
    drop((harness, backstage));

    let read = SessionStore::open(&second, Some(&ModelIdentity::of(&world().parameters).unwrap())).unwrap();
    assert_eq!(read.session().answers().len(), 3, "it goes on there");
    assert_eq!(read.dream(DreamId(0)).unwrap().len(), 200);
    assert_eq!(read.dream(DreamId(1)).unwrap().len(), 90);
}

#[test]
fn a_folder_that_was_moved_is_told_of_though_nobody_does_anything() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    go(&mut harness, Panel::World);
    let folder = harness.state().app().open().unwrap().dir().to_owned();
    let moved = folder.with_extension("moved");
    fs::rename(&folder, &moved).unwrap();
    // Nothing else draws the window.
    std::thread::sleep(std::time::Duration::from_millis(1500));
    harness.run_steps(3);
    assert!(says(&harness, "not saved") && says(&harness, "no longer saved under its name"));
    go(&mut harness, Panel::Label);
    press(&mut harness, Key::A);
    assert!(!folder.exists(), "no other folder is made in its place");

    // Put back it is as before, and what was said meanwhile can be saved there.
    fs::rename(&moved, &folder).unwrap();
    harness.get_all_by_label("Try again").next().unwrap().click();
    harness.run_steps(3);
    assert_eq!(responses(&harness), [Response::Safety(SafetyAnswer::OnlyLeft)]);
    assert!(!says(&harness, "not saved"));
}

#[test]
fn an_answer_that_is_not_on_disk_can_be_given_otherwise_or_taken_back() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    press(&mut harness, Key::A);
    replace_log(&harness);
    press(&mut harness, Key::D);
    press(&mut harness, Key::S);
    assert!(says(&harness, "not saved: 1 event"), "the second is instead of the first");
    let n_unsaved = |harness: &Harness<'_, Window>| harness.state().app().open().unwrap().n_unsaved();
    press(&mut harness, Key::Backspace);
    assert_eq!(n_unsaved(&harness), 0, "it is taken back");
    press(&mut harness, Key::S);
    save_elsewhere(&mut harness);
    let both = [SafetyAnswer::OnlyLeft, SafetyAnswer::Neither].map(Response::Safety);
    assert_eq!(responses(&harness), both);
}

#[test]
fn a_dream_that_was_driven_is_kept_until_it_can_be_saved_and_none_begins_that_could_not_be() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = labeling(dir.path(), Protocol::Dropj);
    go(&mut harness, Panel::Dream);
    replace_log(&harness);
    backstage.orders();
    backstage.report(Report::Dream(DreamReport::Ended { episode: dream(70), journal: None }));
    harness.run_steps(3);
    assert!(says(&harness, "the dream is not lost") || says(&harness, "The dream is not lost"));
    press(&mut harness, Key::Enter);
    let begun = |orders: Vec<WorkerCommand>| {
        orders.iter().any(|order| matches!(order, WorkerCommand::Dreamer(DreamerCommand::Start { .. })))
    };
    assert!(!begun(backstage.orders()), "nobody drives what could not be kept");
    assert!(says(&harness, "No dream begins"));

    save_elsewhere(&mut harness);
    let session = harness.state().app().open().unwrap();
    assert_eq!(session.session().dreams().last().unwrap().len, 70);
    assert_eq!(session.session().dreams().len(), 3);
    press(&mut harness, Key::Enter);
    assert!(begun(backstage.orders()), "and there one begins");
}

#[test]
fn where_no_session_can_be_kept_it_is_said_before_anybody_drives() {
    let dir = tempfile::tempdir().unwrap();
    let (file, other) = (dir.path().join("sessions"), dir.path().join("other"));
    fs::write(&file, "not a folder").unwrap();
    let (mut harness, backstage) = window(&file, None, vec2(1280.0, 800.0), false);
    assert!(says(&harness, "There is no place to keep what is done and answered"));
    assert!(says(&harness, "no place to save"));
    press(&mut harness, Key::Enter);
    let orders = backstage.orders();
    let is_start =
        |order: &WorkerCommand| matches!(order, WorkerCommand::Dreamer(DreamerCommand::Start { .. }));
    assert!(!orders.iter().any(is_start), "nobody drives what could not be kept: {orders:?}");

    harness.get_all_by_label("Choose another folder…").next().unwrap().click();
    harness.run_steps(3);
    harness.get_by_label("The folder of sessions").focus();
    harness.run_steps(1);
    harness.key_press_modifiers(eframe::egui::Modifiers::COMMAND, Key::A);
    harness.get_by_label("The folder of sessions").type_text(&other.display().to_string());
    harness.run_steps(2);
    harness.get_by_label("Keep them there").click();
    harness.run_steps(3);
    assert!(!says(&harness, "no place to save"));
    press(&mut harness, Key::Enter);
    let session = harness.state().app().open().unwrap();
    assert!(session.dir().starts_with(&other), "{:?}", session.dir());
    assert!(backstage.orders().iter().any(is_start), "and there it goes on");
    assert_eq!(fs::read(&file).unwrap(), b"not a folder");
}

#[cfg(target_os = "linux")]
#[test]
fn a_disk_that_takes_no_files_is_told_of_before_anybody_drives() {
    let (mut harness, backstage) = window(Path::new("/proc/sessions"), None, vec2(1280.0, 800.0), false);
    assert!(says(&harness, "There is no place to keep what is done and answered"));
    press(&mut harness, Key::Enter);
    let orders = backstage.orders();
    let is_start =
        |order: &WorkerCommand| matches!(order, WorkerCommand::Dreamer(DreamerCommand::Start { .. }));
    assert!(!orders.iter().any(is_start), "{orders:?}");
}

#[test]
fn a_recording_that_cannot_be_written_stands_and_goes_on_elsewhere() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = labeling(dir.path(), Protocol::Dropj);
    go(&mut harness, Panel::Record);
    backstage.orders();
    backstage.report(Report::Record(RecordReport::Held("the disk is full".to_owned())));
    harness.run_steps(3);
    assert!(says(&harness, "The recording stands, and nothing of it is lost"));
    harness.get_by_label("Try again").click();
    harness.run_steps(3);
    let goes_on =
        |order: &WorkerCommand| matches!(order, WorkerCommand::Recorder(RecorderCommand::Pause(false)));
    assert!(backstage.orders().iter().any(goes_on));

    backstage.report(Report::Record(RecordReport::Held("the disk is full".to_owned())));
    harness.run_steps(3);
    save_elsewhere(&mut harness);
    let saved = backstage.orders().into_iter().find_map(|order| match order {
        WorkerCommand::Recorder(RecorderCommand::SaveIn(dataset)) => Some(dataset),
        _ => None,
    });
    backstage.report(Report::Record(RecordReport::Moved(saved.unwrap())));
    harness.run_steps(3);
    assert!(says(&harness, "The recording is in"));
}

#[test]
fn a_session_with_something_unsaved_is_not_left_for_another() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    replace_log(&harness);
    press(&mut harness, Key::A);
    let before = harness.state().app().open().unwrap().dir().to_owned();
    harness.get_by_label("Sessions…").click();
    harness.run_steps(10);
    harness.get_by_label("DROP").click();
    harness.run_steps(10);
    assert_eq!(harness.state().app().open().unwrap().dir(), before);
    assert!(says(&harness, "save that first"));
    harness.get_by_label("Let it go").click();
    harness.run_steps(3);
    assert_eq!(harness.state().app().open().unwrap().n_unsaved(), 0);
}
