//! How the program tells what came of it: as one JSON object, in files for others, and by its exit code.

use std::fs;
use std::path::Path;

use serde_json::Value;

use crate::program::{dropj, shipped};

/// What a command tells as JSON, which must be one object on one line.
#[track_caller]
fn told(dir: &Path, line: &str) -> Value {
    let ran = dropj(dir, line.split(' ').chain(["--json"]));
    let out = ran.succeeded();
    assert_eq!(out.lines().count(), 1, "{line}: {out}");
    let told: Value = serde_json::from_str(out).unwrap_or_else(|e| panic!("{line}: {e}: {out}"));
    assert!(told.is_object(), "{line}: {told}");
    told
}

#[test]
fn what_came_of_a_command_is_one_object() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let session = shipped("sessions/example").display().to_string();
    let replayed = told(dir, &format!("replay {session}"));
    assert!(replayed["answered"].as_u64() > Some(0) && replayed["checked"] == false, "{replayed}");
    let agreed = told(dir, &format!("agree {session}"));
    assert_eq!(agreed["annotators"].as_array().map(Vec::len), Some(1), "{agreed}");
    let labels = told(dir, &format!("labels {session}"));
    assert!(labels["rows"].as_array().is_some_and(|rows| !rows.is_empty()), "{labels}");
    let handed = told(dir, &format!("hand-on {session} --annotator B --out second"));
    assert!(handed["queries"].as_u64() > Some(0), "{handed}");
    let repaired = told(dir, "repair second");
    assert_eq!(repaired["changed"], false, "{repaired}");
    let world = told(dir, "world check car-racing");
    assert_eq!(world["world"]["axes"].as_array().map(Vec::len), Some(3), "{world}");
    let listed = told(dir, "experiment --list");
    assert!(listed["experiments"].as_array().is_some_and(|all| all.len() > 2), "{listed}");
    let recorded = told(dir, "record --episodes 1 --out data");
    assert_eq!(recorded["episodes"], 1, "{recorded}");
    assert!(recorded["event_steps"]["grass"].is_u64(), "{recorded}");

    let exported = told(dir, "export --hub hub --data data");
    assert_eq!(
        (&exported["kind"], &exported["steps"]),
        (&"dataset".into(), &recorded["steps"]),
        "{exported}"
    );
    assert!(dir.join("data/journal").exists() && !dir.join("hub/journal").exists());
    assert!(fs::read_to_string(dir.join("hub/README.md")).unwrap().starts_with("---\n"));
    dropj(dir, ["export", "--hub", "hub", "--data", "data"]).refused();
}

#[test]
fn a_network_goes_to_the_hub_as_it_is_with_what_is_known_of_it() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let world = shipped("assets/world-car-racing.safetensors");
    fs::write(dir.join("figures.json"), r#"{"figures": {"reconstruction": 0.0625}}"#).unwrap();
    let told = told(dir, &format!("export --hub world --results figures.json --world {}", world.display()));
    assert_eq!(told["model_type"], "dropj-world-model");
    assert!(fs::read(dir.join("world/model.safetensors")).unwrap() == fs::read(&world).unwrap());
    let config = fs::read(dir.join("world/config.json")).unwrap();
    let config: Value = serde_json::from_slice(&config).unwrap();
    assert_eq!((&config["hash"], &config["config"]["env"]), (&told["hash"], &"car-racing".into()));
    let card = fs::read_to_string(dir.join("world/README.md")).unwrap();
    assert!(card.contains("| `figures.reconstruction` | 0.0625 |"), "{card}");
    // Two things are not put into one folder.
    let reward = shipped("sessions/example/reward/0000.safetensors");
    let line = [
        "export",
        "--hub",
        "both",
        "--world",
        &world.display().to_string(),
        "--reward",
        &reward.display().to_string(),
    ];
    assert!(dropj(dir, line).refused().contains("two things"));
}

#[test]
fn the_exit_code_tells_a_wrong_line_from_what_failed() {
    let dir = tempfile::tempdir().unwrap();
    for (line, code) in
        [("replay --help", 0), ("replay nowhere", 1), ("replay", 2), ("replay nowhere --no-such", 2)]
    {
        let ran = dropj(dir.path(), line.split(' '));
        assert_eq!(ran.code, Some(code), "{line}: {ran:?}");
    }
}
