//! `dropj convert`.

use std::path::PathBuf;

use anyhow::Context as _;
use clap::ValueEnum;
use dropj::reward::{RewardEnsemble, RewardKind, SparseReward};
use dropj::run::{read_parameters, write_whole};
use dropj::simulate::probe::Probe;
use dropj::tensor::{Dtype, Parameters};
use dropj::world_model::WorldModel;

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
}

/// How the numbers of networks are stored; they are computed with in whatever is best here.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Precision {
    /// Single precision, four bytes
    F32,
    /// Half precision, two bytes
    F16,
    /// Two bytes with the range of single precision
    Bf16,
}

impl Precision {
    /// `parameters` with their networks stored so; starts and the numbers of episodes stay as they are.
    pub(crate) fn store(self, parameters: &Parameters) -> anyhow::Result<Parameters> {
        const NETWORKS: [&str; 5] = ["vae.", "mdn_rnn.", "probe.", "reward.", "sparse_reward."];
        let dtype = match self {
            Self::F32 => Dtype::F32,
            Self::F16 => Dtype::F16,
            Self::Bf16 => Dtype::BF16,
        };
        let is_network = |name: &str| NETWORKS.iter().any(|prefix| name.starts_with(prefix));
        Ok(parameters.narrowed(dtype, is_network)?)
    }
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    let Options { file, out, dtype } = options;
    anyhow::ensure!(!out.exists(), "there is something already where the file should be written: {out:?}");
    let parameters = read_parameters(file)?;
    let (what, relaid) = relaid(&parameters).with_context(|| format!("in the file {file:?}"))?;
    let stored = dtype.map_or_else(|| Ok(relaid.clone()), |dtype| dtype.store(&relaid))?;
    write_whole(out, stored.bytes())?;
    println!("the {what} {} is stored anew: {out:?}, {}", parameters.hash(), stored.hash());
    Ok(())
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
