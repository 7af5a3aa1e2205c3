//! The networks of DrQ-v2: an encoder of pictures, an actor, and two critics with one trunk.

use rand::Rng;
use tch::{Kind, Tensor, nn};

use super::DrqConfig;
use crate::tensor::limits::{MAX_ACTIVATIONS, OutOfRange, product, within};
use crate::tensor::{dims, normal};
use crate::world::Size;

/// The stride of each convolution. All kernels have three pixels a side, and nothing is padded.
const STRIDES: [i64; 4] = [2, 1, 1, 1];
const KERNEL: i64 = 3;
/// The ε of layer normalization in PyTorch.
const NORM_EPSILON: f64 = 1e-5;

/// How many numbers the encoder makes of pictures of `size`: 32 · 35 · 35 of 84 x 84.
///
/// `// DIFFERENCE:` the published program knows 84 x 84 alone; other sizes pass through the same layers.
pub(super) fn representation(config: &DrqConfig, size: Size) -> Result<i64, OutOfRange> {
    let mut sides = [i64::from(size.height), i64::from(size.width)];
    for stride in STRIDES {
        for side in &mut sides {
            if *side < KERNEL {
                let wanted = "at least 15 pixels a side, so that four convolutions pass over it";
                return Err(OutOfRange::new("the picture of this world", size, wanted));
            }
            *side = (*side - KERNEL) / stride + 1;
        }
    }
    let n = product(&[config.channels, sides[0], sides[1]]).unwrap_or(i64::MAX);
    within("how many numbers the encoder makes", n, 1..=MAX_ACTIVATIONS)?;
    Ok(n)
}

/// A matrix of `rows × columns` with orthonormal rows or columns, whichever are fewer, times `gain`.
///
/// That of the QR decomposition of a normal one, with the signs that make it uniform among all.
fn orthogonal(rng: &mut impl Rng, rows: i64, columns: i64, gain: f64) -> Tensor {
    let is_wide = rows < columns;
    let drawn = normal(rng, &[rows.max(columns), rows.min(columns)]);
    let (q, r) = Tensor::linalg_qr(&drawn, "reduced");
    let q = q * r.diagonal(0, 0, 1).sign();
    gain * if is_wide { q.transpose(0, 1).contiguous() } else { q }
}

/// `y = x Wᵀ + b`.
#[derive(Debug)]
struct Linear {
    weight: Tensor,
    bias: Tensor,
}

impl Linear {
    fn new(path: &nn::Path<'_>, inputs: i64, outputs: i64, rng: &mut impl Rng) -> Self {
        let weight = path.var_copy("weight", &orthogonal(rng, outputs, inputs, 1.0));
        Self { weight, bias: path.zeros("bias", &[outputs]) }
    }

    fn detached(&self) -> Self {
        Self { weight: self.weight.detach(), bias: self.bias.detach() }
    }

    fn forward(&self, x: &Tensor) -> Tensor {
        x.linear(&self.weight, Some(&self.bias))
    }
}

/// Three linear layers with ReLU between them.
#[derive(Debug)]
struct Mlp([Linear; 3]);

impl Mlp {
    fn new(path: &nn::Path<'_>, [inputs, hidden, outputs]: [i64; 3], rng: &mut impl Rng) -> Self {
        let sizes = [(inputs, hidden), (hidden, hidden), (hidden, outputs)];
        let mut number = 0;
        Self(sizes.map(|(inputs, outputs)| {
            number += 1;
            Linear::new(&(path / format!("layer{number}")), inputs, outputs, rng)
        }))
    }

    fn detached(&self) -> Self {
        Self(self.0.each_ref().map(Linear::detached))
    }

    fn forward(&self, x: &Tensor) -> Tensor {
        let [first, second, last] = &self.0;
        last.forward(&second.forward(&first.forward(x).relu()).relu())
    }
}

/// What the actor and the critic each make of what the encoder sees: `tanh(LayerNorm(W h))`.
#[derive(Debug)]
struct Trunk {
    linear: Linear,
    scale: Tensor,
    offset: Tensor,
}

impl Trunk {
    fn new(path: &nn::Path<'_>, inputs: i64, features: i64, rng: &mut impl Rng) -> Self {
        let (linear, norm) = (Linear::new(&(path / "linear"), inputs, features, rng), path / "norm");
        Self { linear, scale: norm.ones("weight", &[features]), offset: norm.zeros("bias", &[features]) }
    }

    fn detached(&self) -> Self {
        let (scale, offset) = (self.scale.detach(), self.offset.detach());
        Self { linear: self.linear.detached(), scale, offset }
    }

    fn forward(&self, h: &Tensor) -> Tensor {
        let y = self.linear.forward(h);
        let n = y.size()[1];
        y.layer_norm([n], Some(&self.scale), Some(&self.offset), NORM_EPSILON, true).tanh()
    }
}

/// Four convolutions over a stack of pictures.
#[derive(Debug)]
pub(super) struct Encoder {
    /// Weight `[out, in, 3, 3]` and bias of each.
    convolutions: Vec<[Tensor; 2]>,
}

impl Encoder {
    pub(super) fn new(path: &nn::Path<'_>, config: &DrqConfig, rng: &mut impl Rng) -> Self {
        let mut inputs = 3 * config.stack as i64;
        let convolution = |i: usize| {
            let path = path / format!("conv{}", i + 1);
            let outputs = config.channels;
            // Of ReLU's gain, √2.
            let weight = orthogonal(rng, outputs, inputs * KERNEL * KERNEL, 2f64.sqrt());
            let weight = weight.view([outputs, inputs, KERNEL, KERNEL]);
            inputs = outputs;
            [path.var_copy("weight", &weight), path.zeros("bias", &[outputs])]
        };
        Self { convolutions: (0..STRIDES.len()).map(convolution).collect() }
    }

    pub(super) fn detached(&self) -> Self {
        let detached = |[weight, bias]: &[Tensor; 2]| [weight.detach(), bias.detach()];
        Self { convolutions: self.convolutions.iter().map(detached).collect() }
    }

    /// What is seen, computed as `kind`.
    ///
    /// # Shapes
    /// - `pixels`: `[B, 3 k, H, W]`, bytes
    /// - returns `[B, R]`, single precision
    pub(super) fn forward(&self, pixels: &Tensor, kind: Kind) -> Tensor {
        let [b, ..] = dims::<4>(pixels);
        let mut h = (pixels.to_kind(Kind::Float) / 255.0 - 0.5).to_kind(kind);
        for ([weight, bias], stride) in self.convolutions.iter().zip(STRIDES) {
            let (weight, bias) = (weight.to_kind(kind), bias.to_kind(kind));
            h = h.conv2d(&weight, Some(&bias), [stride; 2], [0; 2], [1; 2], 1).relu();
        }
        h.to_kind(Kind::Float).reshape([b, -1])
    }
}

/// What to do.
#[derive(Debug)]
pub(super) struct Actor {
    trunk: Trunk,
    policy: Mlp,
}

impl Actor {
    pub(super) fn new(
        path: &nn::Path<'_>,
        config: &DrqConfig,
        [inputs, n_axes]: [i64; 2],
        rng: &mut impl Rng,
    ) -> Self {
        let trunk = Trunk::new(&(path / "trunk"), inputs, config.features, rng);
        let policy = Mlp::new(&(path / "policy"), [config.features, config.hidden, n_axes], rng);
        Self { trunk, policy }
    }

    pub(super) fn detached(&self) -> Self {
        Self { trunk: self.trunk.detached(), policy: self.policy.detached() }
    }

    /// The action without noise, in `[-1, 1]`.
    ///
    /// # Shapes
    /// - `h`: `[B, R]`
    /// - returns `[B, A]`
    pub(super) fn forward(&self, h: &Tensor) -> Tensor {
        self.policy.forward(&self.trunk.forward(h)).tanh()
    }
}

/// What an action is worth, told twice.
#[derive(Debug)]
pub(super) struct Critic {
    trunk: Trunk,
    values: [Mlp; 2],
}

impl Critic {
    pub(super) fn new(
        path: &nn::Path<'_>,
        config: &DrqConfig,
        [inputs, n_axes]: [i64; 2],
        rng: &mut impl Rng,
    ) -> Self {
        let trunk = Trunk::new(&(path / "trunk"), inputs, config.features, rng);
        let sizes = [config.features + n_axes, config.hidden, 1];
        let values = ["q1", "q2"].map(|name| Mlp::new(&(path / name), sizes, rng));
        Self { trunk, values }
    }

    /// The same numbers, through which gradients pass without staying: an actor learns by them.
    pub(super) fn detached(&self) -> Self {
        Self { trunk: self.trunk.detached(), values: self.values.each_ref().map(Mlp::detached) }
    }

    /// Both values.
    ///
    /// # Shapes
    /// - `h`: `[B, R]`, `actions`: `[B, A]`
    /// - returns twice `[B, 1]`
    pub(super) fn forward(&self, h: &Tensor, actions: &Tensor) -> [Tensor; 2] {
        let x = Tensor::cat(&[&self.trunk.forward(h), actions], 1);
        self.values.each_ref().map(|value| value.forward(&x))
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::tensor::to_vec;

    #[test]
    fn published_pictures_become_as_many_numbers_as_published() {
        let size = |height, width| Size { height, width };
        let config = DrqConfig::published();
        assert_eq!(representation(&config, size(84, 84)), Ok(32 * 35 * 35));
        assert_eq!(representation(&config, size(17, 19)), Ok(32 * 2 * 3));
        assert!(representation(&config, size(16, 84)).is_ok(), "one row is left");
        assert!(representation(&config, size(14, 84)).is_err());
    }

    #[test]
    fn weights_are_orthogonal_whichever_way_they_lie() {
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        for (rows, columns) in [(6, 4), (4, 6), (5, 5)] {
            let weight = orthogonal(rng, rows, columns, 2.0);
            assert_eq!(weight.size(), [rows, columns]);
            let other = weight.transpose(0, 1);
            let product = if rows < columns { weight.matmul(&other) } else { other.matmul(&weight) };
            let n = rows.min(columns);
            let wanted = 4.0 * Tensor::eye(n, (Kind::Float, tch::Device::Cpu));
            assert!(to_vec(&(product - wanted)).iter().all(|apart| apart.abs() < 1e-5), "{rows} x {columns}");
        }
    }
}
