//! All workers together: commands go in, reports come out.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;

use crate::planner::PlannerConfig;
use crate::planner::synthesis::SynthesisConfig;
use crate::reward::RewardConfig;
use crate::tensor::{Backend, Parameters};
use crate::worker::channel::Sent;
use crate::worker::jobs::Jobs;
use crate::worker::{
    Cause, ClipperCommand, DeployReport, Dismissed, DreamInspectorCommand, DreamReport, DreamerCommand,
    DriveView, DriverCommand, EpisodeBrowserCommand, EpisodeView, EvaluateReport, Inbox, Latest, LiveAction,
    LiveView, LoadedWorld, ModelerCommand, OpenWorld, PreviewerCommand, RecordReport, RecorderCommand,
    ReplayView, ReplayerCommand, Report, Reports, ReviewView, RolloutView, ScreenerCommand,
    SessionWriterCommand, SynthesizerCommand, TrainerCommand, Worker, WorkerCommand, clipper,
    dream_inspector, dreamer, driver, episode_browser, modeler, previewer, recorder, replayer, screener,
    session_writer, synthesizer, trainer,
};
use crate::world::WorldSpec;
use crate::world_model::fit::FitConfig;
use crate::world_model::{Placed, WorldModelConfig};

/// The workers, or a script in their place in tests.
pub trait Workers {
    /// Passes a command on.
    fn send(&mut self, command: WorkerCommand);

    /// All that was reported since the last time, live pictures included.
    fn poll(&mut self) -> Vec<Report>;

    /// Where the driver's hands are put.
    fn action(&self) -> LiveAction;
}

/// Makes a world model out of a file, or says why it cannot.
pub type LoadWorldModel = Arc<dyn Fn(&Path) -> Result<LoadedWorld, Cause> + Send + Sync>;

/// What workers are made with.
pub struct WorkerConfig {
    /// Opens the real world; it may help a deployed planner, as in the paper's evaluation, and nobody who records.
    pub open: OpenWorld,
    /// What it is.
    pub spec: Arc<WorldSpec>,
    /// The shapes of a world model that is fitted here.
    pub world: WorldModelConfig,
    /// How it is fitted.
    pub fit: FitConfig,
    /// The reward.
    pub reward: RewardConfig,
    /// The planner.
    pub planner: PlannerConfig,
    /// How trajectories are synthesized.
    pub synthesis: SynthesisConfig,
    /// How world models are read.
    pub load: LoadWorldModel,
    /// What computes dreams, plans, rewards and the fit of a world model.
    pub backend: Backend,
}

/// The slots between the application and its workers: only the latest value counts.
#[derive(Clone, Debug, Default)]
pub struct Slots {
    /// What the driver's hands do.
    pub action: LiveAction,
    /// What is seen in the dream.
    pub dream: Latest<LiveView>,
    /// What is seen while recording.
    pub record: Latest<LiveView>,
    /// The rollout beside that.
    pub rollout: Latest<RolloutView>,
    /// What is seen while the planner drives.
    pub drive: Latest<DriveView>,
    /// What is seen of a kept dream.
    pub review: Latest<ReviewView>,
    /// What is seen of a recorded episode.
    pub episode: Latest<EpisodeView>,
    /// What is seen of an episode that is driven again.
    pub replay: Latest<ReplayView>,
}

impl Slots {
    /// The pictures that are new, each taken out of its slot.
    pub fn take(&self) -> impl Iterator<Item = Report> {
        let Self { action: _, dream, record, rollout, drive, review, episode, replay } = self;
        let views = [
            dream.take().map(|view| DreamReport::View(view).into()),
            record.take().map(|view| RecordReport::View(view).into()),
            rollout.take().map(|view| RecordReport::Rollout(view).into()),
            drive.take().map(|view| DeployReport::View(view).into()),
            review.take().map(|view| DreamReport::Review(view).into()),
            episode.take().map(|view| RecordReport::EpisodeView(view).into()),
            replay.take().map(|view| EvaluateReport::View(view).into()),
        ];
        views.into_iter().flatten()
    }
}

/// A thread for each worker, started by the first command for it.
pub struct Threads {
    config: WorkerConfig,
    reports: Reports,
    inbox: Inbox,
    /// Reports that were in the inbox when others were dropped from it.
    unread: VecDeque<Sent>,
    slots: Slots,
    model: Option<Parameters>,
    running: Running,
    jobs: Jobs,
    /// Threads that were told to end: nobody waits for them but the end of the program.
    dismissed: Vec<Dismissed>,
}

/// What a worker is started with.
struct Start<'a> {
    config: &'a WorkerConfig,
    slots: &'a Slots,
    model: Option<&'a Parameters>,
    reports: &'a Reports,
}

impl Start<'_> {
    fn model(&self) -> Option<Placed> {
        let backend = self.config.backend;
        self.model.cloned().map(|parameters| Placed { parameters, backend })
    }
}

/// How long a worker lives: what ends one ends those before it, too.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Life {
    /// As long as the session.
    Session,
    /// As long as the world model.
    WorldModel,
    /// As long as the program; after a bug, another takes its place with the next world model.
    Program,
}

/// The table of workers. Each line says a worker's name, its commands, how long it lives, which slots it fills, and how it
/// is started, where that can be: who needs a world model is not started without.
macro_rules! workers {
    ($($name:ident, $field:ident: $command:ty, lives $life:ident, fills [$($slot:ident)*], $start:expr;)*) => {
        /// The workers whose threads were started.
        #[derive(Default)]
        struct Running {
            $($field: Option<Worker<$command>>,)*
        }

        impl Threads {
            fn pass_on(&mut self, command: WorkerCommand) {
                match command {
                    $(WorkerCommand::$name(command) => {
                        let start: fn(Start<'_>) -> Option<Worker<$command>> = $start;
                        if self.running.$field.is_none() {
                            self.running.$field = start(self.start());
                        }
                        match &self.running.$field {
                            Some(worker) => worker.send(command),
                            None => log::warn!("nobody can do this without a world model: {command:?}"),
                        }
                    })*
                    WorkerCommand::Jobs(command) => {
                        self.jobs.give_up_before(&command);
                        // What was given up may hold the very session that is wanted now.
                        self.drop_unwanted();
                        self.jobs.begin(command);
                    }
                    WorkerCommand::EndSession => self.end(Life::Session),
                    WorkerCommand::UseWorldModel(model) => {
                        self.end(Life::WorldModel);
                        self.model = Some(model);
                    }
                }
            }

            /// Ends all workers that live no longer than this, and whoever died of a bug.
            fn end(&mut self, life: Life) {
                $(if Life::$life <= life {
                    self.dismissed.extend(self.running.$field.take().map(Worker::dismiss));
                    // What it still draws goes into a slot that nobody looks at.
                    $(self.slots.$slot = Latest::default();)*
                } else if life == Life::WorldModel {
                    self.running.$field.take_if(|worker| worker.is_over());
                })*
                self.drop_unwanted();
            }
        }
    };
}

workers! {
    Dreamer, dreamer: DreamerCommand, lives WorldModel, fills [dream], |start| {
        let (action, view) = (start.slots.action.clone(), start.slots.dream.clone());
        Some(dreamer::spawn(start.model()?, start.config.planner.clone(), action, view, start.reports))
    };
    Clipper, clipper: ClipperCommand, lives Session, fills [], |start| {
        Some(clipper::spawn(start.model()?, start.reports))
    };
    Screener, screener: ScreenerCommand, lives Session, fills [], |start| {
        Some(screener::spawn(start.model()?, start.reports))
    };
    Synthesizer, synthesizer: SynthesizerCommand, lives Session, fills [], |start| {
        Some(synthesizer::spawn(start.model()?, start.config.synthesis.clone(), start.reports))
    };
    Trainer, trainer: TrainerCommand, lives Session, fills [], |start| {
        Some(trainer::spawn(start.model()?, start.config.reward.clone(), start.reports))
    };
    Driver, driver: DriverCommand, lives Session, fills [drive], |start| {
        let (planner, view) = (start.config.planner.clone(), start.slots.drive.clone());
        Some(driver::spawn(Arc::clone(&start.config.open), start.model()?, planner, view, start.reports))
    };
    DreamInspector, dream_inspector: DreamInspectorCommand, lives Session, fills [review], |start| {
        let (planner, view) = (start.config.planner.clone(), start.slots.review.clone());
        Some(dream_inspector::spawn(start.model()?, planner, view, start.reports))
    };
    Recorder, recorder: RecorderCommand, lives Program, fills [record rollout], |start| {
        let Start { config, slots, reports, .. } = start;
        let (action, views) = (slots.action.clone(), (slots.record.clone(), slots.rollout.clone()));
        let planner = config.planner.clone();
        Some(recorder::spawn(Arc::clone(&config.open), Arc::clone(&config.spec), planner, action, views, reports))
    };
    EpisodeBrowser, episode_browser: EpisodeBrowserCommand, lives Program, fills [episode], |start| {
        Some(episode_browser::spawn(Arc::clone(&start.config.spec), start.slots.episode.clone(), start.reports))
    };
    Replayer, replayer: ReplayerCommand, lives Program, fills [replay], |start| {
        Some(replayer::spawn(Arc::clone(&start.config.open), start.slots.replay.clone(), start.reports))
    };
    Modeler, modeler: ModelerCommand, lives Program, fills [], |start| {
        let WorkerConfig { world, fit, backend, .. } = start.config;
        Some(modeler::spawn(world.clone(), fit.clone(), *backend, start.reports))
    };
    Previewer, previewer: PreviewerCommand, lives Program, fills [], |start| {
        Some(previewer::spawn(Arc::clone(&start.config.open), start.reports))
    };
    SessionWriter, session_writer: SessionWriterCommand, lives Program, fills [], |start| {
        Some(session_writer::spawn(start.reports))
    };
}

impl Threads {
    /// What the workers show, for whoever wants to see it without taking reports.
    pub fn slots(&self) -> Slots {
        self.slots.clone()
    }

    /// None is running yet; those that need a world model use `model`, and do nothing without. `wake` is called whenever
    /// there is something to poll.
    pub fn new(
        config: WorkerConfig,
        model: Option<&Parameters>,
        wake: impl Fn() + Send + Sync + 'static,
    ) -> Self {
        let (reports, inbox) = Reports::new(wake);
        Self {
            jobs: Jobs::new(Arc::clone(&config.load), &reports),
            config,
            reports,
            inbox,
            unread: VecDeque::new(),
            slots: Slots::default(),
            model: model.cloned(),
            running: Running::default(),
            dismissed: Vec::new(),
        }
    }

    fn start(&self) -> Start<'_> {
        let Self { config, slots, model, reports, .. } = self;
        Start { config, slots, model: model.as_ref(), reports }
    }

    /// Drops what was reported by those that were dismissed.
    fn drop_unwanted(&mut self) {
        self.unread.extend(self.inbox.sent());
        self.unread.retain(Sent::is_wanted);
    }
}

impl Workers for Threads {
    fn send(&mut self, command: WorkerCommand) {
        self.dismissed.retain(|thread| !thread.is_over());
        self.pass_on(command);
    }

    fn poll(&mut self) -> Vec<Report> {
        self.unread.extend(self.inbox.sent());
        let reports = self.unread.drain(..).filter_map(Sent::report);
        reports.chain(self.slots.take()).collect()
    }

    fn action(&self) -> LiveAction {
        self.slots.action.clone()
    }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::query::DreamId;
    use crate::reward::RewardEnsemble;
    use crate::session::{Header, SessionStore};
    use crate::worker::{JobCommand, JobReport, LabelReport, WorkerError, WorkerName, fixtures};

    fn threads() -> Threads {
        Threads::new(fixtures::config(1_000_000), Some(fixtures::model().parameters()), || ())
    }

    /// What is polled until `is_last` comes, which is the last of it.
    fn poll_until(threads: &mut Threads, is_last: impl Fn(&Report) -> bool) -> Vec<Report> {
        let (mut all, end) = (Vec::new(), Instant::now() + Duration::from_mins(1));
        while !all.iter().any(&is_last) {
            assert!(Instant::now() < end, "{all:?}");
            all.extend(threads.poll());
            std::thread::sleep(Duration::from_millis(1));
        }
        all
    }

    /// Waits until so many reports are in the inbox, without taking them.
    fn wait_for(threads: &mut Threads, n: usize) {
        let end = Instant::now() + Duration::from_mins(1);
        while threads.unread.len() < n {
            assert!(Instant::now() < end, "{:?}", threads.unread);
            threads.unread.extend(threads.inbox.sent());
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    fn unknown_clip() -> WorkerCommand {
        WorkerCommand::Clipper(ClipperCommand::Decode(fixtures::query(0, (0, 0), (0, 0))))
    }

    fn list_nothing() -> WorkerCommand {
        WorkerCommand::EpisodeBrowser(EpisodeBrowserCommand::List("no such folder".into()))
    }

    #[test]
    fn commands_come_to_their_workers_and_pictures_to_whoever_polls() {
        let mut threads = threads();
        let dream = Arc::new(fixtures::dream(1, 30));
        for command in [
            WorkerCommand::DreamInspector(DreamInspectorCommand::AddDream(DreamId(0), Arc::clone(&dream))),
            WorkerCommand::DreamInspector(DreamInspectorCommand::Show { dream: DreamId(0), step: 7 }),
            WorkerCommand::Screener(ScreenerCommand::AddDream(DreamId(0), dream)),
            WorkerCommand::Jobs(JobCommand::Identify("nothing".into())),
        ] {
            threads.send(command);
        }
        let (mut is_shown, mut is_screened, mut is_identified) = (false, false, false);
        let end = Instant::now() + Duration::from_mins(1);
        while !(is_shown && is_screened && is_identified) {
            assert!(Instant::now() < end, "{:?}", (is_shown, is_screened, is_identified));
            for report in threads.poll() {
                match report {
                    Report::Dream(DreamReport::Review(view)) => is_shown = view.step == 7,
                    Report::Label(LabelReport::Signs { .. }) => is_screened = true,
                    Report::Job(JobReport::Identified(..)) => is_identified = true,
                    other => panic!("{other:?}"),
                }
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    #[test]
    fn what_is_driven_is_seen() {
        let mut threads = threads();
        let dir = tempfile::tempdir().unwrap();
        let start = RecorderCommand::Start { dataset: dir.path().to_owned(), seed: 0 };
        threads.send(WorkerCommand::Recorder(start));
        let begin = DreamerCommand::Start { start: fixtures::start(), seed: 5, journal: None };
        threads.send(WorkerCommand::Dreamer(begin));
        poll_until(&mut threads, |report| matches!(report, Report::Record(RecordReport::View(_))));
        poll_until(&mut threads, |report| matches!(report, Report::Dream(DreamReport::View(_))));
        threads.send(WorkerCommand::Recorder(RecorderCommand::Discard));
    }

    #[test]
    fn with_the_session_goes_all_that_its_workers_reported_and_nothing_else() {
        let mut threads = threads();
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let hash = fixtures::model().hash();
        let reward = RewardEnsemble::new((36, hash.as_str()), RewardConfig::tiny(), rng).parameters();
        threads.send(WorkerCommand::Driver(DriverCommand::Reward(reward)));
        threads.send(WorkerCommand::Driver(DriverCommand::Drive { seed: 0 }));
        let driven = |threads: &mut Threads| {
            poll_until(threads, |report| matches!(report, Report::Deploy(DeployReport::View(_))))
        };
        driven(&mut threads);
        threads.send(unknown_clip());
        threads.send(list_nothing());
        wait_for(&mut threads, 2);
        while threads.slots.drive.is_empty() {
            std::thread::yield_now();
        }
        let slot = threads.slots.drive.clone();
        threads.send(WorkerCommand::EndSession);
        let all = threads.poll();
        let [Report::Record(RecordReport::Episodes(_))] = &all[..] else { panic!("{all:?}") };
        let Running { driver, clipper, episode_browser, .. } = &threads.running;
        assert!(driver.is_none() && clipper.is_none() && episode_browser.is_some());
        // Even if it draws once more.
        threads.dismissed.clear();
        assert!(slot.take().is_some() && threads.poll().is_empty());
        threads.send(unknown_clip());
        let all = poll_until(&mut threads, |report| matches!(report, Report::Failed(_)));
        assert_eq!(all.len(), 1, "another took its place: {all:?}");
    }

    #[test]
    fn another_world_model_is_for_new_workers_and_for_those_that_died() {
        let mut threads = threads();
        let begin = || {
            let start = DreamerCommand::Start { start: fixtures::start(), seed: 5, journal: None };
            WorkerCommand::Dreamer(start)
        };
        threads.send(begin());
        threads.send(list_nothing());
        let died = Worker::spawn(WorkerName::Modeler, &threads.reports, |_, _| panic!("on purpose"));
        while !died.is_over() {
            std::thread::yield_now();
        }
        threads.running.modeler = Some(died);
        threads.send(WorkerCommand::EndSession);
        let Running { dreamer, episode_browser, modeler, .. } = &threads.running;
        assert!(
            dreamer.is_some() && episode_browser.is_some() && modeler.is_some(),
            "they outlive a session"
        );
        threads.send(WorkerCommand::UseWorldModel(fixtures::exploding().parameters().clone()));
        let Running { dreamer, episode_browser, modeler, .. } = &threads.running;
        assert!(dreamer.is_none() && episode_browser.is_some() && modeler.is_none());
        let all = poll_until(
            &mut threads,
            |report| matches!(report, Report::Failed(failure) if failure.worker == WorkerName::Modeler),
        );
        let is_bug = |report: &Report| matches!(report, Report::Failed(failure) if matches!(failure.error, WorkerError::Panicked(_)));
        assert!(all.iter().any(is_bug), "that it died is not lost: {all:?}");
        threads.send(begin());
        // The new model explodes, as the old one did not.
        poll_until(&mut threads, |report| matches!(report, Report::Dream(DreamReport::Ended { .. })));
    }

    #[test]
    fn without_a_world_model_nothing_that_needs_one_is_begun() {
        let mut threads = Threads::new(fixtures::config(5), None, || ());
        threads.send(unknown_clip());
        threads.send(WorkerCommand::Driver(DriverCommand::Drive { seed: 0 }));
        assert!(threads.running.clipper.is_none() && threads.running.driver.is_none());
        threads.send(list_nothing());
        poll_until(&mut threads, |report| matches!(report, Report::Record(RecordReport::Episodes(_))));
        threads.send(WorkerCommand::UseWorldModel(fixtures::model().parameters().clone()));
        threads.send(unknown_clip());
        poll_until(&mut threads, |report| matches!(report, Report::Failed(_)));
    }

    #[test]
    fn a_session_that_was_opened_and_is_given_up_unread_holds_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s");
        let header =
            Header::new("dummy-road", crate::query::Protocol::Dropj, 1, &fixtures::model().hash(), 0);
        drop(SessionStore::create(&path, header).unwrap());
        let mut threads = threads();
        let open = || WorkerCommand::Jobs(JobCommand::OpenSession { dir: path.clone(), model: None });
        threads.send(open());
        wait_for(&mut threads, 1);
        threads.send(open());
        let all = poll_until(&mut threads, |report| matches!(report, Report::Job(JobReport::Session(_))));
        assert!(matches!(&all[..], [Report::Job(JobReport::Session(Ok(_)))]), "{all:?}");
        drop(all);
        threads.send(open());
        wait_for(&mut threads, 1);
        threads.send(WorkerCommand::Jobs(JobCommand::GiveUpOpening));
        assert!(threads.poll().is_empty());
        assert!(SessionStore::open(&path, None).is_ok(), "nobody holds it");
    }
}
