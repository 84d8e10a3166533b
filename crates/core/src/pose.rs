//! Poses, and the 55 joints of the SMPL-X order.

use crate::Vec3;
use nalgebra::{Rotation3, UnitQuaternion};
use serde::{Deserialize, Serialize};

/// Joint names in SMPL-X order: the vocabulary of motion clips. Bodies are matched to it by name.
pub const SMPLX_JOINTS: [&str; 55] = [
    "pelvis",
    "left_hip",
    "right_hip",
    "spine1",
    "left_knee",
    "right_knee",
    "spine2",
    "left_ankle",
    "right_ankle",
    "spine3",
    "left_foot",
    "right_foot",
    "neck",
    "left_collar",
    "right_collar",
    "head",
    "left_shoulder",
    "right_shoulder",
    "left_elbow",
    "right_elbow",
    "left_wrist",
    "right_wrist",
    "jaw",
    "left_eye_smplhf",
    "right_eye_smplhf",
    "left_index1",
    "left_index2",
    "left_index3",
    "left_middle1",
    "left_middle2",
    "left_middle3",
    "left_pinky1",
    "left_pinky2",
    "left_pinky3",
    "left_ring1",
    "left_ring2",
    "left_ring3",
    "left_thumb1",
    "left_thumb2",
    "left_thumb3",
    "right_index1",
    "right_index2",
    "right_index3",
    "right_middle1",
    "right_middle2",
    "right_middle3",
    "right_pinky1",
    "right_pinky2",
    "right_pinky3",
    "right_ring1",
    "right_ring2",
    "right_ring3",
    "right_thumb1",
    "right_thumb2",
    "right_thumb3",
];

/// Parent of each SMPL-X joint; `usize::MAX` for the root.
pub const SMPLX_PARENTS: [usize; 55] = [
    usize::MAX,
    0,
    0,
    0,
    1,
    2,
    3,
    4,
    5,
    6,
    7,
    8,
    9,
    9,
    9,
    12,
    13,
    14,
    16,
    17,
    18,
    19,
    15,
    15,
    15,
    20,
    25,
    26,
    20,
    28,
    29,
    20,
    31,
    32,
    20,
    34,
    35,
    20,
    37,
    38,
    21,
    40,
    41,
    21,
    43,
    44,
    21,
    46,
    47,
    21,
    49,
    50,
    21,
    52,
    53,
];

/// Index of a joint by its SMPL-X name.
pub fn smplx_joint(name: &str) -> Option<usize> {
    SMPLX_JOINTS.iter().position(|&n| n == name)
}

/// One pose: a rotation per joint relative to its parent, and where the root is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Axis-angle per joint [rad], shape [joint_count]; the first is the root's in the world.
    pub rotations: Vec<Vec3>,
    /// Translation added after posing [m]; the root rotates about the pelvis.
    pub translation: Vec3,
}

impl Pose {
    /// The T-pose at the origin.
    pub fn rest(joint_count: usize) -> Self {
        Self { rotations: vec![Vec3::zeros(); joint_count], translation: Vec3::zeros() }
    }
    /// Shortest-arc interpolation of every joint, linear interpolation of the translation; `t` in [0, 1].
    pub fn interpolate(&self, other: &Pose, t: f64) -> Pose {
        let rotations = self
            .rotations
            .iter()
            .zip(&other.rotations)
            .map(|(a, b)| {
                let a = UnitQuaternion::from_scaled_axis(*a);
                let b = UnitQuaternion::from_scaled_axis(*b);
                // Opposite rotations have no shortest arc: stay at the nearer end.
                a.try_slerp(&b, t, 1e-12).unwrap_or(if t < 0.5 { a } else { b }).scaled_axis()
            })
            .collect();
        Pose { rotations, translation: self.translation.lerp(&other.translation, t) }
    }
    /// Turns the whole body about the world's origin (for z-up files: -90° about x).
    ///
    /// The translation of this format is the offset of a body whose root turns about the pelvis, so a turned world also
    /// needs the pelvis's rest position, as `pelvis` [m].
    pub fn rotate_world(&mut self, rotation: &Rotation3<f64>, pelvis: &Vec3) {
        if let Some(root) = self.rotations.first_mut() {
            // As quaternions: the angle of a matrix is known to 1e-8 only where it is small.
            *root = (UnitQuaternion::from_rotation_matrix(rotation) * UnitQuaternion::from_scaled_axis(*root))
                .scaled_axis();
        }
        self.translation = rotation * (pelvis + self.translation) - pelvis;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parents_come_before_children() {
        for (joint, &parent) in SMPLX_PARENTS.iter().enumerate().skip(1) {
            assert!(parent < joint);
        }
        assert_eq!(smplx_joint("left_wrist"), Some(20));
        assert_eq!(SMPLX_PARENTS[smplx_joint("right_thumb1").unwrap()], 21);
    }

    #[test]
    fn interpolation_takes_the_short_way_and_meets_its_ends() {
        let mut a = Pose::rest(1);
        let mut b = Pose::rest(1);
        a.rotations[0] = Vec3::new(0.0, 3.0, 0.0);
        b.rotations[0] = Vec3::new(0.0, -3.0, 0.0);
        let middle = a.interpolate(&b, 0.5).rotations[0];
        assert!((middle.norm() - std::f64::consts::PI).abs() < 1e-9);
        assert!((a.interpolate(&b, 0.0).rotations[0] - a.rotations[0]).norm() < 1e-12);
        // The same rotation by two vectors, whose quaternions are opposite: nothing moves in between.
        a.rotations[0] = Vec3::new(1.0, 0.0, 0.0);
        b.rotations[0] = Vec3::new(1.0 - std::f64::consts::TAU, 0.0, 0.0);
        for t in [0.0, 0.3, 0.5, 1.0] {
            assert!((a.interpolate(&b, t).rotations[0] - a.rotations[0]).norm() < 1e-12, "{t}");
        }
        // Half a turn apart has no shorter way: any of the two, at the steady pace.
        b.rotations[0] = Vec3::new(1.0 + std::f64::consts::PI, 0.0, 0.0);
        let turn = |p: &Pose| UnitQuaternion::from_scaled_axis(p.rotations[0]);
        for t in [0.25, 0.5] {
            let angle = turn(&a).angle_to(&turn(&a.interpolate(&b, t)));
            assert!((angle - t * std::f64::consts::PI).abs() < 1e-9, "{t}: {angle}");
        }
    }
}
