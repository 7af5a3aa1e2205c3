//! `dropj check-reward`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use dropj::dataset::Dataset;
use dropj::dream::Rows;
use dropj::evaluation::{HazardRanking, HazardTally, aligned};
use dropj::planner::PlannerConfig;
use dropj::query::{DreamId, Justification, LabeledQuery, Response, SegmentRef, Verdict};
use dropj::reward::{LearnedReward, PredictionMetrics, RewardEnsemble, SegmentPair, Trainer, segment_rows};
use dropj::session::{Header, Session, SessionStore};
use dropj::text::{distinct, shown};
use dropj::world::{Action, EventKind, EventSpec, WorldSpec};
use dropj::world_model::WorldModel;
use serde::Serialize;

use super::chosen_world::ChosenWorld;
use super::meter::Meter;
use super::models;
use super::numbers::count;
use super::told::Form;

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The session whose latest reward is judged
    #[arg(long)]
    session: PathBuf,
    /// Sessions dreamed with the same world model, whose answers it has to predict
    #[arg(long, num_args = 1..)]
    on: Vec<PathBuf>,
    /// Recordings, by which is told how well it ranks real moments with each hazard below those without any
    #[arg(long)]
    data: Option<PathBuf>,
    /// How many of the recorded episodes, spread over all
    #[arg(long, value_parser = count(1..=100_000), default_value_t = 10)]
    episodes: usize,
    #[command(flatten)]
    form: Form,
    /// The world model of these sessions, where it is not found by itself
    #[arg(long)]
    world: Option<PathBuf>,
}

/// What is told of a reward.
#[derive(Serialize)]
struct Told {
    /// How many answers there are from which something is learned.
    n_answers: usize,
    /// How many of them rest on nothing unsafe.
    n_by_default: usize,
    hazards: Vec<Hazard>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    predictions: Vec<Predicted>,
}

/// What a reward was told of a hazard, and what it makes of it.
#[derive(Serialize)]
struct Hazard {
    hazard: String,
    /// Answers that name it, or, where nothing is named, that call a clip unsafe.
    n_named: usize,
    /// Answers in which it is active.
    n_active: usize,
    #[serde(flatten)]
    ranked: Option<Ranked>,
}

/// How recorded moments with it are ranked.
#[derive(Serialize)]
struct Ranked {
    n_with: usize,
    n_without: usize,
    auc: Option<f64>,
    mean_with: Option<f64>,
    mean_without: Option<f64>,
}

/// How well the answers of a session are predicted.
#[derive(Serialize)]
struct Predicted {
    session: String,
    answers: &'static str,
    #[serde(flatten)]
    figures: PredictionMetrics,
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    tch::set_num_threads(1);
    let model = models::of_session(&options.session, options.world.as_deref())?;
    let (session, parameters) = SessionStore::read_reward(&options.session)?;
    let parameters = parameters.context("this session has no reward yet: fit one with `dropj refit`")?;
    let reward = LearnedReward::load(&parameters, &model)?;
    let rankings = match &options.data {
        Some(dir) => ranked(dir, options.episodes, &model, &reward)?,
        None => Vec::new(),
    };
    // The world of the session may have fewer hazards than that of the model's recordings.
    let here = Header::read(&options.session)
        .ok()
        .and_then(|header| ChosenWorld::of_session(&header, Some(&model)).ok());
    let mut told = said(&session, here.as_ref().map_or(model.spec(), |here| &here.spec));
    for hazard in &mut told.hazards {
        let ranking = rankings.iter().find(|ranking| ranking.event == hazard.hazard);
        hazard.ranked =
            ranking.map(|&HazardRanking { n_with, n_without, auc, mean_with, mean_without, .. }| Ranked {
                n_with,
                n_without,
                auc,
                mean_with,
                mean_without,
            });
    }
    for (name, other) in distinct(&options.on).iter().zip(&options.on) {
        let labels = labels(other, &model)?;
        // Certain labels are those that safety decides, or a preference where nothing else is asked.
        let (sure, unsure): (Vec<_>, Vec<_>) =
            labels.into_iter().partition(|pair| (pair.label.mu() - 0.5).abs() > 0.49);
        let (mut meter, n, mut done) = (Meter::new(), sure.len() + unsure.len(), 0);
        for (answers, pairs) in [("one clip is surely better", sure), ("all others", unsure)] {
            let mut judge = Trainer::new(RewardEnsemble::load(&parameters)?);
            for pair in &pairs {
                meter.at("predicting answers", done, n, String::new);
                done += 1;
                judge.predict_and_add(pair);
            }
            let figures = judge.overall();
            told.predictions.extend(figures.map(|figures| Predicted {
                session: name.clone(),
                answers,
                figures,
            }));
        }
    }
    options.form.tell(&told, || in_lines(&told))
}

/// What the answers of a session are about.
fn said(session: &Session, spec: &WorldSpec) -> Told {
    let justifications = &session.weights().justifications;
    let stands_for = |justification: Justification, event: &str| {
        let name = justifications.iter().find(|(it, ..)| *it == justification).map(|(_, name, _)| name);
        let named = spec.justifications.iter().find(|it| Some(it.name.as_str()) == name);
        named.is_some_and(|named| named.events.iter().any(|it| it == event))
    };
    let counts = session.queries().iter().filter(|asked| asked.repeats().is_none());
    let responses: Vec<_> = counts.filter_map(|asked| Some(asked.answer()?.answer.response)).collect();
    let n_of = |is: &dyn Fn(Response) -> bool| responses.iter().filter(|response| is(**response)).count();
    let is_unsafe = |response: Response| match response {
        Response::Judged(verdict) => verdict == Verdict::Unsafe,
        Response::Safety(_) => response.safety().is_some_and(|both| both != [true, true]),
        Response::Justified(..) | Response::Preferred(_) | Response::Skipped(_) => false,
    };
    let hazard = |event: &EventSpec| {
        let name = &event.name;
        let n_named = n_of(&|response| match response {
            Response::Justified(active, _) => stands_for(active.most_severe(), name),
            other => is_unsafe(other),
        });
        let n_active = n_of(&|response| match response {
            Response::Justified(active, _) => active.iter().any(|it| stands_for(it, name)),
            other => is_unsafe(other),
        });
        Hazard { hazard: name.clone(), n_named, n_active, ranked: None }
    };
    Told {
        n_answers: n_of(&|response| !matches!(response, Response::Skipped(_))),
        n_by_default: n_of(&|response| match response {
            Response::Justified(active, _) => active.most_severe() == justifications.default(),
            Response::Skipped(_) => false,
            other => !is_unsafe(other),
        }),
        hazards: spec.events_of(EventKind::Safety).map(hazard).collect(),
        predictions: Vec::new(),
    }
}

/// How recorded moments are ranked, by `n` of the episodes in `dir`.
fn ranked(
    dir: &Path,
    n: usize,
    model: &WorldModel,
    reward: &LearnedReward,
) -> anyhow::Result<Vec<HazardRanking>> {
    let dataset = Dataset::open_as(dir, model.spec())?;
    let reset = PlannerConfig::of_model(model).memory_reset;
    let all = dataset.n_episodes();
    let n = n.min(all);
    let mut tally = HazardTally::new(model.spec());
    let mut meter = Meter::new();
    for i in 0..n {
        meter.at("looking at episodes", i, n, String::new);
        tally.add(model, reward, &dataset.episode(i * all / n)?, reset);
    }
    Ok(tally.rankings())
}

fn in_lines(told: &Told) -> String {
    let mut lines =
        format!("{} answers, {} of them about nothing unsafe\n", told.n_answers, told.n_by_default);
    let number = |value: Option<f64>| value.map_or_else(|| "–".to_owned(), |value| format!("{value:.3}"));
    let heads =
        ["hazard", "named by", "active in", "steps", "ranked below safe", "mean reward", "where safe"];
    let n_columns = if told.hazards.iter().any(|hazard| hazard.ranked.is_some()) { heads.len() } else { 3 };
    let rows = told.hazards.iter().map(|hazard| {
        let mut cells = vec![shown(&hazard.hazard), hazard.n_named.to_string(), hazard.n_active.to_string()];
        if let Some(ranked) = &hazard.ranked {
            cells.push(ranked.n_with.to_string());
            cells.extend([ranked.auc, ranked.mean_with, ranked.mean_without].map(number));
        }
        cells
    });
    let head = heads[..n_columns].iter().map(|&head| head.to_owned()).collect();
    lines += &aligned(&std::iter::once(head).chain(rows).collect::<Vec<Vec<String>>>());
    let mut last = None;
    for Predicted { session, answers, figures } in &told.predictions {
        if last != Some(session) {
            lines.extend([&shown(session), ":\n"]);
            last = Some(session);
        }
        lines.extend(["  ", answers, ": ", &in_words(figures), "\n"]);
    }
    lines
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
