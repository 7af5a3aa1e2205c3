//! Threads: every slow part runs in a named one of its own, hears commands and sends reports.
//!
//! The only module that starts a thread. A worker owns its models and shares nothing: what crosses a channel is plain
//! data, and networks travel as [`Parameters`]. Only the live picture and the live action go through [`Latest`] slots.

mod clock;
mod companion;
mod gallery;
mod judge;
#[cfg(test)]
mod toy;

pub mod clipper;
pub mod dreamer;
pub mod driver;
pub mod modeler;
pub mod recorder;
pub mod reviewer;
pub mod screener;
pub mod trainer;

use std::any::Any;
use std::fmt::{self, Display};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Instant;

use crate::dream::{DreamEpisode, Rows};
use crate::env::{Action, Env, Frame};
use crate::evaluation::EpisodeMetrics;
use crate::query::{DreamId, JudgedTransition, Label, Query, QueryId, SegmentRef};
use crate::session::DreamJournal;
use crate::tensor::Parameters;
use crate::world_model::LatentState;
use crate::world_model::fit::Progress;

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

/// What a person sees while driving, and how well the clock keeps.
#[derive(Clone, Debug)]
pub struct LiveView {
    /// What the models see.
    pub frame: Frame,
    /// The real scene as a person sees it, where that is what is driven: width, height, RGB bytes.
    pub picture: Option<(u32, u32, Arc<[u8]>)>,
    /// Its number, from 0.
    pub step: usize,
    /// The action that was taken.
    pub action: Action,
    /// Steps a second over the last second.
    pub steps_per_sec: f32,
    /// Pictures a second over the last second: steps are never left out, but pictures are where time is short.
    pub pictures_per_sec: f32,
    /// Steps that came more than a step too late, since the start.
    pub n_late: usize,
    /// Whether the clock stands.
    pub is_paused: bool,
    /// Marks given so far.
    pub n_unsafe_marks: usize,
    /// Whether the planner drives, and not a person.
    pub is_planned: bool,
    /// How many of the real car's four wheels are off the road now, whatever the environment's latch says.
    pub wheels_off: Option<u8>,
}

/// How a dream rides beside the real car.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Beside {
    /// After how many steps it looks at the real world and begins anew, if ever.
    pub reset: Option<usize>,
}

/// A dream beside the real car, under the same actions.
#[derive(Clone, Debug)]
pub struct BesideView {
    /// What is dreamt.
    pub frame: Frame,
    /// The step of the real car.
    pub step: usize,
    /// How many steps ago the dream last saw the real world.
    pub since: usize,
    /// How far the dream's picture is from the real one: the root of the mean squared difference, in `[0, 1]`.
    pub drift: f32,
}

/// What the planner thinks of one course of action.
#[derive(Clone, Debug, PartialEq)]
pub struct Promise {
    /// Its actions in words, run by run: `left 4 · straight 11`.
    pub actions: String,
    /// What the reward promises of it.
    pub now: f32,
    /// What the reward promised that it is compared with.
    pub before: Option<f32>,
}

/// A step of a kept dream, looked at again.
#[derive(Clone, Debug)]
pub struct ReviewView {
    /// Of which dream.
    pub dream: DreamId,
    /// Which step.
    pub step: usize,
    /// What was seen.
    pub frame: Frame,
    /// What the planner would choose from there; nothing without a reward.
    pub promises: Vec<Promise>,
    /// The one that it would drive.
    pub chosen: usize,
    /// The one that it would have driven by the reward that this one is compared with.
    pub chosen_before: Option<usize>,
}

/// What the reward says of every step of a dream.
#[derive(Clone, Debug, PartialEq)]
pub struct Judgement {
    /// Which dream.
    pub dream: DreamId,
    /// The mean of the ensemble, step by step.
    pub rewards: Vec<f32>,
    /// The lowest of its members.
    pub low: Vec<f32>,
    /// The highest.
    pub high: Vec<f32>,
}

/// One imagined future, for the eye.
#[derive(Clone, Debug)]
pub struct CandidateView {
    /// Its actions in words, run by run: `left 4 · straight 11`.
    pub actions: String,
    /// What the reward promises of it.
    pub predicted_return: f32,
    /// Its last picture, and a few on the way.
    pub frames: Vec<Frame>,
}

/// The real car under the planner, and what it thought of.
#[derive(Clone, Debug)]
pub struct DriveView {
    /// What the models see.
    pub frame: Frame,
    /// The scene as a person sees it: width, height, RGB bytes.
    pub picture: (u32, u32, Arc<[u8]>),
    /// Steps so far.
    pub step: usize,
    /// The running figures of this episode.
    pub metrics: EpisodeMetrics,
    /// The candidates of a recent plan, in order: the latest one that there was time to draw.
    pub candidates: Arc<[CandidateView]>,
    /// Which of these was chosen.
    pub chosen: usize,
    /// How long the latest plan took, in milliseconds.
    pub plan_ms: f32,
    /// How many of the four wheels are off the road now, whatever the environment's latch says.
    pub wheels_off: u8,
}

/// Plays dreams at 50 steps a second, each for [`MAX_STEPS`](crate::env::MAX_STEPS) at the most.
#[derive(Debug)]
pub enum DreamerCommand {
    /// Starts a dream, journalled in `journal` where that is given.
    Start {
        /// Where it begins.
        start: LatentState,
        /// Of its noise.
        seed: u64,
        /// What holds it until it is kept; without a session there is none.
        journal: Option<DreamJournal>,
    },
    /// Stops the clock, or lets it go on.
    Pause(bool),
    /// One step while the clock stands.
    Step,
    /// Marks the present step as unsafe.
    MarkUnsafe,
    /// Plans with this reward from now on.
    Reward(Parameters),
    /// Gives the wheel to the planner, or back.
    HandOver(bool),
    /// Ends the dream and reports it.
    Finish,
    /// Ends the dream and forgets it, journal and all.
    Discard,
}

/// Draws clips before they are needed.
#[derive(Debug)]
pub enum ClipperCommand {
    /// Knows a dream from now on.
    AddDream(DreamId, Arc<DreamEpisode>),
    /// Decodes both segments of a query.
    Decode(Query),
    /// Decodes one picture of either segment, for a list.
    Glance(Query),
}

/// Looks for signs that dreams have left the world behind.
#[derive(Debug)]
pub enum ScreenerCommand {
    /// Looks at a dream.
    AddDream(DreamId, Arc<DreamEpisode>),
}

/// Learns a reward while answers come in: from preferences or from verdicts, whichever came last.
#[derive(Debug)]
pub enum TrainerCommand {
    /// Knows a dream from now on.
    AddDream(DreamId, Arc<DreamEpisode>),
    /// Learns from an answer, or from another answer to the same query.
    Learn(Query, Label),
    /// Learns from a verdict on a transition, or from another verdict on the same.
    Judge(JudgedTransition),
    /// Forgets the answer to a query.
    Forget(QueryId),
    /// Says how much the reward is of two minds about each of these pairs.
    Weigh(Vec<[SegmentRef; 2]>),
    /// Learns all answers anew, for they weigh differently.
    Relearn,
    /// Starts afresh and fits all answers to the end.
    Fit {
        /// Of initialization and order.
        seed: u64,
    },
}

/// Drives the real car by plan.
#[derive(Debug)]
pub enum DriverCommand {
    /// Plans with these rewards from now on.
    Reward(Parameters),
    /// Drives an episode on the track of `seed`, once there is a reward.
    Drive {
        /// Of the track and of the planner's draws.
        seed: u64,
    },
    /// Stops the clock, or lets it go on.
    Pause(bool),
    /// Ends the episode; its figures are not reported, for they are not those of a whole one.
    Stop,
}

/// Looks at kept dreams again.
#[derive(Debug)]
pub enum ReviewerCommand {
    /// Knows a dream from now on.
    AddDream(DreamId, Arc<DreamEpisode>),
    /// Judges by this reward from now on.
    Reward(Parameters),
    /// Compares what the rewards to come say with what the present one says.
    Compare,
    /// Draws this step, and judges the dream where that has not been done by the present reward.
    Look {
        /// Of which dream.
        dream: DreamId,
        /// Which step.
        step: usize,
    },
}

/// Lets a person drive the real car and records it; an episode that the environment ends is kept.
#[derive(Debug)]
pub enum RecorderCommand {
    /// Starts an episode on the track of `seed`, kept in the dataset at `dataset`.
    Start {
        /// The `LeRobot` folder.
        dataset: PathBuf,
        /// Of the track.
        seed: u64,
    },
    /// Dreams and plans with this world model from now on.
    Model(Parameters),
    /// Plans with this reward from now on.
    Reward(Parameters),
    /// Gives the wheel to the planner, or back.
    HandOver(bool),
    /// Dreams beside the real car, or no longer.
    Beside(Option<Beside>),
    /// Stops the clock, or lets it go on.
    Pause(bool),
    /// Ends the episode and seals it.
    Keep,
    /// Ends the episode and forgets it.
    Discard,
    /// Looks in this dataset for episodes that a killed program left behind, unless one is being driven.
    Look(PathBuf),
    /// Seals those, as far as they go.
    Recover(PathBuf),
    /// Throws them away.
    Forget(PathBuf),
}

/// Trains a world model.
#[derive(Debug)]
pub enum ModelerCommand {
    /// Fits one to the recordings at `dataset` and writes it to `out`.
    Fit {
        /// The `LeRobot` folder.
        dataset: PathBuf,
        /// The file to write.
        out: PathBuf,
        /// Whether to go on from a checkpoint.
        resume: bool,
    },
    /// Stops at the next update, which is reported as [`Report::Failed`]; it can be resumed.
    Stop,
}

/// What a worker tells the window: one closed list, one inbox.
#[derive(Debug)]
pub enum Report {
    /// A dream ended and is offered for keeping.
    Dreamt {
        /// As it was driven.
        episode: DreamEpisode,
        /// What to discard once it is kept or thrown away.
        journal: Option<DreamJournal>,
    },
    /// A query's clips are ready.
    Clips {
        /// Which.
        query: Query,
        /// Twenty pictures.
        left: Vec<Frame>,
        /// Twenty pictures.
        right: Vec<Frame>,
    },
    /// A query's thumbnails are ready.
    Glance {
        /// Which.
        query: Query,
        /// From the middle of the left clip, and of the right one.
        frames: [Frame; 2],
    },
    /// A dream has been looked at.
    Signs {
        /// Which.
        dream: DreamId,
        /// Of its noise: another session has a dream of this number, too.
        seed: u64,
        /// The signs of its steps.
        signs: Rows,
    },
    /// Pairs have been weighed.
    Weighed {
        /// Which.
        pairs: Vec<[SegmentRef; 2]>,
        /// How much the members disagree about each; nothing where nothing was learned yet.
        disagreements: Option<Vec<f32>>,
    },
    /// What the reward says of a dream.
    Judged(Judgement),
    /// The reward has learned a little.
    Learning(Learning),
    /// The reward has parameters worth planning with.
    Learned {
        /// They.
        parameters: Parameters,
        /// How many answers they rest on.
        n_labels: usize,
        /// Where a full fit has ended: its seed, and each member's loss in its last epoch.
        fit: Option<(u64, Vec<f32>)>,
    },
    /// An episode by plan ended.
    Drove {
        /// Of the track.
        seed: u64,
        /// Its figures.
        metrics: EpisodeMetrics,
    },
    /// A recorded episode is on disk.
    Recorded {
        /// Its number in the dataset.
        episode: usize,
        /// Steps.
        n_steps: usize,
    },
    /// So many recordings were left behind by a killed program.
    Unfinished(usize),
    /// A recorded episode is left out of a fit; the sentence says why.
    LeftOut(String),
    /// A world model is being trained.
    Modeling(Progress),
    /// A world model is on disk.
    Modeled(PathBuf),
    /// A worker met an error, or has died of a bug; the sentence says which.
    Failed {
        /// The thread's name.
        worker: &'static str,
        /// One sentence.
        message: String,
    },
}

/// How well the reward fits.
#[derive(Clone, Debug, PartialEq)]
pub struct Learning {
    /// Epochs of a full fit that are done, or the fits so far while answers come in.
    pub epoch: usize,
    /// Cross-entropy of each member.
    pub losses: Vec<f32>,
    /// Cross-entropy of answers predicted before they were learned, where there are enough.
    pub held_out_loss: Option<f32>,
    /// Share of strict answers that were predicted right before they were learned.
    pub agreement: Option<f32>,
    /// Answers learned from.
    pub n_labels: usize,
    /// Whether a full fit is under way, and how many epochs it will have.
    pub fit_epochs: Option<usize>,
}

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
