//! A stand-in for the person who answers: it watches decoded clips and answers by simple rules, with human failings.
//!
//! The failings are the parameters of [B-Pref](crate#references): rationality, myopia, mistakes, skipping and equality.

use rand::{Rng, RngExt as _};
use serde::{Deserialize, Serialize};

use super::probe::{Probe, Sight};
use crate::env::{Frame, STEPS_PER_SEC};
use crate::query::{Justification, Justifications, Preference, Protocol, Response, SafetyAnswer, SkipReason};

/// Length of a tile in units.
const TILE: f32 = 3.5;
/// Where the car, keeping its middle to the middle of the road, has a wheel at the edge, in units.
const EDGE: f32 = 6.0;
/// A step off the road costs this part of what a new tile pays: −1 against +10 (method §12).
const UNSAFE_COST: f32 = 0.1;
/// In so many pictures the car must be seen off the road. One alone may be a flaw of the picture.
const N_OFF: usize = 2;

/// What is seen in a clip.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Perception {
    /// Probability of being off the road, picture by picture.
    pub off_road: Vec<f32>,
    /// Probability of a wheel in a chuckhole, picture by picture.
    pub chuckhole: Vec<f32>,
    /// Probability of touching another car, picture by picture.
    pub car: Vec<f32>,
    /// Tiles passed in each step: velocity along the road, backwards counting nothing.
    pub tiles: Vec<f32>,
    /// How near the edge the car is, picture by picture: the square of its way from the middle, where 1 is the edge.
    pub nearness: Vec<f32>,
    /// How much the car jumps on the road: root mean square of its moves across it that its motion does not explain,
    /// in units.
    pub jumps: f32,
}

impl Perception {
    /// What `sights`, one a picture, come to.
    pub fn of(sights: &[Sight]) -> Self {
        let secs = 1.0 / STEPS_PER_SEC as f32;
        // Far out on the grass there is little to measure a move by, and its meaning is clear.
        let on_road = sights.windows(2).filter(|pair| pair.iter().all(|sight| sight.off_road < 0.5));
        let jumps = on_road.map(|pair| {
            let across = 0.5 * (pair[0].road_velocity[1] + pair[1].road_velocity[1]);
            pair[1].lateral - pair[0].lateral - across * secs
        });
        let n_jumps = sights.len().saturating_sub(1).max(1) as f32;
        Self {
            off_road: sights.iter().map(|sight| sight.off_road).collect(),
            chuckhole: sights.iter().map(|sight| sight.chuckhole).collect(),
            car: sights.iter().map(|sight| sight.car).collect(),
            tiles: sights.iter().map(|sight| sight.road_velocity[0].max(0.0) * secs / TILE).collect(),
            nearness: sights.iter().map(|sight| (sight.lateral / EDGE).powi(2)).collect(),
            jumps: (jumps.map(|jump| jump * jump).sum::<f32>() / n_jumps).sqrt(),
        }
    }

    /// Whether the clip never shows the car leaving the road.
    pub fn is_safe(&self) -> bool {
        !self.shows("grass")
    }

    /// Whether the clip shows what the justification of this name is about.
    pub fn shows(&self, justification: &str) -> bool {
        let chances = match justification {
            "grass" => &self.off_road,
            "chuckhole" => &self.chuckhole,
            "car" => &self.car,
            _ => return false,
        };
        chances.iter().filter(|chance| **chance > 0.5).count() >= N_OFF
    }

    /// What the driving is worth in tiles: those passed, less `care` for each step at the edge.
    ///
    /// Steps of the past count `gamma` times less than the next.
    pub fn worth(&self, gamma: f32, care: f32) -> f32 {
        self.steps(care).fold(0.0, |sum, (worth, _)| gamma * sum + worth)
    }

    /// The same where off the road no tile pays, and each step costs.
    pub fn payoff(&self, gamma: f32, care: f32) -> f32 {
        self.steps(care).fold(0.0, |sum, (worth, off)| gamma * sum + if off { -UNSAFE_COST } else { worth })
    }

    /// What each step is worth on the road, and whether it is off it.
    fn steps(&self, care: f32) -> impl Iterator<Item = (f32, bool)> {
        let worths = self.tiles.iter().zip(&self.nearness).map(move |(tiles, near)| tiles - care * near);
        worths.zip(self.off_road.iter().map(|chance| *chance > 0.5))
    }
}

/// How well an annotator answers: the parameters of B-Pref, and one for safety.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Annotator {
    /// β: rationality, per tile of difference. Nothing means perfect, 0 a coin.
    pub beta: Option<f32>,
    /// γ: what a step counts against the next, in `(0, 1]`. Below 1 the end of a clip impresses more.
    pub gamma: f32,
    /// Probability of saying the opposite preference.
    pub eps_mistake: f64,
    /// A query is skipped where a clip's jumps are above this, in units. Nothing means that none is.
    pub eps_skip: Option<f32>,
    /// What a step at the very edge of the road costs, in tiles: whoever drives there is about to leave it.
    pub care: f32,
    /// Clips are equal where they differ by less than this, in tiles.
    pub eps_equal: f32,
    /// Probability of mistaking a safe clip for an unsafe one, or an unsafe one for a safe one.
    pub eps_safety: f64,
}

impl Annotator {
    /// Makes no mistake, keeps away from the edge, and differences below a third of a tile escape it.
    pub fn careful() -> Self {
        Self {
            beta: None,
            gamma: 1.0,
            eps_mistake: 0.0,
            care: 0.1,
            eps_skip: Some(1.5),
            eps_equal: 0.3,
            eps_safety: 0.0,
        }
    }

    /// Watches a clip.
    pub fn watch(&self, probe: &Probe, clip: &[Frame]) -> Perception {
        Perception::of(&probe.watch(clip))
    }

    /// The answer to a query under `protocol`, where several `justifications` are asked for among those.
    pub fn answer(
        &self,
        protocol: Protocol,
        justifications: &Justifications,
        left: &Perception,
        right: &Perception,
        rng: &mut impl Rng,
    ) -> Response {
        // Always the same draws, so that one parameter leaves the chance of the others alone.
        let luck = Luck {
            choice: rng.random(),
            is_mistaken: rng.random_bool(self.eps_mistake),
            misjudges: [rng.random_bool(self.eps_safety), rng.random_bool(self.eps_safety)],
        };
        if self.eps_skip.is_some_and(|most| left.jumps.max(right.jumps) > most) {
            return Response::Skipped(Some(SkipReason::Hallucinated));
        }
        let payoffs = [left, right].map(|clip| clip.payoff(self.gamma, self.care));
        let worths = [left, right].map(|clip| clip.worth(self.gamma, self.care));
        let [left_safe, right_safe] =
            [left.is_safe() != luck.misjudges[0], right.is_safe() != luck.misjudges[1]];
        match protocol {
            // They ask about transitions, each by itself: see `verdict`.
            Protocol::Request | Protocol::Dros => Response::Skipped(Some(SkipReason::Other)),
            Protocol::Drop => match self.prefer(payoffs, luck) {
                Preference::Equal => Response::Skipped(Some(SkipReason::Ambiguous)),
                strict => Response::Preferred(strict),
            },
            Protocol::Drope => Response::Preferred(self.prefer(payoffs, luck)),
            Protocol::Dropj => Response::Safety(match (left_safe, right_safe) {
                (true, false) => SafetyAnswer::OnlyLeft,
                (false, true) => SafetyAnswer::OnlyRight,
                (false, false) => SafetyAnswer::Neither,
                (true, true) => SafetyAnswer::Both(self.prefer(worths, luck)),
            }),
            Protocol::DropjMulti => {
                let shown: Vec<_> = justifications
                    .iter()
                    .map(|(justification, name, _)| {
                        let errs = [rng.random_bool(self.eps_safety), rng.random_bool(self.eps_safety)];
                        (justification, [left.shows(name) != errs[0], right.shows(name) != errs[1]])
                    })
                    .collect();
                justify(justifications, &shown, || self.prefer(worths, luck))
            }
        }
    }

    /// Which of two worths in tiles is preferred.
    fn prefer(&self, [left, right]: [f32; 2], luck: Luck) -> Preference {
        let lead = left - right;
        if lead.abs() < self.eps_equal {
            return Preference::Equal;
        }
        // B-Pref: P(left) = exp β·left / (exp β·left + exp β·right).
        let is_left = match self.beta {
            None => lead > 0.0,
            Some(beta) => luck.choice < 1.0 / (1.0 + (-beta * lead).exp()),
        };
        if is_left == luck.is_mistaken { Preference::Right } else { Preference::Left }
    }
}

/// The most severe justification that tells the clips apart decides. Where both show the same, neither is better.
/// Where both show nothing, `otherwise` decides by default.
///
/// `// DIFFERENCE:` in Eq. 2 the most severe that is active decides. One that both clips show alike leaves them to the next.
fn justify(
    all: &Justifications,
    shown: &[(Justification, [bool; 2])],
    otherwise: impl FnOnce() -> Preference,
) -> Response {
    let default = all.default();
    let mut shared = None;
    for &(justification, shown) in shown.iter().filter(|(justification, _)| *justification != default) {
        match shown {
            [false, true] => return Response::Justified(justification, Preference::Left),
            [true, false] => return Response::Justified(justification, Preference::Right),
            [true, true] => shared = shared.or(Some(justification)),
            [false, false] => {}
        }
    }
    match shared {
        Some(justification) => Response::Justified(justification, Preference::Equal),
        None => Response::Justified(default, otherwise()),
    }
}

/// What chance has in store for one query.
#[derive(Clone, Copy, Debug)]
struct Luck {
    /// Uniform in `[0, 1)`.
    choice: f32,
    is_mistaken: bool,
    misjudges: [bool; 2],
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// A clip at a steady speed in units a second, with its first `n_off` pictures off the road.
    fn clip(speed: f32, n_off: usize) -> Perception {
        let sight = |i| Sight {
            off_road: if i < n_off { 0.9 } else { 0.1 },
            road_velocity: [speed, 0.0],
            ..Sight::default()
        };
        Perception::of(&(0..20).map(sight).collect::<Vec<_>>())
    }

    fn answers(annotator: Annotator, protocol: Protocol, clips: [&Perception; 2]) -> Vec<Response> {
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let justifications = Justifications::car_racing();
        (0..200).map(|_| annotator.answer(protocol, &justifications, clips[0], clips[1], rng)).collect()
    }

    fn answer(annotator: Annotator, protocol: Protocol, clips: [&Perception; 2]) -> Response {
        answers(annotator, protocol, clips)[0]
    }

    #[test]
    fn driving_is_worth_the_way_in_tiles() {
        assert!((clip(35.0, 0).worth(1.0, 0.4) - 4.0).abs() < 1e-5, "35 units a second for 0.4 seconds");
        assert!((clip(35.0, 10).payoff(1.0, 0.4) - (2.0 - 1.0)).abs() < 1e-5, "half of it off the road");
        assert!(clip(35.0, 0).worth(0.5, 0.4) < 0.5, "a myopic one counts the last steps");
    }

    #[test]
    fn whoever_cares_prefers_the_middle_of_the_road_to_a_little_more_speed() {
        let along = |speed, lateral| {
            let sight = Sight { lateral, road_velocity: [speed, 0.0], ..Sight::default() };
            Perception::of(&[sight; 20])
        };
        let clips = [&along(35.0, 0.5), &along(40.0, 4.5)];
        let careless = Annotator { care: 0.0, ..Annotator::careful() };

        assert_eq!(answer(careless, Protocol::Drope, clips), Response::Preferred(Preference::Right));
        assert_eq!(
            answer(Annotator::careful(), Protocol::Drope, clips),
            Response::Preferred(Preference::Left)
        );
    }

    #[test]
    fn safety_goes_before_progress_in_dropj_only() {
        let (slow, wild) = (clip(20.0, 0), clip(60.0, 3));
        let careful = Annotator::careful();

        assert_eq!(
            answer(careful, Protocol::Dropj, [&wild, &slow]),
            Response::Safety(SafetyAnswer::OnlyRight)
        );
        assert_eq!(answer(careful, Protocol::Drope, [&wild, &slow]), Response::Preferred(Preference::Left));
    }

    #[test]
    fn the_most_severe_difference_is_the_reason() {
        let all = Justifications::new([("chuckhole", 1.0), ("grass", 0.95), ("default", 0.75)]).unwrap();
        let [chuckhole, grass] = ["chuckhole", "grass"].map(|name| all.named(name).unwrap());
        let bumpy = |clip: Perception| Perception { chuckhole: vec![0.9; 20], ..clip };
        let answer = |left: &Perception, right: &Perception| {
            let rng = &mut ChaCha8Rng::seed_from_u64(0);
            Annotator::careful().answer(Protocol::DropjMulti, &all, left, right, rng)
        };
        let [fast, slow, off] = [clip(40.0, 0), clip(20.0, 0), clip(40.0, 9)];

        assert_eq!(answer(&bumpy(fast.clone()), &off), Response::Justified(chuckhole, Preference::Right));
        assert_eq!(answer(&bumpy(fast.clone()), &bumpy(off)), Response::Justified(grass, Preference::Left));
        let both = [bumpy(fast.clone()), bumpy(slow.clone())];
        assert_eq!(answer(&both[0], &both[1]), Response::Justified(chuckhole, Preference::Equal));
        assert_eq!(answer(&fast, &slow), Response::Justified(all.default(), Preference::Left));
    }

    #[test]
    fn one_odd_picture_does_not_make_a_clip_unsafe() {
        assert!(clip(30.0, 1).is_safe() && !clip(30.0, 2).is_safe(), "two do");
    }

    #[test]
    fn changing_the_clips_over_mirrors_the_answer() {
        let clips = [clip(20.0, 0), clip(40.0, 0), clip(30.0, 5), clip(10.0, 20)];
        for protocol in Protocol::ALL {
            for (left, right) in clips.iter().flat_map(|left| clips.iter().map(move |right| (left, right))) {
                let there = answer(Annotator::careful(), protocol, [left, right]);
                let back = answer(Annotator::careful(), protocol, [right, left]);
                assert_eq!(there, back.mirrored(), "{protocol:?}");
                assert!(protocol.permits(&there), "{protocol:?} does not ask for {there:?}");
            }
        }
    }

    #[test]
    fn someone_who_always_mistakes_says_the_opposite() {
        let clips = [&clip(20.0, 0), &clip(40.0, 0)];
        let mistaken = Annotator { eps_mistake: 1.0, ..Annotator::careful() };

        let all = answers(mistaken, Protocol::Dropj, clips);

        let opposite = Response::Safety(SafetyAnswer::Both(Preference::Left));
        assert!(all.iter().all(|answer| *answer == opposite), "the right one is faster");
    }

    #[test]
    fn someone_who_misjudges_safety_says_the_opposite_of_both() {
        let clips = [&clip(20.0, 0), &clip(40.0, 20)];
        let blind = Annotator { eps_safety: 1.0, ..Annotator::careful() };

        assert_eq!(answer(blind, Protocol::Dropj, clips), Response::Safety(SafetyAnswer::OnlyRight));
    }

    #[test]
    fn a_clip_in_which_the_car_jumps_is_skipped() {
        let jumping = Perception { jumps: 2.0, ..clip(20.0, 0) };
        let clips = [&jumping, &clip(40.0, 0)];
        let patient = Annotator { eps_skip: None, ..Annotator::careful() };

        let skipped = Response::Skipped(Some(SkipReason::Hallucinated));
        assert_eq!(answer(Annotator::careful(), Protocol::Dropj, clips), skipped);
        assert_ne!(answer(patient, Protocol::Dropj, clips), skipped);
    }

    #[test]
    fn jumps_across_the_road_are_measured_and_smooth_moves_are_none() {
        let sight = |lateral, across| Sight { lateral, road_velocity: [20.0, across], ..Sight::default() };
        let smooth: Vec<_> = (0..20).map(|i| sight(0.2 * i as f32, 10.0)).collect();
        let jumping: Vec<_> = (0..20).map(|i| sight(2.0 * (i % 2) as f32, 0.0)).collect();

        assert!(Perception::of(&smooth).jumps < 1e-4 && (Perception::of(&jumping).jumps - 2.0).abs() < 1e-4);
    }

    #[test]
    fn clips_that_hardly_differ_are_equal_or_left_where_that_cannot_be_said() {
        let clips = [&clip(30.0, 0), &clip(31.0, 0)];
        let sharp = Annotator { eps_equal: 0.0, ..Annotator::careful() };

        assert_eq!(
            answer(Annotator::careful(), Protocol::Dropj, clips),
            Response::Safety(SafetyAnswer::Both(Preference::Equal))
        );
        let left_out = Response::Skipped(Some(SkipReason::Ambiguous));
        assert_eq!(answer(Annotator::careful(), Protocol::Drop, clips), left_out);
        assert_eq!(answer(sharp, Protocol::Drop, clips), Response::Preferred(Preference::Right));
    }

    #[test]
    fn less_rational_people_choose_the_worse_clip_more_often() {
        let clips = [&clip(40.0, 0), &clip(30.0, 0)];
        let n_left = |beta| {
            let annotator = Annotator { beta: Some(beta), ..Annotator::careful() };
            let all = answers(annotator, Protocol::Drope, clips);
            all.iter().filter(|answer| **answer == Response::Preferred(Preference::Left)).count()
        };

        assert!(n_left(0.0) < 130 && n_left(1.0) > 130 && n_left(20.0) == 200, "of 200");
    }
}
