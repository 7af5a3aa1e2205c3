//! Where one is in something that plays.

/// A place in an episode, in steps, which moves while it plays.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Playhead {
    at: f64,
    /// Whether it moves.
    pub is_playing: bool,
}

impl Playhead {
    /// The step that is seen of `len`.
    pub(crate) fn step(self, len: usize) -> usize {
        (self.at as usize).min(len.saturating_sub(1))
    }

    /// Stands at this step.
    pub(crate) fn stand_at(&mut self, step: usize) {
        *self = Self { at: step as f64, is_playing: false };
    }

    /// Plays on, or stops; what has come to its end begins anew.
    pub(crate) fn toggle(&mut self, len: usize) {
        self.is_playing = !self.is_playing;
        if self.step(len) + 1 >= len {
            self.at = 0.0;
        }
    }

    /// Goes on for `secs` seconds at so many steps a second, if it plays, and stops at the end.
    pub(crate) fn pass(&mut self, secs: f64, rate: f64, len: usize) {
        if self.is_playing {
            self.at += secs * rate;
            if self.at as usize + 1 >= len {
                self.stand_at(len.saturating_sub(1));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_plays_stops_at_its_end_and_begins_anew() {
        let mut head = Playhead::default();
        head.toggle(100);
        head.pass(1.0, 50.0, 100);
        assert_eq!((head.step(100), head.is_playing), (50, true));
        head.pass(1.0, 50.0, 100);
        assert_eq!((head.step(100), head.is_playing), (99, false));
        head.toggle(100);
        assert_eq!((head.step(100), head.is_playing), (0, true));
        head.stand_at(500);
        assert_eq!((head.step(100), head.step(0)), (99, 0));
    }
}
