//! What the poses say about every native parameter at an estimate: well-determined combinations, and the nearest of known fabrics.

use super::super::reduction::Reduction;
use super::{EquilibriumEstimate, EquilibriumSettings, Fit, Problem};
use caphy_core::{Error, Result, Vec3};
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// Information of the poses on the logarithms of all native parameters at an estimate.
pub struct NativeEvidence {
    /// Names of the parameters.
    pub names: Vec<String>,
    /// Their values at the estimate.
    pub values: Vec<f64>,
    /// Information matrix, noise inflated as in the estimate.
    information: DMatrix<f64>,
    /// Slope of the cost by the logarithms.
    slope: DVector<f64>,
}

/// How likely a known fabric is among its like.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FabricOdds {
    /// The fabric.
    pub name: String,
    /// Squared distance from the estimate in standard deviations of what the poses determine, mesh error included.
    pub distance2: f64,
    /// Its share among the given ones, all held equally likely before.
    pub probability: f64,
}

impl NativeEvidence {
    /// Evaluates all native parameters at an estimate of the same problem.
    ///
    /// # Errors
    /// As [`super::equilibrium`].
    pub fn at(problem: &Problem, estimate: &EquilibriumEstimate, settings: &EquilibriumSettings) -> Result<Self> {
        let material = problem.material.with_parameters(&estimate.parameters)?;
        let plain = EquilibriumSettings { ease_sd: 0.0, body_offset_sd_m: 0.0, ..settings.clone() };
        let mut fit = Fit::new(problem, Reduction::table(&*material)?, &plain)?;
        Error::check_length("poses of the estimate", fit.poses.len(), estimate.shapes.len())?;
        for (pose, shape) in fit.poses.iter_mut().zip(&estimate.shapes) {
            pose.x = shape.iter().map(|p| Vec3::from(*p)).collect();
            pose.settled = true;
        }
        for (left_out, report) in fit.state.left_out.iter_mut().zip(&estimate.poses) {
            *left_out = report.left_out.is_some();
        }
        let y = fit.unknowns.start();
        let (none, part) = (fit.pulls(0.0)?, fit.taking_part());
        let trials = fit.attempt(&y, &none, None, &part)?;
        let slopes = fit.slopes(&y, &none, &trials)?;
        let n = y.len();
        let mut information = DMatrix::zeros(n, n);
        for (i, (s, t)) in slopes.iter().zip(&trials).enumerate() {
            if let (Some(s), Some(t)) = (s, t) {
                information += fit.information(s, t, &[], fit.poses[i].sigma);
            }
        }
        information /= estimate.inflation;
        let slope = fit.normal(&y, &slopes).g / estimate.inflation;
        let names = fit.unknowns.reduction.names.clone();
        Ok(Self { names, values: estimate.parameters.clone(), information, slope })
    }
    /// Unit combinations of the logarithms whose standard deviation from the poses alone is below `log_sd`, best first, shape
    /// [native][combination], for [`Reduction::along`].
    pub fn determined(&self, log_sd: f64) -> DMatrix<f64> {
        let eigen = (0.5 * (&self.information + self.information.transpose())).symmetric_eigen();
        let mut order: Vec<usize> =
            (0..self.names.len()).filter(|&k| eigen.eigenvalues[k] > 1.0 / (log_sd * log_sd)).collect();
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        DMatrix::from_fn(self.names.len(), order.len(), |r, k| eigen.eigenvectors[(r, order[k])])
    }
    /// Odds among fabrics of the same table, nearest first. The mesh's error counts on every combination alike.
    ///
    /// # Errors
    /// [`Error::Length`] for a fabric of another table.
    pub fn odds(&self, fabrics: &[(String, Vec<f64>)], mesh_log_sd: f64) -> Result<Vec<FabricOdds>> {
        let n = self.names.len();
        let eigen = (0.5 * (&self.information + self.information.transpose())).symmetric_eigen();
        let mut out = Vec::with_capacity(fabrics.len());
        for (name, values) in fabrics {
            Error::check_length(&format!("parameters of {name}"), n, values.len())?;
            let change = DVector::from_fn(n, |i, _| {
                let (to, from) = (values[i], self.values[i]);
                if to * from > 0.0 { (to / from).ln() } else { (to - from) / from.abs().max(f64::MIN_POSITIVE) }
            });
            let distance2 = (0..n)
                .map(|k| {
                    let value = eigen.eigenvalues[k];
                    // Combinations that nothing determines tell no fabrics apart.
                    if value <= 0.0 {
                        return 0.0;
                    }
                    let v = eigen.eigenvectors.column(k);
                    let best = -v.dot(&self.slope) / (value + 1.0);
                    (v.dot(&change) - best).powi(2) / (1.0 / value + mesh_log_sd * mesh_log_sd)
                })
                .sum();
            out.push(FabricOdds { name: name.clone(), distance2, probability: 0.0 });
        }
        let least = out.iter().map(|o| o.distance2).fold(f64::INFINITY, f64::min);
        let total: f64 = out.iter().map(|o| (-0.5 * (o.distance2 - least)).exp()).sum();
        out.iter_mut().for_each(|o| o.probability = (-0.5 * (o.distance2 - least)).exp() / total);
        out.sort_by(|a, b| a.distance2.total_cmp(&b.distance2));
        Ok(out)
    }
}
