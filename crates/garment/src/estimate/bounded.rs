//! Least squares with bounds on a handful of unknowns.

use caphy_core::{Error, Result};
use nalgebra::{DMatrix, DVector};

/// Minimises ½ zᵀH z − cᵀz over `lower ≤ z ≤ upper` for a symmetric positive semi-definite H.
///
/// Active set by coordinate descent, then exact solves on the free unknowns: coordinate descent alone creeps along narrow
/// valleys. Unknowns that H does not see (a zero diagonal) keep their start.
///
/// Errors: [`Error::Numerics`] for values that are not finite or bounds that are crossed.
pub fn solve(
    h: &DMatrix<f64>,
    c: &DVector<f64>,
    lower: &DVector<f64>,
    upper: &DVector<f64>,
    start: &DVector<f64>,
) -> Result<DVector<f64>> {
    let n = c.len();
    if !(h.iter().chain(c.iter()).all(|v| v.is_finite()) && (0..n).all(|i| lower[i] <= upper[i])) {
        return Err(Error::numerics(
            "bounded least squares",
            "a coefficient is not finite, or a lower bound lies above its upper one",
            "look for a garment that exploded before its fabric was estimated",
        ));
    }
    let mut z = DVector::from_fn(n, |i, _| start[i].clamp(lower[i], upper[i]));
    let descend = |z: &mut DVector<f64>| {
        for i in 0..n {
            if h[(i, i)] > 0.0 {
                let slope = (h.row(i) * &*z)[0] - c[i];
                z[i] = (z[i] - slope / h[(i, i)]).clamp(lower[i], upper[i]);
            }
        }
    };
    // Each round ends with a feasible point no worse than before; few unknowns settle in a few rounds.
    for _ in 0..200 {
        let before = z.clone();
        for _ in 0..20 {
            descend(&mut z);
        }
        let free: Vec<usize> = (0..n).filter(|&i| h[(i, i)] > 0.0 && z[i] > lower[i] && z[i] < upper[i]).collect();
        if !free.is_empty() {
            let m = free.len();
            let hf = DMatrix::from_fn(m, m, |a, b| h[(free[a], free[b])]);
            let fixed =
                |a: usize| -> f64 { (0..n).filter(|i| !free.contains(i)).map(|i| h[(free[a], i)] * z[i]).sum() };
            let rhs = DVector::from_fn(m, |a, _| c[free[a]] - fixed(a));
            if let Some(solution) = hf.cholesky().map(|f| f.solve(&rhs)) {
                // Go as far towards the free minimum as the bounds allow.
                let mut t: f64 = 1.0;
                for (a, &i) in free.iter().enumerate() {
                    let step = solution[a] - z[i];
                    if step > 0.0 {
                        t = t.min((upper[i] - z[i]) / step);
                    } else if step < 0.0 {
                        t = t.min((lower[i] - z[i]) / step);
                    }
                }
                for (a, &i) in free.iter().enumerate() {
                    z[i] = (z[i] + t.max(0.0) * (solution[a] - z[i])).clamp(lower[i], upper[i]);
                }
            }
        }
        if (&z - &before).amax() <= 1e-14 * (1.0 + z.amax()) {
            break;
        }
    }
    Ok(z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn free_and_bounded_minima_meet_the_optimality_conditions() {
        let h = DMatrix::from_row_slice(3, 3, &[4.0, 1.0, 0.5, 1.0, 3.0, -0.2, 0.5, -0.2, 2.0]);
        let c = DVector::from_row_slice(&[1.0, -6.0, 9.0]);
        let wide = DVector::from_element(3, 100.0);
        let z = solve(&h, &c, &-&wide, &wide, &DVector::zeros(3)).unwrap();
        assert!((&h * &z - &c).amax() < 1e-12);
        let (lower, upper) = (DVector::from_element(3, -1.0), DVector::from_element(3, 2.0));
        let z = solve(&h, &c, &lower, &upper, &DVector::zeros(3)).unwrap();
        let slope = &h * &z - &c;
        for i in 0..3 {
            let free = z[i] > lower[i] && z[i] < upper[i];
            let good = if free {
                slope[i].abs() < 1e-10
            } else if z[i] == lower[i] {
                slope[i] >= 0.0
            } else {
                slope[i] <= 0.0
            };
            assert!(good, "unknown {i}: z {} slope {}", z[i], slope[i]);
        }
    }

    #[test]
    fn unseen_unknowns_stay_and_bad_input_is_refused() {
        let h = DMatrix::from_diagonal(&DVector::from_row_slice(&[2.0, 0.0]));
        let c = DVector::from_row_slice(&[4.0, 0.0]);
        let (lower, upper) = (DVector::zeros(2), DVector::from_element(2, 9.0));
        let z = solve(&h, &c, &lower, &upper, &DVector::from_row_slice(&[1.0, 1.5])).unwrap();
        // The seen one is solved to rounding, the unseen one is not touched at all.
        assert!((z[0] - 2.0).abs() < 1e-14 && z[1] == 1.5, "{z}");
        let nan = DVector::from_row_slice(&[f64::NAN, 0.0]);
        assert!(solve(&h, &nan, &lower, &upper, &upper).is_err());
    }
}
