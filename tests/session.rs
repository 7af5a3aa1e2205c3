//! Sessions on disk: what a killed program, a full disk, another model or another writer can and cannot do.
#![expect(clippy::unwrap_used, reason = "a failing test may panic")]

use std::io::{BufRead as _, BufReader};
use std::ops::ControlFlow;
use std::path::Path;
use std::process::{Command, Stdio};

use dropj::dream::{Dream, DreamEpisode};
use dropj::query::{
    DreamId, LabeledQuery, Preference, Protocol, Query, QueryId, Response, SafetyAnswer, SegmentRef, Weights,
    sample_queries,
};
use dropj::reward::{RewardConfig, RewardEnsemble, RewardInputs, SegmentPair, Trainer, segment_rows};
use dropj::session::{
    Annotators, Answer, Choice, DreamSource, Event, FORMAT, Fit, Header, SessionError, SessionStore, hand_on,
    latest, list_sessions, merge, replay,
};
use dropj::tensor::Parameters;
use dropj::world::Action;
use dropj::world_model::{LatentState, WorldModel, WorldModelConfig, untrained};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

/// 2026-11-22, a quarter past ten.
const AT: u64 = 1_795_342_500_000;

fn model(seed: u64) -> WorldModel {
    untrained(&WorldModelConfig::tiny(), &mut ChaCha8Rng::seed_from_u64(seed))
}

fn dream(model: &WorldModel, len: usize, seed: u64) -> DreamEpisode {
    let start = LatentState { z: vec![0.1; 4], c: vec![0.0; 16], h: vec![0.0; 16] };
    let mut dream = Dream::new(&start, seed);
    let rng = &mut ChaCha8Rng::seed_from_u64(seed);
    for t in 0..len {
        dream.step(model, Action::new([(t as f32).sin(), 0.5, 0.0]), rng).unwrap();
    }
    dream.mark_unsafe();
    dream.finish()
}

fn header(model: &WorldModel) -> Header {
    Header::new("dummy-road", Protocol::Dropj, 7, &model.hash(), AT)
}

fn ask(store: &mut SessionStore, n: usize) -> Vec<Query> {
    let rng = &mut ChaCha8Rng::seed_from_u64(3);
    let session = store.session();
    let queries = sample_queries(&session.dream_lens(), n, session.next_query_id(), rng);
    for &Query { id: query, left, right } in &queries {
        store.record(Event::Asked { query, left, right, choice: Choice::Uniform }).unwrap();
    }
    queries
}

fn answered(query: QueryId, safety: SafetyAnswer) -> Event {
    Event::Answered(Answer::new(query, Response::Safety(safety), 4.5, "anna, the \"first\""))
}

/// A session with two dreams and four queries, of which three have answers and two labels.
fn small(dir: &Path, model: &WorldModel) -> SessionStore {
    let mut store = SessionStore::create(dir, header(model)).unwrap();
    store.save_dream(&dream(model, 40, 1), DreamSource::User).unwrap();
    store.save_dream(&dream(model, 25, 2), DreamSource::Simulated).unwrap();
    let queries = ask(&mut store, 4);
    store.record(answered(queries[0].id, SafetyAnswer::OnlyLeft)).unwrap();
    store.record(answered(queries[1].id, SafetyAnswer::Both(Preference::Right))).unwrap();
    let skip = Answer::new(queries[2].id, Response::Skipped(None), 2.0, "anna");
    store.record(Event::Answered(skip)).unwrap();
    store
}

#[test]
fn a_session_opens_to_the_state_it_was_left_in() {
    let (dir, model) = (tempfile::tempdir().unwrap(), model(1));
    let dir = dir.path().join("s");
    let mut store = small(&dir, &model);
    let fit = Fit { after: 9, n_labels: 2, seed: 5, epochs: 3, losses: vec![0.1, 0.2, 0.3], held_out: None };
    store.save_reward(model.parameters(), fit).unwrap();
    let left = store.session().clone();
    drop(store);
    let mut store = SessionStore::open(&dir, Some(model.identity())).unwrap();
    assert_eq!(*store.session(), left);
    assert_eq!(store.torn(), None);
    assert_eq!(store.session().pending().map(|asked| asked.query.id).collect::<Vec<_>>(), [QueryId(3)]);
    assert_eq!(store.reward().unwrap().unwrap().hash(), model.hash());
    let kept = DreamEpisode { unsafe_marks: vec![], ..dream(&model, 40, 1) };
    assert_eq!(store.dream(DreamId(0)).unwrap(), kept, "the mark after the last step marks nothing");
    store.record(Event::Retracted { query: QueryId(1) }).unwrap();
    assert_eq!(store.session().labeled().len(), 1);
}

#[test]
fn a_replay_reads_every_dream_and_clip_and_writes_nothing() {
    let (dir, model) = (tempfile::tempdir().unwrap(), model(1));
    let dir = dir.path().join("s");
    let mut store = small(&dir, &model);
    let after = store.session().n_entries();
    let fit = Fit { after, n_labels: 2, seed: 5, epochs: 3, losses: vec![0.1], held_out: Some(0.2) };
    store.save_reward(model.parameters(), fit).unwrap();
    store.record(answered(QueryId(3), SafetyAnswer::Neither)).unwrap();
    let labeled_at_the_fit = 2;
    // The session is still open: reading needs no lock.
    let replayed = replay(&dir, &model).unwrap();
    assert_eq!(replayed.session, *store.session());
    assert_eq!(replayed.fits[0].labels.len(), labeled_at_the_fit);
    assert_eq!(replayed.session.labeled().len(), 3);
    assert_eq!(replayed.clips, replay(&dir, &model).unwrap().clips);
    let asked = store.session().queries().iter().map(|asked| asked.query.left);
    for SegmentRef { dream, start } in asked {
        assert!(replayed.clips.contains_key(&(dream, start)), "dream {} from {start}", dream.0);
    }
}

#[test]
fn a_reward_that_is_learned_again_has_the_losses_of_the_log() {
    let (dir, model) = (tempfile::tempdir().unwrap(), model(1));
    let dir = dir.path().join("s");
    let mut store = small(&dir, &model);
    let (after, seed) = (store.session().n_entries(), 5);
    let rng = &mut ChaCha8Rng::seed_from_u64(seed);
    let config = RewardConfig::tiny();
    let epochs = config.epochs(store.session().labeled().len()) as u32;
    let mut trainer = Trainer::new(RewardEnsemble::new(RewardInputs::of(&model), config, rng));
    let labeled = store.session().labeled();
    for LabeledQuery { query, label } in &labeled {
        let rows = |segment: SegmentRef| {
            let episode = store.dream(segment.dream).unwrap();
            segment_rows(&episode.features(&model), &episode.actions, model.ranges(), segment)
        };
        trainer.predict_and_add(&SegmentPair {
            left: rows(query.left),
            right: rows(query.right),
            label: *label,
        });
    }
    let mut losses = Vec::new();
    let done = trainer.fit(rng, |report| {
        losses = report.losses.iter().map(|loss| *loss as f32).collect();
        ControlFlow::Continue(())
    });
    assert!(done.unwrap().is_continue(), "nobody stops it");
    let fit = Fit { after, n_labels: labeled.len(), seed, epochs, losses: losses.clone(), held_out: None };
    store.record(answered(QueryId(3), SafetyAnswer::Neither)).unwrap();
    store.save_reward(&trainer.ensemble().parameters(), fit).unwrap();
    let replayed = replay(&dir, &model).unwrap();
    let again = replayed.refit(&model, &replayed.fits[0]).unwrap();
    assert_eq!(again, losses, "the same processor computes the same");
    assert!(replayed.fits[0].agrees(&again), "and that is within the tolerance");
    assert!(!replayed.fits[0].agrees(&[losses[0] + 0.1, losses[1]]), "another loss is not");
}

#[test]
fn another_world_model_is_refused_with_both_hashes() {
    let (dir, mine, other) = (tempfile::tempdir().unwrap(), model(1), model(2));
    let dir = dir.path().join("s");
    drop(small(&dir, &mine));
    let refused = SessionStore::open(&dir, Some(other.identity())).unwrap_err().to_string();
    assert!(refused.contains(&mine.hash()) && refused.contains(&other.hash()), "{refused}");
    assert!(replay(&dir, &other).is_err(), "a replay looks too");
    let store = SessionStore::open(&dir, None).unwrap();
    assert!(store.save_world_model(&other).is_err(), "a copy of another model is refused");
    assert!(matches!(store.world_model(), Err(SessionError::NoWorldModel { .. })));
    store.save_world_model(&mine).unwrap();
    assert_eq!(store.world_model().unwrap().hash(), mine.hash());
}

#[test]
fn a_session_has_one_writer_until_it_is_closed() {
    let (dir, model) = (tempfile::tempdir().unwrap(), model(1));
    let dir = dir.path().join("s");
    let first = small(&dir, &model);
    let refused = SessionStore::open(&dir, None).unwrap_err();
    assert!(matches!(refused, SessionError::InUse { .. }), "{refused}");
    drop(first);
    assert!(SessionStore::open(&dir, None).is_ok());
}

#[test]
fn a_log_cut_anywhere_in_its_last_line_opens_without_that_line() {
    let (dir, model) = (tempfile::tempdir().unwrap(), model(1));
    let dir = dir.path().join("s");
    drop(small(&dir, &model));
    let log = dir.join("events.jsonl");
    let whole = std::fs::read(&log).unwrap();
    let last = whole[..whole.len() - 1].iter().rposition(|&byte| byte == b'\n').unwrap() + 1;
    for len in last..whole.len() - 1 {
        std::fs::write(&log, &whole[..len]).unwrap();
        let store = SessionStore::open(&dir, None).unwrap();
        assert_eq!(store.session().answers().len(), 2, "cut at {len}");
        assert_eq!(store.torn().is_some(), len > last, "cut at {len}");
    }
}

#[test]
fn a_line_that_cannot_be_is_named() {
    let (dir, model) = (tempfile::tempdir().unwrap(), model(1));
    let dir = dir.path().join("s");
    drop(small(&dir, &model));
    let log = dir.join("events.jsonl");
    let text = std::fs::read_to_string(&log).unwrap();
    std::fs::write(&log, text.replace("\"answered\",\"query\":1", "\"answered\",\"query\":9")).unwrap();
    let refused = SessionStore::open(&dir, None).unwrap_err().to_string();
    assert!(
        refused.starts_with("line 8 of the session log cannot be: query 9 was never asked: "),
        "{refused}"
    );
    std::fs::write(&log, text.replace("\"answered\",\"query\":1", "\"answered\",\"qu\"ry\":1")).unwrap();
    let refused = SessionStore::open(&dir, None).unwrap_err().to_string();
    assert!(refused.starts_with("line 8 of the session log is not an event: it is not JSON"), "{refused}");
}

#[test]
fn what_the_disk_refuses_has_not_happened() {
    let (dir, model) = (tempfile::tempdir().unwrap(), model(1));
    let dir = dir.path().join("s");
    let mut store = small(&dir, &model);
    let before = store.session().clone();
    // A file where the folder should be refuses every user, root included.
    std::fs::remove_dir_all(dir.join("dreams")).unwrap();
    std::fs::write(dir.join("dreams"), "").unwrap();
    let refused = store.save_dream(&dream(&model, 30, 3), DreamSource::User).unwrap_err().to_string();
    assert!(refused.starts_with("cannot save a dream: "), "{refused}");
    let impossible = store.record(answered(QueryId(9), SafetyAnswer::Neither)).unwrap_err().to_string();
    assert_eq!(impossible, "cannot record this: query 9 was never asked");
    assert_eq!(*store.session(), before);
    drop(store);
    assert_eq!(*SessionStore::open(&dir, None).unwrap().session(), before);
}

#[test]
fn a_dream_that_was_changed_on_disk_is_refused() {
    let (dir, model) = (tempfile::tempdir().unwrap(), model(1));
    let dir = dir.path().join("s");
    let store = small(&dir, &model);
    let file = dir.join("dreams/0001.safetensors");
    let mut bytes = std::fs::read(&file).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    std::fs::write(&file, bytes).unwrap();
    assert!(matches!(store.dream(DreamId(1)), Err(SessionError::Changed { .. })));
    assert!(replay(&dir, &model).is_err(), "a replay looks too");
}

#[test]
fn a_dream_that_was_cut_short_is_offered_and_can_be_kept() {
    let (dir, model) = (tempfile::tempdir().unwrap(), model(1));
    let dir = dir.path().join("s");
    let mut store = small(&dir, &model);
    let whole = dream(&model, 30, 9);
    let journal = store.journal(&whole, DreamSource::User).unwrap();
    assert_eq!(store.unfinished_dreams().unwrap(), [], "it is being driven");
    drop(journal);
    let mut unfinished = store.unfinished_dreams().unwrap();
    assert_eq!(unfinished[0].episode, whole);
    let id = store.recover(unfinished.remove(0)).unwrap();
    assert_eq!(store.dream(id).unwrap().zs, whole.zs);
    assert_eq!(store.unfinished_dreams().unwrap(), []);
}

#[test]
fn a_journal_that_outlived_the_keeping_of_its_dream_is_not_offered() {
    let (dir, model) = (tempfile::tempdir().unwrap(), model(1));
    let mut store = SessionStore::create(&dir.path().join("s"), header(&model)).unwrap();
    let episode = dream(&model, 30, 9);
    drop(store.journal(&episode, DreamSource::User).unwrap());
    store.save_dream(&episode, DreamSource::User).unwrap();
    assert_eq!(store.unfinished_dreams().unwrap(), []);
    let left: Vec<_> = std::fs::read_dir(store.dir().join("dreams")).unwrap().collect();
    assert_eq!(left.len(), 1, "the journal is gone");
}

#[test]
fn new_sessions_never_lie_over_old_ones() {
    let (dir, model) = (tempfile::tempdir().unwrap(), model(1));
    let sessions = dir.path().join("sessions");
    let names = |store: &SessionStore| store.dir().file_name().unwrap().to_str().unwrap().to_owned();
    let first = SessionStore::create_in(&sessions, header(&model)).unwrap();
    let second = SessionStore::create_in(&sessions, header(&model)).unwrap();
    assert_eq!(names(&first), "2026-11-22T10-15-00-dropj");
    assert_eq!(names(&second), "2026-11-22T10-15-00-dropj-2");
    assert!(matches!(SessionStore::create(first.dir(), header(&model)), Err(SessionError::Exists { .. })));
}

#[test]
fn recent_sessions_come_latest_first_and_the_unreadable_last() {
    let (dir, model) = (tempfile::tempdir().unwrap(), model(1));
    let sessions = dir.path().join("sessions");
    assert!(list_sessions(&sessions).unwrap().is_empty());
    assert_eq!(latest(&sessions).unwrap().count(), 0);
    let mut early = SessionStore::create_in(&sessions, header(&model)).unwrap();
    let late =
        SessionStore::create_in(&sessions, Header { created_at: AT + 60_000, ..header(&model) }).unwrap();
    std::fs::create_dir(sessions.join("broken")).unwrap();
    std::fs::write(sessions.join("broken/session.json"), "{").unwrap();
    std::fs::create_dir(sessions.join("photos")).unwrap();
    let dirs = || -> Vec<_> {
        let dirs: Vec<_> = list_sessions(&sessions).unwrap().into_iter().map(|recent| recent.dir).collect();
        let one_by_one: Vec<_> = latest(&sessions).unwrap().map(|recent| recent.dir).collect();
        assert_eq!(one_by_one, dirs);
        dirs
    };
    assert_eq!(dirs(), [late.dir(), early.dir(), &sessions.join("broken")]);
    early.record_at(Event::WeightsChanged { weights: Weights::paper() }, AT + 120_000).unwrap();
    assert_eq!(dirs(), [early.dir(), late.dir(), &sessions.join("broken")]);
}

#[test]
fn labels_are_exported_as_they_were_said_and_as_they_weigh() {
    let (dir, model) = (tempfile::tempdir().unwrap(), model(1));
    let mut store = SessionStore::create(&dir.path().join("s"), header(&model)).unwrap();
    store.save_dream(&dream(&model, 20, 1), DreamSource::User).unwrap();
    ask(&mut store, 2);
    store.record_at(answered(QueryId(1), SafetyAnswer::Both(Preference::Right)), AT).unwrap();
    let skip = Answer::new(QueryId(0), Response::Skipped(None), 2.0, "anna");
    store.record_at(Event::Answered(skip), AT).unwrap();
    let path = dir.path().join("labels.csv");
    store.export_labels(&path).unwrap();
    let table = std::fs::read_to_string(&path).unwrap();
    let rows: Vec<_> = table.lines().collect();
    let names = rows[0].split(',').count();
    assert_eq!(
        rows[1],
        r#"1,0,0,0,0,uniform,DROPJ,,true,true,,right,0.25,4.5,0,"anna, the ""first""",false,,,1795342500000,,,"#
    );
    assert_eq!(rows[2], "0,0,0,0,0,uniform,DROPJ,yes,,,,,,2,0,anna,false,,,1795342500000,,,");
    assert_eq!(rows[2].split(',').count(), names);
}

#[test]
fn a_session_of_the_first_format_goes_on_in_this_one() {
    let (dir, model) = (tempfile::tempdir().unwrap(), model(1));
    let path = dir.path().join("s");
    drop(SessionStore::create(&path, header(&model)).unwrap());
    let head = std::fs::read_to_string(path.join("session.json")).unwrap();
    std::fs::write(path.join("session.json"), head.replace("\"format\": 3", "\"format\": 1")).unwrap();
    assert_eq!(Header::read(&path).unwrap().format, 1);
    let mut store = SessionStore::open(&path, None).unwrap();
    store.record(Event::ProtocolChanged { protocol: Protocol::Drop }).unwrap();
    assert_eq!(Header::read(&path).unwrap().format, FORMAT);
}

#[test]
fn parameters_come_back_as_they_went() {
    let (dir, model) = (tempfile::tempdir().unwrap(), model(1));
    let mut store = SessionStore::create(&dir.path().join("s"), header(&model)).unwrap();
    assert!(store.reward().unwrap().is_none(), "nothing was learned yet");
    let fit = Fit { after: 0, n_labels: 0, seed: 0, epochs: 0, losses: vec![], held_out: None };
    for parameters in [model.parameters(), self::model(2).parameters()] {
        store.save_reward(parameters, fit.clone()).unwrap();
        assert_eq!(store.reward().unwrap().as_ref().map(Parameters::hash), Some(parameters.hash()));
    }
    assert_eq!(store.session().fits()[1].file, "reward/0001.safetensors");
}

#[test]
fn sessions_of_two_annotators_are_made_from_the_same_queries_and_put_together_again() {
    let (dir, model) = (tempfile::tempdir().unwrap(), model(1));
    let [anna, ben, both] = ["anna", "ben", "both"].map(|name| dir.path().join(name));
    let mut first = small(&anna, &model);
    first.record(Event::ProtocolChanged { protocol: Protocol::Drop }).unwrap();
    first.save_world_model(&model).unwrap();
    let asked: Vec<_> = first.session().queries().iter().map(|asked| asked.query).collect();
    drop(first);

    let mut second = hand_on(&anna, &ben, "ben").unwrap();
    assert_eq!(second.header().config.annotator, "ben");
    assert_eq!(second.header().protocol, Protocol::Drop, "the questions asked last");
    let handed: Vec<_> = second.session().pending().map(|pending| pending.query).collect();
    assert_eq!(handed, asked[..3], "what was answered or skipped");
    second.record(Event::ProtocolChanged { protocol: Protocol::Dropj }).unwrap();
    for (query, safety) in [(0, SafetyAnswer::OnlyRight), (1, SafetyAnswer::Both(Preference::Right))] {
        let answer = Answer::new(QueryId(query), Response::Safety(safety), 3.0, "ben");
        second.record(Event::Answered(answer)).unwrap();
    }
    let mut own = dream(&model, 33, 9);
    own.unsafe_marks.clear();
    let own = second.save_dream(&own, DreamSource::User).unwrap();
    let segment = |start| SegmentRef { dream: own, start };
    let query = second.session().next_query_id();
    let asked_own = Event::Asked { query, left: segment(0), right: segment(9), choice: Choice::Uniform };
    second.record(asked_own).unwrap();
    let agreed =
        Annotators::of(&[(None, &SessionStore::read_reward(&anna).unwrap().0), (None, second.session())]);
    assert_eq!((agreed.pairs[0].1.n, agreed.pairs[0].1.n_same, agreed.pairs[0].1.n_critical), (2, 1, 1));
    drop(second);

    let merged = merge(&[anna.clone(), ben.clone()], &both).unwrap();
    let session = merged.session();
    assert_eq!(session.dreams().len(), 3, "two in common, and one of ben's own");
    assert_eq!(merged.dream(DreamId(2)).unwrap().len(), 33);
    assert_eq!((session.queries().len(), session.labeled().len()), (4 + 4, 2 + 2));
    assert_eq!(session.queries()[7].query.left, SegmentRef { dream: DreamId(2), start: 0 });
    assert_eq!(session.annotators().values().sum::<usize>(), 5);
    assert_eq!(merged.world_model().unwrap().hash(), model.hash(), "it is still found");
    assert_eq!(
        SessionStore::open(&anna, None).unwrap().session().queries().len(),
        4,
        "nothing is taken away"
    );
    drop(merged);
    assert_eq!(replay(&both, &model).unwrap().session.labeled().len(), 4);

    let foreign = dir.path().join("foreign");
    let other = self::model(2);
    drop(small(&foreign, &other));
    let refused = merge(&[anna, foreign], &dir.path().join("none")).unwrap_err().to_string();
    assert!(refused.contains("different world models"), "{refused}");
    assert!(!dir.path().join("none").exists(), "and nothing is begun");
}

/// Names the folder in which [`answers_until_it_is_killed`] works, when it is the child of another test.
const CHILD_DIR: &str = "DROPJ_TEST_SESSION";

/// Not a test of its own, but the program that the next one kills.
#[expect(clippy::print_stderr, reason = "the test that kills it listens")]
#[test]
fn answers_until_it_is_killed() {
    let Some(dir) = std::env::var_os(CHILD_DIR) else { return };
    let model = model(1);
    let mut store = SessionStore::create(Path::new(&dir), header(&model)).unwrap();
    store.save_dream(&dream(&model, 40, 1), DreamSource::User).unwrap();
    let driven = dream(&model, 2000, 2);
    let mut live = DreamEpisode::new(driven.start.clone(), driven.seed);
    let mut journal = store.journal(&live, DreamSource::User).unwrap();
    for n in 0..driven.len() {
        let query = ask(&mut store, 1)[0].id;
        store.record(answered(query, SafetyAnswer::OnlyLeft)).unwrap();
        live.zs.push(driven.zs.row(n));
        live.actions.push(driven.actions[n]);
        journal.follow(&live).unwrap();
        eprintln!("acknowledged {}", n + 1);
    }
}

#[test]
fn a_killed_program_loses_no_answer_and_no_step_that_it_acknowledged() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path().join("s");
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "answers_until_it_is_killed", "--nocapture"])
        .env(CHILD_DIR, &dir)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut n_acknowledged = 0;
    for line in BufReader::new(child.stderr.take().unwrap()).lines() {
        let Ok(line) = line else { break };
        if let Some(n) = line.strip_prefix("acknowledged ") {
            n_acknowledged = n.parse().unwrap();
        }
        if n_acknowledged == 25 {
            child.kill().unwrap();
        }
    }
    child.wait().unwrap();
    assert!(n_acknowledged >= 25, "the child ended by itself after {n_acknowledged}");
    let store = SessionStore::open(&dir, None).unwrap();
    let n_answers = store.session().answers().len();
    assert!(n_answers >= n_acknowledged, "{n_answers} answers of {n_acknowledged}");
    let unfinished = store.unfinished_dreams().unwrap();
    let n_steps = unfinished[0].episode.len();
    assert!(n_steps >= n_acknowledged, "{n_steps} steps of {n_acknowledged}");
}
