//! Stand-ins for people: they drive, see and answer, so that everything runs without anyone at the keys.
//!
//! In dreams they see only decoded pixels, as a person does, through a [`probe`] that was fitted on the simulator.
//! They serve tests and experiments. The reward that a user trains knows nothing of them.

mod actuation;
pub mod annotator;
pub mod fit_probe;
pub mod handover;
mod obstacle_policy;
pub mod pilot;
pub mod player;
pub mod probe;
mod query_policy;
pub mod record;
pub mod run;
pub mod sparse_simulate;

pub use annotator::{Annotator, Perception};
pub use fit_probe::{FitProbeConfig, ProbeErrors, ProbeFit, fit_probe};
pub use player::DreamPlayer;
pub use probe::{Probe, ProbeConfig, Sight};
pub use run::{Answered, SimulateConfig, Simulated, simulate};
pub use sparse_simulate::{AnsweredTransition, SparseSimulation, simulate_dros, simulate_request};
