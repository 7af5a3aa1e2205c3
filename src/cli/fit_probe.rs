//! `dropj fit-probe`.

use std::ops::ControlFlow;
use std::path::PathBuf;

use anyhow::Context as _;
use dropj::env::Aids;
use dropj::run::{Kind, OutputFile};
use dropj::simulate::fit_probe::{FitProbeConfig, Phase, fit_probe};

use super::choices::{EnvName, Precision};
use super::meter::Meter;
use super::models;
use super::numbers::count;
use super::run_file::{MAX_WHOLE, RunFile};

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
    /// Of episodes, initialization and order [default: 0]
    #[arg(long)]
    seed: Option<u64>,
    #[command(flatten)]
    pub(crate) run_file: RunFile,
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    tch::set_num_threads(1);
    let config = match options.env {
        EnvName::CarRacing => FitProbeConfig::car_racing(),
        _ => FitProbeConfig::obstacle_car_racing(),
    };
    let config = options.run_file.over("fit", &config, FitProbeConfig::check)?;
    let config = FitProbeConfig {
        seed: options.seed.unwrap_or(config.seed),
        n_episodes: options.episodes.unwrap_or(config.n_episodes),
        n_updates: options.updates.unwrap_or(config.n_updates),
        ..config
    };
    if let Some(all) = options.run_file.to_print() {
        // A larger seed stands among the options, as text.
        let config = FitProbeConfig { seed: config.seed.min(MAX_WHOLE), ..config };
        print!("{}", all.with("fit", &config).to_toml());
        return Ok(());
    }
    let world = options.world.clone().unwrap_or_else(|| models::world_model_asset(options.env));
    let model = models::world_model(&world)?;
    models::require(&model, options.env)?;
    let out = OutputFile::at(&options.out, Kind::Network)?;
    let mut env = options.env.open(Aids::NONE);
    let mut meter = Meter::new();
    let fit = fit_probe(&config, &mut *env, Some(&model), &mut |progress| {
        let what = match progress.phase {
            Phase::Drive => "driving",
            Phase::Paint => "painting",
            Phase::Learn => "learning",
        };
        let loss = || if progress.loss > 0.0 { format!("loss {:.4}", progress.loss) } else { String::new() };
        meter.at(what, progress.done, progress.n, loss);
        ControlFlow::Continue(())
    });
    drop(meter);
    let fit = fit.context("the probe cannot be fitted")?;
    let parameters = options.dtype.store(&fit.parameters)?;
    out.write(parameters.bytes())?;
    println!("held-out real frames: {:.3?}\nseen through the world model: {:.3?}", fit.real, fit.painted);
    println!("wrote {:?}, {}", options.out, parameters.hash());
    Ok(())
}
