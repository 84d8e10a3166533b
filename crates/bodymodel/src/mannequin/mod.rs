//! The embedded default body: a smooth adult mannequin in the SMPL-X joint layout, generated, free of licences.
//!
//! Solids along the skeleton (`figure`, `head`, `hand`) are blended into one implicit surface, meshed on a grid that is
//! finer at hands, head and feet (`grid`), relaxed and mirrored (`surface`), skinned (`skinning`, `regressor`), given pose
//! correctives (`correctives`) and ten shape coefficients (`shape`); the result is the same [`BodySmplx`] that files
//! give. All of it is its own mirror image to the bit.

mod correctives;
mod field;
mod figure;
mod grid;
mod hand;
mod head;
mod regressor;
mod shape;
mod skinning;
mod surface;

pub use shape::MANNEQUIN_SHAPE;

use crate::smplx::{BodySmplx, SmplxArrays};
use caphy_core::body::{BodyModel, BodySpec};
use caphy_core::files::Files;
use caphy_core::{Error, Result};
use serde::{Deserialize, Serialize};

/// The mannequin: about 9700 vertices at the default resolution, T-pose, pelvis joint at the origin, 1.72 m tall,
/// ten shape coefficients (see [`MANNEQUIN_SHAPE`]), pose correctives of limbs and neck, no expression.
///
/// ```toml
/// [body]
/// type = "mannequin"
/// resolution = 0.020
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BodyMannequin {
    /// Size of the cells from which trunk and limbs are made [m]; about the mean edge length there. Head and feet have
    /// about half, fingers at most 5.5 mm. Default 0.020: the number of vertices of SMPL-X.
    #[serde(default = "default_resolution")]
    pub resolution: f64,
}

fn default_resolution() -> f64 {
    0.020
}

/// Coarser cells lose the limbs' shape, finer ones take minutes.
const RESOLUTIONS: std::ops::RangeInclusive<f64> = 0.006..=0.030;

impl Default for BodyMannequin {
    fn default() -> Self {
        Self { resolution: default_resolution() }
    }
}

impl BodyMannequin {
    /// Makes the body; the same bits for the same resolution.
    ///
    /// # Errors
    /// [`Error::Config`] for a resolution outside 0.006 to 0.030 m.
    pub fn generate(&self) -> Result<BodySmplx> {
        BodySmplx::new(self.arrays()?)
    }

    /// The arrays of the body.
    ///
    /// # Errors
    /// As [`BodyMannequin::generate`].
    pub fn arrays(&self) -> Result<SmplxArrays> {
        if !RESOLUTIONS.contains(&self.resolution) {
            return Err(Error::config(
                "body.resolution",
                format!("{} m", self.resolution),
                format!("give a value from {} to {} m", RESOLUTIONS.start(), RESOLUTIONS.end()),
            ));
        }
        let body = surface::surface(&figure::Figure::new(), self.resolution)?;
        let weights = skinning::weights(&body);
        let joints = figure::joints();
        let joint_regressor = regressor::regressor(&body, &weights, &joints, self.resolution)?;
        let shape_directions = shape::directions(&body, &weights);
        let pose_directions = correctives::directions(&body.mesh.vertices, &weights, &joints);
        Ok(SmplxArrays {
            name: "mannequin".into(),
            template: body.mesh.vertices,
            faces: body.mesh.faces,
            shape_directions,
            expression_directions: Vec::new(),
            pose_directions,
            joint_regressor,
            weights,
            joints: skinning::joint_tree(),
        })
    }
}

#[typetag::serde(name = "mannequin")]
impl BodySpec for BodyMannequin {
    fn build(&self, _files: &dyn Files) -> Result<Box<dyn BodyModel>> {
        Ok(Box::new(self.generate()?))
    }
}

/// 0 below `a`, 1 above `b`, a cubic between.
fn smoothstep(a: f64, b: f64, x: f64) -> f64 {
    let t = ((x - a) / (b - a)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
