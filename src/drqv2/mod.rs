//! DrQ-v2, the paper's upper bound: reinforcement learning from pixels, in the real world and by its true reward.
//!
//! [Yarats et al.](#reference) learn a policy and its value off-policy, from pictures that are shifted by chance. Nothing here
//! is safe, and that is what it is measured for: how many unsafe steps such learning takes, which DROPJ does without.
//!
//! ```text
//! encoder   h = conv(stack of k pictures)                                       learned with the critic
//! actor     μ = tanh(MLP(tanh(LayerNorm(W h)))),  a = clip(μ + ε),  ε ~ N(0, σ²)
//! critic    Q₁, Q₂ of (tanh(LayerNorm(W h)), a)
//! target    y = Σ_{i<n} γ^i r_{t+i} + γ^n min(Q̄₁, Q̄₂)(h_{t+n}, clip(μ + clip(ε, ±c)))
//! losses    mean (Q₁ − y)² + mean (Q₂ − y)²,  and for the actor  −mean min(Q₁, Q₂)(h, clip(μ + clip(ε, ±c)))
//! afterward Q̄ ← τ Q + (1 − τ) Q̄
//! ```
//!
//! It counts two kinds of time: a *step* is one of the world's, an *action* is held for [`DrqConfig::action_repeat`] of them.
//!
//! # Reference
//!
//! - **DrQ-v2**: Yarats, Fergus, Lazaric, Pinto. *Mastering Visual Continuous Control: Improved Data-Augmented
//!   Reinforcement Learning.* 2021, arXiv 2107.09645. Numbers are those of its table of hyperparameters and of its
//!   published program (configuration of tasks of middling difficulty); where the two leave room, the program's.

mod agent;
mod config;
mod curve;
mod learner;
mod networks;
mod noise;
mod record;
mod replay;
#[cfg(test)]
mod tests;
mod train;

pub use agent::{AgentError, DrqAgent, DrqPolicy};
pub use config::DrqConfig;
pub use curve::{Beside, curve, tables};
pub use learner::{Learner, Losses, critic_loss};
pub use noise::{NoiseSchedule, perturbed};
pub use record::{Evaluated, Finished, Progress, Record, Report};
pub use replay::{Batch, Episode, Replay, ReplayError, n_step_return};
pub use train::{DrqError, Job, train};
