//! Files that are written: what is not ours stays, what cannot be written is said before the work, and what is built is
//! whole or absent.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use dropj::dataset::{Dataset, DatasetError, EpisodeInfo, Layout, StepRecord};
use dropj::dream::{Dream, DreamEpisode};
use dropj::query::{DreamId, Preference, Protocol, Query, QueryId, Response, SafetyAnswer, sample_queries};
use dropj::session::{
    Answer, Choice, DreamSource, Event, Fit, Header, NewSession, SessionError, SessionStore, list_sessions,
};
use dropj::world::End;
use dropj::world::{Action, Frame};
use dropj::world_model::{LatentState, WorldModel, WorldModelConfig, untrained};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use crate::program::{Ran, dropj, shipped};

fn model() -> WorldModel {
    untrained(&WorldModelConfig::tiny(), &mut ChaCha8Rng::seed_from_u64(1))
}

fn dream(model: &WorldModel, len: usize, seed: u64) -> DreamEpisode {
    let start = LatentState { z: vec![0.1; 4], c: vec![0.0; 16], h: vec![0.0; 16] };
    let (mut dream, rng) = (Dream::new(&start, seed), &mut ChaCha8Rng::seed_from_u64(seed));
    for t in 0..len {
        dream.step(model, Action::new([(t as f32).sin(), 0.5, 0.0]), rng).unwrap();
    }
    dream.finish()
}

fn answered(query: QueryId, safety: SafetyAnswer) -> Event {
    Event::Answered(Answer::new(query, Response::Safety(safety), 4.5, "anna"))
}

/// A session with two dreams, a reward and four queries, two of them answered.
fn session(dir: &Path, model: &WorldModel) -> SessionStore {
    let header = Header::new("dummy-road", Protocol::Dropj, 7, &model.hash(), 1_795_342_500_000);
    let mut store = SessionStore::create(dir, header).unwrap();
    store.save_dream(&dream(model, 40, 1), DreamSource::User).unwrap();
    store.save_dream(&dream(model, 25, 2), DreamSource::User).unwrap();
    let rng = &mut ChaCha8Rng::seed_from_u64(3);
    for Query { id: query, left, right } in
        sample_queries(&store.session().dream_lens(), 4, store.session().next_query_id(), rng)
    {
        store.record(Event::Asked { query, left, right, choice: Choice::Uniform }).unwrap();
    }
    store.record(answered(QueryId(0), SafetyAnswer::OnlyLeft)).unwrap();
    store.record(answered(QueryId(1), SafetyAnswer::Both(Preference::Right))).unwrap();
    let fit = Fit { after: 8, n_labels: 2, seed: 5, epochs: 3, losses: vec![0.1], held_out: None };
    store.save_reward(model.parameters(), fit).unwrap();
    store
}

/// Recorded episodes of a gray picture of `side` pixels a side.
fn recordings(dir: &Path, n_episodes: u64, side: usize) {
    let mut dataset = Dataset::create_or_open(dir, "car-racing").unwrap();
    let frame = Frame::square(side as u32, vec![90; 3 * side * side]);
    for seed in 0..n_episodes {
        let info = EpisodeInfo { env: "car-racing".to_owned(), pilot: "nobody".to_owned(), seed };
        let mut recording = dataset.begin(info).unwrap();
        for _ in 0..3 {
            recording.push(&step(&frame)).unwrap();
        }
        dataset.seal(recording, &frame, Some(End::Truncated)).unwrap();
    }
}

fn step(frame: &Frame) -> StepRecord {
    StepRecord {
        frame: frame.clone(),
        action: Action::new([0.0; 3]),
        reward: 0.0,
        events: vec![false],
        wall_time_ns: 0,
        state: Vec::new(),
    }
}

/// The names of what is in `dir`, in order.
fn names(dir: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        fs::read_dir(dir).unwrap().map(|it| it.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

fn args(line: &str) -> Vec<String> {
    line.split_whitespace().map(str::to_owned).collect()
}

/// Runs `line`, in which `EXAMPLE` stands for the session beside the sources.
fn run(dir: &Path, line: &str) -> Ran {
    let example = shipped("sessions/example").display().to_string();
    dropj(dir, args(line).into_iter().map(|arg| if arg == "EXAMPLE" { example.clone() } else { arg }))
}

#[test]
fn a_fit_leaves_alone_what_no_fit_wrote() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    recordings(&dir.join("data"), 2, 84);
    for folder in ["f/world.fit", "f/world.safetensors.fit"] {
        fs::create_dir_all(dir.join(folder)).unwrap();
        fs::write(dir.join(folder).join("thesis.txt"), "mine").unwrap();
    }
    let ran = run(dir, "fit-world --data data --out f/world.safetensors");
    assert!(ran.refused().contains("thesis.txt"), "{ran:?}");
    for folder in ["f/world.fit", "f/world.safetensors.fit"] {
        assert_eq!(names(&dir.join(folder)), ["thesis.txt"], "{folder}");
    }
    assert_eq!(names(&dir.join("f")), ["world.fit", "world.safetensors.fit"]);
}

#[test]
fn a_fit_checks_everything_before_it_clears_what_an_earlier_one_left() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    recordings(&dir.join("one"), 1, 84);
    recordings(&dir.join("small"), 3, 20);
    recordings(&dir.join("good"), 3, 84);
    let run_of_before = dropj::run::Run::beside(&dir.join("w.safetensors"), false).unwrap();
    run_of_before.note("terms", &"dear").unwrap();
    drop(run_of_before);
    fs::create_dir(dir.join("folder")).unwrap();
    for (line, why) in [
        ("fit-world --data nowhere --out w.safetensors", "nowhere"),
        ("fit-world --data one --out w.safetensors", "at least two recorded episodes"),
        ("fit-world --data small --out w.safetensors", "pixels"),
        ("fit-world --data good --out folder", "there is a folder of that name"),
    ] {
        let ran = run(dir, line);
        assert!(ran.refused().contains(why), "{line}: {ran:?}");
        let note = fs::read(dir.join("w.safetensors.fit/terms.json")).unwrap();
        assert_eq!(note, b"\"dear\"", "{line}");
    }
    assert_eq!(names(dir), ["folder", "good", "one", "small", "w.safetensors.fit"]);
}

#[test]
fn an_output_that_cannot_be_written_is_refused_before_the_work() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    recordings(&dir.join("data"), 3, 84);
    fs::write(dir.join("actions.csv"), "0,1,0\n0,1,0\n").unwrap();
    fs::write(dir.join("file"), "mine").unwrap();
    fs::create_dir(dir.join("folder")).unwrap();
    fs::write(dir.join("notes.md"), "# Mine\n\nand dear to me, too\n").unwrap();
    fs::write(dir.join("table.csv"), "a,b\n1,2\n").unwrap();
    let before = names(dir);
    let world = shipped("assets/world-car-racing.safetensors").display().to_string();
    let long = "deploy --straight-on --episodes 100000";
    for (line, why) in [
        // A file in the place of a folder.
        (format!("{long} --steps file/steps.csv"), "a file in the place of a folder"),
        (format!("check-world --data data --world {world} --picture file/p.png"), "a file in the place"),
        ("agree EXAMPLE --csv file/a/t.csv".to_owned(), "a file in the place of a folder"),
        ("screen EXAMPLE --csv file/t.csv".to_owned(), "a file in the place of a folder"),
        (
            "trace --gym-seed 1 --actions actions.csv --frames file".to_owned(),
            "a file in the place of a folder",
        ),
        ("fit-probe --out file/p.safetensors".to_owned(), "a file in the place of a folder"),
        ("simulate --out file/s".to_owned(), "a file in the place of a folder"),
        ("merge EXAMPLE EXAMPLE --out file/s".to_owned(), "a file in the place of a folder"),
        ("hand-on EXAMPLE --annotator eva --out file/s".to_owned(), "a file in the place of a folder"),
        // A folder in the place of a file, and a name that is none.
        (format!("{long} --steps folder"), "a folder of that name"),
        ("agree EXAMPLE --csv folder".to_owned(), "a folder of that name"),
        ("screen EXAMPLE --csv new/".to_owned(), "names a folder"),
        ("fit-probe --out folder".to_owned(), "a folder of that name"),
        (format!("check-world --data data --world {world} --picture p.jpg"), ".png"),
        // Something of another kind, which would be gone.
        ("fit-probe --out table.csv".to_owned(), "would be written over"),
        ("fit-world --data data --out notes.md".to_owned(), "would be written over"),
        (format!("{long} --steps notes.md"), "would be written over"),
        ("agree EXAMPLE --csv notes.md".to_owned(), "would be written over"),
        (format!("check-world --data data --world {world} --picture table.png"), "would be written over"),
        // Something already.
        ("simulate --out data".to_owned(), "something already"),
        ("merge EXAMPLE EXAMPLE --out data".to_owned(), "something already"),
        ("hand-on EXAMPLE --annotator eva --out file".to_owned(), "something already"),
        // A disk that takes no files, whoever asks.
        (format!("{long} --steps /proc/steps.csv"), "write into this folder"),
        ("simulate --out /proc/s".to_owned(), "write into this folder"),
    ] {
        if line.contains("table.png") {
            fs::copy(dir.join("table.csv"), dir.join("table.png")).unwrap();
        }
        let ran = run(dir, &line);
        assert!(ran.refused().contains(why), "{line}: {ran:?}");
        fs::remove_file(dir.join("table.png")).ok();
        assert_eq!(names(dir), before, "{line}");
    }
    assert_eq!(fs::read(dir.join("table.csv")).unwrap(), b"a,b\n1,2\n");
    assert_eq!(fs::read(dir.join("notes.md")).unwrap(), b"# Mine\n\nand dear to me, too\n");
}

#[test]
fn an_output_is_written_where_its_folder_is_still_to_be_made_and_over_one_of_its_kind() {
    let dir = tempfile::tempdir().unwrap();
    let theirs = dir.path().join("a/b/t.csv.partial");
    for _ in 0..2 {
        run(dir.path(), "agree EXAMPLE --csv a/b/t.csv").succeeded();
        let table = fs::read_to_string(dir.path().join("a/b/t.csv")).unwrap();
        assert!(table.lines().count() > 1, "{table}");
        fs::write(&theirs, "mine").unwrap();
    }
    assert_eq!(names(&dir.path().join("a/b")), ["t.csv", "t.csv.partial"]);
    assert_eq!(fs::read(&theirs).unwrap(), b"mine", "what somebody else calls so is no business of ours");
}

/// A simulation that takes a few seconds, and what it is to make.
const SIMULATION: &str = "simulate --dreams 1 --steps 60 --queries 6 --out s";

#[test]
fn a_refused_simulation_leaves_nothing() {
    let dir = tempfile::tempdir().unwrap();
    for wrong in [
        "--eps-mistake 2",
        "--rounds 9",
        "--world nowhere",
        "--probe nowhere",
        "--weights grass=7",
        "--queries 0",
    ] {
        run(dir.path(), &format!("{SIMULATION} {wrong}").replace("--queries 6", "")).refused();
        assert_eq!(names(dir.path()), [""; 0], "{wrong}");
    }
}

/// Starts `line` in `dir` and kills it as soon as something is there.
fn killed(dir: &Path, line: &str, is_there: impl Fn() -> bool) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_dropj"))
        .current_dir(dir)
        .args(args(line))
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let since = Instant::now();
    while !is_there() {
        assert!(since.elapsed() < Duration::from_secs(50) && child.try_wait().unwrap().is_none(), "{line}");
        std::thread::sleep(Duration::from_millis(2));
    }
    child.kill().unwrap();
    child.wait().unwrap();
}

#[test]
fn a_killed_simulation_does_not_bar_the_next() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let long = "simulate --dreams 10 --steps 1000 --queries 500 --out s";
    killed(dir, long, || dir.join("s.partial/session.json").exists());
    assert_eq!(names(dir), ["s.partial"], "nobody takes half of it for the whole");
    assert_eq!(list_sessions(dir).unwrap().len(), 0);

    run(dir, SIMULATION).succeeded();
    assert_eq!(names(dir), ["s"]);
    assert!(!names(&dir.join("s")).iter().any(|name| name.starts_with('.')), "{:?}", names(&dir.join("s")));
    let store = SessionStore::open(&dir.join("s"), None).unwrap();
    assert_eq!((store.session().dreams().len(), store.session().fits().len()), (1, 1));
    assert!(store.world_model_path().is_some(), "the way to the world model leads there from its own place");
}

#[test]
fn what_somebody_else_has_in_the_place_of_a_half_built_session_stays() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    fs::create_dir(dir.join("s.partial")).unwrap();
    fs::write(dir.join("s.partial/thesis.txt"), "mine").unwrap();
    for line in [SIMULATION, "merge EXAMPLE EXAMPLE --out s", "hand-on EXAMPLE --annotator eva --out s"] {
        let ran = run(dir, line);
        assert!(ran.refused().contains("left alone"), "{ran:?}");
        assert_eq!(names(dir), ["s.partial"]);
        assert_eq!(names(&dir.join("s.partial")), ["thesis.txt"]);
    }
}

#[test]
fn a_half_built_session_is_built_anew_by_every_command_unless_it_is_being_built() {
    let dir = tempfile::tempdir().unwrap();
    let (dir, model) = (dir.path(), model());
    drop(session(&dir.join("a"), &model));
    for line in ["merge a a --out m", "hand-on a --annotator eva --out m"] {
        let building = NewSession::at(&dir.join("m")).unwrap();
        let header = Header::new("dummy-road", Protocol::Dropj, 7, &model.hash(), 0);
        drop(building.create(header).unwrap());
        let ran = run(dir, line);
        assert!(ran.refused().contains("another program is at work"), "{ran:?}");
        // As a killed program leaves it: all of its files, and nobody's lock.
        copy(&dir.join("m.partial"), &dir.join("left"));
        drop(building);
        fs::rename(dir.join("left"), dir.join("m.partial")).unwrap();
        let refused = SessionStore::open(&dir.join("m.partial"), None).unwrap_err();
        assert!(
            matches!(refused, SessionError::Unfinished { .. }),
            "nobody answers in what may be removed: {refused}"
        );
        run(dir, line).succeeded();
        assert_eq!(names(dir), ["a", "m"], "{line}");
        fs::remove_dir_all(dir.join("m")).unwrap();
    }
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let to = to.join(path.file_name().unwrap());
        if path.is_dir() {
            copy(&path, &to);
        } else {
            fs::copy(&path, &to).unwrap();
        }
    }
}

/// Runs `line` where no file may grow beyond some kilobytes, as on a disk that fills up.
#[cfg(unix)]
fn run_on_a_full_disk(dir: &Path, line: &str) -> Ran {
    let script = "ulimit -f 12; exec \"$0\" \"$@\"";
    let example = shipped("sessions/example").display().to_string();
    let args = args(line).into_iter().map(|arg| if arg == "EXAMPLE" { example.clone() } else { arg });
    let output = Command::new("sh")
        .current_dir(dir)
        .args(["-c", script, env!("CARGO_BIN_EXE_dropj")])
        .args(args)
        .output()
        .unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
    Ran { code: output.status.code(), out: text(output.stdout), err: text(output.stderr) }
}

#[cfg(unix)]
#[test]
fn a_disk_that_fills_up_leaves_nothing_half_and_is_told_plainly() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    fs::write(dir.join("t.csv"), "a,b\n1,2\n").unwrap();
    for line in [
        "merge EXAMPLE EXAMPLE --out m",
        "hand-on EXAMPLE --annotator eva --out m",
        SIMULATION,
        "screen EXAMPLE --csv t.csv",
    ] {
        let ran = run_on_a_full_disk(dir, line);
        assert!(ran.refused().contains("choose another place"), "{line}: {ran:?}");
        assert_eq!(names(dir), ["t.csv"], "{line}");
        assert_eq!(fs::read(dir.join("t.csv")).unwrap(), b"a,b\n1,2\n", "{line}");
    }
}

/// A way in which a session's folder stops being what it was while it is open.
type Mishap = fn(&Path);

const MISHAPS: [(&str, Mishap); 5] = [
    ("the log is replaced", |dir| {
        fs::copy(dir.join("events.jsonl"), dir.join("copy")).unwrap();
        fs::rename(dir.join("copy"), dir.join("events.jsonl")).unwrap();
    }),
    ("the log is removed", |dir| fs::remove_file(dir.join("events.jsonl")).unwrap()),
    ("the log is written by another", |dir| {
        let log = fs::read(dir.join("events.jsonl")).unwrap();
        fs::write(dir.join("events.jsonl"), &log[..log.len() / 2]).unwrap();
    }),
    ("the folder is moved", |dir| fs::rename(dir, dir.with_extension("moved")).unwrap()),
    ("the folder is removed", |dir| fs::remove_dir_all(dir).unwrap()),
];

#[cfg(unix)]
#[test]
fn what_is_said_after_a_mishap_is_refused_kept_and_saved_elsewhere() {
    for (mishap, happen) in MISHAPS {
        let dir = tempfile::tempdir().unwrap();
        let (s, model) = (dir.path().join("s"), model());
        let mut store = session(&s, &model);
        happen(&s);
        let there = fs::read(s.join("events.jsonl")).ok();
        let refused = store.record(answered(QueryId(2), SafetyAnswer::Neither)).unwrap_err();
        assert!(matches!(refused, SessionError::Replaced { .. }), "{mishap}: {refused}");
        assert!(refused.to_string().contains("save the session elsewhere"), "{refused}");
        assert!(store.check().is_err(), "{mishap}");
        assert_eq!(store.session().answers().len(), 2, "{mishap}: it does not count yet");
        // Nothing else is written there either, and no folder made.
        assert!(store.save_dream(&dream(&model, 30, 9), DreamSource::User).is_err(), "{mishap}");
        assert!(store.journal(&dream(&model, 1, 9), DreamSource::User).is_err(), "{mishap}");
        assert_eq!(fs::read(s.join("events.jsonl")).ok(), there, "{mishap}");

        let held = |id: DreamId| Some(dream(&model, [40, 25][id.0 as usize], u64::from(id.0) + 1));
        let saved = store.save_as(&dir.path().join("e"), held, Some(model.parameters())).unwrap();
        assert_eq!(saved.left_out, [""; 0], "{mishap}");
        assert_eq!(saved.written, [answered(QueryId(2), SafetyAnswer::Neither)]);
        let mut saved = saved.store;
        assert_eq!(saved.header(), store.header());
        assert_eq!(saved.session().answers().len(), 3, "{mishap}");
        saved.record(answered(QueryId(3), SafetyAnswer::OnlyRight)).unwrap();
        drop(saved);
        let read = SessionStore::open(&dir.path().join("e"), Some(model.identity())).unwrap();
        assert_eq!(read.session().answers().len(), 4, "{mishap}: it goes on there");
        assert_eq!(read.dream(DreamId(1)).unwrap(), dream(&model, 25, 2), "{mishap}");
        assert_eq!(read.reward().unwrap().unwrap().hash(), model.hash(), "{mishap}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_session_whose_folder_was_moved_finds_its_files_though_nothing_is_in_memory() {
    let dir = tempfile::tempdir().unwrap();
    let (s, model) = (dir.path().join("s"), model());
    let store = session(&s, &model);
    store.save_world_model(&model).unwrap();
    fs::rename(&s, dir.path().join("moved")).unwrap();
    let saved = store.save_as(&dir.path().join("e"), |_| None, None).unwrap();
    assert_eq!(saved.left_out, [""; 0]);
    assert_eq!(saved.store.dream(DreamId(0)).unwrap().len(), 40);
    assert!(saved.store.world_model().is_ok());
}

#[cfg(unix)]
#[test]
fn a_mishap_that_is_undone_costs_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let (s, model) = (dir.path().join("s"), model());
    let mut store = session(&s, &model);
    fs::rename(&s, dir.path().join("moved")).unwrap();
    store.record(answered(QueryId(2), SafetyAnswer::Neither)).unwrap_err();
    store.record(answered(QueryId(2), SafetyAnswer::OnlyLeft)).unwrap_err();
    assert_eq!(store.n_unsaved(), 1, "the second is instead of the first");
    assert!(store.try_again().is_err());
    fs::rename(dir.path().join("moved"), &s).unwrap();
    assert_eq!(store.try_again().unwrap(), [answered(QueryId(2), SafetyAnswer::OnlyLeft)]);
    store.check().unwrap();
    drop(store);
    assert_eq!(SessionStore::open(&s, None).unwrap().session().answers().len(), 3);
}

#[cfg(unix)]
#[test]
fn the_lock_follows_the_path() {
    let dir = tempfile::tempdir().unwrap();
    let (s, moved, model) = (dir.path().join("s"), dir.path().join("moved"), model());
    let mut first = session(&s, &model);
    fs::rename(&s, &moved).unwrap();
    let refused = SessionStore::open(&moved, None).unwrap_err();
    assert!(
        matches!(refused, SessionError::InUse { .. }),
        "moved, it is still in the first one's hands: {refused}"
    );
    assert!(first.record(Event::Flagged { query: QueryId(2) }).is_err(), "which writes no more");

    copy(&moved, &s);
    let mut second = SessionStore::open(&s, None).unwrap();
    second.record(Event::Flagged { query: QueryId(3) }).unwrap();
    assert!(
        first.record(Event::Flagged { query: QueryId(2) }).is_err(),
        "what took its place is the second one's"
    );
    drop(first);
    drop(SessionStore::open(&moved, None).unwrap());
    assert_eq!(second.session().n_entries(), SessionStore::read_reward(&s).unwrap().0.n_entries());
}

#[test]
fn a_session_of_which_a_file_is_gone_is_not_called_saved() {
    let dir = tempfile::tempdir().unwrap();
    let (s, model) = (dir.path().join("s"), model());
    for gone in ["dreams", "reward", "session.json"] {
        let mut store = session(&s, &model);
        store.check().unwrap();
        if gone == "session.json" { fs::remove_file(s.join(gone)) } else { fs::remove_dir_all(s.join(gone)) }
            .unwrap();
        let said = store.check().unwrap_err();
        assert!(matches!(&said, SessionError::Gone { path } if path.starts_with(s.join(gone))), "{said}");
        // Its folder is made again by what belongs into it.
        store.save_dream(&dream(&model, 30, 9), DreamSource::User).unwrap();
        let left_out = store.save_as(&dir.path().join("e"), |_| None, None).unwrap().left_out;
        let expected: &[&str] = match gone {
            "dreams" => &["dreams/0000.safetensors", "dreams/0001.safetensors"],
            "reward" => &["reward/0000.safetensors"],
            _ => &[],
        };
        assert_eq!(left_out, expected);
        drop(store);
        fs::remove_dir_all(&s).unwrap();
        fs::remove_dir_all(dir.path().join("e")).unwrap();
    }
}

#[test]
fn a_session_that_cannot_be_begun_leaves_nothing_in_the_way() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("file"), "mine").unwrap();
    assert!(SessionStore::check_folder(&dir.path().join("file")).is_err());
    assert!(SessionStore::check_folder(&dir.path().join("new/folder")).is_ok());
    let mut header = Header::new("dummy-road", Protocol::Dropj, 7, "sha256:00", 0);
    header.config.weights.default = 7.0;
    assert!(SessionStore::create(&dir.path().join("s"), header.clone()).is_err());
    assert!(SessionStore::create_in(&dir.path().join("file"), header).is_err());
    assert_eq!(names(dir.path()), ["file"]);
}

#[cfg(unix)]
#[test]
fn a_recording_whose_journal_is_replaced_goes_on_in_another_dataset() {
    let mishaps: [Mishap; 3] = [
        |journal| {
            fs::copy(journal, journal.with_extension("copy")).unwrap();
            fs::rename(journal.with_extension("copy"), journal).unwrap();
        },
        |journal| fs::remove_file(journal).unwrap(),
        |journal| {
            let dataset: PathBuf = journal.ancestors().nth(2).unwrap().to_owned();
            fs::rename(&dataset, dataset.with_extension("moved")).unwrap();
        },
    ];
    for happen in mishaps {
        let dir = tempfile::tempdir().unwrap();
        let frame = Frame::square(20, vec![90; 3 * 20 * 20]);
        let dataset = Dataset::create_or_open(&dir.path().join("one"), "wall").unwrap();
        let info = EpisodeInfo { env: "wall".to_owned(), pilot: "nobody".to_owned(), seed: 4 };
        let layout = Layout { sensors: vec!["speed".to_owned()], ..Layout::default() };
        let mut recording = dataset.begin_with(info.clone(), &layout).unwrap();
        let step = StepRecord { state: vec![3.5], ..step(&frame) };
        for _ in 0..3 {
            recording.push(&step).unwrap();
        }
        happen(recording.path());
        let refused = recording.push(&step).unwrap_err();
        assert!(matches!(refused, DatasetError::Replaced { .. }), "{refused}");
        assert!(recording.check().is_err());

        let mut other = Dataset::create_or_open(&dir.path().join("other"), "wall").unwrap();
        let mut moved = other.take_over(&recording).unwrap();
        moved.push(&step).unwrap();
        other.seal(moved, &frame, None).unwrap();
        recording.discard().unwrap();
        assert_eq!((other.len(0), other.info(0)), (4, &info));
    }
}
