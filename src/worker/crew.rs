//! Several threads that take pieces of work from one queue, such as the requests of a server.

use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use crate::worker::panicked;

/// Threads that do the same to whatever comes. Dropped, it does what waits and ends.
#[derive(Debug)]
pub struct Crew<T> {
    queue: Option<SyncSender<T>>,
    hands: Vec<JoinHandle<()>>,
}

impl<T: Send + 'static> Crew<T> {
    /// Starts `n` threads called `name` that do `work`; no more than `waiting` pieces wait for one of them.
    ///
    /// Work that panics is a bug that is logged, and the next piece is taken.
    pub fn spawn(
        name: &str,
        n: usize,
        waiting: usize,
        work: impl Fn(T) + Send + Sync + 'static,
    ) -> io::Result<Self> {
        let (queue, pieces) = sync_channel(waiting);
        let (pieces, work) = (Arc::new(Mutex::new(pieces)), Arc::new(work));
        let mut crew = Self { queue: Some(queue), hands: Vec::new() };
        for _ in 0..n {
            let (pieces, work) = (Arc::clone(&pieces), Arc::clone(&work));
            let take = move || {
                while let Some(piece) = next(&pieces) {
                    if let Err(panic) = catch_unwind(AssertUnwindSafe(|| work(piece))) {
                        log::error!("{}", panicked(panic.as_ref()));
                    }
                }
            };
            crew.hands.push(std::thread::Builder::new().name(name.to_owned()).spawn(take)?);
        }
        Ok(crew)
    }

    /// Hands over a piece of work, or gives it back where too many wait already.
    pub fn offer(&self, piece: T) -> Result<(), T> {
        match self.queue.as_ref().map(|queue| queue.try_send(piece)) {
            Some(Err(TrySendError::Full(piece) | TrySendError::Disconnected(piece))) => Err(piece),
            Some(Ok(())) | None => Ok(()),
        }
    }
}

/// The piece that is next, as soon as there is one.
fn next<T>(pieces: &Mutex<Receiver<T>>) -> Option<T> {
    pieces.lock().unwrap_or_else(PoisonError::into_inner).recv().ok()
}

impl<T> Drop for Crew<T> {
    fn drop(&mut self) {
        self.queue = None;
        for hand in self.hands.drain(..) {
            hand.join().ok();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;

    #[test]
    fn a_crew_does_all_that_it_took_and_outlives_a_bug() {
        let (done, all) = channel();
        let crew = Crew::spawn("crew", 3, 100, move |piece: u32| {
            assert!(piece != 7, "on purpose");
            done.send(piece).unwrap();
        });
        let crew = crew.unwrap();
        (0..20).for_each(|piece| crew.offer(piece).unwrap());
        drop(crew);
        let mut all: Vec<_> = all.iter().collect();
        all.sort_unstable();
        assert_eq!(all, (0..20).filter(|piece| *piece != 7).collect::<Vec<_>>());
    }

    #[test]
    fn what_would_wait_too_long_is_given_back() {
        let (go, wait) = channel::<()>();
        let wait = Mutex::new(wait);
        let crew = Crew::spawn("crew", 1, 1, move |_: u32| {
            wait.lock().unwrap().recv().ok();
        });
        let crew = crew.unwrap();
        let n_taken = (0..10).filter(|piece| crew.offer(*piece).is_ok()).count();
        assert!((1..=2).contains(&n_taken), "one at work and one waiting, not {n_taken}");
        drop(go);
    }
}
