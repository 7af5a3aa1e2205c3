//! The results of several methods as plain text, one method a line.

use comfy_table::presets::NOTHING;
use comfy_table::{CellAlignment, Table};

use crate::evaluation::metrics::{MeanSd, Summary};

/// A column: its heading, what it shows, a factor and how many digits follow the point.
type Column = (&'static str, fn(&Summary) -> Option<MeanSd>, f64, usize);

const COLUMNS: [Column; 7] = [
    ("return", |s| s.ret, 1.0, 0),
    ("new tiles %", |s| s.new_tile_rate, 100.0, 1),
    ("grass %", |s| s.grass_rate, 100.0, 1),
    ("chuckholes %", |s| s.chuckhole_rate, 100.0, 1),
    ("cars %", |s| s.car_rate, 100.0, 1),
    ("steps", |s| s.n_steps, 1.0, 0),
    ("plan ms", |s| s.plan_ms, 1.0, 1),
];

/// Means ± standard deviations of each method. Columns that no method has are left out.
///
/// ```
/// use dropj::evaluation::{MeanSd, Summary, table};
///
/// let ret = Some(MeanSd { mean: 812.4, sd: 95.0, n: 10 });
/// let summary = Summary { n_episodes: 10, ret, ..Summary::default() };
/// assert_eq!(table(&[("DROPJ", summary)]), "\
/// method  episodes    return
/// DROPJ         10  812 ± 95
/// ");
/// ```
pub fn table(methods: &[(&str, Summary)]) -> String {
    let shown = COLUMNS.iter().filter(|(_, value, ..)| methods.iter().any(|(_, s)| value(s).is_some()));
    let shown: Vec<_> = shown.collect();
    let mut lines = vec![vec!["method".to_owned(), "episodes".to_owned()]];
    lines[0].extend(shown.iter().map(|(heading, ..)| (*heading).to_owned()));
    for (name, summary) in methods {
        let mut cells = vec![(*name).to_owned(), summary.n_episodes.to_string()];
        cells.extend(shown.iter().map(|(_, value, factor, digits)| match value(summary) {
            Some(MeanSd { mean, sd, .. }) => format!("{:.digits$} ± {:.digits$}", mean * factor, sd * factor),
            None => "–".to_owned(),
        }));
        lines.push(cells);
    }
    aligned(&lines)
}

/// Lines of as many cells each, the first cell at the left and the others at the right of their columns.
///
/// Nothing is drawn around them, so that they can be copied; what is in a cell is to be safe to show already
/// ([`shown`](crate::text::shown)).
pub fn aligned(lines: &[Vec<String>]) -> String {
    let mut table = Table::new();
    table.load_style(NOTHING).add_rows(lines);
    for (i, column) in table.column_iter_mut().enumerate() {
        let (gap, side) = if i == 0 { (0, CellAlignment::Left) } else { (2, CellAlignment::Right) };
        column.set_padding((gap, 0)).set_cell_alignment(side);
    }
    table.trim_fmt() + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_no_episode_has_is_a_dash_or_no_column_at_all() {
        let rate = |mean| Some(MeanSd { mean, sd: 0.01, n: 10 });
        let with =
            Summary { n_episodes: 10, grass_rate: rate(0.05), car_rate: rate(0.5), ..Summary::default() };
        let without = Summary { car_rate: None, ..with };
        assert_eq!(
            table(&[("A", with), ("Bee", without)]),
            "method  episodes    grass %      cars %\n\
             A             10  5.0 ± 1.0  50.0 ± 1.0\n\
             Bee           10  5.0 ± 1.0           –\n"
        );
    }

    #[test]
    fn columns_are_as_wide_as_they_look() {
        let lines = [["who", "n"], ["用户", "10"], ["Ann", "9"]].map(|line| line.map(str::to_owned).to_vec());
        assert_eq!(aligned(&lines), "who    n\n用户  10\nAnn    9\n");
    }
}
