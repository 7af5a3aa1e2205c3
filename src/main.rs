//! The command line: a window by default, and a subcommand for everything that runs without one.
#![expect(clippy::print_stderr, reason = "errors are said on standard error")]

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    set_around_libtorch();
    outlive_full_disks();
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("warn")).init();
    let asked = match cli::parse(std::env::args_os()) {
        Ok(asked) => asked,
        // Help and version.
        Err(cli::CliError::Line(asked)) if !asked.use_stderr() => asked.exit(),
        Err(refused) => {
            eprintln!("dropj: {}", cli::refusal(&refused));
            return ExitCode::from(USAGE);
        }
    };
    match cli::run(asked) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("dropj: {}", cli::in_words(&error));
            ExitCode::FAILURE
        }
    }
}

/// The exit code where the command line is none: what was asked but failed has 1 (`cli::EXIT`).
const USAGE: u8 = 2;

/// What libtorch needs around it: they are read as it is loaded, before `main`; cargo sets them, an installed program
/// has to itself.
///
/// Threads that spin while they wait cost ten times beside a window. Memory that is given back to the system after each
/// training step costs a fifth of the next; a window, which trains little and stays open, gives it back all the same, and
/// holds two thirds of what it would (671 MiB for 1039 after dreams, answers, a fit and a drive with the paper's networks for
/// obstacles). Threads come and go with sessions, and each of the many arenas that the allocator would give them keeps what
/// it once had: with two, memory is flat after a dozen sessions.
#[cfg(unix)]
const AROUND_LIBTORCH: [(&str, &str); 4] = [
    ("OMP_WAIT_POLICY", "PASSIVE"),
    ("MALLOC_MMAP_THRESHOLD_", "2097152"),
    ("MALLOC_TRIM_THRESHOLD_", "33554432"),
    ("MALLOC_ARENA_MAX", "2"),
];
/// The same for [`TRAINING`].
#[cfg(unix)]
const WHILE_TRAINING: [(&str, &str); 4] = [
    ("OMP_WAIT_POLICY", "PASSIVE"),
    ("MALLOC_MMAP_THRESHOLD_", "33554432"),
    ("MALLOC_TRIM_THRESHOLD_", "536870912"),
    ("MALLOC_ARENA_MAX", "2"),
];
/// The subcommands that train for long.
#[cfg(unix)]
const TRAINING: [&str; 5] = ["fit-world", "fit-probe", "fit-drqv2", "simulate", "refit"];
/// Those that compute nothing with networks, or as good as nothing: to load libtorch twice would take half of their time.
#[cfg(unix)]
const LIGHT: [&str; 19] = [
    "-h",
    "--help",
    "-V",
    "--version",
    "help",
    "completions",
    "man",
    "trace",
    "world",
    "convert",
    "compare",
    "labels",
    "agree",
    "times",
    "merge",
    "hand-on",
    "repair",
    "record",
    "export",
];

/// Starts the program anew where that is not set yet. What somebody set otherwise is left alone.
#[cfg(unix)]
fn set_around_libtorch() {
    use std::os::unix::process::CommandExt as _;

    let first = std::env::args_os().nth(1);
    let is_one_of =
        |names: &[&str]| first.as_ref().is_some_and(|first| names.iter().any(|name| first == *name));
    if is_one_of(&LIGHT) {
        return;
    }
    let trains = is_one_of(&TRAINING);
    let wanted = if trains { WHILE_TRAINING } else { AROUND_LIBTORCH };
    let is_missing = |&((name, value), (_, usual)): &((&str, &str), (&str, &str))| {
        // Cargo sets what is usual.
        std::env::var_os(name).is_none_or(|set| set == *usual && value != usual)
    };
    let missing = wanted.into_iter().zip(AROUND_LIBTORCH).filter(is_missing).map(|(wanted, _)| wanted);
    let missing: Vec<_> = missing.collect();
    if !missing.is_empty()
        && let Ok(program) = std::env::current_exe()
    {
        let mut again = std::process::Command::new(program);
        let error = again.args(std::env::args_os().skip(1)).envs(missing).exec();
        log::debug!("went on with what was set: {error}");
    }
}

/// Has a limit on the size of files, as quotas set it, be an error like that of a full disk, and not the end of the program.
#[cfg(unix)]
fn outlive_full_disks() {
    let heard = std::sync::Arc::default();
    if let Err(error) = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, heard) {
        log::debug!("a file that grows too large will end the program: {error}");
    }
}

#[cfg(not(unix))]
fn outlive_full_disks() {}

#[cfg(not(unix))]
fn set_around_libtorch() {}
