//! What an experiment comes to, in words and tables: means with intervals over seeds, and which differ by the tests.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use super::comparison::{Comparison, Driven, Group, LEAST_SEEDS, Verdict, probability};
use super::description::{Axis, Description};
use super::table::{Measure, Row, Rows};
use crate::evaluation::bootstrap;

/// What was measured of a series at a place of the axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// Where it is on the axis; its number among the series where that has no numbers.
    pub x: f64,
    /// For each seed of the whole chain the mean over its episodes, in the order of seeds.
    pub of_seeds: Vec<f64>,
    /// Every episode.
    pub episodes: Vec<f64>,
    /// The mean over seeds, and the bounds of its interval of 95 %.
    pub mean: [f64; 3],
}

/// A series by its name, with its points in the order of the axis.
pub type Series = (String, Vec<Point>);

/// The series of a measure, in the order in which their trials come.
pub fn series(description: &Description, rows: &Rows, measure: &Measure) -> Vec<Series> {
    let (axis, differing) = (description.axis, rows.differing());
    let mut names: Vec<String> = Vec::new();
    let mut points: BTreeMap<(usize, u64), Vec<&Row>> = BTreeMap::new();
    for row in &rows.0 {
        // A world model is one, whatever was learned in it.
        let name = if measure.is_of_world_model() {
            "world models".to_owned()
        } else {
            row.series(axis, &differing)
        };
        let at = names.iter().position(|known| *known == name).unwrap_or_else(|| {
            names.push(name);
            names.len() - 1
        });
        // In thousandths, to be compared.
        let x = row.x(axis).unwrap_or(at as f64);
        points.entry((at, (1e3 * x).round() as u64)).or_default().push(row);
    }
    let mut all: Vec<Series> = names.into_iter().map(|name| (name, Vec::new())).collect();
    for ((at, x), rows) in points {
        let mut of_seeds: BTreeMap<u64, Vec<f64>> = BTreeMap::new();
        for row in &rows {
            if let Some(value) = measure.of(row) {
                of_seeds.entry(row.seed).or_default().push(value);
            }
        }
        let episodes: Vec<f64> = of_seeds.values().flatten().copied().collect();
        let means = of_seeds.into_values().map(|values| values.iter().sum::<f64>() / values.len() as f64);
        let of_seeds: Vec<f64> = means.collect();
        // The same rows give the same interval, whatever else is there.
        let rng = &mut ChaCha8Rng::seed_from_u64(x);
        if let Some(mean) = bootstrap(&of_seeds, rng) {
            all[at].1.push(Point { x: x as f64 / 1e3, of_seeds, episodes, mean });
        }
    }
    all.retain(|(_, points)| !points.is_empty());
    all
}

/// All in words: Markdown.
pub fn summary(description: &Description, rows: &Rows, n_missing: usize) -> String {
    let mut text = format!("# {}\n\n{}.", description.name, description.title);
    if !description.paper.is_empty() {
        let _ = write!(text, " In the paper: {}.", description.paper);
    }
    let (trials, seeds) = (description.trials().len(), description.seeds.len());
    let _ = write!(
        text,
        "\n\nIn {}: {trials} trials of {seeds} seeds, {} episodes; a chain has {} dreams of {} steps.",
        description.world,
        rows.0.len(),
        description.dreams,
        description.dream_steps
    );
    if n_missing > 0 {
        let _ =
            write!(text, " **{n_missing} of the trials are not done**, and what follows is without them.");
    }
    text.push('\n');
    if rows.0.is_empty() {
        return text;
    }
    recorded(&mut text, description);
    for measure in rows.measures() {
        let all = series(description, rows, &measure);
        let _ = write!(text, "\n## {}\n\n", measure.title());
        table(&mut text, description.axis, &measure, &all);
        compare(&mut text, description, rows, &measure, &all);
    }
    disagreement(&mut text, rows);
    let _ = writeln!(
        text,
        "\nIn brackets: the interval of 95 % of the mean over seeds of the whole chain (percentile bootstrap, 2000 draws). \
         Nothing is said of a single seed. \"Seeds alone\" is the stricter test, which takes no two episodes of a seed for apart: \
         Wilcoxon's signed ranks of the seeds' means, Holm's correction. Six seeds that all agree are the fewest that it calls different."
    );
    text
}

/// A row for each series and place on the axis.
fn table(text: &mut String, axis: Axis, measure: &Measure, all: &[Series]) {
    let place = match axis {
        Axis::Answers => "answers",
        Axis::Minutes => "minutes",
        Axis::CriticalMistakes => "% wrong",
        Axis::Recorded => "recorded",
        Axis::Variants => "",
    };
    let has_place = !place.is_empty();
    let _ = writeln!(
        text,
        "| | {}mean | of each seed |",
        if has_place { format!("{place} | ") } else { String::new() }
    );
    let _ = writeln!(text, "|---|{}---:|---|", if has_place { "---:|" } else { "" });
    for (name, points) in all {
        for point in points {
            let [mean, low, high] = point.mean.map(|value| measure.shown(value));
            let interval = if point.of_seeds.len() > 1 { format!(" [{low}, {high}]") } else { String::new() };
            let seeds: Vec<_> = point.of_seeds.iter().map(|value| measure.shown(*value)).collect();
            let x = if has_place { format!("{:.0} | ", point.x) } else { String::new() };
            let _ = writeln!(text, "| {name} | {x}{mean}{interval} | {} |", seeds.join(", "));
        }
    }
}

/// The episodes of each series where the most is known: at its last place.
fn last_groups(description: &Description, rows: &Rows, measure: &Measure, all: &[Series]) -> Vec<Group> {
    let (axis, differing) = (description.axis, rows.differing());
    let mut groups: Vec<(f64, Group)> = all
        .iter()
        .filter_map(|(name, points)| {
            let group = Group { name: name.clone(), episodes: Vec::new() };
            Some((points.last()?.x, group))
        })
        .collect();
    for row in &rows.0 {
        let name = row.series(axis, &differing);
        let is_there = |(x, group): &&mut (f64, Group)| {
            group.name == name && row.x(axis).is_none_or(|of_row| (of_row - x).abs() < 1e-2)
        };
        if let Some(value) = measure.of(row)
            && let Some((_, group)) = groups.iter_mut().find(is_there)
        {
            group.episodes.push(Driven { seed: Some(row.seed), track: Some(row.track), value });
        }
    }
    groups.into_iter().map(|(_, group)| group).collect()
}

/// What differs, where the most is known: at the last place of each series.
fn compare(text: &mut String, description: &Description, rows: &Rows, measure: &Measure, all: &[Series]) {
    let groups = last_groups(description, rows, measure, all);
    let Some(found) = Comparison::of(&groups) else { return };
    if found.n_seeds < 2 {
        let _ = writeln!(text, "\nNothing is called different on one seed.");
        return;
    }
    // The same seed and track for all: an episode of each is a block.
    text.push('\n');
    if let Some(test) = found.friedman {
        let _ = write!(
            text,
            "Paired by seed and track ({} blocks): Friedman χ² = {:.1}, p = {}. ",
            found.n_blocks,
            test.chi2,
            probability(test.p)
        );
    }
    if let Some(test) = found.kruskal_wallis {
        let _ = write!(
            text,
            "As the paper tests, episodes taken for independent: Kruskal–Wallis H = {:.1}, p = {}. ",
            test.h,
            probability(test.p)
        );
    }
    text.push('\n');
    if found.pairs.is_empty() {
        return;
    }
    text.push_str(
        "\n| | difference of means over seeds | Cliff's δ | Wilcoxon, Holm | Dunn | | seeds alone |\n\
         |---|---:|---:|---:|---:|---|---|\n",
    );
    for pair in &found.pairs {
        let (one, other) = (&groups[pair.of.0].name, &groups[pair.of.1].name);
        let [mean, low, high] = pair.difference.unwrap_or([f64::NAN; 3]).map(|value| measure.shown(value));
        let alone = pair.differ_by_seeds().zip(pair.seeds_alone).map_or("–".to_owned(), |(differ, p)| {
            let verdict = if differ { Verdict::Differ } else { Verdict::NotToldApart };
            format!("{}, p = {}", verdict.in_words(), probability(p))
        });
        let _ = writeln!(
            text,
            "| {one} − {other} | {mean} [{low}, {high}] | {:+.2} | {} | {} | {} | {alone} |",
            pair.delta,
            probability(pair.wilcoxon),
            pair.dunn.map_or("–".to_owned(), probability),
            pair.verdict.in_words()
        );
    }
    if found.n_seeds < LEAST_SEEDS {
        let _ = writeln!(text, "\nBy seeds alone nothing is said on fewer than {LEAST_SEEDS} of them.");
    }
}

/// How world models were learned, where they were.
fn recorded(text: &mut String, description: &Description) {
    let Some(how) = &description.world_models else { return };
    let _ = writeln!(
        text,
        "\nWorld models were learned with {} × {} updates of vision and {} × {} of memory at the most, whatever the number of \
         recorded episodes; all are measured on the same {} held-out episodes. Fewer episodes are among more, and those of a seed \
         are drawn from one pool: at its largest number all seeds learn from the same. The loss of memory is that of the latents \
         of its own vision, so that those of different models compare with care; errors of pixels compare as they are. What the \
         stand-in sees with was fitted for each model by {} updates.",
        how.vae_epochs,
        how.vae_updates,
        how.mdn_rnn_epochs,
        how.mdn_rnn_updates,
        how.held_out,
        how.probe_updates
    );
}

/// How others, or answers with mistakes, agree with the trial's own annotator.
fn disagreement(text: &mut String, rows: &Rows) {
    // Shares as whole thousandths, to be in order.
    let share = |share: f64| (1000.0 * share).round() as i64;
    let mut of: BTreeMap<_, Vec<[f64; 2]>> = BTreeMap::new();
    for row in &rows.0 {
        if let (Some(critical), Some(other)) = (row.critical_disagreement, row.other_disagreement) {
            let wrong = [share(row.critical_mistakes), share(row.other_mistakes)];
            of.entry((row.annotators, wrong)).or_default().push([critical, other]);
        }
    }
    for ((annotators, wrong), shares) in of {
        let mean = |i: usize| 100.0 * shares.iter().map(|share| share[i]).sum::<f64>() / shares.len() as f64;
        let whose = match wrong {
            [0, 0] => format!("{annotators:?} answers differ from careful ones"),
            [critical, other] => format!(
                "Where {} % of the critical and {} % of the other answers are to be wrong, they differ from those without mistakes",
                critical as f64 / 10.0,
                other as f64 / 10.0
            ),
        };
        let _ = writeln!(
            text,
            "\n{whose} in what is safe in {:.1} % of the queries that both answered, and otherwise in {:.1} %.",
            mean(0),
            mean(1)
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::named;
    use crate::experiment::table::made_up::{row, rows};
    use crate::query::Protocol;

    fn asked() -> Description {
        Description { seeds: vec![0, 1, 2], ..named("q3-justifications").unwrap() }
    }

    #[test]
    fn a_series_has_a_point_for_each_place_and_a_mean_for_each_seed() {
        let all = series(&asked(), &rows(), &Measure::Return);
        assert_eq!(all.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>(), ["DROP", "DROPJ"]);
        let point = &all[1].1[1];
        assert_eq!((point.x, &point.of_seeds[..]), (100.0, &[1100.5, 1110.5, 1120.5][..]));
        assert_eq!(point.episodes.len(), 6);
        assert!((point.mean[0] - 1110.5).abs() < 1e-9 && point.mean[1] >= 1100.5 && point.mean[2] <= 1120.5);
    }

    #[test]
    fn what_differs_on_every_seed_and_track_is_said_and_what_does_not_is_not() {
        let text = summary(&asked(), &rows(), 2);
        let line = |part: &str| {
            text.lines().find(|line| line.contains(part)).unwrap_or_else(|| panic!("{part}: {text}"))
        };
        assert!(line("trials are not done").contains("**2 of"));
        assert!(line("| DROPJ | 100 |").contains("1110 [") || line("| DROPJ | 100 |").contains("1111 ["));
        assert!(line("DROP − DROPJ").contains("-400") && line("DROP − DROPJ").ends_with("| differ | – |"));
        let bump = text.split("## bump").nth(1).unwrap();
        assert!(bump.contains("12.5 %") && bump.contains("not told apart") && !bump.contains("| differ |"));
        assert!(text.contains("By seeds alone nothing is said on fewer than 5"));
        let alone = Rows(rows().0.into_iter().filter(|row| row.seed == 0).collect());
        let text = summary(&asked(), &alone, 0);
        assert!(text.contains("Nothing is called different on one seed") && !text.contains("| differ |"));
    }

    #[test]
    fn mistakes_are_told_by_their_shares() {
        let mut rows = rows();
        for row in &mut rows.0 {
            (row.critical_mistakes, row.critical_disagreement, row.other_disagreement) =
                (0.05, Some(0.04), Some(0.001));
        }
        let text = summary(&asked(), &rows, 0);
        let told = "Where 5 % of the critical and 0 % of the other answers are to be wrong, they differ from those without mistakes \
                    in what is safe in 4.0 % of the queries that both answered, and otherwise in 0.1 %.";
        assert!(text.contains(told), "{text}");
    }

    #[test]
    fn by_seeds_alone_six_that_agree_differ_and_five_do_not() {
        let of = |n: u64| {
            let mut all = Vec::new();
            for seed in 0..n {
                for (method, better) in [(Protocol::Drop, 0.0), (Protocol::Dropj, 400.0)] {
                    for track in [100, 101] {
                        all.push(row(method, seed, 50, track, better + 7.0 * seed as f64 + track as f64));
                    }
                }
            }
            let text = summary(&Description { seeds: (0..n).collect(), ..asked() }, &Rows(all), 0);
            text.lines().find(|line| line.contains("DROP − DROPJ")).unwrap().to_owned()
        };
        assert!(of(5).ends_with("| differ | not told apart, p = 0.0625 |"), "{}", of(5));
        assert!(of(6).ends_with("| differ | differ, p = 0.0312 |"), "{}", of(6));
    }

    #[test]
    fn seeds_that_one_lacks_are_left_out_of_differences() {
        let mut rows = rows();
        // The first seed of DROPJ is missing: the others are still compared with themselves.
        rows.0.retain(|row| row.method != Protocol::Dropj || row.seed > 0);
        let text = summary(&asked(), &rows, 1);
        let line = text.lines().find(|line| line.contains("DROP − DROPJ")).unwrap();
        assert!(line.contains("| -400 [-400, -400] |"), "{line}");
    }
}
