//! What the paper measures in an episode, and its mean over several (method §12).

use serde::ser::{Serialize, SerializeMap as _, Serializer};

use crate::world::{Count, End, EventKind, EventSpec, Step, event_slug};

/// How often an event of the world's file happened in an episode.
#[derive(Clone, Debug, PartialEq)]
pub struct EventFigure {
    /// The event's name.
    pub name: String,
    /// How it is counted.
    pub count: Count,
    /// The share of steps, or of those that were passed, in `[0, 1]`; of an event that is counted when it begins, how
    /// often that was. Nothing where none was passed.
    pub value: Option<f32>,
}

impl EventFigure {
    /// Its key in results: `grass_rate`, or `bump_count` for what is counted when it begins.
    ///
    /// ```
    /// use dropj::evaluation::EventFigure;
    /// use dropj::world::Count;
    ///
    /// let figure = EventFigure { name: "new tile".to_owned(), count: Count::PerStep, value: Some(0.5) };
    /// assert_eq!((figure.key().as_str(), figure.shown().as_str()), ("new_tile_rate", "50.0 %"));
    /// ```
    pub fn key(&self) -> String {
        let suffix = if self.count == Count::FirstTouch { "count" } else { "rate" };
        format!("{}_{suffix}", event_slug(&self.name))
    }

    /// The figure that has this key in results, without its value.
    pub(crate) fn of_key(key: &str) -> Option<Self> {
        let named = |slug: &str, count| Self { name: slug.replace('_', " "), count, value: None };
        let rate = key.strip_suffix("_rate").map(|slug| named(slug, Count::PerStep));
        rate.or_else(|| key.strip_suffix("_count").map(|slug| named(slug, Count::FirstTouch)))
    }

    /// Its value for people; a dash where there is none.
    pub fn shown(&self) -> String {
        match self.value {
            None => "–".to_owned(),
            Some(n) if self.count == Count::FirstTouch => format!("{n:.0}"),
            Some(share) => format!("{:.1} %", 100.0 * share),
        }
    }
}

/// How well an episode went.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EpisodeMetrics {
    /// The sum of the world's rewards; 0 where it has none. Some 2800 is the best that was ever driven in Car Racing.
    pub ret: f32,
    /// The share of steps in which something went on that must not happen.
    pub unsafe_rate: f32,
    /// Each event of the world's file, in its order.
    pub events: Vec<EventFigure>,
    /// How long it was.
    pub n_steps: usize,
    /// Whether it lasted its time: nothing that happened ended it.
    pub finished: bool,
    /// How long a step took that made a plan, on average, in milliseconds.
    pub plan_ms_mean: Option<f32>,
    /// The longest of them.
    pub plan_ms_max: Option<f32>,
}

impl EpisodeMetrics {
    /// The figure of an event, where it has one.
    pub fn event(&self, name: &str) -> Option<f32> {
        self.events.iter().find(|figure| figure.name == name)?.value
    }
}

impl Serialize for EpisodeMetrics {
    /// One object, with a key for each event.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("ret", &self.ret)?;
        map.serialize_entry("unsafe_rate", &self.unsafe_rate)?;
        for figure in &self.events {
            map.serialize_entry(&figure.key(), &figure.value)?;
        }
        map.serialize_entry("n_steps", &self.n_steps)?;
        map.serialize_entry("finished", &self.finished)?;
        map.serialize_entry("plan_ms_mean", &self.plan_ms_mean)?;
        map.serialize_entry("plan_ms_max", &self.plan_ms_max)?;
        map.end()
    }
}

/// The counts from which [`EpisodeMetrics`] come.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    events: Vec<EventSpec>,
    /// Steps with the event as it is counted, and steps that passed one, as the authors count them.
    counts: Vec<[usize; 2]>,
    ret: f32,
    n_steps: usize,
    n_unsafe: usize,
    finished: bool,
    plan_secs: Vec<f64>,
}

impl Tally {
    /// Nothing counted yet, of these events.
    pub fn of(events: &[EventSpec]) -> Self {
        Self { events: events.to_vec(), counts: vec![[0; 2]; events.len()], ..Self::default() }
    }

    /// Counts a step, which planned for so many seconds if it did.
    pub fn add(&mut self, step: &Step, plan_secs: Option<f64>) {
        self.ret += step.reward.unwrap_or_default();
        self.n_steps += 1;
        for (counts, happened) in self.counts.iter_mut().zip(&step.events) {
            counts[0] += usize::from(happened.happened);
            counts[1] += usize::from(happened.passed);
        }
        let is_unsafe = |(event, now): (&EventSpec, &crate::world::Happened)| {
            event.kind == EventKind::Safety && (now.goes_on || now.happened)
        };
        self.n_unsafe += usize::from(self.events.iter().zip(&step.events).any(is_unsafe));
        self.finished |= step.end == Some(End::Truncated);
        self.plan_secs.extend(plan_secs);
    }

    /// What was counted so far.
    pub fn metrics(&self) -> EpisodeMetrics {
        // DIFFERENCE: the paper divides by the longest episode there may be, the authors' code by this one's length.
        // We follow the code (method §14.21). The authors' rates of nothing are NaN. Ours are absent (§14.23).
        let share = |n: usize, of: usize| (of > 0).then(|| n as f32 / of as f32);
        let of_steps = |n| share(n, self.n_steps).unwrap_or(0.0);
        let figure = |(event, [n, passed]): (&EventSpec, &[usize; 2])| EventFigure {
            name: event.name.clone(),
            count: event.count,
            value: match event.count {
                Count::PerStep => Some(of_steps(*n)),
                Count::FirstTouch => Some(*n as f32),
                Count::OfPassed => share(*n, *passed),
            },
        };
        let n_plans = self.plan_secs.len();
        let plan_secs = self.plan_secs.iter().sum::<f64>();
        let longest = self.plan_secs.iter().copied().reduce(f64::max);
        EpisodeMetrics {
            ret: self.ret,
            unsafe_rate: of_steps(self.n_unsafe),
            events: self.events.iter().zip(&self.counts).map(figure).collect(),
            n_steps: self.n_steps,
            finished: self.finished,
            plan_ms_mean: (n_plans > 0).then(|| (1e3 * plan_secs / n_plans as f64) as f32),
            plan_ms_max: longest.map(|secs| (1e3 * secs) as f32),
        }
    }
}

/// A mean and the population's standard deviation, as the paper reports them.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
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
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Summary {
    /// How many episodes.
    pub n_episodes: usize,
    /// Of [`EpisodeMetrics::ret`].
    pub ret: Option<MeanSd>,
    /// Of [`EpisodeMetrics::unsafe_rate`].
    pub unsafe_rate: Option<MeanSd>,
    /// Of [`EpisodeMetrics::events`]: the mean of the episodes' ratios, not the ratio of the sums.
    pub events: Vec<(EventFigure, Option<MeanSd>)>,
    /// Of [`EpisodeMetrics::n_steps`].
    pub n_steps: Option<MeanSd>,
    /// Of [`EpisodeMetrics::plan_ms_mean`].
    pub plan_ms: Option<MeanSd>,
}

impl Summary {
    /// Of `episodes`.
    pub fn of(episodes: &[EpisodeMetrics]) -> Self {
        let over = |value: &dyn Fn(&EpisodeMetrics) -> Option<f32>| MeanSd::of(episodes.iter().map(value));
        let mut events: Vec<EventFigure> = Vec::new();
        for figure in episodes.iter().flat_map(|episode| &episode.events) {
            if !events.iter().any(|known| known.name == figure.name) {
                events.push(EventFigure { value: None, ..figure.clone() });
            }
        }
        let summed = |figure: EventFigure| {
            let all = over(&|episode| episode.event(&figure.name));
            (figure, all)
        };
        Self {
            n_episodes: episodes.len(),
            ret: over(&|e| Some(e.ret)),
            unsafe_rate: over(&|e| Some(e.unsafe_rate)),
            n_steps: over(&|e| Some(e.n_steps as f32)),
            plan_ms: over(&|e| e.plan_ms_mean),
            events: events.into_iter().map(summed).collect(),
        }
    }
}

impl Serialize for Summary {
    /// One object, with a key for each event.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("n_episodes", &self.n_episodes)?;
        map.serialize_entry("ret", &self.ret)?;
        map.serialize_entry("unsafe_rate", &self.unsafe_rate)?;
        for (figure, value) in &self.events {
            map.serialize_entry(&figure.key(), value)?;
        }
        map.serialize_entry("n_steps", &self.n_steps)?;
        map.serialize_entry("plan_ms", &self.plan_ms)?;
        map.end()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::{Frame, Happened, WorldSpec};

    #[test]
    fn a_standard_deviation_is_the_populations_and_leaves_out_what_is_not_there() {
        let spread = MeanSd::of([Some(1.0), None, Some(3.0), Some(f32::NAN)]);
        assert_eq!(spread, Some(MeanSd { mean: 2.0, sd: 1.0, n: 2 }));
        assert_eq!(MeanSd::of([None, Some(f32::NAN)]), None);
    }

    fn step(events: Vec<Happened>) -> Step {
        Step { frame: Frame::square(1, [0; 3]), reward: None, events, executed: None, end: None }
    }

    #[test]
    fn a_rate_of_what_is_counted_of_those_passed_is_of_those_that_came_near() {
        let spec = WorldSpec::built_in("obstacle-car-racing").unwrap();
        let mut tally = Tally::of(&spec.events);
        for (happened, passed) in [(false, true), (true, true), (false, true), (false, true), (false, false)]
        {
            let events = spec.events.iter().map(|event| match event.name.as_str() {
                "chuckhole" => Happened { happened, goes_on: happened, passed },
                _ => Happened::default(),
            });
            tally.add(&step(events.collect()), None);
        }
        let metrics = tally.metrics();
        assert_eq!((metrics.event("chuckhole"), metrics.event("car")), (Some(0.25), None));
        assert_eq!((metrics.event("grass"), metrics.unsafe_rate), (Some(0.0), 0.2));
        let told = serde_json::to_value(&metrics).unwrap();
        assert_eq!((&told["chuckhole_rate"], &told["car_rate"]), (&0.25.into(), &serde_json::Value::Null));
    }

    #[test]
    fn episodes_without_an_event_do_not_count_in_its_rate() {
        let episode = |value| {
            let figure = EventFigure { name: "vase".to_owned(), count: Count::OfPassed, value };
            EpisodeMetrics { events: vec![figure], ..EpisodeMetrics::default() }
        };
        let summary = Summary::of(&[episode(Some(0.5)), episode(None)]);
        let (figure, rate) = &summary.events[0];
        assert_eq!((figure.name.as_str(), rate.map(|rate| (rate.mean, rate.n))), ("vase", Some((0.5, 1))));
        assert_eq!(summary.n_episodes, 2);
    }
}
