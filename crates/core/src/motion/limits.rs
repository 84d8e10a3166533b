//! How far joints of people turn and how fast, for telling damaged motion from lively motion.

use crate::pose::{SMPLX_JOINTS, smplx_joint};
use crate::{Error, Result, Vec3};
use nalgebra::{Quaternion, UnitQuaternion};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Limits of a motion, the `[motion.limits]` of a configuration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MotionLimits {
    /// How far past the ranges of [`joint_range`] and `ranges` a joint may turn [degrees]. Default 30: athletes and children
    /// pass the clinical norms by 10 to 15, and where capture puts a joint differs from person to person by as much again.
    pub margin_degrees: f64,
    /// Ranges of your own by SMPL-X joint, `[[x from, to], [y from, to], [z from, to]]` of [`joint_angles`] [degrees].
    /// Default: none.
    pub ranges: BTreeMap<String, [[f64; 2]; 3]>,
    /// Fastest turn of a joint against its parent [degrees/s]. Default 2500: kicks reach 1700 at the knee, throws 2300 at
    /// the elbow for some hundredths of a second (a pitcher's shoulder passes it).
    pub joint_speed_degrees_per_s: f64,
    /// Fastest way of the pelvis [m/s]. Default 12.5, the fastest sprint on record.
    pub root_speed_m_per_s: f64,
}

impl Default for MotionLimits {
    fn default() -> Self {
        Self {
            margin_degrees: 30.0,
            ranges: BTreeMap::new(),
            joint_speed_degrees_per_s: 2500.0,
            root_speed_m_per_s: 12.5,
        }
    }
}

impl MotionLimits {
    /// Checks the numbers and the names.
    ///
    /// # Errors
    /// [`Error::Config`] naming the key, the value and what is allowed.
    pub fn check(&self) -> Result<()> {
        let positive = [
            ("joint_speed_degrees_per_s", self.joint_speed_degrees_per_s),
            ("root_speed_m_per_s", self.root_speed_m_per_s),
        ];
        for (key, value) in positive {
            if value.is_nan() || value <= 0.0 {
                return Err(Error::config(
                    key,
                    format!("{value}"),
                    "give a positive speed; inf switches the check off",
                ));
            }
        }
        if self.margin_degrees.is_nan() || self.margin_degrees < 0.0 {
            let remedy = "give degrees from 0; inf switches the check of joint angles off";
            return Err(Error::config("margin_degrees", format!("{}", self.margin_degrees), remedy));
        }
        for (name, range) in &self.ranges {
            let key = format!("ranges.{name}");
            if smplx_joint(name).is_none_or(|j| j == 0) {
                let joints = SMPLX_JOINTS[1..].join(", ");
                return Err(Error::config(key, "no such joint has a range", format!("joints: {joints}")));
            }
            if let Some([from, to]) =
                range.iter().find(|[from, to]| !(from <= to && from.is_finite() && to.is_finite()))
            {
                return Err(Error::config(key, format!("[{from}, {to}]"), "give [from, to] in degrees, from <= to"));
            }
        }
        Ok(())
    }
    /// Allowed [`joint_angles`] of a joint, margin included [degrees]; `None` for the root, which may turn anyhow.
    pub fn allowed(&self, joint: usize) -> Option<[[f64; 2]; 3]> {
        let name = SMPLX_JOINTS.get(joint)?;
        let range = self.ranges.get(*name).copied().or_else(|| joint_range(joint))?;
        Some(range.map(|[from, to]| [from - self.margin_degrees, to + self.margin_degrees]))
    }
}

/// The axis about which a limb turns in itself: 0, 1, 2 for x, y, z. In the T-pose arms lie along x, trunk and legs along
/// y, feet and lines of sight along z.
fn twist_axis(joint: usize) -> usize {
    match joint {
        7 | 8 | 10 | 11 | 23 | 24 => 2,
        13 | 14 | 16..=21 | 25..=54 => 0,
        _ => 1,
    }
}

/// A joint's rotation as angles about x, y and z [degrees]: the rotation is split into a turn of the limb in itself,
/// which is the angle about the limb's own axis, followed by the shortest swing of the limb, whose rotation vector gives the
/// other two. Unlike Euler angles they have no pole short of a limb that points backwards.
pub fn joint_angles(joint: usize, rotation: &Vec3) -> [f64; 3] {
    let axis = twist_axis(joint);
    let q = UnitQuaternion::from_scaled_axis(*rotation);
    let mut part = Quaternion::new(q.w, 0.0, 0.0, 0.0);
    part.coords[axis] = q.coords[axis];
    let twist = UnitQuaternion::try_new(part, 1e-12).unwrap_or_else(UnitQuaternion::identity);
    let mut angles = (q * twist.inverse()).scaled_axis();
    angles[axis] = twist.scaled_axis()[axis];
    [angles.x, angles.y, angles.z].map(f64::to_degrees)
}

/// Range of motion of a joint in [`joint_angles`] [degrees]; `None` for the root and unknown joints.
///
/// Clinical norms (American Academy of Orthopaedic Surgeons 1965; Norkin and White, *Measurement of Joint Motion*), told in
/// the signs of this body: hip flexion 120, extension 30, abduction 45, adduction 30, rotation 45; knee 150; ankle 20 up (40
/// under load), 50 down; shoulder 180 of elevation, shared with the collar, 60 back, 90 of rotation; elbow 150, forearm 80 to 90 each way; wrist 80 and 70,
/// 20 and 30; trunk 80 forward, 25 back, 35 aside, 45 of rotation; neck 45 each way, 60 of rotation; fingers 90, 100, 90.
/// Three joints share the trunk and two the neck: each may take two thirds of the whole, since skeletons differ in that. Which of
/// shoulder, elbow and wrist holds an arm's turn about itself differs, too: each may hold 90, and the axis of the elbow's hinge
/// may lie aslant. A turn about itself counts from the T-pose along the shortest swing: an arm that is lifted forward over the
/// head holds 130 by that count.
pub fn joint_range(joint: usize) -> Option<[[f64; 2]; 3]> {
    let name = SMPLX_JOINTS.get(joint)?;
    let (side, part) = match name.split_once('_') {
        Some((side @ ("left" | "right"), part)) => (side, part),
        _ => ("", *name),
    };
    // As of the left side: the mirror image changes the signs of y and z.
    let left: [[f64; 2]; 3] = match part {
        "hip" => [[-120.0, 30.0], [-45.0, 45.0], [-30.0, 45.0]],
        "knee" => [[0.0, 150.0], [-30.0, 30.0], [-10.0, 10.0]],
        "ankle" => [[-40.0, 50.0], [-30.0, 30.0], [-35.0, 20.0]],
        "foot" => [[-70.0, 45.0], [-15.0, 15.0], [-15.0, 15.0]],
        "spine1" | "spine2" | "spine3" => [[-20.0, 55.0], [-30.0, 30.0], [-25.0, 25.0]],
        "neck" | "head" => [[-35.0, 35.0], [-45.0, 45.0], [-30.0, 30.0]],
        "collar" => [[-30.0, 30.0], [-30.0, 25.0], [-10.0, 45.0]],
        "shoulder" => [[-130.0, 100.0], [-135.0, 80.0], [-100.0, 95.0]],
        "elbow" => [[-90.0, 90.0], [-150.0, 0.0], [-50.0, 50.0]],
        "wrist" => [[-90.0, 90.0], [-30.0, 40.0], [-80.0, 70.0]],
        "jaw" => [[0.0, 35.0], [-15.0, 15.0], [-10.0, 10.0]],
        "eye_smplhf" => [[-40.0, 40.0], [-45.0, 45.0], [-10.0, 10.0]],
        // The thumb lies across the other axes; its joints together turn about 70 each way.
        "thumb1" | "thumb2" | "thumb3" => [[-70.0, 70.0], [-70.0, 70.0], [-70.0, 70.0]],
        finger if finger.ends_with('1') => [[-20.0, 20.0], [-25.0, 25.0], [-90.0, 45.0]],
        finger if finger.ends_with('2') => [[-10.0, 10.0], [-10.0, 10.0], [-100.0, 10.0]],
        finger if finger.ends_with('3') => [[-10.0, 10.0], [-10.0, 10.0], [-90.0, 20.0]],
        _ => return None,
    };
    let [x, y, z] = left;
    let mirrored = |[from, to]: [f64; 2]| [-to, -from];
    Some(if side == "right" { [x, mirrored(y), mirrored(z)] } else { left })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    #[test]
    fn angles_are_swing_and_twist() {
        let [x, y, z] = [Vec3::x_axis(), Vec3::y_axis(), Vec3::z_axis()];
        let joint = |name| smplx_joint(name).unwrap();
        let about = |axis, degrees: f64| Rotation3::from_axis_angle(&axis, degrees.to_radians());
        // An arm that turns 40 about itself, then swings 50 forward.
        let arm = about(y, -50.0) * about(x, 40.0);
        let angles = joint_angles(joint("left_shoulder"), &arm.scaled_axis());
        assert!(
            (angles[0] - 40.0).abs() < 1e-9 && (angles[1] + 50.0).abs() < 1e-9 && angles[2].abs() < 1e-9,
            "{angles:?}"
        );
        let leg = about(x, -90.0) * about(y, 30.0);
        let angles = joint_angles(joint("right_hip"), &leg.scaled_axis());
        assert!(
            (angles[0] + 90.0).abs() < 1e-9 && (angles[1] - 30.0).abs() < 1e-9 && angles[2].abs() < 1e-9,
            "{angles:?}"
        );
        assert!(joint_angles(joint("left_ankle"), &about(z, 20.0).scaled_axis())[2] > 19.9);
        // A limb that points backwards, and every joint at pi: finite.
        for j in 0..55 {
            for v in [Vec3::x(), Vec3::y(), Vec3::z(), Vec3::new(0.6, 0.0, 0.8), Vec3::zeros()] {
                assert!(joint_angles(j, &(v * std::f64::consts::PI)).iter().all(|a| a.abs() < 180.0 + 1e-9));
            }
        }
    }

    #[test]
    fn ranges_are_mirrored_and_hold_the_t_pose() {
        assert_eq!(joint_range(0), None);
        for (j, name) in SMPLX_JOINTS.iter().enumerate().skip(1) {
            let range = joint_range(j).unwrap_or_else(|| panic!("{name}"));
            assert!(range.iter().all(|[from, to]| *from <= 0.0 && *to >= 0.0), "{name}");
            if let Some(other) = name.strip_prefix("left_") {
                let [x, y, z] = joint_range(smplx_joint(&format!("right_{other}")).unwrap()).unwrap();
                assert_eq!([x, [-y[1], -y[0]], [-z[1], -z[0]]], range, "{name}");
            }
        }
    }

    #[test]
    fn bad_limits_are_refused() {
        let with =
            |name: &str, range| MotionLimits { ranges: [(name.to_string(), range)].into(), ..Default::default() };
        let fine = [[0.0, 1.0]; 3];
        assert!(MotionLimits::default().check().is_ok() && with("left_knee", fine).check().is_ok());
        for (limits, word) in [
            (MotionLimits { margin_degrees: -1.0, ..Default::default() }, "margin_degrees"),
            (MotionLimits { joint_speed_degrees_per_s: f64::NAN, ..Default::default() }, "joint_speed"),
            (MotionLimits { root_speed_m_per_s: 0.0, ..Default::default() }, "root_speed"),
            (with("kneecap", fine), "kneecap"),
            (with("pelvis", fine), "pelvis"),
            (with("left_knee", [[1.0, 0.0]; 3]), "left_knee"),
        ] {
            assert!(limits.check().unwrap_err().to_string().contains(word), "{word}");
        }
    }
}
