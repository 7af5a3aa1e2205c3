//! How far two people, or one person twice, say the same of the same clips.

use std::collections::HashMap;
use std::hash::Hash;

use serde::Serialize;

use crate::query::difference::{Difference, SafetyClaim};
use crate::query::{Justification, Response};

/// How two series of answers to the same queries agree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Agreement {
    /// How many queries both answered, with more than a skip.
    pub n: usize,
    /// How many of them alike.
    pub n_same: usize,
    /// How many with another view of what is safe.
    pub n_critical: usize,
    /// Cohen's κ of the answers as they are.
    pub kappa: Option<f64>,
    /// Cohen's κ of what they say about safety, whatever is preferred.
    pub safety_kappa: Option<f64>,
}

impl Agreement {
    /// That of pairs of answers, each seen from the same side, where `default` is the justification that says nothing.
    ///
    /// Pairs with a skip, or with answers to other questions, are passed over. Nothing comes where none is left.
    pub fn of(pairs: &[(Response, Response)], default: Justification) -> Option<Self> {
        let between = |&(one, other): &(Response, Response)| Difference::between(one, other, default);
        let compared: Vec<_> = pairs.iter().copied().filter(|pair| between(pair).is_some()).collect();
        if compared.is_empty() {
            return None;
        }
        let count = |wanted| compared.iter().filter(|pair| between(pair) == Some(wanted)).count();
        let claims = compared.iter().filter_map(|&(one, other)| {
            Some((SafetyClaim::of(one, default)?, SafetyClaim::of(other, default)?))
        });
        Some(Self {
            n: compared.len(),
            n_same: count(Difference::None),
            n_critical: count(Difference::Critical),
            kappa: kappa(&compared),
            safety_kappa: kappa(&claims.collect::<Vec<_>>()),
        })
    }

    /// How many differ about something else than safety.
    pub fn n_other(&self) -> usize {
        self.n - self.n_same - self.n_critical
    }

    /// The share of answers that are alike, in `[0, 1]`.
    pub fn share(&self) -> f64 {
        self.n_same as f64 / self.n as f64
    }
}

/// Cohen's κ of two series of choices.
///
/// ```text
/// κ = (p_o − p_e) / (1 − p_e),  p_e = Σ_c p₁(c) p₂(c)
/// ```
///
/// 1 is agreeing always, 0 what two who choose by chance as often would reach.
/// Nothing comes where there are no choices, or where only one thing was ever chosen, for then chance explains all.
///
/// ```
/// use dropj::evaluation::kappa;
///
/// assert_eq!(kappa(&[("yes", "yes"), ("no", "no")]), Some(1.0));
/// assert_eq!(kappa(&[("yes", "yes"), ("yes", "yes")]), None);
/// ```
pub fn kappa<T: Copy + Eq + Hash>(pairs: &[(T, T)]) -> Option<f64> {
    let n = pairs.len();
    let mut counts: HashMap<T, [usize; 2]> = HashMap::new();
    for &(one, other) in pairs {
        counts.entry(one).or_default()[0] += 1;
        counts.entry(other).or_default()[1] += 1;
    }
    let n_same = pairs.iter().filter(|(one, other)| one == other).count();
    // Whole numbers, so that the order of the counts does not matter: p_o = n·n_same / n², p_e = by_chance / n².
    let by_chance: usize = counts.values().map(|[one, other]| one * other).sum();
    let (all, same) = (n * n, n * n_same);
    (all > by_chance).then(|| (same as f64 - by_chance as f64) / (all - by_chance) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::query::Weights;
    use crate::query::{Preference, SafetyAnswer};

    #[test]
    fn kappa_is_that_of_the_textbook() {
        // 20 times both yes, 5 times only the first, 10 times only the second, 15 times both no:
        // p_o = 0.7, p_e = 0.5 · 0.6 + 0.5 · 0.4 = 0.5, κ = 0.4.
        let mut pairs = vec![(true, true); 20];
        pairs.extend([(true, false)].repeat(5));
        pairs.extend([(false, true)].repeat(10));
        pairs.extend([(false, false)].repeat(15));
        assert!((kappa(&pairs).unwrap() - 0.4).abs() < 1e-12);
        assert_eq!(kappa::<bool>(&[]), None);
        assert_eq!(kappa(&[(1, 2), (2, 1)]), Some(-1.0), "never agreeing where half would by chance");
    }

    #[test]
    fn critical_and_other_differences_are_counted_apart() {
        let default = Weights::paper().justifications.default();
        let both = |preference| Response::Safety(SafetyAnswer::Both(preference));
        let only_left = Response::Safety(SafetyAnswer::OnlyLeft);
        let neither = Response::Safety(SafetyAnswer::Neither);
        let pairs = [
            (only_left, only_left),
            (both(Preference::Left), both(Preference::Left)),
            (both(Preference::Left), both(Preference::Equal)),
            (only_left, neither),
            (neither, Response::Skipped(None)),
        ];
        let agreement = Agreement::of(&pairs, default).unwrap();
        assert_eq!((agreement.n, agreement.n_same, agreement.n_critical, agreement.n_other()), (4, 2, 1, 1));
        assert_eq!(agreement.share(), 0.5);
        // By hand: the first says only-left 2, both-left 2; the second only-left 1, both-left 1, both-equal 1, neither 1:
        // p_o = ½, p_e = (2·1 + 2·1) / 16 = ¼, κ = ⅓. Of safety: both 2 and 2, only-left 2 and 1: p_o = ¾,
        // p_e = (2·2 + 2·1) / 16 = ⅜, κ = ⅗.
        assert!((agreement.kappa.unwrap() - 1.0 / 3.0).abs() < 1e-12);
        assert!((agreement.safety_kappa.unwrap() - 0.6).abs() < 1e-12);
        assert_eq!(Agreement::of(&pairs[4..], default), None);
    }
}
