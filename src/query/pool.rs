//! Where a strategy becomes a pair, for people in the window and for stand-ins alike.

use rand::Rng;

use crate::query::known::{KnownClips, sample_balanced, sample_least_answered};
use crate::query::segment::{DreamId, SegmentRef};
use crate::query::strategy::{Strategy, sample_near_mark, sample_pair};

/// The dreams that can be asked about, and what is known of them.
#[derive(Clone, Copy, Debug)]
pub struct Pool<'a> {
    /// The dreams, each with its length in steps.
    pub dreams: &'a [(DreamId, usize)],
    /// What was answered so far about which moments.
    pub known: &'a KnownClips,
    /// The steps that were marked as unsafe while driving.
    pub marks: &'a [(DreamId, usize)],
}

impl Pool<'_> {
    /// A pair by this strategy; nothing where none can be found.
    ///
    /// For [`Strategy::Disagreement`] it is one of the [`N_CANDIDATES`](crate::query::strategy::N_CANDIDATES) that are
    /// drawn by chance, of which [`most_disagreed`] names the one to ask.
    pub fn draw(&self, strategy: Strategy, rng: &mut impl Rng) -> Option<[SegmentRef; 2]> {
        match strategy {
            Strategy::Uniform | Strategy::Disagreement => sample_pair(self.dreams, rng),
            Strategy::Balanced => sample_balanced(self.dreams, self.known, rng),
            Strategy::LeastAnswered => sample_least_answered(self.dreams, self.known, rng),
            Strategy::SafetyBoundary => sample_near_mark(self.dreams, self.marks, rng),
        }
    }
}

/// The pair that the members disagree about most: the last one of several equal ones.
pub fn most_disagreed(pairs: &[[SegmentRef; 2]], disagreements: &[f32]) -> Option<[SegmentRef; 2]> {
    let all = pairs.iter().zip(disagreements);
    all.max_by(|(_, one), (_, other)| one.total_cmp(other)).map(|(pair, _)| *pair)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn each_strategy_draws_from_what_it_goes_by() {
        let (dreams, marks) = ([(DreamId(0), 400), (DreamId(1), 100)], [(DreamId(1), 60)]);
        let known = KnownClips::new(&crate::query::Weights::paper().justifications);
        let pool = Pool { dreams: &dreams, known: &known, marks: &marks };
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        for _ in 0..50 {
            let near = pool.draw(Strategy::SafetyBoundary, rng).unwrap();
            assert!(near.iter().any(|segment| segment.dream == DreamId(1)), "{near:?}");
            assert!(pool.draw(Strategy::Uniform, rng).is_some());
        }
        let empty = Pool { dreams: &[], marks: &[], ..pool };
        for strategy in
            [Strategy::Uniform, Strategy::Balanced, Strategy::LeastAnswered, Strategy::SafetyBoundary]
        {
            assert_eq!(empty.draw(strategy, rng), None, "{strategy:?}");
        }
    }

    #[test]
    fn the_most_disagreed_pair_is_asked() {
        let at = |start| [SegmentRef { dream: DreamId(0), start }; 2];
        assert_eq!(most_disagreed(&[at(1), at(2), at(3)], &[0.1, 0.7, 0.2]), Some(at(2)));
        assert_eq!(most_disagreed(&[], &[]), None);
    }
}
