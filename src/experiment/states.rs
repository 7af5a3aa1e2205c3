//! The states of labeled trajectories, laid out in the plane by t-SNE (the paper's Figure 2).

use bhtsne::tSNE;
use rand::seq::SliceRandom as _;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::charts::{Figure, FigureError, Points, Words, drawn};
use super::table::{csv, said};
use crate::query::Protocol;

/// Neighbors that count, about. As van der Maaten and Hinton suggest.
const PERPLEXITY: f64 = 30.0;
/// Rounds of the descent.
const ROUNDS: usize = 1000;

/// A state of a trajectory that was labeled.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StateRow {
    /// The number of its trial.
    pub trial: usize,
    /// Whose trajectory it is.
    pub method: Protocol,
    /// The seed of the chain.
    pub seed: u64,
    /// Which of the trajectories.
    pub trajectory: usize,
    /// Steps from its beginning.
    pub step: usize,
    /// Z latents.
    pub z: Vec<f32>,
}

/// `n` of `states`, each at most once, in their order.
pub(super) fn chosen(mut states: Vec<StateRow>, n: usize, rng: &mut ChaCha8Rng) -> Vec<StateRow> {
    let mut order: Vec<usize> = (0..states.len()).collect();
    order.shuffle(rng);
    let mut rank = vec![0; states.len()];
    order.iter().enumerate().for_each(|(place, i)| rank[*i] = place);
    let mut i = 0;
    states.retain(|_| {
        i += 1;
        rank[i - 1] < n
    });
    states
}

/// States that were laid out together.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Layout {
    states: Vec<StateRow>,
    points: Vec<[f64; 2]>,
}

impl Layout {
    /// As many states of each method, laid out. Nothing where there are too few to have neighbors.
    ///
    /// The same states give the same points: their beginning is drawn from a seed, and one thread sums what is summed.
    pub(super) fn of(states: Vec<StateRow>) -> Option<Self> {
        let states = alike(states);
        let n = states.len();
        let perplexity = PERPLEXITY.min(((n.saturating_sub(1)) as f64 / 3.0).floor());
        if perplexity < 1.0 {
            return None;
        }
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let begin: Vec<f64> = (0..2 * n).map(|_| rng.random_range(-1e-4..1e-4)).collect();
        let rows: Vec<&[f32]> = states.iter().map(|state| &state.z[..]).collect();
        let embed = || {
            let mut embedding: tSNE<'_, f64, &[f32]> = tSNE::new(&rows);
            embedding.perplexity(perplexity).epochs(ROUNDS).initial_embedding(begin.clone());
            embedding
                .exact(|a, b| a.iter().zip(*b).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum());
            embedding.embedding()
        };
        // Sums of several threads differ in their last digits from run to run, which descents make large.
        let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build();
        let found = alone.map_or_else(|_| embed(), |pool| pool.install(embed));
        let points = found.as_chunks::<2>().0.to_vec();
        Some(Self { states, points })
    }

    /// As a table.
    pub(super) fn to_csv(&self) -> String {
        let column = |name: &str, of: &dyn Fn(&StateRow) -> String| {
            (name.to_owned(), self.states.iter().map(of).collect::<Vec<_>>())
        };
        let along = |name: &str, i: usize| {
            (name.to_owned(), self.points.iter().map(|point| format!("{:.5}", point[i])).collect())
        };
        csv(&[
            column("trial", &|row| row.trial.to_string()),
            column("method", &|row| said(&row.method)),
            column("seed", &|row| row.seed.to_string()),
            column("trajectory", &|row| row.trajectory.to_string()),
            column("step", &|row| row.step.to_string()),
            along("x", 0),
            along("y", 1),
        ])
    }

    /// Drawn.
    ///
    /// # Errors
    /// Where it cannot be drawn.
    pub(super) fn figure(&self) -> Result<Figure, FigureError> {
        let mut groups: Vec<(String, Vec<[f64; 2]>)> = Vec::new();
        for (state, point) in self.states.iter().zip(&self.points) {
            let name = state.method.name();
            let at = groups.iter().position(|(known, _)| known == name).unwrap_or_else(|| {
                groups.push((name.to_owned(), Vec::new()));
                groups.len() - 1
            });
            groups[at].1.push(*point);
        }
        let n = groups.first().map_or(0, |(_, points)| points.len());
        let caption = format!("{n} states of the labeled trajectories of each method (t-SNE of latents)");
        let words = Words { caption, x: String::new(), y: "only distances mean something".to_owned() };
        drawn("tsne".to_owned(), &Points { words: &words, groups: &groups })
    }

    /// In words.
    pub(super) fn words(&self) -> String {
        let n_methods = self.methods().len();
        format!(
            "\n## States\n\n`figures/tsne.svg` lays out {} states, as many of each of {n_methods} methods, by t-SNE (exact; perplexity \
             {:.0}, {ROUNDS} rounds; `tsne.csv` has the points). All trajectories were imagined again in the mean from where they \
             began, as for their diversity, since those that were played hold noise and those that were made do not. Clusters and \
             the distances between them say little by themselves.\n",
            self.states.len(),
            PERPLEXITY.min(((self.states.len() - 1) as f64 / 3.0).floor()),
        )
    }

    fn methods(&self) -> Vec<Protocol> {
        methods(&self.states)
    }
}

fn methods(states: &[StateRow]) -> Vec<Protocol> {
    let mut all: Vec<Protocol> = Vec::new();
    for state in states {
        if !all.contains(&state.method) {
            all.push(state.method);
        }
    }
    all
}

/// As many of each method, by chance.
fn alike(states: Vec<StateRow>) -> Vec<StateRow> {
    let mut groups: Vec<Vec<StateRow>> = methods(&states).iter().map(|_| Vec::new()).collect();
    let order = methods(&states);
    for state in states {
        if let Some(at) = order.iter().position(|method| *method == state.method) {
            groups[at].push(state);
        }
    }
    let n = groups.iter().map(Vec::len).min().unwrap_or(0);
    let rng = &mut ChaCha8Rng::seed_from_u64(0);
    groups.into_iter().flat_map(|group| chosen(group, n, rng)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two clouds far apart, the second with more states than the first.
    fn states() -> Vec<StateRow> {
        let rng = &mut ChaCha8Rng::seed_from_u64(1);
        let mut state = |method, i: usize, middle: f32| {
            let z = (0..4).map(|_| middle + rng.random_range(-1.0..1.0)).collect();
            StateRow { trial: 0, method, seed: 0, trajectory: i / 10, step: i % 10, z }
        };
        let mut all: Vec<_> = (0..25).map(|i| state(Protocol::Dros, i, 0.0)).collect();
        all.extend((0..40).map(|i| state(Protocol::Request, i, 20.0)));
        all
    }

    #[test]
    fn clouds_that_are_apart_stay_apart_and_the_same_states_lie_the_same() {
        let layout = Layout::of(states()).unwrap();
        assert_eq!(layout.points.len(), 50, "as many of each");
        assert_eq!(layout, Layout::of(states()).unwrap());
        let distance = |a: &[f64; 2], b: &[f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
        for (i, point) in layout.points.iter().enumerate() {
            let nearest = (0..50).filter(|j| *j != i).min_by(|a, b| {
                distance(point, &layout.points[*a]).total_cmp(&distance(point, &layout.points[*b]))
            });
            assert_eq!(layout.states[nearest.unwrap()].method, layout.states[i].method, "{i}");
        }
        let table = layout.to_csv();
        assert!(table.starts_with("trial,method,seed,trajectory,step,x,y\n0,dros,0,0,0,"), "{table}");
        assert_eq!(table.lines().count(), 51);
        let figure = layout.figure().unwrap();
        assert!(figure.svg.contains("DROS") && figure.svg.contains("25 states"));
        assert!(layout.words().contains("lays out 50 states"));
    }

    #[test]
    fn too_few_states_are_not_laid_out() {
        assert_eq!(Layout::of(states()[..3].to_vec()), None);
        assert_eq!(Layout::of(Vec::new()), None);
    }

    #[test]
    fn states_are_chosen_once_and_in_their_order() {
        let rng = &mut ChaCha8Rng::seed_from_u64(2);
        let some = chosen(states(), 10, rng);
        assert_eq!(some.len(), 10);
        let all = states();
        let places: Vec<_> =
            some.iter().map(|it| all.iter().position(|other| other == it).unwrap()).collect();
        assert!(places.is_sorted() && places.windows(2).all(|two| two[0] != two[1]), "{places:?}");
        assert_ne!(places, (0..10).collect::<Vec<_>>());
    }
}
