//! What is asked about, and what is asked twice.

use std::path::Path;

use dropj::dream::signs::N_SIGNS;
use dropj::dream::{Rows, Screen};
use dropj::query::{DreamId, SegmentRef};
use dropj::session::{Answer, AskedQuery, Choice, Event as SessionEvent, hand_on};
use dropj::worker::ScreenerCommand;

use super::keys::Memory;
use super::looks::has_adapter;
use super::merge::wait_for;
use super::*;

/// The label panel of somebody whose preferences are these.
fn asking(dir: &Path, preferences: &str) -> (Harness<'static, Window>, Backstage) {
    let store = session(dir, Protocol::Dropj);
    let memory = Memory([("preferences".to_owned(), format!("(asking:{preferences})"))].into());
    let memory: &'static Memory = Box::leak(Box::new(memory));
    window_with(dir, Some(store), vec2(1280.0, 800.0), false, Some(memory))
}

fn choices(harness: &Harness<'_, Window>) -> Vec<Choice> {
    let session = harness.state().app().open().unwrap().session();
    session.queries().iter().map(|asked| asked.choice).collect()
}

/// Opens the menu of what is asked.
fn change(harness: &mut Harness<'_, Window>) {
    if harness.query_by_label("Change what is asked").is_none() {
        press(harness, Key::L);
    }
    harness.get_by_label("Change what is asked").click();
    harness.run_steps(3);
}

/// The pairs that the trainer was last asked to weigh.
fn weighed(backstage: &Backstage) -> Option<Vec<[SegmentRef; 2]>> {
    backstage.orders().into_iter().rev().find_map(|order| match order {
        WorkerCommand::Trainer(TrainerCommand::MeasureDisagreement(pairs)) => Some(pairs),
        _ => None,
    })
}

#[test]
fn the_pair_that_is_disagreed_about_most_is_asked() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = asking(dir.path(), "(mix:(disagreement:100,boundary:0),again:0)");
    go(&mut harness, Panel::Label);
    assert_eq!(choices(&harness), [Choice::Uniform; 5], "nothing was learned that could disagree");
    change(&mut harness);
    harness.get_by_label_contains("Nothing is learned yet");
    press(&mut harness, Key::Escape);

    let parameters = world().parameters;
    backstage.report(Report::Reward(RewardReport::Learned { parameters, n_labels: 10, fit: None }));
    press(&mut harness, Key::A);
    let pairs = weighed(&backstage).unwrap();
    assert_eq!((pairs.len(), choices(&harness).len()), (10, 5), "with four at hand there is time to weigh");
    let disagreements = Some((0..10).map(|i| if i == 6 { 0.4 } else { 0.1 }).collect());
    backstage.report(Report::Label(LabelReport::Disagreements { pairs: pairs.clone(), disagreements }));
    harness.run_steps(2);
    let session = harness.state().app().open().unwrap().session();
    let last = session.queries().last().unwrap();
    assert_eq!(last.choice, Choice::Disagreement);
    assert_eq!([last.query.left, last.query.right], pairs[6]);
}

#[test]
fn a_trainer_that_is_slow_keeps_nobody_waiting() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = asking(dir.path(), "(mix:(disagreement:100,boundary:0),again:0)");
    let parameters = world().parameters;
    backstage.report(Report::Reward(RewardReport::Learned { parameters, n_labels: 10, fit: None }));
    go(&mut harness, Panel::Label);
    for _ in 0..12 {
        press(&mut harness, Key::A);
    }
    assert_eq!(answers(&harness).len(), 12);
    assert!(choices(&harness).iter().all(|choice| *choice == Choice::Uniform), "it has not answered at all");
    let pairs = weighed(&backstage).unwrap();
    backstage.report(Report::Label(LabelReport::Disagreements { pairs, disagreements: None }));
    harness.run_steps(2);
    assert_eq!(choices(&harness).last(), Some(&Choice::Uniform), "what nobody weighed was not chosen");
}

#[test]
fn pairs_are_balanced_where_somebody_wants_that() {
    for (preferences, wanted) in
        [("(mix:(is_balanced:true),again:0)", Choice::Balanced), ("(again:0)", Choice::Uniform)]
    {
        let dir = tempfile::tempdir().unwrap();
        let (mut harness, _backstage) = asking(dir.path(), preferences);
        go(&mut harness, Panel::Label);
        for _ in 0..8 {
            press(&mut harness, Key::S);
        }
        assert_eq!(answers(&harness).len(), 8);
        assert!(choices(&harness).iter().all(|choice| *choice == wanted), "{:?}", choices(&harness));
        let known = harness.state().app().open().unwrap().session().known_clips();
        let first = harness.state().app().open().unwrap().session().queries()[0].query.left;
        assert_eq!(known.is_safe(first), Some(false), "what was called unsafe is known to be");
    }
}

#[test]
fn pairs_near_unsafe_marks_are_asked() {
    let dir = tempfile::tempdir().unwrap();
    let mut store = session(dir.path(), Protocol::Dropj);
    let mut marked = dream(120);
    marked.unsafe_marks = vec![70];
    let id = store.save_dream(&marked, DreamSource::User).unwrap();
    let memory = "(asking:(mix:(disagreement:0,boundary:100),again:0))".to_owned();
    let memory = Memory([("preferences".to_owned(), memory)].into());
    let memory: &'static Memory = Box::leak(Box::new(memory));
    let size = vec2(1280.0, 800.0);
    let (mut harness, _) = window_with(dir.path(), Some(store), size, false, Some(memory));
    go(&mut harness, Panel::Label);
    let session = harness.state().app().open().unwrap().session();
    for asked in session.queries() {
        assert_eq!(asked.choice, Choice::SafetyBoundary);
        let is_near = |segment: SegmentRef| segment.dream == id && (30..=70).contains(&segment.start);
        assert!(is_near(asked.query.left) || is_near(asked.query.right), "{asked:?}");
    }
}

#[test]
fn a_query_comes_again_with_its_sides_changed_over_and_moves_no_count() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = asking(dir.path(), "(mix:(disagreement:0,boundary:0),again:30)");
    go(&mut harness, Panel::Label);
    backstage.orders();
    for _ in 0..40 {
        press(&mut harness, Key::A);
    }
    let session = harness.state().app().open().unwrap().session();
    let again: Vec<_> = session.queries().iter().filter(|asked| asked.answer().is_some()).collect();
    let again: Vec<_> = again.into_iter().filter_map(|asked| Some((asked, asked.repeats()?))).collect();
    assert!(again.len() >= 3, "30 of 100, once ten were answered: {}", again.len());
    for (asked, of) in &again {
        let first = session.query(*of).unwrap().query;
        assert_eq!((asked.query.left, asked.query.right), (first.right, first.left));
    }
    let learned = backstage.orders().into_iter().filter_map(|order| match order {
        WorkerCommand::Trainer(TrainerCommand::Learn(query, _)) => Some(query.id),
        _ => None,
    });
    let learned: Vec<_> = learned.collect();
    assert!(again.iter().all(|(asked, _)| !learned.contains(&asked.query.id)), "nothing is learned twice");
    let n = 40 - again.len();
    assert_eq!((learned.len(), session.statistics().n_answered), (n, n));
    harness.get_by_label_contains(&format!("{n} of 500 queries"));
    // Whoever always says "only left is safe" contradicts themselves each time.
    let wanted = format!("0 of {0} were answered as before, {0} differed about safety", again.len());
    change(&mut harness);
    harness.get_by_label(&wanted);
}

/// Signs of a dream of `n` steps that looks ever less like the world.
fn signs(n: usize) -> Rows {
    let mut signs = Rows { width: N_SIGNS, values: Vec::new() };
    (0..n).for_each(|t| signs.push(&[t as f32 / n as f32; N_SIGNS]));
    signs
}

#[test]
fn doubtful_pairs_are_held_back_and_those_that_were_drawn_come_last() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = asking(dir.path(), "(again:0,held_back:40)");
    go(&mut harness, Panel::Label);
    let looked_at = backstage.orders().into_iter().filter(
        |order| matches!(order, WorkerCommand::Screener(ScreenerCommand::AddDream(_, dream)) if dream.len() > 80),
    );
    assert_eq!(looked_at.count(), 2, "both dreams are looked at");
    let drawn: Vec<_> = harness.state().app().open().unwrap().session().queries().to_vec();
    for (id, n) in [(0, 200), (1, 90)] {
        backstage.report(Report::Label(LabelReport::Signs { dream: DreamId(id), seed: 7, signs: signs(n) }));
    }
    backstage.report(Report::Label(LabelReport::Signs { dream: DreamId(0), seed: 8, signs: signs(20) }));
    harness.run_steps(3);

    let mut screen = Screen::default();
    screen.add_dream(DreamId(0), &signs(200));
    screen.add_dream(DreamId(1), &signs(90));
    let is_held = |asked: &AskedQuery| screen.holds_back([asked.query.left, asked.query.right], 0.4);
    for _ in 0..30 {
        press(&mut harness, Key::A);
    }
    let session = harness.state().app().open().unwrap().session();
    assert_eq!(session.held_back(), 40, "it is written down");
    assert!(!session.queries()[drawn.len()..].iter().any(is_held), "no other doubtful pair is drawn");
    let answered = |asked: &&AskedQuery| session.query(asked.query.id).unwrap().answer().is_some();
    let held: Vec<_> = drawn.iter().filter(|asked| is_held(asked)).collect();
    assert!(!held.is_empty(), "of five some are doubtful, or this tests nothing");
    let n_answered = held.into_iter().filter(answered).count();
    // One may have been on the screen already.
    assert!(n_answered <= 1, "{n_answered} that were drawn before were not left for last");
}

#[test]
fn skips_as_hallucinated_are_counted_against_the_screen() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = asking(dir.path(), "(again:0,held_back:20)");
    go(&mut harness, Panel::Label);
    change(&mut harness);
    harness.get_by_label("The dreams are yet to be looked at");
    press(&mut harness, Key::Escape);
    for (id, n) in [(0, 200), (1, 90)] {
        backstage.report(Report::Label(LabelReport::Signs { dream: DreamId(id), seed: 7, signs: signs(n) }));
    }
    press(&mut harness, Key::A);
    press(&mut harness, Key::Space);
    press(&mut harness, Key::Num1);
    change(&mut harness);
    harness.get_by_label("How doubtful pairs are");
    harness.get_by_label_contains("of 1 skipped as hallucinated");
}

#[test]
fn those_who_answered_the_same_queries_are_compared() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = asking(dir.path(), "(again:0)");
    go(&mut harness, Panel::Label);
    for key in [Key::A, Key::D, Key::S] {
        press(&mut harness, key);
    }
    let from = harness.state().app().open().unwrap().dir().to_owned();
    let mut other = hand_on(&from, &dir.path().join("other"), "ben").unwrap();
    for (id, safety) in [(0, SafetyAnswer::OnlyLeft), (1, SafetyAnswer::Neither)] {
        let answer = Answer::new(QueryId(id), Response::Safety(safety), 3.0, "ben");
        other.record(SessionEvent::Answered(answer)).unwrap();
    }
    drop(other);
    if harness.query_by_label("Compare").is_none() {
        press(&mut harness, Key::L);
    }
    harness.get_by_label("Compare").click();
    wait_for(&mut harness, "anonymous and ben");
    harness.get_by_label_contains("1 of 2 alike");
    harness.get_by_label_contains("2 answers, 3.0 s each");
}

#[test]
fn what_is_asked_looks_as_it_did() {
    if !has_adapter() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let store = session(dir.path(), Protocol::Dropj);
    let memory = "(asking:(mix:(disagreement:30,boundary:20),again:5,held_back:20))".to_owned();
    let memory = Memory([("preferences".to_owned(), memory)].into());
    let memory: &'static Memory = Box::leak(Box::new(memory));
    let (mut harness, backstage) =
        window_with(dir.path(), Some(store), vec2(1280.0, 800.0), true, Some(memory));
    go(&mut harness, Panel::Label);
    for key in [Key::A, Key::Space, Key::Num1, Key::P] {
        press(&mut harness, key);
    }
    for (id, n) in [(0, 200), (1, 90)] {
        backstage.report(Report::Label(LabelReport::Signs { dream: DreamId(id), seed: 7, signs: signs(n) }));
    }
    change(&mut harness);
    harness.run_steps(180);
    harness.snapshot("asking");
}
