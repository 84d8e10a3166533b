//! tanh and the logistic sigmoid in vector registers: plain arithmetic that a loop over lanes turns into vector code.
//!
//! Both come from eˣ - 1 = 2ⁿ (eʳ - 1) + (2ⁿ - 1) with x = n ln 2 + r, |r| ≤ ln 2 / 2, and the Taylor series of eʳ - 1.
//! Its remainder relative to the sum is below |r|⁷/8! = 1.5e-8 with 7 terms (`f32`) and |r|¹³/14! = 1.2e-17 with 13 terms
//! (`f64`), which is less than half a unit in the last place of either. No fused multiply-add, so the bits are the same
//! on every vector width.

use caphy_core::Real;

/// Whether `T` is the narrow one of the two precisions: known when compiled, so the other branch vanishes.
#[inline(always)]
fn narrow<T: Real>() -> bool {
    size_of::<T>() == size_of::<f32>()
}

/// Splits x, |x| below 80, into (2ⁿ, r).
///
/// Adding 1.5·2²³ (1.5·2⁵²) leaves the nearest whole number in the low bits of the sum, where a shift makes it an exponent.
#[inline(always)]
fn reduce<T: Real>(x: T) -> (T, T) {
    if narrow::<T>() {
        const SHIFT: f32 = 12_582_912.0;
        // ln 2 in two parts: the first has 9 significant bits, so that n times it is exact.
        const LN2_HIGH: f32 = 355.0 / 512.0;
        const LN2_LOW: f32 = -2.121_944_4e-4;
        let x = x.to_f64() as f32;
        let shifted = x * std::f32::consts::LOG2_E + SHIFT;
        let n = shifted - SHIFT;
        let power = f32::from_bits((shifted.to_bits() << 23).wrapping_add(1.0f32.to_bits()));
        let r = (x - n * LN2_HIGH) - n * LN2_LOW;
        (T::of(f64::from(power)), T::of(f64::from(r)))
    } else {
        const SHIFT: f64 = 6_755_399_441_055_744.0;
        const LN2_HIGH: f64 = f64::from_bits(0x3fe6_2e42_fee0_0000);
        const LN2_LOW: f64 = 1.908_214_929_270_587_7e-10;
        let x = x.to_f64();
        let shifted = x * std::f64::consts::LOG2_E + SHIFT;
        let n = shifted - SHIFT;
        let power = f64::from_bits((shifted.to_bits() << 52).wrapping_add(1.0f64.to_bits()));
        let r = (x - n * LN2_HIGH) - n * LN2_LOW;
        (T::of(power), T::of(r))
    }
}

/// 1/k!, k = 0..14.
const INVERSE_FACTORIAL: [f64; 14] = [
    1.0,
    1.0,
    1.0 / 2.0,
    1.0 / 6.0,
    1.0 / 24.0,
    1.0 / 120.0,
    1.0 / 720.0,
    1.0 / 5_040.0,
    1.0 / 40_320.0,
    1.0 / 362_880.0,
    1.0 / 3_628_800.0,
    1.0 / 39_916_800.0,
    1.0 / 479_001_600.0,
    1.0 / 6_227_020_800.0,
];

/// eˣ - 1 for |x| below 80.
#[inline(always)]
fn exp_minus_one<T: Real>(x: T) -> T {
    let (power, r) = reduce(x);
    let terms = if narrow::<T>() { 7 } else { 13 };
    let mut sum = T::of(INVERSE_FACTORIAL[terms]);
    for k in (1..terms).rev() {
        sum = sum * r + T::of(INVERSE_FACTORIAL[k]);
    }
    power * (sum * r) + (power - T::one())
}

/// `x` moved into [-limit, limit]; not-a-number stays, so that a diverged net is seen.
#[inline(always)]
fn clamp<T: Real>(x: T, limit: f64) -> T {
    let limit = T::of(limit);
    let x = if x > limit { limit } else { x };
    if x < -limit { -limit } else { x }
}

/// tanh x.
#[inline(always)]
pub(crate) fn tanh<T: Real>(x: T) -> T {
    // Beyond 20, tanh is 1 in both precisions.
    let x = clamp(x, 20.0);
    let two = T::one() + T::one();
    let e = exp_minus_one(x * two);
    e / (e + two)
}

/// 1 / (1 + e⁻ˣ).
#[inline(always)]
pub(crate) fn sigmoid<T: Real>(x: T) -> T {
    // Beyond 70 the value is 1, or 4e-31 and falling: no gate can tell the difference.
    let x = clamp(x, 70.0);
    let two = T::one() + T::one();
    T::one() / (exp_minus_one(-x) + two)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest relative error against the standard library's `f64` over a sweep that crosses every reduction interval.
    fn errors<T: Real>() -> (f64, f64) {
        let mut worst = (0.0f64, 0.0f64);
        for i in -400_000..=400_000 {
            let x = T::of(f64::from(i) * 1.0e-4 + 1.0e-7);
            let wide = x.to_f64();
            worst.0 = worst.0.max((tanh(x).to_f64() / wide.tanh() - 1.0).abs());
            worst.1 = worst.1.max((sigmoid(x).to_f64() * (1.0 + (-wide).exp()) - 1.0).abs());
        }
        (worst.0, worst.1)
    }

    #[test]
    fn both_functions_are_good_to_a_few_units_in_the_last_place() {
        // Four units: rounding of the sum, of the scaling, of the denominator and of the quotient, half a unit each, twice
        // that for the standard library and the comparison.
        let (tanh, sigmoid) = errors::<f32>();
        println!("f32: tanh {tanh:.2e}, sigmoid {sigmoid:.2e}");
        assert!(tanh < 4.0 * f64::from(f32::EPSILON) && sigmoid < 4.0 * f64::from(f32::EPSILON));
        let (tanh, sigmoid) = errors::<f64>();
        println!("f64: tanh {tanh:.2e}, sigmoid {sigmoid:.2e}");
        assert!(tanh < 4.0 * f64::EPSILON && sigmoid < 4.0 * f64::EPSILON);
    }

    #[test]
    fn extremes_saturate_and_not_a_number_stays() {
        for x in [1.0e3f32, f32::MAX, f32::INFINITY] {
            assert_eq!((tanh(x), tanh(-x), sigmoid(x)), (1.0, -1.0, 1.0));
            assert!(sigmoid(-x) >= 0.0 && sigmoid(-x) < 1e-30);
        }
        assert_eq!((tanh(0.0f32), tanh(-0.0f64), sigmoid(0.0f32)), (0.0, 0.0, 0.5));
        assert!(tanh(f32::NAN).is_nan() && sigmoid(f32::NAN).is_nan());
        assert!(tanh(f64::NAN).is_nan() && sigmoid(f64::NAN).is_nan());
        assert_eq!(tanh(1.0e-30f32), 1.0e-30);
    }
}
