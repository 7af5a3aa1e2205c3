//! What the paper measures in an episode, and its mean over several (method §12).

use serde::{Deserialize, Serialize};

use crate::env::{End, Outcome};

/// How well an episode went.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct EpisodeMetrics {
    /// The sum of rewards. Some 2800 is the best that was ever driven in Car Racing.
    pub ret: f32,
    /// The share of steps that entered a new tile (success).
    pub new_tile_rate: f32,
    /// The share of steps off the road, of the steps that there were.
    pub grass_rate: f32,
    /// Chuckholes touched, of those that came within 20 units. Nothing where none came.
    pub chuckhole_rate: Option<f32>,
    /// Cars hit, of those that came within 20 units. Nothing where none came.
    pub car_rate: Option<f32>,
    /// How long it was.
    pub n_steps: usize,
    /// Whether it lasted its time: the car never left the field.
    pub finished: bool,
    /// How long a step took that made a plan, on average, in milliseconds.
    pub plan_ms_mean: Option<f32>,
    /// The longest of them.
    pub plan_ms_max: Option<f32>,
}

/// The counts from which [`EpisodeMetrics`] come.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    ret: f32,
    n_steps: usize,
    n_new_tiles: usize,
    n_grass: usize,
    /// Steps with a contact, and steps that passed one, as the authors count them.
    chuckholes: [usize; 2],
    cars: [usize; 2],
    finished: bool,
    plan_secs: Vec<f64>,
}

impl Tally {
    /// Counts a step, which planned for so many seconds if it did.
    pub fn add(&mut self, outcome: &Outcome, plan_secs: Option<f64>) {
        let events = outcome.events;
        self.ret += outcome.reward;
        self.n_steps += 1;
        self.n_new_tiles += usize::from(events.new_tile);
        self.n_grass += usize::from(events.grass);
        for (count, flags) in [
            (&mut self.chuckholes, [events.chuckhole, events.chuckhole_passed]),
            (&mut self.cars, [events.car, events.car_passed]),
        ] {
            count[0] += usize::from(flags[0]);
            count[1] += usize::from(flags[1]);
        }
        self.finished |= outcome.end == Some(End::TimeLimit);
        self.plan_secs.extend(plan_secs);
    }

    /// What was counted so far.
    pub fn metrics(&self) -> EpisodeMetrics {
        // DIFFERENCE: the paper divides by the longest episode there may be, the authors' code by this one's length.
        // We follow the code (method §14.21). The authors' rates of nothing are NaN. Ours are absent (§14.23).
        let share = |n: usize, of: usize| (of > 0).then(|| n as f32 / of as f32);
        let of_steps = |n| share(n, self.n_steps).unwrap_or(0.0);
        let n_plans = self.plan_secs.len();
        let plan_secs = self.plan_secs.iter().sum::<f64>();
        let longest = self.plan_secs.iter().copied().reduce(f64::max);
        EpisodeMetrics {
            ret: self.ret,
            new_tile_rate: of_steps(self.n_new_tiles),
            grass_rate: of_steps(self.n_grass),
            chuckhole_rate: share(self.chuckholes[0], self.chuckholes[1]),
            car_rate: share(self.cars[0], self.cars[1]),
            n_steps: self.n_steps,
            finished: self.finished,
            plan_ms_mean: (n_plans > 0).then(|| (1e3 * plan_secs / n_plans as f64) as f32),
            plan_ms_max: longest.map(|secs| (1e3 * secs) as f32),
        }
    }
}

/// A mean and the population's standard deviation, as the paper reports them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeanSd {
    /// The mean.
    pub mean: f64,
    /// The root of the mean squared distance from it.
    pub sd: f64,
    /// Of how many values.
    pub n: usize,
}

impl MeanSd {
    /// Of all `values` that are there and are finite numbers. Nothing where none is.
    pub fn of(values: impl IntoIterator<Item = Option<f32>>) -> Option<Self> {
        let values: Vec<f64> =
            values.into_iter().flatten().filter(|value| value.is_finite()).map(f64::from).collect();
        if values.is_empty() {
            return None;
        }
        let n = values.len();
        let mean = values.iter().sum::<f64>() / n as f64;
        let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / n as f64;
        Some(Self { mean, sd: variance.sqrt(), n })
    }
}

/// Several episodes together. Each is absent where no episode has it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// How many episodes.
    pub n_episodes: usize,
    /// Of [`EpisodeMetrics::ret`].
    pub ret: Option<MeanSd>,
    /// Of [`EpisodeMetrics::new_tile_rate`].
    pub new_tile_rate: Option<MeanSd>,
    /// Of [`EpisodeMetrics::grass_rate`].
    pub grass_rate: Option<MeanSd>,
    /// Of [`EpisodeMetrics::chuckhole_rate`]: the mean of the episodes' ratios, not the ratio of the sums.
    pub chuckhole_rate: Option<MeanSd>,
    /// Of [`EpisodeMetrics::car_rate`], likewise.
    pub car_rate: Option<MeanSd>,
    /// Of [`EpisodeMetrics::n_steps`].
    pub n_steps: Option<MeanSd>,
    /// Of [`EpisodeMetrics::plan_ms_mean`].
    pub plan_ms: Option<MeanSd>,
}

impl Summary {
    /// Of `episodes`.
    pub fn of(episodes: &[EpisodeMetrics]) -> Self {
        let over = |value: fn(&EpisodeMetrics) -> Option<f32>| MeanSd::of(episodes.iter().map(value));
        Self {
            n_episodes: episodes.len(),
            ret: over(|e| Some(e.ret)),
            new_tile_rate: over(|e| Some(e.new_tile_rate)),
            grass_rate: over(|e| Some(e.grass_rate)),
            chuckhole_rate: over(|e| e.chuckhole_rate),
            car_rate: over(|e| e.car_rate),
            n_steps: over(|e| Some(e.n_steps as f32)),
            plan_ms: over(|e| e.plan_ms_mean),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::Events;

    #[test]
    fn a_standard_deviation_is_the_populations_and_leaves_out_what_is_not_there() {
        let spread = MeanSd::of([Some(1.0), None, Some(3.0), Some(f32::NAN)]);
        assert_eq!(spread, Some(MeanSd { mean: 2.0, sd: 1.0, n: 2 }));
        assert_eq!(MeanSd::of([None, Some(f32::NAN)]), None);
    }

    #[test]
    fn a_rate_of_chuckholes_is_of_those_that_came_near() {
        let mut tally = Tally::default();
        let step = |chuckhole, chuckhole_passed| Outcome {
            events: Events { chuckhole, chuckhole_passed, ..Events::default() },
            ..Outcome::default()
        };
        for (touched, passed) in [(false, true), (true, true), (false, true), (false, true), (false, false)] {
            tally.add(&step(touched, passed), None);
        }
        let metrics = tally.metrics();
        assert_eq!((metrics.chuckhole_rate, metrics.car_rate), (Some(0.25), None));
    }

    #[test]
    fn episodes_without_chuckholes_do_not_count_in_their_rate() {
        let episode = |chuckhole_rate| EpisodeMetrics { chuckhole_rate, ..Tally::default().metrics() };
        let summary = Summary::of(&[episode(Some(0.5)), episode(None)]);
        assert_eq!(summary.chuckhole_rate.map(|rate| (rate.mean, rate.n)), Some((0.5, 1)));
        assert_eq!(summary.n_episodes, 2);
    }
}
