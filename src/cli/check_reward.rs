//! `dropj check-reward`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use dropj::dream::Rows;
use dropj::query::{DreamId, LabeledQuery, SegmentRef};
use dropj::reward::{PredictionMetrics, RewardEnsemble, SegmentPair, Trainer, segment_rows};
use dropj::session::SessionStore;
use dropj::text::{distinct, shown};
use dropj::world::Action;
use dropj::world_model::WorldModel;

use super::models;

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The session whose latest reward is judged
    #[arg(long)]
    session: PathBuf,
    /// Sessions dreamed with the same world model, whose answers it has to predict
    #[arg(long, num_args = 1.., required = true)]
    on: Vec<PathBuf>,
    /// The world model of these sessions, where it is not found by itself
    #[arg(long)]
    world: Option<PathBuf>,
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    tch::set_num_threads(1);
    let model = models::of_session(&options.session, options.world.as_deref())?;
    let (_, parameters) = SessionStore::read_reward(&options.session)?;
    let parameters = parameters.context("this session has no reward yet: fit one with `dropj refit`")?;
    RewardEnsemble::load(&parameters)?.require(model.identity())?;
    for (name, other) in distinct(&options.on).iter().zip(&options.on) {
        let labels = labels(other, &model)?;
        println!("{}, {} answers:", shown(name), labels.len());
        // Certain labels are those that safety decides, or a preference where nothing else is asked.
        let (sure, unsure): (Vec<_>, Vec<_>) =
            labels.into_iter().partition(|pair| (pair.label.mu() - 0.5).abs() > 0.49);
        for (name, pairs) in [("one clip is surely better", sure), ("all others", unsure)] {
            let mut judge = Trainer::new(RewardEnsemble::load(&parameters)?);
            for pair in &pairs {
                judge.predict_and_add(pair);
            }
            let Some(figures) = judge.overall() else { continue };
            println!("  {name}: {}", in_words(&figures));
        }
    }
    Ok(())
}

fn in_words(figures: &PredictionMetrics) -> String {
    let agreement = figures.agreement.map_or_else(
        || "no side was named".to_owned(),
        |agreement| format!("{:.1} % of {} sides predicted", 100.0 * agreement, figures.n_strict),
    );
    let PredictionMetrics { n, log_loss, floor, .. } = figures;
    format!("{agreement}; loss {log_loss:.4} over {n}, of which {floor:.4} cannot be saved")
}

/// What was answered in the session in `dir`, as the reward reads it.
fn labels(dir: &Path, model: &WorldModel) -> anyhow::Result<Vec<SegmentPair>> {
    let (session, dreams) = SessionStore::read_dreams(dir, model.identity())?;
    let of = |episode: dropj::dream::DreamEpisode| {
        let features = episode.features(model);
        (episode.actions, features)
    };
    let dreams: BTreeMap<DreamId, (Vec<Action>, Rows)> =
        dreams.into_iter().map(|(id, episode)| (id, of(episode))).collect();
    let rows = |segment: SegmentRef| {
        let (actions, features) = &dreams[&segment.dream];
        segment_rows(features, actions, model.ranges(), segment)
    };
    let pair = |LabeledQuery { query, label }| {
        let (left, right) = (rows(query.left), rows(query.right));
        SegmentPair { left, right, label }
    };
    Ok(session.labeled().into_iter().map(pair).collect())
}
