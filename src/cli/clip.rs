//! `dropj clip`: what somebody saw, as a GIF to show to others.

use std::path::PathBuf;

use anyhow::Context as _;
use dropj::clip::{self, Clip};
use dropj::dream::DreamEpisode;
use dropj::query::{DreamId, QueryId, SEGMENT_LEN, SegmentRef};
use dropj::run::{Kind, OutputFile};
use dropj::session::{Session, SessionStore};
use dropj::world::Frame;
use dropj::world_model::WorldModel;

use super::choices::Switch;
use super::clip_real::{Compared, drive};
use super::models;
use super::numbers::count;
use super::told::Form;

/// Of a dream every second step is shown.
const EVERY: usize = 2;
/// Of an episode in the real world every third.
const EVERY_REAL: usize = 3;

#[derive(Debug, clap::Args)]
#[command(group = clap::ArgGroup::new("what").required(true).args(["query", "dream", "deploy", "beside"]))]
pub(crate) struct Options {
    /// The session
    #[arg(long)]
    session: PathBuf,
    /// The number of a query, from 0: both clips as they were compared; the better one has a whole blue frame, the other a broken
    /// orange one
    #[arg(long)]
    query: Option<u32>,
    /// The number of a dream, from 0
    #[arg(long)]
    dream: Option<u32>,
    /// The seed of an episode in the real world: the planner acts by the session's reward, beside the futures that it chose from
    #[arg(long, value_name = "SEED")]
    deploy: Option<u64>,
    /// The same, beside what the world model dreams under the same actions
    #[arg(long, value_name = "SEED")]
    beside: Option<u64>,
    /// After how many steps the dream beside looks at the real world and begins anew; 0 is never
    #[arg(long, value_parser = count(0..=1_000_000), default_value_t = 50, conflicts_with_all = ["query", "dream", "deploy"])]
    look_every: usize,
    /// The first step that is shown of a dream or an episode
    #[arg(long, value_parser = count(0..=10_000_000), default_value_t = 0, conflicts_with = "query")]
    from: usize,
    /// How many steps are shown of a dream [default: 500] or an episode [default: 300]
    #[arg(long, value_parser = count(1..=10_000), conflicts_with = "query")]
    steps: Option<usize>,
    /// The driving aids of the paper's evaluation, where there are obstacles
    #[arg(long, value_enum, default_value = "on")]
    aids: Switch,
    /// How many pixels wide and high each of its pixels is [default: as many as can be shown well]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=8))]
    scale: Option<u32>,
    /// The GIF to write
    #[arg(long)]
    out: PathBuf,
    /// The session's world model, where it is not found by itself
    #[arg(long)]
    world: Option<PathBuf>,
    #[command(flatten)]
    form: Form,
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    tch::set_num_threads(1);
    let output = OutputFile::at(&options.out, Kind::Clip)?;
    let model = models::of_session(&options.session, options.world.as_deref())?;
    let (clip, told) = match (options.deploy, options.beside) {
        (Some(seed), _) => real(options, &model, seed, None)?,
        (_, Some(seed)) => {
            let reset = (options.look_every > 0).then_some(options.look_every);
            real(options, &model, seed, Some(Compared { reset }))?
        }
        (None, None) => dreamed(options, &model)?,
    };
    let clip = Clip { scale: options.scale.unwrap_or(clip.scale), ..clip };
    output.write(&clip.gif()?)?;
    let json = serde_json::json!({
        "file": options.out, "answer": told.answer, "steps": told.steps, "return": told.ret,
    });
    options.form.tell(&json, || {
        let answer = told.answer.iter().cloned();
        let driven = told.steps.zip(told.ret).map(|(n, ret)| format!("{n} steps, a return of {ret:.0}"));
        answer.chain(driven).chain([format!("wrote {:?}", options.out)]).collect::<Vec<_>>().join("\n")
    })
}

/// What is said beside a clip.
#[derive(Debug, Default)]
struct Told {
    /// Of a query, what was answered.
    answer: Option<String>,
    /// Of an episode in the real world, how many steps were driven.
    steps: Option<usize>,
    /// And what they returned.
    ret: Option<f32>,
}

/// An episode in the real world.
fn real(
    options: &Options,
    model: &WorldModel,
    seed: u64,
    compared: Option<Compared>,
) -> anyhow::Result<(Clip, Told)> {
    let steps = options.from..options.from + options.steps.unwrap_or(300);
    let driven = drive(&options.session, model, (seed, options.aids.is_on()), compared, steps, EVERY_REAL)?;
    let told = Told { steps: Some(driven.n_steps), ret: Some(driven.ret), ..Told::default() };
    Ok((Clip::at_pace(driven.frames, model.spec().rate, EVERY_REAL), told))
}

/// A query, with its answer in words, or a dream.
fn dreamed(options: &Options, model: &WorldModel) -> anyhow::Result<(Clip, Told)> {
    let (session, dreams) = SessionStore::read_dreams(&options.session, model.identity())?;
    let dream = |id: DreamId| {
        let found = dreams.iter().find(|(known, _)| *known == id).map(|(_, dream)| dream);
        found
            .with_context(|| format!("there is no dream {} among the {} of this session", id.0, dreams.len()))
    };
    let rate = model.spec().rate;
    if let Some(number) = options.query {
        let (frames, said) = query(number, model, &session, dream)?;
        let told = Told { answer: Some(said), ..Told::default() };
        return Ok((Clip::half_as_fast(frames, rate, 1), told));
    }
    let dream = dream(DreamId(options.dream.unwrap_or(0)))?;
    anyhow::ensure!(options.from < dream.len(), "that dream has {} steps", dream.len());
    let range = options.from..(options.from + options.steps.unwrap_or(500)).min(dream.len());
    let frames: Vec<Frame> = dream.frames(model, range).into_iter().step_by(EVERY).collect();
    Ok((Clip::at_pace(frames, rate, EVERY), Told::default()))
}

/// A query, framed after its answer, and that answer in words.
fn query<'a>(
    number: u32,
    model: &WorldModel,
    session: &Session,
    dream: impl Fn(DreamId) -> anyhow::Result<&'a DreamEpisode>,
) -> anyhow::Result<(Vec<Frame>, String)> {
    let asked = session.query(QueryId(number));
    let asked = asked.with_context(|| {
        format!("there is no query {number} among the {} of this session", session.queries().len())
    })?;
    let clip = |SegmentRef { dream: id, start }: SegmentRef| {
        Ok::<_, anyhow::Error>(dream(id)?.frames(model, start..start + SEGMENT_LEN))
    };
    let (left, right) = (clip(asked.query.left)?, clip(asked.query.right)?);
    let response = asked.answer().map(|given| given.answer.response);
    let said = response.map_or("not answered yet".to_owned(), |response| session.weights().say(&response));
    Ok((clip::query(&left, &right, response), said))
}
