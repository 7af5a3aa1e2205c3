//! A sealed episode: one Parquet file that holds everything known about it.
//!
//! Rows are steps. What has no row lives in the notes of the footer: the frame after the last action, who drove,
//! and the column statistics, so that the folder `meta` can be rebuilt from these files alone.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};

use parquet::data_type::{BoolType, ByteArray, ByteArrayType, FloatType, Int64Type};
use serde::{Deserialize, Serialize};

use super::journal::{Row, Take, TakeEnd};
use super::stats::Stats;
use super::table::{Column, Table, to_parquet};
use super::{DatasetError, Episode, EpisodeInfo, disk, png};
use crate::env::{Action, Contacts, Frame, STEPS_PER_SEC};

/// The format of the notes.
const FORMAT: u32 = 1;
/// The key of the notes in the footer.
const NOTES: &str = "dropj";
/// The key of the last frame in the footer: a PNG in hexadecimal.
const LAST_FRAME: &str = "dropj.last_frame";
/// At most so many frames of an episode are looked at for its statistics.
const N_SAMPLED_FRAMES: usize = 100;
/// The columns that only worlds with obstacles have.
pub(super) const CHUCKHOLE: &str = "next.chuckhole";
pub(super) const CAR: &str = "next.car";
/// The column of frames.
pub(super) const IMAGE: &str = "observation.image";

/// What the footer of an episode file says.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Notes {
    format: u32,
    /// The version that recorded it.
    pub(super) app: String,
    /// Who drove where.
    #[serde(flatten)]
    pub(super) info: EpisodeInfo,
    /// The journal that it was sealed from.
    pub(super) recording: String,
    /// Its number, which its file name gives as well.
    pub(super) number: usize,
    /// How many steps the episodes before it have.
    pub(super) first_index: usize,
    /// How many steps it has.
    pub(super) n_steps: usize,
    /// Pixels a side.
    pub(super) side: u32,
    /// Whether the environment ended it.
    pub(super) done: bool,
    /// The steps that the planner drove, from the first to before the last of each stretch.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) planned: Vec<[usize; 2]>,
    /// The statistics of each column.
    pub(super) stats: BTreeMap<String, Stats>,
}

impl Notes {
    /// Whether contacts with obstacles were recorded.
    pub(super) fn has_obstacles(&self) -> bool {
        self.stats.contains_key(CHUCKHOLE)
    }
}

/// Seals a take as episode `number` of the dataset at `dir`.
pub(super) fn write(
    dir: &Path,
    take: &Take,
    number: usize,
    first_index: usize,
) -> Result<Notes, DatasetError> {
    write_as(dir, take, number, first_index, env!("CARGO_PKG_VERSION").into())
}

/// Writes episode `old`, which is in the file `path`, as episode `number` of the dataset at `dir`; `path` stays.
pub(super) fn move_to(
    dir: &Path,
    path: PathBuf,
    old: usize,
    number: usize,
    first_index: usize,
) -> Result<Notes, DatasetError> {
    let sealed = Sealed::open(path, old)?;
    let take = sealed.take().map_err(|reason| DatasetError::damaged(reason, &sealed.path))?;
    write_as(dir, &take, number, first_index, sealed.notes.app)
}

/// Seals a take that the version `app` recorded.
fn write_as(
    dir: &Path,
    take: &Take,
    number: usize,
    first_index: usize,
    app: String,
) -> Result<Notes, DatasetError> {
    let path = disk::episode_path(dir, number);
    let damaged = |reason: String| DatasetError::damaged(reason, &path);
    let n_steps = take.rows.len();
    let side = png::decode(&take.rows[0].png).map_err(damaged)?.side();
    let mut columns = columns(take, number, first_index);
    let notes = Notes {
        format: FORMAT,
        app,
        info: take.info.clone(),
        recording: take.id.clone(),
        number,
        first_index,
        n_steps,
        side,
        done: take.end.as_ref().is_some_and(|end| end.done),
        planned: planned(&take.rows),
        stats: statistics(&columns, &take.rows).map_err(damaged)?,
    };
    let images = take.rows.iter().map(|row| ByteArray::from(row.png.clone())).collect();
    columns.insert(0, (IMAGE.into(), Column::Images(images)));
    let mut footer = vec![(NOTES.into(), serde_json::to_string(&notes).expect("text and finite numbers"))];
    if let Some(end) = &take.end {
        footer.push((LAST_FRAME.into(), to_hex(&end.png)));
    }
    let bytes = to_parquet(columns, footer).map_err(|error| damaged(error.to_string()))?;
    disk::replace(&path, &bytes)?;
    Ok(notes)
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
fn columns(take: &Take, number: usize, first_index: usize) -> Vec<(String, Column)> {
    let rows = &take.rows;
    let n = rows.len();
    let done = take.end.as_ref().is_some_and(|end| end.done);
    let contacts: Vec<Contacts> = rows.iter().filter_map(|row| row.contacts).collect();
    let mut columns = vec![
        (
            "action",
            Column::FloatLists(Action::LEN, rows.iter().flat_map(|row| row.action.to_array()).collect()),
        ),
        ("next.reward", Column::Floats(rows.iter().map(|row| row.reward).collect())),
        ("next.done", Column::Bools((1..=n).map(|step| done && step == n).collect())),
        ("next.grass", Column::Bools(rows.iter().map(|row| row.grass).collect())),
        ("wall_time_ns", Column::Ints(rows.iter().map(|row| row.wall_time_ns).collect())),
        ("timestamp", Column::Floats((0..n).map(|step| step as f32 / STEPS_PER_SEC as f32).collect())),
        ("frame_index", Column::Ints((0..n as i64).collect())),
        ("episode_index", Column::Ints(vec![number as i64; n])),
        ("index", Column::Ints((first_index..first_index + n).map(|index| index as i64).collect())),
        ("task_index", Column::Ints(vec![0; n])),
    ];
    if contacts.len() == n {
        columns.push((CHUCKHOLE, Column::Bools(contacts.iter().map(|touched| touched.chuckhole).collect())));
        columns.push((CAR, Column::Bools(contacts.iter().map(|touched| touched.car).collect())));
    }
    columns.into_iter().map(|(name, column)| (name.into(), column)).collect()
}

/// The statistics of every column; of the frames, some only, as `LeRobot` has it.
fn statistics(columns: &[(String, Column)], rows: &[Row]) -> Result<BTreeMap<String, Stats>, String> {
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
        let frame = png::decode(&rows[sample * rows.len() / n_samples].png)?;
        pixels.extend(frame.rgb().iter().map(|&byte| f64::from(byte) / 255.0));
    }
    stats.insert(IMAGE.into(), Stats::of(3, &pixels, n_samples));
    Ok(stats)
}

/// An episode file whose footer has been read.
pub(super) struct Sealed {
    table: Table,
    path: PathBuf,
    pub(super) notes: Notes,
}

impl Sealed {
    /// Opens the file of episode `number`.
    pub(super) fn open(path: PathBuf, number: usize) -> Result<Self, DatasetError> {
        let sealed = Self::open_anywhere(path)?;
        if sealed.notes.number != number {
            let reason = format!("it says it is episode {}", sealed.notes.number);
            return Err(DatasetError::damaged(reason, &sealed.path));
        }
        Ok(sealed)
    }

    /// Opens the file of an episode, whatever its number.
    pub(super) fn open_anywhere(path: PathBuf) -> Result<Self, DatasetError> {
        let file = File::open(&path).map_err(DatasetError::disk("open the episode", &path))?;
        let table = Table::new(file).map_err(|error| DatasetError::damaged(error.to_string(), &path))?;
        let notes = table.note(NOTES).ok_or_else(|| DatasetError::damaged("not recorded by dropj", &path))?;
        let notes: Notes =
            serde_json::from_str(notes).map_err(|error| DatasetError::damaged(error.to_string(), &path))?;
        if notes.format != FORMAT {
            let reason = format!("its format is {}, not {FORMAT}", notes.format);
            return Err(DatasetError::damaged(reason, &path));
        }
        if notes.n_steps != table.n_rows() || notes.n_steps == 0 {
            let reason = format!("it says it has {} steps", notes.n_steps);
            return Err(DatasetError::damaged(reason, &path));
        }
        Ok(Self { table, path, notes })
    }

    /// Reads all of it.
    pub(super) fn read(self) -> Result<Episode, DatasetError> {
        self.read_columns().map_err(|reason| DatasetError::damaged(reason, &self.path))
    }

    fn read_columns(&self) -> Result<Episode, String> {
        let Take { rows, end, .. } = self.take()?;
        let pngs = rows.iter().map(|row| &row.png).chain(end.iter().map(|end| &end.png));
        let frames = pngs.map(|png| png::decode(png)).collect::<Result<Vec<Frame>, _>>()?;
        if let Some(frame) = frames.iter().find(|frame| frame.side() != self.notes.side) {
            return Err(format!("a frame has {} pixels a side, not {}", frame.side(), self.notes.side));
        }
        let Notes { number, info, done, planned, .. } = self.notes.clone();
        Ok(Episode {
            number,
            info,
            frames,
            actions: rows.iter().map(|row| row.action).collect(),
            rewards: rows.iter().map(|row| row.reward).collect(),
            grass: rows.iter().map(|row| row.grass).collect(),
            contacts: rows.iter().filter_map(|row| row.contacts).collect(),
            wall_times_ns: rows.iter().map(|row| row.wall_time_ns).collect(),
            done,
            planned: planned.into_iter().map(|[from, to]| from..to).collect(),
        })
    }

    /// Reads all of it, its frames as they are stored.
    fn take(&self) -> Result<Take, String> {
        let met = |error: parquet::errors::ParquetError| error.to_string();
        let n = self.notes.n_steps;
        // A decoder that trusts its input must not see a damaged page.
        if !self.table.is_intact().map_err(|error| error.to_string())? {
            return Err("its content does not match its checksum".into());
        }
        let pngs = self.table.read::<ByteArrayType>(&[IMAGE, "bytes"]).map_err(met)?;
        let actions = self.table.read::<FloatType>(&["action", "list", "element"]).map_err(met)?;
        let rewards = self.table.read::<FloatType>(&["next.reward"]).map_err(met)?;
        let grass = self.table.read::<BoolType>(&["next.grass"]).map_err(met)?;
        let wall_times_ns = self.table.read::<Int64Type>(&["wall_time_ns"]).map_err(met)?;
        let contacts = self.contacts().map_err(met)?;
        let lens = [pngs.len(), actions.len() / Action::LEN, rewards.len(), grass.len(), wall_times_ns.len()];
        if lens != [n; 5] {
            return Err(format!("{n} steps have columns of {lens:?}"));
        }
        let (actions, _): (&[[f32; Action::LEN]], _) = actions.as_chunks();
        let is_planned = |t: usize| self.notes.planned.iter().any(|&[from, to]| (from..to).contains(&t));
        let rows = pngs.into_iter().enumerate().map(|(t, png)| {
            let [steer, gas, brake] = actions[t];
            Row {
                png: png.data().to_vec(),
                action: Action { steer, gas, brake },
                reward: rewards[t],
                grass: grass[t],
                contacts: contacts.get(t).copied(),
                wall_time_ns: wall_times_ns[t],
                planned: is_planned(t),
            }
        });
        let rows = rows.collect();
        let last =
            self.table.note(LAST_FRAME).map(|hex| from_hex(hex).ok_or("its last frame is not hexadecimal"));
        let end = last.transpose()?.map(|png| TakeEnd { png, done: self.notes.done });
        Ok(Take { id: self.notes.recording.clone(), info: self.notes.info.clone(), rows, end })
    }

    /// What was touched, where the world has obstacles.
    fn contacts(&self) -> parquet::errors::Result<Vec<Contacts>> {
        if !self.notes.has_obstacles() {
            return Ok(Vec::new());
        }
        let chuckholes = self.table.read::<BoolType>(&[CHUCKHOLE])?;
        let cars = self.table.read::<BoolType>(&[CAR])?;
        Ok(chuckholes.into_iter().zip(cars).map(|(chuckhole, car)| Contacts { chuckhole, car }).collect())
    }
}

/// Bytes in hexadecimal, as notes are text.
pub(super) fn to_hex(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 16] = b"0123456789abcdef";
    bytes.iter().flat_map(|byte| [byte >> 4, byte & 15]).map(|digit| DIGITS[digit as usize] as char).collect()
}

fn from_hex(hex: &str) -> Option<Vec<u8>> {
    let digit = |byte: u8| char::from(byte).to_digit(16).map(|digit| digit as u8);
    let (pairs, rest) = hex.as_bytes().as_chunks();
    if !rest.is_empty() {
        return None;
    }
    pairs.iter().map(|&[high, low]| Some(digit(high)? << 4 | digit(low)?)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hexadecimal_comes_back() {
        let bytes: Vec<u8> = (0..=255).collect();
        assert_eq!(from_hex(&to_hex(&bytes)), Some(bytes));
        assert_eq!(from_hex("0g"), None);
        assert_eq!(from_hex("012"), None);
    }
}
