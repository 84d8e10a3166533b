//! How an equilibrium answers to a change, by the implicit function theorem.
//!
//! At rest f(x*, p) = 0 with f the gradient of all energies, so that dx*/dp = −J⁻¹ ∂f/∂p with J = ∂f/∂x. J is the exact, not
//! projected derivative, with the stiffness's own dependence on strain; with frozen stiffness it is not symmetric and is
//! factorised as L U. Contact pairs, normals and friction limits are held, as in the solve.

use super::Solver;
use super::factor::{Factor, Kind};
use super::scene::Scene;
use super::solution::Solution;
use super::sparse::BlockMatrix;
use super::state::{Prepared, Workspace, flat};
use crate::energy::{State, Tangent};
use caphy_core::lanes::Frames;
use caphy_core::{Error, Result};

/// Rounds of iterative refinement after a solve: they bring the rounding of a badly conditioned J down to that of one product.
const REFINEMENTS: usize = 2;

/// J at an equilibrium, factorised.
///
/// Vectors are flat, shape [vertex][3]; entries of fixed vertices are ignored and answered with zero.
pub struct Linearisation<'a> {
    solver: &'a Solver,
    positions: Frames<f64>,
    matrix: BlockMatrix,
    factor: Factor,
    fixed: Vec<bool>,
    /// Residual of the equilibrium [N]: the theorem holds at zero.
    pub residual_n: f64,
}

impl Solver {
    /// Factorises the exact derivative of the forces at a solution of this scene.
    ///
    /// # Errors
    /// As [`Solver::solve`]; [`Error::Numerics`] for a matrix without a factorisation.
    pub fn linearise(&self, scene: &Scene<'_>, solution: &Solution) -> Result<Linearisation<'_>> {
        let prepared = Prepared::new(self, scene)?;
        let mut workspace = Workspace::new(self.vertex_count());
        let x = flat(&solution.positions);
        Error::check_length("solution to linearise at", 3 * self.vertex_count(), x.len())?;
        let mut matrix = BlockMatrix::new(self.pattern.clone());
        workspace.tangent(self, &prepared, &solution.frozen, &x, Tangent::Exact, &mut matrix)?;
        let symmetric = if self.conservative() { Factor::new(&self.analysis, &matrix, Kind::Cholesky)? } else { None };
        let factor = match symmetric {
            Some(factor) => Some(factor),
            None => Factor::new(&self.analysis, &matrix, Kind::Lu)?,
        };
        let Some(factor) = factor else {
            return Err(Error::numerics(
                "sensitivity of an equilibrium",
                "the derivative of the forces has no factorisation",
                "look at the soft modes of the solution: something moves without resistance",
            ));
        };
        let positions = workspace.set(&x).clone();
        let fixed = prepared.fixed;
        Ok(Linearisation { solver: self, positions, matrix, factor, fixed, residual_n: solution.report.residual_n })
    }
}

impl Solver {
    /// ∂E/∂x [N], shape [vertex][3], at a solution's positions in a scene that may differ a little from its own, contact pairs and
    /// friction held as they are there; zero at fixed vertices. Differences of it are the ∂f/∂p of [`Linearisation::response`]
    /// for whatever a scene or a garment consists of.
    ///
    /// # Errors
    /// As [`Solver::solve`].
    pub fn gradient_at(&self, scene: &Scene<'_>, solution: &Solution) -> Result<Vec<f64>> {
        let prepared = Prepared::new(self, scene)?;
        let mut workspace = Workspace::new(self.vertex_count());
        let x = flat(&solution.positions);
        Error::check_length("solution to take forces at", 3 * self.vertex_count(), x.len())?;
        let mut gradient = Vec::new();
        workspace.evaluate(self, &prepared, &solution.frozen, &x, Some(&mut gradient))?;
        Ok(gradient)
    }
}

impl Linearisation<'_> {
    /// Pivots that had to be replaced: above zero the equilibrium moves freely in some direction and answers along it mean
    /// nothing.
    pub fn replaced_pivots(&self) -> usize {
        self.factor.replaced_pivots
    }
    /// dx*/dp [m per unit] for any p with ∂f/∂p [N per unit], f the gradient (minus the force).
    ///
    /// # Errors
    /// [`Error::Length`], [`Error::Numerics`] where the answer is not finite.
    pub fn response(&self, gradient_change: &[f64]) -> Result<Vec<f64>> {
        let x = self.refined(gradient_change, false)?;
        Ok(x.into_iter().map(|x| -x).collect())
    }
    /// The adjoint w [m per unit of a functional] of v = d(functional)/dx*: the functional's derivative by any p is
    /// wᵀ ∂f/∂p. w = −J⁻ᵀ v.
    ///
    /// # Errors
    /// As [`Linearisation::response`].
    pub fn adjoint(&self, v: &[f64]) -> Result<Vec<f64>> {
        let w = self.refined(v, true)?;
        Ok(w.into_iter().map(|w| -w).collect())
    }
    /// dx*/dΘ · direction [m] for a direction among the material's native parameters, in their units.
    ///
    /// # Errors
    /// As [`Linearisation::response`]; [`Error::Unsupported`] for a material without parameter derivatives.
    pub fn response_to_parameters(&self, direction: &[f64]) -> Result<Vec<f64>> {
        let mut change = vec![0.0; 3 * self.solver.vertex_count()];
        let state = State::new(&self.positions);
        let [strain, bending, ..] = self.solver.forces.weights;
        self.solver.strain.add_by_direction(&state, strain, direction, &mut change)?;
        self.solver.bending.add_by_direction(&state, bending, direction, &mut change)?;
        self.response(&change)
    }
    /// vᵀ dx*/dΘ for every native parameter, by one solve.
    ///
    /// # Errors
    /// As [`Linearisation::response_to_parameters`].
    pub fn adjoint_of_parameters(&self, v: &[f64]) -> Result<Vec<f64>> {
        let w = self.adjoint(v)?;
        let state = State::new(&self.positions);
        let [strain, bending, ..] = self.solver.forces.weights;
        let mut out = self.solver.strain.by_parameter(&state, strain, &w)?;
        let more = self.solver.bending.by_parameter(&state, bending, &w)?;
        out.iter_mut().zip(more).for_each(|(a, b)| *a += b);
        Ok(out)
    }
    /// J times a vector [N]: for products of one's own.
    pub fn multiply(&self, x: &[f64]) -> Vec<f64> {
        self.matrix.multiply(x)
    }

    fn refined(&self, right: &[f64], transposed: bool) -> Result<Vec<f64>> {
        Error::check_length("vector of a sensitivity", 3 * self.solver.vertex_count(), right.len())?;
        let mut b = right.to_vec();
        for (v, _) in self.fixed.iter().enumerate().filter(|f| *f.1) {
            b[3 * v..3 * v + 3].fill(0.0);
        }
        let solve = |b: &[f64]| if transposed { self.factor.solve_transposed(b) } else { self.factor.solve(b) };
        let times = |x: &[f64]| if transposed { self.matrix.multiply_transposed(x) } else { self.matrix.multiply(x) };
        let mut x = solve(&b);
        for _ in 0..REFINEMENTS {
            let rest: Vec<f64> = times(&x).iter().zip(&b).map(|(a, b)| b - a).collect();
            x.iter_mut().zip(solve(&rest)).for_each(|(x, more)| *x += more);
        }
        if let Some(i) = x.iter().position(|x| !x.is_finite()) {
            return Err(Error::numerics(
                "sensitivity of an equilibrium",
                format!("the answer at vertex {} is {}", i / 3, x[i]),
                "look at the soft modes of the solution: something moves without resistance",
            ));
        }
        Ok(x)
    }
}
