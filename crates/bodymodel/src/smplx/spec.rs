//! The `[body]` table with `type = "smplx"`.

use super::{SmplxOptions, load};
use caphy_core::Result;
use caphy_core::body::{BodyModel, BodySpec};
use caphy_core::files::Files;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// A body in the SMPL-X layout from a file.
///
/// ```toml
/// [body]
/// type = "smplx"
/// path = "models/SMPLX_NEUTRAL.npz"   # of any gender
/// shape_coefficients = 10
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SmplxSpec {
    /// The `.npz` file, version 1.0 (10 + 10) or 1.1 (300 + 100).
    pub path: PathBuf,
    /// Number of shape coefficients to keep. Default: up to 10, what scans of a clothed person determine. More than the file
    /// has is refused.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shape_coefficients: Option<usize>,
    /// Number of expression coefficients to keep. Default: up to 10.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expression_coefficients: Option<usize>,
    /// Number of leading columns of `shapedirs` that are shape, the rest being expression. Default, as the official package:
    /// 300 of at least 400 columns, else 10.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shape_columns: Option<usize>,
    /// Whether the file's mean hand pose is added to the rotations of the fingers: zero rotations are then relaxed hands
    /// instead of flat ones (`flat_hand_mean = False` of the official package). Default false, since AMASS clips contain the
    /// mean already.
    #[serde(default)]
    pub hand_mean: bool,
    /// Whether the landmarks have the 17 points of the face's contour, which slide as the head turns
    /// (`use_face_contour = True`). Default false.
    #[serde(default)]
    pub face_contour: bool,
    /// Vertices by name that stand for joints (nose, toes, finger tips, …) instead of those of SMPL-X, for other surfaces.
    /// Default: those of SMPL-X for a surface of 10475 vertices, none for others.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub extra_joints: BTreeMap<String, u32>,
}

impl SmplxSpec {
    /// How the file is read.
    pub fn options(&self) -> SmplxOptions {
        SmplxOptions {
            shape_coefficients: self.shape_coefficients,
            expression_coefficients: self.expression_coefficients,
            shape_columns: self.shape_columns,
            hand_mean: self.hand_mean,
            face_contour: self.face_contour,
            extra_joints: self.extra_joints.clone(),
        }
    }
}

#[typetag::serde(name = "smplx")]
impl BodySpec for SmplxSpec {
    fn build(&self, files: &dyn Files) -> Result<Box<dyn BodyModel>> {
        Ok(Box::new(load(&self.path, files.read(&self.path)?, &self.options())?))
    }
}
