//! Limited-memory BFGS steps on the forces of one pose: what comes before Newton's steps, and what large garments are left with.
//!
//! A step costs little more than its forces.

use super::vector::{add_scaled, dot, largest, moved};
use caphy_core::{Error, Result};
use std::collections::VecDeque;

/// Pairs that are remembered.
const HISTORY: usize = 12;

/// Share by which the root mean square of forces must fall within `patience` steps.
const PROGRESS: f64 = 0.15;

/// When to stop and how far to go.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// Most steps.
    pub(super) steps: usize,
    /// Longest move of a vertex in one step [m].
    pub(super) max_move_m: f64,
    /// At rest when no force is larger [N].
    pub(super) tolerance_n: f64,
    /// Steps after which forces must have fallen by [`PROGRESS`], or no more are made.
    pub(super) patience: usize,
}

/// A change of position s and of gradient y, and 1/(s·y): 0 where the pair has no positive curvature and is left out.
struct Pair {
    s: Vec<f64>,
    y: Vec<f64>,
    rho: f64,
}

/// What is brought to rest.
pub(super) trait Balance {
    /// Overwrites `g` with minus the forces [N].
    ///
    /// # Errors
    /// Where there are none.
    fn forces(&mut self, x: &[f64], g: &mut Vec<f64>) -> Result<()>;
    /// Called where a step ends: renews what was held during it. Whether forces there have changed.
    ///
    /// # Errors
    /// As [`Balance::forces`].
    fn renew(&mut self, _: &[f64]) -> Result<bool> {
        Ok(false)
    }
    /// A first guess of the step: q by the inverse of some positive definite approximation of the second derivative, near `x`.
    /// `None`: a multiple of q, found from the last step.
    ///
    /// # Errors
    /// As [`Balance::forces`].
    fn guess(&mut self, _x: &[f64], _q: &[f64]) -> Result<Option<Vec<f64>>> {
        Ok(None)
    }
}

/// Moves `x` towards rest. Answers the number of steps and the largest force [N].
///
/// # Errors
/// [`Error::NonFinite`] when the start has no finite force; errors of `problem`.
pub(super) fn descend(x: &mut Vec<f64>, limits: &Limits, problem: &mut impl Balance) -> Result<(usize, f64)> {
    let mut g = Vec::new();
    problem.renew(x)?;
    problem.forces(x, &mut g)?;
    Error::check_finite("force at the start of relaxation", &g)?;
    let mut history: VecDeque<Pair> = VecDeque::new();
    let mut ahead = Vec::new();
    let (mut best, mut before) = (f64::INFINITY, f64::INFINITY);
    for step in 0..limits.steps {
        if step > 0 && problem.renew(x)? {
            problem.forces(x, &mut g)?;
        }
        let square = dot(&g, &g);
        best = best.min(square);
        if step > 0 && step.is_multiple_of(limits.patience) {
            if best > before * (1.0 - PROGRESS).powi(2) {
                return Ok((step, largest(&g).0));
            }
            before = best;
        }
        if largest(&g).0 <= limits.tolerance_n {
            return Ok((step, largest(&g).0));
        }
        let mut d = direction(x, &g, &history, problem)?;
        let along = dot(&d, &g);
        if !along.is_finite() || along >= 0.0 {
            // Start gently, and fall back to the force where the direction does not go with it.
            let reach = largest(&g).0;
            d.clear();
            d.extend(g.iter().map(|g| -0.05 * limits.max_move_m / reach * g));
            history.clear();
        }
        let reach = largest(&d).0;
        if reach > limits.max_move_m {
            d.iter_mut().for_each(|d| *d *= limits.max_move_m / reach);
        }
        let slope = dot(&d, &g);
        let mut alpha = 1.0;
        let mut next;
        let mut tries = 0;
        loop {
            next = moved(x, alpha, &d);
            problem.forces(&next, &mut ahead)?;
            let force = dot(&d, &ahead);
            tries += 1;
            // The force along the step may fall or gently reverse, but not push back harder than it pulled.
            if force.is_finite() && force <= -0.5 * slope || tries >= 14 || alpha == 0.0 {
                break;
            }
            alpha = if tries >= 12 && !force.is_finite() { 0.0 } else { 0.4 * alpha };
        }
        d.iter_mut().for_each(|d| *d *= alpha);
        let y = moved(&ahead, -1.0, &g);
        let sy = dot(&d, &y);
        let enough = 1e-8 * (dot(&d, &d) * dot(&y, &y)).sqrt();
        let rho = if sy.is_finite() && sy > enough && sy > 0.0 { 1.0 / sy } else { 0.0 };
        if history.len() == HISTORY {
            history.pop_front();
        }
        history.push_back(Pair { s: d, y, rho });
        *x = next;
        std::mem::swap(&mut g, &mut ahead);
    }
    Ok((limits.steps, largest(&g).0))
}

/// −H⁻¹g by the two-loop recursion; nothing to go by yet is no number.
fn direction(x: &[f64], g: &[f64], history: &VecDeque<Pair>, problem: &mut impl Balance) -> Result<Vec<f64>> {
    let mut q = g.to_vec();
    let mut alphas = Vec::with_capacity(history.len());
    for pair in history.iter().rev() {
        let alpha = pair.rho * dot(&pair.s, &q);
        add_scaled(&mut q, -alpha, &pair.y);
        alphas.push(alpha);
    }
    match (problem.guess(x, &q)?, history.back()) {
        (Some(guess), _) => q = guess,
        (None, None) => return Ok(vec![f64::NAN; g.len()]),
        (None, Some(last)) => {
            let gamma = if last.rho > 0.0 { 1.0 / (last.rho * dot(&last.y, &last.y)) } else { 1.0 };
            q.iter_mut().for_each(|q| *q *= gamma);
        }
    }
    for (pair, alpha) in history.iter().zip(alphas.iter().rev()).filter(|(pair, _)| pair.rho > 0.0) {
        let beta = pair.rho * dot(&pair.y, &q);
        add_scaled(&mut q, alpha - beta, &pair.s);
    }
    q.iter_mut().for_each(|q| *q = -*q);
    Ok(q)
}

#[cfg(test)]
mod tests {
    use super::*;

    impl<F: FnMut(&[f64], &mut Vec<f64>) -> Result<()>> Balance for F {
        fn forces(&mut self, x: &[f64], g: &mut Vec<f64>) -> Result<()> {
            self(x, g)
        }
    }

    /// A hanging chain of springs: vertex 0 is held, each link pulls with stiffness k, gravity pulls down.
    #[test]
    fn a_chain_hangs_by_its_closed_form() {
        let (n, k) = (6, 50.0);
        let mut x: Vec<f64> = (0..n).flat_map(|v| [0.012 * v as f64, 0.0, 0.002 * v as f64]).collect();
        let mut gradient = |x: &[f64], g: &mut Vec<f64>| -> Result<()> {
            g.clear();
            g.resize(x.len(), 0.0);
            for i in 1..n {
                g[3 * i + 1] += 0.001 * 9.81;
                let d: [f64; 3] = std::array::from_fn(|c| x[3 * i + c] - x[3 * i - 3 + c]);
                let length = d.iter().map(|d| d * d).sum::<f64>().sqrt();
                for c in 0..3 {
                    let pull = k * (1.0 - 0.01 / length) * d[c];
                    g[3 * i + c] += pull;
                    if i > 1 {
                        g[3 * i - 3 + c] -= pull;
                    }
                }
            }
            Ok(())
        };
        let limits = Limits { steps: 3000, max_move_m: 5e-3, tolerance_n: 1e-10, patience: 3000 };
        let (steps, force) = descend(&mut x, &limits, &mut gradient).unwrap();
        assert!(steps < 3000 && force <= 1e-10, "{steps} steps, {force:e} N");
        // Link i carries the weight of the vertices below it: stretch = (n - i) m g / k.
        let mut y = 0.0;
        for v in 1..n {
            y -= 0.01 + (n - v) as f64 * 0.001 * 9.81 / k;
            // Sideways the tension m g is what holds a vertex, 1 N/m over its links.
            assert!((x[3 * v + 1] - y).abs() < 1e-9, "vertex {v}");
        }
    }

    #[test]
    fn a_start_without_finite_force_is_refused() {
        let mut nan = |x: &[f64], g: &mut Vec<f64>| {
            g.clear();
            g.resize(x.len(), f64::NAN);
            Ok(())
        };
        let limits = Limits { steps: 10, max_move_m: 5e-3, tolerance_n: 1e-10, patience: 3000 };
        assert!(descend(&mut vec![0.0; 6], &limits, &mut nan).is_err());
    }
}
