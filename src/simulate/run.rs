//! The steps between the world model and the reward without a person: dreams are played, queries drawn and answered.

use std::collections::BTreeMap;
use std::ops::ControlFlow;

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::annotator::Annotator;
use super::handover::Learned;
use super::perception::{Eyes, Perception};
use super::player::{Manner, Playing, play_all};
use super::probe::Probe;
use super::query_policy::QueryPolicy;
use crate::dream::DreamEpisode;
use crate::planner::PlannerConfig;
use crate::query::{
    Justifications, LabeledQuery, Protocol, Query, QueryId, Response, SEGMENT_LEN, SegmentRef, Strategy,
    Weights, sample_queries,
};
use crate::reward::{EpochReport, RewardConfig, fit_anew, segment_rows};
use crate::tensor::{NotFinite, from_slice};
use crate::world::{Frame, WorldSpec};
use crate::world_model::{LatentState, WorldModel};

/// Pictures that are decoded together.
const DECODED: usize = 100;

/// What is played and asked.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulateConfig {
    /// Which questions are asked: one after the other, each for its share of the queries.
    pub protocols: Vec<Protocol>,
    /// What may be named where several justifications are asked for.
    pub justifications: Justifications,
    /// Queries. Those that are skipped count, as in the paper.
    pub n_queries: usize,
    /// Dreams. Paper: 10.
    pub n_dreams: usize,
    /// Steps of a dream. Paper: 1000.
    pub dream_steps: usize,
    /// In how many rounds: each plays its share of the dreams and answers its share of the queries, about those dreams.
    /// From the second on, the planner drives in turns with the player, by what was learned so far. Paper: 1.
    // DIFFERENCE: with more than one, what is dreamed depends on the answers. In the paper it does not.
    #[serde(default = "one")]
    pub n_rounds: usize,
    /// What the player is after.
    #[serde(default)]
    pub manner: Manner,
    /// How the planner looks ahead in its turns.
    #[serde(default = "PlannerConfig::paper")]
    pub planner: PlannerConfig,
    /// Of everything drawn.
    pub seed: u64,
    /// Who answers.
    pub annotator: Annotator,
    /// How queries are chosen.
    #[serde(default)]
    pub strategy: Strategy,
    /// What learns from the answers of one round, for the next.
    #[serde(default = "RewardConfig::car_racing")]
    pub reward: RewardConfig,
}

impl SimulateConfig {
    /// The paper's 500 queries over 10 dreams.
    pub fn car_racing(protocol: Protocol, seed: u64) -> Self {
        Self {
            protocols: vec![protocol],
            justifications: Weights::paper().justifications,
            n_queries: 500,
            n_dreams: 10,
            dream_steps: 1000,
            n_rounds: 1,
            manner: Manner::Exploring,
            planner: PlannerConfig::car_racing(),
            seed,
            annotator: Annotator::careful(),
            strategy: Strategy::Uniform,
            reward: RewardConfig::car_racing(),
        }
    }

    /// In a world: as in the paper's first, or where several things must not happen, as in its others, with 1000 queries
    /// over 30 dreams, or of more than two things with 1500 over 60.
    ///
    /// `// DIFFERENCE:` where several things must not happen, queries are about what was answered least. By chance, of a
    /// thousand answers 726 named grass and 101 a chuckhole, and a reward hardly knew chuckholes (assets/results).
    pub fn of(spec: &WorldSpec, protocol: Protocol, seed: u64) -> Self {
        let (justifications, planner) = (Weights::of(spec).justifications, PlannerConfig::of(spec, None));
        let usual = Self { justifications, planner, ..Self::car_racing(protocol, seed) };
        let strategy = Strategy::LeastAnswered;
        match spec.justifications.len() {
            0 | 1 => usual,
            2 => Self { n_queries: 1000, n_dreams: 30, strategy, ..usual },
            _ => Self { n_queries: 1500, n_dreams: 60, strategy, ..usual },
        }
    }
}

/// The paper's number of rounds.
fn one() -> usize {
    1
}

/// Where a simulation stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// So many of so many steps of all dreams are played.
    Played(usize, usize),
    /// So many of so many dreams are decoded.
    Decoded(usize, usize),
    /// So many of so many queries are answered.
    Answered(usize, usize),
}

/// A query, what was seen in its clips, and what was said.
#[derive(Clone, Debug, PartialEq)]
pub struct Answered {
    /// What was shown.
    pub query: Query,
    /// What was asked.
    pub protocol: Protocol,
    /// How it was chosen.
    pub strategy: Strategy,
    /// What was seen on the left.
    pub left: Perception,
    /// What was seen on the right.
    pub right: Perception,
    /// What was said.
    pub response: Response,
}

/// What came of a simulation: what a session holds before the reward is fitted.
#[derive(Clone, Debug, PartialEq)]
pub struct Simulated {
    /// In the order of their [`DreamId`](crate::query::DreamId)s.
    pub dreams: Vec<DreamEpisode>,
    /// In the order of asking.
    pub answers: Vec<Answered>,
}

impl Simulated {
    /// Share of the clips that were shown that are not [safe](Perception::is_safe), in `[0, 1]`.
    pub fn unsafe_share(&self) -> f64 {
        let clips = self.answers.iter().flat_map(|answered| [&answered.left, &answered.right]);
        let n_unsafe = clips.filter(|clip| !clip.is_safe()).count();
        n_unsafe as f64 / (2 * self.answers.len()).max(1) as f64
    }

    /// The reward learned from the answers so far.
    fn learned(&self, model: &WorldModel, config: &SimulateConfig) -> Result<Learned, NotFinite> {
        let weights = weights(config);
        let label = |answered: &Answered| {
            Some(LabeledQuery { query: answered.query, label: weights.label(&answered.response)? })
        };
        let labels: Vec<_> = self.answers.iter().filter_map(label).collect();
        let features: Vec<_> = self.dreams.iter().map(|dream| dream.features(model)).collect();
        let rows = |segment: SegmentRef| {
            let i = segment.dream.0 as usize;
            Ok::<_, NotFinite>(segment_rows(&features[i], &self.dreams[i].actions, model.ranges(), segment))
        };
        let go_on = |_: &EpochReport| ControlFlow::Continue(());
        let fitted = fit_anew(model, config.reward.clone(), config.seed, &labels, rows, go_on)?;
        let fitted = fitted.unwrap_or_else(|| unreachable!("nobody stops this fit"));
        Ok(Learned { reward: fitted.trainer.ensemble().for_inference(), planner: config.planner.clone() })
    }
}

/// Plays and answers, all decided by the seed. Dreams begin at the `starts` in turn.
///
/// Nothing comes where `on_progress` breaks off. Where a number is none, that is the error.
///
/// # Panics
/// Where there is no start, no protocol, or a round without a dream.
pub fn simulate(
    model: &WorldModel,
    probe: &Probe,
    config: &SimulateConfig,
    starts: &[LatentState],
    on_progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<Option<Simulated>, NotFinite> {
    assert!(!starts.is_empty(), "a dream needs a state to start from");
    let eyes = Eyes::new(probe, model.spec());
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    let starts: Vec<_> = starts
        .iter()
        .cycle()
        .take(config.n_dreams)
        .map(|start| (start, u64::from(rng.random::<u32>())))
        .collect();
    let weights = weights(config);
    // It learns often, and the paper's members suffice to disagree.
    let members = config.reward.members.min(RewardConfig::car_racing().members);
    let asking = RewardConfig { members, ..config.reward.clone() };
    let mut policy = QueryPolicy::new(model, config.strategy, &config.justifications, &asking, config.seed);
    let mut simulated = Simulated { dreams: Vec::new(), answers: Vec::new() };
    let mut pictures = Vec::new();
    for round in 0..config.n_rounds {
        let share = |n: usize| n * round / config.n_rounds..n * (round + 1) / config.n_rounds;
        let learned = (round > 0).then(|| simulated.learned(model, config)).transpose()?;
        let (steps, n_dreams) = (config.dream_steps, config.n_dreams);
        let these = &starts[share(n_dreams)];
        let mut seen: Vec<BTreeMap<usize, Frame>> = vec![BTreeMap::new(); these.len()];
        let on_step = &mut |step: usize, view: Option<&[Frame]>| {
            for (seen, frame) in seen.iter_mut().zip(view.into_iter().flatten()) {
                seen.insert(step - 1, frame.clone());
            }
            on_progress(Progress::Played(step, steps))
        };
        let playing = Playing { n_steps: steps, manner: config.manner, learned: learned.as_ref() };
        let dreams = play_all(model, probe, these, &playing, on_step)?;
        let Some(mut dreams) = dreams else { return Ok(None) };
        for (dream, seen) in dreams.iter_mut().zip(seen) {
            pictures.push(decoded(model, dream, seen));
            if config.strategy == Strategy::SafetyBoundary {
                dream.unsafe_marks = eyes.watch(&pictures[pictures.len() - 1]).marks();
            }
            if on_progress(Progress::Decoded(pictures.len(), n_dreams)).is_break() {
                return Ok(None);
            }
        }
        policy.add_dreams(model, &dreams);
        simulated.dreams.extend(dreams);
        let queries = share(config.n_queries);
        let first = QueryId(queries.start as u32);
        for query in sample_queries(policy.lens(), queries.len(), first, &mut rng) {
            let answered = answer(config, &eyes, &pictures, policy.choose(query));
            policy.observe(answered.query, answered.response, weights.label(&answered.response))?;
            simulated.answers.push(answered);
            let n_answers = simulated.answers.len();
            if on_progress(Progress::Answered(n_answers, config.n_queries)).is_break() {
                return Ok(None);
            }
        }
    }
    Ok(Some(simulated))
}

/// The weights of the answers.
fn weights(config: &SimulateConfig) -> Weights {
    Weights { justifications: config.justifications.clone(), ..Weights::paper() }
}

/// What the annotator says to a query about dreams that look like `pictures`.
fn answer(
    config: &SimulateConfig,
    eyes: &Eyes<'_>,
    pictures: &[Vec<Frame>],
    (query, strategy): (Query, Strategy),
) -> Answered {
    let SimulateConfig { annotator, protocols, justifications, .. } = config;
    let clip = |SegmentRef { dream, start }| &pictures[dream.0 as usize][start..start + SEGMENT_LEN];
    let [left, right] = [query.left, query.right].map(|at| eyes.watch(clip(at)));
    // A stream of its own: what is said to one query does not hang on the others.
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    rng.set_stream(1 + u64::from(query.id.0));
    let protocol = protocols[query.id.0 as usize * protocols.len() / config.n_queries];
    let response = annotator.answer(protocol, justifications, &left, &right, &mut rng);
    Answered { query, protocol, strategy, left, right, response }
}

/// Every picture of a dream, of which some were `seen` while it was played.
fn decoded(model: &WorldModel, dream: &DreamEpisode, mut seen: BTreeMap<usize, Frame>) -> Vec<Frame> {
    let missing: Vec<usize> = (0..dream.len()).filter(|t| !seen.contains_key(t)).collect();
    for steps in missing.chunks(DECODED) {
        let zs: Vec<f32> = steps.iter().flat_map(|t| dream.zs.row(*t)).copied().collect();
        let frames = model.decode(&from_slice(&zs, &[steps.len() as i64, dream.zs.width as i64]));
        seen.extend(steps.iter().copied().zip(frames));
    }
    seen.into_values().collect()
}

#[cfg(test)]
mod tests {
    use tch::{Device, nn};

    use super::*;
    use crate::simulate::player::play;
    use crate::simulate::probe::{Net, ProbeConfig};
    use crate::world_model::{WorldModelConfig, untrained};

    /// A probe, a world and a place in it, none of which has learned anything.
    fn blank() -> (WorldModel, Probe, LatentState) {
        let model = untrained(&WorldModelConfig::tiny(), &mut ChaCha8Rng::seed_from_u64(0));
        let (store, config) = (nn::VarStore::new(Device::Cpu), ProbeConfig::tiny());
        Net::new(&store.root(), config.clone(), &mut ChaCha8Rng::seed_from_u64(1));
        let probe = Probe::load(&Probe::parameters_of(&config, &store, None, String::new())).unwrap();
        (model, probe, LatentState { z: vec![0.1; 4], c: vec![0.0; 16], h: vec![0.0; 16] })
    }

    #[test]
    fn the_same_seed_simulates_the_same() {
        let (model, probe, start) = blank();
        let config = SimulateConfig {
            n_queries: 6,
            n_dreams: 2,
            n_rounds: 2,
            dream_steps: 40,
            reward: RewardConfig::tiny(),
            ..SimulateConfig::car_racing(Protocol::Dropj, 3)
        };
        let run = |config: &SimulateConfig| {
            let go_on = &mut |_| ControlFlow::Continue(());
            simulate(&model, &probe, config, std::slice::from_ref(&start), go_on).unwrap()
        };

        let first = run(&config).unwrap();

        assert_eq!((first.dreams.len(), first.answers.len()), (2, 6));
        assert!(
            first.dreams.iter().all(|dream| dream.len() == 40 && dream.zs.len() == 40),
            "every step is kept"
        );
        assert_eq!(run(&config), Some(first.clone()));
        let asked_about = |answered: &Answered| [answered.query.left.dream.0, answered.query.right.dream.0];
        let wanted = [[0, 0]; 3].into_iter().chain([[1, 1]; 3]);
        assert!(first.answers.iter().map(asked_about).eq(wanted), "each round asks about its own dreams");
        let protocols = vec![Protocol::Drop, Protocol::Drope, Protocol::Dropj];
        let asked = run(&SimulateConfig { protocols: protocols.clone(), ..config.clone() }).unwrap().answers;
        assert_eq!(asked.iter().step_by(2).map(|a| a.protocol).collect::<Vec<_>>(), protocols);
        assert_ne!(run(&SimulateConfig { seed: 4, ..config }), Some(first));
    }

    #[test]
    fn a_simulation_asks_as_it_was_told() {
        let (model, probe, start) = blank();
        let annotator = Annotator { eps_skip: None, ..Annotator::careful() };
        let run = |strategy| {
            let config = SimulateConfig {
                n_queries: 30,
                n_dreams: 2,
                n_rounds: 2,
                dream_steps: 60,
                annotator,
                strategy,
                reward: RewardConfig::tiny(),
                ..SimulateConfig::car_racing(Protocol::Dropj, 3)
            };
            let go_on = &mut |_| ControlFlow::Continue(());
            simulate(&model, &probe, &config, std::slice::from_ref(&start), go_on).unwrap().unwrap()
        };
        let by_chance = run(Strategy::Uniform);
        let by_doubt = run(Strategy::Disagreement);
        assert!(by_chance.answers.iter().all(|answered| answered.strategy == Strategy::Uniform));
        for (i, (one, other)) in by_chance.answers.iter().zip(&by_doubt.answers).enumerate() {
            let wanted = if i < 10 { Strategy::Uniform } else { Strategy::Disagreement };
            assert_eq!((other.strategy, other.query.id), (wanted, one.query.id), "ten answers come first");
            assert_eq!(one.query == other.query, i < 10);
        }
        let balanced = run(Strategy::Balanced);
        assert!(balanced.answers.iter().all(|answered| answered.strategy == Strategy::Balanced));
        let least = run(Strategy::LeastAnswered);
        assert!(least.answers.iter().all(|answered| answered.strategy == Strategy::LeastAnswered));
        let near = run(Strategy::SafetyBoundary);
        let has_marks = near.dreams.iter().any(|dream| !dream.unsafe_marks.is_empty());
        let wanted = if has_marks { Strategy::SafetyBoundary } else { Strategy::Uniform };
        assert!(near.answers.iter().all(|answered| answered.strategy == wanted));
    }

    #[test]
    fn the_planner_drives_from_the_second_round_on() {
        let (model, probe, start) = blank();
        let config = SimulateConfig {
            n_queries: 16,
            n_dreams: 8,
            n_rounds: 2,
            dream_steps: 30,
            reward: RewardConfig::tiny(),
            ..SimulateConfig::car_racing(Protocol::Drope, 3)
        };
        let go_on = &mut |_| ControlFlow::Continue(());
        let dreams = simulate(&model, &probe, &config, &[start], go_on).unwrap().unwrap().dreams;
        let is_planned: Vec<_> = dreams.iter().map(|dream| dream.n_planned() > 0).collect();
        assert_eq!(is_planned[..4], [false; 4]);
        assert!(is_planned[4..].contains(&true), "{is_planned:?}");
    }

    #[test]
    fn a_simulation_can_be_broken_off() {
        let (model, probe, start) = blank();
        let config = SimulateConfig::car_racing(Protocol::Dropj, 0);

        let stopped = simulate(&model, &probe, &config, &[start], &mut |_| ControlFlow::Break(()));

        assert_eq!(stopped, Ok(None));
    }

    #[test]
    fn a_dream_is_played_from_its_start() {
        let (model, probe, start) = blank();

        let dream = play(&model, &probe, &start, 30, 5).unwrap();

        assert_eq!((dream.len(), dream.zs.row(0)), (30, &start.z[..]));
        assert_eq!(Ok(&dream), play(&model, &probe, &start, 30, 5).as_ref());
        assert_ne!(dream.actions, play(&model, &probe, &start, 30, 6).unwrap().actions, "another player");
    }
}
