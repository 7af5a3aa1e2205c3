//! `dropj fit-probe`.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::Instant;

use dropj::run::write_whole;
use dropj::simulate::fit_probe::{FitProbeConfig, fit_probe};

use super::{EnvName, models};

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The world model through whose eyes half of the pictures are seen
    #[arg(long)]
    world: Option<PathBuf>,
    /// The file to write
    #[arg(long)]
    out: PathBuf,
    /// Of episodes, initialization and order
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    tch::set_num_threads(1);
    let world = options.world.clone().unwrap_or_else(|| models::world_model_asset(EnvName::CarRacing));
    let model = models::world_model(&world)?;
    let config = FitProbeConfig { seed: options.seed, ..FitProbeConfig::car_racing() };
    let mut said = Instant::now();
    let fit = fit_probe(&config, Some(&model), &mut |progress| {
        if said.elapsed().as_secs() >= 10 {
            said = Instant::now();
            eprintln!("{:?} {} of {}: loss {:.4}", progress.phase, progress.done, progress.n, progress.loss);
        }
        ControlFlow::Continue(())
    });
    write_whole(&options.out, fit.parameters.bytes())?;
    println!("held-out real frames: {:.3?}\nseen through the world model: {:.3?}", fit.real, fit.painted);
    println!("wrote {:?}, {}", options.out, fit.parameters.hash());
    Ok(())
}
