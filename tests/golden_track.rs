//! Random streams, tracks and frame processing against gym 0.20, gymnasium, Python and Pillow.
//!
//! The files in `tests/golden` were written by, or checked equal to, those programs.

#![expect(clippy::unwrap_used, reason = "a file that cannot be read fails the test")]

use std::fs;
use std::path::{Path, PathBuf};

use dropj::world::cars::Seed;
use dropj::world::cars::process::process;
use dropj::world::cars::random::{ChoiceStream, UniformStream};
use dropj::world::cars::track::Track;

fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name)
}

/// The rows of a CSV file without its heading.
fn rows(name: &str) -> Vec<Vec<String>> {
    let text = fs::read_to_string(golden(name)).unwrap();
    text.lines().skip(1).map(|line| line.split(',').map(str::to_owned).collect()).collect()
}

/// The seed kind that a golden file calls by the name of its generator.
fn seed(stream: &str, n: u64) -> Seed {
    match stream {
        "numpy_pcg64" => Seed::Gymnasium(n),
        "gym020_mt19937" => Seed::Gym { env: n, python: 0 },
        "cpython_below298" => Seed::Gym { env: 0, python: n },
        _ => panic!("no stream is called {stream:?}"),
    }
}

fn pixels(name: &str) -> Vec<u8> {
    image::open(golden(name)).unwrap().into_rgb8().into_raw()
}

#[test]
fn every_stream_draws_what_its_python_counterpart_draws() {
    let rows = rows("rng.csv");
    for draws in rows.chunk_by(|a, b| a[..2] == b[..2]) {
        let (stream, n) = (draws[0][0].as_str(), draws[0][1].parse().unwrap());
        let mut uniform = UniformStream::track(seed(stream, n));
        let mut choice = ChoiceStream::obstacles(seed(stream, n));
        for draw in draws {
            let value = match stream {
                "cpython_below298" => f64::from(choice.below(298)),
                _ => uniform.uniform(0.0, 1.0),
            };
            assert_eq!(value, draw[3].parse::<f64>().unwrap(), "{draw:?}");
        }
    }
}

#[test]
fn tracks_are_those_of_gym_and_gymnasium() {
    for row in rows("tracks.csv") {
        let number = |i: usize| row[i].parse::<f64>().unwrap();

        let track = Track::generate(&mut UniformStream::track(seed(&row[0], row[1].parse().unwrap())));

        let n_kerbs = track.kerbs.iter().filter(|&&kerb| kerb).count();
        assert_eq!(f64::from(track.attempts), number(2), "attempts of {row:?}");
        assert_eq!(track.nodes.len() as f64, number(3), "tiles of {row:?}");
        assert_eq!(n_kerbs as f64, number(4), "kerbs of {row:?}");
        let [first, last] = [track.nodes[0], track.nodes[track.nodes.len() - 1]];
        let sum = |of: fn(&dropj::world::cars::track::Node) -> f64| track.nodes.iter().map(of).sum::<f64>();
        let values = [first.alpha, first.beta, first.x, first.y, last.alpha, last.beta, last.x, last.y];
        // The sine of glibc and of libm differ in the last bit now and then, and the walk carries that on.
        for (i, value) in values.into_iter().enumerate() {
            assert!((value - number(5 + i)).abs() < 1e-8, "{value} in column {} of {row:?}", 5 + i);
        }
        assert!((sum(|node| node.x) - number(13)).abs() < 1e-6, "sum of x of {row:?}");
        assert!((sum(|node| node.y) - number(14)).abs() < 1e-6, "sum of y of {row:?}");
    }
}

#[test]
fn a_native_seed_decides_the_track() {
    let track = |n| Track::generate(&mut UniformStream::track(Seed::Native(n)));

    assert_eq!(track(5), track(5));
    assert_ne!(track(5), track(6));
}

#[test]
fn frames_are_processed_as_pillow_does_bit_for_bit() {
    for step in [0, 10, 150] {
        let raw = pixels(&format!("frame_plain_0_step{step}.png"));

        let frame = process(&raw);

        assert_eq!(frame.rgb(), pixels(&format!("processed84_plain_0_step{step}.png")), "step {step}");
    }
}
