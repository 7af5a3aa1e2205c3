//! `dropj export --hub`: folders as the Hugging Face Hub and its clients want them.
//!
//! ```text
//! recordings    data/ meta/ README.md              a LeRobotDataset v3.0
//! networks      model.safetensors config.json README.md
//! ```

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use dropj::dataset::Dataset;
use dropj::reward::{RewardKind, RewardNetworks};
use dropj::run::{Building, read_at_most, read_parameters, write_whole};
use dropj::tensor::Parameters;
use dropj::tensor::container::Container;
use dropj::text::{decoded, shown};
use dropj::world_model::WorldModel;
use dropj::world_model::fit::FitRecord;
use serde_json::{Value, json};

use super::meter::Meter;
use super::told::Form;

/// Where the networks lie, and what they are: where the Hub's clients look.
const MODEL: &str = "model.safetensors";
const CONFIG: &str = "config.json";
const CARD: &str = "README.md";
/// Bytes of a file of results.
const MOST: u64 = 16 << 20;

/// What goes to the Hub.
#[derive(Clone, Debug)]
pub(crate) enum Item<'a> {
    /// A folder of recordings.
    Recordings(&'a Path),
    /// The file of a world model.
    World(&'a Path),
    /// The file of a reward.
    Reward(&'a Path),
}

/// Writes `item` as the folder `out`, where there must be nothing yet; `results` is what a check of it printed as JSON.
pub(crate) fn write(item: &Item<'_>, out: &Path, results: Option<&Path>, form: Form) -> anyhow::Result<()> {
    let results = results.map(figures).transpose()?;
    let told = match item {
        Item::Recordings(dir) => {
            anyhow::ensure!(
                results.is_none(),
                "--results is of a world model or a reward: recordings need none"
            );
            let dataset = Dataset::open(dir)?;
            let building = begin(out)?;
            let mut meter = Meter::new();
            dataset.write_for_hub(building.dir(), |done, n| {
                meter.at("writing episodes", done, n, String::new);
            })?;
            drop(meter);
            building.finish()?;
            json!({"kind": "dataset", "folder": out, "episodes": dataset.n_episodes(), "steps": dataset.n_steps()})
        }
        Item::World(path) => network(&world_model(path)?, results, out)?,
        Item::Reward(path) => network(&reward(path)?, results, out)?,
    };
    let kind = told["kind"].as_str().unwrap_or_default().to_owned();
    form.tell(&told, || {
        let folder = shown(&out.to_string_lossy());
        let mut words =
            format!("written: {out:?}\nto upload it: hf upload USER/NAME {folder} --repo-type {kind}\n");
        if kind == "dataset" {
            words +=
                "LeRobot then finds it by a tag: hf repos tag create USER/NAME v3.0 --repo-type dataset\n";
        }
        words
    })
}

fn begin(out: &Path) -> anyhow::Result<Building> {
    let is_ours = |way: &Path| {
        let at = |name: &str| way == Path::new(name);
        let is_table = way.extension().is_some_and(|end| end == "parquet" || end == "json");
        [MODEL, CONFIG, CARD, ".gitignore"].into_iter().any(at)
            || is_table && (way.starts_with("data") || way.starts_with("meta"))
    };
    Ok(Building::begin(out, is_ours)?)
}

/// Networks with all that is said of them.
struct Network {
    parameters: Parameters,
    /// Of what kind they are, for programs.
    model_type: &'static str,
    config: Value,
    card: String,
}

/// Writes the folder of networks.
fn network(network: &Network, results: Option<Vec<(String, String)>>, out: &Path) -> anyhow::Result<Value> {
    let Network { parameters, model_type, config, card } = network;
    let building = begin(out)?;
    write_whole(&building.dir().join(MODEL), parameters.bytes())?;
    write_whole(&building.dir().join(CONFIG), &serde_json::to_vec_pretty(config)?)?;
    let card = card.clone() + &measured(results) + LICENSE;
    write_whole(&building.dir().join(CARD), card.as_bytes())?;
    building.finish()?;
    Ok(json!({"kind": "model", "folder": out, "model_type": model_type, "hash": parameters.hash()}))
}

/// `config.json`: what the file says of itself, where programs look for it without reading the file.
fn config(parameters: &Parameters, model_type: &str, key: &str) -> anyhow::Result<Value> {
    let told = |key: &str| -> anyhow::Result<Value> {
        parameters.metadata(key).map_or(Ok(Value::Null), |text| Ok(serde_json::from_str(&text)?))
    };
    let mut config = json!({
        "model_type": model_type,
        "library_name": "dropj",
        "dropj_version": env!("CARGO_PKG_VERSION"),
        "hash": parameters.hash(),
        "parameters": n_numbers(parameters)?,
        "config": told(key)?,
    });
    let fit = told("fit")?;
    if !fit.is_null() {
        config["fit"] = fit;
    }
    Ok(config)
}

/// How many numbers the networks have, without what is kept beside them.
fn n_numbers(parameters: &Parameters) -> anyhow::Result<usize> {
    let container = Container::read(parameters.bytes())?;
    let networks = container.entries.iter().filter(|entry| !entry.name.starts_with("starts."));
    Ok(networks.map(|entry| entry.shape.iter().product::<usize>()).sum())
}

fn world_model(path: &Path) -> anyhow::Result<Network> {
    let parameters = read_parameters(path)?;
    let model = WorldModel::load(parameters.clone()).with_context(|| format!("in the file {path:?}"))?;
    let config = config(&parameters, "dropj-world-model", "config")?;
    let (spec, networks) = (model.spec(), model.config());
    let (size, rate) = (networks.vae.size(), spec.rate);
    let mut card = front(&format!("World model of {}", shown(&spec.name)), &["world-model"], &spec.name);
    let name = shown(&spec.name);
    writeln!(
        card,
        "# A world model of `{name}`\n\nIt observes, imagines and paints what `{name}` shows, and is made for \
         dropj, a program for safe reward learning from preferences and justifications: a variational autoencoder of pictures of {} by {} pixels into {} latents, and a recurrent network of {} \
         cells with mixtures of {} Gaussians, {} parameters in all (Ha and Schmidhuber, *World Models*, 2018).\n\n\
         | axis of an action | from | to |\n|---|---|---|",
        size.height,
        size.width,
        networks.mdn_rnn.latent,
        networks.mdn_rnn.memory,
        networks.mdn_rnn.components,
        config["parameters"]
    )?;
    for axis in &spec.axes {
        writeln!(card, "| `{}` | {} | {} |", shown(&axis.name), axis.low, axis.high)?;
    }
    writeln!(
        card,
        "\nIt takes {rate} steps a second. Its hash, by which sessions and rewards know it, is\n`{}`.\n",
        parameters.hash()
    )?;
    card += "## What it was fitted on\n\n";
    match FitRecord::of(&parameters) {
        Some(FitRecord { n_episodes, settings, app, .. }) => writeln!(
            card,
            "{n_episodes} recorded episodes, those that were held out among them, with the seed {}, by dropj {app}; all settings \
             are in `config.json`.",
            settings.seed
        )?,
        None => card += "Its file does not tell.\n",
    }
    if let Some(held_out) = model.held_out() {
        writeln!(card, "{} of the episodes were held out.", held_out.len())?;
    }
    card += "What never happened in them it cannot imagine.\n";
    card += "\n## Using it\n\n```sh\nhf download USER/NAME --local-dir world\ndropj --world world/model.safetensors\n```\n\n\
             ```python\nimport dropj  # the package that `dropj world adapter --out DIR` writes\n\
             world = dropj.load_world(\"world/model.safetensors\")\n```\n\n";
    Ok(Network { parameters, model_type: "dropj-world-model", config, card })
}

fn reward(path: &Path) -> anyhow::Result<Network> {
    let parameters = read_parameters(path)?;
    let networks = RewardNetworks::load(&parameters).with_context(|| format!("in the file {path:?}"))?;
    let is_of_verdicts = matches!(RewardKind::of(&parameters), Some(RewardKind::Verdicts));
    let (model_type, key) = if is_of_verdicts {
        ("dropj-verdict-reward", dropj::reward::SparseReward::KEY)
    } else {
        ("dropj-reward", dropj::reward::RewardEnsemble::KEY)
    };
    let config = config(&parameters, model_type, key)?;
    let (from, inputs) = match &networks {
        RewardNetworks::Preferences(reward) => {
            ("which of two clips is better, whether they stay safe, and why", reward.inputs())
        }
        RewardNetworks::Verdicts(reward) => {
            ("whether single steps are good, neutral or unsafe", reward.inputs())
        }
    };
    let members = config["config"]["config"]["members"].as_u64().unwrap_or_default();
    let mut card = front("Reward", &["reward-model", "preference-learning"], "");
    writeln!(
        card,
        "# A reward\n\nLearned with dropj from what a person said: {from}. It is an ensemble of {members} networks, {} parameters in \
         all, which reads the {} features of a state of the world model\n`{}`\nand the {} numbers of an action; with any other world model \
         it means nothing.\n\nIt says what was asked for in the answers that it was learned from, as far as these told it; where they told \
         nothing, it guesses.\n\n## Using it\n\n```python\nimport dropj  # the package that `dropj world adapter --out DIR` writes\n\
         world = dropj.load_world(\"world/model.safetensors\")\n\
         reward = dropj.load_reward(\"reward/model.safetensors\", world=world)\n```\n",
        config["parameters"],
        inputs.n_features,
        inputs.world_model,
        inputs.ranges.n_axes(),
    )?;
    Ok(Network { parameters, model_type, config, card })
}

/// The front matter of a card.
fn front(name: &str, tags: &[&str], world: &str) -> String {
    let mut front = String::from(
        "---\nlibrary_name: dropj\npipeline_tag: reinforcement-learning\ntags:\n- dropj\n- safetensors\n",
    );
    let world = (!world.is_empty()).then(|| shown(world));
    for tag in tags.iter().map(|&tag| tag.to_owned()).chain(world) {
        // A text of JSON is one of YAML.
        writeln!(front, "- {}", Value::from(tag)).ok();
    }
    writeln!(front, "model_name: {}\n---\n", Value::from(name)).ok();
    front
}

/// What was measured, for a card.
fn measured(results: Option<Vec<(String, String)>>) -> String {
    let mut text = String::from("## Figures\n\n");
    match results {
        None => text += "None were given: `dropj check-world` and `dropj check-reward` measure them.\n",
        Some(rows) => {
            text += "As dropj printed them:\n\n| figure | |\n|---|---|\n";
            for (name, value) in rows {
                writeln!(text, "| `{name}` | {value} |").ok();
            }
        }
    }
    text
}

/// The end of a card.
const LICENSE: &str = "\n## License\n\nNone is stated yet. Whoever passes it on says so at the top, as `license: apache-2.0`.\n";

/// The figures in a file that a check printed as JSON, of which the last line counts: each by the way to it.
fn figures(path: &Path) -> anyhow::Result<Vec<(String, String)>> {
    let bytes = read_at_most(path, MOST).with_context(|| format!("cannot read the results: {path:?}"))?;
    let bytes = bytes
        .with_context(|| format!("results have {MOST} bytes at the most, and this has more: {path:?}"))?;
    let text = decoded(&bytes).into_owned();
    let last = text.trim_end().lines().next_back().unwrap_or_default();
    let parsed = serde_json::from_str(&text).or_else(|_| serde_json::from_str(last));
    let value: Value = parsed.with_context(|| {
        format!("these are no results that `check-world --json`, `check-reward --json` or `deploy --json` printed: {path:?}")
    })?;
    let mut rows = Vec::new();
    flatten(&value, "", &mut rows);
    Ok(rows)
}

/// Each number and text in `value` with the way to it; a list of these in one row.
fn flatten(value: &Value, way: &str, rows: &mut Vec<(String, String)>) {
    let plain = |value: &Value| match value {
        Value::Number(number) => Some(number.to_string()),
        Value::String(text) => Some(shown(text).replace('|', "\\|")),
        Value::Bool(told) => Some(told.to_string()),
        Value::Null => Some("–".to_owned()),
        Value::Array(_) | Value::Object(_) => None,
    };
    let below = |name: &str| if way.is_empty() { name.to_owned() } else { format!("{way}.{name}") };
    match value {
        Value::Object(fields) => {
            fields.iter().for_each(|(name, value)| flatten(value, &below(&shown(name)), rows));
        }
        Value::Array(values) => {
            if let Some(row) = values.iter().map(plain).collect::<Option<Vec<_>>>() {
                rows.push((way.to_owned(), row.join(", ")));
            } else {
                values.iter().enumerate().for_each(|(i, value)| flatten(value, &below(&i.to_string()), rows));
            }
        }
        other => rows.extend(plain(other).map(|value| (way.to_owned(), value))),
    }
}

/// The folder that `--hub` names and what goes into it.
#[derive(Debug, clap::Args)]
pub(crate) struct HubOptions {
    /// Write a folder that the Hugging Face Hub and its clients take: for recordings, a world model or a reward; there must
    /// be nothing yet
    #[arg(long, value_name = "FOLDER", conflicts_with = "torchscript")]
    pub(crate) hub: Option<PathBuf>,
    /// The recordings to write
    #[arg(long, value_name = "FOLDER", requires = "hub", conflicts_with_all = ["world", "reward"])]
    pub(crate) data: Option<PathBuf>,
    /// For the card of networks: what `check-world --json`, `check-reward --json` or `deploy --json` printed of them
    #[arg(long, value_name = "FILE", requires = "hub", conflicts_with = "data")]
    pub(crate) results: Option<PathBuf>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_found_wherever_they_stand() {
        let mut rows = Vec::new();
        flatten(&json!({"n": 3, "figures": {"dreamed": [0.5, 1], "of": [{"auc": null}]}}), "", &mut rows);
        let rows: Vec<(&str, &str)> =
            rows.iter().map(|(way, value)| (way.as_str(), value.as_str())).collect();
        assert_eq!(rows, [("figures.dreamed", "0.5, 1"), ("figures.of.0.auc", "–"), ("n", "3")]);
    }
}
