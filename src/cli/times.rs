//! `dropj times`: the paper's Table 2, of any session.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use dropj::evaluation::{AnswerTimes, TimedAnswer, aligned};
use dropj::query::{Protocol, Response};
use dropj::run::read_at_most;
use dropj::session::responses::MOST;
use dropj::session::{SessionStore, protocol_of_released, read_responses};
use dropj::text::{distinct, shown};

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// Sessions, and answer files as the authors released them (responses_*.pkl)
    #[arg(num_args = 1.., required = true)]
    sources: Vec<PathBuf>,
    /// Print the result as JSON: an object a line, a source and protocol each
    #[arg(long)]
    json: bool,
}

/// The answers of a source, by what was asked where that is known.
type ByProtocol = BTreeMap<&'static str, Vec<TimedAnswer>>;

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    let heads = ["source", "asked", "answers", "s an answer", "median s", "skipped %", "labels/h"];
    let mut lines = vec![heads.map(str::to_owned).to_vec()];
    for (name, path) in distinct(&options.sources).into_iter().zip(&options.sources) {
        let by_protocol = if path.is_dir() { of_session(path)? } else { of_file(path)? };
        for (asked, answers) in by_protocol {
            let Some(times) = AnswerTimes::of(&answers) else { continue };
            if options.json {
                println!("{}", serde_json::json!({"source": name, "asked": asked, "times": times}));
                continue;
            }
            lines.push(vec![
                shown(&name),
                asked.to_owned(),
                times.secs.n.to_string(),
                format!("{:.2} ± {:.2}", times.secs.mean, times.secs.sd),
                format!("{:.1}", times.median_secs),
                format!("{:.0}", 100.0 * times.skipped),
                format!("{:.0}", times.labels_per_hour),
            ]);
        }
    }
    if !options.json {
        println!("{}", aligned(&lines));
    }
    Ok(())
}

fn of_session(dir: &Path) -> anyhow::Result<ByProtocol> {
    let (_, session) = SessionStore::read(dir)?;
    let mut by_protocol = ByProtocol::new();
    for given in session.answers() {
        let is_skipped = matches!(given.answer.response, Response::Skipped(_));
        let answer = TimedAnswer { secs: f64::from(given.answer.secs), is_skipped };
        by_protocol.entry(given.protocol.name()).or_default().push(answer);
    }
    Ok(by_protocol)
}

fn of_file(path: &Path) -> anyhow::Result<ByProtocol> {
    let bytes = read_at_most(path, MOST).with_context(|| format!("cannot read {path:?}"))?;
    let bytes = bytes.with_context(|| format!("no answer file has more than {MOST} bytes: {path:?}"))?;
    let records = read_responses(&bytes).with_context(|| format!("in the file {path:?}"))?;
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let asked = protocol_of_released(&name).map_or("unknown", Protocol::name);
    let answers = records.iter().map(|it| TimedAnswer { secs: it.secs, is_skipped: it.is_skipped });
    Ok([(asked, answers.collect())].into())
}
