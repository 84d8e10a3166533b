//! What is known of a pose before any scan: how far joints turn, and which way knees and elbows bend.

use caphy_core::Vec3;
use caphy_core::body::BodyDescription;

/// When a joint starts to move in the coarse-to-fine schedule.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Group {
    /// The root: from the first iteration.
    Root,
    /// Limbs, spine, collars, neck: once the root stands.
    Limb,
    /// Wrists, ankles, head, toes, and joints of unknown name: last.
    End,
    /// Jaw, eyes and fingers: scans of clothed people do not resolve them, they stay at the start pose.
    Held,
}

/// Prior of one joint: independent normal distributions of its axis-angle components about zero (the T-pose).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct JointPrior {
    pub(super) group: Group,
    /// Standard deviation per component [rad].
    pub(super) sd: Vec3,
    /// A component that only bends one way: its axis and the allowed sign.
    pub(super) hinge: Option<(usize, f64)>,
}

/// Standard deviation of a hinge that bends the wrong way [rad]: 3°, what a hyperextended knee or elbow does.
pub(super) const HINGE_SD: f64 = 0.05;

/// Priors by joint name (SMPL-X names; axes of the T-pose: x to the body's left, y up, z forward). A name that is not
/// known gets 0.5 rad about every axis.
pub(super) fn joint_priors(body: &BodyDescription) -> Vec<JointPrior> {
    body.joints
        .iter()
        .map(|joint| {
            if joint.parent.is_none() {
                return JointPrior { group: Group::Root, sd: Vec3::repeat(10.0), hinge: None };
            }
            let (side, part) = match joint.name.split_once('_') {
                Some(("left", part)) => (1.0, part),
                Some(("right", part)) => (-1.0, part),
                _ => (0.0, joint.name.as_str()),
            };
            let (group, sd, hinge) = match part {
                "hip" => (Group::Limb, [1.0, 0.4, 0.6], None),
                // Shin backwards only; a knee hardly twists or bends sideways.
                "knee" => (Group::Limb, [1.2, 0.15, 0.1], Some((0, 1.0))),
                // A sleeve does not show twist (about x): hands decide it, through shoulder, elbow and wrist
                // together, against tight priors; loose ones let the armpit's skinning artefacts twist an arm by 60°.
                "shoulder" => (Group::Limb, [0.3, 1.0, 1.2], None),
                // Forearm forwards only.
                "elbow" => (Group::Limb, [0.25, 1.2, 0.15], Some((1, -side))),
                // A stiffer one keeps shoulders where they are while arms move: shoulders then come out too narrow, and arms too long.
                "collar" => (Group::Limb, [0.1, 0.2, 0.4], None),
                "spine1" | "spine2" | "spine3" => (Group::Limb, [0.25, 0.15, 0.15], None),
                "neck" => (Group::Limb, [0.25, 0.25, 0.2], None),
                "head" => (Group::End, [0.3, 0.3, 0.2], None),
                "wrist" => (Group::End, [0.3, 0.3, 0.4], None),
                "ankle" => (Group::End, [0.4, 0.25, 0.25], None),
                "foot" => (Group::End, [0.15, 0.05, 0.05], None),
                "jaw" | "eye_smplhf" => (Group::Held, [0.1; 3], None),
                finger if is_finger(finger) => (Group::Held, [0.1; 3], None),
                _ => (Group::End, [0.5; 3], None),
            };
            JointPrior { group, sd: Vec3::from(sd), hinge }
        })
        .collect()
}

fn is_finger(part: &str) -> bool {
    ["index", "middle", "pinky", "ring", "thumb"].iter().any(|f| part.starts_with(f))
}

#[cfg(test)]
mod tests {
    use super::*;
    use caphy_core::body::{BlendWeights, Joint};
    use caphy_core::pose::{SMPLX_JOINTS, SMPLX_PARENTS};

    #[test]
    fn names_decide_groups_and_the_two_sides_mirror() {
        let joints = SMPLX_JOINTS
            .iter()
            .zip(SMPLX_PARENTS)
            .map(|(&name, p)| Joint { name: name.into(), parent: (p != usize::MAX).then_some(p) })
            .chain([Joint { name: "tail".into(), parent: Some(0) }])
            .collect();
        let body = BodyDescription {
            name: "x".into(),
            joints,
            faces: vec![],
            vertex_count: 0,
            shape_count: 0,
            expression_count: 0,
            weights: BlendWeights::default(),
        };
        let priors = joint_priors(&body);
        let of = |name| priors[body.joint(name).unwrap()];
        assert_eq!(of("pelvis").group, Group::Root);
        assert_eq!(of("left_elbow").hinge, Some((1, -1.0)));
        assert_eq!(of("right_elbow").hinge, Some((1, 1.0)));
        assert_eq!(of("left_knee"), of("right_knee"));
        assert_eq!((of("jaw").group, of("left_ring2").group), (Group::Held, Group::Held));
        assert_eq!((of("tail").group, of("tail").sd), (Group::End, Vec3::repeat(0.5)));
    }
}
