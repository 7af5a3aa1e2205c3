//! The command line: a window by default, and a subcommand for everything that runs without one.
#![expect(clippy::print_stderr, reason = "errors are said on standard error")]

mod cli;

use std::process::ExitCode;

use clap::Parser as _;

fn main() -> ExitCode {
    wait_without_spinning();
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("warn")).init();
    match cli::run(cli::Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("dropj: {error:#}");
            ExitCode::from(2)
        }
    }
}

/// Starts the program anew where libtorch's threads would spin while they wait, which costs ten times beside a window.
///
/// The library reads the variable as it is loaded, before `main`; cargo sets it, an installed program has to itself.
#[cfg(unix)]
fn wait_without_spinning() {
    use std::os::unix::process::CommandExt as _;

    const POLICY: &str = "OMP_WAIT_POLICY";
    if std::env::var_os(POLICY).is_none()
        && let Ok(program) = std::env::current_exe()
    {
        let mut again = std::process::Command::new(program);
        let error = again.args(std::env::args_os().skip(1)).env(POLICY, "PASSIVE").exec();
        log::debug!("went on with waiting threads that spin: {error}");
    }
}

#[cfg(not(unix))]
fn wait_without_spinning() {}
