//! What came of an experiment as curves for `TensorBoard`: a run for each series, in it a curve for each measure.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use super::description::Description;
use super::summary::series;
use super::table::Rows;
use crate::run::{Run, RunError};

/// Writes the mean of each measure over the axis, and the bounds of its interval of 95 %, a folder below `dir` for each
/// series.
///
/// Where the axis has no numbers, a series has one point, at its number.
///
/// # Errors
/// Where they cannot be written.
pub(super) fn write(dir: &Path, description: &Description, rows: &Rows) -> Result<(), RunError> {
    let mut runs: BTreeMap<String, BTreeMap<u64, Vec<(String, f32)>>> = BTreeMap::new();
    for measure in rows.measures() {
        for (name, points) in series(description, rows, &measure) {
            let run = runs.entry(name).or_default();
            for point in points {
                let named = ["", "/low", "/high"].map(|bound| format!("{}{bound}", measure.slug()));
                let values = named.into_iter().zip(point.mean).map(|(name, value)| (name, value as f32));
                run.entry(point.x.round() as u64).or_default().extend(values);
            }
        }
    }
    let mut taken = BTreeSet::new();
    for (name, steps) in runs {
        let run = Run::open(&dir.join(folder(&name, &mut taken)), false)?;
        for (step, points) in steps {
            let points: Vec<(&str, f32)> =
                points.iter().map(|(name, value)| (name.as_str(), *value)).collect();
            run.plot(step, &points)?;
        }
    }
    Ok(())
}

/// The name of a series as that of a folder that no other has.
fn folder(name: &str, taken: &mut BTreeSet<String>) -> String {
    let plain = |sign: char| if sign.is_alphanumeric() || ".-".contains(sign) { sign } else { '_' };
    let name: String = name.chars().map(plain).collect();
    let name = if name.trim_matches('.').is_empty() { "all".to_owned() } else { name };
    let mut free = name.clone();
    let mut n = 1;
    while !taken.insert(free.clone()) {
        n += 1;
        free = format!("{name}-{n}");
    }
    free
}
