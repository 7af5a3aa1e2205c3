//! Where dreams may start: states that a model passes through in real episodes (method §5).

use tch::Tensor;

use crate::tensor::limits::{MAX_STARTS, within};
use crate::tensor::{Parameters, ParametersError, from_slice, to_vec};
use crate::world::{Action, Frame};
use crate::world_model::{LatentState, MdnRnnConfig, State, WorldModel, WorldModelError, actions_tensor};

impl WorldModel {
    /// The states in a real episode before the steps `at`, the memory having taken in all steps before.
    pub fn states_of(&self, frames: &[Frame], actions: &[Action], at: &[usize]) -> Vec<LatentState> {
        self.states(frames.len(), |t| self.observe(&frames[t..=t]), actions, at)
    }

    /// The same where the latents of the episode are known.
    ///
    /// # Shapes
    /// - `zs`: `[T, Z]`
    pub(super) fn states_of_latents(
        &self,
        zs: &Tensor,
        actions: &[Action],
        at: &[usize],
    ) -> Vec<LatentState> {
        self.states(zs.size()[0] as usize, |t| zs.narrow(0, t as i64, 1), actions, at)
    }

    /// The states before the steps `at` of `n`, whose latents `z` tells.
    fn states(
        &self,
        n: usize,
        z: impl Fn(usize) -> Tensor,
        actions: &[Action],
        at: &[usize],
    ) -> Vec<LatentState> {
        let mut memory = self.no_memory(1);
        let mut found = Vec::new();
        let until = at.iter().max().map_or(0, |last| last + 1).min(n);
        for t in 0..until {
            let state = State { z: z(t), memory };
            if at.contains(&t) {
                found.push(LatentState::from(&state));
            }
            let Some(action) = actions.get(t) else { break };
            memory = self.remember(&state, &actions_tensor(&[*action]));
        }
        found
    }
}

/// The starts as tensors: `starts.z`, `starts.c` and `starts.h`, a row each.
pub(super) fn pack(starts: &[LatentState]) -> Vec<(String, Tensor)> {
    let rows = |part: fn(&LatentState) -> &Vec<f32>| {
        let values: Vec<f32> = starts.iter().flat_map(part).copied().collect();
        from_slice(&values, &[starts.len() as i64, -1])
    };
    if starts.is_empty() {
        return Vec::new();
    }
    vec![
        ("starts.z".to_owned(), rows(|start| &start.z)),
        ("starts.c".to_owned(), rows(|start| &start.c)),
        ("starts.h".to_owned(), rows(|start| &start.h)),
    ]
}

/// The starts that lie among `parameters`, if any do: all three parts, a row of each a start.
pub(super) fn unpack(
    parameters: &Parameters,
    config: &MdnRnnConfig,
) -> Result<Vec<LatentState>, WorldModelError> {
    const NAMES: [&str; 3] = ["starts.z", "starts.c", "starts.h"];
    let wrong = |what| WorldModelError::Beside { what };
    let parts = NAMES.map(|name| parameters.finite(name));
    let [Some(zs), Some(cs), Some(hs)] = &lifted(parts)? else {
        let is_there = |name: &&str| parameters.tensor(name).is_some();
        return match (NAMES.iter().any(is_there), NAMES.iter().find(|name| !is_there(name))) {
            (true, Some(missing)) => {
                Err(wrong(format!("it has states to start dreams from, but no {missing:?}")))
            }
            _ => Ok(Vec::new()),
        };
    };
    let n = zs.size().first().copied().unwrap_or_default();
    within("the number of states to start dreams from", n, 0..=MAX_STARTS as i64)
        .map_err(WorldModelError::Config)?;
    for (name, part, width) in
        [(NAMES[0], zs, config.latent), (NAMES[1], cs, config.memory), (NAMES[2], hs, config.memory)]
    {
        let (found, wanted) = (part.size(), vec![n, width]);
        if found != wanted {
            return Err(ParametersError::Shape { name: name.to_owned(), found, wanted }.into());
        }
    }
    let row = |rows: &Tensor, i| to_vec(&rows.get(i));
    Ok((0..n).map(|i| LatentState { z: row(zs, i), c: row(cs, i), h: row(hs, i) }).collect())
}

/// The three, or the first error among them.
fn lifted<T, E>([a, b, c]: [Result<T, E>; 3]) -> Result<[T; 3], E> {
    Ok([a?, b?, c?])
}
