//! The default estimator: the fabric whose simulated equilibria lie nearest to the scans.
//!
//! min over y of Σ_poses Σ_rows ρ(distance(x*(Θ(y)), scan)/σ) + ½ Σ ((y − y₀)/sd)², by Gauss-Newton steps with
//! dx*/dy = −J⁻¹ ∂f/∂y from the solver's own factorisation, all poses of a subject together.
//!
//! Differs from the paper: Eq. 10 asks in which fabric the *observed* shape would be at rest, and noise of 0.02 mm makes that
//! answer useless, because membrane forces are second differences of positions. Here noise enters the residual instead.
//!
//! x*(Θ) jumps between buckling branches. So the fit begins with springs to the scan, x_λ = argmin E + ½ λ‖x − scan‖², whose λ falls
//! to 0; and a pose that does not fit in the end is attached and released again, then left out.
//!
//! # Limitations
//! Static shapes show Θ over density only. Friction is modelled but not known. Values belong to this mesh.

mod evidence;
mod native;
mod pose;
mod sheet;
mod unknowns;

pub use evidence::{Combination, EquilibriumEstimate, NuisanceEstimate, PoseReport, UnknownEstimate};
pub use native::{FabricOdds, NativeEvidence};

use super::bounded;
use super::capture::Capture;
use super::cut::CutPart;
use super::reduction::Reduction;
use super::settings::EquilibriumSettings;
use crate::GarmentRest;
use crate::solver::{Forces, SolverSettings};
use caphy_core::material::MaterialModel;
use caphy_core::{Error, Result, Vec3};
use nalgebra::{DMatrix, DVector};
use pose::{PoseFit, Pull, Slopes, Trial};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sheet::Sheet;
use std::sync::Arc;
use unknowns::Unknowns;

/// Shorter steps that are tried before a λ is given up.
const TRIES: usize = 8;
/// Rounds of leaving poses out.
const GATINGS: usize = 3;
/// Promised gain, in units of half χ², below which a step at a λ that is to fall yet is not worth its time.
const GOOD_ENOUGH: f64 = 0.2;
/// Poses that fit so much worse than the median are attached and released again, whatever the gate.
const SUSPICIOUS: f64 = 1.12;

/// A cloth, what is known of its poses, and how they are simulated.
#[derive(Clone)]
pub struct Problem {
    /// The cloth at rest; its density is taken as known.
    pub rest: GarmentRest,
    /// The fabric to start from, around which the prior lies.
    pub material: Arc<dyn MaterialModel>,
    /// What acts.
    pub forces: Forces,
    /// How poses are solved for; its friction is the one of the fit.
    pub solver: SolverSettings,
    /// The poses.
    pub captures: Vec<Capture>,
    /// Whether the density is that of this cloth (weighed), rather than the fabric's of the start.
    pub weighed: bool,
    /// What may be cut otherwise than `rest` where `ease_sd` asks for it, each part in length and in girth.
    pub parts: Vec<CutPart>,
}

impl Problem {
    /// `Ok` for a problem that can be estimated.
    ///
    /// # Errors
    /// [`Error::Unsupported`] for a material without derivatives by its parameters, [`Error::Config`] without poses, those of
    /// [`Capture::check`].
    pub fn check(&self) -> Result<()> {
        let facts = self.material.describe();
        let lacks = [
            ("derivatives by its parameters, which estimation needs", !facts.offers.by_parameter),
            ("the whole tangent, which estimation needs", !facts.offers.tangent_total),
        ];
        if let Some((what, _)) = lacks.into_iter().find(|l| l.1) {
            return Err(Error::unsupported(what, facts.name));
        }
        if self.captures.is_empty() {
            return Err(Error::config("pose", "there is none", "give at least one scanned pose"));
        }
        let faces = self.rest.faces().len();
        for part in &self.parts {
            Error::check_length(&format!("faces of the part `{}`", part.name), faces, part.share.len())?;
        }
        self.captures.iter().try_for_each(|c| c.check(&self.rest))
    }
}

/// Where a fit stands; enough to go on from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FitState {
    /// Index into the continuation.
    pub stage: usize,
    /// Steps taken at this λ.
    pub step: usize,
    /// Unknowns.
    pub y: Vec<f64>,
    /// Largest step that is allowed now.
    pub reach: f64,
    /// Shapes [m], `[pose][vertex]`.
    pub shapes: Vec<Vec<[f64; 3]>>,
    /// Poses that are left out.
    pub left_out: Vec<bool>,
    /// Times that poses were left out.
    pub gatings: usize,
    /// Simulations of all poses so far.
    pub evaluations: usize,
}

/// What a fit says while it runs.
#[derive(Debug, Clone, Copy)]
pub struct FitProgress<'a> {
    /// Share done, in [0, 1].
    pub share: f64,
    /// A word on it.
    pub message: &'a str,
    /// Where to go on from, to keep: the present λ's beginning.
    pub state: &'a FitState,
}

/// Fits a fabric to scans.
///
/// `resume` goes on from a state of the same problem; `progress` hears of every step and may keep the state.
///
/// # Errors
/// As [`Problem::check`] and [`EquilibriumSettings::check`]; those of the solver and of the material; what `progress` gives.
pub fn equilibrium(
    problem: &Problem,
    reduction: Reduction,
    settings: &EquilibriumSettings,
    resume: Option<FitState>,
    progress: &mut dyn FnMut(FitProgress<'_>) -> Result<()>,
) -> Result<EquilibriumEstimate> {
    problem.check()?;
    settings.check()?;
    if settings.ease_sd > 0.0 && problem.parts.is_empty() {
        let problem = format!("{} and no part of the cloth whose cut may differ", settings.ease_sd);
        return Err(Error::config("ease_sd", problem, "name the parts (`CutPart::whole`), or give 0"));
    }
    let mut fit = Fit::new(problem, reduction, settings)?;
    if let Some(state) = resume {
        fit.go_on(state)?;
    }
    fit.run(progress)?;
    fit.report(progress)
}

struct Fit<'p> {
    problem: &'p Problem,
    settings: &'p EquilibriumSettings,
    unknowns: Unknowns,
    poses: Vec<PoseFit<'p>>,
    sheet: Sheet,
    state: FitState,
    /// The state at which contacts were last looked for: what to go on from, since no later one says how.
    kept: FitState,
}

/// Sums of squares of all poses: half the Hessian's data part, its gradient.
struct Normal {
    h: DMatrix<f64>,
    g: DVector<f64>,
}

impl<'p> Fit<'p> {
    fn new(problem: &'p Problem, reduction: Reduction, settings: &'p EquilibriumSettings) -> Result<Self> {
        let unknowns = Unknowns::new(reduction, &problem.parts, &problem.captures, settings)?;
        let mut poses: Vec<PoseFit<'p>> =
            problem.captures.iter().map(|c| PoseFit::new(problem, c)).collect::<Result<_>>()?;
        // One scanner, one noise: what folds add to the roughness of some poses is not its.
        let least = poses.iter().filter(|p| p.capture.sigma_m.is_none()).map(|p| p.sigma).fold(f64::INFINITY, f64::min);
        poses.iter_mut().filter(|p| p.capture.sigma_m.is_none()).for_each(|p| p.sigma = least);
        let state = FitState {
            stage: 0,
            step: 0,
            y: unknowns.start(),
            reach: settings.largest_step,
            shapes: poses.iter().map(|p| packed(&p.x)).collect(),
            left_out: vec![false; poses.len()],
            gatings: 0,
            evaluations: 0,
        };
        let kept = state.clone();
        Ok(Self { problem, settings, unknowns, poses, sheet: Sheet::new(&*problem.material)?, state, kept })
    }
    fn go_on(&mut self, state: FitState) -> Result<()> {
        Error::check_length("unknowns of the state to go on from", self.unknowns.len(), state.y.len())?;
        Error::check_length("poses of the state to go on from", self.poses.len(), state.shapes.len())?;
        Error::check_length("poses of the state to go on from", self.poses.len(), state.left_out.len())?;
        for (pose, shape) in self.poses.iter_mut().zip(&state.shapes) {
            Error::check_length("vertices of the state to go on from", pose.x.len(), shape.len())?;
            pose.x = shape.iter().map(|p| Vec3::from(*p)).collect();
            pose.settled = state.evaluations > 0;
        }
        self.state = state;
        Ok(())
    }
    fn material(&self, y: &[f64]) -> Result<Arc<dyn MaterialModel>> {
        Ok(Arc::from(self.unknowns.reduction.material(&*self.problem.material, &y[..self.unknowns.fabric()])?))
    }
    fn lambda(&self) -> f64 {
        self.settings.continuation[self.state.stage]
    }
    fn taking_part(&self) -> Vec<bool> {
        self.state.left_out.iter().map(|l| !l).collect()
    }

    /// Springs of the present λ, `[pose]`.
    fn pulls(&self, lambda: f64) -> Result<Vec<Option<Pull>>> {
        self.poses.iter().map(|p| p.pull(lambda)).collect()
    }

    /// Solves the poses that take part; `None` for the others.
    fn attempt(
        &mut self,
        y: &[f64],
        pulls: &[Option<Pull>],
        forecasts: Option<&[Vec<f64>]>,
        part: &[bool],
    ) -> Result<Vec<Option<Trial>>> {
        let material = self.material(y)?;
        let (unknowns, robust_at) = (&self.unknowns, self.settings.robust_at);
        self.state.evaluations += 1;
        let trials: Vec<Result<Option<Trial>>> = self
            .poses
            .par_iter_mut()
            .enumerate()
            .map(|(i, pose)| {
                if !part[i] {
                    return Ok(None);
                }
                let forecast = forecasts.map(|f| &f[i][..]);
                pose.attempt((unknowns, y), &material, pulls[i].as_ref(), forecast, robust_at).map(Some)
            })
            .collect();
        trials.into_iter().collect()
    }
    fn take(&mut self, y: Vec<f64>, trials: &[Option<Trial>]) {
        self.state.y = y;
        for (i, trial) in trials.iter().enumerate() {
            if let Some(trial) = trial {
                self.poses[i].x.clone_from(&trial.solution.positions);
                self.state.shapes[i] = packed(&trial.solution.positions);
            }
        }
    }
    /// Cost of trials with the prior; poses that found no rest make it infinite unless they had none before.
    fn cost(&self, y: &[f64], trials: &[Option<Trial>]) -> f64 {
        let data: f64 = trials.iter().flatten().map(|t| t.cost).sum();
        let off = self.off_start(y);
        let prior = 0.5 * (&self.unknowns.prior * &off).dot(&off);
        data + prior
    }
    fn off_start(&self, y: &[f64]) -> DVector<f64> {
        DVector::from_column_slice(y) - DVector::from_vec(self.unknowns.start())
    }
    fn slopes(&mut self, y: &[f64], pulls: &[Option<Pull>], trials: &[Option<Trial>]) -> Result<Vec<Option<Slopes>>> {
        let material = self.material(y)?;
        let (unknowns, robust_at) = (&self.unknowns, self.settings.robust_at);
        let all: Vec<Result<Option<Slopes>>> = self
            .poses
            .par_iter_mut()
            .zip(trials)
            .enumerate()
            .map(|(i, (pose, trial))| match trial {
                Some(trial) if trial.at_rest => {
                    pose.slopes((unknowns, y), &material, pulls[i].as_ref(), trial, robust_at).map(Some)
                }
                _ => Ok(None),
            })
            .collect();
        all.into_iter().collect()
    }
    fn normal(&self, y: &[f64], slopes: &[Option<Slopes>]) -> Normal {
        let n = self.unknowns.len();
        let (mut h, mut g) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for s in slopes.iter().flatten() {
            let mut weighted = s.by_unknown.clone();
            for (mut row, w) in weighted.row_iter_mut().zip(s.weight.iter()) {
                row *= *w;
            }
            h += weighted.transpose() * &s.by_unknown;
            g += weighted.transpose() * &s.residual;
        }
        h += &self.unknowns.prior;
        g += &self.unknowns.prior * self.off_start(y);
        Normal { h, g }
    }

    fn run(&mut self, progress: &mut dyn FnMut(FitProgress<'_>) -> Result<()>) -> Result<()> {
        while self.state.stage < self.settings.continuation.len() {
            self.look_again();
            self.descend(progress)?;
            let last = self.state.stage + 1 == self.settings.continuation.len();
            if last && self.state.gatings < GATINGS && self.gate()? {
                self.state.gatings += 1;
                self.state.step = 0;
                self.state.reach = self.settings.largest_step;
                continue;
            }
            self.state.stage += 1;
            self.state.step = 0;
            self.state.reach = self.settings.largest_step;
        }
        Ok(())
    }

    /// Has contacts looked for anew by the next solves.
    fn look_again(&mut self) {
        self.poses.iter_mut().for_each(|p| p.contacts = None);
        self.kept.clone_from(&self.state);
    }

    /// Gauss-Newton steps at the present λ.
    fn descend(&mut self, progress: &mut dyn FnMut(FitProgress<'_>) -> Result<()>) -> Result<()> {
        let lambda = self.lambda();
        let last = self.state.stage + 1 == self.settings.continuation.len();
        let steps = if last { self.settings.steps } else { self.settings.steps_while_held };
        let part = self.taking_part();
        while self.state.step < steps {
            let pulls = self.pulls(lambda)?;
            let y = self.state.y.clone();
            let mut now = self.attempt(&y, &pulls, None, &part)?;
            self.take(y.clone(), &now);
            let mut cost = self.cost(&y, &now);
            self.say(progress, lambda, cost)?;
            let slopes = self.slopes(&y, &pulls, &now)?;
            if slopes.iter().all(Option::is_none) {
                return Err(Error::numerics(
                    "equilibrium fit",
                    format!("no pose comes to rest (the first is left with {:.1e} N)", self.worst(&now)),
                    "look at the starts and the clamps: does something slide or fall?",
                ));
            }
            let normal = self.normal(&y, &slopes);
            let mut done = false;
            let mut taken = false;
            for _ in 0..TRIES {
                let d = self.step(&y, &normal)?;
                let expected = -(normal.g.dot(&d) + 0.5 * (&normal.h * &d).dot(&d));
                if expected < if last { 0.5 * self.settings.tolerance.powi(2) } else { GOOD_ENOUGH } {
                    done = true;
                    break;
                }
                let to: Vec<f64> = y.iter().zip(d.iter()).map(|(y, d)| y + d).collect();
                if !self.sheet.admits(&*self.material(&to)?)? {
                    self.state.reach = 0.5 * d.amax();
                    continue;
                }
                let forecasts = self.forecasts(&slopes, &d);
                let trials = self.attempt(&to, &pulls, Some(&forecasts), &part)?;
                let reached = self.cost(&to, &trials);
                let gain = (cost - reached) / expected;
                if gain > 1e-3 && lost_rest(&now, &trials) == 0 {
                    self.take(to, &trials);
                    cost = reached;
                    now = trials;
                    taken = true;
                    self.state.reach = if gain > 0.5 {
                        (2.0 * self.state.reach).min(self.settings.largest_step)
                    } else {
                        self.state.reach
                    };
                    break;
                }
                self.state.reach = 0.3 * d.amax();
            }
            self.state.step += 1;
            self.say(progress, lambda, cost)?;
            drop(now);
            if done || !taken {
                break;
            }
        }
        Ok(())
    }
    /// The step that minimises the quadratic model within limits, damped in the prior's metric until no unknown moves beyond reach.
    /// Bounds on each unknown would let what the poses say little of make up for the others: Poisson coupling that grows while
    /// tension falls, until the fabric is no sheet.
    fn step(&self, y: &[f64], normal: &Normal) -> Result<DVector<f64>> {
        let n = y.len();
        let unit = |k: usize| if k < self.unknowns.fabric() { 1.0 } else { self.unknowns.prior_sd[k] };
        let lower = DVector::from_fn(n, |k, _| (self.unknowns.limits(k)[0] - y[k]).min(0.0));
        let upper = DVector::from_fn(n, |k, _| (self.unknowns.limits(k)[1] - y[k]).max(0.0));
        let mut damping = 0.0;
        loop {
            let h = &normal.h + &self.unknowns.prior * damping;
            let d = bounded::solve(&h, &-&normal.g, &lower, &upper, &DVector::zeros(n))?;
            let far = (0..n).map(|k| d[k].abs() / unit(k)).fold(0.0, f64::max);
            if far <= self.state.reach {
                return Ok(d);
            }
            damping =
                if damping == 0.0 { 1e-3 * normal.h.trace() / self.unknowns.prior.trace() } else { 2.0 * damping };
        }
    }
    fn forecasts(&self, slopes: &[Option<Slopes>], d: &DVector<f64>) -> Vec<Vec<f64>> {
        let of = |(s, pose): (&Option<Slopes>, &PoseFit<'_>)| {
            let mut out = vec![0.0; 3 * pose.x.len()];
            for (response, d) in s.iter().flat_map(|s| &s.responses).zip(d.iter()) {
                out.iter_mut().zip(response).for_each(|(o, r)| *o += d * r);
            }
            out
        };
        slopes.iter().zip(&self.poses).map(of).collect()
    }
    fn worst(&self, trials: &[Option<Trial>]) -> f64 {
        trials.iter().flatten().map(|t| t.solution.report.residual_n).fold(0.0, f64::max)
    }
    fn say(&self, progress: &mut dyn FnMut(FitProgress<'_>) -> Result<()>, lambda: f64, cost: f64) -> Result<()> {
        let stages = self.settings.continuation.len() as f64;
        let of = if self.state.stage + 1 == self.settings.continuation.len() {
            self.settings.steps
        } else {
            self.settings.steps_while_held
        };
        let share = (self.state.stage as f64 + self.state.step as f64 / of.max(1) as f64) / stages;
        let message = format!("λ {lambda}, step {}, cost {cost:.5e}", self.state.step);
        progress(FitProgress { share: 0.9 * share.min(1.0), message: &message, state: &self.kept })
    }

    /// χ² per measurement of each pose [`None`: left out].
    fn fits(&self, trials: &[Option<Trial>]) -> Vec<Option<f64>> {
        let of = |(t, pose): (&Option<Trial>, &PoseFit<'_>)| {
            let (sum, count) = t.as_ref()?.chi2(pose.sigma, self.settings.robust_at);
            Some(sum / count.max(1) as f64)
        };
        trials.iter().zip(&self.poses).map(of).collect()
    }
    /// Attaches poses that do not fit to the scan and releases them again, then leaves out those that still do not fit; `true` when
    /// something changed.
    fn gate(&mut self) -> Result<bool> {
        let y = self.state.y.clone();
        let part = self.taking_part();
        let none = self.pulls(0.0)?;
        let trials = self.attempt(&y, &none, None, &part)?;
        self.take(y.clone(), &trials);
        let bad = self.misfits(&trials, SUSPICIOUS.min(self.settings.gate));
        if bad.iter().all(|b| !b) {
            return Ok(false);
        }
        let hopeless = self.misfits(&trials, self.settings.gate);
        let before = self.fits(&trials);
        let old: Vec<_> = self.poses.iter().map(|p| (p.x.clone(), p.contacts.clone())).collect();
        for (pose, _) in self.poses.iter_mut().zip(&bad).filter(|(_, b)| **b) {
            pose.x.clone_from(&pose.capture.start);
        }
        let mut again = Vec::new();
        for lambda in [0.3, 0.1, 0.03, 0.0] {
            let pulls = self.pulls(lambda)?;
            self.poses.iter_mut().zip(&bad).filter(|(_, b)| **b).for_each(|(p, _)| {
                p.contacts = None;
                p.settled = false;
            });
            again = self.attempt(&y, &pulls, None, &bad)?;
            self.take(y.clone(), &again);
        }
        let after = self.fits(&again);
        let mut changed = false;
        for i in 0..bad.len() {
            if !bad[i] {
                continue;
            }
            let better = match (before[i], after[i]) {
                (Some(b), Some(a)) => a < 0.95 * b && again[i].as_ref().is_some_and(|t| t.at_rest),
                _ => false,
            };
            if better {
                changed = true;
            } else {
                (self.poses[i].x, self.poses[i].contacts) = old[i].clone();
                self.state.shapes[i] = packed(&old[i].0);
            }
        }
        if changed {
            return Ok(true);
        }
        // Never more than half: then it is the model that does not fit, and the report says so.
        let mut order: Vec<usize> = (0..bad.len()).filter(|&i| hopeless[i]).collect();
        order.sort_by(|&a, &b| before[b].unwrap_or(f64::INFINITY).total_cmp(&before[a].unwrap_or(f64::INFINITY)));
        let spare = (self.poses.len() / 2).saturating_sub(self.state.left_out.iter().filter(|l| **l).count());
        for i in order.into_iter().take(spare) {
            self.state.left_out[i] = true;
            changed = true;
        }
        Ok(changed)
    }
    /// Poses that take part and fit worse than a gate allows, or are not at rest.
    fn misfits(&self, trials: &[Option<Trial>], gate: f64) -> Vec<bool> {
        let fits = self.fits(trials);
        let limit = gate * median(fits.iter().flatten().copied());
        let bad = |(fit, trial): (&Option<f64>, &Option<Trial>)| match (fit, trial) {
            (Some(fit), Some(trial)) => *fit > limit || !trial.at_rest,
            _ => false,
        };
        fits.iter().zip(trials).map(bad).collect()
    }
}

/// The median; 0 of nothing.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut all: Vec<f64> = values.collect();
    all.sort_by(f64::total_cmp);
    match all.len() {
        0 => 0.0,
        n if n % 2 == 1 => all[n / 2],
        n => 0.5 * (all[n / 2 - 1] + all[n / 2]),
    }
}

/// Poses that were at rest and are not any more.
fn lost_rest(before: &[Option<Trial>], after: &[Option<Trial>]) -> usize {
    let rest = |t: &Option<Trial>| t.as_ref().is_some_and(|t| t.at_rest);
    before.iter().zip(after).filter(|(b, a)| rest(b) && !rest(a)).count()
}

fn packed(x: &[Vec3]) -> Vec<[f64; 3]> {
    x.iter().map(|p| [p.x, p.y, p.z]).collect()
}

/// Shapes [m] of all poses that lie between physics and scan: E of a fabric plus ½ λ‖x − scan‖² minimised from `start`, λ in weights of
/// a vertex per mm.
///
/// # Errors
/// As [`equilibrium`].
pub fn held_shapes(
    problem: &Problem,
    material: &Arc<dyn MaterialModel>,
    start: &[Vec<Vec3>],
    lambda: f64,
) -> Result<Vec<Vec<Vec3>>> {
    Error::check_length("shapes to start from", problem.captures.len(), start.len())?;
    let unknowns = Unknowns::new(Reduction::multipliers(&**material)?, &[], &[], &EquilibriumSettings::default())?;
    let y = unknowns.start();
    let solved: Vec<Result<Vec<Vec3>>> = problem
        .captures
        .par_iter()
        .zip(start)
        .map(|(capture, start)| {
            let mut pose = PoseFit::new(problem, capture)?;
            pose.x.clone_from(start);
            let pull = pose.pull(lambda)?;
            let trial = pose.attempt((&unknowns, &y), material, pull.as_ref(), None, f64::INFINITY)?;
            Ok(trial.solution.positions)
        })
        .collect();
    solved.into_iter().collect()
}
