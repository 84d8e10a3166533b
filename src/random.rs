//! Random numbers from a generator's own words, so that a seed means the same values whatever the version of a library.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::Rng;
use std::f64::consts::TAU;

/// A number in [a, b).
pub(crate) fn uniform(rng: &mut ChaCha8Rng, a: f64, b: f64) -> f64 {
    a + (b - a) * (rng.next_u64() >> 11) as f64 / (1u64 << 53) as f64
}

/// A standard normal number (Box-Muller).
pub(crate) fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let (u, v) = (uniform(rng, f64::MIN_POSITIVE, 1.0), uniform(rng, 0.0, TAU));
    (-2.0 * u.ln()).sqrt() * v.cos()
}
