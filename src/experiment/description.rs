//! What an experiment is: the axes along which trials differ, in a file that a person can write.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde::{Deserialize, Serialize};

use super::mistakes::Mistakes;
use super::options::{Search, WorldModels};
use crate::planner::PlannerConfig;
use crate::query::{Justifications, Protocol, Strategy, Weights};
use crate::reward::{Learned, RewardConfig};
use crate::simulate::player::Manner;
use crate::simulate::{Annotator, SimulateConfig};
use crate::world::WorldSpec;

/// The only version of the format.
pub const FORMAT: u32 = 1;
/// No experiment has more trials, variants of a trial, or episodes of a variant.
const MOST: usize = 10_000;

/// An experiment. Every list is an axis, and all combinations are tried.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Description {
    /// [`FORMAT`].
    pub format: u32,
    /// Its name, as that of a folder.
    pub name: String,
    /// What it asks, in one line.
    pub title: String,
    /// Where the paper asks the same.
    #[serde(default)]
    pub paper: String,
    /// The world: the name of one that is built in, or the path of its file.
    pub world: String,
    /// Its world model, if not the one that belongs to the world.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub world_model: Option<String>,
    /// From how many recorded episodes world models are learned, if that is asked.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub recorded: Vec<usize>,
    /// What people are asked.
    pub methods: Vec<Protocol>,
    /// Each is a chain of its own: of dreams, answers and fits.
    pub seeds: Vec<u64>,
    /// Dreams of a chain.
    pub dreams: usize,
    /// Steps of a dream.
    #[serde(default = "thousand")]
    pub dream_steps: usize,
    /// Queries about pairs of clips.
    pub queries: usize,
    /// Queries about single steps, for DROS and ReQueST.
    #[serde(default)]
    pub verdicts: usize,
    /// How pairs are chosen.
    #[serde(default = "uniform")]
    pub strategies: Vec<Strategy>,
    /// What players in dreams are after.
    #[serde(default)]
    pub manner: Manner,
    /// After how many answers a reward is learned; all, where it is empty. More than there are count as all.
    #[serde(default)]
    pub first: Vec<usize>,
    /// What answers weigh; as the world's file says, where it is empty.
    #[serde(default)]
    pub weights: Vec<WeightSet>,
    /// How often answers are wrong.
    #[serde(default)]
    pub mistakes: Vec<Mistakes>,
    /// Who answers.
    #[serde(default)]
    pub annotators: Vec<Annotators>,
    /// How rewards are learned.
    #[serde(default = "our_fit")]
    pub fits: Vec<Fit>,
    /// How it is driven.
    #[serde(default = "our_plans")]
    pub planners: Vec<Plans>,
    /// Episodes of each reward.
    pub episodes: u64,
    /// The seed of the first episode; all drive the same.
    #[serde(default = "hundred")]
    pub first_track: u64,
    /// After so many steps an episode is over, if it is not before.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub episode_steps: Option<usize>,
    /// Whether the paper's driving aids help, where there are obstacles.
    #[serde(default = "yes")]
    pub aids: bool,
    /// What figures are drawn over.
    #[serde(default)]
    pub axis: Axis,
    /// Whether the gradients of answers are measured while a reward learns from them.
    #[serde(default, skip_serializing_if = "is_false")]
    pub gradients: bool,
    /// Whether it is measured how long this machine takes for a trajectory to be labeled: DROS's and `ReQueST`'s.
    #[serde(default, skip_serializing_if = "is_false")]
    pub times: bool,
    /// Steps of the gradient by which `ReQueST` searches for a trajectory. The authors' code: 200.
    #[serde(default = "two_hundred", skip_serializing_if = "is_two_hundred")]
    pub iterations: usize,
    /// So many states of each method's labeled trajectories are laid out in the plane; none where it is 0.
    #[serde(default, skip_serializing_if = "is_none")]
    pub states: usize,
    /// How world models are learned, where `recorded` asks for that.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub world_models: Option<WorldModels>,
    /// How weights are searched for, if they are.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub search: Option<Search>,
}

/// What answers weigh, by name: `default`, `safety` and the world's justifications. What is not named weighs what it does.
pub type WeightSet = BTreeMap<String, f32>;

/// What figures are drawn over.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Axis {
    /// The number of answers.
    #[default]
    Answers,
    /// The time that a person takes for them.
    Minutes,
    /// Wrong answers to critical queries.
    CriticalMistakes,
    /// The episodes that the world model was learned from.
    Recorded,
    /// What differs is no number.
    Variants,
}

/// People of different taste.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Annotators {
    /// Makes no mistake and keeps away from the edge.
    #[default]
    Careful,
    /// Wants to get on: does not mind the edge, and sees every difference.
    Hasty,
    /// Errs as people do: B-Pref's mistakes of a tenth, and one safety judgement in twenty.
    Fallible,
}

impl Annotators {
    /// How they answer.
    pub fn annotator(self) -> Annotator {
        let careful = Annotator::careful();
        match self {
            Self::Careful => careful,
            Self::Hasty => Annotator { care: 0.0, eps_equal: 0.05, ..careful },
            Self::Fallible => Annotator { eps_mistake: 0.1, eps_safety: 0.05, ..careful },
        }
    }
}

/// How a reward is learned.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Fit {
    /// As we do: [`Schedule::Falling`](crate::reward::Schedule).
    #[default]
    Ours,
    /// The same, and what answers name: [`Learned::Hazards`].
    Hazards,
    /// As the authors do: [`Schedule::Authors`](crate::reward::Schedule).
    Paper,
}

/// How it is driven.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Plans {
    /// As the world's file says.
    #[default]
    Ours,
    /// The same without the courses that the file gives whole.
    WithoutCourses,
    /// As the authors do.
    Paper,
    /// In copies of the world itself, by its own reward: nothing is learned.
    Oracle,
}

/// One chain: a method, a way to choose queries, and a seed.
#[derive(Clone, Debug, PartialEq)]
pub struct Trial {
    /// Its place among all, from 0.
    pub index: usize,
    /// What is asked.
    pub method: Protocol,
    /// How pairs are chosen.
    pub strategy: Strategy,
    /// From how many recorded episodes its world model was learned; none where it was there before.
    pub recorded: Option<usize>,
    /// The seed.
    pub seed: u64,
}

/// What is made of the answers of a trial.
#[derive(Clone, Debug, PartialEq)]
pub struct Variant {
    /// So many answers, or all.
    pub first: Option<usize>,
    /// What they weigh.
    pub weights: WeightSet,
    /// Whether these weights were found by a search.
    pub found: bool,
    /// How many are wrong.
    pub mistakes: Mistakes,
    /// Who answers.
    pub annotators: Annotators,
    /// How they are learned.
    pub fit: Fit,
    /// How it is driven.
    pub plans: Plans,
}

/// Why an experiment cannot be.
#[derive(Debug, thiserror::Error)]
pub enum DescriptionError {
    /// The text is none.
    #[error("this is no description of an experiment: {0}")]
    Toml(#[from] toml::de::Error),
    /// A value is none.
    #[error("in the experiment {name:?}, {what}")]
    Value {
        /// Of which.
        name: String,
        /// What is wrong.
        what: String,
    },
}

impl Description {
    /// That in a file.
    ///
    /// # Errors
    /// Where it is none, or says what cannot be.
    pub fn from_toml(text: &str) -> Result<Self, DescriptionError> {
        let description: Self = toml::from_str(text)?;
        description.check()?;
        Ok(description)
    }

    /// As [`from_toml`](Self::from_toml) reads it.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).unwrap_or_else(|met| unreachable!("plain values: {met}"))
    }

    /// Fails where no such experiment can be made.
    pub fn check(&self) -> Result<(), DescriptionError> {
        let wrong = |what: String| Err(DescriptionError::Value { name: self.name.clone(), what });
        if self.format != FORMAT {
            return wrong(format!("the format is {}, and this program knows {FORMAT}", self.format));
        }
        let is_name = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if self.name.is_empty() || !self.name.chars().all(is_name) {
            return wrong("the name must be of letters, digits, - and _: it names a folder".to_owned());
        }
        if self.methods.is_empty() || self.seeds.is_empty() || self.strategies.is_empty() {
            return wrong("there must be at least one of methods, seeds and strategies each".to_owned());
        }
        if self.fits.is_empty() || self.planners.is_empty() {
            return wrong("there must be at least one of fits and planners each".to_owned());
        }
        // What is measured while rewards learn need not be driven.
        let least_driven = usize::from(!self.gradients);
        let n_worlds = self.recorded.len().max(1);
        let counts = [
            ("dreams", 1, self.dreams),
            ("dream-steps", 1, self.dream_steps),
            ("episodes", least_driven, self.episodes as usize),
            ("trials", 1, self.methods.len() * self.strategies.len() * self.seeds.len() * n_worlds),
            ("states", 0, self.states),
            ("iterations", 1, self.iterations),
        ];
        for (what, least, n) in counts {
            if !(least..=MOST).contains(&n) {
                return wrong(format!("{what} must be {least} to {MOST}, and are {n}"));
            }
        }
        if self.dreams.saturating_mul(self.dream_steps) > 10_000_000 {
            return wrong("the dreams of a trial have more than 10000000 steps in all".to_owned());
        }
        let is_sparse = self.methods.iter().any(|method| method.is_sparse());
        if is_sparse && self.verdicts == 0 {
            return wrong("methods that ask for verdicts need a number of verdicts".to_owned());
        }
        if self.methods.iter().any(|method| !method.is_sparse()) && self.queries == 0 {
            return wrong("methods that ask about pairs need a number of queries".to_owned());
        }
        let is_share = |share: f64| (0.0..=1.0).contains(&share);
        if self.mistakes.iter().any(|it| !is_share(it.critical) || !is_share(it.other)) {
            return wrong("mistakes are shares between 0 and 1".to_owned());
        }
        if self.weights.iter().flat_map(BTreeMap::values).any(|weight| !(*weight > 0.5 && *weight <= 1.0)) {
            return wrong("weights must be above 0.5 and at most 1".to_owned());
        }
        self.check_measures()
    }

    /// Fails where what is measured beside driving cannot be.
    fn check_measures(&self) -> Result<(), DescriptionError> {
        let wrong = |what: String| Err(DescriptionError::Value { name: self.name.clone(), what });
        if self.recorded.iter().any(|n| !(1..=MOST).contains(n)) {
            return wrong(format!("world models are learned from 1 to {MOST} episodes"));
        }
        if self.recorded.is_empty() == self.world_models.is_some() {
            return wrong(
                "`recorded`, a list of numbers, and a section [world-models] go together".to_owned(),
            );
        }
        if self.world_models.is_some() && self.world_model.is_some() {
            return wrong("a world model is either given or learned".to_owned());
        }
        if (self.search.is_some() || self.gradients) && self.methods.iter().any(|method| method.is_sparse()) {
            return wrong("weights and gradients are those of answers about pairs".to_owned());
        }
        if self.search.is_some() && (self.episodes == 0 || self.planners != [Plans::Ours]) {
            return wrong("weights are searched for by driving with the planner `ours`".to_owned());
        }
        let fault = self.world_models.as_ref().and_then(WorldModels::fault);
        match fault.or_else(|| self.search.as_ref().and_then(Search::fault)) {
            Some(fault) => wrong(fault),
            None => Ok(()),
        }
    }

    /// Fails where its weights name what the world `spec` does not know.
    pub fn check_for(&self, spec: &WorldSpec) -> Result<(), DescriptionError> {
        let known = Weights::of(spec).justifications;
        let searched = self.search.iter().flat_map(|search| &search.weights);
        for name in self.weights.iter().flat_map(BTreeMap::keys).chain(searched) {
            let is_known = name == "safety" || known.named(name).is_ok();
            if !is_known {
                let names = known.iter().map(|(_, name, _)| name).collect::<Vec<_>>().join(", ");
                let what = format!("{name:?} weighs something, and {:?} knows safety, {names}", spec.name);
                return Err(DescriptionError::Value { name: self.name.clone(), what });
            }
        }
        Ok(())
    }

    /// All its trials: the first seed of every method and strategy comes before the second of any.
    pub fn trials(&self) -> Vec<Trial> {
        let mut trials = Vec::new();
        for &seed in &self.seeds {
            for &method in &self.methods {
                // A trajectory is asked about as a whole, however pairs would be chosen.
                let n = if method.is_sparse() { 1 } else { self.strategies.len() };
                for &strategy in &self.strategies[..n] {
                    let worlds: Vec<_> = if self.recorded.is_empty() {
                        vec![None]
                    } else {
                        self.recorded.iter().copied().map(Some).collect()
                    };
                    for recorded in worlds {
                        trials.push(Trial { index: trials.len(), method, strategy, recorded, seed });
                    }
                }
            }
        }
        trials
    }

    /// What is made of the answers of each trial of this method. Without a reward there is nothing to vary.
    pub fn variants(&self, method: Protocol) -> Vec<Variant> {
        fn or<T: Clone>(list: &[T], usual: T) -> Vec<T> {
            if list.is_empty() { vec![usual] } else { list.to_vec() }
        }
        let firsts: Vec<Option<usize>> =
            if self.first.is_empty() { vec![None] } else { self.first.iter().copied().map(Some).collect() };
        let mut variants: Vec<Variant> = Vec::new();
        for &plans in &self.planners {
            for &fit in &self.fits {
                for &annotators in &or(&self.annotators, Annotators::Careful) {
                    for &mistakes in &or(&self.mistakes, Mistakes::NONE) {
                        for weights in &or(&self.weights, WeightSet::new()) {
                            for &first in &firsts {
                                let weights = weights.clone();
                                let found = false;
                                variants.push(Variant {
                                    first,
                                    weights,
                                    found,
                                    mistakes,
                                    annotators,
                                    fit,
                                    plans,
                                });
                            }
                        }
                    }
                }
            }
        }
        let most = if method.is_sparse() { self.verdicts } else { self.queries };
        for variant in &mut variants {
            variant.first = variant.first.map(|first| first.min(most));
            variant.simplify(method);
        }
        let mut distinct: Vec<Variant> = Vec::new();
        for variant in variants {
            if !distinct.contains(&variant) {
                distinct.push(variant);
            }
        }
        distinct
    }

    /// What a trial simulates, in this world.
    pub fn simulation(&self, trial: &Trial, spec: &WorldSpec) -> SimulateConfig {
        let n_queries = if trial.method.is_sparse() { self.verdicts } else { self.queries };
        SimulateConfig {
            n_queries,
            n_dreams: self.dreams,
            dream_steps: self.dream_steps,
            manner: self.manner,
            strategy: trial.strategy,
            ..SimulateConfig::of(spec, trial.method, trial.seed)
        }
    }
}

impl Variant {
    /// Leaves out what says nothing under this method.
    fn simplify(&mut self, method: Protocol) {
        if method.is_sparse() {
            (self.weights, self.mistakes, self.fit) = (WeightSet::new(), Mistakes::NONE, Fit::Ours);
        }
        if self.plans == Plans::Oracle {
            *self = Self {
                first: None,
                weights: WeightSet::new(),
                found: false,
                mistakes: Mistakes::NONE,
                annotators: Annotators::Careful,
                fit: Fit::Ours,
                plans: Plans::Oracle,
            };
        }
    }

    /// The weights of a world with those of this variant.
    pub fn weights(&self, spec: &WorldSpec) -> Weights {
        let usual = Weights::of(spec);
        let of = |name: &str, usual: f32| self.weights.get(name).copied().unwrap_or(usual);
        let named = usual.justifications.iter().map(|(_, name, weight)| (name.to_owned(), of(name, weight)));
        let justifications = Justifications::new(named.collect::<Vec<_>>());
        Weights {
            safety: of("safety", usual.safety),
            default: of("default", usual.default),
            justifications: justifications.unwrap_or_else(|met| unreachable!("checked: {met}")),
        }
    }

    /// How its reward is fitted, in this world.
    pub fn reward(&self, usual: &RewardConfig, spec: &WorldSpec) -> RewardConfig {
        match self.fit {
            Fit::Ours => usual.clone(),
            Fit::Hazards => RewardConfig { learned: Learned::Hazards, ..usual.clone() },
            Fit::Paper => usual.clone().authors(spec.justifications.len()),
        }
    }

    /// How its reward drives.
    pub fn planner(&self, usual: PlannerConfig, spec: &WorldSpec) -> PlannerConfig {
        match self.plans {
            Plans::Ours | Plans::Oracle => usual,
            Plans::WithoutCourses => PlannerConfig { courses: false, ..usual },
            Plans::Paper => usual.authors(spec),
        }
    }

    /// Its weights in a few characters: `default 0.75, safety 1`.
    pub fn weights_shown(&self) -> String {
        let mut text = String::new();
        for (name, weight) in &self.weights {
            let _ = write!(text, "{}{name} {weight}", if text.is_empty() { "" } else { ", " });
        }
        text
    }
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde hands over a reference")]
fn is_false(value: &bool) -> bool {
    !value
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde hands over a reference")]
fn is_none(n: &usize) -> bool {
    *n == 0
}

fn two_hundred() -> usize {
    200
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde hands over a reference")]
fn is_two_hundred(n: &usize) -> bool {
    *n == two_hundred()
}

fn thousand() -> usize {
    1000
}

fn hundred() -> u64 {
    100
}

fn yes() -> bool {
    true
}

fn uniform() -> Vec<Strategy> {
    vec![Strategy::Uniform]
}

fn our_fit() -> Vec<Fit> {
    vec![Fit::Ours]
}

fn our_plans() -> Vec<Plans> {
    vec![Plans::Ours]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::{Scale, named, names};

    #[test]
    fn every_named_experiment_survives_its_file_at_every_scale() {
        for name in names() {
            for scale in [Scale::Full, Scale::Quick, Scale::Toy] {
                let description = named(name).unwrap().at(scale);
                assert_eq!(description.name, name);
                description.check().unwrap();
                let spec = WorldSpec::built_in(&description.world).unwrap();
                description.check_for(&spec).unwrap();
                assert_eq!(Description::from_toml(&description.to_toml()).unwrap(), description, "{name}");
                let n_rows: usize =
                    description.trials().iter().map(|trial| description.variants(trial.method).len()).sum();
                assert!(n_rows >= 2, "{name} compares something");
                if scale == Scale::Toy {
                    assert!(n_rows < 60, "{name} has {n_rows} rewards to learn at its smallest");
                }
            }
        }
        assert!(named("elsewhere").is_none());
    }

    #[test]
    fn what_cannot_be_is_refused_in_words() {
        let good = named("weights").unwrap();
        let text = good.to_toml();
        for (from, to, said) in [
            ("format = 1", "format = 2", "the format is 2"),
            ("name = \"weights\"", "name = \"../weights\"", "names a folder"),
            ("dreams = 10", "dreams = 0", "dreams must be 1"),
            ("methods = [\"dropj\"]", "methods = []", "at least one of methods"),
            ("methods = [\"dropj\"]", "methods = [\"dros\"]", "number of verdicts"),
            ("methods = [\"dropj\"]", "methods = [\"best\"]", "unknown variant"),
            ("world =", "whorld =", "unknown field"),
        ] {
            assert!(text.contains(from), "{from} in {text}");
            let met = Description::from_toml(&text.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(met.contains(said), "{to}: {met}");
        }
        let mut odd = good;
        odd.weights = vec![[("ice".to_owned(), 0.9)].into()];
        let met = odd.check_for(&WorldSpec::default()).unwrap_err().to_string();
        assert!(met.contains("\"ice\" weighs something"), "{met}");
        odd.weights = vec![[("safety".to_owned(), 0.4)].into()];
        assert!(odd.check().is_err());
        let search = named("learned-weights").unwrap();
        let spec = WorldSpec::default();
        search.check_for(&spec).unwrap();
        let with = |change: &dyn Fn(&mut Search)| {
            let mut search = search.clone();
            search.search.iter_mut().for_each(change);
            search.check().and_then(|()| search.check_for(&spec)).unwrap_err().to_string()
        };
        assert!(with(&|it| it.weights = vec!["ice".to_owned()]).contains("\"ice\" weighs something"));
        assert!(with(&|it| it.evaluations = 0).contains("evaluations"));
        assert!(with(&|it| it.tracks = 0).contains("tracks"));
        let mut world_size = named("world-size").unwrap();
        world_size.recorded.clear();
        assert!(world_size.check().unwrap_err().to_string().contains("go together"));
    }

    #[test]
    fn without_courses_it_is_planned_among_the_others() {
        let spec = WorldSpec::built_in("obstacle-car-racing-chuckholes").unwrap();
        let rng = &mut <rand_chacha::ChaCha8Rng as rand::SeedableRng>::seed_from_u64(0);
        let mut n = |plans: Plans| {
            let all = Description { planners: vec![plans], ..named("q4-obstacles").unwrap() };
            let variant = all.variants(Protocol::DropjMulti).remove(0);
            let config = variant.planner(PlannerConfig::of(&spec, None), &spec);
            crate::planner::candidates(&config, rng).len()
        };
        assert_eq!([Plans::Ours, Plans::WithoutCourses, Plans::Paper].map(&mut n), [37, 15, 15]);
    }

    #[test]
    fn an_oracle_learns_nothing_and_so_has_one_variant() {
        let all = named("oracle").unwrap();
        let variants = all.variants(Protocol::Dropj);
        assert_eq!(variants.iter().filter(|variant| variant.plans == Plans::Oracle).count(), 1);
        assert!(variants.len() > 1, "beside what is learned");
    }
}
