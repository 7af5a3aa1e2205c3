//! The random streams that decide a world: our own, and those of gym, gymnasium and Python.

use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_pcg::Pcg64;
use sha2::{Digest as _, Sha512};

use super::Seed;
use super::mersenne::{Mt19937, words};

/// Number of the `ChaCha8` stream of the track.
const TRACK_STREAM: u64 = 0;
/// Number of the `ChaCha8` stream of the obstacles.
const OBSTACLE_STREAM: u64 = 1;

/// Uniform real numbers: what a track is drawn from.
#[derive(Clone, Debug)]
pub enum UniformStream {
    /// Our own.
    Native(Box<ChaCha8Rng>),
    /// gym 0.20's `np_random` after `env.seed(n)`.
    Gym(Box<Mt19937>),
    /// gymnasium's `np_random` after `reset(seed=n)`: numpy's `default_rng(n)`.
    Gymnasium(Pcg64),
}

impl UniformStream {
    /// The stream that `seed` gives to the track.
    pub fn track(seed: Seed) -> Self {
        match seed {
            Seed::Native(n) => Self::Native(Box::new(native(n, TRACK_STREAM))),
            Seed::Gym { env, .. } => Self::Gym(Box::new(gym(env))),
            Seed::Gymnasium(n) => Self::Gymnasium(numpy(n)),
        }
    }

    /// A uniform number in `[lo, hi)`, made from 53 random bits.
    pub fn uniform(&mut self, lo: f64, hi: f64) -> f64 {
        let unit = match self {
            Self::Native(rng) => unit(rng.next_u64()),
            Self::Gym(rng) => rng.unit(),
            Self::Gymnasium(rng) => unit(rng.next_u64()),
        };
        lo + (hi - lo) * unit
    }
}

/// Uniform choices: where the chuckholes go.
#[derive(Clone, Debug)]
pub enum ChoiceStream {
    /// Our own. Also for gymnasium's seeds, which know no obstacles.
    Native(Box<ChaCha8Rng>),
    /// Python's global `random` after `random.seed(n)`.
    Python(Box<Mt19937>),
}

impl ChoiceStream {
    /// The stream that `seed` gives to the obstacles.
    pub fn obstacles(seed: Seed) -> Self {
        match seed {
            Seed::Native(n) | Seed::Gymnasium(n) => Self::Native(Box::new(native(n, OBSTACLE_STREAM))),
            Seed::Gym { python, .. } => Self::Python(Box::new(Mt19937::from_integer(python))),
        }
    }

    /// A uniform integer below `n`: the top bits of a draw, as many as `n` has, until they are below it.
    ///
    /// # Panics
    /// Where `n` is 0.
    pub fn below(&mut self, n: u32) -> u32 {
        assert!(n > 0, "nothing is below 0");
        loop {
            let bits = match self {
                Self::Native(rng) => rng.next_u32(),
                Self::Python(rng) => rng.next_u32(),
            };
            let value = bits >> n.leading_zeros();
            if value < n {
                return value;
            }
        }
    }
}

/// A uniform number in `[0, 1)` from the upper 53 bits.
fn unit(bits: u64) -> f64 {
    (bits >> 11) as f64 * (1.0 / 9_007_199_254_740_992.0)
}

/// One of the independent streams of a native seed.
fn native(seed: u64, stream: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(stream);
    rng
}

/// The generator of gym 0.20: the first eight bytes of SHA-512 of the decimal text are the key.
fn gym(seed: u64) -> Mt19937 {
    let digest = Sha512::digest(seed.to_string().as_bytes());
    let word = |i: usize| u32::from_le_bytes([digest[i], digest[i + 1], digest[i + 2], digest[i + 3]]);
    Mt19937::from_key(words(&[word(0), word(4)]))
}

/// The generator of numpy: `SeedSequence(n)` (after `O'Neill`'s `seed_seq_fe`) → `PCG64`.
fn numpy(seed: u64) -> Pcg64 {
    let mut pool = [seed as u32, (seed >> 32) as u32, 0, 0];
    let mut hash = SeedHash { constant: 0x43b0_d7e5, factor: 0x931e_8875 };
    for word in &mut pool {
        *word = hash.of(*word);
    }
    for source in 0..pool.len() {
        for destination in 0..pool.len() {
            if destination != source {
                let hashed = hash.of(pool[source]);
                pool[destination] = mix(pool[destination], hashed);
            }
        }
    }
    let mut hash = SeedHash { constant: 0x8b51_f9dd, factor: 0x58f3_8ded };
    let mut word = |i: usize| u128::from(hash.of(pool[i % pool.len()]));
    // Eight words, paired little-endian into four; of these the first is the upper half of a 128-bit number.
    let words: [u128; 8] = std::array::from_fn(&mut word);
    let pair = |i: usize| words[2 * i] | (words[2 * i + 1] << 32);
    Pcg64::new((pair(0) << 64) | pair(1), (pair(2) << 64) | pair(3))
}

/// The hash of numpy's seed sequence, whose constant changes with each use.
struct SeedHash {
    constant: u32,
    factor: u32,
}

impl SeedHash {
    fn of(&mut self, value: u32) -> u32 {
        let value = value ^ self.constant;
        self.constant = self.constant.wrapping_mul(self.factor);
        let value = value.wrapping_mul(self.constant);
        value ^ (value >> 16)
    }
}

/// Mixes a hashed word into a word of the pool.
fn mix(word: u32, hashed: u32) -> u32 {
    let mixed = 0xca01_f9dd_u32.wrapping_mul(word).wrapping_sub(0x4973_f715_u32.wrapping_mul(hashed));
    mixed ^ (mixed >> 16)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn track_and_obstacles_of_a_native_seed_are_independent() {
        let mut track = UniformStream::track(Seed::Native(3));
        let mut obstacles = ChoiceStream::obstacles(Seed::Native(3));

        let from_track: Vec<u32> = (0..8).map(|_| (track.uniform(0.0, 1.0) * 256.0) as u32).collect();
        let from_obstacles: Vec<u32> = (0..8).map(|_| obstacles.below(256)).collect();

        assert_ne!(from_track, from_obstacles);
    }

    #[test]
    fn choices_reach_every_value_below_the_bound_and_no_other() {
        let mut stream = ChoiceStream::obstacles(Seed::Native(0));
        let mut seen = [false; 5];

        for _ in 0..200 {
            seen[stream.below(5) as usize] = true;
        }

        assert_eq!(seen, [true; 5]);
    }
}
