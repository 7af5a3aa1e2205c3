//! Trajectories that are worth asking about, found by following a gradient: ReQueST's (method §10).

use std::ops::ControlFlow;

use rand::{Rng, RngExt as _};
use rand_distr::{Distribution as _, StandardNormal};
use serde::{Deserialize, Serialize};
use tch::{Kind, Tensor, nn};

use crate::dream::{DreamEpisode, Rows};
use crate::query::TRAJECTORY_LEN;
use crate::reward::SparseReward;
use crate::tensor::adam::pytorch_adam;
use crate::tensor::{NotFinite, from_slice, to_vec};
use crate::world::{Action, ActionRanges, WorldSpec};
use crate::world_model::{LatentState, State, WorldModel};

/// How many actions a trajectory has that lead from state to state.
const N_ACTIONS: i64 = TRAJECTORY_LEN as i64 - 1;
/// Trajectories of a round, each of which begins elsewhere if there are so many starts. Paper: 15.
pub const ROUND: usize = 15;
/// Latents seen before that novelty is measured against, at the most.
const N_REFERENCES: usize = 1000;
/// Where a world's file does not say what searches begin with, so many constant actions over its axes are.
const BEGINNINGS: usize = 9;

/// What makes a trajectory worth asking about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Acquisition {
    /// The members of the ensemble disagree.
    Uncertainty,
    /// It is thought to be good.
    MaxReward,
    /// It is thought to be bad.
    MinReward,
    /// It is unlike what was seen.
    Novelty,
}

impl Acquisition {
    /// That of start `i` in a round: each of the first three in turn, then novelty for all, then those by turns, then any.
    pub fn of(round: usize, i: usize, rng: &mut impl Rng) -> Self {
        const THREE: [Acquisition; 3] =
            [Acquisition::Uncertainty, Acquisition::MaxReward, Acquisition::MinReward];
        match round {
            0 => THREE[i % 3],
            1 => Self::Novelty,
            2 | 3 => THREE[(i + round - 1) % 3],
            _ => [THREE[0], THREE[1], THREE[2], Self::Novelty][rng.random_range(0..4)],
        }
    }
}

/// How trajectories are searched for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SynthesisConfig {
    /// Steps of the gradient. Authors' code: 200.
    pub iterations: usize,
    /// Adam's step. Paper: 1e-2.
    pub learning_rate: f64,
    /// τ of the imagined mean. Authors' code: 0.1.
    pub temperature: f64,
}

impl SynthesisConfig {
    /// The authors' values.
    pub fn paper() -> Self {
        Self { iterations: 200, learning_rate: 1e-2, temperature: 0.1 }
    }
}

/// For each start the trajectory that serves its acquisition best. `seen` are the latents that labeled transitions led to.
///
/// Nothing comes where `on_iteration` breaks off. Where what a search wants to be small is no number, that is the error.
///
/// `// DIFFERENCE:` all searches go on side by side, each with moments of its own, and what is kept is the actions that
/// led to the states that are kept (method §14.30).
///
/// # Shapes
/// - `seen`: `[N, Z]`
pub fn synthesize(
    model: &WorldModel,
    reward: &SparseReward,
    wanted: &[(&LatentState, Acquisition)],
    seen: Option<&Tensor>,
    config: &SynthesisConfig,
    rng: &mut impl Rng,
    on_iteration: &mut dyn FnMut(usize) -> ControlFlow<()>,
) -> Result<Option<Vec<DreamEpisode>>, NotFinite> {
    // Only the actions are moved: no gradient of anything else is asked for.
    let reward = &reward.for_inference();
    let beginnings = constant_beginnings(model.spec());
    let n_searches = beginnings.len() + 1;
    let starts: Vec<_> = wanted.iter().flat_map(|(start, _)| vec![*start; n_searches]).collect();
    let start = State::side_by_side(&starts).on(model.backend().device);
    let device = model.backend().device;
    let store = nn::VarStore::new(device);
    let mut actions = store.root().var_copy(
        "actions",
        &drawn_beginnings(&beginnings, wanted.len(), model.ranges(), rng).to_device(device),
    ); // [B, 49, A]
    let mut adam = pytorch_adam(&store, config.learning_rate);
    let end = |i: usize| {
        Tensor::from_slice(&model.ranges().iter().map(|range| range[i]).collect::<Vec<f32>>())
            .to_device(device)
    };
    let (low, high) = (end(0), end(1));
    let mut best: Vec<Option<(f32, Tensor, Tensor)>> = (0..starts.len()).map(|_| None).collect();
    for i in 0..config.iterations {
        let references = seen.map(|seen| drawn(seen, rng).to_device(device));
        let (zs, features) = imagined(model, &start, &actions, config.temperature);
        let losses = losses(reward, wanted, &zs, &features, &actions, references.as_ref(), n_searches);
        let values = to_vec(&losses.detach());
        if values.iter().any(|loss| !loss.is_finite()) {
            let what =
                format!("what the search for a trajectory wants to be small, at its iteration {}", i + 1);
            return Err(NotFinite(what));
        }
        for (idx, (best, &loss)) in best.iter_mut().zip(&values).enumerate() {
            if best.as_ref().is_none_or(|(least, ..)| loss < *least) {
                let at = |tensor: &Tensor| tensor.detach().select(0, idx as i64).copy();
                *best = Some((loss, at(&zs), at(&actions)));
            }
        }
        adam.backward_step(&losses.sum(Kind::Float));
        tch::no_grad(|| actions.copy_(&actions.maximum(&low).minimum(&high)));
        if on_iteration(i + 1).is_break() {
            return Ok(None);
        }
    }
    let best_of = |searches: &[Option<(f32, Tensor, Tensor)>], start: &LatentState| {
        let found = searches.iter().flatten().min_by(|a, b| a.0.total_cmp(&b.0));
        found.map(|(_, zs, actions)| episode(start, zs, actions, model.spec()))
    };
    Ok(best.chunks(n_searches).zip(wanted).map(|(searches, (start, _))| best_of(searches, start)).collect())
}

/// What every search begins with, constant throughout. One more is drawn by chance.
///
/// Those of the world's file; else nobody does anything, and each axis by itself at its ends, the first ones first.
fn constant_beginnings(spec: &WorldSpec) -> Vec<Action> {
    if !spec.planner.beginnings.is_empty() {
        return spec.planner.beginnings.iter().map(Action::new).collect();
    }
    let neutral = Action::new(spec.neutral());
    let mut all = vec![neutral];
    for (i, axis) in spec.axes.iter().enumerate() {
        for end in [axis.high, axis.low] {
            let moved = neutral.map(|j, value| if i == j { end } else { value });
            if !all.contains(&moved) && all.len() < BEGINNINGS {
                all.push(moved);
            }
        }
    }
    all
}

/// The actions that the searches of all starts begin with, `[B, 49, A]`.
fn drawn_beginnings(
    constant: &[Action],
    n_starts: usize,
    ranges: &ActionRanges,
    rng: &mut impl Rng,
) -> Tensor {
    let mut all = Vec::new();
    for _ in 0..n_starts {
        for action in constant {
            all.extend(action.repeat(N_ACTIONS as usize));
        }
        for _ in 0..N_ACTIONS {
            for [low, high] in ranges.iter() {
                let drawn: f32 = StandardNormal.sample(rng);
                all.push((high - low) * (1.0 / (1.0 + (-drawn).exp())) + low);
            }
        }
    }
    from_slice(&all, &[-1, N_ACTIONS, ranges.n_axes() as i64])
}

/// Some of the rows of `seen`.
fn drawn(seen: &Tensor, rng: &mut impl Rng) -> Tensor {
    let n = seen.size()[0] as usize;
    if n <= N_REFERENCES {
        return seen.shallow_clone();
    }
    let picks: Vec<i64> = (0..N_REFERENCES).map(|_| rng.random_range(0..n) as i64).collect();
    seen.index_select(0, &Tensor::from_slice(&picks))
}

/// Where the actions lead, through which gradients pass: the latents of all states, and the features of all but the last.
///
/// # Shapes
/// - `actions`: `[B, 49, A]`
/// - returns `[B, 50, Z]` and `[B, 49, F]`
fn imagined(model: &WorldModel, start: &State, actions: &Tensor, temperature: f64) -> (Tensor, Tensor) {
    let mut state = start.clone();
    let (mut zs, mut features) = (vec![state.z.shallow_clone()], Vec::new());
    for t in 0..N_ACTIONS {
        features.push(state.features());
        state = model.imagine_for_gradients(&state, &actions.select(1, t), temperature);
        zs.push(state.z.shallow_clone());
    }
    (Tensor::stack(&zs, 1), Tensor::stack(&features, 1))
}

/// What every search wants to be small, `[B]` (method §10.1).
fn losses(
    reward: &SparseReward,
    wanted: &[(&LatentState, Acquisition)],
    zs: &Tensor,
    features: &Tensor,
    actions: &Tensor,
    references: Option<&Tensor>,
    n_searches: usize,
) -> Tensor {
    let mut all = Vec::new();
    for (i, (_, acquisition)) in wanted.iter().enumerate() {
        let mine = |tensor: &Tensor| tensor.narrow(0, (i * n_searches) as i64, n_searches as i64);
        let chances = || reward.chances(&mine(features).flatten(0, 1), &mine(actions).flatten(0, 1)); // [E, N, 3]
        let mean = |per_step: Tensor| per_step.view([n_searches as i64, -1]).mean_dim(1, false, Kind::Float);
        all.push(match (acquisition, references) {
            (Acquisition::Uncertainty, _) => -mean(disagreement(&chances())),
            (Acquisition::MinReward, _) => mean(SparseReward::expected(&chances())),
            (Acquisition::Novelty, Some(seen)) => novelty_loss(&mine(zs), seen),
            // Where nothing was seen, everything is new: then it had better be good.
            (Acquisition::MaxReward | Acquisition::Novelty, _) => -mean(SparseReward::expected(&chances())),
        });
    }
    Tensor::cat(&all, 0)
}

/// How far the members are from their mean: `U = 1/E Σ_e Σ_c p_c^e [ln(p_c^e + 1e-9) − ln(p̄_c + 1e-9)]`.
///
/// # Shapes
/// - `chances`: `[E, N, 3]`
/// - returns `[N]`
fn disagreement(chances: &Tensor) -> Tensor {
    let log = |p: &Tensor| (p + 1e-9).log();
    let mean = chances.mean_dim(0, true, Kind::Float);
    let apart = chances * (log(chances) - log(&mean));
    apart.sum_dim_intlist(-1, false, Kind::Float).mean_dim(0, false, Kind::Float)
}

/// How like the latents are to those seen: the mean of `exp(−‖z_seen − z_t‖ / √Z)`.
///
/// # Shapes
/// - `zs`: `[B, 50, Z]`, `seen`: `[N, Z]`
/// - returns `[B]`
fn novelty_loss(zs: &Tensor, seen: &Tensor) -> Tensor {
    let (b, z) = (zs.size()[0], zs.size()[2]);
    let rows = zs.reshape([-1, z]);
    // ‖a − b‖² = ‖a‖² + ‖b‖² − 2 a·b, kept off 0, where the root has no slope.
    let squares = |x: &Tensor| x.square().sum_dim_intlist(-1, false, Kind::Float);
    let square =
        squares(&rows).unsqueeze(1) + squares(seen).unsqueeze(0) - rows.matmul(&seen.transpose(0, 1)) * 2.0;
    let distance = square.clamp_min(1e-6).sqrt() / (z as f64).sqrt();
    (-distance).exp().view([b, -1]).mean_dim(1, false, Kind::Float)
}

/// A trajectory as a dream. Its last state has no action, and is given that of doing nothing.
fn episode(start: &LatentState, zs: &Tensor, actions: &Tensor, spec: &WorldSpec) -> DreamEpisode {
    let zs = Rows { width: start.z.len(), values: to_vec(zs) };
    let actions = to_vec(actions).chunks_exact(spec.axes.len()).map(Action::new).collect();
    let mut episode = DreamEpisode { zs, actions, ..DreamEpisode::new(start.clone(), 0) };
    episode.actions.push(Action::new(spec.neutral()));
    episode
}

#[cfg(test)]
mod tests {
    use tch::Device;

    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::reward::SparseConfig;
    use crate::world_model::{WorldModelConfig, untrained};

    fn rng() -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(0)
    }

    fn world() -> (WorldModel, SparseReward, LatentState) {
        let model = untrained(&WorldModelConfig::tiny(), &mut rng());
        let reward = SparseReward::new((36, model.hash().as_str()), SparseConfig::tiny(), &mut rng());
        (model, reward, LatentState { z: vec![0.1; 4], c: vec![0.0; 16], h: vec![0.0; 16] })
    }

    #[test]
    fn disagreement_and_novelty_are_those_by_hand() {
        // One member is sure of the first class, the other of the second: each is ln 2 from their mean.
        let chances = from_slice(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0], &[2, 1, 3]);
        assert!((disagreement(&chances).double_value(&[0]) - std::f64::consts::LN_2).abs() < 1e-6);
        // Latents at a distance of √Z from the only one that was seen.
        let zs = Tensor::ones([1, 2, 4], (Kind::Float, Device::Cpu));
        let seen = Tensor::zeros([1, 4], (Kind::Float, Device::Cpu));
        assert!((novelty_loss(&zs, &seen).double_value(&[0]) - (-1.0f64).exp()).abs() < 1e-6);
    }

    #[test]
    fn a_search_finds_more_of_what_it_wants_and_stays_in_reach() {
        let (model, reward, start) = world();
        let wants = [Acquisition::MaxReward, Acquisition::MinReward, Acquisition::Uncertainty];
        let wanted: Vec<_> = wants.iter().map(|acquisition| (&start, *acquisition)).collect();
        let found = |iterations| {
            let config = SynthesisConfig { iterations, learning_rate: 0.05, ..SynthesisConfig::paper() };
            let go_on = &mut |_| ControlFlow::Continue(());
            synthesize(&model, &reward, &wanted, None, &config, &mut rng(), go_on).unwrap().unwrap()
        };
        let worth = |dream: &DreamEpisode| {
            let features = dream.features(&model);
            let rows: Vec<f32> =
                (0..49).flat_map(|t| crate::reward::transition_row(&features, &dream.actions, t)).collect();
            let rows = from_slice(&rows, &[49, 39]);
            let chances = reward.chances(&rows.narrow(1, 0, 36), &rows.narrow(1, 36, 3));
            SparseReward::expected(&chances).mean(Kind::Float).double_value(&[])
        };
        let (first, last) = (found(1), found(40));
        assert!(worth(&last[0]) > worth(&first[0]) + 1e-4, "{} and {}", worth(&last[0]), worth(&first[0]));
        assert!(worth(&last[1]) < worth(&first[1]) - 1e-4, "{} and {}", worth(&last[1]), worth(&first[1]));
        for action in last.iter().flat_map(|dream| &dream.actions) {
            assert_eq!(*action, model.ranges().clamped(action));
        }
    }

    #[test]
    fn a_trajectory_is_where_its_actions_lead() {
        let (model, reward, start) = world();
        let config = SynthesisConfig { iterations: 3, ..SynthesisConfig::paper() };
        let wanted = [(&start, Acquisition::Uncertainty)];
        let go_on = &mut |_| ControlFlow::Continue(());
        let made = synthesize(&model, &reward, &wanted, None, &config, &mut rng(), go_on).unwrap().unwrap();
        let dream = &made[0];
        assert_eq!((dream.len(), dream.zs.len(), dream.zs.row(0)), (50, 50, &start.z[..]));
        let actions = crate::world_model::actions_tensor(&dream.actions[..49]).unsqueeze(0);
        let (zs, _) = imagined(&model, &State::from(&start), &actions, 0.1);
        let apart = to_vec(&zs).iter().zip(&dream.zs.values).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(apart < 1e-5, "{apart}");
    }
}
