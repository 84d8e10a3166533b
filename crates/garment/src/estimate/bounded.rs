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
        return Err(refused());
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

/// Singular values below this share of the largest are rounding: along them the answer does not move.
const RANK: f64 = 1e-13;

/// Minimises ‖A z − b‖² over `lower ≤ z ≤ upper`, 0 inside of them, without squaring A: starting from 0, active set with exact
/// solves on the free unknowns. What A does not see stays 0.
///
/// Errors: as [`solve`].
pub fn least_squares(
    a: &DMatrix<f64>,
    b: &DVector<f64>,
    lower: &DVector<f64>,
    upper: &DVector<f64>,
) -> Result<DVector<f64>> {
    let n = a.ncols();
    if !(a.iter().chain(b.iter()).all(|v| v.is_finite()) && (0..n).all(|i| lower[i] <= 0.0 && 0.0 <= upper[i])) {
        return Err(refused());
    }
    let mut z = DVector::zeros(n);
    let mut free: Vec<bool> = (0..n).map(|i| lower[i] < upper[i]).collect();
    // Each round frees or fixes one unknown; a handful of unknowns settle in a few rounds.
    for _ in 0..10 * n + 10 {
        let ids: Vec<usize> = (0..n).filter(|&i| free[i]).collect();
        let mut blocked = None;
        if !ids.is_empty() {
            let part = DMatrix::from_fn(a.nrows(), ids.len(), |r, k| a[(r, ids[k])]);
            // Twice: the second takes the rounding of the first away.
            let svd = part.clone().svd(true, true);
            let least = RANK * svd.singular_values.amax();
            let mut goal = DVector::from_fn(ids.len(), |k, _| z[ids[k]]);
            for _ in 0..2 {
                let held = DVector::from_fn(n, |i, _| if free[i] { 0.0 } else { z[i] });
                let rest = b - a * held - &part * &goal;
                goal += svd.solve(&rest, least.max(f64::MIN_POSITIVE)).map_err(|_| refused())?;
            }
            let mut t = 1.0;
            for (k, &i) in ids.iter().enumerate() {
                let step = goal[k] - z[i];
                let room = if step > 0.0 { upper[i] - z[i] } else { lower[i] - z[i] };
                let share = (room / step).max(0.0);
                if step != 0.0 && share < t {
                    t = share;
                    blocked = Some((i, if step > 0.0 { upper[i] } else { lower[i] }));
                }
            }
            for (k, &i) in ids.iter().enumerate() {
                z[i] += t * (goal[k] - z[i]);
            }
            if let Some((i, at)) = blocked {
                z[i] = at;
                free[i] = false;
                continue;
            }
        }
        // At a bound the slope must point out of it.
        let slope = a.transpose() * (a * &z - b);
        let scale = b.norm() * a.norm();
        let worst = (0..n)
            .filter(|&i| !free[i] && lower[i] < upper[i])
            .map(|i| (i, if z[i] == lower[i] { -slope[i] } else { slope[i] }))
            .max_by(|x, y| x.1.total_cmp(&y.1));
        match worst {
            Some((i, inward)) if inward > 1e-14 * scale => free[i] = true,
            _ => break,
        }
    }
    Ok(z)
}

fn refused() -> Error {
    Error::numerics(
        "bounded least squares",
        "a coefficient is not finite, or a lower bound lies above its upper one",
        "look for a garment that exploded before its fabric was estimated",
    )
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
    fn without_squares_the_small_singular_values_count() {
        // Columns that differ by 1e-9: squared, they would be the same.
        let a = DMatrix::from_fn(9, 3, |r, k| match k {
            0 => 1.0 + r as f64,
            1 => 1.0 + r as f64 + 1e-9 * (r as f64).sin(),
            _ => (r as f64).cos(),
        });
        let truth = DVector::from_row_slice(&[0.3, -0.2, 0.5]);
        let wide = DVector::from_element(3, 10.0);
        let z = least_squares(&a, &(&a * &truth), &-&wide, &wide).unwrap();
        assert!((z - &truth).amax() < 1e-5);
        // A bound that holds, one that lets go again, and an unknown that nothing sees.
        let a = DMatrix::from_row_slice(3, 3, &[2.0, 1.0, 0.0, 0.0, 1.0, 0.0, 1.0, -1.0, 0.0]);
        let b = DVector::from_row_slice(&[4.0, -3.0, 2.0]);
        let (lower, upper) = (DVector::from_element(3, -0.5), DVector::from_element(3, 1.0));
        let z = least_squares(&a, &b, &lower, &upper).unwrap();
        let slope = a.transpose() * (&a * &z - &b);
        for i in 0..2 {
            let good = if z[i] == lower[i] {
                slope[i] >= 0.0
            } else if z[i] == upper[i] {
                slope[i] <= 0.0
            } else {
                slope[i].abs() < 1e-12
            };
            assert!(good, "{i}: {z} {slope}");
        }
        assert_eq!(z[2], 0.0);
        assert!(least_squares(&a, &b, &upper, &lower).is_err());
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
