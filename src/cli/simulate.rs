//! `dropj simulate`.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context as _;
use dropj::query::{Justifications, Protocol, Query, SEGMENT_LEN, Strategy};
use dropj::reward::RewardConfig;
use dropj::session::{Answer, DreamSource, Event, Header, NewSession, SessionStore, now, relative};
use dropj::simulate::annotator::Annotator;
use dropj::simulate::player::Manner;
use dropj::simulate::run::{Answered, Progress, SimulateConfig, simulate};

use super::numbers::{count, name, named_weight, number, number32, one_of};
use super::refit::fit_reward;
use super::{EnvName, models, names, verdicts};

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The world that is dreamed of
    #[arg(long, value_enum, default_value = "car-racing")]
    env: EnvName,
    /// Which questions are asked; of several, such as drop,drope,dropj, each gets its share of the queries [default:
    /// dropj, with obstacles dropj-multi]
    #[arg(long, value_parser = one_of(PROTOCOLS), value_delimiter = ',')]
    protocol: Vec<Protocol>,
    /// What may be named under dropj-multi, and what it weighs: the most severe first, such as
    /// chuckhole=1,grass=0.95,default=0.75
    #[arg(long, value_parser = named_weight, value_delimiter = ',')]
    weights: Vec<(String, f32)>,
    /// How many queries; those that are skipped count [default: the paper's 500, with obstacles 1000; of single
    /// transitions 2205]
    #[arg(long, value_parser = count(1..=1_000_000))]
    queries: Option<usize>,
    /// How many answers are taken back and given again, evenly spread
    #[arg(long, value_parser = count(0..=1_000_000), default_value_t = 0)]
    undo: usize,
    /// How pairs are chosen: uniform, balanced (seldom two that are likely unsafe), disagreement (of the reward's networks) or
    /// boundary (near where the road was left)
    #[arg(long, value_parser = one_of(CHOICES), default_value = "uniform")]
    choice: Strategy,
    /// Who answers, as the session says it
    #[arg(long, value_parser = name, default_value = "simulated")]
    annotator: String,
    /// How many dreams are played [default: the paper's 10, with obstacles 60]
    #[arg(long, value_parser = count(1..=10_000))]
    dreams: Option<usize>,
    /// Steps of a dream, at least those of a clip
    #[arg(long, value_parser = count(SEGMENT_LEN..=1_000_000), default_value_t = 1000)]
    steps: usize,
    /// In how many rounds dreams are played and answered, of preferences; from the second on the planner drives in turns with
    /// the player, by what was learned so far. Paper: 1
    #[arg(long, value_parser = count(1..=10_000), default_value_t = 1)]
    rounds: usize,
    /// What the player is after: exploring (off the road nearly half of the time) or touring (fast along it, slow beside it)
    #[arg(long, value_parser = one_of(MANNERS), default_value = "exploring")]
    manner: Manner,
    /// How many networks the reward of preferences is the mean of. Paper: 3
    #[arg(long, value_parser = clap::value_parser!(i64).range(1..=100), default_value_t = 3)]
    members: i64,
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
    /// What a step at the edge of the road costs, in tiles
    #[arg(long, value_parser = number32(0.0..=1e6))]
    care: Option<f32>,
    /// Doubt above which a query is skipped
    #[arg(long, value_parser = number32(0.0..=1e6))]
    eps_skip: Option<f32>,
    /// Difference below which clips are equal
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

/// The protocols by their names here.
const PROTOCOLS: &[(&str, Protocol)] = &[
    ("drop", Protocol::Drop),
    ("drope", Protocol::Drope),
    ("dropj", Protocol::Dropj),
    ("dropj-multi", Protocol::DropjMulti),
    ("request", Protocol::Request),
    ("dros", Protocol::Dros),
];

/// The ways to choose pairs by their names here.
const CHOICES: &[(&str, Strategy)] = &[
    ("uniform", Strategy::Uniform),
    ("balanced", Strategy::Balanced),
    ("disagreement", Strategy::Disagreement),
    ("boundary", Strategy::SafetyBoundary),
];

/// What players are after, by its name here.
const MANNERS: &[(&str, Manner)] = &[("exploring", Manner::Exploring), ("touring", Manner::Touring)];

/// No session is larger than so many steps in all: they are kept in memory while they are played.
const MOST_STEPS: usize = 10_000_000;

/// Whether the numbers fit each other, as far as that can be said before anything is read.
fn check(options: &Options, n_queries: usize, n_dreams: usize) -> anyhow::Result<()> {
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
    let is_sparse = options.protocol.first().is_some_and(|protocol| protocol.is_sparse());
    anyhow::ensure!(!is_sparse || options.rounds == 1, "rounds are for preferences: verdicts have none");
    let n_sparse = options.protocol.iter().filter(|protocol| protocol.is_sparse()).count();
    anyhow::ensure!(
        n_sparse == 0 || options.protocol.len() == 1,
        "transitions are labeled in a session of their own: name one protocol"
    );
    let weights = Justifications::new(options.weights.iter().cloned());
    anyhow::ensure!(
        options.weights.is_empty() || weights.is_ok(),
        weights.err().map_or_else(String::new, |e| e.to_string())
    );
    Ok(())
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    let env = options.env;
    let is_sparse = options.protocol.first().is_some_and(|protocol| protocol.is_sparse());
    let papers = match env {
        EnvName::CarRacing => SimulateConfig::car_racing(Protocol::default(), options.seed),
        _ => SimulateConfig::obstacle_car_racing(Protocol::default(), options.seed),
    };
    let usual = if is_sparse { verdicts::N_QUERIES } else { papers.n_queries };
    check(options, options.queries.unwrap_or(usual), options.dreams.unwrap_or(papers.n_dreams))?;
    let world = options.world.clone().unwrap_or_else(|| models::world_model_asset(env));
    let model = models::world_model(&world)?;
    models::require(&model, env)?;
    let probe = models::probe(options.probe.as_deref(), env)?;
    probe.require(&model)?;
    let protocols = match &options.protocol[..] {
        [] => vec![Protocol::of_env(env.name())],
        asked => asked.to_vec(),
    };
    let mut header = Header::new(env.name(), protocols[0], options.seed, &model.hash(), now());
    if !options.weights.is_empty() {
        header.config.weights.justifications = Justifications::new(options.weights.iter().cloned())?;
    }
    let justifications = header.config.weights.justifications.clone();
    header.config.annotator.clone_from(&options.annotator);
    header.world_model_path = relative(&options.out, &world);

    let is_sparse = protocols[0].is_sparse();
    let papers = match env {
        EnvName::CarRacing => SimulateConfig::car_racing(protocols[0], options.seed),
        _ => SimulateConfig::obstacle_car_racing(protocols[0], options.seed),
    };
    let config = SimulateConfig {
        protocols,
        justifications,
        n_queries: options.queries.unwrap_or(if is_sparse { verdicts::N_QUERIES } else { papers.n_queries }),
        n_dreams: options.dreams.unwrap_or(papers.n_dreams),
        dream_steps: options.steps,
        n_rounds: options.rounds,
        manner: options.manner,
        planner: env.planner(),
        reward: RewardConfig { members: options.members, ..papers.reward },
        annotator: options.knobs.annotator(),
        strategy: options.choice,
        ..papers
    };
    anyhow::ensure!(
        !model.starts().is_empty(),
        "the world model {world:?} has no states to start dreams from"
    );
    let new = NewSession::at(&options.out)?;
    let mut store = new.create(header)?;
    let started = Instant::now();
    let mut said = Instant::now();
    let on_progress = &mut |progress| {
        if said.elapsed().as_secs() >= 5 {
            said = Instant::now();
            match progress {
                Progress::Played(done, n) => eprintln!("playing: step {done} of {n}"),
                Progress::Decoded(done, n) => eprintln!("looking: dream {done} of {n}"),
                Progress::Answered(done, n) => eprintln!("answering: query {done} of {n}"),
            }
        }
        ControlFlow::Continue(())
    };
    if config.protocols.iter().any(|protocol| protocol.is_sparse()) {
        let said = verdicts::run(&mut store, &model, &probe, &config, on_progress)?;
        new.finish(store)?;
        println!("{said}; {:?}", options.out);
        return Ok(());
    }
    let simulated = simulate(&model, &probe, &config, model.starts(), on_progress)
        .context("the simulation cannot go on")?
        .context("the simulation was broken off")?;
    for dream in &simulated.dreams {
        store.save_dream(dream, DreamSource::Simulated)?;
    }
    let n = simulated.answers.len();
    for (i, answered) in simulated.answers.iter().enumerate() {
        let is_undone = (i + 1) * options.undo / n > i * options.undo / n;
        record(&mut store, answered, &options.annotator, is_undone)?;
    }
    let fit = fit_reward(&mut store, &model, config.reward.clone(), options.seed, None)?;
    let store = new.finish(store)?;
    println!(
        "{}: {} dreams, {} queries, {} labels; {:.0} % of the clips unsafe; losses {:.4?}; {:.0} s; {:?}",
        names(&store.session().protocols()),
        simulated.dreams.len(),
        simulated.answers.len(),
        fit.n_labels,
        100.0 * simulated.unsafe_share(),
        fit.losses,
        started.elapsed().as_secs_f64(),
        options.out
    );
    Ok(())
}

/// Writes an answer down; one that `is_undone` is taken back and given again.
fn record(
    store: &mut SessionStore,
    answered: &Answered,
    annotator: &str,
    is_undone: bool,
) -> anyhow::Result<()> {
    let &Answered { query: Query { id: query, left, right }, protocol, strategy, response, .. } = answered;
    if protocol != store.session().protocol() {
        store.record(Event::ProtocolChanged { protocol })?;
    }
    store.record(Event::Asked { query, left, right, choice: strategy.into() })?;
    let answer = Event::Answered(Answer::new(query, response, 0.0, annotator));
    if is_undone {
        store.record(answer.clone())?;
        store.record(Event::Retracted { query })?;
    }
    store.record(answer)?;
    Ok(())
}
