//! What can be asked on the command line, and by whom it is answered.
#![expect(clippy::print_stdout, reason = "the command line speaks on standard output")]
#![expect(clippy::print_stderr, reason = "and of its progress on standard error")]

mod agree;
mod check_reward;
mod check_world;
mod compare;
mod deploy;
mod fit_probe;
mod fit_world;
mod models;
mod numbers;
mod record;
mod refit;
mod repair;
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
    /// Make a damaged session readable again: keep what can be read, and say what was left out
    Repair(repair::Options),
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

/// What the parser of the command line refuses, in one sentence, and how the command is used behind it.
pub(crate) fn refusal(text: &str) -> String {
    let text = text.strip_prefix("error: ").unwrap_or(text);
    let (what, usage) = text.split_once("\n\n").unwrap_or((text, ""));
    let what = what.split_whitespace().collect::<Vec<_>>().join(" ");
    if usage.trim().is_empty() { what } else { format!("{what}\n\n{}", usage.trim_end()) }
}

/// An error and its causes in one sentence: nothing is said twice, and no other library tells where in its code it was.
pub(crate) fn in_words(error: &anyhow::Error) -> String {
    let mut words = String::new();
    for cause in error.chain() {
        let cause = cause.to_string();
        // libtorch puts the stack of its own code behind what it says.
        let said = cause.split("\nException raised from").next().unwrap_or_default();
        let said: Vec<_> = said.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
        let said = said.join(" ");
        if words.is_empty() {
            words = said;
        } else if !said.is_empty() && !words.contains(&said) {
            words = format!("{words}: {said}");
        }
    }
    words
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
        Some(Command::Replay(options)) => replay::run(&options),
        Some(Command::Screen(options)) => screen::run(&options),
        Some(Command::Agree(options)) => agree::run(&options),
        Some(Command::Merge(options)) => agree::run_merge(&options),
        Some(Command::HandOn(options)) => agree::run_hand_on(&options),
        Some(Command::Repair(options)) => repair::run(&options),
        Some(Command::Trace(options)) => trace::run(&options),
    }
}

#[cfg(test)]
mod tests {
    use anyhow::Context as _;

    use super::*;

    #[test]
    fn the_command_line_fits_together() {
        use clap::CommandFactory as _;

        Cli::command().debug_assert();
    }

    #[test]
    fn a_cause_is_said_once_and_without_a_foreign_stack() {
        let torn: Result<(), _> =
            Err(anyhow::anyhow!("the shape is wrong\nException raised from f at x.cpp:1\nframe #0"));
        let error = torn.context("cannot load it: the shape is wrong").context("cannot drive").unwrap_err();
        assert_eq!(in_words(&error), "cannot drive: cannot load it: the shape is wrong");
    }

    #[test]
    fn what_the_parser_refuses_is_one_sentence() {
        let refused = Cli::try_parse_from(["dropj", "merge", "a"]).unwrap_err().to_string();
        let said = refusal(&refused);
        let first = said.lines().next().unwrap();
        assert!(first.contains("--out") && !said.starts_with("error"), "{said}");
    }
}
