//! Recorded episodes: listed, looked at again, deleted and brought back.

use dropj::dataset::{EpisodeInfo, Summary};
use dropj::worker::{EpisodeBrowserCommand, EpisodeList, EpisodeView, OpenEpisode, WorkerName};
use eframe::egui::Theme;
use egui_kittest::SnapshotResults;

use super::looks::has_adapter;
use super::*;

fn summary(number: usize) -> Summary {
    Summary {
        recording: format!("take-{number}"),
        number,
        info: EpisodeInfo { env: "car-racing".to_owned(), pilot: "person".to_owned(), seed: 7 },
        n_steps: 100 * (number + 1),
        n_planned: 20 * number,
        events: vec![("grass".to_owned(), 0.03 * number as f64)],
        done: number == 1,
        began_secs: 1_795_342_500 + 600 * number as i64,
    }
}

/// What the folder holds that the window begins with.
pub(crate) fn folder(numbers: &[usize], deleted: Option<usize>) -> Report {
    let episodes = numbers.iter().map(|number| summary(*number)).collect();
    let deleted = deleted.map(summary);
    let (dataset, damaged) = ("recordings".into(), Vec::new());
    Report::Record(RecordReport::Episodes(EpisodeList {
        dataset,
        episodes,
        damaged,
        deleted,
        is_changed: true,
    }))
}

/// A window on the record panel, with three episodes.
fn recordings(dir: &Path, picture: bool) -> (Harness<'static, Window>, Backstage) {
    let (mut harness, backstage) = window(dir, None, vec2(1280.0, 720.0), picture);
    go(&mut harness, Panel::Record);
    let is_list = |order: &WorkerCommand| {
        matches!(order, WorkerCommand::EpisodeBrowser(EpisodeBrowserCommand::List(_)))
    };
    assert_eq!(
        backstage.orders().iter().filter(|order| is_list(order)).count(),
        1,
        "the folder is listed once"
    );
    backstage.report(folder(&[0, 1, 2], None));
    harness.run_steps(2);
    (harness, backstage)
}

/// Clicks on the last episode, which is read.
fn open(harness: &mut Harness<'_, Window>, backstage: &Backstage) {
    harness.get_by_label("Episode 2: 300 steps · 6 % unsafe · shared").click();
    harness.run_steps(2);
    backstage.report(Report::Record(RecordReport::Opened(OpenEpisode {
        recording: "take-2".to_owned(),
        actions: (0..300).map(|t| Action::new([(t as f32 / 20.0).sin(), 0.1, 0.0])).collect(),
        rewards: vec![0.0; 300],
        unsafe_steps: vec![40..58, 200..203],
        planned: vec![100..140, 160..180],
    })));
    harness.run_steps(2);
}

/// There is a reward.
fn learned(harness: &mut Harness<'_, Window>, backstage: &Backstage) {
    backstage.report(Report::Reward(RewardReport::Learned {
        parameters: world().parameters,
        n_labels: 1,
        fit: None,
    }));
    harness.run_steps(2);
}

/// What the episode browser was asked for, by name and number.
fn asked(backstage: &Backstage) -> Vec<String> {
    let said = |order| match order {
        WorkerCommand::EpisodeBrowser(EpisodeBrowserCommand::Open { recording, .. }) => {
            Some(format!("open {recording}"))
        }
        WorkerCommand::EpisodeBrowser(EpisodeBrowserCommand::Show(step)) => Some(format!("look {step}")),
        WorkerCommand::EpisodeBrowser(EpisodeBrowserCommand::Delete { recording, .. }) => {
            Some(format!("delete {recording}"))
        }
        WorkerCommand::EpisodeBrowser(EpisodeBrowserCommand::BringBack { recording, .. }) => {
            Some(format!("bring back {recording}"))
        }
        WorkerCommand::EpisodeBrowser(EpisodeBrowserCommand::Close) => Some("close".to_owned()),
        _ => None,
    };
    backstage.orders().into_iter().filter_map(said).collect()
}

#[test]
fn a_recorded_episode_is_looked_at_again_step_by_step() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = recordings(dir.path(), false);
    open(&mut harness, &backstage);
    assert_eq!(asked(&backstage), ["open take-2"]);
    harness.get_by_label("Episode 2 at step 0");
    for key in [Key::Period, Key::Period, Key::Comma] {
        press(&mut harness, key);
    }
    assert_eq!(asked(&backstage), ["look 1", "look 2", "look 1"]);
    harness.get_by_label("In control person");
    press(&mut harness, Key::P);
    harness.run_steps(20);
    assert!(asked(&backstage).len() > 10, "it plays");
    press(&mut harness, Key::P);

    let rewards = [0.5, 0.4, 0.6].map(|reward| vec![reward; 300]);
    backstage.report(Report::Record(RecordReport::EpisodeRewards {
        recording: "take-2".to_owned(),
        rewards: rewards.clone(),
    }));
    harness.run_steps(2);
    assert!(harness.query_by_label_contains(": reward ").is_none(), "the reward of a session that was left");
    learned(&mut harness, &backstage);
    backstage.report(Report::Record(RecordReport::EpisodeRewards {
        recording: "take-1".to_owned(),
        rewards: rewards.clone(),
    }));
    harness.run_steps(2);
    assert!(harness.query_by_label_contains(": reward ").is_none(), "another episode's reward");
    backstage
        .report(Report::Record(RecordReport::EpisodeRewards { recording: "take-2".to_owned(), rewards }));
    harness.run_steps(2);
    harness.get_by_label_contains(": reward 0.50");

    press(&mut harness, Key::PageUp);
    assert_eq!(asked(&backstage).last().unwrap(), "open take-1");
    press(&mut harness, Key::Escape);
    assert_eq!(asked(&backstage), ["close"]);
    harness.get_by_label("The real world");
}

#[test]
fn an_episode_is_deleted_when_asked_twice_and_brought_back() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = recordings(dir.path(), false);
    open(&mut harness, &backstage);
    asked(&backstage);
    press(&mut harness, Key::Delete);
    press(&mut harness, Key::Escape);
    assert!(asked(&backstage).is_empty(), "nothing is deleted, and the episode stays open");
    press(&mut harness, Key::Delete);
    harness.get_by_label("Delete episode 2 from the folder?");
    press(&mut harness, Key::Enter);
    assert_eq!(asked(&backstage), ["delete take-2"]);
    // Until it is done nothing is recorded into the folder, whatever was listed before.
    if let Report::Record(RecordReport::Episodes(before)) = folder(&[0, 1, 2], None) {
        backstage.report(Report::Record(RecordReport::Episodes(EpisodeList { is_changed: false, ..before })));
        harness.run_steps(2);
    }
    press(&mut harness, Key::Enter);
    harness.get_by_label_contains("being put in order");
    assert!(!backstage.orders().iter().any(|order| matches!(order, WorkerCommand::Recorder(_))));
    backstage.report(folder(&[0, 1], Some(2)));
    harness.run_steps(2);
    assert!(harness.query_by_label_contains("Episode 2:").is_none());
    harness.get_by_label("Bring it back").click();
    harness.run_steps(2);
    assert_eq!(asked(&backstage), ["bring back take-2"]);
}

#[test]
fn what_cannot_be_deleted_stays_in_the_list() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = recordings(dir.path(), false);
    open(&mut harness, &backstage);
    press(&mut harness, Key::Delete);
    harness.get_by_label_contains("Yes, delete it").click();
    harness.run_steps(2);
    backstage.report(folder(&[0, 1, 2], None));
    let message = "another program is recording into the dataset at \"recordings\"";
    backstage.report(failed(WorkerName::EpisodeBrowser, message));
    harness.run_steps(2);
    harness.get_by_label_contains("Episode 2:");
    harness.get_by_label_contains("Another program is recording");
    assert!(harness.query_by_label("Bring it back").is_none(), "nothing is said to be deleted");
}

#[test]
fn a_recording_closes_the_episode_and_is_listed_when_it_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = recordings(dir.path(), false);
    open(&mut harness, &backstage);
    press(&mut harness, Key::Escape);
    press(&mut harness, Key::Enter);
    asked(&backstage);
    assert!(
        harness.query_by_label_contains("Episode 1:").is_none(),
        "nothing is looked at while somebody drives"
    );
    backstage.report(Report::Record(RecordReport::Recorded { episode: 3, n_steps: 9 }));
    harness.run_steps(2);
    let orders = backstage.orders();
    assert!(
        orders
            .iter()
            .any(|order| matches!(order, WorkerCommand::EpisodeBrowser(EpisodeBrowserCommand::List(_)))),
        "{orders:?}"
    );
}

#[test]
fn an_episode_that_is_looked_at_again_looks_as_it_did() {
    if !has_adapter() {
        return;
    }
    let mut results = SnapshotResults::new();
    for (theme, name) in [(Theme::Dark, "record-again-dark"), (Theme::Light, "record-again-light")] {
        let dir = tempfile::tempdir().unwrap();
        let (mut harness, backstage) = recordings(dir.path(), true);
        harness.ctx.set_theme(theme);
        open(&mut harness, &backstage);
        learned(&mut harness, &backstage);
        let at = |t: usize| (t as f32 / 13.0).sin() * 0.6 + (t as f32 / 3.0).cos() * 0.1;
        let rewards = [0.0, -0.12, 0.15].map(|by| (0..300).map(|t| at(t) + by).collect());
        backstage
            .report(Report::Record(RecordReport::EpisodeRewards { recording: "take-2".to_owned(), rewards }));
        let (recording, frame) = ("take-2".to_owned(), frame(90));
        backstage.slots.episode.put(EpisodeView { recording, step: 0, frame });
        harness.run_steps(8);
        results.add(harness.try_snapshot(name));
    }
}
