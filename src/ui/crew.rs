//! Whoever does the slow work, as the window sees them.

use crate::env::{Aids, Env};
use crate::planner::PlannerConfig;
use crate::planner::synthesis::SynthesisConfig;
use crate::reward::RewardConfig;
use crate::tensor::Parameters;
use crate::worker::{
    BesideView, ClipperCommand, Dismissed, DreamerCommand, DriveView, DriverCommand, EpisodeView, Latest,
    LibrarianCommand, LiveAction, LiveView, ModelerCommand, RecorderCommand, Reports, ReviewView,
    ReviewerCommand, ScreenerCommand, SynthesizerCommand, TrainerCommand, Worker, clipper, dreamer, driver,
    librarian, modeler, recorder, reviewer, screener, synthesizer, trainer,
};
use crate::world_model::WorldModelConfig;
use crate::world_model::fit::FitConfig;

/// A command and whom it is for.
#[derive(Debug)]
pub enum Order {
    /// To whoever plays dreams.
    Dreamer(DreamerCommand),
    /// To whoever draws clips.
    Clipper(ClipperCommand),
    /// To whoever looks for bad dreams.
    Screener(ScreenerCommand),
    /// To whoever makes trajectories.
    Synthesizer(SynthesizerCommand),
    /// To whoever learns the reward.
    Trainer(TrainerCommand),
    /// To whoever drives by plan.
    Driver(DriverCommand),
    /// To whoever looks at kept dreams again.
    Reviewer(ReviewerCommand),
    /// To whoever records.
    Recorder(RecorderCommand),
    /// To whoever keeps recorded episodes.
    Librarian(LibrarianCommand),
    /// To whoever trains world models.
    Modeler(ModelerCommand),
}

/// The slots between the window and its workers: only the latest value counts.
#[derive(Clone, Debug, Default)]
pub struct Slots {
    /// What the driver's hands do.
    pub action: LiveAction,
    /// What is seen in the dream.
    pub dream: Latest<LiveView>,
    /// What is seen while recording.
    pub record: Latest<LiveView>,
    /// What is dreamt beside that.
    pub beside: Latest<BesideView>,
    /// What is seen while the planner drives.
    pub drive: Latest<DriveView>,
    /// What is seen of a kept dream.
    pub review: Latest<ReviewView>,
    /// What is seen of a recorded episode.
    pub episode: Latest<EpisodeView>,
}

/// Threads, or a script in tests.
pub trait Crew {
    /// Passes a command on.
    fn send(&mut self, order: Order);

    /// Begins anew with another world model: all dreams, answers and rewards are forgotten.
    fn change_world(&mut self, model: &Parameters);

    /// Begins anew with the same world model, as for another session.
    fn forget(&mut self);

    /// The slots that the workers read and write.
    fn slots(&self) -> Slots;
}

/// What workers are made with.
pub struct Plans {
    /// Makes the real world; its aids help a deployed car, as in the paper's evaluation, and nobody who records.
    pub env: Box<dyn Fn(Aids) -> Box<dyn Env>>,
    /// What it is called in recordings.
    pub env_name: String,
    /// The shapes of a world model that is fitted here.
    pub world: WorldModelConfig,
    /// How it is fitted.
    pub fit: FitConfig,
    /// The reward.
    pub reward: RewardConfig,
    /// The planner.
    pub planner: PlannerConfig,
    /// How trajectories are made.
    pub synthesis: SynthesisConfig,
}

/// A thread for each worker, started by the first command that it hears.
pub struct Threads {
    plans: Plans,
    reports: Reports,
    slots: Slots,
    model: Option<Parameters>,
    dreamer: Option<Worker<DreamerCommand>>,
    clipper: Option<Worker<ClipperCommand>>,
    screener: Option<Worker<ScreenerCommand>>,
    synthesizer: Option<Worker<SynthesizerCommand>>,
    trainer: Option<Worker<TrainerCommand>>,
    driver: Option<Worker<DriverCommand>>,
    reviewer: Option<Worker<ReviewerCommand>>,
    recorder: Option<Worker<RecorderCommand>>,
    librarian: Option<Worker<LibrarianCommand>>,
    modeler: Option<Worker<ModelerCommand>>,
    /// Threads that were told to end: nobody waits for them but the end of the program.
    dismissed: Vec<Dismissed>,
}

impl Threads {
    /// None is running yet; those that need a world model use `model`, and do nothing without.
    pub fn new(plans: Plans, reports: &Reports, model: Option<&Parameters>) -> Self {
        Self {
            plans,
            reports: reports.clone(),
            slots: Slots::default(),
            model: model.cloned(),
            dreamer: None,
            clipper: None,
            screener: None,
            synthesizer: None,
            trainer: None,
            driver: None,
            reviewer: None,
            recorder: None,
            librarian: None,
            modeler: None,
            dismissed: Vec::new(),
        }
    }
}

/// Tells a worker to end, if there is one.
fn dismiss<C: Send + 'static>(worker: &mut Option<Worker<C>>, dismissed: &mut Vec<Dismissed>) {
    dismissed.extend(worker.take().map(Worker::dismiss));
}

impl Crew for Threads {
    fn send(&mut self, order: Order) {
        self.dismissed.retain(|thread| !thread.is_over());
        let (plans, reports, slots) = (&self.plans, &self.reports, &self.slots);
        match (order, self.model.clone()) {
            (Order::Recorder(command), _) => {
                let start = || {
                    let (env, views) =
                        ((plans.env)(Aids::NONE), (slots.record.clone(), slots.beside.clone()));
                    let planner = plans.planner.clone();
                    recorder::spawn(env, &plans.env_name, planner, slots.action.clone(), views, reports)
                };
                self.recorder.get_or_insert_with(start).send(command);
            }
            (Order::Librarian(command), _) => {
                let start = || librarian::spawn(slots.episode.clone(), reports);
                self.librarian.get_or_insert_with(start).send(command);
            }
            (Order::Modeler(command), _) => {
                let start = || modeler::spawn(plans.world.clone(), plans.fit.clone(), reports);
                self.modeler.get_or_insert_with(start).send(command);
            }
            (Order::Dreamer(command), Some(model)) => {
                let start = || {
                    let (action, view) = (slots.action.clone(), slots.dream.clone());
                    dreamer::spawn(model, plans.planner.clone(), action, view, reports)
                };
                self.dreamer.get_or_insert_with(start).send(command);
            }
            (Order::Clipper(command), Some(model)) => {
                self.clipper.get_or_insert_with(|| clipper::spawn(model, reports)).send(command);
            }
            (Order::Screener(command), Some(model)) => {
                self.screener.get_or_insert_with(|| screener::spawn(model, reports)).send(command);
            }
            (Order::Synthesizer(command), Some(model)) => {
                let start = || synthesizer::spawn(model, plans.synthesis.clone(), reports);
                self.synthesizer.get_or_insert_with(start).send(command);
            }
            (Order::Trainer(command), Some(model)) => {
                let start = || trainer::spawn(model, plans.reward.clone(), reports);
                self.trainer.get_or_insert_with(start).send(command);
            }
            (Order::Driver(command), Some(model)) => {
                let start = || {
                    let view = slots.drive.clone();
                    driver::spawn((plans.env)(Aids::ALL), model, plans.planner.clone(), view, reports)
                };
                self.driver.get_or_insert_with(start).send(command);
            }
            (Order::Reviewer(command), Some(model)) => {
                let start = || reviewer::spawn(model, plans.planner.clone(), slots.review.clone(), reports);
                self.reviewer.get_or_insert_with(start).send(command);
            }
            (order, None) => log::warn!("nobody can do this without a world model: {order:?}"),
        }
    }

    fn change_world(&mut self, model: &Parameters) {
        self.forget();
        dismiss(&mut self.dreamer, &mut self.dismissed);
        // These need no model: only after a bug is there another.
        if self.recorder.as_ref().is_some_and(Worker::is_over) {
            self.recorder = None;
        }
        if self.librarian.as_ref().is_some_and(Worker::is_over) {
            self.librarian = None;
        }
        if self.modeler.as_ref().is_some_and(Worker::is_over) {
            self.modeler = None;
        }
        self.model = Some(model.clone());
    }

    fn forget(&mut self) {
        dismiss(&mut self.clipper, &mut self.dismissed);
        dismiss(&mut self.screener, &mut self.dismissed);
        dismiss(&mut self.synthesizer, &mut self.dismissed);
        dismiss(&mut self.trainer, &mut self.dismissed);
        dismiss(&mut self.driver, &mut self.dismissed);
        dismiss(&mut self.reviewer, &mut self.dismissed);
    }

    fn slots(&self) -> Slots {
        self.slots.clone()
    }
}
