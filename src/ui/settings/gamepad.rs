//! What the buttons of a gamepad do, and which: every one can be changed.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::ui::input::PadButton;
use crate::ui::settings::keymap::KeyAction;

/// Where a button does something; elsewhere the same button may do something else.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Place {
    /// Nothing is driven yet.
    Waiting,
    /// Acting in a dream or the real world.
    Driving,
    /// Answering.
    Labeling,
    /// Answering one question at a time.
    Guided,
}

/// What can be done with a pad, where, and by which button at first.
const ACTIONS: [(KeyAction, Place, PadButton); 17] = [
    (KeyAction::Begin, Place::Waiting, PadButton::Start),
    (KeyAction::Keep, Place::Driving, PadButton::North),
    (KeyAction::Redo, Place::Driving, PadButton::West),
    (KeyAction::Unsafe, Place::Driving, PadButton::South),
    (KeyAction::Pause, Place::Driving, PadButton::Start),
    (KeyAction::HandOver, Place::Driving, PadButton::Back),
    (KeyAction::Leave, Place::Driving, PadButton::East),
    (KeyAction::OnlyLeft, Place::Labeling, PadButton::LeftShoulder),
    (KeyAction::OnlyRight, Place::Labeling, PadButton::RightShoulder),
    (KeyAction::Neither, Place::Labeling, PadButton::Down),
    (KeyAction::PreferLeft, Place::Labeling, PadButton::Left),
    (KeyAction::Equal, Place::Labeling, PadButton::Up),
    (KeyAction::PreferRight, Place::Labeling, PadButton::Right),
    (KeyAction::Skip, Place::Labeling, PadButton::East),
    (KeyAction::Undo, Place::Labeling, PadButton::Back),
    (KeyAction::Yes, Place::Guided, PadButton::South),
    (KeyAction::No, Place::Guided, PadButton::West),
];

/// Which buttons do what; what was not changed is as at first.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub(crate) struct Buttons(BTreeMap<KeyAction, PadButton>);

impl Buttons {
    /// The first buttons but for those of `own`, as far as these can be had; of the others, why not.
    pub(crate) fn with(own: BTreeMap<KeyAction, PadButton>) -> (Self, Vec<(KeyAction, String)>) {
        let (mut buttons, mut refused) = (Self::default(), Vec::new());
        for (key_action, button) in own {
            if ACTIONS.into_iter().any(|(known, ..)| known == key_action) {
                buttons.0.insert(key_action, button);
            } else {
                refused.push((key_action, "a pad does nothing of that kind".to_owned()));
            }
        }
        while let Some((key_action, other)) = buttons.conflict() {
            refused.push((key_action, format!("it has the button of “{}”", other.name())));
            buttons.0.remove(&key_action);
        }
        (buttons, refused)
    }

    /// An action with a button of its own that another action has there, and that other: the last one, for the first may stay.
    fn conflict(&self) -> Option<(KeyAction, KeyAction)> {
        let own: Vec<_> = self.all().filter(|(key_action, ..)| self.0.contains_key(key_action)).collect();
        own.into_iter().rev().find_map(|(key_action, place, button)| {
            let mut others = self.all().filter(|(other, ..)| *other != key_action);
            let other = others.find(|(_, of, theirs)| (*of, *theirs) == (place, button))?;
            Some((key_action, other.0))
        })
    }

    /// What can be done, in the order of the work, each with its place and its button.
    pub(crate) fn all(&self) -> impl Iterator<Item = (KeyAction, Place, PadButton)> + '_ {
        let own = |key_action, first| self.0.get(&key_action).copied().unwrap_or(first);
        ACTIONS.into_iter().map(move |(key_action, place, first)| (key_action, place, own(key_action, first)))
    }

    /// The button that at first did in `place` what `button` does there now; nothing where that is nothing.
    pub(crate) fn meant(&self, place: Place, button: PadButton) -> Option<PadButton> {
        let mut here = self.all().zip(ACTIONS).filter(|((_, of, _), _)| *of == place);
        if let Some((_, (.., first))) = here.find(|((.., own), _)| *own == button) {
            return Some(first);
        }
        // Buttons that nobody asked about keep what else they do, unless theirs was given away.
        let is_known = ACTIONS.into_iter().any(|(_, of, first)| of == place && first == button);
        (!is_known).then_some(button)
    }

    /// Gives `button` to `key_action`; whoever had it in the same place gets the one that `key_action` had.
    pub(crate) fn bind(&mut self, key_action: KeyAction, button: PadButton) {
        let Some((_, place, before)) = self.all().find(|(other, ..)| *other == key_action) else { return };
        let taken = self.all().find(|&(other, of, own)| other != key_action && of == place && own == button);
        if let Some((other, ..)) = taken {
            self.0.insert(other, before);
        }
        self.0.insert(key_action, button);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_deeds_of_a_place_have_a_button_at_first() {
        for (i, (_, place, button)) in ACTIONS.into_iter().enumerate() {
            let twice = ACTIONS[..i].iter().any(|(_, of, first)| (*of, *first) == (place, button));
            assert!(!twice, "{place:?} {button:?}");
            assert_eq!(Buttons::default().meant(place, button), Some(button));
        }
    }

    #[test]
    fn a_button_that_is_taken_is_swapped_and_other_places_stay_as_they_were() {
        let mut pads = Buttons::default();
        pads.bind(KeyAction::Keep, PadButton::East);
        assert_eq!(pads.meant(Place::Driving, PadButton::East), Some(PadButton::North));
        assert_eq!(pads.meant(Place::Driving, PadButton::North), Some(PadButton::East), "it leaves now");
        assert_eq!(pads.meant(Place::Labeling, PadButton::East), Some(PadButton::East));
        pads.bind(KeyAction::Keep, PadButton::RightShoulder);
        assert_eq!(pads.meant(Place::Driving, PadButton::RightShoulder), Some(PadButton::North));
        assert_eq!(pads.meant(Place::Driving, PadButton::East), None, "nobody has it now");
    }
}
