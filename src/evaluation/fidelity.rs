//! How true a world model is: what it sees again, and how far its dreams stray from what really came.

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::dataset::{Dataset, DatasetError};
use crate::tensor::{NotFinite, from_slice};
use crate::world::Frame;
use crate::world_model::{LatentState, Next, Noise, State, WorldModel, actions_tensor};

/// Steps of a dream that is compared with what really came.
pub const HORIZON: usize = 50;

/// Steps of the real episode that the memory takes in before the dream.
const WARM_UP: usize = 60;

/// Episodes of at most so many steps have no stretch that can be compared.
pub const LEAST: usize = WARM_UP + HORIZON + 1;

/// The figures of a world model on held-out episodes.
#[derive(Clone, Debug, Serialize)]
pub struct Fidelity {
    /// Stretches that were compared.
    pub n_stretches: usize,
    /// Root mean square error of reconstructed pixels, intensities in `[0, 1]`.
    pub reconstruction: f32,
    /// The same of pixels dreamed at temperature 1, after each number of steps in [`Self::STEPS`].
    pub dreamed: Vec<f32>,
    /// The same of what the planner imagines: mixture means at temperature 0.1.
    pub imagined: Vec<f32>,
    /// The same of a picture that stands still: what a model without dynamics would show.
    pub still: Vec<f32>,
}

impl Fidelity {
    /// After how many steps the drift is told.
    pub const STEPS: [usize; 6] = [1, 5, 10, 15, 25, HORIZON];
}

/// A stretch of an episode three times over: as it was, as it is seen, and as it is dreamed from its beginning.
#[derive(Clone, Debug)]
pub struct Stretch {
    /// The real frames, `HORIZON + 1`.
    pub real: Vec<Frame>,
    /// Each encoded and decoded.
    pub reconstructed: Vec<Frame>,
    /// The first encoded, the rest dreamed under the actions that were really taken.
    pub dreamed: Vec<Frame>,
    /// The same by mixture means.
    pub imagined: Vec<Frame>,
}

/// Why nothing can be said of a world model.
#[derive(Debug, thiserror::Error)]
pub enum FidelityError {
    /// The recordings cannot be read.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// What it dreams is no number, and so no picture.
    #[error("cannot say how true the world model is: {0}")]
    NotFinite(NotFinite),
}

/// Compares `n` stretches of the episodes `held_out`, drawn by `seed`.
pub fn fidelity(
    model: &WorldModel,
    dataset: &Dataset,
    held_out: &[usize],
    n: usize,
    seed: u64,
) -> Result<(Fidelity, Vec<Stretch>), FidelityError> {
    fidelity_told(model, dataset, held_out, n, seed, &mut |_, _| ())
}

/// The same; `told` hears how many stretches are done, of how many.
pub fn fidelity_told(
    model: &WorldModel,
    dataset: &Dataset,
    held_out: &[usize],
    n: usize,
    seed: u64,
    told: &mut dyn FnMut(usize, usize),
) -> Result<(Fidelity, Vec<Stretch>), FidelityError> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut stretches = Vec::new();
    for (done, &episode) in held_out.iter().cycle().take(n).enumerate() {
        told(done, n);
        let episode = dataset.episode(episode)?;
        let last = episode.frames.len().min(episode.actions.len()).saturating_sub(HORIZON + 1);
        if last <= WARM_UP {
            continue;
        }
        let start = rng.random_range(WARM_UP..=last);
        let before = start - WARM_UP..=start;
        let warm = model.states_of(&episode.frames[before.clone()], &episode.actions[before], &[WARM_UP]);
        let real = episode.frames[start..=start + HORIZON].to_vec();
        let actions = &episode.actions[start..start + HORIZON];
        let mut go_on = |mean: bool| {
            let mut state = State::from(&warm[0]);
            let mut zs = vec![LatentState::from(&state).z];
            for action in actions {
                let noise = Noise::draw(1, model.config().mdn_rnn.latent, &mut rng);
                let next = if mean {
                    Next::Mean { temperature: 0.1 }
                } else {
                    Next::Sample { temperature: 1.0, noise: &noise }
                };
                state = model.imagine(&state, &actions_tensor(&[*action]), next);
                let what = format!("step {} of a dream", zs.len());
                state.require_finite(&what).map_err(FidelityError::NotFinite)?;
                zs.push(LatentState::from(&state).z);
            }
            Ok::<_, FidelityError>(model.decode(&from_slice(&zs.concat(), &[zs.len() as i64, -1])))
        };
        let (dreamed, imagined) = (go_on(false)?, go_on(true)?);
        let reconstructed = model.decode(&model.observe(&real));
        stretches.push(Stretch { real, reconstructed, dreamed, imagined });
    }
    let over = |apart: &dyn Fn(&Stretch) -> f32| {
        (stretches.iter().map(apart).sum::<f32>() / stretches.len().max(1) as f32).sqrt()
    };
    let at = |of: fn(&Stretch) -> &Vec<Frame>| {
        Fidelity::STEPS.iter().map(|&t| over(&|s| square_error(&of(s)[t], &s.real[t]))).collect()
    };
    let figures = Fidelity {
        n_stretches: stretches.len(),
        reconstruction: over(&|s| {
            let pairs = s.reconstructed.iter().zip(&s.real);
            pairs.map(|(a, b)| square_error(a, b)).sum::<f32>() / s.real.len() as f32
        }),
        dreamed: at(|s| &s.dreamed),
        imagined: at(|s| &s.imagined),
        still: Fidelity::STEPS.iter().map(|&t| over(&|s| square_error(&s.real[0], &s.real[t]))).collect(),
    };
    Ok((figures, stretches))
}

/// The mean square difference of two frames' intensities.
fn square_error(a: &Frame, b: &Frame) -> f32 {
    let squares = a.rgb().iter().zip(b.rgb()).map(|(&a, &b)| ((f32::from(a) - f32::from(b)) / 255.0).powi(2));
    squares.sum::<f32>() / a.rgb().len() as f32
}
