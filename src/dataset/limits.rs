//! What an episode can sanely be: the one place that says so, for all that is read from files, before it is allocated.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use super::damage::OutOfLimits;
use super::layout::column;
use super::notes::{ACTION, DONE, IMAGE, Notes, REWARD, STATE, TERMINATED, TRUNCATED};
use super::stats::Stats;
use super::{EpisodeInfo, Layout};
use crate::text::shown;
use crate::world::{MAX_AXES, Size};

/// Steps of an episode.
pub(super) const STEPS: usize = 100_000;
/// Rows of a frame, and pixels of a row.
pub(super) const SIDE: u32 = 1024;
/// Bytes of all frames of an episode, as they are in memory.
const FRAMES_BYTES: usize = 4 << 30;
/// Bytes of the footer of an episode file, which holds a frame.
pub(super) const FOOTER_BYTES: usize = 16 << 20;
/// Bytes of an episode file, and of a journal.
pub(super) const FILE_BYTES: u64 = 2 << 30;
/// Bytes of a name: of a world, of a driver, of an axis.
const NAME_BYTES: usize = 256;
/// Sensors of a world.
const SENSORS: usize = 64;
/// Events of a world.
const EVENTS: usize = 64;
/// Steps a second.
const RATE: RangeInclusive<f64> = 0.01..=10_000.0;

/// The most bytes that a page of `n_values` numbers takes.
pub(super) fn page_bytes(n_values: usize) -> usize {
    (64 << 10) + 16 * n_values
}

/// Why these cannot be the notes of an episode of `n_rows` steps.
pub(super) fn check_notes(notes: &Notes, n_rows: i64) -> Result<(), OutOfLimits> {
    check_info(&notes.info)?;
    check_layout(&notes.layout())?;
    let (n_steps, size) = (notes.n_steps, notes.size());
    if !(1..=STEPS).contains(&n_steps) || i64::try_from(n_steps) != Ok(n_rows) {
        return Err(OutOfLimits::Steps { n_steps, n_rows });
    }
    if !is_sane(size) {
        return Err(OutOfLimits::Size(size));
    }
    let frame_bytes = 3 * size.height as usize * size.width as usize;
    if frame_bytes.saturating_mul(n_steps + 1) > FRAMES_BYTES {
        return Err(OutOfLimits::Frames { n_steps, size });
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
    for (what, name) in [("world", &info.env), ("driver", &info.pilot)] {
        if !is_printable(name) {
            return Err(OutOfLimits::Name { what, n_bytes: name.len() });
        }
    }
    Ok(())
}

/// Whether a name is of a bearable length and can be shown.
fn is_printable(name: &str) -> bool {
    name.len() <= NAME_BYTES && !name.chars().any(char::is_control)
}

/// Whether frames can have this size.
pub(super) fn is_sane(size: Size) -> bool {
    [size.height, size.width].iter().all(|side| (1..=SIDE).contains(side))
}

/// Why this cannot be what the steps of an episode have.
pub(super) fn check_layout(layout: &Layout) -> Result<(), OutOfLimits> {
    let Layout { axes, events, sensors, rate } = layout;
    let listed =
        [("axes", axes, 1..=MAX_AXES), ("events", events, 0..=EVENTS), ("sensors", sensors, 0..=SENSORS)];
    for (what, names, bounds) in listed {
        if !bounds.contains(&names.len()) {
            let (least, most) = bounds.into_inner();
            return Err(OutOfLimits::Listed { what, found: names.len(), least, most });
        }
        if let Some(name) = names.iter().find(|name| name.is_empty() || !is_printable(name)) {
            return Err(OutOfLimits::Called { what, name: shown(name) });
        }
    }
    if !RATE.contains(rate) {
        return Err(OutOfLimits::Rate(rate.to_string()));
    }
    let mut taken = BTreeMap::new();
    for event in events {
        let column = column(event);
        if [REWARD, DONE, TERMINATED, TRUNCATED].contains(&column.as_str()) {
            return Err(OutOfLimits::Taken { event: event.clone(), column });
        }
        if let Some(other) = taken.insert(column.clone(), event) {
            return Err(OutOfLimits::SameColumn { one: other.clone(), other: event.clone(), column });
        }
    }
    Ok(())
}

/// Each column has its statistics, and no other has.
fn check_stats(notes: &Notes) -> Result<(), OutOfLimits> {
    let columns = notes.columns().names();
    if let Some(missing) = columns.iter().find(|name| !notes.stats.contains_key(*name)) {
        return Err(OutOfLimits::NoStatistics(missing.clone()));
    }
    if let Some(other) = notes.stats.keys().find(|name| !columns.contains(name)) {
        return Err(OutOfLimits::OtherStatistics(other.clone()));
    }
    let odd = |stats: &BTreeMap<String, Stats>| {
        let is_odd = |(name, stats): &(&String, &Stats)| {
            let width = match name.as_str() {
                ACTION => notes.axes.len(),
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
