//! `dropj` without a subcommand: the window.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::time::SystemTime;

use anyhow::Context as _;
use dropj::app::{FirstWorld, Startup};
use dropj::planner::PlannerConfig;
use dropj::planner::synthesis::SynthesisConfig;
use dropj::reward::RewardConfig;
use dropj::session::SessionStore;
use dropj::tensor::from_slice;
use dropj::text::shown;
use dropj::ui::{self, WindowStartup, system_pads};
use dropj::worker::{Cause, DreamStart, LoadedWorld, Threads, WorkerConfig, Workers};
use dropj::world_model::fit::FitConfig;

use super::choices::Computing;
use super::chosen_world::{ChosenWorld, chosen_world};
use super::words::in_words;
use super::{models, settings};

#[derive(Debug, Default, clap::Args)]
pub(crate) struct Options {
    /// The world, by its name or its file; without it the session's, or car-racing
    #[arg(long, value_name = "NAME|FILE", value_parser = chosen_world)]
    env: Option<ChosenWorld>,
    /// The folder of a session to go on with
    #[arg(long)]
    session: Option<PathBuf>,
    /// A world model other than the shipped one
    #[arg(long)]
    world: Option<PathBuf>,
    /// Open this as if it were dropped on the window: results, recordings, a session or a world model; may be given
    /// several times
    #[arg(long, value_name = "PATH")]
    open: Vec<PathBuf>,
    /// The folder in which sessions are kept
    #[arg(long, default_value = "sessions")]
    sessions: PathBuf,
    /// The folder of recordings; without it data/ and the world's name
    #[arg(long)]
    data: Option<PathBuf>,
    #[command(flatten)]
    computing: Computing,
}

pub(crate) fn run(options: Options) -> anyhow::Result<()> {
    // The screen keeps a core: what runs beside it has one thread each.
    tch::set_num_threads(1);
    let session = options.session.as_deref().map(|dir| SessionStore::open(dir, None)).transpose()?;
    let env = match (options.env, &session) {
        (Some(env), _) => env,
        (None, Some(session)) => {
            let path = options.world.clone().or_else(|| session.world_model_path());
            let model = path.as_deref().map(models::world_model).transpose()?;
            ChosenWorld::of_session(session.header(), model.as_ref())?
        }
        (None, None) => ChosenWorld::usual(),
    };
    let own = session.as_ref().and_then(SessionStore::world_model_path);
    let world = match options.world.as_deref() {
        named @ Some(_) => env.named_world_model(named),
        None => own.unwrap_or_else(|| env.world_model()),
    };
    let shipped = env.world_model();
    let here = env.clone();
    let load = move |path: &Path| {
        load(path, path == shipped && here.is_built_in(), &here)
            .map_err(|error| -> Cause { Arc::new(LoadError(in_words(&error))) })
    };
    let config = WorkerConfig {
        open: env.opener(),
        spec: Arc::clone(&env.spec),
        world: env.networks(),
        fit: FitConfig::for_world(&env.spec),
        reward: RewardConfig::car_racing(),
        planner: PlannerConfig::of(&env.spec, None),
        synthesis: SynthesisConfig::paper(),
        load: Arc::new(load),
        backend: options.computing.backend()?,
    };
    let app = Startup {
        spec: Arc::clone(&env.spec),
        spec_file: env.file.clone(),
        sessions: options.sessions.clone(),
        dataset: options.data.unwrap_or_else(|| Path::new("data").join(env.name())),
        world: FirstWorld::In(world),
        session,
        seed: SystemTime::now()
            .duration_since(SystemTime::UNIX_EPOCH)
            .map_or(0, |since| since.as_nanos() as u64),
    };
    let sessions = options.sessions;
    let workers = Box::new(|wake| -> Box<dyn Workers> { Box::new(Threads::new(config, None, wake)) });
    let startup = WindowStartup { app, workers, input: system_pads() };
    let notices = ui::settings_file().and_then(|path| settings::look_after(&path));
    match ui::run(startup, notices.into_iter().collect(), options.open)? {
        Some(world) => begin_anew(&world, &sessions),
        None => Ok(()),
    }
}

/// Starts the program for the world in a file. Sessions stay where they are; session, world model and recordings were
/// those of another world.
fn begin_anew(world: &Path, sessions: &Path) -> anyhow::Result<()> {
    let mut program = Command::new(std::env::current_exe()?);
    program.arg("--env").arg(world).arg("--sessions").arg(sessions);
    log::info!("begins anew: {program:?}");
    #[cfg(unix)]
    {
        use std::os::unix::process::CommandExt as _;
        Err(program.exec()).context("the world cannot be opened")
    }
    #[cfg(not(unix))]
    program.spawn().map(drop).context("the world cannot be opened")
}

/// Why a world model could not be read, in one sentence.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct LoadError(String);

/// The world model in `path`, with what a person may want to know of it.
fn load(path: &Path, is_shipped: bool, env: &ChosenWorld) -> anyhow::Result<LoadedWorld> {
    let model = models::world_model(path)?;
    models::require(&model, env)?;
    let name = if is_shipped {
        "the shipped one".to_owned()
    } else {
        shown(&path.file_name().unwrap_or_default().to_string_lossy())
    };
    let config = model.config();
    let card = vec![
        ("World".to_owned(), model.spec().title.clone()),
        ("Pixels".to_owned(), model.spec().image.trained().to_string()),
        ("Latents".to_owned(), config.vae.latent.to_string()),
        ("Memory cells".to_owned(), config.mdn_rnn.memory.to_string()),
    ];
    let starts = model.starts().iter().enumerate().map(|(i, state)| DreamStart {
        name: format!("Start {}", i + 1),
        picture: model.decode(&from_slice(&state.z, &[1, -1])).pop(),
        state: state.clone(),
    });
    let starts = starts.collect();
    Ok(LoadedWorld {
        name,
        path: Some(path.to_owned()),
        parameters: model.parameters().clone(),
        card,
        starts,
        compact: env.compact_world_model().filter(|_| is_shipped),
    })
}
