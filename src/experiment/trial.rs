//! A trial: dreams are played, queries are answered, and each variant learns and drives.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::ControlFlow;

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use super::description::{Description, Plans, Trial, Variant};
use super::gradients::GradientRow;
use super::learner::{Learned, Learner};
use super::search::Evaluation;
use super::segment_times::{SegmentTime, measured};
use super::states::{StateRow, chosen};
use super::table::{Row, Rows};
use crate::dream::{DreamEpisode, Rows as Features};
use crate::evaluation::{Agreement, EpisodeError, EpisodeMetrics, TracksAlike, diversity};
use crate::planner::synthesis::SynthesisConfig;
use crate::query::{Protocol, TRAJECTORY_LEN};
use crate::reward::SparseConfig;
use crate::simulate::run::{Answered, Progress, SimulateConfig};
use crate::simulate::{AnsweredTransition, Probe, simulate, simulate_dros, simulate_request};
use crate::tensor::{NotFinite, to_vec};
use crate::world::{World, WorldSpec};
use crate::world_model::{LatentState, Next, State, WorldModel, actions_tensor};

/// Seconds that an answer takes a person, whatever is done with it (the paper's Table 2).
fn seconds_an_answer(method: Protocol) -> f64 {
    match method {
        Protocol::Request | Protocol::Dros => 1.66,
        Protocol::Drop => 7.09,
        Protocol::Drope => 7.36,
        // DIFFERENCE: the paper does not tell it for several justifications.
        Protocol::Dropj | Protocol::DropjMulti => 7.88,
    }
}

/// Where trials take place.
pub struct Ground<'a> {
    /// What the world is. Its model may have been learned in one where more can happen.
    pub spec: &'a WorldSpec,
    /// What was learned of the world.
    pub model: &'a WorldModel,
    /// Through which people are stood in for.
    pub probe: &'a Probe,
    /// Opens the world itself, with driving aids or without.
    pub open: &'a dyn Fn(bool) -> Result<Box<dyn World>, String>,
}

/// How far a trial is: of what, how much of how much is done.
pub type Stage = (&'static str, usize, usize);

/// Why a trial came to nothing.
#[derive(Debug, thiserror::Error)]
pub enum TrialError {
    /// A number is none.
    #[error(transparent)]
    NotFinite(#[from] NotFinite),
    /// The world cannot be opened.
    #[error("{0}")]
    World(String),
    /// An episode broke off.
    #[error("on track {track}: {met}")]
    Episode {
        /// Its seed.
        track: u64,
        /// What it met.
        met: EpisodeError,
    },
    /// There is nothing to start dreams from.
    #[error("the world model has no states to start dreams from")]
    NoStarts,
    /// No answer says anything.
    #[error("with {0} there is no answer to learn from")]
    NoAnswers(String),
    /// What was tried cannot be kept.
    #[error("{0}")]
    Keep(String),
    /// It was told to end.
    #[error("the trial was broken off")]
    Stopped,
}

/// What a trial brought.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outcome {
    /// A row for each episode that was driven.
    pub rows: Vec<Row>,
    /// How strongly answers moved what learned from them.
    pub gradients: Vec<GradientRow>,
    /// States of labeled trajectories.
    pub states: Vec<StateRow>,
    /// How long this machine took for a trajectory: no function of the description.
    pub times: Vec<SegmentTime>,
}

impl From<Rows> for Outcome {
    fn from(rows: Rows) -> Self {
        Self { rows: rows.0, ..Self::default() }
    }
}

/// Weights that were tried before, and where more are kept.
pub struct Evaluations<'a> {
    /// As far as they are known, in their order.
    pub known: Vec<Evaluation>,
    /// Keeps all of them, so that a search that is killed goes on.
    pub keep: &'a mut dyn FnMut(&[Evaluation]) -> Result<(), String>,
}

/// What was dreamed and answered.
enum Answers {
    Pairs(Vec<Answered>),
    Steps(Vec<AnsweredTransition>),
}

impl Answers {
    fn len(&self) -> usize {
        match self {
            Self::Pairs(all) => all.len(),
            Self::Steps(all) => all.len(),
        }
    }
}

/// Runs a trial to its end. All but times follows from the description and the ground.
///
/// # Errors
/// Where a number is none, a world fails, what is tried cannot be kept, or `on_stage` breaks off.
pub fn run_trial(
    description: &Description,
    trial: &Trial,
    ground: &Ground<'_>,
    evaluations: &mut Evaluations<'_>,
    on_stage: &mut dyn FnMut(Stage) -> ControlFlow<()>,
) -> Result<Outcome, TrialError> {
    let mut variants = description.variants(trial.method);
    let config = simulation(description, trial, ground);
    let learns = variants.iter().any(|variant| variant.plans != Plans::Oracle);
    let (dreams, answers) = if learns {
        dreamed(description, trial, &config, ground, on_stage)?
    } else {
        (Vec::new(), Answers::Pairs(Vec::new()))
    };
    let features: Vec<Features> = dreams.iter().map(|dream| dream.features(ground.model)).collect();
    let trajectories = match &answers {
        Answers::Steps(all) => imagined_again(ground.model, &dreams, &features, all),
        Answers::Pairs(_) => Vec::new(),
    };
    let mut outcome = Outcome { states: states_of(description, trial, &trajectories), ..Outcome::default() };
    let learner =
        Learner { description, trial, config: &config, ground, dreams: &dreams, features: &features };
    if let (Some(search), Answers::Pairs(all)) = (&description.search, &answers) {
        let like = variants[0].clone();
        let all = &all[..like.first.unwrap_or(all.len()).min(all.len())];
        let weights = learner.searched(search, &like, all, evaluations, on_stage)?;
        variants.push(Variant { weights: weights.unwrap_or_default(), found: true, ..like });
    }
    let n_episodes = variants.len() * description.episodes as usize;
    for variant in &variants {
        let first = variant.first.unwrap_or(answers.len()).min(answers.len());
        let learned = match (&answers, variant.plans) {
            (_, Plans::Oracle) => None,
            (Answers::Pairs(all), _) => {
                Some(learner.learn_pairs(variant, &all[..first], Some(&mut outcome.gradients))?)
            }
            (Answers::Steps(all), _) => Some(learner.learn_steps(&all[..first])?),
        };
        let tracks = TracksAlike { seed: description.first_track };
        for i in 0..description.episodes {
            let track = tracks.track(i);
            let at = ("driving episodes", outcome.rows.len(), n_episodes);
            let metrics = learner.drive(variant, learned.as_ref(), track, at, on_stage)?;
            let row = row(trial, variant, first, learned.as_ref(), track, &metrics);
            outcome.rows.push(Row { diversity: spread(&trajectories), ..row });
        }
    }
    if description.times {
        outcome.times = measured(trial, ground.model, &synthesis(description))?;
    }
    Ok(outcome)
}

/// What is simulated: what can be named, and how it is planned, as the file of the world says.
fn simulation(description: &Description, trial: &Trial, ground: &Ground<'_>) -> SimulateConfig {
    let config = description.simulation(trial, ground.spec);
    SimulateConfig { planner: config.planner.clone().for_model(ground.model), ..config }
}

/// How trajectories are searched for.
fn synthesis(description: &Description) -> SynthesisConfig {
    SynthesisConfig { iterations: description.iterations, ..SynthesisConfig::paper() }
}

fn dreamed(
    description: &Description,
    trial: &Trial,
    config: &SimulateConfig,
    ground: &Ground<'_>,
    on_stage: &mut dyn FnMut(Stage) -> ControlFlow<()>,
) -> Result<(Vec<DreamEpisode>, Answers), TrialError> {
    let (model, probe) = (ground.model, ground.probe);
    let starts = model.starts();
    if starts.is_empty() {
        return Err(TrialError::NoStarts);
    }
    let mut on_progress = |progress| match progress {
        Progress::Played(done, n) => on_stage(("playing steps", done, n)),
        Progress::Decoded(done, n) => on_stage(("looking at dreams", done, n)),
        Progress::Answered(done, n) => on_stage(("answering queries", done, n)),
    };
    Ok(match trial.method {
        Protocol::Request => {
            let (synthesis, learning) = (synthesis(description), SparseConfig::request());
            let made =
                simulate_request(model, probe, config, starts, &synthesis, &learning, &mut on_progress)?;
            let made = made.ok_or(TrialError::Stopped)?;
            (made.dreams, Answers::Steps(made.answers))
        }
        Protocol::Dros => {
            let played = simulate_dros(model, probe, config, starts, &mut on_progress)?;
            let played = played.ok_or(TrialError::Stopped)?;
            (played.dreams, Answers::Steps(played.answers))
        }
        _ => {
            let played =
                simulate(model, probe, config, starts, &mut on_progress)?.ok_or(TrialError::Stopped)?;
            (played.dreams, Answers::Pairs(played.answers))
        }
    })
}

/// The latents of each trajectory that was labeled, a row a state.
///
/// Those that were played hold noise and those that were made do not, so that neighbors differ for that alone: all are imagined
/// again from where they began, in the mean.
fn imagined_again(
    model: &WorldModel,
    dreams: &[DreamEpisode],
    features: &[Features],
    answered: &[AnsweredTransition],
) -> Vec<Features> {
    const TEMPERATURE: f64 = 0.1;
    let firsts: BTreeSet<(usize, usize)> =
        answered.iter().map(|it| (it.transition.dream.0 as usize, it.transition.first)).collect();
    let fits = |&(dream, first): &(usize, usize)| first + TRAJECTORY_LEN <= dreams[dream].len();
    let firsts: Vec<_> = firsts.into_iter().filter(fits).collect();
    if firsts.is_empty() {
        return Vec::new();
    }
    let starts: Vec<LatentState> = firsts
        .iter()
        .map(|&(dream, first)| LatentState::from(&model.state_of(features[dream].row(first))))
        .collect();
    let mut state = State::side_by_side(&starts.iter().collect::<Vec<_>>());
    let mut zs = vec![to_vec(&state.z)];
    for t in 0..TRAJECTORY_LEN - 1 {
        let actions: Vec<_> = firsts.iter().map(|&(dream, first)| dreams[dream].actions[first + t]).collect();
        state = model.imagine(&state, &actions_tensor(&actions), Next::Mean { temperature: TEMPERATURE });
        zs.push(to_vec(&state.z));
    }
    let width = model.config().mdn_rnn.latent as usize;
    let of = |i: usize| {
        let values = zs.iter().flat_map(|row| &row[i * width..(i + 1) * width]).copied().collect();
        Features { width, values }
    };
    (0..firsts.len()).map(of).collect()
}

/// How diverse trajectories are, on average.
fn spread(trajectories: &[Features]) -> Option<f64> {
    let n = trajectories.len();
    (n > 0).then(|| trajectories.iter().map(diversity).sum::<f64>() / n as f64)
}

/// Some of the states of the labeled trajectories: the seed's share of what is asked for.
fn states_of(description: &Description, trial: &Trial, trajectories: &[Features]) -> Vec<StateRow> {
    let (method, seed) = (trial.method, trial.seed);
    let all = trajectories.iter().enumerate().flat_map(|(trajectory, rows)| {
        (0..rows.len()).map(move |step| {
            let z = rows.row(step).to_vec();
            StateRow { trial: trial.index, method, seed, trajectory, step, z }
        })
    });
    let n = description.states.div_ceil(description.seeds.len().max(1));
    chosen(all.collect(), n, &mut ChaCha8Rng::seed_from_u64(seed))
}

fn row(
    trial: &Trial,
    variant: &Variant,
    first: usize,
    learned: Option<&Learned>,
    track: u64,
    metrics: &EpisodeMetrics,
) -> Row {
    let agreement = learned.and_then(|learned| learned.agreement);
    let share = |n: usize, agreement: &Agreement| n as f64 / agreement.n.max(1) as f64;
    Row {
        trial: trial.index,
        method: trial.method,
        strategy: trial.strategy,
        seed: trial.seed,
        answers: if learned.is_some() { first } else { 0 },
        minutes: if learned.is_some() { first as f64 * seconds_an_answer(trial.method) / 60.0 } else { 0.0 },
        labels: learned.map_or(0, |learned| learned.n_labels),
        weights: variant.weights_shown(),
        found: variant.found,
        recorded: trial.recorded,
        world_model: BTreeMap::new(),
        critical_mistakes: variant.mistakes.critical,
        other_mistakes: variant.mistakes.other,
        annotators: variant.annotators,
        fit: variant.fit,
        planner: variant.plans,
        critical_disagreement: agreement.as_ref().map(|it| share(it.n_critical, it)),
        diversity: None,
        other_disagreement: agreement.as_ref().map(|it| share(it.n_other(), it)),
        track,
        ret: f64::from(metrics.ret),
        unsafe_rate: f64::from(metrics.unsafe_rate),
        events: metrics.events.iter().map(|figure| (figure.key(), figure.value.map(f64::from))).collect(),
        steps: metrics.n_steps,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::named;
    use crate::run::read_parameters;
    use crate::session::worlds::asset;

    #[test]
    fn answers_name_what_can_happen_in_the_world_and_not_what_can_in_that_of_its_model() {
        let read = |what: &str| {
            read_parameters(&asset(&format!("{what}-obstacle-car-racing-compact.safetensors"))).unwrap()
        };
        let (model, probe) = (WorldModel::load(read("world")).unwrap(), Probe::load(&read("probe")).unwrap());
        let description = named("q4-obstacles").unwrap();
        let spec = WorldSpec::built_in(&description.world).unwrap();
        assert!(model.spec().justifications.len() > spec.justifications.len(), "or this tells nothing");
        let ground = Ground { spec: &spec, model: &model, probe: &probe, open: &|_| Err(String::new()) };
        let config = simulation(&description, &description.trials()[0], &ground);
        let named: Vec<_> = config.justifications.iter().map(|(_, name, _)| name).collect();
        let wanted: Vec<_> =
            spec.justifications.iter().map(|it| it.name.as_str()).chain(["default"]).collect();
        assert_eq!(named, wanted);
    }
}
