//! How a command tells its result: in words, or as one JSON object.

use std::io::Write as _;

use serde::Serialize;

/// `--json`, of every command that tells a result.
#[derive(Clone, Copy, Debug, clap::Args)]
pub(crate) struct Form {
    /// Print the result as one JSON object
    #[arg(long)]
    pub(crate) json: bool,
}

impl Form {
    /// Prints `result`, which is an object, as it is or as `words`.
    pub(crate) fn tell(self, result: &impl Serialize, words: impl FnOnce() -> String) -> anyhow::Result<()> {
        let mut text = if self.json { serde_json::to_string(result)? } else { words() };
        if !text.ends_with('\n') {
            text.push('\n');
        }
        Ok(std::io::stdout().write_all(text.as_bytes())?)
    }
}
