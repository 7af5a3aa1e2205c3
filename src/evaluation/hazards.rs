//! How well a reward tells recorded moments in which something unsafe happens from those in which nothing does.

use crate::dataset::Episode;
use crate::dream::Rows;
use crate::evaluation::auc;
use crate::reward::{RewardModel, scaled_actions_tensor};
use crate::tensor::{from_slice, to_vec};
use crate::world::{EventKind, WorldSpec};
use crate::world_model::{State, WorldModel, actions_tensor};

/// Frames that are observed at once.
const CHUNK: usize = 32;

/// What a reward makes of the moments of one hazard.
#[derive(Clone, Debug, PartialEq)]
pub struct HazardRanking {
    /// The event, as its world calls it.
    pub event: String,
    /// Recorded steps in which it happens.
    pub n_with: usize,
    /// Recorded steps in which nothing unsafe happens.
    pub n_without: usize,
    /// The probability that a step with it has a lower reward than one without, in `[0, 1]`. None where one kind is missing.
    pub auc: Option<f64>,
    /// The mean reward of the steps with it.
    pub mean_with: Option<f64>,
    /// The mean reward of the steps in which nothing unsafe happens.
    pub mean_without: Option<f64>,
}

/// The steps of real episodes, their rewards, and what happened.
#[derive(Debug)]
pub struct HazardTally {
    /// The safety events of the world.
    events: Vec<String>,
    /// The reward of each step, and which of the events happen in it.
    steps: Vec<(f64, Vec<bool>)>,
}

impl HazardTally {
    /// Nothing yet.
    pub fn new(spec: &WorldSpec) -> Self {
        let events = spec.events_of(EventKind::Safety).map(|event| event.name.clone()).collect();
        Self { events, steps: Vec::new() }
    }

    /// Takes in an episode as a deployed planner would see it: `memory_reset` steps after it last forgot, it forgets all.
    pub fn add(
        &mut self,
        model: &WorldModel,
        reward: &impl RewardModel,
        episode: &Episode,
        memory_reset: Option<usize>,
    ) {
        let features = features(model, episode, memory_reset);
        let features = from_slice(&features.values, &[features.len() as i64, features.width as i64]);
        let scaled = scaled_actions_tensor(&episode.actions, model.ranges());
        let rewards = to_vec(&tch::no_grad(|| reward.rewards(&features, &scaled)));
        let columns: Vec<_> = self.events.iter().map(|name| episode.event(name)).collect();
        let happens =
            |t: usize| columns.iter().map(|column| column.as_ref().is_some_and(|it| it[t])).collect();
        self.steps.extend(rewards.iter().enumerate().map(|(t, &reward)| (f64::from(reward), happens(t))));
    }

    /// What came of it, an entry for each safety event of the world.
    pub fn rankings(&self) -> Vec<HazardRanking> {
        let mean = |rewards: &[f64]| {
            (!rewards.is_empty()).then(|| rewards.iter().sum::<f64>() / rewards.len() as f64)
        };
        let of = |pick: &dyn Fn(&[bool]) -> bool| -> Vec<f64> {
            self.steps.iter().filter(|(_, happens)| pick(happens)).map(|(reward, _)| *reward).collect()
        };
        let without = of(&|happens| !happens.contains(&true));
        let ranking = |(i, event): (usize, &String)| {
            let with = of(&|happens| happens[i]);
            let scored = with.iter().map(|reward| (-reward, true));
            let scored: Vec<_> = scored.chain(without.iter().map(|reward| (-reward, false))).collect();
            HazardRanking {
                event: event.clone(),
                n_with: with.len(),
                n_without: without.len(),
                auc: auc(&scored),
                mean_with: mean(&with),
                mean_without: mean(&without),
            }
        };
        self.events.iter().enumerate().map(ranking).collect()
    }
}

/// What the world model makes of each step of an episode.
fn features(model: &WorldModel, episode: &Episode, memory_reset: Option<usize>) -> Rows {
    let n = episode.actions.len();
    let mut rows = Rows { width: model.config().n_features() as usize, values: Vec::new() };
    let mut memory = model.no_memory(1);
    for from in (0..n).step_by(CHUNK) {
        let zs = model.observe(&episode.frames[from..n.min(from + CHUNK)]);
        for t in from..n.min(from + CHUNK) {
            if memory_reset.is_some_and(|every| every > 0 && t % every == 0) {
                memory = model.no_memory(1);
            }
            let state = State { z: zs.narrow(0, (t - from) as i64, 1), memory };
            rows.push(&to_vec(&state.features()));
            memory = model.remember(&state, &actions_tensor(&episode.actions[t..=t]));
        }
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hazards_are_ranked_against_moments_in_which_nothing_happens() {
        // Grass lies below three of the four safe moments, and ties with none; a chuckhole looks as good as the road.
        let step = |reward, grass, chuckhole| (reward, vec![grass, chuckhole]);
        let tally = HazardTally {
            events: vec!["grass".to_owned(), "chuckhole".to_owned()],
            steps: vec![
                step(-0.1, false, false),
                step(0.1, false, false),
                step(0.2, false, false),
                step(0.3, false, false),
                step(0.0, true, false),
                step(0.2, false, true),
                step(0.2, false, true),
            ],
        };
        let [grass, chuckhole] = &tally.rankings()[..] else { panic!("two events") };
        assert_eq!((grass.n_with, grass.n_without, grass.auc), (1, 4, Some(0.75)));
        assert_eq!((chuckhole.n_with, chuckhole.auc, chuckhole.mean_with), (2, Some(0.375), Some(0.2)));
        assert_eq!(chuckhole.mean_without, Some(0.125));
        let none = HazardTally { steps: vec![], ..tally };
        assert_eq!((none.rankings()[0].auc, none.rankings()[0].mean_with), (None, None));
    }
}
