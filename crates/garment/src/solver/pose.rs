//! One pose (or one time step): rounds of Newton steps, contact pairs and friction renewed in between.

use super::Solver;
use super::newton::{Newton, Stop};
use super::scene::{Scene, Springs};
use super::solution::{Method, Outcome, Progress, Solution, SolveReport};
use super::state::{Frozen, Prepared, Workspace, largest, points_of, total};
use crate::energy::{Attachment, BodyState, Friction, State, Touch};
use crate::relax::{RelaxReport, RelaxSettings, relax};
use caphy_core::lanes::Frames;
use caphy_core::{Error, Real, Result, Vec3};

/// Friction limits may be this share off when a solve ends.
const FRICTION_AGREEMENT: f64 = 1e-3;
/// A touching vertex changes its body vertex for one that is nearer by this share, once more for each round, and again for each
/// that ended at rest: pairs that flip for ever are held in the end.
const PREFERENCE: f64 = 0.03;
/// Iterations of L-BFGS for one of Newton.
const LBFGS_STEPS: usize = 20;
/// Evaluations of L-BFGS between two searches for contact pairs: cloth moves by a few millimetres at most in between.
const LBFGS_REFRESH: usize = 4;

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
        Error::check_length("start of the solver", self.vertex_count(), start.len())?;
        let mut x: Vec<f64> = start.iter().flat_map(|p| [p.x, p.y, p.z]).collect();
        Error::check_finite("start of the solver", &x)?;
        self.release();
        let prepared = Prepared::new(self, scene)?;
        let answer = if self.vertex_count() > self.settings.largest_factorised {
            self.solve_lbfgs(&prepared, start, &mut x, progress)
        } else {
            self.solve_newton(&prepared, start, &mut x, progress)
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
        start: &[Vec3],
        x: &mut Vec<f64>,
        progress: &dyn Fn(Progress),
    ) -> Result<Solution> {
        let settings = self.settings;
        let mut workspace = Workspace::new(self.vertex_count());
        let mut newton = Newton::new(self);
        let nearest = prepared.search(workspace.set(x))?;
        let mut frozen = Frozen { nearest, friction: Friction::none(self.vertex_count()) };
        frozen.friction = self.friction(prepared, &frozen, &mut workspace, x, start)?;
        let touching = prepared.scene.body.is_some();
        if touching && prepared.scene.momentum.is_none() && settings.warm_steps > 0 {
            let mut warm = (x.clone(), frozen.clone());
            let steps = settings.warm_steps;
            // A start that is too wild for it is left to Newton's steps.
            if self.lbfgs(prepared, start, &mut workspace, (&mut warm.0, &mut warm.1), steps, progress).is_ok()
                && warm.0.iter().all(|x| x.is_finite())
            {
                *x = warm.0;
                frozen.nearest = prepared.search(workspace.set(x))?;
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

    /// [`relax`] from `x`, with contact pairs and friction renewed every few evaluations.
    fn lbfgs(
        &self,
        prepared: &Prepared<'_>,
        start: &[Vec3],
        workspace: &mut Workspace,
        (x, frozen): (&mut Vec<f64>, &mut Frozen),
        steps: usize,
        progress: &dyn Fn(Progress),
    ) -> Result<RelaxReport> {
        let settings = self.settings;
        let mut frames = workspace.set(x).clone();
        let mut evaluations = 0;
        let relaxing = RelaxSettings {
            iterations: steps,
            max_move_m: settings.max_move_m.min(RelaxSettings::default().max_move_m),
            // The root mean square is below the largest force.
            rest_force_n: settings.tolerance_n / (self.vertex_count().max(1) as f64).sqrt(),
            ..RelaxSettings::default()
        };
        let gradient = |x: &Frames<f64>, g: &mut Frames<f64>| -> Result<()> {
            let values = values_of(x);
            if evaluations % LBFGS_REFRESH == 0 {
                frozen.nearest = prepared.search(x)?;
                frozen.friction = self.friction(prepared, frozen, workspace, &values, start)?;
            }
            evaluations += 1;
            let mut out = Vec::new();
            let energies = workspace.evaluate(self, prepared, frozen, &values, Some(&mut out))?;
            let (residual_n, energy_j) = (largest(&out).0, total(&energies));
            progress(Progress { round: 0, iteration: evaluations, residual_n, energy_j });
            for (lanes, value) in g.data_mut().chunks_exact_mut(<f64 as Real>::LANES).zip(out) {
                lanes.fill(value);
            }
            Ok(())
        };
        let report = relax(&mut frames, &relaxing, gradient, &|_| {})?;
        *x = values_of(&frames);
        Ok(report)
    }

    fn solve_lbfgs(
        &mut self,
        prepared: &Prepared<'_>,
        start: &[Vec3],
        x: &mut Vec<f64>,
        progress: &dyn Fn(Progress),
    ) -> Result<Solution> {
        let mut workspace = Workspace::new(self.vertex_count());
        let mut frozen = Frozen { nearest: None, friction: Friction::none(self.vertex_count()) };
        let steps = self.settings.iterations * LBFGS_STEPS;
        let relaxed = self.lbfgs(prepared, start, &mut workspace, (x, &mut frozen), steps, progress)?;
        let outcome = if relaxed.at_rest.iter().all(|&r| r) { Outcome::Converged } else { Outcome::IterationLimit };
        let report = SolveReport {
            outcome,
            method: Method::Lbfgs,
            residual_n: 0.0,
            residual_vertex: 0,
            iterations: relaxed.iterations,
            factorisations: 0,
            evaluations: 0,
            rounds: workspace.evaluations.div_ceil(LBFGS_REFRESH),
            damped: 0,
            energies: Vec::new(),
            pairs_open: 0,
            friction_open_n: 0.0,
            soft_modes: Vec::new(),
        };
        self.finish(prepared, frozen, workspace, x, report)
    }

    /// Residual, energies, contacts and soft modes at the end.
    fn finish(
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
        let mut nearest = prepared.search(workspace.set(x))?;
        let mut changed = 0;
        if let (Some(new), Some(old), Some(body)) = (&mut nearest, &frozen.nearest, &prepared.scene.body) {
            let with = |nearest: Vec<u32>| Frozen { nearest: Some(nearest), friction: Friction::none(0) };
            let mut touching = vec![false; self.vertex_count()];
            for pairs in [old, &*new] {
                for t in self.touches(prepared, &with(pairs.clone()), workspace, x)? {
                    touching[t.vertex as usize] = true;
                }
            }
            let lanes = <f64 as Real>::LANES;
            for (v, (new, old)) in new.chunks_exact_mut(lanes).zip(old.chunks_exact(lanes)).enumerate() {
                if new[0] == old[0] || !touching[v] {
                    continue;
                }
                let at = Vec3::new(x[3 * v], x[3 * v + 1], x[3 * v + 2]);
                let distance = |id: u32| (body.positions.get(0, 0, id as usize) - at).norm();
                if distance(old[0]) <= distance(new[0]) * (1.0 + PREFERENCE * patience as f64) {
                    new.copy_from_slice(old);
                } else {
                    changed += 1;
                }
            }
        }
        let mut out = Frozen { nearest, friction: Friction::none(self.vertex_count()) };
        out.friction = self.friction(prepared, &out, workspace, x, start)?;
        let friction_open = out.friction.change(&frozen.friction);
        let friction_limit = out.friction.change(&Friction::none(self.vertex_count()));
        Ok(Renewed { frozen: out, changed, friction_open, friction_limit })
    }
}

/// The only frame, flat.
fn values_of(frames: &Frames<f64>) -> Vec<f64> {
    frames.data().chunks_exact(<f64 as Real>::LANES).map(|lanes| lanes[0]).collect()
}
