//! Vision: a variational autoencoder from frames to latents and back (method §3).
//!
//! Pictures are `[B, H, W, C]` throughout, channels last, which is what the processor likes best.

use rand::Rng;
use serde::{Deserialize, Serialize};
use tch::{Kind, Tensor, nn};

use crate::tensor::limits::{MAX_ACTIVATIONS, MAX_LATENTS, MAX_LAYERS, MAX_SIDE, OutOfRange, within};
use crate::tensor::{Slot, dims};
use crate::world::Size;
use crate::world_model::layers::{Conv, Deconv, Layer, Linear, channels_last};

/// The shape of a [`Vae`], and what its loss weighs.
///
/// In files a square has one `side`, as before there were others, and any other picture a `height` and a `width`.
///
/// The encoder's convolutions may leave rows and columns over where a side is no multiple of what they move by. The
/// decoder makes up for them. Where it would paint another size than that of the frames, and has as many layers as the
/// encoder, each of its layers paints as many more rows below, and columns at the right, as it lacks of what the encoder
/// has at the same depth (PyTorch's `output_padding`): no more than its padding cuts off there.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "VaeFile", into = "VaeFile")]
pub struct VaeConfig {
    /// H: rows of a frame.
    pub height: i64,
    /// W: pixels of a row.
    pub width: i64,
    /// Z: how many latents (`n_z`).
    pub latent: i64,
    /// From the frame inwards.
    pub encoder: Vec<Layer>,
    /// From the latents outwards. The last makes the three colors.
    pub decoder: Vec<Layer>,
    /// τ: nats per latent below which the divergence costs nothing more.
    pub free_bits: f64,
    /// How many times more the bluest and the yellowest pixels count, and those around them: 0 in the paper.
    pub emphasis: f64,
    /// How much pixels of rare colors count more, and those around them: 0 in the paper, 1 as
    /// [`fit`](crate::world_model::fit) says.
    pub rarity: f64,
}

/// A [`VaeConfig`] as files have it.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct VaeFile {
    /// Of a square.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    side: Option<i64>,
    /// Of any other picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    height: Option<i64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    width: Option<i64>,
    latent: i64,
    encoder: Vec<Layer>,
    decoder: Vec<Layer>,
    free_bits: f64,
    #[serde(default)]
    emphasis: f64,
    #[serde(default, skip_serializing_if = "is_none")]
    rarity: f64,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde hands over a reference")]
fn is_none(strength: &f64) -> bool {
    *strength == 0.0
}

/// Why a file does not say the size of vision's frames.
#[derive(Debug, thiserror::Error)]
#[error("vision has either a `side` or a `height` and a `width`")]
struct SizeError;

impl TryFrom<VaeFile> for VaeConfig {
    type Error = SizeError;

    fn try_from(file: VaeFile) -> Result<Self, SizeError> {
        let (height, width) = match (file.side, file.height, file.width) {
            (Some(side), None, None) => (side, side),
            (None, Some(height), Some(width)) => (height, width),
            _ => return Err(SizeError),
        };
        let VaeFile { latent, encoder, decoder, free_bits, emphasis, rarity, .. } = file;
        Ok(Self { height, width, latent, encoder, decoder, free_bits, emphasis, rarity })
    }
}

impl From<VaeConfig> for VaeFile {
    fn from(config: VaeConfig) -> Self {
        let VaeConfig { height, width, latent, encoder, decoder, free_bits, emphasis, rarity } = config;
        let is_square = height == width;
        let (side, other) = (is_square.then_some(height), (!is_square).then_some([height, width]));
        let [height, width] = [other.map(|sides| sides[0]), other.map(|sides| sides[1])];
        Self { side, height, width, latent, encoder, decoder, free_bits, emphasis, rarity }
    }
}

impl VaeConfig {
    /// The paper's network for Car Racing (Table 3): 84 pixels, 32 latents, 3 337 747 parameters.
    pub fn car_racing() -> Self {
        Self::paper(24)
    }

    /// The same with `channels` in the first layer and proportionally many in the others.
    pub(super) fn paper(channels: i64) -> Self {
        // DIFFERENCE: Table 3 prints the third stride as 1, which does not give the sizes it prints. It is 2.
        let encoder = [(1, 4, 2), (2, 4, 2), (4, 4, 2), (8, 4, 1), (16, 4, 1)];
        let decoder = [(8, 4, 1), (4, 4, 1), (2, 5, 2), (1, 5, 2)];
        let of = |&(factor, kernel, stride): &_| (factor * channels, kernel, stride);
        let decoder: Vec<_> = decoder.iter().map(of).chain([(3, 4, 2)]).collect();
        Self {
            height: 84,
            width: 84,
            latent: 32,
            encoder: layers(&encoder.each_ref().map(of), 0),
            decoder: layers(&decoder, 0),
            free_bits: 0.5,
            emphasis: 0.0,
            rarity: 0.0,
        }
    }

    /// The paper's network for Obstacle Car Racing (Table 3): 128 pixels, 64 latents, 25 453 571 parameters.
    pub fn obstacle_car_racing() -> Self {
        // DIFFERENCE: Table 3 prints other widths for the decoder. These are those of the authors' code.
        Self::halving([128; 2], &[1, 2, 4, 8, 16].map(|factor| 64 * factor))
    }

    /// The same layers with a quarter of the channels, 2 185 571 parameters: what two cores can train.
    pub fn obstacle_compact() -> Self {
        // DIFFERENCE: obstacles are so small that without emphasis none was to be seen after 3 000 updates.
        let narrower = Self::halving([128; 2], &[1, 2, 4, 8, 16].map(|factor| 16 * factor));
        Self { emphasis: 15.0, ..narrower }
    }

    /// As many halvings of a picture of `height` and `width` as there are `channels`, and as many doublings back.
    pub(super) fn halving([height, width]: [i64; 2], channels: &[i64]) -> Self {
        let of = |channels: &i64| (*channels, 4, 2);
        let encoder: Vec<_> = channels.iter().map(of).collect();
        let decoder: Vec<_> = channels.iter().rev().skip(1).chain([&3]).map(of).collect();
        Self {
            height,
            width,
            latent: 64,
            encoder: layers(&encoder, 1),
            decoder: layers(&decoder, 1),
            free_bits: 2.0,
            emphasis: 0.0,
            rarity: 0.0,
        }
    }

    /// A toy for tests: 20 pixels, 4 latents.
    pub fn tiny() -> Self {
        let encoder = layers(&[(8, 4, 2), (16, 4, 2)], 0);
        let decoder = layers(&[(8, 5, 2), (3, 4, 2)], 0);
        let (emphasis, rarity) = (0.0, 0.0);
        Self { height: 20, width: 20, latent: 4, encoder, decoder, free_bits: 0.1, emphasis, rarity }
    }

    /// The size of the frames.
    pub fn size(&self) -> Size {
        let [height, width] = self.sides().map(|side| u32::try_from(side).unwrap_or_default());
        Size { height, width }
    }

    /// Height and width of the frames.
    pub(super) fn sides(&self) -> [i64; 2] {
        [self.height, self.width]
    }

    /// What errors call height and width.
    fn names(&self) -> [&'static str; 2] {
        if self.height == self.width { ["side"; 2] } else { ["height", "width"] }
    }

    /// Fails where no network can be of this shape.
    pub fn check(&self) -> Result<(), OutOfRange> {
        for (name, side) in self.names().iter().zip(self.sides()) {
            within(&format!("the {name} of vision's frames"), side, 1..=MAX_SIDE)?;
        }
        within("the number of vision's latents", self.latent, 1..=MAX_LATENTS)?;
        within("the number of vision's encoding layers", self.encoder.len(), 1..=MAX_LAYERS)?;
        within("the number of vision's decoding layers", self.decoder.len(), 1..=MAX_LAYERS)?;
        within("vision's free bits", self.free_bits, 0.0..=1e6)?;
        within("vision's emphasis", self.emphasis, 0.0..=1e6)?;
        within("vision's emphasis of rare colors", self.rarity, 0.0..=1e6)?;
        let mut sides = self.sides();
        for (i, layer) in self.encoder.iter().enumerate() {
            sides = layer.convolved_sides(&format!("vision's conv{}", i + 1), sides)?;
        }
        for ((i, layer), more) in self.decoder.iter().enumerate().zip(self.output_padding()) {
            sides = layer.deconvolved(&format!("vision's deconv{}", i + 1), sides, more)?;
        }
        for ((name, found), side) in self.names().iter().zip(sides).zip(self.sides()) {
            if found != side {
                let wanted = format!("the {name} of the frames, {side}");
                let what = format!("the {name} of the pictures that vision paints");
                return Err(OutOfRange::new(what, found, wanted));
            }
        }
        let n_colors = self.decoder.last().map_or(0, |layer| layer.channels);
        within("the number of colors that vision paints", n_colors, 3..=3)?;
        within("how many features vision has", self.n_features(), 1..=MAX_ACTIVATIONS)
    }

    /// How the network is stored.
    pub fn slots(&self) -> Vec<Slot> {
        let mut slots = Vec::new();
        let mut channels = 3;
        for (i, layer) in self.encoder.iter().enumerate() {
            slots.extend(Conv::slots(&format!("conv{}", i + 1), channels, *layer));
            channels = layer.channels;
        }
        let n_features = self.n_features();
        slots.extend(Linear::slots("fc_mu", n_features, self.latent));
        slots.extend(Linear::slots("fc_logvar", n_features, self.latent));
        slots.extend(Linear::slots("dec_fc", self.latent, n_features));
        for (i, layer) in self.decoder.iter().enumerate() {
            slots.extend(Deconv::slots(&format!("deconv{}", i + 1), channels, *layer));
            channels = layer.channels;
        }
        slots
    }

    /// How many parameters the network has.
    pub(super) fn n_parameters(&self) -> i64 {
        self.slots().iter().map(|slot| slot.shape.iter().product::<i64>()).sum()
    }

    /// How many multiplications it takes to encode and decode a picture.
    pub(super) fn work(&self) -> i64 {
        let mut work = 3 * self.latent * self.n_features();
        let [mut height, mut width] = self.sides();
        let mut channels = 3;
        let weights = |channels: i64, layer: &Layer| channels * layer.channels * layer.kernel * layer.kernel;
        for layer in &self.encoder {
            [height, width] = [height, width].map(|side| layer.shrunk(side));
            work += height * width * weights(channels, layer);
            channels = layer.channels;
        }
        for (layer, more) in self.decoder.iter().zip(self.output_padding()) {
            work += height * width * weights(channels, layer);
            [height, width] = [layer.grown(height) + more[0], layer.grown(width) + more[1]];
            channels = layer.channels;
        }
        work
    }

    /// Numbers where encoder and decoder meet.
    pub(super) fn n_features(&self) -> i64 {
        let [height, width] = self.bottom();
        self.depth() * height * width
    }

    /// Height and width where encoder and decoder meet.
    fn bottom(&self) -> [i64; 2] {
        self.sides().map(|side| self.encoder.iter().fold(side, |side, layer| layer.shrunk(side)))
    }

    /// How many rows and columns each layer of the decoder paints beyond what it does by itself: PyTorch's
    /// `output_padding`.
    pub fn output_padding(&self) -> Vec<[i64; 2]> {
        let [rows, columns] = self.sides().map(|side| self.output_padding_along(side));
        rows.into_iter().zip(columns).map(<[i64; 2]>::from).collect()
    }

    /// The same along one axis, of `side` pixels.
    fn output_padding_along(&self, side: i64) -> Vec<i64> {
        let none = vec![0; self.decoder.len()];
        // From the frame inwards.
        let mut wanted: Vec<i64> = vec![side];
        wanted.extend(self.encoder.iter().scan(side, |side, layer| {
            *side = layer.shrunk(*side);
            Some(*side)
        }));
        let bottom = wanted.pop().unwrap_or(side);
        let painted = self.decoder.iter().fold(bottom, |side, layer| layer.grown(side));
        if painted == side || self.decoder.len() != self.encoder.len() {
            return none;
        }
        let mut from = bottom;
        let more = self.decoder.iter().zip(wanted.iter().rev()).map(|(layer, &wanted)| {
            let more = wanted - layer.grown(std::mem::replace(&mut from, wanted));
            (0..=layer.padding.min(layer.stride - 1)).contains(&more).then_some(more)
        });
        more.collect::<Option<_>>().unwrap_or(none)
    }

    /// Channels where encoder and decoder meet.
    fn depth(&self) -> i64 {
        self.encoder.last().map_or(3, |layer| layer.channels)
    }
}

fn layers(all: &[(i64, i64, i64)], padding: i64) -> Vec<Layer> {
    all.iter().map(|&(channels, kernel, stride)| Layer { channels, kernel, stride, padding }).collect()
}

/// From pictures to latents: the first half of a [`Vae`].
#[derive(Debug)]
pub struct Encoder {
    /// The arithmetic of the convolutions. The rest is `f32`.
    kind: Kind,
    layers: Vec<Conv>,
    mean: Linear,
    log_var: Linear,
}

/// From latents to pictures: the second half of a [`Vae`].
#[derive(Debug)]
pub struct Decoder {
    /// The arithmetic of the convolutions. The rest is `f32`.
    kind: Kind,
    /// Height and width of what the first convolution is given.
    bottom: [i64; 2],
    first: Linear,
    layers: Vec<Deconv>,
}

impl Encoder {
    /// A copy for use alone, its weights already in `kind`. It cannot be trained.
    pub fn for_inference(&self, kind: Kind) -> Self {
        Self {
            kind,
            layers: self.layers.iter().map(|layer| layer.for_inference(kind)).collect(),
            mean: self.mean.for_inference(),
            log_var: self.log_var.for_inference(),
        }
    }

    /// The same numbers under another name, for another thread.
    pub(super) fn shared(&self) -> Self {
        Self {
            kind: self.kind,
            layers: self.layers.iter().map(Conv::shared).collect(),
            mean: self.mean.shared(),
            log_var: self.log_var.shared(),
        }
    }

    /// Mean and logarithm of the variance of the latents of each picture.
    ///
    /// # Shapes
    /// - `pixels`: `[B, H, W, 3]` in `[0, 1]`
    /// - returns two `[B, Z]`
    pub fn encode(&self, pixels: &Tensor) -> (Tensor, Tensor) {
        let [b, ..] = dims::<4>(pixels);
        let mut x = pixels.to_kind(self.kind);
        for layer in &self.layers {
            x = layer.forward(&x, self.kind).relu();
        }
        // DIFFERENCE: features are flattened with the channels last. The same network with its rows in another order.
        let x = x.to_kind(Kind::Float).reshape([b, -1]);
        (self.mean.forward(&x), self.log_var.forward(&x))
    }
}

impl Decoder {
    /// A copy for use alone, its weights already in `kind`. It cannot be trained.
    pub fn for_inference(&self, kind: Kind) -> Self {
        Self {
            kind,
            bottom: self.bottom,
            first: self.first.for_inference(),
            layers: self.layers.iter().map(|layer| layer.for_inference(kind)).collect(),
        }
    }

    /// The same numbers under another name, for another thread.
    pub(super) fn shared(&self) -> Self {
        Self {
            kind: self.kind,
            bottom: self.bottom,
            first: self.first.shared(),
            layers: self.layers.iter().map(Deconv::shared).collect(),
        }
    }

    /// The pictures of latents.
    ///
    /// # Shapes
    /// - `z`: `[B, Z]`
    /// - returns `[B, H, W, 3]` in `(0, 1)`
    pub fn decode(&self, z: &Tensor) -> Tensor {
        let [b, _] = dims(z);
        let [height, width] = self.bottom;
        let mut x = self.first.forward(z).view([b, height, width, -1]).to_kind(self.kind);
        for (i, layer) in self.layers.iter().enumerate() {
            if i > 0 {
                x = x.relu();
            }
            x = layer.forward(&x, self.kind);
        }
        x.to_kind(Kind::Float).sigmoid()
    }
}

/// A trained or trainable autoencoder.
#[derive(Debug)]
pub struct Vae {
    config: VaeConfig,
    /// Its first half.
    pub encoder: Encoder,
    /// Its second half.
    pub decoder: Decoder,
}

impl Vae {
    /// A fresh network under `path`, drawn by `rng` as PyTorch draws it (method §3.5), computing in `kind`.
    pub fn new(path: &nn::Path<'_>, config: VaeConfig, kind: Kind, rng: &mut impl Rng) -> Self {
        let latent = config.latent;
        let mut channels = 3;
        let mut layers = Vec::new();
        for (i, layer) in config.encoder.iter().enumerate() {
            layers.push(Conv::new(&(path / format!("conv{}", i + 1)), channels, *layer, rng));
            channels = layer.channels;
        }
        let n_features = config.n_features();
        let mean = Linear::new(&(path / "fc_mu"), n_features, latent, rng);
        let log_var = Linear::new(&(path / "fc_logvar"), n_features, latent, rng);
        let encoder = Encoder { kind, layers, mean, log_var };
        let first = Linear::new(&(path / "dec_fc"), latent, n_features, rng);
        let mut layers = Vec::new();
        for ((i, layer), more) in config.decoder.iter().enumerate().zip(config.output_padding()) {
            layers.push(Deconv::new(&(path / format!("deconv{}", i + 1)), channels, (*layer, more), rng));
            channels = layer.channels;
        }
        let decoder = Decoder { kind, bottom: config.bottom(), first, layers };
        Self { config, encoder, decoder }
    }

    /// The shape of this network.
    pub fn config(&self) -> &VaeConfig {
        &self.config
    }

    /// As [`Encoder::encode`].
    pub fn encode(&self, pixels: &Tensor) -> (Tensor, Tensor) {
        self.encoder.encode(pixels)
    }

    /// As [`Decoder::decode`].
    pub fn decode(&self, z: &Tensor) -> Tensor {
        self.decoder.decode(z)
    }

    /// The two parts of the loss, each averaged over the batch (method §3.3).
    ///
    /// ```text
    /// z = μ + exp(½ logvar) ε
    /// R = Σ w (x̂ − x)²          over all 3 H W values; w is 1 in the paper
    /// KL = max(−½ Σ (1 + logvar − μ² − exp(logvar)), τ Z)
    /// ```
    ///
    /// # Shapes
    /// - `pixels`: `[B, H, W, 3]`, `noise` (ε): `[B, Z]`
    pub fn loss(&self, pixels: &Tensor, noise: &Tensor) -> VaeLoss {
        self.weighted_loss(pixels, noise, None)
    }

    /// The same where `weights` say how much each pixel counts beside that.
    ///
    /// # Shapes
    /// - `pixels`: `[B, H, W, 3]`, `noise` (ε): `[B, Z]`, `weights`: `[B, H, W, 1]`
    pub(super) fn weighted_loss(&self, pixels: &Tensor, noise: &Tensor, weights: Option<&Tensor>) -> VaeLoss {
        let [b, ..] = dims::<4>(pixels);
        let (mean, log_var) = self.encode(pixels);
        let z = &mean + (&log_var * 0.5).exp() * noise;
        let error: Tensor = self.decode(&z) - pixels;
        let mut square = error.square();
        if self.config.emphasis > 0.0 {
            square *= self.weights(pixels);
        }
        if let Some(weights) = weights {
            square *= weights;
        }
        let reconstruction = square.sum(Kind::Float) / b as f64;
        let terms: Tensor = 1.0 + &log_var - mean.square() - log_var.exp();
        let divergence = terms.sum_dim_intlist(1, false, Kind::Float) * -0.5; // [B]
        let floor = self.config.free_bits * self.config.latent as f64;
        let divergence = divergence.clamp_min(floor).mean(Kind::Float);
        VaeLoss { reconstruction, divergence }
    }

    /// How much each pixel counts: more in and around what is blue or yellow, as obstacles are and road and grass are not.
    ///
    /// # Shapes
    /// - `pixels`: `[B, H, W, 3]`
    /// - returns `[B, H, W, 1]`
    fn weights(&self, pixels: &Tensor) -> Tensor {
        const AROUND: i64 = 2;
        let color = |i| pixels.select(3, i);
        let tint = (color(0).minimum(&color(1)) - color(2)).abs().unsqueeze(1); // [B, 1, H, W]
        let tint = tint.max_pool2d([2 * AROUND + 1; 2], [1; 2], [AROUND; 2], [1; 2], false);
        channels_last(&tint) * self.config.emphasis + 1.0
    }
}

/// What a [`Vae`] is trained to lessen: the sum of both.
#[derive(Debug)]
pub struct VaeLoss {
    /// Squared error summed over a picture: `[]`.
    pub reconstruction: Tensor,
    /// Nats beyond the prior, at least the free ones: `[]`.
    pub divergence: Tensor,
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;
    use tch::Device;

    use super::*;
    use crate::tensor::{normal, to_vec};

    fn rng() -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(0)
    }

    #[test]
    fn the_car_racing_network_has_the_papers_size() {
        let store = nn::VarStore::new(Device::Cpu);
        let vae = Vae::new(&store.root(), VaeConfig::car_racing(), Kind::Float, &mut rng());
        let n_parameters: usize = store.variables().values().map(Tensor::numel).sum();
        assert_eq!(n_parameters, 3_337_747);
        let pixels = Tensor::zeros([2, 84, 84, 3], (Kind::Float, Device::Cpu));
        assert_eq!(vae.decode(&vae.encode(&pixels).0).size(), [2, 84, 84, 3]);
    }

    #[test]
    fn the_networks_for_obstacles_have_the_papers_size_and_a_smaller_one() {
        for (config, size) in
            [(VaeConfig::obstacle_car_racing(), 25_453_571), (VaeConfig::obstacle_compact(), 2_185_571)]
        {
            let store = nn::VarStore::new(Device::Cpu);
            let vae = Vae::new(&store.root(), config, Kind::Float, &mut rng());
            let n_parameters: usize = store.variables().values().map(Tensor::numel).sum();
            assert_eq!(n_parameters, size);
            let pixels = Tensor::zeros([1, 128, 128, 3], (Kind::Float, Device::Cpu));
            assert_eq!(vae.decode(&vae.encode(&pixels).0).size(), [1, 128, 128, 3]);
        }
    }

    #[test]
    fn the_divergence_is_never_below_its_free_bits() {
        let store = nn::VarStore::new(Device::Cpu);
        let mut vae = Vae::new(&store.root(), VaeConfig::car_racing(), Kind::Float, &mut rng());
        for layer in [&mut vae.encoder.mean, &mut vae.encoder.log_var] {
            for parameter in [&mut layer.weight, &mut layer.bias] {
                let _ = tch::no_grad(|| parameter.zero_());
            }
        }
        let pixels = Tensor::zeros([2, 84, 84, 3], (Kind::Float, Device::Cpu));
        let loss = vae.loss(&pixels, &normal(&mut rng(), &[2, 32]));
        assert_eq!(loss.divergence.double_value(&[]), 16.0);
    }

    /// A toy whose encoder says the same of every picture, and whose decoder paints all alike.
    fn constant(store: &nn::VarStore) -> Vae {
        let vae = Vae::new(&store.root(), VaeConfig::tiny(), Kind::Float, &mut rng());
        let outputs = [
            ("fc_mu.bias", vec![0.5, -1.0, 2.0, 0.0]),
            ("fc_logvar.bias", vec![0.2, -0.4, 0.0, 1.0]),
            ("deconv2.bias", vec![0.2, -0.3, 1.0]),
        ];
        for (name, mut variable) in store.variables() {
            let value = outputs.iter().find(|(of, _)| *of == name).map(|(_, value)| value);
            let value =
                value.map_or_else(|| variable.zeros_like(), |value: &Vec<f32>| Tensor::from_slice(value));
            tch::no_grad(|| variable.copy_(&value.view_as(&variable)));
        }
        vae
    }

    // In Python, where b = [0.2, −0.3, 1.0] is what the decoder paints, through σ, on each of 400 pixels:
    // 400 * sum((1 / (1 + exp(-b)) - 0.4) ** 2), and −½ Σ (1 + logvar − μ² − e^logvar), which is above the floor of 0.4.
    #[test]
    fn the_loss_sums_squares_over_a_picture_and_adds_the_divergence() {
        let store = nn::VarStore::new(Device::Cpu);
        let vae = constant(&store);
        let pixels = Tensor::full([3, 20, 20, 3], 0.4, (Kind::Float, Device::Cpu));
        let loss = vae.loss(&pixels, &normal(&mut rng(), &[3, 4]));
        let reconstruction = loss.reconstruction.double_value(&[]);
        assert!((reconstruction - 53.081_278).abs() < 1e-3, "{reconstruction}");
        let divergence = loss.divergence.double_value(&[]);
        assert!((divergence - 3.030_002_3).abs() < 1e-5, "{divergence}");
    }

    #[test]
    fn emphasis_weighs_what_is_blue_or_yellow_and_its_surroundings() {
        let store = nn::VarStore::new(Device::Cpu);
        let config = VaeConfig { emphasis: 10.0, ..VaeConfig::tiny() };
        let vae = Vae::new(&store.root(), config, Kind::Float, &mut rng());
        let weight_around = |rgb: [f32; 3]| {
            let pixels = Tensor::full([1, 20, 20, 3], 0.4, (Kind::Float, Device::Cpu));
            pixels.select(1, 9).select(1, 9).copy_(&Tensor::from_slice(&rgb));
            let weights = vae.weights(&pixels);
            [7, 6].map(|row| weights.double_value(&[0, row, 9, 0]))
        };
        let [around, beyond] = weight_around([0.0, 0.0, 0.8]);
        assert!((around - 9.0).abs() < 1e-5 && beyond == 1.0, "a blue pixel: {around} and {beyond}");
        assert!(weight_around([1.0, 0.65, 0.0])[0] > 7.0, "an orange one");
        assert_eq!(weight_around([0.8, 0.0, 0.0]), [1.0; 2], "a red one");
    }

    /// In a file each was a square of one side before there were others, and its models are called by their file's hash.
    #[test]
    fn a_square_is_told_by_its_side_and_other_pictures_by_height_and_width() {
        let said = |config: &VaeConfig| serde_json::to_string(config).unwrap();
        let layers = r#""latent":4,"encoder":[{"channels":8,"kernel":4,"stride":2,"padding":0},{"channels":16,"kernel":4,"stride":2,"padding":0}],"decoder":[{"channels":8,"kernel":5,"stride":2,"padding":0},{"channels":3,"kernel":4,"stride":2,"padding":0}],"free_bits":0.1"#;
        let square = VaeConfig::tiny();
        assert_eq!(said(&square), format!("{{\"side\":20,{layers},\"emphasis\":0.0}}"));
        let other = VaeConfig { height: 12, rarity: 2.0, ..VaeConfig::tiny() };
        let of_other = format!("{{\"height\":12,\"width\":20,{layers},\"emphasis\":0.0,\"rarity\":2.0}}");
        assert_eq!(said(&other), of_other);
        for config in [square, other] {
            assert_eq!(serde_json::from_str::<VaeConfig>(&said(&config)).unwrap(), config);
        }
        let read = |sides: &str| serde_json::from_str::<VaeConfig>(&format!("{{{sides}{layers}}}"));
        assert_eq!(read("\"height\":20,\"width\":20,").unwrap(), VaeConfig::tiny());
        for wrong in ["", "\"side\":20,\"width\":20,", "\"height\":20,"] {
            assert!(
                read(wrong).unwrap_err().to_string().contains("`side` or a `height` and a `width`"),
                "{wrong}"
            );
        }
        assert!(read("\"side\":20,\"new\":1,").is_err());
    }

    /// Halvings of odd sides, and of sides that a factor of two and more lies between.
    #[test]
    fn pictures_of_any_size_are_painted_in_that_size_and_learned_from() {
        for (sides, channels) in [
            ([60, 80], vec![4, 8, 8]),
            ([97, 33], vec![4, 6]),
            ([8, 8], vec![5, 7]),
            ([31, 9], vec![4, 4, 4]),
        ] {
            let config = VaeConfig { latent: 3, ..VaeConfig::halving(sides, &channels) };
            assert_eq!(config.check(), Ok(()));
            let store = nn::VarStore::new(Device::Cpu);
            let vae = Vae::new(&store.root(), config.clone(), Kind::Float, &mut rng());
            let shape = [2, sides[0], sides[1], 3];
            let pixels = Tensor::full(shape, 0.4, (Kind::Float, Device::Cpu));
            let (mean, log_var) = vae.encode(&pixels);
            assert_eq!([mean.size(), log_var.size()], [[2, 3]; 2]);
            assert_eq!(vae.decode(&mean).size(), shape);
            let quick = vae.decoder.for_inference(crate::tensor::fast_kind()).decode(&mean);
            assert!((quick - vae.decode(&mean)).abs().max().double_value(&[]) < 0.02, "{sides:?}");
            let config = VaeConfig { emphasis: 2.0, ..config };
            let vae = Vae { config, ..vae };
            let loss = vae.loss(&pixels, &normal(&mut rng(), &[2, 3]));
            (loss.reconstruction + loss.divergence).backward();
            for (name, variable) in store.variables() {
                let size = variable.grad().abs().max().double_value(&[]);
                // A rectifier may rest.
                assert!(size.is_finite() && (size > 0.0 || !name.starts_with("deconv")), "{sides:?}: {name}");
            }
        }
    }

    /// What the last row and column show is seen, and can be painted.
    #[test]
    fn nothing_at_the_rim_of_an_odd_side_is_lost() {
        let store = nn::VarStore::new(Device::Cpu);
        let config = VaeConfig { latent: 3, ..VaeConfig::halving([33, 47], &[4, 4]) };
        let vae = Vae::new(&store.root(), config, Kind::Float, &mut rng());
        let pixels = Tensor::full([1, 33, 47, 3], 0.4, (Kind::Float, Device::Cpu)).set_requires_grad(true);
        vae.encode(&pixels).0.square().sum(Kind::Float).backward();
        let seen = pixels.grad().abs();
        let z = Tensor::zeros([1, 3], (Kind::Float, Device::Cpu)).set_requires_grad(true);
        for (row, column) in [(0, 0), (32, 20), (20, 46), (32, 46)] {
            assert!(seen.double_value(&[0, row, column, 0]) > 0.0, "{row}, {column}");
            let of = |z: &Tensor| vae.decode(z).double_value(&[0, row, column, 0]);
            assert_ne!(of(&z.detach()), of(&(z.detach() + 3.0)), "{row}, {column}");
        }
    }

    /// That a decoder is not given more than it needs: what always was refused, is.
    #[test]
    fn a_decoder_that_paints_another_size_is_refused() {
        let wrong = VaeConfig { height: 21, width: 21, ..VaeConfig::tiny() };
        let said = wrong.check().unwrap_err().to_string();
        assert_eq!(
            said,
            "the side of the pictures that vision paints is 20, and must be the side of the frames, 21"
        );
        let wrong = VaeConfig { width: 21, ..VaeConfig::tiny() };
        let said = wrong.check().unwrap_err().to_string();
        assert_eq!(
            said,
            "the width of the pictures that vision paints is 20, and must be the width of the frames, 21"
        );
        let even = VaeConfig { height: 16, width: 12, ..VaeConfig::tiny() };
        assert_eq!(even.check(), Ok(()), "it paints this size by itself");
    }

    #[test]
    fn a_frozen_copy_computes_the_same() {
        let store = nn::VarStore::new(Device::Cpu);
        let vae = Vae::new(&store.root(), VaeConfig::tiny(), Kind::Float, &mut rng());
        let z = normal(&mut rng(), &[3, 4]);
        assert_eq!(to_vec(&vae.decode(&z)), to_vec(&vae.decoder.for_inference(Kind::Float).decode(&z)));
    }
}
