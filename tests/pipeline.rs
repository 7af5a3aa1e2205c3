//! All four steps of the method on a toy road, without a screen: whoever breaks one of them hears of it here.

mod support;

use std::ops::ControlFlow;

use dropj::dataset::{Dataset, EpisodeInfo, StepRecord};
use dropj::dream::Dream;
use dropj::env::{Action, Env as _, Seed};
use dropj::evaluation::{PlanningPolicy, evaluate_episode};
use dropj::planner::{Agent, PlannerConfig};
use dropj::query::{DreamId, QueryId, Response, SEGMENT_LEN, SegmentRef, Weights, sample_queries};
use dropj::reward::{RewardConfig, RewardEnsemble, SegmentPair, Trainer, segment_rows};
use dropj::run::Run;
use dropj::world_model::fit::{FitConfig, fit_world};
use dropj::world_model::{WorldModel, WorldModelConfig};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use support::{DummyRoad, Oracle};

/// Steering that holds for a while, as hands do.
fn wander(t: usize, held: &mut Action, rng: &mut ChaCha8Rng) -> Action {
    if t.is_multiple_of(6) {
        *held = Action::new(rng.random_range(-1..=1) as f32, 0.1, 0.0);
    }
    *held
}

#[test]
fn a_car_that_learned_from_answers_stays_on_the_road_better_than_one_that_did_not() {
    tch::set_num_threads(1);
    let rng = &mut ChaCha8Rng::seed_from_u64(0);
    let folder = tempfile::tempdir().unwrap();

    // Step 1: record, and learn what the world does.
    let mut dataset = Dataset::create_or_open(&folder.path().join("data"), "dummy-road").unwrap();
    for seed in 0..10 {
        let mut env = DummyRoad::default();
        env.reset(Seed::Native(seed));
        let info = EpisodeInfo { env: "dummy-road".into(), pilot: "test".into(), seed };
        let (mut recording, mut held) = (dataset.begin(info).unwrap(), Action::default());
        for t in 0..DummyRoad::LEN {
            let (frame, action) = (env.frame(), wander(t, &mut held, rng));
            let outcome = env.advance(action);
            let (reward, grass) = (outcome.reward, outcome.events.grass);
            recording
                .push(&StepRecord { frame, action, reward, grass, contacts: None, wall_time_ns: 0 })
                .unwrap();
        }
        dataset.seal(recording, &env.frame(), true).unwrap();
    }
    let run = Run::open(&folder.path().join("fit"), false).unwrap();
    let config = WorldModelConfig::tiny();
    let go_on = &mut |_: &_| ControlFlow::Continue(());
    let parameters = fit_world(&dataset, &config, &FitConfig::tiny(), &run, go_on).unwrap();
    let model = WorldModel::load(parameters).unwrap();

    // Step 2: drive in the dream.
    let mut dreams = Vec::new();
    for (seed, start) in (0..).zip(model.starts().iter().cycle().take(6)) {
        let (mut dream, mut held) = (Dream::new(start, seed), Action::default());
        (0..150).for_each(|t| dream.step(&model, wander(t, &mut held, rng), rng));
        dreams.push(dream.finish());
    }

    // Step 3: ask, and learn a reward from the answers.
    let lens: Vec<_> = (0..).zip(&dreams).map(|(i, dream)| (DreamId(i), dream.len())).collect();
    let features: Vec<_> = dreams.iter().map(|dream| dream.features(&model)).collect();
    let reward_config = RewardConfig::tiny();
    let fresh = || {
        RewardEnsemble::new(
            config.n_features(),
            &model.hash(),
            reward_config.clone(),
            &mut ChaCha8Rng::seed_from_u64(1),
        )
    };
    let mut trainer = Trainer::new(fresh());
    for query in sample_queries(&lens, 150, QueryId(0), rng) {
        let clip = |s: SegmentRef| dreams[s.dream.0 as usize].frames(&model, s.start..s.start + SEGMENT_LEN);
        let answer = Oracle::answer(&clip(query.left), &clip(query.right));
        let label = Weights::car_racing().label(&Response::Safety(answer)).unwrap();
        let rows = |s: SegmentRef| {
            segment_rows(&features[s.dream.0 as usize], &dreams[s.dream.0 as usize].actions, s)
        };
        trainer.learn(&SegmentPair { left: rows(query.left), right: rows(query.right), label });
    }
    assert!(trainer.fit(rng, |_| ControlFlow::Continue(())).is_continue());

    // Step 4: drive the real road.
    let grass = |reward: &RewardEnsemble| {
        let planner = PlannerConfig::car_racing();
        let rates = (100..104).map(|seed| {
            let agent = Agent::new(planner.clone(), seed);
            let mut policy = PlanningPolicy::new(&model, reward, agent);
            let seed = Seed::Native(seed);
            evaluate_episode(&mut DummyRoad::default(), seed, &mut policy, |_, _| ControlFlow::Continue(()))
                .grass_rate
        });
        rates.sum::<f32>() / 4.0
    };
    let (learned, unlearned) = (grass(trainer.ensemble()), grass(&fresh()));
    assert!(learned < 0.5 * unlearned, "grass rate {learned} learned, {unlearned} by chance");
}
