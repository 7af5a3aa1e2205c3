//! What an annotator waits for: the time from a key to the next pair on the screen, through the real window with its
//! real threads. The clips are those of the shipped world model; the reward learns from the answers meanwhile.
//!
//! `cargo bench --profile dev --bench labeling`

#![expect(clippy::print_stdout, clippy::unwrap_used, reason = "a bench prints what it measured, or stops")]

use std::io::Write as _;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use dropj::app::{FirstWorld, Panel, Startup};
use dropj::dream::Dream;
use dropj::planner::PlannerConfig;
use dropj::planner::synthesis::SynthesisConfig;
use dropj::query::{Preference, Protocol, Response, SafetyAnswer, sample_queries};
use dropj::reward::RewardConfig;
use dropj::run::read_parameters;
use dropj::session::{Answer, Choice, DreamSource, Event, Header, SessionStore};
use dropj::tensor::Backend;
use dropj::ui::{NoPads, Window, WindowStartup};
use dropj::worker::{LoadedWorld, Threads, WorkerConfig, Workers};
use dropj::world::Action;
use dropj::world::WorldSpec;
use dropj::world::cars::{Aids, CarWorld};
use dropj::world_model::fit::FitConfig;
use dropj::world_model::{WorldModel, WorldModelConfig};
use eframe::egui::{Key, vec2};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable as _;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

/// Answers that are timed one by one.
const N_TIMED: usize = 60;
/// Keys that are hit as fast as they can be.
const N_BURST: usize = 60;
/// Answers of a session that has been going on for long.
const N_OLD: usize = 1000;

fn main() {
    tch::set_num_threads(1);
    let parameters = read_parameters(Path::new("assets/world-car-racing.safetensors")).unwrap();
    let model = WorldModel::load(parameters).unwrap();
    disk();
    for n_old in [0, N_OLD] {
        let dir = tempfile::tempdir().unwrap();
        let store = session(&model, &dir.path().join("session"), n_old);
        println!("\n{n_old} answers in the session, window of 1280 x 720");
        let mut window = window(&model, store, dir.path());
        timed(&mut window);
        burst(&mut window);
    }
}

/// A session of three dreams, and so many answers.
fn session(model: &WorldModel, dir: &Path, n_old: usize) -> SessionStore {
    let rng = &mut ChaCha8Rng::seed_from_u64(0);
    let header = Header::new("car-racing", Protocol::Dropj, 7, &model.hash(), 0);
    let mut store = SessionStore::create(dir, header).unwrap();
    for (seed, start) in (0..3).zip(model.starts()) {
        let mut dream = Dream::new(start, seed);
        (0..300).for_each(|_| {
            dream.step(model, Action::new([0.0, 0.1, 0.0]), rng).expect("numbers stay numbers");
        });
        store.save_dream(&dream.finish(), DreamSource::Simulated).unwrap();
    }
    let lens = store.session().dream_lens();
    let first = store.session().next_query_id();
    for query in sample_queries(&lens, n_old, first, rng) {
        let (left, right) = (query.left, query.right);
        store.record(Event::Asked { query: query.id, left, right, choice: Choice::Uniform }).unwrap();
        let response = Response::Safety(SafetyAnswer::Both(Preference::Left));
        store.record(Event::Answered(Answer::new(query.id, response, 3.0, "bench"))).unwrap();
    }
    store
}

fn window(model: &WorldModel, store: SessionStore, dir: &Path) -> Harness<'static, Window> {
    let config = WorkerConfig {
        open: Arc::new(|_| Ok(Box::new(CarWorld::open("car-racing", Aids::NONE).expect("it is built in")))),
        spec: Arc::new(WorldSpec::default()),
        world: WorldModelConfig::car_racing(),
        fit: FitConfig::full(),
        reward: RewardConfig::car_racing(),
        planner: PlannerConfig::car_racing(),
        backend: Backend::cpu(),
        synthesis: SynthesisConfig::paper(),
        load: Arc::new(|path| unreachable!("nobody loads {path:?}")),
    };
    let app = Startup {
        spec: Arc::new(WorldSpec::default()),
        spec_file: None,
        sessions: dir.to_owned(),
        dataset: dir.join("data"),
        world: FirstWorld::Here(Ok(Box::new(LoadedWorld {
            name: "the shipped one".to_owned(),
            path: None,
            parameters: model.parameters().clone(),
            card: Vec::new(),
            starts: Vec::new(),
            compact: None,
        }))),
        session: Some(store),
        seed: 1,
    };
    let workers = Box::new(|wake| -> Box<dyn Workers> { Box::new(Threads::new(config, None, wake)) });
    let startup = WindowStartup { app, workers, input: Box::new(NoPads) };
    let builder = Harness::builder().with_size(vec2(1280.0, 720.0)).with_render_cursor(false).wgpu();
    let mut harness = builder.build_eframe(|cc| Window::new(cc, startup));
    harness.run_steps(2);
    harness.get_by_label(Panel::Label.name()).click();
    harness.run_steps(2);
    harness
}

/// Draws the window until so many pairs are ready, and the first of them was seen.
fn wait(window: &mut Harness<'_, Window>, n: usize) {
    while window.state().app().n_ready() < n || !window.state().app().is_answerable() {
        std::thread::sleep(Duration::from_millis(2));
        window.step();
    }
}

/// From a key to the picture with the next pair, which is ready.
fn timed(window: &mut Harness<'_, Window>) {
    let (mut to_hear, mut to_disk) = (Vec::new(), Vec::new());
    let (mut to_picture, mut to_pixels, mut of_ours) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..N_TIMED {
        wait(window, 3);
        let before = window.state().app().shown();
        let (began, cpu) = (Instant::now(), cpu());
        window.key_down(Key::A);
        // The picture that hears the key: the answer goes to disk, and once it is there the next pair is chosen.
        window.step();
        to_hear.push(began.elapsed());
        while window.state().app().shown() <= before {
            std::thread::sleep(Duration::from_micros(200));
            window.step();
        }
        to_disk.push(began.elapsed());
        // The picture of the next pair, textures and all.
        window.step();
        to_picture.push(began.elapsed());
        of_ours.push(cpu_since(cpu));
        let image = window.render().unwrap();
        to_pixels.push(began.elapsed());
        assert_eq!(image.width(), 1280, "it is painted");
        window.key_up(Key::A);
        window.step();
    }
    said("key, for which the window stands", &mut to_hear);
    said("key to answer on disk", &mut to_disk);
    said("key to next pair laid out", &mut to_picture);
    said("of which the processor worked for the window", &mut of_ours);
    said("key to next pair in pixels (here painted in software)", &mut to_pixels);
}

/// For how long this thread has been computing, where the system says so: other programs do not count.
fn cpu() -> Duration {
    let times = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let nanos = times.split(' ').next().and_then(|nanos| nanos.parse().ok());
    Duration::from_nanos(nanos.unwrap_or(0))
}

fn cpu_since(before: Duration) -> Duration {
    cpu().saturating_sub(before)
}

/// Keys that are hit as soon as they are taken: how fast can nobody be? The moment for which a pair is to be seen first is
/// none here, for each picture counts for a quarter of a second.
fn burst(window: &mut Harness<'_, Window>) {
    wait(window, 3);
    let (mut waits, mut n_waited) = (Vec::new(), 0);
    let began = Instant::now();
    for _ in 0..N_BURST {
        window.key_down(Key::D);
        window.step();
        window.key_up(Key::D);
        window.step();
        let answered = Instant::now();
        n_waited += usize::from(window.state().app().shown().is_none());
        while window.state().app().shown().is_none() {
            std::thread::sleep(Duration::from_millis(1));
            window.step();
        }
        waits.push(answered.elapsed());
        while !window.state().app().is_answerable() {
            window.step();
        }
    }
    let per_sec = N_BURST as f64 / began.elapsed().as_secs_f64();
    println!(
        "  without a pause: {per_sec:.1} answers a second, {n_waited} of {N_BURST} had to wait for their clips"
    );
    said("that wait", &mut waits);
}

/// What this disk takes for one line: the part of an answer that no program can spare.
fn disk() {
    let mut file = tempfile::tempfile().unwrap();
    let mut times: Vec<_> = (0..50)
        .map(|_| {
            let began = Instant::now();
            file.write_all(&[b'x'; 200]).unwrap();
            file.sync_data().unwrap();
            began.elapsed()
        })
        .collect();
    said("a line to this disk", &mut times);
}

fn said(what: &str, times: &mut [Duration]) {
    times.sort();
    let ms = |at: usize| 1000.0 * times[at].as_secs_f64();
    let n = times.len();
    println!("  {what}: median {:.1} ms, 99th percentile {:.1} ms", ms(n / 2), ms(n * 99 / 100));
}
