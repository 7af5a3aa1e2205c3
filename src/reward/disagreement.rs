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
            let rows =
                self.here(&Tensor::stack(&rows, 0)).to_kind(self.kind).view([1, b, 2, shape[0], shape[1]]);
            let returns = self.segment_returns(&rows.expand([e, -1, -1, -1, -1], false)); // [E, B, 2]
            let preferences = (returns.select(2, 0) - returns.select(2, 1)).sigmoid(); // [E, B]
            to_vec(&preferences.std_dim(0, false, false))
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::reward::of_cosines;

    /// Rows of `scale · sin(phase + i)`.
    fn segment(scale: f32, phase: u8) -> Vec<f32> {
        (0..100).map(|i: u8| scale * f32::from(phase + i).sin()).collect()
    }

    // With `rewards` as above the test of members in `reward`:
    //
    //   segment = lambda scale, phase: scale * sin(phase + arange(100.)).reshape(20, 5)
    //   left, right = (rewards(segment(*which)).sum(1) for which in [(1, 0), (0.9, 1)])
    //   (1 / (1 + exp(right - left))).std()     # of 0.77441361 and 0.3445194
    #[test]
    fn disagreement_is_the_deviation_of_the_members_preferences() {
        let ensemble = of_cosines();
        let (left, right) = (segment(1.0, 0), segment(0.9, 1));
        let found = ensemble.disagreements(&[[left.clone(), right], [left.clone(), left]]);
        assert!((found[0] - 0.214_947_1).abs() < 1e-4, "{found:?}");
        assert_eq!(found[1], 0.0, "about a segment and itself all say a half");
        assert!(ensemble.disagreements(&[]).is_empty(), "of nothing there is none");
    }
}
