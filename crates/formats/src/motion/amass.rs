//! Motion in AMASS's `.npz` layout: SMPL-H (156 numbers per frame) and SMPL-X (165), z up.

use super::named_clip;
use crate::npz::Npz;
use caphy_core::motion::MotionClip;
use caphy_core::pose::{Pose, SMPLX_JOINTS};
use caphy_core::{Error, Result, Vec3};
use nalgebra::Rotation3;
use std::path::Path;

/// Root and 21 body joints: the same in SMPL-H and SMPL-X.
const BODY_JOINTS: usize = 22;
/// Jaw and two eyes, which SMPL-H has not.
const FACE_JOINTS: usize = 3;

/// What the array `trans` means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AmassTranslation {
    /// Where the pelvis is [m]: clips retargeted from ASF/AMC or BVH.
    PelvisPosition,
    /// What is added to the posed body [m]: clips fitted with a body model, AMASS's own.
    BodyOffset,
}

/// Reads a clip whose `trans` is the pelvis position, for a body with its rest pelvis at `pelvis` [m].
/// See [`read_amass_npz_as`].
pub fn read_amass_npz(path: &Path, bytes: Vec<u8>, pelvis: &Vec3) -> Result<MotionClip> {
    read_amass_npz_as(path, bytes, pelvis, AmassTranslation::PelvisPosition)
}

/// Reads a clip: `poses`, shape [frames, 156 or 165] (axis-angle, rad), `trans`, shape [frames, 3] (m), and
/// `mocap_framerate` or `mocap_frame_rate` (1/s), in any number type.
///
/// The world turns from z up to y up (-90° about x: root and translation). SMPL-H's hands go to SMPL-X's, jaw and eyes
/// rest. With [`AmassTranslation::PelvisPosition`], a body with its rest pelvis at `pelvis` [m] has its pelvis where the
/// file says; with [`AmassTranslation::BodyOffset`], `pelvis` must be the rest pelvis of the body that the clip was
/// fitted with (y up).
///
/// # Errors
/// [`Error::Format`]: missing array, unknown width, unequal frame counts, values that are not finite, no frames.
pub fn read_amass_npz_as(path: &Path, bytes: Vec<u8>, pelvis: &Vec3, meaning: AmassTranslation) -> Result<MotionClip> {
    let npz = Npz::from_bytes(path, bytes)?;
    let bad = |at: &str, problem: String, remedy: &str| Error::format(path, at, problem, remedy);
    let poses = npz.f64s("poses")?;
    let &[frames, width @ (156 | 165)] = poses.shape.as_slice() else {
        return Err(bad(
            "array `poses`",
            format!("has shape {:?}", poses.shape),
            "[frames, 156] (SMPL-H) and [frames, 165] (SMPL-X) are read",
        ));
    };
    let trans = npz.f64s("trans")?;
    if trans.shape != [frames, 3] {
        let problem = format!("has shape {:?}, `poses` has {frames} frames", trans.shape);
        return Err(bad("array `trans`", problem, "[frames, 3] is needed"));
    }
    for (name, array, columns) in [("poses", &poses, width), ("trans", &trans, 3)] {
        if let Some(i) = array.data.iter().position(|x| !x.is_finite()) {
            let problem = format!("column {} is {}", i % columns, array.data[i]);
            return Err(bad(&format!("array `{name}`, frame {}", i / columns), problem, "repair or cut the clip"));
        }
    }
    let rate_name = ["mocap_framerate", "mocap_frame_rate"].into_iter().find(|n| npz.has(n));
    let rate_name = rate_name.ok_or_else(|| {
        let problem = format!("neither `mocap_framerate` nor `mocap_frame_rate` among {}", npz.names().join(", "));
        bad("whole file", problem, "add the frame rate of the clip")
    })?;
    let fps = npz.f64_scalar(rate_name)?;
    if !(fps.is_finite() && fps > 0.0) {
        return Err(bad(&format!("array `{rate_name}`"), format!("frame rate {fps} 1/s"), "it must be positive"));
    }
    if frames == 0 {
        return Err(bad("array `poses`", "has no frames".into(), "give a clip of at least one frame"));
    }

    let z_up_to_y_up = Rotation3::from_axis_angle(&Vec3::x_axis(), -std::f64::consts::FRAC_PI_2);
    let clip = poses
        .data
        .chunks_exact(width)
        .zip(trans.data.chunks_exact(3))
        .map(|(angles, position)| {
            let mut joints: Vec<Vec3> = angles.chunks_exact(3).map(Vec3::from_column_slice).collect();
            if joints.len() < SMPLX_JOINTS.len() {
                joints.splice(BODY_JOINTS..BODY_JOINTS, [Vec3::zeros(); FACE_JOINTS]);
            }
            let mut pose = Pose { rotations: joints, translation: Vec3::from_column_slice(position) };
            match meaning {
                AmassTranslation::PelvisPosition => {
                    pose.rotate_world(&z_up_to_y_up, &Vec3::zeros());
                    pose.translation -= pelvis;
                }
                AmassTranslation::BodyOffset => pose.rotate_world(&z_up_to_y_up, pelvis),
            }
            pose
        })
        .collect();
    named_clip(path, fps, clip)
}
