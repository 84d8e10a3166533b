//! From a recorded skeleton to the SMPL-X joints, the same way for every format.
//!
//! A retarget of directions, not a fit of a body to markers: each joint turns as its source does in the world, corrected
//! by the smallest rotation from the T-pose's limb to the skeleton's rest direction. Limb directions of the result are
//! the recorded ones. What it cannot know: bones of other proportions, shoulder centres that are placed differently.

use super::mapping::{SkeletonMapping, SkeletonRest};
use caphy_core::pose::{Pose, SMPLX_JOINTS, SMPLX_PARENTS, smplx_joint};
use caphy_core::{Error, Result, Vec3};
use nalgebra::UnitQuaternion;
use std::path::Path;

/// A joint of a recorded skeleton.
pub(super) struct SourceJoint {
    pub name: String,
    /// Rest direction of its limb in the file's world, unit length; `None` where the file shows none.
    pub direction: Option<Vec3>,
}

/// One body joint that follows the skeleton.
struct Followed {
    joint: usize,
    source: usize,
    /// From the T-pose's limb to the source's rest direction.
    correction: UnitQuaternion<f64>,
}

/// Turns frames of one skeleton into poses.
pub(super) struct Retarget {
    followed: Vec<Followed>,
    pelvis: usize,
    /// File's world to y up, resting skeleton to +z.
    upright: UnitQuaternion<f64>,
    metres: f64,
}

/// Direction of a limb in the T-pose; `None` for what is not a limb (trunk, head, collars, feet) and rests alike everywhere.
pub(super) fn t_pose_limb(joint: &str) -> Option<Vec3> {
    let (side, part) = joint.split_once('_')?;
    match part {
        "hip" | "knee" => Some(-Vec3::y()),
        "shoulder" | "elbow" | "wrist" => Some(if side == "left" { Vec3::x() } else { -Vec3::x() }),
        _ => None,
    }
}

/// First joint of the fingers: from there on, rest directions are the hand's.
const FIRST_FINGER: usize = 25;

impl Retarget {
    /// `metres` per length unit of the file.
    ///
    /// # Errors
    /// [`Error::Format`]: mapped joints that the skeleton lacks (listing its own), a limb without a rest direction.
    pub(super) fn new(path: &Path, skeleton: &[SourceJoint], mapping: &SkeletonMapping, metres: f64) -> Result<Self> {
        let turned = mapping.up.to_y_up();
        let upright = match mapping.facing {
            None => turned,
            Some(facing) => {
                let looks = turned * facing.direction();
                UnitQuaternion::from_axis_angle(&Vec3::y_axis(), -looks.x.atan2(looks.z)) * turned
            }
        };
        // Parents before children, as the corrections of fingers are their wrist's.
        let mut pairs = Vec::with_capacity(mapping.joints.len());
        for (name, target) in &mapping.joints {
            let source = skeleton.iter().position(|j| j.name == *name);
            let (Some(joint), Some(source)) = (smplx_joint(target), source) else {
                let known: Vec<&str> = skeleton.iter().map(|j| j.name.as_str()).collect();
                return Err(Error::format(
                    path,
                    format!("joint `{name}`"),
                    format!("{} asks for it, the skeleton does not have it", mapping.path().display()),
                    format!("give a mapping for this skeleton; its joints: {}", known.join(", ")),
                ));
            };
            pairs.push((joint, source));
        }
        pairs.sort_unstable();
        let mut followed: Vec<Followed> = Vec::with_capacity(pairs.len());
        for (joint, source) in pairs {
            let correction = if mapping.rest == SkeletonRest::TPose {
                UnitQuaternion::identity()
            } else if joint >= FIRST_FINGER {
                let mut above = std::iter::successors(Some(joint), |&j| (j > 0).then(|| SMPLX_PARENTS[j])).skip(1);
                let parent = above.find_map(|j| followed.iter().find(|f| f.joint == j));
                parent.map_or_else(UnitQuaternion::identity, |f| f.correction)
            } else {
                let name = &skeleton[source].name;
                let given = mapping.rest_directions.get(name).and_then(|d| Vec3::from(*d).try_normalize(1e-9));
                match (t_pose_limb(SMPLX_JOINTS[joint]), given.or(skeleton[source].direction)) {
                    (None, _) => UnitQuaternion::identity(),
                    (Some(_), None) => {
                        return Err(Error::format(
                            path,
                            format!("joint `{name}`"),
                            "has no rest direction: nothing is attached at a distance from it",
                            format!("give one in [rest_directions] of {}", mapping.path().display()),
                        ));
                    }
                    (Some(limb), Some(direction)) => UnitQuaternion::rotation_between(&limb, &(upright * direction))
                        // Opposite directions: half a turn about the viewing axis keeps front in front.
                        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vec3::z_axis(), std::f64::consts::PI)),
                }
            };
            followed.push(Followed { joint, source, correction });
        }
        let pelvis = followed.first().map_or(0, |f| f.source);
        Ok(Self { followed, pelvis, upright, metres })
    }
    /// Which joint of the skeleton says where the pelvis is.
    pub(super) fn pelvis(&self) -> usize {
        self.pelvis
    }
    /// One frame: `world` rotations of all joints and the `position` of [`Retarget::pelvis`] [file's unit], for a body with
    /// its rest pelvis at `rest_pelvis` [m].
    pub(super) fn pose(&self, world: &[UnitQuaternion<f64>], position: &Vec3, rest_pelvis: &Vec3) -> Pose {
        // None: the joint keeps its parent's rotation.
        let mut turned = [None; SMPLX_JOINTS.len()];
        for f in &self.followed {
            turned[f.joint] = Some(self.upright * world[f.source] * self.upright.inverse() * f.correction);
        }
        let mut rotations = vec![Vec3::zeros(); SMPLX_JOINTS.len()];
        for joint in 0..SMPLX_JOINTS.len() {
            let parent = match joint {
                0 => UnitQuaternion::identity(),
                _ => turned[SMPLX_PARENTS[joint]].unwrap_or_else(UnitQuaternion::identity),
            };
            let own = *turned[joint].get_or_insert(parent);
            rotations[joint] = (parent.inverse() * own).scaled_axis();
        }
        Pose { rotations, translation: self.upright * position * self.metres - rest_pelvis }
    }
}

/// A turn by `angle` [rad] about axis 0, 1 or 2.
pub(super) fn turn(axis: usize, angle: f64) -> UnitQuaternion<f64> {
    let axes = [Vec3::x_axis(), Vec3::y_axis(), Vec3::z_axis()];
    UnitQuaternion::from_axis_angle(&axes[axis], angle)
}
