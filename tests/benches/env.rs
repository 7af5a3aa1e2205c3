//! How fast the simulator is: a step alone, and with the picture that vision is given. At least 5 000 a second are wanted.

use divan::Bencher;
use divan::counter::ItemsCount;
use dropj::world::cars::{Aids, CarAction, CarRacing, Env, ObstacleCarRacing, Obstacles, Seed};

/// Steps in a sample.
const N_STEPS: usize = 500;

fn main() {
    divan::main();
}

fn car_racing() -> Box<dyn Env> {
    Box::new(CarRacing::new(Seed::Native(0)))
}

fn obstacle_car_racing() -> Box<dyn Env> {
    Box::new(ObstacleCarRacing::new(Seed::Native(0), Obstacles::ChuckholesAndCars, Aids::NONE))
}

/// Drives on from wherever the last sample ended, anew where an episode does.
fn steps(bencher: Bencher<'_, '_>, open: fn() -> Box<dyn Env>, has_picture: bool) {
    let (mut env, mut track) = (open(), 0);
    bencher.counter(ItemsCount::new(N_STEPS)).bench_local(|| {
        for i in 0..N_STEPS {
            let outcome = env.advance(CarAction::new((i as f32 / 40.0).sin(), 0.1, 0.0));
            if has_picture {
                divan::black_box(env.frame());
            }
            if outcome.end.is_some() {
                track += 1;
                env.reset(Seed::Native(track));
            }
        }
    });
}

#[divan::bench(sample_count = 20)]
fn car_racing_step(bencher: Bencher<'_, '_>) {
    steps(bencher, car_racing, false);
}

#[divan::bench(sample_count = 20)]
fn car_racing_step_with_picture(bencher: Bencher<'_, '_>) {
    steps(bencher, car_racing, true);
}

#[divan::bench(sample_count = 20)]
fn obstacle_car_racing_step(bencher: Bencher<'_, '_>) {
    steps(bencher, obstacle_car_racing, false);
}

#[divan::bench(sample_count = 20)]
fn obstacle_car_racing_step_with_picture(bencher: Bencher<'_, '_>) {
    steps(bencher, obstacle_car_racing, true);
}
