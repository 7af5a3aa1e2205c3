//! Threads: every slow part runs in a named one of its own, hears commands and sends reports.
//!
//! The only module that starts a thread. A worker owns its models and shares nothing: what crosses a channel is plain
//! data, and networks travel as [`Parameters`](crate::tensor::Parameters). Only the live picture and the live action go through [`Latest`] slots.

mod appraisal;
mod clock;
mod command;
mod companion;
mod gallery;
mod report;
#[cfg(test)]
mod toy;
mod view;

pub mod clipper;
pub mod dreamer;
pub mod driver;
pub mod librarian;
pub mod modeler;
pub mod recorder;
pub mod reviewer;
pub mod screener;
pub mod synthesizer;
pub mod trainer;

use std::any::Any;
use std::fmt::{self, Display};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Instant;

use crate::env::{Action, Env};

pub use command::{
    ClipperCommand, DreamerCommand, DriverCommand, LibrarianCommand, ModelerCommand, RecorderCommand,
    ReviewerCommand, ScreenerCommand, SynthesizerCommand, TrainerCommand,
};
pub use report::{Learning, Report};
pub use view::{
    Beside, BesideView, CandidateView, ClipRewards, DriveView, EpisodeView, Judgement, LiveView, OpenEpisode,
    Promise, ReviewView, Shelf,
};

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

/// Where a worker sends its reports, waking whoever reads them.
#[derive(Clone)]
pub struct Reports {
    reports: Sender<Report>,
    wake: Arc<dyn Fn() + Send + Sync>,
    /// Whether anybody wants to hear: of a worker that was dismissed, nobody does.
    is_heard: Arc<Mutex<bool>>,
}

impl Reports {
    /// An outbox and its inbox; `wake` is called after every report.
    pub fn new(wake: impl Fn() + Send + Sync + 'static) -> (Self, Receiver<Report>) {
        let (reports, inbox) = channel();
        (Self { reports, wake: Arc::new(wake), is_heard: Arc::new(Mutex::new(true)) }, inbox)
    }

    /// Sends a report; where nobody listens any more it is dropped.
    pub fn send(&self, report: Report) {
        let is_heard = self.is_heard.lock().unwrap_or_else(PoisonError::into_inner);
        if *is_heard {
            self.reports.send(report).ok();
            drop(is_heard);
            (self.wake)();
        }
    }

    /// The same outbox, to be closed by itself.
    fn of_its_own(&self) -> Self {
        Self { is_heard: Arc::new(Mutex::new(true)), ..self.clone() }
    }

    /// Reports that the worker called `worker` has met `message`, and lives on.
    pub(crate) fn fail(&self, worker: &'static str, message: impl Display) {
        self.send(Report::Failed { worker, message: message.to_string() });
    }

    /// Wakes the reader without a report: a slot has something new.
    pub fn wake(&self) {
        (self.wake)();
    }
}

impl fmt::Debug for Reports {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Reports")
    }
}

/// A named thread that runs until its commands end.
#[derive(Debug)]
pub struct Worker<C> {
    commands: Option<Sender<C>>,
    thread: Option<JoinHandle<()>>,
    is_heard: Arc<Mutex<bool>>,
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
    /// Runs `body` in a thread called `name`; an error or a panic in it is one [`Report::Failed`].
    pub fn spawn(
        name: &'static str,
        reports: &Reports,
        body: impl FnOnce(Receiver<C>, Reports) -> Result<(), String> + Send + 'static,
    ) -> Self {
        let (commands, heard) = channel();
        let reports = reports.of_its_own();
        let is_heard = Arc::clone(&reports.is_heard);
        let run = move || {
            let outbox = reports.clone();
            let message = match catch_unwind(AssertUnwindSafe(|| body(heard, outbox))) {
                Ok(Ok(())) => return,
                Ok(Err(message)) => message,
                Err(panic) => panic_message(panic.as_ref()),
            };
            reports.send(Report::Failed { worker: name, message });
        };
        let thread = std::thread::Builder::new().name(name.to_owned()).spawn(run);
        Self { commands: Some(commands), thread: thread.ok(), is_heard }
    }

    /// Tells it to end, and waits neither for that nor for what it still has to say.
    pub fn dismiss(mut self) -> Dismissed {
        *self.is_heard.lock().unwrap_or_else(PoisonError::into_inner) = false;
        self.commands = None;
        Dismissed(self.thread.take())
    }

    /// Whether its thread has ended, as after a bug.
    pub fn is_over(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Sends a command; a worker that has died hears nothing and has said so.
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

fn panic_message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
    format!("this is a bug of ours: {}", text.unwrap_or_else(|| "no message".to_owned()))
}

/// How large the real scene is drawn for people.
const PICTURE: (u32, u32) = (600, 480);

/// The real scene as a person sees it: width, height, RGB bytes.
fn picture(env: &dyn Env, (width, height): (u32, u32)) -> (u32, u32, Arc<[u8]>) {
    (width, height, env.picture(width, height).into())
}

/// Keeps libtorch to the calling thread: a second one that waits costs the window and the others more than it brings.
fn one_thread() {
    tch::set_num_threads(1);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_worker_that_panics_says_so_and_takes_nobody_with_it() {
        let (reports, inbox) = Reports::new(|| ());
        let worker = Worker::<()>::spawn("test", &reports, |_, _| panic!("on purpose"));
        let Report::Failed { worker: name, message } = inbox.recv().unwrap() else {
            panic!("another report")
        };
        assert_eq!(name, "test");
        assert!(message.contains("on purpose"), "{message}");
        drop(worker);
    }

    #[test]
    fn who_is_dismissed_is_not_waited_for_and_not_heard_of_again() {
        let (reports, inbox) = Reports::new(|| ());
        let (go, wait) = channel::<()>();
        let worker = Worker::<()>::spawn("slow", &reports, move |_, reports| {
            wait.recv().ok();
            reports.send(Report::Unfinished(1));
            Err("too late".to_owned())
        });
        let dismissed = worker.dismiss();
        assert!(!dismissed.is_over(), "it is busy, and we are here already");
        go.send(()).unwrap();
        drop(dismissed);
        assert!(inbox.try_recv().is_err(), "it was heard");
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
