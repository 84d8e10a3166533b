//! The angle of a direction folded into the first quadrant, as plain arithmetic that vectorises.

use caphy_core::Real;

/// tan(π/8): beyond it the ratio is folded at 45° so that the polynomial's argument stays small.
const FOLD: f64 = 0.414_213_562_373_095_05;

/// (atan(x)/x − 1)/x² as a polynomial in x² for |x| ≤ tan(π/8): Chebyshev fits, largest error 5e-10 (enough for f32).
const SINGLE: [f64; 6] = [
    -0.333_333_332_792_548,
    0.199_999_772_586_883_86,
    -0.142_841_511_936_286_14,
    0.110_713_650_218_847_94,
    -0.086_246_761_452_494_94,
    0.050_481_385_120_797_44,
];

/// As [`SINGLE`], largest error 2e-18 (f64).
const DOUBLE: [f64; 12] = [
    -0.333_333_333_333_333_3,
    0.199_999_999_999_998_05,
    -0.142_857_142_856_598_28,
    0.111_111_111_051_554_47,
    -0.090_909_087_535_008_77,
    0.076_922_963_750_321_42,
    -0.066_664_248_857_382_55,
    0.058_789_289_978_347_75,
    -0.052_304_542_706_502_45,
    0.045_515_932_206_265_49,
    -0.034_570_561_981_427_747,
    0.016_285_756_855_221_03,
];

/// atan(small / large) in [0, π/4] for 0 ≤ small ≤ large; 0 when both are 0. No branch, no call: it stays inside vector loops.
#[inline(always)]
pub(crate) fn eighth_angle<T: Real>(small: T, large: T) -> T {
    let folded = small > large * T::of(FOLD);
    let numerator = if folded { small - large } else { small };
    let denominator = if folded { small + large } else { large };
    let ratio = numerator / if denominator > T::zero() { denominator } else { T::one() };
    let square = ratio * ratio;
    let mut sum = T::zero();
    if size_of::<T>() == 4 {
        for c in SINGLE.iter().rev() {
            sum = sum * square + T::of(*c);
        }
    } else {
        for c in DOUBLE.iter().rev() {
            sum = sum * square + T::of(*c);
        }
    }
    let angle = ratio + ratio * square * sum;
    if folded { angle + T::of(std::f64::consts::FRAC_PI_4) } else { angle }
}

/// atan2(y, x) in [0, π/2] for y, x ≥ 0; 0 when both are 0.
#[inline(always)]
pub(crate) fn quarter_angle<T: Real>(y: T, x: T) -> T {
    let steep = y > x;
    let (small, large) = if steep { (x, y) } else { (y, x) };
    let angle = eighth_angle(small, large);
    if steep { T::of(std::f64::consts::FRAC_PI_2) - angle } else { angle }
}

#[cfg(test)]
mod tests {
    use super::quarter_angle;

    #[test]
    fn agrees_with_the_library() {
        for i in 0..=2000 {
            let (y, x) = (f64::from(i) * 0.37, f64::from(2000 - i) * 1.21);
            let want = y.atan2(x);
            assert!((quarter_angle(y, x) - want).abs() <= 4.0 * f64::EPSILON, "{y} {x}");
            let single = quarter_angle(y as f32, x as f32);
            assert!((f64::from(single) - want).abs() <= 4.0 * f64::from(f32::EPSILON), "{y} {x}");
        }
    }

    #[test]
    fn exact_at_the_axes_and_finite_at_the_extremes() {
        assert_eq!(quarter_angle(0.0, 0.0), 0.0);
        assert_eq!(quarter_angle(0.0, 3.0), 0.0);
        assert_eq!(quarter_angle(3.0, 0.0), std::f64::consts::FRAC_PI_2);
        assert_eq!(quarter_angle(3.0, 3.0), std::f64::consts::FRAC_PI_4);
        for y in [0.0f32, 1e-45, 1e-20, 1.0, 3e38] {
            for x in [0.0f32, 1e-45, 1e-20, 1.0, 3e38] {
                assert!(quarter_angle(y, x).is_finite(), "{y} {x}");
            }
        }
    }
}
