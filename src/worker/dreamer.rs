//! Plays dreams: reads the controls, steps the model, and shows what it can.

use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use crate::dream::Dream;
use crate::planner::{CoDriver, PlannerConfig};
use crate::reward::LearnedReward;
use crate::session::DreamJournal;
use crate::tensor::Parameters;
use crate::worker::clock::{Allowance, Beat, Clock, Rate, held};
use crate::worker::error::TaskError;
use crate::worker::{
    DreamReport, DreamerCommand, Latest, LiveAction, LiveView, Reports, Worker, WorkerError, WorkerName,
    one_thread,
};
use crate::world::{Action, WorldSpec};
use crate::world_model::{LatentState, Placed, WorldModel};

const NAME: WorkerName = WorkerName::Dreamer;

/// Starts a thread that plays dreams of `model`, drives them by `action` or by plan, and shows them in `view`.
pub fn spawn(
    model: impl Into<Placed>,
    planner: PlannerConfig,
    action: LiveAction,
    view: Latest<LiveView>,
    reports: &Reports,
) -> Worker<DreamerCommand> {
    let model = model.into();
    Worker::spawn(NAME, reports, move |commands, reports| {
        dream(&commands, &reports, model, planner, &action, &view)
    })
}

/// The body of the thread.
pub fn dream(
    commands: &Receiver<DreamerCommand>,
    reports: &Reports,
    model: impl Into<Placed>,
    planner: PlannerConfig,
    action: &LiveAction,
    view: &Latest<LiveView>,
) -> Result<(), WorkerError> {
    one_thread();
    let model = WorldModel::load(model)?;
    let (spec, planner) = (Arc::clone(model.spec()), planner.for_model(&model));
    let (neutral, rate) = (Action::new(spec.neutral()), spec.rate);
    let mut dreamer = Dreamer {
        model,
        spec,
        neutral,
        planner,
        reward: None,
        reports,
        action,
        view,
        clock: Clock::at(rate),
        drawing: Allowance::default(),
        pictures: Rate::default(),
        live: None,
    };
    loop {
        match dreamer.clock.wait(commands) {
            Beat::Command(command) => dreamer.handle(command),
            Beat::Due => dreamer.tick(),
            Beat::Over => return Ok(()),
        }
    }
}

/// What the thread owns.
struct Dreamer<'a> {
    model: WorldModel,
    spec: Arc<WorldSpec>,
    /// What is done where nobody does anything.
    neutral: Action,
    planner: PlannerConfig,
    /// What the planner maximizes, once something is learned.
    reward: Option<LearnedReward>,
    reports: &'a Reports,
    action: &'a LiveAction,
    view: &'a Latest<LiveView>,
    clock: Clock,
    drawing: Allowance,
    pictures: Rate,
    live: Option<Live>,
}

/// A dream that is being driven.
struct Live {
    dream: Dream,
    rng: ChaCha8Rng,
    journal: Option<DreamJournal>,
    /// Whether the journal has refused a step, and that was reported; the next step may catch up.
    is_journal_broken: bool,
    action: Action,
    /// Who drives where no person does.
    co_driver: Option<CoDriver>,
}

impl Live {
    /// Writes down what is new, and reports where that fails for the first time.
    fn note(&mut self, reports: &Reports) {
        let Some(journal) = self.journal.as_mut() else { return };
        match journal.follow(self.dream.episode()) {
            Ok(()) => self.is_journal_broken = false,
            Err(_) if self.is_journal_broken => {}
            Err(e) => {
                self.is_journal_broken = true;
                reports.send(DreamReport::Unjournaled(e.to_string()));
            }
        }
    }
}

impl Dreamer<'_> {
    fn handle(&mut self, command: DreamerCommand) {
        match command {
            DreamerCommand::Start { start, seed, journal } => {
                self.finish();
                self.start(&start, seed, journal);
            }
            DreamerCommand::Pause(pause) if self.live.is_some() => {
                if pause {
                    self.clock.stop();
                } else {
                    self.clock.start(Instant::now());
                }
                self.show(Duration::MAX);
            }
            DreamerCommand::Step if !self.clock.runs() => self.step(Instant::now()),
            DreamerCommand::MarkUnsafe => {
                if let Some(live) = &mut self.live {
                    live.dream.mark_unsafe();
                    live.note(self.reports);
                }
            }
            DreamerCommand::Reward(parameters) => self.use_reward(&parameters),
            DreamerCommand::HandOver(is_over) => {
                let config = self.planner_config().filter(|_| is_over);
                if let Some(live) = &mut self.live {
                    let seed = live.dream.episode().seed;
                    live.co_driver = config.map(|config| CoDriver::new(config, seed));
                }
                self.show(Duration::MAX);
            }
            DreamerCommand::Journal(journal) => {
                let before = match &mut self.live {
                    Some(live) => {
                        let before = live.journal.replace(journal);
                        live.is_journal_broken = false;
                        live.note(self.reports);
                        before
                    }
                    // It has ended meanwhile.
                    None => Some(journal),
                };
                if let Some(Err(e)) = before.map(DreamJournal::discard) {
                    log::warn!("{e}");
                }
            }
            DreamerCommand::Finish => self.finish(),
            DreamerCommand::Discard => {
                self.clock.stop();
                let journal = self.live.take().and_then(|live| live.journal);
                if let Some(Err(e)) = journal.map(DreamJournal::discard) {
                    self.reports.fail(NAME, e);
                }
            }
            DreamerCommand::Pause(_) | DreamerCommand::Step => {}
        }
    }

    /// Plans by this reward from the next plan on; by none where it cannot be used, rather than by one that is not meant.
    fn use_reward(&mut self, reward: &Parameters) {
        self.reward = match LearnedReward::load(reward, &self.model) {
            Ok(reward) => Some(reward),
            Err(e) => {
                self.reports.fail(NAME, TaskError::NoPlanning(e));
                None
            }
        };
        let config = self.planner_config();
        let Some(live) = &mut self.live else { return };
        match (config, &mut live.co_driver) {
            (Some(config), Some(co_driver)) => co_driver.plan_by(config),
            (None, co_driver) => *co_driver = None,
            (Some(_), None) => {}
        }
    }

    /// How the planner looks ahead by the reward that there is.
    fn planner_config(&self) -> Option<PlannerConfig> {
        let is_sparse = self.reward.as_ref()?.is_sparse();
        let config = self.planner.clone();
        Some(if is_sparse { config.for_transitions() } else { config })
    }

    fn start(&mut self, start: &LatentState, seed: u64, journal: Option<DreamJournal>) {
        let (dream, rng) = (Dream::new(start, seed), ChaCha8Rng::seed_from_u64(seed));
        let action = self.neutral;
        self.live = Some(Live { dream, rng, journal, is_journal_broken: false, action, co_driver: None });
        (self.clock, self.pictures) = (Clock::at(self.spec.rate), Rate::default());
        self.show(Duration::MAX);
        self.clock.start(Instant::now());
    }

    fn tick(&mut self) {
        let now = Instant::now();
        self.clock.tick(now);
        self.step(now);
    }

    /// One step; its picture may be left out, the step never.
    fn step(&mut self, now: Instant) {
        let Some(live) = &mut self.live else { return };
        let hands = held(self.action, self.neutral, now);
        // Whoever takes hold of the wheel has it, as in a car with an assistant.
        if hands != self.neutral {
            live.co_driver = None;
        }
        let planned = match (&mut live.co_driver, &self.reward) {
            (Some(co_driver), Some(reward)) => {
                co_driver.act(&self.model, reward, live.dream.state()).map(Some)
            }
            _ => Ok(None),
        };
        let planned = planned.unwrap_or_else(|met| {
            live.co_driver = None;
            self.reports.fail(NAME, TaskError::PlannerEnded(met));
            None
        });
        live.action = planned.unwrap_or(hands);
        let stepped = if planned.is_some() {
            live.dream.step_planned(&self.model, live.action, &mut live.rng)
        } else {
            live.dream.step(&self.model, live.action, &mut live.rng)
        };
        live.note(self.reports);
        if let Err(met) = stepped {
            self.reports.fail(NAME, TaskError::DreamEnded(met));
            return self.finish();
        }
        let is_long_enough = live.dream.episode().len() >= self.spec.longest_episode;
        self.show(self.clock.time_left(Instant::now()));
        if is_long_enough {
            self.finish();
        }
    }

    /// Draws the present, if there is time.
    fn show(&mut self, time_left: Duration) {
        let Some(live) = &self.live else { return };
        let Some(Some(frame)) = self.drawing.spend(time_left, || live.dream.frame(&self.model)) else {
            return;
        };
        self.pictures.note(Instant::now());
        self.view.put(LiveView {
            frame,
            picture: None,
            step: live.dream.episode().len(),
            action: live.action,
            steps_per_sec: self.clock.steps_per_sec(),
            pictures_per_sec: self.pictures.per_sec(),
            n_late: self.clock.n_late(),
            is_paused: !self.clock.runs(),
            n_unsafe_marks: live.dream.episode().unsafe_marks.len(),
            is_planned: live.co_driver.is_some(),
            status: None,
        });
        self.reports.wake();
    }

    fn finish(&mut self) {
        self.clock.stop();
        if let Some(Live { dream, journal, .. }) = self.live.take() {
            self.reports.send(DreamReport::Ended { episode: dream.finish(), journal });
        }
    }
}

#[cfg(test)]
mod tests {
    use std::ops::Range;
    use std::sync::mpsc::channel;

    use super::*;
    use crate::reward::{RewardConfig, RewardEnsemble, SparseConfig, SparseReward};
    use crate::worker::{Report, fixtures};
    use crate::world_model::State;

    /// What comes of `commands`, all of them received before the first step is due.
    fn reports_of(commands: impl IntoIterator<Item = DreamerCommand>, action: &LiveAction) -> Vec<Report> {
        let (sender, received) = channel();
        commands.into_iter().for_each(|command| sender.send(command).unwrap());
        drop(sender);
        let (reports, inbox) = Reports::new(|| ());
        let parameters = fixtures::model().parameters().clone();
        dream(&received, &reports, parameters, PlannerConfig::car_racing(), action, &Latest::default())
            .unwrap();
        drop(reports);
        inbox.iter().collect()
    }

    #[test]
    fn a_dream_ends_where_numbers_end_and_what_was_dreamed_is_kept() {
        let (sender, received) = channel();
        sender.send(start(5)).unwrap();
        sender.send(DreamerCommand::Pause(true)).unwrap();
        (0..50).for_each(|_| sender.send(DreamerCommand::Step).unwrap());
        drop(sender);
        let (reports, inbox) = Reports::new(|| ());
        let parameters = fixtures::exploding().parameters().clone();
        let action = Latest::default();
        dream(&received, &reports, parameters, PlannerConfig::car_racing(), &action, &Latest::default())
            .unwrap();
        drop(reports);
        let all: Vec<_> = inbox.iter().collect();
        let [Report::Failed(failure), Report::Dream(DreamReport::Ended { episode, .. })] = &all[..] else {
            panic!("{all:?}")
        };
        let message = failure.error.to_string();
        assert!(message.contains(&format!("step {} of the dream", episode.len() + 1)), "{message}");
        assert!(episode.zs.values.iter().all(|z| z.is_finite()) && !message.contains("bug"), "{message}");
    }

    fn start(seed: u64) -> DreamerCommand {
        DreamerCommand::Start { start: fixtures::start(), seed, journal: None }
    }

    #[test]
    fn a_dream_is_what_the_model_dreams_under_the_live_actions() {
        let action = Latest::default();
        action.put((Action::new([-1.0, 1.0, 0.0]), Instant::now() + Duration::from_secs(1000)));
        let steps =
            [DreamerCommand::Step, DreamerCommand::Step, DreamerCommand::MarkUnsafe, DreamerCommand::Step];
        let commands =
            [start(5), DreamerCommand::Pause(true)].into_iter().chain(steps).chain([DreamerCommand::Finish]);
        let reports = reports_of(commands, &action);
        let [Report::Dream(DreamReport::Ended { episode, journal: None })] = &reports[..] else {
            panic!("{reports:?}")
        };

        let (model, rng) = (fixtures::model(), &mut ChaCha8Rng::seed_from_u64(5));
        let mut by_hand = Dream::new(&fixtures::start(), 5);
        (0..3).for_each(|_| by_hand.step(&model, Action::new([-1.0, 1.0, 0.0]), rng).unwrap());
        assert_eq!(episode.unsafe_marks, [2]);
        assert_eq!((&episode.zs, &episode.actions), (&by_hand.episode().zs, &by_hand.episode().actions));
    }

    /// A reward that has learned nothing.
    fn reward() -> DreamerCommand {
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let ensemble =
            RewardEnsemble::new((36, fixtures::model().hash().as_str()), RewardConfig::tiny(), rng);
        DreamerCommand::Reward(ensemble.parameters())
    }

    #[test]
    fn the_planner_drives_until_it_is_told_otherwise_or_a_hand_is_on_the_wheel() {
        let step = || DreamerCommand::Step;
        let begin = || vec![reward(), start(5), DreamerCommand::Pause(true), step()];
        let rest = [DreamerCommand::HandOver(true), step(), step(), DreamerCommand::HandOver(false), step()];
        let commands = begin().into_iter().chain(rest).chain([DreamerCommand::Finish]);
        let reports = reports_of(commands, &Latest::default());
        let [Report::Dream(DreamReport::Ended { episode, .. })] = &reports[..] else { panic!("{reports:?}") };
        assert_eq!((episode.len(), &episode.planned), (4, &vec![Range { start: 1, end: 3 }]));
        assert!(episode.actions[1][1] > 0.0, "every candidate gives gas");
        assert_eq!(episode.actions[3], [0.0; 3]);

        let hands = Latest::default();
        hands.put((Action::new([0.0, 1.0, 0.0]), Instant::now() + Duration::from_secs(1000)));
        let rest = [DreamerCommand::HandOver(true), step(), step(), DreamerCommand::Finish];
        let reports = reports_of(begin().into_iter().chain(rest), &hands);
        let [Report::Dream(DreamReport::Ended { episode, .. })] = &reports[..] else { panic!("{reports:?}") };
        assert_eq!(episode.n_planned(), 0, "hands are stronger");
    }

    /// A classifier of transitions that has learned nothing.
    fn verdicts(seed: u64, world: &str) -> SparseReward {
        SparseReward::new((36, world), SparseConfig::tiny(), &mut ChaCha8Rng::seed_from_u64(seed))
    }

    #[test]
    fn a_reward_of_verdicts_drives_a_dream_and_looks_further_ahead() {
        let sparse = verdicts(1, &fixtures::model().hash());
        let short = PlannerConfig { horizon: 15, ..PlannerConfig::obstacle_car_racing() };
        let (sender, received) = channel();
        for command in [
            DreamerCommand::Reward(sparse.parameters()),
            start(5),
            DreamerCommand::Pause(true),
            DreamerCommand::HandOver(true),
            DreamerCommand::Step,
            DreamerCommand::Finish,
        ] {
            sender.send(command).unwrap();
        }
        drop(sender);
        let (reports, inbox) = Reports::new(|| ());
        let parameters = fixtures::model().parameters().clone();
        dream(&received, &reports, parameters, short.clone(), &Latest::default(), &Latest::default())
            .unwrap();
        drop(reports);
        let reports: Vec<_> = inbox.iter().collect();
        let [Report::Dream(DreamReport::Ended { episode, .. })] = &reports[..] else { panic!("{reports:?}") };
        let state = State::from(&fixtures::start());
        let by_hand = CoDriver::new(short.for_transitions(), 5).act(
            &fixtures::model(),
            &sparse.for_inference(),
            &state,
        );
        assert_eq!((episode.n_planned(), episode.actions[0]), (1, by_hand.unwrap()));
    }

    #[test]
    fn a_reward_that_is_learned_meanwhile_is_planned_by_from_the_next_plan_on() {
        let rewards = [1, 2].map(|seed| verdicts(seed, &fixtures::model().hash()));
        let learned = |i: usize| DreamerCommand::Reward(rewards[i].parameters());
        let begin = [learned(0), start(5), DreamerCommand::Pause(true), DreamerCommand::HandOver(true)];
        let step = || DreamerCommand::Step;
        let rest = [step(), step(), learned(1), step(), step(), step(), DreamerCommand::Finish];
        let reports = reports_of(begin.into_iter().chain(rest), &Latest::default());
        let [Report::Dream(DreamReport::Ended { episode, .. })] = &reports[..] else { panic!("{reports:?}") };

        let (model, rng) = (fixtures::model(), &mut ChaCha8Rng::seed_from_u64(5));
        let (mut by_hand, mut driver) = (
            Dream::new(&fixtures::start(), 5),
            CoDriver::new(PlannerConfig::car_racing().for_transitions(), 5),
        );
        for t in 0..5 {
            let reward = &rewards[usize::from(t >= 4)].for_inference();
            let action = driver.act(&model, reward, by_hand.state()).unwrap();
            by_hand.step_planned(&model, action, rng).unwrap();
        }
        assert_eq!((episode.n_planned(), &episode.actions), (5, &by_hand.episode().actions));
    }

    #[test]
    fn a_reward_that_cannot_be_used_takes_the_wheel_away_and_says_why() {
        let step = || DreamerCommand::Step;
        let other = DreamerCommand::Reward(verdicts(1, "sha256:0").parameters());
        let begin = [reward(), start(5), DreamerCommand::Pause(true), DreamerCommand::HandOver(true), step()];
        let rest = [other, step(), DreamerCommand::HandOver(true), step(), DreamerCommand::Finish];
        let reports = reports_of(begin.into_iter().chain(rest), &Latest::default());
        let [Report::Failed(failure), Report::Dream(DreamReport::Ended { episode, .. })] = &reports[..]
        else {
            panic!("{reports:?}")
        };
        let message = failure.error.to_string();
        assert!(message.contains("the planner cannot drive by this reward"), "{message}");
        assert_eq!((episode.len(), episode.n_planned()), (3, 1));
    }

    #[test]
    fn a_discarded_dream_is_not_reported() {
        let reports =
            reports_of([start(0), DreamerCommand::Discard, DreamerCommand::Finish], &Latest::default());
        assert!(reports.is_empty(), "{reports:?}");
    }

    #[cfg(unix)]
    #[test]
    fn a_dream_whose_journal_is_gone_is_reported_once_and_goes_on_in_another() {
        use crate::dream::DreamEpisode;
        use crate::query::Protocol;
        use crate::session::{DreamSource, Header, SessionStore};

        let (first, second) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let store = |dir: &std::path::Path| {
            let header = Header::new("dummy-road", Protocol::Dropj, 1, &fixtures::model().hash(), 0);
            SessionStore::create(&dir.join("s"), header).unwrap()
        };
        let (one, other) = (store(first.path()), store(second.path()));
        let begun = DreamEpisode::new(fixtures::start(), 5);
        let journal = |store: &SessionStore| store.journal(&begun, DreamSource::User).unwrap();
        let (gone, kept) = (journal(&one), journal(&other));
        first.close().unwrap();
        let start = DreamerCommand::Start { start: fixtures::start(), seed: 5, journal: Some(gone) };
        let step = || DreamerCommand::Step;
        let commands =
            [start, DreamerCommand::Pause(true), step(), step(), DreamerCommand::Journal(kept), step()];
        let reports = reports_of(commands, &Latest::default());
        let [Report::Dream(DreamReport::Unjournaled(why))] = &reports[..] else { panic!("{reports:?}") };
        assert!(why.contains("was replaced, moved or changed"), "{why}");
        // The program ended before the dream did.
        let left = other.unfinished_dreams().unwrap();
        assert_eq!((left.len(), left[0].episode.len()), (1, 3), "all of it, from the first step on");
    }

    #[test]
    fn starting_again_ends_the_dream_before() {
        let reports = reports_of([start(1), start(2)], &Latest::default());
        assert!(
            matches!(&reports[..], [Report::Dream(DreamReport::Ended { episode, .. })] if episode.seed == 1),
            "{reports:?}"
        );
    }

    #[test]
    fn a_dream_ends_by_itself_after_a_thousand_steps() {
        let steps = (0..1005).map(|_| DreamerCommand::Step);
        let reports =
            reports_of([start(1), DreamerCommand::Pause(true)].into_iter().chain(steps), &Latest::default());
        assert!(
            matches!(&reports[..], [Report::Dream(DreamReport::Ended { episode, .. })] if episode.len() == 1000)
        );
    }

    #[test]
    fn a_living_dream_is_shown_and_ends_with_its_worker() {
        let (reports, inbox) = Reports::new(|| ());
        let view = Latest::default();
        let parameters = fixtures::model().parameters().clone();
        let planner = PlannerConfig::car_racing();
        let dreamer = spawn(parameters, planner, Latest::default(), view.clone(), &reports);
        dreamer.send(start(3));
        while view.take().is_none_or(|view| view.step < 3) {
            std::thread::yield_now();
        }
        drop(dreamer);
        assert!(inbox.try_recv().is_err(), "it was neither finished nor in trouble");
    }
}
