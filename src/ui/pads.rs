//! What the buttons of a gamepad do, and which: every one can be changed.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::ui::input::PadButton;
use crate::ui::keys::Deed;

/// Where a button does something; elsewhere the same button may do something else.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Place {
    /// Nothing is driven yet.
    Waiting,
    /// Driving a dream or the real car.
    Driving,
    /// Answering.
    Labeling,
    /// Answering one question at a time.
    Guided,
}

/// What can be done with a pad, where, and by which button at first.
const DEEDS: [(Deed, Place, PadButton); 17] = [
    (Deed::Begin, Place::Waiting, PadButton::Start),
    (Deed::Keep, Place::Driving, PadButton::North),
    (Deed::Redo, Place::Driving, PadButton::West),
    (Deed::Unsafe, Place::Driving, PadButton::South),
    (Deed::Pause, Place::Driving, PadButton::Start),
    (Deed::HandOver, Place::Driving, PadButton::Back),
    (Deed::Leave, Place::Driving, PadButton::East),
    (Deed::OnlyLeft, Place::Labeling, PadButton::LeftShoulder),
    (Deed::OnlyRight, Place::Labeling, PadButton::RightShoulder),
    (Deed::Neither, Place::Labeling, PadButton::Down),
    (Deed::PreferLeft, Place::Labeling, PadButton::Left),
    (Deed::Equal, Place::Labeling, PadButton::Up),
    (Deed::PreferRight, Place::Labeling, PadButton::Right),
    (Deed::Skip, Place::Labeling, PadButton::East),
    (Deed::Undo, Place::Labeling, PadButton::Back),
    (Deed::Yes, Place::Guided, PadButton::South),
    (Deed::No, Place::Guided, PadButton::West),
];

/// Which buttons do what; what was not changed is as at first.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub(crate) struct Pads(BTreeMap<Deed, PadButton>);

impl Pads {
    /// The first buttons but for those of `own`, as far as these can be had; of the others, why not.
    pub(crate) fn with(own: BTreeMap<Deed, PadButton>) -> (Self, Vec<(Deed, String)>) {
        let (mut pads, mut refused) = (Self::default(), Vec::new());
        for (deed, button) in own {
            if DEEDS.into_iter().any(|(known, ..)| known == deed) {
                pads.0.insert(deed, button);
            } else {
                refused.push((deed, "a pad does nothing of that kind".to_owned()));
            }
        }
        while let Some((deed, other)) = pads.conflict() {
            refused.push((deed, format!("it has the button of “{}”", other.name())));
            pads.0.remove(&deed);
        }
        (pads, refused)
    }

    /// A deed with a button of its own that another deed has there, and that other: the last one, for the first may stay.
    fn conflict(&self) -> Option<(Deed, Deed)> {
        let own: Vec<_> = self.all().filter(|(deed, ..)| self.0.contains_key(deed)).collect();
        own.into_iter().rev().find_map(|(deed, place, button)| {
            let mut others = self.all().filter(|(other, ..)| *other != deed);
            let other = others.find(|(_, of, theirs)| (*of, *theirs) == (place, button))?;
            Some((deed, other.0))
        })
    }

    /// What can be done, in the order of the work, each with its place and its button.
    pub(crate) fn all(&self) -> impl Iterator<Item = (Deed, Place, PadButton)> + '_ {
        let own = |deed, first| self.0.get(&deed).copied().unwrap_or(first);
        DEEDS.into_iter().map(move |(deed, place, first)| (deed, place, own(deed, first)))
    }

    /// The button that at first did in `place` what `button` does there now; nothing where that is nothing.
    pub(crate) fn meant(&self, place: Place, button: PadButton) -> Option<PadButton> {
        let mut here = self.all().zip(DEEDS).filter(|((_, of, _), _)| *of == place);
        if let Some((_, (.., first))) = here.find(|((.., own), _)| *own == button) {
            return Some(first);
        }
        // Buttons that nobody asked about keep what else they do, unless theirs was given away.
        let is_known = DEEDS.into_iter().any(|(_, of, first)| of == place && first == button);
        (!is_known).then_some(button)
    }

    /// Gives `button` to `deed`; whoever had it in the same place gets the one that `deed` had.
    pub(crate) fn bind(&mut self, deed: Deed, button: PadButton) {
        let Some((_, place, before)) = self.all().find(|(other, ..)| *other == deed) else { return };
        let taken = self.all().find(|&(other, of, own)| other != deed && of == place && own == button);
        if let Some((other, ..)) = taken {
            self.0.insert(other, before);
        }
        self.0.insert(deed, button);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_deeds_of_a_place_have_a_button_at_first() {
        for (i, (_, place, button)) in DEEDS.into_iter().enumerate() {
            let twice = DEEDS[..i].iter().any(|(_, of, first)| (*of, *first) == (place, button));
            assert!(!twice, "{place:?} {button:?}");
            assert_eq!(Pads::default().meant(place, button), Some(button));
        }
    }

    #[test]
    fn a_button_that_is_taken_is_swapped_and_other_places_stay_as_they_were() {
        let mut pads = Pads::default();
        pads.bind(Deed::Keep, PadButton::East);
        assert_eq!(pads.meant(Place::Driving, PadButton::East), Some(PadButton::North));
        assert_eq!(pads.meant(Place::Driving, PadButton::North), Some(PadButton::East), "it leaves now");
        assert_eq!(pads.meant(Place::Labeling, PadButton::East), Some(PadButton::East));
        pads.bind(Deed::Keep, PadButton::RightShoulder);
        assert_eq!(pads.meant(Place::Driving, PadButton::RightShoulder), Some(PadButton::North));
        assert_eq!(pads.meant(Place::Driving, PadButton::East), None, "nobody has it now");
    }
}
