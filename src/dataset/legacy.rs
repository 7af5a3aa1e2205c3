//! What versions of before wrote, as this one reads it. They knew the built-in cars and no other world.

use std::sync::LazyLock;

use super::journal::{Row, Take, floats};
use super::layout::{Layout, column};
use super::notes::Notes;
use crate::world::{Action, WorldSpec};

/// What journals began with that knew neither a car's state nor why an episode ended.
pub(super) const FIRST_MAGIC: &[u8; 16] = b"dropj journal 1\n";
/// What they began with before they knew other worlds.
pub(super) const SECOND_MAGIC: &[u8; 16] = b"dropj journal 2\n";

/// The format of the notes that first told why an episode ended.
const FORMAT_OF_ENDS: u32 = 2;
/// That of the notes that first told other worlds.
const FORMAT_OF_WORLDS: u32 = 3;
/// An episode that the world ended, and that has so many steps, was out of time.
const MAX_STEPS: usize = 1000;
/// What was recorded in every world.
const GRASS: &str = "grass";
/// What was recorded in worlds with obstacles, whether there were any of the kind or not.
const OBSTACLES: [&str; 2] = ["chuckhole", "car"];
/// The world with obstacles that has no car among them.
const WITHOUT_CARS: &str = "obstacle-car-racing-chuckholes";
/// Numbers of an action.
const N_AXES: usize = 3;

/// What every recording was of, without obstacles.
static CAR: LazyLock<Layout> = LazyLock::new(|| {
    let spec = WorldSpec::built_in("car-racing").unwrap_or_else(|| unreachable!("it is built in"));
    Layout { events: vec![GRASS.to_owned()], ..Layout::of(&spec, &[]) }
});

/// The layout of recordings with obstacles or without.
pub(super) fn layout(has_obstacles: bool) -> Layout {
    let mut layout = CAR.clone();
    if has_obstacles {
        layout.events.extend(OBSTACLES.map(str::to_owned));
    }
    layout
}

/// Whether an event was recorded of a world in which it cannot happen. Of any step there it is true that it does not go on.
pub(super) fn never_happens(event: &str, env: &str) -> bool {
    env == WITHOUT_CARS && event == OBSTACLES[1]
}

/// Fills in what the notes of older formats do not tell.
pub(super) fn complete(notes: &mut Notes) {
    if notes.format < FORMAT_OF_WORLDS {
        let has_obstacles = OBSTACLES.iter().any(|event| notes.stats.contains_key(&column(event)));
        Layout { axes: notes.axes, events: notes.events, rate: notes.rate, .. } = layout(has_obstacles);
        (notes.height, notes.width) = (notes.side, notes.side);
    }
    notes.truncated |= notes.format < FORMAT_OF_ENDS && is_out_of_time(notes.done, notes.n_steps);
}

/// Whether an episode ended because its time was up, where nobody said so.
pub(super) fn is_out_of_time(done: bool, n_steps: usize) -> bool {
    done && n_steps >= MAX_STEPS
}

/// The next step of an older journal, whose first one tells whether there are obstacles.
///
/// ```text
/// 'S', wall clock i64, steer, gas, brake and reward f32, touched u8, f32 for each of the state, PNG
/// ```
///
/// The bits of what was touched, from the lowest: grass, chuckhole, car, whether the world has the latter two, whether the
/// planner drove.
pub(super) fn row(payload: &[u8], take: &mut Take) -> Option<Row> {
    const HAS_OBSTACLES: u8 = 3;
    let rest = payload.strip_prefix(b"S")?;
    let (wall_time_ns, rest) = rest.split_first_chunk()?;
    let (numbers, rest) = rest.split_at_checked(4 * (N_AXES + 1))?;
    let (&touched, rest) = rest.split_first()?;
    let (state, png) = rest.split_at_checked(4 * take.layout.sensors.len())?;
    let is = |bit: u8| touched >> bit & 1 != 0;
    let numbers = floats(numbers);
    let (action, reward) = numbers.split_at(N_AXES);
    let row = Row {
        png: png.to_vec(),
        action: Action::new(action),
        reward: reward[0],
        events: if is(HAS_OBSTACLES) { vec![is(0), is(1), is(2)] } else { vec![is(0)] },
        wall_time_ns: i64::from_le_bytes(*wall_time_ns),
        planned: is(4),
        state: floats(state),
    };
    if take.rows.is_empty() {
        take.layout.events = layout(is(HAS_OBSTACLES)).events;
    }
    (row.is_finite() && row.events.len() == take.layout.events.len()).then_some(row)
}
