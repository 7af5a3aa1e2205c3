//! Threads: every slow part runs in a named one of its own, receives commands and sends reports.
//!
//! The only module that starts a thread. A worker owns its models and shares nothing: what crosses a channel is plain
//! data, and networks travel as [`Parameters`](crate::tensor::Parameters). Only live pictures and the live action go
//! through [`Latest`] slots.
//!
//! [`Workers`] is what the application sees of all this: commands go in, reports come out. [`Threads`] runs them; a new
//! worker is added in its table, `workers::workers!`.

mod channel;
mod clip_writer;
mod clock;
mod command;
mod crew;
mod error;
#[cfg(test)]
mod fixtures;
mod plan_view;
mod read_ahead;
mod report;
mod reward_eval;
mod rollout_comparison;
mod view;
mod workers;

pub mod clipper;
pub mod dream_inspector;
pub mod dreamer;
pub mod driver;
pub mod episode_browser;
pub mod jobs;
pub mod modeler;
pub mod previewer;
pub mod recorder;
pub mod replayer;
pub mod screener;
pub mod session_writer;
pub mod synthesizer;
pub mod trainer;

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Instant;

use crate::world::{Action, Frame, World, WorldError};

pub use channel::{Inbox, Reports};
pub use command::{
    ClipSource, ClipperCommand, DeployedMoment, DreamInspectorCommand, DreamerCommand, DriverCommand,
    EpisodeBrowserCommand, FolderCheck, JobCommand, ModelerCommand, PreviewerCommand, RecorderCommand,
    ReplayerCommand, ScreenerCommand, SessionWriterCommand, SynthesizerCommand, TrainerCommand,
    WorkerCommand,
};
pub use crew::Crew;
pub use read_ahead::read_ahead;
pub use report::{
    Cause, DeployReport, DreamReport, DreamStart, Dropped, EvaluateReport, JobReport, LabelReport, Learning,
    LoadedWorld, RecordReport, Report, RewardReport, SceneReport, SessionItem, SessionReport, WorkerError,
    WorkerFailure, WorkerName, WorldModelReport,
};
pub use session_writer::SessionWriter;
pub use view::{
    CandidateView, ClipRewards, DreamRewards, DriveView, EpisodeList, EpisodeView, LiveView, OpenEpisode,
    Promise, ReplayView, ReviewView, RolloutComparison, RolloutView,
};
pub use workers::{LoadWorldModel, Slots, Threads, WorkerConfig, Workers};

use channel::IsWanted;

/// A slot that holds only the latest value: a slow reader misses some and never delays the writer.
#[derive(Debug)]
pub struct Latest<T>(Arc<Mutex<Option<T>>>);

impl<T> Default for Latest<T> {
    fn default() -> Self {
        Self(Arc::default())
    }
}

impl<T> Clone for Latest<T> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<T> Latest<T> {
    /// Replaces what is there.
    pub fn put(&self, value: T) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(value);
    }

    /// Takes what is there.
    pub fn take(&self) -> Option<T> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    /// Whether there is nothing: the reader has taken it and looks for more.
    pub fn is_empty(&self) -> bool {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).is_none()
    }
}

impl<T: Clone> Latest<T> {
    /// A copy of what is there.
    pub fn peek(&self) -> Option<T> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// The driver's hands: the latest action and when it was given.
///
/// A worker lets go of the controls where this has not been written for a moment, for the window may hang.
pub type LiveAction = Latest<(Action, Instant)>;

/// A named thread that runs until its commands end.
#[derive(Debug)]
pub struct Worker<C> {
    commands: Option<Sender<C>>,
    thread: Option<JoinHandle<()>>,
    is_wanted: IsWanted,
}

/// A thread that was told to end and is not waited for, until the program ends.
#[derive(Debug)]
pub struct Dismissed(Option<JoinHandle<()>>);

impl Dismissed {
    /// Whether it has ended.
    pub fn is_over(&self) -> bool {
        self.0.as_ref().is_none_or(JoinHandle::is_finished)
    }
}

impl Drop for Dismissed {
    fn drop(&mut self) {
        if let Some(thread) = self.0.take() {
            thread.join().ok();
        }
    }
}

impl<C: Send + 'static> Worker<C> {
    /// Runs `body` in a thread of that name; an error or a panic in it is one [`Report::Failed`].
    pub fn spawn(
        name: WorkerName,
        reports: &Reports,
        body: impl FnOnce(Receiver<C>, Reports) -> Result<(), WorkerError> + Send + 'static,
    ) -> Self {
        let (commands, received) = channel();
        let reports = reports.of_its_own();
        let is_wanted = reports.is_wanted().clone();
        let run = move || {
            let outbox = reports.clone();
            match catch_unwind(AssertUnwindSafe(|| body(received, outbox))) {
                Ok(Ok(())) => {}
                Ok(Err(error)) => reports.fail(name, error),
                Err(panic) => reports.fail(name, panicked(panic.as_ref())),
            }
        };
        let thread = std::thread::Builder::new().name(name.name().to_owned()).spawn(run);
        Self { commands: Some(commands), thread: thread.ok(), is_wanted }
    }

    /// Tells it to end, and waits neither for that nor for what it still has to report: that is dropped, and so is what
    /// was reported and is not received yet.
    pub fn dismiss(mut self) -> Dismissed {
        self.is_wanted.end();
        self.commands = None;
        Dismissed(self.thread.take())
    }

    /// Whether its thread has ended, as after a bug.
    pub fn is_over(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Sends a command; a worker that has died does nothing and has reported that.
    pub fn send(&self, command: C) {
        if let Some(commands) = &self.commands {
            commands.send(command).ok();
        }
    }
}

impl<C> Drop for Worker<C> {
    fn drop(&mut self) {
        self.commands = None;
        if let Some(thread) = self.thread.take() {
            thread.join().ok();
        }
    }
}

/// One piece of work in a thread of its own, whose result is asked for when there is time.
#[derive(Debug)]
pub struct Job<T> {
    done: Latest<T>,
    thread: Option<JoinHandle<()>>,
}

impl<T: Send + 'static> Job<T> {
    /// Begins `work` in a thread called `name`, and calls `wake` when it is done.
    pub fn begin(
        name: &str,
        wake: impl FnOnce() + Send + 'static,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Self {
        let done = Latest::default();
        let slot = done.clone();
        let run = move || {
            one_thread();
            slot.put(work());
            wake();
        };
        let thread = std::thread::Builder::new().name(name.to_owned()).spawn(run).ok();
        Self { done, thread }
    }

    /// What came of it, once something has; a job that died says nothing for ever, which `is_over` tells.
    pub fn poll(&mut self) -> Option<T> {
        self.done.take()
    }

    /// Whether its thread has ended.
    pub fn is_over(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Waits until its thread has ended, and throws away what came of it.
    pub fn wait(mut self) {
        if let Some(thread) = self.thread.take() {
            thread.join().ok();
        }
    }
}

/// What a panic is as an error.
fn panicked(panic: &(dyn Any + Send)) -> WorkerError {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
    WorkerError::Panicked(text.unwrap_or_else(|| "no message".to_owned()))
}

/// How large the real scene is drawn for people, where it can be drawn at any size: width by height.
const PICTURE: (u32, u32) = (600, 480);

/// The real scene as a person sees it: width, height, RGB bytes. What models see, where there is nothing else.
fn picture(world: &dyn World, frame: &Frame) -> (u32, u32, Arc<[u8]>) {
    let shown = world.picture(PICTURE.0, PICTURE.1);
    let shown = shown.as_ref().unwrap_or(frame);
    (shown.width(), shown.height(), shown.shared())
}

/// Opens the real world, in the thread that calls; it may help the driver where the paper's does, if that is asked.
pub type OpenWorld = Arc<dyn Fn(bool) -> Result<Box<dyn World>, OpenError> + Send + Sync>;

/// Why the real world cannot be driven in.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// It failed.
    #[error(transparent)]
    World(#[from] WorldError),
    /// There is none.
    #[error("the world {0:?} is known from recordings alone: there is nothing that could be driven")]
    RecordingsOnly(String),
}

/// Keeps libtorch to the calling thread: a second one that waits costs the window and the others more than it brings.
fn one_thread() {
    tch::set_num_threads(1);
}

/// Waits, while nobody is waited for.
pub fn pause(time: std::time::Duration) {
    std::thread::sleep(time);
}

/// How many processors there are.
pub fn n_processors() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_worker_that_panics_says_so_and_takes_nobody_with_it() {
        let (reports, inbox) = Reports::new(|| ());
        let worker = Worker::<()>::spawn(WorkerName::Clipper, &reports, |_, _| panic!("on purpose"));
        let report = inbox.recv().unwrap();
        let Report::Failed(WorkerFailure { worker: WorkerName::Clipper, error }) = report else {
            panic!("{report:?}")
        };
        assert!(matches!(&error, WorkerError::Panicked(text) if text == "on purpose"), "{error:?}");
        assert_eq!(error.to_string(), "this is a bug of ours: on purpose");
        drop(worker);
    }

    #[test]
    fn who_is_dismissed_is_not_waited_for_and_reports_nothing_more() {
        let (reports, inbox) = Reports::new(|| ());
        let (go, wait) = channel::<()>();
        let (sent, is_sent) = channel::<()>();
        let worker = Worker::<()>::spawn(WorkerName::Recorder, &reports, move |_, reports| {
            reports.send(RecordReport::Unfinished(1));
            sent.send(()).unwrap();
            wait.recv().ok();
            reports.send(RecordReport::Unfinished(2));
            Err(WorkerError::Stopped)
        });
        is_sent.recv().unwrap();
        let dismissed = worker.dismiss();
        assert!(!dismissed.is_over(), "it is busy, and we are here already");
        go.send(()).unwrap();
        drop(dismissed);
        reports.send(RecordReport::Unfinished(3));
        let all: Vec<_> = inbox.try_iter().collect();
        assert!(matches!(all[..], [Report::Record(RecordReport::Unfinished(3))]), "{all:?}");
    }

    #[test]
    fn threads_have_names_that_the_system_shows_whole() {
        for worker in WorkerName::ALL {
            assert!(worker.name().len() <= 15, "{}", worker.name());
        }
    }

    #[test]
    fn a_job_wakes_its_owner_when_it_is_done() {
        let (wake, woken) = channel();
        let mut job = Job::begin("job", move || wake.send(()).unwrap(), || 7);
        woken.recv().unwrap();
        assert_eq!((job.poll(), job.poll()), (Some(7), None));
    }

    #[test]
    fn a_slot_holds_the_latest_only() {
        let slot = Latest::default();
        slot.put(1);
        slot.put(2);
        assert_eq!((slot.take(), slot.take()), (Some(2), None));
    }
}
