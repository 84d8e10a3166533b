//! One pose (or one time step): rounds of Newton steps, contact pairs and friction renewed in between.

use super::Solver;
use super::lbfgs::{Balance, Limits, descend};
use super::newton::{Newton, Stop};
use super::scene::{Scene, Springs};
use super::solution::{Method, Outcome, Progress, Solution, SolveReport};
use super::state::{Frozen, Prepared, Workspace, flat, points_of, total};
use super::vector::{largest, moved};
use crate::energy::{Attachment, BodyState, Friction, State, Touch};
use caphy_core::{Error, Result, Vec3};

/// Friction limits may be this share off when a solve ends.
const FRICTION_AGREEMENT: f64 = 1e-3;
/// A touching vertex changes its body vertex for one that is nearer by this share, once more for each round, and again for each
/// that ended at rest: pairs that flip for ever are held in the end.
const PREFERENCE: f64 = 0.03;
/// Iterations of L-BFGS for one of Newton.
const LBFGS_STEPS: usize = 20;
/// L-BFGS looks for contact pairs again when a vertex has gone so far [m]: a fraction of the distance of body vertices.
const SEARCH_M: f64 = 1e-3;

/// Longest move of a vertex in one step of L-BFGS [m]: below the gap kept from the body, so that nothing jumps through a limb.
const LBFGS_MOVE_M: f64 = 5e-3;

/// Steps of L-BFGS between two looks at the stiffness, where forces are not a gradient unless it is held.
const HOLD_STEPS: usize = 30;
/// L-BFGS steps within which forces must fall noticeably before Newton's steps take over.
const LBFGS_PATIENCE: usize = 500;
/// Force at which Newton's steps take over from L-BFGS, as a share of the weight of the lightest vertices.
const HANDOVER: f64 = 1e-2;

/// Answers of a renewal.
struct Renewed {
    frozen: Frozen,
    changed: usize,
    friction_open: f64,
    friction_limit: f64,
}

impl Solver {
    /// Brings the garment to rest from `start` [m] in a scene, or through a time step where the scene has momentum.
    ///
    /// Robust from a penetrating start: each vertex is pushed out along the normal of its nearest body vertex, however deep. The
    /// answer may be unconverged ([`Solution::report`] says how far it came); it is always finite. The same bits on any number
    /// of threads.
    ///
    /// # Errors
    /// [`Error::Length`] and [`Error::NonFinite`] for a bad start, [`Error::Config`] for a scene without what a term needs,
    /// [`Error::Numerics`] where forces are not finite, errors of the material and of the scene's search.
    pub fn solve(&mut self, scene: &Scene<'_>, start: &[Vec3], progress: &dyn Fn(Progress)) -> Result<Solution> {
        self.solve_with(scene, start, None, progress)
    }

    /// The next pose of a sequence: [`Solver::solve`] with the contacts of the pose before, so that cloth that two limbs press between
    /// them stays on its side. `start` [m] is the garment carried along with the body.
    ///
    /// How long the garment is relaxed before Newton's steps follows from how far from rest it starts.
    ///
    /// # Errors
    /// As [`Solver::solve`].
    pub fn solve_from(
        &mut self,
        previous: &Solution,
        scene: &Scene<'_>,
        start: &[Vec3],
        progress: &dyn Fn(Progress),
    ) -> Result<Solution> {
        self.solve_with(scene, start, previous.pairs(), progress)
    }

    pub(super) fn solve_with(
        &mut self,
        scene: &Scene<'_>,
        start: &[Vec3],
        pairs: Option<&[u32]>,
        progress: &dyn Fn(Progress),
    ) -> Result<Solution> {
        Error::check_length("start of the solver", self.vertex_count(), start.len())?;
        let mut x = flat(start);
        Error::check_finite("start of the solver", &x)?;
        self.release();
        let prepared = Prepared::new(self, scene)?;
        let answer = if self.vertex_count() > self.settings.largest_factorised {
            self.solve_lbfgs(&prepared, (start, pairs), &mut x, progress)
        } else {
            self.solve_newton(&prepared, (start, pairs), &mut x, progress)
        };
        self.release();
        answer
    }

    /// The same from a scan: first pulled to points that are known for some vertices, then let go in steps. `targets` [m] in the
    /// order of `vertices`.
    ///
    /// The springs carry each vertex's weight at 1 mm times λ = 0.3, 0.1, 0.03, 0 (see the reference on fabric estimation): this
    /// keeps the garment on the buckling branch of the scan. Returns the last, free solution.
    ///
    /// # Errors
    /// As [`Solver::solve`], and those of [`Attachment::springs`].
    pub fn attach_and_release(
        &mut self,
        scene: &Scene<'_>,
        start: &[Vec3],
        (vertices, targets): (&[u32], &[Vec3]),
        progress: &dyn Fn(Progress),
    ) -> Result<Solution> {
        Error::check_length("scan points, one per attached vertex", vertices.len(), targets.len())?;
        let mut at = start.to_vec();
        for lambda in [0.3, 0.1, 0.03] {
            let weight = lambda * 9.81 / 1e-3;
            let masses = &self.rest.vertex_masses;
            let stiffness: Vec<f64> =
                vertices.iter().map(|&v| weight * masses.get(v as usize).copied().unwrap_or(0.0)).collect();
            let attachment = Attachment::springs(vertices, &stiffness, self.vertex_count())?;
            let pulled = Scene { springs: Some(Springs { attachment: &attachment, targets }), ..*scene };
            at = self.solve(&pulled, &at, progress)?.positions;
        }
        self.solve(scene, &at, progress)
    }

    fn solve_newton(
        &mut self,
        prepared: &Prepared<'_>,
        (start, pairs): (&[Vec3], Option<&[u32]>),
        x: &mut Vec<f64>,
        progress: &dyn Fn(Progress),
    ) -> Result<Solution> {
        let settings = self.settings;
        let mut workspace = Workspace::new(self.vertex_count());
        let mut newton = Newton::new(self);
        let mut frozen = self.first_pairs(prepared, pairs, &mut workspace, x)?;
        frozen.friction = self.friction(prepared, &frozen, &mut workspace, x, start)?;
        let touching = prepared.scene.body.is_some();
        if touching && settings.warm_steps > 0 {
            let weight = self.rest.mass() * self.forces.gravity.norm() / self.vertex_count().max(1) as f64;
            let tolerance = settings.tolerance_n.max(HANDOVER * weight);
            let mut warm = (x.clone(), frozen.clone());
            let steps = settings.warm_steps;
            // A start that is too wild for it is left to Newton's steps.
            if self
                .lbfgs(prepared, start, &mut workspace, (&mut warm.0, &mut warm.1), (steps, tolerance), progress)
                .is_ok()
                && warm.0.iter().all(|x| x.is_finite())
            {
                *x = warm.0;
                frozen = warm.1;
                frozen.friction = self.friction(prepared, &frozen, &mut workspace, x, start)?;
            }
        }
        let mut outcome = Outcome::IterationLimit;
        let (mut rounds, mut settled, mut open) = (0, 0, (0, 0.0));
        // Pairs change while the garment moves far; near rest they rarely do and a round may take its time.
        while rounds < settings.rounds.max(1) && newton.iterations < settings.iterations {
            let left = settings.iterations - newton.iterations;
            let steps = if touching { settings.steps_per_round.max(1).min(left) } else { left };
            let say = |p: Progress| progress(Progress { round: rounds, ..p });
            let stop = newton.run(self, prepared, &frozen, &mut workspace, x, (steps, settings.tolerance_n), &say)?;
            rounds += 1;
            if !touching {
                outcome = match stop {
                    Stop::Converged => Outcome::Converged,
                    Stop::Stalled => Outcome::Stalled,
                    Stop::StepsUsed => Outcome::IterationLimit,
                };
                break;
            }
            if stop != Stop::StepsUsed {
                settled += 1;
            }
            let new = self.renew(prepared, &frozen, &mut workspace, (x, start), rounds + settled)?;
            open = (new.changed, new.friction_open);
            let agreed = new.friction_open <= settings.tolerance_n.max(FRICTION_AGREEMENT * new.friction_limit);
            if stop != Stop::StepsUsed && new.changed == 0 && agreed {
                outcome = if stop == Stop::Converged { Outcome::Converged } else { Outcome::Stalled };
                break;
            }
            frozen = new.frozen;
            if stop == Stop::Converged && rounds == settings.rounds.max(1) {
                outcome = Outcome::PairsOpen;
            }
        }
        let report = SolveReport {
            outcome,
            method: Method::Newton,
            residual_n: 0.0,
            residual_vertex: 0,
            iterations: newton.iterations,
            factorisations: newton.factorisations,
            evaluations: 0,
            rounds,
            damped: newton.damped,
            energies: Vec::new(),
            pairs_open: open.0,
            friction_open_n: open.1,
            soft_modes: Vec::new(),
        };
        self.finish(prepared, frozen, workspace, x, report)
    }

    /// [`descend`] from `x`, with contact pairs and friction renewed as the garment moves.
    fn lbfgs(
        &mut self,
        prepared: &Prepared<'_>,
        start: &[Vec3],
        workspace: &mut Workspace,
        (x, frozen): (&mut Vec<f64>, &mut Frozen),
        (steps, tolerance_n): (usize, f64),
        progress: &dyn Fn(Progress),
    ) -> Result<(usize, f64)> {
        let limits = Limits {
            steps,
            max_move_m: self.settings.max_move_m.min(LBFGS_MOVE_M),
            tolerance_n,
            patience: LBFGS_PATIENCE,
        };
        let conservative = self.conservative();
        let mut problem = Relaxing {
            solver: self,
            prepared,
            start,
            workspace,
            frozen,
            searched: Vec::new(),
            held: 0,
            conservative,
            count: 0,
            progress,
        };
        let answer = descend(x, &limits, &mut problem);
        self.release();
        answer
    }

    fn solve_lbfgs(
        &mut self,
        prepared: &Prepared<'_>,
        (start, pairs): (&[Vec3], Option<&[u32]>),
        x: &mut Vec<f64>,
        progress: &dyn Fn(Progress),
    ) -> Result<Solution> {
        let mut workspace = Workspace::new(self.vertex_count());
        let mut frozen = self.first_pairs(prepared, pairs, &mut workspace, x)?;
        let steps = self.settings.iterations * LBFGS_STEPS;
        let tolerance = self.settings.tolerance_n;
        let (iterations, residual) =
            self.lbfgs(prepared, start, &mut workspace, (x, &mut frozen), (steps, tolerance), progress)?;
        let outcome = if residual <= self.settings.tolerance_n { Outcome::Converged } else { Outcome::IterationLimit };
        let report = SolveReport {
            outcome,
            method: Method::Lbfgs,
            residual_n: 0.0,
            residual_vertex: 0,
            iterations,
            factorisations: 0,
            evaluations: 0,
            rounds: 0,
            damped: 0,
            energies: Vec::new(),
            pairs_open: 0,
            friction_open_n: 0.0,
            soft_modes: Vec::new(),
        };
        self.finish(prepared, frozen, workspace, x, report)
    }

    /// Contact pairs and friction as they are found at `x`.
    pub(super) fn contacts_at(
        &self,
        prepared: &Prepared<'_>,
        workspace: &mut Workspace,
        x: &[f64],
        start: &[Vec3],
    ) -> Result<Frozen> {
        let mut frozen = self.first_pairs(prepared, None, workspace, x)?;
        frozen.friction = self.friction(prepared, &frozen, workspace, x, start)?;
        Ok(frozen)
    }

    /// Contact pairs at the start, on the side where they were before.
    fn first_pairs(
        &self,
        prepared: &Prepared<'_>,
        pairs: Option<&[u32]>,
        workspace: &mut Workspace,
        x: &[f64],
    ) -> Result<Frozen> {
        let nearest = prepared.search(workspace.set(x))?;
        let mut frozen = Frozen::new(nearest, Friction::none(self.vertex_count()));
        if let (Some(old), Some(new)) = (pairs, frozen.nearest.clone())
            && old.len() == new.len()
            && old.iter().all(|&id| prepared.has_body_vertex(id))
        {
            let old = Frozen::new(Some(old.to_vec()), Friction::none(0));
            frozen = self.kept(prepared, &old, new, workspace, x, 0.0)?.0;
        }
        Ok(frozen)
    }

    /// New pairs where they are clearly better than the old ones of touching vertices, and how many of those changed.
    fn kept(
        &self,
        prepared: &Prepared<'_>,
        old: &Frozen,
        mut new: Vec<u32>,
        workspace: &mut Workspace,
        x: &[f64],
        preference: f64,
    ) -> Result<(Frozen, usize)> {
        let mut changed = 0;
        if let Some(before) = &old.nearest {
            let mut touching = vec![false; self.vertex_count()];
            let now = Frozen::new(Some(new.clone()), Friction::none(0));
            for frozen in [old, &now] {
                for t in self.touches(prepared, frozen, workspace, x)? {
                    touching[t.vertex as usize] = true;
                }
            }
            changed = prepared.keep_pairs(x, before, &mut new, &touching, (preference, self.forces.contact.margin));
        }
        Ok((Frozen::new(Some(new), Friction::none(self.vertex_count())), changed))
    }

    /// Residual, energies, contacts and soft modes at the end.
    pub(super) fn finish(
        &mut self,
        prepared: &Prepared<'_>,
        frozen: Frozen,
        mut workspace: Workspace,
        x: &[f64],
        mut report: SolveReport,
    ) -> Result<Solution> {
        self.release();
        let mut g = Vec::new();
        let energies = workspace.evaluate(self, prepared, &frozen, x, Some(&mut g))?;
        (report.residual_n, report.residual_vertex) = largest(&g);
        report.energies = energies.into_iter().map(|(name, value)| (name.to_string(), value)).collect();
        let contacts = self.touches(prepared, &frozen, &mut workspace, x)?;
        if self.settings.soft_modes > 0 && self.vertex_count() <= self.settings.largest_factorised {
            report.soft_modes = self.soft_modes(prepared, &frozen, &mut workspace, x)?;
        }
        report.evaluations = workspace.evaluations;
        let positions = points_of(x);
        let anchors = frozen.friction.anchors(&positions);
        Ok(Solution { positions, contacts, anchors, report, frozen })
    }

    fn touches(
        &self,
        prepared: &Prepared<'_>,
        frozen: &Frozen,
        workspace: &mut Workspace,
        x: &[f64],
    ) -> Result<Vec<Touch>> {
        let Some(body) = &prepared.scene.body else { return Ok(Vec::new()) };
        let frame = workspace.set(x);
        let state = BodyState { positions: body.positions, normals: body.normals, nearest: frozen.nearest.as_deref() };
        self.collision.contacts(&State::new(frame).with_body(state), self.forces.weights[3])
    }

    /// Friction with the normal forces at `x`.
    fn friction(
        &self,
        prepared: &Prepared<'_>,
        frozen: &Frozen,
        workspace: &mut Workspace,
        x: &[f64],
        start: &[Vec3],
    ) -> Result<Friction> {
        let n = self.vertex_count();
        if self.settings.friction == 0.0 {
            return Ok(Friction::none(n));
        }
        let touches = self.touches(prepared, frozen, workspace, x)?;
        let origin = match (prepared.scene.anchors, &prepared.scene.momentum) {
            (Some(anchors), _) => {
                Error::check_length("anchors of friction", n, anchors.len())?;
                anchors
            }
            (None, Some(past)) => past.now,
            (None, None) => start,
        };
        Friction::new(&touches, self.settings.friction, self.settings.slip_m, n, |t| {
            origin[t.vertex as usize] + prepared.carried(t.body)
        })
    }

    /// Pairs and friction at `x`; pairs stay by [`PREFERENCE`] times `patience`.
    fn renew(
        &self,
        prepared: &Prepared<'_>,
        frozen: &Frozen,
        workspace: &mut Workspace,
        (x, start): (&[f64], &[Vec3]),
        patience: usize,
    ) -> Result<Renewed> {
        let (mut out, changed) = match prepared.search(workspace.set(x))? {
            Some(new) => self.kept(prepared, frozen, new, workspace, x, PREFERENCE * patience as f64)?,
            None => (Frozen::new(None, Friction::none(self.vertex_count())), 0),
        };
        out.friction = self.friction(prepared, &out, workspace, x, start)?;
        let friction_open = out.friction.change(&frozen.friction);
        let friction_limit = out.friction.change(&Friction::none(self.vertex_count()));
        Ok(Renewed { frozen: out, changed, friction_open, friction_limit })
    }
}

/// A garment while [`descend`] moves it.
struct Relaxing<'r, 's> {
    solver: &'r mut Solver,
    prepared: &'r Prepared<'s>,
    start: &'r [Vec3],
    workspace: &'r mut Workspace,
    frozen: &'r mut Frozen,
    /// Where contact pairs were last searched for.
    searched: Vec<f64>,
    /// Steps with the present stiffness.
    held: usize,
    conservative: bool,
    count: usize,
    progress: &'r dyn Fn(Progress),
}

impl Balance for Relaxing<'_, '_> {
    fn forces(&mut self, x: &[f64], g: &mut Vec<f64>) -> Result<()> {
        self.count += 1;
        let energies = self.workspace.evaluate(self.solver, self.prepared, self.frozen, x, Some(g))?;
        let (residual_n, energy_j) = (largest(g).0, total(&energies));
        (self.progress)(Progress { round: 0, iteration: self.count, residual_n, energy_j });
        Ok(())
    }
    fn renew(&mut self, x: &[f64]) -> Result<bool> {
        let mut renewed = false;
        if !self.conservative {
            // In between, forces are the gradient of an energy.
            if self.held.is_multiple_of(HOLD_STEPS) {
                self.solver.hold(self.workspace.set(x))?;
                renewed = true;
            }
            self.held += 1;
        }
        if self.prepared.scene.body.is_none() {
            return Ok(renewed);
        }
        if !self.searched.is_empty() && largest(&moved(x, -1.0, &self.searched)).0 < SEARCH_M {
            return Ok(renewed);
        }
        let Some(new) = self.prepared.search(self.workspace.set(x))? else { return Ok(renewed) };
        let (kept, _) = self.solver.kept(self.prepared, self.frozen, new, self.workspace, x, 0.0)?;
        self.searched = x.to_vec();
        *self.frozen = kept;
        self.frozen.friction = self.solver.friction(self.prepared, self.frozen, self.workspace, x, self.start)?;
        Ok(true)
    }
}
