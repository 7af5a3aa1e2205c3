//! Finding the networks that a command works with.

use std::path::Path;

use anyhow::Context as _;
use dropj::run::read_parameters;
use dropj::session::SessionStore;
use dropj::simulate::probe::Probe;
use dropj::tensor::Backend;
use dropj::world_model::WorldModel;

use dropj::world::WorldSpec;

use super::chosen_world::ChosenWorld;

/// Whether `model` is of the world `here`: sees what it shows, and does what can be done there.
pub(crate) fn require(model: &WorldModel, here: &ChosenWorld) -> anyhow::Result<()> {
    let (of, spec) = (model.spec(), &here.spec);
    let (sees, shown) = (of.image.trained(), spec.image.trained());
    anyhow::ensure!(
        sees == shown,
        "this world model was trained on {:?}, in pictures of {sees} pixels, and {:?} shows {shown}: choose another with \
         --world, or its world with --env",
        of.name,
        spec.name
    );
    let ranges = |spec: &WorldSpec| spec.axes.iter().map(|axis| (axis.low, axis.high)).collect::<Vec<_>>();
    anyhow::ensure!(
        ranges(of) == ranges(spec),
        "this world model was trained on {:?}, whose actions are in the ranges {:?}, and those of {:?} are in {:?}: choose \
         another with --world, or its world with --env",
        of.name,
        ranges(of),
        spec.name,
        ranges(spec)
    );
    anyhow::ensure!(
        (of.rate - spec.rate).abs() <= 1e-3 * spec.rate,
        "this world model was trained on {:?} at {} steps a second, and {:?} has {}: choose another with --world, or its \
         world with --env",
        of.name,
        of.rate,
        spec.name,
        spec.rate
    );
    Ok(())
}

/// The world model in `path`.
pub(crate) fn world_model(path: &Path) -> anyhow::Result<WorldModel> {
    let parameters = read_parameters(path).context(
        "there is no usable world model; give one with --world, or train one with `dropj fit-world`",
    )?;
    WorldModel::load(parameters).with_context(|| format!("in the file {path:?}"))
}

/// The world model that the session in `dir` was made with: the one in `path`, or else the one that is found by its hash.
pub(crate) fn of_session(dir: &Path, path: Option<&Path>) -> anyhow::Result<WorldModel> {
    match path {
        Some(path) => world_model(path),
        None => Ok(SessionStore::read_world_model(dir)?),
    }
}

/// The probe in `path`, or else that for the world model in the file `model`.
pub(crate) fn probe(
    path: Option<&Path>,
    model: &Path,
    world: &ChosenWorld,
    backend: Backend,
) -> anyhow::Result<Probe> {
    let usual = world.probe(model);
    let path = path.unwrap_or(&usual);
    let parameters = read_parameters(path)
        .context("there is no usable probe; give one with --probe, or fit one with `dropj fit-probe`")?;
    Probe::load_on(&parameters, backend.device).with_context(|| format!("in the file {path:?}"))
}
