//! Eq. 10 as numbers: f(m) = A m + b, reduced to a small triangle, and its bounded minimum.

use super::bounded;
use caphy_core::{Error, Result};
use nalgebra::{DMatrix, DVector};

/// Gauss-Newton steps for unknowns on a logarithmic scale.
const STEPS: usize = 200;

/// Forces that are linear in multipliers, kept as the triangle R of [A b]: squares of A are never formed, so that combinations
/// down to 1e-12 of the largest can be told.
pub(crate) struct BalanceSystem {
    unknowns: usize,
    triangle: DMatrix<f64>,
    /// Rows that went in.
    pub(crate) rows: usize,
}

/// The minimum, and what it is worth.
pub(crate) struct BalanceSolution {
    pub(crate) multipliers: DVector<f64>,
    /// Lengths of A's columns.
    pub(crate) lengths: DVector<f64>,
    /// Singular values of A with columns of unit length, largest first; of excited columns.
    pub(crate) singular_values: Vec<f64>,
    /// Their right singular vectors, parts of the unknowns in units of their columns.
    pub(crate) combinations: Vec<Vec<f64>>,
    /// Posterior over prior variance per unknown: 1 where the data says nothing.
    pub(crate) left_to_prior: Vec<f64>,
}

/// How the minimum is looked for.
pub(crate) struct BalanceRules<'a> {
    /// Where multipliers start, and where λ_reg pulls them back to.
    pub(crate) start: &'a DVector<f64>,
    /// λ_reg per unknown, relative to the squared length of its column.
    pub(crate) regularisation: &'a [f64],
    /// Which unknowns are logarithms of multipliers.
    pub(crate) logarithmic: &'a [bool],
    pub(crate) lower: &'a DVector<f64>,
    pub(crate) upper: &'a DVector<f64>,
}

impl BalanceSystem {
    pub(crate) fn new(unknowns: usize) -> Self {
        Self { unknowns, triangle: DMatrix::zeros(0, unknowns + 1), rows: 0 }
    }
    /// The triangle of rows [A b].
    pub(crate) fn of_rows(rows: DMatrix<f64>) -> Self {
        let (count, unknowns) = (rows.nrows(), rows.ncols() - 1);
        let triangle = if count > unknowns + 1 { rows.qr().unpack_r() } else { rows };
        Self { unknowns, triangle, rows: count }
    }
    /// Puts another system's rows below.
    pub(crate) fn join(&mut self, other: &Self) {
        let n = self.unknowns + 1;
        let mut both = DMatrix::zeros(self.triangle.nrows() + other.triangle.nrows(), n);
        both.view_mut((0, 0), (self.triangle.nrows(), n)).copy_from(&self.triangle);
        both.view_mut((self.triangle.nrows(), 0), (other.triangle.nrows(), n)).copy_from(&other.triangle);
        self.rows += other.rows;
        self.triangle = if both.nrows() > n { both.qr().unpack_r() } else { both };
    }
    /// Root-mean-square of A m + b [N].
    pub(crate) fn residual(&self, m: &DVector<f64>) -> f64 {
        if self.rows == 0 { 0.0 } else { (self.a() * m + self.b()).norm() / (self.rows as f64).sqrt() }
    }
    pub(crate) fn column_lengths(&self) -> DVector<f64> {
        DVector::from_fn(self.unknowns, |k, _| self.triangle.column(k).norm())
    }
    /// ½‖A m + b‖² and its slope by m.
    pub(crate) fn half_square(&self, m: &DVector<f64>) -> (f64, DVector<f64>) {
        let f = self.a() * m + self.b();
        (0.5 * f.norm_squared(), self.a().transpose() * f)
    }
    fn a(&self) -> DMatrix<f64> {
        self.triangle.columns(0, self.unknowns).into_owned()
    }
    fn b(&self) -> DVector<f64> {
        self.triangle.column(self.unknowns).into_owned()
    }

    pub(crate) fn solve(&self, rules: &BalanceRules<'_>) -> Result<BalanceSolution> {
        let n = self.unknowns;
        let (a, b) = (self.a(), self.b());
        if a.iter().chain(b.iter()).any(|v| !v.is_finite()) {
            return Err(Error::numerics(
                "Eq. 10",
                "a force or its slope is not finite",
                "look for a garment that exploded before its fabric was estimated",
            ));
        }
        let lengths = DVector::from_fn(n, |k, _| a.column(k).norm());
        let excited = |k: usize| lengths[k] > 1e-12 * lengths.amax() && lengths[k] > 0.0;
        // z is m or its logarithm; λ_reg stays that of the start.
        let to_m = |z: &DVector<f64>| DVector::from_fn(n, |k, _| if rules.logarithmic[k] { z[k].exp() } else { z[k] });
        let to_z = |m: &DVector<f64>| DVector::from_fn(n, |k, _| if rules.logarithmic[k] { m[k].ln() } else { m[k] });
        let start = to_z(rules.start);
        let scale = |m: &DVector<f64>, k: usize| if rules.logarithmic[k] { m[k] } else { 1.0 };
        let pull: Vec<f64> =
            (0..n).map(|k| rules.regularisation[k].sqrt() * lengths[k] * scale(rules.start, k)).collect();
        let (lower, upper) = (to_z(rules.lower), to_z(rules.upper));
        let mut z = start.clone();
        let cost = |z: &DVector<f64>| {
            let f = &a * to_m(z) + &b;
            let back: f64 = (0..n).map(|k| (pull[k] * (z[k] - start[k])).powi(2)).sum();
            f.norm_squared() + back
        };
        let nonlinear = rules.logarithmic.iter().any(|l| *l);
        for _ in 0..if nonlinear { STEPS } else { 1 } {
            let m = to_m(&z);
            let f = &a * &m + &b;
            // Rows of A and of λ_reg, unknowns in units of their columns.
            let unit = |k: usize| if excited(k) { 1.0 / (lengths[k] * scale(&m, k)) } else { 0.0 };
            let rows = a.nrows();
            let big = DMatrix::from_fn(rows + n, n, |r, k| {
                if r < rows {
                    a[(r, k)] * scale(&m, k) * unit(k)
                } else if r - rows == k {
                    pull[k] * unit(k)
                } else {
                    0.0
                }
            });
            let right = DVector::from_fn(rows + n, |r, _| {
                if r < rows { -f[r] } else { -pull[r - rows] * (z[r - rows] - start[r - rows]) }
            });
            let bound = |limit: &DVector<f64>, k: usize| if excited(k) { (limit[k] - z[k]) / unit(k) } else { 0.0 };
            let low = DVector::from_fn(n, |k, _| bound(&lower, k).min(0.0));
            let high = DVector::from_fn(n, |k, _| bound(&upper, k).max(0.0));
            let d = bounded::least_squares(&big, &right, &low, &high)?;
            let step = DVector::from_fn(n, |k, _| d[k] * unit(k));
            if !nonlinear {
                z += step;
                break;
            }
            let before = cost(&z);
            let mut share = (1.0 / step.amax().max(1.0)).min(1.0);
            let mut next = &z + &step * share;
            while cost(&next) > before && share > 1e-10 {
                share *= 0.5;
                next = &z + &step * share;
            }
            let moved = (&next - &z).amax();
            if cost(&next) > before {
                break;
            }
            z = next;
            if moved < 1e-14 {
                break;
            }
        }
        let multipliers = to_m(&z);
        let unit = DMatrix::from_fn(a.nrows(), n, |r, k| if excited(k) { a[(r, k)] / lengths[k] } else { 0.0 });
        let seen = (0..n).filter(|&k| excited(k)).count();
        let svd = unit.clone().svd(false, true);
        let mut order: Vec<usize> = (0..svd.singular_values.len()).collect();
        order.sort_by(|&x, &y| svd.singular_values[y].total_cmp(&svd.singular_values[x]));
        order.truncate(seen);
        let singular_values = order.iter().map(|&k| svd.singular_values[k]).collect();
        let combinations = order
            .iter()
            .map(|&k| svd.v_t.as_ref().map_or_else(Vec::new, |v| v.row(k).iter().copied().collect()))
            .collect();
        let information = unit.transpose() * &unit;
        let left_to_prior = (0..n)
            .map(|k| {
                let prior = rules.regularisation[k];
                if !excited(k) {
                    return 1.0;
                }
                if prior == 0.0 {
                    return 0.0;
                }
                let with = DMatrix::from_fn(n, n, |i, j| {
                    information[(i, j)] + if i == j { rules.regularisation[i].max(1e-12) } else { 0.0 }
                });
                with.cholesky().map_or(1.0, |f| f.inverse()[(k, k)] * prior)
            })
            .collect();
        Ok(BalanceSolution { multipliers, lengths, singular_values, combinations, left_to_prior })
    }
}
