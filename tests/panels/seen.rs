//! Only what was seen is answered.

use std::time::Duration;

use eframe::egui::{Modifiers, PointerButton, ViewportId};

use super::*;

/// So long a pair is on the screen before it can be answered, in seconds.
const MOMENT: f32 = 0.1;

fn key(key: Key) -> [Event; 2] {
    [true, false].map(|pressed| Event::Key {
        key,
        physical_key: None,
        pressed,
        repeat: false,
        modifiers: Modifiers::NONE,
    })
}

/// One picture of the window, `secs` after the last one, which hears all these keys at once.
fn picture(harness: &mut Harness<'_, Window>, secs: f64, keys: &[Key]) {
    let now = harness.ctx.input(|input| input.time);
    harness.input_mut().time = Some(now + secs);
    harness.input_mut().events.extend(keys.iter().flat_map(|it| key(*it)));
    harness.step();
    // From here on it goes by itself again.
    harness.input_mut().time = None;
}

/// How long each answered pair was on the screen.
fn secs(harness: &Harness<'_, Window>) -> Vec<f32> {
    let session = harness.state().app().open().unwrap().session();
    session.answers().iter().map(|given| given.answer.secs).collect()
}

const ONLY_LEFT: Response = Response::Safety(SafetyAnswer::OnlyLeft);
const ONLY_RIGHT: Response = Response::Safety(SafetyAnswer::OnlyRight);

#[test]
fn of_two_keys_in_a_picture_the_second_answers_nothing() {
    let dir = tempfile::tempdir().unwrap();
    for secs_between in [0.016, 0.05, 0.4] {
        let (mut harness, _) = labeling(&dir.path().join(secs_between.to_string()), Protocol::Dropj);
        for _ in 0..20 {
            picture(&mut harness, secs_between, &[]);
        }
        // The one that was struck first counts, and not the one that is drawn first.
        picture(&mut harness, secs_between, &[Key::D, Key::A]);
        assert_eq!(answers(&harness), [(QueryId(0), ONLY_RIGHT)]);
        for _ in 0..20 {
            picture(&mut harness, secs_between, &[]);
        }
        assert_eq!(answers(&harness).len(), 1, "the second is no answer to the next pair, nor later on");
        harness.get_by_label("Not taken: this came before the pair could be seen");
        picture(&mut harness, secs_between, &[Key::A]);
        assert_eq!(responses(&harness), [ONLY_RIGHT, ONLY_LEFT], "one that comes later is");
        assert!(secs(&harness).iter().all(|secs| *secs >= MOMENT), "{:?}", secs(&harness));
    }
}

#[test]
fn many_keys_that_were_struck_while_the_window_hung_answer_one_pair() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    see(&mut harness);
    picture(&mut harness, 3.0, &[Key::A, Key::D, Key::S, Key::A, Key::D, Key::S, Key::A]);
    for _ in 0..30 {
        picture(&mut harness, 0.3, &[]);
    }
    assert_eq!(
        answers(&harness),
        [(QueryId(0), ONLY_LEFT)],
        "all others were struck before the next was seen"
    );
}

#[test]
fn a_key_that_comes_before_the_pair_could_be_seen_is_not_taken() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    see(&mut harness);
    picture(&mut harness, 0.02, &[Key::A]);
    // Five pictures a fiftieth of a second apart: seen, but for too short.
    for _ in 0..5 {
        picture(&mut harness, 0.02, &[Key::D]);
    }
    assert_eq!(responses(&harness), [ONLY_LEFT]);
    picture(&mut harness, 0.02, &[]);
    picture(&mut harness, 0.02, &[Key::D]);
    assert_eq!(responses(&harness), [ONLY_LEFT, ONLY_RIGHT]);
    assert!(secs(&harness)[1] >= MOMENT && secs(&harness)[1] < 0.2, "{:?}", secs(&harness));
    // A second after the last picture, but in the first one that shows it, and in the next.
    picture(&mut harness, 1.0, &[Key::S]);
    picture(&mut harness, 1.0, &[Key::S]);
    assert_eq!(answers(&harness).len(), 2, "nobody has seen it yet");
    picture(&mut harness, 1.0, &[Key::S]);
    assert_eq!(answers(&harness).len(), 3);
}

#[test]
fn who_answers_as_fast_as_one_can_look_feels_nothing_of_it() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    see(&mut harness);
    for _ in 0..20 {
        picture(&mut harness, 0.016, &[Key::A]);
        // An eighth of a second: faster than anybody can look and strike.
        for _ in 0..8 {
            picture(&mut harness, 0.016, &[]);
        }
    }
    assert_eq!(answers(&harness).len(), 20, "each key is an answer");
}

#[test]
fn buttons_of_a_pad_that_come_at_once_answer_one_pair() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = labeling(dir.path(), Protocol::Dropj);
    see(&mut harness);
    let both = [PadButton::RightShoulder, PadButton::LeftShoulder].map(PadEvent::Pressed);
    backstage.pad.lock().unwrap().extend(both);
    harness.run_steps(5);
    assert_eq!(answers(&harness), [(QueryId(0), ONLY_RIGHT)]);
}

#[test]
fn a_click_and_a_key_in_a_picture_answer_one_pair() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    see(&mut harness);
    let pos = harness.get_by_label("Neither is safe").rect().center();
    let button = |pressed| Event::PointerButton {
        pos,
        button: PointerButton::Primary,
        pressed,
        modifiers: Modifiers::NONE,
    };
    harness.hover_at(pos);
    harness.event(button(true));
    harness.step();
    harness.input_mut().events.extend([button(false)].into_iter().chain(key(Key::A)));
    harness.step();
    harness.run_steps(5);
    assert_eq!(answers(&harness), [(QueryId(0), Response::Safety(SafetyAnswer::Neither))]);
}

#[test]
fn a_pair_that_was_covered_is_to_be_seen_anew() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    see(&mut harness);
    picture(&mut harness, 0.04, &[Key::Questionmark, Key::A]);
    for _ in 0..10 {
        picture(&mut harness, 0.04, &[]);
    }
    harness.get_by_label("Click a key to change it.");
    assert_eq!(answers(&harness), [], "what was struck after it goes to the dialog");
    picture(&mut harness, 0.04, &[Key::Escape, Key::D]);
    for _ in 0..10 {
        picture(&mut harness, 0.04, &[]);
    }
    assert!(harness.query_by_label("Click a key to change it.").is_none(), "it is closed");
    assert_eq!(answers(&harness), [], "nobody has seen the pair since");
    picture(&mut harness, 0.04, &[Key::D]);
    assert_eq!(responses(&harness), [ONLY_RIGHT]);
    assert!(secs(&harness)[0] < 1.0, "the time under the dialog does not count: {:?}", secs(&harness));
}

#[test]
fn what_is_undone_or_redone_is_to_be_seen_first() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    for key in [Key::A, Key::S] {
        press(&mut harness, key);
    }
    see(&mut harness);
    picture(&mut harness, 0.04, &[Key::Backspace, Key::D]);
    for _ in 0..10 {
        picture(&mut harness, 0.04, &[]);
    }
    assert_eq!(responses(&harness), [ONLY_LEFT], "it is taken back, and nothing is said of it yet");
    picture(&mut harness, 0.04, &[Key::R, Key::D]);
    for _ in 0..10 {
        picture(&mut harness, 0.04, &[]);
    }
    let neither = Response::Safety(SafetyAnswer::Neither);
    assert_eq!(responses(&harness), [ONLY_LEFT, neither], "nor of the one after it");
    assert_eq!(harness.state().app().shown(), Some(QueryId(2)));
}

#[test]
fn an_answer_that_is_chosen_from_the_list_is_to_be_seen_first() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    for key in [Key::A, Key::S] {
        press(&mut harness, key);
    }
    press(&mut harness, Key::L);
    see(&mut harness);
    harness.get_by_label("Query 1: μ = 1: left preferred because right is unsafe").click();
    harness.step();
    picture(&mut harness, 0.04, &[Key::D]);
    picture(&mut harness, 0.04, &[]);
    assert_eq!(harness.state().app().shown(), Some(QueryId(0)));
    assert_eq!(responses(&harness), [ONLY_LEFT, Response::Safety(SafetyAnswer::Neither)], "it stays");
    press(&mut harness, Key::D);
    assert!(answers(&harness).contains(&(QueryId(0), ONLY_RIGHT)), "{:?}", answers(&harness));
}

#[test]
fn while_clips_are_being_drawn_nothing_is_answered() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = labeling(dir.path(), Protocol::Dropj);
    backstage.draws.store(false, Ordering::Relaxed);
    for key in [Key::A; 5] {
        press(&mut harness, key);
    }
    assert_eq!(
        (answers(&harness).len(), harness.state().app().shown()),
        (5, None),
        "the next waits for its clips"
    );
    press(&mut harness, Key::G);
    for key in [Key::Y, Key::N, Key::Space, Key::ArrowUp] {
        picture(&mut harness, 0.2, &[key]);
    }
    backstage.pad.lock().unwrap().push(PadEvent::Pressed(PadButton::South));
    picture(&mut harness, 0.2, &[Key::F]);
    assert_eq!(answers(&harness).len(), 5);
    let clip = |shade: usize| (0..SEGMENT_LEN).map(|t| frame(shade + 6 * t)).collect();
    let session = harness.state().app().open().unwrap().session();
    let query = session.query(QueryId(5)).unwrap();
    assert!(!query.is_flagged, "nor marked");
    let query = query.query;
    backstage.report(Report::Label(LabelReport::Clips { query, left: clip(40), right: clip(100) }));
    picture(&mut harness, 0.2, &[Key::N]);
    see(&mut harness);
    harness.get_by_label("Does the left clip stay safe?");
}

#[test]
fn guided_questions_about_one_pair_come_as_fast_as_one_likes_and_no_further() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    press(&mut harness, Key::G);
    see(&mut harness);
    picture(&mut harness, 0.04, &[Key::Y, Key::N, Key::Y, Key::N]);
    for _ in 0..10 {
        picture(&mut harness, 0.04, &[]);
    }
    assert_eq!(
        answers(&harness),
        [(QueryId(0), ONLY_LEFT)],
        "the next pair was not seen by whoever struck them"
    );
    harness.get_by_label("Does the left clip stay safe?");
}

#[test]
fn a_verdict_is_given_of_a_transition_that_was_seen() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dros);
    see(&mut harness);
    picture(&mut harness, 0.04, &[Key::ArrowRight, Key::ArrowLeft]);
    for _ in 0..10 {
        picture(&mut harness, 0.04, &[]);
    }
    assert_eq!(answers(&harness), [(QueryId(0), Response::Judged(Verdict::Good))]);
}

#[test]
fn a_justification_counts_for_the_answer_that_was_struck_after_it() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::DropjMulti);
    see(&mut harness);
    picture(&mut harness, 0.04, &[Key::Num1, Key::ArrowLeft]);
    picture(&mut harness, 0.04, &[]);
    let all = harness.state().app().open().unwrap().session().weights().justifications.clone();
    let grass = all.named("grass").unwrap();
    assert_eq!(responses(&harness), [Response::Justified(grass.into(), Preference::Left)]);
}

#[test]
fn a_mark_that_was_struck_before_the_dream_was_kept_is_in_it() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = dreaming(dir.path());
    backstage.slots.dream.put(view(30));
    picture(&mut harness, 0.04, &[]);
    backstage.orders();
    picture(&mut harness, 0.04, &[Key::U, Key::N]);
    picture(&mut harness, 0.04, &[]);
    let orders = backstage.orders();
    assert!(
        matches!(
            orders[..],
            [
                WorkerCommand::Dreamer(DreamerCommand::MarkUnsafe),
                WorkerCommand::Dreamer(DreamerCommand::Finish)
            ]
        ),
        "{orders:?}"
    );
}

#[test]
fn the_window_draws_until_a_pair_can_be_answered() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    // Somebody who is away: nothing else moves.
    picture(&mut harness, 100.0, &[]);
    picture(&mut harness, 0.1, &[Key::Backspace]);
    see(&mut harness);
    picture(&mut harness, 0.02, &[Key::A]);
    picture(&mut harness, 0.02, &[]);
    let delay = harness.output().viewport_output.values().map(|viewport| viewport.repaint_delay).min();
    assert!(delay.is_some_and(|delay| delay < Duration::from_millis(100)), "{delay:?}");
}

/// Whether a pause was ordered, and by whom it is to be heard.
fn pauses(backstage: &Backstage) -> Vec<&'static str> {
    let who = |order: &WorkerCommand| match order {
        WorkerCommand::Dreamer(DreamerCommand::Pause(true)) => Some("dream"),
        WorkerCommand::Recorder(RecorderCommand::Pause(true)) => Some("recording"),
        WorkerCommand::Dreamer(DreamerCommand::Pause(false))
        | WorkerCommand::Recorder(RecorderCommand::Pause(false)) => Some("goes on"),
        WorkerCommand::Driver(_) => Some("drive"),
        _ => None,
    };
    backstage.orders().iter().filter_map(who).collect()
}

/// Takes the focus away from the window, or gives it.
fn focus(harness: &mut Harness<'_, Window>, has_focus: bool) {
    harness.input_mut().focused = has_focus;
    harness.event(Event::WindowFocused(has_focus));
    harness.run_steps(2);
}

#[test]
fn a_dream_pauses_when_the_window_loses_the_focus_and_stays_so() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = dreaming(dir.path());
    backstage.slots.dream.put(view(30));
    harness.run_steps(2);
    backstage.orders();
    focus(&mut harness, false);
    assert_eq!(pauses(&backstage), ["dream"], "once");
    backstage.slots.dream.put(LiveView { is_paused: true, ..view(31) });
    focus(&mut harness, true);
    harness.run_steps(5);
    assert_eq!(pauses(&backstage), [""; 0], "it does not go on by itself");
    press(&mut harness, Key::P);
    assert_eq!(pauses(&backstage), ["goes on"]);
}

#[test]
fn a_dream_that_the_planner_drives_pauses_too_and_so_does_a_window_that_is_put_away() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = dreaming(dir.path());
    backstage.slots.dream.put(LiveView { is_planned: true, ..view(30) });
    harness.run_steps(2);
    backstage.orders();
    let viewport = harness.input_mut().viewports.get_mut(&ViewportId::ROOT).unwrap();
    viewport.minimized = Some(true);
    harness.run_steps(3);
    assert_eq!(pauses(&backstage), ["dream"]);
}

#[test]
fn a_recording_pauses_with_the_focus_and_a_drive_by_plan_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = window(dir.path(), None, vec2(1280.0, 800.0), false);
    backstage.report(Report::Reward(RewardReport::Learned {
        parameters: world().parameters,
        n_labels: 12,
        fit: None,
    }));
    go(&mut harness, Panel::Record);
    press(&mut harness, Key::Enter);
    backstage.slots.record.put(view(10));
    harness.run_steps(2);
    backstage.orders();
    focus(&mut harness, false);
    assert_eq!(pauses(&backstage), ["recording"]);
    focus(&mut harness, true);
    press(&mut harness, Key::Escape);
    go(&mut harness, Panel::Deploy);
    press(&mut harness, Key::Enter);
    assert_eq!(pauses(&backstage), ["drive"], "it has begun");
    focus(&mut harness, false);
    assert_eq!(pauses(&backstage), [""; 0], "nobody's hands are needed");
}

#[test]
fn a_pad_is_not_heard_while_another_window_has_the_focus() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = labeling(dir.path(), Protocol::Dropj);
    see(&mut harness);
    focus(&mut harness, false);
    backstage.pad.lock().unwrap().push(PadEvent::Pressed(PadButton::LeftShoulder));
    harness.run_steps(3);
    assert_eq!(answers(&harness), [], "it was meant for that one");
    focus(&mut harness, true);
    see(&mut harness);
    backstage.pad.lock().unwrap().push(PadEvent::Pressed(PadButton::LeftShoulder));
    harness.run_steps(3);
    assert_eq!(responses(&harness), [ONLY_LEFT]);
}

#[test]
fn unplugging_another_pad_lets_go_of_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = dreaming(dir.path());
    let pad = Pad { stick: 1.0, right_trigger: 1.0, ..Pad::default() };
    let [one, other] = ["Pad", "Pad (2)"].map(str::to_owned);
    backstage.pad.lock().unwrap().extend([
        PadEvent::Connected(one.clone()),
        PadEvent::Connected(other.clone()),
        PadEvent::Took(one.clone()),
        PadEvent::Moved(pad),
    ]);
    harness.key_down(Key::ArrowDown);
    harness.run_steps(2);
    let held = Action::new([1.0, 1.0, 0.8]);
    assert_eq!(backstage.given(), held);
    backstage.pad.lock().unwrap().push(PadEvent::Disconnected(other));
    harness.run_steps(2);
    assert_eq!(backstage.given(), held);
    harness.get_by_label_contains("Pad (2) was unplugged, and Pad controls still");
    backstage.pad.lock().unwrap().extend([PadEvent::Moved(Pad::default()), PadEvent::Disconnected(one)]);
    harness.run_steps(2);
    assert_eq!(backstage.given(), Action::new([0.0, 0.0, 0.8]), "keys are held still");
}

#[test]
fn nothing_in_the_log_was_answered_in_no_time() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    // Somebody who drums on the keys.
    for i in 0..300 {
        picture(&mut harness, 0.017, &[[Key::A, Key::D, Key::S, Key::ArrowUp][i % 4], Key::Space]);
    }
    let store = harness.state().app().open().unwrap();
    let log = std::fs::read_to_string(store.dir().join("events.jsonl")).unwrap();
    let events = log.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
    let answered = events.filter(|event| event["event"] == "answered");
    let secs: Vec<_> = answered.map(|event| event["secs"].as_f64().unwrap() as f32).collect();
    assert!(secs.len() > 10 && secs.iter().all(|secs| *secs >= MOMENT), "{secs:?}");
}
