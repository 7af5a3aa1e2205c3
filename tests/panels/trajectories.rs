//! ReQueST: what is asked about is made while somebody answers.

use std::time::{Duration, Instant};

use dropj::planner::synthesis::{Acquisition, SynthesisConfig};
use dropj::query::TRAJECTORY_LEN;
use dropj::reward::RewardConfig;
use dropj::session::{Choice, replay};
use dropj::worker::{SynthesizerCommand, WorkerName};

use super::looks::has_adapter;
use super::*;

/// Chooses ReQueST where the questions are those of `before`.
fn choose_request(harness: &mut Harness<'_, Window>, before: Protocol) {
    harness.get_by_label(before.name()).click();
    harness.run_steps(3);
    harness.get_by_label("ReQueST").click();
    harness.run_steps(3);
}

/// The seeds of the trajectories that were wanted, what each was to be, and whether with a reward.
fn wanted(backstage: &Backstage) -> Vec<(u64, Acquisition, bool)> {
    let wanted = |order| match order {
        WorkerCommand::Synthesizer(SynthesizerCommand::Make { seed, acquisition, reward, .. }) => {
            Some((seed, acquisition, reward.is_some()))
        }
        _ => None,
    };
    backstage.orders().into_iter().filter_map(wanted).collect()
}

/// Reports a trajectory.
fn make(harness: &mut Harness<'_, Window>, backstage: &Backstage, seed: u64, acquisition: Acquisition) {
    let episode = DreamEpisode { seed, ..dream(TRAJECTORY_LEN) };
    backstage.report(Report::Label(LabelReport::Synthesized { episode, acquisition }));
    harness.run_steps(4);
}

#[test]
fn a_trajectory_is_made_kept_and_asked_about_and_the_next_is_made_meanwhile() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = labeling(dir.path(), Protocol::Dropj);
    choose_request(&mut harness, Protocol::Dropj);
    let [(seed, Acquisition::Uncertainty, false)] = wanted(&backstage)[..] else { panic!("none is wanted") };
    backstage.report(Report::Label(LabelReport::Synthesizing { seed: seed ^ 1, done: 180, n: 200 }));
    backstage.report(Report::Label(LabelReport::Synthesizing { seed, done: 80, n: 200 }));
    harness.run_steps(2);
    harness.get_by_label("Making a trajectory, 40 %");
    make(&mut harness, &backstage, seed ^ 1, Acquisition::MinReward);
    harness.get_by_label_contains("Making a trajectory");
    // It takes a second, and verdicts a tenth of that each.
    harness.run_steps(25);
    make(&mut harness, &backstage, seed, Acquisition::Uncertainty);
    harness.get_by_label("Where does the last step of this clip lead?");
    press(&mut harness, Key::ArrowRight);
    assert_eq!(wanted(&backstage), [], "there is time: the next one is made by what is learned until then");

    let parameters = world().parameters;
    backstage.report(Report::Reward(RewardReport::Learned { parameters, n_labels: 10, fit: None }));
    for _ in 1..40 {
        press(&mut harness, Key::ArrowUp);
    }
    let [(next, Acquisition::MaxReward, true)] = wanted(&backstage)[..] else { panic!("none is wanted") };
    backstage.report(Report::Label(LabelReport::Synthesizing { seed: next, done: 20, n: 200 }));
    harness.run_steps(2);
    harness.get_by_label_contains("next one: 10 % made");
    for _ in 40..49 {
        press(&mut harness, Key::ArrowUp);
    }
    harness.get_by_label("Making a trajectory, 10 %");
    make(&mut harness, &backstage, next, Acquisition::MaxReward);
    press(&mut harness, Key::ArrowLeft);

    let folder = harness.state().app().open().unwrap().dir().to_owned();
    drop((harness, backstage));
    let store = SessionStore::open(&folder, None).unwrap();
    let session = store.session();
    let kept: Vec<_> = session.dreams()[2..].iter().map(|kept| (kept.source, kept.acquisition)).collect();
    let made = |acquisition| (DreamSource::Synthesized, Some(acquisition));
    assert_eq!(kept, [made(Acquisition::Uncertainty), made(Acquisition::MaxReward)], "the stray one is not");
    let answered = session.queries().iter().filter(|asked| asked.answer().is_some());
    let asked: Vec<_> = answered.filter_map(|asked| Some((asked.transition?, asked.choice))).collect();
    assert_eq!(asked.len(), 50);
    for (i, (transition, choice)) in asked.iter().enumerate() {
        let (dream, step, acquisition) =
            if i < 49 { (2, i, Acquisition::Uncertainty) } else { (3, 0, Acquisition::MaxReward) };
        assert_eq!((transition.dream.0, transition.step), (dream, step));
        assert_eq!(*choice, Choice::Synthesized(acquisition));
    }
}

#[test]
fn making_can_be_stopped_fails_in_a_sentence_and_goes_on_when_wanted() {
    let dir = tempfile::tempdir().unwrap();
    let (mut harness, backstage) = labeling(dir.path(), Protocol::Dros);
    choose_request(&mut harness, Protocol::Dros);
    let [(seed, ..)] = wanted(&backstage)[..] else { panic!("none is wanted") };
    harness.get_by_label("Stop").click();
    harness.run_steps(3);
    assert!(matches!(&backstage.orders()[..], [WorkerCommand::Synthesizer(SynthesizerCommand::Stop)]));
    harness.get_by_label("Make the next one").click();
    harness.run_steps(3);
    let [(again, ..)] = wanted(&backstage)[..] else { panic!("none is wanted") };
    assert_eq!(seed, again, "the same session makes the same");
    let message = "this classifier was learned in another world model";
    backstage.report(failed(WorkerName::Synthesizer, message));
    harness.run_steps(3);
    assert_eq!(wanted(&backstage), [], "not over and over");
    harness.get_by_label("This classifier was learned in another world model");
    harness.get_by_label("Try again").click();
    harness.run_steps(3);
    assert_eq!(wanted(&backstage).len(), 1);
    harness.get_by_label("ReQueST").click();
    harness.run_steps(3);
    harness.get_by_label("DROS").click();
    harness.run_steps(3);
    let stops = backstage.orders().into_iter();
    let mut stops =
        stops.filter(|order| matches!(order, WorkerCommand::Synthesizer(SynthesizerCommand::Stop)));
    assert!(stops.next().is_some(), "another protocol wants none");
    harness.get_by_label("Where does the last step of this clip lead?");
    press(&mut harness, Key::ArrowUp);
    let session = harness.state().app().open().unwrap().session();
    assert!(
        session.dreams().iter().all(|kept| kept.source == DreamSource::User),
        "DROS asks about driven ones"
    );
}

#[test]
fn from_choosing_request_to_three_verdicts_and_a_replay() {
    let dir = tempfile::tempdir().unwrap();
    let config = WorkerConfig {
        spec: Arc::new(WorldSpec::of_name("dummy-road")),
        world: WorldModelConfig::tiny(),
        reward: RewardConfig::tiny(),
        synthesis: SynthesisConfig { iterations: 3, ..SynthesisConfig::paper() },
        ..worker_config()
    };
    let startup = WindowStartup {
        workers: Box::new(|wake| Box::new(Threads::new(config, None, wake))),
        ..startup(dir.path(), None, &Backstage::default())
    };
    let builder = Harness::builder().with_size(vec2(1280.0, 800.0)).with_step_dt(0.04);
    let mut harness = builder.build_eframe(|cc| Window::new(cc, startup));
    harness.run_steps(2);
    go(&mut harness, Panel::Label);
    harness.get_by_label("ReQueST").click();
    for (n, verdict) in [Key::ArrowRight, Key::ArrowUp, Key::ArrowLeft].into_iter().enumerate() {
        let began = Instant::now();
        while harness.state().app().shown().is_none() {
            assert!(began.elapsed() < Duration::from_secs(50), "nothing is asked");
            harness.step();
            std::thread::sleep(Duration::from_millis(5));
        }
        press(&mut harness, verdict);
        // Here a thread writes.
        wait_for(&mut harness, |harness| responses(harness).len() > n);
    }
    let expected = [Verdict::Good, Verdict::Neutral, Verdict::Unsafe].map(Response::Judged);
    assert_eq!(responses(&harness), expected);
    wait_for(&mut harness, |harness| harness.state().app().is_settled());
    let (folder, live) = {
        let store = harness.state().app().open().unwrap();
        (store.dir().to_owned(), store.session().clone())
    };
    drop(harness);
    let model = untrained(&WorldModelConfig::tiny(), &mut ChaCha8Rng::seed_from_u64(0));
    let replayed = replay(&folder, &model).unwrap();
    assert_eq!(replayed.session, live);
    assert_eq!(replayed.session.judged().len(), 3);
    replayed.record_clips().unwrap();
    let then = replayed.recorded_clips().unwrap().unwrap();
    assert!(!then.is_empty() && replayed.changed_clips(&then).is_empty());
}

#[test]
fn waiting_for_a_trajectory_looks_as_it_did() {
    if !has_adapter() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let store = session(dir.path(), Protocol::Request);
    let (mut harness, backstage) = window(dir.path(), Some(store), vec2(1280.0, 720.0), true);
    go(&mut harness, Panel::Label);
    let [(seed, ..)] = wanted(&backstage)[..] else { panic!("none is wanted") };
    backstage.report(Report::Label(LabelReport::Synthesizing { seed, done: 80, n: 200 }));
    harness.run_steps(3);
    harness.snapshot("label_waiting");
}
