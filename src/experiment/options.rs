//! What some experiments ask beside driving: how world models are learned, and how weights are searched for.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::scale::Scale;

/// No number here is larger.
const MOST: usize = 1_000_000;

/// How world models are learned from recordings. The networks are those that suit the world.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct WorldModels {
    /// Further episodes that no model learns from: losses are measured on them.
    pub held_out: usize,
    /// Steps of a recorded episode, if it is not over before; as long as the world's, where it is not said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub episode_steps: Option<usize>,
    /// Epochs of vision at the most.
    pub vae_epochs: usize,
    /// Updates in each.
    pub vae_updates: usize,
    /// Epochs of memory at the most.
    pub mdn_rnn_epochs: usize,
    /// Updates in each.
    pub mdn_rnn_updates: usize,
    /// Episodes that are driven to fit what the stand-in sees with, where the world is a built-in one; a tenth more measure it.
    pub probe_episodes: usize,
    /// Updates of that fit.
    pub probe_updates: usize,
}

impl WorldModels {
    /// What cannot be, if something cannot.
    pub(super) fn fault(&self) -> Option<String> {
        let numbers = [
            ("held-out", self.held_out),
            ("episode-steps", self.episode_steps.unwrap_or(2)),
            ("vae-epochs", self.vae_epochs),
            ("vae-updates", self.vae_updates),
            ("mdn-rnn-epochs", self.mdn_rnn_epochs),
            ("mdn-rnn-updates", self.mdn_rnn_updates),
            ("probe-episodes", self.probe_episodes.saturating_sub(1)),
            ("probe-updates", self.probe_updates),
        ];
        let (name, _) = numbers.into_iter().find(|(_, n)| !(1..=MOST).contains(n))?;
        Some(format!("{name} of [world-models] must be 1 to {MOST}, and of probe-episodes at least 2"))
    }

    pub(super) fn at(mut self, scale: Scale) -> Self {
        let (held_out, vae, mdn_rnn, episodes, updates) = match scale {
            Scale::Full => return self,
            Scale::Quick => (4, (2, 100), (4, 20), 12, 400),
            Scale::Toy => (1, (1, 2), (1, 2), 2, 4),
        };
        self.held_out = self.held_out.min(held_out);
        self.vae_epochs = self.vae_epochs.min(vae.0);
        self.vae_updates = self.vae_updates.min(vae.1);
        self.mdn_rnn_epochs = self.mdn_rnn_epochs.min(mdn_rnn.0);
        self.mdn_rnn_updates = self.mdn_rnn_updates.min(mdn_rnn.1);
        self.probe_episodes = self.probe_episodes.min(episodes);
        self.probe_updates = self.probe_updates.min(updates);
        if scale == Scale::Toy {
            self.episode_steps = Some(self.episode_steps.unwrap_or(MOST).min(120));
        }
        self
    }
}

/// How weights are searched for by CMA-ES, under soft limits: the paper's outlook (§6.2).
///
/// ```text
/// to be large: mean return − penalty · Σ_rates max(0, mean rate − limit)
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Search {
    /// Which weights are searched for, by their names: `default`, `safety` and the world's justifications.
    pub weights: Vec<String>,
    /// How often weights are tried in a trial, in whole generations.
    pub evaluations: usize,
    /// Weights in a generation.
    pub population: usize,
    /// Tracks that each is driven on.
    pub tracks: u64,
    /// The seed of the first of these, which must be others than those of `first-track`.
    pub first_track: u64,
    /// What rates are to stay below, by their columns in tables: `unsafe_rate`, and those of the world's events.
    pub limits: BTreeMap<String, f64>,
    /// What it costs in returns that a rate is above its limit by 1.
    pub penalty: f64,
}

impl Search {
    /// What cannot be, if something cannot.
    pub(super) fn fault(&self) -> Option<String> {
        if self.weights.is_empty() {
            return Some("[search] must name weights to search for".to_owned());
        }
        let numbers = [("evaluations", self.evaluations), ("tracks", self.tracks as usize)];
        if let Some((name, _)) = numbers.into_iter().find(|(_, n)| !(1..=MOST).contains(n)) {
            return Some(format!("{name} of [search] must be 1 to {MOST}"));
        }
        if !(2..=1000).contains(&self.population) {
            return Some("the population of [search] must be 2 to 1000".to_owned());
        }
        let is_limit = |limit: &f64| (0.0..=1.0).contains(limit);
        if !self.limits.values().all(is_limit) || !(0.0..=1e12).contains(&self.penalty) {
            return Some(
                "limits of [search] are shares between 0 and 1, and its penalty is 0 or more".to_owned(),
            );
        }
        None
    }

    pub(super) fn at(mut self, scale: Scale) -> Self {
        let (evaluations, population, tracks) = match scale {
            Scale::Full => return self,
            Scale::Quick => (12, 4, 1),
            Scale::Toy => (4, 2, 1),
        };
        self.evaluations = self.evaluations.min(evaluations);
        self.population = self.population.min(population);
        self.tracks = self.tracks.min(tracks);
        self
    }
}
