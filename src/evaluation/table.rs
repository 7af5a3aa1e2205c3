//! The results of several methods as plain text, one method a line.

use comfy_table::presets::NOTHING;
use comfy_table::{CellAlignment, Table};

use crate::evaluation::metrics::{EventFigure, MeanSd, Summary};
use crate::text::shown;
use crate::world::Count;

/// A column: its heading, what it shows of each method, a factor and how many digits follow the point.
type Column = (String, Vec<Option<MeanSd>>, f64, usize);

/// The columns of some methods: fixed ones, and one for each event that one of them has.
fn columns(methods: &[(&str, Summary)]) -> Vec<Column> {
    let of = |value: &dyn Fn(&Summary) -> Option<MeanSd>| {
        methods.iter().map(|(_, s)| value(s)).collect::<Vec<_>>()
    };
    let fixed = |name: &str, value: fn(&Summary) -> Option<MeanSd>, factor, digits| {
        (name.to_owned(), of(&value), factor, digits)
    };
    let mut events: Vec<&EventFigure> = Vec::new();
    for (figure, _) in methods.iter().flat_map(|(_, summary)| &summary.events) {
        if !events.iter().any(|known| known.name == figure.name) {
            events.push(figure);
        }
    }
    let mut columns = vec![fixed("return", |s| s.ret, 1.0, 0)];
    // Where one thing alone must not happen, its rate says it all.
    let rates = |(_, s): &(&str, Summary)| s.events.iter().any(|(_, rate)| *rate == s.unsafe_rate);
    if !methods.iter().any(rates) {
        columns.push(fixed("unsafe %", |s| s.unsafe_rate, 100.0, 1));
    }
    for figure in events {
        let value = |s: &Summary| {
            s.events.iter().find(|(of, _)| of.name == figure.name).and_then(|(_, value)| *value)
        };
        columns.push(match figure.count {
            Count::FirstTouch => (figure.name.clone(), of(&value), 1.0, 1),
            Count::PerStep | Count::OfPassed => (format!("{} %", figure.name), of(&value), 100.0, 1),
        });
    }
    columns.extend([fixed("steps", |s| s.n_steps, 1.0, 0), fixed("plan ms", |s| s.plan_ms, 1.0, 1)]);
    columns.retain(|(_, values, ..)| values.iter().any(Option::is_some));
    columns
}

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
    let columns = columns(methods);
    let mut lines = vec![vec!["method".to_owned(), "episodes".to_owned()]];
    lines[0].extend(columns.iter().map(|(heading, ..)| shown(heading)));
    for (i, (name, summary)) in methods.iter().enumerate() {
        let mut cells = vec![(*name).to_owned(), summary.n_episodes.to_string()];
        cells.extend(columns.iter().map(|(_, values, factor, digits)| match values[i] {
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
/// ([`shown`]).
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
        let rate = |name: &str, mean| {
            let figure = EventFigure { name: name.to_owned(), count: Count::PerStep, value: None };
            (figure, Some(MeanSd { mean, sd: 0.01, n: 10 }))
        };
        let with = Summary {
            n_episodes: 10,
            unsafe_rate: rate("", 0.55).1,
            events: vec![rate("grass", 0.05), rate("car", 0.5)],
            ..Summary::default()
        };
        let without = Summary { events: vec![rate("grass", 0.05)], ..with.clone() };
        assert_eq!(
            table(&[("A", with), ("Bee", without)]),
            "method  episodes    unsafe %    grass %       car %\n\
             A             10  55.0 ± 1.0  5.0 ± 1.0  50.0 ± 1.0\n\
             Bee           10  55.0 ± 1.0  5.0 ± 1.0           –\n"
        );
    }

    #[test]
    fn columns_are_as_wide_as_they_look() {
        let lines = [["who", "n"], ["用户", "10"], ["Ann", "9"]].map(|line| line.map(str::to_owned).to_vec());
        assert_eq!(aligned(&lines), "who    n\n用户  10\nAnn    9\n");
    }
}
