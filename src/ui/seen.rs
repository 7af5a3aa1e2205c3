//! Only what was seen is answered: whether a pair was on the screen before a key, a button or a click meant it.
//!
//! What reaches the window while it draws a picture was done before that picture could be seen, and often before the one
//! before it. So a pair counts as seen from the second picture after its first one, and not before [`MOMENT`] has
//! passed: nobody judges two clips in less (the fastest answers of people take seconds), but a key that bounces, or two
//! that are struck at once, do come that fast.

use std::collections::VecDeque;

use eframe::egui::Event;

use crate::query::QueryId;
use crate::ui::App;
use crate::ui::command::Panel;

/// Seconds for which a pair is on the screen before it can be answered.
pub(crate) const MOMENT: f64 = 0.1;
/// Pictures of the window in which it is drawn before that.
const N_PICTURES: u64 = 2;

/// Keys that wait for a picture of theirs at the most.
const MOST_WAITING: usize = 4;

/// A picture of the window: its number, and when it was begun, in seconds since the window opened.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Picture {
    pub nr: u64,
    pub at: f64,
}

/// The query whose clips are shown.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shown {
    pub query: QueryId,
    /// The first picture of those that have shown it without a break.
    first: Option<Picture>,
    /// Whether it was on the screen before, so that its time has begun.
    was_drawn: bool,
}

impl Shown {
    /// A query that is ready, and not yet on the screen.
    pub(crate) fn new(query: QueryId) -> Self {
        Self { query, first: None, was_drawn: false }
    }

    /// Takes note that `picture` shows it, and says whether that is the very first.
    fn draw(&mut self, picture: Picture) -> bool {
        self.first.get_or_insert(picture);
        !std::mem::replace(&mut self.was_drawn, true)
    }

    /// Takes note that something hides it: it is to be seen anew.
    fn hide(&mut self) {
        self.first = None;
    }

    /// Whether who did something that reached the window with the picture `heard` had seen it.
    pub(crate) fn is_seen(&self, heard: Picture) -> bool {
        self.first.is_some_and(|first| heard.nr >= first.nr + N_PICTURES && heard.at >= first.at + MOMENT)
    }

    /// Whether more pictures are needed until it is, whatever else moves.
    pub(crate) fn is_becoming_seen(&self, now: Picture) -> bool {
        self.first.is_none_or(|first| now.nr <= first.nr + N_PICTURES || now.at < first.at + MOMENT)
    }
}

impl App {
    /// Takes note of what the picture that was just laid out shows.
    pub(super) fn note_drawn(&mut self) {
        let is_hidden = self.state.panel != Panel::Label || self.state.is_covered();
        let (picture, label) = (self.state.picture, &mut self.state.label);
        let Some(shown) = &mut label.shown else { return };
        if is_hidden {
            shown.hide();
        } else if shown.draw(picture) {
            label.pace.begin(picture.at);
        }
    }

    /// Whether the pair on the screen was seen by whoever did what is heard now; says so where it was not.
    pub(super) fn is_seen(&mut self) -> bool {
        let heard = self.state.heard;
        let label = &mut self.state.label;
        let Some(shown) = label.shown else { return false };
        let is_seen = shown.is_seen(heard);
        label.early = Some(shown.query).filter(|_| !is_seen);
        is_seen
    }
}

/// Keys that were struck faster than the window draws.
///
/// Each is heard in a picture of its own, in the order of striking: what one of them changes is so before the next one
/// is heard, and buttons that are drawn first are not pressed first. Whoever drums on the keys is not waited for: of more
/// than [`MOST_WAITING`] the last ones are lost.
#[derive(Debug, Default)]
pub(super) struct Typing {
    waiting: VecDeque<(Picture, Event)>,
    /// The picture in which one was heard last.
    last: u64,
}

impl Typing {
    /// Leaves in `events` no more than one key that goes down, and returns the picture with which that one came.
    ///
    /// All of them stay where somebody writes, for text is not a matter of pictures.
    pub(super) fn one_by_one(&mut self, events: &mut Vec<Event>, now: Picture, is_writing: bool) -> Picture {
        let n_down = events.iter().filter(|event| goes_down(event)).count();
        let is_clicked = events.iter().any(|event| matches!(event, Event::PointerButton { .. }));
        let is_simple = self.waiting.is_empty() && (n_down == 0 || n_down == 1 && !is_clicked);
        if is_simple || is_writing {
            let waiting = self.waiting.drain(..).map(|(_, event)| event);
            events.splice(0..0, waiting);
            self.last = now.nr;
            return now;
        }
        // A click that came first is carried out first.
        let mut is_taken = self.last == now.nr && now.nr > 0;
        for event in std::mem::take(events) {
            match event {
                _ if goes_down(&event) && self.n_waiting() >= MOST_WAITING => {}
                Event::Key { .. } | Event::Text(_) => self.waiting.push_back((now, event)),
                other => {
                    is_taken |= self.waiting.is_empty() && matches!(other, Event::PointerButton { .. });
                    events.push(other);
                }
            }
        }
        let (mut heard, mut taken) = (now, Vec::new());
        while let Some((picture, event)) = self.waiting.front() {
            if goes_down(event) {
                if is_taken {
                    break;
                }
                (is_taken, heard) = (true, *picture);
            }
            taken.extend(self.waiting.pop_front().map(|(_, event)| event));
        }
        self.last = now.nr;
        events.splice(0..0, taken);
        heard
    }

    /// Whether there are keys that are yet to be heard.
    pub(super) fn is_waiting(&self) -> bool {
        !self.waiting.is_empty()
    }

    fn n_waiting(&self) -> usize {
        self.waiting.iter().filter(|(_, event)| goes_down(event)).count()
    }
}

fn goes_down(event: &Event) -> bool {
    matches!(event, Event::Key { pressed: true, repeat: false, .. })
}

#[cfg(test)]
mod tests {
    use eframe::egui::{Key, Modifiers, PointerButton, pos2};

    use super::*;

    fn picture(nr: u64, at: f64) -> Picture {
        Picture { nr, at }
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

    fn key(key: Key, pressed: bool) -> Event {
        Event::Key { key, physical_key: None, pressed, repeat: false, modifiers: Modifiers::NONE }
    }

    /// The keys that go down in these events.
    fn down(events: &[Event]) -> Vec<Key> {
        let down = |event: &Event| match event {
            Event::Key { key, pressed: true, .. } => Some(*key),
            _ => None,
        };
        events.iter().filter_map(down).collect()
    }

    #[test]
    fn keys_of_one_picture_are_heard_in_one_each_in_their_order() {
        let mut typing = Typing::default();
        let mut events = vec![key(Key::D, true), key(Key::D, false), key(Key::A, true), key(Key::A, false)];
        let first = picture(5, 1.0);
        assert_eq!(typing.one_by_one(&mut events, first, false), first);
        assert_eq!((down(&events), typing.is_waiting()), (vec![Key::D], true));

        // The same picture is laid out a second time.
        let mut events = Vec::new();
        typing.one_by_one(&mut events, first, false);
        assert_eq!(down(&events), []);

        let mut events = vec![key(Key::S, true)];
        assert_eq!(typing.one_by_one(&mut events, picture(6, 1.1), false), first, "A was struck before");
        assert_eq!(down(&events), [Key::A]);
        let mut events = Vec::new();
        assert_eq!(typing.one_by_one(&mut events, picture(7, 1.2), false), picture(6, 1.1));
        assert_eq!((down(&events), typing.is_waiting()), (vec![Key::S], false));
    }

    #[test]
    fn who_drums_on_the_keys_is_soon_caught_up_with() {
        let mut typing = Typing::default();
        let mut events = Vec::new();
        for nr in 1..100 {
            events = vec![key(Key::A, true), key(Key::A, false), key(Key::D, true), key(Key::D, false)];
            let heard = typing.one_by_one(&mut events, picture(nr, 0.1 * nr as f64), false);
            assert!(nr - heard.nr <= MOST_WAITING as u64, "{heard:?} in picture {nr}");
        }
        assert_eq!(down(&events).len(), 1);
        let left = (100..).take_while(|nr| {
            let mut events = Vec::new();
            typing.one_by_one(&mut events, picture(*nr, 0.1 * *nr as f64), false);
            !down(&events).is_empty()
        });
        assert!(left.count() <= MOST_WAITING, "what waits is heard, and no more");
    }

    #[test]
    fn a_key_after_a_click_waits_for_the_next_picture() {
        let click = Event::PointerButton {
            pos: pos2(1.0, 1.0),
            button: PointerButton::Primary,
            pressed: false,
            modifiers: Modifiers::NONE,
        };
        let mut typing = Typing::default();
        let mut events = vec![click.clone(), key(Key::A, true)];
        typing.one_by_one(&mut events, picture(5, 1.0), false);
        assert_eq!((down(&events), events.len()), (vec![], 1));
        let mut events = vec![key(Key::D, true), click];
        typing.one_by_one(&mut events, picture(6, 1.1), false);
        assert_eq!(down(&events), [Key::A]);
    }

    #[test]
    fn who_writes_is_not_slowed_down() {
        let mut typing = Typing::default();
        let mut events = vec![key(Key::D, true), Event::Text("d".to_owned()), key(Key::A, true)];
        typing.one_by_one(&mut events, picture(5, 1.0), true);
        assert_eq!((events.len(), typing.is_waiting()), (3, false));
    }
}
