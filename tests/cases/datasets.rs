//! Folders of recordings: other people's, damaged, put together wrongly, and our own.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use dropj::dataset::{Dataset, EpisodeInfo, Layout, StepRecord};
use dropj::tensor::Parameters;
use dropj::world::{Action, End, Frame};
use dropj::world_model::{WorldModelConfig, untrained};
use parquet::data_type::Int64Type;
use parquet::file::reader::{FileReader as _, SerializedFileReader};
use parquet::file::writer::SerializedFileWriter;
use parquet::record::RowAccessor as _;
use parquet::schema::parser::parse_message_type;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use crate::program::{Ran, dropj};

/// Pixels a side, as the tiny world model wants.
const SIDE: u32 = 20;

/// A dataset of episodes of so many steps.
fn dataset(dir: &Path, env: &str, lens: &[usize]) {
    let mut dataset = Dataset::create_or_open(dir, env).unwrap();
    let frame = |t: usize| Frame::square(SIDE, vec![t as u8; 3 * (SIDE * SIDE) as usize]);
    let layout = Layout { sensors: ["speed", "yaw_rate"].map(str::to_owned).to_vec(), ..Layout::default() };
    for (seed, &len) in (0..).zip(lens) {
        let info = EpisodeInfo { env: env.to_owned(), pilot: "nobody".to_owned(), seed };
        let mut recording = dataset.begin_with(info, &layout).unwrap();
        for t in 0..len {
            let step = StepRecord {
                frame: frame(t),
                action: Action::new([0.1, 0.2, 0.0]),
                reward: 1.0,
                events: vec![false],
                wall_time_ns: 20_000_000 * t as i64,
                state: vec![t as f32, -1.0],
            };
            recording.push(&step).unwrap();
        }
        dataset.seal(recording, &frame(len), Some(End::Truncated)).unwrap();
    }
}

/// The recordings opened for writing by the program, without an episode more.
fn open(dir: &Path) -> Ran {
    dropj(dir, ["record", "--env", "car-racing", "--out", "ds", "--episodes", "0"])
}

fn episode_file(ds: &Path, number: usize) -> PathBuf {
    ds.join(format!("data/chunk-000/file-{number:03}.parquet"))
}

/// A Parquet file of another program's, of two rows.
fn foreign() -> Vec<u8> {
    let schema = parse_message_type("message schema { optional int64 index; }").unwrap();
    let mut file = Vec::new();
    let mut writer = SerializedFileWriter::new(&mut file, Arc::new(schema), Arc::default()).unwrap();
    let mut group = writer.next_row_group().unwrap();
    let mut column = group.next_column().unwrap().unwrap();
    column.typed::<Int64Type>().write_batch(&[0, 1], Some(&[1, 1]), None).unwrap();
    column.close().unwrap();
    group.close().unwrap();
    writer.close().unwrap();
    file
}

/// Every file below a folder with its content.
fn tree(dir: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let (mut tree, mut folders) = (BTreeMap::new(), vec![dir.to_owned()]);
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                tree.insert(path.clone(), Vec::new());
                folders.push(path);
            } else {
                tree.insert(path.clone(), fs::read(path).unwrap());
            }
        }
    }
    tree
}

fn put(dir: &Path, name: &str, bytes: impl AsRef<[u8]>) {
    let path = dir.join(name);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, bytes).unwrap();
}

/// A dataset that `LeRobot` made of somebody's robot.
fn of_lerobot(ds: &Path) {
    put(ds, "meta/info.json", r#"{"codebase_version": "v3.0", "robot_type": "so101", "total_episodes": 2}"#);
    put(ds, "meta/stats.json", "{}");
    put(ds, "meta/episodes/chunk-000/file-000.parquet", foreign());
    put(ds, "data/chunk-000/file-000.parquet", foreign());
}

/// A tiny world model, untrained.
fn world(path: &Path) {
    let model = untrained(&WorldModelConfig::tiny(), &mut ChaCha8Rng::seed_from_u64(0));
    let parameters: &Parameters = model.parameters();
    fs::write(path, parameters.bytes()).unwrap();
}

/// Asserts that the index says of the dataset what its files say, as `LeRobot` wants it.
#[track_caller]
fn assert_index_agrees(ds: &Path, lens: &[usize]) {
    let table =
        SerializedFileReader::new(File::open(ds.join("meta/episodes/chunk-000/file-000.parquet")).unwrap());
    let table = table.unwrap();
    let fields = table.metadata().file_metadata().schema_descr().root_schema().get_fields().to_vec();
    let column = |name: &str| fields.iter().position(|field| field.name() == name).unwrap();
    let mut from = 0;
    let rows: Vec<_> = table.get_row_iter(None).unwrap().map(Result::unwrap).collect();
    assert_eq!(rows.len(), lens.len(), "a row for each episode");
    for (number, (row, &len)) in rows.iter().zip(lens).enumerate() {
        let told = |name| row.get_long(column(name)).unwrap() as usize;
        assert_eq!((told("episode_index"), told("length")), (number, len), "numbers without a gap");
        let steps = (told("dataset_from_index"), told("dataset_to_index"));
        assert_eq!(steps, (from, from + len), "steps without a gap");
        assert_eq!((told("data/chunk_index"), told("data/file_index")), (0, number), "where it lies");
        let file = SerializedFileReader::new(File::open(episode_file(ds, number)).unwrap()).unwrap();
        let of_file = file.metadata().file_metadata().schema_descr().root_schema().get_fields().to_vec();
        let at = |name: &str| of_file.iter().position(|field| field.name() == name).unwrap();
        for (t, row) in file.get_row_iter(None).unwrap().map(Result::unwrap).enumerate() {
            let told = |name| row.get_long(at(name)).unwrap() as usize;
            assert_eq!((told("episode_index"), told("index")), (number, from + t), "in the file itself");
        }
        from += len;
    }
    let info: serde_json::Value =
        serde_json::from_slice(&fs::read(ds.join("meta/info.json")).unwrap()).unwrap();
    let totals = (&info["total_episodes"], &info["total_frames"]);
    assert_eq!(totals, (&lens.len().into(), &from.into()), "in all");
    assert_eq!(fs::read_dir(ds.join("data/chunk-000")).unwrap().count(), lens.len(), "and no other file");
}

#[test]
fn a_dataset_of_others_is_never_written_to() {
    let dir = tempfile::tempdir().unwrap();
    let ds = dir.path().join("ds");
    of_lerobot(&ds);
    let before = tree(&ds);
    let ran = open(dir.path());
    assert!(ran.refused().contains("so101") && ran.refused().contains("choose another folder"), "{ran:?}");
    assert!(tree(&ds) == before, "nothing is touched");
}

#[test]
fn nor_is_any_other_folder_of_somebodys() {
    let somebodys: [&[&str]; 4] =
        [&["thesis.tex"], &["data/measured.csv"], &["meta/info.json"], &["journal/monday.txt", "meta/x"]];
    for files in somebodys {
        let dir = tempfile::tempdir().unwrap();
        let ds = dir.path().join("ds");
        for name in files {
            put(&ds, name, "{\"mine\": 1}");
        }
        let before = tree(&ds);
        let ran = open(dir.path());
        assert!(ran.refused().contains("holds no recordings of dropj's"), "{ran:?}");
        assert!(tree(&ds) == before, "nothing is touched");
    }
}

#[test]
fn recordings_of_others_are_named_for_what_they_are() {
    let dir = tempfile::tempdir().unwrap();
    of_lerobot(&dir.path().join("ds"));
    world(&dir.path().join("w.safetensors"));
    let ran = dropj(dir.path(), ["fit-world", "--data", "ds", "--out", "new.safetensors"]);
    assert!(ran.refused().contains("LeRobot dataset") && ran.refused().contains("so101"), "{ran:?}");
    assert!(ran.refused().contains("`dropj world new --data`"), "what to do: {ran:?}");
    assert!(!dir.path().join("new.fit").exists(), "and nothing is begun");
    // As recordings of the model's world they are read, as far as that goes.
    let ran = dropj(dir.path(), ["check-world", "--data", "ds", "--world", "w.safetensors"]);
    assert!(ran.refused().contains("fps is missing"), "{ran:?}");
}

#[test]
fn nothing_to_compare_is_an_error() {
    let dir = tempfile::tempdir().unwrap();
    world(&dir.path().join("w.safetensors"));
    let check = |more: &[&str]| {
        let args = ["check-world", "--data", "ds", "--world", "w.safetensors"];
        dropj(dir.path(), args.iter().chain(more))
    };
    dataset(&dir.path().join("ds"), "dummy-road", &[30, 40]);
    assert!(check(&[]).refused().contains("nothing to compare"), "all are too short");
    fs::remove_dir_all(dir.path().join("ds")).unwrap();
    dataset(&dir.path().join("ds"), "dummy-road", &[130, 140]);
    assert!(check(&["--stretches", "0"]).refused().contains("--stretches"), "of none nothing can be said");
    assert!(check(&["--json"]).succeeded().contains("\"n_stretches\":100"));
    fs::remove_file(episode_file(&dir.path().join("ds"), 1)).unwrap();
    assert!(check(&[]).refused().contains("nothing to compare"), "one episode, which was trained on");
    fs::remove_dir_all(dir.path().join("ds")).unwrap();
    dataset(&dir.path().join("ds"), "car-racing", &[130, 140]);
    assert!(check(&[]).refused().contains("these recordings are of \"car-racing\""));
}

#[test]
fn the_index_follows_from_the_files() {
    let dir = tempfile::tempdir().unwrap();
    let ds = dir.path().join("ds");
    dataset(&ds, "car-racing", &[3, 4, 5, 6]);
    assert_index_agrees(&ds, &[3, 4, 5, 6]);
    // The middle one is moved out, as the program once advised.
    fs::rename(episode_file(&ds, 1), dir.path().join("out.parquet")).unwrap();
    open(dir.path()).succeeded();
    assert_index_agrees(&ds, &[3, 5, 6]);
    // It comes back in the middle; what was there goes to the end, under a name of somebody's own.
    fs::rename(episode_file(&ds, 1), ds.join("data/chunk-000/later.parquet")).unwrap();
    fs::rename(dir.path().join("out.parquet"), episode_file(&ds, 1)).unwrap();
    open(dir.path()).succeeded();
    assert_index_agrees(&ds, &[3, 4, 6, 5]);
    fs::remove_dir_all(ds.join("meta")).unwrap();
    open(dir.path()).succeeded();
    assert_index_agrees(&ds, &[3, 4, 6, 5]);
}

#[test]
fn a_damaged_file_is_moved_aside_and_named() {
    let dir = tempfile::tempdir().unwrap();
    let ds = dir.path().join("ds");
    let whole = {
        dataset(&ds, "car-racing", &[3, 4, 5]);
        fs::read(episode_file(&ds, 1)).unwrap()
    };
    let mut flipped = whole.clone();
    let at = whole.len() - 400;
    flipped[at] ^= 1;
    for (nth, torn) in [whole[..whole.len() / 2].to_vec(), Vec::new(), flipped].into_iter().enumerate() {
        let (last, lens) = if nth == 0 { (1, vec![3, 5]) } else { (2, vec![3, 5]) };
        fs::write(episode_file(&ds, last), &torn).unwrap();
        let ran = open(dir.path());
        ran.succeeded();
        assert!(ran.err.contains("moved aside"), "{ran:?}");
        assert!(ran.err.contains(&format!("file-00{last}.parquet")), "it is named: {ran:?}");
        assert_index_agrees(&ds, &lens);
        let aside = tree(&ds.join("damaged"));
        assert_eq!(aside.len(), nth + 1, "none overwrites another");
        assert!(aside.values().any(|bytes| *bytes == torn), "nothing is lost");
        assert!(aside.keys().all(|path| path.extension().unwrap() != "parquet"), "out of everybody's way");
    }
}

/// An episode of the world "dummy" that the version before format 2 wrote: its footer has no checksum.
const OLD_EPISODE: &[u8] = include_bytes!("../golden/episode-format-1.parquet");

#[test]
fn a_footer_without_the_statistics_of_a_column_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let name = b"\"next.grass\":{";
    let at = OLD_EPISODE.windows(name.len()).position(|bytes| bytes == name).unwrap();
    let mut bytes = OLD_EPISODE.to_vec();
    bytes[at..at + name.len()].copy_from_slice(b"\"next.glass\":{");
    put(&dir.path().join("ds"), "data/chunk-000/file-000.parquet", OLD_EPISODE);
    put(&dir.path().join("ds"), "data/chunk-000/file-001.parquet", bytes);
    let ran = open(dir.path());
    assert!(ran.refused().contains("file-001.parquet") && ran.refused().contains("next.grass"), "{ran:?}");
    world(&dir.path().join("w.safetensors"));
    let ran = dropj(dir.path(), ["fit-world", "--data", "ds", "--out", "new.safetensors"]);
    ran.refused();
    assert!(ran.err.contains("file-001.parquet"), "{ran:?}");
}

#[test]
fn two_worlds_in_one_folder_are_named_with_their_files() {
    let dir = tempfile::tempdir().unwrap();
    let ds = dir.path().join("ds");
    dataset(&ds, "car-racing", &[3]);
    dataset(&dir.path().join("other"), "obstacle-car-racing", &[4]);
    fs::copy(episode_file(&dir.path().join("other"), 0), episode_file(&ds, 1)).unwrap();
    fs::remove_dir_all(ds.join("journal")).unwrap();
    let before = tree(&ds);
    let fit = ["fit-world", "--data", "ds", "--out", "new.safetensors"];
    for ran in [open(dir.path()), dropj(dir.path(), fit)] {
        let line = ran.refused();
        let named = ["\"car-racing\"", "\"obstacle-car-racing\"", "file-000.parquet", "file-001.parquet"];
        assert!(named.iter().all(|name| line.contains(name)), "{line}");
    }
    assert!(tree(&ds) == before, "nothing is touched");
}

#[test]
fn what_is_recorded_is_what_other_programs_expect() {
    let dir = tempfile::tempdir().unwrap();
    let ds = dir.path().join("ds");
    dropj(dir.path(), ["record", "--out", "ds", "--episodes", "1"]).succeeded();
    let info: serde_json::Value =
        serde_json::from_slice(&fs::read(ds.join("meta/info.json")).unwrap()).unwrap();
    let state = &info["features"]["observation.state"];
    assert_eq!((&state["dtype"], &state["shape"][0]), (&"float32".into(), &7.into()));
    assert_eq!(state["names"][0], "speed");
    let features = info["features"].as_object().unwrap();
    for name in ["next.done", "next.terminated", "next.truncated", "next.reward", "action"] {
        assert!(features.contains_key(name), "{name}");
    }
    for event in ["next.grass", "next.new_tile"] {
        assert_eq!(features[event]["dtype"], "bool", "{event}");
    }
    assert_eq!(info["fps"], 50);
    assert_eq!(features["action"]["names"], serde_json::json!(["steer", "gas", "brake"]));
    assert_eq!(features["observation.image"]["shape"], serde_json::json!([84, 84, 3]));
    let file = SerializedFileReader::new(File::open(episode_file(&ds, 0)).unwrap()).unwrap();
    let columns = file.metadata().file_metadata().schema_descr().root_schema().get_fields();
    assert!(columns.iter().all(|column| features.contains_key(column.name())), "as many as it tells of");
    assert_eq!(columns.len(), features.len());
    let stats: serde_json::Value =
        serde_json::from_slice(&fs::read(ds.join("meta/stats.json")).unwrap()).unwrap();
    assert!(stats["observation.state"]["max"][0].as_f64().unwrap() > 1.0, "it moved");
    // A thousand steps, and nothing that happened ended it.
    assert_eq!(stats["next.truncated"]["max"][0], 1.0);
    assert_eq!(stats["next.terminated"]["max"][0], 0.0);
}
