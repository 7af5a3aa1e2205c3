//! Transitions and their order: those that were driven, and trajectories that a worker synthesizes to be asked about.

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::app::{App, Command, LabelCommand, State};
use crate::dream::{DreamEpisode, Rows};
use crate::planner::synthesis::{Acquisition, ROUND};
use crate::query::{DreamId, Protocol, TRAJECTORY_LEN, Transition, sample_trajectory};
use crate::session::{Choice, DreamSource, Event, Session};
use crate::worker::{SynthesizerCommand, WorkerCommand};
use crate::world_model::LatentState;

/// The next trajectory is begun while there is so many times as much to answer as the last one took to make: late, so
/// that it is of what was learned meanwhile, but early enough that nobody waits.
const HEADROOM: f64 = 2.0;
/// Seconds of a verdict before the first one was given.
const USUAL_SECS: f64 = 1.0;
/// The generators of trajectories have streams of their own, beyond those of queries.
const STREAMS: u64 = 1 << 32;

/// What is known of the synthesis of trajectories.
#[derive(Clone, Debug, Default)]
pub(crate) struct Synthesis {
    /// The one that is being made.
    pub ordered: Option<Ordered>,
    /// Whether none is made until somebody says so.
    pub is_stopped: bool,
    /// Seconds that the last one took.
    took: Option<f64>,
}

/// A trajectory that is being made.
#[derive(Clone, Debug)]
pub(crate) struct Ordered {
    seed: u64,
    /// When, in seconds since the window opened.
    since: f64,
    /// What it is to be.
    pub acquisition: Acquisition,
    /// How much of the work is done, in `[0, 1]`.
    pub share: f32,
}

impl App {
    /// Draws the transition that comes next where so many are `missing`: the one after the last, or the first of another
    /// trajectory.
    pub(super) fn ask_transitions(&mut self, missing: usize) {
        if missing == 0 || self.state.now < self.state.label.ask_again_at {
            return;
        }
        let Some(open) = &self.state.open else { return };
        let is_readable = |dream: DreamId| !self.state.label.unreadable.contains(&dream);
        if let Some((transition, choice)) = next_transition(&open.session, open.header.seed, is_readable) {
            self.ask_about_transition(transition, choice);
        }
    }

    /// Asks about a transition that a script has chosen.
    pub(super) fn ask_about_transition(&mut self, transition: Transition, choice: Choice) {
        let Some(query) = self.state.session().map(Session::next_query_id) else { return };
        self.record(Event::AskedTransition { query, transition, choice });
    }

    /// Has another trajectory made where the present one comes to its end.
    ///
    /// `// DIFFERENCE:` the authors make the fifteen of a round at once, by one and the same classifier, while somebody
    /// waits; here one is made while another is answered, each by what is learned by then.
    pub(super) fn synthesize_ahead(&mut self) {
        let synthesis = &self.state.label.synthesis;
        if self.state.protocol() != Protocol::Request || synthesis.ordered.is_some() || synthesis.is_stopped {
            return;
        }
        let (Some(open), Some(_)) = (&self.state.open, &self.state.world.loaded) else { return };
        if self.state.now < self.state.label.ask_again_at {
            return;
        }
        let session = &open.session;
        // Whoever has nothing to answer waits already: what was left of a deleted trajectory counts for nothing.
        let is_early = self.state.current().is_some()
            && synthesis.took.is_some_and(|took| secs_left(session) > HEADROOM * took);
        let unreadable = &self.state.label.unreadable;
        let is_one_there = session.fresh_trajectories().iter().any(|kept| !unreadable.contains(&kept.dream));
        if is_early || is_one_there {
            return;
        }
        let starts = starts(&self.state);
        if starts.is_empty() {
            return;
        }
        let number = session.n_synthesized();
        // What is made does not hang on when it was made.
        let mut rng = ChaCha8Rng::seed_from_u64(open.header.seed);
        rng.set_stream(STREAMS + number as u64);
        let acquisition = Acquisition::of(number / ROUND, number % ROUND, &mut rng);
        let seed = rng.random();
        let start = starts[number % ROUND % starts.len()].clone();
        let (reward, seen) = (self.state.reward.parameters.clone(), seen(&self.state));
        self.state.label.synthesis.ordered =
            Some(Ordered { seed, since: self.state.now, acquisition, share: 0.0 });
        let command = SynthesizerCommand::Make { start, acquisition, reward, seen, seed };
        self.send(WorkerCommand::Synthesizer(command));
    }

    pub(super) fn synthesizing(&mut self, seed: u64, done: usize, n: usize) {
        let ordered = self.state.label.synthesis.ordered.as_mut();
        if let Some(ordered) = ordered.filter(|ordered| ordered.seed == seed) {
            ordered.share = done as f32 / n.max(1) as f32;
        }
    }

    /// Keeps a trajectory, unless nobody waits for it any more.
    pub(super) fn synthesized(&mut self, episode: DreamEpisode, acquisition: Acquisition) {
        let synthesis = &mut self.state.label.synthesis;
        let Some(ordered) = synthesis.ordered.take_if(|ordered| ordered.seed == episode.seed) else { return };
        synthesis.took = Some(self.state.now - ordered.since);
        self.save_dream(episode, DreamSource::Synthesized, Some(acquisition), None);
    }

    /// Says that no trajectory came of it, and makes none before somebody wants it.
    pub(in crate::app) fn not_synthesized(&mut self, why: String) {
        let synthesis = &mut self.state.label.synthesis;
        (synthesis.ordered, synthesis.is_stopped) = (None, true);
        self.fail_with(why, vec![("Try again".to_owned(), Command::Label(LabelCommand::Synthesize(true)))]);
    }

    /// Makes trajectories where they are needed, or none.
    pub(in crate::app) fn synthesize(&mut self, is_wanted: bool) {
        let synthesis = &mut self.state.label.synthesis;
        synthesis.is_stopped = !is_wanted;
        if !is_wanted && synthesis.ordered.take().is_some() {
            self.send(WorkerCommand::Synthesizer(SynthesizerCommand::Stop));
        }
    }
}

/// The transition to ask about next in a session with this seed, and why: the one after the last, or the first of another
/// trajectory.
pub(crate) fn next_transition(
    session: &Session,
    seed: u64,
    is_readable: impl Fn(DreamId) -> bool,
) -> Option<(Transition, Choice)> {
    let protocol = session.protocol();
    let mut dreams = session.dreams_for(protocol);
    dreams.retain(|(dream, _)| is_readable(*dream));
    let len = |id| dreams.iter().find(|(dream, _)| *dream == id).map(|(_, len)| *len);
    let next = last_transition(session, protocol).and_then(|last| last.next(len(last.dream)?));
    let transition = match next {
        Some(next) => next,
        None if protocol == Protocol::Request => {
            let fresh = session.fresh_trajectories().into_iter().find(|kept| is_readable(kept.dream))?;
            Transition { dream: fresh.dream, first: 0, step: 0 }
        }
        None => {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(u64::from(session.next_query_id().0));
            sample_trajectory(&dreams, &mut rng)?
        }
    };
    Some((transition, session.choice_of(transition.dream)))
}

/// The transition that `protocol` asked about last.
fn last_transition(session: &Session, protocol: Protocol) -> Option<Transition> {
    let mut asked = session.queries().iter().rev().filter(|asked| session.is_of(asked, protocol));
    asked.find_map(|asked| asked.transition)
}

/// How long the trajectories that were begun keep whoever answers, in seconds.
fn secs_left(session: &Session) -> f64 {
    let statistics = session.statistics();
    let n = statistics.n_answered + statistics.n_skipped + statistics.n_again;
    let secs = if n == 0 { USUAL_SECS } else { f64::from(statistics.active_secs) / n as f64 };
    secs * n_left(session) as f64
}

/// How many transitions of the trajectories that were begun are left to answer.
fn n_left(session: &Session) -> usize {
    let n_asked = session.pending().filter(|asked| session.is_of(asked, Protocol::Request)).count();
    let last = last_transition(session, Protocol::Request);
    let n_unasked = last.map_or(0, |last| (TRAJECTORY_LEN - 2).saturating_sub(last.place()));
    n_asked + n_unasked
}

/// Where trajectories begin: where dreams of the session did, and wherever else they can.
fn starts(state: &State) -> Vec<&LatentState> {
    let kept = state.session().map_or(&[][..], |session| session.dreams());
    let driven = kept.iter().filter(|kept| kept.source != DreamSource::Synthesized);
    let driven = driven.filter_map(|kept| state.review.episodes.get(&kept.dream)).map(|dream| &dream.start);
    let offered = state.world.loaded.iter().flat_map(|world| &world.starts).map(|start| &start.state);
    let mut starts: Vec<&LatentState> = Vec::new();
    for start in driven.chain(offered) {
        if !starts.contains(&start) {
            starts.push(start);
        }
    }
    starts
}

/// The latents that transitions led to which were judged.
fn seen(state: &State) -> Rows {
    let mut seen = Rows::default();
    for judged in state.session().map(Session::judged).unwrap_or_default() {
        let Transition { dream, step, .. } = judged.transition;
        if let Some(dream) = state.review.episodes.get(&dream).filter(|dream| step + 1 < dream.len()) {
            seen.width = dream.zs.width;
            seen.push(dream.zs.row(step + 1));
        }
    }
    seen
}
