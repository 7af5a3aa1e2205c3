//! Experiments: grids of trials, each a pure function of its description, and what came of them.
//!
//! ```text
//! Description (TOML) → trials → rows (a JSON line for each driven episode) → tables, figures, words
//! ```
//!
//! A trial is a whole chain for one method and one seed: dreams are played, queries are answered, and from the same answers
//! each [`Variant`] learns a reward and drives. So variants are paired, and what is dreamed is dreamed once. Trials know
//! nothing of each other: any number of processes works on a folder, on this machine or on a cluster.
//!
//! Results of any kind are [`Opened`] beside each other, compared by the same tests, and drawn by the same hand.

pub mod charts;
mod curves;
pub mod comparison;
pub mod description;
pub mod figures;
pub mod folder;
pub mod gradients;
mod learner;
pub mod mistakes;
pub mod named;
pub mod options;
pub mod recorded;
pub mod scale;
pub mod search;
pub mod segment_times;
pub mod opened;
pub mod read_csv;
pub mod side_by_side;
pub mod slurm;
pub mod states;
pub mod summary;
pub mod table;
pub mod trial;

pub use charts::Figure;
pub use comparison::{Comparison, Group, Verdict};
pub use description::{
    Annotators, Axis, Description, DescriptionError, Fit, Plans, Trial, Variant, WeightSet,
};
pub use folder::Folder;
pub use mistakes::Mistakes;
pub use named::{named, names};
pub use opened::{Curves, Opened, ResultsError, Run, RunEpisode, is_results};
pub use options::{Search, WorldModels};
pub use recorded::{LearnedWorld, RecordedError, learned_world};
pub use scale::Scale;
pub use search::Evaluation;
pub use summary::{Point, Series};
pub use table::{Measure, Row, Rows};
pub use trial::{Evaluations, Ground, Outcome, Stage, TrialError, run_trial};
