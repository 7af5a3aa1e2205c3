//! Weights that are searched for by CMA-ES, so that a reward drives far and stays below soft limits (the paper's outlook, §6.2).

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fmt::Write as _;

use cmaes::{CMAESOptions, DVector, Mode};
use serde::{Deserialize, Serialize};

use super::charts::{Curve, Figure, FigureError, Lines, Place, Words, drawn};
use super::description::{Description, WeightSet};
use super::options::Search;
use super::table::csv;
use crate::evaluation::EpisodeMetrics;

/// A weight is a share of preferences, and more than half.
const LEAST: f64 = 0.51;
/// Where the search begins, and how far about that it looks at first.
const BEGIN: (f64, f64) = (0.8, 0.15);

/// Weights that were tried.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Evaluation {
    /// The number of its trial.
    pub trial: usize,
    /// The seed of the chain.
    pub seed: u64,
    /// Which of the search it was, from 0.
    pub number: usize,
    /// The weights.
    pub weights: WeightSet,
    /// The mean return on the search's tracks.
    pub ret: f64,
    /// The mean of each rate that has a limit.
    pub rates: BTreeMap<String, f64>,
    /// What is to be large.
    pub worth: f64,
}

/// What came of driving with some weights: mean return and mean rates.
pub(super) fn evaluated(search: &Search, episodes: &[EpisodeMetrics]) -> (f64, BTreeMap<String, f64>, f64) {
    let mean = |values: Vec<f64>| {
        let n = values.len();
        if n == 0 { 0.0 } else { values.iter().sum::<f64>() / n as f64 }
    };
    let ret = mean(episodes.iter().map(|it| f64::from(it.ret)).collect());
    let rate = |episode: &EpisodeMetrics, key: &str| {
        if key == "unsafe_rate" {
            return Some(f64::from(episode.unsafe_rate));
        }
        let figure = episode.events.iter().find(|figure| figure.key() == key)?;
        figure.value.map(f64::from)
    };
    let rates: BTreeMap<String, f64> = search
        .limits
        .keys()
        .map(|key| (key.clone(), mean(episodes.iter().filter_map(|episode| rate(episode, key)).collect())))
        .collect();
    // In digits that survive their file, so that a search goes on with the same numbers.
    let rounded = |value: f64, by: f64| (value * by).round() / by;
    let rates: BTreeMap<String, f64> =
        rates.into_iter().map(|(key, rate)| (key, rounded(rate, 1e6))).collect();
    let ret = rounded(ret, 1e3);
    let above = search.limits.iter().map(|(key, limit)| (rates[key] - limit).max(0.0)).sum::<f64>();
    let worth = rounded(ret - search.penalty * above, 1e3);
    (ret, rates, worth)
}

/// The best weights of a search in which `evaluate` says what weights of a number are worth. It is asked for each in turn, and
/// whoever remembers what it said goes on where a search was left: the same seed asks for the same.
///
/// # Errors
/// The first that `evaluate` meets.
pub(super) fn searched<E>(
    search: &Search,
    seed: u64,
    evaluate: &mut dyn FnMut(usize, &WeightSet) -> Result<f64, E>,
) -> Result<Option<WeightSet>, E> {
    let failed: RefCell<Option<E>> = RefCell::new(None);
    let best: RefCell<Option<(f64, WeightSet)>> = RefCell::new(None);
    let mut number = 0;
    let objective = |x: &DVector<f64>| {
        let weights: WeightSet =
            search.weights.iter().zip(x.iter()).map(|(name, x)| (name.clone(), weight(*x))).collect();
        // Beyond the ends all weights are alike: what lies further out is worth a little less.
        let beyond: f64 = x.iter().map(|x| (x - x.clamp(LEAST, 1.0)).powi(2)).sum();
        match evaluate(number, &weights) {
            Ok(worth) => {
                number += 1;
                if best.borrow().as_ref().is_none_or(|(most, _)| worth > *most) {
                    *best.borrow_mut() = Some((worth, weights));
                }
                worth - 1000.0 * beyond
            }
            Err(met) => {
                *failed.borrow_mut() = Some(met);
                f64::NAN
            }
        }
    };
    let options = CMAESOptions::new(vec![BEGIN.0; search.weights.len()], BEGIN.1)
        .mode(Mode::Maximize)
        .population_size(search.population)
        .max_generations(search.evaluations.div_ceil(search.population))
        // Where all weights drive alike nothing is found, but all that was asked for is tried.
        .tol_fun(0.0)
        .tol_fun_hist(0.0)
        .seed(seed);
    // What cannot be built was checked: there are weights, and a population of at least 2.
    if let Ok(mut cmaes) = options.build(objective) {
        cmaes.run();
    }
    match failed.into_inner() {
        Some(met) => Err(met),
        None => Ok(best.into_inner().map(|(_, weights)| weights)),
    }
}

/// In thousandths, as they are told.
fn weight(x: f64) -> f32 {
    ((1e3 * x.clamp(LEAST, 1.0)).round() / 1e3) as f32
}

/// As the columns of a table.
pub(super) fn columns(search: &Search, all: &[Evaluation]) -> Vec<(String, Vec<String>)> {
    let column = |name: &str, of: &dyn Fn(&Evaluation) -> String| {
        (name.to_owned(), all.iter().map(of).collect::<Vec<_>>())
    };
    let mut columns = vec![
        column("trial", &|row| row.trial.to_string()),
        column("seed", &|row| row.seed.to_string()),
        column("evaluation", &|row| row.number.to_string()),
    ];
    for name in &search.weights {
        let weight = |row: &Evaluation| row.weights.get(name).map_or(String::new(), f32::to_string);
        columns.push(column(&format!("weight_{name}"), &weight));
    }
    columns.push(column("return", &|row| row.ret.to_string()));
    for key in search.limits.keys() {
        let rate = |row: &Evaluation| row.rates.get(key).map_or(String::new(), f64::to_string);
        columns.push(column(key, &rate));
    }
    columns.push(column("worth", &|row| row.worth.to_string()));
    columns
}

/// The evaluations as CSV.
pub(super) fn to_csv(search: &Search, all: &[Evaluation]) -> String {
    csv(&columns(search, all))
}

/// What the best so far is worth, over evaluations, a curve a seed.
///
/// # Errors
/// Where it cannot be drawn.
pub(super) fn figure(description: &Description, all: &[Evaluation]) -> Result<Figure, FigureError> {
    let mut curves: Vec<Curve> = Vec::new();
    let mut best = f64::NEG_INFINITY;
    for row in all {
        let name = format!("seed {}", row.seed);
        if curves.last().is_none_or(|curve| curve.name != name) {
            curves.push(Curve { number: curves.len(), name, places: Vec::new() });
            best = f64::NEG_INFINITY;
        }
        best = best.max(row.worth);
        let place = Place { x: row.number as f64 + 1.0, mean: [best; 3], of: vec![row.worth] };
        curves.iter_mut().last().into_iter().for_each(|curve| curve.places.push(place.clone()));
    }
    let words = Words {
        caption: description.title.clone(),
        x: "evaluations".to_owned(),
        y: "worth: return less penalties (line: the best so far)".to_owned(),
    };
    drawn("search".to_owned(), &Lines { words: &words, curves: &curves })
}

/// In words.
pub(super) fn words(search: &Search, all: &[Evaluation]) -> String {
    let limits: Vec<_> = search.limits.iter().map(|(key, limit)| format!("{key} {limit}")).collect();
    let mut text = format!(
        "\n## Search\n\nCMA-ES, {} weights a generation, over {}: mean return on the tracks {} to {} less {} times what is above the \
         limits ({}). The best that was tried is driven above on other tracks.\n\n| seed | tried | best weights | return | rates | worth |\n\
         |---|---:|---|---:|---|---:|\n",
        search.population,
        search.weights.join(", "),
        search.first_track,
        search.first_track + search.tracks - 1,
        search.penalty,
        limits.join(", "),
    );
    let mut seeds: Vec<u64> = all.iter().map(|row| row.seed).collect();
    seeds.dedup();
    for seed in seeds {
        let of: Vec<&Evaluation> = all.iter().filter(|row| row.seed == seed).collect();
        // The first of equals, as in the search.
        let best = of.iter().reduce(|best, row| if row.worth > best.worth { row } else { best });
        let Some(best) = best else { continue };
        let weights: Vec<_> = best.weights.iter().map(|(name, weight)| format!("{name} {weight}")).collect();
        let rates: Vec<_> = best.rates.iter().map(|(key, rate)| format!("{key} {rate:.4}")).collect();
        let _ = writeln!(
            text,
            "| {seed} | {} | {} | {:.0} | {} | {:.0} |",
            of.len(),
            weights.join(", "),
            best.ret,
            rates.join(", "),
            best.worth
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::named;

    fn search() -> Search {
        Search { evaluations: 60, ..named("learned-weights").unwrap().search.unwrap() }
    }

    /// Best at the weights 0.7 and 1.
    fn worth(weights: &WeightSet) -> f64 {
        let of = |name: &str| f64::from(weights[name]);
        1000.0 - 1e4 * (of("default") - 0.7).powi(2) - 1e4 * (of("safety") - 1.0).powi(2)
    }

    #[test]
    fn a_search_finds_good_weights_within_their_range_and_by_the_seed_alone() {
        let run = |seed| {
            let mut asked = Vec::new();
            let best = searched(&search(), seed, &mut |number, weights| {
                assert_eq!(number, asked.len(), "one after the other");
                assert!(weights.values().all(|weight| (0.51..=1.0).contains(weight)), "{weights:?}");
                asked.push(weights.clone());
                Ok::<_, String>(worth(weights))
            });
            (best.unwrap().unwrap(), asked)
        };
        let (best, asked) = run(0);
        assert!((best["default"] - 0.7).abs() < 0.05 && best["safety"] > 0.95, "{best:?}");
        assert_eq!(asked.len(), 60, "whole generations of 6");
        assert_eq!(run(0).1, asked);
        assert_ne!(run(1).1, asked);
    }

    #[test]
    fn a_search_ends_with_what_was_met() {
        let met = searched(&search(), 0, &mut |number, _| if number < 3 { Ok(1.0) } else { Err("no more") });
        assert_eq!(met, Err("no more"));
        let all_alike = searched(&search(), 0, &mut |_, _| Ok::<_, String>(1.0)).unwrap().unwrap();
        assert_eq!(all_alike.len(), 2, "the first of equals");
    }

    #[test]
    fn what_is_above_a_limit_costs() {
        let limits = [("unsafe_rate".to_owned(), 0.1)].into();
        let search = Search { limits, penalty: 1000.0, ..search() };
        let episode =
            |ret: f32, unsafe_rate: f32| EpisodeMetrics { ret, unsafe_rate, ..EpisodeMetrics::default() };
        let (ret, rates, worth) = evaluated(&search, &[episode(500.0, 0.1), episode(700.0, 0.3)]);
        assert_eq!(ret, 600.0);
        assert!(
            (rates["unsafe_rate"] - 0.2).abs() < 1e-6 && (worth - 500.0).abs() < 1e-3,
            "{rates:?} {worth}"
        );
        let (ret, _, worth) = evaluated(&search, &[episode(500.0, 0.05)]);
        assert_eq!(ret, worth, "below it nothing");
    }

    #[test]
    fn a_search_is_told_with_its_best() {
        let row = |seed: u64, number: usize, worth: f64| Evaluation {
            trial: seed as usize,
            seed,
            number,
            weights: [("default".to_owned(), 0.6), ("safety".to_owned(), 0.9)].into(),
            ret: worth + 100.0,
            rates: [("grass_rate".to_owned(), 0.015)].into(),
            worth,
        };
        let all = [row(0, 0, 5.0), row(0, 1, 7.0), row(1, 0, 3.0)];
        let text = words(&search(), &all);
        assert!(text.contains("| 0 | 2 | default 0.6, safety 0.9 | 107 | grass_rate 0.0150 | 7 |"), "{text}");
        let table = to_csv(&search(), &all);
        assert!(
            table.starts_with("trial,seed,evaluation,weight_default,weight_safety,return,grass_rate,worth\n"),
            "{table}"
        );
        assert!(figure(&named("learned-weights").unwrap(), &all).unwrap().svg.contains("seed 1"));
    }
}
