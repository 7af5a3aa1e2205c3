//! What the Hugging Face Hub wants to know: a card beside the episodes, the type of each column, and what stays at home.
//!
//! ```text
//! README.md     the card: front matter in YAML for programs, then words for people
//! .gitignore    what no upload takes along
//! ```
//!
//! A card is written anew with each episode as long as it is as we wrote it: its last line holds the SHA-256 of all
//! before that. One that somebody changed is theirs.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use serde_json::{Map, Value, json};
use sha2::{Digest as _, Sha256};

use super::hex::to_hex;
use super::layout::column;
use super::notes::{ACTION, Columns, IMAGE, Notes, STATE};
use super::{DatasetError, disk};
use crate::text::shown;

/// The key in the footer of an episode file under which `datasets` looks for the types of the columns.
pub(super) const FEATURES: &str = "huggingface";
/// The card.
const CARD: &str = "README.md";
/// What an upload passes over.
const IGNORED: &str = ".gitignore";
/// Whatever the folder holds beside episodes, their index and the card.
const IGNORE: &str = "# dropj's own, of no use to others.\n/journal/\n/deleted/\n/damaged/\n";
/// The last line of a card of ours, before and after the digits.
const MARK: [&str; 2] =
    ["<!-- dropj ", ": it writes this card anew with each episode, until somebody changes it -->\n"];

/// Writes the card of these episodes, and what an upload passes over, where there is nothing yet or what we wrote.
pub(super) fn write(dir: &Path, episodes: &[Notes]) -> Result<(), DatasetError> {
    let Some(first) = episodes.first() else { return Ok(()) };
    let (card, ignored) = (dir.join(CARD), dir.join(IGNORED));
    if is_free(&card, is_ours) {
        disk::replace_if_other(&card, marked(front(first, episodes) + &body(first, episodes)).as_bytes())?;
    }
    if is_free(&ignored, |text| text == IGNORE) {
        disk::replace_if_other(&ignored, IGNORE.as_bytes())?;
    }
    Ok(())
}

/// Removes what [`write()`] wrote.
pub(super) fn remove(dir: &Path) -> Result<(), DatasetError> {
    let is_ignore: fn(&str) -> bool = |text| text == IGNORE;
    for (name, is_ours) in [(CARD, is_ours as fn(&str) -> bool), (IGNORED, is_ignore)] {
        let path = dir.join(name);
        if path.exists() && is_free(&path, is_ours) {
            fs::remove_file(&path).map_err(DatasetError::disk("remove the file", &path))?;
        }
    }
    Ok(())
}

/// Copies the card of the dataset at `from` to `to` where somebody changed it.
pub(super) fn take_along(from: &Path, to: &Path) -> Result<(), DatasetError> {
    let path = from.join(CARD);
    match fs::read(&path) {
        Ok(card) if !str::from_utf8(&card).is_ok_and(is_ours) => disk::replace(&to.join(CARD), &card),
        _ => Ok(()),
    }
}

/// Whether nothing is at `path`, or what is ours.
fn is_free(path: &Path, is_ours: impl Fn(&str) -> bool) -> bool {
    match fs::read_to_string(path) {
        Ok(text) => is_ours(&text),
        // What cannot be read, as it is a folder or no text, is not ours.
        Err(met) => met.kind() == std::io::ErrorKind::NotFound,
    }
}

/// Whether a card is as we wrote it.
fn is_ours(card: &str) -> bool {
    let text = card.rfind(MARK[0]).map(|at| &card[..at]);
    text.is_some_and(|text| marked(text.to_owned()) == card)
}

/// A card with the line that tells it from one that was changed.
fn marked(text: String) -> String {
    let digest = to_hex(&Sha256::digest(text.as_bytes()));
    format!("{text}{}{digest}{}", MARK[0], MARK[1])
}

/// The columns in their order, and how `datasets` calls what a value of each is, with how many numbers it has.
fn types(columns: &Columns) -> Vec<(String, &'static str, usize)> {
    let Columns { layout, .. } = columns;
    let events: Vec<String> = layout.events.iter().map(|event| column(event)).collect();
    let of = |name: String| {
        let (kind, width) = match name.as_str() {
            IMAGE => ("image", 1),
            ACTION => ("float32", layout.axes.len()),
            STATE => ("float32", layout.sensors.len()),
            "next.reward" | "timestamp" => ("float32", 1),
            name if name.starts_with("next.") => ("bool", 1),
            _ => ("int64", 1),
        };
        // An event may be called as a column of numbers is.
        let kind = if events.contains(&name) { "bool" } else { kind };
        (name, kind, width)
    };
    columns.names().into_iter().map(of).collect()
}

/// What stands under [`FEATURES`]: the types in the words of `datasets`, which its older versions know, too.
pub(super) fn features(columns: &Columns) -> Value {
    let features = types(columns).into_iter().map(|(name, kind, width)| {
        let value = json!({"dtype": kind, "_type": "Value"});
        let feature = match (kind, width) {
            ("image", _) => json!({"_type": "Image"}),
            (_, 1) => value,
            _ => json!({"feature": value, "length": width, "_type": "Sequence"}),
        };
        (name, feature)
    });
    json!({"info": {"features": features.collect::<Map<_, _>>()}})
}

/// The front matter.
fn front(first: &Notes, episodes: &[Notes]) -> String {
    let n: usize = episodes.iter().map(|notes| notes.n_steps).sum();
    let size = match n {
        0..1_000 => "n<1K",
        1_000..10_000 => "1K<n<10K",
        10_000..100_000 => "10K<n<100K",
        100_000..1_000_000 => "100K<n<1M",
        1_000_000..10_000_000 => "1M<n<10M",
        _ => "10M<n<100M",
    };
    let name = json!(format!("Recordings of {}", shown(&first.info.env)));
    let tag = json!(shown(&first.info.env));
    let mut front = format!(
        "---\npretty_name: {name}\ntask_categories:\n- robotics\n- reinforcement-learning\ntags:\n- LeRobot\n- dropj\n- {tag}\n\
         size_categories:\n- {size}\nconfigs:\n- config_name: default\n  data_files: data/*/*.parquet\n\
         dataset_info:\n  features:\n"
    );
    for (name, kind, width) in types(&first.columns()) {
        let what = if width == 1 { "dtype" } else { "sequence" };
        // A text of JSON is one of YAML.
        writeln!(front, "  - name: {}\n    {what}: {kind}", json!(name)).ok();
        if width != 1 {
            writeln!(front, "    length: {width}").ok();
        }
    }
    front + "---\n\n"
}

/// The words.
fn body(first: &Notes, episodes: &[Notes]) -> String {
    let n_steps: usize = episodes.iter().map(|notes| notes.n_steps).sum();
    let (size, rate) = (first.size(), first.rate);
    let minutes = n_steps as f64 / rate / 60.0;
    let apps: Vec<String> = tally(episodes, |notes| &notes.app).into_keys().collect();
    let (env, n_episodes) = (named(&first.info.env), episodes.len());
    let mut body = format!(
        "# Recordings of {env}\n\n{n_episodes} {} with {n_steps} {} at {rate} a second ({minutes:.1} minutes), in pictures of {} by \
         {} pixels: a LeRobotDataset v3.0, recorded with dropj {}.\n",
        plural(n_episodes, "episode"),
        plural(n_steps, "step"),
        size.height,
        size.width,
        apps.join(", "),
    );
    body += "\nA row is a step: the picture *before* the action, the action as the world took it, and what came of it.\n\n";
    body += "| column | |\n|---|---|\n";
    let list = |names: &[String]| names.iter().map(|name| named(name)).collect::<Vec<_>>().join(", ");
    writeln!(body, "| `{ACTION}` | {} |", list(&first.axes)).ok();
    if !first.state.is_empty() {
        writeln!(body, "| `{STATE}` | {} |", list(&first.state)).ok();
    }
    body += "| `next.reward` | the world's own reward |\n";
    for event in &first.events {
        let steps = |notes: &Notes| {
            let share = notes.stats.get(&column(event)).map_or(0.0, |stats| stats.mean[0]);
            share * notes.n_steps as f64
        };
        let share = 100.0 * episodes.iter().map(steps).sum::<f64>() / n_steps as f64;
        writeln!(
            body,
            "| {} | {} goes on after the step: {share:.1} % of all |",
            named(&column(event)),
            named(event)
        )
        .ok();
    }
    body += "\n| driver | episodes | steps |\n|---|---|---|\n";
    for (pilot, of_them) in tally(episodes, |notes| &notes.info.pilot) {
        let n: usize = of_them.iter().map(|notes| notes.n_steps).sum();
        writeln!(body, "| {} | {} | {n} |", named(&pilot), of_them.len()).ok();
    }
    body += HOW;
    body
}

/// How to read them.
const HOW: &str = r#"
## Reading them

```python
from datasets import load_dataset
steps = load_dataset("USER/NAME", split="train")       # or a folder

from lerobot.datasets.lerobot_dataset import LeRobotDataset
steps = LeRobotDataset("USER/NAME")                    # or LeRobotDataset("any/name", root=FOLDER)
```

LeRobot takes a dataset from the Hub by the tag of its format, which whoever uploads it sets once:
`huggingface_hub.HfApi().create_tag("USER/NAME", tag="v3.0", repo_type="dataset")`.

The frame after the last action of an episode is no step; it stands in the footer of the episode's file, as
`dropj.last_frame`.

## License

None is stated yet. Whoever passes the recordings on says so at the top, as `license: cc-by-4.0`.

"#;

/// The episodes by what `of` says of each, in its order.
fn tally(episodes: &[Notes], of: fn(&Notes) -> &String) -> BTreeMap<String, Vec<&Notes>> {
    let mut tally: BTreeMap<String, Vec<&Notes>> = BTreeMap::new();
    for notes in episodes {
        tally.entry(of(notes).clone()).or_default().push(notes);
    }
    tally
}

/// A name of somebody's as code in a table.
fn named(name: &str) -> String {
    format!("`{}`", shown(name).replace('`', "'").replace('|', "\\|"))
}

fn plural(n: usize, what: &str) -> String {
    if n == 1 { what.to_owned() } else { format!("{what}s") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_card_is_ours_until_a_letter_of_it_changes() {
        let card = marked("# Recordings\n".to_owned());
        assert!(is_ours(&card));
        for changed in ["# My recordings\n", ""] {
            assert!(!is_ours(&card.replace("# Recordings\n", changed)), "{changed:?}");
        }
        assert!(!is_ours(&format!("{card}And more.\n")) && !is_ours("") && !is_ours("# Recordings\n"));
    }
}
