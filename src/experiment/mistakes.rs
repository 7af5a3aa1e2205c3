//! Wrong answers, so that it can be measured what they cost (the paper's Figure 16).

use rand::{Rng, RngExt as _};
use serde::{Deserialize, Serialize};

use crate::query::{Preference, Response, SafetyAnswer};

/// How many answers are turned into wrong ones.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mistakes {
    /// Of those about pairs in which at least one clip is unsafe, the share in `[0, 1]`.
    pub critical: f64,
    /// Of all others, the share in `[0, 1]`.
    pub other: f64,
}

impl Mistakes {
    /// None.
    pub const NONE: Self = Self { critical: 0.0, other: 0.0 };

    /// The answer that is given instead of `right`, about a pair that is critical or not.
    ///
    /// Who errs takes the one clip for the other; where both are alike, one of them for better, or safer, by chance.
    ///
    /// `// DIFFERENCE:` the paper does not say how a wrong answer is chosen, nor judges criticality from clips: for DROP and
    /// DROPe the authors took it from answers of DROPJ (method §12).
    pub fn made(self, right: Response, is_critical: bool, rng: &mut impl Rng) -> Response {
        // Always the same draws, so that one share leaves the chance of the other alone.
        let (luck, side) = (rng.random::<f64>(), rng.random_bool(0.5));
        let share = if is_critical { self.critical } else { self.other };
        if luck >= share {
            return right;
        }
        let strict = if side { Preference::Left } else { Preference::Right };
        let turned = |preference| match preference {
            Preference::Equal => strict,
            Preference::Left => Preference::Right,
            Preference::Right => Preference::Left,
        };
        match right {
            Response::Preferred(preference) => Response::Preferred(turned(preference)),
            Response::Justified(active, preference) => Response::Justified(active, turned(preference)),
            Response::Safety(SafetyAnswer::Both(preference)) => {
                Response::Safety(SafetyAnswer::Both(turned(preference)))
            }
            Response::Safety(SafetyAnswer::OnlyLeft) => Response::Safety(SafetyAnswer::OnlyRight),
            Response::Safety(SafetyAnswer::OnlyRight) => Response::Safety(SafetyAnswer::OnlyLeft),
            Response::Safety(SafetyAnswer::Neither) => {
                Response::Safety(if side { SafetyAnswer::OnlyLeft } else { SafetyAnswer::OnlyRight })
            }
            Response::Skipped(_) | Response::Judged(_) => right,
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn so_many_are_wrong_as_is_said_and_wrong_is_never_right() {
        let mistakes = Mistakes { critical: 0.2, other: 0.6 };
        for right in [
            Response::Safety(SafetyAnswer::OnlyLeft),
            Response::Safety(SafetyAnswer::Neither),
            Response::Safety(SafetyAnswer::Both(Preference::Equal)),
            Response::Preferred(Preference::Left),
        ] {
            for (is_critical, share) in [(true, 0.2), (false, 0.6)] {
                let rng = &mut ChaCha8Rng::seed_from_u64(0);
                let n = (0..4000).filter(|_| mistakes.made(right, is_critical, rng) != right).count();
                assert!((n as f64 / 4000.0 - share).abs() < 0.03, "{n} of 4000 for {right:?}");
            }
        }
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let skipped = Response::Skipped(None);
        assert_eq!(Mistakes { critical: 1.0, other: 1.0 }.made(skipped, true, rng), skipped);
    }
}
