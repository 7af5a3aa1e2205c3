//! What a world model is called, and how wide its states are: what sessions, dreams and rewards must agree with.

use crate::tensor::{LAYOUT, Parameters};
use crate::world_model::{WorldModel, WorldModelConfig, WorldModelError};

/// By what a world model is known to whatever was made with it.
///
/// It is the hash of its file; and since a file can be stored anew in another layout, in which not a number changes, the
/// hash of the same parameters in that one as well. That is computed from the parameters, so no file can claim it.
#[derive(Clone, Debug)]
pub struct ModelIdentity {
    parameters: Parameters,
    config: WorldModelConfig,
    layout: u32,
}

impl ModelIdentity {
    /// That of the model whose networks `parameters` hold, of which only the header is read.
    pub fn of(parameters: &Parameters) -> Result<Self, WorldModelError> {
        let (layout, config) = WorldModelConfig::of(parameters)?;
        Ok(Self { parameters: parameters.clone(), config, layout })
    }

    /// The hash of its file.
    pub fn hash(&self) -> String {
        self.parameters.hash()
    }

    /// Whether this is the model that is called `hash`.
    ///
    /// The other hash is computed where the first is not it, and only once.
    pub fn is(&self, hash: &str) -> bool {
        self.parameters.hash() == hash || self.parameters.other_hash(|_| self.relaid()) == Some(hash)
    }

    /// Whether `one` and `other` call the same model, as far as that can be told: they are alike, or both call `known`.
    pub fn are_same(known: Option<&Self>, one: &str, other: &str) -> bool {
        one == other || known.is_some_and(|known| known.is(one) && known.is(other))
    }

    /// The same parameters in the other layout of the two that there are.
    pub fn relaid(&self) -> Option<Parameters> {
        self.stored_in(if self.layout == LAYOUT { 1 } else { LAYOUT })
    }

    /// The same parameters in this layout.
    fn stored_in(&self, layout: u32) -> Option<Parameters> {
        let (vae, mdn_rnn) = (self.config.vae.slots(), self.config.mdn_rnn.slots());
        let networks: [(&str, &[_]); 2] = [("vae", &vae), ("mdn_rnn", &mdn_rnn)];
        self.parameters.relaid("config", &networks, self.layout, layout)
    }

    /// The layout of its file.
    pub fn layout(&self) -> u32 {
        self.layout
    }

    /// The shapes of the networks.
    pub fn config(&self) -> &WorldModelConfig {
        &self.config
    }
}

impl WorldModel {
    /// What this model is called.
    pub fn identity(&self) -> &ModelIdentity {
        &self.identity
    }

    /// `parameters`, which must be those of a world model, in this program's layout.
    pub fn relaid(parameters: Parameters) -> Result<Parameters, WorldModelError> {
        let model = Self::load(parameters)?;
        Ok(model.identity.stored_in(LAYOUT).unwrap_or(model.parameters))
    }

    /// Whether this is the model that is called `hash`: see [`ModelIdentity::is`].
    pub fn is(&self, hash: &str) -> bool {
        self.identity.is(hash)
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;
    use tch::{Device, Kind, nn};

    use super::*;
    use crate::tensor::from_slice;
    use crate::world_model::{Layer, MdnRnn, Vae, VaeConfig, untrained};

    /// A model with layers that lie as matrices in memory.
    fn large() -> WorldModel {
        let layer = |channels| Layer { channels, kernel: 4, stride: 1, padding: 0 };
        let (encoder, decoder) = (vec![layer(290)], vec![layer(3)]);
        let vae = VaeConfig { height: 4, width: 4, encoder, decoder, ..VaeConfig::tiny() };
        let config = WorldModelConfig { vae, ..WorldModelConfig::tiny() };
        untrained(&config, &mut ChaCha8Rng::seed_from_u64(0))
    }

    #[test]
    fn a_model_in_another_layout_is_the_same_model() {
        let model = large();
        let earlier = model.identity().relaid().unwrap();
        assert_ne!(earlier.hash(), model.hash());
        assert!(model.is(&model.hash()) && model.is(&earlier.hash()) && !model.is("sha256:00"));
        assert_eq!(earlier.tensor("vae.conv1.weight").unwrap().size(), [48, 290], "as it lies in memory");
        assert_eq!(model.parameters().tensor("vae.conv1.weight").unwrap().size(), [290, 3, 4, 4]);

        let known = Some(model.identity());
        assert!(ModelIdentity::are_same(known, &model.hash(), &earlier.hash()));
        assert!(ModelIdentity::are_same(None, "sha256:00", "sha256:00"));
        assert!(!ModelIdentity::are_same(None, &model.hash(), &earlier.hash()), "who knows?");
        assert!(!ModelIdentity::are_same(known, &model.hash(), "sha256:00"));

        let again = WorldModel::load(earlier).unwrap();
        assert_eq!((again.identity().layout(), model.identity().layout()), (1, LAYOUT));
        assert!(again.is(&model.hash()), "either way");
        let z = from_slice(&[0.3, -0.2, 0.9, 0.1], &[1, 4]);
        assert_eq!(again.decode(&z), model.decode(&z));
    }

    /// What the file must hold is told before networks are made, and so apart from how they are made.
    #[test]
    fn networks_have_the_parameters_that_are_told_of_them() {
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        for config in
            [WorldModelConfig::tiny(), WorldModelConfig::car_racing(), WorldModelConfig::obstacle_compact()]
        {
            assert_eq!(config.check(), Ok(()));
            let (vision, memory) = (nn::VarStore::new(Device::Cpu), nn::VarStore::new(Device::Cpu));
            Vae::new(&vision.root(), config.vae.clone(), Kind::Float, rng);
            MdnRnn::new(&memory.root(), config.mdn_rnn.clone(), rng);
            for (store, slots) in [(vision, config.vae.slots()), (memory, config.mdn_rnn.slots())] {
                let variables = store.variables();
                assert_eq!(variables.len(), slots.len());
                for slot in &slots {
                    assert_eq!(variables[&slot.name].size(), slot.shape_in_memory(), "{}", slot.name);
                }
            }
        }
        assert_eq!(WorldModelConfig::obstacle_car_racing().check(), Ok(()));
    }

    #[test]
    fn a_model_with_another_number_in_it_is_another() {
        let model = large();
        let earlier = model.identity().relaid().unwrap().hash();
        let bias = model.parameters().tensor("mdn_rnn.head.bias").unwrap() + 1e-3;
        let changed = model.parameters().with([("mdn_rnn.head.bias".to_owned(), bias)]);
        assert!(!WorldModel::load(changed).unwrap().is(&earlier));
    }
}
