//! Experiments: grids of trials, each a pure function of its description, and what came of them.
//!
//! ```text
//! Description (TOML) → trials → rows (a JSON line for each driven episode) → tables, figures, words
//! ```
//!
//! A trial is a whole chain for one method and one seed: dreams are played, queries are answered, and from the same answers
//! each [`Variant`] learns a reward and drives. So variants are paired, and what is dreamed is dreamed once. Trials know
//! nothing of each other: any number of processes works on a folder, on this machine or on a cluster.

mod curves;
pub mod description;
pub mod figures;
pub mod folder;
pub mod mistakes;
pub mod named;
pub mod slurm;
pub mod summary;
pub mod table;
pub mod trial;

pub use description::{
    Annotators, Axis, Description, DescriptionError, Fit, Plans, Scale, Trial, Variant, WeightSet,
};
pub use folder::Folder;
pub use mistakes::Mistakes;
pub use named::{named, names};
pub use table::{Row, Rows};
pub use trial::{Ground, Stage, TrialError, run_trial};
