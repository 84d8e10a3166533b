//! Names of joints of a tree that comes without names.

use caphy_core::pose::{SMPLX_JOINTS, SMPLX_PARENTS};

/// Body joints that SMPL, SMPL-H and SMPL-X share, in the same order.
const SHARED: usize = 22;
/// First finger of SMPL-X, and the number of finger joints of both hands.
const FINGERS: (usize, usize) = (25, 30);

/// Whether the trees of two layouts agree where joint `ours(i)` is SMPL-X joint `theirs(i)`.
fn agrees(parent: Option<usize>, smplx: usize, to_ours: impl Fn(usize) -> usize) -> bool {
    match (parent, SMPLX_PARENTS[smplx]) {
        (None, usize::MAX) => true,
        (Some(ours), theirs) => theirs != usize::MAX && ours == to_ours(theirs),
        _ => false,
    }
}

/// SMPL-X names where the tree is that of SMPL-X (55 joints) or SMPL-H (52: no jaw and eyes), and for as many body joints as
/// agree with them otherwise; `joint<i>` for the rest.
pub(super) fn of_tree(parents: &[Option<usize>]) -> Vec<String> {
    let count = parents.len();
    let shared = (0..count.min(SHARED)).take_while(|&j| agrees(parents[j], j, |p| p)).count();
    let smplx = count == SMPLX_JOINTS.len() && (0..count).all(|j| agrees(parents[j], j, |p| p));
    let skipped = FINGERS.0 - SHARED;
    let smplh = count == SHARED + FINGERS.1
        && shared == SHARED
        && (SHARED..count).all(|j| agrees(parents[j], j + skipped, |p| if p >= FINGERS.0 { p - skipped } else { p }));
    let name = |j: usize| match j {
        _ if smplx || j < shared => SMPLX_JOINTS[j].to_string(),
        _ if smplh => SMPLX_JOINTS[j + skipped].to_string(),
        _ => format!("joint{j}"),
    };
    (0..count).map(name).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trees_of_the_family_are_recognised() {
        let smplx: Vec<Option<usize>> = SMPLX_PARENTS.iter().map(|p| (*p != usize::MAX).then_some(*p)).collect();
        assert_eq!(of_tree(&smplx), SMPLX_JOINTS);
        // SMPL-H: the same without joints 22 to 24.
        let smplh: Vec<Option<usize>> = (0..55)
            .filter(|j| !(22..25).contains(j))
            .map(|j| smplx[j].map(|p| if p >= 25 { p - 3 } else { p }))
            .collect();
        let names = of_tree(&smplh);
        assert_eq!(
            (names[21].as_str(), names[22].as_str(), names[51].as_str()),
            ("right_wrist", "left_index1", "right_thumb3")
        );
        // SMPL: two hands behind the wrists.
        let smpl: Vec<Option<usize>> = smplx[..22].iter().copied().chain([Some(20), Some(21)]).collect();
        let names = of_tree(&smpl);
        assert_eq!((names[21].as_str(), names[22].as_str()), ("right_wrist", "joint22"));
        let other = of_tree(&[None, Some(0), Some(1)]);
        assert_eq!(other, ["pelvis", "left_hip", "joint2"]);
    }
}
