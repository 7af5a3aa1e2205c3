//! Drives an episode of the planner again, so that it can be looked at: the same seed and the same actions.
//!
//! A seed and the actions decide everything in a built-in world, so nothing but these is kept of an episode. Whether
//! it came out as it was measured is found out each time.

use std::ops::Range;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, TryRecvError};

use crate::evaluation::{EpisodeMetrics, Tally};
use crate::worker::{
    EvaluateReport, Latest, OpenError, OpenWorld, ReplayView, ReplayerCommand, Reports, Worker, WorkerError,
    WorkerName,
};
use crate::world::{Action, EventKind, Frame, World};

const NAME: WorkerName = WorkerName::Replayer;
/// Steps that are driven before another command is received.
const CHUNK: usize = 20;

/// Starts a thread that drives episodes again in the world that `open` opens, and shows their steps in `view`.
pub fn spawn(open: OpenWorld, view: Latest<ReplayView>, reports: &Reports) -> Worker<ReplayerCommand> {
    Worker::spawn(NAME, reports, move |commands, reports| {
        replay(&commands, &reports, &open, &view);
        Ok(())
    })
}

/// The body of the thread.
pub fn replay(
    commands: &Receiver<ReplayerCommand>,
    reports: &Reports,
    open: &OpenWorld,
    view: &Latest<ReplayView>,
) {
    let mut replayer = Replayer { open, reports, view, world: None, episode: None };
    loop {
        let is_driving = replayer.episode.as_ref().is_some_and(|episode| !episode.is_over());
        let command = if is_driving {
            match commands.try_recv() {
                Ok(command) => Some(command),
                Err(TryRecvError::Disconnected) => return,
                Err(TryRecvError::Empty) => None,
            }
        } else {
            match commands.recv() {
                Ok(command) => Some(command),
                Err(_) => return,
            }
        };
        match command {
            Some(command) => replayer.handle(command),
            None => replayer.drive_on(),
        }
    }
}

/// What the thread owns.
struct Replayer<'a> {
    open: &'a OpenWorld,
    reports: &'a Reports,
    view: &'a Latest<ReplayView>,
    /// Open once it was driven in. One that failed is opened anew.
    world: Option<Box<dyn World>>,
    episode: Option<Episode>,
}

/// An episode that is driven again, or was.
struct Episode {
    replay: u64,
    actions: Arc<[Action]>,
    /// What is seen before each step; one more than steps are driven, until the last.
    frames: Vec<Frame>,
    is_unsafe: Vec<bool>,
    tally: Tally,
    has_ended: bool,
    /// The step that somebody waits for.
    wanted: Option<usize>,
}

impl Episode {
    fn is_over(&self) -> bool {
        self.has_ended || self.is_unsafe.len() == self.actions.len()
    }
}

impl Replayer<'_> {
    fn handle(&mut self, command: ReplayerCommand) {
        match command {
            ReplayerCommand::Drive { replay, seed, actions } => {
                self.episode = None;
                if let Err(met) = self.begin(replay, seed, actions) {
                    self.give_up(met);
                }
            }
            ReplayerCommand::Show(step) => {
                if let Some(episode) = &mut self.episode {
                    episode.wanted = Some(step);
                }
                self.show();
            }
            ReplayerCommand::Close => self.episode = None,
        }
    }

    fn begin(&mut self, replay: u64, seed: u64, actions: Arc<[Action]>) -> Result<(), OpenError> {
        let mut world = match self.world.take() {
            Some(world) => world,
            // With the aids that the planner had.
            None => (self.open)(true)?,
        };
        let frame = world.reset(seed)?;
        let tally = Tally::of(&world.spec().events);
        self.world = Some(world);
        let (frames, is_unsafe) = (vec![frame], Vec::new());
        let episode =
            Episode { replay, actions, frames, is_unsafe, tally, has_ended: false, wanted: Some(0) };
        self.episode = Some(episode);
        self.show();
        Ok(())
    }

    /// Drives a few steps more.
    fn drive_on(&mut self) {
        let (Some(world), Some(episode)) = (&mut self.world, &mut self.episode) else { return };
        for _ in 0..CHUNK {
            let Some(action) = episode.actions.get(episode.is_unsafe.len()) else { break };
            let step = match world.step(action) {
                Ok(step) => step,
                Err(met) => return self.give_up(OpenError::World(met)),
            };
            let safety = |(event, now): (&crate::world::EventSpec, &crate::world::Happened)| {
                event.kind == EventKind::Safety && (now.goes_on || now.happened)
            };
            episode.is_unsafe.push(world.spec().events.iter().zip(&step.events).any(safety));
            episode.tally.add(&step, None);
            episode.has_ended = step.end.is_some();
            if episode.has_ended {
                break;
            }
            episode.frames.push(step.frame);
        }
        let (replay, done) = (episode.replay, episode.is_unsafe.len());
        if episode.is_over() {
            let (metrics, unsafe_steps) = (episode.tally.metrics(), stretches(&episode.is_unsafe));
            self.reports.send(EvaluateReport::Replayed { replay, metrics, unsafe_steps });
        } else {
            self.reports.send(EvaluateReport::Replaying { replay, done });
        }
        self.show();
    }

    /// Shows the step that is waited for, once it is driven.
    fn show(&mut self) {
        let Some(episode) = &mut self.episode else { return };
        let Some(step) = episode.wanted else { return };
        if let Some(frame) = episode.frames.get(step) {
            episode.wanted = None;
            self.view.put(ReplayView { replay: episode.replay, step, frame: frame.clone() });
            self.reports.wake();
        }
    }

    fn give_up(&mut self, met: OpenError) {
        (self.world, self.episode) = (None, None);
        self.reports.fail(NAME, WorkerError::from(met).gave_up());
    }
}

/// The steps that are `true`, as stretches.
pub(super) fn stretches(is: &[bool]) -> Vec<Range<usize>> {
    let mut at = 0;
    let all = is.chunk_by(PartialEq::eq).map(|stretch| {
        at += stretch.len();
        (stretch[0], at - stretch.len()..at)
    });
    all.filter_map(|(is, range)| is.then_some(range)).collect()
}

impl EvaluateReport {
    /// Whether an episode that was driven again is the one that was measured: times apart, which are never the same.
    pub fn is_same(driven: &EpisodeMetrics, measured: &EpisodeMetrics) -> bool {
        let timeless = |metrics: &EpisodeMetrics| EpisodeMetrics {
            plan_ms_mean: None,
            plan_ms_max: None,
            ..metrics.clone()
        };
        timeless(driven) == timeless(measured)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::worker::Report;
    use crate::worker::fixtures;
    use crate::world::cars::{Aids, CarWorld};

    /// Drives so many steps and says what was measured, and the last frame before the end.
    fn measured(seed: u64, actions: &[Action]) -> (EpisodeMetrics, Frame) {
        let mut world = CarWorld::open("obstacle-car-racing-chuckholes", Aids::ALL).unwrap();
        let mut frame = world.reset(seed).unwrap();
        let mut tally = Tally::of(&world.spec().events);
        for (t, action) in actions.iter().enumerate() {
            let step = world.step(action).unwrap();
            tally.add(&step, Some(0.004));
            if t + 1 < actions.len() {
                frame = step.frame;
            }
        }
        (tally.metrics(), frame)
    }

    #[test]
    fn an_episode_is_driven_again_as_it_was_measured() {
        let actions: Arc<[Action]> =
            (0..70).map(|t| Action::new([(t as f32 / 9.0).sin(), 0.4, 0.0])).collect();
        let (expected, last) = measured(11, &actions);
        let open: OpenWorld =
            Arc::new(|_| Ok(Box::new(CarWorld::open("obstacle-car-racing-chuckholes", Aids::ALL).unwrap())));
        let ((reports, inbox), view) = (Reports::new(|| ()), Latest::default());
        let replayer = spawn(open, view.clone(), &reports);
        replayer.send(ReplayerCommand::Drive { replay: 4, seed: 11, actions });
        // It is waited for: nothing is drawn before it is driven.
        replayer.send(ReplayerCommand::Show(69));
        let (metrics, unsafe_steps) = loop {
            match inbox.recv().unwrap() {
                Report::Evaluate(EvaluateReport::Replaying { replay: 4, done }) => assert!(done < 70),
                Report::Evaluate(EvaluateReport::Replayed { replay: 4, metrics, unsafe_steps }) => {
                    break (metrics, unsafe_steps);
                }
                other => panic!("{other:?}"),
            }
        };
        assert!(EvaluateReport::is_same(&metrics, &expected), "{metrics:?} and {expected:?}");
        let n_unsafe: usize = unsafe_steps.iter().map(ExactSizeIterator::len).sum();
        assert!((n_unsafe as f32 / 70.0 - expected.unsafe_rate).abs() < 1e-6);
        let other = EpisodeMetrics { ret: expected.ret + 1.0, ..expected };
        assert!(!EvaluateReport::is_same(&metrics, &other));
        let shown = loop {
            // The first step may have been shown until it was known which is wanted.
            match view.take() {
                Some(shown) if shown.step > 0 => break shown,
                _ => std::thread::yield_now(),
            }
        };
        assert_eq!((shown.replay, shown.step, shown.frame), (4, 69, last));
    }

    #[test]
    fn another_episode_overtakes_one_that_is_being_driven() {
        let ((reports, inbox), view) = (Reports::new(|| ()), Latest::default());
        let replayer = spawn(fixtures::wall(1_000_000), view, &reports);
        let drive = |replay, n| {
            let actions = vec![Action::new([0.0; 3]); n].into();
            replayer.send(ReplayerCommand::Drive { replay, seed: 0, actions });
        };
        drive(0, 100_000);
        drive(1, 100_000);
        replayer.send(ReplayerCommand::Close);
        drive(2, 50);
        let is_last = |report: Report| match report {
            Report::Evaluate(EvaluateReport::Replayed { replay, metrics, .. }) => {
                assert_eq!((replay, metrics.n_steps), (2, 50));
                true
            }
            Report::Evaluate(EvaluateReport::Replaying { .. }) => false,
            other => panic!("{other:?}"),
        };
        assert!(inbox.iter().any(is_last));
    }
}
