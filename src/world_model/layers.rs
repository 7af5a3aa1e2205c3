//! What a [`Vae`](super::Vae) is made of: convolutions over channels-last pictures, the large ones as matrix products.

use rand::Rng;
use serde::{Deserialize, Serialize};
use tch::{Device, Kind, Tensor, nn};

use crate::tensor::limits::{MAX_ACTIVATIONS, MAX_KERNEL, MAX_WIDTH, OutOfRange, product, within};
use crate::tensor::{Slot, dims, uniform};

/// One convolution: what it makes and how it moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Layer {
    /// Channels that come out.
    pub channels: i64,
    /// Pixels a side of the kernel.
    pub kernel: i64,
    /// Pixels from one place of the kernel to the next.
    pub stride: i64,
    /// Pixels added on every side.
    pub padding: i64,
}

impl Layer {
    /// Fails where the numbers are none of a convolution. `what` names it.
    fn check(self, what: &str) -> Result<(), OutOfRange> {
        within(&format!("the number of channels of {what}"), self.channels, 1..=MAX_WIDTH)?;
        within(&format!("the kernel of {what}"), self.kernel, 1..=MAX_KERNEL)?;
        within(&format!("the stride of {what}"), self.stride, 1..=self.kernel)?;
        within(&format!("the padding of {what}"), self.padding, 0..=self.kernel - 1)
    }

    /// Pixels a side that the convolution makes of `side`.
    pub(super) fn shrunk(self, side: i64) -> i64 {
        (side + 2 * self.padding - self.kernel) / self.stride + 1
    }

    /// Pixels a side that the transposed convolution makes of `side`.
    pub(super) fn grown(self, side: i64) -> i64 {
        (side - 1).saturating_mul(self.stride).saturating_add(self.kernel - 2 * self.padding)
    }

    /// Height and width that the convolution called `what` makes of these, where that is a picture of a sane size.
    pub(crate) fn convolved_sides(self, what: &str, sides: [i64; 2]) -> Result<[i64; 2], OutOfRange> {
        self.check(what)?;
        let wanted = |side| format!("no larger than the {side} pixels a side that it is given");
        let padded = sides.map(|side| side + 2 * self.padding);
        if let Some(&padded) = padded.iter().find(|padded| **padded < self.kernel) {
            return Err(OutOfRange::new(format!("the kernel of {what}"), self.kernel, wanted(padded)));
        }
        self.bounded(what, sides.map(|side| self.shrunk(side)))
    }

    /// The same of a transposed convolution that paints `more` rows and columns.
    pub(super) fn deconvolved(
        self,
        what: &str,
        sides: [i64; 2],
        more: [i64; 2],
    ) -> Result<[i64; 2], OutOfRange> {
        self.check(what)?;
        let [height, width] = sides.map(|side| self.grown(side));
        self.bounded(what, [height + more[0], width + more[1]])
    }

    fn bounded(self, what: &str, sides: [i64; 2]) -> Result<[i64; 2], OutOfRange> {
        for side in sides {
            within(&format!("the side of what {what} makes"), side, 1..=MAX_ACTIVATIONS)?;
        }
        let n = product(&[sides[0], sides[1], self.channels]).unwrap_or(i64::MAX);
        within(&format!("how many numbers {what} makes"), n, 1..=MAX_ACTIVATIONS)?;
        Ok(sides)
    }
}

/// `y = x Wᵀ + b`.
#[derive(Debug)]
pub(super) struct Linear {
    pub(super) weight: Tensor,
    pub(super) bias: Tensor,
}

impl Linear {
    pub(super) fn new(path: &nn::Path<'_>, inputs: i64, outputs: i64, rng: &mut impl Rng) -> Self {
        let bound = 1.0 / (inputs as f64).sqrt();
        let weight = path.var_copy("weight", &uniform(rng, &[outputs, inputs], bound));
        let bias = path.var_copy("bias", &uniform(rng, &[outputs], bound));
        Self { weight, bias }
    }

    /// How it is stored.
    pub(super) fn slots(name: &str, inputs: i64, outputs: i64) -> [Slot; 2] {
        [
            Slot::plain(format!("{name}.weight"), &[outputs, inputs]),
            Slot::plain(format!("{name}.bias"), &[outputs]),
        ]
    }

    pub(super) fn for_inference(&self) -> Self {
        Self { weight: self.weight.detach().copy(), bias: self.bias.detach().copy() }
    }

    /// The same numbers under another name, for another thread.
    pub(super) fn shared(&self) -> Self {
        Self { weight: self.weight.shallow_clone(), bias: self.bias.shallow_clone() }
    }

    pub(super) fn forward(&self, x: &Tensor) -> Tensor {
        x.linear(&self.weight, Some(&self.bias))
    }
}

/// The layers that are large and cover few pixels pass faster as one matrix product (measured; see the benches).
///
/// That is so on the processor; accelerators have good convolutions for them, too.
/// So they lie in memory alone. In files of layout 1 they lay so, too: for those, what was measured then still holds.
fn as_matrix(inputs: i64, layer: Layer) -> bool {
    let large = if layer.padding == 0 { 280 } else { 700 };
    inputs + layer.channels >= large && layer.kernel == 4 && layer.kernel % layer.stride == 0
}

fn channels_first(x: &Tensor) -> Tensor {
    x.permute([0, 3, 1, 2])
}

pub(super) fn channels_last(x: &Tensor) -> Tensor {
    x.permute([0, 2, 3, 1])
}

/// A convolution over channels-last pictures.
///
/// As a matrix its weight is `[k · k · in, out]`, rows ordered by kernel row, kernel column, channel;
/// otherwise `[out, in, k, k]`, as it is stored in either case.
#[derive(Debug)]
pub(super) struct Conv {
    layer: Layer,
    is_matrix: bool,
    weight: Tensor,
    bias: Tensor,
}

impl Conv {
    /// How it is stored.
    pub(super) fn slots(name: &str, inputs: i64, layer: Layer) -> [Slot; 2] {
        let (k, out) = (layer.kernel, layer.channels);
        let weight = Slot::plain(format!("{name}.weight"), &[out, inputs, k, k]);
        let bias = Slot::plain(format!("{name}.bias"), &[out]);
        if as_matrix(inputs, layer) {
            return [weight.rearranged(&[2, 3, 1, 0], &[k * k * inputs, out]), bias];
        }
        [weight, bias]
    }

    pub(super) fn new(path: &nn::Path<'_>, inputs: i64, layer: Layer, rng: &mut impl Rng) -> Self {
        let (k, out) = (layer.kernel, layer.channels);
        let bound = 1.0 / ((inputs * k * k) as f64).sqrt();
        let is_matrix = as_matrix(inputs, layer);
        let [slot, _] = Self::slots("", inputs, layer);
        let weight = path.var_copy("weight", &uniform(rng, slot.shape_in_memory(), bound));
        let bias = path.var_copy("bias", &uniform(rng, &[out], bound));
        Self { layer, is_matrix, weight, bias }
    }

    pub(super) fn for_inference(&self, kind: Kind) -> Self {
        let weight = self.weight.detach().to_kind(kind).copy();
        let bias = self.bias.detach().to_kind(kind).copy();
        Self { layer: self.layer, is_matrix: self.is_matrix, weight, bias }
    }

    /// The same numbers under another name, for another thread.
    pub(super) fn shared(&self) -> Self {
        let (weight, bias) = (self.weight.shallow_clone(), self.bias.shallow_clone());
        Self { layer: self.layer, is_matrix: self.is_matrix, weight, bias }
    }

    pub(super) fn forward(&self, x: &Tensor, kind: Kind) -> Tensor {
        let Layer { channels, kernel: k, stride, padding } = self.layer;
        let (weight, bias) = (self.weight.to_kind(kind), self.bias.to_kind(kind));
        if !self.is_matrix || x.device() != Device::Cpu {
            let weight =
                if self.is_matrix { weight.view([k, k, -1, channels]).permute([3, 2, 0, 1]) } else { weight };
            let y = channels_first(x).conv2d(&weight, Some(&bias), [stride; 2], [padding; 2], [1; 2], 1);
            return channels_last(&y);
        }
        let padded = x.constant_pad_nd([0, 0, padding, padding, padding, padding]);
        let rows = side_by_side(&side_by_side(&padded, 2, k, stride), 1, k, stride);
        let [b, p, q, width] = dims(&rows); // [B, P', P', k k C]
        bias.addmm(&rows.view([b * p * q, width]), &weight).view([b, p, q, channels])
    }
}

/// A transposed convolution over channels-last pictures.
///
/// As a matrix its weight is `[in, k · k · out]`, columns ordered by kernel row, kernel column, channel;
/// otherwise `[in, out, k, k]`, as it is stored in either case.
#[derive(Debug)]
pub(super) struct Deconv {
    layer: Layer,
    /// Rows and columns that it paints of what its padding cuts off below and at the right.
    more: [i64; 2],
    is_matrix: bool,
    weight: Tensor,
    bias: Tensor,
}

impl Deconv {
    /// How it is stored.
    pub(super) fn slots(name: &str, inputs: i64, layer: Layer) -> [Slot; 2] {
        let (k, out) = (layer.kernel, layer.channels);
        let weight = Slot::plain(format!("{name}.weight"), &[inputs, out, k, k]);
        let bias = Slot::plain(format!("{name}.bias"), &[out]);
        if as_matrix(inputs, layer) {
            return [weight.rearranged(&[0, 2, 3, 1], &[inputs, k * k * out]), bias];
        }
        [weight, bias]
    }

    pub(super) fn new(
        path: &nn::Path<'_>,
        inputs: i64,
        (layer, more): (Layer, [i64; 2]),
        rng: &mut impl Rng,
    ) -> Self {
        let (k, out) = (layer.kernel, layer.channels);
        // PyTorch reads the fan-in of a transposed convolution off the wrong axis: the outputs.
        let bound = 1.0 / ((out * k * k) as f64).sqrt();
        let is_matrix = as_matrix(inputs, layer);
        let [slot, _] = Self::slots("", inputs, layer);
        let weight = path.var_copy("weight", &uniform(rng, slot.shape_in_memory(), bound));
        let bias = path.var_copy("bias", &uniform(rng, &[out], bound));
        Self { layer, more, is_matrix, weight, bias }
    }

    pub(super) fn for_inference(&self, kind: Kind) -> Self {
        let weight = self.weight.detach().to_kind(kind).copy();
        let bias = self.bias.detach().to_kind(kind).copy();
        Self { layer: self.layer, more: self.more, is_matrix: self.is_matrix, weight, bias }
    }

    /// The same numbers under another name, for another thread.
    pub(super) fn shared(&self) -> Self {
        let (weight, bias) = (self.weight.shallow_clone(), self.bias.shallow_clone());
        Self { layer: self.layer, more: self.more, is_matrix: self.is_matrix, weight, bias }
    }

    pub(super) fn forward(&self, x: &Tensor, kind: Kind) -> Tensor {
        let Layer { channels, kernel: k, stride, padding } = self.layer;
        let (weight, bias) = (self.weight.to_kind(kind), self.bias.to_kind(kind));
        if !self.is_matrix || x.device() != Device::Cpu {
            let weight =
                if self.is_matrix { weight.view([-1, k, k, channels]).permute([0, 3, 1, 2]) } else { weight };
            let x = channels_first(x);
            let y = x.conv_transpose2d(&weight, Some(&bias), [stride; 2], [padding; 2], self.more, 1, [1; 2]);
            return channels_last(&y);
        }
        // Every input pixel stamps a k × k patch. Overlapping stamps add up, row by row and then column by column.
        // A stride of s makes of k rows k / s groups of s that stay together.
        let [b, p, q, c] = dims(x);
        let (n, width) = (k / stride, stride * k * channels);
        let stamps = x.reshape([b * p * q, c]).matmul(&weight).view([b, p, q, n, width]);
        let rows = overlap(&stamps.permute([0, 2, 1, 3, 4]).reshape([b * q, p, n, width])); // [B Q, p + n − 1, s k C]
        let p = (p - 1) * stride + k;
        let rows = rows.view([b, q, p, k, channels]).permute([0, 2, 1, 3, 4]);
        let y = overlap(&rows.reshape([b * p, q, n, stride * channels])); // [B P', q + n − 1, s C]
        let y = y.view([b, p, (q - 1) * stride + k, channels]);
        let inside = |y: &Tensor, axis, more| {
            let all = y.size()[axis as usize];
            y.narrow(axis, padding, all - 2 * padding + more)
        };
        inside(&inside(&y, 1, self.more[0]), 2, self.more[1]) + bias
    }
}

/// What a kernel of `k` places sees along `axis` as it moves by `stride`, side by side as channels.
///
/// # Shapes
/// - `x`: `[B, P, Q, C]`
/// - returns `[B, P, Q, k C]`, with only the kernel's places along `axis`
fn side_by_side(x: &Tensor, axis: i64, k: i64, stride: i64) -> Tensor {
    let reach = x.size()[axis as usize] - k; // from the first place of the kernel to the last
    // Not `unfold`: its gradient is slow.
    let seen: Vec<_> = (0..k).map(|i| x.slice(axis, i, i + reach + 1, stride)).collect();
    Tensor::cat(&seen, 3)
}

/// Adds up `n` stamps of length `k`, each one place after the last.
///
/// # Shapes
/// - `stamps`: `[B, n, k, C]`
/// - returns `[B, n + k − 1, C]`
fn overlap(stamps: &Tensor) -> Tensor {
    let [b, n, k, c] = dims(stamps);
    // Padding each stamp to length n + k and reading the whole as rows of n + k − 1 shifts each by one more place.
    let padded = stamps.constant_pad_nd([0, 0, 0, n]); // [B, n, n + k, C]
    let skewed = padded.view([b, n * (n + k), c]).narrow(1, 0, n * (n + k - 1));
    skewed.reshape([b, n, n + k - 1, c]).sum_dim_intlist(1, false, None::<Kind>)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;
    use tch::Device;

    use super::*;
    use crate::tensor::normal;

    fn rng() -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(0)
    }

    #[test]
    fn a_convolution_as_a_matrix_is_the_same_convolution() {
        for (inputs, channels, stride, padding, more) in [
            (96, 200, 1, 0, [0, 0]),
            (96, 200, 2, 0, [0, 0]),
            (300, 400, 2, 1, [0, 0]),
            (300, 400, 2, 1, [1, 0]),
            (300, 400, 2, 1, [1, 1]),
        ] {
            let layer = Layer { channels, kernel: 4, stride, padding };
            let store = nn::VarStore::new(Device::Cpu);
            let conv = Conv::new(&(store.root() / "c"), inputs, layer, &mut rng());
            let deconv = Deconv::new(&(store.root() / "d"), inputs, (layer, more), &mut rng());
            assert!(conv.is_matrix && deconv.is_matrix, "the layer is large enough");
            let x = normal(&mut rng(), &[2, 6 + more[0], 8 + more[1], inputs]);
            let (stride, padding) = ([stride; 2], [padding; 2]);
            let apart = |a: &Tensor, b: &Tensor| (a - b).abs().max().double_value(&[]);

            let weight = Conv::slots("c", inputs, layer)[0].from_memory(&conv.weight);
            assert_eq!(weight.size(), [channels, inputs, 4, 4]);
            let bias = Some(&conv.bias);
            let plain = channels_first(&x).conv2d(&weight, bias, stride, padding, [1; 2], 1);
            assert!(apart(&conv.forward(&x, Kind::Float), &channels_last(&plain)) < 1e-4, "{layer:?}");

            let weight = Deconv::slots("d", inputs, layer)[0].from_memory(&deconv.weight);
            assert_eq!(weight.size(), [inputs, channels, 4, 4]);
            let (x_first, bias) = (channels_first(&x), Some(&deconv.bias));
            let plain = x_first.conv_transpose2d(&weight, bias, stride, padding, more, 1, [1; 2]);
            assert!(apart(&deconv.forward(&x, Kind::Float), &channels_last(&plain)) < 1e-4, "{layer:?}");
        }
    }
}
