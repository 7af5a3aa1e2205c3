//! Which clips are likely to stay safe, by what was said of others near them: so that few queries show two that do not.

use std::collections::BTreeMap;

use rand::{Rng, RngExt as _};

use crate::query::strategy::sample_pair;
use crate::query::{DreamId, Response, SEGMENT_LEN, SegmentRef};

/// What was said of a clip goes for those that begin at most so many steps before or after it.
const REACH: usize = 2 * SEGMENT_LEN;
/// So often another pair is drawn where one is not wanted.
const N_TRIES: usize = 50;

/// Which clips were said to stay safe.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct KnownSafety {
    /// By where they begin.
    clips: BTreeMap<DreamId, BTreeMap<usize, bool>>,
}

impl KnownSafety {
    /// Records what was answered about a pair. Some answers say nothing of safety.
    pub fn record(&mut self, pair: [SegmentRef; 2], response: Response) {
        for (segment, is_safe) in pair.into_iter().zip(response.safety().into_iter().flatten()) {
            self.clips.entry(segment.dream).or_default().insert(segment.start, is_safe);
        }
    }

    /// Whether a clip is likely to stay safe: what was said of the nearest that is near.
    pub fn guess(&self, segment: SegmentRef) -> Option<bool> {
        let clips = self.clips.get(&segment.dream)?;
        let near = clips.range(segment.start.saturating_sub(REACH)..=segment.start + REACH);
        near.min_by_key(|(start, _)| start.abs_diff(segment.start)).map(|(_, is_safe)| *is_safe)
    }

    /// How likely a pair is kept that was drawn by chance.
    ///
    /// From two unsafe clips nothing is learned but that they are alike, and of safety more is soon known than of taste.
    fn share_kept(&self, pair: [SegmentRef; 2]) -> f64 {
        // Where nothing is known of a clip, it may be either.
        let chance = |segment| self.guess(segment).map_or(0.5, |is_safe| if is_safe { 1.0 } else { 0.0 });
        let [left, right] = pair.map(chance);
        0.5 * (left + right)
    }
}

/// A pair by chance, but of those that are likely unsafe on both sides none, and of those that are so on one only half.
///
/// What is likely follows from what is `known`, and what is not known may be either. Nothing comes where no dream is long
/// enough.
// DIFFERENCE: in the paper every pair is as likely as any other (method §6). Ours does so too unless this is asked for.
pub fn sample_balanced(
    dreams: &[(DreamId, usize)],
    known: &KnownSafety,
    rng: &mut impl Rng,
) -> Option<[SegmentRef; 2]> {
    let mut pair = sample_pair(dreams, rng)?;
    for _ in 1..N_TRIES {
        if rng.random_bool(known.share_kept(pair)) {
            break;
        }
        pair = sample_pair(dreams, rng)?;
    }
    Some(pair)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::query::{Preference, SafetyAnswer};

    fn at(start: usize) -> SegmentRef {
        SegmentRef { dream: DreamId(0), start }
    }

    #[test]
    fn a_clip_is_likely_what_the_nearest_was_said_to_be() {
        let mut known = KnownSafety::default();
        known.record([at(100), at(160)], Response::Safety(SafetyAnswer::OnlyLeft));
        known.record([at(500), at(600)], Response::Skipped(None));
        assert_eq!([129, 131, 59].map(|start| known.guess(at(start))), [Some(true), Some(false), None]);
        assert_eq!([500, 600].map(|start| known.guess(at(start))), [None, None], "nothing was said");
        assert_eq!(known.guess(SegmentRef { dream: DreamId(1), start: 100 }), None, "nor of other dreams");
    }

    #[test]
    fn few_pairs_are_unsafe_on_both_sides_and_more_are_safe() {
        // Of this dream it is known that its first half is unsafe.
        let mut known = KnownSafety::default();
        for start in (0..981).step_by(20) {
            let answer =
                if start < 500 { SafetyAnswer::Neither } else { SafetyAnswer::Both(Preference::Equal) };
            known.record([at(start), at(start)], Response::Safety(answer));
        }
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let mut counts = [0; 3];
        for _ in 0..1000 {
            let pair = sample_balanced(&[(DreamId(0), 1000)], &known, rng).unwrap();
            counts[pair.iter().filter(|segment| known.guess(**segment) == Some(true)).count()] += 1;
        }
        // By chance they would be 250, 500 and 250; none of the first and half of the second leave as many as of the last.
        assert_eq!(counts[0], 0);
        assert!((430..570).contains(&counts[1]), "{counts:?}");
    }

    #[test]
    fn where_all_is_known_to_be_unsafe_something_is_asked_all_the_same() {
        let mut known = KnownSafety::default();
        known.record([at(0), at(10)], Response::Safety(SafetyAnswer::Neither));
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        assert!(sample_balanced(&[(DreamId(0), 30)], &known, rng).is_some());
        assert_eq!(sample_balanced(&[(DreamId(0), 10)], &known, rng), None, "none is long enough");
    }
}
