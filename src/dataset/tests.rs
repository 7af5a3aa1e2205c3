//! Episodes survive: the disk, a killed program, a damaged file, another program's eyes.

use std::fs;
use std::path::{Path, PathBuf};

use super::{Dataset, DatasetError, Episode, EpisodeInfo, Recording, StepRecord};
use crate::env::{Action, Contacts, Frame};

const SIDE: u32 = 12;

fn frame(level: usize) -> Frame {
    let rgb: Vec<u8> =
        (0..3 * SIDE as usize * SIDE as usize).map(|byte| (byte * level % 253) as u8).collect();
    Frame::new(SIDE, rgb)
}

fn step(index: usize) -> StepRecord {
    StepRecord {
        frame: frame(index),
        action: Action::new(-0.1 * index as f32, 0.3, 0.01 * index as f32),
        reward: if index.is_multiple_of(3) { 10.0 } else { -1.0 },
        grass: index.is_multiple_of(4),
        contacts: None,
        wall_time_ns: 1_767_225_600_000_000_000 + 20_000_000 * index as i64,
    }
}

fn info(seed: u64) -> EpisodeInfo {
    EpisodeInfo { env: "dummy".into(), pilot: "nobody".into(), seed }
}

fn record(dataset: &Dataset, seed: u64, n_steps: usize) -> Recording {
    let mut recording = dataset.begin(info(seed)).unwrap();
    for index in 0..n_steps {
        recording.push(&step(index)).unwrap();
    }
    recording
}

fn seal(dataset: &mut Dataset, seed: u64, n_steps: usize) -> usize {
    let recording = record(dataset, seed, n_steps);
    dataset.seal(recording, &frame(n_steps), true).unwrap()
}

fn expected(number: usize, seed: u64, n_steps: usize) -> Episode {
    let steps: Vec<StepRecord> = (0..n_steps).map(step).collect();
    Episode {
        number,
        info: info(seed),
        frames: (0..=n_steps).map(frame).collect(),
        actions: steps.iter().map(|step| step.action).collect(),
        rewards: steps.iter().map(|step| step.reward).collect(),
        grass: steps.iter().map(|step| step.grass).collect(),
        contacts: steps.iter().filter_map(|step| step.contacts).collect(),
        wall_times_ns: steps.iter().map(|step| step.wall_time_ns).collect(),
        done: true,
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
        let mut recording = dataset.begin(info(1)).unwrap();
        for index in 0..8 {
            recording.push_by(&step(index), planned(index)).unwrap();
        }
        recording
    };
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    let recording = drive(&dataset);
    dataset.seal(recording, &frame(8), true).unwrap();
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
        assert_eq!((dataset.env(), dataset.side()), (Some("dummy"), Some(SIDE)));
        let episodes: Vec<Episode> = dataset.episodes().map(Result::unwrap).collect();
        assert_eq!(episodes, [expected(0, 7, 1), expected(1, u64::MAX, 130)]);
    }
}

#[test]
fn contacts_with_obstacles_come_back() {
    let dir = tempfile::tempdir().unwrap();
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    let contacts = [(true, false), (false, false), (true, true)];
    let contacts = contacts.map(|(chuckhole, car)| Contacts { chuckhole, car });
    let mut recording = dataset.begin(info(1)).unwrap();
    for (i, &contact) in contacts.iter().enumerate() {
        recording.push(&StepRecord { contacts: Some(contact), ..step(i) }).unwrap();
    }
    dataset.seal(recording, &frame(3), true).unwrap();
    let read = Dataset::open(dir.path()).unwrap().episode(0).unwrap();
    assert_eq!(read.contacts, contacts);
    assert_eq!(read.grass, [true, false, false]);
}

#[test]
fn episodes_keep_the_order_they_were_sealed_in() {
    let dir = tempfile::tempdir().unwrap();
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    let early = record(&dataset, 1, 2);
    let late = record(&dataset, 2, 2);
    assert_eq!(dataset.seal(late, &frame(2), false).unwrap(), 0);
    assert_eq!(dataset.seal(early, &frame(2), false).unwrap(), 1);
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
    dataset.seal(recording, &frame(3), true).unwrap();
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
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    assert_eq!((dataset.n_episodes(), dataset.damaged().len()), (2, 1));
    let message = dataset.damaged()[0].to_string();
    assert!(message.starts_with("this episode file is damaged ("), "{message}");
    let end = format!("; move it out of the dataset to go on without it: {path:?}");
    assert!(message.ends_with(&end), "{message}");
    assert_eq!(seal(&mut dataset, 9, 1), 3, "no file is overwritten");
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
    let mut recording = dataset.begin(info(2)).unwrap();
    let small = StepRecord { frame: Frame::new(1, vec![0; 3]), ..step(0) };
    assert!(matches!(recording.push(&small), Err(DatasetError::OtherSide { tried: 1, met: SIDE, .. })));
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
    let message = dataset.seal(recording, &frame(2), true).unwrap_err().to_string();
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
    assert_eq!(dataset.damaged().len(), 1, "{:?}", dataset.damaged());
    assert_eq!(seal(&mut dataset, 20, 1), 4, "behind all others");
    assert_eq!(dataset.episode(0).unwrap(), expected(0, 10, 3));
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
