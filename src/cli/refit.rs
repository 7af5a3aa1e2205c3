//! `dropj refit`.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context as _;
use dropj::query::{Justifications, SegmentRef, Weights};
use dropj::reward::{Figures, Fitted, RewardConfig, fit_anew, foretell_held_out, segment_rows};
use dropj::session::{Event, Fit, SessionStore};
use dropj::world_model::WorldModel;

use super::simulate::parse_weight;

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The session whose answers are learned
    #[arg(long)]
    session: PathBuf,
    /// What else the justifications weigh from now on, such as grass=1,chuckhole=0.95,default=0.75: in the session's order
    #[arg(long, value_parser = parse_weight, value_delimiter = ',')]
    weights: Vec<(String, f32)>,
    /// What it weighs from now on that only one clip is safe
    #[arg(long)]
    safety: Option<f32>,
    /// What a preference between safe clips weighs from now on
    #[arg(long)]
    default: Option<f32>,
    /// Steps of Adam
    #[arg(long)]
    updates: Option<usize>,
    /// Of initialization and order
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Also hold out this share of the answers, learn from the rest, and say how well those are foretold
    #[arg(long)]
    held_out: Option<f64>,
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    tch::set_num_threads(2);
    let model = SessionStore::read_world_model(&options.session)?;
    let mut store = SessionStore::open(&options.session, Some(&model.hash()))?;
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
    if weights != now {
        store.record(Event::WeightsChanged { weights })?;
    }
    let papers = RewardConfig::car_racing();
    let config = RewardConfig { updates: options.updates.unwrap_or(papers.updates), ..papers };
    let started = Instant::now();
    let fit = fit_reward(&mut store, &model, config, options.seed, options.held_out)?;
    println!("{} labels, losses {:.4?}, {:.1} s", fit.n_labels, fit.losses, started.elapsed().as_secs_f64());
    Ok(())
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
    for kept in store.session().dreams() {
        let episode = store.dream(kept.dream)?;
        let features = episode.features(model);
        dreams.insert(kept.dream, (episode.actions, features));
    }
    let rows = |segment: SegmentRef| {
        let (actions, features) = &dreams[&segment.dream];
        Ok::<_, Infallible>(segment_rows(features, actions, segment))
    };
    let labels = store.session().labeled();
    anyhow::ensure!(!labels.is_empty(), "there are no answers to learn from");
    let epochs = config.epochs(labels.len()) as u32;
    let figures = held_out.map(|share| {
        let Ok(figures) = foretell_held_out(model, config.clone(), seed, &labels, rows, share);
        figures
    });
    if let Some(figures) = figures {
        let Figures { n, log_loss, floor, n_strict, agreement } =
            figures.context("there are too few answers to hold some out")?;
        println!(
            "of {n} answers held out: log-loss {log_loss:.3} nats (at least {floor:.3}), \
             {:.0} % of {n_strict} strict ones foretold",
            100.0 * agreement.unwrap_or(0.0)
        );
    }
    let Ok(fitted) = fit_anew(model, config, seed, &labels, rows, |_| ControlFlow::Continue(()));
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
