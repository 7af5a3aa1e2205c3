//! `dropj fit-probe`.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use dropj::dataset::Dataset;
use dropj::run::{Kind, OutputFile};
use dropj::simulate::fit_probe::{FitProbeConfig, Phase, Progress, fit_car_probe, fit_event_probe};
use dropj::simulate::probe::Reads;
use dropj::tensor::Parameters;
use dropj::world::cars::{Aids, CarWorld};
use dropj::world_model::WorldModel;

use serde_json::{Value, json};

use super::choices::{Computing, Precision};
use super::chosen_world::{ChosenWorld, chosen_world};
use super::meter::Meter;
use super::models;
use super::numbers::count;
use super::run_file::{MAX_WHOLE, RunFile};
use super::told::Form;

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The world that is looked at, by its name or its file
    #[arg(long, value_name = "NAME|FILE", value_parser = chosen_world, default_value = "car-racing")]
    env: ChosenWorld,
    /// The folder of recorded episodes to fit on; a built-in world drives its own if this is not given [default: data/ and
    /// the world's name]
    #[arg(long)]
    data: Option<PathBuf>,
    /// The world model through whose eyes half of the pictures are seen
    #[arg(long)]
    world: Option<PathBuf>,
    /// The file to write
    #[arg(long)]
    out: PathBuf,
    /// Episodes that are driven to fit on; of recordings, the most that are read
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
    computing: Computing,
    #[command(flatten)]
    form: Form,
    #[command(flatten)]
    pub(crate) run_file: RunFile,
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    tch::set_num_threads(1);
    let spec = &options.env.spec;
    let config = match options.data {
        Some(_) => FitProbeConfig::for_recordings(spec),
        None => FitProbeConfig::for_world(spec),
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
    let world = options.env.named_world_model(options.world.as_deref());
    let model = models::world_model(&world)?.on(options.computing.backend()?)?;
    models::require(&model, &options.env)?;
    let out = OutputFile::at(&options.out, Kind::Network)?;
    let (parameters, said, errors) = match config.probe.reads {
        Reads::Car { .. } => drive(&config, options, &model)?,
        Reads::Events(_) => learn_recorded(&config, options, &model)?,
    };
    let parameters = options.dtype.store(&parameters)?;
    out.write(parameters.bytes())?;
    let told = json!({"file": options.out, "hash": parameters.hash(), "errors": errors});
    options.form.tell(&told, || format!("{said}\nwrote {:?}, {}", options.out, parameters.hash()))
}

/// Fits the probe of a built-in car; what came of it in words.
fn drive(
    config: &FitProbeConfig,
    options: &Options,
    model: &WorldModel,
) -> anyhow::Result<(Parameters, String, Value)> {
    let name = options.env.spec.source.world.as_deref().unwrap_or(options.env.name());
    let mut world =
        CarWorld::open(name, Aids::NONE).context("there is no such car: give recordings with --data")?;
    let mut meter = Meter::new();
    let fit =
        fit_car_probe(config, world.simulation(), Some(model), &mut |progress| say(&mut meter, progress));
    drop(meter);
    let fit = fit.context("the probe cannot be fitted")?;
    let said =
        format!("held-out real frames: {:.3?}\nseen through the world model: {:.3?}", fit.real, fit.painted);
    let errors = json!({"real": fit.real, "painted": fit.painted});
    Ok((fit.parameters, said, errors))
}

/// Fits the probe of any world on its recordings; what came of it in words.
fn learn_recorded(
    config: &FitProbeConfig,
    options: &Options,
    model: &WorldModel,
) -> anyhow::Result<(Parameters, String, Value)> {
    let usual = || Path::new("data").join(options.env.name());
    let data = options.data.clone().unwrap_or_else(usual);
    let dataset = Dataset::open(&data)
        .context("there are no usable recordings; give some with --data, or make them with `dropj record`")?;
    for damaged in dataset.damaged() {
        eprintln!("left out: {damaged}");
    }
    let mut meter = Meter::new();
    let report = &mut |progress: &Progress| say(&mut meter, progress);
    let fit = fit_event_probe(config, &dataset, &options.env.spec, Some(model), report);
    drop(meter);
    let fit = fit.with_context(|| format!("the probe cannot be fitted on the recordings in {data:?}"))?;
    let mut said = format!("held-out real frames: {}", fit.real);
    if let Some(painted) = &fit.painted {
        said = format!("{said}\nseen through the world model: {painted}");
    }
    let errors = json!({"real": fit.real, "painted": fit.painted});
    Ok((fit.parameters, said, errors))
}

fn say(meter: &mut Meter, progress: &Progress) -> ControlFlow<()> {
    let what = match progress.phase {
        Phase::Drive => "driving",
        Phase::Read => "reading episodes",
        Phase::Paint => "painting",
        Phase::Learn => "learning",
    };
    let loss = || if progress.loss > 0.0 { format!("loss {:.4}", progress.loss) } else { String::new() };
    meter.at(what, progress.done, progress.n, loss);
    ControlFlow::Continue(())
}
