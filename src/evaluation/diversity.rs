//! How diverse a trajectory is: the determinantal measure of Dai et al. (2021), Eq. 7, with windows of two (method §12).

use crate::dream::Rows;

/// The sum over neighbors of the squared area that their normalized vectors span.
///
/// ```text
/// d = Σ_t det(MᵀM) = Σ_t (1 − cos² ∠(v_t, v_{t+1}))      in [0, T − 1]
/// ```
///
/// Identical neighbors add 0, orthogonal ones 1. A vector of length 0 has no direction and adds 0.
///
/// ```
/// use dropj::dream::Rows;
/// use dropj::evaluation::diversity;
///
/// let rows = |values: &[f32]| Rows { width: 2, values: values.to_vec() };
/// assert_eq!(diversity(&rows(&[1.0, 0.0, 0.0, 2.0, 0.0, 5.0])), 1.0);
/// ```
pub fn diversity(rows: &Rows) -> f64 {
    let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
    (1..rows.len())
        .map(|t| {
            let (one, other) = (rows.row(t - 1), rows.row(t));
            let lengths = dot(one, one) * dot(other, other);
            if lengths > 0.0 { (1.0 - dot(one, other).powi(2) / lengths).max(0.0) } else { 0.0 }
        })
        .sum()
}
