//! `dropj deploy`.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use dropj::env::{Env, MAX_STEPS};
use dropj::evaluation::{
    PlanningPolicy, Policy, Step, StraightOn, Summary, TracksAlike, evaluate_episode, table,
};
use dropj::planner::{Agent, PlannerConfig};
use dropj::reward::{LearnedReward, RewardConfig, RewardEnsemble};
use dropj::run::{Kind, OutputFile};
use dropj::session::{Header, SessionStore};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use super::choices::{EnvName, Switch};
use super::meter::Meter;
use super::models;
use super::numbers::{count, number32};
use super::run_file::RunFile;
use super::words::names;

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
    /// The world to drive in [default: the session's, or car-racing]
    #[arg(long, value_enum)]
    env: Option<EnvName>,
    /// The driving aids of the paper's evaluation, where there are obstacles
    #[arg(long, value_enum, default_value = "on")]
    aids: Switch,
    /// How many episodes
    #[arg(long, value_parser = clap::value_parser!(u64).range(0..=100_000), default_value_t = 10)]
    episodes: u64,
    /// The track of the first; the others follow by one
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// How many steps the planner looks ahead [default: the world's]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=200))]
    horizon: Option<u16>,
    /// How hard the planner's candidates brake, from 0 to 1 [default: the world's]
    #[arg(long, value_parser = number32(0.0..=1.0))]
    brake: Option<f32>,
    /// Steps between forgetting all memory; 0 is never [default: 50]
    #[arg(long, value_parser = count(0..=1_000_000))]
    memory_reset: Option<usize>,
    /// A world model other than the session's or the shipped one
    #[arg(long)]
    world: Option<PathBuf>,
    /// A table to write, a line a step: where the car was, what was done and what the plan promised
    #[arg(long)]
    steps: Option<PathBuf>,
    /// Print JSON: an object an episode, then one for the whole
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    pub(crate) run_file: RunFile,
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    tch::set_num_threads(1);
    let table_of_steps =
        options.steps.as_deref().map(|path| OutputFile::at(path, Kind::Table)).transpose()?;
    let header = options.session.as_deref().map(Header::read).transpose()?;
    let own = header.map(|header| EnvName::named(&header.env)).transpose()?;
    let env = options.env.or(own).unwrap_or(EnvName::CarRacing);
    let kept = options.session.as_deref().map(SessionStore::read_reward).transpose()?;
    let model = match (&options.world, &options.session) {
        (Some(path), _) => models::world_model(path)?,
        (None, Some(dir)) => models::of_session(dir, None)?,
        (None, None) => models::world_model(&models::world_model_asset(env))?,
    };
    models::require(&model, env)?;
    let reward = if let Some((_, reward)) = &kept {
        let dir = options.session.as_deref().unwrap_or(Path::new(""));
        let none = || format!("the session {dir:?} has no reward yet: fit one in the window");
        LearnedReward::load(reward.as_ref().with_context(none)?, model.identity())?
    } else {
        let rng = &mut ChaCha8Rng::seed_from_u64(options.random_reward.unwrap_or(0));
        let (n, config) = (model.config().n_features(), RewardConfig::car_racing());
        LearnedReward::Preferences(RewardEnsemble::new(n, &model.hash(), config, rng).for_inference())
    };

    let planner = if reward.is_sparse() { env.planner().for_transitions() } else { env.planner() };
    let planner = options.run_file.over("planner", &planner, PlannerConfig::check)?;
    let horizon = options.horizon.map_or(planner.horizon, usize::from);
    let brake = options.brake.unwrap_or(planner.brake);
    let given = options.memory_reset.map(|steps| (steps > 0).then_some(steps));
    let memory_reset = given.unwrap_or(planner.memory_reset);
    let config = PlannerConfig { horizon, brake, memory_reset, ..planner };
    if let Some(all) = options.run_file.to_print() {
        print!("{}", all.with("env", env.name()).with("planner", &config).to_toml());
        return Ok(());
    }
    let tracks = TracksAlike { seed: options.seed };
    let mut episodes = Vec::new();
    let mut meter = Meter::new();
    let n_steps = options.episodes as usize * MAX_STEPS;
    let mut steps =
        "track,step,speed,lateral,heading_error,wheels_off,grass,chuckhole,car,steer,gas,brake,chosen,best,worst\n"
            .to_owned();
    for i in 0..options.episodes {
        let number = options.seed.wrapping_add(i);
        let seed = tracks.track(i);
        let mut env = env.open(options.aids.aids());
        let agent = Agent::new(config.clone(), number);
        let mut planning = PlanningPolicy::new(&model, &reward, agent);
        let policy: &mut dyn Policy = if options.straight_on { &mut StraightOn } else { &mut planning };
        let metrics = evaluate_episode(&mut *env, seed, policy, |env, step| {
            if options.steps.is_some() {
                steps.push_str(&line(number, env, step));
            }
            let done = i as usize * MAX_STEPS + step.t + 1;
            meter.at("driving steps", done, n_steps, || format!("track {number}"));
            ControlFlow::Continue(())
        });
        let metrics = metrics.with_context(|| {
            format!(
                "the episode on track {} ended, for nothing can be driven by this",
                options.seed.wrapping_add(i)
            )
        })?;
        if options.json {
            meter.print(&serde_json::json!({"track": number, "metrics": metrics}).to_string());
        } else {
            meter.print(&format!(
                "track {number}: return {:.0}, new tiles {:.1} %, grass {:.2} %, {}{}{} steps, plan {:.1} ms",
                metrics.ret,
                100.0 * metrics.new_tile_rate,
                100.0 * metrics.grass_rate,
                rate("chuckholes", metrics.chuckhole_rate),
                rate("cars", metrics.car_rate),
                metrics.n_steps,
                metrics.plan_ms_mean.unwrap_or(0.0)
            ));
        }
        episodes.push(metrics);
    }
    drop(meter);
    if let Some(table) = table_of_steps {
        table.write(steps.as_bytes())?;
    }
    let summary = Summary::of(&episodes);
    if options.json {
        println!("{}", serde_json::json!({"summary": summary}));
    } else {
        let name = kept.map_or_else(|| "baseline".to_owned(), |(session, _)| names(&session.protocols()));
        println!("{}", table(&[(&name, summary)]));
    }
    Ok(())
}

/// A rate that not every world has, in percent.
fn rate(name: &str, rate: Option<f32>) -> String {
    rate.map_or(String::new(), |rate| format!("{name} {:.0} %, ", 100.0 * rate))
}

/// A line of the table of steps.
fn line(track: u64, env: &dyn Env, step: &Step<'_>) -> String {
    let truth = env.truth();
    let (action, events) = (step.executed, step.outcome.events);
    let plan = step.plan.map_or(",,".to_owned(), |plan| {
        let returns = || plan.candidates.iter().map(|candidate| candidate.predicted_return);
        let (best, worst) = (returns().fold(f32::MIN, f32::max), returns().fold(f32::MAX, f32::min));
        format!("{},{best:.3},{worst:.3}", plan.chosen)
    });
    format!(
        "{track},{},{:.2},{:.2},{:.3},{},{},{},{},{},{},{},{plan}\n",
        step.t,
        truth.speed,
        truth.lateral,
        truth.heading_error,
        truth.wheels_off,
        u8::from(events.grass),
        u8::from(events.chuckhole),
        u8::from(events.car),
        action.steer,
        action.gas,
        action.brake
    )
}
