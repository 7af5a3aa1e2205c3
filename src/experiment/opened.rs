//! Results that are set beside others: folders of experiments, what `dropj deploy --json` printed, and curves of fits.
//!
//! Whatever they come from, they are [`Run`]s of episodes afterwards: each says which seed of the chain it was learned by
//! and which track it drove, where that is known.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

use super::comparison::{Driven, Group};
use super::description::Axis;
use super::folder::{Folder, FolderError};
use super::read_csv::CsvError;
use super::summary::{Series, series};
use super::table::{Measure, Row, Rows};
use crate::evaluation::{EpisodeMetrics, EventFigure, Results};
use crate::run::{names_in, read_at_most};
use crate::text::{decoded, shown};

/// Bytes of a file of results at the most.
const MOST: u64 = 1 << 28;
/// Files of results of a folder that are opened at once.
const MOST_FILES: usize = 64;
/// Points of a curve that are kept: a plot has fewer columns.
const MOST_POINTS: usize = 2000;
/// What describes the experiment of a folder.
const DESCRIPTION: &str = "experiment.toml";
/// Where a fit logs how it goes.
const METRICS: &str = "metrics.jsonl";
/// What a folder of an experiment holds beside its description.
const IN_FOLDER: [&str; 4] = [DESCRIPTION, "results.csv", "results.parquet", "summary.md"];

/// An episode of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct RunEpisode {
    /// The seed of the chain that was learned by, where it is known.
    pub seed: Option<u64>,
    /// The seed of the episode, where it is known.
    pub track: Option<u64>,
    /// How it went.
    pub metrics: EpisodeMetrics,
}

/// Episodes that were driven in one way.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Run {
    /// What tells it from others of the same results; nothing where there are none.
    pub name: String,
    /// In their order.
    pub episodes: Vec<RunEpisode>,
}

impl Run {
    /// Its episodes that have a value of `measure`.
    pub fn group(&self, name: &str, measure: &Measure) -> Group {
        let driven = |it: &RunEpisode| {
            let value = measure.in_episode(&it.metrics)?;
            Some(Driven { seed: it.seed, track: it.track, value })
        };
        Group { name: name.to_owned(), episodes: self.episodes.iter().filter_map(driven).collect() }
    }
}

/// What an experiment measured over its axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Curves {
    /// The axis.
    pub axis: Axis,
    /// For each measure its series.
    pub of: Vec<(Measure, Vec<Series>)>,
}

/// A curve of a fit: what it shows, and its points over epochs.
pub type Loss = (String, Vec<[f64; 2]>);

/// Results that were read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Opened {
    /// Where they are.
    pub path: PathBuf,
    /// A name for people.
    pub name: String,
    /// What they are, in a few words.
    pub about: String,
    /// The world that was driven in, where it is known.
    pub world: Option<String>,
    /// The episodes.
    pub runs: Vec<Run>,
    /// Over the axis of an experiment, where it has one with numbers.
    pub curves: Option<Curves>,
    /// Curves of a fit.
    pub losses: Vec<Loss>,
    /// What was passed over, in sentences.
    pub notes: Vec<String>,
}

/// Why nothing is opened.
#[derive(Debug, thiserror::Error)]
pub enum ResultsError {
    /// The folder of an experiment cannot be read.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// A file cannot be read.
    #[error("cannot read the results {path:?}: {met}")]
    Read {
        /// Which.
        path: PathBuf,
        /// What was met.
        met: std::io::Error,
    },
    /// A file is too long.
    #[error("this is longer than any file of results: {0:?}")]
    TooLong(PathBuf),
    /// A table is none of an experiment.
    #[error(
        "{path:?} is no table of an experiment ({met}): write it anew with `dropj experiment --collect --out FOLDER`"
    )]
    Table {
        /// Which.
        path: PathBuf,
        /// What was met.
        met: CsvError,
    },
    /// An experiment has no row.
    #[error("no trial of the experiment in {0:?} is done yet")]
    NoTrial(PathBuf),
    /// A file has no episode.
    #[error("there are no episodes in these results, for {why}: {path:?}")]
    NoEpisode {
        /// Which.
        path: PathBuf,
        /// Why.
        why: String,
    },
    /// A log of a fit has no curve.
    #[error("there is no curve in this log of a fit: {0:?}")]
    NoCurve(PathBuf),
    /// It is nothing of the kind.
    #[error(
        "these are no results: wanted is the folder of an experiment, what `dropj deploy --json` printed, or the folder of a \
         fit: {0:?}"
    )]
    Other(PathBuf),
}

/// Whether what is at `path` looks like results.
pub fn is_results(path: &Path) -> bool {
    place(path).is_some()
}

/// What is at a path.
enum Place {
    Experiment(PathBuf),
    Fit(PathBuf),
    Episodes(Vec<PathBuf>),
}

fn place(path: &Path) -> Option<Place> {
    if path.is_dir() {
        if path.join(DESCRIPTION).is_file() {
            return Some(Place::Experiment(path.to_owned()));
        }
        if path.join(METRICS).is_file() {
            return Some(Place::Fit(path.join(METRICS)));
        }
        let names = names_in(path).ok().filter(|_| !path.join("meta").exists())?;
        let files: Vec<_> = names.iter().map(|name| path.join(name)).filter(|file| is_json(file)).collect();
        return (!files.is_empty()).then_some(Place::Episodes(files));
    }
    let name = path.file_name()?.to_str()?;
    let folder = path.parent().filter(|dir| IN_FOLDER.contains(&name) && dir.join(DESCRIPTION).is_file());
    match folder {
        Some(dir) => Some(Place::Experiment(dir.to_owned())),
        None if name == METRICS => Some(Place::Fit(path.to_owned())),
        None => is_json(path).then(|| Place::Episodes(vec![path.to_owned()])),
    }
}

fn is_json(path: &Path) -> bool {
    let end = path.extension().and_then(std::ffi::OsStr::to_str);
    end.is_some_and(|end| ["json", "jsonl", "ndjson"].contains(&end)) && path.is_file()
}

impl Opened {
    /// What is at `path`.
    ///
    /// # Errors
    /// Where it is no results, or damaged.
    pub fn read(path: &Path) -> Result<Self, ResultsError> {
        match place(path) {
            Some(Place::Experiment(dir)) => experiment(&dir),
            Some(Place::Fit(file)) => fit(&file),
            Some(Place::Episodes(files)) => episodes(path, &files),
            None => Err(ResultsError::Other(path.to_owned())),
        }
    }

    /// What figures can show of these runs: the return, what is unsafe, and each event.
    pub fn measures<'a>(all: impl IntoIterator<Item = &'a Run>) -> Vec<Measure> {
        let mut keys: Vec<String> = Vec::new();
        let (mut n, mut n_unsafe) = (0, 0);
        let mut same: BTreeMap<String, usize> = BTreeMap::new();
        for metrics in all.into_iter().flat_map(|run| &run.episodes).map(|episode| &episode.metrics) {
            n += 1;
            n_unsafe += usize::from(metrics.unsafe_rate.is_finite());
            for figure in &metrics.events {
                let key = figure.key();
                *same.entry(key.clone()).or_default() +=
                    usize::from(figure.value == Some(metrics.unsafe_rate));
                if figure.value.is_some() && !keys.contains(&key) {
                    keys.push(key);
                }
            }
        }
        // Where only one thing must not happen, what is unsafe is that.
        let is_told = n_unsafe == 0 || keys.iter().any(|key| same.get(key) == Some(&n));
        let events = keys.into_iter().map(Measure::Event);
        [Measure::Return].into_iter().chain((!is_told).then_some(Measure::Unsafe)).chain(events).collect()
    }
}

fn bytes(path: &Path) -> Result<Vec<u8>, ResultsError> {
    let read = read_at_most(path, MOST).map_err(|met| ResultsError::Read { path: path.to_owned(), met })?;
    read.ok_or_else(|| ResultsError::TooLong(path.to_owned()))
}

/// The name of a folder, or of a file without its end.
fn name(path: &Path, is_file: bool) -> String {
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let name = if is_file { absolute.file_stem() } else { absolute.file_name() };
    shown(&name.map_or_else(|| absolute.to_string_lossy(), |name| name.to_string_lossy()))
}

fn experiment(dir: &Path) -> Result<Opened, ResultsError> {
    let folder = Folder::open(dir)?;
    let mut rows = folder.rows()?;
    let table = dir.join("results.csv");
    if rows.0.is_empty() && table.is_file() {
        // As it is handed on, without what each trial brought.
        rows = Rows::from_csv(&decoded(&bytes(&table)?))
            .map_err(|met| ResultsError::Table { path: table, met })?;
    }
    if rows.0.is_empty() {
        return Err(ResultsError::NoTrial(dir.to_owned()));
    }
    let description = &folder.description;
    let axis = description.axis;
    let of = rows.measures().into_iter().map(|measure| {
        let all = series(description, &rows, &measure);
        (measure, all)
    });
    let curves = Curves { axis, of: of.collect() };
    let has_axis = axis != Axis::Variants;
    Ok(Opened {
        path: dir.to_owned(),
        name: name(dir, false),
        about: description.title.clone(),
        world: Some(description.world.clone()),
        runs: runs(&curves, &rows),
        curves: Some(curves).filter(|_| has_axis),
        ..Opened::default()
    })
}

/// The episodes of each series at its last place, where the most is known.
fn runs(curves: &Curves, rows: &Rows) -> Vec<Run> {
    let (axis, differing) = (curves.axis, rows.differing());
    let Some((_, all)) = curves.of.first() else { return Vec::new() };
    let mut runs: Vec<(f64, Run)> = all
        .iter()
        .filter_map(|(name, points)| {
            Some((points.last()?.x, Run { name: name.clone(), episodes: Vec::new() }))
        })
        .collect();
    for row in &rows.0 {
        let name = row.series(axis, &differing);
        let is_there = |(x, run): &&mut (f64, Run)| {
            run.name == name && row.x(axis).is_none_or(|of_row| (of_row - x).abs() < 1e-2)
        };
        if let Some((_, run)) = runs.iter_mut().find(is_there) {
            run.episodes.push(RunEpisode {
                seed: Some(row.seed),
                track: Some(row.track),
                metrics: metrics(row),
            });
        }
    }
    runs.into_iter().map(|(_, run)| run).collect()
}

fn metrics(row: &Row) -> EpisodeMetrics {
    let event = |(key, value): (&String, &Option<f64>)| {
        Some(EventFigure { value: value.map(|value| value as f32), ..EventFigure::of_key(key)? })
    };
    EpisodeMetrics {
        ret: row.ret as f32,
        unsafe_rate: row.unsafe_rate as f32,
        events: row.events.iter().filter_map(event).collect(),
        n_steps: row.steps,
        ..EpisodeMetrics::default()
    }
}

/// Files of driven episodes, a run each.
fn episodes(path: &Path, files: &[PathBuf]) -> Result<Opened, ResultsError> {
    let (mut runs, mut notes) = (Vec::new(), Vec::new());
    for file in files.iter().take(MOST_FILES) {
        let Results { episodes, tracks, notes: of_file } = Results::parse(&bytes(file)?);
        if episodes.is_empty() {
            let why = of_file.into_iter().next().unwrap_or_else(|| "they are empty".to_owned());
            return Err(ResultsError::NoEpisode { path: file.clone(), why });
        }
        let name = name(file, true);
        notes.extend(of_file.into_iter().map(|note| format!("{name}: {note}")));
        let driven = episodes.into_iter().zip(tracks);
        let episodes = driven.map(|(metrics, track)| RunEpisode { seed: None, track, metrics }).collect();
        runs.push(Run { name, episodes });
    }
    if files.len() > MOST_FILES {
        notes.push(format!("{} more files in this folder are left out", files.len() - MOST_FILES));
    }
    let is_file = path.is_file();
    if is_file && let Some(run) = runs.first_mut() {
        // Its results have the name already.
        run.name.clear();
    }
    let about = "driven episodes".to_owned();
    Ok(Opened { path: path.to_owned(), name: name(path, is_file), about, runs, notes, ..Opened::default() })
}

/// The log of a fit: losses over epochs.
fn fit(file: &Path) -> Result<Opened, ResultsError> {
    let text = bytes(file)?;
    let mut losses: Vec<Loss> = Vec::new();
    for line in decoded(&text).lines() {
        let Ok(Value::Object(object)) = serde_json::from_str::<Value>(line) else { continue };
        let Some(x) = epochs(&object) else { continue };
        let stage = object.get("stage").and_then(Value::as_str).map(shown).unwrap_or_default();
        for key in ["loss", "held_out"] {
            let Some(y) = object.get(key).and_then(Value::as_f64) else { continue };
            let name = format!("{} {}", stage, key.replace('_', " ")).trim().to_owned();
            match losses.iter_mut().find(|(known, _)| *known == name) {
                Some((_, points)) => points.push([x, y]),
                None => losses.push((name, vec![[x, y]])),
            }
        }
    }
    if losses.is_empty() {
        return Err(ResultsError::NoCurve(file.to_owned()));
    }
    for (_, points) in &mut losses {
        let every = points.len().div_ceil(MOST_POINTS);
        *points = points.iter().copied().step_by(every).collect();
    }
    let dir = file.parent().unwrap_or(file);
    let (path, about) = (dir.to_owned(), "a fit of a world model".to_owned());
    Ok(Opened { path, name: name(dir, false), about, losses, ..Opened::default() })
}

/// Epochs behind a line of a log, parts of one too.
fn epochs(object: &Map<String, Value>) -> Option<f64> {
    let number = |key: &str| object.get(key).and_then(Value::as_f64);
    let share = number("done").zip(number("n")).filter(|(_, n)| *n > 0.0).map_or(0.0, |(done, n)| done / n);
    Some(number("epoch")? + share)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::table::made_up::rows;
    use crate::experiment::{Scale, named};
    use crate::run::{make_folder, write_whole};

    fn line(track: u64, ret: f32) -> String {
        format!(
            "{{\"track\": {track}, \"metrics\": {{\"ret\": {ret}, \"bump_rate\": 0.25, \"n_steps\": 9}}}}\n"
        )
    }

    #[test]
    fn an_experiment_is_opened_from_its_trials_or_from_its_table_alike() {
        let dir = tempfile::tempdir().unwrap();
        let asked = named("q3-justifications").unwrap().at(Scale::Toy);
        let folder = Folder::begin(&dir.path().join("run"), asked.clone()).unwrap();
        assert!(matches!(Opened::read(folder.dir()), Err(ResultsError::NoTrial(_))));
        folder.keep(0, &rows().into()).unwrap();
        folder.collect().unwrap();
        let opened = Opened::read(folder.dir()).unwrap();
        let names: Vec<_> = opened.runs.iter().map(|run| (run.name.as_str(), run.episodes.len())).collect();
        assert_eq!(names, [("DROP", 6), ("DROPJ", 6)], "with the most answers");
        assert_eq!(
            opened.curves.as_ref().map(|curves| (curves.axis, curves.of.len())),
            Some((Axis::Answers, 3))
        );

        let handed_on = dir.path().join("handed on/run");
        make_folder(&handed_on).unwrap();
        write_whole(&handed_on.join(DESCRIPTION), asked.to_toml().as_bytes()).unwrap();
        write_whole(&handed_on.join("results.csv"), rows().to_csv().as_bytes()).unwrap();
        let again = Opened::read(&handed_on.join("results.csv")).unwrap();
        assert_eq!(again.runs[1].group("x", &Measure::Return), opened.runs[1].group("x", &Measure::Return));
        assert_eq!(again.curves, opened.curves);

        write_whole(&handed_on.join("results.csv"), b"trial,method\n0,dro").unwrap();
        let met = Opened::read(&handed_on).unwrap_err().to_string();
        assert!(met.contains("results.csv") && met.contains("line 2"), "{met}");
    }

    #[test]
    fn files_of_episodes_are_a_run_each_and_one_that_holds_none_is_said() {
        let dir = tempfile::tempdir().unwrap();
        write_whole(&dir.path().join("a.json"), (line(3, 10.0) + &line(4, 20.0)).as_bytes()).unwrap();
        write_whole(&dir.path().join("b.json"), line(3, 30.0).as_bytes()).unwrap();
        let opened = Opened::read(dir.path()).unwrap();
        assert_eq!(opened.runs.iter().map(|run| run.name.as_str()).collect::<Vec<_>>(), ["a", "b"]);
        assert_eq!(opened.runs[0].episodes[1].track, Some(4));
        let one = Opened::read(&dir.path().join("b.json")).unwrap();
        assert_eq!((one.name.as_str(), one.runs[0].name.as_str()), ("b", ""));
        assert_eq!(
            Opened::measures(&opened.runs),
            [Measure::Return, Measure::Event("bump_rate".to_owned())],
            "nothing is known of what was unsafe"
        );
        write_whole(&dir.path().join("c.json"), b"{\"summary\": {}}").unwrap();
        let met = Opened::read(&dir.path().join("c.json")).unwrap_err().to_string();
        assert!(
            met.contains("there is only the summary of episodes in it") && met.contains("c.json"),
            "{met}"
        );
        write_whole(&dir.path().join("d.txt"), b"hello").unwrap();
        assert!(matches!(Opened::read(&dir.path().join("d.txt")), Err(ResultsError::Other(_))));
        assert!(!is_results(&dir.path().join("gone.json")));
    }

    #[test]
    fn the_log_of_a_fit_is_curves_over_epochs() {
        let dir = tempfile::tempdir().unwrap();
        let log = "{\"stage\":\"Vision\",\"epoch\":0,\"done\":5,\"n\":10,\"loss\":2.0,\"held_out\":null}\n\
                   {\"stage\":\"Vision\",\"epoch\":1,\"done\":0,\"n\":10,\"loss\":1.0,\"held_out\":1.5}\n{\"sta";
        write_whole(&dir.path().join(METRICS), log.as_bytes()).unwrap();
        let opened = Opened::read(dir.path()).unwrap();
        let expected = [("Vision loss", vec![[0.5, 2.0], [1.0, 1.0]]), ("Vision held out", vec![[1.0, 1.5]])];
        assert_eq!(opened.losses, expected.map(|(name, points)| (name.to_owned(), points)));
        assert!(opened.runs.is_empty());
        write_whole(&dir.path().join(METRICS), b"nothing").unwrap();
        assert!(matches!(Opened::read(dir.path()), Err(ResultsError::NoCurve(_))));
    }
}
