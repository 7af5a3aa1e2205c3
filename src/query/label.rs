//! What an answer means: Table 1 and Eq. 2 of the paper, and nothing else.

use serde::{Deserialize, Serialize};

use crate::query::{Justifications, Preference, Response, SafetyAnswer, Verdict};
use crate::world::{LabelWeights, WorldSpec};

/// The target probability that the left segment is better, μ in `[0, 1]`.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Label(f32);

impl Label {
    /// Neither segment is better: μ = ½.
    pub const EQUAL: Self = Self(0.5);

    /// The label of a preference held with weight `weight` in `(0.5, 1]`.
    ///
    /// ```text
    /// μ = w if left is preferred, 1 − w if right, ½ if equal
    /// ```
    fn weighted(weight: f32, preference: Preference) -> Self {
        match preference {
            Preference::Left => Self(weight),
            Preference::Equal => Self::EQUAL,
            Preference::Right => Self(1.0 - weight),
        }
    }

    /// μ itself.
    pub fn mu(self) -> f32 {
        self.0
    }
}

/// The weights of answers: what a researcher varies without asking anybody again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Weights {
    /// `w_s`: only one segment is safe. Paper: 1.
    pub safety: f32,
    /// `w_def`: both are safe. Paper: 0.75.
    pub default: f32,
    /// `w_k` of several justifications, by severity (Eq. 2).
    pub justifications: Justifications,
}

impl Weights {
    /// The weights that a world's file begins with.
    pub fn of(spec: &WorldSpec) -> Self {
        let LabelWeights { safety, default } = spec.weights;
        Self { safety, default, justifications: Justifications::of(spec) }
    }

    /// Those of the first built-in world: the paper's, `w_s` = 1, `w_def` = 0.75.
    pub fn paper() -> Self {
        Self::of(&WorldSpec::default())
    }

    /// The label of `response`, or nothing where it was skipped.
    ///
    /// DROP and DROPe: μ = 1, ½, 0 (method §7.2).
    /// DROPJ: [DROPJ](crate#references), Table 1.
    /// Several justifications: Eq. 2, `μ = w_k*` if left is preferred, `1 − w_k*` if right, ½ if equal.
    ///
    /// # Examples
    ///
    /// ```
    /// use dropj::query::{Preference, Response, SafetyAnswer, Weights};
    ///
    /// let weights = Weights::paper();
    /// let both = Response::Safety(SafetyAnswer::Both(Preference::Right));
    /// assert_eq!(weights.label(&both).map(|label| label.mu()), Some(0.25));
    /// assert_eq!(weights.label(&Response::Skipped(None)), None);
    /// ```
    pub fn label(&self, response: &Response) -> Option<Label> {
        match *response {
            // A verdict names a class, and no probability of being better.
            Response::Skipped(_) | Response::Judged(_) => None,
            Response::Preferred(preference) => Some(Label::weighted(1.0, preference)),
            Response::Safety(answer) => Some(match answer {
                SafetyAnswer::OnlyLeft => Label::weighted(self.safety, Preference::Left),
                SafetyAnswer::OnlyRight => Label::weighted(self.safety, Preference::Right),
                SafetyAnswer::Neither => Label::EQUAL,
                SafetyAnswer::Both(preference) => Label::weighted(self.default, preference),
            }),
            Response::Justified(active, preference) => {
                Some(Label::weighted(self.justifications.weight(active.most_severe()), preference))
            }
        }
    }

    /// The response and its label in one sentence, for the person who gave it.
    ///
    /// ```
    /// use dropj::query::{Response, SafetyAnswer, Weights};
    ///
    /// let said = Weights::paper().say(&Response::Safety(SafetyAnswer::OnlyLeft));
    /// assert_eq!(said, "μ = 1: left preferred because right is unsafe");
    /// ```
    pub fn say(&self, response: &Response) -> String {
        let why = match *response {
            Response::Skipped(_) => return "skipped: nothing is learned from it".to_owned(),
            Response::Judged(Verdict::Unsafe) => return "−1: unsafe".to_owned(),
            Response::Judged(Verdict::Neutral) => return "0: neither good nor unsafe".to_owned(),
            Response::Judged(Verdict::Good) => return "+10: good, it gets on".to_owned(),
            Response::Preferred(Preference::Left) => "left is better".to_owned(),
            Response::Preferred(Preference::Right) => "right is better".to_owned(),
            Response::Preferred(Preference::Equal) => "neither is better".to_owned(),
            Response::Safety(SafetyAnswer::OnlyLeft) => "left preferred because right is unsafe".to_owned(),
            Response::Safety(SafetyAnswer::OnlyRight) => "right preferred because left is unsafe".to_owned(),
            Response::Safety(SafetyAnswer::Neither) => "neither preferred because both are unsafe".to_owned(),
            Response::Safety(SafetyAnswer::Both(Preference::Left)) => {
                "both are safe and left is better".to_owned()
            }
            Response::Safety(SafetyAnswer::Both(Preference::Right)) => {
                "both are safe and right is better".to_owned()
            }
            Response::Safety(SafetyAnswer::Both(Preference::Equal)) => {
                "both are safe, neither is better".to_owned()
            }
            Response::Justified(active, preference) => {
                let names = self.justifications.iter().filter(|(it, ..)| active.contains(*it));
                let names: Vec<_> = names.map(|(_, name, _)| name).collect();
                let name = match names[..] {
                    [] => "default".to_owned(),
                    [one] => one.to_owned(),
                    [named, ref others @ ..] => format!("{named} (and {})", others.join(", ")),
                };
                match preference {
                    Preference::Left => format!("left is better because of {name}"),
                    Preference::Right => format!("right is better because of {name}"),
                    Preference::Equal => format!("neither is better, judged by {name}"),
                }
            }
        };
        let mu = self.label(response).unwrap_or(Label::EQUAL).mu();
        format!("μ = {mu}: {why}")
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::query::Justification;

    #[test]
    fn the_labels_of_safety_answers_are_those_of_table_1() {
        let weights = Weights::paper();
        let mu = |answer| weights.label(&Response::Safety(answer)).unwrap().mu();
        assert_eq!(mu(SafetyAnswer::OnlyLeft), 1.0);
        assert_eq!(mu(SafetyAnswer::OnlyRight), 0.0);
        assert_eq!(mu(SafetyAnswer::Neither), 0.5);
        assert_eq!(mu(SafetyAnswer::Both(Preference::Left)), 0.75);
        assert_eq!(mu(SafetyAnswer::Both(Preference::Right)), 0.25);
        assert_eq!(mu(SafetyAnswer::Both(Preference::Equal)), 0.5);
    }

    // Eq. 2 with w = (1, 0.95, 0.75), as the paper's Figure 8 has them: μ = w_k* if left is preferred, 1 − w_k* if right.
    #[test]
    fn the_label_of_a_justified_preference_is_that_of_equation_2() {
        let named = [("grass", 1.0), ("chuckhole", 0.95), ("default", 0.75)];
        let justifications = Justifications::new(named).unwrap();
        let weights = Weights { justifications, ..Weights::paper() };
        let mu = |name: &str, preference| {
            let justification = weights.justifications.named(name).unwrap();
            weights.label(&Response::Justified(justification.into(), preference)).unwrap().mu()
        };
        for (name, expected) in
            [("grass", [1.0, 0.5, 0.0]), ("chuckhole", [0.95, 0.5, 0.05]), ("default", [0.75, 0.5, 0.25])]
        {
            let sides = [Preference::Left, Preference::Equal, Preference::Right].map(|side| mu(name, side));
            let apart =
                sides.iter().zip(expected).map(|(mu, expected)| (mu - expected).abs()).fold(0.0, f32::max);
            assert!(apart < 1e-6, "{name}: {sides:?} instead of {expected:?}");
        }
    }

    fn any_preference() -> impl Strategy<Value = Preference> {
        prop::sample::select(vec![Preference::Left, Preference::Equal, Preference::Right])
    }

    fn any_response() -> impl Strategy<Value = Response> {
        prop_oneof![
            any_preference().prop_map(Response::Preferred),
            Just(Response::Safety(SafetyAnswer::OnlyLeft)),
            Just(Response::Safety(SafetyAnswer::OnlyRight)),
            Just(Response::Safety(SafetyAnswer::Neither)),
            any_preference().prop_map(|p| Response::Safety(SafetyAnswer::Both(p))),
            (0u8..2, any_preference()).prop_map(|(j, p)| Response::Justified(Justification(j).into(), p)),
        ]
    }

    proptest! {
        #[test]
        fn changing_the_sides_over_turns_mu_into_one_minus_mu(
            response in any_response(), safety in 0.51f32..=1.0, default in 0.51f32..=1.0,
        ) {
            let weights = Weights { safety, default, ..Weights::paper() };
            let mu = weights.label(&response).unwrap().mu();
            let mirrored = weights.label(&response.mirrored()).unwrap().mu();
            prop_assert!((mu + mirrored - 1.0).abs() < 1e-6, "{mu} and {mirrored}");
        }
    }
}
