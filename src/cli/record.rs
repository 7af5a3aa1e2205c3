//! `dropj record`.

use std::fmt::Write as _;
use std::ops::ControlFlow;
use std::path::PathBuf;

use dropj::dataset::Dataset;
use dropj::simulate::record::record;

use super::chosen_world::{ChosenWorld, chosen_world};
use super::meter::Meter;
use super::told::Form;

/// As many as a dataset of ours can number.
const MAX_EPISODES: u64 = 1_000_000;

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The world to act in, by its name or its file
    #[arg(long, value_name = "NAME|FILE", value_parser = chosen_world, default_value = "car-racing")]
    env: ChosenWorld,
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
    #[command(flatten)]
    form: Form,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Pilot {
    /// The world itself, mostly safely: a built-in car by what its simulator knows, a process by its own policy; a process
    /// without one is explored by chance
    Scripted,
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    let Pilot::Scripted = options.pilot;
    let mut world = options.env.open(false)?;
    let mut dataset = Dataset::create_or_open(&options.out, options.env.name())?;
    let mut meter = Meter::new();
    let (first, n) = (options.first, options.episodes as usize);
    meter.at("recording episodes", 0, n, String::new);
    let names: Vec<&str> = options.env.spec.events.iter().map(|event| event.name.as_str()).collect();
    let (mut n_steps, mut n_episodes, mut events) = (0, 0, vec![0; names.len()]);
    let recorded = record(
        &mut *world,
        &mut dataset,
        options.first..options.first + options.episodes,
        options.seed,
        |recorded| {
            n_steps += recorded.n_steps;
            n_episodes += 1;
            events.iter_mut().zip(&recorded.events).for_each(|(sum, n)| *sum += n);
            meter.line(&format!(
                "episode {}: {} steps, return {:.0}{}",
                recorded.k,
                recorded.n_steps,
                recorded.ret,
                shares(&names, &recorded.events, recorded.n_steps)
            ));
            // Those that the dataset has already are passed over.
            let done = (recorded.k + 1 - first) as usize;
            meter.at("recording episodes", done, n, String::new);
            ControlFlow::Continue(())
        },
    );
    drop(meter);
    let n_all = dataset.n_episodes();
    let of_each: serde_json::Map<_, _> =
        names.iter().zip(&events).map(|(name, n)| ((*name).to_owned(), serde_json::json!(n))).collect();
    let told = serde_json::json!({
        "folder": options.out, "episodes": n_episodes, "steps": n_steps, "event_steps": of_each, "episodes_in_all": n_all
    });
    options.form.tell(&told, || {
        format!(
            "{n_episodes} episodes of {n_steps} steps recorded{}; {n_all} in all in {:?}",
            shares(&names, &events, n_steps),
            options.out
        )
    })?;
    Ok(recorded?)
}

/// In how many steps each event went on: `, grass 24.1 %`.
fn shares(names: &[&str], events: &[usize], n_steps: usize) -> String {
    let share = |n: usize| 100.0 * n as f64 / n_steps.max(1) as f64;
    let mut text = String::new();
    for (name, n) in names.iter().zip(events) {
        let _ = write!(text, ", {name} {:.1} %", share(*n));
    }
    text
}
