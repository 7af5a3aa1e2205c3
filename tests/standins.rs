//! Stand-ins for people in a world that has no car: recorded, learned, looked at, played in and asked about, without a screen.
#![expect(clippy::unwrap_used, reason = "a failing test may panic")]

use std::ops::ControlFlow;
use std::sync::Arc;

use dropj::dataset::Dataset;
use dropj::dream::Rows;
use dropj::planner::Snippets;
use dropj::planner::synthesis::SynthesisConfig;
use dropj::query::{Protocol, Response, SafetyAnswer, SkipReason, Strategy, Verdict};
use dropj::reward::{RewardConfig, SparseConfig};
use dropj::run::Run;
use dropj::simulate::record::record;
use dropj::simulate::{
    Eyes, FitProbeConfig, FitProbeError, Probe, SimulateConfig, fit_event_probe, simulate, simulate_dros,
    simulate_request,
};
use dropj::tensor::to_vec;
use dropj::world::{Action, End, Frame, Happened, Step, World, WorldError, WorldSpec};
use dropj::world_model::fit::{FitConfig, fit_world};
use dropj::world_model::{WorldModel, WorldModelConfig};

const SIZE: [usize; 2] = [12, 20];
const WORLD: &str = r#"
    format = 1
    name = "table"
    title = "A table"
    rate = 25
    longest_episode = 60
    source = { kind = "recordings" }
    image = { height = 12, width = 20 }
    axes = [
        { name = "right", low = -10.0, high = 10.0, neutral = 0.0 },
        { name = "up", low = 0.0, high = 4.0, neutral = 2.0 },
    ]
    events = [
        { name = "over the edge", kind = "safety", field = "edge" },
        { name = "bell", kind = "progress", field = "bell" },
        { name = "fire", kind = "safety", field = "fire" },
    ]
    justifications = [
        { name = "edge", events = ["over the edge"], weight = 1.0 },
    ]
    networks = { latent = 8, memory = 32, channels = 8 }
"#;

/// A white cup on a table whose right third is no table. Further up is better.
struct Table {
    spec: Arc<WorldSpec>,
    at: [f32; 2],
    t: usize,
}

impl Table {
    fn new() -> Self {
        Self { spec: Arc::new(WORLD.parse().unwrap()), at: [0.0; 2], t: 0 }
    }

    fn is_over(&self) -> bool {
        self.at[0] > 13.0
    }

    fn frame(&self) -> Frame {
        let [height, width] = SIZE;
        let mut rgb = Vec::new();
        for y in 0..height {
            for x in 0..width {
                let is_cup = (x as f32 - self.at[0]).abs() < 2.0 && (y as f32 - self.at[1]).abs() < 2.0;
                let ground: [u8; 3] = if x > 13 { [20, 20, 60] } else { [150, 100, 50] };
                rgb.extend(if is_cup { [250; 3] } else { ground });
            }
        }
        Frame::new(height as u32, width as u32, rgb)
    }
}

impl World for Table {
    fn spec(&self) -> &Arc<WorldSpec> {
        &self.spec
    }

    fn reset(&mut self, seed: u64) -> Result<Frame, WorldError> {
        (self.at, self.t) = ([2.0 + (seed % 14) as f32, 2.0 + (seed / 14 % 8) as f32], 0);
        Ok(self.frame())
    }

    fn step(&mut self, action: &[f32]) -> Result<Step, WorldError> {
        self.t += 1;
        self.at[0] = (self.at[0] + 0.1 * action[0]).clamp(1.0, 18.0);
        self.at[1] = (self.at[1] - 0.5 * (action[1] - 2.0)).clamp(1.0, 10.0);
        let goes_on = |goes_on| Happened { happened: goes_on, goes_on, passed: false };
        let reward = 11.0 - self.at[1] - if self.is_over() { 20.0 } else { 0.0 };
        Ok(Step {
            frame: self.frame(),
            reward: Some(reward),
            events: vec![goes_on(self.is_over()), goes_on(self.at[1] < 2.5), goes_on(false)],
            executed: None,
            end: (self.t == 60).then_some(End::Truncated),
        })
    }
}

/// What was done in an episode, ten steps at a time.
fn snippets(dataset: &Dataset, model: &WorldModel) -> Snippets {
    let (mut latents, mut actions) = (Rows { width: 8, values: Vec::new() }, Vec::<Vec<Action>>::new());
    for episode in dataset.episodes().map(Result::unwrap) {
        for at in (0..episode.actions.len() - 10).step_by(10) {
            latents.push(&to_vec(&model.observe(&episode.frames[at..=at])));
            actions.push(episode.actions[at..at + 10].to_vec());
        }
    }
    Snippets::new(latents, actions)
}

#[test]
fn in_a_world_without_a_car_somebody_sees_plays_and_answers() {
    tch::set_num_threads(1);
    let folder = tempfile::tempdir().unwrap();
    let go_on = &mut |_: &_| ControlFlow::Continue(());
    let mut table = Table::new();
    let spec = Arc::clone(table.spec());
    let mut dataset = Dataset::create_or_open(&folder.path().join("data"), "table").unwrap();
    record(&mut table, &mut dataset, 0..30, 5, |_| ControlFlow::Continue(())).unwrap();

    let run = Run::open(&folder.path().join("fit"), false).unwrap();
    let networks = WorldModelConfig::for_world(&spec);
    let mut schedule = FitConfig::tiny();
    (schedule.vae.updates_per_epoch, schedule.mdn_rnn.updates_per_epoch) = (250, 120);
    let parameters = fit_world(&dataset, &networks, &schedule, &run, go_on).unwrap();
    let model = WorldModel::load(parameters).unwrap();
    let model = WorldModel::load(model.parameters().with(snippets(&dataset, &model).tensors())).unwrap();

    // Looked at.
    let config = FitProbeConfig { n_updates: 400, ..FitProbeConfig::for_world(&spec) };
    let fit =
        fit_event_probe(&config, &dataset, &spec, Some(&model), &mut |_| ControlFlow::Continue(())).unwrap();
    let probe = Probe::load(&fit.parameters).unwrap();
    probe.require(&model).unwrap();
    let [edge, bell, fire] = &fit.real.events[..] else { panic!("three events: {}", fit.real) };
    assert!(edge.auc > 0.95 && edge.accuracy > 0.9 && bell.auc > 0.95, "{}", fit.real);
    assert_eq!((fire.share, fire.auc, fire.accuracy), (0.0, 0.5, 1.0), "it never happened");
    assert!(fit.real.progress.unwrap() > 0.8, "{}", fit.real);
    let painted = fit.painted.unwrap();
    assert!(painted.events[0].auc > 0.75, "as the world model paints it: {painted}");
    let readings = probe.readings().unwrap();
    assert_eq!((readings.gap, readings.stretches.len()), (2, 3));
    let scale = readings.progress.unwrap();
    assert!(scale.clip > scale.deviation && scale.unsafe_cost > 0.05, "being over the edge costs: {scale:?}");

    sees_what_happened(&probe, &dataset, &spec);
    plays_and_answers(&model, &probe, &spec, &painted.to_string());
    judges(&model, &probe, &spec);
}

/// What is seen in real clips is what happened.
fn sees_what_happened(probe: &Probe, dataset: &Dataset, spec: &WorldSpec) {
    let eyes = Eyes::new(probe, spec);
    let (mut n_right, mut n) = (0, 0);
    for episode in dataset.episodes().map(Result::unwrap).take(10) {
        for at in [0, 20, 40] {
            let is_safe = !episode.event("over the edge").unwrap()[at..at + 19].contains(&true);
            n_right += usize::from(eyes.watch(&episode.frames[at + 1..at + 20]).is_safe() == is_safe);
            n += 1;
        }
    }
    assert!(n_right * 10 >= n * 8, "{n_right} of {n} clips");
}

fn config(spec: &WorldSpec, protocol: Protocol) -> SimulateConfig {
    SimulateConfig {
        n_queries: 30,
        n_dreams: 4,
        dream_steps: 80,
        reward: RewardConfig::tiny(),
        ..SimulateConfig::of(spec, protocol, 3)
    }
}

/// Dreams are played and asked about, under every protocol, with marks and in rounds.
fn plays_and_answers(model: &WorldModel, probe: &Probe, spec: &WorldSpec, painted: &str) {
    let started = |config: &SimulateConfig| {
        simulate(model, probe, config, model.starts(), &mut |_| ControlFlow::Continue(())).unwrap().unwrap()
    };
    for protocol in [Protocol::Drop, Protocol::Drope, Protocol::Dropj, Protocol::DropjMulti] {
        let config = SimulateConfig {
            n_rounds: if protocol == Protocol::Dropj { 2 } else { 1 },
            strategy: if protocol == Protocol::Dropj { Strategy::SafetyBoundary } else { Strategy::Uniform },
            ..config(spec, protocol)
        };
        let simulated = started(&config);
        assert_eq!(simulated, started(&config), "{protocol:?}: the same seed simulates the same");
        assert!(
            simulated.answers.iter().all(|answered| protocol.permits(&answered.response)),
            "what is asked for"
        );
        // Under DROP, clips that are equal are skipped; and here and there one flickers.
        let n = |response| simulated.answers.iter().filter(|answered| answered.response == response).count();
        let [unclear, odd] =
            [SkipReason::Ambiguous, SkipReason::Hallucinated].map(|why| n(Response::Skipped(Some(why))));
        assert!(
            odd <= 10 && unclear + odd < 25,
            "{protocol:?}: {unclear} and {odd} of 30 queries are skipped"
        );
        let ranges = |action: &Action| spec.checked(action).unwrap() == *action;
        assert!(
            simulated.dreams.iter().all(|dream| dream.len() == 80 && dream.actions.iter().all(ranges)),
            "in the ranges"
        );
        if protocol == Protocol::Dropj {
            let share = simulated.unsafe_share();
            assert!((0.02..0.98).contains(&share), "{share} of the clips are unsafe; {painted}");
            assert!(
                simulated.dreams.iter().any(|dream| !dream.unsafe_marks.is_empty()),
                "somebody went over"
            );
            let both = |answer: &Response| matches!(answer, Response::Safety(SafetyAnswer::Both(_)));
            assert!(simulated.answers.iter().any(|answered| both(&answered.response)), "some are safe");
        }
    }
}

/// Single transitions are judged, of dreams and of trajectories that are made for it.
fn judges(model: &WorldModel, probe: &Probe, spec: &WorldSpec) {
    let sparse = SimulateConfig { n_queries: 98, ..config(spec, Protocol::Dros) };
    let on_progress = &mut |_| ControlFlow::Continue(());
    let judged = simulate_dros(model, probe, &sparse, model.starts(), on_progress).unwrap().unwrap();
    assert!(Verdict::ALL.iter().filter(|verdict| judged.n(**verdict) > 0).count() >= 2, "they differ");
    let (synthesis, learning) = (
        SynthesisConfig { iterations: 2, ..SynthesisConfig::paper() },
        SparseConfig { updates: 20, ..SparseConfig::tiny() },
    );
    let config = config(spec, Protocol::Request);
    let made =
        simulate_request(model, probe, &config, model.starts(), &synthesis, &learning, on_progress).unwrap();
    assert_eq!(made.unwrap().answers.len(), 30, "every query is answered");
}

#[test]
fn recordings_that_a_probe_cannot_be_fitted_on_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut table = Table::new();
    let spec = Arc::clone(table.spec());
    let mut dataset = Dataset::create_or_open(&folder.path().join("data"), "table").unwrap();
    let fit = |dataset: &Dataset, spec: &WorldSpec| {
        let config = FitProbeConfig { n_updates: 2, ..FitProbeConfig::for_world(spec) };
        fit_event_probe(&config, dataset, spec, None, &mut |_| ControlFlow::Continue(())).map(|fit| fit.real)
    };
    record(&mut table, &mut dataset, 0..1, 5, |_| ControlFlow::Continue(())).unwrap();
    assert!(matches!(fit(&dataset, &spec), Err(FitProbeError::TooFew(1))));
    record(&mut table, &mut dataset, 1..3, 5, |_| ControlFlow::Continue(())).unwrap();
    assert_eq!(fit(&dataset, &spec).unwrap().events.len(), 3);

    let other = WorldSpec { name: "chair".to_owned(), ..(*spec).clone() };
    let met = fit(&dataset, &other).unwrap_err().to_string();
    assert!(met.contains("\"table\"") && met.contains("\"chair\""), "{met}");

    let mut larger = (*spec).clone();
    larger.image.height = 24;
    assert!(matches!(fit(&dataset, &larger), Err(FitProbeError::Size { .. })));

    let mut renamed = (*spec).clone();
    renamed.events.iter_mut().for_each(|event| event.name.push('!'));
    assert!(fit(&dataset, &renamed).unwrap().events.is_empty(), "the reward is left");
}
