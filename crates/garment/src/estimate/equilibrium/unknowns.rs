//! Everything that the fit turns: the fabric, and what nobody wants to know but has to.

use super::super::capture::{Capture, Surroundings};
use super::super::cut::CutPart;
use super::super::reduction::Reduction;
use super::super::settings::EquilibriumSettings;
use caphy_core::{Error, Result, Vec3};
use nalgebra::DMatrix;

/// Names of the body's offset [m]: the same everywhere, and growing along x, y, z of the first body.
const OFFSET: [&str; 4] = ["body offset", "body offset by x", "body offset by y", "body offset by z"];
/// An offset moves by one in this many metres in the fit, so that all unknowns are of one size.
const OFFSET_SCALE_M: f64 = 1e-3;

/// What unknowns there are, in their order: fabric, ease, offset.
pub(crate) struct Unknowns {
    pub(crate) reduction: Reduction,
    /// Names of the rest-shape eases; none where the cut is believed.
    ease: Vec<String>,
    /// Values of the offset's four shapes at each body vertex, in [−1, 1].
    offset: Option<Vec<[f64; 4]>>,
    pub(crate) prior_sd: Vec<f64>,
    /// Inverse of the prior's covariance.
    pub(crate) prior: DMatrix<f64>,
}

impl Unknowns {
    pub(crate) fn new(
        reduction: Reduction,
        parts: &[CutPart],
        captures: &[Capture],
        settings: &EquilibriumSettings,
    ) -> Result<Self> {
        let mut prior_sd = vec![settings.prior_log_sd; reduction.len()];
        let ease = if settings.ease_sd > 0.0 { CutPart::unknowns(parts) } else { Vec::new() };
        prior_sd.extend(ease.iter().map(|_| settings.ease_sd));
        let mut offset = None;
        if settings.body_offset_sd_m > 0.0 {
            offset = Some(offset_shapes(captures)?);
            prior_sd.extend([settings.body_offset_sd_m / OFFSET_SCALE_M; 4]);
        }
        let prior = precision(&reduction, settings, &prior_sd);
        Ok(Self { reduction, ease, offset, prior_sd, prior })
    }
    pub(crate) fn len(&self) -> usize {
        self.prior_sd.len()
    }
    /// Number of those that are the fabric's.
    pub(crate) fn fabric(&self) -> usize {
        self.reduction.len()
    }
    pub(crate) fn start(&self) -> Vec<f64> {
        let mut y: Vec<f64> = self.reduction.start.iter().copied().collect();
        y.resize(self.len(), 0.0);
        y
    }
    pub(crate) fn limits(&self, k: usize) -> [f64; 2] {
        if k < self.fabric() { self.reduction.limits(k) } else { [-5.0, 5.0].map(|f| f * self.prior_sd[k]) }
    }
    /// Name, unit and metres or shares per unit of an unknown that is not the fabric's.
    pub(crate) fn nuisance(&self, k: usize) -> (&str, &'static str, f64) {
        let at = k - self.fabric();
        match self.ease.get(at) {
            Some(name) => (name, "1", 1.0),
            None => (OFFSET[at - self.ease.len()], "m", OFFSET_SCALE_M),
        }
    }
    /// The eases among unknowns, in the order of [`CutPart::unknowns`].
    pub(crate) fn eases<'y>(&self, y: &'y [f64]) -> &'y [f64] {
        &y[self.fabric()..][..self.ease.len()]
    }
    pub(crate) fn offset_at(&self, shape: usize) -> Option<usize> {
        self.offset.as_ref().map(|_| self.fabric() + self.ease.len() + shape)
    }
    /// The body with its offset.
    pub(crate) fn body(&self, body: &Surroundings, y: &[f64]) -> Surroundings {
        match (&self.offset, self.offset_at(0)) {
            (Some(shapes), Some(first)) => {
                body.offset(|v| (0..4).map(|k| OFFSET_SCALE_M * y[first + k] * shapes[v][k]).sum())
            }
            _ => body.clone(),
        }
    }
}

/// Inverse of sd² (s 1 1ᵀ + (1 − s) I) for the fabric, s the common share, and of sd² for the others.
fn precision(reduction: &Reduction, settings: &EquilibriumSettings, sd: &[f64]) -> DMatrix<f64> {
    let p = reduction.len();
    let common = if reduction.logarithmic { settings.prior_common } else { 0.0 };
    let own = 1.0 - common;
    // Sherman and Morrison.
    let off = common / (own * (own + common * p as f64));
    DMatrix::from_fn(sd.len(), sd.len(), |i, j| {
        let unit = f64::from(u8::from(i == j));
        let value = if i < p && j < p { unit / own - off } else { unit };
        value / (sd[i] * sd[j])
    })
}

fn offset_shapes(captures: &[Capture]) -> Result<Vec<[f64; 4]>> {
    let Some(first) = captures.iter().find_map(|c| c.body.as_ref()) else {
        return Err(Error::config(
            "body_offset_sd_m",
            "no pose has a body whose surface could be off",
            "leave it out, or give the body of a pose",
        ));
    };
    let n = first.positions.vertices();
    for capture in captures {
        if let Some(body) = &capture.body {
            Error::check_length(&format!("body vertices of pose `{}`", capture.name), n, body.positions.vertices())?;
        }
    }
    let points: Vec<Vec3> = first.positions.frame(0, 0);
    let (low, high) = caphy_core::mesh::bounds(&points).unwrap_or_default();
    let (middle, half) = ((low + high) * 0.5, ((high - low) * 0.5).map(|h| h.max(1e-9)));
    Ok(points
        .iter()
        .map(|p| {
            let s = (p - middle).component_div(&half);
            [1.0, s.x, s.y, s.z]
        })
        .collect())
}
