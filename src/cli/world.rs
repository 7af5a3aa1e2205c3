//! `dropj world`: a world's file checked, a first one written, and the Python package that serves worlds.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context as _;
use dropj::run::write_whole;
use dropj::text::shown;
use dropj::world::{
    Axis, CandidateSource, Count, End, EventKind, EventSpec, FORMAT, Fields, Hello, ImageSpec,
    JustificationSpec, Launch, PlannerSpec, Process, ProcessError, ProcessFault, ProcessWorld, Release, Size,
    Source, SourceKind, TimeOuts, When, WorldError, WorldSpec, field_value,
};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde_json::json;

use super::first_world::{Inputs, MOST_TRAINED, file_name, readable};
use super::meter::Meter;
use super::numbers::count;
use super::told::Form;
use super::world_data;

/// The Python package, each file by its path.
const ADAPTER: [(&str, &str); 14] = [
    ("pyproject.toml", include_str!("../../assets/python/pyproject.toml")),
    ("dropj/__init__.py", include_str!("../../assets/python/dropj/__init__.py")),
    ("dropj/_channel.py", include_str!("../../assets/python/dropj/_channel.py")),
    ("dropj/_serving.py", include_str!("../../assets/python/dropj/_serving.py")),
    ("dropj/serve.py", include_str!("../../assets/python/dropj/serve.py")),
    ("dropj/robot.py", include_str!("../../assets/python/dropj/robot.py")),
    ("dropj/_arrays.py", include_str!("../../assets/python/dropj/_arrays.py")),
    ("dropj/_axes.py", include_str!("../../assets/python/dropj/_axes.py")),
    ("dropj/_environments.py", include_str!("../../assets/python/dropj/_environments.py")),
    ("dropj/_networks.py", include_str!("../../assets/python/dropj/_networks.py")),
    ("dropj/_reward.py", include_str!("../../assets/python/dropj/_reward.py")),
    ("dropj/_session.py", include_str!("../../assets/python/dropj/_session.py")),
    ("dropj/_world_model.py", include_str!("../../assets/python/dropj/_world_model.py")),
    ("dropj/README.md", include_str!("../../assets/python/dropj/README.md")),
];

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Say what is wrong with a world's file, or what it says
    Check(Check),
    /// Ask a process what it is, or look at a dataset, and write a first world's file
    New(New),
    /// Write the Python package that serves a Gymnasium environment or a robot
    Adapter(Adapter),
}

#[derive(Debug, clap::Args)]
struct Check {
    /// The file, or the name of a built-in world
    file: PathBuf,
    /// Start its process and take so many random steps
    #[arg(long, value_name = "N", value_parser = count(1..=1_000_000))]
    run: Option<usize>,
    /// The seed of the first episode and of the steps
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Say whether this LeRobotDataset, which others made, fits the world
    #[arg(long, value_name = "DIR", conflicts_with = "run")]
    data: Option<PathBuf>,
    #[command(flatten)]
    form: Form,
}

#[derive(Debug, clap::Args)]
struct New {
    /// The program that is the world, with its arguments
    #[arg(long, value_name = "CMD", required_unless_present = "data")]
    process: Option<String>,
    /// A LeRobotDataset that others made: only recordings of the world are there
    #[arg(long, value_name = "DIR", conflicts_with_all = ["process", "rate", "steps", "start_time_out"])]
    data: Option<PathBuf>,
    /// The camera of the dataset that shows the world; more than one stand side by side
    #[arg(long = "camera", value_name = "NAME", requires = "data")]
    cameras: Vec<String>,
    /// The column of the dataset that has what was done, where that is not `action`
    #[arg(long, value_name = "NAME", requires = "data")]
    action: Option<String>,
    /// The file to write; without it the file is printed
    #[arg(long)]
    out: Option<PathBuf>,
    /// Steps a second, where the process does not say
    #[arg(long, value_name = "HZ")]
    rate: Option<f64>,
    /// How many neutral steps are taken to see what it tells; 0 moves nothing
    #[arg(long, value_name = "N", value_parser = count(0..=10_000), default_value_t = 20)]
    steps: usize,
    /// How long it may take to start, in seconds
    #[arg(long, value_name = "SECONDS", default_value_t = TimeOuts::default().start)]
    start_time_out: f64,
}

#[derive(Debug, clap::Args)]
struct Adapter {
    /// The folder to write it to; without it the names of its files are printed
    #[arg(long)]
    out: Option<PathBuf>,
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    match &options.command {
        Command::Check(options) => check(options),
        Command::New(options) => new(options),
        Command::Adapter(options) => adapter(options),
    }
}

fn check(options: &Check) -> anyhow::Result<()> {
    let (spec, folder) = read(&options.file)?;
    let mut telling = Telling::new(options.form, &spec);
    if let Some(dir) = &options.data {
        return world_data::check_fit(&spec, dir, telling);
    }
    let Some(n) = options.run else { return telling.tell() };
    anyhow::ensure!(
        spec.source.kind == SourceKind::Process,
        "only a world that is a process can be started so, and source.kind is {:?}: {:?}",
        spec.source.kind.name(),
        options.file
    );
    drive(spec, &folder, n, options.seed, &mut telling).map_err(told)?;
    telling.tell()
}

/// What a check says: words as they come, or all of it at the end as one object.
#[derive(Debug)]
pub(super) struct Telling {
    form: Form,
    object: serde_json::Value,
}

impl Telling {
    /// Begins with what the world's file says.
    fn new(form: Form, spec: &WorldSpec) -> Self {
        let axes = spec.axes.iter().map(
            |axis| json!({"name": axis.name, "low": axis.low, "high": axis.high, "neutral": axis.neutral}),
        );
        let events = spec.events.iter().map(|event| {
            json!({"name": event.name, "kind": event.kind.name(), "count": event.count.name(), "field": event.field})
        });
        let (image, trained) = (&spec.image, spec.image.trained());
        let world = json!({
            "name": spec.name, "title": spec.title, "source": spec.source.kind.name(), "rate": spec.rate,
            "longest_episode": spec.longest_episode, "size": [image.height, image.width],
            "trained_size": [trained.height, trained.width], "axes": axes.collect::<Vec<_>>(),
            "events": events.collect::<Vec<_>>(), "horizon": spec.planner.horizon
        });
        let telling = Self { form, object: json!({"world": world}) };
        telling.say(summary(spec).trim_end());
        telling
    }

    /// Says a line, where words are wanted.
    pub(super) fn say(&self, line: &str) {
        if !self.form.json {
            println!("{line}");
        }
    }

    /// Notes a value, where an object is wanted.
    pub(super) fn note(&mut self, name: &str, value: impl Into<serde_json::Value>) {
        self.object[name] = value.into();
    }

    /// Says the object, where it is wanted.
    pub(super) fn tell(self) -> anyhow::Result<()> {
        if self.form.json { self.form.tell(&self.object, String::new) } else { Ok(()) }
    }
}

/// The world's file at `path`, or the built-in one of that name, and the folder that it is in.
fn read(path: &Path) -> anyhow::Result<(WorldSpec, PathBuf)> {
    let built_in = path.to_str().and_then(WorldSpec::built_in);
    if let Some(spec) = built_in.filter(|_| !path.exists()) {
        return Ok((spec, PathBuf::new()));
    }
    let spec = super::chosen_world::read_world(path)?;
    Ok((spec, path.parent().unwrap_or(Path::new("")).to_owned()))
}

/// What a world's file says, for people.
fn summary(spec: &WorldSpec) -> String {
    let (image, trained) = (&spec.image, spec.image.trained());
    let source = match spec.source.kind {
        SourceKind::BuiltIn => "built in".to_owned(),
        SourceKind::Process => format!("a process: {}", shown(&spec.source.command.join(" "))),
        SourceKind::Recordings => "recordings alone".to_owned(),
    };
    let mut lines = vec![
        format!("{} ({}), {source}", spec.title, spec.name),
        format!(
            "  {} steps a second, {} steps an episode at the most ({:.0} s)",
            spec.rate,
            spec.longest_episode,
            spec.longest_episode as f64 / spec.rate
        ),
        format!(
            "  pictures of {} x {}, trained at {} x {}",
            image.height, image.width, trained.height, trained.width
        ),
    ];
    for axis in &spec.axes {
        let keys: Vec<&str> = axis.keys.iter().map(|input| input.key.as_str()).collect();
        let keys = if keys.is_empty() { "no key".to_owned() } else { keys.join(" ") };
        lines.push(format!(
            "  axis {}: {} to {}, neutral {}, moved by {keys}",
            axis.name, axis.low, axis.high, axis.neutral
        ));
    }
    for event in &spec.events {
        let (kind, count) = (event.kind.name(), event.count.name());
        lines.push(format!("  event {}: {kind}, counted {count}, from {}", event.name, event.field));
    }
    let weights = spec.justifications.iter().map(|each| format!("{} {}", each.name, each.weight));
    let weights: Vec<_> = weights.chain([format!("default {}", spec.weights.default)]).collect();
    lines.push(format!("  justifications: {}", weights.join(", ")));
    let planner = &spec.planner;
    let candidates = match planner.candidates.from {
        CandidateSource::File => {
            format!("{} candidates", planner.candidates.n_given())
        }
        CandidateSource::Recordings => "candidates from recordings".to_owned(),
    };
    lines.push(format!(
        "  planner: {} steps ahead ({:.2} s), anew every {}, {candidates}",
        planner.horizon,
        planner.horizon as f64 / spec.rate,
        planner.replan
    ));
    lines.join("\n") + "\n"
}

/// Takes `n` random steps, each axis anywhere in its range, and says what came.
fn drive(
    spec: WorldSpec,
    folder: &Path,
    n: usize,
    seed: u64,
    telling: &mut Telling,
) -> Result<(), WorldError> {
    let began = Instant::now();
    let mut world = ProcessWorld::start(spec.clone(), folder)?;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut episode_seed = seed;
    let (_, first) = world.reset_told(episode_seed)?;
    telling.say(&format!("started and reset in {:.2} s", began.elapsed().as_secs_f64()));
    telling.note("start_secs", began.elapsed().as_secs_f64());

    let began = Instant::now();
    let mut told: Vec<bool> =
        spec.fields().iter().map(|name| field_value(&first.fields, name).is_some()).collect();
    let mut counts = vec![[0_usize; 2]; spec.events.len()];
    let (mut n_ends, mut rewards) = ([0_usize; 2], Vec::new());
    let mut meter = Meter::new();
    for taken in 1..=n {
        meter.at("random steps", taken, n, String::new);
        let action: Vec<f32> = spec.axes.iter().map(|axis| rng.random_range(axis.low..=axis.high)).collect();
        let (step, reply) = world.step_told(&action)?;
        for (told, name) in told.iter_mut().zip(spec.fields()) {
            *told |= field_value(&reply.fields, &name).is_some();
        }
        for (counts, event) in counts.iter_mut().zip(&step.events) {
            counts[0] += usize::from(event.happened);
            counts[1] += usize::from(event.passed);
        }
        rewards.extend(step.reward);
        n_ends[0] += usize::from(step.end == Some(End::Terminated));
        n_ends[1] += usize::from(step.end == Some(End::Truncated));
        if step.end.is_some() && taken < n {
            episode_seed += 1;
            world.reset_told(episode_seed)?;
        }
    }
    let seconds = began.elapsed().as_secs_f64();
    drop(meter);
    telling.say(&format!("{n} random steps in {seconds:.2} s: {:.0} a second", n as f64 / seconds.max(1e-9)));
    telling.say(&format!("  episodes: {} terminated, {} truncated", n_ends[0], n_ends[1]));
    let sum: f32 = rewards.iter().sum();
    telling.note("steps", n);
    telling.note("secs", seconds);
    telling.note("terminated", n_ends[0]);
    telling.note("truncated", n_ends[1]);
    match rewards.iter().copied().reduce(f32::min).zip(rewards.iter().copied().reduce(f32::max)) {
        Some((least, most)) => {
            telling.say(&format!("  rewards: {least} to {most}, sum {sum}"));
            telling.note("rewards", json!({"least": least, "most": most, "sum": sum}));
        }
        None => telling.say("  rewards: none"),
    }
    let counted = spec.events.iter().zip(&counts).map(|(event, n)| (event.name.clone(), n[0].into()));
    telling.note("events", counted.collect::<serde_json::Map<_, _>>());
    for (event, [happened, passed]) in spec.events.iter().zip(counts) {
        let of = if event.count == Count::OfPassed { format!(" of {passed} passed") } else { String::new() };
        telling.say(&format!("  {}: {happened}{of}", event.name));
    }
    for (name, _) in spec.fields().iter().zip(told).filter(|(_, told)| !told) {
        eprintln!("the process never told the field {name:?}, from which an event is read");
    }
    for warning in world.take_warnings() {
        eprintln!("{warning}");
    }
    Ok(())
}

fn new(options: &New) -> anyhow::Result<()> {
    if let Some(out) = &options.out {
        anyhow::ensure!(!out.exists(), "there is a file of that name already; choose another: {out:?}");
    }
    let (file, next) = match (&options.data, &options.process) {
        (Some(dir), _) => {
            let (_, file) = world_data::first_file(dir, &options.cameras, options.action.as_deref())?;
            (file, format!("--data {dir:?}"))
        }
        (None, Some(process)) => (file_of_process(options, process)?, "--run 50".to_owned()),
        (None, None) => unreachable!("one of both is required"),
    };
    match &options.out {
        None => print!("{file}"),
        Some(out) => {
            write_whole(out, file.as_bytes())?;
            eprintln!("written: {out:?}; read through it, and then: dropj world check {out:?} {next}");
        }
    }
    Ok(())
}

/// A first file for the process that `command` starts.
fn file_of_process(options: &New, command: &str) -> anyhow::Result<String> {
    let command = parts(command).with_context(|| format!("--process {command:?}"))?;
    let time_outs = TimeOuts { start: options.start_time_out, ..TimeOuts::default() };
    let launch = Launch { command: command.clone(), folder: None, environment: vec![], time_outs };
    let (hello, fields) = ask(&launch, options.steps).map_err(told)?;
    let folder = options.out.as_deref().map(started_in).transpose()?.flatten();
    let source = Source { kind: SourceKind::Process, command, folder, time_outs, ..Source::default() };
    let rate = options.rate.or(hello.hertz).or(hello.render_fps).with_context(|| {
        "the process does not say how many steps a second it takes: say so with --rate HZ".to_owned()
    })?;
    let spec = first_spec(&hello, source, rate);
    spec.check().context("no world's file can be written for this process")?;
    Ok(spec.to_toml() + &hints(&hello, &fields, options.rate.is_none() && hello.hertz.is_none()))
}

/// The folder to start a process in that was asked in the present one, from the folder of the file `out`; none where both are
/// the same.
fn started_in(out: &Path) -> anyhow::Result<Option<PathBuf>> {
    let (here, out) = (std::env::current_dir()?, std::path::absolute(out)?);
    let there = out.parent().unwrap_or(&out);
    if there == here {
        return Ok(None);
    }
    let up = there.strip_prefix(&here).map(|inner| inner.iter().map(|_| "..").collect());
    Ok(Some(up.unwrap_or(here)))
}

/// What was seen of a field: its values in the order of the steps.
type Told = Vec<(String, Vec<f64>)>;

/// What a process says of itself, and what it tells of `n` neutral steps.
fn ask(launch: &Launch, n: usize) -> Result<(Hello, Told), WorldError> {
    let mut process = Process::start(launch)?;
    let hello = process.hello().clone();
    let mut told = Told::new();
    if n == 0 {
        return Ok((hello, told));
    }
    let action: Vec<f32> = hello.axes.iter().map(|axis| neutral(axis.low, axis.high, axis.neutral)).collect();
    let (_, mut reply) = process.reset(0, &Fields::All)?;
    for step in 0..=n {
        if step > 0 {
            reply = process.step(&action)?.1;
        }
        for name in reply.fields.keys() {
            let Some(value) = field_value(&reply.fields, name) else { continue };
            match told.iter_mut().find(|(other, _)| other == name) {
                Some((_, values)) => values.push(value),
                None => told.push((name.clone(), vec![value])),
            }
        }
        if reply.terminated || reply.truncated {
            break;
        }
    }
    Ok((hello, told))
}

/// The neutral value of an axis: what is said, else 0 where that is in its range, else its middle.
fn neutral(low: f64, high: f64, said: Option<f64>) -> f32 {
    let within = |value: &f64| (low..=high).contains(value);
    said.filter(within).or(Some(0.0).filter(within)).unwrap_or(f64::midpoint(low, high)) as f32
}

/// A first file for a process.
fn first_spec(hello: &Hello, source: Source, rate: f64) -> WorldSpec {
    let (height, width) = (hello.image.height, hello.image.width);
    let shrink = (f64::from(height.max(width)) / f64::from(MOST_TRAINED)).max(1.0);
    let side = |pixels: u32| ((f64::from(pixels) / shrink).round() as u32).max(8);
    let train = Size { height: side(height), width: side(width) };
    let mut inputs = Inputs::new();
    let axes = hello.axes.iter().enumerate().map(|(i, axis)| {
        let (low, high, neutral) =
            (axis.low as f32, axis.high as f32, neutral(axis.low, axis.high, axis.neutral));
        let distance = (high - neutral) - (neutral - low);
        let (keys, pad) = inputs.take(low, high, neutral);
        Axis {
            name: readable(&axis.name).unwrap_or_else(|| format!("axis {}", i + 1)),
            low,
            high,
            neutral,
            mirrored: false,
            keys,
            pad,
            key_speed: None,
            release: if distance.abs() < 1e-3 * (high - low) && low >= 0.0 {
                Release::Stay
            } else {
                Release::Spring
            },
        }
    });
    let events = hello.events.iter().filter_map(|event| {
        Some(EventSpec {
            name: readable(&event.name)?,
            kind: event.kind,
            count: Count::PerStep,
            field: event.field.clone(),
            when: When::True,
            passed: None,
        })
    });
    let events: Vec<_> = events.collect();
    let unsafe_events = events.iter().filter(|event| event.kind == EventKind::Safety);
    let justifications = unsafe_events.map(|event| JustificationSpec {
        name: event.name.clone(),
        events: vec![event.name.clone()],
        weight: 1.0,
    });
    // The paper looks 0.3 to 0.5 s ahead at 50 Hz.
    let horizon = (rate / 2.0).round().clamp(10.0, 50.0) as usize;
    WorldSpec {
        format: FORMAT,
        name: file_name(&hello.name),
        title: readable(&hello.name).unwrap_or_else(|| "A world".to_owned()),
        rate,
        longest_episode: hello.longest_episode.filter(|&n| n > 0).unwrap_or(1000),
        source,
        image: ImageSpec {
            height,
            width,
            train: (train != Size { height, width }).then_some(train),
            ..ImageSpec::default()
        },
        axes: axes.collect(),
        justifications: justifications.collect(),
        events,
        weights: dropj::world::LabelWeights::default(),
        planner: PlannerSpec { horizon, memory_reset: Some(50), ..PlannerSpec::default() },
        networks: dropj::world::NetworkOverrides::default(),
        fitting: dropj::world::FittingOverrides::default(),
    }
}

/// What whoever goes on with a first file should know, as comments.
fn hints(hello: &Hello, told: &Told, is_guessed: bool) -> String {
    let mut lines = vec![String::new()];
    if is_guessed {
        lines.push(
            "# The rate is what the process says of its pictures, and often wrong: look it up.".to_owned(),
        );
    }
    if !told.is_empty() {
        lines.push("# What the process tells of a step, and what it was in some neutral ones. An event reads one of these:".to_owned());
    }
    for (name, values) in told {
        let least = values.iter().copied().fold(f64::INFINITY, f64::min);
        let most = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        lines.push(format!("#   field = {:?}  # {least} to {most}", shown(name)));
    }
    let versions: Vec<_> =
        hello.versions.iter().map(|(name, version)| format!("{} {}", shown(name), shown(version))).collect();
    if !versions.is_empty() {
        lines.push(format!("# Made with {}.", versions.join(", ")));
    }
    lines.join("\n") + "\n"
}

/// A command's parts: split at spaces, with quotes and backslashes as a shell has them.
fn parts(command: &str) -> anyhow::Result<Vec<String>> {
    let (mut parts, mut part, mut quote) = (vec![], None::<String>, None);
    let mut rest = command.chars();
    while let Some(c) = rest.next() {
        match (quote, c) {
            (Some(open), c) if open == c => quote = None,
            (None, '\'' | '"') => {
                quote = Some(c);
                part.get_or_insert_default();
            }
            (None | Some('"'), '\\') => {
                part.get_or_insert_default().push(rest.next().context("a backslash stands at the end")?);
            }
            (None, c) if c.is_whitespace() => parts.extend(part.take()),
            (_, c) => part.get_or_insert_default().push(c),
        }
    }
    anyhow::ensure!(quote.is_none(), "a quote is not closed");
    parts.extend(part);
    anyhow::ensure!(!parts.is_empty(), "a program has to be named");
    Ok(parts)
}

fn adapter(options: &Adapter) -> anyhow::Result<()> {
    let Some(out) = &options.out else {
        for (name, _) in ADAPTER {
            println!("{name}");
        }
        eprintln!("--out DIR writes these files");
        return Ok(());
    };
    for (name, text) in ADAPTER {
        let path = out.join(name);
        let is_other = fs::read(&path).is_ok_and(|found| found != text.as_bytes());
        anyhow::ensure!(
            !is_other,
            "there is a file of that name that is not ours; choose another folder: {path:?}"
        );
    }
    for (name, text) in ADAPTER {
        write_whole(&out.join(name), text.as_bytes())?;
    }
    eprintln!("written to {out:?}; for Python to find it: PYTHONPATH={out:?}, or pip install {out:?}");
    Ok(())
}

/// An error whose lines of the process have been shown.
fn told(error: WorldError) -> anyhow::Error {
    let WorldError::Process(ProcessError { fault, last_lines }) = error else { return error.into() };
    let traceback =
        if let ProcessFault::Reported { traceback, .. } = &fault { traceback.as_slice() } else { &[] };
    for line in last_lines.iter().chain(traceback) {
        eprintln!("  | {line}");
    }
    fault.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_is_split_as_a_shell_does() {
        let split = |command| parts(command).map_err(|met| met.to_string());
        assert_eq!(split(r#"a  'b c' "d \"e" f\ g """#).unwrap(), ["a", "b c", "d \"e", "f g", ""]);
        assert!(split("a 'b").unwrap_err().contains("quote"));
        assert!(split("  ").unwrap_err().contains("program"));
    }
}
