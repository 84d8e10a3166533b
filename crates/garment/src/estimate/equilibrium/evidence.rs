//! What a fit is worth: intervals, what the poses do not show, which poses do not fit.

use super::super::reduction::in_words;
use super::pose::{Slopes, Trial, huber, project};
use super::{Fit, FitProgress, median};
use crate::solver::{Outcome, SolverSettings};
use caphy_core::{Error, Result, Vec3};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

/// Half-width of a 95 % interval in standard deviations.
const NINETY_FIVE: f64 = 1.96;
/// A mode softer than a pendulum of ten metres slides freely [1/s²].
const FREE: f64 = 1.0;
/// How far the cloth may have slid along a free mode [m, rms]: nobody knows.
const SLID_M: f64 = 5e-3;
/// Steps of a fit with another friction.
const FRICTION_STEPS: usize = 8;
/// A cloth that ends so far beyond its scan [m] is cut larger than what was scanned.
const BEYOND_M: f64 = 3e-3;

/// One unknown of the fabric.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct UnknownEstimate {
    /// The group's name.
    pub name: String,
    /// Factor of the configured values; for combinations, 1 + the share by which they move.
    pub multiplier: f64,
    /// Standard deviation of its logarithm from the scans' noise alone, widened where poses fit worse than noise.
    pub log_sd_noise: f64,
    /// Half the spread of the logarithm over the friction coefficients.
    pub log_sd_friction: f64,
    /// Standard deviation of the logarithm from noise, friction and mesh together.
    pub log_sd: f64,
    /// 95 % interval of the factor.
    pub interval: [f64; 2],
    /// Whether the poses say so little that the prior holds it.
    pub held_by_prior: bool,
    /// Whether a bound holds it.
    pub at_bound: bool,
}

/// Something that had to be fitted along.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NuisanceEstimate {
    /// What it is.
    pub name: String,
    /// `1` or `m`.
    pub unit: String,
    /// Value.
    pub value: f64,
    /// Its standard deviation.
    pub sd: f64,
}

/// A combination of unknowns and how well the poses determine it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Combination {
    /// In words.
    pub words: String,
    /// Parts of the unknowns, a unit vector.
    pub parts: Vec<f64>,
    /// Standard deviation along it from the poses alone, without the prior; infinite for nothing.
    pub log_sd: f64,
    /// Whether that is below the limit of the settings.
    pub determined: bool,
}

/// How one pose fits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PoseReport {
    /// The pose.
    pub name: String,
    /// χ² per measurement (Huber): 1 for a pose that fits to the noise.
    pub chi2: f64,
    /// The same over that of the median pose that took part.
    pub chi2_over_median: f64,
    /// Measurements.
    pub measurements: usize,
    /// Noise that was assumed [mm].
    pub sigma_mm: f64,
    /// Root-mean-square distance to the scan [mm].
    pub rms_mm: f64,
    /// By how much the cloth ends beyond the scan, on average [mm]; negative: the scan goes on.
    pub beyond_mm: f64,
    /// How the simulation ended.
    pub outcome: Outcome,
    /// Force that it left [N].
    pub residual_n: f64,
    /// Vertices that touch something.
    pub contacts: usize,
    /// Modes that slide freely.
    pub free_modes: usize,
    /// Why it was left out; `None` when it took part.
    pub left_out: Option<String>,
}

/// A fabric with its evidence.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EquilibriumEstimate {
    /// The fabric's unknowns.
    pub unknowns: Vec<UnknownEstimate>,
    /// What was fitted along.
    pub nuisances: Vec<NuisanceEstimate>,
    /// Native parameters of the fabric.
    pub parameters: Vec<f64>,
    /// Covariance of the unknowns' logarithms from noise, without mesh and friction, row by row.
    pub covariance: Vec<f64>,
    /// Combinations, best determined first.
    pub combinations: Vec<Combination>,
    /// The poses.
    pub poses: Vec<PoseReport>,
    /// Factor on the noise's variance, from how much worse than it the poses fit
    /// ([`super::super::EquilibriumSettings::misfit_length_m`]); at least 1.
    pub inflation: f64,
    /// What the mesh adds to each standard deviation of a logarithm.
    pub mesh_log_sd: f64,
    /// Friction coefficients of the spread; empty without contact.
    pub friction: Vec<f64>,
    /// Shapes at the end [m], `[pose][vertex]`.
    pub shapes: Vec<Vec<[f64; 3]>>,
    /// Simulations of all poses.
    pub evaluations: usize,
    /// What the user must know.
    pub warnings: Vec<String>,
}

impl EquilibriumEstimate {
    /// How many times worse than the scans' noise the poses that took part fit, √ of their mean χ².
    pub fn misfit(&self) -> f64 {
        misfit(&self.poses)
    }
}

fn misfit(poses: &[PoseReport]) -> f64 {
    let taken: Vec<f64> = poses.iter().filter(|p| p.left_out.is_none()).map(|p| p.chi2).collect();
    (taken.iter().sum::<f64>() / taken.len().max(1) as f64).sqrt()
}

/// Factor on the noise's variance for a χ² per degree of freedom. What exceeds noise by more than chance (three standard deviations
/// of χ²) is a wrong model rather than more noise: alike over a patch of the cloth with `per_patch` measurements, which then say
/// together what one would.
fn inflation(chi2: f64, freedom: usize, per_patch: f64) -> f64 {
    let misfit = chi2 - 1.0 - 3.0 * (2.0 / freedom as f64).sqrt();
    chi2.max(1.0).max(1.0 + misfit * per_patch.max(1.0))
}

impl Fit<'_> {
    pub(super) fn report(
        mut self,
        progress: &mut dyn FnMut(FitProgress<'_>) -> Result<()>,
    ) -> Result<EquilibriumEstimate> {
        let y = self.state.y.clone();
        let all = vec![true; self.poses.len()];
        let none = self.pulls(0.0)?;
        let trials = self.attempt(&y, &none, None, &all)?;
        self.take(y.clone(), &trials);
        self.tell(progress, 0.92, "intervals")?;
        let mut slopes = self.slopes(&y, &none, &trials)?;
        for (s, left_out) in slopes.iter_mut().zip(&self.state.left_out) {
            if *left_out {
                *s = None;
            }
        }
        let material = self.material(&y)?;
        let mut free = vec![Vec::new(); self.poses.len()];
        if self.settings.soft_modes > 0 {
            for (i, pose) in self.poses.iter_mut().enumerate().filter(|(i, _)| slopes[*i].is_some()) {
                let modes = pose.soft_modes((&self.unknowns, &y), &material, self.settings.soft_modes)?;
                free[i] = modes.into_iter().filter(|m| m.omega_squared.abs() < FREE).collect();
            }
        }
        let mass = self.problem.rest.mass();
        let mut information = DMatrix::zeros(y.len(), y.len());
        for (i, s) in slopes.iter().enumerate() {
            let (Some(s), Some(trial)) = (s, &trials[i]) else { continue };
            let shapes: Vec<Vec<f64>> =
                free[i].iter().map(|m| m.shape.iter().flatten().map(|c| c * SLID_M * mass.sqrt()).collect()).collect();
            information += self.information(s, trial, &shapes, self.poses[i].sigma);
        }
        let inflation = self.inflation(&trials);
        let data = &information / inflation;
        let prior = self.unknowns.prior.clone();
        let covariance = inverse(&(&data + &prior))?;
        let (friction, spread) = self.friction_spread(&y, progress)?;
        let unknowns = self.judged(&y, &covariance, &spread);
        let combinations = self.combinations(&data, &prior)?;
        let poses = self.pose_reports(&trials, &free);
        let warnings = self.warnings(&unknowns, &poses, inflation, friction.len() > 1);
        let fabric = self.unknowns.fabric();
        let nuisances = (fabric..y.len())
            .map(|k| {
                let (name, unit, scale) = self.unknowns.nuisance(k);
                let (value, sd) = (scale * y[k], scale * covariance[(k, k)].sqrt());
                NuisanceEstimate { name: name.into(), unit: unit.into(), value, sd }
            })
            .collect();
        self.tell(progress, 1.0, "done")?;
        Ok(EquilibriumEstimate {
            unknowns,
            nuisances,
            parameters: self.unknowns.reduction.values(&y[..fabric]),
            covariance: (0..fabric * fabric).map(|i| covariance[(i / fabric, i % fabric)]).collect(),
            combinations,
            poses,
            inflation,
            mesh_log_sd: self.settings.mesh_log_sd,
            friction,
            shapes: self.state.shapes,
            evaluations: self.state.evaluations,
            warnings,
        })
    }
    fn tell(&self, progress: &mut dyn FnMut(FitProgress<'_>) -> Result<()>, share: f64, message: &str) -> Result<()> {
        progress(FitProgress { share, message, state: &self.kept })
    }

    /// Information of a pose's measurements on the unknowns, free sliding marginalised out: `modes` are displacements of one
    /// standard deviation each.
    pub(super) fn information(&self, s: &Slopes, trial: &Trial, modes: &[Vec<f64>], sigma: f64) -> DMatrix<f64> {
        let rows: Vec<usize> = (0..s.counts.len()).filter(|&r| s.counts[r]).collect();
        let n = s.by_unknown.ncols();
        let m = modes.len();
        let j = DMatrix::from_fn(rows.len(), n + m, |r, k| {
            let row = rows[r];
            let slope = if k < n { s.by_unknown[(row, k)] } else { project(&trial.rows[row], &modes[k - n]) / sigma };
            slope * huber(s.residual[row], self.settings.robust_at).1.sqrt()
        });
        let whole = j.transpose() * &j;
        let own = whole.view((0, 0), (n, n)).into_owned();
        if m == 0 {
            return own;
        }
        let cross = whole.view((0, n), (n, m)).into_owned();
        let sliding = whole.view((n, n), (m, m)) + DMatrix::identity(m, m);
        match sliding.cholesky() {
            Some(factor) => own - &cross * factor.solve(&cross.transpose()),
            None => own,
        }
    }
    /// Factor on the noise's variance, from how much worse than it the poses that took part fit.
    fn inflation(&self, trials: &[Option<Trial>]) -> f64 {
        let (mut sum, mut count, mut poses) = (0.0, 0, 0);
        for (i, trial) in trials.iter().enumerate().filter(|(i, _)| !self.state.left_out[*i]) {
            let Some(trial) = trial else { continue };
            let (chi2, n) = trial.chi2(self.poses[i].sigma, self.settings.robust_at);
            sum += chi2;
            count += n;
            poses += 1;
        }
        let freedom = count.saturating_sub(self.unknowns.len()).max(1);
        let patches = self.problem.rest.area() / self.settings.misfit_length_m.powi(2) * f64::from(poses.max(1));
        inflation(sum / freedom as f64, freedom, count as f64 / patches.max(1.0))
    }

    /// Fits again with other friction, and says by how much the unknowns then differ.
    fn friction_spread(
        &mut self,
        y: &[f64],
        progress: &mut dyn FnMut(FitProgress<'_>) -> Result<()>,
    ) -> Result<(Vec<f64>, Vec<f64>)> {
        let touching = self.problem.captures.iter().any(|c| c.body.is_some());
        let coefficients = self.settings.friction_spread.clone();
        let fabric = self.unknowns.fabric();
        if !touching || coefficients.is_empty() {
            return Ok((Vec::new(), vec![0.0; fabric]));
        }
        let kept = self.state.clone();
        let shapes: Vec<Vec<Vec3>> = self.poses.iter().map(|p| p.x.clone()).collect();
        let mut found: Vec<Vec<f64>> = Vec::new();
        for (i, &friction) in coefficients.iter().enumerate() {
            let share = 0.93 + 0.06 * i as f64 / coefficients.len() as f64;
            self.tell(progress, share, &format!("with friction {friction}"))?;
            if friction == self.problem.solver.friction {
                found.push(y.to_vec());
                continue;
            }
            self.state.clone_from(&kept);
            for (pose, x) in self.poses.iter_mut().zip(&shapes) {
                pose.x.clone_from(x);
                pose.set_settings(SolverSettings { friction, ..self.problem.solver })?;
            }
            self.state.stage = self.settings.continuation.len() - 1;
            self.state.step = self.settings.steps.saturating_sub(FRICTION_STEPS);
            self.state.reach = self.settings.largest_step;
            self.descend(&mut |_| Ok(()))?;
            found.push(self.state.y.clone());
        }
        let evaluations = self.state.evaluations;
        self.state = kept;
        self.state.evaluations = evaluations;
        for (pose, x) in self.poses.iter_mut().zip(shapes) {
            pose.x = x;
            pose.set_settings(self.problem.solver)?;
        }
        let spread = (0..fabric)
            .map(|k| {
                let of = |pick: fn(f64, f64) -> f64, from: f64| found.iter().map(|y| y[k]).fold(from, pick);
                0.5 * (of(f64::max, f64::NEG_INFINITY) - of(f64::min, f64::INFINITY))
            })
            .collect();
        Ok((coefficients, spread))
    }

    fn judged(&self, y: &[f64], covariance: &DMatrix<f64>, spread: &[f64]) -> Vec<UnknownEstimate> {
        let reduction = &self.unknowns.reduction;
        (0..self.unknowns.fabric())
            .map(|k| {
                let noise = covariance[(k, k)].sqrt();
                let mesh = self.settings.mesh_log_sd;
                let log_sd = (noise * noise + spread[k] * spread[k] + mesh * mesh).sqrt();
                let factor = |y: f64| if reduction.logarithmic { y.exp() } else { 1.0 + y };
                let [lower, upper] = reduction.limits(k);
                UnknownEstimate {
                    name: reduction.names[k].clone(),
                    multiplier: factor(y[k]),
                    log_sd_noise: noise,
                    log_sd_friction: spread[k],
                    log_sd,
                    interval: [factor(y[k] - NINETY_FIVE * log_sd), factor(y[k] + NINETY_FIVE * log_sd)],
                    held_by_prior: noise > self.settings.held_above,
                    at_bound: y[k] <= lower + 1e-9 || y[k] >= upper - 1e-9,
                }
            })
            .collect()
    }
    /// Eigen-directions of the data's information on the fabric, the other unknowns marginalised out under their priors.
    fn combinations(&self, data: &DMatrix<f64>, prior: &DMatrix<f64>) -> Result<Vec<Combination>> {
        let (n, p) = (data.nrows(), self.unknowns.fabric());
        let mut own = data.view((0, 0), (p, p)).into_owned();
        if n > p {
            let cross = data.view((0, p), (p, n - p)).into_owned();
            let rest = data.view((p, p), (n - p, n - p)) + prior.view((p, p), (n - p, n - p));
            own -= &cross * inverse(&rest)? * cross.transpose();
        }
        let names = &self.unknowns.reduction.names;
        let eigen = (0.5 * (&own + own.transpose())).symmetric_eigen();
        let mut order: Vec<usize> = (0..p).collect();
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        Ok(order
            .into_iter()
            .map(|k| {
                let parts: Vec<f64> = eigen.eigenvectors.column(k).iter().copied().collect();
                let value = eigen.eigenvalues[k];
                let log_sd = if value > 0.0 { value.sqrt().recip() } else { f64::INFINITY };
                Combination {
                    words: in_words(names, &parts),
                    parts,
                    log_sd,
                    determined: log_sd <= self.settings.held_above,
                }
            })
            .collect())
    }
    fn pose_reports(&self, trials: &[Option<Trial>], free: &[Vec<crate::solver::SoftMode>]) -> Vec<PoseReport> {
        let fits = self.fits(trials);
        let taking = fits.iter().zip(&self.state.left_out).filter(|(_, l)| !**l).filter_map(|(f, _)| *f);
        let middle = median(taking).max(f64::MIN_POSITIVE);
        let of = |(i, trial): (usize, &Option<Trial>)| {
            let trial = trial.as_ref()?;
            let chi2 = fits[i]?;
            let measured: Vec<f64> = trial.rows.iter().filter(|r| r.counts).map(|r| r.distance).collect();
            let edge: Vec<f64> =
                trial.rows.iter().filter(|r| r.beyond != 0).map(|r| f64::from(r.beyond) * r.distance.abs()).collect();
            let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len().max(1) as f64;
            let squares: Vec<f64> = measured.iter().map(|d| d * d).collect();
            let left_out = self.state.left_out[i].then(|| {
                if trial.at_rest {
                    format!("χ² per point {:.1} times that of the median pose", chi2 / middle)
                } else {
                    format!("does not come to rest: {:.1e} N left", trial.solution.report.residual_n)
                }
            });
            Some(PoseReport {
                name: self.poses[i].capture.name.clone(),
                chi2,
                chi2_over_median: chi2 / middle,
                measurements: measured.len(),
                sigma_mm: 1e3 * self.poses[i].sigma,
                rms_mm: 1e3 * mean(&squares).sqrt(),
                beyond_mm: 1e3 * mean(&edge),
                outcome: trial.solution.report.outcome,
                residual_n: trial.solution.report.residual_n,
                contacts: trial.solution.contacts.len(),
                free_modes: free[i].len(),
                left_out,
            })
        };
        trials.iter().enumerate().filter_map(of).collect()
    }
    fn warnings(
        &self,
        unknowns: &[UnknownEstimate],
        poses: &[PoseReport],
        inflation: f64,
        contact: bool,
    ) -> Vec<String> {
        let mut out = vec![
            "these values are effective at this mesh: cloth cut into other triangles of the same size gives others, within \
             about 30 %, twice as fine or coarse within a factor of two"
                .to_string(),
        ];
        if !self.problem.weighed {
            out.push(format!(
                "the cloth was not weighed: what is known is stiffness over density, for the fabric's {:.4} kg/m²",
                self.problem.rest.density.0
            ));
        }
        if contact {
            out.push(
                "friction was modelled, not measured: half the spread over its coefficients is in the intervals".into(),
            );
        }
        let list = |pick: &dyn Fn(&UnknownEstimate) -> bool| -> Vec<&str> {
            unknowns.iter().filter(|u| pick(u)).map(|u| u.name.as_str()).collect()
        };
        let held = list(&|u| u.held_by_prior);
        if !held.is_empty() {
            out.push(format!("these poses say next to nothing on {}: held by the prior", held.join(", ")));
        }
        let bound = list(&|u| u.at_bound);
        if !bound.is_empty() {
            out.push(format!("at its bound: {}", bound.join(", ")));
        }
        if inflation > 2.0 {
            out.push(format!(
                "the poses fit {:.1} times worse than the scans' noise: body, registration, friction or the cut are off; intervals are \
                 widened as if that were alike over {:.0} mm, but know of nothing that is off everywhere",
                misfit(poses),
                1e3 * self.settings.misfit_length_m
            ));
        }
        for pose in poses {
            if let Some(why) = &pose.left_out {
                out.push(format!("pose `{}` was left out: {why}; another fold, friction, or a bad scan", pose.name));
            } else if pose.chi2_over_median > self.settings.gate {
                out.push(format!(
                    "pose `{}` took part though its χ² is {:.1} times the median's: too few poses fit",
                    pose.name, pose.chi2_over_median
                ));
            }
            if pose.free_modes > 0 {
                out.push(format!("pose `{}` slides freely in {} ways", pose.name, pose.free_modes));
            }
            if 1e-3 * pose.beyond_mm.abs() > BEYOND_M {
                let (which, other) = if pose.beyond_mm > 0.0 { ("cloth", "scan") } else { ("scan", "cloth") };
                out.push(format!(
                    "pose `{}`: the {which} ends {:.1} mm beyond the {other}: cut to another size, or not all of it was scanned; \
                     fit `ease_sd`",
                    pose.name,
                    pose.beyond_mm.abs()
                ));
            }
        }
        out
    }
}

fn inverse(m: &DMatrix<f64>) -> Result<DMatrix<f64>> {
    (0.5 * (m + m.transpose())).cholesky().map(|f| f.inverse()).ok_or_else(|| {
        Error::numerics(
            "covariance of the estimate",
            "the information matrix is not positive definite",
            "give a finite prior to every unknown",
        )
    })
}

#[cfg(test)]
mod tests {
    use super::inflation;

    #[test]
    fn chance_widens_little_and_a_wrong_model_by_all_its_neighbours() {
        assert_eq!(inflation(0.98, 5000, 40.0), 1.0);
        // Three standard deviations of χ² of 5000 are 0.06.
        assert_eq!(inflation(1.05, 5000, 40.0), 1.05);
        let wrong = inflation(9.0, 5000, 40.0);
        assert!((wrong - (1.0 + 7.94 * 40.0)).abs() < 1e-9, "{wrong}");
        // A sparse scan has no neighbours.
        assert_eq!(inflation(9.0, 5000, 0.5), 9.0);
    }
}
