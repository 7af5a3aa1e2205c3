//! Charts as vectors and as pixels: lines with bands, bars with whiskers, and points in the plane.

use std::sync::Once;

use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::element::ComposedElement;
use plotters::prelude::*;
use plotters::style::{FontStyle, register_font};

use crate::dataset::png_bytes;
use crate::world::Frame;

/// Pixels of a figure.
pub(super) const SIZE: (u32, u32) = (900, 560);
/// The name under which the font of the window is known to figures.
pub(crate) const FONT: &str = "sans-serif";
/// Colors that people who see fewer of them tell apart, too (Okabe and Ito).
pub(crate) const COLORS: [RGBColor; 8] = [
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

impl FigureError {
    /// Of the figure of `what`, for what was `met`.
    pub(crate) fn new(what: &str, met: String) -> Self {
        Self { what: what.to_owned(), met }
    }
}

/// A mean at a place of an axis.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Place {
    pub x: f64,
    /// The mean, and the bounds of its interval.
    pub mean: [f64; 3],
    /// What it is the mean of, each drawn as a dot.
    pub of: Vec<f64>,
}

/// A mean along an axis.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Curve {
    /// That of its color and its mark.
    pub number: usize,
    pub name: String,
    pub places: Vec<Place>,
}

/// What stands around a chart.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Words {
    pub caption: String,
    pub x: String,
    pub y: String,
}

/// Something that can be drawn on anything.
pub(super) trait Drawing {
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), String>;
}

/// `drawing` as files of this name.
pub(super) fn drawn(name: String, drawing: &impl Drawing) -> Result<Figure, FigureError> {
    let failed = |met: String| FigureError { what: name.clone(), met };
    // Vectors name the font, and ask how wide its letters are.
    with_font();
    let mut svg = String::new();
    draw(&SVGBackend::with_string(&mut svg, SIZE).into_drawing_area(), drawing).map_err(failed)?;
    let mut pixels = vec![0; (SIZE.0 * SIZE.1 * 3) as usize];
    let area = BitMapBackend::with_buffer(&mut pixels, SIZE).into_drawing_area();
    draw(&area, drawing).map_err(failed)?;
    drop(area);
    let png = png_bytes(&Frame::new(SIZE.1, SIZE.0, pixels));
    Ok(Figure { name, svg, png })
}

fn draw<B: DrawingBackend>(area: &DrawingArea<B, Shift>, drawing: &impl Drawing) -> Result<(), String> {
    area.fill(&WHITE).map_err(said)?;
    drawing.draw(area)?;
    area.present().map_err(said)
}

/// Makes letters known: no font of the system is asked for.
pub(crate) fn with_font() {
    static KNOWN: Once = Once::new();
    KNOWN.call_once(|| {
        for style in [FontStyle::Normal, FontStyle::Bold] {
            if register_font(FONT, style, epaint_default_fonts::UBUNTU_LIGHT).is_err() {
                log::warn!("the font of figures cannot be read");
            }
        }
    });
}

/// From 0, or below, to above the highest, with room for a legend of all curves: it must not hide a mark.
fn bounds(curves: &[Curve]) -> [f64; 2] {
    let (mut low, mut high) = (0.0f64, f64::EPSILON);
    for value in
        curves.iter().flat_map(|curve| &curve.places).flat_map(|place| place.of.iter().chain(&place.mean))
    {
        (low, high) = (low.min(*value), high.max(*value));
    }
    let low = if low < 0.0 { low * 1.05 } else { 0.0 };
    let high = if high < 1e-6 { 1.0 } else { high };
    // A name is 20 pixels high.
    let legend = (20.0 * curves.len() as f64 + 24.0) / f64::from(SIZE.1);
    [low, low + (high - low) / (1.0 - legend.min(0.5))]
}

/// A number at an axis, with no more digits than it has.
#[expect(clippy::trivially_copy_pass_by_ref, reason = "axes ask so")]
fn number(value: &f64) -> String {
    let text = format!("{value:.2}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// A chart over two plain axes.
pub(crate) type Chart<'a, B> = ChartContext<'a, B, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// A chart with its axes, before anything is in it. Where `x` has no words, its axis has no numbers.
pub(super) fn chart<'a, B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    words: &Words,
    [left, right]: [f64; 2],
    [low, high]: [f64; 2],
) -> Result<Chart<'a, B>, String> {
    let has_numbers = !words.x.is_empty();
    let mut chart = ChartBuilder::on(area)
        .caption(&words.caption, (FONT, 19))
        .margin(14)
        .x_label_area_size(if has_numbers { 46 } else { 20 })
        .y_label_area_size(70)
        .build_cartesian_2d(left..right, low..high)
        .map_err(said)?;
    grid(&mut chart, &words.x, &words.y)?;
    Ok(chart)
}

/// The lines and the words of the axes of a chart. Where `x` has no words, its axis has no numbers.
pub(crate) fn grid<B: DrawingBackend>(chart: &mut Chart<'_, B>, x: &str, y: &str) -> Result<(), String> {
    let mut mesh = chart.configure_mesh();
    mesh.y_desc(y)
        .y_label_formatter(&number)
        .x_label_formatter(&number)
        .label_style((FONT, 14))
        .axis_desc_style((FONT, 16))
        .max_light_lines(0)
        .bold_line_style(BLACK.mix(0.12));
    if x.is_empty() {
        mesh.disable_x_mesh().x_labels(0);
    } else {
        mesh.x_desc(x);
    }
    mesh.draw().map_err(said)
}

pub(crate) fn legend<'a, B: DrawingBackend + 'a>(
    chart: &mut Chart<'a, B>,
    position: SeriesLabelPosition,
) -> Result<(), String> {
    chart
        .configure_series_labels()
        .position(position)
        .label_font((FONT, 14))
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.3))
        .draw()
        .map_err(said)
}

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

/// A line a curve with the interval of its mean, and a dot for each value.
pub(super) struct Lines<'a> {
    pub words: &'a Words,
    pub curves: &'a [Curve],
}

impl Drawing for Lines<'_> {
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), String> {
        let places = self.curves.iter().flat_map(|curve| &curve.places);
        let right = places.map(|place| place.x).fold(1.0, f64::max);
        let mut chart = chart(area, self.words, [0.0, right * 1.03], bounds(self.curves))?;
        for Curve { number, name, places } in self.curves {
            let (i, color) = (*number, COLORS[number % COLORS.len()]);
            let upper = places.iter().map(|place| (place.x, place.mean[2]));
            let lower = places.iter().rev().map(|place| (place.x, place.mean[1]));
            let band: Vec<_> = upper.chain(lower).collect();
            chart.draw_series([Polygon::new(band, color.mix(0.15))]).map_err(said)?;
            let line =
                LineSeries::new(places.iter().map(|place| (place.x, place.mean[0])), color.stroke_width(2));
            let drawn = chart.draw_series(line).map_err(said)?;
            drawn.label(name).legend(move |at| mark_in_legend(i, at, color.filled()));
            let dots = places.iter().flat_map(|place| place.of.iter().map(|value| (place.x, *value)));
            chart.draw_series(dots.map(|at| mark(i, at, 4, color.mix(0.8).filled()))).map_err(said)?;
        }
        legend(&mut chart, SeriesLabelPosition::UpperRight)
    }
}

/// A bar a curve, which has one place, with the interval of its mean, and a dot for each value.
pub(super) struct Bars<'a> {
    pub words: &'a Words,
    pub curves: &'a [Curve],
}

impl Drawing for Bars<'_> {
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), String> {
        let [low, high] = bounds(self.curves);
        let mut chart = chart(area, self.words, [-0.6, self.curves.len() as f64 - 0.4], [low, high])?;
        for (i, Curve { number, name, places }) in self.curves.iter().enumerate() {
            let (color, x) = (COLORS[number % COLORS.len()], i as f64);
            for place in places {
                let [mean, from, to] = place.mean;
                let corners = [(x - 0.28, 0.0f64.max(low)), (x + 0.28, mean)];
                let bar = Rectangle::new(corners, color.mix(0.35).filled());
                let drawn = chart.draw_series([bar]).map_err(said)?;
                drawn.label(name).legend(move |(x, y)| {
                    Rectangle::new([(x, y - 5), (x + 14, y + 5)], color.mix(0.6).filled())
                });
                let whisker = PathElement::new([(x, from), (x, to)], color.stroke_width(2));
                chart.draw_series([whisker]).map_err(said)?;
                let n = place.of.len();
                let dots = place.of.iter().enumerate().map(|(k, value)| {
                    let aside = 0.36 * ((k as f64 + 0.5) / n as f64 - 0.5);
                    Circle::new((x + aside, *value), 3, color.filled())
                });
                chart.draw_series(dots).map_err(said)?;
            }
        }
        legend(&mut chart, SeriesLabelPosition::UpperRight)
    }
}

/// Points of the plane in groups, where only their distances mean something.
pub(super) struct Points<'a> {
    pub words: &'a Words,
    pub groups: &'a [(String, Vec<[f64; 2]>)],
}

impl Drawing for Points<'_> {
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), String> {
        let along = |i: usize| {
            let values = self.groups.iter().flat_map(|(_, points)| points.iter().map(move |point| point[i]));
            let (low, high) =
                values.fold((0.0f64, f64::EPSILON), |(low, high), value| (low.min(value), high.max(value)));
            let room = 0.05 * (high - low).max(1e-9);
            [low - room, high + room]
        };
        let mut chart = chart(area, self.words, along(0), along(1))?;
        for (i, (name, points)) in self.groups.iter().enumerate() {
            let color = COLORS[i % COLORS.len()];
            let dots = points.iter().map(|[x, y]| Circle::new((*x, *y), 3, color.mix(0.55).filled()));
            let drawn = chart.draw_series(dots).map_err(said)?;
            drawn.label(name).legend(move |(x, y)| Circle::new((x + 9, y), 4, color.filled()));
        }
        legend(&mut chart, SeriesLabelPosition::UpperRight)
    }
}

pub(crate) fn said(met: impl std::fmt::Display) -> String {
    met.to_string()
}
