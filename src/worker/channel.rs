//! What workers report, on its way: each report carries its sender's mark, so that of a worker that was dismissed
//! nothing arrives, not even what was under way.

use std::fmt;
use std::sync::mpsc::{Receiver, RecvError, RecvTimeoutError, Sender, TryRecvError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::worker::{Report, WorkerError, WorkerFailure, WorkerName};

/// Whether anybody wants to receive what a sender reports.
#[derive(Clone, Debug)]
pub(super) struct IsWanted(Arc<Mutex<bool>>);

impl Default for IsWanted {
    fn default() -> Self {
        Self(Arc::new(Mutex::new(true)))
    }
}

impl IsWanted {
    /// Nobody does, from here on; where a report is just being sent, this waits until it is.
    pub(super) fn end(&self) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = false;
    }

    /// Whether somebody does.
    pub(super) fn get(&self) -> bool {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A report that was sent.
#[derive(Debug)]
pub(super) struct Sent {
    report: Report,
    is_wanted: IsWanted,
}

impl Sent {
    /// The report, unless its sender was dismissed meanwhile.
    pub(super) fn report(self) -> Option<Report> {
        self.is_wanted.get().then_some(self.report)
    }

    /// Whether its sender was not dismissed meanwhile.
    pub(super) fn is_wanted(&self) -> bool {
        self.is_wanted.get()
    }
}

/// Where a worker sends its reports, waking whoever reads them.
#[derive(Clone)]
pub struct Reports {
    reports: Sender<Sent>,
    wake: Arc<dyn Fn() + Send + Sync>,
    is_wanted: IsWanted,
}

impl Reports {
    /// An outbox and its inbox; `wake` is called after every report.
    pub fn new(wake: impl Fn() + Send + Sync + 'static) -> (Self, Inbox) {
        let (reports, inbox) = channel();
        (Self { reports, wake: Arc::new(wake), is_wanted: IsWanted::default() }, Inbox(inbox))
    }

    /// Sends a report; where nobody receives it any more it is dropped.
    pub fn send(&self, report: impl Into<Report>) {
        let is_wanted = self.is_wanted.0.lock().unwrap_or_else(PoisonError::into_inner);
        if *is_wanted {
            self.reports.send(Sent { report: report.into(), is_wanted: self.is_wanted.clone() }).ok();
            drop(is_wanted);
            (self.wake)();
        }
    }

    /// The same outbox, to be closed by itself.
    pub(super) fn of_its_own(&self) -> Self {
        Self { is_wanted: IsWanted::default(), ..self.clone() }
    }

    /// Whether anybody wants to receive what is sent here.
    pub(super) fn is_wanted(&self) -> &IsWanted {
        &self.is_wanted
    }

    /// Reports that `worker` has met `error`.
    pub(crate) fn fail(&self, worker: WorkerName, error: impl Into<WorkerError>) {
        self.send(Report::Failed(WorkerFailure { worker, error: error.into() }));
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

/// Where reports arrive, but those whose sender was dismissed.
#[derive(Debug)]
pub struct Inbox(Receiver<Sent>);

impl Inbox {
    /// The next report, as soon as there is one; an error where there will be none.
    pub fn recv(&self) -> Result<Report, RecvError> {
        loop {
            if let Some(report) = self.0.recv()?.report() {
                return Ok(report);
            }
        }
    }

    /// The same, but no longer than `timeout`.
    pub fn recv_timeout(&self, timeout: Duration) -> Result<Report, RecvTimeoutError> {
        let end = Instant::now() + timeout;
        loop {
            let left = end.saturating_duration_since(Instant::now());
            if let Some(report) = self.0.recv_timeout(left)?.report() {
                return Ok(report);
            }
        }
    }

    /// The next report, if there is one.
    pub fn try_recv(&self) -> Result<Report, TryRecvError> {
        loop {
            if let Some(report) = self.0.try_recv()?.report() {
                return Ok(report);
            }
        }
    }

    /// The reports that are there.
    pub fn try_iter(&self) -> impl Iterator<Item = Report> {
        self.0.try_iter().filter_map(Sent::report)
    }

    /// All reports to the last, each as soon as it is there.
    pub fn iter(&self) -> impl Iterator<Item = Report> {
        self.0.iter().filter_map(Sent::report)
    }

    /// What is there, with its senders.
    pub(super) fn sent(&self) -> impl Iterator<Item = Sent> {
        self.0.try_iter()
    }
}
