//! `dropj compare`.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use dropj::evaluation::{EpisodeMetrics, Summary, dunn, kruskal_wallis, table};

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// What `deploy --json` printed, a file a method, which is called as its file
    #[arg(num_args = 2.., required = true)]
    results: Vec<PathBuf>,
    /// Print JSON: an object a figure
    #[arg(long)]
    json: bool,
}

/// A figure of an episode, and its name in the results.
type Figure = (&'static str, fn(&EpisodeMetrics) -> Option<f32>);

const FIGURES: [Figure; 5] = [
    ("return", |m| Some(m.ret)),
    ("new tiles", |m| Some(m.new_tile_rate)),
    ("grass", |m| Some(m.grass_rate)),
    ("chuckholes", |m| m.chuckhole_rate),
    ("cars", |m| m.car_rate),
];

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    let name = |path: &PathBuf| path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let names: Vec<String> = options.results.iter().map(name).collect();
    let methods: Vec<_> = options.results.iter().map(|path| read(path)).collect::<Result<_, _>>()?;
    if !options.json {
        let summaries = methods.iter().map(|episodes| Summary::of(episodes));
        println!("{}", table(&names.iter().map(String::as_str).zip(summaries).collect::<Vec<_>>()));
    }
    for (figure, value) in FIGURES {
        let values = |episodes: &Vec<EpisodeMetrics>| -> Vec<f64> {
            episodes.iter().filter_map(value).map(f64::from).collect()
        };
        let values: Vec<_> = methods.iter().map(values).collect();
        let groups: Vec<&[f64]> = values.iter().map(Vec::as_slice).collect();
        let Some(test) = kruskal_wallis(&groups) else { continue };
        let pairs = dunn(&groups);
        if options.json {
            println!(
                "{}",
                serde_json::json!({"figure": figure, "methods": names, "kruskal_wallis": test, "dunn": pairs})
            );
            continue;
        }
        println!("{figure}: Kruskal–Wallis H({}) = {:.3}, p {}", test.df, test.h, rounded(test.p));
        for pair in pairs {
            let (one, other) = (&names[pair.pair.0], &names[pair.pair.1]);
            println!("  {one} – {other}: Dunn z = {:+.3}, p {}", pair.z, rounded(pair.p));
        }
    }
    Ok(())
}

/// A probability to four digits, and never nothing.
fn rounded(p: f64) -> String {
    if p < 1e-4 { "< 0.0001".to_owned() } else { format!("= {p:.4}") }
}

/// The episodes in the lines that `deploy --json` printed; the line of their summary is passed over.
fn read(path: &Path) -> anyhow::Result<Vec<EpisodeMetrics>> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read the results {path:?}"))?;
    let mut episodes = Vec::new();
    for (i, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        let wrong = || format!("line {} is not what `deploy --json` prints: {path:?}", i + 1);
        let mut line: serde_json::Value = serde_json::from_str(line).with_context(wrong)?;
        match line.get_mut("metrics").map(serde_json::Value::take) {
            Some(metrics) => episodes.push(serde_json::from_value(metrics).with_context(wrong)?),
            None => anyhow::ensure!(line.get("summary").is_some(), wrong()),
        }
    }
    anyhow::ensure!(!episodes.is_empty(), "there are no episodes in {path:?}");
    Ok(episodes)
}
