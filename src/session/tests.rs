//! What can and cannot happen in a session.

use proptest::prelude::*;

use super::*;
use crate::query::{Justification, Preference, SafetyAnswer, SegmentRef, SkipReason};

const SAFE_LEFT: Response = Response::Safety(SafetyAnswer::OnlyLeft);
const BOTH: Response = Response::Safety(SafetyAnswer::Both(Preference::Right));

struct Script {
    session: Session,
    entries: Vec<Entry>,
}

impl Script {
    /// A session with a dream of 30 steps and `n` queries about it.
    fn with_queries(n: u32) -> Self {
        let session = Session::new(Protocol::Dropj, Weights::paper());
        let mut script = Self { session, entries: Vec::new() };
        script.happens(dream_of(30)).unwrap();
        (0..n).for_each(|id| script.happens(asked(id, 0, 10)).unwrap());
        script
    }

    fn happens(&mut self, event: Event) -> Result<(), Impossible> {
        let entry = Entry { event, seq: self.entries.len() as u64, at: 1000 };
        self.session.apply(&entry)?;
        self.entries.push(entry);
        Ok(())
    }

    fn responses(&self) -> Vec<Response> {
        self.session.answers().iter().map(|given| given.answer.response).collect()
    }
}

fn dream_of(len: usize) -> Event {
    let (file, sha256) = ("dreams/0000.safetensors".to_owned(), String::new());
    let source = DreamSource::Simulated;
    Event::DreamKept(KeptDream {
        dream: DreamId(0),
        len,
        seed: 0,
        marks: vec![],
        source,
        acquisition: None,
        planned: 0,
        file,
        sha256,
    })
}

fn asked(id: u32, left: usize, right: usize) -> Event {
    let segment = |start| SegmentRef { dream: DreamId(0), start };
    let (left, right) = (segment(left), segment(right));
    Event::Asked { query: QueryId(id), left, right, choice: Choice::Uniform }
}

fn answered(id: u32, response: Response) -> Event {
    Event::Answered(Answer::new(QueryId(id), response, 5.0, "anna"))
}

fn retracted(id: u32) -> Event {
    Event::Retracted { query: QueryId(id) }
}

fn restored(id: u32) -> Event {
    Event::Restored { query: QueryId(id) }
}

#[test]
fn undoing_an_undo_gives_the_session_back() {
    let mut script = Script::with_queries(3);
    for id in 0..3 {
        script.happens(answered(id, if id == 1 { BOTH } else { SAFE_LEFT })).unwrap();
    }
    let before = script.session.clone();
    for id in [2, 1, 0] {
        assert_eq!(script.session.undoable(), Some(QueryId(id)));
        script.happens(retracted(id)).unwrap();
    }
    assert_eq!((script.session.undoable(), script.session.pending().count()), (None, 3));
    for id in 0..3 {
        assert_eq!(script.session.redoable(), Some(QueryId(id)));
        script.happens(restored(id)).unwrap();
    }
    assert_eq!(script.session.answers(), before.answers());
    assert_eq!(script.session.labeled(), before.labeled());
    assert_eq!(script.session.redoable(), None);
}

#[test]
fn a_later_answer_to_the_same_query_counts_until_it_is_taken_back() {
    let mut script = Script::with_queries(1);
    script.happens(answered(0, SAFE_LEFT)).unwrap();
    script.happens(answered(0, BOTH)).unwrap();
    assert_eq!(script.responses(), [BOTH]);
    script.happens(retracted(0)).unwrap();
    assert_eq!(script.responses(), [SAFE_LEFT]);
    script.happens(answered(0, Response::Skipped(None))).unwrap();
    assert_eq!(script.happens(restored(0)), Err(Impossible::NotRetracted(QueryId(0))));
}

#[test]
fn skips_are_answers_and_no_labels() {
    let mut script = Script::with_queries(3);
    script.happens(answered(1, SAFE_LEFT)).unwrap();
    script.happens(answered(0, Response::Skipped(None))).unwrap();
    let labeled = script.session.labeled();
    assert_eq!(labeled.len(), 1);
    assert_eq!((labeled[0].query.id, labeled[0].label.mu()), (QueryId(1), 1.0));
    let statistics = script.session.statistics();
    assert_eq!((statistics.n_answered, statistics.n_skipped, statistics.n_pending()), (1, 1, 1));
    assert_eq!(statistics.labels_per_hour(), Some(360.0));
}

#[test]
fn an_hour_away_from_the_screen_counts_as_a_minute() {
    let mut script = Script::with_queries(1);
    script.happens(Event::Answered(Answer::new(QueryId(0), BOTH, 3600.0, "anna"))).unwrap();
    assert_eq!(script.session.statistics().labels_per_hour(), Some(60.0));
}

#[test]
fn a_reason_is_part_of_its_skip() {
    let mut script = Script::with_queries(2);
    let explained = |id, reason| Event::SkipExplained { query: QueryId(id), reason };
    script.happens(answered(0, Response::Skipped(None))).unwrap();
    script.happens(explained(0, SkipReason::Other)).unwrap();
    script.happens(explained(0, SkipReason::Ambiguous)).unwrap();
    assert_eq!(script.responses(), [Response::Skipped(Some(SkipReason::Ambiguous))]);
    assert_eq!(script.session.statistics().active_secs, 5.0, "its time counts once");
    script.happens(retracted(0)).unwrap();
    assert_eq!(script.responses(), []);
    script.happens(answered(1, BOTH)).unwrap();
    for id in [0, 1] {
        assert_eq!(
            script.happens(explained(id, SkipReason::Other)),
            Err(Impossible::NotSkipped(QueryId(id)))
        );
    }
}

#[test]
fn an_answer_is_judged_by_the_protocol_in_force() {
    let mut script = Script::with_queries(3);
    script.happens(answered(0, SAFE_LEFT)).unwrap();
    script.happens(Event::ProtocolChanged { protocol: Protocol::Drope }).unwrap();
    let equal = Response::Preferred(Preference::Equal);
    assert!(script.happens(answered(1, BOTH)).is_err());
    script.happens(answered(1, equal)).unwrap();
    script.happens(Event::ProtocolChanged { protocol: Protocol::Drop }).unwrap();
    assert!(script.happens(answered(2, equal)).is_err());
    script.happens(answered(2, Response::Preferred(Preference::Right))).unwrap();
    let mus: Vec<_> = script.session.labeled().iter().map(|labeled| labeled.label.mu()).collect();
    assert_eq!(mus, [1.0, 0.5, 0.0]);
    assert_eq!(script.session.protocols(), [Protocol::Drop, Protocol::Drope, Protocol::Dropj]);
    script.happens(retracted(0)).unwrap();
    script.happens(restored(0)).unwrap();
    assert_eq!(script.session.protocol(), Protocol::Drop);
}

#[test]
fn what_is_asked_again_teaches_nothing_and_moves_no_count() {
    let mut script = Script::with_queries(11);
    let again = |id, of| {
        let segment = |start| SegmentRef { dream: DreamId(0), start };
        let (left, right) = (segment(10), segment(0));
        Event::Asked { query: QueryId(id), left, right, choice: Choice::Repeat(QueryId(of)) }
    };
    let both = |preference| Response::Safety(SafetyAnswer::Both(preference));
    for id in 0..10 {
        assert_eq!(script.session.repeatable("anna"), [], "nothing is long ago after {id} answers");
        let response = if id == 1 { Response::Skipped(None) } else { both(Preference::Left) };
        script.happens(answered(id, response)).unwrap();
    }
    script.happens(answered(10, SAFE_LEFT)).unwrap();
    assert_eq!(script.session.repeatable("anna"), [QueryId(0)]);
    assert_eq!(script.session.repeatable("ben"), []);
    let (labels, before) = (script.session.labeled(), script.session.statistics());

    script.happens(again(11, 0)).unwrap();
    assert_eq!(script.session.repeatable("anna"), [], "nothing is repeated twice, or while it waits");
    script.happens(answered(11, both(Preference::Right))).unwrap();
    script.happens(again(12, 10)).unwrap();
    script.happens(answered(12, Response::Safety(SafetyAnswer::Neither))).unwrap();

    assert_eq!(script.session.labeled(), labels);
    let after = script.session.statistics();
    assert_eq!((after.n_asked, after.n_answered, after.n_skipped, after.n_again), (11, 10, 1, 2));
    assert_eq!((before.n_answered, before.n_skipped, before.n_pending()), (10, 1, 0));
    assert!(after.labels_per_hour() < before.labels_per_hour(), "but its time is spent");
    let consistency = script.session.consistency(None).unwrap();
    assert_eq!((consistency.n, consistency.n_same, consistency.n_critical), (2, 1, 1), "seen from one side");
    assert_eq!(script.session.consistency(Some("ben")), None);
    assert_eq!(script.session.undoable(), Some(QueryId(12)), "it can be taken back like any other");
}

#[test]
fn other_weights_change_labels_and_no_answers() {
    let mut script = Script::with_queries(1);
    script.happens(answered(0, BOTH)).unwrap();
    assert_eq!(script.session.labeled()[0].label.mu(), 0.25);
    let weights = Weights { default: 1.0, ..Weights::paper() };
    script.happens(Event::WeightsChanged { weights }).unwrap();
    assert_eq!(script.session.labeled()[0].label.mu(), 0.0);
    assert_eq!(script.responses(), [BOTH]);
}

#[test]
fn what_cannot_have_happened_is_refused_and_changes_nothing() {
    let mut script = Script::with_queries(1);
    let before = script.session.clone();
    let segment = SegmentRef { dream: DreamId(0), start: 11 };
    let again = |of| {
        let segment = |start| SegmentRef { dream: DreamId(0), start };
        let (left, right) = (segment(10), segment(9));
        Event::Asked { query: QueryId(1), left, right, choice: Choice::Repeat(QueryId(of)) }
    };
    let step = Answer { left_unsafe_from: Some(20), ..Answer::new(QueryId(0), BOTH, 1.0, "anna") };
    let fit = |after, loss| Event::Fitted {
        fit: Fit { after, n_labels: 0, seed: 0, epochs: 1, losses: vec![loss], held_out: None },
        file: "reward/0000.safetensors".to_owned(),
        sha256: String::new(),
    };
    let (query, next) = (QueryId(0), 1);
    let weights = |safety| Event::WeightsChanged { weights: Weights { safety, ..Weights::paper() } };
    for (event, why) in [
        (answered(9, BOTH), Impossible::NeverAsked(QueryId(9))),
        (asked(1, 0, 11), Impossible::Segment(segment)),
        (asked(1, usize::MAX, 0), Impossible::Segment(SegmentRef { start: usize::MAX, ..segment })),
        (asked(0, 0, 0), Impossible::QueryNumber { found: query, next }),
        (again(0), Impossible::OtherSegments { query: QueryId(1), of: query }),
        (dream_of(30), Impossible::DreamNumber { found: DreamId(0), next }),
        (
            answered(0, Response::Preferred(Preference::Left)),
            Impossible::Response { query, protocol: Protocol::Dropj },
        ),
        (
            answered(0, Response::Justified(Justification(0).into(), Preference::Left)),
            Impossible::Response { query, protocol: Protocol::Dropj },
        ),
        (Event::Answered(step), Impossible::Step { query, step: 20 }),
        (
            Event::Answered(Answer::new(query, BOTH, f32::NAN, "anna")),
            Impossible::Number("the time of an answer"),
        ),
        (retracted(0), Impossible::NotAnswered(query)),
        (restored(0), Impossible::NotRetracted(query)),
        (Event::SkipExplained { query, reason: SkipReason::Other }, Impossible::NotSkipped(query)),
        (weights(0.3), Impossible::Weight { name: "safety", weight: 0.3 }),
        (Event::ScreenChanged { held_back: 101 }, Impossible::Share(101)),
        (fit(0, f32::NAN), Impossible::Number("a loss")),
        (fit(3, 0.1), Impossible::Future { after: 3, n_lines: 2 }),
    ] {
        assert_eq!(script.happens(event), Err(why));
    }
    assert_eq!(script.session, before);
}

#[test]
fn files_outside_the_session_are_refused() {
    let mut session = Session::new(Protocol::Dropj, Weights::paper());
    for file in ["../secret", "/etc/passwd"] {
        let Event::DreamKept(kept) = dream_of(30) else { unreachable!("it is one") };
        let event = Event::DreamKept(KeptDream { file: file.to_owned(), ..kept });
        let refused = session.apply(&Entry { event, seq: 0, at: 0 });
        assert_eq!(refused, Err(Impossible::Outside(file.to_owned())));
    }
}

#[test]
fn a_dream_is_dropped_only_where_no_answer_rests_on_it_and_can_be_brought_back() {
    let mut script = Script::with_queries(3);
    let (dream, dropped) = (DreamId(0), Event::DreamDropped { dream: DreamId(0) });
    script.happens(answered(0, SAFE_LEFT)).unwrap();
    script.happens(answered(1, Response::Skipped(None))).unwrap();
    assert_eq!(script.happens(dropped.clone()), Err(Impossible::Rests { dream, n: 1 }));
    script.happens(retracted(0)).unwrap();
    let before = script.session.clone();
    script.happens(dropped.clone()).unwrap();
    assert!(script.session.dream_lens().is_empty(), "nothing is drawn from it");
    assert_eq!((script.session.pending().count(), script.session.redoable()), (0, None));
    for event in [answered(2, SAFE_LEFT), restored(0), retracted(1), asked(3, 0, 10), dropped] {
        assert_eq!(script.happens(event), Err(Impossible::Dropped(dream)));
    }
    script.happens(Event::DreamRestored { dream }).unwrap();
    assert_eq!(script.session.pending().count(), before.pending().count());
    assert_eq!(script.happens(Event::DreamRestored { dream }), Err(Impossible::NotDropped(dream)));
    script.happens(restored(0)).unwrap();
}

proptest! {
    #[test]
    fn a_log_folds_to_the_session_that_wrote_it(deeds in prop::collection::vec((0u8..5, 0u32..4), 0..60)) {
        let mut script = Script::with_queries(4);
        for (deed, query) in deeds {
            let event = match deed {
                0 => answered(query, SAFE_LEFT),
                1 => answered(query, Response::Skipped(None)),
                2 => retracted(query),
                3 => restored(query),
                _ => Event::Flagged { query: QueryId(query) },
            };
            script.happens(event).ok();
        }
        let read: Vec<Entry> =
            script.entries.iter().map(|entry| Entry::from_line(entry.to_line().as_bytes()).unwrap()).collect();
        let folded = Session::new(Protocol::Dropj, Weights::paper()).folded(&read);
        prop_assert_eq!(folded, Ok(script.session));
    }
}
