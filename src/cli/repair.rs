//! `dropj repair`.

use std::path::PathBuf;

use dropj::session::{Origin, repair};

use super::models;

#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// The folder of the session
    session: PathBuf,
    /// Only say what would be done
    #[arg(long)]
    dry_run: bool,
    /// The world model that the session was dreamed with; only needed where its header is lost
    #[arg(long)]
    world: Option<PathBuf>,
}

pub(crate) fn run(options: &Options) -> anyhow::Result<()> {
    let is_part = options.session.is_file()
        && options.session.file_name().is_some_and(|name| name == "events.jsonl" || name == "session.json");
    let dir = match options.session.parent() {
        Some(folder) if is_part => folder,
        _ => &options.session,
    };
    let origin = options.world.as_deref().map(models::world_model).transpose()?;
    let origin = origin.map(|model| Origin { world_model: model.hash(), env: model.config().env.clone() });
    let repaired = repair(dir, origin.as_ref(), options.dry_run)?;
    for note in &repaired.notes {
        match note.line {
            Some(line) => println!("line {line}: {}", note.what),
            None => println!("{}", note.what),
        }
    }
    let n = repaired.n_kept;
    if options.dry_run {
        println!("{n} events can be kept; nothing was changed: {dir:?}");
    } else if repaired.kept_beside.is_empty() && repaired.notes.is_empty() {
        println!("there is nothing to repair, and nothing was changed: {n} events in {dir:?}");
    } else {
        println!("{n} events are kept in {dir:?}");
        for beside in repaired.kept_beside {
            println!("what stood there before is in {beside:?}");
        }
    }
    Ok(())
}
