//! Worlds that are no cars: other axes, pictures, candidates, reasons and sources.

use std::fmt::Write as _;

use dropj::worker::{CandidateView, DriveView, DriverCommand};
use egui_kittest::SnapshotResults;

use super::looks::{driving, has_adapter};
use super::*;

/// A world of these axes, in TOML, with pictures of 60 × 80 pixels and three reasons.
fn spec(source: &str, axes: &str) -> Arc<WorldSpec> {
    let mut text = format!(
        "format = 1\nname = \"arm\"\ntitle = \"An arm over a table\"\nrate = 10\nlongest_episode = 400\n\
         source = {source}\nimage = {{ height = 60, width = 80 }}\n{axes}"
    );
    for name in ["collision", "spill", "drop"] {
        let _ = write!(
            text,
            "[[events]]\nname = \"{name}\"\nkind = \"safety\"\nfield = \"{name}\"\n\
             [[justifications]]\nname = \"{name}\"\nevents = [\"{name}\"]\nweight = 0.9\n"
        );
    }
    text += "[[events]]\nname = \"placed\"\nkind = \"progress\"\nfield = \"placed\"\n";
    Arc::new(WorldSpec::from_toml(&text, Path::new("arm.toml")).unwrap())
}

const PROCESS: &str = "{ kind = \"process\", command = [\"arm\"] }";

/// Seven axes; N, which keeps what is acted, moves the last one.
fn seven() -> Arc<WorldSpec> {
    let keys =
        [["Q", "A"], ["W", "S"], ["E", "D"], ["Left", "Right"], ["Up", "Down"], ["1", "2"], ["N", "0"]];
    let names = ["base", "shoulder", "elbow", "wrist turn", "wrist", "flange", "grip"];
    let mut axes = String::new();
    for (name, [low, high]) in names.into_iter().zip(keys) {
        let _ = write!(
            axes,
            "[[axes]]\nname = \"{name}\"\nlow = -2.0\nhigh = 2.0\nneutral = 0.0\n\
             keys = [{{ key = \"{low}\", to = -2.0 }}, {{ key = \"{high}\", to = 2.0 }}]\n"
        );
    }
    spec(PROCESS, &axes)
}

/// One axis that stays where it is put, and moves by and by.
fn one(source: &str) -> Arc<WorldSpec> {
    spec(
        source,
        "[[axes]]\nname = \"height\"\nlow = 0.0\nhigh = 100.0\nneutral = 50.0\nkey_speed = 50.0\nrelease = \"stay\"\n\
         keys = [{ key = \"Down\", to = 0.0 }, { key = \"Up\", to = 100.0 }]\n\
         pad = [{ axis = \"left-stick-down\", to = 0.0 }, { axis = \"left-stick-up\", to = 100.0 }]\n",
    )
}

fn about(spec: &Arc<WorldSpec>, dir: &Path, picture: bool) -> (Harness<'static, Window>, Backstage) {
    window_of(Arc::clone(spec), dir, None, vec2(1280.0, 720.0), picture, None, 1.0)
}

/// A picture of 60 × 80 pixels.
fn wide(shade: usize) -> Frame {
    let pixel = |i: usize| [(i % 80 * 3) as u8, (i / 80 * 4) as u8, shade as u8];
    Frame::new(60, 80, (0..60 * 80).flat_map(pixel).collect::<Vec<_>>())
}

/// Begins a dream on the panel that is shown.
fn begin(harness: &mut Harness<'_, Window>) {
    press(harness, Key::Enter);
    harness.run_steps(2);
}

#[test]
fn seven_axes_are_moved_by_their_keys_and_a_key_that_is_a_command_moves() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = about(&seven(), dir.path(), false);
    begin(&mut harness);
    for key in [Key::Q, Key::S, Key::Num2, Key::N] {
        harness.key_down(key);
    }
    harness.run_steps(6);
    assert_eq!(backstage.given(), [-2.0, 2.0, 0.0, 0.0, 0.0, 2.0, -2.0]);
    let orders = backstage.orders();
    let is_kept = |order: &WorkerCommand| matches!(order, WorkerCommand::Dreamer(DreamerCommand::Finish));
    assert!(!orders.iter().any(is_kept), "N moves the grip here, and keeps nothing: {orders:?}");
    harness.get_by_label("Grip -2.0");
    harness.get_by_label("Keep").click();
    harness.run_steps(2);
    assert!(backstage.orders().iter().any(is_kept), "its button does");
    harness.get_by_label("Keys and help").click();
    harness.run_steps(10);
    harness.get_by_label("end and keep (not while N moves grip −)");
    assert!(harness.query_all_by_label("An arm over a table").count() > 1, "where its keys are told, too");
    harness.get_by_label("wrist turn −: Left");
}

#[test]
fn an_axis_that_stays_is_moved_by_and_by_and_stays_where_the_focus_was_lost() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = about(&one(PROCESS), dir.path(), false);
    begin(&mut harness);
    assert_eq!(backstage.given(), [50.0]);
    harness.key_down(Key::ArrowUp);
    harness.run_steps(5);
    let up = backstage.given()[0];
    assert!((52.0..=70.0).contains(&up), "{up}");
    harness.event(Event::WindowFocused(false));
    harness.run_steps(3);
    assert_eq!(backstage.given(), [up]);
}

#[test]
fn a_world_of_recordings_says_that_it_cannot_be_acted_in() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = about(&one("{ kind = \"recordings\" }"), dir.path(), false);
    go(&mut harness, Panel::Record);
    press(&mut harness, Key::Enter);
    backstage.pad.lock().unwrap().push(PadEvent::Pressed(PadButton::Start));
    harness.run_steps(2);
    harness.get_by_label_contains("is known from recordings alone");
    let orders = backstage.orders();
    let is_start =
        |order: &WorkerCommand| matches!(order, WorkerCommand::Recorder(RecorderCommand::Start { .. }));
    assert!(!orders.iter().any(is_start), "{orders:?}");
    backstage.report(Report::Reward(RewardReport::Learned {
        parameters: world().parameters,
        n_labels: 1,
        fit: None,
    }));
    go(&mut harness, Panel::Deploy);
    harness.get_by_label_contains("All else works");
    assert!(harness.query_by_label("Begin").is_none());
}

#[test]
fn a_world_that_takes_its_time_is_being_started_and_one_that_fails_says_why() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = about(&one(PROCESS), dir.path(), false);
    go(&mut harness, Panel::Record);
    press(&mut harness, Key::Enter);
    harness.get_by_label("Keep");
    let error = WorkerError::GaveUp(Arc::new(std::io::Error::other("the world has no arm")));
    backstage.report(Report::Failed(WorkerFailure { worker: WorkerName::Recorder, error }));
    harness.run_steps(2);
    harness.get_by_label("The world has no arm");
    harness.get_by_label("Folder of recordings");
}

/// The planner acts, with so many candidates.
fn planned(n: usize) -> DriveView {
    let candidate = |i: usize| CandidateView {
        actions: "height 60 10 · neutral 5".to_owned(),
        predicted_return: (i as f32 * 1.7).sin(),
        frames: vec![wide(8 * i % 250)],
    };
    DriveView {
        frame: wide(90),
        picture: (80, 60, wide(90).shared()),
        candidates: (0..n).map(candidate).collect(),
        chosen: n - 1,
        ..driving()
    }
}

#[test]
fn as_many_futures_are_shown_as_fit_and_the_chosen_one_always() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = about(&one(PROCESS), dir.path(), false);
    backstage.report(Report::Reward(RewardReport::Learned {
        parameters: world().parameters,
        n_labels: 1,
        fit: None,
    }));
    go(&mut harness, Panel::Deploy);
    press(&mut harness, Key::Enter);
    let is_begun =
        |order: &WorkerCommand| matches!(order, WorkerCommand::Driver(DriverCommand::Drive { .. }));
    assert!(backstage.orders().iter().any(is_begun));
    backstage.slots.drive.put(planned(30));
    harness.run_steps(2);
    assert_eq!(harness.query_all_by_label_contains("Plan ").count(), 30);
    backstage.slots.drive.put(planned(2000));
    harness.run_steps(2);
    let n = harness.query_all_by_label_contains("Plan ").count();
    assert!((20..400).contains(&n), "{n}");
    harness.get_by_label_contains("Plan 2000, chosen");
    harness.get_by_label_contains("of 2000 plans");
}

#[test]
fn three_reasons_have_a_key_each() {
    let dir = tempfile::tempdir().unwrap();
    let store = {
        let mut header =
            Header::new("arm", Protocol::DropjMulti, 5, &world().parameters.hash(), 1_795_342_500_000);
        header.config.weights = dropj::query::Weights::of(&one(PROCESS));
        let mut store = SessionStore::create(&dir.path().join("2026-11-22T10-15-00-arm"), header).unwrap();
        store.save_dream(&dream(200), DreamSource::User).unwrap();
        store
    };
    let size = vec2(1280.0, 720.0);
    let (mut harness, _) = window_of(one(PROCESS), dir.path(), Some(store), size, false, None, 1.0);
    go(&mut harness, Panel::Label);
    harness.get_by_label("spill");
    press(&mut harness, Key::Num3);
    press(&mut harness, Key::ArrowRight);
    // Several can be active, and a second press makes one inactive again.
    for key in [Key::Num1, Key::Num2, Key::Num3, Key::Num2, Key::ArrowLeft] {
        press(&mut harness, key);
    }
    let all = dropj::query::Weights::of(&one(PROCESS)).justifications;
    let [first, drop] = [all.iter().next().unwrap().0, all.named("drop").unwrap()];
    let both = dropj::query::Active::of(drop).with(first);
    let expected = [(drop.into(), Preference::Right), (both, Preference::Left)];
    assert_eq!(responses(&harness), expected.map(|(active, side)| Response::Justified(active, side)));
}

#[test]
fn another_world_is_opened_by_its_file_and_a_wrong_one_says_what_is_wrong() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = window(dir.path(), None, vec2(1280.0, 800.0), false);
    let file = dir.path().join("world.toml");
    let said = |harness: &Harness<'_, Window>, text: &str| {
        harness.state().app().state().messages().iter().any(|message| message.text.contains(text))
    };
    std::fs::write(&file, one(PROCESS).to_toml().replace("rate = 10.0", "rate = -1.0")).unwrap();
    merge::drop_on(&mut harness, &file);
    wait_for(&mut harness, |harness| said(harness, "Rate is -1"));
    assert_eq!(harness.state().next_world(), None);
    std::fs::write(&file, one(PROCESS).to_toml()).unwrap();
    merge::drop_on(&mut harness, &file);
    wait_for(&mut harness, |harness| harness.state().next_world().is_some());
    assert_eq!(harness.state().next_world(), Some(file.clone()));

    let (mut harness, backstage) = dreaming(dir.path());
    backstage.slots.dream.put(view(30));
    harness.run_steps(1);
    merge::drop_on(&mut harness, &file);
    wait_for(&mut harness, |harness| said(harness, "End this episode first"));
    assert_eq!(harness.state().next_world(), None);
}

#[test]
fn clips_of_a_slow_world_are_played_as_fast_as_it_goes() {
    let dir = tempfile::tempdir().unwrap();
    let mut frames = [one(PROCESS), Arc::default()].map(|spec| {
        let sessions = dir.path().join(&spec.name);
        std::fs::create_dir(&sessions).unwrap();
        let store = session(&sessions, Protocol::Drope);
        let size = vec2(1280.0, 720.0);
        let (mut harness, _) = window_of(Arc::clone(&spec), dir.path(), Some(store), size, false, None, 1.0);
        go(&mut harness, Panel::Label);
        press(&mut harness, Key::Num0);
        harness.run_steps(10);
        let named = harness.query_all_by_label_contains("Frame ").next().unwrap();
        let label = named.accesskit_node().label().unwrap_or_default();
        label.split(' ').nth(1).and_then(|n| n.parse::<usize>().ok()).unwrap()
    });
    // Ten pictures of 40 ms, and two more for the key.
    frames.sort_unstable();
    assert!((4..=7).contains(&frames[0]) && (10..=15).contains(&frames[1]), "{frames:?}");
}

#[test]
fn worlds_of_other_shapes_look_as_they_did() {
    if !has_adapter() {
        return;
    }
    let mut results = SnapshotResults::new();
    let dir = tempfile::tempdir().unwrap();
    let header = Header::of(&seven(), Protocol::DropjMulti, 5, &world().parameters.hash(), 1_795_342_500_000);
    // Of a name, for that of a new one has the date and time.
    let store = SessionStore::create(&dir.path().join("2026-11-22T10-15-00-arm"), header).unwrap();
    let size = vec2(1280.0, 720.0);
    let (mut harness, backstage) = window_of(seven(), dir.path(), Some(store), size, true, None, 1.0);
    begin(&mut harness);
    for step in 0..3 {
        backstage.slots.dream.put(LiveView { frame: wide(90), ..view(step) });
        harness.run_steps(2);
    }
    results.add(harness.try_snapshot("worlds-dream-7-axes"));
    harness.get_by_label("Keys and help").click();
    harness.run_steps(10);
    results.add(harness.try_snapshot("worlds-keys-7-axes"));

    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = about(&one(PROCESS), dir.path(), true);
    backstage.report(Report::Reward(RewardReport::Learned {
        parameters: world().parameters,
        n_labels: 1,
        fit: None,
    }));
    go(&mut harness, Panel::Record);
    press(&mut harness, Key::Enter);
    harness.run_steps(4);
    results.add(harness.try_snapshot("worlds-record-starting"));
    press(&mut harness, Key::Escape);
    go(&mut harness, Panel::Deploy);
    press(&mut harness, Key::Enter);
    backstage.slots.drive.put(planned(30));
    harness.run_steps(4);
    results.add(harness.try_snapshot("worlds-deploy-30-candidates"));

    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = about(&one("{ kind = \"recordings\" }"), dir.path(), true);
    go(&mut harness, Panel::Record);
    results.add(harness.try_snapshot("worlds-record-recordings"));
}
