//! What a world is, as its file says: where it comes from, what it shows, what can be done in it, and what can happen.
//!
//! Numbers, names and ranges come from here and from nowhere else.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Deserialize;

use super::WorldError;
use super::action::{Action, MAX_AXES};
use super::builtin::{self, BuiltIn};
use super::error::{SpecError, SpecFault};
use crate::text::shown_within;

/// The version of the file's format that this program writes and reads.
pub const FORMAT: u32 = 1;

/// Letters of a name.
const MAX_NAME: usize = 64;
/// Letters of a title.
const MAX_TITLE: usize = 100;
/// Letters of a command's part, or of an environment variable's value.
const MAX_ARGUMENT: usize = 4096;
/// Letters of the name of a camera or a column.
const MAX_COLUMN: usize = 256;
/// Cameras side by side.
const MAX_CAMERAS: usize = 16;
/// Axes, events, justifications, keys: more is a mistake.
const MAX_LISTED: usize = 64;
/// Justifications: their number is one byte, and the default is one of them.
const MAX_JUSTIFICATIONS: usize = 255;
/// Pixels a side of what a world shows.
pub const MAX_SIDE: u32 = 4096;
/// Pixels a side of what networks are trained at.
const TRAINED_SIDE: RangeInclusive<u32> = 8..=1024;
/// Steps of an episode.
const MAX_STEPS: usize = 10_000_000;
/// Candidates of a plan.
const MAX_CANDIDATES: usize = 4096;
/// Further ahead nobody looks: what is imagined there has little to do with the world.
pub const MAX_HORIZON: usize = 200;
/// Values of axes and events: beyond this single precision has nothing to say.
const MAX_VALUE: f32 = 1e9;

/// One world, as a `world.toml` says it.
///
/// # Examples
///
/// ```
/// use std::path::Path;
///
/// use dropj::world::WorldSpec;
///
/// let file = r#"
///     format = 1
///     name = "arm"
///     title = "An arm"
///     rate = 20
///     longest_episode = 400
///     source = { kind = "recordings" }
///     image = { height = 60, width = 80 }
///     axes = [{ name = "reach", low = 0.0, high = 512.0, neutral = 256.0 }]
/// "#;
/// let spec = WorldSpec::from_toml(file, Path::new("arm.toml"))?;
/// assert_eq!(spec.to_toml().parse::<WorldSpec>()?, spec);
///
/// let wrong = file.replace("neutral = 256.0", "neutral = 600.0");
/// let error = WorldSpec::from_toml(&wrong, Path::new("arm.toml")).unwrap_err();
/// assert_eq!(
///     error.to_string(),
///     r#"axes."reach".neutral is 600, and must be from its low, 0, to its high, 512: "arm.toml""#
/// );
/// # Ok::<(), dropj::world::SpecError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorldSpec {
    /// The version of the file's format: [`FORMAT`].
    pub format: u32,
    /// What it is called in files and on the command line: letters, digits, `-`, `_` and `.`.
    pub name: String,
    /// What people call it, in one line.
    pub title: String,
    /// Steps a second of its time, in Hz.
    pub rate: f64,
    /// The most steps an episode has.
    pub longest_episode: usize,
    /// Where it comes from.
    pub source: Source,
    /// What it shows.
    pub image: ImageSpec,
    /// What can be done in it, in the order of an action's numbers.
    pub axes: Vec<Axis>,
    /// What can happen in a step.
    #[serde(default)]
    pub events: Vec<EventSpec>,
    /// Reasons for a preference, the most severe first. The default, which always applies, is not among them.
    #[serde(default)]
    pub justifications: Vec<JustificationSpec>,
    /// What answers weigh to begin with.
    #[serde(default)]
    pub weights: LabelWeights,
    /// How it is looked ahead.
    #[serde(default)]
    pub planner: PlannerSpec,
    /// The networks, where they are not to follow from the image, the axes and the rate.
    #[serde(default)]
    pub networks: NetworkOverrides,
    /// How they are fitted, where that is not to be as usual.
    #[serde(default)]
    pub fitting: FittingOverrides,
}

/// Where a world comes from.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Source {
    /// Of which kind that is; the other keys belong to one of them.
    pub kind: SourceKind,
    /// Built in: which one.
    #[serde(default)]
    pub world: Option<String>,
    /// A process: the program and its arguments. No shell takes part.
    #[serde(default)]
    pub command: Vec<String>,
    /// A process: the folder that it is started in, from the folder of the file. None: that folder itself.
    #[serde(default)]
    pub folder: Option<PathBuf>,
    /// A process: environment variables that it gets beside ours.
    #[serde(default)]
    pub environment: BTreeMap<String, String>,
    /// A process: how long it is waited for.
    #[serde(default)]
    pub time_outs: TimeOuts,
    /// In datasets of others: the cameras that show what the world shows, side by side from left to right. None: the
    /// first one.
    #[serde(default)]
    pub cameras: Vec<String>,
    /// In datasets of others: the column that has the numbers of an action. None: `action`.
    #[serde(default)]
    pub action: Option<String>,
}

/// Of which kind a world's source is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SourceKind {
    /// A part of this program.
    BuiltIn,
    /// A process that speaks our protocol.
    Process,
    /// Nothing that moves: only recordings of it are there.
    #[default]
    Recordings,
}

impl SourceKind {
    /// As in the file.
    pub fn name(self) -> &'static str {
        match self {
            Self::BuiltIn => "built-in",
            Self::Process => "process",
            Self::Recordings => "recordings",
        }
    }
}

/// How long a process is waited for, in seconds.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TimeOuts {
    /// From its start to its first message: imports, and the making of the world.
    pub start: f64,
    /// For the first picture of an episode.
    pub reset: f64,
    /// For a step.
    pub step: f64,
    /// For its end, once it was asked to end; after this it is killed.
    pub close: f64,
}

impl TimeOuts {
    /// The seconds that a time-out may have.
    const RANGE: RangeInclusive<f64> = 0.01..=3600.0;

    fn each(self) -> [(&'static str, f64); 4] {
        [("start", self.start), ("reset", self.reset), ("step", self.step), ("close", self.close)]
    }

    /// `seconds` as a duration; what is out of range is moved into it.
    pub(super) fn duration(seconds: f64) -> Duration {
        let (least, most) = (*Self::RANGE.start(), *Self::RANGE.end());
        Duration::from_secs_f64(if seconds.is_nan() { most } else { seconds.clamp(least, most) })
    }
}

impl Default for TimeOuts {
    /// A minute to start, half of one for a reset, ten seconds for a step, two to end.
    fn default() -> Self {
        Self { start: 60.0, reset: 30.0, step: 10.0, close: 2.0 }
    }
}

/// What a world shows: RGB pictures, not necessarily square.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImageSpec {
    /// Rows of pixels, as the world gives them.
    pub height: u32,
    /// Pixels of a row, as the world gives them.
    pub width: u32,
    /// How many pixels are cut off first.
    #[serde(default)]
    pub crop: Margins,
    /// How many black pixels are then put around.
    #[serde(default)]
    pub pad: Margins,
    /// The size that networks are trained at. None: what is left after cutting and padding.
    #[serde(default)]
    pub train: Option<Size>,
}

impl Display for Size {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} x {}", self.height, self.width)
    }
}

impl ImageSpec {
    /// The size after cutting and padding.
    pub fn framed(&self) -> Size {
        let side = |whole: u32, cut: [u32; 2], added: [u32; 2]| {
            whole
                .saturating_sub(cut[0])
                .saturating_sub(cut[1])
                .saturating_add(added[0])
                .saturating_add(added[1])
        };
        let (crop, pad) = (self.crop, self.pad);
        Size {
            height: side(self.height, [crop.top, crop.bottom], [pad.top, pad.bottom]),
            width: side(self.width, [crop.left, crop.right], [pad.left, pad.right]),
        }
    }

    /// The size that networks are trained at.
    pub fn trained(&self) -> Size {
        self.train.unwrap_or_else(|| self.framed())
    }
}

/// Pixels at the four sides of a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Margins {
    /// Rows above.
    pub top: u32,
    /// Columns at the right.
    pub right: u32,
    /// Rows below.
    pub bottom: u32,
    /// Columns at the left.
    pub left: u32,
}

impl Margins {
    pub(super) fn each(self) -> [(&'static str, u32); 4] {
        [("top", self.top), ("right", self.right), ("bottom", self.bottom), ("left", self.left)]
    }
}

/// The size of a picture, in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Size {
    /// Rows.
    pub height: u32,
    /// Pixels of a row.
    pub width: u32,
}

/// One number of an action.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Axis {
    /// What it is called.
    pub name: String,
    /// Its smallest value.
    pub low: f32,
    /// Its largest value.
    pub high: f32,
    /// Its value while nobody does anything, in `[low, high]`.
    pub neutral: f32,
    /// Whether its mirror image around `neutral` is as good: left and right, for instance.
    #[serde(default)]
    pub mirrored: bool,
    /// The keys that move it.
    #[serde(default)]
    pub keys: Vec<KeyInput>,
    /// The sticks and triggers of a gamepad that move it.
    #[serde(default)]
    pub pad: Vec<PadInput>,
    /// How fast a held key moves it, in its own units a second. None: at once.
    #[serde(default)]
    pub key_speed: Option<f32>,
    /// What it does when it is let go.
    #[serde(default)]
    pub release: Release,
}

impl Axis {
    /// `value` moved into the axis's range; what is not a number becomes the neutral value.
    pub fn clamped(&self, value: f32) -> f32 {
        if value.is_nan() { self.neutral } else { value.clamp(self.low, self.high) }
    }
}

/// A key that moves an axis.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KeyInput {
    /// Which one: one of [`KEYS`].
    pub key: String,
    /// The value that it moves the axis to, in `[low, high]`.
    pub to: f32,
}

/// A stick or trigger that moves an axis.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PadInput {
    /// Which one.
    pub axis: PadAxis,
    /// The value at its far end, in `[low, high]`. The neutral value is at rest.
    pub to: f32,
}

/// The keys that can move an axis.
pub const KEYS: [&str; 41] = [
    "Left", "Right", "Up", "Down", "Space", "A", "B", "C", "D", "E", "F", "G", "H", "I", "J", "K", "L", "M",
    "N", "O", "P", "Q", "R", "S", "T", "U", "V", "W", "X", "Y", "Z", "0", "1", "2", "3", "4", "5", "6", "7",
    "8", "9",
];

/// A direction in which a gamepad's stick or trigger moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PadAxis {
    /// The left stick to the left.
    LeftStickLeft,
    /// The left stick to the right.
    LeftStickRight,
    /// The left stick, pushed away.
    LeftStickUp,
    /// The left stick, pulled near.
    LeftStickDown,
    /// The right stick to the left.
    RightStickLeft,
    /// The right stick to the right.
    RightStickRight,
    /// The right stick, pushed away.
    RightStickUp,
    /// The right stick, pulled near.
    RightStickDown,
    /// The left trigger.
    LeftTrigger,
    /// The right trigger.
    RightTrigger,
}

impl PadAxis {
    /// As in the file.
    pub fn name(self) -> &'static str {
        match self {
            Self::LeftStickLeft => "left-stick-left",
            Self::LeftStickRight => "left-stick-right",
            Self::LeftStickUp => "left-stick-up",
            Self::LeftStickDown => "left-stick-down",
            Self::RightStickLeft => "right-stick-left",
            Self::RightStickRight => "right-stick-right",
            Self::RightStickUp => "right-stick-up",
            Self::RightStickDown => "right-stick-down",
            Self::LeftTrigger => "left-trigger",
            Self::RightTrigger => "right-trigger",
        }
    }
}

/// What an axis does when its key is let go.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Release {
    /// It springs back to its neutral value.
    #[default]
    Spring,
    /// It stays where it is.
    Stay,
}

impl Release {
    /// As in the file.
    pub fn name(self) -> &'static str {
        if self == Self::Spring { "spring" } else { "stay" }
    }
}

/// Something that can happen in a step.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EventSpec {
    /// What it is called.
    pub name: String,
    /// Whether it is bad or good.
    pub kind: EventKind,
    /// How it is counted.
    #[serde(default)]
    pub count: Count,
    /// The field of what the world tells of a step that says it: `crashed`, or `rewards.on_road` for one within another.
    /// In datasets of others it is a column: `next.success`, or `observation.state.2` for one number of several.
    pub field: String,
    /// When that field says that it happens.
    #[serde(default)]
    pub when: When,
    /// The field that says that one more was passed; only where it is counted of those passed.
    #[serde(default)]
    pub passed: Option<String>,
}

/// Whether an event is bad or good.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EventKind {
    /// It must not happen.
    Safety,
    /// It is what the world is about.
    Progress,
}

impl EventKind {
    /// As in the file.
    pub fn name(self) -> &'static str {
        if self == Self::Safety { "safety" } else { "progress" }
    }
}

/// How an event is counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Count {
    /// In each step in which it goes on.
    #[default]
    PerStep,
    /// Once, when it begins.
    FirstTouch,
    /// Once, when it begins, as a share of those that were passed.
    OfPassed,
}

impl Count {
    /// As in the file.
    pub fn name(self) -> &'static str {
        match self {
            Self::PerStep => "per-step",
            Self::FirstTouch => "first-touch",
            Self::OfPassed => "of-passed",
        }
    }
}

/// When a field says that an event happens. Of truth values, true is 1 and false is 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum When {
    /// Where it is not 0.
    #[default]
    True,
    /// Where it is 0.
    False,
    /// Where it is larger than in the step before.
    Grows,
    /// Where it is above this value.
    Above(f64),
    /// Where it is below this value.
    Below(f64),
}

/// A reason for a preference.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JustificationSpec {
    /// What it is called.
    pub name: String,
    /// The events that it stands for.
    pub events: Vec<String>,
    /// What it weighs to begin with, in `(0.5, 1]`.
    pub weight: f32,
}

/// What answers weigh to begin with, each in `(0.5, 1]`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LabelWeights {
    /// `w_s`: one of two clips is safe.
    pub safety: f32,
    /// `w_def`: both are safe, or no reason but the default applies.
    pub default: f32,
}

impl Default for LabelWeights {
    /// The paper's: 1 and 0.75.
    fn default() -> Self {
        Self { safety: 1.0, default: 0.75 }
    }
}

/// How it is looked ahead.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PlannerSpec {
    /// H: how many steps are imagined.
    pub horizon: usize,
    /// R: how many steps of a plan are carried out before the next plan.
    pub replan: usize,
    /// τ of the imagined mean.
    pub temperature: f64,
    /// After how many steps everything is forgotten, if ever.
    pub memory_reset: Option<usize>,
    /// What the searches for trajectories worth asking about begin with, a number for each axis; none: each axis by itself.
    pub beginnings: Vec<Vec<f32>>,
    /// The courses of action that it chooses among.
    pub candidates: Candidates,
}

impl Default for PlannerSpec {
    /// The paper's numbers, and candidates from recordings. Nothing is forgotten, as where the file does not say so.
    fn default() -> Self {
        Self {
            horizon: 15,
            replan: 4,
            temperature: 0.1,
            memory_reset: None,
            beginnings: Vec::new(),
            candidates: Candidates::default(),
        }
    }
}

/// The courses of action that a planner chooses among.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Candidates {
    /// Where they come from; the other keys belong to one of these.
    pub from: CandidateSource,
    /// From the file: actions that are kept to throughout.
    pub constant: Vec<Vec<f32>>,
    /// From the file: actions that others follow. Each stage comes first in one candidate, for n ~ U{1 … H − 1} steps;
    /// the second is drawn from the same list.
    pub stages: Vec<Stage>,
    /// From the file: whole courses of action, each in parts that follow one another; the last part lasts to the end.
    pub courses: Vec<Vec<Part>>,
    /// From recordings: how many.
    pub count: Option<usize>,
}

/// Where candidates come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CandidateSource {
    /// From the file.
    File,
    /// From what was done in recordings.
    #[default]
    Recordings,
}

impl CandidateSource {
    /// As in the file.
    pub fn name(self) -> &'static str {
        if self == Self::File { "file" } else { "recordings" }
    }
}

impl Candidates {
    /// How many the file gives.
    pub fn n_given(&self) -> usize {
        self.constant.len() + self.stages.len() + self.courses.len()
    }
}

/// An action that lasts for some steps of a course.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Part {
    /// A number for each axis.
    pub action: Vec<f32>,
    /// How many. The last part of a course lasts to the end, whatever it says.
    #[serde(default = "Part::one_step")]
    pub steps: usize,
}

impl Part {
    fn one_step() -> usize {
        1
    }
}

/// An action that lasts for a part of a candidate.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stage {
    /// A number for each axis.
    pub action: Vec<f32>,
    /// The probability to come second, in `[0, 1]`. All together they make 1.
    pub follows: f64,
}

/// What of the networks is not to follow from the image, the axes and the rate.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NetworkOverrides {
    /// Z: latents.
    pub latent: Option<usize>,
    /// M: cells of the memory.
    pub memory: Option<usize>,
    /// K: Gaussians in the mixture of each latent.
    pub components: Option<usize>,
    /// Channels of the first convolution; each further one has twice as many.
    pub channels: Option<usize>,
}

impl NetworkOverrides {
    pub(super) fn each(&self) -> [(&'static str, Option<usize>, usize); 4] {
        [
            ("latent", self.latent, 1 << 12),
            ("memory", self.memory, 1 << 14),
            ("components", self.components, 256),
            ("channels", self.channels, 1024),
        ]
    }
}

/// How the networks are fitted, where that is not to be as usual.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FittingOverrides {
    /// Epochs of vision at the most.
    pub vae_epochs: Option<usize>,
    /// Epochs of the memory at the most.
    pub mdn_rnn_epochs: Option<usize>,
    /// Steps in a window of an episode for the memory.
    pub window: Option<usize>,
    /// Frames, or windows, in an update.
    pub batch: Option<usize>,
    /// Share of the episodes that is never trained on, in `[0, 0.9]`.
    pub held_out: Option<f64>,
    /// How much pixels of rare colors count more for vision: 0 not at all, 1 as usual.
    pub emphasis: Option<f64>,
}

impl FittingOverrides {
    pub(super) fn each(&self) -> [(&'static str, Option<usize>, usize); 4] {
        [
            ("vae_epochs", self.vae_epochs, 1_000_000),
            ("mdn_rnn_epochs", self.mdn_rnn_epochs, 1_000_000),
            ("window", self.window, 1_000_000),
            ("batch", self.batch, 1 << 16),
        ]
    }
}

impl Default for WorldSpec {
    /// The first of the built-in worlds.
    fn default() -> Self {
        BuiltIn::all().next().map_or_else(|| unreachable!("there are some"), BuiltIn::spec)
    }
}

impl WorldSpec {
    /// The built-in world of this name; of another name, as if it was the first of them. For files that tell no more.
    pub fn of_name(name: &str) -> Self {
        Self::built_in(name).unwrap_or_else(|| Self { name: name.to_owned(), ..Self::default() })
    }

    /// The events of this kind, in order.
    pub fn events_of(&self, kind: EventKind) -> impl Iterator<Item = &EventSpec> {
        self.events.iter().filter(move |event| event.kind == kind)
    }

    /// What the file at `path`, which holds `text`, says; the path is for errors alone.
    ///
    /// # Errors
    /// Where it is no TOML, where a key is unknown or missing, and where a value cannot be: see [`SpecFault`].
    pub fn from_toml(text: &str, path: &Path) -> Result<Self, SpecError> {
        let spec: Self = toml::from_str(text).map_err(|met| SpecFault::syntax(&met, text).at(path))?;
        spec.check().map_err(|fault| fault.at(path))?;
        Ok(spec)
    }

    /// The built-in world of this name, if there is one.
    pub fn built_in(name: &str) -> Option<Self> {
        Some(BuiltIn::named(name)?.spec())
    }

    /// `action` with every number moved into its axis's range.
    ///
    /// # Errors
    /// Where it has not a finite number for each axis.
    pub fn checked(&self, action: &[f32]) -> Result<Action, WorldError> {
        if action.len() != self.axes.len() {
            return Err(WorldError::ActionLength { found: action.len(), wanted: self.axes.len() });
        }
        if let Some((axis, found)) = self.axes.iter().zip(action).find(|(_, value)| !value.is_finite()) {
            return Err(WorldError::ActionValue { axis: axis.name.clone(), found: *found });
        }
        Ok(Action::new(action).map(|i, value| self.axes[i].clamped(value)))
    }

    /// The neutral action.
    pub fn neutral(&self) -> Vec<f32> {
        self.axes.iter().map(|axis| axis.neutral).collect()
    }

    /// The fields of what the world tells that its events are read from, each once.
    pub fn fields(&self) -> Vec<String> {
        let named = self.events.iter().flat_map(|event| [Some(&event.field), event.passed.as_ref()]);
        named.flatten().cloned().collect::<BTreeSet<_>>().into_iter().collect()
    }

    /// Fails where no world can be so.
    pub fn check(&self) -> Result<(), SpecFault> {
        within("format", self.format, FORMAT..=FORMAT)?;
        check_id("name", &self.name)?;
        check_line("title", &self.title, MAX_TITLE)?;
        within("rate", self.rate, 0.01..=10_000.0)?;
        within("longest_episode", self.longest_episode, 1..=MAX_STEPS)?;
        self.source.check()?;
        self.image.check()?;
        within("the number of axes", self.axes.len(), 1..=MAX_AXES)?;
        unique("axes", self.axes.iter().map(|axis| axis.name.as_str()))?;
        for (i, axis) in self.axes.iter().enumerate() {
            axis.check(i)?;
        }
        within("the number of events", self.events.len(), 0..=MAX_LISTED)?;
        unique("events", self.events.iter().map(|event| event.name.as_str()))?;
        for (i, event) in self.events.iter().enumerate() {
            event.check(i)?;
        }
        self.check_justifications()?;
        weight("weights.safety", self.weights.safety)?;
        weight("weights.default", self.weights.default)?;
        self.planner.check(&self.axes)?;
        for (name, value, most) in self.networks.each() {
            within(format!("networks.{name}"), value.unwrap_or(1), 1..=most)?;
        }
        for (name, value, most) in self.fitting.each() {
            within(format!("fitting.{name}"), value.unwrap_or(1), 1..=most)?;
        }
        within("fitting.window", self.fitting.window.unwrap_or(2), 2..=1_000_000)?;
        within("fitting.held_out", self.fitting.held_out.unwrap_or_default(), 0.0..=0.9)?;
        within("fitting.emphasis", self.fitting.emphasis.unwrap_or_default(), 0.0..=1000.0)
    }

    fn check_justifications(&self) -> Result<(), SpecFault> {
        within("the number of justifications", self.justifications.len(), 0..=MAX_JUSTIFICATIONS)?;
        let names = || self.justifications.iter().map(|justification| justification.name.as_str());
        unique("justifications", names())?;
        if names().any(|name| name == "default") {
            let why = "the default is always there, and its weight is weights.default";
            return Err(SpecFault::misplaced("justifications.\"default\"", why));
        }
        let known: Vec<&str> = self.events.iter().map(|event| event.name.as_str()).collect();
        for (i, justification) in self.justifications.iter().enumerate() {
            check_line(&format!("justifications[{}].name", i + 1), &justification.name, MAX_NAME)?;
            let key = format!("justifications.\"{}\"", justification.name);
            weight(&format!("{key}.weight"), justification.weight)?;
            let events = format!("{key}.events");
            if justification.events.is_empty() {
                return Err(SpecFault::missing(events, format!("name at least one; {}", listed(&known))));
            }
            unique(&events, justification.events.iter().map(String::as_str))?;
            if let Some(name) = justification.events.iter().find(|name| !known.contains(&name.as_str())) {
                return Err(SpecFault::UnknownEvent {
                    key: events,
                    name: name.clone(),
                    known: listed(&known),
                });
            }
        }
        Ok(())
    }
}

impl std::str::FromStr for WorldSpec {
    type Err = SpecError;

    fn from_str(text: &str) -> Result<Self, SpecError> {
        Self::from_toml(text, Path::new("world.toml"))
    }
}

impl Source {
    fn check(&self) -> Result<(), SpecFault> {
        let kind = self.kind;
        let belongs = |key: &str, is_given: bool, to: SourceKind| {
            if !is_given || kind == to {
                return Ok(());
            }
            let why = format!(
                "it belongs to source.kind = \"{}\", and this world's is \"{}\"",
                to.name(),
                kind.name()
            );
            Err(SpecFault::misplaced(key, why))
        };
        belongs("source.world", self.world.is_some(), SourceKind::BuiltIn)?;
        belongs("source.command", !self.command.is_empty(), SourceKind::Process)?;
        belongs("source.folder", self.folder.is_some(), SourceKind::Process)?;
        belongs("source.environment", !self.environment.is_empty(), SourceKind::Process)?;
        belongs("source.time_outs", self.time_outs != TimeOuts::default(), SourceKind::Process)?;
        match kind {
            SourceKind::BuiltIn => self.check_built_in()?,
            SourceKind::Process => self.check_process()?,
            SourceKind::Recordings => {}
        }
        self.check_columns()
    }

    /// What datasets of others are read by.
    fn check_columns(&self) -> Result<(), SpecFault> {
        let cameras = self.cameras.iter().map(|name| ("source.cameras", name));
        let action = self.action.iter().map(|name| ("source.action", name));
        for (key, name) in cameras.chain(action) {
            if self.kind == SourceKind::BuiltIn {
                let why = "it belongs to recordings of others, and this world's are dropj's own";
                return Err(SpecFault::misplaced(key, why));
            }
            check_line(key, name, MAX_COLUMN)?;
        }
        within("the number of source.cameras", self.cameras.len(), 0..=MAX_CAMERAS)?;
        unique("source.cameras", self.cameras.iter().map(String::as_str))
    }

    fn check_built_in(&self) -> Result<(), SpecFault> {
        let known = listed(&builtin::NAMES);
        match &self.world {
            None => Err(SpecFault::missing("source.world", format!("say which world is meant; {known}"))),
            Some(name) if BuiltIn::named(name).is_none() => {
                Err(SpecFault::text("source.world", name, format!("the name of a built-in world; {known}")))
            }
            Some(_) => Ok(()),
        }
    }

    fn check_process(&self) -> Result<(), SpecFault> {
        let Some(program) = self.command.first() else {
            let wanted = "give the program and its arguments, such as [\"python3\", \"my_world.py\"]";
            return Err(SpecFault::missing("source.command", wanted));
        };
        if program.is_empty() {
            return Err(SpecFault::text("source.command", program, "a program and its arguments"));
        }
        let texts = self.command.iter().map(|part| ("source.command".to_owned(), part));
        let variables =
            self.environment.iter().map(|(name, value)| (format!("source.environment.{name:?}"), value));
        for (key, text) in texts.chain(variables) {
            if text.contains('\0') || text.chars().count() > MAX_ARGUMENT {
                let wanted = format!("of {MAX_ARGUMENT} letters at the most, and without the character 0");
                return Err(SpecFault::text(key, text, wanted));
            }
        }
        if let Some(name) = self.environment.keys().find(|name| name.is_empty() || name.contains(['=', '\0']))
        {
            let wanted = "the name of an environment variable, without = in it";
            return Err(SpecFault::text("a key of source.environment", name, wanted));
        }
        for (name, seconds) in self.time_outs.each() {
            within(format!("source.time_outs.{name}"), seconds, TimeOuts::RANGE)?;
        }
        Ok(())
    }
}

impl ImageSpec {
    fn check(&self) -> Result<(), SpecFault> {
        within("image.height", self.height, 1..=MAX_SIDE)?;
        within("image.width", self.width, 1..=MAX_SIDE)?;
        for (table, margins) in [("crop", self.crop), ("pad", self.pad)] {
            for (side, n) in margins.each() {
                within(format!("image.{table}.{side}"), n, 0..=MAX_SIDE)?;
            }
        }
        let (crop, wanted) = (self.crop, "so small that a pixel is left");
        if crop.top + crop.bottom >= self.height {
            let found = format!("{} rows of {}", crop.top + crop.bottom, self.height);
            return Err(SpecFault::value("image.crop.top and bottom", found, wanted));
        }
        if crop.left + crop.right >= self.width {
            let found = format!("{} columns of {}", crop.left + crop.right, self.width);
            return Err(SpecFault::value("image.crop.left and right", found, wanted));
        }
        let trained = self.trained();
        if self.train.is_none() && ![trained.height, trained.width].iter().all(|n| TRAINED_SIDE.contains(n)) {
            let why = format!(
                "the picture has {} x {} pixels, and networks are trained at {} to {} a side",
                trained.height,
                trained.width,
                TRAINED_SIDE.start(),
                TRAINED_SIDE.end()
            );
            return Err(SpecFault::missing("image.train", why));
        }
        within("image.train.height", trained.height, TRAINED_SIDE)?;
        within("image.train.width", trained.width, TRAINED_SIDE)
    }
}

impl Axis {
    fn check(&self, i: usize) -> Result<(), SpecFault> {
        check_line(&format!("axes[{}].name", i + 1), &self.name, MAX_NAME)?;
        let key = |name: &str| format!("axes.\"{}\".{name}", self.name);
        within(key("low"), self.low, -MAX_VALUE..=MAX_VALUE)?;
        within(key("high"), self.high, -MAX_VALUE..=MAX_VALUE)?;
        if self.high <= self.low {
            return Err(SpecFault::value(key("high"), self.high, format!("above its low, {}", self.low)));
        }
        self.check_value(key("neutral"), self.neutral)?;
        within(format!("the number of keys of axes.\"{}\"", self.name), self.keys.len(), 0..=MAX_LISTED)?;
        unique(&key("keys"), self.keys.iter().map(|input| input.key.as_str()))?;
        for KeyInput { key: name, to } in &self.keys {
            if !KEYS.contains(&name.as_str()) {
                let wanted = "a letter from A to Z, a digit, Left, Right, Up, Down or Space";
                return Err(SpecFault::text(key("keys"), name, wanted));
            }
            self.check_value(key(&format!("keys.\"{name}\".to")), *to)?;
        }
        unique(&key("pad"), self.pad.iter().map(|input| input.axis.name()))?;
        for PadInput { axis, to } in &self.pad {
            self.check_value(key(&format!("pad.\"{}\".to", axis.name())), *to)?;
        }
        if let Some(speed) = self.key_speed {
            within(key("key_speed"), speed, 1e-6..=MAX_VALUE)?;
        }
        Ok(())
    }

    fn check_value(&self, key: String, value: f32) -> Result<(), SpecFault> {
        if (self.low..=self.high).contains(&value) {
            return Ok(());
        }
        let wanted = format!("from its low, {}, to its high, {}", self.low, self.high);
        Err(SpecFault::value(key, value, wanted))
    }
}

impl EventSpec {
    fn check(&self, i: usize) -> Result<(), SpecFault> {
        check_line(&format!("events[{}].name", i + 1), &self.name, MAX_NAME)?;
        let key = |name: &str| format!("events.\"{}\".{name}", self.name);
        check_line(&key("field"), &self.field, MAX_TITLE)?;
        if let When::Above(limit) | When::Below(limit) = self.when {
            let most = f64::from(MAX_VALUE);
            within(key("when"), limit, -most..=most)?;
        }
        match (&self.passed, self.count) {
            (Some(passed), Count::OfPassed) => check_line(&key("passed"), passed, MAX_TITLE),
            (None, Count::OfPassed) => {
                let wanted = "count = \"of-passed\" needs the field that says that one was passed";
                Err(SpecFault::missing(key("passed"), wanted))
            }
            (Some(_), _) => {
                let why =
                    format!("it belongs to count = \"of-passed\", and this is \"{}\"", self.count.name());
                Err(SpecFault::misplaced(key("passed"), why))
            }
            (None, _) => Ok(()),
        }
    }
}

impl PlannerSpec {
    fn check(&self, axes: &[Axis]) -> Result<(), SpecFault> {
        within("planner.horizon", self.horizon, 1..=MAX_HORIZON)?;
        within("planner.replan", self.replan, 1..=self.horizon)?;
        within("planner.temperature", self.temperature, 1e-6..=1e3)?;
        within("planner.memory_reset", self.memory_reset.unwrap_or(1), 1..=MAX_STEPS)?;
        within("the number of planner.beginnings", self.beginnings.len(), 0..=MAX_LISTED)?;
        self.beginnings.iter().try_for_each(|action| check_action("planner.beginnings", action, axes))?;
        self.candidates.check(axes)
    }
}

impl Candidates {
    fn check(&self, axes: &[Axis]) -> Result<(), SpecFault> {
        let key = |name: &str| format!("planner.candidates.{name}");
        let belongs = |name: &str, is_given: bool, to: CandidateSource| {
            if !is_given || self.from == to {
                return Ok(());
            }
            let why = format!(
                "it belongs to planner.candidates.from = \"{}\", and this is \"{}\"",
                to.name(),
                self.from.name()
            );
            Err(SpecFault::misplaced(key(name), why))
        };
        belongs("constant", !self.constant.is_empty(), CandidateSource::File)?;
        belongs("stages", !self.stages.is_empty(), CandidateSource::File)?;
        belongs("courses", !self.courses.is_empty(), CandidateSource::File)?;
        belongs("count", self.count.is_some(), CandidateSource::Recordings)?;
        within(key("count"), self.count.unwrap_or(1), 1..=MAX_CANDIDATES)?;
        if self.from == CandidateSource::Recordings {
            return Ok(());
        }
        within("the number of planner.candidates", self.n_given(), 1..=MAX_CANDIDATES)?;
        let constant = self.constant.iter().map(|action| ("constant", action));
        let stages = self.stages.iter().map(|stage| ("stages", &stage.action));
        let parts = self.courses.iter().flatten().map(|part| ("courses", &part.action));
        for (name, action) in constant.chain(stages).chain(parts) {
            check_action(&key(name), action, axes)?;
        }
        for course in &self.courses {
            within("the number of parts of one of planner.candidates.courses", course.len(), 1..=MAX_LISTED)?;
            for part in course {
                within(key("courses.steps"), part.steps, 1..=MAX_HORIZON)?;
            }
        }
        for stage in &self.stages {
            within(key("stages.follows"), stage.follows, 0.0..=1.0)?;
        }
        let found: f64 = self.stages.iter().map(|stage| stage.follows).sum();
        if !self.stages.is_empty() && (found - 1.0).abs() > 1e-6 {
            return Err(SpecFault::Follows { found });
        }
        Ok(())
    }
}

/// Fails where an action has not a number in its range for each axis.
fn check_action(key: &str, action: &[f32], axes: &[Axis]) -> Result<(), SpecFault> {
    if action.len() != axes.len() {
        let wanted = format!("of {} numbers, one for each axis", axes.len());
        return Err(SpecFault::value(key, format!("an action of {}", action.len()), wanted));
    }
    let mut each = axes.iter().zip(action);
    each.try_for_each(|(axis, value)| axis.check_value(format!("{key} for \"{}\"", axis.name), *value))
}

/// Fails where `found` does not lie in `range`. What is not a number lies in none.
fn within<T: PartialOrd + Display>(
    key: impl Into<String>,
    found: T,
    range: RangeInclusive<T>,
) -> Result<(), SpecFault> {
    if range.contains(&found) {
        return Ok(());
    }
    let (least, most) = (range.start(), range.end());
    let wanted = if least == most { least.to_string() } else { format!("from {least} to {most}") };
    Err(SpecFault::value(key, found, wanted))
}

fn weight(key: &str, found: f32) -> Result<(), SpecFault> {
    if found > 0.5 && found <= 1.0 {
        return Ok(());
    }
    Err(SpecFault::value(key, found, "above 0.5 and at most 1"))
}

/// Fails where a text is no visible line of `most` letters at the most.
fn check_line(key: &str, text: &str, most: usize) -> Result<(), SpecFault> {
    if !text.trim().is_empty() && shown_within(text, most) == text {
        return Ok(());
    }
    let wanted = format!(
        "of 1 to {most} letters that can be seen, without line ends and without spaces at its start and end"
    );
    Err(SpecFault::text(key, text, wanted))
}

/// Fails where a name cannot be that of a file.
fn check_id(key: &str, name: &str) -> Result<(), SpecFault> {
    let fits = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
    if name.starts_with(|c: char| c.is_ascii_alphanumeric())
        && name.chars().all(fits)
        && name.len() <= MAX_NAME
    {
        return Ok(());
    }
    let wanted = format!(
        "of 1 to {MAX_NAME} letters from a to z or A to Z, digits, -, _ and ., and begin with a letter or digit"
    );
    Err(SpecFault::text(key, name, wanted))
}

fn unique<'a>(key: &str, names: impl Iterator<Item = &'a str>) -> Result<(), SpecFault> {
    let mut seen = BTreeSet::new();
    for name in names {
        if !seen.insert(name) {
            return Err(SpecFault::Twice { key: key.to_owned(), name: name.to_owned() });
        }
    }
    Ok(())
}

/// Those that there are, in words.
fn listed(names: &[&str]) -> String {
    match names {
        [] => "there are none".to_owned(),
        [one] => format!("there is \"{one}\""),
        names => format!("there are \"{}\"", names.join("\", \"")),
    }
}
