//! First parameter values from a seed.

use caphy_core::net::NetManifest;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Uniform values in ±bound, one bound per tensor; a bound of 0 gives zeros.
///
/// The draws are made from the generator's 64-bit words directly, so that a seed means the same values whatever the
/// version of a distribution library.
pub(crate) fn uniform(manifest: &NetManifest, seed: u64, bounds: &[f64]) -> Vec<f64> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut values = Vec::with_capacity(manifest.parameter_count());
    for (tensor, &bound) in manifest.tensors.iter().zip(bounds) {
        if bound == 0.0 {
            values.resize(values.len() + tensor.len(), 0.0);
            continue;
        }
        for _ in 0..tensor.len() {
            // 53 random bits: a whole number below 2⁵³, scaled to [0, 1).
            let unit = (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
            values.push(bound * (2.0 * unit - 1.0));
        }
    }
    values
}
