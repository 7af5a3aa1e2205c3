//! Worlds in processes, well and ill, and files of worlds.
#![expect(clippy::print_stderr, reason = "a test that is skipped says so")]

use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use super::*;

const TOY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/support/toy_world.py");
const PACKAGE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/python");

const FILE: &str = r#"
format = 1
name = "toy"
title = "A toy"
rate = 12.5
longest_episode = 30

[source]
kind = "process"
command = ["python3", "toy_world.py"]
time_outs = { start = 20.0, reset = 20.0, step = 20.0, close = 0.5 }

[image]
height = 6
width = 10
crop = { bottom = 1 }
pad = { top = 2, left = 1, right = 1 }
train = { height = 8, width = 16 }

[[axes]]
name = "push"
low = -2.5
high = 0.5
neutral = 0.0
keys = [{ key = "Left", to = -2.0 }, { key = "Right", to = 0.5 }]
pad = [{ axis = "right-stick-up", to = 0.5 }]
key_speed = 3.0
release = "stay"

[[axes]]
name = "lift"
low = 0
high = 512
neutral = 256

[[events]]
name = "off"
kind = "safety"
count = "first-touch"
field = "off"

[[events]]
name = "lap"
kind = "progress"
field = "laps"
when = "grows"

[[events]]
name = "far"
kind = "safety"
count = "of-passed"
field = "at"
when = { below = -0.5 }
passed = "laps"

[[justifications]]
name = "off the road"
events = ["off", "far"]
weight = 0.95

[planner]
horizon = 12
memory_reset = 20

[planner.candidates]
from = "file"
constant = [[0.0, 256.0]]
stages = [{ action = [-2.5, 0.0], follows = 0.25 }, { action = [0.5, 512.0], follows = 0.75 }]
courses = [[{ action = [0.5, 0.0], steps = 3 }, { action = [-0.5, 0.0], steps = 2 }, { action = [0.0, 256.0] }]]

[networks]
latent = 8

[fitting]
held_out = 0.25
"#;

fn spec() -> WorldSpec {
    FILE.parse().unwrap()
}

/// The toy's process with a fault, and time-outs that are short where it hangs.
fn toy(fault: &str, seconds: f64) -> Launch {
    Launch {
        command: ["python3", TOY, fault].map(str::to_owned).to_vec(),
        folder: None,
        environment: vec![],
        time_outs: TimeOuts {
            start: if fault.contains("start") || fault.contains("print-a") { seconds } else { 20.0 },
            reset: 20.0,
            step: seconds,
            close: 0.3,
        },
    }
}

/// Whether Python is here, which these tests need.
fn has_python(import: &str) -> bool {
    let is_here =
        Command::new("python3").args(["-c", import]).output().is_ok_and(|done| done.status.success());
    if !is_here {
        eprintln!("skipped: python3 cannot `{import}` here");
    }
    is_here
}

/// What happens with this fault: the error in words, and how long that took.
fn failed(fault: &str, seconds: f64) -> (ProcessError, Duration) {
    let began = Instant::now();
    let failed = Process::start(&toy(fault, seconds)).and_then(|mut process| {
        process.reset(7, &Fields::Nothing)?;
        process.step(&[0.0, 256.0])?;
        process.step(&[0.0, 256.0])
    });
    (failed.expect_err(fault), began.elapsed())
}

#[test]
fn a_world_file_reads_back_equal() {
    let spec = spec();
    assert_eq!(spec.to_toml().parse::<WorldSpec>().unwrap(), spec, "{}", spec.to_toml());
    for world in BuiltIn::all() {
        assert_eq!(world.spec().to_toml().parse::<WorldSpec>().unwrap(), world.spec());
    }
    let odd = WorldSpec {
        title: "\"quoted\" \\ ø".to_owned(),
        planner: PlannerSpec { memory_reset: None, ..spec.planner.clone() },
        source: Source {
            environment: [("A".to_owned(), "tab\there".to_owned())].into(),
            folder: Some("x/y".into()),
            cameras: vec!["observation.images.front".to_owned(), "top \"2\"".to_owned()],
            action: Some("action.delta".to_owned()),
            ..spec.source.clone()
        },
        ..spec
    };
    assert_eq!(odd.to_toml().parse::<WorldSpec>().unwrap(), odd, "{}", odd.to_toml());
}

#[test]
fn the_files_of_the_worlds_that_results_are_of_are_right() {
    let car = include_str!("../../assets/results/worlds/car-racing-v3/world.toml");
    for (text, name, axes) in [
        (car, "car-racing-v3", &["steer", "gas", "brake"][..]),
        (
            include_str!("../../assets/results/worlds/racetrack-v0/world.toml"),
            "racetrack-v0",
            &["throttle", "steer"],
        ),
        (
            include_str!("../../assets/results/worlds/safety-point-goal1/world.toml"),
            "safety-point-goal1",
            &["drive", "turn"],
        ),
        (include_str!("../../assets/results/worlds/push-t/world.toml"), "push-t", &["x", "y"]),
    ] {
        let spec = WorldSpec::from_toml(text, Path::new(name)).unwrap();
        assert_eq!((spec.name.as_str(), spec.source.kind), (name, SourceKind::Process));
        assert_eq!(spec.axes.iter().map(|axis| axis.name.as_str()).collect::<Vec<_>>(), axes);
    }
    let built_in = WorldSpec::built_in("car-racing").unwrap();
    let same = WorldSpec::from_toml(car, Path::new("car-racing-v3")).unwrap();
    let WorldSpec { name, title, source, .. } = same.clone();
    assert_eq!(same, WorldSpec { name, title, source, ..built_in }, "all else is that of the built-in one");
}

#[test]
#[expect(clippy::too_many_lines, reason = "a table")]
fn what_is_wrong_with_a_world_file_is_said_in_a_sentence() {
    let cases = [
        (
            "height = 6",
            "tall = 6",
            "line 14 of this world cannot be understood: unknown field \"tall\", expected one of \"height\"",
        ),
        ("rate = 12.5", "rate = \"fast\"", "line 5 of this world cannot be understood: invalid type"),
        ("rate = 12.5", "", "missing field \"rate\""),
        ("rate = 12.5", "rate = nan", "rate is NaN, and must be from 0.01 to 10000"),
        ("rate = 12.5", "rate = 0", "rate is 0, and must be"),
        ("format = 1", "format = 2", "format is 2, and must be 1"),
        ("name = \"toy\"", "name = \"../toy\"", "name is \"../toy\", and must be of 1 to 64 letters"),
        (
            "title = \"A toy\"",
            "title = \"A\\u0007\"",
            "title is \"A\\u{7}\", and must be of 1 to 100 letters that can be seen",
        ),
        ("longest_episode = 30", "longest_episode = 0", "longest_episode is 0, and must be from 1"),
        ("longest_episode = 30", "longest_episode = -3", "line 6"),
        (
            "kind = \"process\"",
            "kind = \"recordings\"",
            "source.command cannot be given here: it belongs to source.kind = \"process\"",
        ),
        (
            "kind = \"process\"\ncommand = [\"python3\", \"toy_world.py\"]",
            "kind = \"process\"",
            "source.command is missing: give the program",
        ),
        ("kind = \"process\"", "kind = \"robot\"", "unknown variant \"robot\", expected one of \"built-in\""),
        (
            "kind = \"process\"",
            "kind = \"process\"\ncameras = [\"top\", \"top\"]",
            "source.cameras has \"top\" twice, and each must be given once",
        ),
        (
            "kind = \"process\"",
            "kind = \"process\"\naction = \"\"",
            "source.action is \"\", and must be of 1 to 256 letters",
        ),
        (
            "kind = \"process\"\ncommand = [\"python3\", \"toy_world.py\"]\ntime_outs = { start = 20.0, reset = 20.0, step = 20.0, close = 0.5 }",
            "kind = \"built-in\"\nworld = \"car-racing\"\naction = \"action\"",
            "source.action cannot be given here: it belongs to recordings of others",
        ),
        ("step = 20.0", "step = inf", "source.time_outs.step is inf, and must be from 0.01 to 3600"),
        ("width = 10", "width = 0", "image.width is 0, and must be from 1 to 4096"),
        ("width = 10", "width = 1000000", "image.width is 1000000, and must be from 1 to 4096"),
        (
            "crop = { bottom = 1 }",
            "crop = { bottom = 6 }",
            "image.crop.top and bottom is 6 rows of 6, and must be so small",
        ),
        ("train = { height = 8, width = 16 }", "", "image.train is missing: the picture has 7 x 12 pixels"),
        (
            "train = { height = 8,",
            "train = { height = 4,",
            "image.train.height is 4, and must be from 8 to 1024",
        ),
        ("name = \"lift\"", "name = \"push\"", "axes has \"push\" twice, and each must be given once"),
        ("name = \"lift\"", "name = \"\"", "axes[2].name is \"\", and must be of 1 to 64 letters"),
        ("high = 512", "high = 0", "axes.\"lift\".high is 0, and must be above its low, 0"),
        ("low = 0\n", "low = nan\n", "axes.\"lift\".low is NaN, and must be from"),
        (
            "neutral = 256",
            "neutral = 600",
            "axes.\"lift\".neutral is 600, and must be from its low, 0, to its high, 512",
        ),
        ("key = \"Left\"", "key = \"Hyper\"", "axes.\"push\".keys is \"Hyper\", and must be a letter"),
        ("key = \"Left\"", "key = \"Right\"", "axes.\"push\".keys has \"Right\" twice"),
        ("\"right-stick-up\"", "\"stick\"", "unknown variant \"stick\""),
        ("to = -2.0", "to = -3.0", "axes.\"push\".keys.\"Left\".to is -3, and must be from its low, -2.5"),
        ("key_speed = 3.0", "key_speed = 0", "axes.\"push\".key_speed is 0, and must be from"),
        ("passed = \"laps\"", "", "events.\"far\".passed is missing: count = \"of-passed\" needs"),
        ("count = \"of-passed\"", "count = \"per-step\"", "events.\"far\".passed cannot be given here"),
        ("when = \"grows\"", "when = \"sometimes\"", "unknown variant \"sometimes\""),
        ("below = -0.5", "below = nan", "events.\"far\".when is NaN"),
        (
            "weight = 0.95",
            "weight = 0.5",
            "justifications.\"off the road\".weight is 0.5, and must be above 0.5 and at most 1",
        ),
        ("weight = 0.95", "weight = nan", "weight is NaN, and must be above 0.5"),
        (
            "events = [\"off\", \"far\"]",
            "events = []",
            "justifications.\"off the road\".events is missing: name at least one; there are \"off\", \"lap\", \"far\"",
        ),
        (
            "events = [\"off\", \"far\"]",
            "events = [\"ice\"]",
            "names the event \"ice\", which this world does not have; there are \"off\"",
        ),
        ("name = \"off the road\"", "name = \"default\"", "the default is always there"),
        (
            "[planner]\n",
            "[weights]\ndefault = 0.4\n[planner]\n",
            "weights.default is 0.4, and must be above 0.5",
        ),
        ("horizon = 12", "horizon = 0", "planner.horizon is 0, and must be from 1 to 200"),
        ("horizon = 12", "horizon = 12\nreplan = 13", "planner.replan is 13, and must be from 1 to 12"),
        ("from = \"file\"", "from = \"recordings\"", "planner.candidates.constant cannot be given here"),
        (
            "[[0.0, 256.0]]",
            "[[0.0]]",
            "planner.candidates.constant is an action of 1, and must be of 2 numbers",
        ),
        ("[[0.0, 256.0]]", "[[0.0, 999.0]]", "planner.candidates.constant for \"lift\" is 999"),
        ("follows = 0.25", "follows = 0.5", "the values of `follows` sum to 1.25, and must sum to 1"),
        (
            "action = [0.0, 256.0] }",
            "action = [0.0] }",
            "planner.candidates.courses is an action of 1, and must be of 2 numbers",
        ),
        ("steps = 3", "steps = 0", "planner.candidates.courses.steps is 0, and must be from 1 to 200"),
        (
            "courses = [[",
            "courses = [[], [",
            "the number of parts of one of planner.candidates.courses is 0, and must be from 1 to 64",
        ),
        ("latent = 8", "latent = 0", "networks.latent is 0, and must be from 1"),
        ("held_out = 0.25", "held_out = nan", "fitting.held_out is NaN"),
    ];
    for (right, wrong, sentence) in cases {
        assert!(FILE.contains(right), "{right}");
        let error =
            WorldSpec::from_toml(&FILE.replace(right, wrong), Path::new("my/world.toml")).expect_err(wrong);
        let said = error.to_string();
        assert!(said.contains(sentence), "{wrong}: {said}");
        assert!(said.ends_with(": \"my/world.toml\"") && !said.contains('\n'), "{said}");
    }
}

#[test]
fn a_world_in_a_process_is_reset_and_stepped() {
    if !has_python("import json") {
        return;
    }
    let folder = Path::new(TOY).parent().unwrap();
    let mut world = ProcessWorld::start(spec(), folder).unwrap();
    assert!(matches!(world.step(&[0.0, 0.0]), Err(WorldError::NoEpisode)));
    let first = world.reset(3).unwrap();
    assert_eq!((first.height(), first.width(), first.is_uniform()), (8, 16, false), "as networks see it");
    let shown = world.picture(600, 480).unwrap();
    assert_eq!((shown.height(), shown.width()), (6, 10), "as it was sent");
    assert!(matches!(world.step(&[0.0]), Err(WorldError::ActionLength { found: 1, wanted: 2 })));
    assert!(matches!(world.step(&[0.0, f32::NAN]), Err(WorldError::ActionValue { .. })));

    // Far beyond its range, which is clipped: 0.125 a step to the left.
    let steps: Vec<_> = (0..3).map(|_| world.step(&[-99.0, 256.0]).unwrap()).collect();
    assert_eq!(steps.iter().map(|step| step.reward).collect::<Vec<_>>()[..1], [Some(0.5)]);
    let again = world.reset(3).unwrap();
    assert_eq!(again, first, "the seed decides it");
    let mut counts = [0; 3];
    let mut n = 0;
    loop {
        let step = world.step(&[0.0, 256.0]).unwrap();
        n += 1;
        counts.iter_mut().zip(&step.events).for_each(|(n, event)| *n += usize::from(event.happened));
        if let Some(end) = step.end {
            assert_eq!(end, End::Truncated);
            break;
        }
    }
    assert_eq!((n, counts), (30, [0, 3, 0]), "the file's longest episode is shorter than the world's");
    assert!(matches!(world.step(&[0.0, 0.0]), Err(WorldError::NoEpisode)));

    let other = WorldSpec { rate: 20.0, ..spec() };
    let refused = ProcessWorld::start(other, folder).unwrap_err().to_string();
    assert_eq!(refused, "rate is 20 in the world's file, and its process says 12.5");
    let mut other = spec();
    other.image.width = 12;
    let refused = ProcessWorld::start(other, folder).unwrap_err().to_string();
    assert!(refused.contains("6 x 12 in the world's file, and its process says 6 x 10"), "{refused}");
}

#[test]
fn a_process_that_fails_says_why_and_its_last_lines() {
    if !has_python("import json") {
        return;
    }
    for (fault, sentence) in [
        (
            "exit-at-start",
            "ended during start (exit status: 1); its last lines: ModuleNotFoundError: No module named 'my_robot'",
        ),
        ("print-at-start", "wrote \"pygame-ce 2.5.8 (SDL 2.32, Python 3.11)\\nHello"),
        ("other-version", "speaks version 99 of the protocol, and this program speaks version 1"),
        ("no-axes", "says that the number of axes is 0"),
        ("huge-header", "would have a header of 2147483632 bytes"),
        ("huge-pixels", "would have pixels of 4294967280 bytes"),
        ("no-json", "cannot be understood"),
        ("bytes", "would have a header of"),
        ("frame-first", "sent a frame during start"),
        ("exit", "ended during step (exit status: 3); its last lines: motor 3 is too hot"),
        ("signal", "ended during step (signal: 11"),
        ("close-output", "closed its standard output during step"),
        ("print", "wrote \"step 1 of 40\\n"),
        ("wrong-size", "sent a picture of 7 x 10 pixels, and it had said 6 x 10"),
        ("few-pixels", "sent a picture of 179 bytes, and it had said 180"),
        ("nan", "tells of a reward that is not a finite number, during step"),
        ("overflow", "tells of a reward that is not a finite number, during step"),
        ("two", "sent a message that was not asked for, before its step"),
        ("action-unasked", "sent an action during step, and a frame was due"),
        ("executed-short", "tells of an action of 1 numbers during step, and it has 2 axes"),
        ("executed-nan", "tells of an action that is not a finite number, during step"),
        ("error", "reports during step: ValueError: no such gear"),
    ] {
        let (error, took) = failed(fault, 20.0);
        let said = error.to_string();
        assert!(said.contains(sentence), "{fault}: {said}");
        assert!(!said.contains(['\n', '\u{1b}']), "{fault}: {said}");
        assert!(took < Duration::from_secs(10), "{fault} took {took:?}");
    }
    let ProcessFault::Reported { traceback, .. } = failed("error", 20.0).0.fault else {
        panic!("it reports")
    };
    assert_eq!(traceback, ["line one", "\\u{1b}[31mline two"]);
}

#[test]
fn a_process_says_what_its_own_policy_would_do() {
    if !has_python("import json") {
        return;
    }
    let with = |fault: &str| {
        let source = Source { command: toy(fault, 1.0).command, ..spec().source };
        ProcessWorld::start(WorldSpec { source, ..spec() }, Path::new("")).unwrap()
    };
    let mut world = with("");
    assert!(world.has_policy());
    assert!(matches!(world.act(), Err(WorldError::NoEpisode)));
    let drive = |world: &mut ProcessWorld| {
        let first = world.reset(5).unwrap();
        let steps: Vec<_> = (0..8)
            .map(|_| {
                let action = world.act().unwrap().unwrap();
                assert_eq!(world.act().unwrap().unwrap(), action, "asking moves nothing");
                let step = world.step(&action).unwrap();
                (action, step)
            })
            .collect();
        (first, steps)
    };
    let driven = drive(&mut world);
    assert_eq!(drive(&mut world), driven);
    assert_eq!(driven.1[7].0[1], 263.0);
    assert_eq!(world.executed(), None);

    // Out of range, which is clipped, also where the file narrows an axis.
    let mut spec = spec();
    spec.axes[1].high = 300.0;
    let source = Source { command: toy("act-far", 1.0).command, ..spec.source };
    let mut world = ProcessWorld::start(WorldSpec { source, ..spec }, Path::new("")).unwrap();
    world.reset(0).unwrap();
    assert_eq!(world.act().unwrap().unwrap(), [-2.5, 300.0]);

    let mut world = with("no-policy");
    world.reset(0).unwrap();
    assert!(!world.has_policy());
    assert_eq!(world.act().unwrap(), None);
}

#[test]
fn a_policy_that_fails_says_why() {
    if !has_python("import json") {
        return;
    }
    for (fault, sentence) in [
        ("act-short", "tells of an action of 1 numbers during act, and it has 2 axes"),
        ("act-overflow", "tells of an action that is not a finite number, during act"),
        ("act-infinite", "tells of an action that is not a finite number, during act"),
        ("act-text", "cannot be understood (invalid type: string \"left\""),
        ("act-frame", "sent a frame during act, and an action was due"),
        ("act-other", "sent a message that was not asked for, before its act"),
        ("act-hang", "did not answer within 0.3 s of its act"),
        ("act-exit", "ended during act (exit status: 1); its last lines: the policy's file is not there"),
    ] {
        let seconds = if fault == "act-hang" { 0.3 } else { 20.0 };
        let mut process = Process::start(&toy(fault, seconds)).unwrap();
        process.reset(7, &Fields::Nothing).unwrap();
        let said = process.act().expect_err(fault).to_string();
        assert!(said.contains(sentence), "{fault}: {said}");
        assert!(matches!(process.act().unwrap_err().fault, ProcessFault::Gone), "{fault}");
    }
}

#[test]
fn what_was_executed_may_be_another_action_than_was_asked() {
    if !has_python("import json") {
        return;
    }
    let source = Source { command: toy("executed", 1.0).command, ..spec().source };
    let mut world = ProcessWorld::start(WorldSpec { source, ..spec() }, Path::new("")).unwrap();
    world.reset(0).unwrap();
    assert_eq!(world.executed(), None);
    let (_, reply) = world.step_told(&[0.0, 256.0]).unwrap();
    assert_eq!(reply.action, Some(vec![-1.5, 1000.0]));
    assert_eq!(world.executed(), Some([-1.5, 512.0].as_slice()), "in the ranges of the axes");
    world.reset(0).unwrap();
    assert_eq!(world.executed(), None);
}

/// Whether a process has ended, or is as good as that. True where nobody can tell.
fn is_over(id: &str) -> bool {
    let state = Command::new("ps").args(["-o", "stat=", "-p", id]).output();
    state.map_or(true, |told| {
        told.stdout.trim_ascii().is_empty() || told.stdout.trim_ascii().starts_with(b"Z")
    })
}

#[test]
fn a_process_that_hangs_is_waited_for_as_long_as_was_said_and_leaves_nothing() {
    if !has_python("import json") {
        return;
    }
    for (fault, sentence) in [
        ("silent-at-start", "did not answer within 0.3 s of its start"),
        ("print-a-little", "3 bytes of its answer came: \"hi\\n\""),
        ("hang", "did not answer within 0.3 s of its step"),
        ("half-a-frame", "did not answer within 0.3 s of its step; 20 bytes of its answer came"),
        ("hang-on-sigterm-with-child", "did not answer within 0.3 s of its step"),
    ] {
        let (error, took) = failed(fault, 0.3);
        assert!(error.to_string().contains(sentence), "{fault}: {error}");
        assert!(took < Duration::from_mins(1), "{fault} took {took:?}");
        if let Some(id) = error.last_lines.iter().find_map(|line| line.strip_prefix("child ")) {
            assert!((0..200).any(|_| is_over(id)), "what it started is ended with it");
        }
    }
    let mut process = Process::start(&toy("hang", 0.3)).unwrap();
    process.reset(0, &Fields::Nothing).unwrap();
    process.step(&[0.0, 0.0]).unwrap_err();
    assert!(matches!(process.step(&[0.0, 0.0]).unwrap_err().fault, ProcessFault::Gone));
    let process = Process::start(&toy("no-end", 20.0)).unwrap();
    let began = Instant::now();
    drop(process);
    assert!(began.elapsed() < Duration::from_secs(3), "one that will not end is killed");
}

#[test]
fn chatter_and_pictures_of_one_color_are_no_errors() {
    if !has_python("import json") {
        return;
    }
    let mut process = Process::start(&toy("chatter", 20.0)).unwrap();
    process.reset(0, &Fields::All).unwrap();
    let (_, reply) = process.step(&[0.0, 256.0]).unwrap();
    assert_eq!(field_value(&reply.fields, "off"), Some(0.0));
    assert_eq!(field_value(&reply.fields, "nested.depth"), Some(3.0));
    assert_eq!(field_value(&reply.fields, "quiet"), None);
    process.step(&[0.0, 256.0]).unwrap();
    assert!(process.last_lines().last().unwrap().starts_with("a line of chatter"));

    let source = Source { command: toy("uniform", 1.0).command, ..spec().source };
    let mut world = ProcessWorld::start(WorldSpec { source, ..spec() }, Path::new("")).unwrap();
    world.reset(0).unwrap();
    assert_eq!(world.take_warnings(), []);
    for _ in 0..2 {
        world.step(&[0.0, 256.0]).unwrap();
    }
    assert_eq!(world.take_warnings(), [Warning::Uniform { rgb: [0; 3] }]);
}

#[test]
fn what_would_blacken_pictures_is_kept_from_the_process() {
    if !has_python("import json") {
        return;
    }
    // A variable of the file's own is passed on.
    let mut launch = toy("sees-sdl", 20.0);
    let said = Process::start(&launch).unwrap_err().to_string();
    assert!(said.contains("SDL_VIDEODRIVER is None, DROPJ_PROTOCOL is 1"), "{said}");
    launch.environment = vec![("SDL_VIDEODRIVER".to_owned(), "x11".to_owned())];
    let said = Process::start(&launch).unwrap_err().to_string();
    assert!(said.contains("SDL_VIDEODRIVER is x11"), "{said}");
}

#[test]
fn a_program_that_is_not_there_is_named() {
    let launch = Launch { command: vec!["no-such-program".to_owned()], ..toy("", 1.0) };
    let said = Process::start(&launch).unwrap_err().to_string();
    assert!(
        said.contains("cannot be started: No such file") && said.ends_with("\"no-such-program\""),
        "{said}"
    );
    // One that says nothing of ours.
    let launch = Launch { command: vec!["true".to_owned()], ..toy("", 1.0) };
    let said = Process::start(&launch).unwrap_err().to_string();
    assert!(said.contains("ended during start (exit status: 0)"), "{said}");
}

#[test]
fn events_are_counted_as_their_file_says() {
    let fields = |off: bool, laps: u32, at: f64| {
        serde_json::json!({ "off": off, "laps": laps, "at": at }).as_object().unwrap().clone()
    };
    let mut reader = EventReader::new(&spec().events);
    reader.begin(&fields(false, 4, 0.0));
    let mut seen = vec![];
    for (off, laps, at) in [(true, 5, -0.6), (true, 6, -0.7), (false, 6, 0.0), (true, 6, -0.6)] {
        let events = reader.read(&fields(off, laps, at));
        seen.push(events.iter().map(|event| (event.happened, event.passed)).collect::<Vec<_>>());
    }
    let (yes, no) = ((true, false), (false, false));
    assert_eq!(seen, [[yes, yes, (true, true)], [no, yes, (false, true)], [no, no, no], [yes, no, yes],]);
    assert!(reader.read(&serde_json::Map::new()).iter().all(|event| *event == Happened::default()));
}

/// A script that serves an environment with the package that is shipped.
fn served(script: &str) -> Launch {
    Launch {
        command: ["python3", "-c", script].map(str::to_owned).to_vec(),
        environment: vec![
            ("PYTHONPATH".to_owned(), PACKAGE.to_owned()),
            ("PYTHONDONTWRITEBYTECODE".to_owned(), "1".to_owned()),
        ],
        ..toy("", 20.0)
    }
}

const ENV: &str = r#"
import dropj
print("this is printed, and does no harm")
import os, sys, numpy as np
os.write(1, b"nor does this\n")

class Env:
    action_space = dropj.Box([-1, 0], [1, 512], names=["turn", "go"])
    metadata = {"render_fps": 30}
    def reset(self, *, seed=None, options=None):
        self.t, self.seed = 0, seed
        return self.look(), {}
    def step(self, action):
        assert action.dtype == np.float32 and action.shape == (2,), action
        self.t += 1
        if self.t == 3:
            raise RuntimeError("the gripper slipped")
        info = {"crashed": np.bool_(True), "speed": np.float32(2.5), "pose": np.zeros(3), "rewards": {"road": False}, "text": "no"}
        return self.look(), np.float64(action[0]), False, self.t == 2, info
    def look(self):
        whole = np.zeros((8, 12, 3), np.uint8)
        whole[:, :, 0] = np.arange(12) * 20
        whole[0, :, 1] = self.seed % 256
        return whole[::-1]
"#;

#[test]
fn the_python_package_serves_what_looks_like_gymnasium() {
    if !has_python("import numpy") {
        return;
    }
    let script =
        format!("{ENV}\ndropj.serve(Env(), hertz=25, safety=['crashed'], fields={{'t': lambda env: env.t}})");
    let mut process = Process::start(&served(&script)).unwrap();
    let hello = process.hello().clone();
    assert_eq!(
        (hello.image, hello.hertz, hello.render_fps),
        (HelloImage { height: 8, width: 12 }, Some(25.0), Some(30.0))
    );
    assert_eq!((hello.axes[1].name.as_str(), hello.axes[1].high), ("go", 512.0));
    assert_eq!(hello.events[0].field, "crashed");
    let (frame, _) = process.reset(9, &Fields::All).unwrap();
    assert_eq!(frame.rgb()[..6], [0, 0, 0, 20, 0, 0], "rows from the top, whatever the array's strides");
    assert_eq!(frame.rgb()[7 * 36..7 * 36 + 3], [0, 9, 0]);
    let (_, reply) = process.step(&[0.5, 512.0]).unwrap();
    let told = serde_json::json!({ "crashed": true, "speed": 2.5, "rewards.road": false, "t": 1 });
    assert_eq!((reply.reward, serde_json::Value::Object(reply.fields)), (Some(0.5), told));
    let asked = Fields::Named(vec!["rewards.road".to_owned(), "nothing".to_owned()]);
    process.reset(1, &asked).unwrap();
    let (_, reply) = process.step(&[0.0, 0.0]).unwrap();
    assert_eq!(
        serde_json::Value::Object(reply.fields),
        serde_json::json!({ "rewards.road": false, "nothing": null })
    );
    assert!(process.step(&[0.0, 0.0]).unwrap().1.truncated);
    let error = process.step(&[0.0, 0.0]).unwrap_err();
    assert!(error.to_string().contains("reports during step: RuntimeError: the gripper slipped"), "{error}");
    let ProcessFault::Reported { traceback, .. } = &error.fault else { panic!("{error}") };
    assert!(traceback.iter().any(|line| line.contains("in step")), "{traceback:?}");

    let script = format!("{ENV}\ndropj.serve(Env(), size=(4, 3))");
    let mut process = Process::start(&served(&script)).unwrap();
    let (frame, _) = process.reset(0, &Fields::Nothing).unwrap();
    assert_eq!(
        frame.rgb()[..9],
        [30, 0, 0, 110, 0, 0, 190, 0, 0],
        "each pixel is the mean of what it covers"
    );
}

#[test]
fn the_python_package_serves_a_policy_that_the_seed_decides() {
    if !has_python("import numpy") {
        return;
    }
    let object = "class Policy:
    def reset(self, env, rng): self.env, self.rng = env, rng
    def act(self, env):
        assert env is self.env
        return self.rng.uniform(0, 1, 2)";
    let policies = [
        "lambda env, rng: rng.uniform(0, 1, 2)",
        "Policy",
        "Policy()",
        "lambda env, rng: list(rng.uniform(0, 1, 2))",
    ];
    let drives = policies.map(|policy| {
        let script =
            format!("{ENV}\n{object}\ndropj.serve(Env, policy={policy}, executed=lambda env: [-1, env.t])");
        let mut process = Process::start(&served(&script)).unwrap();
        assert!(process.has_policy());
        let mut drive = |seed| {
            process.reset(seed, &Fields::Nothing).unwrap();
            let first = process.act().unwrap().unwrap();
            assert_eq!(process.act().unwrap().unwrap(), first, "asking moves nothing");
            assert_eq!(process.step(&first).unwrap().1.action, Some(vec![-1.0, 1.0]));
            let second = process.act().unwrap().unwrap();
            assert_ne!(first, second);
            [first, second]
        };
        let most = drive(u64::MAX);
        assert_ne!(drive(3), most);
        assert_eq!(drive(u64::MAX), most, "the seed decides it");
        most
    });
    assert!(drives.iter().all(|drive| *drive == drives[0]));

    let plain = Process::start(&served(&format!("{ENV}\ndropj.serve(Env)"))).unwrap();
    assert!(!plain.has_policy());
    for (policy, sentence) in [
        ("lambda env, rng: [1]", "ValueError: the policy's action is [1.0], and 2 finite numbers are needed"),
        ("lambda env, rng: [1, np.nan]", "2 finite numbers are needed"),
        ("lambda env, rng: 1 / 0", "reports during act: ZeroDivisionError"),
        ("7", "reports during start: TypeError: the policy is int: a function of env and rng is needed"),
    ] {
        let script = format!("{ENV}\ndropj.serve(Env, policy={policy})");
        let failed = Process::start(&served(&script)).and_then(|mut process| {
            process.reset(0, &Fields::Nothing)?;
            process.act()
        });
        let said = failed.expect_err(policy).to_string();
        assert!(said.contains(sentence), "{policy}: {said}");
    }
}

#[test]
fn the_python_package_refuses_what_cannot_be_served() {
    if !has_python("import numpy") {
        return;
    }
    for (change, sentence) in [
        (
            "class Discrete: n = 7\nEnv.action_space = Discrete()",
            "TypeError: the actions are Discrete, and dropj needs numbers in ranges",
        ),
        ("Env.action_space = dropj.Box([-1, 0], [1, np.inf])", "has no bounds"),
        (
            "Env.look = lambda self: np.zeros(5)\nEnv.render = lambda self: None",
            "there is no picture but NoneType",
        ),
        ("Env.step = lambda self, action: (0, 0, 0, 0)", "step returns 4 values"),
        (
            "step = Env.step\nEnv.step = lambda self, action: (lambda r: (r[0], float('nan'), *r[2:]))(step(self, action))",
            "the reward is nan",
        ),
        ("sys.stderr.write('the arm is off\\n'); sys.exit(4)", "exit status: 4); its last lines:"),
    ] {
        let script = format!("{ENV}\n{change}\ndropj.serve(Env)");
        let error = Process::start(&served(&script))
            .and_then(|mut process| {
                process.reset(0, &Fields::Nothing)?;
                process.step(&[0.0, 0.0])
            })
            .expect_err(change);
        assert!(error.to_string().contains(sentence), "{change}: {error}");
    }
    let robot =
        Launch { command: ["python3", "-m", "dropj.robot"].map(str::to_owned).to_vec(), ..served("") };
    let mut robot = Process::start(&robot).unwrap();
    robot.reset(0, &Fields::Nothing).unwrap();
    assert_eq!(robot.act().unwrap().unwrap().len(), 2);
    let (_, reply) = robot.step(&[0.5, 0.0]).unwrap();
    assert_eq!((reply.reward, reply.action), (None, Some(vec![0.5, 0.0])));
}
