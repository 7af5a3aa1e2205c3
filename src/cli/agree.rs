//! `dropj agree`, `dropj merge` and `dropj hand-on`: several annotators.

use std::fmt::Write as _;
use std::path::PathBuf;

use dropj::evaluation::{Agreement, aligned};
use dropj::run::{Kind, OutputFile};
use dropj::session::{Annotators, SessionStore, hand_on, merge_counted};
use dropj::text::{distinct, shown, shown_within};

use serde_json::json;

use super::numbers;
use super::told::Form;

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The sessions whose annotators are compared
    #[arg(num_args = 1.., required = true)]
    sessions: Vec<PathBuf>,
    /// Call annotators as their sessions' folders, so that the same name in two sessions is two annotators
    #[arg(long)]
    by_session: bool,
    /// Where to write the figures as a table
    #[arg(long)]
    csv: Option<PathBuf>,
    #[command(flatten)]
    form: Form,
}

#[derive(Debug, clap::Args)]
pub(crate) struct MergeOptions {
    /// The sessions to put together: of the same world model and the same justifications
    #[arg(num_args = 2.., required = true)]
    sessions: Vec<PathBuf>,
    /// The folder of the session to make
    #[arg(long)]
    out: PathBuf,
    #[command(flatten)]
    form: Form,
}

#[derive(Debug, clap::Args)]
pub(crate) struct HandOnOptions {
    /// The session whose dreams and queries are handed on
    session: PathBuf,
    /// Who is to answer them
    #[arg(long, value_parser = numbers::name)]
    annotator: String,
    /// The folder of the session to make
    #[arg(long)]
    out: PathBuf,
    #[command(flatten)]
    form: Form,
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    let csv = options.csv.as_deref().map(|path| OutputFile::at(path, Kind::Table)).transpose()?;
    let mut sessions = Vec::new();
    for (name, dir) in distinct(&options.sessions).into_iter().zip(&options.sessions) {
        sessions.push((name, SessionStore::read(dir)?.1));
    }
    let annotators = if options.by_session {
        Annotators::of(
            &sessions.iter().map(|(name, session)| (Some(name.as_str()), session)).collect::<Vec<_>>(),
        )
    } else {
        let named: Vec<_> = sessions.iter().map(|(name, session)| (name.clone(), session)).collect();
        Annotators::of_sessions(&named)
    };
    for note in &annotators.notes {
        eprintln!("{}", shown_within(note, 200));
    }
    if let Some(csv) = csv {
        csv.write(annotators.to_csv().as_bytes())?;
    }
    options.form.tell(&figures(&annotators), || {
        let pairs = if annotators.pairs.is_empty() {
            "no two annotators answered the same query".to_owned()
        } else {
            table_of_pairs(&annotators)
        };
        format!("{}\n{pairs}\n", table_of_each(&annotators))
    })
}

/// The same for other programs.
fn figures(annotators: &Annotators) -> serde_json::Value {
    let each = annotators.each.iter().map(|one| {
        json!({
            "annotator": one.name, "answered": one.n_answered, "skipped": one.n_skipped, "hallucinated": one.n_hallucinated,
            "labels_per_hour": one.labels_per_hour(), "median_secs": one.median_secs, "again": one.consistency
        })
    });
    let pairs =
        annotators.pairs.iter().map(|(names, found)| json!({"annotators": names, "agreement": found}));
    json!({"annotators": each.collect::<Vec<_>>(), "pairs": pairs.collect::<Vec<_>>(), "notes": annotators.notes})
}

fn table_of_each(annotators: &Annotators) -> String {
    let heads =
        ["annotator", "answered", "skipped", "hallucinated", "labels/h", "median s", "again", "as before %"];
    let mut lines = vec![heads.map(str::to_owned).to_vec()];
    for one in &annotators.each {
        let again = one.consistency;
        lines.push(vec![
            shown(&one.name),
            one.n_answered.to_string(),
            one.n_skipped.to_string(),
            one.n_hallucinated.to_string(),
            figure(one.labels_per_hour().map(f64::from), 0),
            figure(one.median_secs.map(f64::from), 1),
            again.map_or(0, |again| again.n).to_string(),
            figure(again.map(|again| 100.0 * again.share()), 0),
        ]);
    }
    aligned(&lines)
}

fn table_of_pairs(annotators: &Annotators) -> String {
    let heads = ["both answered", "queries", "same %", "critical %", "other %", "kappa", "kappa of safety"];
    let mut lines = vec![heads.map(str::to_owned).to_vec()];
    for ([one, other], found) in &annotators.pairs {
        let Agreement { n, n_same, n_critical, kappa, safety_kappa } = *found;
        let percent = |part: usize| figure(Some(100.0 * part as f64 / n as f64), 0);
        lines.push(vec![
            format!("{} – {}", shown(one), shown(other)),
            n.to_string(),
            percent(n_same),
            percent(n_critical),
            percent(found.n_other()),
            figure(kappa, 2),
            figure(safety_kappa, 2),
        ]);
    }
    aligned(&lines)
}

fn figure(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "–".to_owned(), |value| format!("{value:.digits$}"))
}

pub(crate) fn run_merge(options: &MergeOptions) -> anyhow::Result<()> {
    let (merged, n_same) = merge_counted(&options.sessions, &options.out)?;
    let statistics = merged.session().statistics();
    let annotators: Vec<_> = merged.session().annotators().into_keys().collect();
    let n_dreams = merged.session().dreams().len();
    let told = json!({
        "session": options.out, "dreams": n_dreams, "answered": statistics.n_answered, "skipped": statistics.n_skipped,
        "annotators": annotators, "same_queries": n_same
    });
    options.form.tell(&told, || {
        let mut words = format!(
            "{n_dreams} dreams, {} answers, {} skipped, of {}: {:?}\n",
            statistics.n_answered,
            statistics.n_skipped,
            annotators.iter().map(|name| shown(name)).collect::<Vec<_>>().join(", "),
            options.out
        );
        if n_same > 0 {
            writeln!(words, "{n_same} queries stood in several of these sessions and count once").ok();
        }
        words + &format!("the reward is yet to be learned: dropj refit --session {:?}\n", options.out)
    })
}

pub(crate) fn run_hand_on(options: &HandOnOptions) -> anyhow::Result<()> {
    let handed = hand_on(&options.session, &options.out, &options.annotator)?;
    let n_queries = handed.session().pending().count();
    let told = json!({"session": options.out, "annotator": options.annotator, "queries": n_queries});
    options.form.tell(&told, || {
        format!("{n_queries} queries for {}: dropj --session {:?}", shown(&options.annotator), options.out)
    })
}
