//! The `[body]` table with `type = "smplx"`.

use super::{SmplxOptions, load};
use caphy_core::Result;
use caphy_core::body::{BodyModel, BodySpec};
use caphy_core::files::Files;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// A body in the SMPL-X layout from a file.
///
/// ```toml
/// [body]
/// type = "smplx"
/// path = "models/SMPLX_NEUTRAL.npz"
/// shape_coefficients = 10
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SmplxSpec {
    /// The `.npz` file, version 1.0 (10 + 10) or 1.1 (300 + 100).
    pub path: PathBuf,
    /// Largest number of shape coefficients to keep. Default 10: what scans of a clothed person determine.
    #[serde(default = "default_coefficients")]
    pub shape_coefficients: usize,
    /// Largest number of expression coefficients to keep. Default 10.
    #[serde(default = "default_coefficients")]
    pub expression_coefficients: usize,
}

fn default_coefficients() -> usize {
    10
}

#[typetag::serde(name = "smplx")]
impl BodySpec for SmplxSpec {
    fn build(&self, files: &dyn Files) -> Result<Box<dyn BodyModel>> {
        let options = SmplxOptions {
            shape_coefficients: self.shape_coefficients,
            expression_coefficients: self.expression_coefficients,
        };
        Ok(Box::new(load(&self.path, files.read(&self.path)?, &options)?))
    }
}
