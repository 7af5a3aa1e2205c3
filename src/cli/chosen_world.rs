//! The world that a command is about: a built-in one by its name, or any by its file.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context as _;
use dropj::dataset::Dataset;
use dropj::run::read_at_most;
use dropj::session::Header;
use dropj::session::worlds::asset;
use dropj::worker::{OpenError, OpenWorld};
use dropj::world::cars::{Aids, CarWorld};
use dropj::world::{NAMES, ProcessWorld, SourceKind, World, WorldSpec};
use dropj::world_model::{WorldModel, WorldModelConfig};

/// What a smaller world model is called, on the command line and at the end of its file's name.
const COMPACT: &str = "compact";
/// Bytes of a world's file.
const MOST: u64 = 1 << 20;

/// A world, and where its file is if it has one of its own.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ChosenWorld {
    pub(crate) spec: Arc<WorldSpec>,
    pub(crate) file: Option<PathBuf>,
}

/// Reads what `--env` names: a built-in world, or a world's file.
pub(crate) fn chosen_world(named: &str) -> Result<ChosenWorld, String> {
    ChosenWorld::named(named).map_err(|met| super::words::in_words(&met))
}

/// The world in the file at `path`.
pub(crate) fn read_world(path: &Path) -> anyhow::Result<WorldSpec> {
    let bytes = read_at_most(path, MOST).with_context(|| format!("cannot read the world: {path:?}"))?;
    let bytes = bytes.with_context(|| {
        format!("a world's file has {MOST} bytes at the most, and this has more: {path:?}")
    })?;
    Ok(WorldSpec::from_toml(&dropj::text::decoded(&bytes), path)?)
}

impl ChosenWorld {
    /// The first of the built-in worlds.
    pub(crate) fn usual() -> Self {
        Self::built_in(WorldSpec::default())
    }

    fn built_in(spec: WorldSpec) -> Self {
        Self { spec: Arc::new(spec), file: None }
    }

    /// The built-in world of this name, or that in this file.
    pub(crate) fn named(named: &str) -> anyhow::Result<Self> {
        if let Some(spec) = WorldSpec::built_in(named) {
            return Ok(Self::built_in(spec));
        }
        let path = Path::new(named);
        anyhow::ensure!(
            path.exists(),
            "there is no world {:?}: built in are {}, any other is named by its file, such as world.toml",
            dropj::text::shown(named),
            NAMES.join(", ")
        );
        Self::in_file(path)
    }

    /// The world in a file.
    pub(crate) fn in_file(path: &Path) -> anyhow::Result<Self> {
        let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        let spec = read_world(&path)?;
        Ok(Self { spec: Arc::new(spec), file: Some(path) })
    }

    /// That of the session with this head: built in, in the file that it names, or as its world model knows it.
    pub(crate) fn of_session(header: &Header, model: Option<&WorldModel>) -> anyhow::Result<Self> {
        if let Some(spec) = WorldSpec::built_in(&header.env) {
            return Ok(Self::built_in(spec));
        }
        let file = header.world_file.as_deref().map(Path::new);
        if let Some(file) = file.filter(|file| file.exists()) {
            return Self::in_file(file);
        }
        // What it looks like is known; where it moves is not.
        match model.filter(|model| model.spec().name == header.env) {
            Some(model) => Ok(Self { spec: Arc::clone(model.spec()), file: None }),
            None => anyhow::bail!(
                "{:?} is not a world of this program, and its file is not at {file:?}: name it with --env",
                dropj::text::shown(&header.env)
            ),
        }
    }

    /// What it is called in sessions and recordings.
    pub(crate) fn name(&self) -> &str {
        &self.spec.name
    }

    /// Whether this program brings it along.
    pub(crate) fn is_built_in(&self) -> bool {
        self.spec.source.kind == SourceKind::BuiltIn
    }

    /// The folder that its file is in.
    fn folder(&self) -> PathBuf {
        self.file.as_deref().and_then(Path::parent).map(Path::to_owned).unwrap_or_default()
    }

    /// A file that belongs to it: shipped as `asset-WORLD.safetensors`, or beside the world's file as `NAME-asset.safetensors`.
    fn belonging(&self, what: &str) -> PathBuf {
        if !self.is_built_in() {
            return self.folder().join(format!("{}-{what}.safetensors", self.spec.name));
        }
        // What was fitted with everything in it serves where there is less.
        let least = NAMES.iter().filter(|name| self.spec.name.starts_with(**name));
        let name = least.min_by_key(|name| name.len()).copied().unwrap_or(NAMES[0]);
        asset(&format!("{what}-{name}.safetensors"))
    }

    /// Where its world model is looked for.
    pub(crate) fn world_model(&self) -> PathBuf {
        self.belonging("world")
    }

    /// A smaller world model that is shipped for it beside the usual one, for machines that do not keep its pace.
    pub(crate) fn compact_world_model(&self) -> Option<PathBuf> {
        let mut name = self.world_model().file_stem()?.to_owned();
        name.push(format!("-{COMPACT}.safetensors"));
        let path = self.world_model().with_file_name(name);
        (self.is_built_in() && path.is_file()).then_some(path)
    }

    /// The world model that `--world` names: a file, the compact one that is shipped, or without it the usual one.
    pub(crate) fn named_world_model(&self, named: Option<&Path>) -> PathBuf {
        let Some(path) = named else { return self.world_model() };
        let compact = || self.compact_world_model().filter(|_| path == Path::new(COMPACT) && !path.exists());
        compact().unwrap_or_else(|| path.to_owned())
    }

    /// Where the probe for the world model in the file `world` is looked for: beside that, by a name of the same kind, or where
    /// that of the world is.
    pub(crate) fn probe(&self, world: &Path) -> PathBuf {
        let name = world.file_name().map(|name| name.to_string_lossy());
        let beside = name.filter(|name| name.contains("world")).map(|name| {
            let at = name.rfind("world").unwrap_or_default();
            world.with_file_name(format!("{}probe{}", &name[..at], &name[at + "world".len()..]))
        });
        beside.filter(|path| path.is_file()).unwrap_or_else(|| self.belonging("probe"))
    }

    /// The networks that two cores train and dream with for it.
    pub(crate) fn networks(&self) -> WorldModelConfig {
        WorldModelConfig::for_world(&self.spec)
    }

    /// Opens it; where there are aids, they may help the driver.
    pub(crate) fn open(&self, aids: bool) -> Result<Box<dyn World>, OpenError> {
        let recordings_only = || OpenError::RecordingsOnly(self.spec.name.clone());
        match self.spec.source.kind {
            SourceKind::Recordings => Err(recordings_only()),
            SourceKind::BuiltIn => {
                let name = self.spec.source.world.as_deref().unwrap_or(&self.spec.name);
                let aids = if aids { Aids::ALL } else { Aids::NONE };
                let world = CarWorld::open(name, aids).ok_or_else(recordings_only)?;
                Ok(Box::new(world.described(Arc::clone(&self.spec))))
            }
            SourceKind::Process => {
                let world = ProcessWorld::start((*self.spec).clone(), &self.folder());
                Ok(Box::new(world.map_err(dropj::world::WorldError::Process)?))
            }
        }
    }

    /// What opens it in whichever thread it is to live.
    pub(crate) fn opener(&self) -> OpenWorld {
        let world = self.clone();
        Arc::new(move |aids| world.open(aids))
    }
}

/// The recordings in `dir`, and the world that they are of: the one that was named, or the built-in one that they name.
pub(crate) fn recordings(
    dir: &Path,
    named: Option<&ChosenWorld>,
) -> anyhow::Result<(Dataset, Arc<WorldSpec>)> {
    if let Some(world) = named {
        return Ok((Dataset::open_as(dir, &world.spec)?, Arc::clone(&world.spec)));
    }
    let dataset = Dataset::open(dir)?;
    let env = dataset.env().unwrap_or_default();
    let spec = WorldSpec::built_in(env).with_context(|| {
        format!(
            "the recordings in {dir:?} are of {:?}, a world that this program does not bring along: give its file with --env",
            dropj::text::shown(env)
        )
    })?;
    Ok((dataset, Arc::new(spec)))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn a_world_is_named_or_in_a_file() {
        let named = |name: &str| chosen_world(name).map(|world| world.name().to_owned());
        assert_eq!(named("obstacle-car-racing").unwrap(), "obstacle-car-racing");
        assert!(
            named("elsewhere").unwrap_err().contains("built in are car-racing"),
            "{:?}",
            named("elsewhere")
        );
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("mine.toml");
        let text = WorldSpec::default().to_toml().replace("\"car-racing\"  #", "\"mine\"  #");
        fs::write(&path, &text).unwrap();
        let world = chosen_world(path.to_str().unwrap()).unwrap();
        assert_eq!(world.name(), "mine");
        assert!(world.open(false).is_ok(), "a built-in world under another name");
        fs::write(&path, text.replace("rate = 50.0", "rate = -1.0")).unwrap();
        assert!(chosen_world(path.to_str().unwrap()).unwrap_err().contains("rate"));
    }

    #[test]
    fn what_is_shipped_serves_the_worlds_that_begin_with_its_name() {
        let of = |name: &str| chosen_world(name).unwrap().world_model().file_name().unwrap().to_owned();
        assert_eq!(of("car-racing"), "world-car-racing.safetensors");
        assert_eq!(of("obstacle-car-racing"), "world-obstacle-car-racing.safetensors");
        assert_eq!(of("obstacle-car-racing-chuckholes"), "world-obstacle-car-racing.safetensors");
    }

    #[test]
    fn a_compact_model_has_a_name_and_a_probe_of_its_own() {
        let obstacles = chosen_world("obstacle-car-racing-chuckholes").unwrap();
        let named = |name: &str| obstacles.named_world_model(Some(Path::new(name)));
        let file_of = |path: PathBuf| path.file_name().unwrap().to_string_lossy().into_owned();
        assert_eq!(file_of(named("compact")), "world-obstacle-car-racing-compact.safetensors");
        let probe = obstacles.probe(&named("compact"));
        assert_eq!(file_of(probe), "probe-obstacle-car-racing-compact.safetensors");
        assert_eq!(named("elsewhere/world.safetensors"), Path::new("elsewhere/world.safetensors"));
        assert_eq!(
            file_of(obstacles.probe(Path::new("world.safetensors"))),
            "probe-obstacle-car-racing.safetensors"
        );
        let cars = chosen_world("car-racing").unwrap();
        assert_eq!(cars.compact_world_model(), None, "the usual one is small");
        assert_eq!(cars.named_world_model(Some(Path::new("compact"))), Path::new("compact"));
    }
}
