//! Learning the reward, and weighting answers otherwise.

use crate::app::App;
use crate::query::{Justifications, Weights};
use crate::session::{Event, Fit, Session};
use crate::tensor::Parameters;
use crate::worker::trainer::MIN_LABELS;
use crate::worker::{
    DreamInspectorCommand, DriverCommand, Learning, RewardReport, SessionWriterCommand, TrainerCommand,
    WorkerCommand,
};

/// On the reward.
#[derive(Clone, Debug, PartialEq)]
pub enum RewardCommand {
    /// Fits it to all answers, to the end.
    Fit {
        /// Of initialization and order; a fresh one where none is given.
        seed: Option<u64>,
    },
    /// Shows other weights while a slider is being moved.
    TryWeights(Weights),
    /// Lets answers weigh so from here on, and learns the reward anew.
    ChangeWeights(Weights),
}

/// Learning the reward.
#[derive(Debug, Default)]
pub(crate) struct Rewarding {
    pub latest: Option<Learning>,
    /// Loss of each member, by report.
    pub losses: Vec<Vec<[f64; 2]>>,
    pub held_out: Vec<[f64; 2]>,
    pub agreement: Vec<[f64; 2]>,
    /// Reports so far.
    pub n_reports: usize,
    pub parameters: Option<Parameters>,
    /// How many answers those rest on.
    pub n_learned: usize,
    pub is_fitting: bool,
    /// A fit that could not be written.
    pub unsaved: Option<(Parameters, Fit)>,
    /// Whether other weights are being learned.
    pub is_relearning: bool,
    /// Weights that are tried with a slider.
    pub tried: Option<Weights>,
    /// Fits that were asked for: the seed of each, and how many lines the log had then.
    pub asked: Vec<(u64, u64)>,
}

impl Rewarding {
    fn receive(&mut self, learning: Learning) {
        let x = self.n_reports as f64;
        self.n_reports += 1;
        self.losses.resize(learning.losses.len().max(self.losses.len()), Vec::new());
        for (curve, loss) in self.losses.iter_mut().zip(&learning.losses) {
            push_thinned(curve, [x, f64::from(*loss)]);
        }
        let n = learning.n_labels as f64;
        if let Some(loss) = learning.held_out_loss {
            push_by_label(&mut self.held_out, [n, f64::from(loss)]);
        }
        if let Some(agreement) = learning.agreement {
            push_by_label(&mut self.agreement, [n, f64::from(agreement)]);
        }
        self.is_fitting = learning.fit_epochs.is_some();
        self.latest = Some(learning);
    }
}

/// Appends a point; a curve of very many loses every second one.
fn push_thinned(curve: &mut Vec<[f64; 2]>, point: [f64; 2]) {
    const MOST: usize = 4000;
    curve.push(point);
    if curve.len() > MOST {
        let mut is_kept = false;
        curve.retain(|_| {
            is_kept = !is_kept;
            is_kept
        });
    }
}

/// Appends a point, or moves the last one where nothing was answered since. Points of answers that were taken back go.
fn push_by_label(curve: &mut Vec<[f64; 2]>, point: [f64; 2]) {
    while curve.last().is_some_and(|last| last[0] > point[0]) {
        curve.pop();
    }
    match curve.last_mut() {
        Some(last) if last[0] == point[0] => *last = point,
        _ => push_thinned(curve, point),
    }
}

impl App {
    pub(super) fn reward_command(&mut self, command: RewardCommand) {
        match command {
            RewardCommand::Fit { seed } => self.fit_reward(seed),
            RewardCommand::TryWeights(weights) => self.state.reward.tried = Some(weights),
            RewardCommand::ChangeWeights(weights) => self.change_weights(weights),
        }
    }

    pub(super) fn reward_report(&mut self, report: RewardReport) {
        match report {
            RewardReport::Learning(learning) => self.state.reward.receive(learning),
            RewardReport::Learned { parameters, n_labels, fit } => self.learned(parameters, n_labels, fit),
        }
    }

    fn fit_reward(&mut self, seed: Option<u64>) {
        let Some(after) = self.state.session().map(Session::n_entries) else { return };
        let seed = seed.unwrap_or_else(|| self.fresh_seed());
        let reward = &mut self.state.reward;
        reward.is_fitting = true;
        // What is answered while it fits is not in it.
        reward.asked.push((seed, after));
        self.send(WorkerCommand::Trainer(TrainerCommand::Fit { seed }));
    }

    fn learned(&mut self, parameters: Parameters, n_labels: usize, fit: Option<(u64, Vec<f32>)>) {
        self.send(WorkerCommand::Driver(DriverCommand::Reward(parameters.clone())));
        let reward = &mut self.state.reward;
        reward.n_learned = n_labels;
        reward.parameters = Some(parameters.clone());
        reward.is_relearning = false;
        self.tell_inspector();
        self.tell_planner();
        let reward = &mut self.state.reward;
        let Some((seed, losses)) = fit else { return };
        reward.is_fitting = false;
        let latest = reward.latest.as_ref();
        let (epochs, held_out) = latest.map_or((0, None), |latest| (latest.epoch, latest.held_out_loss));
        let asked = reward.asked.iter().position(|(asked, _)| *asked == seed);
        let (Some(asked), Some(_)) = (asked, &self.state.open) else { return };
        // Those asked for before were overtaken by this one.
        let after = reward.asked.drain(..=asked).next_back().map_or(0, |(_, after)| after);
        let fit = Fit { after, n_labels, seed, epochs: epochs as u32, losses, held_out };
        self.save_reward(parameters, fit);
    }

    pub(super) fn save_reward(&mut self, parameters: Parameters, fit: Fit) {
        self.change(SessionWriterCommand::SaveReward { parameters, fit });
    }

    /// Tells the dream inspector of a new reward, if there is one.
    pub(super) fn tell_inspector(&mut self) {
        self.state.episodes.forget_reward();
        self.state.label.predictions = super::label::Predictions::default();
        if let Some(parameters) = self.state.reward.parameters.clone()
            && self.state.review.is_known()
        {
            self.send(WorkerCommand::DreamInspector(DreamInspectorCommand::Reward(parameters)));
        }
    }

    fn change_weights(&mut self, weights: Weights) {
        self.state.reward.tried = None;
        if weights == self.state.weights() {
            return;
        }
        if self.state.review.is_known() {
            self.send(WorkerCommand::DreamInspector(DreamInspectorCommand::Compare));
        }
        self.record(Event::WeightsChanged { weights });
    }

    /// Answers weigh differently now: their labels change, and the reward is learned anew.
    pub(super) fn weights_changed(&mut self) {
        let labeled = self.state.session().map(Session::labeled).unwrap_or_default();
        for labeled in &labeled {
            self.send(WorkerCommand::Trainer(TrainerCommand::Learn(labeled.query, labeled.label)));
        }
        self.send(WorkerCommand::Trainer(TrainerCommand::Relearn));
        self.state.reward.is_relearning = labeled.len() >= MIN_LABELS;
    }
}

/// The weights with that of one justification moved.
pub(crate) fn with_justification(weights: &Weights, idx: usize, weight: f32) -> Weights {
    let mut named: Vec<(String, f32)> = weights.justifications.clone().into();
    named[idx].1 = weight;
    let justifications = Justifications::new(named).unwrap_or(weights.justifications.clone());
    Weights { justifications, ..weights.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_of_answers_that_were_taken_back_go() {
        let mut curve = Vec::new();
        for point in [[10.0, 0.6], [20.0, 0.5], [30.0, 0.4], [20.0, 0.55], [25.0, 0.5]] {
            push_by_label(&mut curve, point);
        }
        assert_eq!(curve, [[10.0, 0.6], [20.0, 0.55], [25.0, 0.5]]);
    }

    #[test]
    fn a_weight_is_moved_alone() {
        let all = [("grass", 1.0), ("chuckhole", 0.9), ("car", 0.8), ("default", 0.75)];
        let weights = Weights { justifications: Justifications::new(all).unwrap(), ..Weights::paper() };
        let moved = |idx, weight| -> Vec<f32> {
            let moved = with_justification(&weights, idx, weight);
            moved.justifications.iter().map(|(.., weight)| weight).collect()
        };
        assert_eq!(moved(1, 0.6), [1.0, 0.6, 0.8, 0.75]);
        assert_eq!(moved(2, 1.0), [1.0, 0.9, 1.0, 0.75], "more than what is more severe");
        assert_eq!(moved(3, 1.0), [1.0, 0.9, 0.8, 1.0]);
        assert_eq!(moved(0, 0.4), [1.0, 0.9, 0.8, 0.75], "no weight is below one half");
    }
}
