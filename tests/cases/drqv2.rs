//! DrQ-v2 from the command line: trained, gone on with, and deployed.

use crate::program::dropj;

/// Networks that a second trains.
const SMALL: &str = "[fit-drqv2]\nout = 'a.safetensors'\nbatch = 4\ndevice = 'cpu'\nthreads = 1\nevaluation-episodes = 1\n\
    [fit-drqv2.fit]\nchannels = 2\nfeatures = 4\nhidden = 8\nexploration_actions = 450\n";

#[test]
fn an_agent_is_trained_gone_on_with_and_deployed() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    std::fs::write(dir.join("run.toml"), SMALL).unwrap();
    let fit = |more: &str| dropj(dir, format!("fit-drqv2 --config run.toml {more}").split(' '));
    let first = fit("--steps 1");
    assert!(first.succeeded().starts_with("wrote \"a.safetensors\", sha256:"), "{first:?}");
    let first = std::fs::read(dir.join("a.safetensors")).unwrap();
    let lines =
        || std::fs::read_to_string(dir.join("a.safetensors.fit/training.csv")).unwrap().lines().count();
    assert_eq!(lines(), 2, "a heading and an episode");

    let other = fit("--steps 1001 --resume --batch 8");
    assert!(other.refused().contains("begun with other settings"), "{other:?}");
    fit("--steps 1001 --resume").succeeded();
    assert_eq!(lines(), 3);
    assert_ne!(std::fs::read(dir.join("a.safetensors")).unwrap(), first, "it learned on");

    let deploy = |line: &str| dropj(dir, format!("deploy --drqv2 a.safetensors {line}").split(' '));
    let json = deploy("--episodes 1 --json");
    std::fs::write(dir.join("drqv2.jsonl"), json.succeeded()).unwrap();
    assert!(json.out.contains("\"track\":0") && json.out.contains("grass_rate"), "{json:?}");
    let wrong = deploy("--episodes 1 --env obstacle-car-racing");
    assert!(wrong.refused().contains("84 x 84"), "{wrong:?}");

    // All is done, so that only the figure is drawn anew.
    fit("--steps 1001 --resume --beside deployed=drqv2.jsonl").succeeded();
    let curve = std::fs::read_to_string(dir.join("a.safetensors.fit/curve.svg")).unwrap();
    assert!(curve.contains("deployed") && curve.contains("unsafe steps so far"), "what is beside is named");
    let none = dropj(dir, ["deploy", "--drqv2", "run.toml"]);
    assert!(none.refused().contains("not readable network parameters"), "{none:?}");
}
