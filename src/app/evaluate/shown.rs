//! What runs side by side come to: found out once after each change, and only looked at while a picture is drawn.

use super::Results;
use crate::evaluation::MeanSd;
use crate::experiment::opened::Loss;
use crate::experiment::side_by_side::{Numbered, SideBySide, Spread};
use crate::experiment::{Axis, Comparison, Group, Measure, Opened};

/// A run in the table.
#[derive(Clone, Debug)]
pub(crate) struct ShownRun {
    /// Of which results.
    pub results: u64,
    /// Its number in them.
    pub run: usize,
    /// Its number among all, by which it has a color and a mark.
    pub number: usize,
    /// As it is told from the others.
    pub name: String,
    pub is_hidden: bool,
    pub n_episodes: usize,
    /// Seeds of whole chains, where they are known.
    pub n_seeds: Option<usize>,
    /// Of each measure, over episodes.
    pub cells: Vec<Option<MeanSd>>,
}

/// What is shown of all runs.
#[derive(Clone, Debug, Default)]
pub(crate) struct Shown {
    /// What can be shown of them.
    pub measures: Vec<Measure>,
    pub runs: Vec<ShownRun>,
    /// The episodes of each run that is not left out, with its number.
    pub groups: Vec<(usize, Group)>,
    /// How those are spread.
    pub spreads: Vec<Spread>,
    /// What the tests say of those.
    pub comparison: Option<Comparison>,
    /// What experiments measured over the axis of the first of them, with numbers of runs.
    pub over: Option<(Axis, Vec<Numbered>)>,
    /// Experiments that are over another axis, and so are not drawn.
    pub left_out: Vec<String>,
    /// Curves of fits, with numbers of colors.
    pub losses: Vec<(usize, Loss)>,
    /// The worlds that were driven in, as far as they are known.
    pub worlds: Vec<String>,
}

impl Shown {
    /// What `results` come to, and the measure that is shown of them: `measure`, if they have it.
    pub(super) fn of(results: &[Results], measure: &Measure, is_sorted: bool) -> (Measure, Self) {
        let all = || results.iter().flat_map(|it| &it.opened.runs);
        let measures = if all().next().is_none() { Vec::new() } else { Opened::measures(all()) };
        let measure = measures.iter().find(|known| *known == measure).unwrap_or(&Measure::Return).clone();
        let mut shown = Self { measures, ..Self::default() };
        let is_alone = results.iter().filter(|it| !it.opened.runs.is_empty()).count() < 2;
        for it in results {
            let first = shown.runs.len();
            for (run, opened) in it.opened.runs.iter().enumerate() {
                let name = match &*opened.name {
                    "" => it.name.clone(),
                    name if is_alone => name.to_owned(),
                    name => format!("{} · {name}", it.name),
                };
                let is_hidden = it.hidden.contains(&run);
                let number = shown.runs.len();
                let group = opened.group(&name, &measure);
                if !is_hidden && let Some(spread) = Spread::of(&group.values()) {
                    shown.groups.push((number, group));
                    shown.spreads.push(spread);
                }
                let value = |of: &Measure| {
                    let values = opened.episodes.iter().map(|episode| of.in_episode(&episode.metrics));
                    MeanSd::of(values.map(|value| value.map(|value| value as f32)))
                };
                let seeds = opened.episodes.iter().filter_map(|episode| episode.seed);
                let n_seeds = seeds.collect::<std::collections::BTreeSet<_>>().len();
                shown.runs.push(ShownRun {
                    results: it.id,
                    run,
                    number,
                    name,
                    is_hidden,
                    n_episodes: opened.episodes.len(),
                    n_seeds: Some(n_seeds).filter(|n| *n > 0),
                    cells: shown.measures.iter().map(value).collect(),
                });
            }
            shown.take_curves(it, first, &measure);
            if let Some(world) = it.opened.world.as_ref().filter(|world| !shown.worlds.contains(world)) {
                shown.worlds.push(world.clone());
            }
        }
        shown.comparison =
            Comparison::of(&shown.groups.iter().map(|(_, group)| group.clone()).collect::<Vec<_>>());
        if is_sorted && let Some(at) = shown.measures.iter().position(|known| *known == measure) {
            let key = |run: &ShownRun| run.cells[at].map_or(f64::NEG_INFINITY, |cell| cell.mean);
            shown.runs.sort_by(|one, other| key(other).total_cmp(&key(one)));
        }
        (measure, shown)
    }

    /// Takes in what `results` measured over an axis, whose first run has this number.
    fn take_curves(&mut self, results: &Results, first: usize, measure: &Measure) {
        for loss in &results.opened.losses {
            let (name, points) = loss;
            self.losses.push((self.losses.len(), (format!("{} · {name}", results.name), points.clone())));
        }
        let Some(curves) = &results.opened.curves else { return };
        let Some((_, all)) = curves.of.iter().find(|(known, _)| known == measure) else { return };
        let (axis, over) = self.over.get_or_insert_with(|| (curves.axis, Vec::new()));
        if *axis != curves.axis {
            self.left_out.push(results.name.clone());
            return;
        }
        for (name, points) in all {
            let place = results.opened.runs.iter().position(|run| run.name == *name);
            let run = place.and_then(|place| self.runs.get(first + place)).filter(|run| !run.is_hidden);
            over.extend(run.map(|run| (run.number, run.name.clone(), points.clone())));
        }
    }

    /// The same for files.
    pub(super) fn to_save(&self, measure: &Measure) -> SideBySide {
        let mut head: Vec<String> = ["run", "episodes", "seeds"].map(str::to_owned).into();
        for measure in &self.measures {
            head.extend(["mean", "sd"].map(|of| format!("{}_{of}", measure.slug())));
        }
        let mut table = vec![head];
        for run in &self.runs {
            let n_seeds = run.n_seeds.map_or(String::new(), |n| n.to_string());
            let mut line = vec![run.name.clone(), run.n_episodes.to_string(), n_seeds];
            for cell in &run.cells {
                let text = |value: Option<f64>| value.map_or(String::new(), |value| value.to_string());
                line.extend([text(cell.map(|cell| cell.mean)), text(cell.map(|cell| cell.sd))]);
            }
            table.push(line);
        }
        SideBySide {
            measure: measure.clone(),
            groups: self.groups.clone(),
            over: self.over.clone().filter(|(_, all)| !all.is_empty()),
            losses: self.losses.clone(),
            table,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::sync::Arc;

    use super::*;
    use crate::app::evaluate::Origin;
    use crate::evaluation::EpisodeMetrics;
    use crate::experiment::{Curves, Point, Run, RunEpisode};

    fn run(name: &str, by: f32) -> Run {
        let episode = |i: u64| RunEpisode {
            seed: Some(i % 2),
            track: Some(i),
            metrics: EpisodeMetrics {
                ret: by + i as f32,
                unsafe_rate: f32::NAN,
                ..EpisodeMetrics::default()
            },
        };
        Run { name: name.to_owned(), episodes: (0..8).map(episode).collect() }
    }

    fn results(id: u64, axis: Option<Axis>, runs: Vec<Run>) -> Results {
        let point = |x: f64| Point { x, of_seeds: vec![x], episodes: vec![x], mean: [x; 3] };
        let curves = axis.map(|axis| Curves {
            axis,
            of: vec![(
                Measure::Return,
                runs.iter().map(|run| (run.name.clone(), vec![point(1.0)])).collect(),
            )],
        });
        let name = format!("results {id}");
        let opened = Opened { name: name.clone(), runs, curves, ..Opened::default() };
        Results { id, name, opened: Arc::new(opened), hidden: BTreeSet::new(), origin: Origin::Files }
    }

    #[test]
    fn what_is_left_out_keeps_its_number_and_is_in_no_figure_or_test() {
        let mut all = vec![results(0, Some(Axis::Answers), vec![run("a", 0.0), run("b", 50.0)])];
        let (_, shown) = Shown::of(&all, &Measure::Return, true);
        assert_eq!(
            shown.runs.iter().map(|run| (&*run.name, run.number)).collect::<Vec<_>>(),
            [("b", 1), ("a", 0)]
        );
        assert_eq!((shown.groups.len(), shown.over.as_ref().map(|(_, all)| all.len())), (2, Some(2)));
        all[0].hidden.insert(0);
        all.push(results(1, Some(Axis::Minutes), vec![run("", 9.0)]));
        let (_, shown) = Shown::of(&all, &Measure::Unsafe, false);
        let names: Vec<_> = shown.runs.iter().map(|run| (&*run.name, run.is_hidden)).collect();
        assert_eq!(names, [("results 0 · a", true), ("results 0 · b", false), ("results 1", false)]);
        assert_eq!(shown.groups.iter().map(|(number, _)| *number).collect::<Vec<_>>(), [1, 2]);
        assert_eq!(shown.comparison.as_ref().map(|found| (found.pairs.len(), found.n_blocks)), Some((1, 8)));
        assert_eq!(shown.left_out, ["results 1"], "over another axis");
        let saved = shown.to_save(&Measure::Return);
        assert_eq!(
            saved.table[0],
            ["run", "episodes", "seeds", "return_mean", "return_sd"].map(str::to_owned)
        );
        assert_eq!(saved.table.len(), 4, "the table has all");
    }
}
