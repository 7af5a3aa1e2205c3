//! Sessions of several annotators, and what is taken in from elsewhere.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use dropj::dataset::{Dataset, EpisodeInfo, StepRecord};
use dropj::session::{Answer, Event as SessionEvent, hand_on};
use dropj::world::End;
use eframe::egui::DroppedFile;

use super::looks::has_adapter;
use super::*;

/// Goes on until something so called is there.
pub(super) fn wait_for(harness: &mut Harness<'_, Window>, label: &str) {
    let began = Instant::now();
    while harness.query_by_label_contains(label).is_none() {
        assert!(began.elapsed() < Duration::from_secs(30), "{label:?} never came");
        harness.step();
        std::thread::sleep(Duration::from_millis(2));
    }
    harness.run_steps(2);
}

/// Goes on until a session is open whose folder is as `wanted`.
fn wait_until_open(harness: &mut Harness<'_, Window>, wanted: impl Fn(&Path) -> bool) {
    let began = Instant::now();
    while !harness.state().app().open().is_some_and(|store| wanted(store.dir())) {
        assert!(began.elapsed() < Duration::from_secs(30), "it was never opened");
        harness.step();
        std::thread::sleep(Duration::from_millis(2));
    }
    harness.run_steps(2);
}

/// A window with a session of three answers, and another one that ben answered in part.
fn with_ben(dir: &Path) -> (Harness<'static, Window>, PathBuf) {
    let (mut harness, _) = labeling(dir, Protocol::Dropj);
    for key in [Key::A, Key::D, Key::S] {
        press(&mut harness, key);
    }
    let from = harness.state().app().open().unwrap().dir().to_owned();
    let folder = dir.join("of-ben");
    let mut other = hand_on(&from, &folder, "ben").unwrap();
    let answer = Answer::new(QueryId(0), Response::Safety(SafetyAnswer::Neither), 3.0, "ben");
    other.record(SessionEvent::Answered(answer)).unwrap();
    (harness, folder)
}

fn open(harness: &mut Harness<'_, Window>) {
    if harness.query_by_label("Merge or hand on…").is_none() {
        press(harness, Key::L);
    }
    harness.get_by_label("Merge or hand on…").click();
    wait_for(harness, "of-ben");
}

fn folders(dir: &Path) -> Vec<String> {
    let names = std::fs::read_dir(dir).unwrap().map(|item| item.unwrap().file_name());
    names.map(|name| name.to_string_lossy().into_owned()).collect()
}

#[test]
fn sessions_are_put_together_in_a_new_one() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = with_ben(dir.path());
    open(&mut harness);
    harness.get_by_label("2 dreams, 1 answer of ben");
    harness.get_by_label("Choose at least two");
    press(&mut harness, Key::A);
    assert_eq!(answers(&harness).len(), 3, "what lies beneath hears no key");
    // All by keyboard.
    for (label, key) in [("of-ben", Key::Space), ("Put together", Key::Enter)] {
        harness.get_by_label(label).focus();
        harness.run_steps(2);
        press(&mut harness, key);
    }
    wait_for(&mut harness, "2 sessions put together in");
    harness.get_by_label_contains("2 dreams, 4 answers of anonymous, ben");
    harness.get_by_label("Open it").focus();
    harness.run_steps(2);
    press(&mut harness, Key::Enter);
    wait_until_open(&mut harness, |dir| dir.to_string_lossy().ends_with("-merged"));
    let store = harness.state().app().open().unwrap();
    let annotators: Vec<_> = store.session().annotators().into_iter().collect();
    assert_eq!(annotators, [("anonymous", 3), ("ben", 1)]);
}

#[test]
fn what_cannot_be_put_together_is_said_and_leaves_nothing_behind() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, other) = with_ben(dir.path());
    let dream = other.join("dreams/0001.safetensors");
    let mut bytes = std::fs::read(&dream).unwrap();
    bytes.truncate(100);
    std::fs::write(&dream, bytes).unwrap();
    // Not the same content, so it is not taken for the same dream.
    let log = std::fs::read_to_string(other.join("events.jsonl")).unwrap();
    let hash = log.lines().nth(1).and_then(|line| line.split("sha256:").nth(1)).unwrap()[..64].to_owned();
    std::fs::write(other.join("events.jsonl"), log.replace(&hash, &"0".repeat(64))).unwrap();
    open(&mut harness);
    harness.get_by_label("of-ben").click();
    harness.run_steps(2);
    harness.get_by_label("Put together").click();
    wait_for(&mut harness, "0001.safetensors");
    assert!(!folders(dir.path()).iter().any(|name| name.contains("merged")), "{:?}", folders(dir.path()));
    harness.get_by_label("Put together");
}

#[test]
fn a_session_is_handed_on_to_somebody_else() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = with_ben(dir.path());
    let asked = |harness: &Harness<'_, Window>| -> Vec<_> {
        let session = harness.state().app().open().unwrap().session();
        session.queries().iter().map(|asked| asked.query).collect()
    };
    let before = asked(&harness);
    open(&mut harness);
    harness.get_by_label("Who is to answer").focus();
    harness.run_steps(2);
    harness.get_by_label("Who is to answer").type_text("Eva M.");
    harness.run_steps(2);
    harness.get_by_label("Hand on").click();
    wait_for(&mut harness, "3 queries wait for Eva M. in");
    harness.get_by_label("Open it").click();
    wait_until_open(&mut harness, |dir| dir.to_string_lossy().ends_with("-for-Eva-M-"));
    let store = harness.state().app().open().unwrap();
    assert_eq!(store.header().config.annotator, "Eva M.");
    assert_eq!(asked(&harness)[..3], before[..3], "the same queries");
    assert!(answers(&harness).is_empty(), "without the answers");
}

/// A file or folder that is dropped on the window.
#[derive(Debug)]
struct Dropped(PathBuf);

impl DroppedFile for Dropped {
    fn path(&self) -> &Path {
        &self.0
    }

    fn bytes(&self) -> Result<Vec<u8>, String> {
        Err("nobody reads it whole".to_owned())
    }
}

/// Drops a file or folder on the window.
pub(super) fn drop_on(harness: &mut Harness<'_, Window>, path: &Path) {
    harness.input_mut().dropped_files.push(Arc::new(Dropped(path.to_owned())));
    harness.run_steps(3);
}

#[test]
fn recordings_sessions_and_world_models_are_taken_in_from_elsewhere() {
    let (dir, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    let recordings = |name: &str, env: &str| {
        let folder = elsewhere.path().join(name);
        let mut dataset = Dataset::create_or_open(&folder, env).unwrap();
        let info = EpisodeInfo { env: env.to_owned(), pilot: "anna".to_owned(), seed: 1 };
        let mut spec = WorldSpec::built_in(env).unwrap();
        (spec.image.height, spec.image.width) = (24, 24);
        let mut recording = dataset.begin_with(info, &dropj::dataset::Layout::of(&spec, &[])).unwrap();
        for t in 0..7 {
            let step = StepRecord {
                frame: frame(t),
                action: Action::new(spec.neutral()),
                reward: 0.0,
                events: vec![false; spec.events.len()],
                wall_time_ns: 0,
                state: Vec::new(),
            };
            recording.push(&step).unwrap();
        }
        dataset.seal(recording, &frame(7), Some(End::Truncated)).unwrap();
        folder
    };
    drop_on(&mut harness, &recordings("mine", "car-racing"));
    wait_for(&mut harness, "Recordings are in mine from here on: 1 episode, 7 steps");
    harness.get_by_label("Fit a world model").click();
    harness.run_steps(3);
    assert_eq!(harness.state().app().state().panel(), Panel::World);
    let value = harness.get_by_label("Folder of recordings").accesskit_node().value();
    assert_eq!(value.as_deref(), elsewhere.path().join("mine").to_str());

    drop_on(&mut harness, &recordings("theirs", "obstacle-car-racing"));
    wait_for(&mut harness, "start `dropj --env obstacle-car-racing` for them");
    drop_on(&mut harness, &elsewhere.path().join("none.safetensors"));
    wait_for(&mut harness, "Cannot read the world model");
    let other = session(elsewhere.path(), Protocol::Drope).dir().to_owned();
    drop_on(&mut harness, &other);
    wait_until_open(&mut harness, |dir| dir == other);
}

#[test]
fn several_annotators_look_as_they_did() {
    if !has_adapter() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let store = session(dir.path(), Protocol::Dropj);
    let (mut harness, _) = window(dir.path(), Some(store), vec2(1280.0, 720.0), true);
    go(&mut harness, Panel::Label);
    // How long the wait takes is not to be seen.
    press(&mut harness, Key::P);
    press(&mut harness, Key::L);
    if harness.query_by_label("Merge or hand on…").is_none() {
        press(&mut harness, Key::L);
    }
    harness.get_by_label("Merge or hand on…").click();
    wait_for(&mut harness, "2026-11-22T10-15-00-test");
    harness.run_steps(10);
    harness.snapshot("several");
}
