//! Where a strain falls in the stretching table: principal stretch and principal angle (reference note, 2.1).

use crate::angle::quarter_angle;
use crate::chunk::clamp;
use caphy_core::Real;

/// The last segment stays half open, as in the shipped evaluation.
const OPEN: f64 = 1e-6;

/// Principal strains closer than this count as equal: the angle then has no derivative.
const EQUAL: f64 = 1e-12;

/// Coordinates of a strain in the stretching table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SamplePoint<T> {
    /// Weight t of the stretched rows, in [0, 1): 0 unstretched or compressed, 1 at stretch 7/6 and above.
    pub(crate) stretch: T,
    /// Angle coordinate p in [0, 4): 8/π times the angle between u and the direction of largest stretch.
    pub(crate) angle: T,
}

/// Derivatives of a [`SamplePoint`] by (Guu, Gvv, Guv).
pub(crate) struct SampleSlope<T> {
    pub(crate) stretch: [T; 3],
    pub(crate) angle: [T; 3],
}

/// Difference of the normal strains and of the principal strains, (d, r).
#[inline(always)]
fn principal<T: Real>(guu: T, gvv: T, guv: T) -> (T, T) {
    let d = guu - gvv;
    (d, (d * d + T::of(4.0) * guv * guv).sqrt())
}

/// Coordinates of the strain (Guu, Gvv, Guv); the sign of Guv is folded away.
///
/// Equal principal strains have angle 0. No strain, however unphysical, gives NaN.
#[inline(always)]
pub(crate) fn sample_point<T: Real>(guu: T, gvv: T, guv: T) -> SamplePoint<T> {
    let (d, r) = principal(guu, gvv, guv);
    let largest = T::one() + guu + gvv + r;
    let largest = if largest > T::zero() { largest } else { T::zero() };
    let stretch = clamp(T::of(6.0) * (largest.sqrt() - T::one()), T::zero(), T::of(1.0 - OPEN));
    let shear = T::of(2.0) * guv.abs();
    // atan2(shear, d + r); for d < 0 the same angle without the cancellation in d + r.
    let (y, x) = if d < T::zero() { (r - d, shear) } else { (shear, d + r) };
    let angle = clamp(quarter_angle(y, x) * T::of(8.0 / std::f64::consts::PI), T::zero(), T::of(4.0 - OPEN));
    SamplePoint { stretch, angle }
}

/// Derivatives of [`sample_point`], zero where a coordinate is clamped, where Guv = 0 (mean of both sides) and, for the
/// angle, at equal principal strains, where it jumps.
#[inline(always)]
pub(crate) fn sample_slope<T: Real>(guu: T, gvv: T, guv: T) -> SampleSlope<T> {
    let (d, r) = principal(guu, gvv, guv);
    let mut slope = SampleSlope { stretch: [T::zero(); 3], angle: [T::zero(); 3] };
    let largest = T::one() + guu + gvv + r;
    let distinct = r > T::of(EQUAL);
    if largest > T::zero() {
        let raw = T::of(6.0) * (largest.sqrt() - T::one());
        if raw > T::zero() && raw < T::of(1.0 - OPEN) {
            let outer = T::of(3.0) / largest.sqrt();
            let tilt = if distinct { d / r } else { T::zero() };
            let shear = if distinct { T::of(4.0) * guv / r } else { T::zero() };
            slope.stretch = [outer * (T::one() + tilt), outer * (T::one() - tilt), outer * shear];
        }
    }
    if distinct {
        // angle = ½ atan2(2|Guv|, d)
        let outer = T::of(8.0 / std::f64::consts::PI);
        let (sine, cosine) = (guv / r, d / r);
        let sign = if guv > T::zero() {
            T::one()
        } else if guv < T::zero() {
            -T::one()
        } else {
            T::zero()
        };
        let by_difference = -outer * sine.abs() / r;
        slope.angle = [by_difference, -by_difference, outer * sign * cosine / r];
    }
    slope
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn named_points() {
        let rest = sample_point(0.0, 0.0, 0.0);
        assert_eq!((rest.stretch, rest.angle), (0.0, 0.0));
        // Stretch 7/6 along u and along v, and at 45°.
        let g = 0.5 * (49.0 / 36.0 - 1.0);
        let along_u: SamplePoint<f64> = sample_point(g, 0.0, 0.0);
        assert!((along_u.stretch - 1.0).abs() < 2e-6 && along_u.angle == 0.0);
        assert!((sample_point(0.0, g, 0.0).angle - 4.0f64).abs() < 2e-6);
        assert!((sample_point(g / 2.0, g / 2.0, -g / 2.0).angle - 2.0f64).abs() < 1e-12);
        // Equal principal strains: angle 0 by definition.
        assert_eq!(sample_point(0.1, 0.1, 0.0).angle, 0.0);
        // Compression uses row 0.
        assert_eq!(sample_point(-0.1, -0.2, 0.01).stretch, 0.0);
    }

    #[test]
    fn slopes_agree_with_differences() {
        let h = 1e-6;
        for g in [[0.05, 0.01, 0.02], [0.01, 0.06, -0.03], [-0.05, 0.1, 0.02], [0.08, 0.07, -0.001]] {
            let slope = sample_slope(g[0], g[1], g[2]);
            for c in 0..3 {
                let at = |step: f64| {
                    let mut moved: [f64; 3] = g;
                    moved[c] += step;
                    sample_point(moved[0], moved[1], moved[2])
                };
                let (plus, minus) = (at(h), at(-h));
                let stretch = (plus.stretch - minus.stretch) / (2.0 * h);
                let angle = (plus.angle - minus.angle) / (2.0 * h);
                // Third derivative of the angle grows as 1/r³, r ≥ 0.01: h² / r³ ≈ 1e-6, relative to a slope of 1/r.
                assert!((stretch - slope.stretch[c]).abs() < 1e-6 * 6.0, "{g:?} {c}");
                assert!((angle - slope.angle[c]).abs() < 1e-4 * (1.0 + angle.abs()), "{g:?} {c}: {angle}");
            }
        }
    }
}
