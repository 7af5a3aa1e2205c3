//! `dropj check-world`.

use std::path::PathBuf;

use dropj::dataset::Dataset;
use dropj::evaluation::aligned;
use dropj::evaluation::fidelity::{Fidelity, HORIZON, LEAST, Stretch, fidelity_told};
use dropj::run::{Kind, OutputFile};
use dropj::world::{Frame, Size};
use dropj::world_model::fit::{FitConfig, Split, check_world};

use super::meter::Meter;
use super::models;
use super::numbers::count;
use super::picture::png;
use super::told::Form;

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The folder of recorded episodes that the world model was trained on
    #[arg(long)]
    data: PathBuf,
    /// The world model
    #[arg(long)]
    world: PathBuf,
    /// The seed that the world model was trained with; only for models whose file does not say what was held out
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// None of these recordings was trained on: compare on all of them
    #[arg(long)]
    fresh: bool,
    /// How many stretches of held-out episodes to compare
    #[arg(long, value_parser = count(1..=100_000), default_value_t = 100)]
    stretches: usize,
    /// A picture to write: rows of real, reconstructed and dreamed frames, every fifth step
    #[arg(long)]
    picture: Option<PathBuf>,
    #[command(flatten)]
    form: Form,
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    let picture = options.picture.as_deref().map(|path| OutputFile::at(path, Kind::Picture)).transpose()?;
    let model = models::world_model(&options.world)?;
    let dataset = Dataset::open_as(&options.data, model.spec())?;
    let n = dataset.n_episodes();
    let held_out = if options.fresh {
        (0..n).collect()
    } else {
        model.held_out().unwrap_or_else(|| Split::new(n, FitConfig::full().held_out, options.seed).held_out)
    };
    anyhow::ensure!(
        held_out.iter().all(|&episode| episode < n),
        "the world model was trained on more recordings than the {n} in {:?}: give those, or say with --fresh that none of \
         these is among them",
        options.data
    );
    let (env, seen) = (dataset.env().unwrap_or_default(), model.config().vae.size());
    let shown = dataset.size().unwrap_or(Size { height: 0, width: 0 });
    anyhow::ensure!(
        env == model.config().env && seen == shown,
        "the world model was trained on {:?}, in pictures of {} x {} pixels, and these recordings are of {env:?}, in \
         pictures of {} x {}: give those that it was trained on, not {:?}",
        model.config().env,
        seen.height,
        seen.width,
        shown.height,
        shown.width,
        options.data
    );
    check_world(&dataset, model.config())?;
    let mut meter = Meter::new();
    let told = &mut |done, n| meter.at("comparing stretches", done, n, String::new);
    let (figures, stretches) = fidelity_told(&model, &dataset, &held_out, options.stretches, 0, told)?;
    drop(meter);
    anyhow::ensure!(
        figures.n_stretches > 0,
        "there is nothing to compare: of {} held-out episodes none is longer than the {LEAST} steps that it takes, or \
         --stretches is 0; record more or longer ones, with {:?}",
        held_out.len(),
        options.data
    );
    let told = serde_json::json!({"steps": Fidelity::STEPS, "figures": figures});
    options.form.tell(&told, || in_words(&figures))?;
    if let Some(picture) = picture {
        let drawn = draw(&stretches[..stretches.len().min(3)]);
        picture.write(&png(drawn.as_raw(), drawn.width(), drawn.height())?)?;
    }
    Ok(())
}

/// The same for people: root mean square errors of pixels, intensities in `[0, 1]`.
fn in_words(figures: &Fidelity) -> String {
    let Fidelity { n_stretches, reconstruction, dreamed, imagined, still } = figures;
    let heads = ["after so many steps", "dreamed", "imagined", "a still picture"];
    let mut lines = vec![heads.map(str::to_owned).to_vec()];
    for (i, steps) in Fidelity::STEPS.iter().enumerate() {
        let errors = [dreamed, imagined, still].map(|errors| format!("{:.4}", errors[i]));
        lines.push([vec![steps.to_string()], errors.to_vec()].concat());
    }
    format!(
        "{n_stretches} stretches; errors of pixels, root mean square, of intensities from 0 to 1\nreconstructed: \
         {reconstruction:.4}\n{}",
        aligned(&lines)
    )
}

/// Three rows a stretch, every fifth step.
fn draw(stretches: &[Stretch]) -> image::RgbImage {
    const GAP: u32 = 4;
    let Size { height: rows, width: columns } =
        stretches.first().map_or(Size { height: 1, width: 1 }, |stretch| stretch.real[0].size());
    let (n_columns, n_rows) = ((HORIZON / 5 + 1) as u32, 3 * stretches.len() as u32);
    let (width, height) =
        (n_columns * (columns + GAP) + GAP, n_rows * (rows + GAP) + GAP * (1 + stretches.len() as u32));
    let mut picture = image::RgbImage::from_pixel(width, height, image::Rgb([255; 3]));
    let all = stretches.iter().flat_map(|s| [&s.real, &s.reconstructed, &s.dreamed]);
    for (row, frames) in (0..).zip(all) {
        let y = GAP + row * (rows + GAP) + row / 3 * GAP;
        for (column, frame) in (0..).zip(frames.iter().step_by(5)) {
            paste(&mut picture, frame, GAP + column * (columns + GAP), y);
        }
    }
    picture
}

fn paste(picture: &mut image::RgbImage, frame: &Frame, left: u32, top: u32) {
    for (i, rgb) in (0..).zip(frame.rgb().as_chunks::<3>().0) {
        picture.put_pixel(left + i % frame.width(), top + i / frame.width(), image::Rgb(*rgb));
    }
}
