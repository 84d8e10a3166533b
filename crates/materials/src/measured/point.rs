//! Stiffness straight from the published table at any strain (reference note, 2.1): what the 30³ table samples, and a
//! lookup of its own (`lookup = "direct"`).

use super::fabrics::{STRETCH_COLUMNS, STRETCH_ROWS, StretchEntries};
use super::membrane::{Jet, Lookup, Rule, Stiffness, Weights, WeightsJet, answer};
use super::sample_point::{SamplePoint, sample_point, sample_slope};
use crate::chunk::{CHUNK, Row, index};
use caphy_core::material::MembraneBlock;
use caphy_core::{Real, simd_kernel};

/// Twice the raw entries at a sample point, clamped: the point evaluation of the reference note, 2.1.
#[inline(always)]
pub(super) fn stiffness_at<T: Real>(doubled: &[[T; 4]; STRETCH_ROWS], point: SamplePoint<T>) -> [T; 4] {
    let whole = point.angle.floor();
    let fraction = point.angle - whole;
    let row = index(whole);
    let (low, high) = (&doubled[row + 1], &doubled[row + 2]);
    let mut k = [T::zero(); 4];
    for a in 0..4 {
        let stretched = low[a] + fraction * (high[a] - low[a]);
        let raw = doubled[0][a] + point.stretch * (stretched - doubled[0][a]);
        k[a] = if raw > T::zero() { raw } else { T::zero() };
    }
    k
}

/// Adds `share` times the influence of every entry at a sample point, where `active`.
#[inline(always)]
pub(super) fn add_weights<T: Real>(point: SamplePoint<T>, share: T, active: [bool; 4], out: &mut Weights<T>) {
    let whole = point.angle.floor();
    let fraction = point.angle - whole;
    let row = index(whole);
    let share = T::of(2.0) * share;
    for (a, active) in active.into_iter().enumerate() {
        if active {
            out[0][a] += share * (T::one() - point.stretch);
            out[row + 1][a] += share * point.stretch * (T::one() - fraction);
            out[row + 2][a] += share * point.stretch * fraction;
        }
    }
}

/// Twice every entry: the factor that turns raw entries into stiffness.
pub(super) fn doubled(entries: &StretchEntries) -> [[f64; STRETCH_COLUMNS]; STRETCH_ROWS] {
    entries.map(|row| row.map(|c| 2.0 * c))
}

/// Point evaluation as a lookup.
#[derive(Clone, Copy)]
pub(super) struct PointLookup<T> {
    doubled: [[T; 4]; STRETCH_ROWS],
}

impl<T: Real> PointLookup<T> {
    /// From raw entries [N/m].
    pub(super) fn new(entries: &StretchEntries) -> Self {
        Self { doubled: doubled(entries).map(|row| row.map(T::of)) }
    }
}

impl<T: Real> Lookup<T> for PointLookup<T> {
    #[inline(always)]
    fn stiffness(&self, green: &[Row<T>; 3], out: &mut Stiffness<T>) {
        let mut stretch = [T::zero(); CHUNK];
        let mut angle = [T::zero(); CHUNK];
        for i in 0..CHUNK {
            let point = sample_point(green[0][i], green[1][i], green[2][i]);
            stretch[i] = point.stretch;
            angle[i] = point.angle;
        }
        for i in 0..CHUNK {
            out[i] = stiffness_at(&self.doubled, SamplePoint { stretch: stretch[i], angle: angle[i] });
        }
    }

    #[inline(always)]
    fn jet(&self, green: [T; 3]) -> Jet<T> {
        let point = sample_point(green[0], green[1], green[2]);
        let slope = sample_slope(green[0], green[1], green[2]);
        let whole = point.angle.floor();
        let fraction = point.angle - whole;
        let row = index(whole);
        let zero = [T::zero(); 4];
        // The second derivatives are not offered: a full gradient is only built on the table.
        let mut jet = Jet { value: stiffness_at(&self.doubled, point), slope: [zero; 3], mixed: [zero; 3] };
        for a in 0..4 {
            if jet.value[a] > T::zero() {
                let (low, high) = (self.doubled[row + 1][a], self.doubled[row + 2][a]);
                let by_stretch = low + fraction * (high - low) - self.doubled[0][a];
                let by_angle = point.stretch * (high - low);
                for c in 0..3 {
                    jet.slope[c][a] = by_stretch * slope.stretch[c] + by_angle * slope.angle[c];
                }
            }
        }
        jet
    }

    #[inline(always)]
    fn weights(&self, green: [T; 3]) -> WeightsJet<T> {
        let point = sample_point(green[0], green[1], green[2]);
        let zero = [[T::zero(); STRETCH_COLUMNS]; STRETCH_ROWS];
        let mut weights = WeightsJet { value: zero, slope: [zero; 3] };
        let active = stiffness_at(&self.doubled, point).map(|k| k > T::zero());
        add_weights(point, T::one(), active, &mut weights.value);
        weights
    }
}

simd_kernel! {
    /// Answers a checked block by point evaluation.
    pub(super) fn membrane_by_point<T>(lookup: PointLookup<T>, rule: Rule, block: &mut MembraneBlock<'_, T>) {
        answer(&lookup, rule, block);
    }
}
