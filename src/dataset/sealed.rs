//! A sealed episode: one Parquet file that holds everything known about it.
//!
//! Rows are steps. What has no row lives in the notes of the footer: the frame after the last action, who drove,
//! and the column statistics, so that the folder `meta` can be rebuilt from these files alone.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::Path;

use parquet::data_type::{BoolType, ByteArray, ByteArrayType, FloatType, Int64Type};
use serde::Deserialize;

use super::damage::{Damage, Stranger, TableError, shown};
use super::hex::{from_hex, to_hex};
use super::journal::{Row, Take, TakeEnd};
use super::layout::column;
use super::notes::{ACTION, Columns, DONE, FORMAT, IMAGE, Notes, REWARD, STATE, TERMINATED, TRUNCATED};
use super::stats::Stats;
use super::table::{Column, Footer, Table, to_parquet};
use super::{DatasetError, Episode, Layout, card, disk, legacy, limits, png};
use crate::world::{Action, Frame, Size};

/// The key of the notes in the footer.
const NOTES: &str = "dropj";
/// The key of the last frame in the footer: a PNG in hexadecimal.
const LAST_FRAME: &str = "dropj.last_frame";
/// At most so many frames of an episode are looked at for its statistics.
const N_SAMPLED_FRAMES: usize = 100;

/// Where an episode stands among others.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub(super) number: usize,
    pub(super) first_index: usize,
}

/// Whether two episodes can be in one dataset: of one world, in one size, with the same columns.
pub(super) fn require_alike(one: &Notes, other: &Notes) -> Result<(), DatasetError> {
    let differing = [
        (one.info.env != other.info.env)
            .then(|| [one, other].map(|notes| format!("is of the world {:?}", notes.info.env))),
        (one.size() != other.size())
            .then(|| [one, other].map(|notes| format!("has frames of {} pixels", shown(notes.size())))),
        (one.axes != other.axes).then(|| [one, other].map(|notes| format!("has the axes {:?}", notes.axes))),
        (one.rate != other.rate)
            .then(|| [one, other].map(|notes| format!("has {} steps a second", notes.rate))),
        (one.columns() != other.columns()).then(|| {
            let [one, other] = [one, other].map(Notes::columns);
            let told = |columns: &Columns, than: &Columns| {
                let more: Vec<_> =
                    columns.names().into_iter().filter(|name| !than.names().contains(name)).collect();
                let (layout, thans) = (&columns.layout, &than.layout);
                match more[..] {
                    [] if layout.sensors != thans.sensors => format!("measures {:?}", layout.sensors),
                    [] if columns.names().len() == than.names().len() => {
                        format!("tells the events {:?}", layout.events)
                    }
                    [] => "has no more columns".to_owned(),
                    _ => format!("has the columns {}", more.join(", ")),
                }
            };
            [told(&one, &other), told(&other, &one)]
        }),
    ];
    match differing.into_iter().flatten().next() {
        None => Ok(()),
        Some([first, second]) => Err(DatasetError::Mixed {
            one: first,
            other: second,
            path: one.path.clone(),
            other_path: other.path.clone(),
        }),
    }
}

/// Whether an episode of this layout can be sealed in the dataset at `dir`, whose first episode is `first`.
pub(super) fn require_fit(layout: &Layout, first: &Notes, dir: &Path) -> Result<(), DatasetError> {
    let met = first.layout();
    let path = || dir.to_path_buf();
    if layout.axes != met.axes {
        let [tried, met] = [&layout.axes, &met.axes].map(|axes| format!("with the axes {axes:?}"));
        return Err(DatasetError::OtherLayout { tried, met, path: path() });
    }
    if layout.rate != met.rate {
        let [tried, met] = [layout.rate, met.rate].map(|rate| format!("of {rate} steps a second"));
        return Err(DatasetError::OtherLayout { tried, met, path: path() });
    }
    let lacks_sensors = !met.sensors.is_empty() && met.sensors != layout.sensors;
    let is_told =
        |event: &String| layout.event(event).is_some() || legacy::never_happens(event, &first.info.env);
    if lacks_sensors || !met.events.iter().all(is_told) {
        let tried = Columns { layout: layout.clone(), ends: true }.names().join(", ");
        let met = first.columns().names().join(", ");
        return Err(DatasetError::OtherColumns { tried, met, path: path() });
    }
    Ok(())
}

/// Seals a take in the dataset at `dir`, whose first episode is `first`: the columns that this lacks are left out.
pub(super) fn write(
    dir: &Path,
    take: &Take,
    place: Place,
    first: Option<&Notes>,
) -> Result<Notes, DatasetError> {
    let columns = match first {
        None => Columns { layout: take.layout.clone(), ends: true },
        Some(first) => {
            require_fit(&take.layout, first, dir)?;
            first.columns()
        }
    };
    if let (Some(first), Ok(size)) = (first, size(take))
        && first.size() != size
    {
        return Err(DatasetError::OtherSize { tried: size, met: first.size(), path: dir.to_path_buf() });
    }
    write_as(dir, take, place, &columns, env!("CARGO_PKG_VERSION").into())
}

/// Writes the episode of `old`'s file at another place of the dataset at `dir`. The file stays.
pub(super) fn move_to(dir: &Path, old: &Notes, place: Place) -> Result<Notes, DatasetError> {
    let (notes, take) = read(&old.path)?;
    write_as(dir, &take, place, &notes.columns(), notes.app)
}

/// Seals a take that the version `app` recorded.
fn write_as(
    dir: &Path,
    take: &Take,
    place: Place,
    columns: &Columns,
    app: String,
) -> Result<Notes, DatasetError> {
    let Place { number, first_index } = place;
    let path = disk::episode_path(dir, number);
    let damaged = |reason: Damage| DatasetError::damaged(reason, &path);
    let size = size(take).map_err(damaged)?;
    let Layout { axes, events, sensors, rate } = columns.layout.clone();
    let mut cells = cells(take, place, columns);
    let ends = take.end.as_ref();
    let notes = Notes {
        format: FORMAT,
        app,
        info: take.info.clone(),
        recording: take.id.clone(),
        number,
        first_index,
        n_steps: take.rows.len(),
        height: size.height,
        width: size.width,
        side: 0,
        done: ends.is_some_and(|end| end.done),
        truncated: ends.is_some_and(|end| end.truncated),
        axes,
        events,
        rate,
        state: sensors,
        planned: planned(&take.rows),
        stats: statistics(&cells, &take.rows, size).map_err(damaged)?,
        path: path.clone(),
    };
    // What is written can be read.
    limits::check_notes(&notes, take.rows.len() as i64).map_err(|met| damaged(met.into()))?;
    let images = take.rows.iter().map(|row| ByteArray::from(row.png.clone())).collect();
    cells.insert(0, (IMAGE.into(), Column::Images(images)));
    let mut footer = vec![
        (NOTES.into(), serde_json::to_string(&notes).expect("text and finite numbers")),
        (card::FEATURES.into(), card::features(columns).to_string()),
    ];
    if let Some(end) = &take.end {
        footer.push((LAST_FRAME.into(), to_hex(&end.png)));
    }
    let bytes = to_parquet(cells, footer).map_err(|met| damaged(met.into()))?;
    disk::replace(&path, &bytes)?;
    Ok(notes)
}

/// The size of all frames of a take.
fn size(take: &Take) -> Result<Size, Damage> {
    let mut pngs = take.rows.iter().map(|row| &row.png).chain(take.end.iter().map(|end| &end.png));
    let size = png::size(pngs.next().ok_or(Damage::NoStep)?)?;
    match pngs.find(|png| !png::size(png).is_ok_and(|other| other == size)) {
        Some(_) => Err(Damage::Sizes),
        None => Ok(size),
    }
}

/// The stretches that the planner drove.
fn planned(rows: &[Row]) -> Vec<[usize; 2]> {
    let mut at = 0;
    let stretches = rows.chunk_by(|a, b| a.planned == b.planned).map(|stretch| {
        at += stretch.len();
        (stretch[0].planned, [at - stretch.len(), at])
    });
    stretches.filter_map(|(is_planned, ends)| is_planned.then_some(ends)).collect()
}

/// All columns but the frames.
fn cells(take: &Take, place: Place, columns: &Columns) -> Vec<(String, Column)> {
    let Place { number, first_index } = place;
    let rows = &take.rows;
    let n = rows.len();
    let end = take.end.as_ref();
    let (done, truncated) = end.map_or((false, false), |end| (end.done, end.truncated));
    let at_end = |is: bool| Column::Bools((1..=n).map(|step| is && step == n).collect());
    let Layout { axes, events, sensors, rate } = &columns.layout;
    let secs = |step: usize| (step as f64 / rate) as f32;
    let mut cells = vec![
        (ACTION, floats(axes.len(), rows.iter().flat_map(|row| row.action.to_vec()).collect())),
        (REWARD, Column::Floats(rows.iter().map(|row| row.reward).collect())),
        (DONE, at_end(done)),
        ("wall_time_ns", Column::Ints(rows.iter().map(|row| row.wall_time_ns).collect())),
        ("timestamp", Column::Floats((0..n).map(secs).collect())),
        ("frame_index", Column::Ints((0..n as i64).collect())),
        ("episode_index", Column::Ints(vec![number as i64; n])),
        ("index", Column::Ints((first_index..first_index + n).map(|index| index as i64).collect())),
        ("task_index", Column::Ints(vec![0; n])),
    ];
    if columns.ends {
        cells.push((TERMINATED, at_end(done && !truncated)));
        cells.push((TRUNCATED, at_end(truncated)));
    }
    if !sensors.is_empty() {
        cells.push((STATE, floats(sensors.len(), rows.iter().flat_map(|row| row.state.clone()).collect())));
    }
    let events = events.iter().map(|event| {
        let there = take.layout.event(event);
        let goes_on = |row: &Row| there.is_some_and(|event| row.events[event]);
        (column(event), Column::Bools(rows.iter().map(goes_on).collect()))
    });
    cells.into_iter().map(|(name, cells)| (name.to_owned(), cells)).chain(events).collect()
}

/// A column of `width` numbers a row. `LeRobot` has a feature of one number without a list.
fn floats(width: usize, values: Vec<f32>) -> Column {
    if width == 1 { Column::Floats(values) } else { Column::FloatLists(width, values) }
}

/// The numbers of such a column.
fn read_floats(table: &Table, name: &str, width: usize) -> parquet::errors::Result<Vec<f32>> {
    match width {
        0 => Ok(Vec::new()),
        1 => table.read::<FloatType>(&[name], 1),
        _ => table.read::<FloatType>(&[name, "list", "element"], width),
    }
}

/// The statistics of every column; of the frames, some only, as `LeRobot` has it.
fn statistics(
    columns: &[(String, Column)],
    rows: &[Row],
    size: Size,
) -> Result<BTreeMap<String, Stats>, Damage> {
    let mut stats = BTreeMap::new();
    for (name, column) in columns {
        let (width, values): (usize, Vec<f64>) = match column {
            Column::Bools(values) => (1, values.iter().map(|&value| f64::from(u8::from(value))).collect()),
            Column::Ints(values) => (1, values.iter().map(|&value| value as f64).collect()),
            Column::Floats(values) => (1, values.iter().map(|&value| f64::from(value)).collect()),
            Column::FloatLists(width, values) => {
                (*width, values.iter().map(|&value| f64::from(value)).collect())
            }
            _ => continue,
        };
        stats.insert(name.clone(), Stats::of(width, &values, rows.len()));
    }
    let n_samples = rows.len().min(N_SAMPLED_FRAMES);
    let mut pixels = Vec::new();
    for sample in 0..n_samples {
        let frame = png::decode(&rows[sample * rows.len() / n_samples].png, size)?;
        pixels.extend(frame.rgb().iter().map(|&byte| f64::from(byte) / 255.0));
    }
    stats.insert(IMAGE.into(), Stats::of(3, &pixels, n_samples));
    Ok(stats)
}

/// Reads what the footer of an episode file says.
pub(super) fn open(path: &Path) -> Result<Notes, DatasetError> {
    let footer = File::open(path).map_err(TableError::Disk).and_then(|mut file| Footer::read(&mut file));
    let footer = footer.map_err(|fault| faulty(fault, path))?;
    signed_notes(&footer, path)
}

/// Reads all of an episode file, its frames as they are stored.
pub(super) fn read(path: &Path) -> Result<(Notes, Take), DatasetError> {
    let failed = DatasetError::disk("read the episode", path);
    let n_bytes = match fs::metadata(path) {
        Ok(met) => met.len(),
        Err(met) => return Err(failed(met)),
    };
    if n_bytes > limits::FILE_BYTES {
        return Err(DatasetError::damaged(Damage::Bytes(n_bytes), path));
    }
    parse(fs::read(path).map_err(failed)?, path)
}

/// The same of a file's bytes. `path` is only told.
pub(super) fn parse(bytes: Vec<u8>, path: &Path) -> Result<(Notes, Take), DatasetError> {
    // What was not written by us has no checksum of ours, and is not torn.
    let footer = Footer::read(&mut std::io::Cursor::new(&bytes)).map_err(|fault| faulty(fault, path))?;
    let notes = signed_notes(&footer, path)?;
    let table = Table::new(bytes).map_err(|fault| faulty(fault, path))?;
    let take = take(&table, &notes).map_err(|reason| DatasetError::damaged(reason, path))?;
    Ok((notes, take))
}

/// The notes in a footer that has a checksum where its format asks for one.
fn signed_notes(footer: &Footer, path: &Path) -> Result<Notes, DatasetError> {
    let notes = notes(footer, path);
    let notes = notes.map_err(|reason| DatasetError::NotOurs { reason, path: path.to_path_buf() })?;
    if notes.format >= 2 && !footer.is_signed() {
        return Err(DatasetError::damaged(Damage::Unsigned, path));
    }
    Ok(notes)
}

fn faulty(met: TableError, path: &Path) -> DatasetError {
    match met {
        TableError::Disk(met) => DatasetError::disk("read the episode", path)(met),
        met => DatasetError::damaged(Damage::Table(met), path),
    }
}

/// What every version's notes have.
#[derive(Deserialize)]
struct Format {
    format: u32,
}

/// The notes in a footer, all within their limits, or what the file is instead of an episode of ours.
fn notes(footer: &Footer, path: &Path) -> Result<Notes, Stranger> {
    let by = || footer.created_by().to_owned();
    let Some(json) = footer.note(NOTES) else {
        // LeRobot's tools write the columns anew, and leave the notes out.
        let was_ours = footer.has_column("wall_time_ns");
        return Err(if was_ours { Stranger::WithoutNotes(by()) } else { Stranger::Foreign(by()) });
    };
    if !footer.is_ours() {
        return Err(Stranger::Rewritten(by()));
    }
    let Format { format } = serde_json::from_str(json).map_err(Stranger::Json)?;
    if !(1..=FORMAT).contains(&format) {
        return Err(Stranger::Format { found: format, known: FORMAT });
    }
    let mut notes: Notes = serde_json::from_str(json).map_err(Stranger::Json)?;
    legacy::complete(&mut notes);
    limits::check_notes(&notes, footer.n_rows()).map_err(Stranger::Limits)?;
    notes.path = path.to_path_buf();
    Ok(notes)
}

/// An episode as it was recorded.
pub(super) fn episode((notes, take): (Notes, Take)) -> Result<Episode, DatasetError> {
    let size = notes.size();
    let Notes { number, info, done, truncated, planned, path, .. } = notes;
    let Take { layout, rows, end, .. } = take;
    let pngs = rows.iter().map(|row| &row.png).chain(end.iter().map(|end| &end.png));
    let frames = pngs.map(|png| png::decode(png, size)).collect::<Result<Vec<Frame>, _>>();
    Ok(Episode {
        number,
        info,
        frames: frames.map_err(|reason| DatasetError::damaged(reason, &path))?,
        actions: rows.iter().map(|row| row.action).collect(),
        rewards: rows.iter().map(|row| row.reward).collect(),
        layout,
        events: rows.iter().map(|row| row.events.clone()).collect(),
        wall_times_ns: rows.iter().map(|row| row.wall_time_ns).collect(),
        states: rows.into_iter().map(|row| row.state).collect(),
        done,
        truncated,
        planned: planned.into_iter().map(|[from, to]| from..to).collect(),
    })
}

/// The steps in a table, all numbers finite.
fn take(table: &Table, notes: &Notes) -> Result<Take, Damage> {
    let n = notes.n_steps;
    let layout = notes.layout();
    let (n_axes, n_sensors) = (layout.axes.len(), layout.sensors.len());
    let pngs = table.read::<ByteArrayType>(&[IMAGE, "bytes"], 1)?;
    let actions = read_floats(table, ACTION, n_axes)?;
    let rewards = table.read::<FloatType>(&[REWARD], 1)?;
    let wall_times_ns = table.read::<Int64Type>(&["wall_time_ns"], 1)?;
    let states = read_floats(table, STATE, n_sensors)?;
    let events = layout.events.iter().map(|event| table.read::<BoolType>(&[&column(event)], 1));
    let events = events.collect::<parquet::errors::Result<Vec<_>>>()?;
    let lens = [pngs.len(), actions.len() / n_axes, rewards.len(), wall_times_ns.len()];
    let lens: Vec<usize> = lens.into_iter().chain(events.iter().map(Vec::len)).collect();
    if lens.iter().any(|&len| len != n) {
        return Err(Damage::Lengths { n_steps: n, lens });
    }
    if !actions.iter().chain(&rewards).chain(&states).all(|number| number.is_finite()) {
        return Err(Damage::NotFinite);
    }
    let is_planned = |t: usize| notes.planned.iter().any(|&[from, to]| (from..to).contains(&t));
    let rows = pngs.into_iter().enumerate().map(|(t, png)| Row {
        png: png.data().to_vec(),
        action: Action::new(&actions[t * n_axes..(t + 1) * n_axes]),
        reward: rewards[t],
        events: events.iter().map(|event| event[t]).collect(),
        wall_time_ns: wall_times_ns[t],
        planned: is_planned(t),
        state: states[t * n_sensors..(t + 1) * n_sensors].to_vec(),
    });
    let rows = rows.collect();
    let last = table.footer.note(LAST_FRAME).map(|hex| from_hex(hex).ok_or(Damage::LastFrame));
    let Notes { done, truncated, .. } = *notes;
    let end = last.transpose()?.map(|png| TakeEnd { png, done, truncated });
    let (id, info) = (notes.recording.clone(), notes.info.clone());
    Ok(Take { id, info, layout, rows, end })
}
