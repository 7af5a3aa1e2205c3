//! The curve of learning: returns and unsafe steps over steps of the world, as tables and as a figure.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use plotters::coord::Shift;
use plotters::prelude::*;

use super::{Evaluated, Finished, Record};
use crate::experiment::charts::{COLORS, FONT, FigureError, grid, legend, said, with_font};
use crate::run::{Run, RunError};

/// Pixels of the figure.
const SIZE: (u32, u32) = (900, 760);
/// Of these, the rows of the upper panel.
const UPPER: u32 = 430;

/// Episodes that were driven to learn, and evaluations.
fn apart(records: &[Record]) -> (Vec<&Finished>, Vec<&Evaluated>) {
    let (mut finished, mut evaluated) = (Vec::new(), Vec::new());
    for record in records {
        match record {
            Record::Episode(one) => finished.push(one),
            Record::Evaluation(one) => evaluated.push(one),
        }
    }
    (finished, evaluated)
}

/// Two tables, with commas: a line an episode that was driven to learn, and a line an evaluation.
pub fn tables(records: &[Record]) -> [String; 2] {
    let (finished, evaluated) = apart(records);
    let names = |all: &mut dyn Iterator<Item = &String>| all.cloned().collect::<BTreeSet<_>>();
    let optional = |value: Option<f64>| value.map_or(String::new(), |value| value.to_string());

    let events = names(&mut finished.iter().flat_map(|one| one.events.keys()));
    let mut training = "episode,steps,updates,return,episode_steps,noise,critic_loss,value,unsafe_steps".to_owned();
    events.iter().for_each(|event| training.extend([",", event]));
    for one in finished {
        let Finished { episode, steps, updates, ret, n_steps, noise, unsafe_steps, .. } = one;
        let (loss, value) = (optional(one.critic_loss), optional(one.value));
        let _ = write!(training, "\n{episode},{steps},{updates},{ret},{n_steps},{noise},{loss},{value},{unsafe_steps}");
        for event in &events {
            let _ = write!(training, ",{}", one.events.get(event).copied().unwrap_or_default());
        }
    }

    let events = names(&mut evaluated.iter().flat_map(|one| one.events.keys()));
    let mut evaluations = "steps,updates,episodes,return,lowest,highest,unsafe_rate".to_owned();
    events.iter().for_each(|event| evaluations.extend([",", event]));
    for one in evaluated {
        let Evaluated { steps, updates, returns, ret, unsafe_rate, .. } = one;
        let [low, high] = ends(returns);
        let _ = write!(evaluations, "\n{steps},{updates},{},{ret},{low},{high},{unsafe_rate}", returns.len());
        for event in &events {
            let _ = write!(evaluations, ",{}", optional(one.events.get(event).copied()));
        }
    }
    [training, evaluations].map(|table| table + "\n")
}

/// The lowest and the highest.
fn ends(values: &[f32]) -> [f32; 2] {
    [values.iter().copied().fold(f32::INFINITY, f32::min), values.iter().copied().fold(f32::NEG_INFINITY, f32::max)]
}

/// The figure, as SVG: above, the return of each episode with noise and the mean of each evaluation without it, with the
/// lowest and highest of its episodes; below, unsafe steps in all episodes with noise.
///
/// # Errors
/// Where it cannot be drawn.
pub fn curve(title: &str, records: &[Record]) -> Result<String, FigureError> {
    with_font();
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        draw(&area, title, records).map_err(|met| FigureError::new("DrQ-v2", met))?;
    }
    Ok(svg)
}

fn draw<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    title: &str,
    records: &[Record],
) -> Result<(), String> {
    area.fill(&WHITE).map_err(said)?;
    let (finished, evaluated) = apart(records);
    let ends_at = finished.iter().map(|one| one.steps).chain(evaluated.iter().map(|one| one.steps));
    let right = ends_at.max().unwrap_or_default().max(1) as f64 * 1.03;
    let (upper, lower) = area.split_vertically(UPPER);
    let [noisy, quiet, harm] = [COLORS[4], COLORS[0], COLORS[1]];

    let returns = || finished.iter().map(|one| (one.steps as f64, f64::from(one.ret)));
    let spans = || {
        let span = |one: &&Evaluated| (one.steps as f64, ends(&one.returns).map(f64::from), one.ret);
        evaluated.iter().map(span)
    };
    let all = returns().map(|(_, y)| y).chain(spans().flat_map(|(_, ends, _)| ends));
    let (low, high) = all.fold((0.0f64, 1.0f64), |(low, high), y| (low.min(y), high.max(y)));
    let mut chart = ChartBuilder::on(&upper)
        .caption(format!("DrQ-v2 in {title}, by its true reward"), (FONT, 19))
        .margin(14)
        .x_label_area_size(46)
        .y_label_area_size(80)
        .build_cartesian_2d(0.0..right, low * 1.08..high * 1.08)
        .map_err(said)?;
    grid(&mut chart, "steps of the world in episodes with noise", "return of an episode")?;
    let points = returns().map(|at| Circle::new(at, 2, noisy.filled()));
    let drawn = chart.draw_series(points).map_err(said)?;
    drawn.label("while it learns").legend(move |at| Circle::new((at.0 + 9, at.1), 3, noisy.filled()));
    let whiskers = spans().map(|(x, [low, high], _)| PathElement::new([(x, low), (x, high)], quiet.mix(0.4)));
    chart.draw_series(whiskers).map_err(said)?;
    let means = LineSeries::new(spans().map(|(x, _, mean)| (x, mean)), quiet.stroke_width(2));
    let drawn = chart.draw_series(means.point_size(3)).map_err(said)?;
    drawn
        .label("evaluated without noise: mean, lowest, highest")
        .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], quiet.stroke_width(3)));
    legend(&mut chart, SeriesLabelPosition::UpperLeft)?;

    let most = finished.last().map_or(1, |one| one.unsafe_steps.max(1)) as f64;
    let mut chart = ChartBuilder::on(&lower)
        .margin(14)
        .x_label_area_size(46)
        .y_label_area_size(80)
        .build_cartesian_2d(0.0..right, 0.0..most * 1.08)
        .map_err(said)?;
    grid(&mut chart, "steps of the world in episodes with noise", "unsafe steps so far")?;
    let sums = finished.iter().map(|one| (one.steps as f64, one.unsafe_steps as f64));
    let line = LineSeries::new(std::iter::once((0.0, 0.0)).chain(sums), harm.stroke_width(2));
    chart.draw_series(line).map_err(said)?;
    area.present().map_err(said)
}

/// Puts the curve into the folder of the job, as far as it goes.
pub(super) fn write(run: &Run, title: &str, records: &[Record]) -> Result<(), RunError> {
    let [training, evaluations] = tables(records);
    run.write("training.csv", training.as_bytes())?;
    run.write("evaluations.csv", evaluations.as_bytes())?;
    match curve(title, records) {
        Ok(svg) => run.write("curve.svg", svg.as_bytes()),
        // No job ends because its figure cannot be drawn.
        Err(met) => {
            log::warn!("{met}");
            Ok(())
        }
    }
}
