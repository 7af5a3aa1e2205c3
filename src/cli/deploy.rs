//! `dropj deploy`.

use std::ops::ControlFlow;
use std::path::PathBuf;

use anyhow::Context as _;
use dropj::env::{CarRacing, Env};
use dropj::evaluation::{PlanningPolicy, Policy, StraightOn, Summary, TracksAlike, evaluate_episode, table};
use dropj::planner::{Agent, PlannerConfig};
use dropj::reward::{RewardConfig, RewardEnsemble};
use dropj::session::SessionStore;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use super::{EnvName, models};

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The session whose reward drives
    #[arg(long, required_unless_present_any = ["random_reward", "straight_on"])]
    session: Option<PathBuf>,
    /// Drive by a reward that has learned nothing, drawn from this seed, for scale
    #[arg(long, conflicts_with = "session")]
    random_reward: Option<u64>,
    /// Drive straight on without looking, for scale
    #[arg(long, conflicts_with_all = ["session", "random_reward"])]
    straight_on: bool,
    /// The world to drive in
    #[arg(long, value_enum, default_value = "car-racing")]
    env: EnvName,
    /// How many episodes
    #[arg(long, default_value_t = 10)]
    episodes: u64,
    /// The track of the first; the others follow by one
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Steps between forgetting all memory; 0 is never
    #[arg(long, default_value_t = 50)]
    memory_reset: usize,
    /// A world model other than the session's or the shipped one
    #[arg(long)]
    world: Option<PathBuf>,
    /// Print JSON: an object an episode, then one for the whole
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    anyhow::ensure!(options.env == EnvName::CarRacing, "only car-racing can be deployed in so far");
    tch::set_num_threads(1);
    let store = options.session.as_deref().map(|dir| SessionStore::open(dir, None)).transpose()?;
    let model = match (&options.world, &store) {
        (Some(path), _) => models::world_model(path)?,
        (None, Some(store)) => store.world_model()?,
        (None, None) => models::world_model(&models::world_model_asset(options.env))?,
    };
    let reward = if let Some(store) = &store {
        let parameters = store.reward()?.with_context(|| {
            format!("the session {:?} has no reward yet: fit one in the window", store.dir())
        })?;
        RewardEnsemble::load(&parameters)?
    } else {
        let rng = &mut ChaCha8Rng::seed_from_u64(options.random_reward.unwrap_or(0));
        RewardEnsemble::new(model.config().n_features(), &model.hash(), RewardConfig::car_racing(), rng)
    };
    reward.require(&model.hash())?;
    let reward = reward.frozen();

    let memory_reset = (options.memory_reset > 0).then_some(options.memory_reset);
    let config = PlannerConfig { memory_reset, ..PlannerConfig::car_racing() };
    let tracks = TracksAlike { seed: options.seed };
    let mut episodes = Vec::new();
    for i in 0..options.episodes {
        let seed = tracks.track(i);
        let mut env: Box<dyn Env> = Box::new(CarRacing::new(seed));
        let agent = Agent::new(config.clone(), options.seed.wrapping_add(i));
        let mut planning = PlanningPolicy::new(&model, &reward, agent);
        let policy: &mut dyn Policy = if options.straight_on { &mut StraightOn } else { &mut planning };
        let metrics = evaluate_episode(&mut *env, seed, policy, |_, _| ControlFlow::Continue(()));
        if options.json {
            println!("{}", serde_json::json!({"track": options.seed + i, "metrics": metrics}));
        } else {
            println!(
                "track {}: return {:.0}, new tiles {:.1} %, grass {:.2} %, {} steps, plan {:.1} ms",
                options.seed + i,
                metrics.ret,
                100.0 * metrics.new_tile_rate,
                100.0 * metrics.grass_rate,
                metrics.n_steps,
                metrics.plan_ms_mean.unwrap_or(0.0)
            );
        }
        episodes.push(metrics);
    }
    let summary = Summary::of(&episodes);
    if options.json {
        println!("{}", serde_json::json!({"summary": summary}));
    } else {
        let name = store.as_ref().map_or("baseline", |store| store.header().protocol.name());
        println!("{}", table(&[(name, summary)]));
    }
    Ok(())
}
