//! `dropj` without a subcommand: the window.

use std::path::{Path, PathBuf};

use dropj::env::{CarRacing, Seed};
use dropj::planner::PlannerConfig;
use dropj::reward::RewardConfig;
use dropj::session::SessionStore;
use dropj::tensor::from_slice;
use dropj::ui::{self, DreamStart, LoadedWorld, Plans, Startup, Threads, system_pads};
use dropj::world_model::WorldModelConfig;
use dropj::world_model::fit::FitConfig;

use super::{EnvName, models};

#[derive(Debug, Default, clap::Args)]
pub(crate) struct Options {
    /// The folder of a session to go on with
    #[arg(long)]
    session: Option<PathBuf>,
    /// A world model other than the shipped one
    #[arg(long)]
    world: Option<PathBuf>,
    /// The folder in which sessions are kept
    #[arg(long, default_value = "sessions")]
    sessions: PathBuf,
    /// The folder of recordings
    #[arg(long, default_value = "data/car-racing")]
    data: PathBuf,
}

pub(crate) fn run(options: Options) -> anyhow::Result<()> {
    let env = EnvName::CarRacing;
    // The screen keeps a core: what runs beside it has one thread each.
    tch::set_num_threads(1);
    let world = options.world.unwrap_or_else(|| models::world_model_asset(env));
    let session = options.session.as_deref().map(|dir| SessionStore::open(dir, None)).transpose()?;
    let plans = Plans {
        env: Box::new(|| Box::new(CarRacing::new(Seed::Native(0)))),
        env_name: env.name().to_owned(),
        world: WorldModelConfig::car_racing(),
        fit: FitConfig::car_racing(),
        reward: RewardConfig::car_racing(),
        planner: PlannerConfig::car_racing(),
    };
    let startup = Startup {
        sessions: options.sessions,
        dataset: options.data,
        world: load(&world),
        session,
        load: Box::new(load),
        hire: Box::new(|reports, model| Box::new(Threads::new(plans, reports, model))),
        input: system_pads(),
    };
    ui::run(startup).map_err(anyhow::Error::msg)
}

/// The world model in `path`, with what a person may want to know of it.
fn load(path: &Path) -> Result<LoadedWorld, String> {
    let model = models::world_model(path).map_err(|e| format!("{e:#}"))?;
    let shipped = models::world_model_asset(EnvName::CarRacing);
    let name = if path == shipped {
        "the shipped one".to_owned()
    } else {
        path.file_name().unwrap_or_default().to_string_lossy().into_owned()
    };
    let config = model.config();
    let card = vec![
        ("Environment".to_owned(), config.env.clone()),
        ("Pixels a side".to_owned(), config.vae.side.to_string()),
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
    })
}
