//! What is asked about, and what is asked twice.

use std::path::Path;

use dropj::query::SegmentRef;
use dropj::session::Choice;

use super::keys::Memory;
use super::*;

/// The label panel of somebody whose preferences are these.
fn asking(dir: &Path, preferences: &str) -> (Harness<'static, App>, Backstage) {
    let store = session(dir, Protocol::Dropj);
    let memory = Memory([("preferences".to_owned(), format!("(asking:{preferences})"))].into());
    let memory: &'static Memory = Box::leak(Box::new(memory));
    window_with(dir, Some(store), vec2(1280.0, 800.0), false, Some(memory))
}

fn choices(harness: &Harness<'_, App>) -> Vec<Choice> {
    let session = harness.state().session().unwrap().session();
    session.queries().iter().map(|asked| asked.choice).collect()
}

/// Opens the menu of what is asked.
fn change(harness: &mut Harness<'_, App>) {
    if harness.query_by_label("Change what is asked").is_none() {
        press(harness, Key::L);
    }
    harness.get_by_label("Change what is asked").click();
    harness.run_steps(3);
}

/// The pairs that the trainer was last asked to weigh.
fn weighed(backstage: &Backstage) -> Option<Vec<[SegmentRef; 2]>> {
    backstage.orders().into_iter().rev().find_map(|order| match order {
        Order::Trainer(TrainerCommand::Weigh(pairs)) => Some(pairs),
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
    backstage.report(Report::Learned { parameters, n_labels: 10, fit: None });
    press(&mut harness, Key::A);
    let pairs = weighed(&backstage).unwrap();
    assert_eq!((pairs.len(), choices(&harness).len()), (10, 5), "with four at hand there is time to weigh");
    let disagreements = Some((0..10).map(|i| if i == 6 { 0.4 } else { 0.1 }).collect());
    backstage.report(Report::Weighed { pairs: pairs.clone(), disagreements });
    harness.run_steps(2);
    let session = harness.state().session().unwrap().session();
    let last = session.queries().last().unwrap();
    assert_eq!(last.choice, Choice::Disagreement);
    assert_eq!([last.query.left, last.query.right], pairs[6]);
}

#[test]
fn a_trainer_that_is_slow_keeps_nobody_waiting() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = asking(dir.path(), "(mix:(disagreement:100,boundary:0),again:0)");
    let parameters = world().parameters;
    backstage.report(Report::Learned { parameters, n_labels: 10, fit: None });
    go(&mut harness, Panel::Label);
    for _ in 0..12 {
        press(&mut harness, Key::A);
    }
    assert_eq!(answers(&harness).len(), 12);
    assert!(choices(&harness).iter().all(|choice| *choice == Choice::Uniform), "it has not answered at all");
    let pairs = weighed(&backstage).unwrap();
    backstage.report(Report::Weighed { pairs, disagreements: None });
    harness.run_steps(2);
    assert_eq!(choices(&harness).last(), Some(&Choice::Uniform), "what nobody weighed was not chosen");
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
    let session = harness.state().session().unwrap().session();
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
    let session = harness.state().session().unwrap().session();
    let again: Vec<_> = session.queries().iter().filter(|asked| asked.answer().is_some()).collect();
    let again: Vec<_> = again.into_iter().filter_map(|asked| Some((asked, asked.repeats()?))).collect();
    assert!(again.len() >= 3, "30 of 100, once ten were answered: {}", again.len());
    for (asked, of) in &again {
        let first = session.query(*of).unwrap().query;
        assert_eq!((asked.query.left, asked.query.right), (first.right, first.left));
    }
    let learned = backstage.orders().into_iter().filter_map(|order| match order {
        Order::Trainer(TrainerCommand::Learn(query, _)) => Some(query.id),
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
