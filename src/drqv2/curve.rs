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
    let optional = |value: Option<f32>| value.map_or(String::new(), |value| value.to_string());

    let events = names(&mut finished.iter().flat_map(|one| one.events.keys()));
    let mut training =
        "episode,steps,updates,return,episode_steps,noise,critic_loss,value,unsafe_steps".to_owned();
    for event in &events {
        training.extend([",", event]);
    }
    for one in finished {
        let Finished { episode, steps, updates, ret, n_steps, noise, unsafe_steps, .. } = one;
        let (loss, value) = (optional(one.critic_loss), optional(one.value));
        let _ = write!(
            training,
            "\n{episode},{steps},{updates},{ret},{n_steps},{noise},{loss},{value},{unsafe_steps}"
        );
        for event in &events {
            let _ = write!(training, ",{}", one.events.get(event).copied().unwrap_or_default());
        }
    }

    let events = names(&mut evaluated.iter().flat_map(|one| one.events.keys()));
    let mut evaluations = "steps,updates,episodes,return,lowest,highest,unsafe_rate".to_owned();
    for event in &events {
        evaluations.extend([",", event]);
    }
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
    [
        values.iter().copied().fold(f32::INFINITY, f32::min),
        values.iter().copied().fold(f32::NEG_INFINITY, f32::max),
    ]
}

/// What another method reached, to be drawn beside the curve.
#[derive(Clone, Debug, PartialEq)]
pub struct Beside {
    /// What it is called.
    pub name: String,
    /// The mean return of its episodes.
    pub ret: f64,
}

/// The figure, as SVG: above, the return of each episode with noise and the mean of each evaluation without it, with the
/// lowest and highest of its episodes, and a line for each method `beside`; below, unsafe steps in all episodes with noise.
///
/// # Errors
/// Where it cannot be drawn.
pub fn curve(title: &str, records: &[Record], beside: &[Beside]) -> Result<String, FigureError> {
    with_font();
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        draw(&area, title, records, beside).map_err(|met| FigureError::new("DrQ-v2", met))?;
    }
    Ok(svg)
}

fn draw<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    title: &str,
    records: &[Record],
    beside: &[Beside],
) -> Result<(), String> {
    area.fill(&WHITE).map_err(said)?;
    let (finished, evaluated) = apart(records);
    let ends_at = finished.iter().map(|one| one.steps).chain(evaluated.iter().map(|one| one.steps));
    let right = ends_at.max().unwrap_or_default().max(1) as f64 * 1.03;
    let (upper, lower) = area.split_vertically(UPPER);
    draw_returns(&upper, title, right, (&finished, &evaluated), beside)?;
    draw_unsafe(&lower, right, &finished)?;
    area.present().map_err(said)
}

fn draw_returns<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    title: &str,
    right: f64,
    (finished, evaluated): (&[&Finished], &[&Evaluated]),
    beside: &[Beside],
) -> Result<(), String> {
    let (noisy, quiet) = (COLORS[4], COLORS[0]);
    let returns = || finished.iter().map(|one| (one.steps as f64, f64::from(one.ret)));
    let spans = || {
        let span =
            |one: &&Evaluated| (one.steps as f64, ends(&one.returns).map(f64::from), f64::from(one.ret));
        evaluated.iter().map(span)
    };
    let all = returns().map(|(_, y)| y).chain(spans().flat_map(|(_, ends, _)| ends));
    let all = all.chain(beside.iter().map(|one| one.ret));
    let (low, high) = all.fold((0.0f64, 1.0f64), |(low, high), y| (low.min(y), high.max(y)));
    let mut chart = ChartBuilder::on(area)
        .caption(format!("DrQ-v2 in {title}, by its true reward"), (FONT, 19))
        .margin(14)
        .x_label_area_size(46)
        .y_label_area_size(80)
        .build_cartesian_2d(0.0..right, low * 1.08..high * 1.08)
        .map_err(said)?;
    grid(&mut chart, "steps of the world in episodes with noise", "return of an episode")?;
    for (i, one) in beside.iter().enumerate() {
        let color = COLORS[(2 + i) % COLORS.len()];
        let line = PathElement::new([(0.0, one.ret), (right, one.ret)], color.stroke_width(2));
        let drawn = chart.draw_series([line]).map_err(said)?;
        drawn
            .label(&one.name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], color.stroke_width(3)));
    }
    let points = returns().map(|at| Circle::new(at, 2, noisy.filled()));
    let drawn = chart.draw_series(points).map_err(said)?;
    drawn.label("DrQ-v2 while it learns").legend(move |(x, y)| Circle::new((x + 9, y), 3, noisy.filled()));
    let whiskers = spans().map(|(x, [low, high], _)| PathElement::new([(x, low), (x, high)], quiet.mix(0.4)));
    chart.draw_series(whiskers).map_err(said)?;
    let means = LineSeries::new(spans().map(|(x, _, mean)| (x, mean)), quiet.stroke_width(2));
    let drawn = chart.draw_series(means.point_size(3)).map_err(said)?;
    drawn
        .label("DrQ-v2 without noise: mean, lowest, highest")
        .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], quiet.stroke_width(3)));
    legend(&mut chart, SeriesLabelPosition::MiddleLeft)
}

fn draw_unsafe<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    right: f64,
    finished: &[&Finished],
) -> Result<(), String> {
    let most = finished.last().map_or(1, |one| one.unsafe_steps.max(1)) as f64;
    let mut chart = ChartBuilder::on(area)
        .margin(14)
        .x_label_area_size(46)
        .y_label_area_size(80)
        .build_cartesian_2d(0.0..right, 0.0..most * 1.08)
        .map_err(said)?;
    grid(&mut chart, "steps of the world in episodes with noise", "unsafe steps so far")?;
    let sums = finished.iter().map(|one| (one.steps as f64, one.unsafe_steps as f64));
    let line = LineSeries::new(std::iter::once((0.0, 0.0)).chain(sums), COLORS[1].stroke_width(2));
    chart.draw_series(line).map(|_| ()).map_err(said)
}

/// Puts the curve into the folder of the job, as far as it goes.
pub(super) fn write(run: &Run, title: &str, records: &[Record], beside: &[Beside]) -> Result<(), RunError> {
    let [training, evaluations] = tables(records);
    run.write("training.csv", training.as_bytes())?;
    run.write("evaluations.csv", evaluations.as_bytes())?;
    match curve(title, records, beside) {
        Ok(svg) => run.write("curve.svg", svg.as_bytes()),
        // No job ends because its figure cannot be drawn.
        Err(met) => {
            log::warn!("{met}");
            Ok(())
        }
    }
}
