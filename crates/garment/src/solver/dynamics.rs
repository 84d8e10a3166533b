//! A sequence of backward Euler steps.

use super::Solver;
use super::scene::{Momentum, Scene};
use super::settings::out_of_bounds;
use super::solution::{Progress, Solution};
use caphy_core::{Error, Result, Vec3};

/// A garment in motion: x_{t+1} minimises Σ m/(2Δt²)|x − x_t − Δt v_t|² + E(x) with the body at t + 1, and
/// v_{t+1} = (x_{t+1} − x_t)/Δt.
///
/// Backward Euler is stable for any Δt and damps what is faster than a few steps: a swinging hem loses part of its energy.
#[derive(Debug, Clone, PartialEq)]
pub struct Dynamics {
    positions: Vec<Vec3>,
    velocity: Vec<Vec3>,
    anchors: Option<Vec<Vec3>>,
    /// Body vertices of the last step.
    pairs: Option<Vec<u32>>,
    step: f64,
}

impl Dynamics {
    /// Starts at rest, or with a velocity [m/s].
    ///
    /// # Errors
    /// [`Error::Parameter`] for a time step [s] that is not positive, [`Error::Length`].
    pub fn new(positions: Vec<Vec3>, velocity: Option<Vec<Vec3>>, step: f64) -> Result<Self> {
        if !(step > 0.0 && step.is_finite()) {
            return Err(out_of_bounds("time step", step, "s"));
        }
        let velocity = velocity.unwrap_or_else(|| vec![Vec3::zeros(); positions.len()]);
        Error::check_length("velocities, one per vertex", positions.len(), velocity.len())?;
        Ok(Self { positions, velocity, anchors: None, pairs: None, step })
    }
    /// Present positions [m].
    pub fn positions(&self) -> &[Vec3] {
        &self.positions
    }
    /// Present velocity [m/s].
    pub fn velocity(&self) -> &[Vec3] {
        &self.velocity
    }
    /// One step in the scene of its end. `start` is where the solver begins [m], such as the garment carried along with the body;
    /// `None`: the present positions, whose contacts are then those of a body that moved away under the cloth.
    ///
    /// # Errors
    /// As [`Solver::solve`]; the state is then unchanged.
    pub fn advance(
        &mut self,
        solver: &mut Solver,
        scene: &Scene<'_>,
        start: Option<&[Vec3]>,
        progress: &dyn Fn(Progress),
    ) -> Result<Solution> {
        let momentum = Momentum { step: self.step, now: &self.positions, velocity: &self.velocity };
        let anchors = scene.anchors.or(self.anchors.as_deref());
        let scene = Scene { momentum: Some(momentum), anchors, ..*scene };
        let solution = solver.solve_with(&scene, start.unwrap_or(&self.positions), self.pairs.as_deref(), progress)?;
        self.velocity =
            solution.positions.iter().zip(&self.positions).map(|(x, before)| (x - before) / self.step).collect();
        self.positions.clone_from(&solution.positions);
        self.anchors = Some(solution.anchors.clone());
        self.pairs = solution.pairs().map(<[u32]>::to_vec);
        Ok(solution)
    }
}
