//! What can be asked on the command line, and by whom it is answered.
#![expect(clippy::print_stdout, reason = "the command line speaks on standard output")]
#![expect(clippy::print_stderr, reason = "and of its progress on standard error")]

mod agree;
mod check_reward;
mod check_world;
mod compare;
mod convert;
mod deploy;
mod fit_probe;
mod fit_world;
mod models;
mod record;
mod refit;
mod replay;
mod screen;
mod simulate;
mod trace;
mod verdicts;
mod window;

use clap::{Parser, Subcommand, ValueEnum};
use dropj::env::{Aids, CarRacing, Env, ObstacleCarRacing, Obstacles, Seed};
use dropj::planner::PlannerConfig;
use dropj::query::Protocol;
use dropj::world_model::WorldModelConfig;

/// Safe reward learning from a person who drives in a dream and says what they prefer, and why.
#[derive(Debug, Parser)]
#[command(version, about, args_conflicts_with_subcommands = true)]
pub(crate) struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    window: window::Options,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Record real episodes with the scripted pilot (step 1)
    Record(record::Options),
    /// Train a world model on recorded episodes (step 1)
    FitWorld(fit_world::Options),
    /// Say how true a world model is, on episodes that it was not trained on
    CheckWorld(check_world::Options),
    /// Fit the probe, through which simulated people see
    FitProbe(fit_probe::Options),
    /// Play dreams, answer queries and fit a reward, with simulated people (steps 2 and 3)
    Simulate(simulate::Options),
    /// Learn a session's answers anew, perhaps with other weights (step 3)
    Refit(refit::Options),
    /// Say how well a session's reward foretells the answers of others
    CheckReward(check_reward::Options),
    /// Drive the real car by a session's reward (step 4)
    Deploy(deploy::Options),
    /// Say whether methods differ by more than chance, from what `deploy --json` printed of each
    Compare(compare::Options),
    /// Store a world model, a probe or a reward anew: in the layout of PyTorch, and in fewer bytes if that is asked
    Convert(convert::Options),
    /// Go through a session again from its files
    Replay(replay::Options),
    /// Say how well bad dreams can be told before anybody skips them, on sessions in which some were skipped
    Screen(screen::Options),
    /// Say who answered, how fast and how steadily, and how far they agree
    Agree(agree::Options),
    /// Put the sessions of several annotators together
    Merge(agree::MergeOptions),
    /// Make a session with another's dreams and queries, for a second annotator to answer
    HandOn(agree::HandOnOptions),
    /// Print an episode step by step, in the columns of the reference traces
    Trace(trace::Options),
}

/// The worlds that can be driven in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum EnvName {
    /// Car Racing.
    CarRacing,
    /// Obstacle Car Racing with chuckholes and other cars.
    ObstacleCarRacing,
    /// Obstacle Car Racing with chuckholes alone.
    ObstacleCarRacingChuckholes,
}

/// Whether something helps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Switch {
    On,
    Off,
}

impl Switch {
    fn aids(self) -> Aids {
        if self == Self::On { Aids::ALL } else { Aids::NONE }
    }
}

impl EnvName {
    /// The world itself; where there are obstacles, `aids` may help the driver.
    fn open(self, aids: Aids) -> Box<dyn Env> {
        let seed = Seed::Native(0);
        match self {
            Self::CarRacing => Box::new(CarRacing::new(seed)),
            Self::ObstacleCarRacing => {
                Box::new(ObstacleCarRacing::new(seed, Obstacles::ChuckholesAndCars, aids))
            }
            Self::ObstacleCarRacingChuckholes => {
                Box::new(ObstacleCarRacing::new(seed, Obstacles::Chuckholes, aids))
            }
        }
    }

    /// The networks that two cores train and dream with for it.
    fn world(self) -> WorldModelConfig {
        match self {
            Self::CarRacing => WorldModelConfig::car_racing(),
            Self::ObstacleCarRacing | Self::ObstacleCarRacingChuckholes => {
                WorldModelConfig::obstacle_compact()
            }
        }
    }

    /// How the planner looks ahead there.
    fn planner(self) -> PlannerConfig {
        match self {
            Self::CarRacing => PlannerConfig::car_racing(),
            Self::ObstacleCarRacing => PlannerConfig::obstacle_car_racing(),
            Self::ObstacleCarRacingChuckholes => PlannerConfig::obstacle_car_racing_chuckholes(),
        }
    }

    /// The world that is called so in sessions and recordings.
    fn named(name: &str) -> anyhow::Result<Self> {
        let known = Self::from_str(name, false);
        known.map_err(|_| anyhow::anyhow!("{name:?} is not a world of this program"))
    }

    fn name(self) -> &'static str {
        match self {
            Self::CarRacing => "car-racing",
            Self::ObstacleCarRacing => "obstacle-car-racing",
            Self::ObstacleCarRacingChuckholes => "obstacle-car-racing-chuckholes",
        }
    }
}

/// The protocols' names, one after the other.
fn names(protocols: &[Protocol]) -> String {
    protocols.iter().map(|protocol| protocol.name()).collect::<Vec<_>>().join(", ")
}

/// Carries out what was asked.
pub(crate) fn run(cli: Cli) -> anyhow::Result<()> {
    if cli.command.is_some() {
        // Whoever reads only the first lines (`| head`) ends the program without a word. A window would end with its screen.
        sigpipe::reset();
    }
    match cli.command {
        None => window::run(cli.window),
        Some(Command::Record(options)) => record::run(&options),
        Some(Command::FitWorld(options)) => fit_world::run(&options),
        Some(Command::CheckWorld(options)) => check_world::run(&options),
        Some(Command::FitProbe(options)) => fit_probe::run(&options),
        Some(Command::Simulate(options)) => simulate::run(&options),
        Some(Command::Refit(options)) => refit::run(&options),
        Some(Command::CheckReward(options)) => check_reward::run(&options),
        Some(Command::Deploy(options)) => deploy::run(&options),
        Some(Command::Compare(options)) => compare::run(&options),
        Some(Command::Convert(options)) => convert::run(&options),
        Some(Command::Replay(options)) => replay::run(&options),
        Some(Command::Screen(options)) => screen::run(&options),
        Some(Command::Agree(options)) => agree::run(&options),
        Some(Command::Merge(options)) => agree::run_merge(&options),
        Some(Command::HandOn(options)) => agree::run_hand_on(&options),
        Some(Command::Trace(options)) => trace::run(&options),
    }
}
