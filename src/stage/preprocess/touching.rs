//! Arms that touch the rest of the body: a scanner joins what touches, and nothing is seen in between.

use caphy_core::Result;
use caphy_core::body::{BodyDescription, BodyModel, BodyParameters};
use caphy_core::query::NearestSurface;

/// Skin of a fitted body this near to other skin counts as touching [m]: two layers of thick cloth, and the fit's error.
const NEAR: f64 = 0.02;
/// Share of a forearm's vertices, hand included, from which on it is worth a note.
const SHARE: f64 = 0.05;

/// Says which forearms lie against something other than their own upper arm; `None` where none does, and for bodies without elbows.
///
/// # Errors
/// Those of [`BodyModel::forward`].
pub(super) fn note(body: &dyn BodyModel, posed: &BodyParameters) -> Result<Option<String>> {
    let vertices = body.forward(posed)?.vertices;
    let mut found = Vec::new();
    for side in ["left", "right"] {
        let Some(arm) = Arm::new(body.describe(), side) else { continue };
        let others = NearestSurface::new(&vertices, &arm.others)?;
        let near = |v: &&usize| others.nearest_within(&vertices[**v], NEAR * NEAR).is_some();
        let share = arm.forearm.iter().filter(near).count() as f64 / arm.forearm.len().max(1) as f64;
        if share >= SHARE {
            found.push(format!("{side} {:.0} %", 100.0 * share));
        }
    }
    Ok((!found.is_empty()).then(|| {
        format!(
            "has forearms that touch the body ({} of their vertices): labels and cloth are less sure there, and where cloth lies \
             between they are joined; scan arms apart from the body where you can",
            found.join(", ")
        )
    }))
}

/// One arm of a body.
struct Arm {
    /// Vertices from the elbow on.
    forearm: Vec<usize>,
    /// Triangles of everything but this arm and its shoulder.
    others: Vec<[u32; 3]>,
}

impl Arm {
    fn new(body: &BodyDescription, side: &str) -> Option<Self> {
        let elbow = body.joint(&format!("{side}_elbow"))?;
        // The upper arm, and the shoulder where there is one.
        let upper = body.joints[elbow].parent?;
        let shoulder = body.joints[upper].parent.filter(|&j| body.joints[j].name.starts_with(side));
        let below = |joint: usize| {
            let mut at = Some(joint);
            while let Some(j) = at.filter(|&j| j != elbow) {
                at = body.joints[j].parent;
            }
            at.is_some()
        };
        let of_forearm: Vec<bool> = (0..body.joints.len()).map(below).collect();
        let of_arm = |j: usize| of_forearm[j] || j == upper || Some(j) == shoulder;
        // The joint that moves a vertex most; the first of equals.
        let mover =
            |v: usize| body.weights.row(v).fold((0, 0.0), |best, (j, w)| if w > best.1 { (j, w) } else { best }).0;
        let movers: Vec<usize> = (0..body.vertex_count).map(mover).collect();
        Some(Self {
            forearm: (0..body.vertex_count).filter(|&v| of_forearm[movers[v]]).collect(),
            others: body.faces.iter().filter(|f| f.iter().all(|&v| !of_arm(movers[v as usize]))).copied().collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use caphy_bodymodel::BodyMannequin;
    use caphy_core::Vec3;

    #[test]
    fn arms_on_the_body_are_noted_and_others_are_not() {
        let body = BodyMannequin { resolution: 0.03 }.generate().unwrap();
        let joints = body.describe().joints.len();
        let turned = |turns: &[(&str, Vec3)]| {
            let mut pose = BodyParameters::rest(joints, &[]);
            for (name, turn) in turns {
                pose.rotations[body.describe().joint(name).unwrap()] = *turn;
            }
            note(&body, &pose).unwrap()
        };
        // T-pose; A-pose, with the left arm turned down about z; a bent elbow, whose forearm lies on its own upper arm only.
        assert_eq!(turned(&[]), None);
        let a_pose = [("left_shoulder", Vec3::new(0.0, 0.0, -0.9)), ("right_shoulder", Vec3::new(0.0, 0.0, 0.9))];
        assert_eq!(turned(&a_pose), None);
        assert_eq!(turned(&[("left_elbow", Vec3::new(0.0, -2.3, 0.0))]), None);
        // Down to the thigh.
        let left = turned(&[("left_shoulder", Vec3::new(0.0, 0.0, -1.65))]).unwrap();
        assert!(left.contains("left ") && !left.contains("right "), "{left}");
        // Hands together in front.
        let front = [("left_shoulder", Vec3::new(0.0, -1.6, 0.0)), ("right_shoulder", Vec3::new(0.0, 1.6, 0.0))];
        let elbows = [("left_elbow", Vec3::new(0.0, -0.5, 0.0)), ("right_elbow", Vec3::new(0.0, 0.5, 0.0))];
        let both = turned(&[front, elbows].concat()).unwrap();
        assert!(both.contains("left ") && both.contains("right "), "{both}");
    }
}
