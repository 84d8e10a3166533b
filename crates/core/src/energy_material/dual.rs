//! Dual numbers: values that carry their exact derivatives along.
//!
//! Own types, because material kernels need plain arithmetic that stays in vector registers, logarithm included; the ones
//! of a library call the system's `ln` for each value.

use crate::Real;
use std::fmt::Debug;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// What an energy is written in: `f32`, `f64`, or either with derivatives.
pub trait Scalar:
    Copy
    + Debug
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + Send
    + Sync
{
    /// A number without derivatives.
    fn constant(value: f64) -> Self;
    /// Whether this value is below another's; derivatives do not count.
    fn below(self, other: Self) -> bool;
    /// √x; x must be positive where derivatives are wanted.
    fn sqrt(self) -> Self;
    /// ln x for x > 0.
    fn ln(self) -> Self;
    /// x − ln(1 + x) for x > −1, without the cancellation near 0.
    fn less_ln_1p(self) -> Self;

    /// The larger one, with its derivatives.
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        if self.below(other) { other } else { self }
    }
    /// The smaller one, with its derivatives.
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        if other.below(self) { other } else { self }
    }
    /// x².
    #[inline(always)]
    fn squared(self) -> Self {
        self * self
    }
    /// `factor` times this.
    #[inline(always)]
    fn times(self, factor: f64) -> Self {
        self * Self::constant(factor)
    }
}

/// Odd coefficients 1/(2k+1), k ≥ 1, of atanh(s)/s − 1 by s²; with |s| ≤ 0.172 eleven reach double precision.
const ATANH: [f64; 11] = [
    1.0 / 3.0,
    1.0 / 5.0,
    1.0 / 7.0,
    1.0 / 9.0,
    1.0 / 11.0,
    1.0 / 13.0,
    1.0 / 15.0,
    1.0 / 17.0,
    1.0 / 19.0,
    1.0 / 21.0,
    1.0 / 23.0,
];
/// |x| / (2 + x) below which x − ln(1 + x) is summed directly.
const SMALL: f64 = 0.17;

/// atanh(s)/s − 1 from s².
macro_rules! tail {
    ($real:ty, $terms:literal, $square:expr) => {{
        let square = $square;
        let mut sum: $real = 0.0;
        for c in ATANH[..$terms].iter().rev() {
            sum = (sum + *c as $real) * square;
        }
        sum
    }};
}

macro_rules! plain {
    ($real:ty, $bits:ty, $int:ty, $mantissa:literal, $bias:literal, $terms:literal) => {
        impl Scalar for $real {
            #[inline(always)]
            fn constant(value: f64) -> Self {
                value as $real
            }
            #[inline(always)]
            fn below(self, other: Self) -> bool {
                self < other
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                self.sqrt()
            }
            #[inline(always)]
            fn ln(self) -> Self {
                // x = m 2^e with m in [1/√2, √2): no call, no branch, so that loops stay vector loops.
                let bits = self.to_bits();
                let exponent = ((bits >> $mantissa) as $int - $bias) as $real;
                let mantissa = <$real>::from_bits((bits & ((1 << $mantissa) - 1)) | ($bias << $mantissa));
                let high = mantissa > std::f64::consts::SQRT_2 as $real;
                let m = if high { 0.5 * mantissa } else { mantissa };
                let e = if high { exponent + 1.0 } else { exponent };
                let s = (m - 1.0) / (m + 1.0);
                2.0 * (s + s * tail!($real, $terms, s * s)) + e * std::f64::consts::LN_2 as $real
            }
            #[inline(always)]
            fn less_ln_1p(self) -> Self {
                let s = self / (2.0 + self);
                // x = 2s/(1 − s), so that x − 2s = s x, and ln(1 + x) = 2 atanh(s).
                let near = s * self - 2.0 * s * tail!($real, $terms, s * s);
                let far = self - (1.0 + self).ln_plain();
                if s.abs() < SMALL as $real { near } else { far }
            }
        }

        impl LnPlain for $real {
            #[inline(always)]
            fn ln_plain(self) -> Self {
                Scalar::ln(self)
            }
        }
    };
}

/// Names the polynomial logarithm beside the inherent `ln` of floats.
trait LnPlain {
    fn ln_plain(self) -> Self;
}

plain!(f32, u32, i32, 23, 127, 5);
plain!(f64, u64, i64, 52, 1023, 11);

/// A value with its derivatives in `N` directions; nested for higher orders.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dual<S, const N: usize> {
    /// The value.
    pub value: S,
    /// Derivatives.
    pub slope: [S; N],
}

impl<S: Scalar, const N: usize> Dual<S, N> {
    /// The variable of direction `direction`.
    #[inline(always)]
    pub fn variable(value: S, direction: usize) -> Self {
        let mut slope = [S::constant(0.0); N];
        slope[direction] = S::constant(1.0);
        Self { value, slope }
    }
    /// A value that does not vary.
    #[inline(always)]
    pub fn fixed(value: S) -> Self {
        Self { value, slope: [S::constant(0.0); N] }
    }
    /// f(x) from f and f′ at x.
    #[inline(always)]
    fn chain(self, value: S, derivative: S) -> Self {
        Self { value, slope: self.slope.map(|s| derivative * s) }
    }
}

impl<S: Scalar, const N: usize> Add for Dual<S, N> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self { value: self.value + other.value, slope: std::array::from_fn(|k| self.slope[k] + other.slope[k]) }
    }
}
impl<S: Scalar, const N: usize> Sub for Dual<S, N> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self { value: self.value - other.value, slope: std::array::from_fn(|k| self.slope[k] - other.slope[k]) }
    }
}
impl<S: Scalar, const N: usize> Mul for Dual<S, N> {
    type Output = Self;
    #[inline(always)]
    #[allow(clippy::suspicious_arithmetic_impl, reason = "the product rule adds")]
    fn mul(self, other: Self) -> Self {
        let slope = std::array::from_fn(|k| self.slope[k] * other.value + self.value * other.slope[k]);
        Self { value: self.value * other.value, slope }
    }
}
impl<S: Scalar, const N: usize> Div for Dual<S, N> {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        let inverse = S::constant(1.0) / other.value;
        let value = self.value * inverse;
        Self { value, slope: std::array::from_fn(|k| (self.slope[k] - value * other.slope[k]) * inverse) }
    }
}
impl<S: Scalar, const N: usize> Neg for Dual<S, N> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self { value: -self.value, slope: self.slope.map(|s| -s) }
    }
}

impl<S: Scalar, const N: usize> Scalar for Dual<S, N> {
    #[inline(always)]
    fn constant(value: f64) -> Self {
        Self::fixed(S::constant(value))
    }
    #[inline(always)]
    fn below(self, other: Self) -> bool {
        self.value.below(other.value)
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        self.chain(root, S::constant(0.5) / root)
    }
    #[inline(always)]
    fn ln(self) -> Self {
        self.chain(self.value.ln(), S::constant(1.0) / self.value)
    }
    #[inline(always)]
    fn less_ln_1p(self) -> Self {
        self.chain(self.value.less_ln_1p(), self.value / (S::constant(1.0) + self.value))
    }
    #[inline(always)]
    fn times(self, factor: f64) -> Self {
        let factor = S::constant(factor);
        Self { value: self.value * factor, slope: self.slope.map(|s| s * factor) }
    }
}

/// A plain number of a [`Real`].
pub trait PlainScalar: Real + Scalar {}
impl PlainScalar for f32 {}
impl PlainScalar for f64 {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logarithms_agree_with_the_library() {
        for i in 1..4000 {
            let x = 1.3f64.powi(i / 20 - 100) * (1.0 + 0.013 * f64::from(i % 20));
            let (want, got) = (x.ln(), Scalar::ln(x));
            assert!((got - want).abs() <= 4.0 * f64::EPSILON * want.abs().max(1.0), "{x}: {got} {want}");
            let (want, got) = ((x as f32).ln(), Scalar::ln(x as f32));
            assert!((got - want).abs() <= 4.0 * f32::EPSILON * want.abs().max(1.0), "{x}: {got} {want}");
        }
        assert_eq!((Scalar::ln(1.0f64), Scalar::ln(1.0f32)), (0.0, 0.0));
        for i in -80..400 {
            let x = 1e-2 * f64::from(i);
            let want = x - x.ln_1p();
            // The difference itself loses |x| ε.
            assert!((x.less_ln_1p() - want).abs() <= 8.0 * f64::EPSILON * x.abs().max(0.1), "{x}");
        }
        // Small x: x²/2 − x³/3 to all digits.
        for x in [1e-3f64, -1e-5, 1e-9] {
            let want: f64 = (2..8).map(|k| (-x).powi(k) / f64::from(k)).sum();
            assert!((x.less_ln_1p() / want - 1.0).abs() < 1e-12, "{x}");
            let single = (x as f32).less_ln_1p();
            assert!((f64::from(single) / want - 1.0).abs() < 1e-5, "{x}");
        }
    }

    #[test]
    fn derivatives_are_exact_to_second_order() {
        // f = √(x y) ln(x) / (y + less_ln_1p(x)), against differences of its own first derivative.
        fn f<S: Scalar>(x: S, y: S) -> S {
            (x * y).sqrt() * x.ln() / (y + x.less_ln_1p()) - x.times(3.0)
        }
        type First = Dual<f64, 2>;
        type Second = Dual<First, 2>;
        let first = |x: f64, y: f64| f(First::variable(x, 0), First::variable(y, 1));
        let (x, y, h) = (1.7, 0.6, 1e-6);
        let second = f(Second::variable(First::variable(x, 0), 0), Second::variable(First::variable(y, 1), 1));
        let slope = first(x, y).slope;
        assert!((0..2).all(|k| (second.value.slope[k] - slope[k]).abs() < 1e-14), "rounding of another order");
        for k in 0..2 {
            let by_x = (first(x + h, y).slope[k] - first(x - h, y).slope[k]) / (2.0 * h);
            let by_y = (first(x, y + h).slope[k] - first(x, y - h).slope[k]) / (2.0 * h);
            assert!((second.slope[k].slope[0] - by_x).abs() < 1e-8, "{k}");
            assert!((second.slope[k].slope[1] - by_y).abs() < 1e-8, "{k}");
        }
    }
}
