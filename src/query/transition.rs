//! Single transitions of dreams, and what can be said of one: the labels of ReQueST and DROS (method §7.1).

use rand::{Rng, RngExt as _};
use serde::{Deserialize, Serialize};

use crate::query::{DreamId, QueryId, SEGMENT_LEN, SegmentRef};

/// How many states a trajectory has whose transitions are labeled one after the other (method §6).
pub const TRAJECTORY_LEN: usize = 50;
/// Where in its clip the outcome of a transition lies, if the dream is long enough on both sides.
const OUTCOME: usize = 14;

/// An action in a state of a dream, and the state that comes of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Transition {
    /// Which dream.
    pub dream: DreamId,
    /// Where the trajectory begins that it is labeled with.
    pub first: usize,
    /// The state that it leads from. It leads to the next one.
    pub step: usize,
}

impl Transition {
    /// The clip that shows it, with what comes before and after, in a dream of `len` steps.
    pub fn clip(self, len: usize) -> SegmentRef {
        let latest = len.saturating_sub(SEGMENT_LEN);
        SegmentRef { dream: self.dream, start: (self.step + 1).saturating_sub(OUTCOME).min(latest) }
    }

    /// The picture of its outcome in a clip that begins at `start`.
    pub fn outcome_in(self, start: usize) -> usize {
        self.step + 1 - start
    }

    /// The one after it in its trajectory, in a dream of `len` steps.
    pub fn next(self, len: usize) -> Option<Self> {
        let next = Self { step: self.step + 1, ..self };
        (next.step + 1 < len.min(self.first + TRAJECTORY_LEN)).then_some(next)
    }

    /// Its place in its trajectory, from 0.
    pub fn place(self) -> usize {
        self.step - self.first
    }
}

/// What a person says of a transition.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// It leads off the road: −1.
    Unsafe,
    /// It stays where the car has been: 0.
    Neutral,
    /// It leads on, to a new piece of road: +10.
    Good,
}

impl Verdict {
    /// All of them, in the order of the classes that are learned.
    pub const ALL: [Self; 3] = [Self::Unsafe, Self::Neutral, Self::Good];

    /// What the environment would pay for it.
    pub fn worth(self) -> f32 {
        match self {
            Self::Unsafe => -1.0,
            Self::Neutral => 0.0,
            Self::Good => 10.0,
        }
    }

    /// Its class.
    pub fn class(self) -> usize {
        self as usize
    }
}

/// A transition and what was said of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct JudgedTransition {
    /// The query that asked about it.
    pub query: QueryId,
    /// Which one.
    pub transition: Transition,
    /// What was said.
    pub verdict: Verdict,
}

/// The first transition of a trajectory that is drawn by chance: the dream, then the start (method §6).
///
/// Dreams shorter than a segment are left out; of one shorter than a trajectory, all is taken.
pub fn sample_trajectory(dreams: &[(DreamId, usize)], rng: &mut impl Rng) -> Option<Transition> {
    let long: Vec<_> = dreams.iter().filter(|(_, len)| *len >= SEGMENT_LEN).collect();
    let &&(dream, len) = long.get(rng.random_range(0..long.len().max(1)))?;
    // DIFFERENCE: the authors never draw the last valid start. We do, as for segments.
    let first = rng.random_range(0..=len.saturating_sub(TRAJECTORY_LEN));
    Some(Transition { dream, first, step: first })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    proptest! {
        #[test]
        fn a_trajectory_is_gone_through_inside_its_dream(len in SEGMENT_LEN..200, seed: u64) {
            let rng = &mut ChaCha8Rng::seed_from_u64(seed);
            let first = sample_trajectory(&[(DreamId(3), len)], rng).unwrap();
            let all: Vec<_> = std::iter::successors(Some(first), |one| one.next(len)).collect();
            prop_assert_eq!(all.len(), len.min(TRAJECTORY_LEN) - 1);
            for one in all {
                let clip = one.clip(len);
                prop_assert!(one.step + 1 < len && clip.start + SEGMENT_LEN <= len);
                prop_assert!(one.outcome_in(clip.start) < SEGMENT_LEN && one.outcome_in(clip.start) > 0);
            }
        }
    }

    #[test]
    fn where_no_dream_is_long_enough_nothing_is_drawn() {
        assert_eq!(sample_trajectory(&[(DreamId(0), 19)], &mut ChaCha8Rng::seed_from_u64(0)), None);
    }

    #[test]
    fn classes_are_in_the_order_of_their_worth() {
        let worths = Verdict::ALL.map(Verdict::worth);
        assert_eq!((worths, Verdict::ALL.map(Verdict::class)), ([-1.0, 0.0, 10.0], [0, 1, 2]));
    }
}
