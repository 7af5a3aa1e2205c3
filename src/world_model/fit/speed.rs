//! How fast the networks are trained on a device, with data that cost nothing to get.

use std::time::{Duration, Instant};

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use tch::{Kind, Tensor, nn};

use crate::tensor::adam::Adam;
use crate::tensor::{Backend, intensities};
use crate::world_model::fit::FitConfig;
use crate::world_model::fit::data::DeviceSequences;
use crate::world_model::{MdnRnn, Vae, WorldModelConfig};

/// What is trained in a second.
#[derive(Clone, Copy, Debug)]
pub struct Speed {
    /// Pictures, by vision.
    pub pictures: f64,
    /// Steps, by memory.
    pub steps: f64,
    /// Steps, by memory in single precision, as at the end of a fit.
    pub steps_in_full: f64,
}

/// The speed of updates as a fit makes them, each network trained for about so long on noise.
pub fn speed(config: &WorldModelConfig, fit: &FitConfig, backend: Backend, lasting: Duration) -> Speed {
    let rng = &mut ChaCha8Rng::seed_from_u64(0);
    backend.begin(rng);
    let (batch, latent) = (fit.vae.batch as i64, config.vae.latent);

    let store = nn::VarStore::new(backend.device);
    let vae = Vae::new(&store.root(), config.vae.clone(), backend.kind, rng);
    let (n, [height, width]) = (4 * batch, config.vae.sides());
    let pixels = Tensor::randint(256, [n, height, width, 3], (Kind::Uint8, backend.device));
    let pictures = per_second(backend, &store, None, lasting, || {
        let drawn = Tensor::randint(n, [batch], (Kind::Int64, backend.device));
        let pixels = intensities(&pixels.index_select(0, &drawn));
        let loss = vae.loss(&pixels, &backend.normal(&mut *rng, &[batch, latent]));
        loss.reconstruction + loss.divergence
    });
    drop((vae, store));

    let (window, options) = (fit.window as i64, (Kind::Float, backend.device));
    let rng = &mut ChaCha8Rng::seed_from_u64(0);
    let steps = |kind: Kind, rng: &mut ChaCha8Rng| {
        let store = nn::VarStore::new(backend.device);
        let mdn_rnn = MdnRnn::new(&store.root(), config.mdn_rnn.clone(), rng);
        let lens = [2 * window; 64];
        let noise = |width: i64| Tensor::randn([lens.iter().sum(), width], options);
        let sequences =
            DeviceSequences::of(noise(latent), noise(latent), noise(config.mdn_rnn.actions), &lens);
        per_second(backend, &store, Some(1.0), lasting, || {
            let windows = sequences.windows(fit.mdn_rnn.batch, fit.window);
            mdn_rnn.loss_in(kind, &windows.zs, &windows.actions, &windows.lens)
        }) * window as f64
            * fit.mdn_rnn.batch as f64
    };
    let (quick, full) = (steps(backend.recurrent_kind(), rng), steps(Kind::Float, rng));
    Speed { pictures: pictures * batch as f64, steps: quick, steps_in_full: full }
}

/// How many updates are made in a second.
fn per_second(
    backend: Backend,
    store: &nn::VarStore,
    clip: Option<f64>,
    lasting: Duration,
    mut loss: impl FnMut() -> Tensor,
) -> f64 {
    // The first are slower: libraries are loaded, and ways to compute tried out.
    let (first, at_once) = if backend.is_cpu() { (1, 1) } else { (20, 20) };
    let mut adam = Adam::new(store);
    let mut updates = |n: usize| {
        for _ in 0..n {
            adam.step(&loss(), 1e-6, clip);
        }
        wait(store);
    };
    updates(first);
    let (begun, mut n) = (Instant::now(), 0);
    while n == 0 || begun.elapsed() < lasting {
        updates(at_once);
        n += at_once;
    }
    n as f64 / begun.elapsed().as_secs_f64()
}

/// Waits until the last update has reached the parameters, by reading one.
fn wait(store: &nn::VarStore) {
    if let Some(variable) = store.variables().values().next() {
        variable.view(-1).double_value(&[0]);
    }
}
