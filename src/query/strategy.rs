//! What to ask about next: by chance, where the members of the reward disagree, or near what a driver called unsafe.

use rand::{Rng, RngExt as _};
use serde::{Deserialize, Serialize};

use crate::query::{DreamId, QueryId, SEGMENT_LEN, SegmentRef, sample_queries};

/// Of so many pairs drawn by chance, the one that is disagreed about most is asked.
///
/// [PEBBLE](crate#references) draws ten times as many pairs as it asks about.
pub const N_CANDIDATES: usize = 10;

/// How a pair of segments is chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Strategy {
    /// By chance, every pair being as likely as any other: the paper's way.
    #[default]
    Uniform,
    /// By chance, but seldom two that are likely unsafe: [`sample_balanced`](crate::query::sample_balanced).
    Balanced,
    /// About the justification that was named least so far: [`sample_least_answered`](crate::query::sample_least_answered).
    LeastAnswered,
    /// Of [`N_CANDIDATES`] pairs the one that the members of the ensemble disagree about most.
    Disagreement,
    /// One segment near a step that a driver marked as unsafe, the other by chance.
    SafetyBoundary,
}

/// How many queries of a hundred are chosen otherwise than by chance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Mix {
    /// By disagreement.
    pub disagreement: u8,
    /// Near marks.
    pub boundary: u8,
    /// About what was answered least.
    pub least_answered: u8,
    /// Whether what is left to chance is [balanced](Strategy::Balanced).
    pub is_balanced: bool,
}

impl Mix {
    /// The same mix with no more than a hundred of a hundred: marks give way first.
    #[must_use]
    pub fn clamped(self) -> Self {
        let disagreement = self.disagreement.min(100);
        let least_answered = self.least_answered.min(100 - disagreement);
        Self {
            disagreement,
            least_answered,
            boundary: self.boundary.min(100 - disagreement - least_answered),
            ..self
        }
    }

    /// How many of a hundred are drawn by chance.
    pub fn uniform(self) -> u8 {
        let Self { disagreement, boundary, least_answered, .. } = self.clamped();
        100 - disagreement - boundary - least_answered
    }

    /// The strategy of one query.
    pub fn draw(self, rng: &mut impl Rng) -> Strategy {
        let Self { disagreement, boundary, least_answered, is_balanced } = self.clamped();
        match rng.random_range(0..100u8) {
            n if n < disagreement => Strategy::Disagreement,
            n if n < disagreement + boundary => Strategy::SafetyBoundary,
            n if n < disagreement + boundary + least_answered => Strategy::LeastAnswered,
            _ if is_balanced => Strategy::Balanced,
            _ => Strategy::Uniform,
        }
    }
}

/// A pair by chance, or nothing where no dream is long enough.
pub fn sample_pair(dreams: &[(DreamId, usize)], rng: &mut impl Rng) -> Option<[SegmentRef; 2]> {
    sample_queries(dreams, 1, QueryId(0), rng).first().map(|query| [query.left, query.right])
}

/// A pair of which one segment, on either side, lies near one of `marks`. Nothing where no mark can be shown.
///
/// It begins at the earliest two lengths before the mark, and at the latest on it: who marks a step has seen it coming,
/// or presses a moment late.
pub fn sample_near_mark(
    dreams: &[(DreamId, usize)],
    marks: &[(DreamId, usize)],
    rng: &mut impl Rng,
) -> Option<[SegmentRef; 2]> {
    let range = |&(dream, mark): &(DreamId, usize)| {
        let (_, len) = dreams.iter().find(|(id, _)| *id == dream)?;
        let last = mark.min(len.checked_sub(SEGMENT_LEN)?);
        let first = mark.saturating_sub(2 * SEGMENT_LEN).min(last);
        Some((dream, first..=last))
    };
    let ranges: Vec<_> = marks.iter().filter_map(range).collect();
    if ranges.is_empty() {
        return None;
    }
    let (dream, starts) = ranges[rng.random_range(0..ranges.len())].clone();
    let near = SegmentRef { dream, start: rng.random_range(starts) };
    let [other, _] = sample_pair(dreams, rng)?;
    Some(if rng.random() { [near, other] } else { [other, near] })
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn one_segment_lies_near_a_mark_and_stands_on_either_side() {
        let dreams = [(DreamId(0), 400), (DreamId(1), 100)];
        let marks = [(DreamId(1), 95), (DreamId(1), 5), (DreamId(7), 3)];
        let is_near = |segment: &SegmentRef| {
            segment.dream == DreamId(1) && ((55..=80).contains(&segment.start) || segment.start <= 5)
        };
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let pairs: Vec<_> = (0..200).map(|_| sample_near_mark(&dreams, &marks, rng).unwrap()).collect();
        assert!(pairs.iter().all(|pair| pair.iter().any(is_near)), "{pairs:?}");
        assert!(pairs.iter().any(|[_, right]| !is_near(right)), "the near one is not always on the right");
        assert!(pairs.iter().any(|[left, _]| !is_near(left)), "nor always on the left");
    }

    #[test]
    fn where_nothing_is_marked_nothing_is_near() {
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        assert_eq!(sample_near_mark(&[(DreamId(0), 40)], &[], rng), None);
        assert_eq!(sample_near_mark(&[(DreamId(0), 10)], &[(DreamId(0), 4)], rng), None);
    }

    #[test]
    fn strategies_are_drawn_in_their_shares() {
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let mix = Mix { disagreement: 30, boundary: 100, ..Mix::default() }.clamped();
        assert_eq!((mix.boundary, mix.uniform()), (70, 0));
        let mix = Mix { disagreement: 30, boundary: 20, least_answered: 10, is_balanced: false };
        let drawn: Vec<_> = (0..2000).map(|_| mix.draw(rng)).collect();
        for (strategy, share) in [
            (Strategy::Uniform, 800),
            (Strategy::Disagreement, 600),
            (Strategy::SafetyBoundary, 400),
            (Strategy::LeastAnswered, 200),
        ] {
            let n = drawn.iter().filter(|drawn| **drawn == strategy).count();
            assert!(n.abs_diff(share) < 100, "{n} of {strategy:?} where {share} were due");
        }
        let balanced = Mix { is_balanced: true, ..mix };
        let with_chance =
            |strategy| if strategy == Strategy::Uniform { Strategy::Balanced } else { strategy };
        let [rng, other] = &mut [ChaCha8Rng::seed_from_u64(1), ChaCha8Rng::seed_from_u64(1)];
        assert!(
            (0..100).all(|_| balanced.draw(rng) == with_chance(mix.draw(other))),
            "chance alone is balanced"
        );
        assert!(
            (0..100).all(|_| Mix::default().draw(rng) == Strategy::Uniform),
            "the paper's way is the default"
        );
    }
}
