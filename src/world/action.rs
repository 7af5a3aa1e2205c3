//! What is done in a step: a number for each axis of a world.

use std::ops::Deref;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::Axis;

/// The most numbers that an action has. Two arms with hands have about forty.
pub const MAX_AXES: usize = 48;

/// A number for each axis of a world, in its own units and order. Small enough to be copied.
///
/// ```
/// use dropj::world::Action;
///
/// let action = Action::new([0.5, -1.0]);
/// assert_eq!((action.len(), action[1]), (2, -1.0));
/// ```
#[derive(Clone, Copy, PartialEq)]
pub struct Action {
    n: usize,
    /// The first `n` count, the others are 0.
    values: [f32; MAX_AXES],
}

impl Action {
    /// The action of these numbers.
    ///
    /// # Panics
    /// Where there are more than [`MAX_AXES`].
    pub fn new(values: impl AsRef<[f32]>) -> Self {
        let values = values.as_ref();
        let mut all = [0.0; MAX_AXES];
        all[..values.len()].copy_from_slice(values);
        Self { n: values.len(), values: all }
    }

    /// The same with other numbers.
    #[must_use]
    pub fn map(&self, mut of: impl FnMut(usize, f32) -> f32) -> Self {
        let mut all = *self;
        (0..all.n).for_each(|i| all.values[i] = of(i, all.values[i]));
        all
    }

    /// Whether all its numbers are some.
    pub fn is_finite(&self) -> bool {
        self.iter().all(|value| value.is_finite())
    }
}

impl Deref for Action {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        &self.values[..self.n]
    }
}

impl std::ops::DerefMut for Action {
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut self.values[..self.n]
    }
}

impl Default for Action {
    /// That of nobody: no number at all.
    fn default() -> Self {
        Self::new([])
    }
}

impl<const N: usize> From<[f32; N]> for Action {
    fn from(values: [f32; N]) -> Self {
        Self::new(values)
    }
}

impl<const N: usize> PartialEq<[f32; N]> for Action {
    fn eq(&self, other: &[f32; N]) -> bool {
        **self == other[..]
    }
}

impl std::fmt::Debug for Action {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.iter().as_slice().fmt(f)
    }
}

/// The lowest and the highest value of each number of an action.
///
/// Files from before worlds were described do not tell them, and mean those of the built-in cars.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Vec<[f32; 2]>", into = "Vec<[f32; 2]>")]
pub struct ActionRanges(Arc<[[f32; 2]]>);

impl ActionRanges {
    /// Those of a world's axes.
    pub fn of(axes: &[Axis]) -> Self {
        Self(axes.iter().map(|axis| [axis.low, axis.high]).collect())
    }

    /// A: how many numbers an action has.
    pub fn n_axes(&self) -> usize {
        self.0.len()
    }

    /// Lowest and highest of each number.
    pub fn iter(&self) -> impl Iterator<Item = [f32; 2]> {
        self.0.iter().copied()
    }

    /// Whether they are those that a file means which does not tell them.
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// `action` with every number moved to `[-1, 1]`, as only the preference reward takes it.
    ///
    /// `ã = clip(2 (a − low) / (high − low) − 1, −1, 1)` (method §5).
    ///
    /// ```
    /// use dropj::world::{Action, ActionRanges};
    ///
    /// let ranges = ActionRanges::try_from(vec![[-1.0, 1.0], [0.0, 512.0]]).unwrap();
    /// assert_eq!(ranges.scaled(&Action::new([0.25, 512.0])), [0.25, 1.0]);
    /// ```
    pub fn scaled(&self, action: &[f32]) -> Action {
        let mut scaled = Action::new(action);
        for (value, [scale, offset]) in scaled.iter_mut().zip(self.scales()) {
            *value = (*value * scale + offset).clamp(-1.0, 1.0);
        }
        scaled
    }

    /// Factor and summand of each number on its way to `[-1, 1]`.
    pub fn scales(&self) -> impl Iterator<Item = [f32; 2]> {
        self.iter().map(|[low, high]| [2.0 / (high - low), -(high + low) / (high - low)])
    }

    /// `action` with every number moved into its range; what is no number becomes the middle.
    pub fn clamped(&self, action: &[f32]) -> Action {
        let mut clamped = Action::new(action);
        for (value, [low, high]) in clamped.iter_mut().zip(self.iter()) {
            *value = if value.is_nan() { f32::midpoint(low, high) } else { value.clamp(low, high) };
        }
        clamped
    }
}

impl Default for ActionRanges {
    fn default() -> Self {
        Self(Arc::new(super::cars::RANGES))
    }
}

/// Why some ranges are none.
#[derive(Debug, thiserror::Error)]
#[error(
    "an action has 1 to {MAX_AXES} numbers, each with a finite lowest value below its highest, and these are {0}"
)]
pub struct RangesError(String);

impl TryFrom<Vec<[f32; 2]>> for ActionRanges {
    type Error = RangesError;

    fn try_from(all: Vec<[f32; 2]>) -> Result<Self, RangesError> {
        let is_range = |[low, high]: &[f32; 2]| low.is_finite() && high.is_finite() && low < high;
        if (1..=MAX_AXES).contains(&all.len()) && all.iter().all(is_range) {
            return Ok(Self(all.into()));
        }
        Err(RangesError(crate::text::shown(&format!("{all:?}"))))
    }
}

impl From<ActionRanges> for Vec<[f32; 2]> {
    fn from(ranges: ActionRanges) -> Self {
        ranges.0.to_vec()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn what_is_not_told_is_as_the_cars_have_it() {
        let ranges = ActionRanges::default();
        assert_eq!(ranges, ActionRanges::of(&crate::world::WorldSpec::built_in("car-racing").unwrap().axes));
        // Bit for bit: the first number stays as it is.
        for value in [0.1f32, -0.7, 1e-20, -0.0] {
            let scaled = ranges.scaled(&[value, 0.3, 0.8]);
            assert_eq!(
                scaled.iter().map(|x| x.to_bits()).collect::<Vec<_>>(),
                [value.to_bits(), (2.0 * 0.3f32 - 1.0).to_bits(), (2.0 * 0.8f32 - 1.0).to_bits()]
            );
        }
    }

    #[test]
    fn ranges_that_cannot_be_are_refused() {
        for wrong in [
            vec![],
            vec![[1.0, 1.0]],
            vec![[f32::NAN, 1.0]],
            vec![[0.0, f32::INFINITY]],
            vec![[0.0, 1.0]; 49],
        ] {
            assert!(ActionRanges::try_from(wrong.clone()).is_err(), "{wrong:?}");
        }
    }

    proptest! {
        #[test]
        fn scaled_actions_lie_within_one(low in -1e6f32..1e6, width in 1e-3f32..1e6, share in -1f32..2.0) {
            let ranges = ActionRanges::try_from(vec![[low, low + width.max(low.abs() * 1e-5)]]).unwrap();
            let value = ranges.scaled(&[low + share * width])[0];
            prop_assert!((-1.0..=1.0).contains(&value), "{value}");
        }
    }
}
