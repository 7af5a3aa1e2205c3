//! `LeRobotDataset`s v3.0 that others made, as material: whichever cameras, actions, rates and files they have.
//!
//! ```text
//! meta/info.json                     what there is: features with their shapes and names, rows a second, templates of paths
//! meta/episodes/chunk-*/file-*       a row an episode: its length, and in which files its rows and videos lie
//! meta/tasks.parquet                 what was to be done
//! meta/stats.json                    least and greatest values; not needed, and of pictures not right
//! data/chunk-*/file-*.parquet        a row a step, many episodes a file
//! videos/KEY/chunk-*/file-*.mp4      a picture a row, many episodes a file
//! ```
//!
//! An episode's rows are those of its `episode_index` in its file, in the order of `frame_index`; how they are grouped, and
//! of which types they are, says nothing. Row `r` shows picture `round((from_timestamp + timestamp) · fps)` of its video.
//! There is no frame after the last action: n rows have n frames.
//!
//! Videos in AV1 are decoded here; others by the program `ffmpeg`, where it is installed. Nothing of a dataset is trusted:
//! its numbers are held against limits before room is made, its paths stay within it, and a decoder that panics is met.

mod av1;
mod columns;
mod episodes;
mod fault;
mod ffmpeg;
mod info;
mod mp4;
mod pictures;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use serde_json::Value;

pub use fault::LeRobotFault;

use columns::{Columns, Rows};
use episodes::Entry;
use info::Info;
use pictures::{Pictures, Stored, Whose};

use super::DatasetError;
use crate::world::{EventReader, EventSpec, Frame, Happened, ImageSpec, image};

/// Bytes of all frames of an episode, as they are in memory.
const MOST_FRAME_BYTES: u64 = 4 << 30;
/// Numbers of an episode beside its frames.
const MOST_NUMBERS: usize = 256 << 20;

/// A camera of a dataset.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Camera {
    /// Its name, such as `observation.images.front`.
    pub name: String,
    /// Rows of pixels.
    pub height: u32,
    /// Pixels of a row.
    pub width: u32,
    /// Whether its pictures lie in videos, and not each by itself.
    pub is_video: bool,
}

/// A column of numbers or truth values, one or several a row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Feature {
    /// Its name, such as `action` or `next.reward`.
    pub name: String,
    /// What its numbers are called: as the dataset says, or "axis 1" and so on.
    pub components: Vec<String>,
    /// Whether the dataset says so.
    pub is_named: bool,
    /// Whether they are truth values.
    pub is_bool: bool,
}

impl Feature {
    /// Whether its name says that it is what was done.
    pub fn is_action(&self) -> bool {
        self.name.split(['.', '_', '/']).next().is_some_and(|first| matches!(first, "action" | "actions"))
    }
}

/// What of a dataset is looked at.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct View {
    /// The cameras. Several stand side by side from left to right, each brought to the height of the first. None: the
    /// first one of the dataset.
    pub cameras: Vec<String>,
    /// The feature that is the action. None: `action`, or the only one of such a name.
    pub action: Option<String>,
}

/// An episode as others recorded it: n rows.
#[derive(Clone, Debug, PartialEq)]
pub struct RawEpisode {
    /// Its number in the dataset, which may leave some out.
    pub number: i64,
    /// What was seen at each row, before its action.
    pub frames: Vec<Frame>,
    /// What was done at each.
    pub actions: Vec<Vec<f32>>,
    /// Every feature of a number a row by its name. Of those with several, each number is there as `NAME.0`, `NAME.1` and
    /// so on, and where it has a name as `NAME.COMPONENT` too. Truth values are 1 and 0; what is missing is not a number.
    pub scalars: BTreeMap<String, Vec<f32>>,
    /// What was to be done at each; nothing where the dataset does not say.
    pub tasks: Vec<String>,
}

impl RawEpisode {
    /// What happened at each row, in the order of `events`, whose fields are names of [`Self::scalars`]. A field that is not
    /// among them, or is not a number at a row, says that nothing happens.
    pub fn happened(&self, events: &[EventSpec]) -> Vec<Vec<Happened>> {
        let mut reader = EventReader::new(events);
        let fields: BTreeSet<&String> =
            events.iter().flat_map(|event| [Some(&event.field), event.passed.as_ref()]).flatten().collect();
        let row = |row: usize| {
            let told = fields.iter().filter_map(|&name| {
                let number = serde_json::Number::from_f64(f64::from(*self.scalars.get(name)?.get(row)?))?;
                Some((name.clone(), Value::Number(number)))
            });
            reader.read(&told.collect())
        };
        (0..self.actions.len()).map(row).collect()
    }
}

/// A `LeRobotDataset` of others.
#[derive(Debug)]
pub struct LeRobotDataset {
    dir: PathBuf,
    info: Info,
    entries: Vec<Entry>,
    tasks: BTreeMap<i64, String>,
    /// What reads videos that are not AV1.
    ffmpeg: OsString,
    /// The file of rows that was read last: most episodes lie in the one of the episode before.
    last: Mutex<Option<Arc<DataFile>>>,
}

/// A file of rows, and which of them each episode has.
struct DataFile {
    columns: Columns,
    rows: HashMap<i64, Rows>,
}

impl std::fmt::Debug for DataFile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "DataFile({:?})", self.columns.path())
    }
}

/// The rows of an episode: where they are, and the order that they belong in.
struct Found {
    file: Arc<DataFile>,
    rows: Rows,
    /// Of the rows in the order of the file, which comes first, second and so on.
    order: Vec<usize>,
}

impl LeRobotDataset {
    /// Opens the dataset at `dir`. It is only ever read.
    ///
    /// # Errors
    /// Where it is none, of another version, not finalized, or damaged: see [`LeRobotFault`].
    pub fn open(dir: &Path) -> Result<Self, DatasetError> {
        let info = Info::read(dir)?;
        let entries = episodes::read(dir, &info)?;
        let tasks = episodes::tasks(dir)?;
        Ok(Self {
            dir: dir.to_path_buf(),
            info,
            entries,
            tasks,
            ffmpeg: "ffmpeg".into(),
            last: Mutex::new(None),
        })
    }

    /// Whether the folder at `dir` looks like such a dataset, whoever made it.
    pub fn is_at(dir: &Path) -> bool {
        dir.join("meta").join("info.json").is_file()
    }

    /// Its folder.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// Rows a second.
    pub fn fps(&self) -> f64 {
        self.info.fps
    }

    /// Its cameras, in its order. Those that show depths are left out.
    pub fn cameras(&self) -> &[Camera] {
        &self.info.cameras
    }

    /// Its columns of numbers and truth values, in its order; without those that only count rows.
    pub fn features(&self) -> &[Feature] {
        &self.info.features
    }

    /// How many episodes there are.
    pub fn n_episodes(&self) -> usize {
        self.entries.len()
    }

    /// The number of episode `idx`, which datasets may leave some out of.
    ///
    /// # Panics
    /// Where there are not so many.
    pub fn number(&self, idx: usize) -> i64 {
        self.entries[idx].number
    }

    /// How many rows episode `idx` has.
    ///
    /// # Panics
    /// Where there are not so many.
    pub fn len(&self, idx: usize) -> usize {
        self.entries[idx].len
    }

    /// The camera of this name.
    ///
    /// # Errors
    /// Where there is none; the message lists those that there are.
    pub fn camera(&self, name: &str) -> Result<&Camera, DatasetError> {
        let found = self.cameras().iter().find(|camera| camera.name == name);
        found.ok_or_else(|| {
            let names = self.cameras().iter().map(|camera| camera.name.as_str());
            self.choice(format!("there is no camera {name:?} in this dataset; {}", listed(names)))
        })
    }

    /// The feature that is the action: the one of this name, or `action`, or the only one of such a name.
    ///
    /// # Errors
    /// Where there is none, or more than one that it could be.
    pub fn action(&self, name: Option<&str>) -> Result<&Feature, DatasetError> {
        let features = self.features();
        let named = |name: &str| features.iter().find(|feature| feature.name == name);
        let all = || listed(features.iter().map(|feature| feature.name.as_str()));
        if let Some(name) = name {
            return named(name).ok_or_else(|| {
                self.choice(format!("there is no column of numbers {name:?} in this dataset; {}", all()))
            });
        }
        let mut actions = features.iter().filter(|feature| feature.is_action());
        match (named("action"), actions.next(), actions.next()) {
            (Some(action), ..) | (None, Some(action), None) => Ok(action),
            (None, None, _) => Err(self.choice(format!(
                "no column of this dataset is called an action; say which one it is (action = \"NAME\" in [source]); {}",
                all()
            ))),
            (None, Some(_), Some(_)) => {
                let actions = features.iter().filter(|feature| feature.is_action());
                let names = listed(actions.map(|feature| feature.name.as_str()));
                Err(self.choice(format!(
                    "several columns of this dataset could be the action; say which one it is (action = \"NAME\" in \
                     [source]); {names}"
                )))
            }
        }
    }

    /// The cameras of a view.
    ///
    /// # Errors
    /// Where there is none of a name, or none at all.
    pub fn cameras_of(&self, view: &View) -> Result<Vec<&Camera>, DatasetError> {
        if view.cameras.is_empty() {
            let first = self.cameras().first();
            let first = first.ok_or_else(|| self.choice("this dataset has no camera".to_owned()))?;
            return Ok(vec![first]);
        }
        view.cameras.iter().map(|name| self.camera(name)).collect()
    }

    /// The size of the frames of a view: height and width.
    ///
    /// # Errors
    /// As [`Self::cameras_of`].
    pub fn frame_size(&self, view: &View) -> Result<[u32; 2], DatasetError> {
        let cameras = self.cameras_of(view)?;
        let height = cameras[0].height;
        let width = cameras.iter().map(|camera| tile_width(camera, height)).fold(0, u32::saturating_add);
        Ok([height, width])
    }

    /// The least and the greatest value of each number of a feature, over all episodes.
    ///
    /// They are taken from `meta/stats.json` where they are there and can be right; else all rows are read.
    ///
    /// # Errors
    /// Where there is no such feature, and where rows cannot be read.
    pub fn ranges(&self, feature: &str) -> Result<Vec<[f32; 2]>, DatasetError> {
        let width = self.action(Some(feature))?.components.len();
        if let Some(ranges) = self.told_ranges(feature, width) {
            return Ok(ranges);
        }
        let mut ranges = vec![[f32::INFINITY, f32::NEG_INFINITY]; width];
        for idx in 0..self.n_episodes() {
            for row in self.rows_of(idx, feature)? {
                for (range, value) in ranges.iter_mut().zip(row) {
                    *range = [range[0].min(value), range[1].max(value)];
                }
            }
        }
        Ok(ranges)
    }

    /// What `meta/stats.json` says of them.
    fn told_ranges(&self, feature: &str, width: usize) -> Option<Vec<[f32; 2]>> {
        let path = self.dir.join("meta").join("stats.json");
        let stats: Value = info::json(&path, "").ok()?;
        let values = |key: &str| -> Option<Vec<f32>> {
            let values = match stats.get(feature)?.get(key)? {
                Value::Array(values) => values.iter().map(Value::as_f64).collect::<Option<Vec<_>>>()?,
                value => vec![value.as_f64()?],
            };
            (values.len() == width).then(|| values.into_iter().map(|value| value as f32).collect())
        };
        let ranges: Vec<_> =
            values("min")?.into_iter().zip(values("max")?).map(|(min, max)| [min, max]).collect();
        let is_sane = |[min, max]: &[f32; 2]| min.is_finite() && max.is_finite() && min <= max;
        ranges.iter().all(is_sane).then_some(ranges)
    }

    /// The numbers of a feature at each row of episode `idx`, without reading anything else.
    ///
    /// # Errors
    /// Where there is no such feature, where rows cannot be read, and where a number is none.
    ///
    /// # Panics
    /// Where there are not so many episodes.
    pub fn rows_of(&self, idx: usize, feature: &str) -> Result<Vec<Vec<f32>>, DatasetError> {
        let feature = self.action(Some(feature))?;
        let found = self.find(idx)?;
        self.actions(idx, feature, &found)
    }

    /// What [`RawEpisode::scalars`] has of episode `idx`, without reading anything else.
    ///
    /// # Errors
    /// Where rows cannot be read.
    ///
    /// # Panics
    /// Where there are not so many episodes.
    pub fn scalars_of(&self, idx: usize) -> Result<BTreeMap<String, Vec<f32>>, DatasetError> {
        let found = self.find(idx)?;
        self.scalars(idx, &found)
    }

    /// Episode `idx`, its frames as large as the cameras'.
    ///
    /// # Errors
    /// Where the view names what is not there, and where something of the episode cannot be read.
    ///
    /// # Panics
    /// Where there are not so many episodes.
    pub fn episode(&self, idx: usize, view: &View) -> Result<RawEpisode, DatasetError> {
        self.read(idx, view, &|frame| frame, self.frame_size(view)?)
    }

    /// Episode `idx`, each frame cut, padded and brought to size as [`image::framed`] does it as soon as it is decoded: so
    /// that long episodes of large pictures fit into memory.
    ///
    /// # Errors
    /// As [`Self::episode`].
    ///
    /// # Panics
    /// Where there are not so many episodes.
    pub fn framed_episode(
        &self,
        idx: usize,
        view: &View,
        spec: &ImageSpec,
    ) -> Result<RawEpisode, DatasetError> {
        let trained = spec.trained();
        self.read(idx, view, &|frame| image::framed(spec, &frame), [trained.height, trained.width])
    }

    fn read(
        &self,
        idx: usize,
        view: &View,
        brought: &dyn Fn(Frame) -> Frame,
        [height, width]: [u32; 2],
    ) -> Result<RawEpisode, DatasetError> {
        let entry = &self.entries[idx];
        let (cameras, action) = (self.cameras_of(view)?, self.action(view.action.as_deref())?);
        let n_bytes = 3 * u64::from(height) * u64::from(width) * entry.len as u64;
        if n_bytes > MOST_FRAME_BYTES {
            let why = format!(
                "its {} pictures of {height} x {width} are more than is held in memory; let them be smaller (train in \
                 [image])",
                entry.len
            );
            return Err(self.episode_fault(idx, why));
        }
        let found = self.find(idx)?;
        let actions = self.actions(idx, action, &found)?;
        let scalars = self.scalars(idx, &found)?;
        let tasks = self.tasks_of(&found)?;
        let mut sources = Vec::new();
        for camera in &cameras {
            sources.push(self.pictures(idx, camera, &found)?);
        }
        let mut frames = Vec::with_capacity(entry.len);
        for row in 0..entry.len {
            let mut tiles = Vec::with_capacity(cameras.len());
            for (camera, source) in cameras.iter().copied().zip(&mut sources) {
                tiles.push(source.next(row, Whose { dir: &self.dir, camera, episode: entry.number })?);
            }
            frames.push(brought(tiled(tiles)));
        }
        Ok(RawEpisode { number: entry.number, frames, actions, scalars, tasks })
    }

    /// Where the rows of episode `idx` are.
    fn find(&self, idx: usize) -> Result<Found, DatasetError> {
        let entry = &self.entries[idx];
        let path = self.info.data_path.path(entry.data[0], entry.data[1], "");
        let path = self.dir.join(path.map_err(|fault| fault.at(&self.dir))?);
        let file = self.data_file(&path)?;
        let rows = file.rows.get(&entry.number).cloned().unwrap_or_default();
        let n: usize = rows.iter().map(|(_, rows)| rows.len()).sum();
        let fault = |why: String| LeRobotFault::Episode { episode: entry.number, why }.at(&path);
        if n != entry.len {
            return Err(fault(format!(
                "the list of episodes says that it has {} rows, and this file has {n}",
                entry.len
            )));
        }
        let frames = file.columns.counts("frame_index", &rows).map_err(|met| met.at(&path))?;
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by_key(|&row| frames[row]);
        if let Some((at, &row)) = order.iter().enumerate().find(|&(at, &row)| frames[row] != at as i64) {
            return Err(fault(format!("row {at} of it says that its frame_index is {}", frames[row])));
        }
        Ok(Found { file, rows, order })
    }

    /// The file of rows at `path`: the one that was read last, or else it is looked over.
    fn data_file(&self, path: &Path) -> Result<Arc<DataFile>, DatasetError> {
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(file) = last.as_ref().filter(|file| file.columns.path() == path) {
            return Ok(Arc::clone(file));
        }
        let columns = Columns::open(path, "the rows of an episode are in it")?;
        let mut rows: HashMap<i64, Rows> = HashMap::new();
        let numbers = columns.counts("episode_index", &columns.all()).map_err(|met| met.at(path))?;
        let mut numbers = numbers.into_iter();
        for (group, places) in columns.all() {
            for (place, number) in places.into_iter().zip(&mut numbers) {
                let groups = rows.entry(number).or_default();
                match groups.last_mut().filter(|(last, _)| *last == group) {
                    Some((_, rows)) => rows.push(place),
                    None => groups.push((group, vec![place])),
                }
            }
        }
        let file = Arc::new(DataFile { columns, rows });
        *last = Some(Arc::clone(&file));
        Ok(file)
    }

    fn actions(&self, idx: usize, action: &Feature, found: &Found) -> Result<Vec<Vec<f32>>, DatasetError> {
        let width = action.components.len();
        let numbers = numbers(&action.name, width, found)?;
        let numbers: Vec<f32> = numbers.into_iter().map(|number| number as f32).collect();
        if let Some(at) = numbers.iter().position(|number| !number.is_finite()) {
            let (row, axis) = (at / width, action.components[at % width].clone());
            let fault =
                LeRobotFault::NotFinite { episode: self.entries[idx].number, row, axis, found: numbers[at] };
            return Err(fault.at(found.file.columns.path()));
        }
        Ok(numbers.chunks_exact(width).map(<[f32]>::to_vec).collect())
    }

    fn scalars(&self, idx: usize, found: &Found) -> Result<BTreeMap<String, Vec<f32>>, DatasetError> {
        let n_numbers: usize = self.features().iter().map(|feature| feature.components.len()).sum();
        if n_numbers.saturating_mul(self.len(idx)) > MOST_NUMBERS {
            return Err(self.episode_fault(idx, format!("it has {n_numbers} numbers a row")));
        }
        let mut scalars = BTreeMap::new();
        let mut named = Vec::new();
        for feature in self.features() {
            let width = feature.components.len();
            let numbers = numbers(&feature.name, width, found)?;
            if width == 1 {
                let values = numbers.into_iter().map(|number| number as f32).collect();
                scalars.insert(feature.name.clone(), values);
                continue;
            }
            for (i, component) in feature.components.iter().enumerate() {
                let values: Vec<f32> =
                    numbers.iter().skip(i).step_by(width).map(|&number| number as f32).collect();
                if feature.is_named {
                    named.push((format!("{}.{component}", feature.name), values.clone()));
                }
                scalars.insert(format!("{}.{i}", feature.name), values);
            }
        }
        for (name, values) in named {
            scalars.entry(name).or_insert(values);
        }
        Ok(scalars)
    }

    /// What was to be done at each row.
    fn tasks_of(&self, found: &Found) -> Result<Vec<String>, DatasetError> {
        if !found.file.columns.has("task_index") {
            return Ok(vec![String::new(); found.order.len()]);
        }
        let numbers = numbers("task_index", 1, found)?;
        let task = |number: f64| self.tasks.get(&(number as i64)).cloned().unwrap_or_default();
        Ok(numbers.into_iter().map(task).collect())
    }

    /// Where the pictures of a camera come from in an episode.
    fn pictures(&self, idx: usize, camera: &Camera, found: &Found) -> Result<Pictures, DatasetError> {
        let entry = &self.entries[idx];
        let columns = &found.file.columns;
        if !camera.is_video {
            // Without its own column all pictures are files.
            let member = |member: &str| match columns.bytes(&camera.name, member, &found.rows) {
                Ok(all) => Ok(all),
                Err(LeRobotFault::NoColumn { .. }) if member == "path" || !columns.has(&camera.name) => {
                    Ok(vec![None; entry.len])
                }
                Err(met) => Err(met.at(columns.path())),
            };
            let (mut bytes, paths) = (member("bytes")?, member("path")?);
            let stored = found.order.iter().map(|&row| Stored {
                bytes: bytes[row].take(),
                path: paths[row].as_ref().map(|path| String::from_utf8_lossy(path).into_owned()),
            });
            return Ok(Pictures::Stored(stored.collect::<Vec<_>>().into_iter()));
        }
        let with_video = self.cameras().iter().filter(|camera| camera.is_video);
        let place = with_video.zip(&entry.videos).find(|(other, _)| other.name == camera.name);
        let (Some((_, place)), Some(template)) = (place, &self.info.video_path) else {
            return Err(self.episode_fault(idx, format!("it has no video of {:?}", camera.name)));
        };
        let path = template.path(place.file[0], place.file[1], &camera.name);
        let path = self.dir.join(path.map_err(|fault| fault.at(&self.dir))?);
        let times: Vec<f64> = if columns.has("timestamp") {
            numbers("timestamp", 1, found)?
        } else {
            (0..entry.len).map(|row| row as f64 / self.fps()).collect()
        };
        let mut wanted = Vec::with_capacity(times.len());
        for (row, time) in times.into_iter().enumerate() {
            let k = ((place.from + time) * self.fps()).round();
            let is_next = (0.0..1e9).contains(&k) && wanted.last().is_none_or(|&last| last <= k as usize);
            if !is_next {
                return Err(self.episode_fault(idx, format!("the timestamp of row {row}, {time}, cannot be")));
            }
            wanted.push(k as usize);
        }
        Pictures::of_video(path, wanted, self.fps(), camera, &self.ffmpeg)
    }

    fn episode_fault(&self, idx: usize, why: String) -> DatasetError {
        LeRobotFault::Episode { episode: self.entries[idx].number, why }.at(&self.dir)
    }

    fn choice(&self, why: String) -> DatasetError {
        LeRobotFault::Choice(why).at(&self.dir)
    }
}

/// Those that there are, in words.
fn listed<'a>(names: impl Iterator<Item = &'a str>) -> String {
    let names: Vec<String> = names.map(|name| format!("{name:?}")).collect();
    match names.as_slice() {
        [] => "there are none".to_owned(),
        [one] => format!("there is {one}"),
        names => format!("there are {}", names.join(", ")),
    }
}

/// How wide a camera's pictures are once they are so high.
fn tile_width(camera: &Camera, height: u32) -> u32 {
    let width = f64::from(camera.width) * f64::from(height) / f64::from(camera.height);
    (width.round() as u32).max(1)
}

/// Frames side by side, each brought to the height of the first.
fn tiled(mut tiles: Vec<Frame>) -> Frame {
    if tiles.len() == 1 {
        return tiles.remove(0);
    }
    let height = tiles[0].height();
    let tiles: Vec<Frame> = tiles
        .into_iter()
        .map(|frame| {
            let camera =
                Camera { name: String::new(), height: frame.height(), width: frame.width(), is_video: false };
            let width = tile_width(&camera, height);
            image::resized(frame, crate::world::Size { height, width })
        })
        .collect();
    let width = tiles.iter().map(Frame::width).sum();
    let mut rgb = Vec::with_capacity(3 * height as usize * width as usize);
    for row in 0..height as usize {
        for tile in &tiles {
            let len = 3 * tile.width() as usize;
            rgb.extend_from_slice(&tile.rgb()[row * len..(row + 1) * len]);
        }
    }
    Frame::new(height, width, rgb)
}

/// The numbers of a feature in the order of the episode.
fn numbers(feature: &str, width: usize, found: &Found) -> Result<Vec<f64>, DatasetError> {
    let columns = &found.file.columns;
    let numbers = columns.numbers(feature, width, &found.rows).map_err(|met| met.at(columns.path()))?;
    Ok(found.order.iter().flat_map(|&row| &numbers[row * width..(row + 1) * width]).copied().collect())
}
