//! `dropj fit-world`.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use dropj::dataset::Dataset;
use dropj::run::{Run, write_whole};
use dropj::world_model::WorldModelConfig;
use dropj::world_model::fit::{FitConfig, Progress, fit_world};

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The folder of recorded episodes
    #[arg(long)]
    data: PathBuf,
    /// The file to write; checkpoints and metrics go into a folder beside it
    #[arg(long)]
    out: PathBuf,
    /// Go on from the last checkpoint
    #[arg(long)]
    resume: bool,
    /// Of initialization, order and noise
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Threads for the arithmetic
    #[arg(long, default_value_t = 2)]
    threads: i32,
    /// The most epochs for vision
    #[arg(long)]
    vae_epochs: Option<usize>,
    /// The most epochs for memory
    #[arg(long)]
    mdn_rnn_epochs: Option<usize>,
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    tch::set_num_threads(options.threads);
    let dataset = Dataset::open(&options.data)?;
    let config = WorldModelConfig::car_racing();
    let mut fit = FitConfig { seed: options.seed, ..FitConfig::car_racing() };
    fit.vae.max_epochs = options.vae_epochs.unwrap_or(fit.vae.max_epochs);
    fit.mdn_rnn.max_epochs = options.mdn_rnn_epochs.unwrap_or(fit.mdn_rnn.max_epochs);
    let run = Run::open(&options.out.with_extension("fit"), options.resume)?;
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
    let parameters = fit_world(&dataset, &config, &fit, &run, &mut report)?;
    write_whole(&options.out, parameters.bytes()).context("the fit is done, but not written")?;
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
