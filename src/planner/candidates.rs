//! The courses of action that the planner chooses among (method §11).

use std::sync::Arc;

use rand::{Rng, RngExt as _};

use super::snippets::Snippets;
use crate::planner::PlannerConfig;
use crate::world::{Action, ActionRanges, CandidateSource, Part, WorldSpec};

/// How many candidates are made from recordings where the world's file does not say.
const FROM_RECORDINGS: usize = 24;
/// The axes that are combined where there is nothing else to make candidates of; all others stay neutral.
const COMBINED_AXES: usize = 6;

/// What candidates are made of.
#[derive(Clone, Debug, PartialEq)]
pub struct CandidateSet {
    /// Actions that are kept to throughout.
    constant: Vec<Action>,
    /// Actions that others follow, each with its probability to come second.
    stages: Vec<(Action, f64)>,
    /// Courses of action as the world's file gives them, which the authors' planner does not try.
    given: Arc<[Vec<Action>]>,
    /// Courses of action as they were recorded.
    whole: Arc<[Vec<Action>]>,
}

impl CandidateSet {
    /// That of a world's file; where it says that they come from recordings, those of `snippets`, or without any a spread
    /// over the axes.
    pub fn of(spec: &WorldSpec, snippets: Option<&Snippets>) -> Self {
        let candidates = &spec.planner.candidates;
        match (candidates.from, snippets) {
            (CandidateSource::File, _) => Self {
                constant: candidates.constant.iter().map(Action::new).collect(),
                stages: candidates.stages.iter().map(|it| (Action::new(&it.action), it.follows)).collect(),
                given: candidates.courses.iter().map(|parts| course(parts)).collect(),
                whole: Arc::default(),
            },
            (CandidateSource::Recordings, Some(snippets)) => {
                let count = candidates.count.unwrap_or(FROM_RECORDINGS);
                let whole = snippets.clustered(count, spec);
                let constant = vec![Action::new(spec.neutral())];
                Self { constant, stages: Vec::new(), given: Arc::default(), whole: whole.into() }
            }
            (CandidateSource::Recordings, None) => Self::over_axes(spec),
        }
    }

    /// Each axis at its ends and halfway to them, alone and two together, kept to or followed by another.
    fn over_axes(spec: &WorldSpec) -> Self {
        let neutral = Action::new(spec.neutral());
        let axes = &spec.axes[..spec.axes.len().min(COMBINED_AXES)];
        let moved = |from: &Action, i: usize, share: f32| {
            let (axis, mut action) = (&axes[i], *from);
            let end = if share < 0.0 { axis.low } else { axis.high };
            action[i] = axis.neutral + share.abs() * (end - axis.neutral);
            action
        };
        let mut constant = vec![neutral];
        let shares = [-1.0, -0.5, 0.5, 1.0];
        for i in 0..axes.len() {
            let alone: Vec<_> = shares.iter().map(|share| moved(&neutral, i, *share)).collect();
            for one in &alone {
                constant.push(*one);
                constant
                    .extend((i + 1..axes.len()).flat_map(|j| [-0.5, 0.5].map(|share| moved(one, j, share))));
            }
        }
        let mut distinct: Vec<Action> = Vec::new();
        for action in constant {
            if !distinct.contains(&action) {
                distinct.push(action);
            }
        }
        let share = 1.0 / distinct.len() as f64;
        Self {
            stages: distinct.iter().map(|action| (*action, share)).collect(),
            constant: distinct,
            given: Arc::default(),
            whole: Arc::default(),
        }
    }

    /// S: how many candidates it makes.
    pub fn len(&self) -> usize {
        self.constant.len() + self.stages.len() + self.given.len() + self.whole.len()
    }

    /// Whether it makes none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The candidates of `horizon` steps each: the constant ones, then one for each first stage, then those that
    /// are given whole.
    ///
    /// A first stage lasts n ~ U{1 … H − 1} steps. The second is drawn from the same list for the rest.
    /// The generator gives n and then the second stage, candidate by candidate.
    /// `// DIFFERENCE:` the paper counts braking among the predefined sequences. In the authors' code nobody brakes throughout
    /// (method §14.10), and we follow the code.
    pub fn draw(&self, horizon: usize, rng: &mut impl Rng) -> Vec<Vec<Action>> {
        let constant = self.constant.iter().map(|action| vec![*action; horizon]);
        let staged: Vec<Vec<Action>> = self
            .stages
            .iter()
            .map(|(first, _)| {
                let n = rng.random_range(1..horizon.max(2));
                let (second, _) = self.stages[self.second_stage(rng.random())];
                (0..horizon).map(|t| if t < n { *first } else { second }).collect()
            })
            .collect();
        let whole = self.given.iter().chain(&*self.whole).map(|actions| lasting(actions, horizon));
        constant.chain(staged).chain(whole).collect()
    }

    /// The stage in whose share of `[0, 1)` `u` lies.
    fn second_stage(&self, u: f64) -> usize {
        let mut below = 0.0;
        let at = self.stages.iter().position(|(_, p)| {
            below += p;
            u < below
        });
        at.unwrap_or(self.stages.len() - 1) // rounding
    }

    /// The same without those that the world's file gives whole.
    pub(super) fn without_given(mut self) -> Self {
        self.given = Arc::default();
        self
    }

    /// The same with `strength` as the third number of every stage in which it is not 0: how hard cars brake.
    pub(super) fn braking(mut self, strength: f32) -> Self {
        for (action, _) in &mut self.stages {
            if let Some(brake) = action.get_mut(2).filter(|brake| **brake > 0.0) {
                *brake = strength;
            }
        }
        self
    }
}

impl Default for CandidateSet {
    /// The authors'.
    fn default() -> Self {
        Self::of(&WorldSpec::built_in("car-racing").unwrap_or_else(|| unreachable!("it is built in")), None)
    }
}

/// A course of action in parts, each as long as it lasts.
fn course(parts: &[Part]) -> Vec<Action> {
    let each = parts.iter().map(|part| (Action::new(&part.action), part.steps));
    each.flat_map(|(action, steps)| std::iter::repeat_n(action, steps)).collect()
}

/// The candidates of `config`.
pub fn candidates(config: &PlannerConfig, rng: &mut impl Rng) -> Vec<Vec<Action>> {
    let mut all = config.candidates.clone();
    if let Some(strength) = config.brake {
        all = all.braking(strength);
    }
    if !config.courses {
        all = all.without_given();
    }
    all.draw(config.horizon, rng)
}

/// `actions` cut to `horizon` steps, or the last of them for as long as it takes.
pub(super) fn lasting(actions: &[Action], horizon: usize) -> Vec<Action> {
    let last = actions.last().copied().unwrap_or_else(|| Action::new([]));
    (0..horizon).map(|t| actions.get(t).copied().unwrap_or(last)).collect()
}

/// How a plan is refined once its candidates were looked at: by the cross-entropy method.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Refinement {
    /// How often.
    pub rounds: usize,
    /// Courses of action that are tried in a round.
    pub samples: usize,
    /// The best of all so far, around whose mean the next are drawn.
    pub elites: usize,
    /// The least standard deviation of a number of an action, as a share of its range.
    pub noise: f32,
}

impl Default for Refinement {
    fn default() -> Self {
        Self { rounds: 2, samples: 24, elites: 6, noise: 0.1 }
    }
}

impl Refinement {
    /// Courses of action around the mean of `elites`, which are equally long.
    pub(super) fn draw(
        &self,
        elites: &[&[Action]],
        ranges: &ActionRanges,
        rng: &mut impl Rng,
    ) -> Vec<Vec<Action>> {
        use rand_distr::{Distribution as _, StandardNormal};
        /// So much of what was drawn for a step is kept in the next: nobody trembles.
        const KEPT: f32 = 0.8;
        let horizon = elites.first().map_or(0, |elite| elite.len());
        let n = elites.len().max(1) as f32;
        let widths: Vec<f32> = ranges.iter().map(|[low, high]| high - low).collect();
        let at = |t: usize| {
            let mean = elites[0][t].map(|i, _| elites.iter().map(|elite| elite[t][i]).sum::<f32>() / n);
            let sd = mean.map(|i, mean| {
                let variance = elites.iter().map(|elite| (elite[t][i] - mean).powi(2)).sum::<f32>() / n;
                variance.sqrt().max(self.noise * widths[i])
            });
            (mean, sd)
        };
        let spread: Vec<_> = (0..horizon).map(at).collect();
        let fresh = (1.0 - KEPT * KEPT).sqrt();
        (0..self.samples)
            .map(|_| {
                let mut drawn = vec![0.0f32; ranges.n_axes()];
                let course = spread.iter().enumerate().map(|(t, (mean, sd))| {
                    for value in &mut drawn {
                        let new: f32 = StandardNormal.sample(rng);
                        *value = if t == 0 { new } else { KEPT * *value + fresh * new };
                    }
                    ranges.clamped(&mean.map(|i, mean| mean + sd[i] * drawn[i]))
                });
                course.collect()
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn six_candidates_keep_to_one_action_and_nine_change_it_once() {
        let all = candidates(&PlannerConfig::paper(), &mut ChaCha8Rng::seed_from_u64(0));
        assert_eq!(all.len(), 15);
        let firsts: Vec<_> = all.iter().map(|actions| actions[0]).collect();
        assert_eq!(firsts[..2], [Action::new([0.0, 0.2, 0.0]), Action::new([-1.0, 0.1, 0.0])]);
        assert_eq!(firsts[6..8], [Action::new([0.0, 0.1, 0.0]), Action::new([0.0, 0.2, 0.0])]);
        assert_eq!(firsts[14], Action::new([0.0, 0.1, 0.2]));
        for (i, actions) in all.iter().enumerate() {
            let n_changes = actions.windows(2).filter(|pair| pair[0] != pair[1]).count();
            assert!(n_changes <= usize::from(i >= 6), "candidate {i} changes {n_changes} times");
        }
    }

    #[test]
    fn courses_are_as_the_file_gives_them_and_the_authors_planner_has_none() {
        let mut spec = WorldSpec::default();
        let part = |steer: f32, steps: usize| Part { action: vec![steer, 0.1, 0.0], steps };
        spec.planner.candidates.courses = vec![vec![part(-1.0, 3), part(1.0, 2), part(0.0, 1)]];
        let config = PlannerConfig { horizon: 9, ..PlannerConfig::of(&spec, None) };
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let all = candidates(&config, rng);
        assert_eq!((all.len(), config.candidates.len()), (16, 16));
        let steers: Vec<f32> = all[15].iter().map(|action| action[0]).collect();
        assert_eq!(
            steers,
            [-1.0, -1.0, -1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0],
            "the last part lasts to the end"
        );
        let short = candidates(&PlannerConfig { horizon: 2, ..config.clone() }, rng);
        assert_eq!(short[15], [Action::new([-1.0, 0.1, 0.0]); 2]);
        assert_eq!(candidates(&config.authors(&spec), rng).len(), 15);
    }

    #[test]
    fn the_shares_of_the_second_stages_are_the_papers() {
        let set = CandidateSet::default();
        assert!((set.stages.iter().map(|(_, p)| p).sum::<f64>() - 1.0).abs() < 1e-12);
        assert_eq!([0.0, 0.12, 0.14, 0.5, 0.8, 0.9999].map(|u| set.second_stage(u)), [0, 0, 1, 2, 3, 8]);
    }

    #[test]
    fn the_last_step_is_always_of_the_second_stage() {
        let config = PlannerConfig { horizon: 2, ..PlannerConfig::car_racing() };
        let all = candidates(&config, &mut ChaCha8Rng::seed_from_u64(0));
        // Seven draws of nine differ from their first stage here; with n = H none would.
        assert!(all[6..].iter().any(|actions| actions[0] != actions[1]));
    }

    #[test]
    fn a_world_without_recordings_has_candidates_over_its_axes() {
        let spec = |axes: &str| {
            let text = format!(
                "format = 1\nname = \"arm\"\ntitle = \"Arm\"\nrate = 10\nlongest_episode = 100\n\
                 source = {{ kind = \"recordings\" }}\nimage = {{ height = 60, width = 80 }}\naxes = [{axes}]"
            );
            text.parse::<WorldSpec>().unwrap()
        };
        let one = spec(r#"{ name = "reach", low = 0.0, high = 512.0, neutral = 256.0 }"#);
        let all = CandidateSet::of(&one, None).draw(5, &mut ChaCha8Rng::seed_from_u64(0));
        assert_eq!(all[0], vec![Action::new([256.0]); 5]);
        assert!(all.iter().flatten().all(|action| (0.0..=512.0).contains(&action[0])));
        assert!(all.contains(&vec![Action::new([512.0]); 5]) && all.contains(&vec![Action::new([128.0]); 5]));
        // An axis that rests at its end has no other side.
        let two = spec(
            r#"{ name = "gas", low = 0.0, high = 1.0, neutral = 0.0 }, { name = "turn", low = -1.0, high = 1.0, neutral = 0.0 }"#,
        );
        assert!(CandidateSet::of(&two, None).len() < 64);
    }

    proptest! {
        #[test]
        fn candidates_are_as_long_as_the_horizon(horizon in 1usize..40, seed: u64) {
            let config = PlannerConfig { horizon, ..PlannerConfig::car_racing() };
            for actions in candidates(&config, &mut ChaCha8Rng::seed_from_u64(seed)) {
                prop_assert_eq!(actions.len(), horizon);
            }
        }

        #[test]
        fn refined_courses_stay_in_their_ranges(seed: u64, spread in 0.0f32..1.0) {
            let ranges = ActionRanges::default();
            let courses = [vec![Action::new([-spread, 0.0, 0.0]); 4], vec![Action::new([spread, 1.0, 0.5]); 4]];
            let elites: Vec<_> = courses.iter().map(Vec::as_slice).collect();
            let drawn = Refinement::default().draw(&elites, &ranges, &mut ChaCha8Rng::seed_from_u64(seed));
            for action in drawn.iter().flatten() {
                for (value, [low, high]) in action.iter().zip(ranges.iter()) {
                    prop_assert!((low..=high).contains(value));
                }
            }
        }
    }
}
