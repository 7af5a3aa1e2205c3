//! Stand-ins for people: they drive, see and answer, so that everything runs without anyone at the keys.
//!
//! In dreams they see only decoded pixels, as a person does, through a [`probe`] that was fitted on the simulator.
//! They serve tests and experiments; the reward that a user teaches knows nothing of them.

pub mod annotator;
mod asker;
pub mod fit_probe;
mod encounter;
mod hand;
pub mod pilot;
pub mod player;
pub mod probe;
pub mod record;
pub mod run;
pub mod turns;
pub mod verdicts;

pub use annotator::{Annotator, Judgement};
pub use fit_probe::{FitProbeConfig, ProbeErrors, ProbeFit, fit_probe};
pub use player::DreamPlayer;
pub use probe::{Probe, ProbeConfig, Sight};
pub use run::{Answered, SimulateConfig, Simulated, simulate};
pub use verdicts::{AnsweredTransition, SimulatedVerdicts, simulate_dros, simulate_request};
