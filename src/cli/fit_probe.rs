//! `dropj fit-probe`.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context as _;
use dropj::env::Aids;
use dropj::run::{Kind, OutputFile};
use dropj::simulate::fit_probe::{FitProbeConfig, fit_probe};

use super::convert::Precision;
use super::numbers::count;
use super::{EnvName, models};

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The world that is looked at
    #[arg(long, value_enum, default_value = "car-racing")]
    env: EnvName,
    /// The world model through whose eyes half of the pictures are seen
    #[arg(long)]
    world: Option<PathBuf>,
    /// The file to write
    #[arg(long)]
    out: PathBuf,
    /// Episodes that are driven to fit on
    #[arg(long, value_parser = count(2..=100_000))]
    episodes: Option<usize>,
    /// Updates
    #[arg(long, value_parser = count(1..=10_000_000))]
    updates: Option<usize>,
    /// How each number of the file is stored
    #[arg(long, value_enum, default_value = "f32")]
    dtype: Precision,
    /// Of episodes, initialization and order
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    tch::set_num_threads(1);
    let world = options.world.clone().unwrap_or_else(|| models::world_model_asset(options.env));
    let model = models::world_model(&world)?;
    models::require(&model, options.env)?;
    let config = match options.env {
        EnvName::CarRacing => FitProbeConfig::car_racing(),
        _ => FitProbeConfig::obstacle_car_racing(),
    };
    let config = FitProbeConfig {
        seed: options.seed,
        n_episodes: options.episodes.unwrap_or(config.n_episodes),
        n_updates: options.updates.unwrap_or(config.n_updates),
        ..config
    };
    let out = OutputFile::at(&options.out, Kind::Network)?;
    let mut env = options.env.open(Aids::NONE);
    let mut said = Instant::now();
    let fit = fit_probe(&config, &mut *env, Some(&model), &mut |progress| {
        if said.elapsed().as_secs() >= 10 {
            said = Instant::now();
            eprintln!("{:?} {} of {}: loss {:.4}", progress.phase, progress.done, progress.n, progress.loss);
        }
        ControlFlow::Continue(())
    });
    let fit = fit.context("the probe cannot be fitted")?;
    let parameters = options.dtype.store(&fit.parameters)?;
    out.write(parameters.bytes())?;
    println!("held-out real frames: {:.3?}\nseen through the world model: {:.3?}", fit.real, fit.painted);
    println!("wrote {:?}, {}", options.out, parameters.hash());
    Ok(())
}
