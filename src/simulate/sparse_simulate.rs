//! Verdicts on single transitions without a person: dreams are played or made, and every transition is looked at.

use std::ops::ControlFlow;

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use super::perception::Eyes;
use super::player::{Playing, play_all};
use super::probe::Probe;
use super::run::{Progress, SimulateConfig};
use crate::dream::DreamEpisode;
use crate::planner::synthesis::{Acquisition, ROUND, SynthesisConfig, synthesize};
use crate::query::{
    DreamId, JudgedTransition, QueryId, Response, TRAJECTORY_LEN, Transition, Verdict, sample_trajectory,
};
use crate::reward::{RewardInputs, SparseConfig, SparseReward, fit_sparse_anew, transition_row};
use crate::tensor::{NotFinite, from_slice};
use crate::world::Frame;
use crate::world_model::{LatentState, WorldModel};

/// Pictures before a transition that are played with it.
const RUN_UP: usize = 7;

/// A transition, and what was said of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnsweredTransition {
    /// The number of its query.
    pub query: QueryId,
    /// What was shown.
    pub transition: Transition,
    /// What was said.
    pub response: Response,
}

/// What came of a simulation with verdicts.
#[derive(Clone, Debug, PartialEq)]
pub struct SparseSimulation {
    /// In the order of their [`DreamId`]s.
    pub dreams: Vec<DreamEpisode>,
    /// What each was made to be. Nothing where they were played.
    pub wanted: Vec<Acquisition>,
    /// In the order of asking.
    pub answers: Vec<AnsweredTransition>,
}

impl SparseSimulation {
    /// How many transitions were called this.
    pub fn n(&self, verdict: Verdict) -> usize {
        self.answers.iter().filter(|answered| answered.response == Response::Judged(verdict)).count()
    }

    fn judged(&self) -> Vec<JudgedTransition> {
        let judged = |answered: &AnsweredTransition| match answered.response {
            Response::Judged(verdict) => {
                let &AnsweredTransition { query, transition, .. } = answered;
                Some(JudgedTransition { query, transition, verdict })
            }
            _ => None,
        };
        self.answers.iter().filter_map(judged).collect()
    }

    /// Looks at every transition of the trajectory that begins with `first`, as far as there are queries left.
    fn label(
        &mut self,
        model: &WorldModel,
        eyes: &Eyes<'_>,
        config: &SimulateConfig,
        first: Transition,
        on_progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
    ) -> ControlFlow<()> {
        let dream = &self.dreams[first.dream.0 as usize];
        let begin = first.first.saturating_sub(RUN_UP);
        let end = dream.len().min(first.first + TRAJECTORY_LEN);
        let seen = eyes.watch(&dream.frames(model, begin..end));
        let all = std::iter::successors(Some(first), |transition| transition.next(dream.len()));
        for transition in all.take(config.n_queries - self.answers.len()) {
            let query = QueryId(self.answers.len() as u32);
            // A stream of its own: what is said of one does not hang on the others.
            let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
            rng.set_stream(1 + u64::from(query.0));
            let outcome = transition.step + 1 - begin;
            let shown = seen.part(outcome.saturating_sub(RUN_UP)..outcome + 1);
            let response = config.annotator.verdict(&shown, &mut rng);
            self.answers.push(AnsweredTransition { query, transition, response });
        }
        on_progress(Progress::Answered(self.answers.len(), config.n_queries))
    }
}

/// DROS: dreams are played, trajectories are drawn from them, and all their transitions are labeled.
///
/// Nothing comes where `on_progress` breaks off. Where a number is none, that is the error.
///
/// # Panics
/// Where there is no start.
pub fn simulate_dros(
    model: &WorldModel,
    probe: &Probe,
    config: &SimulateConfig,
    starts: &[LatentState],
    on_progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<Option<SparseSimulation>, NotFinite> {
    assert!(!starts.is_empty(), "a dream needs a state to start from");
    let eyes = Eyes::new(probe, model.spec());
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    let starts: Vec<_> = starts
        .iter()
        .cycle()
        .take(config.n_dreams)
        .map(|start| (start, u64::from(rng.random::<u32>())))
        .collect();
    let steps = config.dream_steps;
    let on_step = &mut |step, _: Option<&[Frame]>| on_progress(Progress::Played(step, steps));
    let playing = Playing { n_steps: steps, manner: config.manner, learned: None };
    let dreams = play_all(model, probe, &starts, &playing, on_step)?;
    let Some(dreams) = dreams else { return Ok(None) };
    let lens: Vec<_> = (0..).map(DreamId).zip(dreams.iter().map(DreamEpisode::len)).collect();
    let mut simulated = SparseSimulation { dreams, wanted: Vec::new(), answers: Vec::new() };
    while simulated.answers.len() < config.n_queries {
        let Some(first) = sample_trajectory(&lens, &mut rng) else { return Ok(None) };
        if simulated.label(model, &eyes, config, first, on_progress).is_break() {
            return Ok(None);
        }
    }
    Ok(Some(simulated))
}

/// ReQueST: trajectories are made that are worth asking about, labeled, learned from, and made anew (method §10.1).
///
/// Nothing comes where `on_progress` breaks off. Where a number is none, that is the error.
///
/// # Panics
/// Where there is no start.
pub fn simulate_request(
    model: &WorldModel,
    probe: &Probe,
    config: &SimulateConfig,
    starts: &[LatentState],
    synthesis: &SynthesisConfig,
    learning: &SparseConfig,
    on_progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<Option<SparseSimulation>, NotFinite> {
    assert!(!starts.is_empty(), "a trajectory needs a state to start from");
    let eyes = Eyes::new(probe, model.spec());
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    let mut reward =
        SparseReward::new(RewardInputs::of(model), learning.clone(), &mut rng).on(model.backend());
    let mut simulated = SparseSimulation { dreams: Vec::new(), wanted: Vec::new(), answers: Vec::new() };
    for round in 0.. {
        let n_left = config.n_queries - simulated.answers.len();
        if n_left == 0 {
            break;
        }
        if round > 0 {
            // DIFFERENCE: the authors go on with networks that were fitted before. Like ReQueST we begin anew.
            reward = refit(model, learning, config.seed, &simulated)?;
        }
        let wanted = starts.iter().cycle().take(ROUND.min(n_left.div_ceil(TRAJECTORY_LEN - 1)));
        let wanted: Vec<_> =
            wanted.enumerate().map(|(i, start)| (start, Acquisition::of(round, i, &mut rng))).collect();
        let seen = outcomes(model, &simulated);
        let on_iteration = &mut |i| on_progress(Progress::Played(i, synthesis.iterations));
        let made = synthesize(model, &reward, &wanted, seen.as_ref(), synthesis, &mut rng, on_iteration)?;
        let Some(made) = made else { return Ok(None) };
        for (dream, (_, acquisition)) in made.into_iter().zip(&wanted) {
            let first = Transition { dream: DreamId(simulated.dreams.len() as u32), first: 0, step: 0 };
            simulated.dreams.push(dream);
            simulated.wanted.push(*acquisition);
            if simulated.label(model, &eyes, config, first, on_progress).is_break() {
                return Ok(None);
            }
        }
    }
    Ok(Some(simulated))
}

fn refit(
    model: &WorldModel,
    learning: &SparseConfig,
    seed: u64,
    simulated: &SparseSimulation,
) -> Result<SparseReward, NotFinite> {
    let features: Vec<_> = simulated.dreams.iter().map(|dream| dream.features(model)).collect();
    let row = |transition: Transition| {
        let i = transition.dream.0 as usize;
        Ok::<_, NotFinite>(transition_row(&features[i], &simulated.dreams[i].actions, transition.step))
    };
    let judged = simulated.judged();
    let fitted = fit_sparse_anew(model, learning.clone(), seed, &judged, row, |_| ControlFlow::Continue(()))?;
    Ok(fitted.map_or_else(|| unreachable!("nobody stops this fit"), |fitted| fitted.reward))
}

/// The latents that labeled transitions led to, `[N, Z]`.
fn outcomes(model: &WorldModel, simulated: &SparseSimulation) -> Option<tch::Tensor> {
    let judged = simulated.judged();
    let zs: Vec<f32> = judged
        .iter()
        .flat_map(|judged| {
            let Transition { dream, step, .. } = judged.transition;
            simulated.dreams[dream.0 as usize].zs.row(step + 1)
        })
        .copied()
        .collect();
    (!judged.is_empty()).then(|| from_slice(&zs, &[judged.len() as i64, model.config().mdn_rnn.latent]))
}

#[cfg(test)]
mod tests {
    use tch::{Device, nn};

    use super::*;
    use crate::query::Protocol;
    use crate::simulate::probe::{Net, ProbeConfig};
    use crate::world_model::{WorldModelConfig, untrained};

    fn blank() -> (WorldModel, Probe, LatentState) {
        let model = untrained(&WorldModelConfig::tiny(), &mut ChaCha8Rng::seed_from_u64(0));
        let (store, config) = (nn::VarStore::new(Device::Cpu), ProbeConfig::tiny());
        Net::new(&store.root(), config.clone(), &mut ChaCha8Rng::seed_from_u64(1));
        let probe = Probe::load(&Probe::parameters_of(&config, &store, None, String::new())).unwrap();
        (model, probe, LatentState { z: vec![0.1; 4], c: vec![0.0; 16], h: vec![0.0; 16] })
    }

    fn config(protocol: Protocol) -> SimulateConfig {
        SimulateConfig {
            n_queries: 120,
            n_dreams: 2,
            dream_steps: 60,
            ..SimulateConfig::car_racing(protocol, 3)
        }
    }

    #[test]
    fn every_transition_of_a_trajectory_is_labeled_and_the_same_seed_labels_the_same() {
        let (model, probe, start) = blank();
        let starts = [start];
        let run = || {
            let go_on = &mut |_| ControlFlow::Continue(());
            simulate_dros(&model, &probe, &config(Protocol::Dros), &starts, go_on).unwrap().unwrap()
        };
        let simulated = run();
        let places: Vec<_> = simulated.answers.iter().map(|answered| answered.transition.place()).collect();
        assert_eq!(places, (0..49).chain(0..49).chain(0..22).collect::<Vec<_>>());
        assert_eq!((simulated.dreams.len(), simulated == run()), (2, true));
    }

    #[test]
    fn trajectories_are_made_labeled_and_made_anew() {
        let (model, probe, start) = blank();
        let (starts, synthesis) = ([start], SynthesisConfig { iterations: 2, ..SynthesisConfig::paper() });
        let learning = SparseConfig { updates: 20, ..SparseConfig::tiny() };
        let config = SimulateConfig { n_queries: 16 * 49, ..config(Protocol::Request) };
        let go_on = &mut |_| ControlFlow::Continue(());
        let simulated = simulate_request(&model, &probe, &config, &starts, &synthesis, &learning, go_on)
            .unwrap()
            .unwrap();
        assert_eq!((simulated.dreams.len(), simulated.answers.len()), (16, 16 * 49), "a round and one more");
        assert!(simulated.dreams.iter().all(|dream| dream.len() == TRAJECTORY_LEN), "each of one trajectory");
    }
}
