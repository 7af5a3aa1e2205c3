//! Pictures of every panel in both themes, for the eye: `UPDATE_SNAPSHOTS=1` makes them anew.

use dropj::evaluation::Tally;
use dropj::query::DreamId;
use dropj::tensor::Parameters;
use dropj::worker::{CandidateView, DreamRewards, DriveView, Learning, Promise, ReviewView, RolloutView};
use dropj::world::{Happened, Status, Step};
use eframe::egui::Theme;
use egui_kittest::SnapshotResults;

use super::*;

/// A window on a session with three answers and a reward, in which everything has something to show.
fn lived_in(dir: &Path, theme: Theme, scale: f32) -> (Harness<'static, Window>, Backstage) {
    let (mut harness, backstage) =
        window_at(dir, Some(session(dir, Protocol::Dropj)), vec2(1280.0, 720.0), true, None, scale);
    harness.ctx.set_theme(theme);
    go(&mut harness, Panel::Label);
    for key in [Key::A, Key::ArrowRight, Key::S, Key::P] {
        press(&mut harness, key);
    }
    for epoch in 0..20 {
        backstage.report(Report::Reward(RewardReport::Learning(learning(epoch))));
    }
    backstage.report(Report::Reward(RewardReport::Learned { parameters: reward(), n_labels: 3, fit: None }));
    backstage.slots.drive.put(driving());
    harness.run_steps(2);
    (harness, backstage)
}

/// Shows `panel` with all that workers have to say of it.
fn open(harness: &mut Harness<'_, Window>, backstage: &Backstage, panel: Panel) {
    go(harness, panel);
    if panel == Panel::Record {
        backstage.report(episodes::folder(&[0, 1, 2], None));
    }
    if panel == Panel::Reward {
        backstage.slots.review.put(review(DreamId(1)));
        backstage.report(Report::Dream(DreamReport::Rewards(judgement(DreamId(1)))));
    }
    harness.run_steps(8);
}

fn reward() -> Parameters {
    world().parameters
}

#[test]
fn every_panel_looks_as_it_did_in_the_dark() {
    every_panel_looks_as_it_did(Theme::Dark, "dark");
}

#[test]
fn every_panel_looks_as_it_did_in_the_light() {
    every_panel_looks_as_it_did(Theme::Light, "light");
}

fn every_panel_looks_as_it_did(theme: Theme, of: &str) {
    if !has_adapter() {
        return;
    }
    let mut results = SnapshotResults::new();
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = lived_in(dir.path(), theme, 1.0);
    for panel in Panel::ALL {
        open(&mut harness, &backstage, panel);
        let name = panel.name().to_lowercase().replace(' ', "-");
        results.add(harness.try_snapshot(format!("{name}-{of}")));
    }
    harness.get_by_label("Keys and help").click();
    harness.run_steps(10);
    results.add(harness.try_snapshot(format!("keys-{of}")));
    harness.get_by_label("Gamepad").click();
    harness.run_steps(10);
    results.add(harness.try_snapshot(format!("gamepad-{of}")));
}

#[test]
fn panels_are_crisp_at_twice_the_size() {
    if !has_adapter() {
        return;
    }
    let mut results = SnapshotResults::new();
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = lived_in(dir.path(), Theme::Dark, 2.0);
    for (panel, name) in [(Panel::Dream, "dream-200"), (Panel::Reward, "reward-200")] {
        open(&mut harness, &backstage, panel);
        results.add(harness.try_snapshot(name));
    }
}

#[test]
fn empty_panels_and_a_dream_that_is_looked_at_again_look_as_they_did() {
    if !has_adapter() {
        return;
    }
    let mut results = SnapshotResults::new();
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = window(dir.path(), None, vec2(1280.0, 720.0), true);
    results.add(harness.try_snapshot("first-start"));
    go(&mut harness, Panel::Reward);
    results.add(harness.try_snapshot("reward-empty"));
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = lived_in(dir.path(), Theme::Dark, 1.0);
    go(&mut harness, Panel::Dream);
    harness.get_by_label_contains("Dream 1: 200 steps").click();
    harness.run_steps(2);
    backstage.slots.review.put(review(DreamId(0)));
    backstage.report(Report::Dream(DreamReport::Rewards(judgement(DreamId(0)))));
    harness.run_steps(8);
    results.add(harness.try_snapshot("dream-again"));
    go(&mut harness, Panel::Record);
    press(&mut harness, Key::B);
    press(&mut harness, Key::Enter);
    let scene = vec![150; 3 * 600 * 480];
    for step in 1..60 {
        let picture = Some((600, 480, scene.clone().into()));
        backstage.slots.record.put(LiveView { picture, ..view(step) });
        let drift = 0.002 * step as f32;
        backstage.slots.rollout.put(RolloutView { frame: frame(90), step, since: step, drift });
        harness.step();
    }
    results.add(harness.try_snapshot("record-beside"));
}

/// What a reviewer sees of a dream of 200 steps, somewhere in it.
pub(crate) fn review(dream: DreamId) -> ReviewView {
    let promise = |i: usize| Promise {
        actions: format!("left {} · straight {}", i % 5 + 1, 14 - i % 5),
        now: (i as f32 * 1.7).sin() * 4.0,
        before: Some((i as f32 * 1.7 + 0.4).sin() * 3.5),
    };
    let promises: Vec<Promise> = (0..15).map(promise).collect();
    ReviewView { dream, step: 0, frame: frame(90), promises, chosen: 1, chosen_before: Some(8) }
}

/// What a reward says of a dream of 200 steps.
pub(crate) fn judgement(dream: DreamId) -> DreamRewards {
    let at = |t: usize| (t as f32 / 13.0).sin() * 0.6 + (t as f32 / 3.0).cos() * 0.1;
    let n = if dream == DreamId(0) { 200 } else { 90 };
    DreamRewards {
        dream,
        rewards: (0..n).map(at).collect(),
        low: (0..n).map(|t| at(t) - 0.12).collect(),
        high: (0..n).map(|t| at(t) + 0.15).collect(),
    }
}

pub(crate) fn learning(epoch: usize) -> Learning {
    let loss = |member: usize| 0.7 / (1.0 + 0.1 * (epoch + member) as f32);
    Learning {
        epoch,
        losses: (0..3).map(loss).collect(),
        held_out_loss: Some(loss(4)),
        agreement: Some(1.0 - loss(4)),
        n_labels: epoch,
        fit_epochs: None,
    }
}

pub(crate) fn driving() -> DriveView {
    let candidate = |i: usize| CandidateView {
        actions: "straight 15".to_owned(),
        predicted_return: 0.1 * i as f32,
        frames: vec![frame(10 * i)],
    };
    let spec = WorldSpec::default();
    let mut tally = Tally::of(&spec.events);
    let events = vec![Happened::default(); spec.events.len()];
    tally.add(&Step { frame: frame(90), reward: Some(10.0), events, executed: None, end: None }, Some(0.004));
    DriveView {
        frame: frame(90),
        picture: (4, 3, vec![120; 36].into()),
        step: 1,
        metrics: tally.metrics(),
        candidates: (0..15).map(candidate).collect(),
        chosen: 6,
        plan_ms: 4.0,
        status: Some(Status { text: "0 of 4 wheels off the road".to_owned(), is_fine: true }),
    }
}

/// Whether pictures can be drawn here at all; where they must be, that is an error.
pub(crate) fn has_adapter() -> bool {
    let draws = std::panic::catch_unwind(|| {
        Harness::builder()
            .with_size(vec2(8.0, 8.0))
            .wgpu()
            .build_ui(|ui| drop(ui.label("x")))
            .render()
            .is_ok()
    });
    let has_one = draws.unwrap_or(false);
    assert!(
        has_one || std::env::var_os("REQUIRE_WGPU").is_none(),
        "REQUIRE_WGPU is set, but nobody can draw"
    );
    if !has_one {
        eprintln!("SKIPPED: there is no graphics adapter, not even in software");
    }
    has_one
}
