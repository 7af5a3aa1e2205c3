//! `dropj repair`.

use std::fmt::Write as _;
use std::path::PathBuf;

use dropj::session::{Origin, repair};

use serde_json::json;

use super::models;
use super::told::Form;

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
    #[command(flatten)]
    form: Form,
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
    let n = repaired.n_kept;
    let notes = repaired.notes.iter().map(|note| json!({"line": note.line, "what": note.what}));
    let told = json!({
        "session": dir, "events_kept": n, "changed": !options.dry_run && !repaired.kept_beside.is_empty(),
        "notes": notes.collect::<Vec<_>>(), "kept_beside": repaired.kept_beside
    });
    options.form.tell(&told, || {
        let mut words = String::new();
        for note in &repaired.notes {
            words += &note.line.map_or_else(String::new, |line| format!("line {line}: "));
            writeln!(words, "{}", note.what).ok();
        }
        if options.dry_run {
            writeln!(words, "{n} events can be kept; nothing was changed: {dir:?}").ok();
        } else if repaired.kept_beside.is_empty() && repaired.notes.is_empty() {
            writeln!(words, "there is nothing to repair, and nothing was changed: {n} events in {dir:?}")
                .ok();
        } else {
            writeln!(words, "{n} events are kept in {dir:?}").ok();
            for beside in &repaired.kept_beside {
                writeln!(words, "what stood there before is in {beside:?}").ok();
            }
        }
        words
    })
}
