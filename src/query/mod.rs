//! Asking a person which of two dream segments is better, and why (Step 3 of the method).
//!
//! Plain data: no tensor, no file, and no text that a user reads but the words of [`Label`].
//! What is stored is what was *said*. The label μ is derived from it, so that other weights need no new answers.

pub mod difference;
pub mod justification;
pub mod known;
pub mod label;
pub mod response;
pub mod pool;
pub mod segment;
pub mod strategy;
pub mod transition;

pub use justification::{Active, Justification, JustificationError, Justifications};
pub use known::{KnownClips, sample_balanced, sample_least_answered};
pub use label::{Label, Shown, Weights};
pub use pool::{Pool, most_disagreed};
pub use response::{Preference, Protocol, Response, SafetyAnswer, SkipReason};
pub use segment::{DreamId, Query, QueryId, SEGMENT_LEN, SegmentRef, sample_queries};
pub use strategy::{Mix, Strategy};
pub use transition::{JudgedTransition, TRAJECTORY_LEN, Transition, Verdict, sample_trajectory};

/// A query together with what its answer means: the triple (σ⁰, σ¹, μ) of the paper, by reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LabeledQuery {
    /// What was shown.
    pub query: Query,
    /// The probability that the left segment is better.
    pub label: Label,
}
