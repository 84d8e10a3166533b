//! Yarn axes of a template: which way the fabric was laid when the pieces were cut.

use super::rest::{BodyRest, Limb, limb_of};
use caphy_core::{TriMesh, Vec3};

/// What [`material_uv`] assumed, in words for artifacts and reports.
pub(crate) const GRAIN_NOTE: &str = "u (grain) along the dominant bone: spine on the trunk (carried over the shoulders from front \
to back), upper arm and forearm on sleeves, thigh and shin on legs; v across, on the surface; metres, isometric per rest triangle; \
which of u and v is the warp is not known";

/// Per face the corner coordinates (u, v) [m] in the triangle's own plane, shape [face_count, 3, 2]: u along the grain, v
/// across, (u, v, outward normal) right-handed. Isometric: side lengths equal those of the rest triangle. The origin is
/// the first corner: coordinates of different faces do not join into a layout.
pub(crate) fn material_uv(mesh: &TriMesh, body: &BodyRest, nearest: &[u32]) -> Vec<[[f64; 2]; 3]> {
    let fallback = |grain: &Vec3, normal: &Vec3, side: &Vec3| {
        let flat = |d: &Vec3| d - normal * d.dot(normal);
        let u = flat(grain);
        // Where the bone stands on the surface, the next best direction.
        if u.norm() > 0.2 { u } else { flat(side) }
    };
    mesh.faces
        .iter()
        .enumerate()
        .map(|(f, face)| {
            let p = mesh.corners(f);
            let (side_a, side_b) = (p[1] - p[0], p[2] - p[0]);
            let normal = side_a.cross(&side_b).try_normalize(0.0).unwrap_or_else(Vec3::z);
            let joint = dominant_joint(body, face.map(|v| nearest[v as usize]));
            let grain = match limb_of(joint) {
                Limb::Trunk | Limb::Head => trunk_grain(&normal),
                _ => fallback(&bone_direction(body, joint), &normal, &Vec3::y()),
            };
            let u = grain.try_normalize(1e-9).or_else(|| side_a.try_normalize(0.0)).unwrap_or_else(Vec3::x);
            let v = normal.cross(&u);
            [[0.0, 0.0], [side_a.dot(&u), side_a.dot(&v)], [side_b.dot(&u), side_b.dot(&v)]]
        })
        .collect()
}

/// Up along the spine on front, back and sides; over the shoulders from front to back, as a panel is laid.
fn trunk_grain(normal: &Vec3) -> Vec3 {
    let up = Vec3::y() - normal * normal.y;
    let over = normal.cross(&Vec3::x());
    let over = if over.y < 0.0 { -over } else { over };
    // On the sides (normal ∥ x) `over` vanishes, on the shoulders `up` leans to the neck.
    let weight = 1.0 - super::shape::smooth_step(0.6, 0.95, normal.x.abs());
    up * (1.0 - weight) + over * weight
}

/// The joint with most weight over the faces' nearest body vertices; the smallest index of equals.
fn dominant_joint(body: &BodyRest, vertices: [u32; 3]) -> usize {
    let mut sums: Vec<(usize, f64)> = Vec::with_capacity(8);
    for v in vertices {
        for (joint, w) in body.weights.row(v as usize) {
            match sums.iter_mut().find(|(j, _)| *j == joint) {
                Some((_, sum)) => *sum += w,
                None => sums.push((joint, w)),
            }
        }
    }
    sums.iter()
        .fold((usize::MAX, 0.0), |best, &(j, w)| if w > best.1 || (w == best.1 && j < best.0) { (j, w) } else { best })
        .0
}

/// From a limb's joint to the next one down the limb.
fn bone_direction(body: &BodyRest, joint: usize) -> Vec3 {
    let (from, to) = match joint {
        1 | 2 | 4 | 5 => (joint, joint + 3),
        7 | 10 => (4, 7),
        8 | 11 => (5, 8),
        16..=19 => (joint, joint + 2),
        20 | 25..=39 => (18, 20),
        21 | 40..=54 => (19, 21),
        _ => return Vec3::y(),
    };
    (body.joints[to] - body.joints[from]).try_normalize(0.0).unwrap_or_else(Vec3::y)
}
