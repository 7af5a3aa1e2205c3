//! `dropj world` for datasets that others made: a first world's file for one, and whether one fits a world.

use std::path::Path;

use anyhow::Context as _;
use dropj::dataset::lerobot::{Feature, LeRobotDataset, View};
use dropj::text::shown;
use dropj::world::{
    Axis, Count, EventKind, EventSpec, FORMAT, FittingOverrides, ImageSpec, JustificationSpec, LabelWeights,
    NetworkOverrides, PlannerSpec, Release, Size, Source, SourceKind, When, WorldSpec,
};

use super::first_world::{Inputs, MOST_TRAINED, file_name, readable};
use super::meter::Meter;
use super::world::Telling;

/// Steps of an episode at the least that a first file gives a world: five clips of a dream.
const LEAST_EPISODE: usize = 5 * dropj::query::SEGMENT_LEN;

/// Episodes whose rows are looked at for what the numbers look like.
const N_SAMPLED: usize = 30;
/// Events that a first file has.
const MOST_EVENTS: usize = 16;
/// What a column that tells of harm has in its name.
const HARM: [&str; 8] = ["cost", "collision", "collide", "crash", "unsafe", "violation", "hazard", "danger"];
/// Columns that tell that an episode ended, which is no event.
const ENDS: [&str; 6] = ["done", "terminated", "truncated", "is_last", "is_first", "is_terminal"];

/// A first file for the dataset at `dir`.
pub(super) fn first_file(
    dir: &Path,
    cameras: &[String],
    action: Option<&str>,
) -> anyhow::Result<(WorldSpec, String)> {
    let dataset = LeRobotDataset::open(dir)?;
    let mut view = View { cameras: cameras.to_vec(), action: action.map(str::to_owned) };
    view.cameras = dataset.cameras_of(&view)?.into_iter().map(|camera| camera.name.clone()).collect();
    let [height, width] = dataset.frame_size(&view)?;
    let action = dataset.action(view.action.as_deref())?.clone();
    let sampled: Vec<usize> = sampled(dataset.n_episodes());
    let mut rows = Vec::new();
    for &idx in &sampled {
        rows.push(dataset.rows_of(idx, &action.name)?);
    }
    let ranges = dataset.ranges(&action.name)?;
    let mut inputs = Inputs::new();
    let mut axes = Vec::<Axis>::new();
    for (i, (name, range)) in action.components.iter().zip(ranges).enumerate() {
        let episodes: Vec<Vec<f32>> =
            rows.iter().map(|rows| rows.iter().map(|row| row[i]).collect()).collect();
        let is_new = |name: &String| axes.iter().all(|axis| axis.name != *name);
        let name = readable(name).filter(is_new).unwrap_or_else(|| format!("axis {}", i + 1));
        axes.push(axis(name, range, &episodes, &mut inputs));
    }
    let events = events(dataset.features(), &action);
    let harms = events.iter().filter(|event| event.kind == EventKind::Safety);
    let justifications = harms.map(|event| JustificationSpec {
        name: event.name.clone(),
        events: vec![event.name.clone()],
        weight: 1.0,
    });
    let folder = dir.canonicalize().unwrap_or_else(|_| dir.to_path_buf());
    let folder = folder.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    // The paper looks 0.3 to 0.5 s ahead at 50 Hz.
    let horizon = (dataset.fps() / 2.0).round().clamp(10.0, 50.0) as usize;
    let spec = WorldSpec {
        format: FORMAT,
        name: file_name(&folder),
        title: readable(&folder).unwrap_or_else(|| "A world".to_owned()),
        rate: dataset.fps(),
        // A dream may be longer than a short recording: it is asked about in clips.
        longest_episode: (0..dataset.n_episodes())
            .map(|idx| dataset.len(idx))
            .max()
            .unwrap_or(1)
            .max(LEAST_EPISODE),
        source: Source {
            kind: SourceKind::Recordings,
            cameras: view.cameras,
            action: (action.name != "action").then(|| action.name.clone()),
            ..Source::default()
        },
        image: ImageSpec { height, width, train: trained(height, width), ..ImageSpec::default() },
        axes,
        justifications: justifications.collect(),
        events,
        weights: LabelWeights::default(),
        planner: PlannerSpec { horizon, memory_reset: Some(50), ..PlannerSpec::default() },
        networks: NetworkOverrides::default(),
        fitting: FittingOverrides::default(),
    };
    spec.check().context("no world's file can be written for this dataset")?;
    let hints = hints(&dataset, &sampled)?;
    let file = spec.to_toml() + &hints;
    Ok((spec, file))
}

/// Some episodes, evenly among all.
fn sampled(n: usize) -> Vec<usize> {
    let n_sampled = n.min(N_SAMPLED);
    (0..n_sampled).map(|i| i * n / n_sampled).collect()
}

/// The size that networks are trained at: at most [`MOST_TRAINED`] a side, in the same shape, and in fours. None where the
/// pictures are so already.
fn trained(height: u32, width: u32) -> Option<Size> {
    let shrink = (f64::from(height.max(width)) / f64::from(MOST_TRAINED)).max(1.0);
    let side = |pixels: u32| (4 * (f64::from(pixels) / shrink / 4.0).round() as u32).max(8);
    let train = Size { height: side(height), width: side(width) };
    (train != Size { height, width }).then_some(train)
}

/// An axis whose values were from `range[0]` to `range[1]`, and in some episodes as in `episodes`.
fn axis(name: String, range: [f32; 2], episodes: &[Vec<f32>], inputs: &mut Inputs) -> Axis {
    let [low, high] = widened(range);
    let span = high - low;
    let mut values: Vec<f32> = episodes.concat();
    values.sort_by(f32::total_cmp);
    let median = values.get(values.len() / 2).copied().unwrap_or(f32::midpoint(low, high));
    let has_zero = (low..=high).contains(&0.0);
    let neutral = if has_zero { 0.0 } else { median.clamp(low, high) };
    // Positions change little from row to row, and are rarely nothing; what pushes is nothing most of the time.
    let steps: Vec<f32> =
        episodes.iter().flat_map(|values| values.windows(2)).map(|pair| (pair[1] - pair[0]).abs()).collect();
    let step = steps.iter().sum::<f32>() / steps.len().max(1) as f32;
    let n_near_zero = values.iter().filter(|value| value.abs() < 0.05 * span).count();
    let is_smooth = !steps.is_empty() && step < 0.05 * span;
    let is_position = !has_zero || (is_smooth && n_near_zero * 10 < values.len());
    let (keys, pad) = inputs.take(low, high, neutral);
    Axis {
        name,
        low,
        high,
        neutral,
        mirrored: false,
        keys,
        pad,
        // From end to end in two seconds.
        key_speed: is_position.then_some(shortened(span / 2.0)),
        release: if is_position { Release::Stay } else { Release::Spring },
    }
}

/// A range a little wider than what was met, in short numbers. It does not reach over 0 where that was not met, nor over 1
/// and -1 where all was within them.
fn widened([least, most]: [f32; 2]) -> [f32; 2] {
    let [least, most] = [least, most].map(f64::from);
    let span = most - least;
    let size = least.abs().max(most.abs());
    let unit = |size: f64| 10_f64.powf(size.log10().floor() - 1.0);
    let [low, high] = if span > 1e-6 * size {
        let (margin, unit) = (0.05 * span, unit(span));
        let mut low = ((least - margin) / unit).floor() * unit;
        let mut high = ((most + margin) / unit).ceil() * unit;
        if size <= 1.0 {
            (low, high) = (low.max(-1.0), high.min(1.0));
        }
        [if least >= 0.0 { low.max(0.0) } else { low }, if most <= 0.0 { high.min(0.0) } else { high }]
    } else {
        // One value alone.
        let margin = if size > 0.0 { 0.5 * size } else { 1.0 };
        [least - margin, most + margin]
    };
    // As short as they look.
    [low, high].map(|value| format!("{value:.6e}").parse::<f32>().unwrap_or(value as f32))
}

/// A number with two digits.
fn shortened(value: f32) -> f32 {
    format!("{value:.1e}").parse().unwrap_or(value)
}

/// What columns tell by their names.
fn events(features: &[Feature], action: &Feature) -> Vec<EventSpec> {
    let mut events = Vec::<EventSpec>::new();
    for feature in
        features.iter().filter(|feature| feature.components.len() == 1 && feature.name != action.name)
    {
        let short = feature.name.strip_prefix("next.").unwrap_or(&feature.name);
        let short = short.strip_prefix("observation.").unwrap_or(short);
        let lower = short.to_lowercase();
        let is_harm = HARM.iter().any(|word| lower.contains(word));
        if events.len() == MOST_EVENTS || ENDS.contains(&lower.as_str()) || !(feature.is_bool || is_harm) {
            continue;
        }
        let (Some(name), Some(field)) = (readable(short), readable(&feature.name)) else { continue };
        if field != feature.name || events.iter().any(|event| event.name == name) {
            continue;
        }
        events.push(EventSpec {
            name,
            kind: if is_harm { EventKind::Safety } else { EventKind::Progress },
            count: if is_harm { Count::PerStep } else { Count::FirstTouch },
            field,
            when: if feature.is_bool { When::True } else { When::Above(0.0) },
            passed: None,
        });
    }
    events
}

/// What whoever goes on with a first file should know, as comments.
fn hints(dataset: &LeRobotDataset, sampled: &[usize]) -> anyhow::Result<String> {
    let mut lines =
        vec![String::new(), "# The cameras of the dataset, for `cameras` in [source]:".to_owned()];
    for camera in dataset.cameras() {
        let kind = if camera.is_video { "video" } else { "pictures" };
        lines.push(format!("#   {:?}  # {} x {}, {kind}", shown(&camera.name), camera.height, camera.width));
    }
    lines.push("# Its columns, and what they were in some episodes. An event reads one of these:".to_owned());
    let mut ranges = std::collections::BTreeMap::<String, [f32; 2]>::new();
    for &idx in sampled {
        for (name, values) in dataset.scalars_of(idx)? {
            let range = ranges.entry(name).or_insert([f32::INFINITY, f32::NEG_INFINITY]);
            for value in values.into_iter().filter(|value| !value.is_nan()) {
                *range = [range[0].min(value), range[1].max(value)];
            }
        }
    }
    // A hundred say enough.
    for (name, [least, most]) in ranges.iter().take(100) {
        lines.push(format!("#   field = {:?}  # {least} to {most}", shown(name)));
    }
    Ok(lines.join("\n") + "\n")
}

/// Says whether the dataset at `dir` fits the world, and fails where it does not.
pub(super) fn check_fit(spec: &WorldSpec, dir: &Path, mut telling: Telling) -> anyhow::Result<()> {
    let dataset = LeRobotDataset::open(dir)?;
    let view = View { cameras: spec.source.cameras.clone(), action: spec.source.action.clone() };
    let n = dataset.n_episodes();
    let lens: Vec<usize> = (0..n).map(|idx| dataset.len(idx)).collect();
    let n_rows: usize = lens.iter().sum();
    telling.say(&format!("{n} episodes of {n_rows} rows in all, {} a second: {dir:?}", dataset.fps()));
    telling.note("episodes", n);
    telling.note("rows", n_rows);
    telling.note("rate", dataset.fps());
    let [height, width] = dataset.frame_size(&view)?;
    let cameras: Vec<_> = dataset.cameras_of(&view)?.into_iter().map(|camera| shown(&camera.name)).collect();
    telling.say(&format!("  pictures of {height} x {width}: {}", cameras.join(", ")));
    telling.note("size", vec![height, width]);
    telling.note("cameras", cameras);
    let mut faults = Vec::new();
    if [height, width] != [spec.image.height, spec.image.width] {
        faults.push(format!(
            "its pictures are {height} x {width}, and the world's {} x {}",
            spec.image.height, spec.image.width
        ));
    }
    if (dataset.fps() / spec.rate - 1.0).abs() > 1e-3 {
        faults.push(format!("it has {} rows a second, and the world {} steps", dataset.fps(), spec.rate));
    }
    if let Some(len) = lens.iter().max().filter(|&&len| len > spec.longest_episode) {
        faults.push(format!(
            "an episode has {len} rows, and one of the world {} at the most",
            spec.longest_episode
        ));
    }
    let action = dataset.action(view.action.as_deref())?;
    let components: Vec<_> = action.components.iter().map(|name| shown(name)).collect();
    telling.say(&format!("  action {}: {}", shown(&action.name), components.join(", ")));
    telling.note("action", components);
    if action.components.len() == spec.axes.len() {
        check_values(spec, &dataset, action, &mut telling)?;
    } else {
        faults.push(format!(
            "{:?} has {} numbers, and the world {} axes",
            shown(&action.name),
            action.components.len(),
            spec.axes.len()
        ));
    }
    let first = dataset.episode(0, &view)?;
    for field in spec.fields().iter().filter(|field| !first.scalars.contains_key(*field)) {
        faults.push(format!("it has no column {:?}, from which an event is read", shown(field)));
    }
    telling.say(&format!("  the first episode's {} pictures were read", first.frames.len()));
    let mut of_first = serde_json::Map::new();
    for (event, happened) in spec.events.iter().zip(counts(spec, &first)) {
        telling.say(&format!("  {} in the first episode: {happened}", shown(&event.name)));
        of_first.insert(event.name.clone(), happened.into());
    }
    for fault in &faults {
        telling.say(&format!("  does not fit: {fault}"));
    }
    if faults.is_empty() {
        telling.say("  it fits");
    }
    telling.note("events_of_the_first_episode", of_first);
    telling.note("fits", faults.is_empty());
    telling.note("faults", faults.clone());
    telling.tell()?;
    anyhow::ensure!(
        faults.is_empty(),
        "the dataset does not fit this world ({}): {dir:?}",
        faults.join("; ")
    );
    Ok(())
}

/// How often each event happened.
fn counts(spec: &WorldSpec, episode: &dropj::dataset::lerobot::RawEpisode) -> Vec<usize> {
    let mut counts = vec![0; spec.events.len()];
    for happened in episode.happened(&spec.events) {
        for (count, happened) in counts.iter_mut().zip(happened) {
            *count += usize::from(happened.happened);
        }
    }
    counts
}

/// Says which values are out of their axis's range.
fn check_values(
    spec: &WorldSpec,
    dataset: &LeRobotDataset,
    action: &Feature,
    telling: &mut Telling,
) -> anyhow::Result<()> {
    let mut out = vec![(0_usize, f32::INFINITY, f32::NEG_INFINITY); spec.axes.len()];
    let mut n_rows = 0;
    let mut meter = Meter::new();
    for idx in 0..dataset.n_episodes() {
        meter.at("reading episodes", idx, dataset.n_episodes(), String::new);
        for row in dataset.rows_of(idx, &action.name)? {
            n_rows += 1;
            for ((axis, value), (n, least, most)) in spec.axes.iter().zip(row).zip(&mut out) {
                *n += usize::from(!(axis.low..=axis.high).contains(&value));
                (*least, *most) = (least.min(value), most.max(value));
            }
        }
    }
    drop(meter);
    let mut ranges = Vec::new();
    for (axis, (n, least, most)) in spec.axes.iter().zip(out) {
        let range = format!("{least} to {most}");
        telling
            .say(&format!("  axis {}: {range}, {n} of {n_rows} values out of its range", shown(&axis.name)));
        ranges.push(serde_json::json!({"axis": axis.name, "least": least, "most": most, "out_of_range": n}));
    }
    telling.note("axes", ranges);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_a_little_wider_and_short() {
        assert_eq!(widened([-0.7, 0.5]), [-0.8, 0.6]);
        assert_eq!(widened([-0.996, 0.992]), [-1.0, 1.0], "not over 1");
        assert_eq!(widened([0.0, 0.9]), [0.0, 0.95], "not below 0");
        assert_eq!(widened([12.0, 498.0]), [0.0, 530.0]);
        for value in [0.0, 1.0, -1.0, 300.0, -2e-9] {
            let [low, high] = widened([value, value]);
            assert!(low < value && value < high, "{value} is not in {low} to {high}");
        }
    }

    #[test]
    fn networks_see_at_most_128_pixels_a_side_in_fours() {
        assert_eq!(trained(96, 96), None);
        assert_eq!(trained(480, 640), Some(Size { height: 96, width: 128 }));
        assert_eq!(trained(50, 90), Some(Size { height: 52, width: 92 }));
        assert_eq!(trained(10, 2000), Some(Size { height: 8, width: 128 }));
    }

    #[test]
    fn positions_stay_and_pushes_spring_back() {
        let mut inputs = Inputs::new();
        let push = axis("push".to_owned(), [-1.0, 1.0], &[vec![0.0, 0.0, 1.0, 0.0, -1.0, 0.0]], &mut inputs);
        assert_eq!((push.neutral, push.release, push.key_speed), (0.0, Release::Spring, None));
        let place: Vec<f32> = (0..100).map(|i| 100.0 + i as f32).collect();
        let place = axis("place".to_owned(), [100.0, 200.0], &[place], &mut inputs);
        assert_eq!((place.low, place.high, place.release), (90.0, 210.0, Release::Stay));
        assert_eq!((place.neutral, place.key_speed), (150.0, Some(60.0)));
        let joint: Vec<f32> = (0..100).map(|i| 0.4 + 0.01 * i as f32).collect();
        let joint = axis("joint".to_owned(), [-0.2, 1.4], &[joint], &mut inputs);
        assert_eq!((joint.neutral, joint.release), (0.0, Release::Stay));
    }
}
