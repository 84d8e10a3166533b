//! One pose (or one time step): rounds of Newton steps, contact pairs and friction renewed in between.

use super::Solver;
use super::newton::{Newton, Stop};
use super::relaxation::Guide;
use super::scene::{Scene, Springs};
use super::solution::{Method, Outcome, Progress, Solution, SolveReport};
use super::state::{Frozen, Habit, Prepared, Workspace, flat, points_of};
use super::vector::largest;
use crate::energy::{Attachment, BodyState, Friction, State, Touch};
use caphy_core::{Error, Result, Vec3};

/// Friction limits may be this share off when a solve ends.
const FRICTION_AGREEMENT: f64 = 1e-3;
/// A touching vertex changes its body vertex for one that is nearer by this share, once more for each round, and again for each
/// that ended at rest: pairs that flip for ever are held in the end.
const PREFERENCE: f64 = 0.03;
/// Iterations of L-BFGS for one of Newton.
const LBFGS_STEPS: usize = 20;
/// Force at which Newton's steps take over from L-BFGS, as a share of the weight of the lightest vertices.
const HANDOVER: f64 = 1e-2;

/// From one look to the next a friction limit grows by this factor at most, or to so many times the vertex's weight. A vertex that has
/// just met another part of the body is pushed hard for a moment; friction by that force would hold all around it in place.
const FRICTION_GROWTH: f64 = 2.0;
const FRICTION_START: f64 = 10.0;

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
        frozen.friction = self.friction(prepared, &frozen, &mut workspace, x, (start, None))?;
        let touching = prepared.scene.body.is_some();
        let mut factorisations = 0;
        if touching {
            let tolerance = self.handover_n();
            for (guide, steps) in [(Guide::Past, settings.warm_steps), (Guide::Factor, settings.guided_steps)] {
                if steps == 0 {
                    continue;
                }
                let mut warm = (x.clone(), frozen.clone());
                let answer = self.relax(
                    prepared,
                    start,
                    &mut workspace,
                    (&mut warm.0, &mut warm.1),
                    (guide, steps, tolerance),
                    progress,
                );
                // A start that is too wild for it is left to Newton's steps.
                if let Ok(relaxed) = answer
                    && warm.0.iter().all(|x| x.is_finite())
                {
                    (*x, frozen) = warm;
                    factorisations += relaxed.factorisations;
                }
            }
            frozen.friction = self.friction(prepared, &frozen, &mut workspace, x, (start, None))?;
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
                outcome = stop.into();
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
            factorisations: factorisations + newton.factorisations,
            rounds,
            damped: newton.damped,
            pairs_open: open.0,
            friction_open_n: open.1,
            ..SolveReport::new(outcome, Method::Newton, newton.iterations)
        };
        self.finish(prepared, frozen, workspace, x, report)
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
        let relaxed =
            self.relax(prepared, start, &mut workspace, (x, &mut frozen), (Guide::Past, steps, tolerance), progress)?;
        let outcome =
            if relaxed.residual_n <= self.settings.tolerance_n { Outcome::Converged } else { Outcome::IterationLimit };
        let report = SolveReport::new(outcome, Method::Lbfgs, relaxed.steps);
        self.finish(prepared, frozen, workspace, x, report)
    }

    /// Force at which Newton's steps take over [N].
    pub(super) fn handover_n(&self) -> f64 {
        let weight = self.rest.mass() * self.forces.gravity.norm() / self.vertex_count().max(1) as f64;
        self.settings.tolerance_n.max(HANDOVER * weight)
    }

    /// Contact pairs and friction as they are found at `x`.
    pub(super) fn contacts_at(
        &self,
        prepared: &Prepared<'_>,
        workspace: &mut Workspace,
        x: &[f64],
        (start, pairs): (&[Vec3], Option<&[u32]>),
    ) -> Result<Frozen> {
        let mut frozen = self.first_pairs(prepared, pairs, workspace, x)?;
        frozen.friction = self.friction(prepared, &frozen, workspace, x, (start, None))?;
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
    pub(super) fn kept(
        &self,
        prepared: &Prepared<'_>,
        old: &Frozen,
        mut new: Vec<u32>,
        workspace: &mut Workspace,
        x: &[f64],
        preference: f64,
    ) -> Result<(Frozen, usize)> {
        let (mut changed, mut habits) = (0, old.habits.clone());
        habits.resize(self.vertex_count(), Habit::default());
        if let Some(before) = &old.nearest {
            let mut touching = vec![false; self.vertex_count()];
            let now = Frozen::new(Some(new.clone()), Friction::none(0));
            for frozen in [old, &now] {
                for t in self.touches(prepared, frozen, workspace, x)? {
                    touching[t.vertex as usize] = true;
                }
            }
            let margin = self.forces.contact.margin;
            changed = prepared.keep_pairs(x, before, &mut new, &touching, (preference, margin), &mut habits);
        }
        let mut out = Frozen::new(Some(new), Friction::none(self.vertex_count()));
        out.habits = habits;
        Ok((out, changed))
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

    /// Friction with the normal forces at `x`, where those have not grown by leaps since `before`.
    pub(super) fn friction(
        &self,
        prepared: &Prepared<'_>,
        frozen: &Frozen,
        workspace: &mut Workspace,
        x: &[f64],
        (start, before): (&[Vec3], Option<&Friction>),
    ) -> Result<Friction> {
        let n = self.vertex_count();
        if self.settings.friction == 0.0 {
            return Ok(Friction::none(n));
        }
        let mut touches = self.touches(prepared, frozen, workspace, x)?;
        if let Some(before) = before {
            let limits = before.limits();
            for t in &mut touches {
                let v = t.vertex as usize;
                let grown = FRICTION_GROWTH * limits[v] / self.settings.friction;
                let least = FRICTION_START * self.rest.vertex_masses[v] * self.forces.gravity.norm();
                t.force = t.force.min(grown.max(least));
            }
        }
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
        out.friction = self.friction(prepared, &out, workspace, x, (start, Some(&frozen.friction)))?;
        let friction_open = out.friction.change(&frozen.friction);
        let friction_limit = out.friction.change(&Friction::none(self.vertex_count()));
        Ok(Renewed { frozen: out, changed, friction_open, friction_limit })
    }
}
