//! `dropj simulate --protocol dros` and `request`: sparse labels, which are verdicts on single transitions.

use std::ops::ControlFlow;
use std::time::Instant;

use anyhow::Context as _;
use dropj::app::{Command, LabelCommand};
use dropj::planner::synthesis::SynthesisConfig;
use dropj::query::{DreamId, Protocol, Verdict};
use dropj::reward::SparseConfig;
use dropj::session::{Choice, DreamSource, SessionStore};
use dropj::simulate::probe::Probe;
use dropj::simulate::run::{Progress, SimulateConfig};
use dropj::simulate::{AnsweredTransition, simulate_dros, simulate_request};
use dropj::world_model::WorldModel;
use serde_json::{Value, json};

use super::curves::Curves;
use super::learn::{Learned, learn_sparse};
use super::script::Script;
use super::words::names;

/// The paper's best model of DROS, and so many for ReQueST beside it: 45 trajectories.
pub(crate) const N_QUERIES: usize = 2205;

/// What came of it: in a sentence, for other programs, and as curves.
#[derive(Debug)]
pub(crate) struct Simulated {
    pub(crate) said: String,
    pub(crate) told: Value,
    pub(crate) curves: Curves,
}

/// Simulates, keeps everything in the session in `store`, and fits; what came of it is one sentence.
pub(crate) fn run(
    store: SessionStore,
    model: &WorldModel,
    probe: &Probe,
    config: &SimulateConfig,
    learning: &SparseConfig,
    on_progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> anyhow::Result<(Simulated, SessionStore)> {
    let [protocol] = config.protocols[..] else {
        anyhow::bail!("transitions are labeled in a session of their own: name one protocol");
    };
    let started = Instant::now();
    let simulated = if protocol == Protocol::Request {
        let synthesis = SynthesisConfig::paper();
        simulate_request(model, probe, config, model.starts(), &synthesis, learning, on_progress)
    } else {
        simulate_dros(model, probe, config, model.starts(), on_progress)
    };
    let simulated =
        simulated.context("the simulation cannot go on")?.context("the simulation was broken off")?;
    let annotator = store.header().config.annotator.clone();
    let mut script = Script::new(store, model)?;
    for (i, dream) in simulated.dreams.iter().enumerate() {
        let wanted = simulated.wanted.get(i).copied();
        let source = if wanted.is_some() { DreamSource::Synthesized } else { DreamSource::Simulated };
        script.keep_dream(dream, source, wanted)?;
    }
    let secs = started.elapsed().as_secs_f64();
    for &AnsweredTransition { query, transition, response } in &simulated.answers {
        let wanted = simulated.wanted.get(transition.dream.0 as usize);
        let choice = wanted.map_or(Choice::Uniform, |acquisition| Choice::Synthesized(*acquisition));
        script.command(Command::Label(LabelCommand::AskTransition(transition, choice)))?;
        script.answer(query, response, &annotator)?;
    }
    let dreams = (0..).map(DreamId).zip(simulated.dreams.iter().cloned()).collect();
    let Learned { parameters, fit, curves, held_out } =
        learn_sparse(script.session(), &dreams, model, learning.clone(), config.seed)?;
    script.keep_reward(parameters, &fit)?;
    let [n_unsafe, n_neutral, n_good] = Verdict::ALL.map(|verdict| simulated.n(verdict));
    let said = format!(
        "{}{}: {} dreams, {} queries, {} verdicts: {n_unsafe} unsafe, {n_neutral} neutral, {n_good} good; losses {:.4?}; \
         {secs:.0} s to make and label, {:.0} s in all",
        held_out.as_ref().map_or_else(String::new, ToString::to_string),
        names(&script.session().protocols()),
        simulated.dreams.len(),
        simulated.answers.len(),
        fit.n_labels,
        fit.losses,
        started.elapsed().as_secs_f64()
    );
    let told = json!({
        "protocols": script.session().protocols(), "dreams": simulated.dreams.len(), "queries": simulated.answers.len(),
        "labels": fit.n_labels, "unsafe": n_unsafe, "neutral": n_neutral, "good": n_good, "losses": fit.losses,
        "held_out": held_out, "secs": started.elapsed().as_secs_f64()
    });
    Ok((Simulated { said, told, curves }, script.finish()?))
}
