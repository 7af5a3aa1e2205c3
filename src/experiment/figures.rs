//! Figures of what was driven: for each measure a line for each series over an axis, or the episodes of each.

use super::charts::{Bars, Curve, Figure, FigureError, Lines, Place, Words, drawn};
use super::description::{Axis, Description};
use super::summary::{Point, series};
use super::table::{Measure, Rows};

/// A figure of each measure.
///
/// # Errors
/// Where one cannot be drawn.
pub fn figures(description: &Description, rows: &Rows) -> Result<Vec<Figure>, FigureError> {
    rows.measures().iter().map(|measure| figure(description, rows, measure)).collect()
}

fn figure(description: &Description, rows: &Rows, measure: &Measure) -> Result<Figure, FigureError> {
    let all = series(description, rows, measure);
    let all = all.iter().enumerate().map(|(i, (name, points))| (i, name.as_str(), &points[..])).collect();
    over(measure.slug(), &Over { title: &description.title, axis: description.axis, measure, all })
}

/// Series of a measure over an axis.
pub(super) struct Over<'a> {
    pub title: &'a str,
    pub axis: Axis,
    pub measure: &'a Measure,
    /// The number of its color and mark, its name and its points.
    pub all: Vec<(usize, &'a str, &'a [Point])>,
}

/// `of` as the figure `name`.
pub(super) fn over(name: String, of: &Over<'_>) -> Result<Figure, FigureError> {
    let Over { title, axis, measure, all } = of;
    let scale = scale(measure);
    let curve = |&(number, name, points): &(usize, &str, &[Point])| {
        let places = points.iter().map(|point| Place {
            x: point.x,
            mean: point.mean.map(|value| scale * value),
            of: point.of_seeds.iter().map(|value| scale * value).collect(),
        });
        Curve { number, name: name.to_owned(), places: places.collect() }
    };
    let curves: Vec<Curve> = all.iter().map(curve).collect();
    let words = Words { caption: (*title).to_owned(), x: axis.in_words().to_owned(), y: label(measure) };
    if *axis == Axis::Variants {
        drawn(name, &Bars { words: &words, curves: &curves })
    } else {
        drawn(name, &Lines { words: &words, curves: &curves })
    }
}

/// Shares are shown in percent.
pub(super) fn scale(measure: &Measure) -> f64 {
    if measure.is_share() { 100.0 } else { 1.0 }
}

/// What stands beside a measure's axis.
pub(super) fn label(measure: &Measure) -> String {
    let title = measure.title();
    if measure.is_share() { format!("{title} (%)") } else { title }
}

impl Axis {
    /// What a figure says under it.
    pub fn in_words(self) -> &'static str {
        match self {
            Self::Answers => "answers",
            Self::Minutes => "minutes of feedback",
            Self::CriticalMistakes => "wrong answers to critical queries (%)",
            Self::Recorded => "recorded episodes that the world model was learned from",
            Self::Variants => "",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::charts::SIZE;
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
