//! `dropj simulate --protocol dros` and `request`: verdicts on single transitions.

use std::ops::ControlFlow;
use std::time::Instant;

use anyhow::Context as _;
use dropj::planner::synthesis::SynthesisConfig;
use dropj::query::{Protocol, Verdict};
use dropj::session::{Answer, Choice, DreamSource, Event, SessionStore};
use dropj::simulate::probe::Probe;
use dropj::simulate::run::{Progress, SimulateConfig};
use dropj::simulate::{AnsweredTransition, simulate_dros, simulate_request};
use dropj::world_model::WorldModel;

use super::names;
use super::refit::{fit_sparse, sparse_config};

/// The paper's best model of DROS, and so many for ReQueST beside it: 45 trajectories.
pub(super) const N_QUERIES: usize = 2205;

/// Simulates, keeps everything in `store`, and fits; what came of it is one sentence.
pub(super) fn run(
    store: &mut SessionStore,
    model: &WorldModel,
    probe: &Probe,
    config: &SimulateConfig,
    on_progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> anyhow::Result<String> {
    let [protocol] = config.protocols[..] else {
        anyhow::bail!("transitions are labeled in a session of their own: name one protocol");
    };
    let started = Instant::now();
    let learning = sparse_config(protocol);
    let simulated = if protocol == Protocol::Request {
        let synthesis = SynthesisConfig::paper();
        simulate_request(model, probe, config, model.starts(), &synthesis, &learning, on_progress)
    } else {
        simulate_dros(model, probe, config, model.starts(), on_progress)
    };
    let simulated =
        simulated.context("the simulation cannot go on")?.context("the simulation was broken off")?;
    for (i, dream) in simulated.dreams.iter().enumerate() {
        match simulated.wanted.get(i) {
            Some(acquisition) => store.save_trajectory(dream, *acquisition)?,
            None => store.save_dream(dream, DreamSource::Simulated)?,
        };
    }
    let secs = started.elapsed().as_secs_f64();
    let annotator = store.header().config.annotator.clone();
    for &AnsweredTransition { query, transition, response } in &simulated.answers {
        let wanted = simulated.wanted.get(transition.dream.0 as usize);
        let choice = wanted.map_or(Choice::Uniform, |acquisition| Choice::Synthesized(*acquisition));
        store.record(Event::AskedTransition { query, transition, choice })?;
        store.record(Event::Answered(Answer::new(query, response, 0.0, &annotator)))?;
    }
    let fit = fit_sparse(store, model, learning, config.seed)?;
    let [n_unsafe, n_neutral, n_good] = Verdict::ALL.map(|verdict| simulated.n(verdict));
    Ok(format!(
        "{}: {} dreams, {} queries, {} verdicts: {n_unsafe} unsafe, {n_neutral} neutral, {n_good} good; losses {:.4?}; \
         {secs:.0} s to make and label, {:.0} s in all",
        names(&store.session().protocols()),
        simulated.dreams.len(),
        simulated.answers.len(),
        fit.n_labels,
        fit.losses,
        started.elapsed().as_secs_f64()
    ))
}
