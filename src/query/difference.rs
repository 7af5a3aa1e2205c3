//! How two answers to the same query differ: about safety, which matters most, or about something else.

use crate::query::{Justification, Preference, Response, SafetyAnswer, Verdict};

/// What sets two answers to the same query apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Difference {
    /// Nothing: they are the same.
    None,
    /// One calls unsafe what the other does not.
    Critical,
    /// Which clip is better.
    Other,
}

impl Difference {
    /// That between two answers seen from the same side, where `default` is the justification that says nothing.
    ///
    /// Nothing comes where one is a skip, or where they answer other questions.
    pub fn between(one: Response, other: Response, default: Justification) -> Option<Self> {
        let is_skip = |response| matches!(response, Response::Skipped(_));
        if is_skip(one) || std::mem::discriminant(&one) != std::mem::discriminant(&other) {
            return None;
        }
        let claims = [one, other].map(|response| SafetyClaim::of(response, default));
        Some(match claims {
            _ if one.as_counted() == other.as_counted() => Self::None,
            [Some(one), Some(other)] if one != other => Self::Critical,
            _ => Self::Other,
        })
    }
}

/// What an answer says about safety, whatever it says about which clip is better.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SafetyClaim {
    /// Whether the left clip is safe, and the right one.
    Safe(bool, bool),
    /// Whether a single step is unsafe.
    Unsafe(bool),
    /// No justification but the default tells the clips apart.
    Nothing,
    /// This justification does, in this way.
    Reason(Justification, Preference),
}

impl SafetyClaim {
    /// That of `response`. Nothing comes where it was not asked about safety.
    pub fn of(response: Response, default: Justification) -> Option<Self> {
        Some(match response {
            Response::Safety(SafetyAnswer::OnlyLeft) => Self::Safe(true, false),
            Response::Safety(SafetyAnswer::OnlyRight) => Self::Safe(false, true),
            Response::Safety(SafetyAnswer::Neither) => Self::Safe(false, false),
            Response::Safety(SafetyAnswer::Both(_)) => Self::Safe(true, true),
            Response::Justified(active, _) if active.most_severe() == default => Self::Nothing,
            Response::Justified(active, preference) => Self::Reason(active.most_severe(), preference),
            Response::Judged(verdict) => Self::Unsafe(verdict == Verdict::Unsafe),
            Response::Preferred(_) | Response::Skipped(_) => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::query::{Active, Justifications, Weights};

    #[test]
    fn differing_about_safety_is_critical() {
        let default = Weights::paper().justifications.default();
        let between =
            |one, other| Difference::between(Response::Safety(one), Response::Safety(other), default);
        let both = SafetyAnswer::Both;
        assert_eq!(between(SafetyAnswer::OnlyLeft, SafetyAnswer::OnlyLeft), Some(Difference::None));
        assert_eq!(between(SafetyAnswer::OnlyLeft, SafetyAnswer::Neither), Some(Difference::Critical));
        assert_eq!(
            between(SafetyAnswer::OnlyLeft, both(Preference::Left)),
            Some(Difference::Critical),
            "though both prefer left"
        );
        assert_eq!(between(both(Preference::Left), both(Preference::Right)), Some(Difference::Other));
    }

    #[test]
    fn naming_another_danger_is_critical_and_another_taste_is_not() {
        let all = Justifications::of(&crate::world::WorldSpec::built_in("obstacle-car-racing").unwrap());
        let [grass, chuckhole] = ["grass", "chuckhole"].map(|name| all.named(name).unwrap());
        let said = |why: Justification, side| Response::Justified(why.into(), side);
        let between = |one, other| Difference::between(one, other, all.default());
        let (left, right) = (Preference::Left, Preference::Right);
        assert_eq!(between(said(grass, left), said(chuckhole, left)), Some(Difference::Critical));
        assert_eq!(between(said(grass, left), said(grass, right)), Some(Difference::Critical));
        let both = Response::Justified(Active::of(chuckhole).with(grass), left);
        assert_eq!(between(said(grass, left), both), Some(Difference::None), "both name grass");
        assert_eq!(between(said(all.default(), left), said(all.default(), right)), Some(Difference::Other));
    }

    #[test]
    fn preferences_alone_are_never_critical_and_skips_are_not_compared() {
        let default = Weights::paper().justifications.default();
        let between = |one, other| Difference::between(one, other, default);
        let [left, right] = [Preference::Left, Preference::Right].map(Response::Preferred);
        assert_eq!(between(left, right), Some(Difference::Other));
        let [unsafe_one, neutral, good] = Verdict::ALL.map(Response::Judged);
        assert_eq!(between(unsafe_one, good), Some(Difference::Critical), "but those of single steps are");
        assert_eq!(between(neutral, good), Some(Difference::Other));
        assert_eq!(between(left, Response::Skipped(None)), None);
        assert_eq!(between(left, Response::Safety(SafetyAnswer::Neither)), None, "other questions");
    }

    #[test]
    fn whether_a_transition_is_unsafe_is_critical_and_whether_it_is_good_is_not() {
        let default = Weights::paper().justifications.default();
        let between =
            |one, other| Difference::between(Response::Judged(one), Response::Judged(other), default);
        assert_eq!(between(Verdict::Unsafe, Verdict::Good), Some(Difference::Critical));
        assert_eq!(between(Verdict::Neutral, Verdict::Good), Some(Difference::Other));
        assert_eq!(between(Verdict::Unsafe, Verdict::Unsafe), Some(Difference::None));
    }
}
