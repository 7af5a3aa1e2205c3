//! The memory rearranged for looking ahead: the function of [`MdnRnn`] in fewer products, for which planning waits.

use tch::{Device, Kind, Tensor};

use crate::world_model::fast_kind;
use crate::world_model::mdn_rnn::{MdnRnn, Memory};

/// A frozen [`MdnRnn`] that follows the mean of its mixtures.
///
/// One product takes in latents, action and output together, against weights that lie as the product reads them. The
/// head's deviations are left out. Looking ahead from 15 states at once then takes less than half the time.
#[derive(Debug)]
pub(super) struct FusedRollout {
    /// `[Z + A + M, 4 M]`: gates in the order i, f, o, g, so that those with a sigmoid lie together.
    weight: Tensor,
    bias: Tensor,
    /// `[M, 2 K Z]`: all logits, then all means, both component by component.
    head: Tensor,
    head_bias: Tensor,
    /// K and Z.
    mixture: [i64; 2],
    /// The arithmetic of both products.
    kind: Kind,
}

/// More weights than these no longer stay near the processor: fetching them anew at every step is what takes the time,
/// so that half as many bytes take half as long.
const MANY: usize = 2_000_000;

impl FusedRollout {
    /// That of `mdn_rnn`, whose parameters it copies.
    pub(super) fn of(mdn_rnn: &MdnRnn) -> Self {
        let [w_ih, w_hh, b_ih, b_hh] = &mdn_rnn.lstm;
        let (z, k) = (mdn_rnn.config().latent, mdn_rnn.config().components);
        let by_gate = |rows: &Tensor| {
            let gates = rows.chunk(4, 0);
            Tensor::cat(&[&gates[0], &gates[1], &gates[3], &gates[2]], 0)
        };
        let without_deviations = |rows: &Tensor| {
            let parts = rows.view([z, 3, k, -1]).narrow(1, 0, 2); // [Z, 2, K, …]
            parts.permute([1, 2, 0, 3]).reshape([2 * k * z, -1])
        };
        let columns = |rows: Tensor| rows.tr().contiguous();
        let is_many = w_ih.device() == Device::Cpu && w_ih.numel() + w_hh.numel() > MANY;
        let kind = if is_many { fast_kind() } else { Kind::Float };
        tch::no_grad(|| Self {
            weight: columns(by_gate(&Tensor::cat(&[w_ih, w_hh], 1))).to_kind(kind),
            bias: by_gate(&(b_ih + b_hh)).to_kind(kind),
            head: columns(without_deviations(&mdn_rnn.head)).to_kind(kind),
            head_bias: without_deviations(&mdn_rnn.head_bias).view(-1).to_kind(kind),
            mixture: [k, z],
            kind,
        })
    }

    /// The same numbers under another name, for another thread.
    pub(super) fn shared(&self) -> Self {
        let [weight, bias] = [&self.weight, &self.bias].map(Tensor::shallow_clone);
        let [head, head_bias] = [&self.head, &self.head_bias].map(Tensor::shallow_clone);
        Self { weight, bias, head, head_bias, mixture: self.mixture, kind: self.kind }
    }

    /// The latents and the memory that follow: [`MdnRnn::remember`], then the mean at `temperature` of the mixture.
    ///
    /// # Shapes
    /// - `z`: `[B, Z]`, `actions`: `[B, A]` as driven
    /// - returns `[B, Z]`
    pub(super) fn imagine(
        &self,
        z: &Tensor,
        actions: &Tensor,
        memory: &Memory,
        temperature: f64,
    ) -> (Tensor, Memory) {
        let input = Tensor::cat(&[z, actions, &memory.h], 1).to_kind(self.kind);
        let gates = self.bias.addmm(&input, &self.weight).to_kind(Kind::Float); // [B, 4 M]
        let m = gates.size()[1] / 4;
        let open = gates.narrow(1, 0, 3 * m).sigmoid();
        let gate = |i| open.narrow(1, i * m, m);
        let c = (gate(1) * &memory.c).addcmul(&gate(0), &gates.narrow(1, 3 * m, m).tanh());
        let h = gate(2) * c.tanh();
        let [k, z] = self.mixture;
        let out = self.head_bias.addmm(&h.to_kind(self.kind), &self.head);
        let out = out.to_kind(Kind::Float).view([-1, 2, k, z]);
        let weights = (out.select(1, 0) / temperature).softmax(1, Kind::Float);
        let mean = (weights * out.select(1, 1)).sum_dim_intlist(1, false, Kind::Float);
        (mean, Memory { c, h })
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;
    use tch::nn;

    use super::*;
    use crate::tensor::normal;
    use crate::world_model::MdnRnnConfig;

    #[test]
    fn the_fused_rollout_is_remembering_and_the_mean_of_the_mixture() {
        // The second's weights are many, and taken in the arithmetic that is quick here.
        let of_five = MdnRnnConfig { actions: 5, ..MdnRnnConfig::tiny() };
        for (config, within) in
            [(MdnRnnConfig::tiny(), 1e-5), (of_five, 1e-5), (MdnRnnConfig::obstacle_car_racing(), 0.02)]
        {
            let rng = &mut ChaCha8Rng::seed_from_u64(0);
            let store = nn::VarStore::new(Device::Cpu);
            let (latent, m, n_axes) = (config.latent, config.memory, config.actions);
            let mdn_rnn = MdnRnn::new(&store.root(), config, rng);
            let (z, actions) = (normal(rng, &[5, latent]), normal(rng, &[5, n_axes]));
            let memory = Memory { c: normal(rng, &[5, m]), h: normal(rng, &[5, m]) };
            let (mean, quick) = FusedRollout::of(&mdn_rnn).imagine(&z, &actions, &memory, 0.1);
            let memory = mdn_rnn.remember(&z, &actions, &memory);
            let apart = |a: &Tensor, b: &Tensor| (a - b).abs().max().double_value(&[]);
            let apart = [
                (&quick.c, &memory.c),
                (&quick.h, &memory.h),
                (&mean, &mdn_rnn.mixture(&memory.h).mean(0.1)),
            ]
            .map(|(a, b)| apart(a, b));
            assert!(apart.iter().all(|apart| *apart < within), "{apart:?} of at most {within}");
        }
    }
}
