//! Learns a reward while answers come in, and fits it to the end when asked.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, TryRecvError};
use std::time::{Duration, Instant};

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::dream::{DreamEpisode, Rows};
use crate::query::{DreamId, Label, LabeledQuery, Query, QueryId, SEGMENT_LEN, SegmentRef, Transition};
use crate::reward::{
    EpochReport, Figures, Fitted, RewardConfig, RewardEnsemble, SegmentPair, Trainer, fit_anew, segment_rows,
    transition_row,
};
use crate::tensor::Parameters;
use crate::worker::judge::Judge;
use crate::worker::{Learning, Report, Reports, TrainerCommand, Worker, one_thread};
use crate::world_model::WorldModel;

const NAME: &str = "trainer";
/// From so many answers on, something can be learned from them, and something be said about them.
pub const MIN_LABELS: usize = 10;
/// Once one in so many answers is new, all are learned anew.
const NEW_SHARE: usize = 10;
/// Parameters are handed on no more often than this.
const HAND_ON_EVERY: Duration = Duration::from_secs(1);

/// Starts a thread that learns a reward of the given shape over what `model` dreams.
pub fn spawn(model: Parameters, config: RewardConfig, reports: &Reports) -> Worker<TrainerCommand> {
    Worker::spawn(NAME, reports, move |commands, reports| train(&commands, &reports, model, config))
}

/// The body of the thread.
pub fn train(
    commands: &Receiver<TrainerCommand>,
    reports: &Reports,
    model: Parameters,
    config: RewardConfig,
) -> Result<(), String> {
    one_thread();
    let model = WorldModel::load(model).map_err(|e| e.to_string())?;
    let mut learner = Learner::new(model, config, reports);
    let mut waiting = VecDeque::new();
    loop {
        let next = waiting.pop_front().map_or_else(|| learner.wait(commands), Ok);
        match next {
            Ok(TrainerCommand::Fit { seed }) => learner.fit(seed, commands, &mut waiting),
            Ok(command) => learner.hear(command),
            Err(RecvTimeoutError::Timeout) => learner.go_on(),
            Err(RecvTimeoutError::Disconnected) => return Ok(()),
        }
    }
}

/// What the thread owns.
struct Learner<'a> {
    model: WorldModel,
    config: RewardConfig,
    reports: &'a Reports,
    dreams: Dreams,
    /// All that counts.
    answers: BTreeMap<QueryId, LabeledQuery>,
    trainer: Trainer,
    /// Verdicts on transitions.
    judge: Judge,
    /// The answers of the trainer, in its order.
    order: Vec<QueryId>,
    rng: ChaCha8Rng,
    /// Answers given, changed or taken back since the last fit.
    n_new: usize,
    n_fits: usize,
    /// Whether anything was ever fitted.
    has_learned: bool,
    /// When parameters were last handed on, and whether newer ones wait.
    handed_on: Option<Instant>,
    has_news: bool,
}

/// The dreams that are known, each with the features of its steps once they are needed.
#[derive(Default)]
struct Dreams(HashMap<DreamId, (Arc<DreamEpisode>, Option<Rows>)>);

impl Dreams {
    /// A segment as the reward reads it, `[k, F + A]`.
    fn rows(&mut self, model: &WorldModel, segment: SegmentRef) -> Result<Vec<f32>, String> {
        let SegmentRef { dream: id, start } = segment;
        let known = self.0.get_mut(&id).filter(|(episode, _)| start + SEGMENT_LEN <= episode.len());
        let Some((episode, features)) = known else {
            return Err(format!("cannot learn from step {start} of dream {}: it is not known here", id.0));
        };
        let features = features.get_or_insert_with(|| episode.features(model));
        Ok(segment_rows(features, &episode.actions, segment))
    }

    /// A transition as a classifier reads it, `[F + A]`.
    fn row(&mut self, model: &WorldModel, transition: Transition) -> Result<Vec<f32>, String> {
        let Transition { dream: id, step, .. } = transition;
        let known = self.0.get_mut(&id).filter(|(episode, _)| step < episode.len());
        let Some((episode, features)) = known else {
            return Err(format!("cannot learn from step {step} of dream {}: it is not known here", id.0));
        };
        let features = features.get_or_insert_with(|| episode.features(model));
        Ok(transition_row(features, &episode.actions, step))
    }
}

impl<'a> Learner<'a> {
    fn new(model: WorldModel, config: RewardConfig, reports: &'a Reports) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let ensemble =
            RewardEnsemble::new(model.config().n_features(), &model.hash(), config.clone(), &mut rng);
        Self {
            model,
            config,
            reports,
            dreams: Dreams::default(),
            answers: BTreeMap::new(),
            trainer: Trainer::new(ensemble),
            judge: Judge::default(),
            order: Vec::new(),
            rng,
            n_new: 0,
            n_fits: 0,
            has_learned: false,
            handed_on: None,
            has_news: false,
        }
    }

    /// The next command; a time-out means that there is something to do meanwhile.
    fn wait(&self, commands: &Receiver<TrainerCommand>) -> Result<TrainerCommand, RecvTimeoutError> {
        if self.is_behind() {
            return commands.recv_timeout(Duration::ZERO);
        }
        if self.has_news {
            let since = self.handed_on.map_or(HAND_ON_EVERY, |handed_on| handed_on.elapsed());
            return commands.recv_timeout(HAND_ON_EVERY.saturating_sub(since));
        }
        commands.recv().map_err(|_| RecvTimeoutError::Disconnected)
    }

    fn is_behind(&self) -> bool {
        if self.judge.is_last {
            return self.judge.is_behind();
        }
        let n = self.order.len();
        n >= MIN_LABELS && self.n_new > 0 && self.n_new * NEW_SHARE >= n
    }

    fn hear(&mut self, command: TrainerCommand) {
        match command {
            TrainerCommand::AddDream(id, episode) => {
                self.dreams.0.insert(id, (episode, None));
            }
            TrainerCommand::Learn(query, label) => {
                if let Err(e) = self.learn(query, label) {
                    self.reports.fail(NAME, e);
                }
            }
            TrainerCommand::Judge(judged) => self.judge.hear(judged),
            TrainerCommand::Forget(id) => {
                self.judge.forget(id);
                if self.answers.remove(&id).is_some() {
                    let idx = self.idx(id);
                    self.order.remove(idx);
                    self.trainer.forget(idx);
                    self.n_new += 1;
                }
            }
            TrainerCommand::Weigh(pairs) => {
                let disagreements = self.has_learned.then(|| self.weigh(&pairs)).transpose();
                let disagreements = disagreements.unwrap_or_else(|e| {
                    self.reports.fail(NAME, e);
                    None
                });
                self.reports.send(Report::Weighed { pairs, disagreements });
            }
            TrainerCommand::Relearn => self.n_new = self.order.len(),
            TrainerCommand::Fit { .. } => unreachable!("a fit hears commands itself"),
        }
    }

    fn weigh(&mut self, pairs: &[[SegmentRef; 2]]) -> Result<Vec<f32>, String> {
        let mut rows = |segment| self.dreams.rows(&self.model, segment);
        let pairs = pairs.iter().map(|[left, right]| Ok([rows(*left)?, rows(*right)?]));
        Ok(self.trainer.ensemble().disagreements(&pairs.collect::<Result<Vec<_>, String>>()?))
    }

    fn learn(&mut self, query: Query, label: Label) -> Result<(), String> {
        self.judge.is_last = false;
        match self.answers.get(&query.id) {
            Some(known) if known.label == label => return Ok(()),
            Some(_) => self.trainer.relabel(self.idx(query.id), label),
            None => {
                let mut rows = |segment| self.dreams.rows(&self.model, segment);
                let pair = SegmentPair { left: rows(query.left)?, right: rows(query.right)?, label };
                // Only a reward that has learned the others foretells anything.
                if self.order.len() >= MIN_LABELS && !self.is_behind() {
                    self.trainer.learn(&pair);
                } else {
                    self.trainer.take_up(&pair);
                }
                self.order.push(query.id);
            }
        }
        self.answers.insert(query.id, LabeledQuery { query, label });
        self.n_new += 1;
        Ok(())
    }

    /// Where the trainer has the answer to a query that counts.
    fn idx(&self, id: QueryId) -> usize {
        let idx = self.order.iter().position(|known| *known == id);
        idx.expect("what counts is known to the trainer")
    }

    /// Learns all anew, or hands on what that brought.
    ///
    /// Steps added to an old fit for every answer would soon be more than drive well: see [`RewardConfig::updates`].
    fn go_on(&mut self) {
        if self.judge.is_behind() {
            self.go_on_with_verdicts();
        } else if self.is_behind() {
            let mut losses = Vec::new();
            let _ = self.trainer.fit(&mut self.rng, |report| {
                losses.clone_from(&report.losses);
                ControlFlow::Continue(())
            });
            self.n_new = 0;
            self.n_fits += 1;
            (self.has_learned, self.has_news) = (true, true);
            let figures = self.trainer.recent().filter(|figures| figures.n >= MIN_LABELS);
            let fit = (self.n_fits, None);
            self.reports.send(learning(figures, fit, &losses, self.trainer.n_labels()));
        }
        let is_time = self.handed_on.is_none_or(|handed_on| handed_on.elapsed() >= HAND_ON_EVERY);
        if self.has_news && is_time {
            self.hand_on(None);
        }
    }

    fn go_on_with_verdicts(&mut self) {
        let Self { model, dreams, judge, rng, .. } = self;
        let row = |transition| dreams.row(model, transition);
        let config = Judge::config(false);
        match judge.fit(model, config, rng.random(), row, |_| ControlFlow::Continue(())) {
            Ok(Some(fitted)) => {
                (self.n_fits, self.has_news) = (self.n_fits + 1, true);
                let held_out = fitted.held_out;
                self.reports.send(Report::Learning(Learning {
                    epoch: self.n_fits,
                    losses: fitted.losses,
                    held_out_loss: held_out.map(|held_out| held_out.loss),
                    agreement: held_out.map(|held_out| held_out.accuracy),
                    n_labels: self.judge.len(),
                    fit_epochs: None,
                }));
            }
            Ok(None) => {}
            Err(e) => self.reports.fail(NAME, e),
        }
    }

    fn hand_on(&mut self, fit: Option<(u64, Vec<f32>)>) {
        (self.handed_on, self.has_news) = (Some(Instant::now()), false);
        let (parameters, n_labels) = match &self.judge.parameters {
            Some(parameters) if self.judge.is_last => (parameters.clone(), self.judge.len()),
            _ => (self.trainer.ensemble().parameters(), self.order.len()),
        };
        self.reports.send(Report::Learned { parameters, n_labels, fit });
    }

    /// Fits a fresh ensemble to all answers, the same for the same answers and seed whatever was learned before.
    ///
    /// What is heard meanwhile goes to `waiting`; another fit, or the end of commands, ends this one.
    fn fit(
        &mut self,
        seed: u64,
        commands: &Receiver<TrainerCommand>,
        waiting: &mut VecDeque<TrainerCommand>,
    ) {
        let n_labels = if self.judge.is_last { self.judge.len() } else { self.answers.len() };
        if n_labels == 0 {
            return self.reports.fail(NAME, "there are no answers to learn from yet");
        }
        let Self { model, config, reports, dreams, answers, trainer, judge, .. } = self;
        let labels: Vec<_> = answers.values().copied().collect();
        let judge_is_last = judge.is_last;
        let on_epoch = |report: &EpochReport| {
            let is_sparse = judge_is_last;
            let figures = trainer.recent().filter(|figures| figures.n >= MIN_LABELS && !is_sparse);
            let fit = (report.epoch, Some(report.n_epochs));
            reports.send(learning(figures, fit, &report.losses, n_labels));
            loop {
                match commands.try_recv() {
                    Ok(command) => waiting.push_back(command),
                    Err(TryRecvError::Disconnected) => return ControlFlow::Break(()),
                    Err(TryRecvError::Empty) => break,
                }
            }
            let is_overtaken = waiting.iter().any(|command| matches!(command, TrainerCommand::Fit { .. }));
            if is_overtaken { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        if judge_is_last {
            let row = |transition| dreams.row(model, transition);
            match judge.fit(model, Judge::config(true), seed, row, on_epoch) {
                Ok(Some(fitted)) => {
                    self.n_fits = 0;
                    self.hand_on(Some((seed, fitted.losses)));
                }
                Ok(None) => {}
                Err(e) => reports.fail(NAME, e),
            }
            return;
        }
        let rows = |segment| dreams.rows(model, segment);
        match fit_anew(model, config.clone(), seed, &labels, rows, on_epoch) {
            Ok(Some(Fitted { trainer, losses })) => {
                self.trainer.adopt(trainer);
                (self.n_new, self.n_fits, self.has_learned) = (0, 0, true);
                self.hand_on(Some((seed, losses)));
            }
            Ok(None) => {}
            Err(e) => self.reports.fail(NAME, e),
        }
    }
}

/// How far learning is, and how well the latest answers were foretold.
fn learning(
    figures: Option<Figures>,
    (epoch, fit_epochs): (usize, Option<usize>),
    losses: &[f64],
    n_labels: usize,
) -> Report {
    Report::Learning(Learning {
        epoch,
        losses: losses.iter().map(|loss| *loss as f32).collect(),
        held_out_loss: figures.map(|figures| figures.log_loss as f32),
        agreement: figures.and_then(|figures| figures.agreement).map(|agreement| agreement as f32),
        n_labels,
        fit_epochs,
    })
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;
    use crate::query::{JudgedTransition, Response, SafetyAnswer, Verdict, Weights};
    use crate::reward::SparseReward;
    use crate::tensor::to_vec;
    use crate::worker::toy;

    fn answer(id: u32, answer: SafetyAnswer) -> TrainerCommand {
        let label = Weights::car_racing().label(&Response::Safety(answer)).unwrap();
        TrainerCommand::Learn(toy::query(id, (0, id as usize % 40), (1, id as usize * 7 % 40)), label)
    }

    fn answers(ids: impl IntoIterator<Item = u32>) -> Vec<TrainerCommand> {
        let side =
            |id: u32| if id.is_multiple_of(3) { SafetyAnswer::OnlyLeft } else { SafetyAnswer::OnlyRight };
        ids.into_iter().map(|id| answer(id, side(id))).collect()
    }

    /// What comes of `commands`, given two dreams.
    fn reports_of(commands: impl IntoIterator<Item = TrainerCommand>) -> Vec<Report> {
        let (sender, heard) = channel();
        for id in 0..2 {
            let dream = Arc::new(toy::dream(id, 60));
            sender.send(TrainerCommand::AddDream(DreamId(id as u32), dream)).unwrap();
        }
        commands.into_iter().for_each(|command| sender.send(command).unwrap());
        let (reports, inbox) = Reports::new(|| ());
        let model = toy::model().parameters().clone();
        drop(sender);
        train(&heard, &reports, model, RewardConfig::tiny()).unwrap();
        drop(reports);
        inbox.into_iter().collect()
    }

    /// The parameters after a full fit with seed 4, which nothing interrupts, after `commands`.
    fn fitted(commands: Vec<TrainerCommand>) -> (Parameters, usize) {
        let (reports, inbox) = Reports::new(|| ());
        let trainer = spawn(toy::model().parameters().clone(), RewardConfig::tiny(), &reports);
        for id in 0..2 {
            trainer.send(TrainerCommand::AddDream(DreamId(id as u32), Arc::new(toy::dream(id, 60))));
        }
        for command in commands {
            trainer.send(command);
        }
        trainer.send(TrainerCommand::Fit { seed: 4 });
        let ended = inbox.iter().find_map(|report| match report {
            Report::Learned { parameters, n_labels, fit: Some((4, _)) } => Some((parameters, n_labels)),
            Report::Failed { message, .. } => panic!("{message}"),
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
    fn enough_answers_teach_the_reward_and_hand_it_on() {
        let (reports, inbox) = Reports::new(|| ());
        let trainer = spawn(toy::model().parameters().clone(), RewardConfig::tiny(), &reports);
        for id in 0..2 {
            trainer.send(TrainerCommand::AddDream(DreamId(id as u32), Arc::new(toy::dream(id, 60))));
        }
        for command in answers(0..MIN_LABELS as u32) {
            trainer.send(command);
        }
        let first = inbox.recv().unwrap();
        let Report::Learning(Learning { epoch: 1, n_labels, fit_epochs: None, losses, .. }) = first else {
            panic!("{first:?}")
        };
        assert_eq!((n_labels, losses.len()), (MIN_LABELS, 2));
        let handed_on = inbox.iter().find_map(|report| match report {
            Report::Learned { parameters, fit: None, .. } => Some(parameters),
            _ => None,
        });
        let ensemble = RewardEnsemble::load(&handed_on.unwrap()).unwrap();
        assert!(ensemble.require(&toy::model().hash()).is_ok(), "it names the model it was learned in");
    }

    #[test]
    fn pairs_are_weighed_once_something_was_learned() {
        let segment = |dream, start| SegmentRef { dream: DreamId(dream), start };
        let pairs = vec![[segment(0, 3), segment(1, 9)], [segment(1, 5), segment(1, 5)]];
        let (reports, inbox) = Reports::new(|| ());
        let trainer = spawn(toy::model().parameters().clone(), RewardConfig::tiny(), &reports);
        let weigh = |pairs: &[[SegmentRef; 2]]| {
            trainer.send(TrainerCommand::Weigh(pairs.to_vec()));
            let weighed = inbox.iter().find_map(|report| match report {
                Report::Weighed { disagreements, .. } => Some(disagreements),
                _ => None,
            });
            weighed.unwrap()
        };
        for id in 0..2 {
            trainer.send(TrainerCommand::AddDream(DreamId(id as u32), Arc::new(toy::dream(id, 60))));
        }
        assert_eq!(weigh(&pairs), None);
        for command in answers(0..12) {
            trainer.send(command);
        }
        trainer.send(TrainerCommand::Fit { seed: 4 });
        inbox.iter().find(|report| matches!(report, Report::Learned { fit: Some(_), .. })).unwrap();
        let found = weigh(&pairs).unwrap();
        assert!(found[0] > 0.0 && found[1] == 0.0, "{found:?}");
        assert_eq!(
            weigh(&[[segment(0, 41), segment(0, 0)]]),
            None,
            "what is beyond a dream cannot be weighed"
        );
    }

    #[test]
    fn too_few_answers_are_only_taken_up() {
        assert!(reports_of(answers(0..MIN_LABELS as u32 - 1)).is_empty());
    }

    #[test]
    fn what_cannot_be_learned_is_said_in_a_sentence() {
        let label = Weights::car_racing().label(&Response::Safety(SafetyAnswer::Neither)).unwrap();
        let unknown = TrainerCommand::Learn(toy::query(0, (0, 41), (9, 0)), label);
        let reports = reports_of([unknown, TrainerCommand::Fit { seed: 0 }]);
        let [Report::Failed { message: one, .. }, Report::Failed { message: other, .. }] = &reports[..]
        else {
            panic!("{reports:?}")
        };
        assert!(one.contains("step 41 of dream 0") && other.contains("no answers"), "{one}; {other}");
    }

    #[test]
    fn answers_that_weigh_differently_are_learned_anew_at_once() {
        let (reports, _inbox) = Reports::new(|| ());
        let mut learner = Learner::new(toy::model(), RewardConfig::tiny(), &reports);
        for id in 0..2 {
            learner.hear(TrainerCommand::AddDream(DreamId(id as u32), Arc::new(toy::dream(id, 60))));
        }
        for command in answers(0..40) {
            learner.hear(command);
        }
        learner.go_on();
        let weights = Weights { safety: 0.9, ..Weights::car_racing() };
        let label = weights.label(&Response::Safety(SafetyAnswer::OnlyLeft)).unwrap();
        learner.hear(TrainerCommand::Learn(toy::query(0, (0, 0), (1, 0)), label));
        assert!(!learner.is_behind(), "one answer in forty can wait");
        learner.hear(TrainerCommand::Relearn);
        assert!(learner.is_behind(), "but other weights cannot");
    }

    #[test]
    fn a_changed_answer_is_not_foretold_again() {
        let (reports, _inbox) = Reports::new(|| ());
        let mut learner = Learner::new(toy::model(), RewardConfig::tiny(), &reports);
        for id in 0..2 {
            learner.hear(TrainerCommand::AddDream(DreamId(id as u32), Arc::new(toy::dream(id, 60))));
        }
        for command in answers(0..20) {
            learner.hear(command);
        }
        assert_eq!(learner.trainer.overall(), None, "a reward that has learned nothing foretells nothing");
        while learner.is_behind() {
            learner.go_on();
        }
        for command in answers(20..22) {
            learner.hear(command);
        }
        let n_foretold = |learner: &Learner<'_>| learner.trainer.overall().map(|f| (f.n, f.n_strict));
        assert_eq!(n_foretold(&learner), Some((2, 2)));
        learner.hear(answer(20, SafetyAnswer::Neither));
        assert_eq!(n_foretold(&learner), Some((2, 1)));
        learner.hear(TrainerCommand::Forget(QueryId(20)));
        assert_eq!(n_foretold(&learner), Some((1, 1)));
        assert_eq!((learner.order.len(), learner.trainer.n_labels()), (21, 21));
    }

    #[test]
    fn verdicts_are_learned_while_they_come_in_and_what_came_last_counts() {
        one_thread();
        let (reports, inbox) = Reports::new(|| ());
        let mut learner = Learner::new(toy::model(), RewardConfig::tiny(), &reports);
        for id in 0..2 {
            learner.hear(TrainerCommand::AddDream(DreamId(id as u32), Arc::new(toy::dream(id, 60))));
        }
        for i in 0..50 {
            let transition = Transition { dream: DreamId(0), first: 0, step: i };
            let verdict = Verdict::ALL[usize::from(toy::dream(0, 60).actions[i].steer > 0.0)];
            let query = QueryId(i as u32);
            learner.hear(TrainerCommand::Judge(JudgedTransition { query, transition, verdict }));
        }
        assert!(learner.is_behind(), "a trajectory is enough to begin with");
        learner.go_on();
        let reports: Vec<_> = inbox.try_iter().collect();
        let [Report::Learning(learning), Report::Learned { parameters, n_labels: 50, fit: None }] =
            &reports[..]
        else {
            panic!("{reports:?}")
        };
        assert!(
            SparseReward::is_in(parameters) && learning.held_out_loss.is_some(),
            "a classifier: {learning:?}"
        );
        learner.hear(TrainerCommand::Forget(QueryId(3)));
        assert!(!learner.is_behind(), "one in fifty is not worth it");
        for command in answers(100..110) {
            learner.hear(command);
        }
        while learner.is_behind() {
            learner.go_on();
        }
        learner.hand_on(None);
        let last = inbox.try_iter().last();
        let Some(Report::Learned { parameters, n_labels: 10, .. }) = last else { panic!("{last:?}") };
        assert!(!SparseReward::is_in(&parameters), "preferences came last");
    }
}
