//! Lets the planner act in the real world, and shows the plans that it considered.

use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::Instant;

use crate::evaluation::Tally;
use crate::planner::{Agent, PlannerConfig};
use crate::reward::LearnedReward;
use crate::tensor::NotFinite;
use crate::worker::clock::{Allowance, Beat, Clock};
use crate::worker::error::TaskError;
use crate::worker::plan_view::PlanDrawing;
use crate::worker::{
    CandidateView, DeployReport, DriveView, DriverCommand, Latest, OpenError, OpenWorld, Reports, Worker,
    WorkerError, WorkerName, one_thread, picture,
};
use crate::world::{Action, Frame, World};
use crate::world_model::{Placed, WorldModel};

const NAME: WorkerName = WorkerName::Driver;

/// Starts a thread that drives the world that `open` opens by planning in `model`, and shows it in `view`.
pub fn spawn(
    open: OpenWorld,
    model: impl Into<Placed>,
    config: PlannerConfig,
    view: Latest<DriveView>,
    reports: &Reports,
) -> Worker<DriverCommand> {
    let model = model.into();
    Worker::spawn(NAME, reports, move |commands, reports| {
        drive(&commands, &reports, &open, model, config, &view)
    })
}

/// The body of the thread.
pub fn drive(
    commands: &Receiver<DriverCommand>,
    reports: &Reports,
    open: &OpenWorld,
    model: impl Into<Placed>,
    config: PlannerConfig,
    view: &Latest<DriveView>,
) -> Result<(), WorkerError> {
    one_thread();
    let model = WorldModel::load(model)?;
    let config = config.for_model(&model);
    let rate = model.spec().rate;
    let mut driver = Driver {
        open,
        world: None,
        model,
        config,
        reports,
        view,
        clock: Clock::at(rate),
        reward: None,
        waiting: None,
        episode: None,
    };
    loop {
        match driver.clock.wait(commands) {
            Beat::Command(command) => driver.handle(command),
            Beat::Due => driver.tick(),
            Beat::Over => return Ok(()),
        }
    }
}

/// What the thread owns.
struct Driver<'a> {
    open: &'a OpenWorld,
    /// Open once it was driven in. A world that failed is opened anew for the next episode.
    world: Option<Box<dyn World>>,
    model: WorldModel,
    config: PlannerConfig,
    reports: &'a Reports,
    view: &'a Latest<DriveView>,
    clock: Clock,
    reward: Option<LearnedReward>,
    /// The track to drive as soon as there is a reward.
    waiting: Option<u64>,
    episode: Option<Episode>,
}

/// An episode that is being driven.
struct Episode {
    seed: u64,
    agent: Agent,
    /// What is seen now.
    frame: Frame,
    tally: Tally,
    /// What was asked for so far.
    actions: Vec<Action>,
    n_steps: usize,
    plan_ms: f32,
    /// The plan that is being drawn.
    drawing: Option<PlanDrawing>,
    allowance: Allowance,
    /// The plan that was drawn last.
    candidates: Arc<[CandidateView]>,
    chosen: usize,
}

impl Driver<'_> {
    fn handle(&mut self, command: DriverCommand) {
        match command {
            DriverCommand::Reward(parameters) => {
                match LearnedReward::load(&parameters, &self.model) {
                    Ok(reward) => self.reward = Some(reward),
                    Err(e) => return self.reports.fail(NAME, e),
                }
                if let Some(seed) = self.waiting.take() {
                    self.start(seed);
                }
            }
            DriverCommand::Drive { seed } if self.reward.is_some() => self.start(seed),
            DriverCommand::Drive { seed } => self.waiting = Some(seed),
            DriverCommand::Pause(pause) if self.episode.is_some() => {
                if pause {
                    self.clock.stop();
                } else {
                    self.clock.start(Instant::now());
                }
            }
            DriverCommand::Pause(_) => {}
            DriverCommand::Stop => {
                self.clock.stop();
                (self.waiting, self.episode) = (None, None);
            }
        }
    }

    fn start(&mut self, seed: u64) {
        let opened = match self.world.take() {
            Some(world) => Ok(world),
            None => (self.open)(true),
        };
        let reset = opened.and_then(|mut world| {
            let frame = world.reset(seed).map_err(OpenError::World)?;
            Ok((world, frame))
        });
        let (world, frame) = match reset {
            Ok(begun) => begun,
            Err(met) => {
                self.episode = None;
                return self.reports.fail(NAME, WorkerError::from(met).gave_up());
            }
        };
        let tally = Tally::of(&world.spec().events);
        self.clock = Clock::at(world.spec().rate);
        self.world = Some(world);
        let is_sparse = self.reward.as_ref().is_some_and(LearnedReward::is_sparse);
        let config = self.config.clone();
        let config = if is_sparse { config.for_transitions() } else { config };
        self.episode = Some(Episode {
            seed,
            agent: Agent::new(config, seed),
            frame,
            tally,
            actions: Vec::new(),
            n_steps: 0,
            plan_ms: 0.0,
            drawing: None,
            allowance: Allowance::default(),
            candidates: Arc::default(),
            chosen: 0,
        });
        self.clock.start(Instant::now());
    }

    fn tick(&mut self) {
        let (Some(reward), Some(episode), Some(world)) = (&self.reward, &mut self.episode, &mut self.world)
        else {
            return;
        };
        let began = Instant::now();
        self.clock.tick(began);
        let (action, plan) = match episode.agent.act(&self.model, reward, &episode.frame) {
            Ok(driven) => driven,
            Err(met) => return self.give_up(met),
        };
        let plan_secs = plan.map(|_| began.elapsed().as_secs_f64());
        if let Some(plan) = plan {
            // Drawing takes longer than four steps: of the plans made meanwhile nothing is shown.
            if episode.drawing.is_none() && self.view.is_empty() {
                episode.drawing = Some(PlanDrawing::new(plan.clone()));
            }
        }
        episode.plan_ms = plan_secs.map_or(episode.plan_ms, |secs| (secs * 1000.0) as f32);
        let step = match world.step(&action) {
            Ok(step) => step,
            Err(met) => {
                let met = OpenError::World(met);
                (self.world, self.episode) = (None, None);
                self.clock.stop();
                return self.reports.fail(NAME, WorkerError::from(met).gave_up());
            }
        };
        episode.actions.push(action);
        episode.agent.acted(step.executed.unwrap_or(action));
        episode.tally.add(&step, plan_secs);
        episode.n_steps += 1;
        let has_ended = step.end.is_some();
        episode.frame = step.frame;
        self.draw();
        self.show();
        if has_ended {
            self.finish();
        }
    }

    /// Draws candidates while there is time.
    fn draw(&mut self) {
        let Some(episode) = &mut self.episode else { return };
        let Some(mut drawing) = episode.drawing.take() else { return };
        while !drawing.is_done() {
            let left = self.clock.time_left(Instant::now());
            if episode.allowance.spend(left, || drawing.draw_next(&self.model)).is_none() {
                episode.drawing = Some(drawing);
                return;
            }
        }
        (episode.candidates, episode.chosen) = drawing.finish();
    }

    fn show(&self) {
        let Some(episode) = self.episode.as_ref().filter(|_| self.view.is_empty()) else { return };
        let Some(world) = &self.world else { return };
        self.view.put(DriveView {
            frame: episode.frame.clone(),
            picture: picture(world.as_ref(), &episode.frame),
            step: episode.n_steps,
            metrics: episode.tally.metrics(),
            candidates: Arc::clone(&episode.candidates),
            chosen: episode.chosen,
            plan_ms: episode.plan_ms,
            status: world.status(),
        });
        self.reports.wake();
    }

    /// Ends an episode in which nothing can be planned; its figures would be none.
    fn give_up(&mut self, met: NotFinite) {
        self.clock.stop();
        if let Some(Episode { n_steps: step, .. }) = self.episode.take() {
            self.reports.fail(NAME, WorkerError::from(TaskError::DriveEnded { step, met }).gave_up());
        }
    }

    fn finish(&mut self) {
        self.clock.stop();
        if let Some(Episode { seed, tally, actions, .. }) = self.episode.take() {
            let (metrics, actions) = (tally.metrics(), actions.into());
            self.reports.send(DeployReport::Ended { seed, metrics, actions });
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::reward::{RewardConfig, RewardEnsemble};
    use crate::worker::Report;
    use crate::worker::fixtures;

    /// A reward that has learned nothing, over the features of the model with hash `world`.
    fn reward(world: &str) -> DriverCommand {
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        DriverCommand::Reward(RewardEnsemble::new((36, world), RewardConfig::tiny(), rng).parameters())
    }

    fn driver(len: usize, view: &Latest<DriveView>, reports: &Reports) -> Worker<DriverCommand> {
        let model = fixtures::model().parameters().clone();
        spawn(fixtures::wall(len), model, PlannerConfig::car_racing(), view.clone(), reports)
    }

    #[test]
    fn an_episode_in_which_nothing_can_be_planned_ends_without_figures() {
        let (reports, inbox) = Reports::new(|| ());
        let model = fixtures::exploding();
        let config = PlannerConfig::car_racing();
        let hash = model.hash();
        let driver =
            spawn(fixtures::wall(60), model.parameters().clone(), config, Latest::default(), &reports);
        driver.send(reward(&hash));
        driver.send(DriverCommand::Drive { seed: 3 });
        let Report::Failed(failure) = inbox.recv().unwrap() else { panic!("another report") };
        let WorkerError::GaveUp(error) = failure.error else { panic!("{failure:?}") };
        let message = error.to_string();
        assert!(message.starts_with("the drive ended at step ") && message.contains("NaN"), "{message}");
        drop(driver);
        let has_ended = |report| matches!(report, Report::Deploy(DeployReport::Ended { .. }));
        assert!(!inbox.try_iter().any(has_ended), "there are none");
    }

    #[test]
    fn an_episode_begins_with_the_first_reward_and_ends_with_its_figures() {
        let (reports, inbox) = Reports::new(|| ());
        let driver = driver(6, &Latest::default(), &reports);
        driver.send(DriverCommand::Drive { seed: 11 });
        driver.send(reward(&fixtures::model().hash()));
        let Report::Deploy(DeployReport::Ended { seed: 11, metrics, actions }) = inbox.recv().unwrap() else {
            panic!("another report")
        };
        assert_eq!((metrics.n_steps, actions.len()), (6, 6));
    }

    #[test]
    fn whoever_looks_sees_the_candidates() {
        let (reports, _inbox) = Reports::new(|| ());
        let view = Latest::default();
        let driver = driver(1_000_000, &view, &reports);
        driver.send(reward(&fixtures::model().hash()));
        driver.send(DriverCommand::Drive { seed: 0 });
        let seen = loop {
            match view.take() {
                Some(DriveView { candidates, .. }) if candidates.is_empty() => {}
                Some(view) => break view,
                None => std::thread::yield_now(),
            }
        };
        drop(driver);
        assert_eq!((seen.candidates.len(), seen.candidates[seen.chosen].frames.len()), (15, 3));
        assert_eq!(seen.candidates[0].actions, "gas 0.2 for 25");
        assert_eq!(seen.picture.2.len() as u32, 3 * seen.picture.0 * seen.picture.1);
    }

    #[test]
    fn a_reward_of_another_world_and_a_stopped_episode_drive_nothing() {
        let (commands, received) = channel();
        let good = reward(&fixtures::model().hash());
        for command in [reward("sha256:0"), DriverCommand::Drive { seed: 0 }, DriverCommand::Stop, good] {
            commands.send(command).unwrap();
        }
        drop(commands);
        let (reports, inbox) = Reports::new(|| ());
        let model = fixtures::model().parameters().clone();
        drive(
            &received,
            &reports,
            &fixtures::wall(1),
            model,
            PlannerConfig::car_racing(),
            &Latest::default(),
        )
        .unwrap();
        drop(reports);
        let reports: Vec<_> = inbox.iter().collect();
        let [Report::Failed(failure)] = &reports[..] else { panic!("{reports:?}") };
        assert_eq!(failure.worker, WorkerName::Driver);
    }
}
