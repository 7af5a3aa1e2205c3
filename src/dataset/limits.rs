//! What an episode can sanely be: the one place that says so, for all that is read from files, before it is allocated.

use std::collections::BTreeMap;

use super::EpisodeInfo;
use super::damage::OutOfLimits;
use super::notes::{ACTION, IMAGE, Notes, STATE};
use super::stats::Stats;
use crate::env::Action;

/// Steps of an episode. Ours have at most a thousand.
pub(super) const STEPS: usize = 100_000;
/// Pixels a side of a frame. Ours have 84 or 128.
pub(super) const SIDE: u32 = 1024;
/// Bytes of all frames of an episode, as they are in memory.
const FRAMES_BYTES: usize = 4 << 30;
/// Bytes of the footer of an episode file, which holds a frame.
pub(super) const FOOTER_BYTES: usize = 16 << 20;
/// Bytes of an episode file, and of a journal.
pub(super) const FILE_BYTES: u64 = 2 << 30;
/// Bytes of a name: of an environment, of a driver.
const NAME_BYTES: usize = 256;
/// Sensors of a car.
pub(super) const SENSORS: usize = 64;

/// The most bytes that a page of `n_values` numbers takes.
pub(super) fn page_bytes(n_values: usize) -> usize {
    (64 << 10) + 16 * n_values
}

/// Why these cannot be the notes of an episode of `n_rows` steps.
pub(super) fn check_notes(notes: &Notes, n_rows: i64) -> Result<(), OutOfLimits> {
    check_info(&notes.info)?;
    check_sensors(&notes.state)?;
    let Notes { n_steps, side, .. } = *notes;
    if !(1..=STEPS).contains(&n_steps) || i64::try_from(n_steps) != Ok(n_rows) {
        return Err(OutOfLimits::Steps { n_steps, n_rows });
    }
    if !(1..=SIDE).contains(&side) {
        return Err(OutOfLimits::Side(side));
    }
    let frame_bytes = 3 * (side as usize).pow(2);
    if frame_bytes.saturating_mul(n_steps + 1) > FRAMES_BYTES {
        return Err(OutOfLimits::Frames { n_steps, side });
    }
    // A part of the name of a file.
    let is_name = |byte: u8| byte.is_ascii_alphanumeric() || b"-_".contains(&byte);
    if !(1..=64).contains(&notes.recording.len()) || !notes.recording.bytes().all(is_name) {
        return Err(OutOfLimits::Recording(notes.recording.clone()));
    }
    let mut driven = 0;
    for &[from, to] in &notes.planned {
        if from < driven || to <= from || to > n_steps {
            return Err(OutOfLimits::Planned { from, to, n_steps });
        }
        driven = to;
    }
    if notes.truncated && !notes.done {
        return Err(OutOfLimits::End);
    }
    check_stats(notes)
}

/// Why this cannot be who drove where.
pub(super) fn check_info(info: &EpisodeInfo) -> Result<(), OutOfLimits> {
    for (what, name) in [("environment", &info.env), ("driver", &info.pilot)] {
        if name.len() > NAME_BYTES || name.chars().any(char::is_control) {
            return Err(OutOfLimits::Name { what, n_bytes: name.len() });
        }
    }
    Ok(())
}

/// Why these cannot be the names of a car's sensors.
pub(super) fn check_sensors(names: &[String]) -> Result<(), OutOfLimits> {
    let is_odd = |name: &String| name.is_empty() || name.len() > NAME_BYTES;
    if names.len() > SENSORS || names.iter().any(is_odd) {
        return Err(OutOfLimits::Sensors(names.len()));
    }
    Ok(())
}

/// Each column has its statistics, and no other has.
fn check_stats(notes: &Notes) -> Result<(), OutOfLimits> {
    let columns = notes.columns().names();
    if let Some(missing) = columns.iter().find(|name| !notes.stats.contains_key(**name)) {
        return Err(OutOfLimits::NoStatistics(missing));
    }
    let is_known = |name: &String| columns.contains(&name.as_str());
    if let Some(other) = notes.stats.keys().find(|name| !is_known(name)) {
        return Err(OutOfLimits::OtherStatistics(other.clone()));
    }
    let odd = |stats: &BTreeMap<String, Stats>| {
        let is_odd = |(name, stats): &(&String, &Stats)| {
            let width = match name.as_str() {
                ACTION => Action::LEN,
                IMAGE => 3,
                STATE => notes.state.len(),
                _ => 1,
            };
            !stats.is_sane(width, notes.n_steps)
        };
        stats.iter().find(is_odd).map(|(name, _)| name.clone())
    };
    match odd(&notes.stats) {
        Some(name) => Err(OutOfLimits::OddStatistics(name)),
        None => Ok(()),
    }
}
