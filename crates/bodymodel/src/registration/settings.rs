//! Knobs of the registration.

use caphy_core::{Error, Result};
use serde::{Deserialize, Serialize};

/// Knobs of [`register`](super::register): the `[registration]` table of a configuration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RegistrationSettings {
    /// Gauss-Newton iterations of the joint stage (default 36): two thirds go from coarse to fine, in the last third dT is found in turn
    /// with pose and shape.
    pub iterations: usize,
    /// Iterations with which every start pose of the search is tried before the best one is kept (default 10).
    pub start_iterations: usize,
    /// Start poses that go from the coarse search into the trial (default 3: enough to tell front from back).
    pub start_trials: usize,
    /// Headings that the search starts from, evenly around the vertical (default 4; 1 when all scans face +z).
    pub start_headings: usize,
    /// Points of the scan, and vertices of the body, that carry residuals at the end (default 6000: 1.8 cm apart on an adult); a third of
    /// them before.
    pub sample_vertices: usize,
    /// Shape coefficients that are fitted; fewer when the body has fewer (default 10).
    pub shape_coefficients: usize,
    /// Number of independent residuals in each direction [1] (default 150): neighbouring residuals are correlated over
    /// about 8 cm on a surface of 2 m², and both directions see the same surface. This many, not `sample_vertices`, are
    /// weighed against the priors.
    pub evidence: f64,
    /// Standard deviation of bare skin about the scan [m] (default 4 mm: scan noise and the shape space's misfit).
    pub skin_sigma: f64,
    /// Standard deviation of skin that sticks out of cloth [m] (default 4 mm).
    pub outside_sigma: f64,
    /// Depth of the skin under cloth that is expected when nothing else is known [m] (default 8 mm: cloth and its
    /// ease).
    pub cloth_ease: f64,
    /// Standard deviation of that expectation [m] (default 0.1: hardly more than nothing). Cloth stands off where it hangs and lies on
    /// where it rests: expected everywhere alike, it pulls hips and thighs after the folds by centimetres.
    pub cloth_ease_sigma: f64,
    /// Depth of the skin under cloth beyond which it is pulled out [m] (default 30 mm: loose everyday clothes).
    pub cloth_depth_max: f64,
    /// Standard deviation of skin deeper than that [m] (default 60 mm: folds and hems do lie deeper).
    pub cloth_deep_sigma: f64,
    /// Depth of the skin under cloth that touches it [m] (default 3 mm: cloth and the scan's roughness). Where cloth comes to lie on
    /// the skin in some of the poses, dT moves the skin there.
    pub contact_gap: f64,
    /// Standard deviation of that depth [m] (default 5 mm).
    pub contact_sigma: f64,
    /// Cloth that stays farther from touching than this in all scans hardly says where the skin is [m] (default 6 mm).
    pub contact_reach: f64,
    /// Robust scale (Geman-McClure) of the first iteration [m] (default 0.15: a limb's width away still pulls).
    pub robust_start: f64,
    /// Robust scale of the last iterations [m] (default 0.012: hair, bags, hems and holes stop pulling).
    pub robust_end: f64,
    /// Largest angle between the normals of corresponding points [rad] (default 1.2: 70°).
    pub normal_angle_max: f64,
    /// Scales the joints' prior standard deviations [1] (default 1; larger trusts the scan more).
    pub pose_prior_scale: f64,
    /// Scales the shape's prior standard deviation N(0, 1) [1] (default 1).
    pub shape_prior_scale: f64,
    /// Standard deviation of a displacement dT [m] (default 5 mm); 0 leaves dT zero.
    pub displacement_sigma: f64,
    /// Distance over which dT is smooth [m] (default 4 cm: wider than folds, narrower than a calf).
    pub displacement_smoothness: f64,
}

impl Default for RegistrationSettings {
    fn default() -> Self {
        Self {
            iterations: 36,
            start_iterations: 10,
            start_trials: 3,
            start_headings: 4,
            sample_vertices: 6000,
            shape_coefficients: 10,
            evidence: 150.0,
            skin_sigma: 0.004,
            outside_sigma: 0.004,
            cloth_ease: 0.008,
            cloth_ease_sigma: 0.1,
            cloth_depth_max: 0.03,
            cloth_deep_sigma: 0.06,
            contact_gap: 0.003,
            contact_sigma: 0.005,
            contact_reach: 0.006,
            robust_start: 0.15,
            robust_end: 0.012,
            normal_angle_max: 1.2,
            pose_prior_scale: 1.0,
            shape_prior_scale: 1.0,
            displacement_sigma: 0.005,
            displacement_smoothness: 0.04,
        }
    }
}

impl RegistrationSettings {
    /// Refuses values that cannot be used.
    ///
    /// # Errors
    /// [`Error::Config`] naming the key, the value and the range.
    pub fn check(&self) -> Result<()> {
        let counts = [
            ("iterations", self.iterations),
            ("start_trials", self.start_trials),
            ("start_headings", self.start_headings),
            ("sample_vertices", self.sample_vertices),
        ];
        for (key, value) in counts {
            if value == 0 {
                return Err(Error::config(format!("registration.{key}"), "is 0", "give at least 1"));
            }
        }
        let positive = [
            ("evidence", self.evidence),
            ("skin_sigma", self.skin_sigma),
            ("outside_sigma", self.outside_sigma),
            ("cloth_ease_sigma", self.cloth_ease_sigma),
            ("cloth_deep_sigma", self.cloth_deep_sigma),
            ("contact_sigma", self.contact_sigma),
            ("contact_reach", self.contact_reach),
            ("robust_start", self.robust_start),
            ("robust_end", self.robust_end),
            ("normal_angle_max", self.normal_angle_max),
            ("pose_prior_scale", self.pose_prior_scale),
            ("shape_prior_scale", self.shape_prior_scale),
            ("displacement_smoothness", self.displacement_smoothness),
        ];
        for (key, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return Err(Error::config(
                    format!("registration.{key}"),
                    format!("is {value}"),
                    "give a positive number",
                ));
            }
        }
        let not_negative = [
            ("cloth_ease", self.cloth_ease),
            ("cloth_depth_max", self.cloth_depth_max),
            ("displacement_sigma", self.displacement_sigma),
            ("contact_gap", self.contact_gap),
        ];
        for (key, value) in not_negative {
            if !(value.is_finite() && value >= 0.0) {
                return Err(Error::config(format!("registration.{key}"), format!("is {value}"), "give 0 or more"));
            }
        }
        if self.cloth_ease > self.cloth_depth_max {
            return Err(Error::config(
                "registration.cloth_ease",
                format!("is {} m, deeper than cloth_depth_max = {} m", self.cloth_ease, self.cloth_depth_max),
                "raise cloth_depth_max or lower cloth_ease",
            ));
        }
        Ok(())
    }
}
