//! Driving, looking at what was driven, and weighing answers.

use std::sync::mpsc::channel;
use std::time::Duration;

use dropj::query::{DreamId, Weights};
use dropj::session::Event as Happened;
use dropj::worker::{DreamInspectorCommand, LoadWorldModel, RolloutComparison, RolloutView};
use eframe::egui::accesskit::Role;

use super::looks::{judgement, learning, review};
use super::*;

fn click(harness: &mut Harness<'_, Window>, label: &str) {
    harness.get_by_label(label).click();
    harness.run_steps(2);
}

/// A window on the dream panel of a session with two dreams.
fn kept(dir: &Path) -> (Harness<'static, Window>, Backstage) {
    let (harness, backstage) = window(dir, Some(session(dir, Protocol::Dropj)), vec2(1280.0, 800.0), false);
    backstage.orders();
    (harness, backstage)
}

/// The steps that the reviewer was asked to draw.
fn looks(backstage: &Backstage) -> Vec<(DreamId, usize)> {
    let orders = backstage.orders();
    let look = |order: &WorkerCommand| match order {
        WorkerCommand::DreamInspector(DreamInspectorCommand::Show { dream, step }) => Some((*dream, *step)),
        _ => None,
    };
    orders.iter().filter_map(look).collect()
}

#[test]
fn a_kept_dream_is_looked_at_again_step_by_step() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = kept(dir.path());
    click(&mut harness, "Dream 1: 200 steps");
    assert_eq!(looks(&backstage), [(DreamId(0), 0)]);
    press(&mut harness, Key::Period);
    press(&mut harness, Key::Period);
    press(&mut harness, Key::Comma);
    assert_eq!(looks(&backstage), [(DreamId(0), 1), (DreamId(0), 2), (DreamId(0), 1)]);
    press(&mut harness, Key::P);
    harness.run_steps(5);
    let played = looks(&backstage);
    assert!(played.last().is_some_and(|(_, step)| *step > 5), "it plays: {played:?}");
    press(&mut harness, Key::P);
    backstage.slots.review.put(review(DreamId(0)));
    backstage.report(Report::Dream(DreamReport::Rewards(judgement(DreamId(0)))));
    harness.run_steps(2);
    harness.get_by_label_contains(": reward ");
    press(&mut harness, Key::PageDown);
    assert_eq!(looks(&backstage).last(), Some(&(DreamId(1), 0)));
    press(&mut harness, Key::Escape);
    harness.get_by_label("Begin");
}

#[test]
fn a_dream_that_no_answer_rests_on_is_deleted_and_brought_back() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = kept(dir.path());
    let lens =
        |harness: &Harness<'_, Window>| harness.state().app().open().unwrap().session().dream_lens().len();
    click(&mut harness, "Dream 2: 90 steps");
    press(&mut harness, Key::Delete);
    assert_eq!(lens(&harness), 1);
    assert!(harness.query_by_label("Dream 2: 90 steps").is_none(), "it is gone from the list");
    let file = harness.state().app().open().unwrap().dir().join("dreams/0001.safetensors");
    assert!(file.exists(), "but not from the disk");
    click(&mut harness, "Bring it back");
    assert_eq!(lens(&harness), 2);
    harness.get_by_label("Dream 2: 90 steps");
}

#[test]
fn a_dream_that_answers_rest_on_is_not_deleted_and_says_why() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = kept(dir.path());
    go(&mut harness, Panel::Label);
    for _ in 0..8 {
        press(&mut harness, Key::A);
    }
    go(&mut harness, Panel::Dream);
    click(&mut harness, "Dream 1: 200 steps");
    press(&mut harness, Key::Delete);
    harness.get_by_label_contains("answers rest on it");
    assert_eq!(harness.state().app().open().unwrap().session().dream_lens().len(), 2);
}

#[test]
fn other_weights_change_the_labels_and_the_reward_is_learned_anew() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = kept(dir.path());
    go(&mut harness, Panel::Label);
    press(&mut harness, Key::ArrowLeft);
    go(&mut harness, Panel::Reward);
    backstage.orders();
    let slider = harness
        .get_all_by_role(Role::Slider)
        .find(|node| node.accesskit_node().label().is_some_and(|label| label.contains("both are safe")));
    slider.expect("there is a slider for it").focus();
    harness.run_steps(2);
    press(&mut harness, Key::ArrowRight);
    let store = harness.state().app().open().unwrap();
    let default = store.session().weights().default;
    assert!(default > 0.75, "{default}");
    let log = std::fs::read_to_string(store.dir().join("events.jsonl")).unwrap();
    assert!(log.contains("weights_changed"), "it is written down");
    let orders = backstage.orders();
    let learned = orders.iter().any(
        |order| matches!(order, WorkerCommand::Trainer(TrainerCommand::Learn(_, label)) if label.mu() == default),
    );
    let relearned =
        orders.iter().any(|order| matches!(order, WorkerCommand::Trainer(TrainerCommand::Relearn)));
    assert!(learned && relearned, "{orders:?}");
    click(&mut harness, "As at first");
    let session = harness.state().app().open().unwrap().session();
    assert_eq!(session.weights(), &Weights::paper());
}

#[test]
fn the_wheel_of_a_dream_is_handed_over_with_one_key() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = dreaming(dir.path());
    press(&mut harness, Key::M);
    harness.get_by_label_contains("The planner needs a reward");
    backstage.report(Report::Reward(RewardReport::Learned {
        parameters: world().parameters,
        n_labels: 12,
        fit: None,
    }));
    harness.run_steps(2);
    backstage.orders();
    press(&mut harness, Key::M);
    let orders = backstage.orders();
    let [
        WorkerCommand::Dreamer(DreamerCommand::Reward(_)),
        WorkerCommand::Dreamer(DreamerCommand::HandOver(true)),
    ] = &orders[..]
    else {
        panic!("{orders:?}")
    };
    backstage.slots.dream.put(LiveView { is_planned: true, ..view(3) });
    harness.run_steps(2);
    click(&mut harness, "Take over");
    assert!(
        matches!(backstage.orders().last(), Some(WorkerCommand::Dreamer(DreamerCommand::HandOver(false)))),
        "and taken back"
    );
}

#[test]
fn a_recording_that_is_being_sealed_cannot_be_thrown_away() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = window(dir.path(), None, vec2(1280.0, 800.0), false);
    go(&mut harness, Panel::Record);
    press(&mut harness, Key::Enter);
    backstage.slots.record.put(view(30));
    harness.run_steps(1);
    backstage.orders_but_lists();
    for key in [Key::N, Key::R, Key::Escape, Key::N] {
        press(&mut harness, key);
    }
    let orders = backstage.orders_but_lists();
    assert!(matches!(&orders[..], [WorkerCommand::Recorder(RecorderCommand::Keep)]), "{orders:?}");
    backstage.report(Report::Record(RecordReport::Recorded { episode: 0, n_steps: 30 }));
    harness.run_steps(2);
    press(&mut harness, Key::Enter);
    assert!(
        matches!(
            backstage.orders_but_lists()[..],
            [WorkerCommand::Recorder(RecorderCommand::Start { seed: 2, .. })]
        ),
        "another can be begun"
    );
}

#[test]
fn a_window_opens_while_its_world_model_is_being_read() {
    let dir = tempfile::tempdir().unwrap();
    let (go_on, wait) = channel::<()>();
    let wait = Mutex::new(wait);
    let backstage = Backstage::default();
    let mut startup = startup(dir.path(), Some(session(dir.path(), Protocol::Dropj)), &backstage);
    startup.app.world = FirstWorld::In("slow.safetensors".into());
    let load: LoadWorldModel = Arc::new(move |_| {
        wait.lock().unwrap().recv().ok();
        Ok(world())
    });
    startup.workers = Box::new(move |wake| {
        *backstage.jobs.lock().unwrap() =
            Some(Threads::new(WorkerConfig { load, ..worker_config() }, None, wake));
        Box::new(backstage)
    });
    let builder = Harness::builder().with_size(vec2(1280.0, 800.0));
    let mut harness = builder.build_eframe(|cc| Window::new(cc, startup));
    harness.run_steps(3);
    harness.get_by_label("Reading the world model…");
    assert!(harness.state().app().open().is_none(), "the session waits for its world model");
    go_on.send(()).unwrap();
    wait_for(&mut harness, |harness| harness.state().app().open().is_some());
    harness.step();
    harness.get_by_label("Begin");
}

fn protocol(harness: &Harness<'_, Window>) -> Option<Protocol> {
    harness.state().app().open().map(|store| store.session().protocol())
}

#[test]
fn what_old_workers_have_still_to_say_does_not_reach_another_session() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = kept(dir.path());
    let header = Header::new("dummy-road", Protocol::Drope, 6, &world().parameters.hash(), 1_795_342_600_000);
    drop(SessionStore::create(&dir.path().join("2026-11-22T10-20-00-other"), header).unwrap());
    click(&mut harness, "Sessions…");
    harness.run_steps(10);
    opening::choose(&mut harness, "2026-11-22T10-20-00-other");
    // It is in the inbox when the other session is opened.
    backstage.report(Report::Reward(RewardReport::Learned {
        parameters: world().parameters,
        n_labels: 40,
        fit: None,
    }));
    backstage.report(Report::Reward(RewardReport::Learning(learning(3))));
    wait_for(&mut harness, |harness| protocol(harness) == Some(Protocol::Drope));
    harness.run_steps(4);
    go(&mut harness, Panel::Deploy);
    harness.get_by_label("The planner needs a reward: answer some queries first.");
}

#[test]
fn nothing_is_drawn_while_nothing_moves() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, _) = kept(dir.path());
    for panel in [Panel::Record, Panel::World, Panel::Dream, Panel::Reward, Panel::Deploy] {
        go(&mut harness, panel);
        harness.run_steps(300);
        let delay = harness.output().viewport_output.values().map(|viewport| viewport.repaint_delay).min();
        assert!(delay.is_some_and(|delay| delay > Duration::from_mins(1)), "{panel:?}: {delay:?}");
    }
}

#[test]
fn a_deleted_dream_is_still_deleted_when_the_session_is_opened_again() {
    let dir = tempfile::tempdir().unwrap();
    let mut store = session(dir.path(), Protocol::Dropj);
    store.record(Happened::DreamDropped { dream: DreamId(0) }).unwrap();
    let folder = store.dir().to_owned();
    drop(store);
    let store = SessionStore::open(&folder, None).unwrap();
    let (mut harness, _) = window(dir.path(), Some(store), vec2(1280.0, 800.0), false);
    assert!(harness.query_by_label("Dream 1: 200 steps").is_none(), "it is not in the list");
    go(&mut harness, Panel::Label);
    let session = harness.state().app().open().unwrap().session();
    let shows = |segment: dropj::query::SegmentRef| segment.dream == DreamId(1);
    let all = session.queries().iter().all(|asked| shows(asked.query.left) && shows(asked.query.right));
    assert!(all && !session.queries().is_empty(), "only the other one is asked about");
}

#[test]
fn a_dream_rides_beside_the_real_car_and_its_drift_is_shown() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = window(dir.path(), None, vec2(1280.0, 800.0), false);
    go(&mut harness, Panel::Record);
    backstage.orders();
    press(&mut harness, Key::B);
    click(&mut harness, "50");
    let orders = backstage.orders();
    let asked = orders.iter().filter_map(|order| match order {
        WorkerCommand::Recorder(RecorderCommand::CompareRollout(beside)) => Some(*beside),
        _ => None,
    });
    assert_eq!(
        asked.collect::<Vec<_>>(),
        [Some(RolloutComparison::default()), Some(RolloutComparison { reset: Some(50) })]
    );
    assert!(
        matches!(orders[0], WorkerCommand::Recorder(RecorderCommand::Model(_))),
        "it is told what to dream with"
    );
    press(&mut harness, Key::Enter);
    backstage.slots.record.put(view(3));
    backstage.slots.rollout.put(RolloutView { frame: frame(80), step: 3, since: 3, drift: 0.125 });
    harness.run_steps(2);
    harness.get_by_label("Drift 12.5 %");
    harness.get_by_label("The dream beside, 3 steps after it last saw the world");
}

#[test]
fn the_wheel_of_the_real_car_is_handed_over_too() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = window(dir.path(), None, vec2(1280.0, 800.0), false);
    backstage.report(Report::Reward(RewardReport::Learned {
        parameters: world().parameters,
        n_labels: 12,
        fit: None,
    }));
    go(&mut harness, Panel::Record);
    press(&mut harness, Key::Enter);
    backstage.slots.record.put(view(3));
    harness.run_steps(2);
    backstage.orders();
    backstage.pad.lock().unwrap().push(PadEvent::Pressed(PadButton::Back));
    harness.run_steps(2);
    let orders = backstage.orders();
    assert!(
        matches!(
            &orders[..],
            [
                WorkerCommand::Recorder(RecorderCommand::Model(_)),
                WorkerCommand::Recorder(RecorderCommand::Reward(_)),
                WorkerCommand::Recorder(RecorderCommand::HandOver(true)),
            ]
        ),
        "{orders:?}"
    );
}

#[test]
fn the_buttons_of_a_pad_can_be_changed() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = dreaming(dir.path());
    backstage.slots.dream.put(view(30));
    harness.run_steps(1);
    let pressed = |harness: &mut Harness<'_, Window>, button| {
        backstage.pad.lock().unwrap().push(PadEvent::Pressed(button));
        harness.run_steps(2);
    };
    harness.get_by_label("Keys and help").click();
    harness.run_steps(10);
    click(&mut harness, "Gamepad");
    harness.run_steps(4);
    click(&mut harness, "end and keep: Y");
    pressed(&mut harness, PadButton::RightShoulder);
    harness.get_by_label("end and keep: R1");
    click(&mut harness, "unsafe now: A");
    harness.get_by_label("Button X: throw away and redo, it becomes unsafe").click();
    harness.run_steps(2);
    harness.get_by_label("throw away and redo: A");
    press(&mut harness, Key::Escape);
    backstage.orders();
    pressed(&mut harness, PadButton::West);
    pressed(&mut harness, PadButton::RightShoulder);
    let orders = backstage.orders();
    assert!(
        matches!(
            orders[..],
            [
                WorkerCommand::Dreamer(DreamerCommand::MarkUnsafe),
                WorkerCommand::Dreamer(DreamerCommand::Finish)
            ]
        ),
        "{orders:?}"
    );
}

#[test]
fn nothing_held_outlasts_the_focus() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = dreaming(dir.path());
    harness.key_down(Key::ArrowUp);
    harness.key_down(Key::ArrowLeft);
    harness.run_steps(2);
    harness.event(Event::WindowFocused(false));
    harness.run_steps(2);
    // The window system never tells of keys that are let go elsewhere, and may repeat those that are held still.
    harness.event(Event::WindowFocused(true));
    harness.run_steps(3);
    assert_eq!(backstage.given(), [0.0; 3], "what was held before is not held again by itself");
    harness.key_down(Key::ArrowUp);
    harness.run_steps(2);
    assert_eq!(backstage.given()[1], 1.0, "until it is pressed again");
}

#[test]
fn a_reward_that_is_learned_while_the_planner_drives_reaches_it() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = dreaming(dir.path());
    let learned = |seed: u64, n_labels| {
        backstage.report(Report::Reward(RewardReport::Learned {
            parameters: toy(seed).parameters,
            n_labels,
            fit: None,
        }));
    };
    let taught = |harness: &mut Harness<'_, Window>| {
        harness.run_steps(2);
        let to_dreamer =
            |order: &WorkerCommand| matches!(order, WorkerCommand::Dreamer(DreamerCommand::Reward(_)));
        backstage.orders().iter().filter(|order| to_dreamer(order)).count()
    };
    learned(0, 12);
    assert_eq!(taught(&mut harness), 0, "a hand drives");
    press(&mut harness, Key::M);
    assert_eq!(taught(&mut harness), 1);
    learned(1, 13);
    assert_eq!(taught(&mut harness), 1);
    press(&mut harness, Key::R);
    learned(2, 14);
    assert_eq!(taught(&mut harness), 0, "another dream begins with a hand at the wheel");
}

#[test]
fn the_wheel_can_be_taken_back_whatever_became_of_the_reward() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = dreaming(dir.path());
    backstage.slots.dream.put(LiveView { is_planned: true, ..view(3) });
    harness.run_steps(2);
    backstage.orders();
    press(&mut harness, Key::M);
    assert!(matches!(backstage.orders()[..], [WorkerCommand::Dreamer(DreamerCommand::HandOver(false))]));
}

#[test]
fn where_no_verdict_was_learned_from_the_planner_says_what_it_needs() {
    let dir = tempfile::tempdir().unwrap();
    let store = session(dir.path(), Protocol::Dros);
    let (mut harness, backstage) = window(dir.path(), Some(store), vec2(1280.0, 800.0), false);
    press(&mut harness, Key::Enter);
    backstage.slots.dream.put(view(3));
    harness.run_steps(2);
    press(&mut harness, Key::M);
    harness.get_by_label_contains("judge some transitions, then fit it in Reward");
}
