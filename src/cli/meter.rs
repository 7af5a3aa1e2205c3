//! How far a long job is: a bar where standard error is a terminal, plain lines at intervals where it is none.

use std::time::{Duration, Instant};

use indicatif::{HumanDuration, ProgressBar, ProgressState, ProgressStyle};

/// The time from one line to the next, where there is no terminal.
const INTERVAL: Duration = Duration::from_secs(10);
/// Nothing is known of a longer time that is left.
const LONGEST: Duration = Duration::from_hours(24 * 365);

/// What a person sees of a job: what is being done, how much of how much, how fast, and the time that is left.
///
/// Nothing of it is on standard output. What a job says beside it goes through [`Meter::line`] and [`Meter::print`], so
/// that no bar is in its way; the bar itself vanishes with the meter.
#[derive(Debug)]
pub(crate) struct Meter {
    bar: ProgressBar,
    what: &'static str,
    said: Instant,
}

impl Meter {
    /// Of nothing yet.
    pub(crate) fn new() -> Self {
        Self { bar: ProgressBar::new(0), what: "", said: Instant::now() }
    }

    /// That `done` of `n` of `what` are done; what else there is to say, `more`, is asked for where it is shown.
    pub(crate) fn at(&mut self, what: &'static str, done: usize, n: usize, more: impl FnOnce() -> String) {
        if self.what != what {
            self.what = what;
            self.bar.finish_and_clear();
            self.bar = ProgressBar::new(n as u64).with_style(style()).with_prefix(what);
        }
        self.bar.set_length(n as u64);
        self.bar.set_position(done as u64);
        if self.bar.is_hidden() {
            if self.said.elapsed() >= INTERVAL {
                self.said = Instant::now();
                let (rate, left) = (self.bar.per_sec(), self.bar.eta());
                eprintln!("{}", line(what, [done, n], rate, left, &more()));
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

fn style() -> ProgressStyle {
    let rate = |state: &ProgressState, text: &mut dyn std::fmt::Write| {
        write!(text, "{}", per_second(state.per_sec())).ok();
    };
    let template = "{prefix} [{bar:24}] {pos} of {len}, {rate}, {eta} left {wide_msg}";
    let style = ProgressStyle::with_template(template).unwrap_or_else(|e| unreachable!("it is ours: {e}"));
    style.with_key("rate", rate).progress_chars("=> ")
}

/// The same as one line of text.
fn line(what: &str, [done, n]: [usize; 2], rate: f64, left: Duration, more: &str) -> String {
    let more = if more.is_empty() { String::new() } else { format!("; {more}") };
    if done == 0 || left > LONGEST {
        return format!("{what}: {done} of {n}{more}");
    }
    format!("{what}: {done} of {n}, {}, {} left{more}", per_second(rate), HumanDuration(left))
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
        let told = line("playing", [1500, 4000], 250.0, Duration::from_secs(10), "");
        assert_eq!(told, "playing: 1500 of 4000, 250/s, 10 seconds left");
        let told = line("trials", [0, 5], 0.0, Duration::ZERO, "");
        assert_eq!(told, "trials: 0 of 5", "where nothing is known");
        let told = line("learning", [1, 60], 0.5, Duration::from_mins(2), "loss 0.1234");
        assert_eq!(told, "learning: 1 of 60, 0.50/s, 2 minutes left; loss 0.1234");
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
