//! What stand-ins see with: a small network that reads off a picture what happens in it, and how well it goes on.
//!
//! It sees what a person sees: the present picture, and one of a moment before for the motion. What its numbers mean is
//! told beside it: of a car on its road they are those of [`cars::sight`](crate::world::cars::sight), in any other world
//! the world's own events by their names, and progress.

use rand::{Rng, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use tch::{Device, Kind, Tensor, nn};

use crate::dream::Rows;
use crate::tensor::limits::{MAX_ACTIVATIONS, MAX_LAYERS, MAX_SIDE, MAX_WIDTH, OutOfRange, within};
use crate::tensor::{
    Backend, DescriptionError, LAYOUT, Parameters, ParametersError, Slot, described, describes, dims,
    from_frames_on, layout_of, to_vec, uniform,
};
use crate::world::cars::{Sight, sight};
use crate::world::{Frame, Size, WorldSpec};
use crate::world_model::{Layer, WorldModel};

/// Seconds from the earlier picture to the present one, as near as whole steps come.
const GAP_SECS: f64 = 0.08;
/// The most steps that may be.
const MAX_GAP: usize = 10_000;
/// Pictures that are looked at together.
const BATCH: usize = 128;
/// The most events that are read, and bytes of what is told of them.
const MAX_EVENTS: usize = 64;
const MAX_TOLD: usize = 1 << 16;

/// The steps from the earlier picture to the present one where there are `rate` a second: about 0.08 s, at least one.
pub fn gap(rate: f64) -> usize {
    ((GAP_SECS * rate).round() as usize).clamp(1, MAX_GAP)
}

/// What the numbers mean that come out of a probe.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reads {
    /// Where a car is on its road and how it moves: see [`cars::sight`](crate::world::cars::sight). 10 numbers, or 12.
    Car {
        /// Whether it looks for obstacles that the car touches, too.
        contacts: bool,
    },
    /// The logits of the events of these names, and behind them progress: E + 1 numbers.
    Events(Vec<String>),
}

/// The shape of a [`Probe`], and what it reads.
///
/// In files a square has one `side`, as before there were others, and any other picture a `height` and a `width`. Files
/// without `reads`, a list of names, are of cars on their roads, and tell of `obstacles` instead.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "ProbeFile", into = "ProbeFile")]
pub struct ProbeConfig {
    /// H: rows of a frame.
    pub height: i64,
    /// W: pixels of a row.
    pub width: i64,
    /// Convolutions, from the frame inwards.
    pub layers: Vec<Layer>,
    /// Units of the hidden layer behind them.
    pub hidden: i64,
    /// What it reads.
    pub reads: Reads,
}

/// A [`ProbeConfig`] as files have it.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ProbeFile {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    side: Option<i64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    height: Option<i64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    width: Option<i64>,
    layers: Vec<Layer>,
    hidden: i64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    obstacles: Option<bool>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    reads: Option<Vec<String>>,
}

/// Why a file does not say what a probe is.
#[derive(Debug, thiserror::Error)]
enum FileError {
    #[error("a probe has either a `side` or a `height` and a `width`")]
    Size,
    #[error("a probe has either `obstacles` or a list of what it `reads`")]
    Reads,
}

impl TryFrom<ProbeFile> for ProbeConfig {
    type Error = FileError;

    fn try_from(file: ProbeFile) -> Result<Self, FileError> {
        let (height, width) = match (file.side, file.height, file.width) {
            (Some(side), None, None) => (side, side),
            (None, Some(height), Some(width)) => (height, width),
            _ => return Err(FileError::Size),
        };
        let reads = match (file.reads, file.obstacles) {
            (Some(events), None | Some(false)) => Reads::Events(events),
            (Some(_), Some(true)) => return Err(FileError::Reads),
            (None, contacts) => Reads::Car { contacts: contacts.unwrap_or_default() },
        };
        Ok(Self { height, width, layers: file.layers, hidden: file.hidden, reads })
    }
}

impl From<ProbeConfig> for ProbeFile {
    fn from(config: ProbeConfig) -> Self {
        let ProbeConfig { height, width, layers, hidden, reads } = config;
        let is_square = height == width;
        let (obstacles, reads) = match reads {
            Reads::Car { contacts } => (Some(contacts), None),
            Reads::Events(events) => (None, Some(events)),
        };
        Self {
            side: is_square.then_some(height),
            height: (!is_square).then_some(height),
            width: (!is_square).then_some(width),
            layers,
            hidden,
            obstacles,
            reads,
        }
    }
}

impl ProbeConfig {
    /// The probe that is fitted for this world: of a built-in car what is seen of it, else the world's events.
    pub fn for_world(spec: &WorldSpec) -> Self {
        let reads = match Sight::has_contacts(spec) {
            Some(contacts) => Reads::Car { contacts },
            None => Self::events_of(spec),
        };
        Self::of_size(spec.image.trained(), reads)
    }

    /// All events of a world.
    pub(super) fn events_of(spec: &WorldSpec) -> Reads {
        Reads::Events(spec.events.iter().map(|event| event.name.clone()).collect())
    }

    /// For frames of this size, by a rule.
    ///
    /// Convolutions have a stride of 2 and no padding; the first and the third a kernel of 4, all others of 3; 16, 32, 48
    /// and from then on 64 channels. There are as many as bring the larger side to 4 pixels or less, as far as the smaller
    /// side has enough for a kernel. 128 hidden units follow. 84 x 84 pixels take four, 128 x 128 five: 190 000 parameters.
    pub fn of_size(size: Size, reads: Reads) -> Self {
        const ENOUGH: i64 = 4;
        let (height, width) = (i64::from(size.height), i64::from(size.width));
        let (mut layers, mut sides) = (Vec::new(), [height, width]);
        while sides[0].max(sides[1]) > ENOUGH || layers.is_empty() {
            let i = layers.len() as i64;
            let kernel = if i == 0 || i == 2 { 4 } else { 3 };
            if sides[0].min(sides[1]) < kernel {
                break;
            }
            layers.push(Layer { channels: (16 * (i + 1)).min(64), kernel, stride: 2, padding: 0 });
            sides = sides.map(|side| (side - kernel) / 2 + 1);
        }
        Self { height, width, layers, hidden: 128, reads }
    }

    /// A toy for frames of 20 pixels with a car in them.
    pub fn tiny() -> Self {
        let layer = |channels| Layer { channels, kernel: 4, stride: 2, padding: 0 };
        let layers = vec![layer(8), layer(16)];
        Self { height: 20, width: 20, layers, hidden: 32, reads: Reads::Car { contacts: false } }
    }

    /// What errors call height and width.
    fn names(&self) -> [&'static str; 2] {
        if self.height == self.width { ["side"; 2] } else { ["height", "width"] }
    }

    /// Fails where no network can be of this shape.
    pub fn check(&self) -> Result<(), OutOfRange> {
        for (name, side) in self.names().iter().zip([self.height, self.width]) {
            within(&format!("the {name} of the probe's frames"), side, 1..=MAX_SIDE)?;
        }
        within("the number of the probe's convolutions", self.layers.len(), 1..=MAX_LAYERS)?;
        within("the number of the probe's hidden units", self.hidden, 1..=MAX_WIDTH)?;
        if let Reads::Events(events) = &self.reads {
            within("the number of events that the probe reads", events.len(), 0..=MAX_EVENTS)?;
        }
        let [height, width] = self.bottom()?;
        let depth = self.layers.last().map_or(0, |layer| layer.channels);
        within("how many features the probe has", depth * height * width, 1..=MAX_ACTIVATIONS)
    }

    /// Height and width behind the convolutions.
    fn bottom(&self) -> Result<[i64; 2], OutOfRange> {
        let layers = self.layers.iter().enumerate();
        layers.into_iter().try_fold([self.height, self.width], |sides, (i, layer)| {
            layer.convolved_sides(&format!("the probe's conv{}", i + 1), sides)
        })
    }

    /// How the network is stored.
    pub(super) fn slots(&self) -> Vec<Slot> {
        let weighted = |name: &str, shape: &[i64]| {
            [Slot::plain(format!("{name}.weight"), shape), Slot::plain(format!("{name}.bias"), &shape[..1])]
        };
        let (mut channels, mut slots) = (6, Vec::new());
        for (i, layer) in self.layers.iter().enumerate() {
            let shape = [layer.channels, channels, layer.kernel, layer.kernel];
            slots.extend(weighted(&format!("conv{}", i + 1), &shape));
            channels = layer.channels;
        }
        let [height, width] = self.bottom().unwrap_or_default();
        slots.extend(weighted("hidden", &[self.hidden, channels * height * width]));
        slots.extend(weighted("out", &[self.n_outputs() as i64, self.hidden]));
        slots
    }

    /// How many numbers come out.
    pub(super) fn n_outputs(&self) -> usize {
        match &self.reads {
            Reads::Car { contacts: false } => sight::CONTACTS,
            Reads::Car { contacts: true } => sight::CONTACTS + 2,
            Reads::Events(events) => events.len() + 1,
        }
    }
}

/// What was found out in recordings about what a probe reads: the other half of what its header tells.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Readings {
    /// The world's name.
    pub world: String,
    /// Steps from the earlier picture to the present one.
    pub gap: usize,
    /// How many steps each event goes on once it has begun, on average; 0 where it never did.
    pub stretches: Vec<f32>,
    /// What the number of progress means; none where there was no reward.
    #[serde(default)]
    pub progress: Option<ProgressScale>,
    /// The root mean square change of a pixel, in `[0, 1]`, that 99 of 100 steps stay below; none where that is unknown.
    #[serde(default)]
    pub change: Option<f32>,
}

/// What the number of progress means: `r = mean + deviation · number` is the world's reward for the step to the picture,
/// without what safety events cost.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProgressScale {
    /// Mean of the reward for a step without a safety event.
    pub mean: f32,
    /// Its standard deviation.
    pub deviation: f32,
    /// The standard deviation of what the steps of a whole clip bring together: the unit in which annotators compare.
    pub clip: f32,
    /// What a step with a safety event costs, in that unit.
    pub unsafe_cost: f32,
}

impl Readings {
    /// Fails where these cannot be of a probe that reads `events`.
    fn check(&self, events: &[String]) -> Result<(), OutOfRange> {
        within("the number of steps from picture to picture", self.gap, 1..=MAX_GAP)?;
        within("the number of stretches", self.stretches.len(), events.len()..=events.len())?;
        for stretch in &self.stretches {
            within("the length of an event's stretch", *stretch, 0.0..=1e9)?;
        }
        if let Some(ProgressScale { mean, deviation, clip, unsafe_cost }) = self.progress {
            within("the mean of progress", mean, -1e30..=1e30)?;
            within("the deviation of progress", deviation, f32::MIN_POSITIVE..=1e30)?;
            within("the deviation of a clip's progress", clip, f32::MIN_POSITIVE..=1e30)?;
            within("what an unsafe step costs", unsafe_cost, 0.0..=1e30)?;
        }
        within("the usual change of a pixel", self.change.unwrap_or(1.0), 1e-9..=1.0)
    }
}

/// The network that a probe looks with.
#[derive(Debug)]
pub(super) struct Net {
    config: ProbeConfig,
    convs: Vec<[Tensor; 2]>,
    hidden: [Tensor; 2],
    out: [Tensor; 2],
}

impl Net {
    /// A fresh network under `path`, drawn by `rng`.
    pub(super) fn new(path: &nn::Path<'_>, config: ProbeConfig, rng: &mut impl Rng) -> Self {
        let mut weighted = |name: &str, shape: &[i64], gain: f64| {
            let fan_in = shape[1..].iter().product::<i64>() as f64;
            let weight = uniform(rng, shape, (gain / fan_in).sqrt());
            let bias = uniform(rng, &shape[..1], 1.0 / fan_in.sqrt());
            let path = path / name;
            [path.var_copy("weight", &weight), path.var_copy("bias", &bias)]
        };
        let (mut channels, mut sides) = (6, [config.height, config.width]);
        let mut convs = Vec::new();
        for (i, layer) in config.layers.iter().enumerate() {
            let shape = [layer.channels, channels, layer.kernel, layer.kernel];
            convs.push(weighted(&format!("conv{}", i + 1), &shape, 6.0));
            channels = layer.channels;
            sides = sides.map(|side| (side + 2 * layer.padding - layer.kernel) / layer.stride + 1);
        }
        let hidden = weighted("hidden", &[config.hidden, channels * sides[0] * sides[1]], 6.0);
        let out = weighted("out", &[config.n_outputs() as i64, config.hidden], 1.0);
        Self { config, convs, hidden, out }
    }

    /// Where the network is.
    pub(super) fn device(&self) -> Device {
        self.out[0].device()
    }

    /// The raw outputs.
    ///
    /// # Shapes
    /// - `earlier`, `now`: `[B, H, W, 3]` in `[0, 1]`
    /// - returns `[B, N]`: as many numbers as [`Reads`] says
    pub(super) fn forward(&self, earlier: &Tensor, now: &Tensor) -> Tensor {
        let [b, height, width, _] = dims::<4>(now);
        let wanted = [self.config.height, self.config.width];
        assert_eq!([height, width], wanted, "a probe sees frames of the size it was fitted on");
        let Backend { device, kind } = Backend::on(self.device());
        let (earlier, now) = (earlier.to_device(device), now.to_device(device));
        let pair = Tensor::cat(&[&now * 2.0 - 1.0, (&now - earlier) * 2.0], 3); // [B, H, W, 6]
        let mut x = pair.permute([0, 3, 1, 2]).to_kind(kind);
        for (layer, [weight, bias]) in self.config.layers.iter().zip(&self.convs) {
            let (weight, bias) = (weight.to_kind(kind), bias.to_kind(kind));
            x = x.conv2d(&weight, Some(&bias), [layer.stride; 2], [layer.padding; 2], [1; 2], 1).relu();
        }
        let x = x.to_kind(Kind::Float).reshape([b, -1]);
        let x = x.linear(&self.hidden[0], Some(&self.hidden[1])).relu();
        x.linear(&self.out[0], Some(&self.out[1]))
    }
}

/// Why a probe cannot be loaded, or not be used.
#[derive(Debug, thiserror::Error)]
pub enum ProbeError {
    /// The parameters are wrong.
    #[error("cannot load the probe: {0}")]
    Parameters(ParametersError),
    /// The header does not describe one.
    #[error("cannot load the probe: its header does not describe one ({0})")]
    Header(DescriptionError),
    /// The header describes one that cannot be.
    #[error("cannot load the probe: {0}")]
    Config(OutOfRange),
    /// It sees pictures of another size than are shown.
    #[error(
        "this probe sees pictures of {}, and the world model shows {}: choose another with --probe",
        pixels(*.sees), pixels(*.shown)
    )]
    Size {
        /// What it sees.
        sees: Size,
        /// What there is to see.
        shown: Size,
    },
    /// It looks for what cannot happen here.
    #[error(
        "this probe looks for {what} in {sees:?}, and the world model is of {shown:?}: choose another with --probe"
    )]
    World {
        /// What it looks for.
        what: String,
        /// The world that it was fitted for.
        sees: String,
        /// The world that is shown.
        shown: String,
    },
}

/// A size in words: `84 pixels a side`, or `60 x 80 pixels`.
fn pixels(size: Size) -> String {
    if size.height == size.width {
        format!("{} pixels a side", size.height)
    } else {
        format!("{size} pixels")
    }
}

impl From<ParametersError> for ProbeError {
    fn from(met: ParametersError) -> Self {
        Self::Parameters(met)
    }
}

/// A fitted probe, for use.
#[derive(Debug)]
pub struct Probe {
    net: Net,
    /// None where it sees a car on its road.
    readings: Option<Readings>,
}

impl Probe {
    /// The probe whose network `parameters` hold.
    pub fn load(parameters: &Parameters) -> Result<Self, ProbeError> {
        Self::load_on(parameters, Device::Cpu)
    }

    /// The same on a device.
    pub fn load_on(parameters: &Parameters, device: Device) -> Result<Self, ProbeError> {
        let told = describes::<ProbeConfig>(parameters.metadata("config").as_deref());
        let (layout, config) = told.map_err(ProbeError::Header)?;
        config.check().map_err(ProbeError::Config)?;
        let readings = match &config.reads {
            Reads::Car { .. } => None,
            Reads::Events(events) => Some(readings(parameters, events)?),
        };
        let slots = config.slots();
        // Before anything is made: what a header promises, the file must hold.
        parameters.require("probe", &slots, layout)?;
        let mut store = nn::VarStore::new(Device::Cpu);
        // The draw is overwritten at once.
        let net = Net::new(&store.root(), config, &mut ChaCha8Rng::seed_from_u64(0));
        parameters.fill("probe", &slots, layout, &store)?;
        store.freeze();
        if device != Device::Cpu {
            store.set_device(device);
        }
        Ok(Self { net, readings })
    }

    /// `parameters`, which must be those of a probe, in this program's layout.
    pub fn relaid(parameters: &Parameters) -> Result<Parameters, ProbeError> {
        Self::load(parameters)?;
        let layout = layout_of(parameters.metadata("config").as_deref()).map_err(ProbeError::Header)?;
        // Of a probe nothing was ever rearranged: only the mark is new.
        Ok(parameters.relaid("config", &[], layout, LAYOUT).unwrap_or_else(|| parameters.clone()))
    }

    /// Fails where `model` shows pictures of another size than this sees, or a world in which other things happen.
    pub fn require(&self, model: &WorldModel) -> Result<(), ProbeError> {
        let config = &self.net.config;
        let side = |side: i64| u32::try_from(side).unwrap_or_default();
        let sees = Size { height: side(config.height), width: side(config.width) };
        let (shown, spec) = (model.config().vae.size(), model.spec());
        if sees != shown {
            return Err(ProbeError::Size { sees, shown });
        }
        let other = |what: String, sees: &str| {
            let (sees, shown) = (crate::text::shown(sees), crate::text::shown(&spec.name));
            Err(ProbeError::World { what, sees, shown })
        };
        match (&config.reads, &self.readings) {
            // Models from before worlds were described are all of cars, whatever they are called.
            (Reads::Car { .. }, _) => match &model.config().world {
                Some(_) if spec.axes.len() != WorldSpec::default().axes.len() => {
                    other("a car on its road".to_owned(), "car-racing")
                }
                _ => Ok(()),
            },
            (Reads::Events(events), readings) => {
                let is_there = |name: &String| spec.events.iter().any(|event| event.name == *name);
                let world = readings.as_ref().map_or("", |readings| &readings.world);
                match events.iter().find(|name| !is_there(name)) {
                    Some(name) => other(format!("the event {:?}", crate::text::shown(name)), world),
                    None => Ok(()),
                }
            }
        }
    }

    /// What it reads.
    pub fn reads(&self) -> &Reads {
        &self.net.config.reads
    }

    /// What is known of what it reads; nothing where that is a car on its road.
    pub fn readings(&self) -> Option<&Readings> {
        self.readings.as_ref()
    }

    /// Steps from the earlier picture to the present one.
    pub fn gap(&self) -> usize {
        self.readings.as_ref().map_or(sight::GAP, |readings| readings.gap)
    }

    /// The network in `store` as parameters, with what else is told in the header.
    pub(super) fn parameters_of(
        config: &ProbeConfig,
        store: &nn::VarStore,
        readings: Option<&Readings>,
        errors: String,
    ) -> Parameters {
        let told =
            |readings| serde_json::to_string(readings).unwrap_or_else(|e| unreachable!("plain data: {e}"));
        let readings = readings.map(|readings: &Readings| ("readings", told(readings)));
        let metadata: Vec<_> =
            [("config", described(config)), ("errors", errors)].into_iter().chain(readings).collect();
        Parameters::stored(&[("probe", store, &config.slots())], &metadata)
    }

    /// The numbers that the network makes of the pictures `now`, each [`gap`](Self::gap) steps after the one in `earlier`:
    /// a row each, as [`reads`](Self::reads) says.
    ///
    /// Where both are the same picture nothing moves.
    pub fn read(&self, earlier: &[Frame], now: &[Frame]) -> Rows {
        assert_eq!(earlier.len(), now.len(), "pictures come in pairs");
        let mut rows = Rows { width: self.net.config.n_outputs(), values: Vec::new() };
        for (earlier, now) in earlier.chunks(BATCH).zip(now.chunks(BATCH)) {
            let device = self.net.device();
            let [earlier, now] = [earlier, now].map(|frames| from_frames_on(device, frames));
            let outputs = tch::no_grad(|| self.net.forward(&earlier, &now));
            rows.values.extend(to_vec(&outputs));
        }
        rows
    }

    /// The same of each picture of a clip. Before the first [`gap`](Self::gap) nothing is known, so there nothing moves.
    pub fn read_clip(&self, clip: &[Frame]) -> Rows {
        self.read_every(clip, 1)
    }

    /// The same of a clip of one picture in so many steps.
    pub(super) fn read_every(&self, clip: &[Frame], steps: usize) -> Rows {
        let n_still = (self.gap() / steps).clamp(1, clip.len().max(1));
        let earlier: Vec<_> = clip.iter().take(n_still).chain(clip).take(clip.len()).cloned().collect();
        self.read(&earlier, clip)
    }

    /// What pictures of a car on its road show, each [`gap`](Self::gap) steps after the one in `earlier`.
    pub(super) fn sights(&self, earlier: &[Frame], now: &[Frame]) -> Vec<Sight> {
        sights(&self.read(earlier, now))
    }

    /// The same of each picture of a clip. The motion in the first [`gap`](Self::gap) is that of the one after them.
    pub(super) fn sights_of(&self, clip: &[Frame]) -> Vec<Sight> {
        self.sights_every(clip, 1)
    }

    /// The same of a clip of one picture in so many steps.
    pub(super) fn sights_every(&self, clip: &[Frame], steps: usize) -> Vec<Sight> {
        let (mut sights, gap) = (sights(&self.read_every(clip, steps)), (self.gap() / steps).max(1));
        if let Some(&first) = sights.get(gap) {
            sights[..gap].iter_mut().for_each(|sight| *sight = sight.moving_as(&first));
        }
        sights
    }
}

fn sights(rows: &Rows) -> Vec<Sight> {
    (0..rows.len()).map(|i| Sight::from_outputs(rows.row(i))).collect()
}

/// What a header tells of what is read.
fn readings(parameters: &Parameters, events: &[String]) -> Result<Readings, ProbeError> {
    let told = parameters.metadata("readings");
    let told = told.ok_or(ProbeError::Header(DescriptionError::Missing))?;
    within("the length of the readings", told.len(), 0..=MAX_TOLD).map_err(ProbeError::Config)?;
    let readings: Readings =
        serde_json::from_str(&told).map_err(|met| ProbeError::Header(DescriptionError::Json(met)))?;
    readings.check(events).map_err(ProbeError::Config)?;
    Ok(readings)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world_model::{WorldModelConfig, untrained};

    /// A network that has learned nothing.
    fn blank(config: &ProbeConfig, readings: Option<&Readings>) -> (nn::VarStore, Parameters) {
        let store = nn::VarStore::new(Device::Cpu);
        Net::new(&store.root(), config.clone(), &mut ChaCha8Rng::seed_from_u64(1));
        let parameters = Probe::parameters_of(config, &store, readings, String::new());
        (store, parameters)
    }

    /// Of a world in which a goal can be reached.
    fn readings() -> Readings {
        let progress = ProgressScale { mean: 0.5, deviation: 2.0, clip: 8.0, unsafe_cost: 0.25 };
        let (world, stretches) = ("arm".to_owned(), vec![1.0]);
        Readings { world, gap: 2, stretches, progress: Some(progress), change: Some(0.1) }
    }

    #[test]
    fn layers_follow_from_the_size() {
        let layers = |height, width| {
            let config = ProbeConfig::of_size(Size { height, width }, Reads::Car { contacts: false });
            config.check().unwrap();
            config.layers.iter().map(|layer| (layer.channels, layer.kernel)).collect::<Vec<_>>()
        };
        assert_eq!(layers(84, 84), [(16, 4), (32, 3), (48, 4), (64, 3)], "as those that are shipped");
        assert_eq!(layers(128, 128), [(16, 4), (32, 3), (48, 4), (64, 3), (64, 3)]);
        assert_eq!(layers(60, 80).len(), 4);
        assert_eq!(layers(8, 8).len(), 1);
        assert_eq!(layers(8, 1024).len(), 2, "the smaller side has no more");
        assert_eq!(layers(1024, 1024).len(), 8);
    }

    #[test]
    fn the_car_racing_probe_is_small() {
        let (store, _) = blank(&ProbeConfig::for_world(&WorldSpec::default()), None);

        let n_parameters: usize = store.variables().values().map(Tensor::numel).sum();

        assert!(n_parameters < 300_000, "{n_parameters} parameters");
    }

    #[test]
    fn files_from_before_worlds_were_described_are_of_cars() {
        let read = |text: &str| serde_json::from_str::<ProbeConfig>(text);
        let layers = r#""layers":[{"channels":8,"kernel":4,"stride":2,"padding":0}],"hidden":32"#;
        let car = read(&format!(r#"{{"side":20,{layers}}}"#)).unwrap();
        assert_eq!((car.height, car.width, &car.reads), (20, 20, &Reads::Car { contacts: false }));
        assert_eq!(
            serde_json::to_string(&car).unwrap(),
            format!(r#"{{"side":20,{layers},"obstacles":false}}"#),
            "and are written so"
        );
        let obstacles = read(&format!(r#"{{"side":20,{layers},"obstacles":true}}"#)).unwrap();
        assert_eq!(obstacles.reads, Reads::Car { contacts: true });
        let arm = read(&format!(r#"{{"height":20,"width":30,{layers},"reads":["goal"]}}"#)).unwrap();
        assert_eq!((arm.width, &arm.reads, arm.n_outputs()), (30, &Reads::Events(vec!["goal".into()]), 2));
        assert_eq!(read(&serde_json::to_string(&arm).unwrap()).unwrap(), arm);
        for wrong in
            [r#"{"side":20,"height":20,"#, r#"{"height":20,"#, r#"{"side":20,"obstacles":true,"reads":[],"#]
        {
            assert!(read(&format!("{wrong}{layers}}}")).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_gap_is_about_the_same_time_at_any_rate() {
        assert_eq!([50.0, 12.5, 30.0, 5.0, 200.0].map(gap), [4, 1, 2, 1, 16]);
    }

    #[test]
    fn what_is_told_of_events_must_fit_them() {
        let reads = Reads::Events(vec!["goal".to_owned()]);
        let config = ProbeConfig::of_size(Size { height: 12, width: 20 }, reads);
        let load = |readings: Option<&Readings>| Probe::load(&blank(&config, readings).1);
        let probe = load(Some(&readings())).unwrap();
        assert_eq!((probe.gap(), probe.readings()), (2, Some(&readings())));
        let scale = readings().progress.unwrap();
        for wrong in [
            Readings { gap: 0, ..readings() },
            Readings { stretches: vec![], ..readings() },
            Readings { stretches: vec![-1.0], ..readings() },
            Readings { progress: Some(ProgressScale { clip: 0.0, ..scale }), ..readings() },
            Readings { change: Some(0.0), ..readings() },
        ] {
            assert!(matches!(load(Some(&wrong)), Err(ProbeError::Config(_))), "{wrong:?}");
        }
        assert!(matches!(load(None), Err(ProbeError::Header(_))), "nothing is told");
    }

    #[test]
    fn a_probe_of_another_world_is_refused() {
        let model = untrained(&WorldModelConfig::tiny(), &mut ChaCha8Rng::seed_from_u64(0));
        let require = |config: &ProbeConfig, readings: Option<&Readings>| {
            Probe::load(&blank(config, readings).1).unwrap().require(&model).map_err(|met| met.to_string())
        };
        assert_eq!(require(&ProbeConfig::tiny(), None), Ok(()));
        let size = Size { height: 20, width: 20 };
        let of = |name: &str, size| ProbeConfig::of_size(size, Reads::Events(vec![name.to_owned()]));
        assert_eq!(require(&of("grass", size), Some(&readings())), Ok(()));
        assert!(
            require(&of("goal", size), Some(&readings()))
                .unwrap_err()
                .contains(r#"the event "goal" in "arm""#)
        );
        let large = require(&of("grass", Size { height: 20, width: 30 }), Some(&readings())).unwrap_err();
        assert!(large.contains("of 20 x 30 pixels, and the world model shows 20 pixels a side"), "{large}");
    }

    #[test]
    fn a_clip_is_watched_picture_by_picture() {
        let probe = Probe::load(&blank(&ProbeConfig::tiny(), None).1).unwrap();
        let clip: Vec<_> = (0..6u8).map(|i| Frame::square(20, vec![40 * i; 1200])).collect();

        let sights = probe.sights_of(&clip);

        assert_eq!(sights.len(), 6);
        assert_eq!(sights[0].road_velocity, sights[probe.gap()].road_velocity, "no motion is seen before");
        let alone = probe.sights(&clip[1..2], &clip[5..])[0];
        assert!((sights[5].lateral - alone.lateral).abs() < 0.02, "four steps apart");
    }
}
