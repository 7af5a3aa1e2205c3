//! What is chosen by its name on the command line.

use clap::ValueEnum;
use dropj::query::{Protocol, Strategy};
use dropj::simulate::player::Manner;
use dropj::tensor::{Backend, DeviceChoice, DeviceError, Dtype, Parameters};

/// Whether something helps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Switch {
    /// It does.
    On,
    /// It does not.
    Off,
}

impl Switch {
    /// Whether it is on.
    pub(crate) fn is_on(self) -> bool {
        self == Self::On
    }
}

/// What can be known beforehand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum OracleName {
    /// The simulator itself, and its reward
    World,
    /// What is seen in imagined pictures
    Seen,
}

/// The questions that can be asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum ProtocolName {
    /// Left or right
    Drop,
    /// Left, equal or right
    Drope,
    /// Which clips stay safe, and which is better where both do
    Dropj,
    /// The most severe thing that happened, and which is better
    DropjMulti,
    /// Verdicts on the steps of trajectories that were made to be worth asking about
    Request,
    /// Verdicts on the steps of dreams
    Dros,
}

impl From<ProtocolName> for Protocol {
    fn from(name: ProtocolName) -> Self {
        match name {
            ProtocolName::Drop => Self::Drop,
            ProtocolName::Drope => Self::Drope,
            ProtocolName::Dropj => Self::Dropj,
            ProtocolName::DropjMulti => Self::DropjMulti,
            ProtocolName::Request => Self::Request,
            ProtocolName::Dros => Self::Dros,
        }
    }
}

/// The ways to choose pairs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum StrategyName {
    /// By chance
    Uniform,
    /// By chance, but seldom two that are likely unsafe
    Balanced,
    /// About what was named least so far, such as a hazard that is seldom
    LeastAnswered,
    /// Where the reward's networks disagree
    Disagreement,
    /// Near where something unsafe began
    Boundary,
}

impl From<StrategyName> for Strategy {
    fn from(name: StrategyName) -> Self {
        match name {
            StrategyName::Uniform => Self::Uniform,
            StrategyName::Balanced => Self::Balanced,
            StrategyName::LeastAnswered => Self::LeastAnswered,
            StrategyName::Disagreement => Self::Disagreement,
            StrategyName::Boundary => Self::SafetyBoundary,
        }
    }
}

/// The planners that act in the real world.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum PlannerName {
    /// As the world's file says
    Ours,
    /// The authors': 15 steps ahead in the paper's worlds, by their brake, and nothing refined
    Paper,
}

/// The ways to fit a reward.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum FitName {
    /// From nothing, at a falling rate, a fixed number of steps
    Ours,
    /// The same, and where answers name hazards, what those look like: what they cost is taken off
    Hazards,
    /// The authors': at one rate, 60 passes through all answers, 40 where several things must not happen
    Paper,
}

/// What players can be after.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum MannerName {
    /// To see everything, for a good part what is unsafe; a car is off the road nearly half of the time
    Exploring,
    /// To get on, and unsafe things now and then; a car is fast along the road, slow beside it
    Touring,
}

impl From<MannerName> for Manner {
    fn from(name: MannerName) -> Self {
        match name {
            MannerName::Exploring => Self::Exploring,
            MannerName::Touring => Self::Touring,
        }
    }
}

/// The option of commands that work with networks.
#[derive(Clone, Debug, Default, clap::Args)]
pub(crate) struct Computing {
    /// On what to compute: auto (an accelerator, if there is one), cpu, cuda, cuda:N or mps; the same seed makes the same
    /// numbers on the processor alone
    #[arg(long, default_value = "auto")]
    device: DeviceChoice,
}

impl Computing {
    /// What computes; an accelerator that was found without being asked for is named.
    pub(crate) fn backend(&self) -> Result<Backend, DeviceError> {
        let backend = Backend::of(self.device)?;
        if self.device == DeviceChoice::Auto && !backend.is_cpu() {
            eprintln!("computing on {backend}");
        }
        Ok(backend)
    }
}

/// What computes; where that was left to the program, it says what it found.
pub(crate) fn backend(choice: DeviceChoice) -> Result<Backend, DeviceError> {
    let backend = Backend::of(choice)?;
    if choice == DeviceChoice::Auto {
        eprintln!("computing on {backend}");
    }
    Ok(backend)
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
