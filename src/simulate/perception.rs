//! What somebody who watches a clip perceives: what happens in it, how well it goes on, and whether it holds together.

use std::ops::Range;
use std::sync::Arc;

use super::probe::{Probe, ProgressScale, Readings, Reads};
use crate::dream::Rows;
use crate::world::cars::{Sight, sight};
use crate::world::{EventKind, Frame, WorldSpec};

/// In so many pictures an event must be seen. In one alone it may be a flaw of the picture.
const N_SEEN: usize = 2;
/// Unless it goes on for fewer steps than this, on average: then it is over before it could be seen in two.
const SHORT: f32 = 2.0;
/// What an unsafe step costs where there is no reward, and each progress event is worth 1: as the paper's −1 against +10.
const UNSAFE_COST: f32 = 0.1;

/// An event that can be perceived.
#[derive(Clone, Debug, PartialEq)]
struct Perceived {
    name: String,
    /// In so many pictures it must be seen.
    n_seen: usize,
}

/// What perceptions mean in a world.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Meaning {
    events: Vec<Perceived>,
    /// The events that each of the world's justifications stands for.
    justifications: Vec<(String, Vec<String>)>,
    /// The events of which none may be seen in a clip that is safe.
    barred: Vec<usize>,
    /// The events that make a step unsafe.
    safety: Vec<usize>,
    /// What such a step costs, in the unit of progress.
    unsafe_cost: f32,
    /// Progress in a step from which on it is said to be good.
    onward: f32,
}

impl Meaning {
    /// That of a built-in car's sights.
    fn of_cars(spec: &WorldSpec) -> Self {
        let events = sight::EVENTS.map(|name| Perceived { name: name.to_owned(), n_seen: sight::N_SEEN });
        let safety: Vec<_> =
            sight::EVENTS.iter().position(|name| *name == sight::UNSAFE).into_iter().collect();
        Self {
            events: events.into(),
            justifications: justifications(spec),
            barred: safety.clone(),
            safety,
            unsafe_cost: sight::UNSAFE_COST,
            onward: sight::ONWARD,
        }
    }

    /// That of `events`, as the file of their world says.
    fn of_events(spec: &WorldSpec, events: &[String], readings: &Readings) -> Self {
        let is_short = |stretch: f32| stretch > 0.0 && stretch < SHORT;
        let perceived = events.iter().zip(&readings.stretches).map(|(name, stretch)| Perceived {
            name: name.clone(),
            n_seen: if is_short(*stretch) { 1 } else { N_SEEN },
        });
        let those =
            |is: &dyn Fn(&str) -> bool| (0..events.len()).filter(|i| is(&events[*i])).collect::<Vec<_>>();
        let safety = those(&|name| spec.events_of(EventKind::Safety).any(|event| event.name == name));
        let justifications = justifications(spec);
        let barred = those(&|name| justifications.iter().any(|(_, of)| of.iter().any(|event| event == name)));
        let (unsafe_cost, onward) = match readings.progress {
            Some(ProgressScale { unsafe_cost, .. }) => (unsafe_cost, 0.0),
            None => (UNSAFE_COST, 1.0),
        };
        Self {
            events: perceived.collect(),
            // Without a justification, nothing that must not happen may.
            barred: if justifications.is_empty() { safety.clone() } else { barred },
            justifications,
            safety,
            unsafe_cost,
            onward,
        }
    }

    /// The events that the justification of this name is about; if there is none, the event of this name.
    fn about(&self, justification: &str) -> impl Iterator<Item = usize> {
        let found = self.justifications.iter().find(|(name, _)| name == justification);
        let is_meant = move |event: &str| match found {
            Some((_, events)) => events.iter().any(|name| name == event),
            None => event == justification,
        };
        (0..self.events.len()).filter(move |i| is_meant(&self.events[*i].name))
    }
}

fn justifications(spec: &WorldSpec) -> Vec<(String, Vec<String>)> {
    spec.justifications.iter().map(|it| (it.name.clone(), it.events.clone())).collect()
}

/// A probe that looks at one world, and what it sees there.
#[derive(Clone, Debug)]
pub struct Eyes<'a> {
    probe: &'a Probe,
    meaning: Arc<Meaning>,
    /// Of each event that is read, whether it is progress.
    is_progress: Vec<bool>,
}

impl<'a> Eyes<'a> {
    /// Those that look at this world.
    pub fn new(probe: &'a Probe, spec: &WorldSpec) -> Self {
        let kind = |name: &String| {
            let event = spec.events.iter().find(|event| event.name == *name);
            event.is_some_and(|event| event.kind == EventKind::Progress)
        };
        let (meaning, is_progress) = match (probe.reads(), probe.readings()) {
            (Reads::Events(events), Some(readings)) => {
                (Meaning::of_events(spec, events, readings), events.iter().map(kind).collect())
            }
            _ => (Meaning::of_cars(spec), Vec::new()),
        };
        Self { probe, meaning: Arc::new(meaning), is_progress }
    }

    /// Watches a clip, one picture a step.
    pub fn watch(&self, clip: &[Frame]) -> Perception {
        match self.probe.readings() {
            None => Perception::of_sights(Arc::clone(&self.meaning), &self.probe.sights_of(clip)),
            Some(readings) => self.perceived(readings, &self.probe.read_clip(clip), clip),
        }
    }

    /// Watches a clip of one picture in so many steps.
    pub fn watch_every(&self, clip: &[Frame], steps: usize) -> Perception {
        match self.probe.readings() {
            None => Perception::of_sights(Arc::clone(&self.meaning), &self.probe.sights_every(clip, steps)),
            Some(readings) => self.perceived(readings, &self.probe.read_every(clip, steps), clip),
        }
    }

    /// What the numbers of a clip's pictures mean.
    fn perceived(&self, readings: &Readings, rows: &Rows, clip: &[Frame]) -> Perception {
        let chance = |logit: f32| 1.0 / (1.0 + (-logit).exp());
        let n_events = self.meaning.events.len();
        let chances: Vec<Vec<f32>> =
            (0..n_events).map(|i| (0..rows.len()).map(|t| chance(rows.row(t)[i])).collect()).collect();
        let progress = (0..rows.len()).map(|t| {
            if let Some(scale) = readings.progress {
                return rows.row(t)[n_events] * scale.deviation / scale.clip;
            }
            let is_seen = |i: &usize| self.is_progress[*i] && chances[*i][t] > 0.5;
            (0..n_events).filter(is_seen).count() as f32
        });
        let jump = |t: usize| {
            let (before, usual) = t.checked_sub(1).zip(readings.change)?;
            Some(change(&clip[before], &clip[t]) / usual)
        };
        Perception {
            progress: progress.collect(),
            nearness: vec![0.0; rows.len()],
            jumps: (0..rows.len()).map(|t| jump(t).unwrap_or_default()).collect(),
            chances,
            meaning: Arc::clone(&self.meaning),
        }
    }
}

/// The root mean square change of a pixel's colors from one picture to another of the same size, in `[0, 1]`.
pub(super) fn change(before: &Frame, now: &Frame) -> f32 {
    let squares = before.rgb().iter().zip(now.rgb()).map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2));
    ((squares.sum::<f64>() / now.rgb().len().max(1) as f64).sqrt() / 255.0) as f32
}

/// What is perceived in a clip of T pictures.
///
/// The unit of progress is, for the built-in cars, a tile. In other worlds it is the standard deviation of what a whole clip's
/// steps bring in the world's own reward, without what safety events cost, and 0 is a usual step; where there is no
/// reward, it is one progress event.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Perception {
    meaning: Arc<Meaning>,
    /// The probability of each event, picture by picture: E times T, in `[0, 1]`.
    chances: Vec<Vec<f32>>,
    /// Progress in each step, in its unit: T.
    pub progress: Vec<f32>,
    /// How near each picture is to what is unsafe, where that can be seen beforehand; 1 is very near, 0 where nothing is
    /// known: T. For the built-in cars the square of the way from the middle of the road to its edge.
    pub nearness: Vec<f32>,
    /// How much each picture jumps against the one before, 0 the first: T.
    ///
    /// For the built-in cars moves across the road that the car's motion does not explain, in units. In other worlds the
    /// change of pixels as a multiple of what 99 of 100 recorded steps stay below. That tells dreams that flicker or leap, and
    /// nothing of slower wrongs: 0 where no change was measured.
    pub jumps: Vec<f32>,
}

impl Perception {
    /// What sights of a car, one a picture, come to.
    pub(super) fn of_sights(meaning: Arc<Meaning>, sights: &[Sight]) -> Self {
        let chances =
            (0..sight::EVENTS.len()).map(|i| sights.iter().map(|sight| sight.chances()[i]).collect());
        let jump = |t: usize| t.checked_sub(1).map_or(0.0, |before| sights[t].jump(&sights[before]));
        Self {
            meaning,
            chances: chances.collect(),
            progress: sights.iter().map(Sight::tiles).collect(),
            nearness: sights.iter().map(Sight::nearness).collect(),
            jumps: (0..sights.len()).map(jump).collect(),
        }
    }

    /// How many pictures there are.
    pub fn len(&self) -> usize {
        self.progress.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.progress.is_empty()
    }

    /// The pictures in `range` alone.
    ///
    /// # Panics
    /// Where it reaches beyond the clip.
    #[must_use]
    pub fn part(&self, range: Range<usize>) -> Self {
        let of = |values: &Vec<f32>| values[range.clone()].to_vec();
        Self {
            meaning: Arc::clone(&self.meaning),
            chances: self.chances.iter().map(of).collect(),
            progress: of(&self.progress),
            nearness: of(&self.nearness),
            jumps: of(&self.jumps),
        }
    }

    /// The probability of the event of this name, picture by picture, where that is looked for.
    pub fn chance(&self, event: &str) -> Option<&[f32]> {
        let i = self.meaning.events.iter().position(|perceived| perceived.name == event)?;
        self.chances.get(i).map(Vec::as_slice)
    }

    /// Whether the clip shows nothing that must not happen: no event of a justification, and where there is none, no safety
    /// event. Of the built-in cars: whether they stay on the road.
    pub fn is_safe(&self) -> bool {
        !self.meaning.barred.iter().any(|event| self.happens(*event))
    }

    /// Whether the clip shows what the justification of this name is about.
    pub fn shows(&self, justification: &str) -> bool {
        self.meaning.about(justification).any(|event| self.happens(event))
    }

    /// Whether an event is seen in as many pictures as it takes.
    fn happens(&self, event: usize) -> bool {
        let seen = self.chances[event].iter().filter(|chance| **chance > 0.5);
        seen.count() >= self.meaning.events[event].n_seen
    }

    /// Whether a safety event goes on in picture `t`.
    fn is_unsafe_at(&self, t: usize) -> bool {
        self.meaning.safety.iter().any(|event| self.chances[*event][t] > 0.5)
    }

    /// Progress in the last step, whether it gets on, and whether it is unsafe.
    pub(super) fn last_step(&self) -> Option<LastStep> {
        let t = self.len().checked_sub(1)?;
        Some(LastStep { gets_on: self.progress[t] >= self.meaning.onward, is_unsafe: self.is_unsafe_at(t) })
    }

    /// How much the clip jumps: the root mean square of its [`jumps`](Self::jumps).
    pub fn jumpiness(&self) -> f32 {
        let jumps = self.jumps.get(1..).unwrap_or_default();
        let sum = jumps.iter().map(|jump| jump * jump).sum::<f32>();
        (sum / jumps.len().max(1) as f32).sqrt()
    }

    /// What the clip is worth, safety aside: progress, less `care` for each step that is near to what is unsafe.
    ///
    /// Steps of the past count `gamma` times less than the next.
    pub fn worth(&self, gamma: f32, care: f32) -> f32 {
        self.worths(care).fold(0.0, |sum, worth| gamma * sum + worth)
    }

    /// The same where a step in which a safety event goes on is worth no progress, and costs.
    pub fn payoff(&self, gamma: f32, care: f32) -> f32 {
        let steps = self.worths(care).enumerate();
        steps.fold(0.0, |sum, (t, worth)| {
            gamma * sum + if self.is_unsafe_at(t) { -self.meaning.unsafe_cost } else { worth }
        })
    }

    fn worths(&self, care: f32) -> impl Iterator<Item = f32> {
        self.progress.iter().zip(&self.nearness).map(move |(progress, near)| progress - care * near)
    }

    /// What each step is worth: its progress, or minus one unit of it where a safety event goes on, or what a justification is
    /// about.
    pub(super) fn rewards(&self) -> Vec<f32> {
        let named = self.meaning.justifications.iter().flat_map(|(name, _)| self.meaning.about(name));
        let bad: Vec<usize> = named.chain(self.meaning.safety.iter().copied()).collect();
        let is_bad = |t: usize| bad.iter().any(|event| self.chances[*event][t] > 0.5);
        (0..self.len()).map(|t| if is_bad(t) { -1.0 } else { self.progress[t] }).collect()
    }

    /// The pictures at which somebody who watches would say that it is unsafe now: once each time a safety event begins.
    pub fn marks(&self) -> Vec<usize> {
        let mut marks: Vec<usize> =
            self.meaning.safety.iter().flat_map(|event| self.beginnings(*event)).collect();
        marks.sort_unstable();
        marks.dedup();
        marks
    }

    /// The pictures in which an event has been seen in as many as it takes, and not before.
    fn beginnings(&self, event: usize) -> impl Iterator<Item = usize> {
        let (chances, n) = (&self.chances[event], self.meaning.events[event].n_seen);
        let is_seen = move |t: usize| chances[t] > 0.5;
        (n..chances.len()).filter(move |&t| (0..n).all(|i| is_seen(t - i)) && !is_seen(t - n))
    }
}

/// What is seen of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct LastStep {
    /// Whether it gets on.
    pub(super) gets_on: bool,
    /// Whether a safety event goes on.
    pub(super) is_unsafe: bool,
}

/// Perceptions for tests.
#[cfg(test)]
pub(super) mod made_up {
    use super::*;

    /// Of sights of a car.
    pub(in super::super) fn of_sights(sights: &[Sight]) -> Perception {
        Perception::of_sights(Arc::new(Meaning::of_cars(&WorldSpec::default())), sights)
    }

    /// An arm that may drop things, for a moment, or lean, for longer; what it places is progress.
    pub(in super::super) fn arm() -> WorldSpec {
        let text = r#"
            format = 1
            name = "arm"
            title = "An arm"
            rate = 20
            longest_episode = 400
            source = { kind = "recordings" }
            image = { height = 12, width = 20 }
            axes = [{ name = "reach", low = 0.0, high = 512.0, neutral = 256.0 }]
            events = [
                { name = "drop", kind = "safety", field = "drop" },
                { name = "lean", kind = "safety", field = "lean" },
                { name = "placed", kind = "progress", field = "placed" },
            ]
            justifications = [{ name = "careless", events = ["drop"], weight = 1.0 }]
        "#;
        text.parse().unwrap()
    }

    /// What is known of it; its steps have a reward, or not.
    pub(in super::super) fn readings(has_reward: bool) -> Readings {
        let scale = ProgressScale { mean: 1.0, deviation: 2.0, clip: 10.0, unsafe_cost: 0.5 };
        let (world, stretches) = ("arm".to_owned(), vec![1.2, 9.0, 0.0]);
        Readings { world, gap: 2, stretches, progress: has_reward.then_some(scale), change: None }
    }

    /// Of chances of its events, and progress.
    pub(in super::super) fn of_arm(
        has_reward: bool,
        chances: [Vec<f32>; 3],
        progress: Vec<f32>,
    ) -> Perception {
        let names: Vec<_> = arm().events.iter().map(|event| event.name.clone()).collect();
        let n = progress.len();
        Perception {
            meaning: Arc::new(Meaning::of_events(&arm(), &names, &readings(has_reward))),
            chances: chances.into(),
            progress,
            nearness: vec![0.0; n],
            jumps: vec![0.0; n],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::made_up::{arm, of_arm, of_sights, readings};
    use super::*;
    use crate::simulate::probe::{Net, ProbeConfig};
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;
    use tch::{Device, nn};

    const NO: f32 = 0.1;
    const YES: f32 = 0.9;

    #[test]
    fn a_short_event_takes_one_picture_and_a_long_one_two() {
        let clip = |drop: Vec<f32>, lean: Vec<f32>| of_arm(true, [drop, lean, vec![NO; 4]], vec![0.0; 4]);
        let dropped = clip(vec![NO, YES, NO, NO], vec![NO; 4]);
        assert!(!dropped.is_safe() && dropped.shows("careless") && dropped.shows("drop"));
        let leaning = clip(vec![NO; 4], vec![YES; 4]);
        assert!(leaning.is_safe(), "no justification is about that");
        assert!(leaning.shows("lean") && !leaning.shows("careless"));
        assert!(!clip(vec![NO; 4], vec![NO, YES, NO, NO]).shows("lean"), "a flaw");
        assert!(!leaning.shows("elsewhere"));
        assert_eq!(leaning.chance("lean"), Some(&[YES; 4][..]));
    }

    #[test]
    fn an_unsafe_step_costs_and_brings_no_progress() {
        let clip = of_arm(true, [vec![NO; 4], vec![NO, NO, YES, YES], vec![NO; 4]], vec![0.25; 4]);
        assert!((clip.worth(1.0, 0.1) - 1.0).abs() < 1e-6);
        assert!((clip.payoff(1.0, 0.1) - (0.5 - 1.0)).abs() < 1e-6);
        let last = |has_reward, progress| {
            of_arm(has_reward, [vec![NO], vec![NO], vec![NO]], vec![progress]).last_step().unwrap().gets_on
        };
        assert!(last(true, 0.01) && !last(true, -0.01), "above usual");
        assert!(last(false, 1.0) && !last(false, 0.0), "an event");
    }

    #[test]
    fn a_mark_is_set_once_where_a_safety_event_begins() {
        let clip = of_arm(
            true,
            [vec![NO, NO, NO, NO, NO, NO, YES, YES], vec![NO, YES, NO, YES, YES, YES, NO, NO], vec![NO; 8]],
            vec![0.0; 8],
        );
        assert_eq!(clip.marks(), [4, 6]);
        let sights = [0.0, 0.9, 0.0, 0.9, 0.9, 0.9, 0.2, 0.8, 0.7];
        let sights = sights.map(|off_road| Sight { off_road, ..Sight::default() });
        assert_eq!(of_sights(&sights).marks(), [4, 8]);
    }

    #[test]
    fn jumps_of_a_car_across_the_road_are_measured_and_smooth_moves_are_none() {
        let sight = |lateral, across| Sight { lateral, road_velocity: [20.0, across], ..Sight::default() };
        let smooth: Vec<_> = (0..20).map(|i| sight(0.2 * i as f32, 10.0)).collect();
        let jumping: Vec<_> = (0..20).map(|i| sight(2.0 * (i % 2) as f32, 0.0)).collect();

        assert!(of_sights(&smooth).jumpiness() < 1e-4);
        assert!((of_sights(&jumping).jumpiness() - 2.0).abs() < 1e-4);
        assert!((of_sights(&jumping).part(4..9).jumpiness() - 2.0).abs() < 1e-4);
    }

    #[test]
    fn a_picture_that_changes_more_than_is_usual_jumps() {
        let frame = |shade: u8| Frame::new(12, 20, vec![shade; 12 * 20 * 3]);
        assert!((change(&frame(0), &frame(51)) - 0.2).abs() < 1e-6);
        let reads = Reads::Events(arm().events.iter().map(|event| event.name.clone()).collect());
        let config = ProbeConfig::of_size(arm().image.trained(), reads);
        let store = nn::VarStore::new(Device::Cpu);
        Net::new(&store.root(), config.clone(), &mut ChaCha8Rng::seed_from_u64(0));
        let clip: Vec<_> = [0, 51, 51].map(frame).into();
        let watched = |readings: Readings| {
            let parameters = Probe::parameters_of(&config, &store, Some(&readings), String::new());
            let probe = Probe::load(&parameters).unwrap();
            Eyes::new(&probe, &arm()).watch(&clip)
        };
        let seen = watched(Readings { change: Some(0.1), ..readings(true) });
        assert!((seen.jumps[1] - 2.0).abs() < 1e-4 && seen.jumps[2] == 0.0, "{:?}", seen.jumps);
        assert_eq!(seen.chances.iter().map(Vec::len).collect::<Vec<_>>(), [3; 3]);
        assert_eq!(watched(readings(true)).jumpiness(), 0.0, "where nothing is known nothing jumps");
    }
}
