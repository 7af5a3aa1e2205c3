//! Experiments as the command line runs them: killed and gone on with, they come to the same.

#![cfg(unix)]

use std::fs;
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// A trial of a few seconds for each of two seeds.
const SMALL: &str = r#"
format = 1
name = "small"
title = "Whether it runs"
world = "car-racing"
methods = ["dropj"]
seeds = [0, 1]
dreams = 1
dream-steps = 50
queries = 6
first = [3, 6]
episodes = 1
episode-steps = 12
axis = "answers"
"#;

fn experiment(asked: &Path, out: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_dropj"));
    command.args(["experiment".as_ref(), asked, "--jobs".as_ref(), "1".as_ref(), "--out".as_ref(), out]);
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

fn finished(child: Child) -> String {
    let output = child.wait_with_output().expect("it was started");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    said
}

#[test]
fn an_experiment_that_is_killed_goes_on_and_comes_to_the_same() {
    let dir = tempfile::tempdir().unwrap();
    let asked = dir.path().join("small.toml");
    fs::write(&asked, SMALL).unwrap();
    let (whole, torn) = (dir.path().join("whole"), dir.path().join("torn"));

    let mut child = experiment(&asked, &torn).process_group(0).spawn().unwrap();
    let first = torn.join("trials/0000.jsonl");
    let begun = Instant::now();
    while !first.exists() {
        assert!(begun.elapsed() < Duration::from_mins(2), "the first trial is never done");
        std::thread::sleep(Duration::from_millis(20));
    }
    let group = rustix::process::Pid::from_child(&child);
    rustix::process::kill_process_group(group, rustix::process::Signal::KILL).unwrap();
    child.wait().unwrap();
    assert!(!torn.join("results.csv").exists() && !torn.join("trials/0001.jsonl").exists());
    let kept = fs::read(&first).unwrap();

    finished(experiment(&asked, &torn).spawn().unwrap());
    finished(experiment(&asked, &whole).spawn().unwrap());

    assert_eq!(fs::read(&first).unwrap(), kept, "what was done stands");
    for file in ["results.csv", "results.parquet", "summary.md", "figures/return.svg", "figures/return.png"] {
        assert!(fs::read(torn.join(file)).unwrap() == fs::read(whole.join(file)).unwrap(), "{file}");
    }
    let table = fs::read_to_string(whole.join("results.csv")).unwrap();
    assert_eq!(table.lines().count(), 1 + 2 * 2, "two seeds, two numbers of answers: {table}");

    // Another experiment does not get into that folder.
    fs::write(&asked, SMALL.replace("queries = 6", "queries = 7")).unwrap();
    let refused = experiment(&asked, &whole).output().unwrap();
    assert_eq!(refused.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("holds another experiment"));
}

#[test]
fn a_trial_that_cannot_be_is_said_with_its_reason() {
    let dir = tempfile::tempdir().unwrap();
    let asked = dir.path().join("small.toml");
    fs::write(&asked, SMALL.replace("world = ", "world-model = \"nowhere.safetensors\"\nworld = ")).unwrap();
    let output = experiment(&asked, &dir.path().join("run")).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(
        said.contains("2 of the trials came to nothing") && said.contains("nowhere.safetensors"),
        "{said}"
    );
}

/// The folder of a named experiment that was run at its smallest, two trials at a time.
fn toy(name: &str, dir: &Path) -> std::path::PathBuf {
    let out = dir.join(name);
    let mut command = Command::new(env!("CARGO_BIN_EXE_dropj"));
    command.args(["experiment", name, "--scale", "toy", "--jobs", "2", "--out"]).arg(&out);
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    finished(command.spawn().expect("the program is there"));
    out
}

/// The lines of a table behind its head, each as its cells by name.
fn table(path: &Path) -> Vec<std::collections::BTreeMap<String, String>> {
    let text = fs::read_to_string(path).expect("the table is there");
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().expect("it has a head").split(',').collect();
    lines.map(|line| names.iter().map(|name| (*name).to_owned()).zip(cells(line)).collect()).collect()
}

/// The cells of a line, of which those with commas are in quotes.
fn cells(line: &str) -> Vec<String> {
    let mut is_quoted = false;
    let mut cells = vec![String::new()];
    for letter in line.chars() {
        match letter {
            '"' => is_quoted = !is_quoted,
            ',' if !is_quoted => cells.push(String::new()),
            _ => cells.iter_mut().last().expect("it began with one").push(letter),
        }
    }
    cells
}

#[test]
fn world_models_of_few_episodes_are_shared_by_methods_and_measured() {
    let dir = tempfile::tempdir().unwrap();
    let out = toy("world-size", dir.path());
    let rows = table(&out.join("results.csv"));
    assert_eq!(rows.len(), 2 * 2 * 2, "two methods, two seeds, two numbers of episodes");
    for (recorded, seed) in [("2", "0"), ("3", "1")] {
        let of: Vec<_> =
            rows.iter().filter(|row| row["recorded"] == recorded && row["seed"] == seed).collect();
        assert_eq!(of.len(), 2);
        assert_ne!(of[0]["method"], of[1]["method"]);
        assert_eq!(of[0]["vision_loss"], of[1]["vision_loss"], "they share a world model");
        assert!(of[0]["vision_loss"].parse::<f64>().unwrap() > 0.0, "{:?}", of[0]);
    }
    let worlds = fs::read_dir(out.join("worlds")).unwrap().flatten();
    let n_models =
        worlds.filter(|it| it.file_name().to_string_lossy().ends_with(".probe.safetensors")).count();
    assert_eq!(n_models, 4, "one for each seed and number of episodes");
    let words = fs::read_to_string(out.join("summary.md")).unwrap();
    assert!(words.contains("held-out loss of vision") && words.contains("| world models | 2 |"), "{words}");
    for figure in ["return", "vision_loss", "memory_loss", "dreamed_error"] {
        assert!(out.join(format!("figures/{figure}.svg")).is_file(), "{figure}");
    }
}

#[test]
fn gradients_are_told_of_each_epoch_and_nothing_is_driven() {
    let dir = tempfile::tempdir().unwrap();
    let out = toy("theorem", dir.path());
    let rows = table(&out.join("gradients.csv"));
    // Before the first step p is a half, where the fit is ours.
    let begin =
        rows.iter().filter(|row| row["epoch"] == "0" && row["fit"] == "ours" && row["about"] == "safety");
    let begin: Vec<f64> = begin.map(|row| row["logit"].parse().unwrap()).collect();
    assert!(!begin.is_empty() && begin.iter().all(|logit| (logit - 0.5).abs() < 1e-3), "{begin:?}");
    assert!(rows.iter().any(|row| row["epoch"].parse::<usize>().unwrap() > 10), "through the whole fit");
    assert_eq!(table(&out.join("results.csv")).len(), 0);
    assert!(fs::read_to_string(out.join("summary.md")).unwrap().contains("The claim (Theorem 1)"));
    assert!(out.join("figures/gradients-1-parameters.png").is_file());
}

#[test]
fn a_search_for_weights_that_is_killed_goes_on_after_what_it_tried() {
    let dir = tempfile::tempdir().unwrap();
    let whole = toy("learned-weights", dir.path());
    let kept = fs::read(whole.join("evaluations.csv")).unwrap();
    assert_eq!(table(&whole.join("evaluations.csv")).len(), 2 * 4, "four of each of two seeds");
    let results = fs::read(whole.join("results.csv")).unwrap();
    let rows = table(&whole.join("results.csv"));
    assert_eq!(rows.iter().filter(|row| row["found"] == "1").count(), 2);
    assert_eq!(rows.iter().filter(|row| row["found"] == "0").count(), 2, "beside the usual weights");

    // As if the first trial had been killed after its second evaluation.
    let tried = whole.join("trials/0000.evaluations.jsonl");
    let lines = fs::read_to_string(&tried).unwrap();
    let first_two: Vec<&str> = lines.lines().take(2).collect();
    fs::write(&tried, first_two.join("\n") + "\n").unwrap();
    fs::remove_file(whole.join("trials/0000.jsonl")).unwrap();
    toy("learned-weights", dir.path());
    assert_eq!(fs::read_to_string(&tried).unwrap(), lines);
    assert!(fs::read(whole.join("evaluations.csv")).unwrap() == kept, "what was tried is the same");
    assert!(fs::read(whole.join("results.csv")).unwrap() == results, "and what came of it");
}

#[test]
fn states_of_one_shot_trajectories_are_laid_out_and_times_stand_apart() {
    let dir = tempfile::tempdir().unwrap();
    let out = toy("q1-one-shot", dir.path());
    let points = table(&out.join("tsne.csv"));
    let of = |method: &str| points.iter().filter(|row| row["method"] == method).count();
    assert!(of("dros") > 0 && of("dros") == of("request"), "{} and {}", of("dros"), of("request"));
    let times = table(&out.join("times.csv"));
    assert_eq!(times.len(), 2 * 2, "two methods and two seeds");
    assert!(times.iter().all(|row| row["seconds"].parse::<f64>().unwrap() > 0.0));
    assert!(!fs::read_to_string(out.join("results.csv")).unwrap().contains("seconds"));
    let words = fs::read_to_string(out.join("summary.md")).unwrap();
    assert!(words.contains("Measured by the clock of this machine") && words.contains("t-SNE"), "{words}");
    assert!(out.join("figures/tsne.png").is_file());
}
