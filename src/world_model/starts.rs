//! Where dreams may start: states that a model passes through in real episodes (method §5).

use tch::Tensor;

use crate::env::{Action, Frame};
use crate::tensor::{Parameters, dims, from_slice, to_vec};
use crate::world_model::{LatentState, State, WorldModel, actions_tensor};

impl WorldModel {
    /// The states in a real episode before the steps `at`, the memory having taken in all steps before.
    pub fn states_of(&self, frames: &[Frame], actions: &[Action], at: &[usize]) -> Vec<LatentState> {
        let mut memory = self.no_memory(1);
        let mut found = Vec::new();
        let until = at.iter().max().map_or(0, |last| last + 1).min(frames.len());
        for (t, frame) in frames[..until].iter().enumerate() {
            let state = State { z: self.observe(std::slice::from_ref(frame)), memory };
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

/// The starts that lie among `parameters`, if any do.
pub(super) fn unpack(parameters: &Parameters) -> Vec<LatentState> {
    let part = |name: &str| parameters.tensor(&format!("starts.{name}"));
    let (Some(zs), Some(cs), Some(hs)) = (part("z"), part("c"), part("h")) else { return Vec::new() };
    let [n, _] = dims(&zs);
    let row = |rows: &Tensor, i| to_vec(&rows.get(i));
    (0..n).map(|i| LatentState { z: row(&zs, i), c: row(&cs, i), h: row(&hs, i) }).collect()
}
