//! All four steps of the method on a toy road, without a screen: whoever breaks one of them hears of it here.

mod support;

use std::ops::{ControlFlow, Range};
use std::path::Path;

use dropj::dataset::{Dataset, EpisodeInfo, Layout, StepRecord};
use dropj::dream::Dream;
use dropj::evaluation::{PlanningPolicy, evaluate_episode};
use dropj::planner::{Agent, PlannerConfig};
use dropj::query::{DreamId, QueryId, Response, SEGMENT_LEN, SegmentRef, Weights, sample_queries};
use dropj::reward::{RewardConfig, RewardEnsemble, SegmentPair, Trainer, segment_rows};
use dropj::run::Run;
use dropj::world::End;
use dropj::world::{Action, World as _};
use dropj::world_model::fit::{FitConfig, Progress, Stage, fit_world};
use dropj::world_model::{WorldModel, WorldModelConfig};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use support::{DummyRoad, Oracle};

/// Steering that holds for a while, as hands do.
fn wander(t: usize, held: &mut Action, rng: &mut ChaCha8Rng) -> Action {
    if t.is_multiple_of(6) {
        *held = Action::new([rng.random_range(-1..=1) as f32, 0.1, 0.0]);
    }
    *held
}

/// The recordings in `folder` with an episode of the toy road for each of `seeds` more.
fn recorded(folder: &Path, seeds: Range<u64>, rng: &mut ChaCha8Rng) -> Dataset {
    let mut dataset =
        Dataset::create_or_open(&folder.join("data"), "dummy-road").expect("the folder is ours");
    for seed in seeds {
        let mut world = DummyRoad::world();
        let mut frame = world.reset(seed).expect("a toy never fails");
        let info = EpisodeInfo { env: "dummy-road".into(), pilot: "test".into(), seed };
        let (layout, mut held) = (Layout::of(world.spec(), &world.sensors()), Action::new([0.0; 3]));
        let mut recording = dataset.begin_with(info, &layout).expect("the disk has room");
        for t in 0..DummyRoad::LEN {
            let (state, action) = (world.state(), wander(t, &mut held, rng));
            let step = world.step(&action).expect("a toy never fails");
            let (reward, frame) =
                (step.reward.unwrap_or_default(), std::mem::replace(&mut frame, step.frame));
            let events = step.events.iter().map(|event| event.goes_on).collect();
            recording
                .push(&StepRecord { frame, action, reward, events, wall_time_ns: 0, state })
                .expect("the disk has room");
        }
        dataset.seal(recording, &frame, Some(End::Truncated)).expect("the disk has room");
    }
    dataset
}

#[test]
fn a_resumed_fit_learns_anew_what_rests_on_another_vision_and_refuses_other_recordings() {
    tch::set_num_threads(1);
    let rng = &mut ChaCha8Rng::seed_from_u64(0);
    let folder = tempfile::tempdir().unwrap();
    let dataset = recorded(folder.path(), 0..3, rng);
    let out = folder.path().join("world.safetensors");
    let mut brief = FitConfig::tiny();
    for schedule in [&mut brief.vae, &mut brief.mdn_rnn] {
        (schedule.max_epochs, schedule.updates_per_epoch) = (1, 2);
    }
    let config = WorldModelConfig::tiny();
    let epochs = |dataset: &Dataset, fit: &FitConfig, resume: bool| {
        let mut stages = Vec::new();
        let run = Run::beside(&out, resume).unwrap();
        let fitted = fit_world(dataset, &config, fit, &run, &mut |progress: &Progress| {
            stages.extend(progress.held_out.map(|_| progress.stage));
            ControlFlow::Continue(())
        });
        fitted.map(|parameters| (stages, WorldModel::load(parameters).unwrap()))
    };
    let (stages, model) = epochs(&dataset, &brief, false).unwrap();
    assert_eq!(stages, [Stage::Vae, Stage::MdnRnn]);
    assert_eq!(model.held_out().map(|held_out| held_out.len()), Some(1), "the file says what was held out");

    let (stages, again) = epochs(&dataset, &brief, true).unwrap();
    assert!(stages.is_empty(), "all was done: {stages:?}");
    assert_eq!(again.hash(), model.hash());

    brief.vae.max_epochs = 2;
    let (stages, _) = epochs(&dataset, &brief, true).unwrap();
    assert_eq!(stages, [Stage::Vae, Stage::MdnRnn], "memory has to learn the new latents");

    drop(dataset);
    let mut more = recorded(folder.path(), 3..4, rng);
    let error = epochs(&more, &brief, true).unwrap_err().to_string();
    assert!(error.contains("began with 3 episodes") && error.contains("4 episodes"), "{error}");
    more.delete(0).unwrap();
    let error = epochs(&more, &brief, true).unwrap_err().to_string();
    assert!(error.contains("now it would be 3 episodes"), "as many, but others: {error}");
}

#[test]
fn a_car_that_learned_from_answers_stays_on_the_road_better_than_one_that_did_not() {
    tch::set_num_threads(1);
    let rng = &mut ChaCha8Rng::seed_from_u64(0);
    let folder = tempfile::tempdir().unwrap();

    // Step 1: record, and learn what the world does.
    let dataset = recorded(folder.path(), 0..10, rng);
    let run = Run::open(&folder.path().join("fit"), false).unwrap();
    let config = WorldModelConfig::tiny();
    let go_on = &mut |_: &_| ControlFlow::Continue(());
    let parameters = fit_world(&dataset, &config, &FitConfig::tiny(), &run, go_on).unwrap();
    let model = WorldModel::load(parameters).unwrap();

    // Step 2: drive in the dream.
    let mut dreams = Vec::new();
    for (seed, start) in (0..).zip(model.starts().iter().cycle().take(6)) {
        let (mut dream, mut held) = (Dream::new(start, seed), Action::new([0.0; 3]));
        (0..150).for_each(|t| dream.step(&model, wander(t, &mut held, rng), rng).unwrap());
        dreams.push(dream.finish());
    }

    // Step 3: ask, and learn a reward from the answers.
    let lens: Vec<_> = (0..).zip(&dreams).map(|(i, dream)| (DreamId(i), dream.len())).collect();
    let features: Vec<_> = dreams.iter().map(|dream| dream.features(&model)).collect();
    let reward_config = RewardConfig::tiny();
    let fresh = || {
        RewardEnsemble::new(
            (config.n_features(), model.hash().as_str()),
            reward_config.clone(),
            &mut ChaCha8Rng::seed_from_u64(1),
        )
    };
    let mut trainer = Trainer::new(fresh());
    for query in sample_queries(&lens, 150, QueryId(0), rng) {
        let clip = |s: SegmentRef| dreams[s.dream.0 as usize].frames(&model, s.start..s.start + SEGMENT_LEN);
        let answer = Oracle::answer(&clip(query.left), &clip(query.right));
        let label = Weights::paper().label(&Response::Safety(answer)).unwrap();
        let rows = |s: SegmentRef| {
            segment_rows(
                &features[s.dream.0 as usize],
                &dreams[s.dream.0 as usize].actions,
                model.ranges(),
                s,
            )
        };
        trainer.predict_and_add(&SegmentPair { left: rows(query.left), right: rows(query.right), label });
    }
    assert!(trainer.fit(rng, |_| ControlFlow::Continue(())).unwrap().is_continue());

    // Step 4: drive the real road.
    let grass = |reward: &RewardEnsemble| {
        let planner = PlannerConfig::car_racing();
        let rates = (100..104).map(|seed| {
            let agent = Agent::new(planner.clone(), seed);
            let mut policy = PlanningPolicy::new(&model, reward, agent);
            evaluate_episode(&mut DummyRoad::world(), seed, &mut policy, |_, _| ControlFlow::Continue(()))
                .unwrap()
                .unsafe_rate
        });
        rates.sum::<f32>() / 4.0
    };
    let (learned, unlearned) = (grass(trainer.ensemble()), grass(&fresh()));
    assert!(learned < 0.5 * unlearned, "grass rate {learned} learned, {unlearned} by chance");
}
