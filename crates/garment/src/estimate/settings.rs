//! What the equilibrium fit is told.

use caphy_core::{Error, Result};
use serde::{Deserialize, Serialize};

/// How a fabric is fitted to scans by its simulated equilibria.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EquilibriumSettings {
    /// λ of the springs that pull the cloth to the scan while the fit begins, in weights of a vertex per mm, falling to 0. Default
    /// .3, .1, .03, 0: keeps the cloth on the scan's buckling branch. A start at 3 would pull all stiffness to zero.
    pub continuation: Vec<f64>,
    /// Most Gauss-Newton steps at each λ but the last. Default 3: what is left to do is done at the next.
    pub steps_while_held: usize,
    /// Most Gauss-Newton steps at the last λ. Default 20.
    pub steps: usize,
    /// Prior standard deviation of an unknown on a logarithmic scale, around the configured fabric. Default 1: a factor of 2.7.
    pub prior_log_sd: f64,
    /// Share of the prior's variance that all unknowns on a logarithmic scale have in common: a fabric that is stiffer than expected
    /// is so in most ways. Default 0.8. With 0, an unknown that the poses say little of stays behind the others, and a fit from
    /// four times too stiff tries fabrics that are no sheet.
    pub prior_common: f64,
    /// Largest change of an unknown in one step. Default 0.7: a factor of two.
    pub largest_step: f64,
    /// Converged when no unknown moves by more than this share of its predicted standard deviation. Default 0.02.
    pub tolerance: f64,
    /// Distances above so many standard deviations of the noise count linearly (Huber). Default 3.
    pub robust_at: f64,
    /// A pose whose χ² per point is so many times that of the median pose is left out. Default 1.3: a thousand points scatter by 0.04,
    /// and a pose on a neighbouring fold at 1.4 was seen to shift shear by 10 %.
    pub gate: f64,
    /// Whether rest-shape ease (girth and length of each part of the cut: trunk, sleeves, legs of what is worn) is fitted along, with
    /// this prior standard deviation (share of the length). Default 0: not fitted. 0.02 is right for garments whose cut is not known.
    pub ease_sd: f64,
    /// Whether a smooth offset of the body's surface is fitted along, with this prior standard deviation [m]. Default 0: not
    /// fitted. 0.002 is right for bodies found under clothes.
    pub body_offset_sd_m: f64,
    /// What the mesh adds to the standard deviation of a logarithm. Default 0.15: cloth cut into other triangles of the same size
    /// gives values within 30 %; twice as fine or coarse, take 0.35. Only for data of this very mesh, 0.
    pub mesh_log_sd: f64,
    /// Where poses fit worse than the scans' noise, the misfit (of the body, the cut, the model) is taken as alike over patches of this
    /// size [m], so that thousands of points do not make up for it. Default 0.05: folds and limbs are of this size.
    pub misfit_length_m: f64,
    /// Friction coefficients between which the fit is repeated at the end where there is contact; half their spread is added to the
    /// interval. Default 0, 0.3, 0.6: nobody measured it. Empty: the configured one is believed.
    pub friction_spread: Vec<f64>,
    /// Unknowns with a predicted standard deviation of the logarithm above this are called held by the prior. Default 0.5.
    pub held_above: f64,
    /// Softest modes per pose that are looked at: what slides freely is not evidence. Default 4.
    pub soft_modes: usize,
}

impl Default for EquilibriumSettings {
    fn default() -> Self {
        Self {
            continuation: vec![0.3, 0.1, 0.03, 0.0],
            steps_while_held: 3,
            steps: 20,
            prior_log_sd: 1.0,
            prior_common: 0.8,
            largest_step: 0.7,
            tolerance: 0.02,
            robust_at: 3.0,
            gate: 1.3,
            ease_sd: 0.0,
            body_offset_sd_m: 0.0,
            mesh_log_sd: 0.15,
            misfit_length_m: 0.05,
            friction_spread: vec![0.0, 0.3, 0.6],
            held_above: 0.5,
            soft_modes: 4,
        }
    }
}

impl EquilibriumSettings {
    /// `Ok` for settings that can act.
    ///
    /// # Errors
    /// [`Error::Config`] naming the key.
    pub fn check(&self) -> Result<()> {
        let refuse = |key: &str, problem: String, remedy: &str| Err(Error::config(key, problem, remedy));
        let falling = self.continuation.windows(2).all(|w| w[0] > w[1]);
        if !falling || self.continuation.last() != Some(&0.0) || self.continuation.iter().any(|l| !l.is_finite()) {
            let problem = format!("{:?} does not fall to 0", self.continuation);
            return refuse("continuation", problem, "give falling numbers that end with 0, or [0.0] alone");
        }
        let positive = [
            ("prior_log_sd", self.prior_log_sd),
            ("largest_step", self.largest_step),
            ("tolerance", self.tolerance),
            ("robust_at", self.robust_at),
            ("held_above", self.held_above),
            ("misfit_length_m", self.misfit_length_m),
        ];
        for (key, value) in positive {
            if !(value > 0.0 && value.is_finite()) {
                return refuse(key, value.to_string(), "give a positive number");
            }
        }
        for (key, value) in
            [("ease_sd", self.ease_sd), ("body_offset_sd_m", self.body_offset_sd_m), ("mesh_log_sd", self.mesh_log_sd)]
        {
            if !(value >= 0.0 && value.is_finite()) {
                return refuse(key, value.to_string(), "give a number that is not negative");
            }
        }
        if !(0.0..1.0).contains(&self.prior_common) {
            return refuse("prior_common", self.prior_common.to_string(), "give a share from 0 to below 1");
        }
        if self.gate.is_nan() || self.gate <= 1.0 {
            return refuse("gate", self.gate.to_string(), "give more than 1, or every other pose is left out");
        }
        if self.steps == 0 {
            return refuse("steps", "0".into(), "allow at least one step");
        }
        if self.friction_spread.iter().any(|f| !(*f >= 0.0 && f.is_finite())) {
            return refuse("friction_spread", format!("{:?}", self.friction_spread), "give coefficients from 0 up");
        }
        Ok(())
    }
}
