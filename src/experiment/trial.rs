//! A trial: dreams are played, queries are answered, and each variant learns and drives.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::ControlFlow;

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use super::description::{Description, Plans, Trial, Variant, WeightSet};
use super::gradients::{About, GradientRow, Watch};
use super::options::Search;
use super::search::{Evaluation, evaluated, searched};
use super::segment_times::{SegmentTime, measured};
use super::states::{StateRow, chosen};
use super::table::{Row, Rows};
use crate::dream::{DreamEpisode, Rows as Features};
use crate::evaluation::{
    Agreement, EpisodeError, EpisodeMetrics, Oracle, PlanningPolicy, Policy, TracksAlike, diversity,
    evaluate_episode,
};
use crate::planner::Agent;
use crate::planner::synthesis::SynthesisConfig;
use crate::query::{
    JudgedTransition, LabeledQuery, Protocol, Response, SegmentRef, TRAJECTORY_LEN, Transition, Weights,
};
use crate::reward::{
    EpochReport, RewardConfig, RewardModel, SparseConfig, Trainer, fit_anew_watched, fit_sparse_anew,
    segment_rows, transition_row,
};
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
        dreamed(trial, &config, ground, on_stage)?
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
        outcome.times = measured(trial, ground.model)?;
    }
    Ok(outcome)
}

/// What is simulated: what can be named, and how it is planned, as the file of the world says.
fn simulation(description: &Description, trial: &Trial, ground: &Ground<'_>) -> SimulateConfig {
    let config = description.simulation(trial, ground.spec);
    SimulateConfig { planner: config.planner.clone().for_model(ground.model), ..config }
}

fn dreamed(
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
            let (synthesis, learning) = (SynthesisConfig::paper(), SparseConfig::request());
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

/// What learns from answers about these dreams, and drives.
struct Learner<'a> {
    description: &'a Description,
    trial: &'a Trial,
    config: &'a SimulateConfig,
    ground: &'a Ground<'a>,
    dreams: &'a [DreamEpisode],
    features: &'a [Features],
}

/// A reward, and from what it was learned.
struct Learned {
    reward: Box<dyn RewardModel>,
    n_labels: usize,
    /// How far the answers agree with those of the trial's own annotator.
    agreement: Option<Agreement>,
}

impl Learner<'_> {
    /// An episode on `track` under the planner of `variant`, by what was learned, or by the world itself.
    fn drive(
        &self,
        variant: &Variant,
        learned: Option<&Learned>,
        track: u64,
        (what, done, n): Stage,
        on_stage: &mut dyn FnMut(Stage) -> ControlFlow<()>,
    ) -> Result<EpisodeMetrics, TrialError> {
        let (description, ground) = (self.description, self.ground);
        let usual = self.config.planner.clone();
        let usual = if self.trial.method.is_sparse() { usual.for_transitions() } else { usual };
        let planner = variant.planner(usual, ground.spec);
        // By its track, as where a session is deployed.
        let agent = Agent::new(planner.clone(), track);
        let reward = learned.map(|learned| &learned.reward);
        let mut planning = reward.map(|reward| PlanningPolicy::new(ground.model, reward, agent));
        let mut oracle = Oracle::new(planner, track);
        let policy: &mut dyn Policy = match &mut planning {
            Some(planning) => planning,
            None => &mut oracle,
        };
        let mut world = (ground.open)(description.aids).map_err(TrialError::World)?;
        let longest = description.episode_steps.unwrap_or(usize::MAX);
        let driven = evaluate_episode(&mut *world, track, policy, |_, step| {
            let is_over = step.t + 1 >= longest;
            if on_stage((what, done, n)).is_break() || is_over {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        });
        if on_stage((what, done + 1, n)).is_break() {
            return Err(TrialError::Stopped);
        }
        driven.map_err(|met| TrialError::Episode { track, met })
    }

    /// The best weights of a search that goes on where `evaluations` end.
    fn searched(
        &self,
        search: &Search,
        like: &Variant,
        answered: &[Answered],
        evaluations: &mut Evaluations<'_>,
        on_stage: &mut dyn FnMut(Stage) -> ControlFlow<()>,
    ) -> Result<Option<WeightSet>, TrialError> {
        let (trial, seed) = (self.trial.index, self.trial.seed);
        let tracks = TracksAlike { seed: search.first_track };
        let mut evaluate = |number: usize, weights: &WeightSet| {
            // What was tried otherwise, as by another version of the program, is tried again.
            let known = evaluations.known.get(number).filter(|known| known.weights == *weights);
            if let Some(known) = known {
                return Ok(known.worth);
            }
            evaluations.known.truncate(number);
            let variant = Variant { weights: weights.clone(), found: true, ..like.clone() };
            let learned = self.learn_pairs(&variant, answered, None)?;
            let at = ("trying weights", number, search.evaluations);
            let driven: Vec<EpisodeMetrics> = (0..search.tracks)
                .map(|i| self.drive(&variant, Some(&learned), tracks.track(i), at, on_stage))
                .collect::<Result<_, _>>()?;
            let (ret, rates, worth) = evaluated(search, &driven);
            let weights = weights.clone();
            evaluations.known.push(Evaluation { trial, seed, number, weights, ret, rates, worth });
            (evaluations.keep)(&evaluations.known).map_err(TrialError::Keep)?;
            Ok(worth)
        };
        searched(search, seed, &mut evaluate)
    }

    /// What is learned from pairs. Where the description asks for it, and there is somewhere to note them, gradients are
    /// measured meanwhile.
    fn learn_pairs(
        &self,
        variant: &Variant,
        answered: &[Answered],
        gradients: Option<&mut Vec<GradientRow>>,
    ) -> Result<Learned, TrialError> {
        let model = self.ground.model;
        let (spec, weights) = (self.ground.spec, variant.weights(self.ground.spec));
        let responses: Vec<Response> = answered.iter().map(|it| self.said(variant, it)).collect();
        let labels: Vec<LabeledQuery> = answered
            .iter()
            .zip(&responses)
            .filter_map(|(it, response)| {
                Some(LabeledQuery { query: it.query, label: weights.label(response)? })
            })
            .collect();
        if labels.is_empty() {
            return Err(TrialError::NoAnswers(format!("{} queries", answered.len())));
        }
        let rows = |segment: SegmentRef| {
            let i = segment.dream.0 as usize;
            Ok::<_, NotFinite>(segment_rows(
                &self.features[i],
                &self.dreams[i].actions,
                model.ranges(),
                segment,
            ))
        };
        let config: RewardConfig = variant.reward(&self.config.reward, spec);
        let mut watch = gradients.filter(|_| self.description.gradients);
        let about = about(answered, &responses, &weights);
        let on_epoch = |trainer: &Trainer, report: &EpochReport| match &mut watch {
            Some(rows) => {
                Watch { about: &about, like: unmeasured(self.trial, variant), rows }.look(trainer, report)
            }
            None => ControlFlow::Continue(()),
        };
        let fitted = fit_anew_watched(model, config, self.trial.seed, &labels, rows, on_epoch)?;
        let fitted = fitted.ok_or(TrialError::Stopped)?;
        let pairs: Vec<_> = answered.iter().map(|it| it.response).zip(responses).collect();
        let is_same = pairs.iter().all(|(own, said)| own == said);
        Ok(Learned {
            reward: Box::new(fitted.trainer.ensemble().for_inference()),
            n_labels: labels.len(),
            agreement: (!is_same).then(|| Agreement::of(&pairs, weights.justifications.default())).flatten(),
        })
    }

    /// What is said of a pair by whom the variant asks, and with its mistakes.
    fn said(&self, variant: &Variant, answered: &Answered) -> Response {
        let mut rng = ChaCha8Rng::seed_from_u64(self.config.seed);
        // Streams of their own, behind those of the trial's own annotator.
        rng.set_stream((1 << 33) + u64::from(answered.query.id.0));
        let Answered { protocol, left, right, response, .. } = answered;
        let right_answer = if variant.annotators == super::Annotators::default() {
            *response
        } else {
            let annotator = variant.annotators.annotator();
            annotator.answer(*protocol, &self.config.justifications, left, right, &mut rng)
        };
        rng.set_stream((2 << 33) + u64::from(answered.query.id.0));
        let is_critical = !left.is_safe() || !right.is_safe();
        variant.mistakes.made(right_answer, is_critical, &mut rng)
    }

    fn learn_steps(&self, answered: &[AnsweredTransition]) -> Result<Learned, TrialError> {
        let judged: Vec<JudgedTransition> = answered
            .iter()
            .filter_map(|&AnsweredTransition { query, transition, response }| match response {
                Response::Judged(verdict) => Some(JudgedTransition { query, transition, verdict }),
                _ => None,
            })
            .collect();
        if judged.is_empty() {
            return Err(TrialError::NoAnswers(format!("{} queries", answered.len())));
        }
        let row = |transition: Transition| {
            let i = transition.dream.0 as usize;
            Ok::<_, NotFinite>(transition_row(&self.features[i], &self.dreams[i].actions, transition.step))
        };
        let is_request = self.trial.method == Protocol::Request;
        let config = if is_request { SparseConfig::request() } else { SparseConfig::dros() };
        let go_on = |_: &EpochReport| ControlFlow::Continue(());
        let fitted = fit_sparse_anew(self.ground.model, config, self.trial.seed, &judged, row, go_on)?;
        let fitted = fitted.ok_or(TrialError::Stopped)?;
        Ok(Learned { reward: Box::new(fitted.reward), n_labels: judged.len(), agreement: None })
    }
}

/// What each answer that became a label is about, in the order of asking.
fn about(answered: &[Answered], responses: &[Response], weights: &Weights) -> Vec<About> {
    let default = weights.justifications.default();
    let mut all: Vec<_> = answered
        .iter()
        .zip(responses)
        .filter_map(|(it, response)| {
            weights.label(response)?;
            Some((it.query.id, About::of(response, default)?))
        })
        .collect();
    all.sort_by_key(|(id, _)| *id);
    all.into_iter().map(|(_, about)| about).collect()
}

/// A row of gradients without its measures.
fn unmeasured(trial: &Trial, variant: &Variant) -> GradientRow {
    GradientRow {
        trial: trial.index,
        seed: trial.seed,
        weights: variant.weights_shown(),
        fit: variant.fit,
        epoch: 0,
        about: About::Safety,
        n: 0,
        logit: 0.0,
        parameters: 0.0,
    }
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
