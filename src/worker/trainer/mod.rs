//! Learns a reward while answers come in, and fits it to the end when asked.

mod dreams;
mod sparse;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, VecDeque};
use std::ops::ControlFlow;
use std::sync::mpsc::{Receiver, RecvTimeoutError, TryRecvError};
use std::time::{Duration, Instant};

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use crate::query::{Label, LabeledQuery, Query, QueryId, SegmentRef};
use crate::reward::RewardInputs;
use crate::reward::{
    EpochReport, Fitted, PredictionMetrics, RewardConfig, RewardEnsemble, SegmentPair, Trainer, fit_anew,
};
use crate::worker::error::TaskError;
use crate::worker::{
    LabelReport, Learning, Reports, RewardReport, TrainerCommand, Worker, WorkerError, WorkerName, one_thread,
};
use crate::world_model::{Placed, WorldModel};

use dreams::Dreams;
use sparse::Verdicts;

const NAME: WorkerName = WorkerName::Trainer;
/// From so many answers on, something can be learned from them, and something be said about them.
pub const MIN_LABELS: usize = 10;
/// Once one in so many answers is new, all are learned anew.
const NEW_SHARE: usize = 10;
/// Parameters are handed on no more often than this.
const HAND_ON_EVERY: Duration = Duration::from_secs(1);

/// Starts a thread that learns a reward of the given shape over what `model` dreams.
pub fn spawn(model: impl Into<Placed>, config: RewardConfig, reports: &Reports) -> Worker<TrainerCommand> {
    let model = model.into();
    Worker::spawn(NAME, reports, move |commands, reports| train(&commands, &reports, model, config))
}

/// The body of the thread.
pub fn train(
    commands: &Receiver<TrainerCommand>,
    reports: &Reports,
    model: impl Into<Placed>,
    config: RewardConfig,
) -> Result<(), WorkerError> {
    one_thread();
    let model = WorldModel::load(model)?;
    let mut learner = Learner::new(model, config, reports);
    let mut waiting = VecDeque::new();
    loop {
        let next = waiting.pop_front().map_or_else(|| learner.wait(commands), Ok);
        match next {
            Ok(TrainerCommand::Fit { seed }) => learner.fit(seed, commands, &mut waiting),
            Ok(command) => learner.handle(command),
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
    verdicts: Verdicts,
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

impl<'a> Learner<'a> {
    fn new(model: WorldModel, config: RewardConfig, reports: &'a Reports) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let ensemble =
            RewardEnsemble::new(RewardInputs::of(&model), config.clone(), &mut rng).on(model.backend());
        Self {
            model,
            config,
            reports,
            dreams: Dreams::default(),
            answers: BTreeMap::new(),
            trainer: Trainer::new(ensemble),
            verdicts: Verdicts::default(),
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
        if self.verdicts.is_last {
            return self.verdicts.is_behind();
        }
        let n = self.order.len();
        n >= MIN_LABELS && self.n_new > 0 && self.n_new * NEW_SHARE >= n
    }

    fn handle(&mut self, command: TrainerCommand) {
        match command {
            TrainerCommand::AddDream(id, episode) => {
                self.dreams.add(id, episode);
            }
            TrainerCommand::Learn(query, label) => {
                if let Err(e) = self.learn(query, label) {
                    self.reports.fail(NAME, e);
                }
            }
            TrainerCommand::LearnVerdict(judged) => self.verdicts.receive(judged),
            TrainerCommand::Forget(id) => {
                self.verdicts.forget(id);
                if self.answers.remove(&id).is_some() {
                    let idx = self.idx(id);
                    self.order.remove(idx);
                    self.trainer.remove(idx);
                    self.n_new += 1;
                }
            }
            TrainerCommand::MeasureDisagreement(pairs) => {
                let disagreements = self.has_learned.then(|| self.disagreements(&pairs)).transpose();
                let disagreements = disagreements.unwrap_or_else(|e| {
                    self.reports.fail(NAME, e);
                    None
                });
                self.reports.send(LabelReport::Disagreements { pairs, disagreements });
            }
            TrainerCommand::Relearn => self.n_new = self.order.len(),
            TrainerCommand::Fit { .. } => unreachable!("a fit receives commands itself"),
        }
    }

    fn disagreements(&mut self, pairs: &[[SegmentRef; 2]]) -> Result<Vec<f32>, TaskError> {
        let mut rows = |segment| self.dreams.rows(&self.model, segment);
        let pairs = pairs.iter().map(|[left, right]| Ok([rows(*left)?, rows(*right)?]));
        Ok(self.trainer.ensemble().disagreements(&pairs.collect::<Result<Vec<_>, TaskError>>()?))
    }

    fn learn(&mut self, query: Query, label: Label) -> Result<(), TaskError> {
        self.verdicts.is_last = false;
        match self.answers.get(&query.id) {
            Some(known) if known.label == label => return Ok(()),
            Some(_) => self.trainer.relabel(self.idx(query.id), label),
            None => {
                let mut rows = |segment| self.dreams.rows(&self.model, segment);
                let pair = SegmentPair { left: rows(query.left)?, right: rows(query.right)?, label };
                // Only a reward that has learned the others predicts anything.
                if self.order.len() >= MIN_LABELS && !self.is_behind() {
                    self.trainer.predict_and_add(&pair);
                } else {
                    self.trainer.add(&pair);
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
        if self.verdicts.is_behind() {
            self.go_on_with_verdicts();
        } else if self.is_behind() {
            let mut losses = Vec::new();
            let fitted = self.trainer.fit(&mut self.rng, |report| {
                losses.clone_from(&report.losses);
                ControlFlow::Continue(())
            });
            // Where it fails it is not tried again before something changes.
            self.n_new = 0;
            if let Err(e) = fitted {
                (self.has_learned, self.has_news) = (false, false);
                return self.reports.fail(NAME, e);
            }
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

    fn hand_on(&mut self, fit: Option<(u64, Vec<f32>)>) {
        (self.handed_on, self.has_news) = (Some(Instant::now()), false);
        let (parameters, n_labels) = match &self.verdicts.parameters {
            Some(parameters) if self.verdicts.is_last => (parameters.clone(), self.verdicts.len()),
            _ => (self.trainer.ensemble().parameters(), self.order.len()),
        };
        self.reports.send(RewardReport::Learned { parameters, n_labels, fit });
    }

    /// Fits a fresh ensemble to all answers, the same for the same answers and seed whatever was learned before.
    ///
    /// What is received meanwhile goes to `waiting`; another fit, or the end of commands, ends this one.
    fn fit(
        &mut self,
        seed: u64,
        commands: &Receiver<TrainerCommand>,
        waiting: &mut VecDeque<TrainerCommand>,
    ) {
        let n_labels = if self.verdicts.is_last { self.verdicts.len() } else { self.answers.len() };
        if n_labels == 0 {
            return self.reports.fail(NAME, TaskError::NoAnswers);
        }
        let Self { model, config, reports, dreams, answers, trainer, verdicts, .. } = self;
        let labels: Vec<_> = answers.values().copied().collect();
        let is_sparse = verdicts.is_last;
        let on_epoch = |report: &EpochReport| {
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
        if is_sparse {
            let row = |transition| Ok(dreams.row(model, transition)?);
            match verdicts.fit(model, Verdicts::config(true), seed, row, on_epoch) {
                Ok(Some(fitted)) => {
                    self.n_fits = 0;
                    self.hand_on(Some((seed, fitted.losses)));
                }
                Ok(None) => {}
                Err(e) => reports.fail(NAME, e),
            }
            return;
        }
        let rows = |segment| Ok::<_, WorkerError>(dreams.rows(model, segment)?);
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

/// How far learning is, and how well the latest answers were predicted.
fn learning(
    figures: Option<PredictionMetrics>,
    (epoch, fit_epochs): (usize, Option<usize>),
    losses: &[f64],
    n_labels: usize,
) -> RewardReport {
    RewardReport::Learning(Learning {
        epoch,
        losses: losses.iter().map(|loss| *loss as f32).collect(),
        held_out_loss: figures.map(|figures| figures.log_loss as f32),
        agreement: figures.and_then(|figures| figures.agreement).map(|agreement| agreement as f32),
        n_labels,
        fit_epochs,
    })
}
