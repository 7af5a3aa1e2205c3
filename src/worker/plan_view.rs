//! What the planner considered, decoded in the time that driving leaves.

use std::sync::Arc;

use crate::planner::{Candidate, Plan};
use crate::tensor::from_slice;
use crate::worker::CandidateView;
use crate::world::{Action, Axis};
use crate::world_model::WorldModel;

/// How many pictures of a candidate are drawn: on the way, and the last.
const N_FRAMES: usize = 3;
/// So many runs of equal actions are told one by one.
const MOST_RUNS: usize = 4;

/// The drawing of the candidates of one plan, one by one.
#[derive(Debug)]
pub(super) struct PlanDrawing {
    plan: Plan,
    views: Vec<CandidateView>,
}

impl PlanDrawing {
    /// Nothing of `plan` is drawn yet.
    pub(super) fn new(plan: Plan) -> Self {
        Self { plan, views: Vec::new() }
    }

    /// Whether all is drawn.
    pub(super) fn is_done(&self) -> bool {
        self.views.len() == self.plan.candidates.len()
    }

    /// Draws the next candidate.
    pub(super) fn draw_next(&mut self, model: &WorldModel) {
        if let Some(candidate) = self.plan.candidates.get(self.views.len()) {
            self.views.push(view(candidate, model));
        }
    }

    /// All candidates, and which was chosen.
    pub(super) fn finish(self) -> (Arc<[CandidateView]>, usize) {
        (self.views.into(), self.plan.chosen)
    }
}

fn view(candidate: &Candidate, model: &WorldModel) -> CandidateView {
    let n = candidate.zs.len();
    let shown: Vec<_> = (1..=N_FRAMES.min(n)).map(|i| i * n / N_FRAMES.min(n) - 1).collect();
    let zs: Vec<f32> = shown.iter().flat_map(|t| candidate.zs.row(*t)).copied().collect();
    CandidateView {
        actions: in_words(&candidate.actions, &model.spec().axes),
        predicted_return: candidate.predicted_return,
        frames: model.decode(&from_slice(&zs, &[shown.len() as i64, candidate.zs.width as i64])),
    }
}

/// Actions run by run, each as what is moved off its neutral value: `steer -1, gas 0.1 for 4; gas 0.2 for 11`.
///
/// Where every step differs, as in what was recorded, only how it begins and ends.
pub(super) fn in_words(actions: &[Action], axes: &[Axis]) -> String {
    let runs: Vec<&[Action]> = actions.chunk_by(|a, b| a == b).collect();
    let (Some(first), Some(last)) = (runs.first(), runs.last()) else { return String::new() };
    if runs.len() > MOST_RUNS {
        return format!("{} to {} in {}", name(first[0], axes), name(last[0], axes), actions.len());
    }
    let runs: Vec<_> = runs.iter().map(|run| format!("{} for {}", name(run[0], axes), run.len())).collect();
    runs.join("; ")
}

fn name(action: Action, axes: &[Axis]) -> String {
    let moved = axes.iter().zip(action.iter()).filter(|(axis, value)| **value != axis.neutral);
    let moved: Vec<_> = moved.map(|(axis, value)| format!("{} {}", axis.name, rounded(*value))).collect();
    if moved.is_empty() { "nothing".to_owned() } else { moved.join(", ") }
}

/// A value with as many digits as tell something.
fn rounded(value: f32) -> String {
    let digits = if value.abs() >= 100.0 { 0 } else { 2 };
    let text = format!("{value:.digits$}");
    if digits == 0 { text } else { text.trim_end_matches('0').trim_end_matches('.').to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dream::Rows;
    use crate::worker::fixtures;

    #[test]
    fn actions_are_said_run_by_run() {
        let mut actions = vec![Action::new([-1.0, 0.1, 0.0]); 4];
        actions.extend(vec![Action::new([0.0, 0.2, 0.0]); 10]);
        actions.push(Action::new([1.0, 0.1, 0.2]));
        let axes = crate::world::WorldSpec::built_in("car-racing").unwrap().axes;
        assert_eq!(
            in_words(&actions, &axes),
            "steer -1, gas 0.1 for 4; gas 0.2 for 10; steer 1, gas 0.1, brake 0.2 for 1"
        );
        let all_differ: Vec<_> = (0..20).map(|t| Action::new([0.0, t as f32 / 20.0, 0.0])).collect();
        assert_eq!(in_words(&all_differ, &axes), "nothing to gas 0.95 in 20");
    }

    #[test]
    fn a_plan_is_drawn_candidate_by_candidate_to_the_last_picture() {
        let zs = Rows { width: 4, values: (0..60).map(|i| i as f32 / 10.0).collect() };
        let candidate = Candidate { actions: vec![Action::new([0.0; 3]); 15], predicted_return: 2.5, zs };
        let last = fixtures::model().decode(&from_slice(candidate.zs.row(14), &[1, 4]));
        let mut drawing =
            PlanDrawing::new(Plan { candidates: vec![candidate.clone(), candidate], chosen: 1 });
        drawing.draw_next(&fixtures::model());
        assert!(!drawing.is_done(), "one of two");
        drawing.draw_next(&fixtures::model());
        assert!(drawing.is_done(), "two of two");
        let (views, chosen) = drawing.finish();
        assert_eq!((views.len(), chosen, views[0].frames.len()), (2, 1, 3));
        let apart = views[1].frames[2].rgb().iter().zip(last[0].rgb()).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(apart <= Some(2), "{apart:?}");
    }
}
