//! `dropj compare`.

use std::path::PathBuf;

use anyhow::Context as _;
use dropj::evaluation::{EpisodeMetrics, Results, Summary, Untested, dunn, kruskal_wallis, table, untested};
use dropj::text::{distinct_files, shown};

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// What `deploy --json` printed, a file a method, which is called as its file; what is no result in it is passed over and
    /// said
    #[arg(num_args = 2.., required = true)]
    results: Vec<PathBuf>,
    /// Print the result as JSON: an object a line, a figure each
    #[arg(long)]
    json: bool,
}

/// Below so many values the distribution of χ² is a rough guide.
const FEW: usize = 5;

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    let names = distinct_files(&options.results);
    let mut methods = Vec::new();
    for (name, path) in names.iter().zip(&options.results) {
        let bytes = std::fs::read(path).with_context(|| format!("cannot read the results {path:?}"))?;
        let Results { episodes, notes, .. } = Results::parse(&bytes);
        if episodes.is_empty() {
            let why = notes.first().map_or("they are empty", String::as_str);
            anyhow::bail!("there are no episodes in these results, for {why}: {path:?}");
        }
        for note in notes {
            eprintln!("{}: {note}", shown(name));
        }
        if let Some(same) = methods.iter().position(|others: &Vec<EpisodeMetrics>| is_same(others, &episodes))
        {
            eprintln!(
                "{} and {} hold the same episodes, so they cannot differ",
                shown(&names[same]),
                shown(name)
            );
        }
        methods.push(episodes);
    }
    let names_shown: Vec<_> = names.iter().map(|name| shown(name)).collect();
    if !options.json {
        let summaries = methods.iter().map(|episodes| Summary::of(episodes));
        println!("{}", table(&names_shown.iter().map(String::as_str).zip(summaries).collect::<Vec<_>>()));
    }
    for figure in figures(&methods) {
        let value = |episode: &EpisodeMetrics| match figure.as_str() {
            RETURN => Some(episode.ret),
            UNSAFE => Some(episode.unsafe_rate),
            event => episode.event(event),
        };
        let values = |episodes: &Vec<EpisodeMetrics>| -> Vec<f64> {
            episodes.iter().filter_map(value).map(f64::from).filter(|value| value.is_finite()).collect()
        };
        let values: Vec<_> = methods.iter().map(values).collect();
        let groups: Vec<&[f64]> = values.iter().map(Vec::as_slice).collect();
        if groups.iter().all(|group| group.is_empty()) {
            // No episode had it.
            continue;
        }
        let why = untested(&groups).map(|why| in_words(why, &groups, &names_shown));
        let (test, pairs) = match why {
            None => (kruskal_wallis(&groups), dunn(&groups)),
            Some(_) => (None, Vec::new()),
        };
        if options.json {
            println!(
                "{}",
                serde_json::json!({
                    "figure": figure, "methods": names, "kruskal_wallis": test, "dunn": pairs, "untested": why
                })
            );
            continue;
        }
        let Some(test) = test else {
            let figure = shown(&figure);
            println!("{figure}: not tested, for {}", why.as_deref().unwrap_or("the ranks say nothing"));
            continue;
        };
        let figure = shown(&figure);
        println!("{figure}: Kruskal–Wallis H({}) = {:.3}, p {}", test.df, test.h, rounded(test.p));
        for pair in pairs {
            let (one, other) = (&names_shown[pair.pair.0], &names_shown[pair.pair.1]);
            println!("  {one} – {other}: Dunn z = {:+.3}, p {}", pair.z, rounded(pair.p));
        }
        let few = groups.iter().zip(&names_shown).find(|(group, _)| group.len() < FEW);
        if let Some((group, name)) = few {
            let values = if group.len() == 1 { "1 value" } else { &format!("{} values", group.len()) };
            println!("  {name} has {values}: with fewer than {FEW} these probabilities are rough");
        }
    }
    Ok(())
}

/// The names of the figures that are not of an event.
const RETURN: &str = "return";
const UNSAFE: &str = "unsafe";

/// The names of all figures that an episode of some method has.
fn figures(methods: &[Vec<EpisodeMetrics>]) -> Vec<String> {
    let mut all = vec![RETURN.to_owned(), UNSAFE.to_owned()];
    for figure in methods.iter().flatten().flat_map(|episode| &episode.events) {
        if !all.contains(&figure.name) {
            all.push(figure.name.clone());
        }
    }
    all
}

/// Why a figure is not tested.
fn in_words(why: Untested, groups: &[&[f64]], names: &[String]) -> String {
    match why {
        Untested::FewerThanTwo => "there are fewer than two methods".to_owned(),
        Untested::Empty(i) => format!("{} has no value of it", names[i]),
        Untested::OneEach => "each method has one value, which tells nothing of chance".to_owned(),
        Untested::AllEqual => {
            let value = groups.iter().find_map(|group| group.first()).copied().unwrap_or_default();
            format!("all values are equal ({value})")
        }
    }
}

/// Whether two results are of the very same episodes: no two drives take the same time to the last digit.
fn is_same(one: &[EpisodeMetrics], other: &[EpisodeMetrics]) -> bool {
    // A figure that is missing is the same as one that is missing.
    serde_json::json!(one) == serde_json::json!(other)
        && one.iter().any(|episode| episode.plan_ms_mean.is_some())
}

/// A probability to four digits, and never nothing.
fn rounded(p: f64) -> String {
    if p < 1e-4 { "< 0.0001".to_owned() } else { format!("= {p:.4}") }
}
