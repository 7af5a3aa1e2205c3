//! Stand-ins for people: they play, see and answer, so that everything runs without anyone at the keys.
//!
//! In dreams they see only decoded pixels, as a person does, through a [`probe`]. That of the built-in cars was fitted on
//! their simulators; that of any other world is fitted on its recordings. What is a car's here is in
//! [`world::cars`](crate::world::cars).
//! They serve tests and experiments. The reward that a user trains knows nothing of them.

pub mod annotator;
pub mod fit_probe;
pub mod handover;
pub mod perception;
pub mod player;
pub mod probe;
mod query_policy;
pub mod seen_reward;
pub mod record;
pub mod run;
pub mod sparse_simulate;

pub use annotator::Annotator;
pub use fit_probe::{EventErrors, FitProbeConfig, FitProbeError, ProbeFit, fit_car_probe, fit_event_probe};
pub use perception::{Eyes, Perception};
pub use player::DreamPlayer;
pub use probe::{Probe, ProbeConfig, Readings, Reads};
pub use run::{Answered, SimulateConfig, Simulated, simulate};
pub use seen_reward::SeenReward;
pub use sparse_simulate::{AnsweredTransition, SparseSimulation, simulate_dros, simulate_request};
