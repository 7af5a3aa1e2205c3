//! Whoever does the slow work, as the window sees them.

use crate::env::{Aids, Env};
use crate::planner::PlannerConfig;
use crate::reward::RewardConfig;
use crate::tensor::Parameters;
use crate::worker::{
    ClipperCommand, DreamerCommand, DriveView, DriverCommand, Latest, LiveAction, LiveView, ModelerCommand,
    RecorderCommand, Reports, TrainerCommand, Worker, clipper, dreamer, driver, modeler, recorder, trainer,
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
    /// To whoever learns the reward.
    Trainer(TrainerCommand),
    /// To whoever drives by plan.
    Driver(DriverCommand),
    /// To whoever records.
    Recorder(RecorderCommand),
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
    /// What is seen while the planner drives.
    pub drive: Latest<DriveView>,
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
}

/// A thread for each worker, started by the first command that it hears.
pub struct Threads {
    plans: Plans,
    reports: Reports,
    slots: Slots,
    model: Option<Parameters>,
    dreamer: Option<Worker<DreamerCommand>>,
    clipper: Option<Worker<ClipperCommand>>,
    trainer: Option<Worker<TrainerCommand>>,
    driver: Option<Worker<DriverCommand>>,
    recorder: Option<Worker<RecorderCommand>>,
    modeler: Option<Worker<ModelerCommand>>,
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
            trainer: None,
            driver: None,
            recorder: None,
            modeler: None,
        }
    }
}

impl Crew for Threads {
    fn send(&mut self, order: Order) {
        let (plans, reports, slots) = (&self.plans, &self.reports, &self.slots);
        match (order, self.model.clone()) {
            (Order::Recorder(command), _) => {
                let start = || {
                    let view = slots.record.clone();
                    recorder::spawn(
                        (plans.env)(Aids::NONE),
                        &plans.env_name,
                        slots.action.clone(),
                        view,
                        reports,
                    )
                };
                self.recorder.get_or_insert_with(start).send(command);
            }
            (Order::Modeler(command), _) => {
                let start = || modeler::spawn(plans.world.clone(), plans.fit.clone(), reports);
                self.modeler.get_or_insert_with(start).send(command);
            }
            (Order::Dreamer(command), Some(model)) => {
                let start = || dreamer::spawn(model, slots.action.clone(), slots.dream.clone(), reports);
                self.dreamer.get_or_insert_with(start).send(command);
            }
            (Order::Clipper(command), Some(model)) => {
                self.clipper.get_or_insert_with(|| clipper::spawn(model, reports)).send(command);
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
            (order, None) => log::warn!("nobody can do this without a world model: {order:?}"),
        }
    }

    fn change_world(&mut self, model: &Parameters) {
        self.forget();
        (self.dreamer, self.recorder) = (None, None);
        self.model = Some(model.clone());
    }

    fn forget(&mut self) {
        (self.clipper, self.trainer, self.driver) = (None, None, None);
    }

    fn slots(&self) -> Slots {
        self.slots.clone()
    }
}
