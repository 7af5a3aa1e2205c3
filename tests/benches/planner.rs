//! What a driver waits for (a plan: at most 5 ms) and what a user waits for (a fit: at most 10 s), with the paper's sizes.

use std::ops::ControlFlow;

use divan::Bencher;
use dropj::planner::{PlannerConfig, plan};
use dropj::query::{Preference, Response, SEGMENT_LEN, SafetyAnswer, Weights};
use dropj::reward::{RewardConfig, RewardEnsemble, SegmentPair, Trainer};
use dropj::tensor::{normal, to_vec};
use dropj::world::Frame;
use dropj::world_model::{State, WorldModel, WorldModelConfig, fast_kind, untrained};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use tch::Kind;

/// How many labels 500 queries gave the authors.
const N_LABELS: u64 = 342;

fn main() {
    tch::set_num_threads(std::env::var("THREADS").ok().and_then(|n| n.parse().ok()).unwrap_or(1));
    divan::main();
}

fn rng() -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(0)
}

fn ensemble(kind: Kind) -> RewardEnsemble {
    let n_features = WorldModelConfig::car_racing().n_features();
    // The 60 passes of the authors.
    let config = RewardConfig { updates: 180, ..RewardConfig::car_racing() };
    RewardEnsemble::new((n_features, "sha256:0"), config, &mut rng()).in_kind(kind)
}

fn here(model: &WorldModel) -> State {
    let frame = Frame::square(84, vec![100u8; 3 * 84 * 84]);
    State { z: model.observe(&[frame]), memory: model.no_memory(1) }
}

fn plan_in(bencher: Bencher<'_, '_>, kind: Kind, config: &PlannerConfig) {
    let model = untrained(&WorldModelConfig::car_racing(), &mut rng());
    let (reward, state, mut rng) = (ensemble(kind).for_inference(), here(&model), rng());
    bencher.bench_local(|| {
        plan(&model, &reward, &state, config, None, &mut rng).expect("numbers stay numbers").chosen
    });
}

#[divan::bench(sample_count = 200, sample_size = 1)]
fn plan_15_times_15_f32(bencher: Bencher<'_, '_>) {
    plan_in(bencher, Kind::Float, &PlannerConfig::paper());
}

#[divan::bench(sample_count = 200, sample_size = 1)]
fn plan_15_times_15_fast(bencher: Bencher<'_, '_>) {
    plan_in(bencher, fast_kind(), &PlannerConfig::paper());
}

#[divan::bench(sample_count = 200, sample_size = 1)]
fn plan_15_times_25_fast(bencher: Bencher<'_, '_>) {
    plan_in(bencher, fast_kind(), &PlannerConfig::car_racing());
}

fn fit_in(bencher: Bencher<'_, '_>, kind: Kind) {
    let mut trainer = Trainer::new(ensemble(kind));
    let width = trainer.ensemble().n_features() + 3;
    for i in 0..N_LABELS {
        let segment =
            |seed| to_vec(&normal(&mut ChaCha8Rng::seed_from_u64(seed), &[SEGMENT_LEN as i64, width]));
        let answer = SafetyAnswer::Both(if i % 2 == 0 { Preference::Left } else { Preference::Right });
        let label = Weights::paper().label(&Response::Safety(answer));
        let label = label.unwrap_or_else(|| unreachable!("it was answered"));
        trainer.predict_and_add(&SegmentPair { left: segment(2 * i), right: segment(2 * i + 1), label });
    }
    bencher.bench_local(|| trainer.fit(&mut rng(), |_| ControlFlow::Continue(())));
}

#[divan::bench(sample_count = 2, sample_size = 1)]
fn fit_342_labels_f32(bencher: Bencher<'_, '_>) {
    fit_in(bencher, Kind::Float);
}

#[divan::bench(sample_count = 3, sample_size = 1)]
fn fit_342_labels_fast(bencher: Bencher<'_, '_>) {
    fit_in(bencher, fast_kind());
}
