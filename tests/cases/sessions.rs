//! Sessions that were damaged, moved, copied, or given names that nobody expects.

use std::path::{Path, PathBuf};

use dropj::dream::{Dream, DreamEpisode};
use dropj::query::{DreamId, Preference, Protocol, QueryId, Response, SafetyAnswer, SegmentRef, SkipReason};
use dropj::session::{
    Annotators, Answer, Choice, DreamSource, Entry, Event, Header, SessionStore, hand_on, merge, relative,
};
use dropj::world::Action;
use dropj::world_model::{LatentState, WorldModel, WorldModelConfig, untrained};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use crate::program::dropj;

/// 2026-11-22, a quarter past ten.
const AT: u64 = 1_795_342_500_000;
const LEFT: Response = Response::Safety(SafetyAnswer::OnlyLeft);
const RIGHT: Response = Response::Safety(SafetyAnswer::OnlyRight);
const EQUAL: Response = Response::Safety(SafetyAnswer::Both(Preference::Equal));
const SKIPPED: Response = Response::Skipped(Some(SkipReason::Hallucinated));

fn model(seed: u64) -> WorldModel {
    untrained(&WorldModelConfig::tiny(), &mut ChaCha8Rng::seed_from_u64(seed))
}

fn dream(model: &WorldModel, seed: u64) -> DreamEpisode {
    let start = LatentState { z: vec![0.1; 4], c: vec![0.0; 16], h: vec![0.0; 16] };
    let mut dream = Dream::new(&start, seed);
    let rng = &mut ChaCha8Rng::seed_from_u64(seed);
    for t in 0..60 {
        dream.step(model, Action::new([(t as f32).sin(), 0.5, 0.0]), rng).unwrap();
    }
    dream.finish()
}

fn ask(store: &mut SessionStore, dream: u32, at: u64) -> QueryId {
    let query = store.session().next_query_id();
    let segment = |start| SegmentRef { dream: DreamId(dream), start };
    let (left, right) = (segment(query.0 as usize % 20), segment(30));
    store.record_at(Event::Asked { query, left, right, choice: Choice::Uniform }, at).unwrap();
    query
}

fn answer(store: &mut SessionStore, query: QueryId, response: Response, annotator: &str, at: u64) {
    store.record_at(Event::Answered(Answer::new(query, response, 4.0, annotator)), at).unwrap();
}

/// A session in `dir/s` by `annotator`, of the world model in `dir/world.safetensors`: two dreams and eight answers.
fn session(dir: &Path, annotator: &str) -> PathBuf {
    let (model, path) = (model(1), dir.join("s"));
    std::fs::create_dir_all(dir).unwrap();
    std::fs::write(dir.join("world.safetensors"), model.parameters().bytes()).unwrap();
    let mut header = Header::new("car-racing", Protocol::Dropj, 7, &model.hash(), AT);
    header.world_model_path = relative(&path, &dir.join("world.safetensors"));
    let mut store = SessionStore::create(&path, header).unwrap();
    for seed in [1, 2] {
        store.save_dream(&dream(&model, seed), DreamSource::User).unwrap();
    }
    for (i, response) in [LEFT, RIGHT, EQUAL, LEFT, SKIPPED, RIGHT, LEFT, EQUAL].into_iter().enumerate() {
        let at = AT + 10 * i as u64;
        let query = ask(&mut store, i as u32 % 2, at);
        answer(&mut store, query, response, annotator, at + 5);
    }
    path
}

fn copy(from: &Path, to: &Path) -> PathBuf {
    std::fs::create_dir_all(to).unwrap();
    for item in std::fs::read_dir(from).unwrap() {
        let path = item.unwrap().path();
        let to = to.join(path.file_name().unwrap());
        if path.is_dir() {
            copy(&path, &to);
        } else {
            std::fs::copy(&path, to).unwrap();
        }
    }
    to.to_owned()
}

/// Rewrites the log of the session in `dir`.
fn rewrite(dir: &Path, change: impl FnOnce(Vec<Vec<u8>>) -> Vec<u8>) {
    let log = dir.join("events.jsonl");
    let lines = std::fs::read(&log).unwrap();
    let lines = lines.split(|&byte| byte == b'\n').filter(|line| !line.is_empty()).map(<[u8]>::to_vec);
    std::fs::write(log, change(lines.collect())).unwrap();
}

fn joined(lines: &[Vec<u8>]) -> Vec<u8> {
    lines.iter().flat_map(|line| [line, &b"\n"[..]].concat()).collect()
}

/// Gives every answer in the session another name.
fn rename(dir: &Path, from: &str, to: &str) {
    let [from, to] = [from, to].map(|name| format!("\"annotator\":{}", serde_json::to_string(name).unwrap()));
    let log = dir.join("events.jsonl");
    std::fs::write(&log, std::fs::read_to_string(&log).unwrap().replace(&from, &to)).unwrap();
}

#[test]
fn what_means_nothing_around_lines_is_no_damage() {
    let dir = tempfile::tempdir().unwrap();
    let plain = session(dir.path(), "anna");
    let wanted = dropj(dir.path(), ["agree", "s"]).succeeded().to_owned();
    let odd = copy(&plain, &dir.path().join("odd"));
    let head = std::fs::read_to_string(odd.join("session.json")).unwrap();
    std::fs::write(odd.join("session.json"), format!("\u{feff}{}", head.replace('\n', "\r\n"))).unwrap();
    rewrite(&odd, |lines| {
        let mut bytes = b"\xef\xbb\xbf".to_vec();
        for line in lines {
            bytes.extend([&line[..], b"\r\n\r\n \t\r\n"].concat());
        }
        bytes
    });
    assert_eq!(dropj(dir.path(), ["agree", "odd"]).succeeded(), wanted);
    let ran = dropj(dir.path(), ["repair", "odd"]);
    assert!(ran.succeeded().contains("nothing to repair"), "{ran:?}");
    let mut store = SessionStore::open(&odd, None).unwrap();
    let query = ask(&mut store, 0, AT + 1000);
    answer(&mut store, query, LEFT, "anna", AT + 1001);
    drop(store);
    assert_eq!(SessionStore::open(&odd, None).unwrap().session().answers().len(), 9, "it goes on");
}

#[test]
fn zeros_that_a_crash_left_at_the_end_are_cut_off() {
    let dir = tempfile::tempdir().unwrap();
    let path = session(dir.path(), "anna");
    for end in ["", "\n"] {
        rewrite(&path, |lines| [joined(&lines), vec![0; 700], end.into()].concat());
        let store = SessionStore::open(&path, None).unwrap();
        assert_eq!((store.session().answers().len(), store.torn().is_some()), (8, true));
    }
}

/// A damaged log, whose lines are changed so.
type Damage = (&'static str, fn(Vec<Vec<u8>>) -> Vec<u8>);

#[test]
fn a_damaged_log_is_refused_with_a_way_on_and_repaired_without_losing_an_answer() {
    let damages: [Damage; 8] = [
        ("zeros before a line", |mut lines| {
            lines[9] = [vec![0; 200], lines[9].clone()].concat();
            joined(&lines)
        }),
        ("a line of zeros", |mut lines| {
            lines.insert(9, vec![0; 200]);
            joined(&lines)
        }),
        ("half a line before a line", |mut lines| {
            lines[9] = [lines[9][..40].to_vec(), lines[9].clone()].concat();
            joined(&lines)
        }),
        ("two lines in one", |mut lines| {
            let next = lines.remove(10);
            lines[9].extend(next);
            joined(&lines)
        }),
        ("two halves at the end", |lines| {
            [joined(&lines), b"{\"event\":\"ask\n{\"event\":\"ans".to_vec()].concat()
        }),
        ("half a line before the last", |mut lines| {
            let last = lines.len() - 1;
            lines[last] = [b"{\"event\":\"ans".to_vec(), lines[last].clone()].concat();
            joined(&lines)
        }),
        ("marks of a merge", |mut lines| {
            lines.insert(5, b"<<<<<<< HEAD".to_vec());
            lines.extend([b"=======".to_vec(), b">>>>>>> theirs".to_vec()]);
            joined(&lines)
        }),
        ("an event of a later program", |mut lines| {
            lines.insert(5, br#"{"event":"sung","seq":5,"at":0}"#.to_vec());
            joined(&lines)
        }),
    ];
    let dir = tempfile::tempdir().unwrap();
    let plain = session(dir.path(), "anna");
    let whole = SessionStore::read(&plain).unwrap().1;
    for (what, damage) in damages {
        let broken = copy(&plain, &dir.path().join(what));
        rewrite(&broken, damage);
        let damaged = std::fs::read(broken.join("events.jsonl")).unwrap();
        let refused = SessionStore::open(&broken, None).unwrap_err().to_string();
        assert!(refused.contains("dropj repair"), "{what}: {refused}");
        assert_eq!(std::fs::read(broken.join("events.jsonl")).unwrap(), damaged, "{what}: it is not cut");

        let ran = dropj(dir.path(), ["repair", what, "--dry-run"]);
        assert!(
            ran.succeeded().contains("line ") && ran.out.contains("nothing was changed"),
            "{what}: {ran:?}"
        );
        assert_eq!(
            std::fs::read(broken.join("events.jsonl")).unwrap(),
            damaged,
            "{what}: that was no repair"
        );
        let ran = dropj(dir.path(), ["repair", what]);
        assert!(ran.succeeded().starts_with("line "), "{what}: {ran:?}");
        assert_eq!(SessionStore::read(&broken).unwrap().1, whole, "{what}");
        assert_eq!(std::fs::read(broken.join("events.jsonl.before-repair")).unwrap(), damaged, "{what}");
    }
    let ran = dropj(dir.path(), ["agree", "marks of a merge"]);
    assert_eq!(ran.succeeded(), dropj(dir.path(), ["agree", "s"]).succeeded());
}

#[test]
fn a_session_that_is_open_is_not_repaired() {
    let dir = tempfile::tempdir().unwrap();
    let path = session(dir.path(), "anna");
    let open = SessionStore::open(&path, None).unwrap();
    rewrite(&path, |lines| [joined(&lines), b"{\n".to_vec()].concat());
    assert!(dropj(dir.path(), ["repair", "s"]).refused().contains("another program has it open"));
    drop(open);
    dropj(dir.path(), ["repair", "s"]).succeeded();
}

#[test]
fn an_emptied_or_missing_log_leaves_the_dreams() {
    let dir = tempfile::tempdir().unwrap();
    let plain = session(dir.path(), "anna");
    for is_missing in [false, true] {
        let lost = copy(&plain, &dir.path().join(format!("lost-{is_missing}")));
        let log = lost.join("events.jsonl");
        if is_missing {
            std::fs::remove_file(&log).unwrap();
            assert!(dropj(&lost, ["agree", "."]).refused().contains("events.jsonl"));
        } else {
            std::fs::write(&log, "").unwrap();
        }
        let ran = dropj(&lost, ["repair", "."]);
        assert!(ran.succeeded().contains("dream 2 is put in from its file"), "{ran:?}");
        let store = SessionStore::open(&lost, None).unwrap();
        assert_eq!(
            store.dream(DreamId(1)).unwrap(),
            SessionStore::open(&plain, None).unwrap().dream(DreamId(1)).unwrap()
        );
    }
    let folder = copy(&plain, &dir.path().join("folder"));
    std::fs::remove_file(folder.join("events.jsonl")).unwrap();
    std::fs::create_dir(folder.join("events.jsonl")).unwrap();
    for command in ["agree", "repair"] {
        assert!(dropj(dir.path(), [command, "folder"]).refused().contains("folder/events.jsonl"));
    }
    std::fs::create_dir(dir.path().join("photos")).unwrap();
    assert!(dropj(dir.path(), ["repair", "photos"]).refused().contains("this is no session"));
}

#[test]
fn a_header_that_cannot_be_is_one_clear_sentence() {
    let dir = tempfile::tempdir().unwrap();
    let path = session(dir.path(), "anna").join("session.json");
    let whole = std::fs::read_to_string(&path).unwrap();
    for (text, wanted) in [
        (String::new(), "it is empty"),
        ("\0".repeat(544), "nothing but zeros"),
        ("{".to_owned(), "EOF while parsing"),
        (
            whole.replace("\"seed\": 7", "\"seed\": 18446744073709551616"),
            "its \"seed\" is not a whole number",
        ),
        (whole.replace("\"format\": 3", "\"format\": 0"), "it is of format 0"),
        (whole.replace("\"format\": 3", "\"format\": 9"), "this is a session of format 9"),
        (whole.replace("\"seed\"", "\"mood\": 1, \"seed\""), "unknown field `mood`"),
        (whole.replace("0.75", "0.5"), "must be above 0.5"),
    ] {
        std::fs::write(&path, text).unwrap();
        let line = SessionStore::read(&dir.path().join("s")).unwrap_err().to_string();
        assert!(line.contains(wanted) && line.contains("s/session.json"), "{line}");
    }
    assert!(dropj(dir.path(), ["agree", "s"]).refused().contains("must be above 0.5"));
    std::fs::write(&path, whole.replace("car-racing", "lunar-lander")).unwrap();
    dropj(dir.path(), ["agree", "s"]).succeeded();
    let ran = dropj(dir.path(), ["deploy", "--session", "s"]);
    assert!(ran.refused().contains("\"lunar-lander\" is not a world of this program"), "{ran:?}");
}

#[test]
fn a_damaged_header_is_repaired_and_a_lost_one_made_anew() {
    let dir = tempfile::tempdir().unwrap();
    let session = session(dir.path(), "anna");
    let (path, answers) = (session.join("session.json"), SessionStore::read(&session).unwrap().1);
    let whole = std::fs::read_to_string(&path).unwrap();
    let odd = whole.replace("\"seed\": 7", "\"mood\": 1, \"seed\": 18446744073709551616");
    std::fs::write(&path, &odd).unwrap();
    let ran = dropj(dir.path(), ["repair", "s"]);
    assert!(ran.succeeded().contains("its \"seed\" is 0 from here on"), "{ran:?}");
    assert!(ran.out.contains("\"mood\" is left out"), "{ran:?}");
    assert_eq!(std::fs::read_to_string(session.join("session.json.before-repair")).unwrap(), odd);
    assert_eq!(Header::read(&session).unwrap().seed, 0);

    std::fs::write(&path, "\0".repeat(500)).unwrap();
    assert!(dropj(dir.path(), ["repair", "s"]).refused().contains("--world"));
    dropj(dir.path(), ["repair", "s", "--world", "world.safetensors"]).succeeded();
    let (header, found) = SessionStore::read(&session).unwrap();
    assert_eq!((found, header.world_model), (answers, model(1).hash()));
    assert!(session.join("session.json.before-repair-2").exists(), "what was kept before is still kept");
    std::fs::write(&path, whole.replace("\"format\": 3", "\"format\": 9")).unwrap();
    assert!(
        dropj(dir.path(), ["repair", "s"]).refused().contains("of format 9"),
        "that is for a later program"
    );
}

#[test]
fn a_moved_session_finds_its_world_model_and_every_command_can_be_told() {
    let dir = tempfile::tempdir().unwrap();
    let plain = session(&dir.path().join("made"), "anna");
    let moved = copy(&plain, &dir.path().join("moved/s"));
    let world = dir.path().join("made/world.safetensors");
    let commands: [&[&str]; 4] = [
        &["replay", "moved/s"],
        &["refit", "--session", "moved/s", "--updates", "3"],
        &["check-reward", "--session", "moved/s", "--on", "moved/s"],
        &["screen", "moved/s"],
    ];
    for command in commands {
        let ran = dropj(dir.path(), command);
        let line = ran.refused();
        assert!(line.contains(&model(1).hash()) && line.contains("--world"), "{line}");
        let told = command.iter().copied().chain(["--world", world.to_str().unwrap()]);
        dropj(dir.path(), told).succeeded();
    }
    std::fs::write(dir.path().join("other.safetensors"), model(2).parameters().bytes()).unwrap();
    for command in commands {
        let told = command.iter().copied().chain(["--world", "other.safetensors"]);
        let ran = dropj(dir.path(), told);
        let line = ran.refused();
        assert!(line.contains(&model(1).hash()) && line.contains(&model(2).hash()), "{line}");
    }
    // Beside it, where a hint leads elsewhere.
    std::fs::create_dir(dir.path().join("moved/neighbor")).unwrap();
    std::fs::copy(&world, dir.path().join("moved/neighbor/world_model.safetensors")).unwrap();
    for hint in ["dreams", "../../other.safetensors", "/nowhere/world.safetensors"] {
        let header = std::fs::read_to_string(plain.join("session.json")).unwrap();
        std::fs::write(moved.join("session.json"), header.replace("../world.safetensors", hint)).unwrap();
        dropj(dir.path(), ["replay", "moved/s"]).succeeded();
    }
    // A session that is made from it knows the way.
    let merged = merge(&[moved.clone(), moved], &dir.path().join("merged")).unwrap();
    assert_eq!(merged.world_model().unwrap().hash(), model(1).hash());
}

#[test]
fn what_is_not_needed_need_not_be_there() {
    let dir = tempfile::tempdir().unwrap();
    let path = session(dir.path(), "anna");
    dropj(dir.path(), ["refit", "--session", "s", "--updates", "3"]).succeeded();
    // A third dream about which something was skipped, and which was deleted.
    let mut store = SessionStore::open(&path, None).unwrap();
    let third = store.save_dream(&dream(&model(1), 3), DreamSource::User).unwrap();
    let query = ask(&mut store, third.0, AT + 1000);
    answer(&mut store, query, SKIPPED, "anna", AT + 1001);
    store.record(Event::DreamDropped { dream: third }).unwrap();
    drop(store);
    dropj(dir.path(), ["replay", "s", "--record"]).succeeded();
    std::fs::remove_file(path.join("dreams/0002.safetensors")).unwrap();
    let ran = dropj(dir.path(), ["replay", "s", "--check"]);
    assert!(ran.succeeded().contains("dream 3, which was deleted, cannot be read any more"), "{ran:?}");
    std::fs::remove_file(path.join("reward/0000.safetensors")).unwrap();
    let looks: [(&[u8], &str); 3] =
        [(b"{", "EOF"), (b"{\"99/0\":\"00\"}", "99/0"), (b"{\"1/3\":\"\xc3\xa90\xc3\xa9\"}", "hexadecimal")];
    for (clips, wanted) in looks {
        std::fs::write(path.join("clips.json"), clips).unwrap();
        let line = dropj(dir.path(), ["replay", "s", "--check"]).refused().to_owned();
        assert!(line.contains(wanted) && line.contains("replay --record"), "{line}");
    }
    dropj(dir.path(), ["agree", "s"]).succeeded();
    dropj(dir.path(), ["replay", "s"]).succeeded();
    dropj(dir.path(), ["screen", "s"]).succeeded();
    dropj(dir.path(), ["merge", "s", "s", "--out", "merged"]).succeeded();
    dropj(dir.path(), ["hand-on", "s", "--annotator", "ben", "--out", "handed"]).succeeded();
    assert!(dropj(dir.path(), ["deploy", "--session", "s"]).refused().contains("s/reward/0000.safetensors"));
    assert!(
        dropj(dir.path(), ["check-reward", "--session", "s", "--on", "s"]).refused().contains("reward/0000")
    );
    dropj(dir.path(), ["refit", "--session", "s", "--updates", "3"]).succeeded();
    dropj(dir.path(), ["check-reward", "--session", "s", "--on", "merged"]).succeeded();
}

#[test]
fn names_are_shown_safely_on_the_terminal_and_in_tables() {
    let dir = tempfile::tempdir().unwrap();
    let path = session(dir.path(), "anna");
    let mut before = "anna".to_owned();
    let long = "x".repeat(5000);
    for (name, seen, cell) in [
        ("Smith, J. \"JJ\"", "Smith, J. \"JJ\" ", "\"Smith, J. \"\"JJ\"\"\","),
        ("two\nlines", r"two\nlines ", r"two\nlines,"),
        ("=1+1", "=1+1 ", "'=1+1,"),
        ("用户—Ж", "用户—Ж ", "用户—Ж,"),
        ("", "\"\" ", ","),
        (&long, &format!("{}… ", "x".repeat(60)), &format!("{long},")),
        ("a\u{1b}[31mred\u{7}", r"a\u{1b}[31mred\u{7} ", r"a\u{1b}[31mred\u{7},"),
        ("\u{202e}abc", r"\u{202e}abc ", r"\u{202e}abc,"),
    ] {
        rename(&path, &before, name);
        name.clone_into(&mut before);
        let ran = dropj(dir.path(), ["agree", "s", "--csv", "agree.csv"]);
        let line = ran.succeeded().lines().nth(1).unwrap();
        assert!(line.starts_with(seen), "{line}");
        let table = std::fs::read_to_string(dir.path().join("agree.csv")).unwrap();
        assert_eq!(table.lines().count(), 2, "{table}");
        assert!(table.lines().nth(1).unwrap().starts_with(cell), "{table}");
        let labels = dir.path().join("labels.csv");
        SessionStore::open(&path, None).unwrap().export_labels(&labels).unwrap();
        let table = std::fs::read_to_string(labels).unwrap();
        assert_eq!(table.lines().count(), 9, "{table}");
        assert!(table.contains(cell), "{table}");
    }
}

#[test]
fn answers_that_stand_in_several_sessions_count_once() {
    let dir = tempfile::tempdir().unwrap();
    let path = session(dir.path(), "anna");
    copy(&path, &dir.path().join("copy/s"));
    let labeled = |name: &str| SessionStore::read(&dir.path().join(name)).unwrap().1.labeled().len();
    for (sessions, out) in [
        (["s", "s"], "twice"),
        (["s", "copy/s"], "with-copy"),
        (["twice", "s"], "again"),
        (["copy/s", "again"], "chain"),
    ] {
        let ran = dropj(dir.path(), ["merge", sessions[0], sessions[1], "--out", out]);
        assert!(ran.succeeded().contains("8 queries stood in several"), "{ran:?}");
        assert_eq!(labeled(out), 7, "{out}");
    }
    let ran = dropj(dir.path(), ["agree", "s", "copy/s", "chain"]);
    assert_eq!(ran.succeeded(), dropj(dir.path(), ["agree", "s"]).succeeded());
    assert!(ran.err.contains("the answers of copy/s all stand in the sessions before it"), "{ran:?}");

    // Somebody else's answers to the same are others, in whatever order and however often they are put together.
    let mut ben = hand_on(&path, &dir.path().join("ben"), "ben").unwrap();
    for query in 0..8 {
        answer(&mut ben, QueryId(query), LEFT, "ben", AT + 5000);
    }
    drop(ben);
    for (sessions, out) in [(["s", "ben"], "both"), (["both", "s"], "both-2"), (["ben", "both-2"], "both-3")]
    {
        dropj(dir.path(), ["merge", sessions[0], sessions[1], "--out", out]).succeeded();
        assert_eq!(labeled(out), 15, "{out}");
    }
    // Who is handed what two have answered is asked once.
    let handed = hand_on(&dir.path().join("both-3"), &dir.path().join("cem"), "cem").unwrap();
    assert_eq!(handed.session().pending().count(), 8);
}

#[test]
fn two_copies_that_went_on_are_put_together_without_saying_anything_twice() {
    let dir = tempfile::tempdir().unwrap();
    let here = session(dir.path(), "anna");
    let there = copy(&here, &dir.path().join("there"));
    let mut store = SessionStore::open(&here, None).unwrap();
    let query = ask(&mut store, 0, AT + 1000);
    answer(&mut store, query, LEFT, "anna", AT + 1001);
    store.record_at(Event::Retracted { query: QueryId(0) }, AT + 1002).unwrap();
    drop(store);
    let mut store = SessionStore::open(&there, None).unwrap();
    let query = ask(&mut store, 1, AT + 2000);
    answer(&mut store, query, RIGHT, "anna", AT + 2001);
    answer(&mut store, QueryId(0), RIGHT, "anna", AT + 2002);
    answer(&mut store, QueryId(1), EQUAL, "ben", AT + 2003);
    drop(store);
    for (dirs, out) in [([&here, &there], "one"), ([&there, &here], "other")] {
        let merged = merge(&dirs.map(Clone::clone), &dir.path().join(out)).unwrap();
        let session = merged.session();
        assert_eq!(session.queries().len(), 10, "{out}: eight of both and one of each");
        let said = |query: u32| session.query(QueryId(query)).unwrap().answer().unwrap().answer.response;
        assert_eq!(said(0), RIGHT, "{out}: what one person said last");
        assert_eq!(said(1), EQUAL, "{out}: what was added");
    }
}

#[test]
fn equal_names_are_told_apart_by_their_sessions() {
    let dir = tempfile::tempdir().unwrap();
    let [one, other] = ["monday", "tuesday"].map(|day| session(&dir.path().join(day), "anonymous"));
    rewrite(&other, |lines| {
        let text = String::from_utf8(joined(&lines)).unwrap();
        text.replace("\"secs\":4.0", "\"secs\":5.0").into_bytes()
    });
    let ran = dropj(dir.path(), ["agree", "monday/s", "tuesday/s"]);
    assert!(ran.succeeded().contains("anonymous in monday/s – anonymous in tuesday/s"), "{ran:?}");
    for path in [&one, &other] {
        rename(path, "anonymous", "anna");
    }
    let ran = dropj(dir.path(), ["agree", "monday/s", "tuesday/s"]);
    assert!(ran.err.contains("anna in monday/s and tuesday/s is taken for one person"), "{ran:?}");
    let ran = dropj(dir.path(), ["agree", "monday/s", "tuesday/s", "--by-session"]);
    assert!(ran.succeeded().contains("monday/s – tuesday/s"), "{ran:?}");
    let ran = dropj(dir.path(), ["check-reward", "--session", "monday/s", "--on", "tuesday/s", "monday/s"]);
    assert!(ran.refused().contains("no reward yet"), "{ran:?}");
    let ran = dropj(dir.path(), ["screen", "monday/s", "tuesday/s", "--csv", "screen.csv"]);
    ran.succeeded();
    let table = std::fs::read_to_string(dir.path().join("screen.csv")).unwrap();
    assert!(table.contains("\nmonday/s,") && table.contains("\ntuesday/s,"), "{table}");
}

#[test]
fn times_that_cannot_be_make_no_absurd_figures() {
    let dir = tempfile::tempdir().unwrap();
    let path = session(dir.path(), "anna");
    rewrite(&path, |lines| {
        let entries = lines.iter().enumerate().map(|(i, line)| {
            let mut entry: serde_json::Value = serde_json::from_slice(line).unwrap();
            entry["at"] = match i {
                3 | 4 => u64::MAX.into(),
                _ => (1_000_000_000_000 - 3_600_000 * i as u64).into(),
            };
            if entry.get("secs").is_some() {
                entry["secs"] = 3e38.into();
            }
            entry.to_string().into_bytes()
        });
        joined(&entries.collect::<Vec<_>>())
    });
    let header = Header { created_at: u64::MAX, ..Header::read(&path).unwrap() };
    std::fs::write(path.join("session.json"), serde_json::to_string(&header).unwrap()).unwrap();
    assert!(header.folder_name().ends_with("-dropj"), "{}", header.folder_name());
    let ran = dropj(dir.path(), ["agree", "s"]);
    let line = ran.succeeded().lines().nth(1).unwrap();
    // Seven answers in eight minutes.
    assert!(line.contains(" 52 ") && line.contains(" 60.0 ") && !line.contains("inf"), "{line}");
    let (_, session) = SessionStore::read(&path).unwrap();
    assert_eq!(session.statistics().active_secs, 480.0);
    dropj(dir.path(), ["replay", "s"]).succeeded();
    dropj(dir.path(), ["merge", "s", "s", "--out", "merged"]).succeeded();
    let found = Annotators::of(&[(None, &session)]);
    assert_eq!(found.each[0].median_secs, Some(60.0));
}

#[test]
fn a_repaired_session_never_writes_over_a_dream() {
    let dir = tempfile::tempdir().unwrap();
    let path = session(dir.path(), "anna");
    let second = std::fs::read(path.join("dreams/0001.safetensors")).unwrap();
    std::fs::remove_file(path.join("dreams/0000.safetensors")).unwrap();
    rewrite(&path, |lines| joined(&lines[1..]));
    let ran = dropj(dir.path(), ["repair", "s"]);
    assert!(ran.succeeded().contains("of which the line and the file are lost"), "{ran:?}");
    let mut store = SessionStore::open(&path, None).unwrap();
    assert_eq!(store.session().answers().len(), 4, "those about the second dream");
    let next = store.save_dream(&dream(&model(1), 9), DreamSource::User).unwrap();
    assert_eq!(next, DreamId(1));
    assert_eq!(std::fs::read(path.join("dreams/0001.safetensors")).unwrap(), second);
    assert_ne!(store.dream(DreamId(0)).unwrap(), store.dream(DreamId(1)).unwrap());
}

#[test]
fn what_is_written_to_a_log_is_what_the_lines_say() {
    let dir = tempfile::tempdir().unwrap();
    let path = session(dir.path(), "anna");
    let bytes = std::fs::read(path.join("events.jsonl")).unwrap();
    let contents = dropj::session::log::parse(&bytes, &path).unwrap();
    let lines: Vec<_> = contents.entries.iter().map(Entry::to_line).collect();
    assert_eq!(lines.join("\n") + "\n", String::from_utf8(bytes).unwrap());
}
