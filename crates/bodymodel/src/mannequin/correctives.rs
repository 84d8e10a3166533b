//! Pose correctives of the mannequin: what linear blending takes from a bent or twisted limb is given back.
//!
//! A vertex of which the share w follows a joint that turns by R about it, at r from the joint, goes to (1 - w) r + w R r
//! by linear blending and to R^w r by spherical blending, which keeps its distance from the joint. Across the axis the
//! blend scales r by |1 - w + w e^{iθ}|; to second order in θ the vertex is missing w (1 - w)(1 - cos θ) r. With a the
//! axis, (1 - cos θ)(I - a aᵀ) r = -½ ((R - I) + (R - I)ᵀ) r whatever the axis is: linear in R - I, as the layout asks.
//! At w = ½ the exact factor is (1 / cos(θ/2) - 1) r; [`AT_A_RIGHT_ANGLE`] makes the two agree at 90°.

use caphy_core::Vec3;
use caphy_core::body::BlendWeights;
use caphy_core::pose::{SMPLX_JOINTS, SMPLX_PARENTS};
use rayon::prelude::*;

/// 4 (√2 - 1).
const AT_A_RIGHT_ANGLE: f64 = 4.0 * (std::f64::consts::SQRT_2 - 1.0);

/// Share of the missing part that is given back. With 1 the outside of a bend keeps its distance from the joint; what
/// the inside loses or gains by folding differs from limb to limb, and these shares leave the volume of the body after a
/// turn by 90° within 3 % of what bends (`tests/all/mannequin.rs`).
fn share(joint: &str) -> f64 {
    match joint.trim_start_matches("left_").trim_start_matches("right_") {
        "elbow" => 1.35,
        "wrist" => 0.85,
        "knee" | "ankle" => 0.70,
        "shoulder" => 0.65,
        "hip" => 0.45,
        "neck" | "head" => 0.50,
        _ => 0.0,
    }
}

/// Pose directions [m], shape [vertex_count][xyz][9 · (joint_count - 1)], flat; `joints` are those of the template [m].
pub(super) fn directions(vertices: &[Vec3], weights: &BlendWeights, joints: &[Vec3]) -> Vec<f32> {
    let count = SMPLX_JOINTS.len();
    let shares: Vec<f64> = SMPLX_JOINTS.iter().map(|j| share(j) * AT_A_RIGHT_ANGLE).collect();
    let width = 9 * (count - 1);
    let mut out = vec![0f32; 3 * width * vertices.len()];
    out.par_chunks_mut(3 * width).enumerate().for_each(|(v, rows)| {
        // What follows a joint is what its children follow, too; parents come first.
        let mut follows = vec![0.0; count];
        for (j, w) in weights.row(v) {
            follows[j] = w;
        }
        for j in (1..count).rev() {
            follows[SMPLX_PARENTS[j]] += follows[j];
        }
        for j in (1..count).filter(|&j| shares[j] > 0.0) {
            let missing = shares[j] * follows[j] * (1.0 - follows[j]);
            if missing < 1e-3 {
                continue;
            }
            let r = (vertices[v] - joints[j]) * missing;
            for a in 0..3 {
                for b in 0..3 {
                    let column = a * width + 9 * (j - 1);
                    rows[column + 3 * a + b] -= (0.5 * r[b]) as f32;
                    rows[column + 3 * b + a] -= (0.5 * r[b]) as f32;
                }
            }
        }
    });
    out
}
