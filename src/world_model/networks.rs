//! The networks of a world model, held once however many threads use them.

use std::sync::{Arc, Mutex, PoisonError, Weak};

use crate::tensor::Backend;
use crate::world_model::fused_rollout::FusedRollout;
use crate::world_model::mdn_rnn::MdnRnn;
use crate::world_model::vae::{Decoder, Encoder};

/// Frozen networks. Nobody writes into their numbers, so threads can share them.
#[derive(Debug)]
pub(super) struct Networks {
    /// Full precision: latents decide.
    pub(super) encoder: Encoder,
    /// Whatever is quickest here: pictures are only looked at.
    pub(super) decoder: Decoder,
    pub(super) mdn_rnn: MdnRnn,
    /// The same memory, rearranged.
    pub(super) fused_rollout: FusedRollout,
}

/// What keeps networks for the next thread that wants them. Each world model has one.
pub(super) type Kept = Arc<Mutex<Networks>>;

/// Networks in use, the hash of the file that they are from, and what computes them.
type InUse = (String, Backend, Weak<Mutex<Networks>>);

/// All that are in use.
static KEPT: Mutex<Vec<InUse>> = Mutex::new(Vec::new());

impl Networks {
    /// The networks of the file with this hash computed by `backend`: those that are in use, or else what `make` makes.
    pub(super) fn of<E>(
        hash: &str,
        backend: Backend,
        make: impl FnOnce() -> Result<Self, E>,
    ) -> Result<(Self, Kept), E> {
        let mut all = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
        all.retain(|(.., kept)| kept.strong_count() > 0);
        let there =
            all.iter().find(|(of, by, _)| of == hash && *by == backend).and_then(|(.., kept)| kept.upgrade());
        let kept = if let Some(kept) = there {
            kept
        } else {
            let kept = Arc::new(Mutex::new(make()?));
            all.push((hash.to_owned(), backend, Arc::downgrade(&kept)));
            kept
        };
        let networks = kept.lock().unwrap_or_else(PoisonError::into_inner).shared();
        Ok((networks, kept))
    }

    /// The same numbers under another name: tensors go from thread to thread, and are not used by two at once.
    fn shared(&self) -> Self {
        let Self { encoder, decoder, mdn_rnn, fused_rollout } = self;
        Self {
            encoder: encoder.shared(),
            decoder: decoder.shared(),
            mdn_rnn: mdn_rnn.shared(),
            fused_rollout: fused_rollout.shared(),
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use crate::tensor::{from_slice, to_vec};
    use crate::world_model::{WorldModel, WorldModelConfig, untrained};

    fn model(seed: u64) -> WorldModel {
        untrained(&WorldModelConfig::tiny(), &mut ChaCha8Rng::seed_from_u64(seed))
    }

    #[test]
    fn many_pictures_are_those_that_each_draws_alone() {
        let (model, n) = (model(23), 12);
        let zs: Vec<f32> = (0..4 * n).map(|i| (i as f32 * 0.37).sin()).collect();
        let together = model.decode(&from_slice(&zs, &[n, 4]));
        let alone: Vec<_> = zs.chunks_exact(4).flat_map(|z| model.decode(&from_slice(z, &[1, 4]))).collect();
        assert_eq!((together.len(), alone.len()), (12, 12));
        for (one, other) in together.iter().zip(&alone) {
            let apart = one.rgb().iter().zip(other.rgb()).map(|(a, b)| a.abs_diff(*b)).max();
            assert!(apart <= Some(1), "by rounding alone: {apart:?}");
        }
        assert_ne!(together[0], together[11], "they differ, so that their order shows");
    }

    #[test]
    fn models_of_one_file_share_their_numbers_and_others_do_not() {
        let one = model(21);
        let head = |model: &WorldModel| model.networks.mdn_rnn.head.data_ptr() as usize;
        let again = WorldModel::load(one.parameters().clone()).unwrap();
        assert_eq!(head(&one), head(&again));
        assert_ne!(head(&one), head(&model(22)));
        // Also after the first is gone.
        let (place, z) = (head(&one), [0.3; 4]);
        let painted = one.decode(&from_slice(&z, &[1, 4]));
        drop(one);
        let there = WorldModel::load(again.parameters().clone()).unwrap();
        assert_eq!(head(&there), place);
        assert_eq!(there.decode(&from_slice(&z, &[1, 4])), painted);
        let kept = to_vec(&there.networks.mdn_rnn.head);
        assert_eq!(kept, to_vec(&there.parameters().tensor("mdn_rnn.head.weight").unwrap()));
    }
}
