//! The window without a screen: what labels and keys do, and a few pictures of it.

#![expect(
    clippy::unwrap_used,
    clippy::print_stderr,
    reason = "a test that cannot be set up fails, and one that is skipped says so"
)]

mod query_selection;
mod cockpit;
mod worlds;
mod predictions;
mod journeys;
mod keys;
mod labeling;
mod looks;
mod merge;
mod trajectories;
mod opening;
mod saving;
mod seen;
mod episodes;
mod first_hour;
mod evaluate;

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use dropj::app::{FirstWorld, Panel, Startup};
use dropj::dream::DreamEpisode;
use dropj::planner::PlannerConfig;
use dropj::planner::synthesis::SynthesisConfig;
use dropj::query::{Preference, Protocol, QueryId, Response, SEGMENT_LEN, SafetyAnswer, SkipReason, Verdict};
use dropj::reward::RewardConfig;
use dropj::session::{DreamSource, Header, SessionStore};
use dropj::tensor::Backend;
use dropj::ui::{InputSource, PadButton, PadEvent, Wake, Window, WindowStartup};
use dropj::worker::{
    ClipperCommand, DeployReport, DreamReport, DreamStart, DreamerCommand, EvaluateReport, LabelReport,
    LiveAction, LiveView, LoadedWorld, RecordReport, RecorderCommand, Report, RewardReport, SessionWriter,
    Slots, Threads, TrainerCommand, WorkerCommand, WorkerConfig, WorkerError, WorkerFailure, WorkerName,
    Workers,
};
use dropj::world::cars::{Aids, CarWorld};
use dropj::world::controls::Pad;
use dropj::world::{Action, Frame, WorldSpec};
use dropj::world_model::fit::FitConfig;
use dropj::world_model::{LatentState, WorldModelConfig, untrained};
use eframe::Storage;
use eframe::egui::{Event, Key, Vec2, vec2};
use egui_kittest::kittest::{NodeT as _, Queryable as _};
use egui_kittest::{Harness, SnapshotOptions};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

/// The software renderer paints a pixel or two at the rim of a shape otherwise on another processor.
const N_OTHER_PIXELS: usize = 8;

/// What a test holds on to: what was sent to workers, how to report, and the pad's next events.
///
/// The session is written for real, at once and in this thread; files are read for real, in threads of their own.
#[derive(Clone)]
struct Backstage {
    /// Whether clips are decoded as soon as they are asked for.
    draws: Arc<AtomicBool>,
    orders: Arc<Mutex<Vec<WorkerCommand>>>,
    reports: Arc<Mutex<Vec<Report>>>,
    writer: Arc<Mutex<SessionWriter>>,
    jobs: Arc<Mutex<Option<Threads>>>,
    pad: Arc<Mutex<Vec<PadEvent>>>,
    slots: Slots,
}

impl Default for Backstage {
    fn default() -> Self {
        Self {
            draws: Arc::new(AtomicBool::new(true)),
            orders: Arc::default(),
            reports: Arc::default(),
            writer: Arc::default(),
            jobs: Arc::default(),
            pad: Arc::default(),
            slots: Slots::default(),
        }
    }
}

impl Backstage {
    fn report(&self, report: Report) {
        self.reports.lock().unwrap().push(report);
    }

    /// What was sent since the last time.
    fn orders(&self) -> Vec<WorkerCommand> {
        std::mem::take(&mut *self.orders.lock().unwrap())
    }

    /// The same, but for looking into the folder of recordings.
    fn orders_but_lists(&self) -> Vec<WorkerCommand> {
        let mut orders = self.orders();
        orders.retain(|order| !matches!(order, WorkerCommand::EpisodeBrowser(_)));
        orders
    }

    fn given(&self) -> Action {
        self.slots.action.peek().map_or_else(Action::default, |(action, _)| action)
    }
}

impl Workers for Backstage {
    fn send(&mut self, command: WorkerCommand) {
        match command {
            WorkerCommand::SessionWriter(command) => {
                self.writer
                    .lock()
                    .unwrap()
                    .handle(command, &mut |report| self.report(Report::Session(report)));
            }
            WorkerCommand::Jobs(_) => self.jobs.lock().unwrap().as_mut().unwrap().send(command),
            WorkerCommand::EndSession | WorkerCommand::UseWorldModel(_) | WorkerCommand::Previewer(_) => {}
            command => {
                if let WorkerCommand::Clipper(ClipperCommand::Decode(query)) = &command
                    && self.draws.load(Ordering::Relaxed)
                {
                    let clip = |shade: usize| (0..SEGMENT_LEN).map(|t| frame(shade + 6 * t)).collect();
                    let (query, left, right) = (*query, clip(40), clip(100));
                    self.report(Report::Label(LabelReport::Clips { query, left, right }));
                }
                self.orders.lock().unwrap().push(command);
            }
        }
    }

    fn poll(&mut self) -> Vec<Report> {
        self.writer.lock().unwrap().check(&mut |report| self.report(Report::Session(report)));
        let mut reports = std::mem::take(&mut *self.reports.lock().unwrap());
        reports.extend(self.jobs.lock().unwrap().as_mut().unwrap().poll());
        let slots = &self.slots;
        reports.extend(slots.dream.take().map(|view| Report::Dream(DreamReport::View(view))));
        reports.extend(slots.record.take().map(|view| Report::Record(RecordReport::View(view))));
        reports.extend(slots.rollout.take().map(|view| Report::Record(RecordReport::Rollout(view))));
        reports.extend(slots.episode.take().map(|view| Report::Record(RecordReport::EpisodeView(view))));
        reports.extend(slots.review.take().map(|view| Report::Dream(DreamReport::Review(view))));
        reports.extend(slots.replay.take().map(|view| Report::Evaluate(EvaluateReport::View(view))));
        reports.extend(slots.drive.take().map(|view| Report::Deploy(DeployReport::View(view))));
        reports
    }

    fn action(&self) -> LiveAction {
        self.slots.action.clone()
    }
}

impl InputSource for Backstage {
    fn poll(&mut self) -> Vec<PadEvent> {
        std::mem::take(&mut *self.pad.lock().unwrap())
    }
}

/// A road of gray in something green, as wide as `shade` is bright.
fn frame(shade: usize) -> Frame {
    let side = 24;
    let pixel = |i: usize| {
        let (x, y) = (i % side, i / side);
        let is_road = x.abs_diff(side / 2) < 3 + (y + shade / 16) % 6;
        if is_road { [shade as u8; 3] } else { [60, 130, 70] }
    };
    Frame::square(side as u32, (0..side * side).flat_map(pixel).collect::<Vec<_>>())
}

fn world() -> LoadedWorld {
    toy(0)
}

/// A world model that has learned nothing, drawn from `seed`.
fn toy(seed: u64) -> LoadedWorld {
    let model = untrained(&WorldModelConfig::tiny(), &mut ChaCha8Rng::seed_from_u64(seed));
    let state = LatentState { z: vec![0.1; 4], c: vec![0.0; 16], h: vec![0.0; 16] };
    let start = |i: usize| DreamStart {
        name: format!("Start {i}"),
        state: state.clone(),
        picture: Some(frame(60 * i)),
    };
    LoadedWorld {
        name: "Toy".to_owned(),
        path: None,
        parameters: model.parameters().clone(),
        card: vec![("Learned from".to_owned(), "nothing".to_owned())],
        starts: (1..4).map(start).collect(),
        compact: Some("compact.safetensors".into()),
    }
}

fn dream(n: usize) -> DreamEpisode {
    let start = LatentState { z: vec![0.1; 4], c: vec![0.0; 16], h: vec![0.0; 16] };
    let mut episode = DreamEpisode::new(start, 7);
    for _ in 0..n {
        episode.zs.push(&[0.1; 4]);
        episode.actions.push(Action::new([0.0; 3]));
    }
    episode
}

/// A session with two dreams.
fn session(dir: &Path, protocol: Protocol) -> SessionStore {
    let header = Header::new("dummy-road", protocol, 5, &world().parameters.hash(), 1_795_342_500_000);
    let mut store = SessionStore::create(&dir.join("2026-11-22T10-15-00-test"), header).unwrap();
    store.save_dream(&dream(200), DreamSource::User).unwrap();
    store.save_dream(&dream(90), DreamSource::User).unwrap();
    store
}

fn window(
    dir: &Path,
    session: Option<SessionStore>,
    size: Vec2,
    picture: bool,
) -> (Harness<'static, Window>, Backstage) {
    window_with(dir, session, size, picture, None)
}

/// A window of somebody who has used one before.
fn window_with(
    dir: &Path,
    session: Option<SessionStore>,
    size: Vec2,
    picture: bool,
    storage: Option<&'static dyn Storage>,
) -> (Harness<'static, Window>, Backstage) {
    window_at(dir, session, size, picture, storage, 1.0)
}

/// The same on a screen of another scale.
fn window_at(
    dir: &Path,
    session: Option<SessionStore>,
    size: Vec2,
    picture: bool,
    storage: Option<&'static dyn Storage>,
    scale: f32,
) -> (Harness<'static, Window>, Backstage) {
    window_of(Arc::default(), dir, session, size, picture, storage, scale)
}

/// The same about another world.
fn window_of(
    spec: Arc<WorldSpec>,
    dir: &Path,
    session: Option<SessionStore>,
    size: Vec2,
    picture: bool,
    storage: Option<&'static dyn Storage>,
    scale: f32,
) -> (Harness<'static, Window>, Backstage) {
    let backstage = Backstage::default();
    let has_session = session.is_some();
    let startup = startup_of(spec, dir, session, &backstage);
    let builder = Harness::builder().with_size(size).with_step_dt(0.04).with_pixels_per_point(scale);
    let options = SnapshotOptions::new().max_failed_pixels(N_OTHER_PIXELS);
    let builder = builder.with_options(options);
    let builder = if picture { builder.with_render_cursor(false).wgpu() } else { builder };
    let mut harness = builder.build_eframe(|cc| {
        cc.storage = storage;
        Window::new(cc, startup)
    });
    harness.run_steps(2);
    if has_session {
        wait_for(&mut harness, |harness| harness.state().app().open().is_some());
        harness.run_steps(1);
    }
    (harness, backstage)
}

/// Draws until something has come that a thread is working on.
fn wait_for(harness: &mut Harness<'_, Window>, is_there: impl Fn(&Harness<'_, Window>) -> bool) {
    let since = std::time::Instant::now();
    while !is_there(harness) {
        assert!(since.elapsed().as_secs() < 30, "it never came");
        std::thread::sleep(std::time::Duration::from_millis(1));
        harness.step();
    }
}

/// What a window in a test begins with.
fn startup(dir: &Path, session: Option<SessionStore>, backstage: &Backstage) -> WindowStartup {
    startup_of(Arc::default(), dir, session, backstage)
}

/// What a window about a world begins with.
fn startup_of(
    spec: Arc<WorldSpec>,
    dir: &Path,
    session: Option<SessionStore>,
    backstage: &Backstage,
) -> WindowStartup {
    let inner = backstage.clone();
    let app = Startup {
        spec,
        spec_file: None,
        sessions: dir.to_owned(),
        dataset: "recordings".into(),
        world: FirstWorld::Here(Ok(Box::new(world()))),
        session,
        seed: 1,
    };
    let workers = move |wake: Wake| -> Box<dyn Workers> {
        *inner.jobs.lock().unwrap() = Some(Threads::new(worker_config(), None, wake));
        Box::new(inner)
    };
    WindowStartup { app, workers: Box::new(workers), input: Box::new(backstage.clone()) }
}

/// What a worker reports that has met this, and lives on.
fn failed(worker: WorkerName, message: &str) -> Report {
    let error = WorkerError::Met(Arc::new(std::io::Error::other(message.to_owned())));
    Report::Failed(WorkerFailure { worker, error })
}

/// Those who read files.
fn worker_config() -> WorkerConfig {
    WorkerConfig {
        open: Arc::new(|_| Ok(Box::new(CarWorld::open("car-racing", Aids::NONE).unwrap()))),
        spec: Arc::default(),
        world: WorldModelConfig::car_racing(),
        fit: FitConfig::full(),
        reward: RewardConfig::car_racing(),
        planner: PlannerConfig::of(&WorldSpec::default(), None),
        backend: Backend::cpu(),
        synthesis: SynthesisConfig::paper(),
        load: Arc::new(|path| match std::fs::read_to_string(path) {
            Ok(text) if text == "another" => Ok(toy(1)),
            _ => Err(Arc::new(std::io::Error::other(format!("cannot read the world model: {path:?}")))),
        }),
    }
}

/// A window on the label panel of a session.
fn labeling(dir: &Path, protocol: Protocol) -> (Harness<'static, Window>, Backstage) {
    let store = session(dir, protocol);
    let (mut harness, backstage) = window(dir, Some(store), vec2(1280.0, 800.0), false);
    go(&mut harness, Panel::Label);
    backstage.orders();
    (harness, backstage)
}

fn go(harness: &mut Harness<'_, Window>, panel: Panel) {
    harness.get_by_label(panel.name()).click();
    harness.run_steps(3);
}

/// Strikes a key; one that can answer, once the pair on the screen was there for a moment.
fn press(harness: &mut Harness<'_, Window>, key: Key) {
    let answers = [Key::A, Key::D, Key::S, Key::ArrowLeft, Key::ArrowUp, Key::ArrowRight, Key::Space];
    if answers.contains(&key) || [Key::Y, Key::N, Key::F, Key::Q].contains(&key) {
        see(harness);
    }
    harness.key_press(key);
    harness.run_steps(2);
}

/// Looks at the pair on the screen, if there is one, until an answer to it is taken.
fn see(harness: &mut Harness<'_, Window>) {
    for _ in 0..10 {
        if harness.state().app().shown().is_none() || harness.state().app().is_answerable() {
            return;
        }
        harness.step();
    }
}

/// What the session says was answered, in the order of answering.
fn answers(harness: &Harness<'_, Window>) -> Vec<(QueryId, Response)> {
    let session = harness.state().app().open().unwrap().session();
    session.answers().iter().map(|given| (given.answer.query, given.answer.response)).collect()
}

fn responses(harness: &Harness<'_, Window>) -> Vec<Response> {
    answers(harness).into_iter().map(|(_, response)| response).collect()
}

#[test]
fn every_answer_of_dropj_has_one_key() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    let keys = [Key::A, Key::D, Key::S, Key::ArrowLeft, Key::ArrowUp, Key::ArrowRight, Key::Space];
    for key in keys {
        press(&mut harness, key);
    }
    let both = |preference| Response::Safety(SafetyAnswer::Both(preference));
    let expected = [
        Response::Safety(SafetyAnswer::OnlyLeft),
        Response::Safety(SafetyAnswer::OnlyRight),
        Response::Safety(SafetyAnswer::Neither),
        both(Preference::Left),
        both(Preference::Equal),
        both(Preference::Right),
        Response::Skipped(None),
    ];
    assert_eq!(responses(&harness), expected);
}

#[test]
fn every_answer_of_drop_and_drope_has_one_key() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Drope);
    for key in [Key::ArrowLeft, Key::ArrowUp, Key::ArrowRight] {
        press(&mut harness, key);
    }
    let preferred = [Preference::Left, Preference::Equal, Preference::Right].map(Response::Preferred);
    assert_eq!(responses(&harness), preferred);

    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Drop);
    for key in [Key::ArrowUp, Key::ArrowRight] {
        press(&mut harness, key);
    }
    assert_eq!(responses(&harness), [Response::Preferred(Preference::Right)], "DROP knows no equal");
}

#[test]
fn buttons_say_what_their_keys_do() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = labeling(dir.path(), Protocol::Dropj);
    harness.get_by_label("Only left is safe").click();
    harness.run_steps(2);
    assert_eq!(responses(&harness), [Response::Safety(SafetyAnswer::OnlyLeft)]);
    harness.get_by_label("μ = 1: left preferred because right is unsafe");
    let learned = backstage.orders().into_iter().any(|order| {
        matches!(order, WorkerCommand::Trainer(TrainerCommand::Learn(query, label)) if query.id == QueryId(0) && label.mu() == 1.0)
    });
    assert!(learned, "the trainer was not told");
}

#[test]
fn the_next_pair_is_there_in_the_frame_after_an_answer() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = labeling(dir.path(), Protocol::Dropj);
    see(&mut harness);
    harness.key_down(Key::A);
    harness.step();
    assert_eq!(harness.state().app().shown(), Some(QueryId(1)), "in the picture after this one");
    harness.key_up(Key::A);
    harness.step();
    press(&mut harness, Key::D);
    assert_eq!(answers(&harness).len(), 2);
    let n_decoded = |orders: Vec<WorkerCommand>| {
        orders
            .iter()
            .filter(|order| matches!(order, WorkerCommand::Clipper(ClipperCommand::Decode(_))))
            .count()
    };
    assert_eq!(n_decoded(backstage.orders()), 2, "as many are drawn ahead as were answered");
}

#[test]
fn undo_has_no_limit_and_shows_the_query_again() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = labeling(dir.path(), Protocol::Dropj);
    for key in [Key::A, Key::S, Key::D] {
        press(&mut harness, key);
    }
    for _ in 0..3 {
        press(&mut harness, Key::Backspace);
    }
    assert_eq!(answers(&harness), [], "all are taken back");
    assert!(
        backstage
            .orders()
            .iter()
            .any(|order| matches!(order, WorkerCommand::Trainer(TrainerCommand::Forget(QueryId(0))))),
        "the trainer forgets the first answer",
    );
    press(&mut harness, Key::D);
    assert_eq!(answers(&harness), [(QueryId(0), Response::Safety(SafetyAnswer::OnlyRight))]);
}

#[test]
fn a_skip_can_be_given_a_reason_and_one_undo_takes_back_both() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    press(&mut harness, Key::Space);
    press(&mut harness, Key::Num1);
    assert_eq!(responses(&harness), [Response::Skipped(Some(SkipReason::Hallucinated))]);
    press(&mut harness, Key::Backspace);
    assert_eq!(responses(&harness), []);
}

#[test]
fn the_guided_questions_come_one_at_a_time() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    press(&mut harness, Key::G);
    harness.run_steps(2);
    harness.get_by_label("Does the left clip stay safe?");
    press(&mut harness, Key::Y);
    harness.get_by_label("Does the right clip stay safe?");
    press(&mut harness, Key::N);
    assert_eq!(responses(&harness), [Response::Safety(SafetyAnswer::OnlyLeft)]);

    press(&mut harness, Key::Y);
    press(&mut harness, Key::Y);
    harness.get_by_label("Both are safe. Which is better?");
    press(&mut harness, Key::ArrowRight);
    assert_eq!(responses(&harness)[1], Response::Safety(SafetyAnswer::Both(Preference::Right)));

    press(&mut harness, Key::Y);
    press(&mut harness, Key::Backspace);
    harness.get_by_label("Does the left clip stay safe?");
    assert_eq!(answers(&harness).len(), 2, "undo went back by one question only");
}

#[test]
fn a_preference_rests_on_the_justification_that_was_named() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::DropjMulti);
    press(&mut harness, Key::Num1);
    press(&mut harness, Key::ArrowLeft);
    press(&mut harness, Key::ArrowLeft);
    let all = harness.state().app().open().unwrap().session().weights().justifications.clone();
    let grass = all.named("grass").unwrap();
    let expected = [grass, all.default()].map(|why| Response::Justified(why.into(), Preference::Left));
    assert_eq!(responses(&harness), expected, "and the default counts where none was named");
}

#[test]
fn a_pad_answers_too() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = labeling(dir.path(), Protocol::Dropj);
    for button in [PadButton::LeftShoulder, PadButton::Right, PadButton::East, PadButton::Back] {
        see(&mut harness);
        backstage.pad.lock().unwrap().push(PadEvent::Pressed(button));
        harness.run_steps(2);
    }
    let right = Response::Safety(SafetyAnswer::Both(Preference::Right));
    assert_eq!(responses(&harness), [Response::Safety(SafetyAnswer::OnlyLeft), right]);
}

#[test]
fn an_answer_is_on_disk_before_the_next_query_shows() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    press(&mut harness, Key::A);
    let folder = harness.state().app().open().unwrap().dir().to_owned();
    let log = std::fs::read_to_string(folder.join("events.jsonl")).unwrap();
    assert!(log.lines().last().unwrap().contains("\"asked\"") || log.contains("only_left"), "{log}");
    assert!(log.contains("only_left"), "{log}");
}

/// A dream that has begun.
fn dreaming(dir: &Path) -> (Harness<'static, Window>, Backstage) {
    let (mut harness, backstage) = window(dir, None, vec2(1280.0, 800.0), false);
    assert_eq!(harness.state().app().state().panel(), Panel::Dream, "one can drive at once");
    press(&mut harness, Key::Enter);
    let orders = backstage.orders();
    let started = orders.iter().find_map(|order| match order {
        WorkerCommand::Dreamer(DreamerCommand::Start { journal, .. }) => Some(journal.is_some()),
        _ => None,
    });
    assert_eq!(started, Some(true), "it has begun, and is journaled");
    (harness, backstage)
}

#[test]
fn held_keys_drive_until_they_are_released() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = dreaming(dir.path());
    harness.key_down(Key::ArrowLeft);
    harness.key_down(Key::W);
    harness.run_steps(3);
    assert_eq!(backstage.given(), Action::new([-1.0, 1.0, 0.0]));
    harness.key_up(Key::ArrowLeft);
    harness.run_steps(1);
    assert_eq!(backstage.given(), Action::new([0.0, 1.0, 0.0]));
}

#[test]
fn losing_the_focus_lets_go_of_all_keys() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = dreaming(dir.path());
    harness.key_down(Key::ArrowUp);
    harness.run_steps(2);
    assert_eq!(backstage.given()[1], 1.0);
    harness.event(Event::WindowFocused(false));
    harness.run_steps(2);
    assert_eq!(backstage.given(), [0.0; 3]);
}

#[test]
fn unplugging_a_pad_lets_go_of_it_and_says_so() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = dreaming(dir.path());
    let pad = Pad { stick: 1.0, right_trigger: 1.0, ..Pad::default() };
    let name = || "Test pad".to_owned();
    backstage.pad.lock().unwrap().extend([PadEvent::Connected(name()), PadEvent::Moved(pad)]);
    harness.run_steps(2);
    assert_eq!(backstage.given(), Action::new([1.0, 1.0, 0.0]));
    backstage.pad.lock().unwrap().push(PadEvent::Disconnected(name()));
    harness.run_steps(2);
    assert_eq!(backstage.given(), [0.0; 3]);
    harness.get_by_label_contains("Test pad was unplugged");
}

#[test]
fn a_dream_is_kept_with_one_key_and_redone_with_another() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = dreaming(dir.path());
    press(&mut harness, Key::R);
    let orders = backstage.orders();
    let [
        WorkerCommand::Dreamer(DreamerCommand::Discard),
        WorkerCommand::Dreamer(DreamerCommand::Start { journal, .. }),
    ] = &orders[..]
    else {
        panic!("{orders:?}")
    };
    assert!(journal.is_some(), "the second dream has a journal too");
    press(&mut harness, Key::N);
    assert!(
        matches!(backstage.orders()[..], [WorkerCommand::Dreamer(DreamerCommand::Finish)]),
        "it is asked to end"
    );
    backstage.report(Report::Dream(DreamReport::Ended { episode: dream(60), journal: None }));
    harness.run_steps(2);
    let session = harness.state().app().open().unwrap().session();
    assert_eq!(session.dreams().len(), 1);
    assert_eq!(session.protocol(), Protocol::Dropj, "the first dream begins a session");
}

#[test]
fn a_dream_shorter_than_a_segment_is_not_kept_and_says_why() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = dreaming(dir.path());
    backstage.report(Report::Dream(DreamReport::Ended { episode: dream(12), journal: None }));
    harness.run_steps(2);
    assert_eq!(harness.state().app().open().unwrap().session().dreams().len(), 0);
    harness.get_by_label_contains("a segment needs 20");
}

#[test]
fn a_machine_that_does_not_keep_the_pace_is_offered_the_compact_world_model() {
    for (n_late, is_offered) in [(6, false), (40, true)] {
        let dir = tempfile::tempdir().unwrap();
        let (mut harness, backstage) = dreaming(dir.path());
        press(&mut harness, Key::R);
        let seed = backstage.orders().into_iter().find_map(|order| match order {
            WorkerCommand::Dreamer(DreamerCommand::Start { seed, .. }) => Some(seed),
            _ => None,
        });
        backstage.slots.dream.put(LiveView { n_late, ..view(120) });
        harness.run_steps(1);
        let episode = DreamEpisode { seed: seed.unwrap(), ..dream(120) };
        backstage.report(Report::Dream(DreamReport::Ended { episode, journal: None }));
        harness.run_steps(2);
        assert_eq!(saving::says(&harness, "came late"), is_offered, "{n_late} of 120");
        if is_offered {
            harness.get_by_label("Use the compact one").click();
            // There is no such file here.
            merge::wait_for(&mut harness, "compact.safetensors");
        }
    }
}

#[test]
fn leaving_the_panel_pauses_the_dream() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = dreaming(dir.path());
    backstage.slots.dream.put(view(10));
    harness.run_steps(1);
    go(&mut harness, Panel::Reward);
    assert!(
        matches!(backstage.orders()[..], [WorkerCommand::Dreamer(DreamerCommand::Pause(true))]),
        "nobody drives unseen"
    );
}

fn view(step: usize) -> LiveView {
    LiveView {
        frame: frame(90),
        picture: None,
        step,
        action: Action::new([0.0; 3]),
        steps_per_sec: 50.0,
        pictures_per_sec: 25.0,
        n_late: 0,
        is_paused: false,
        n_unsafe_marks: 0,
        is_planned: false,
        status: None,
    }
}

#[test]
fn recording_uses_the_same_keys() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = window(dir.path(), None, vec2(1280.0, 800.0), false);
    go(&mut harness, Panel::Record);
    backstage.orders();
    press(&mut harness, Key::Enter);
    backstage.slots.record.put(view(10));
    harness.run_steps(1);
    for key in [Key::P, Key::N] {
        press(&mut harness, key);
    }
    let orders = backstage.orders();
    let [
        WorkerCommand::Recorder(RecorderCommand::Start { seed: 1, .. }),
        WorkerCommand::Recorder(RecorderCommand::Pause(true)),
        WorkerCommand::Recorder(RecorderCommand::Keep),
    ] = &orders[..]
    else {
        panic!("{orders:?}")
    };
}

#[test]
fn an_empty_panel_says_what_to_do_and_takes_one_there() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = window(dir.path(), None, vec2(1280.0, 800.0), false);
    go(&mut harness, Panel::Label);
    harness.get_by_label("Go and dream").click();
    harness.run_steps(2);
    assert_eq!(harness.state().app().state().panel(), Panel::Dream);
}

#[test]
fn a_worker_that_fails_is_a_sentence_in_the_window() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = dreaming(dir.path());
    backstage.report(failed(WorkerName::Dreamer, "the journal is full"));
    harness.run_steps(2);
    harness.get_by_label("The journal is full");
    harness.get_by_label("Keep");
    assert!(harness.query_by_label("Restart").is_none(), "the dream goes on");
    let error = WorkerError::Panicked("no message".to_owned());
    backstage.report(Report::Failed(WorkerFailure { worker: WorkerName::Dreamer, error }));
    harness.run_steps(2);
    harness.get_by_label("Begin");
    harness.get_by_label("Restart").click();
    harness.run_steps(2);
    assert!(harness.query_by_label("Restart").is_none(), "what was done about needs no more doing");
}

#[test]
fn controls_have_names() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = labeling(dir.path(), Protocol::Dropj);
    for panel in Panel::ALL {
        go(&mut harness, panel);
        let nameless = harness.root().children_recursive().filter(|node| {
            use eframe::egui::accesskit::Role;
            let node = node.accesskit_node();
            matches!(node.role(), Role::Button | Role::TextInput | Role::CheckBox | Role::Image)
                && node.label().is_none_or(|label| label.is_empty())
        });
        assert_eq!(nameless.count(), 0, "on the panel {panel:?}");
    }
}

#[test]
fn what_a_key_changes_is_drawn_without_waiting_for_another() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = window(dir.path(), None, vec2(1280.0, 800.0), false);
    harness.run_steps(5);
    harness.key_down(Key::Questionmark);
    harness.step();
    let delay = harness.output().viewport_output.values().map(|viewport| viewport.repaint_delay).min();
    assert_eq!(delay, Some(std::time::Duration::ZERO), "a picture of what changed is asked for");
}
