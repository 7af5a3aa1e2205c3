//! `dropj completions` and `dropj man`: the command line for shells, and on paper.

use std::io::Write as _;

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// Of which shell
    #[arg(value_enum)]
    shell: clap_complete::Shell,
}

pub(crate) fn run(options: &Options, mut command: clap::Command) -> anyhow::Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(options.shell, &mut command, "dropj", &mut script);
    Ok(std::io::stdout().write_all(&script)?)
}

/// The page of the program, and then one of each subcommand.
pub(crate) fn manual(mut command: clap::Command) -> anyhow::Result<()> {
    command.build();
    let mut page = Vec::new();
    clap_mangen::Man::new(command.clone()).section("1").render(&mut page)?;
    for sub in command.get_subcommands().filter(|sub| sub.get_name() != "help") {
        clap_mangen::Man::new(sub.clone()).section("1").render(&mut page)?;
    }
    Ok(std::io::stdout().write_all(&page)?)
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    #[test]
    fn every_shell_completes_every_subcommand() {
        use clap::ValueEnum as _;
        for shell in clap_complete::Shell::value_variants() {
            let mut script = Vec::new();
            clap_complete::generate(*shell, &mut super::super::Cli::command(), "dropj", &mut script);
            let text = String::from_utf8(script).unwrap();
            assert!(text.contains("fit-world") && text.contains("experiment"), "{shell}");
        }
    }
}
