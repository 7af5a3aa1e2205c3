//! A scripted pilot that drives by what the simulator knows, to record what the world model learns from.
//!
//! It stands in for the people who recorded the 600 episodes of the paper: mostly safe driving, at many speeds and on
//! many lines, but also the grass, spins, stops and ways back, without which a dream would not know them.

mod actuation;
mod obstacle_policy;

use std::f32::consts::PI;

use rand::{Rng, RngExt as _};

use self::actuation::{Actuator, InputKind, LOCK, Setpoint};
use self::obstacle_policy::{HALF_ROAD, ObstaclePolicy};
use super::{CarAction, STEPS_PER_SEC, Truth};

/// Distance between the axles in units.
const WHEELBASE: f32 = 3.24;
/// Units from node to node.
const NODE_STEP: f32 = 3.5;
/// Beyond this coordinate in units the pilot heads back. The field ends at 333.
const FIELD_MARGIN: f32 = 285.0;

/// How somebody drives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PilotStyle {
    /// Share of stretches that leave the road on purpose, in `[0, 1]`.
    pub excursions: f64,
    /// Share of stretches that stand or brake sharply, in `[0, 1]`.
    pub pauses: f64,
    /// Share of stretches driven by keys, in `[0, 1]`.
    pub keys: f64,
    /// Share of stretches driven by the planner's menu, in `[0, 1]`. What is left is driven by stick.
    pub menu: f64,
    /// The slowest and the fastest speed aimed at, in units a second.
    pub speeds: [f32; 2],
    /// What sideways acceleration is dared in a bend, in units per square second.
    pub daring: f32,
    /// The fastest speed aimed at off the road, in units a second.
    pub off_road_speed: f32,
}

impl PilotStyle {
    /// A bit of everything, in the shares that the recordings aim at.
    pub fn varied() -> Self {
        let (speeds, off_road_speed) = ([10.0, 60.0], 45.0);
        Self { excursions: 0.12, pauses: 0.06, keys: 0.5, menu: 0.25, speeds, daring: 120.0, off_road_speed }
    }
}

/// What a stretch is about.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Intent {
    /// Along the road or beside it, `line` units right of its center.
    Follow { speed: f32, line: f32 },
    /// Along the road, over the inside of every bend.
    Cut { speed: f32, inside: f32 },
    /// Away from the road at an angle in radians, positive left, as far as `reach` units.
    Across { speed: f32, angle: f32, reach: f32 },
    /// Round and round, to the side of the sign.
    Spin { side: f32, throttle: f32 },
    /// Brake, then stand.
    Stop { brake: f32 },
}

/// A pilot in the middle of a stretch.
#[derive(Clone, Debug)]
pub struct ScriptedPilot {
    style: PilotStyle,
    intent: Intent,
    actuator: Option<Actuator>,
    /// Steps until the next stretch.
    steps_left: u32,
    /// Whether this stretch leaves the road on purpose.
    is_excursion: bool,
    /// What it makes of the next chuckhole and of the next car.
    policies: [Option<ObstaclePolicy>; 2],
}

impl ScriptedPilot {
    /// A pilot of this style.
    pub fn new(style: PilotStyle) -> Self {
        Self {
            style,
            intent: Intent::Stop { brake: 0.0 },
            actuator: None,
            steps_left: 0,
            is_excursion: false,
            policies: [None; 2],
        }
    }

    /// A pilot of a random style: some careful, some wild.
    pub fn drawn(rng: &mut impl Rng) -> Self {
        let varied = PilotStyle::varied();
        Self::new(PilotStyle {
            excursions: varied.excursions * rng.random_range(0.3..1.7),
            pauses: varied.pauses * rng.random_range(0.3..1.7),
            keys: rng.random_range(0.3..0.7),
            menu: rng.random_range(0.15..0.3),
            speeds: [rng.random_range(8.0..16.0), rng.random_range(45.0..80.0)],
            daring: rng.random_range(60.0..200.0),
            ..varied
        })
    }

    /// The action of this step.
    pub fn act(&mut self, truth: &Truth, rng: &mut impl Rng) -> CarAction {
        if self.steps_left == 0 || self.is_over(truth) {
            self.begin_stretch(truth, rng);
        }
        self.steps_left = self.steps_left.saturating_sub(1);
        for (policy, obstacle) in self.policies.iter_mut().zip([truth.chuckhole, truth.car]) {
            *policy = obstacle.and_then(|it| ObstaclePolicy::with(it, *policy, truth, rng));
        }
        let setpoint = self.setpoint(truth);
        match &mut self.actuator {
            Some(actuator) => actuator.act(setpoint, rng),
            None => CarAction::default(),
        }
    }

    /// Whether the stretch has reached what it was about, or must not go on.
    fn is_over(&self, truth: &Truth) -> bool {
        let out_there = truth.position.iter().any(|c| c.abs() > FIELD_MARGIN);
        match self.intent {
            Intent::Across { reach, .. } => out_there || truth.lateral.abs() > reach,
            _ => self.is_excursion && out_there,
        }
    }

    /// Decides what to do next, and for how long.
    fn begin_stretch(&mut self, truth: &Truth, rng: &mut impl Rng) {
        let is_cut_short = self.steps_left > 0;
        let is_astray = truth.lateral.abs() > HALF_ROAD - 1.0;
        let share: f64 = rng.random();
        self.is_excursion = !is_astray && share < self.style.excursions;
        let (intent, secs) = if is_astray && (is_cut_short || rng.random_bool(0.9)) {
            way_back(rng)
        } else if self.is_excursion {
            self.excursion(rng)
        } else if is_astray || share < self.style.excursions + self.style.pauses {
            (Intent::Stop { brake: rng.random_range(0.3..1.0) }, rng.random_range(0.4..1.6))
        } else {
            (self.drive(rng), rng.random_range(1.0..6.0))
        };
        self.intent = intent;
        self.steps_left = (secs * STEPS_PER_SEC as f32) as u32;
        self.actuator = Some(Actuator::new(self.input(rng), rng));
    }

    /// A way of driving on the road.
    fn drive(&self, rng: &mut impl Rng) -> Intent {
        let [slow, fast] = self.style.speeds;
        let speed = rng.random_range(slow..fast);
        if rng.random_bool(0.12) {
            return Intent::Cut { speed, inside: rng.random_range(3.0..7.5) };
        }
        // Two draws: mostly near the center line, now and then near the kerb.
        let line = rng.random_range(-2.7..2.7) + rng.random_range(-2.7..2.7);
        Intent::Follow { speed, line }
    }

    /// A way of leaving the road, and for how many seconds.
    fn excursion(&self, rng: &mut impl Rng) -> (Intent, f32) {
        let [slow, fast] = self.style.speeds;
        let side = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
        let speed = rng.random_range(slow..fast.min(self.style.off_road_speed));
        match rng.random_range(0..10) {
            0..4 => {
                let line = side * rng.random_range(7.5..14.0);
                (Intent::Follow { speed, line }, rng.random_range(1.0..4.0))
            }
            4..8 => {
                let [angle, reach] = [side * rng.random_range(0.3..1.1), rng.random_range(9.0..26.0)];
                (Intent::Across { speed, angle, reach }, rng.random_range(1.0..4.0))
            }
            _ => (Intent::Spin { side, throttle: rng.random_range(0.2..1.0) }, rng.random_range(1.0..2.5)),
        }
    }

    /// How the controls are worked in a stretch.
    fn input(&self, rng: &mut impl Rng) -> InputKind {
        let share: f64 = rng.random();
        // The menu can neither stand still nor spin.
        let can_menu = !matches!(self.intent, Intent::Stop { .. } | Intent::Spin { .. });
        if share < self.style.keys {
            InputKind::Keys
        } else if share < self.style.keys + self.style.menu && can_menu {
            InputKind::Menu
        } else {
            InputKind::Stick
        }
    }

    /// What the intent wants of the car right now.
    fn setpoint(&self, truth: &Truth) -> Setpoint {
        match self.intent {
            Intent::Follow { speed, line } => self.follow(truth, speed, line),
            Intent::Cut { speed, inside } => {
                let bend = truth.bends[1];
                let line = if bend.abs() > 0.3 { -bend.signum() * inside } else { 0.0 };
                self.follow(truth, speed, line)
            }
            Intent::Across { speed, angle, .. } => Setpoint {
                wheels: wheels(angle - truth.heading_error),
                throttle: throttle(speed - truth.speed),
            },
            Intent::Spin { side, throttle } => Setpoint { wheels: side * LOCK, throttle },
            Intent::Stop { brake } => {
                Setpoint { wheels: 0.0, throttle: if truth.speed > 0.5 { -brake } else { 0.0 } }
            }
        }
    }

    /// Keeps to a line at a speed, slower where the road bends and where the car is off it.
    fn follow(&self, truth: &Truth, speed: f32, line: f32) -> Setpoint {
        let (mut speed, line) =
            self.policies.iter().flatten().fold((speed, line), |aim, met| met.bend(aim, truth));
        let [near, middle, far] = truth.bends;
        let [near, middle, far] =
            [near / (5.0 * NODE_STEP), middle / (10.0 * NODE_STEP), far / (20.0 * NODE_STEP)];
        let sharpest = near.abs().max(middle.abs()).max(far.abs()).max(1e-3);
        speed = speed.min((self.style.daring / sharpest).sqrt());
        let astray = truth.lateral - line;
        if astray.abs() > HALF_ROAD {
            speed = speed.min(28.0);
        }
        // Back to the line in about a second, at no more than a right angle from far away.
        let steepest = (0.4 + 0.03 * astray.abs()).min(1.3);
        let approach = (astray * 1.2 / truth.speed.max(12.0)).clamp(-steepest, steepest);
        let turn = wheels(approach - truth.heading_error) - near * WHEELBASE * 1.3;
        let [along, right] = truth.road_velocity;
        let slip = if truth.speed > 8.0 { wrapped(truth.heading_error - (-right).atan2(along)) } else { 0.0 };
        // Where the tail comes round, the wheels point where the car goes and the gas waits.
        let counter = if slip.abs() > 0.25 { slip } else { 0.0 };
        let throttle = throttle(speed - truth.speed);
        Setpoint {
            wheels: (turn + counter).clamp(-LOCK, LOCK),
            throttle: if slip.abs() > 0.5 { throttle.min(0.0) } else { throttle },
        }
    }
}

/// A slow drive to the road, and for how many seconds.
fn way_back(rng: &mut impl Rng) -> (Intent, f32) {
    let [speed, line] = [rng.random_range(12.0..30.0), rng.random_range(-3.0..3.0)];
    (Intent::Follow { speed, line }, rng.random_range(1.5..3.5))
}

/// The angle of the wheels that turns the car by `angle` radians, positive left, soon.
fn wheels(angle: f32) -> f32 {
    -wrapped(angle).clamp(-LOCK, LOCK)
}

/// The pedals for a speed that lacks this many units a second.
fn throttle(lack: f32) -> f32 {
    if lack > 0.0 { (0.04 * lack).min(1.0) } else { (0.06 * (lack + 3.0)).clamp(-1.0, 0.0) }
}

/// An angle in `(-π, π]`.
fn wrapped(angle: f32) -> f32 {
    let angle = angle.rem_euclid(2.0 * PI);
    if angle > PI { angle - 2.0 * PI } else { angle }
}
