//! `dropj convert`.

use std::path::PathBuf;

use anyhow::Context as _;
use dropj::reward::{RewardEnsemble, RewardKind, SparseReward};
use dropj::run::{read_parameters, write_whole};
use dropj::simulate::probe::Probe;
use dropj::tensor::Parameters;
use dropj::world_model::WorldModel;

use super::choices::Precision;
use super::told::Form;

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// A world model, a probe or a reward
    file: PathBuf,
    /// The file to write; there must be nothing yet
    #[arg(long)]
    out: PathBuf,
    /// How each number is stored [default: as it is]
    #[arg(long, value_enum)]
    dtype: Option<Precision>,
    #[command(flatten)]
    form: Form,
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    let Options { file, out, dtype, form } = options;
    anyhow::ensure!(!out.exists(), "there is something already where the file should be written: {out:?}");
    let parameters = read_parameters(file)?;
    let (what, relaid) = relaid(&parameters).with_context(|| format!("in the file {file:?}"))?;
    let stored = dtype.map_or_else(|| Ok(relaid.clone()), |dtype| dtype.store(&relaid))?;
    write_whole(out, stored.bytes())?;
    let (before, after) = (parameters.hash(), stored.hash());
    form.tell(&serde_json::json!({"kind": what, "hash": before, "file": out, "new_hash": after}), || {
        format!("the {what} {before} is stored anew: {out:?}, {after}")
    })
}

/// What `parameters` are, and the same in this program's layout.
fn relaid(parameters: &Parameters) -> anyhow::Result<(&'static str, Parameters)> {
    match RewardKind::of(parameters) {
        Some(RewardKind::Preferences) => return Ok(("reward", RewardEnsemble::relaid(parameters)?)),
        Some(RewardKind::Verdicts) => return Ok(("reward of verdicts", SparseReward::relaid(parameters)?)),
        None => {}
    }
    let config = parameters.metadata("config").unwrap_or_default();
    let config: serde_json::Value = serde_json::from_str(&config).unwrap_or_default();
    if config.get("layers").is_some() {
        return Ok(("probe", Probe::relaid(parameters)?));
    }
    Ok(("world model", WorldModel::relaid(parameters.clone())?))
}
