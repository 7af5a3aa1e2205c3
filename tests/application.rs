//! The application without a window: a whole session is played through it, by commands alone and with the real workers.

#[expect(dead_code, reason = "the road is used, and nobody who answers")]
mod support;

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use dropj::app::{
    App, Command, DeployCommand, DreamCommand, Effect, EvaluateCommand, FirstWorld, LabelCommand,
    MessageKind, Moment, Panel, RewardCommand, SessionCommand, Startup, Tick, WindowCommand,
};
use dropj::planner::PlannerConfig;
use dropj::planner::synthesis::SynthesisConfig;
use dropj::query::{Preference, QueryId, Response, SafetyAnswer};
use dropj::reward::RewardConfig;
use dropj::session::{SessionStore, replay};
use dropj::tensor::Backend;
use dropj::worker::{DreamStart, LoadedWorld, Threads, WorkerConfig, Workers};
use dropj::world::Action;
use dropj::world::World as _;
use dropj::world_model::fit::FitConfig;
use dropj::world_model::{LatentState, WorldModelConfig, untrained};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use support::DummyRoad;

/// The application with its workers, and what a window would do with them.
struct Headless {
    app: App,
    workers: Threads,
    moment: Moment,
}

impl Headless {
    fn new(sessions: &Path) -> Self {
        let world = toy_world();
        let config = WorkerConfig {
            open: Arc::new(|_| Ok(Box::new(DummyRoad::world()))),
            spec: Arc::clone(DummyRoad::world().spec()),
            world: WorldModelConfig::tiny(),
            fit: FitConfig::full(),
            reward: RewardConfig::tiny(),
            planner: PlannerConfig::car_racing(),
            synthesis: SynthesisConfig::paper(),
            load: Arc::new(|path| unreachable!("nobody loads {path:?}")),
            backend: Backend::cpu(),
        };
        let workers = Threads::new(config, Some(&world.parameters), || ());
        let app = App::new(Startup {
            spec: Arc::clone(DummyRoad::world().spec()),
            spec_file: None,
            sessions: sessions.to_owned(),
            dataset: sessions.join("recordings"),
            world: FirstWorld::Here(Ok(Box::new(world))),
            session: None,
            seed: 5,
        });
        Self { app, workers, moment: Moment::default() }
    }

    fn command(&mut self, command: Command) {
        self.picture(Some(command));
    }

    fn step(&mut self) {
        self.picture(None);
    }

    /// What happens in a window from one picture to the next.
    fn picture(&mut self, command: Option<Command>) {
        self.moment = Moment { nr: self.moment.nr + 1, at: self.moment.at + 0.1 };
        let (moment, dt, date) = (self.moment, 0.1, 1_795_342_500_000);
        let tick = Tick { moment, dt, date, has_focus: true, is_touched: true };
        self.app.tick(tick);
        if let Some(command) = command {
            self.app.command(command, moment);
        }
        self.settle();
        self.app.advance(tick);
        self.settle();
        self.app.drawn();
        if self.app.state().panel() == Panel::Dream {
            self.workers.action().put((Action::new([0.2, 0.0, 0.0]), Instant::now()));
        }
    }

    fn settle(&mut self) {
        for effect in self.app.take_effects() {
            match effect {
                Effect::Worker(command) => self.workers.send(command),
                Effect::ReleaseControls => {}
                Effect::OpenDialog(..) | Effect::OpenWorld(_) | Effect::KeepOpen => {
                    panic!("nobody asked for {effect:?}")
                }
            }
        }
        for report in self.workers.poll() {
            self.app.report(report);
        }
    }

    fn wait_for(&mut self, what: &str, is_there: impl Fn(&App) -> bool) {
        let since = Instant::now();
        while !is_there(&self.app) {
            let said: Vec<_> = self.app.state().messages().iter().map(|message| &message.text).collect();
            assert!(since.elapsed().as_secs() < 60, "{what} never came: {said:?}");
            std::thread::sleep(Duration::from_millis(2));
            self.step();
        }
    }

    fn n_dreams(&self) -> usize {
        self.app.open().map_or(0, |open| open.session().dreams().len())
    }

    fn n_answers(app: &App) -> usize {
        app.open().map_or(0, |open| open.session().answers().len())
    }
}

/// A world model that has learned nothing: what is dreamt does not matter here.
fn toy_world() -> LoadedWorld {
    let model = untrained(&WorldModelConfig::tiny(), &mut ChaCha8Rng::seed_from_u64(0));
    let state = LatentState { z: vec![0.1; 4], c: vec![0.0; 16], h: vec![0.0; 16] };
    LoadedWorld {
        name: "Toy".to_owned(),
        path: None,
        parameters: model.parameters().clone(),
        card: Vec::new(),
        starts: vec![DreamStart { name: "Start".to_owned(), state, picture: None }],
        compact: None,
    }
}

#[test]
fn a_session_is_dreamed_labeled_fitted_and_deployed_without_a_window() {
    let dir = tempfile::tempdir().unwrap();
    let mut headless = Headless::new(dir.path());

    for n in 1..=2 {
        headless.command(Command::Dream(DreamCommand::Start));
        headless.wait_for("a dream of a second", |app| app.state().dream_step() > Some(50));
        headless.command(Command::Dream(DreamCommand::Keep));
        headless.wait_for("the kept dream", |app| !app.state().is_driving());
        headless.wait_for("its line in the log", |app| {
            app.open().is_some_and(|open| open.session().dreams().len() == n)
        });
    }
    assert_eq!(headless.n_dreams(), 2);

    headless.command(Command::Window(WindowCommand::Show(Panel::Label)));
    let both = |preference| Response::Safety(SafetyAnswer::Both(preference));
    let responses = [
        Response::Safety(SafetyAnswer::OnlyLeft),
        Response::Safety(SafetyAnswer::OnlyRight),
        Response::Safety(SafetyAnswer::Neither),
        both(Preference::Left),
        both(Preference::Equal),
        both(Preference::Right),
    ];
    for n in 0..24 {
        headless.wait_for("clips that are seen", App::is_answerable);
        headless.command(Command::Label(LabelCommand::Answer(responses[n % responses.len()])));
        headless.wait_for("the answer on disk", |app| Headless::n_answers(app) == n + 1);
    }
    headless.command(Command::Label(LabelCommand::Undo));
    headless.wait_for("the answer taken back", |app| Headless::n_answers(app) == 23);
    assert_eq!(headless.app.shown(), Some(QueryId(23)), "it is asked again");

    headless.command(Command::Reward(RewardCommand::Fit { seed: None }));
    headless.wait_for("the reward on disk", |app| {
        app.open().is_some_and(|open| !open.session().fits().is_empty())
    });

    headless.command(Command::Window(WindowCommand::Show(Panel::Deploy)));
    headless.command(Command::Deploy(DeployCommand::Start));
    headless.wait_for("the end of an episode", |app| !app.state().deployed().is_empty());
    assert_eq!(headless.app.state().deployed()[0].1.n_steps, DummyRoad::LEN);

    headless.command(Command::Window(WindowCommand::Show(Panel::Evaluate)));
    assert_eq!(headless.app.state().evaluated().len(), 1, "it is a run that can be compared");
    headless.command(Command::Evaluate(EvaluateCommand::Watch(Some(0))));
    headless.wait_for("the episode once more", |app| app.state().came_out_the_same().is_some());
    assert_eq!(headless.app.state().came_out_the_same(), Some(true));

    let errors = headless.app.state().messages().iter().filter(|message| message.kind == MessageKind::Error);
    assert_eq!(errors.count(), 0, "{:?}", headless.app.state().messages());
    let folder = headless.app.open().unwrap().dir().to_owned();
    let session = headless.app.open().unwrap().session().clone();
    drop(headless);
    assert_eq!(SessionStore::read(&folder).unwrap().1, session, "what was shown is what is on disk");
    let model = untrained(&WorldModelConfig::tiny(), &mut ChaCha8Rng::seed_from_u64(0));
    assert_eq!(replay(&folder, &model).unwrap().fits.len(), 1, "and its reward can be learned from it again");
}

#[test]
fn nothing_counts_before_it_is_on_disk() {
    let dir = tempfile::tempdir().unwrap();
    let mut headless = Headless::new(dir.path());
    headless.command(Command::Session(SessionCommand::New(dropj::query::Protocol::Dropj)));
    headless.wait_for("a session", |app| app.open().is_some());
    let episode = || {
        let state = &toy_world().starts[0].state;
        let mut episode = dropj::dream::DreamEpisode::new(state.clone(), 7);
        for _ in 0..60 {
            episode.zs.push(&[0.1; 4]);
            episode.actions.push(Action::new([0.0; 3]));
        }
        Box::new(episode)
    };
    headless.command(Command::Dream(DreamCommand::Offer {
        episode: episode(),
        source: dropj::session::DreamSource::Simulated,
        acquisition: None,
    }));
    headless.wait_for("the dream", |app| app.open().is_some_and(|open| open.session().dreams().len() == 1));
    headless.command(Command::Window(WindowCommand::Show(Panel::Label)));
    headless.wait_for("clips that are seen", App::is_answerable);

    // The key is struck, and nobody has written anything yet.
    let answer = Command::Label(LabelCommand::Answer(Response::Safety(SafetyAnswer::OnlyLeft)));
    let seen = Moment { nr: headless.moment.nr + 1, at: headless.moment.at + 0.1 };
    headless.app.command(answer.clone(), seen);
    assert_eq!((Headless::n_answers(&headless.app), headless.app.is_settled()), (0, false));
    // A second key waits for that, and is then too early for the next pair.
    headless.app.command(answer, seen);
    headless.wait_for("the answer on disk", App::is_settled);
    headless.step();
    assert_eq!(Headless::n_answers(&headless.app), 1);
}
