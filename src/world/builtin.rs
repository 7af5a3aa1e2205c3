//! The worlds that this program brings along, as their files say them.

use std::path::Path;

use super::WorldSpec;

/// The names of the built-in worlds.
pub const NAMES: [&str; 3] = ["car-racing", "obstacle-car-racing", "obstacle-car-racing-chuckholes"];

/// Their files, in the order of [`NAMES`].
const FILES: [&str; 3] = [
    include_str!("../../assets/worlds/car-racing.toml"),
    include_str!("../../assets/worlds/obstacle-car-racing.toml"),
    include_str!("../../assets/worlds/obstacle-car-racing-chuckholes.toml"),
];

/// One of the worlds that this program brings along.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BuiltIn {
    name: &'static str,
    file: &'static str,
}

impl BuiltIn {
    /// All of them, in the order of [`NAMES`].
    pub fn all() -> impl Iterator<Item = Self> {
        NAMES.into_iter().zip(FILES).map(|(name, file)| Self { name, file })
    }

    /// The one of this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::all().find(|world| world.name == name)
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        self.name
    }

    /// Its file.
    pub fn file(self) -> &'static str {
        self.file
    }

    /// What its file says.
    ///
    /// # Panics
    /// Never: the files are right.
    pub fn spec(self) -> WorldSpec {
        WorldSpec::from_toml(self.file, Path::new(self.name)).unwrap_or_else(|met| unreachable!("{met}"))
    }
}

/// How hard the authors' candidates brake in a world of the paper, in `[0, 1]` (method §11.4). None in any other.
pub fn authors_brake(name: &str) -> Option<f32> {
    let brakes = [0.2, 0.05, 0.1];
    NAMES.iter().position(|it| *it == name).map(|i| brakes[i])
}

/// The folder below `sessions/` of the example session of a world that this program brings along, where there is one.
pub fn example_of(name: &str) -> Option<&'static str> {
    let examples = [Some("example"), None, Some("example-obstacles")];
    NAMES.iter().position(|it| *it == name).and_then(|i| examples[i])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::cars::controls::{ControlConfig, DrivingKey, HeldKeys};
    use crate::world::cars::{
        Aids, CarAction, CarRacing, Env, Events, MAX_STEPS, ObstacleCarRacing, Obstacles, RANGES,
        STEPS_PER_SEC, Seed,
    };
    use crate::world::spec::{Release, SourceKind};

    fn env_of(world: BuiltIn) -> Box<dyn Env> {
        let seed = Seed::Native(0);
        match world.name {
            "car-racing" => Box::new(CarRacing::new(seed)),
            "obstacle-car-racing" => {
                Box::new(ObstacleCarRacing::new(seed, Obstacles::ChuckholesAndCars, Aids::NONE))
            }
            _ => Box::new(ObstacleCarRacing::new(seed, Obstacles::Chuckholes, Aids::NONE)),
        }
    }

    #[test]
    fn built_in_worlds_are_as_the_code_has_them() {
        for world in BuiltIn::all() {
            let spec = world.spec();
            assert_eq!((spec.name.as_str(), spec.source.world.as_deref()), (world.name, Some(world.name)));
            assert_eq!(spec.source.kind, SourceKind::BuiltIn);
            assert_eq!((spec.rate, spec.longest_episode), (f64::from(STEPS_PER_SEC), MAX_STEPS));
            assert_eq!(env_of(world).frame().size(), spec.image.trained(), "{}", world.name);
        }
    }

    #[test]
    fn built_in_axes_are_clipped_and_driven_as_the_code_does() {
        let axes = WorldSpec::built_in("car-racing").unwrap().axes;
        assert_eq!(axes.len(), CarAction::LEN);
        let lows: Vec<f32> = axes.iter().map(|axis| axis.low).collect();
        let highs: Vec<f32> = axes.iter().map(|axis| axis.high).collect();
        assert_eq!(lows, CarAction::new(-9.0, -9.0, -9.0).to_array());
        assert_eq!(highs, CarAction::new(9.0, 9.0, 9.0).to_array());
        assert_eq!(
            RANGES.concat(),
            lows.iter().zip(&highs).flat_map(|(low, high)| [*low, *high]).collect::<Vec<_>>()
        );
        let keys = [
            (DrivingKey::Left, "Left", "A"),
            (DrivingKey::Right, "Right", "D"),
            (DrivingKey::Up, "Up", "W"),
            (DrivingKey::Down, "Down", "S"),
        ];
        for (key, arrow, letter) in keys {
            let mut held = HeldKeys::default();
            held.set(key, true);
            let action = held.action(&ControlConfig::paper()).to_array();
            for name in [arrow, letter] {
                let to = |axis: &crate::world::Axis| {
                    axis.keys.iter().find(|input| input.key == name).map_or(axis.neutral, |input| input.to)
                };
                assert_eq!(axes.iter().map(to).collect::<Vec<_>>(), action, "{name}");
            }
        }
        for axis in &axes {
            assert_eq!((axis.neutral, axis.key_speed, axis.release), (0.0, None, Release::Spring));
        }
        assert!(BuiltIn::all().all(|world| world.spec().axes == axes));
    }

    #[test]
    fn built_in_events_are_those_of_the_code() {
        // A flag that is added there has to be named here.
        let Events { new_tile: _, grass: _, chuckhole: _, chuckhole_passed: _, car: _, car_passed: _ } =
            Events::default();
        let fields = |name: &str| WorldSpec::built_in(name).unwrap().fields();
        assert_eq!(fields("car-racing"), ["grass", "new_tile"]);
        assert_eq!(
            fields("obstacle-car-racing"),
            ["car", "car_passed", "chuckhole", "chuckhole_passed", "grass", "new_tile"]
        );
        assert_eq!(
            fields("obstacle-car-racing-chuckholes"),
            ["chuckhole", "chuckhole_passed", "grass", "new_tile"]
        );
    }
}
