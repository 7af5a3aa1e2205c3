//! Figures of what was driven: for each measure a line for each series over an axis, or the episodes of each.

use super::charts::{Bars, Curve, Figure, FigureError, Lines, Place, Words, drawn};
use super::description::{Axis, Description};
use super::summary::series;
use super::table::{Measure, Rows};

/// A figure of each measure.
///
/// # Errors
/// Where one cannot be drawn.
pub fn figures(description: &Description, rows: &Rows) -> Result<Vec<Figure>, FigureError> {
    rows.measures().iter().map(|measure| figure(description, rows, measure)).collect()
}

fn figure(description: &Description, rows: &Rows, measure: &Measure) -> Result<Figure, FigureError> {
    // Shares are shown in percent.
    let scale = if measure.is_share() { 100.0 } else { 1.0 };
    let curves: Vec<Curve> = series(description, rows, measure)
        .into_iter()
        .map(|(name, points)| {
            let places = points.into_iter().map(|point| Place {
                x: point.x,
                mean: point.mean.map(|value| scale * value),
                of: point.of_seeds.iter().map(|value| scale * value).collect(),
            });
            Curve { name, places: places.collect() }
        })
        .collect();
    let x = match description.axis {
        Axis::Answers => "answers",
        Axis::Minutes => "minutes of feedback",
        Axis::CriticalMistakes => "wrong answers to critical queries (%)",
        Axis::Recorded => "recorded episodes that the world model was learned from",
        Axis::Variants => "",
    };
    let title = measure.title();
    let y = if measure.is_share() { format!("{title} (%)") } else { title };
    let words = Words { caption: description.title.clone(), x: x.to_owned(), y };
    if description.axis == Axis::Variants {
        drawn(measure.slug(), &Bars { words: &words, curves: &curves })
    } else {
        drawn(measure.slug(), &Lines { words: &words, curves: &curves })
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
