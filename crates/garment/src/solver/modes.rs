//! The softest ways to move, by subspace iteration on H φ = ω² M φ.

use super::Solver;
use super::factor::{Factor, Kind};
use super::solution::SoftMode;
use super::sparse::BlockMatrix;
use super::state::{Frozen, Prepared, Workspace};
use super::vector::largest;
use crate::energy::Tangent;
use caphy_core::Result;
use nalgebra::{DMatrix, SymmetricEigen};

/// Iterations: the error of a mode falls by the ratio of its ω² to that of the first one left out.
const ITERATIONS: usize = 24;
/// Vectors beyond those that are wanted.
const SPARE: usize = 4;
/// H + σM is factorised, with σ [1/s²] far below a pendulum of 1 m, so that free modes do not make it singular.
const SHIFT: f64 = 0.1;

impl Solver {
    /// The modes with the smallest |ω² + σ|, softest first.
    pub(super) fn soft_modes(
        &self,
        prepared: &Prepared<'_>,
        frozen: &Frozen,
        workspace: &mut Workspace,
        x: &[f64],
    ) -> Result<Vec<SoftMode>> {
        let n = x.len();
        let masses = &self.rest.vertex_masses;
        let free: Vec<f64> = (0..n).map(|i| if prepared.fixed[i / 3] { 0.0 } else { 1.0 }).collect();
        let count = (self.settings.soft_modes + SPARE).min(free.iter().filter(|f| **f > 0.0).count());
        if count == 0 {
            return Ok(Vec::new());
        }
        let mut matrix = BlockMatrix::new(self.pattern.clone());
        workspace.tangent(self, prepared, frozen, x, Tangent::Exact, &mut matrix)?;
        let plain = matrix.clone();
        matrix.add_diagonal(masses.iter().map(|m| SHIFT * m));
        let factor = match Factor::new(&self.analysis, &matrix, Kind::Cholesky)? {
            Some(factor) => factor,
            None => match Factor::new(&self.analysis, &matrix, Kind::Lu)? {
                Some(factor) => factor,
                None => return Ok(Vec::new()),
            },
        };
        let mass = |i: usize| masses[i / 3].max(f64::MIN_POSITIVE);
        // A fixed start that no symmetry annuls.
        let mut basis: Vec<Vec<f64>> = (0..count)
            .map(|k| (0..n).map(|i| free[i] * ((1 + i * (2 * k + 3)) as f64 * 0.618_033_988_75).fract()).collect())
            .collect();
        let mut values = vec![0.0; count];
        for _ in 0..ITERATIONS {
            let mut next: Vec<Vec<f64>> = basis
                .iter()
                .map(|phi| {
                    let right: Vec<f64> = (0..n).map(|i| mass(i) * phi[i]).collect();
                    factor.solve(&right).iter().zip(&free).map(|(x, f)| x * f).collect()
                })
                .collect();
            orthonormalise(&mut next, &mass);
            let products: Vec<Vec<f64>> = next.iter().map(|phi| plain.multiply(phi)).collect();
            let small = DMatrix::from_fn(next.len(), next.len(), |i, j| {
                let one = |a: usize, b: usize| next[a].iter().zip(&products[b]).map(|(x, y)| x * y).sum::<f64>();
                0.5 * (one(i, j) + one(j, i))
            });
            let eigen = SymmetricEigen::new(small);
            let mut order: Vec<usize> = (0..next.len()).collect();
            order.sort_by(|&a, &b| {
                (eigen.eigenvalues[a] + SHIFT).abs().total_cmp(&(eigen.eigenvalues[b] + SHIFT).abs())
            });
            values = order.iter().map(|&k| eigen.eigenvalues[k]).collect();
            basis = order
                .iter()
                .map(|&k| {
                    (0..n)
                        .map(|i| next.iter().enumerate().map(|(j, phi)| eigen.eigenvectors[(j, k)] * phi[i]).sum())
                        .collect()
                })
                .collect();
        }
        let whole: f64 = (0..n / 3).filter(|&v| !prepared.fixed[v]).map(|v| masses[v]).sum();
        Ok(basis
            .iter()
            .zip(values)
            .take(self.settings.soft_modes)
            .map(|(phi, omega_squared)| {
                let participation = [0, 1, 2].map(|axis| {
                    let along: f64 = phi.iter().skip(axis).step_by(3).zip(masses).map(|(p, m)| p * m).sum();
                    along * along / whole.max(f64::MIN_POSITIVE)
                });
                let shape = phi.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
                SoftMode { omega_squared, participation, vertex: largest(phi).1, shape }
            })
            .collect())
    }
}

/// Gram-Schmidt in the mass product, twice; vectors that vanish are dropped.
fn orthonormalise(vectors: &mut Vec<Vec<f64>>, mass: &impl Fn(usize) -> f64) {
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).enumerate().map(|(i, (a, b))| mass(i) * a * b).sum::<f64>();
    let mut out: Vec<Vec<f64>> = Vec::with_capacity(vectors.len());
    for mut v in vectors.drain(..) {
        let before = product(&v, &v).sqrt();
        for _ in 0..2 {
            for u in &out {
                let along = product(u, &v);
                v.iter_mut().zip(u).for_each(|(v, u)| *v -= along * u);
            }
        }
        let length = product(&v, &v).sqrt();
        if length > 1e-12 * before && length.is_finite() {
            v.iter_mut().for_each(|v| *v /= length);
            out.push(v);
        }
    }
    *vectors = out;
}
