//! What stand-ins see with: a small network that reads off a picture where on the road the car is, how it moves, and what it
//! touches.
//!
//! It sees what a person sees: the present picture, and one of a moment before for the motion.

use rand::{Rng, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use tch::{Device, Kind, Tensor, nn};

use crate::env::{Frame, Truth};
use crate::tensor::limits::{MAX_ACTIVATIONS, MAX_LAYERS, MAX_SIDE, MAX_WIDTH, OutOfRange, within};
use crate::tensor::{
    DescriptionError, LAYOUT, Parameters, ParametersError, Slot, described, describes, dims, from_frames,
    layout_of, to_vec, uniform,
};
use crate::world_model::{Layer, WorldModel, fast_kind};

/// Steps from the earlier picture to the present one.
pub const GAP: usize = 4;
/// Pictures that are looked at together.
const BATCH: usize = 128;
/// Numbers that come out first: two logits, then what [`Sight`] measures, each divided by its scale.
pub(super) const N_MEASURED: usize = 8;
/// Where the logits of contacts begin, if there are obstacles.
pub(super) const CONTACTS: usize = 2 + N_MEASURED;
/// Units, 1, 1, units a second twice, radians three times.
pub(super) const SCALES: [f32; N_MEASURED] = [5.0, 1.0, 1.0, 15.0, 15.0, 0.5, 0.5, 1.0];
/// Beyond this many units from the center line the road is out of sight.
pub(super) const FARTHEST: f32 = 25.0;

/// What a picture shows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sight {
    /// Probability that at least one wheel is off the road, in `[0, 1]`.
    pub off_road: f32,
    /// Probability that all four are, in `[0, 1]`.
    pub all_off: f32,
    /// Signed distance from the center line in units. Positive is right of it.
    pub lateral: f32,
    /// Heading of the car against that of the road in radians. Positive points left of it.
    pub heading_error: f32,
    /// Velocity along and to the right of the road, units a second.
    pub road_velocity: [f32; 2],
    /// The road's change of direction over the next 5, 10 and 20 nodes, radians. Positive is left.
    pub bends: [f32; 3],
    /// Probability that a wheel is in a chuckhole, in `[0, 1]`. 0 where there are none.
    pub chuckhole: f32,
    /// Probability that the hull touches another car, in `[0, 1]`. 0 where there are none.
    pub car: f32,
}

impl Sight {
    /// What a perfect probe sees.
    pub fn of(truth: &Truth) -> Self {
        let share = |is: bool| if is { 1.0 } else { 0.0 };
        let contacts = truth.contacts.unwrap_or_default();
        Self {
            off_road: share(truth.wheels_off > 0),
            all_off: share(truth.wheels_off == 4),
            lateral: truth.lateral.clamp(-FARTHEST, FARTHEST),
            heading_error: truth.heading_error,
            road_velocity: truth.road_velocity,
            bends: truth.bends,
            chuckhole: share(contacts.chuckhole),
            car: share(contacts.car),
        }
    }

    /// Something a pilot can drive by. What no picture shows, such as the place on the map, is left at zero.
    pub fn as_truth(&self) -> Truth {
        let [along, across] = self.road_velocity;
        Truth {
            speed: along.hypot(across),
            road_velocity: self.road_velocity,
            lateral: self.lateral,
            heading_error: self.heading_error,
            bends: self.bends,
            wheels_off: if self.all_off > 0.5 { 4 } else { u8::from(self.off_road > 0.5) },
            ..Truth::default()
        }
    }

    /// This sight moved towards a `later` one by a `share` in `[0, 1]`.
    pub fn blended(&self, later: &Self, share: f32) -> Self {
        let mix = |a: f32, b: f32| a + share * (b - a);
        Self {
            off_road: mix(self.off_road, later.off_road),
            all_off: mix(self.all_off, later.all_off),
            lateral: mix(self.lateral, later.lateral),
            heading_error: mix(self.heading_error, later.heading_error),
            road_velocity: [0, 1].map(|i| mix(self.road_velocity[i], later.road_velocity[i])),
            bends: [0, 1, 2].map(|i| mix(self.bends[i], later.bends[i])),
            chuckhole: mix(self.chuckhole, later.chuckhole),
            car: mix(self.car, later.car),
        }
    }

    /// The sight that the network's numbers mean.
    fn from_outputs(outputs: &[f32]) -> Self {
        let chance = |logit: f32| 1.0 / (1.0 + (-logit).exp());
        let measured = |i: usize| outputs[2 + i] * SCALES[i];
        Self {
            off_road: chance(outputs[0]),
            all_off: chance(outputs[1]),
            lateral: measured(0),
            heading_error: measured(1).atan2(measured(2)),
            road_velocity: [measured(3), measured(4)],
            bends: [measured(5), measured(6), measured(7)],
            chuckhole: outputs.get(CONTACTS).map_or(0.0, |logit| chance(*logit)),
            car: outputs.get(CONTACTS + 1).map_or(0.0, |logit| chance(*logit)),
        }
    }

    /// What the network's measuring outputs should be.
    pub(super) fn targets(&self) -> [f32; N_MEASURED] {
        let (sin, cos) = self.heading_error.sin_cos();
        let [along, across] = self.road_velocity;
        let [near, middle, far] = self.bends;
        let values = [self.lateral, sin, cos, along, across, near, middle, far];
        std::array::from_fn(|i| values[i] / SCALES[i])
    }
}

/// The shape of a [`Probe`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProbeConfig {
    /// P: pixels a side of a frame.
    pub side: i64,
    /// Convolutions, from the frame inwards.
    pub layers: Vec<Layer>,
    /// Units of the hidden layer behind them.
    pub hidden: i64,
    /// Whether it looks for obstacles that the car touches.
    #[serde(default)]
    pub obstacles: bool,
}

impl ProbeConfig {
    /// For frames of 84 pixels. 190 000 parameters.
    pub fn car_racing() -> Self {
        Self {
            side: 84,
            layers: layers(&[(16, 4), (32, 3), (48, 4), (64, 3)]),
            hidden: 128,
            obstacles: false,
        }
    }

    /// For frames of 128 pixels with obstacles in them.
    pub fn obstacle_car_racing() -> Self {
        let layers = layers(&[(16, 4), (32, 3), (48, 4), (64, 3), (64, 3)]);
        Self { side: 128, layers, hidden: 128, obstacles: true }
    }

    /// A toy for frames of 20 pixels.
    pub fn tiny() -> Self {
        Self { side: 20, layers: layers(&[(8, 4), (16, 4)]), hidden: 32, obstacles: false }
    }

    /// Fails where no network can be of this shape.
    pub fn check(&self) -> Result<(), OutOfRange> {
        within("the side of the probe's frames", self.side, 1..=MAX_SIDE)?;
        within("the number of the probe's convolutions", self.layers.len(), 1..=MAX_LAYERS)?;
        within("the number of the probe's hidden units", self.hidden, 1..=MAX_WIDTH)?;
        let side = self.bottom()?;
        let depth = self.layers.last().map_or(0, |layer| layer.channels);
        within("how many features the probe has", depth * side * side, 1..=MAX_ACTIVATIONS)
    }

    /// Pixels a side behind the convolutions.
    fn bottom(&self) -> Result<i64, OutOfRange> {
        let layers = self.layers.iter().enumerate();
        layers.into_iter().try_fold(self.side, |side, (i, layer)| {
            layer.convolved(&format!("the probe's conv{}", i + 1), side)
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
        let side = self.bottom().unwrap_or_default();
        slots.extend(weighted("hidden", &[self.hidden, channels * side * side]));
        slots.extend(weighted("out", &[self.n_outputs() as i64, self.hidden]));
        slots
    }

    /// How many numbers come out.
    pub(super) fn n_outputs(&self) -> usize {
        if self.obstacles { CONTACTS + 2 } else { CONTACTS }
    }
}

fn layers(all: &[(i64, i64)]) -> Vec<Layer> {
    all.iter().map(|&(channels, kernel)| Layer { channels, kernel, stride: 2, padding: 0 }).collect()
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
        let (mut channels, mut side) = (6, config.side);
        let mut convs = Vec::new();
        for (i, layer) in config.layers.iter().enumerate() {
            let shape = [layer.channels, channels, layer.kernel, layer.kernel];
            convs.push(weighted(&format!("conv{}", i + 1), &shape, 6.0));
            channels = layer.channels;
            side = (side + 2 * layer.padding - layer.kernel) / layer.stride + 1;
        }
        let hidden = weighted("hidden", &[config.hidden, channels * side * side], 6.0);
        let out = weighted("out", &[config.n_outputs() as i64, config.hidden], 1.0);
        Self { config, convs, hidden, out }
    }

    /// The raw outputs.
    ///
    /// # Shapes
    /// - `earlier`, `now`: `[B, P, P, 3]` in `[0, 1]`
    /// - returns `[B, 10]`, or `[B, 12]` with obstacles
    pub(super) fn forward(&self, earlier: &Tensor, now: &Tensor) -> Tensor {
        let [b, p, ..] = dims::<4>(now);
        assert_eq!(p, self.config.side, "a probe sees frames of the size it was fitted on");
        let kind = fast_kind();
        let pair = Tensor::cat(&[now * 2.0 - 1.0, (now - earlier) * 2.0], 3); // [B, P, P, 6]
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

/// Why a probe cannot be loaded.
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
        "this probe sees pictures of {sees} pixels a side, and the world model shows {shown}: choose another with --probe"
    )]
    Side {
        /// What it sees.
        sees: i64,
        /// What there is to see.
        shown: i64,
    },
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
}

impl Probe {
    /// The probe whose network `parameters` hold.
    pub fn load(parameters: &Parameters) -> Result<Self, ProbeError> {
        let told = describes::<ProbeConfig>(parameters.metadata("config").as_deref());
        let (layout, config) = told.map_err(ProbeError::Header)?;
        config.check().map_err(ProbeError::Config)?;
        let slots = config.slots();
        // Before anything is made: what a header promises, the file must hold.
        parameters.require("probe", &slots, layout)?;
        let mut store = nn::VarStore::new(Device::Cpu);
        // The draw is overwritten at once.
        let net = Net::new(&store.root(), config, &mut ChaCha8Rng::seed_from_u64(0));
        parameters.fill("probe", &slots, layout, &store)?;
        store.freeze();
        Ok(Self { net })
    }

    /// `parameters`, which must be those of a probe, in this program's layout.
    pub fn relaid(parameters: &Parameters) -> Result<Parameters, ProbeError> {
        Self::load(parameters)?;
        let layout = layout_of(parameters.metadata("config").as_deref()).map_err(ProbeError::Header)?;
        // Of a probe nothing was ever rearranged: only the mark is new.
        Ok(parameters.relaid("config", &[], layout, LAYOUT).unwrap_or_else(|| parameters.clone()))
    }

    /// Fails where `model` shows pictures of another size than this sees.
    pub fn require(&self, model: &WorldModel) -> Result<(), ProbeError> {
        let (sees, shown) = (self.net.config.side, model.config().vae.side);
        if sees == shown { Ok(()) } else { Err(ProbeError::Side { sees, shown }) }
    }

    /// The network in `store` as parameters, with `metadata` beside its shape in the header.
    pub(super) fn parameters_of(config: &ProbeConfig, store: &nn::VarStore, errors: String) -> Parameters {
        let metadata = [("config", described(config)), ("errors", errors)];
        Parameters::stored(&[("probe", store, &config.slots())], &metadata)
    }

    /// What the pictures `now` show, each [`GAP`] steps after the one in `earlier`.
    ///
    /// Where both are the same picture nothing moves.
    pub fn read(&self, earlier: &[Frame], now: &[Frame]) -> Vec<Sight> {
        assert_eq!(earlier.len(), now.len(), "pictures come in pairs");
        let mut sights = Vec::with_capacity(now.len());
        let n_outputs = self.net.config.n_outputs();
        for (earlier, now) in earlier.chunks(BATCH).zip(now.chunks(BATCH)) {
            let outputs = tch::no_grad(|| self.net.forward(&from_frames(earlier), &from_frames(now)));
            sights.extend(to_vec(&outputs).chunks_exact(n_outputs).map(Sight::from_outputs));
        }
        sights
    }

    /// What each picture of a clip shows. The motion in the first [`GAP`] is that of the one after them.
    pub fn watch(&self, clip: &[Frame]) -> Vec<Sight> {
        let n_still = GAP.min(clip.len());
        let earlier: Vec<_> = clip[..n_still].iter().chain(clip).take(clip.len()).cloned().collect();
        let mut sights = self.read(&earlier, clip);
        if let Some(&Sight { road_velocity, .. }) = sights.get(GAP) {
            for sight in &mut sights[..GAP] {
                sight.road_velocity = road_velocity;
            }
        }
        sights
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A network that has learned nothing.
    fn blank(config: &ProbeConfig) -> (nn::VarStore, Probe) {
        let store = nn::VarStore::new(Device::Cpu);
        Net::new(&store.root(), config.clone(), &mut ChaCha8Rng::seed_from_u64(1));
        let probe = Probe::load(&Probe::parameters_of(config, &store, String::new())).unwrap();
        (store, probe)
    }

    #[test]
    fn the_car_racing_probe_is_small() {
        let (store, _) = blank(&ProbeConfig::car_racing());

        let n_parameters: usize = store.variables().values().map(Tensor::numel).sum();

        assert!(n_parameters < 300_000, "{n_parameters} parameters");
    }

    // By hand, with the scales of assets/FORMAT.md: −3 / 5, sin 0.4, cos 0.4, 30 / 15, −2 / 15, 0.1 / 0.5, −0.2 / 0.5, 0.6.
    #[test]
    fn the_outputs_of_a_sight_mean_that_sight() {
        let sight = Sight {
            lateral: -3.0,
            heading_error: 0.4,
            road_velocity: [30.0, -2.0],
            bends: [0.1, -0.2, 0.6],
            ..Sight::default()
        };
        let outputs = [-0.6, 0.389_418, 0.921_061, 2.0, -0.133_333, 0.2, -0.4, 0.6];
        for (found, wanted) in sight.targets().into_iter().zip(outputs) {
            assert!((found - wanted).abs() < 1e-5, "{found} instead of {wanted}");
        }

        // A logit of ln 3 is a chance of three quarters.
        let read = Sight::from_outputs(&[[1.098_612, -1.098_612].as_slice(), &outputs].concat());
        assert!((read.off_road - 0.75).abs() < 1e-5 && (read.all_off - 0.25).abs() < 1e-5, "{read:?}");
        assert!((read.heading_error - 0.4).abs() < 1e-5 && (read.lateral + 3.0).abs() < 1e-5, "{read:?}");
        assert!((read.road_velocity[0] - 30.0).abs() < 1e-4, "{read:?}");
        assert!((read.road_velocity[1] + 2.0).abs() < 1e-4, "{read:?}");
        assert!((read.bends[1] + 0.2).abs() < 1e-5 && (read.bends[2] - 0.6).abs() < 1e-5, "{read:?}");
    }

    #[test]
    fn a_clip_is_watched_picture_by_picture() {
        let (_, probe) = blank(&ProbeConfig::tiny());
        let clip: Vec<_> = (0..6u8).map(|i| Frame::new(20, vec![40 * i; 1200])).collect();

        let sights = probe.watch(&clip);

        assert_eq!(sights.len(), 6);
        assert_eq!(sights[0].road_velocity, sights[GAP].road_velocity, "no motion is seen before");
        let alone = probe.read(&clip[1..2], &clip[5..])[0];
        assert!((sights[5].lateral - alone.lateral).abs() < 0.02, "four steps apart");
    }
}
