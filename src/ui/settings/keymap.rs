//! What keys do, and which: every binding can be changed but those of help and of numbers.

use std::collections::BTreeMap;

use eframe::egui::Key;
use serde::{Deserialize, Serialize};

use crate::env::controls::DrivingKey;

/// Something that is done by a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[expect(missing_docs, reason = "each says below what it does")]
pub enum KeyAction {
    SteerLeft,
    SteerRight,
    Gas,
    Brake,
    Begin,
    Keep,
    Redo,
    Pause,
    Step,
    Unsafe,
    HandOver,
    Beside,
    Leave,
    OnlyLeft,
    OnlyRight,
    Neither,
    PreferLeft,
    Equal,
    PreferRight,
    Yes,
    No,
    Skip,
    Undo,
    Restore,
    Flag,
    Answers,
    Guide,
    Restart,
    PauseClips,
    Back,
    Forward,
    Slower,
    Faster,
}

impl KeyAction {
    /// All of them, those of driving first.
    pub(crate) const ALL: [Self; 33] = [
        Self::SteerLeft,
        Self::SteerRight,
        Self::Gas,
        Self::Brake,
        Self::Begin,
        Self::Keep,
        Self::Redo,
        Self::Pause,
        Self::Step,
        Self::Unsafe,
        Self::HandOver,
        Self::Beside,
        Self::Leave,
        Self::OnlyLeft,
        Self::OnlyRight,
        Self::Neither,
        Self::PreferLeft,
        Self::Equal,
        Self::PreferRight,
        Self::Yes,
        Self::No,
        Self::Skip,
        Self::Undo,
        Self::Restore,
        Self::Flag,
        Self::Answers,
        Self::Guide,
        Self::Restart,
        Self::PauseClips,
        Self::Back,
        Self::Forward,
        Self::Slower,
        Self::Faster,
    ];

    /// What it does, and by which keys at first.
    fn says(self) -> (&'static str, &'static [Key]) {
        match self {
            Self::SteerLeft => ("steer left", &[Key::ArrowLeft, Key::A]),
            Self::SteerRight => ("steer right", &[Key::ArrowRight, Key::D]),
            Self::Gas => ("gas", &[Key::ArrowUp, Key::W]),
            Self::Brake => ("brake", &[Key::ArrowDown, Key::S]),
            Self::Begin => ("begin", &[Key::Enter]),
            Self::Keep => ("end and keep", &[Key::N]),
            Self::Redo => ("throw away and redo", &[Key::R]),
            Self::Pause => ("pause", &[Key::P]),
            Self::Step => ("one step, paused", &[Key::Period]),
            Self::Unsafe => ("unsafe now", &[Key::U]),
            Self::HandOver => ("hand over", &[Key::M]),
            Self::Beside => ("dream beside the real car", &[Key::B]),
            Self::Leave => ("leave", &[Key::Escape]),
            Self::OnlyLeft => ("only left is safe", &[Key::A]),
            Self::OnlyRight => ("only right is safe", &[Key::D]),
            Self::Neither => ("neither is safe", &[Key::S]),
            Self::PreferLeft => ("left is better", &[Key::ArrowLeft]),
            Self::Equal => ("equal", &[Key::ArrowUp]),
            Self::PreferRight => ("right is better", &[Key::ArrowRight]),
            Self::Yes => ("it stays safe", &[Key::Y]),
            Self::No => ("it becomes unsafe", &[Key::N]),
            Self::Skip => ("skip", &[Key::Space]),
            Self::Undo => ("undo", &[Key::Backspace]),
            Self::Restore => ("redo", &[Key::R]),
            Self::Flag => ("flag", &[Key::F]),
            Self::Answers => ("list of answers", &[Key::L]),
            Self::Guide => ("one question at a time", &[Key::G]),
            Self::Restart => ("clips from the start", &[Key::Num0]),
            Self::PauseClips => ("pause the clips", &[Key::P]),
            Self::Back => ("a frame back", &[Key::Comma]),
            Self::Forward => ("a frame on", &[Key::Period]),
            Self::Slower => ("slower", &[Key::OpenBracket]),
            Self::Faster => ("faster", &[Key::CloseBracket]),
        }
    }

    /// What it does, in words.
    pub fn name(self) -> &'static str {
        self.says().0
    }

    /// Whether it is done at the wheel; the same key may do something else with answers.
    fn is_driving(self) -> bool {
        self < Self::OnlyLeft
    }
}

/// One of the keys of an action: the action, and which of them.
pub(crate) type Slot = (KeyAction, usize);

/// Who has a key already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Taken {
    /// One whose key can be changed.
    By(Slot),
    /// What always has this key.
    Fixed(&'static str),
}

/// A key that is to be changed, and the one that could not be had.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rebinding {
    pub slot: Slot,
    pub wanted: Option<(Key, Taken)>,
}

/// Which keys do what.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Keys(BTreeMap<KeyAction, Vec<Key>>);

impl Default for Keys {
    fn default() -> Self {
        Self(
            KeyAction::ALL.into_iter().map(|key_action| (key_action, key_action.says().1.to_vec())).collect(),
        )
    }
}

impl From<Keys> for BTreeMap<KeyAction, Vec<Key>> {
    fn from(keys: Keys) -> Self {
        keys.0
    }
}

impl Keys {
    /// The first keys but for those of `own`, as far as these can be had; of the others, why not.
    pub(crate) fn with(own: BTreeMap<KeyAction, Vec<Key>>) -> (Self, Vec<(KeyAction, String)>) {
        let (mut keys, mut refused) = (Self::default(), Vec::new());
        for (key_action, wanted) in own {
            let n = key_action.says().1.len();
            if wanted.len() == n {
                keys.0.insert(key_action, wanted);
            } else {
                refused.push((key_action, format!("{} keys where it has {n}", wanted.len())));
            }
        }
        while let Some((key_action, what)) = keys.conflict() {
            refused.push((key_action, what));
            keys.0.insert(key_action, key_action.says().1.to_vec());
        }
        (keys, refused)
    }

    /// An action with keys of its own, one of which it cannot have, and why: the last one, for the first may stay.
    fn conflict(&self) -> Option<(KeyAction, String)> {
        let is_own = |key_action: &KeyAction| self.all(*key_action) != key_action.says().1;
        let slots = |key_action: KeyAction| (0..self.all(key_action).len()).map(move |idx| (key_action, idx));
        KeyAction::ALL.into_iter().rev().filter(is_own).flat_map(slots).find_map(|slot| {
            let key = self.all(slot.0)[slot.1];
            let whose = match self.taken(slot, key)? {
                Taken::By((other, _)) => other.name(),
                Taken::Fixed(what) => what,
            };
            Some((slot.0, format!("{} is the key of “{whose}”", key.name())))
        })
    }

    /// All keys of `key_action`.
    pub(crate) fn all(&self, key_action: KeyAction) -> &[Key] {
        self.0.get(&key_action).filter(|keys| !keys.is_empty()).map_or(key_action.says().1, Vec::as_slice)
    }

    /// The key that is shown on the button of `key_action`.
    pub fn of(&self, key_action: KeyAction) -> Key {
        self.all(key_action)[0]
    }

    /// What `key` does at the wheel.
    pub(crate) fn driving(&self, key: Key) -> Option<DrivingKey> {
        let wheel = [
            (KeyAction::SteerLeft, DrivingKey::Left),
            (KeyAction::SteerRight, DrivingKey::Right),
            (KeyAction::Gas, DrivingKey::Up),
            (KeyAction::Brake, DrivingKey::Down),
        ];
        wheel
            .into_iter()
            .find(|(key_action, _)| self.all(*key_action).contains(&key))
            .map(|(_, driving)| driving)
    }

    /// Who has `key` where `slot` would like it.
    pub(crate) fn taken(&self, slot: Slot, key: Key) -> Option<Taken> {
        let digits = [
            Key::Num1,
            Key::Num2,
            Key::Num3,
            Key::Num4,
            Key::Num5,
            Key::Num6,
            Key::Num7,
            Key::Num8,
            Key::Num9,
        ];
        match key {
            Key::Questionmark | Key::Slash | Key::F1 => return Some(Taken::Fixed("keys and help")),
            Key::Tab => return Some(Taken::Fixed("the next control")),
            key if digits.contains(&key) && !slot.0.is_driving() => {
                return Some(Taken::Fixed("reasons and justifications"));
            }
            _ => {}
        }
        let here =
            KeyAction::ALL.into_iter().filter(|key_action| key_action.is_driving() == slot.0.is_driving());
        let mut slots =
            here.flat_map(|key_action| (0..self.all(key_action).len()).map(move |idx| (key_action, idx)));
        slots
            .find(|&(key_action, idx)| (key_action, idx) != slot && self.all(key_action)[idx] == key)
            .map(Taken::By)
    }

    /// Gives `key` to `slot`; whoever had it there gets the one that `slot` had.
    pub(crate) fn bind(&mut self, slot: Slot, key: Key) {
        let before = self.all(slot.0)[slot.1];
        if let Some(Taken::By(other)) = self.taken(slot, key) {
            self.put(other, before);
        }
        self.put(slot, key);
    }

    fn put(&mut self, (key_action, idx): Slot, key: Key) {
        let mut keys = self.all(key_action).to_vec();
        keys[idx] = key;
        self.0.insert(key_action, keys);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_deeds_of_a_place_have_a_key_at_first() {
        let keys = Keys::default();
        for key_action in KeyAction::ALL {
            for (idx, &key) in keys.all(key_action).iter().enumerate() {
                assert_eq!(keys.taken((key_action, idx), key), None, "{key_action:?} {key:?}");
            }
        }
    }

    #[test]
    fn who_takes_a_key_gives_its_own() {
        let mut keys = Keys::default();
        let keep = (KeyAction::Keep, 0);
        assert_eq!(keys.taken(keep, Key::S), Some(Taken::By((KeyAction::Brake, 1))));
        assert_eq!(keys.taken(keep, Key::F), None, "flagging is done elsewhere");
        assert_eq!(keys.taken(keep, Key::Slash), Some(Taken::Fixed("keys and help")));
        keys.bind(keep, Key::S);
        assert_eq!(
            (keys.of(KeyAction::Keep), keys.all(KeyAction::Brake)),
            (Key::S, &[Key::ArrowDown, Key::N][..])
        );
        assert_eq!(keys.driving(Key::N), Some(DrivingKey::Down));
    }
}
