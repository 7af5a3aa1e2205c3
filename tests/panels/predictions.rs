//! What the reward says of clips: shown where an answer is looked at again, and nowhere else.

use dropj::query::Query;
use dropj::worker::{ClipRewards, DreamInspectorCommand};
use eframe::egui::Theme;
use egui_kittest::SnapshotResults;

use super::looks::has_adapter;
use super::*;

/// The queries that the reward was asked about.
fn asked(backstage: &Backstage) -> Vec<Query> {
    let of = |order| match order {
        WorkerCommand::DreamInspector(DreamInspectorCommand::Predict(query)) => Some(query),
        _ => None,
    };
    backstage.orders().into_iter().filter_map(of).collect()
}

fn predicted(query: Query) -> Report {
    let clip = |level: f32| {
        let at = |t: usize, by: f32| level + by + 0.2 * (t as f32 / 4.0).sin();
        let row = |by: f32| (0..SEGMENT_LEN).map(|t| at(t, by)).collect::<Vec<_>>();
        ClipRewards { rewards: row(0.0), members: [-0.1, 0.02, 0.08].map(row).into() }
    };
    Report::Label(LabelReport::Predicted { query, clips: [clip(0.4), clip(-0.3)] })
}

/// A window with an answer and a reward, in which the first answer is looked at again.
fn reconsidering(dir: &Path, picture: bool, theme: Theme) -> (Harness<'static, Window>, Backstage) {
    let store = session(dir, Protocol::Dropj);
    let (mut harness, backstage) = window(dir, Some(store), vec2(1280.0, 720.0), picture);
    harness.ctx.set_theme(theme);
    go(&mut harness, Panel::Label);
    press(&mut harness, Key::A);
    let parameters = world().parameters;
    backstage.report(Report::Reward(RewardReport::Learned { parameters, n_labels: 1, fit: None }));
    harness.run_steps(4);
    assert!(asked(&backstage).is_empty(), "nothing is said of a query that is still to be answered");
    if harness.query_by_label_contains("Query 1: ").is_none() {
        harness.get_by_label_contains("Answers").click();
        harness.run_steps(2);
    }
    harness.get_by_label_contains("Query 1: ").click();
    harness.run_steps(4);
    (harness, backstage)
}

#[test]
fn the_reward_is_drawn_under_clips_that_were_answered_and_under_no_others() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = reconsidering(dir.path(), false, Theme::Dark);
    let queries = asked(&backstage);
    assert_eq!(queries.iter().map(|query| query.id).collect::<Vec<_>>(), [QueryId(0)], "once");
    backstage.report(predicted(queries[0]));
    harness.run_steps(2);
    harness.get_by_label_contains("Left clip: the reward gives it +");
    harness.get_by_label_contains("Right clip: the reward gives it -");
    // Another reward says something else.
    backstage.report(Report::Reward(RewardReport::Learned {
        parameters: world().parameters,
        n_labels: 1,
        fit: None,
    }));
    harness.run_steps(2);
    assert!(harness.query_by_label_contains("the reward gives it").is_none());
    assert_eq!(asked(&backstage), queries);
    backstage.report(predicted(queries[0]));
    harness.run_steps(2);
    press(&mut harness, Key::D);
    assert_eq!(responses(&harness), [Response::Safety(SafetyAnswer::OnlyRight)]);
    assert!(harness.query_by_label_contains("the reward gives it").is_none(), "the next one is not answered");
    // Nor is one whose answer was taken back.
    press(&mut harness, Key::Backspace);
    press(&mut harness, Key::Backspace);
    assert_eq!((responses(&harness), harness.state().app().shown()), (vec![], Some(QueryId(0))));
    assert!(harness.query_by_label_contains("the reward gives it").is_none());
    assert!(asked(&backstage).is_empty());
}

#[test]
fn the_reward_under_clips_looks_as_it_did() {
    if !has_adapter() {
        return;
    }
    let mut results = SnapshotResults::new();
    for (theme, name) in [(Theme::Dark, "predicted-dark"), (Theme::Light, "predicted-light")] {
        let dir = tempfile::tempdir().unwrap();
        let (mut harness, backstage) = reconsidering(dir.path(), true, theme);
        backstage.report(predicted(asked(&backstage)[0]));
        press(&mut harness, Key::Num0);
        press(&mut harness, Key::Period);
        results.add(harness.try_snapshot(name));
    }
}
