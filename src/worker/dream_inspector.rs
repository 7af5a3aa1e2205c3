//! Shows kept dreams step by step: what was seen, what reward is predicted, and what the planner would do.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, TryRecvError};

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use crate::dream::{DreamEpisode, Rows};
use crate::planner::{Plan, PlannerConfig, plan};
use crate::query::{DreamId, Query, SEGMENT_LEN, SegmentRef};
use crate::reward::LearnedReward;
use crate::tensor::NotFinite;
use crate::worker::error::TaskError;
use crate::worker::plan_view::in_words;
use crate::worker::reward_eval::RewardEvaluator;
use crate::worker::{
    ClipRewards, DreamInspectorCommand, DreamReport, DreamRewards, LabelReport, Latest, Promise, Reports,
    ReviewView, Worker, WorkerError, WorkerName, one_thread,
};
use crate::world_model::{Placed, WorldModel};

const NAME: WorkerName = WorkerName::DreamInspector;

/// Starts a thread that inspects dreams of `model`, plans as `planner` says, and shows steps in `view`.
pub fn spawn(
    model: impl Into<Placed>,
    planner: PlannerConfig,
    view: Latest<ReviewView>,
    reports: &Reports,
) -> Worker<DreamInspectorCommand> {
    let model = model.into();
    Worker::spawn(NAME, reports, move |commands, reports| inspect(&commands, &reports, model, planner, &view))
}

/// The body of the thread.
pub fn inspect(
    commands: &Receiver<DreamInspectorCommand>,
    reports: &Reports,
    model: impl Into<Placed>,
    planner: PlannerConfig,
    view: &Latest<ReviewView>,
) -> Result<(), WorkerError> {
    one_thread();
    let model = WorldModel::load(model)?;
    let dreams = HashMap::new();
    let mut inspector = DreamInspector {
        model,
        planner,
        reports,
        view,
        dreams,
        now: None,
        before: None,
        evaluated: None,
        last: None,
    };
    let mut waiting = VecDeque::new();
    while let Some(command) = waiting.pop_front().or_else(|| commands.recv().ok()) {
        loop {
            match commands.try_recv() {
                Ok(command) => waiting.push_back(command),
                Err(TryRecvError::Disconnected) => return Ok(()),
                Err(TryRecvError::Empty) => break,
            }
        }
        let is_show = |command: &DreamInspectorCommand| matches!(command, DreamInspectorCommand::Show { .. });
        // Of steps that a hand passes over quickly, only the last is drawn.
        if is_show(&command) && waiting.iter().any(is_show) {
            continue;
        }
        if let Err(e) = inspector.handle(command) {
            reports.fail(NAME, e);
        }
    }
    Ok(())
}

/// A reward, for planning and member by member.
struct Reward {
    evaluator: RewardEvaluator,
    frozen: LearnedReward,
}

/// What the thread owns.
struct DreamInspector<'a> {
    model: WorldModel,
    planner: PlannerConfig,
    reports: &'a Reports,
    view: &'a Latest<ReviewView>,
    dreams: HashMap<DreamId, (Arc<DreamEpisode>, Option<Rows>)>,
    now: Option<Reward>,
    before: Option<LearnedReward>,
    /// The dream that was evaluated last by the present reward.
    evaluated: Option<DreamId>,
    /// What was shown last.
    last: Option<(DreamId, usize)>,
}

impl DreamInspector<'_> {
    fn handle(&mut self, command: DreamInspectorCommand) -> Result<(), WorkerError> {
        match command {
            DreamInspectorCommand::AddDream(id, episode) => {
                self.dreams.insert(id, (episode, None));
            }
            DreamInspectorCommand::Reward(parameters) => {
                let evaluator = RewardEvaluator::load(&parameters, &self.model)?;
                self.now = Some(Reward { frozen: evaluator.frozen(), evaluator });
                self.evaluated = None;
                if let Some((dream, step)) = self.last {
                    self.show(dream, step)?;
                }
            }
            DreamInspectorCommand::Compare => {
                self.before = self.now.as_ref().map(|reward| reward.evaluator.frozen());
            }
            DreamInspectorCommand::Show { dream, step } => self.show(dream, step)?,
            DreamInspectorCommand::Predict(query) => self.predict(query)?,
        }
        Ok(())
    }

    fn show(&mut self, dream: DreamId, step: usize) -> Result<(), WorkerError> {
        self.last = Some((dream, step));
        let (episode, features) = self.dreams.get_mut(&dream).ok_or(TaskError::UnknownDream(dream))?;
        let step = step.min(episode.len().saturating_sub(1));
        let frame = episode.frames(&self.model, step..step + 1).pop().ok_or(TaskError::EmptyDream)?;
        let (mut promises, mut chosen, mut chosen_before) = (Vec::new(), 0, None);
        if let Some(reward) = &self.now {
            let features = features.get_or_insert_with(|| episode.features(&self.model));
            let state = self.model.state_of(features.row(step));
            // The same draw for both, so that returns of the same plans are compared.
            let seed = episode.seed ^ step as u64;
            let imagine = |reward: &LearnedReward| -> Result<Plan, NotFinite> {
                let config = self.planner.clone();
                let config = if reward.is_sparse() { config.for_transitions() } else { config };
                plan(&self.model, reward, &state, &config, None, &mut ChaCha8Rng::seed_from_u64(seed))
            };
            let (now, before) = (imagine(&reward.frozen)?, self.before.as_ref().map(imagine).transpose()?);
            let before_of = |i: usize| before.as_ref().map(|plan| plan.candidates[i].predicted_return);
            let candidates = now.candidates.iter().enumerate();
            promises = candidates
                .map(|(i, candidate)| Promise {
                    actions: in_words(&candidate.actions, &self.model.spec().axes),
                    now: candidate.predicted_return,
                    before: before_of(i),
                })
                .collect();
            (chosen, chosen_before) = (now.chosen, before.map(|plan| plan.chosen));
        }
        self.view.put(ReviewView { dream, step, frame, promises, chosen, chosen_before });
        self.reports.wake();
        self.evaluate(dream);
        Ok(())
    }

    /// Predicts the rewards of both clips of a query, if there is a reward.
    fn predict(&mut self, query: Query) -> Result<(), WorkerError> {
        let Some(reward) = &self.now else { return Ok(()) };
        let mut of = |SegmentRef { dream, start }: SegmentRef| {
            let (episode, features) = self.dreams.get_mut(&dream)?;
            let features = features.get_or_insert_with(|| episode.features(&self.model));
            let rows = features.values.get(start * features.width..(start + SEGMENT_LEN) * features.width)?;
            let actions = &episode.actions[start..start + SEGMENT_LEN];
            let (rewards, members) = reward.evaluator.evaluate_members(rows, actions, self.model.ranges());
            Some(ClipRewards { rewards, members })
        };
        let unknown = || TaskError::UnknownClip(query.id);
        let clips = [of(query.left).ok_or_else(unknown)?, of(query.right).ok_or_else(unknown)?];
        self.reports.send(LabelReport::Predicted { query, clips });
        Ok(())
    }

    /// Evaluates a whole dream, once.
    fn evaluate(&mut self, dream: DreamId) {
        if self.evaluated == Some(dream) {
            return;
        }
        let Some((episode, Some(features))) = self.dreams.get(&dream) else { return };
        let Some(reward) = &self.now else { return };
        let [rewards, low, high] =
            reward.evaluator.evaluate(&features.values, &episode.actions, self.model.ranges());
        self.reports.send(DreamReport::Rewards(DreamRewards { dream, rewards, low, high }));
        self.evaluated = Some(dream);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;
    use crate::reward::{RewardConfig, RewardEnsemble, RewardModel as _, scaled_actions_tensor};
    use crate::tensor::{from_slice, to_vec};
    use crate::worker::{Report, fixtures};
    use crate::world::ActionRanges;

    fn ensemble(seed: u64) -> RewardEnsemble {
        let rng = &mut ChaCha8Rng::seed_from_u64(seed);
        RewardEnsemble::new((36, fixtures::model().hash().as_str()), RewardConfig::tiny(), rng)
    }

    #[test]
    fn a_dream_is_evaluated_step_by_step_and_plans_are_compared() {
        let dream = Arc::new(fixtures::dream(1, 30));
        let (reports, inbox) = Reports::new(|| ());
        let view = Latest::default();
        let model = fixtures::model();
        let planner = PlannerConfig::car_racing();
        let mut inspector = DreamInspector {
            model: fixtures::model(),
            planner: planner.clone(),
            reports: &reports,
            view: &view,
            dreams: HashMap::new(),
            now: None,
            before: None,
            evaluated: None,
            last: None,
        };
        let show = |step| DreamInspectorCommand::Show { dream: DreamId(7), step };
        inspector.handle(DreamInspectorCommand::AddDream(DreamId(7), Arc::clone(&dream))).unwrap();
        inspector.handle(show(12)).unwrap();
        let seen = view.take().unwrap();
        assert!(
            seen.promises.is_empty() && inbox.try_recv().is_err(),
            "without a reward there is only the picture"
        );
        for command in
            [DreamInspectorCommand::Reward(ensemble(0).parameters()), DreamInspectorCommand::Compare]
        {
            inspector.handle(command).unwrap();
        }
        inspector.handle(DreamInspectorCommand::Reward(ensemble(1).parameters())).unwrap();
        let all: Vec<_> = inbox.try_iter().collect();
        let [_, Report::Dream(DreamReport::Rewards(evaluated))] = &all[..] else { panic!("{all:?}") };
        let rows = dream.features(&model);
        let by_hand = ensemble(1).rewards(
            &from_slice(&rows.values, &[30, 36]),
            &scaled_actions_tensor(&dream.actions, &ActionRanges::default()),
        );
        assert_eq!(evaluated.rewards, to_vec(&by_hand));
        let inside =
            |t: usize| evaluated.low[t] <= evaluated.rewards[t] && evaluated.rewards[t] <= evaluated.high[t];
        assert!((0..30).all(inside), "the mean lies between the members");

        let seen = view.take().unwrap();
        assert_eq!((seen.step, seen.promises.len()), (12, 15));
        let state = model.state_of(rows.row(12));
        let imagine = |seed| {
            let rng = &mut ChaCha8Rng::seed_from_u64(dream.seed ^ seen.step as u64);
            plan(&model, &ensemble(seed).for_inference(), &state, &planner, None, rng).unwrap()
        };
        let (now, before) = (imagine(1), imagine(0));
        assert_eq!((seen.chosen, seen.chosen_before), (now.chosen, Some(before.chosen)));
        let returns_of = |promise: &Promise| (promise.now, promise.before);
        let returns = now.candidates.iter().zip(&before.candidates);
        let expected: Vec<_> =
            returns.map(|(now, before)| (now.predicted_return, Some(before.predicted_return))).collect();
        assert_eq!(seen.promises.iter().map(returns_of).collect::<Vec<_>>(), expected);
    }

    #[test]
    fn clips_are_evaluated_by_each_member() {
        let dream = Arc::new(fixtures::dream(1, 60));
        let (reports, inbox) = Reports::new(|| ());
        let (commands, received) = channel();
        let query = fixtures::query(3, (7, 2), (7, 31));
        for command in [
            DreamInspectorCommand::AddDream(DreamId(7), Arc::clone(&dream)),
            DreamInspectorCommand::Predict(query),
            DreamInspectorCommand::Reward(ensemble(0).parameters()),
            DreamInspectorCommand::Predict(query),
        ] {
            commands.send(command).unwrap();
        }
        let parameters = fixtures::model().parameters().clone();
        let inspector = spawn(parameters, PlannerConfig::car_racing(), Latest::default(), &reports);
        for command in received.try_iter() {
            inspector.send(command);
        }
        let Report::Label(LabelReport::Predicted { query: of, clips: [_, right] }) = inbox.recv().unwrap()
        else {
            panic!("another report: without a reward nothing is predicted")
        };
        let rows = dream.features(&fixtures::model());
        let rows = from_slice(&rows.values[31 * 36..51 * 36], &[20, 36]);
        let scaled = scaled_actions_tensor(&dream.actions[31..51], &ActionRanges::default());
        let members = ensemble(0).member_rewards(&rows, &scaled);
        let by_hand: Vec<Vec<f32>> = members.unbind(0).iter().map(to_vec).collect();
        assert_eq!((of, right.members), (query, by_hand));
        assert_eq!(right.rewards, to_vec(&ensemble(0).rewards(&rows, &scaled)));
    }

    #[test]
    fn of_steps_passed_over_quickly_the_last_is_drawn() {
        let (commands, received) = channel();
        commands.send(DreamInspectorCommand::AddDream(DreamId(0), Arc::new(fixtures::dream(1, 30)))).unwrap();
        for step in 0..20 {
            commands.send(DreamInspectorCommand::Show { dream: DreamId(0), step }).unwrap();
        }
        let (reports, _inbox) = Reports::new(|| ());
        let view = Latest::default();
        let inspector = spawn(
            fixtures::model().parameters().clone(),
            PlannerConfig::car_racing(),
            view.clone(),
            &reports,
        );
        for step in 20..25 {
            commands.send(DreamInspectorCommand::Show { dream: DreamId(0), step }).unwrap();
        }
        for command in received.try_iter() {
            inspector.send(command);
        }
        let mut last = None;
        while last != Some(24) {
            last = view.take().map(|view: ReviewView| view.step).or(last);
            std::thread::yield_now();
        }
    }
}
