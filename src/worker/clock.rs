//! Steps at a world's own rate on an absolute schedule, receiving commands while it waits.

use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use crate::worker::LiveAction;
use crate::world::Action;

/// What the rate is measured over.
const RECENT: Duration = Duration::from_secs(1);
/// After this the hands are off the controls: the window hangs, or nobody drives.
const LET_GO_AFTER: Duration = Duration::from_millis(250);
/// At least every so many steps a picture is drawn, however late it is.
const MAX_DROPPED: usize = 4;

/// What a worker wakes up for.
#[derive(Debug, PartialEq)]
pub(super) enum Beat<C> {
    /// A command came.
    Command(C),
    /// A step is due.
    Due,
    /// There will be no more commands.
    Over,
}

/// The clock of a worker that lives at the rate of a world.
///
/// A step that comes late makes the next one come sooner, so that the average keeps; but a clock that lags by more
/// than a step lets the rest go rather than play it at double speed.
#[derive(Debug)]
pub(super) struct Clock {
    /// From one step to the next.
    step: Duration,
    /// When the next step is due; nothing while the clock stands.
    due: Option<Instant>,
    n_late: usize,
    steps: Rate,
}

impl Clock {
    /// One that stands, for `rate` steps a second.
    pub(super) fn at(rate: f64) -> Self {
        Self { step: Duration::from_secs_f64(1.0 / rate), due: None, n_late: 0, steps: Rate::default() }
    }

    /// Lets it go on: the next step is due one step from `now`.
    pub(super) fn start(&mut self, now: Instant) {
        self.due = Some(now + self.step);
        self.steps = Rate::default();
    }

    /// Stops it.
    pub(super) fn stop(&mut self) {
        self.due = None;
        self.steps = Rate::default();
    }

    /// Whether it goes.
    pub(super) fn runs(&self) -> bool {
        self.due.is_some()
    }

    /// Waits for a command or for the next step, whichever comes first; commands go before steps.
    pub(super) fn wait<C>(&self, commands: &Receiver<C>) -> Beat<C> {
        let received = match self.due {
            Some(due) => commands.recv_timeout(due.saturating_duration_since(Instant::now())),
            None => commands.recv().map_err(|_| RecvTimeoutError::Disconnected),
        };
        match received {
            Ok(command) => Beat::Command(command),
            Err(RecvTimeoutError::Timeout) => Beat::Due,
            Err(RecvTimeoutError::Disconnected) => Beat::Over,
        }
    }

    /// Takes note that a step was begun at `now`.
    pub(super) fn tick(&mut self, now: Instant) {
        if let Some(due) = self.due {
            self.n_late += usize::from(now > due + self.step);
            self.due = Some((due + self.step).max(now));
        }
        self.steps.note(now);
    }

    /// How long it is to the next step; for ever, where the clock stands.
    pub(super) fn time_left(&self, now: Instant) -> Duration {
        self.due.map_or(Duration::MAX, |due| due.saturating_duration_since(now))
    }

    /// Steps that came more than a step too late.
    pub(super) fn n_late(&self) -> usize {
        self.n_late
    }

    /// Steps a second over the last second.
    pub(super) fn steps_per_sec(&self) -> f32 {
        self.steps.per_sec()
    }
}

/// How often something happens.
#[derive(Debug, Default)]
pub(super) struct Rate {
    /// When it did in the last second.
    recent: VecDeque<Instant>,
}

impl Rate {
    /// Takes note that it happened at `now`.
    pub(super) fn note(&mut self, now: Instant) {
        self.recent.push_back(now);
        while self.recent.front().is_some_and(|first| now - *first > RECENT) {
            self.recent.pop_front();
        }
    }

    /// Times a second over the last second.
    pub(super) fn per_sec(&self) -> f32 {
        match (self.recent.front(), self.recent.back()) {
            (Some(first), Some(last)) if last > first => {
                (self.recent.len() - 1) as f32 / (*last - *first).as_secs_f32()
            }
            _ => 0.0,
        }
    }
}

/// Whether there is time for a piece of work that may be left out.
#[derive(Debug, Default)]
pub(super) struct Allowance {
    /// How long it takes, smoothed.
    cost: Duration,
    n_dropped: usize,
}

impl Allowance {
    /// Does `work` if it fits into `left`, or if it was left out for too long.
    pub(super) fn spend<T>(&mut self, left: Duration, work: impl FnOnce() -> T) -> Option<T> {
        if self.cost > left && self.n_dropped < MAX_DROPPED {
            self.n_dropped += 1;
            return None;
        }
        let began = Instant::now();
        let done = work();
        self.cost = (self.cost * 3 + began.elapsed()) / 4;
        self.n_dropped = 0;
        Some(done)
    }
}

/// What the driver's hands do at `now`: nothing, which is `neutral`, where nothing came from them for a quarter of a second.
pub(super) fn held(action: &LiveAction, neutral: Action, now: Instant) -> Action {
    match action.peek() {
        Some((action, given))
            if now.saturating_duration_since(given) <= LET_GO_AFTER && action.len() == neutral.len() =>
        {
            action
        }
        _ => neutral,
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;

    const STEP: Duration = Duration::from_millis(20);
    use crate::worker::Latest;

    #[test]
    fn a_clock_that_keeps_time_is_never_late_and_counts_fifty() {
        let began = Instant::now();
        let mut clock = Clock::at(50.0);
        clock.start(began);
        (1..=200).for_each(|t| clock.tick(began + STEP * t));
        assert_eq!(clock.n_late(), 0);
        assert!((clock.steps_per_sec() - 50.0).abs() < 0.01, "{}", clock.steps_per_sec());
        assert_eq!(clock.time_left(began + STEP * 200), STEP);
    }

    #[test]
    fn a_small_delay_is_made_up_for_and_a_large_one_is_let_go() {
        let began = Instant::now();
        let mut clock = Clock::at(50.0);
        clock.start(began);
        clock.tick(began + STEP * 3 / 2);
        assert_eq!((clock.n_late(), clock.time_left(began)), (0, STEP * 2));
        clock.tick(began + STEP * 10);
        assert_eq!((clock.n_late(), clock.time_left(began + STEP * 10)), (1, Duration::ZERO));
        clock.tick(began + STEP * 10);
        assert_eq!((clock.n_late(), clock.time_left(began + STEP * 10)), (1, STEP));
    }

    #[test]
    fn commands_go_before_steps_and_the_end_before_both() {
        let (commands, received) = channel();
        let mut clock = Clock::at(50.0);
        let long_ago = Instant::now().checked_sub(STEP * 5).unwrap();
        clock.start(long_ago);
        commands.send("pause").unwrap();
        assert_eq!(clock.wait(&received), Beat::Command("pause"));
        assert_eq!(clock.wait(&received), Beat::Due);
        drop(commands);
        assert_eq!(clock.wait(&received), Beat::Over);
    }

    #[test]
    fn what_takes_too_long_is_done_every_fifth_time() {
        let mut allowance = Allowance { cost: Duration::from_secs(1000), n_dropped: 0 };
        let done = (0..10).map(|_| allowance.spend(Duration::ZERO, || ()).is_some());
        assert_eq!(done.filter(|was_done| *was_done).count(), 2);
    }

    #[test]
    fn hands_of_which_nothing_comes_let_go() {
        let (slot, now) = (Latest::default(), Instant::now());
        let neutral = Action::new([0.0; 3]);
        assert_eq!(held(&slot, neutral, now), neutral);
        slot.put((Action::new([1.0, 0.5, 0.0]), now));
        assert_eq!(held(&slot, neutral, now + LET_GO_AFTER), Action::new([1.0, 0.5, 0.0]));
        assert_eq!(held(&slot, Action::new([0.5]), now), [0.5], "hands of another world");
        assert_eq!(held(&slot, neutral, now + LET_GO_AFTER * 2), neutral);
    }
}
