//! Lists recorded episodes, shows them step by step with their predicted rewards, and deletes them.
//!
//! One episode is in memory at a time, however many there are. It is evaluated a few steps at a time, in the
//! moments in which nothing is asked.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, TryRecvError};
use std::time::{Duration, Instant};

use crate::dataset::{Dataset, DatasetError, Episode};
use crate::dream::Rows;
use crate::tensor::{Parameters, to_vec};
use crate::worker::replayer::stretches;
use crate::worker::reward_eval::RewardEvaluator;
use crate::worker::{
    EpisodeBrowserCommand, EpisodeList, EpisodeView, Latest, OpenEpisode, RecordReport, Reports, Worker,
    WorkerError, WorkerName, one_thread,
};
use crate::world::{EventKind, WorldSpec};
use crate::world_model::{Memory, State, WorldModel, actions_tensor};

const NAME: WorkerName = WorkerName::EpisodeBrowser;
/// Steps that the world model observes before another command is received.
const CHUNK: usize = 20;
/// How long a dataset is waited for that somebody else has open: the recorder looks into it, too.
const PATIENCE: Duration = Duration::from_secs(1);
/// The same where it is torn, and the recorder may be repairing it already.
const LONG_PATIENCE: Duration = Duration::from_secs(30);
/// Between two tries.
const PAUSE: Duration = Duration::from_millis(50);

/// Starts a thread that shows steps of recorded episodes in `view`.
pub fn spawn(
    spec: Arc<WorldSpec>,
    view: Latest<EpisodeView>,
    reports: &Reports,
) -> Worker<EpisodeBrowserCommand> {
    Worker::spawn(NAME, reports, move |commands, reports| {
        browse(&commands, &reports, &spec, &view);
        Ok(())
    })
}

/// The body of the thread.
pub fn browse(
    commands: &Receiver<EpisodeBrowserCommand>,
    reports: &Reports,
    spec: &Arc<WorldSpec>,
    view: &Latest<EpisodeView>,
) {
    one_thread();
    let mut browser = EpisodeBrowser { reports, spec, view, evaluation: None, open: None };
    let mut waiting = VecDeque::new();
    loop {
        let command = waiting.pop_front().or_else(|| match commands.try_recv() {
            Ok(command) => Some(command),
            Err(TryRecvError::Disconnected) => None,
            // Nothing is asked: there is time to evaluate, if there is anything to be evaluated.
            Err(TryRecvError::Empty) => {
                while browser.evaluate_on() {
                    match commands.try_recv() {
                        Ok(command) => return Some(command),
                        Err(TryRecvError::Disconnected) => return None,
                        Err(TryRecvError::Empty) => {}
                    }
                }
                commands.recv().ok()
            }
        });
        let Some(command) = command else { return };
        waiting.extend(commands.try_iter());
        // Of steps that a hand passes over quickly, only the last is drawn; of folders that are typed, the last is read.
        let is_overtaken = match command {
            EpisodeBrowserCommand::Show(_) => waiting.iter().any(|later| {
                matches!(later, EpisodeBrowserCommand::Show(_) | EpisodeBrowserCommand::Open { .. })
            }),
            EpisodeBrowserCommand::List(_) => {
                waiting.iter().any(|later| matches!(later, EpisodeBrowserCommand::List(_)))
            }
            _ => false,
        };
        if is_overtaken {
            continue;
        }
        if let Err(e) = browser.handle(command) {
            reports.fail(NAME, e);
        }
    }
}

/// What the thread owns.
struct EpisodeBrowser<'a> {
    /// Says which events must not happen.
    spec: &'a Arc<WorldSpec>,
    reports: &'a Reports,
    view: &'a Latest<EpisodeView>,
    evaluation: Option<(WorldModel, RewardEvaluator)>,
    open: Option<Open>,
}

/// The episode that is shown.
struct Open {
    recording: String,
    episode: Episode,
    /// What the world model made of the steps so far, and its memory after them.
    features: Rows,
    memory: Option<Memory>,
    is_evaluated: bool,
}

impl EpisodeBrowser<'_> {
    fn handle(&mut self, command: EpisodeBrowserCommand) -> Result<(), WorkerError> {
        match command {
            EpisodeBrowserCommand::List(dataset) => Ok(self.list(&dataset, false)?),
            EpisodeBrowserCommand::Open { dataset, recording } => {
                self.open = None;
                let episode = match open(&dataset, self.spec, &recording) {
                    Ok(episode) => episode,
                    // The list that it was chosen from may be an old one.
                    Err(e) => return Ok(self.list(&dataset, false).and(Err(e))?),
                };
                self.reports.send(RecordReport::Opened(OpenEpisode {
                    recording: recording.clone(),
                    actions: episode.actions.clone(),
                    rewards: episode.rewards.clone(),
                    unsafe_steps: stretches(&unsafe_steps(&episode, self.spec)),
                    planned: episode.planned.clone(),
                }));
                let features = Rows { width: 0, values: Vec::new() };
                self.open = Some(Open { recording, episode, features, memory: None, is_evaluated: false });
                self.show(0);
                Ok(())
            }
            EpisodeBrowserCommand::Show(step) => {
                self.show(step);
                Ok(())
            }
            EpisodeBrowserCommand::Evaluate(None) => {
                self.evaluation = None;
                Ok(())
            }
            EpisodeBrowserCommand::Evaluate(Some((model, reward))) => self.evaluate_by(model, &reward),
            EpisodeBrowserCommand::Close => {
                self.open = None;
                Ok(())
            }
            EpisodeBrowserCommand::Delete { dataset, recording } => {
                if self.open.as_ref().is_some_and(|open| open.recording == recording) {
                    self.open = None;
                }
                let deleted = change(&dataset, PATIENCE, |dataset| match dataset.find(&recording) {
                    Some(idx) => dataset.delete(idx),
                    None => Ok(()),
                });
                self.list_after(&dataset, deleted)
            }
            EpisodeBrowserCommand::BringBack { dataset, recording } => {
                let back = change(&dataset, PATIENCE, |dataset| dataset.bring_back(&recording).map(drop));
                self.list_after(&dataset, back)
            }
        }
    }

    /// Lists the dataset after a change, however that went.
    fn list_after(&self, dataset: &Path, changed: Result<(), DatasetError>) -> Result<(), WorkerError> {
        let listed = self.list(dataset, true);
        Ok(changed.and(listed)?)
    }

    fn list(&self, dir: &Path, is_changed: bool) -> Result<(), DatasetError> {
        if Dataset::is_torn(dir) {
            // A killed program left it so. Where somebody records, that can wait.
            change(dir, LONG_PATIENCE, |_| Ok(())).unwrap_or_else(|e| log::warn!("{e}"));
        }
        let dataset = match Dataset::inspect(dir)? {
            // Perhaps it is of others.
            empty if empty.is_empty() => Dataset::open_as(dir, self.spec).unwrap_or(empty),
            ours => ours,
        };
        self.reports.send(RecordReport::Episodes(EpisodeList {
            dataset: dir.to_owned(),
            episodes: dataset.summaries().collect(),
            damaged: dataset.damaged().iter().map(ToString::to_string).collect(),
            deleted: dataset.deleted(),
            is_changed,
        }));
        Ok(())
    }

    fn show(&self, step: usize) {
        let Some(open) = &self.open else { return };
        let step = step.min(open.episode.actions.len().saturating_sub(1));
        let Some(frame) = open.episode.frames.get(step) else { return };
        self.view.put(EpisodeView { recording: open.recording.clone(), step, frame: frame.clone() });
        self.reports.wake();
    }

    fn evaluate_by(&mut self, model: Parameters, reward: &Parameters) -> Result<(), WorkerError> {
        let known = self.evaluation.take().map(|(model, _)| model);
        let known = known.filter(|known| known.hash() == model.hash());
        if known.is_none()
            && let Some(open) = &mut self.open
        {
            (open.features.values, open.memory) = (Vec::new(), None);
        }
        let model = match known {
            Some(known) => known,
            None => WorldModel::load(model)?,
        };
        let evaluator = RewardEvaluator::load(reward, &model)?;
        self.evaluation = Some((model, evaluator));
        if let Some(open) = &mut self.open {
            open.is_evaluated = false;
        }
        Ok(())
    }

    /// Goes on evaluating the open episode, and says whether there is more to do.
    fn evaluate_on(&mut self) -> bool {
        let (Some((model, evaluator)), Some(open)) = (&self.evaluation, &mut self.open) else { return false };
        let Open { episode, features, memory, .. } = open;
        // A model of another world has nothing to say.
        let is_seen = episode.info.env == model.config().env
            && episode.frames.first().is_some_and(|frame| frame.size() == model.spec().image.trained());
        if open.is_evaluated || !is_seen {
            return false;
        }
        features.width = model.config().n_features() as usize;
        let (from, n) = (features.len(), episode.actions.len());
        let steps = from..n.min(from + CHUNK);
        if steps.is_empty() {
            let rewards = evaluator.evaluate(&features.values, &episode.actions, model.ranges());
            self.reports.send(RecordReport::EpisodeRewards { recording: open.recording.clone(), rewards });
            open.is_evaluated = true;
            return false;
        }
        let zs = model.observe(&episode.frames[steps.clone()]);
        for (row, t) in steps.enumerate() {
            let memory_then = memory.take().unwrap_or_else(|| model.no_memory(1));
            let state = State { z: zs.narrow(0, row as i64, 1), memory: memory_then };
            features.push(&to_vec(&state.features()));
            *memory = Some(model.remember(&state, &actions_tensor(&episode.actions[t..=t])));
        }
        true
    }
}

fn open(dataset: &Path, spec: &Arc<WorldSpec>, recording: &str) -> Result<Episode, DatasetError> {
    let dataset = Dataset::open_as(dataset, spec)?;
    let idx =
        dataset.find(recording).ok_or_else(|| DatasetError::Moved { path: dataset.dir().to_owned() })?;
    dataset.episode(idx)
}

/// Opens a dataset for `change`, waiting for it where somebody else has it open for a moment.
fn change(
    dir: &Path,
    patience: Duration,
    change: impl FnOnce(&mut Dataset) -> Result<(), DatasetError>,
) -> Result<(), DatasetError> {
    let there = Dataset::inspect(dir)?;
    let env = there.env().map(str::to_owned).or(there.deleted().map(|deleted| deleted.info.env));
    let Some(env) = env else { return Err(DatasetError::Missing { path: dir.to_owned() }) };
    let since = Instant::now();
    loop {
        match Dataset::create_or_open(dir, &env) {
            Err(DatasetError::Busy { .. }) if since.elapsed() < patience => std::thread::sleep(PAUSE),
            opened => return change(&mut opened?),
        }
    }
}

/// After which steps something went on that must not happen.
fn unsafe_steps(episode: &Episode, spec: &WorldSpec) -> Vec<bool> {
    let columns: Vec<Vec<bool>> =
        spec.events_of(EventKind::Safety).filter_map(|event| episode.event(&event.name)).collect();
    (0..episode.actions.len()).map(|t| columns.iter().any(|column| column[t])).collect()
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::dataset::{EpisodeInfo, StepRecord, Summary};
    use crate::reward::{RewardConfig, RewardEnsemble};
    use crate::worker::{Inbox, Report, fixtures};
    use crate::world::{Action, Frame};

    /// A dataset of episodes of so many steps, made by the tiny world of the tests.
    fn dataset(dir: &Path, lens: &[usize]) {
        let side = fixtures::model().config().vae.height as u32;
        let frame = |t: usize| Frame::square(side, vec![t as u8; (3 * side * side) as usize]);
        let mut dataset = Dataset::create_or_open(dir, "dummy-road").unwrap();
        for (seed, &len) in lens.iter().enumerate() {
            let info =
                EpisodeInfo { env: "dummy-road".to_owned(), pilot: "test".to_owned(), seed: seed as u64 };
            let mut recording = dataset.begin(info).unwrap();
            for t in 0..len {
                let step = StepRecord {
                    frame: frame(t),
                    action: Action::new([(t as f32).sin(), 0.5, 0.0]),
                    reward: 1.0,
                    events: vec![(3..7).contains(&t)],
                    wall_time_ns: 1_795_342_500_000_000_000 + t as i64,
                    state: Vec::new(),
                };
                recording.push(&step).unwrap();
            }
            dataset.seal(recording, &frame(len), None).unwrap();
        }
    }

    struct Browser {
        inbox: Inbox,
        view: Latest<EpisodeView>,
        worker: Worker<EpisodeBrowserCommand>,
    }

    impl Browser {
        fn new() -> Self {
            let ((reports, inbox), view) = (Reports::new(|| ()), Latest::default());
            let worker = spawn(Arc::new(WorldSpec::default()), view.clone(), &reports);
            Self { inbox, view, worker }
        }

        fn ask(&self, command: EpisodeBrowserCommand) -> Report {
            self.worker.send(command);
            self.inbox.recv_timeout(Duration::from_mins(1)).unwrap()
        }

        fn list(&self, dir: &Path) -> EpisodeList {
            match self.ask(EpisodeBrowserCommand::List(dir.to_owned())) {
                Report::Record(RecordReport::Episodes(list)) => list,
                other => panic!("{other:?}"),
            }
        }
    }

    #[test]
    fn an_episode_is_opened_and_evaluated_step_by_step() {
        let dir = tempfile::tempdir().unwrap();
        dataset(dir.path(), &[5, 50]);
        let browser = Browser::new();
        let list = browser.list(dir.path());
        let [_, Summary { number: 1, n_steps: 50, events, began_secs, recording, .. }] = &list.episodes[..]
        else {
            panic!("{list:?}")
        };
        assert_eq!(*events, [("grass".to_owned(), 0.08)], "4 of 50 steps");
        assert_eq!(*began_secs, 1_795_342_500);

        let model = fixtures::model();
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let ensemble = RewardEnsemble::new((36, model.hash().as_str()), RewardConfig::tiny(), rng);
        let by = Some((model.parameters().clone(), ensemble.parameters()));
        browser.worker.send(EpisodeBrowserCommand::Evaluate(by));
        let open =
            EpisodeBrowserCommand::Open { dataset: dir.path().to_owned(), recording: recording.clone() };
        let Report::Record(RecordReport::Opened(opened)) = browser.ask(open) else {
            panic!("another report")
        };
        assert_eq!((opened.actions.len(), opened.unsafe_steps.first()), (50, Some(&(3..7))));
        let report = browser.inbox.recv().unwrap();
        let Report::Record(RecordReport::EpisodeRewards { rewards: [mean, low, high], .. }) = report else {
            panic!("{report:?}")
        };

        // By hand, all at once: what is observed, and a memory that begins empty.
        let episode = Dataset::open(dir.path()).unwrap().episode(1).unwrap();
        let mut features = Rows { width: 36, values: Vec::new() };
        let mut memory = model.no_memory(1);
        for (frame, action) in episode.frames.iter().zip(&episode.actions) {
            let state = State { z: model.observe(std::slice::from_ref(frame)), memory };
            features.push(&to_vec(&state.features()));
            memory = model.remember(&state, &actions_tensor(&[*action]));
        }
        let by_hand = RewardEvaluator::Preferences(ensemble).evaluate(
            &features.values,
            &episode.actions,
            model.ranges(),
        );
        let gap = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert_eq!(mean.len(), 50);
        for (said, expected) in [mean, low, high].iter().zip(&by_hand) {
            assert!(gap(said, expected) < 1e-4, "a batch rounds differently, but little");
        }

        browser.worker.send(EpisodeBrowserCommand::Show(7));
        browser.worker.send(EpisodeBrowserCommand::Show(30));
        let mut seen = None;
        while seen.as_ref().is_none_or(|view: &EpisodeView| view.step != 30) {
            seen = browser.view.take().or(seen);
            std::thread::yield_now();
        }
        assert_eq!(seen.map(|view| view.frame), Some(episode.frames[30].clone()));
    }

    #[test]
    fn what_is_deleted_is_gone_and_comes_back_last() {
        let dir = tempfile::tempdir().unwrap();
        dataset(dir.path(), &[5, 6, 7]);
        let browser = Browser::new();
        let recording = browser.list(dir.path()).episodes[0].recording.clone();
        let dataset = dir.path().to_owned();
        let back =
            EpisodeBrowserCommand::BringBack { dataset: dataset.clone(), recording: recording.clone() };
        let delete = EpisodeBrowserCommand::Delete { dataset, recording };
        let lens = |report: Report| match report {
            Report::Record(RecordReport::Episodes(list)) => {
                list.episodes.iter().map(|it| it.n_steps).collect::<Vec<_>>()
            }
            other => panic!("{other:?}"),
        };
        assert_eq!(lens(browser.ask(delete)), [6, 7]);
        assert_eq!(lens(browser.ask(back)), [6, 7, 5]);
    }

    #[test]
    fn nothing_is_deleted_from_a_folder_that_is_recorded_into() {
        let dir = tempfile::tempdir().unwrap();
        dataset(dir.path(), &[5, 6]);
        let browser = Browser::new();
        let recording = browser.list(dir.path()).episodes[0].recording.clone();
        let held = Dataset::create_or_open(dir.path(), "dummy-road").unwrap();
        let delete =
            || EpisodeBrowserCommand::Delete { dataset: dir.path().to_owned(), recording: recording.clone() };
        let Report::Record(RecordReport::Episodes(list)) = browser.ask(delete()) else {
            panic!("another report")
        };
        assert_eq!(list.episodes.len(), 2, "both are there");
        let Report::Failed(failure) = browser.inbox.recv().unwrap() else { panic!("another report") };
        let message = failure.error.to_string();
        assert!(message.contains("recording into the dataset"), "{message}");
        drop(held);
        let Report::Record(RecordReport::Episodes(list)) = browser.ask(delete()) else {
            panic!("another report")
        };
        assert_eq!(list.episodes.len(), 1);
    }
}
