//! Writing what is shown of runs side by side: tables as CSV, figures as SVG or PNG.

use std::path::{Path, PathBuf};

use crate::experiment::Figure;
use crate::experiment::charts::FigureError;
use crate::experiment::side_by_side::{Part, SideBySide};
use crate::run::{Kind, OutputFile, RunError, make_folder};
use crate::text::shown as safely;

/// Why it is not saved.
#[derive(Debug, thiserror::Error)]
pub(in crate::worker) enum SaveError {
    /// It cannot be written.
    #[error(transparent)]
    Run(#[from] RunError),
    /// It cannot be drawn.
    #[error(transparent)]
    Figure(#[from] FigureError),
    /// There is nothing of the kind.
    #[error("there is nothing to save: {0}")]
    Nothing(&'static str),
}

/// Saves `part` of what is shown at `path`, and says so.
pub(super) fn save(part: Part, path: &Path, shown: &SideBySide) -> Result<String, SaveError> {
    let none = SaveError::Nothing;
    let path = match part {
        Part::All => {
            let n = all(path, shown)?;
            return Ok(format!("{n} files are in {}", name(path)));
        }
        Part::Table => {
            let path = with_end(path, "csv");
            OutputFile::at(&path, Kind::Table)?.write(shown.table_csv().as_bytes())?;
            path
        }
        Part::Distribution if shown.groups.is_empty() => return Err(none("no run is shown")),
        Part::Distribution => figure(path, &shown.distribution()?)?,
        Part::Curves => figure(path, &shown.curves().ok_or(none("no experiment with an axis is shown"))??)?,
        Part::Losses => figure(path, &shown.losses().ok_or(none("no fit is shown"))??)?,
    };
    Ok(format!("{} is saved", name(&path)))
}

/// As PNG where the name ends so, and else as SVG.
fn figure(path: &Path, figure: &Figure) -> Result<PathBuf, SaveError> {
    let is_png = path.extension().is_some_and(|end| end.eq_ignore_ascii_case("png"));
    let path = if is_png { path.to_owned() } else { with_end(path, "svg") };
    let (kind, bytes) =
        if is_png { (Kind::Picture, &figure.png[..]) } else { (Kind::Drawing, figure.svg.as_bytes()) };
    OutputFile::at(&path, kind)?.write(bytes)?;
    Ok(path)
}

/// Every table and figure, in the folder `dir`; returns how many files.
fn all(dir: &Path, shown: &SideBySide) -> Result<usize, SaveError> {
    let mut tables = vec![("runs.csv", shown.table_csv())];
    let mut figures = Vec::new();
    if !shown.groups.is_empty() {
        tables.push(("episodes.csv", shown.episodes_csv()));
        figures.push(shown.distribution()?);
    }
    tables.extend(shown.tests_csv().map(|csv| ("tests.csv", csv)));
    figures.extend(shown.curves().transpose()?);
    figures.extend(shown.losses().transpose()?);
    make_folder(dir)?;
    let mut files = Vec::new();
    for (name, csv) in &tables {
        files.push((OutputFile::at(&dir.join(name), Kind::Table)?, csv.as_bytes()));
    }
    for figure in &figures {
        let at = |end: &str| dir.join(&figure.name).with_added_extension(end);
        files.push((OutputFile::at(&at("svg"), Kind::Drawing)?, figure.svg.as_bytes()));
        files.push((OutputFile::at(&at("png"), Kind::Picture)?, &figure.png[..]));
    }
    let n = files.len();
    // All places were looked at before anything is written.
    for (file, bytes) in files {
        file.write(bytes)?;
    }
    Ok(n)
}

/// The path with this end, unless it has it.
fn with_end(path: &Path, end: &str) -> PathBuf {
    if path.extension().is_some_and(|known| known.eq_ignore_ascii_case(end)) {
        path.to_owned()
    } else {
        path.with_added_extension(end)
    }
}

fn name(path: &Path) -> String {
    safely(&path.file_name().map_or_else(|| path.to_string_lossy(), |name| name.to_string_lossy()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::comparison::Driven;
    use crate::experiment::{Group, Measure};
    use crate::worker::fixtures::put;

    fn shown() -> SideBySide {
        let group = |name: &str, by: f64| {
            let driven = |i: u64| Driven { seed: Some(i % 2), track: Some(i), value: by + i as f64 };
            Group { name: name.to_owned(), episodes: (0..8).map(driven).collect() }
        };
        SideBySide {
            measure: Measure::Return,
            groups: vec![(0, group("a", 0.0)), (1, group("b", 9.0))],
            over: None,
            losses: vec![(2, ("loss".to_owned(), vec![[0.0, 1.0], [1.0, 0.5]]))],
            table: vec![vec!["run".to_owned()], vec!["a".to_owned()], vec!["b".to_owned()]],
        }
    }

    #[test]
    fn every_figure_and_table_is_saved_by_itself_or_all_at_once() {
        let (dir, shown) = (tempfile::tempdir().unwrap(), shown());
        let at = |name: &str| dir.path().join(name);
        assert_eq!(save(Part::Table, &at("t"), &shown).unwrap(), "t.csv is saved");
        assert_eq!(save(Part::Distribution, &at("d.png"), &shown).unwrap(), "d.png is saved");
        assert_eq!(save(Part::Distribution, &at("d"), &shown).unwrap(), "d.svg is saved");
        assert_eq!(save(Part::Losses, &at("l.svg"), &shown).unwrap(), "l.svg is saved");
        // Over itself once more.
        save(Part::Distribution, &at("d.svg"), &shown).unwrap();
        assert!(matches!(save(Part::Curves, &at("c"), &shown), Err(SaveError::Nothing(_))));
        assert_eq!(save(Part::All, &at("all"), &shown).unwrap(), "7 files are in all");
        for name in ["runs.csv", "episodes.csv", "tests.csv", "distribution_return.png", "losses.svg"] {
            assert!(at("all").join(name).is_file(), "{name}");
        }
    }

    #[test]
    fn nothing_of_another_kind_is_written_over() {
        let (dir, shown) = (tempfile::tempdir().unwrap(), shown());
        put(&dir.path().join("thesis.svg"), "a thesis");
        let met = save(Part::Distribution, &dir.path().join("thesis.svg"), &shown).unwrap_err().to_string();
        assert!(met.contains("thesis.svg"), "{met}");
        put(&dir.path().join("losses.png"), "another thesis");
        assert!(save(Part::All, dir.path(), &shown).is_err());
        assert!(!dir.path().join("runs.csv").exists(), "nothing is written before all places were looked at");
    }
}
