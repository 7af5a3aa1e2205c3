//! What can be asked on the command line, and by whom it is answered.
#![expect(clippy::print_stdout, reason = "the command line speaks on standard output")]
#![expect(clippy::print_stderr, reason = "and of its progress on standard error")]

mod agree;
mod check_device;
mod check_reward;
mod check_world;
mod choices;
mod chosen_world;
mod clip;
mod clip_real;
mod compare;
mod completions;
mod convert;
mod curves;
mod deploy;
mod error;
mod experiment;
mod first_world;
mod export;
mod fit_drqv2;
mod fit_probe;
mod fit_world;
mod hub;
mod labels;
mod learn;
mod meter;
mod models;
mod numbers;
mod picture;
mod record;
mod refit;
mod repair;
mod replay;
mod reward_on;
mod run_file;
mod screen;
mod script;
mod serve;
mod settings;
mod simulate;
mod sparse;
mod times;
mod told;
mod trace;
mod window;
mod words;
mod world;
mod world_data;

use std::ffi::OsString;

use clap::{CommandFactory as _, FromArgMatches as _, Parser, Subcommand};

pub(crate) use error::CliError;
pub(crate) use words::{in_words, refusal};

/// Safe reward learning from a person who acts in a dream and says what they prefer, and why.
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
    /// Record real episodes, by a pilot or by chance (step 1)
    Record(record::Options),
    /// Train a world model on recorded episodes (step 1)
    FitWorld(fit_world::Options),
    /// Say how true a world model is, on episodes that it was not trained on
    CheckWorld(check_world::Options),
    /// Say whether an accelerator computes what the processor does, and how fast it trains
    CheckDevice(check_device::Options),
    /// Fit the probe, through which simulated people see
    FitProbe(fit_probe::Options),
    /// Train DrQ-v2, the paper's upper bound, in the real world by its true reward, and count what is unsafe meanwhile
    #[command(name = "fit-drqv2")]
    FitDrqv2(fit_drqv2::Options),
    /// Play dreams, answer queries and fit a reward, with simulated people (steps 2 and 3)
    Simulate(simulate::Options),
    /// Learn a session's answers anew, perhaps with other weights (step 3)
    Refit(refit::Options),
    /// Say how well a session's reward predicts the answers of others
    CheckReward(check_reward::Options),
    /// Act in the real world by a session's reward (step 4)
    Deploy(deploy::Options),
    /// Run grids of trials, a seed and a method each, and say what comes of them in tables, words and figures
    Experiment(experiment::Options),
    /// Say whether methods differ by more than chance, from what `deploy --json` printed of each
    Compare(compare::Options),
    /// Store a world model, a probe or a reward anew: in the layout of PyTorch, and in fewer bytes if that is asked
    Convert(convert::Options),
    /// Offer a session's queries to several people in browsers, on this machine or on its network
    Serve(serve::Options),
    /// Write a query with its answer, or a dream, as a GIF to show
    Clip(clip::Options),
    /// Write a session's answers and what they mean as a table, for other programs
    Labels(labels::Options),
    /// Write the reward of every step of a dream
    Reward(reward_on::Options),
    /// Write recordings, a world model or a reward for the Hugging Face Hub, or networks as TorchScript
    Export(export::Options),
    /// Go through a session again from its files
    Replay(replay::Options),
    /// Say how well bad dreams can be told before anybody skips them, on sessions in which some were skipped
    Screen(screen::Options),
    /// Say who answered, how fast and how steadily, and how far they agree
    Agree(agree::Options),
    /// Say how long answers take, by what is asked, of sessions and of the authors' answer files
    Times(times::Options),
    /// Put the sessions of several annotators together
    Merge(agree::MergeOptions),
    /// Make a session with another's dreams and queries, for a second annotator to answer
    HandOn(agree::HandOnOptions),
    /// Make a damaged session readable again: keep what can be read, and say what was left out
    Repair(repair::Options),
    /// Print an episode step by step, in the columns of the reference traces
    Trace(trace::Options),
    /// Write what completes the command line in a shell
    Completions(completions::Options),
    /// Write the manual page, with all subcommands
    Man,
    /// Check a world's file, write a first one, or write the Python package that serves worlds
    World(world::Options),
}

impl Command {
    /// Where its settings come from, if they can come from a file.
    fn run_file(&mut self) -> Option<&mut run_file::RunFile> {
        match self {
            Self::FitWorld(options) => Some(&mut options.run_file),
            Self::FitProbe(options) => Some(&mut options.run_file),
            Self::FitDrqv2(options) => Some(&mut options.run_file),
            Self::Simulate(options) => Some(&mut options.run_file),
            Self::Refit(options) => Some(&mut options.run_file),
            Self::Deploy(options) => Some(&mut options.run_file),
            _ => None,
        }
    }
}

/// What every help ends with.
const EXIT: &str = "\
Exit codes: 0 it is done; 1 it failed, and standard error says why in one sentence; 2 the command line is not understood.
Results are on standard output, progress and warnings on standard error: --json makes the result one JSON object, where a command \
has it. RUST_LOG=info or RUST_LOG=debug says more (RUST_LOG=error less), and RUST_LOG=dropj=debug more of this program alone.";

/// The command line, with that at the end of the help of each command.
fn command() -> clap::Command {
    ended(Cli::command())
}

fn ended(command: clap::Command) -> clap::Command {
    let own = command.get_after_help().map(|own| format!("{own}\n\n")).unwrap_or_default();
    command.after_help(own + EXIT).mut_subcommands(ended)
}

/// What is asked on the command line, and in the file of settings that it names.
pub(crate) fn parse(line: impl IntoIterator<Item = OsString>) -> Result<Cli, CliError> {
    let (matches, filling) = run_file::read_line(command(), line.into_iter().collect())?;
    let mut cli = Cli::from_arg_matches(&matches)?;
    if let Some(run_file) = cli.command.as_mut().and_then(Command::run_file) {
        run_file.fill(filling);
    }
    Ok(cli)
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
        Some(Command::CheckDevice(options)) => check_device::run(&options),
        Some(Command::FitProbe(options)) => fit_probe::run(&options),
        Some(Command::FitDrqv2(options)) => fit_drqv2::run(&options),
        Some(Command::Simulate(options)) => simulate::run(&options),
        Some(Command::Refit(options)) => refit::run(&options),
        Some(Command::CheckReward(options)) => check_reward::run(&options),
        Some(Command::Deploy(options)) => deploy::run(&options),
        Some(Command::Experiment(options)) => experiment::run(&options),
        Some(Command::Compare(options)) => compare::run(&options),
        Some(Command::Convert(options)) => convert::run(&options),
        Some(Command::Serve(options)) => serve::run(&options),
        Some(Command::Clip(options)) => clip::run(&options),
        Some(Command::Labels(options)) => labels::run(&options),
        Some(Command::Reward(options)) => reward_on::run(&options),
        Some(Command::Export(options)) => export::run(&options),
        Some(Command::Replay(options)) => replay::run(&options),
        Some(Command::Screen(options)) => screen::run(&options),
        Some(Command::Agree(options)) => agree::run(&options),
        Some(Command::Times(options)) => times::run(&options),
        Some(Command::Merge(options)) => agree::run_merge(&options),
        Some(Command::HandOn(options)) => agree::run_hand_on(&options),
        Some(Command::Repair(options)) => repair::run(&options),
        Some(Command::Trace(options)) => trace::run(&options),
        Some(Command::Completions(options)) => completions::run(&options, command()),
        Some(Command::Man) => completions::manual(command()),
        Some(Command::World(options)) => world::run(&options),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_fits_together() {
        use clap::CommandFactory as _;

        Cli::command().debug_assert();
    }

    #[cfg(unix)]
    #[test]
    fn what_is_set_around_libtorch_knows_commands_that_there_are() {
        let names: Vec<_> = Cli::command().get_subcommands().map(|it| it.get_name().to_owned()).collect();
        let own = ["help", "-h", "--help", "-V", "--version"];
        for name in crate::LIGHT.iter().chain(&crate::TRAINING) {
            assert!(own.contains(name) || names.iter().any(|it| it == name), "{name} is no command");
        }
    }

    /// Every command that can be given, by its name, `world check` as one of them.
    fn commands() -> Vec<(String, clap::Command)> {
        fn add(before: &str, command: &clap::Command, all: &mut Vec<(String, clap::Command)>) {
            for sub in command.get_subcommands().filter(|sub| sub.get_name() != "help") {
                let name = format!("{before}{}", sub.get_name());
                if sub.has_subcommands() {
                    add(&format!("{name} "), sub, all);
                } else {
                    all.push((name, sub.clone()));
                }
            }
        }
        let mut all = Vec::new();
        add("", &command(), &mut all);
        all
    }

    #[test]
    fn what_tells_a_result_tells_it_as_json_and_every_help_says_how_it_ends() {
        // They write text that is read by somebody else: a shell, a pager, a world's file, a package.
        let texts = ["completions", "man", "world new", "world adapter"];
        let commands = commands();
        assert!(commands.len() > 25, "{}", commands.len());
        for (name, mut command) in commands {
            let has_json = command.get_arguments().any(|arg| arg.get_long() == Some("json"));
            assert_eq!(has_json, !texts.contains(&name.as_str()), "{name}");
            for help in [command.render_help(), command.render_long_help()] {
                let help = help.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
                assert!(help.contains("Exit codes: 0 it is done; 1 it failed"), "{name}: {help}");
                assert!(help.ends_with("more of this program alone."), "{name}: {help}");
            }
        }
        let help = command().render_help().to_string();
        assert!(help.contains("Exit codes:") && help.contains("RUST_LOG"), "{help}");
    }

    #[test]
    fn what_the_parser_refuses_is_one_sentence() {
        let refused = parse(["dropj", "merge", "a", "b"].map(OsString::from)).unwrap_err();
        let said = refusal(&refused);
        let first = said.lines().next().unwrap();
        assert!(first.contains("--out") && !said.starts_with("error"), "{said}");
    }

    /// Whether the command line is refused for a value.
    fn is_refused(args: &str) -> bool {
        let parsed = Cli::try_parse_from(["dropj"].into_iter().chain(args.split(' ')));
        parsed.is_err_and(|refused| {
            assert!(!refused.to_string().contains("required arguments"), "{args}: {refused}");
            true
        })
    }

    #[test]
    fn every_number_has_its_range() {
        for (command, option, values) in [
            ("simulate --out X", "queries", "-1 0 1000001 99999999999999999999 1.5 NaN"),
            ("simulate --out X", "undo", "-1 1000001"),
            ("simulate --out X", "dreams", "-1 0 10001"),
            ("simulate --out X", "steps", "-1 0 19 18446744073709551615"),
            ("simulate --out X", "rounds", "-1 0 10001"),
            ("simulate --out X", "members", "-1 0 101"),
            ("simulate --out X", "seed", "-1 18446744073709551616 1.5"),
            ("simulate --out X", "beta", "-1 NaN inf 1e400"),
            ("simulate --out X", "gamma", "-1 0 1.1 NaN inf"),
            ("simulate --out X", "eps-mistake", "-0.1 1.1 NaN inf"),
            ("simulate --out X", "eps-safety", "-0.1 1.1 NaN inf"),
            ("simulate --out X", "care", "-1 NaN inf"),
            ("simulate --out X", "eps-skip", "-1 NaN inf"),
            ("simulate --out X", "eps-equal", "-1 NaN inf"),
            (
                "simulate --out X",
                "weights",
                "grass grass= =1 grass=0.5 grass=1.1 grass=NaN grass=1,default=inf",
            ),
            ("record --out X", "episodes", "-1 1000001 18446744073709551615"),
            ("record --out X", "first", "-1 4294967296 18446744073709551615"),
            ("record --out X", "seed", "-1 18446744073709551616"),
            ("deploy --straight-on", "episodes", "-1 100001 18446744073709551615"),
            ("deploy --straight-on", "seed", "-1 18446744073709551616"),
            ("deploy", "random-reward", "-1 18446744073709551616 NaN"),
            ("deploy --straight-on", "horizon", "-1 0 201"),
            ("deploy --straight-on", "brake", "-0.1 1.1 NaN inf"),
            ("deploy --straight-on", "memory-reset", "-1 1000001"),
            ("fit-world --data X --out Y", "threads", "-1 0 1025"),
            ("fit-world --data X --out Y", "seed", "-1 18446744073709551616"),
            ("fit-world --data X --out Y", "emphasis", "-1 1001 NaN inf"),
            ("fit-world --data X --out Y", "vae-epochs", "-1 0 1000001"),
            ("fit-world --data X --out Y", "mdn-rnn-epochs", "-1 0 1000001"),
            ("check-world --data X --world Y", "stretches", "-1 0 100001"),
            ("check-world --data X --world Y", "seed", "-1 18446744073709551616"),
            ("fit-world --data X --out Y", "device", "gpu cuda: cuda:-1 CPU"),
            ("check-device", "seconds", "-1 3601 NaN"),
            ("fit-probe --out X", "episodes", "-1 0 1 100001"),
            ("fit-probe --out X", "updates", "-1 0 10000001"),
            ("fit-probe --out X", "seed", "-1 18446744073709551616"),
            ("fit-drqv2 --out X", "steps", "-1 0 4294967297"),
            ("fit-drqv2 --out X", "batch", "-1 0 1048577"),
            ("fit-drqv2 --out X", "capacity", "-1 0 NaN"),
            ("refit --session X", "updates", "-1 0 10000001"),
            ("refit --session X", "members", "-1 0 101"),
            ("refit --session X", "seed", "-1 18446744073709551616"),
            ("refit --session X", "safety", "0.5 1.1 NaN inf -1"),
            ("refit --session X", "default", "0.5 1.1 NaN inf -1"),
            ("refit --session X", "weights", "grass grass=0 grass=NaN"),
            ("refit --session X", "held-out", "-1 0 0.91 1 NaN inf"),
            ("labels X", "safety", "0.5 1.1 NaN inf -1"),
            ("labels X", "default", "0.5 1.1 NaN inf -1"),
            ("labels X", "weights", "grass grass=0 grass=NaN"),
            ("trace --actions X", "gym-seed", "-1 18446744073709551616"),
            ("trace --actions X --gym-seed 0", "python-seed", "-1 18446744073709551616"),
        ] {
            for value in values.split(' ') {
                let args = format!("{command} --{option}={value}");
                assert!(is_refused(&args), "{args}");
            }
        }
    }

    #[test]
    fn usual_numbers_are_taken() {
        for args in [
            "simulate --out X --queries 1 --steps 20 --gamma 1 --eps-skip 0.35 --weights grass=1,default=0.75",
            "simulate --out X --seed 18446744073709551615",
            "record --out X --episodes 0",
            "deploy --random-reward 0 --episodes 0 --memory-reset 0 --horizon 15 --brake 0",
            "refit --session X --default 0.9 --safety 1 --held-out 0.2 --members 10",
            "fit-world --data X --out Y --emphasis 0 --threads 1 --vae-epochs 1 --device cuda:1",
        ] {
            assert!(!is_refused(args), "{args}");
        }
    }
}
