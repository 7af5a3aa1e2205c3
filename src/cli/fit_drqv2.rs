//! `dropj fit-drqv2`, and `dropj deploy --drqv2`.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use dropj::drqv2::{Beside, DrqAgent, DrqConfig, Job, Progress, Record, train};
use dropj::evaluation::{Results, Summary};
use dropj::run::{Kind, OutputFile, Run, read_parameters};
use dropj::tensor::DeviceChoice;

use super::choices::{Switch, backend};
use super::chosen_world::{ChosenWorld, chosen_world};
use super::meter::Meter;
use super::numbers::count;
use super::run_file::{MAX_WHOLE, RunFile};
use super::told::Form;

/// What of a job's memory its user decides, in the help of `--capacity`.
const MEMORY: &str = "Actions that the replay buffer holds [default: 1000000, as published]. Each takes one picture of memory, \
    21 kB in Car Racing and 49 kB in Obstacle Car Racing: a million that are full take 21 GB and 49 GB. On disk, where they \
    lie for --resume, they are compressed";

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The world to learn in, by its name or its file; it must tell a reward
    #[arg(long, value_name = "NAME|FILE", value_parser = chosen_world, default_value = "car-racing")]
    env: ChosenWorld,
    /// The file to write; checkpoints, the replay buffer, metrics and the curve go into a folder beside it, called as the file
    /// with .fit behind
    #[arg(long)]
    out: PathBuf,
    /// Go on from the last whole episode
    #[arg(long)]
    resume: bool,
    /// Steps of the world to learn from [default: 3100000, as published for tasks of middling difficulty; two cores take
    /// weeks]
    #[arg(long, value_parser = count(1..=1 << 32))]
    steps: Option<usize>,
    /// Samples of an update [default: 256, as published]
    #[arg(long, value_parser = count(1..=1 << 20))]
    batch: Option<usize>,
    /// Actions from one update to the next [default: 2, as published]
    #[arg(long, value_parser = count(1..=1_000_000))]
    update_every: Option<usize>,
    /// Steps of the world for which an action is held [default: 2, as published]
    #[arg(long, value_parser = count(1..=1000))]
    action_repeat: Option<usize>,
    /// Actions over which the noise falls from 1 to 0.1 [default: 500000, as published]
    #[arg(long, value_parser = count(0..=1 << 32))]
    noise_actions: Option<usize>,
    #[arg(long, value_parser = count(1..=1 << 32), help = MEMORY)]
    capacity: Option<usize>,
    /// Steps of the world from one evaluation to the next [default: 10000, as published]
    #[arg(long, value_parser = count(1..=1 << 32))]
    evaluate_every: Option<usize>,
    /// Episodes of an evaluation, without noise and on the tracks of `deploy` from seed 0 on [default: 10, as published]
    #[arg(long, value_parser = count(0..=100_000))]
    evaluation_episodes: Option<usize>,
    /// Draw a line beside the curve for another method, such as dropj=results.jsonl: the mean return of what `deploy --json`
    /// printed of it
    #[arg(long, value_name = "NAME=FILE")]
    beside: Vec<String>,
    /// The driving aids of the paper's evaluation, where there are obstacles
    #[arg(long, value_enum, default_value = "on")]
    aids: Switch,
    /// Of initialization, tracks, noise and samples [default: 0]
    #[arg(long)]
    seed: Option<u64>,
    /// On what to compute: auto (an accelerator, if there is one), cpu, cuda, cuda:N or mps
    #[arg(long, default_value = "auto")]
    device: DeviceChoice,
    /// Threads for the arithmetic on the processor
    #[arg(long, value_parser = clap::value_parser!(i32).range(1..=1024), default_value_t = 2)]
    threads: i32,
    #[command(flatten)]
    form: Form,
    #[command(flatten)]
    pub(crate) run_file: RunFile,
}

impl Options {
    fn config(&self) -> anyhow::Result<DrqConfig> {
        let config = self.run_file.over("fit", &DrqConfig::published(), DrqConfig::check)?;
        let given = |given: Option<usize>, or: u64| given.map_or(or, |given| given as u64);
        let mut noise = config.noise;
        noise.actions = given(self.noise_actions, noise.actions);
        Ok(DrqConfig {
            seed: self.seed.unwrap_or(config.seed),
            steps: given(self.steps, config.steps),
            batch: self.batch.unwrap_or(config.batch),
            update_every: given(self.update_every, config.update_every),
            action_repeat: self.action_repeat.unwrap_or(config.action_repeat),
            capacity: self.capacity.unwrap_or(config.capacity),
            evaluate_every: given(self.evaluate_every, config.evaluate_every),
            evaluation_episodes: given(self.evaluation_episodes, config.evaluation_episodes),
            noise,
            ..config
        })
    }
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    tch::set_num_threads(options.threads);
    let config = options.config()?;
    if let Some(all) = options.run_file.to_print() {
        // A larger seed stands among the options, as text.
        let config = DrqConfig { seed: config.seed.min(MAX_WHOLE), ..config };
        print!("{}", all.with("fit", &config).to_toml());
        return Ok(());
    }
    config.check_for(options.env.spec.image.trained())?;
    let backend = backend(options.device)?;
    let out = OutputFile::at(&options.out, Kind::Network)?;
    let beside = options.beside.iter().map(|named| reached(named)).collect::<anyhow::Result<Vec<_>>>()?;
    let mut world = options.env.open(options.aids.is_on())?;
    let run = Run::beside(&options.out, options.resume)?;
    let mut meter = Meter::new();
    let job = Job { backend, run: &run, beside: &beside };
    let parameters = train(&mut *world, &config, job, &mut |progress| {
        say(&mut meter, progress);
        ControlFlow::Continue(())
    });
    drop(meter);
    let parameters = parameters?;
    let hint = "it has learned, but nothing is written; with `--resume` nothing is learned anew";
    out.write(parameters.bytes()).context(hint)?;
    let hash = parameters.hash();
    options.form.tell(&serde_json::json!({"file": options.out, "hash": hash}), || {
        format!("wrote {:?}, {hash}", options.out)
    })
}

/// What a method reached, from its name and its file of results.
fn reached(named: &str) -> anyhow::Result<Beside> {
    let (name, path) = named.split_once('=').context("what is drawn beside is written NAME=FILE")?;
    let bytes = std::fs::read(path).with_context(|| format!("cannot read the results {path:?}"))?;
    let ret = Summary::of(&Results::parse(&bytes).episodes).ret;
    let ret = ret.with_context(|| format!("there are no episodes in these results: {path:?}"))?;
    Ok(Beside { name: name.to_owned(), ret: ret.mean })
}

fn say(meter: &mut Meter, progress: &Progress) {
    match &progress.record {
        Some(Record::Episode(one)) => {
            let events: Vec<_> = one.events.iter().map(|(event, n)| format!("{event} {n}")).collect();
            let learned = match (one.critic_loss, one.value) {
                (Some(loss), Some(value)) => format!(", loss {loss:.3}, value {value:.1}"),
                _ => ", exploring".to_owned(),
            };
            meter.line(&format!(
                "episode {}: return {:.0}; in {} steps {} unsafe ({}); noise {:.2}{learned}",
                one.episode,
                one.ret,
                one.steps,
                one.unsafe_steps,
                events.join(", "),
                one.noise
            ));
        }
        Some(Record::Evaluation(one)) => meter.line(&format!(
            "evaluated after {} steps, {} updates: return {:.0} in {} episodes, unsafe {:.1} %",
            one.steps,
            one.updates,
            one.ret,
            one.returns.len(),
            100.0 * one.unsafe_rate
        )),
        None => {}
    }
    if let Some([done, n]) = progress.evaluating {
        meter.at("evaluation steps", done, n, || format!("after {} steps", progress.steps));
        return;
    }
    let done = progress.steps.min(progress.n_steps) as usize;
    meter.at("learning steps", done, progress.n_steps as usize, || {
        let ret = progress.ret.map_or(String::new(), |ret| format!(", last return {ret:.0}"));
        format!("{} updates, {} unsafe steps{ret}", progress.updates, progress.unsafe_steps)
    });
}

/// The agent in the file at `path`, and the world to act in: this one, or the one that it was trained in.
pub(crate) fn agent(path: &Path, env: Option<&ChosenWorld>) -> anyhow::Result<(DrqAgent, ChosenWorld)> {
    let agent = DrqAgent::load(&read_parameters(path)?);
    let agent = agent.with_context(|| format!("there is no agent of DrQ-v2 in this file: {path:?}"))?;
    let named = || {
        ChosenWorld::named(agent.world())
            .context("the agent was trained in a world of its own: name it with --env")
    };
    let env = env.cloned().map_or_else(named, Ok)?;
    agent.require(&env.spec)?;
    Ok((agent, env))
}
