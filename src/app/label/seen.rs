//! Only what was seen is answered: whether a pair was on the screen before a key, a button or a click meant it.
//!
//! What reaches the window while it draws a picture was done before that picture could be seen, and often before the one
//! before it. So a pair counts as seen from the second picture after its first one, and not before [`LEAST_SECS`] has
//! passed: nobody judges two clips in less (the fastest answers of people take seconds), but a key that bounces, or two
//! that are struck at once, do come that fast.

use crate::app::{App, Panel};
use crate::query::QueryId;

/// Seconds for which a pair is on the screen before it can be answered.
pub(crate) const LEAST_SECS: f64 = 0.1;
/// Pictures of the window in which it is drawn before that.
const N_PICTURES: u64 = 2;

/// A picture of the window: its number, and when it was begun, in seconds since the window opened.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moment {
    /// Its number.
    pub nr: u64,
    /// When it was begun.
    pub at: f64,
}

/// The query whose clips are shown.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shown {
    pub query: QueryId,
    /// The first picture of those that have shown it without a break.
    first: Option<Moment>,
    /// Whether it was on the screen before, so that its time has begun.
    was_drawn: bool,
}

impl Shown {
    /// A query that is ready, and not yet on the screen.
    pub(crate) fn new(query: QueryId) -> Self {
        Self { query, first: None, was_drawn: false }
    }

    /// Takes note that `picture` shows it, and says whether that is the very first.
    fn draw(&mut self, picture: Moment) -> bool {
        self.first.get_or_insert(picture);
        !std::mem::replace(&mut self.was_drawn, true)
    }

    /// Takes note that something hides it: it is to be seen anew.
    fn hide(&mut self) {
        self.first = None;
    }

    /// Whether who did something that reached the window with the picture `seen` had seen it.
    pub(crate) fn is_seen(&self, seen: Moment) -> bool {
        self.first.is_some_and(|first| seen.nr >= first.nr + N_PICTURES && seen.at >= first.at + LEAST_SECS)
    }

    /// Whether more pictures are needed until it is, whatever else moves.
    pub(crate) fn is_becoming_seen(&self, now: Moment) -> bool {
        self.first.is_none_or(|first| now.nr <= first.nr + N_PICTURES || now.at < first.at + LEAST_SECS)
    }
}

impl App {
    /// Takes note of what the picture that was just laid out shows.
    pub fn drawn(&mut self) {
        let is_hidden = self.state.panel != Panel::Label || self.state.is_covered();
        let (picture, label) = (self.state.moment, &mut self.state.label);
        let Some(shown) = &mut label.shown else { return };
        if is_hidden {
            shown.hide();
        } else if shown.draw(picture) {
            label.clock.begin(picture.at);
        }
    }

    /// Whether the pair on the screen was seen by whoever did what is seen now; says so where it was not.
    pub(super) fn is_seen(&mut self) -> bool {
        let seen = self.state.seen;
        let label = &mut self.state.label;
        let Some(shown) = label.shown else { return false };
        let is_seen = shown.is_seen(seen);
        label.early = Some(shown.query).filter(|_| !is_seen);
        is_seen
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(nr: u64, at: f64) -> Moment {
        Moment { nr, at }
    }

    #[test]
    fn a_pair_is_seen_after_two_pictures_and_a_moment() {
        let mut shown = Shown::new(QueryId(0));
        assert!(!shown.is_seen(picture(9, 9.0)), "it is not on the screen");
        assert!(shown.draw(picture(10, 10.0)), "its time begins");
        assert!(!shown.draw(picture(11, 10.2)), "once");
        for (nr, at, is_seen) in
            [(10, 10.0, false), (11, 10.5, false), (12, 10.05, false), (12, 10.2, true), (40, 11.0, true)]
        {
            assert_eq!(shown.is_seen(picture(nr, at)), is_seen, "picture {nr} at {at}");
        }
    }

    #[test]
    fn what_was_hidden_is_to_be_seen_anew_but_its_time_goes_on() {
        let mut shown = Shown::new(QueryId(0));
        shown.draw(picture(1, 1.0));
        shown.hide();
        assert!(!shown.is_seen(picture(9, 9.0)));
        assert!(!shown.draw(picture(10, 10.0)), "its time has begun before");
        assert!(!shown.is_seen(picture(11, 10.5)) && shown.is_seen(picture(12, 10.5)));
    }
}
