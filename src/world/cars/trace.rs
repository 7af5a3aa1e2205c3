//! Episodes as tables, to compare with recorded runs of the Python environments.

use super::{End, Env, Events, Outcome, Seed};

/// The columns of a [`Row`]. Those from `x` on repeat for every car.
pub const COLUMNS: [&str; 18] = [
    "a0",
    "a1",
    "a2",
    "reward",
    "done",
    "crash",
    "succ",
    "chuck",
    "chuck_passed",
    "car",
    "car_passed",
    "score",
    "x",
    "y",
    "angle",
    "vx",
    "vy",
    "w",
];

/// An environment that can be driven and looked at in full.
pub trait Traced: Env {
    /// [`Env::advance`] in double precision: steer, gas, brake.
    fn advance_by(&mut self, action: [f64; 3]) -> Outcome;
    /// The score that gym shows.
    fn score(&self) -> f64;
    /// x, y, angle, vx, vy and turn rate of every hull.
    fn car_states(&self) -> Vec<[f32; 6]>;
    /// The state image before processing, square RGB.
    fn raw_image(&self) -> Vec<u8>;
}

/// A step of a traced episode.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Steer, gas, brake.
    pub action: [f64; 3],
    /// What the step brought.
    pub outcome: Outcome,
    /// The score that gym shows.
    pub score: f64,
    /// x, y, angle, vx, vy and turn rate of every hull.
    pub cars: Vec<[f32; 6]>,
}

impl Row {
    /// The numbers of the row in the order of [`COLUMNS`].
    pub fn values(&self) -> Vec<f64> {
        let Events { new_tile, grass, chuckhole, chuckhole_passed, car, car_passed } = self.outcome.events;
        let mut values = self.action.to_vec();
        values.push(f64::from(self.outcome.reward));
        // The recorded runs have no time limit: only leaving the field is "done".
        values.push(f64::from(u8::from(self.outcome.end == Some(End::Terminated))));
        let flags = [grass, new_tile, chuckhole, chuckhole_passed, car, car_passed];
        values.extend(flags.map(|flag| f64::from(u8::from(flag))));
        values.push(self.score);
        values.extend(self.cars.iter().flatten().map(|&x| f64::from(x)));
        values
    }

    /// The row as a line of comma-separated values, without a line break.
    pub fn to_csv(&self) -> String {
        self.values().iter().map(|value| format!("{value:?}")).collect::<Vec<_>>().join(",")
    }
}

/// Drives `env` by `actions` (steer, gas, brake) from a reset to the end of the episode or of the actions.
///
/// `look` sees the environment after the reset (step 0) and after each step, for instance to keep its pictures.
pub fn trace<E: Traced + ?Sized>(
    env: &mut E,
    seed: Seed,
    actions: &[[f64; 3]],
    mut look: impl FnMut(usize, &E),
) -> Vec<Row> {
    env.reset(seed);
    look(0, env);
    let mut rows = Vec::with_capacity(actions.len());
    for (i, &action) in actions.iter().enumerate() {
        let outcome = env.advance_by(action);
        rows.push(Row { action, outcome, score: env.score(), cars: env.car_states() });
        look(i + 1, env);
        if outcome.end.is_some() {
            break;
        }
    }
    rows
}
