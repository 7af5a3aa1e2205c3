//! `meta/episodes/**` and `meta/tasks.parquet`: which episodes there are, where they lie, and what was to be done.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use super::DatasetError;
use super::columns::{self, Columns};
use super::fault::LeRobotFault;
use super::info::Info;
use crate::dataset::limits;
use crate::text::shown_within;

/// Files and folders that are looked at.
const MOST_FILES: usize = 100_000;
/// Letters of a task.
const MOST_TASK: usize = 4096;
/// Tasks of a dataset.
const MOST_TASKS: usize = 1_000_000;

/// An episode, as the list has it.
#[derive(Clone, Debug)]
pub(super) struct Entry {
    /// Its number in the data.
    pub(super) number: i64,
    /// Its rows.
    pub(super) len: usize,
    /// Chunk and file of its rows.
    pub(super) data: [u32; 2],
    /// Where its videos lie, in the order of the cameras that have one.
    pub(super) videos: Vec<VideoPlace>,
}

/// Where the video of an episode lies.
#[derive(Clone, Copy, Debug)]
pub(super) struct VideoPlace {
    /// Chunk and file.
    pub(super) file: [u32; 2],
    /// When it begins in it, in seconds.
    pub(super) from: f64,
}

/// All episodes, by their numbers.
pub(super) fn read(dir: &Path, info: &Info) -> Result<Vec<Entry>, DatasetError> {
    let folder = dir.join("meta").join("episodes");
    let files = tables(&folder)?;
    if files.is_empty() {
        // Whether whoever recorded it was killed is seen at the data.
        let data = tables(&dir.join("data"))?;
        return Err(match data.iter().find(|path| !columns::is_whole(path)) {
            Some(torn) => LeRobotFault::Killed.at(torn),
            None => LeRobotFault::NotFinalized { told: info.told.clone() }.at(&folder),
        });
    }
    let mut entries = Vec::new();
    for path in files {
        let table = Columns::open(&path, "it lists the episodes")?;
        entries.extend(entries_of(&table, info).map_err(|fault| fault.at(&path))?);
    }
    entries.sort_by_key(|entry: &Entry| entry.number);
    if let Some(pair) = entries.windows(2).find(|pair| pair[0].number == pair[1].number) {
        let why = format!("it has episode {} twice", pair[0].number);
        return Err(LeRobotFault::Episodes(why).at(&folder));
    }
    if entries.is_empty() {
        return Err(LeRobotFault::Empty.at(dir));
    }
    Ok(entries)
}

fn entries_of(table: &Columns, info: &Info) -> Result<Vec<Entry>, LeRobotFault> {
    let rows = table.all();
    let file = |prefix: &str| -> Result<Vec<[u32; 2]>, LeRobotFault> {
        let chunks = table.counts(&format!("{prefix}/chunk_index"), &rows)?;
        let files = table.counts(&format!("{prefix}/file_index"), &rows)?;
        let small =
            |n: i64| u32::try_from(n).map_err(|_| LeRobotFault::Episodes(format!("a file has number {n}")));
        chunks.into_iter().zip(files).map(|(chunk, file)| Ok([small(chunk)?, small(file)?])).collect()
    };
    let numbers = table.counts("episode_index", &rows)?;
    let lens = table.counts("length", &rows)?;
    let data = file("data")?;
    let mut videos = Vec::new();
    for camera in info.cameras.iter().filter(|camera| camera.is_video) {
        let prefix = format!("videos/{}", camera.name);
        let from = table.numbers(&format!("{prefix}/from_timestamp"), 1, &rows)?;
        videos.push((file(&prefix)?, from));
    }
    let mut entries = Vec::with_capacity(numbers.len());
    for (i, number) in numbers.into_iter().enumerate() {
        let len = usize::try_from(lens[i]).unwrap_or(usize::MAX);
        if !(1..=limits::STEPS).contains(&len) {
            let why = format!("episode {number} has {len} rows, and one has 1 to {}", limits::STEPS);
            return Err(LeRobotFault::Episodes(why));
        }
        let places = videos.iter().map(|(files, from)| VideoPlace { file: files[i], from: from[i] });
        let places: Vec<_> = places.collect();
        if let Some(place) = places.iter().find(|place| !(0.0..1e9).contains(&place.from)) {
            let why = format!("episode {number} begins {} s after its video does", place.from);
            return Err(LeRobotFault::Episodes(why));
        }
        entries.push(Entry { number, len, data: data[i], videos: places });
    }
    Ok(entries)
}

/// The texts of the tasks by their numbers.
pub(super) fn tasks(dir: &Path) -> Result<BTreeMap<i64, String>, DatasetError> {
    let path = dir.join("meta").join("tasks.parquet");
    let table = Columns::open(&path, "it says what was to be done")?;
    tasks_of(&table).map_err(|fault| fault.at(&path))
}

fn tasks_of(table: &Columns) -> Result<BTreeMap<i64, String>, LeRobotFault> {
    let rows = table.all();
    let numbers = table.counts("task_index", &rows)?;
    if numbers.len() > MOST_TASKS {
        return Err(LeRobotFault::Table(format!("it lists {} tasks", numbers.len())));
    }
    let known = ["task", "__index_level_0__"].into_iter().find(|name| table.has(name)).map(str::to_owned);
    let column = known.or_else(|| table.only_text());
    let column = column.ok_or(LeRobotFault::NoColumn { column: "task".to_owned(), wanted: "texts" })?;
    let texts = table.bytes(&column, "", &rows)?;
    let shown = |text: Option<Vec<u8>>| match String::from_utf8_lossy(&text.unwrap_or_default()).trim() {
        "" => String::new(),
        text => shown_within(text, MOST_TASK),
    };
    Ok(numbers.into_iter().zip(texts.into_iter().map(shown)).collect())
}

/// The Parquet files in the folders of `folder`, sorted. None where there is no such folder.
fn tables(folder: &Path) -> Result<Vec<PathBuf>, DatasetError> {
    let mut found = BTreeSet::new();
    let mut n_looked_at = 0;
    let mut folders = vec![(folder.to_path_buf(), 0)];
    while let Some((folder, depth)) = folders.pop() {
        let entries = match fs::read_dir(&folder) {
            Ok(entries) => entries,
            Err(met) if met.kind() == std::io::ErrorKind::NotFound => continue,
            Err(met) => return Err(DatasetError::disk("list the folder", &folder)(met)),
        };
        for entry in entries {
            let path = entry.map_err(DatasetError::disk("list the folder", &folder))?.path();
            n_looked_at += 1;
            if n_looked_at > MOST_FILES {
                return Err(
                    LeRobotFault::Episodes(format!("there are more than {MOST_FILES} files")).at(&folder)
                );
            }
            let is_hidden = path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
            if path.is_dir() {
                if depth < 3 && !is_hidden {
                    folders.push((path, depth + 1));
                }
            } else if !is_hidden && path.extension().is_some_and(|extension| extension == "parquet") {
                found.insert(path);
            }
        }
    }
    Ok(found.into_iter().collect())
}
