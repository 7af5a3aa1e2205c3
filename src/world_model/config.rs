//! The shapes of both networks, and the world that they are of: what the header of a world model tells.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::tensor::limits::{OutOfRange, named, within};
use crate::tensor::{Parameters, describes};
use crate::text::shown;
use crate::world::{ImageSpec, Source, SourceKind, WorldSpec};
use crate::world_model::{MdnRnnConfig, VaeConfig, WorldModelError};

/// Bytes of a world's file within a header: those of the built-in worlds have some three thousand.
const MAX_WORLD: usize = 1 << 18;

/// The shapes of both networks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorldModelConfig {
    /// The world whose recordings it learns from, as on the command line.
    pub env: String,
    /// That world's file, where it is none that this program brings along: see [`Self::spec`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub world: Option<String>,
    /// Vision.
    pub vae: VaeConfig,
    /// Memory.
    pub mdn_rnn: MdnRnnConfig,
}

impl WorldModelConfig {
    /// The paper's networks for Car Racing.
    pub fn car_racing() -> Self {
        Self {
            env: "car-racing".to_owned(),
            world: None,
            vae: VaeConfig::car_racing(),
            mdn_rnn: MdnRnnConfig::car_racing(),
        }
    }

    /// The paper's networks for Obstacle Car Racing.
    pub fn obstacle_car_racing() -> Self {
        Self {
            env: "obstacle-car-racing".to_owned(),
            world: None,
            vae: VaeConfig::obstacle_car_racing(),
            mdn_rnn: MdnRnnConfig::obstacle_car_racing(),
        }
    }

    /// Smaller networks for Obstacle Car Racing, which two cores train and dream with in real time.
    pub fn obstacle_compact() -> Self {
        Self {
            vae: VaeConfig::obstacle_compact(),
            mdn_rnn: MdnRnnConfig::obstacle_compact(),
            ..Self::obstacle_car_racing()
        }
    }

    /// Toys for tests.
    pub fn tiny() -> Self {
        Self {
            env: "dummy-road".to_owned(),
            world: None,
            vae: VaeConfig::tiny(),
            mdn_rnn: MdnRnnConfig::tiny(),
        }
    }

    /// The same networks for `spec`, whose file goes with them unless it is that of a built-in world.
    ///
    /// What starts the world does not: whoever gets a model from elsewhere is not to run what it says, and an
    /// environment variable may be a secret.
    #[must_use]
    pub fn of_world(self, spec: &WorldSpec) -> Self {
        let is_built_in = WorldSpec::built_in(&spec.name).as_ref() == Some(spec);
        let world = || {
            let source = match spec.source.kind {
                SourceKind::Recordings => spec.source.clone(),
                _ => Source { kind: SourceKind::Recordings, ..Source::default() },
            };
            WorldSpec { source, ..spec.clone() }.to_toml()
        };
        Self { env: spec.name.clone(), world: (!is_built_in).then(world), ..self }
    }

    /// The world that it learns from, in pictures of the size that vision sees.
    ///
    /// It is the one whose file stands here, or else the built-in one of this name. Models of other names are from before
    /// worlds were described, and of a kind of Car Racing.
    pub fn spec(&self) -> Arc<WorldSpec> {
        if let Some(Ok(spec)) = self.world.as_ref().map(|file| file.parse::<WorldSpec>()) {
            return Arc::new(spec);
        }
        let mut spec = WorldSpec::built_in(&self.env).unwrap_or_else(|| {
            let like = WorldSpec::built_in("car-racing").unwrap_or_else(|| unreachable!("it is built in"));
            let source = Source { kind: SourceKind::Recordings, ..Source::default() };
            WorldSpec { name: self.env.clone(), title: self.env.clone(), source, ..like }
        });
        let size = self.vae.size();
        if spec.image.trained() != size {
            spec.image = ImageSpec { height: size.height, width: size.width, ..ImageSpec::default() };
        }
        Arc::new(spec)
    }

    /// How many features a state has: Z + 2 M.
    pub fn n_features(&self) -> i64 {
        self.mdn_rnn.latent + 2 * self.mdn_rnn.memory
    }

    /// Fails where no networks can be of these shapes, or where they do not fit each other or their world.
    pub fn check(&self) -> Result<(), OutOfRange> {
        named("the environment's name", &self.env)?;
        self.vae.check()?;
        self.mdn_rnn.check()?;
        if self.vae.latent != self.mdn_rnn.latent {
            let wanted = format!("those of vision, {}", self.vae.latent);
            return Err(OutOfRange::new("the number of memory's latents", self.mdn_rnn.latent, wanted));
        }
        self.check_world()
    }

    /// Fails where the world is none, or another than the networks are for.
    fn check_world(&self) -> Result<(), OutOfRange> {
        if let Some(file) = &self.world {
            within("the length of the world's file", file.len(), 1..=MAX_WORLD)?;
            let spec: WorldSpec = file.parse().map_err(|met| {
                OutOfRange::new(
                    "the world's file",
                    "no such file",
                    format!("one: {}", shown(&format!("{met}"))),
                )
            })?;
            if spec.name != self.env {
                let wanted = format!("that of the environment, {:?}", shown(&self.env));
                return Err(OutOfRange::new("the name in the world's file", shown(&spec.name), wanted));
            }
            let (sees, shows) = (self.vae.size(), spec.image.trained());
            if sees != shows {
                let wanted = format!("those of its world, {} x {}", shows.height, shows.width);
                let found = format!("{} x {}", sees.height, sees.width);
                return Err(OutOfRange::new("the size of vision's frames", found, wanted));
            }
        }
        let n_axes = self.spec().axes.len() as i64;
        if self.mdn_rnn.actions == n_axes {
            return Ok(());
        }
        let wanted = format!("that of its world, {n_axes}");
        Err(OutOfRange::new("the number of an action's axes", self.mdn_rnn.actions, wanted))
    }

    /// That which the header of `parameters` tells, and the layout in which they are.
    pub(super) fn of(parameters: &Parameters) -> Result<(u32, Self), WorldModelError> {
        let told = describes::<Self>(parameters.metadata("config").as_deref());
        let (layout, config) = told.map_err(WorldModelError::Header)?;
        config.check().map_err(WorldModelError::Config)?;
        Ok((layout, config))
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::run::read_parameters;
    use crate::tensor::described;
    use crate::world::{Action, ActionRanges, Frame, Size};
    use crate::world_model::{Next, Noise, State, WorldModel, actions_tensor, untrained};

    const ARM: &str = r#"
        format = 1
        name = "arm"
        title = "An arm"
        rate = 20
        longest_episode = 400
        source = { kind = "process", command = ["python", "arm.py"], environment = { TOKEN = "secret" } }
        image = { height = 60, width = 81, train = { height = 31, width = 47 } }
        axes = [
            { name = "reach", low = 0.0, high = 512.0, neutral = 256.0 },
            { name = "grip", low = -1.0, high = 1.0, neutral = 0.0 },
        ]
        events = [{ name = "bump", kind = "safety", field = "bump" }]
        networks = { latent = 5, memory = 12, components = 2, channels = 4 }
    "#;

    fn arm() -> WorldSpec {
        ARM.parse().unwrap()
    }

    fn rng() -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(0)
    }

    #[test]
    fn a_models_world_travels_with_it_but_not_what_starts_it() {
        let config = WorldModelConfig::for_world(&arm());
        let file = config.world.as_ref().unwrap();
        assert!(!file.contains("secret") && !file.contains("arm.py"), "{file}");
        let source = Source { kind: SourceKind::Recordings, ..Source::default() };
        assert_eq!(*config.spec(), WorldSpec { source, ..arm() });

        let model = untrained(&config, &mut rng());
        let again =
            WorldModel::load(Parameters::from_bytes(model.parameters().bytes().to_vec()).unwrap()).unwrap();
        assert_eq!((again.config(), again.hash()), (&config, model.hash()));
        assert_eq!((again.spec().name.as_str(), again.spec().rate), ("arm", 20.0));
        assert_eq!(again.ranges(), &ActionRanges::of(&arm().axes));

        let frame = Frame::new(31, 47, vec![90; 31 * 47 * 3]);
        let state = State { z: again.observe(&[frame]), memory: again.no_memory(1) };
        let actions = actions_tensor(&[Action::new([300.0, -1.0])]);
        let noise = Noise::draw(1, 5, &mut rng());
        for next in [Next::Mean { temperature: 0.1 }, Next::Sample { temperature: 1.0, noise: &noise }] {
            let next = again.imagine(&state, &actions, next);
            assert_eq!(next.features().size(), [1, config.n_features()]);
            assert_eq!(again.decode(&next.z)[0].size(), Size { height: 31, width: 47 });
        }
    }

    #[test]
    fn a_world_that_does_not_fit_the_networks_is_refused() {
        let config = WorldModelConfig::for_world(&arm());
        let said = |config: &WorldModelConfig| config.check().unwrap_err().to_string();
        let file = |change: &dyn Fn(&mut WorldSpec)| {
            let mut spec = arm();
            change(&mut spec);
            WorldModelConfig { world: Some(spec.to_toml()), ..config.clone() }
        };
        let axes = said(&file(&|spec| spec.axes.truncate(1)));
        assert_eq!(axes, "the number of an action's axes is 2, and must be that of its world, 1");
        let size = said(&file(&|spec| spec.image.train = Some(Size { height: 31, width: 48 })));
        assert_eq!(size, "the size of vision's frames is 31 x 47, and must be those of its world, 31 x 48");
        assert!(said(&file(&|spec| spec.name = "leg".to_owned())).contains("\"arm\""));
        let with = |world: String| WorldModelConfig { world: Some(world), ..config.clone() };
        assert!(said(&with("name = 3".to_owned())).contains("the world's file"));
        assert!(said(&with("#".repeat(MAX_WORLD + 1))).contains("length of the world's file"));
        assert!(said(&with(String::new())).contains("length of the world's file"));
        let alone = WorldModelConfig { world: None, ..config };
        assert!(said(&alone).contains("axes"), "a model of another kind than the cars tells its world");
    }

    #[test]
    fn models_without_a_world_are_of_a_built_in_one_or_of_one_like_it() {
        let spec = WorldModelConfig::obstacle_compact().spec();
        assert_eq!(*spec, WorldSpec::built_in("obstacle-car-racing").unwrap());
        let (spec, cars) = (WorldModelConfig::tiny().spec(), WorldSpec::built_in("car-racing").unwrap());
        assert_eq!((spec.name.as_str(), &spec.axes, &spec.events), ("dummy-road", &cars.axes, &cars.events));
        assert_eq!(spec.image.trained(), Size { height: 20, width: 20 });
        let named = WorldModelConfig { env: "car-racing".to_owned(), ..WorldModelConfig::tiny() };
        assert_eq!(named.spec().image.trained(), Size { height: 20, width: 20 });
    }

    /// Sessions name a world model by its hash: what is shipped must be read, and written, as it was.
    #[test]
    fn shipped_models_are_called_what_they_were() {
        let assets = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("assets");
        for (name, config, hash) in [
            (
                "world-car-racing",
                WorldModelConfig::car_racing(),
                "sha256:2bdf06f3c54699824265e9a3dedaa2df1f35ae06a046390c8f99fd7ec932e06a",
            ),
            (
                "world-obstacle-car-racing-compact",
                WorldModelConfig::obstacle_compact(),
                "sha256:ad2f71d4db3b7e377cf245b13cd4bab5eb9cf708e7e36c2579e8a337c6211f50",
            ),
            (
                "world-obstacle-car-racing",
                WorldModelConfig {
                    vae: VaeConfig { emphasis: 15.0, ..VaeConfig::obstacle_car_racing() },
                    ..WorldModelConfig::obstacle_car_racing()
                },
                "sha256:e8f4a68f6c449be4ff03a485489f99f2546cb5092ed2a88c07bac9ac227632ab",
            ),
        ] {
            let parameters = read_parameters(&assets.join(format!("{name}.safetensors"))).unwrap();
            let header = parameters.metadata("config").unwrap();
            let model = WorldModel::load(parameters).unwrap();
            assert_eq!(model.config(), &config);
            assert_eq!(model.hash(), hash, "{name}");
            // The first of them is from before there was an emphasis, and the last was not written by this program.
            let told = described(&config);
            let header = header.replace([' ', '\n'], "");
            assert!(told == header || told.replace(",\"emphasis\":0.0", "") == header, "{told}\n{header}");
        }
    }
}
