//! The Mersenne Twister as numpy and Python seed it, so that an episode can be compared with theirs.

/// Words of state.
const N: usize = 624;
/// How far the recurrence reaches.
const M: usize = 397;

/// MT19937, seeded by `init_by_array`: Matsumoto and Nishimura, 1998, with the seeding of 2002.
#[derive(Clone, Debug)]
pub struct Mt19937 {
    state: [u32; N],
    next: usize,
}

impl Mt19937 {
    /// A generator seeded with the words of `key`, of which there is at least one.
    pub fn from_key(key: &[u32]) -> Self {
        assert!(!key.is_empty(), "a key has at least one word");
        let mut state = [0u32; N];
        state[0] = 19_650_218;
        for i in 1..N {
            state[i] = previous(&state, i).wrapping_mul(1_812_433_253).wrapping_add(i as u32);
        }
        let mut i = 1;
        for k in 0..N.max(key.len()) {
            let j = k % key.len();
            state[i] = (state[i] ^ previous(&state, i).wrapping_mul(1_664_525))
                .wrapping_add(key[j])
                .wrapping_add(j as u32);
            i = following(&mut state, i);
        }
        for _ in 1..N {
            state[i] = (state[i] ^ previous(&state, i).wrapping_mul(1_566_083_941)).wrapping_sub(i as u32);
            i = following(&mut state, i);
        }
        state[0] = 0x8000_0000;
        Self { state, next: N }
    }

    /// A generator seeded with the 32-bit words of `n`, low first, as Python's `random.seed(n)` does.
    pub fn from_integer(n: u64) -> Self {
        Self::from_key(words(&[n as u32, (n >> 32) as u32]))
    }

    /// The next 32 random bits.
    pub fn next_u32(&mut self) -> u32 {
        if self.next == N {
            self.twist();
        }
        let mut y = self.state[self.next];
        self.next += 1;
        y ^= y >> 11;
        y ^= (y << 7) & 0x9d2c_5680;
        y ^= (y << 15) & 0xefc6_0000;
        y ^ (y >> 18)
    }

    /// A uniform number in `[0, 1)` of 53 random bits.
    pub fn unit(&mut self) -> f64 {
        let high = f64::from(self.next_u32() >> 5);
        let low = f64::from(self.next_u32() >> 6);
        (high * 67_108_864.0 + low) / 9_007_199_254_740_992.0
    }

    /// Renews all words of state.
    fn twist(&mut self) {
        for i in 0..N {
            let y = (self.state[i] & 0x8000_0000) | (self.state[(i + 1) % N] & 0x7fff_ffff);
            let odd = if y & 1 == 1 { 0x9908_b0df } else { 0 };
            self.state[i] = self.state[(i + M) % N] ^ (y >> 1) ^ odd;
        }
        self.next = 0;
    }
}

/// The two words of a number, without a high word of zero.
pub(super) fn words(low_high: &[u32; 2]) -> &[u32] {
    if low_high[1] == 0 { &low_high[..1] } else { low_high }
}

/// The word before `i`, mixed.
fn previous(state: &[u32; N], i: usize) -> u32 {
    state[i - 1] ^ (state[i - 1] >> 30)
}

/// The place after `i`, going round.
fn following(state: &mut [u32; N], i: usize) -> usize {
    if i + 1 < N {
        return i + 1;
    }
    state[0] = state[N - 1];
    1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_outputs_are_those_of_the_authors_of_the_generator() {
        // mt19937ar.out: init_by_array({0x123, 0x234, 0x345, 0x456})
        let mut generator = Mt19937::from_key(&[0x123, 0x234, 0x345, 0x456]);

        let outputs: Vec<u32> = (0..3).map(|_| generator.next_u32()).collect();

        assert_eq!(outputs, [1_067_595_299, 955_945_823, 477_289_528]);
    }
}
