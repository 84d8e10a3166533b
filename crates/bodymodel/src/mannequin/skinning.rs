//! Skinning weights of the mannequin.

use super::figure::PELVIS_HEIGHT;
use super::hand::{Finger, fingers};
use super::smoothstep;
use super::surface::Symmetric;
use caphy_core::Vec3;
use caphy_core::body::{BlendWeights, Joint};
use caphy_core::pose::{SMPLX_JOINTS, SMPLX_PARENTS, smplx_joint};
use caphy_core::query::{Adjacency, nearest_on_line};
use rayon::prelude::*;

pub(super) const COUNT: usize = SMPLX_JOINTS.len();
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

/// The joint of the other side for each joint; itself in the middle.
pub(super) fn mirror_joints() -> [usize; COUNT] {
    std::array::from_fn(|j| {
        let name = SMPLX_JOINTS[j];
        let other = match (name.strip_prefix("left_"), name.strip_prefix("right_")) {
            (Some(rest), _) => format!("right_{rest}"),
            (_, Some(rest)) => format!("left_{rest}"),
            _ => return j,
        };
        smplx_joint(&other).unwrap_or(j)
    })
}

/// Where the joints of the left side own what lies beyond a plane through them, and the joints' ids.
struct Regions {
    fingers: [Finger; 5],
    /// Ids of the three joints of each finger.
    finger_joints: [[usize; 3]; 5],
    mirror: [usize; COUNT],
}

impl Regions {
    fn new() -> Self {
        let fingers = fingers();
        let finger_joints =
            std::array::from_fn(|f| std::array::from_fn(|k| id(&format!("left_{}{}", fingers[f].name, k + 1))));
        Self { fingers, finger_joints, mirror: mirror_joints() }
    }

    /// Weights that a position of the left half takes from where it lies on the figure, before smoothing.
    ///
    /// Each joint owns what lies beyond a plane through it, with a soft border. The planes are tilted so that they pass
    /// through the armpit and the crotch: the side of the chest is not the arm's, although the arm's bone is near.
    fn at(&self, p: &Vec3) -> Weights {
        let mut out = [0.0; COUNT];
        let p = Vec3::new(p.x, p.y + PELVIS_HEIGHT, p.z);
        let (x, y, z) = (p.x, p.y, p.z);

        // Arm: beyond a plane from the armpit to the top of the shoulder.
        let arm = smoothstep(-0.060, 0.065, 0.78 * (x - 0.174) + 0.62 * (y - 1.400)) * smoothstep(0.09, 0.16, x);
        let elbow = smoothstep(0.398, 0.492, x);
        let wrist = smoothstep(0.658, 0.714, x);
        out[id("left_shoulder")] = arm * (1.0 - elbow);
        out[id("left_elbow")] = arm * elbow * (1.0 - wrist);
        let hand = arm * elbow * wrist;
        if hand > 0.0 {
            self.hand(&p, hand, &mut out);
        }

        // Leg: below the line of the groin; the two legs share only the perineum.
        let leg = if y > 1.1 { 0.0 } else { smoothstep(-0.07, 0.07, 0.5 * (x - 0.085) - 0.866 * (y - 0.890)) };
        let knee = smoothstep(-0.065, 0.065, 0.480 - y);
        let ankle = smoothstep(-0.035, 0.03, (0.085 - y) + 0.5 * (z + 0.03));
        let toes = smoothstep(0.070, 0.110, z);
        let this = smoothstep(-0.02, 0.02, x);
        let names = ["left_hip", "left_knee", "left_ankle", "left_foot"].map(id);
        for (mirrored, share) in [(false, this), (true, 1.0 - this)] {
            let below = leg * share;
            let parts =
                [1.0 - knee, knee * (1.0 - ankle), knee * ankle * (1.0 - toes), knee * ankle * toes].map(|w| below * w);
            for (name, part) in names.iter().zip(parts) {
                out[if mirrored { self.mirror[*name] } else { *name }] += part;
            }
        }

        // Trunk: planes across the spine; the head's is tilted so that the chin goes with it.
        let mut trunk = (1.0 - arm - leg).max(0.0);
        let planes = [
            ("pelvis", y - 1.050, 0.090),
            ("spine1", y - 1.165, 0.085),
            ("spine2", y - 1.260, 0.080),
            ("spine3", y - 1.458 + 0.3 * (z + 0.035), 0.036),
            ("neck", y - 1.540 + 0.8 * (z + 0.015), 0.030),
        ];
        for (name, above, border) in planes {
            let rest = smoothstep(-border, border, above);
            let here = trunk * (1.0 - rest);
            if name == "spine3" {
                let collar = 0.9 * smoothstep(0.02, 0.12, x) * smoothstep(1.27, 1.39, y);
                out[id("left_collar")] += here * collar;
                out[id(name)] += here * (1.0 - collar);
            } else {
                out[id(name)] += here;
            }
            trunk *= rest;
        }
        out[id("head")] += trunk;
        out
    }

    /// Shares the weight `hand` of a position out among the wrist and the joints of the fingers.
    fn hand(&self, p: &Vec3, hand: f64, out: &mut Weights) {
        let thumb = smoothstep(-0.012, 0.012, p.z - (0.016 + 0.28 * (p.x - 0.70))) * smoothstep(0.69, 0.72, p.x);
        // Fingers share the hand by their distance: alike on the palm between two, alone on a finger.
        let near: [f64; 4] = std::array::from_fn(|f| {
            let points = &self.fingers[f].points;
            let wrist = Vec3::new(0.685, points[0].y, 0.5 * (points[0].z - 0.02));
            let chain = [wrist, points[0], points[1], points[2], points[3]];
            let d =
                chain.windows(2).map(|s| (p - nearest_on_line(p, [&s[0], &s[1]])).norm()).fold(f64::INFINITY, f64::min);
            (-(d / 0.007).powi(2)).exp().max(1e-30)
        });
        let sum: f64 = near.iter().sum();
        let mut palm = hand * (1.0 - thumb);
        for (f, near) in near.iter().enumerate() {
            let share = hand * (1.0 - thumb) * near / sum;
            let [a, b, c] = self.beyond(f, p, [0.016, 0.010, 0.008]);
            let joints = self.finger_joints[f];
            out[joints[0]] += share * a * (1.0 - b);
            out[joints[1]] += share * a * b * (1.0 - c);
            out[joints[2]] += share * a * b * c;
            palm -= share * a;
        }
        out[id("left_wrist")] += palm;
        let [_, b, c] = self.beyond(4, p, [0.016, 0.012, 0.009]);
        let joints = self.finger_joints[4];
        out[joints[0]] += hand * thumb * (1.0 - b);
        out[joints[1]] += hand * thumb * b * (1.0 - c);
        out[joints[2]] += hand * thumb * b * c;
    }

    /// How much of a position lies beyond each of the three joints of a finger, with soft borders [m].
    fn beyond(&self, finger: usize, p: &Vec3, borders: [f64; 3]) -> [f64; 3] {
        let points = &self.fingers[finger].points;
        std::array::from_fn(|k| {
            let before = if k == 0 { points[1] - points[0] } else { points[k] - points[k - 1] };
            let along = (before.normalize() + (points[k + 1] - points[k]).normalize()).normalize();
            smoothstep(-borders[k], borders[k], (p - points[k]).dot(&along))
        })
    }
}

/// Id of a joint that the layout has.
fn id(name: &str) -> usize {
    smplx_joint(name).unwrap_or(0)
}

/// Weights of all vertices: regions, smoothed along the surface (never across a gap), at most six joints each.
pub(super) fn weights(body: &Symmetric) -> BlendWeights {
    let (mesh, half) = (&body.mesh, body.half);
    let adjacency = Adjacency::new(mesh.vertices.len(), &mesh.faces);
    let regions = Regions::new();
    let swapped = |row: &Weights| -> Weights { std::array::from_fn(|j| row[regions.mirror[j]]) };
    // Rows of the left half; the right half and what is uneven in the middle follow by reflection.
    let whole = |mut left: Vec<Weights>| -> Vec<Weights> {
        for v in (0..half).filter(|&v| body.mirror[v] as usize == v) {
            let other = swapped(&left[v]);
            left[v] = std::array::from_fn(|j| 0.5 * (left[v][j] + other[j]));
        }
        let right: Vec<Weights> = body.mirror[half..].iter().map(|&v| swapped(&left[v as usize])).collect();
        left.extend(right);
        left
    };
    let mut rows = whole(mesh.vertices[..half].par_iter().map(|p| regions.at(p)).collect());
    for _ in 0..SMOOTHING {
        let average = |v: usize| -> Weights {
            let around = adjacency.of(v);
            let share = 0.5 / around.len() as f64;
            let mut out = rows[v].map(|w| 0.5 * w);
            for &w in around {
                for (o, r) in out.iter_mut().zip(&rows[w as usize]) {
                    *o += share * r;
                }
            }
            out
        };
        rows = whole((0..half).into_par_iter().map(average).collect());
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
