//! A trial: dreams are played, queries are answered, and each variant learns and drives.

use std::collections::BTreeSet;
use std::ops::ControlFlow;

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use super::description::{Description, Plans, Trial, Variant};
use super::table::Row;
use crate::dream::{DreamEpisode, Rows as Features};
use crate::evaluation::{
    Agreement, EpisodeError, EpisodeMetrics, Oracle, PlanningPolicy, Policy, TracksAlike, diversity,
    evaluate_episode,
};
use crate::planner::Agent;
use crate::planner::synthesis::SynthesisConfig;
use crate::query::{
    JudgedTransition, LabeledQuery, Protocol, Response, SegmentRef, TRAJECTORY_LEN, Transition,
};
use crate::reward::{
    EpochReport, RewardConfig, RewardModel, SparseConfig, fit_anew, fit_sparse_anew, segment_rows,
    transition_row,
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
    /// It was told to end.
    #[error("the trial was broken off")]
    Stopped,
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

/// Runs a trial to its end: a row for each episode that was driven. All follows from the description and the ground.
///
/// # Errors
/// Where a number is none, a world fails, or `on_stage` breaks off.
pub fn run_trial(
    description: &Description,
    trial: &Trial,
    ground: &Ground<'_>,
    on_stage: &mut dyn FnMut(Stage) -> ControlFlow<()>,
) -> Result<Vec<Row>, TrialError> {
    let spec = ground.spec;
    let variants = description.variants(trial.method);
    let config = simulation(description, trial, ground);
    let learns = variants.iter().any(|variant| variant.plans != Plans::Oracle);
    let (dreams, answers) = if learns {
        dreamed(trial, &config, ground, on_stage)?
    } else {
        (Vec::new(), Answers::Pairs(Vec::new()))
    };
    let features: Vec<Features> = dreams.iter().map(|dream| dream.features(ground.model)).collect();
    let spread = match &answers {
        Answers::Steps(all) => spread(ground.model, &dreams, &features, all),
        Answers::Pairs(_) => None,
    };
    let learner = Learner { trial, config: &config, ground, dreams: &dreams, features: &features };
    let n_episodes = variants.len() * description.episodes as usize;
    let mut rows = Vec::new();
    for variant in &variants {
        let first = variant.first.unwrap_or(answers.len()).min(answers.len());
        let learned = match (&answers, variant.plans) {
            (_, Plans::Oracle) => None,
            (Answers::Pairs(all), _) => Some(learner.learn_pairs(variant, &all[..first])?),
            (Answers::Steps(all), _) => Some(learner.learn_steps(&all[..first])?),
        };
        let usual = config.planner.clone();
        let usual = if trial.method.is_sparse() { usual.for_transitions() } else { usual };
        let planner = variant.planner(usual, spec);
        let tracks = TracksAlike { seed: description.first_track };
        for i in 0..description.episodes {
            let (agent, track) = (Agent::new(planner.clone(), i), tracks.track(i));
            let reward = learned.as_ref().map(|learned| &learned.reward);
            let mut planning = reward.map(|reward| PlanningPolicy::new(ground.model, reward, agent));
            let mut oracle = Oracle::new(planner.clone(), i);
            let policy: &mut dyn Policy = match &mut planning {
                Some(planning) => planning,
                None => &mut oracle,
            };
            let mut world = (ground.open)(description.aids).map_err(TrialError::World)?;
            let longest = description.episode_steps.unwrap_or(usize::MAX);
            let driven = evaluate_episode(&mut *world, track, policy, |_, step| {
                let is_over = step.t + 1 >= longest;
                if on_stage(("driving episodes", rows.len(), n_episodes)).is_break() || is_over {
                    ControlFlow::Break(())
                } else {
                    ControlFlow::Continue(())
                }
            });
            if on_stage(("driving episodes", rows.len() + 1, n_episodes)).is_break() {
                return Err(TrialError::Stopped);
            }
            let metrics = driven.map_err(|met| TrialError::Episode { track, met })?;
            let row = row(trial, variant, first, learned.as_ref(), track, &metrics);
            rows.push(Row { diversity: spread, ..row });
        }
    }
    Ok(rows)
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

/// What learns from answers about these dreams.
struct Learner<'a> {
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
    fn learn_pairs(&self, variant: &Variant, answered: &[Answered]) -> Result<Learned, TrialError> {
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
        let go_on = |_: &EpochReport| ControlFlow::Continue(());
        let fitted =
            fit_anew(model, config, self.trial.seed, &labels, rows, go_on)?.ok_or(TrialError::Stopped)?;
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

/// How diverse the trajectories are that were labeled, on average.
///
/// Those that were played hold noise and those that were made do not, so that neighbors differ for that alone: all are imagined
/// again from where they began, in the mean.
fn spread(
    model: &WorldModel,
    dreams: &[DreamEpisode],
    features: &[Features],
    answered: &[AnsweredTransition],
) -> Option<f64> {
    const TEMPERATURE: f64 = 0.1;
    let firsts: BTreeSet<(usize, usize)> =
        answered.iter().map(|it| (it.transition.dream.0 as usize, it.transition.first)).collect();
    let fits = |&(dream, first): &(usize, usize)| first + TRAJECTORY_LEN <= dreams[dream].len();
    let firsts: Vec<_> = firsts.into_iter().filter(fits).collect();
    if firsts.is_empty() {
        return None;
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
        diversity(&Features { width, values })
    };
    Some((0..firsts.len()).map(of).sum::<f64>() / firsts.len() as f64)
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
