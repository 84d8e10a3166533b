//! How distances from scans answer to a style: a linear model through all garments that were tried near it.
//!
//! Where a fold lies is chance in each garment that is worn. With differences to one garment its folds are in all slopes, and each axis
//! seems to lead away from them; over many garments they average out.

use crate::estimate::bounded;
use caphy_core::{Error, Result};
use nalgebra::{DMatrix, DVector};

/// Distances beyond so many sigmas pull no harder.
const ROBUST_AT: f64 = 2.0;

/// Distances, over sigma, beyond which a patch says nothing: a wrong label far from any edge.
#[derive(Debug, Clone, Copy)]
pub(super) enum Far {
    /// Styles far away are looked for, too.
    Nowhere,
    /// A garment that is nearly right.
    Beyond(f64),
}

/// Standard deviation of the prior around the middle of the space, in shares of an axis's range: a waist under a shirt is not seen.
const PRIOR: f64 = 0.3;
pub(super) const MIDDLE: f64 = 0.5;
/// How far along an axis the model is trusted, in shares of its range; garments so far off count for exp(-1/2).
const REACH: f64 = 0.3;
/// Step of differences, in shares of an axis's range: well above what another triangulation of the same style changes.
pub(super) const DIFFERENCE: f64 = 0.2;
/// A patch that moves by fewer sigmas over that step does not answer to the axis, it has other folds.
pub(super) const ANSWERS: f64 = 0.8;
/// Keeps an axis without trials at no slope; far below the squares of differences.
const RIDGE: f64 = 1e-6;

/// A garment that was tried.
pub(super) struct Tried {
    /// Its style, in shares of the axes' ranges.
    pub u: Vec<f64>,
    /// Its distances from the scan, over sigma.
    pub residuals: Vec<f64>,
}

/// Distances of garments around a style, over sigma.
pub(super) struct Response {
    /// Of the style itself.
    pub residuals: Vec<f64>,
    /// Change per axis, over its whole range; 0 where it is less than other folds are. Shape [residuals, axes].
    pub slopes: DMatrix<f64>,
}

impl Response {
    /// Least squares through garments around `u`, nearer ones counting for more; slopes along the axes that are `free`.
    pub(super) fn around(u: &[f64], tried: &[Tried], free: &[usize]) -> Result<Self> {
        let rows = tried.first().map_or(0, |t| t.residuals.len());
        let size = free.len() + 1;
        let mut normal = DMatrix::from_diagonal_element(size, size, RIDGE);
        let mut right = DMatrix::zeros(size, rows);
        for t in tried {
            let off: Vec<f64> = free.iter().map(|&k| t.u[k] - u[k]).collect();
            let w = (-0.5 * off.iter().map(|d| (d / REACH).powi(2)).sum::<f64>()).exp();
            let x = DVector::from_fn(size, |i, _| if i == 0 { 1.0 } else { off[i - 1] });
            normal.ger(w, &x, &x, 1.0);
            right.ger(w, &x, &DVector::from_row_slice(&t.residuals), 1.0);
        }
        let factor = normal.cholesky().ok_or_else(|| {
            Error::numerics("refinement of a style", "no garment was tried", "report this as a defect")
        })?;
        let model = factor.solve(&right);
        let mut slopes = DMatrix::zeros(rows, u.len());
        for (i, &k) in free.iter().enumerate() {
            for row in 0..rows {
                let slope = model[(i + 1, row)];
                slopes[(row, k)] = if (slope * DIFFERENCE).abs() < ANSWERS { 0.0 } else { slope };
            }
        }
        Ok(Self { residuals: model.row(0).iter().copied().collect(), slopes })
    }

    /// The step from `u` within the space, and within reach, that promises most, and what it promises to gain of [`cost`]; 0 along axes
    /// without slopes.
    pub(super) fn step(&self, u: &[f64], far: Far) -> Result<(DVector<f64>, f64)> {
        let axes = u.len();
        let mut h = DMatrix::from_diagonal_element(axes, axes, PRIOR.powi(-2));
        let mut g = DVector::from_fn(axes, |k, _| (u[k] - MIDDLE) / (PRIOR * PRIOR));
        for (row, r) in self.residuals.iter().enumerate() {
            let slopes = self.slopes.row(row).transpose();
            let w = loss(*r, far).1;
            h.ger(w, &slopes, &slopes, 1.0);
            g.axpy(w * r, &slopes, 1.0);
        }
        let seen = |k: usize| self.slopes.column(k).iter().any(|s| *s != 0.0);
        let within = |k: usize, bound: f64| if seen(k) { (bound - u[k]).clamp(-REACH, REACH) } else { 0.0 };
        let lower = DVector::from_fn(axes, |k, _| within(k, 0.0));
        let upper = DVector::from_fn(axes, |k, _| within(k, 1.0));
        let step = bounded::solve(&h, &-&g, &lower, &upper, &DVector::zeros(axes))?;
        let gain = -(g.dot(&step) + 0.5 * step.dot(&(&h * &step)));
        Ok((step, gain))
    }
}

/// Half the sum of squares, robust, with the prior's: minus the logarithm of how likely a style is.
pub(super) fn cost(u: &[f64], residuals: &[f64], far: Far) -> f64 {
    let prior: f64 = u.iter().map(|u| ((u - MIDDLE) / PRIOR).powi(2)).sum();
    0.5 * prior + cost_of(residuals, far)
}

/// Half the sum of squares, robust.
pub(super) fn cost_of(residuals: &[f64], far: Far) -> f64 {
    residuals.iter().map(|r| loss(*r, far).0).sum()
}

/// The part of [`cost_of`] that is not of what is far: what a better garment can take away.
pub(super) fn near_cost_of(residuals: &[f64], far: Far) -> f64 {
    let near = |r: &&f64| !matches!(far, Far::Beyond(at) if r.abs() > at);
    residuals.iter().filter(near).map(|r| loss(*r, far).0).sum()
}

/// ρ(r) and its weight ρ′(r)/r: Huber's, constant from where it is far.
fn loss(r: f64, far: Far) -> (f64, f64) {
    let huber = |r: f64| if r <= ROBUST_AT { 0.5 * r * r } else { ROBUST_AT * (r - 0.5 * ROBUST_AT) };
    match far {
        Far::Beyond(far) if r.abs() > far => (huber(far), 0.0),
        _ => (huber(r.abs()), (ROBUST_AT / r.abs()).min(1.0)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Residuals of a linear law with folds: pseudo-random numbers of one standard deviation.
    fn worn(u: &[f64], folds: u64) -> Vec<f64> {
        let mut state = folds.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / f64::from(1u32 << 31) - 0.5
        };
        let law = |row: usize| 8.0 * (u[0] - 0.3) * f64::from(u8::from(row.is_multiple_of(3))) + 6.0 * (u[1] - 0.6);
        (0..60).map(|row| law(row) + 12f64.sqrt() * uniform()).collect()
    }

    #[test]
    fn folds_of_one_garment_do_not_lead_the_step_when_many_are_tried() {
        let centre = [0.3, 0.6];
        let steps = |count: u64| -> f64 {
            let mut squares = 0.0;
            for person in 0..20 {
                let mut tried = vec![Tried { u: centre.to_vec(), residuals: worn(&centre, 1000 * person + 1) }];
                for i in 0..count {
                    let mut u = centre;
                    u[(i % 2) as usize] += if (i / 2).is_multiple_of(2) { DIFFERENCE } else { -DIFFERENCE };
                    tried.push(Tried { residuals: worn(&u, 1000 * person + 2 + i), u: u.to_vec() });
                }
                let (step, gain) =
                    Response::around(&centre, &tried, &[0, 1]).unwrap().step(&centre, Far::Nowhere).unwrap();
                assert!(gain >= 0.0);
                squares += step.norm_squared();
            }
            (squares / 20.0).sqrt()
        };
        // The best place is the centre but for the prior. Two differences and none to average: folds lead.
        let (few, many) = (steps(2), steps(16));
        assert!(many < 0.5 * few, "{few} {many}");
    }

    #[test]
    fn exact_trials_give_exact_slopes() {
        let exact = |u: &[f64]| vec![10.0 * u[0] - 3.0, 7.0 * u[1] + 2.0 * u[0], 0.1 * u[0]];
        let tried: Vec<Tried> = [[0.5, 0.5], [0.7, 0.5], [0.5, 0.3], [0.4, 0.6]]
            .iter()
            .map(|u| Tried { u: u.to_vec(), residuals: exact(u) })
            .collect();
        let model = Response::around(&[0.45, 0.5], &tried, &[0, 1]).unwrap();
        let at = exact(&[0.45, 0.5]);
        // The ridge takes a share of about RIDGE / DIFFERENCE².
        assert!(model.residuals.iter().zip(&at).all(|(a, b)| (a - b).abs() < 1e-3));
        let expected = [[10.0, 0.0], [2.0 * f64::from(u8::from(2.0 * DIFFERENCE >= ANSWERS)), 7.0], [0.0, 0.0]];
        for (row, slopes) in expected.iter().enumerate() {
            for (k, slope) in slopes.iter().enumerate() {
                assert!((model.slopes[(row, k)] - slope).abs() < 1e-3, "{}", model.slopes);
            }
        }
    }

    #[test]
    fn what_is_far_off_says_nothing_of_a_garment_that_is_nearly_right() {
        // Nineteen patches are right, one is another edge.
        let slopes = DMatrix::from_element(20, 1, 5.0);
        let residuals = (0..20).map(|row| if row == 7 { 25.0 } else { 0.0 }).collect();
        let model = Response { residuals, slopes };
        let (pulled, _) = model.step(&[0.5], Far::Nowhere).unwrap();
        let (step, gain) = model.step(&[0.5], Far::Beyond(7.5)).unwrap();
        assert!(pulled[0] < -0.01 && step[0] == 0.0 && gain == 0.0, "{pulled} {step}");
        let residuals: Vec<f64> = (0..20).map(|row| if row == 7 { 25.0 } else { 1.0 }).collect();
        assert_eq!(near_cost_of(&residuals, Far::Beyond(7.5)), 0.5 * 19.0);
        assert_eq!(near_cost_of(&residuals, Far::Nowhere), cost_of(&residuals, Far::Nowhere));
        for far in [Far::Nowhere, Far::Beyond(7.5)] {
            // Continuous, and its weight is its slope.
            for r in [-9.0, -7.5, -2.0, -0.5, 0.0, 1.9, 2.1, 7.4, 7.6] {
                let h = 1e-6;
                let difference = (loss(r + h, far).0 - loss(r - h, far).0) / (2.0 * h);
                assert!((loss(r + h, far).0 - loss(r - h, far).0).abs() < 1e-5);
                let corner = matches!(far, Far::Beyond(at) if (r.abs() - at).abs() < 1e-3);
                assert!(corner || (difference - r * loss(r, far).1).abs() < 1e-5, "{r}");
            }
        }
    }
}
