//! What came of an experiment: a row for each driven episode, as lines of JSON, CSV and Parquet.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::description::{Annotators, Axis, Fit, Plans};
use crate::dataset::{TableColumn, table_bytes};
use crate::evaluation::EpisodeMetrics;
use crate::query::{Protocol, Strategy};

/// An episode, and what drove it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Row {
    /// The number of its trial.
    pub trial: usize,
    /// What was asked.
    pub method: Protocol,
    /// How pairs were chosen.
    pub strategy: Strategy,
    /// The seed of the chain.
    pub seed: u64,
    /// Answers, skipped ones too.
    pub answers: usize,
    /// The time that they take a person, by the paper's Table 2.
    pub minutes: f64,
    /// Answers from which something was learned.
    pub labels: usize,
    /// What they weigh, where that is not what the world's file says.
    pub weights: String,
    /// Whether these weights were found by a search.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub found: bool,
    /// From how many recorded episodes the world model was learned, where it was learned for this.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recorded: Option<usize>,
    /// What that model can: `vision_loss`, …
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub world_model: BTreeMap<String, f64>,
    /// Share of wrong answers to critical queries.
    pub critical_mistakes: f64,
    /// Share of wrong answers to all others.
    pub other_mistakes: f64,
    /// Who answered.
    pub annotators: Annotators,
    /// How it was learned.
    pub fit: Fit,
    /// How it was driven.
    pub planner: Plans,
    /// Share of answers that differ in what is safe from those of the trial's own annotator, where others answered.
    pub critical_disagreement: Option<f64>,
    /// Share of answers that differ otherwise.
    pub other_disagreement: Option<f64>,
    /// How diverse the trajectories of the chain are that were labeled step by step, imagined again without noise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub diversity: Option<f64>,
    /// The seed of the episode.
    pub track: u64,
    /// The sum of the world's rewards.
    pub ret: f64,
    /// Share of steps in which something went on that must not happen.
    pub unsafe_rate: f64,
    /// What else happened: `bump_rate`, …
    pub events: BTreeMap<String, Option<f64>>,
    /// How long it was.
    pub steps: usize,
}

/// The rows of an experiment, in the order of its trials.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rows(pub Vec<Row>);

/// What a figure shows of an episode.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Measure {
    /// The return.
    Return,
    /// The share of unsafe steps.
    Unsafe,
    /// An event, by its key.
    Event(String),
    /// How diverse labeled trajectories are.
    Diversity,
    /// What the world model can, by its key in [`WORLD_MODEL`].
    WorldModel(&'static str),
}

/// What is measured of a world model that was learned for an experiment, all on the same held-out episodes: keys and words.
pub const WORLD_MODEL: [(&str, &str); 5] = [
    ("vision_loss", "held-out loss of vision (squared error and divergence)"),
    ("memory_loss", "held-out loss of memory (nats a latent)"),
    ("seen_error", "error of pixels seen again (of 1)"),
    ("dreamed_error", "error of pixels dreamed 25 steps ahead (of 1)"),
    ("probe_accuracy", "what the stand-in tells rightly in its pictures"),
];

impl Measure {
    /// Its value in an episode.
    pub fn of(&self, row: &Row) -> Option<f64> {
        match self {
            Self::Return => Some(row.ret),
            Self::Unsafe => Some(row.unsafe_rate),
            Self::Event(key) => row.events.get(key).copied().flatten(),
            Self::Diversity => row.diversity,
            Self::WorldModel(key) => row.world_model.get(*key).copied(),
        }
        .filter(|value| value.is_finite())
    }

    /// Its value in the figures of an episode.
    pub fn in_episode(&self, metrics: &EpisodeMetrics) -> Option<f64> {
        let value = match self {
            Self::Return => Some(metrics.ret),
            Self::Unsafe => Some(metrics.unsafe_rate),
            Self::Event(key) => metrics.events.iter().find(|figure| figure.key() == *key)?.value,
            Self::Diversity | Self::WorldModel(_) => None,
        };
        value.map(f64::from).filter(|value| value.is_finite())
    }

    /// As people read it.
    pub fn title(&self) -> String {
        match self {
            Self::Return => "return".to_owned(),
            Self::Unsafe => "unsafe steps".to_owned(),
            Self::Diversity => "diversity of trajectories".to_owned(),
            Self::WorldModel(key) => {
                let known = WORLD_MODEL.iter().find(|(known, _)| known == key);
                known.map_or(*key, |(_, words)| words).to_owned()
            }
            Self::Event(key) => key.trim_end_matches("_rate").trim_end_matches("_count").replace('_', " "),
        }
    }

    /// Its name in those of files.
    pub fn slug(&self) -> String {
        match self {
            Self::Return => "return".to_owned(),
            Self::Unsafe => "unsafe".to_owned(),
            Self::Diversity => "diversity".to_owned(),
            Self::WorldModel(key) => (*key).to_owned(),
            Self::Event(key) => key.clone(),
        }
    }

    /// Whether it is one of the world model, whatever was learned in it.
    pub fn is_of_world_model(&self) -> bool {
        matches!(self, Self::WorldModel(_))
    }

    /// Whether it is a share, which is shown in percent.
    pub fn is_share(&self) -> bool {
        match self {
            Self::Return | Self::Diversity => false,
            Self::WorldModel(key) => *key == "probe_accuracy",
            Self::Unsafe => true,
            Self::Event(key) => key.ends_with("_rate"),
        }
    }

    /// A value as people read it.
    pub fn shown(&self, value: f64) -> String {
        match self {
            _ if self.is_share() => format!("{:.1} %", 100.0 * value),
            Self::Diversity => format!("{value:.2}"),
            Self::WorldModel(_) => format!("{value:.3}"),
            _ => format!("{value:.0}"),
        }
    }
}

impl Row {
    /// What it is in a figure over `axis`: all that differs but the seed and the axis.
    pub fn series(&self, axis: Axis, differing: &Differing) -> String {
        let mut parts = Vec::new();
        let mut say = |is: bool, text: String| parts.extend((is && !text.is_empty()).then_some(text));
        if self.planner == Plans::Oracle {
            return "oracle".to_owned();
        }
        say(differing.method || differing.is_nothing(axis), self.method.name().to_owned());
        say(differing.strategy, said(&self.strategy));
        let weights = match &*self.weights {
            _ if self.found => "weights found",
            "" => "usual weights",
            weights => weights,
        };
        say(differing.weights, weights.to_owned());
        say(differing.annotators, said(&self.annotators));
        let critical = format!("{:.0} % wrong", 100.0 * self.critical_mistakes);
        say(differing.critical && axis != Axis::CriticalMistakes, format!("{critical} of critical"));
        say(differing.other, format!("{:.0} % wrong of others", 100.0 * self.other_mistakes));
        say(differing.fit, format!("fit: {}", said(&self.fit)));
        say(differing.planner, format!("planner: {}", said(&self.planner)));
        say(
            differing.answers && !matches!(axis, Axis::Answers | Axis::Minutes),
            format!("{} answers", self.answers),
        );
        let of = |n: usize| format!("{n} recorded episodes");
        say(differing.recorded && axis != Axis::Recorded, self.recorded.map(of).unwrap_or_default());
        parts.join(", ")
    }

    /// Where it is on `axis`; nothing where that has no numbers.
    pub fn x(&self, axis: Axis) -> Option<f64> {
        match axis {
            Axis::Answers => Some(self.answers as f64),
            Axis::Minutes => Some(self.minutes),
            Axis::CriticalMistakes => Some(100.0 * self.critical_mistakes),
            Axis::Recorded => self.recorded.map(|n| n as f64),
            Axis::Variants => None,
        }
    }
}

/// A plain value by its name in files.
pub(super) fn said(value: &impl Serialize) -> String {
    serde_json::to_value(value).ok().and_then(|value| Some(value.as_str()?.to_owned())).unwrap_or_default()
}

/// Along which axes the rows of an experiment differ.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[expect(clippy::struct_excessive_bools, reason = "one for each axis")]
pub struct Differing {
    method: bool,
    strategy: bool,
    weights: bool,
    annotators: bool,
    critical: bool,
    other: bool,
    fit: bool,
    planner: bool,
    answers: bool,
    recorded: bool,
}

impl Differing {
    fn is_nothing(self, axis: Axis) -> bool {
        let answers = self.answers && !matches!(axis, Axis::Answers | Axis::Minutes);
        let critical = self.critical && axis != Axis::CriticalMistakes;
        let recorded = self.recorded && axis != Axis::Recorded;
        let rest = Self { critical, answers, recorded, ..self };
        rest == Self::default()
    }
}

impl Rows {
    /// The rows in lines of JSON, an episode each.
    ///
    /// # Errors
    /// Where a line is none.
    pub fn from_lines(text: &str) -> serde_json::Result<Self> {
        from_lines(text).map(Self)
    }

    /// As [`from_lines`](Self::from_lines) reads them.
    pub fn to_lines(&self) -> String {
        to_lines(&self.0)
    }

    /// Along which axes they differ. Oracles, which learn nothing, do not count.
    pub fn differing(&self) -> Differing {
        let learned: Vec<&Row> = self.0.iter().filter(|row| row.planner != Plans::Oracle).collect();
        let differ = |of: &dyn Fn(&Row) -> String| {
            let mut all = learned.iter().map(|row| of(row));
            let first = all.next();
            all.any(|other| Some(other) != first)
        };
        Differing {
            method: differ(&|row| row.method.name().to_owned()),
            strategy: differ(&|row| said(&row.strategy)),
            weights: differ(&|row| row.weights.clone()),
            annotators: differ(&|row| said(&row.annotators)),
            critical: differ(&|row| row.critical_mistakes.to_string()),
            other: differ(&|row| row.other_mistakes.to_string()),
            fit: differ(&|row| said(&row.fit)),
            planner: differ(&|row| said(&row.planner)),
            answers: differ(&|row| row.answers.to_string()),
            recorded: differ(&|row| row.recorded.unwrap_or_default().to_string()),
        }
    }

    /// What figures can show of them.
    pub fn measures(&self) -> Vec<Measure> {
        let keys: BTreeSet<&String> = self.0.iter().flat_map(|row| row.events.keys()).collect();
        let events = keys.iter().map(|key| Measure::Event((*key).clone()));
        let of_models = WORLD_MODEL.iter().map(|(key, _)| Measure::WorldModel(key));
        let all = [Measure::Return, Measure::Unsafe].into_iter().chain(events);
        let all = all.chain([Measure::Diversity]).chain(of_models);
        let is_known = |measure: &Measure| self.0.iter().any(|row| measure.of(row).is_some());
        // Where only one thing must not happen, what is unsafe is that.
        let is_told_twice = |measure: &Measure| {
            let same =
                |key: &String| self.0.iter().all(|row| row.events.get(key) == Some(&Some(row.unsafe_rate)));
            *measure == Measure::Unsafe && keys.iter().any(|key| same(key))
        };
        all.filter(|measure| is_known(measure) && !is_told_twice(measure)).collect()
    }

    /// The columns of their table: names and values as text, an empty cell where there is none.
    fn columns(&self) -> Vec<(String, Vec<String>)> {
        let mut columns: Vec<(String, Vec<String>)> = Vec::new();
        let mut add = |name: &str, of: &dyn Fn(&Row) -> String| {
            columns.push((name.to_owned(), self.0.iter().map(of).collect()));
        };
        let some = |value: Option<f64>| value.map_or(String::new(), |value| value.to_string());
        add("trial", &|row| row.trial.to_string());
        add("method", &|row| said(&row.method));
        add("strategy", &|row| said(&row.strategy));
        add("seed", &|row| row.seed.to_string());
        add("answers", &|row| row.answers.to_string());
        add("minutes", &|row| format!("{:.3}", row.minutes));
        add("labels", &|row| row.labels.to_string());
        add("weights", &|row| row.weights.clone());
        if self.0.iter().any(|row| row.found) {
            add("found", &|row| u8::from(row.found).to_string());
        }
        if self.0.iter().any(|row| row.recorded.is_some()) {
            add("recorded", &|row| row.recorded.map_or(String::new(), |n| n.to_string()));
        }
        for (key, _) in WORLD_MODEL {
            if self.0.iter().any(|row| row.world_model.contains_key(key)) {
                add(key, &|row| some(row.world_model.get(key).copied()));
            }
        }
        add("critical_mistakes", &|row| row.critical_mistakes.to_string());
        add("other_mistakes", &|row| row.other_mistakes.to_string());
        add("annotators", &|row| said(&row.annotators));
        add("fit", &|row| said(&row.fit));
        add("planner", &|row| said(&row.planner));
        add("critical_disagreement", &|row| some(row.critical_disagreement));
        add("other_disagreement", &|row| some(row.other_disagreement));
        if self.0.iter().any(|row| row.diversity.is_some()) {
            add("diversity", &|row| some(row.diversity));
        }
        add("track", &|row| row.track.to_string());
        add("return", &|row| row.ret.to_string());
        add("unsafe_rate", &|row| row.unsafe_rate.to_string());
        for measure in self.measures() {
            if let Measure::Event(key) = &measure {
                add(key, &|row| some(measure.of(row)));
            }
        }
        add("steps", &|row| row.steps.to_string());
        columns
    }

    /// The table as CSV.
    pub fn to_csv(&self) -> String {
        csv(&self.columns())
    }

    /// The table as the bytes of a Parquet file. A missing number is NaN.
    ///
    /// # Errors
    /// Where it cannot be made.
    pub fn to_parquet(&self) -> Result<Vec<u8>, String> {
        const WHOLE: [&str; 8] =
            ["trial", "seed", "answers", "labels", "track", "steps", "recorded", "found"];
        const WORDS: [&str; 6] = ["method", "strategy", "weights", "annotators", "fit", "planner"];
        let columns = self.columns().into_iter().map(|(name, values)| {
            let column = if WORDS.contains(&&*name) {
                TableColumn::Texts(values)
            } else if WHOLE.contains(&&*name) {
                TableColumn::Ints(
                    values.iter().map(|value| value.parse::<u64>().unwrap_or(0) as i64).collect(),
                )
            } else {
                TableColumn::Floats(values.iter().map(|value| value.parse().unwrap_or(f32::NAN)).collect())
            };
            (name, column)
        });
        table_bytes(columns.collect()).map_err(|met| met.to_string())
    }
}

/// Columns, by their names, as CSV.
pub(super) fn csv(columns: &[(String, Vec<String>)]) -> String {
    let cell = |text: &str| {
        if text.contains([',', '"', '\n']) {
            format!("\"{}\"", text.replace('"', "\"\""))
        } else {
            text.to_owned()
        }
    };
    let names: Vec<_> = columns.iter().map(|(name, _)| cell(name)).collect();
    let mut csv = names.join(",") + "\n";
    for i in 0..columns.first().map_or(0, |(_, values)| values.len()) {
        let cells: Vec<_> = columns.iter().map(|(_, values)| cell(&values[i])).collect();
        let _ = writeln!(csv, "{}", cells.join(","));
    }
    csv
}

/// Values in lines of JSON, one each.
pub(super) fn to_lines<T: Serialize>(values: &[T]) -> String {
    values.iter().fold(String::new(), |mut text, value| {
        let line = serde_json::to_string(value).unwrap_or_else(|met| unreachable!("plain values: {met}"));
        text.push_str(&line);
        text.push('\n');
        text
    })
}

/// What [`to_lines`] wrote.
pub(super) fn from_lines<T: DeserializeOwned>(text: &str) -> serde_json::Result<Vec<T>> {
    text.lines().filter(|line| !line.trim().is_empty()).map(serde_json::from_str).collect()
}

#[cfg(test)]
pub(super) mod made_up {
    use super::*;

    /// An episode of a method after so many answers.
    pub(in super::super) fn row(method: Protocol, seed: u64, answers: usize, track: u64, ret: f64) -> Row {
        Row {
            trial: seed as usize,
            method,
            strategy: Strategy::Uniform,
            seed,
            answers,
            minutes: answers as f64 / 8.0,
            labels: answers,
            weights: String::new(),
            found: false,
            recorded: None,
            world_model: BTreeMap::new(),
            critical_mistakes: 0.0,
            other_mistakes: 0.0,
            annotators: Annotators::Careful,
            fit: Fit::Ours,
            planner: Plans::Ours,
            critical_disagreement: None,
            other_disagreement: None,
            diversity: None,
            track,
            ret,
            unsafe_rate: 0.25,
            events: [("bump_rate".to_owned(), Some(0.125)), ("drop_rate".to_owned(), None)].into(),
            steps: 1000,
        }
    }

    /// Two methods, three seeds, two numbers of answers and two tracks.
    pub(in super::super) fn rows() -> Rows {
        let mut rows = Vec::new();
        for seed in 0..3 {
            for (method, better) in [(Protocol::Drop, 0.0), (Protocol::Dropj, 400.0)] {
                for answers in [50, 100] {
                    for track in [100, 101] {
                        let ret = 500.0 + better + answers as f64 + 10.0 * seed as f64 + track as f64;
                        rows.push(row(method, seed, answers, track, ret));
                    }
                }
            }
        }
        Rows(rows)
    }
}

#[cfg(test)]
mod tests {
    use super::made_up::rows;
    use super::*;

    #[test]
    fn rows_survive_their_lines_and_stand_in_tables() {
        let rows = rows();
        assert_eq!(Rows::from_lines(&rows.to_lines()).unwrap(), rows);
        let csv = rows.to_csv();
        let lines: Vec<_> = csv.lines().collect();
        assert_eq!(lines.len(), 25);
        assert!(
            lines[0].starts_with("trial,method,strategy,seed,answers") && lines[0].contains(",bump_rate,")
        );
        assert!(!lines[0].contains("drop_rate"), "nobody passed one");
        assert!(lines[1].starts_with("0,drop,uniform,0,50,6.250,50,"), "{}", lines[1]);
        let parquet = rows.to_parquet().unwrap();
        assert_eq!((&parquet[..4], &parquet[parquet.len() - 4..]), (&b"PAR1"[..], &b"PAR1"[..]));
    }

    #[test]
    fn series_are_named_by_what_differs() {
        let rows = rows();
        let series = |axis| rows.0[4].series(axis, &rows.differing());
        assert_eq!(series(Axis::Answers), "DROPJ");
        assert_eq!(series(Axis::Variants), "DROPJ, 50 answers");
        let alike = Rows(rows.0[..2].to_vec());
        assert_eq!(alike.0[0].series(Axis::Answers, &alike.differing()), "DROP", "never without a name");
    }
}
