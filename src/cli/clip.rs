//! `dropj clip`: what somebody saw, as a GIF to show to others.

use std::path::PathBuf;

use anyhow::Context as _;
use dropj::query::{DreamId, Preference, QueryId, Response, SEGMENT_LEN, SafetyAnswer, SegmentRef};
use dropj::run::{Kind, OutputFile};
use dropj::session::SessionStore;
use dropj::world::Frame;

use super::models;
use super::numbers::count;
use super::picture::{gif, side_by_side};
use super::told::Form;

/// What is better is framed in this color, what is not in the other: people who see fewer colors tell them apart, too.
const BETTER: [u8; 3] = [86, 180, 233];
const WORSE: [u8; 3] = [213, 94, 0];
/// What is neither.
const NEITHER: [u8; 3] = [120, 120, 120];
/// Of a dream every second step is shown.
const EVERY: usize = 2;

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The session
    #[arg(long)]
    session: PathBuf,
    /// The number of a query, from 0: both clips as they were compared, the better one framed in blue, the other in orange
    #[arg(long, required_unless_present = "dream", conflicts_with = "dream")]
    query: Option<u32>,
    /// The number of a dream, from 0
    #[arg(long)]
    dream: Option<u32>,
    /// The first step of the dream that is shown
    #[arg(long, value_parser = count(0..=10_000_000), default_value_t = 0, conflicts_with = "query")]
    from: usize,
    /// How many steps of the dream are shown
    #[arg(long, value_parser = count(1..=10_000), default_value_t = 500, conflicts_with = "query")]
    steps: usize,
    /// How many pixels wide and high each of its pixels is
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=8), default_value_t = 2)]
    scale: u32,
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
    let (session, dreams) = SessionStore::read_dreams(&options.session, model.identity())?;
    let dream = |id: DreamId| {
        let found = dreams.iter().find(|(known, _)| *known == id).map(|(_, dream)| dream);
        found
            .with_context(|| format!("there is no dream {} among the {} of this session", id.0, dreams.len()))
    };
    // Half as fast as it happens, as in the window.
    let millis = (2000.0 / model.spec().rate).round().max(20.0) as u32;
    let mut said = None;
    let bytes = if let Some(number) = options.query {
        let asked = session.query(QueryId(number));
        let asked = asked.with_context(|| {
            format!("there is no query {number} among the {} of this session", session.queries().len())
        })?;
        let clip = |SegmentRef { dream: id, start }: SegmentRef| {
            Ok::<_, anyhow::Error>(dream(id)?.frames(&model, start..start + SEGMENT_LEN))
        };
        let (left, right) = (clip(asked.query.left)?, clip(asked.query.right)?);
        let response = asked.answer().map(|given| given.answer.response);
        let colors = colors(response);
        let both: Vec<Frame> =
            left.iter().zip(&right).map(|(left, right)| side_by_side(left, right, colors)).collect();
        said =
            Some(response.map_or("not answered yet".to_owned(), |response| session.weights().say(&response)));
        gif(&both, millis, options.scale)?
    } else {
        let dream = dream(DreamId(options.dream.unwrap_or(0)))?;
        anyhow::ensure!(options.from < dream.len(), "that dream has {} steps", dream.len());
        let range = options.from..(options.from + options.steps).min(dream.len());
        let frames: Vec<Frame> = dream.frames(&model, range).into_iter().step_by(EVERY).collect();
        gif(&frames, millis, options.scale)?
    };
    output.write(&bytes)?;
    options.form.tell(&serde_json::json!({"file": options.out, "answer": said}), || {
        let said = said.as_ref().map_or_else(String::new, |said| format!("{said}\n"));
        format!("{said}wrote {:?}", options.out)
    })
}

/// How each clip is framed, left and right.
fn colors(response: Option<Response>) -> [[u8; 3]; 2] {
    let of = |preference| match preference {
        Preference::Left => [BETTER, WORSE],
        Preference::Right => [WORSE, BETTER],
        Preference::Equal => [NEITHER; 2],
    };
    match response {
        Some(Response::Preferred(preference) | Response::Justified(_, preference)) => of(preference),
        Some(Response::Safety(answer)) => match answer {
            SafetyAnswer::OnlyLeft => of(Preference::Left),
            SafetyAnswer::OnlyRight => of(Preference::Right),
            SafetyAnswer::Neither => [WORSE; 2],
            SafetyAnswer::Both(preference) => of(preference),
        },
        Some(Response::Skipped(_) | Response::Judged(_)) | None => [NEITHER; 2],
    }
}
