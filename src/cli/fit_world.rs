//! `dropj fit-world`.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use dropj::dataset::Dataset;
use dropj::run::{Kind, OutputFile, Run};
use dropj::world_model::WorldModelConfig;
use dropj::world_model::fit::{self, FitConfig, Progress, fit_world};

use super::EnvName;
use super::convert::Precision;
use super::numbers::{count, number};

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The folder of recorded episodes
    #[arg(long)]
    data: PathBuf,
    /// The file to write; checkpoints and metrics go into a folder beside it, called as the file with .fit behind
    #[arg(long)]
    out: PathBuf,
    /// The networks' sizes; if not given, what suits the recorded world on this kind of machine
    #[arg(long, value_enum)]
    preset: Option<Preset>,
    /// Go on from the last checkpoint
    #[arg(long)]
    resume: bool,
    /// How each number of the file is stored
    #[arg(long, value_enum, default_value = "f32")]
    dtype: Precision,
    /// Of initialization, order and noise
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Threads for the arithmetic
    #[arg(long, value_parser = clap::value_parser!(i32).range(1..=1024), default_value_t = 2)]
    threads: i32,
    /// How many times more the bluest and yellowest pixels count for vision; the preset's if not given
    #[arg(long, value_parser = number(0.0..=1000.0))]
    emphasis: Option<f64>,
    /// The most epochs for vision
    #[arg(long, value_parser = count(1..=1_000_000))]
    vae_epochs: Option<usize>,
    /// The most epochs for memory
    #[arg(long, value_parser = count(1..=1_000_000))]
    mdn_rnn_epochs: Option<usize>,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Preset {
    /// The paper's for Car Racing: frames of 84 pixels, 3.8 million parameters
    CarRacing,
    /// The paper's for Obstacle Car Racing: frames of 128 pixels, 31 million parameters
    ObstacleCarRacing,
    /// Smaller ones for Obstacle Car Racing: 2.8 million parameters
    ObstacleCompact,
}

impl Preset {
    fn config(self) -> WorldModelConfig {
        match self {
            Self::CarRacing => WorldModelConfig::car_racing(),
            Self::ObstacleCarRacing => WorldModelConfig::obstacle_car_racing(),
            Self::ObstacleCompact => WorldModelConfig::obstacle_compact(),
        }
    }
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    tch::set_num_threads(options.threads);
    let dataset = Dataset::open(&options.data)?;
    for damaged in dataset.damaged() {
        eprintln!("left out: {damaged}");
    }
    let env = dataset.env().unwrap_or_default();
    let suited = if env == EnvName::CarRacing.name() { Preset::CarRacing } else { Preset::ObstacleCompact };
    let mut config = WorldModelConfig { env: env.to_owned(), ..options.preset.unwrap_or(suited).config() };
    config.vae.emphasis = options.emphasis.unwrap_or(config.vae.emphasis);
    anyhow::ensure!(
        dataset.side().map(i64::from) == Some(config.vae.side),
        "these networks see frames of {0} x {0} pixels, and those of the recordings are others; \
         choose another --preset",
        config.vae.side
    );
    let mut settings = FitConfig { seed: options.seed, ..FitConfig::full() };
    settings.vae.max_epochs = options.vae_epochs.unwrap_or(settings.vae.max_epochs);
    settings.mdn_rnn.max_epochs = options.mdn_rnn_epochs.unwrap_or(settings.mdn_rnn.max_epochs);
    fit::check(&dataset)?;
    let out = OutputFile::at(&options.out, Kind::Network)?;
    let run = Run::beside(&options.out, options.resume)?;
    let (mut epoch_start, mut said) = (Instant::now(), Instant::now());
    let mut report = |progress: &Progress| {
        if progress.held_out.is_some() || said.elapsed() > Duration::from_secs(20) {
            said = Instant::now();
            say(progress, epoch_start.elapsed());
        }
        if progress.done == progress.n {
            epoch_start = Instant::now();
        }
        ControlFlow::Continue(())
    };
    let parameters = fit_world(&dataset, &config, &settings, &run, &mut report)?;
    let parameters = options.dtype.store(&parameters)?;
    let hint = "the fit is done, but not written; with `--resume` nothing is fitted anew";
    out.write(parameters.bytes()).context(hint)?;
    println!("wrote {:?}, {}", options.out, parameters.hash());
    Ok(())
}

fn say(progress: &Progress, elapsed: Duration) {
    let Progress { stage, epoch, max_epochs, done, n, items, loss, held_out, learning_rate, is_best } =
        progress;
    let rate = (done * items) as f64 / elapsed.as_secs_f64();
    let left = (max_epochs - epoch) * n - if held_out.is_some() { 0 } else { *done };
    let eta_mins = elapsed.as_secs_f64() / (*done).max(1) as f64 * left as f64 / 60.0;
    let held_out = held_out.map_or(String::new(), |loss| {
        format!(", held out {loss:.4}{}", if *is_best { " (best)" } else { "" })
    });
    eprintln!(
        "{stage:?} epoch {epoch}/{max_epochs}, {done}/{n}: loss {loss:.4}{held_out}; rate {learning_rate:.1e}, \
         {rate:.0}/s, at most {eta_mins:.0} min left"
    );
}
