//! Short stretches of dreams, and drawing pairs of them.

use rand::{Rng, RngExt as _};
use serde::{Deserialize, Serialize};

/// How many steps a segment has: k of the paper (method §6).
///
/// `// DIFFERENCE:` the paper writes `t … t + k`, which is k + 1 items. The authors' code has 20 rows, and so have we.
pub const SEGMENT_LEN: usize = 20;

/// A dream episode of a session, numbered in the order of keeping.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub struct DreamId(pub u32);

/// A query of a session, numbered in the order of asking.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub struct QueryId(pub u32);

/// [`SEGMENT_LEN`] consecutive steps of a dream: a view, never a copy.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SegmentRef {
    /// Which dream.
    pub dream: DreamId,
    /// Its first step.
    pub start: usize,
}

/// Two segments to compare.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Query {
    /// Its number.
    pub id: QueryId,
    /// Shown on the left: σ⁰, the first.
    pub left: SegmentRef,
    /// Shown on the right: σ¹, the second.
    pub right: SegmentRef,
}

/// Draws `n` queries over dreams of the given lengths, numbered from `first`.
///
/// All left dreams are drawn first, then all right ones, then the starts in the same order (method §6).
/// Each is uniform and with replacement.
/// Dreams shorter than a segment are left out. Where none is long enough there are no queries.
pub fn sample_queries(
    dreams: &[(DreamId, usize)],
    n: usize,
    first: QueryId,
    rng: &mut impl Rng,
) -> Vec<Query> {
    let long: Vec<_> = dreams.iter().filter(|(_, len)| *len >= SEGMENT_LEN).collect();
    if long.is_empty() {
        return Vec::new();
    }
    let lefts: Vec<_> = (0..n).map(|_| long[rng.random_range(0..long.len())]).collect();
    let rights: Vec<_> = (0..n).map(|_| long[rng.random_range(0..long.len())]).collect();
    // DIFFERENCE: the authors never draw the last valid start. We do (method §14.32).
    let mut segment = |&&(dream, len): &&(DreamId, usize)| SegmentRef {
        dream,
        start: rng.random_range(0..=len - SEGMENT_LEN),
    };
    let lefts: Vec<_> = lefts.iter().map(&mut segment).collect();
    let rights: Vec<_> = rights.iter().map(&mut segment).collect();
    let pairs = lefts.into_iter().zip(rights).enumerate();
    pairs.map(|(i, (left, right))| Query { id: QueryId(first.0 + i as u32), left, right }).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    proptest! {
        #[test]
        fn segments_stay_inside_their_dream(lens in prop::collection::vec(0usize..60, 1..5), seed: u64) {
            let dreams: Vec<_> = lens.iter().enumerate().map(|(i, len)| (DreamId(i as u32), *len)).collect();
            let queries = sample_queries(&dreams, 20, QueryId(0), &mut ChaCha8Rng::seed_from_u64(seed));
            for segment in queries.iter().flat_map(|q| [q.left, q.right]) {
                prop_assert!(segment.start + SEGMENT_LEN <= lens[segment.dream.0 as usize]);
            }
        }
    }

    #[test]
    fn the_last_start_is_drawn_too() {
        let dreams = [(DreamId(0), SEGMENT_LEN + 1)];
        let queries = sample_queries(&dreams, 50, QueryId(0), &mut ChaCha8Rng::seed_from_u64(0));
        assert!(queries.iter().any(|q| q.left.start == 1), "start 1 is valid and was never drawn");
        assert_eq!(queries[7].id, QueryId(7));
    }
}
