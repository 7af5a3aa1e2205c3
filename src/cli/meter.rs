//! How far a long job is: a bar where standard error is a terminal, plain lines at intervals where it is none.

use std::time::{Duration, Instant};

use indicatif::{HumanDuration, ProgressBar, ProgressState, ProgressStyle};

/// The time from one line to the next, where there is no terminal.
const INTERVAL: Duration = Duration::from_secs(10);
/// Nothing is known of a longer time that is left.
const LONGEST: Duration = Duration::from_hours(24 * 365);

/// How fast a job is, over all of its time: trials of minutes tell nothing of how fast it is right now.
#[derive(Clone, Copy, Debug)]
struct Pace {
    /// What had been done before it began, by a run that was stopped.
    before: usize,
    elapsed: Duration,
}

impl Pace {
    /// In a second; 0 where nothing is done yet.
    fn rate(self, done: usize) -> f64 {
        let secs = self.elapsed.as_secs_f64();
        if secs > 0.0 { done.saturating_sub(self.before) as f64 / secs } else { 0.0 }
    }

    /// The time that is left of `n`, where it can be told.
    fn left(self, done: usize, n: usize) -> Option<Duration> {
        let rate = self.rate(done);
        let secs = n.saturating_sub(done) as f64 / rate;
        (rate > 0.0 && secs < LONGEST.as_secs_f64()).then(|| Duration::from_secs_f64(secs))
    }
}

/// What a person sees of a job: what is being done, how much of how much, how fast, and the time that is left.
///
/// Nothing of it is on standard output. What a job says beside it goes through [`Meter::line`] and [`Meter::print`], so
/// that no bar is in its way; the bar itself vanishes with the meter.
#[derive(Debug)]
pub(crate) struct Meter {
    bar: ProgressBar,
    what: &'static str,
    /// What was done of it when it began, and when that was.
    began: (usize, Instant),
    said: Instant,
}

impl Meter {
    /// Of nothing yet.
    pub(crate) fn new() -> Self {
        let now = Instant::now();
        Self { bar: ProgressBar::new(0), what: "", began: (0, now), said: now }
    }

    /// That `done` of `n` of `what` are done; what else there is to say, `more`, is asked for where it is shown.
    pub(crate) fn at(&mut self, what: &'static str, done: usize, n: usize, more: impl FnOnce() -> String) {
        if self.what != what {
            self.what = what;
            self.bar.finish_and_clear();
            self.began = (done, Instant::now());
            self.bar = ProgressBar::new(n as u64).with_style(style(done)).with_prefix(what);
        }
        self.bar.set_length(n as u64);
        self.bar.set_position(done as u64);
        if self.bar.is_hidden() {
            if self.said.elapsed() >= INTERVAL {
                self.said = Instant::now();
                let pace = Pace { before: self.began.0, elapsed: self.began.1.elapsed() };
                eprintln!("{}", line(what, [done, n], pace, &more()));
            }
        } else {
            self.bar.set_message(more());
        }
    }

    /// Says a line on standard error that stays there.
    pub(crate) fn line(&mut self, text: &str) {
        self.said = Instant::now();
        self.beside(|| eprintln!("{text}"));
    }

    /// Prints a line on standard output.
    pub(crate) fn print(&self, text: &str) {
        self.beside(|| println!("{text}"));
    }

    /// Does what writes to a terminal while there is no bar on it.
    fn beside(&self, write: impl FnOnce()) {
        if self.what.is_empty() { write() } else { self.bar.suspend(write) }
    }
}

impl Drop for Meter {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

fn style(before: usize) -> ProgressStyle {
    let pace = move |state: &ProgressState| Pace { before, elapsed: state.elapsed() };
    let rate = move |state: &ProgressState, text: &mut dyn std::fmt::Write| {
        write!(text, "{}", per_second(pace(state).rate(state.pos() as usize))).ok();
    };
    let left = move |state: &ProgressState, text: &mut dyn std::fmt::Write| {
        let left = pace(state).left(state.pos() as usize, state.len().unwrap_or(0) as usize);
        write!(text, "{}", left.map_or("?".to_owned(), |left| HumanDuration(left).to_string())).ok();
    };
    let template = "{prefix} [{bar:24}] {pos} of {len}, {rate}, {left} left {wide_msg}";
    let style = ProgressStyle::with_template(template).unwrap_or_else(|e| unreachable!("it is ours: {e}"));
    style.with_key("rate", rate).with_key("left", left).progress_chars("=> ")
}

/// The same as one line of text.
fn line(what: &str, [done, n]: [usize; 2], pace: Pace, more: &str) -> String {
    let more = if more.is_empty() { String::new() } else { format!("; {more}") };
    match pace.left(done, n) {
        None => format!("{what}: {done} of {n}{more}"),
        Some(left) => {
            format!(
                "{what}: {done} of {n}, {}, {} left{more}",
                per_second(pace.rate(done)),
                HumanDuration(left)
            )
        }
    }
}

/// A rate to as many digits as tell something: of what takes long, how many in an hour.
fn per_second(rate: f64) -> String {
    if rate > 0.0 && rate < 0.01 {
        return format!("{:.1}/h", 3600.0 * rate);
    }
    let digits = if rate < 10.0 { 2 } else { 0 };
    format!("{rate:.digits$}/s")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_tells_what_how_much_how_fast_and_how_long() {
        let pace = |before, secs| Pace { before, elapsed: Duration::from_secs(secs) };
        let told = line("playing", [1500, 4000], pace(0, 6), "");
        assert_eq!(told, "playing: 1500 of 4000, 250/s, 10 seconds left");
        let told = line("trials", [0, 5], pace(0, 3), "");
        assert_eq!(told, "trials: 0 of 5", "where nothing is known");
        let told = line("learning", [1, 61], pace(0, 2), "loss 0.1234");
        assert_eq!(told, "learning: 1 of 61, 0.50/s, 2 minutes left; loss 0.1234");
        let told = line("trials", [7, 9], pace(5, 1200), "");
        assert_eq!(
            told, "trials: 7 of 9, 6.0/h, 20 minutes left",
            "what an earlier run did took no time of this one"
        );
    }

    #[test]
    fn one_job_after_the_other_is_measured_by_itself() {
        let mut meter = Meter::new();
        meter.at("playing", 5, 10, String::new);
        assert_eq!((meter.bar.position(), meter.bar.length()), (5, Some(10)));
        meter.at("answering", 0, 3, String::new);
        assert_eq!((meter.bar.position(), meter.bar.length()), (0, Some(3)));
    }
}
