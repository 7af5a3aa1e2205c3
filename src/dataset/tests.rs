//! Episodes survive: the disk, a killed program, a damaged file, another program's eyes.

use std::fs;
use std::path::{Path, PathBuf};

use parquet::data_type::{BoolType, FloatType};
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use super::notes::Notes;
use super::table::{Column, Table, sign_footer, sign_pages, to_parquet};
use super::{Dataset, DatasetError, Episode, EpisodeInfo, Layout, Recording, StepRecord};
use super::{disk, limits, read_episode, read_journal};
use crate::world::{Action, End, Frame, Size, WorldSpec};

const SIDE: u32 = 12;
const SIZE: Size = Size { height: SIDE, width: SIDE };

fn frame(level: usize) -> Frame {
    let rgb: Vec<u8> =
        (0..3 * SIDE as usize * SIDE as usize).map(|byte| (byte * level % 253) as u8).collect();
    Frame::square(SIDE, rgb)
}

fn step(index: usize) -> StepRecord {
    StepRecord {
        frame: frame(index),
        action: Action::new([-0.1 * index as f32, 0.3, 0.01 * index as f32]),
        reward: if index.is_multiple_of(3) { 10.0 } else { -1.0 },
        events: vec![index.is_multiple_of(4)],
        wall_time_ns: 1_767_225_600_000_000_000 + 20_000_000 * index as i64,
        state: vec![0.5 * index as f32, -1.0],
    }
}

fn layout() -> Layout {
    Layout { sensors: names(&["speed", "yaw_rate"]), ..Layout::default() }
}

fn names(names: &[&str]) -> Vec<String> {
    names.iter().map(|&name| name.to_owned()).collect()
}

fn info(seed: u64) -> EpisodeInfo {
    EpisodeInfo { env: "dummy".into(), pilot: "nobody".into(), seed }
}

fn record(dataset: &Dataset, seed: u64, n_steps: usize) -> Recording {
    let mut recording = dataset.begin_with(info(seed), &layout()).unwrap();
    for index in 0..n_steps {
        recording.push(&step(index)).unwrap();
    }
    recording
}

fn seal(dataset: &mut Dataset, seed: u64, n_steps: usize) -> usize {
    let recording = record(dataset, seed, n_steps);
    dataset.seal(recording, &frame(n_steps), Some(End::Terminated)).unwrap()
}

fn expected(number: usize, seed: u64, n_steps: usize) -> Episode {
    let steps: Vec<StepRecord> = (0..n_steps).map(step).collect();
    Episode {
        number,
        info: info(seed),
        frames: (0..=n_steps).map(frame).collect(),
        actions: steps.iter().map(|step| step.action).collect(),
        rewards: steps.iter().map(|step| step.reward).collect(),
        layout: layout(),
        events: steps.iter().map(|step| step.events.clone()).collect(),
        wall_times_ns: steps.iter().map(|step| step.wall_time_ns).collect(),
        states: steps.into_iter().map(|step| step.state).collect(),
        done: true,
        truncated: false,
        planned: Vec::new(),
    }
}

fn episode_file(dir: &Path, number: usize) -> PathBuf {
    dir.join(format!("data/chunk-000/file-{number:03}.parquet"))
}

#[test]
fn who_drove_each_step_is_kept_even_where_the_program_was_killed() {
    let dir = tempfile::tempdir().unwrap();
    let planned = |index: usize| (2..5).contains(&index) || index == 7;
    let drive = |dataset: &Dataset| {
        let mut recording = dataset.begin_with(info(1), &layout()).unwrap();
        for index in 0..8 {
            recording.push_by(&step(index), planned(index)).unwrap();
        }
        recording
    };
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    let recording = drive(&dataset);
    dataset.seal(recording, &frame(8), Some(End::Truncated)).unwrap();
    drop(drive(&dataset));
    drop(dataset);
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    dataset.recover(0).unwrap();
    for idx in 0..2 {
        assert_eq!(dataset.episode(idx).unwrap().planned, [2..5, 7..8]);
    }
}

#[test]
fn what_is_recorded_is_what_is_read() {
    let dir = tempfile::tempdir().unwrap();
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    seal(&mut dataset, 7, 1);
    seal(&mut dataset, u64::MAX, 130);
    for dataset in [&dataset, &Dataset::open(dir.path()).unwrap()] {
        assert_eq!((dataset.n_episodes(), dataset.n_steps(), dataset.len(1)), (2, 131, 130));
        assert_eq!((dataset.env(), dataset.size()), (Some("dummy"), Some(SIZE)));
        let episodes: Vec<Episode> = dataset.episodes().map(Result::unwrap).collect();
        assert_eq!(episodes, [expected(0, 7, 1), expected(1, u64::MAX, 130)]);
    }
}

#[test]
fn what_goes_on_comes_back_event_by_event() {
    let dir = tempfile::tempdir().unwrap();
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    let layout = Layout { events: names(&["grass", "new tile", "Falls!"]), ..layout() };
    let events = [[true, true, false], [false, false, false], [false, true, true], [false, true, false]];
    let mut recording = dataset.begin_with(info(1), &layout).unwrap();
    for (t, events) in events.iter().enumerate() {
        recording.push(&StepRecord { events: events.to_vec(), ..step(t) }).unwrap();
    }
    dataset.seal(recording, &frame(4), Some(End::Terminated)).unwrap();
    let dataset = Dataset::open(dir.path()).unwrap();
    let read = dataset.episode(0).unwrap();
    assert_eq!(read.events, events);
    assert_eq!(read.event("new tile").unwrap(), [true, false, true, true]);
    assert_eq!((read.event("tile"), &read.layout), (None, &layout));
    let shares = dataset.summaries().next().unwrap().events;
    assert_eq!(
        shares,
        [("grass", 0.25), ("new tile", 0.75), ("Falls!", 0.25)].map(|(name, share)| (name.to_owned(), share))
    );
    let table = Table::new(fs::read(episode_file(dir.path(), 0)).unwrap()).unwrap();
    assert_eq!(table.read::<BoolType>(&["next.falls_"], 1).unwrap(), [false, false, true, false]);
}

/// The index of a dataset.
fn index(dir: &Path) -> serde_json::Value {
    serde_json::from_slice(&fs::read(dir.join("meta/info.json")).unwrap()).unwrap()
}

#[test]
fn episodes_of_any_world_are_kept() {
    type Shape<'a> = (&'a [&'a str], &'a [&'a str], usize, f64, Size);
    let worlds: [Shape<'_>; 3] = [
        (&["torque"], &[], 0, 20.0, Size { height: 60, width: 80 }),
        (&["joint"; 14], &["drop", "spill"], 1, 12.5, Size { height: 80, width: 60 }),
        (&["throttle", "rudder"], &["stall"], 3, 50.0, Size { height: 1, width: 1024 }),
    ];
    for (axes, events, n_sensors, rate, size) in worlds {
        let dir = tempfile::tempdir().unwrap();
        let sensors = (0..n_sensors).map(|i| format!("sensor {i}")).collect();
        let layout = Layout { axes: names(axes), events: names(events), sensors, rate };
        let frame = |t: usize| {
            let n_bytes = 3 * (size.height * size.width) as usize;
            let rgb: Vec<u8> = (0..n_bytes).map(|byte| (byte * t % 253) as u8).collect();
            Frame::new(size.height, size.width, rgb)
        };
        let step = |t: usize| StepRecord {
            frame: frame(t),
            action: Action::new(
                axes.iter().enumerate().map(|(i, _)| i as f32 - t as f32).collect::<Vec<_>>(),
            ),
            events: (0..events.len()).map(|event| event == t % 2).collect(),
            state: (0..n_sensors).map(|i| 0.5 * (i + t) as f32).collect(),
            ..step(t)
        };
        let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
        assert_eq!((dataset.layout(), dataset.size()), (None, None));
        for n_steps in [1, 5] {
            let mut recording = dataset.begin_with(info(3), &layout).unwrap();
            (0..n_steps).for_each(|t| recording.push(&step(t)).unwrap());
            // Killed, and found again.
            let journal = recording.path().to_owned();
            let (bytes, is_killed) = (fs::read(&journal).unwrap(), n_steps == 5);
            assert_eq!(read_journal(&bytes), Some((info(3), n_steps)));
            if is_killed {
                drop((recording, dataset));
                dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
                dataset.recover(0).unwrap();
            } else {
                dataset.seal(recording, &frame(n_steps), None).unwrap();
            }
            let episode = dataset.episode(dataset.n_episodes() - 1).unwrap();
            let steps: Vec<_> = (0..n_steps).map(step).collect();
            assert_eq!(episode.layout, layout);
            assert_eq!(episode.frames, (0..n_steps + usize::from(!is_killed)).map(frame).collect::<Vec<_>>());
            assert_eq!(episode.actions, steps.iter().map(|step| step.action).collect::<Vec<_>>());
            assert_eq!(episode.events, steps.iter().map(|step| step.events.clone()).collect::<Vec<_>>());
            assert_eq!(episode.states, steps.iter().map(|step| step.state.clone()).collect::<Vec<_>>());
        }
        drop(dataset);
        let dataset = Dataset::open(dir.path()).unwrap();
        assert_eq!((dataset.layout(), dataset.size()), (Some(layout), Some(size)));
        let info = index(dir.path());
        let features = &info["features"];
        assert_eq!(features["observation.image"]["shape"], serde_json::json!([size.height, size.width, 3]));
        assert_eq!(features["action"]["shape"], serde_json::json!([axes.len()]));
        assert_eq!(features["action"]["names"], serde_json::json!(axes));
        let fps = if rate == 12.5 { serde_json::json!(12.5) } else { serde_json::json!(rate as u64) };
        assert_eq!(info["fps"], fps, "a whole number where it is one");
        let table = Table::new(fs::read(episode_file(dir.path(), 1)).unwrap()).unwrap();
        let secs: Vec<f32> = (0..5).map(|t| t as f32 / rate as f32).collect();
        assert_eq!(table.read::<FloatType>(&["timestamp"], 1).unwrap(), secs);
        if axes.len() == 1 {
            let actions = table.read::<FloatType>(&["action"], 1).unwrap();
            assert_eq!(actions, [0.0, -1.0, -2.0, -3.0, -4.0], "one number, as LeRobot has it");
        }
        // Moved to another place it is written anew.
        let last = dataset.episode(1).unwrap();
        drop(dataset);
        Dataset::create_or_open(dir.path(), "dummy").unwrap().delete(0).unwrap();
        let moved = Dataset::open(dir.path()).unwrap().episode(0).unwrap();
        assert_eq!(moved, Episode { number: 0, ..last });
    }
}

#[test]
fn what_could_not_be_sealed_is_not_begun() {
    let dir = tempfile::tempdir().unwrap();
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    seal(&mut dataset, 1, 1);
    let refused = |layout: Layout| dataset.begin_with(info(2), &layout).err().map(|met| met.to_string());
    let other_axes = refused(Layout { axes: names(&["gas", "brake"]), ..layout() }).unwrap();
    let told = r#"an episode with the axes ["gas", "brake"] cannot join episodes with the axes ["steer", "gas", "brake"]"#;
    assert!(other_axes.starts_with(told), "{other_axes}");
    let other_rate = refused(Layout { rate: 12.5, ..layout() }).unwrap();
    assert!(
        other_rate.starts_with("an episode of 12.5 steps a second cannot join episodes of 50 steps a second"),
        "{other_rate}"
    );
    let lacking = refused(Layout { events: names(&["new tile"]), ..layout() }).unwrap();
    assert!(
        lacking.starts_with("an episode with the columns") && lacking.contains("next.grass"),
        "{lacking}"
    );
    assert!(refused(Layout { sensors: names(&["speed"]), ..layout() }).is_some());
    assert_eq!(
        refused(Layout { events: names(&["new tile", "grass"]), ..layout() }),
        None,
        "but for more events"
    );
}

#[test]
fn episodes_keep_the_order_they_were_sealed_in() {
    let dir = tempfile::tempdir().unwrap();
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    let early = record(&dataset, 1, 2);
    let late = record(&dataset, 2, 2);
    assert_eq!(dataset.seal(late, &frame(2), None).unwrap(), 0);
    assert_eq!(dataset.seal(early, &frame(2), None).unwrap(), 1);
    drop(dataset);
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    assert_eq!(seal(&mut dataset, 3, 2), 2);
    let seeds: Vec<u64> = dataset.episodes().map(|episode| episode.unwrap().info.seed).collect();
    assert_eq!(seeds, [2, 1, 3]);
}

#[test]
fn an_episode_of_a_killed_program_is_offered_and_recovered() {
    let dir = tempfile::tempdir().unwrap();
    drop(record(&Dataset::create_or_open(dir.path(), "dummy").unwrap(), 5, 4));
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    assert_eq!(dataset.unfinished().len(), 1);
    assert_eq!((dataset.unfinished()[0].n_steps, &dataset.unfinished()[0].info), (4, &info(5)));
    assert_eq!(dataset.recover(0).unwrap(), 0);
    assert!(dataset.unfinished().is_empty(), "a recovered episode is finished");
    let mut known = expected(0, 5, 4);
    known.frames.pop();
    known.done = false;
    assert_eq!(dataset.episode(0).unwrap(), known);
    drop(dataset);
    assert_eq!(Dataset::create_or_open(dir.path(), "dummy").unwrap().unfinished(), []);
}

#[test]
fn an_unfinished_episode_can_be_dropped() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    drop(record(&dataset, 5, 4));
    record(&dataset, 6, 4).discard().unwrap();
    drop(dataset);
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    assert_eq!(dataset.unfinished().len(), 1);
    dataset.discard(0).unwrap();
    assert_eq!((dataset.unfinished().len(), dataset.n_episodes()), (0, 0));
}

#[test]
fn a_program_killed_between_sealing_and_tidying_up_seals_nothing_twice() {
    let dir = tempfile::tempdir().unwrap();
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    let recording = record(&dataset, 1, 3);
    let journal = recording.path().to_path_buf();
    let bytes = fs::read(&journal).unwrap();
    dataset.seal(recording, &frame(3), Some(End::Terminated)).unwrap();
    drop(dataset);
    fs::write(&journal, bytes).unwrap();
    let dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    assert_eq!((dataset.n_episodes(), dataset.unfinished().len()), (1, 0));
    assert!(!journal.exists(), "the journal of a sealed episode goes");
}

#[test]
fn metadata_that_lags_behind_is_repaired_from_the_episodes() {
    let dir = tempfile::tempdir().unwrap();
    let names = ["info.json", "stats.json", "tasks.parquet", "episodes/chunk-000/file-000.parquet"];
    let read = || names.map(|name| fs::read(dir.path().join("meta").join(name)).unwrap_or_default());
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    seal(&mut dataset, 1, 3);
    let old = read();
    seal(&mut dataset, 2, 5);
    drop(dataset);
    let current = read();
    for (name, bytes) in names.iter().zip(old) {
        fs::write(dir.path().join("meta").join(name), bytes).unwrap();
    }
    fs::write(dir.path().join("meta/info.json.partial"), "half").unwrap();
    Dataset::create_or_open(dir.path(), "dummy").unwrap();
    let repaired = read();
    assert_eq!(repaired[0], current[0], "info.json");
    assert_eq!(repaired[2], current[2], "tasks.parquet");
    let info: serde_json::Value = serde_json::from_slice(&repaired[0]).unwrap();
    assert_eq!((&info["total_episodes"], &info["total_frames"]), (&2.into(), &8.into()));
    let stats: serde_json::Value = serde_json::from_slice(&repaired[1]).unwrap();
    assert_eq!(stats["action"]["count"][0], 8);
    assert!(!dir.path().join("meta/info.json.partial").exists(), "half-written files go");
    fs::remove_dir_all(dir.path().join("meta")).unwrap();
    Dataset::create_or_open(dir.path(), "dummy").unwrap();
    assert_eq!(read(), repaired);
}

#[test]
fn a_torn_episode_file_is_named_and_the_others_are_read() {
    let dir = tempfile::tempdir().unwrap();
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    for seed in 0..3 {
        seal(&mut dataset, seed, 3);
    }
    drop(dataset);
    let path = episode_file(dir.path(), 1);
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    let torn = fs::read(&path).unwrap();
    let reader = Dataset::open(dir.path()).unwrap();
    let message = reader.damaged()[0].to_string();
    assert!(message.starts_with("this episode file is damaged ("), "{message}");
    let end = format!("; move it out of the dataset to go on without it: {path:?}");
    assert!(message.ends_with(&end), "{message}");
    assert!(path.exists(), "who only reads changes nothing");

    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    assert_eq!((dataset.n_episodes(), dataset.damaged().len()), (2, 1));
    let DatasetError::SetAside { to, .. } = &dataset.damaged()[0] else { panic!("{:?}", dataset.damaged()) };
    assert!(to.starts_with(dir.path().join("damaged")), "{to:?}");
    assert_eq!(fs::read(to).unwrap(), torn, "nothing is lost");
    let episodes: Vec<Episode> = dataset.episodes().map(Result::unwrap).collect();
    assert_eq!(episodes, [expected(0, 0, 3), expected(1, 2, 3)], "the place is taken by the next");
    assert_eq!(seal(&mut dataset, 9, 1), 2);
}

#[test]
fn a_bit_flipped_anywhere_in_an_episode_is_an_error_or_changes_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    seal(&mut dataset, 1, 3);
    let path = episode_file(dir.path(), 0);
    let whole = fs::read(&path).unwrap();
    let end_of_pages = whole.windows(5).position(|bytes| bytes == b"dropj").unwrap();
    for at in (4..end_of_pages).step_by(7) {
        let mut bytes = whole.clone();
        bytes[at] ^= 0x10;
        fs::write(&path, bytes).unwrap();
        if let Ok(episode) = dataset.episode(0) {
            assert_eq!(episode, expected(0, 1, 3), "byte {at}");
        }
    }
}

#[test]
fn a_damaged_episode_can_be_passed_over() {
    let dir = tempfile::tempdir().unwrap();
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    seal(&mut dataset, 0, 3);
    seal(&mut dataset, 1, 3);
    let path = episode_file(dir.path(), 0);
    let mut bytes = fs::read(&path).unwrap();
    let png = bytes.windows(4).position(|bytes| bytes == b"IDAT").unwrap();
    bytes[png + 6] ^= 1;
    fs::write(&path, bytes).unwrap();
    let seeds: Vec<u64> =
        dataset.episodes().filter_map(Result::ok).map(|episode| episode.info.seed).collect();
    assert_eq!(seeds, [1]);
}

#[test]
fn a_dataset_keeps_to_one_environment_and_one_frame_size() {
    let dir = tempfile::tempdir().unwrap();
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    seal(&mut dataset, 1, 1);
    let mut recording = dataset.begin_with(info(2), &layout()).unwrap();
    let small = StepRecord { frame: Frame::square(1, vec![0; 3]), ..step(0) };
    assert!(matches!(
        recording.push(&small),
        Err(DatasetError::OtherSize { tried: Size { height: 1, width: 1 }, met: SIZE, .. })
    ));
    drop(dataset);
    let message = Dataset::create_or_open(dir.path(), "other").err().unwrap().to_string();
    assert!(message.starts_with(r#"episodes of "other" cannot join a dataset of "dummy""#), "{message}");
}

#[test]
fn only_one_program_records_into_a_dataset() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    assert!(matches!(Dataset::create_or_open(dir.path(), "dummy"), Err(DatasetError::Busy { .. })));
    drop(dataset);
    Dataset::create_or_open(dir.path(), "dummy").unwrap();
}

#[test]
fn a_folder_without_episodes_is_said_to_be_one() {
    let dir = tempfile::tempdir().unwrap();
    let message = Dataset::open(&dir.path().join("nowhere")).err().unwrap().to_string();
    assert!(message.starts_with("no recorded episodes at"), "{message}");
}

#[test]
fn an_episode_that_cannot_be_sealed_stays_in_its_journal() {
    let dir = tempfile::tempdir().unwrap();
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    let recording = record(&dataset, 3, 2);
    // A file where the folder should be: as good as a disk that refuses, and true for root as well.
    fs::write(dir.path().join("data"), "in the way").unwrap();
    let message = dataset.seal(recording, &frame(2), Some(End::Terminated)).unwrap_err().to_string();
    assert!(message.starts_with("could not seal the episode, which stays in its journal"), "{message}");
    fs::remove_file(dir.path().join("data")).unwrap();
    assert_eq!(dataset.recover(0).unwrap(), 0);
    assert_eq!(dataset.episode(0).unwrap(), expected(0, 3, 2));
}

/// All files of a dataset with their content, but for the locks and the ones left from deleting.
///
/// Statistics read back from a file differ in their last digits from those that were written, so it is opened first.
fn files(dir: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    drop(Dataset::create_or_open(dir, "dummy").unwrap());
    let mut files = Vec::new();
    let mut folders = vec![dir.join("data"), dir.join("meta"), dir.join("journal")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).into_iter().flatten() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if !path.ends_with(".lock") {
                files.push((path.strip_prefix(dir).unwrap().to_owned(), fs::read(&path).unwrap()));
            }
        }
    }
    files.sort();
    files
}

/// Four episodes of different lengths.
fn four(dir: &Path) -> Dataset {
    let mut dataset = Dataset::create_or_open(dir, "dummy").unwrap();
    for (seed, n_steps) in [(10, 3), (11, 5), (12, 2), (13, 4)] {
        seal(&mut dataset, seed, n_steps);
    }
    dataset
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let to = to.join(path.file_name().unwrap());
        if path.is_dir() {
            copy(&path, &to);
        } else {
            fs::copy(&path, &to).unwrap();
        }
    }
}

#[test]
fn after_a_deletion_numbers_and_steps_count_on_without_a_gap() {
    let dir = tempfile::tempdir().unwrap();
    let mut dataset = four(dir.path());
    let before = dataset.fingerprint();
    dataset.delete(1).unwrap();
    let left = [expected(0, 10, 3), expected(1, 12, 2), expected(2, 13, 4)];
    let deleted = dataset.fingerprint();
    assert_ne!(deleted, before, "a fit that was begun before does not go on with these");
    let read = |dataset: &Dataset| dataset.episodes().map(Result::unwrap).collect::<Vec<_>>();
    assert_eq!(read(&dataset), left);
    drop(dataset);
    let dataset = Dataset::open(dir.path()).unwrap();
    assert_eq!((read(&dataset), dataset.next_number()), (left.to_vec(), 3));
    assert_eq!(dataset.fingerprint(), deleted);
    let json = |name: &str| -> serde_json::Value {
        serde_json::from_slice(&fs::read(dir.path().join("meta").join(name)).unwrap()).unwrap()
    };
    assert_eq!(
        (&json("info.json")["total_episodes"], &json("info.json")["total_frames"]),
        (&3.into(), &9.into())
    );
    // What LeRobot and we say of indices: each episode begins where the one before ended.
    let stats = json("stats.json");
    assert_eq!((&stats["index"]["max"][0], &stats["episode_index"]["max"][0]), (&8.0.into(), &2.0.into()));
    assert_eq!(dataset.deleted().map(|deleted| deleted.info.seed), Some(11));
}

#[test]
fn a_deleted_episode_comes_back_after_the_others_until_another_is_deleted() {
    let dir = tempfile::tempdir().unwrap();
    let mut dataset = four(dir.path());
    let recording = dataset.summaries().next().unwrap().recording.clone();
    dataset.delete(0).unwrap();
    assert!(dataset.bring_back("another").is_err(), "somebody deleted one more in the meantime");
    assert_eq!(dataset.bring_back(&recording).unwrap(), 3);
    assert_eq!(dataset.episode(3).unwrap(), expected(3, 10, 3));
    let again = dataset.bring_back(&recording);
    assert!(matches!(again, Err(DatasetError::NothingDeleted { .. })), "but once");
    dataset.delete(0).unwrap();
    dataset.delete(0).unwrap();
    assert_eq!(dataset.deleted().map(|deleted| deleted.info.seed), Some(12), "the last one only");
    let summaries: Vec<_> = dataset.summaries().map(|it| (it.number, it.info.seed, it.n_steps)).collect();
    assert_eq!(summaries, [(0, 13, 4), (1, 10, 3)]);
    assert_eq!(seal(&mut dataset, 20, 1), 2, "and recording goes on after them");
}

#[test]
fn a_program_killed_at_any_moment_of_a_deletion_leaves_it_done_or_not_begun() {
    let (before, after) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    drop(four(before.path()));
    copy(before.path(), after.path());
    Dataset::create_or_open(after.path(), "dummy").unwrap().delete(1).unwrap();
    let wanted = files(after.path());

    // Which files are there already (of the folder before, or after), one killing after the other.
    let moments: [&[(usize, bool)]; 6] = [
        &[(0, false), (2, false), (3, false)],
        &[(0, false), (1, true), (2, false), (3, false)],
        &[(0, false), (1, true), (3, false)],
        &[(0, false), (1, true), (2, true), (3, false)],
        &[(0, false), (1, true), (2, true)],
        &[(0, false), (1, false), (2, false), (3, false)],
    ];
    for (moment, there) in moments.into_iter().enumerate() {
        let torn = tempfile::tempdir().unwrap();
        copy(before.path(), torn.path());
        fs::remove_dir_all(torn.path().join("data")).unwrap();
        fs::create_dir_all(torn.path().join("data/chunk-000")).unwrap();
        for &(number, is_after) in there {
            let from = if is_after { after.path() } else { before.path() };
            fs::copy(episode_file(from, number), episode_file(torn.path(), number)).unwrap();
        }
        fs::write(torn.path().join("journal/renumbering"), "").unwrap();
        let is_deleted = moment < 5;
        let read = Dataset::open(torn.path()).unwrap();
        let seeds: Vec<_> = read.episodes().map(|episode| episode.unwrap().info.seed).collect();
        let expected = if is_deleted { vec![10, 12, 13] } else { vec![10, 11, 12, 13] };
        assert_eq!(seeds, expected, "no episode is read twice, at moment {moment}");
        assert!(Dataset::is_torn(torn.path()));

        drop(Dataset::create_or_open(torn.path(), "dummy").unwrap());
        let wanted = if is_deleted { wanted.clone() } else { files(before.path()) };
        assert!(files(torn.path()) == wanted, "moment {moment} is repaired");
    }
}

#[test]
fn an_episode_that_cannot_be_moved_keeps_nobody_from_recording() {
    let dir = tempfile::tempdir().unwrap();
    drop(four(dir.path()));
    // A deletion was begun, and the next episode is damaged where only reading it whole can tell.
    fs::remove_file(episode_file(dir.path(), 1)).unwrap();
    fs::write(dir.path().join("journal/renumbering"), "").unwrap();
    let damaged = episode_file(dir.path(), 2);
    let mut bytes = fs::read(&damaged).unwrap();
    bytes[8..200].fill(0xa5);
    fs::write(&damaged, bytes).unwrap();

    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    assert!(matches!(dataset.damaged(), [DatasetError::SetAside { .. }]), "{:?}", dataset.damaged());
    assert_eq!(seal(&mut dataset, 20, 1), 2, "behind all others");
    assert_eq!(dataset.episode(0).unwrap(), expected(0, 10, 3));
    assert_eq!(dataset.episode(1).unwrap(), expected(1, 13, 4));
}

#[test]
fn the_last_episode_takes_what_was_said_of_it_with_it() {
    let dir = tempfile::tempdir().unwrap();
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    seal(&mut dataset, 1, 3);
    let recording = dataset.summaries().next().unwrap().recording.clone();
    dataset.delete(0).unwrap();
    assert!(!dir.path().join("meta").exists());
    assert!(matches!(Dataset::open(dir.path()), Err(DatasetError::Missing { .. })));
    assert_eq!(dataset.bring_back(&recording).unwrap(), 0);
    assert_eq!(Dataset::open(dir.path()).unwrap().episode(0).unwrap(), expected(0, 1, 3));
}

#[test]
fn nothing_is_deleted_while_somebody_records() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = four(dir.path());
    let mut reader = Dataset::open(dir.path()).unwrap();
    assert!(matches!(reader.delete(0), Err(DatasetError::ReadOnly { .. })));
    drop(dataset);
    // And who read on while another program deleted is told.
    Dataset::create_or_open(dir.path(), "dummy").unwrap().delete(1).unwrap();
    assert!(matches!(reader.episode(1), Err(DatasetError::Moved { .. })));
}

/// What lies below a folder: every file with its content, and every folder.
fn tree(dir: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let (mut tree, mut folders) = (Vec::new(), vec![dir.to_owned()]);
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path.clone());
                tree.push((path, Vec::new()));
            } else {
                tree.push((path.clone(), fs::read(path).unwrap()));
            }
        }
    }
    tree.sort();
    tree
}

/// Asserts that the folder is refused and nothing in it changed, and returns why.
#[track_caller]
fn refused(dir: &Path) -> String {
    let before = tree(dir);
    let refused = Dataset::create_or_open(dir, "dummy").err();
    assert!(tree(dir) == before, "nothing is touched");
    refused.expect("it is refused").to_string()
}

/// A Parquet file of somebody else's with these columns.
fn foreign(names: &[&str]) -> Vec<u8> {
    let columns = names.iter().map(|&name| (name.to_owned(), Column::Ints(vec![1, 2]))).collect();
    let ours = to_parquet(columns, Vec::new()).unwrap();
    let by = format!("dropj {}", env!("CARGO_PKG_VERSION"));
    signed(edited(ours, &by, &format!("{:1$}", "pyarrow", by.len())))
}

/// The same bytes with a text replaced by another of the same length, wherever it stands.
fn edited(mut bytes: Vec<u8>, from: &str, to: &str) -> Vec<u8> {
    assert_eq!(from.len(), to.len());
    let at: Vec<usize> =
        (0..bytes.len() - from.len()).filter(|&at| bytes[at..].starts_with(from.as_bytes())).collect();
    assert!(!at.is_empty(), "{from} is there");
    for at in at {
        bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
    }
    bytes
}

/// The same file with the checksum of its footer made right: what an attacker would do.
fn signed(mut file: Vec<u8>) -> Vec<u8> {
    sign_footer(&mut file).unwrap();
    file
}

fn put(dir: &Path, name: &str, bytes: impl AsRef<[u8]>) {
    let path = dir.join(name);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, bytes).unwrap();
}

/// Names and contents of files.
type Files<'a> = &'a [(&'a str, &'a [u8])];

#[test]
fn a_folder_of_somebody_elses_is_refused_and_nothing_in_it_touched() {
    let lerobot = r#"{"codebase_version": "v3.0", "robot_type": "so101", "features": {}}"#;
    let data = foreign(&["action", "index"]);
    let file = "data/chunk-000/file-000.parquet";
    let folders: [(Files<'_>, &str); 8] = [
        (&[("meta/info.json", lerobot.as_bytes()), (file, &data)], "so101"),
        (&[("meta/info.json", lerobot.as_bytes())], "so101"),
        (&[(file, &data)], "not recorded by dropj, but written by pyarrow"),
        (&[("data/chunk-000/episode_000000.parquet", &data)], "episode_000000.parquet"),
        (&[("notes.txt", b"mine")], "notes.txt"),
        (&[("data/notes.txt", b"mine")], "\"data\""),
        (&[(file, b"torn"), ("notes.txt", b"mine")], "notes.txt"),
        // A version of before went over it, and made a lock and an index of its own.
        (&[("meta/info.json", br#"{"dropj": {}}"#), ("journal/.lock", b""), (file, &data)], "pyarrow"),
    ];
    for (files, reason) in folders {
        let dir = tempfile::tempdir().unwrap();
        for (name, bytes) in files {
            put(dir.path(), name, bytes);
        }
        let message = refused(dir.path());
        assert!(message.contains(reason), "{message}");
        if files.iter().any(|(name, _)| *name == file) {
            assert!(Dataset::open(dir.path()).is_err(), "there is nothing of ours to read");
        }
    }
}

#[test]
fn an_empty_folder_is_as_good_as_none() {
    let dir = tempfile::tempdir().unwrap();
    fs::create_dir_all(dir.path().join("empty/within")).unwrap();
    put(dir.path(), ".DS_Store", "");
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    seal(&mut dataset, 1, 2);
    dataset.delete(0).unwrap();
    drop(dataset);
    // And one of which all was deleted is ours still.
    seal(&mut Dataset::create_or_open(dir.path(), "dummy").unwrap(), 1, 2);
    put(dir.path(), "README.md", "what I drove");
    Dataset::create_or_open(dir.path(), "dummy").unwrap();
}

#[test]
fn an_episode_that_another_program_rewrote_is_refused_by_its_true_name() {
    let dir = tempfile::tempdir().unwrap();
    drop(four(dir.path()));
    let path = episode_file(dir.path(), 1);
    let whole = fs::read(&path).unwrap();
    let by = format!("dropj {}", env!("CARGO_PKG_VERSION"));
    let pyarrow = format!("{:1$}", "pyarrow", by.len());
    let left_out = foreign(&["action", "next.grass", "wall_time_ns"]);
    for (rewritten, reason) in [
        (signed(edited(whole.clone(), &by, &pyarrow)), "recorded by dropj, but rewritten by pyarrow"),
        (left_out, "which left out who drove"),
        (signed(edited(whole.clone(), "\"format\":3", "\"format\":9")), "format 9"),
        (
            signed(edited(whole, "\"next.grass\":{", "\"next.glass\":{")),
            "lacks the statistics of \"next.grass\"",
        ),
    ] {
        fs::write(&path, rewritten).unwrap();
        let message = refused(dir.path());
        assert!(message.contains(reason) && message.contains("file-001.parquet"), "{message}");
        let reader = Dataset::open(dir.path()).unwrap();
        assert_eq!((reader.n_episodes(), reader.damaged().len()), (3, 1), "the others are read");
    }
}

#[test]
fn whatever_happens_to_files_the_index_follows() {
    let dir = tempfile::tempdir().unwrap();
    let other = tempfile::tempdir().unwrap();
    drop(four(dir.path()));
    seal(&mut Dataset::create_or_open(other.path(), "dummy").unwrap(), 99, 6);
    let file = |number| episode_file(dir.path(), number);
    fs::remove_file(file(1)).unwrap();
    let check = |seeds: &[(u64, usize)]| {
        let read = Dataset::open(dir.path()).unwrap();
        let known: Vec<Episode> =
            (0..).zip(seeds).map(|(number, &(seed, n_steps))| expected(number, seed, n_steps)).collect();
        assert_eq!(read.episodes().map(Result::unwrap).collect::<Vec<_>>(), known, "to who only reads");
        let written = Dataset::create_or_open(dir.path(), "dummy").unwrap();
        assert_eq!(written.episodes().map(Result::unwrap).collect::<Vec<_>>(), known);
        let mut first_index = 0;
        for (number, notes) in written.episodes.iter().enumerate() {
            assert!(notes.is_at(dir.path(), number, first_index), "{notes:?}");
            // The file itself says so, too.
            let of_file = super::sealed::open(&file(number)).unwrap();
            assert_eq!((of_file.number, of_file.first_index), (number, first_index));
            first_index += notes.n_steps;
        }
        assert_eq!(disk::data_files(dir.path()).unwrap().len(), seeds.len());
    };
    check(&[(10, 3), (12, 2), (13, 4)]);
    // One in the middle, of another dataset. The last under a name of its own.
    fs::rename(file(2), file(7)).unwrap();
    fs::rename(file(1), file(5)).unwrap();
    fs::copy(episode_file(other.path(), 0), file(3)).unwrap();
    fs::rename(file(0), dir.path().join("data/chunk-000/the first.parquet")).unwrap();
    check(&[(99, 6), (12, 2), (13, 4), (10, 3)]);
    // Two change places.
    fs::rename(file(0), file(9)).unwrap();
    fs::rename(file(1), file(0)).unwrap();
    check(&[(12, 2), (13, 4), (10, 3), (99, 6)]);
    // And a copy is no episode of its own.
    fs::copy(file(1), file(8)).unwrap();
    check(&[(12, 2), (13, 4), (10, 3), (99, 6)]);
    assert!(dir.path().join("damaged/data-chunk-000-file-008.parquet.damaged").exists());
}

#[test]
fn nothing_that_was_moved_aside_is_overwritten() {
    let dir = tempfile::tempdir().unwrap();
    drop(four(dir.path()));
    for content in ["one", "two"] {
        put(dir.path(), "data/chunk-000/file-003.parquet", content);
        let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
        assert_eq!(dataset.damaged().len(), 1, "{content}");
        seal(&mut dataset, 1, 1);
    }
    put(dir.path(), "journal/00000000000000000000007.journal", "no journal");
    put(dir.path(), "meta/episodes/chunk-000/file-001.parquet", "another's index");
    assert_eq!(Dataset::create_or_open(dir.path(), "dummy").unwrap().damaged().len(), 2);
    let mut aside: Vec<_> = tree(&dir.path().join("damaged"))
        .into_iter()
        .map(|(_, bytes)| String::from_utf8(bytes).unwrap())
        .collect();
    aside.sort();
    assert_eq!(aside, ["another's index", "no journal", "one", "two"]);
}

#[test]
fn only_what_is_ours_is_removed() {
    let dir = tempfile::tempdir().unwrap();
    let mut dataset = four(dir.path());
    for name in ["deleted/mine.parquet", "meta/mine.txt", "meta/mine.txt.partial", "data/mine.partial"] {
        put(dir.path(), name, "mine");
    }
    (0..4).for_each(|_| dataset.delete(0).unwrap());
    drop(dataset);
    Dataset::create_or_open(dir.path(), "dummy").unwrap();
    for name in ["deleted/mine.parquet", "meta/mine.txt", "meta/mine.txt.partial", "data/mine.partial"] {
        assert!(dir.path().join(name).exists(), "{name}");
    }
    assert!(!dir.path().join("meta/info.json").exists(), "it would tell of episodes that are gone");
}

#[test]
fn episodes_that_do_not_belong_together_are_named_with_their_files() {
    let (dir, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    drop(four(dir.path()));
    let mut dataset = Dataset::create_or_open(other.path(), "elsewhere").unwrap();
    let there = EpisodeInfo { env: "elsewhere".into(), ..info(1) };
    let mut recording = dataset.begin(there).unwrap();
    recording.push(&StepRecord { state: Vec::new(), ..step(0) }).unwrap();
    dataset.seal(recording, &frame(1), None).unwrap();
    fs::copy(episode_file(other.path(), 0), episode_file(dir.path(), 4)).unwrap();
    let message = refused(dir.path());
    for name in ["\"dummy\"", "\"elsewhere\"", "file-000.parquet", "file-004.parquet"] {
        assert!(message.contains(name), "{name}: {message}");
    }
    assert!(matches!(Dataset::open(dir.path()), Err(DatasetError::Mixed { .. })), "nor are they read as one");
}

#[test]
fn why_an_episode_ended_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    let ends =
        [(None, false, false), (Some(End::Terminated), true, false), (Some(End::Truncated), true, true)];
    for (end, ..) in ends {
        let recording = record(&dataset, 1, 2);
        dataset.seal(recording, &frame(2), end).unwrap();
    }
    for (idx, (_, done, truncated)) in ends.into_iter().enumerate() {
        let episode = dataset.episode(idx).unwrap();
        assert_eq!((episode.done, episode.truncated), (done, truncated));
        let file = fs::read(episode_file(dir.path(), idx)).unwrap();
        let table = Table::new(file).unwrap();
        let column = |name| table.read::<BoolType>(&[name], 1).unwrap();
        assert_eq!(column("next.done"), [false, done]);
        assert_eq!(column("next.truncated"), [false, truncated]);
        assert_eq!(column("next.terminated"), [false, done && !truncated]);
    }
}

/// An episode of seed 7 and four steps, and a journal of seed 8, that the version before format 2 wrote.
const OLD_EPISODE: &[u8] = include_bytes!("../../tests/golden/episode-format-1.parquet");
const OLD_JOURNAL: &[u8] = include_bytes!("../../tests/golden/journal-format-1.journal");

/// What an older version would have recorded.
fn expected_old(number: usize, seed: u64, n_steps: usize) -> Episode {
    let states = vec![Vec::new(); n_steps];
    Episode { layout: Layout::default(), states, ..expected(number, seed, n_steps) }
}

#[test]
fn a_dataset_of_an_older_version_is_read_and_keeps_its_columns() {
    let dir = tempfile::tempdir().unwrap();
    put(dir.path(), "data/chunk-000/file-000.parquet", OLD_EPISODE);
    put(dir.path(), "journal/00000000000000000000007.journal", OLD_JOURNAL);
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    assert_eq!(fs::read(episode_file(dir.path(), 0)).unwrap(), OLD_EPISODE, "it stays as it is");
    assert_eq!(dataset.recover(0).unwrap(), 1);
    assert_eq!(seal(&mut dataset, 9, 2), 2, "what the car measures is left out");
    let planned = std::iter::once(1..2).collect();
    let known = [expected_old(0, 7, 4), Episode { planned, ..expected_old(1, 8, 3) }, expected_old(2, 9, 2)];
    assert_eq!(dataset.episodes().map(Result::unwrap).collect::<Vec<_>>(), known);
    let text = fs::read_to_string(dir.path().join("meta/info.json")).unwrap();
    assert!(!text.contains("observation.state"), "all files have the same columns");
    // Moved to another place it is written anew, with the columns that it had.
    dataset.delete(1).unwrap();
    fs::rename(episode_file(dir.path(), 0), episode_file(dir.path(), 5)).unwrap();
    drop(dataset);
    let dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    assert_eq!(dataset.episode(1).unwrap(), expected_old(1, 7, 4));
}

/// An episode of seed 7 and four steps in a world with obstacles, and a journal of seed 8, that the version before format 3
/// wrote.
const SECOND_EPISODE: &[u8] = include_bytes!("../../tests/golden/episode-format-2.parquet");
const SECOND_JOURNAL: &[u8] = include_bytes!("../../tests/golden/journal-format-2.journal");

/// What that version recorded, and this one goes on with.
fn expected_second(number: usize, seed: u64, n_steps: usize) -> Episode {
    let env = "obstacle-car-racing-chuckholes".into();
    let known = expected(number, seed, n_steps);
    Episode {
        info: EpisodeInfo { env, ..info(seed) },
        layout: Layout { events: names(&["grass", "chuckhole", "car"]), ..layout() },
        events: (0..n_steps).map(|t| vec![t.is_multiple_of(4), t == 2, false]).collect(),
        planned: std::iter::once(1..2).collect(),
        ..known
    }
}

#[test]
fn a_dataset_of_the_cars_is_continued_in_a_world_that_tells_other_events() {
    let dir = tempfile::tempdir().unwrap();
    let spec = WorldSpec::built_in("obstacle-car-racing-chuckholes").unwrap();
    put(dir.path(), "data/chunk-000/file-000.parquet", SECOND_EPISODE);
    put(dir.path(), "journal/00000000000000000000007.journal", SECOND_JOURNAL);
    let mut dataset = Dataset::create_or_open(dir.path(), &spec.name).unwrap();
    assert_eq!(fs::read(episode_file(dir.path(), 0)).unwrap(), SECOND_EPISODE, "it stays as it is");
    assert_eq!(dataset.recover(0).unwrap(), 1);
    // There is no car in this world any more, and "new tile" was none of its events.
    let layout = Layout::of(&spec, &layout().sensors);
    assert_eq!(layout.events, ["grass", "new tile", "chuckhole"]);
    let mut recording = dataset.begin_with(expected_second(2, 9, 3).info, &layout).unwrap();
    for t in 0..3 {
        let step = StepRecord { events: vec![t == 0, true, t == 2], ..step(t) };
        recording.push_by(&step, t == 1).unwrap();
    }
    dataset.seal(recording, &frame(3), Some(End::Terminated)).unwrap();
    let mut killed = expected_second(1, 8, 3);
    killed.frames.pop();
    killed.done = false;
    let known = [expected_second(0, 7, 4), killed, expected_second(2, 9, 3)];
    assert_eq!(dataset.episodes().map(Result::unwrap).collect::<Vec<_>>(), known);
    let features = index(dir.path())["features"].as_object().unwrap().clone();
    assert!(features.contains_key("next.car") && !features.contains_key("next.new_tile"), "{features:?}");
    // Moved to another place it is written anew, with the columns that it had.
    dataset.delete(1).unwrap();
    fs::rename(episode_file(dir.path(), 0), episode_file(dir.path(), 5)).unwrap();
    drop(dataset);
    let dataset = Dataset::create_or_open(dir.path(), &spec.name).unwrap();
    assert_eq!(dataset.episode(1).unwrap(), expected_second(1, 7, 4));
}

#[test]
fn notes_beyond_all_measure_are_refused_before_anything_is_allocated() {
    let dir = tempfile::tempdir().unwrap();
    drop(four(dir.path()));
    let notes = super::sealed::open(&episode_file(dir.path(), 0)).unwrap();
    let check = |notes: &Notes| limits::check_notes(notes, 3);
    assert_eq!(check(&notes), Ok(()));
    let odd: [fn(&mut Notes); 16] = [
        |notes| notes.n_steps = usize::MAX,
        |notes| notes.n_steps = 0,
        |notes| notes.height = 60_000,
        |notes| notes.width = 60_000,
        |notes| notes.height = 0,
        |notes| notes.width = 0,
        |notes| notes.recording = "../../etc/passwd".into(),
        |notes| notes.planned = vec![[2, 1]],
        |notes| notes.planned = vec![[0, 4]],
        |notes| notes.info.env = "x".repeat(1000),
        |notes| notes.state = vec![String::new()],
        |notes| notes.axes = Vec::new(),
        |notes| notes.events.push("Grass".into()),
        |notes| notes.rate = f64::INFINITY,
        |notes| drop(notes.stats.remove("action")),
        |notes| notes.stats.get_mut("index").unwrap().max = Vec::new(),
    ];
    for change in odd {
        let mut notes = notes.clone();
        change(&mut notes);
        assert!(check(&notes).is_err(), "{notes:?}");
    }
    let mut long = notes.clone();
    (long.n_steps, long.height, long.width) = (limits::STEPS, limits::SIDE, limits::SIDE);
    assert!(limits::check_notes(&long, limits::STEPS as i64).is_err(), "300 GB of frames");
}

#[test]
fn no_bytes_make_the_readers_panic() {
    let dir = tempfile::tempdir().unwrap();
    drop(four(dir.path()));
    let episode = fs::read(episode_file(dir.path(), 0)).unwrap();
    let mut numbers = ChaCha8Rng::seed_from_u64(0);
    drop(record(&Dataset::create_or_open(dir.path(), "dummy").unwrap(), 5, 4));
    let journal = disk::list(&dir.path().join("journal")).unwrap();
    let journal = journal.iter().find(|path| path.extension().is_some()).map(|path| fs::read(path).unwrap());
    let old = [OLD_EPISODE, OLD_JOURNAL, SECOND_EPISODE, SECOND_JOURNAL].map(<[u8]>::to_vec);
    for whole in [episode.clone(), journal.unwrap()].iter().chain(&old) {
        // So many take a second. ROUNDS=400000 took over a minute.
        for round in 0..std::env::var("ROUNDS").map_or(600, |rounds| rounds.parse().unwrap()) {
            let mut bytes = whole.clone();
            for _ in 0..=round % 4 {
                let (at, byte) = (numbers.next_u64() as usize % bytes.len(), numbers.next_u64() as u8);
                match round % 3 {
                    0 => bytes[at] = byte,
                    1 => bytes[at] ^= 1 << (byte % 8),
                    _ => bytes.truncate(at.max(1)),
                }
            }
            read_episode(bytes.clone()).ok();
            // And where the checksums are made right.
            sign_footer(&mut bytes).ok();
            read_episode(bytes.clone()).ok();
            sign_pages(&mut bytes);
            read_episode(bytes.clone()).ok();
            read_journal(&bytes);
        }
    }
    assert_eq!(read_episode(episode).unwrap(), expected(0, 10, 3));
}

mod hub;
