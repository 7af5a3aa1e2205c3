//! What a hand feels while a reward trains: egui's CPU time for a frame of each panel, and the pace of a dream.
//!
//! The real window without a screen, the shipped world model and the example session; what a frame costs on the
//! graphics card is not in it. Times are of the window's thread alone, so that other work changes them little.
#![expect(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a bench that cannot be set up ends, and one that ran says so"
)]

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use dropj::app::{FirstWorld, Panel, Startup};
use dropj::dream::DreamEpisode;
use dropj::planner::PlannerConfig;
use dropj::planner::synthesis::SynthesisConfig;
use dropj::reward::RewardConfig;
use dropj::session::{DreamSource, Header, LoadedSession, SessionStore};
use dropj::tensor::{Backend, Parameters, from_slice};
use dropj::ui::{NoPads, Window, WindowStartup};
use dropj::worker::{
    DreamStart, Job, LoadedWorld, Report, Reports, RewardReport, Slots, Threads, TrainerCommand,
    WorkerConfig, Workers, trainer,
};
use dropj::world::Action;
use dropj::world::WorldSpec;
use dropj::world::cars::{Aids, CarWorld};
use dropj::world_model::fit::FitConfig;
use dropj::world_model::{LatentState, WorldModel, WorldModelConfig};
use eframe::egui::{Key, vec2};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable as _;

/// Frames of each panel.
const N_FRAMES: usize = 300;
/// Dreams of the session that is opened, each of a thousand steps.
const N_DREAMS: u64 = 200;
/// The least time between two, as on a screen of 60 Hz.
const FRAME: Duration = Duration::from_millis(16);

fn main() {
    tch::set_num_threads(1);
    let dir = tempfile::tempdir().unwrap();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let session = dir.path().join("example");
    copy(&root.join("sessions/example"), &session);
    let world = root.join("assets/world-car-racing.safetensors");
    let is_over = Arc::new(AtomicBool::new(false));
    let n_fits = Arc::new(AtomicUsize::new(0));

    let began = Instant::now();
    let (mut harness, slots) = window(dir.path(), &session, &world);
    harness.step();
    println!("first frame after {:.0} ms", began.elapsed().as_secs_f64() * 1e3);
    while harness.query_by_label("Begin").is_none() || harness.state().app().open().is_none() {
        harness.step();
        std::thread::sleep(FRAME);
    }
    println!(
        "usable after {:.0} ms, the world model being read meanwhile",
        began.elapsed().as_secs_f64() * 1e3
    );

    opening(&mut harness, dir.path());
    let fitting = {
        let (is_over, n_fits, session, world) =
            (is_over.clone(), n_fits.clone(), session.clone(), world.clone());
        Job::begin("fitting", || (), move || keep_fitting(&session, &world, &is_over, &n_fits))
    };
    while n_fits.load(Ordering::Relaxed) == 0 {
        std::thread::sleep(FRAME);
    }
    println!(
        "\n{:12} {:>8} {:>8} {:>8}   CPU ms a frame, {N_FRAMES} frames, a reward being fitted",
        "panel", "median", "p99", "most"
    );
    for panel in Panel::ALL {
        harness.get_by_label(panel.name()).click();
        harness.run_steps(3);
        if matches!(panel, Panel::Dream | Panel::Deploy) {
            harness.key_press(Key::Enter);
            harness.run_steps(2);
        }
        measure(&mut harness, &slots, panel);
        if panel == Panel::Deploy {
            harness.key_press(Key::Escape);
            harness.run_steps(2);
        }
    }
    is_over.store(true, Ordering::Relaxed);
    while !fitting.is_over() {
        std::thread::sleep(FRAME);
    }
    println!("fits meanwhile: {}", n_fits.load(Ordering::Relaxed));
}

/// Opens a session of many dreams, and says how long the window stood still for it.
fn opening(harness: &mut Harness<'_, Window>, sessions: &Path) {
    let dir = sessions.join("long");
    let header = Header { created_at: 0, ..harness.state().app().open().unwrap().header().clone() };
    let mut store = SessionStore::create(&dir, header).unwrap();
    let start = LatentState { z: vec![0.0; 32], c: vec![0.0; 256], h: vec![0.0; 256] };
    for seed in 0..N_DREAMS {
        let mut dream = DreamEpisode::new(start.clone(), seed);
        for t in 0..1000 {
            dream.zs.push(&[(seed as f32 + 0.01 * t as f32).sin(); 32]);
            dream.actions.push(Action::new([0.0; 3]));
        }
        store.save_dream(&dream, DreamSource::User).unwrap();
    }
    drop(store);
    let began = Instant::now();
    let store = SessionStore::open(&dir, None).unwrap();
    drop(LoadedSession::read(store, &mut |_, _| ControlFlow::Continue(())).unwrap());
    let at_once = began.elapsed();

    harness.get_by_label("Sessions…").click();
    harness.run_steps(10);
    while harness.query_by_label("long").is_none() {
        std::thread::sleep(FRAME);
        harness.step();
    }
    harness.get_by_label("long").click();
    let (began, mut longest) = (Instant::now(), (Duration::ZERO, 0));
    let is_open = |harness: &Harness<'_, Window>| harness.state().app().open().unwrap().dir() == dir;
    while !is_open(harness) {
        let (frame, cpu) = (Instant::now(), cpu_nanos());
        harness.step();
        longest = (longest.0.max(frame.elapsed()), longest.1.max(cpu_nanos() - cpu));
        std::thread::sleep(FRAME.saturating_sub(frame.elapsed()));
    }
    println!(
        "a session of {N_DREAMS} dreams is open after {:.0} ms; the longest picture meanwhile took {:.1} ms, {:.1} of them on \
         a core; reading it at once takes {:.0} ms",
        began.elapsed().as_secs_f64() * 1e3,
        longest.0.as_secs_f64() * 1e3,
        longest.1 as f64 / 1e6,
        at_once.as_secs_f64() * 1e3
    );
}

/// Draws `panel` again and again, and says what that cost.
fn measure(harness: &mut Harness<'_, Window>, slots: &Slots, panel: Panel) {
    let mut costs = Vec::new();
    let mut pace = None;
    for _ in 0..N_FRAMES {
        let began = Instant::now();
        if let Some(view) = slots.dream.peek() {
            pace = Some((view.steps_per_sec, view.n_late, view.step));
        }
        let before = cpu_nanos();
        harness.step();
        let drawn = cpu_nanos() - before;
        let shapes = harness.output().shapes.clone();
        let before = cpu_nanos();
        let meshes = harness.ctx.tessellate(shapes, 1.0);
        costs.push((drawn + cpu_nanos() - before) as f64 / 1e6);
        drop(meshes);
        std::thread::sleep(FRAME.saturating_sub(began.elapsed()));
    }
    costs.sort_by(f64::total_cmp);
    let (median, p99, most) = (costs[N_FRAMES / 2], costs[N_FRAMES * 99 / 100], costs[N_FRAMES - 1]);
    println!("{:12} {median:8.2} {p99:8.2} {most:8.2}", panel.name());
    if let (Panel::Dream, Some((rate, n_late, step))) = (panel, pace) {
        println!("{:12} {rate:8.1} steps a second, {n_late} of {step} late", "  the dream");
    }
}

/// Nanoseconds that this thread was on a core.
///
/// The kernel counts them up to the last time that it looked, which yielding makes it do.
fn cpu_nanos() -> u64 {
    std::thread::yield_now();
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    text.split_whitespace().next().unwrap().parse().unwrap()
}

fn window(dir: &Path, session: &Path, world: &Path) -> (Harness<'static, Window>, Slots) {
    let config = WorkerConfig {
        open: Arc::new(|_| Ok(Box::new(CarWorld::open("car-racing", Aids::NONE).expect("it is built in")))),
        spec: Arc::new(WorldSpec::default()),
        world: WorldModelConfig::car_racing(),
        fit: FitConfig::full(),
        reward: RewardConfig::car_racing(),
        planner: PlannerConfig::car_racing(),
        backend: Backend::cpu(),
        synthesis: SynthesisConfig::paper(),
        load: Arc::new(|path| Ok(load(path))),
    };
    let (share, shared) = std::sync::mpsc::channel();
    let app = Startup {
        spec: Arc::new(WorldSpec::default()),
        spec_file: None,
        sessions: dir.to_owned(),
        dataset: dir.join("data"),
        world: FirstWorld::In(world.to_owned()),
        session: Some(SessionStore::open(session, None).unwrap()),
        seed: 1,
    };
    let workers = Box::new(move |wake| -> Box<dyn Workers> {
        let threads = Threads::new(config, None, wake);
        share.send(threads.slots()).unwrap();
        Box::new(threads)
    });
    let startup = WindowStartup { app, workers, input: Box::new(NoPads) };
    let builder = Harness::builder().with_size(vec2(1280.0, 720.0)).with_step_dt(FRAME.as_secs_f32());
    let harness = builder.build_eframe(|cc| Window::new(cc, startup));
    (harness, shared.recv().unwrap())
}

fn load(path: &Path) -> LoadedWorld {
    let model = model(path);
    let starts = model.starts().iter().enumerate().map(|(i, state)| DreamStart {
        name: format!("Start {}", i + 1),
        picture: model.decode(&from_slice(&state.z, &[1, -1])).pop(),
        state: state.clone(),
    });
    let starts = starts.collect();
    let (name, parameters) = ("the shipped one".to_owned(), model.parameters().clone());
    LoadedWorld { name, path: None, parameters, card: Vec::new(), starts, compact: None }
}

fn model(path: &Path) -> WorldModel {
    WorldModel::load(Parameters::from_bytes(std::fs::read(path).unwrap()).unwrap()).unwrap()
}

/// Fits the answers of the session over and over, as a person would who never stops answering.
fn keep_fitting(session: &Path, world: &Path, is_over: &AtomicBool, n_fits: &AtomicUsize) {
    let (state, _) = SessionStore::read_reward(session).unwrap();
    let (reports, inbox) = Reports::new(|| ());
    let trainer = trainer::spawn(model(world).parameters().clone(), RewardConfig::car_racing(), &reports);
    for (id, _) in state.dream_lens() {
        let bytes = std::fs::read(session.join(&state.dreams()[id.0 as usize].file)).unwrap();
        let dream = dropj::session::arrays::dream_from_bytes(&bytes).unwrap();
        trainer.send(TrainerCommand::AddDream(id, Arc::new(dream)));
    }
    for labeled in state.labeled() {
        trainer.send(TrainerCommand::Learn(labeled.query, labeled.label));
    }
    let mut seed = 0;
    while !is_over.load(Ordering::Relaxed) {
        trainer.send(TrainerCommand::Fit { seed });
        seed += 1;
        while let Ok(report) = inbox.recv() {
            if matches!(report, Report::Reward(RewardReport::Learned { fit: Some(_), .. })) {
                n_fits.fetch_add(1, Ordering::Relaxed);
                break;
            }
        }
    }
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let target = to.join(path.file_name().unwrap());
        if path.is_dir() {
            copy(&path, &target);
        } else {
            std::fs::copy(&path, &target).unwrap();
        }
    }
}
