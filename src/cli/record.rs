//! `dropj record`.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::Instant;

use dropj::dataset::Dataset;
use dropj::env::{CarRacing, Env, Seed};
use dropj::simulate::record::record;

use super::EnvName;

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The world to drive in
    #[arg(long, value_enum, default_value = "car-racing")]
    env: EnvName,
    /// Who drives
    #[arg(long, value_enum, default_value = "scripted")]
    pilot: Pilot,
    /// How many episodes
    #[arg(long, default_value_t = 10)]
    episodes: u64,
    /// The number of the first, to share the work among several runs
    #[arg(long, default_value_t = 0)]
    first: u64,
    /// Of tracks and driving
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// The folder to record into; episodes that it has are not driven again
    #[arg(long)]
    out: PathBuf,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Pilot {
    /// Drives from simulator truth, mostly safely
    Scripted,
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    let Pilot::Scripted = options.pilot;
    anyhow::ensure!(options.env == EnvName::CarRacing, "only car-racing can be recorded so far");
    let mut env: Box<dyn Env> = Box::new(CarRacing::new(Seed::Native(0)));
    let mut dataset = Dataset::create_or_open(&options.out, options.env.name())?;
    let started = Instant::now();
    let (mut n_steps, mut n_grass, mut n_episodes) = (0, 0, 0);
    record(
        &mut *env,
        &mut dataset,
        options.first..options.first + options.episodes,
        options.seed,
        |recorded| {
            n_steps += recorded.n_steps;
            n_grass += recorded.n_grass;
            n_episodes += 1;
            let rate = n_steps as f64 / started.elapsed().as_secs_f64();
            eprintln!(
                "episode {}: {} steps, return {:.0}, {:.0} % grass ({rate:.0} steps/s)",
                recorded.k,
                recorded.n_steps,
                recorded.ret,
                100.0 * recorded.n_grass as f64 / recorded.n_steps as f64
            );
            ControlFlow::Continue(())
        },
    )?;
    println!(
        "{n_episodes} episodes of {n_steps} steps recorded, {:.1} % of them on the grass; {} in all in {:?}",
        100.0 * f64::from(n_grass as u32) / f64::from((n_steps as u32).max(1)),
        dataset.n_episodes(),
        options.out
    );
    Ok(())
}
