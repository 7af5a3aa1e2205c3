//! What the trainer makes of answers.

use std::sync::Arc;
use std::sync::mpsc::channel;

use super::*;
use crate::query::{DreamId, Response, SafetyAnswer, Weights};
use crate::tensor::Parameters;
use crate::tensor::to_vec;
use crate::worker::{Report, fixtures};

fn answer(id: u32, answer: SafetyAnswer) -> TrainerCommand {
    let label = Weights::paper().label(&Response::Safety(answer)).unwrap();
    TrainerCommand::Learn(fixtures::query(id, (0, id as usize % 40), (1, id as usize * 7 % 40)), label)
}

pub(super) fn answers(ids: impl IntoIterator<Item = u32>) -> Vec<TrainerCommand> {
    let side = |id: u32| if id.is_multiple_of(3) { SafetyAnswer::OnlyLeft } else { SafetyAnswer::OnlyRight };
    ids.into_iter().map(|id| answer(id, side(id))).collect()
}

/// What comes of `commands`, given two dreams.
fn reports_of(commands: impl IntoIterator<Item = TrainerCommand>) -> Vec<Report> {
    let (sender, received) = channel();
    for id in 0..2 {
        let dream = Arc::new(fixtures::dream(id, 60));
        sender.send(TrainerCommand::AddDream(DreamId(id as u32), dream)).unwrap();
    }
    commands.into_iter().for_each(|command| sender.send(command).unwrap());
    let (reports, inbox) = Reports::new(|| ());
    let model = fixtures::model().parameters().clone();
    drop(sender);
    train(&received, &reports, model, RewardConfig::tiny()).unwrap();
    drop(reports);
    inbox.iter().collect()
}

/// The parameters after a full fit with seed 4, which nothing interrupts, after `commands`.
fn fitted(commands: Vec<TrainerCommand>) -> (Parameters, usize) {
    let (reports, inbox) = Reports::new(|| ());
    let trainer = spawn(fixtures::model().parameters().clone(), RewardConfig::tiny(), &reports);
    for id in 0..2 {
        trainer.send(TrainerCommand::AddDream(DreamId(id as u32), Arc::new(fixtures::dream(id, 60))));
    }
    for command in commands {
        trainer.send(command);
    }
    trainer.send(TrainerCommand::Fit { seed: 4 });
    let ended = inbox.iter().find_map(|report| match report {
        Report::Reward(RewardReport::Learned { parameters, n_labels, fit: Some((4, _)) }) => {
            Some((parameters, n_labels))
        }
        Report::Failed(failure) => panic!("{failure:?}"),
        _ => None,
    });
    ended.unwrap()
}

#[test]
fn the_same_answers_and_seed_fit_the_same_reward_however_they_came_about() {
    let (plain, n) = fitted(answers(0..12));
    let mut detour = answers((0..14).rev());
    detour.insert(5, answer(3, SafetyAnswer::Neither));
    detour.extend([12, 13].map(|id| TrainerCommand::Forget(QueryId(id))));
    let (other, n_other) = fitted(detour);
    assert_eq!((n, n_other), (12, 12));
    for name in ["reward.0.weight", "reward.2.bias"] {
        let [one, other] = [&plain, &other].map(|parameters| to_vec(&parameters.tensor(name).unwrap()));
        assert!(one == other, "the fits differ in {name}");
    }
}

#[test]
fn from_enough_answers_a_reward_is_learned_and_handed_on() {
    let (reports, inbox) = Reports::new(|| ());
    let trainer = spawn(fixtures::model().parameters().clone(), RewardConfig::tiny(), &reports);
    for id in 0..2 {
        trainer.send(TrainerCommand::AddDream(DreamId(id as u32), Arc::new(fixtures::dream(id, 60))));
    }
    for command in answers(0..MIN_LABELS as u32) {
        trainer.send(command);
    }
    let first = inbox.recv().unwrap();
    let Report::Reward(RewardReport::Learning(learning)) = first else { panic!("{first:?}") };
    let Learning { epoch: 1, n_labels, fit_epochs: None, losses, .. } = learning else {
        panic!("{learning:?}")
    };
    assert_eq!((n_labels, losses.len()), (MIN_LABELS, 2));
    let handed_on = inbox.iter().find_map(|report| match report {
        Report::Reward(RewardReport::Learned { parameters, fit: None, .. }) => Some(parameters),
        _ => None,
    });
    let ensemble = RewardEnsemble::load(&handed_on.unwrap()).unwrap();
    assert!(ensemble.require(fixtures::model().identity()).is_ok(), "it names the model it was learned in");
}

#[test]
fn disagreement_is_measured_once_something_was_learned() {
    let segment = |dream, start| SegmentRef { dream: DreamId(dream), start };
    let pairs = vec![[segment(0, 3), segment(1, 9)], [segment(1, 5), segment(1, 5)]];
    let (reports, inbox) = Reports::new(|| ());
    let trainer = spawn(fixtures::model().parameters().clone(), RewardConfig::tiny(), &reports);
    let measure = |pairs: &[[SegmentRef; 2]]| {
        trainer.send(TrainerCommand::MeasureDisagreement(pairs.to_vec()));
        let measured = inbox.iter().find_map(|report| match report {
            Report::Label(LabelReport::Disagreements { disagreements, .. }) => Some(disagreements),
            _ => None,
        });
        measured.unwrap()
    };
    for id in 0..2 {
        trainer.send(TrainerCommand::AddDream(DreamId(id as u32), Arc::new(fixtures::dream(id, 60))));
    }
    assert_eq!(measure(&pairs), None);
    for command in answers(0..12) {
        trainer.send(command);
    }
    trainer.send(TrainerCommand::Fit { seed: 4 });
    inbox
        .iter()
        .find(|report| matches!(report, Report::Reward(RewardReport::Learned { fit: Some(_), .. })))
        .unwrap();
    let found = measure(&pairs).unwrap();
    assert!(found[0] > 0.0 && found[1] == 0.0, "{found:?}");
    assert_eq!(
        measure(&[[segment(0, 41), segment(0, 0)]]),
        None,
        "what is beyond a dream cannot be measured"
    );
}

#[test]
fn too_few_answers_are_only_taken_up() {
    assert!(reports_of(answers(0..MIN_LABELS as u32 - 1)).is_empty());
}

#[test]
fn what_cannot_be_learned_is_said_in_a_sentence() {
    let label = Weights::paper().label(&Response::Safety(SafetyAnswer::Neither)).unwrap();
    let unknown = TrainerCommand::Learn(fixtures::query(0, (0, 41), (9, 0)), label);
    let reports = reports_of([unknown, TrainerCommand::Fit { seed: 0 }]);
    let [Report::Failed(one), Report::Failed(other)] = &reports[..] else { panic!("{reports:?}") };
    let [one, other] = [one, other].map(|failure| failure.error.to_string());
    assert!(one.contains("step 41 of dream 0") && other.contains("no answers"), "{one}; {other}");
}

#[test]
fn answers_that_weigh_differently_are_learned_anew_at_once() {
    let (reports, _inbox) = Reports::new(|| ());
    let mut learner = Learner::new(fixtures::model(), RewardConfig::tiny(), &reports);
    for id in 0..2 {
        learner.handle(TrainerCommand::AddDream(DreamId(id as u32), Arc::new(fixtures::dream(id, 60))));
    }
    for command in answers(0..40) {
        learner.handle(command);
    }
    learner.go_on();
    let weights = Weights { safety: 0.9, ..Weights::paper() };
    let label = weights.label(&Response::Safety(SafetyAnswer::OnlyLeft)).unwrap();
    learner.handle(TrainerCommand::Learn(fixtures::query(0, (0, 0), (1, 0)), label));
    assert!(!learner.is_behind(), "one answer in forty can wait");
    learner.handle(TrainerCommand::Relearn);
    assert!(learner.is_behind(), "but other weights cannot");
}

#[test]
fn a_changed_answer_is_not_predicted_again() {
    let (reports, _inbox) = Reports::new(|| ());
    let mut learner = Learner::new(fixtures::model(), RewardConfig::tiny(), &reports);
    for id in 0..2 {
        learner.handle(TrainerCommand::AddDream(DreamId(id as u32), Arc::new(fixtures::dream(id, 60))));
    }
    for command in answers(0..20) {
        learner.handle(command);
    }
    assert_eq!(learner.trainer.overall(), None, "a reward that has learned nothing predicts nothing");
    while learner.is_behind() {
        learner.go_on();
    }
    for command in answers(20..22) {
        learner.handle(command);
    }
    let n_predicted = |learner: &Learner<'_>| learner.trainer.overall().map(|f| (f.n, f.n_strict));
    assert_eq!(n_predicted(&learner), Some((2, 2)));
    learner.handle(answer(20, SafetyAnswer::Neither));
    assert_eq!(n_predicted(&learner), Some((2, 1)));
    learner.handle(TrainerCommand::Forget(QueryId(20)));
    assert_eq!(n_predicted(&learner), Some((1, 1)));
    assert_eq!((learner.order.len(), learner.trainer.n_labels()), (21, 21));
}
