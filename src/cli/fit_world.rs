//! `dropj fit-world`.

use std::ops::ControlFlow;
use std::path::PathBuf;

use anyhow::Context as _;
use dropj::planner::with_snippets;
use dropj::run::{Kind, OutputFile, Run};
use dropj::tensor::DeviceChoice;
use dropj::worker::read_ahead;
use dropj::world_model::WorldModelConfig;
use dropj::world_model::fit::{self, FitConfig, FitRecord, Means, Progress, Stage, fit_world_with};

use super::choices::{Precision, backend};
use super::chosen_world::{ChosenWorld, chosen_world, recordings};
use super::meter::Meter;
use super::models::world_model;
use super::numbers::{count, number};
use super::run_file::{MAX_WHOLE, RunFile};
use super::told::Form;

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The folder of recorded episodes
    #[arg(long)]
    data: PathBuf,
    /// The file to write; checkpoints and metrics go into a folder beside it, called as the file with .fit behind
    #[arg(long)]
    out: PathBuf,
    /// The world that was recorded: its name, if it is built in, or its file; if not given, the name in the recordings
    #[arg(long, value_name = "NAME|FILE", value_parser = chosen_world)]
    env: Option<ChosenWorld>,
    /// The networks' sizes; if not given, what suits the world on this kind of machine
    #[arg(long, value_enum)]
    preset: Option<Preset>,
    /// Fit as this world model was fitted: its networks, and the settings where its file tells them
    #[arg(long, value_name = "FILE", conflicts_with = "preset")]
    like: Option<PathBuf>,
    /// Go on from the last checkpoint
    #[arg(long)]
    resume: bool,
    /// How each number of the file is stored
    #[arg(long, value_enum, default_value = "f32")]
    dtype: Precision,
    /// Of initialization, order and noise [default: 0]
    #[arg(long)]
    seed: Option<u64>,
    /// On what to compute: auto (an accelerator, if there is one), cpu, cuda, cuda:N or mps
    #[arg(long, default_value = "auto")]
    device: DeviceChoice,
    /// Threads for the arithmetic on the processor
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
    #[command(flatten)]
    form: Form,
    #[command(flatten)]
    pub(crate) run_file: RunFile,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub(crate) enum Preset {
    /// The paper's for Car Racing: frames of 84 pixels, 3.8 million parameters
    CarRacing,
    /// The paper's for Obstacle Car Racing: frames of 128 pixels, 31 million parameters
    ObstacleCarRacing,
    /// Smaller ones for Obstacle Car Racing: 2.8 million parameters
    ObstacleCompact,
}

impl Preset {
    pub(crate) fn config(self) -> WorldModelConfig {
        match self {
            Self::CarRacing => WorldModelConfig::car_racing(),
            Self::ObstacleCarRacing => WorldModelConfig::obstacle_car_racing(),
            Self::ObstacleCompact => WorldModelConfig::obstacle_compact(),
        }
    }
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    tch::set_num_threads(options.threads);
    let (dataset, spec) = recordings(&options.data, options.env.as_ref())?;
    for damaged in dataset.damaged() {
        eprintln!("left out: {damaged}");
    }
    let suited = || WorldModelConfig::for_world(&spec);
    let like = options.like.as_deref().map(world_model).transpose()?;
    let base = match (&like, options.preset) {
        (Some(model), _) => model.config().clone().of_world(&spec),
        (None, Some(preset)) => preset.config().of_world(&spec),
        (None, None) => suited(),
    };
    let record = like.as_ref().and_then(|model| FitRecord::of(model.parameters()));
    if like.is_some() && record.is_none() {
        eprintln!(
            "the file of that world model does not tell how it was fitted: the settings are the usual ones"
        );
    }
    let usual = record.map_or_else(|| FitConfig::for_world(&spec), |record| record.settings);
    let config = options.run_file.over("networks", &base, WorldModelConfig::check)?;
    let mut config = config.of_world(&spec);
    config.vae.emphasis = options.emphasis.unwrap_or(config.vae.emphasis);
    fit::check_world(&dataset, &config)?;
    let mut settings = options.run_file.over("fit", &usual, FitConfig::check)?;
    settings.seed = options.seed.unwrap_or(settings.seed);
    settings.vae.max_epochs = options.vae_epochs.unwrap_or(settings.vae.max_epochs);
    settings.mdn_rnn.max_epochs = options.mdn_rnn_epochs.unwrap_or(settings.mdn_rnn.max_epochs);
    if let Some(all) = options.run_file.to_print() {
        // A larger seed stands among the options, as text.
        let settings = FitConfig { seed: settings.seed.min(MAX_WHOLE), ..settings };
        print!("{}", all.with("networks", &config).with("fit", &settings).to_toml());
        return Ok(());
    }
    fit::check(&dataset)?;
    let means = Means { backend: backend(options.device)?, read: &read_ahead };
    let out = OutputFile::at(&options.out, Kind::Network)?;
    let run = Run::beside(&options.out, options.resume)?;
    let mut meter = Meter::new();
    let mut report = |progress: &Progress| {
        say(&mut meter, progress);
        ControlFlow::Continue(())
    };
    let parameters = fit_world_with(means, &dataset, &config, &settings, &run, &mut report)?;
    drop(meter);
    let mut meter = Meter::new();
    let parameters = with_snippets(parameters, &dataset, &mut |done, n| {
        meter.at("looking at what was done", done, n, String::new);
        ControlFlow::Continue(())
    })?;
    drop(meter);
    let parameters = parameters.context("nobody broke off")?;
    let parameters = options.dtype.store(&parameters)?;
    let hint = "the fit is done, but not written; with `--resume` nothing is fitted anew";
    out.write(parameters.bytes()).context(hint)?;
    options.form.tell(&serde_json::json!({"file": options.out, "hash": parameters.hash()}), || {
        format!("wrote {:?}, {}", options.out, parameters.hash())
    })
}

fn say(meter: &mut Meter, progress: &Progress) {
    let &Progress { stage, epoch, max_epochs, done, n, loss, held_out, learning_rate, is_best, .. } =
        progress;
    let what = match stage {
        Stage::Vae => "vision",
        Stage::Encode => "encoding",
        Stage::MdnRnn => "memory",
    };
    if let Some(held_out) = held_out {
        let best = if is_best { " (best)" } else { "" };
        meter.line(&format!(
            "{what}, epoch {epoch} of {max_epochs}: loss {loss:.4}, held out {held_out:.4}{best}; rate {learning_rate:.1e}"
        ));
    }
    // An epoch that is over counts among the epochs.
    let in_epoch = if held_out.is_some() { 0 } else { done };
    meter.at(what, epoch * n + in_epoch, max_epochs * n, || {
        let epoch = (epoch + 1).min(max_epochs);
        format!("epoch {epoch} of at most {max_epochs}, loss {loss:.4}, rate {learning_rate:.1e}")
    });
}
