//! Keys that were struck faster than the window draws.

use std::collections::VecDeque;

use eframe::egui::Event;

use crate::app::Moment;

/// Keys that wait for a picture of theirs at the most.
const MOST_WAITING: usize = 4;

/// Keys that were struck faster than the window draws.
///
/// Each is carried out in a picture of its own, in the order of striking: what one of them changes is so before the next one
/// is carried out, and buttons that are drawn first are not pressed first. Whoever drums on the keys is not waited for: of more
/// than [`MOST_WAITING`] the last ones are lost.
#[derive(Debug, Default)]
pub(crate) struct Typing {
    waiting: VecDeque<(Moment, Event)>,
    /// The picture in which one was carried out last.
    last: u64,
}

impl Typing {
    /// Leaves in `events` no more than one key that goes down, and returns the picture with which that one came.
    ///
    /// All of them stay where somebody writes, for text is not a matter of pictures.
    pub(crate) fn one_by_one(&mut self, events: &mut Vec<Event>, now: Moment, is_writing: bool) -> Moment {
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
        let (mut seen, mut taken) = (now, Vec::new());
        while let Some((picture, event)) = self.waiting.front() {
            if goes_down(event) {
                if is_taken {
                    break;
                }
                (is_taken, seen) = (true, *picture);
            }
            taken.extend(self.waiting.pop_front().map(|(_, event)| event));
        }
        self.last = now.nr;
        events.splice(0..0, taken);
        seen
    }

    /// Whether there are keys that are yet to be carried out.
    pub(crate) fn is_waiting(&self) -> bool {
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

    fn picture(nr: u64, at: f64) -> Moment {
        Moment { nr, at }
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
    fn keys_of_one_picture_are_carried_out_in_one_each_in_their_order() {
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
            let seen = typing.one_by_one(&mut events, picture(nr, 0.1 * nr as f64), false);
            assert!(nr - seen.nr <= MOST_WAITING as u64, "{seen:?} in picture {nr}");
        }
        assert_eq!(down(&events).len(), 1);
        let left = (100..).take_while(|nr| {
            let mut events = Vec::new();
            typing.one_by_one(&mut events, picture(*nr, 0.1 * *nr as f64), false);
            !down(&events).is_empty()
        });
        assert!(left.count() <= MOST_WAITING, "what waits is carried out, and no more");
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
