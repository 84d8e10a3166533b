//! How sure a difference is: intervals by drawing scans again.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use serde::{Deserialize, Serialize};

/// A value with the interval in which 95 % of the draws lie.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// The value itself.
    pub value: f64,
    /// The interval's ends; none for a single scan.
    pub interval: Option<[f64; 2]>,
}

/// Number of draws.
const DRAWS: usize = 4000;

/// Ratio of two means minus 1, of values that belong together pair by pair (one scan, one seed): pairs are drawn with replacement.
///
/// It tells what other scans of these people would change, not what other people or other trainings would: those only several seeds show.
/// NaN for lists of other lengths, empty ones, or a mean of 0.
pub fn ratio_interval(values: &[f64], against: &[f64]) -> Interval {
    let count = values.len();
    if count == 0 || count != against.len() {
        return Interval { value: f64::NAN, interval: None };
    }
    let ratio = |pick: &mut dyn FnMut(usize) -> usize| {
        let (mut a, mut b) = (0.0, 0.0);
        for i in 0..count {
            let i = pick(i);
            a += values[i];
            b += against[i];
        }
        if b == 0.0 { f64::NAN } else { a / b - 1.0 }
    };
    let value = ratio(&mut |i| i);
    if count < 2 || !value.is_finite() {
        return Interval { value, interval: None };
    }
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut draws: Vec<f64> = (0..DRAWS)
        .map(|_| ratio(&mut |_| (rng.next_u64() % count as u64) as usize))
        .filter(|r| r.is_finite())
        .collect();
    draws.sort_by(f64::total_cmp);
    let at = |share: f64| draws[((draws.len() - 1) as f64 * share).round() as usize];
    Interval { value, interval: (!draws.is_empty()).then(|| [at(0.025), at(0.975)]) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::normal;

    #[test]
    fn pairs_are_drawn_together() {
        // Every scan is 10 % worse, however different scans are: nothing is unsure.
        let against = [1.0, 5.0, 20.0, 3.0];
        let worse = against.map(|v| 1.1 * v);
        let Interval { value, interval } = ratio_interval(&worse, &against);
        let [low, high] = interval.unwrap();
        assert!([value, low, high].iter().all(|v| (v - 0.1).abs() < 1e-12), "{value} {low} {high}");
        assert_eq!(ratio_interval(&[2.0], &[1.0]), Interval { value: 1.0, interval: None });
        assert!(ratio_interval(&[], &[]).value.is_nan() && ratio_interval(&[1.0], &[0.0]).value.is_nan());
        assert_eq!(ratio_interval(&worse, &against), ratio_interval(&worse, &against));
    }

    #[test]
    fn intervals_hold_the_truth_as_often_as_they_say() {
        // Pairs with 20 % of scatter about a ratio of 1.3.
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let (trials, scans) = (300, 30);
        let mut held = 0;
        for _ in 0..trials {
            let against: Vec<f64> = (0..scans).map(|_| 10.0 + normal(&mut rng)).collect();
            let values: Vec<f64> = against.iter().map(|a| a * (1.3 + 0.2 * normal(&mut rng))).collect();
            let [low, high] = ratio_interval(&values, &against).interval.unwrap();
            held += usize::from((low..=high).contains(&0.3));
        }
        // 95 % of 300 are 285 ± 4; the percentile interval of 30 pairs is a little narrow (about 93 %).
        assert!((265..=297).contains(&held), "{held} of {trials}");
    }
}
