//! What happens over more than one panel, or more than one program.

use super::*;

#[test]
fn other_questions_can_be_asked_in_mid_session() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    press(&mut harness, Key::A);
    harness.get_by_label("DROPJ").click();
    harness.run_steps(3);
    harness.get_by_label("DROPe").click();
    harness.run_steps(3);
    harness.get_by_label("Which clip is better, or are they equal?");
    press(&mut harness, Key::ArrowUp);
    let equal = Response::Preferred(Preference::Equal);
    assert_eq!(responses(&harness), [Response::Safety(SafetyAnswer::OnlyLeft), equal]);

    let folder = harness.state().app().open().unwrap().dir().to_owned();
    drop(harness);
    let read = SessionStore::open(&folder, None).unwrap();
    assert_eq!(read.session().protocol(), Protocol::Drope, "it is so when the session is opened again");
    assert_eq!(read.session().protocols(), [Protocol::Drope, Protocol::Dropj]);
}

#[test]
fn a_fit_is_of_the_answers_that_there_were_when_it_was_asked_for() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = labeling(dir.path(), Protocol::Dropj);
    press(&mut harness, Key::A);
    go(&mut harness, Panel::Reward);
    let after = harness.state().app().open().unwrap().session().n_entries();
    harness.get_by_label("Fit fully").click();
    harness.run_steps(2);
    let seed = backstage.orders().into_iter().find_map(|order| match order {
        WorkerCommand::Trainer(TrainerCommand::Fit { seed }) => Some(seed),
        _ => None,
    });
    go(&mut harness, Panel::Label);
    press(&mut harness, Key::S);
    let fit = Some((seed.unwrap(), vec![0.5, 0.25]));
    backstage.report(Report::Reward(RewardReport::Learned {
        parameters: world().parameters,
        n_labels: 1,
        fit,
    }));
    harness.run_steps(2);
    let session = harness.state().app().open().unwrap().session();
    assert!(session.n_entries() > after + 1, "something was answered meanwhile");
    assert_eq!(session.fits().last().map(|fitted| fitted.fit.after), Some(after));
}

#[test]
fn the_time_of_a_skip_with_a_reason_counts_once() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    harness.run_steps(25);
    press(&mut harness, Key::Space);
    let active_secs = |harness: &Harness<'_, Window>| {
        harness.state().app().open().unwrap().session().statistics().active_secs
    };
    let before = active_secs(&harness);
    press(&mut harness, Key::Num2);
    assert_eq!(responses(&harness), [Response::Skipped(Some(SkipReason::Ambiguous))]);
    assert!(before > 0.0 && active_secs(&harness) == before, "{before} and {}", active_secs(&harness));
}

#[test]
fn recordings_that_a_killed_program_left_behind_are_offered() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = window(dir.path(), None, vec2(1280.0, 800.0), false);
    go(&mut harness, Panel::Record);
    assert!(
        matches!(
            &backstage.orders_but_lists()[..],
            [WorkerCommand::Recorder(RecorderCommand::FindUnfinished(_))]
        ),
        "they are sought"
    );
    backstage.report(Report::Record(RecordReport::Unfinished(2)));
    harness.run_steps(2);
    harness.get_by_label("2 recordings not ended the last time can still be kept");
    harness.get_by_label("Keep").click();
    harness.run_steps(2);
    let orders = backstage.orders_but_lists();
    assert!(matches!(&orders[..], [WorkerCommand::Recorder(RecorderCommand::Recover(_))]), "{orders:?}");
    backstage.report(Report::Record(RecordReport::Recorded { episode: 4, n_steps: 90 }));
    harness.run_steps(2);
    harness.get_by_label("Episode 4 is on disk: 90 steps");
}
