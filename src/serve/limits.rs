//! How often somebody may ask: a bucket of tries that fills again at a steady rate, for each address and each token.

use std::collections::HashMap;
use std::hash::Hash;
use std::net::IpAddr;
use std::time::Instant;

/// So many addresses are remembered. Where more come, those that have been quiet are forgotten.
const MOST: usize = 4096;

/// How many at once, and how many a second after that.
#[derive(Clone, Copy, Debug)]
pub struct Rate {
    /// At once.
    pub burst: f64,
    /// A second.
    pub per_sec: f64,
}

/// What is allowed.
#[derive(Clone, Copy, Debug)]
pub struct Rates {
    /// Requests of one address: several may sit behind it.
    pub address: Rate,
    /// Requests with one token. A page asks for some fifty clips as it begins, and three times an answer.
    pub token: Rate,
}

impl Default for Rates {
    fn default() -> Self {
        Self { address: Rate { burst: 600.0, per_sec: 100.0 }, token: Rate { burst: 200.0, per_sec: 30.0 } }
    }
}

/// What is left of a burst, and as of when.
#[derive(Debug)]
struct Bucket {
    left: f64,
    at: Instant,
}

/// A bucket for each of many.
#[derive(Debug)]
struct Buckets<K> {
    rate: Rate,
    each: HashMap<K, Bucket>,
}

impl<K: Eq + Hash> Buckets<K> {
    fn new(rate: Rate) -> Self {
        Self { rate, each: HashMap::new() }
    }

    /// Whether one more is allowed at `now`; it counts where it is.
    fn take(&mut self, who: K, now: Instant) -> bool {
        let Rate { burst, per_sec } = self.rate;
        let filled = |bucket: &Bucket| {
            let secs = now.saturating_duration_since(bucket.at).as_secs_f64();
            (bucket.left + secs * per_sec).min(burst)
        };
        if self.each.len() >= MOST && !self.each.contains_key(&who) {
            self.each.retain(|_, bucket| filled(bucket) < burst);
            if self.each.len() >= MOST {
                return false;
            }
        }
        let bucket = self.each.entry(who).or_insert(Bucket { left: burst, at: now });
        (bucket.left, bucket.at) = (filled(bucket), now);
        let is_allowed = bucket.left >= 1.0;
        bucket.left -= f64::from(u8::from(is_allowed));
        is_allowed
    }
}

/// Who asked how often.
#[derive(Debug)]
pub(super) struct Limits {
    addresses: Buckets<IpAddr>,
    annotators: Buckets<usize>,
}

impl Limits {
    pub(super) fn new(rates: Rates) -> Self {
        Self { addresses: Buckets::new(rates.address), annotators: Buckets::new(rates.token) }
    }

    /// Whether this address may ask once more.
    pub(super) fn take_address(&mut self, address: IpAddr, now: Instant) -> bool {
        self.addresses.take(address, now)
    }

    /// Whether the annotator of this number may.
    pub(super) fn take_annotator(&mut self, annotator: usize, now: Instant) -> bool {
        self.annotators.take(annotator, now)
    }
}

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_burst_is_allowed_and_then_a_steady_rate_to_each() {
        let mut buckets = Buckets::new(Rate { burst: 5.0, per_sec: 2.0 });
        let began = Instant::now();
        let mut n = |who: u32, millis| {
            let now = began + Duration::from_millis(millis);
            (0..100).filter(|_| buckets.take(who, now)).count()
        };
        assert_eq!((n(1, 0), n(1, 0), n(2, 0)), (5, 0, 5));
        assert_eq!((n(1, 1000), n(1, 1400), n(1, 1500)), (2, 0, 1));
        assert_eq!(n(1, 1_000_000), 5, "no more than a burst is saved up");
    }

    #[test]
    fn memory_stays_flat_however_many_addresses_come() {
        let mut limits = Limits::new(Rates::default());
        let began = Instant::now();
        let address = |n: u32| IpAddr::V4(Ipv4Addr::from(n));
        let n_taken = (0..10_000).filter(|n| limits.take_address(address(*n), began)).count();
        assert_eq!((n_taken, limits.addresses.each.len()), (MOST, MOST));
        assert!(
            limits.take_address(address(20_000), began + Duration::from_mins(1)),
            "the quiet ones are forgotten"
        );
        assert_eq!(limits.addresses.each.len(), 1);
    }
}
