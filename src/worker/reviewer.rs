//! Looks at kept dreams again: what was seen, what the reward says of it, and what the planner would do.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, TryRecvError};

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use crate::dream::{DreamEpisode, Rows};
use crate::planner::{Plan, PlannerConfig, plan};
use crate::query::{DreamId, Query, SEGMENT_LEN, SegmentRef};
use crate::reward::LearnedReward;
use crate::tensor::{NotFinite, Parameters};
use crate::worker::appraisal::Jury;
use crate::worker::gallery::in_words;
use crate::worker::{
    ClipRewards, Judgement, Latest, Promise, Report, Reports, ReviewView, ReviewerCommand, Worker, one_thread,
};
use crate::world_model::WorldModel;

const NAME: &str = "reviewer";

/// Starts a thread that looks at dreams of `model`, plans as `planner` says, and shows steps in `view`.
pub fn spawn(
    model: Parameters,
    planner: PlannerConfig,
    view: Latest<ReviewView>,
    reports: &Reports,
) -> Worker<ReviewerCommand> {
    Worker::spawn(NAME, reports, move |commands, reports| review(&commands, &reports, model, planner, &view))
}

/// The body of the thread.
pub fn review(
    commands: &Receiver<ReviewerCommand>,
    reports: &Reports,
    model: Parameters,
    planner: PlannerConfig,
    view: &Latest<ReviewView>,
) -> Result<(), String> {
    one_thread();
    let model = WorldModel::load(model).map_err(|e| e.to_string())?;
    let dreams = HashMap::new();
    let mut reviewer =
        Reviewer { model, planner, reports, view, dreams, now: None, before: None, judged: None, last: None };
    let mut waiting = VecDeque::new();
    while let Some(command) = waiting.pop_front().or_else(|| commands.recv().ok()) {
        loop {
            match commands.try_recv() {
                Ok(command) => waiting.push_back(command),
                Err(TryRecvError::Disconnected) => return Ok(()),
                Err(TryRecvError::Empty) => break,
            }
        }
        let is_look = |command: &ReviewerCommand| matches!(command, ReviewerCommand::Look { .. });
        // Of steps that a hand passes over quickly, only the last is drawn.
        if is_look(&command) && waiting.iter().any(is_look) {
            continue;
        }
        if let Err(e) = reviewer.hear(command) {
            reports.fail(NAME, e);
        }
    }
    Ok(())
}

/// A reward, for all and for each.
struct Judge {
    jury: Jury,
    frozen: LearnedReward,
}

/// What the thread owns.
struct Reviewer<'a> {
    model: WorldModel,
    planner: PlannerConfig,
    reports: &'a Reports,
    view: &'a Latest<ReviewView>,
    dreams: HashMap<DreamId, (Arc<DreamEpisode>, Option<Rows>)>,
    now: Option<Judge>,
    before: Option<LearnedReward>,
    /// The dream that the present reward has judged last.
    judged: Option<DreamId>,
    /// What was looked at last.
    last: Option<(DreamId, usize)>,
}

impl Reviewer<'_> {
    fn hear(&mut self, command: ReviewerCommand) -> Result<(), String> {
        match command {
            ReviewerCommand::AddDream(id, episode) => {
                self.dreams.insert(id, (episode, None));
            }
            ReviewerCommand::Reward(parameters) => {
                let jury = Jury::load(&parameters, self.model.identity()).map_err(|e| e.to_string())?;
                self.now = Some(Judge { frozen: jury.frozen(), jury });
                self.judged = None;
                if let Some((dream, step)) = self.last {
                    self.look(dream, step)?;
                }
            }
            ReviewerCommand::Compare => {
                self.before = self.now.as_ref().map(|judge| judge.jury.frozen());
            }
            ReviewerCommand::Look { dream, step } => self.look(dream, step)?,
            ReviewerCommand::Foretell(query) => self.foretell(query)?,
        }
        Ok(())
    }

    fn look(&mut self, dream: DreamId, step: usize) -> Result<(), String> {
        self.last = Some((dream, step));
        let unknown = || format!("dream {} is not known here: its file could not be read", dream.0 + 1);
        let (episode, features) = self.dreams.get_mut(&dream).ok_or_else(unknown)?;
        let step = step.min(episode.len().saturating_sub(1));
        let frame = episode.frames(&self.model, step..step + 1).pop().ok_or("the dream has no steps")?;
        let (mut promises, mut chosen, mut chosen_before) = (Vec::new(), 0, None);
        if let Some(judge) = &self.now {
            let features = features.get_or_insert_with(|| episode.features(&self.model));
            let state = self.model.state_of(features.row(step));
            // The same draw for both, so that they promise something of the same plans.
            let seed = episode.seed ^ step as u64;
            let imagine = |reward: &LearnedReward| -> Result<Plan, NotFinite> {
                let config = self.planner.clone();
                let config = if reward.is_sparse() { config.for_transitions() } else { config };
                plan(&self.model, reward, &state, &config, &mut ChaCha8Rng::seed_from_u64(seed))
            };
            let (now, before) = (imagine(&judge.frozen)?, self.before.as_ref().map(imagine).transpose()?);
            let before_of = |i: usize| before.as_ref().map(|plan| plan.candidates[i].predicted_return);
            let candidates = now.candidates.iter().enumerate();
            promises = candidates
                .map(|(i, candidate)| Promise {
                    actions: in_words(&candidate.actions),
                    now: candidate.predicted_return,
                    before: before_of(i),
                })
                .collect();
            (chosen, chosen_before) = (now.chosen, before.map(|plan| plan.chosen));
        }
        self.view.put(ReviewView { dream, step, frame, promises, chosen, chosen_before });
        self.reports.wake();
        self.judge(dream);
        Ok(())
    }

    /// Says what each member thinks of both clips of a query, if there is a reward.
    fn foretell(&mut self, query: Query) -> Result<(), String> {
        let Some(judge) = &self.now else { return Ok(()) };
        let mut of = |SegmentRef { dream, start }: SegmentRef| {
            let (episode, features) = self.dreams.get_mut(&dream)?;
            let features = features.get_or_insert_with(|| episode.features(&self.model));
            let rows = features.values.get(start * features.width..(start + SEGMENT_LEN) * features.width)?;
            let (rewards, members) = judge.jury.hear(rows, &episode.actions[start..start + SEGMENT_LEN]);
            Some(ClipRewards { rewards, members })
        };
        let unknown = || format!("a clip of query {} is of a dream that is not known here", query.id.0 + 1);
        let clips = [of(query.left).ok_or_else(unknown)?, of(query.right).ok_or_else(unknown)?];
        self.reports.send(Report::Foretold { query, clips });
        Ok(())
    }

    /// Says what the reward thinks of a whole dream, once.
    fn judge(&mut self, dream: DreamId) {
        if self.judged == Some(dream) {
            return;
        }
        let Some((episode, Some(features))) = self.dreams.get(&dream) else { return };
        let Some(judge) = &self.now else { return };
        let [rewards, low, high] = judge.jury.appraise(&features.values, &episode.actions);
        self.reports.send(Report::Judged(Judgement { dream, rewards, low, high }));
        self.judged = Some(dream);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;
    use crate::reward::{RewardConfig, RewardEnsemble, RewardModel as _, scaled_actions_tensor};
    use crate::tensor::{from_slice, to_vec};
    use crate::worker::toy;

    fn ensemble(seed: u64) -> RewardEnsemble {
        let rng = &mut ChaCha8Rng::seed_from_u64(seed);
        RewardEnsemble::new(36, &toy::model().hash(), RewardConfig::tiny(), rng)
    }

    #[test]
    fn a_dream_is_judged_step_by_step_and_plans_are_compared() {
        let dream = Arc::new(toy::dream(1, 30));
        let (reports, inbox) = Reports::new(|| ());
        let view = Latest::default();
        let model = toy::model();
        let planner = PlannerConfig::car_racing();
        let mut reviewer = Reviewer {
            model: toy::model(),
            planner: planner.clone(),
            reports: &reports,
            view: &view,
            dreams: HashMap::new(),
            now: None,
            before: None,
            judged: None,
            last: None,
        };
        let look = |step| ReviewerCommand::Look { dream: DreamId(7), step };
        reviewer.hear(ReviewerCommand::AddDream(DreamId(7), Arc::clone(&dream))).unwrap();
        reviewer.hear(look(12)).unwrap();
        let seen = view.take().unwrap();
        assert!(
            seen.promises.is_empty() && inbox.try_recv().is_err(),
            "without a reward there is only the picture"
        );
        for command in [ReviewerCommand::Reward(ensemble(0).parameters()), ReviewerCommand::Compare] {
            reviewer.hear(command).unwrap();
        }
        reviewer.hear(ReviewerCommand::Reward(ensemble(1).parameters())).unwrap();
        let judgements: Vec<_> = inbox.try_iter().collect();
        let [_, Report::Judged(judgement)] = &judgements[..] else { panic!("{judgements:?}") };
        let rows = dream.features(&model);
        let by_hand =
            ensemble(1).rewards(&from_slice(&rows.values, &[30, 36]), &scaled_actions_tensor(&dream.actions));
        assert_eq!(judgement.rewards, to_vec(&by_hand));
        let inside =
            |t: usize| judgement.low[t] <= judgement.rewards[t] && judgement.rewards[t] <= judgement.high[t];
        assert!((0..30).all(inside), "the mean lies between the members");

        let seen = view.take().unwrap();
        assert_eq!((seen.step, seen.promises.len()), (12, 15));
        let state = model.state_of(rows.row(12));
        let imagine = |seed| {
            let rng = &mut ChaCha8Rng::seed_from_u64(dream.seed ^ seen.step as u64);
            plan(&model, &ensemble(seed).for_inference(), &state, &planner, rng).unwrap()
        };
        let (now, before) = (imagine(1), imagine(0));
        assert_eq!((seen.chosen, seen.chosen_before), (now.chosen, Some(before.chosen)));
        let promised = |promise: &Promise| (promise.now, promise.before);
        let returns = now.candidates.iter().zip(&before.candidates);
        let expected: Vec<_> =
            returns.map(|(now, before)| (now.predicted_return, Some(before.predicted_return))).collect();
        assert_eq!(seen.promises.iter().map(promised).collect::<Vec<_>>(), expected);
    }

    #[test]
    fn of_clips_each_member_is_heard() {
        let dream = Arc::new(toy::dream(1, 60));
        let (reports, inbox) = Reports::new(|| ());
        let (commands, heard) = channel();
        let query = toy::query(3, (7, 2), (7, 31));
        for command in [
            ReviewerCommand::AddDream(DreamId(7), Arc::clone(&dream)),
            ReviewerCommand::Foretell(query),
            ReviewerCommand::Reward(ensemble(0).parameters()),
            ReviewerCommand::Foretell(query),
        ] {
            commands.send(command).unwrap();
        }
        let parameters = toy::model().parameters().clone();
        let reviewer = spawn(parameters, PlannerConfig::car_racing(), Latest::default(), &reports);
        for command in heard.try_iter() {
            reviewer.send(command);
        }
        let Report::Foretold { query: of, clips: [_, right] } = inbox.recv().unwrap() else {
            panic!("another report: without a reward nothing is foretold")
        };
        let rows = dream.features(&toy::model());
        let rows = from_slice(&rows.values[31 * 36..51 * 36], &[20, 36]);
        let scaled = scaled_actions_tensor(&dream.actions[31..51]);
        let members = ensemble(0).member_rewards(&rows, &scaled);
        let by_hand: Vec<Vec<f32>> = members.unbind(0).iter().map(to_vec).collect();
        assert_eq!((of, right.members), (query, by_hand));
        assert_eq!(right.rewards, to_vec(&ensemble(0).rewards(&rows, &scaled)));
    }

    #[test]
    fn of_steps_passed_over_quickly_the_last_is_drawn() {
        let (commands, heard) = channel();
        commands.send(ReviewerCommand::AddDream(DreamId(0), Arc::new(toy::dream(1, 30)))).unwrap();
        for step in 0..20 {
            commands.send(ReviewerCommand::Look { dream: DreamId(0), step }).unwrap();
        }
        let (reports, _inbox) = Reports::new(|| ());
        let view = Latest::default();
        let reviewer =
            spawn(toy::model().parameters().clone(), PlannerConfig::car_racing(), view.clone(), &reports);
        for step in 20..25 {
            commands.send(ReviewerCommand::Look { dream: DreamId(0), step }).unwrap();
        }
        for command in heard.try_iter() {
            reviewer.send(command);
        }
        let mut last = None;
        while last != Some(24) {
            last = view.take().map(|view: ReviewView| view.step).or(last);
            std::thread::yield_now();
        }
    }
}
