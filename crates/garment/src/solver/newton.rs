//! Newton steps with contact pairs and friction frozen.

use super::Solver;
use super::factor::{Factor, Kind};
use super::solution::{Outcome, Progress};
use super::sparse::BlockMatrix;
use super::state::{Frozen, Prepared, Workspace, total};
use super::vector::{dot, largest, moved};
use crate::energy::Tangent;
use caphy_core::{Error, Result};

/// Sufficient decrease of the energy, as a share of what the slope promises (Armijo).
const DECREASE: f64 = 1e-4;
/// Energies are sums of some ten thousand terms: differences below this share of their absolute sum are rounding.
const ROUNDING: f64 = 1e-13;
/// Tries of σ for the exact matrix in one step.
const SHIFTS: usize = 3;
/// Most steps between two tries of a matrix that failed before.
const LONGEST_WAIT: usize = 16;

/// Forces below which steps with the unsymmetric derivative are tried, in weights of the heaviest vertex.
const UNSYMMETRIC: f64 = 10.0;

/// How a run of steps ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Stop {
    Converged,
    StepsUsed,
    Stalled,
}

impl From<Stop> for Outcome {
    fn from(stop: Stop) -> Self {
        match stop {
            Stop::Converged => Self::Converged,
            Stop::Stalled => Self::Stalled,
            Stop::StepsUsed => Self::IterationLimit,
        }
    }
}

/// What is remembered from step to step and round to round.
pub(super) struct Newton {
    matrix: BlockMatrix,
    /// σ [1/s²]: σM is added to the matrix, as if the step were one of time σ^-½ without velocity. It holds back what moves freely
    /// without crippling the rest.
    damping: f64,
    smallest_damping: f64,
    /// σ that last made the exact matrix positive definite. Next to a saddle that goes far faster than clamping each element's
    /// curvature, which stiffens every wrinkle.
    shift: f64,
    exact: Patience,
    unsymmetric: Patience,
    /// σ that last made a step with the unsymmetric derivative bring forces down: one vertex at a kink of its table is helped while a
    /// soft mode of the rest is left for later.
    unsymmetric_shift: f64,
    pub(super) iterations: usize,
    pub(super) factorisations: usize,
    pub(super) damped: usize,
}

/// Waits longer after every failure.
#[derive(Default)]
struct Patience {
    wait: usize,
    failures: u32,
}

impl Patience {
    fn ready(&mut self) -> bool {
        if self.wait == 0 {
            return true;
        }
        self.wait -= 1;
        false
    }
    fn failed(&mut self) {
        self.failures += 1;
        self.wait = (1usize << self.failures.min(6)).min(LONGEST_WAIT);
    }
    fn succeeded(&mut self) {
        *self = Self::default();
    }
}

impl Newton {
    pub(super) fn new(solver: &Solver) -> Self {
        let pull = solver.forces.gravity.norm().max(1.0);
        Self {
            matrix: BlockMatrix::new(solver.pattern.clone()),
            damping: 0.0,
            // With it, something in free fall moves by the longest allowed step.
            smallest_damping: pull / solver.settings.max_move_m,
            shift: 0.0,
            exact: Patience::default(),
            unsymmetric: Patience { wait: 3, failures: 0 },
            unsymmetric_shift: 0.0,
            iterations: 0,
            factorisations: 0,
            damped: 0,
        }
    }

    /// Steps until forces are below `tolerance` or `steps` are used up.
    pub(super) fn run(
        &mut self,
        solver: &mut Solver,
        prepared: &Prepared<'_>,
        frozen: &Frozen,
        workspace: &mut Workspace,
        x: &mut Vec<f64>,
        (steps, tolerance): (usize, f64),
        say: &dyn Fn(Progress),
    ) -> Result<Stop> {
        let conservative = solver.conservative();
        let mut g = Vec::new();
        let mut failures = 0;
        for step in 0..=steps {
            if !conservative {
                solver.hold(workspace.set(x))?;
            }
            let energies = workspace.evaluate(solver, prepared, frozen, x, Some(&mut g))?;
            let (residual, vertex) = largest(&g);
            if !residual.is_finite() {
                return Err(Error::numerics(
                    "reference solver",
                    format!("the force on vertex {vertex} is {residual} N"),
                    "start from positions in metres that are not collapsed, and check the material's parameters",
                ));
            }
            say(Progress { round: 0, iteration: self.iterations, residual_n: residual, energy_j: total(&energies) });
            if residual <= tolerance {
                return Ok(Stop::Converged);
            }
            if step == steps {
                return Ok(Stop::StepsUsed);
            }
            self.iterations += 1;
            let gentle = solver.rest.vertex_masses.iter().copied().fold(0.0, f64::max) * solver.forces.gravity.norm();
            if !conservative && residual < UNSYMMETRIC * gentle && self.unsymmetric.ready() {
                if self.unsymmetric_step(solver, prepared, frozen, workspace, x, &g)? {
                    self.unsymmetric.succeeded();
                    continue;
                }
                self.unsymmetric.failed();
                // The trial released the stiffness.
                solver.hold(workspace.set(x))?;
            }
            let d = self.direction(solver, prepared, frozen, workspace, x, &g)?;
            let size: f64 = energies.iter().map(|e| e.1.abs()).sum();
            if self.search(solver, prepared, frozen, workspace, x, (&g, &d), (total(&energies), size))? {
                failures = 0;
            } else {
                failures += 1;
                // Shorter steps along a safer direction.
                self.damping = (16.0 * self.damping).max(self.smallest_damping);
                self.exact.failed();
                if failures > 4 {
                    return Ok(Stop::Stalled);
                }
            }
        }
        Ok(Stop::StepsUsed)
    }

    fn factorise(&mut self, solver: &Solver, kind: Kind) -> Result<Option<Factor>> {
        self.factorisations += 1;
        Factor::new(&solver.analysis, &self.matrix, kind)
    }

    /// −H⁻¹g: with the exact second derivative where that is positive definite, else with the projected one.
    fn direction(
        &mut self,
        solver: &Solver,
        prepared: &Prepared<'_>,
        frozen: &Frozen,
        workspace: &mut Workspace,
        x: &[f64],
        g: &[f64],
    ) -> Result<Vec<f64>> {
        let masses = &solver.rest.vertex_masses;
        if self.damping > 0.0 {
            self.damped += 1;
        }
        if self.exact.ready() {
            workspace.tangent(solver, prepared, frozen, x, Tangent::Exact, &mut self.matrix)?;
            let (mut within, mut shift) = (0.0, self.damping.max(self.shift));
            for _ in 0..SHIFTS {
                let more = shift - within;
                self.matrix.add_diagonal(masses.iter().map(|m| m * more));
                within = shift;
                if let Some(factor) = self.factorise(solver, Kind::Cholesky)? {
                    self.exact.succeeded();
                    self.damped += usize::from(shift > 0.0);
                    self.shift = if shift > self.smallest_damping / 64.0 { 0.25 * shift } else { 0.0 };
                    return Ok(negative(factor.solve(g)));
                }
                shift = (8.0 * shift).max(self.smallest_damping / 16.0);
            }
            self.exact.failed();
        }
        workspace.tangent(solver, prepared, frozen, x, Tangent::Projected, &mut self.matrix)?;
        self.matrix.add_diagonal(masses.iter().map(|m| m * self.damping));
        // Singular where nothing holds the garment: a little more on the diagonal until the factorisation takes it.
        let mut more = 1e-10 * self.matrix.mean_diagonal().max(f64::MIN_POSITIVE);
        for _ in 0..12 {
            if let Some(factor) = self.factorise(solver, Kind::Cholesky)? {
                return Ok(negative(factor.solve(g)));
            }
            self.damped += 1;
            self.matrix.add_diagonal(std::iter::repeat_n(more, masses.len()));
            more *= 30.0;
        }
        Err(Error::numerics(
            "reference solver",
            format!("the tangent matrix has no factorisation, even with {more:e} N/m added to its diagonal"),
            "look for collapsed triangles in the start and for parameters of the material that are far out of bounds",
        ))
    }

    /// Moves along d as far as the energy falls; `false` when it does not.
    fn search(
        &mut self,
        solver: &Solver,
        prepared: &Prepared<'_>,
        frozen: &Frozen,
        workspace: &mut Workspace,
        x: &mut Vec<f64>,
        (g, d): (&[f64], &[f64]),
        (energy, size): (f64, f64),
    ) -> Result<bool> {
        let slope = dot(g, d);
        let reach = largest(d).0;
        if !(slope < 0.0 && reach.is_finite() && slope.is_finite()) {
            return Ok(false);
        }
        let whole = (solver.settings.max_move_m / reach).min(1.0);
        let noise = ROUNDING * size;
        let mut step = whole;
        for _ in 0..24 {
            let trial = moved(x, step, d);
            // Too far can be not finite: that is a reason for a shorter step, not an error.
            let mut value =
                workspace.evaluate(solver, prepared, frozen, &trial, None).map_or(f64::INFINITY, |e| total(&e));
            let mut good = value <= energy + DECREASE * step * slope;
            if !good && value.is_finite() {
                // A hinge that folds through itself is no reason to stop before it.
                value -= solver.bending.jump_between(x, &trial, solver.forces.weights[1])?;
                good = value <= energy + DECREASE * step * slope;
            }
            if !good && (value - energy).abs() <= noise {
                // Below rounding of the energy the forces tell: the slope along d must have fallen.
                let mut ahead = Vec::new();
                workspace.evaluate(solver, prepared, frozen, &trial, Some(&mut ahead))?;
                good = dot(&ahead, d).abs() <= 0.9 * slope.abs() || largest(&ahead).0 < 0.9 * largest(g).0;
            }
            if good {
                let (mut trial, mut value) = (trial, value);
                // Leaving a saddle along a curvature that was clamped away, whole steps are far too short. Where energies are
                // rounding they say nothing of that.
                while -slope > noise && (step == 1.0 || (step > 1.0 && step < 64.0)) {
                    let longer = 2.0 * step;
                    if longer * reach > solver.settings.max_move_m {
                        break;
                    }
                    let next = moved(x, longer, d);
                    let ahead =
                        workspace.evaluate(solver, prepared, frozen, &next, None).map_or(f64::INFINITY, |e| total(&e));
                    if ahead > value + 0.25 * step * slope {
                        break;
                    }
                    (step, trial, value) = (longer, next, ahead);
                }
                if step < 0.3 * whole && self.exact.wait == 0 {
                    // The exact matrix knows nothing of contacts to come.
                    self.exact.wait = 2;
                }
                *x = trial;
                if whole < 0.25 {
                    self.damping = (3.0 * self.damping).max(self.smallest_damping);
                } else if step >= whole {
                    self.damping *= 0.25;
                    if self.damping < 0.05 * self.smallest_damping {
                        self.damping = 0.0;
                    }
                }
                return Ok(true);
            }
            // The minimum of the parabola through what is known, but no less than a tenth.
            let bend = value - energy - slope * step;
            let ideal = if bend > 0.0 && bend.is_finite() { -0.5 * slope * step * step / bend } else { 0.0 };
            step = ideal.clamp(0.1 * step, 0.5 * step);
        }
        Ok(false)
    }

    /// A Newton step on the material's own forces with their unsymmetric derivative; taken where it brings them down.
    fn unsymmetric_step(
        &mut self,
        solver: &mut Solver,
        prepared: &Prepared<'_>,
        frozen: &Frozen,
        workspace: &mut Workspace,
        x: &mut Vec<f64>,
        g: &[f64],
    ) -> Result<bool> {
        solver.release();
        workspace.tangent(solver, prepared, frozen, x, Tangent::Exact, &mut self.matrix)?;
        let masses = &solver.rest.vertex_masses;
        let before = dot(g, g).sqrt();
        let mut ahead = Vec::new();
        let (mut within, mut shift) = (0.0, self.unsymmetric_shift);
        for _ in 0..SHIFTS {
            let more = shift - within;
            self.matrix.add_diagonal(masses.iter().map(|m| m * more));
            within = shift;
            if let Some(factor) = self.factorise(solver, Kind::Lu)? {
                let mut d = factor.solve(g);
                if factor.replaced_pivots > 0 {
                    let rest: Vec<f64> = self.matrix.multiply(&d).iter().zip(g).map(|(a, b)| b - a).collect();
                    d.iter_mut().zip(factor.solve(&rest)).for_each(|(d, more)| *d += more);
                }
                let d = negative(d);
                if largest(&d).0 <= solver.settings.max_move_m {
                    for step in [1.0, 0.5, 0.25, 0.125] {
                        let trial = moved(x, step, &d);
                        workspace.evaluate(solver, prepared, frozen, &trial, Some(&mut ahead))?;
                        if dot(&ahead, &ahead).sqrt() < before * (1.0 - 0.3 * step) {
                            *x = trial;
                            let smallest = self.smallest_damping / 64.0;
                            self.unsymmetric_shift = if shift > smallest && step == 1.0 { 0.25 * shift } else { shift };
                            if self.unsymmetric_shift < smallest {
                                self.unsymmetric_shift = 0.0;
                            }
                            self.damped += usize::from(shift > 0.0);
                            return Ok(true);
                        }
                    }
                }
            }
            shift = (8.0 * shift).max(self.smallest_damping / 16.0);
        }
        self.unsymmetric_shift = shift.min(64.0 * self.smallest_damping);
        Ok(false)
    }
}

fn negative(mut d: Vec<f64>) -> Vec<f64> {
    d.iter_mut().for_each(|d| *d = -*d);
    d
}
