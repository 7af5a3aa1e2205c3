//! The numbers of DrQ-v2.

use serde::{Deserialize, Serialize};

use super::NoiseSchedule;
use super::networks::representation;
use crate::tensor::limits::{MAX_COUNT, MAX_WIDTH, OutOfRange, within};
use crate::world::Size;

/// How DrQ-v2 learns.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DrqConfig {
    /// Of initialization, tracks, noise and samples.
    pub seed: u64,
    /// Steps of the world after which it ends; the episode that goes on then is driven to its end.
    pub steps: u64,
    /// k: how many pictures are seen at once, the last ones.
    pub stack: usize,
    /// Steps of the world for which an action is held.
    pub action_repeat: usize,
    /// Channels of each of the four convolutions.
    pub channels: i64,
    /// Numbers that the actor and the critic each make of what the encoder sees.
    pub features: i64,
    /// Units of each of the two hidden layers of the actor and of the critics.
    pub hidden: i64,
    /// Pixels by which pictures are shifted at the most, in every direction.
    pub shift: usize,
    /// γ, for an action.
    pub discount: f64,
    /// n: the actions whose rewards are summed before the critic is asked.
    pub n_step: usize,
    /// Actions that the replay buffer holds.
    pub capacity: usize,
    /// Samples of an update.
    pub batch: usize,
    /// Of all networks.
    pub learning_rate: f64,
    /// τ: how far the target network moves towards the critic with each update.
    pub target_rate: f64,
    /// Actions from one update to the next.
    pub update_every: u64,
    /// So many actions are drawn by chance at first, and nothing is learned yet.
    pub exploration_actions: u64,
    /// σ over time.
    pub noise: NoiseSchedule,
    /// c: the most that noise moves an action by in an update.
    pub noise_clip: f64,
    /// Steps of the world from one evaluation to the next.
    pub evaluate_every: u64,
    /// Episodes of an evaluation, without noise and on the same tracks each time: those of `deploy`.
    pub evaluation_episodes: u64,
}

impl DrqConfig {
    /// The published ones.
    pub fn published() -> Self {
        Self {
            seed: 0,
            steps: 3_100_000,
            stack: 3,
            action_repeat: 2,
            channels: 32,
            features: 50,
            hidden: 1024,
            shift: 4,
            discount: 0.99,
            n_step: 3,
            capacity: 1_000_000,
            batch: 256,
            learning_rate: 1e-4,
            target_rate: 0.01,
            update_every: 2,
            exploration_actions: 2000,
            noise: NoiseSchedule { from: 1.0, to: 0.1, actions: 500_000 },
            noise_clip: 0.3,
            evaluate_every: 10_000,
            evaluation_episodes: 10,
        }
    }

    /// Networks so small, and a schedule so short, that a test trains them in no time.
    pub fn tiny() -> Self {
        Self {
            steps: 120,
            stack: 2,
            channels: 4,
            features: 6,
            hidden: 16,
            shift: 2,
            capacity: 1000,
            batch: 8,
            learning_rate: 1e-3,
            exploration_actions: 12,
            noise: NoiseSchedule { from: 1.0, to: 0.1, actions: 60 },
            evaluate_every: 60,
            evaluation_episodes: 2,
            ..Self::published()
        }
    }

    /// Fails where nothing can be learned so.
    pub fn check(&self) -> Result<(), OutOfRange> {
        let most = MAX_COUNT as u64;
        within("the number of steps", self.steps, 1..=most)?;
        within("the number of pictures in a stack", self.stack, 1..=16)?;
        within("the steps of an action", self.action_repeat, 1..=1000)?;
        within("the number of channels", self.channels, 1..=MAX_WIDTH)?;
        within("the number of features", self.features, 1..=MAX_WIDTH)?;
        within("the number of hidden units", self.hidden, 1..=MAX_WIDTH)?;
        within("the pixels of a shift", self.shift, 0..=64)?;
        within("the discount", self.discount, 0.0..=1.0)?;
        within("the number of rewards in a target", self.n_step, 1..=1000)?;
        within("the capacity of the replay buffer", self.capacity, 1..=MAX_COUNT)?;
        within("the batch", self.batch, 1..=1 << 20)?;
        within("the learning rate", self.learning_rate, 1e-12..=1e3)?;
        within("the rate of the target network", self.target_rate, 0.0..=1.0)?;
        within("the actions from update to update", self.update_every, 1..=most)?;
        within("the actions of exploration", self.exploration_actions, 0..=most)?;
        within("the noise at first", self.noise.from, 0.0..=100.0)?;
        within("the noise in the end", self.noise.to, 0.0..=100.0)?;
        within("the actions over which noise falls", self.noise.actions, 0..=most)?;
        within("the clip of noise", self.noise_clip, 0.0..=100.0)?;
        within("the steps from evaluation to evaluation", self.evaluate_every, 1..=most)?;
        within("the episodes of an evaluation", self.evaluation_episodes, 0..=100_000)
    }

    /// The same, for a world that shows pictures of this size.
    pub fn check_for(&self, size: Size) -> Result<(), OutOfRange> {
        self.check()?;
        representation(self, size).map(|_| ())
    }

    /// The same but for how long it is trained and how often it is looked at, which may change on the way.
    pub(super) fn lasting(&self) -> Self {
        let Self { steps, evaluate_every, evaluation_episodes, .. } = Self::published();
        Self { steps, evaluate_every, evaluation_episodes, ..self.clone() }
    }

    /// σ at an action.
    pub(super) fn noise_at(&self, action: u64) -> f64 {
        self.noise.at(action)
    }
}
