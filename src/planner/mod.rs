//! Driving by imagining ahead: a few courses of action, the one with the best imagined return (Step 4 of the method).
//!
//! A pure function of state, models and generator. Only the [`Agent`] remembers.

pub mod agent;
pub mod candidates;
pub mod co_driver;
pub mod snippets;
pub mod synthesis;

use rand::Rng;
use serde::{Deserialize, Serialize};
use tch::{Kind, Tensor};

use crate::dream::Rows;
use crate::reward::{RewardModel, scaled_actions_tensor};
use crate::tensor::limits::{MAX_COUNT, OutOfRange, within};
use crate::tensor::{NotFinite, to_vec};
use crate::world::{Action, CandidateSource, MAX_HORIZON, WorldSpec, authors_brake};
use crate::world_model::{Next, State, WorldModel, actions_tensor};

pub use agent::Agent;
pub use candidates::{CandidateSet, Refinement, candidates};
pub use co_driver::CoDriver;
pub use snippets::{Snippets, with_snippets, with_snippets_of};

/// How the planner looks ahead (method §11).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlannerConfig {
    /// H: how many steps it imagines. Paper: 15 for preferences, 25 for sparse rewards. Ours in Car Racing: 25.
    pub horizon: usize,
    /// R: how many steps of a plan are driven before the next plan. Paper: 4.
    pub replan: usize,
    /// τ of the imagined mean. Authors' code: 0.1.
    pub temperature: f64,
    /// After how many steps an agent forgets everything, if ever. Authors' code: 50. The paper does not say so.
    pub memory_reset: Option<usize>,
    /// How hard the candidates of the built-in cars that brake do so; none: as the world's file says. Paper: 0.2 in Car
    /// Racing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub brake: Option<f32>,
    /// Whether it tries the courses that the world's file gives whole, too. The authors' does not.
    #[serde(default = "yes", skip_serializing_if = "is_yes")]
    pub courses: bool,
    /// How a plan is refined once all candidates were looked at, if it is. The authors' is not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refine: Option<Refinement>,
    /// What it chooses among: from the world's file, or from recordings.
    #[serde(skip)]
    pub candidates: CandidateSet,
}

fn yes() -> bool {
    true
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde gives a reference")]
fn is_yes(is: &bool) -> bool {
    *is
}

impl PlannerConfig {
    /// As the world's file says, and where it takes candidates from recordings, from those that `snippets` are of.
    pub fn of(spec: &WorldSpec, snippets: Option<&Snippets>) -> Self {
        let planner = &spec.planner;
        Self {
            horizon: planner.horizon,
            replan: planner.replan,
            temperature: planner.temperature,
            memory_reset: planner.memory_reset,
            brake: None,
            courses: true,
            refine: (planner.candidates.from == CandidateSource::Recordings).then(Refinement::default),
            candidates: CandidateSet::of(spec, snippets),
        }
    }

    /// That for the world of this model, with what its recordings show.
    pub fn of_model(model: &WorldModel) -> Self {
        Self::of_world(model.spec(), model)
    }

    /// That for the world of this file, which may offer other candidates than that of the model, with what was recorded for
    /// the model.
    pub fn of_world(spec: &WorldSpec, model: &WorldModel) -> Self {
        let read = Snippets::read(model.parameters(), spec.axes.len(), model.config().mdn_rnn.latent);
        let snippets = read.unwrap_or_else(|met| {
            log::warn!("the recorded actions in the world model cannot be used: {met}");
            None
        });
        Self::of(spec, snippets.as_ref())
    }

    /// The same among what the world of this model, and its recordings, offer.
    #[must_use]
    pub fn for_model(self, model: &WorldModel) -> Self {
        self.for_world(model.spec(), model)
    }

    /// The same among what the world of this file, and the recordings for the model, offer.
    #[must_use]
    pub fn for_world(self, spec: &WorldSpec, model: &WorldModel) -> Self {
        let Self { candidates, .. } = Self::of_world(spec, model);
        Self { candidates, ..self }
    }

    /// That of a built-in world.
    fn built_in(name: &str) -> Self {
        let spec = WorldSpec::built_in(name).unwrap_or_else(|| unreachable!("it is built in: {name}"));
        Self::of(&spec, None)
    }

    /// The authors' values for Car Racing.
    pub fn paper() -> Self {
        Self::car_racing().authors(&WorldSpec::default())
    }

    /// The authors' planner in this world: in those of the paper 15 steps ahead by their brake (method §11.4), in others as
    /// the world's file says; nothing is refined.
    #[must_use]
    pub fn authors(self, spec: &WorldSpec) -> Self {
        let brake = authors_brake(&spec.name);
        let horizon = if brake.is_some() { 15 } else { self.horizon };
        Self { horizon, brake, courses: brake.is_none(), refine: None, ..self }
    }

    /// Ours for Car Racing: a longer look ahead and a gentler brake.
    ///
    /// `// DIFFERENCE:` within the authors' 15 steps their brake of 0.2 takes far more speed away than any gas can give. So
    /// whichever states a reward likes a little better, it finds more ways to be slow than to be fast, and some cars
    /// crawl. With 0.08 the two are alike. 25 steps let so gentle a brake come in time. assets/results has the measurements.
    pub fn car_racing() -> Self {
        Self::built_in("car-racing")
    }

    /// The same for a reward that was learned from single transitions: it looks 25 steps ahead, as the authors' does.
    pub fn for_transitions(self) -> Self {
        Self { horizon: 25, ..self }
    }

    /// Fails where nobody can look ahead so.
    pub fn check(&self) -> Result<(), OutOfRange> {
        within("the planner's horizon", self.horizon, 1..=MAX_HORIZON)?;
        within("the number of steps from plan to plan", self.replan, 1..=MAX_COUNT)?;
        within("how hard the planner brakes", self.brake.unwrap_or(0.0), 0.0..=1.0)?;
        if let Some(Refinement { rounds, samples, elites, noise }) = self.refine {
            within("the number of rounds that refine a plan", rounds, 0..=100)?;
            within("the number of courses tried in a round", samples, 1..=10_000)?;
            within("the number of the best that the next are drawn around", elites, 1..=10_000)?;
            within("the noise that a plan is refined with", noise, 0.0..=1.0)?;
        }
        within("the planner's temperature", self.temperature, 1e-6..=1e3)?;
        within("the number of steps until all is forgotten", self.memory_reset.unwrap_or(1), 1..=MAX_COUNT)
    }

    /// Ours for Obstacle Car Racing with chuckholes and other cars: the authors' brake there, and a longer look ahead.
    ///
    /// `// DIFFERENCE:` 25 steps instead of 15, as in [`Self::car_racing`], and courses that change lanes, too.
    pub fn obstacle_car_racing() -> Self {
        Self::built_in("obstacle-car-racing")
    }

    /// Ours for Obstacle Car Racing with chuckholes alone: a longer look ahead, and a gentler brake.
    ///
    /// `// DIFFERENCE:` 25 steps instead of 15 and a brake of 0.05 instead of 0.1, as in [`Self::car_racing`].
    /// Beside the authors' courses it tries gentle turns and changes of lane, without which nobody gets around what lies ahead:
    /// assets/results has the measurements.
    pub fn obstacle_car_racing_chuckholes() -> Self {
        Self::built_in("obstacle-car-racing-chuckholes")
    }
}

/// A course of action and what is imagined to come of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// H actions.
    pub actions: Vec<Action>,
    /// The sum of the imagined rewards.
    pub predicted_return: f32,
    /// The latents that it passes through, `[H, Z]`. The first row is the present.
    pub zs: Rows,
}

/// All candidates, and the choice among them.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// In the order of [`candidates()`].
    pub candidates: Vec<Candidate>,
    /// Which one is driven: the first of the highest return.
    pub chosen: usize,
}

impl Plan {
    /// The candidate that is driven.
    pub fn best(&self) -> &Candidate {
        &self.candidates[self.chosen]
    }
}

/// Imagines every candidate from `state` and chooses the best.
///
/// Where a return is not a number there is nothing to choose by. Where plans are refined, what is left of the `last`
/// one is a candidate too, and what refinement finds comes last.
///
/// # Shapes
/// - `state`: a batch of one
pub fn plan(
    model: &WorldModel,
    reward: &impl RewardModel,
    state: &State,
    config: &PlannerConfig,
    last: Option<&Plan>,
    rng: &mut impl Rng,
) -> Result<Plan, NotFinite> {
    let mut all = candidates(config, rng);
    let Some(refinement) = config.refine else { return evaluate(model, reward, state, config, all) };
    if let Some(rest) =
        last.and_then(|plan| plan.best().actions.get(config.replan..)).filter(|rest| !rest.is_empty())
    {
        all.push(candidates::lasting(rest, config.horizon));
    }
    let mut plan = evaluate(model, reward, state, config, all)?;
    let mut best: Vec<Candidate> = plan.candidates.clone();
    for _ in 0..refinement.rounds {
        best.sort_by(|a, b| b.predicted_return.total_cmp(&a.predicted_return));
        best.truncate(refinement.elites);
        let elites: Vec<&[Action]> = best.iter().map(|candidate| candidate.actions.as_slice()).collect();
        let drawn = refinement.draw(&elites, model.ranges(), rng);
        best.extend(evaluate(model, reward, state, config, drawn)?.candidates);
    }
    let returns: Vec<f32> = best.iter().map(|candidate| candidate.predicted_return).collect();
    let found = &best[first_maximum(&returns)];
    if found.predicted_return > plan.best().predicted_return {
        plan.chosen = plan.candidates.len();
        plan.candidates.push(found.clone());
    }
    Ok(plan)
}

/// Evaluates the courses of action `all` by imagining them from `state`, which are equally long, and chooses the best.
///
/// ```text
/// return = Σ_{t=0}^{H−1} r̂(x_t, ã_t)
/// ```
fn evaluate(
    model: &WorldModel,
    reward: &impl RewardModel,
    state: &State,
    config: &PlannerConfig,
    all: Vec<Vec<Action>>,
) -> Result<Plan, NotFinite> {
    let (n, horizon) = (all.len() as i64, config.horizon as i64);
    let by_time: Vec<Action> =
        (0..config.horizon).flat_map(|t| all.iter().map(move |actions| actions[t])).collect();
    let device = model.backend().device;
    let actions =
        actions_tensor(&by_time).view([horizon, n, model.ranges().n_axes() as i64]).to_device(device);
    let mut state = state.repeated(n).on(device);
    let (mut features, mut zs) = (vec![state.features()], vec![state.z.shallow_clone()]);
    // DIFFERENCE: the paper adds H + 1 rewards, the authors' code H (method §14.9): the state after the last action
    // is not needed.
    for t in 0..horizon - 1 {
        state = model.imagine(&state, &actions.select(0, t), Next::Mean { temperature: config.temperature });
        features.push(state.features());
        zs.push(state.z.shallow_clone());
    }
    let scaled_actions = scaled_actions_tensor(&by_time, model.ranges()).view([horizon, n, -1]);
    let rewards = reward.rewards(&Tensor::stack(&features, 0), &scaled_actions); // [H, S]
    let returns = to_vec(&rewards.sum_dim_intlist(0, false, Kind::Float));
    if let Some(i) = returns.iter().position(|promised| !promised.is_finite()) {
        return Err(NotFinite(format!("what the planner promises itself of its course of action {}", i + 1)));
    }
    let zs = Tensor::stack(&zs, 1); // [S, H, Z]
    let width = zs.size()[2] as usize;
    let zs = to_vec(&zs);
    let zs = zs.chunks_exact(width * config.horizon).map(|values| Rows { width, values: values.to_vec() });
    let imagined = all.into_iter().zip(zs).zip(&returns);
    let candidates =
        imagined.map(|((actions, zs), &predicted_return)| Candidate { actions, predicted_return, zs });
    Ok(Plan { candidates: candidates.collect(), chosen: first_maximum(&returns) })
}

/// Where the highest of `values` comes first.
fn first_maximum(values: &[f32]) -> usize {
    (1..values.len()).fold(0, |best, i| if values[i] > values[best] { i } else { best })
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::reward::{RewardConfig, RewardEnsemble};
    use crate::world::cars::{CarRacing, Env as _, Seed};
    use crate::world_model::{WorldModelConfig, untrained};

    /// Likes steering to the right.
    struct RightTurner;

    impl RewardModel for RightTurner {
        fn rewards(&self, _: &Tensor, scaled_actions: &Tensor) -> Tensor {
            scaled_actions.select(-1, 0)
        }
    }

    fn rng() -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(0)
    }

    fn here(model: &WorldModel) -> State {
        State { z: Tensor::ones([1, 4], tch::kind::FLOAT_CPU), memory: model.no_memory(1) }
    }

    // method §11, and ours in Car Racing: see `PlannerConfig::car_racing`.
    #[test]
    fn built_in_worlds_look_ahead_as_the_authors_do_or_as_we_measured() {
        let brake = |config: &PlannerConfig| {
            let all = candidates(config, &mut rng());
            all[14][0][2]
        };
        let told =
            |config: &PlannerConfig| (config.horizon, config.replan, config.memory_reset, brake(config));
        assert_eq!(told(&PlannerConfig::car_racing()), (25, 4, Some(50), 0.08));
        assert_eq!(told(&PlannerConfig::paper()), (15, 4, Some(50), 0.2));
        for (name, brake) in [("obstacle-car-racing", 0.05), ("obstacle-car-racing-chuckholes", 0.1)] {
            let ours = PlannerConfig::built_in(name);
            assert_eq!(told(&ours), (25, 4, Some(50), 0.05));
            let spec = WorldSpec::built_in(name).unwrap();
            assert_eq!(candidates(&ours, &mut rng()).len(), 37);
            let authors = ours.authors(&spec);
            assert_eq!(told(&authors), (15, 4, Some(50), brake));
            assert_eq!(candidates(&authors, &mut rng()).len(), 15);
        }
        let other = WorldSpec { name: "arm".to_owned(), ..WorldSpec::default() };
        assert_eq!(told(&PlannerConfig::of(&other, None).authors(&other)), (25, 4, Some(50), 0.08));
        assert!(PlannerConfig::car_racing().refine.is_none() && PlannerConfig::paper().temperature == 0.1);
    }

    #[test]
    fn another_file_of_a_world_may_offer_other_candidates() {
        let model = untrained(&WorldModelConfig::tiny(), &mut rng());
        let mut spec = WorldSpec::clone(model.spec());
        spec.planner.candidates.stages.clear();
        spec.planner.candidates.constant.truncate(2);
        let config = PlannerConfig::of_world(&spec, &model);
        assert_eq!(candidates(&config, &mut rng()).len(), 2);
        assert_eq!(candidates(&config.clone().for_world(&spec, &model), &mut rng()).len(), 2);
        assert_eq!(candidates(&config.for_model(&model), &mut rng()).len(), 15);
    }

    #[test]
    fn a_refined_plan_is_never_worse_and_goes_on_with_the_last() {
        let model = untrained(&WorldModelConfig::tiny(), &mut rng());
        let config = PlannerConfig { refine: Some(Refinement::default()), ..PlannerConfig::car_racing() };
        let plain = plan(&model, &RightTurner, &here(&model), &PlannerConfig::car_racing(), None, &mut rng())
            .unwrap();
        let refined = plan(&model, &RightTurner, &here(&model), &config, None, &mut rng()).unwrap();
        assert_eq!(refined.candidates[..15], plain.candidates[..]);
        assert!(refined.best().predicted_return >= plain.best().predicted_return);
        let next = plan(&model, &RightTurner, &here(&model), &config, Some(&refined), &mut rng()).unwrap();
        assert_eq!(next.candidates[15].actions[..21], refined.best().actions[4..], "what is left of it");
    }

    #[test]
    fn the_first_of_the_best_candidates_is_chosen() {
        let model = untrained(&WorldModelConfig::tiny(), &mut rng());
        let plan = plan(&model, &RightTurner, &here(&model), &PlannerConfig::car_racing(), None, &mut rng())
            .unwrap();
        // Candidates 2 and 5 turn right throughout. The former comes first.
        assert_eq!((plan.chosen, plan.best().predicted_return), (2, 25.0));
        assert_eq!(plan.candidates[0].predicted_return, 0.0);
        assert_eq!(first_maximum(&[1.0, 3.0, 3.0, f32::NAN]), 1);
    }

    #[test]
    fn nothing_is_chosen_by_what_is_no_number() {
        struct NoNumber;
        impl RewardModel for NoNumber {
            fn rewards(&self, _: &Tensor, scaled_actions: &Tensor) -> Tensor {
                scaled_actions.select(-1, 0).log() // of what is below 0 it is none
            }
        }
        let model = untrained(&WorldModelConfig::tiny(), &mut rng());
        let met = plan(&model, &NoNumber, &here(&model), &PlannerConfig::car_racing(), None, &mut rng())
            .unwrap_err();
        assert!(met.to_string().contains("course of action 1"), "{met}");
    }

    #[test]
    fn imagining_all_at_once_is_imagining_one_after_the_other() {
        let model = untrained(&WorldModelConfig::tiny(), &mut rng());
        let reward =
            RewardEnsemble::new((36, "sha256:0"), RewardConfig::tiny(), &mut rng()).in_kind(Kind::Float);
        let config = PlannerConfig::car_racing();
        let together = plan(&model, &reward, &here(&model), &config, None, &mut rng()).unwrap();
        for one in &together.candidates {
            let alone = evaluate(&model, &reward, &here(&model), &config, vec![one.actions.clone()]).unwrap();
            assert!((alone.best().predicted_return - one.predicted_return).abs() < 1e-4);
            let apart = alone.best().zs.values.iter().zip(&one.zs.values).map(|(a, b)| (a - b).abs());
            assert!(apart.fold(0.0, f32::max) < 1e-5, "the latents are the same too");
        }
    }

    #[test]
    fn our_brake_takes_about_as_much_speed_as_gas_gives_and_the_authors_takes_more() {
        let after = |last: Action| {
            let mut car = CarRacing::new(Seed::Native(0));
            let gas = Action::new([0.0, 0.2, 0.0]);
            for action in [vec![gas; 60], vec![last; 15]].concat() {
                car.advance((&*action).into());
            }
            assert_eq!(car.truth().wheels_off, 0, "grass would slow it down too");
            car.truth().speed
        };
        let coasting = after(Action::new([0.0; 3]));
        let given = after(Action::new([0.0, 0.2, 0.0])) - coasting;
        let taken =
            |config: &PlannerConfig| coasting - after(Action::new([0.0, 0.1, config.brake.unwrap_or(0.08)]));
        let [ours, authors] =
            [PlannerConfig::car_racing(), PlannerConfig::paper()].map(|config| taken(&config));
        assert!((0.5 * given..2.0 * given).contains(&ours), "gas gives {given}, the brake takes {ours}");
        assert!(authors > 3.0 * given, "gas gives {given}, the authors' brake takes {authors}");
    }

    #[test]
    fn a_return_is_the_sum_of_the_rewards_along_the_way() {
        let model = untrained(&WorldModelConfig::tiny(), &mut rng());
        let reward =
            RewardEnsemble::new((36, "sha256:0"), RewardConfig::tiny(), &mut rng()).in_kind(Kind::Float);
        let config = PlannerConfig { horizon: 4, ..PlannerConfig::car_racing() };
        let best = plan(&model, &reward, &here(&model), &config, None, &mut rng()).unwrap().best().clone();
        let (mut state, mut sum) = (here(&model), 0.0);
        for action in &best.actions {
            let scaled = scaled_actions_tensor(&[*action], model.ranges());
            sum += reward.rewards(&state.features(), &scaled).double_value(&[0]) as f32;
            state = model.imagine(&state, &actions_tensor(&[*action]), Next::Mean { temperature: 0.1 });
        }
        assert!((best.predicted_return - sum).abs() < 1e-5, "{} and {sum}", best.predicted_return);
        assert_eq!(best.zs.len(), 4);
    }
}
