//! Lets a person act in the real world by hand, every step of it on disk before the next.

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use crate::dataset::{Dataset, DatasetError, EpisodeInfo, Layout, Recording, StepRecord};
use crate::planner::PlannerConfig;
use crate::worker::clock::{Allowance, Beat, Clock, Rate, held};
use crate::worker::error::TaskError;
use crate::worker::rollout_comparison::Assistant;
use crate::worker::{
    Latest, LiveAction, LiveView, OpenError, OpenWorld, RecordReport, RecorderCommand, Reports, RolloutView,
    Worker, WorkerError, WorkerName, one_thread, picture,
};
use crate::world::{Action, End, Frame, World, WorldSpec};

const NAME: WorkerName = WorkerName::Recorder;
/// The name of the driver in the recordings.
const PILOT: &str = "person";

/// What a recorder shows: the real world, and the rollout that it is compared with.
pub type Views = (Latest<LiveView>, Latest<RolloutView>);

/// Starts a thread that drives the world that `open` opens, which is `spec`, by `action` or as `planner` says, and shows it
/// in `views`.
pub fn spawn(
    open: OpenWorld,
    spec: Arc<WorldSpec>,
    planner: PlannerConfig,
    action: LiveAction,
    views: Views,
    reports: &Reports,
) -> Worker<RecorderCommand> {
    Worker::spawn(NAME, reports, move |commands, reports| {
        record(&commands, &reports, &open, &spec, planner, &action, &views);
        Ok(())
    })
}

/// The body of the thread.
pub fn record(
    commands: &Receiver<RecorderCommand>,
    reports: &Reports,
    open: &OpenWorld,
    spec: &Arc<WorldSpec>,
    planner: PlannerConfig,
    action: &LiveAction,
    (view, rollout): &Views,
) {
    one_thread();
    let mut recorder = Recorder {
        open,
        world: None,
        spec,
        neutral: Action::new(spec.neutral()),
        reports,
        action,
        view,
        rollout,
        clock: Clock::at(spec.rate),
        drawing: Allowance::default(),
        pictures: Rate::default(),
        assistant: Assistant::new(Arc::clone(spec), planner),
        take: None,
    };
    loop {
        let done = match recorder.clock.wait(commands) {
            Beat::Command(command) => recorder.handle(command),
            Beat::Due => recorder.tick(),
            // An episode that is being driven stays in its journal.
            Beat::Over => return,
        };
        if let Err(e) = done {
            reports.fail(NAME, e.gave_up());
        }
    }
}

/// What the thread owns.
struct Recorder<'a> {
    open: &'a OpenWorld,
    /// Open once somebody has driven in it. A world that failed is opened anew for the next episode.
    world: Option<Box<dyn World>>,
    spec: &'a Arc<WorldSpec>,
    /// What is done where nobody does anything.
    neutral: Action,
    reports: &'a Reports,
    action: &'a LiveAction,
    view: &'a Latest<LiveView>,
    rollout: &'a Latest<RolloutView>,
    clock: Clock,
    /// For drawing the rollout.
    drawing: Allowance,
    pictures: Rate,
    assistant: Assistant,
    take: Option<Take>,
}

/// An episode that is being driven.
struct Take {
    /// Open, and so locked, only as long as this lives.
    dataset: Dataset,
    recording: Recording,
    /// What is seen now.
    frame: Frame,
    action: Action,
    /// The step that was driven last, until it is on disk.
    unsaved: Option<Unsaved>,
}

/// A step that is not on disk yet.
struct Unsaved {
    step: StepRecord,
    /// Whether the planner drove.
    planned: bool,
    /// Whether the environment ended the episode with it.
    end: Option<End>,
}

impl Recorder<'_> {
    fn handle(&mut self, command: RecorderCommand) -> Result<(), WorkerError> {
        match command {
            RecorderCommand::Start { dataset, seed } => {
                self.end(None)?;
                // One that could not be ended is not thrown away for the next.
                if self.take.is_none() {
                    self.start(&dataset, seed)?;
                }
            }
            RecorderCommand::Pause(pause) if self.take.is_some() => {
                if pause {
                    self.clock.stop();
                } else {
                    self.clock.start(Instant::now());
                }
                self.show();
            }
            RecorderCommand::Pause(_) => {}
            RecorderCommand::Model(model) => {
                let used = self.assistant.use_model(model);
                self.assisted(used);
            }
            RecorderCommand::Reward(reward) => {
                let used = self.assistant.use_reward(&reward);
                self.assisted(used);
            }
            RecorderCommand::HandOver(is_over) => {
                let n_steps = self.take.as_ref().map_or(0, |take| take.recording.n_steps());
                self.assistant.hand_over(is_over && self.take.is_some(), n_steps as u64);
                self.show();
            }
            RecorderCommand::CompareRollout(comparison) => self.assistant.compare(comparison),
            RecorderCommand::Keep => self.end(None)?,
            RecorderCommand::SaveIn(dataset) => self.save_in(&dataset),
            RecorderCommand::Discard => {
                self.clock.stop();
                self.take.take().map_or(Ok(()), |take| take.recording.discard())?;
            }
            RecorderCommand::FindUnfinished(dataset) => {
                let left = self.left_behind(&dataset)?.map_or(0, |dataset| dataset.unfinished().len());
                if left > 0 {
                    self.reports.send(RecordReport::Unfinished(left));
                }
            }
            RecorderCommand::Recover(dataset) => {
                let Some(mut dataset) = self.left_behind(&dataset)? else { return Ok(()) };
                while let Some(n_steps) = dataset.unfinished().first().map(|left| left.n_steps) {
                    let episode = dataset.recover(0)?;
                    self.reports.send(RecordReport::Recorded { episode, n_steps });
                }
            }
            RecorderCommand::Forget(dataset) => {
                let Some(mut dataset) = self.left_behind(&dataset)? else { return Ok(()) };
                while !dataset.unfinished().is_empty() {
                    dataset.discard(0)?;
                }
            }
        }
        Ok(())
    }

    /// The dataset in which something can have been left behind: nothing is made to look for that.
    fn left_behind(&self, dataset: &Path) -> Result<Option<Dataset>, DatasetError> {
        if self.take.is_some() || !dataset.join("journal").is_dir() {
            return Ok(None);
        }
        self.open(dataset).map(Some)
    }

    /// Opens the dataset for recording, and reports what had to be moved out of it.
    fn open(&self, dataset: &Path) -> Result<Dataset, DatasetError> {
        let dataset = Dataset::create_or_open(dataset, &self.spec.name)?;
        for damaged in dataset.damaged() {
            self.reports.send(RecordReport::LeftOut(damaged.to_string()));
        }
        Ok(dataset)
    }

    fn start(&mut self, dataset: &Path, seed: u64) -> Result<(), WorkerError> {
        let dataset = self.open(dataset)?;
        let mut world = match self.world.take() {
            Some(world) => world,
            None => (self.open)(false)?,
        };
        let frame = world.reset(seed).map_err(OpenError::World)?;
        let info = EpisodeInfo { env: self.spec.name.clone(), pilot: PILOT.to_owned(), seed };
        let layout = Layout::of(self.spec, &world.sensors());
        let recording = dataset.begin_with(info, &layout)?;
        self.world = Some(world);
        self.take = Some(Take { dataset, recording, frame, action: self.neutral, unsaved: None });
        self.assistant.begin();
        self.clock = Clock::at(self.spec.rate);
        self.show();
        self.clock.start(Instant::now());
        Ok(())
    }

    fn tick(&mut self) -> Result<(), WorkerError> {
        let now = Instant::now();
        self.clock.tick(now);
        let Some(take) = &mut self.take else { return Ok(()) };
        // With a step missing it would be another episode: nothing is driven before that one is on disk.
        if take.unsaved.is_some() {
            return Ok(self.write_down()?);
        }
        let Some(world) = &mut self.world else { return Ok(()) };
        let hands = held(self.action, self.neutral, now);
        let planned = self.assistant.act(hands, &take.frame).unwrap_or_else(|met| {
            self.reports.fail(NAME, TaskError::PlannerEnded(met));
            None
        });
        take.action = planned.unwrap_or(hands);
        let (wall_time_ns, state) = (nanos_since_1970(), world.state());
        let step = match world.step(&take.action) {
            Ok(step) => step,
            // What was recorded so far is an episode, and the world is opened anew for the next one.
            Err(met) => {
                self.world = None;
                self.reports.fail(NAME, WorkerError::from(OpenError::World(met)));
                return Ok(self.end(None)?);
            }
        };
        let executed = step.executed.unwrap_or(take.action);
        if let Err(met) = self.assistant.acted(&take.frame, executed) {
            self.reports.fail(NAME, TaskError::RolloutEnded(met));
        }
        let record = StepRecord {
            frame: std::mem::replace(&mut take.frame, step.frame),
            action: take.action,
            reward: step.reward.unwrap_or_default(),
            events: step.events.iter().map(|event| event.goes_on).collect(),
            wall_time_ns,
            state,
        };
        take.unsaved = Some(Unsaved { step: record, planned: planned.is_some(), end: step.end });
        Ok(self.write_down()?)
    }

    /// Writes down the step that was driven last.
    fn write_down(&mut self) -> Result<(), DatasetError> {
        if !self.is_written_down() {
            return Ok(());
        }
        let end = self.take.as_mut().and_then(|take| take.unsaved.take()?.end);
        self.show();
        self.show_rollout();
        if end.is_some() { self.end(end) } else { Ok(()) }
    }

    /// Whether all that was driven is on disk under its name; where it cannot be, the clock stands, all of it is kept in
    /// memory, and somebody is asked what to do.
    fn is_written_down(&mut self) -> bool {
        let Some(take) = &mut self.take else { return true };
        let written = match &take.unsaved {
            Some(Unsaved { step, planned, .. }) => take.recording.push_by(step, *planned),
            None => take.recording.check(),
        };
        written.map_err(|e| self.hold(e.to_string())).is_ok()
    }

    fn hold(&mut self, why: String) {
        self.clock.stop();
        self.show();
        self.reports.send(RecordReport::Held(why));
    }

    /// Goes on with what is being driven in another dataset.
    fn save_in(&mut self, dir: &Path) {
        self.clock.stop();
        if self.take.is_none() {
            return;
        }
        let opened = self.open(dir);
        let Some(take) = &mut self.take else { return };
        let moved = opened.and_then(|dataset| {
            let recording = dataset.take_over(&take.recording)?;
            Ok((dataset, recording))
        });
        match moved {
            Err(e) => self.hold(e.to_string()),
            Ok((dataset, recording)) => {
                take.dataset = dataset;
                let before = std::mem::replace(&mut take.recording, recording);
                if let Err(e) = before.discard() {
                    log::warn!("{e}");
                }
                self.show();
                self.reports.send(RecordReport::Moved(dir.to_owned()));
            }
        }
    }

    /// Seals what was driven, unless that is nothing; `end` is why the environment ended it, if it did.
    fn end(&mut self, end: Option<End>) -> Result<(), DatasetError> {
        self.clock.stop();
        if !self.is_written_down() {
            return Ok(());
        }
        let Some(Take { mut dataset, recording, frame, unsaved, .. }) = self.take.take() else {
            return Ok(());
        };
        let end = end.or(unsaved.and_then(|unsaved| unsaved.end));
        let n_steps = recording.n_steps();
        if n_steps == 0 {
            return recording.discard();
        }
        let episode = dataset.seal(recording, &frame, end).inspect_err(|_| {
            // It stays in its journal, and is offered from there.
            self.reports.send(RecordReport::Unfinished(1));
        })?;
        drop(dataset);
        self.reports.send(RecordReport::Recorded { episode, n_steps });
        Ok(())
    }

    fn show(&mut self) {
        let Some(take) = &self.take else { return };
        // The picture for people is costly: it is drawn only for somebody who looks.
        if !self.view.is_empty() && self.clock.runs() {
            return;
        }
        self.pictures.note(Instant::now());
        self.view.put(LiveView {
            frame: take.frame.clone(),
            picture: self.world.as_deref().map(|world| picture(world, &take.frame)),
            step: take.recording.n_steps(),
            action: take.action,
            steps_per_sec: self.clock.steps_per_sec(),
            pictures_per_sec: self.pictures.per_sec(),
            n_late: self.clock.n_late(),
            is_paused: !self.clock.runs(),
            n_unsafe_marks: 0,
            is_planned: self.assistant.is_driving(),
            status: self.world.as_ref().and_then(|world| world.status()),
        });
        self.reports.wake();
    }

    /// Draws the rollout, if there is time.
    fn show_rollout(&mut self) {
        let Some(take) = self.take.as_ref().filter(|_| self.assistant.has_rollout()) else { return };
        let (left, n_steps) = (self.clock.time_left(Instant::now()), take.recording.n_steps());
        let (assistant, frame) = (&self.assistant, &take.frame);
        if let Some(Some(view)) = self.drawing.spend(left, || assistant.view(n_steps, frame)) {
            self.rollout.put(view);
            self.reports.wake();
        }
    }

    /// Reports what befell the planner or the rollout beside: that ends no recording.
    fn assisted(&self, done: Result<(), WorkerError>) {
        if let Err(e) = done {
            self.reports.fail(NAME, e);
        }
    }
}

/// The wall clock; recordings keep it beside the step's number, so that nobody takes a slow loop for a steady one.
fn nanos_since_1970() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as i64)
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;
    use crate::worker::Report;
    use crate::worker::fixtures::{self, Wall};
    use crate::world::cars::Env as _;

    fn spec() -> Arc<WorldSpec> {
        Arc::clone(fixtures::wall(1)(false).unwrap().spec())
    }

    fn recorder(
        len: usize,
        action: &LiveAction,
        view: &Latest<LiveView>,
        reports: &Reports,
    ) -> Worker<RecorderCommand> {
        let views = (view.clone(), Latest::default());
        let planner = PlannerConfig::car_racing();
        spawn(fixtures::wall(len), spec(), planner, action.clone(), views, reports)
    }

    #[test]
    fn an_episode_that_the_environment_ends_is_on_disk() {
        let dir = tempfile::tempdir().unwrap();
        let (reports, inbox) = Reports::new(|| ());
        let (action, view) = (Latest::default(), Latest::default());
        let recorder = recorder(5, &action, &view, &reports);
        action.put((Action::new([0.5, 1.0, 0.0]), Instant::now() + std::time::Duration::from_secs(1000)));
        recorder.send(RecorderCommand::Start { dataset: dir.path().to_owned(), seed: 9 });
        let Report::Record(RecordReport::Recorded { episode: 0, n_steps: 5 }) = inbox.recv().unwrap() else {
            panic!("another report")
        };
        drop(recorder);

        let episode = Dataset::open(dir.path()).unwrap().episode(0).unwrap();
        assert_eq!((episode.frames.len(), episode.done, episode.info.seed), (6, true, 9));
        assert!(episode.truncated, "the wall ends when its time is up");
        assert_eq!(episode.actions, [Action::new([0.5, 1.0, 0.0]); 5]);
        assert!(episode.frames.iter().enumerate().all(|(t, frame)| frame.rgb()[0] == t as u8));
        let (width, height, rgb) = view.take().unwrap().picture.unwrap();
        assert_eq!(rgb.len() as u32, 3 * width * height);
    }

    #[test]
    fn what_was_not_driven_is_not_kept() {
        let dir = tempfile::tempdir().unwrap();
        let start = || RecorderCommand::Start { dataset: dir.path().to_owned(), seed: 0 };
        let commands = [start(), RecorderCommand::Keep, start(), RecorderCommand::Discard];
        assert!(reports_of(commands).is_empty());
        let dataset = Dataset::create_or_open(dir.path(), "wall").unwrap();
        assert!(dataset.is_empty() && dataset.unfinished().is_empty(), "nothing is left of either");
    }

    #[test]
    fn an_episode_whose_worker_ends_can_be_recovered() {
        let dir = tempfile::tempdir().unwrap();
        let (reports, _inbox) = Reports::new(|| ());
        let view = Latest::<LiveView>::default();
        let recorder = recorder(1000, &Latest::default(), &view, &reports);
        recorder.send(RecorderCommand::Start { dataset: dir.path().to_owned(), seed: 0 });
        while view.take().is_none_or(|view| view.step < 2) {
            std::thread::yield_now();
        }
        drop(recorder);
        let dataset = Dataset::create_or_open(dir.path(), "wall").unwrap();
        let n_steps = dataset.unfinished()[0].n_steps;
        assert!(n_steps >= 2, "{:?}", dataset.unfinished());
        drop(dataset);

        let path = || dir.path().to_owned();
        let reports = reports_of([RecorderCommand::FindUnfinished(path()), RecorderCommand::Recover(path())]);
        let [
            Report::Record(RecordReport::Unfinished(1)),
            Report::Record(RecordReport::Recorded { episode: 0, n_steps: kept }),
        ] = reports[..]
        else {
            panic!("{reports:?}")
        };
        assert_eq!(kept, n_steps);
        assert_eq!(Dataset::open(dir.path()).unwrap().len(0), n_steps);
    }

    #[cfg(unix)]
    #[test]
    fn a_recording_whose_journal_is_gone_stands_and_goes_on_elsewhere_without_a_gap() {
        let (one, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let (first, other) = (one.path().to_owned(), other.path().join("other"));
        let (reports, inbox) = Reports::new(|| ());
        let view = Latest::<LiveView>::default();
        let recorder = recorder(30, &Latest::default(), &view, &reports);
        recorder.send(RecorderCommand::Start { dataset: first.clone(), seed: 0 });
        while view.take().is_none_or(|view| view.step < 2) {
            std::thread::yield_now();
        }
        one.close().unwrap();
        let Report::Record(RecordReport::Held(why)) = inbox.recv().unwrap() else { panic!("another report") };
        assert!(why.contains("was replaced, moved or changed"), "{why}");
        recorder.send(RecorderCommand::Pause(false));
        assert!(
            matches!(inbox.recv().unwrap(), Report::Record(RecordReport::Held(_))),
            "tried again, it is the same"
        );
        // Not even the end of the recording loses it.
        recorder.send(RecorderCommand::Keep);
        assert!(matches!(inbox.recv().unwrap(), Report::Record(RecordReport::Held(_))));

        recorder.send(RecorderCommand::SaveIn(other.clone()));
        let Report::Record(RecordReport::Moved(moved)) = inbox.recv().unwrap() else {
            panic!("another report")
        };
        assert_eq!(moved, other);
        recorder.send(RecorderCommand::Pause(false));
        let Report::Record(RecordReport::Recorded { episode: 0, n_steps: 30 }) = inbox.recv().unwrap() else {
            panic!("another report")
        };
        drop(recorder);
        let episode = Dataset::open(&other).unwrap().episode(0).unwrap();
        assert!(
            episode.frames.iter().enumerate().all(|(t, frame)| frame.rgb()[0] == t as u8),
            "no step is missing"
        );
        assert!(episode.done && !first.exists());
    }

    #[test]
    fn what_was_left_behind_can_be_thrown_away() {
        let dir = tempfile::tempdir().unwrap();
        let dataset = Dataset::create_or_open(dir.path(), "wall").unwrap();
        let info = EpisodeInfo { env: "wall".to_owned(), pilot: PILOT.to_owned(), seed: 0 };
        let step = StepRecord {
            frame: Wall::new(5).frame(),
            action: Action::new([0.0; 3]),
            reward: 0.0,
            events: vec![false],
            wall_time_ns: 0,
            state: Vec::new(),
        };
        dataset.begin(info).unwrap().push(&step).unwrap();
        drop(dataset);
        let path = || dir.path().to_owned();
        let commands = [RecorderCommand::Forget(path()), RecorderCommand::FindUnfinished(path())];
        assert!(reports_of(commands).is_empty());
        let none = RecorderCommand::FindUnfinished(dir.path().join("none"));
        assert!(reports_of([none]).is_empty() && !dir.path().join("none").exists(), "looking makes nothing");
    }

    /// What comes of `commands`.
    fn reports_of(commands: impl IntoIterator<Item = RecorderCommand>) -> Vec<Report> {
        let (sender, received) = channel();
        commands.into_iter().for_each(|command| sender.send(command).unwrap());
        drop(sender);
        let (reports, inbox) = Reports::new(|| ());
        let planner = PlannerConfig::car_racing();
        let views = Views::default();
        record(&received, &reports, &fixtures::wall(5), &spec(), planner, &Latest::default(), &views);
        drop(reports);
        inbox.iter().collect()
    }
}
