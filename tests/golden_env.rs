//! Whole episodes equal those recorded in the authors' Python environments under gym 0.20.
//!
//! The files hold the columns of `trace::COLUMNS`, a line a step. With glibc's sines all of it is equal to the last
//! bit; with the portable ones of the product, poses drift apart by and by.

use dropj::world::cars::trace::{COLUMNS, Row, Traced, trace};
use dropj::world::cars::trig::Trig;
use dropj::world::cars::{Aids, CarRacing, Env as _, ObstacleCarRacing, Obstacles, Seed};

const PLAIN: &str = include_str!("golden/env_plain_seed0.csv");
const CHUCKHOLES: &str = include_str!("golden/env_chuckholes_seed1.csv");
const CARS: &str = include_str!("golden/env_cars_seed0.csv");

fn gym(n: u64) -> Seed {
    Seed::Gym { env: n, python: n }
}

fn plain(trig: Trig) -> CarRacing {
    CarRacing::with_trig(gym(0), trig)
}

fn chuckholes(trig: Trig) -> ObstacleCarRacing {
    ObstacleCarRacing::with_trig(gym(1), Obstacles::Chuckholes, Aids::ALL, trig)
}

fn cars(trig: Trig) -> ObstacleCarRacing {
    ObstacleCarRacing::with_trig(gym(0), Obstacles::ChuckholesAndCars, Aids::ALL, trig)
}

fn table(csv: &str) -> Vec<Vec<f64>> {
    csv.lines().map(|line| line.split(',').map(|field| field.parse().expect("a number")).collect()).collect()
}

fn actions(table: &[Vec<f64>]) -> Vec<[f64; 3]> {
    table.iter().map(|row| [row[0], row[1], row[2]]).collect()
}

/// Drives `env` by the recorded actions; returns its rows beside the recorded ones.
fn drive(env: &mut dyn Traced, seed: Seed, csv: &str) -> Vec<(Vec<f64>, Vec<f64>)> {
    let recorded = table(csv);
    let rows = trace(env, seed, &actions(&recorded), |_, _| {});
    assert_eq!(rows.len(), recorded.len(), "the episode is as long as the recorded one");
    rows.iter().map(Row::values).zip(recorded).collect()
}

#[cfg(all(target_os = "linux", target_env = "gnu", target_arch = "x86_64"))]
fn assert_equal(env: &mut dyn Traced, seed: Seed, csv: &str) {
    for (step, (ours, recorded)) in drive(env, seed, csv).iter().enumerate() {
        assert_eq!(ours.len(), recorded.len(), "step {step} has all columns");
        for (column, (a, b)) in ours.iter().zip(recorded).enumerate() {
            let (car, name) = match column.checked_sub(12) {
                Some(place) => (place / 6, COLUMNS[12 + place % 6]),
                None => (0, COLUMNS[column]),
            };
            assert!(a == b, "step {step}, {name} of car {car}: {a} is not {b}");
        }
    }
}

#[test]
#[cfg(all(target_os = "linux", target_env = "gnu", target_arch = "x86_64"))]
fn an_episode_of_car_racing_equals_the_recorded_one_to_the_last_bit() {
    assert_equal(&mut plain(Trig::System), gym(0), PLAIN);
}

#[test]
#[cfg(all(target_os = "linux", target_env = "gnu", target_arch = "x86_64"))]
fn an_episode_with_chuckholes_equals_the_recorded_one_to_the_last_bit() {
    assert_equal(&mut chuckholes(Trig::System), gym(1), CHUCKHOLES);
}

#[test]
#[cfg(all(target_os = "linux", target_env = "gnu", target_arch = "x86_64"))]
fn an_episode_with_cars_equals_the_recorded_one_to_the_last_bit() {
    assert_equal(&mut cars(Trig::System), gym(0), CARS);
}

#[test]
fn a_portable_episode_of_car_racing_stays_near_the_recorded_one() {
    let mut env = plain(Trig::Portable);
    let mut worst = 0.0_f64;
    for (ours, recorded) in drive(&mut env, gym(0), PLAIN) {
        worst = worst.max((ours[12] - recorded[12]).abs()).max((ours[13] - recorded[13]).abs());
    }
    // Sines that differ in the last bit grow to about 2e-4 units over this episode.
    assert!(worst < 1e-2, "the hull is {worst} units away");
}

/// How many pixels of `ours` differ from a recorded picture.
fn different_pixels(ours: &[u8], name: &str) -> usize {
    let path = format!("{}/tests/golden/{name}.png", env!("CARGO_MANIFEST_DIR"));
    let recorded = image::open(path).expect("a recorded picture").to_rgb8();
    assert_eq!(ours.len(), recorded.as_raw().len(), "{name} has our size");
    // Of the 96 rows of Car Racing the last twelve are the bar with the score, whose digits have another font with us.
    let n = if ours.len() == 96 * 96 * 3 { 84 * 96 } else { ours.len() / 3 };
    ours.chunks(3).zip(recorded.as_raw().chunks(3)).take(n).filter(|(a, b)| a != b).count()
}

/// Drives `env` by the recorded actions and counts different pixels in each recorded picture.
fn assert_pictures(
    env: &mut dyn Traced,
    seed: Seed,
    csv: &str,
    name: &str,
    steps: &[usize],
    tolerance: usize,
) {
    trace(env, seed, &actions(&table(csv)), |step, env| {
        if steps.contains(&step) {
            let different = different_pixels(&env.raw_image(), &format!("{name}_step{step}"));
            assert!(different <= tolerance, "{different} pixels of {name}, step {step} differ");
        }
    });
}

#[test]
#[cfg(all(target_os = "linux", target_env = "gnu", target_arch = "x86_64"))]
fn pictures_equal_the_recorded_ones() {
    // Mesa fills triangles, we fill polygons: now and then a pixel center lies on an edge of both.
    let steps = [0, 1, 10, 30, 60, 150, 250, 260];
    assert_pictures(&mut plain(Trig::System), gym(0), PLAIN, "frame_plain_0", &steps[..7], 2);
    assert_pictures(&mut chuckholes(Trig::System), gym(1), CHUCKHOLES, "frame_chuck_1", &[60, 150], 2);
    assert_pictures(&mut cars(Trig::System), gym(0), CARS, "frame_cars_0", &[0, 10, 60, 150, 260], 2);
}

#[test]
#[cfg(all(target_os = "linux", target_env = "gnu", target_arch = "x86_64"))]
fn frames_are_processed_as_the_recorded_ones() {
    let mut env = plain(Trig::System);
    trace(&mut env, gym(0), &actions(&table(PLAIN)), |step, env| {
        if [0, 10, 150].contains(&step) {
            let different = different_pixels(env.frame().rgb(), &format!("processed84_plain_0_step{step}"));
            assert!(different == 0, "{different} pixels of step {step} differ");
        }
    });
}

#[test]
fn the_same_seed_and_actions_give_the_same_episode() {
    let drive = |mut env: CarRacing| {
        env.reset(Seed::Native(7));
        (0..100).map(|i| (env.advance([0.1, 0.3, 0.0].into()), env.truth(), i)).collect::<Vec<_>>()
    };
    assert_eq!(drive(CarRacing::new(Seed::Native(7))), drive(CarRacing::new(Seed::Native(8))));
}

#[test]
fn an_episode_ends_after_a_thousand_actions() {
    let mut env = CarRacing::new(Seed::Native(1));
    let ends: Vec<_> = (0..1000).map(|_| env.advance([0.0, 0.0, 0.0].into()).end).collect();
    assert_eq!(ends.iter().position(Option::is_some), Some(999));
}

#[test]
fn leaving_the_field_ends_the_episode_at_a_loss() {
    let mut env = CarRacing::new(Seed::Native(1));
    let last =
        (0..1000).map(|_| env.advance([0.0, 0.3, 0.0].into())).find(|outcome| outcome.end.is_some()).unwrap();
    assert_eq!((last.reward, last.events.grass), (-1.0, true));
    assert_eq!(last.end, Some(dropj::world::End::Terminated));
}
