//! Memory: a recurrent network that says where the latents go next, as mixtures of Gaussians (method §4).

use rand::{Rng, RngExt as _};
use serde::{Deserialize, Serialize};
use tch::{Cuda, Device, Kind, Tensor, nn};

use crate::tensor::limits::{MAX_COMPONENTS, MAX_LATENTS, MAX_MEMORY, OutOfRange, within};
use crate::tensor::{Slot, dims, from_slice, normal, uniform};
use crate::world::MAX_AXES;

/// The shape of an [`MdnRnn`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MdnRnnConfig {
    /// Z: how many latents (`n_z`).
    pub latent: i64,
    /// M: how many cells the memory has, and as many outputs.
    pub memory: i64,
    /// K: Gaussians in the mixture of each latent.
    pub components: i64,
    /// A: numbers of an action. Files say it where it is not 3, as it was everywhere before there were other worlds.
    #[serde(default = "three", skip_serializing_if = "is_three")]
    pub actions: i64,
}

fn three() -> i64 {
    3
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde hands over a reference")]
fn is_three(actions: &i64) -> bool {
    *actions == 3
}

impl MdnRnnConfig {
    /// The paper's network for Car Racing (Table 4): 32 latents, 256 cells, 5 Gaussians, 423 392 parameters.
    pub fn car_racing() -> Self {
        Self { latent: 32, memory: 256, components: 5, actions: 3 }
    }

    /// The paper's network for Obstacle Car Racing (Table 4): 64 latents, 1024 cells, 7 Gaussians, 5 854 528 parameters.
    pub fn obstacle_car_racing() -> Self {
        Self { latent: 64, memory: 1024, components: 7, actions: 3 }
    }

    /// That for Car Racing with as many latents as obstacles need.
    pub fn obstacle_compact() -> Self {
        Self { latent: 64, ..Self::car_racing() }
    }

    /// A toy for tests.
    pub fn tiny() -> Self {
        Self { latent: 4, memory: 16, components: 2, actions: 3 }
    }

    /// Fails where no network can be of this shape.
    pub fn check(&self) -> Result<(), OutOfRange> {
        within("the number of memory's latents", self.latent, 1..=MAX_LATENTS)?;
        within("the number of memory's cells", self.memory, 1..=MAX_MEMORY)?;
        within("the number of memory's Gaussians", self.components, 1..=MAX_COMPONENTS)?;
        within("the number of an action's axes", self.actions, 1..=MAX_AXES as i64)
    }

    /// How the network is stored.
    pub fn slots(&self) -> Vec<Slot> {
        let (m, inputs) = (self.memory, self.latent + self.actions);
        let outputs = self.latent * self.components * 3;
        vec![
            Slot::plain("lstm.weight_ih", &[4 * m, inputs]),
            Slot::plain("lstm.weight_hh", &[4 * m, m]),
            Slot::plain("lstm.bias_ih", &[4 * m]),
            Slot::plain("lstm.bias_hh", &[4 * m]),
            Slot::plain("head.weight", &[outputs, m]),
            Slot::plain("head.bias", &[outputs]),
        ]
    }
}

/// What the recurrent network remembers, each `[B, M]`.
#[derive(Debug)]
pub struct Memory {
    /// The cell state; not normalized, and the largest part of what the reward reads.
    pub c: Tensor,
    /// The output.
    pub h: Tensor,
}

impl Memory {
    /// Nothing remembered, for a batch of `b`.
    pub fn zeros(b: i64, config: &MdnRnnConfig) -> Self {
        let zeros = || Tensor::zeros([b, config.memory], (Kind::Float, Device::Cpu));
        Self { c: zeros(), h: zeros() }
    }

    /// The same on a device.
    pub(super) fn on(&self, device: Device) -> Self {
        Self { c: self.c.to_device(device), h: self.h.to_device(device) }
    }
}

impl Clone for Memory {
    fn clone(&self) -> Self {
        Self { c: self.c.shallow_clone(), h: self.h.shallow_clone() }
    }
}

/// A mixture of K Gaussians **for each latent coordinate by itself**. The three tensors are `[…, Z, K]`.
///
/// (Some world models share one mixture over all coordinates; this one, like the original, does not.)
#[derive(Debug)]
pub struct Mixture {
    /// Logarithms of the weights, normalized over K.
    pub log_pi: Tensor,
    /// Means.
    pub mean: Tensor,
    /// Logarithms of the standard deviations, not clamped.
    pub log_std: Tensor,
}

/// The randomness of one imagined step, drawn in Rust so that torch's global generator plays no part.
#[derive(Debug)]
pub struct Noise {
    /// Uniform in `[0, 1)`, `[B, Z]`: picks the component.
    pub uniform: Tensor,
    /// Standard normal, `[B, Z]`: the place in it.
    pub normal: Tensor,
}

impl Noise {
    /// Fresh noise for a batch of `b` states of `latent` coordinates.
    pub fn draw(b: i64, latent: i64, rng: &mut impl Rng) -> Self {
        let uniform: Vec<f32> = (0..b * latent).map(|_| rng.random()).collect();
        Self { uniform: from_slice(&uniform, &[b, latent]), normal: normal(rng, &[b, latent]) }
    }

    /// The same on a device.
    pub(super) fn on(&self, device: Device) -> Self {
        Self { uniform: self.uniform.to_device(device), normal: self.normal.to_device(device) }
    }
}

impl Mixture {
    /// The negative logarithm of the density at `y`, for every coordinate.
    ///
    /// ```text
    /// ℓ = −logsumexp_k [ log π_k − ½ ((y − m_k) / e^{s_k})² − s_k − ½ ln 2π ]
    /// ```
    ///
    /// # Shapes
    /// - `y`: `[…, Z]`
    /// - returns nats, `[…, Z]`
    pub fn nll(&self, y: &Tensor) -> Tensor {
        let standard = (y.unsqueeze(-1) - &self.mean) * (-&self.log_std).exp();
        let half_ln_2_pi = 0.5 * (2.0 * std::f64::consts::PI).ln();
        let log_density = &self.log_pi - standard.square() * 0.5 - &self.log_std - half_ln_2_pi;
        -log_density.logsumexp(-1, false)
    }

    /// A draw at `temperature` τ: components from softmax(log π / τ), deviations times √τ (method §4.5).
    ///
    /// # Shapes
    /// - returns `[B, Z]`
    pub fn sample(&self, temperature: f64, noise: &Noise) -> Tensor {
        let cumulative = (&self.log_pi / temperature).softmax(-1, Kind::Float).cumsum(-1, Kind::Float);
        // The first component whose cumulative weight reaches u: as many as lie below it. Rounding must not pass the last.
        let last = self.log_pi.size()[self.log_pi.dim() - 1] - 1;
        let component =
            cumulative.lt_tensor(&noise.uniform.unsqueeze(-1)).sum_dim_intlist(-1, true, Kind::Int64);
        let component = component.clamp_max(last); // [B, Z, 1]
        let mean = self.mean.gather(-1, &component, false).squeeze_dim(-1);
        let std = self.log_std.gather(-1, &component, false).squeeze_dim(-1).exp();
        mean + std * temperature.sqrt() * &noise.normal
    }

    /// The mean of the mixture sharpened by `temperature` τ: `Σ_k softmax(log π / τ)_k m_k`.
    ///
    /// # Shapes
    /// - returns `[B, Z]`
    pub fn mean(&self, temperature: f64) -> Tensor {
        let weights = (&self.log_pi / temperature).softmax(-1, Kind::Float);
        (weights * &self.mean).sum_dim_intlist(-1, false, Kind::Float)
    }
}

/// A trained or trainable memory.
#[derive(Debug)]
pub struct MdnRnn {
    config: MdnRnnConfig,
    /// Input weights, recurrent weights, and the two biases: gates in the order i, f, g, o.
    pub(super) lstm: [Tensor; 4],
    pub(super) head: Tensor,
    pub(super) head_bias: Tensor,
}

impl MdnRnn {
    /// A fresh network under `path`, drawn by `rng` as PyTorch draws it.
    pub fn new(path: &nn::Path<'_>, config: MdnRnnConfig, rng: &mut impl Rng) -> Self {
        let (m, inputs) = (config.memory, config.latent + config.actions);
        let outputs = config.latent * config.components * 3;
        let bound = 1.0 / (m as f64).sqrt();
        let lstm = path / "lstm";
        let lstm = [
            lstm.var_copy("weight_ih", &uniform(rng, &[4 * m, inputs], bound)),
            lstm.var_copy("weight_hh", &uniform(rng, &[4 * m, m], bound)),
            lstm.var_copy("bias_ih", &uniform(rng, &[4 * m], bound)),
            lstm.var_copy("bias_hh", &uniform(rng, &[4 * m], bound)),
        ];
        let head = (path / "head").var_copy("weight", &uniform(rng, &[outputs, m], bound));
        let head_bias = (path / "head").var_copy("bias", &uniform(rng, &[outputs], bound));
        Self { config, lstm, head, head_bias }
    }

    /// The same numbers under another name, for another thread.
    pub(super) fn shared(&self) -> Self {
        Self {
            config: self.config.clone(),
            lstm: self.lstm.each_ref().map(Tensor::shallow_clone),
            head: self.head.shallow_clone(),
            head_bias: self.head_bias.shallow_clone(),
        }
    }

    /// The shape of this network.
    pub fn config(&self) -> &MdnRnnConfig {
        &self.config
    }

    /// The memory after taking in latents and an action.
    ///
    /// # Shapes
    /// - `z`: `[B, Z]`, `actions`: `[B, A]` as driven, not scaled
    pub fn remember(&self, z: &Tensor, actions: &Tensor, memory: &Memory) -> Memory {
        let [w_ih, w_hh, b_ih, b_hh] = &self.lstm;
        let input = Tensor::cat(&[z, actions], 1);
        let (h, c) = input.lstm_cell(&[&memory.h, &memory.c], w_ih, w_hh, Some(b_ih), Some(b_hh));
        Memory { c, h }
    }

    /// Where the latents go from a memory that has taken in the present.
    ///
    /// # Shapes
    /// - `h`: `[…, M]`
    pub fn mixture(&self, h: &Tensor) -> Mixture {
        let MdnRnnConfig { latent, components, .. } = self.config;
        // The head's layout: for each latent, K logits, then K means, then K log-stds (method §4.1).
        let mut shape = h.size();
        shape.pop();
        shape.extend([latent, 3, components]);
        let out = match h.kind() {
            Kind::Float => h.linear(&self.head, Some(&self.head_bias)),
            kind => {
                h.linear(&self.head.to_kind(kind), Some(self.head_bias.to_kind(kind))).to_kind(Kind::Float)
            }
        };
        let out = out.view(shape.as_slice()); // […, Z, 3, K]
        let part = |i| out.select(-2, i);
        Mixture { log_pi: part(0).log_softmax(-1, Kind::Float), mean: part(1), log_std: part(2) }
    }

    /// Every output of a run over whole sequences, from an empty memory, in the arithmetic `kind`.
    ///
    /// # Shapes
    /// - `zs`: `[B, T, Z]`, `actions`: `[B, T, A]`
    /// - returns h, `[B, T, M]`
    fn run(&self, zs: &Tensor, actions: &Tensor, kind: Kind) -> Tensor {
        let [b, ..] = dims::<3>(zs);
        let nothing = Tensor::zeros([1, b, self.config.memory], (kind, zs.device()));
        let input = Tensor::cat(&[zs, actions], 2).to_kind(kind);
        let weights = self.lstm.each_ref().map(|weight| weight.to_kind(kind));
        let is_training = Tensor::requires_grad(&self.lstm[0]);
        if zs.device().is_cuda() && Cuda::cudnn_is_available() {
            // What `lstm` comes to, without its warning, every time, that the weights do not lie as cuDNN has them.
            const LSTM: i64 = 2;
            let (whole, m) = (None::<&Tensor>, self.config.memory);
            let batches: &[i64] = &[];
            let (hs, ..) = input.internal_cudnn_rnn(
                &weights.each_ref(),
                weights.len() as i64,
                whole,
                &nothing,
                Some(&nothing),
                LSTM,
                m,
                0,
                1,
                true,
                0.0,
                is_training,
                false,
                batches,
                None,
            );
            return hs;
        }
        let (hs, ..) =
            input.lstm(&[&nothing, &nothing], &weights.each_ref(), true, 1, 0.0, is_training, false, true);
        hs
    }

    /// How surprised the memory is by what came: the mean over all real steps and coordinates (method §4.3).
    ///
    /// Step t's latents and action are answered for by step t + 1's latents. The last action is not used.
    ///
    /// # Shapes
    /// - `zs`: `[B, T, Z]`, `actions`: `[B, T, A]`, `lens`: how many of the T steps of each row are real
    /// - returns nats per coordinate, `[]`
    pub fn loss(&self, zs: &Tensor, actions: &Tensor, lens: &[i64]) -> Tensor {
        let lens = Tensor::from_slice(lens).to_device(zs.device());
        self.loss_in(Kind::Float, zs, actions, &lens)
    }

    /// The same in the arithmetic `kind`, wherever the tensors are.
    ///
    /// # Shapes
    /// - as [`Self::loss`], and `lens`: `[B]`
    pub fn loss_in(&self, kind: Kind, zs: &Tensor, actions: &Tensor, lens: &Tensor) -> Tensor {
        let [_, t, z] = dims(zs);
        let hs = self.run(&zs.narrow(1, 0, t - 1), &actions.narrow(1, 0, t - 1), kind); // [B, T − 1, M]
        let nll = self.mixture(&hs).nll(&zs.narrow(1, 1, t - 1)); // [B, T − 1, Z]
        // DIFFERENCE: the authors count padded steps too. We do not.
        let step = Tensor::arange(t - 1, (Kind::Int64, zs.device()));
        let n_targets = lens.unsqueeze(1) - 1;
        let mask = step.unsqueeze(0).lt_tensor(&n_targets).to_kind(Kind::Float).unsqueeze(2); // [B, T − 1, 1]
        let n = mask.sum(Kind::Float) * z as f64;
        (nll * mask).sum(Kind::Float) / n
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::tensor::to_vec;

    fn rng() -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(0)
    }

    #[test]
    fn the_networks_have_the_papers_sizes() {
        for (config, size) in
            [(MdnRnnConfig::car_racing(), 423_392), (MdnRnnConfig::obstacle_car_racing(), 5_854_528)]
        {
            let store = nn::VarStore::new(Device::Cpu);
            MdnRnn::new(&store.root(), config, &mut rng());
            let n_parameters: usize = store.variables().values().map(Tensor::numel).sum();
            assert_eq!(n_parameters, size);
        }
    }

    #[test]
    fn equal_unit_gaussians_at_their_mean_cost_half_the_logarithm_of_two_pi() {
        let zeros = || Tensor::zeros([1, 2, 5], (Kind::Float, Device::Cpu));
        let mixture =
            Mixture { log_pi: zeros().log_softmax(-1, Kind::Float), mean: zeros(), log_std: zeros() };
        let nll = mixture.nll(&Tensor::zeros([1, 2], (Kind::Float, Device::Cpu)));
        assert!((nll.mean(Kind::Float).double_value(&[]) - 0.918_938_5).abs() < 1e-6);
    }

    #[test]
    fn a_sample_comes_from_the_component_that_the_uniform_noise_picks() {
        let log_pi = from_slice(&[0.25f32.ln(), 0.75f32.ln()], &[1, 1, 2]);
        let mixture = Mixture {
            log_pi,
            mean: from_slice(&[-1.0, 1.0], &[1, 1, 2]),
            log_std: from_slice(&[-20.0, -20.0], &[1, 1, 2]),
        };
        let draw = |u| {
            let noise = Noise { uniform: from_slice(&[u], &[1, 1]), normal: from_slice(&[0.0], &[1, 1]) };
            to_vec(&mixture.sample(1.0, &noise))[0]
        };
        assert_eq!([draw(0.2), draw(0.3), draw(0.999_999_9)], [-1.0, 1.0, 1.0]);
        assert!((mixture.mean(1.0).double_value(&[0, 0]) - 0.5).abs() < 1e-6, "the mean averages both");
        assert!(mixture.mean(0.1).double_value(&[0, 0]) > 0.99, "a low temperature sharpens");
    }

    /// Three Gaussians of one coordinate that differ in everything.
    fn uneven() -> Mixture {
        let of = |values: [f32; 3]| from_slice(&values, &[1, 1, 3]);
        Mixture {
            log_pi: of([0.3, -1.2, 0.5]).log_softmax(-1, Kind::Float),
            mean: of([-1.0, 0.5, 2.0]),
            log_std: of([-0.7, 0.2, 1.1]),
        }
    }

    // The expected numbers are those of
    //
    //   from torch import tensor
    //   from torch.distributions import Categorical, MixtureSameFamily, Normal
    //   std = tensor([-0.7, 0.2, 1.1], dtype=float).exp()
    //   means = Normal(tensor([-1.0, 0.5, 2.0], dtype=float), std)
    //   mixture = MixtureSameFamily(Categorical(logits=tensor([0.3, -1.2, 0.5], dtype=float)), means)
    //   -mixture.log_prob(tensor([-2.5, 0.1, 4.0], dtype=float))
    #[test]
    fn the_likelihood_is_pytorchs_away_from_the_means_and_with_scales_other_than_one() {
        for (y, expected) in [(-2.5, 3.630_628_2), (0.1, 2.199_630_7), (4.0, 2.925_200_3)] {
            let nll = uneven().nll(&from_slice(&[y], &[1, 1])).double_value(&[0, 0]);
            assert!((nll - expected).abs() < 1e-5, "of {y}: {nll} instead of {expected}");
        }
    }

    // By hand, for τ = 0.25: softmax(log π / τ) = [0.3098, 0.0008, 0.6894], of which u = 0.2 picks the first and u = 0.9 the
    // last; √τ = 0.5, so that a normal draw of −1.5 gives −1 − 0.75 e^−0.7 and 2 − 0.75 e^1.1.
    #[test]
    fn temperature_sharpens_the_choice_and_shrinks_deviations_by_its_root() {
        for (u, expected) in [(0.2, -1.372_439), (0.9, -0.253_125)] {
            let noise = Noise { uniform: from_slice(&[u], &[1, 1]), normal: from_slice(&[-1.5], &[1, 1]) };
            let drawn = uneven().sample(0.25, &noise).double_value(&[0, 0]);
            assert!((drawn - expected).abs() < 1e-5, "for u = {u}: {drawn} instead of {expected}");
        }
    }

    // In NumPy, after PyTorch's page on LSTMCell, whose gates are i, f, g, o:
    //
    //   from numpy import *
    //   Z, M, K = 2, 3, 2
    //   of = lambda *shape: 0.5 * cos(arange(prod(shape))).reshape(shape)
    //   w_ih, w_hh, b_ih, b_hh = of(4 * M, Z + 3), of(4 * M, M), of(4 * M), of(4 * M)
    //   W, b = of(3 * K * Z, M), of(3 * K * Z)
    //   z, a, c, h = array([0.3, -0.8]), array([0.5, 0.2, 0.0]), array([0.1, -0.2, 0.3]), array([0.4, 0.0, -0.1])
    //   s = lambda x: 1 / (1 + exp(-x))
    //   i, f, g, o = split(w_ih @ concatenate([z, a]) + b_ih + w_hh @ h + b_hh, 4)
    //   c = s(f) * c + s(i) * tanh(g); h = s(o) * tanh(c)
    //   logits, mean, log_std = moveaxis((W @ h + b).reshape(Z, 3, K), 1, 0)
    //   pi = exp(logits); pi /= pi.sum(1, keepdims=True)
    //   sharp = exp(log(pi) / 0.1); sharp /= sharp.sum(1, keepdims=True)
    //   c, h, pi, mean, log_std, (pi * mean).sum(1), (sharp * mean).sum(1)
    #[test]
    fn a_step_and_what_it_expects_are_those_of_the_formulas() {
        let store = nn::VarStore::new(Device::Cpu);
        let config = MdnRnnConfig { latent: 2, memory: 3, components: 2, actions: 3 };
        let mdn_rnn = MdnRnn::new(&store.root(), config, &mut rng());
        for (_, mut variable) in store.variables() {
            let values: Vec<_> = (0..variable.numel()).map(|i| 0.5 * (i as f32).cos()).collect();
            tch::no_grad(|| variable.copy_(&from_slice(&values, &variable.size())));
        }
        let memory =
            Memory { c: from_slice(&[0.1, -0.2, 0.3], &[1, 3]), h: from_slice(&[0.4, 0.0, -0.1], &[1, 3]) };
        let (z, action) = (from_slice(&[0.3, -0.8], &[1, 2]), from_slice(&[0.5, 0.2, 0.0], &[1, 3]));
        let memory = mdn_rnn.remember(&z, &action, &memory);
        let mixture = mdn_rnn.mixture(&memory.h);
        for (what, found, wanted) in [
            ("c", &memory.c, &[0.557_973_7, 0.304_910_2, 0.216_360_2][..]),
            ("h", &memory.h, &[0.136_951_2, 0.071_970_6, 0.103_640_8]),
            ("π", &mixture.log_pi.exp(), &[0.592_139, 0.407_861, 0.575_951_8, 0.424_048_2]),
            ("m", &mixture.mean, &[-0.122_735_7, -0.587_351_3, 0.025_488_2, -0.548_973_8]),
            ("s", &mixture.log_std, &[-0.229_297_9, 0.041_090_3, -0.332_826_2, -0.076_062]),
            ("the mean", &mixture.mean(1.0), &[-0.312_234_3, -0.218_111_3]),
            ("the mean at 0.1", &mixture.mean(0.1), &[-0.133_641_6, -0.000_197_1]),
        ] {
            for (found, wanted) in to_vec(found).into_iter().zip(wanted) {
                assert!((found - wanted).abs() < 1e-5, "{what}: {found} instead of {wanted}");
            }
        }
    }

    #[test]
    fn actions_of_any_length_are_told_where_they_have_not_three_numbers() {
        let said = |config: &MdnRnnConfig| serde_json::to_string(config).unwrap();
        assert_eq!(said(&MdnRnnConfig::tiny()), r#"{"latent":4,"memory":16,"components":2}"#);
        let config = MdnRnnConfig { actions: 14, ..MdnRnnConfig::tiny() };
        assert_eq!(said(&config), r#"{"latent":4,"memory":16,"components":2,"actions":14}"#);
        for config in [config.clone(), MdnRnnConfig::tiny()] {
            assert_eq!(serde_json::from_str::<MdnRnnConfig>(&said(&config)).unwrap(), config);
        }
        assert!(MdnRnnConfig { actions: 49, ..config.clone() }.check().is_err());
        let store = nn::VarStore::new(Device::Cpu);
        let mdn_rnn = MdnRnn::new(&store.root(), config, &mut rng());
        let (zs, actions) = (normal(&mut rng(), &[2, 6, 4]), normal(&mut rng(), &[2, 6, 14]));
        assert!(mdn_rnn.loss(&zs, &actions, &[6, 4]).double_value(&[]).is_finite());
    }

    #[test]
    fn running_a_sequence_is_remembering_step_by_step() {
        let store = nn::VarStore::new(Device::Cpu);
        let mdn_rnn = MdnRnn::new(&store.root(), MdnRnnConfig::tiny(), &mut rng());
        let (zs, actions) = (normal(&mut rng(), &[2, 6, 4]), normal(&mut rng(), &[2, 6, 3]));
        let hs = mdn_rnn.run(&zs, &actions, Kind::Float);
        let mut memory = Memory::zeros(2, mdn_rnn.config());
        for t in 0..6 {
            memory = mdn_rnn.remember(&zs.select(1, t), &actions.select(1, t), &memory);
        }
        assert!((hs.select(1, 5) - memory.h).abs().max().double_value(&[]) < 1e-5);
    }

    #[test]
    fn padding_does_not_count() {
        let store = nn::VarStore::new(Device::Cpu);
        let mdn_rnn = MdnRnn::new(&store.root(), MdnRnnConfig::tiny(), &mut rng());
        let (zs, actions) = (normal(&mut rng(), &[1, 6, 4]), normal(&mut rng(), &[1, 6, 3]));
        let short = mdn_rnn.loss(&zs.narrow(1, 0, 4), &actions.narrow(1, 0, 4), &[4]).double_value(&[]);
        let padded = mdn_rnn.loss(&zs, &actions, &[4]).double_value(&[]);
        assert!((short - padded).abs() < 1e-6, "{short} and {padded}");
    }
}
