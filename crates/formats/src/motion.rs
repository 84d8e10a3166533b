//! Motion clips from files, as poses of the 55 SMPL-X joints, y up.
//!
//! Files say where the pelvis is; a [`Pose`](caphy_core::pose::Pose) says what is added to a body whose pelvis is where
//! its shape puts it. Readers therefore take the rest pelvis of the body that will be moved.

mod asf_amc;
mod axes;
mod bvh;
mod mapping;
mod retarget;
mod smpl_npz;
mod text;

pub use asf_amc::read_asf_amc;
pub use axes::UpAxis;
pub use bvh::read_bvh;
pub use mapping::{SkeletonMapping, SkeletonRest};
pub use smpl_npz::{SmplNpzOptions, TranslationMeaning, read_smpl_npz};

use caphy_core::motion::MotionClip;
use caphy_core::pose::Pose;
use caphy_core::{Error, Result};
use std::path::Path;

/// The clip of a file, named after it.
///
/// # Errors
/// [`Error::Format`] naming the frame whose numbers overflowed on the way to a pose; those of [`MotionClip::new`].
fn named_clip(path: &Path, fps: f64, poses: Vec<Pose>) -> Result<MotionClip> {
    let finite = |p: &Pose| p.rotations.iter().chain([&p.translation]).all(|v| v.iter().all(|x| x.is_finite()));
    if let Some(frame) = poses.iter().position(|p| !finite(p)) {
        let problem = "numbers too large for a pose";
        return Err(Error::format(path, format!("frame {frame}"), problem, "the file is damaged: get it again"));
    }
    let name = path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    MotionClip::new(name, fps, poses)
}
