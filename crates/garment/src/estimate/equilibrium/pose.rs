//! One pose: its solver, its shape, and how that answers to the unknowns.

use super::super::capture::{Capture, Surroundings};
use super::super::cut::eased;
use super::super::rows::{Comparison, Row};
use super::Problem;
use super::unknowns::Unknowns;
use crate::energy::Attachment;
use crate::solver::{Contacts, Obstacle, Scene, Solution, Solver, SolverSettings, Springs};
use caphy_core::lanes::Frames;
use caphy_core::material::MaterialModel;
use caphy_core::{Error, Result, Vec3};
use nalgebra::{DMatrix, DVector};
use std::sync::Arc;

/// Step of differences by ease, and by the body's offset in its unit.
const EASE_STEP: f64 = 1e-4;
const OFFSET_STEP: f64 = 1e-2;
/// A pose counts as at rest when no vertex is pushed harder than this share of its weight, or than the solver was asked for.
const AT_REST: f64 = 1e-3;
/// Newton steps of a trial: near an equilibrium it takes one or two; one that needs more went too far.
const TRIAL_STEPS: usize = 25;
/// Farthest that the linear forecast of a shape may move a vertex [m]: beyond, the step starts from the old shape.
const FORECAST_M: f64 = 1e-3;

/// Springs to the scan while the fit begins.
pub(crate) struct Pull {
    attachment: Attachment<f64>,
    targets: Vec<Vec3>,
}

/// A pose solved for at some unknowns.
pub(crate) struct Trial {
    pub(crate) solution: Solution,
    pub(crate) rows: Vec<Row>,
    /// Σ share ρ(distance/σ).
    pub(crate) cost: f64,
    pub(crate) at_rest: bool,
}

impl Trial {
    /// (2 Σ ρ over measurements, their number).
    pub(crate) fn chi2(&self, sigma: f64, robust_at: f64) -> (f64, usize) {
        let counted = self.rows.iter().filter(|r| r.counts);
        let sum = counted.clone().map(|r| 2.0 * huber(r.distance / sigma, robust_at).0).sum();
        (sum, counted.count())
    }
}

/// Rows of a pose by all unknowns.
pub(crate) struct Slopes {
    /// ∂(distance/σ)/∂y, shape [row][unknown].
    pub(crate) by_unknown: DMatrix<f64>,
    /// distance/σ.
    pub(crate) residual: DVector<f64>,
    /// Share times the robust weight.
    pub(crate) weight: DVector<f64>,
    /// Whether a row is a measurement.
    pub(crate) counts: Vec<bool>,
    /// dx*/dy per unknown [m], shape [unknown][vertex][3].
    pub(crate) responses: Vec<Vec<f64>>,
}

/// ρ(r) and its weight ρ′(r)/r.
pub(crate) fn huber(r: f64, k: f64) -> (f64, f64) {
    if r.abs() <= k { (0.5 * r * r, 1.0) } else { (k * r.abs() - 0.5 * k * k, k / r.abs()) }
}

pub(crate) struct PoseFit<'p> {
    problem: &'p Problem,
    pub(crate) capture: &'p Capture,
    pub(crate) comparison: Comparison,
    /// Noise of the scan [m].
    pub(crate) sigma: f64,
    solver: Solver,
    /// Of the solver's rest state, as the unknowns have it; empty: as cut.
    ease: Vec<f64>,
    /// The present shape [m].
    pub(crate) x: Vec<Vec3>,
    /// Where contact pairs and friction were last looked for: trials hold them, or a step would be judged by which pair flips.
    /// `None`: to be looked for.
    pub(crate) contacts: Option<Solution>,
    /// Whether the shape was brought to rest before, contacts and all: from then on they are looked for once at a time.
    pub(crate) settled: bool,
}

impl<'p> PoseFit<'p> {
    pub(crate) fn new(problem: &'p Problem, capture: &'p Capture) -> Result<Self> {
        capture.check(&problem.rest)?;
        let solver = Solver::new(&problem.rest, problem.material.clone(), problem.forces, problem.solver)?;
        if !solver.held_vertices().is_empty() {
            let what = format!("targets of held vertices in pose `{}`", capture.name);
            Error::check_length(&what, solver.held_vertices().len(), capture.targets.len())?;
        }
        Ok(Self {
            problem,
            capture,
            comparison: Comparison::new(&problem.rest, &capture.scan, &capture.fixed)?,
            sigma: capture.noise(&problem.rest)?,
            solver,
            ease: Vec::new(),
            x: capture.start.clone(),
            contacts: None,
            settled: false,
        })
    }
    pub(crate) fn set_settings(&mut self, settings: SolverSettings) -> Result<()> {
        self.contacts = None;
        self.solver.set_settings(settings)
    }
    fn configure(&mut self, material: &Arc<dyn MaterialModel>, ease: &[f64]) -> Result<()> {
        if ease != self.ease {
            let rest = eased(&self.problem.rest, &self.problem.parts, ease)?;
            self.solver = Solver::new(&rest, material.clone(), self.problem.forces, *self.solver.settings())?;
            self.ease = ease.to_vec();
        } else {
            self.solver.set_material(material.clone());
        }
        Ok(())
    }
    /// Springs of λ weights per mm to what the scan shows near the present shape; `None` for λ = 0.
    pub(crate) fn pull(&self, lambda: f64) -> Result<Option<Pull>> {
        if lambda == 0.0 {
            return Ok(None);
        }
        let (vertices, targets) = self.comparison.targets(&self.x)?;
        let masses = &self.problem.rest.vertex_masses;
        let stiffness: Vec<f64> =
            vertices.iter().map(|&v| lambda * masses[v as usize] * self.problem.forces.gravity.norm() / 1e-3).collect();
        let attachment = Attachment::springs(&vertices, &stiffness, self.problem.rest.vertex_count())?;
        Ok(Some(Pull { attachment, targets }))
    }

    /// Brings the cloth to rest from the present shape, or from one that is forecast.
    pub(crate) fn attempt(
        &mut self,
        (unknowns, y): (&Unknowns, &[f64]),
        material: &Arc<dyn MaterialModel>,
        pull: Option<&Pull>,
        forecast: Option<&[f64]>,
        robust_at: f64,
    ) -> Result<Trial> {
        self.configure(material, unknowns.eases(y))?;
        let body = self.capture.body.as_ref().map(|b| unknowns.body(b, y));
        let start = match forecast {
            Some(d) if d.iter().all(|d| d.abs() <= FORECAST_M) => {
                self.x.iter().zip(d.chunks_exact(3)).map(|(x, d)| x + Vec3::new(d[0], d[1], d[2])).collect()
            }
            _ => self.x.clone(),
        };
        let capture = self.capture;
        let solver = &mut self.solver;
        let settings = *solver.settings();
        if forecast.is_some() {
            solver.set_settings(SolverSettings { iterations: settings.iterations.min(TRIAL_STEPS), ..settings })?;
        }
        let how = How::new(self.settled && body.is_some(), self.contacts.as_ref(), capture);
        let solution = in_scene(capture, body.as_ref(), pull, |scene| solved(solver, how, scene, &start));
        solver.set_settings(settings)?;
        let solution = solution?;
        self.settled = true;
        if self.contacts.is_none() && body.is_some() {
            self.contacts = Some(solution.clone());
        }
        let weight = self.problem.rest.mass() * self.problem.forces.gravity.norm() / start.len() as f64;
        let at_rest = solution.report.residual_n <= (AT_REST * weight).max(settings.tolerance_n);
        let rows = self.comparison.rows(&solution.positions)?;
        let cost = rows.iter().map(|r| r.share * huber(r.distance / self.sigma, robust_at).0).sum();
        Ok(Trial { solution, rows, cost, at_rest })
    }

    /// How the rows answer to the unknowns, where the pose was last solved for.
    pub(crate) fn slopes(
        &mut self,
        (unknowns, y): (&Unknowns, &[f64]),
        material: &Arc<dyn MaterialModel>,
        pull: Option<&Pull>,
        trial: &Trial,
        robust_at: f64,
    ) -> Result<Slopes> {
        let ease = unknowns.eases(y);
        self.configure(material, ease)?;
        let body = self.capture.body.as_ref().map(|b| unknowns.body(b, y));
        let capture = self.capture;
        let solver = &self.solver;
        let mut changes: Vec<Vec<f64>> = Vec::new();
        for which in 0..ease.len() {
            let force = |sign: f64| -> Result<Vec<f64>> {
                let mut to = ease.to_vec();
                to[which] += sign * EASE_STEP;
                let rest = eased(&self.problem.rest, &self.problem.parts, &to)?;
                let other = Solver::new(&rest, material.clone(), self.problem.forces, *solver.settings())?;
                in_scene(capture, body.as_ref(), pull, |scene| other.gradient_at(scene, &trial.solution))
            };
            changes.push(difference(force(1.0)?, &force(-1.0)?, EASE_STEP));
        }
        for shape in 0..4 {
            let Some(at) = unknowns.offset_at(shape) else { continue };
            let force = |sign: f64| -> Result<Vec<f64>> {
                let mut to = y.to_vec();
                to[at] += sign * OFFSET_STEP;
                let body = capture.body.as_ref().map(|b| unknowns.body(b, &to));
                in_scene(capture, body.as_ref(), pull, |scene| solver.gradient_at(scene, &trial.solution))
            };
            changes.push(difference(force(1.0)?, &force(-1.0)?, OFFSET_STEP));
        }
        let responses = in_scene(capture, body.as_ref(), pull, |scene| {
            let line = solver.linearise(scene, &trial.solution)?;
            let mut out = Vec::with_capacity(unknowns.len());
            for k in 0..unknowns.fabric() {
                out.push(line.response_to_parameters(&unknowns.reduction.direction(&y[..unknowns.fabric()], k))?);
            }
            for change in &changes {
                out.push(line.response(change)?);
            }
            Ok(out)
        })?;
        let rows = &trial.rows;
        let along = |r: &Row, s: &[f64]| project(r, s) / self.sigma;
        Ok(Slopes {
            by_unknown: DMatrix::from_fn(rows.len(), responses.len(), |i, k| along(&rows[i], &responses[k])),
            residual: DVector::from_iterator(rows.len(), rows.iter().map(|r| r.distance / self.sigma)),
            weight: DVector::from_iterator(
                rows.len(),
                rows.iter().map(|r| r.share * huber(r.distance / self.sigma, robust_at).1),
            ),
            counts: rows.iter().map(|r| r.counts).collect(),
            responses,
        })
    }

    /// The softest modes at the present shape, without springs.
    pub(crate) fn soft_modes(
        &mut self,
        (unknowns, y): (&Unknowns, &[f64]),
        material: &Arc<dyn MaterialModel>,
        count: usize,
    ) -> Result<Vec<crate::solver::SoftMode>> {
        let settings = *self.solver.settings();
        self.configure(material, unknowns.eases(y))?;
        self.solver.set_settings(SolverSettings { soft_modes: count, ..settings })?;
        let body = self.capture.body.as_ref().map(|b| unknowns.body(b, y));
        let how = How::new(self.settled && body.is_some(), self.contacts.as_ref(), self.capture);
        let (capture, x, solver) = (self.capture, &self.x, &mut self.solver);
        let answer = in_scene(capture, body.as_ref(), None, |scene| solved(solver, how, scene, x));
        self.solver.set_settings(settings)?;
        Ok(answer?.report.soft_modes)
    }
}

/// Whether contacts are held.
#[derive(Clone, Copy)]
enum How<'a> {
    Held(Contacts<'a>),
    /// Looked for until they stay, from a solution before where there is one.
    Found(Option<&'a Solution>),
}

impl<'a> How<'a> {
    /// Held where a pose has `settled` before.
    fn new(settled: bool, contacts: Option<&'a Solution>, capture: &'a Capture) -> Self {
        let worn = capture.worn.as_deref();
        match (settled, contacts) {
            (true, Some(contacts)) => Self::Held(Contacts::Of(contacts)),
            (true, None) => Self::Held(Contacts::AtStart(worn)),
            (false, _) => Self::Found(worn),
        }
    }
}

/// A shape at rest.
fn solved(solver: &mut Solver, how: How<'_>, scene: &Scene<'_>, start: &[Vec3]) -> Result<Solution> {
    match how {
        How::Held(contacts) => solver.solve_held(contacts, scene, start, &|_| {}),
        How::Found(Some(worn)) => solver.solve_from(worn, scene, start, &|_| {}),
        How::Found(None) => solver.solve(scene, start, &|_| {}),
    }
}

/// Change of a row's distance [m] when the vertices move along `s`.
pub(crate) fn project(row: &Row, s: &[f64]) -> f64 {
    let mut sum = 0.0;
    for (&v, w) in row.vertices.iter().zip(row.weights) {
        let at = 3 * v as usize;
        sum += w * (row.direction.x * s[at] + row.direction.y * s[at + 1] + row.direction.z * s[at + 2]);
    }
    sum
}

fn difference(ahead: Vec<f64>, behind: &[f64], step: f64) -> Vec<f64> {
    ahead.iter().zip(behind).map(|(a, b)| (a - b) / (2.0 * step)).collect()
}

/// Calls `f` with the scene of a pose.
fn in_scene<T>(
    capture: &Capture,
    body: Option<&Surroundings>,
    pull: Option<&Pull>,
    f: impl FnOnce(&Scene<'_>) -> Result<T>,
) -> Result<T> {
    let search = |x: &Frames<f64>| match body {
        Some(Surroundings { positions, search: Some(search), .. }) => search(x, positions),
        Some(Surroundings { positions, .. }) => crate::energy::nearest_body_vertices(x, positions),
        None => Ok(Vec::new()),
    };
    let scene = Scene {
        body: body.map(|b| Obstacle {
            positions: &b.positions,
            normals: &b.normals,
            before: None,
            search: Some(&search),
        }),
        targets: (!capture.targets.is_empty()).then_some(&capture.targets[..]),
        springs: pull.map(|p| Springs { attachment: &p.attachment, targets: &p.targets }),
        fixed: &capture.fixed,
        momentum: None,
        anchors: Some(capture.anchors.as_deref().unwrap_or(&capture.start)),
    };
    f(&scene)
}
