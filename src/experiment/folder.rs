//! The folder of an experiment: what was asked, what each trial brought, and what it comes to.
//!
//! ```text
//! experiment.toml      what is asked, at its scale
//! trials/0003.jsonl    what trial 3 brought: what was driven; written whole when it is done
//! trials/0003.*.jsonl  what else it brought: gradients, states, times, evaluations
//! trials/0003.now      how far it is, while it runs
//! trials/0003.error    why it came to nothing, if so
//! worlds/              world models that were learned for it
//! results.csv          all that was driven; the same in results.parquet
//! gradients.csv, …     what else was measured
//! summary.md           what they come to, in words
//! figures/*.svg        drawn; the same as *.png
//! curves/SERIES/       the same over the axis, for `TensorBoard`
//! ```

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::charts::{Figure, FigureError};
use super::curves;
use super::description::{Description, DescriptionError};
use super::figures::figures;
use super::gradients::{self, GradientRow};
use super::search::{self, Evaluation};
use super::segment_times::{self, SegmentTime};
use super::states::{Layout, StateRow};
use super::summary::summary;
use super::table::{Rows, csv, from_lines, to_lines};
use super::trial::Outcome;
use crate::run::{RunError, make_folder, read_at_most, remove_file, write_whole};

/// Bytes of a trial's rows, and of a description.
const MOST: u64 = 1 << 28;

/// Why a folder is none of an experiment.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    /// It cannot be read or written.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A file in it cannot be read.
    #[error("cannot read {path:?}: {met}")]
    Read {
        /// Which.
        path: PathBuf,
        /// What was met.
        met: std::io::Error,
    },
    /// It holds another experiment.
    #[error("the folder {0:?} holds another experiment: choose another with --out, or remove it")]
    Other(PathBuf),
    /// There is none.
    #[error("there is no experiment in {0:?}")]
    None(PathBuf),
    /// What is asked cannot be.
    #[error("in {path:?}: {met}")]
    Description {
        /// Where.
        path: PathBuf,
        /// What was met.
        met: DescriptionError,
    },
    /// The rows of a trial are none.
    #[error("{path:?} holds no rows of a trial ({met}): remove it, and the trial is run again")]
    Rows {
        /// Where.
        path: PathBuf,
        /// What was met.
        met: serde_json::Error,
    },
    /// A table cannot be made.
    #[error("the table cannot be made: {0}")]
    Table(String),
    /// A figure cannot be drawn.
    #[error(transparent)]
    Figure(#[from] FigureError),
}

/// The folder of an experiment.
#[derive(Clone, Debug)]
pub struct Folder {
    dir: PathBuf,
    /// What is asked.
    pub description: Description,
}

impl Folder {
    /// The folder of `description` at `dir`, which is made where there is none: what was done in it stands.
    ///
    /// # Errors
    /// Where another experiment is in it, or where it cannot be made.
    pub fn begin(dir: &Path, description: Description) -> Result<Self, FolderError> {
        match Self::open(dir) {
            Ok(folder) if folder.description == description => return Ok(folder),
            Ok(_) => return Err(FolderError::Other(dir.to_owned())),
            Err(FolderError::None(_)) => {}
            Err(met) => return Err(met),
        }
        make_folder(&dir.join("trials"))?;
        write_whole(&dir.join("experiment.toml"), description.to_toml().as_bytes())?;
        Ok(Self { dir: dir.to_owned(), description })
    }

    /// The experiment in `dir`.
    ///
    /// # Errors
    /// Where there is none, or where it cannot be read.
    pub fn open(dir: &Path) -> Result<Self, FolderError> {
        let path = dir.join("experiment.toml");
        let text = read(&path)?.ok_or_else(|| FolderError::None(dir.to_owned()))?;
        let description = Description::from_toml(&text);
        let description = description.map_err(|met| FolderError::Description { path, met })?;
        Ok(Self { dir: dir.to_owned(), description })
    }

    /// Where it is.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    fn file(&self, trial: usize, kind: &str) -> PathBuf {
        self.dir.join("trials").join(format!("{trial:04}.{kind}"))
    }

    /// What a trial brought, if it is done.
    ///
    /// # Errors
    /// Where what is there cannot be read.
    pub fn rows_of(&self, trial: usize) -> Result<Option<Rows>, FolderError> {
        let path = self.file(trial, "jsonl");
        let Some(text) = read(&path)? else { return Ok(None) };
        Rows::from_lines(&text).map(Some).map_err(|met| FolderError::Rows { path, met })
    }

    /// The trials that are not done.
    ///
    /// # Errors
    /// Where what is there cannot be read.
    pub fn missing(&self) -> Result<Vec<usize>, FolderError> {
        let mut missing = Vec::new();
        for trial in self.description.trials() {
            if self.rows_of(trial.index)?.is_none() {
                missing.push(trial.index);
            }
        }
        Ok(missing)
    }

    /// Keeps what a trial brought: it is done.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn keep(&self, trial: usize, outcome: &Outcome) -> Result<(), FolderError> {
        self.keep_beside(trial, "gradients", &outcome.gradients)?;
        self.keep_beside(trial, "states", &outcome.states)?;
        self.keep_beside(trial, "times", &outcome.times)?;
        // The last: where it is, all is.
        write_whole(&self.file(trial, "jsonl"), to_lines(&outcome.rows).as_bytes())?;
        for kind in ["now", "error"] {
            remove_file(&self.file(trial, kind))?;
        }
        Ok(())
    }

    /// Keeps what a trial brought beside what was driven, if that is anything.
    fn keep_beside<T: Serialize>(&self, trial: usize, kind: &str, values: &[T]) -> Result<(), FolderError> {
        if values.is_empty() {
            return Ok(());
        }
        Ok(write_whole(&self.file(trial, &format!("{kind}.jsonl")), to_lines(values).as_bytes())?)
    }

    /// What a trial brought beside what was driven, which is often nothing.
    fn beside<T: DeserializeOwned>(&self, trial: usize, kind: &str) -> Result<Vec<T>, FolderError> {
        let path = self.file(trial, &format!("{kind}.jsonl"));
        let Some(text) = read(&path)? else { return Ok(Vec::new()) };
        from_lines(&text).map_err(|met| FolderError::Rows { path, met })
    }

    /// The same of all trials that are done.
    fn all_beside<T: DeserializeOwned>(&self, kind: &str) -> Result<Vec<T>, FolderError> {
        let mut all = Vec::new();
        for trial in self.description.trials() {
            if self.rows_of(trial.index)?.is_some() {
                all.extend(self.beside(trial.index, kind)?);
            }
        }
        Ok(all)
    }

    /// The weights that a trial tried so far.
    ///
    /// # Errors
    /// Where what is there cannot be read.
    pub fn evaluations(&self, trial: usize) -> Result<Vec<Evaluation>, FolderError> {
        self.beside(trial, "evaluations")
    }

    /// Keeps the weights that a trial tried so far.
    ///
    /// # Errors
    /// Where they cannot be written.
    pub fn keep_evaluations(&self, trial: usize, all: &[Evaluation]) -> Result<(), FolderError> {
        self.keep_beside(trial, "evaluations", all)
    }

    /// Notes how far a trial is, in words.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn note(&self, trial: usize, now: &str) -> Result<(), FolderError> {
        Ok(write_whole(&self.file(trial, "now"), now.as_bytes())?)
    }

    /// How far a trial is, in words, if it noted that.
    pub fn noted(&self, trial: usize) -> Option<String> {
        read(&self.file(trial, "now")).ok().flatten()
    }

    /// Notes why a trial came to nothing.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn fail(&self, trial: usize, why: &str) -> Result<(), FolderError> {
        write_whole(&self.file(trial, "error"), why.as_bytes())?;
        Ok(remove_file(&self.file(trial, "now"))?)
    }

    /// Why a trial came to nothing, if it did.
    pub fn failure(&self, trial: usize) -> Option<String> {
        read(&self.file(trial, "error")).ok().flatten()
    }

    /// All rows of the trials that are done.
    ///
    /// # Errors
    /// Where what is there cannot be read.
    pub fn rows(&self) -> Result<Rows, FolderError> {
        let mut all = Rows::default();
        for trial in self.description.trials() {
            all.0.extend(self.rows_of(trial.index)?.unwrap_or_default().0);
        }
        Ok(all)
    }

    /// Writes tables, words and figures of what is done, and returns the words.
    ///
    /// # Errors
    /// Where they cannot be made or written.
    pub fn collect(&self) -> Result<String, FolderError> {
        let rows = self.rows()?;
        let mut words = summary(&self.description, &rows, self.missing()?.len());
        self.write("results.csv", rows.to_csv().as_bytes())?;
        self.write("results.parquet", &rows.to_parquet().map_err(FolderError::Table)?)?;
        let mut drawn = figures(&self.description, &rows)?;
        self.collect_beside(&mut words, &mut drawn)?;
        self.write("summary.md", words.as_bytes())?;
        for Figure { name, svg, png } in drawn {
            self.write(&format!("figures/{name}.svg"), svg.as_bytes())?;
            self.write(&format!("figures/{name}.png"), &png)?;
        }
        curves::write(&self.dir.join("curves"), &self.description, &rows)?;
        Ok(words)
    }

    /// The same of what was measured beside driving.
    fn collect_beside(&self, words: &mut String, drawn: &mut Vec<Figure>) -> Result<(), FolderError> {
        let gradients: Vec<GradientRow> = self.all_beside("gradients")?;
        if !gradients.is_empty() {
            self.write("gradients.csv", csv(&gradients::columns(&gradients)).as_bytes())?;
            words.push_str(&gradients::words(&self.description, &gradients));
            drawn.extend(gradients::figures(&gradients)?);
        }
        let evaluations: Vec<Evaluation> = self.all_beside("evaluations")?;
        if let (Some(search), false) = (&self.description.search, evaluations.is_empty()) {
            self.write("evaluations.csv", search::to_csv(search, &evaluations).as_bytes())?;
            words.push_str(&search::words(search, &evaluations));
            drawn.push(search::figure(&self.description, &evaluations)?);
        }
        let states: Vec<StateRow> = self.all_beside("states")?;
        if let Some(layout) = Layout::of(states) {
            self.write("tsne.csv", layout.to_csv().as_bytes())?;
            words.push_str(&layout.words());
            drawn.push(layout.figure()?);
        }
        let times: Vec<SegmentTime> = self.all_beside("times")?;
        if !times.is_empty() {
            self.write("times.csv", segment_times::to_csv(&times).as_bytes())?;
            words.push_str(&segment_times::words(&times, self.description.iterations));
        }
        Ok(())
    }

    fn write(&self, name: &str, bytes: &[u8]) -> Result<(), FolderError> {
        Ok(write_whole(&self.dir.join(name), bytes)?)
    }
}

/// The text of a file, if it is there.
fn read(path: &Path) -> Result<Option<String>, FolderError> {
    match read_at_most(path, MOST) {
        Ok(bytes) => Ok(bytes.map(|bytes| crate::text::decoded(&bytes).into_owned())),
        Err(met) if met.kind() == ErrorKind::NotFound => Ok(None),
        Err(met) => Err(FolderError::Read { path: path.to_owned(), met }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::table::made_up::rows;
    use crate::experiment::{Scale, named};

    #[test]
    fn a_folder_goes_on_where_it_was_left() {
        let dir = tempfile::tempdir().unwrap();
        let at = dir.path().join("run");
        assert!(matches!(Folder::open(&at), Err(FolderError::None(_))));
        let asked = named("q3-justifications").unwrap().at(Scale::Toy);
        let folder = Folder::begin(&at, asked.clone()).unwrap();
        let n = asked.trials().len();
        assert_eq!(folder.missing().unwrap(), (0..n).collect::<Vec<_>>());
        folder.note(1, "playing steps: 3 of 60").unwrap();
        folder.fail(2, "the world failed").unwrap();
        assert_eq!(folder.failure(2).as_deref(), Some("the world failed"));
        folder.keep(1, &rows().into()).unwrap();
        let again = Folder::begin(&at, asked.clone()).unwrap();
        assert_eq!((again.noted(1), again.missing().unwrap().len()), (None, n - 1));
        assert_eq!(again.rows().unwrap(), rows());
        let other = named("weights").unwrap();
        assert!(matches!(Folder::begin(&at, other), Err(FolderError::Other(_))));
    }

    #[test]
    fn what_is_done_is_collected_into_tables_words_and_figures() {
        let dir = tempfile::tempdir().unwrap();
        let asked = named("q3-justifications").unwrap().at(Scale::Toy);
        let folder = Folder::begin(dir.path(), asked).unwrap();
        folder.keep(0, &rows().into()).unwrap();
        let words = folder.collect().unwrap();
        assert!(words.contains("DROPJ"), "{words}");
        for file in
            ["results.csv", "results.parquet", "summary.md", "figures/return.svg", "figures/return.png"]
        {
            assert!(dir.path().join(file).is_file(), "{file}");
        }
        let curves = dir.path().join("curves");
        let all = || -> Vec<Option<Vec<u8>>> {
            let names = crate::run::names_in(&curves).unwrap();
            let file = |name: String| curves.join(name).join(crate::run::curves::NAME);
            names.into_iter().map(|name| read_at_most(&file(name), 1 << 20).unwrap()).collect()
        };
        let once: Vec<usize> = all().into_iter().map(|bytes| bytes.unwrap().len()).collect();
        assert!(!once.is_empty());
        folder.collect().unwrap();
        let again: Vec<usize> = all().into_iter().map(|bytes| bytes.unwrap().len()).collect();
        assert_eq!(again, once, "collected again, not twice as much");
        // Damage is said, with its place.
        write_whole(&dir.path().join("trials/0000.jsonl"), b"{\"trial\": ").unwrap();
        assert!(folder.collect().unwrap_err().to_string().contains("0000.jsonl"));
    }
}
