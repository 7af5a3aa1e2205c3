//! Fitting the probe of any world: its recordings tell which events went on after each step, and what it brought.

use std::collections::BTreeSet;
use std::fmt::{self, Display};
use std::ops::ControlFlow;

use rand::seq::SliceRandom as _;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use tch::{Device, nn};

use super::{
    Example, FitProbeConfig, Group, GroupKind, Lesson, PAINTED, Painter, Phase, ProbeFit, Progress, Report,
    Targets, auc, learn,
};
use crate::dataset::{Dataset, DatasetError, Episode};
use crate::dream::Rows;
use crate::query::SEGMENT_LEN;
use crate::simulate::perception::change;
use crate::simulate::probe::{Probe, ProbeConfig, ProgressScale, Readings, Reads, gap};
use crate::tensor::{NotFinite, from_slice};
use crate::text::shown;
use crate::world::{EventKind, Frame, Size, WorldSpec};
use crate::world_model::WorldModel;

/// Steps of the recordings that are read: enough, and read in minutes.
const MOST_STEPS: usize = 200_000;
/// Bytes of the pictures of all examples, before some are painted as well.
const MOST_BYTES: usize = 512 << 20;
/// Examples at the most.
const MOST_EXAMPLES: usize = 25_000;
/// So many beginnings of each event are examples in any case, wherever examples fall.
const BEGINNINGS: usize = 1500;
/// Pairs of pictures that tell how much one step usually changes.
const PAIRS: usize = 512;
/// Those change less than the usual that is found.
const USUAL: f64 = 0.99;
/// Where it is not told which episodes are held out, it is this share of them.
const HELD_OUT: f64 = 0.1;
/// An event that goes on in a few steps counts up to so many times more in the loss, and one that goes on in most as much less.
const BALANCE: f32 = 20.0;
/// The weight of progress in the loss, whose errors count as squares within ten deviations.
const PROGRESS: (f64, f64) = (10.0, 10.0);
/// A clip in which every step is unsafe costs at least one unit of progress.
const LEAST_COST: f32 = 1.0 / SEGMENT_LEN as f32;

/// Why no probe can be fitted on recordings.
#[derive(Debug, thiserror::Error)]
pub enum FitProbeError {
    /// The recordings.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// A loss, or what was learned.
    #[error(transparent)]
    NotFinite(#[from] NotFinite),
    /// They are of another world.
    #[error("the recordings are of the world {found:?}, and the probe is to be of {wanted:?}")]
    World {
        /// The world that was recorded.
        found: String,
        /// The world that was asked for.
        wanted: String,
    },
    /// Their pictures have another size.
    #[error("the recordings have pictures of {found} pixels, and the probe is to see {wanted}")]
    Size {
        /// That of the recordings.
        found: Size,
        /// That which the probe was to see.
        wanted: Size,
    },
    /// There is nothing to see.
    #[error(
        "there is nothing to learn in the recordings: none of the world's events was recorded ({0}), and no reward that \
         changes"
    )]
    Nothing(String),
    /// There are too few.
    #[error(
        "a probe is fitted on some episodes and measured on others, and the recordings have {0}: record at least 2"
    )]
    TooFew(usize),
}

/// How well a probe tells one event.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct EventError {
    /// What it is called.
    pub name: String,
    /// Share of all steps in which it goes on.
    pub share: f64,
    /// Share of all steps in which it is told rightly whether it does.
    pub accuracy: f64,
    /// Probability that a step in which it goes on looks more so than another; ½ where there are none of one kind.
    pub auc: f64,
}

/// How good a probe is on moments that it was not fitted on.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct EventErrors {
    /// Moments.
    pub n: usize,
    /// For each event.
    pub events: Vec<EventError>,
    /// R² of progress: 1 is perfect, 0 is as good as the mean. None where there is no reward.
    pub progress: Option<f64>,
}

impl Display for EventErrors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} pictures", self.n)?;
        for EventError { name, share, accuracy, auc } in &self.events {
            let share = 100.0 * share;
            write!(f, "; {}: in {share:.1} %, accuracy {accuracy:.3}, AUC {auc:.3}", shown(name))?;
        }
        match self.progress {
            Some(progress) => write!(f, "; progress: R² {progress:.3}"),
            None => write!(f, "; no reward"),
        }
    }
}

/// What a picture shows.
#[derive(Clone, Debug)]
struct Shown {
    /// Which events go on, in the order of those that are read.
    events: Vec<bool>,
    /// The world's reward for the step to it; none where a safety event goes on, whose cost is in it.
    reward: Option<f32>,
}

/// Fits a probe on recorded episodes of the world that `spec` describes. Where `report` breaks off, on what has been seen
/// until then.
///
/// Those events are read that `config` names and the recordings have. Episodes are held out that `model` names as held out,
/// or else a tenth. An example is a picture and the one [`gap`] steps before; every beginning of an event is one, others
/// are `config.stride` steps apart on average, or further where there would be too many. In the loss, rare events count up
/// to 20 times more. Afterwards each event's logit is shifted so that it is above 0 in as many steps as the event goes on
/// in.
///
/// # Errors
/// Where the recordings cannot be read, do not fit, or tell nothing; and at the first loss that is no number.
pub fn fit_event_probe(
    config: &FitProbeConfig,
    dataset: &Dataset,
    spec: &WorldSpec,
    model: Option<&WorldModel>,
    report: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
) -> Result<ProbeFit<EventErrors>, FitProbeError> {
    let mut tell = |phase, done, n, loss| report(&Progress { phase, done, n, loss });
    let events = recorded_events(config, dataset, spec)?;
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    let plan = Plan::new(config, dataset, spec, events, model, &mut rng)?;
    let (mut held_out, mut seen) = plan.read(dataset, &mut rng, &mut tell)?;
    let progress = seen.progress(spec);
    if plan.events.is_empty() && progress.is_none() {
        return Err(nothing(spec));
    }
    let painter = model.map(Painter::new);
    let change = seen.usual_change(painter.as_ref(), &mut rng);
    let mut painted = Vec::new();
    if let Some(painter) = &painter {
        seen.examples.shuffle(&mut rng);
        let n = (config.painted * seen.examples.len() as f64) as usize;
        painted = painter.paint(&held_out.examples, &mut rng);
        let mut all = Vec::new();
        for some in seen.examples[..n].chunks(PAINTED) {
            all.extend(painter.paint(some, &mut rng));
            if tell(Phase::Paint, all.len(), n, 0.0).is_break() {
                break;
            }
        }
        seen.examples.extend(all);
    }
    let happenings = Happenings::new(&seen.examples, plan.events.len(), progress);
    let probe = ProbeConfig { reads: Reads::Events(plan.events.clone()), ..config.probe.clone() };
    let config = FitProbeConfig { probe, ..config.clone() };
    let on_update = &mut |done, loss| tell(Phase::Learn, done, config.n_updates, loss);
    let device = model.map_or(Device::Cpu, |model| model.backend().device);
    let store = learn(&config, &happenings, &seen.examples, device, on_update)?;
    let readings = Readings {
        world: spec.name.clone(),
        gap: plan.gap,
        stretches: seen.counts.iter().map(Counts::stretch).collect(),
        progress,
        change,
    };
    let load = |store: &nn::VarStore| {
        let parameters = Probe::parameters_of(&config.probe, store, Some(&readings), String::new());
        Probe::load(&parameters).unwrap_or_else(|e| unreachable!("just made: {e}"))
    };
    let shares: Vec<f64> = seen.counts.iter().map(Counts::share).collect();
    shift(&store, &thresholds(&read(&load(&store), &seen.examples), &seen.examples, &shares));
    let (probe, shares) = (load(&store), held_out.counts.iter().map(Counts::share).collect::<Vec<_>>());
    let errors = |examples: &[Example<Shown>]| {
        errors(&plan.events, &read(&probe, examples), examples, &shares, progress)
    };
    let real = errors(&held_out.examples);
    held_out.examples.clear();
    let painted = (!painted.is_empty()).then(|| errors(&painted));
    let told = serde_json::json!({ "real": real, "painted": painted, "fit": config }).to_string();
    let parameters = Probe::parameters_of(&config.probe, &store, Some(&readings), told);
    Ok(ProbeFit { parameters, real, painted })
}

fn nothing(spec: &WorldSpec) -> FitProbeError {
    let names: Vec<_> = spec.events.iter().map(|event| shown(&event.name)).collect();
    FitProbeError::Nothing(if names.is_empty() { "it has none".to_owned() } else { names.join(", ") })
}

/// The events that are to be read and were recorded, where the recordings are of the right world.
fn recorded_events(
    config: &FitProbeConfig,
    dataset: &Dataset,
    spec: &WorldSpec,
) -> Result<Vec<String>, FitProbeError> {
    let found = dataset.env().unwrap_or_default();
    if found != spec.name {
        return Err(FitProbeError::World { found: shown(found), wanted: spec.name.clone() });
    }
    let side = |side: i64| u32::try_from(side).unwrap_or_default();
    let wanted = Size { height: side(config.probe.height), width: side(config.probe.width) };
    if let Some(found) = dataset.size().filter(|found| *found != wanted) {
        return Err(FitProbeError::Size { found, wanted });
    }
    let recorded = dataset.layout().unwrap_or_default().events;
    let named = match &config.probe.reads {
        Reads::Events(events) => events.clone(),
        Reads::Car { .. } => spec.events.iter().map(|event| event.name.clone()).collect(),
    };
    Ok(named.into_iter().filter(|name| recorded.contains(name)).collect())
}

/// Which episodes are read, and how.
struct Plan {
    events: Vec<String>,
    /// Which of the events are bad, in their order.
    is_safety: Vec<bool>,
    gap: usize,
    stride: usize,
    held_out: Vec<usize>,
    train: Vec<usize>,
}

impl Plan {
    fn new(
        config: &FitProbeConfig,
        dataset: &Dataset,
        spec: &WorldSpec,
        events: Vec<String>,
        model: Option<&WorldModel>,
        rng: &mut ChaCha8Rng,
    ) -> Result<Self, FitProbeError> {
        let n = dataset.n_episodes();
        if n < 2 {
            return Err(FitProbeError::TooFew(n));
        }
        let mut order: Vec<usize> = (0..n).collect();
        order.shuffle(rng);
        let named = model.and_then(WorldModel::held_out).unwrap_or_default();
        let mut held: BTreeSet<usize> = named.into_iter().filter(|episode| *episode < n).collect();
        if held.is_empty() || held.len() == n {
            let n_held_out = ((HELD_OUT * n as f64).round() as usize).clamp(1, n - 1);
            held = order.iter().copied().take(n_held_out).collect();
        }
        let (mut held_out, mut train): (Vec<_>, Vec<_>) = order.into_iter().partition(|i| held.contains(i));
        held_out.truncate(config.n_held_out);
        train.truncate(config.n_episodes);
        let mut n_steps = 0;
        let n_read = train.iter().take_while(|episode| {
            let reads_on = n_steps < MOST_STEPS;
            n_steps += dataset.len(**episode);
            reads_on
        });
        let n_read = n_read.count();
        train.truncate(n_read);
        let n_steps: usize = train.iter().map(|episode| dataset.len(*episode)).sum();
        let bytes = 6 * (config.probe.height * config.probe.width).max(1) as usize;
        let most = (MOST_BYTES / bytes).clamp(1, MOST_EXAMPLES);
        let stride = config.stride.max(n_steps.div_ceil(most)).max(1);
        let is_safety = |name: &String| spec.events_of(EventKind::Safety).any(|event| event.name == *name);
        let is_safety = events.iter().map(is_safety).collect();
        Ok(Self { events, is_safety, gap: gap(spec.rate), stride, held_out, train })
    }

    /// Reads the episodes that are held out, and those that are not.
    fn read(
        &self,
        dataset: &Dataset,
        rng: &mut ChaCha8Rng,
        tell: &mut Report<'_>,
    ) -> Result<(Seen, Seen), FitProbeError> {
        let (mut held_out, mut seen) = (Seen::new(self), Seen::new(self));
        let n = self.held_out.len() + self.train.len();
        let all = self.held_out.iter().map(|i| (*i, true)).chain(self.train.iter().map(|i| (*i, false)));
        for (done, (episode, is_held_out)) in all.enumerate() {
            let into = if is_held_out { &mut held_out } else { &mut seen };
            into.take(self, &dataset.episode(episode)?, rng);
            if tell(Phase::Read, done + 1, n, 0.0).is_break() {
                break;
            }
        }
        Ok((held_out, seen))
    }
}

/// In how many steps an event goes on, and how often it begins.
#[derive(Clone, Copy, Debug, Default)]
struct Counts {
    steps: usize,
    goes_on: usize,
    begins: usize,
}

impl Counts {
    /// Share of the steps in which it goes on.
    fn share(&self) -> f64 {
        self.goes_on as f64 / self.steps.max(1) as f64
    }

    /// How many steps it goes on once it has begun; 0 where it never did.
    fn stretch(&self) -> f32 {
        self.goes_on as f32 / self.begins.max(1) as f32
    }
}

/// What was seen in episodes.
struct Seen {
    examples: Vec<Example<Shown>>,
    /// Of each event.
    counts: Vec<Counts>,
    /// How many examples are there because an event begins, of each event.
    n_beginnings: Vec<usize>,
    /// The rewards of each episode's steps, and whether a safety event goes on after them.
    rewards: Vec<Vec<(f32, bool)>>,
    /// Pictures of successive steps.
    pairs: Vec<[Frame; 2]>,
}

impl Seen {
    fn new(plan: &Plan) -> Self {
        let n = plan.events.len();
        let (examples, rewards, pairs) = (Vec::new(), Vec::new(), Vec::new());
        Self { examples, counts: vec![Counts::default(); n], n_beginnings: vec![0; n], rewards, pairs }
    }

    /// Takes in an episode.
    fn take(&mut self, plan: &Plan, episode: &Episode, rng: &mut ChaCha8Rng) {
        let columns: Vec<_> =
            plan.events.iter().map(|name| episode.event(name).unwrap_or_default()).collect();
        // After the last step there may be no picture.
        let n = episode.actions.len().min(episode.frames.len().saturating_sub(1));
        let goes_on = |event: usize, t: usize| columns[event].get(t).copied().unwrap_or_default();
        let begins = |event: usize, t: usize| goes_on(event, t) && (t == 0 || !goes_on(event, t - 1));
        let is_unsafe = |t: usize| (0..columns.len()).any(|event| plan.is_safety[event] && goes_on(event, t));
        for (event, counts) in self.counts.iter_mut().enumerate() {
            counts.steps += n;
            counts.goes_on += (0..n).filter(|t| goes_on(event, *t)).count();
            counts.begins += (0..n).filter(|t| begins(event, *t)).count();
        }
        self.rewards.push((0..n).map(|t| (episode.rewards[t], is_unsafe(t))).collect());
        let mut next = rng.random_range(0..plan.stride);
        for t in 0..n {
            let is_due = t == next;
            if is_due {
                next += rng.random_range(1..=2 * plan.stride - 1);
            }
            let begun: Vec<usize> = (0..columns.len())
                .filter(|event| begins(*event, t) && self.n_beginnings[*event] < BEGINNINGS)
                .collect();
            for event in &begun {
                self.n_beginnings[*event] += 1;
            }
            if !is_due && begun.is_empty() {
                continue;
            }
            let now = t + 1;
            // At the beginning of an episode nothing is known of before, as at that of a clip.
            let earlier = now.checked_sub(plan.gap).unwrap_or(now);
            let events = (0..columns.len()).map(|event| goes_on(event, t)).collect();
            let shown = Shown { events, reward: (!is_unsafe(t)).then_some(episode.rewards[t]) };
            let [earlier, now] = [earlier, now].map(|at| episode.frames[at].clone());
            self.examples.push(Example { earlier, now, shown });
        }
        for _ in 0..2.min(n) {
            if self.pairs.len() < PAIRS {
                let at = rng.random_range(0..n);
                self.pairs.push([at, at + 1].map(|at| episode.frames[at].clone()));
            }
        }
    }

    /// What the reward is without safety events, and what these cost. None where it does not change, so that there is none.
    fn progress(&self, spec: &WorldSpec) -> Option<ProgressScale> {
        let of = |is_wanted: bool| {
            let all = self.rewards.iter().flatten().filter(move |(_, is_unsafe)| *is_unsafe == is_wanted);
            all.map(|(reward, _)| f64::from(*reward))
        };
        let (mean, deviation) = mean_and_deviation(of(false))?;
        if deviation <= 1e-6 * mean.abs().max(1e-6) {
            return None;
        }
        // Where a safety event goes on, a step counts as any other.
        let beyond: Vec<Vec<f64>> = self
            .rewards
            .iter()
            .map(|steps| {
                let of = |(reward, is_unsafe): &(f32, bool)| {
                    if *is_unsafe { 0.0 } else { f64::from(*reward) - mean }
                };
                steps.iter().map(of).collect()
            })
            .collect();
        let clips = beyond.iter().flat_map(|steps| steps.windows(SEGMENT_LEN).step_by(SEGMENT_LEN / 2));
        let found = mean_and_deviation(clips.map(|clip| clip.iter().sum::<f64>()));
        let independent = deviation * (SEGMENT_LEN as f64).sqrt();
        let clip = found.map(|(_, deviation)| deviation).filter(|clip| *clip > 1e-3 * independent);
        let clip = clip.unwrap_or(independent);
        let cost = mean_and_deviation(of(true)).map_or(0.0, |(of_unsafe, _)| (mean - of_unsafe) / clip);
        let is_safe_everywhere = spec.events_of(EventKind::Safety).next().is_none();
        let unsafe_cost = if is_safe_everywhere { 0.0 } else { (cost as f32).max(LEAST_COST) };
        let scale =
            ProgressScale { mean: mean as f32, deviation: deviation as f32, clip: clip as f32, unsafe_cost };
        let is_number =
            [scale.mean, scale.deviation, scale.clip, unsafe_cost].iter().all(|it| it.is_finite());
        (is_number && scale.deviation > 0.0 && scale.clip > 0.0).then_some(scale)
    }

    /// The change of a pixel that 99 of 100 steps stay below: as painted, or as it is, whichever is more.
    fn usual_change(&self, painter: Option<&Painter<'_>>, rng: &mut ChaCha8Rng) -> Option<f32> {
        let most = |pairs: &[[Frame; 2]]| {
            let mut all: Vec<f32> = pairs.iter().map(|[before, now]| change(before, now)).collect();
            all.sort_by(f32::total_cmp);
            all.get(((USUAL * all.len() as f64) as usize).min(all.len().saturating_sub(1))).copied()
        };
        let mut usual = most(&self.pairs)?;
        if let Some(painter) = painter {
            let painted: Vec<[Frame; 2]> = self
                .pairs
                .chunks(PAINTED)
                .flat_map(|pairs| {
                    let [before, now] =
                        [0, 1].map(|i| pairs.iter().map(|pair| pair[i].clone()).collect::<Vec<_>>());
                    let (before, now) = (painter.repaint(&before, rng), painter.repaint(&now, rng));
                    before.into_iter().zip(now).map(|(before, now)| [before, now]).collect::<Vec<_>>()
                })
                .collect();
            usual = usual.max(most(&painted)?);
        }
        (usual > 1e-6).then_some(usual.min(1.0))
    }
}

/// Mean and standard deviation, where there is any value.
fn mean_and_deviation(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    // Welford's way.
    let (mut n, mut mean, mut squares) = (0.0, 0.0, 0.0);
    for value in values {
        n += 1.0;
        let away = value - mean;
        mean += away / n;
        squares += away * (value - mean);
    }
    (n > 0.0).then(|| (mean, (squares / n).sqrt()))
}

/// The events of a world, and progress.
struct Happenings {
    /// How much more each event counts where it goes on.
    balance: Vec<f32>,
    progress: Option<ProgressScale>,
}

impl Happenings {
    fn new(examples: &[Example<Shown>], n_events: usize, progress: Option<ProgressScale>) -> Self {
        let balance = |event: usize| {
            let n = examples.iter().filter(|example| example.shown.events[event]).count();
            let (is, is_not) = (n as f32, (examples.len() - n) as f32);
            if is * is_not == 0.0 { 1.0 } else { (is_not / is).clamp(1.0 / BALANCE, BALANCE) }
        };
        Self { balance: (0..n_events).map(balance).collect(), progress }
    }
}

impl Lesson<Shown> for Happenings {
    fn groups(&self) -> Vec<Group> {
        let n = self.balance.len();
        let (smooth, weight) = PROGRESS;
        let (events, progress) = (GroupKind::Chances(Some(self.balance.clone())), GroupKind::Values(smooth));
        vec![Group { from: 0, n, kind: events, weight: 1.0 }, Group { from: n, n: 1, kind: progress, weight }]
    }

    fn targets(&self, shown: &Shown, _: bool, _: bool) -> Targets {
        let value = |is: &bool| if *is { 1.0f32 } else { 0.0 };
        let progress = self.progress.zip(shown.reward);
        let progress = progress.map(|(scale, reward)| (reward - scale.mean) / scale.deviation);
        Targets {
            values: shown.events.iter().map(value).chain([progress.unwrap_or_default()]).collect(),
            counts: vec![1.0; shown.events.len()]
                .into_iter()
                .chain([if progress.is_some() { 1.0 } else { 0.0 }])
                .collect(),
        }
    }

    fn has_mirror_images(&self) -> bool {
        false
    }
}

/// The numbers that `probe` makes of examples, a row each.
fn read(probe: &Probe, examples: &[Example<Shown>]) -> Rows {
    let mut rows: Option<Rows> = None;
    for some in examples.chunks(PAINTED) {
        let (earlier, now): (Vec<_>, Vec<_>) =
            some.iter().map(|example| (example.earlier.clone(), example.now.clone())).unzip();
        let read = probe.read(&earlier, &now);
        match &mut rows {
            Some(rows) => rows.values.extend(read.values),
            None => rows = Some(read),
        }
    }
    rows.unwrap_or_default()
}

/// An event's logits with whether it goes on, and how much each counts so that all count as much as the steps of the
/// recordings, in a `share` of which it does.
fn weighed(rows: &Rows, examples: &[Example<Shown>], event: usize, share: f64) -> Vec<(f32, bool, f64)> {
    let n = examples.iter().filter(|example| example.shown.events[event]).count();
    let weights = [(1.0 - share) / (examples.len() - n).max(1) as f64, share / n.max(1) as f64];
    let of = |(i, example): (usize, &Example<Shown>)| {
        let is = example.shown.events[event];
        (rows.row(i)[event], is, weights[usize::from(is)])
    };
    examples.iter().enumerate().map(of).collect()
}

/// For each event the logit that is exceeded in as many steps as the event goes on in: `shares` of all.
fn thresholds(rows: &Rows, examples: &[Example<Shown>], shares: &[f64]) -> Vec<f32> {
    let of = |(event, &share): (usize, &f64)| {
        let mut all = weighed(rows, examples, event, share);
        all.sort_by(|a, b| b.0.total_cmp(&a.0));
        let (Some(highest), Some(lowest)) = (all.first(), all.last()) else { return 0.0 };
        if share <= 0.0 {
            return highest.0 + 1.0;
        }
        let mut above = 0.0;
        let at = all.iter().position(|(_, _, weight)| {
            above += weight;
            above >= share - 1e-9
        });
        match at.and_then(|at| Some((all[at].0, all.get(at + 1)?.0))) {
            Some((last, next)) => f32::midpoint(last, next),
            None => lowest.0 - 1.0,
        }
    };
    shares.iter().enumerate().map(of).collect()
}

/// Takes `thresholds` off the logits of a network.
fn shift(store: &nn::VarStore, thresholds: &[f32]) {
    if thresholds.is_empty() {
        return;
    }
    let variables = store.variables();
    let bias = variables.get("out.bias").unwrap_or_else(|| unreachable!("every probe has one"));
    tch::no_grad(|| {
        let mut logits = bias.narrow(0, 0, thresholds.len() as i64);
        let _ = logits.g_sub_(&from_slice(thresholds, &[thresholds.len() as i64]).to_device(bias.device()));
    });
}

/// How good what was read of `examples` is, where events go on in `shares` of all steps.
fn errors(
    names: &[String],
    rows: &Rows,
    examples: &[Example<Shown>],
    shares: &[f64],
    progress: Option<ProgressScale>,
) -> EventErrors {
    let events = names.iter().zip(shares).enumerate().map(|(event, (name, &share))| {
        let all = weighed(rows, examples, event, share);
        let total: f64 = all.iter().map(|(_, _, weight)| weight).sum();
        let right = all.iter().filter(|(logit, is, _)| (*logit > 0.0) == *is).map(|(_, _, weight)| weight);
        let scored: Vec<_> = all.iter().map(|(logit, is, _)| (*is, *logit)).collect();
        let accuracy = right.sum::<f64>() / total.max(f64::MIN_POSITIVE);
        EventError { name: name.clone(), share, accuracy, auc: auc(&scored) }
    });
    let progress = progress.map(|scale| {
        let told = examples.iter().enumerate().filter_map(|(i, example)| {
            let wanted = (example.shown.reward? - scale.mean) / scale.deviation;
            Some((f64::from(wanted), f64::from(rows.row(i)[names.len()])))
        });
        r_squared(&told.collect::<Vec<_>>())
    });
    EventErrors { n: examples.len(), events: events.collect(), progress }
}

/// R² of what was found against what is, in pairs of what is and what was found. 0 where nothing differs.
fn r_squared(pairs: &[(f64, f64)]) -> f64 {
    let Some((_, deviation)) = mean_and_deviation(pairs.iter().map(|(is, _)| *is)) else { return 0.0 };
    let wrong = pairs.iter().map(|(is, found)| (is - found).powi(2)).sum::<f64>() / pairs.len() as f64;
    if deviation > 0.0 { 1.0 - wrong / deviation.powi(2) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::perception::made_up::arm;

    fn example(is: bool) -> Example<Shown> {
        let frame = Frame::new(1, 1, vec![0; 3]);
        let shown = Shown { events: vec![is], reward: None };
        Example { earlier: frame.clone(), now: frame, shown }
    }

    #[test]
    fn as_many_steps_look_like_an_event_as_are() {
        // Of ten examples four are of the event, but only a tenth of all steps: each of those counts 0.1 / 4, each other 0.9 / 6.
        let logits = [4.0, 3.0, 2.5, 2.0, 1.0, 0.0, -1.0, -2.0, -3.0, -4.0];
        let is = [true, true, false, true, true, false, false, false, false, false];
        let examples: Vec<_> = is.into_iter().map(example).collect();
        let rows = Rows { width: 1, values: logits.to_vec() };
        // The first two come to 0.05, and the third to 0.2.
        assert_eq!(thresholds(&rows, &examples, &[0.1]), [f32::midpoint(2.5, 2.0)]);
        assert_eq!(thresholds(&rows, &examples, &[0.0]), [5.0], "what never happens is never seen");
        assert!(thresholds(&rows, &examples, &[1.0])[0] < 1.0);
        assert_eq!(thresholds(&rows, &[], &[0.1]), [0.0]);

        let found = errors(&["drop".to_owned()], &rows, &examples, &[0.1], None);
        assert!(
            (found.events[0].auc - 22.0 / 24.0).abs() < 1e-9,
            "two of 24 pairs are the wrong way round: {found}"
        );
        let wanted = 4.0 * 0.1 / 4.0 + 5.0 * 0.9 / 6.0;
        assert!((found.events[0].accuracy - wanted).abs() < 1e-9, "one other is above zero: {found}");
    }

    #[test]
    fn progress_is_the_reward_without_what_safety_events_cost() {
        let seen = |rewards: Vec<Vec<(f32, bool)>>| Seen {
            examples: vec![],
            counts: vec![],
            n_beginnings: vec![],
            rewards,
            pairs: vec![],
        };
        // 40 steps of 1, 40 of 3, and 20 that are unsafe.
        let steps = [vec![(1.0, false); 40], vec![(3.0, false); 40], vec![(-8.0, true); 20]].concat();
        let scale = seen(vec![steps]).progress(&arm()).unwrap();
        assert_eq!((scale.mean, scale.deviation), (2.0, 1.0));
        assert!((10.0..25.0).contains(&scale.clip), "twenty steps that differ by one: {scale:?}");
        assert!((scale.unsafe_cost * scale.clip - 10.0).abs() < 1e-4, "{scale:?}");

        let short = seen(vec![vec![(1.0, false), (3.0, false)]; 9]).progress(&arm()).unwrap();
        assert!((short.clip - 20f32.sqrt()).abs() < 1e-5, "as if steps had nothing to do with each other");
        assert!((short.unsafe_cost - LEAST_COST).abs() < 1e-6, "nobody knows what it costs");
        assert_eq!(seen(vec![vec![(0.0, false); 30]]).progress(&arm()), None, "no reward");
        assert_eq!(seen(vec![]).progress(&arm()), None);
    }

    #[test]
    fn r_squared_is_one_for_what_is_right_and_zero_for_the_mean() {
        assert_eq!(r_squared(&[(1.0, 1.0), (3.0, 3.0)]), 1.0);
        assert_eq!(r_squared(&[(1.0, 2.0), (3.0, 2.0)]), 0.0);
        assert_eq!(r_squared(&[]), 0.0);
        assert_eq!(r_squared(&[(1.0, 2.0)]), 0.0);
    }

    #[test]
    fn rare_events_count_more() {
        let examples: Vec<_> = (0..100).map(|i| example(i < 10)).collect();
        assert_eq!(Happenings::new(&examples, 1, None).balance, [9.0]);
        assert_eq!(Happenings::new(&examples[..1], 1, None).balance, [1.0], "of one kind alone");
        assert_eq!(Happenings::new(&examples[9..], 1, None).balance, [BALANCE]);
    }
}
