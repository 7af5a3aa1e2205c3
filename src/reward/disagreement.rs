//! Where the members of an ensemble disagree, so that most would be learned from an answer.

use tch::Tensor;

use crate::query::SEGMENT_LEN;
use crate::reward::RewardEnsemble;
use crate::tensor::{from_slice, to_vec};

impl RewardEnsemble {
    /// How much the members disagree about which segment of each pair is better, in `[0, ½]`.
    ///
    /// ```text
    /// sd_e σ(R̂_e(σ⁰) − R̂_e(σ¹))
    /// ```
    ///
    /// The measure of [PEBBLE](crate#references).
    ///
    /// # Shapes
    /// - `pairs`: the rows of both segments, `[k, F + A]` each, as [`segment_rows`](crate::reward::segment_rows) makes them
    pub fn disagreements(&self, pairs: &[[Vec<f32>; 2]]) -> Vec<f32> {
        if pairs.is_empty() {
            return Vec::new();
        }
        let shape = [SEGMENT_LEN as i64, self.row_len()];
        let rows: Vec<Tensor> = pairs.iter().flatten().map(|rows| from_slice(rows, &shape)).collect();
        let (e, b) = (self.config.members, pairs.len() as i64);
        tch::no_grad(|| {
            let rows = Tensor::stack(&rows, 0).to_kind(self.kind).view([1, b, 2, shape[0], shape[1]]);
            let returns = self.segment_returns(&rows.expand([e, -1, -1, -1, -1], false)); // [E, B, 2]
            let preferences = (returns.select(2, 0) - returns.select(2, 1)).sigmoid(); // [E, B]
            to_vec(&preferences.std_dim(0, false, false))
        })
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;
    use tch::Kind;

    use super::*;
    use crate::reward::RewardConfig;
    use crate::tensor::normal;

    const F: i64 = 6;

    fn segment(seed: u64) -> Vec<f32> {
        to_vec(&normal(&mut ChaCha8Rng::seed_from_u64(seed), &[SEGMENT_LEN as i64, F + 3]))
    }

    #[test]
    fn disagreement_is_the_deviation_of_the_members_preferences() {
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let ensemble = RewardEnsemble::new(F, "sha256:0", RewardConfig::tiny(), rng).in_kind(Kind::Float);
        let (left, right) = (segment(1), segment(2));
        let found = ensemble.disagreements(&[[left.clone(), right.clone()], [left.clone(), left.clone()]]);

        let returns = |rows: &[f32]| {
            let rows = from_slice(rows, &[SEGMENT_LEN as i64, F + 3]);
            let rewards = ensemble.member_rewards(&rows.narrow(1, 0, F), &rows.narrow(1, F, 3)); // [2, k]
            to_vec(&rewards.sum_dim_intlist(1, false, Kind::Float))
        };
        let (lefts, rights) = (returns(&left), returns(&right));
        let p = |e: usize| 1.0 / (1.0 + (rights[e] - lefts[e]).exp());
        // Of two numbers the deviation is half their distance.
        assert!((found[0] - (p(0) - p(1)).abs() / 2.0).abs() < 1e-5, "{found:?}");
        assert!(found[0] > 1e-3 && found[1] == 0.0, "about a segment and itself all say a half: {found:?}");
        assert!(ensemble.disagreements(&[]).is_empty());
    }
}
