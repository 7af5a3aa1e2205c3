//! `dropj refit`.

use std::collections::{BTreeMap, btree_map};
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context as _;
use dropj::query::{Justifications, Protocol, SegmentRef, Transition, Weights};
use dropj::reward::sparse::Rules;
use dropj::reward::{
    Fitted, HeldOut, PredictionMetrics, RewardConfig, RewardEnsemble, SparseConfig, SparseFit, fit_anew,
    fit_sparse_anew, predict_held_out, segment_rows, transition_row,
};
use dropj::session::{Event, Fit, SessionError, SessionStore};
use dropj::tensor::NotFinite;
use dropj::world_model::WorldModel;

use super::models;
use super::numbers::{above, count, named_weight, weight};

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
    /// Of initialization and order
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Also hold out this share of the answers, learn from the rest, and say how well those are foretold
    #[arg(long, value_parser = above(0.0, 0.9))]
    held_out: Option<f64>,
    /// Learn from verdicts on transitions as ReQueST did, each network by itself and classes alike; else as DROPJ's authors
    #[arg(long)]
    apart: bool,
    /// The session's world model, where it is not found by itself
    #[arg(long)]
    world: Option<PathBuf>,
}

const NO_VERDICTS: &str = "there are no verdicts to learn from";
const NO_ANSWERS: &str = "there are no answers to learn from";

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    tch::set_num_threads(2);
    let model = models::of_session(&options.session, options.world.as_deref())?;
    let mut store = SessionStore::open(&options.session, Some(model.identity()))?;
    let now = store.session().weights().clone();
    let mut weights = Weights {
        safety: options.safety.unwrap_or(now.safety),
        default: options.default.unwrap_or(now.default),
        ..now.clone()
    };
    if !options.weights.is_empty() {
        weights.justifications = Justifications::new(options.weights.iter().cloned())?;
        let names = |all: &Justifications| all.iter().map(|(_, name, _)| name.to_owned()).collect::<Vec<_>>();
        let wanted = names(&now.justifications);
        anyhow::ensure!(
            names(&weights.justifications) == wanted,
            "the answers of this session name {wanted:?}, in this order of severity: give each its weight"
        );
    }
    // Before anything is written: that there is something to learn from, and a place for what is learned.
    if store.session().protocol().is_sparse() {
        anyhow::ensure!(!store.session().judged().is_empty(), NO_VERDICTS);
    } else {
        anyhow::ensure!(!store.session().labeled_by(&weights).is_empty(), NO_ANSWERS);
    }
    SessionStore::check_folder(&options.session)?;
    if weights != now {
        store.record(Event::WeightsChanged { weights })?;
    }
    let started = Instant::now();
    let fit = if store.session().protocol().is_sparse() {
        let papers = sparse_config(store.session().protocol());
        let (updates, held_out) = (options.updates, options.held_out);
        let config = SparseConfig {
            updates: updates.unwrap_or(papers.updates),
            held_out: held_out.unwrap_or(papers.held_out),
            rules: if options.apart { Rules::Apart } else { papers.rules },
            ..papers
        };
        fit_sparse(&mut store, &model, config, options.seed)?
    } else {
        let papers = RewardConfig::car_racing();
        let (updates, members) = (options.updates, options.members);
        // One of verdicts, or one that cannot be read, says nothing of this and stands in nobody's way.
        let kept = SessionStore::read_reward(&options.session).ok().and_then(|(_, parameters)| parameters);
        let kept = kept.and_then(|parameters| RewardEnsemble::load(&parameters).ok());
        let kept = kept.map(|reward| reward.config().members);
        let config = RewardConfig {
            updates: updates.unwrap_or(papers.updates),
            members: members.or(kept).unwrap_or(papers.members),
            ..papers
        };
        fit_reward(&mut store, &model, config, options.seed, options.held_out)?
    };
    println!("{} labels, losses {:.4?}, {:.1} s", fit.n_labels, fit.losses, started.elapsed().as_secs_f64());
    Ok(())
}

/// How verdicts given under `protocol` are learned.
pub(super) fn sparse_config(protocol: Protocol) -> SparseConfig {
    if protocol == Protocol::Request { SparseConfig::request() } else { SparseConfig::dros() }
}

/// Fits a fresh classifier to every verdict of the session and keeps it there.
pub(super) fn fit_sparse(
    store: &mut SessionStore,
    model: &WorldModel,
    config: SparseConfig,
    seed: u64,
) -> anyhow::Result<Fit> {
    // Batches are small: a second thread would mostly be waited for.
    tch::set_num_threads(1);
    let judged = store.session().judged();
    anyhow::ensure!(!judged.is_empty(), NO_VERDICTS);
    let mut dreams = BTreeMap::new();
    let row = |transition: Transition| {
        let (actions, features) = match dreams.entry(transition.dream) {
            btree_map::Entry::Occupied(read) => read.into_mut(),
            btree_map::Entry::Vacant(unread) => {
                let episode = store.dream(transition.dream)?;
                let features = episode.features(model);
                unread.insert((episode.actions, features))
            }
        };
        Ok::<_, SessionError>(transition_row(features, actions, transition.step))
    };
    let mut epochs = 0;
    let fitted = fit_sparse_anew(model, config, seed, &judged, row, |report| {
        epochs = report.epoch as u32;
        ControlFlow::Continue(())
    })?;
    let SparseFit { reward, losses, held_out } = fitted.context("the fit was broken off")?;
    if let Some(HeldOut { n, loss, accuracy }) = held_out {
        println!("of {n} verdicts held out: log-loss {loss:.3} nats, {:.0} % foretold", 100.0 * accuracy);
    }
    let (after, n_labels) = (store.session().n_entries(), judged.len());
    let fit = Fit { after, n_labels, seed, epochs, losses, held_out: held_out.map(|held_out| held_out.loss) };
    store.save_reward(&reward.parameters(), fit.clone())?;
    Ok(fit)
}

/// Fits a fresh reward to every answer of the session and keeps it there.
pub(super) fn fit_reward(
    store: &mut SessionStore,
    model: &WorldModel,
    config: RewardConfig,
    seed: u64,
    held_out: Option<f64>,
) -> anyhow::Result<Fit> {
    let mut dreams = BTreeMap::new();
    for (id, _) in store.session().dream_lens() {
        let episode = store.dream(id)?;
        let features = episode.features(model);
        dreams.insert(id, (episode.actions, features));
    }
    let rows = |segment: SegmentRef| {
        let (actions, features) = &dreams[&segment.dream];
        Ok::<_, NotFinite>(segment_rows(features, actions, segment))
    };
    let labels = store.session().labeled();
    anyhow::ensure!(!labels.is_empty(), NO_ANSWERS);
    let epochs = config.epochs(labels.len()) as u32;
    let figures = held_out.map(|share| predict_held_out(model, config.clone(), seed, &labels, rows, share));
    let figures = figures.transpose()?;
    if let Some(figures) = figures {
        let PredictionMetrics { n, log_loss, floor, n_strict, agreement } =
            figures.context("there are too few answers to hold some out")?;
        println!(
            "of {n} answers held out: log-loss {log_loss:.3} nats (at least {floor:.3}), \
             {:.0} % of {n_strict} strict ones foretold",
            100.0 * agreement.unwrap_or(0.0)
        );
    }
    let fitted = fit_anew(model, config, seed, &labels, rows, |_| ControlFlow::Continue(()))?;
    let Fitted { trainer, losses } = fitted.context("the fit was broken off")?;
    let after = store.session().n_entries();
    let fit = Fit {
        after,
        n_labels: labels.len(),
        seed,
        epochs,
        losses,
        held_out: figures.flatten().map(|figures| figures.log_loss as f32),
    };
    store.save_reward(&trainer.ensemble().parameters(), fit.clone())?;
    Ok(fit)
}
