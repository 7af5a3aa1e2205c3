//! Datasets that others made: two tiny ones of lerobot's own, read as lerobot itself reads them.

#![expect(
    clippy::unwrap_used,
    clippy::print_stderr,
    reason = "a failing test may panic, and one that is skipped says so"
)]

use std::path::{Path, PathBuf};
use std::process::Command;

use dropj::dataset::lerobot::{LeRobotDataset, RawEpisode, View};
use dropj::world::{Frame, ImageSpec, Size, WorldSpec};

/// How far a value may be from lerobot's, whose colors come from a fast path of its decoder.
const MOST_OFF: u8 = 3;
/// How far a mean may be.
const MOST_MEAN_OFF: f64 = 1.6;

fn dir(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/lerobot").join(name)
}

fn open(name: &str) -> LeRobotDataset {
    LeRobotDataset::open(&dir(name)).unwrap()
}

fn view(cameras: &[&str]) -> View {
    View { cameras: cameras.iter().map(|&name| name.to_owned()).collect(), action: None }
}

fn pixel(frame: &Frame, row: u32, column: u32) -> [u8; 3] {
    let at = 3 * (row * frame.width() + column) as usize;
    [frame.rgb()[at], frame.rgb()[at + 1], frame.rgb()[at + 2]]
}

fn mean(frame: &Frame) -> [f64; 3] {
    let pixels = frame.rgb().as_chunks::<3>().0;
    [0, 1, 2]
        .map(|color| pixels.iter().map(|pixel| f64::from(pixel[color])).sum::<f64>() / pixels.len() as f64)
}

/// How long the white bar is in its row: 2 + 3 · step in all of them.
fn bar(frame: &Frame) -> usize {
    let row = frame.height() - 3;
    (0..frame.width()).filter(|&column| pixel(frame, row, column)[1] > 128).count()
}

fn near(found: &[f32], wanted: &[f32]) {
    let is_near = found.len() == wanted.len() && found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-6);
    assert!(is_near, "{found:?} is not {wanted:?}");
}

#[test]
fn a_dataset_says_what_it_is() {
    let images = open("images");
    assert_eq!((images.fps(), images.n_episodes()), (10.0, 3));
    assert_eq!([0, 1, 2].map(|idx| images.len(idx)), [10, 13, 8]);
    let camera = &images.cameras()[0];
    assert_eq!((camera.name.as_str(), camera.height, camera.width), ("observation.image", 96, 96));
    assert!(!camera.is_video && images.cameras().len() == 1);
    assert_eq!(images.action(None).unwrap().components, ["throttle", "steer"]);
    let names: Vec<_> = images.features().iter().map(|feature| feature.name.as_str()).collect();
    assert_eq!(names, ["observation.state", "action", "next.reward", "next.done"]);
    assert!(images.features()[3].is_bool);

    let video = open("video");
    assert_eq!((video.fps(), video.n_episodes()), (15.0, 4));
    assert_eq!([0, 1, 2, 3].map(|idx| video.len(idx)), [9, 12, 10, 11]);
    assert_eq!(video.action(None).unwrap().components, ["steer", "gas", "brake"]);
    assert!(video.cameras().iter().all(|camera| camera.is_video) && video.cameras().len() == 2);
}

#[test]
fn pictures_in_parquet_are_read_exactly() {
    let images = open("images");
    let episodes: Vec<RawEpisode> =
        (0..3).map(|idx| images.episode(idx, &View::default()).unwrap()).collect();
    for (episode, n) in episodes.iter().zip([10, 13, 8]) {
        assert_eq!((episode.frames.len(), episode.actions.len(), episode.tasks.len()), (n, n, n));
        for (step, frame) in episode.frames.iter().enumerate() {
            assert_eq!((frame.height(), frame.width()), (96, 96));
            assert_eq!(bar(frame), 2 + 3 * step, "episode {}, step {step}", episode.number);
        }
        assert!(episode.tasks.iter().all(|task| task == "keep to the road"));
        let done: Vec<f32> = (1..=n).map(|step| f32::from(u8::from(step == n))).collect();
        assert_eq!(episode.scalars["next.done"], done);
    }
    let told = [
        (1, 0, [97.0540, 176.5959, 96.2207], [0.5, 0.841_471], [0.2, 0.75], 0.0),
        (1, 7, [99.3626, 179.5035, 98.5293], [-0.2, -0.373_876_7], [0.55, 0.47], 1.75),
        (2, 0, [97.0540, 176.5282, 96.4290], [0.5, 0.909_297_4], [0.2, 0.7], 0.0),
    ];
    for (idx, row, means, action, state, reward) in told {
        let episode: &RawEpisode = &episodes[idx];
        let frame = &episode.frames[row];
        for (found, wanted) in mean(frame).into_iter().zip(means) {
            assert!((found - wanted).abs() < 1e-4, "{found} is not {wanted}");
        }
        assert_eq!(pixel(frame, 42, 10), [102, 204, 102]);
        assert_eq!(pixel(frame, 42, 42), [105, 105, 105]);
        near(&episode.actions[row], &action);
        let scalar = |name: &str| episode.scalars[name][row];
        near(&[scalar("observation.state.0"), scalar("observation.state.1")], &state);
        near(&[scalar("observation.state.x"), scalar("observation.state.y")], &state);
        near(&[scalar("next.reward")], &[reward]);
        near(&[scalar("action.throttle"), scalar("action.1")], &action);
    }
}

#[test]
fn every_picture_of_a_video_is_the_right_one() {
    let video = open("video");
    for camera in ["observation.images.front", "observation.images.top"] {
        // Backwards, so that files are begun in their middle.
        for idx in (0..4).rev() {
            let episode = video.episode(idx, &view(&[camera])).unwrap();
            assert_eq!(episode.frames.len(), video.len(idx));
            for (step, frame) in episode.frames.iter().enumerate() {
                assert_eq!((frame.height(), frame.width()), (84, 84));
                assert_eq!(bar(frame), 2 + 3 * step, "{camera}, episode {idx}, step {step}");
            }
            let task = if idx % 2 == 0 { "drive fast" } else { "drive slowly" };
            assert!(episode.tasks.iter().all(|found| found == task));
        }
    }
}

#[test]
fn colors_of_videos_are_near_lerobots() {
    let video = open("video");
    let (front, top) = ("observation.images.front", "observation.images.top");
    let told = [
        (front, 1, 0, [95.0444, 173.0567, 94.4858], [100, 202, 102], [102, 104, 104]),
        (top, 1, 0, [94.1991, 173.2123, 95.5952], [102, 205, 100], [104, 103, 106]),
        (front, 1, 7, [98.2261, 176.9474, 97.4538], [100, 203, 98], [92, 111, 102]),
        (top, 1, 7, [97.0038, 176.8554, 98.3447], [98, 203, 100], [104, 107, 83]),
        (front, 2, 0, [95.1273, 173.1103, 94.7917], [100, 202, 100], [104, 104, 104]),
        (top, 2, 0, [94.4368, 173.2955, 95.5007], [100, 206, 100], [104, 104, 104]),
        (front, 3, 7, [98.1213, 177.0240, 98.0420], [103, 205, 100], [196, 41, 176]),
        (top, 3, 7, [98.0293, 177.0427, 98.3543], [107, 202, 102], [178, 56, 206]),
    ];
    for (camera, idx, row, means, one, other) in told {
        let episode = video.episode(idx, &view(&[camera])).unwrap();
        let frame = &episode.frames[row];
        for (found, wanted) in mean(frame).into_iter().zip(means) {
            assert!((found - wanted).abs() < MOST_MEAN_OFF, "{camera} {idx} {row}: {found} is not {wanted}");
        }
        for (column, wanted) in [(10, one), (42, other)] {
            let found = pixel(frame, 42, column);
            let is_near = found.iter().zip(wanted).all(|(a, b)| a.abs_diff(b) <= MOST_OFF);
            assert!(is_near, "{camera} {idx} {row}: {found:?} is not {wanted:?}");
        }
    }
    let actions = [
        (1, 0, [0.540_302_3, 0.0, 0.0]),
        (1, 7, [-0.210_795_8, 0.7, 0.75]),
        (3, 7, [0.976_587_7, 0.7, 0.75]),
    ];
    for (idx, row, action) in actions {
        near(&video.rows_of(idx, "action").unwrap()[row], &action);
    }
}

#[test]
fn several_cameras_stand_side_by_side() {
    let video = open("video");
    let both = view(&["observation.images.top", "observation.images.front"]);
    assert_eq!(video.frame_size(&both).unwrap(), [84, 168]);
    let tiled = video.episode(1, &both).unwrap();
    let front = video.episode(1, &view(&["observation.images.front"])).unwrap();
    let top = video.episode(1, &view(&["observation.images.top"])).unwrap();
    for ((tiled, front), top) in tiled.frames.iter().zip(&front.frames).zip(&top.frames) {
        assert_eq!((tiled.height(), tiled.width()), (84, 168));
        for (row, column) in [(0, 0), (42, 10), (83, 83)] {
            assert_eq!(pixel(tiled, row, column), pixel(top, row, column));
            assert_eq!(pixel(tiled, row, 84 + column), pixel(front, row, column));
        }
    }
    assert!(
        video.episode(0, &view(&["front"])).unwrap_err().to_string().contains("observation.images.front")
    );
}

#[test]
fn frames_are_brought_to_size_as_they_come() {
    let video = open("video");
    let train = Some(Size { height: 21, width: 42 });
    let spec = ImageSpec { height: 84, width: 84, train, ..ImageSpec::default() };
    let small = video.framed_episode(2, &View::default(), &spec).unwrap();
    let whole = video.episode(2, &View::default()).unwrap();
    for (small, whole) in small.frames.iter().zip(&whole.frames) {
        assert_eq!(*small, dropj::world::image::framed(&spec, whole));
        assert_eq!((small.height(), small.width()), (21, 42));
    }
}

#[test]
fn ranges_come_from_the_statistics_or_the_rows() {
    let images = open("images");
    let told = images.ranges("action").unwrap();
    near(&told.concat(), &[-0.7, 0.5, -0.996_164_6, 0.991_664_8]);
    let folder = tempfile::tempdir().unwrap();
    copy(&dir("images"), folder.path());
    std::fs::write(folder.path().join("meta/stats.json"), r#"{"action": {"min": [3, 0], "max": [1, 2]}}"#)
        .unwrap();
    let read = LeRobotDataset::open(folder.path()).unwrap().ranges("action").unwrap();
    assert_eq!(read, told, "statistics that cannot be are not believed");
}

/// Copies a folder with all that is in it.
fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let place = to.join(path.file_name().unwrap());
        if path.is_dir() {
            copy(&path, &place);
        } else {
            std::fs::copy(&path, &place).unwrap();
        }
    }
}

/// What the program says and writes, with an empty PATH: without any other program.
fn dropj(args: &[&str]) -> (bool, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_dropj"))
        .env("PATH", "")
        .args(args)
        .output()
        .expect("it can be started");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (output.status.success(), text(output.stdout), text(output.stderr))
}

#[test]
fn a_first_world_is_written_for_a_dataset_and_fits_it() {
    let folder = tempfile::tempdir().unwrap();
    let (out, data) = (folder.path().join("world.toml"), dir("video"));
    let (out, data) = (out.to_str().unwrap(), data.to_str().unwrap());
    let cameras = ["--camera", "observation.images.top", "--camera", "observation.images.front"];
    let args = [["world", "new", "--data", data, "--out", out].as_slice(), &cameras].concat();
    let (is_done, _, errors) = dropj(&args);
    assert!(is_done, "{errors}");
    let spec: WorldSpec = std::fs::read_to_string(out).unwrap().parse().unwrap();
    assert_eq!((spec.name.as_str(), spec.rate, spec.longest_episode), ("video", 15.0, 100));
    assert_eq!((spec.image.height, spec.image.width), (84, 168));
    assert_eq!(spec.image.trained(), Size { height: 64, width: 128 });
    assert_eq!(spec.source.cameras, ["observation.images.top", "observation.images.front"]);
    let axes: Vec<_> = spec.axes.iter().map(|axis| (axis.name.as_str(), axis.low, axis.neutral)).collect();
    assert_eq!(axes, [("steer", -1.0, 0.0), ("gas", 0.0, 0.0), ("brake", 0.0, 0.0)]);
    assert!(spec.axes.iter().all(|axis| axis.low < axis.high && axis.high <= 1.2 && !axis.keys.is_empty()));

    let (fits, told, errors) = dropj(&["world", "check", out, "--data", data]);
    assert!(fits && told.contains("it fits") && told.contains("axis steer"), "{told}{errors}");

    // A narrower axis and another rate.
    let mut narrow = WorldSpec { rate: 50.0, ..spec };
    let axis = &mut narrow.axes[0];
    (axis.low, axis.keys, axis.pad) = (-0.5, vec![], vec![]);
    std::fs::write(out, narrow.to_toml()).unwrap();
    let (fits, told, errors) = dropj(&["world", "check", out, "--data", data]);
    assert!(!fits && errors.contains("does not fit"), "{told}{errors}");
    assert!(told.contains("does not fit: it has 15 rows a second, and the world 50 steps"), "{told}");
    assert!(told.contains("of 42 values out of its range"), "{told}");
}

#[test]
fn a_first_world_has_events_from_columns() {
    let data = dir("images");
    let (is_done, file, errors) = dropj(&["world", "new", "--data", data.to_str().unwrap()]);
    assert!(is_done, "{errors}");
    let spec: WorldSpec = file.parse().unwrap();
    assert!(spec.events.is_empty(), "that an episode ended is none");
    assert!(file.contains("#   field = \"observation.state.x\"  # 0.2 to"), "{file}");
    assert!(file.contains("cameras = [\"observation.image\"]"), "{file}");
    assert_eq!(spec.image.train, None);
}

#[test]
fn a_video_of_another_kind_is_told_where_there_is_no_ffmpeg() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("set");
    copy(&dir("video"), &data);
    let video = data.join("videos/observation.images.front/chunk-000/file-000.mp4");
    let mut bytes = std::fs::read(&video).unwrap();
    let at = bytes.windows(10).position(|bytes| bytes == b"av01\0\0\0\0\0\0").unwrap();
    bytes[at..at + 4].copy_from_slice(b"hvc1");
    std::fs::write(&video, bytes).unwrap();
    let out = folder.path().join("world.toml");
    let (data, out) = (data.to_str().unwrap(), out.to_str().unwrap());
    assert!(dropj(&["world", "new", "--data", data, "--out", out]).0, "no picture is needed for it");
    let (fits, _, errors) = dropj(&["world", "check", out, "--data", data]);
    assert!(!fits && errors.contains("HEVC (H.265)") && errors.contains("apt install ffmpeg"), "{errors}");
}

#[test]
fn videos_of_other_kinds_are_read_where_ffmpeg_is_installed() {
    let kinds: [&[&str]; 3] = [
        &["libx264", "-bf", "2", "-crf", "10"],
        &["libx265", "-x265-params", "log-level=none", "-crf", "10"],
        // With ten bits a color, which the decoder of AV1 leaves to it.
        &["libsvtav1", "-crf", "20", "-pix_fmt", "yuv420p10le"],
    ];
    let name = "videos/observation.images.front/chunk-000/file-000.mp4";
    for kind in kinds {
        let folder = tempfile::tempdir().unwrap();
        copy(&dir("video"), folder.path());
        let mut command = Command::new("ffmpeg");
        command.args(["-v", "error", "-y", "-i"]).arg(dir("video").join(name)).arg("-c:v").args(kind);
        let made = command.arg(folder.path().join(name)).output();
        if !made.is_ok_and(|made| made.status.success()) {
            eprintln!("skipped: there is no ffmpeg here that writes {}", kind[0]);
            continue;
        }
        let dataset = LeRobotDataset::open(folder.path()).unwrap();
        for idx in [2, 0, 1] {
            let episode = dataset.episode(idx, &view(&["observation.images.front"])).unwrap();
            for (step, frame) in episode.frames.iter().enumerate() {
                assert_eq!(bar(frame), 2 + 3 * step, "{}, episode {idx}, step {step}", kind[0]);
            }
        }
    }
}
