//! `dropj screen`.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use dropj::dream::screen::{Pair, Screen, Spared};
use dropj::dream::signs::{N_SIGNS, SIGNS};
use dropj::evaluation::{aligned, auc};
use dropj::run::{Kind, OutputFile};
use dropj::session::SessionStore;
use dropj::text::{cell, distinct};

use serde_json::json;

use super::meter::Meter;
use super::models;
use super::told::Form;

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// Sessions in which some queries were skipped as hallucinated, such as by `simulate --eps-skip 0.35`
    #[arg(num_args = 1.., required = true)]
    sessions: Vec<PathBuf>,
    /// Where to write the signs of every pair as a table
    #[arg(long)]
    csv: Option<PathBuf>,
    /// The world model of these sessions, where it is not found by itself
    #[arg(long)]
    world: Option<PathBuf>,
    #[command(flatten)]
    form: Form,
}

/// Shares of all pairs that could be held back.
const SHARES: [f32; 6] = [0.05, 0.1, 0.2, 0.3, 0.4, 0.5];

/// A session, its screen, and what was judged in it in the order of asking.
struct Judged {
    screen: Screen,
    judged: Vec<(Pair, bool)>,
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    tch::set_num_threads(1);
    let csv = options.csv.as_deref().map(|path| OutputFile::at(path, Kind::Table)).transpose()?;
    let mut sessions = Vec::new();
    let mut meter = Meter::new();
    for (i, dir) in options.sessions.iter().enumerate() {
        meter.at("reading sessions", i, options.sessions.len(), String::new);
        sessions.push(read(dir, options.world.as_deref())?);
    }
    drop(meter);
    if let Some(csv) = csv {
        csv.write(table(&options.sessions, &sessions).as_bytes())?;
    }
    let n = sessions.iter().map(|session| session.judged.len()).sum::<usize>();
    let is_bad = sessions.iter().flat_map(|session| &session.judged).filter(|(_, is_bad)| *is_bad);
    let n_bad = is_bad.count();
    let mut words = format!(
        "{n} pairs, {n_bad} of them skipped as hallucinated\n\n\
         How often a skipped pair has more of a sign than another (0.5 is chance), and what it counts:\n"
    );
    let mut signs = serde_json::Map::new();
    let mut lines = vec![["sign", "how often", "counts"].map(str::to_owned).to_vec()];
    let weights: Vec<_> = Screen::default().weights().collect();
    for (i, (name, weight)) in weights.into_iter().enumerate() {
        let scored = scored(&sessions, |session, pair| session.screen.signs(pair).map(|signs| signs[i]));
        lines.push(vec![name.to_owned(), figure(auc(&scored)), format!("{weight:+.2}")]);
        signs.insert(name.to_owned(), json!({"auc": auc(&scored), "weight": weight}));
    }
    let shipped = |session: &Judged, pair: Pair| session.screen.anomaly(pair).map(f64::from);
    let together = auc(&scored(&sessions, shipped));
    lines.push(vec!["together".to_owned(), figure(together), String::new()]);
    words += &aligned(&lines);
    words += "\nHeld back with the weights as they are shipped:\n";
    let as_shipped = spared(&sessions);
    words += &spared_lines(&as_shipped);

    let taught: Vec<_> = sessions.into_iter().map(taught_by_half).collect();
    let then = auc(&scored(&taught, shipped));
    let once_taught = spared(&taught);
    write!(
        words,
        "\nHeld back of the second half of each session, once taught by its first half:\ntogether: {}\n{}",
        figure(then),
        spared_lines(&once_taught)
    )?;
    let figures = |auc: Option<f64>, spared: &[(f32, Spared)]| {
        let held_back = spared.iter().map(|(share, spared)| {
            let Spared { n_bad, n_spared, n_good, n_lost } = spared;
            json!({"share": share, "skips": n_bad, "skips_saved": n_spared, "others": n_good, "others_lost": n_lost})
        });
        json!({"auc": auc, "held_back": held_back.collect::<Vec<_>>()})
    };
    let told = json!({
        "pairs": n, "hallucinated": n_bad, "signs": signs, "as_shipped": figures(together, &as_shipped),
        "once_taught": figures(then, &once_taught)
    });
    options.form.tell(&told, || words)
}

fn read(dir: &Path, world: Option<&Path>) -> anyhow::Result<Judged> {
    let model = models::of_session(dir, world)?;
    let (session, dreams) = SessionStore::read_dreams(dir, model.identity())?;
    let mut screen = Screen::default();
    for (id, episode) in dreams {
        let signs = episode.signs(&model, || true).unwrap_or_else(|| unreachable!("nobody says no"));
        screen.add_dream(id, &signs);
    }
    Ok(Judged { screen, judged: session.looked_at() })
}

/// The second half of what was judged, and a screen that knows what was said of the first.
fn taught_by_half(mut session: Judged) -> Judged {
    let second = session.judged.split_off(session.judged.len() / 2);
    session.screen.learn(&session.judged);
    Judged { judged: second, ..session }
}

/// Every pair's score, and whether it was skipped as hallucinated.
fn scored(sessions: &[Judged], score: impl Fn(&Judged, Pair) -> Option<f64>) -> Vec<(f64, bool)> {
    let of = |session| Judged::scored(session, &score);
    sessions.iter().flat_map(of).collect()
}

impl Judged {
    fn scored(&self, score: &impl Fn(&Self, Pair) -> Option<f64>) -> Vec<(f64, bool)> {
        self.judged.iter().filter_map(|(pair, is_bad)| Some((score(self, *pair)?, *is_bad))).collect()
    }
}

/// What holding back a share of all pairs would have saved, and cost.
fn spared(sessions: &[Judged]) -> Vec<(f32, Spared)> {
    let of_all = SHARES.iter().map(|&share| {
        let mut all = Spared::default();
        for session in sessions {
            let spared = session.screen.spared(&session.judged, share);
            (all.n_bad, all.n_spared) = (all.n_bad + spared.n_bad, all.n_spared + spared.n_spared);
            (all.n_good, all.n_lost) = (all.n_good + spared.n_good, all.n_lost + spared.n_lost);
        }
        (share, all)
    });
    of_all.collect()
}

/// The same as a table.
fn spared_lines(spared: &[(f32, Spared)]) -> String {
    let mut lines = vec![["share %", "skips saved", "%", "others lost", "%"].map(str::to_owned).to_vec()];
    for &(share, Spared { n_bad, n_spared, n_good, n_lost }) in spared {
        let of = |some: usize, all: usize| {
            let percent = 100.0 * some as f64 / all.max(1) as f64;
            [format!("{some} of {all}"), format!("{percent:.0}")]
        };
        let share = format!("{:.0}", 100.0 * share);
        lines.push([vec![share], of(n_spared, n_bad).to_vec(), of(n_lost, n_good).to_vec()].concat());
    }
    aligned(&lines)
}

fn figure(auc: Option<f64>) -> String {
    auc.map_or_else(|| "–".to_owned(), |auc| format!("{auc:.3}"))
}

fn table(dirs: &[PathBuf], sessions: &[Judged]) -> String {
    let mut text = format!("session,hallucinated,{}\n", SIGNS.join(","));
    for (name, session) in distinct(dirs).iter().zip(sessions) {
        for (pair, is_bad) in &session.judged {
            let Some(signs): Option<[f64; N_SIGNS]> = session.screen.signs(*pair) else { continue };
            let signs = signs.map(|sign| sign.to_string()).join(",");
            writeln!(text, "{},{is_bad},{signs}", cell(name)).ok();
        }
    }
    text
}
