//! What the scripted pilot records: mostly the road, enough of the grass, never far from either.

use dropj::world::End;
use dropj::world::cars::CarAction;
use dropj::world::cars::pilot::{PilotStyle, ScriptedPilot};
use dropj::world::cars::{Aids, CarRacing, Env as _, ObstacleCarRacing, Obstacles, Seed, Truth};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

/// One step: what was done, and what the simulator knew afterwards.
type Step = (CarAction, Truth);

/// An episode of a pilot, and how it ended.
fn drive(seed: u64, pilot: impl Fn(&mut ChaCha8Rng) -> ScriptedPilot) -> (Vec<Step>, End) {
    let rng = &mut ChaCha8Rng::seed_from_u64(seed);
    let mut pilot = pilot(rng);
    let mut env = CarRacing::new(Seed::Native(seed));
    let mut steps = Vec::new();
    loop {
        let action = pilot.act(&env.truth(), rng);
        let outcome = env.advance(action);
        steps.push((action, env.truth()));
        if let Some(end) = outcome.end {
            return (steps, end);
        }
    }
}

fn share(steps: &[Step], of: impl Fn(&Step) -> bool) -> f64 {
    steps.iter().filter(|step| of(step)).count() as f64 / steps.len() as f64
}

#[test]
fn varied_pilots_show_the_road_the_grass_and_every_speed() {
    let episodes: Vec<_> = (0..24).map(|seed| drive(seed, ScriptedPilot::drawn)).collect();

    let n_out = episodes.iter().filter(|(_, end)| *end == End::Terminated).count();
    let n_visited = |steps: &[Step]| steps.last().map_or(0, |(_, truth)| truth.n_visited);
    let mean_visited = episodes.iter().map(|(steps, _)| n_visited(steps)).sum::<usize>() / episodes.len();
    let steps: Vec<Step> = episodes.into_iter().flat_map(|(steps, _)| steps).collect();

    assert_eq!(n_out, 0, "episodes that left the field");
    assert!(mean_visited > 100, "{mean_visited} tiles an episode");
    let off_road = share(&steps, |(_, truth)| truth.wheels_off > 0);
    assert!((0.10..0.25).contains(&off_road), "{off_road} of the steps are off the road");
    for slowest in [0.0, 10.0, 20.0, 30.0, 40.0] {
        let at_speed = share(&steps, |(_, truth)| (slowest..slowest + 10.0).contains(&truth.speed));
        assert!(at_speed > 0.02, "{at_speed} of the steps are at {slowest} to {} u/s", slowest + 10.0);
    }
    let full = share(&steps, |(action, _)| action.gas == 1.0 || action.brake == 0.8);
    let menu = share(&steps, |(action, _)| [0.1, 0.2].contains(&action.gas));
    let locked = share(&steps, |(action, _)| action.steer.abs() == 1.0);
    assert!(full > 0.03 && menu > 0.1 && locked > 0.1, "keys {full}, menu {menu}, full steering {locked}");
}

#[test]
fn a_pilot_without_excursions_stays_on_the_road() {
    let careful = PilotStyle { excursions: 0.0, menu: 0.0, speeds: [15.0, 30.0], ..PilotStyle::varied() };

    let steps: Vec<Step> = (0..8).flat_map(|seed| drive(seed, |_| ScriptedPilot::new(careful)).0).collect();

    let off_road = share(&steps, |(_, truth)| truth.wheels_off > 0);
    assert!(off_road < 0.05, "{off_road} of the steps are off the road");
}

#[test]
fn the_same_seed_drives_the_same_way() {
    let actions = |seed| drive(seed, ScriptedPilot::drawn).0.into_iter().map(|(a, _)| a).collect::<Vec<_>>();

    assert_eq!(actions(3), actions(3));
}

#[test]
fn a_pilot_passes_most_obstacles_and_meets_some() {
    let (mut chuckholes, mut cars, mut n_visited) = ([0; 2], [0; 2], 0);
    for seed in 0..12 {
        let rng = &mut ChaCha8Rng::seed_from_u64(seed);
        let mut pilot = ScriptedPilot::drawn(rng);
        let seed = Seed::Native(seed);
        let mut env = ObstacleCarRacing::new(seed, Obstacles::ChuckholesAndCars, Aids::NONE);
        let mut end = None;
        while end.is_none() {
            let outcome = env.advance(pilot.act(&env.truth(), rng));
            let events = outcome.events;
            chuckholes[0] += usize::from(events.chuckhole);
            chuckholes[1] += usize::from(events.chuckhole_passed);
            cars[0] += usize::from(events.car);
            cars[1] += usize::from(events.car_passed);
            end = outcome.end;
        }
        assert_eq!(end, Some(End::Truncated), "nobody leaves the field");
        n_visited += env.truth().n_visited;
    }
    let rate = |[met, passed]: [usize; 2]| met as f64 / passed as f64;
    assert!((0.15..0.6).contains(&rate(chuckholes)), "{chuckholes:?} chuckholes touched and passed");
    assert!((0.1..0.6).contains(&rate(cars)), "{cars:?} cars hit and passed");
    assert!(n_visited > 12 * 80, "{n_visited} tiles in all");
}
