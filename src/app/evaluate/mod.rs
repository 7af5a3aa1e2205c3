//! Runs side by side: opening and closing them, what they come to, and driven episodes looked at again.
//!
//! Results come from files, which a job reads, and from the planner itself: what it drives in this window is a run, too,
//! one for each session.

mod replay;
mod shown;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

pub(crate) use replay::{DrivenHere, Replay};
pub(crate) use shown::{Shown, ShownRun};

use crate::app::session::is_same;
use crate::app::{App, Effect, Field, Panel, Purpose, State, counted};
use crate::evaluation::{EpisodeMetrics, Results as FoundResults};
use crate::experiment::side_by_side::Part;
use crate::experiment::{Measure, Opened, Run, RunEpisode};
use crate::text::shown as safely;
use crate::worker::{JobCommand, WorkerError};
use crate::world::Action;

/// On runs that are set side by side.
#[derive(Clone, Debug, PartialEq)]
pub enum EvaluateCommand {
    /// Opens the results in a folder or a file.
    Open(PathBuf),
    /// Closes results.
    Close(u64),
    /// Calls results something else.
    Rename(u64, String),
    /// Leaves a run out of figures and tests, or takes it in again.
    Hide {
        /// Of which results.
        results: u64,
        /// The number of the run in them.
        run: usize,
        /// Whether it is left out.
        is_hidden: bool,
    },
    /// Shows another measure.
    Measure(Measure),
    /// Puts the runs in the order of the measure, or as they were opened.
    Sort(bool),
    /// Drives an episode of this window again to look at it, by its number among all, or looks at none any longer.
    Watch(Option<usize>),
    /// Asks where to save something.
    Save(Part),
    /// Saves everything into the folder that is named.
    SaveAll,
}

/// Results that are open.
#[derive(Clone, Debug)]
pub(crate) struct Results {
    /// By which they are known.
    pub id: u64,
    /// What somebody calls them.
    pub name: String,
    pub opened: Arc<Opened>,
    /// Runs that are left out, by their numbers.
    hidden: BTreeSet<usize>,
    origin: Origin,
}

/// Where results come from.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Origin {
    /// They were read.
    Files,
    /// The planner drove in this window, by the reward of the session in this folder, if there was one.
    Session(Option<PathBuf>),
}

/// Runs side by side.
#[derive(Debug)]
pub(crate) struct Evaluating {
    /// In the order of opening.
    pub results: Vec<Results>,
    /// How many are being read.
    pub n_reading: usize,
    pub measure: Measure,
    pub is_sorted: bool,
    /// What they come to.
    pub shown: Shown,
    /// Episodes that were driven in this window.
    pub driven: Vec<DrivenHere>,
    pub replay: Option<Replay>,
    next: u64,
}

impl Default for Evaluating {
    fn default() -> Self {
        Self {
            results: Vec::new(),
            n_reading: 0,
            measure: Measure::Return,
            is_sorted: false,
            shown: Shown::default(),
            driven: Vec::new(),
            replay: None,
            next: 0,
        }
    }
}

impl Evaluating {
    /// What is shown anew after a change.
    fn refresh(&mut self) {
        let (measure, shown) = Shown::of(&self.results, &self.measure, self.is_sorted);
        (self.measure, self.shown) = (measure, shown);
    }

    fn push(&mut self, opened: Opened, origin: Origin) {
        let id = self.next;
        self.next += 1;
        let name = self.free_name(&opened.name);
        self.results.push(Results { id, name, opened: Arc::new(opened), hidden: BTreeSet::new(), origin });
    }

    /// `name`, with a number where others are called so.
    fn free_name(&self, name: &str) -> String {
        let is_free = |name: &String| !self.results.iter().any(|known| known.name == *name);
        let numbered = (2..).map(|n| format!("{name} ({n})"));
        std::iter::once(name.to_owned()).chain(numbered).find(is_free).unwrap_or_default()
    }
}

impl State {
    /// The names of runs that are set side by side, and whether each is shown: for tests.
    pub fn evaluated(&self) -> Vec<(String, bool)> {
        self.evaluate.shown.runs.iter().map(|run| (run.name.clone(), !run.is_hidden)).collect()
    }

    /// What the tests say of each two runs that are shown, in words: for tests.
    pub fn verdicts(&self) -> Vec<&'static str> {
        let found = self.evaluate.shown.comparison.as_ref();
        found.map_or_else(Vec::new, |found| found.pairs.iter().map(|pair| pair.verdict.in_words()).collect())
    }
}

impl App {
    pub(super) fn evaluate_command(&mut self, command: EvaluateCommand) {
        let evaluate = &mut self.state.evaluate;
        match command {
            EvaluateCommand::Open(path) => return self.open_results(path),
            EvaluateCommand::Watch(which) => return self.watch_driven(which),
            EvaluateCommand::Save(part) => return self.ask_where_to_save(part),
            EvaluateCommand::SaveAll => {
                let path = self.state.field(Field::FiguresOut).trim().into();
                return self.save_results(Part::All, path);
            }
            EvaluateCommand::Close(id) => {
                evaluate.results.retain(|results| results.id != id);
                evaluate.driven.retain(|driven| driven.results != id);
            }
            EvaluateCommand::Rename(id, name) => {
                if let Some(results) = evaluate.results.iter_mut().find(|results| results.id == id) {
                    results.name = name;
                }
            }
            EvaluateCommand::Hide { results: id, run, is_hidden } => {
                if let Some(results) = evaluate.results.iter_mut().find(|results| results.id == id) {
                    if is_hidden {
                        results.hidden.insert(run);
                    } else {
                        results.hidden.remove(&run);
                    }
                }
            }
            EvaluateCommand::Measure(measure) => evaluate.measure = measure,
            EvaluateCommand::Sort(is_sorted) => evaluate.is_sorted = is_sorted,
        }
        self.state.evaluate.refresh();
    }

    fn open_results(&mut self, path: PathBuf) {
        self.state.evaluate.n_reading += 1;
        self.job(JobCommand::OpenResults(path));
    }

    /// Results were read: they are shown beside the others, in the place of what was read from there before.
    pub(super) fn results_read(&mut self, read: Result<Box<Opened>, WorkerError>) {
        let evaluate = &mut self.state.evaluate;
        evaluate.n_reading = evaluate.n_reading.saturating_sub(1);
        let opened = match read {
            Ok(opened) => *opened,
            Err(error) => return self.fail(error.to_string()),
        };
        let (notes, said) = (opened.notes.clone(), format!("{} is open", opened.name));
        let is_known =
            |known: &&mut Results| known.origin == Origin::Files && is_same(&known.opened.path, &opened.path);
        match evaluate.results.iter_mut().find(is_known) {
            Some(known) => {
                known.hidden.retain(|run| *run < opened.runs.len());
                known.opened = Arc::new(opened);
            }
            None => evaluate.push(opened, Origin::Files),
        }
        evaluate.refresh();
        self.show(Panel::Evaluate);
        self.done(said);
        for note in notes {
            self.warn(note);
        }
    }

    /// The planner has driven an episode to its end: it is one of the run of its session.
    pub(super) fn episode_driven(&mut self, seed: u64, metrics: &EpisodeMetrics, actions: Arc<[Action]>) {
        let dir = self.state.open.as_ref().map(|open| open.dir.clone());
        let n_answers = self.state.reward.n_learned;
        let episode = RunEpisode { seed: None, track: Some(seed), metrics: metrics.clone() };
        let results = self.add_driven(dir, vec![episode]);
        let evaluate = &mut self.state.evaluate;
        evaluate.driven.push(DrivenHere { seed, metrics: metrics.clone(), actions, n_answers, results });
        evaluate.refresh();
    }

    /// What was driven by the reward of the session in `dir` when it was open before: a run, unless there is one of it already.
    pub(super) fn recall_driven(&mut self, dir: &Path, lines: &[u8]) {
        let found = FoundResults::parse(lines);
        for note in &found.notes {
            self.warn(format!("of what was driven before, {note}"));
        }
        let episodes: Vec<_> = found.tracks.iter().copied().zip(found.episodes).collect();
        self.state.deploy.episodes =
            episodes.iter().map(|(track, metrics)| (track.unwrap_or_default(), metrics.clone())).collect();
        let origin = Origin::Session(Some(dir.to_owned()));
        let is_there = self.state.evaluate.results.iter().any(|results| results.origin == origin);
        if !episodes.is_empty() && !is_there {
            let run = episodes.into_iter().map(|(track, metrics)| RunEpisode { seed: None, track, metrics });
            self.add_driven(Some(dir.to_owned()), run.collect());
            self.state.evaluate.refresh();
        }
    }

    /// Adds episodes to the run of the session in `dir`, and returns the number of its results.
    fn add_driven(&mut self, dir: Option<PathBuf>, episodes: Vec<RunEpisode>) -> u64 {
        let world = self.state.spec.name.clone();
        let evaluate = &mut self.state.evaluate;
        let name = dir.as_ref().and_then(|dir| dir.file_name());
        let name = name.map_or("this window".to_owned(), |name| safely(&name.to_string_lossy()));
        let origin = Origin::Session(dir);
        let place = evaluate.results.iter().position(|results| results.origin == origin);
        let place = place.unwrap_or_else(|| {
            let about = "driven in this window".to_owned();
            let opened =
                Opened { name, about, world: Some(world), runs: vec![Run::default()], ..Opened::default() };
            evaluate.push(opened, origin);
            evaluate.results.len() - 1
        });
        let results = &mut evaluate.results[place];
        Arc::make_mut(&mut results.opened).runs[0].episodes.extend(episodes);
        results.id
    }

    fn ask_where_to_save(&mut self, part: Part) {
        let measure = self.state.evaluate.measure.slug();
        let name = match part {
            Part::Table => "runs.csv".to_owned(),
            Part::Distribution => format!("distribution_{measure}.svg"),
            Part::Curves => format!("curves_{measure}.svg"),
            Part::Losses => "losses.svg".to_owned(),
            Part::All => self.state.field(Field::FiguresOut).to_owned(),
        };
        self.effects.push(Effect::OpenDialog(Purpose::Save(part), name));
    }

    pub(super) fn save_results(&mut self, part: Part, path: PathBuf) {
        if path.as_os_str().is_empty() {
            return self.warn("name the folder to save into first".to_owned());
        }
        let shown = Box::new(self.state.evaluate.shown.to_save(&self.state.evaluate.measure));
        self.job(JobCommand::SaveResults { part, path, shown });
    }

    pub(super) fn results_saved(&mut self, saved: Result<String, WorkerError>) {
        match saved {
            Ok(said) => self.done(said),
            Err(error) => self.fail(error.to_string()),
        }
    }
}

/// How many runs are open, in words.
pub(crate) fn n_open(state: &State) -> String {
    let evaluate = &state.evaluate;
    match (evaluate.n_reading, evaluate.shown.runs.len()) {
        (0, 0) if evaluate.results.is_empty() => "compare runs".to_owned(),
        (0, n) => counted(n, "run"),
        _ => "reading results".to_owned(),
    }
}
