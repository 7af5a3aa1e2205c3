//! A world that is none of ours, in a process of plain Python: recorded, fitted, dreamed, answered and deployed in seconds,
//! and what is said and kept where its process fails.
#![expect(clippy::print_stderr, reason = "a test that is skipped says so")]

#[path = "support/program.rs"]
mod program;

use std::fs;
use std::path::Path;
use std::process::Command;

use dropj::dataset::Dataset;
use dropj::session::SessionStore;
use program::{dropj, shipped};

/// The world's file, whose process does `fault` in its 20th step; it is waited for a second.
fn write_world(dir: &Path, name: &str, fault: &str) {
    let script = shipped("tests/support/channel_world.py");
    let text = format!(
        r#"
format = 1
name = "channel"
title = "A boat in a channel"
rate = 10
longest_episode = 80
source = {{ kind = "process", command = ["python3", {script:?}, {fault:?}], time_outs = {{ start = 30.0, reset = 20.0, step = 3.0, close = 0.5 }} }}
image = {{ height = 16, width = 24 }}

[[axes]]
name = "rudder"
low = 0
high = 10
neutral = 5
mirrored = true
keys = [{{ key = "Left", to = 0 }}, {{ key = "Right", to = 10 }}]

[[axes]]
name = "throttle"
low = 0
high = 2
neutral = 0
keys = [{{ key = "Up", to = 2 }}]

[[events]]
name = "aground"
kind = "safety"
field = "aground"

[[justifications]]
name = "aground"
events = ["aground"]
weight = 1.0

[planner]
horizon = 8

[networks]
latent = 8
memory = 32
channels = 8

[fitting]
vae_epochs = 2
mdn_rnn_epochs = 2
window = 40
"#
    );
    fs::write(dir.join(name), text).expect("the folder can be written");
}

fn has_python() -> bool {
    let is_there = Command::new("python3").arg("--version").output().is_ok_and(|ran| ran.status.success());
    if !is_there {
        eprintln!("skipped: there is no python3");
    }
    is_there
}

#[test]
fn a_world_of_somebody_else_goes_through_all_four_steps() {
    if !has_python() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    write_world(dir, "world.toml", "");
    let run = |line: &str| dropj(dir, line.split_whitespace()).succeeded().to_owned();

    let said = run("record --env world.toml --episodes 12 --seed 1 --out data");
    assert!(said.contains("12 episodes of 960 steps recorded, aground"), "{said}");
    // The same episodes again: nothing is recorded twice, and another folder gets the same.
    run("record --env world.toml --episodes 2 --seed 1 --out again");
    let (first, again) =
        (Dataset::open(&dir.join("data")).unwrap(), Dataset::open(&dir.join("again")).unwrap());
    assert_eq!(first.episode(1).unwrap().actions, again.episode(1).unwrap().actions);
    let episode = first.episode(0).unwrap();
    assert_eq!(
        (episode.layout.axes.as_slice(), episode.layout.rate),
        (["rudder", "throttle"].map(str::to_owned).as_slice(), 10.0)
    );
    let aground: usize = first
        .episodes()
        .map(|it| it.unwrap().event("aground").unwrap().iter().filter(|is| **is).count())
        .sum();
    assert!((96..640).contains(&aground), "{aground} of 960 steps aground: both are recorded");

    fs::write(
        dir.join("fit.toml"),
        "[fit-world.fit.vae]\nupdates_per_epoch = 60\n[fit-world.fit.mdn_rnn]\nupdates_per_epoch = 30\n",
    )
    .unwrap();
    let said =
        run("fit-world --env world.toml --data data --out channel-world.safetensors --config fit.toml");
    assert!(said.contains("channel-world.safetensors"), "{said}");
    // Its file tells how it was fitted.
    let settings = run(
        "fit-world --env world.toml --data data --out again.safetensors --like channel-world.safetensors --seed 7 --print-config",
    );
    for line in ["updates_per_epoch = 60", "updates_per_epoch = 30", "window = 40", "memory = 32", "seed = 7"]
    {
        assert!(settings.contains(line), "{line} in {settings}");
    }
    let said = run("fit-probe --env world.toml --data data --out channel-probe.safetensors --updates 150");
    assert!(said.contains("aground"), "{said}");
    for (protocol, session) in [("dropj", "justified"), ("drop", "preferred")] {
        run(&format!(
            "simulate --env world.toml --protocol {protocol} --dreams 2 --steps 80 --queries 20 --seed 3 --out {session}"
        ));
        let store = SessionStore::open(&dir.join(session), None).unwrap();
        assert_eq!(store.session().dream_lens().len(), 2);
    }
    // The session knows its world's file by itself.
    let told = run("deploy --session justified --episodes 2 --seed 5 --steps steps.csv");
    assert!(told.contains("aground"), "{told}");
    let steps = fs::read_to_string(dir.join("steps.csv")).unwrap();
    assert!(steps.starts_with("track,step,aground,rudder,throttle,chosen,best,worst\n"), "{}", &steps[..100]);
    assert_eq!(steps.lines().count(), 1 + 2 * 80);
    for line in steps.lines().skip(1) {
        let cells: Vec<f32> = line.split(',').skip(3).take(2).map(|cell| cell.parse().unwrap()).collect();
        assert!((0.0..=10.0).contains(&cells[0]) && (0.0..=2.0).contains(&cells[1]), "{line}");
    }
    assert_eq!(run("deploy --session justified --episodes 1 --seed 5 --json").lines().count(), 2);
    run("replay justified");

    // What its reward was told of the hazard, and what it makes of recorded moments with it.
    let said = run("check-reward --session justified --data data --episodes 6 --on preferred --json");
    let told: serde_json::Value = serde_json::from_str(&said).unwrap();
    let hazard = &told["hazards"][0];
    let steps = |name: &str| hazard[name].as_u64().unwrap();
    assert_eq!((hazard["hazard"].as_str(), steps("n_with") + steps("n_without")), (Some("aground"), 6 * 80));
    assert_eq!(
        steps("n_named") + told["n_by_default"].as_u64().unwrap(),
        told["n_answers"].as_u64().unwrap()
    );
    assert!((0.0..=1.0).contains(&hazard["auc"].as_f64().unwrap()), "{said}");
    assert!(told["predictions"][0]["session"].as_str().unwrap().contains("preferred"), "{said}");
    let lines = run("check-reward --session justified");
    assert!(lines.contains("named by") && !lines.contains("ranked below safe"), "{lines}");
    let lines = run("check-reward --session justified --data data");
    assert!(lines.contains("ranked below safe"), "{lines}");
}

#[test]
fn a_process_that_fails_ends_the_recording_with_one_error_and_keeps_what_was_recorded() {
    if !has_python() {
        return;
    }
    for (fault, wanted) in [
        ("dies", "ended during step"),
        ("hangs", "did not answer within 3 s of its step"),
        ("prints", "wrote \"knot 7 of 12"),
        ("rubbish", "a message of the world's process would have a header"),
        ("raises", "ValueError: no wind"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        write_world(dir, "world.toml", fault);
        let ran = dropj(dir, ["record", "--env", "world.toml", "--episodes", "3", "--out", "data"]);
        let said = ran.refused();
        assert!(said.contains(wanted) && said.contains("after 19 steps, which are kept"), "{fault}: {said}");
        let dataset = Dataset::open(&dir.join("data")).unwrap();
        assert_eq!((dataset.n_episodes(), dataset.len(0)), (1, 19), "{fault}");
    }
}

#[test]
fn a_first_file_starts_the_process_where_it_was_asked() {
    if !has_python() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    fs::copy(shipped("tests/support/channel_world.py"), dir.join("boat.py")).unwrap();
    for out in ["world.toml", "mine/boat/world.toml"] {
        dropj(dir, ["world", "new", "--process", "python3 boat.py", "--out", out]).succeeded();
        dropj(dir, ["world", "check", out, "--run", "20"]).succeeded();
        let text = fs::read_to_string(dir.join(out)).unwrap();
        assert_eq!(text.contains("folder = \"../..\""), out != "world.toml", "{text}");
    }
    dropj(dir, ["record", "--env", "mine/boat/world.toml", "--episodes", "1", "--out", "data"]).succeeded();
}

#[test]
fn what_is_no_world_is_refused_before_anything_is_done() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let refused = |line: &str| dropj(dir, line.split_whitespace()).refused().to_owned();
    assert!(refused("record --env nowhere.toml --out data").contains("there is no world"));
    fs::write(dir.join("wrong.toml"), "format = 1\nname = \"x\"\nsteer = 3\n").unwrap();
    assert!(refused("record --env wrong.toml --out data").contains("steer"));
    write_world(dir, "world.toml", "");
    let text = fs::read_to_string(dir.join("world.toml")).unwrap();
    let alone = text.lines().filter(|line| !line.starts_with("source")).collect::<Vec<_>>().join("\n");
    fs::write(dir.join("alone.toml"), format!("{alone}\n[source]\nkind = \"recordings\"\n")).unwrap();
    let said = refused("record --env alone.toml --out data");
    assert!(said.contains("known from recordings alone"), "{said}");
    assert!(!dir.join("data").exists(), "nothing was made");
}
