//! Vision: a variational autoencoder from frames to latents and back (method §3).
//!
//! Pictures are `[B, P, P, C]` throughout, channels last, which is what the processor likes best.

use rand::Rng;
use serde::{Deserialize, Serialize};
use tch::{Kind, Tensor, nn};

use crate::tensor::limits::{MAX_ACTIVATIONS, MAX_LATENTS, MAX_LAYERS, MAX_SIDE, OutOfRange, within};
use crate::tensor::{Slot, dims};
use crate::world_model::layers::{Conv, Deconv, Layer, Linear, channels_last};

/// The shape of a [`Vae`] and its one hyper-parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VaeConfig {
    /// P: pixels a side of a frame.
    pub side: i64,
    /// Z: how many latents (`n_z`).
    pub latent: i64,
    /// From the frame inwards.
    pub encoder: Vec<Layer>,
    /// From the latents outwards. The last makes the three colors.
    pub decoder: Vec<Layer>,
    /// τ: nats per latent below which the divergence costs nothing more.
    pub free_bits: f64,
    /// How many times more the bluest and the yellowest pixels count, and those around them: 0 in the paper.
    #[serde(default)]
    pub emphasis: f64,
}

impl VaeConfig {
    /// The paper's network for Car Racing (Table 3): 84 pixels, 32 latents, 3 337 747 parameters.
    pub fn car_racing() -> Self {
        // DIFFERENCE: Table 3 prints the third stride as 1, which does not give the sizes it prints. It is 2.
        let encoder = layers(&[(24, 4, 2), (48, 4, 2), (96, 4, 2), (192, 4, 1), (384, 4, 1)], 0);
        let decoder = layers(&[(192, 4, 1), (96, 4, 1), (48, 5, 2), (24, 5, 2), (3, 4, 2)], 0);
        Self { side: 84, latent: 32, encoder, decoder, free_bits: 0.5, emphasis: 0.0 }
    }

    /// The paper's network for Obstacle Car Racing (Table 3): 128 pixels, 64 latents, 25 453 571 parameters.
    pub fn obstacle_car_racing() -> Self {
        // DIFFERENCE: Table 3 prints other widths for the decoder. These are those of the authors' code.
        Self::obstacles(64)
    }

    /// The same layers with a quarter of the channels, 2 185 571 parameters: what two cores can train.
    pub fn obstacle_compact() -> Self {
        // DIFFERENCE: obstacles are so small that without emphasis none was to be seen after 3 000 updates.
        Self { emphasis: 15.0, ..Self::obstacles(16) }
    }

    /// Five halvings of 128 pixels, the first to `width` channels and each of the others to twice as many.
    fn obstacles(width: i64) -> Self {
        let encoder = layers(&[1, 2, 4, 8, 16].map(|factor| (factor * width, 4, 2)), 1);
        let outwards = [8 * width, 4 * width, 2 * width, width, 3];
        let decoder = layers(&outwards.map(|channels| (channels, 4, 2)), 1);
        Self { side: 128, latent: 64, encoder, decoder, free_bits: 2.0, emphasis: 0.0 }
    }

    /// A toy for tests: 20 pixels, 4 latents.
    pub fn tiny() -> Self {
        let encoder = layers(&[(8, 4, 2), (16, 4, 2)], 0);
        let decoder = layers(&[(8, 5, 2), (3, 4, 2)], 0);
        Self { side: 20, latent: 4, encoder, decoder, free_bits: 0.1, emphasis: 0.0 }
    }

    /// Fails where no network can be of this shape.
    pub fn check(&self) -> Result<(), OutOfRange> {
        within("the side of vision's frames", self.side, 1..=MAX_SIDE)?;
        within("the number of vision's latents", self.latent, 1..=MAX_LATENTS)?;
        within("the number of vision's encoding layers", self.encoder.len(), 1..=MAX_LAYERS)?;
        within("the number of vision's decoding layers", self.decoder.len(), 1..=MAX_LAYERS)?;
        within("vision's free bits", self.free_bits, 0.0..=1e6)?;
        within("vision's emphasis", self.emphasis, 0.0..=1e6)?;
        let mut side = self.side;
        for (i, layer) in self.encoder.iter().enumerate() {
            side = layer.convolved(&format!("vision's conv{}", i + 1), side)?;
        }
        for (i, layer) in self.decoder.iter().enumerate() {
            side = layer.deconvolved(&format!("vision's deconv{}", i + 1), side)?;
        }
        if side != self.side {
            let wanted = format!("the side of the frames, {}", self.side);
            return Err(OutOfRange::new("the side of the pictures that vision paints", side, wanted));
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

    /// Numbers where encoder and decoder meet.
    fn n_features(&self) -> i64 {
        self.depth() * self.bottom() * self.bottom()
    }

    /// Pixels a side where encoder and decoder meet.
    fn bottom(&self) -> i64 {
        let shrink = |side, layer: &Layer| (side + 2 * layer.padding - layer.kernel) / layer.stride + 1;
        self.encoder.iter().fold(self.side, shrink)
    }

    /// Channels where encoder and decoder meet.
    fn depth(&self) -> i64 {
        self.encoder.last().map_or(3, |layer| layer.channels)
    }
}

fn layers(all: &[(i64, i64, i64)], padding: i64) -> Vec<Layer> {
    all.iter().map(|&(channels, kernel, stride)| Layer { channels, kernel, stride, padding }).collect()
}

/// A trained or trainable autoencoder.
#[derive(Debug)]
pub struct Vae {
    config: VaeConfig,
    /// The arithmetic of the convolutions. The rest is `f32`.
    kind: Kind,
    encoder: Vec<Conv>,
    mean: Linear,
    log_var: Linear,
    decoder_in: Linear,
    decoder: Vec<Deconv>,
}

impl Vae {
    /// A fresh network under `path`, drawn by `rng` as PyTorch draws it (method §3.5), computing in `kind`.
    pub fn new(path: &nn::Path<'_>, config: VaeConfig, kind: Kind, rng: &mut impl Rng) -> Self {
        let latent = config.latent;
        let mut channels = 3;
        let mut encoder = Vec::new();
        for (i, layer) in config.encoder.iter().enumerate() {
            encoder.push(Conv::new(&(path / format!("conv{}", i + 1)), channels, *layer, rng));
            channels = layer.channels;
        }
        let n_features = config.n_features();
        let mean = Linear::new(&(path / "fc_mu"), n_features, latent, rng);
        let log_var = Linear::new(&(path / "fc_logvar"), n_features, latent, rng);
        let decoder_in = Linear::new(&(path / "dec_fc"), latent, n_features, rng);
        let mut decoder = Vec::new();
        for (i, layer) in config.decoder.iter().enumerate() {
            decoder.push(Deconv::new(&(path / format!("deconv{}", i + 1)), channels, *layer, rng));
            channels = layer.channels;
        }
        Self { config, kind, encoder, mean, log_var, decoder_in, decoder }
    }

    /// A copy for use alone, its weights already in `kind`. It cannot be trained.
    pub fn for_inference(&self, kind: Kind) -> Self {
        Self {
            config: self.config.clone(),
            kind,
            encoder: self.encoder.iter().map(|layer| layer.for_inference(kind)).collect(),
            mean: self.mean.for_inference(),
            log_var: self.log_var.for_inference(),
            decoder_in: self.decoder_in.for_inference(),
            decoder: self.decoder.iter().map(|layer| layer.for_inference(kind)).collect(),
        }
    }

    /// The shape of this network.
    pub fn config(&self) -> &VaeConfig {
        &self.config
    }

    /// Mean and logarithm of the variance of the latents of each picture.
    ///
    /// # Shapes
    /// - `pixels`: `[B, P, P, 3]` in `[0, 1]`
    /// - returns two `[B, Z]`
    pub fn encode(&self, pixels: &Tensor) -> (Tensor, Tensor) {
        let [b, ..] = dims::<4>(pixels);
        let mut x = pixels.to_kind(self.kind);
        for layer in &self.encoder {
            x = layer.forward(&x, self.kind).relu();
        }
        // DIFFERENCE: features are flattened with the channels last. The same network with its rows in another order.
        let x = x.to_kind(Kind::Float).reshape([b, -1]);
        (self.mean.forward(&x), self.log_var.forward(&x))
    }

    /// The pictures of latents.
    ///
    /// # Shapes
    /// - `z`: `[B, Z]`
    /// - returns `[B, P, P, 3]` in `(0, 1)`
    pub fn decode(&self, z: &Tensor) -> Tensor {
        let [b, _] = dims(z);
        let bottom = self.config.bottom();
        let mut x = self.decoder_in.forward(z).view([b, bottom, bottom, -1]).to_kind(self.kind);
        for (i, layer) in self.decoder.iter().enumerate() {
            if i > 0 {
                x = x.relu();
            }
            x = layer.forward(&x, self.kind);
        }
        x.to_kind(Kind::Float).sigmoid()
    }

    /// The two parts of the loss, each averaged over the batch (method §3.3).
    ///
    /// ```text
    /// z = μ + exp(½ logvar) ε
    /// R = Σ w (x̂ − x)²          over all 3 P² values; w is 1 in the paper
    /// KL = max(−½ Σ (1 + logvar − μ² − exp(logvar)), τ Z)
    /// ```
    ///
    /// # Shapes
    /// - `pixels`: `[B, P, P, 3]`, `noise` (ε): `[B, Z]`
    pub fn loss(&self, pixels: &Tensor, noise: &Tensor) -> VaeLoss {
        let [b, ..] = dims::<4>(pixels);
        let (mean, log_var) = self.encode(pixels);
        let z = &mean + (&log_var * 0.5).exp() * noise;
        let error: Tensor = self.decode(&z) - pixels;
        let mut square = error.square();
        if self.config.emphasis > 0.0 {
            square *= self.weights(pixels);
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
    /// - `pixels`: `[B, P, P, 3]`
    /// - returns `[B, P, P, 1]`
    fn weights(&self, pixels: &Tensor) -> Tensor {
        const AROUND: i64 = 2;
        let color = |i| pixels.select(3, i);
        let tint = (color(0).minimum(&color(1)) - color(2)).abs().unsqueeze(1); // [B, 1, P, P]
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
        for layer in [&mut vae.mean, &mut vae.log_var] {
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

    #[test]
    fn a_frozen_copy_computes_the_same() {
        let store = nn::VarStore::new(Device::Cpu);
        let vae = Vae::new(&store.root(), VaeConfig::tiny(), Kind::Float, &mut rng());
        let z = normal(&mut rng(), &[3, 4]);
        assert_eq!(to_vec(&vae.decode(&z)), to_vec(&vae.for_inference(Kind::Float).decode(&z)));
    }
}
