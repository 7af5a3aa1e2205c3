//! Runs side by side: how their episodes are distributed, what is measured over an axis, and both as figures and as tables.

use plotters::coord::Shift;
use plotters::prelude::*;

use super::charts::{
    COLORS, Curve, Drawing, Figure, FigureError, Lines, Place, Words, chart, drawn, legend, mark,
    mark_in_legend, said,
};
use super::comparison::{Comparison, Group, probability};
use super::description::Axis;
use super::figures::{Over, label, over, scale};
use super::opened::Loss;
use super::summary::Point;
use super::table::Measure;
use crate::text::cell;

/// How the values of a group are spread.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// The least and the greatest.
    pub ends: [f64; 2],
    /// Between these lies the middle half.
    pub quartiles: [f64; 2],
    /// The middle value.
    pub median: f64,
}

impl Spread {
    /// Of `values`; nothing where there are none. Between two values lies what is between them in proportion.
    ///
    /// ```
    /// use dropj::experiment::side_by_side::Spread;
    ///
    /// let spread = Spread::of(&[4.0, 1.0, 2.0, 3.0]).unwrap();
    /// assert_eq!((spread.ends, spread.median, spread.quartiles), ([1.0, 4.0], 2.5, [1.75, 3.25]));
    /// ```
    pub fn of(values: &[f64]) -> Option<Self> {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let last = sorted.len().checked_sub(1)?;
        let at = |share: f64| {
            let place = share * last as f64;
            let (below, above) = (sorted[place as usize], sorted[(place as usize + 1).min(last)]);
            below + (above - below) * place.fract()
        };
        Some(Self { ends: [sorted[0], sorted[last]], quartiles: [at(0.25), at(0.75)], median: at(0.5) })
    }
}

/// Where the point of an episode stands beside the middle of its group, in `[−1, 1]`: the same each time.
pub fn aside(i: usize) -> f64 {
    // Multiples of the golden ratio never fall on each other.
    2.0 * (i as f64 * 0.618_033_988_749_894_9).fract() - 1.0
}

/// A series with the number of its color and mark, and its name.
pub type Numbered = (usize, String, Vec<Point>);

/// What can be saved of runs side by side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The table of runs.
    Table,
    /// How episodes are distributed.
    Distribution,
    /// What is measured over the axis of an experiment.
    Curves,
    /// Curves of fits.
    Losses,
    /// All of it, into a folder.
    All,
}

/// What is drawn, for files.
#[derive(Clone, Debug, PartialEq)]
pub struct SideBySide {
    /// What is shown.
    pub measure: Measure,
    /// The number of each run's color and mark, and its episodes.
    pub groups: Vec<(usize, Group)>,
    /// What was measured over an axis, with numbers of colors.
    pub over: Option<(Axis, Vec<Numbered>)>,
    /// Curves of fits, with numbers of colors.
    pub losses: Vec<(usize, Loss)>,
    /// What is said of each run: names of columns, then a line a run.
    pub table: Vec<Vec<String>>,
}

impl SideBySide {
    /// How the episodes of each run are distributed.
    ///
    /// # Errors
    /// Where it cannot be drawn.
    pub fn distribution(&self) -> Result<Figure, FigureError> {
        drawn(format!("distribution_{}", self.measure.slug()), &Distribution(self))
    }

    /// What is measured over the axis, where there is one.
    ///
    /// # Errors
    /// Where it cannot be drawn.
    pub fn curves(&self) -> Option<Result<Figure, FigureError>> {
        let (axis, all) = self.over.as_ref()?;
        let title = format!("{} over {}", capital(&self.measure.title()), axis.in_words());
        let all = all.iter().map(|(i, name, points)| (*i, name.as_str(), &points[..])).collect();
        let of = Over { title: &title, axis: *axis, measure: &self.measure, all };
        Some(over(format!("curves_{}", self.measure.slug()), &of))
    }

    /// Curves of fits, where there are some.
    ///
    /// # Errors
    /// Where they cannot be drawn.
    pub fn losses(&self) -> Option<Result<Figure, FigureError>> {
        let curves = self.losses.iter().map(|(number, (name, points))| {
            let places = points.iter().map(|&[x, y]| Place { x, mean: [y; 3], of: Vec::new() });
            Curve { number: *number, name: name.clone(), places: places.collect() }
        });
        let curves: Vec<Curve> = curves.collect();
        let words =
            Words { caption: "Loss over epochs".to_owned(), x: "epochs".to_owned(), y: "loss".to_owned() };
        (!curves.is_empty()).then(|| drawn("losses".to_owned(), &Lines { words: &words, curves: &curves }))
    }

    /// The table of runs as CSV.
    pub fn table_csv(&self) -> String {
        csv(&self.table)
    }

    /// Every episode as CSV: its run, its seeds and the value.
    pub fn episodes_csv(&self) -> String {
        let some = |number: Option<u64>| number.map_or(String::new(), |number| number.to_string());
        let head = ["run", "seed", "track", &self.measure.slug()].map(str::to_owned).to_vec();
        let rows = self.groups.iter().flat_map(|(_, group)| {
            group
                .episodes
                .iter()
                .map(|it| vec![cell(&group.name), some(it.seed), some(it.track), it.value.to_string()])
        });
        lines(std::iter::once(head).chain(rows))
    }

    /// What the tests say of each two, as CSV; nothing where they say nothing.
    pub fn tests_csv(&self) -> Option<String> {
        let groups: Vec<Group> = self.groups.iter().map(|(_, group)| group.clone()).collect();
        let found = Comparison::of(&groups)?;
        let head =
            ["one", "other", "difference", "low", "high", "cliffs_delta", "wilcoxon_holm", "dunn", "verdict"];
        let rows = found.pairs.iter().map(|pair| {
            let [mean, low, high] = pair
                .difference
                .map_or([const { String::new() }; 3], |all| all.map(|value| value.to_string()));
            let name = |i: usize| cell(&groups[i].name);
            vec![
                name(pair.of.0),
                name(pair.of.1),
                mean,
                low,
                high,
                pair.delta.to_string(),
                probability(pair.wilcoxon),
                pair.dunn.map_or(String::new(), probability),
                pair.verdict.in_words().to_owned(),
            ]
        });
        let head = head.map(str::to_owned).to_vec();
        Some(lines(std::iter::once(head).chain(rows))).filter(|_| !found.pairs.is_empty())
    }
}

fn csv(table: &[Vec<String>]) -> String {
    lines(table.iter().map(|line| line.iter().map(|text| cell(text)).collect()))
}

fn lines(rows: impl Iterator<Item = Vec<String>>) -> String {
    rows.fold(String::new(), |text, row| text + &row.join(",") + "\n")
}

fn capital(name: &str) -> String {
    let mut letters = name.chars();
    letters.next().map(|first| first.to_uppercase().chain(letters).collect()).unwrap_or_default()
}

/// A box for each run, and a mark for each episode.
struct Distribution<'a>(&'a SideBySide);

impl Drawing for Distribution<'_> {
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), String> {
        let SideBySide { measure, groups, .. } = self.0;
        let scale = scale(measure);
        let values = groups.iter().flat_map(|(_, group)| group.values()).map(|value| scale * value);
        let (low, high) = values.fold((0.0f64, f64::EPSILON), |(low, high), y| (low.min(y), high.max(y)));
        let bounds = [low * 1.05, if high < 1e-6 { 1.0 } else { high * 1.08 }];
        let caption = format!("{} of each episode", capital(&measure.title()));
        let words = Words { caption, x: String::new(), y: label(measure) };
        let mut chart = chart(area, &words, [-0.6, groups.len() as f64 - 0.4], bounds)?;
        for (place, (i, group)) in groups.iter().enumerate() {
            let (i, x, color) = (*i, place as f64, COLORS[i % COLORS.len()]);
            let values = group.values();
            let Some(spread) = Spread::of(&values) else { continue };
            let [least, most] = spread.ends.map(|value| scale * value);
            let [lower, upper] = spread.quartiles.map(|value| scale * value);
            let middle = Rectangle::new([(x - 0.3, lower), (x + 0.3, upper)], color.mix(0.2).filled());
            let drawn = chart.draw_series([middle]).map_err(said)?;
            drawn.label(&group.name).legend(move |at| mark_in_legend(i, at, color.filled()));
            let median = scale * spread.median;
            let lines =
                [[(x, least), (x, lower)], [(x, upper), (x, most)], [(x - 0.3, median), (x + 0.3, median)]];
            let lines = lines.map(|line| PathElement::new(line, color.stroke_width(2)));
            chart.draw_series(lines).map_err(said)?;
            let points = values
                .iter()
                .enumerate()
                .map(|(k, value)| mark(i, (x + 0.24 * aside(k), scale * value), 4, color.mix(0.8).filled()));
            chart.draw_series(points).map_err(said)?;
        }
        legend(&mut chart, SeriesLabelPosition::UpperRight)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::comparison::Driven;

    fn shown() -> SideBySide {
        let group = |name: &str, by: f64| {
            let driven = |i: u64| Driven { seed: Some(i % 3), track: Some(i), value: by + i as f64 };
            Group { name: name.to_owned(), episodes: (0..12).map(driven).collect() }
        };
        let groups: Vec<_> = (0..8).map(|i| (i, group(&format!("run {i}"), 100.0 * i as f64))).collect();
        let point =
            |x: f64| Point { x, of_seeds: vec![x, 2.0 * x], episodes: vec![], mean: [x, 0.5 * x, 2.0 * x] };
        let over = groups.iter().map(|(i, group)| (*i, group.name.clone(), vec![point(1.0), point(2.0)]));
        let table =
            vec![vec!["run".to_owned(), "return".to_owned()], vec!["=a,b".to_owned(), "1 ± 2".to_owned()]];
        let losses = (0..8).map(|i| (i, (format!("run {i}"), vec![[0.0, 2.0], [1.0, 1.0]]))).collect();
        let over = Some((Axis::Answers, over.collect()));
        SideBySide { measure: Measure::Return, over, groups, losses, table }
    }

    #[test]
    fn distributions_and_curves_are_drawn_in_every_color_with_every_mark() {
        let shown = shown();
        let figures = [shown.distribution(), shown.curves().unwrap(), shown.losses().unwrap()];
        for figure in figures.map(Result::unwrap) {
            assert!(
                figure.svg.contains("run 7") && figure.svg.trim_end().ends_with("</svg>"),
                "{}",
                figure.name
            );
            for RGBColor(r, g, b) in COLORS {
                let hex = format!("#{r:02X}{g:02X}{b:02X}");
                assert!(figure.svg.contains(&hex), "{hex} in {}", figure.name);
            }
            assert!(figure.png.starts_with(b"\x89PNG"));
        }
    }

    #[test]
    fn tables_are_told_to_spreadsheets_safely() {
        let shown = shown();
        assert_eq!(shown.table_csv(), "run,return\n\"'=a,b\",1 ± 2\n");
        assert!(shown.episodes_csv().starts_with("run,seed,track,return\nrun 0,0,0,0\nrun 0,1,1,1\n"));
        let tests = shown.tests_csv().unwrap();
        assert_eq!(tests.lines().count(), 1 + 28);
        assert!(tests.contains("run 0,run 1,-100,-100,-100,"), "{tests}");
    }
}
