//! `dropj refit`.

use std::path::PathBuf;
use std::time::Instant;

use dropj::query::{Justifications, Protocol, Weights};
use dropj::reward::sparse::Rules;
use dropj::reward::{Learned, RewardConfig, RewardEnsemble, SparseConfig};
use dropj::session::{Event, SessionStore};

use super::choices::{Computing, FitName};
use super::error::CliError;
use super::learn::{NO_ANSWERS, NO_VERDICTS, fit_reward, fit_sparse, sparse_config};
use super::models;
use super::numbers::{above, count, named_weight, weight};
use super::run_file::RunFile;
use super::told::Form;

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The session whose answers are learned
    #[arg(long)]
    session: PathBuf,
    /// What else the justifications weigh from now on, such as grass=1,chuckhole=0.95,default=0.75: in the session's order
    #[arg(long, value_parser = named_weight, value_delimiter = ',')]
    weights: Vec<(String, f32)>,
    /// What it weighs from now on that only one clip is safe
    #[arg(long, value_parser = weight)]
    safety: Option<f32>,
    /// What a preference between safe clips weighs from now on
    #[arg(long, value_parser = weight)]
    default: Option<f32>,
    /// Steps of Adam
    #[arg(long, value_parser = count(1..=10_000_000))]
    updates: Option<usize>,
    /// How many networks the reward is the mean of [default: as many as before, at first the paper's 3]; of
    /// preferences alone
    #[arg(long, value_parser = clap::value_parser!(i64).range(1..=100))]
    members: Option<i64>,
    /// How preferences are learned: as we do, or as the authors do, for comparison
    #[arg(long, value_enum, default_value = "ours")]
    fit: FitName,
    /// Of initialization and order
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Learn from so many queries alone, the first that were asked, skipped ones too: for learning curves; of preferences alone
    #[arg(long, value_parser = count(1..=10_000_000))]
    first: Option<usize>,
    /// Also hold out this share of the answers, learn from the rest, and say how well those are predicted
    #[arg(long, value_parser = above(0.0, 0.9))]
    held_out: Option<f64>,
    /// Learn from verdicts on transitions as ReQueST did, each network by itself and classes alike; else as DROPJ's authors
    #[arg(long)]
    apart: bool,
    /// The session's world model, where it is not found by itself
    #[arg(long)]
    world: Option<PathBuf>,
    #[command(flatten)]
    computing: Computing,
    #[command(flatten)]
    form: Form,
    #[command(flatten)]
    pub(crate) run_file: RunFile,
}

/// How a session is learned, by what its answers are about.
#[derive(Debug)]
enum Learning {
    Preferences(RewardConfig),
    Verdicts(SparseConfig),
}

impl Options {
    /// What answers weigh from now on, where they weigh `now` what they do.
    fn weights(&self, now: &Weights) -> anyhow::Result<Weights> {
        reweighted(now, &self.weights, self.safety, self.default)
    }

    /// How answers under `protocol` are learned, where so many justifications can be named.
    fn learning(&self, protocol: Protocol, n_justifications: usize) -> Result<Learning, CliError> {
        if protocol.is_sparse() {
            let config = self.run_file.over("sparse", &sparse_config(protocol), SparseConfig::check)?;
            return Ok(Learning::Verdicts(SparseConfig {
                updates: self.updates.unwrap_or(config.updates),
                held_out: self.held_out.unwrap_or(config.held_out),
                rules: if self.apart { Rules::Apart } else { config.rules },
                ..config
            }));
        }
        let papers = RewardConfig::car_racing();
        // One of verdicts, or one that cannot be read, says nothing of this and stands in nobody's way.
        let kept = SessionStore::read_reward(&self.session).ok().and_then(|(_, parameters)| parameters);
        let kept = kept.and_then(|parameters| RewardEnsemble::load(&parameters).ok());
        let kept = kept.map(|reward| reward.config().members);
        let base = RewardConfig { members: kept.unwrap_or(papers.members), ..papers };
        let base = match self.fit {
            FitName::Ours => base,
            FitName::Hazards => RewardConfig { learned: Learned::Hazards, ..base },
            FitName::Paper => base.authors(n_justifications),
        };
        let config = self.run_file.over("reward", &base, RewardConfig::check)?;
        Ok(Learning::Preferences(RewardConfig {
            updates: self.updates.unwrap_or(config.updates),
            members: self.members.unwrap_or(config.members),
            ..config
        }))
    }
}

/// The weights `now` with others in place of those that are given; of justifications all or none.
pub(crate) fn reweighted(
    now: &Weights,
    named: &[(String, f32)],
    safety: Option<f32>,
    default: Option<f32>,
) -> anyhow::Result<Weights> {
    let mut weights = Weights {
        safety: safety.unwrap_or(now.safety),
        default: default.unwrap_or(now.default),
        ..now.clone()
    };
    if !named.is_empty() {
        weights.justifications = Justifications::new(named.iter().cloned())?;
        let names = |all: &Justifications| all.iter().map(|(_, name, _)| name.to_owned()).collect::<Vec<_>>();
        let wanted = names(&now.justifications);
        anyhow::ensure!(
            names(&weights.justifications) == wanted,
            "the answers of this session name {wanted:?}, in this order of severity: give each its weight"
        );
    }
    Ok(weights)
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    tch::set_num_threads(2);
    let model = models::of_session(&options.session, options.world.as_deref())?;
    let model = model.on(options.computing.backend()?)?;
    let mut store = SessionStore::open(&options.session, Some(model.identity()))?;
    let now = store.session().weights().clone();
    let weights = options.weights(&now)?;
    let learning = options.learning(store.session().protocol(), now.justifications.iter().count() - 1)?;
    if let Some(all) = options.run_file.to_print() {
        let all = all.with("safety", weights.safety).with("default", weights.default);
        let all = match &learning {
            Learning::Preferences(config) => all.with("reward", config),
            Learning::Verdicts(config) => all.with("sparse", config),
        };
        print!("{}", all.to_toml());
        return Ok(());
    }
    // Before anything is written: that there is something to learn from, and a place for what is learned.
    match learning {
        Learning::Preferences(_) => {
            anyhow::ensure!(!store.session().labeled_by(&weights).is_empty(), NO_ANSWERS);
        }
        Learning::Verdicts(_) => anyhow::ensure!(!store.session().judged().is_empty(), NO_VERDICTS),
    }
    SessionStore::check_folder(&options.session)?;
    if weights != now {
        store.record(Event::WeightsChanged { weights })?;
    }
    let started = Instant::now();
    let (fit, held_out) = match learning {
        Learning::Preferences(config) => {
            fit_reward(&mut store, &model, config, options.seed, options.held_out, options.first)?
        }
        Learning::Verdicts(config) => fit_sparse(&mut store, &model, config, options.seed)?,
    };
    let secs = started.elapsed().as_secs_f64();
    let told = serde_json::json!({
        "labels": fit.n_labels, "epochs": fit.epochs, "losses": fit.losses, "held_out": held_out, "secs": secs
    });
    options.form.tell(&told, || {
        let held_out = held_out.as_ref().map_or_else(String::new, ToString::to_string);
        format!("{held_out}{} labels, losses {:.4?}, {secs:.1} s", fit.n_labels, fit.losses)
    })
}
