//! How long this machine takes until there is a trajectory of 50 states to be labeled: one that is played, or one that is made.
//!
//! A clock is read here, so that what comes is no pure function of a description: it stands apart from all results.

use std::fmt::Write as _;
use std::ops::ControlFlow;
use std::time::Instant;

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::description::Trial;
use super::table::{csv, said};
use super::trial::TrialError;
use crate::dream::Dream;
use crate::planner::synthesis::{Acquisition, SynthesisConfig, synthesize};
use crate::query::{Protocol, TRAJECTORY_LEN};
use crate::reward::{RewardInputs, SparseConfig, SparseReward};
use crate::world::Action;
use crate::world_model::WorldModel;

/// So many that are played are measured, and the least time counts: what else the machine does only adds to it.
const PLAYED: usize = 10;

/// How long a trajectory took.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SegmentTime {
    /// The number of its trial.
    pub trial: usize,
    /// Whose way it was made.
    pub method: Protocol,
    /// The seed of the chain.
    pub seed: u64,
    /// Seconds of this machine, on one thread.
    pub seconds: f64,
    /// Seconds of a person who plays it at the world's rate; 0 where it is made.
    pub played: f64,
}

/// Measures it for the method of `trial`. Nothing for methods that do not label trajectories.
///
/// A played one is 50 steps of a dream, each decoded, as it is shown. One that is made is searched for alone and from all ten
/// beginnings, by a reward that has learned nothing, which takes as long as any other.
pub(super) fn measured(
    trial: &Trial,
    model: &WorldModel,
    synthesis: &SynthesisConfig,
) -> Result<Vec<SegmentTime>, TrialError> {
    let (method, seed) = (trial.method, trial.seed);
    let Some(start) = model.starts().first() else { return Err(TrialError::NoStarts) };
    let rng = &mut ChaCha8Rng::seed_from_u64(seed);
    let (seconds, played) = match method {
        Protocol::Dros => {
            let mut least = f64::INFINITY;
            for _ in 0..PLAYED {
                let began = Instant::now();
                let mut dream = Dream::new(start, seed);
                for _ in 0..TRAJECTORY_LEN {
                    dream.step(model, Action::new(model.spec().neutral()), rng)?;
                    drop(dream.frame(model));
                }
                least = least.min(began.elapsed().as_secs_f64());
            }
            (least, TRAJECTORY_LEN as f64 / model.spec().rate)
        }
        Protocol::Request => {
            let reward = SparseReward::new(RewardInputs::of(model), SparseConfig::request(), rng);
            let wanted = [(start, Acquisition::Uncertainty)];
            let began = Instant::now();
            let go_on = &mut |_| ControlFlow::Continue(());
            synthesize(model, &reward, &wanted, None, synthesis, rng, go_on)?;
            (began.elapsed().as_secs_f64(), 0.0)
        }
        _ => return Ok(Vec::new()),
    };
    Ok(vec![SegmentTime { trial: trial.index, method, seed, seconds, played }])
}

/// As a table.
pub(super) fn to_csv(times: &[SegmentTime]) -> String {
    let column = |name: &str, of: &dyn Fn(&SegmentTime) -> String| {
        (name.to_owned(), times.iter().map(of).collect::<Vec<_>>())
    };
    csv(&[
        column("trial", &|row| row.trial.to_string()),
        column("method", &|row| said(&row.method)),
        column("seed", &|row| row.seed.to_string()),
        column("seconds", &|row| format!("{:.4}", row.seconds)),
        column("played", &|row| format!("{:.2}", row.played)),
    ])
}

/// In words.
pub(super) fn words(times: &[SegmentTime], iterations: usize) -> String {
    let mut text = "\n## Time for a trajectory of 50 states\n\nMeasured by the clock of this machine, one thread each, and so not the \
                    same when it is run again (`times.csv`).\n\n"
        .to_owned();
    for method in [Protocol::Dros, Protocol::Request] {
        let of: Vec<&SegmentTime> = times.iter().filter(|time| time.method == method).collect();
        let Some(played) = of.first().map(|time| time.played) else { continue };
        let mean = of.iter().map(|time| time.seconds).sum::<f64>() / of.len() as f64;
        let what = if played > 0.0 {
            format!("to imagine and show what a person plays in {played:.1} s")
        } else {
            format!(
                "to search for one from ten beginnings, {iterations} iterations (the paper: 193.6 s, of 200)"
            )
        };
        let _ = writeln!(text, "- {}: {mean:.2} s {what}; the mean of {} trials.", method.name(), of.len());
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_said_of_each_method_that_labels_trajectories() {
        let time = |trial, method, seconds, played| SegmentTime { trial, method, seed: 3, seconds, played };
        let times = [
            time(0, Protocol::Dros, 0.2, 1.0),
            time(1, Protocol::Request, 30.0, 0.0),
            time(3, Protocol::Request, 40.0, 0.0),
        ];
        let text = words(&times, 200);
        assert!(
            text.contains("- DROS: 0.20 s to imagine and show what a person plays in 1.0 s; the mean of 1"),
            "{text}"
        );
        assert!(text.contains("- ReQueST: 35.00 s"), "{text}");
        assert!(to_csv(&times).ends_with("\n3,request,3,40.0000,0.00\n"), "{}", to_csv(&times));
    }
}
