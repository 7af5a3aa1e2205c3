//! `dropj simulate`.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context as _;
use dropj::query::{Protocol, Query, SegmentRef};
use dropj::reward::{Fitted, RewardConfig, fit_anew, segment_rows};
use dropj::session::{Answer, Choice, DreamSource, Event, Fit, Header, SessionStore, now};
use dropj::simulate::annotator::Annotator;
use dropj::simulate::run::{Answered, Progress, SimulateConfig, simulate};
use dropj::world_model::WorldModel;

use super::{EnvName, models, names};

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// Which questions are asked; of several, such as drop,drope,dropj, each gets its share of the queries
    #[arg(long, value_parser = parse_protocol, value_delimiter = ',', default_value = "dropj")]
    protocol: Vec<Protocol>,
    /// How many queries; those that are skipped count
    #[arg(long, default_value_t = 500)]
    queries: usize,
    /// How many answers are taken back and given again, evenly spread
    #[arg(long, default_value_t = 0)]
    undo: usize,
    /// How many dreams are played
    #[arg(long, default_value_t = 10)]
    dreams: usize,
    /// Steps of a dream
    #[arg(long, default_value_t = 1000)]
    steps: usize,
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
    #[arg(long)]
    beta: Option<f32>,
    /// Discount of the past: below 1 the end of a clip weighs more
    #[arg(long)]
    gamma: Option<f32>,
    /// Share of preferences that are turned round
    #[arg(long)]
    eps_mistake: Option<f64>,
    /// What a step at the edge of the road costs, in tiles
    #[arg(long)]
    care: Option<f32>,
    /// Doubt above which a query is skipped
    #[arg(long)]
    eps_skip: Option<f32>,
    /// Difference below which clips are equal
    #[arg(long)]
    eps_equal: Option<f32>,
    /// Share of safety judgements that are turned round
    #[arg(long)]
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

fn parse_protocol(text: &str) -> Result<Protocol, String> {
    match text {
        "drop" => Ok(Protocol::Drop),
        "drope" => Ok(Protocol::Drope),
        "dropj" => Ok(Protocol::Dropj),
        _ => Err("the protocols that can be simulated are drop, drope and dropj".to_owned()),
    }
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    let env = EnvName::CarRacing;
    let world = options.world.clone().unwrap_or_else(|| models::world_model_asset(env));
    let model = models::world_model(&world)?;
    let probe = models::probe(options.probe.as_deref())?;
    let mut header = Header::new(env.name(), options.protocol[0], options.seed, &model.hash(), now());
    "simulated".clone_into(&mut header.config.annotator);
    header.world_model_path = relative(&options.out, &world);
    let mut store = SessionStore::create(&options.out, header)?;

    let config = SimulateConfig {
        protocols: options.protocol.clone(),
        n_queries: options.queries,
        n_dreams: options.dreams,
        dream_steps: options.steps,
        seed: options.seed,
        annotator: options.knobs.annotator(),
    };
    anyhow::ensure!(
        !model.starts().is_empty(),
        "the world model {world:?} has no states to start dreams from"
    );
    let started = Instant::now();
    let mut said = Instant::now();
    let simulated = simulate(&model, &probe, &config, model.starts(), &mut |progress| {
        if said.elapsed().as_secs() >= 5 {
            said = Instant::now();
            match progress {
                Progress::Played(done, n) => eprintln!("playing: step {done} of {n}"),
                Progress::Decoded(done, n) => eprintln!("looking: dream {done} of {n}"),
                Progress::Answered(done, n) => eprintln!("answering: query {done} of {n}"),
            }
        }
        ControlFlow::Continue(())
    })
    .context("the simulation was broken off")?;
    for dream in &simulated.dreams {
        store.save_dream(dream, DreamSource::Simulated)?;
    }
    let n = simulated.answers.len();
    for (i, answered) in simulated.answers.iter().enumerate() {
        let is_undone = (i + 1) * options.undo / n > i * options.undo / n;
        record(&mut store, answered, is_undone)?;
    }
    let fit = fit_reward(&mut store, &model, options.seed)?;
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
fn record(store: &mut SessionStore, answered: &Answered, is_undone: bool) -> anyhow::Result<()> {
    let &Answered { query: Query { id: query, left, right }, protocol, response, .. } = answered;
    if protocol != store.session().protocol() {
        store.record(Event::ProtocolChanged { protocol })?;
    }
    store.record(Event::Asked { query, left, right, choice: Choice::Uniform })?;
    let answer = Event::Answered(Answer::new(query, response, 0.0, "simulated"));
    if is_undone {
        store.record(answer.clone())?;
        store.record(Event::Retracted { query })?;
    }
    store.record(answer)?;
    Ok(())
}

/// Fits a fresh reward to every answer of the session and keeps it there.
fn fit_reward(store: &mut SessionStore, model: &WorldModel, seed: u64) -> anyhow::Result<Fit> {
    let mut dreams = BTreeMap::new();
    for kept in store.session().dreams() {
        let episode = store.dream(kept.dream)?;
        let features = episode.features(model);
        dreams.insert(kept.dream, (episode.actions, features));
    }
    let rows = |segment: SegmentRef| {
        let (actions, features) = &dreams[&segment.dream];
        Ok::<_, Infallible>(segment_rows(features, actions, segment))
    };
    let labels = store.session().labeled();
    anyhow::ensure!(!labels.is_empty(), "there are no answers to learn from");
    let config = RewardConfig::car_racing();
    let epochs = config.epochs as u32;
    let Ok(fitted) = fit_anew(model, config, seed, &labels, rows, |_| ControlFlow::Continue(()));
    let Fitted { trainer, losses } = fitted.context("the fit was broken off")?;
    let after = store.session().n_entries();
    let fit = Fit { after, n_labels: labels.len(), seed, epochs, losses, held_out: None };
    store.save_reward(&trainer.ensemble().parameters(), fit.clone())?;
    Ok(fit)
}

/// The way from the folder `from` to the file `to`, where both lie below the same folder.
fn relative(from: &Path, to: &Path) -> Option<String> {
    let (from, to) = (std::path::absolute(from).ok()?, std::path::absolute(to).ok()?);
    let n_shared = from.components().zip(to.components()).take_while(|(a, b)| a == b).count();
    let up = from.components().skip(n_shared).map(|_| std::path::Component::ParentDir);
    let way: PathBuf = up.chain(to.components().skip(n_shared)).collect();
    way.to_str().map(str::to_owned)
}
