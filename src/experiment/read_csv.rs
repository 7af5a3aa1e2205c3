//! Reading the table of an experiment back from `results.csv`.

use std::collections::BTreeMap;

use serde_json::{Map, Value};

use super::table::{Row, Rows, WORLD_MODEL};

/// Columns of whole numbers.
const WHOLE: [&str; 7] = ["trial", "seed", "answers", "labels", "recorded", "track", "steps"];
/// Columns of words.
const WORDS: [&str; 6] = ["method", "strategy", "weights", "annotators", "fit", "planner"];
/// Columns of other numbers that are of no event.
const NUMBERS: [&str; 8] = [
    "minutes",
    "critical_mistakes",
    "other_mistakes",
    "critical_disagreement",
    "other_disagreement",
    "diversity",
    "ret",
    "unsafe_rate",
];

/// Why a table is none of an experiment.
#[derive(Debug, thiserror::Error)]
pub enum CsvError {
    /// It has no line of names.
    #[error("it is empty")]
    Empty,
    /// A line has more or fewer cells than there are names.
    #[error("line {line}: there are {found} cells for {wanted} columns")]
    Cells {
        /// The line, from 1.
        line: u64,
        /// How many it has.
        found: usize,
        /// How many names there are.
        wanted: usize,
    },
    /// A cell holds no number.
    #[error("line {line}: {column} is {found:?}, and must be a number")]
    Number {
        /// The line, from 1.
        line: u64,
        /// The column.
        column: String,
        /// What is there.
        found: String,
    },
    /// A line is no row.
    #[error("line {line}: {met}")]
    Row {
        /// The line, from 1.
        line: u64,
        /// What was met.
        met: serde_json::Error,
    },
}

impl Rows {
    /// The rows in a table, as [`to_csv`](Self::to_csv) writes it.
    ///
    /// # Errors
    /// Where a line is none.
    pub fn from_csv(text: &str) -> Result<Self, CsvError> {
        let mut records = records(text).into_iter();
        let (_, names) = records.next().ok_or(CsvError::Empty)?;
        let names: Vec<&str> =
            names.iter().map(|name| if name == "return" { "ret" } else { name.as_str() }).collect();
        let mut rows = Vec::new();
        for (line, cells) in records {
            let (found, wanted) = (cells.len(), names.len());
            if found != wanted {
                return Err(CsvError::Cells { line, found, wanted });
            }
            let cells: Vec<_> = names.iter().copied().zip(cells.iter().map(String::as_str)).collect();
            rows.push(row(&cells, line)?);
        }
        Ok(Self(rows))
    }
}

/// The cells of each line that has some, with its number from 1: quotes and what is between them as RFC 4180 has it.
fn records(text: &str) -> Vec<(u64, Vec<String>)> {
    let (mut records, mut cells, mut cell) = (Vec::new(), Vec::new(), String::new());
    let (mut line, mut began, mut is_quoted) = (1, 1, false);
    let mut letters = text.trim_start_matches('\u{feff}').chars().peekable();
    while let Some(letter) = letters.next() {
        line += u64::from(letter == '\n');
        match letter {
            '"' if is_quoted && letters.peek() == Some(&'"') => cell.extend(letters.next()),
            '"' => is_quoted = !is_quoted,
            ',' if !is_quoted => cells.push(std::mem::take(&mut cell)),
            '\r' if !is_quoted => {}
            '\n' if !is_quoted => {
                if !(cells.is_empty() && cell.is_empty()) {
                    cells.push(std::mem::take(&mut cell));
                    records.push((began, std::mem::take(&mut cells)));
                }
                began = line;
            }
            letter => cell.push(letter),
        }
    }
    if !(cells.is_empty() && cell.is_empty()) {
        cells.push(cell);
        records.push((began, cells));
    }
    records
}

fn row(cells: &[(&str, &str)], line: u64) -> Result<Row, CsvError> {
    let (mut fields, mut events, mut world_model) = (Map::new(), BTreeMap::new(), BTreeMap::new());
    for &(name, cell) in cells {
        if WORDS.contains(&name) {
            fields.insert(name.to_owned(), cell.into());
            continue;
        }
        if name == "found" {
            fields.insert(name.to_owned(), (cell == "1").into());
            continue;
        }
        let wrong = || CsvError::Number { line, column: name.to_owned(), found: cell.to_owned() };
        let value = if cell.is_empty() {
            Value::Null
        } else if WHOLE.contains(&name) {
            cell.parse::<u64>().map_err(|_| wrong())?.into()
        } else {
            cell.parse::<f64>().ok().filter(|value| value.is_finite()).ok_or_else(wrong)?.into()
        };
        if WHOLE.contains(&name) || NUMBERS.contains(&name) {
            fields.insert(name.to_owned(), value);
        } else if WORLD_MODEL.iter().any(|(key, _)| *key == name) {
            // What was not measured has no cell.
            world_model.extend((!value.is_null()).then_some((name, value)));
        } else {
            events.insert(name, value);
        }
    }
    fields.insert("events".to_owned(), serde_json::json!(events));
    fields.insert("world_model".to_owned(), serde_json::json!(world_model));
    serde_json::from_value(Value::Object(fields)).map_err(|met| CsvError::Row { line, met })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::table::made_up::rows;

    #[test]
    fn a_table_that_was_written_is_read_as_it_was() {
        let mut rows = rows();
        rows.0[3].weights = "flat, all 0.9".to_owned();
        rows.0[4].events.insert("bump_rate".to_owned(), None);
        (rows.0[5].found, rows.0[6].recorded) = (true, Some(25));
        rows.0[7].world_model.insert("seen_error".to_owned(), 0.125);
        let mut read = Rows::from_csv(&rows.to_csv()).unwrap();
        for row in &mut read.0 {
            // What nobody passed has no column.
            row.events.insert("drop_rate".to_owned(), None);
        }
        assert_eq!(read, rows);
    }

    #[test]
    fn damage_is_said_with_its_line() {
        let csv = rows().to_csv();
        let met = |csv: String| Rows::from_csv(&csv).unwrap_err().to_string();
        assert_eq!(
            met(csv.replacen(",6.250,", ",six,", 1)),
            "line 2: minutes is \"six\", and must be a number"
        );
        assert!(met(csv.replacen("drop,", "drip,", 1)).starts_with("line 2: unknown variant `drip`"));
        assert!(met(csv[..csv.len() - 9].to_owned()).starts_with("line 25: there are "), "a cut line");
        assert_eq!(met(String::new()), "it is empty");
        assert!(met("a,b\n1,2\n".to_owned()).contains("missing field"), "another table");
    }
}
