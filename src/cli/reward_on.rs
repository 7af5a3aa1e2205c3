//! `dropj reward`.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use dropj::dream::DreamEpisode;
use dropj::query::DreamId;
use dropj::reward::{RewardModel as _, RewardNetworks, SparseReward, scaled_actions_tensor};
use dropj::run::{Kind, OutputFile, read_parameters};
use dropj::session::SessionStore;
use dropj::session::arrays::dream_from_bytes;
use dropj::tensor::{dims, from_slice, to_vec};
use dropj::world_model::{WorldModel, actions_tensor};
use tch::Tensor;

use super::models;

#[derive(Debug, clap::Args)]
#[command(after_help = COLUMNS)]
pub(crate) struct Options {
    /// The session whose world model and latest reward are taken
    #[arg(long)]
    session: PathBuf,
    /// The number of a dream of the session, from 0, or the file of any dream of its world model
    #[arg(long, value_name = "DREAM")]
    on: String,
    /// A reward other than the session's latest
    #[arg(long)]
    reward: Option<PathBuf>,
    /// Print the result as one JSON object, with a list for each column
    #[arg(long)]
    json: bool,
    /// The file to write; without it the table is printed
    #[arg(long)]
    out: Option<PathBuf>,
    /// The session's world model, where it is not found by itself
    #[arg(long)]
    world: Option<PathBuf>,
}

/// What the table holds.
const COLUMNS: &str = "\
The columns are the step, its reward, and of which parts that comes: what each network says (member_0 and so on), or, of a \
reward of verdicts, how likely all networks together find each verdict (p_unsafe, p_neutral, p_good).";

/// A column of the table: a number a step.
type Column = (String, Vec<f32>);

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    tch::set_num_threads(1);
    let kind = if options.json { Kind::Notes } else { Kind::Table };
    let output = options.out.as_deref().map(|path| OutputFile::at(path, kind)).transpose()?;
    let model = models::of_session(&options.session, options.world.as_deref())?;
    let parameters = if let Some(path) = &options.reward {
        read_parameters(path)?
    } else {
        let (_, kept) = SessionStore::read_reward(&options.session)?;
        kept.context("this session has no reward yet: fit one with `dropj refit`, or give one with --reward")?
    };
    let networks = RewardNetworks::load(&parameters)?;
    networks.require(model.identity())?;
    let episode = dream(&options.session, &options.on, &model)?;
    let columns = rewards(networks, &model, &episode);
    let text = if options.json { to_json(&columns)? } else { to_csv(&columns) };
    match output {
        Some(output) => output.write(text.as_bytes())?,
        None => std::io::stdout().write_all(text.as_bytes())?,
    }
    Ok(())
}

/// The dream of this number in the session, or the one in the file of this name.
fn dream(session: &Path, on: &str, model: &WorldModel) -> anyhow::Result<DreamEpisode> {
    if let Ok(number) = on.parse() {
        let (_, dreams) = SessionStore::read_dreams(session, model.identity())?;
        let n = dreams.len();
        let found = dreams.into_iter().find(|(id, _)| *id == DreamId(number));
        let (_, episode) =
            found.with_context(|| format!("there is no dream {number} among the {n} of this session"))?;
        return Ok(episode);
    }
    let path = Path::new(on);
    let bytes = std::fs::read(path).with_context(|| format!("cannot read the dream {path:?}"))?;
    let episode = dream_from_bytes(&bytes).with_context(|| format!("in the file {path:?}"))?;
    episode.require(model.identity()).with_context(|| format!("in the file {path:?}"))?;
    Ok(episode)
}

/// The reward of each step of a dream, and its parts.
fn rewards(networks: RewardNetworks, model: &WorldModel, episode: &DreamEpisode) -> Vec<Column> {
    let features = episode.features(model);
    let features = from_slice(&features.values, &[episode.len() as i64, features.width as i64]);
    let scaled = scaled_actions_tensor(&episode.actions, model.ranges());
    let row = |rows: &Tensor, i| to_vec(&rows.get(i));
    let (total, parts) = match networks {
        RewardNetworks::Preferences(reward) => {
            let reward = reward.in_kind(tch::Kind::Float);
            let members = reward.member_rewards(&features, &scaled);
            let [n, _] = dims(&members);
            let parts = (0..n).map(|i| (format!("member_{i}"), row(&members, i)));
            (reward.rewards(&features, &scaled), parts.collect())
        }
        RewardNetworks::Verdicts(reward) => {
            (reward.rewards(&features, &scaled), chances(&reward, &features, episode))
        }
    };
    let mut columns = vec![("reward".to_owned(), to_vec(&total))];
    columns.extend::<Vec<_>>(parts);
    columns
}

/// How likely each verdict is to all networks together.
fn chances(reward: &SparseReward, features: &Tensor, episode: &DreamEpisode) -> Vec<Column> {
    let chances = tch::no_grad(|| reward.chances(features, &actions_tensor(&episode.actions)));
    let chances = chances.mean_dim(0, false, tch::Kind::Float).tr(); // [3, T]
    let names = ["p_unsafe", "p_neutral", "p_good"].into_iter().zip(0..);
    names.map(|(name, i)| (name.to_owned(), to_vec(&chances.get(i)))).collect()
}

fn to_csv(columns: &[Column]) -> String {
    let names: Vec<_> = columns.iter().map(|(name, _)| name.as_str()).collect();
    let mut csv = format!("step,{}\n", names.join(","));
    for step in 0..columns[0].1.len() {
        let values: Vec<_> = columns.iter().map(|(_, values)| values[step].to_string()).collect();
        writeln!(csv, "{step},{}", values.join(",")).unwrap_or_else(|_| unreachable!("a string takes all"));
    }
    csv
}

fn to_json(columns: &[Column]) -> serde_json::Result<String> {
    let field = |(name, values): &Column| Ok(format!("\"{name}\":{}", serde_json::to_string(values)?));
    let fields = columns.iter().map(field).collect::<serde_json::Result<Vec<_>>>()?;
    Ok(format!("{{{}}}\n", fields.join(",")))
}
