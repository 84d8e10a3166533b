//! From four constants to the λ and μ of Eq. 5: for reports and comparison (reference note, 5).

/// λ and μ [N/m] of the isotropic sheet nearest to k0..k3: the rotational average (option A).
///
/// Defined everywhere; anisotropy is lost, and the two stiff wovens come out far too stiff in shear. λ may be negative.
pub fn average_lame(k: [f64; 4]) -> [f64; 2] {
    [(k[0] + 6.0 * k[1] + k[2] - 2.0 * k[3]) / 8.0, (k[0] + k[2] - 2.0 * k[1] + 2.0 * k[3]) / 8.0]
}

/// λ(G) and μ(G) [N/m] with which Eq. 5 gives the orthotropic energy of k0..k3 exactly (option P), from the stiffness in the
/// frame of the principal strains; `None` at zero strain, where μ has no limit.
///
/// What the paper's Eq. 5 means by moduli that depend on principal strain and angle. μ may be negative; compute with the
/// four constants, report with these.
pub fn principal_lame(k: [f64; 4], green: [f64; 3]) -> Option<[f64; 2]> {
    let [u, v, w] = green;
    let (mean, half) = (0.5 * (u + v), 0.5 * (u - v));
    let radius = half.hypot(w);
    let (g1, g2) = (mean + radius, mean - radius);
    let square = g1 * g1 + g2 * g2;
    if square == 0.0 {
        return None;
    }
    // Direction of the larger principal strain; any will do when both are equal.
    let angle = 0.5 * w.atan2(half);
    let (s, c) = angle.sin_cos();
    let (c2, s2) = (c * c, s * s);
    let along = |a: f64, b: f64| k[0] * a * a + 2.0 * (k[1] + k[3]) * a * b + k[2] * b * b;
    let (dd, ee) = (along(c2, s2), along(s2, c2));
    let de = (k[0] + k[2] - 2.0 * k[3]) * c2 * s2 + k[1] * (c2 * c2 + s2 * s2);
    Some([de, 0.5 * ((dd * g1 * g1 + ee * g2 * g2) / square - de)])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn eq5(lame: [f64; 2], [u, v, w]: [f64; 3]) -> f64 {
        0.5 * lame[0] * (u + v).powi(2) + lame[1] * (u * u + v * v + 2.0 * w * w)
    }
    fn orthotropic(k: [f64; 4], [u, v, w]: [f64; 3]) -> f64 {
        0.5 * (k[0] * u * u + k[2] * v * v) + k[1] * u * v + k[3] * w * w
    }

    #[test]
    fn the_principal_moduli_lose_nothing() {
        let k = [41.6, 3.0, 109.8, 66.9];
        for g in [[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.05, -0.03, 0.02], [0.1, 0.1, 0.0], [-0.01, 0.02, -0.3]] {
            let lame = principal_lame(k, g).unwrap();
            let (want, got) = (orthotropic(k, g), eq5(lame, g));
            // Products of k and G of at most 110 · 0.09.
            assert!((want - got).abs() < 1e-14 * 110.0, "{g:?}: {got} instead of {want}");
        }
        assert_eq!(principal_lame(k, [0.0; 3]), None);
        // An isotropic sheet is its own average and the same in every frame.
        let isotropic = [7.0, 3.0, 7.0, 4.0];
        assert_eq!(average_lame(isotropic), [3.0, 2.0]);
        let lame = principal_lame(isotropic, [0.03, -0.01, 0.05]).unwrap();
        assert!((lame[0] - 3.0).abs() < 1e-14 && (lame[1] - 2.0).abs() < 1e-14);
    }
}
