//! Skinning weights and joint regressor of the mannequin.

use super::figure::PELVIS_HEIGHT;
use super::smoothstep;
use caphy_core::body::{BlendWeights, Joint};
use caphy_core::pose::{SMPLX_JOINTS, SMPLX_PARENTS, smplx_joint};
use caphy_core::query::Adjacency;
use caphy_core::{Error, Result, TriMesh, Vec3};
use nalgebra::Matrix3;

const COUNT: usize = SMPLX_JOINTS.len();
/// Most joints that move one vertex.
const MOST_JOINTS: usize = 6;
/// Rounds of averaging with neighbours along the surface.
const SMOOTHING: usize = 4;
/// A weight below this is not worth its transform: at 20 cm it moves a vertex by less than half a millimetre.
const SMALLEST: f64 = 2e-3;

type Weights = [f64; COUNT];

/// Joints in SMPL-X order.
pub(super) fn joint_tree() -> Vec<Joint> {
    let joint = |(name, &parent): (&&str, &usize)| Joint {
        name: (*name).into(),
        parent: (parent != usize::MAX).then_some(parent),
    };
    SMPLX_JOINTS.iter().zip(&SMPLX_PARENTS).map(joint).collect()
}

/// Weights that a position takes from where it lies on the figure, before smoothing.
///
/// Each joint owns what lies beyond a plane through it, with a soft border. The planes are tilted so that they pass
/// through the armpit and the crotch: the side of the chest is not the arm's, although the arm's bone is near.
fn regions(p: &Vec3) -> Weights {
    let mut out = [0.0; COUNT];
    let left = p.x >= 0.0;
    let (x, y, z) = (p.x.abs(), p.y + PELVIS_HEIGHT, p.z);
    let mut put = |name: &str, near_side: bool, weight: f64| {
        let sided = if (left == near_side) || !name.starts_with("left_") {
            name.to_string()
        } else {
            name.replacen("left_", "right_", 1)
        };
        if let Some(j) = smplx_joint(&sided) {
            out[j] += weight;
        }
    };

    // Arm: beyond a plane from the armpit to the top of the shoulder.
    let arm = smoothstep(-0.05, 0.06, 0.78 * (x - 0.172) + 0.62 * (y - 1.400)) * smoothstep(0.09, 0.16, x);
    let elbow = smoothstep(0.400, 0.490, x);
    let wrist = smoothstep(0.660, 0.710, x);
    put("left_shoulder", true, arm * (1.0 - elbow));
    put("left_elbow", true, arm * elbow * (1.0 - wrist));
    let hand = arm * elbow * wrist;
    if hand > 0.0 {
        let thumb = smoothstep(-0.012, 0.012, z - (0.012 + 0.35 * (x - 0.70))) * smoothstep(0.69, 0.72, x);
        let second = smoothstep(0.730, 0.746, x);
        let third = smoothstep(0.756, 0.770, x);
        put("left_thumb1", true, hand * thumb * (1.0 - second));
        put("left_thumb2", true, hand * thumb * second * (1.0 - third));
        put("left_thumb3", true, hand * thumb * second * third);
        // Fingers share the hand by their distance across it.
        let across = [0.008, -0.014, -0.034, -0.052];
        let names = ["index", "middle", "ring", "pinky"];
        let knuckles = [[0.772, 0.804, 0.826], [0.776, 0.812, 0.837], [0.770, 0.802, 0.824], [0.760, 0.784, 0.800]];
        let mut palm = hand * (1.0 - thumb);
        for f in 0..4 {
            let inner = if f == 0 { 1.0 } else { ((across[f - 1] - z) / (across[f - 1] - across[f])).clamp(0.0, 1.0) };
            let outer = if f == 3 { 1.0 } else { ((z - across[f + 1]) / (across[f] - across[f + 1])).clamp(0.0, 1.0) };
            let share = hand * (1.0 - thumb) * inner.min(outer);
            let [a, b, c] = knuckles[f].map(|k| smoothstep(k - 0.014, k + 0.014, x));
            put(&format!("left_{}1", names[f]), true, share * a * (1.0 - b));
            put(&format!("left_{}2", names[f]), true, share * a * b * (1.0 - c));
            put(&format!("left_{}3", names[f]), true, share * a * b * c);
            palm -= share * a;
        }
        put("left_wrist", true, palm);
    }

    // Leg: below the line of the groin; the two legs share only the perineum.
    let leg = if y > 1.1 { 0.0 } else { smoothstep(-0.06, 0.06, 0.5 * (x - 0.085) - 0.866 * (y - 0.890)) };
    let knee = smoothstep(-0.06, 0.06, 0.480 - y);
    let ankle = smoothstep(-0.035, 0.03, (0.085 - y) + 0.5 * (z + 0.03));
    let toes = smoothstep(0.070, 0.110, z);
    let this = smoothstep(-0.02, 0.02, x);
    for (near_side, share) in [(true, this), (false, 1.0 - this)] {
        put("left_hip", near_side, leg * share * (1.0 - knee));
        put("left_knee", near_side, leg * share * knee * (1.0 - ankle));
        put("left_ankle", near_side, leg * share * knee * ankle * (1.0 - toes));
        put("left_foot", near_side, leg * share * knee * ankle * toes);
    }

    // Trunk: planes across the spine; the head's is tilted so that the chin goes with it.
    let mut trunk = (1.0 - arm - leg).max(0.0);
    let planes = [
        ("pelvis", y - 1.050, 0.090),
        ("spine1", y - 1.165, 0.085),
        ("spine2", y - 1.260, 0.080),
        ("spine3", y - 1.455 + 0.3 * (z + 0.03), 0.035),
        ("neck", y - 1.545 + 0.8 * (z + 0.01), 0.025),
    ];
    for (name, above, border) in planes {
        let rest = smoothstep(-border, border, above);
        let here = trunk * (1.0 - rest);
        if name == "spine3" {
            let collar = 0.9 * smoothstep(0.02, 0.11, x) * smoothstep(1.28, 1.38, y);
            put("left_collar", true, here * collar);
            put(name, true, here * (1.0 - collar));
        } else {
            put(name, true, here);
        }
        trunk *= rest;
    }
    put("head", true, trunk);
    out
}

/// Weights of all vertices: regions, smoothed along the surface (never across a gap), at most six joints each.
pub(super) fn weights(mesh: &TriMesh) -> BlendWeights {
    let adjacency = Adjacency::new(mesh.vertices.len(), &mesh.faces);
    let mut rows: Vec<Weights> = mesh.vertices.iter().map(regions).collect();
    for _ in 0..SMOOTHING {
        rows = (0..rows.len())
            .map(|v| {
                let around = adjacency.of(v);
                let share = 0.5 / around.len() as f64;
                std::array::from_fn(|j| {
                    0.5 * rows[v][j] + share * around.iter().map(|&w| rows[w as usize][j]).sum::<f64>()
                })
            })
            .collect();
    }
    BlendWeights::from_rows(rows.iter().map(|row| {
        let mut kept: Vec<(u16, f64)> =
            row.iter().enumerate().filter(|(_, w)| **w > SMALLEST).map(|(j, w)| (j as u16, *w)).collect();
        kept.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        kept.truncate(MOST_JOINTS);
        let sum: f64 = kept.iter().map(|(_, w)| w).sum();
        kept.sort_by_key(|(j, _)| *j);
        kept.into_iter().map(|(j, w)| (j, w / sum)).collect()
    }))
}

/// Joint regressor: positive weights on the ring of skin around each joint whose mean is the joint.
///
/// Among all such weights these are the ones of largest entropy relative to a Gaussian over the ring: unique, smooth,
/// positive, and found by Newton's method in three unknowns.
pub(super) fn regressor(
    mesh: &TriMesh,
    weights: &BlendWeights,
    joints: &[Vec3],
    cell: f64,
) -> Result<Vec<Vec<(u32, f64)>>> {
    let mut carried = vec![vec![0.0; mesh.vertices.len()]; COUNT];
    for v in 0..mesh.vertices.len() {
        for (j, w) in weights.row(v) {
            carried[j][v] = w;
        }
    }
    (0..COUNT)
        .map(|j| {
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
            let along = if hand { 0.6 * cell } else { 1.1 * cell };
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
        .collect()
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
