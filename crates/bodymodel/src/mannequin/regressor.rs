//! Joint regressor of the mannequin.

use super::skinning::{COUNT, mirror_joints};
use super::surface::Symmetric;
use caphy_core::body::BlendWeights;
use caphy_core::pose::{SMPLX_JOINTS, SMPLX_PARENTS};
use caphy_core::{Error, Result, Vec3};
use nalgebra::Matrix3;
use rayon::prelude::*;

/// Joint regressor: positive weights on the ring of skin around each joint whose mean is the joint.
///
/// Among all such weights these are the ones of largest entropy relative to a Gaussian over the ring: unique, smooth,
/// positive, and found by Newton's method in three unknowns.
pub(super) fn regressor(
    body: &Symmetric,
    weights: &BlendWeights,
    joints: &[Vec3],
    cell: f64,
) -> Result<Vec<Vec<(u32, f64)>>> {
    let mesh = &body.mesh;
    let mut carried = vec![vec![0.0; mesh.vertices.len()]; COUNT];
    for v in 0..mesh.vertices.len() {
        for (j, w) in weights.row(v) {
            carried[j][v] = w;
        }
    }
    let mirror = mirror_joints();
    let mut rows: Vec<Vec<(u32, f64)>> = (0..COUNT)
        .into_par_iter()
        .map(|j| {
            // The right side mirrors the left.
            if SMPLX_JOINTS[j].starts_with("right_") {
                return Ok(Vec::new());
            }
            let parent = SMPLX_PARENTS[j];
            let child = (0..COUNT).find(|&c| SMPLX_PARENTS[c] == j);
            let from = if parent == usize::MAX { joints[j] } else { joints[parent] };
            let to = child.map_or(joints[j], |c| joints[c]);
            // The pelvis, eyes and jaw have no limb around them: their ring lies across the spine.
            let axis = match SMPLX_JOINTS[j] {
                "pelvis" | "jaw" | "left_eye_smplhf" | "right_eye_smplhf" | "left_hip" | "right_hip" => Vec3::y(),
                _ => (to - from).normalize(),
            };
            let hand = j >= 25;
            let along = if hand { (0.4 * cell).max(0.006) } else { 1.1 * cell };
            let across = if hand { 0.03 } else { 0.12 };
            let mut ring: Vec<(u32, f64)> = (0..mesh.vertices.len())
                .filter_map(|v| {
                    let own = carried[j][v] + if parent == usize::MAX { 0.0 } else { carried[parent][v] };
                    let d = mesh.vertices[v] - joints[j];
                    let a = d.dot(&axis);
                    let b = (d - axis * a).norm();
                    let prior = own * (-0.5 * ((a / along).powi(2) + (b / across).powi(2))).exp();
                    (prior > 1e-3).then_some((v as u32, prior))
                })
                .collect();
            let solved = maximum_entropy(&mesh.vertices, &ring, &joints[j]);
            if let Some(weights) = solved {
                // Only what counts, then exact again.
                let largest = weights.iter().copied().fold(0.0, f64::max);
                let mut at = weights.iter();
                ring.retain(|_| at.next().is_some_and(|w| *w > 1e-3 * largest));
                if let Some(weights) = maximum_entropy(&mesh.vertices, &ring, &joints[j]) {
                    return Ok(ring.iter().zip(weights).map(|((v, _), w)| (*v, w)).collect());
                }
            }
            Err(Error::numerics(
                format!("mannequin with resolution {cell} m, joint `{}`", SMPLX_JOINTS[j]),
                format!("lies outside the {} vertices around it", ring.len()),
                "choose a finer resolution",
            ))
        })
        .collect::<Result<_>>()?;
    for j in (0..COUNT).filter(|&j| SMPLX_JOINTS[j].starts_with("right_")) {
        rows[j] = rows[mirror[j]].iter().map(|&(v, w)| (body.mirror[v as usize], w)).collect();
    }
    Ok(rows)
}

/// Weights w_i ∝ prior_i exp(λ·(p_i - target)) whose mean is `target`; `None` when it is not inside the points.
fn maximum_entropy(points: &[Vec3], ring: &[(u32, f64)], target: &Vec3) -> Option<Vec<f64>> {
    // Centimetres keep the exponents and the Newton matrix near 1.
    let offsets: Vec<Vec3> = ring.iter().map(|(v, _)| (points[*v as usize] - target) * 100.0).collect();
    let evaluate = |lambda: &Vec3| {
        let raw: Vec<f64> = offsets.iter().zip(ring).map(|(d, (_, prior))| prior.ln() + lambda.dot(d)).collect();
        let top = raw.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let weights: Vec<f64> = raw.iter().map(|r| (r - top).exp()).collect();
        let sum: f64 = weights.iter().sum();
        (top + sum.ln(), weights.into_iter().map(|w| w / sum).collect::<Vec<f64>>())
    };
    let mut lambda = Vec3::zeros();
    let (mut value, mut weights) = evaluate(&lambda);
    for _ in 0..100 {
        let mean: Vec3 = offsets.iter().zip(&weights).map(|(d, w)| d * *w).sum();
        // 1e-12 m.
        if mean.norm() < 1e-10 {
            return Some(weights);
        }
        let spread: Matrix3<f64> =
            offsets.iter().zip(&weights).map(|(d, w)| (d - mean) * (d - mean).transpose() * *w).sum();
        let step = (spread + Matrix3::identity() * 1e-9).cholesky()?.solve(&mean);
        let mut scale = 1.0;
        loop {
            let trial = lambda - step * scale;
            let (trial_value, trial_weights) = evaluate(&trial);
            if trial_value <= value - 1e-4 * scale * mean.dot(&step) || mean.norm() < 1e-5 {
                (lambda, value, weights) = (trial, trial_value, trial_weights);
                break;
            }
            scale *= 0.5;
            if scale < 1e-6 {
                return None;
            }
        }
    }
    None
}
