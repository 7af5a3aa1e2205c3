//! The real window with its real threads and the shipped world model, drawn by nobody.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use dropj::app::{FirstWorld, Startup};
use dropj::planner::PlannerConfig;
use dropj::planner::synthesis::SynthesisConfig;
use dropj::reward::RewardConfig;
use dropj::run::read_parameters;
use dropj::session::SessionStore;
use dropj::tensor::Backend;
use dropj::tensor::from_slice;
use dropj::ui::{NoPads, Window, WindowStartup};
use dropj::worker::{DreamStart, LoadedWorld, Threads, WorkerConfig};
use dropj::world::WorldSpec;
use dropj::world::cars::{Aids, CarWorld};
use dropj::world_model::fit::FitConfig;
use dropj::world_model::{WorldModel, WorldModelConfig};
use eframe::egui::vec2;
use egui_kittest::Harness;

/// The time from one picture to the next.
pub(crate) const FRAME: Duration = Duration::from_millis(20);

/// A window on `session`, or without one, whose sessions and recordings go to `dir`.
pub(crate) fn real_window(dir: &Path, session: Option<SessionStore>) -> Harness<'static, Window> {
    let world = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/world-car-racing.safetensors");
    let config = WorkerConfig {
        open: Arc::new(|_| Ok(Box::new(CarWorld::open("car-racing", Aids::NONE).unwrap()))),
        spec: Arc::default(),
        world: WorldModelConfig::car_racing(),
        fit: FitConfig::full(),
        reward: RewardConfig::car_racing(),
        planner: PlannerConfig::of(&WorldSpec::default(), None),
        synthesis: SynthesisConfig::paper(),
        load: Arc::new(|path| Ok(load(path))),
        backend: Backend::cpu(),
    };
    let app = Startup {
        spec: Arc::default(),
        spec_file: None,
        sessions: dir.to_owned(),
        dataset: dir.join("recordings"),
        world: FirstWorld::In(world),
        session,
        seed: 1,
    };
    let workers =
        Box::new(|wake| -> Box<dyn dropj::worker::Workers> { Box::new(Threads::new(config, None, wake)) });
    let startup = WindowStartup { app, workers, input: Box::new(NoPads) };
    let builder = Harness::builder().with_size(vec2(1280.0, 820.0)).with_step_dt(FRAME.as_secs_f32());
    builder.build_eframe(|cc| Window::new(cc, startup))
}

fn load(path: &Path) -> LoadedWorld {
    let model = WorldModel::load(read_parameters(path).unwrap()).unwrap();
    let starts = model.starts().iter().enumerate().map(|(i, state)| DreamStart {
        name: format!("Start {}", i + 1),
        picture: model.decode(&from_slice(&state.z, &[1, -1])).pop(),
        state: state.clone(),
    });
    let starts = starts.collect();
    let (name, parameters) = ("the shipped one".to_owned(), model.parameters().clone());
    LoadedWorld { name, path: None, parameters, card: Vec::new(), starts, compact: None }
}
