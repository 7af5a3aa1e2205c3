//! What an hour of labeling needs: taking back and giving back, scrubbing, a list to revise, a budget and a pause.

use eframe::egui::{Modifiers, PointerButton, pos2};

use super::*;

fn ctrl(harness: &mut Harness<'_, Window>, modifiers: Modifiers, key: Key) {
    harness.key_press_modifiers(modifiers, key);
    harness.run_steps(2);
}

/// So many seconds, with a sign of somebody now and then if somebody is there.
fn pass(harness: &mut Harness<'_, Window>, secs: usize, is_there: bool) {
    for sec in 0..secs {
        if is_there && sec % 10 == 0 {
            harness.hover_at(pos2(700.0 + (sec % 20) as f32, 90.0));
        }
        let now = harness.ctx.input(|input| input.time);
        harness.input_mut().time = Some(now + 1.0);
        harness.step();
    }
}

#[test]
fn what_was_undone_is_redone_by_one_key_and_by_those_of_every_program() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = labeling(dir.path(), Protocol::Dropj);
    for key in [Key::A, Key::S, Key::D, Key::ArrowUp] {
        press(&mut harness, key);
    }
    let given = answers(&harness);
    press(&mut harness, Key::Backspace);
    (0..3).for_each(|_| ctrl(&mut harness, Modifiers::COMMAND, Key::Z));
    assert_eq!(answers(&harness), [], "all four are taken back");
    backstage.orders();
    press(&mut harness, Key::R);
    ctrl(&mut harness, Modifiers::COMMAND, Key::Y);
    ctrl(&mut harness, Modifiers::COMMAND | Modifiers::SHIFT, Key::Z);
    assert_eq!(answers(&harness), given[..3], "three are given back");
    let n_taught = backstage
        .orders()
        .iter()
        .filter(|order| matches!(order, WorkerCommand::Trainer(TrainerCommand::Learn(..))))
        .count();
    assert_eq!(n_taught, 3, "the trainer hears of each");
    press(&mut harness, Key::D);
    assert_eq!(answers(&harness)[3].0, QueryId(3), "and the one that is still open is asked");
}

#[test]
fn dragging_the_timeline_moves_both_clips_and_holds_them() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    let line = harness.get_by_label_contains("of 20").rect();
    let at = |share: f32| pos2(line.left() + share * line.width(), line.center().y);
    harness.hover_at(at(0.1));
    harness.run_steps(1);
    harness.event(Event::PointerButton {
        pos: at(0.1),
        button: PointerButton::Primary,
        pressed: true,
        modifiers: Modifiers::NONE,
    });
    harness.run_steps(2);
    for share in [0.3, 0.5, 0.775] {
        harness.hover_at(at(share));
        harness.run_steps(2);
    }
    harness.get_by_label("Frame 16 of 20");
    harness.event(Event::PointerButton {
        pos: at(0.775),
        button: PointerButton::Primary,
        pressed: false,
        modifiers: Modifiers::NONE,
    });
    harness.run_steps(20);
    harness.get_by_label("Frame 16 of 20");
    press(&mut harness, Key::A);
    harness.run_steps(4);
    assert!(harness.query_by_label("Frame 16 of 20").is_none(), "the next pair plays again");
    press(&mut harness, Key::ArrowUp);
    assert_eq!(answers(&harness).len(), 2, "arrows answer as before");
}

#[test]
fn answers_have_thumbnails_and_are_revised_by_a_click() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = labeling(dir.path(), Protocol::Dropj);
    for key in [Key::A, Key::S, Key::D] {
        press(&mut harness, key);
    }
    let folder = harness.state().app().open().unwrap().dir().to_owned();
    drop((harness, backstage));

    // Opened again, what was answered before is drawn small for the list, and only there.
    let store = SessionStore::open(&folder, None).unwrap();
    let (mut harness, backstage) = window(dir.path(), Some(store), vec2(1280.0, 800.0), false);
    go(&mut harness, Panel::Label);
    press(&mut harness, Key::L);
    harness.run_steps(2);
    let glanced: Vec<_> = backstage
        .orders()
        .into_iter()
        .filter_map(|order| match order {
            WorkerCommand::Clipper(ClipperCommand::DecodeThumbnails(query)) => Some(query),
            _ => None,
        })
        .collect();
    let ids: Vec<_> = glanced.iter().map(|query| query.id.0).collect();
    assert_eq!(ids, [2, 1, 0], "those in the list, each once");
    backstage
        .report(Report::Label(LabelReport::Thumbnails { query: glanced[1], frames: [frame(40), frame(90)] }));
    harness.run_steps(2);
    harness.get_by_label("Query 2: μ = 0.5: neither preferred because both are unsafe").click();
    harness.run_steps(3);
    press(&mut harness, Key::ArrowLeft);
    let better = Response::Safety(SafetyAnswer::Both(Preference::Left));
    assert!(answers(&harness).contains(&(QueryId(1), better)), "{:?}", answers(&harness));
}

#[test]
fn progress_is_told_against_a_budget_that_can_be_changed_and_stays() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    for key in [Key::A, Key::Space, Key::D] {
        press(&mut harness, key);
    }
    harness.get_by_label("3 of 500 queries").click();
    harness.run_steps(3);
    harness.get_by_label("30 minutes").click();
    harness.run_steps(3);
    harness.get_by_label("0 of 30 min · 3 queries");
    press(&mut harness, Key::S);
    harness.get_by_label_contains("labels an hour");
}

#[test]
fn a_pause_is_suggested_quietly_and_time_away_does_not_count() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    pass(&mut harness, 26 * 60, true);
    harness.get_by_label("26 minutes of labeling: a short pause keeps answers good");
    harness.get_by_label("Not now").click();
    harness.run_steps(2);
    assert!(harness.query_by_label("Not now").is_none(), "it is gone");
    press(&mut harness, Key::A);
    let secs = |harness: &Harness<'_, Window>| {
        let session = harness.state().app().open().unwrap().session();
        session.answers().last().unwrap().answer.secs
    };
    assert!(secs(&harness) > 1500.0, "all of it was looked at: {}", secs(&harness));
    pass(&mut harness, 300, false);
    press(&mut harness, Key::D);
    assert!(secs(&harness) < 35.0, "nobody was there for most of five minutes: {}", secs(&harness));
}

#[test]
fn the_label_panel_looks_as_it_did_in_small_and_large_windows() {
    if !looks::has_adapter() {
        return;
    }
    let mut results = egui_kittest::SnapshotResults::new();
    for (size, name, protocol) in [
        (vec2(1280.0, 720.0), "label_1280x720", Protocol::Dropj),
        (vec2(2560.0, 1440.0), "label_2560x1440", Protocol::Dropj),
        (vec2(1280.0, 720.0), "label_transition", Protocol::Dros),
    ] {
        let dir = tempfile::tempdir().unwrap();
        let (mut harness, _) = window(dir.path(), Some(session(dir.path(), protocol)), size, true);
        go(&mut harness, Panel::Label);
        for key in [Key::A, Key::ArrowRight, Key::S, Key::F, Key::Backspace, Key::P] {
            press(&mut harness, key);
        }
        if size.x > 2000.0 {
            press(&mut harness, Key::L);
        }
        results.add(harness.try_snapshot(name));
    }
}

#[test]
fn single_transitions_are_labeled_by_one_key_each() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = labeling(dir.path(), Protocol::Dros);
    harness.get_by_label("Where does the last step of this clip lead?");
    for key in [Key::ArrowRight, Key::ArrowLeft, Key::ArrowUp, Key::Space, Key::ArrowRight] {
        press(&mut harness, key);
    }
    press(&mut harness, Key::Backspace);
    press(&mut harness, Key::F);
    let expected = [Verdict::Good, Verdict::Unsafe, Verdict::Neutral].map(Response::Judged);
    assert_eq!(responses(&harness), [&expected[..], &[Response::Skipped(None)]].concat());
    let session = harness.state().app().open().unwrap().session();
    let asked: Vec<_> = session.queries().iter().filter_map(|asked| asked.transition).collect();
    assert!(asked.windows(2).all(|pair| pair[1].step == pair[0].step + 1), "one after the other: {asked:?}");
    assert_eq!(session.queries().iter().filter(|asked| asked.is_flagged).count(), 1);
    let orders = backstage.orders();
    let is_taught = |order: &WorkerCommand| matches!(order, WorkerCommand::Trainer(TrainerCommand::LearnVerdict(judged)) if judged.verdict == Verdict::Unsafe);
    assert!(orders.iter().any(is_taught), "the trainer hears of it");
    let is_forgotten =
        |order: &WorkerCommand| matches!(order, WorkerCommand::Trainer(TrainerCommand::Forget(QueryId(4))));
    assert!(orders.iter().any(is_forgotten), "and of what is taken back");
}

#[test]
fn a_transition_plays_up_to_its_outcome_over_and_over() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dros);
    // Into the trajectory, so that there is something to run up from.
    for _ in 0..20 {
        press(&mut harness, Key::ArrowUp);
    }
    let mut seen = std::collections::BTreeSet::new();
    for _ in 0..40 {
        harness.step();
        let line = harness.get_by_label_contains("of 20");
        seen.insert(line.accesskit_node().label().unwrap());
    }
    let expected: std::collections::BTreeSet<_> =
        (8..=15).map(|frame| format!("Frame {frame} of 20")).collect();
    assert_eq!(seen, expected, "seven frames of run-up, then the outcome, and nothing after it");
    press(&mut harness, Key::Period);
    press(&mut harness, Key::Period);
    assert!(harness.query_by_label_contains("of 20").is_some(), "what comes after can be looked at by hand");
}

#[test]
fn pairs_and_transitions_can_be_asked_by_turns() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    press(&mut harness, Key::A);
    for (here, there) in [("DROPJ", "DROS"), ("DROS", "DROPJ")] {
        harness.get_by_label(here).click();
        harness.run_steps(3);
        harness.get_by_label(there).click();
        harness.run_steps(3);
        press(&mut harness, Key::ArrowRight);
    }
    let both = Response::Safety(SafetyAnswer::Both(Preference::Right));
    let expected = [Response::Safety(SafetyAnswer::OnlyLeft), Response::Judged(Verdict::Good), both];
    assert_eq!(responses(&harness), expected);
    press(&mut harness, Key::Backspace);
    press(&mut harness, Key::Backspace);
    assert_eq!(responses(&harness), expected[..1], "undo knows both");
}
