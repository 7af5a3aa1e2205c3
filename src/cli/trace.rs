//! `dropj trace`.

use std::path::PathBuf;

use anyhow::Context as _;
use dropj::run::{Kind, OutputFile};
use dropj::world::NAMES;
use dropj::world::cars::trace::{COLUMNS, Row, Traced, trace};
use dropj::world::cars::{Aids, CarRacing, ObstacleCarRacing, Obstacles, Seed};

use super::choices::Switch;
use super::meter::Meter;
use super::picture::png;
use super::told::Form;

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The world to drive in
    #[arg(long, value_parser = NAMES, default_value = "car-racing")]
    env: String,
    /// What `env.seed` of gym 0.20 was given
    #[arg(long)]
    gym_seed: u64,
    /// What Python's `random.seed` was given: it places the chuckholes
    #[arg(long, default_value_t = 0)]
    python_seed: u64,
    /// The driving aids of the paper's evaluation, where there are obstacles
    #[arg(long, value_enum, default_value = "on")]
    aids: Switch,
    /// A table whose first three columns are steer, gas and brake
    #[arg(long)]
    actions: PathBuf,
    /// A folder for the pictures, one PNG a step
    #[arg(long)]
    frames: Option<PathBuf>,
    #[command(flatten)]
    form: Form,
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    let bytes = std::fs::read(&options.actions)
        .with_context(|| format!("cannot read the actions {:?}", options.actions))?;
    let actions = parse(&dropj::text::decoded(&bytes))
        .with_context(|| format!("in the actions {:?}", options.actions))?;
    let seed = Seed::Gym { env: options.gym_seed, python: options.python_seed };
    let aids = if options.aids.is_on() { Aids::ALL } else { Aids::NONE };
    let mut env: Box<dyn Traced> = match options.env.as_str() {
        "obstacle-car-racing" => Box::new(ObstacleCarRacing::new(seed, Obstacles::ChuckholesAndCars, aids)),
        "obstacle-car-racing-chuckholes" => {
            Box::new(ObstacleCarRacing::new(seed, Obstacles::Chuckholes, aids))
        }
        _ => Box::new(CarRacing::new(seed)),
    };
    // The state before the first action is drawn, too.
    let names = (0..=actions.len()).map(|step| format!("step{step:04}.png"));
    let pictures = options.frames.as_deref().map(|dir| OutputFile::all_in(dir, names, Kind::Picture));
    let mut pictures = pictures.transpose()?.unwrap_or_default().into_iter();
    let (mut failed, mut meter) = (None, Meter::new());
    let rows = trace(&mut *env, seed, &actions, |step, env| {
        meter.at("steps", step, actions.len(), String::new);
        if let Some(picture) = pictures.next()
            && let Err(error) = save(picture, &env.raw_image())
        {
            failed.get_or_insert(error);
        }
    });
    drop(meter);
    let values: Vec<_> = rows.iter().map(Row::values).collect();
    options.form.tell(&serde_json::json!({"columns": COLUMNS, "rows": values}), || {
        rows.iter().map(|row| row.to_csv() + "\n").collect()
    })?;
    failed.map_or(Ok(()), Err)
}

/// Writes a square picture.
fn save(picture: OutputFile, rgb: &[u8]) -> anyhow::Result<()> {
    let side = (rgb.len() / 3).isqrt() as u32;
    picture.write(&png(rgb, side, side)?)?;
    Ok(())
}

/// The first three columns of every line; a heading is passed over.
fn parse(text: &str) -> anyhow::Result<Vec<[f64; 3]>> {
    let mut actions = Vec::new();
    for (i, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        let numbers: Vec<_> = line.split(',').take(3).map(|cell| cell.trim().parse::<f64>()).collect();
        match numbers.as_slice() {
            [Ok(steer), Ok(gas), Ok(brake)] if [steer, gas, brake].iter().all(|x| x.is_finite()) => {
                actions.push([*steer, *gas, *brake]);
            }
            _ if i == 0 => {}
            _ => anyhow::bail!(
                "line {} does not begin with three numbers: {}",
                i + 1,
                dropj::text::shown(line)
            ),
        }
    }
    Ok(actions)
}
