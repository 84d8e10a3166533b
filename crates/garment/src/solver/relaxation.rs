//! L-BFGS steps on a garment, contact pairs, friction and stiffness renewed as it moves: what comes before Newton's steps, and what
//! large garments are left with.
//!
//! While pairs, friction and a frozen stiffness are held, forces are the gradient of an energy; the state at rest is one that
//! renewing no longer changes. Newton's steps cost too much to find it: every renewal throws them back. Steps here cost little,
//! those with a factor about as much as twenty without, and one factor serves many of them.

use super::Solver;
use super::factor::{Factor, Kind};
use super::lbfgs::{Balance, Limits, descend};
use super::solution::Progress;
use super::sparse::BlockMatrix;
use super::state::{Frozen, Prepared, Workspace, total};
use super::vector::{largest, moved};
use crate::energy::Tangent;
use caphy_core::{Result, Vec3};

/// Contact pairs are looked for again when a vertex has gone so far [m]: a fraction of the distance of body vertices.
const SEARCH_M: f64 = 1e-3;
/// Longest move of a vertex in one step [m]: below the gap kept from the body, so that nothing jumps through a limb.
const MOVE_M: f64 = 5e-3;
/// Mass times this [1/s²] is added to the matrix: what nothing holds is no faster than that.
const SHIFT: f64 = 1.0;

/// Where the first guess of a step comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Guide {
    /// From the last step.
    Past,
    /// From the projected second derivative, factorised now and then.
    Factor,
    /// The same, and contact pairs and friction stay as they are.
    FactorHeld,
}

impl Guide {
    /// Steps between two looks at the stiffness, where forces are not a gradient unless it is held.
    fn hold(self) -> usize {
        match self {
            Self::Past => 30,
            Self::Factor | Self::FactorHeld => 5,
        }
    }
    /// Steps between two looks at friction; it is renewed with contact pairs, too.
    fn friction(self) -> usize {
        match self {
            Self::Past | Self::FactorHeld => usize::MAX,
            Self::Factor => 10,
        }
    }
    /// Steps within which forces must fall noticeably.
    fn patience(self) -> usize {
        match self {
            Self::Past => 500,
            Self::Factor | Self::FactorHeld => 150,
        }
    }
    /// Steps that one factor serves.
    const AGE: usize = 40;
}

/// How far [`Solver::relax`] came.
pub(super) struct Relaxed {
    pub(super) steps: usize,
    pub(super) factorisations: usize,
    /// Largest force [N].
    pub(super) residual_n: f64,
}

impl Solver {
    /// [`descend`] from `x`.
    pub(super) fn relax(
        &mut self,
        prepared: &Prepared<'_>,
        start: &[Vec3],
        workspace: &mut Workspace,
        (x, frozen): (&mut Vec<f64>, &mut Frozen),
        (guide, steps, tolerance_n): (Guide, usize, f64),
        progress: &dyn Fn(Progress),
    ) -> Result<Relaxed> {
        let limits =
            Limits { steps, max_move_m: self.settings.max_move_m.min(MOVE_M), tolerance_n, patience: guide.patience() };
        let mut problem = Relaxation {
            conservative: self.conservative(),
            solver: self,
            prepared,
            start,
            workspace,
            frozen,
            guide,
            factor: None,
            factor_age: 0,
            factorisations: 0,
            searched: Vec::new(),
            step: 0,
            evaluations: 0,
            progress,
        };
        let answer = descend(x, &limits, &mut problem);
        let factorisations = problem.factorisations;
        self.release();
        let (steps, residual_n) = answer?;
        Ok(Relaxed { steps, factorisations, residual_n })
    }
}

/// A garment while [`descend`] moves it.
struct Relaxation<'r, 's> {
    solver: &'r mut Solver,
    prepared: &'r Prepared<'s>,
    start: &'r [Vec3],
    workspace: &'r mut Workspace,
    frozen: &'r mut Frozen,
    conservative: bool,
    guide: Guide,
    factor: Option<Factor>,
    /// Steps that it has served.
    factor_age: usize,
    factorisations: usize,
    /// Where contact pairs were last searched for.
    searched: Vec<f64>,
    step: usize,
    evaluations: usize,
    progress: &'r dyn Fn(Progress),
}

impl Relaxation<'_, '_> {
    fn renew_friction(&mut self, x: &[f64]) -> Result<()> {
        let origin = (self.start, Some(&self.frozen.friction));
        self.frozen.friction = self.solver.friction(self.prepared, self.frozen, self.workspace, x, origin)?;
        Ok(())
    }
    fn factorise(&mut self, x: &[f64]) -> Result<()> {
        let mut matrix = BlockMatrix::new(self.solver.pattern.clone());
        self.workspace.tangent(self.solver, self.prepared, self.frozen, x, Tangent::Projected, &mut matrix)?;
        matrix.add_diagonal(self.solver.rest.vertex_masses.iter().map(|m| m * SHIFT));
        self.factor = Factor::new(&self.solver.analysis, &matrix, Kind::Cholesky)?;
        self.factorisations += 1;
        self.factor_age = 0;
        Ok(())
    }
}

impl Balance for Relaxation<'_, '_> {
    fn forces(&mut self, x: &[f64], g: &mut Vec<f64>) -> Result<()> {
        self.evaluations += 1;
        let energies = self.workspace.evaluate(self.solver, self.prepared, self.frozen, x, Some(g))?;
        let (residual_n, energy_j) = (largest(g).0, total(&energies));
        (self.progress)(Progress { round: 0, iteration: self.evaluations, residual_n, energy_j });
        Ok(())
    }
    fn renew(&mut self, x: &[f64]) -> Result<bool> {
        let step = self.step;
        self.step += 1;
        let mut renewed = false;
        if !self.conservative && step.is_multiple_of(self.guide.hold()) {
            self.solver.hold(self.workspace.set(x))?;
            renewed = true;
        }
        if self.prepared.scene.body.is_none() || self.guide == Guide::FactorHeld {
            return Ok(renewed);
        }
        if self.searched.is_empty() || largest(&moved(x, -1.0, &self.searched)).0 >= SEARCH_M {
            let Some(new) = self.prepared.search(self.workspace.set(x))? else { return Ok(renewed) };
            let (mut kept, _) = self.solver.kept(self.prepared, self.frozen, new, self.workspace, x, 0.0)?;
            self.searched = x.to_vec();
            std::mem::swap(&mut kept.friction, &mut self.frozen.friction);
            *self.frozen = kept;
        } else if !(step + 1).is_multiple_of(self.guide.friction()) {
            return Ok(renewed);
        }
        self.renew_friction(x)?;
        Ok(true)
    }
    fn guess(&mut self, x: &[f64], q: &[f64]) -> Result<Option<Vec<f64>>> {
        if self.guide == Guide::Past {
            return Ok(None);
        }
        if self.factor.is_none() || self.factor_age == Guide::AGE {
            self.factorise(x)?;
        }
        self.factor_age += 1;
        Ok(self.factor.as_ref().map(|factor| factor.solve(q)))
    }
}
