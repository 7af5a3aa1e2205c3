//! Runs side by side: what is opened, what is said of it, and driven episodes looked at again.

use dropj::evaluation::{EpisodeMetrics, EventFigure};
use dropj::worker::{ReplayView, ReplayerCommand};
use dropj::world::Count;
use eframe::egui::Theme;
use egui_kittest::SnapshotResults;

use super::looks::has_adapter;
use super::merge::drop_on;
use super::*;

/// The results that come with the program.
const SHIPPED: &str = "assets/results/q3-justifications";

fn evaluated(harness: &Harness<'_, Window>) -> Vec<(String, bool)> {
    harness.state().app().state().evaluated()
}

fn says(harness: &Harness<'_, Window>, text: &str) -> bool {
    harness.query_by_label_contains(text).is_some()
}

fn names(harness: &Harness<'_, Window>) -> Vec<String> {
    evaluated(harness).into_iter().map(|(name, _)| name).collect()
}

/// What `deploy --json` prints of so many episodes.
fn file(dir: &Path, name: &str, n: u64, by: f64) -> std::path::PathBuf {
    let line = |track: u64| {
        let ret = by + 7.0 * track as f64;
        format!(
            "{{\"track\": {track}, \"metrics\": {{\"ret\": {ret}, \"unsafe_rate\": 0.25, \"bump_rate\": 0.{track}, \"n_steps\": 90}}}}\n"
        )
    };
    let path = dir.join(name);
    std::fs::write(&path, (1..=n).map(line).collect::<String>()).unwrap();
    path
}

/// A window in which the results that come with the program are open.
fn opened(dir: &Path, size: Vec2, picture: bool) -> (Harness<'static, Window>, Backstage) {
    let (mut harness, backstage) = window(dir, None, size, picture);
    drop_on(&mut harness, Path::new(SHIPPED));
    wait_for(&mut harness, |harness| !evaluated(harness).is_empty());
    harness.run_steps(4);
    (harness, backstage)
}

#[test]
fn a_folder_of_results_that_is_dropped_opens_with_figures_and_tests() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = opened(dir.path(), vec2(1280.0, 1600.0), false);
    assert_eq!(harness.state().app().state().panel(), Panel::Evaluate);
    assert_eq!(names(&harness), ["DROP", "DROPe", "DROPJ"]);
    // As its summary says it.
    harness.get_by_label_contains("Paired by seed and track (12 blocks): Friedman χ² = 3.2, p = 0.2028.");
    harness.get_by_label("-3 [-267, 334]");
    assert_eq!(harness.state().app().state().verdicts(), ["not told apart"; 3]);
    harness.get_by_label_contains("Return of each episode. DROP: median 20");
    harness.get_by_label_contains("Return over answers. DROP: 2084 at the end; DROPe: 2087 at the end");
    harness.get_by_label("grass").click();
    harness.run_steps(3);
    harness.get_by_label_contains("Grass (%) of each episode. DROP");
    harness.get_by_label_contains("Friedman χ² = 4.9");

    harness.get_by_label("2 DROPe").click();
    harness.run_steps(3);
    assert_eq!(evaluated(&harness)[1], ("DROPe".to_owned(), false));
    assert!(!says(&harness, "DROP − DROPe") && says(&harness, "DROP − DROPJ"));
    // Until the message of the first time is gone.
    wait_for(&mut harness, |harness| !says(harness, "is open"));
    drop_on(&mut harness, Path::new(SHIPPED));
    wait_for(&mut harness, |harness| says(harness, "is open"));
    assert_eq!(names(&harness).len(), 3, "what is opened again takes its place");
    harness.get_by_label("Close q3-justifications").click();
    harness.run_steps(3);
    harness.get_by_label("Nothing to compare yet");
}

#[test]
fn what_is_damaged_is_said_and_changes_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = window(dir.path(), None, vec2(1280.0, 800.0), false);
    let panel = harness.state().app().state().panel();
    let torn = dir.path().join("torn");
    std::fs::create_dir(&torn).unwrap();
    std::fs::copy(Path::new(SHIPPED).join("experiment.toml"), torn.join("experiment.toml")).unwrap();
    let csv = std::fs::read_to_string(Path::new(SHIPPED).join("results.csv")).unwrap();
    std::fs::write(torn.join("results.csv"), &csv[..csv.len() / 2]).unwrap();
    let other = dir.path().join("other.json");
    std::fs::write(&other, "{\"hello\": 1}").unwrap();
    for (path, said) in [(&torn, "no table of an experiment"), (&other, "no episodes in these results")] {
        drop_on(&mut harness, path);
        wait_for(&mut harness, |harness| says(harness, said));
        assert_eq!(harness.state().app().state().panel(), panel);
        assert!(evaluated(&harness).is_empty());
    }
}

#[test]
fn files_of_one_seed_stand_side_by_side_and_are_not_called_different() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = window(dir.path(), None, vec2(1280.0, 1600.0), false);
    for (name, n, by) in [("low.json", 8, 0.0), ("high.json", 8, 4000.0)] {
        drop_on(&mut harness, &file(dir.path(), name, n, by));
        let name = name.trim_end_matches(".json").to_owned();
        wait_for(&mut harness, |harness| names(harness).contains(&name));
    }
    harness.run_steps(3);
    assert_eq!(harness.state().app().state().verdicts(), ["one seed"], "however far apart");
    harness.get_by_label_contains("Nothing is called different on one seed");
    harness.get_by_label_contains("Paired by seed and track (8 blocks)");
    harness.get_by_label("4032 ± 16");
    harness.get_by_label("In the order of opening").click();
    harness.run_steps(2);
    assert_eq!(names(&harness), ["high", "low"]);
    harness.get_by_label("Name of results 1").focus();
    harness.run_steps(1);
    harness.key_press_modifiers(eframe::egui::Modifiers::COMMAND, Key::A);
    harness.get_by_label("Name of results 1").type_text("straight on");
    harness.run_steps(3);
    assert_eq!(names(&harness), ["high", "straight on"]);

    harness.get_by_label("A folder for all tables (CSV) and figures (SVG and PNG)").focus();
    harness.run_steps(1);
    harness.key_press_modifiers(eframe::egui::Modifiers::COMMAND, Key::A);
    let out = dir.path().join("out");
    harness
        .get_by_label("A folder for all tables (CSV) and figures (SVG and PNG)")
        .type_text(&out.display().to_string());
    harness.run_steps(2);
    harness.get_by_label("Save everything").click();
    wait_for(&mut harness, |harness| says(harness, "5 files are in out"));
    let tests = std::fs::read_to_string(out.join("tests.csv")).unwrap();
    assert!(tests.contains("straight on,high,-4000") && tests.contains("one seed"), "{tests}");
}

fn metrics(ret: f32) -> EpisodeMetrics {
    let grass = EventFigure { name: "grass".to_owned(), count: Count::PerStep, value: Some(0.04) };
    EpisodeMetrics { ret, unsafe_rate: 0.04, events: vec![grass], n_steps: 300, ..EpisodeMetrics::default() }
}

/// The planner has driven so many episodes to their ends.
fn driven(backstage: &Backstage, n: u64) {
    for seed in 1..=n {
        let actions: Vec<_> = (0..300).map(|t| Action::new([(t as f32 / 20.0).sin(), 0.1, 0.0])).collect();
        let (metrics, actions) = (metrics(700.0 + seed as f32), actions.into());
        backstage.report(Report::Deploy(DeployReport::Ended { seed, metrics, actions }));
    }
}

#[test]
fn what_was_driven_is_there_again_when_its_session_is() {
    let dir = tempfile::tempdir().unwrap();
    let store = session(dir.path(), Protocol::Dropj);
    let folder = store.dir().to_owned();
    let (mut harness, backstage) = window(dir.path(), Some(store), vec2(1280.0, 800.0), false);
    driven(&backstage, 2);
    wait_for(&mut harness, |_| {
        std::fs::read_to_string(folder.join("driven.jsonl")).is_ok_and(|text| text.lines().count() == 2)
    });
    drop((harness, backstage));

    let store = SessionStore::open(&folder, None).unwrap();
    let (mut harness, backstage) = window(dir.path(), Some(store), vec2(1280.0, 800.0), false);
    go(&mut harness, Panel::Evaluate);
    let returns = |harness: &Harness<'_, Window>| {
        let episodes = harness.state().app().state().deployed();
        episodes.iter().map(|(seed, metrics)| (*seed, metrics.ret)).collect::<Vec<_>>()
    };
    assert_eq!(returns(&harness), [(1, 701.0), (2, 702.0)]);
    let n_runs = |harness: &Harness<'_, Window>| {
        harness.query_all_by_label_contains("Close 2026-11-22T10-15-00-test").count()
    };
    assert_eq!(n_runs(&harness), 1);
    // What is driven now is of the same run.
    driven(&backstage, 1);
    wait_for(&mut harness, |harness| returns(harness).len() == 3);
    assert_eq!(n_runs(&harness), 1);
}

/// What the replayer was asked for.
fn asked(backstage: &Backstage) -> Vec<String> {
    let said = |order| match order {
        WorkerCommand::Replayer(ReplayerCommand::Drive { seed, actions, .. }) => {
            Some(format!("drive {seed} in {}", actions.len()))
        }
        WorkerCommand::Replayer(ReplayerCommand::Show(step)) => Some(format!("look {step}")),
        WorkerCommand::Replayer(ReplayerCommand::Close) => Some("close".to_owned()),
        _ => None,
    };
    backstage.orders().into_iter().filter_map(said).collect()
}

/// The number by which the replayer knows the episode that is looked at.
fn replay(backstage: &Backstage) -> u64 {
    let number = |order| match order {
        WorkerCommand::Replayer(ReplayerCommand::Drive { replay, .. }) => Some(replay),
        _ => None,
    };
    backstage.orders().into_iter().find_map(number).unwrap()
}

#[test]
fn an_episode_of_the_planner_is_driven_again_and_looked_at_step_by_step() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = window(dir.path(), None, vec2(1280.0, 1200.0), false);
    driven(&backstage, 2);
    harness.run_steps(2);
    go(&mut harness, Panel::Evaluate);
    assert_eq!(names(&harness), ["this window"]);
    backstage.orders();
    harness.get_by_label_contains("Episode 2 on seed 2: return 702").click();
    harness.run_steps(3);
    let number = replay(&backstage);
    for key in [Key::Period, Key::Period, Key::Comma] {
        press(&mut harness, key);
    }
    assert_eq!(asked(&backstage), ["look 1", "look 2", "look 1"]);
    harness.get_by_label("Driven again under way");
    backstage.slots.replay.put(ReplayView { replay: number, step: 1, frame: frame(90) });
    let done = |metrics| {
        let unsafe_steps = vec![3..15, 40..42];
        EvaluateReport::Replayed { replay: number, metrics, unsafe_steps }
    };
    backstage.report(Report::Evaluate(done(metrics(702.0))));
    harness.run_steps(2);
    harness.get_by_label("Driven again the same figures");
    harness.get_by_label("Episode 2 at step 1");
    backstage.report(Report::Evaluate(done(metrics(703.0))));
    harness.run_steps(2);
    harness.get_by_label("Driven again other figures");
    press(&mut harness, Key::P);
    harness.run_steps(20);
    assert!(asked(&backstage).len() > 10, "it plays");
    press(&mut harness, Key::PageUp);
    let all = asked(&backstage);
    assert_eq!(all[all.len() - 2..], ["close", "drive 1 in 300"]);
    press(&mut harness, Key::Escape);
    assert_eq!(asked(&backstage), ["close"]);
    harness.get_by_label_contains("Episode 1 on seed 1");
}

#[test]
fn runs_side_by_side_look_as_they_did() {
    if !has_adapter() {
        return;
    }
    let mut results = SnapshotResults::new();
    for (theme, of, size) in [
        (Theme::Dark, "dark", vec2(1280.0, 1240.0)),
        (Theme::Light, "light", vec2(1280.0, 720.0)),
        (Theme::Light, "again", vec2(1280.0, 1500.0)),
        (Theme::Light, "narrow", vec2(880.0, 600.0)),
    ] {
        let dir = tempfile::tempdir().unwrap();
        let (mut harness, backstage) = opened(dir.path(), size, true);
        harness.ctx.set_theme(theme);
        driven(&backstage, 3);
        harness.run_steps(4);
        // What is said of it passes.
        harness.run_steps(120);
        if of == "again" {
            harness.get_by_label_contains("Episode 2 on seed 2").click();
            harness.run_steps(3);
            let number = replay(&backstage);
            backstage.slots.replay.put(ReplayView { replay: number, step: 0, frame: frame(90) });
            let (metrics, unsafe_steps) = (metrics(702.0), vec![40..58, 200..203]);
            let report = EvaluateReport::Replayed { replay: number, metrics, unsafe_steps };
            backstage.report(Report::Evaluate(report));
            harness.set_size(vec2(1280.0, 720.0));
            harness.run_steps(4);
        }
        results.add(harness.try_snapshot(format!("evaluate-runs-{of}")));
    }
}

#[test]
fn ten_runs_of_a_hundred_episodes_are_drawn_and_how_fast_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = window(dir.path(), None, vec2(1280.0, 1600.0), false);
    for i in 0..10 {
        drop_on(&mut harness, &file(dir.path(), &format!("run {i}.json"), 100, 100.0 * f64::from(i)));
        wait_for(&mut harness, |harness| names(harness).len() == i as usize + 1);
    }
    harness.run_steps(10);
    harness.get_by_label_contains("More than 8 runs are not compared two by two");
    let since = std::time::Instant::now();
    harness.run_steps(50);
    eprintln!("a picture of ten runs takes {:.1} ms", since.elapsed().as_secs_f64() * 20.0);
}
