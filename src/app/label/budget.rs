//! How far labeling is, how fast it goes, and when a pause would do good.
//!
//! Only time in which somebody was there counts: the clock stands while the window is not in front, and from a while
//! after the last key, move or button on.

use serde::{Deserialize, Serialize};

use crate::session::Statistics;

/// Seconds without a sign of anybody after which nobody is taken to be there.
pub(crate) const AWAY_AFTER: f64 = 30.0;
/// The longest that one picture of the window may stand for, in seconds: more is a program that slept.
const LONGEST_FRAME: f64 = 1.0;
/// Seconds away that make a pause.
const PAUSE: f64 = 180.0;

/// How much is to be labeled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Budget {
    /// So many queries, answered or skipped. Paper: 500.
    Queries(u32),
    /// So many minutes with queries.
    Minutes(u32),
}

impl Default for Budget {
    fn default() -> Self {
        Self::Queries(500)
    }
}

impl Budget {
    /// What is offered.
    pub(crate) const ALL: [Self; 8] = [
        Self::Queries(100),
        Self::Queries(200),
        Self::Queries(500),
        Self::Queries(1000),
        Self::Minutes(15),
        Self::Minutes(30),
        Self::Minutes(60),
        Self::Minutes(120),
    ];

    /// In words.
    pub(crate) fn name(self) -> String {
        match self {
            Self::Queries(n) => format!("{n} queries"),
            Self::Minutes(n) => format!("{n} minutes"),
        }
    }

    /// The share that is done, in `[0, 1]`.
    pub(crate) fn share(self, so_far: &Statistics) -> f32 {
        let share = match self {
            Self::Queries(n) => n_done(so_far) as f32 / n.max(1) as f32,
            Self::Minutes(n) => so_far.active_secs / 60.0 / n.max(1) as f32,
        };
        share.clamp(0.0, 1.0)
    }

    /// What is done and what is left, as far as the pace tells: `12 of 500 queries · 430 labels an hour · 68 min left`.
    pub(crate) fn say(self, so_far: &Statistics) -> String {
        let (n, minutes) = (n_done(so_far), so_far.active_secs / 60.0);
        let done = match self {
            Self::Queries(all) => format!("{n} of {all} queries"),
            Self::Minutes(all) => format!("{minutes:.0} of {all} min · {n} queries"),
        };
        // A pace of one or two answers is none.
        let Some(per_hour) = so_far.labels_per_hour().filter(|_| so_far.n_timed_answered >= 3) else {
            return done;
        };
        let left = match self {
            _ if self.share(so_far) >= 1.0 => "done".to_owned(),
            Self::Queries(all) => {
                let minutes = (all as f32 - n as f32) * minutes / so_far.n_timed as f32;
                format!("{:.0} min left", minutes.ceil())
            }
            Self::Minutes(all) => {
                format!("{:.0} more to come", (all as f32 - minutes) * so_far.n_timed as f32 / minutes)
            }
        };
        format!("{done} · {per_hour:.0} labels an hour · {left}")
    }
}

/// Queries that were answered or skipped.
fn n_done(so_far: &Statistics) -> usize {
    so_far.n_answered + so_far.n_skipped
}

/// The clock of whoever labels.
#[derive(Clone, Debug, Default)]
pub(crate) struct LabelClock {
    /// When somebody last gave a sign, in seconds since the window opened, as all times here.
    touched: f64,
    /// When the clock was last looked at.
    looked: f64,
    /// When somebody was last seen labeling.
    seen: f64,
    /// Seconds for which the present query was before somebody's eyes.
    watched: f64,
    /// Seconds of labeling since the last pause.
    worked: f64,
    /// The hint comes once `worked` is above this; dismissing it puts it off.
    put_off: f64,
}

impl LabelClock {
    /// Somebody is there.
    pub(crate) fn touch(&mut self, now: f64) {
        self.touched = now;
    }

    /// Whether nobody has given a sign for a while.
    pub(crate) fn is_away(&self, now: f64) -> bool {
        now - self.touched > AWAY_AFTER
    }

    /// Another query is on the screen from `now` on.
    pub(crate) fn begin(&mut self, now: f64) {
        (self.watched, self.looked) = (0.0, now);
    }

    /// Takes in the time since the last picture, if a query was on the screen, in a window that `has_focus`.
    pub(crate) fn pass(&mut self, now: f64, has_focus: bool) {
        let secs = (now - self.looked).clamp(0.0, LONGEST_FRAME);
        self.looked = now;
        if !has_focus || self.is_away(now) {
            return;
        }
        if now - self.seen > PAUSE {
            (self.worked, self.put_off) = (0.0, 0.0);
        }
        self.seen = now;
        self.watched += secs;
        self.worked += secs;
    }

    /// Seconds for which the present query was before somebody's eyes.
    pub(crate) fn watched(&self) -> f32 {
        self.watched as f32
    }

    /// Minutes without a pause, where those are more than `most`, and the hint was not put off.
    pub(crate) fn overdue(&self, most: u32) -> Option<u32> {
        let is_due = most > 0 && self.worked >= self.put_off.max(60.0 * f64::from(most));
        is_due.then_some((self.worked / 60.0) as u32)
    }

    /// Says nothing of pauses for another `most` minutes.
    pub(crate) fn put_off(&mut self, most: u32) {
        self.put_off = self.worked + 60.0 * f64::from(most);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn so_far(n_answered: usize, n_skipped: usize, active_secs: f32) -> Statistics {
        let (n_timed, n_timed_answered) = (n_answered + n_skipped, n_answered);
        let n_asked = 600;
        let timed = Statistics { n_timed, n_timed_answered, ..Statistics::default() };
        Statistics { n_asked, n_answered, n_skipped, active_secs, ..timed }
    }

    #[test]
    fn a_budget_tells_what_is_left_at_this_pace() {
        let half_an_hour = so_far(200, 50, 1800.0);
        let said = Budget::Queries(500).say(&half_an_hour);
        assert_eq!(said, "250 of 500 queries · 400 labels an hour · 30 min left");
        let said = Budget::Minutes(60).say(&half_an_hour);
        assert_eq!(said, "30 of 60 min · 250 queries · 400 labels an hour · 250 more to come");
        let by_stand_ins = Statistics { n_answered: 180, active_secs: 2.0, ..Statistics::default() };
        assert_eq!(
            Budget::Queries(500).say(&by_stand_ins),
            "180 of 500 queries",
            "who took no time has no pace"
        );
        assert_eq!(Budget::Queries(250).say(&half_an_hour), "250 of 250 queries · 400 labels an hour · done");
        assert_eq!(Budget::Queries(500).say(&so_far(2, 1, 3.0)), "3 of 500 queries", "too few for a pace");
        assert_eq!(Budget::Minutes(120).share(&half_an_hour), 0.25);
    }

    /// Somebody who touches something every `every` seconds for `secs`, at ten pictures a second.
    fn live(pace: &mut LabelClock, now: &mut f64, secs: f64, every: f64, has_focus: bool) {
        let end = *now + secs;
        let mut next = *now;
        while *now < end {
            if *now >= next {
                pace.touch(*now);
                next += every;
            }
            *now += 0.1;
            pace.pass(*now, has_focus);
        }
    }

    #[test]
    fn time_in_which_nobody_is_there_does_not_count() {
        let (mut pace, mut now) = (LabelClock::default(), 1000.0);
        pace.begin(now);
        live(&mut pace, &mut now, 5.0, 1.0, true);
        assert!((pace.watched() - 5.0).abs() < 0.2, "{}", pace.watched());
        live(&mut pace, &mut now, 500.0, 1e9, true);
        let until_away = 5.0 + AWAY_AFTER as f32;
        assert!((pace.watched() - until_away).abs() < 0.5, "{}", pace.watched());
        assert!(pace.is_away(now), "nobody has touched anything");
        live(&mut pace, &mut now, 60.0, 1.0, false);
        now += 900.0;
        pace.pass(now, true);
        assert!(pace.watched() < until_away + 1.5, "neither another window nor a sleeping program counts");
        pace.begin(now);
        assert_eq!(pace.watched(), 0.0);
    }

    #[test]
    fn a_pause_is_suggested_put_off_and_taken() {
        let (mut pace, mut now) = (LabelClock::default(), 0.0);
        live(&mut pace, &mut now, 24.0 * 60.0, 1.0, true);
        assert_eq!(pace.overdue(25), None);
        live(&mut pace, &mut now, 90.0, 1.0, true);
        assert_eq!((pace.overdue(25), pace.overdue(0)), (Some(25), None));
        pace.put_off(25);
        live(&mut pace, &mut now, 24.0 * 60.0, 1.0, true);
        assert_eq!(pace.overdue(25), None, "not again so soon");
        live(&mut pace, &mut now, 120.0, 1.0, true);
        assert_eq!(pace.overdue(25), Some(51));
        now += PAUSE + 1.0;
        live(&mut pace, &mut now, 60.0, 1.0, true);
        assert_eq!(pace.overdue(25), None, "a pause begins a new count");
    }
}
