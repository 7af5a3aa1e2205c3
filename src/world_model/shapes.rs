//! Which networks suit a world.

use crate::world::{Size, WorldSpec};
use crate::world_model::vae::VaeConfig;
use crate::world_model::{MdnRnnConfig, WorldModelConfig};

/// Pixels a side up to which a picture is small: that of the paper's Car Racing.
const SMALL: u32 = 84;
/// A picture is halved until its smaller side is below so many pixels, as one of 128 is to 4.
const BOTTOM: i64 = 8;
/// The fewest and the most halvings.
const HALVINGS: [usize; 2] = [2, 6];
/// What the first layer may have, the best first.
const FIRST_CHANNELS: [i64; 7] = [32, 24, 16, 12, 8, 6, 4];
/// The most channels of a layer, unless the first was told to have more.
const MAX_CHANNELS: i64 = 512;
/// Multiplications that vision may take for a picture to be encoded and decoded. Compact obstacle networks take 70 million.
const MAX_WORK: i64 = 100_000_000;
/// Parameters that vision may have. Compact obstacle networks have 2.2 million, the paper's of Car Racing 3.3 million.
const MAX_PARAMETERS: i64 = 4_000_000;

impl WorldModelConfig {
    /// The networks for `spec`, by a rule.
    ///
    /// | pictures | vision | memory |
    /// |---|---|---|
    /// | 84 x 84, three axes | the paper's for Car Racing | the same |
    /// | 128 x 128 | the compact ones for obstacles | 64 latents, 256 cells |
    /// | at most 84 x 84 | halvings, 32 latents, 0.5 free bits | 256 cells |
    /// | larger | halvings, 64 latents, 2 free bits | 512 cells |
    ///
    /// - **Halvings**: convolutions with a kernel of 4, a stride of 2 and a padding of 1, as many as bring the smaller side
    ///   below 8 pixels, though at least 2 and at most 6; and as many transposed ones, which paint exactly the size of
    ///   the picture (see [`VaeConfig`]).
    /// - **Channels**: the first layer has 32, each further one twice as many up to 512. Where vision would then take more
    ///   than 100 million multiplications for a picture, or have more than 4 million parameters, so that two cores could no
    ///   longer train it in a night, it has 24, 16, 12, 8, 6 or 4: the first that fits, or 4.
    /// - **Mixtures** have 5 Gaussians everywhere.
    /// - **Emphasis**: the built-in worlds with obstacles weigh blue and yellow, as the models that are shipped do. All
    ///   others that are not built in weigh what is rare in their recordings, by `fitting.emphasis` of the world's file: 1
    ///   if not given.
    /// - `networks` in the world's file overrides latents, cells, Gaussians and the channels of the first layer.
    ///
    /// The rate takes no part: it only decides how many steps are [fitted](crate::world_model::fit::FitConfig::for_world)
    /// at once.
    pub fn for_world(spec: &WorldSpec) -> Self {
        let Size { height, width } = spec.image.trained();
        let (sides, n_axes) = ([i64::from(height), i64::from(width)], spec.axes.len() as i64);
        let is_small = height.max(width) <= SMALL;
        let is_built_in = WorldSpec::built_in(&spec.name).as_ref() == Some(spec);
        let told = &spec.networks;
        let number = |told: Option<usize>, usual: i64| told.map_or(usual, |told| told as i64);
        let latent = number(told.latent, if is_small { 32 } else { 64 });
        let channels = told.channels.map(|channels| channels as i64);
        let vae = match sides {
            [84, 84] if n_axes == 3 => VaeConfig::paper(channels.unwrap_or(24)),
            [128, 128] => halved(sides, latent, channels.or(Some(16))),
            sides => halved(sides, latent, channels),
        };
        let compact = VaeConfig::obstacle_compact();
        let emphasis = if is_built_in && sides == compact.sides() { compact.emphasis } else { 0.0 };
        let rarity = if is_built_in { 0.0 } else { spec.fitting.emphasis.unwrap_or(1.0) };
        let free_bits = if is_small { 0.5 } else { 2.0 };
        let memory = if is_small || sides == compact.sides() { 256 } else { 512 };
        let mdn_rnn = MdnRnnConfig {
            latent,
            memory: number(told.memory, memory),
            components: number(told.components, 5),
            actions: n_axes,
        };
        let vae = VaeConfig { latent, free_bits, emphasis, rarity, ..vae };
        Self { env: String::new(), world: None, vae, mdn_rnn }.of_world(spec)
    }
}

/// A network of halvings for pictures of these sides; the first layer's channels by the rule where they are not told.
fn halved(sides: [i64; 2], latent: i64, first: Option<i64>) -> VaeConfig {
    let smaller = sides[0].min(sides[1]);
    let n = (0..HALVINGS[1]).find(|n| smaller >> n < BOTTOM).unwrap_or(HALVINGS[1]).max(HALVINGS[0]);
    let of = |first: i64| {
        let channels: Vec<_> = (0..n).map(|i| (first << i).min(MAX_CHANNELS.max(first))).collect();
        VaeConfig { latent, ..VaeConfig::halving(sides, &channels) }
    };
    if let Some(first) = first {
        return of(first);
    }
    let fits = |config: &VaeConfig| config.work() <= MAX_WORK && config.n_parameters() <= MAX_PARAMETERS;
    FIRST_CHANNELS.into_iter().map(of).find(fits).unwrap_or_else(|| of(4))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::world::{Axis, ImageSpec, NetworkOverrides, PlannerSpec};

    /// A world that is not built in, which shows such pictures and has so many axes.
    fn spec(height: u32, width: u32, n_axes: usize) -> WorldSpec {
        let like = WorldSpec::built_in("car-racing").unwrap();
        let axis = |i| Axis { name: format!("joint {i}"), keys: vec![], pad: vec![], ..like.axes[0].clone() };
        WorldSpec {
            name: "arm".to_owned(),
            image: ImageSpec { height, width, ..ImageSpec::default() },
            axes: (0..n_axes).map(axis).collect(),
            planner: PlannerSpec::default(),
            ..like.clone()
        }
    }

    /// Halvings, the channels of the first layer, latents and cells for pictures of this size.
    fn sizes(height: u32, width: u32) -> (usize, i64, i64, i64) {
        let config = WorldModelConfig::for_world(&spec(height, width, 4));
        assert_eq!(config.check(), Ok(()), "{height} x {width}");
        let vae = &config.vae;
        (vae.encoder.len(), vae.encoder[0].channels, vae.latent, config.mdn_rnn.memory)
    }

    #[test]
    fn built_in_worlds_have_the_networks_that_they_always_had() {
        let of = |name: &str| WorldModelConfig::for_world(&WorldSpec::built_in(name).unwrap());
        assert_eq!(of("car-racing"), WorldModelConfig::car_racing());
        assert_eq!(of("obstacle-car-racing"), WorldModelConfig::obstacle_compact());
        let chuckholes = "obstacle-car-racing-chuckholes".to_owned();
        let wanted = WorldModelConfig { env: chuckholes.clone(), ..WorldModelConfig::obstacle_compact() };
        assert_eq!(of(&chuckholes), wanted);
    }

    #[test]
    fn other_worlds_of_these_sizes_have_the_same_networks_and_weigh_what_is_rare() {
        let paper = WorldModelConfig::for_world(&spec(84, 84, 3));
        assert_eq!(paper.vae, VaeConfig { rarity: 1.0, ..VaeConfig::car_racing() });
        assert_eq!(paper.mdn_rnn, MdnRnnConfig::car_racing());
        let compact = WorldModelConfig::for_world(&spec(128, 128, 7));
        assert_eq!(compact.vae, VaeConfig { rarity: 1.0, emphasis: 0.0, ..VaeConfig::obstacle_compact() });
        assert_eq!(compact.mdn_rnn, MdnRnnConfig { actions: 7, ..MdnRnnConfig::obstacle_compact() });
    }

    #[test]
    fn networks_follow_from_the_size_of_the_pictures() {
        for (size, wanted) in [
            ((8, 8), (2, 32, 32, 256)),
            ((48, 64), (3, 32, 32, 256)),
            ((60, 80), (3, 32, 32, 256)),
            ((64, 64), (4, 32, 32, 256)),
            ((84, 84), (4, 32, 32, 256)),
            ((96, 96), (4, 24, 64, 512)),
            ((97, 33), (3, 32, 64, 512)),
            ((120, 160), (4, 16, 64, 512)),
            ((240, 320), (5, 8, 64, 512)),
            ((480, 640), (6, 4, 64, 512)),
            ((1024, 1024), (6, 4, 64, 512)),
        ] {
            assert_eq!(sizes(size.0, size.1), wanted, "{size:?}");
        }
    }

    #[test]
    fn a_worlds_file_overrides_the_rule() {
        let networks =
            NetworkOverrides { latent: Some(20), memory: Some(100), components: Some(3), channels: Some(10) };
        for (height, width, n_axes, n_layers) in [(84, 84, 3, 5), (128, 128, 3, 5), (60, 80, 4, 3)] {
            let mut spec = WorldSpec { networks: networks.clone(), ..spec(height, width, n_axes) };
            spec.fitting.emphasis = Some(0.0);
            let config = WorldModelConfig::for_world(&spec);
            assert_eq!(config.check(), Ok(()));
            let wanted = MdnRnnConfig { latent: 20, memory: 100, components: 3, actions: n_axes as i64 };
            assert_eq!(config.mdn_rnn, wanted);
            assert_eq!((config.vae.latent, config.vae.rarity), (20, 0.0));
            let channels: Vec<_> = config.vae.encoder.iter().map(|layer| layer.channels).collect();
            assert_eq!(channels, [10, 20, 40, 80, 160][..n_layers]);
        }
    }

    #[test]
    fn work_and_parameters_are_counted_as_they_are() {
        assert_eq!(VaeConfig::car_racing().n_parameters(), 3_337_747);
        assert_eq!(VaeConfig::obstacle_compact().n_parameters(), 2_185_571);
        // One pixel: three colors to two, those to a latent of two numbers and back, two to three colors.
        let layer = |channels| crate::world_model::Layer { channels, kernel: 1, stride: 1, padding: 0 };
        let (encoder, decoder) = (vec![layer(2)], vec![layer(3)]);
        let one = VaeConfig { height: 1, width: 1, latent: 1, encoder, decoder, ..VaeConfig::tiny() };
        assert_eq!(one.work(), 3 * 2 + 3 * 2 + 2 * 3);
    }

    proptest! {
        #[test]
        fn pictures_of_every_size_have_networks_within_bounds(height in 8u32..=1024, width in 8u32..=1024) {
            let config = WorldModelConfig::for_world(&spec(height, width, 4));
            // That they paint this very size is part of it.
            prop_assert_eq!(config.check(), Ok(()));
            let vae = &config.vae;
            let is_least = vae.encoder[0].channels == 4;
            prop_assert!(is_least || (vae.work() <= MAX_WORK && vae.n_parameters() <= MAX_PARAMETERS));
            prop_assert!(vae.n_parameters() <= 20_000_000 && vae.work() <= 1_000_000_000, "{vae:?}");
        }
    }
}
