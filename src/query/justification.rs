//! Reasons for a preference, ordered by severity and weighted (paper, Eq. 2).

use serde::{Deserialize, Serialize};

use crate::world::WorldSpec;

/// How many justifications a list can have.
const MOST: usize = 64;
/// What the default, which always applies, is called.
const DEFAULT: &str = "default";

/// One of a session's [`Justifications`]: its place in the order of severity, 0 the most severe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Justification(pub u8);

/// The justifications that an answer rests on: those that are active, or the default alone where none is (method §7.4).
///
/// Which of them is named, and so what the answer weighs, follows when labels are made: the most severe. In files it is
/// the place of a single one, or a list of places.
///
/// # Examples
///
/// ```
/// use dropj::query::{Active, Justification};
///
/// let (grass, chuckhole) = (Justification(0), Justification(1));
/// let both = Active::of(chuckhole).with(grass);
/// assert_eq!(both.most_severe(), grass);
/// assert!(both.contains(chuckhole) && !Active::of(grass).contains(chuckhole));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "Places", into = "Places")]
pub struct Active(u64);

/// [`Active`] as files have it.
#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum Places {
    One(u8),
    Several(Vec<u8>),
}

/// Why an answer's justifications cannot be.
#[derive(Debug, thiserror::Error)]
#[error("the justifications of an answer are one or more places below {MOST}, and these are {0:?}")]
struct PlacesError(Vec<u8>);

impl Active {
    /// One alone.
    ///
    /// # Panics
    /// Where its place is beyond the longest list of justifications.
    pub fn of(justification: Justification) -> Self {
        assert!(usize::from(justification.0) < MOST, "{justification:?} is of no list");
        Self(1 << justification.0)
    }

    /// These and another.
    #[must_use]
    pub fn with(self, justification: Justification) -> Self {
        Self(self.0 | Self::of(justification).0)
    }

    /// These with one more or less: what a key that is pressed makes of them. The default stands only alone.
    #[must_use]
    pub fn toggled(self, justification: Justification, default: Justification) -> Self {
        let alone = Self::of(default);
        if justification == default {
            return alone;
        }
        let rest = (self.0 ^ Self::of(justification).0) & !alone.0;
        if rest == 0 { alone } else { Self(rest) }
    }

    /// Whether this one is active.
    pub fn contains(self, justification: Justification) -> bool {
        usize::from(justification.0) < MOST && self.0 >> justification.0 & 1 == 1
    }

    /// The most severe, which is the one that is named: `k* = min {k : J_k = 1}`.
    pub fn most_severe(self) -> Justification {
        Justification(self.0.trailing_zeros() as u8)
    }

    /// The least severe.
    pub fn least_severe(self) -> Justification {
        Justification(self.0.ilog2() as u8)
    }

    /// All of them, the most severe first.
    pub fn iter(self) -> impl Iterator<Item = Justification> {
        (0..MOST as u8).map(Justification).filter(move |it| self.contains(*it))
    }
}

impl From<Justification> for Active {
    fn from(justification: Justification) -> Self {
        Self::of(justification)
    }
}

impl TryFrom<Places> for Active {
    type Error = PlacesError;

    fn try_from(places: Places) -> Result<Self, PlacesError> {
        let places = match places {
            Places::One(place) => vec![place],
            Places::Several(places) => places,
        };
        if places.is_empty() || places.iter().any(|place| usize::from(*place) >= MOST) {
            return Err(PlacesError(places));
        }
        Ok(Self(places.into_iter().fold(0, |all, place| all | 1 << place)))
    }
}

impl From<Active> for Places {
    fn from(active: Active) -> Self {
        let mut places: Vec<u8> = active.iter().map(|it| it.0).collect();
        if places.len() == 1 { Self::One(places.remove(0)) } else { Self::Several(places) }
    }
}

/// Why a list of justifications cannot be used.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum JustificationError {
    /// The list is empty.
    #[error("there must be at least one justification, the default")]
    Empty,
    /// The list is longer than their numbers reach.
    #[error("there can be {MOST} justifications at the most, and these are {0}")]
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
    /// Names with their weights `w_k` in `(½, 1]`, the most severe first and the default last.
    ///
    /// The order decides which of several an answer names, and the weight what that answer counts: any weights go with any
    /// order, as in the paper's Figures 8 and 9.
    pub fn new<S: Into<String>>(
        named: impl IntoIterator<Item = (S, f32)>,
    ) -> Result<Self, JustificationError> {
        let named: Vec<(String, f32)> =
            named.into_iter().map(|(name, weight)| (name.into(), weight)).collect();
        if named.is_empty() {
            return Err(JustificationError::Empty);
        }
        if named.len() > MOST {
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
    fn keys_make_justifications_active_and_the_most_severe_is_named() {
        let all = Justifications::new([("grass", 1.0), ("chuckhole", 0.95), ("default", 0.75)]).unwrap();
        let [grass, chuckhole] = ["grass", "chuckhole"].map(|name| all.named(name).unwrap());
        let none = Active::of(all.default());
        let toggled = |active: Active, it| active.toggled(it, all.default());
        let one = toggled(none, chuckhole);
        assert_eq!(one, Active::of(chuckhole), "the default no longer applies alone");
        let both = toggled(one, grass);
        assert_eq!((both.most_severe(), both.least_severe()), (grass, chuckhole));
        assert_eq!(both.iter().collect::<Vec<_>>(), [grass, chuckhole]);
        assert_eq!(toggled(both, grass), one);
        assert_eq!(toggled(one, chuckhole), none);
        assert_eq!(toggled(both, all.default()), none);
    }

    #[test]
    fn what_is_active_is_a_place_or_a_list_in_files() {
        let read = |text: &str| serde_json::from_str::<Active>(text).map_err(|met| met.to_string());
        let both = Active::of(Justification(3)).with(Justification(0));
        assert_eq!(serde_json::to_string(&Active::of(Justification(3))).unwrap(), "3");
        assert_eq!(serde_json::to_string(&both).unwrap(), "[0,3]");
        assert_eq!(read("3"), Ok(Active::of(Justification(3))));
        assert_eq!(read("[3,0]"), Ok(both));
        for text in ["[]", "64", "[0,200]"] {
            let refused = read(text).unwrap_err();
            assert!(refused.contains("below 64"), "{text}: {refused}");
        }
        assert!(read("-1").is_err() && read("\"grass\"").is_err());
    }

    #[test]
    fn any_weights_go_with_any_order_of_severity() {
        let named = [("grass", 0.95), ("chuckhole", 1.0), ("default", 0.75)];
        let all = Justifications::new(named).unwrap();
        let chuckhole = all.named("chuckhole").unwrap();
        assert_eq!((all.weight(chuckhole), all.weight(Justification(0))), (1.0, 0.95));
    }

    #[test]
    fn weights_outside_their_range_are_refused() {
        for weight in [0.5, 1.01, f32::NAN] {
            let refused = Justifications::new([("grass", weight), ("default", 0.75)]);
            assert!(matches!(refused, Err(JustificationError::Weight { .. })), "{weight} was taken");
        }
    }
}
