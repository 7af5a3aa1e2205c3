//! Reasons for a preference, ordered by severity and weighted (paper, Eq. 2).

use serde::{Deserialize, Serialize};

use crate::world::WorldSpec;

/// What the default, which always applies, is called.
const DEFAULT: &str = "default";

/// One of a session's [`Justifications`]: its place in the order of severity, 0 the most severe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Justification(pub u8);

/// Why a list of justifications cannot be used.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum JustificationError {
    /// The list is empty.
    #[error("there must be at least one justification, the default")]
    Empty,
    /// The list is longer than their numbers reach.
    #[error("there can be 256 justifications at the most, and these are {0}")]
    TooMany(usize),
    /// Two entries share a name.
    #[error("the justification {0:?} is named twice")]
    Twice(String),
    /// A weight lies outside `(0.5, 1]`.
    #[error("the weight of {name:?} must be above 0.5 and at most 1, but is {weight}")]
    Weight {
        /// Which one.
        name: String,
        /// Its weight.
        weight: f32,
    },
    /// A justification has a larger weight than one that is more severe.
    #[error("{name:?} is less severe than {above:?}, and so cannot weigh more")]
    Order {
        /// Which one.
        name: String,
        /// The one before it.
        above: String,
    },
    /// There is no justification of that name.
    #[error("{0:?} is not a justification of this session")]
    Unknown(String),
}

/// The justifications of a session, the most severe first, the default last.
///
/// # Examples
///
/// ```
/// use dropj::query::Justifications;
///
/// let justifications = Justifications::new([("grass", 1.0), ("chuckhole", 0.95), ("default", 0.75)])?;
/// let grass = justifications.named("grass")?;
/// assert_eq!(justifications.weight(grass), 1.0);
/// assert!(justifications.named("ice").is_err());
/// # Ok::<(), dropj::query::JustificationError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Vec<(String, f32)>", into = "Vec<(String, f32)>")]
pub struct Justifications(Vec<(String, f32)>);

impl Justifications {
    /// Names with their weights `w_k`, the most severe first: `1 ≥ w_1 ≥ w_2 ≥ … > ½`. The default last.
    ///
    /// The default, which is no degree of severity, may weigh anything in `(½, 1]`. The paper also tries 1 for it.
    pub fn new<S: Into<String>>(
        named: impl IntoIterator<Item = (S, f32)>,
    ) -> Result<Self, JustificationError> {
        let named: Vec<(String, f32)> =
            named.into_iter().map(|(name, weight)| (name.into(), weight)).collect();
        if named.is_empty() {
            return Err(JustificationError::Empty);
        }
        if named.len() > 256 {
            return Err(JustificationError::TooMany(named.len()));
        }
        for (i, (name, weight)) in named.iter().enumerate() {
            if named[..i].iter().any(|(other, _)| other == name) {
                return Err(JustificationError::Twice(name.clone()));
            }
            if !(*weight > 0.5 && *weight <= 1.0) {
                return Err(JustificationError::Weight { name: name.clone(), weight: *weight });
            }
        }
        if let Some(pair) = named[..named.len() - 1].windows(2).find(|pair| pair[1].1 > pair[0].1) {
            return Err(JustificationError::Order { name: pair[1].0.clone(), above: pair[0].0.clone() });
        }
        Ok(Self(named))
    }

    /// Those of a world's file, with the default last.
    ///
    /// # Panics
    /// Never: a file's justifications are checked where it is read.
    pub fn of(spec: &WorldSpec) -> Self {
        let named = spec.justifications.iter().map(|it| (it.name.as_str(), it.weight));
        let all = named.chain([(DEFAULT, spec.weights.default)]);
        Self::new(all).unwrap_or_else(|e| unreachable!("checked: {e}"))
    }

    /// The justification of this name.
    pub fn named(&self, name: &str) -> Result<Justification, JustificationError> {
        let place = self.0.iter().position(|(other, _)| other == name);
        place.map(|i| Justification(i as u8)).ok_or_else(|| JustificationError::Unknown(name.to_owned()))
    }

    /// The most severe justification among the active ones, `k* = min {k : J_k = 1}`. The default where none is.
    pub fn most_severe(&self, active: impl IntoIterator<Item = Justification>) -> Justification {
        active.into_iter().min().unwrap_or(self.default())
    }

    /// The default, which always applies.
    pub fn default(&self) -> Justification {
        Justification((self.0.len() - 1) as u8)
    }

    /// The weight `w_k`, in `(0.5, 1]`. That of the default for one that is not of this list.
    pub fn weight(&self, justification: Justification) -> f32 {
        self.0.get(usize::from(justification.0)).unwrap_or(&self.0[self.0.len() - 1]).1
    }

    /// Each with its name and weight, the most severe first.
    pub fn iter(&self) -> impl Iterator<Item = (Justification, &str, f32)> {
        self.0.iter().enumerate().map(|(i, (name, weight))| (Justification(i as u8), name.as_str(), *weight))
    }
}

impl TryFrom<Vec<(String, f32)>> for Justifications {
    type Error = JustificationError;

    fn try_from(named: Vec<(String, f32)>) -> Result<Self, JustificationError> {
        Self::new(named)
    }
}

impl From<Justifications> for Vec<(String, f32)> {
    fn from(justifications: Justifications) -> Self {
        justifications.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_most_severe_active_justification_is_named() {
        let all = Justifications::new([("grass", 1.0), ("chuckhole", 0.95), ("default", 0.75)]).unwrap();
        let (chuckhole, default) = (all.named("chuckhole").unwrap(), all.default());
        assert_eq!(all.most_severe([default, chuckhole]), chuckhole);
        assert_eq!(all.most_severe([]), default);
    }

    #[test]
    fn weights_that_contradict_the_order_are_refused() {
        let refused = Justifications::new([("grass", 0.95), ("chuckhole", 1.0), ("default", 0.75)]);
        let order = JustificationError::Order { name: "chuckhole".into(), above: "grass".into() };
        assert_eq!(refused, Err(order));
    }

    #[test]
    fn weights_outside_their_range_are_refused() {
        for weight in [0.5, 1.01, f32::NAN] {
            let refused = Justifications::new([("grass", weight), ("default", 0.75)]);
            assert!(matches!(refused, Err(JustificationError::Weight { .. })), "{weight} was taken");
        }
    }
}
