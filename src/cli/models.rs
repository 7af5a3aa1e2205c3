//! Finding the networks that a command works with.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use dropj::run::read_parameters;
use dropj::session::SessionStore;
pub(crate) use dropj::session::worlds::asset;
use dropj::simulate::probe::Probe;
use dropj::world_model::WorldModel;

use super::choices::EnvName;

/// The shipped world model of an environment.
pub(crate) fn world_model_asset(env: EnvName) -> PathBuf {
    // That with other cars has seen chuckholes without them, too.
    let env = if env == EnvName::CarRacing { env } else { EnvName::ObstacleCarRacing };
    asset(&format!("world-{}.safetensors", env.name()))
}

/// Whether `model` can see what `env` shows.
pub(crate) fn require(model: &WorldModel, env: EnvName) -> anyhow::Result<()> {
    let (sees, shown) = (model.config().vae.side, env.world().vae.side);
    anyhow::ensure!(
        sees == shown,
        "this world model was trained on {:?}, in pictures of {sees} pixels a side, and {:?} shows {shown}: \
         choose another with --world, or its environment with --env",
        model.config().env,
        env.name()
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

/// The probe in `path`, or the shipped one of an environment.
pub(crate) fn probe(path: Option<&Path>, env: EnvName) -> anyhow::Result<Probe> {
    let shipped = match env {
        EnvName::CarRacing => asset("probe-car-racing.safetensors"),
        EnvName::ObstacleCarRacing | EnvName::ObstacleCarRacingChuckholes => {
            asset("probe-obstacle-car-racing.safetensors")
        }
    };
    let path = path.unwrap_or(&shipped);
    let parameters = read_parameters(path)
        .context("there is no usable probe; give one with --probe, or fit one with `dropj fit-probe`")?;
    Probe::load(&parameters).with_context(|| format!("in the file {path:?}"))
}
