//! What was done in recordings, a few steps at a time: candidates for a planner, and what somebody who plays can do.

use std::ops::ControlFlow;

use rand::seq::SliceRandom as _;
use rand::{Rng, RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use tch::Tensor;

use crate::dataset::{Dataset, DatasetError};
use crate::dream::Rows;
use crate::tensor::{Parameters, ParametersError, from_slice, to_vec};
use crate::world::{Action, Frame, SourceKind, WorldSpec};
use crate::world_model::WorldModel;

/// So many are kept of all that was recorded.
pub const MOST_KEPT: usize = 2000;
/// Of no more episodes than these.
const MOST_EPISODES: usize = 200;
/// Rounds of the clustering.
const ROUNDS: usize = 20;
/// The names of the tensors in a world model's file.
const ACTIONS: &str = "snippets.actions";
const LATENTS: &str = "snippets.latents";

/// Stretches of H recorded actions, each with the latents of the picture in which it began.
#[derive(Clone, Debug, PartialEq)]
pub struct Snippets {
    /// N rows of Z latents.
    latents: Rows,
    /// N times H actions.
    actions: Vec<Vec<Action>>,
}

impl Snippets {
    /// Those that begin in moments with these latents.
    ///
    /// # Panics
    /// Where there are not as many of both, or where they are not equally long.
    pub fn new(latents: Rows, actions: Vec<Vec<Action>>) -> Self {
        assert_eq!(latents.len(), actions.len(), "a moment for each");
        assert!(actions.windows(2).all(|two| two[0].len() == two[1].len()), "equally long");
        Self { latents, actions }
    }

    /// Those of the recordings in `dataset`, of `horizon` steps each, spread evenly: [`MOST_KEPT`] at the most.
    ///
    /// `on_episode` is told of each episode that was read, and may break off: then nothing comes.
    ///
    /// # Errors
    /// Where an episode cannot be read.
    pub fn gather(
        model: &WorldModel,
        dataset: &Dataset,
        horizon: usize,
        on_episode: &mut dyn FnMut(usize, usize) -> ControlFlow<()>,
    ) -> Result<Option<Self>, DatasetError> {
        let all: Vec<usize> = (0..dataset.n_episodes()).collect();
        Self::gather_from(model, (dataset, &all), horizon, on_episode)
    }

    /// The same of some episodes alone.
    ///
    /// # Errors
    /// Where an episode cannot be read.
    pub fn gather_from(
        model: &WorldModel,
        (dataset, episodes): (&Dataset, &[usize]),
        horizon: usize,
        on_episode: &mut dyn FnMut(usize, usize) -> ControlFlow<()>,
    ) -> Result<Option<Self>, DatasetError> {
        let lens: Vec<usize> = (0..dataset.n_episodes()).map(|i| dataset.len(i)).collect();
        let fits: Vec<usize> = episodes.iter().copied().filter(|i| lens[*i] >= horizon).collect();
        // Of many episodes some, of each several.
        let every = fits.len().div_ceil(MOST_EPISODES).max(1);
        let chosen: Vec<usize> = fits.into_iter().step_by(every).collect();
        let n_begins: usize = chosen.iter().map(|i| lens[*i] + 1 - horizon).sum();
        let stride = n_begins.div_ceil(MOST_KEPT).max(1);
        let width = model.config().mdn_rnn.latent as usize;
        let mut all = Self { latents: Rows { width, values: Vec::new() }, actions: Vec::new() };
        let mut passed = 0;
        for (n, &i) in chosen.iter().enumerate() {
            let episode = dataset.episode(i)?;
            let n_here = lens[i] + 1 - horizon;
            let first = (stride - passed % stride) % stride;
            passed += n_here;
            let begins: Vec<usize> = (first..n_here).step_by(stride).collect();
            let frames: Vec<Frame> = begins.iter().map(|t| episode.frames[*t].clone()).collect();
            if !frames.is_empty() {
                all.latents.values.extend(to_vec(&model.observe(&frames)));
                all.actions.extend(begins.iter().map(|t| episode.actions[*t..*t + horizon].to_vec()));
            }
            if on_episode(n + 1, chosen.len()).is_break() {
                return Ok(None);
            }
        }
        Ok(Some(all).filter(|all| !all.is_empty()))
    }

    /// Those in a world model's file, where there are any.
    ///
    /// # Errors
    /// Where what is there are none, or not of `n_axes` numbers and `n_latents` latents.
    pub fn read(
        parameters: &Parameters,
        n_axes: usize,
        n_latents: i64,
    ) -> Result<Option<Self>, ParametersError> {
        let (Some(actions), Some(latents)) = (parameters.finite(ACTIONS)?, parameters.finite(LATENTS)?)
        else {
            return Ok(None);
        };
        let [n, horizon, width] = actions.size()[..] else { return Ok(None) };
        if width != n_axes as i64 || latents.size() != [n, n_latents] || horizon == 0 || n == 0 {
            return Ok(None);
        }
        let all: Vec<Action> = to_vec(&actions).chunks_exact(n_axes).map(Action::new).collect();
        let actions = all.chunks_exact(horizon as usize).map(<[Action]>::to_vec).collect();
        let latents = Rows { width: n_latents as usize, values: to_vec(&latents) };
        Ok(Some(Self { latents, actions }))
    }

    /// As they stand in a world model's file.
    pub fn tensors(&self) -> [(String, Tensor); 2] {
        let (n, horizon) = (self.actions.len() as i64, self.actions.first().map_or(0, Vec::len) as i64);
        let values: Vec<f32> = self.actions.iter().flatten().flat_map(|action| action.to_vec()).collect();
        let latents = from_slice(&self.latents.values, &[n, self.latents.width as i64]);
        [(ACTIONS.to_owned(), from_slice(&values, &[n, horizon, -1])), (LATENTS.to_owned(), latents)]
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.actions.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.actions.is_empty()
    }

    /// One that began where it looked like `z`: one of the `n` nearest, by chance.
    pub fn near(&self, z: &[f32], n: usize, rng: &mut impl Rng) -> Option<&[Action]> {
        let distance = |row: &[f32]| row.iter().zip(z).map(|(a, b)| (a - b).powi(2)).sum::<f32>();
        let mut all: Vec<(f32, usize)> =
            (0..self.len()).map(|i| (distance(self.latents.row(i)), i)).collect();
        let n = n.min(all.len());
        if n == 0 {
            return None;
        }
        all.select_nth_unstable_by(n - 1, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        all.truncate(n);
        all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        Some(&self.actions[all[rng.random_range(0..n)].1])
    }

    /// `count` of them at the most that stand for all: the nearest to the means of clusters (k-means over scaled actions,
    /// begun far apart). Where an axis is mirrored, with their mirror images.
    pub fn clustered(&self, count: usize, spec: &WorldSpec) -> Vec<Vec<Action>> {
        let axes = &spec.axes;
        let mirrored = axes.iter().any(|axis| axis.mirrored);
        let mirror = |course: &Vec<Action>| -> Vec<Action> {
            let about = |i: usize, value: f32| {
                let axis = &axes[i];
                if axis.mirrored { axis.clamped(2.0 * axis.neutral - value) } else { value }
            };
            course.iter().map(|action| action.map(about)).collect()
        };
        let n_clusters = if mirrored { count.div_ceil(2) } else { count };
        let point = |course: &Vec<Action>| -> Vec<f32> {
            let scaled = course.iter().flat_map(|action| {
                action
                    .iter()
                    .zip(axes)
                    .map(|(value, axis)| (value - axis.neutral) / (axis.high - axis.low))
                    .collect::<Vec<_>>()
            });
            scaled.collect()
        };
        let points: Vec<Vec<f32>> = self.actions.iter().map(point).collect();
        let mut all: Vec<Vec<Action>> = Vec::new();
        for i in medoids(&points, n_clusters) {
            for course in [self.actions[i].clone(), mirror(&self.actions[i])] {
                if !all.contains(&course) && all.len() < count {
                    all.push(course);
                }
                if !mirrored {
                    break;
                }
            }
        }
        all
    }
}

/// The world model in `parameters` with what was done in the recordings that it was fitted to, for a planner and for whoever
/// plays. The built-in worlds bring their own, and stay as they are.
///
/// Nothing comes where `on_episode` breaks off.
///
/// # Errors
/// Where an episode cannot be read.
///
/// # Panics
/// Where `parameters` hold no world model.
pub fn with_snippets(
    parameters: Parameters,
    dataset: &Dataset,
    on_episode: &mut dyn FnMut(usize, usize) -> ControlFlow<()>,
) -> Result<Option<Parameters>, DatasetError> {
    let all: Vec<usize> = (0..dataset.n_episodes()).collect();
    with_snippets_of(parameters, dataset, &all, on_episode)
}

/// The same of some episodes alone.
///
/// # Errors
/// Where an episode cannot be read.
///
/// # Panics
/// Where `parameters` hold no world model.
pub fn with_snippets_of(
    parameters: Parameters,
    dataset: &Dataset,
    episodes: &[usize],
    on_episode: &mut dyn FnMut(usize, usize) -> ControlFlow<()>,
) -> Result<Option<Parameters>, DatasetError> {
    let model = WorldModel::load(parameters.clone()).unwrap_or_else(|met| panic!("just fitted: {met}"));
    let spec = model.spec();
    if spec.source.kind == SourceKind::BuiltIn {
        return Ok(Some(parameters));
    }
    let mut is_broken_off = false;
    let from = (dataset, episodes);
    let snippets = Snippets::gather_from(&model, from, spec.planner.horizon, &mut |done, n| {
        let go_on = on_episode(done, n);
        is_broken_off |= go_on.is_break();
        go_on
    })?;
    Ok(match snippets {
        Some(snippets) => Some(parameters.with(snippets.tensors())),
        None => (!is_broken_off).then_some(parameters),
    })
}

/// The points that stand for `k` clusters, in order: a pure function of the points.
fn medoids(points: &[Vec<f32>], k: usize) -> Vec<usize> {
    let distance = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f32>();
    if points.is_empty() || k == 0 {
        return Vec::new();
    }
    // k-means++, whose generator is always the same.
    let rng = &mut ChaCha8Rng::seed_from_u64(0);
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.shuffle(rng);
    let mut means = vec![points[order[0]].clone()];
    while means.len() < k.min(points.len()) {
        let away =
            |i: &usize| means.iter().map(|mean| distance(&points[*i], mean)).fold(f32::INFINITY, f32::min);
        let shares: Vec<f32> = order.iter().map(away).collect();
        let total: f32 = shares.iter().sum();
        if total <= 0.0 {
            break;
        }
        let mut left = rng.random::<f32>() * total;
        let drawn = shares.iter().position(|share| {
            left -= share;
            left <= 0.0
        });
        means.push(points[order[drawn.unwrap_or(order.len() - 1)]].clone());
    }
    let nearest = |point: &[f32], means: &[Vec<f32>]| {
        let all = means.iter().enumerate().map(|(i, mean)| (distance(point, mean), i));
        all.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(0, |(_, i)| i)
    };
    for _ in 0..ROUNDS {
        let mut sums = vec![(vec![0.0; points[0].len()], 0usize); means.len()];
        for point in points {
            let (sum, n) = &mut sums[nearest(point, &means)];
            sum.iter_mut().zip(point).for_each(|(sum, value)| *sum += value);
            *n += 1;
        }
        for (mean, (sum, n)) in means.iter_mut().zip(sums) {
            if n > 0 {
                *mean = sum.into_iter().map(|sum| sum / n as f32).collect();
            }
        }
    }
    let mut found: Vec<usize> = means
        .iter()
        .filter_map(|mean| {
            (0..points.len())
                .min_by(|a, b| distance(&points[*a], mean).total_cmp(&distance(&points[*b], mean)))
        })
        .collect();
    found.sort_unstable();
    found.dedup();
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn snippets(courses: &[[f32; 2]]) -> Snippets {
        let latents = Rows { width: 1, values: (0..courses.len()).map(|i| i as f32).collect() };
        Snippets::new(latents, courses.iter().map(|action| vec![Action::new(action); 3]).collect())
    }

    fn spec(mirrored: bool) -> WorldSpec {
        let text = format!(
            "format = 1\nname = \"car\"\ntitle = \"Car\"\nrate = 10\nlongest_episode = 100\nsource = {{ kind = \"recordings\" }}\n\
             image = {{ height = 60, width = 80 }}\naxes = [{{ name = \"turn\", low = -1.0, high = 1.0, neutral = 0.0, \
             mirrored = {mirrored} }}, {{ name = \"go\", low = 0.0, high = 1.0, neutral = 0.0 }}]"
        );
        text.parse().unwrap()
    }

    #[test]
    fn clusters_are_told_by_one_of_their_own() {
        let all = snippets(&[[0.9, 0.1], [0.92, 0.1], [0.0, 0.9], [0.02, 0.9], [0.0, 0.88]]);
        let found = all.clustered(2, &spec(false));
        assert_eq!(found.len(), 2);
        assert!(
            found.iter().any(|course| course[0][0] >= 0.9) && found.iter().any(|course| course[0][1] >= 0.88)
        );
        assert_eq!(all.clustered(50, &spec(false)).len(), 5, "no more than there are");
        assert_eq!(snippets(&[]).clustered(5, &spec(false)), Vec::<Vec<Action>>::new());
    }

    #[test]
    fn what_turns_right_turns_left_as_well_where_that_is_as_good() {
        let found = snippets(&[[0.9, 0.1], [0.9, 0.1]]).clustered(4, &spec(true));
        assert_eq!(
            found.iter().map(|course| course[0]).collect::<Vec<_>>(),
            [Action::new([0.9, 0.1]), Action::new([-0.9, 0.1])]
        );
    }

    #[test]
    fn somebody_does_what_was_done_where_it_looked_alike() {
        let all = snippets(&[[0.1, 0.0], [0.2, 0.0], [0.3, 0.0], [0.4, 0.0]]);
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let drawn: Vec<f32> = (0..40).map(|_| all.near(&[2.9], 2, rng).unwrap()[0][0]).collect();
        assert!(
            drawn.iter().all(|turn| [0.3, 0.4].contains(turn))
                && drawn.contains(&0.3)
                && drawn.contains(&0.4)
        );
    }

    #[test]
    fn they_survive_the_way_to_tensors_and_back() {
        let all = snippets(&[[0.1, 0.0], [0.2, 1.0]]);
        let parameters = Parameters::from_tensors(all.tensors(), &[]);
        assert_eq!(Snippets::read(&parameters, 2, 1).unwrap(), Some(all));
        assert_eq!(Snippets::read(&parameters, 3, 1).unwrap(), None, "of another world");
        assert_eq!(Snippets::read(&Parameters::from_tensors([], &[]), 2, 1).unwrap(), None);
    }
}
