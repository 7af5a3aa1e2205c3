//! `dropj deploy`.

use std::fmt::Write as _;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use dropj::drqv2::DrqPolicy;
use dropj::evaluation::{
    Constant, EpisodeMetrics, Oracle, PlanningPolicy, Policy, Summary, TracksAlike, Watched,
    evaluate_episode, table,
};
use dropj::planner::{Agent, PlannerConfig, candidates};
use dropj::reward::{LearnedReward, RewardConfig, RewardEnsemble, RewardInputs, RewardModel};
use dropj::run::{Kind, OutputFile};
use dropj::session::{Header, SessionStore};
use dropj::simulate::{Probe, SeenReward};
use dropj::world::{Action, World, event_slug};
use dropj::world_model::WorldModel;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use super::choices::{Computing, OracleName, PlannerName, Switch};
use super::chosen_world::{ChosenWorld, chosen_world};
use super::fit_drqv2;
use super::meter::Meter;
use super::models;
use super::numbers::{count, number32};
use super::run_file::RunFile;
use super::words::names;

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The session whose reward drives
    #[arg(long, required_unless_present_any = ["random_reward", "straight_on", "oracle", "drqv2"])]
    session: Option<PathBuf>,
    /// Drive by a reward that has learned nothing, drawn from this seed, for scale
    #[arg(long, conflicts_with = "session")]
    random_reward: Option<u64>,
    /// Do the first thing that the planner could throughout, without looking, for scale: a car drives straight on
    #[arg(long, conflicts_with_all = ["session", "random_reward"])]
    straight_on: bool,
    /// Plan with what no method has, for scale: in copies of the simulator by its own reward, or in imagination by what the
    /// stand-in for a person sees in its pictures
    #[arg(long, value_enum, conflicts_with_all = ["session", "random_reward", "straight_on"])]
    oracle: Option<OracleName>,
    /// Act as an agent that `fit-drqv2` trained, for scale: it learned in the real world, by its true reward
    #[arg(long, value_name = "FILE", conflicts_with_all = ["session", "random_reward", "straight_on", "oracle"])]
    drqv2: Option<PathBuf>,
    /// The world to act in, by its name or its file [default: the session's or the agent's, or car-racing]
    #[arg(long, value_name = "NAME|FILE", value_parser = chosen_world)]
    env: Option<ChosenWorld>,
    /// The driving aids of the paper's evaluation, where there are obstacles
    #[arg(long, value_enum, default_value = "on")]
    aids: Switch,
    /// How many episodes
    #[arg(long, value_parser = clap::value_parser!(u64).range(0..=100_000), default_value_t = 10)]
    episodes: u64,
    /// The seed of the first; the others follow by one
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Which planner acts: ours, or the authors' for comparison
    #[arg(long, value_enum, default_value = "ours")]
    planner: PlannerName,
    /// How many steps the planner looks ahead [default: the world's]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=200))]
    horizon: Option<u16>,
    /// How hard the candidates of the built-in cars brake, from 0 to 1 [default: the world's]
    #[arg(long, value_parser = number32(0.0..=1.0))]
    brake: Option<f32>,
    /// Steps between forgetting all memory; 0 is never [default: the world's]
    #[arg(long, value_parser = count(0..=1_000_000))]
    memory_reset: Option<usize>,
    /// A world model other than the session's or the shipped one
    #[arg(long)]
    world: Option<PathBuf>,
    /// A table to write, a line a step: what the world knows, what happened, what was done and what the plan promised
    #[arg(long)]
    steps: Option<PathBuf>,
    /// Print the result as JSON: an object a line, an episode each, then one for the whole
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    computing: Computing,
    #[command(flatten)]
    pub(crate) run_file: RunFile,
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    tch::set_num_threads(1);
    let table_of_steps =
        options.steps.as_deref().map(|path| OutputFile::at(path, Kind::Table)).transpose()?;
    if let Some(path) = &options.drqv2 {
        return act_as_agent(options, path, table_of_steps);
    }
    let header = options.session.as_deref().map(Header::read).transpose()?;
    let kept = options.session.as_deref().map(SessionStore::read_reward).transpose()?;
    let (model, env) = if let (Some(dir), Some(header)) = (&options.session, &header) {
        let model = models::of_session(dir, options.world.as_deref())?;
        let own = || ChosenWorld::of_session(header, Some(&model));
        let env = options.env.clone().map_or_else(own, Ok)?;
        (model, env)
    } else {
        let env = options.env.clone().unwrap_or_else(ChosenWorld::usual);
        let path = env.named_world_model(options.world.as_deref());
        (models::world_model(&path)?, env)
    };
    models::require(&model, &env)?;
    let model = model.on(options.computing.backend()?)?;
    let probe = probe_of(options, &env, &model)?;
    let mut is_sparse = false;
    let reward: Box<dyn RewardModel + '_> = if let Some(probe) = &probe {
        Box::new(SeenReward::new(&model, probe, &env.spec))
    } else if let Some((_, reward)) = &kept {
        let dir = options.session.as_deref().unwrap_or(Path::new(""));
        let none = || format!("the session {dir:?} has no reward yet: fit one in the window");
        let learned = LearnedReward::load(reward.as_ref().with_context(none)?, &model)?;
        is_sparse = learned.is_sparse();
        Box::new(learned)
    } else {
        let rng = &mut ChaCha8Rng::seed_from_u64(options.random_reward.unwrap_or(0));
        let ensemble = RewardEnsemble::new(RewardInputs::of(&model), RewardConfig::car_racing(), rng);
        let ensemble = ensemble.on(model.backend());
        Box::new(ensemble.for_inference())
    };

    let config = planner_of(options, &env, &model, is_sparse)?;
    if let Some(all) = options.run_file.to_print() {
        print!("{}", all.with("env", env.name()).with("planner", &config).to_toml());
        return Ok(());
    }
    let name = kept.map_or_else(|| "baseline".to_owned(), |(session, _)| names(&session.protocols()));
    let straight_on = first_action(&config, &env);
    drive_all(options, &env, &name, table_of_steps, &mut |number, drive| {
        let agent = Agent::new(config.clone(), number);
        match options.oracle {
            _ if options.straight_on => drive(&mut Constant(straight_on)),
            Some(OracleName::World) => drive(&mut Oracle::new(config.clone(), number)),
            _ => drive(&mut PlanningPolicy::new(&model, &reward, agent)),
        }
    })
}

/// Acts as a trained agent does, without a session or a world model.
fn act_as_agent(options: &Options, path: &Path, table_of_steps: Option<OutputFile>) -> anyhow::Result<()> {
    let (agent, env) = fit_drqv2::agent(path, options.env.as_ref())?;
    if let Some(all) = options.run_file.to_print() {
        print!("{}", all.with("env", env.name()).to_toml());
        return Ok(());
    }
    drive_all(options, &env, "drqv2", table_of_steps, &mut |_, drive| drive(&mut DrqPolicy::new(&agent)))
}

/// Drives one episode by the policy that it is given.
type Drive<'a> = dyn FnMut(&mut dyn Policy) -> anyhow::Result<EpisodeMetrics> + 'a;

/// Drives all episodes, each by the policy that `as_who` gives for its number, and says how they went.
fn drive_all(
    options: &Options,
    env: &ChosenWorld,
    name: &str,
    table_of_steps: Option<OutputFile>,
    as_who: &mut dyn FnMut(u64, &mut Drive<'_>) -> anyhow::Result<EpisodeMetrics>,
) -> anyhow::Result<()> {
    let tracks = TracksAlike { seed: options.seed };
    let (mut episodes, mut meter) = (Vec::new(), Meter::new());
    let n_steps = options.episodes as usize * env.spec.longest_episode;
    let mut steps = String::new();
    let mut world = env.open(options.aids.is_on())?;
    for i in 0..options.episodes {
        let number = options.seed.wrapping_add(i);
        let metrics = as_who(number, &mut |policy| {
            let metrics = evaluate_episode(&mut *world, tracks.track(i), policy, |world, step| {
                if options.steps.is_some() {
                    if steps.is_empty() {
                        steps = heading(world);
                    }
                    steps.push_str(&line(number, world, step));
                }
                let done = i as usize * env.spec.longest_episode + step.t + 1;
                meter.at("driving steps", done, n_steps, || format!("track {number}"));
                ControlFlow::Continue(())
            });
            metrics.with_context(|| {
                format!("the episode on track {number} ended, for nothing can be driven by this")
            })
        })?;
        if options.json {
            meter.print(&serde_json::json!({"track": number, "metrics": metrics}).to_string());
        } else {
            meter.print(&format!(
                "track {number}: return {:.0}, {}{} steps{}",
                metrics.ret,
                events(&metrics),
                metrics.n_steps,
                metrics.plan_ms_mean.map_or(String::new(), |ms| format!(", plan {ms:.1} ms"))
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
        println!("{}", table(&[(name, summary)]));
    }
    Ok(())
}

/// What sees in imagined pictures, where that is asked for.
fn probe_of(options: &Options, env: &ChosenWorld, model: &WorldModel) -> anyhow::Result<Option<Probe>> {
    if options.oracle != Some(OracleName::Seen) {
        return Ok(None);
    }
    let probe = models::probe(None, &env.named_world_model(options.world.as_deref()), env, model.backend())?;
    probe.require(model)?;
    Ok(Some(probe))
}

/// How it is planned.
fn planner_of(
    options: &Options,
    env: &ChosenWorld,
    model: &WorldModel,
    is_sparse: bool,
) -> anyhow::Result<PlannerConfig> {
    let planner = PlannerConfig::of_world(&env.spec, model);
    let planner = match options.planner {
        PlannerName::Ours => planner,
        PlannerName::Paper => planner.authors(&env.spec),
    };
    let planner = if is_sparse { planner.for_transitions() } else { planner };
    let planner =
        options.run_file.over("planner", &planner, PlannerConfig::check)?.for_world(&env.spec, model);
    let horizon = options.horizon.map_or(planner.horizon, usize::from);
    let brake = options.brake.or(planner.brake);
    let given = options.memory_reset.map(|steps| (steps > 0).then_some(steps));
    let memory_reset = given.unwrap_or(planner.memory_reset);
    Ok(PlannerConfig { horizon, brake, memory_reset, ..planner })
}

/// What the planner could do first, throughout.
fn first_action(config: &PlannerConfig, env: &ChosenWorld) -> Action {
    let constant = candidates(config, &mut ChaCha8Rng::seed_from_u64(0));
    let first = constant.first().and_then(|course| course.first()).copied();
    first.unwrap_or_else(|| Action::new(env.spec.neutral()))
}

/// What happened in an episode: `grass 0.2 %, new tile 31.0 %, `.
fn events(metrics: &EpisodeMetrics) -> String {
    let mut text = String::new();
    for figure in metrics.events.iter().filter(|figure| figure.value.is_some()) {
        let _ = write!(text, "{} {}, ", figure.name, figure.shown());
    }
    text
}

/// The heading of the table of steps.
fn heading(world: &dyn World) -> String {
    let spec = world.spec();
    let known = world.known().into_iter().map(|(name, _)| name.to_owned());
    let events = spec.events.iter().map(|event| event_slug(&event.name));
    let axes = spec.axes.iter().map(|axis| axis.name.replace([',', '"'], " "));
    let all = ["track", "step"].map(str::to_owned).into_iter().chain(known).chain(events).chain(axes);
    all.chain(["chosen", "best", "worst"].map(str::to_owned)).collect::<Vec<_>>().join(",") + "\n"
}

/// A line of the table of steps.
fn line(track: u64, world: &dyn World, watched: &Watched<'_>) -> String {
    let plan = watched.plan.map_or(",,".to_owned(), |plan| {
        let returns = || plan.candidates.iter().map(|candidate| candidate.predicted_return);
        let (best, worst) = (returns().fold(f32::MIN, f32::max), returns().fold(f32::MAX, f32::min));
        format!("{},{best:.3},{worst:.3}", plan.chosen)
    });
    let known = world.known().into_iter().map(|(_, value)| value.to_string());
    let events = watched.step.events.iter().map(|event| u8::from(event.happened).to_string());
    let axes = watched.executed.iter().map(f32::to_string);
    let cells: Vec<_> = known.chain(events).chain(axes).collect();
    format!("{track},{},{},{plan}\n", watched.t, cells.join(","))
}
