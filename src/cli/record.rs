//! `dropj record`.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::Instant;

use dropj::dataset::Dataset;
use dropj::env::Aids;
use dropj::simulate::record::record;

use super::EnvName;

/// As many as a dataset of ours can number.
const MAX_EPISODES: u64 = 1_000_000;

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The world to drive in
    #[arg(long, value_enum, default_value = "car-racing")]
    env: EnvName,
    /// Who drives
    #[arg(long, value_enum, default_value = "scripted")]
    pilot: Pilot,
    /// How many episodes
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u64).range(..=MAX_EPISODES))]
    episodes: u64,
    /// The number of the first, to share the work among several runs
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u64).range(..=u64::from(u32::MAX)))]
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
    let mut env = options.env.open(Aids::NONE);
    let mut dataset = Dataset::create_or_open(&options.out, options.env.name())?;
    let started = Instant::now();
    let (mut n_steps, mut n_grass, mut n_chuckhole, mut n_car, mut n_episodes) = (0, 0, 0, 0, 0);
    record(
        &mut *env,
        &mut dataset,
        options.first..options.first + options.episodes,
        options.seed,
        |recorded| {
            n_steps += recorded.n_steps;
            n_grass += recorded.n_grass;
            n_chuckhole += recorded.n_chuckhole;
            n_car += recorded.n_car;
            n_episodes += 1;
            let rate = n_steps as f64 / started.elapsed().as_secs_f64();
            eprintln!(
                "episode {}: {} steps, return {:.0}, {:.0} % grass, {} steps in chuckholes, {} at cars \
                 ({rate:.0} steps/s)",
                recorded.k,
                recorded.n_steps,
                recorded.ret,
                percent(recorded.n_grass, recorded.n_steps),
                recorded.n_chuckhole,
                recorded.n_car
            );
            ControlFlow::Continue(())
        },
    )?;
    println!(
        "{n_episodes} episodes of {n_steps} steps recorded, {:.1} % of them on the grass, {:.1} % in chuckholes, \
         {:.1} % at other cars; {} in all in {:?}",
        percent(n_grass, n_steps),
        percent(n_chuckhole, n_steps),
        percent(n_car, n_steps),
        dataset.n_episodes(),
        options.out
    );
    Ok(())
}

fn percent(n: usize, of: usize) -> f64 {
    100.0 * n as f64 / of.max(1) as f64
}
