//! What keys do, and which: every binding can be changed but those of help and of numbers.
//!
//! The keys that move a world's axes come from its file, and can be changed by their names: what somebody has for A
//! moves whatever a world moves by A. Where a world moves something by a key that is a command too, the key moves it
//! while that world is acted in, and the command has none: its button shows no key then, and the list of keys says so.

use std::collections::BTreeMap;

use eframe::egui::Key;
use serde::{Deserialize, Serialize, Serializer};

use crate::world::{Axis, KEYS, WorldSpec};

/// Something that is done by a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[expect(missing_docs, reason = "each says below what it does")]
pub enum KeyAction {
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
    pub(crate) const ALL: [Self; 29] = [
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
            Self::Begin => ("begin", &[Key::Enter]),
            Self::Keep => ("end and keep", &[Key::N]),
            Self::Redo => ("throw away and redo", &[Key::R]),
            Self::Pause => ("pause", &[Key::P]),
            Self::Step => ("one step, paused", &[Key::Period]),
            Self::Unsafe => ("unsafe now", &[Key::U]),
            Self::HandOver => ("hand over", &[Key::M]),
            Self::Beside => ("dream beside the real world", &[Key::B]),
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

    /// Whether it is done while a world is acted in; the same key may do something else with answers.
    fn is_driving(self) -> bool {
        self < Self::OnlyLeft
    }
}

/// A key that can be changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Slot {
    /// One of the keys of an action: the action, and which of them.
    Of(KeyAction, usize),
    /// The key that moves what worlds move by this one of [`KEYS`].
    Move(&'static str),
}

impl Slot {
    fn is_driving(self) -> bool {
        match self {
            Self::Of(key_action, _) => key_action.is_driving(),
            Self::Move(_) => true,
        }
    }
}

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

/// The keys that somebody has for some of [`KEYS`].
pub(crate) type MovedKeys = BTreeMap<&'static str, Key>;

/// Which keys do what, in one world.
#[derive(Clone, Debug, PartialEq)]
pub struct Keys {
    own: BTreeMap<KeyAction, Vec<Key>>,
    moved: MovedKeys,
    /// Those of [`KEYS`] that move something in this world, and what that is called.
    world: Vec<(&'static str, String)>,
}

impl Default for Keys {
    /// The first keys, in the first of the built-in worlds.
    fn default() -> Self {
        Self::of_world(&WorldSpec::default())
    }
}

impl Serialize for Keys {
    /// Those of actions alone.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.own.serialize(serializer)
    }
}

impl From<Keys> for BTreeMap<KeyAction, Vec<Key>> {
    fn from(keys: Keys) -> Self {
        keys.own
    }
}

/// The one of [`KEYS`] of this name.
pub(crate) fn known_key(name: &str) -> Option<&'static str> {
    KEYS.into_iter().find(|known| *known == name)
}

/// What one of [`KEYS`] is to the window.
fn first_key(name: &str) -> Key {
    Key::from_name(name).unwrap_or_else(|| unreachable!("{name} is a key"))
}

/// What a key does that moves an axis to `to`: `gas`, `steer −`.
fn move_name(axis: &Axis, to: f32) -> String {
    let has_other = axis.keys.iter().any(|input| (input.to < axis.neutral) != (to < axis.neutral));
    match (has_other, to < axis.neutral) {
        (false, _) => axis.name.clone(),
        (true, true) => format!("{} −", axis.name),
        (true, false) => format!("{} +", axis.name),
    }
}

impl Keys {
    /// The first keys in this world.
    pub(crate) fn of_world(spec: &WorldSpec) -> Self {
        let own = KeyAction::ALL.into_iter().map(|key_action| (key_action, key_action.says().1.to_vec()));
        let mut world: Vec<(&'static str, String)> = Vec::new();
        for (axis, input) in spec.axes.iter().flat_map(|axis| axis.keys.iter().map(move |it| (axis, it))) {
            let Some(key) = known_key(&input.key) else { continue };
            let what = move_name(axis, input.to);
            // A key may move several axes at once.
            match world.iter_mut().find(|(known, _)| *known == key) {
                Some((_, all)) => *all = format!("{all}, {what}"),
                None => world.push((key, what)),
            }
        }
        Self { own: own.collect(), moved: MovedKeys::new(), world }
    }

    /// The same keys in this world, with `moved` for those of its own.
    pub(crate) fn in_world(self, spec: &WorldSpec, moved: MovedKeys) -> Self {
        Self { own: self.own, moved, world: Self::of_world(spec).world }
    }

    /// What was changed of the keys that move something.
    pub(crate) fn moved(&self) -> &MovedKeys {
        &self.moved
    }

    /// The first keys but for those of `own`, as far as these can be had; of the others, why not.
    ///
    /// What a world moves by which keys is another matter: see [`Self::free`].
    pub(crate) fn with(own: BTreeMap<KeyAction, Vec<Key>>) -> (Self, Vec<(KeyAction, String)>) {
        let (mut keys, mut refused) = (Self::default(), Vec::new());
        let world = std::mem::take(&mut keys.world);
        for (key_action, wanted) in own {
            let n = key_action.says().1.len();
            if wanted.len() == n {
                keys.own.insert(key_action, wanted);
            } else {
                refused.push((key_action, format!("{} keys where it has {n}", wanted.len())));
            }
        }
        while let Some((key_action, what)) = keys.conflict() {
            refused.push((key_action, what));
            keys.own.insert(key_action, key_action.says().1.to_vec());
        }
        keys.world = world;
        (keys, refused)
    }

    /// An action with keys of its own, one of which it cannot have, and why: the last one, for the first may stay.
    fn conflict(&self) -> Option<(KeyAction, String)> {
        let is_own = |key_action: &KeyAction| self.all(*key_action) != key_action.says().1;
        let slots = |key_action: KeyAction| (0..self.all(key_action).len()).map(move |idx| (key_action, idx));
        KeyAction::ALL.into_iter().rev().filter(is_own).flat_map(slots).find_map(|(key_action, idx)| {
            let key = self.all(key_action)[idx];
            let whose = match self.taken(Slot::Of(key_action, idx), key)? {
                Taken::By(other) => self.name_of(other),
                Taken::Fixed(what) => what.to_owned(),
            };
            Some((key_action, format!("{} is the key of “{whose}”", key.name())))
        })
    }

    /// What the key in `slot` does, in words.
    pub(crate) fn name_of(&self, slot: Slot) -> String {
        match slot {
            Slot::Of(key_action, _) => key_action.name().to_owned(),
            Slot::Move(key) => self
                .world
                .iter()
                .find(|(known, _)| *known == key)
                .map_or_else(|| format!("what {key} moves"), |(_, what)| what.clone()),
        }
    }

    /// All keys of `key_action`.
    pub(crate) fn all(&self, key_action: KeyAction) -> &[Key] {
        self.own.get(&key_action).filter(|keys| !keys.is_empty()).map_or(key_action.says().1, Vec::as_slice)
    }

    /// The key that is shown on the button of `key_action`.
    pub fn of(&self, key_action: KeyAction) -> Key {
        self.all(key_action)[0]
    }

    /// The same while a world is acted in; none where the world moves something by that key.
    pub(crate) fn free(&self, key_action: KeyAction) -> Option<Key> {
        Some(self.of(key_action)).filter(|key| self.driving(*key).is_none())
    }

    /// The key that somebody has for one of [`KEYS`], as far as nothing else in this world is moved by it.
    pub(crate) fn of_move(&self, name: &str) -> Key {
        let first = first_key(name);
        let Some(&own) = self.moved.get(name) else { return first };
        let is_others = |(other, _): &(&'static str, String)| {
            *other != name && first_key(other) == own && !self.moved.contains_key(other)
        };
        if self.world.iter().any(is_others) { first } else { own }
    }

    /// What of this world `key` moves, by its name in the world's file.
    pub(crate) fn driving(&self, key: Key) -> Option<&'static str> {
        self.world.iter().map(|(name, _)| *name).find(|name| self.of_move(name) == key)
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
            key if digits.contains(&key) && !slot.is_driving() => {
                return Some(Taken::Fixed("reasons and justifications"));
            }
            _ => {}
        }
        if slot.is_driving()
            && let Some(name) = self.driving(key).filter(|name| slot != Slot::Move(name))
        {
            return Some(Taken::By(Slot::Move(name)));
        }
        let here =
            KeyAction::ALL.into_iter().filter(|key_action| key_action.is_driving() == slot.is_driving());
        let mut slots = here
            .flat_map(|key_action| (0..self.all(key_action).len()).map(move |idx| (key_action, idx)))
            .filter(|&(key_action, idx)| slot != Slot::Of(key_action, idx));
        slots
            .find(|&(key_action, idx)| self.all(key_action)[idx] == key)
            .map(|(key_action, idx)| Taken::By(Slot::Of(key_action, idx)))
    }

    /// Gives `key` to `slot`; whoever had it there gets the one that `slot` had.
    pub(crate) fn bind(&mut self, slot: Slot, key: Key) {
        let before = self.key_in(slot);
        if let Some(Taken::By(other)) = self.taken(slot, key) {
            self.put(other, before);
        }
        self.put(slot, key);
    }

    fn key_in(&self, slot: Slot) -> Key {
        match slot {
            Slot::Of(key_action, idx) => self.all(key_action)[idx],
            Slot::Move(name) => self.of_move(name),
        }
    }

    fn put(&mut self, slot: Slot, key: Key) {
        match slot {
            Slot::Of(key_action, idx) => {
                let mut keys = self.all(key_action).to_vec();
                keys[idx] = key;
                self.own.insert(key_action, keys);
            }
            Slot::Move(name) if first_key(name) == key => {
                self.moved.remove(name);
            }
            Slot::Move(name) => {
                self.moved.insert(name, key);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn no_two_deeds_of_a_place_have_a_key_at_first() {
        let keys = Keys::default();
        for key_action in KeyAction::ALL {
            for (idx, &key) in keys.all(key_action).iter().enumerate() {
                assert_eq!(keys.taken(Slot::Of(key_action, idx), key), None, "{key_action:?} {key:?}");
            }
        }
    }

    #[test]
    fn the_page_for_browsers_has_the_keys_of_the_window() {
        let page = include_str!("../../serve/page/page.js");
        let arrows = r#"const ARROWS = ["ArrowLeft", "ArrowUp", "ArrowRight"];"#;
        let preferences = [KeyAction::PreferLeft, KeyAction::Equal, KeyAction::PreferRight];
        let keys = Keys::default();
        assert_eq!(preferences.map(|it| keys.of(it)), [Key::ArrowLeft, Key::ArrowUp, Key::ArrowRight]);
        assert!(page.contains(arrows), "and so on the page");
        for (key_action, name) in [
            (KeyAction::OnlyLeft, "Only left is safe"),
            (KeyAction::OnlyRight, "Only right is safe"),
            (KeyAction::Neither, "Neither is safe"),
            (KeyAction::Yes, "Yes, it stays safe"),
            (KeyAction::No, "No, it becomes unsafe"),
            (KeyAction::Skip, "Skip"),
            (KeyAction::Undo, "Undo"),
            (KeyAction::Restore, "Redo"),
            (KeyAction::Flag, "Flag"),
            (KeyAction::Guide, "One question at a time"),
            (KeyAction::Restart, "Again"),
            (KeyAction::PauseClips, "Pause"),
            (KeyAction::Back, "A frame back"),
            (KeyAction::Forward, "A frame on"),
            (KeyAction::Slower, "Slower"),
            (KeyAction::Faster, "Faster"),
        ] {
            let key = match keys.of(key_action) {
                Key::Space => " ".to_owned(),
                Key::Backspace => "Backspace".to_owned(),
                key => key.symbol_or_name().to_lowercase(),
            };
            assert!(
                page.contains(&format!("[\"{name}\", \"{key}\", ")),
                "{name} has another key than {key:?}"
            );
        }
    }

    #[test]
    fn every_key_of_a_file_is_one_of_the_window() {
        let known: std::collections::BTreeSet<_> = KEYS.into_iter().map(first_key).collect();
        assert_eq!(known.len(), KEYS.len());
    }

    #[test]
    fn who_takes_a_key_gives_its_own() {
        let mut keys = Keys::default();
        let keep = Slot::Of(KeyAction::Keep, 0);
        assert_eq!(keys.taken(keep, Key::S), Some(Taken::By(Slot::Move("S"))));
        assert_eq!(keys.taken(keep, Key::F), None, "flagging is done elsewhere");
        assert_eq!(keys.taken(keep, Key::Slash), Some(Taken::Fixed("keys and help")));
        keys.bind(keep, Key::S);
        assert_eq!((keys.of(KeyAction::Keep), keys.of_move("S")), (Key::S, Key::N));
        assert_eq!((keys.driving(Key::N), keys.driving(Key::S)), (Some("S"), None));
        assert_eq!(keys.name_of(Slot::Move("S")), "brake");
    }

    /// A world with one axis that these keys move to its ends.
    fn world(low: &str, high: &str) -> WorldSpec {
        let text = format!(
            "format = 1\nname = \"arm\"\ntitle = \"An arm\"\nrate = 20\nlongest_episode = 400\n\
             source = {{ kind = \"recordings\" }}\nimage = {{ height = 60, width = 80 }}\n\
             [[axes]]\nname = \"reach\"\nlow = -1\nhigh = 1\nneutral = 0\n\
             keys = [{{ key = \"{low}\", to = -1 }}, {{ key = \"{high}\", to = 1 }}]\n"
        );
        WorldSpec::from_toml(&text, Path::new("arm.toml")).unwrap()
    }

    #[test]
    fn where_a_world_moves_something_by_the_key_of_a_command_the_command_has_none() {
        let mut keys = Keys::of_world(&world("N", "R"));
        assert_eq!((keys.driving(Key::N), keys.driving(Key::A)), (Some("N"), None));
        assert_eq!((keys.free(KeyAction::Keep), keys.free(KeyAction::Pause)), (None, Some(Key::P)));
        assert_eq!(keys.name_of(Slot::Move("R")), "reach +");
        keys.bind(Slot::Of(KeyAction::Keep, 0), Key::K);
        assert_eq!((keys.free(KeyAction::Keep), keys.driving(Key::N)), (Some(Key::K), Some("N")));
    }

    #[test]
    fn a_key_that_was_changed_in_one_world_is_changed_in_others_but_takes_none_of_theirs() {
        let mut keys = Keys::default();
        keys.bind(Slot::Move("A"), Key::J);
        let moved = keys.moved().clone();
        let there = Keys::default().in_world(&world("A", "L"), moved.clone());
        assert_eq!((there.driving(Key::J), there.driving(Key::A)), (Some("A"), None));
        let there = Keys::default().in_world(&world("A", "J"), moved);
        assert_eq!((there.driving(Key::J), there.driving(Key::A)), (Some("J"), Some("A")));
    }
}
