//! One file for a run: what it says, what the command line says instead, and what is refused.

use std::path::Path;

use crate::program::{Ran, dropj, shipped};

/// Runs a command, in a folder with this file of settings.
fn with_file(dir: &Path, file: &str, line: &str) -> Ran {
    std::fs::write(dir.join("run.toml"), file).unwrap();
    dropj(dir, line.split(' '))
}

/// The settings that a command prints.
#[track_caller]
fn printed(dir: &Path, file: &str, line: &str) -> toml::Table {
    let ran = with_file(dir, file, &format!("{line} --config run.toml --print-config"));
    ran.succeeded().parse().unwrap()
}

#[test]
fn a_file_says_what_the_command_line_does_not() {
    let dir = tempfile::tempdir().unwrap();
    let file = "[simulate]\nout = 'X'\nqueries = 7\nprotocol = ['drop', 'drope']\nchoice = 'boundary'\n\
                [simulate.reward]\nmembers = 5\nlearning_rate = 1e-2\n[deploy]\nepisodes = 3\n";
    let all = &printed(dir.path(), file, "simulate")["simulate"];
    assert_eq!(all["queries"].as_integer(), Some(7));
    assert_eq!(all["protocol"], toml::Value::from(vec!["drop", "drope"]));
    assert_eq!(all["choice"].as_str(), Some("boundary"));
    assert_eq!(all["reward"]["members"].as_integer(), Some(5));
    assert_eq!(all["reward"]["hidden"].as_integer(), Some(256), "what it leaves out stays as it was");

    let all = &printed(dir.path(), file, "simulate --queries 8 --protocol dropj --members 2")["simulate"];
    assert_eq!(all["queries"].as_integer(), Some(8), "what is on the line wins");
    assert_eq!(all["protocol"], toml::Value::from(vec!["dropj"]));
    assert_eq!(all["reward"]["members"].as_integer(), Some(2), "over a table within, too");

    let all =
        &printed(dir.path(), "[deploy]\nsession = 'nowhere'\nhorizon = 9", "deploy --straight-on")["deploy"];
    assert!(all.get("session").is_none(), "what does not go with the line is left out: {all}");
    assert_eq!(all["planner"]["horizon"].as_integer(), Some(9));
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1, "nothing is written");
}

#[test]
fn what_is_printed_says_the_same_once_more() {
    let dir = tempfile::tempdir().unwrap();
    for line in [
        "simulate --out X",
        "simulate --out X --protocol dros --env obstacle-car-racing --seed 18446744073709551615",
        "simulate --out X --beta 0.1 --weights grass=0.9,default=0.7",
        "deploy --straight-on --memory-reset 0 --brake 0.3",
        "fit-probe --out X --dtype bf16 --seed 18446744073709551615",
    ] {
        let first = dropj(dir.path(), line.split(' ').chain(["--print-config"]));
        let command = line.split(' ').next().unwrap();
        let again =
            with_file(dir.path(), first.succeeded(), &format!("{command} --config run.toml --print-config"));
        let [first, again] =
            [first.succeeded(), again.succeeded()].map(|text| text.parse::<toml::Table>().unwrap());
        assert_eq!(again, first, "{line}");
    }
}

#[test]
fn what_nobody_knows_is_refused_with_its_name_and_the_file() {
    let dir = tempfile::tempdir().unwrap();
    // What the line alone decides is tested where it is read, in `src/cli/run_file.rs`.
    for (file, wanted) in [
        ("[simulate]\nquery = 5", "there is no setting simulate.query; there are "),
        ("[simulate.reward]\nmember = 5", "in the table simulate.reward: unknown field `member`"),
        ("[simulate.reward]\nmembers = 0", "the number of the reward's networks is 0"),
        ("[simulate.reward]\nmembers = 'many'", "in the table simulate.reward: invalid type"),
        ("[simulate.planner]\nhorizon = 0", "the planner's horizon is 0"),
    ] {
        let ran = with_file(dir.path(), file, "simulate --out X --config run.toml");
        let line = ran.refused();
        assert!(line.contains(wanted) && line.contains("run.toml"), "{file}: {line}");
    }
    let ran = dropj(dir.path(), ["simulate", "--out", "X", "--config", "nowhere.toml"]);
    assert!(ran.refused().contains("nowhere.toml"), "{ran:?}");
    let ran = with_file(dir.path(), "[simulate]\nqueries = 5", "simulate --config run.toml");
    assert!(ran.refused().contains("--out"), "what is missing in both is named: {ran:?}");
    let ran = with_file(dir.path(), "", "record --out X --config run.toml");
    assert!(ran.refused().contains("--config"), "short commands have none: {ran:?}");
}

#[test]
fn the_example_can_be_used() {
    let dir = tempfile::tempdir().unwrap();
    let file = std::fs::read_to_string(shipped("assets/run.toml")).unwrap();
    for command in ["fit-world", "fit-probe", "fit-drqv2", "simulate", "refit", "deploy"] {
        let ran = with_file(dir.path(), &file, &format!("{command} --config run.toml --seed=none"));
        // Nothing is wrong but the seed.
        assert!(ran.refused().contains("invalid value 'none' for '--seed <SEED>'"), "{ran:?}");
    }
    // What nothing is needed for works.
    let all = &printed(dir.path(), &file, "simulate")["simulate"];
    assert_eq!(all["queries"].as_integer(), Some(300));
    let line = "deploy --config run.toml --straight-on --episodes 1 --json";
    assert!(with_file(dir.path(), &file, line).succeeded().contains("\"track\":0"));
    assert!(dir.path().join("steps.csv").exists(), "as the file says");
}
