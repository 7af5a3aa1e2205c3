//! What an answer means: Table 1 and Eq. 2 of the paper, and nothing else.

use serde::{Deserialize, Serialize};

use crate::query::{Active, Justification, Justifications, Preference, Response, SafetyAnswer, Verdict};
use crate::world::{LabelWeights, WorldSpec};

/// What an answer means: the target probability that the left segment is better, and what each of the two was said to show.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Label {
    mu: f32,
    shown: [Shown; 2],
}

/// What was said of a segment by an answer that names justifications: which of them it shows, as far as that follows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Shown {
    /// By their places: bit `j` is that of the justification `j`.
    known: u64,
    shows: u64,
}

impl Shown {
    /// Whether the segment shows `justification` at some step. Nothing where that does not follow.
    pub fn shows(self, justification: Justification) -> Option<bool> {
        let bit = |all: u64| all.checked_shr(u32::from(justification.0)).is_some_and(|rest| rest & 1 == 1);
        bit(self.known).then(|| bit(self.shows))
    }

    /// So many places, from the most severe, reach as far as anything is known.
    pub fn n_places(self) -> usize {
        (u64::BITS - self.known.leading_zeros()) as usize
    }

    /// The same, and whether it shows those in `these`.
    fn with(self, these: u64, shows: bool) -> Self {
        Self { known: self.known | these, shows: if shows { self.shows | these } else { self.shows } }
    }
}

impl Label {
    /// Neither segment is better: μ = ½.
    pub const EQUAL: Self = Self { mu: 0.5, shown: [Shown { known: 0, shows: 0 }; 2] };

    /// The label of a preference held with weight `weight` in `(0.5, 1]`.
    ///
    /// ```text
    /// μ = w if left is preferred, 1 − w if right, ½ if equal
    /// ```
    fn weighted(weight: f32, preference: Preference) -> Self {
        let mu = match preference {
            Preference::Left => weight,
            Preference::Equal => Self::EQUAL.mu,
            Preference::Right => 1.0 - weight,
        };
        Self { mu, ..Self::EQUAL }
    }

    /// The same, by an answer that these justifications are active and this is preferred, where the last that there is, which
    /// says nothing, is `default`.
    ///
    /// - Those that are active are shown by the segment that is not preferred and not by the other, or where none is, by both.
    /// - By default, no segment shows anything.
    /// - Where both show what is active, neither shows what is more severe, or that would have been named.
    /// - The segment that is not preferred shows nothing less severe, or that would have been named, too. (It may still where
    ///   both do, which is rare.)
    /// - Of all others nothing follows.
    fn naming(self, active: Active, preference: Preference, default: Justification) -> Self {
        let below =
            |justification: Justification| !(u64::MAX.checked_shl(justification.0.into()).unwrap_or(0));
        if active.most_severe() == default {
            return Self { shown: [Shown::default().with(below(default), false); 2], ..self };
        }
        let named = active.iter().filter(|it| *it != default).fold(0, |all, it| all | 1u64 << it.0);
        let more_severe = below(active.most_severe());
        let better = Shown::default().with(named, false);
        let worse = Shown::default().with(below(default) & !more_severe & !named, false).with(named, true);
        let shown = match preference {
            Preference::Left => [better, worse],
            Preference::Right => [worse, better],
            Preference::Equal => [Shown::default().with(more_severe, false).with(named, true); 2],
        };
        Self { shown, ..self }
    }

    /// μ in `[0, 1]`.
    pub fn mu(self) -> f32 {
        self.mu
    }

    /// What the left and the right segment were said to show. Only answers that name justifications say anything.
    pub fn shown(self) -> [Shown; 2] {
        self.shown
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
                let weight = self.justifications.weight(active.most_severe());
                let default = self.justifications.default();
                Some(Label::weighted(weight, preference).naming(active, preference, default))
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

    /// What is known of both sides about each of grass, chuckhole and car.
    fn shown(places: &[u8], preference: Preference) -> [[Option<bool>; 3]; 2] {
        let named = [("grass", 1.0), ("chuckhole", 1.0), ("car", 1.0), ("default", 0.75)];
        let weights = Weights { justifications: Justifications::new(named).unwrap(), ..Weights::paper() };
        let active = places.iter().map(|place| Active::of(Justification(*place)));
        let active = active.reduce(|all, one| all.with(one.most_severe())).unwrap();
        let label = weights.label(&Response::Justified(active, preference)).unwrap();
        label.shown().map(|side| [0, 1, 2].map(|place| side.shows(Justification(place))))
    }

    #[test]
    fn an_answer_tells_what_each_clip_shows_as_far_as_that_follows() {
        let (yes, no, unknown) = (Some(true), Some(false), None);
        assert_eq!(shown(&[3], Preference::Left), [[no; 3]; 2], "by default: nothing is shown");
        assert_eq!(shown(&[1], Preference::Left), [[unknown, no, unknown], [unknown, yes, no]]);
        assert_eq!(shown(&[0, 2], Preference::Right), [[yes, no, yes], [no, unknown, no]]);
        assert_eq!(shown(&[1], Preference::Equal), [[no, yes, unknown]; 2], "grass would have been named");
        let plain = Weights::paper().label(&Response::Safety(SafetyAnswer::OnlyLeft)).unwrap();
        assert_eq!((plain.shown(), plain.shown()[0].n_places()), ([Shown::default(); 2], 0));
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
