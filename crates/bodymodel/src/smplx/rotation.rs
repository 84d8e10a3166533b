//! Axis-angle rotations and their exact derivatives, also at zero.

use caphy_core::Vec3;
use nalgebra::Matrix3;

/// Below this squared angle the closed forms lose digits to cancellation and the series take over: at 0.25 the closed
/// forms still have 1e-14 relative accuracy, and nine terms of the series have more.
const SERIES_BELOW: f64 = 0.25;

/// Cross-product matrix [v]×.
pub(super) fn cross_matrix(v: &Vec3) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// a = sin θ / θ, b = (1 - cos θ) / θ², and a'/θ, b'/θ, for x = θ².
fn coefficients(x: f64) -> [f64; 4] {
    if x < SERIES_BELOW {
        // a = Σ (-x)^n / (2n+1)!, b = Σ (-x)^n / (2n+2)!; d/dθ = 2θ d/dx.
        let (mut a, mut b, mut da, mut db) = (0.0, 0.0, 0.0, 0.0);
        let mut power = 1.0; // (-x)^n / (2n)!
        let mut previous = 0.0; // -n (-x)^(n-1) / (2n)!
        for n in 0..10 {
            let (odd, even) = (f64::from(2 * n + 1), f64::from(2 * n + 2));
            a += power / odd;
            b += power / (odd * even);
            da += 2.0 * previous / odd;
            db += 2.0 * previous / (odd * even);
            let next = f64::from(n + 1);
            previous = -next * power / (odd * even);
            power *= -x / (odd * even);
        }
        [a, b, da, db]
    } else {
        let angle = x.sqrt();
        let (sin, cos) = angle.sin_cos();
        let (a, b) = (sin / angle, (1.0 - cos) / x);
        [a, b, (cos - a) / x, (a - 2.0 * b) / x]
    }
}

/// Rotation matrix of an axis-angle vector [rad]: R = I + a K + b K².
pub(super) fn rotation(r: &Vec3) -> Matrix3<f64> {
    let [a, b, _, _] = coefficients(r.norm_squared());
    let k = cross_matrix(r);
    Matrix3::identity() + k * a + k * k * b
}

/// ∂R/∂r_x, ∂R/∂r_y, ∂R/∂r_z [1/rad].
pub(super) fn rotation_derivatives(r: &Vec3) -> [Matrix3<f64>; 3] {
    let [a, b, da, db] = coefficients(r.norm_squared());
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
