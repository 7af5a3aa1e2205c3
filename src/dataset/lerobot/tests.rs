//! Datasets in every shape that was met, and in some that nobody should meet.

use std::fs;
use std::io::Cursor;

use ::image::{DynamicImage, ImageFormat, RgbImage};
use parquet::data_type::ByteArray;
use serde_json::json;
use tempfile::TempDir;

use super::super::table::{Column, to_parquet};
use super::*;

/// How long the episodes of the datasets made here are.
const LENS: [usize; 2] = [3, 2];
const HEIGHT: u32 = 4;
const WIDTH: u32 = 6;

/// The rows of all episodes: episode and step.
fn rows() -> Vec<(usize, usize)> {
    LENS.iter().enumerate().flat_map(|(episode, &len)| (0..len).map(move |step| (episode, step))).collect()
}

/// The color of a row's picture.
fn color((episode, step): (usize, usize)) -> u8 {
    (100 * episode + 30 * step) as u8
}

fn picture(row: (usize, usize), format: ImageFormat) -> Vec<u8> {
    let image = RgbImage::from_pixel(WIDTH, HEIGHT, ::image::Rgb([color(row); 3]));
    let mut bytes = Cursor::new(Vec::new());
    DynamicImage::from(image).write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

/// The numbers of a row's action.
fn action((episode, step): (usize, usize), width: usize) -> Vec<f32> {
    (0..width).map(|axis| episode as f32 + 0.25 * step as f32 - 0.5 * axis as f32).collect()
}

/// A dataset that can be changed before it is written.
struct Made {
    info: Value,
    /// The rows in the order of the file.
    rows: Vec<(usize, usize)>,
    cells: Vec<(String, Column)>,
}

impl Made {
    /// With two axes, a picture, a reward and an end.
    fn new() -> Self {
        Self::of(rows())
    }

    fn of(rows: Vec<(usize, usize)>) -> Self {
        let scalar = |dtype: &str| json!({"dtype": dtype, "shape": [1], "names": null});
        let info = json!({
            "codebase_version": "v3.0", "fps": 12.5, "total_episodes": 2, "total_frames": 5,
            "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet", "video_path": null,
            "features": {
                "front": {"dtype": "image", "shape": [HEIGHT, WIDTH, 3], "names": ["height", "width", "channels"]},
                "action": {"dtype": "float32", "shape": [2], "names": {"motors": ["left", "right"]}},
                "next.reward": scalar("float32"), "next.done": scalar("bool"), "count": scalar("int64"),
                "timestamp": scalar("float32"), "frame_index": scalar("int64"), "episode_index": scalar("int64"),
                "index": scalar("int64"), "task_index": scalar("int64"),
            },
        });
        let ints =
            |of: fn((usize, usize)) -> usize| Column::Ints(rows.iter().map(|&row| of(row) as i64).collect());
        let images = rows.iter().map(|&row| ByteArray::from(picture(row, ImageFormat::Png)));
        let cells = vec![
            ("front".to_owned(), Column::Images(images.collect())),
            (
                "action".to_owned(),
                Column::FloatLists(2, rows.iter().flat_map(|&row| action(row, 2)).collect()),
            ),
            (
                "next.reward".to_owned(),
                Column::DoubleLists(0, rows.iter().map(|row| vec![row.1 as f64]).collect()),
            ),
            (
                "next.done".to_owned(),
                Column::Bools(rows.iter().map(|row| row.1 + 1 == LENS[row.0]).collect()),
            ),
            ("count".to_owned(), ints(|row| 1000 * row.0 + row.1)),
            ("timestamp".to_owned(), Column::Floats(rows.iter().map(|row| row.1 as f32 / 12.5).collect())),
            ("frame_index".to_owned(), ints(|row| row.1)),
            ("episode_index".to_owned(), ints(|row| row.0)),
            ("index".to_owned(), ints(|row| 3 * row.0 + row.1)),
            ("task_index".to_owned(), ints(|row| row.1 % 2)),
        ];
        Self { info, rows, cells }
    }

    fn set(&mut self, name: &str, column: Column) {
        self.cells.retain(|(other, _)| other != name);
        self.cells.push((name.to_owned(), column));
    }

    /// Writes it into a new folder.
    fn write(self) -> TempDir {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        fs::create_dir_all(dir.join("meta")).unwrap();
        fs::write(dir.join("meta/info.json"), self.info.to_string()).unwrap();
        table(&dir.join("data/chunk-000/file-000.parquet"), self.cells);
        let ints = |numbers: [usize; 2]| Column::Ints(numbers.map(|number| number as i64).to_vec());
        let episodes = vec![
            ("episode_index".to_owned(), ints([0, 1])),
            ("length".to_owned(), ints(LENS)),
            ("data/chunk_index".to_owned(), ints([0, 0])),
            ("data/file_index".to_owned(), ints([0, 0])),
        ];
        table(&dir.join("meta/episodes/chunk-000/file-000.parquet"), episodes);
        let tasks = vec![
            ("task_index".to_owned(), ints([0, 1])),
            ("__index_level_0__".to_owned(), Column::Texts(vec!["go".to_owned(), "stop".to_owned()])),
        ];
        table(&dir.join("meta/tasks.parquet"), tasks);
        folder
    }
}

fn table(path: &Path, cells: Vec<(String, Column)>) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, to_parquet(cells, vec![]).unwrap()).unwrap();
}

/// Both episodes, which are as they were made.
fn check(folder: &TempDir, width: usize) -> Vec<RawEpisode> {
    let dataset = LeRobotDataset::open(folder.path()).unwrap();
    assert_eq!((dataset.fps(), dataset.n_episodes()), (12.5, 2));
    let episodes: Vec<_> = (0..2).map(|idx| dataset.episode(idx, &View::default()).unwrap()).collect();
    for (idx, episode) in episodes.iter().enumerate() {
        assert_eq!(episode.frames.len(), LENS[idx]);
        for step in 0..LENS[idx] {
            let row = (idx, step);
            let frame = &episode.frames[step];
            assert_eq!((frame.height(), frame.width()), (HEIGHT, WIDTH));
            assert!(frame.rgb().iter().all(|byte| byte.abs_diff(color(row)) < 3), "the picture of {row:?}");
            assert_eq!(episode.actions[step], action(row, width));
            assert_eq!(episode.scalars["next.reward"][step], step as f32);
            assert_eq!(episode.scalars["next.done"][step], f32::from(u8::from(step + 1 == LENS[idx])));
            assert_eq!(episode.scalars["count"][step], (1000 * idx + step) as f32);
            assert_eq!(episode.tasks[step], ["go", "stop"][step % 2]);
        }
    }
    episodes
}

/// Why the dataset in a folder is not read: the words, all of them.
fn refused(folder: &TempDir) -> String {
    let read = LeRobotDataset::open(folder.path()).and_then(|dataset| {
        (0..dataset.n_episodes()).try_for_each(|idx| dataset.episode(idx, &View::default()).map(drop))
    });
    read.expect_err("it is refused").to_string()
}

#[test]
fn what_is_made_is_read() {
    let episodes = check(&Made::new().write(), 2);
    assert_eq!(episodes[1].scalars["action.left"], [1.0, 1.25]);
    assert_eq!(episodes[1].scalars["action.1"], episodes[1].scalars["action.right"]);
    let folder = Made::new().write();
    let dataset = LeRobotDataset::open(folder.path()).unwrap();
    assert_eq!(
        dataset.ranges("action").unwrap(),
        [[0.0, 1.25], [-0.5, 0.75]],
        "of all rows, without statistics"
    );
}

#[test]
fn events_are_read_from_columns() {
    let event = |field: &str, when| EventSpec {
        name: field.to_owned(),
        kind: crate::world::EventKind::Progress,
        count: crate::world::Count::PerStep,
        field: field.to_owned(),
        when,
        passed: None,
    };
    let episodes = check(&Made::new().write(), 2);
    let events = [
        event("next.done", crate::world::When::True),
        event("action.right", crate::world::When::Above(-0.1)),
        event("nothing", crate::world::When::True),
    ];
    let happened: Vec<Vec<bool>> = episodes[0]
        .happened(&events)
        .iter()
        .map(|row| row.iter().map(|event| event.happened).collect())
        .collect();
    assert_eq!(happened, [[false, false, false], [false, false, false], [true, true, false]]);
}

#[test]
fn rows_go_by_their_indices_wherever_they_lie() {
    let shuffled = [4, 1, 3, 0, 2].map(|row| rows()[row]).to_vec();
    check(&Made::of(shuffled).write(), 2);
}

#[test]
fn types_and_lists_are_as_they_are_found() {
    let mut made = Made::new();
    let doubles = made.rows.iter().map(|&row| action(row, 2).into_iter().map(f64::from).collect()).collect();
    made.set("action", Column::DoubleLists(1, doubles));
    made.set("next.reward", Column::Ints(made.rows.iter().map(|row| row.1 as i64).collect()));
    check(&made.write(), 2);

    let mut made = Made::new();
    made.info["features"]["action"] = json!({"dtype": "float32", "shape": [1], "names": null});
    made.set("action", Column::Floats(made.rows.iter().map(|&row| action(row, 1)[0]).collect()));
    let folder = made.write();
    check(&folder, 1);
    let dataset = LeRobotDataset::open(folder.path()).unwrap();
    assert_eq!(dataset.action(None).unwrap().components, ["axis 1"]);

    let mut made = Made::new();
    made.info["features"]["action"]["names"] = json!({"left": {"x": 0}, "right": ["y"]});
    let folder = made.write();
    check(&folder, 2);
    let dataset = LeRobotDataset::open(folder.path()).unwrap();
    assert_eq!(dataset.action(None).unwrap().components, ["x", "y"]);

    let mut made = Made::new();
    made.info["features"]["front"]["shape"] = json!([3, HEIGHT, WIDTH]);
    made.info["features"]["front"]["names"] = json!(["channels", "height", "width"]);
    made.info["codebase_version"] = json!("v3.1");
    check(&made.write(), 2);
}

#[test]
fn pictures_are_jpegs_or_files_as_well() {
    let mut made = Made::new();
    let images = made.rows.iter().map(|&row| ByteArray::from(picture(row, ImageFormat::Jpeg)));
    made.set("front", Column::Images(images.collect()));
    check(&made.write(), 2);

    let mut made = Made::new();
    made.cells.retain(|(name, _)| name != "front");
    let folder = made.write();
    for row in rows() {
        let path = folder.path().join(format!("images/front/episode-{:06}/frame-{:06}.png", row.0, row.1));
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, picture(row, ImageFormat::Png)).unwrap();
    }
    check(&folder, 2);
    fs::remove_file(folder.path().join("images/front/episode-000001/frame-000001.png")).unwrap();
    let why = refused(&folder);
    assert!(why.starts_with("episode 1, row 1: the picture of \"front\" cannot be read"), "{why}");
}

#[test]
fn the_action_can_be_named_and_must_be_where_it_is_not_plain() {
    let mut made = Made::new();
    let feature = made.info["features"]["action"].clone();
    made.info["features"].as_object_mut().unwrap().remove("action");
    for name in ["action.joints", "action.delta"] {
        made.info["features"][name] = feature.clone();
        made.set(name, Column::FloatLists(2, made.rows.iter().flat_map(|&row| action(row, 2)).collect()));
    }
    let folder = made.write();
    let why = refused(&folder);
    assert!(why.contains("several columns") && why.contains("\"action.joints\""), "{why}");
    let dataset = LeRobotDataset::open(folder.path()).unwrap();
    let view = View { action: Some("action.delta".to_owned()), ..View::default() };
    assert_eq!(dataset.episode(1, &view).unwrap().actions[0], action((1, 0), 2));
    let view = View { action: Some("speed".to_owned()), ..View::default() };
    assert!(
        dataset
            .episode(1, &view)
            .unwrap_err()
            .to_string()
            .contains("there is no column of numbers \"speed\"")
    );
}

#[test]
fn an_action_that_is_no_number_is_told_with_its_row() {
    let mut made = Made::new();
    let mut numbers: Vec<f32> = made.rows.iter().flat_map(|&row| action(row, 2)).collect();
    numbers[9] = f32::NAN;
    made.set("action", Column::FloatLists(2, numbers));
    let why = refused(&made.write());
    assert!(why.starts_with("episode 1, row 1: \"right\" of the action is NaN"), "{why}");
}

#[test]
fn other_versions_are_told_what_converts_them() {
    for (version, wanted) in [
        ("v2.1", "is a LeRobotDataset v2.1, and those of v3.0 are read"),
        ("v2.1", "python -m lerobot.datasets.v30.convert_dataset_v21_to_v30 --repo-id=\""),
        ("v2.0", "first bring it to v2.1"),
        ("v1.6", "is a LeRobotDataset v1.6"),
        ("v4.0", "says that its codebase_version is \"v4.0\""),
    ] {
        let mut made = Made::new();
        made.info["codebase_version"] = json!(version);
        let why = refused(&made.write());
        assert!(why.contains(wanted), "{why}");
    }
}

#[test]
fn recordings_that_were_not_finalized_or_were_killed_are_told_apart() {
    let folder = Made::new().write();
    fs::remove_dir_all(folder.path().join("meta/episodes")).unwrap();
    let why = refused(&folder);
    assert!(why.contains("was never finalized: info.json counts 2 episodes and 5 rows"), "{why}");

    let data = folder.path().join("data/chunk-000/file-000.parquet");
    let bytes = fs::read(&data).unwrap();
    fs::write(&data, &bytes[..bytes.len() / 2]).unwrap();
    let why = refused(&folder);
    assert!(why.contains("without a footer") && why.contains("file-000.parquet"), "{why}");

    let folder = Made::new().write();
    fs::write(folder.path().join("data/chunk-000/file-000.parquet"), b"PAR1").unwrap();
    assert!(refused(&folder).contains("killed before it called finalize()"));

    let empty = tempfile::tempdir().unwrap();
    assert!(refused(&empty).contains("has no meta/info.json"));
}

#[test]
fn missing_files_and_paths_that_lead_elsewhere_are_refused() {
    for (file, why) in
        [("meta/tasks.parquet", "what was to be done"), ("data/chunk-000/file-000.parquet", "the rows")]
    {
        let folder = Made::new().write();
        fs::remove_file(folder.path().join(file)).unwrap();
        let told = refused(&folder);
        assert!(told.contains("is missing") && told.contains(why) && told.contains(file), "{told}");
    }
    for path in [
        "../data/file-{file_index:03d}.parquet",
        "/data/file-{file_index:03d}.parquet",
        "data/../../file-{file_index:03d}.parquet",
    ] {
        let mut made = Made::new();
        made.info["data_path"] = json!(path);
        let why = refused(&made.write());
        assert!(why.contains("which is not a path within the dataset"), "{why}");
    }
    for path in [
        "data/file-000.parquet",
        "data/{file_index",
        "data/{file_index:03x}",
        "data/{file_index:0999999d}",
        "data/{episode_index:06d}.parquet",
        "data/{video_key}/{file_index}",
        "",
    ] {
        let mut made = Made::new();
        made.info["data_path"] = json!(path);
        let why = refused(&made.write());
        assert!(why.contains("data_path is") && why.contains("must be a path within"), "{why}");
    }
}

#[test]
fn what_info_says_is_held_against_limits() {
    let refuse = |change: &dyn Fn(&mut Value), wanted: &str| {
        let mut made = Made::new();
        change(&mut made.info);
        let why = refused(&made.write());
        assert!(why.contains(wanted), "{why}");
    };
    refuse(&|info| info["fps"] = json!(0), "fps is 0");
    refuse(&|info| info["fps"] = json!("ten"), "fps is \"ten\"");
    refuse(&|info| info["features"]["front"]["shape"] = json!([100_000, 6, 3]), "of 1 to 4096 pixels a side");
    refuse(
        &|info| info["features"]["front"]["shape"] = json!([HEIGHT, 8, 3]),
        "4 x 6, and info.json says 4 x 8",
    );
    refuse(
        &|info| info["features"]["action"]["shape"] = json!([3]),
        "a row has 2 numbers, and info.json says 3",
    );
    refuse(
        &|info| info["features"]["action"]["shape"] = json!([1_u64 << 40, 1_u64 << 40]),
        "of 1 to 4096 numbers",
    );
    refuse(&|info| info["features"]["front"]["dtype"] = json!("video"), "video_path is missing");
    refuse(&|info| info["features"] = json!([]), "cannot be understood");
    refuse(
        &|info| info["features"]["speed"] = json!({"dtype": "float32", "shape": [1]}),
        "no column \"speed\"",
    );
}

#[test]
fn lists_that_contradict_the_rows_are_refused() {
    let ints = |numbers: &[i64]| Column::Ints(numbers.to_vec());
    let refuse = |length: &[i64], number: &[i64], wanted: &str| {
        let folder = Made::new().write();
        let zeros = vec![0; length.len()];
        let cells = vec![
            ("episode_index".to_owned(), ints(number)),
            ("length".to_owned(), ints(length)),
            ("data/chunk_index".to_owned(), ints(&zeros)),
            ("data/file_index".to_owned(), ints(&zeros)),
        ];
        table(&folder.path().join("meta/episodes/chunk-000/file-000.parquet"), cells);
        let why = refused(&folder);
        assert!(why.contains(wanted), "{why}");
    };
    refuse(&[3, 4], &[0, 1], "episode 1: the list of episodes says that it has 4 rows, and this file has 2");
    refuse(&[3, 2], &[0, 7], "has 2 rows, and this file has 0");
    refuse(&[3, 3], &[0, 0], "episode 0 twice");
    refuse(&[3, 0], &[0, 1], "episode 1 has 0 rows");
    refuse(&[3, -1], &[0, 1], "whole numbers from 0 on");
    refuse(&[3, i64::MAX], &[0, 1], "whole numbers from 0 on");
    let mut made = Made::new();
    made.set("frame_index", ints(&[0, 1, 1, 0, 1]));
    assert!(refused(&made.write()).contains("episode 0: row 2 of it says that its frame_index is 1"));
}

#[test]
fn damaged_tables_are_errors_and_never_more() {
    let folder = Made::new().write();
    for file in
        ["data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet", "meta/tasks.parquet"]
    {
        let path = folder.path().join(file);
        let whole = fs::read(&path).unwrap();
        for len in (0..whole.len()).step_by(37) {
            fs::write(&path, &whole[..len]).unwrap();
            assert!(!refused(&folder).is_empty());
        }
        for at in (0..whole.len()).step_by(11) {
            let mut bytes = whole.clone();
            bytes[at] ^= [0x01, 0x20, 0x80, 0xff][at % 4];
            fs::write(&path, &bytes).unwrap();
            let Ok(dataset) = LeRobotDataset::open(folder.path()) else { continue };
            for idx in 0..dataset.n_episodes() {
                let _ = dataset.episode(idx, &View::default());
            }
        }
        fs::write(&path, &whole).unwrap();
    }
    check(&folder, 2);
}

/// The tiny dataset of videos, in a folder of its own.
fn video() -> TempDir {
    fn copy(from: &Path, to: &Path) {
        fs::create_dir_all(to).unwrap();
        for entry in fs::read_dir(from).unwrap() {
            let path = entry.unwrap().path();
            let place = to.join(path.file_name().unwrap());
            if path.is_dir() {
                copy(&path, &place);
            } else {
                fs::copy(&path, &place).unwrap();
            }
        }
    }
    let folder = tempfile::tempdir().unwrap();
    copy(&Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/lerobot/video"), folder.path());
    folder
}

const FIRST_VIDEO: &str = "videos/observation.images.front/chunk-000/file-000.mp4";

/// Puts `with` where the bytes `what` stand in the first video of a folder.
fn patch(folder: &TempDir, what: &[u8], with: &[u8]) {
    let path = folder.path().join(FIRST_VIDEO);
    let mut bytes = fs::read(&path).unwrap();
    let at = bytes.windows(what.len()).position(|bytes| bytes == what).unwrap();
    bytes[at..at + with.len()].copy_from_slice(with);
    fs::write(&path, bytes).unwrap();
}

#[test]
fn cut_and_missing_videos_are_told() {
    let folder = video();
    let path = folder.path().join(FIRST_VIDEO);
    let whole = fs::read(&path).unwrap();
    for len in (0..whole.len()).step_by(whole.len() / 12) {
        fs::write(&path, &whole[..len]).unwrap();
        let why = refused(&folder);
        assert!(why.starts_with("this video cannot be read") && why.contains("file-000.mp4"), "{why}");
    }
    fs::write(&path, b"version https://git-lfs.github.com/spec/v1\n").unwrap();
    assert!(refused(&folder).contains("git lfs pull"));
    fs::remove_file(&path).unwrap();
    assert!(refused(&folder).contains("this file is missing"));
}

#[test]
fn damaged_videos_are_errors_and_never_more() {
    let folder = video();
    let path = folder.path().join(FIRST_VIDEO);
    let whole = fs::read(&path).unwrap();
    let index = whole.windows(4).position(|bytes| bytes == b"moov").unwrap();
    let data = whole.windows(4).position(|bytes| bytes == b"mdat").unwrap();
    // Every few bytes of where everything lies, and some of the pictures.
    let places = (index..data).step_by(13).chain((data..whole.len()).step_by(499));
    for at in places {
        let mut bytes = whole.clone();
        bytes[at] ^= [0x01, 0x20, 0x80, 0xff][at % 4];
        fs::write(&path, &bytes).unwrap();
        let dataset = LeRobotDataset::open(folder.path()).unwrap();
        let _ = dataset.episode(0, &View::default());
    }
}

#[test]
fn a_video_that_claims_thousands_of_millions_of_samples_is_refused_at_once() {
    let folder = video();
    let path = folder.path().join(FIRST_VIDEO);
    let mut bytes = fs::read(&path).unwrap();
    let at = bytes.windows(4).position(|bytes| bytes == b"stsz").unwrap();
    // One size for all, and as many as can be said.
    bytes[at + 8..at + 12].copy_from_slice(&1_u32.to_be_bytes());
    bytes[at + 12..at + 16].copy_from_slice(&u32::MAX.to_be_bytes());
    fs::write(&path, bytes).unwrap();
    assert!(refused(&folder).contains("its box \"stsz\" is damaged"));
}

#[test]
fn other_sizes_and_rates_of_videos_are_told() {
    for (from, to, wanted) in [
        ("\"fps\": 15", "\"fps\": 30", "it has 15.00 pictures a second, and info.json says 30"),
        ("84", "80", "it is 84 x 84, and info.json says 80 x 80"),
    ] {
        let folder = video();
        let path = folder.path().join("meta/info.json");
        let info = fs::read_to_string(&path).unwrap().replace(from, to);
        fs::write(&path, info).unwrap();
        let why = refused(&folder);
        assert!(why.contains(wanted), "{why}");
    }
}

/// Reads the first episode with `script` in place of ffmpeg.
fn with_ffmpeg(folder: &TempDir, script: &str) -> Result<RawEpisode, DatasetError> {
    let path = folder.path().join("decoder");
    fs::write(&path, format!("#!/bin/sh\n{script}\n")).unwrap();
    fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o755)).unwrap();
    let mut dataset = LeRobotDataset::open(folder.path())?;
    dataset.ffmpeg = path.into();
    dataset.episode(0, &View::default())
}

#[test]
fn other_videos_need_ffmpeg() {
    let folder = video();
    patch(&folder, b"av01\0\0\0\0\0\0", b"avc1");
    let mut dataset = LeRobotDataset::open(folder.path()).unwrap();
    dataset.ffmpeg = "/nonexistent/ffmpeg".into();
    let why = dataset.episode(0, &View::default()).unwrap_err().to_string();
    assert!(why.contains("this video is H.264") && why.contains("apt install ffmpeg"), "{why}");

    // As many bytes as nine pictures have, all of them "a".
    let n = 9 * 3 * 84 * 84;
    let episode = with_ffmpeg(&folder, &format!("head -c {n} /dev/zero | tr '\\0' a")).unwrap();
    assert_eq!(episode.frames.len(), 9);
    assert!(episode.frames.iter().all(|frame| frame.rgb().iter().all(|&byte| byte == b'a')));

    let why = with_ffmpeg(&folder, "head -c 30000 /dev/zero; echo cannot go on >&2; exit 1").unwrap_err();
    let why = why.to_string();
    assert!(why.contains("ffmpeg gave 1 pictures of 84 x 84 and no more: cannot go on"), "{why}");
    // What never ends is ended.
    with_ffmpeg(&folder, "cat /dev/zero").unwrap();
}
