//! What first files of worlds have in common, wherever the worlds come from.

use dropj::text::shown;
use dropj::world::{KeyInput, PadAxis, PadInput};

/// Pixels a side beyond which a first file says that networks see less.
pub(super) const MOST_TRAINED: u32 = 128;

/// `name` as that of a file: what cannot stand in one becomes a dash.
pub(super) fn file_name(name: &str) -> String {
    let id: String = name
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() || ".-_".contains(c) { c } else { '-' })
        .skip_while(|c| !c.is_ascii_alphanumeric())
        .take(60)
        .collect();
    if id.is_empty() { "world".to_owned() } else { id }
}

/// `text` in one line that a file can have as a name.
pub(super) fn readable(text: &str) -> Option<String> {
    let line: String = text.trim().chars().filter(|c| !c.is_control()).take(60).collect();
    let line = line.trim().to_owned();
    (!line.is_empty() && shown(&line) == line).then_some(line)
}

/// What is free for the axes to come: keys and sticks in pairs, and single ones for axes with a neutral end.
pub(super) struct Inputs {
    pairs: Vec<[(&'static str, PadAxis); 2]>,
    singles: Vec<(&'static str, Option<PadAxis>)>,
}

impl Inputs {
    pub(super) fn new() -> Self {
        let pairs = vec![
            [("Left", PadAxis::LeftStickLeft), ("Right", PadAxis::LeftStickRight)],
            [("Down", PadAxis::LeftStickDown), ("Up", PadAxis::LeftStickUp)],
            [("A", PadAxis::RightStickLeft), ("D", PadAxis::RightStickRight)],
            [("S", PadAxis::RightStickDown), ("W", PadAxis::RightStickUp)],
        ];
        let singles = vec![
            ("Up", Some(PadAxis::RightTrigger)),
            ("Down", Some(PadAxis::LeftTrigger)),
            ("W", None),
            ("S", None),
            ("E", None),
            ("Q", None),
        ];
        Self { pairs, singles }
    }

    /// What moves the next axis. Nothing where all is taken.
    pub(super) fn take(&mut self, low: f32, high: f32, neutral: f32) -> (Vec<KeyInput>, Vec<PadInput>) {
        let ends: Vec<f32> = [low, high].into_iter().filter(|to| *to != neutral).collect();
        let taken: Vec<(&str, Option<PadAxis>)> = if ends.len() == 2 {
            let pair = if self.pairs.is_empty() { None } else { Some(self.pairs.remove(0)) };
            pair.iter().flatten().map(|(key, axis)| (*key, Some(*axis))).collect()
        } else if self.singles.is_empty() {
            vec![]
        } else {
            vec![self.singles.remove(0)]
        };
        let is_taken = |key: &str| taken.iter().any(|(other, _)| *other == key);
        self.pairs.retain(|pair| !pair.iter().any(|(key, _)| is_taken(key)));
        self.singles.retain(|(key, _)| !is_taken(key));
        let keys = taken.iter().zip(&ends).map(|((key, _), &to)| KeyInput { key: (*key).to_owned(), to });
        let pad =
            taken.iter().zip(&ends).filter_map(|((_, axis), &to)| Some(PadInput { axis: (*axis)?, to }));
        (keys.collect(), pad.collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_get_keys_of_their_own() {
        let mut inputs = Inputs::new();
        let mut keys = |low, high| {
            let (keys, pad) = inputs.take(low, high, 0.0);
            (
                keys.iter().map(|input| format!("{} {}", input.key, input.to)).collect::<Vec<_>>().join(", "),
                pad.len(),
            )
        };
        assert_eq!(keys(-1.0, 1.0), ("Left -1, Right 1".to_owned(), 2));
        assert_eq!(keys(0.0, 1.0), ("Up 1".to_owned(), 1));
        assert_eq!(keys(0.0, 2.0), ("Down 2".to_owned(), 1));
        assert_eq!(keys(-3.0, 1.0), ("A -3, D 1".to_owned(), 2));
        assert_eq!(keys(-3.0, 1.0), ("S -3, W 1".to_owned(), 2));
        assert_eq!(keys(-3.0, 1.0), (String::new(), 0));
    }
}
