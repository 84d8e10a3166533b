//! Which joint of a recorded skeleton moves which joint of the body.

use super::axes::UpAxis;
use super::retarget::t_pose_limb;
use caphy_core::pose::{SMPLX_JOINTS, smplx_joint};
use caphy_core::{Error, Result, Vec3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// How a skeleton stands when all its channels are zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SkeletonRest {
    /// As its bones say: arms and legs are corrected by the smallest rotation from the T-pose's limb to the bone.
    #[default]
    Skeleton,
    /// In the T-pose: rotations are taken as they are.
    TPose,
}

/// A skeleton's mapping to the SMPL-X joints, as a TOML file:
///
/// ```toml
/// up = "z"                  # the file's upward axis: "y" (default), "-y", "z", "-z", "x" or "-x"
/// facing = "-y"             # where the skeleton looks at rest; by default what turning `up` to y brings to +z
/// metres_per_unit = 0.01    # centimetres
/// rest = "skeleton"         # or "t_pose"
///
/// [joints]                  # joint of the file = SMPL-X joint; `pelvis` is needed, others rest if not named
/// Hips = "pelvis"
/// LeftUpLeg = "left_hip"
///
/// [rest_directions]         # of limbs of the file, in its axes, where its skeleton does not say or says it wrong
/// LeftUpLeg = [0.0, 0.0, -1.0]
/// ```
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SkeletonMapping {
    /// Upward axis of the file's world.
    #[serde(default)]
    pub up: UpAxis,
    /// Where the resting skeleton looks.
    #[serde(default)]
    pub facing: Option<UpAxis>,
    /// Metres per length unit of the file; ASF skeletons divide it by their own `length`.
    pub metres_per_unit: f64,
    /// The skeleton's rest pose.
    #[serde(default)]
    pub rest: SkeletonRest,
    /// SMPL-X joint of each joint of the file that is followed.
    pub joints: BTreeMap<String, String>,
    /// Rest direction of a limb by its joint in the file.
    #[serde(default)]
    pub rest_directions: BTreeMap<String, [f64; 3]>,
    /// Where it was read, for messages.
    #[serde(skip)]
    path: PathBuf,
}

impl SkeletonMapping {
    /// Reads a mapping file.
    ///
    /// # Errors
    /// [`Error::Format`]: no TOML, unknown keys, unknown or doubly used SMPL-X joints (listing those that exist), no pelvis,
    /// lengths and directions that are no positive finite ones.
    pub fn from_toml(path: &Path, bytes: &[u8]) -> Result<Self> {
        let bad = |at: String, problem: String, remedy: String| Error::format(path, at, problem, remedy);
        let text = std::str::from_utf8(bytes).map_err(|e| {
            bad(format!("byte {}", e.valid_up_to()), "is no UTF-8 text".into(), "save it as UTF-8".into())
        })?;
        let mut mapping: Self = toml::from_str(text).map_err(|e| {
            let line = e.span().map_or(1, |s| text[..s.start.min(text.len())].matches('\n').count() + 1);
            bad(format!("line {line}"), e.message().to_string(), "see SkeletonMapping for the keys".into())
        })?;
        mapping.path = path.into();
        mapping.check()?;
        Ok(mapping)
    }
    /// The bones of the CMU database's `.asf` skeletons.
    pub fn cmu_asf() -> Result<Self> {
        Self::from_toml(Path::new("built-in mapping cmu_asf"), include_bytes!("mappings/cmu_asf.toml"))
    }
    /// The joints of the CMU database as cgspeed converted it to BVH.
    pub fn cmu_bvh() -> Result<Self> {
        Self::from_toml(Path::new("built-in mapping cmu_bvh"), include_bytes!("mappings/cmu_bvh.toml"))
    }
    /// The same mapping with another length unit.
    ///
    /// # Errors
    /// [`Error::Format`] for a unit that is not positive and finite.
    pub fn with_metres_per_unit(self, metres_per_unit: f64) -> Result<Self> {
        let mapping = Self { metres_per_unit, ..self };
        mapping.check()?;
        Ok(mapping)
    }
    /// Where the mapping was read.
    pub fn path(&self) -> &Path {
        &self.path
    }

    fn check(&self) -> Result<()> {
        let bad = |key: String, problem: String, remedy: String| {
            Error::format(&self.path, format!("`{key}`"), problem, remedy)
        };
        if !(self.metres_per_unit.is_finite() && self.metres_per_unit > 0.0) {
            let problem = format!("is {}", self.metres_per_unit);
            return Err(bad("metres_per_unit".into(), problem, "give a positive length, 0.01 for centimetres".into()));
        }
        if let Some(facing) = self.facing
            && facing.direction().dot(&self.up.direction()) != 0.0
        {
            return Err(bad("facing".into(), "lies along `up`".into(), "name a horizontal axis".into()));
        }
        let mut used: Vec<Option<&str>> = vec![None; SMPLX_JOINTS.len()];
        for (source, target) in &self.joints {
            let Some(joint) = smplx_joint(target) else {
                let problem = format!("there is no SMPL-X joint `{target:.40}`");
                return Err(bad(format!("joints.{source}"), problem, format!("joints: {}", SMPLX_JOINTS.join(", "))));
            };
            if let Some(other) = used[joint].replace(source) {
                let problem = format!("`{target}` already follows `{other}`");
                return Err(bad(format!("joints.{source}"), problem, "name each SMPL-X joint once".into()));
            }
        }
        if used[0].is_none() {
            let problem = "no joint is mapped to `pelvis`".to_string();
            return Err(bad("joints".into(), problem, "map the root of the hips to it".into()));
        }
        for (source, direction) in &self.rest_directions {
            let key = || format!("rest_directions.{source}");
            let Some(target) = self.joints.get(source) else {
                return Err(bad(key(), "is not among `joints`".into(), "map the joint, or leave it out".into()));
            };
            if t_pose_limb(target).is_none() {
                let problem = format!("has no effect: `{target}` is taken as it rests");
                return Err(bad(key(), problem, "only hips, knees, shoulders, elbows and wrists are corrected".into()));
            }
            if self.rest == SkeletonRest::TPose {
                let remedy = "leave it out, or set rest = \"skeleton\"".to_string();
                return Err(bad(key(), "has no effect when the skeleton rests in the T-pose".into(), remedy));
            }
            if Vec3::from(*direction).try_normalize(1e-9).is_none_or(|d| !d.iter().all(|x| x.is_finite())) {
                return Err(bad(key(), format!("is {direction:?}"), "give a direction of some length".into()));
            }
        }
        Ok(())
    }
}
