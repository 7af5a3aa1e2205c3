//! Which groups of episodes differ by the tests: those of an experiment, or runs that were opened side by side.
//!
//! Groups are paired where all of them drove the same track with the same seed of the whole chain. Nothing is called
//! different on one seed: a single chain says nothing of another.

use std::collections::{BTreeMap, BTreeSet};

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use crate::evaluation::{
    Friedman, KruskalWallis, bootstrap, cliffs_delta, dunn, friedman, holm, kruskal_wallis, wilcoxon,
};

/// A probability below this is called a difference.
const ALPHA: f64 = 0.05;
/// By seeds alone nothing is said on fewer than these. With five that all agree Wilcoxon's test says 0.0625, with six 0.0313.
pub const LEAST_SEEDS: usize = 5;
/// More groups than these are not compared pair by pair.
pub const MOST_COMPARED: usize = 8;

/// A value of an episode, and where it was driven.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Driven {
    /// The seed of the chain that was learned by, where it is known.
    pub seed: Option<u64>,
    /// The seed of the episode, where it is known.
    pub track: Option<u64>,
    /// What was measured.
    pub value: f64,
}

/// The episodes of a series or of a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Group {
    /// What it is called.
    pub name: String,
    /// Each episode.
    pub episodes: Vec<Driven>,
}

impl Group {
    /// The values of all episodes, in their order.
    pub fn values(&self) -> Vec<f64> {
        self.episodes.iter().map(|episode| episode.value).collect()
    }

    /// For each seed the mean over its episodes, in the order of seeds. Episodes of unknown seed are of one.
    pub fn of_seeds(&self) -> BTreeMap<Option<u64>, f64> {
        let mut sums: BTreeMap<Option<u64>, (f64, f64)> = BTreeMap::new();
        for episode in &self.episodes {
            let (sum, n) = sums.entry(episode.seed).or_default();
            (*sum, *n) = (*sum + episode.value, *n + 1.0);
        }
        sums.into_iter().map(|(seed, (sum, n))| (seed, sum / n)).collect()
    }
}

/// What the tests say of several groups.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Comparison {
    /// The least number of seeds that a group has.
    pub n_seeds: usize,
    /// Seeds and tracks that all groups drove.
    pub n_blocks: usize,
    /// Of these blocks.
    pub friedman: Option<Friedman>,
    /// Of all episodes, which it takes for independent, as the paper's test does.
    pub kruskal_wallis: Option<KruskalWallis>,
    /// Each two of them. None where there are more than [`MOST_COMPARED`].
    pub pairs: Vec<Pair>,
}

/// What the tests say of two groups.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// The numbers of both.
    pub of: (usize, usize),
    /// Seeds and tracks that both drove.
    pub n_blocks: usize,
    /// The mean difference over the seeds that both have, and the bounds of its interval of 95 %.
    pub difference: Option<[f64; 3]>,
    /// Cliff's δ of the episodes.
    pub delta: f64,
    /// Wilcoxon's probability over the seeds and tracks that both drove, corrected by Holm's method. 1 where there is none.
    pub wilcoxon: f64,
    /// Dunn's probability.
    pub dunn: Option<f64>,
    /// What follows.
    pub verdict: Verdict,
    /// Wilcoxon's probability of the means over the seeds that both have, corrected by Holm's method: the stricter test, which
    /// takes no two episodes of a seed for apart. None on fewer than [`LEAST_SEEDS`].
    pub seeds_alone: Option<f64>,
}

impl Pair {
    /// Whether they differ by seeds alone, where that can be said.
    pub fn differ_by_seeds(&self) -> Option<bool> {
        self.seeds_alone.map(|p| p < ALPHA)
    }
}

/// Whether two groups differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// They do.
    Differ,
    /// They may.
    NotToldApart,
    /// They have no seed and track in common.
    Unpaired,
    /// One of them has a single seed.
    OneSeed,
}

impl Verdict {
    /// In words.
    pub fn in_words(self) -> &'static str {
        match self {
            Self::Differ => "differ",
            Self::NotToldApart => "not told apart",
            Self::Unpaired => "no seed and track in common",
            Self::OneSeed => "one seed",
        }
    }
}

impl Comparison {
    /// Of `groups`, each with at least one episode; nothing where there are fewer than two.
    pub fn of(groups: &[Group]) -> Option<Self> {
        if groups.len() < 2 {
            return None;
        }
        let all: Vec<&Group> = groups.iter().collect();
        let blocks = blocks(&all);
        let values: Vec<Vec<f64>> = groups.iter().map(Group::values).collect();
        let values: Vec<&[f64]> = values.iter().map(Vec::as_slice).collect();
        let n_seeds = groups.iter().map(|group| group.of_seeds().len()).min().unwrap_or(0);
        let pairs = if groups.len() > MOST_COMPARED { Vec::new() } else { pairs(groups, &values) };
        Some(Self {
            n_seeds,
            n_blocks: blocks.len(),
            friedman: friedman(&blocks),
            kruskal_wallis: kruskal_wallis(&values),
            pairs,
        })
    }
}

fn pairs(groups: &[Group], values: &[&[f64]]) -> Vec<Pair> {
    let all: Vec<(usize, usize)> =
        (0..groups.len()).flat_map(|i| (i + 1..groups.len()).map(move |j| (i, j))).collect();
    // What both drove, whatever others did.
    let both: Vec<Vec<Vec<f64>>> = all.iter().map(|&(i, j)| blocks(&[&groups[i], &groups[j]])).collect();
    let raw: Vec<f64> = both
        .iter()
        .map(|blocks| {
            let pairs: Vec<(f64, f64)> = blocks.iter().map(|block| (block[0], block[1])).collect();
            wilcoxon(&pairs).unwrap_or(1.0)
        })
        .collect();
    let seeds = |(i, j): (usize, usize)| -> Vec<(f64, f64)> {
        let (one, other) = (groups[i].of_seeds(), groups[j].of_seeds());
        one.iter().filter_map(|(seed, value)| Some((*value, *other.get(seed)?))).collect()
    };
    let strict: Vec<f64> = all.iter().map(|&pair| wilcoxon(&seeds(pair)).unwrap_or(1.0)).collect();
    let (corrected, strict, dunns) = (holm(&raw), holm(&strict), dunn(values));
    let of = |(n, &(i, j)): (usize, &(usize, usize))| {
        let (one, other) = (groups[i].of_seeds(), groups[j].of_seeds());
        let differences: Vec<f64> = seeds((i, j)).iter().map(|(one, other)| one - other).collect();
        // The same episodes give the same interval, whatever else is there.
        let difference = bootstrap(&differences, &mut ChaCha8Rng::seed_from_u64(n as u64));
        let is_apart = difference.is_some_and(|[_, low, high]| low > 0.0 || high < 0.0);
        let verdict = match one.len().min(other.len()) {
            0 | 1 => Verdict::OneSeed,
            _ if both[n].is_empty() => Verdict::Unpaired,
            _ if corrected[n] < ALPHA && is_apart => Verdict::Differ,
            _ => Verdict::NotToldApart,
        };
        Pair {
            of: (i, j),
            n_blocks: both[n].len(),
            difference,
            delta: cliffs_delta(values[i], values[j]).unwrap_or(0.0),
            wilcoxon: corrected[n],
            dunn: dunns.iter().find(|test| test.pair == (i, j)).map(|test| test.p),
            verdict,
            seeds_alone: (differences.len() >= LEAST_SEEDS).then_some(strict[n]),
        }
    };
    all.iter().enumerate().map(of).collect()
}

/// For each seed and track that all groups drove, a value of each, in the order of seeds and tracks.
fn blocks(groups: &[&Group]) -> Vec<Vec<f64>> {
    let of = |group: &&Group| -> BTreeMap<(Option<u64>, u64), f64> {
        group.episodes.iter().filter_map(|it| Some(((it.seed, it.track?), it.value))).collect()
    };
    let all: Vec<_> = groups.iter().map(of).collect();
    let keys: BTreeSet<_> = all.iter().flat_map(BTreeMap::keys).collect();
    keys.into_iter().filter_map(|key| all.iter().map(|values| values.get(key).copied()).collect()).collect()
}

/// A probability as people read it.
pub fn probability(p: f64) -> String {
    if p < 1e-4 { "< 0.0001".to_owned() } else { format!("{p:.4}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A group that drives so many tracks for each of so many seeds.
    fn group(name: &str, seeds: &[Option<u64>], by: f64) -> Group {
        let episodes = seeds.iter().flat_map(|&seed| {
            (100..106).map(move |track| Driven {
                seed,
                track: Some(track),
                value: by + track as f64 + 3.0 * seed.unwrap_or(0) as f64,
            })
        });
        Group { name: name.to_owned(), episodes: episodes.collect() }
    }

    #[test]
    fn what_is_greater_on_every_seed_and_track_differs() {
        let seeds = [Some(0), Some(1), Some(2)];
        let found = Comparison::of(&[group("a", &seeds, 0.0), group("b", &seeds, 50.0)]).unwrap();
        assert_eq!((found.n_seeds, found.n_blocks), (3, 18));
        let [pair] = found.pairs[..] else { panic!("{found:?}") };
        assert_eq!((pair.verdict, pair.delta, pair.difference), (Verdict::Differ, -1.0, Some([-50.0; 3])));
        let same = Comparison::of(&[group("a", &seeds, 0.0), group("b", &seeds, 0.0)]).unwrap();
        assert_eq!(same.pairs[0].verdict, Verdict::NotToldApart);
    }

    #[test]
    fn nothing_is_called_different_on_one_seed_however_far_apart() {
        for seeds in [[None], [Some(0)]] {
            let found = Comparison::of(&[group("a", &seeds, 0.0), group("b", &seeds, 5000.0)]).unwrap();
            assert_eq!((found.n_blocks, found.pairs[0].verdict), (6, Verdict::OneSeed));
            assert!(found.kruskal_wallis.is_some_and(|test| test.p < 0.05), "though the ranks differ");
        }
    }

    #[test]
    fn a_chain_of_unknown_seed_is_no_block_with_one_that_is_known() {
        let (known, unknown) = (group("a", &[Some(0), Some(1)], 0.0), group("b", &[None], 50.0));
        let found = Comparison::of(&[known.clone(), unknown]).unwrap();
        assert_eq!((found.n_blocks, found.friedman), (0, None));
        assert_eq!(found.pairs[0].difference, None);
        let other = group("c", &[Some(7), Some(8)], 50.0);
        let found = Comparison::of(&[known.clone(), other]).unwrap();
        assert_eq!(found.pairs[0].verdict, Verdict::Unpaired);
        assert_eq!(Comparison::of(&[known]), None, "there is nothing to compare with");
    }

    #[test]
    fn of_many_groups_no_pairs_are_tested() {
        let all: Vec<_> = (0..9).map(|i| group(&i.to_string(), &[Some(0), Some(1)], f64::from(i))).collect();
        let found = Comparison::of(&all).unwrap();
        assert!(found.pairs.is_empty() && found.friedman.is_some());
    }
}
