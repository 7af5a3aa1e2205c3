//! What is told of learning while it goes on.

use std::collections::BTreeMap;
use std::ops::ControlFlow;

use serde::{Deserialize, Serialize};

/// A line of the metrics.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Record {
    /// An episode that was driven to learn, with noise.
    Episode(Finished),
    /// Episodes without noise.
    Evaluation(Evaluated),
}

/// An episode that was driven to learn. Counts are of all episodes so far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Finished {
    /// Its number, from 1.
    pub episode: u64,
    /// Steps of the world.
    pub steps: u64,
    /// Updates of the networks.
    pub updates: u64,
    /// The sum of its rewards.
    pub ret: f32,
    /// How many steps it had.
    pub n_steps: u64,
    /// Steps in which something went on that must not happen.
    pub unsafe_steps: u64,
    /// How often each event of the world was counted.
    pub events: BTreeMap<String, u64>,
    /// σ in its last action.
    pub noise: f32,
    /// The mean loss of the critic in its updates, if there were any.
    pub critic_loss: Option<f32>,
    /// The mean of what the critic was to say.
    pub value: Option<f32>,
}

/// An evaluation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluated {
    /// Steps of the world before it, all in episodes that were driven to learn.
    pub steps: u64,
    /// Updates before it.
    pub updates: u64,
    /// Of each episode, on the tracks of `deploy` from seed 0 on.
    pub returns: Vec<f32>,
    /// Their mean.
    pub ret: f32,
    /// The mean share of steps in which something went on that must not happen.
    pub unsafe_rate: f32,
    /// The mean of each event's figure, by its key in results.
    pub events: BTreeMap<String, f32>,
}

/// How far it is.
#[derive(Clone, Debug)]
pub struct Progress {
    /// Steps of the world.
    pub steps: u64,
    /// So many there will be.
    pub n_steps: u64,
    /// Updates of the networks.
    pub updates: u64,
    /// Steps in which something went on that must not happen.
    pub unsafe_steps: u64,
    /// The return of the last episode.
    pub ret: Option<f32>,
    /// Where it is evaluated: steps that were driven so, and how many there are at the most.
    pub evaluating: Option<[usize; 2]>,
    /// What was just over.
    pub record: Option<Record>,
}

/// Whoever listens. `Break` stops it.
pub type Report<'a> = dyn FnMut(&Progress) -> ControlFlow<()> + 'a;
