//! How large what a file describes may be: far above anything that this program writes, and small enough for any machine.
//!
//! Every configuration that comes from a file is held against these before anything is made from it.

use std::fmt::Display;
use std::ops::RangeInclusive;

/// Bytes of a safetensors header: ours have some four thousand.
pub const MAX_HEADER: usize = 1 << 20;
/// Tensors of a file: ours have some forty.
pub const MAX_TENSORS: usize = 4096;
/// Axes of a tensor: ours have at most four.
pub const MAX_AXES: usize = 8;
/// Numbers of a tensor, were none of its axes empty: no file of ours comes near, and products of sizes stay numbers.
pub const MAX_NUMBERS: usize = 1 << 40;
/// Pixels a side of a frame: ours have 84 and 128, and a frame of this side is 3 MB.
pub const MAX_SIDE: i64 = 1024;
/// Layers of a network: the deepest of the paper has five.
pub const MAX_LAYERS: usize = 32;
/// Channels of a convolution, or units of a hidden layer: the widest of the paper has 1024.
pub const MAX_WIDTH: i64 = 1 << 14;
/// Pixels a side of a kernel: ours have at most five.
pub const MAX_KERNEL: i64 = 32;
/// Numbers that a layer makes of one frame: the paper's make a quarter of a million at the most, and these would be 16 MB.
pub const MAX_ACTIVATIONS: i64 = 1 << 22;
/// Latents of a state: the paper has at most 64.
pub const MAX_LATENTS: i64 = 1 << 12;
/// Cells of a memory: the paper has at most 1024.
pub const MAX_MEMORY: i64 = 1 << 14;
/// Gaussians of a mixture: the paper has at most 7.
pub const MAX_COMPONENTS: i64 = 256;
/// Networks of an ensemble: the paper has at most 4.
pub const MAX_MEMBERS: i64 = 1024;
/// What is counted and allocates nothing: steps of an optimizer, passes, rows in a batch.
pub const MAX_COUNT: usize = 1 << 32;
/// States that dreams can start from: ours have thirty.
pub const MAX_STARTS: usize = 100_000;
/// The number of a recorded episode: the largest up to which `f32` knows all whole numbers, for so they are kept.
pub const MAX_EPISODE: f32 = 16_777_216.0;
/// Bytes of a name, such as that of an environment, or of a hash.
pub const MAX_NAME: usize = 100;

/// A number in a configuration that cannot be.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{what} is {found}, and must be {wanted}")]
pub struct OutOfRange {
    /// What it counts or measures.
    pub what: String,
    /// Its value.
    pub found: String,
    /// What it may be.
    pub wanted: String,
}

impl OutOfRange {
    /// That `what` is `found`, in place of something `wanted`.
    pub fn new(what: impl Into<String>, found: impl Display, wanted: impl Into<String>) -> Self {
        Self { what: what.into(), found: found.to_string(), wanted: wanted.into() }
    }
}

/// Fails where `found` does not lie in `range`. What is not a number lies in none.
pub fn within<T: PartialOrd + Display>(
    what: &str,
    found: T,
    range: RangeInclusive<T>,
) -> Result<(), OutOfRange> {
    if range.contains(&found) {
        return Ok(());
    }
    let wanted = format!("from {} to {}", range.start(), range.end());
    Err(OutOfRange::new(what, found, wanted))
}

/// Fails where a name is empty, or too long to be one.
pub fn named(what: &str, name: &str) -> Result<(), OutOfRange> {
    within(&format!("the length of {what}"), name.len(), 1..=MAX_NAME)
}

/// The product of sizes, where it can be told.
pub fn product(sizes: &[i64]) -> Option<i64> {
    sizes.iter().try_fold(1_i64, |product, &size| product.checked_mul(size))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_number_lies_in_no_range() {
        assert_eq!(within("it", 3, 1..=3), Ok(()));
        let refused = within("the memory", -1, 1..=8).unwrap_err().to_string();
        assert_eq!(refused, "the memory is -1, and must be from 1 to 8");
        assert!(within("it", f64::NAN, 0.0..=1.0).is_err());
        assert_eq!((product(&[2, 3]), product(&[i64::MAX, 2])), (Some(6), None));
    }
}
