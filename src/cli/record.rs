//! `dropj record`.

use std::ops::ControlFlow;
use std::path::PathBuf;

use dropj::dataset::Dataset;
use dropj::env::Aids;
use dropj::simulate::record::record;

use super::choices::EnvName;
use super::meter::Meter;

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
    let mut meter = Meter::new();
    let (first, n) = (options.first, options.episodes as usize);
    meter.at("recording episodes", 0, n, String::new);
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
            meter.line(&format!(
                "episode {}: {} steps, return {:.0}, {:.0} % grass, {} steps in chuckholes, {} at cars",
                recorded.k,
                recorded.n_steps,
                recorded.ret,
                percent(recorded.n_grass, recorded.n_steps),
                recorded.n_chuckhole,
                recorded.n_car
            ));
            // Those that the dataset has already are passed over.
            let done = (recorded.k + 1 - first) as usize;
            meter.at("recording episodes", done, n, String::new);
            ControlFlow::Continue(())
        },
    )?;
    drop(meter);
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
