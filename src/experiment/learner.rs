//! What learns from the answers of a trial, and drives by what it learned.

use std::ops::ControlFlow;

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use super::description::{Annotators, Description, Trial, Variant, WeightSet};
use super::gradients::{About, GradientRow, Watch};
use super::options::Search;
use super::search::{Evaluation, evaluated, searched};
use super::trial::{Evaluations, Ground, Stage, TrialError};
use crate::dream::{DreamEpisode, Rows as Features};
use crate::evaluation::{
    Agreement, EpisodeMetrics, Oracle, PlanningPolicy, Policy, TracksAlike, evaluate_episode,
};
use crate::planner::Agent;
use crate::query::{JudgedTransition, LabeledQuery, Protocol, Response, SegmentRef, Transition, Weights};
use crate::reward::{
    EpochReport, RewardConfig, RewardModel, SparseConfig, Trainer, fit_anew_watched, fit_sparse_anew,
    segment_rows, transition_row,
};
use crate::simulate::AnsweredTransition;
use crate::simulate::run::{Answered, SimulateConfig};
use crate::tensor::NotFinite;

/// What learns from answers about these dreams, and drives.
pub(super) struct Learner<'a> {
    pub description: &'a Description,
    pub trial: &'a Trial,
    pub config: &'a SimulateConfig,
    pub ground: &'a Ground<'a>,
    pub dreams: &'a [DreamEpisode],
    pub features: &'a [Features],
}

/// A reward, and from what it was learned.
pub(super) struct Learned {
    reward: Box<dyn RewardModel>,
    pub n_labels: usize,
    /// How far the answers agree with those of the trial's own annotator.
    pub agreement: Option<Agreement>,
}

impl Learner<'_> {
    /// An episode on `track` under the planner of `variant`, by what was learned, or by the world itself.
    pub(super) fn drive(
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
        // By its number among the episodes, and not by its track: results that are kept came of these draws.
        let number = track.wrapping_sub(description.first_track);
        let agent = Agent::new(planner.clone(), number);
        let reward = learned.map(|learned| &learned.reward);
        let mut planning = reward.map(|reward| PlanningPolicy::new(ground.model, reward, agent));
        let mut oracle = Oracle::new(planner, number);
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
    pub(super) fn searched(
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
    pub(super) fn learn_pairs(
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
        let right_answer = if variant.annotators == Annotators::default() {
            *response
        } else {
            let annotator = variant.annotators.annotator();
            annotator.answer(*protocol, &self.config.justifications, left, right, &mut rng)
        };
        rng.set_stream((2 << 33) + u64::from(answered.query.id.0));
        let is_critical = !left.is_safe() || !right.is_safe();
        variant.mistakes.made(right_answer, is_critical, &mut rng)
    }

    pub(super) fn learn_steps(&self, answered: &[AnsweredTransition]) -> Result<Learned, TrialError> {
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
