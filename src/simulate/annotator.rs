//! A stand-in for the person who answers: it watches decoded clips and answers by simple rules, with human failings.
//!
//! The failings are the parameters of [B-Pref](crate#references): rationality, myopia, mistakes, skipping and equality.

use rand::{Rng, RngExt as _};
use serde::{Deserialize, Serialize};

use super::perception::Perception;
use crate::query::{
    Active, Justification, Justifications, Preference, Protocol, Response, SafetyAnswer, SkipReason, Verdict,
};

/// How well an annotator answers: the parameters of B-Pref, and one for safety.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Annotator {
    /// β: rationality, per unit of progress of difference. Nothing means perfect, 0 a coin.
    pub beta: Option<f32>,
    /// γ: what a step counts against the next, in `(0, 1]`. Below 1 the end of a clip impresses more.
    pub gamma: f32,
    /// Probability of saying the opposite preference.
    pub eps_mistake: f64,
    /// A query is skipped where a clip [jumps](Perception::jumpiness) more than this. Nothing means that none is.
    pub eps_skip: Option<f32>,
    /// What a step at the very edge of what is unsafe costs, in the unit of progress: whoever is there is about to go too
    /// far. It counts where that can be [seen beforehand](Perception::nearness): for the built-in cars.
    pub care: f32,
    /// Clips are equal where they differ by less than this, in the unit of [progress](Perception).
    pub eps_equal: f32,
    /// Probability of mistaking a safe clip for an unsafe one, or an unsafe one for a safe one.
    pub eps_safety: f64,
}

impl Annotator {
    /// Makes no mistake, keeps away from the edge, and differences below a third of a unit of progress escape it: of a
    /// tile, or of what clips usually differ by.
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
        if self.eps_skip.is_some_and(|most| left.jumpiness().max(right.jumpiness()) > most) {
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

    /// What is said of the transition to the last picture, after watching those before it: unsafe where a safety event goes
    /// on, good where it gets on.
    ///
    /// Who makes more progress than is usual gets on, or is seen to reach what counts as some; a built-in car that makes way
    /// along its road.
    pub fn verdict(&self, seen: &Perception, rng: &mut impl Rng) -> Response {
        // Always the same draws, so that one parameter leaves the chance of the others alone.
        let (is_mistaken, misjudges) = (rng.random_bool(self.eps_mistake), rng.random_bool(self.eps_safety));
        let Some(last) = seen.last_step() else {
            return Response::Skipped(Some(SkipReason::Other));
        };
        if self.eps_skip.is_some_and(|most| seen.jumpiness() > most) {
            return Response::Skipped(Some(SkipReason::Hallucinated));
        }
        Response::Judged(match last.is_unsafe != misjudges {
            true => Verdict::Unsafe,
            false if last.gets_on != is_mistaken => Verdict::Good,
            false => Verdict::Neutral,
        })
    }

    /// Which of two worths, in the unit of progress, is preferred.
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
    // All that are shown so, for one preference each: they are active together.
    let active = |wanted: [bool; 2]| {
        let these = shown.iter().filter(|(it, shown)| *it != default && *shown == wanted).map(|(it, _)| *it);
        these.fold(None, |all: Option<Active>, it| Some(all.map_or(Active::of(it), |all| all.with(it))))
    };
    let [left, right, both] = [[false, true], [true, false], [true, true]].map(active);
    let apart = [(left, Preference::Left), (right, Preference::Right)];
    let decides = apart.into_iter().filter_map(|(active, side)| Some((active?, side)));
    match (decides.min_by_key(|(active, _)| active.most_severe()), both) {
        (Some((active, side)), _) => Response::Justified(active, side),
        (None, Some(active)) => Response::Justified(active, Preference::Equal),
        (None, None) => Response::Justified(default.into(), otherwise()),
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
    use crate::query::Weights;
    use crate::simulate::perception::made_up::{of_arm, of_sights};
    use crate::world::cars::Sight;

    /// A clip at a steady speed in units a second, with its first `n_off` pictures off the road.
    fn clip(speed: f32, n_off: usize) -> Perception {
        let sight = |i| Sight {
            off_road: if i < n_off { 0.9 } else { 0.1 },
            road_velocity: [speed, 0.0],
            ..Sight::default()
        };
        of_sights(&(0..20).map(sight).collect::<Vec<_>>())
    }

    fn answers(annotator: Annotator, protocol: Protocol, clips: [&Perception; 2]) -> Vec<Response> {
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let justifications = Weights::paper().justifications;
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
            of_sights(&[sight; 20])
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
        let answer = |left: &Perception, right: &Perception| {
            let rng = &mut ChaCha8Rng::seed_from_u64(0);
            Annotator::careful().answer(Protocol::DropjMulti, &all, left, right, rng)
        };
        let clip = |speed, off_road, chuckhole| {
            let sight = Sight { off_road, chuckhole, road_velocity: [speed, 0.0], ..Sight::default() };
            of_sights(&[sight; 20])
        };
        let [fast, slow, off] = [clip(40.0, 0.1, 0.1), clip(20.0, 0.1, 0.1), clip(40.0, 0.9, 0.1)];
        let bumpy = |speed, off_road| clip(speed, off_road, 0.9);

        assert_eq!(answer(&bumpy(40.0, 0.1), &off), Response::Justified(chuckhole.into(), Preference::Right));
        assert_eq!(
            answer(&bumpy(40.0, 0.1), &bumpy(40.0, 0.9)),
            Response::Justified(grass.into(), Preference::Left)
        );
        let both = [bumpy(40.0, 0.1), bumpy(20.0, 0.1)];
        assert_eq!(answer(&both[0], &both[1]), Response::Justified(chuckhole.into(), Preference::Equal));
        assert_eq!(answer(&fast, &slow), Response::Justified(all.default().into(), Preference::Left));
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
        let mut jumping = clip(20.0, 0);
        jumping.jumps = vec![2.0; 20];
        let clips = [&jumping, &clip(40.0, 0)];
        let patient = Annotator { eps_skip: None, ..Annotator::careful() };

        let skipped = Response::Skipped(Some(SkipReason::Hallucinated));
        assert_eq!(answer(Annotator::careful(), Protocol::Dropj, clips), skipped);
        assert_ne!(answer(patient, Protocol::Dropj, clips), skipped);
    }

    #[test]
    fn a_verdict_is_of_the_last_picture() {
        let sight = |off_road, speed| Sight { off_road, road_velocity: [speed, 0.0], ..Sight::default() };
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let mut of = |sights: &[Sight]| Annotator::careful().verdict(&of_sights(sights), rng);
        let [fast, slow, off] = [sight(0.1, 35.0), sight(0.1, 5.0), sight(0.9, 35.0)];
        assert_eq!(of(&[off, off, fast]), Response::Judged(Verdict::Good));
        assert_eq!(of(&[off, off, slow]), Response::Judged(Verdict::Neutral));
        assert_eq!(of(&[fast, fast, off]), Response::Judged(Verdict::Unsafe));
        let jumpy = [Sight { lateral: -4.0, ..fast }, Sight { lateral: 4.0, ..fast }];
        assert_eq!(of(&jumpy), Response::Skipped(Some(SkipReason::Hallucinated)));
        assert_eq!(of(&[]), Response::Skipped(Some(SkipReason::Other)));
    }

    #[test]
    fn in_any_world_safety_and_progress_decide_as_its_file_says() {
        let [no, yes] = [vec![0.1; 20], vec![0.9; 20]];
        let clip = |drop: &Vec<f32>, lean: &Vec<f32>, progress| {
            of_arm(true, [drop.clone(), lean.clone(), no.clone()], vec![progress; 20])
        };
        let careful = Annotator::careful();
        let [usual, better, leaning, dropping] =
            [clip(&no, &no, 0.0), clip(&no, &no, 0.1), clip(&no, &yes, 0.1), clip(&yes, &no, 0.1)];
        let both = |preference| Response::Safety(SafetyAnswer::Both(preference));
        assert_eq!(answer(careful, Protocol::Dropj, [&usual, &better]), both(Preference::Right));
        assert_eq!(answer(careful, Protocol::Dropj, [&leaning, &usual]), both(Preference::Left));
        let only_left = Response::Safety(SafetyAnswer::OnlyLeft);
        assert_eq!(answer(careful, Protocol::Dropj, [&usual, &dropping]), only_left);
        let right = Response::Preferred(Preference::Right);
        assert_eq!(answer(careful, Protocol::Drop, [&leaning, &usual]), right, "unsafe steps cost");
        let named = Justifications::new([("careless", 1.0), ("default", 0.75)]).unwrap();
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let said = careful.answer(Protocol::DropjMulti, &named, &dropping, &better, rng);
        assert_eq!(said, Response::Justified(named.named("careless").unwrap().into(), Preference::Right));
        let mut verdict = |clip: &Perception| careful.verdict(clip, rng);
        assert_eq!(verdict(&better), Response::Judged(Verdict::Good));
        assert_eq!(verdict(&clip(&no, &no, -0.1)), Response::Judged(Verdict::Neutral));
        assert_eq!(verdict(&leaning), Response::Judged(Verdict::Unsafe));
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
