//! Axis-angle rotations and their exact derivatives, also at zero.

use caphy_core::Vec3;
use nalgebra::Matrix3;

/// Below this squared angle the closed forms lose digits to cancellation and the series take over: at 0.25 the closed
/// forms still have 1e-14 relative accuracy, and ten terms of the series have more.
const SERIES_BELOW: f64 = 0.25;
/// Terms of the series.
const TERMS: usize = 10;

/// (-1)^n / (2n + `first`)!: a = Σ SINE_n xⁿ, b = Σ COSINE_n xⁿ for x = θ².
const fn reciprocal_factorials(first: usize) -> [f64; TERMS] {
    let mut out = [1.0; TERMS];
    let (mut n, mut value) = (0, if first == 2 { 0.5 } else { 1.0 });
    while n < TERMS {
        out[n] = value;
        let next = 2 * n + first;
        value /= -(((next + 1) * (next + 2)) as f64);
        n += 1;
    }
    out
}
const SINE: [f64; TERMS] = reciprocal_factorials(1);
const COSINE: [f64; TERMS] = reciprocal_factorials(2);

/// Σ c_n xⁿ.
fn polynomial(c: &[f64; TERMS], x: f64) -> f64 {
    c.iter().rev().fold(0.0, |sum, c| sum * x + c)
}

/// Σ 2 n c_n xⁿ⁻¹, the derivative by θ over θ.
fn slope(c: &[f64; TERMS], x: f64) -> f64 {
    c.iter().enumerate().skip(1).rev().fold(0.0, |sum, (n, c)| sum * x + 2.0 * n as f64 * c)
}

/// Cross-product matrix [v]×.
pub(super) fn cross_matrix(v: &Vec3) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// a = sin θ / θ and b = (1 - cos θ) / θ² for x = θ².
fn sine_and_cosine(x: f64) -> [f64; 2] {
    if x < SERIES_BELOW {
        return [polynomial(&SINE, x), polynomial(&COSINE, x)];
    }
    let angle = x.sqrt();
    let (sin, cos) = angle.sin_cos();
    [sin / angle, (1.0 - cos) / x]
}

/// Rotation matrix of an axis-angle vector [rad]: R = I + a K + b K².
pub(super) fn rotation(r: &Vec3) -> Matrix3<f64> {
    let [a, b] = sine_and_cosine(r.norm_squared());
    let k = cross_matrix(r);
    Matrix3::identity() + k * a + k * k * b
}

/// ∂R/∂r_x, ∂R/∂r_y, ∂R/∂r_z [1/rad].
pub(super) fn rotation_derivatives(r: &Vec3) -> [Matrix3<f64>; 3] {
    let x = r.norm_squared();
    let [a, b] = sine_and_cosine(x);
    // a'/θ and b'/θ.
    let [da, db] = if x < SERIES_BELOW {
        [slope(&SINE, x), slope(&COSINE, x)]
    } else {
        [(x.sqrt().cos() - a) / x, (a - 2.0 * b) / x]
    };
    let k = cross_matrix(r);
    let kk = k * k;
    std::array::from_fn(|axis| {
        let e = cross_matrix(&Vec3::ith(axis, 1.0));
        k * (da * r[axis]) + e * a + kk * (db * r[axis]) + (e * k + k * e) * b
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    #[test]
    fn rotations_equal_nalgebras_and_derivatives_finite_differences() {
        let axis = Vec3::new(0.3, -0.8, 0.5).normalize();
        for angle in [0.0, 1e-9, 1e-5, 0.1, 0.499, 0.501, 1.0, 3.0, std::f64::consts::PI, 6.0] {
            let r = axis * angle;
            let expected = Rotation3::from_scaled_axis(r).into_inner();
            assert!((rotation(&r) - expected).amax() < 1e-14, "angle {angle}");
            for (k, exact) in rotation_derivatives(&r).iter().enumerate() {
                // Fourth-order central difference: truncation ~ h⁴ and rounding ~ 1e-16/h balance near 1e-3.
                let h = 1e-3;
                let at = |s: f64| rotation(&(r + Vec3::ith(k, s * h)));
                let numeric = ((at(1.0) - at(-1.0)) * 8.0 - (at(2.0) - at(-2.0))) / (12.0 * h);
                assert!((numeric - exact).amax() < 1e-11, "angle {angle}, axis {k}: {}", (numeric - exact).amax());
            }
        }
    }
}
