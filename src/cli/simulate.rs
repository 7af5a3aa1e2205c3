//! `dropj simulate`.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context as _;
use dropj::app::{Command, LabelCommand};
use dropj::planner::PlannerConfig;
use dropj::query::{DreamId, Justifications, Protocol, Query, SEGMENT_LEN, Strategy, Weights};
use dropj::reward::{RewardConfig, SparseConfig};
use dropj::session::{DreamSource, Header, NewSession, now, relative};
use dropj::simulate::annotator::Annotator;
use dropj::simulate::run::{Answered, Progress, SimulateConfig, simulate};
use serde_json::json;

use super::choices::{Computing, MannerName, ProtocolName, StrategyName};
use super::chosen_world::{ChosenWorld, chosen_world};
use super::learn::{Learned, learn_reward, sparse_config};
use super::meter::Meter;
use super::numbers::{count, name, named_weight, number, number32};
use super::run_file::{RunFile, Settings};
use super::script::Script;
use super::told::Form;
use super::words::names;
use super::{models, sparse};

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The world that is dreamed of, by its name or its file
    #[arg(long, value_name = "NAME|FILE", value_parser = chosen_world, default_value = "car-racing")]
    env: ChosenWorld,
    /// Which questions are asked; of several, such as drop,drope,dropj, each gets its share of the queries [default:
    /// dropj, where several things must not happen dropj-multi]
    #[arg(long, value_enum, value_delimiter = ',')]
    protocol: Vec<ProtocolName>,
    /// What may be named under dropj-multi, and what it weighs: the most severe first, such as
    /// crash=1,bump=0.95,default=0.75
    #[arg(long, value_parser = named_weight, value_delimiter = ',')]
    weights: Vec<(String, f32)>,
    /// How many queries; those that are skipped count [default: the paper's 500, where two things must not happen 1000,
    /// where more 1500; of single transitions 2205]
    #[arg(long, value_parser = count(1..=1_000_000))]
    queries: Option<usize>,
    /// How many answers are taken back and given again, evenly spread
    #[arg(long, value_parser = count(0..=1_000_000), default_value_t = 0)]
    undo: usize,
    /// How pairs are chosen [default: the paper's uniform; where several things must not happen least-answered]
    #[arg(long, value_enum)]
    choice: Option<StrategyName>,
    /// Who answers, as the session says it
    #[arg(long, value_parser = name, default_value = "simulated")]
    annotator: String,
    /// How many dreams are played [default: the paper's 10, where two things must not happen 30, where more 60]
    #[arg(long, value_parser = count(1..=10_000))]
    dreams: Option<usize>,
    /// Steps of a dream, at least those of a clip
    #[arg(long, value_parser = count(SEGMENT_LEN..=1_000_000), default_value_t = 1000)]
    steps: usize,
    /// In how many rounds dreams are played and answered, of preferences; from the second on the planner drives in turns with
    /// the player, by what was learned so far. Paper: 1
    #[arg(long, value_parser = count(1..=10_000), default_value_t = 1)]
    rounds: usize,
    /// What the player is after
    #[arg(long, value_enum, default_value = "exploring")]
    manner: MannerName,
    /// How many networks the reward of preferences is the mean of [default: the paper's 3]
    #[arg(long, value_parser = clap::value_parser!(i64).range(1..=100))]
    members: Option<i64>,
    /// Of everything drawn
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// The folder of the session to make
    #[arg(long)]
    out: PathBuf,
    /// A world model other than the shipped one
    #[arg(long)]
    world: Option<PathBuf>,
    /// A probe other than the shipped one
    #[arg(long)]
    probe: Option<PathBuf>,
    #[command(flatten)]
    knobs: Knobs,
    #[command(flatten)]
    computing: Computing,
    #[command(flatten)]
    form: Form,
    #[command(flatten)]
    pub(crate) run_file: RunFile,
}

/// How the annotator errs (B-Pref's knobs).
#[derive(Debug, clap::Args)]
struct Knobs {
    /// Rationality: preferences follow σ(beta · difference); without it they are always right
    #[arg(long, value_parser = number32(0.0..=1e6))]
    beta: Option<f32>,
    /// Discount of the past: below 1 the end of a clip weighs more
    #[arg(long, value_parser = number32(f32::EPSILON..=1.0))]
    gamma: Option<f32>,
    /// Share of preferences that are turned round
    #[arg(long, value_parser = number(0.0..=1.0))]
    eps_mistake: Option<f64>,
    /// What a step at the edge of what is safe costs, in the unit of progress, where that edge can be seen: by built-in cars
    #[arg(long, value_parser = number32(0.0..=1e6))]
    care: Option<f32>,
    /// How much a clip may jump before it is skipped: a built-in car in units; else pixels, as a multiple of what 99 of 100
    /// recorded steps change
    #[arg(long, value_parser = number32(0.0..=1e6))]
    eps_skip: Option<f32>,
    /// Difference below which clips are equal: in tiles for the built-in cars; else in deviations of what clips bring in the
    /// world's reward, or without one in progress events
    #[arg(long, value_parser = number32(0.0..=1e6))]
    eps_equal: Option<f32>,
    /// Share of safety judgements that are turned round
    #[arg(long, value_parser = number(0.0..=1.0))]
    eps_safety: Option<f64>,
}

impl Knobs {
    fn annotator(&self) -> Annotator {
        let careful = Annotator::careful();
        Annotator {
            beta: self.beta.or(careful.beta),
            gamma: self.gamma.unwrap_or(careful.gamma),
            eps_mistake: self.eps_mistake.unwrap_or(careful.eps_mistake),
            care: self.care.unwrap_or(careful.care),
            eps_skip: self.eps_skip.or(careful.eps_skip),
            eps_equal: self.eps_equal.unwrap_or(careful.eps_equal),
            eps_safety: self.eps_safety.unwrap_or(careful.eps_safety),
        }
    }
}

/// No session is larger than so many steps in all: they are kept in memory while they are played.
const MOST_STEPS: usize = 10_000_000;

/// Whether the numbers fit each other, as far as that can be said before anything is read.
fn check(options: &Options, protocols: &[Protocol], n_queries: usize, n_dreams: usize) -> anyhow::Result<()> {
    anyhow::ensure!(
        options.undo <= n_queries,
        "{} answers cannot be taken back where there are {n_queries}: choose another --undo",
        options.undo
    );
    anyhow::ensure!(
        n_dreams.saturating_mul(options.steps) <= MOST_STEPS,
        "{n_dreams} dreams of {} steps are more than the {MOST_STEPS} steps that one simulation plays",
        options.steps
    );
    anyhow::ensure!(
        (1..=n_dreams).contains(&options.rounds),
        "each round plays a dream: with {n_dreams} dreams there are 1 to {n_dreams} rounds, not {}",
        options.rounds
    );
    anyhow::ensure!(
        !protocols[0].is_sparse() || options.rounds == 1,
        "rounds are for preferences: verdicts have none"
    );
    let has_sparse = protocols.iter().any(|protocol| protocol.is_sparse());
    anyhow::ensure!(
        !has_sparse || protocols.len() == 1,
        "transitions are labeled in a session of their own: name one protocol"
    );
    Ok(())
}

/// What is simulated, as far as that can be said before anything is read, and how verdicts are learned.
fn settings(options: &Options) -> anyhow::Result<(SimulateConfig, SparseConfig)> {
    let env = &options.env;
    let protocols = match &options.protocol[..] {
        [] => vec![Protocol::of(&env.spec)],
        asked => asked.iter().copied().map(Protocol::from).collect(),
    };
    let papers = SimulateConfig::of(&env.spec, protocols[0], options.seed);
    let usual = if protocols[0].is_sparse() { sparse::N_QUERIES } else { papers.n_queries };
    let (n_queries, n_dreams) = (options.queries.unwrap_or(usual), options.dreams.unwrap_or(papers.n_dreams));
    check(options, &protocols, n_queries, n_dreams)?;
    let justifications = match &options.weights[..] {
        [] => Weights::of(&env.spec).justifications,
        given => Justifications::new(given.iter().cloned())?,
    };
    let planner = options.run_file.over("planner", &papers.planner, PlannerConfig::check)?;
    let reward = options.run_file.over("reward", &papers.reward, RewardConfig::check)?;
    let reward = RewardConfig { members: options.members.unwrap_or(reward.members), ..reward };
    let verdicts = options.run_file.over("sparse", &sparse_config(protocols[0]), SparseConfig::check)?;
    let config = SimulateConfig {
        protocols,
        justifications,
        n_queries,
        n_dreams,
        dream_steps: options.steps,
        n_rounds: options.rounds,
        manner: options.manner.into(),
        planner,
        reward,
        annotator: options.knobs.annotator(),
        strategy: options.choice.map_or(papers.strategy, Strategy::from),
        ..papers
    };
    Ok((config, verdicts))
}

/// The settings as a file says them.
fn to_toml(all: Settings, config: &SimulateConfig, verdicts: &SparseConfig) -> String {
    let Annotator { beta, gamma, eps_mistake, eps_skip, care, eps_equal, eps_safety } = config.annotator;
    let weights = config.justifications.iter().map(|(_, name, weight)| format!("{name}={weight}"));
    let all = all
        .with("protocol", &config.protocols)
        .with("weights", weights.collect::<Vec<_>>())
        .with("queries", config.n_queries)
        .with("dreams", config.n_dreams)
        .with_any("beta", beta)
        .with("gamma", gamma)
        .with("eps-mistake", eps_mistake)
        .with("care", care)
        .with_any("eps-skip", eps_skip)
        .with("eps-equal", eps_equal)
        .with("eps-safety", eps_safety)
        .with("planner", &config.planner);
    // Verdicts and preferences are learned by networks of different kinds.
    let is_sparse = config.protocols[0].is_sparse();
    let all = if is_sparse { all.with("sparse", verdicts) } else { all.with("reward", &config.reward) };
    all.to_toml()
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    let env = &options.env;
    let (mut config, learning) = settings(options)?;
    if let Some(all) = options.run_file.to_print() {
        print!("{}", to_toml(all, &config, &learning));
        return Ok(());
    }
    let world = env.named_world_model(options.world.as_deref());
    let backend = options.computing.backend()?;
    let model = models::world_model(&world)?.on(backend)?;
    models::require(&model, env)?;
    config.planner = config.planner.for_model(&model);
    let probe = models::probe(options.probe.as_deref(), &world, env, backend)?;
    probe.require(&model)?;
    let mut header = Header::of(&env.spec, config.protocols[0], options.seed, &model.hash(), now());
    header.config.weights.justifications = config.justifications.clone();
    header.config.annotator.clone_from(&options.annotator);
    header.world_model_path = relative(&options.out, &world);
    header.world_file = env.file.as_ref().map(|file| file.display().to_string());
    anyhow::ensure!(
        !model.starts().is_empty(),
        "the world model {world:?} has no states to start dreams from"
    );
    let new = NewSession::at(&options.out)?;
    let store = new.create(header)?;
    let started = Instant::now();
    let mut meter = Meter::new();
    let on_progress = &mut |progress| {
        match progress {
            Progress::Played(done, n) => meter.at("playing steps", done, n, String::new),
            Progress::Decoded(done, n) => meter.at("looking at dreams", done, n, String::new),
            Progress::Answered(done, n) => meter.at("answering queries", done, n, String::new),
        }
        ControlFlow::Continue(())
    };
    if config.protocols.iter().any(|protocol| protocol.is_sparse()) {
        let (came, store) = sparse::run(store, &model, &probe, &config, &learning, on_progress)?;
        drop(meter);
        let store = new.finish(store)?;
        let sparse::Simulated { said, mut told, curves } = came;
        curves.write(store.dir(), store.session())?;
        told["session"] = json!(options.out);
        return options.form.tell(&told, || format!("{said}; {:?}", options.out));
    }
    let simulated = simulate(&model, &probe, &config, model.starts(), on_progress)
        .context("the simulation cannot go on")?
        .context("the simulation was broken off")?;
    drop(meter);
    let mut script = Script::new(store, &model)?;
    for dream in &simulated.dreams {
        script.keep_dream(dream, DreamSource::Simulated, None)?;
    }
    let n = simulated.answers.len();
    for (i, answered) in simulated.answers.iter().enumerate() {
        let is_undone = (i + 1) * options.undo / n > i * options.undo / n;
        answer(&mut script, answered, &options.annotator, is_undone)?;
    }
    let dreams = (0..).map(DreamId).zip(simulated.dreams.iter().cloned()).collect();
    let Learned { parameters, fit, curves, .. } =
        learn_reward(script.session(), &dreams, &model, config.reward.clone(), options.seed, None, None)?;
    script.keep_reward(parameters, &fit)?;
    let store = script.finish()?;
    let store = new.finish(store)?;
    curves.write(store.dir(), store.session())?;
    let (protocols, secs) = (store.session().protocols(), started.elapsed().as_secs_f64());
    let told = json!({
        "session": options.out, "protocols": protocols, "dreams": simulated.dreams.len(), "queries": n,
        "labels": fit.n_labels, "unsafe_share": simulated.unsafe_share(), "losses": fit.losses, "secs": secs
    });
    let words = || {
        format!(
            "{}: {} dreams, {} queries, {} labels; {:.0} % of the clips unsafe; losses {:.4?}; {:.0} s; {:?}",
            names(&protocols),
            simulated.dreams.len(),
            simulated.answers.len(),
            fit.n_labels,
            100.0 * simulated.unsafe_share(),
            fit.losses,
            secs,
            options.out
        )
    };
    options.form.tell(&told, words)
}

/// Asks and answers what a person would be asked; one that `is_undone` is taken back and given again.
fn answer(script: &mut Script, answered: &Answered, annotator: &str, is_undone: bool) -> anyhow::Result<()> {
    let &Answered { query: Query { id: query, left, right }, protocol, strategy, response, .. } = answered;
    script.command(Command::Label(LabelCommand::ChangeProtocol(protocol)))?;
    script.ask([left, right], strategy.into())?;
    if is_undone {
        script.answer(query, response, annotator)?;
        script.command(Command::Label(LabelCommand::Undo))?;
    }
    script.answer(query, response, annotator)
}
