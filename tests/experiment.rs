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
