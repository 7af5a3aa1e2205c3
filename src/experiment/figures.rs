//! Figures of an experiment, as vectors and as pixels: a line for each series over an axis, or the episodes of each.

use std::sync::Once;

use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::element::ComposedElement;
use plotters::prelude::*;
use plotters::style::{FontStyle, register_font};

use super::description::{Axis, Description};
use super::summary::{Point, series};
use super::table::{Measure, Rows};
use crate::dataset::png_bytes;
use crate::world::Frame;

/// Pixels of a figure.
pub(super) const SIZE: (u32, u32) = (900, 560);
/// The name under which the font of the window is known to figures.
pub(super) const FONT: &str = "sans-serif";
/// Colors that people who see fewer of them tell apart, too (Okabe and Ito).
pub(super) const COLORS: [RGBColor; 8] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(90, 90, 90),
    RGBColor(150, 110, 60),
];

/// A drawn figure.
#[derive(Clone, Debug)]
pub struct Figure {
    /// That of its files, without their ends.
    pub name: String,
    /// As vectors.
    pub svg: String,
    /// The bytes of a PNG.
    pub png: Vec<u8>,
}

/// Why a figure cannot be drawn.
#[derive(Debug, thiserror::Error)]
#[error("the figure of {what} cannot be drawn: {met}")]
pub struct FigureError {
    what: String,
    met: String,
}

/// A figure of each measure.
///
/// # Errors
/// Where one cannot be drawn.
pub fn figures(description: &Description, rows: &Rows) -> Result<Vec<Figure>, FigureError> {
    rows.measures().iter().map(|measure| figure(description, rows, measure)).collect()
}

fn figure(description: &Description, rows: &Rows, measure: &Measure) -> Result<Figure, FigureError> {
    let all = series(description, rows, measure);
    let names = all.iter().enumerate().map(|(i, (name, points))| (i, name.as_str(), &points[..])).collect();
    let of = Drawn { title: &description.title, axis: description.axis, measure, all: names };
    drawn(&measure.slug(), &of)
}

/// What a figure of series shows.
pub(super) struct Drawn<'a> {
    pub title: &'a str,
    pub axis: Axis,
    pub measure: &'a Measure,
    /// The number of its color and mark, its name and its points.
    pub all: Vec<(usize, &'a str, &'a [Point])>,
}

/// Something that is drawn as vectors and as pixels.
pub(super) trait Draw {
    /// What it is of.
    fn what(&self) -> String;

    /// Draws it.
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), String>;
}

impl Draw for Drawn<'_> {
    fn what(&self) -> String {
        self.measure.title()
    }

    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), String> {
        if self.axis == Axis::Variants { bars(area, self) } else { lines(area, self) }
    }
}

/// Draws `of`, whose files are called `name`.
pub(super) fn drawn(name: &str, of: &impl Draw) -> Result<Figure, FigureError> {
    let failed = |met: String| FigureError { what: of.what(), met };
    // Vectors name the font, and ask how wide its letters are.
    with_font();
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        area.fill(&WHITE).map_err(said).and_then(|()| of.draw(&area)).map_err(failed)?;
    }
    let mut pixels = vec![0; (SIZE.0 * SIZE.1 * 3) as usize];
    {
        let area = BitMapBackend::with_buffer(&mut pixels, SIZE).into_drawing_area();
        area.fill(&WHITE).map_err(said).and_then(|()| of.draw(&area)).map_err(failed)?;
    }
    let png = png_bytes(&Frame::new(SIZE.1, SIZE.0, pixels));
    Ok(Figure { name: name.to_owned(), svg, png })
}

/// Makes letters known: no font of the system is asked for.
fn with_font() {
    static KNOWN: Once = Once::new();
    KNOWN.call_once(|| {
        for style in [FontStyle::Normal, FontStyle::Bold] {
            if register_font(FONT, style, epaint_default_fonts::UBUNTU_LIGHT).is_err() {
                log::warn!("the font of figures cannot be read");
            }
        }
    });
}

/// Values from 0, or below, to above the highest, in percent where they are shares.
pub(super) fn bounds(measure: &Measure, values: impl Iterator<Item = f64>) -> (f64, f64, f64) {
    let scale = if measure.is_share() { 100.0 } else { 1.0 };
    let (mut low, mut high) = (0.0f64, f64::EPSILON);
    for value in values {
        (low, high) = (low.min(scale * value), high.max(scale * value));
    }
    (scale, if low < 0.0 { low * 1.05 } else { 0.0 }, if high < 1e-6 { 1.0 } else { high * 1.08 })
}

impl Axis {
    /// What a figure says under it.
    pub fn in_words(self) -> &'static str {
        match self {
            Self::Answers => "answers",
            Self::Minutes => "minutes of feedback",
            Self::CriticalMistakes => "wrong answers to critical queries (%)",
            Self::Variants => "",
        }
    }
}

/// A number at an axis, with no more digits than it has.
#[expect(clippy::trivially_copy_pass_by_ref, reason = "axes ask so")]
pub(super) fn number(value: &f64) -> String {
    let text = format!("{value:.2}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

pub(super) fn label(measure: &Measure) -> String {
    if measure.is_share() { format!("{} (%)", measure.title()) } else { measure.title() }
}

/// A line a series with the interval of its mean, and a point for each seed.
fn lines<B: DrawingBackend>(area: &DrawingArea<B, Shift>, of: &Drawn<'_>) -> Result<(), String> {
    let Drawn { title, axis, measure, all } = of;
    let points = || all.iter().flat_map(|(.., points)| *points);
    let (scale, low, high) =
        bounds(measure, points().flat_map(|p| p.of_seeds.iter().chain(&p.mean)).copied());
    let right = points().map(|point| point.x).fold(1.0, f64::max);
    let mut chart = ChartBuilder::on(area)
        .caption(title, (FONT, 19))
        .margin(14)
        .x_label_area_size(46)
        .y_label_area_size(70)
        .build_cartesian_2d(0.0..right * 1.03, low..high)
        .map_err(said)?;
    grid(&mut chart, axis.in_words(), &label(measure))?;
    for &(i, name, points) in all {
        let color = COLORS[i % COLORS.len()];
        let upper = points.iter().map(|p| (p.x, scale * p.mean[2]));
        let lower = points.iter().rev().map(|p| (p.x, scale * p.mean[1]));
        let band: Vec<_> = upper.chain(lower).collect();
        chart.draw_series([Polygon::new(band, color.mix(0.15))]).map_err(said)?;
        let line = LineSeries::new(points.iter().map(|p| (p.x, scale * p.mean[0])), color.stroke_width(2));
        let drawn = chart.draw_series(line).map_err(said)?;
        drawn.label(name).legend(move |at| mark_in_legend(i, at, color.filled()));
        let of_seeds = points.iter().flat_map(|p| p.of_seeds.iter().map(|value| (p.x, scale * value)));
        chart.draw_series(of_seeds.map(|at| mark(i, at, 4, color.mix(0.8).filled()))).map_err(said)?;
    }
    legend(&mut chart)?;
    area.present().map_err(said)
}

/// The mean of each series with its interval, and a point for each seed.
fn bars<B: DrawingBackend>(area: &DrawingArea<B, Shift>, of: &Drawn<'_>) -> Result<(), String> {
    let Drawn { title, measure, all, .. } = of;
    let points = || all.iter().flat_map(|(.., points)| *points);
    let (scale, low, high) =
        bounds(measure, points().flat_map(|p| p.of_seeds.iter().chain(&p.mean)).copied());
    let mut chart = ChartBuilder::on(area)
        .caption(title, (FONT, 19))
        .margin(14)
        .x_label_area_size(20)
        .y_label_area_size(70)
        .build_cartesian_2d(-0.6..all.len() as f64 - 0.4, low..high)
        .map_err(said)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .x_labels(0)
        .y_label_formatter(&number)
        .y_desc(label(measure))
        .label_style((FONT, 14))
        .axis_desc_style((FONT, 16))
        .max_light_lines(0)
        .bold_line_style(BLACK.mix(0.12))
        .draw()
        .map_err(said)?;
    for (place, &(i, name, points)) in all.iter().enumerate() {
        let color = COLORS[i % COLORS.len()];
        for point in points {
            let x = place as f64;
            let [mean, from, to] = point.mean.map(|value| scale * value);
            let bar =
                Rectangle::new([(x - 0.28, 0.0f64.max(low)), (x + 0.28, mean)], color.mix(0.35).filled());
            let drawn = chart.draw_series([bar]).map_err(said)?;
            drawn
                .label(name)
                .legend(move |(x, y)| Rectangle::new([(x, y - 5), (x + 14, y + 5)], color.mix(0.6).filled()));
            let whisker = PathElement::new([(x, from), (x, to)], color.stroke_width(2));
            chart.draw_series([whisker]).map_err(said)?;
            let n = point.of_seeds.len();
            let of_seeds = point.of_seeds.iter().enumerate().map(|(k, value)| {
                let aside = 0.36 * ((k as f64 + 0.5) / n as f64 - 0.5);
                Circle::new((x + aside, scale * value), 3, color.filled())
            });
            chart.draw_series(of_seeds).map_err(said)?;
        }
    }
    legend(&mut chart)?;
    area.present().map_err(said)
}

pub(super) type Chart<'a, B> = ChartContext<'a, B, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// The outline of a mark by its number, from its middle, in pixels: no two of eight are alike, whoever sees their colors.
pub(super) fn outline(i: usize, r: i32) -> Vec<(i32, i32)> {
    // In quarters of `r`.
    let points: &[(i32, i32)] = match i % COLORS.len() {
        0 => &[(4, 0), (3, 3), (0, 4), (-3, 3), (-4, 0), (-3, -3), (0, -4), (3, -3)],
        1 => &[(-4, -4), (4, -4), (4, 4), (-4, 4)],
        2 => &[(0, -5), (5, 4), (-5, 4)],
        3 => &[(0, -6), (6, 0), (0, 6), (-6, 0)],
        4 => &[(0, 5), (5, -4), (-5, -4)],
        5 => &[
            (-5, -3),
            (-3, -5),
            (0, -2),
            (3, -5),
            (5, -3),
            (2, 0),
            (5, 3),
            (3, 5),
            (0, 2),
            (-3, 5),
            (-5, 3),
            (-2, 0),
        ],
        6 => &[
            (-1, -6),
            (1, -6),
            (1, -1),
            (6, -1),
            (6, 1),
            (1, 1),
            (1, 6),
            (-1, 6),
            (-1, 1),
            (-6, 1),
            (-6, -1),
            (-1, -1),
        ],
        _ => &[(0, -6), (1, -2), (6, -2), (2, 1), (4, 6), (0, 3), (-4, 6), (-2, 1), (-6, -2), (-1, -2)],
    };
    points.iter().map(|(x, y)| (x * r / 4, y * r / 4)).collect()
}

/// A mark at a place of a figure.
pub(super) type Mark<C, B> = ComposedElement<C, B, Polygon<(i32, i32)>, PathElement<(i32, i32)>>;

/// The mark with this number.
pub(super) fn mark<B: DrawingBackend, C>(i: usize, at: C, r: i32, style: ShapeStyle) -> Mark<C, B> {
    let mut around = outline(i, r);
    let inside = Polygon::new(around.clone(), style);
    around.extend(around.first().copied());
    EmptyElement::at(at) + inside + PathElement::new(around, style)
}

/// The same in a legend, left of a name.
pub(super) fn mark_in_legend(i: usize, (x, y): (i32, i32), style: ShapeStyle) -> Polygon<(i32, i32)> {
    let points: Vec<_> = outline(i, 4).into_iter().map(|(right, down)| (x + 9 + right, y + down)).collect();
    Polygon::new(points, style)
}

pub(super) fn grid<B: DrawingBackend>(chart: &mut Chart<'_, B>, x: &str, y: &str) -> Result<(), String> {
    chart
        .configure_mesh()
        .x_desc(x)
        .y_desc(y)
        .x_label_formatter(&number)
        .y_label_formatter(&number)
        .label_style((FONT, 14))
        .axis_desc_style((FONT, 16))
        .max_light_lines(0)
        .bold_line_style(BLACK.mix(0.12))
        .draw()
        .map_err(said)
}

pub(super) fn legend<'a, B: DrawingBackend + 'a>(chart: &mut Chart<'a, B>) -> Result<(), String> {
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .label_font((FONT, 14))
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.3))
        .draw()
        .map_err(said)
}

pub(super) fn said(met: impl std::fmt::Display) -> String {
    met.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::named;
    use crate::experiment::table::made_up::rows;

    #[test]
    fn every_measure_is_drawn_with_its_series_over_either_axis() {
        for axis in [Axis::Answers, Axis::Minutes, Axis::Variants] {
            let description = Description { axis, ..named("q3-justifications").unwrap() };
            let drawn = figures(&description, &rows()).unwrap();
            let names: Vec<_> = drawn.iter().map(|figure| figure.name.as_str()).collect();
            assert_eq!(names, ["return", "unsafe", "bump_rate"]);
            for Figure { svg, png, .. } in &drawn {
                assert!(
                    svg.starts_with("<svg") && svg.contains("DROPJ") && svg.trim_end().ends_with("</svg>")
                );
                let picture = image::load_from_memory(png).unwrap().into_rgb8();
                assert_eq!(picture.dimensions(), SIZE);
                let n_colors = picture.pixels().collect::<std::collections::HashSet<_>>().len();
                assert!(n_colors > 20, "letters and lines: {n_colors} colors");
            }
        }
    }
}
