//! The standard pose: upright, limbs straight, arms between level and halfway down.

use caphy_core::Vec3;
use caphy_core::body::Joint;
use caphy_core::pose::Pose;

/// How far arms are lowered in an A-pose [rad]; all between this and a T-pose is standard.
const LOWERED: f64 = 1.0;

/// How far a pose is from the standard pose [rad]: the root's tilt and heading do not count.
pub(super) fn distance_to_standard(pose: &Pose, joints: &[Joint]) -> f64 {
    let mut square = 0.0;
    // Collar and shoulder turn the arm together.
    let mut arms = [Vec3::zeros(); 2];
    for (rotation, joint) in pose.rotations.iter().zip(joints).skip(1) {
        let side = usize::from(joint.name.starts_with("right"));
        if ["shoulder", "collar"].iter().any(|part| joint.name.contains(part)) {
            arms[side] += rotation;
        } else {
            square += rotation.norm_squared();
        }
    }
    for (arm, down) in arms.into_iter().zip([-1.0, 1.0]) {
        let lowered = (down * arm.z).clamp(0.0, LOWERED);
        square += (arm - Vec3::new(0.0, 0.0, down * lowered)).norm_squared();
    }
    square.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use caphy_bodymodel::BodyMannequin;
    use caphy_core::body::BodyModel;

    #[test]
    fn lowered_arms_are_standard_raised_or_stretched_ones_are_not() {
        let body = BodyMannequin { resolution: 0.03 }.generate().unwrap();
        let joints = &body.describe().joints;
        let of = |turned: &[(&str, Vec3)]| {
            let mut pose = Pose::rest(joints.len());
            for (name, rotation) in turned {
                pose.rotations[joints.iter().position(|j| j.name == *name).unwrap()] = *rotation;
            }
            distance_to_standard(&pose, joints)
        };
        let arms = |z: f64| of(&[("left_shoulder", Vec3::z() * z), ("right_shoulder", -Vec3::z() * z)]);
        assert_eq!(arms(0.0), 0.0);
        assert_eq!(arms(-0.9), 0.0);
        assert!((arms(-1.3) - 0.3 * 2f64.sqrt()).abs() < 1e-12);
        assert!((arms(0.9) - 0.9 * 2f64.sqrt()).abs() < 1e-12);
        // A collar that lowers the arm makes up for a shoulder that raises it.
        assert!(of(&[("left_collar", Vec3::z() * 0.2), ("left_shoulder", Vec3::z() * -0.2)]) < 1e-12);
        assert!((of(&[("left_shoulder", Vec3::new(0.0, -1.2, -0.2))]) - 1.2).abs() < 1e-12);
        assert!((of(&[("left_knee", Vec3::x() * 0.4), ("pelvis", Vec3::y())]) - 0.4).abs() < 1e-12);
    }
}
