//! The folder `meta` of `LeRobotDataset` v3.0, derived from the episode files and never read back.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use parquet::errors::Result;
use serde_json::{Map, Value, json};

use super::layout::column;
use super::notes::{ACTION, DONE, IMAGE, Notes, REWARD, STATE, TERMINATED, TRUNCATED};
use super::stats::{QUANTILES, Stats};
use super::table::{Column, to_parquet};
use super::{DatasetError, card, disk};

/// Writes what is missing or says something else than the episodes do.
pub(super) fn write(dir: &Path, episodes: &[Notes]) -> std::result::Result<(), DatasetError> {
    let Some(first) = episodes.first() else { return Ok(()) };
    let meta = dir.join("meta");
    let table = |name: &str, bytes: Result<Vec<u8>>| {
        let path = meta.join(name);
        let bytes = bytes.map_err(|error| DatasetError::damaged(error, &path))?;
        disk::replace_if_other(&path, &bytes)
    };
    table("tasks.parquet", tasks(&task(first)))?;
    table(EPISODES, episode_table(episodes))?;
    for (name, value) in [("stats.json", stats(episodes)), ("info.json", info(first, episodes))] {
        let json = serde_json::to_vec_pretty(&value).expect("text and numbers");
        disk::replace_if_other(&meta.join(name), &json)?;
    }
    card::write(dir, episodes)
}

/// The files that [`write()`] writes, in the folder `meta`.
const FILES: [&str; 4] = ["info.json", "stats.json", "tasks.parquet", EPISODES];
/// The table of episodes.
const EPISODES: &str = "episodes/chunk-000/file-000.parquet";

/// Removes what was written, and the folders that are empty then.
pub(super) fn remove(dir: &Path) -> std::result::Result<(), DatasetError> {
    let meta = dir.join("meta");
    for path in FILES.map(|name| meta.join(name)).iter().filter(|path| path.exists()) {
        fs::remove_file(path).map_err(DatasetError::disk("remove the file", path))?;
    }
    for folder in ["episodes/chunk-000", "episodes", ""] {
        // Where somebody put something of their own, the folder stays.
        fs::remove_dir(meta.join(folder)).ok();
    }
    card::remove(dir)
}

/// Files that others would take for parts of the index, and we did not write.
pub(super) fn strays(dir: &Path) -> std::result::Result<Vec<PathBuf>, DatasetError> {
    let meta = dir.join("meta");
    let mut strays = Vec::new();
    for chunk in disk::list(&meta.join("episodes"))?.into_iter().filter(|path| path.is_dir()) {
        strays.extend(disk::list(&chunk)?);
    }
    let is_stray = |path: &PathBuf| {
        path.extension().is_some_and(|extension| extension == "parquet") && *path != meta.join(EPISODES)
    };
    strays.retain(is_stray);
    Ok(strays)
}

/// What the driver was asked to do, in the words of the dataset.
fn task(first: &Notes) -> String {
    format!("Drive in {}", first.info.env)
}

/// `info.json`: what the dataset is.
fn info(first: &Notes, episodes: &[Notes]) -> Value {
    let n_episodes = episodes.len();
    let scalar = |dtype: &str| json!({"dtype": dtype, "shape": [1], "names": null});
    let mut features = json!({
        IMAGE: {"dtype": "image", "shape": [first.height, first.width, 3], "names": ["height", "width", "channels"]},
        ACTION: {"dtype": "float32", "shape": [first.axes.len()], "names": first.axes},
        REWARD: scalar("float32"),
        DONE: scalar("bool"),
        "wall_time_ns": scalar("int64"),
        "timestamp": scalar("float32"),
        "frame_index": scalar("int64"),
        "episode_index": scalar("int64"),
        "index": scalar("int64"),
        "task_index": scalar("int64"),
    });
    if first.columns().ends {
        for name in [TERMINATED, TRUNCATED] {
            features[name] = scalar("bool");
        }
    }
    for event in &first.events {
        features[column(event)] = scalar("bool");
    }
    if !first.state.is_empty() {
        features[STATE] = json!({"dtype": "float32", "shape": [first.state.len()], "names": first.state});
    }
    json!({
        "codebase_version": "v3.0",
        "robot_type": first.info.env,
        "total_episodes": n_episodes,
        "total_frames": episodes.iter().map(|notes| notes.n_steps).sum::<usize>(),
        "total_tasks": 1,
        "chunks_size": disk::FILES_PER_CHUNK,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": rate(first.rate),
        "splits": {"train": format!("0:{n_episodes}")},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": null,
        "features": features,
        "dropj": {"env": first.info.env, "app": env!("CARGO_PKG_VERSION")},
    })
}

/// Steps a second, without a point where there is nothing behind it: so `LeRobot` has them.
fn rate(rate: f64) -> Value {
    if rate.fract() == 0.0 { json!(rate as u64) } else { json!(rate) }
}

/// `stats.json`: the statistics of each column over all episodes.
fn stats(episodes: &[Notes]) -> Value {
    let mut all: BTreeMap<&str, Stats> = BTreeMap::new();
    for (name, stats) in episodes.iter().flat_map(|notes| &notes.stats) {
        all.entry(name).and_modify(|before| *before = before.merged(stats)).or_insert_with(|| stats.clone());
    }
    let mut features = Map::new();
    for (name, stats) in all {
        // `LeRobot` keeps one number per color channel as [3, 1, 1].
        let shaped = |values: &[f64]| match name {
            IMAGE => values.iter().map(|value| json!([[value]])).collect(),
            _ => json!(values),
        };
        let Stats { min, max, mean, std, count, quantiles } = &stats;
        let mut told = json!({
            "min": shaped(min), "max": shaped(max), "mean": shaped(mean), "std": shaped(std), "count": [count]
        });
        for ((quantile, _), values) in QUANTILES.iter().zip(quantiles) {
            told[*quantile] = shaped(values);
        }
        features.insert(name.into(), told);
    }
    features.into()
}

/// `tasks.parquet`: a `pandas` frame with the only task as its index.
fn tasks(task: &str) -> Result<Vec<u8>> {
    let column = |name: &str, kind: &str, numpy: &str| json!({"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy, "metadata": null});
    let pandas = json!({
        "index_columns": ["task"],
        "column_indexes": [{
            "name": null, "field_name": null, "pandas_type": "unicode", "numpy_type": "object",
            "metadata": {"encoding": "UTF-8"},
        }],
        "columns": [column("task_index", "int64", "int64"), column("task", "unicode", "object")],
        "creator": {"library": "dropj", "version": env!("CARGO_PKG_VERSION")},
        "pandas_version": "2.2.0",
    });
    let columns =
        vec![("task_index".into(), Column::Ints(vec![0])), ("task".into(), Column::Texts(vec![task.into()]))];
    to_parquet(columns, vec![("pandas".into(), pandas.to_string())])
}

/// `episodes/…/file-000.parquet`: a row for each episode.
fn episode_table(episodes: &[Notes]) -> Result<Vec<u8>> {
    let ints = |number: fn(&Notes) -> usize| {
        Column::Ints(episodes.iter().map(|notes| number(notes) as i64).collect())
    };
    let texts = |text: fn(&Notes) -> String| Column::Texts(episodes.iter().map(text).collect());
    let mut columns = vec![
        ("episode_index".to_owned(), ints(|notes| notes.number)),
        ("tasks".to_owned(), Column::TextLists(episodes.iter().map(task).collect())),
        ("length".to_owned(), ints(|notes| notes.n_steps)),
        ("data/chunk_index".to_owned(), ints(|notes| notes.number / disk::FILES_PER_CHUNK)),
        ("data/file_index".to_owned(), ints(|notes| notes.number % disk::FILES_PER_CHUNK)),
        ("dataset_from_index".to_owned(), ints(|notes| notes.first_index)),
        ("dataset_to_index".to_owned(), ints(|notes| notes.first_index + notes.n_steps)),
        ("meta/episodes/chunk_index".to_owned(), ints(|_| 0)),
        ("meta/episodes/file_index".to_owned(), ints(|_| 0)),
        ("env".to_owned(), texts(|notes| notes.info.env.clone())),
        ("pilot".to_owned(), texts(|notes| notes.info.pilot.clone())),
        ("seed".to_owned(), Column::Unsigned(episodes.iter().map(|notes| notes.info.seed).collect())),
        ("app".to_owned(), texts(|notes| notes.app.clone())),
    ];
    let Some(first) = episodes.first() else { return to_parquet(columns, Vec::new()) };
    for name in first.stats.keys() {
        let depth = if name == IMAGE { 3 } else { 1 };
        let mut add = |part: &str, depth, values: &dyn Fn(&Stats) -> Vec<f64>| {
            let rows = episodes.iter().map(|notes| values(&notes.stats[name])).collect();
            columns.push((format!("stats/{name}/{part}"), Column::DoubleLists(depth, rows)));
        };
        add("min", depth, &|stats| stats.min.clone());
        add("max", depth, &|stats| stats.max.clone());
        add("mean", depth, &|stats| stats.mean.clone());
        add("std", depth, &|stats| stats.std.clone());
        add("count", 1, &|stats| vec![stats.count as f64]);
        // A table has no holes: with an episode of an older version, none has them.
        if episodes.iter().all(|notes| !notes.stats[name].quantiles.is_empty()) {
            for (i, (quantile, _)) in QUANTILES.iter().enumerate() {
                add(quantile, depth, &|stats| stats.quantiles[i].clone());
            }
        }
    }
    to_parquet(columns, Vec::new())
}
