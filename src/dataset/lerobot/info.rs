//! `meta/info.json`: which features a dataset has, and where its files lie.

use std::fmt;
use std::fs::File;
use std::io::Read as _;
use std::marker::PhantomData;
use std::path::{Component, Path, PathBuf};

use serde::de::{DeserializeOwned, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};
use serde_json::Value;

use super::fault::{self, LeRobotFault};
use super::{Camera, DatasetError, Feature};
use crate::world::MAX_SIDE;

/// Bytes of a file of JSON.
const MOST_JSON: u64 = 64 << 20;
/// Features of a dataset.
const MOST_FEATURES: usize = 4096;
/// Components of a feature.
pub(super) const MOST_COMPONENTS: usize = 4096;
/// Letters of a name.
const MOST_NAME: usize = 256;
/// Columns that count rows and say whose they are: in every dataset, and no measurements.
const COUNTERS: [&str; 5] = ["timestamp", "frame_index", "episode_index", "index", "task_index"];

/// What `info.json` says.
#[derive(Debug)]
pub(super) struct Info {
    pub(super) fps: f64,
    pub(super) cameras: Vec<Camera>,
    pub(super) features: Vec<Feature>,
    pub(super) data_path: Template,
    pub(super) video_path: Option<Template>,
    /// How many episodes and rows it counts, in words.
    pub(super) told: String,
}

/// As the file has it.
#[derive(Deserialize)]
struct InfoFile {
    codebase_version: Option<Value>,
    fps: Option<Value>,
    total_episodes: Option<Value>,
    total_frames: Option<Value>,
    data_path: Option<String>,
    video_path: Option<String>,
    #[serde(default)]
    features: Ordered<FeatureFile>,
}

#[derive(Deserialize)]
struct FeatureFile {
    dtype: Option<Value>,
    shape: Option<Value>,
    #[serde(default)]
    names: Names,
    info: Option<Value>,
}

impl Info {
    /// Reads it from the dataset at `dir`.
    pub(super) fn read(dir: &Path) -> Result<Self, DatasetError> {
        let path = dir.join("meta").join("info.json");
        if !path.exists() {
            // Without a folder at all the system's own words are better.
            std::fs::metadata(dir).map_err(DatasetError::disk("open the dataset", dir))?;
            return Err(LeRobotFault::NoDataset.at(dir));
        }
        let file: InfoFile = json(&path, "it says what the dataset is")?;
        Self::of(file, dir).map_err(|fault| fault.at(&path))
    }

    fn of(file: InfoFile, dir: &Path) -> Result<Self, LeRobotFault> {
        check_version(file.codebase_version.as_ref(), dir)?;
        let fps = file.fps.as_ref().and_then(Value::as_f64).filter(|fps| (0.01..=10_000.0).contains(fps));
        let fps = fps.ok_or_else(|| {
            LeRobotFault::key("fps", told(file.fps.as_ref()), "the rows a second, from 0.01 to 10000")
        })?;
        let data_path = file.data_path.as_deref().unwrap_or_default();
        let data_path = Template::parse("data_path", data_path, false)?;
        let video_path = file.video_path.as_deref().map(|path| Template::parse("video_path", path, true));
        let n = file.features.0.len();
        if n > MOST_FEATURES {
            return Err(LeRobotFault::key("the number of features", n, format!("at most {MOST_FEATURES}")));
        }
        let (mut cameras, mut features) = (Vec::<Camera>::new(), Vec::<Feature>::new());
        for (name, feature) in file.features.0 {
            if name.is_empty() || name.chars().count() > MOST_NAME || name.chars().any(char::is_control) {
                let wanted = format!("of 1 to {MOST_NAME} letters that can be seen");
                return Err(LeRobotFault::key("the name of a feature", name, wanted));
            }
            let dtype = feature.dtype.as_ref().and_then(Value::as_str).unwrap_or_default();
            let dtype = dtype.to_owned();
            match dtype.as_str() {
                "image" | "video" if is_depth(feature.info.as_ref()) => {}
                "image" | "video" => cameras.push(camera(name, &feature, dtype == "video")?),
                "bool" => features.push(columns(name, &feature, true)?),
                "float16" | "float32" | "float64" | "int8" | "int16" | "int32" | "int64" | "uint8"
                | "uint16" | "uint32" | "uint64"
                    if !COUNTERS.contains(&name.as_str()) =>
                {
                    features.push(columns(name, &feature, false)?);
                }
                // Text and others say nothing that could be an action or an event.
                _ => {}
            }
        }
        for (i, name) in cameras.iter().map(|camera| &camera.name).enumerate() {
            if cameras[..i].iter().any(|camera| camera.name == *name) {
                return Err(LeRobotFault::key("a feature", name, "named once"));
            }
        }
        let video_path = video_path.transpose()?;
        if let (Some(camera), None) = (cameras.iter().find(|camera| camera.is_video), &video_path) {
            let wanted = format!("the path of the videos, for {:?} is one", camera.name);
            return Err(LeRobotFault::key("video_path", "missing", wanted));
        }
        let told = format!(
            "info.json counts {} episodes and {} rows",
            told(file.total_episodes.as_ref()),
            told(file.total_frames.as_ref())
        );
        Ok(Self { fps, cameras, features, data_path, video_path, told })
    }
}

/// A file of JSON, whose size is looked at first.
pub(super) fn json<T: DeserializeOwned>(path: &Path, why: &str) -> Result<T, DatasetError> {
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(|met| fault::met(met, path, why))?;
    // One byte more than it may have, for a file that has no end says nothing of its size.
    let read = file.take(MOST_JSON + 1).read_to_end(&mut bytes);
    read.map_err(|met| fault::met(met, path, why))?;
    let found = bytes.len() as u64;
    if found > MOST_JSON {
        return Err(LeRobotFault::TooLarge { found, most: MOST_JSON }.at(path));
    }
    serde_json::from_str(&crate::text::decoded(&bytes)).map_err(|met| LeRobotFault::Json(met).at(path))
}

/// A value of JSON in a message.
fn told(value: Option<&Value>) -> String {
    match value {
        None | Some(Value::Null) => "missing".to_owned(),
        Some(value) => crate::text::shown_within(&value.to_string(), 60),
    }
}

fn check_version(found: Option<&Value>, dir: &Path) -> Result<(), LeRobotFault> {
    let text = found.and_then(Value::as_str).unwrap_or_default();
    let major = text.trim_start_matches('v').split('.').next().and_then(|major| major.parse::<u32>().ok());
    match major {
        Some(3) => Ok(()),
        Some(0..3) => Err(LeRobotFault::Old {
            version: crate::text::shown_within(text, 20),
            command: converter(text, dir),
        }),
        _ => Err(LeRobotFault::Version(told(found))),
    }
}

/// What converts the dataset at `dir`.
fn converter(version: &str, dir: &Path) -> String {
    let whole = dir.canonicalize().unwrap_or_else(|_| dir.to_path_buf());
    let part =
        |path: Option<&Path>| path.and_then(Path::file_name).map(|name| name.to_string_lossy().into_owned());
    let user = whole.parent();
    let name = part(Some(&whole)).unwrap_or_else(|| "NAME".to_owned());
    let (me, parent) = match (part(user), user.and_then(Path::parent)) {
        (Some(me), Some(parent)) => (me, parent.to_string_lossy().into_owned()),
        _ => ("me".to_owned(), "PARENT".to_owned()),
    };
    let first = if version.trim_start_matches('v').starts_with("2.1") {
        ""
    } else {
        "first bring it to v2.1 with the convert_dataset_v20_to_v21 of an older lerobot, and then: "
    };
    format!(
        "{first}python -m lerobot.datasets.v30.convert_dataset_v21_to_v30 --repo-id={:?} --root={:?} --push-to-hub=false \
         (from lerobot 0.6 on the module is lerobot.scripts.convert_dataset_v21_to_v30)",
        format!("{me}/{name}"),
        parent
    )
}

fn is_depth(info: Option<&Value>) -> bool {
    let says = |key: &str| info.and_then(|info| info.get(key)).and_then(Value::as_bool) == Some(true);
    says("video.is_depth_map") || says("is_depth_map")
}

/// The sizes that a feature has.
fn shape(name: &str, feature: &FeatureFile) -> Result<Vec<u64>, LeRobotFault> {
    let sizes = match &feature.shape {
        Some(Value::Array(sizes)) => sizes.iter().map(Value::as_u64).collect::<Option<Vec<_>>>(),
        Some(size) => size.as_u64().map(|size| vec![size]),
        None => None,
    };
    sizes.filter(|sizes| sizes.len() <= 8).ok_or_else(|| {
        let wanted = "a list of whole numbers";
        LeRobotFault::key(format!("features.{name:?}.shape"), told(feature.shape.as_ref()), wanted)
    })
}

fn camera(name: String, feature: &FeatureFile, is_video: bool) -> Result<Camera, LeRobotFault> {
    let sizes = shape(&name, feature)?;
    let wrong =
        |wanted: &str| LeRobotFault::key(format!("features.{name:?}.shape"), format!("{sizes:?}"), wanted);
    let place = |side: &str| feature.names.0.iter().position(|found| found.eq_ignore_ascii_case(side));
    let [height, width] = match (place("height"), place("width"), sizes.as_slice()) {
        (Some(height), Some(width), sizes) if height.max(width) < sizes.len() => {
            [sizes[height], sizes[width]]
        }
        // Without names: channels are few, wherever they stand.
        (_, _, [1 | 3 | 4, height, width]) if ![1, 3, 4].contains(width) => [*height, *width],
        (_, _, [height, width, _] | [height, width]) => [*height, *width],
        _ => return Err(wrong("a height, a width and channels")),
    };
    let side = |found: u64| u32::try_from(found).ok().filter(|side| (1..=MAX_SIDE).contains(side));
    let (Some(height), Some(width)) = (side(height), side(width)) else {
        return Err(wrong(&format!("of 1 to {MAX_SIDE} pixels a side")));
    };
    Ok(Camera { name, height, width, is_video })
}

fn columns(name: String, feature: &FeatureFile, is_bool: bool) -> Result<Feature, LeRobotFault> {
    let sizes = shape(&name, feature)?;
    let n = sizes.iter().try_fold(1_u64, |n, &size| n.checked_mul(size));
    let n = n.and_then(|n| usize::try_from(n).ok()).filter(|n| (1..=MOST_COMPONENTS).contains(n));
    let n = n.ok_or_else(|| {
        let wanted = format!("of 1 to {MOST_COMPONENTS} numbers");
        LeRobotFault::key(format!("features.{name:?}.shape"), format!("{sizes:?}"), wanted)
    })?;
    let shown = |name: &String| match name.trim() {
        "" => String::new(),
        name => crate::text::shown_within(name, MOST_NAME),
    };
    let named: Vec<String> = feature.names.0.iter().map(shown).collect();
    let is_told = |i: usize| !named[i].is_empty() && !named[..i].contains(&named[i]);
    let is_named = named.len() == n && (0..n).all(is_told);
    let components = if is_named { named } else { (1..=n).map(|i| format!("axis {i}")).collect() };
    Ok(Feature { name, components, is_named, is_bool })
}

/// A map in the order of the file.
struct Ordered<V>(Vec<(String, V)>);

impl<V> Default for Ordered<V> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<'de, V: Deserialize<'de>> Deserialize<'de> for Ordered<V> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Pairs<V>(PhantomData<V>);

        impl<'de, V: Deserialize<'de>> Visitor<'de> for Pairs<V> {
            type Value = Ordered<V>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object of features")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
                let mut pairs = Vec::new();
                while let Some(pair) = map.next_entry()? {
                    pairs.push(pair);
                }
                Ok(Ordered(pairs))
            }
        }

        deserializer.deserialize_map(Pairs(PhantomData))
    }
}

/// The names of a feature's components, in whichever way they are told: a list, an object of lists, one in another.
#[derive(Default)]
struct Names(Vec<String>);

impl<'de> Deserialize<'de> for Names {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Any;

        impl<'de> Visitor<'de> for Any {
            type Value = Names;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("names")
            }

            fn visit_unit<E>(self) -> Result<Names, E> {
                Ok(Names::default())
            }

            fn visit_bool<E>(self, _: bool) -> Result<Names, E> {
                Ok(Names::default())
            }

            fn visit_i64<E>(self, _: i64) -> Result<Names, E> {
                Ok(Names::default())
            }

            fn visit_u64<E>(self, _: u64) -> Result<Names, E> {
                Ok(Names::default())
            }

            fn visit_f64<E>(self, _: f64) -> Result<Names, E> {
                Ok(Names::default())
            }

            fn visit_str<E>(self, name: &str) -> Result<Names, E> {
                Ok(Names(vec![name.to_owned()]))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Names, A::Error> {
                let mut all = Vec::new();
                while let Some(Names(names)) = list.next_element()? {
                    all.extend(names);
                }
                Ok(Names(all))
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Names, A::Error> {
                let mut all = Vec::new();
                while let Some((key, Names(names))) = map.next_entry::<String, Names>()? {
                    // `{"x": 0, "y": 1}` names them itself.
                    all.extend(if names.is_empty() { vec![key] } else { names });
                }
                Ok(Names(all))
            }
        }

        deserializer.deserialize_any(Any)
    }
}

/// Where files lie: a path within the dataset with places for numbers.
#[derive(Clone, Debug)]
pub(super) struct Template {
    key: &'static str,
    parts: Vec<Part>,
}

#[derive(Clone, Debug)]
enum Part {
    Text(String),
    /// With so many digits at the least.
    Chunk(usize),
    File(usize),
    VideoKey,
}

impl Template {
    fn parse(key: &'static str, text: &str, has_key: bool) -> Result<Self, LeRobotFault> {
        let wanted = "a path within the dataset with {chunk_index:03d} and {file_index:03d} in it, and for videos {video_key}";
        let wrong = || LeRobotFault::key(key, format!("{text:?}"), wanted);
        if text.len() > 1024 {
            return Err(wrong());
        }
        let (mut parts, mut rest) = (Vec::new(), text);
        while let Some((before, after)) = rest.split_once('{') {
            let (place, after) = after.split_once('}').ok_or_else(wrong)?;
            parts.push(Part::Text(before.to_owned()));
            let (name, digits) = place.split_once(':').unwrap_or((place, "d"));
            let digits = digits.strip_suffix('d').ok_or_else(wrong)?;
            let n = if digits.is_empty() { 0 } else { digits.parse().map_err(|_| wrong())? };
            parts.push(match name {
                "chunk_index" if n <= 20 => Part::Chunk(n),
                "file_index" if n <= 20 => Part::File(n),
                "video_key" if has_key => Part::VideoKey,
                _ => return Err(wrong()),
            });
            rest = after;
        }
        parts.push(Part::Text(rest.to_owned()));
        let is_there = |is_it: fn(&Part) -> bool| parts.iter().any(is_it);
        let has_file = is_there(|part| matches!(part, Part::File(_)));
        if rest.contains('}') || !has_file || has_key != is_there(|part| matches!(part, Part::VideoKey)) {
            return Err(wrong());
        }
        let template = Self { key, parts };
        template.path(0, 0, "key")?;
        Ok(template)
    }

    /// The path of a file, from the dataset's folder.
    pub(super) fn path(&self, chunk: u32, file: u32, video_key: &str) -> Result<PathBuf, LeRobotFault> {
        let mut text = String::new();
        for part in &self.parts {
            match part {
                Part::Text(part) => text.push_str(part),
                Part::Chunk(n) => text += format!("{chunk:0n$}", n = *n).as_str(),
                Part::File(n) => text += format!("{file:0n$}", n = *n).as_str(),
                Part::VideoKey => text.push_str(video_key),
            }
        }
        within(&text).ok_or_else(|| LeRobotFault::Escape { key: self.key.to_owned(), found: text })
    }
}

/// `text` as a path that stays below the folder that it starts from.
pub(super) fn within(text: &str) -> Option<PathBuf> {
    let path = Path::new(text);
    let is_name = |part: Component<'_>| matches!(part, Component::Normal(_));
    let is_inside = !text.is_empty() && !text.contains(['\0', '\\']) && path.components().all(is_name);
    is_inside.then(|| path.to_path_buf())
}
